"""The contract of every predictor in the registry, and what single ones must do."""

import dataclasses
import math

import numpy as np
import pytest

from twin import PREDICTORS, Twin, TwinError, make_predictor
from twin.channels import MEASUREMENTS
from twin.digital_twin import known_plan
from twin.predictors.base import Prediction
from twin.predictors.baselines import hold_velocity
from twin.predictors.registry import PredictorError
from usv_kernel.errors import ArgumentError


def test_state_is_estimated_within_bounds(name, make_twin, zigzag):
    twin = make_twin(name)
    twin.run(zigzag.slice(t1=zigzag.t[800]))
    estimate = twin.estimate()
    assert estimate.ready and estimate.t == zigzag.t[799]
    # the error is that of the receiver's bias, and small in velocity and yaw rate
    error = np.abs(estimate.state - zigzag.truth[799])
    assert (error[[0, 1, 3, 5]] < [5.0, 5.0, 0.8, 0.15]).all()
    prediction = twin.predict(known_plan(zigzag, 799, 10.0, 0.1), dt=0.1)
    assert prediction.t[-1] == pytest.approx(prediction.t0 + 10.0)
    assert prediction.sd[-1, 0] > prediction.sd[0, 0]


def test_estimate_recovers_after_losses(name, make_twin, zigzag):
    """All sensors lost for minutes, then gaps and extreme numbers: finite, then accurate again."""
    twin = make_twin(name)
    rng, size = np.random.default_rng(1), len(MEASUREMENTS)
    twin.run(zigzag.slice(t1=zigzag.t[600]))
    t = twin.t
    for k in range(600):
        t += 0.5 if k % 50 else 30.0
        z = np.full(size, math.nan)
        if k > 500:
            z = np.where(rng.random(size) < 0.5, math.nan, rng.normal(size=size) * 1e4)
        twin.step(t, z, rng.normal(size=4) * [30.0, 30.0, 1.0, 1.0])
        if k % 200 == 0 or k == 599:
            prediction = twin.predict()
            assert np.isfinite(prediction.mean).all()
            assert np.isfinite(prediction.cov).all()
            assert np.isfinite(twin.estimate().sd).all()
    for k in range(600, 1200):
        twin.step(t + 1.0 + 0.05 * (k - 600), zigzag.z[k], zigzag.cmd[k])
    error = np.abs(twin.estimate().state - zigzag.truth[1199])
    assert np.isfinite(error).all()
    if name != "dsw-ukf":  # as in the paper it refuses no number, and forgets slowly
        assert (error[[0, 1, 3]] < [10.0, 10.0, 1.0]).all()


def test_intervals_are_given_or_normal():
    t = np.array([1.0, 2.0])
    mean = np.arange(12.0).reshape(2, 6)
    plain = Prediction(0.0, np.zeros(6), np.eye(6), t, mean, np.tile(4.0 * np.eye(6), (2, 1, 1)))
    np.testing.assert_allclose(plain.high - mean, 2.0 * 1.6448536, rtol=1e-7)
    np.testing.assert_allclose(mean - plain.low, 2.0 * 1.6448536, rtol=1e-7)
    skew = dataclasses.replace(plain, low=mean - 1.0, high=mean + 5.0)
    low, high = skew.interval(np.array([1.5, 2.0]))
    middle = skew.at(np.array([1.5, 2.0]))[0]
    np.testing.assert_allclose(middle - low, 1.0)
    np.testing.assert_allclose(high - middle, 5.0)
    # halfway to the first row: between the spread of the start and that of the row
    low, high = skew.interval(np.array([0.5]))
    np.testing.assert_allclose(high, 0.5 * (1.6448536 + mean[:1] + 5.0), rtol=1e-7)


def test_hold_velocity_is_an_arc():
    start = np.array([1.0, 2.0, 0.3, 0.0, 0.0, 0.0])
    t = np.array([0.5, 2.0, 10.0])
    for r in (0.3, -0.3, 1e-9, 0.0):
        out = hold_velocity(start, np.array([2.0, -0.5, r]), t)
        fine = np.linspace(0.0, 10.0, 200_001)
        psi = 0.3 + r * fine
        vx, vy = 2.0 * np.cos(psi) + 0.5 * np.sin(psi), 2.0 * np.sin(psi) - 0.5 * np.cos(psi)
        x = 1.0 + np.concatenate([[0.0], np.cumsum(0.5 * (vx[1:] + vx[:-1]) * np.diff(fine))])
        y = 2.0 + np.concatenate([[0.0], np.cumsum(0.5 * (vy[1:] + vy[:-1]) * np.diff(fine))])
        np.testing.assert_allclose(out[:, 0], np.interp(t, fine, x), atol=1e-8)
        np.testing.assert_allclose(out[:, 1], np.interp(t, fine, y), atol=1e-8)
        np.testing.assert_allclose(out[:, 2], 0.3 + r * t)


def test_known_plan_gives_the_commands_that_came(zigzag):
    plan = known_plan(zigzag, 400, 10.0, 0.05)
    np.testing.assert_array_equal(plan, zigzag.cmd[401:601])
    end = known_plan(zigzag, len(zigzag) - 2, 10.0, 0.05)
    np.testing.assert_array_equal(end, np.tile(zigzag.cmd[-1], (200, 1)))


@pytest.mark.parametrize("row", [99999, -99999])
def test_known_plan_refuses_rows_that_the_log_lacks(zigzag, row):
    with pytest.raises(TwinError, match=f"row = {row}: the log has {len(zigzag)} rows, 0 to"):
        known_plan(zigzag, row, 10.0, 0.05)


def test_names_and_paths_instead_of_particulars_and_logs_are_refused(boat):
    with pytest.raises(ArgumentError, match=r"particulars = 'otter' must be .*Particulars.load"):
        Twin("otter")
    with pytest.raises(ArgumentError, match=r"log = 'run.csv' must be a Log: Log.read\(path\)"):
        Twin(boat, "persistence").run("run.csv")


def test_unknown_predictor_is_named(boat):
    with pytest.raises(PredictorError, match=r"no predictor is called 'nope'; known: persistence"):
        make_predictor("nope", boat)
    with pytest.raises(PredictorError, match=r"'dsw-ukf-pls' \(did you mean 'dsw-ukf-plus'\?\)"):
        make_predictor("dsw-ukf-pls", boat)
    PREDICTORS["not-one"] = "builtins:dict"
    try:
        with pytest.raises(PredictorError, match="not a subclass of Predictor"):
            make_predictor("not-one", boat)
    finally:
        del PREDICTORS["not-one"]


@pytest.mark.parametrize(
    ("t", "z", "cmd", "message"),
    [
        (math.nan, np.zeros(len(MEASUREMENTS)), np.zeros(4), "must be finite and later"),
        (-1.0, np.zeros(len(MEASUREMENTS)), np.zeros(4), "later than the row before"),
        (1.0, np.zeros(8), np.zeros(4), r"z has shape \(8,\)"),
        (1.0, np.zeros(len(MEASUREMENTS)), np.zeros(3), r"cmd \(3,\)"),
        (1.0, np.zeros(len(MEASUREMENTS)), [0.0, math.nan, 0.0, 0.0], "give the last command"),
    ],
)
def test_bad_rows_are_refused(make_twin, zigzag, t, z, cmd, message):
    twin = make_twin("ukf")
    twin.run(zigzag.slice(t1=zigzag.t[10]))
    before = twin.estimate()
    with pytest.raises(TwinError, match=message):
        twin.step(t, z, cmd)
    np.testing.assert_array_equal(before.state, twin.estimate().state)


@pytest.mark.parametrize(
    ("plan", "options", "message"),
    [
        ("guess", {}, "use 'hold' or an array"),
        (np.zeros((0, 4)), {}, "must be"),
        (np.zeros((5, 3)), {}, "must be"),
        (np.full((5, 4), math.nan), {}, "NaN"),
        ("hold", {"horizon": -1.0}, "above 0"),
        ("hold", {"dt": math.inf}, "above 0"),
    ],
)
def test_bad_plans_are_refused(boat, plan, options, message):
    with pytest.raises(TwinError, match=message):
        Twin(boat).predict(plan, **options)
