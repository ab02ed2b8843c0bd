"""What is shown of a twin, and how its errors are measured."""

import math

import numpy as np
import pytest

from twin import Log, Twin
from twin.live.sessions.tracker import HISTORY_ROWS, HORIZON_S, PLAN_STEP_S, TwinMonitor, overlay_of
from twin.predictors.baselines import hold_velocity
from twin.sim.bridge import particulars_of, simulate
from usv_gym import Fault, SeaState, Vessel

VESSEL = Vessel.load("usv75")


def sailed(duration: float = 40.0, **options: object) -> Log:
    given = {"vessel": VESSEL, "sea": SeaState.named("2"), "seed": 3} | options
    return simulate("zigzag", duration=duration, **given)  # type: ignore[arg-type]


def monitor(predictor: str = "ukf") -> TwinMonitor:
    return TwinMonitor(Twin(particulars_of(VESSEL), predictor))


def test_error_is_the_distance_from_the_true_place_ten_seconds_later():
    log = sailed()
    seen, twin = monitor(), Twin(particulars_of(VESSEL), "ukf")
    predicted, held = {}, {}
    for row, (t, z, cmd) in enumerate(log):
        twin.step(t, z, cmd)
        seen.step(t, z, cmd, log.truth[row])
        if seen.predict() is not None:
            mean = twin.predict("hold", horizon=HORIZON_S, dt=PLAN_STEP_S)
            predicted[row] = mean.mean[-1, :2]
            held[row] = hold_velocity(mean.start, mean.start[3:], np.array([HORIZON_S]))[0, :2]
        begun = row - round(HORIZON_S / 0.05)
        if begun in predicted:
            assert seen.error == pytest.approx(math.dist(predicted[begun], log.truth[row, :2]))
            assert seen.error_hold == pytest.approx(math.dist(held[begun], log.truth[row, :2]))
    assert seen.error < 30.0


def test_no_error_is_computed_across_a_gap_or_without_fixes():
    log = sailed(60.0, faults=(Fault("gps", 20.0, 35.0),))
    seen = monitor()
    for t, z, cmd in log:
        seen.step(t, z, cmd)
        seen.predict()
        if t < 20.0:
            known = seen.error
        if t > 22.0 and t < 54.0:
            assert seen.gps_lost and math.isnan(seen.error)
            assert seen.gps_age == pytest.approx(t - 20.0, abs=0.3)
    assert math.isfinite(known)
    assert not seen.gps_lost
    begin = log.t[-1]
    for k, (t, z, cmd) in enumerate(log):  # the log once more, two minutes later
        seen.step(begin + 120.0 + t, z, cmd)
        if k == 0:
            assert math.isnan(seen.error)
            assert seen.history().t[0] > begin + 100.0  # and no line across


def test_curves_stay_short_however_long_the_run():
    seen = monitor("persistence")
    for k in range(5 * HISTORY_ROWS):
        t = 0.5 * k
        z = np.full(17, math.nan)
        z[:5] = 2.0 * t, 0.0, 2.0, 0.0, 0.0
        seen.step(t, z, np.array([20.0, 20.0, 0.0, 0.0]))
    curves = seen.history()
    assert HISTORY_ROWS // 2 <= len(curves.t) <= HISTORY_ROWS
    assert np.all(np.diff(curves.t) > 0.0)
    assert curves.t[0] == 0.0 and curves.t[-1] > 0.99 * seen.t
    assert len(seen.track) <= 1500 and len(seen.fixes) <= 400


def test_before_a_first_fix_there_is_no_prediction():
    seen = monitor()
    seen.step(0.0, np.full(17, math.nan), np.zeros(4))
    assert seen.predict() is None
    assert seen.gps_age == math.inf and seen.gps_lost
    assert len(seen.track) == 0


def test_what_is_drawn_is_the_prediction():
    log = sailed(30.0)
    seen = monitor()
    for t, z, cmd in log:
        seen.step(t, z, cmd)
    prediction = seen.predict()
    overlay = overlay_of(prediction)
    times, places, covs = overlay.interpolate(80)
    for h in (2.5, 5.0, 10.0):
        k, row = int(np.argmin(np.abs(times - h))), round(h / PLAN_STEP_S) - 1
        np.testing.assert_allclose(places[k], prediction.mean[row, :2], atol=1e-6)
        np.testing.assert_allclose(covs[k], prediction.cov[row, :2, :2], atol=1e-9)
