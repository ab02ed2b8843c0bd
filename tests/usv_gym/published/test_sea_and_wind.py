"""Constants of wave and gust spectra, wind loads and mean drift, beside separate computations."""

import math

import numpy as np
import pytest

from tests.usv_gym.world.seas import realise
from usv_gym import SeaState, Vessel
from usv_gym.physics import GRAVITY, spectra, waves, wind

BOAT = Vessel.load("usv75").packed.copy()


def test_constants_of_the_pierson_moskowitz_spectrum() -> None:
    omega, U = np.geomspace(0.05, 500.0, 100_001), 7.0  # wind 19.5 m above the sea
    hs = spectra.pm_height(U / 1.026)
    m0 = float(np.trapezoid(spectra.pm_spectrum(omega, hs), omega))
    assert m0 * GRAVITY**2 / U**4 == pytest.approx(0.0027365, rel=1e-3)
    assert hs * GRAVITY / U**2 == pytest.approx(0.2092, rel=1e-3)
    period = spectra.pm_peak_period(0.5)
    peak = 2.0 * math.pi / period
    assert peak * math.sqrt(0.5 / GRAVITY) == pytest.approx(0.4012, rel=1e-3)
    assert peak == pytest.approx(1.777, rel=0.01)
    assert period == pytest.approx(3.54, rel=0.01)
    assert GRAVITY * period**2 / (2.0 * math.pi) == pytest.approx(19.5, rel=0.01)


def test_bins_of_equal_energy() -> None:
    frequencies = (np.arange(50) + 0.5) / 50
    spectra.to_pm_frequencies(0.5, frequencies)
    scale = math.sqrt(9.81 / GRAVITY)  # the published frequencies are for g = 9.81 m/s2
    assert frequencies[0] * scale == pytest.approx(1.283, abs=5e-4)
    assert frequencies[-1] * scale == pytest.approx(5.935, abs=5e-4)
    rows = realise(SeaState(hs=0.5, components=50)).waves
    np.testing.assert_allclose(rows[waves.AMPLITUDE], 0.025, rtol=1e-12)


# Blendermann 1994, speed boat (A_F 4 m2, A_L 9 m2, Loa 7.5 m). None: not computed.


@pytest.mark.parametrize(
    ("degrees", "expected"), [(30.0, (-0.56968, 0.53821, 0.07992)), (90.0, (None, 0.9, -0.0360))]
)
def test_wind_coefficients(degrees: float, expected: tuple[float | None, ...]) -> None:
    found = wind.coefficients(math.radians(degrees), BOAT)
    for got, want in zip(found, expected, strict=True):
        assert want is None or got == pytest.approx(want, rel=1e-4)


@pytest.mark.parametrize(
    ("degrees", "expected"),
    [
        (0.0, (-134.64, None, None)),
        (30.0, (-139.46, 296.44, 330.15)),
        (90.0, (None, 495.72, -148.72)),
        (135.0, (131.65, 444.33, -604.42)),
    ],
)
def test_loads_of_10_mps_of_wind(degrees: float, expected: tuple[float | None, ...]) -> None:
    """X, Y (N) and N (N m) of wind from port of the bow on a boat at rest."""
    to = math.radians(degrees) + math.pi
    found = wind.wind_loads(0.0, 0.0, 0.0, 10.0 * math.cos(to), -10.0 * math.sin(to), BOAT)
    for got, want in zip(found, expected, strict=True):
        assert want is None or got == pytest.approx(want, rel=1e-4)
