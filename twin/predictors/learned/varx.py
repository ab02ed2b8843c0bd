"""Vector autoregression with inputs (VARX), fitted to the run's own past."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.particulars import Particulars
from twin.predictors.baselines import (
    ACTUATORS,
    COMMANDED,
    GRID,
    STATES,
    VELOCITIES,
)
from twin.predictors.learned.features import (
    ActuatedPredictor,
    fill_forward,
    integrate,
    thrust_features,
)

__all__ = [
    "VARPredictor",
]

Array = NDArray[Any]

STRIDE_MAX = 8
"""Most grid steps in a step: a slow ship's still has to resolve its actuators."""

ROWS_MIN = 40
"""Steps without which nothing is fitted."""


class VARPredictor(ActuatedPredictor):
    """A vector autoregression with inputs (VARX), by least squares on the run's own past.

    The change of u, v, r over a step is linear in their last :attr:`order` values and in the
    actuators' values. The latter cover as many steps, the one ahead included. Those are thrust, its
    forward and sideways parts and the sine of the angle, sum and difference of both sides.
    Actuators follow the commands with the lags of the particulars. A step is .25 s for the study
    boat and as much longer as a ship takes longer to sail its length. Until there is a fit,
    velocities are held. Unreliable rows are left out of the fit. What earlier rows taught is kept
    as sums, so that it outlasts long gaps, and a fit costs the same after a day.

    Tuning budget: 39 configurations. They varied order (2 to 10, of the inputs 1 to 8), ridge (1e-4
    to .1), and five sets of inputs. Wind by heading, products of velocities and a window of 60 s
    were tried, too. All were scored on the four manoeuvres of twelve seeds (100-111) by 10 s
    forecasts with known commands.

    Source: docs/explanation/twin.md, Learned predictors; the inputs are ours.

    Parameters
    ----------
    particulars : Particulars
        Lags, and the size of the columns.
    seed : int
        Nothing is drawn at random here.
    """

    tuning = "39 configurations on 12 tuning seeds"

    constants = ("stride",)

    order = 4
    """Steps looked back on."""
    ridge = 3e-3
    """Weight of the coefficients of scaled columns, as a share of the rows."""
    first, refit = 20.0, 10.0
    """Length of the history at the first fit, and between fits, s."""

    def __init__(self, particulars: Particulars, *, seed: int = 0) -> None:
        # the study boat has steps of one GRID
        self.stride = min(max(round(particulars.time_scale), 1), STRIDE_MAX)
        super().__init__(particulars, seed=seed)

    @property
    def look_back(self) -> float:
        """See :attr:`HistoryPredictor.look_back`: the rows since the last fit, and their past."""
        return self.first + self.refit + GRID * self.stride * (self.order + 1)

    def reset(self) -> None:
        """See :meth:`Predictor.reset`; the fit is forgotten too."""
        super().reset()
        self._due = self.first
        # row from which on nothing was added to the sums
        self._next_at = 0
        # sums of products of 1, the regressors and the changes
        self._products = np.zeros((1 + 11 * self.order + 3,) * 2)
        self._fit: Array | None = None

    def update(self, t: float, dt: float, z: Array, cmd: Array) -> None:
        """Take one row; see :meth:`Predictor.update`. A refit takes a millisecond."""
        super().update(t, dt, z, cmd)
        have = (self._dropped + len(self._rows) - 1) * GRID
        if have >= self._due - 1e-9:
            self._due = have + self.refit
            first = self._next_at - self._dropped
            begin = max(first - self.stride * self.order, 0)
            rows, unreliable = np.array(self._rows[begin:]), np.array(self._unreliable[begin:])
            self._products += self._products_of(rows, unreliable, first - begin)
            self._next_at = self._dropped + len(self._rows) - self.stride
            self._fit = self._solve(self._products)
            self._errors_at = -math.inf
        elif have < self._due - max(self.first, self.refit):
            # the history was cleared at a long gap
            self._due, self._next_at = self.first, 0

    def _past(self, rows: Array, at: Array) -> Array:
        """Return scaled u, v, r at rows (B,) and the steps before, newest first (B, 3 p)."""
        back = np.maximum(at[:, None] - self.stride * np.arange(self.order), 0)
        size = self.bound / self.typical
        return np.clip(rows[back, VELOCITIES] / self.typical, -size, size).reshape(len(at), -1)

    def _inputs(self, rows: Array, at: Array, ahead: Array) -> Array:
        """Return what the actuators did, step by step, oldest first (B, p - 1 + n, q)."""
        back = np.maximum(at[:, None] + np.arange(-self.stride * (self.order - 1), 1), 0)
        acts = np.concatenate([rows[back, ACTUATORS], ahead], axis=1)
        acts[..., :2] /= self.particulars.shaft_speed
        each = np.concatenate([thrust_features(acts), np.sin(acts[..., 2:])], axis=2)
        left, right = each[..., ::2], each[..., 1::2]
        both = np.concatenate([left + right, left - right], axis=2)
        mean = 0.5 * (both[:, 1:] + both[:, :-1])
        return mean.reshape(len(at), -1, self.stride, both.shape[2]).mean(axis=2)

    def _products_of(self, rows: Array, unreliable: Array, first: int) -> Array:
        """Return the sums of products of 1, regressors and changes at sound rows from a first."""
        m, p = self.stride, self.order
        at = np.arange(max(m * (p - 1), first), len(rows) - m)
        wild = ~np.isfinite(rows).all(axis=1) | unreliable
        wild |= ~(np.abs(rows[:, VELOCITIES]) <= self.bound).all(axis=1)
        at = at[~wild[at[:, None] + np.arange(-m * (p - 1), m + 1)].any(axis=1)]
        if not len(at):
            return np.zeros_like(self._products)
        ahead = rows[at[:, None] + np.arange(1, m + 1), ACTUATORS]
        inputs = self._inputs(rows, at, ahead).reshape(len(at), -1)
        change = (rows[at + m, VELOCITIES] - rows[at, VELOCITIES]) / self.typical
        parts = np.ones((len(at), 1)), self._past(rows, at), inputs, change
        columns = np.concatenate(parts, axis=1)
        return columns.T @ columns

    def _solve(self, products: Array) -> Array | None:
        """Return coefficients, and in the last row constants; None with too few sound rows."""
        count = products[0, 0]
        if count < ROWS_MIN:
            return None
        means = products[0, 1:] / count
        cov = products[1:, 1:] / count - np.outer(means, means)
        centre, change = means[:-3], means[-3:]
        sd = np.sqrt(np.maximum(np.diag(cov)[:-3], 0.0))
        # a column that never changed gets no weight, now or later
        scale = np.where(sd > 1e-6, 1.0 / np.maximum(sd, 1e-6), 0.0)
        A = cov[:-3, :-3] * np.outer(scale, scale) + self.ridge * np.eye(len(scale))
        W = np.linalg.solve(A, cov[:-3, -3:] * scale[:, None]) * scale[:, None]
        return np.vstack([W, change - centre @ W])

    def forecast(self, rows: Array, origins: Array, plans: Array) -> Array:
        """Return forecasts; see :meth:`HistoryPredictor.forecast`."""
        rows = fill_forward(rows)
        start, K = rows[origins, STATES], plans.shape[1]
        if self._fit is None:
            return self.held(start, K)
        W, b = self._fit[:-1], self._fit[-1]
        m, p = self.stride, self.order
        plans = np.where(np.isfinite(plans), plans, rows[origins, None, COMMANDED])
        plans = np.concatenate([plans, np.repeat(plans[:, -1:], -K % m, axis=1)], axis=1)
        inputs = self._inputs(rows, origins, self.follow(rows[origins, ACTUATORS], plans))
        past = self._past(rows, origins)
        size, path = self.bound / self.typical, [past[:, :3]]
        for k in range(plans.shape[1] // m):
            # newest first, as in the history
            did = inputs[:, k : k + p].reshape(len(origins), -1)
            nu = past[:, :3] + np.concatenate([past, did], axis=1) @ W + b
            path.append(np.clip(nu, -size, size))
            past = np.concatenate([path[-1], past[:, :-3]], axis=1)
        place = np.arange(K + 1) / m
        low = np.minimum(place.astype(int), len(path) - 2)
        nodes = np.stack(path, axis=1)
        between = nodes[:, low] + (place - low)[:, None] * (nodes[:, low + 1] - nodes[:, low])
        return integrate(start, between * self.typical)
