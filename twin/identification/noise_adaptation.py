"""Adaptive process and measurement noise of the paper (Eq 52), with limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.identification.dynamic_window import NOISE_FORMS, as_floats
from usv_kernel.errors import UsvTwinError

__all__ = [
    "NoiseLimits",
    "adapt_noise",
]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NoiseLimits:
    """Bounds between which the diagonals of Q and R may move."""

    # (n,): bounds of the variances of the process noise
    Q_low: Array
    Q_high: Array
    # (m,): bounds of the variances of the measurement noise
    R_low: Array
    R_high: Array

    @classmethod
    def around(cls, Q: ArrayLike, R: ArrayLike, *, factor: float = 100.0) -> NoiseLimits:
        """Return bounds that lie a factor (above 1) below and above start values.

        These are matrices or their diagonals; a variance of 0 stays 0.
        """
        if not factor > 1.0:
            raise UsvTwinError(f"factor = {factor} must be above 1")
        q, r = _diagonal(as_floats(Q)), _diagonal(as_floats(R))
        return cls(q / factor, q * factor, r / factor, r * factor)


def adapt_noise(
    Q: ArrayLike,
    R: ArrayLike,
    eps_s: ArrayLike,
    eps_c: ArrayLike,
    alpha: float = 1e-3,
    beta: float = 1e-3,
    *,
    limits: NoiseLimits,
    form: str = "literal",
) -> tuple[Array, Array]:
    """Return the noise covariances after one step of the adaptation.

    Parameters
    ----------
    Q : array_like, shape (n, n) or (n,)
        Covariance of the process noise, or its diagonal.
    R : array_like, shape (m, m) or (m,)
        Covariance of the measurement noise, or its diagonal.
    eps_s, eps_c : array_like, shape () or (n,); () or (m,)
        State error and control error. Literal: their size counts, whatever the unit. Signed:
        squared error minus the variance that the filter expects, which is negative where the
        filter is too careful. NaN (unknown) counts as 0.
    alpha, beta : float
        Gains, 0 or more.
    limits : NoiseLimits
        Bounds; by :meth:`NoiseLimits.around` of the start values. The literal form needs the
        upper ones, as it can only grow.
    form : str
        One of :data:`NOISE_FORMS`.

    Returns
    -------
    Q, R : ndarray
        New arrays of the same shapes. The diagonals move, off-diagonals follow so that
        correlations stay; positive definite if the given ones were.

    Notes
    -----
    Source: Qu et al. 2025, Eq 52 (the text calls it 49). The equation adds a number to a
    matrix; read as added to each variance.
    """
    if form not in NOISE_FORMS:
        raise UsvTwinError(f"form = {form!r} is unknown; use one of {', '.join(NOISE_FORMS)}")
    if not (alpha >= 0.0 and beta >= 0.0):
        raise UsvTwinError(f"alpha = {alpha} and beta = {beta} must be 0 or more")
    return (
        _shift(as_floats(Q), alpha, as_floats(eps_s), limits.Q_low, limits.Q_high, form),
        _shift(as_floats(R), beta, as_floats(eps_c), limits.R_low, limits.R_high, form),
    )


def _shift(noise: Array, gain: float, error: Array, low: Array, high: Array, form: str) -> Array:
    """Move the variances by gain * error within their bounds; keep the correlations."""
    old = _diagonal(noise)
    step = np.nan_to_num(gain * (np.abs(error) if form == "literal" else error), nan=0.0)
    new = np.clip(old + step, low, high)  # Eq 52
    if noise.ndim == 1:
        return new
    d = np.sqrt(np.divide(new, old, out=np.ones_like(old), where=old > 0.0))
    moved = noise * d * d[:, None]
    np.fill_diagonal(moved, new)
    return moved


def _diagonal(noise: Array) -> Array:
    """Return a copy of the variances of a covariance or of a diagonal."""
    if noise.ndim == 2 and noise.shape[0] == noise.shape[1]:
        return noise.diagonal().copy()
    if noise.ndim == 1:
        return noise.copy()
    raise UsvTwinError(f"noise has shape {noise.shape}; expected (n, n) or (n,)")
