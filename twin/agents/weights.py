"""Policies of Stable-Baselines3: into a policy file, or as they were saved."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twin.agents.policy import AgentError, Policy

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecNormalize

    from usv_gym.envs.vector import USVVectorEnv

__all__ = ["SIX_LINES", "SavedPolicy", "begin_nominal", "policy_of"]

SIX_LINES = (
    "write the six lines of an agent with its own observation and actions, as in "
    "docs/tutorials/train_agent.md, and name it module:Class"
)
"""What to do with a model of another kind."""


def actor_layers(net: Any) -> list[Any]:
    """Return the linear layers of the deterministic actor of a policy of Stable-Baselines3."""
    off_policy = hasattr(net, "actor")
    hidden = net.actor.latent_pi if off_policy else net.mlp_extractor.policy_net
    last = net.actor.mu if off_policy else net.action_net
    return [layer for layer in (*hidden, last) if hasattr(layer, "weight")]


def policy_of(
    model: Any, envs: VecNormalize, name: str, observation: Any, settings: dict[str, Any],
    base: str = "", share: float = 1.0,
) -> Policy:  # fmt: skip
    """Return the deterministic actor of a model of PPO, SAC or RecurrentPPO as plain arrays.

    ``observation`` is the set that it sees, or names of entries; ``settings`` are kept in the file.
    ``base`` is the controller that it corrects, and ``share`` what a correction of 1 adds.
    """
    net = model.policy
    off_policy = hasattr(net, "actor")
    layers = [(_array(layer.weight), _array(layer.bias)) for layer in actor_layers(net)]
    lstm = None
    if hasattr(net, "lstm_actor"):
        of = net.lstm_actor
        bias = _array(of.bias_ih_l0 + of.bias_hh_l0)
        lstm = _array(of.weight_ih_l0), _array(of.weight_hh_l0), bias
    size = envs.observation_space.shape[0]
    mean, sd, clip = np.zeros(size), np.ones(size), np.inf
    if envs.norm_obs:
        mean, clip = envs.obs_rms.mean.copy(), float(envs.clip_obs)
        sd = np.sqrt(envs.obs_rms.var + envs.epsilon)
    names = tuple(envs.unwrapped.envs.observation_names)
    whole = isinstance(observation, str) and size == len(names)
    return Policy(
        name=name,
        observation=observation if whole else list(names),
        names=names,
        settings=settings,
        mean=mean,
        sd=sd,
        clip=clip,
        layers=layers,
        lstm=lstm,
        activation=_activation(net),
        squash=off_policy,
        base=base,
        share=share,
    )


def begin_nominal(model: Any, action: NDArray[np.float64]) -> None:
    """Let an untrained agent hold the nominal speed: it learns sooner than one that lies still."""
    import torch

    net = model.policy
    if hasattr(net, "actor"):  # its actions go through tanh
        net.actor.mu.bias.data.copy_(torch.from_numpy(np.arctanh(0.999 * action)))
    else:
        net.action_net.bias.data.copy_(torch.from_numpy(action))


def _activation(net: Any) -> str:
    """Return the name of the activation of a policy of Stable-Baselines3."""
    default = "relu" if hasattr(net, "actor") else "tanh"
    return net.activation_fn.__name__.lower() if net.activation_fn else default


def _array(parameter: Any) -> Any:
    return parameter.detach().numpy().copy()


class SavedPolicy:
    """The deterministic policy of a model that Stable-Baselines3 saved; an Agent.

    Its spaces ``seen`` and ``acting`` say which observation and actions it is for, see
    :func:`twin.agents.evaluation.agents_named`.

    Parameters
    ----------
    path : Path
        A .zip file of ``model.save``. Where ``VecNormalize`` scaled its observations, the file of
        ``VecNormalize.save`` lies beside it: ``vecnormalize.pkl``, or with the model's name before.

    Raises
    ------
    AgentError
        It is no such file.
    """

    observation: str | list[str]
    actions: str
    settings: Mapping[str, Any]

    def __init__(self, path: Path) -> None:
        import torch
        from stable_baselines3.common.save_util import load_from_zip_file

        try:
            data, parameters, _ = load_from_zip_file(path, device="cpu")
            assert data is not None
            spaces = data["observation_space"], data["action_space"]
            more = data["policy_kwargs"] | ({"use_sde": True} if data.get("use_sde") else {})
            with torch.no_grad():
                self._policy = data["policy_class"](*spaces, lambda _: 0.0, **more)
            self._policy.load_state_dict(parameters["policy"])
            beside = {
                file.stem.replace("_vecnormalize", "").removeprefix("vecnormalize"): file
                for file in path.parent.glob("*vecnormalize*.pkl")
            }
            own = beside.get(path.stem, beside.get(""))  # of this model, else of all in the folder
            self._mean, self._sd, self._clip = 0.0, 1.0, np.inf
            if own is not None and (scale := pickle.loads(own.read_bytes())).norm_obs:
                self._mean, self._clip = scale.obs_rms.mean, scale.clip_obs
                self._sd = np.sqrt(scale.obs_rms.var + scale.epsilon)
        except Exception as error:  # what is pickled may raise anything
            raise AgentError(
                f"{path}: is no model of Stable-Baselines3 that can be loaded here "
                f"({type(error).__name__}: {error})"
            ) from None
        self.path, self.name, (self.seen, self.acting) = path, path.stem, spaces
        without = "as it is: no vecnormalize.pkl lies beside it"
        self._scaled = without if own is None else f"scaled by {own.name}"
        self._memory: Any = None
        self._begins: NDArray[np.bool_] | None = None

    @property
    def note(self) -> str:
        """What it sees and steers, and how."""
        one = self.observation
        seen = f"observation {one}" if isinstance(one, str) else f"entries {', '.join(one)}"
        return f"{self.path}: sees the {seen}, {self._scaled}; actions {self.actions}"

    def begin(self, envs: USVVectorEnv) -> None:
        """Forget all there was."""
        self._memory, self._begins = None, np.ones(envs.num_envs, dtype=np.bool_)

    def act(self, obs: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the actions, shape (n, A), for observations (n, D)."""
        scaled = np.clip((obs - self._mean) / self._sd, -self._clip, self._clip)
        action, self._memory = self._policy.predict(
            scaled.astype(np.float32),
            state=self._memory,
            episode_start=self._begins,
            deterministic=True,
        )
        self._begins = None if self._begins is None else np.zeros_like(self._begins)
        return np.asarray(action, dtype=np.float64)
