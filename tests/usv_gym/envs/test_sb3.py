"""The adapter to Stable-Baselines3 against its own vector of single environments."""

import gymnasium as gym
import numpy as np
import pytest

import usv_gym  # noqa: F401 - registers the environment

pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed")

from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from usv_gym.envs.sb3 import SB3VecEnv
from usv_kernel.errors import BoatIndexError

OPTIONS = {"twin": "ukf", "faults": "gps3@2", "max_episode_steps": 60}


def test_it_is_the_dummy_vector_of_monitored_environments():
    ours = SB3VecEnv(3, infos=True, **OPTIONS)
    theirs = DummyVecEnv([lambda: Monitor(gym.make("USVTwin-v0", **OPTIONS))] * 3)
    for envs in (ours, theirs):
        envs.seed(5)
    np.testing.assert_array_equal(ours.reset(), theirs.reset())
    assert ours.reset_infos == theirs.reset_infos
    rng, ended = np.random.default_rng(0), 0
    for _ in range(130):
        action = rng.uniform(-1.0, 1.0, (3, 2)).astype(np.float32)
        a, b = ours.step(action), theirs.step(action)
        np.testing.assert_array_equal(a[0], b[0])
        np.testing.assert_allclose(a[1], b[1], rtol=1e-6)
        np.testing.assert_array_equal(a[2], b[2])
        for mine, other in zip(a[3], b[3], strict=True):
            episode, known = mine.pop("episode", None), other.pop("episode", None)
            last, known_last = mine.pop("terminal_observation", None), None
            known_last = other.pop("terminal_observation", None)
            assert (last is None) == (known_last is None)
            if last is not None:
                np.testing.assert_array_equal(last, known_last)
                assert episode["l"] == known["l"]
                assert episode["r"] == pytest.approx(known["r"], abs=1e-4)
                assert mine["TimeLimit.truncated"]
                ended += 1
            other.pop("TimeLimit.truncated", None), mine.pop("TimeLimit.truncated", None)
            assert mine == other
    assert ended == 6


def test_attributes_and_methods_are_reached():
    envs = SB3VecEnv(2, twin="ukf")
    envs.reset()
    assert envs.get_attr("max_episode_steps") == [2400, 2400]
    assert envs.get_attr("num_envs", indices=1) == [2]
    assert envs.get_attr("action_space") == [envs.action_space] * 2
    with pytest.raises(BoatIndexError, match="boats count from 0 to 1"):
        envs.get_attr("task", indices=9)
    with pytest.raises(TypeError, match="all boats at once"):
        envs.env_method("reset")
    twins = envs.env_method("twin", indices=[1])
    assert [twin.t for twin in twins] == [0.0]
    envs.set_attr("max_episode_steps", 5)
    assert envs.get_attr("max_episode_steps") == [5, 5]
    with pytest.raises(ValueError, match="shared by all boats"):
        envs.set_attr("max_episode_steps", 5, indices=0)
    assert not envs.has_attr("no_such_thing")
    assert envs.env_is_wrapped(Monitor) == [True, True]
    assert envs.env_is_wrapped(gym.wrappers.TimeLimit) == [False, False]
    envs.close()


def test_sb3_env_refuses_what_it_cannot_wrap():
    with pytest.raises(ValueError, match="autoreset_mode='SameStep'"):
        SB3VecEnv(gym.make_vec("USVTwin-v0", num_envs=2, twin=None))
    with pytest.raises(TypeError, match="as it was made"):
        SB3VecEnv(gym.make_vec("CartPole-v1", num_envs=2))
    with pytest.raises(TypeError, match="twin: options belong"):
        SB3VecEnv(gym.make_vec("USVTwin-v0", num_envs=2, twin=None), twin="ukf")
