"""The autoregression: finds a linear boat, refits, looks only back, survives bad input."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tests.twin.predictors.learned.spoiled import spoiled
from twin.channels import MEASUREMENTS
from twin.particulars import Particulars
from twin.predictors.baselines import GRID, Persistence, hold_velocity
from twin.predictors.learned.features import integrate, lagged, thrust_features
from twin.predictors.learned.varx import VARPredictor

BOAT = Particulars(
    name="test", length=6.0, beam=2.5, draft=0.5, mass=3000.0, speed=5.0, shaft_speed=20.0
)
SHIP = dataclasses.replace(BOAT, length=3.0, speed=0.5)
HORIZON = 40
KINDS = ("drives", "one screw", "differential")


def history(n: int = 400, kind: str = "drives", boat: Particulars = BOAT) -> np.ndarray:
    """Return rows (n, 14) of a boat that is linear in the thrust of its actuators."""
    rng = np.random.default_rng(0)
    scale = np.array([boat.speed, boat.speed, boat.speed / boat.length])
    slow = boat.length / boat.speed / (BOAT.length / BOAT.speed)
    rows = np.zeros((n, 14))
    nu = np.array([0.8, 0.0, 0.0])
    cmd = act = np.array([boat.shaft_speed] * 2 + [0.0, 0.0])
    for k in range(n):
        rows[k, 6:10], rows[k, 10:] = cmd, act
        rows[k, 3:6] = nu * scale
        if k % round(20 * slow) == 0:
            throttle, angle = rng.uniform(0.7, 1.0, 2), rng.uniform(-0.35, 0.35)
            throttle = throttle if kind == "differential" else throttle[:1]
            helm = 0.0 if kind == "differential" else angle
            cmd = np.concatenate([boat.shaft_speed * throttle * np.ones(2), [helm, helm]])
        after = lagged(act, cmd, GRID, boat)
        push = 0.5 * (thrust_features(act) + thrust_features(after)) / boat.shaft_speed**2
        act = after
        ahead, aside = push[:2].mean(), push[2:4].mean() + 0.3 * (push[0] - push[1])
        tau = 0.1 / slow
        nu = nu + tau * np.array([ahead - nu[0], 0.3 * aside - nu[1], 2.0 * aside - 2.0 * nu[2]])
    rows[1:, :6] = integrate(rows[:1, :6], rows[None, :, 3:6])[0]
    return rows


def learned(rows: np.ndarray, boat: Particulars = BOAT) -> VARPredictor:
    """Return a predictor that was fitted to rows."""
    predictor = VARPredictor(boat)
    sound = np.zeros(len(rows), dtype=np.bool_)
    predictor._fit = predictor._solve(predictor._products_of(rows, sound, 0))
    return predictor


def ask(predictor: VARPredictor | Persistence, rows: np.ndarray, origins: np.ndarray) -> np.ndarray:
    """Return forecasts over the horizon under the commands that followed."""
    ahead = origins[:, None] + np.arange(1, HORIZON + 1)
    return predictor.forecast(rows, origins, rows[ahead, 6:10])


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
    origins = np.arange(245, 400 - HORIZON, 4)
    truth = rows[origins[:, None] + np.arange(1, HORIZON + 1), :6]
    ours = np.abs(ask(learned(rows[:241]), rows, origins) - truth).mean(axis=(0, 1))
    held = np.abs(ask(Persistence(BOAT), rows, origins) - truth).mean(axis=(0, 1))
    # what the ridge of 3e-3 leaves
    assert (ours < 0.1 * held).all(), (ours, held)


def test_a_slow_ship_has_longer_steps() -> None:
    """The step follows the time in which a ship sails its length; any horizon will do."""
    assert VARPredictor(BOAT).stride == 1
    predictor = learned(history(2000, boat=SHIP)[:1600], SHIP)
    assert predictor.stride == 5
    rows = history(2000, boat=SHIP)
    origins = np.arange(1605, 1900, 10)
    truth = rows[origins[:, None] + np.arange(1, HORIZON + 1), :6]
    ours, held = (
        np.abs(ask(p, rows, origins) - truth).mean(axis=(0, 1))
        for p in (predictor, Persistence(SHIP))
    )
    assert (ours < 0.2 * held).all(), (ours, held)
    plan = rows[None, 1606:1646, 6:10]
    whole = predictor.forecast(rows, np.array([1605]), plan)
    for K in (1, 4, 5, 13):
        part = predictor.forecast(rows, np.array([1605]), plan[:, :K])
        # a step of the ship that the plan ends within: its last command is held
        exact = K // predictor.stride * predictor.stride
        assert part.shape == (1, K, 6)
        np.testing.assert_allclose(part[:, :exact], whole[:, :exact], atol=1e-12)


def test_forecast_uses_no_later_row() -> None:
    """Rows after an origin do not change its forecast, rows before do; each stands alone."""
    rows = history()
    predictor = learned(rows[:241])
    origins = np.array([1, 250, 300])
    plans = rows[origins[:, None] + np.arange(1, HORIZON + 1), 6:10]
    before = predictor.forecast(rows, origins, plans)
    for j in range(3):
        alone = predictor.forecast(rows, origins[j : j + 1], plans[j : j + 1])[0]
        np.testing.assert_allclose(alone, before[j], atol=1e-9)
    later = rows.copy()
    later[301:] = np.nan
    assert np.array_equal(predictor.forecast(later, origins, plans), before)
    later[251:, 3:6] += 0.1
    after = predictor.forecast(later, origins, plans)
    assert np.array_equal(after[:2], before[:2])
    assert not np.array_equal(after[2], before[2])


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


HOLDS = ("few rows", "one row", "all NaN")


@pytest.mark.parametrize(
    "kind", ["constant", "at rest", "some NaN", "wild", "growing", "noise", *HOLDS]
)
def test_forecasts_are_always_finite_and_within_the_envelope(kind: str) -> None:
    """Whatever the past, forecasts are finite and bounded."""
    rows = spoiled(history(241), kind, 10)
    predictor = learned(rows)
    assert (predictor._fit is None) == (kind in HOLDS)
    origins = np.unique(np.linspace(0, len(rows) - 1, 30).astype(int))
    plans = np.random.default_rng(2).normal(scale=50.0, size=(len(origins), HORIZON, 4))
    plans[::3, 7] = np.nan
    plans[0, 9] = 1e200
    path = predictor.forecast(rows, origins, plans)
    assert path.shape == (len(origins), HORIZON, 6)
    assert np.isfinite(path).all()
    assert (np.abs(path[..., 3:]) <= predictor.bound + 1e-9).all()


def test_slow_irregular_rows_without_velocities_are_learned() -> None:
    """Rows a second apart, some missing, positions and headings alone: it still predicts."""
    rows = history(481)[::4]
    predictor = VARPredictor(BOAT)
    rng, t = np.random.default_rng(1), 0.0
    for k, row in enumerate(rows):
        dt = 0.0 if k == 0 else float(rng.uniform(0.7, 1.3))
        t += dt
        z = np.full(len(MEASUREMENTS), np.nan)
        if not 50 <= k < 60:
            z[:2], z[4] = row[:2], row[2]
        predictor.update(t, dt, z, row[6:10])
    assert predictor._fit is not None
    ahead = predictor.predict(np.tile(rows[-1, 6:10], (10, 1)), 1.0)
    assert np.isfinite(ahead.mean).all() and np.isfinite(ahead.cov).all()
    assert (np.abs(ahead.mean[:, 3:]) <= predictor.bound).all()


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
