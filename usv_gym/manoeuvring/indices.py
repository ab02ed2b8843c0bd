"""Tracks of manoeuvres and their indices.

Lengths are in ship lengths (argument ``length``). Rates of turn are
``r L / U`` with the present speed U, times in s, angles in rad. A turn to port is mirrored first,
so that advance, transfer, diameter, rate and drift are positive to either side.

``origin`` is the time of the order. By default it is the first motion of the helm. If the track
holds actual helm angles, that is later by the delay of the steering gear.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from usv_kernel.errors import UsvTwinError

__all__ = [
    "Track",
    "TrackError",
    "Turning",
    "Zigzag",
    "turning",
    "zigzag",
]


class TrackError(UsvTwinError):
    """A track without the data that an index needs; the message names what is missing."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """Motion of one ship over time.

    TrackError: columns of unequal length, numbers that are not finite, or times that do not rise.
    """

    t: np.ndarray  # (N,): times, s; rising, in any steps
    # (N,): position to north and east (or along and to starboard of any fixed line), m
    x: np.ndarray
    y: np.ndarray
    psi: np.ndarray  # (N,): heading, rad; jumps by whole turns are removed
    # (N,): velocity ahead and to starboard (m/s) and rate of turn (rad/s); default from the slopes
    # of position and heading
    u: np.ndarray | None = None
    v: np.ndarray | None = None
    r: np.ndarray | None = None
    # (N,): actual or ordered helm angle, rad; positive turns to starboard
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
        """Return the present columns by name."""
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
        """Helm angle, rad, shape (N,); :class:`TrackError` if it was not recorded."""
        if self.delta is None:
            raise TrackError("the track has no helm angle (delta): give the time of the order")
        return self.delta

    def mirrored(self) -> Track:
        """Return the track with port and starboard exchanged."""
        odd = ("y", "psi", "v", "r", "delta")
        given = self._given()
        return Track(**{name: -a if name in odd else a for name, a in given.items()})

    def between(self, start: float, end: float = math.inf) -> Track:
        """Return the part between two times (s), with a sample at the start."""
        if not self.t[0] <= start < self.t[-1]:
            raise TrackError(
                f"{start:g} s is not inside the track, which is from {self.t[0]:g} s to "
                f"{self.t[-1]:g} s"
            )
        t = np.concatenate([[start], self.t[(self.t > start) & (self.t <= end)]])
        return self._at(t)

    def helm_moves(self) -> float:
        """Return when the helm first moves, s, extrapolated from 10 and 20 % of its range."""
        moved = np.abs(self.helm - self.helm[0])
        low, high = (crossing(self.t, moved, share * moved.max()) for share in (0.1, 0.2))
        if low is None or high is None or moved.max() == 0.0:
            raise TrackError("the helm never moves: give the time of the order")
        return float(max(self.t[0], 2.0 * low - high))

    def begun(self, origin: float | None = None, heading: float | None = None) -> Track:
        """Return the manoeuvre from its origin on, relative to the approach: t, x, y are 0 there.

        ``origin`` is the time of the order, s, by default :meth:`helm_moves`; ``heading`` that of
        the approach, rad, by default the mean up to the origin.
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
        """Return the track interpolated at other times."""
        columns = self._given()
        return Track(**{name: np.interp(t, self.t, values) for name, values in columns.items()})


def crossing(t: np.ndarray, values: np.ndarray, level: float) -> float | None:
    """Return when values first reach a level, by interpolation; None if they never do."""
    above = np.flatnonzero(values >= level)
    if not above.size:
        return None
    k = max(int(above[0]), 1)
    low, high = values[k - 1], values[k]
    share = (level - low) / (high - low) if low < level else 0.0
    return float(t[k - 1] + share * (t[k] - t[k - 1]))


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
