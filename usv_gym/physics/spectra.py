"""Spectra of waves and gusts, all one-sided, and what follows from them (Eq 15-17).

Waves over circular frequency, in m2 s/rad; gusts over frequency, in (m/s)^2/Hz.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from usv_gym.physics import GRAVITY
from usv_kernel.jit import kernel

Array = NDArray[np.float64]

PM_ALPHA = 8.1e-3

PM_BETA = 0.74

WIND_19 = 1.026
"""Wind speed 19.5 m above the sea over that at 10 m, as Eq (16) has it."""

_DRAG = 0.0026
"""Surface drag coefficient of Harris, Davenport and the logarithmic profile."""


# ---------------------------------------------------------------- waves
def pm_spectrum(omega: Array, hs: float) -> Array:
    """Return the Pierson-Moskowitz spectrum in m2 s/rad for a significant wave height (m).

    ``omega`` in rad/s is above 0. Source: Eq (17), with ``4 alpha`` for the printed .031 (which
    gives 2.2 % too much).
    """
    omega, fall = np.asarray(omega, dtype=float), 4.0 * PM_ALPHA * (GRAVITY / hs) ** 2
    return PM_ALPHA * GRAVITY**2 * omega**-5.0 * np.exp(-fall * omega**-4.0)


def pm_height(wind: float) -> float:
    """Return Hs in m of the sea that a wind (m/s, 10 m above the sea) fully develops.

    Source: the zeroth moment of Eq (15); .2092 U19.5^2/g.
    """
    return 2.0 * math.sqrt(PM_ALPHA / PM_BETA) * (WIND_19 * wind) ** 2 / GRAVITY


def pm_peak_period(hs: float) -> float:
    """Return the peak period in s of the Pierson-Moskowitz spectrum of a height in m."""
    return 2.0 * math.pi * math.sqrt(hs / GRAVITY) / (3.2 * PM_ALPHA) ** 0.25


@kernel
def to_pm_frequencies(hs: float, shares: np.ndarray) -> None:
    """Replace shares (M,) of a PM sea's energy, in (0, 1), by the frequencies below which they lie.

    Frequencies are in rad/s; ``hs`` is the significant wave height, m.
    """
    fall = 4.0 * PM_ALPHA * (GRAVITY / hs) ** 2
    for i in range(shares.shape[0]):
        shares[i] = math.sqrt(math.sqrt(fall / -math.log(shares[i])))


def ittc_spectrum(omega: Array, hs: float, tp: float) -> Array:
    """Return the ITTC (modified Pierson-Moskowitz, Bretschneider) spectrum in m2 s/rad.

    ``omega`` in rad/s is above 0; ``hs`` in m; ``tp`` is the peak period in s:
    1.296 times the mean period, 1.408 times the zero-crossing period.
    Source: ``A w^-5 exp(-B/w^4)`` with A = 487 Hs^2/Tp^4, B = 1949/Tp^4 (ITTC 1978), unrounded.
    """
    w = np.asarray(omega, dtype=float) * (tp / (2.0 * math.pi))
    return tp / (2.0 * math.pi) * 0.3125 * hs**2 * w**-5.0 * np.exp(-1.25 * w**-4.0)


def jonswap_spectrum(omega: Array, hs: float, tp: float, gamma: float = 3.3) -> Array:
    """Return the JONSWAP spectrum in m2 s/rad; its height is hs for every gamma.

    ``omega`` in rad/s is above 0; ``hs`` in m; ``tp`` is the peak period in s; ``gamma`` the peak
    enhancement, 1 for the ITTC spectrum. Source: Hasselmann et al. 1973. Scaled by its own
    integral: the standard factor ``1 - .287 ln gamma`` is a fit to it.
    """
    x = np.geomspace(0.2, 50.0, 4001)  # over the peak frequency; holds all but 3e-8
    area = np.sum(_cells(x, _enhanced(x, gamma)))
    w = np.asarray(omega, dtype=float) * (tp / (2.0 * math.pi))
    return tp / (2.0 * math.pi) * hs**2 / 16.0 / area * _enhanced(w, gamma)


def _enhanced(w: Array, gamma: float) -> Array:
    """Return the shape of JONSWAP's spectrum over frequency by peak frequency."""
    width = np.where(w <= 1.0, 0.07, 0.09)
    return w**-5.0 * np.exp(-1.25 * w**-4.0) * gamma ** np.exp(-0.5 * ((w - 1.0) / width) ** 2)


class Moments(NamedTuple):
    """What a wave spectrum says: m0 (m2), Hs (m); peak, mean and zero-crossing period (s)."""

    m0: float
    hs: float
    tp: float
    tm01: float
    tm02: float


def moments(omega: Array, density: Array) -> Moments:
    """Return the moments of a density (m2 s/rad) over rising omega (rad/s), by trapezoids."""
    m0, m1, m2 = (float(np.sum(_cells(omega, omega**n * density))) for n in range(3))
    return Moments(
        m0=m0,
        hs=4.0 * math.sqrt(m0),
        tp=2.0 * math.pi / float(omega[np.argmax(density)]),
        tm01=2.0 * math.pi * m0 / m1,
        tm02=2.0 * math.pi * math.sqrt(m0 / m2),
    )


def energy_shares(omega: Array, density: Array) -> Array:
    """Return the share of the energy below each point of a spectrum, by trapezoids."""
    below = np.concatenate([[0.0], np.cumsum(_cells(omega, density))])
    return np.asarray(below / below[-1])


def _cells(x: Array, y: Array) -> Array:
    """Return the areas of the trapezoids between the points of a curve."""
    return 0.5 * (y[1:] + y[:-1]) * np.diff(x)


# ---------------------------------------------------------------- wind
GUST_SPECTRA = ("npd", "harris", "davenport")
"""Gust spectra, in the order of their numbers."""

NPD, HARRIS, DAVENPORT = range(len(GUST_SPECTRA))


@kernel
def gust_density(kind: int, f: float, wind: float) -> float:
    """Return a gust spectrum in (m/s)^2/Hz at a frequency (Hz), 10 m above the sea.

    ``kind`` is a place in :data:`GUST_SPECTRA`; ``wind`` is the mean speed at 10 m, m/s, above 0.
    Source: NPD (NORSOK), meant for 1/600 to 0.5 Hz; Harris 1971, with a length of 1800 m; Davenport
    1961, with 1200 m; both with a drag coefficient of .0026.
    """
    if kind == NPD:
        n = 0.468
        x = 172.0 * f * (wind / 10.0) ** (-0.75)
        return 320.0 * (wind / 10.0) ** 2 / (1.0 + x**n) ** (5.0 / (3.0 * n))
    if kind == HARRIS:
        length = 1800.0
        return 4.0 * _DRAG * length * wind / (2.0 + (length * f / wind) ** 2) ** (5.0 / 6.0)
    x = 1200.0 * f / wind
    return 4.0 * _DRAG * wind**2 * x**2 / (f * (1.0 + x**2) ** (4.0 / 3.0))
