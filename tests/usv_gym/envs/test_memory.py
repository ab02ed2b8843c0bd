"""Memory does not grow while boats sail, episode after episode."""

import gc
import os
import weakref
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import usv_gym  # noqa: F401 - registers the environment

STATM = Path("/proc/self/statm")
N, STEPS = 64, 1_000_000


def resident() -> float:
    """Return the memory that the process holds, MB."""
    gc.collect()
    return int(STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


@pytest.mark.slow
@pytest.mark.skipif(not STATM.exists(), reason="reads /proc")
def test_a_million_steps_take_no_memory():
    envs = gym.make_vec("USVTwin-v0", num_envs=N, twin=None, task="free")
    envs.reset(seed=0)
    actions = np.tile(np.array([0.8, 0.1], np.float32), (N, 1))

    def sail(steps):
        for _ in range(steps // N):
            envs.step(actions)

    sail(5000 * N)  # two ends of episodes
    before = resident()
    sail(STEPS)
    assert resident() - before < 3.0


@pytest.mark.parametrize(
    ("make", "options"),
    [
        (gym.make, {"twin": "ukf"}),
        (gym.make, {"twin": None, "record": True}),
        (gym.make_vec, {"twin": "ukf", "num_envs": 3}),
    ],
)
def test_a_dropped_environment_is_gone_at_once(make, options):
    """Without help of the collector: nothing that an environment holds refers back to it."""
    env = make("USVTwin-v0", **options)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    episodes = weakref.ref(env.unwrapped.episodes)
    gc.disable()
    try:
        env.close()
        del env
        assert episodes() is None
    finally:
        gc.enable()
