"""The environment: its API, its errors, its determinism, and that the twin sees no truth."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from tests.usv_gym.envs.acting import actions_of, episode
from twin import Twin
from twin.integrity.state import SENSORS
from twin.sim.batched_twins import HORIZONS, TWIN_OBSERVATION
from twin.sim.bridge import particulars_of
from twin.sim.wrapper import TwinObservation, make_env
from usv_gym import Fault
from usv_gym.envs.env import USVEnv
from usv_gym.envs.episodes import OBSERVATION
from usv_gym.physics import frames as fr

INDEX = {name: i for i, name in enumerate((*OBSERVATION, *TWIN_OBSERVATION))}
AHEAD = np.array([0.8, 0.0], dtype=np.float32)
INFO = {"t_s", "cross_track_m", "leg", "is_success", "capsized", "reward_terms"}

INFO_OF_TWIN = {"twin_position_error_m", "twin_forecast"}
INFO_OF_TWIN |= {f"twin_health_{sensor}" for sensor in SENSORS}

# ------------------------------------------------- the APIs


def test_a_free_manoeuvre_has_no_reward_and_only_the_time_limit_ends_it() -> None:
    env = gym.make("USVTwin-v0", twin=None, task="free")
    env.reset(seed=0)
    for k in range(1, 2401):
        _, reward, terminated, truncated, info = env.step(np.array([0.8, 0.1], np.float32))
        assert not terminated and reward == 0.0
        assert truncated == (k == 2400)
    assert info["t_s"] == pytest.approx(120.0)
    # the line to the north: distance to starboard is y
    y = env.unwrapped.simulation.state[0, fr.Y]
    assert info["cross_track_m"] == pytest.approx(y, abs=1e-9)


def test_without_twin_it_is_the_plain_environment() -> None:
    env = make_env(twin=None)
    assert type(env) is USVEnv
    assert env.observation_space.shape == (len(OBSERVATION),)
    with_twin = make_env()
    assert with_twin.observation_space.shape == (len(INDEX),)
    np.testing.assert_array_equal(with_twin.reset(seed=1)[0][:23], env.reset(seed=1)[0])
    np.testing.assert_array_equal(with_twin.step(AHEAD)[0][:23], env.step(AHEAD)[0])


def test_a_twin_is_named_or_an_object() -> None:
    predictor = Twin(particulars_of(make_env(twin=None).vessel), "ukf").predictor
    by_object, by_name = make_env(twin=predictor, task="free"), make_env(twin="ukf", task="free")
    for env in (by_object, by_name):
        env.reset(seed=0)
    for action in actions_of(by_name, 50):
        np.testing.assert_array_equal(by_object.step(action)[0], by_name.step(action)[0])


# ------------------------------------------------- determinism


# ------------------------------------------------- actions


@pytest.mark.parametrize("twin", [None, "ukf"])
@pytest.mark.parametrize(
    ("action", "words"),
    [
        ([math.nan, 0.0], "NaN"),
        ([0.0, math.inf], "NaN"),
        ([0.0] * 4, "shape"),
        ([[0.0, 0.0]], "shape"),
        (None, "shape"),
        ({"throttle": 1.0}, "numbers"),
        ([[0.0], [0.0, 1.0]], "numbers"),
    ],
)
def test_a_bad_action_is_reported_and_changes_nothing(
    twin: str | None, action: Any, words: str
) -> None:
    env, undisturbed = (make_env(twin=twin, task="free") for _ in range(2))
    for e in (env, undisturbed):
        e.reset(seed=0)
        e.step(AHEAD)
    with pytest.raises(ValueError, match=words):
        env.step(action)
    for _ in range(3):
        one, two = env.step(-AHEAD), undisturbed.step(-AHEAD)
        np.testing.assert_array_equal(one[0], two[0])
        assert one[1:] == two[1:]


def test_more_than_full_is_full() -> None:
    env, full = (make_env(twin=None, task="free") for _ in range(2))
    for e in (env, full):
        e.reset(seed=0)
    one, two = env.step(np.array([7.0, -3.0])), full.step(np.array([1.0, -1.0]))
    np.testing.assert_array_equal(one[0], two[0])
    assert one[0][INDEX["shaft_left"]] == 1.0
    assert one[0][INDEX["drive_right"]] == -1.0


def test_units_are_the_four_actuators() -> None:
    common, units = (make_env(twin=None, actions=a, task="free") for a in ("common", "units"))
    for env in (common, units):
        env.reset(seed=0)
    for _ in range(20):
        one, two = common.step(np.array([0.8, 0.3])), units.step(np.array([0.8, 0.8, 0.3, 0.3]))
        np.testing.assert_array_equal(one[0], two[0])
    obs = units.step(np.array([0.1, 0.2, 0.3, 0.4], dtype=np.float32))[0]
    np.testing.assert_allclose(obs[13:17], [0.1, 0.2, 0.3, 0.4], rtol=1e-6)
    limits = units.vessel.values
    np.testing.assert_allclose(
        units.simulation.cmd[0],
        np.array([0.1, 0.2, 0.3, 0.4])
        * np.repeat([limits["shaft_speed_service"], limits["steer_max"]], 2),
        rtol=1e-6,
    )


def test_the_action_is_not_written_to() -> None:
    env, action = make_env(twin=None), np.array([3.0, 0.5])
    env.reset(seed=0)
    env.step(action)
    np.testing.assert_array_equal(action, [3.0, 0.5])


@pytest.mark.parametrize("twin", [None, "ukf"])
def test_step_before_reset_is_refused(twin: str | None) -> None:
    with pytest.raises(gym.error.ResetNeeded, match="reset"):
        make_env(twin=twin).step(AHEAD)


# ------------------------------------------------- arguments


def test_unknown_reset_options_are_refused() -> None:
    with pytest.raises(ValueError, match="unknown reset options: wind"):
        make_env(twin=None).reset(seed=0, options={"wind": 3})


def test_only_a_vessel_at_sea_can_have_a_twin() -> None:
    with pytest.raises(TypeError, match="wraps environments over USVEnv, not CartPole"):
        TwinObservation(gym.make("CartPole-v1"))  # type: ignore[arg-type]
    flat = gym.wrappers.FrameStackObservation(USVEnv(), 2)
    with pytest.raises(TypeError, match="comes before other observations"):
        TwinObservation(flat)


# ------------------------------------------------- observations and losses


def test_observations_tell_the_truth_with_perfect_sensors() -> None:
    """The observation table of the class, entry by entry."""
    env = make_env(twin=None, suite="perfect", sea="calm")
    env.reset(seed=5)
    for action in actions_of(env, 150):
        obs, *_ = env.step(action)
        s = env.simulation.state[0]
        errors = env.task.errors[0]
        expected = {
            "cos_heading": math.cos(s[fr.PSI]),
            "sin_heading": math.sin(s[fr.PSI]),
            "yaw_rate": s[fr.R],
            "speed_forward": s[fr.U] / env.speed,
            "speed_starboard": s[fr.V] / env.speed,
            "accel_forward": env.simulation.z[0, 6] / 9.80665,
            "accel_starboard": env.simulation.z[0, 7] / 9.80665,
            **{f"{sensor}_valid": 1.0 for sensor in ("gps", "compass", "imu")},
            **{f"{sensor}_age": 0.0 for sensor in ("gps", "compass", "imu")},
            **{name: action[0] for name in ("shaft_left", "shaft_right")},
            **{name: action[1] for name in ("drive_left", "drive_right")},
            "cross_track": errors[0] / 10.0,
            "to_go": errors[1] / 100.0,
            "cos_course_error": math.cos(errors[2]),
            "sin_course_error": math.sin(errors[2]),
            "cos_next_turn": math.cos(errors[3]),
            "sin_next_turn": math.sin(errors[3]),
        }
        assert set(expected) == set(OBSERVATION)
        for name, value in expected.items():
            # float32
            assert obs[INDEX[name]] == pytest.approx(value, rel=1e-6, abs=1e-6), name


def test_the_twins_part_tells_nearly_the_truth_with_perfect_sensors() -> None:
    """The table of TwinObservation: places, turns and speeds ahead, in a steady turn."""
    env = make_env(suite="perfect", sea="calm", task="free")
    env.reset(seed=5)
    base, action, seen, truth = env.unwrapped, np.array([0.8, 0.5]), [], []
    for _ in range(1400):
        seen.append(env.step(action)[0])
        truth.append(base.simulation.state[0].copy())
    now = 1000  # 50 s: the turn has long been steady
    obs, s = seen[now], truth[now]
    for name, value in {
        "twin_surge": s[fr.U] / base.speed,
        "twin_sway": s[fr.V] / base.speed,
        "twin_yaw_rate": s[fr.R],
        "twin_cos_heading": math.cos(s[fr.PSI]),
        "twin_sin_heading": math.sin(s[fr.PSI]),
    }.items():
        # the twin does not know that its sensors are perfect: 2 % of the nominal speed
        assert obs[INDEX[name]] == pytest.approx(value, abs=0.02), name
    for h in HORIZONS:
        later = truth[now + round(h / 0.05)]
        place = fr.to_body(later[fr.X] - s[fr.X], later[fr.Y] - s[fr.Y], s[fr.PSI])
        turn = later[fr.PSI] - s[fr.PSI]
        for name, value in {
            "forward": place[0] / (base.speed * h),
            "starboard": place[1] / (base.speed * h),
            "cos_turn": math.cos(turn),
            "sin_turn": math.sin(turn),
            "surge": later[fr.U] / base.speed,
            "yaw_rate": later[fr.R],
        }.items():
            # a steady motion goes on: a tenth, 10 s ahead too
            got = obs[INDEX[f"ahead_{h:g}s_{name}"]]
            assert got == pytest.approx(value, abs=0.1), f"{name} {h} s ahead"
        for name in TWIN_OBSERVATION:
            if name.startswith(f"ahead_{h:g}s_sd"):
                assert obs[INDEX[name]] > 0.0


@pytest.mark.parametrize(
    ("twin", "start", "minutes"),
    [(None, 20.0, 10), ("ukf", 0.0, 10), ("persistence", 20.0, 1)],
)
def test_observations_stay_finite_without_sensors_in_a_storm(
    twin: str | None, start: float, minutes: int
) -> None:
    """Ten minutes in sea state 6, all sensors gone from the start or from 20 s on."""
    env = make_env(twin=twin, sea="6", task="free", faults=[Fault("all", start, 1e6)])
    obs, _ = env.reset(seed=2)
    for k, action in enumerate(actions_of(env, minutes * 1200)):
        obs, reward, terminated, _, info = env.step(action)
        if not (env.observation_space.contains(obs) and math.isfinite(reward)):
            names = [n for n, i in INDEX.items() if i < len(obs) and not abs(obs[i]) <= 10.0]
            pytest.fail(f"step {k}: {names} outside the space, reward {reward}")
        assert not terminated
    assert np.all(np.isfinite(env.unwrapped.simulation.state))
    assert info["t_s"] == pytest.approx(60.0 * minutes)
    ages = obs[INDEX["gps_age"] : INDEX["imu_age"] + 1]
    # in units of 10 s, cut off at 100 s; the last samples came a step before the loss
    np.testing.assert_allclose(ages, min(6.0 * minutes - 0.1 * start, 10.0), atol=0.02)


def test_a_gps_loss_of_ten_seconds_is_bridged() -> None:
    env = make_env(twin=None, task="free", faults="gps10")
    starts = []
    for seed in range(4):
        observations, _ = episode(env, seed, 1450)
        valid, age = (observations[:, INDEX[f"gps_{name}"]] for name in ("valid", "age"))
        assert set(valid) == {0.0, 1.0}
        latency = env.simulation.suite.delay_steps(0.05)
        assert np.all(valid[:latency] == 0.0)  # before the first fix
        gone = np.flatnonzero(valid[latency:] == 0.0) + latency
        assert len(gone) == 200  # 10 s at 20 Hz, in one piece
        assert gone[-1] - gone[0] == 199
        # the age counts up in units of 10 s, and is 0 with every sample
        np.testing.assert_allclose(age[gone], 0.005 * np.arange(1, 201), rtol=1e-5)
        assert np.all(age[valid == 1.0] == 0.0)
        # the position shown is the last one: to_go can only change by the heading, not at all
        to_go = observations[gone, INDEX["to_go"]]
        assert np.all(to_go == observations[gone[0] - 1, INDEX["to_go"]])
        for other in ("compass", "imu"):
            assert np.all(observations[:, INDEX[f"{other}_valid"]] == 1.0)
        starts.append(gone[0] * 0.05)
    # at random between 10 and 60 s
    assert len(set(starts)) == 4
    assert min(starts) >= 10.0 - 1e-9
    assert max(starts) <= 60.05


# ------------------------------------------------- task, reward, end


@pytest.mark.parametrize("twin", [None, "ukf"])
def test_info_keys_are_constant_and_the_terms_add_up(twin: str | None) -> None:
    env = make_env(twin=twin)
    _, others = episode(env, 3, 300)
    expected = INFO | (INFO_OF_TWIN if twin else set())
    assert set(others[0]) == expected | {"drawn"}
    for reward, terminated, truncated, info in others[1:]:
        assert set(info) == expected
        assert type(reward) is float
        assert type(terminated) is bool
        assert truncated is False
        # a sum of three in the same order; 1e-12 for another
        assert reward == pytest.approx(sum(info["reward_terms"].values()), abs=1e-12)


# ------------------------------------------------- six degrees of freedom, other vessels


@pytest.mark.parametrize("task", ["free", "path"])
def test_capsizing_ends_the_episode(task: str) -> None:
    env = make_env(twin=None, dof=6, task=task, sea="calm")
    env.reset(seed=0)
    *_, terminated, _, info = env.step(AHEAD)
    assert not terminated and not info["capsized"]
    env.simulation.state[0, fr.PHI] = math.radians(170.0)
    obs, _, terminated, _, info = env.step(AHEAD)
    assert terminated and info["capsized"] and not info["is_success"]
    assert np.all(np.isfinite(obs))
