"""Robust estimators that the detectors share: noise, increments, lags, fits."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from twin.logs.columns import Array

__all__ = [
    "ENOUGH",
    "Lag",
    "Line",
    "averaged",
    "best_lag",
    "fit_line",
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


_HUGE = 1e60
"""No measurement is larger."""


class Line(NamedTuple):
    """``y = slope x + offset``, robustly."""

    slope: float
    offset: float
    slope_sd: float
    offset_sd: float
    residual: float
    """Standard deviation of what is left."""
    explained: float
    """Share of the variance of y."""


def fit_line(x: Array, y: Array, loss: float = 2.0) -> Line:
    """Return the line through points by Huber's loss, with standard deviations.

    Parameters
    ----------
    x, y : ndarray, shape (N,)
        Points.
    loss : float
        Residuals beyond so many standard deviations count linearly.
    """
    # squares of invalid values overflow
    sane = (np.abs(x) < _HUGE) & (np.abs(y) < _HUGE)
    x, y = x[sane], y[sane]
    if not len(x):
        return Line(0.0, 0.0, math.inf, math.inf, math.inf, 0.0)
    A = np.column_stack([x, np.ones_like(x)])
    weight = np.ones_like(x)
    for _ in range(20):
        normal = A.T @ (A * weight[:, None])
        fit = np.linalg.lstsq(normal, A.T @ (weight * y), rcond=None)[0]
        left = y - A @ fit
        scale = max(robust_sd(left), 1e-12)
        weight = np.minimum(1.0, loss * scale / np.maximum(np.abs(left), 1e-300))
    spread = math.sqrt(float(weight @ left**2 / max(weight.sum() - 2.0, 1.0)))
    cov = np.linalg.pinv(A.T @ (A * weight[:, None])) * spread**2
    total = float(weight @ (y - np.average(y, weights=weight)) ** 2)
    explained = 1.0 - float(weight @ left**2) / max(total, 1e-300)
    sd = np.sqrt(np.diag(cov))
    return Line(fit[0], fit[1], sd[0], sd[1], spread, explained)


class Lag(NamedTuple):
    """How much later one signal comes than another."""

    seconds: float
    sd: float
    """Standard deviation of it, s."""
    sharpness: float
    """Frequency of the sine whose correlation has such a peak, rad/s."""
    correlation: float
    """At that lag."""
    gain: float
    """Residual without the lag over that with it."""
    lags: Array
    curve: Array


def best_lag(
    first: Callable[[Array], Array],
    second: Callable[[Array], Array],
    grid: Array,
    *,
    most: float,
    width: float,
    turned: bool = False,
) -> Lag | None:
    """Return by how many seconds the second signal is late, where their correlation is largest.

    Parameters
    ----------
    first, second : callable
        Return a signal, shape (N,) or (N, 2), at times; NaN where it is unknown.
    grid : ndarray, shape (N,)
        Times a constant step apart.
    most : float
        Largest lag, s.
    width : float
        Values closer than this say the same, s.
    turned : bool
        Whether vectors may differ by a constant angle.

    Notes
    -----
    The signals are compared on the grid, and the peak is refined by a parabola. Sums over the
    values that both have come from FFTs.
    """
    step = float(grid[1] - grid[0])
    count = max(round(most / step), 1)
    size = 1 << (len(grid) + count).bit_length()
    (x, mx), (y, my) = (_centred(signal(grid)) for signal in (first, second))
    lags = np.arange(-count, count + 1)

    def correlate(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return np.fft.ifft(np.conj(np.fft.fft(a, size)) * np.fft.fft(b, size))[lags]

    common = correlate(mx, my).real
    if common.min() < ENOUGH:
        return None
    power = correlate(np.abs(x) ** 2, my).real * correlate(mx, np.abs(y) ** 2).real
    cross = correlate(x, y)
    value = np.abs(cross) if turned else cross.real
    curve = np.asarray(value / np.sqrt(np.maximum(power, 1e-300)), dtype=np.float64)
    curve[power < 1e-20 * max(float(power.max()), 1e-300)] = 0.0
    peak = int(np.argmax(np.abs(curve)))
    found, sd, sharpness = float(lags[peak]) * step, math.inf, 1e-9
    inside = 0 < peak < len(lags) - 1
    if inside:
        left, top, right = curve[peak - 1 : peak + 2] * np.sign(curve[peak])
        bend = float(left - 2.0 * top + right) / step**2
        if bend < 0.0:
            found -= 0.5 * float(right - left) / step / bend
            sharpness = math.sqrt(-bend / max(float(top), 1e-9))
            independent = max(float(common[peak]) * step / width, 1.0)
            sd = math.sqrt(max(1.0 - float(top) ** 2, 1e-12) / independent / -bend)
    gain = (1.0 - curve[count] ** 2) / max(1.0 - curve[peak] ** 2, 1e-9) if inside else 1.0
    return Lag(
        found, sd, sharpness, float(curve[peak]), float(gain), step * lags.astype(np.float64), curve
    )


def _centred(values: Array) -> tuple[npt.NDArray[Any], Array]:
    """Return a signal about its mean, two columns as one complex, and where it is known."""
    flat: npt.NDArray[Any] = values if values.ndim == 1 else values @ np.array([1.0, 1j])
    known = np.asarray(np.isfinite(flat), dtype=np.float64)
    signal = np.where(known > 0.0, flat, 0.0)
    mean = signal.sum() / max(float(known.sum()), 1.0)
    return np.where(known > 0.0, signal - mean, 0.0), known


def runs_of(mask: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first index and the index after the last of each run of true values."""
    edge = np.diff(np.concatenate(([0], mask.astype(np.int8), [0])))
    starts, ends = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1)
    return list(zip(starts.tolist(), ends.tolist(), strict=True))
