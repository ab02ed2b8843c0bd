"""Predictors: what they are asked, what they answer, and the simple ones.

A predictor is fed one row of measurements and commands after the other, and may at any time
be asked where the boat will be under a plan of commands. It sees nothing else: not the truth,
not the future beyond the plan, not another predictor.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from twin.identifiability import Identifiability
from twin.navigation import Navigator
from twin.particulars import Particulars

__all__ = [
    "CHANNELS",
    "Estimate",
    "HistoryPredictor",
    "Persistence",
    "Prediction",
    "Predictor",
    "SmoothedPersistence",
    "hold_velocity",
]

Array = NDArray[Any]

CHANNELS = ("x_m", "y_m", "psi_rad", "u_mps", "v_mps", "r_radps")
"""Columns of a state: north, east, heading, speed forward, to starboard, yaw rate."""

Z90 = 1.6448536269514722
"""Half the width of the middle 90 % of a normal distribution, standard deviations."""

GAP_MAX = 300.0
"""After a longer gap, s, a history begins anew."""
GRID = 0.25
"""Step of the history that learners and baselines look back on, s."""


@dataclass(frozen=True)
class Estimate:
    """What a predictor believes now.

    Parameters
    ----------
    t : float
        Time of the last row, s.
    s, sd : ndarray, shape (6,)
        State in the order of :data:`CHANNELS`, and its standard deviation.
    xi, xi_sd : ndarray, shape (p,)
        Model parameters and their standard deviations; empty where there is no model.
    ready : bool
        False until a first fix and a first heading have come; the rest means nothing then.
    """

    t: float
    s: Array
    sd: Array
    xi: Array
    xi_sd: Array
    ready: bool


@dataclass(frozen=True)
class Prediction:
    """Where the boat will be, and how sure that is.

    Parameters
    ----------
    t0 : float
        Time at which it was made, s.
    start, start_cov : ndarray, shapes (6,), (6, 6)
        State that it starts from, in the order of :data:`CHANNELS`, and its covariance.
    t : ndarray, shape (K,)
        Times that it speaks of, s.
    mean : ndarray, shape (K, 6)
        Predicted states; heading not wrapped.
    cov : ndarray, shape (K, 6, 6)
        Covariances of their errors.
    low, high : ndarray, shape (K, 6)
        5 % and 95 % points; left out, those of normal errors.
    """

    t0: float
    start: Array
    start_cov: Array
    t: Array
    mean: Array
    cov: Array
    low: Array = None  # type: ignore[assignment]
    high: Array = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        for name, side in (("low", -Z90), ("high", Z90)):
            if getattr(self, name) is None:
                object.__setattr__(self, name, self.mean + side * self.sd)

    @property
    def sd(self) -> Array:
        """Standard deviations, shape (K, 6)."""
        return np.sqrt(np.maximum(np.diagonal(self.cov, axis1=1, axis2=2), 0.0))

    def at(self, horizons: Array) -> tuple[Array, Array]:
        """Return mean (h, 6) and covariance (h, 6, 6) at times after t0, interpolated.

        Parameters
        ----------
        horizons : array_like, shape (h,)
            Seconds after t0, within the prediction.
        """
        return (
            self._between(self.start, self.mean, horizons),
            self._between(self.start_cov, self.cov, horizons),
        )

    def band(self, horizons: Array) -> tuple[Array, Array]:
        """Return the 5 % and 95 % points, each (h, 6), at times after t0, interpolated.

        Parameters
        ----------
        horizons : array_like, shape (h,)
            Seconds after t0, within the prediction.
        """
        half = Z90 * np.sqrt(np.maximum(np.diagonal(self.start_cov), 0.0))
        return (
            self._between(self.start - half, self.low, horizons),
            self._between(self.start + half, self.high, horizons),
        )

    def _between(self, first: Array, later: Array, horizons: Array) -> Array:
        """Return values at times after t0, linearly between those of the start and the rows."""
        after = np.concatenate([[0.0], self.t - self.t0])
        values = np.concatenate([first[None], later])
        place = np.interp(horizons, after, np.arange(len(after)))
        low = np.minimum(place.astype(int), len(after) - 2)
        share = (place - low).reshape(-1, *[1] * (values.ndim - 1))
        return values[low] + share * (values[low + 1] - values[low])


class Predictor(ABC):
    """The contract of every entry of ``twin.PREDICTORS``.

    Parameters
    ----------
    particulars : Particulars
        What is known of the boat beforehand.
    seed : int
        For predictors that draw random numbers; the same seed gives the same bits.
    """

    trains = False
    """Whether the class takes ``train_at``: seconds of data after which it trains itself."""
    models = False
    """Whether the class takes ``model``, one of ``twin.structure.MODELS``."""
    parameter_names: tuple[str, ...] = ()
    """Names of the parameters in ``Estimate.xi`` ..."""
    parameter_units: tuple[str, ...] = ()
    """... their units ..."""
    parameter_blocks: Mapping[str, tuple[int, int]] = MappingProxyType({})
    """... and first and last + 1 of those in the equation of each motion."""
    world = False
    """Whether the class takes ``vessel``, ``sea`` and ``dof``: the true ones, for a floor."""
    tuning: ClassVar[str] = "not stated"
    """What was searched for its settings, in one line: the benchmark prints it."""

    def __init_subclass__(cls, **options: Any) -> None:
        """Leave the tuning of a subclass unstated: it is not that of its base."""
        super().__init_subclass__(**options)
        if "tuning" not in vars(cls):
            cls.tuning = "not stated"

    def __init__(self, particulars: Particulars, *, seed: int = 0) -> None:
        self.particulars = particulars
        self.seed = seed

    def with_common_error(self, cov: Array) -> Array:
        """Return covariances (..., 6, 6) with the drifting part of the GPS error added.

        It is the same at every time of a prediction, and no filter can tell it from the
        position.
        """
        cov = cov.copy()
        for i in (0, 1):
            cov[..., i, i] += self.particulars.instruments.gps_bias_sd**2
        return cov

    @abstractmethod
    def reset(self) -> None:
        """Forget everything that was seen."""

    @abstractmethod
    def update(self, t: float, dt: float, z: Array, cmd: Array) -> None:
        """Take one row.

        Parameters
        ----------
        t, dt : float
            Time of the row and time since the row before, s; dt is 0 in the first row.
        z : ndarray, shape (10,)
            Measurements in the order of ``twin.log.MEASUREMENTS``; NaN is missing.
        cmd : ndarray, shape (4,)
            Command that was in force since the row before, in the order of
            ``twin.log.COMMANDS``.
        """

    @property
    @abstractmethod
    def s(self) -> Array:
        """State believed now, shape (6,) in the order of :data:`CHANNELS`; may be a view."""

    @abstractmethod
    def estimate(self) -> Estimate:
        """Return what is believed now."""

    @property
    def window_s(self) -> float:
        """Length of the data that the identifier looks back on now, s; NaN where it does not."""
        return math.nan

    def identifiability(self) -> Identifiability | None:
        """Return what the data seen say of the parameters; None where there is no model."""
        return None

    def mean(self, plan: Array, dt: float) -> Array:
        """Return the predicted states (K, 6) alone, where that is cheaper.

        Parameters
        ----------
        plan, dt
            As for :meth:`predict`.
        """
        return self.predict(plan, dt).mean

    @abstractmethod
    def predict(self, plan: Array, dt: float) -> Prediction:
        """Predict the motion under a plan; nothing of the predictor's state changes by it.

        Parameters
        ----------
        plan : ndarray, shape (K, 4)
            Commands; row k is in force from k to k + 1 times dt after the last row.
        dt : float
            Time between rows of the plan, s.

        Returns
        -------
        Prediction
            At the ends of the rows of the plan; always finite.
        """


def finer(path: Array, every: int, rows: int) -> Array:
    """Return values at every step of a plan from those at every few steps, linearly between.

    Parameters
    ----------
    path : ndarray, shape (K + 1, ...)
        Values now and after each coarse step.
    every : int
        Steps in a coarse step; the last may be cut short.
    rows : int
        Steps of the plan, at most K * every.

    Returns
    -------
    ndarray, shape (rows, ...)
    """
    place = np.arange(1, rows + 1) / every
    low = np.minimum(place.astype(int), len(path) - 2)
    share = (place - low).reshape(-1, *[1] * (path.ndim - 1))
    between: Array = (1.0 - share) * path[low] + share * path[low + 1]
    return between


def hold_velocity(start: Array, velocity: Array, after: Array) -> Array:
    """Return the states of a boat that keeps body velocity and yaw rate.

    Parameters
    ----------
    start : ndarray, shape (..., 6)
        State at time 0.
    velocity : ndarray, shape (..., 3)
        Held u, v, r in m/s and rad/s.
    after : ndarray, shape (K,)
        Times, s.

    Returns
    -------
    ndarray, shape (..., K, 6)
    """
    u, v, r = (velocity[..., i, None] for i in range(3))
    psi_0 = start[..., 2, None]
    half = 0.5 * r * after
    # chord of the arc: length times sin(half)/half, along the middle heading
    chord = after * np.sinc(half / math.pi)
    c, s = np.cos(psi_0 + half), np.sin(psi_0 + half)
    out = np.empty((*start.shape[:-1], len(after), 6))
    out[..., 0] = start[..., 0, None] + chord * (u * c - v * s)
    out[..., 1] = start[..., 1, None] + chord * (u * s + v * c)
    out[..., 2] = psi_0 + r * after
    out[..., 3], out[..., 4], out[..., 5] = u, v, r
    return out


class HistoryPredictor(Predictor):
    """A predictor that looks back on its navigation filter's states, on an even grid.

    Its bands come from its own forecasts of the last :attr:`memory` seconds: the root mean
    square of their errors at each horizon, judged by what the navigation filter said later.

    Subclasses provide :meth:`forecast`.
    """

    memory = 90.0

    def __init__(self, particulars: Particulars, *, seed: int = 0) -> None:
        super().__init__(particulars, seed=seed)
        self.navigator = Navigator(particulars)
        self.reset()

    def reset(self) -> None:
        """Forget everything that was seen."""
        self.navigator.reset()
        self.t = 0.0
        self._cmd = np.zeros(4)
        self._beside = np.zeros(0)
        self._last = np.zeros(10)
        self._rows: list[Array] = []
        self._next = math.inf
        self._errors_at = -math.inf
        self._errors = np.zeros((0, 6))

    @abstractmethod
    def forecast(self, rows: Array, origins: Array, plans: Array) -> Array:
        """Return forecasts from several rows of a history.

        Parameters
        ----------
        rows : ndarray, shape (M, 10 + n)
            History every :data:`GRID` seconds: six states, then the four commands that were
            in force before the row, then what :meth:`beside` gave.
        origins : ndarray of int, shape (B,)
            Rows to start from; only rows up to and with each may be used for it.
        plans : ndarray, shape (B, K, 4)
            Commands of the K grid steps after each origin.

        Returns
        -------
        ndarray, shape (B, K, 6)
            States at the ends of the steps.
        """

    def beside(self, dt: float) -> Array:
        """Return what a subclass keeps beside the row that just came, shape (n,)."""
        return self._beside

    def path(self, plan: Array, dt: float) -> Array:
        """Return the predicted states (K, 6) under a plan; see :meth:`Predictor.predict`."""
        after = dt * np.arange(1, len(plan) + 1)
        K = math.ceil(after[-1] / GRID - 1e-9)
        # the plan on the grid: the command in force in the middle of each grid step
        middle = (np.arange(K) + 0.5) * GRID
        grid_plan = plan[np.minimum((middle / dt).astype(int), len(plan) - 1)]
        start = self.navigator.n[:6]
        rows = np.array([*self._rows, np.concatenate([start, self._cmd, self._beside])])
        path = self.forecast(rows, np.array([len(rows) - 1]), grid_plan[None])[0]
        path = np.concatenate([start[None], np.nan_to_num(path)])
        times = GRID * np.arange(K + 1)
        return np.stack([np.interp(after, times, path[:, j]) for j in range(6)], axis=1)

    def update(self, t: float, dt: float, z: Array, cmd: Array) -> None:
        """Take one row; see :meth:`Predictor.update`."""
        self.t = t
        s = self.navigator.update(dt, z)
        self._cmd = np.array(cmd, dtype=np.float64)
        self._beside = self.beside(dt)
        if not self.navigator.ready:
            return
        now = np.concatenate([s, self._cmd, self._beside])
        if dt > GAP_MAX:  # nothing on the far side of it bears on what comes
            self._rows.clear()
            self._errors_at = self._next = -math.inf
        if not math.isfinite(self._next):
            self._next = t
            self._last = now
        while self._next <= t + 1e-9:
            share = 1.0 if dt <= 0.0 else min(max(1.0 - (t - self._next) / dt, 0.0), 1.0)
            row = self._last + share * (now - self._last)
            row[6:10] = self._cmd
            self._rows.append(row)
            self._next += GRID
        self._last = now

    @property
    def s(self) -> Array:
        """State, a view of shape (6,)."""
        return self.navigator.n[:6]

    def estimate(self) -> Estimate:
        """Return what is believed now."""
        sd = np.sqrt(np.diag(self.with_common_error(self.navigator.P[:6, :6])))
        none = np.zeros(0)
        return Estimate(self.t, self.s.copy(), sd, none, none, self.navigator.ready)

    def predict(self, plan: Array, dt: float) -> Prediction:
        """Predict the motion under a plan; see :meth:`Predictor.predict`."""
        after = dt * np.arange(1, len(plan) + 1)
        mean = self.path(plan, dt)
        errors = self._own_errors()
        known = GRID * np.arange(1, len(errors) + 1)
        grow = np.stack([np.interp(after, known, errors[:, j]) for j in range(6)], axis=1)
        # further than was ever looked back, place and heading part at the same pace
        grow[:, :3] *= np.maximum(after / known[-1], 1.0)[:, None]
        start_cov = self.with_common_error(self.navigator.P[:6, :6])
        cov = np.repeat(start_cov[None], len(plan), axis=0)
        cov[:, range(6), range(6)] += grow**2
        start = self.navigator.n[:6].copy()
        return Prediction(self.t, start, start_cov, self.t + after, mean, cov)

    def _own_errors(self, horizon: float = 10.0) -> Array:
        """Return the root mean square errors (K, 6) of this predictor's past forecasts."""
        K, second = round(horizon / GRID), round(1.0 / GRID)
        # of whole seconds of history: what was asked before must not matter
        count = len(self._rows) // second * second
        if count == self._errors_at:
            return self._errors
        begin = max(count - round(self.memory / GRID), 0)
        rows = np.array(self._rows[begin:count]).reshape(-1, len(self._last))
        origins = np.arange(round(5.0 / GRID), len(rows) - K, second)
        if len(origins) < 5:
            U, L = self.particulars.speed, self.particulars.length
            rate = np.array([0.3 * U, 0.3 * U, 0.3 * U / L, 0.1 * U, 0.1 * U, 0.3 * U / L])
            return np.outer(np.sqrt(GRID * np.arange(1, K + 1)), rate)
        ahead = origins[:, None] + np.arange(1, K + 1)
        error = self.forecast(rows, origins, rows[ahead, 6:10]) - rows[ahead, :6]
        self._errors = np.sqrt(np.mean(np.nan_to_num(error) ** 2, axis=0))
        self._errors_at = count
        return self._errors


class Persistence(HistoryPredictor):
    """Body velocities and yaw rate of this moment, held and integrated.

    ``average`` seconds of their mean may stand in for the moment.
    """

    average = 0.0
    tuning = "none: it has no settings"

    def forecast(self, rows: Array, origins: Array, plans: Array) -> Array:
        """Return forecasts; see :meth:`HistoryPredictor.forecast`."""
        width = max(round(self.average / GRID), 1)
        sums = np.concatenate([np.zeros((1, 3)), np.cumsum(rows[:, 3:6], axis=0)])
        first = np.maximum(origins + 1 - width, 0)
        velocity = (sums[origins + 1] - sums[first]) / (origins + 1 - first)[:, None]
        return hold_velocity(rows[origins, :6], velocity, GRID * np.arange(1, plans.shape[1] + 1))


class SmoothedPersistence(Persistence):
    """The mean of the last 8 s of body velocities and yaw rate, held and integrated."""

    average = 8.0
    tuning = "none: 8 s are the study's"
