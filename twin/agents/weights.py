"""Weights of policies, from Stable-Baselines3 into a policy file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twin.agents.policy import Policy

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecNormalize

__all__ = ["begin_nominal", "policy_of"]


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
