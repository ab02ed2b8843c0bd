"""Training that starts from the weights of a saved policy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twin.agents.policy import AgentError, Policy

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecNormalize

__all__ = ["actor_layers", "start_from"]

COUNT = 10_000.0
"""Weight of a saved mean and variance against those of new observations, observations."""


def actor_layers(net: Any) -> list[Any]:
    """Return the linear layers of the deterministic actor of a policy of Stable-Baselines3."""
    off_policy = hasattr(net, "actor")
    hidden = net.actor.latent_pi if off_policy else net.mlp_extractor.policy_net
    last = net.actor.mu if off_policy else net.action_net
    return [layer for layer in (*hidden, last) if hasattr(layer, "weight")]


def start_from(policy: Policy, model: Any, envs: VecNormalize, base: str) -> None:
    """Give a new model the actor of a saved policy; its critic and its noise stay new.

    ``base`` is the controller that the new model corrects. AgentError: the policy sees other
    entries, or its net has another form.
    """
    names = tuple(envs.unwrapped.envs.observation_names)  # type: ignore[attr-defined]
    if policy.names != names:
        odd = [
            name for name in (*policy.names, *names) if (name in policy.names) != (name in names)
        ]
        raise AgentError(
            f"--init: {policy.name} sees {len(policy.names)} entries, and this training has "
            f"{len(names)}" + (f" (not in both: {', '.join(odd[:3])})" if odd else "")
            + "; train with the same --obs or --entries"
        )  # fmt: skip
    net = model.policy
    form = _form(policy.layers, policy.lstm, policy.activation, policy.squash, policy.base)
    lstm = getattr(net, "lstm_actor", None)
    layers = actor_layers(net)
    now = _form(
        [(layer.weight, layer.bias) for layer in layers],
        None if lstm is None else (lstm.weight_ih_l0, lstm.weight_hh_l0),
        net.activation_fn.__name__.lower(),
        hasattr(net, "actor"),
        base,
    )
    if form != now:
        raise AgentError(
            f"--init: {policy.name} is {form}, and this training makes {now}; choose the same "
            "algorithm and [policy_kwargs]"
        )
    parts: list[Any] = [*policy.layers] if lstm is None else [policy.lstm, *policy.layers]
    first, *others = parts
    scaled, bias = _unscaled(policy, first, envs)
    if lstm is None:
        _copy(layers[0], scaled, bias)
        rest = layers[1:]
    else:
        _set(lstm.weight_ih_l0, scaled)
        _set(lstm.weight_hh_l0, first[1])
        _set(lstm.bias_ih_l0, bias)
        _set(lstm.bias_hh_l0, np.zeros_like(bias))
        rest = layers
    for layer, (weight, offset) in zip(rest, others, strict=True):
        _copy(layer, weight, offset)


def _unscaled(policy: Policy, first: Any, envs: VecNormalize) -> tuple[Any, Any]:
    """Return weights and biases of the first layer for observations as the new model sees them.

    Where observations are normalised, the mean and variance of the policy go over instead.
    """
    weights, bias = first[0], first[-1]
    if envs.norm_obs:
        averages: Any = envs.obs_rms
        averages.mean, averages.count = policy.mean.copy(), COUNT
        averages.var = np.maximum(policy.sd**2 - envs.epsilon, 0.0)
        return weights, bias
    scaled = weights / policy.sd
    return scaled, bias - scaled @ policy.mean


def _form(layers: Any, lstm: Any, activation: str, squash: bool, base: str) -> str:
    """Return the form of a net in words."""
    sizes = [layers[0][0].shape[1], *(weights.shape[0] for weights, _bias in layers)]
    text = f"a net of {'-'.join(map(str, sizes))} with {activation}"
    if lstm is not None:
        text += f" behind {lstm[1].shape[1]} cells"
    text += " and bounded actions" if squash else ""
    return text + (f" that corrects {base}" if base else "")


def _copy(layer: Any, weights: NDArray[Any], bias: NDArray[Any]) -> None:
    """Write the weights of a layer."""
    _set(layer.weight, weights)
    _set(layer.bias, bias)


def _set(parameter: Any, values: NDArray[Any]) -> None:
    """Write the values of a parameter of torch."""
    import torch

    parameter.data.copy_(torch.from_numpy(np.ascontiguousarray(values)))
