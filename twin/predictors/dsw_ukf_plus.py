"""DSW-UKF+: the twin that refits its model to the last minutes, and says how sure it is.

A navigation filter and a joint UKF carry state and parameters from row to row, as in
:class:`twin.predictors.ukf.UKFPredictor`. Each second the parameters are also refitted to what
would have predicted the last minutes best, from a prior with full covariance, for several weights
of the data and after changes of thrust or current; of refits, joint filter and prior those
parameters are used whose earlier forecasts were best. A forecast begins at a low-frequency
observer, the model held to the navigation's velocities, and what that leaves of them is waves, an
autoregression that is predicted for the next seconds. Its intervals come from draws of parameters,
start and waves, and shrink where the last forecasts erred less than parameters and start claim.

Source: docs/explanation/twin.md, The refit; Waves and prediction intervals; Constants.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.filters.linalg import cholesky
from twin.identification.data_weight import DataWeightSelector
from twin.identification.filter_settings import FilterSettings, plain_settings
from twin.identification.identifiability import Identifiability
from twin.identification.joint_ukf import JointUKF
from twin.identification.prediction_error import COLUMNS, FIRST, GOOD, NONE, RefitSettings
from twin.identification.segments import Segments
from twin.identification.wave_residual import FACTOR
from twin.identification.window import WINDOW
from twin.model.dynamics import model_of
from twin.model.priors import boat_or, population_prior
from twin.model.rollout import GRID, upsample
from twin.model.structure import N_STATES
from twin.particulars import STUDY_LENGTH_M, STUDY_SPEED_MPS, Particulars
from twin.predictors.base import ParametersInUse, Prediction, plain
from twin.predictors.forecast import (
    Draws,
    Forecast,
    ForecastConfig,
    Sources,
    coarse_plan,
    draw_ahead,
    draws_of,
    forecast_of,
    interval_edges,
    mean_ahead,
    mean_products,
    opened,
    steps_of_waves,
)
from twin.predictors.plus_update import (
    SEGMENTS_MIN,
    UNFIT,
    WAVE_WORK,
    PlusConfig,
    PlusMemory,
    PlusWork,
    update_plus,
)
from twin.predictors.ukf import RolloutInputs, UKFPredictor
from usv_kernel.errors import UsvTwinError

__all__ = [
    "PlusPredictor",
    "refit_settings",
]

Array = NDArray[Any]

CORRELATED_TIME_SCALE = 1.5
"""Time scale, in units of the study boat's, above which correlated segments count less."""

DRAWS_MIN = 20
DRAWS_MAX = 10_000
"""Fewer draws give no 5 % point; more take minutes and gigabytes."""


def refit_settings(particulars: Particulars) -> RefitSettings:
    """Return the settings of the refit, tuned for 6.336 m at 5.4 m/s, scaled by Froude.

    Times are not scaled: ten minutes are too long to wait for a tanker's model. A ship that takes
    much longer to sail its length is seen for fewer lengths, by segments that are more correlated,
    and each counts less.

    Source: docs/explanation/twin.md, The refit.
    """
    L, U = particulars.length / STUDY_LENGTH_M, particulars.speed / STUDY_SPEED_MPS
    return RefitSettings(
        span=110.0,
        spacing=2.0,
        horizon=7.0,
        every=2,
        sd=np.array([0.175 * L, 0.175 * L, 0.04, 0.2 * U, 0.2 * U, 0.025 * U / L]),
        offset_sd=np.array([0.075 * U, 0.075 * U, 0.01 * U / L]),
        scale=0.15 * min(1.0, CORRELATED_TIME_SCALE / particulars.time_scale),
        knee=0.1,
    )


def joint_candidate(particulars: Particulars) -> int:
    """Return how the refit uses the joint filter's parameters: NONE or FIRST.

    What disturbs some boats adds up in their motion, as gusts and model errors do. There the joint
    filter's process noise is the right likelihood. So it is for ships in tanks and on ponds, and
    for boats of which no population says how they move: a refit that trusts their prior has
    learned little of thrust, drag and current when the GPS is lost. A fast boat at sea is moved to
    and fro by its waves, and the refit, which allows for them, is better.
    """
    return FIRST if particulars.tanker or particulars.steering == "differential" else NONE


def joint_settings(filters: FilterSettings, particulars: Particulars) -> FilterSettings:
    """Return the settings of the joint filter: those of ``ukf``, with the parameters at hand."""
    own = plain_settings(particulars)
    return own if own.structure.parameters == filters.structure.parameters else filters


class PlusPredictor(UKFPredictor):
    """DSW-UKF+; see the head of this file.

    Parameters
    ----------
    particulars : Particulars
        The boat.
    model : str
        One of ``twin.model.structure.MODELS``.
    prior : tuple of ndarray, optional
        Mean (p,) and covariance (p, p) of the parameters; those of the boat's own prior or of
        like boats if left out.
    settings : RefitSettings, optional
        :func:`refit_settings` if left out.
    period : float
        Time between refits, s.
    relinearised : int
        Segments that a refit relinearises, besides the new one.
    draws : int
        Paths that the prediction intervals are made of.
    seed : int
        Of the draws.
    """

    tuning = "about 290 configurations on 4 to 96 tuning seeds, 20 of the navigation"
    is_compiled = True

    def __init__(
        self,
        particulars: Particulars,
        *,
        model: str = "mmg",
        prior: tuple[Array, Array] | None = None,
        settings: RefitSettings | None = None,
        period: float = 1.0,
        relinearised: int = 8,
        draws: int = 100,
        seed: int = 0,
    ) -> None:
        enough = relinearised >= 0 and DRAWS_MIN <= draws <= DRAWS_MAX
        if not (math.isfinite(period) and period > 0.0 and enough):
            raise UsvTwinError(
                f"period = {period}, relinearised = {relinearised}, draws = {draws}: must be "
                f"above 0 s, 0 or more, and {DRAWS_MIN} to {DRAWS_MAX}"
            )
        structure = model_of(particulars, model, biased=True, current=True)
        own = prior or boat_or(population_prior(structure, particulars), structure, particulars)
        mean, cov = map(np.asarray, own)
        p = len(structure)
        if np.shape(mean) != (p,) or np.shape(cov) != (p, p):
            raise UsvTwinError(
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
        self.joint = JointUKF(particulars, joint_settings(filters, particulars))
        self.refit = settings or refit_settings(particulars)
        self.period, self.relinearised = period, relinearised
        self.spacing = round(self.refit.spacing / GRID)
        capacity = math.ceil(self.refit.span / self.refit.spacing)
        steps, span = round(self.refit.horizon / GRID), round(self.refit.span / GRID)
        self.rows = np.zeros((span + steps + 2 * self.spacing, COLUMNS))
        schedule = period, relinearised, self.spacing, span, float(joint_candidate(particulars))
        self.segments = Segments(structure.terms, mean, cov, self.refit, capacity, schedule)
        self.selector = DataWeightSelector(self.segments)
        self._window = np.zeros(WINDOW.itemsize // 8)
        rng = np.random.default_rng(seed)
        # of parameters, starts and waves; the first path of the waves is the mean
        self.normal = (
            rng.standard_normal((draws, p)),
            rng.standard_normal((draws, N_STATES)),
            rng.standard_normal((draws + 1, round(10.0 / GRID), 3)),
        )
        self.normal[2][0] = 0.0
        super().__init__(particulars, settings=filters, seed=seed)
        segments, (nav, tight) = self.segments, self.memory
        self.sources = Sources(tight, nav, self.rows, self._window)
        refits = self.selector.memory, segments.memory, self.joint.memory
        self.memory = PlusMemory(nav, tight, self.rows, self._window, *refits)
        nav, tight, model = self.config
        self.config = PlusConfig(nav, tight, model, segments.values, self.joint.constants)
        nav, tight = self.work
        scratch = segments.line, segments.scratch, segments.changes
        self.work = PlusWork(nav, tight, *scratch, np.zeros(WAVE_WORK), segments.spread)
        self._plain = plain(self.memory), plain(self.config), plain(self.work)
        self.boat = ForecastConfig(self.ukf.constants, self.ukf.terms, segments.values)

    def reset(self) -> None:
        """Forget everything."""
        super().reset()
        self.rows[:] = 0.0
        self._window[:] = 0.0
        window = self.window
        self.segments.reset()
        self.selector.reset()
        self.joint.reset()
        window["refit_at"] = -math.inf
        # until waves have been measured: as high as the refit assumes, and white
        window["wave_sd"][:] = window["sectors"][:, FACTOR::4] = self.refit.sd[3:]

    @property
    def dtypes(self) -> dict[str, np.dtype[Any]]:
        """See :attr:`UKFPredictor.dtypes`; the rows have the columns of the window."""
        return {
            **super().dtypes,
            "window": WINDOW,
            "selector": self.selector.dtype,
            "segments": self.segments.dtype,
            "joint": self.joint.dtype,
        }

    def rollout_inputs(self, memory: Any) -> RolloutInputs:
        """See :meth:`UKFPredictor.rollout_inputs`; without the share of the waves."""
        window = memory.window.view(WINDOW)[:, 0]
        return (
            super()
            .rollout_inputs(memory)
            ._replace(
                places=memory.nav[:, :3],
                velocities=window["slow"],
            )
        )

    @property
    def window(self) -> Any:
        """Observer, window and waves by name, see :data:`WINDOW`; a record on the memory."""
        return self._window.view(WINDOW)[0]

    @property
    def last_row(self) -> int:
        """Number of the newest complete row of the window; -1 if there is none."""
        return int(self.window["halves"]) // 2 - 1

    def parameters_in_use(self) -> ParametersInUse:
        """See :meth:`twin.predictors.base.Predictor.parameters_in_use`."""
        own = self.selector
        name = own.name if own.refitted else self._lacking()
        return ParametersInUse(name, own.uses_prior, own.best_refit())

    def _lacking(self) -> str:
        """Return what is missing for a first refit, and how much of it there is."""
        good = self.rows[: self.last_row + 1, GOOD]
        lost = GRID * np.bincount(-np.minimum(good, 0.0).astype(int), good <= 0.0, len(UNFIT))
        return (
            f"the prior, as a refit needs {SEGMENTS_MIN} usable stretches of {self.refit.horizon:g}"
            f" s, {self.refit.spacing:g} s apart, and has {(self.segments.first >= 0).sum()}: of "
            f"the last {GRID * len(good):g} s, {GRID * (good > 0.0).sum():g} s are usable"
        ) + "".join(f"; {UNFIT[k]}: {lost[k]:g} s" for k in np.flatnonzero(lost))

    def identifiability(self) -> Identifiability:
        """Return the identifiability of the parameters; none is informed under the prior."""
        seen = super().identifiability()
        if not self.selector.uses_prior:
            return seen
        parts = (
            tuple(dataclasses.replace(item, informed=False) for item in items)
            for items in (seen.parameters, seen.sums)
        )
        return Identifiability(seen.seconds, seen.submodels, *parts)

    def update(self, t: float, dt: float, z: Array, cmd: Array) -> None:
        """Take one row; see :meth:`twin.predictors.base.Predictor.update`."""
        self.t = t
        update_plus(t, dt, z, cmd, *self._plain)

    def _draws(self, central: Forecast, plan: Array, dt: float) -> tuple[Draws, int]:
        """Return draws around a mean forecast, and how many rows of the plan are one of theirs."""
        # they are rolled out in coarse steps: only their spread is used
        coarse, every = coarse_plan(plan, dt)
        K, h, p, D = len(coarse), dt * every, len(self.segments.prior), len(self.normal[0])
        N = steps_of_waves(K * h)
        own = central
        if every > 1:
            own = opened(forecast_of, p, K, N)
            mean_ahead(coarse, h, self.sources, self.boat, own)
        out: Draws = opened(draws_of, p, K, N, D)
        draw_ahead((central, own), dt, self.sources, self.boat, self.normal, out)
        return out, every

    def predict(self, plan: Array, dt: float) -> Prediction:
        """Predict the motion under a plan; see :meth:`twin.predictors.base.Predictor.predict`."""
        central = self._mean_forecast(plan, dt)
        mean, (out, every) = central.states[0], self._draws(central, plan, dt)
        K = out.act.shape[0]
        covs = np.empty((K + 1, N_STATES, N_STATES))
        mean_products(out.deviations, np.arange(K + 1), covs)
        start_cov = self.with_common_error(np.zeros((N_STATES, N_STATES)))
        covs[:, :2, :2] += start_cov[:2, :2]
        # the error of the present position is independent of that of the displacement
        out.deviations[:, :, :2] += (self.normal[1][:, :2] @ _root(start_cov[:2, :2]).T)[:, None]
        low, high = (upsample(edge, every, len(plan)) for edge in interval_edges(out.deviations))
        return Prediction(
            self.t,
            central.start[0].copy(),
            start_cov,
            self.t + dt * np.arange(1, len(plan) + 1),
            mean.copy(),
            upsample(covs, every, len(plan)),
            low=mean + low,
            high=mean + high,
        )


def _root(cov: Array) -> Array:
    """Return a square root of a covariance, also of one that is only semi-definite."""
    root = np.zeros_like(cov)
    cholesky(np.ascontiguousarray(cov), root, np.empty((1, len(cov))))
    return root.T
