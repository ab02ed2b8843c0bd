"""Memory does not grow while boats sail, episode after episode."""

from __future__ import annotations

import gc
import os
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
