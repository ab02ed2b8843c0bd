"""Bounds of physics: any estimate is brought inside, none inside is touched."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.identification.filter_settings import plain_settings
from twin.identification.physical_bounds import BOUNDS, keep_physical, physical_bounds
from twin.model.structure import N_STATES
from twin.particulars import Particulars
from twin.predictors.dsw_ukf_plus import PlusPredictor
from twin.predictors.ukf import UKFPredictor
from twin.sim.bridge import particulars_of
from usv_gym import Vessel

VESSELS = ("usv75", "otter", "wamv16", "telemetron", "kvlcc2_l7")


def bounds_of(boat: Particulars) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the bounds of a boat, and mean and covariance of its prior."""
    given = plain_settings(boat)
    args = given.structure, given.xi0, boat.speed, boat.shaft_speed, given.share
    return physical_bounds(*args), given.xi0, given.xi0_cov


@pytest.mark.parametrize("vessel", VESSELS)
def test_every_bound_is_asked_and_kept_by_the_prior(vessel):
    boat = particulars_of(Vessel.load(vessel))
    bounds, mean, _ = bounds_of(boat)
    assert bounds.shape == (BOUNDS, len(mean) + 1)
    values = bounds[:, :-1] @ mean
    assert (bounds[:, -1] < 0.0).all()
    np.testing.assert_allclose(values * plain_settings(boat).share, bounds[:, -1], rtol=1e-12)


@settings(max_examples=60, deadline=None)
@given(vessel=st.sampled_from(VESSELS), seed=st.integers(0, 2**32 - 1), size=st.floats(0.1, 30.0))
def test_any_estimate_is_brought_inside(vessel, seed, size):
    bounds, mean, cov = bounds_of(particulars_of(Vessel.load(vessel)))
    rng, n = np.random.default_rng(seed), N_STATES + len(mean)
    x, P = np.zeros(n), np.eye(n)
    sd = np.sqrt(np.diag(cov))
    x[N_STATES:] = mean + size * sd * rng.normal(size=len(mean))
    turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
    scale = np.concatenate([np.ones(N_STATES), sd])
    P = (turn * rng.uniform(0.1, 1.0, n)) @ turn.T * np.outer(scale, scale)
    before, inside = x.copy(), (bounds[:, :-1] @ x[N_STATES:] <= bounds[:, -1]).all()
    # bounds are taken in turn: the next row finishes what one undoes of another
    for _ in range(50):
        keep_physical(x, P, bounds, np.empty(n))
    values = bounds[:, :-1] @ x[N_STATES:]
    assert (values <= bounds[:, -1] + 0.05 * np.abs(bounds[:, -1])).all()
    assert inside == np.array_equal(x, before)
    np.testing.assert_allclose(P, P.T, atol=1e-12 * np.abs(P).max())
    assert np.linalg.eigvalsh(P / np.outer(scale, scale)).min() > -1e-9


def test_moments_are_those_of_a_normal_distribution_cut_off():
    """Against draws: one parameter, half a standard deviation beyond its bound."""
    x, P = np.zeros(N_STATES + 1), np.eye(N_STATES + 1)
    x[-1], P[-1, -1], P[0, -1], P[-1, 0] = 1.0, 4.0, 1.0, 1.0
    draws = np.random.default_rng(1).multivariate_normal(
        x[[0, -1]], [[1.0, 1.0], [1.0, 4.0]], 10**6
    )
    draws = draws[draws[:, 1] <= 0.0]
    keep_physical(x, P, np.array([[1.0, 0.0]]), np.empty(len(x)))
    np.testing.assert_allclose(x[[0, -1]], draws.mean(axis=0), atol=5e-3)
    cut = np.cov(draws.T)
    np.testing.assert_allclose(P[np.ix_([0, -1], [0, -1])], cut, atol=1e-2)


@pytest.mark.parametrize("kind", [UKFPredictor, PlusPredictor])
@pytest.mark.parametrize("seed", range(3))
def test_false_velocities_never_teach_thrust_astern(kind, seed):
    """A boat that slows down the more it is pushed is no boat, whatever the sensors say."""
    boat = particulars_of(Vessel.load("otter"))
    predictor, rng = kind(boat), np.random.default_rng(seed)
    bounds = bounds_of(boat)[0]
    t = x = 0.0
    speed = boat.speed
    for k in range(1200):
        push = 1.0 + 0.5 * np.sin(0.3 * t)
        speed += 0.05 * (1.5 - push - 0.2 * speed / boat.speed)
        x += 0.05 * speed
        z = np.array([x, 0.0, speed, 0.0, 0.0, 0.0, np.nan, np.nan, np.nan, np.nan])
        z[:6] += np.array([0.5, 0.5, 0.05, 0.05, 0.01, 0.01]) * rng.normal(size=6)
        n = boat.shaft_speed * push
        predictor.update(t, 0.05 if k else 0.0, z, np.array([n, n, 0.0, 0.0]))
        t += 0.05
    joint = predictor.joint if kind is PlusPredictor else predictor.ukf
    values = bounds[:, :-1] @ joint.x[N_STATES:]
    assert (values <= bounds[:, -1] + 0.1 * np.abs(bounds[:, -1])).all()
