"""Tracks: the motion of one ship over time, simulated or recorded."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import savgol_filter

from usv_kernel.errors import UsvTwinError

__all__ = [
    "Track",
    "TrackError",
    "crossing",
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

    def smoothed(self, window: float) -> Track:
        """Return the track at even times, smoothed by parabolas over a window (s).

        For noisy records, whose extremes are too large and whose slopes are noise. The time to
        sail one or two ship lengths hardly changes the manoeuvre.

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
