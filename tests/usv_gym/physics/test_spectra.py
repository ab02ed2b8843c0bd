"""Spectra: published numbers, moments, quantiles, gusts, wind profile."""

from __future__ import annotations

import math

import numpy as np
import pytest

from usv_gym.physics import GRAVITY, spectra

OMEGA = np.geomspace(0.05, 500.0, 400_001)
GUST_F = np.geomspace(1 / 600, 0.5, 20_001)


# ---------------------------------------------------------------- waves


def test_pm_moment_of_the_wind_spectrum() -> None:
    # m0 g^2 / U^4 = .0027365, Hs g / U^2 = .2092, to 1e-3:
    # docs/explanation/validation.md, Sea and gusts
    wind = 7.0
    m0 = np.trapezoid(spectra.pm_spectrum_wind(OMEGA, wind), OMEGA)
    assert m0 * GRAVITY**2 / wind**4 == pytest.approx(0.0027365, rel=1e-3)
    assert 4.0 * math.sqrt(m0) * GRAVITY / wind**2 == pytest.approx(0.2092, rel=1e-3)


@pytest.mark.parametrize("hs", [0.1, 0.5, 6.0])
def test_pm_moment_and_peak_of_the_height_spectrum(hs: float) -> None:
    spectrum = spectra.pm_spectrum(OMEGA, hs)
    # consistency wants .0324 exactly (docs/explanation/ship_and_sea.md, Waves);
    # the grid ends cost 1e-6
    assert spectra.moments(OMEGA, spectrum).hs == pytest.approx(hs, rel=1e-5)
    # w_p sqrt(Hs/g) = .4012, to 1e-3: docs/explanation/validation.md, Sea and gusts
    peak = OMEGA[np.argmax(spectrum)]
    assert peak * math.sqrt(hs / GRAVITY) == pytest.approx(0.4012, rel=1e-3)
    # steps of the grid are 2.3e-5
    assert spectra.pm_peak_period(hs) == pytest.approx(2.0 * math.pi / peak, rel=5e-5)


def test_pm_by_wind_is_pm_by_its_height() -> None:
    # the same curve by two roads, but for rounding
    hs = spectra.pm_height(9.0)
    np.testing.assert_allclose(
        spectra.pm_spectrum(OMEGA, hs),
        spectra.pm_spectrum_wind(OMEGA, 1.026 * 9.0),
        rtol=1e-9,
        atol=1e-300,
    )


def test_peak_of_the_papers_sea() -> None:
    # Hs = .5 m: 1.777 rad/s, 3.54 s, 19.5 m, to 1e-2: docs/explanation/validation.md, Sea and gusts
    period = spectra.pm_peak_period(0.5)
    assert 2.0 * math.pi / period == pytest.approx(1.777, rel=1e-2)
    assert period == pytest.approx(3.54, rel=1e-2)
    assert GRAVITY * period**2 / (2.0 * math.pi) == pytest.approx(19.5, rel=1e-2)


def test_equal_energy_components() -> None:
    # N = 50, Hs = .5: 1.283 to 5.935 rad/s at g = 9.81 m/s2: docs/explanation/validation.md,
    # Sea and gusts. The frequencies go with the root of g, which is 2e-4 less here
    omega = spectra.pm_equal_energy(0.5, (np.arange(50) + 0.5) / 50)
    scale = math.sqrt(9.81 / GRAVITY)
    np.testing.assert_allclose(omega[[0, -1]] * scale, [1.283, 5.935], atol=5e-4)
    assert np.all(np.diff(omega) > 0)


def test_numerical_quantiles_are_those_of_the_closed_form() -> None:
    quantiles = np.array([0.05, 0.3, 0.5, 0.8, 0.95])
    # trapezoids on 4e5 points: 1e-6
    np.testing.assert_allclose(
        spectra.quantile_frequencies(quantiles, OMEGA, spectra.pm_spectrum(OMEGA, 0.5)),
        spectra.pm_equal_energy(0.5, quantiles),
        rtol=1e-5,
    )


def test_ittc_has_the_height_and_periods_it_is_given() -> None:
    m = spectra.moments(OMEGA, spectra.ittc_spectrum(OMEGA, 2.0, 8.0))
    # the grid's steps are 2.3e-5, its end cuts the tail that Tm02 hangs on by 1e-4
    assert (m.hs, m.tp) == (pytest.approx(2.0, rel=1e-5), pytest.approx(8.0, rel=5e-5))
    # T1 = .772 Tp, Tz = .710 Tp: README of the NDBC data, three figures
    assert m.tm01 / 8.0 == pytest.approx(0.772, abs=5e-4)
    assert m.tm02 / 8.0 == pytest.approx(0.710, abs=5e-4)
    assert m.tm01 / 8.0 == pytest.approx(spectra.T1_OVER_TP, rel=1e-4)
    assert m.tm02 / 8.0 == pytest.approx(spectra.TZ_OVER_TP, rel=1e-4)


def test_ittc_constants_are_the_published_ones() -> None:
    # 487, 1949 with Tp; 173, 691 with T1; 123, 495 with Tz: ITTC 1978, rounded there
    w, hs = np.array([0.5, 1.0, 2.0]), 2.0
    for period, tp, a, b in (
        (8.0, 8.0, 487.0, 1949.0),
        (6.0, 6.0 / spectra.T1_OVER_TP, 173.0, 691.0),
        (6.0, 6.0 / spectra.TZ_OVER_TP, 123.0, 495.0),
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


def test_moments_of_a_triangle() -> None:
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
    [
        # at 10 m/s: docs/explanation/validation.md, Sea and gusts; at 4.5 m/s: separate
        # computation, two figures
        ("npd", 10.0, 0.871, 0.01),
        ("harris", 10.0, 1.22, 0.01),
        ("davenport", 10.0, 1.20, 0.01),
        ("npd", 4.5, 0.28, 0.02),
        ("harris", 4.5, 0.52, 0.02),
        ("davenport", 4.5, 0.53, 0.02),
    ],
)
def test_gust_standard_deviations(name: str, wind: float, sigma: float, rel: float) -> None:
    spectrum = spectra.GUST_SPECTRA[name](GUST_F, wind)
    assert math.sqrt(np.trapezoid(spectrum, GUST_F)) == pytest.approx(sigma, rel=rel)


def test_npd_at_other_heights() -> None:
    # at low frequency only the factor (z/10)^.45 is left
    low = np.array([1e-9])
    ratio = spectra.npd_spectrum(low, 10.0, 20.0) / spectra.npd_spectrum(low, 10.0)
    assert ratio[0] == pytest.approx(2.0**0.45, rel=1e-3)


def test_wind_profile() -> None:
    # Fossen 2021: U10 5/2 sqrt(kap) ln(z/z0), z0 = 10 exp(-2/(5 sqrt kap)), kap = .0026
    assert spectra.wind_profile(10.0, 8.0) == 8.0
    root = math.sqrt(0.0026)
    z0 = 10.0 * math.exp(-2.0 / (5.0 * root))
    for z in (2.0, 19.5, 50.0):
        expected = 8.0 * 2.5 * root * math.log(z / z0)
        assert spectra.wind_profile(z, 8.0) == pytest.approx(expected, rel=1e-12)
