"""Random actions and episodes, for tests."""

from typing import Any

import gymnasium as gym
import numpy as np


def actions_of(env: gym.Env[Any, Any], count: int, seed: int = 0) -> np.ndarray:
    """Return smooth actions within the space."""
    rng = np.random.default_rng(seed)
    width = env.action_space.shape[0]  # type: ignore[index]
    knots = rng.uniform(-1.0, 1.0, (count // 60 + 2, width))
    knots[:, : width // 2] = 0.65 + 0.35 * knots[:, : width // 2]
    at = np.arange(count) / 60.0
    columns = [np.interp(at, np.arange(len(knots)), column) for column in knots.T]
    return np.stack(columns, axis=1).astype(np.float32)


def episode(env: gym.Env[Any, Any], seed: int | None, count: int) -> tuple[np.ndarray, list[Any]]:
    obs, info = env.reset(seed=seed)
    observations, others = [obs], [info]
    for action in actions_of(env, count):
        obs, reward, terminated, truncated, info = env.step(action)
        observations.append(obs)
        others.append((reward, terminated, truncated, info))
        if terminated or truncated:
            break
    return np.array(observations), others
