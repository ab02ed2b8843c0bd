"""The autoregression: finds a linear boat, refits, looks only back, survives bad input."""

import dataclasses
import math

import numpy as np
import pytest

from tests.twin.predictors.learned.test_learners import (
    BOAT,
    HORIZON,
    assert_beats_persistence,
    fitted,
    history,
)
from twin.channels import MEASUREMENTS
from twin.predictors.baselines import GRID, hold_velocity
from twin.predictors.learned.features import lagged
from twin.predictors.learned.varx import VARPredictor

SHIP = dataclasses.replace(BOAT, length=3.0, speed=0.5)
KINDS = ("drives", "one screw", "differential")


def feed(predictor: VARPredictor, rows: np.ndarray, dt: float = GRID, first: float = 0.0) -> None:
    """Hand the rows to the predictor as GPS and compass alone would see them."""
    for k, row in enumerate(rows):
        z = np.full(len(MEASUREMENTS), np.nan)
        z[:2], z[4] = row[:2], row[2]
        predictor.update(first + dt * k, dt if k or first else 0.0, z, row[6:10])


@pytest.mark.parametrize("kind", KINDS)
def test_finds_a_linear_boat(kind: str) -> None:
    """On rows after the fit it is next to exact: the boat is of the family that is fitted."""
    rows = history(kind=kind)
    # what the ridge of 3e-3 leaves
    assert_beats_persistence(fitted(rows[:241]), rows, np.arange(245, 400 - HORIZON, 4), 0.1)


def test_a_slow_ship_has_longer_steps() -> None:
    """The step follows the time in which a ship sails its length; any horizon will do."""
    assert VARPredictor(BOAT).stride == 1
    predictor = fitted(history(2000, boat=SHIP)[:1600], SHIP)
    assert predictor.stride == 5
    rows = history(2000, boat=SHIP)
    assert_beats_persistence(predictor, rows, np.arange(1605, 1900, 10), 0.2)
    plan = rows[None, 1606:1646, 6:10]
    whole = predictor.forecast(rows, np.array([1605]), plan)
    for K in (1, 4, 5, 13):
        part = predictor.forecast(rows, np.array([1605]), plan[:, :K])
        # a step of the ship that the plan ends within: its last command is held
        exact = K // predictor.stride * predictor.stride
        assert part.shape == (1, K, 6)
        np.testing.assert_allclose(part[:, :exact], whole[:, :exact], atol=1e-12)


def test_refits_in_time_and_forgets() -> None:
    """First after 20 s, then every 10 s; velocities are held before; a long gap starts again."""
    rows = history()
    predictor, fits = VARPredictor(BOAT), []
    for k in range(180):
        feed(predictor, rows[k : k + 1], first=GRID * k)
        if not any(predictor._fit is fit for fit in [None, *fits]):
            fits.append(predictor._fit)
            assert len(predictor._rows) - 1 == round((20.0 + 10.0 * (len(fits) - 1)) / GRID)
        if k == 40:
            held = predictor.predict(rows[41:81, 6:10], GRID)
            after = held.t - held.t0
            expected = hold_velocity(held.start, held.start[3:], after)
            np.testing.assert_allclose(held.mean, expected, atol=1e-9)
    assert len(fits) == 3
    fit = predictor._fit
    first = predictor.predict(rows[180:220, 6:10], GRID)
    again = predictor.predict(rows[180:220, 6:10], GRID)
    assert np.array_equal(first.mean, again.mean) and np.array_equal(first.cov, again.cov)
    assert predictor._fit is fit
    predictor.update(1e4, 9e3, np.full(len(MEASUREMENTS), np.nan), rows[0, 6:10])
    feed(predictor, rows[:84], first=1e4 + GRID)
    assert predictor._fit is not fit
    predictor.reset()
    assert predictor._fit is None and predictor._due == predictor.first


def test_actuators_follow_with_lag_and_rate() -> None:
    """A first-order lag for the shafts; the angle no faster than the drive turns."""
    boat = dataclasses.replace(BOAT, shaft_lag=0.5, steer_lag=0.1, steer_rate=0.3)
    act = lagged(np.array([10.0, 10.0, 0.0, 0.3]), np.array([20.0, 10.0, 0.3, 0.29]), 0.25, boat)
    share = 1.0 - math.exp(-2.5)
    expected = [20.0 - 10.0 * math.exp(-0.5), 10.0, 0.075, 0.3 - 0.01 * share]
    np.testing.assert_allclose(act, expected)


def test_unreliable_rows_teach_nothing() -> None:
    """A fit to a history with a false stretch is that to the sound rows, if it is marked."""
    rows, rng = history(), np.random.default_rng(3)
    false = rows.copy()
    false[100:140, :10] += rng.normal(size=(40, 10))
    unreliable = np.zeros(len(rows), dtype=np.bool_)
    predictor = VARPredictor(BOAT)
    sound = predictor._products_of(rows, unreliable, 0)
    unreliable[100:140] = True
    marked = predictor._products_of(false, unreliable, 0)
    np.testing.assert_array_equal(marked, predictor._products_of(rows, unreliable, 0))
    assert 0 < sound[0, 0] - marked[0, 0] <= 40 + predictor.order


def test_what_was_learned_outlasts_a_long_gap() -> None:
    """After ten minutes without rows the fit is there, and the next one adds to it."""
    predictor = VARPredictor(BOAT)
    feed(predictor, history()[:241])
    count, before = predictor._products[0, 0], predictor._fit
    predictor.update(700.0, 640.0, np.full(len(MEASUREMENTS), np.nan), history()[0, 6:10])
    assert len(predictor._rows) == 1
    feed(predictor, history()[:60], first=700.25)
    assert predictor._fit is before and predictor._products[0, 0] == count
    feed(predictor, history()[60:121], first=715.25)
    assert predictor._products[0, 0] > count and predictor._fit is not before
