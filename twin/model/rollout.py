"""The forecast of the twin's model: several motions under one plan of commands.

The state is s = (x, y, psi, u, v, r): m north and east, rad clockwise, m/s forward and to
starboard over the ground, rad/s. The actuators are act = (nL, nR, dL, dR): rev/s, rad. A
positive drive angle turns to starboard. Accelerations are linear in the parameters xi; which
terms they have is defined in :mod:`twin.model.structure`.

    x' = u cos(psi) - v sin(psi),  y' = u sin(psi) + v cos(psi),  psi' = r

Actuators can also return to 0, which those of Eq (27) cannot.

Source: Qu et al. 2025, Eq (20)-(27), with the corrections of docs/explanation/ship_and_sea.md,
What the paper gets wrong.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.channels import PSI
from twin.model.actuators import follow_all
from twin.model.dynamics import N_ACT
from twin.model.structure import (
    HEADING,
    LEFT_COS,
    LENGTH,
    N_STATES,
    N_TERMS,
    current_of,
    gather,
    nominal_speed,
    rates,
    state_terms,
    through_water,
    thrust_rates,
    thrust_terms,
)
from usv_kernel.arrays import take
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import sincos

__all__ = [
    "GRID",
    "HORIZONS",
    "HORIZON_ROWS",
    "LONG_STEP",
    "Paths",
    "RolloutConfig",
    "RolloutStart",
    "Waves",
    "rollout",
    "rollout_size",
    "rotate_body_velocity",
    "upsample",
]

Array = NDArray[np.float64]

GRID = 0.25
"""Step of a forecast's integration (at most) and of its waves, s."""

LONG_STEP = 0.5
"""Rows as long as this, s, are one step of the integration where the model is slow enough."""

RATE_STEP_MAX = 1.3
"""Largest product of the fastest motion's rate and a step; else steps are shorter."""

STEPS_PER_S_MAX = 16.0
"""Most steps of the integration per second."""

SPEED_RATIO = 1.25
START_SPEED = 0.1
"""Increase of the speed after which steps are chosen again: a ratio, and nominal speeds."""

HORIZONS = np.array([1.0, 2.0, 5.0, 10.0])
"""How far ahead an observation looks, s."""

HORIZON_ROWS = np.array([round(h / LONG_STEP) - 1 for h in HORIZONS])
"""Rows of a plan of steps :data:`LONG_STEP` that end there."""

SWAY_INERTIA_RATIO = 0.5
"""Inertia in surge over that in sway, added mass included: .5 to .6 of most hulls."""


class RolloutStart(NamedTuple):
    """Where D motions begin, and with which parameters."""

    states: Any  # (D, 6) x, y (m), psi (rad), u, v (m/s), r (rad/s)
    params: Any  # (D, p) parameters
    act: Any  # (4,) actuators: in the unit of the structure, rad
    wind: Any  # (2,) true wind to north and east, m/s; it stays


class RolloutConfig(NamedTuple):
    """What :func:`rollout` needs of a configuration; others may have more fields."""

    lags: Any  # (3,) shaft speed and drive angle, s, above 0; speed of the drives, rad/s
    envelope: Any  # (3,) largest abs(u), abs(v), m/s, and abs(r), rad/s
    model: Any  # ModelTerms


class Waves(NamedTuple):
    """Velocities that carry the boat along, on average over each row of the plan."""

    velocity: Any  # (D, K, 3) m/s and rad/s; not in the states. (D, 0, 3) for none
    gain: float  # how much of them the boat's own velocities take on, 1/s


class Paths(NamedTuple):
    """What :func:`rollout` writes, at the end of each row of the plan."""

    states: Any  # (D, K, 6)
    act: Any  # (K, 4)


_MOTION = N_STATES + 4 + 9 + 4 * N_TERMS


class _Motion(NamedTuple):
    """Workspace of one motion."""

    now: Any  # (8,) state, cosine and sine of the heading
    current: Any  # (2,) velocity of the water to north and east, m/s
    thrust: Any  # (3, 3) accelerations by the actuators at start, middle and end of a step
    shares: Any  # (N_TERMS, 4) parameters, gathered by terms


class _Workspace(NamedTuple):
    """Workspace of a rollout."""

    terms: Any  # (3, N_TERMS) terms at start, middle and end of a step
    turned: Any  # (4,) cosine and sine of the drive angles, left and right
    motions: Any  # (D, m) the numbers of :class:`_Motion`


@inlined
def _motion(row):
    now, at = take(row, 0, (N_STATES + 2,))
    current, at = take(row, at, (2,))
    thrust, at = take(row, at, (3, 3))
    shares, at = take(row, at, (N_TERMS, 4))
    return _Motion(now, current, thrust, shares)


@inlined
def _workspace(work, D):
    terms, at = take(work, 0, (3, N_TERMS))
    turned, at = take(work, at, (N_ACT,))
    motions, at = take(work, at, (D, _MOTION))
    return _Workspace(terms, turned, motions)


def rollout_size(D: int = 1) -> int:
    """Return the length of the workspace of :func:`rollout` for D motions."""
    return 3 * N_TERMS + N_ACT + D * _MOTION


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
def _rates(motion, water, hull, shares, thrust, terms):
    """Return the derivatives of u, v, r; a motion is u, v, r, cosine and sine of the heading."""
    u, v, r, c, s = motion
    (u, v), over, (ahead, aside) = through_water((u, v), (c, s), water[0], water[1])
    state_terms(u, v, r, c, s, over, hull, terms)
    du, dv, dr = rates(terms, shares, hull, thrust)
    return du + r * aside, dv - r * ahead, dr


@inlined
def _rk4_step(motion, wave, h, envelope, wind, hull, terms):
    """Advance a motion by one step of the Runge-Kutta scheme of fourth order.

    Heading and place follow the velocities by Simpson's rule, with two sines a step.
    """
    now, shares, thrust = motion.now, motion.shares, motion.thrust
    a, b, w = wave
    water = wind, (motion.current[0], motion.current[1])
    x, y, psi, u, v, r = now[0], now[1], now[2], now[3], now[4], now[5]
    c_1, s_1 = now[6], now[7]
    c_2, s_2, c_3, s_3 = c_1, s_1, c_1, s_1
    du_1, dv_1, dr_1 = _rates((u, v, r, c_1, s_1), water, hull, shares, thrust[0], terms[0])
    if hull[HEADING] > 0.0:  # earth-fixed terms need the heading at mid-step and end
        ahead = psi + 0.5 * h * (r + w + 0.25 * h * dr_1)
        s_2, c_2 = sincos(ahead)
        ahead = psi + h * (r + w + 0.5 * h * dr_1)
        s_3, c_3 = sincos(ahead)
    u_2 = _bounded(u + 0.5 * h * du_1, envelope[0])
    v_2 = _bounded(v + 0.5 * h * dv_1, envelope[1])
    r_2 = _bounded(r + 0.5 * h * dr_1, envelope[2])
    du_2, dv_2, dr_2 = _rates((u_2, v_2, r_2, c_2, s_2), water, hull, shares, thrust[1], terms[1])
    u_3 = _bounded(u + 0.5 * h * du_2, envelope[0])
    v_3 = _bounded(v + 0.5 * h * dv_2, envelope[1])
    r_3 = _bounded(r + 0.5 * h * dr_2, envelope[2])
    du_3, dv_3, dr_3 = _rates((u_3, v_3, r_3, c_2, s_2), water, hull, shares, thrust[1], terms[1])
    u_4 = _bounded(u + h * du_3, envelope[0])
    v_4 = _bounded(v + h * dv_3, envelope[1])
    r_4 = _bounded(r + h * dr_3, envelope[2])
    du_4, dv_4, dr_4 = _rates((u_4, v_4, r_4, c_3, s_3), water, hull, shares, thrust[2], terms[2])
    u_1, v_1, r_1 = u, v, r
    u = _bounded(u + h / 6.0 * (du_1 + 2.0 * (du_2 + du_3) + du_4), envelope[0])
    v = _bounded(v + h / 6.0 * (dv_1 + 2.0 * (dv_2 + dv_3) + dv_4), envelope[1])
    r = _bounded(r + h / 6.0 * (dr_1 + 2.0 * (dr_2 + dr_3) + dr_4), envelope[2])
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


@inlined
def rotate_body_velocity(w, h, s, at):
    """Rotate u and v against a wave that turns the hull at a rate w for h seconds.

    Such a turn leaves the velocity over ground: u and v rotate the other way. Added mass nearly
    doubles the inertia in sway, so that v changes by :data:`SWAY_INERTIA_RATIO` of that only.

    Parameters
    ----------
    w, h : float
        Yaw rate of the wave, rad/s, and time, s.
    s : array
        u and v, m/s, stand at ``at``.
    """
    s[at] += h * w * s[at + 1]
    s[at + 1] -= SWAY_INERTIA_RATIO * h * w * s[at]


@inlined
def _moves(act, command):
    """Return whether an actuator has not arrived at its command."""
    moves = False
    for k in range(N_ACT):
        moves = moves or act[k] != command[k]
    return moves


@inlined
def _fastest_rate(motion, wind, hull, terms):
    """Return how fast the model's fastest motion dies away or grows, 1/s; surge by itself.

    Radius of the spectrum of the Jacobian, by differences.
    """
    now, shares, thrust = motion.now, motion.shares, motion.thrust[2]
    u, v, r, c, s = now[3], now[4], now[5], now[6], now[7]
    water = wind, (motion.current[0], motion.current[1])
    small, turn = 1e-3, 1e-3 / hull[LENGTH]
    du, dv, dr = _rates((u, v, r, c, s), water, hull, shares, thrust, terms)
    du_u = _rates((u + small, v, r, c, s), water, hull, shares, thrust, terms)[0]
    by_v = _rates((u, v + small, r, c, s), water, hull, shares, thrust, terms)
    by_r = _rates((u, v, r + turn, c, s), water, hull, shares, thrust, terms)
    vv, rv = (by_v[1] - dv) / small, (by_v[2] - dr) / small
    vr, rr = (by_r[1] - dv) / turn, (by_r[2] - dr) / turn
    half = 0.5 * (vv + rr)
    square = half * half - vv * rr + vr * rv
    fastest = abs(half) + math.sqrt(square) if square > 0.0 else math.sqrt(half * half - square)
    return max(fastest, abs(du_u - du) / small)


@inlined
def _speed(motion, hull):
    """Return the sum of a motion's speeds, m/s; the ends of the hull turn."""
    now = motion.now
    return abs(now[3]) + abs(now[4]) + hull[LENGTH] * abs(now[5])


@inlined
def _steps_of(dt, motion, wind, hull, terms):
    """Return how many steps of the integration are one row."""
    few = max(math.ceil(dt / LONG_STEP - 1e-9), 1)
    many = max(math.ceil(dt / GRID - 1e-9), 1)
    needed = _fastest_rate(motion, wind, hull, terms) * dt / RATE_STEP_MAX
    if needed <= few:
        return few
    return max(many, math.ceil(min(needed, STEPS_PER_S_MAX * dt)))


@inlined
def _thrust_ahead(moves, motion, terms):
    """Write what the actuators give at start, middle and end of a step; before, that of the end."""
    thrust = motion.thrust
    for i in range(3):
        thrust[0, i] = thrust[2, i]
    if moves:
        thrust_rates(terms[1], motion.shares, thrust[1])
        thrust_rates(terms[2], motion.shares, thrust[2])
    else:
        for i in range(3):
            thrust[1, i] = thrust[2, i]


@kernel
def rollout(start, plan, dt, config, waves, out, work):
    """Predict motions under a plan of commands; the actuators are followed once for all.

    Runge-Kutta of fourth order at steps of at most :data:`GRID`; of :data:`LONG_STEP` where rows
    are as long and the first motion is no faster than that resolves. Steps are shorter where it is
    faster still, as when a small boat gathers speed. The velocities are held within an envelope
    throughout, so that the worst parameters give a finite motion.

    Parameters
    ----------
    start : RolloutStart
        Where the motions begin.
    plan : (K, 4) array
        Commands in the unit of the structure, rad; row k is in force from k to k + 1 times ``dt``.
    dt : float
        Time between rows, s.
    config : RolloutConfig
        Boat and model.
    waves : Waves
        The gain is that of an observer which counts its residual of the measured velocities as
        waves. Above 0, u and v also turn against the waves' yaw rate. At 0 waves only carry the
        boat.
    out : Paths
        Written.
    work : array
        Scratch, as long as :func:`rollout_size` says.

    Returns
    -------
    int
        Steps of the integration that one row took, at most.

    Source: Eq (25)-(27), with Eq (27) replaced by ``usv_kernel.scalar.actuate``.
    """
    D, wind, moved = start.states.shape[0], start.wind, True
    lags, envelope, hull = config.lags, config.envelope, config.model.hull
    velocity, gain = waves.velocity, waves.gain
    scratch = _workspace(work, D)
    terms, turned = scratch.terms, scratch.turned
    a, b, w = 0.0, 0.0, 0.0
    _turn_drives(start.act, turned)
    _thrust(start.act, turned, terms[2])
    for d in range(D):
        motion = _motion(scratch.motions[d])
        now, state = motion.now, start.states[d]
        for k in range(3):
            now[k] = state[k]
            now[3 + k] = _bounded(state[3 + k], envelope[k])
        now[7], now[6] = sincos(state[PSI])
        motion.current[0], motion.current[1] = current_of(start.params[d], 0, hull)
        gather(config.model, start.params[d], motion.shares)
        thrust_rates(terms[2], motion.shares, motion.thrust[2])
    first = _motion(scratch.motions[0])
    steps, most, chosen_at = 1, 1, -math.inf
    for row in range(plan.shape[0]):
        speed = _speed(first, hull)
        if speed > chosen_at:
            steps = _steps_of(dt, first, wind, hull, terms[2])
            most = max(most, steps)
            chosen_at = SPEED_RATIO * speed + START_SPEED * nominal_speed(hull)
        h = dt / steps
        act, command = out.act[row], plan[row]
        for k in range(N_ACT):
            act[k] = out.act[row - 1, k] if row > 0 else start.act[k]
        for _ in range(steps):
            moves = _moves(act, command)
            if moves:
                follow_all(act, command, lags, 1.0, 0.5 * h)
                _turn_drives(act, turned)
                for k in range(LEFT_COS, N_TERMS):
                    terms[0, k] = terms[2, k]
                _thrust(act, turned, terms[1])
                follow_all(act, command, lags, 1.0, 0.5 * h)
                _turn_drives(act, turned)
                _thrust(act, turned, terms[2])
            elif moved:  # the actuators have come to rest
                for k in range(LEFT_COS, N_TERMS):
                    terms[0, k] = terms[1, k] = terms[2, k]
            for d in range(D):
                motion = _motion(scratch.motions[d])
                now = motion.now
                if moves or moved:
                    _thrust_ahead(moves, motion, terms)
                if velocity.shape[1] > 0:
                    a, b, w = velocity[d, row, 0], velocity[d, row, 1], velocity[d, row, 2]
                _rk4_step(motion, (a, b, w), h, envelope, wind, hull, terms)
                if velocity.shape[1] > 0 and gain > 0.0:
                    rotate_body_velocity(w, h, now, 3)
                    now[3] = _bounded(now[3] + gain * h * a, envelope[0])
                    now[4] = _bounded(now[4] + gain * h * b, envelope[1])
                    now[5] = _bounded(now[5] + gain * h * w, envelope[2])
            moved = moves
        for d in range(D):
            for k in range(N_STATES):
                out.states[d, row, k] = scratch.motions[d, k]
    return most


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
