"""The oracle: the true ship, from a filtered start, in a sea whose waves it does not know."""

import dataclasses
import math

import gymnasium as gym
import numpy as np
import pytest

from twin import Twin, make_predictor, recorded_runs
from twin.digital_twin import known_plan
from twin.logs.log import Log
from twin.particulars import Instruments
from twin.predictors.registry import PredictorError
from twin.sim.bridge import particulars_of, simulate
from twin.sim.oracle import (
    OBSERVER_GAIN_PER_S,
    Oracle,
    check_simulator,
    known_vessel,
    simulator_options,
)
from usv_gym import SeaState, SensorSuite, Vessel

CALM, WINDY = SeaState(), SeaState(wind=6.0, current=0.4, current_to=1.0, gusts="none")
ROUGH = SeaState(hs=0.5, wind=4.5)


def other_boat() -> Vessel:
    return Vessel.load("usv75").varied(np.random.default_rng(5))


def sail(vessel, sea, dof=3, manoeuvre="random", duration=50.0, suite=None):
    return simulate(
        manoeuvre, vessel=vessel, sea=sea, duration=duration, seed=4, dof=dof, suite=suite
    )


def watch(log: Log, rows: int, oracle: Oracle) -> Oracle:
    """Let an oracle see a log with perfect sensors: what is left is its own."""
    for k, (t, z, cmd) in enumerate(log):
        if k >= rows:
            break
        oracle.update(t, 0.05 if k else 0.0, z, cmd)
    return oracle


@pytest.mark.parametrize("dof", [3, 6])
@pytest.mark.parametrize("sea", [CALM, WINDY])
def test_from_the_true_start_it_is_the_simulation(sea, dof):
    """The same ship, weather and actuators: 10 s later only the rounding of adding up differs.

    The start is put where the ship is; everything else the oracle has followed by itself. Six
    degrees of freedom: heave, roll and pitch are the oracle's own, and still settling (1e-3).
    """
    vessel = other_boat()
    log = sail(vessel, sea, dof)
    oracle = Oracle(particulars_of(vessel, dof=dof), vessel=vessel, sea=sea, dof=dof)
    watch(log, 701, oracle)
    s = oracle._extra[1:]
    x, y, psi, u, v, r = log.truth[700]
    s[:2], s[5], s[6:8], s[11] = (x, y), psi, (u, v), r
    mean = oracle.path(known_plan(log, 700, 10.0, 0.05), 0.05)
    tolerance = 1e-9 if dof == 3 else 1e-3
    np.testing.assert_allclose(mean, log.truth[701:901], rtol=0, atol=tolerance)
    # and not by chance: the boat turns, and the nominal one would go elsewhere
    assert np.ptp(log.truth[701:901, 2]) > 0.2
    wrong = Oracle(particulars_of(vessel, dof=dof), vessel=Vessel.load("usv75"), sea=sea, dof=dof)
    watch(log, 701, wrong)
    wrong._extra[:] = oracle._extra
    away = wrong.path(known_plan(log, 700, 10.0, 0.05), 0.05) - log.truth[701:901]
    assert np.hypot(*away[-1, :2]) > 0.1


def test_with_perfect_sensors_it_finds_the_start_itself():
    """Calm sea, no sensor errors: the observer ends where the ship is.

    Tolerances: what the navigation's own settings (wandering yaw rate, GPS latency) leave.
    """
    vessel = other_boat()
    log = sail(vessel, CALM, suite=SensorSuite.grade("perfect"))
    given = particulars_of(vessel, SensorSuite.grade("perfect"))
    oracle = watch(log, 701, Oracle(given, vessel=vessel, sea=CALM))
    prediction = oracle.predict(known_plan(log, 700, 10.0, 0.05), 0.05)
    error = prediction.mean - log.truth[701:901]
    assert np.abs(error[:, 3:5]).max() < 0.05  # m/s of 5
    assert np.abs(error[:, 5]).max() < 0.01  # rad/s of 0.3
    assert np.hypot(*error[:, :2].T).max() < 0.5  # m of 50


def test_it_follows_the_motion_and_not_the_waves():
    """What stays of a wave of 3 s is about gain times period over 2 pi: below half."""
    vessel = Vessel.load("usv75")
    log = sail(vessel, ROUGH, manoeuvre="straight", duration=60.0)
    oracle = Oracle(particulars_of(vessel), vessel=vessel, sea=ROUGH)
    seen, followed = [], []
    for k, (t, z, cmd) in enumerate(log):
        oracle.update(t, 0.05 if k else 0.0, z, cmd)
        if t > 20.0:
            seen.append(oracle.state[4])
            followed.append(oracle._extra[1 + 7])
    assert np.std(followed) < 0.5 * np.std(seen)
    assert OBSERVER_GAIN_PER_S * 3.0 / (2 * math.pi) < 0.5
    assert abs(np.mean(followed) - np.mean(seen)) < 0.05


def test_it_knows_the_mean_wind_and_not_the_waves():
    """With the wind it is given, it errs less than without; the waves' phases change nothing."""
    vessel = Vessel.load("usv75")
    windy = SeaState(wind=9.0, gusts="none")
    log = sail(vessel, windy, manoeuvre="turn")
    plan = known_plan(log, 700, 10.0, 0.05)
    ends = {}
    for name, sea in (("given", windy), ("calm", CALM), ("waves", windy.replace(hs=1.0))):
        oracle = watch(log, 701, Oracle(particulars_of(vessel), vessel=vessel, sea=sea))
        ends[name] = oracle.path(plan, 0.05)
    truth = log.truth[701:901] - [*log.truth[700, :2], 0, 0, 0, 0]
    start = [*oracle.state[:2], 0, 0, 0, 0]
    error = {k: np.abs(end - start - truth)[:, 3:5].mean() for k, end in ends.items()}
    assert error["given"] < 0.5 * error["calm"]
    np.testing.assert_array_equal(ends["given"], ends["waves"])


def test_the_true_boat_is_known_by_its_particulars():
    boat = particulars_of(Vessel.load("otter"))
    assert known_vessel(boat) == Vessel.load("otter")
    assert isinstance(make_predictor("oracle", boat), Oracle)
    for other in (dataclasses.replace(boat, mass=boat.mass + 1.0), particulars_of(other_boat())):
        with pytest.raises(PredictorError, match=f"true boat behind '{other.name}' is not known"):
            make_predictor("oracle", other)
    # other sensors are no other boat
    make_predictor("oracle", dataclasses.replace(boat, instruments=Instruments(gps_sd=3.0)))


def test_a_recorded_run_has_no_true_boat():
    log = Log.read(recorded_runs()["boat1_usv_circle"])
    boat = particulars_of(Vessel.load("usv75"))
    with pytest.raises(PredictorError, match="true boat of 'boat1_usv_circle' is not known"):
        check_simulator("oracle", log, boat)
    check_simulator("ukf", log, boat)
    check_simulator("oracle", sail(Vessel.load("usv75"), CALM, duration=1.0), boat)


def test_only_those_that_ask_get_the_simulator():
    vessel = other_boat()
    assert simulator_options("ukf", vessel, ROUGH, 3) == {}
    given = simulator_options("oracle", vessel, ROUGH, 6)
    assert given == {"vessel": vessel, "sea": ROUGH, "dof": 6}


def test_in_the_environment_it_gets_the_environments_boat_and_sea():
    env = gym.make(
        "USVTwin-v0",
        vessel=other_boat(),
        sea=WINDY,
        twin="oracle",
        disable_env_checker=True,
    )
    obs, _ = env.reset(seed=1)
    assert obs.shape == (92,)
    for _ in range(60):
        obs, *_ = env.step(np.array([0.8, 0.3], np.float32))
    assert np.isfinite(obs).all()
    oracle = env.get_wrapper_attr("twin").predictor
    assert isinstance(oracle, Oracle)
    np.testing.assert_array_equal(oracle._true.vessel[0], other_boat().packed)


def test_a_capsizing_ship_stays_finite():
    vessel = Vessel.load("usv75")
    log = sail(vessel, SeaState(hs=2.0, wind=10.0), dof=6, duration=20.0)
    oracle = Twin(particulars_of(vessel, dof=6), "oracle", dof=6)
    oracle.run(log)
    prediction = oracle.predict(np.tile([1e6, -1e6, 5.0, -5.0], (200, 1)), dt=0.5)
    assert np.isfinite(prediction.mean).all() and np.isfinite(prediction.cov).all()
