"""Manoeuvring indices of tracks, and the criteria of IMO.

Lengths are in ship lengths (argument ``length``; between perpendiculars for IMO), rates of turn
are ``r L / U`` with the present speed U, times in s, angles in rad. A turn to port is mirrored
first, so that advance, transfer, diameter, rate and drift are positive to either side.

``origin`` is the time of the order. By default it is the first motion of the helm, which is later
by the delay of the steering gear if the track holds actual helm angles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usv_gym.manoeuvring.track import Track, TrackError, crossing

__all__ = [
    "Criterion",
    "PullOut",
    "Spiral",
    "Stopping",
    "Turning",
    "Zigzag",
    "imo",
    "pull_out",
    "spiral",
    "stopping",
    "turning",
    "zigzag",
]


@dataclass(frozen=True, kw_only=True)
class Turning:
    """Indices of a turning circle; those of the steady turn are nan if the track is too short."""

    side: int
    """1 to starboard, -1 to port."""
    advance: float
    """Distance along the approach at a change of heading of 90 degrees, lengths."""
    transfer: float
    """Distance across the approach at 90 degrees, lengths."""
    tactical_diameter: float
    """Distance across the approach at 180 degrees, lengths."""
    time_90: float
    """Time to a change of heading of 90 degrees, s."""
    time_180: float
    """Time to a change of heading of 180 degrees, s."""
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
    """Largest heading beyond ``switch`` after each reversal, rad."""
    executes: tuple[float, ...]
    """Times of all helm orders, s from the first."""
    checks: tuple[float, ...]
    """Time from each reversal to the largest heading, s."""
    initial_turning_time: float
    """Time from the first to the second order, s."""
    initial_turning_distance: float
    """Distance along the path between them, lengths."""
    period: float
    """Time from the second to the fourth order, s; nan without a fourth."""


@dataclass(frozen=True, kw_only=True)
class PullOut:
    """Indices of pull-outs from turns to both sides."""

    starboard: float
    """Residual rate after a turn to starboard, r L / U; positive to starboard."""
    port: float
    """Residual rate after a turn to port, r L / U; positive to starboard."""
    stable: bool
    """Whether both agree within :data:`RESIDUAL`: the ship is course-stable."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Spiral:
    """Indices of a direct spiral."""

    falling: np.ndarray
    """Helm angle (rad) and steady rate (r L / U) from starboard to port, shape (2, K)."""
    rising: np.ndarray
    """The same from port to starboard."""
    height: float
    """Height of the loop at helm 0, r L / U: falling less rising branch."""
    width: float
    """Width of the loop at rate 0, rad; its resolution is a step of the helm."""


@dataclass(frozen=True, kw_only=True)
class Stopping:
    """Indices of a stopping trial."""

    track_reach: float
    """Distance along the path until the ship stops, lengths."""
    head_reach: float
    """Distance along the approach, lengths."""
    side_reach: float
    """Distance across the approach, lengths; positive to starboard."""
    time: float
    """Time until the ship stops, s."""


@dataclass(frozen=True)
class Criterion:
    """One criterion of IMO; ``str`` gives it in one line, with angles in degrees."""

    name: str
    """Manoeuvre and index."""
    value: float
    """Worst of the given runs."""
    limit: float
    """Largest allowed value."""
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
"""Largest difference of the residual rates (r L / U) of a course-stable ship."""

STILL = math.radians(0.25)
"""Largest change of the helm during a hold of a spiral, rad."""


def turning(
    track: Track,
    *,
    length: float,
    origin: float | None = None,
    heading: float | None = None,
    speed: float | None = None,
) -> Turning:
    """Return the indices of a turning circle of a ship of a length (m).

    The track goes from the approach or the order to a change of heading of 180 degrees or more. The
    steady turn needs 270 degrees; it is the mean over the last full circle after 180. A pull-out at
    the end is ignored if the helm is known. ``origin`` (s) and ``heading`` (rad): see
    :meth:`Track.begun`; ``speed`` of the approach, m/s, is by default the mean up to the origin.

    Source: IMO MSC/Circ.1053, 2.1; ITTC 7.5-04-02-01.
    """
    run = track.begun(origin, heading)
    approach = _approach_speed(track, run, origin) if speed is None else speed
    side, run = _to_starboard(run, 0.5 * math.pi, "no advance")
    t_90 = crossing(run.t, run.psi, 0.5 * math.pi)
    t_180 = crossing(run.t, run.psi, math.pi)
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
        u, v = np.mean(run.motion[:2, part], axis=1)
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
    """Return the indices of a zigzag of a ship of a length (m), from its approach or first order.

    ``switch`` is the change of heading at which the helm is reversed, rad; the second number of
    "20/10". ``origin`` (s) and ``heading`` (rad): see :meth:`Track.begun`.

    Source: IMO MSC/Circ.1053, 2.2; ITTC 7.5-04-02-01.
    """
    if not switch > 0.0:
        raise TrackError(f"switch = {switch:g} rad must be above 0")
    side, run = _to_starboard(track.begun(origin, heading), switch, "no zigzag")
    executes, overshoots, checks = [0.0], [], []
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
    """Return the residual rates of a ship of a length (m) after turns to both sides.

    Runs go from the turn to the end of the pull-out. ``releases`` are the times when the helm was
    put back, s, by default from the helm. The rate is the mean over the last fifth of the time
    after.

    Source: IMO MSC/Circ.1053, 2.3.
    """
    residuals = []
    for k, track in enumerate((starboard, port)):
        if releases:
            release = releases[k]
        else:
            moved = np.abs(track.helm - track.helm[-1])
            release = float(track.t[np.flatnonzero(moved >= 0.5 * moved.max())[-1]])
        residuals.append(_last_rate(track.between(release), length))
    return PullOut(
        starboard=residuals[0],
        port=residuals[1],
        stable=abs(residuals[0] - residuals[1]) <= RESIDUAL,
    )


def spiral(track: Track, *, length: float) -> Spiral:
    """Return the indices of Dieudonne's direct spiral of a ship of a length (m).

    The helm is held at successive angles from one side to the other and back, each until the rate
    is steady. The rate is the mean over the last fifth of each hold, during which the helm may
    change by :data:`STILL`.

    Source: IMO MSC/Circ.1053, 2.4.
    """
    helm, begin, holds = track.helm, 0, []
    for k in range(1, len(helm) + 1):
        if k < len(helm) and abs(helm[k] - helm[begin]) <= STILL:
            continue
        # holds shorter than a ship length are helm motion
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
    """Return the indices of a stopping trial of a ship of a length (m), up to the stop.

    ``origin`` is the time of the order, s, by default the first sample; ``heading`` that of the
    approach, rad, see :meth:`Track.begun`.

    Source: IMO MSC/Circ.1053, 2.5.
    """
    run = track.begun(float(track.t[0]) if origin is None else origin, heading)
    time = crossing(run.t, -run.motion[0], 0.0)
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
    """Return the manoeuvring criteria of IMO for the given trials.

    They hold for loaded ships of 100 m and more in deep calm water, at 90 % or more of the speed at
    85 % of full power. ``length`` is between perpendiculars, m; ``speed`` that of the approach,
    m/s. Circles are at 35 degrees or the largest helm angle, zigzags 10/10 and 20/20, stopping is
    full astern; the worst of several counts.

    Source: IMO MSC.137(76), 5.3.
    """
    if not (length > 0.0 and speed > 0.0):
        raise TrackError(f"length = {length:g} m and speed = {speed:g} m/s must be above 0")
    circles = [turning] if isinstance(turning, Turning) else turning
    stops = [stopping] if isinstance(stopping, Stopping) else stopping
    # limits of the 10/10 zigzag rise with L / U between 10 and 30 s
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
    """Check the angle and the number of overshoots of zigzags, and return them."""
    runs = [runs] if isinstance(runs, Zigzag) else runs
    for run in runs:
        if not math.isclose(run.switch, math.radians(degrees), rel_tol=1e-3):
            raise TrackError(
                f"a zigzag that switches at {math.degrees(run.switch):.3g} degrees is not one "
                f"at {degrees:g}"
            )
        if len(run.overshoots) < overshoots:
            raise TrackError(
                f"the {degrees:g}/{degrees:g} zigzag shows {len(run.overshoots)} overshoot(s), "
                f"but {overshoots} are needed: record it for longer"
            )
    return runs


def _to_starboard(run: Track, change: float, lacking: str) -> tuple[int, Track]:
    """Return the side of the first change of heading, and the run mirrored to starboard."""
    beyond = np.flatnonzero(np.abs(run.psi) >= change)
    if not beyond.size:
        raise TrackError(
            f"the heading changed by {math.degrees(np.abs(run.psi).max()):.3g} degrees at most, "
            f"it never reached {math.degrees(change):.3g} degrees: {lacking}"
        )
    return (1, run) if run.psi[beyond[0]] > 0.0 else (-1, run.mirrored())


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
