"""Fixes that no boat can reach from the others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin.logs.columns import Array
from twin.logs.signals import ENOUGH, ways

__all__ = ["Jumps", "find_jumps", "rows_that_catch_up"]

_JUMP, _FAST = 50.0, 30.0
"""Between two fixes no boat goes farther than this, m, and this fast, m/s (58 knots)."""

_PIECES = 1000
"""Most pieces between jumps that are joined to a track."""

_TYPICAL = 0.75
"""The typical speed of a boat that goes is this quantile: it may also rest at times."""

_CATCHES_UP, _CATCHES_UP_STEPS = 1.0, 8.0
"""A shorter step catches up with nothing: in m, and in median steps."""

_MOST_STEPS = 1000
"""Most steps that are tried; more are noise."""

_LAST = 9
"""The place where fixes stand still is the median of so many before they catch up."""

_STILL, _STILL_SHARE = 0.1, 0.02
"""Fixes stand still within this, m, or this share of the step that follows ..."""

_STILL_SCATTER, _STILL_MOST = 4.5, 0.1
"""... or, up to this share of the step, within so many median distances from their place: of
Gaussian noise, one fix of a million is outside."""

_LONG, _STANDS = 3.0, ENOUGH // 2
"""Fixes that stand for a shorter time, s, or are fewer, tell nothing."""

_PASSED = (0.3, 3.0)
"""A step catches up if it is as long as the way at the typical speed, times a factor in between."""

_GOES = 0.3
"""A boat goes from this share of its typical speed on."""

_LEAPS = 10.0
"""Fixes beside a stand that go so many times the typical speed leap to a false place and back."""


class Jumps(NamedTuple):
    """Fixes that no boat can reach from the others."""

    lost: npt.NDArray[np.intp]
    """Their rows."""
    fixes: int
    """How many rows hold a fix."""
    before: int
    """Row of the fix before the first jump ..."""
    after: int
    """... and of that after it."""
    length: float
    """Of the first jump, m."""


def find_jumps(t: Array, fix: Array) -> Jumps | None:
    """Return the fixes that no boat can reach from the others, or None where all can be.

    Parameters
    ----------
    t, fix : ndarray, shape (N,) and (N, 2)
        Times, s, and positions, m; NaN in rows without a fix.

    Notes
    -----
    A boat goes on while its fixes stand still. So where they catch up, the way counts from the
    start of the stand.
    """
    rows = np.flatnonzero(np.isfinite(fix).all(axis=1))
    if len(rows) < 2:
        return None
    t, fix = t[rows], fix[rows]
    length = np.hypot(*np.diff(fix, axis=0).T)
    if not (length > _JUMP + _FAST * np.diff(t)).any():
        return None
    known = t.copy()
    for start_of, last in rows_that_catch_up(t, fix):
        known[last] = t[start_of]

    def reached(first: npt.NDArray[np.intp], then: int) -> npt.NDArray[np.bool_]:
        way = np.hypot(*(fix[then] - fix[first]).T)
        return np.asarray(way <= _JUMP + _FAST * (t[then] - known[first]), dtype=np.bool_)

    broken = np.flatnonzero(length > _JUMP + _FAST * (t[1:] - known[:-1]))
    if not len(broken):
        return None
    # The longest chain of pieces, each of which can be reached from the one before.
    start, end = np.append(0, broken + 1), np.append(broken, len(t) - 1)
    kept = (end - start + 1).astype(np.int64)
    before = np.full(len(start), -1)
    if len(start) <= _PIECES:
        for j in range(1, len(start)):
            chain = np.where(reached(end[:j], int(start[j])), kept[:j], 0)
            best = int(np.argmax(chain))
            if chain[best]:
                kept[j], before[j] = kept[j] + chain[best], best
    good = np.zeros(len(t), dtype=np.bool_)
    piece = int(np.argmax(kept))
    while piece >= 0:
        good[start[piece] : end[piece] + 1] = True
        piece = int(before[piece])
    first = int(broken[0])
    return Jumps(
        rows[~good], len(rows), int(rows[first]), int(rows[first + 1]), float(length[first])
    )


def rows_that_catch_up(t: Array, fix: Array) -> list[tuple[int, int]]:
    """Return first and last row of each stretch in which fixes stand still, and then catch up.

    Parameters
    ----------
    t, fix : ndarray, shape (N,) and (N, 2)
        Times, s, and positions, m, of a boat that goes.
    """
    step = np.hypot(*np.diff(fix, axis=0).T)
    way, middle, width = ways(t, fix)
    speed = np.hypot(*way.T) / width
    speed = speed[np.isfinite(speed)]
    if not len(middle) or not len(speed):
        return []
    typical = max(float(np.quantile(speed, _TYPICAL)), 1e-12)
    bound = max(_CATCHES_UP, _CATCHES_UP_STEPS * float(np.median(step)))
    found = []
    for k in np.flatnonzero(step > bound)[:_MOST_STEPS]:
        start = _stood_from(fix[: k + 1], float(step[k]))
        length = float(t[k] - t[start])
        if k - start < _STANDS or length < _LONG:
            continue
        passed = step[k] / (length * typical)
        gone = np.array([_went(t, fix, start, -1), _went(t, fix, int(k) + 1, 1)]) / typical
        goes = (gone > _GOES).all() and (gone < _LEAPS).all()
        if _PASSED[0] < passed < _PASSED[1] and goes:
            found.append((start, int(k)))
    return found


def _stood_from(fix: Array, step: float) -> int:
    """Return from which row fixes (N, 2) stand still until the last, before a step, m."""
    last = fix[-_LAST:]
    place = np.median(last, axis=0)
    scatter = _STILL_SCATTER * float(np.median(np.hypot(*(last - place).T)))
    radius = max(_STILL, _STILL_SHARE * step, min(scatter, _STILL_MOST * step))
    apart = np.flatnonzero(np.hypot(*(fix - place).T) > radius)
    return int(apart[-1]) + 1 if len(apart) else 0


def _went(t: Array, fix: Array, row: int, way: int) -> float:
    """Return the mean speed in the seconds before (way -1) or after (1) a row; 0 if unknown."""
    edge = t[row] + way * _LONG
    other = int(np.searchsorted(t, edge).clip(0, len(t) - 1))
    time = abs(float(t[other] - t[row]))
    return float(np.hypot(*(fix[other] - fix[row]))) / time if time > 0.0 else 0.0
