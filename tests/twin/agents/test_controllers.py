"""Classical controllers: they keep to paths, and the more they know the better."""

import gymnasium as gym
import numpy as np
import pytest

import usv_gym  # noqa: F401 - registers the environment
from twin.agents.agent import ControllerError
from twin.agents.controllers import CONTROLLERS, make_controller
from twin.agents.evaluation import evaluate
from twin.agents.mpc import ModelPredictive
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.faults import Fault
from usv_gym.world.sensors import SensorSuite


def boats(agent, n=8, **options):
    options = {"twin": "ukf", "frame_skip": 10, "sea": "2"} | options
    return gym.make_vec(
        "USVTwin-v0",
        num_envs=n,
        observation=agent.observation,
        autoreset_mode="Disabled",
        **options,
    )


def sail(agent, seconds=60.0, n=8, seed=50, moved=0.0, **options):
    """Return cross-track errors (K, n) and actions (K, n, 2); NaN once an episode is over."""
    envs = boats(agent, n, **options)
    obs, _ = envs.reset(seed=seed)
    envs.unwrapped.task.points[:, :, 1] += moved
    agent.begin(envs)
    errors, actions, over = [], [], np.zeros(n, dtype=bool)
    for _ in range(round(seconds / 0.05 / envs.unwrapped.frame_skip)):
        action = agent.act(obs)
        obs, _, ended, _, infos = envs.step(action)
        envs.unwrapped._over[:] = False  # boats that are there sail on
        errors.append(np.where(over, np.nan, infos["cross_track_m"]))
        actions.append(action)
        over |= ended
    envs.close()
    return np.array(errors), np.array(actions)


def mean_error(agent, **options):
    return float(np.nanmean(np.abs(sail(agent, **options)[0])))


def odd(name):
    """Return whether an entry of an observation changes its sign in a mirror."""
    return name.endswith(("cross_track", "yaw_rate", "sway", "starboard")) or "sin_" in name


@pytest.mark.parametrize("vessel", ["usv75", "kvlcc2_l7", "otter"])
@pytest.mark.parametrize("name", CONTROLLERS)
def test_they_come_to_a_straight_line_and_stay_there(name, vessel):
    options = {"sea": "0", "task": "free", "suite": SensorSuite.perfect(), "vessel": vessel}
    length = {"otter": 2.0}.get(vessel, 7.0)
    agent = make_controller(name)
    errors, _ = sail(agent, 150.0, n=1, moved=0.7 * length, **options)
    assert np.abs(errors[0]) > 0.5 * length
    assert np.abs(errors[-40:]).max() < 0.1 * length


def test_who_knows_more_keeps_to_the_path_better():
    """30 s without GPS, in which every boat passes a way point."""
    lost = {"faults": "gps30@8", "seconds": 45.0}
    names = ("los", "los-dr", "los-twin", "los-oracle")
    held, reckoned, inputs, true = (mean_error(make_controller(name), **lost) for name in names)
    assert true < inputs < reckoned < held
    assert inputs < 0.5 * held


@pytest.mark.parametrize("task", ["path", "curves", "station"])
def test_the_model_is_worth_looking_ahead_with(task):
    mpc, los = (mean_error(make_controller(name), task=task) for name in ("mpc-twin", "los-twin"))
    assert mpc < los


def test_steady_control_changes_its_shafts_less_and_keeps_as_near():
    """While waves move the boat: the distance off the path may be a tenth of a length more."""
    found = {
        name: sail(make_controller(name), 60.0, 4, sea="2") for name in ("mpc-twin", "mpc-steady")
    }
    change = {name: np.abs(np.diff(act[..., 0], axis=0)).mean() for name, (_, act) in found.items()}
    assert change["mpc-steady"] < 0.5 * change["mpc-twin"]
    off = {name: np.nanmean(np.abs(errors)) for name, (errors, _) in found.items()}
    assert off["mpc-steady"] < off["mpc-twin"] + 0.7


@pytest.mark.parametrize("name", CONTROLLERS)
@pytest.mark.parametrize("frame_skip", [1, 10])
def test_without_any_sensor_actions_are_still_actions(name, frame_skip):
    dead = [Fault("all", start=0.0, duration=1e3)]
    for faults in (dead, [Fault("all", start=2.0, duration=1e3)]):
        _, actions = sail(make_controller(name), 10.0, 2, faults=faults, frame_skip=frame_skip)
        assert np.isfinite(actions).all() and np.abs(actions).max() <= 1.0


@pytest.mark.parametrize("name", ["los", "los-twin", "los-oracle"])
def test_a_mirrored_observation_gives_the_mirrored_action(name):
    agent = make_controller(name)
    envs = boats(agent, 2)
    obs, _ = envs.reset(seed=3)
    agent.begin(envs)
    sign = np.array([-1.0 if odd(x) else 1.0 for x in envs.unwrapped.observation_names])
    rng = np.random.default_rng(0)
    for _ in range(20):
        one = rng.uniform(-1.0, 1.0, obs.shape[1])
        first, second = agent.act(np.stack([one, sign * one]).astype(np.float32))
        np.testing.assert_allclose(second, [first[0], -first[1]], atol=1e-12)
    assert abs(first[1]) > 0.0


@pytest.mark.parametrize("twin", ["ukf", "dsw-ukf-plus"])
def test_the_plan_is_rolled_as_the_twin_would_roll_it(twin):
    agent = ModelPredictive(steps=0)
    envs = boats(agent, 2, twin=twin)
    obs, _ = envs.reset(seed=5)
    agent.begin(envs)
    for _ in range(30):
        obs, *_ = envs.step(agent.act(obs))
    agent.act(obs)
    work = agent._work
    plan, states = work.plan.copy(), work.paths.states[0]  # the last that was tried
    predictor = envs.unwrapped.twin(1).predictor
    plan[:, :2] /= predictor.ukf.settings.n_unit
    row = agent._config.dt
    if twin == "ukf":
        theirs = predictor.mean(plan, row)
    else:  # without the share of the waves
        predictor.window["wave_ar"][:] = 0.0
        predictor.n[3:6] = predictor.window["slow"]
        theirs = predictor.mean(plan, row)
    np.testing.assert_allclose(states, theirs, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("speed", [1.5, 6.0])
def test_near_its_point_the_nominal_speed_changes_no_shaft_speed(speed):
    los = make_controller("los-twin")
    los.fit(Vessel.load("usv75"), speed, 0.5, 20.0)
    # half of the last 20 m is left: a quarter of the nominal speed is right there
    to_go, wanted = 10.0, 0.25
    motion = np.array([[0.0, to_go, 1.0, 0.0, 1.0, 0.0, 0.0, u] for u in (wanted, 0.5, 0.0)])
    shafts = los.steer(motion)[:, 0] / los.shaft
    np.testing.assert_allclose(shafts, [wanted, wanted - 0.5, 3.0 * wanted])


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("pid", {}, "known: los"),
        ("los", {"colour": 1}, "colour"),
        ("los", {"lookahead": 0.0}, "lookahead"),
        ("mpc-twin", {"horizon": -1.0}, "horizon"),
        ("dock-twin", {"slow": 0.0}, "slow"),
        ("dock-twin", {"push": float("nan")}, "push"),
        ("dock-twin", {"lookahead": -1.0}, "lookahead"),
    ],
)
def test_wrong_options_are_named(name, options, said):
    with pytest.raises(ControllerError, match=said):
        make_controller(name, **options)


@pytest.mark.parametrize(
    ("name", "env", "said"),
    [
        ("los-twin", {"observation": "raw"}, "twin_cross_track"),
        ("mpc-twin", {"twin": "persistence"}, "twin='ukf'"),
        ("los-twin", {"twin": "ukf", "actions": "units"}, "actions='common'"),
    ],
)
def test_boats_that_do_not_suit_are_named(name, env, said):
    with pytest.raises(ControllerError, match=said):
        make_controller(name).begin(gym.make_vec("USVTwin-v0", num_envs=1, **env))


def docked(name, seeds, **options):
    """Return the share of episodes in which a boat comes to rest in its berth."""
    rows = evaluate(make_controller(name), seeds=seeds, task="docking", **options)
    return float(np.mean([row["success"] for row in rows])), rows


def test_a_boat_is_docked_in_wind_and_current_without_gps_for_a_while():
    """On seeds that nothing was tuned on; line of sight alone stops there less often."""
    worlds = {"faults": "gps10", "current": "any", "wind_from_deg": "any"}
    share, rows = docked("dock-twin", range(8000, 8012), **worlds)
    assert share > 0.75 and not any(row["failed"] for row in rows)
    assert docked("los-twin", range(8000, 8012), **worlds)[0] < share - 0.1
    assert docked("dock-oracle", range(8000, 8012), **worlds)[0] > 0.75
