"""Spectra: published numbers, moments, quantiles, gusts."""

import math

import numpy as np
import pytest

from usv_gym.physics import GRAVITY, spectra

OMEGA = np.geomspace(0.05, 500.0, 400_001)
GUST_F = np.geomspace(1 / 600, 0.5, 20_001)


# ---------------------------------------------------------------- waves


@pytest.mark.parametrize("hs", [0.1, 0.5, 6.0])
def test_pm_moment_and_peak_are_those_of_the_height_spectrum(hs: float) -> None:
    spectrum = spectra.pm_spectrum(OMEGA, hs)
    # consistency wants 4 alpha = .0324 exactly (docs/explanation/ship_and_sea.md);
    # the grid ends cost 1e-6
    assert spectra.moments(OMEGA, spectrum).hs == pytest.approx(hs, rel=1e-5)
    # w_p sqrt(Hs/g) = .4012, to 1e-3: a separate computation
    peak = OMEGA[np.argmax(spectrum)]
    assert peak * math.sqrt(hs / GRAVITY) == pytest.approx(0.4012, rel=1e-3)
    # steps of the grid are 2.3e-5
    assert spectra.pm_peak_period(hs) == pytest.approx(2.0 * math.pi / peak, rel=5e-5)


def test_ittc_has_the_height_and_periods_it_is_given() -> None:
    m = spectra.moments(OMEGA, spectra.ittc_spectrum(OMEGA, 2.0, 8.0))
    # the grid's steps are 2.3e-5, its end cuts the tail, which changes Tm02 by 1e-4
    assert (m.hs, m.tp) == (pytest.approx(2.0, rel=1e-5), pytest.approx(8.0, rel=5e-5))
    # T1 = .772 Tp, Tz = .710 Tp: README of the NDBC data, three figures
    assert m.tm01 / 8.0 == pytest.approx(0.772, abs=5e-4)
    assert m.tm02 / 8.0 == pytest.approx(0.710, abs=5e-4)


def test_ittc_constants_are_the_published_ones() -> None:
    # 487, 1949 with Tp; 173, 691 with T1; 123, 495 with Tz: ITTC 1978, rounded there
    w, hs = np.array([0.5, 1.0, 2.0]), 2.0
    for period, tp, a, b in (
        (8.0, 8.0, 487.0, 1949.0),
        (6.0, 6.0 / 0.772, 173.0, 691.0),
        (6.0, 6.0 / 0.710, 123.0, 495.0),
    ):
        printed = a * hs**2 / period**4 * w**-5 * np.exp(-b / period**4 / w**4)
        np.testing.assert_allclose(spectra.ittc_spectrum(w, hs, tp), printed, rtol=0.02)


def test_ittc_of_the_pm_period_is_pm() -> None:
    np.testing.assert_allclose(
        spectra.ittc_spectrum(OMEGA, 0.5, spectra.pm_peak_period(0.5)),
        spectra.pm_spectrum(OMEGA, 0.5),
        rtol=1e-9,
        atol=1e-300,
    )


@pytest.mark.parametrize("gamma", [1.0, 2.0, 3.3, 7.0])
def test_jonswap_has_its_height_and_peak(gamma: float) -> None:
    spectrum = spectra.jonswap_spectrum(OMEGA, 1.5, 6.0, gamma)
    m = spectra.moments(OMEGA, spectrum)
    # scaled by its own integral (1 % is asked for); the grid's steps are 2.3e-5
    assert (m.hs, m.tp) == (pytest.approx(1.5, rel=1e-4), pytest.approx(6.0, rel=5e-5))
    # the standard factor, a fit good to 2 % (DNV-RP-C205: 1 <= gamma <= 7)
    wp = 2.0 * math.pi / 6.0
    width = np.where(wp >= OMEGA, 0.07, 0.09)
    enhanced = gamma ** np.exp(-((OMEGA - wp) ** 2) / (2.0 * width**2 * wp**2))
    expected = (1.0 - 0.287 * math.log(gamma)) * spectra.ittc_spectrum(OMEGA, 1.5, 6.0) * enhanced
    np.testing.assert_allclose(spectrum, expected, rtol=0.02, atol=1e-300)
    assert np.max(spectrum) > np.max(spectra.ittc_spectrum(OMEGA, 1.5, 6.0)) or gamma == 1.0


def test_moments_of_a_triangle_equal_theory() -> None:
    # by hand: base 2, height 3, centred on 2: m0 = 3, m1 = 6, m2 = 12.5 (dense: rtol 1e-6)
    omega = np.linspace(1.0, 3.0, 4001)
    m = spectra.moments(omega, 3.0 * (1.0 - np.abs(omega - 2.0)))
    assert m.m0 == pytest.approx(3.0, rel=1e-6)
    assert m.hs == pytest.approx(4.0 * math.sqrt(3.0), rel=1e-6)
    assert m.tp == pytest.approx(math.pi, rel=1e-6)
    assert m.tm01 == pytest.approx(math.pi, rel=1e-6)
    assert m.tm02 == pytest.approx(2.0 * math.pi * math.sqrt(3.0 / 12.5), rel=1e-6)


# ---------------------------------------------------------------- wind


@pytest.mark.parametrize(
    ("name", "wind", "sigma", "rel"),
    # separate computations, to two and three figures
    [
        ("npd", 4.5, 0.28, 0.02),
        ("harris", 4.5, 0.52, 0.02),
        ("davenport", 4.5, 0.53, 0.02),
        ("npd", 10.0, 0.871, 0.01),
        ("harris", 10.0, 1.22, 0.01),
        ("davenport", 10.0, 1.20, 0.01),
    ],
)
def test_gusts_have_the_published_standard_deviation(
    name: str, wind: float, sigma: float, rel: float
) -> None:
    kind = spectra.GUST_SPECTRA.index(name)
    density = [spectra.gust_density(kind, f, wind) for f in GUST_F]
    assert math.sqrt(np.trapezoid(density, GUST_F)) == pytest.approx(sigma, rel=rel)
