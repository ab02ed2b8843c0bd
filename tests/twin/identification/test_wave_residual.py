"""The autoregression of the waves: what it finds, that it dies out, and what it simulates."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from twin.identification.wave_residual import (
    FACTOR,
    ORDER,
    RIDGE,
    ROOT_MAX,
    SECTOR_SIZE,
    SECTORS,
    fit_sector_ar,
    fit_waves,
    forecast_waves,
    sector_work_size,
    simulate_waves,
)

# A wave of 4 s at 4 Hz, and faster roots: what a boat in a sea leaves, where the noise is some
# 0.4 of the whole.
ROOTS = [0.82 * np.exp(1j * math.pi / 8), 0.4 * np.exp(1j * math.pi / 2), 0.3, -0.4]
POLYNOMIAL = np.real(np.poly([*ROOTS[:2], *np.conj(ROOTS[:2]), *ROOTS[2:]]))
TRUE = -POLYNOMIAL[1:]
NOISE = np.array([0.02, 0.5, 3.0])


def process(N: int, seed: int = 0) -> np.ndarray:
    """Return samples (N, 3) of the process, with other noise in each column."""
    shocks = np.random.default_rng(seed).normal(size=(N + 500, 3)) * NOISE
    return lfilter([1.0], POLYNOMIAL, shocks, axis=0)[500:]


def spectral_radius(a: np.ndarray) -> float:
    return float(np.abs(np.roots(np.concatenate([[1.0], -a]))).max())


def fit_autoregression(w: np.ndarray) -> np.ndarray:
    """Return the coefficients (6, c) of what predicts."""
    coefficients = np.full((ORDER, w.shape[1]), math.nan)
    fit_waves(np.ascontiguousarray(w), coefficients, np.full(2 * len(w) + 12, math.nan))
    return coefficients


def forecast(past: np.ndarray, coefficients: np.ndarray, K: int) -> np.ndarray:
    """Return the next K rows of an autoregression without noise."""
    path = np.full((K + 1, past.shape[1]), math.nan)
    forecast_waves(past, coefficients, path)
    np.testing.assert_array_equal(path[0], past[0])
    return path[1:]


def described(w: np.ndarray, psi: np.ndarray, good: np.ndarray | None = None) -> np.ndarray:
    """Return what is known of the sectors of headings."""
    sectors = np.full((SECTORS, SECTOR_SIZE), math.nan)
    good = np.ones(len(w)) if good is None else good
    fit_sector_ar(w, psi, good, sectors, np.full(sector_work_size(len(w)), math.nan))
    return sectors


def simulated(sectors: np.ndarray, psi: np.ndarray, D: int = 2000, seed: int = 8) -> np.ndarray:
    """Return paths (D, K, 3) of waves on headings."""
    shocks = np.random.default_rng(seed).normal(size=(D, len(psi), 3))
    out = np.full(shocks.shape, math.nan)
    simulate_waves(sectors, psi, shocks, out)
    return out


def coefficients_of(sector: np.ndarray) -> np.ndarray:
    return sector[:FACTOR].reshape(ORDER, 3)


def factor_of(sector: np.ndarray) -> np.ndarray:
    return sector[FACTOR:].reshape(3, 3)


def test_a_known_process_is_found_again() -> None:
    N = 100_000
    w = process(N)
    coefficients = fit_autoregression(w)
    assert coefficients.shape == (ORDER, 3)
    for j in range(3):
        # The ridge is a bias that can be written down; the rest is spread, whose covariance is
        # noise^2 / N times the inverse of the autocovariances (Yule-Walker): 5 of its sds.
        past = np.stack([w[ORDER - 1 - k : N - 1 - k, j] for k in range(ORDER)])
        C = past @ past.T / N
        ridged = C + RIDGE * np.trace(C) / ORDER * np.eye(ORDER)
        expected = np.linalg.solve(ridged, C @ TRUE)
        inverse = np.linalg.inv(ridged)
        sd = NOISE[j] * np.sqrt(np.diag(inverse @ C @ inverse) / N)
        assert (np.abs(coefficients[:, j] - expected) < 5.0 * sd).all()
        # one step ahead, next to the true coefficients
        error = w[ORDER:, j] - coefficients[:, j] @ past
        assert np.std(error) < 1.05 * NOISE[j] < 0.5 * np.std(w[:, j])


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    rows=st.integers(3, 7),
    size=st.floats(0.02, 0.1),
    power=st.floats(1.0, 2.5),
)
def test_jump_in_the_last_rows_does_not_go_on(seed, rows, size, power) -> None:
    w = np.random.default_rng(seed).normal(scale=0.002, size=(320, 1))
    w[-rows:, 0] += size * (np.arange(1, rows + 1) / rows) ** power
    past = np.ascontiguousarray(w[: -ORDER - 1 : -1])
    path = forecast(past, fit_autoregression(w), 40)
    assert np.abs(path).max() <= np.abs(w).max()


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    N=st.integers(2 * ORDER + 1, 240),
    grow=st.floats(-0.02, 0.05),
    kind=st.sampled_from(["sine", "white", "drift", "constant", "zero", "walk"]),
)
def test_whatever_it_is_fitted_to_it_is_stable(seed, N, grow, kind) -> None:
    rng, k = np.random.default_rng(seed), np.arange(N)
    w = {
        "sine": np.sin(0.4 * k + rng.uniform(0, 6)) * np.exp(grow * k),
        "white": rng.normal(size=N),
        "drift": 0.1 * k,
        "constant": np.full(N, 2.0),
        "zero": np.zeros(N),
        "walk": np.cumsum(rng.normal(size=N)),
    }[kind]
    coefficients = fit_autoregression(w[:, None])
    assert np.isfinite(coefficients).all()
    # rounding of the roots
    assert spectral_radius(coefficients[:, 0]) <= ROOT_MAX * (1.0 + 1e-6)
    # and so is what is drawn, on all headings, whichever rows are no good
    good = (rng.uniform(size=N) < 0.8).astype(float)
    psi = np.cumsum(rng.normal(scale=0.1, size=N))
    sectors = described(good[:, None] * np.stack([w, -w, rng.normal() * w], axis=1), psi, good)
    assert np.isfinite(sectors).all()
    for row in sectors:
        assert (np.diag(factor_of(row)) >= 0.0).all() and (
            factor_of(row)[[0, 0, 1], [1, 2, 2]] == 0
        ).all()
        for a in coefficients_of(row).T:
            assert spectral_radius(a) < 1.0


def test_columns_do_not_touch_each_other() -> None:
    w = process(400)
    together = fit_autoregression(w)
    for j in range(3):
        alone = fit_autoregression(w[:, j : j + 1])
        # the same sums, but for the order in which memory is read
        np.testing.assert_allclose(together[:, j], alone[:, 0], rtol=1e-9)


def test_what_is_predicted_is_the_recursion() -> None:
    past = np.random.default_rng(3).normal(size=(ORDER, 3))
    coefficients = np.column_stack([TRUE, 0.5 * TRUE, np.zeros(ORDER)])
    line = [*past[::-1]]  # oldest first
    for _ in range(30):
        line.append(np.sum(coefficients * np.array(line[-1 : -ORDER - 1 : -1]), axis=0))
    np.testing.assert_allclose(
        forecast(past, coefficients, 30), line[ORDER:], rtol=1e-12, atol=1e-12
    )


def test_paths_are_the_recursion_of_the_sector_of_each_heading() -> None:
    rng = np.random.default_rng(3)
    sectors = rng.normal(scale=0.1, size=(SECTORS, SECTOR_SIZE))
    psi, shocks = np.linspace(-4.0, 9.0, 30), rng.normal(size=(4, 30, 3))
    out = np.full(shocks.shape, math.nan)
    simulate_waves(sectors, psi, shocks, out)
    for d in range(4):
        line = [np.zeros(3)] * ORDER  # from a calm on, oldest first
        for k in range(30):
            row = sectors[round(math.degrees(psi[k]) / 15.0) % SECTORS]
            last = np.array(line[-1 : -ORDER - 1 : -1])
            noise = np.tril(factor_of(row)) @ shocks[d, k]
            line.append(np.sum(coefficients_of(row) * last, axis=0) + noise)
        np.testing.assert_allclose(out[d], line[ORDER:], rtol=1e-12, atol=1e-12)


def test_on_one_heading_it_is_yule_and_walker() -> None:
    w = process(240, seed=2)
    sector = described(w, np.full(240, -1.0))[round(math.degrees(-1.0) / 15.0) % SECTORS]
    for j in range(3):
        R = np.array([w[i:, j] @ w[: len(w) - i, j] for i in range(ORDER + 1)]) / len(w)
        R[0] = R[0] * (1.0 + RIDGE) + 1e-12
        a = solve_toeplitz(R[:ORDER], R[1:])
        np.testing.assert_allclose(coefficients_of(sector)[:, j], a, rtol=1e-8)
        left = math.sqrt(R[0] - a @ R[1:])
        assert np.linalg.norm(factor_of(sector)[j]) == pytest.approx(left, rel=1e-9)


def test_each_heading_has_waves_of_its_own() -> None:
    """Height, period, and how sway and yaw come together, are those of the heading."""
    rng, N = np.random.default_rng(4), 4000
    north = np.arange(N) // 200 % 2 == 0

    def lasting(period: float, noise: np.ndarray) -> np.ndarray:
        root = 0.85 * np.exp(2j * math.pi / period)
        return lfilter([1.0], [1.0, -2.0 * root.real, abs(root) ** 2], noise, axis=0)

    noise = rng.normal(size=(N, 3))
    short, long = noise.copy(), noise.copy()
    short[:, 2] = 0.8 * noise[:, 1] + 0.6 * noise[:, 2]
    long[:, 2] = -0.8 * noise[:, 1] + 0.6 * noise[:, 2]
    w = np.where(north[:, None], lasting(8.0, short), 3.0 * lasting(24.0, long))
    good = (np.arange(N) % 200 > 0).astype(float)  # nothing runs across a change of course
    w *= good[:, None]
    sectors = described(w, np.where(north, 0.0, math.pi), good)
    for psi, size, period, joint in ((0.0, 1.0, 8.0, 0.8), (math.pi, 3.0, 24.0, -0.8)):
        true = size * lasting(period, rng.normal(size=(20_000, 3)))
        out = simulated(sectors, np.full(200, psi))[:, 100:]
        # a few changes of course, and a few rows of other headings
        np.testing.assert_allclose(out.std(axis=(0, 1)), true.std(axis=0), rtol=0.15)
        one, two = (
            np.mean(x[..., 4:, 0] * x[..., :-4, 0]) / np.mean(x[..., 0] ** 2) for x in (true, out)
        )
        assert two == pytest.approx(one, abs=0.12)
        corr = np.corrcoef(out[..., 1].ravel(), out[..., 2].ravel())[0, 1]
        assert corr == pytest.approx(joint, abs=0.1)
    # where the boat never sailed: what all have in common
    east = simulated(sectors, np.full(200, math.pi / 2))[:, 100:]
    np.testing.assert_allclose(east.std(axis=(0, 1)), w.std(axis=0), rtol=0.2)
    assert abs(np.corrcoef(east[..., 1].ravel(), east[..., 2].ravel())[0, 1]) < 0.6


def test_rows_that_are_no_good_count_for_nothing() -> None:
    w, psi = process(300, seed=1), np.linspace(0.0, 3.0, 300)
    good = np.ones(300)
    good[:100] = 0.0
    w[:100] = 0.0
    np.testing.assert_allclose(
        described(w, psi, good), described(w[100:].copy(), psi[100:].copy()), rtol=1e-9, atol=1e-12
    )
