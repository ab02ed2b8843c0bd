"""The native vector environment for Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from usv_gym.envs.vector import USVVectorEnv
from usv_kernel.errors import ArgumentError, UsvTwinError

__all__ = [
    "SB3VecEnv",
]

try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError(
        "usv_gym.envs.sb3 needs stable-baselines3: pip install 'usv-twin[rl]'"
    ) from error

Indices = int | Iterable[int] | None


class SB3VecEnv(VecEnv):
    """A native vector environment as Stable-Baselines3 wants it.

    An episode that is over starts again within the same step; ``infos[i]`` then holds
    ``terminal_observation`` and ``TimeLimit.truncated``, and ``episode`` with its return
    ``r``, length ``l`` and time ``t``, as Monitor would give it.

    Parameters
    ----------
    envs : USVVectorEnv or int
        Made with ``gym.make_vec("USVTwin-v0", num_envs=..., autoreset_mode="SameStep")``; or the
        number of boats, and the rest as keywords.
    infos : bool
        Hand out the infos of every step, not only those of episodes that are over. They are a
        dict for each boat, and cost about 1 us each.
    **kwargs
        With a number of boats: options of ``gym.make_vec("USVTwin-v0", ...)``.

    Examples
    --------
    >>> from stable_baselines3 import PPO
    >>> from usv_gym.envs.sb3 import SB3VecEnv
    >>> model = PPO("MlpPolicy", SB3VecEnv(64, twin="ukf"))  # doctest: +SKIP
    """

    def __init__(
        self, envs: USVVectorEnv | gym.vector.VectorEnv[Any, Any, Any] | int, *,
        infos: bool = False, **kwargs: Any,
    ) -> None:  # fmt: skip
        if isinstance(envs, (int, np.integer)):
            same = {"autoreset_mode": AutoresetMode.SAME_STEP}
            made = gym.make_vec("USVTwin-v0", num_envs=int(envs), **(same | kwargs))
        elif kwargs:
            raise ArgumentError(
                f"{', '.join(kwargs)}: options belong to where the environment is made"
            )
        else:
            made = envs
        native = getattr(made, "unwrapped", None)
        if native is not made or not isinstance(native, USVVectorEnv):
            raise ArgumentError(
                f"SB3VecEnv takes the native vector environment as it was made, not {made}"
            )
        if native.autoreset_mode != AutoresetMode.SAME_STEP:
            raise UsvTwinError(
                "Stable-Baselines3 resets within the step: make the environment with "
                "autoreset_mode='SameStep'"
            )
        self.envs, self.infos = native, infos
        self._returns = np.zeros(native.num_envs)
        self._lengths = np.zeros(native.num_envs, dtype=np.int64)
        super().__init__(
            native.num_envs, native.single_observation_space, native.single_action_space
        )

    def reset(self) -> np.ndarray:
        """Begin all episodes, with the seeds that were set."""
        options = next((options for options in self._options if options), None)
        seeds = self._seeds
        self._reset_seeds()
        self._reset_options()
        obs, infos = self.envs.reset(seed=seeds, options=options)
        fresh = infos["_t_s"]
        self._returns[fresh], self._lengths[fresh] = 0.0, 0
        self.reset_infos = [one(infos, i) for i in range(self.num_envs)]
        return obs

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions (n, A) of the step to come."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Take the step."""
        obs, rewards, terminated, truncated, infos = self.envs.step(self._actions)
        dones = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        if self.infos:
            over = {"TimeLimit.truncated": False}
            listed = [one(infos, i) | over for i in range(self.num_envs)]
        else:
            listed = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(dones):
            # what the ended episode said, not the new one
            listed[i] = one(infos["final_info"], int(i)) | {
                "terminal_observation": infos["final_obs"][i],
                "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                "episode": {
                    "r": round(float(self._returns[i]), 6),
                    "l": int(self._lengths[i]),
                    "t": infos["final_info"]["t_s"].item(i),
                },
            }
        self._returns[dones], self._lengths[dones] = 0.0, 0
        return obs, rewards.astype(np.float32), dones, listed

    def close(self) -> None:
        """End the environment's threads."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute of the environment, once for each boat; spaces are those of one."""
        one_for_each = ("action_space", "observation_space")
        value = getattr(
            self.envs, f"single_{attr_name}" if attr_name in one_for_each else attr_name
        )
        return [value for _ in self._boats(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the environment, which all boats share."""
        if indices is not None and set(self._boats(indices)) != set(range(self.num_envs)):
            raise UsvTwinError(f"{attr_name} is shared by all boats: leave out the indices")
        setattr(self.envs, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the environment with a boat's number before the arguments.

        ``env_method("twin")`` gives the twins.
        """
        if method_name in ("reset", "step", "render", "close"):
            raise ArgumentError(f"{method_name} is for all boats at once: call it on the vector")
        method = getattr(self.envs, method_name)
        return [method(i, *method_args, **method_kwargs) for i in self._boats(indices)]

    def _boats(self, indices: Indices) -> list[int]:
        boats = list(self._get_indices(indices))
        if not set(boats) <= set(range(self.num_envs)):
            raise IndexError(f"indices {boats}: boats count from 0 to {self.num_envs - 1}")
        return boats

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Indices = None
    ) -> list[bool]:
        """Return False: nothing wraps a boat of a native vector environment.

        Of Monitor it returns True, because the infos have what it would add.
        """
        return [issubclass(wrapper_class, Monitor) for _ in self._boats(indices)]

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return a picture of each boat; None in their place without ``render_mode``."""
        return self.envs.render() or [None] * self.num_envs


def one(infos: dict[str, Any], i: int) -> dict[str, Any]:
    """Return the infos of one boat, as its single environment would give them."""
    found: dict[str, Any] = {}
    for key, value in infos.items():
        if key.startswith("_") or key in ("final_info", "final_obs") or not infos[f"_{key}"][i]:
            continue
        found[key] = one(value, i) if isinstance(value, dict) else value.item(i)
    return found
