"""The learned comparator: an LSTM that a run trains on its own past.

Torch is needed to train, and only there; this module imports nothing of it. Forecasts are plain
numpy, so that a predictor can be copied and pickled.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.checkpoint import State, check_fields, with_prefix, without_prefix
from twin.particulars import Particulars
from twin.predictors.baselines import (
    COMMANDED,
    GRID,
    STATES,
    VELOCITIES,
)
from twin.predictors.learned.features import (
    LearnedPredictor,
    fill_forward,
    integrate,
    lstm_cell,
    thrust_features,
)

__all__ = [
    "LSTMPredictor",
    "MissingTorch",
    "import_torch",
    "undisturbed",
]

Array = NDArray[np.float64]

INPUT_MAX = 6.0
"""Bound of a scaled input: the net is not asked to extrapolate further beyond its data."""


class MissingTorch(ImportError):
    """Torch is not installed; the message says how to get it."""


def import_torch() -> Any:
    """Return the module torch, or say how to get it."""
    try:
        return importlib.import_module("torch")
    except ImportError as error:
        raise MissingTorch(
            "the LSTM predictor needs torch: python -m pip install torch (the extra [lstm] of "
            "usv-twin)"
        ) from error


@contextmanager
def undisturbed(torch: Any) -> Iterator[None]:
    """Train in here: one thread, gradients on, and torch's state as before afterwards."""
    threads = torch.get_num_threads()
    # runs are trained side by side, one core each
    torch.set_num_threads(1)
    try:
        # new layers draw from torch's own generator, which belongs to the caller
        with torch.random.fork_rng(devices=[]), torch.inference_mode(False), torch.enable_grad():
            yield
    finally:
        torch.set_num_threads(threads)


@dataclass(frozen=True)
class _Net:
    """A trained net, in numpy."""

    centre: Array
    scale: Array
    step: Array
    w_in: Array
    w_rec: Array
    bias: Array
    w_out: Array
    b_out: Array

    def advance(self, x: Array, h: Array, c: Array) -> tuple[Array, Array]:
        """Return the hidden state (B, H) and the cell (B, H) after an input x (B, 9)."""
        return lstm_cell(x @ self.w_in + h @ self.w_rec + self.bias, c)

    def increment(self, h: Array) -> Array:
        """Return the increments (B, 3) of u, v, r over a step, in m/s and rad/s."""
        return (h @ self.w_out + self.b_out) * self.step

    def scaled(self, nu: Array, thrust: Array) -> Array:
        """Return inputs (..., 9): velocities (..., 3), features of the commands after (..., 6)."""
        x = np.concatenate([nu, thrust], axis=-1)
        return np.clip((x - self.centre) * self.scale, -INPUT_MAX, INPUT_MAX)


class LSTMPredictor(LearnedPredictor):
    """An LSTM trained once on the run's own past, then rolled out under the plan.

    Its inputs are the last :attr:`warm` steps of (u, v, r) and of the commands, then its own
    predictions and the plan. It predicts increments of (u, v, r), from which
    heading and position follow by integration. It is trained on roll-outs of :attr:`ahead`
    steps from every :attr:`stride`-th row, and its loss is that of whole roll-outs. Until it
    is trained, and where the past is too short, never moves or shows nothing, the
    velocities of the moment are held.

    Its prediction intervals are somewhat narrow at first: forecasts of rows that it was trained
    on count as past forecasts until :attr:`memory` has gone by.

    Tuning budget: 16 configurations, scored on the turn and the zigzag of four seeds (100-103) by
    10 s forecasts with known commands. None was tried on other seeds.

    Source: Qu et al. 2025, Table 4, compares with an LSTM; the design of this one is ours.

    Parameters
    ----------
    particulars : Particulars
        Main particulars; typical speed, length and shaft speed set the size
        below which a column counts as constant.
    seed : int
        Of the initial weights, the noise and the dropout; the same seed gives the same bits
        on the same machine.
    train_at : float
        Seconds after the first row of the history at which it is trained.

    Raises
    ------
    MissingTorch
        Torch is not installed.
    """

    tuning = "16 configurations in the study"
    trains = True
    constants = ("train_at", "_net")

    warm = 12
    """Steps that the net sees before it predicts."""
    ahead = 16
    """Steps of a roll-out in training."""
    stride = 2
    """Steps between the starts of the roll-outs."""
    windows_min = 16
    """Roll-outs without which there is no training."""
    hidden = 32
    """Size of the hidden state."""
    epochs = 90
    """Steps of the optimiser, each on all roll-outs."""
    rate = 3e-2
    """Largest learning rate of AdamW; a tenth of the steps warms up, a cosine ends at 0."""
    decay = 1e-2
    """Weight decay of AdamW."""
    noise = 0.4
    """Standard deviation of the noise on the scaled u, v, r before the start of a roll-out."""
    dropout = 0.2
    """Share of the hidden state that the read-out misses in training, fixed per roll-out."""

    def __init__(self, particulars: Particulars, *, seed: int = 0, train_at: float = 60.0) -> None:
        import_torch()
        self.train_at = train_at
        super().__init__(particulars, seed=seed)

    def reset(self) -> None:
        """See :meth:`Predictor.reset`; the net is forgotten too."""
        super().reset()
        self._net: _Net | None = None
        self._trained = False

    def state_dict(self) -> State:
        """Return all that is remembered; see :meth:`Predictor.state_dict`."""
        net = {} if self._net is None else vars(self._net)
        return {**super().state_dict(), **with_prefix("net", net)}

    def load_state_dict(self, state: State) -> None:
        """Take over a saved state; see :meth:`Predictor.load_state_dict`."""
        net = with_prefix("net", without_prefix("net", state))
        super().load_state_dict({k: v for k, v in state.items() if k not in net})
        self._net = None
        if net:
            H = self.hidden
            shapes = ((9,), (9,), (3,), (9, 4 * H), (H, 4 * H), (4 * H,), (H, 3), (3,))
            names = with_prefix("net", _Net.__dataclass_fields__)
            check_fields(net, {k: np.zeros(n) for k, n in zip(names, shapes, strict=True)})
            self._net = _Net(**without_prefix("net", net))

    @property
    def look_back(self) -> float:
        """See :attr:`HistoryPredictor.look_back`: all that it is going to learn from."""
        return GRID * self.warm if self._trained else math.inf

    @property
    def trained(self) -> bool:
        """True from the training on, even if it taught nothing."""
        return self._trained

    def update(self, t: float, dt: float, z: Array, cmd: Array) -> None:
        """Take one row; see :meth:`Predictor.update`.

        The row with which :attr:`train_at` is reached takes as long as the training, 1 s.
        """
        super().update(t, dt, z, cmd)
        if not self._trained and (len(self._rows) - 1) * GRID >= self.train_at - 1e-9:
            rows = np.array(self._rows).reshape(-1, 10)
            rows[self._unreliable] = math.nan
            self._net = self._train(rows)
            self._trained = True
            self._errors_at = -math.inf

    def forecast(self, rows: Array, origins: Array, plans: Array) -> Array:
        """Return forecasts; see :meth:`HistoryPredictor.forecast`."""
        rows = fill_forward(rows)
        plans = np.where(np.isfinite(plans), plans, rows[origins, None, COMMANDED])
        start, K, net = rows[origins, STATES], plans.shape[1], self._net
        if net is None:
            return self.held(start, K)
        nu = np.clip(start[:, 3:], -self.bound, self.bound)
        before = np.maximum(origins[:, None] + np.arange(-self.warm, 1), 0)
        thrust = thrust_features(rows[before[:, 1:], COMMANDED])
        past = net.scaled(rows[before[:, :-1], VELOCITIES], thrust)
        h = c = np.zeros((len(origins), len(net.w_rec)))
        for j in range(self.warm):
            h, c = net.advance(past[:, j], h, c)
        path, thrust = [nu], thrust_features(plans)
        for k in range(K):
            h, c = net.advance(net.scaled(path[-1], thrust[:, k]), h, c)
            path.append(np.clip(path[-1] + net.increment(h), -self.bound, self.bound))
        return integrate(start, np.stack(path, axis=1))

    def _train(self, rows: Array) -> _Net | None:
        """Return a net that learned from rows (M, 10), or None where nothing can be learned."""
        wild = ~np.isfinite(rows)
        wild[:, VELOCITIES] |= ~(np.abs(rows[:, VELOCITIES]) <= self.bound)
        length = self.warm + self.ahead + 1
        index = np.arange(0, len(rows) - length + 1, self.stride)[:, None] + np.arange(length)
        index = index[~wild[index].any(axis=(1, 2))]
        if len(index) < self.windows_min:
            return None
        used = rows[np.unique(index)]
        inputs = np.concatenate([used[:, VELOCITIES], thrust_features(used[:, COMMANDED])], axis=1)
        sd = inputs.std(axis=0)
        if (sd[:3] < 1e-3 * self.typical).all():
            return None
        # a command that never changed gets no weight, now or later
        shaft = self.particulars.shaft_speed
        scale = np.concatenate(
            [
                1.0 / np.maximum(sd[:3], 1e-2 * self.typical),
                np.where(sd[3:] > 1e-2 * shaft**2, 1.0 / np.maximum(sd[3:], 1e-9), 0.0),
            ]
        )
        nu, cmd = rows[index, VELOCITIES], rows[index[:, 1:], COMMANDED]
        step = np.maximum(np.diff(nu, axis=1).std(axis=(0, 1)), 1e-3 * self.typical)
        H, rng = self.hidden, np.random.default_rng(self.seed)
        bound = 1.0 / math.sqrt(H)
        bias = rng.uniform(-bound, bound, 4 * H)
        # forget gates are open at first, and the read-out starts from persistence
        bias[H : 2 * H] += 1.0
        net = _Net(
            centre=inputs.mean(axis=0),
            scale=scale,
            step=step,
            w_in=rng.uniform(-bound, bound, (9, 4 * H)),
            w_rec=rng.uniform(-bound, bound, (H, 4 * H)),
            bias=bias,
            w_out=np.zeros((H, 3)),
            b_out=np.zeros(3),
        )
        inputs, target = net.scaled(nu[:, :-1], thrust_features(cmd)), nu[:, self.warm + 1 :]
        return self._fit(net, inputs, target, rng)

    def _fit(
        self, net: _Net, inputs: Array, target: Array, rng: np.random.Generator
    ) -> _Net | None:
        """Return the net after training, or None if it does not beat its start."""
        torch = import_torch()
        W, H, B = self.warm, self.hidden, len(inputs)

        def tensor(a: Array) -> Any:
            return torch.from_numpy(np.ascontiguousarray(a, dtype=np.float32))

        def array(a: Any) -> Array:
            return np.asarray(a.detach().numpy(), dtype=np.float64)

        with undisturbed(torch):
            past = np.swapaxes(inputs[:, :W], 0, 1)
            first = tensor(inputs[:, W, :3])
            plan = tensor(np.swapaxes(inputs[:, W:, 3:], 0, 1))
            truth = (target - net.centre[:3]) * net.scale[:3]
            truth = tensor(np.swapaxes(truth, 0, 1))
            step = tensor(net.step * net.scale[:3])
            kind = {"device": "cpu", "dtype": torch.float32}
            lstm = torch.nn.LSTM(9, H, **kind)
            cell = torch.nn.LSTMCell(9, H, **kind)
            read = torch.nn.Linear(H, 3, **kind)
            with torch.no_grad():
                lstm.weight_ih_l0.copy_(tensor(net.w_in.T))
                lstm.weight_hh_l0.copy_(tensor(net.w_rec.T))
                lstm.bias_ih_l0.copy_(tensor(net.bias))
                lstm.bias_hh_l0.zero_()
                read.weight.copy_(tensor(net.w_out.T))
                read.bias.copy_(tensor(net.b_out))
            # one LSTM: a fast pass over the past, single steps for the roll-out
            cell.weight_ih, cell.weight_hh = lstm.weight_ih_l0, lstm.weight_hh_l0
            cell.bias_ih, cell.bias_hh = lstm.bias_ih_l0, lstm.bias_hh_l0
            weights = [*lstm.parameters(), *read.parameters()]
            optimiser = torch.optim.AdamW(weights, lr=self.rate, weight_decay=self.decay)
            losses = []
            for epoch in range(self.epochs):
                share = epoch / self.epochs
                for group in optimiser.param_groups:
                    group["lr"] = (
                        self.rate
                        * min(1.0, 10.0 * (epoch + 1) / self.epochs)
                        * (0.5 + 0.5 * math.cos(math.pi * share))
                    )
                blurred = past.copy()
                blurred[..., :3] += self.noise * rng.standard_normal((W, B, 3))
                keep = rng.random((B, H)) >= self.dropout
                mask = tensor(keep / (1.0 - self.dropout))
                h, c = lstm(tensor(blurred))[1]
                h, c, y = h[0], c[0], first
                path = []
                for k in range(self.ahead):
                    h, c = cell(torch.cat([y, plan[k]], dim=1), (h, c))
                    y = y + read(h * mask) * step
                    path.append(y)
                loss = torch.nn.functional.smooth_l1_loss(torch.stack(path), truth)
                optimiser.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(weights, 1.0)
                optimiser.step()
                losses.append(loss.item())
            values = [array(a) for a in weights]
        if not (losses[-1] < losses[0] and all(np.isfinite(a).all() for a in values)):
            return None
        w_in, w_rec, bias_in, bias_rec, w_out, b_out = values
        return replace(
            net,
            w_in=np.ascontiguousarray(w_in.T),
            w_rec=np.ascontiguousarray(w_rec.T),
            bias=bias_in + bias_rec,
            w_out=np.ascontiguousarray(w_out.T),
            b_out=b_out,
        )
