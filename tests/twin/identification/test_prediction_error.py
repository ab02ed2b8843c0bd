"""The multi-step refit against finite differences, scipy's optimisers, and disturbed data."""

import dataclasses
import math

import numba
import numpy as np
import pytest
from scipy.optimize import least_squares, minimize

from twin.identification.prediction_error import (
    ACT,
    COLUMNS,
    GOOD,
    MIDDLE,
    WIND,
    RefitSettings,
    linearise,
)
from twin.identification.segments import Segments, discard_before
from twin.model import dynamics
from twin.model.rollout import GRID
from twin.model.structure import MODELS, N_TERMS, Structure, structure_of

LENGTH, SPEED, SHAFT = 6.336, 5.4, 6.33
STEPS, EVERY = 20, 2
SETTINGS = RefitSettings(
    span=30.0,
    spacing=2.0,
    horizon=STEPS * GRID,
    every=EVERY,
    sd=np.array([0.35, 0.3, 0.04, 0.2, 0.15, 0.025]),
    offset_sd=np.array([0.15, 0.12, 0.02]),
    scale=0.1,
    knee=1e9,
)
FIXED = dataclasses.replace(SETTINGS, offset_sd=np.full(3, 1e-8))
"""No offset to speak of, so that the problem is one of nonlinear least squares."""
STRUCTURES = [
    pytest.param(
        structure_of(
            name, LENGTH, SPEED, SHAFT, differential=differential, biased=True, current=current
        ),
        id=f"{name}-{'differential' if differential else 'drives'}{'-current' if current else ''}",
    )
    for name in MODELS
    for differential in (False, True)
    for current in (differential == (name == MODELS[0]),)
]
"""Each model with each kind of steering; with a current one of both, so that all pairs are here."""
each_structure = pytest.mark.parametrize("structure", STRUCTURES)

derivative = dynamics.derivative


@numba.njit
def simulate(first, steps, rows, xi, model, offset):
    """Return the states (steps + 1, 6) from a row on: Runge-Kutta's scheme, and nothing else."""
    out, terms = np.empty((steps + 1, 6)), np.empty(N_TERMS)
    k_1, k_2, k_3, k_4 = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    size = rows.shape[0]
    out[0] = rows[first % size, :6]
    out[0, 3:] += offset
    wind = rows[first % size, WIND : WIND + 2]
    for step in range(steps):
        now, then = rows[(first + step) % size], rows[(first + step + 1) % size]
        begin, middle, end = now[ACT : ACT + 4], now[MIDDLE : MIDDLE + 4], then[ACT : ACT + 4]
        s = out[step]
        derivative(s, xi, begin, wind, model, terms, k_1)
        derivative(s + 0.5 * GRID * k_1, xi, middle, wind, model, terms, k_2)
        derivative(s + 0.5 * GRID * k_2, xi, middle, wind, model, terms, k_3)
        derivative(s + GRID * k_3, xi, end, wind, model, terms, k_4)
        out[step + 1] = s + GRID / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)
    return out


def actuators(halves: int, structure: Structure, rng: np.random.Generator) -> np.ndarray:
    """Return actuators every half grid step that chase random calls of 1.5 s."""
    calls = halves // 12 + 1
    n = SHAFT * structure.n_unit
    target = np.hstack([n * rng.uniform(0.5, 1.1, (calls, 2)), rng.uniform(-0.3, 0.3, (calls, 2))])
    out, act = np.empty((halves, 4)), target[0]
    for k in range(halves):
        act = act + 0.2 * (target[k // 12] - act)
        out[k] = act
    return out


def window(
    structure: Structure, xi: np.ndarray, rows: int = 100, noise: float = 0.0, seed: int = 1
) -> np.ndarray:
    """Return a window of a boat with these parameters, and white noise (parts of the weights)."""
    rng = np.random.default_rng(seed)
    out = np.zeros((rows, COLUMNS))
    acts = actuators(2 * rows, structure, rng)
    out[:, ACT : ACT + 4], out[:, MIDDLE : MIDDLE + 4] = acts[::2], acts[1::2]
    out[:, WIND : WIND + 2] = 3.0, -4.0
    out[:, GOOD] = 1.0
    out[0, :6] = 10.0, -20.0, 0.5, 5.0, 0.2, 0.05
    out[:, :6] = simulate(0, rows - 1, out, xi, structure.terms, np.zeros(3))
    out[:, :6] += noise * SETTINGS.sd * rng.normal(size=(rows, 6))
    return out


def a_boat(structure: Structure, seed: int = 5) -> np.ndarray:
    """Return the parameters of some boat half a standard deviation from the prior."""
    return structure.mean + 0.5 * structure.sd * np.random.default_rng(seed).normal(
        size=len(structure)
    )


def errors(first, rows, xi, structure, offset=None) -> np.ndarray:
    """Return the errors of a segment's samples (6 m,), in standard deviations."""
    offset = np.zeros(3) if offset is None else offset
    path = simulate(first, STEPS, rows, xi, structure.terms, offset)[EVERY::EVERY]
    seen = rows[(first + np.arange(EVERY, STEPS + 1, EVERY)) % len(rows), :6]
    return ((seen - path) / SETTINGS.sd).ravel()


def quadratic(first, rows, xi, structure, settings=SETTINGS):
    p = len(structure)
    H, b = np.full((p, p), math.nan), np.full(p, math.nan)
    own = Segments(structure.terms, structure.mean, np.eye(p), settings, 1)
    c = linearise(first, rows, xi, structure.terms, own.config, own.work.line, H, b)
    return c, b, H


def segments_of(structure, rows, settings, starts, cov=None) -> Segments:
    cov = np.diag(structure.sd**2) if cov is None else cov
    segments = Segments(structure.terms, structure.mean, cov, settings, len(starts))
    for first in starts:
        segments.add(first, rows, segments.params)
    return segments


def weights_of(segments: Segments) -> np.ndarray:
    """Return how much each segment counts at the parameters found."""
    q = segments.costs(segments.params)
    return np.minimum(1.0, segments.settings.knee / np.maximum(q, 1e-12))


STARTS = tuple(range(0, 80, 8))


@each_structure
def test_quadratic_is_that_of_finite_differences(structure) -> None:
    xi, p = a_boat(structure), len(structure)
    rows = window(structure, a_boat(structure, 6), noise=0.3)
    first, rng = 37, np.random.default_rng(0)
    c, b, H = quadratic(first, rows, xi, structure)
    e = errors(first, rows, xi, structure)
    unit, h = np.concatenate([structure.sd, SETTINGS.offset_sd]), 1e-4
    J = np.empty((len(e), p + 3))  # of the errors, by parameters and offset in prior sds
    for k, step in enumerate(h * np.diag(unit)):
        up, down = (
            errors(first, rows, xi + s * step[:p], structure, s * step[p:]) for s in (1, -1)
        )
        J[:, k] = (up - down) / (2.0 * h)
    # least squares over the offset, explicitly, at the point and about it
    free = np.vstack([J[:, p:], np.eye(3)])
    assert np.linalg.norm(J[:, :p]) > 1.0

    def least(step: np.ndarray) -> float:
        target = np.concatenate([e + J[:, :p] @ step, np.zeros(3)])
        return float(np.sum((target - free @ np.linalg.lstsq(free, target, rcond=None)[0]) ** 2))

    # differences: h^2 times third derivatives
    assert c == pytest.approx(least(np.zeros(p)), rel=1e-6)
    for step in rng.normal(size=(10, p)):
        move = step * structure.sd
        assert c - 2.0 * b @ move + move @ H @ move == pytest.approx(least(step), rel=1e-6)
    # and the matrices themselves, by the Schur complement
    A, g = J.T @ J, -J.T @ e
    A[p:, p:] += np.eye(3)
    gone = A[:p, p:] @ np.linalg.inv(A[p:, p:])
    scaled = H * np.outer(structure.sd, structure.sd)
    np.testing.assert_allclose(
        scaled, A[:p, :p] - gone @ A[p:, :p], atol=1e-6 * np.abs(scaled).max()
    )
    pull = b * structure.sd
    np.testing.assert_allclose(pull, g[:p] - gone @ g[p:], atol=1e-6 * np.abs(pull).max())
    assert (H == H.T).all()


@each_structure
def test_rows_wrap_around(structure) -> None:
    rows = window(structure, a_boat(structure), noise=0.3)
    # row k at k modulo 40
    ring = np.vstack([rows[80:100], rows[60:80]])
    straight, around = (quadratic(70, part, structure.mean, structure) for part in (rows, ring))
    for a, b in zip(straight, around, strict=True):
        np.testing.assert_array_equal(a, b)


def prior_of(structure, xi) -> np.ndarray:
    return (xi - structure.mean) / structure.sd


@each_structure
def test_fit_is_that_of_least_squares(structure) -> None:
    rows = window(structure, a_boat(structure), noise=0.3)
    segments = segments_of(structure, rows, FIXED, STARTS)
    assert segments.fit(rows, tolerance=1e-13)

    def residuals(step: np.ndarray) -> np.ndarray:
        xi = structure.mean + step * structure.sd
        parts = [errors(first, rows, xi, structure) for first in STARTS]
        return np.concatenate([math.sqrt(FIXED.scale) * np.concatenate(parts), step])

    best = least_squares(
        residuals, np.zeros(len(structure)), jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-12
    )
    assert np.abs(best.x).max() > 0.1
    np.testing.assert_allclose(prior_of(structure, segments.params), best.x, atol=1e-5)
    assert segments.objective(segments.params) == pytest.approx(2.0 * best.cost, rel=1e-9)
    # covariance: inverse of the normal matrix, in prior standard deviations
    cov = segments.cov / np.outer(structure.sd, structure.sd)
    np.testing.assert_allclose(cov, np.linalg.inv(best.jac.T @ best.jac), atol=1e-5)
    assert (segments.cov == segments.cov.T).all()


@each_structure
def test_robust_fit_is_the_least_of_its_objective(structure) -> None:
    settings = dataclasses.replace(FIXED, knee=0.1)
    rows = window(structure, a_boat(structure), noise=0.3)
    rows[30:34, :2] += 1.0  # one part is disturbed
    segments = segments_of(structure, rows, settings, STARTS)
    segments.fit(rows, iterations=200, tolerance=1e-14)
    m = 6 * STEPS // EVERY

    def objective(step: np.ndarray) -> float:
        xi, total = structure.mean + step * structure.sd, float(step @ step)
        for first in STARTS:
            q = np.sum(errors(first, rows, xi, structure) ** 2) / m
            knee = settings.knee
            total += settings.scale * m * (q if q <= knee else knee * (1.0 + math.log(q / knee)))
        return total

    def slope(step: np.ndarray, h: float = 1e-4) -> np.ndarray:
        moves = h * np.eye(len(step))
        return np.array([objective(step + d) - objective(step - d) for d in moves]) / (2.0 * h)

    found = prior_of(structure, segments.params)
    assert segments.objective(segments.params) == pytest.approx(objective(found), rel=1e-9)
    far = found + 0.05 * np.random.default_rng(2).normal(size=len(found))
    best = minimize(objective, far, jac=slope, method="BFGS", options={"gtol": 1e-8})
    weights = weights_of(segments)
    assert weights.min() < 0.5 and np.abs(best.x).max() > 0.1
    np.testing.assert_allclose(found, best.x, atol=1e-5)


@each_structure
def test_gradual_refits_reach_the_fit(structure) -> None:
    settings = dataclasses.replace(FIXED, knee=0.1)
    rows = window(structure, a_boat(structure), noise=0.2)
    at_once, slowly = (segments_of(structure, rows, settings, STARTS) for _ in range(2))
    at_once.fit(rows, iterations=200, tolerance=1e-14)
    for _ in range(150):
        slowly.relinearise(rows, 3)
        slowly.solve()
    away = (slowly.params - at_once.params) / structure.sd
    np.testing.assert_allclose(away, 0.0, atol=1e-5)
    unit = np.outer(structure.sd, structure.sd)
    np.testing.assert_allclose(slowly.cov / unit, at_once.cov / unit, atol=1e-5)


@each_structure
def test_segments_that_blow_up_are_left_out(structure) -> None:
    rows = window(structure, a_boat(structure))
    wild = structure.mean.copy()
    for name in ("X_uu", "X_u|u|"):
        if name in structure.parameters:
            wild[structure.parameters.index(name)] = 10.0
    p = len(structure)
    H, b = np.full((p, p), 7.0), np.full(p, 7.0)
    own = Segments(structure.terms, structure.mean, np.eye(p), SETTINGS, 1)
    c = linearise(0, rows, wild, structure.terms, own.config, own.work.line, H, b)
    assert c == math.inf and (H == 7.0).all() and (b == 7.0).all()
    segments = segments_of(structure, rows, SETTINGS, STARTS[:3])
    kept = segments.first.copy(), segments.H.copy(), segments.state.at.copy()
    segments.add(40, rows, wild)
    rows[50, :6] = math.nan
    segments.add(50, rows, structure.mean)
    for before, after in zip(kept, (segments.first, segments.H, segments.state.at), strict=True):
        np.testing.assert_array_equal(before, after)
    # nor does a wild step spoil those that are there
    segments.params[:] = wild
    segments.relinearise(rows, 10)
    np.testing.assert_array_equal(segments.H, kept[1])
    segments.solve()
    assert np.isfinite(segments.params).all()


def test_a_new_segment_replaces_the_oldest_and_old_ones_go() -> None:
    structure = STRUCTURES[0].values[0]
    rows = window(structure, a_boat(structure))
    segments = segments_of(structure, rows, SETTINGS, (0, 8, 16))
    segments.add(24, rows, structure.mean)
    assert sorted(segments.first) == [8, 16, 24]
    discard_before(16, segments.state)
    assert sorted(segments.first) == [-1, 16, 24]
    assert (segments.costs(structure.mean) > 0.0).sum() == 2
    segments.solve()
    assert not np.array_equal(segments.params, structure.mean)
    segments.reset()
    assert (segments.first == -1).all()
    np.testing.assert_array_equal(segments.params, structure.mean)
    np.testing.assert_array_equal(segments.cov, np.diag(structure.sd**2))


def test_without_segments_the_prior_stays() -> None:
    structure = STRUCTURES[0].values[0]
    segments = Segments(structure.terms, structure.mean, np.diag(structure.sd**2), SETTINGS, 4)
    segments.relinearise(np.zeros((8, COLUMNS)), 4)
    segments.solve()
    np.testing.assert_allclose(segments.params, structure.mean, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(np.sqrt(np.diag(segments.cov)), structure.sd, rtol=1e-9)


def test_a_damped_solution_lies_between_and_says_nothing_of_the_covariance() -> None:
    structure = STRUCTURES[0].values[0]
    rows = window(structure, a_boat(structure), noise=0.2)
    plain, damped, held = (segments_of(structure, rows, SETTINGS, STARTS) for _ in range(3))
    plain.solve(1)
    damped.solve(1, damping=10.0)
    held.solve(1, damping=1e12)
    whole, part = (np.linalg.norm(prior_of(structure, s.params)) for s in (plain, damped))
    assert 0.0 < part < whole
    np.testing.assert_allclose(prior_of(structure, held.params), 0.0, atol=1e-6)
    # the damping is a means of finding the least; it says nothing of how sure that is
    np.testing.assert_array_equal(held.cov, held.prior_cov)
