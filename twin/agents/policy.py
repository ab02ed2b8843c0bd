"""A trained policy as a small file, which plain numpy sails."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.files import read_archive
from twin.predictors.learned.features import lstm_cell
from usv_gym.envs.vector import USVVectorEnv
from usv_kernel.errors import UsvTwinError
from usv_kernel.files import parse_json, write_whole

__all__ = [
    "AgentError",
    "Policy",
]

Array = NDArray[Any]

Layer = tuple[Array, Array]

ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, 0.0),
}

FORMAT = 1

ACTIONS = 2
"""Numbers in an action."""

VALUE_MAX = 1e6
SD_MIN = 1e-9
"""Bounds of weights, biases and means, and of standard deviations. Within them no sum of a net
overflows."""


class AgentError(UsvTwinError):
    """An agent, training or comparison that cannot be used; the message says why."""


@dataclass
class Policy:
    """The deterministic actor that a training left behind; an :class:`~twin.agents.agent.Agent`.

    In a single environment, ``policy.forget(1)`` begins an episode and ``policy.act(obs)`` steers.

    Parameters
    ----------
    name : str
        For tables.
    observation : str or list of str
        The observation set that it was trained on, or the entries.
    names : tuple of str
        Name of each entry of the observation.
    settings : dict
        What it was trained with: ``algo``, ``seed``, ``steps``, ``twin``, ``sea``, ...
    mean, sd : ndarray, shape (D,)
        Observations are normalised with them.
    clip : float
        Largest size of a normalised entry.
    layers : sequence of (ndarray, ndarray)
        Weights (out, in) and biases (out,) of each layer; the last gives the action.
    lstm : tuple of ndarray, optional
        Weights of inputs (4 H, D) and of the hidden state (4 H, H), and biases (4 H,), of what
        comes before the layers. Gates are in the order input, forget, cell, output.
    activation : str
        Of the hidden layers: ``"tanh"`` or ``"relu"``.
    squash : bool
        Actions are the hyperbolic tangent of the last layer; else it is cut off at -1 and 1.
    base : str
        Name of a controller that it corrects, one of :data:`twin.agents.controllers.BASES`; empty
        for none. The net then sees the first entries of the observation, as many as ``mean`` has
        beside the action of that controller, which comes behind them.
    share : float
        Part of its own action that is added to that of the controller.
    """

    name: str
    observation: str | list[str]
    names: tuple[str, ...]
    settings: dict[str, Any]
    mean: Array
    sd: Array
    clip: float
    layers: Sequence[Layer]
    lstm: tuple[Array, Array, Array] | None = None
    activation: str = "tanh"
    squash: bool = False
    base: str = ""
    share: float = 1.0
    _controller: Any = field(default=None, init=False, repr=False)
    _hidden: tuple[Array, Array] | None = field(default=None, init=False, repr=False)

    def __repr__(self) -> str:
        """Return name, observation and sizes of the layers."""
        seen = self.observation if isinstance(self.observation, str) else "named entries"
        sizes = "-".join(str(len(bias)) for _, bias in self.layers)
        return f"Policy({self.name}, {seen} of {len(self.names)} entries, layers {sizes})"

    def __post_init__(self) -> None:
        names = self.names
        texts = isinstance(names, tuple) and all(isinstance(name, str) for name in names)
        whole = isinstance(self.observation, str) or list(names) == self.observation
        numbers = all(type(value) in (int, float) for value in (self.clip, self.share))
        for holds, rule in (
            (texts and 0 < len(set(names)) == len(names), "names must be texts, each once"),
            (whole, "observation must be a text or the list of names"),
            (isinstance(self.name, str), "name must be a text"),
            (isinstance(self.base, str), "base must be a text"),
            (isinstance(self.settings, dict), "settings must be a table"),
            (isinstance(self.squash, bool), "squash must be true or false"),
            (self.activation in [*ACTIVATIONS], f"activation: use one of {', '.join(ACTIVATIONS)}"),
            (numbers and self.clip > 0.0, "clip must be a number above 0"),
            (numbers and 0.0 < self.share <= VALUE_MAX, "share must be a number above 0"),
            (len(self.layers) > 0, "layers must be one or more"),
        ):
            if not holds:
                raise AgentError(rule)
        # behind what it sees of the observation stands the action of the controller
        inputs = np.size(self.mean) if self.base else len(names)
        if self.base and not ACTIONS < inputs <= len(names) + ACTIONS:
            raise AgentError(f"mean has {inputs} entries; it corrects, and sees {len(names)}")
        _check_array("mean", self.mean, (inputs,))
        _check_array("sd", self.sd, (inputs,), least=SD_MIN)
        if self.lstm is not None:
            size = np.shape(self.lstm[1])[-1] if np.ndim(self.lstm[1]) else 0
            shapes = (4 * size, inputs), (4 * size, size), (4 * size,)
            for j, (part, shape) in enumerate(zip(self.lstm, shapes, strict=True)):
                _check_array(f"lstm_{j}", part, shape)
            inputs = size
        for j, (weights, bias) in enumerate(self.layers):
            outputs = ACTIONS if j == len(self.layers) - 1 else np.size(bias)
            _check_array(f"weights_{j}", weights, (outputs, inputs))
            _check_array(f"bias_{j}", bias, (outputs,))
            inputs = outputs

    def begin(self, envs: USVVectorEnv) -> None:
        """Forget all there was; see :meth:`twin.agents.agent.Agent.begin`.

        Raises
        ------
        AgentError
            The observation is not the one that it was trained on.
        """
        found = tuple(envs.unwrapped.observation_names)  # type: ignore[attr-defined]
        if found != self.names:
            odd = [name for name in self.names if name not in found][:3]
            odd += [name for name in found if name not in self.names][:3]
            raise AgentError(
                f"policy {self.name} was trained on {len(self.names)} entries of the observation "
                f"set {self.observation!r}, and this environment gives {len(found)}"
                + (f" (not in both: {', '.join(odd)})" if odd else " in another order")
                + f"; make it with observation={self.observation!r}"
            )
        self.forget(envs.num_envs)
        if self.base:
            from twin.agents.controllers import make_controller

            self._controller = make_controller(self.base)
            self._controller.begin(envs)

    def forget(self, n: int) -> None:
        """Begin with n boats and an empty memory."""
        if self.lstm is not None:
            size = self.lstm[1].shape[1]
            self._hidden = np.zeros((n, size)), np.zeros((n, size))

    def act(self, obs: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the actions, shape (n, 2), for observations (n, D); (2,) for those of one boat."""
        obs = np.asarray(obs)
        if obs.shape[-1] != len(self.names):
            raise AgentError(
                f"policy {self.name} sees {len(self.names)} entries of the observation set "
                f"{self.observation!r}, not {obs.shape[-1]}"
            )
        if obs.ndim == 1:
            return self.act(obs[None])[0]
        based: Array | None = None
        seen: Array = obs
        if self.base:
            if self._controller is None:
                raise AgentError(
                    f"policy {self.name} corrects {self.base}: call begin(envs) before act(obs)"
                )
            based = self._controller.act(obs)
            seen = np.concatenate(
                [obs[:, : len(self.mean) - ACTIONS], based], axis=1, dtype=obs.dtype
            )
        x: Array = np.clip((seen - self.mean) / self.sd, -self.clip, self.clip)
        if self.lstm is not None:
            if self._hidden is None:
                raise AgentError(f"policy {self.name} remembers: call begin(envs) before act(obs)")
            of_input, of_hidden, bias = self.lstm
            hidden, cell = self._hidden
            x, cell = lstm_cell(x @ of_input.T + hidden @ of_hidden.T + bias, cell)
            self._hidden = x, cell
        activate = ACTIVATIONS[self.activation]
        for weights, bias in self.layers[:-1]:
            x = activate(x @ weights.T + bias)
        weights, bias = self.layers[-1]
        x = x @ weights.T + bias
        action = np.tanh(x) if self.squash else np.clip(x, -1.0, 1.0)
        return action if based is None else np.clip(based + self.share * action, -1.0, 1.0)

    def save(self, path: str | Path) -> None:
        """Write it to a file, whole or not at all."""
        notes = {
            **{"format": FORMAT, "name": self.name, "observation": self.observation},
            **{"names": self.names, "settings": self.settings, "clip": self.clip},
            **{"activation": self.activation, "squash": self.squash},
            **({"base": self.base, "share": self.share} if self.base else {}),
        }
        arrays: dict[str, Any] = {
            "notes": np.array(json.dumps(notes)),
            "mean": self.mean,
            "sd": self.sd,
        }
        for j, (weights, bias) in enumerate(self.layers):
            arrays |= {f"weights_{j}": weights, f"bias_{j}": bias}
        if self.lstm is not None:
            arrays |= {f"lstm_{j}": part for j, part in enumerate(self.lstm)}
        packed = io.BytesIO()
        np.savez_compressed(packed, **arrays)
        write_whole(Path(path), packed.getvalue())

    @classmethod
    def load(cls, path: str | Path) -> Policy:
        """Read what :meth:`save` wrote.

        Raises
        ------
        AgentError
            It is no such file.
        """
        path = Path(path)
        if path.is_dir():  # a run
            path = path / "policy.npz"
        remedy = "usv-twin train writes policy.npz"
        arrays = read_archive(path, AgentError, "policy", remedy)
        try:
            notes = parse_json(path, str(arrays["notes"]).encode(), AgentError)
            version = notes.pop("format")
            several = range(len(arrays))
            layers = [
                (arrays[f"weights_{j}"], arrays[f"bias_{j}"])
                for j in several
                if f"weights_{j}" in arrays
            ]
            lstm = tuple(arrays[f"lstm_{j}"] for j in range(3)) if "lstm_0" in arrays else None
            notes["names"] = tuple(notes["names"])
            if version == FORMAT:
                policy = cls(
                    **notes, mean=arrays["mean"], sd=arrays["sd"], layers=layers, lstm=lstm
                )
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            why = str(error).removeprefix(f"{path}: ")
            raise AgentError(f"{path}: is no policy ({why}); {remedy}") from None
        if version != FORMAT:
            raise AgentError(f"{path}: was written by another version; train it again")
        return policy


def _check_array(name: str, array: Any, shape: tuple[int, ...], least: float = -VALUE_MAX) -> None:
    """Refuse an array of another shape, or with values that are not numbers in range."""
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "iuf":
        raise AgentError(f"{name} holds no numbers")
    if array.shape != shape or not array.size:
        raise AgentError(f"{name} has shape {array.shape} where {shape} is needed")
    if not ((array >= least) & (array <= VALUE_MAX)).all():
        raise AgentError(f"{name} holds values outside {least:g} to {VALUE_MAX:g}")
