"""The autoregression of the waves: what it finds, that it dies out, and what it simulates."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from twin.residual import ORDER, RIDGE, ROOT_MAX, fit_autoregression, simulate_waves

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


def largest_root(a: np.ndarray) -> float:
    return float(np.abs(np.roots(np.concatenate([[1.0], -a]))).max())


def simulated(past, coefficients, noise, shocks) -> np.ndarray:
    out = np.full(shocks.shape, math.nan)
    simulate_waves(past, coefficients, noise, np.ones(shocks.shape[1:]), shocks, out)
    return out


def test_a_known_process_is_found_again() -> None:
    N = 100_000
    w = process(N)
    coefficients, noise = fit_autoregression(w)
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
        # the ridge costs next to nothing of what can be foretold
        assert noise[j] == pytest.approx(NOISE[j], rel=0.05)
        # one step ahead, next to the true coefficients
        error = w[ORDER:, j] - coefficients[:, j] @ past
        assert np.std(error) < 1.05 * NOISE[j] < 0.5 * np.std(w[:, j])


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
    coefficients, noise = fit_autoregression(w[:, None])
    assert np.isfinite(coefficients).all() and np.isfinite(noise).all() and (noise >= 0.0).all()
    # rounding of the roots
    assert largest_root(coefficients[:, 0]) <= ROOT_MAX * (1.0 + 1e-6)


def test_columns_do_not_touch_each_other() -> None:
    w = process(400)
    together = fit_autoregression(w)
    for j in range(3):
        alone = fit_autoregression(w[:, j : j + 1])
        # the same sums, but for the order in which memory is read
        np.testing.assert_allclose(together[0][:, j], alone[0][:, 0], rtol=1e-9)
        assert together[1][j] == pytest.approx(alone[1][0], rel=1e-9)


def test_paths_are_the_recursion() -> None:
    rng = np.random.default_rng(3)
    past, shocks = rng.normal(size=(ORDER, 3)), rng.normal(size=(4, 30, 3))
    coefficients = np.column_stack([TRUE, 0.5 * TRUE, np.zeros(ORDER)])
    out = simulated(past, coefficients, NOISE, shocks)
    for d in range(4):
        line = [*past[::-1]]  # oldest first
        for k in range(30):
            last = np.array(line[-1 : -ORDER - 1 : -1])
            line.append(np.sum(coefficients * last, axis=0) + NOISE * shocks[d, k])
        np.testing.assert_allclose(out[d], line[ORDER:], rtol=1e-12, atol=1e-12)


def test_the_mean_path_goes_on_with_the_wave_and_dies_out() -> None:
    w = process(4000, seed=5)
    coefficients, noise = fit_autoregression(w)
    past = w[: -ORDER - 1 : -1].copy()
    mean = simulated(past, coefficients, noise, np.zeros((1, 400, 3)))[0]
    # a second ahead it foretells: better than silence, on average over many starts
    starts = range(100, 3900, 7)
    ahead = np.array(
        [
            simulated(
                w[k - 1 : k - ORDER - 1 : -1].copy(), coefficients, noise, np.zeros((1, 4, 3))
            )[0]
            for k in starts
        ]
    )
    seen = np.array([w[k : k + 4] for k in starts])
    assert (np.mean((seen - ahead) ** 2, axis=0) < 0.8 * np.mean(seen**2, axis=0)).all()
    # slowest root 0.82: after 90 s nothing is left
    assert (np.abs(mean[-40:]) < 1e-6 * np.abs(past).max(axis=0)).all()


def test_simulated_waves_are_as_large_as_the_sample() -> None:
    w = process(4000, seed=7)
    coefficients, noise = fit_autoregression(w)
    shocks = np.random.default_rng(8).normal(size=(2000, 240, 3))
    out = simulated(np.zeros((ORDER, 3)), coefficients, noise, shocks)
    # Ridge and the sample's own spread: the fitted process must be as large within 15 %.
    np.testing.assert_allclose(out[:, -1].std(axis=0), w.std(axis=0), rtol=0.15)
    # and as slow: correlation a second later
    for j in range(3):
        one, two = (
            np.corrcoef(x[..., :-4, j].ravel(), x[..., 4:, j].ravel())[0, 1]
            for x in (w, out[:, 100:])
        )
        assert two == pytest.approx(one, abs=0.1)
