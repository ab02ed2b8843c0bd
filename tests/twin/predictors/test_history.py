"""The history of predictors without a model: as long as needed, and the same bits."""

import math
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin import make_predictor
from twin.channels import MEASUREMENTS
from twin.particulars import Particulars
from twin.predictors.baselines import GRID, HistoryPredictor
from twin.predictors.registry import predictor_class
from twin.sim.bridge import particulars_of
from usv_gym import Vessel

BOAT = particulars_of(Vessel.load("usv75"))
PLAN = np.tile([18.0, 20.0, 0.1, 0.1], (40, 1))
KEPT = 2 * (round((HistoryPredictor.memory + 60.0) / GRID) + 8)
"""Rows from which on some are dropped, of a predictor that looks back for up to 60 s."""


def without_end(name: str, boat: Particulars, **options: Any) -> HistoryPredictor:
    """Return a predictor that never drops a row."""
    kind = predictor_class(name)
    endless = type("Endless", (kind,), {"_drop_old": lambda _: None})
    made: HistoryPredictor = endless(boat, **options)
    return made


def rows(seed: int, count: int, dt: float) -> list[tuple[float, float, np.ndarray, np.ndarray]]:
    """Return rows of a boat on a winding course, with gaps in its sensors."""
    rng = np.random.default_rng(seed)
    t = dt * np.arange(count)
    psi = 0.7 * np.sin(0.05 * t + seed)
    velocity = 5.0 * np.stack([np.cos(psi), np.sin(psi)], axis=1)
    z = np.full((count, len(MEASUREMENTS)), math.nan)
    z[:, :2] = np.cumsum(velocity, axis=0) * dt
    z[:, 2:4], z[:, 4] = velocity, psi
    z[:, :5] += 0.05 * rng.normal(size=(count, 5))
    z[1:][rng.random(count - 1) < 0.2, :4] = math.nan
    cmd = np.array([20.0, 20.0, 0.0, 0.0]) + 0.1 * rng.normal(size=(count, 4))
    steps = [0.0, *np.diff(t)]
    return list(zip(t.tolist(), steps, z, cmd, strict=True))


def assert_same(one: HistoryPredictor, two: HistoryPredictor, *steps: float) -> None:
    for dt in steps:
        first, second = one.predict(PLAN, dt), two.predict(PLAN, dt)
        np.testing.assert_array_equal(first.mean, second.mean)
        np.testing.assert_array_equal(first.cov, second.cov)


@settings(max_examples=8, deadline=None)
@given(
    name=st.sampled_from(["persistence", "persistence-8s"]),
    seed=st.integers(0, 1000),
    count=st.integers(KEPT - 3, 3 * KEPT),
    gap=st.integers(1, 3 * KEPT),
    dt=st.sampled_from([0.25, 0.4]),
)
def test_dropping_old_rows_changes_no_bit(name, seed, count, gap, dt):
    bounded, endless = make_predictor(name, BOAT, seed=1), without_end(name, BOAT, seed=1)
    assert isinstance(bounded, HistoryPredictor)
    late = 0.0
    for k, (t, step, z, cmd) in enumerate(rows(seed, count, dt)):
        wait = 400.0 if k == gap else 0.0  # a gap after which the history starts again
        late += wait
        for one in (bounded, endless):
            one.update(t + late, step + wait, z, cmd)
        assert len(bounded._rows) < KEPT
        if k % 97 == 0 or k == count - 1:
            assert_same(bounded, endless, 0.25, 0.1)
            again = make_predictor(name, BOAT, seed=1)
            again.load_state_dict(bounded.state_dict())
            assert_same(again, endless, 0.25)
            bounded = again


@pytest.mark.parametrize(
    "name",
    [
        "oracle",
        "fleet-lstm",
        pytest.param(
            "lstm", marks=pytest.mark.skipif(find_spec("torch") is None, reason="needs torch")
        ),
    ],
)
def test_other_predictors_drop_what_they_do_not_look_back_on(name):
    options = {"seed": 1, **({"train_at": 20.0} if name == "lstm" else {})}
    bounded, endless = make_predictor(name, BOAT, **options), without_end(name, BOAT, **options)
    assert isinstance(bounded, HistoryPredictor)
    for t, step, z, cmd in rows(0, KEPT + 40, GRID):
        for one in (bounded, endless):
            one.update(t, step, z, cmd)
    assert len(bounded._rows) < KEPT < len(endless._rows)
    assert_same(bounded, endless, 0.25)


@pytest.mark.parametrize("name", ["fleet-lstm", "transformer"])
def test_a_net_begins_again_after_a_fault(name: str) -> None:
    """Rows up to a fault change no forecast once the sensors are right; before that they do."""
    predictor: Any = make_predictor(name, BOAT)
    for t, dt, z, cmd in rows(1, 400, 0.05):
        predictor.update(t, dt, z, cmd)
    history = np.array([*predictor._rows, predictor._rows[-1]])
    false = history.copy()
    false[:60, 3:6] *= 0.2
    predictor._unreliable[40:60] = 20 * [True]
    for suspended in (False, True):
        predictor._suspended = suspended
        one, two = (predictor.forecast_from_last(r, PLAN) for r in (history, false))
        assert np.array_equal(one, two) is not suspended
