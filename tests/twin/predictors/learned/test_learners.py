"""What holds of each learner: it looks only back, and no past makes its forecasts run away."""

from collections.abc import Callable

import numpy as np
import pytest

from twin.particulars import Particulars
from twin.predictors.baselines import GRID, HistoryPredictor, Persistence, hold_velocity
from twin.predictors.learned.features import integrate, lagged, thrust_features
from twin.predictors.learned.lstm import LSTMPredictor
from twin.predictors.learned.varx import VARPredictor

BOAT = Particulars(
    name="test", length=6.0, beam=2.5, draft=0.5, mass=3000.0, speed=5.0, shaft_speed=20.0
)
HORIZON = 40


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


def fitted(rows: np.ndarray, boat: Particulars = BOAT) -> VARPredictor:
    """Return an autoregression that was fitted to rows."""
    predictor = VARPredictor(boat)
    sound = np.zeros(len(rows), dtype=np.bool_)
    predictor._fit = predictor._solve(predictor._products_of(rows, sound, 0))
    return predictor


def trained(rows: np.ndarray, epochs: int = 8, seed: int = 0) -> LSTMPredictor:
    """Return a net that was trained on rows."""
    pytest.importorskip("torch")
    predictor = LSTMPredictor(BOAT, seed=seed)
    predictor.epochs = epochs
    predictor._net = predictor._train(rows)
    return predictor


def ask(predictor: HistoryPredictor, rows: np.ndarray, origins: np.ndarray) -> np.ndarray:
    """Return forecasts over the horizon under the commands that followed."""
    ahead = origins[:, None] + np.arange(1, HORIZON + 1)
    return np.asarray(predictor.forecast(rows, origins, rows[ahead, 6:10]))


def assert_beats_persistence(
    predictor: HistoryPredictor, rows: np.ndarray, origins: np.ndarray, share: float
) -> None:
    """Check that the mean error of each state is below a share of that of held velocities."""
    truth = rows[origins[:, None] + np.arange(1, HORIZON + 1), :6]
    ours, held = (
        np.abs(ask(one, rows, origins) - truth).mean(axis=(0, 1))
        for one in (predictor, Persistence(predictor.particulars))
    )
    assert (ours < share * held).all(), (ours, held)


each_learner = pytest.mark.parametrize("learn", [fitted, trained])


def spoiled(rows: np.ndarray, kind: str) -> np.ndarray:
    """Return a history of 241 rows with something wrong, which no learner may stumble over."""
    rng = np.random.default_rng(5)
    if kind == "constant":
        rows[:] = rows[50]
    elif kind == "at rest":
        rows[:] = 0.0
    elif kind == "few rows":
        rows = rows[:20]
    elif kind == "one row":
        rows = rows[:1]
    elif kind == "all NaN":
        rows[:] = np.nan
    elif kind == "some NaN":
        rows[rng.random(rows.shape) < 0.003] = np.nan
    elif kind == "NaN block":
        rows[60:120] = np.nan
    elif kind == "NaN at the end":
        rows[230:, 3:] = np.nan
    elif kind == "wild":
        rows[rng.integers(0, 241, 3), 3:6] = 1e200
        rows[rng.integers(0, 241, (3, 1)), [6, 10]] = 1e200
        rows[100] = np.inf
    elif kind == "constant commands":
        rows[:, 6:] = rows[5, 6:]
    elif kind == "growing":
        rows[:, 3:6] *= np.exp(0.01 * np.arange(241))[:, None]
    elif kind == "noise":
        rows[:, 3:6] += rng.normal(scale=(3.0, 3.0, 0.5), size=(241, 3))
    return rows


LITTLE = ("few rows", "one row", "all NaN")
KINDS = ("some NaN", "NaN block", "NaN at the end", "wild", "constant commands", "growing", "noise")


@each_learner
@pytest.mark.parametrize("kind", [*LITTLE, "constant", "at rest", *KINDS])
def test_forecasts_are_always_finite_and_within_the_envelope(
    learn: Callable[[np.ndarray], HistoryPredictor], kind: str
) -> None:
    """Whatever the past, forecasts are finite and bounded; too little of it: persistence."""
    rows = spoiled(history(241), kind)
    predictor = learn(rows)
    if isinstance(predictor, LSTMPredictor):
        holds = predictor._net is None
        assert kind in ("growing", "noise") or holds == (kind not in KINDS)
    else:
        holds = predictor._fit is None
        assert holds == (kind in LITTLE)
    origins = np.unique(np.linspace(0, len(rows) - 1, 30).astype(int))
    plans = np.random.default_rng(2).normal(scale=50.0, size=(len(origins), HORIZON, 4))
    plans[::3, 7] = np.nan
    plans[0, 9] = 1e200
    path = predictor.forecast(rows, origins, plans)
    assert path.shape == (len(origins), HORIZON, 6)
    assert np.isfinite(path).all()
    assert (np.abs(path[..., 3:]) <= predictor.bound + 1e-9).all()
    U = 3.0 * BOAT.speed
    np.testing.assert_allclose(predictor.bound, [U, U, U / BOAT.length])
    if holds and kind != "all NaN":
        held = hold_velocity(rows[origins, :6], rows[origins, 3:6], GRID * np.arange(1.0, 41.0))
        assert np.allclose(path, held)
