"""Networks trained on a fleet of simulated boats, evaluated in plain numpy.

``examples/priors/fleet.py`` trains them, with torch; nothing here needs it. A net sees the last
:data:`PAST` s of a run and the plan as tokens of a second each. They are in lengths of the boat and
its typical speed, with masks for what is missing. It answers with the increments of u, v, r under
the plan. So it has to infer the boat from the run itself.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from twin.channels import PSI
from twin.files import read_archive
from twin.particulars import GRAVITY, Particulars
from twin.predictors.baselines import ACTUATORS, COMMANDED, GRID, VELOCITIES
from twin.predictors.learned.features import (
    ActuatedPredictor,
    fill_forward,
    integrate,
    lstm_cell,
    thrust_features,
)
from usv_kernel.errors import UsvTwinError
from usv_kernel.files import replacing

__all__ = [
    "AHEAD",
    "FORMAT",
    "PAST",
    "TOKEN",
    "FleetLSTM",
    "FleetPredictor",
    "FleetTransformer",
    "Weights",
    "WeightsError",
    "run_lstm",
    "run_transformer",
    "tokens",
]

Array = NDArray[Any]

FORMAT = 1
"""Version of the weights' files and of the nets' inputs; another one is refused."""

PATCH = 4
"""Grid steps in a token."""

PAST = 40
AHEAD = 10
"""Tokens of the past and of the plan, s."""

MEANS = (1, 8, 32, 80)
"""Grid steps before the origin that the plan's tokens hold means of, one for each of theirs."""

FADE = 2.0
"""Time in which the mask of a sensor fades after its last sample, s."""

SENSORS = (0, 4, 5)
"""Measurements that stand for GPS, compass and IMU."""

ROW = 17
"""Columns of a history: states, commands, actuators, masks."""

PER_ROW = 13
ABOUT = 6

MASKS = slice(14, ROW)
"""Masks in a row of a history."""

MOTION = slice(0, 3)
COS = 3
SIN = 4
FRESH = slice(5, 8)
KNOWN = 8
"""In a row of a token: velocities, heading, masks, whether the row is known."""

THRUST, DIFFERENCE, SIDE_FORCE, ANGLES = range(KNOWN + 1, PER_ROW)
"""In a row of a token: what the actuators do."""

PLANNED = ABOUT - 1
"""In what a token says of boat and time: whether it lies ahead."""

TOKEN = PATCH * PER_ROW + ABOUT
"""Numbers in a token."""

INPUT_MAX = 6.0
"""Bound of an input: the nets are not asked to extrapolate further."""

CENTRE = np.array([0.8, 0.0, 0.0])
SCALE = np.array([3.0, 5.0, 4.0])
"""Centre and scale of the inputs u, v, r over their typical size."""

STEP = 0.5
"""Increments of u, v, r over their typical size, per length travelled, of an output of 1."""

BATCH = {"lstm": 8, "transformer": 1}
"""Several inputs are padded to a multiple of this: then each has the same answer among any others.

A transformer multiplies matrices of one input at a time.
"""

WEIGHT_MAX = 1e4
"""Bound of a weight: trained ones stay below 100."""

HERE = Path(__file__).with_name("weights")
"""Where the weights that ship lie."""


class WeightsError(UsvTwinError):
    """A file of weights that cannot be used; the message names it and the remedy."""


@dataclass(frozen=True)
class Weights:
    """A trained net."""

    kind: str  # lstm or transformer
    seed: int  # of boats, initial weights and batches
    settings: dict[str, Any]  # how it was made, for the record
    arrays: dict[str, Array]  # its weights, single precision

    def write(self, path: str | Path) -> None:
        """Write a file that :meth:`read` reads; weights are rounded to half precision."""
        about = {"format": FORMAT, "kind": self.kind, "seed": self.seed, "settings": self.settings}
        with replacing(path) as partial, partial.open("wb") as file:
            rounded: Any = {key: value.astype(np.float16) for key, value in self.arrays.items()}
            np.savez_compressed(file, about=np.array(json.dumps(about)), **rounded)

    def run(self, x: Array) -> Array:
        """Return the net's outputs (B, AHEAD, 3 PATCH) for :func:`tokens`."""
        net = {"lstm": run_lstm, "transformer": run_transformer}[self.kind]
        return net(self.arrays, x)

    def run_padded(self, x: Array) -> Array:
        """Return the same as :meth:`run`, to the bit whatever inputs an input comes with."""
        padding = np.repeat(x[-1:], -len(x) % BATCH[self.kind], axis=0)
        return self.run(np.concatenate([x, padding]))[: len(x)]

    @classmethod
    def read(cls, path: str | Path, kind: str) -> Weights:
        """Read weights of a net; WeightsError says what is wrong, and how to make new ones."""
        remedy = "make a new one with examples/priors/fleet.py"
        if not Path(path).exists():
            raise WeightsError(f"{path}: is missing; reinstall usv-twin, or {remedy}")
        arrays = read_archive(path, WeightsError, "file of weights of a net", remedy)
        try:
            about = json.loads(str(arrays.pop("about")))
            version, found = about["format"], about["kind"]
            if version != FORMAT or found != kind:
                raise WeightsError(
                    f"{path}: holds weights of a {found}, format {version}; this usv-twin needs a "
                    f"{kind} of format {FORMAT}: {remedy}"
                )
            weights = cls(found, about["seed"], about["settings"], arrays)
        except WeightsError:
            raise
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            raise WeightsError(f"{path}: holds no weights of a net ({error}); {remedy}") from None
        return weights._checked(path, remedy)

    def _checked(self, path: str | Path, remedy: str) -> Weights:
        """Return the weights in single precision; WeightsError if the net cannot run with them."""
        tokens = np.zeros((1, PAST + AHEAD, TOKEN), np.float32)
        try:
            arrays = {key: value.astype(np.float32) for key, value in self.arrays.items()}
            sane = all((np.abs(value) < WEIGHT_MAX).all() for value in arrays.values())
            weights = dataclasses.replace(self, arrays=arrays)
            answer = weights.run(tokens)
        except (AttributeError, LookupError, TypeError, ValueError, ArithmeticError):
            sane = False
        if not sane or answer.shape != (1, AHEAD, 3 * PATCH) or not np.isfinite(answer).all():
            raise WeightsError(f"{path}: holds damaged weights of a net; {remedy}")
        return weights


@functools.cache
def _shipped(path: Path, kind: str) -> Weights:
    return Weights.read(path, kind)


def tokens(window: Array, known: Array, ahead: Array, particulars: Particulars) -> Array:
    """Return the inputs (B, PAST + AHEAD, TOKEN) of a net, single precision, one token a second.

    ``window`` (B, PAST * PATCH, 17) has rows up to and with the origin: six states, four commands,
    four actuators, three masks. Those of GPS, compass and IMU are 1 with a fresh sample, then fade.
    ``known`` (B, PAST * PATCH) is False for rows before the history began. ``ahead`` (B, AHEAD *
    PATCH, 4) are the actuators under the plan.
    """
    U, L = particulars.speed, particulars.length
    B, past = window.shape[:2]
    out = np.zeros((B, past + ahead.shape[1], PER_ROW))
    seen = out[:, :past]
    seen[..., MOTION] = (window[..., VELOCITIES] / [U, U, U / L] - CENTRE) * SCALE
    # the wind is fixed to the earth: headings are relative to the present one
    turned = window[..., PSI] - window[:, -1:, PSI]
    seen[..., COS], seen[..., SIN] = np.cos(turned), np.sin(turned)
    seen[..., FRESH] = window[..., MASKS]
    seen[..., KNOWN] = 1.0
    acts = np.concatenate([window[..., ACTUATORS], ahead], axis=1)
    acts[..., :2] /= particulars.shaft_speed
    left, right = np.moveaxis(thrust_features(acts).reshape(*acts.shape[:2], 3, 2), 3, 0)
    out[..., THRUST] = 0.5 * (left + right)[..., 0]
    out[..., DIFFERENCE] = 0.5 * (left - right)[..., 0]
    out[..., SIDE_FORCE] = 1.5 * (left + right)[..., 1]
    out[..., ANGLES] = 1.5 * np.sin(acts[..., 2:]).sum(axis=2)
    seen *= known[..., None]
    # the plan's entries for velocities repeat the past mean, so that a steady turn goes on
    count = np.cumsum(known[:, ::-1], axis=1)[:, ::-1]
    means = [seen[:, -n:, MOTION].sum(axis=1) / np.maximum(count[:, -n], 1)[:, None] for n in MEANS]
    out[:, past:, MOTION] = np.tile(np.stack(means, axis=1), (1, ahead.shape[1] // PATCH, 1))
    about = np.zeros((B, PAST + AHEAD, ABOUT))
    about[..., :PLANNED] = (
        math.log(GRID * U / L) + 2.0,
        2.0 * U / math.sqrt(GRAVITY * L),
        0.3 * particulars.length / particulars.beam,
        0.3 * particulars.beam / particulars.draft,
        float(particulars.steering == "differential"),
    )
    about[:, PAST:, PLANNED] = 1.0
    out = np.clip(out, -INPUT_MAX, INPUT_MAX).reshape(B, PAST + AHEAD, PATCH * PER_ROW)
    return np.concatenate([out, about], axis=2).astype(np.float32)


def _read(w: dict[str, Array], h: Array, x: Array) -> Array:
    """Return what is read out of hidden states (B, AHEAD, H), and of the plan's own tokens."""
    return np.concatenate([h, x[:, PAST:]], axis=2) @ w["read.weight"].T + w["read.bias"]


def run_lstm(w: dict[str, Array], x: Array) -> Array:
    """Return the outputs (B, AHEAD, 3 PATCH) of an LSTM for tokens (B, PAST + AHEAD, TOKEN).

    ``w`` are its weights, named as torch names them.
    """
    h = x
    for layer in range(sum(key.startswith("body.weight_ih") for key in w)):
        bias = w[f"body.bias_ih_l{layer}"] + w[f"body.bias_hh_l{layer}"]
        gates = h @ w[f"body.weight_ih_l{layer}"].T + bias
        h = _lstm_layer(gates, w[f"body.weight_hh_l{layer}"])
    return _read(w, h[:, PAST:], x)


def _lstm_layer(gates: Array, back: Array) -> Array:
    """Return hidden states (B, T, H), from what inputs add to the gates and the way back."""
    back = np.ascontiguousarray(back.T)
    h = c = np.zeros((len(gates), len(back)), dtype=np.float32)
    out = []
    for k in range(gates.shape[1]):
        h, c = lstm_cell(gates[:, k] + h @ back, c)
        out.append(h)
    return np.stack(out, axis=1)


def _normed(w: dict[str, Array], name: str, x: Array) -> Array:
    x = x - x.mean(axis=-1, keepdims=True)
    x = x / np.sqrt(np.mean(x * x, axis=-1, keepdims=True) + np.float32(1e-5))
    return x * w[f"{name}.weight"] + w[f"{name}.bias"]


def run_transformer(w: dict[str, Array], x: Array) -> Array:
    """Return the outputs (B, AHEAD, 3 PATCH) of a causal transformer; see :func:`run_lstm`."""

    def linear(name: str, x: Array) -> Array:
        return x @ w[f"{name}.weight"].T + w[f"{name}.bias"]

    B, T = x.shape[:2]
    heads = w["heads"].shape[0]
    h = linear("embed", x) + w["place"]
    later = np.triu(np.full((T, T), -np.inf, dtype=np.float32), 1)
    for layer in range(sum(key.endswith("mix.weight") for key in w)):
        name = f"layers.{layer}"
        parts = linear(f"{name}.qkv", _normed(w, f"{name}.norm1", h))
        q, k, v = np.moveaxis(parts.reshape(B, T, 3, heads, -1), (2, 3), (0, 2))
        scores = q @ np.swapaxes(k, 2, 3) / np.float32(math.sqrt(q.shape[3])) + later
        scores = np.exp(scores - scores.max(axis=3, keepdims=True))
        seen = (scores / scores.sum(axis=3, keepdims=True)) @ v
        h = h + linear(f"{name}.mix", np.moveaxis(seen, 1, 2).reshape(B, T, -1))
        inner = linear(f"{name}.up", _normed(w, f"{name}.norm2", h))
        h = h + linear(f"{name}.down", np.maximum(inner, 0.0))
    return _read(w, _normed(w, "norm", h[:, PAST:]), x)


class FleetPredictor(ActuatedPredictor):
    """A network that was trained once on simulated boats; subclasses say which.

    Its weights ship with the package; ``examples/priors/fleet.py`` makes new ones.
    WeightsError: they are missing, damaged or of another version. The net learns nothing more
    during a run, and draws nothing at random.
    """

    kind: ClassVar[str]
    file: ClassVar[Path]
    steady = True

    def __init__(self, particulars: Particulars, *, seed: int = 0) -> None:
        _shipped(self.file, self.kind)
        super().__init__(particulars, seed=seed)

    def reset(self) -> None:
        """See :meth:`Predictor.reset`."""
        super().reset()
        self._age = np.full(3, math.inf)
        self._extra, self._last = np.zeros(ROW - 10), np.zeros(ROW)

    def update(self, t: float, dt: float, z: Array, cmd: Array) -> None:
        """Take one row; see :meth:`Predictor.update`."""
        self._age = np.where(np.isfinite(z[list(SENSORS)]), 0.0, self._age + dt)
        super().update(t, dt, z, cmd)

    def extra_columns(self, dt: float) -> Array:
        """Return actuators and masks at the row that just came, shape (7,)."""
        return np.concatenate([super().extra_columns(dt), np.exp(-self._age / FADE)])

    @property
    def look_back(self) -> float:
        """See :attr:`HistoryPredictor.look_back`."""
        return GRID * PAST * PATCH

    def forecast_from_last(self, rows: Array, plan: Array) -> Array:
        """See :meth:`HistoryPredictor.forecast_from_last`; after a fault a history begins again."""
        if not self._suspended and True in self._unreliable:
            rows = rows[len(self._unreliable) - self._unreliable[::-1].index(True) :]
        return super().forecast_from_last(rows, plan)

    @staticmethod
    def windows(rows: Array, origins: Array) -> tuple[Array, Array]:
        """Return what :func:`tokens` takes: windows of a history (M, 17), and what is known."""
        back = origins[:, None] + np.arange(1 - PAST * PATCH, 1)
        return rows[np.maximum(back, 0)], back >= 0

    def forecast(self, rows: Array, origins: Array, plans: Array) -> Array:
        """Return forecasts; see :meth:`HistoryPredictor.forecast`."""
        rows = fill_forward(rows)
        K, block = plans.shape[1], AHEAD * PATCH
        plans = np.where(np.isfinite(plans), plans, rows[origins, None, COMMANDED])
        plans = np.concatenate([plans, np.repeat(plans[:, -1:], -K % block, axis=1)], axis=1)
        acts = self.follow(rows[origins, ACTUATORS], plans)
        window, known = self.windows(rows, origins)
        window[..., VELOCITIES] = np.clip(window[..., VELOCITIES], -self.bound, self.bound)
        weights = _shipped(self.file, self.kind)
        # a forecast from the present is made once, with a plan of its own
        net = weights.run if origins[-1] == len(rows) - 1 else weights.run_padded
        out = []
        # beyond its horizon the net goes on from its own outputs
        for first in range(0, plans.shape[1], block):
            part = slice(first, first + block)
            path = self.states_after(
                window, net(tokens(window, known, acts[:, part], self.particulars))
            )
            out.append(path)
            said = np.concatenate([path, plans[:, part], acts[:, part]], axis=2)
            said = np.pad(said, ((0, 0), (0, 0), (0, 3)))
            window = np.concatenate([window[:, block:], said], axis=1)
            known = np.pad(known[:, block:], ((0, 0), (0, block)), constant_values=True)
        return np.concatenate(out, axis=1)[:, :K]

    def states_after(self, window: Array, said: Array) -> Array:
        """Return the states (B, AHEAD * PATCH, 6) that follow windows by a net's outputs."""
        said = said.reshape(len(said), -1, 3)
        travelled = STEP * GRID * self.particulars.speed / self.particulars.length
        start = window[:, -1]
        nu = start[:, None, 3:6] + np.cumsum(said.astype(float), axis=1) * travelled * self.typical
        nu = np.clip(np.concatenate([start[:, None, 3:6], nu], axis=1), -self.bound, self.bound)
        return integrate(start[:, :6], nu)


class FleetLSTM(FleetPredictor):
    """An LSTM, trained once on simulated boats.

    Tuning budget: 40 configurations of 8192 windows each, by successive halving in five rungs,
    77 trainings, scored on 60 other boats of the fleet. 6 short trainings came before that. The
    settings of the training that ships are in its file.
    """

    tuning = "40 configurations by successive halving (77 trainings) on 60 boats of the fleet"
    kind = "lstm"
    file = HERE / "fleet-lstm.npz"


class FleetTransformer(FleetPredictor):
    """A causal transformer, trained once on simulated boats, in the LSTM's harness.

    Tuning budget: the LSTM's 40 configurations (rates of its own, one to three layers), halved in
    three rungs, 70 trainings, scored on the same boats. 3 short trainings came before that.
    """

    tuning = "40 configurations by successive halving (70 trainings) on 60 boats of the fleet"
    kind = "transformer"
    file = HERE / "fleet-transformer.npz"
