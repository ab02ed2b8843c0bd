"""Libraries for learning take the environments as they are, each as its users do."""

import gc
import os
import warnings

import gymnasium as gym
import numpy as np
import pytest

import usv_gym  # noqa: F401 - registers the environment

TASK = {"twin": "ukf", "observation": "compact", "frame_skip": 10, "sea": "0"}


def test_wrappers_of_cleanrl_take_single_and_vector_environments():
    """Those of ppo_continuous_action.py, which are Gymnasium's."""

    def make():
        env = gym.make("USVTwin-v0", max_episode_steps=6, **TASK)
        env = gym.wrappers.FlattenObservation(env)
        env = gym.wrappers.RecordEpisodeStatistics(env)
        env = gym.wrappers.ClipAction(env)
        env = gym.wrappers.NormalizeObservation(env)
        env = gym.wrappers.TransformObservation(
            env, lambda obs: np.clip(obs, -10.0, 10.0), env.observation_space
        )
        env = gym.wrappers.NormalizeReward(env, gamma=0.99)
        return gym.wrappers.TransformReward(env, lambda reward: float(np.clip(reward, -10, 10)))

    several = gym.vector.SyncVectorEnv([make, make])
    native = gym.make_vec("USVTwin-v0", num_envs=2, max_episode_steps=6, **TASK)
    native = gym.wrappers.vector.RecordEpisodeStatistics(native)
    native = gym.wrappers.vector.NormalizeObservation(native)
    for envs in (several, native):
        obs, _ = envs.reset(seed=1)
        assert obs.shape == (2, 14)
        for _step in range(6):
            obs, rewards, _, truncated, infos = envs.step(3.0 * np.ones((2, 2), np.float32) / 3.0)
            assert np.isfinite(obs).all() and np.isfinite(rewards).all()
        assert truncated.all() and infos["episode"]["l"].tolist() == [6, 6]
        envs.close()


@pytest.mark.slow
def test_torchrl_takes_single_environments_and_the_native_vector_with_resets_of_its_own():
    torchrl = pytest.importorskip("torchrl.envs", reason="torchrl is not installed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torchrl's own
        # GymEnv would keep frame_skip for itself
        single = torchrl.GymWrapper(gym.make("USVTwin-v0", **TASK))
        torchrl.check_env_specs(single)
        made = gym.make_vec(
            "USVTwin-v0", num_envs=3, max_episode_steps=5, autoreset_mode="Disabled", **TASK
        )
        envs = torchrl.GymWrapper(made)
        sailed = envs.rollout(12, break_when_any_done=False)
    assert sailed["observation"].shape == (3, 12, 14)
    done = sailed["next", "truncated"][..., 0]
    assert done[:, 4::5].all() and int(done.sum()) == 6
    single.close()
    envs.close()


@pytest.mark.slow
def test_minari_collects_episodes(tmp_path, monkeypatch):
    minari = pytest.importorskip("minari", reason="minari is not installed")
    pytest.importorskip("jax", reason="minari's DataCollector needs jax")
    monkeypatch.setitem(os.environ, "MINARI_DATASETS_PATH", str(tmp_path))
    env = minari.DataCollector(gym.make("USVTwin-v0", max_episode_steps=4, **TASK))
    env.reset(seed=1)
    while not env.step(np.array([0.7, 0.0], np.float32))[3]:
        pass
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of author and link, and of minari's temporary folder
        data = env.create_dataset("usv/collected-v0", algorithm_name="constant")
        env.close()
        env = None
        gc.collect()
    (episode,) = data.iterate_episodes()
    assert episode.observations.shape == (5, 14)
    assert data.recover_environment().spec.kwargs == TASK
