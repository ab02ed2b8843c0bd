"""The LSTM: learns, repeats itself, looks only back, survives bad input, says what is missing."""

import math
import sys

import numpy as np
import pytest

from tests.twin.predictors.learned.test_learners import (
    BOAT,
    HORIZON,
    ask,
    assert_beats_persistence,
    history,
    trained,
)
from twin.channels import MEASUREMENTS
from twin.predictors.baselines import GRID, hold_velocity
from twin.predictors.learned.lstm import LSTMPredictor, MissingTorch

DT = 0.25


def feed(predictor: LSTMPredictor, rows: np.ndarray) -> None:
    """Hand the rows to the predictor as GPS, compass and gyro would see them."""
    for k, row in enumerate(rows):
        c, s = math.cos(row[2]), math.sin(row[2])
        z = np.full(len(MEASUREMENTS), np.nan)
        z[:2] = row[:2]
        z[2:4] = row[3] * c - row[4] * s, row[3] * s + row[4] * c
        z[4], z[5] = row[2], row[5]
        predictor.update(DT * k, DT if k else 0.0, z, row[6:10])


@pytest.fixture(scope="module")
def net() -> LSTMPredictor:
    """Return a predictor that learned from the first 60 s of the history."""
    return trained(history()[:241], LSTMPredictor.epochs)


def test_learns_a_simple_boat(net: LSTMPredictor) -> None:
    """On rows after the training it is far better than holding the velocities."""
    assert_beats_persistence(net, history(), np.arange(245, 400 - HORIZON, 4), 0.5)


def test_path_agrees_with_its_velocities(net: LSTMPredictor) -> None:
    """Position and heading are the integrals of the predicted velocities."""
    rows = history()
    path = ask(net, rows, np.array([250, 300]))
    psi, u, v, r = (np.moveaxis(path, -1, 0))[2:]
    assert np.allclose(np.diff(psi), 0.5 * GRID * (r[:, 1:] + r[:, :-1]), atol=1e-12)
    along = 0.5 * (u[:, 1:] + u[:, :-1])
    aside = 0.5 * (v[:, 1:] + v[:, :-1])
    moved = np.hypot(np.diff(path[..., 0]), np.diff(path[..., 1]))
    assert np.allclose(moved, GRID * np.hypot(along, aside), atol=1e-12)


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
                predictor = trained(rows, seed=seed)
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
    plan = rows[100:140, 6:10]
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
    ours = predictor.predict(plan, DT)
    assert np.isfinite(ours.mean).all() and np.isfinite(ours.cov).all()
    assert not np.allclose(ours.mean, hold_velocity(ours.start, ours.start[3:], ours.t - ours.t0))
    feed(predictor, rows[:2])
    assert predictor._net is net
    predictor.reset()
    assert not predictor.trained and predictor._net is None


def test_missing_torch_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error names the command, and is an ImportError."""
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(MissingTorch, match="pip install torch") as caught:
        LSTMPredictor(BOAT)
    assert isinstance(caught.value, ImportError)
