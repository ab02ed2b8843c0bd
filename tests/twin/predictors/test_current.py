"""The current: found where the boat turns, and held while GPS is lost."""

import dataclasses
import math

import numpy as np
import pytest

from twin import Twin
from twin.channels import MEASUREMENTS
from twin.identification.data_weight import CHANGED
from twin.model.rollout import GRID
from twin.sim.bridge import CONTROL_STEP_S, particulars_of, prepare, sail, simulate
from usv_gym import SeaState, Vessel
from usv_gym.world.simulation import Simulation

GPS = [k for k, name in enumerate(MEASUREMENTS) if name.startswith("gps")]


@pytest.fixture(scope="module")
def log():
    """A usv75 that turns and weaves where the water runs east at .8 m/s."""
    sea = SeaState(hs=0.3, wind=3.0, current=0.8, current_to=math.radians(90.0))
    return simulate("random", vessel=Vessel.load("usv75"), sea=sea, duration=150.0, seed=3)


@pytest.fixture(scope="module")
def twin(log):
    twin = Twin(particulars_of(Vessel.load("usv75")), "dsw-ukf-plus")
    twin.run(log.slice(0.0, 120.0))
    return twin


def without_gps(log, start=0.0, end=math.inf):
    """Return the rows of a log between times, without what the receiver says."""
    z = log.z.copy()
    z[:, GPS] = math.nan
    return dataclasses.replace(log, z=z).slice(start, end)


def current_of(twin):
    found = twin.estimate()
    at = twin.predictor.parameter_names.index("C_north")
    return found.params[at : at + 2], found.params_sd[at : at + 2]


def test_current_is_found_within_what_is_claimed(twin):
    mean, sd = current_of(twin)
    # measured: .03 north and .75 east
    assert (np.abs(mean - [0.0, 0.8]) < 3.0 * sd + 0.1).all()
    assert mean[1] > 0.4 and (sd < 0.25).all()


def test_current_is_held_without_gps(twin, log):
    before = current_of(twin)[0].copy()
    twin.run(without_gps(log, 120.1, 140.0))
    np.testing.assert_allclose(current_of(twin)[0], before, atol=0.1)


@pytest.mark.parametrize("seed", range(8))
def test_rough_models_are_bounded(log, seed):
    """Whatever the refits hold, forecast and observer stay with what was seen."""
    boat = particulars_of(Vessel.load("usv75"))
    twin = Twin(boat, "dsw-ukf-plus")
    twin.run(log.slice(0.0, 30.0))
    predictor, rng = twin.predictor, np.random.default_rng(seed)
    own = predictor.selector.segments
    sd = np.sqrt(np.diag(own.prior_cov))
    wild = own.prior + 10.0 ** rng.uniform(0.0, 2.0) * sd * rng.standard_normal(len(sd))
    predictor.selector.params[:] = predictor.ukf.x[6:] = wild
    bounds = np.maximum(1.5 * predictor.ukf.fastest, predictor.ukf.nominal)
    for t, z, cmd in log.slice(30.05, 45.0):
        twin.step(t, z, cmd)
        slow, seen = predictor.window["slow"], predictor.n[3:6]
        assert (np.abs(slow - seen) <= 0.125 * predictor.ukf.envelope + 1e-9).all()
    ahead = twin.predict("hold").mean[:, 3:]
    assert np.isfinite(ahead).all()
    assert (np.abs(ahead) <= bounds + 3.0 * predictor.window["wave_sd"] + 0.5).all()


@pytest.mark.parametrize("times", [1e2, 1e4, 1e8])
def test_rough_parameters_claim_no_velocity_that_no_boat_has(log, times):
    """However uncertain the parameters, what they draw is bounded as the mean is."""
    twin = Twin(particulars_of(Vessel.load("usv75")), "dsw-ukf-plus")
    twin.run(log.slice(0.0, 30.0))
    twin.predictor.ukf.P[6:, 6:] *= times
    bounds = np.maximum(1.5 * twin.predictor.ukf.fastest, twin.predictor.ukf.nominal)
    variances = np.diagonal(twin.predict("hold").cov, axis1=1, axis2=2)[:, 3:]
    assert (np.sqrt(variances) <= bounds).all()


def test_without_gps_no_rough_boat_is_said_to_be_faster_than_it_was():
    """However unstable its model: the variance of the velocity grew to (82 m/s)2 in a flight."""
    log = simulate("turn", vessel=Vessel.load("otter"), sea=SeaState(), duration=100.0, seed=1)
    twin = Twin(particulars_of(Vessel.load("otter")), "ukf")
    twin.run(log.slice(0.0, 40.0))
    for row in without_gps(log, 40.05):
        twin.predictor.ukf.P[3, 3] = 1e4
        twin.step(*row)
    fastest = np.hypot(*twin.predictor.ukf.fastest[:2])
    # a quarter of it throughout the minute, and what a current may do in a turn
    assert 10.0 < twin.estimate().sd[0] < (1.1 * 0.25 + 0.15) * fastest * 60.0


def lost_otter(turned, seed, current_to=0.0):
    """Return error (2,) and claimed deviation (2,) a minute after the last fix, m.

    The otter sails north for a minute. Without GPS it then goes on, or turns by more than 60
    degrees, where a current that it took for drag comes from another side.
    """
    commands = np.full((2400, 4), 0.0)
    commands[:, :2] = 8.0
    if turned:
        commands[1240:1440, 0], commands[1240:1440, 1] = 11.5, 2.0
    sea = SeaState(hs=0.05, wind=0.5, current=0.2, current_to=current_to)
    vessel = Vessel.load("otter")
    log = simulate(commands, vessel=vessel, sea=sea, duration=120.0, seed=seed)
    twin = Twin(particulars_of(vessel), "dsw-ukf-plus")
    twin.run(log.slice(t1=60.001))
    twin.run(without_gps(log, 60.001))
    found = twin.estimate()
    return found.state[:2] - log.truth[-1, :2], found.sd[:2], found.state[2]


def test_turn_without_gps_makes_a_position_less_sure():
    straight, turned = (lost_otter(turned, 1) for turned in (False, True))
    assert abs(straight[2]) < 0.5 < 1.0 < abs(turned[2])
    assert np.hypot(*turned[1]) > 1.3 * np.hypot(*straight[1])


def test_current_that_no_turn_has_shown_is_within_what_is_claimed():
    runs = [lost_otter(True, seed, math.radians(45.0 * seed)) for seed in range(8)]
    inside = [np.sum((error / sd) ** 2) < 4.605 for error, sd, _heading in runs]
    assert np.mean(inside) >= 0.75


def test_boat_that_has_changed_is_predicted_soon():
    """A current of 1 m/s sets in: the refits look back to the change."""
    boat = Vessel.load("usv75")
    simulation = Simulation(1, boat, SeaState(hs=0.5, wind=4.5), dt=CONTROL_STEP_S)

    def set_in(t: float, simulation: Simulation) -> None:
        simulation.weather["current_east"] = float(t >= 90.0)

    log = sail(prepare(simulation, "turn", 130.0, 1), set_in)
    twin = Twin(particulars_of(boat), "dsw-ukf-plus")
    twin.run(log.slice(0.0, 80.0))
    assert twin.predictor.selector.state.count[CHANGED] < 0.0
    twin.run(log.slice(80.05, 120.0))
    # the rows of the window are a quarter of a second apart
    assert twin.predictor.selector.state.count[CHANGED] * GRID > 80.0
    assert abs(current_of(twin)[0][1] - 1.0) < 0.4


def test_without_gps_a_model_that_errs_says_so() -> None:
    """A current that is wrong by half a metre a second is tried while fixes come."""
    log = simulate("turn", vessel=Vessel.load("otter"), sea=SeaState(), duration=170.0, seed=1)
    said = {}
    for wrong in (0.0, 0.5):
        twin = Twin(particulars_of(Vessel.load("otter")), "ukf")
        at = twin.predictor.parameter_names.index("C_north")
        for t, z, cmd in log.slice(0.0, 140.0):
            twin.step(t, z, cmd)
            if wrong > 0.0 and t > 20.0:
                twin.predictor.ukf.xi[at] = wrong
        twin.run(without_gps(log, 140.05))
        said[wrong] = float(twin.estimate().sd[0])
    assert said[0.5] > 2.0 * said[0.0]


def test_an_outage_is_no_trial_of_the_model() -> None:
    """Without fixes the navigation is the model's: it cannot tell how far that errs."""
    log = simulate("turn", vessel=Vessel.load("otter"), sea=SeaState(), duration=220.0, seed=1)
    twin = Twin(particulars_of(Vessel.load("otter")), "ukf")
    twin.run(log.slice(0.0, 100.0))
    drift = float(twin.predictor._nav["drift_var"])
    twin.run(without_gps(log, 100.05))
    assert drift > 0.0
    assert float(twin.predictor._nav["drift_var"]) == drift


def test_rows_under_doubted_commands_count_as_no_data(log) -> None:
    twin = Twin(particulars_of(Vessel.load("usv75")), "ukf")
    twin.run(log.slice(0.0, 30.0))
    before = twin.predictor.ukf.counted[1]
    assert before > 10.0
    for t, z, cmd in log.slice(30.05, 60.0):
        twin.predictor.suspend_learning(commands=True, motion=False)
        twin.predictor.update(t, 0.05, z, cmd)
    assert twin.predictor.ukf.counted[1] == before


@pytest.mark.parametrize("vessel", ["usv75", "otter", "wamv16"])
def test_without_compass_and_gyro_the_heading_is_that_of_the_course(vessel) -> None:
    """It was taken for the reverse within ten seconds, with a quarter of a radian claimed."""
    sea = SeaState(current=0.2, current_to=1.0)
    log = simulate("zigzag", vessel=Vessel.load(vessel), sea=sea, duration=110.0, seed=2)
    assert log.truth is not None
    twin = Twin(particulars_of(Vessel.load(vessel)), "ukf")
    worst = 0.0
    for row, (t, z, cmd) in enumerate(log.without_truth()):
        z = z.copy()
        z[MEASUREMENTS.index("gyro_radps")] = math.nan
        if t > 70.0:
            z[MEASUREMENTS.index("compass_rad")] = math.nan
        twin.step(t, z, cmd)
        if t > 70.0:
            off = math.remainder(twin.estimate().state[2] - log.truth[row, 2], 2.0 * math.pi)
            worst = max(worst, abs(off))
    assert worst < 1.0  # of a WAM-V 16 .9, of the others .3
