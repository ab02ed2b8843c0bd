"""Turning circles and zigzags in calm water, and the indices of simulated or recorded ones.

Lengths are in ship lengths, times in s, angles in rad, rates of turn r L / U with the present speed
U. A turn to port is mirrored first: its indices are positive as well.

Source: IMO MSC/Circ.1053, 2.1 and 2.2; ITTC 7.5-04-02-01.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from usv_gym import SeaState, SensorSuite
from usv_gym.physics import frames as fr
from usv_gym.world.simulation import Simulation

LONGEST_LENGTHS = 200.0
"""Way at the approach speed after which a trial fails, ship lengths."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """Motion of one ship over time, arrays (N,)."""

    t: np.ndarray  # s, rising
    # position to north and east (or along and to starboard of any fixed line), m
    x: np.ndarray
    y: np.ndarray
    psi: np.ndarray  # heading, rad; jumps by whole turns are removed
    # velocity ahead and to starboard (m/s), rate of turn (rad/s)
    u: np.ndarray
    v: np.ndarray
    r: np.ndarray
    delta: np.ndarray  # actual or ordered helm angle, rad; positive turns to starboard

    def __post_init__(self):
        object.__setattr__(self, "psi", np.unwrap(self.psi))

    @property
    def speed(self):
        """Speed (N,), m/s."""
        return np.hypot(self.u, self.v)

    def mirrored(self):
        """Return the track with port and starboard exchanged."""
        return dataclasses.replace(
            self, y=-self.y, psi=-self.psi, v=-self.v, r=-self.r, delta=-self.delta
        )

    def helm_moves(self):
        """Return when the helm first moves, s, extrapolated from 10 and 20 % of its range."""
        moved = np.abs(self.delta - self.delta[0])
        low, high = (crossing(self.t, moved, share * moved.max()) for share in (0.1, 0.2))
        return float(max(self.t[0], 2.0 * low - high))

    def begun(self, origin=None, heading=None):
        """Return the manoeuvre from its order on, relative to the approach: t, x, y are 0 there.

        ``origin`` is the time of the order, s, by default :meth:`helm_moves`, which is later by the
        delay of the steering gear where helm angles are actual ones; ``heading`` that of the
        approach, rad, by default the mean up to the origin.
        """
        start = self.helm_moves() if origin is None else origin
        t = np.concatenate([[start], self.t[self.t > start]])
        columns = {item.name: getattr(self, item.name) for item in dataclasses.fields(self)}
        run = Track(**{name: np.interp(t, self.t, column) for name, column in columns.items()})
        if heading is None:
            base = float(np.mean(self.psi[self.t <= start]))
        else:
            base = heading + 2.0 * math.pi * round((run.psi[0] - heading) / (2.0 * math.pi))
        x, y, c, s = run.x - run.x[0], run.y - run.y[0], math.cos(base), math.sin(base)
        return dataclasses.replace(
            run, t=run.t - start, x=c * x + s * y, y=c * y - s * x, psi=run.psi - base
        )


def crossing(t, values, level):
    """Return when values first reach a level, by interpolation; None if they never do."""
    above = np.flatnonzero(values >= level)
    if not above.size:
        return None
    k = max(int(above[0]), 1)
    low, high = values[k - 1], values[k]
    share = (level - low) / (high - low) if low < level else 0.0
    return float(t[k - 1] + share * (t[k] - t[k - 1]))


def to_starboard(run, change):
    """Return the side of the first change of heading, and the run mirrored to starboard."""
    beyond = np.flatnonzero(np.abs(run.psi) >= change)
    if not beyond.size:
        most = math.degrees(np.abs(run.psi).max())
        raise ValueError(
            f"the heading changed by {most:.3g} degrees at most, it never reached "
            f"{math.degrees(change):.3g} degrees"
        )
    return (1, run) if run.psi[beyond[0]] > 0.0 else (-1, run.mirrored())


class Turning(NamedTuple):
    """Indices of a turning circle; those of the steady turn are NaN if the track is too short."""

    side: int  # 1 to starboard, -1 to port
    advance: float  # along the approach at a change of heading of 90 degrees
    transfer: float  # across it at 90 degrees
    tactical_diameter: float  # across it at 180 degrees
    # of the steady turn: rate, radius, drift angle (positive with the bow inside the circle), and
    # speed over that of the approach
    rate: float
    radius: float
    drift: float
    speed_ratio: float


def turning_indices(track, length, origin=None, heading=None):
    """Return the indices of a turning circle of a ship of a length (m).

    The track goes from the approach or the order to a change of heading of 180 degrees or more. The
    steady turn needs 270 degrees; it is the mean over the last full circle after 180. A pull-out at
    the end is ignored. ``origin`` (s) and ``heading`` (rad): see :meth:`Track.begun`.
    """
    start = track.helm_moves() if origin is None else origin
    approach = float(np.mean(track.speed[track.t <= start]))
    side, run = to_starboard(track.begun(origin, heading), math.pi)
    t_90, t_180 = (crossing(run.t, run.psi, angle) for angle in (0.5 * math.pi, math.pi))
    x, y = (lambda time, a=a: float(np.interp(time, run.t, a)) for a in (run.x, run.y))
    rate = radius = drift = ratio = math.nan
    last = int(np.flatnonzero(run.delta >= 0.9 * run.delta.max())[-1])
    if run.psi[last] >= 1.5 * math.pi:
        begin = max(run.psi[last] - 2.0 * math.pi, math.pi)
        part = slice(int(np.argmax(run.psi >= begin)), last + 1)
        u, v = np.mean(run.u[part]), np.mean(run.v[part])
        r = (run.psi[last] - run.psi[part][0]) / (run.t[last] - run.t[part][0])
        speed = math.hypot(u, v)
        rate, radius, ratio = r * length / speed, speed / r / length, speed / approach
        drift = math.atan2(-v, u)
    return Turning(
        side, x(t_90) / length, y(t_90) / length, y(t_180) / length, rate, radius, drift, ratio
    )


class Zigzag(NamedTuple):
    """Indices of a zigzag."""

    side: int  # of the first helm: 1 starboard, -1 port
    overshoots: tuple[float, ...]  # largest heading beyond the switch after each reversal, rad
    executes: tuple[float, ...]  # times of all helm orders, s from the first


def zigzag_indices(track, switch, origin=None, heading=None):
    """Return the indices of a zigzag, from its approach or first order.

    ``switch`` is the change of heading at which the helm is reversed, rad; the second number of
    "20/10". ``origin`` (s) and ``heading`` (rad): see :meth:`Track.begun`.
    """
    side, run = to_starboard(track.begun(origin, heading), switch)
    executes, overshoots = [0.0], []
    psi, t = run.psi, run.t
    while (time := crossing(t, psi, switch)) is not None:
        executes.append(time)
        after = t >= time
        psi, t = psi[after], t[after]
        other = np.flatnonzero(psi <= -switch)
        swing = psi[: other[0]] if other.size else psi
        top = int(np.argmax(swing))
        # the track may end before the peak
        if other.size or swing[-1] < swing[top] - 0.05 * switch:
            overshoots.append(float(swing[top] - switch))
        psi = -psi
    return Zigzag(side, tuple(overshoots), tuple(executes))


def turning_circle(vessel, angle, n, speed=None, dt=None):
    """Simulate a turning circle up to a change of heading of 720 degrees, and return its track.

    ``angle`` is that of the helm, rad, positive to starboard, ``n`` the constant shaft speed,
    rev/s. ``speed`` is that of the approach, m/s, by default :meth:`Vessel.straight_speed`. ``dt``
    is by default the time to sail 1/200 of a length, at most 0.05 s for 7 m, scaled with its root.
    """
    return sail(vessel, [turn_program(angle)], n, speed, dt)[0]


def zigzag(vessel, switch, helm, n, speed=None, overshoots=4, dt=None):
    """Simulate a zigzag; options as for :func:`turning_circle`.

    The helm (rad, with the sign of the first order) is reversed at each change of heading of
    ``switch`` (rad).
    """
    return sail(vessel, [zigzag_program(switch, helm, overshoots)], n, speed, dt)[0]


class StandardTrials(NamedTuple):
    """Indices of standard trials, to starboard and to port."""

    turning: list[Turning]  # with 35 degrees of helm, or the largest possible
    zigzag_10: list[Zigzag]
    zigzag_20: list[Zigzag]


def standard_trials(vessel, n, speed=None, dt=None):
    """Simulate turning circles, 10/10 and 20/20 zigzags; options as for :func:`turning_circle`."""
    circle, ten, twenty = min(math.radians(35.0), vessel.helm_max), *np.radians([10.0, 20.0])
    programs = [turn_program(sign * circle) for sign in (1.0, -1.0)]
    for angle in (ten, twenty):
        programs += [zigzag_program(angle, sign * angle, 2) for sign in (1.0, -1.0)]
    tracks, length = sail(vessel, programs, n, speed, dt), vessel.values["length_waterline"]
    return StandardTrials(
        [turning_indices(track, length, origin=0.0) for track in tracks[:2]],
        [zigzag_indices(track, ten, origin=0.0) for track in tracks[2:4]],
        [zigzag_indices(track, twenty, origin=0.0) for track in tracks[4:]],
    )


def turn_program(angle):
    """Take the true state, and yield the next helm angle, as :func:`zigzag_program` does."""
    state = yield angle
    while abs(state[fr.PSI]) < 4.0 * math.pi:
        state = yield angle


def zigzag_program(switch, helm, overshoots):
    side, angle = math.copysign(1.0, helm), helm
    state = yield angle
    for _ in range(overshoots):
        while side * state[fr.PSI] < switch:
            state = yield angle
        side, angle = -side, -angle
    # the last overshoot is over when the heading is 0 again
    while side * state[fr.PSI] < 0.0:
        state = yield angle


def sail(vessel, programs, n, speed, dt):
    """Return the tracks of boats, each until its helm program ends.

    They begin with the order, at full speed along x, with the ordered helm angle.
    """
    speed = vessel.straight_speed(n) if speed is None else speed
    length, count = vessel.values["length_waterline"], len(programs)
    if dt is None:  # orders are late by up to a step
        dt = min(0.005 * length / speed, 0.05 * math.sqrt(length / 7.0))
    calm, exact = SeaState.named("calm"), SensorSuite.perfect()
    simulation = Simulation(count, vessel, calm, suite=exact, dt=dt, dt_physics=dt)
    simulation.reset(range(count), [np.random.default_rng(0) for _ in range(count)])
    state = simulation.state
    state[:, fr.U] = speed
    state[:, [fr.N_LEFT, fr.N_RIGHT]] = n
    angles = np.array([next(program) for program in programs])
    states, orders = [state.copy()], [np.zeros(count)]
    ends, active = [0] * count, dict(enumerate(programs))
    while active:
        if len(states) * dt * speed > LONGEST_LENGTHS * length:
            raise ValueError(
                f"{vessel.name}: a trial is not done in the time to sail {LONGEST_LENGTHS:g} "
                f"lengths ({len(states) * dt:.0f} s)"
            )
        simulation.step(vessel.command(n, angles))
        states.append(state.copy())
        orders.append(angles.copy())
        for i, program in list(active.items()):
            try:
                angles[i] = program.send(state[i])
            except StopIteration:
                ends[i] = len(states)
                del active[i]
    states, orders = np.array(states), np.array(orders)
    columns = {"x": fr.X, "y": fr.Y, "psi": fr.PSI, "u": fr.U, "v": fr.V, "r": fr.R}
    return [
        Track(
            t=dt * np.arange(end),
            delta=orders[:end, i],
            **{name: states[:end, i, k] for name, k in columns.items()},
        )
        for i, end in enumerate(ends)
    ]
