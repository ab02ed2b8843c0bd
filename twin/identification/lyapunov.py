"""Largest Lyapunov exponent of a series by Rosenstein's method."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usv_kernel.errors import UsvTwinError
from usv_kernel.jit import kernel

__all__ = ["LENGTH_MIN", "rosenstein"]

Array = NDArray[np.float64]

FOLLOWED = 5
APART = 1
"""Points along which neighbours are followed, the start included, and least separation in time of
neighbours, samples. A point is a value and the one after."""

LENGTH_MIN = 1 + FOLLOWED + 2 * APART + 1
"""Least number of samples."""


@kernel
def _rosenstein(series: Array, sums: Array, counts: Array) -> float:
    """Slope of the mean log distance of neighbours, per sample; sums, counts: work space (K,)."""
    steps = sums.shape[0]
    starts = series.shape[0] - steps
    for k in range(steps):
        sums[k] = 0.0
        counts[k] = 0.0
    for i in range(starts):
        nearest = -1
        best = math.inf
        for j in range(starts):
            if abs(i - j) <= APART:
                continue
            distance = _distance(series, i, j)
            if distance < best:
                best = distance
                nearest = j
        if nearest < 0:
            return math.nan
        for k in range(steps):
            distance = _distance(series, i + k, nearest + k)
            if distance > 0.0:
                sums[k] += math.log(distance)
                counts[k] += 1.0
    points = 0
    mean_k = 0.0
    mean_y = 0.0
    for k in range(steps):
        if counts[k] > 0.0:
            sums[k] /= counts[k]
            points += 1
            mean_k += k
            mean_y += sums[k]
    if points < 2:
        return -math.inf
    mean_k /= points
    mean_y /= points
    top = 0.0
    bottom = 0.0
    for k in range(steps):
        if counts[k] > 0.0:
            top += (k - mean_k) * (sums[k] - mean_y)
            bottom += (k - mean_k) * (k - mean_k)
    return top / bottom


@kernel
def _distance(series: Array, i: int, j: int) -> float:
    """Return the distance of two points; roots, so that ties fall as in a table of distances."""
    one, two = series[i] - series[j], series[i + 1] - series[j + 1]
    return math.sqrt(one * one + two * two)


def rosenstein(series: ArrayLike, *, dt: float = 1.0) -> float:
    """Return the largest Lyapunov exponent (1/s) of a short series, sampled each dt s.

    NaN if the series holds values that are not finite; minus infinity if no neighbours ever part,
    as in a constant series. UsvTwinError: it is shorter than :data:`LENGTH_MIN`, or not (n,).
    Equal to ``nolds.lyap_r(..., emb_dim=2, lag=1, min_tsep=1, trajectory_len=5, fit="poly",
    tau=dt)``.

    Source: Rosenstein, Collins and De Luca 1993; Qu et al. 2025, Eq 38.
    """
    values = np.ascontiguousarray(series, dtype=np.float64)
    if values.ndim != 1:
        raise UsvTwinError(f"series has shape {values.shape}; expected (n,)")
    if values.size < LENGTH_MIN:
        raise UsvTwinError(f"series has {values.size} samples; at least {LENGTH_MIN} are needed")
    if not np.isfinite(values).all():
        return math.nan
    work = np.empty((2, FOLLOWED))
    return float(_rosenstein(values, work[0], work[1])) / dt
