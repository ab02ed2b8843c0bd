"""DSW-UKF+: the twin that refits its model to the last minutes, and says how sure it is.

Four things work together:

1. the tight navigation filter and the joint UKF of :class:`twin.predictors.ukf.UKFPredictor`, which
   carry state and parameters from row to row, through losses of sensors as well;
2. the refit of :mod:`twin.identification.prediction_error`: every second the parameters (and their covariance) become those
   that would have foretold the last minutes best, starting from a prior with full covariance; the
   joint filter goes on from there;
3. a low-frequency observer, the model held to the navigation's velocities by a gain of 0.5 /s:
   predictions start from it, because waves are no part of the model, and what it leaves of the
   measured velocities is taken for waves (:mod:`twin.identification.wave_residual`);
4. bands from draws: of the parameters, of the start, and of the waves to come, which are those of
   the headings ahead, and move the low-frequency motion as the observer would.

Where the predicted motion leaves what the boat was ever seen to do, the parameters are drawn back
to the prior until it does not (:data:`SHRINK`).

Source: twin.md section 10 B.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.checkpoint import COUNT, Field, State, StateError, with_prefix
from twin.identification.data_weight import RIVAL_FIELDS, Rivals
from twin.identification.filter_settings import plain_settings
from twin.identification.prediction_error import (
    COLUMNS,
    GRID,
    SEGMENT_FIELDS,
    STEPS,
    RefitSettings,
    Segments,
    roll_room,
)
from twin.identification.wave_residual import (
    FACTOR,
    ORDER,
    SECTOR_SIZE,
    SECTORS,
    between,
    foretell_waves,
    simulate_waves,
)
from twin.model.dynamics import N_ACT, model_of
from twin.model.priors import population_prior
from twin.model.rollout import ROOM, roll_outs, upsample
from twin.model.structure import N_STATES
from twin.particulars import STUDY_LENGTH, STUDY_SPEED, Particulars
from twin.predictors.base import Prediction
from twin.predictors.plus_ensemble import (
    START_WAVE,
    _edges,
    _look_size,
    _mean_products,
    _past_waves,
    _roll_guarded,
    _root,
)
from twin.predictors.plus_update import (
    _HALVES,
    _HERE,
    _LAST,
    _LAST_ACT,
    _NEXT_START,
    _ORIGIN,
    _REFIT_AT,
    _RULES,
    _SECTORS,
    _SEEN,
    _SLOW,
    _WAVE_ROOM,
    _WAVE_SD,
    OBSERVER_GAIN,
    _last_row,
    book_parts,
    book_size,
    plus_step,
)
from twin.predictors.ukf import RolloutInputs, UKFPredictor
from usv_kernel.jit import py_func

__all__ = [
    "PlusPredictor",
    "refit_settings",
]

Array = NDArray[Any]

UNHURRIED = 1.5
"""Time to sail a length, in units of the study boat's, from which on segments are too alike."""

DRAWS_MIN, DRAWS_MAX = 20, 10_000
"""Fewer draws give no 5 % point; more take minutes and gigabytes."""


def refit_settings(particulars: Particulars) -> RefitSettings:
    """Return the settings of the refit, tuned for 6.336 m at 5.4 m/s, scaled by Froude.

    Times are not scaled: nobody waits ten minutes for a tanker's model. A ship that takes much
    longer to sail her length is seen for fewer lengths, by segments that are the more alike, and
    each counts the less.

    Source: twin.md section 10 B3.
    """
    L, U = particulars.length / STUDY_LENGTH, particulars.speed / STUDY_SPEED
    return RefitSettings(
        span=110.0,
        spacing=2.0,
        horizon=7.0,
        every=2,
        sd=np.array([0.175 * L, 0.175 * L, 0.04, 0.2 * U, 0.2 * U, 0.025 * U / L]),
        offset_sd=np.array([0.075 * U, 0.075 * U, 0.01 * U / L]),
        scale=0.15 * min(1.0, UNHURRIED / particulars.time_scale),
        knee=0.015,
    )


class PlusPredictor(UKFPredictor):
    """DSW-UKF+; see the head of this file.

    Parameters
    ----------
    particulars : Particulars
        The boat.
    model : str
        One of ``twin.model.structure.MODELS``.
    prior : tuple of ndarray, optional
        Mean (p,) and covariance (p, p) of the parameters; those of like boats if left out.
    settings : RefitSettings, optional
        :func:`refit_settings` if left out.
    period : float
        Time between refits, s.
    renewed : int
        Segments that a refit linearises anew, besides the new one.
    draws : int
        Paths that the bands are made of.
    seed : int
        Of the draws.
    """

    tuning = "about 290 configurations on 4 to 96 tuning seeds, 20 of the navigation"

    def __init__(
        self,
        particulars: Particulars,
        *,
        model: str = "mmg",
        prior: tuple[Array, Array] | None = None,
        settings: RefitSettings | None = None,
        period: float = 1.0,
        renewed: int = 8,
        draws: int = 100,
        seed: int = 0,
    ) -> None:
        sound = math.isfinite(period) and period > 0.0 and renewed >= 0
        if not (sound and DRAWS_MIN <= draws <= DRAWS_MAX):
            raise ValueError(
                f"period = {period}, renewed = {renewed}, draws = {draws}: must be above 0 s, 0 or "
                f"more, and {DRAWS_MIN} to {DRAWS_MAX}"
            )
        structure = model_of(particulars, model, biased=True)
        mean, cov = prior or population_prior(structure, particulars)
        p = len(structure)
        if np.shape(mean) != (p,) or np.shape(cov) != (p, p):
            raise ValueError(
                f"prior has shapes {np.shape(mean)} and {np.shape(cov)}; the structure {model!r} "
                f"has {p} parameters: ({p},) and ({p}, {p})"
            )
        filters = dataclasses.replace(
            plain_settings(particulars, model),
            structure=structure,
            q_xi=np.zeros(p),
            xi0=mean,
            xi0_cov=cov,
        )
        self.refit = settings or refit_settings(particulars)
        self.period, self.renewed = period, renewed
        self.spacing = round(self.refit.spacing / GRID)
        capacity = math.ceil(self.refit.span / self.refit.spacing)
        steps, span = round(self.refit.horizon / GRID), round(self.refit.span / GRID)
        self.rows = np.zeros((span + steps + 2 * self.spacing, COLUMNS))
        self.book = np.zeros(book_size(p, capacity, steps, self.spacing))
        # as long as the rules will be, so that the book can be opened
        rules = np.array([period, renewed, self.spacing, span, *np.zeros(STEPS), steps])
        self.track, record, window = py_func(book_parts)(self.book, rules, p)
        self._seen, self._wave_sd = self.track[_SEEN:_WAVE_SD], self.track[_WAVE_SD:_HERE]
        self._here = self.track[_HERE:_SECTORS].reshape(ORDER, 3)
        self._sectors = self.track[_SECTORS:].reshape(SECTORS, SECTOR_SIZE)
        self.segments = Segments(structure.kit, mean, cov, self.refit, capacity, window)
        if len(self.segments.room) < roll_room(p) + _WAVE_ROOM:
            self.segments.room = np.zeros(roll_room(p) + _WAVE_ROOM)
        self.rules = np.concatenate([rules[:_RULES], self.segments.rules])
        self.rivals = Rivals(self.segments, self.spacing, record)
        rng = np.random.default_rng(seed)
        self._theta_shocks = rng.standard_normal((draws, p))
        self._start_shocks = rng.standard_normal((draws, N_STATES))
        # the first path is the mean
        self._wave_shocks = rng.standard_normal((draws + 1, round(10.0 / GRID), 3))
        self._wave_shocks[0] = 0.0
        self._room = np.empty(ROOM * (draws + 1))
        U = particulars.speed
        self._usual = np.array([1.5 * U, 0.8 * U, 1.2 * U / particulars.length])
        """Velocities that any boat may be foretold to have; once seen, half as much again."""
        super().__init__(particulars, settings=filters, seed=seed)
        self._plus_arguments = (
            *(*self._arguments, self.rows, self.book, self.rules),
            self.segments.room,
        )
        self._look = (
            *(self._usual, np.zeros(_look_size(p))),
            (self._theta_shocks, self._start_shocks, self._wave_shocks),
        )

    def reset(self) -> None:
        """Forget everything."""
        super().reset()
        self.rows[:] = 0.0
        self.track[:] = 0.0
        self.segments.reset()
        self.rivals.reset()
        self.track[_REFIT_AT] = -math.inf
        # until the waves have been seen: as high as a refit takes them to be, and without memory
        self._wave_sd[:] = self._sectors[:, FACTOR::4] = self.refit.sd[3:]

    def views(self) -> dict[str, Array]:
        """See :meth:`ModelPredictor.views`."""
        track = self.track
        window = {
            **{"origin": track[_ORIGIN:_HALVES], "half_steps": track[_HALVES:_LAST]},
            **{"last_state": track[_LAST:_LAST_ACT], "last_actuators": track[_LAST_ACT:_SLOW]},
            **{"slow_velocity": track[_SLOW:_NEXT_START]},
            **{"next_start": track[_NEXT_START:_REFIT_AT], "refit_at": track[_REFIT_AT:_SEEN]},
            **{"largest_velocity": self._seen, "rows": self.rows},
        }
        waves = {"sd": self._wave_sd, "forecast_model": self._here, "sectors": self._sectors}
        return {
            **super().views(),
            **with_prefix("window", window),
            **with_prefix("waves", waves),
            **with_prefix("segments", self.segments.views()),
            **with_prefix("trust", self.rivals.views()),
        }

    def fields(self) -> dict[str, Field]:
        """See :meth:`ModelPredictor.fields`."""
        return {
            **super().fields(),
            **{"window.half_steps": COUNT, "window.next_start": COUNT},
            "window.refit_at": Field(infinite=True),
            **with_prefix("segments", SEGMENT_FIELDS),
            **with_prefix("trust", RIVAL_FIELDS),
        }

    def load_state_dict(self, state: State) -> None:
        """Take over a saved state; see :meth:`Predictor.load_state_dict`."""
        super().load_state_dict(state)
        # rows are written up to the time, one by one
        newest = float(self.track[_ORIGIN] + 0.5 * GRID * self.track[_HALVES])
        if self.ready and not abs(newest - self.t) <= GRID + 1e-6:
            raise StateError(
                f"field 'window.half_steps' ends at {newest} s, and t = {self.t}; use an earlier "
                "copy of the file"
            )

    @property
    def remembered(self) -> tuple[Array, ...]:
        """All that the predictor remembers; see :attr:`UKFPredictor.remembered`."""
        return *super().remembered, self.rows, self.book

    @property
    def shared(self) -> tuple[Any, ...]:
        """What twins of like boats can share: for the rows, then for looking ahead."""
        return *super().shared, self.rules, self.segments.room, *self._look

    def rollout_inputs(self, *remembered: Array) -> RolloutInputs:
        """See :meth:`UKFPredictor.rollout_inputs`; without the share of the waves."""
        nav, _, _, book = remembered
        return (
            super()
            .rollout_inputs(*remembered)
            ._replace(
                places=nav[:, :3],
                velocities=book[:, _SLOW:_NEXT_START],
                seen=book[:, _SEEN:_WAVE_SD],
                usual=self._usual,
                prior=self.segments.prior,
            )
        )

    @property
    def _next_start(self) -> int:
        return int(self.track[_NEXT_START])

    @property
    def _refit_at(self) -> float:
        return float(self.track[_REFIT_AT])

    @property
    def last_row(self) -> int:
        """Number of the newest complete row of the window; -1 if there is none."""
        return int(_last_row(self.track))

    @property
    def window_s(self) -> float:
        """See :attr:`twin.predictors.base.Predictor.window_s`."""
        return min(max(self.last_row, 0) * GRID, self.refit.span)

    def update(self, t: float, dt: float, z: Array, cmd: Array) -> None:
        """Take one row; see :meth:`twin.predictors.base.Predictor.update`."""
        self.t = t
        plus_step(t, dt, z, cmd, *self._plus_arguments)

    def _window(self, first: int, last: int) -> Array:
        """Return rows first to last, the last included, as an array of their own."""
        return self.rows[np.arange(first, last + 1) % len(self.rows)]

    def _start(self) -> Array:
        start = self.n[:N_STATES].copy()
        start[3:] = self.track[_SLOW:_NEXT_START]
        return start

    def _past(self) -> Array:
        w = np.empty((ORDER, 3))
        _past_waves(self.n, self.rows, self.track, w)
        return w

    def _guarded(self, plan: Array, dt: float, ripple: Array) -> tuple[Array, Array]:
        """Return parameters that keep the motion within bounds, and the motion."""
        ukf, theta = self.ukf, np.empty(len(self.segments.prior))
        scaled, out, acts = (
            np.empty_like(plan),
            np.empty((len(plan), N_STATES)),
            np.empty_like(plan),
        )
        _roll_guarded(
            *(plan, dt, self.n, self._usual, ripple, self.track, self.rules),
            *(ukf.memory, ukf.constants, ukf.kit, scaled, theta, out, acts, self._room),
        )
        return theta, out

    def _told(self, after: Array) -> tuple[Array, Array]:
        """Return the waves foretold (1, K, 3) at times (K,), and on average between them."""
        path = np.empty((1, math.ceil(after[-1] / GRID - 1e-9) + 1, 3))
        foretell_waves(self._past(), self._here, path[0])
        ends, means = np.empty((2, 1, len(after), 3))
        between(path, GRID, after, ends, means)
        return ends, means

    def _drawn(self, after: Array, psi: Array) -> tuple[Array, Array]:
        """Return the waves (D, K, 3) of the draws, without those foretold, as :meth:`_told` does.

        Parameters
        ----------
        after : ndarray, shape (K,)
            Times after now, s, from the first step on.
        psi : ndarray
            Headings on the way, every :data:`GRID` seconds, rad.
        """
        shocks = self._wave_shocks
        times = math.ceil(len(psi) / shocks.shape[1])  # used again where they do not reach
        shocks = np.concatenate([shocks] * times, axis=1)[:, : len(psi)] if times > 1 else shocks
        path = np.zeros((len(shocks), len(psi) + 1, 3))
        simulate_waves(self._sectors, psi, shocks, path[:, 1:])
        ends, means = np.empty((2, len(shocks), len(after), 3))
        between(path, GRID, after, ends, means)
        return ends, means

    def _way(self, mean: Array, dt: float, span: float) -> Array:
        """Return headings every :data:`GRID` seconds on the way (K, 6) foretold."""
        after = GRID * np.arange(1, math.ceil(span / GRID - 1e-9) + 1)
        way: Array = np.interp(after, dt * np.arange(len(mean) + 1), [self.n[2], *mean[:, 2]])
        return way

    def _central(self, plan: Array, dt: float) -> tuple[Array, Array]:
        """Return the parameters in use and the states (K, 6) most to be expected."""
        ends, ripple = self._told(dt * np.arange(1, len(plan) + 1))
        theta, out = self._guarded(plan, dt, ripple[0])
        out[:, 3:] += ends[0]
        return theta, out

    def mean(self, plan: Array, dt: float) -> Array:
        """Return the predicted states alone; see :meth:`twin.predictors.base.Predictor.mean`."""
        return self._central(plan, dt)[1]

    def predict(self, plan: Array, dt: float) -> Prediction:
        """Predict the motion under a plan; see :meth:`twin.predictors.base.Predictor.predict`."""
        theta, mean = self._central(plan, dt)
        # the draws are rolled at coarse steps: only how far they part is used
        every = max(1, min(round(GRID / dt), len(plan)))
        K = math.ceil(len(plan) / every)
        h = dt * every
        after = h * np.arange(1, K + 1)
        coarse = plan[np.minimum(np.arange(K) * every + every // 2, len(plan) - 1)]
        unit = self.ukf.settings.n_unit
        coarse = coarse * [unit, unit, 1.0, 1.0]
        D = len(self._theta_shocks)
        thetas, starts = np.empty((D + 1, len(theta))), np.empty((D + 1, N_STATES))
        thetas[0], starts[0] = theta, self._start()
        cov = self.ukf.P[N_STATES:, N_STATES:]
        thetas[1:] = theta + self._theta_shocks @ _root(cov).T
        P = self.P_nav[:N_STATES, :N_STATES].copy()
        P[range(3, 6), range(3, 6)] += (START_WAVE * self._wave_sd) ** 2
        shocks = self._start_shocks @ _root(P).T
        starts[1:] = starts[0] + shocks
        starts[1:, :2] = starts[0, :2]
        ends, ripples = self._drawn(after, self._way(mean, dt, after[-1]))
        ripples += self._told(after)[1]
        out, acts = np.empty((D + 1, K, N_STATES)), np.empty((K, N_ACT))
        ukf = self.ukf
        roll_outs(
            *(starts, thetas, ukf.act, coarse, h, ukf.lags, ukf.envelope, ukf.wind, ukf.kit),
            *(ripples, OBSERVER_GAIN, out, acts, self._room),
        )
        out[..., 3:] += ends
        away = np.concatenate([np.zeros((D, 1, N_STATES)), out[1:] - out[0]], axis=1)
        away[:, 0, 2:] = shocks[:, 2:]
        start_cov = self.with_common_error(np.zeros((N_STATES, N_STATES)))
        covs = np.empty((K + 1, N_STATES, N_STATES))
        _mean_products(away, covs)
        covs[:, :2, :2] += start_cov[:2, :2]
        # where the position is now is as unsure as where it goes, and of another cause
        away[:, :, :2] += (self._start_shocks[:, :2] @ _root(start_cov[:2, :2]).T)[:, None]
        edges = _edges(away)
        low_edge, high_edge = (upsample(edge, every, len(plan)) for edge in edges)
        return Prediction(
            self.t,
            starts[0].copy(),
            start_cov,
            self.t + dt * np.arange(1, len(plan) + 1),
            mean,
            upsample(covs, every, len(plan)),
            low=mean + low_edge,
            high=mean + high_edge,
        )
