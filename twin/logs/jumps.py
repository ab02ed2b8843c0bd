"""Fixes that no boat can reach from the others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin.logs.columns import Array

__all__ = ["Jumps", "find_jumps"]

_JUMP, _FAST = 50.0, 30.0
"""Between two fixes no boat goes farther than this, m, and this fast, m/s (58 knots)."""

_PIECES = 1000
"""Most pieces between jumps that are joined to a track."""


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
    A boat goes on while its fixes repeat themselves: the way counts from the first of them.
    """
    rows = np.flatnonzero(np.isfinite(fix).all(axis=1))
    if len(rows) < 2:
        return None
    new = np.append(True, (np.diff(fix[rows], axis=0) != 0.0).any(axis=1))
    group, seen = np.cumsum(new) - 1, rows[new]
    t, fix = t[seen], fix[seen]
    length = np.hypot(*np.diff(fix, axis=0).T)
    if not (length > _JUMP + _FAST * np.diff(t)).any():
        return None

    def reached(first: npt.NDArray[np.intp], then: int) -> npt.NDArray[np.bool_]:
        way = np.hypot(*(fix[then] - fix[first]).T)
        return np.asarray(way <= _JUMP + _FAST * (t[then] - t[first]), dtype=np.bool_)

    broken = np.flatnonzero(length > _JUMP + _FAST * np.diff(t))
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
    lost, last = rows[~good[group]], rows[np.searchsorted(group, first, "right") - 1]
    return Jumps(lost, len(rows), int(last), int(seen[first + 1]), float(length[first]))
