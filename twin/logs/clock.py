"""A logger's clock that was not set, or set while it ran: back, or forward, as a gap."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from twin.logs.columns import Array
from twin.logs.signals import ENOUGH, white_noise

__all__ = [
    "GAP_STEPS",
    "HOUR_S",
    "MONTH_S",
    "hours_of",
    "order_remedy",
    "run_on",
    "set_back",
    "set_back_remedy",
    "spread",
    "stood_in_gap",
    "wild_stamps",
]

HOUR_S = 3600.0

MONTH_S = 30.0 * 86400.0
"""A clock that is farther off was not set."""

GAP_STEPS = 5.0
"""A longer step of time is a gap, in median steps."""

SORT = "sort the rows by time"
"""The remedy for single rows out of order."""

_SHORT = 0.5
"""A clock is set back by less than this share of the rows' time before; by more, a log starts
again, or its sensors stand one after the other."""

_DENSE = 1.5
"""Sorted rows around a step of the clock are so many times as dense as others: it is twice."""

_LEAPS = 1.01
"""A boat whose way grows by this factor when rows are sorted leaps about."""

_SPEED_TIME = 3.0
"""A boat's speed beside a gap is that over so many seconds."""

_STOOD = 0.5
_SEEN = 6.0
"""Across a gap, a boat went less than this share of the way at its speed, and the way is so many
times the noise of a fix."""


def wild_stamps(stamps: Array) -> npt.NDArray[np.bool_]:
    """Return which stamps (N,), s, are no times of their log.

    They lie more than a month and the whole log from most others. Or they are few, the clock goes
    on after them as if they were not there, and where they stand no row is missing.
    """
    wild = np.zeros(len(stamps), dtype=np.bool_)
    rows = np.flatnonzero(np.isfinite(stamps))
    if len(rows) < 3 * ENOUGH:
        return wild
    t = stamps[rows]
    typical = float(np.median(np.abs(np.diff(t))))
    wild[rows] = np.abs(t - np.sort(t)[len(t) // 2]) > max(MONTH_S, len(t) * typical)
    rows = rows[~wild[rows]]
    t = stamps[rows]
    step, order = np.diff(t), np.sort(t)
    odd = np.flatnonzero((step < 0.0) | (step > GAP_STEPS * typical))
    edges = [-1, *odd.tolist(), len(step)]
    for last, k, end, next_one in zip(edges, edges[1:], edges[2:], edges[3:], strict=False):
        piece = t[k + 1 : end + 1]
        few = ENOUGH * len(piece) <= min(k - last, next_one - end)
        there_and_back = (step[k] < 0.0) != (step[end] < 0.0)
        passed = t[end + 1] - t[k] - typical * (len(piece) + 1)
        if few and there_and_back and abs(passed) < GAP_STEPS * typical:
            before = int(np.searchsorted(order, piece.min()))
            after = int(np.searchsorted(order, piece.max(), "right"))
            place = order[max(before - 1, 0) : after + 1]
            fills = len(place) == len(piece) + 2 and np.ptp(place) > typical * (len(piece) + 0.5)
            wild[rows[k + 1 : end + 1]] = not fills
    return wild


def spread(stamps: Array) -> Array | None:
    """Return times (N,), s, of rows some of which share a stamp, apart within what it counts.

    None where there are none, where times go back, where no stamp is missing beside most that are
    shared, or where most rows share theirs: a clock that is too coarse tells no times.
    """
    step = np.diff(stamps)
    if not (step >= 0.0).all() or (step > 0.0).all():
        return None
    unit = float(step[step > 0.0].min(initial=math.inf))
    if not 0.0 < np.median(step) < 1.5 * unit < math.inf:
        return None
    whole = float(np.median(step)) == round(float(np.median(step)))
    if not whole and (step == 0.0).sum() < 2:  # one may be a slip of another kind
        return None
    group = np.cumsum(np.append(False, step > 0.0))
    size, first = np.bincount(group), np.searchsorted(group, np.arange(group[-1] + 1))
    place = np.arange(len(group)) - first[group]
    missing = np.concatenate([[False], step[step > 0.0] > 1.5 * unit, [False]])
    if (missing[1:] | missing[:-1])[size > 1].mean() < 0.5:
        return None
    return np.asarray(stamps + unit * place / size[group])


def hours_of(seconds: float, typical: float) -> float:
    """Return the whole hours, s, by which a clock was set; 0 where it is no such step."""
    hours = HOUR_S * round(abs(seconds) / HOUR_S)
    return hours if abs(abs(seconds) - hours) < GAP_STEPS * typical else 0.0


def set_back(stamps: Array, motion: Array | None = None) -> list[tuple[int, float]]:
    """Return where a clock was set back, as rows and seconds; none where rows are out of order.

    Parameters
    ----------
    stamps : ndarray, shape (N,)
        Time as the file has it, s; NaN where it is empty.
    motion : ndarray, shape (N, 3), optional
        Positions, m, and headings, rad. Where they go on across the step, no time passed.
    """
    rows = np.flatnonzero(np.isfinite(stamps))
    t = stamps[rows]
    step = np.diff(t)
    back = np.flatnonzero(step < 0.0)
    if not len(back):
        return []
    edges = np.concatenate(([0], back + 1, [len(t)]))
    if np.diff(edges).min() < ENOUGH:
        return []
    typical = float(np.median(step[step >= 0.0]))
    found = []
    for begin, k, end in zip(edges[:-2], back, edges[2:], strict=True):
        overlap = float(t[k] - t[k + 1])
        hours = hours_of(typical + overlap, typical)
        rows_in = np.sum(t[begin : k + 1] >= t[k + 1]) + np.sum(t[k + 1 : end] <= t[k])
        again = overlap > _SHORT * (t[k] - t[begin])
        far = overlap > GAP_STEPS * typical
        goes_on = far and motion is not None and _goes_on(motion, rows, int(k))
        # rows that are only shuffled stand as close there as anywhere
        if not (hours or goes_on) and (again or rows_in < _DENSE * (overlap / typical + 1.0)):
            return []
        found.append((int(rows[k + 1]), hours or typical + overlap))
    return found


def _goes_on(motion: Array, rows: npt.NDArray[np.intp], k: int) -> bool:
    """Return whether position and heading go on after the k-th row as they do elsewhere."""
    for columns in (motion[rows, :2], motion[rows, 2:]):
        known = np.asarray(np.isfinite(columns).all(axis=1))
        before, after = known[: k + 1].nonzero()[0], known[k + 1 :].nonzero()[0]
        if min(len(before), len(after)) < ENOUGH:
            return False
        seen = columns[known]
        steps = np.hypot.reduce(np.diff(seen, axis=0), axis=1)
        if columns.shape[1] == 1:
            steps = np.abs(np.remainder(steps + math.pi, 2.0 * math.pi) - math.pi)
        if steps[len(before) - 1] > GAP_STEPS * np.median(steps[steps > 0.0]):
            return False
    return True


def run_on(stamps: Array, motion: Array | None = None) -> Array:
    """Return stamps (N,), s, as of a clock that was not set back; see :func:`set_back`."""
    mended = np.array(stamps, dtype=np.float64)
    for row, seconds in set_back(stamps, motion):
        mended[row:] += seconds
    return mended


def set_back_remedy(stamps: Array, motion: Array | None = None) -> str:
    """Return what to do about stamps (N,), s, that go back; see :func:`set_back`."""
    steps = set_back(stamps, motion)
    if not steps:
        return order_remedy(stamps, motion)
    more = ", and so on at each such step" if len(steps) > 1 else ""
    return f"the clock was set back: add {steps[0][1]:.6g} s to all stamps from there on{more}"


def order_remedy(stamps: Array, motion: Array | None) -> str:
    """Return what to do about rows out of order; see :func:`set_back`.

    To sort them is tried: the ways of position and heading from row to row must not grow by it.
    """
    if motion is None:
        return SORT
    grown = 1.0
    for columns in (motion[:, :2], np.exp(1j * motion[:, 2:])):
        known = np.isfinite(columns).all(axis=1) & np.isfinite(stamps)
        written, order = columns[known], np.argsort(stamps[known], kind="stable")
        twice = np.diff(stamps[known][order]) == 0.0
        ways = [np.abs(np.diff(each, axis=0)).sum() for each in (written, written[order])]
        grown *= ways[1] / ways[0] if ways[0] > 0.0 else 1.0
    if grown > _LEAPS or twice.any():
        return "cut the log where time goes back: in the order of its times the boat leaps about"
    return SORT


def stood_in_gap(t: Array, fix: Array, start: float, end: float) -> bool:
    """Return whether a boat that goes before and after a gap in time did not move in it.

    Parameters
    ----------
    t, fix : ndarray, shape (N,) and (N, 2)
        Times, s, and positions, m.
    start, end : float
        Of the gap, s.
    """
    before = np.flatnonzero((t <= start) & (t > start - _SPEED_TIME))
    after = np.flatnonzero((t >= end) & (t < end + _SPEED_TIME))
    if min(len(before), len(after)) < 2 or len(t) < ENOUGH:
        return False
    speeds = [
        float(np.hypot(*(fix[rows[-1]] - fix[rows[0]]))) / float(t[rows[-1]] - t[rows[0]])
        for rows in (before, after)
    ]
    way = min(speeds) * (end - start)
    gone = float(np.hypot(*(fix[after[0]] - fix[before[-1]])))
    noise = math.hypot(*(white_noise(t, column) for column in fix.T))
    return way > _SEEN * noise and gone < _STOOD * way
