"""Manoeuvring indices of any track, simulated or recorded, and what IMO asks of them.

Lengths are in ship lengths (the ``length`` that is handed in; between perpendiculars for IMO),
rates of turn in ``r L / U`` with the momentary speed U, times in s, angles in rad. A turn to port
is mirrored first: advance, transfer, diameter, rate and drift of a sound turn are positive either
way, and ``side`` says which way it was.

Where a manoeuvre begins: ``origin`` is the time of the order. Without it the first motion of the
helm counts; if the track holds the helm as it was, that is later by the steering gear's delay.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import savgol_filter

from usv_kernel.errors import UsvTwinError

__all__ = [
    "Criterion",
    "PullOut",
    "Spiral",
    "Stopping",
    "Track",
    "TrackError",
    "Turning",
    "Zigzag",
    "imo",
    "pull_out",
    "spiral",
    "stopping",
    "turning",
    "zigzag",
]


class TrackError(UsvTwinError):
    """A track that does not hold what is asked of it; the message names what is missing."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """Motion of one ship over time.

    Parameters
    ----------
    t : array_like, shape (N,)
        Times, s; rising, not necessarily evenly.
    x, y : array_like, shape (N,)
        Position to north and east (or along and to starboard of any fixed line), m.
    psi : array_like, shape (N,)
        Heading, rad; jumps by whole turns are taken out.
    u, v, r : array_like, shape (N,), optional
        Velocity ahead and to starboard (m/s) and rate of turn (rad/s); by default the slopes
        of position and heading.
    delta : array_like, shape (N,), optional
        Angle of the helm, as it was or as ordered, rad; positive turns to starboard.
    """

    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    psi: np.ndarray
    u: np.ndarray | None = None
    v: np.ndarray | None = None
    r: np.ndarray | None = None
    delta: np.ndarray | None = None

    def __post_init__(self) -> None:
        size = np.size(self.t)
        if size < 2:
            raise TrackError(f"a track needs 2 samples or more, got {size}")
        for name, values in self._given().items():
            column = np.asarray(values, dtype=float)
            if column.shape != (size,):
                raise TrackError(f"{name} has shape {column.shape}, but t has {size} samples")
            bad = np.flatnonzero(~np.isfinite(column))
            if bad.size:
                raise TrackError(f"{name} is not finite at sample {bad[0]}; drop such samples")
            object.__setattr__(self, name, np.unwrap(column) if name == "psi" else column)
        late = np.flatnonzero(np.diff(self.t) <= 0.0)
        if late.size:
            raise TrackError(
                f"times must rise, but after {self.t[late[0]]:g} s comes {self.t[late[0] + 1]:g} s"
            )

    def _given(self) -> dict[str, np.ndarray]:
        """Return the columns that the track has, by name."""
        columns = {item.name: getattr(self, item.name) for item in dataclasses.fields(self)}
        return {name: values for name, values in columns.items() if values is not None}

    @cached_property
    def motion(self) -> np.ndarray:
        """Velocity ahead, to starboard (m/s) and rate of turn (rad/s), shape (3, N)."""
        north, east = np.gradient(self.x, self.t), np.gradient(self.y, self.t)
        c, s = np.cos(self.psi), np.sin(self.psi)
        derived = c * north + s * east, c * east - s * north, np.gradient(self.psi, self.t)
        given = self.u, self.v, self.r
        return np.array([d if g is None else g for d, g in zip(derived, given, strict=True)])

    @cached_property
    def speed(self) -> np.ndarray:
        """Speed, m/s, shape (N,)."""
        return np.hypot(self.motion[0], self.motion[1])

    @cached_property
    def travelled(self) -> np.ndarray:
        """Distance along the path from the first sample, m, shape (N,)."""
        steps = 0.5 * (self.speed[1:] + self.speed[:-1]) * np.diff(self.t)
        return np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def helm(self) -> np.ndarray:
        """Angle of the helm, rad, shape (N,); an error where it was not recorded."""
        if self.delta is None:
            raise TrackError("the track has no helm angle (delta): give the time of the order")
        return self.delta

    def mirrored(self) -> Track:
        """Return the track with port and starboard exchanged."""
        odd = ("y", "psi", "v", "r", "delta")
        given = self._given()
        return Track(**{name: -a if name in odd else a for name, a in given.items()})

    def between(self, start: float, end: float = math.inf) -> Track:
        """Return the part from one time to another (s), a sample at the start included."""
        if not self.t[0] <= start < self.t[-1]:
            raise TrackError(
                f"{start:g} s is not inside the track, which is from {self.t[0]:g} s to "
                f"{self.t[-1]:g} s"
            )
        t = np.concatenate([[start], self.t[(self.t > start) & (self.t <= end)]])
        return self._at(t)

    def smoothed(self, window: float) -> Track:
        """Return the track on even times, with parabolas fitted over a window (s).

        For noisy records: the largest heading of a noisy track is too large, and slopes of noisy
        positions are noise. A window of a ship length or two leaves the manoeuvre as it is.

        Source: Savitzky and Golay 1964.
        """
        dt = float(np.median(np.diff(self.t)))
        even = self._at(np.arange(self.t[0], self.t[-1] + 1e-9 * dt, dt))
        width = 2 * round(0.5 * window / dt) + 1
        if not 5 <= width <= even.t.size:
            raise TrackError(
                f"window = {window:g} s must span 5 samples or more (of {dt:g} s each) and no "
                "more than the track"
            )
        columns = even._given()
        t = columns.pop("t")
        smooth = {name: savgol_filter(values, width, 2) for name, values in columns.items()}
        return Track(t=t, **smooth)

    def helm_moves(self) -> float:
        """Return when the helm first moves, s: its way from 10 to 20 % of its range, drawn back."""
        away = np.abs(self.helm - self.helm[0])
        low, high = (_reached(self.t, away, share * away.max()) for share in (0.1, 0.2))
        if low is None or high is None or away.max() == 0.0:
            raise TrackError("the helm never moves: give the time of the order")
        return float(max(self.t[0], 2.0 * low - high))

    def begun(self, origin: float | None = None, heading: float | None = None) -> Track:
        """Return the manoeuvre: from its origin on, seen along the approach.

        Parameters
        ----------
        origin : float, optional
            Time of the order, s; by default the first motion of the helm.
        heading : float, optional
            Heading of the approach, rad; by default the mean up to the origin.

        Returns
        -------
        Track
            t, x, y from 0 at the origin; x and psi from the heading of the approach.
        """
        start = self.helm_moves() if origin is None else origin
        run = self.between(start)
        if heading is None:
            base = float(np.mean(self.psi[self.t <= start]))
        else:
            base = heading + 2.0 * math.pi * round((run.psi[0] - heading) / (2.0 * math.pi))
        x, y, c, s = run.x - run.x[0], run.y - run.y[0], math.cos(base), math.sin(base)
        return dataclasses.replace(
            run, t=run.t - start, x=c * x + s * y, y=c * y - s * x, psi=run.psi - base
        )

    def _at(self, t: np.ndarray) -> Track:
        columns = self._given()
        return Track(**{name: np.interp(t, self.t, values) for name, values in columns.items()})


@dataclass(frozen=True, kw_only=True)
class Turning:
    """Indices of a turning circle; nan where the track ends too soon for the steady turn."""

    side: int
    """1 to starboard, -1 to port."""
    advance: float
    """Way along the approach until the heading has changed by 90 degrees, lengths."""
    transfer: float
    """Way across the approach until then, lengths."""
    tactical_diameter: float
    """Way across the approach until the heading has changed by 180 degrees, lengths."""
    time_90: float
    """Time to a change of heading by 90 degrees, s."""
    time_180: float
    """Time to a change of heading by 180 degrees, s."""
    rate: float
    """Rate of the steady turn, r L / U."""
    radius: float
    """Radius of the steady turn, lengths."""
    drift: float
    """Drift angle of the steady turn, rad; positive with the bow inside the circle."""
    speed_ratio: float
    """Speed of the steady turn over that of the approach."""


@dataclass(frozen=True, kw_only=True)
class Zigzag:
    """Indices of a zigzag."""

    side: int
    """Side of the first helm: 1 starboard, -1 port."""
    switch: float
    """Change of heading at which the helm was reversed, rad."""
    overshoots: tuple[float, ...]
    """How far the heading went beyond it each time, rad."""
    executes: tuple[float, ...]
    """Times of the helm orders, the first included, s from the first."""
    checks: tuple[float, ...]
    """Time from each reversal until the yaw is checked (largest heading), s."""
    initial_turning_time: float
    """Time from the first to the second order, s."""
    initial_turning_distance: float
    """Distance along the path between them, lengths."""
    period: float
    """Time from the second to the fourth order, s; nan where there is no fourth."""


@dataclass(frozen=True, kw_only=True)
class PullOut:
    """Indices of two pull-outs, out of a turn to either side."""

    starboard: float
    """Rate that remains after a turn to starboard, r L / U; positive to starboard."""
    port: float
    """Rate that remains after a turn to port, r L / U; positive to starboard."""
    stable: bool
    """Whether both are the same within :data:`RESIDUAL`: the ship holds a straight line."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Spiral:
    """Indices of a direct spiral."""

    falling: np.ndarray
    """Helm angle (rad) and steady rate (r L / U) from starboard to port, shape (2, K)."""
    rising: np.ndarray
    """The same from port to starboard."""
    height: float
    """Rate on the falling less that on the rising branch at helm 0: 0 if no loop, r L / U."""
    width: float
    """Helm angle between the zeros of the two branches, rad: known to a step of the helm."""


@dataclass(frozen=True, kw_only=True)
class Stopping:
    """Indices of a stopping trial."""

    track_reach: float
    """Distance along the path until the ship moves ahead no more, lengths."""
    head_reach: float
    """Way along the approach until then, lengths."""
    side_reach: float
    """Way across the approach until then, lengths; positive to starboard."""
    time: float
    """Time until then, s."""


@dataclass(frozen=True)
class Criterion:
    """One row of IMO's list: ``name``, ``value``, ``limit``, ``unit`` and ``ok``.

    Printed, it says it in a line, angles in degrees.
    """

    name: str
    """What is asked."""
    value: float
    """The worst of the runs that were handed in."""
    limit: float
    """The most that is allowed."""
    unit: str
    """``L`` (ship lengths) or ``rad``."""

    @property
    def ok(self) -> bool:
        """Whether it is met."""
        return self.value <= self.limit

    def __str__(self) -> str:
        scale, unit = (180.0 / math.pi, "deg") if self.unit == "rad" else (1.0, self.unit)
        result = "ok" if self.ok else "not met"
        value, limit = scale * self.value, scale * self.limit
        return f"{self.name} {value:.2f} {unit}, at most {limit:.2f} {unit}: {result}"


RESIDUAL = 0.02
"""Difference of the two residual rates (r L / U) below which a ship counts as stable."""

STILL = math.radians(0.25)
"""Most that the helm wanders while a spiral holds it, rad."""


def turning(
    track: Track,
    *,
    length: float,
    origin: float | None = None,
    heading: float | None = None,
    speed: float | None = None,
) -> Turning:
    """Return the indices of a turning circle.

    Parameters
    ----------
    track : Track
        From the approach, or the order, to a change of heading of 180 degrees or more; the
        steady turn needs 270 and is the mean over the last full circle after 180. A pull-out
        that follows does not count where the helm is known; else cut it off.
    length : float
        Ship length, m.
    origin, heading : float, optional
        Time of the order (s) and heading of the approach (rad): see :meth:`Track.begun`.
    speed : float, optional
        Speed of the approach, m/s; by default the mean up to the origin.

    Source: IMO MSC/Circ.1053, 2.1; ITTC 7.5-04-02-01.
    """
    run = track.begun(origin, heading)
    approach = _approach_speed(track, run, origin) if speed is None else speed
    side, run = _to_starboard(run, 0.5 * math.pi, "no advance")
    t_90 = _reached(run.t, run.psi, 0.5 * math.pi)
    t_180 = _reached(run.t, run.psi, math.pi)
    if t_90 is None or t_180 is None:
        raise TrackError(
            f"the heading changed by {math.degrees(run.psi.max()):.3g} degrees at most, it never "
            "reached 180 degrees: no tactical diameter"
        )
    x, y = (lambda time, a=a: float(np.interp(time, run.t, a)) for a in (run.x, run.y))
    rate = radius = drift = ratio = math.nan
    last = len(run.t) - 1
    if run.delta is not None:
        last = int(np.flatnonzero(run.delta >= 0.9 * run.delta.max())[-1])
    if run.psi[last] >= 1.5 * math.pi:
        begin = max(run.psi[last] - 2.0 * math.pi, math.pi)
        part = slice(int(np.argmax(run.psi >= begin)), last + 1)
        u, v, _ = np.mean(run.motion[:, part], axis=1)
        r = (run.psi[last] - run.psi[part][0]) / (run.t[last] - run.t[part][0])
        U = math.hypot(u, v)
        rate, radius, ratio = float(r * length / U), float(U / r / length), U / approach
        drift = math.atan2(-v, u)
    return Turning(
        side=side,
        advance=x(t_90) / length,
        transfer=y(t_90) / length,
        tactical_diameter=y(t_180) / length,
        time_90=t_90,
        time_180=t_180,
        rate=rate,
        radius=radius,
        drift=drift,
        speed_ratio=ratio,
    )


def zigzag(
    track: Track,
    *,
    length: float,
    switch: float,
    origin: float | None = None,
    heading: float | None = None,
) -> Zigzag:
    """Return the indices of a zigzag.

    Parameters
    ----------
    track : Track
        From the approach, or the first order.
    length : float
        Ship length, m.
    switch : float
        Change of heading at which the helm is reversed, rad; 10 degrees of a 20/10 zigzag.
    origin, heading : float, optional
        Time of the first order (s) and heading of the approach (rad): see :meth:`Track.begun`.

    Source: IMO MSC/Circ.1053, 2.2; ITTC 7.5-04-02-01.
    """
    if not switch > 0.0:
        raise TrackError(f"switch = {switch:g} rad must be above 0")
    side, run = _to_starboard(track.begun(origin, heading), switch, "no zigzag")
    executes, overshoots, checks = [0.0], [], []
    psi, t = run.psi, run.t
    while (time := _reached(t, psi, switch)) is not None:
        executes.append(time)
        # from here to the reversal on the other side
        after = t >= time
        psi, t = psi[after], t[after]
        other = np.flatnonzero(psi <= -switch)
        swing = psi[: other[0]] if other.size else psi
        top = int(np.argmax(swing))
        # a track that ends before the heading comes back has not shown its peak
        if other.size or swing[-1] < swing[top] - 0.05 * switch:
            overshoots.append(float(swing[top] - switch))
            checks.append(float(t[top] - time))
        psi = -psi
    return Zigzag(
        side=side,
        switch=switch,
        overshoots=tuple(overshoots),
        executes=tuple(executes),
        checks=tuple(checks),
        initial_turning_time=executes[1],
        initial_turning_distance=float(np.interp(executes[1], run.t, run.travelled)) / length,
        period=executes[3] - executes[1] if len(executes) > 3 else math.nan,
    )


def pull_out(
    starboard: Track, port: Track, *, length: float, releases: Sequence[float] = ()
) -> PullOut:
    """Return the rates that remain when the helm is put back after a turn to either side.

    Parameters
    ----------
    starboard, port : Track
        The two runs, each from the turn to the end of the pull-out.
    length : float
        Ship length, m.
    releases : sequence of float, optional
        When the helm was put back in either run, s; by default seen in the helm. The rate is
        the mean over the last fifth of the time from then on.

    Source: IMO MSC/Circ.1053, 2.3.
    """
    residuals = []
    for k, track in enumerate((starboard, port)):
        if releases:
            release = releases[k]
        else:
            away = np.abs(track.helm - track.helm[-1])
            release = float(track.t[np.flatnonzero(away >= 0.5 * away.max())[-1]])
        residuals.append(_last_rate(track.between(release), length))
    return PullOut(
        starboard=residuals[0],
        port=residuals[1],
        stable=abs(residuals[0] - residuals[1]) <= RESIDUAL,
    )


def spiral(track: Track, *, length: float) -> Spiral:
    """Return the indices of Dieudonne's direct spiral.

    Parameters
    ----------
    track : Track
        Helm held at one angle after the other from one side to the other and back, each until
        the rate is steady; the rate is the mean over the last fifth of each hold. The helm may
        wander by :data:`STILL`.
    length : float
        Ship length, m.

    Source: IMO MSC/Circ.1053, 2.4.
    """
    helm, begin, holds = track.helm, 0, []
    for k in range(1, len(helm) + 1):
        if k < len(helm) and abs(helm[k] - helm[begin]) <= STILL:
            continue
        # shorter than it takes to sail a length: the helm on its way
        if track.travelled[k - 1] - track.travelled[begin] > length:
            part = track.between(track.t[begin], track.t[k - 1])
            holds.append((float(np.median(helm[begin:k])), _last_rate(part, length)))
        begin = k
    levels = np.array(holds).T
    if len(holds) < 3 or not levels[0].min() < 0.0 < levels[0].max():
        raise TrackError(
            f"a spiral needs holds of the helm on either side, there and back; found {len(holds)}"
        )
    falls = levels[0, 0] > 0.0
    far = int(np.argmin(levels[0]) if falls else np.argmax(levels[0]))
    branches = levels[:, : far + 1], levels[:, far:]
    falling, rising = branches if falls else branches[::-1]
    falling, rising = (b[:, np.argsort(b[0], kind="stable")] for b in (falling, rising))
    heights, zeros = [], []
    for name, (angle, rate) in (("falling", falling), ("rising", rising)):
        if not (angle[0] < 0.0 < angle[-1] and rate[0] < 0.0 < rate[-1]):
            raise TrackError(f"the {name} helm does not take the ship from one side to the other")
        heights.append(float(np.interp(0.0, angle, rate)))
        k = int(np.argmax(rate > 0.0))
        share = rate[k - 1] / (rate[k - 1] - rate[k])
        zeros.append(float(angle[k - 1] + share * (angle[k] - angle[k - 1])))
    return Spiral(
        falling=falling[:, ::-1],
        rising=rising,
        height=heights[0] - heights[1],
        width=zeros[1] - zeros[0],
    )


def stopping(
    track: Track, *, length: float, origin: float | None = None, heading: float | None = None
) -> Stopping:
    """Return the indices of a stopping trial.

    Parameters
    ----------
    track : Track
        Until the ship moves ahead no more.
    length : float
        Ship length, m.
    origin : float, optional
        Time of the order, s; by default the first sample.
    heading : float, optional
        Heading of the approach, rad: see :meth:`Track.begun`.

    Source: IMO MSC/Circ.1053, 2.5.
    """
    run = track.begun(float(track.t[0]) if origin is None else origin, heading)
    time = _reached(run.t, -run.motion[0], 0.0)
    if time is None:
        raise TrackError(f"the ship still moves ahead at {run.motion[0, -1]:.3g} m/s at the end")
    reach = [float(np.interp(time, run.t, a)) / length for a in (run.travelled, run.x, run.y)]
    return Stopping(track_reach=reach[0], head_reach=reach[1], side_reach=reach[2], time=time)


def imo(
    *,
    length: float,
    speed: float,
    turning: Turning | Sequence[Turning] = (),
    zigzag_10: Zigzag | Sequence[Zigzag] = (),
    zigzag_20: Zigzag | Sequence[Zigzag] = (),
    stopping: Stopping | Sequence[Stopping] = (),
) -> list[Criterion]:
    """Return what IMO asks of a ship, as far as the trials were made.

    It is asked of ships of 100 m and more, in deep calm water, loaded, at 90 % or more of the
    speed at 85 % of full power; for others it is a yardstick only.

    Parameters
    ----------
    length : float
        Length between perpendiculars, m.
    speed : float
        Speed of the approach, m/s.
    turning : Turning or sequence of Turning
        Circles at 35 degrees or the largest helm angle; the worst of them counts.
    zigzag_10, zigzag_20 : Zigzag or sequence of Zigzag
        10/10 and 20/20 zigzags.
    stopping : Stopping or sequence of Stopping
        Full astern.

    Source: IMO MSC.137(76), 5.3.
    """
    if not (length > 0.0 and speed > 0.0):
        raise TrackError(f"length = {length:g} m and speed = {speed:g} m/s must be above 0")
    circles = [turning] if isinstance(turning, Turning) else turning
    stops = [stopping] if isinstance(stopping, Stopping) else stopping
    # the limits of the 10/10 zigzag grow with L / U between 10 and 30 s
    seconds = min(max(length / speed, 10.0), 30.0)
    rows = []

    def row(name: str, values: Sequence[float], limit: float, unit: str) -> None:
        if values:
            rows.append(Criterion(name, max(values), limit, unit))

    row("turning: advance", [c.advance for c in circles], 4.5, "L")
    row("turning: tactical diameter", [c.tactical_diameter for c in circles], 5.0, "L")
    tens = _zigzags(zigzag_10, 10.0, 2)
    first, second = math.radians(5.0 + 0.5 * seconds), math.radians(17.5 + 0.75 * seconds)
    row("10/10: initial turning", [z.initial_turning_distance for z in tens], 2.5, "L")
    row("10/10: first overshoot", [z.overshoots[0] for z in tens], first, "rad")
    row("10/10: second overshoot", [z.overshoots[1] for z in tens], second, "rad")
    twenties = _zigzags(zigzag_20, 20.0, 1)
    row("20/20: first overshoot", [z.overshoots[0] for z in twenties], math.radians(25.0), "rad")
    row("stopping: track reach", [s.track_reach for s in stops], 15.0, "L")
    return rows


def _zigzags(runs: Zigzag | Sequence[Zigzag], degrees: float, overshoots: int) -> Sequence[Zigzag]:
    """Return zigzags after a look at their angle and number of overshoots."""
    runs = [runs] if isinstance(runs, Zigzag) else runs
    for run in runs:
        if not math.isclose(run.switch, math.radians(degrees), rel_tol=1e-3):
            raise TrackError(
                f"a zigzag that turns at {math.degrees(run.switch):.3g} degrees cannot stand for "
                f"one at {degrees:g}"
            )
        if len(run.overshoots) < overshoots:
            raise TrackError(
                f"the {degrees:g}/{degrees:g} zigzag shows {len(run.overshoots)} overshoot(s), "
                f"but {overshoots} are needed: record it for longer"
            )
    return runs


def _reached(t: np.ndarray, values: np.ndarray, level: float) -> float | None:
    """Return when values first reach a level, between samples; None if they never do."""
    there = np.flatnonzero(values >= level)
    if not there.size:
        return None
    k = max(int(there[0]), 1)
    low, high = values[k - 1], values[k]
    share = (level - low) / (high - low) if low < level else 0.0
    return float(t[k - 1] + share * (t[k] - t[k - 1]))


def _to_starboard(run: Track, change: float, lacking: str) -> tuple[int, Track]:
    """Return to which side the heading first changes so far, and the run as if to starboard."""
    there = np.flatnonzero(np.abs(run.psi) >= change)
    if not there.size:
        raise TrackError(
            f"the heading changed by {math.degrees(np.abs(run.psi).max()):.3g} degrees at most, "
            f"it never reached {math.degrees(change):.3g} degrees: {lacking}"
        )
    return (1, run) if run.psi[there[0]] > 0.0 else (-1, run.mirrored())


def _approach_speed(track: Track, run: Track, origin: float | None) -> float:
    """Return the mean speed up to the origin, m/s."""
    start = track.helm_moves() if origin is None else origin
    before = track.t <= start
    return float(np.mean(track.speed[before])) if before.any() else float(run.speed[0])


def _last_rate(part: Track, length: float) -> float:
    """Return the mean of r L / U over the last fifth of the time."""
    last = part.t >= part.t[-1] - 0.2 * (part.t[-1] - part.t[0])
    u, v, r = np.mean(part.motion[:, last], axis=1)
    return float(r * length / math.hypot(u, v))
