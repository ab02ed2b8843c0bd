"""Largest Lyapunov exponent of a series by Rosenstein's method."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usv_kernel.errors import UsvTwinError
from usv_kernel.jit import kernel

__all__ = [
    "rosenstein",
    "rosenstein_length",
]

Array = NDArray[np.float64]


@kernel
def _rosenstein(
    series: Array, emb_dim: int, lag: int, min_tsep: int, sums: Array, counts: Array
) -> float:
    """Slope of the mean log distance of neighbours, per sample; sums, counts: work space (K,)."""
    steps = sums.shape[0]
    starts = series.shape[0] - (emb_dim - 1) * lag - steps + 1
    for k in range(steps):
        sums[k] = 0.0
        counts[k] = 0.0
    for i in range(starts):
        nearest = -1
        best = math.inf
        for j in range(starts):
            if abs(i - j) <= min_tsep:
                continue
            square = 0.0
            for e in range(emb_dim):
                gap = series[i + e * lag] - series[j + e * lag]
                square += gap * gap
            # roots are compared, so that ties fall as in a table of distances
            distance = math.sqrt(square)
            if distance < best:
                best = distance
                nearest = j
        if nearest < 0:
            return math.nan
        for k in range(steps):
            square = 0.0
            for e in range(emb_dim):
                gap = series[i + k + e * lag] - series[nearest + k + e * lag]
                square += gap * gap
            distance = math.sqrt(square)
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


def rosenstein_length(
    *, emb_dim: int = 2, lag: int = 1, min_tsep: int = 1, trajectory_len: int = 5
) -> int:
    """Return the number of samples that :func:`rosenstein` needs at least."""
    return (emb_dim - 1) * lag + trajectory_len + 2 * min_tsep + 1


def rosenstein(
    series: ArrayLike,
    *,
    emb_dim: int = 2,
    lag: int = 1,
    min_tsep: int = 1,
    trajectory_len: int = 5,
    dt: float = 1.0,
) -> float:
    """Return the largest Lyapunov exponent of a short series.

    Parameters
    ----------
    series : array_like, shape (n,)
        Samples at equal intervals, any unit; n of at least :func:`rosenstein_length`.
    emb_dim, lag : int
        Embedding dimension and delay, samples.
    min_tsep : int
        Neighbours must be more than so many samples apart in time.
    trajectory_len : int
        Number of points, the start included, along which neighbours are followed; a line
        is laid through all of them.
    dt : float
        Sampling interval, s; 1 gives the exponent per sample.

    Returns
    -------
    float
        Exponent, 1/s. NaN if the series holds values that are not finite; minus infinity if
        no neighbours ever part, as in a constant series.

    Raises
    ------
    UsvTwinError
        If the series is too short or an option is out of range.

    Notes
    -----
    Equal to ``nolds.lyap_r(..., fit="poly", tau=dt)`` with the same options.

    Source: Rosenstein, Collins and De Luca 1993; Qu et al. 2025, Eq 38.
    """
    if emb_dim < 1 or lag < 1 or min_tsep < 0 or trajectory_len < 2 or not dt > 0.0:
        raise UsvTwinError(
            f"emb_dim = {emb_dim}, lag = {lag}, min_tsep = {min_tsep}, "
            f"trajectory_len = {trajectory_len}, dt = {dt}: "
            "expected at least 1, 1, 0, 2, and a dt above 0"
        )
    values = np.ascontiguousarray(series, dtype=np.float64)
    if values.ndim != 1:
        raise UsvTwinError(f"series has shape {values.shape}; expected (n,)")
    need = rosenstein_length(
        emb_dim=emb_dim, lag=lag, min_tsep=min_tsep, trajectory_len=trajectory_len
    )
    if values.size < need:
        raise UsvTwinError(f"series has {values.size} samples; at least {need} are needed")
    if not np.isfinite(values).all():
        return math.nan
    work = np.empty((2, trajectory_len))
    return float(_rosenstein(values, emb_dim, lag, min_tsep, work[0], work[1])) / dt
