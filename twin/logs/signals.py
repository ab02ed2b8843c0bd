"""Robust estimators for the signals of a log: noise, means, integrals, ways between fixes."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from twin.logs.columns import Array

__all__ = [
    "ENOUGH",
    "averaged",
    "even_times",
    "integrated",
    "interpolation_residual",
    "robust_sd",
    "runs_of",
    "sampled",
    "ways",
    "white_noise",
]

ENOUGH = 20
"""Fewer samples than this say nothing."""


def robust_sd(values: Array) -> float:
    """Return the standard deviation of the bulk of values, from their median deviation."""
    if not len(values):
        return math.nan
    spread = 1.4826 * float(np.median(np.abs(values - np.median(values))))
    return spread if spread > 0.0 else float(np.std(values))


def interpolation_residual(t: Array, values: Array) -> Array:
    """Return how far each sample lies from the cubic through its four neighbours.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times.
    values : ndarray, shape (N,) or (N, k)
        Samples.

    Returns
    -------
    ndarray, shape (N - 4,) or (N - 4, k)
        Scaled to the standard deviation of white noise in the samples.
    """
    if len(t) < 5:
        return values[:0]
    middle = t[2:-2]
    near = [t[:-4], t[1:-3], t[3:-1], t[4:]]
    weights = np.ones((4, len(middle)))
    for i in range(4):
        for j in range(4):
            if i != j:
                weights[i] *= (middle - near[j]) / (near[i] - near[j])
    parts = [values[:-4], values[1:-3], values[3:-1], values[4:]]
    shape = (-1,) + (1,) * (values.ndim - 1)
    guess = sum(w.reshape(shape) * part for w, part in zip(weights, parts, strict=True))
    gain = np.sqrt(1.0 + (weights**2).sum(axis=0)).reshape(shape)
    return np.asarray((values[2:-2] - guess) / gain)


def white_noise(t: Array, values: Array) -> float:
    """Return the standard deviation of what changes from sample to sample."""
    return robust_sd(interpolation_residual(t, values))


def integrated(t: Array, values: Array) -> Array:
    """Return the integral of samples from the first one on, by trapezes."""
    steps = 0.5 * (values[1:] + values[:-1])
    width = np.diff(t).reshape((-1,) + (1,) * (values.ndim - 1))
    start = np.zeros((1, *values.shape[1:]))
    return np.concatenate([start, np.cumsum(steps * width, axis=0)])


def sampled(t: Array, values: Array, at: Array) -> Array:
    """Return samples interpolated to other times; NaN outside, and inside gaps.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times of the samples, increasing.
    values : ndarray, shape (N,) or (N, k)
        Samples.
    at : ndarray, shape (M,)
        Times wanted.
    """
    step = max(10.0 * float(np.median(np.diff(t))), 1.0)
    after = np.searchsorted(t, at).clip(1, len(t) - 1)
    lost = (at < t[0]) | (at > t[-1]) | (t[after] - t[after - 1] > step)
    if values.ndim == 1:
        found = np.interp(at, t, values)
    else:
        found = np.column_stack([np.interp(at, t, column) for column in values.T])
    found[lost] = np.nan
    return found


def even_times(start: float, stop: float, step: float, t: Array) -> Array:
    """Return times a step apart, but none deep in the gaps of a log with rows at the times t."""
    if stop - start > step * len(t):  # most of them would lie in gaps
        cell = np.unique(np.floor((t - start) / step))
        grid = start + step * np.unique(np.concatenate([cell, cell + 1.0]))
        return grid[(grid >= start) & (grid < stop)]
    return np.arange(start, stop, step)


def averaged(t: Array, values: Array, at: Array, width: float) -> Array:
    """Return the mean of samples over a width around other times; NaN where they are lost.

    Parameters
    ----------
    t, values, at
        As for :func:`sampled`.
    width : float
        s; not below two sample intervals, for which they are interpolated instead.
    """
    if width < 2.0 * float(np.median(np.diff(t))):
        return sampled(t, values, at)
    summed = integrated(t, values)
    half = 0.5 * width
    return (sampled(t, summed, at + half) - sampled(t, summed, at - half)) / width


def ways(t: Array, fix: Array) -> tuple[Array, Array, float]:
    """Return ways between smoothed fixes, the times of their middles, and the time between them.

    The time is 2 s, or as long as a way takes that is several times the noise.
    """
    noise = math.hypot(white_noise(t, fix[:, 0]), white_noise(t, fix[:, 1]))
    rate = 1.0 / max(float(np.median(np.diff(t))), 1e-6)
    most = (t[-1] - t[0]) / 12.0
    # of fixes with a gap of years, no more ways than fixes
    step = min(max(2.0, 8.0 / rate, float(t[-1] - t[0]) / len(t)), most)
    while True:
        grid = np.arange(t[0] + 0.5 * step, t[-1] - 0.5 * step, step)
        way = np.diff(averaged(t, fix, grid, 0.5 * step), axis=0)
        length = np.hypot(*way.T)
        left = noise / math.sqrt(max(0.5 * step * rate, 1.0))
        if step >= most or _median(length) > 6.0 * left:
            return way, 0.5 * (grid[1:] + grid[:-1]), step
        step = min(1.5 * step, most)


def _median(values: Array) -> float:
    """Return the median of what is not NaN; infinity for none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else math.inf


def runs_of(mask: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first index and the index after the last of each run of true values."""
    edge = np.diff(np.concatenate(([0], mask.astype(np.int8), [0])))
    starts, ends = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1)
    return list(zip(starts.tolist(), ends.tolist(), strict=True))
