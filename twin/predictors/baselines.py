"""Predictors that need no model: persistence, and persistence of a mean."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from twin.channels import PSI, R, U, V, X, Y
from twin.checkpoint import State
from twin.filters.navigator import Navigator
from twin.particulars import Particulars
from twin.predictors.base import (
    Estimate,
    ForecastError,
    Prediction,
    Predictor,
    check_forecast,
)

__all__ = [
    "HistoryPredictor",
    "Persistence",
    "SmoothedPersistence",
    "hold_velocity",
]

Array = NDArray[Any]

GAP_MAX = 300.0
"""After a longer gap, s, a history starts again."""

GRID = 0.25
"""Step of the history that learners and baselines look back on, s."""

STATES = slice(0, 6)
VELOCITIES = slice(3, 6)
COMMANDED = slice(6, 10)
ACTUATORS = slice(10, 14)
"""Parts of a row of the history; the actuators only where a predictor follows them."""

_SPARE = 8
"""Rows kept beyond those needed: windows begin at whole seconds, and forecasts within a step."""


def hold_velocity(start: Array, velocity: Array, after: Array) -> Array:
    """Return the states (..., K, 6) of a boat that keeps body velocity and yaw rate.

    ``start`` (..., 6) is the state at time 0, ``velocity`` (..., 3) the held u, v, r, and ``after``
    (K,) the times, s.
    """
    u, v, r = (velocity[..., i, None] for i in range(3))
    psi_0 = start[..., 2, None]
    half = 0.5 * r * after
    # chord of the arc: length times sin(half)/half, along the middle heading
    chord = after * np.sinc(half / math.pi)
    c, s = np.cos(psi_0 + half), np.sin(psi_0 + half)
    out = np.empty((*start.shape[:-1], len(after), 6))
    out[..., X] = start[..., 0, None] + chord * (u * c - v * s)
    out[..., Y] = start[..., 1, None] + chord * (u * s + v * c)
    out[..., PSI] = psi_0 + r * after
    out[..., U], out[..., V], out[..., R] = u, v, r
    return out


class HistoryPredictor(Predictor):
    """A predictor from the past states of its navigation filter, on an even grid.

    Its prediction intervals come from its own forecasts in the last :attr:`memory` seconds: the RMS
    of their errors at each horizon, against later navigation states.

    Subclasses provide :meth:`forecast`, and say with :attr:`look_back` how long a history it needs.
    """

    memory = 90.0
    steady: ClassVar[bool] = False
    """Whether a forecast from a row remains the same as rows come: nothing more is learned."""

    constants: ClassVar[tuple[str, ...]] = ("_errors", "_errors_at", "_kept_paths")

    def __init__(self, particulars: Particulars, *, seed: int = 0) -> None:
        super().__init__(particulars, seed=seed)
        self.navigator = Navigator(particulars)
        self.reset()

    def reset(self) -> None:
        """See :meth:`Predictor.reset`."""
        self.navigator.reset()
        self.t = 0.0
        self._cmd = np.zeros(4)
        self._extra = np.zeros(0)
        self._last = np.zeros(10)
        self._rows: list[Array] = []
        self._suspended = False
        self._unreliable: list[bool] = []
        self._dropped = 0
        self._next = math.inf
        self._errors_at = -math.inf
        self._errors = np.zeros((0, 6))
        # of a steady predictor, past forecasts by the number of their row
        self._kept_paths: dict[int, Array] = {}

    def load_state_dict(self, state: State) -> None:
        """Take over a saved state; see :meth:`Predictor.load_state_dict`."""
        super().load_state_dict(state)
        # past forecasts and their errors follow from the history
        self._errors_at = -math.inf
        self._kept_paths.clear()

    @property
    def rows(self) -> Array:
        """History every :data:`GRID` s that is kept, as :meth:`forecast` gets it, (M, 10 + n)."""
        return np.array(self._rows).reshape(-1, len(self._last))

    @property
    def look_back(self) -> float:
        """Seconds of history before a row that its forecast needs; here all of them.

        The forecasts of the last :attr:`memory` seconds are compared with what came. Rows before
        the look-back of the first of them are dropped.
        """
        return math.inf

    @abstractmethod
    def forecast(self, rows: Array, origins: Array, plans: Array) -> Array:
        """Return forecasts from several rows of a history.

        Parameters
        ----------
        rows : ndarray, shape (M, 10 + n)
            History every :data:`GRID` seconds: six states, then the four commands that were
            in force before the row, then what :meth:`extra_columns` gave.
        origins : ndarray of int, shape (B,)
            Rows to start from; only rows up to and with each may be used for it.
        plans : ndarray, shape (B, K, 4)
            Commands of the K grid steps after each origin.

        Returns
        -------
        ndarray, shape (B, K, 6)
            States at the ends of the steps; always finite.
        """

    def extra_columns(self, dt: float) -> Array:
        """Return the extra columns that a subclass keeps with each row, shape (n,)."""
        return self._extra

    def path(self, plan: Array, dt: float) -> Array:
        """Return the predicted states (K, 6) under a plan; see :meth:`Predictor.predict`.

        ForecastError: :meth:`forecast` returned another shape, NaN or infinity.
        """
        after = dt * np.arange(1, len(plan) + 1)
        K = math.ceil(after[-1] / GRID - 1e-9)
        # the plan on the grid: the command in force in the middle of each grid step
        middle = (np.arange(K) + 0.5) * GRID
        grid_plan = plan[np.minimum((middle / dt).astype(int), len(plan) - 1)]
        start = self.navigator.state
        rows = np.array([*self._rows, np.concatenate([start, self._cmd, self._extra])])
        path = np.asarray(self.forecast_from_last(rows, grid_plan))
        self._check_shape(path, (K, 6))
        check_forecast(type(self).__name__, self.t, GRID * np.arange(1, K + 1), path)
        path = np.concatenate([start[None], path])
        times = GRID * np.arange(K + 1)
        return np.stack([np.interp(after, times, path[:, j]) for j in range(6)], axis=1)

    def forecast_from_last(self, rows: Array, plan: Array) -> Array:
        """Return the forecast (K, 6) from the last row of all that is kept, under a plan (K, 4)."""
        return self.forecast(rows, np.array([len(rows) - 1]), plan[None])[0]

    def _drop_old(self) -> None:
        """Drop rows that nothing needs any more, many at a time."""
        seconds = self.memory + self.look_back
        keep = math.inf if math.isinf(seconds) else math.ceil(seconds / GRID) + _SPARE
        if len(self._rows) >= 2 * keep:
            old = len(self._rows) - int(keep)
            del self._rows[:old]
            del self._unreliable[:old]
            self._dropped += old

    def suspend_learning(self, commands: bool, motion: bool) -> None:
        """See :meth:`Predictor.suspend_learning`: rows are marked in the history."""
        self._suspended = commands or motion

    def begin_again(self, restart: Any) -> None:
        """See :meth:`Predictor.begin_again`."""
        self.navigator.begin_again(restart)

    def update(self, t: float, dt: float, z: Array, cmd: Array) -> None:
        """Take one row; see :meth:`Predictor.update`."""
        self.t = t
        s = self.navigator.update(dt, z)
        self._cmd = np.array(cmd, dtype=np.float64)
        self._extra = self.extra_columns(dt)
        if not self.navigator.ready:
            return
        now = np.concatenate([s, self._cmd, self._extra])
        if dt > GAP_MAX:  # the history before a long gap is of no use
            self._rows.clear()
            self._unreliable.clear()
            self._dropped = 0
            self._errors_at = self._next = -math.inf
            self._kept_paths.clear()
        if not math.isfinite(self._next):
            self._next = t
            self._last = now
        while self._next <= t + 1e-9:
            share = 1.0 if dt <= 0.0 else min(max(1.0 - (t - self._next) / dt, 0.0), 1.0)
            row = self._last + share * (now - self._last)
            row[COMMANDED] = self._cmd
            self._rows.append(row)
            self._unreliable.append(self._suspended)
            self._next += GRID
            self._drop_old()
        self._last = now

    @property
    def state(self) -> Array:
        """State, a view of shape (6,)."""
        return self.navigator.state

    def estimate(self) -> Estimate:
        """See :meth:`Predictor.estimate`."""
        sd = np.sqrt(np.diag(self.with_common_error(self.navigator.P[STATES, STATES])))
        none = np.zeros(0)
        return Estimate(self.t, self.state.copy(), sd, none, none, self.navigator.ready)

    def predict(self, plan: Array, dt: float) -> Prediction:
        """Predict the motion under a plan; see :meth:`Predictor.predict`."""
        after = dt * np.arange(1, len(plan) + 1)
        mean = self.path(plan, dt)
        errors = self._own_errors()
        known = GRID * np.arange(1, len(errors) + 1)
        grow = np.stack([np.interp(after, known, errors[:, j]) for j in range(6)], axis=1)
        # beyond the longest known horizon, errors of position and heading grow linearly
        grow[:, :3] *= np.maximum(after / known[-1], 1.0)[:, None]
        start_cov = self.with_common_error(self.navigator.P[STATES, STATES])
        cov = np.repeat(start_cov[None], len(plan), axis=0)
        cov[:, range(6), range(6)] += grow**2
        start = self.navigator.state.copy()
        return Prediction(self.t, start, start_cov, self.t + after, mean, cov)

    def _own_errors(self, horizon: float = 10.0) -> Array:
        """Return the root mean square errors (K, 6) of this predictor's past forecasts."""
        K, second = round(horizon / GRID), round(1.0 / GRID)
        # of whole seconds of history, so that earlier calls do not change the result
        count = (self._dropped + len(self._rows)) // second * second
        if count == self._errors_at:
            return self._errors
        begin = max(count - round(self.memory / GRID), self._dropped)
        # with the look-back of the oldest origin, so that its forecast is that of a second ago
        look_back = self.look_back if math.isfinite(self.look_back) else 0.0
        before = min(math.ceil(look_back / GRID), begin - self._dropped)
        kept = slice(begin - before - self._dropped, max(count - self._dropped, 0))
        rows = np.array(self._rows[kept]).reshape(-1, len(self._last))
        origins = np.arange(before + round(5.0 / GRID), len(rows) - K, second)
        if len(origins) < 5:
            return self._first_errors(K)
        ahead = origins[:, None] + np.arange(1, K + 1)
        paths = self._past_forecasts(rows, origins, ahead, begin - before)
        finite = np.isfinite(paths).all(axis=(1, 2))
        if not finite.all() and np.isfinite(rows).all():
            k = int(np.argmin(finite))
            origin = self.t - (len(self._rows) - kept.start - 1 - origins[k]) * GRID
            check_forecast(type(self).__name__, origin, GRID * np.arange(1, K + 1), paths[k])
        errors = paths - rows[ahead, STATES]
        # forecasts from a history with gaps may have none
        errors = errors[np.isfinite(errors).all(axis=(1, 2))]
        if not len(errors):
            return self._first_errors(K)
        self._errors = np.sqrt(np.mean(errors**2, axis=0))
        self._errors_at = count
        return self._errors

    def _past_forecasts(self, rows: Array, origins: Array, ahead: Array, first: int) -> Array:
        """Return the forecasts (B, K, 6) from origins with the commands that came.

        ``ahead`` (B, K) are the rows that they forecast, ``first`` is the number of the first row.
        """
        numbers = (first + origins).tolist()
        kept = self._kept_paths
        new = np.array([k for k, number in enumerate(numbers) if number not in kept], int)
        if len(new):
            made = np.asarray(self.forecast(rows, origins[new], rows[ahead[new], COMMANDED]))
            self._check_shape(made, (len(new), ahead.shape[1], 6))
            if not self.steady:
                return made
            self._kept_paths.update(
                (numbers[k], path) for k, path in zip(new.tolist(), made, strict=True)
            )
        self._kept_paths = {number: kept[number] for number in numbers}
        return np.array([self._kept_paths[number] for number in numbers])

    def _first_errors(self, steps: int) -> Array:
        """Return the errors (steps, 6) that are assumed before there are forecasts to compare."""
        U, L = self.particulars.speed, self.particulars.length
        rate = np.array([0.3 * U, 0.3 * U, 0.3 * U / L, 0.1 * U, 0.1 * U, 0.3 * U / L])
        return np.outer(np.sqrt(GRID * np.arange(1, steps + 1)), rate)

    def _check_shape(self, states: Array, shape: tuple[int, ...]) -> None:
        """Refuse forecasts of another shape."""
        if states.shape != shape:
            raise ForecastError(
                f"{type(self).__name__}: its forecast has shape {states.shape}; it must be {shape}"
            )


class Persistence(HistoryPredictor):
    """Body velocities and yaw rate of this moment, held and integrated.

    ``average`` seconds of their mean may stand in for the moment.
    """

    average = 0.0
    tuning = "none: it has no settings"

    @property
    def look_back(self) -> float:
        """See :attr:`HistoryPredictor.look_back`."""
        return self.average

    def forecast(self, rows: Array, origins: Array, plans: Array) -> Array:
        """Return forecasts; see :meth:`HistoryPredictor.forecast`."""
        width = max(round(self.average / GRID), 1)
        means = [rows[max(k + 1 - width, 0) : k + 1, VELOCITIES].mean(axis=0) for k in origins]
        after = GRID * np.arange(1, plans.shape[1] + 1)
        return hold_velocity(rows[origins, STATES], np.array(means), after)


class SmoothedPersistence(Persistence):
    """The mean of the last 8 s of body velocities and yaw rate, held and integrated."""

    average = 8.0
    tuning = "none: 8 s are the study's"
