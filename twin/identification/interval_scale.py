"""Scale of forecast intervals: forecast errors of the past over their claimed variance.

Each segment that is over is forecast again from its first row, with the parameters that were in use
then. A few more forecasts have parameters and velocities moved by one standard deviation, up or
down. The signs are Walsh functions, whose products average to zero over 64 forecasts. So the mean
square of the deviations is the claimed variance. Waves are left out, which makes it too small.
Where the errors were smaller still, the intervals shrink. As the errors are few, their size is
uncertain: the factor is that of Student's t.

Intervals never grow. An error larger than that of parameters and velocities comes from waves, and
these have a model of their own.

Source: docs/explanation/twin.md, Waves and prediction intervals.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from twin.filters.linalg import cholesky
from twin.identification.prediction_error import ACT, GOOD, LOW, MIDDLE, WIND, drive, rk4_step
from twin.model.rollout import GRID
from twin.model.structure import N_STATES
from usv_kernel.arrays import take
from usv_kernel.jit import inlined, kernel

__all__ = [
    "CHANNELS",
    "POINTS",
    "RECORD",
    "RecordWork",
    "compare_segment",
    "factor_ahead",
    "record_work",
]

POINTS = 7
CHANNELS = 5
"""Number of times compared in a segment, evenly apart; and channels: position, heading, u, v, r."""

RECORD = [
    ("compared", "f8"),  # number of segments
    ("share", "f8", (POINTS, CHANNELS)),  # mean squared error over claimed variance
]
"""Fields of the predictor's memory that this module reads and writes."""

MEMORY_SEGMENTS = 30.0
"""Number of segments over which the share is averaged."""

MOVED_FORECASTS = 4
"""Number of moved forecasts of a segment."""

STUDENT_FIRST = 0.926
STUDENT_SECOND = 0.863
"""Terms of first and second order, in the inverse number of errors, of the 95 % quantile of
Student's t over that of the normal distribution.

Source: Abramowitz and Stegun 1964, 26.7.5."""

FACTOR_MIN = 0.1
SHARE_MAX = 10.0
"""Least factor of an interval, and largest share of a single error."""


class RecordWork(NamedTuple):
    """Scratch of :func:`compare_segment`."""

    root: Any  # (p, p) factor of the parameters' covariance
    start: Any  # (3, 3) factor of that of the velocities
    line: Any  # (1, p) scratch of the factors
    xi: Any  # (p,) moved parameters
    shock: Any  # (3,) moves of the velocities
    path: Any  # (POINTS, 6) the forecast that is not moved
    square: Any  # (POINTS, CHANNELS) its squared errors
    variance: Any  # (POINTS, CHANNELS) mean square of the moved ones' deviations


@inlined
def record_work(work, p):
    """Open the scratch of a comparison."""
    root, at = take(work, 0, (p, p))
    start, at = take(work, at, (3, 3))
    line, at = take(work, at, (1, p))
    xi, at = take(work, at, (p,))
    shock, at = take(work, at, (3,))
    path, at = take(work, at, (POINTS, N_STATES))
    square, at = take(work, at, (POINTS, CHANNELS))
    variance, at = take(work, at, (POINTS, CHANNELS))
    return RecordWork(root, start, line, xi, shock, path, square, variance)


@inlined
def _walsh(i, j):
    """Return 1 or -1: entry j of the Walsh function i."""
    both, odd = i & j, 0
    while both > 0:
        odd ^= both & 1
        both >>= 1
    return 1.0 - 2.0 * odd


@inlined
def _square(channel, a, b):
    """Return the squared difference of two states in a channel, of positions per coordinate."""
    if channel == 0:
        return 0.5 * ((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2)
    return (a[1 + channel] - b[1 + channel]) ** 2


@kernel
def _forecast(first, rows, xi, moved, config, model, work, line):
    """Forecast a segment and compare it: with its rows, or if moved with the forecast as it was.

    Return False where the motion leaves all bounds.
    """
    size, s, point = rows.shape[0], line.s, 0
    row = rows[first % size]
    for i in range(3):
        s[i], s[3 + i] = row[i], row[LOW + i]
        if moved:
            s[3 + i] += work.shock[i]
    drive(row[ACT:MIDDLE], line.terms[3])
    for step in range(config.steps):
        now, after = rows[(first + step) % size], rows[(first + step + 1) % size]
        if not rk4_step(now, after, row[WIND:GOOD], xi, model, line, False):
            return False
        if (step + 1) * POINTS < (point + 1) * config.steps:
            continue
        for c in range(CHANNELS):
            if moved:
                work.variance[point, c] += _square(c, s, work.path[point]) / MOVED_FORECASTS
            else:
                work.square[point, c] = _square(c, s, after)
        if not moved:
            for i in range(N_STATES):
                work.path[point, i] = s[i]
        point += 1
    return True


@kernel
def compare_segment(first, rows, xi, covs, record, config, model, work):
    """Compare the forecast of the segment from row ``first`` with what came.

    ``xi`` (p,) are the parameters in use at its start. ``covs`` are the covariances of parameters
    (p, p) and navigation (6, 6).
    """
    cov, P = covs
    scratch, p = work.spread, xi.shape[0]
    if not _forecast(first, rows, xi, False, config, model, scratch, work.line):
        return
    cholesky(cov, scratch.root, scratch.line)
    for i in range(3):
        for k in range(3):
            scratch.start[i, k] = P[3 + i, 3 + k]
    cholesky(scratch.start, scratch.start, scratch.line)
    scratch.variance[:] = 0.0
    for m in range(MOVED_FORECASTS):
        number = int(record.compared) * MOVED_FORECASTS + m
        for k in range(p):
            scratch.xi[k] = xi[k]
        for j in range(p):
            sign = _walsh(number, j + 1)
            for k in range(j, p):
                scratch.xi[k] += sign * scratch.root[j, k]
        scratch.shock[:] = 0.0
        for j in range(3):
            sign = _walsh(number, p + j + 1)
            for k in range(j, 3):
                scratch.shock[k] += sign * scratch.start[j, k]
        if not _forecast(first, rows, scratch.xi, True, config, model, scratch, work.line):
            return  # no variance is known of parameters that no boat has
    record.compared += 1.0
    weight = 1.0 / min(record.compared, MEMORY_SEGMENTS)
    for k in range(POINTS):
        for c in range(CHANNELS):
            share = SHARE_MAX
            if scratch.square[k, c] < SHARE_MAX * scratch.variance[k, c]:
                share = scratch.square[k, c] / scratch.variance[k, c]
            record.share[k, c] += weight * (share - record.share[k, c])


@inlined
def _factor(point, channel, record, config):
    """Return the factor of the intervals of a channel at a point of a segment."""
    # segments overlap, so that their errors at longer times are less independent
    apart = min(1.0, config.spacing * POINTS / (config.steps * (point + 1.0)))
    many = max(min(record.compared, MEMORY_SEGMENTS) * apart, 1.0)
    student = 1.0 + STUDENT_FIRST / many + STUDENT_SECOND / many**2
    return min(max(math.sqrt(record.share[point, channel]) * student, FACTOR_MIN), 1.0)


@inlined
def factor_ahead(after, channel, record, config):
    """Return the factor of a channel's interval at a time ``after`` (s) ahead.

    It is linear between the points of a segment, and constant beyond the last.
    """
    if record.compared == 0.0:
        return 1.0
    place = min(max(after / (config.steps * GRID) * POINTS - 1.0, 0.0), POINTS - 1.0)
    k = min(int(place), POINTS - 2)
    before = _factor(k, channel, record, config)
    return before + (place - k) * (_factor(k + 1, channel, record, config) - before)
