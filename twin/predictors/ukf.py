"""The twin's model in the structured UKF, and the plain predictor built on it.

:class:`twin.identification.joint_ukf.JointUKF` holds state and parameters, follows the actuators
from the commands, and forecasts. :class:`ModelPredictor` makes a predictor of it.
:class:`UKFPredictor` updates it from the tight navigation filter, in one compiled call a row.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.channels import PSI, WIND_FROM, WIND_SPEED, R, U, V, X, Y
from twin.checkpoint import State, check_fields, fill, record_views, with_prefix
from twin.filters.navigation_ekf import (
    is_learning_suspended,
    is_ready,
    lacks_gps,
    lacks_imu,
    navigate,
)
from twin.filters.navigation_state import (
    IS_MODELLED,
    MODEL_VARIANCES,
    NAVIGATION,
    NAVIGATION_SETTINGS,
    NAVIGATION_WORK,
    WIND_LIMIT,
    initial_navigation,
    navigation_settings,
)
from twin.filters.ukf import measurement_update
from twin.identification.filter_settings import STUDY_STEP_S, FilterSettings, plain_settings
from twin.identification.identifiability import Identifiability, assess
from twin.identification.joint_ukf import (
    DOUBTED_VELOCITY_SD,
    STEP_MAX_S,
    JointUKF,
    accumulate_information,
    advance,
    clip_velocities,
    filter_config,
    filter_state,
    filter_workspace,
    information_is_due,
    scale_plan,
)
from twin.identification.physical_bounds import keep_physical
from twin.model.actuators import follow_all
from twin.model.dynamics import current_terms, drive, rates_over_ground
from twin.model.rollout import upsample
from twin.model.structure import CURRENT, N_STATES, ModelTerms, current_of
from twin.particulars import Particulars
from twin.predictors.base import Estimate, Prediction, Predictor, plain
from twin.predictors.forecast import (
    Forecast,
    ForecastConfig,
    Sources,
    coarse_plan,
    covariance_ahead,
    forecast_of,
    limit_covariances,
    mean_ahead,
    opened,
    steps_of_waves,
)
from twin.predictors.model_aid import aid_by_model
from twin.predictors.without_gps import try_open_loop, widen_without_gps
from usv_kernel.channels import ACCEL_X
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import as_record, field_at
from usv_kernel.scalar import wrap

__all__ = [
    "ModelPredictor",
    "RolloutInputs",
    "UKFConfig",
    "UKFMemory",
    "UKFPredictor",
    "UKFWork",
    "tight_step",
]

Array = NDArray[Any]

OUTAGE_NOISE_FACTOR = 400.0
"""Factor of the velocity's measurement noise without GPS, as its errors last from row to row."""

RESTART_AFTER = 4.0
"""Time without GPS, in lengths over nominal speed, after which the first fix re-initialises the
state. Parameters are kept."""

DIVERGENCE_GATE = 10.0
"""Deviation from the navigation, in standard deviations, above which the state is re-initialised.
Parameters are kept."""

LASTING_VELOCITY_SD = 0.25
"""Standard deviation, in nominal speeds, of a velocity error with a correlation time of L/U, to
which the variance is proportional."""

SEEN_SD = 0.25
"""Largest standard deviation, in nominal speeds, of a velocity that updates the fastest one."""


_BEGUN = field_at(NAVIGATION, "begun")
_LOST = field_at(NAVIGATION, "lost")


class UKFMemory(NamedTuple):
    """What a predictor remembers, flat; in a batch each row is a boat's."""

    nav: Any  # see NAVIGATION
    filter: Any  # see FilterState


class UKFConfig(NamedTuple):
    """What a predictor is given of its boat."""

    nav: Any  # see NAVIGATION_SETTINGS
    filter: Any  # see FilterConfig
    model: Any  # ModelTerms


class UKFWork(NamedTuple):
    """Scratch, which predictors of like boats can share."""

    nav: Any  # see NAVIGATION_WORK
    filter: Any  # see FilterWorkspace


@inlined
def _accelerations(dt, z, nav, state, given, model, scratch):
    """Write the model's accelerations and their variances, for the navigation."""
    x, act, envelope = state.x, state.act, given.envelope
    terms, accel = scratch.terms, scratch.accel
    for k in range(accel.shape[0]):
        accel[k] = 0.0
    if nav.begun == 0.0:
        return
    drive(act, terms)
    motion = x[U], x[V], x[R], math.cos(x[PSI]), math.sin(x[PSI])
    current = current_of(x, N_STATES, model.hull)
    du, dv, dr = rates_over_ground(motion, state.wind, current, x, N_STATES, model, terms)
    held = not math.isfinite(z[ACCEL_X]) and not lacks_gps(nav)
    due = information_is_due(dt, state) and not is_learning_suspended(nav)
    if held or due:
        current_terms(motion, state.wind, x, N_STATES, model, terms)
    if due:
        accumulate_information(terms, state, model)
    turn, speed = envelope[2], 0.25 * envelope[0]
    accel[0] = min(max(du, -speed * turn), speed * turn)
    accel[1] = min(max(dv, -speed * turn), speed * turn)
    accel[2] = min(max(dr, -turn * turn), turn * turn)
    # a model never fitted to a measured motion may make the navigation diverge in yaw
    accel[IS_MODELLED] = nav.has_imu
    if not held:
        # accelerometers say more; and without GPS nothing says more than the model
        return
    for i in range(3):
        low, high = model.limits[3 + i, 0], model.limits[3 + i, 1]
        term = model.which[i, low - N_STATES : high - N_STATES]
        for j in range(low, high):
            row = 0.0
            for k in range(low, high):
                row += state.P[j, k] * terms[term[k - low]]
            accel[MODEL_VARIANCES + i] += terms[term[j - low]] * row


@inlined
def start_filter(cmd, nav, state, given):
    """Put the filter where the navigation begins, once it does."""
    act = state.act
    for k in range(2):
        act[k], act[2 + k] = given.n_unit * cmd[k], cmd[2 + k]
    if is_ready(nav):
        for i in range(N_STATES):
            state.x[i], state.P[i, i] = nav.n[i], given.p0[i]


@inlined
def has_diverged(outage, nav, state, given):
    """Return whether the state must restart; ``outage`` is the time without fixes, s."""
    x, P, n, P_nav = state.x, state.P, nav.n, nav.P
    # a rollout over such a gap is far from linear in the parameters: its errors would corrupt them
    diverged = outage > RESTART_AFTER * 4.0 / given.envelope[2] and nav.gps_age == 0.0
    diverged = diverged or nav.commands_doubted > 0.0 or nav.restarted > 0.0
    for i in range(N_STATES):
        error = n[i] - x[i]
        if i == PSI:
            error = wrap(error)
        waves = state.wave_power[i - PSI - 1] if i > PSI else 0.0
        variance = P[i, i] + P_nav[i, i] + given.r[i] + waves
        diverged = diverged or error * error > DIVERGENCE_GATE**2 * variance
    return diverged


@inlined
def restart_state(dt, cmd, nav, state, given):
    """Take the navigation's state; the parameters stay."""
    x, P = state.x, state.P
    for i in range(N_STATES):
        for k in range(x.shape[0]):
            P[i, k] = P[k, i] = 0.0
        x[i], P[i, i] = nav.n[i], given.p0[i] + nav.P[i, i]
    if nav.commands_doubted > 0.0:
        # nobody knows what the drives do
        for k in range(3):
            P[U + k, U + k] += (DOUBTED_VELOCITY_SD * given.envelope[k]) ** 2
    follow_all(state.act, cmd, given.lags, given.n_unit, dt)


@inlined
def correct(dt, cmd, nav, state, given, model, scratch):
    """Predict a row, and correct state and parameters by the navigation."""
    x, P, n, P_nav, wave_power = state.x, state.P, nav.n, nav.P, state.wave_power
    envelope, noise, mask = given.envelope, scratch.R, scratch.mask
    advance(dt, cmd, state, given, scratch)
    if nav.motion_doubted + nav.unsettled > 0.0:
        # parameters without correlation to the state learn nothing of it
        for i in range(N_STATES):
            for k in range(N_STATES, x.shape[0]):
                P[i, k] = P[k, i] = 0.0
    row = max(dt, 1e-3)
    for i in range(N_STATES):
        noise[i, i] = STUDY_STEP_S * given.r[i] / row + P_nav[i, i]
        mask[i] = 1.0
    # an error of a velocity lasts from row to row until fixes tell: longer, the larger it is
    time = 4.0 / envelope[2]
    for i in range(U, R):
        share = P_nav[i, i] / (LASTING_VELOCITY_SD * 0.25 * envelope[0]) ** 2
        noise[i, i] += max(min(share, 1.0) * time / row - 1.0, 0.0) * P_nav[i, i]
    no_gps, no_imu = lacks_gps(nav), lacks_imu(nav)
    if no_gps:
        # the navigation's velocities are then in part the model's own
        mask[X] = mask[Y] = 0.0
        noise[U, U] *= OUTAGE_NOISE_FACTOR
        noise[V, V] *= OUTAGE_NOISE_FACTOR
    if no_imu:
        mask[R] = 0.0
    if given.wave_time > 0.0:
        for k in range(3):
            i = PSI + 1 + k
            # held while the sensor that would measure them is gone
            if not (no_imu if k == 2 else no_gps):
                # a diverged prediction is no wave: no wave moves the boat faster than it sails
                error = min(abs(n[i] - x[i]), 0.25 * envelope[k])
                more = error * error - P[i, i] - noise[i, i]
                share = min(min(row, STEP_MAX_S) / given.wave_time, 1.0)
                wave_power[k] = max(wave_power[k] + share * (more - wave_power[k]), 0.0)
            noise[i, i] += given.wave_noise * wave_power[k] / row
    water = current_of(x, N_STATES, model.hull)
    measurement_update(x, P, n[:N_STATES], mask, noise, PSI, math.inf, scratch.sigma)
    keep_physical(x, P, given.bounds, scratch.ahead[0])
    if no_gps and model.hull[CURRENT] >= 0.0:
        at = N_STATES + int(model.hull[CURRENT])
        x[at], x[at + 1] = water
    clip_velocities(x, envelope)
    if not no_gps and P_nav[U, U] + P_nav[V, V] < 2.0 * (SEEN_SD * 0.25 * envelope[0]) ** 2:
        for k in range(3):
            state.fastest[k] = max(state.fastest[k], abs(n[U + k]))


@inlined
def place_by_navigation(nav, state):
    """Take the place from the navigation, where no fix corrects the filter's own."""
    x, P = state.x, state.P
    for i in range(2):
        spread = P[i, i]
        for k in range(x.shape[0]):
            P[i, k] = P[k, i] = 0.0
        x[i], P[i, i] = nav.n[i], spread


@kernel
def tight_step(dt, z, cmd, memory, config, work):
    """Navigate, predict, correct by one row: :meth:`twin.predictors.base.Predictor.update`."""
    nav, nav_work = as_record(memory.nav, NAVIGATION), as_record(work.nav, NAVIGATION_WORK)
    model = config.model
    state, given = filter_state(memory.filter, model), filter_config(config.filter, model)
    scratch, x = filter_workspace(work.filter, model.which.shape[1]), state.x
    update_wind(z, state.wind)
    _accelerations(dt, z, nav, state, given, model, scratch)
    outage = nav.gps_age + dt
    settings = as_record(config.nav, NAVIGATION_SETTINGS)
    navigate(nav, dt, z, scratch.accel, settings, nav_work)
    if nav.begun == 0.0:
        start_filter(cmd, nav, state, given)
        nav.begun = 1.0 if is_ready(nav) else 0.0
        return
    if nav.imu_age == 0.0:
        nav.has_imu = 1.0
    if has_diverged(outage, nav, state, given):
        restart_state(dt, cmd, nav, state, given)
        return
    correct(dt, cmd, nav, state, given, model, scratch)
    no_gps = lacks_gps(nav)
    try_open_loop(dt, nav, state, given, model, scratch.terms)
    widen_without_gps(dt, nav, state, given, model)
    aid_by_model(dt, nav, nav_work, x, given, model)
    if no_gps:
        place_by_navigation(nav, state)


@kernel
def _update(dt, z, cmd, memory, config, work):
    """Do :func:`tight_step` with plain tuples, which numba takes from Python much faster."""
    given = UKFConfig(config[0], config[1], ModelTerms(*config[2]))
    tight_step(dt, z, cmd, UKFMemory(*memory), given, UKFWork(*work))


@inlined
def update_wind(z, wind):
    """Take the velocity of the true wind (m/s) from a row (19,), if both parts are there."""
    if 0.0 <= z[WIND_SPEED] < WIND_LIMIT and math.isfinite(z[WIND_FROM]):
        wind[0], wind[1] = (
            -z[WIND_SPEED] * math.cos(z[WIND_FROM]),
            -z[WIND_SPEED] * math.sin(z[WIND_FROM]),
        )


class ModelPredictor(Predictor):
    """A predictor that rolls an identified model; subclasses say how it is identified.

    Parameters
    ----------
    particulars : Particulars
        The boat.
    settings : FilterSettings
        Noises and prior.
    seed : int
        Nothing is drawn at random here.

    Attributes
    ----------
    ukf : JointUKF
        State and parameters.
    """

    def __init__(
        self, particulars: Particulars, settings: FilterSettings, *, seed: int = 0
    ) -> None:
        super().__init__(particulars, seed=seed)
        self.ukf = JointUKF(particulars, settings)
        # a subclass that knows the waves, or more of the boat, says so
        self.sources = Sources(self.ukf.memory, None, None, None)
        self.boat = ForecastConfig(self.ukf.constants, self.ukf.terms, None)
        self._latest: Any = None
        self.parameter_names = settings.structure.parameters
        self.parameter_units = settings.structure.units
        self.parameter_blocks = settings.structure.blocks
        self.t = 0.0

    def __reduce__(self) -> tuple[Any, ...]:
        """Make copies (``copy.deepcopy``, ``pickle``) by the constructor, which lays out memory."""
        return _copy_of, (type(self), *self.made_with, self.state_dict())

    def views(self) -> dict[str, Array]:
        """Return the arrays that the predictor remembers, by field; they are views."""
        return with_prefix("filter", record_views(self.ukf.memory, self.ukf.dtype))

    def state_dict(self) -> State:
        """Return all that is remembered; a subclass that remembers more adds its fields."""
        return {"t": self.t, **{name: view.copy() for name, view in self.views().items()}}

    def load_state_dict(self, state: State) -> None:
        """Take over a saved state; see :meth:`Predictor.load_state_dict`."""
        views = self.views()
        check_fields(state, {"t": self.t, **views})
        self.t = float(state["t"])
        fill(views, state)

    @property
    @abstractmethod
    def ready(self) -> bool:
        """True once the filter has begun."""

    @property
    def state(self) -> Array:
        """State, a view of shape (6,)."""
        return self.ukf.x[:N_STATES]

    def estimate(self) -> Estimate:
        """Return state and parameters as estimated now."""
        x, variances = self.ukf.x.copy(), self.ukf.P.diagonal().copy()
        known = self.with_common_error(self.ukf.P[:N_STATES, :N_STATES])
        variances[:N_STATES] = known.diagonal()
        sd = np.sqrt(np.maximum(variances, 0.0))
        own, params = slice(0, N_STATES), slice(N_STATES, None)
        return Estimate(self.t, x[own], sd[own], x[params], sd[params], self.ready)

    def current(self) -> tuple[float, float, float] | None:
        """See :meth:`twin.predictors.base.Predictor.current`."""
        at = int(self.ukf.terms.hull[CURRENT])
        if at < 0 or not self.ready:
            return None
        variance = self.ukf.P.diagonal()[N_STATES + at :][:2].max()
        return float(self.ukf.xi[at]), float(self.ukf.xi[at + 1]), math.sqrt(variance)

    @contextmanager
    def drives_at(self, command: Array) -> Iterator[None]:
        """See :meth:`twin.predictors.base.Predictor.drives_at`."""
        act, before = self.ukf.act, self.ukf.act.copy()
        scale_plan(command[None], self.ukf.settings.n_unit, act[None])
        try:
            yield
        finally:
            act[:] = before

    def identifiability(self) -> Identifiability:
        """Return the identifiability of the parameters from the data until now."""
        ukf, settings = self.ukf, self.ukf.settings
        return assess(
            self.parameter_names,
            [(name, np.arange(*ends)) for name, ends in self.parameter_blocks.items()],
            ukf.gram_matrices,
            settings.q[3:],
            settings.xi0_cov,
            ukf.P[N_STATES:, N_STATES:],
            float(ukf.counted[1]),
        )

    def _opened(self, K: int, dt: float) -> Forecast:
        """Return memory of a forecast of K rows, dt (s) apart."""
        waves = 0 if self.sources.window is None else steps_of_waves(K * dt)
        sizes = len(self.ukf.xi), K, waves
        if self._latest is None or self._latest[0] != sizes:
            self._latest = sizes, opened(forecast_of, *sizes)
        found: Forecast = self._latest[1]
        return found

    def _mean_forecast(self, plan: Array, dt: float) -> Forecast:
        """Return the mean forecast under a plan; the next of as many rows is written over it."""
        out = self._opened(len(plan), dt)
        mean_ahead(plan, dt, self.sources, self.boat, out)
        return out

    def mean(self, plan: Array, dt: float) -> Array:
        """Return the predicted states alone; see :meth:`twin.predictors.base.Predictor.mean`."""
        return np.array(self._mean_forecast(plan, dt).states[0])

    def predict(self, plan: Array, dt: float) -> Prediction:
        """Predict the motion under a plan; see :meth:`twin.predictors.base.Predictor.predict`."""
        mean, own = self.mean(plan, dt), self.ukf.P[:N_STATES, :N_STATES]
        coarse, every = coarse_plan(plan, dt)
        out = self._opened(len(coarse), dt * every)
        covariance_ahead(coarse, dt * every, self.sources, self.boat, out, self.ukf.scratch)
        cov = out.covs
        if every > 1:
            cov = upsample(np.concatenate([own[None], cov]), every, len(plan))
        cov, start_cov = self.with_common_error(cov), self.with_common_error(own)
        limit_covariances(cov, start_cov, dt, self.ukf.envelope)
        after = self.t + dt * np.arange(1, len(plan) + 1)
        return Prediction(self.t, self.state.copy(), start_cov, after, mean, cov)


def _copy_of(
    kind: type[ModelPredictor], arguments: tuple[Any, ...], options: dict[str, Any], state: State
) -> ModelPredictor:
    predictor = kind(*arguments, **options)
    predictor.load_state_dict(state)
    return predictor


class RolloutInputs(NamedTuple):
    """What the models of many boats are rolled from."""

    # (n, 3): position (m) and heading (rad); speed forward and to starboard (m/s), yaw rate (rad/s)
    places: Array
    velocities: Array
    parameters: Array  # (n, p): of the structure
    # (n, 4), (n, 2): see twin.model.rollout.RolloutStart
    actuators: Array
    winds: Array
    # (n, 3) or (1, 3): largest velocities met so far; infinite to accept any model
    fastest: Array
    nominal: Array  # (3,): velocities that may be predicted for any such boat
    prior: Array  # (p,): parameters to fall back to where a model exceeds both by far


class UKFPredictor(ModelPredictor):
    """Plain joint UKF behind the tight navigation filter.

    Without GPS the filter goes on: it weighs what the navigation says by how sure that still
    is, and aids it with the model's velocity. Without IMU the model's accelerations drive the
    navigation. With neither, the model is rolled on.

    Parameters
    ----------
    particulars : Particulars
        The boat.
    model : str, optional
        One of ``twin.model.structure.MODELS``; that of :func:`plain_settings` if left out.
    settings : FilterSettings, optional
        :func:`plain_settings` if left out; it brings its own structure.
    seed : int
        Nothing is drawn at random here.
    """

    tuning = "about 60 configurations in the study"
    is_compiled = True

    def __init__(
        self,
        particulars: Particulars,
        *,
        model: str | None = None,
        settings: FilterSettings | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(particulars, settings or plain_settings(particulars, model), seed=seed)
        settings_nav = navigation_settings(particulars)
        self.memory: Any = UKFMemory(initial_navigation(settings_nav), self.ukf.memory)
        self.config: Any = UKFConfig(settings_nav, self.ukf.constants, self.ukf.terms)
        self.work: Any = UKFWork(np.zeros(NAVIGATION_WORK.itemsize // 8), self.ukf.scratch)
        self._plain = plain(self.memory), plain(self.config), plain(self.work)
        nav = self._nav = self.memory.nav.view(NAVIGATION)[0]
        self.n, self.P_nav = nav["n"], nav["P"]
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.ukf.reset()
        self.memory.nav[:] = initial_navigation(self.config.nav)
        self.t = 0.0

    def views(self) -> dict[str, Array]:
        """See :meth:`ModelPredictor.views`: the fields of :attr:`dtypes`, and other arrays."""
        found: dict[str, Array] = {}
        for part, memory in self.memory._asdict().items():
            if part in self.dtypes:
                found |= with_prefix(part, record_views(memory, self.dtypes[part]))
            else:
                found[part] = memory
        return found

    @property
    def dtypes(self) -> dict[str, np.dtype[Any]]:
        """Structured dtypes of the parts of the memory, by name."""
        return {"nav": NAVIGATION, "filter": self.ukf.dtype}

    def rollout_inputs(self, memory: Any) -> RolloutInputs:
        """Return what rollouts of many boats begin with, as views of their memories, a row each."""
        boats = memory.filter.view(self.ukf.dtype)[:, 0]
        x = boats["x"]
        return RolloutInputs(
            x[:, : PSI + 1],
            x[:, PSI + 1 : N_STATES],
            x[:, N_STATES:],
            boats["act"],
            boats["wind"],
            boats["fastest"],
            self.ukf.nominal,
            self.ukf.settings.xi0,
        )

    @property
    def ready(self) -> bool:
        """True once the filter has begun."""
        return bool(self.memory.nav.item(_BEGUN))

    @property
    def lost(self) -> bool:
        """See :attr:`twin.predictors.base.Predictor.lost`."""
        return self.memory.nav.item(_LOST) > 0.0

    @property
    def navigation(self) -> Array:
        """State of the navigation filter, a view of shape (6,)."""
        return np.asarray(self.n[:N_STATES])

    def with_common_error(self, cov: Array) -> Array:
        """Return covariances with the GPS bias and the error of the navigation added.

        The joint filter takes that error for white, and would average it away; without GPS
        it lasts and grows.
        """
        return super().with_common_error(cov) + self.P_nav[:N_STATES, :N_STATES]

    def suspend_learning(self, commands: bool, motion: bool) -> None:
        """See :meth:`twin.predictors.base.Predictor.suspend_learning`."""
        self._nav["commands_doubted"] = 1.0 if commands else 0.0
        self._nav["motion_doubted"] = 1.0 if motion else 0.0

    def begin_again(self, restart: Any) -> None:
        """See :meth:`twin.predictors.base.Predictor.begin_again`."""
        self._nav["restart"] = restart

    def update(self, t: float, dt: float, z: Array, cmd: Array) -> None:
        """Take one row; see :meth:`twin.predictors.base.Predictor.update`."""
        self.t = t
        _update(dt, z, cmd, *self._plain)
