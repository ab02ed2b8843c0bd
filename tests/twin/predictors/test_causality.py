"""Forecasts use no later row, exist for every plan, and change nothing; for each of PREDICTORS."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from twin import Twin
from twin.digital_twin import known_plan

SPLITS = (90, 433, 655)
"""Rows after which the two logs differ: early, and within a window and a grid step."""


def answers(twin, plan):
    """Return all answers of a twin, under a plan and with the last command held."""
    estimate = twin.estimate()
    found = [
        estimate.t,
        estimate.state,
        estimate.sd,
        estimate.params,
        estimate.params_sd,
        estimate.ready,
        twin.monitor.memory.copy(),
    ]
    for prediction in (twin.predict(plan, dt=0.1), twin.predict("hold", dt=0.25)):
        found += [getattr(prediction, item.name) for item in dataclasses.fields(prediction)]
    return [
        *found,
        twin.predictor.mean(plan, 0.1),
        str(twin.predictor.identifiability()),
    ]


def same(one, other):
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


def replaced_future(log, split):
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


def test_later_rows_change_no_answer(name, make_twin, zigzag, plan):
    """The answers at a row are those of a log that ends there, or goes on otherwise.

    Rows come one by one, and by :meth:`Twin.run`; all give the same bits.
    """
    true = make_twin(name)
    for split in SPLITS:
        for row in range(0 if math.isnan(true.t) else SPLITS[SPLITS.index(split) - 1], split):
            true.step(zigzag.t[row], zigzag.z[row], zigzag.cmd[row])
        found = answers(true, plan)
        if split == SPLITS[1] or ("lstm" not in name and "plus" not in name):  # those take seconds
            other = replaced_future(zigzag, split)
            twin = make_twin(name)
            twin.run(
                dataclasses.replace(
                    other,
                    **{key: getattr(other, key)[:split] for key in ("t", "z", "cmd", "truth")},
                )
            )
            same(found, answers(twin, plan))
            # rows that come later are not looked at before they come
            for row in range(split, split + 20):
                twin.step(other.t[row], other.z[row], other.cmd[row])
        same(found, answers(true, plan))


def test_rows_and_forecasts_leave_no_trace_and_reset_forgets(name, make_twin, zigzag, plan):
    """The answers are those of a new twin that got the rows once, and was asked nothing before."""
    rows = 150 if "lstm" in name else 300
    plain, twin = make_twin(name), make_twin(name)
    for row in range(rows):
        plain.step(zigzag.t[row], zigzag.z[row], zigzag.cmd[row])
    for row in range(100, 160):
        twin.step(zigzag.t[row], zigzag.z[row], zigzag.cmd[row])
    twin.predict("hold")
    twin.reset()
    z, cmd = np.empty_like(zigzag.z[0]), np.empty(4)
    for row in range(rows):
        z[:], cmd[:] = zigzag.z[row], zigzag.cmd[row]
        twin.step(zigzag.t[row], z, cmd)
        np.testing.assert_array_equal(z, zigzag.z[row])
        z[:], cmd[:] = 1e6, 1e6  # a predictor may keep no view of a row
        if row % 50 == 0:
            other = -plan[: 1 + row % 90]
            twin.predict(other, dt=0.1)
            np.testing.assert_array_equal(other, -plan[: len(other)])
            twin.estimate()
    same(answers(plain, plan), answers(twin, plan))


@pytest.fixture(scope="module")
def ready_twins(zigzag, request):
    """Keep the twins of this module: one of each predictor, after 500 rows."""
    return {}


@pytest.fixture
def twin(name, make_twin, zigzag, ready_twins) -> Twin:
    if name not in ready_twins:
        ready_twins[name] = make_twin(name)
        for row in range(500):
            ready_twins[name].step(zigzag.t[row], zigzag.z[row], zigzag.cmd[row])
    return ready_twins[name]


def check_prediction(prediction, rows):
    """Finite everywhere, and covariances are covariances."""
    assert prediction.mean.shape == (rows, 6) and prediction.cov.shape == (rows, 6, 6)
    for item in dataclasses.fields(prediction):
        if item.name == "motion":  # this boat does not roll
            assert prediction.motion is None
            continue
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
def test_every_plan_gives_a_finite_forecast(twin, horizon, dt, shaft, angle, unequal):
    rows = min(max(round(horizon / dt), 1), 600)
    side = -shaft if unequal else shaft
    plan = np.tile([shaft, side, angle, angle], (rows, 1))
    plan[rows // 2 :] *= -1.0
    check_prediction(twin.predict(plan, dt=dt), rows)


@pytest.mark.parametrize(("horizon", "dt"), [(600.0, 1.0), (10.0, 0.01), (1e-3, 1.0)])
def test_every_horizon_gives_a_finite_forecast(twin, horizon, dt):
    check_prediction(twin.predict("hold", horizon=horizon, dt=dt), max(round(horizon / dt), 1))
