"""Commands as learners see them: after the actuators' lag, as what pushes and turns a boat."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from twin.particulars import Particulars
from twin.predictors.baselines import GRID, HistoryPredictor, hold_velocity

__all__ = [
    "ActuatedPredictor",
    "LearnedPredictor",
    "fill_forward",
    "integrate",
    "lagged",
    "lstm_cell",
    "thrust_features",
]

Array = NDArray[np.float64]


def thrust_features(cmd: Array) -> Array:
    """Return n|n|, n|n| sin(delta) and n|n| cos(delta) of commands (..., 4), left and right.

    The result is (..., 6), in (rev/s)^2.
    """
    # the bound only keeps squares of invalid values finite
    n, delta = np.clip(cmd[..., :2], -1e6, 1e6), cmd[..., 2:]
    thrust = n * np.abs(n)
    return np.concatenate([thrust, thrust * np.sin(delta), thrust * np.cos(delta)], axis=-1)


def fill_forward(rows: Array) -> Array:
    """Return rows (M, d) in which what is not finite repeats the last finite value of its column.

    It is 0 where nothing finite came before.
    """
    good = np.isfinite(rows)
    if good.all():
        return rows
    place = np.maximum.accumulate(np.where(good, np.arange(len(rows))[:, None], 0), axis=0)
    padded = np.take_along_axis(rows, place, axis=0)
    return np.where(np.isfinite(padded), padded, 0.0)


def lagged(act: Array, cmd: Array, dt: float, particulars: Particulars) -> Array:
    """Return the actuators (..., 4) after a command was in force for dt (s)."""
    share = [-math.expm1(-dt / lag) for lag in (particulars.shaft_lag, particulars.steer_lag)]
    step = (cmd - act) * np.repeat(share, 2)
    reach = particulars.steer_rate * dt
    step[..., 2:] = np.clip(step[..., 2:], -reach, reach)
    return act + step


def lstm_cell(gates: NDArray[Any], c: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return hidden state and cell (B, H) of an LSTM after a step.

    ``gates`` (B, 4 H) are the sums that drive the gates i, f, g, o, in torch's order.
    """
    H = gates.shape[1] // 4
    # one logistic function of all gates costs less than one for each
    opened = np.tanh(0.5 * gates)
    opened *= 0.5
    opened += 0.5
    new = np.tanh(gates[:, 2 * H : 3 * H])
    c = opened[:, H : 2 * H] * c + opened[:, :H] * new
    return opened[:, 3 * H :] * np.tanh(c), c


def integrate(start: Array, velocity: Array) -> Array:
    """Return the states (B, K, 6) of boats whose velocities (B, K + 1, 3) are known on the grid.

    The velocities in ``start`` (B, 6) are not used.
    """
    u, v, r = np.moveaxis(0.5 * (velocity[:, 1:] + velocity[:, :-1]), 2, 0)
    psi = start[:, 2:3] + GRID * np.cumsum(r, axis=1)
    middle = psi - 0.5 * GRID * r
    c, s = np.cos(middle), np.sin(middle)
    x = start[:, 0:1] + GRID * np.cumsum(u * c - v * s, axis=1)
    y = start[:, 1:2] + GRID * np.cumsum(u * s + v * c, axis=1)
    return np.concatenate([np.stack([x, y, psi], axis=2), velocity[:, 1:]], axis=2)


class LearnedPredictor(HistoryPredictor):
    """A predictor whose forecasts keep within bounds that follow from the particulars."""

    constants: ClassVar[tuple[str, ...]] = ("typical", "bound")

    def __init__(self, particulars: Particulars, *, seed: int = 0) -> None:
        U, L = particulars.speed, particulars.length
        self.typical = np.array([U, U, U / L])
        """Size of u, v, r: m/s and rad/s."""
        self.bound = 3.0 * self.typical
        """Largest u, v, r of a forecast, and of a row worth learning from."""
        super().__init__(particulars, seed=seed)

    def held(self, start: Array, steps: int) -> Array:
        """Return the states (B, steps, 6) of boats that keep their velocities, within bounds."""
        nu = np.clip(start[:, 3:], -self.bound, self.bound)
        return hold_velocity(start, nu, GRID * np.arange(1, steps + 1))


class ActuatedPredictor(LearnedPredictor):
    """A predictor whose history holds the actuators, which follow the commands with a lag.

    Columns 10 to 13 of its rows are where shafts (rev/s) and angles (rad) are estimated to be.
    """

    def reset(self) -> None:
        """See :meth:`Predictor.reset`."""
        super().reset()
        self._act = np.full(4, math.nan)
        self._extra = np.zeros(4)
        self._last = np.zeros(14)

    def extra_columns(self, dt: float) -> Array:
        """Return the actuators at the row that just came, shape (4,)."""
        known = np.isfinite(self._act).all()
        self._act = lagged(self._act, self._cmd, dt, self.particulars) if known else self._cmd
        return self._act

    def follow(self, act: Array, plans: Array) -> Array:
        """Return the actuators (B, K, 4) over a plan, at the ends of its grid steps."""
        out = np.empty(plans.shape)
        for k in range(plans.shape[1]):
            act = out[:, k] = lagged(act, plans[:, k], GRID, self.particulars)
        return out
