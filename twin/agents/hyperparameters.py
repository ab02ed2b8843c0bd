"""Hyperparameters of the algorithms, and their checks."""

from __future__ import annotations

import importlib.util
import inspect
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.agents.controllers import BASES
from twin.agents.policy import ACTIVATIONS, AgentError
from usv_kernel.files import read_toml

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

__all__ = [
    "ALGORITHMS",
    "CORRECTING",
    "SCHEDULES",
    "TIMESTEPS",
    "algorithm_class",
    "check_algorithm",
    "check_hyperparameters",
    "hyperparameters",
    "schedule",
    "torch_options",
]

SCHEDULES = ("learning_rate", "clip_range", "clip_range_vf")
"""Hyperparameters that may be ``"lin_X"``: X at the start, 0 at the end."""

ALGORITHMS = {
    "ppo": ("stable_baselines3", "PPO", "MlpPolicy"),
    "sac": ("stable_baselines3", "SAC", "MlpPolicy"),
    "recurrent_ppo": ("sb3_contrib", "RecurrentPPO", "MlpLstmPolicy"),
    "ppo-residual": ("stable_baselines3", "PPO", "MlpPolicy"),
    "ppo-mpc": ("stable_baselines3", "PPO", "MlpPolicy"),
}
"""Module, class and policy of each algorithm."""

CORRECTING = ("ppo-residual", "ppo-mpc")
"""Those that correct a classical controller."""

TIMESTEPS = 131_072
"""Decisions of a training whose hyperparameters name none."""

WORDS = {"observation", "ent_coef", "target_entropy", *SCHEDULES}
"""Hyperparameters that may be a text."""

NOT_GIVEN = {"policy", "env", "seed", "device", "tensorboard_log", "verbose", "_init_setup_model"}
"""Arguments of an algorithm that are no hyperparameters."""

TABLES = {
    "policy_kwargs": {
        *("net_arch", "activation_fn", "log_std_init", "ortho_init", "n_critics"),
        *("lstm_hidden_size", "shared_lstm", "enable_critic_lstm"),
    },
    "normalize": {"norm_obs", "norm_reward", "clip_obs", "clip_reward", "epsilon"},
    "reward": {"scale", "least"},
    "residual": {"base", "share"},
    "reward_weights": set[str](),  # the terms are those of the task
}
"""Names in each table."""


def check_algorithm(algo: str) -> None:
    """Refuse a name that is no algorithm's."""
    if algo not in ALGORITHMS:
        raise AgentError(f"algo = {algo!r}; known: {', '.join(ALGORITHMS)}")


def hyperparameters(algo: str, path: str | Path | None = None) -> dict[str, Any]:
    """Return an algorithm's hyperparameters, those of this package if no file is named.

    AgentError: the file is missing, no TOML, or names what the algorithm does not know.
    """
    check_algorithm(algo)
    path = Path(__file__).with_name("hyper") / f"{algo}.toml" if path is None else Path(path)
    values = read_toml(path, AgentError)
    check_hyperparameters(algo, values, str(path))
    return {"n_timesteps": TIMESTEPS, **values}


def check_hyperparameters(algo: str, values: Mapping[str, Any], where: str) -> None:
    """Refuse values that the algorithm does not take; ``where`` names their source."""
    own = {"observation", "n_envs", "n_timesteps", "normalize", "reward", "reward_weights"}
    known = own | {*inspect.signature(algorithm_class(algo)).parameters} - NOT_GIVEN
    # checkpoints and policy files do not have these
    known -= {name for name in known if "sde" in name or "replay" in name or "memory" in name}
    known |= {"residual"} if algo in CORRECTING else set()
    for table, names in {"": known, **TABLES}.items():
        found = values.get(table, {}) if table else values
        if not isinstance(found, Mapping):
            raise AgentError(f"{where}: {table} = {found!r}: must be a table [{table}]")
        for name in found:
            if names and name not in names:
                what = f"[{table}]" if table else algo
                raise AgentError(
                    f"{where}: {what} has no {name!r}; it has {', '.join(sorted(names))}"
                )
    for name, value in values.items():
        if isinstance(value, str) and name not in WORDS:
            raise AgentError(f"{where}: {name} = {value!r}: must be a number")
    for name in ("n_envs", "n_timesteps"):
        value = values.get(name, 1)
        if not (isinstance(value, int) and value >= 1):
            raise AgentError(f"{where}: {name} = {value!r}: must be a whole number, 1 or more")
    for table, name, least in (("reward", "scale", 0.0), ("reward", "least", -math.inf),
                               ("residual", "share", 0.0)):  # fmt: skip
        value = values.get(table, {}).get(name, 1.0)
        if not isinstance(value, (int, float)) or not value > least:
            raise AgentError(
                f"{where}: [{table}] {name} = {value!r}: must be a number above {least:g}"
            )
    activation = values.get("policy_kwargs", {}).get("activation_fn", "tanh")
    if not (isinstance(activation, str) and activation in ACTIVATIONS):
        raise AgentError(f"{where}: activation_fn = {activation!r}; use {', '.join(ACTIVATIONS)}")
    base = values.get("residual", {}).get("base", BASES[0])
    if base not in BASES:
        raise AgentError(f"{where}: [residual] base = {base!r}; use {', '.join(BASES)}")


def algorithm_class(algo: str) -> type[BaseAlgorithm]:
    """Return the class of an algorithm by its name."""
    module, name = ALGORITHMS[algo][:2]
    try:
        found: type[BaseAlgorithm] = getattr(importlib.import_module(module), name)
    except ImportError:
        raise ImportError(
            f"{algo} needs {module.replace('_', '-')}: pip install 'usv-twin[rl]'"
        ) from None
    return found


def schedule(name: str, rate: float | str) -> Any:
    """Return a number as it is, and ``"lin_X"`` as a schedule that falls from X to 0."""
    if not isinstance(rate, str):
        return float(rate)
    kind, first = rate.partition("_")[::2]
    try:
        start = float(first)
    except ValueError:
        start = 0.0
    if kind != "lin" or not start > 0.0:
        raise AgentError(f"{name} = {rate!r}: must be a number, or 'lin_3e-4'")
    return lambda left: start * left


def torch_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return policy_kwargs with the activation as torch has it."""
    import torch

    kinds = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}
    return {
        key: kinds[value] if key == "activation_fn" else value for key, value in options.items()
    }
