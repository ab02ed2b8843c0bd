"""Fixes that no boat can reach from the others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin.logs.columns import Array
from twin.logs.signals import ways

__all__ = ["FAST_MPS", "TYPICAL", "Jumps", "find_jumps"]

_JUMP = 50.0
FAST_MPS = 30.0
"""Between two fixes no boat goes farther than this, m, and this fast, m/s (58 knots)."""

_PIECES = 1000
"""Most pieces between jumps that are joined to a track."""

TYPICAL = 0.75
"""The speed of a boat is this quantile: it may also rest at times."""

_STILL_M = 0.1
_STILL_SHARE = 0.02
"""Fixes stand still within this, or this share of the step that follows."""


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
    A boat goes on while its fixes stand still. So where they catch up, the way at the boat's own
    speed counts from the start of the stand.
    """
    rows = np.flatnonzero(np.isfinite(fix).all(axis=1))
    if len(rows) < 2:
        return None
    t, fix = t[rows], fix[rows]
    length = np.hypot(*np.diff(fix, axis=0).T)
    broken = np.flatnonzero(length > _JUMP + FAST_MPS * np.diff(t))
    if not len(broken):
        return None
    way, _, width = ways(t, fix)
    speeds = np.hypot(*way.T)[np.isfinite(way).all(axis=1)] / width
    own = float(np.quantile(speeds, TYPICAL)) if len(speeds) else 0.0
    stood = t.copy()
    for k in broken[:_PIECES]:
        stood[k] = t[_stood_from(fix[: k + 1], float(length[k]))]

    def reached(first: npt.NDArray[np.intp], then: int) -> npt.NDArray[np.bool_]:
        way = np.hypot(*(fix[then] - fix[first]).T)
        most = np.maximum(FAST_MPS * (t[then] - t[first]), own * (t[then] - stood[first]))
        return np.asarray(way <= _JUMP + most, dtype=np.bool_)

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
    if good.all():
        return None
    first = int(broken[~(good[broken] & good[broken + 1])][0])
    return Jumps(
        rows[~good], len(rows), int(rows[first]), int(rows[first + 1]), float(length[first])
    )


def _stood_from(fix: Array, step: float) -> int:
    """Return from which row fixes (N, 2) stand still until the last, before a step, m."""
    radius = max(_STILL_M, _STILL_SHARE * step)
    apart = np.flatnonzero(np.hypot(*(fix - fix[-1]).T) > radius)
    return int(apart[-1]) + 1 if len(apart) else 0
