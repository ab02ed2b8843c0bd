"""Training of a residual: a classical controller steers, and the agent corrects it.

The action is ``clip(base + share * correction, -1, 1)``. The networks see the agent's observation
and, behind it, the action of the controller.

Source: Johannink et al. 2019, Residual Reinforcement Learning for Robot Control, ICRA.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from twin.agents.controllers import LOS
from twin.agents.mpc import ModelPredictive
from usv_gym.envs.sb3 import SB3VecEnv

__all__ = ["ResidualVecEnv", "ScaledReward"]

Info = dict[str, Any]


class ResidualVecEnv(VecEnvWrapper):
    """Boats that a controller steers, with corrections as actions.

    Parameters
    ----------
    venv : SB3VecEnv
        The boats; their observation has all that the controller needs.
    base : LOS or ModelPredictive
        The controller. It forgets what it remembers of a boat where an episode ends.
    share : float
        What a correction of 1 adds to an action of the controller.
    seen : int
        The agent sees so many entries of the observation, the first ones.
    """

    def __init__(
        self, venv: SB3VecEnv, base: LOS | ModelPredictive, share: float, seen: int
    ) -> None:
        self.base, self.share, self.seen = base, share, seen
        self.envs = venv.envs
        width = venv.action_space.shape[0]  # type: ignore[index]
        bound = np.full(seen + width, np.inf, np.float32)
        super().__init__(venv, spaces.Box(-bound, bound))
        self._actions: NDArray[np.float64] = np.zeros((venv.num_envs, width))

    def reset(self) -> NDArray[np.float32]:
        """Begin all episodes."""
        obs = self.venv.reset()
        self.base.begin(self.envs)
        return self._seen(obs)

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Take the corrections (n, A) of the step to come."""
        self.venv.step_async(np.clip(self._actions + self.share * actions, -1.0, 1.0))

    def step_wait(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[Info]]:
        """Take the step."""
        obs, rewards, dones, infos = self.venv.step_wait()
        assert isinstance(obs, np.ndarray)
        if dones.any():
            # behind the last observation of an episode stands the action that led to it
            for i in np.flatnonzero(dones):
                last = infos[i]["terminal_observation"][: self.seen]
                infos[i]["terminal_observation"] = _joined(last, self._actions[i])
            self.base.forget(dones)
        return self._seen(obs), rewards, dones, infos

    def _seen(self, obs: Any) -> NDArray[np.float32]:
        """Return what the agent sees; the controller decides once for each observation."""
        self._actions = self.base.act(obs)
        return _joined(obs[:, : self.seen], self._actions)


def _joined(obs: NDArray[np.float32], actions: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return observations with actions behind them."""
    return np.concatenate([obs, actions], axis=-1, dtype=np.float32, casting="same_kind")


class ScaledReward(VecEnvWrapper):
    """Rewards times a scale, and none below a bound: a failure is no outlier then."""

    def __init__(self, venv: VecEnv, scale: float, least: float) -> None:
        super().__init__(venv)
        self.scale, self.least = scale, least
        self.envs = venv.envs  # type: ignore[attr-defined]

    def reset(self) -> Any:
        """Begin all episodes."""
        return self.venv.reset()

    def step_wait(self) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], list[Info]]:
        """Take the step."""
        obs, rewards, dones, infos = self.venv.step_wait()
        return obs, np.maximum(self.scale * rewards, np.float32(self.least)), dones, infos
