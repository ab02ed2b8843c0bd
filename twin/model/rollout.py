"""The motion of the twin's model: its derivative, its steps in the filter, its prediction.

The state is s = (x, y, psi, u, v, r): m north and east, rad clockwise, m/s forward and to
starboard over the ground, rad/s. The actuators are act = (nL, nR, dL, dR): rev/s, rad. A
positive drive angle turns to starboard. Accelerations are linear in the parameters xi; which
terms they have is the business of :mod:`twin.model.structure`.

    x' = u cos(psi) - v sin(psi),  y' = u sin(psi) + v cos(psi),  psi' = r

Actuators can also return to 0, which those of Eq (27) cannot.

Source: Qu et al. 2025, Eq (20)-(27), with the corrections of physics.md section 10.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.model.actuators import follow_all
from twin.model.dynamics import N_ACT
from twin.model.structure import (
    BIASED,
    LEFT_COS,
    LENGTH,
    N_STATES,
    N_TERMS,
    gather,
    rates,
    state_terms,
    thrust_rates,
    thrust_terms,
)
from usv_kernel.arrays import shaped
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import sincos

__all__ = [
    "LOOK_AHEAD",
    "ROOM",
    "look_ahead",
    "roll_out",
    "roll_outs",
]

Array = NDArray[np.float64]

STEP_MAX = 0.25
"""Longest integration step of :func:`roll_out`, s."""

SWAY_SLIP = 0.5
"""Inertia in surge over that in sway, added mass included: .5 to .6 of most hulls."""

_THRUST = N_STATES + 2

_SHARES = _THRUST + 9

_MOTION = _SHARES + 4 * N_TERMS
"""What a motion needs: state, cosine and sine of the heading; what the actuators add at the start,
middle and end of a step; its parameters, gathered."""

ROOM = 3 * N_TERMS + N_ACT + _MOTION + N_STATES
"""Length of the scratch of :func:`roll_out`."""


@inlined
def _bounded(value, bound):
    """Return the value within -bound ... bound; -bound for NaN."""
    if value >= bound:
        return bound
    return value if value > -bound else -bound


@inlined
def _turn_drives(act, turned):
    """Write cosine and sine of the drive angles, left and right."""
    turned[1], turned[0] = sincos(act[2])
    if act[3] == act[2]:
        turned[3], turned[2] = turned[1], turned[0]
    else:
        turned[3], turned[2] = sincos(act[3])


@kernel
def _thrust(act, turned, terms):
    thrust_terms(act[0], act[1], turned[0], turned[1], turned[2], turned[3], terms)


@inlined
def _rates(u, v, r, c, s, wind, hull, shares, thrust, terms):
    """Return the derivatives of u, v, r with the actuators' terms in place."""
    state_terms(u, v, r, c, s, wind, hull, terms)
    return rates(terms, shares, hull, thrust)


@inlined
def _advance(now, shares, thrust, a, b, w, h, envelope, wind, hull, terms):
    """Advance a motion (state, cosine and sine of the heading) by one step of :func:`roll_out`."""
    x, y, psi, u, v, r = now[0], now[1], now[2], now[3], now[4], now[5]
    c_1, s_1 = now[6], now[7]
    c_2, s_2, c_3, s_3 = c_1, s_1, c_1, s_1
    du_1, dv_1, dr_1 = _rates(u, v, r, c_1, s_1, wind, hull, shares, thrust[0], terms[0])
    if hull[BIASED] > 0.0:  # which way the bias points, as far as this stage can know
        ahead = psi + 0.5 * h * (r + w + 0.25 * h * dr_1)
        s_2, c_2 = sincos(ahead)
        ahead = psi + h * (r + w + 0.5 * h * dr_1)
        s_3, c_3 = sincos(ahead)
    u_2 = _bounded(u + 0.5 * h * du_1, envelope[0])
    v_2 = _bounded(v + 0.5 * h * dv_1, envelope[1])
    r_2 = _bounded(r + 0.5 * h * dr_1, envelope[2])
    du_2, dv_2, dr_2 = _rates(u_2, v_2, r_2, c_2, s_2, wind, hull, shares, thrust[1], terms[1])
    u_3 = _bounded(u + 0.5 * h * du_2, envelope[0])
    v_3 = _bounded(v + 0.5 * h * dv_2, envelope[1])
    r_3 = _bounded(r + 0.5 * h * dr_2, envelope[2])
    du_3, dv_3, dr_3 = _rates(u_3, v_3, r_3, c_2, s_2, wind, hull, shares, thrust[1], terms[1])
    u_4 = _bounded(u + h * du_3, envelope[0])
    v_4 = _bounded(v + h * dv_3, envelope[1])
    r_4 = _bounded(r + h * dr_3, envelope[2])
    du_4, dv_4, dr_4 = _rates(u_4, v_4, r_4, c_3, s_3, wind, hull, shares, thrust[2], terms[2])
    u_1, v_1, r_1 = u, v, r
    u = _bounded(u + h / 6.0 * (du_1 + 2.0 * (du_2 + du_3) + du_4), envelope[0])
    v = _bounded(v + h / 6.0 * (dv_1 + 2.0 * (dv_2 + dv_3) + dv_4), envelope[1])
    r = _bounded(r + h / 6.0 * (dr_1 + 2.0 * (dr_2 + dr_3) + dr_4), envelope[2])
    # heading and place follow the velocities by Simpson's rule, with two sines a step;
    # the velocities in the middle are those of a cubic through both ends
    u_m = _bounded(0.5 * (u_1 + u) + 0.125 * h * (du_1 - du_4), envelope[0])
    v_m = _bounded(0.5 * (v_1 + v) + 0.125 * h * (dv_1 - dv_4), envelope[1])
    r_m = _bounded(0.5 * (r_1 + r) + 0.125 * h * (dr_1 - dr_4), envelope[2])
    psi_m = psi + h / 24.0 * (5.0 * r_1 + 8.0 * r_m - r) + 0.5 * h * w
    psi += h / 6.0 * (r_1 + 4.0 * r_m + r) + h * w
    s_m, c_m = sincos(psi_m)
    vx_1, vy_1 = (u_1 + a) * c_1 - (v_1 + b) * s_1, (u_1 + a) * s_1 + (v_1 + b) * c_1
    vx_m, vy_m = (u_m + a) * c_m - (v_m + b) * s_m, (u_m + a) * s_m + (v_m + b) * c_m
    s_1, c_1 = sincos(psi)
    x += h / 6.0 * (vx_1 + 4.0 * vx_m + (u + a) * c_1 - (v + b) * s_1)
    y += h / 6.0 * (vy_1 + 4.0 * vy_m + (u + a) * s_1 + (v + b) * c_1)
    now[0], now[1], now[2], now[3], now[4], now[5] = x, y, psi, u, v, r
    now[6], now[7] = c_1, s_1


@kernel
def roll_out(
    s_0, xi, act_0, plan, dt_plan, lags, envelope, wind, kit, ripple, gain, out, out_act, room
):
    """Predict the motion under a plan of commands, actuators included.

    Runge-Kutta of fourth order at steps of at most :data:`STEP_MAX`. The velocities are held
    within an envelope throughout, so that the worst parameters give a finite motion.

    Parameters
    ----------
    s_0 : (6,) array
        State at the start: x, y (m), psi (rad), u, v (m/s), r (rad/s).
    xi : (p,) array
        Parameters.
    act_0 : (4,) array
        Actuators at the start: in the unit of the structure, rad.
    plan : (K, 4) array
        Commands; row k is in force from k to k + 1 times ``dt_plan``.
    dt_plan : float
        Time between rows, s.
    lags : (3,) array
        Time constants of shaft speed and drive angle, s, above 0; largest turning speed of
        the drives, rad/s.
    envelope : (3,) array
        Largest abs(u), abs(v), m/s, and abs(r), rad/s.
    wind, kit
        See :func:`derivative`; the wind stays.
    ripple : (K, 3) or (0, 3) array
        Velocities that carry the boat along and act on her as ``gain`` says (waves), on average
        over each row, m/s and rad/s; they are not in ``out[:, 3:]``.
    gain : float
        How much of them the boat's own velocities take on, 1/s: that of an observer which counts
        as ripple what it leaves of the measured ones. Above 0, u and v also turn against the
        ripple's yaw rate, see :func:`slip`. At 0 ripple carries her, no more.
    out : (K, 6) array
        Row k is the state at the end of row k of the plan ...
    out_act : (K, 4) array
        ... and this the actuators then.
    room : (ROOM,) array
        Scratch.

    Source: Eq (25)-(27), with Eq (27) replaced by ``usv_kernel.scalar.actuate``.
    """
    many, K = 1, plan.shape[0]
    start = room[ROOM - N_STATES : ROOM]
    for k in range(N_STATES):
        start[k] = s_0[k]
    _roll(
        *(shaped(start, 0, (many, N_STATES)), shaped(xi, 0, (many, xi.shape[0]))),
        *(act_0, plan, dt_plan),
        *(lags, envelope, wind, kit, shaped(ripple, 0, (many, ripple.shape[0], 3)), gain),
        *(shaped(out, 0, (many, K, N_STATES)), out_act, room),
    )


@kernel
def roll_outs(
    s_0, xi, act_0, plan, dt_plan, lags, envelope, wind, kit, ripple, gain, out, out_act, room
):
    """Predict several motions under one plan; the actuators are followed once.

    Parameters
    ----------
    s_0, xi, ripple, out : (D, ...) arrays
        Those of :func:`roll_out`, one motion's after the other.
    act_0, plan, dt_plan, lags, envelope, wind, kit, gain, out_act
        See :func:`roll_out`.
    room : (ROOM D,) array
        Scratch.
    """
    _roll(
        *(s_0, xi, act_0, plan, dt_plan, lags, envelope, wind, kit, ripple, gain),
        *(out, out_act, room),
    )


@inlined
def _moves(act, command):
    """Return whether an actuator has not arrived at its command."""
    moves = False
    for k in range(N_ACT):
        moves = moves or act[k] != command[k]
    return moves


@inlined
def _rooms(room, D):
    """Return views: terms at start, middle and end of a step, sines of the drives, D motions."""
    end = 3 * N_TERMS + N_ACT
    return (
        shaped(room, 0, (3, N_TERMS)),
        room[3 * N_TERMS : end],
        shaped(room, end, (D, _MOTION)),
    )


@inlined
def _motion(row):
    """Return the parts of a motion as views, see ``_MOTION``."""
    return row[:_THRUST], shaped(row, _THRUST, (3, 3)), shaped(row, _SHARES, (N_TERMS, 4))


@kernel
def _begin(s_0, xi, act_0, envelope, kit, room):
    """Write to the room what :func:`_sail` goes on from."""
    terms, turned, motions = _rooms(room, s_0.shape[0])
    for d in range(s_0.shape[0]):
        now, _, shares = _motion(motions[d])
        for k in range(3):
            now[k] = s_0[d, k]
            now[3 + k] = _bounded(s_0[d, 3 + k], envelope[k])
        now[7], now[6] = sincos(s_0[d, 2])
        gather(kit, xi[d], shares)
    _turn_drives(act_0, turned)
    _thrust(act_0, turned, terms[2])


@inlined
def slip(w, h, s, at):
    """Let her keep way over ground while a wave turns her at a rate w for h seconds.

    What turns her alone leaves the velocity over ground: u and v turn the other way. The water that
    moves with her sides makes her near twice as heavy in sway, and v by :data:`SWAY_SLIP` slower.

    Parameters
    ----------
    w, h : float
        Yaw rate of the wave, rad/s, and time, s.
    s : array
        u and v, m/s, stand at ``at``.
    """
    s[at] += h * w * s[at + 1]
    s[at + 1] -= SWAY_SLIP * h * w * s[at]


@kernel
def _sail(act, command, span, steps, lags, envelope, wind, hull, ripple, gain, row, moved, room):
    """Advance all motions by ``span`` in so many steps; return whether actuators moved in the last.

    ``moved`` is what the span before returned, True at the start.
    """
    D = ripple.shape[0]
    terms, turned, motions = _rooms(room, D)
    a, b, w = 0.0, 0.0, 0.0
    h = span / steps
    for _ in range(steps):
        moves = _moves(act, command)
        if moves or moved:  # else the terms of the actuators stay
            for k in range(LEFT_COS, N_TERMS):
                terms[0, k] = terms[2, k]
            if moves:
                follow_all(act, command, lags, 1.0, 0.5 * h)
                _turn_drives(act, turned)
            _thrust(act, turned, terms[1])
            if moves:
                follow_all(act, command, lags, 1.0, 0.5 * h)
                _turn_drives(act, turned)
            _thrust(act, turned, terms[2])
        for d in range(D):
            now, thrust, shares = _motion(motions[d])
            if moves or moved:
                for k in range(3):
                    thrust_rates(terms[k], shares, thrust[k])
            if ripple.shape[1] > 0:
                a, b, w = ripple[d, row, 0], ripple[d, row, 1], ripple[d, row, 2]
            _advance(now, shares, thrust, a, b, w, h, envelope, wind, hull, terms)
            if ripple.shape[1] > 0 and gain > 0.0:
                slip(w, h, now, 3)
                now[3] = _bounded(now[3] + gain * h * a, envelope[0])
                now[4] = _bounded(now[4] + gain * h * b, envelope[1])
                now[5] = _bounded(now[5] + gain * h * w, envelope[2])
        moved = moves
    return moved


@kernel
def _roll(
    s_0, xi, act_0, plan, dt_plan, lags, envelope, wind, kit, ripple, gain, out, out_act, room
):
    """Roll out as :func:`roll_outs` does."""
    D, moved = s_0.shape[0], True
    motions = _rooms(room, D)[2]
    steps = max(math.ceil(dt_plan / STEP_MAX - 1e-9), 1)
    _begin(s_0, xi, act_0, envelope, kit, room)
    for row in range(plan.shape[0]):
        act = out_act[row]
        for k in range(N_ACT):
            act[k] = out_act[row - 1, k] if row > 0 else act_0[k]
        moved = _sail(
            *(act, plan[row], dt_plan, steps, lags, envelope, wind, kit[2], ripple, gain, row),
            *(moved, room),
        )
        for d in range(D):
            for k in range(N_STATES):
                out[d, row, k] = motions[d, k]


LOOK_AHEAD = np.array([1.0, 2.0, 5.0, 10.0])
"""How far ahead an observation looks, s."""

_LONGEST, _STIFFEST = 1.6, 1.3
"""Longest step of :func:`look_ahead`, in times to sail a length and in the model's own times."""

_STEPS_MAX = 100.0
"""No more steps from one time to the next: a model as stiff as that is wild at any step."""

_NEAR = 1e-3
"""An actuator so near to its command (as a part of it) has arrived, in :func:`look_ahead`."""


@kernel
def _stiffness(now, shares, thrust, time_scale, wind, hull, terms):
    """Return how fast the model's fastest motion dies away, 1/s; surge by itself.

    Radius of the spectrum of the Jacobian, by differences.
    """
    u, v, r, c, s = now[3], now[4], now[5], now[6], now[7]
    length = hull[LENGTH]
    du, dv, dr = _rates(u, v, r, c, s, wind, hull, shares, thrust, terms)
    small = 1e-3 * length / time_scale
    du_u, _, _ = _rates(u + small, v, r, c, s, wind, hull, shares, thrust, terms)
    _, dv_v, dr_v = _rates(u, v + small, r, c, s, wind, hull, shares, thrust, terms)
    _, dv_r, dr_r = _rates(u, v, r + small / length, c, s, wind, hull, shares, thrust, terms)
    vv, rr = (dv_v - dv) / small, (dr_r - dr) / small * length
    half = 0.5 * (vv + rr)
    bent = half * half - vv * rr + (dv_r - dv) / small * length * (dr_v - dr) / small
    fast = abs(half) + math.sqrt(bent) if bent > 0.0 else math.sqrt(half * half - bent)
    return max(fast, abs(du_u - du) / small)


@kernel
def look_ahead(
    s, xi, act, command, lags, envelope, wind, kit, time_scale, ripple, gain, out, out_act, room
):
    """Predict the motion under a held command at a few times, cheaply.

    As :func:`roll_out`, at steps as long as the model's stiffness allows. With a learned model
    mostly within 1e-3 of the way made of what that says; within 1e-2 in nine of ten random states
    of a model drawn from the prior, of which two in a hundred are off by more than 5e-2.

    Parameters
    ----------
    s, xi, act, lags, envelope, wind, kit, room
        See :func:`roll_out`.
    command : (4,) array
        Held all the time; in the unit of the structure, rad.
    slowness : float
        Time to sail a length, s.
    ripple : (4, 3) or (0, 3) array
        Velocities of the waves, on average from each of the times to the next.
    gain : float
        See :func:`roll_out`.
    out, out_act : (4, 6), (4, 4) arrays
        States and actuators at :data:`LOOK_AHEAD` are written there.
    """
    many, before, moved = 1, 0.0, True
    terms, turned, motions = _rooms(room, many)
    start = room[ROOM - N_STATES : ROOM]
    for k in range(N_STATES):
        start[k] = s[k]
    _begin(
        *(shaped(start, 0, (many, N_STATES)), shaped(xi, 0, (many, xi.shape[0]))),
        *(act, envelope, kit, room),
    )
    waves = shaped(ripple, 0, (many, ripple.shape[0], 3))
    for j in range(LOOK_AHEAD.shape[0]):
        now, span = out_act[j], LOOK_AHEAD[j] - before
        before = LOOK_AHEAD[j]
        for k in range(N_ACT):
            now[k] = out_act[j - 1, k] if j > 0 else act[k]
        sailed, thrust, shares = _motion(motions[0])
        thrust_rates(terms[2], shares, thrust[2])
        fast = _stiffness(sailed, shares, thrust[2], time_scale, wind, kit[2], terms[2])
        step = time_scale * min(_LONGEST, _STIFFEST / max(fast * time_scale, 1e-9))
        steps = max(math.ceil(min(span / step, _STEPS_MAX)), 1)
        moved = _sail(
            *(now, command, span, steps, lags, envelope, wind, kit[2], waves, gain, j),
            *(moved, room),
        )
        for k in range(N_STATES):
            out[j, k] = motions[0, k]
        for k in range(N_ACT):
            if now[k] != command[k] and abs(now[k] - command[k]) <= _NEAR * abs(command[k]):
                now[k] = command[k]
                moved = True
        if moved:
            _turn_drives(now, turned)
            _thrust(now, turned, terms[2])


def upsample(path: Array, every: int, rows: int) -> Array:
    """Return values at every step of a plan from those at every few steps, linearly between.

    Parameters
    ----------
    path : ndarray, shape (K + 1, ...)
        Values now and after each coarse step.
    every : int
        Steps in a coarse step; the last may be cut short.
    rows : int
        Steps of the plan, at most K * every.

    Returns
    -------
    ndarray, shape (rows, ...)
    """
    place = np.arange(1, rows + 1) / every
    low = np.minimum(place.astype(int), len(path) - 2)
    share = (place - low).reshape(-1, *[1] * (path.ndim - 1))
    between: Array = (1.0 - share) * path[low] + share * path[low + 1]
    return between
