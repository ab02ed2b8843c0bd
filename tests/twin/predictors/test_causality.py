"""No predictor knows the future, and asking one changes nothing: for every entry of PREDICTORS."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from twin import Twin
from twin.digital_twin import known_plan
from twin.predictors.base import Predictor
from twin.predictors.registry import PREDICTORS

SPLITS = (90, 433, 655)
"""Rows after which the two logs differ: early, and within a window and a grid step."""
LAST = 700


def answers(twin, plan):
    """What a twin says now, under a plan and with the last command held."""
    estimate = twin.estimate()
    said = [
        estimate.t,
        estimate.state,
        estimate.sd,
        estimate.params,
        estimate.params_sd,
        estimate.ready,
    ]
    for prediction in (twin.predict(plan, dt=0.1), twin.predict("hold", dt=0.25)):
        said += [getattr(prediction, item.name) for item in dataclasses.fields(prediction)]
    return [
        *said,
        twin.predictor.mean(plan, 0.1),
        str(twin.predictor.identifiability()),
    ]


def same(one, other):
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


def wild(log, split):
    """Return the log with another future: measurements, commands, times, losses, and truth."""
    rng = np.random.default_rng(split)
    rest = len(log) - split
    z, cmd, t, truth = log.z.copy(), log.cmd.copy(), log.t.copy(), log.truth.copy()
    z[split:] = rng.normal(size=(rest, z.shape[1])) * 100.0
    z[split:][rng.random((rest, z.shape[1])) < 0.3] = math.nan
    cmd[split:] = rng.normal(size=(rest, 4)) * [30.0, 30.0, 1.0, 1.0]
    t[split:] = t[split - 1] + np.cumsum(rng.uniform(0.01, 1.0, rest))
    truth[split:] = 1e6
    return dataclasses.replace(log, z=z, cmd=cmd, t=t, truth=truth)


@pytest.fixture
def plan(zigzag):
    return known_plan(zigzag, 433, 10.0, 0.1)


def test_the_future_changes_no_answer(name, make_twin, zigzag, plan):
    """The answers at a row are those of a log that ends there, or goes on otherwise.

    Logs are handed in whole, row by row, and by :meth:`Twin.run`; all at the same bits.
    """
    true = make_twin(name)
    for split in SPLITS:
        for row in range(0 if math.isnan(true.t) else SPLITS[SPLITS.index(split) - 1], split):
            true.step(zigzag.t[row], zigzag.z[row], zigzag.cmd[row])
        said = answers(true, plan)
        if split == SPLITS[1] or ("lstm" not in name and "plus" not in name):  # those take seconds
            other = wild(zigzag, split)
            twin = make_twin(name)
            twin.run(
                dataclasses.replace(
                    other,
                    **{key: getattr(other, key)[:split] for key in ("t", "z", "cmd", "truth")},
                )
            )
            same(said, answers(twin, plan))
            # rows that come later are not looked at before they come
            for row in range(split, split + 20):
                twin.step(other.t[row], other.z[row], other.cmd[row])
        same(said, answers(true, plan))


def test_a_row_is_not_kept_by_reference(name, make_twin, zigzag, plan):
    """What a caller does to its arrays later changes no answer."""
    kept, shared = make_twin(name), make_twin(name)
    z, cmd = np.empty(zigzag.z.shape[1]), np.empty(4)
    for row in range(200):
        kept.step(zigzag.t[row], zigzag.z[row].copy(), zigzag.cmd[row].copy())
        z[:], cmd[:] = zigzag.z[row], zigzag.cmd[row]
        shared.step(zigzag.t[row], z, cmd)
        z[:], cmd[:] = 1e6, 1e6
    same(answers(kept, plan), answers(shared, plan))


def test_asking_changes_nothing(name, make_twin, zigzag, plan):
    """A twin that was asked at many moments, about many futures, ends like one that never was."""
    silent, asked = make_twin(name), make_twin(name)
    for row in range(LAST):
        silent.step(zigzag.t[row], zigzag.z[row], zigzag.cmd[row])
        asked.step(zigzag.t[row], zigzag.z[row], zigzag.cmd[row])
        if row % 7 == 0 and row < LAST - 19:  # and not in the last second
            asked.estimate()
            asked.predict(-plan[: 1 + row % 90], dt=0.1 + 0.01 * (row % 5))
            asked.predictor.mean(plan[:5], 0.3)
            asked.predictor.identifiability()
    same(answers(silent, plan), answers(asked, plan))
    same(answers(silent, plan), answers(asked, plan))


@pytest.fixture(scope="module")
def sailed(zigzag, request):
    """Keep the twins of this module: one of each predictor, fed until row 500."""
    return {}


@pytest.fixture
def twin(name, make_twin, zigzag, sailed) -> Twin:
    if name not in sailed:
        sailed[name] = make_twin(name)
        for row in range(500):
            sailed[name].step(zigzag.t[row], zigzag.z[row], zigzag.cmd[row])
    return sailed[name]


def sound(prediction, rows):
    """Finite everywhere, and covariances are covariances."""
    assert prediction.mean.shape == (rows, 6) and prediction.cov.shape == (rows, 6, 6)
    for item in dataclasses.fields(prediction):
        assert np.isfinite(getattr(prediction, item.name)).all(), item.name
    for cov in (prediction.start_cov[None], prediction.cov):
        np.testing.assert_array_equal(cov, cov.transpose(0, 2, 1))
        sd = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
        assert (sd > 0.0).all()
        # of correlations: units, and the size of a long prediction, must not matter
        values = np.linalg.eigvalsh(cov / sd[:, :, None] / sd[:, None, :])
        assert values.min() > -1e-7  # rounding of a double, times the condition number


@settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    horizon=st.floats(0.005, 60.0),
    dt=st.sampled_from([0.01, 0.05, 0.1, 0.25, 1.0, 3.0]),
    shaft=st.sampled_from([0.0, 20.0, -20.0, 1e3, -1e3, 1e8]),
    angle=st.sampled_from([0.0, 0.35, -0.35, 3.0, -1e3]),
    unequal=st.booleans(),
)
def test_every_plan_has_an_answer(twin, horizon, dt, shaft, angle, unequal):
    rows = min(max(round(horizon / dt), 1), 600)
    side = -shaft if unequal else shaft
    plan = np.tile([shaft, side, angle, angle], (rows, 1))
    plan[rows // 2 :] *= -1.0
    sound(twin.predict(plan, dt=dt), rows)


@pytest.mark.parametrize(
    ("horizon", "dt"), [(600.0, 0.1), (600.0, 30.0), (10.0, 0.01), (0.01, 0.01), (1e-3, 1.0)]
)
def test_every_horizon_has_an_answer(twin, horizon, dt):
    sound(twin.predict("hold", horizon=horizon, dt=dt), max(round(horizon / dt), 1))


class Peeping(Predictor):
    """What the tests above are there to catch: rows by reference, and answers that leave marks."""

    def __init__(self, particulars, *, seed=0):
        super().__init__(particulars, seed=seed)
        self.reset()

    def reset(self):
        self.rows, self.asked = [], 0

    def update(self, t, dt, z, cmd):
        self.rows.append((t, z))

    @property
    def state(self):
        return np.nan_to_num(self.rows[-1][1][:6]) if self.rows else np.zeros(6)

    def estimate(self):
        from twin.predictors.base import Estimate

        return Estimate(0.0, self.state, np.ones(6), np.zeros(0), np.zeros(0), True)

    def predict(self, plan, dt):
        from twin.predictors.base import Prediction

        self.asked += 1
        mean = np.tile(self.state + self.asked, (len(plan), 1))
        cov = np.tile(np.eye(6), (len(plan), 1, 1))
        return Prediction(0.0, self.state, np.eye(6), dt * np.arange(1, len(plan) + 1), mean, cov)


def test_these_tests_can_fail(boat, zigzag, plan, monkeypatch):
    monkeypatch.setitem(PREDICTORS, "peeping", Peeping)

    def make(name):
        return Twin(boat, name)

    for test in (test_a_row_is_not_kept_by_reference, test_asking_changes_nothing):
        with pytest.raises(AssertionError):
            test("peeping", make, zigzag, plan)
