"""What the model leaves over: the waves, as an autoregressive process.

The measured velocities move with the waves and the model's do not. Their difference, sampled at
the window's step, is described by an autoregression for each of u, v and r:

    w_k = a_1 w_(k-1) + ... + a_6 w_(k-6) + noise

It foretells the next second or so, and its simulated paths say how far waves carry the boat from
the model's motion later on.

Source: twin.md sections 6 and 10 B4.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from usv_kernel import kernel

__all__ = ["ORDER", "between", "fit_autoregression", "simulate_waves"]

Array = NDArray[np.float64]

ORDER = 6
RIDGE = 1e-3
"""Part of the variance that is taken for white noise of the estimate."""
ANSWER = 200
"""Steps over which a shock is followed; by then a wave has died out."""
ROOT_MAX = 0.98
"""Largest root of the characteristic polynomial: waves die out, and never grow."""


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
    N, c = w.shape
    past = np.stack([w[ORDER - 1 - k : N - 1 - k] for k in range(ORDER)], axis=1)
    now = w[ORDER:]
    coefficients = np.zeros((ORDER, c))
    for j in range(c):
        X = past[:, :, j]
        G = X.T @ X
        G[range(ORDER), range(ORDER)] += RIDGE * np.trace(G) / ORDER + 1e-12
        a = np.linalg.solve(G, X.T @ now[:, j])
        companion = np.eye(ORDER, k=-1)
        companion[0] = a
        largest = float(np.abs(np.linalg.eigvals(companion)).max())
        if largest > ROOT_MAX:
            a *= (ROOT_MAX / largest) ** np.arange(1, ORDER + 1)
        coefficients[:, j] = a
    # so much noise that simulated waves are as high as those seen
    shock, answer = np.zeros((1, ANSWER, c)), np.empty((1, ANSWER, c))
    shock[0, 0] = 1.0
    simulate_waves(np.zeros((ORDER, c)), coefficients, np.ones(c), shock, answer)
    return coefficients, np.sqrt(np.mean(w**2, axis=0) / np.sum(answer[0] ** 2, axis=0))


@kernel
def simulate_waves(past, coefficients, noise, shocks, out):
    """Write paths of the autoregression after a past.

    Parameters
    ----------
    past : (6, c) array
        Last values, newest first.
    coefficients, noise : (6, c), (c,) arrays
        From :func:`fit_autoregression`.
    shocks : (D, K, c) array
        Standard normal numbers; zeros give the mean path.
    out : (D, K, c) array
        Paths.
    """
    for d in range(out.shape[0]):
        for k in range(out.shape[1]):
            for j in range(out.shape[2]):
                value = noise[j] * shocks[d, k, j]
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
