"""Waves: surface, first-order loads against quadrature, mean drift."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.usv_gym.world.seas import realise
from usv_gym import SeaState, Vessel
from usv_gym.physics import GRAVITY, spectra, waves

BOAT = Vessel.load("usv75")
RHO_G = BOAT.values["water_density"] * GRAVITY
LENGTH, BEAM, DRAFT = (BOAT.values[key] for key in ("length_waterline", "beam", "draft"))
BOX = BOAT.packed.copy()
BOX["block_coefficient"] = 1.0  # the loads are those of a box times the block coefficient
BOX["mass"] = BOAT.values["water_density"] * LENGTH * BEAM * DRAFT
BOX["A_wp"] = LENGTH * BEAM
BOX["GM_L"], BOX["GM_T"] = LENGTH**2 / (12.0 * DRAFT), BEAM**2 / (12.0 * DRAFT)


def components(
    k: np.ndarray, to: np.ndarray, amplitude: np.ndarray, phase: np.ndarray
) -> np.ndarray:
    rows = np.zeros((waves.WAVE_ROWS, len(k)))
    rows[waves.OMEGA] = np.sqrt(GRAVITY * k)
    rows[waves.K_NORTH], rows[waves.K_EAST] = k * np.cos(to), k * np.sin(to)
    rows[waves.PHASE], rows[waves.AMPLITUDE] = phase, amplitude
    rows[waves.PRESSURE] = RHO_G * amplitude * -np.expm1(-k * DRAFT) / k
    rows[waves.BOTTOM] = k / np.expm1(k * DRAFT)
    return rows


def loads(
    x: float, y: float, psi: float, t: float, rows: np.ndarray, p: np.ndarray = BOX
) -> np.ndarray:
    """Return X, Y, N."""
    factors = waves.factor_workspace(rows.shape[1])
    waves.box_factors(psi, rows, p, 6, factors)
    return np.array(waves.first_order_loads(x, y, psi, t, rows, p, 3, factors))[:3]


def vertical_loads(
    x: float, y: float, psi: float, t: float, rows: np.ndarray, p: np.ndarray = BOX
) -> np.ndarray:
    """Return Z (down), K (starboard down), M (bow up)."""
    factors = waves.factor_workspace(rows.shape[1])
    waves.box_factors(psi, rows, p, 6, factors)
    six = np.array(waves.first_order_loads(x, y, psi, t, rows, p, 6, factors))
    np.testing.assert_array_equal(six[:3], loads(x, y, psi, t, rows, p))
    return six[3:6]


def quadrature(x: float, y: float, psi: float, t: float, row: np.ndarray) -> np.ndarray:
    """Return X, Y (N), N (N m), Z (N, down), K, M (N m) of one wave on the box by quadrature.

    Gauss-Legendre quadrature of the pressure on the bottom, and of its horizontal gradient over the
    volume, which by Gauss' theorem equals the pressure on the sides.
    """
    nodes, weights = np.polynomial.legendre.leggauss(48)
    a, b = 0.5 * LENGTH * nodes[:, None], 0.5 * BEAM * nodes[None, :]
    area = 0.25 * LENGTH * BEAM * weights[:, None] * weights[None, :]
    k = math.hypot(row[waves.K_NORTH], row[waves.K_EAST])
    c, s = math.cos(psi), math.sin(psi)
    k_x = row[waves.K_NORTH] * c + row[waves.K_EAST] * s
    k_y = row[waves.K_EAST] * c - row[waves.K_NORTH] * s
    phase = row[waves.K_NORTH] * x + row[waves.K_EAST] * y - row[waves.OMEGA] * t
    phase = phase + row[waves.PHASE] + k_x * a + k_y * b
    z = -0.5 * DRAFT * (1.0 - nodes)
    depth = float(np.sum(0.5 * DRAFT * weights * np.exp(k * z)))
    pressure = RHO_G * row[waves.AMPLITUDE]
    push = pressure * depth * area * np.sin(phase)
    up = pressure * math.exp(-k * DRAFT) * area * np.cos(phase)
    # an upward force at (a, b): K = -b up, M = a up (bow up)
    return np.array(
        [
            k_x * np.sum(push),
            k_y * np.sum(push),
            np.sum(push * (k_y * a - k_x * b)),
            -np.sum(up),
            -np.sum(b * up),
            np.sum(a * up),
        ]
    )


def load_scale(row: np.ndarray) -> np.ndarray:
    """Return the largest force and moment that the pressure gradient could give."""
    k = math.hypot(row[waves.K_NORTH], row[waves.K_EAST])
    force = row[waves.PRESSURE] * LENGTH * BEAM * k
    return np.array([force, force, 0.5 * force * LENGTH])


# ---------------------------------------------------------------- sine, cosine, surface


@given(st.floats(-1e6, 1e6))
@settings(max_examples=500, deadline=None)
def test_sincos_equals_math(x: float) -> None:
    s, c = waves.sincos(x)
    # 2e-15: what its docstring promises for |x| < 1e6
    assert s == pytest.approx(math.sin(x), rel=0, abs=2e-15)
    assert c == pytest.approx(math.cos(x), rel=0, abs=2e-15)


def test_sincos_is_exact_at_the_seams_of_its_reduction() -> None:
    seams = np.concatenate([np.arange(-9, 10), [101, 4_001, 123_457, 636_000]]) * (math.pi / 4)
    for x in np.concatenate([seams, np.nextafter(seams, 1e9), np.nextafter(seams, -1e9)]):
        s, c = waves.sincos(x)
        assert abs(s - math.sin(x)) <= 2e-15
        assert abs(c - math.cos(x)) <= 2e-15
    assert waves.sincos(0.0) == (0.0, 1.0)


@given(st.floats(-3e3, 3e3), st.floats(-3e3, 3e3), st.floats(0.0, 4e3), st.integers(0, 2**32))
@settings(max_examples=60, deadline=None)
def test_elevation_is_the_plain_sum(x: float, y: float, t: float, seed: int) -> None:
    rows = realise(SeaState(hs=0.5), seed).waves
    phase = (
        rows[waves.K_NORTH] * x + rows[waves.K_EAST] * y - rows[waves.OMEGA] * t + rows[waves.PHASE]
    )
    plain = np.sum(rows[waves.AMPLITUDE] * np.cos(phase))
    # phases up to 1e5 rad are rounded to 1e-11 by either sum; amplitudes add up to 1.8 m
    assert waves.elevation(x, y, t, rows) == pytest.approx(plain, abs=1e-10)


# ---------------------------------------------------------------- first-order loads


@given(
    k=st.floats(0.02, 8.0),
    to=st.floats(-math.pi, math.pi),
    psi=st.floats(-7.0, 7.0),
    phase=st.floats(0.0, 6.2),
)
@settings(max_examples=60, deadline=None)
def test_loads_equal_the_pressure_integral(k: float, to: float, psi: float, phase: float) -> None:
    rows = components(np.array([k]), np.array([to]), np.array([0.2]), np.array([phase]))
    got = [*loads(2.0, -5.0, psi, 3.3, rows), *vertical_loads(2.0, -5.0, psi, 3.3, rows)]
    bottom = rows[waves.BOTTOM, 0] * rows[waves.PRESSURE, 0] * LENGTH * BEAM
    scale = [*load_scale(rows[:, 0]), bottom, 0.5 * bottom * BEAM, 0.5 * bottom * LENGTH]
    # 1e-10: required in advance, of the largest load of any phase
    want = quadrature(2.0, -5.0, psi, 3.3, rows[:, 0])
    assert np.all(np.abs(np.array(got) - want) <= 1e-10 * np.array(scale))


@pytest.mark.parametrize("to", [0.0, 0.6, math.pi / 2, 2.5])
def test_a_very_long_wave_lifts_by_its_height_and_tilts_by_its_slope(to: float) -> None:
    """Weight over restoring: heave is the elevation, roll and pitch are its slopes."""
    k, a, phase, v = 1e-4, 0.3, 0.9, BOAT.values
    rows = components(np.array([k]), np.array([to]), np.array([a]), np.array([phase]))
    Z, K, M = vertical_loads(0.0, 0.0, 0.0, 0.0, rows, BOAT.packed.copy())
    weight = v["mass"] * GRAVITY
    # the next terms are k d smaller, 5e-5
    assert -Z / (RHO_G * v["A_wp"]) == pytest.approx(a * math.cos(phase), rel=1e-4)
    slope = -k * a * math.sin(phase)  # of the surface along its direction, upwards
    assert M / (weight * v["GM_L"]) == pytest.approx(slope * math.cos(to), rel=1e-4, abs=1e-12)
    assert K / (weight * v["GM_T"]) == pytest.approx(-slope * math.sin(to), rel=1e-4, abs=1e-12)


@pytest.mark.parametrize(("psi", "silent"), [(0.0, 1), (math.pi / 2, 0)])
def test_loads_with_one_wave_number_zero_are_finite(psi: float, silent: int) -> None:
    # waves to the north along an axis of the boat: k_y or k_x is 0, and so is N
    rows = components(np.array([0.8]), np.array([0.0]), np.array([0.3]), np.array([0.9]))
    got = loads(0.0, 0.0, psi, 0.0, rows)
    assert np.all(np.isfinite(got))
    scale = load_scale(rows[:, 0])
    assert abs(got[silent]) <= 1e-15 * scale[silent]
    assert abs(got[2]) <= 1e-15 * scale[2]
    assert abs(got[1 - silent]) > 0.1 * scale[0]


@pytest.mark.parametrize("k", [1e-3, 1e-5, 1e-8])
@pytest.mark.parametrize("to", [0.0, 0.6, math.pi / 2])
def test_loads_of_very_long_waves_are_buoyancy_on_a_slope(k: float, to: float) -> None:
    """Long waves: weight of the displaced water times the slope, and N of second order."""
    phase = 0.9
    rows = components(np.array([k]), np.array([to]), np.array([0.3]), np.array([phase]))
    X, Y, N = loads(0.0, 0.0, 0.0, 0.0, rows)
    weight, k_x, k_y = RHO_G * LENGTH * BEAM * DRAFT * 0.3, k * math.cos(to), k * math.sin(to)
    # the next terms are k d / 2 and (k L)^2 / 24 smaller; d = .5 m, L = 6.3 m
    close = {"rel": 3.0 * k, "abs": 1e-15 * weight * k}
    assert pytest.approx(weight * k_x * math.sin(phase), **close) == X
    assert pytest.approx(weight * k_y * math.sin(phase), **close) == Y
    lever = (LENGTH**2 - BEAM**2) / 12.0
    N_long = weight * k_x * k_y * lever * math.cos(phase)
    assert pytest.approx(N_long, rel=3.0 * k + 1e-12, abs=1e-15 * weight * k * LENGTH) == N


def test_loads_scale_with_the_block_coefficient_and_superpose() -> None:
    rng = np.random.default_rng(3)
    k, to = rng.uniform(0.1, 3.0, 7), rng.uniform(0, 6, 7)
    rows = components(k, to, rng.uniform(0.01, 0.1, 7), rng.uniform(0, 6, 7))
    each = [loads(1.0, 2.0, 0.4, 5.0, rows[:, i : i + 1].copy()) for i in range(7)]
    together = loads(1.0, 2.0, 0.4, 5.0, rows)
    # the sum's terms may be taken in another order
    np.testing.assert_allclose(together, np.sum(each, axis=0), rtol=1e-12)
    boat = loads(1.0, 2.0, 0.4, 5.0, rows, BOAT.packed.copy())
    np.testing.assert_allclose(boat, BOAT.values["block_coefficient"] * together, rtol=1e-13)


# ---------------------------------------------------------------- mean drift

UNIT = {0.5: 1e-3, 1.0: 1e-6, 1.5: 1e-2, 2.0: 1e-1, 3.1: 1.0}
"""Last figure of the references, by wave length over ship length."""


@pytest.mark.parametrize(
    ("x", "want"),
    [
        # Qu et al. 2025, Eq (19); up to 1 also a separate computation, to 1e-3
        (0.5, (0.0738, 1.017, 0.0588)),
        (1.0, (0.09, 0.08, -0.01)),
        (1.5, (-0.28, 3.98, -0.16)),
        (2.0, (-1.43, 19.0, -0.23)),
        (3.1, (-8.6, 123.0, 0.66)),
    ],
)
def test_drift_coefficients_as_printed(x: float, want: tuple[float, ...]) -> None:
    for got, expected in zip(waves.drift_coefficients(x), want, strict=True):
        # one unit of the last printed figure
        assert got == pytest.approx(expected, abs=UNIT[x])


def test_limited_drift_is_the_regression_within_its_range() -> None:
    for x in np.linspace(0.2, 1.0, 200):
        c_x, c_y, c_n = waves.drift_coefficients(x)
        # no hull throws back more than all of a beam wave
        assert waves.drift_limited(x) == (c_x, min(c_y, 1.0), c_n)


def test_limited_drift_ends_and_is_continuous() -> None:
    for x in (1e-6, 0.05, 0.2):
        assert waves.drift_limited(x) == waves.drift_limited(0.2)
    for x in (1.3, 1.31, 2.0, 3.1, 50.0):
        # cos(pi/2)^2 is 4e-33, not 0
        assert max(map(abs, waves.drift_limited(x))) < 1e-30
    for seam in (0.2, 1.0, 1.3):
        around = [waves.drift_limited(x) for x in (seam - 1e-9, seam, seam + 1e-9)]
        # slopes are below 10
        assert np.max(np.ptp(around, axis=0)) < 2e-8


def drift_sums(hs: float = 0.5) -> np.ndarray:
    """Return the three sums of mean drift of waves that go north, for a very fine sea."""
    count = 20_000
    omega = (np.arange(count) + 0.5) / count
    spectra.to_pm_frequencies(hs, omega)
    ratio = 2.0 * math.pi * GRAVITY / omega**2 / LENGTH
    load = np.sum([waves.drift_limited(x) for x in ratio], axis=0)
    return 0.5 * RHO_G * LENGTH * hs**2 / (8.0 * count) * load * [1.0, 1.0, LENGTH]


def test_drift_sums_of_a_realised_sea() -> None:
    """A sea of a few components has the drift of its spectrum, in the direction of its waves."""
    direction = math.radians(40.0)
    state = SeaState(hs=0.5, wave_to=direction, components=3)
    sea = realise(state, 5, BOAT.without_table())
    drift = sea.weather["drift_sums"]
    fine = drift_sums()
    np.testing.assert_allclose(drift[0::2], fine * math.cos(direction), rtol=0.01)
    np.testing.assert_allclose(drift[1::2] / drift[0::2], math.tan(direction), rtol=1e-12)
    # small (docs/explanation/ship_and_sea.md, Waves); the printed polynomials give 132 kN
    assert np.max(np.abs(drift)) < 100.0


def test_mean_drift_pushes_along_the_waves() -> None:
    """A head sea pushes astern, a sea from port pushes to starboard ."""
    sea = realise(SeaState(hs=0.5, wave_to=0.0), 5, BOAT.without_table())
    drift = sea.weather["drift_sums"].copy()
    following, head = waves.mean_drift_loads(0.0, drift), waves.mean_drift_loads(math.pi, drift)
    assert following[0] > 0.0
    assert head[0] == pytest.approx(-following[0])
    assert following[1] == 0.0
    # heading west in waves to the north: from port
    X, Y, N = waves.mean_drift_loads(-math.pi / 2, drift)
    assert abs(X) < 1e-12
    assert pytest.approx(drift[2]) == Y
    assert Y > 0.0
    assert pytest.approx(drift[4]) == N
