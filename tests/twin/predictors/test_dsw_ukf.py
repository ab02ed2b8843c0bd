"""The paper's method: each of its pieces can be switched, and does what it should alone."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from twin.channels import MEASUREMENTS
from twin.logs.log import Log
from twin.particulars import Particulars
from twin.predictors.dsw_ukf import DSWPredictor

ACCEL_Y, WIND = MEASUREMENTS.index("accel_y_mps2"), MEASUREMENTS.index("wind_mps")


@pytest.fixture(scope="module")
def run(zigzag: Log) -> Log:
    """Return 22 s of the zigzag with a wind that gusts."""
    log = zigzag.slice(8.0, 30.0)
    z = log.z.copy()
    z[:, WIND] = 4.5 + np.sin(0.3 * log.t)
    return dataclasses.replace(log, z=z)


def run_of(boat: Particulars, log: Log, **options: Any) -> DSWPredictor:
    predictor = DSWPredictor(boat, **options)
    before = log.t[0]
    for t, z, cmd in log:
        predictor.update(t, t - before, z, cmd)
        before = t
    return predictor


@pytest.fixture(scope="module")
def default(boat: Particulars, run: Log) -> DSWPredictor:
    return run_of(boat, run)


def test_as_published_settings_are_those_of_the_paper(
    boat: Particulars, default: DSWPredictor
) -> None:
    settings = default.ukf.settings
    np.testing.assert_array_equal(settings.xi0, 0.1)  # Eq 47
    np.testing.assert_allclose(0.05 * settings.q, 1e-4, rtol=1e-15)  # Eq 50
    np.testing.assert_array_equal(settings.r, 1.0)  # Eq 51
    np.testing.assert_array_equal(settings.p0, 1.0)
    np.testing.assert_array_equal(settings.xi0_cov, np.eye(25))
    assert settings.n_unit * boat.shaft_speed == pytest.approx(380.0 / 60.0)
    assert (settings.alpha, settings.beta, settings.kappa) == (1.0, 2.0, 0.0)
    window = default.window
    assert (window.base, window.base + window.cap, default.stride) == (15, 30, 7)
    assert window.period == "binary"
    assert type(default.fusion.gps).__module__ == "filterpy.kalman.kalman_filter"
    assert type(default.fusion.imu) is type(default.fusion.gps)


# Option, and which of fusion, window and noises it may change; the filter's answer always.
PIECES: list[tuple[dict[str, Any], set[str]]] = [
    ({"feedback": False}, {"fusion", "window"}),
    ({"window": "fixed"}, {"window"}),
    ({"window": "off"}, {"window"}),
    ({"stride": 3}, {"window"}),
    ({"w_min": 20}, {"window"}),
    ({"w_min": 12, "w_max": 18}, {"window"}),
    ({"period": "continuous"}, {"window"}),
    ({"adapt": "literal"}, {"q"}),
    ({"adapt": "literal", "adapts": "R"}, {"r"}),
    ({"adapt": "literal", "adapts": "QR"}, {"q", "r"}),
    ({"adapt": "signed"}, {"q"}),
    ({"adapt": "signed", "adapts": "QR", "adapt_gain": 1e-2}, {"q", "r"}),
    ({"model": "mmg"}, set()),
    ({"x0": 0.05}, set()),
    ({"p0": 0.5}, set()),
    ({"q": 1e-3}, {"q"}),
    ({"r": 0.1}, {"r"}),
    ({"n_unit": 1.0}, set()),
]


@pytest.mark.parametrize(
    ("options", "parts"),
    PIECES,
    # the order of a set differs from worker to worker, and names of tests must not
    ids=lambda value: "+".join(sorted(value)) if isinstance(value, set) else str(value),
)
def test_each_piece_changes_what_it_should(
    boat: Particulars, run: Log, default: DSWPredictor, options: dict[str, Any], parts: set[str]
) -> None:
    other = run_of(boat, run, **options)
    same = {
        "fusion": np.array_equal(other.fusion.state, default.fusion.state),
        "q": np.array_equal(other.q, default.q),
        "r": np.array_equal(other.r, default.r),
    }
    assert {name for name, equal in same.items() if not equal} == parts - {"window"}
    assert not np.array_equal(other.state, default.state)
    if not parts:
        window = other.window
        assert (window.V, window.S) == (default.window.V, default.window.S)


def test_window_off_and_fixed_leave_the_indices_alone(boat: Particulars, run: Log) -> None:
    for kind in ("off", "fixed"):
        other = run_of(boat, run, window=kind)
        assert (other.window.W, math.isnan(other.window.S)) == (15, True)


def test_adjustment_period_is_kept(boat: Particulars, run: Log) -> None:
    # tr(P) is that of the innovation: above the six ones of R, so above P_max in any case
    for form, least, most in (("binary", 5.0, 5.0), ("continuous", 0.0, 2.8)):
        assert least <= run_of(boat, run, period=form).window.T <= most


def test_lateral_acceleration_doubles_the_window(boat: Particulars, run: Log) -> None:
    log = run.slice(8.0, 12.0)  # before the first adjustment
    z = log.z.copy()
    z[-1, ACCEL_Y] = 3.0
    assert run_of(boat, dataclasses.replace(log, z=z)).window.W == 30


def test_intervals_are_finite_and_positive_definite(boat: Particulars, zigzag: Log) -> None:
    predictor = DSWPredictor(boat)
    widest, before = 0.0, 0.0
    for row, (t, z, cmd) in enumerate(zigzag):
        predictor.update(t, t - before, z, cmd)
        before = t
        if row % 40 or not predictor.ready:
            continue
        prediction = predictor.predict(np.repeat(cmd[None], 200, axis=0), 0.05)
        cov = np.concatenate([prediction.start_cov[None], prediction.cov])
        assert np.isfinite(cov).all()
        sd = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
        np.linalg.cholesky(cov / (sd[:, :, None] * sd[:, None, :]))  # raises if not
        widest = max(widest, sd[:, 3].max())
    # they do run away, else this proves nothing, and are held at what a boat could reach
    assert 0.9 < widest / (2.0 * predictor.ukf.envelope[0]) < 1.1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"window": "sliding"}, "window = 'sliding' is unknown; use one of dynamic, fixed, off"),
        ({"adapt": "yes"}, "adapt = 'yes' is unknown; use one of off, literal, signed"),
        ({"adapts": "P"}, "adapts = 'P' is unknown; use one of Q, R, QR"),
        ({"period": "daily"}, "period = 'daily' is unknown; use one of continuous, binary"),
        ({"stride": 0}, 'stride = 0 must be 1 or more; window="off"'),
        ({"w_min": 0}, "w_min = 0 must be 1 or more, and w_max = 30 no less"),
        ({"w_max": 14}, "w_min = 15 must be 1 or more, and w_max = 14 no less"),
        ({"adapt_gain": -1.0}, "adapt_gain = -1.0 must be a finite number, 0 or more"),
        ({"n_unit": 0.0}, "n_unit = 0.0 must be a finite number above 0"),
        ({"x0": [0.1] * 24}, r"x0 has the shape \(24,\); give one number, or 25 of them"),
        ({"p0": 0.0}, "p0 = 0.0 must be finite and above 0"),
        ({"q": math.inf}, "q = inf must be finite and above 0"),
        ({"r": -1.0}, "r = -1.0 must be finite and above 0"),
    ],
)
def test_wrong_values_are_refused(boat: Particulars, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        DSWPredictor(boat, **options)


def test_suspended_learning_changes_no_parameter(boat: Particulars, run: Log) -> None:
    predictor = run_of(boat, run)
    params, moved = predictor.ukf.xi.copy(), run.z.copy()
    moved[:, :2] += 1e5
    predictor.suspend_learning(commands=False, motion=True)
    for k in range(100):
        predictor.update(run.t[-1] + 0.05 * (k + 1), 0.05, moved[k], run.cmd[k])
    np.testing.assert_array_equal(predictor.ukf.xi, params)
    # it goes on from where the fixes are, and learns again
    predictor.suspend_learning(commands=False, motion=False)
    for k in range(200, 300):
        predictor.update(run.t[-1] + 0.05 * (k + 1), 0.05, run.z[k], run.cmd[k])
    off = np.hypot(*(predictor.state[:2] - run.truth[299, :2]))
    assert 0.0 < np.abs(predictor.ukf.xi - params).max() < 5.0 and off < 3.0
