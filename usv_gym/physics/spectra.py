"""Spectra of waves and gusts, all one-sided, and what follows from them (Eq 15-17).

Waves over circular frequency, in m2 s/rad; gusts over frequency, in (m/s)^2/Hz.
"""

from __future__ import annotations

import math
from collections.abc import Callable
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

T1_OVER_TP = 0.8**0.25 / math.gamma(0.75)
"""Mean period m0/m1 over peak period of an ITTC or PM spectrum: .772."""

TZ_OVER_TP = (0.8 / math.pi) ** 0.25
"""Zero-crossing period sqrt(m0/m2) over peak period of an ITTC or PM spectrum: .710."""

_DRAG = 0.0026
"""Surface drag coefficient of Harris, Davenport and the logarithmic profile."""


# ---------------------------------------------------------------- waves
def pm_spectrum(omega: Array, hs: float) -> Array:
    """Return the Pierson-Moskowitz spectrum in m2 s/rad for a significant wave height (m).

    ``omega`` in rad/s is above 0. Source: Eq (17), with ``4 alpha`` for the printed .031 (which
    gives 2.2 % too much).
    """
    return _pm(omega, 4.0 * PM_ALPHA * (GRAVITY / hs) ** 2)


def pm_spectrum_wind(omega: Array, wind: float) -> Array:
    """Return the Pierson-Moskowitz spectrum in m2 s/rad for a wind speed (m/s) at 19.5 m.

    ``omega`` in rad/s is above 0. Source: Eq (15).
    """
    return _pm(omega, PM_BETA * (GRAVITY / wind) ** 4)


def _pm(omega: Array, fall: float) -> Array:
    omega = np.asarray(omega, dtype=float)
    return PM_ALPHA * GRAVITY**2 * omega**-5.0 * np.exp(-fall * omega**-4.0)


def pm_height(wind: float) -> float:
    """Return Hs in m of the sea that a wind (m/s, 10 m above the sea) fully develops.

    Source: the zeroth moment of Eq (15); .2092 U19.5^2/g.
    """
    return 2.0 * math.sqrt(PM_ALPHA / PM_BETA) * (WIND_19 * wind) ** 2 / GRAVITY


def pm_peak_period(hs: float) -> float:
    """Return the peak period in s of the Pierson-Moskowitz spectrum of a height in m."""
    return 2.0 * math.pi * math.sqrt(hs / GRAVITY) / (3.2 * PM_ALPHA) ** 0.25


def pm_equal_energy(hs: float, quantiles: Array) -> Array:
    """Return the frequencies in rad/s below which given shares of a PM sea's energy lie.

    ``hs`` is the significant wave height, m; shares lie in (0, 1).
    """
    omega = np.array(quantiles, dtype=float)
    to_pm_frequencies(float(hs), omega.reshape(-1))
    return omega


@kernel
def to_pm_frequencies(hs: float, shares: np.ndarray) -> None:
    """Replace shares (M,) of the energy as :func:`pm_equal_energy` says."""
    fall = 4.0 * PM_ALPHA * (GRAVITY / hs) ** 2
    for i in range(shares.shape[0]):
        shares[i] = math.sqrt(math.sqrt(fall / -math.log(shares[i])))


def ittc_spectrum(omega: Array, hs: float, tp: float) -> Array:
    """Return the ITTC (modified Pierson-Moskowitz, Bretschneider) spectrum in m2 s/rad.

    ``omega`` in rad/s is above 0; ``hs`` in m; ``tp`` is the peak period in s:
    ``T1 / T1_OVER_TP`` or ``Tz / TZ_OVER_TP`` where those are given.
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
NPD, HARRIS, DAVENPORT = range(3)
"""Places of the gust spectra in :data:`GUST_SPECTRA`."""


@kernel
def gust_density(kind: int, f: float, wind: float, height: float) -> float:
    """Return a gust spectrum in (m/s)^2/Hz at a frequency (Hz) and, of NPD, a height (m)."""
    if kind == NPD:
        n = 0.468
        x = 172.0 * f * (height / 10.0) ** (2 / 3) * (wind / 10.0) ** (-0.75)
        energy = 320.0 * (wind / 10.0) ** 2 * (height / 10.0) ** 0.45
        return energy / (1.0 + x**n) ** (5.0 / (3.0 * n))
    if kind == HARRIS:
        length = 1800.0
        return 4.0 * _DRAG * length * wind / (2.0 + (length * f / wind) ** 2) ** (5.0 / 6.0)
    x = 1200.0 * f / wind
    return 4.0 * _DRAG * wind**2 * x**2 / (f * (1.0 + x**2) ** (4.0 / 3.0))


@kernel
def _fill_density(kind: int, f: np.ndarray, wind: float, height: float, out: np.ndarray) -> None:
    """Write a gust spectrum at frequencies (n,)."""
    for i in range(f.shape[0]):
        out[i] = gust_density(kind, f[i], wind, height)


def _density(kind: int, f: Array, wind: float, height: float = 10.0) -> Array:
    """Return a gust spectrum at frequencies of any shape."""
    f = np.array(f, dtype=float)
    out = np.empty(f.size)
    _fill_density(kind, f.reshape(-1), float(wind), float(height), out)
    return out.reshape(f.shape)


def npd_spectrum(f: Array, wind: float, height: float = 10.0) -> Array:
    """Return the NPD (NORSOK) gust spectrum in (m/s)^2/Hz at a height (m).

    ``f`` (Hz) is meant for 1/600 to 0.5 Hz; ``wind`` is the mean speed at 10 m, m/s, above 0.
    """
    return _density(NPD, f, wind, height)


def harris_spectrum(f: Array, wind: float) -> Array:
    """Return the Harris gust spectrum in (m/s)^2/Hz at f (Hz), of the mean wind at 10 m (m/s).

    Source: Harris 1971, with a length of 1800 m and a drag coefficient of .0026.
    """
    return _density(HARRIS, f, wind)


def davenport_spectrum(f: Array, wind: float) -> Array:
    """Return the Davenport gust spectrum in (m/s)^2/Hz at f (Hz), of the mean wind at 10 m (m/s).

    Source: Davenport 1961, with a length of 1200 m and a drag coefficient of .0026.
    """
    return _density(DAVENPORT, f, wind)


GUST_SPECTRA: dict[str, Callable[[Array, float], Array]] = {
    "npd": npd_spectrum,
    "harris": harris_spectrum,
    "davenport": davenport_spectrum,
}
"""Gust spectra by name; each takes frequency (Hz) and mean wind speed (m/s)."""
