"""What the model leaves over: the waves, as an autoregressive process.

The measured velocities move with the waves and the model's do not. Their difference, sampled at
the window's step, is described by an autoregression for each of u, v and r:

    w_k = a_1 w_(k-1) + ... + a_6 w_(k-6) + noise

It foretells the next second or so, and its simulated paths say how far waves carry the boat from
the model's motion later on.

Source: twin.md sections 6 and 10 B4.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.dense import cholesky, solve_factored
from usv_kernel import kernel
from usv_kernel.views import shaped

__all__ = ["ORDER", "between", "fit_autoregression", "fit_waves", "simulate_waves"]

Array = NDArray[np.float64]

ORDER = 6
RIDGE = 1e-3
"""Part of the variance that is taken for white noise of the estimate."""
ANSWER = 200
"""Steps over which a shock is followed; by then a wave has died out."""
ROOT_MAX = 0.98
"""Largest root of the characteristic polynomial: waves die out, and never grow."""


WAVE_ROOM = ORDER * ORDER + 3 * ORDER + 1
"""Length of the scratch of :func:`fit_waves`."""


def fit_autoregression(w: Array) -> tuple[Array, Array]:
    """Return coefficients and noise of the autoregression of each column.

    Parameters
    ----------
    w : ndarray, shape (N, c)
        Evenly sampled residuals, about zero; more than twice :data:`ORDER` rows.

    Returns
    -------
    coefficients : ndarray, shape (6, c)
        Of the last value first; stable.
    noise : ndarray, shape (c,)
        Standard deviation of what cannot be foretold.
    """
    coefficients, noise = np.zeros((ORDER, w.shape[1])), np.zeros(w.shape[1])
    fit_waves(np.ascontiguousarray(w), coefficients, noise, np.empty(WAVE_ROOM))
    return coefficients, noise


@kernel
def fit_waves(w, coefficients, noise, room):
    """Write what :func:`fit_autoregression` returns.

    Parameters
    ----------
    w : (N, c) array
        Residuals.
    coefficients, noise : (6, c), (c,) arrays
        Written.
    room : (WAVE_ROOM,) array
        Scratch.
    """
    N = w.shape[0]
    G = shaped(room, 0, (ORDER, ORDER))
    rest = room[ORDER * ORDER :]
    a, b, line = (
        rest[:ORDER],
        rest[ORDER : 2 * ORDER],
        shaped(rest, 2 * ORDER, (1, ORDER)),
    )
    for j in range(w.shape[1]):
        # products with the newest value; those of older values differ in the first and last row
        square = 0.0
        for i in range(ORDER):
            a[i] = 0.0
        for n in range(ORDER, N):
            square += w[n, j] * w[n, j]
            for i in range(ORDER):
                a[i] += w[n, j] * w[n - 1 - i, j]
        trace = 0.0
        for i in range(ORDER):
            for k in range(i, ORDER):
                before = (square if k == 0 else a[k - 1]) if i == 0 else G[i - 1, k - 1]
                first = w[ORDER - 1 - i, j] * w[ORDER - 1 - k, j]
                G[i, k] = before + first - w[N - 1 - i, j] * w[N - 1 - k, j]
            trace += G[i, i]
        for i in range(ORDER):
            G[i, i] += RIDGE * trace / ORDER + 1e-12
        if cholesky(G, G, line) > 0:
            a[:] = 0.0
        else:
            solve_factored(G, a, a)
        if not decays(a, ROOT_MAX, b):
            shrink, part = ROOT_MAX / largest_root(a, b), 1.0
            for i in range(ORDER):
                part *= shrink
                a[i] *= part
        # so much noise that simulated waves are as high as those seen
        answer, power = b, 1.0
        answer[:] = 0.0
        answer[0] = 1.0
        for _ in range(ANSWER - 1):
            value = 0.0
            for i in range(ORDER):
                value += a[i] * answer[i]
            for i in range(ORDER - 1, 0, -1):
                answer[i] = answer[i - 1]
            answer[0] = value
            power += value * value
        total = 0.0
        for n in range(N):
            total += w[n, j] * w[n, j]
        noise[j] = math.sqrt(total / N / power)
        for i in range(ORDER):
            coefficients[i, j] = a[i]


@kernel
def decays(a, size, b):
    """Return whether all roots of an autoregression are smaller than a size.

    Parameters
    ----------
    a : (6,) array
        Coefficients, of the last value first.
    size : float
        Size.
    b : (6,) array
        Scratch.

    Source: Schur and Cohn's test, by the recursion of Levinson and Durbin downwards.
    """
    part = 1.0
    for i in range(a.shape[0]):
        part /= size
        b[i] = part * a[i]
    for m in range(a.shape[0] - 1, -1, -1):
        k = b[m]
        if not abs(k) < 1.0:
            return False
        left = 1.0 / ((1.0 - k) * (1.0 + k))
        for i in range((m + 1) // 2):
            one, two = b[i], b[m - 1 - i]
            b[i], b[m - 1 - i] = left * (one + k * two), left * (two + k * one)
    return True


@kernel
def largest_root(a, b):
    """Return the size of the largest root; arguments as for :func:`decays`."""
    low, high = 0.0, 1.0
    for i in range(a.shape[0]):
        high = max(high, 1.0 + abs(a[i]))  # Cauchy's bound
    while high - low > 1e-14 * high:
        middle = 0.5 * (low + high)
        if decays(a, middle, b):
            high = middle
        else:
            low = middle
    return high


@kernel
def simulate_waves(past, coefficients, noise, rough, shocks, out):
    """Write paths of the autoregression after a past.

    Parameters
    ----------
    past : (6, c) array
        Last values, newest first.
    coefficients, noise : (6, c), (c,) arrays
        From :func:`fit_autoregression`.
    rough : (K, c) array
        Times as large as that is the noise of each step.
    shocks : (D, K, c) array
        Standard normal numbers; zeros give the mean path.
    out : (D, K, c) array
        Paths.
    """
    for d in range(out.shape[0]):
        for k in range(out.shape[1]):
            for j in range(out.shape[2]):
                value = noise[j] * rough[k, j] * shocks[d, k, j]
                for i in range(past.shape[0]):
                    value += coefficients[i, j] * (
                        out[d, k - 1 - i, j] if i < k else past[i - k, j]
                    )
                out[d, k, j] = value


@kernel
def between(path, grid, after, ends, means):
    """Write values of paths at times, and their means from each time to the next.

    Parameters
    ----------
    path : (D, K + 1, c) array
        Values from now on, ``grid`` s apart; straight lines between them.
    grid : float
        Step of the path, s.
    after : (M,) array
        Rising times after now, s, within the path.
    ends, means : (D, M, c) arrays
        Values at the times; means since the time before (now, for the first).
    """
    last = path.shape[1] - 2
    for d in range(path.shape[0]):
        for j in range(path.shape[2]):
            carried, done, before, t = 0.0, 0, 0.0, 0.0
            for m in range(after.shape[0]):
                low = min(int(after[m] / grid), last)
                while done < low:
                    carried += 0.5 * grid * (path[d, done, j] + path[d, done + 1, j])
                    done += 1
                share = after[m] / grid - low
                first, rise = path[d, low, j], path[d, low + 1, j] - path[d, low, j]
                ends[d, m, j] = first + share * rise
                total = carried + grid * share * (first + 0.5 * share * rise)
                means[d, m, j] = (total - before) / (after[m] - t)
                before, t = total, after[m]
