"""The LSTM: learns, repeats itself, looks only back, survives bad input, says what is missing."""

from __future__ import annotations

import copy
import math
import pickle
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from tests.twin.predictors.learned.spoiled import spoiled
from twin.channels import MEASUREMENTS
from twin.particulars import Particulars
from twin.predictors.baselines import GRID, Persistence, hold_velocity
from twin.predictors.learned.lstm import LSTMPredictor, MissingTorch

BOAT = Particulars(
    name="test", length=6.0, beam=2.5, draft=0.5, mass=3000.0, speed=5.0, shaft_speed=20.0
)
DT = 0.25
HORIZON = 40


def history(n: int = 400, seed: int = 0) -> np.ndarray:
    """Return rows (n, 10) of a boat whose speed and turn rate follow the command with a lag."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((n, 10))
    rows[0, 3] = 4.0
    thrust, delta = 20.0, 0.0
    for k in range(1, n):
        if k % 24 == 1:
            thrust, delta = rng.uniform(14.0, 20.0), rng.uniform(-0.35, 0.35)
        x, y, psi, u, v, r = rows[k - 1, :6]
        u += GRID / 3.0 * (5.0 * thrust / 20.0 - u)
        r += GRID / 1.5 * (0.8 * math.sin(delta) - r)
        v += GRID / 1.5 * (-1.5 * r - v)
        psi += GRID * r
        x += GRID * (u * math.cos(psi) - v * math.sin(psi))
        y += GRID * (u * math.sin(psi) + v * math.cos(psi))
        rows[k] = x, y, psi, u, v, r, thrust, thrust, delta, delta
    rows[0, 6:] = rows[1, 6:]
    return rows


def ask(predictor: Any, rows: np.ndarray, origins: np.ndarray) -> np.ndarray:
    """Return forecasts over the horizon under the commands that followed."""
    ahead = origins[:, None] + np.arange(1, HORIZON + 1)
    return np.asarray(predictor.forecast(rows, origins, rows[ahead, 6:]))


def feed(predictor: LSTMPredictor, rows: np.ndarray) -> None:
    """Hand the rows to the predictor as GPS, compass and gyro would see them."""
    for k, row in enumerate(rows):
        c, s = math.cos(row[2]), math.sin(row[2])
        z = np.full(len(MEASUREMENTS), np.nan)
        z[:2] = row[:2]
        z[2:4] = row[3] * c - row[4] * s, row[3] * s + row[4] * c
        z[4], z[5] = row[2], row[5]
        predictor.update(DT * k, DT if k else 0.0, z, row[6:])


@pytest.fixture(scope="module")
def trained() -> LSTMPredictor:
    """Return a predictor that learned from the first 60 s of the history."""
    pytest.importorskip("torch")
    predictor = LSTMPredictor(BOAT)
    predictor._net = predictor._train(history()[:241])
    assert predictor._net is not None
    return predictor


def test_learns_a_simple_boat(trained: LSTMPredictor) -> None:
    """On rows after the training it is far better than holding the velocities."""
    rows = history()
    origins = np.arange(245, 400 - HORIZON, 4)
    truth = rows[origins[:, None] + np.arange(1, HORIZON + 1), :6]
    ours = np.abs(ask(trained, rows, origins) - truth).mean(axis=(0, 1))
    held = np.abs(ask(Persistence(BOAT), rows, origins) - truth).mean(axis=(0, 1))
    assert (ours < 0.5 * held).all(), (ours, held)


def test_path_agrees_with_its_velocities(trained: LSTMPredictor) -> None:
    """Position and heading are the integrals of the predicted velocities."""
    rows = history()
    path = ask(trained, rows, np.array([250, 300]))
    psi, u, v, r = (np.moveaxis(path, -1, 0))[2:]
    assert np.allclose(np.diff(psi), 0.5 * GRID * (r[:, 1:] + r[:, :-1]), atol=1e-12)
    along = 0.5 * (u[:, 1:] + u[:, :-1])
    aside = 0.5 * (v[:, 1:] + v[:, :-1])
    moved = np.hypot(np.diff(path[..., 0]), np.diff(path[..., 1]))
    assert np.allclose(moved, GRID * np.hypot(along, aside), atol=1e-12)


def test_batch_equals_one_by_one(trained: LSTMPredictor) -> None:
    """Forecasts of several origins do not see each other."""
    rows = history()
    origins = np.array([3, 100, 300])
    together = ask(trained, rows, origins)
    for j in range(3):
        assert np.allclose(ask(trained, rows, origins[j : j + 1])[0], together[j], atol=1e-9)


def test_forecast_uses_no_later_row(trained: LSTMPredictor) -> None:
    """Rows after an origin do not change its forecast; rows before do."""
    rows = history()
    origins = np.array([5, 250, 300])
    plans = rows[origins[:, None] + np.arange(1, HORIZON + 1), 6:]
    before = trained.forecast(rows, origins, plans)
    later = rows.copy()
    later[301:] = np.random.default_rng(1).normal(size=later[301:].shape)
    assert np.array_equal(trained.forecast(later, origins, plans), before)
    later[251:] = np.nan
    after = trained.forecast(later, origins, plans)
    assert np.array_equal(after[:2], before[:2])
    assert not np.array_equal(after[2], before[2])


def test_same_seed_same_bits_and_torch_undisturbed() -> None:
    """The seed decides; torch's generator, threads and modes are as before."""
    torch = pytest.importorskip("torch")
    rows = history()[:241]
    origins = np.array([150, 200])
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        torch.manual_seed(7)
        state = torch.get_rng_state()
        with torch.inference_mode():
            answers = []
            for seed, disturb in ((3, 1), (3, 2), (4, 2)):
                predictor = LSTMPredictor(BOAT, seed=seed)
                predictor.epochs = 8
                predictor._net = predictor._train(rows)
                assert torch.get_num_threads() == 2
                assert torch.equal(torch.get_rng_state(), state)
                assert torch.is_inference_mode_enabled()
                answers.append(ask(predictor, rows, origins))
                # whatever torch drew before must not matter
                torch.manual_seed(disturb)
                state = torch.get_rng_state()
    finally:
        torch.set_num_threads(threads)
    assert np.array_equal(answers[0], answers[1])
    assert not np.array_equal(answers[0], answers[2])


def test_trains_once_at_its_time_and_forgets() -> None:
    """Before the time it holds velocities; after it, not; reset() forgets the weights."""
    pytest.importorskip("torch")
    rows = history(150)
    predictor = LSTMPredictor(BOAT, train_at=25.0)
    predictor.epochs = 8
    feed(predictor, rows[:100])
    assert not predictor.trained
    plan = rows[100:140, 6:]
    held = predictor.predict(plan, DT)
    start = held.start
    expected = hold_velocity(start, start[3:], held.t - held.t0)
    assert np.allclose(held.mean, expected, atol=1e-9)
    feed_more = rows[:103]
    predictor.reset()
    feed(predictor, feed_more)
    assert predictor.trained
    net = predictor._net
    assert net is not None
    twin = pickle.loads(pickle.dumps(predictor))
    other = copy.deepcopy(predictor)
    ours = predictor.predict(plan, DT)
    assert np.isfinite(ours.mean).all() and np.isfinite(ours.cov).all()
    assert not np.allclose(ours.mean, hold_velocity(ours.start, ours.start[3:], ours.t - ours.t0))
    for again in (twin, other):
        assert np.array_equal(again.predict(plan, DT).mean, ours.mean)
    feed(predictor, rows[:2])
    assert predictor._net is net
    predictor.reset()
    assert not predictor.trained and predictor._net is None


LEARNS = {"some NaN", "NaN block", "NaN at the end", "wild", "constant commands"}
HOLDS = {"constant", "at rest", "few rows", "one row", "all NaN"}


@pytest.mark.parametrize("kind", sorted(LEARNS | HOLDS | {"noise"}))
def test_forecasts_are_always_finite_and_within_the_envelope(kind: str) -> None:
    """Whatever the past, forecasts are finite and bounded; too little of it: persistence."""
    pytest.importorskip("torch")
    rows = spoiled(history(241), kind, 6)
    predictor = LSTMPredictor(BOAT)
    predictor.epochs = 8
    predictor._net = predictor._train(rows)
    if kind in LEARNS | HOLDS:
        assert (predictor._net is None) == (kind in HOLDS)
    origins = np.unique(np.linspace(0, len(rows) - 1, 30).astype(int))
    plans = np.random.default_rng(2).normal(scale=50.0, size=(len(origins), HORIZON, 4))
    plans[::3, 7] = np.nan
    plans[0, 9] = 1e200
    path = predictor.forecast(rows, origins, plans)
    assert path.shape == (len(origins), HORIZON, 6)
    assert np.isfinite(path).all()
    U = 3.0 * BOAT.speed
    limit = np.array([U, U, U / BOAT.length]) + 1e-9
    assert (np.abs(path[..., 3:]) <= limit).all()
    if kind in HOLDS - {"all NaN"}:
        held = hold_velocity(rows[origins, :6], rows[origins, 3:6], GRID * np.arange(1.0, 41.0))
        assert np.allclose(path, held)


def test_missing_torch_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error names the command, and is an ImportError."""
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(MissingTorch, match="pip install torch") as caught:
        LSTMPredictor(BOAT)
    assert isinstance(caught.value, ImportError)


def test_module_does_not_import_torch() -> None:
    """Importing the module costs no torch."""
    code = "import sys, twin.predictors.learned.lstm; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
