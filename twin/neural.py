"""The learned comparator: an LSTM that a run trains on its own past.

Torch is needed to train, and only there: nothing of it is imported with this module, and the
forecasts are plain numpy, so that a predictor can be copied and pickled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.particulars import Particulars
from twin.predictor import GRID, HistoryPredictor, hold_velocity

__all__ = ["LSTMPredictor", "MissingTorch"]

Array = NDArray[np.float64]

REMEDY = "the LSTM predictor needs torch: pip install 'usv-twin[lstm]'"


class MissingTorch(ImportError):
    """Torch is not installed; the message says how to get it."""


def _import_torch() -> Any:
    """Return the module torch."""
    try:
        import torch
    except ImportError as error:
        raise MissingTorch(REMEDY) from error
    return torch


def _features(cmd: Array) -> Array:
    """Return what the net is told of commands: thrust, sideways and forward part, per side.

    Parameters
    ----------
    cmd : ndarray, shape (..., 4)
        Commands in the order of ``twin.log.COMMANDS``, rev/s and rad.

    Returns
    -------
    ndarray, shape (..., 6)
        n|n| and n|n| sin(delta) and n|n| cos(delta), left and right, (rev/s)^2.
    """
    n, delta = cmd[..., :2], cmd[..., 2:]
    thrust = n * np.abs(n)
    return np.concatenate([thrust, thrust * np.sin(delta), thrust * np.cos(delta)], axis=-1)


def _fill_forward(rows: Array) -> Array:
    """Return rows in which what is not finite repeats the last finite value of its column.

    Parameters
    ----------
    rows : ndarray, shape (M, d)
        Anything over time.

    Returns
    -------
    ndarray, shape (M, d)
        0 where nothing finite came before.
    """
    good = np.isfinite(rows)
    if good.all():
        return rows
    place = np.maximum.accumulate(np.where(good, np.arange(len(rows))[:, None], 0), axis=0)
    filled = np.take_along_axis(rows, place, axis=0)
    return np.where(np.isfinite(filled), filled, 0.0)


def _sigmoid(a: Array) -> Array:
    return 0.5 + 0.5 * np.tanh(0.5 * a)


@dataclass(frozen=True)
class _Net:
    """A trained net, in numpy.

    Parameters
    ----------
    centre, scale : ndarray, shape (9,)
        Inputs (u, v, r, six features of the command) enter as (input - centre) * scale.
    step : ndarray, shape (3,)
        Size of the increments of u, v, r that an output of 1 stands for, m/s and rad/s.
    w_in, w_rec, bias : ndarray, shapes (9, 4 H), (H, 4 H), (4 H,)
        The LSTM; gates in torch's order (input, forget, cell, output).
    w_out, b_out : ndarray, shapes (H, 3), (3,)
        Read-out.
    """

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
        gates = x @ self.w_in + h @ self.w_rec + self.bias
        i, f, g, o = np.split(gates, 4, axis=1)
        c = _sigmoid(f) * c + _sigmoid(i) * np.tanh(g)
        return _sigmoid(o) * np.tanh(c), c

    def scaled(self, nu: Array, cmd: Array) -> Array:
        """Return inputs (..., 9) from velocities (..., 3) and the commands (..., 4) after."""
        x = np.concatenate([nu, _features(cmd)], axis=-1)
        return np.clip((x - self.centre) * self.scale, -INPUT_MAX, INPUT_MAX)


INPUT_MAX = 6.0
"""Bound of a scaled input: beyond the data the net is not asked to extrapolate."""


class LSTMPredictor(HistoryPredictor):
    """An LSTM trained once on the run's own past, then rolled out under the plan.

    It is fed with the last :attr:`warm` steps of (u, v, r) and of the commands, and from there
    with its own predictions and the plan; it predicts increments of (u, v, r), from which
    heading and position follow by integration. Until it is trained, and where the past is too
    short or never moves, the velocities of the moment are held.
    """

    warm = 14
    ahead = 20
    hidden = 32
    epochs = 100
    rate = 1e-2
    decay = 1e-2
    noise = 0.0
    dropout = 0.0
    stride = 1
    path_weight = 0.0
    mirror = False
    heading = False

    def __init__(
        self, particulars: Particulars, *, seed: int = 0, train_at: float = 60.0
    ) -> None:
        _import_torch()
        self.train_at = train_at
        super().__init__(particulars, seed=seed)

    def reset(self) -> None:
        """Forget everything that was seen, and what was learned from it."""
        super().reset()
        self._net: _Net | None = None
        self._trained = False

    def update(self, t: float, dt: float, z: Array, cmd: Array) -> None:
        """Take one row; see :meth:`Predictor.update`."""
        super().update(t, dt, z, cmd)
        if not self._trained and (len(self._rows) - 1) * GRID >= self.train_at - 1e-9:
            self._net = self._train(np.array(self._rows))
            self._trained = True
            self._errors_at = -math.inf

    @property
    def _envelope(self) -> Array:
        U = 3.0 * self.particulars.speed
        return np.array([U, U, U / self.particulars.length])

    def forecast(self, rows: Array, origins: Array, plans: Array) -> Array:
        """Return forecasts; see :meth:`HistoryPredictor.forecast`."""
        rows = _fill_forward(rows)
        plans = np.where(np.isfinite(plans), plans, rows[origins, None, 6:])
        bound = self._envelope
        start = rows[origins, :6]
        nu = np.clip(start[:, 3:], -bound, bound)
        K = plans.shape[1]
        if self._net is None:
            return hold_velocity(start, nu, GRID * np.arange(1, K + 1))
        net = self._net
        before = np.maximum(origins[:, None] + np.arange(-self.warm, 1), 0)
        past = net.scaled(rows[before[:, :-1], 3:6], rows[before[:, 1:], 6:])
        h = c = np.zeros((len(origins), len(net.w_rec)))
        for j in range(self.warm):
            h, c = net.advance(past[:, j], h, c)
        out = np.empty((len(origins), K, 6))
        x, y, psi = start[:, 0], start[:, 1], start[:, 2]
        for k in range(K):
            h, c = net.advance(net.scaled(nu, plans[:, k]), h, c)
            new = np.clip(nu + (h @ net.w_out + net.b_out) * net.step, -bound, bound)
            u, v, r = (0.5 * (nu + new)).T
            middle = psi + 0.5 * GRID * r
            x = x + GRID * (u * np.cos(middle) - v * np.sin(middle))
            y = y + GRID * (u * np.sin(middle) + v * np.cos(middle))
            psi = psi + GRID * r
            nu = new
            out[:, k, 0], out[:, k, 1], out[:, k, 2], out[:, k, 3:] = x, y, psi, nu
        return out

    def _train(self, rows: Array) -> _Net | None:
        torch = _import_torch()
        W, K, H = self.warm, self.ahead, self.hidden
        begins = np.arange(0, len(rows) - W - K, self.stride)
        index = begins[:, None] + np.arange(W + K + 1)
        index = index[np.isfinite(rows[index, 3:]).all(axis=(1, 2))]
        if len(index) < 16:
            return None
        used = rows[np.unique(index)]
        speed, length = self.particulars.speed, self.particulars.length
        usual = np.array([speed, speed, speed / length])
        floor = np.concatenate([0.01 * usual, np.full(6, 0.01 * self.particulars.shaft_speed**2)])
        x = np.concatenate([used[:, 3:6], _features(used[:, 6:])], axis=1)
        sd = x.std(axis=0)
        if (sd[:3] < 1e-3 * usual).all():
            return None
        scale = np.where(sd > floor, 1.0 / np.maximum(sd, floor), 0.0)
        scale[:3] = 1.0 / np.maximum(sd, floor)[:3]
        centre = x.mean(axis=0)
        nu = rows[index, 3:6]
        delta = np.diff(nu, axis=1)
        step = np.maximum(delta.std(axis=(0, 1)), 1e-3 * usual)
        cmd = rows[index[:, 1:], 6:]
        D = np.concatenate([nu[:, :-1], _features(cmd)], axis=2)
        D = np.clip((D - centre) * scale, -INPUT_MAX, INPUT_MAX)
        Y = (nu[:, 1:] - centre[:3]) * scale[:3]
        ratio = step * scale[:3]
        rng = np.random.default_rng(self.seed)
        T = lambda a: torch.from_numpy(np.ascontiguousarray(a, dtype=np.float32))
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            data = T(D.transpose(1, 0, 2)); target = T(Y.transpose(1, 0, 2)[W:]); ratio_t = T(ratio)
            if self.mirror:
                sx = np.array([1,-1,-1,1,1,-1,-1,1,1.]); perm=[0,1,2,4,3,6,5,8,7]
                # physical mirror, then rescale
                raw = np.concatenate([nu[:, :-1], _features(cmd)], axis=2)[..., perm]*sx
                D2 = np.clip((raw - centre) * scale, -INPUT_MAX, INPUT_MAX)
                Y2 = (nu[:,1:]*sx[:3]-centre[:3])*scale[:3]
                data = torch.cat([data, T(D2.transpose(1,0,2))],1); target = torch.cat([target, T(Y2.transpose(1,0,2)[W:])],1)
            bound = 1.0 / math.sqrt(H)
            draw = lambda *s: T(rng.uniform(-bound, bound, s)).requires_grad_()
            w_ih, w_hh, b = draw(4 * H, 9), draw(4 * H, H), draw(4 * H)
            with torch.no_grad(): b[H:2*H] += 1.0
            w_out = torch.zeros(3, H, requires_grad=True); b_out = torch.zeros(3, requires_grad=True)
            zero = torch.zeros(4 * H)
            P = [w_ih, w_hh, b, w_out, b_out]
            opt = torch.optim.AdamW(P, lr=self.rate, weight_decay=self.decay)
            B = data.shape[1]
            for epoch in range(self.epochs):
                for gr in opt.param_groups:
                    gr["lr"] = self.rate * (0.5 + 0.5 * math.cos(math.pi * epoch / self.epochs)) * min(1, (epoch+1)/10)
                past = data[:W]
                if self.noise:
                    e = np.zeros((W, B, 9)); e[..., :3] = self.noise * rng.standard_normal((W, B, 3))
                    past = past + T(e)
                h = c = torch.zeros(B, H)
                for j in range(W):
                    h, c = torch.lstm_cell(past[j], (h, c), w_ih, w_hh, b, zero)
                mask = T((rng.random((B, H)) >= self.dropout) / (1 - self.dropout)) if self.dropout else None
                y = data[W, :, :3]
                loss = 0.0; ys = []
                for k in range(K):
                    h, c = torch.lstm_cell(torch.cat([y, data[W + k, :, 3:]], 1), (h, c), w_ih, w_hh, b, zero)
                    hh = h * mask if mask is not None else h
                    y = y + (hh @ w_out.T + b_out) * ratio_t
                    ys.append(y)
                e = torch.stack(ys) - target
                loss = torch.nn.functional.smooth_l1_loss(e, torch.zeros_like(e))
                if self.path_weight:
                    q = torch.cumsum(e, 0) * GRID
                    loss = loss + self.path_weight * torch.nn.functional.smooth_l1_loss(q, torch.zeros_like(q))
                opt.zero_grad(); loss.backward()
                torch.nn.utils.clip_grad_norm_(P, 1.0)
                opt.step()
            N = lambda a: a.detach().numpy().astype(np.float64)
            self.loss = float(loss.detach())
            return _Net(centre, scale, step, N(w_ih).T, N(w_hh).T, N(b), N(w_out).T, N(b_out))
        finally:
            torch.set_num_threads(threads)
