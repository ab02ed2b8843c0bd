"""The twin's model in the structured UKF, and the plain predictor built on it.

:class:`JointUKF` holds state and parameters, follows the actuators from the commands, and
rolls the model into the future. :class:`ModelPredictor` makes a predictor of it.
:class:`UKFPredictor` feeds it from the tight navigation filter, in one compiled call a row.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.checkpoint import FLAG, Field, State, check_fields, fill, with_prefix
from twin.filters.navigation_ekf import (
    GPS_AGE,
    IMU_AGE,
    N_NAV,
    NAVIGATION_FIELDS,
    READY_FIX,
    READY_HEADING,
    STATUS_SIZE,
    WORK_ROWS,
    aid,
    aid_velocity,
    initial_navigation,
    navigate,
    navigation_settings,
    navigation_views,
)
from twin.filters.ukf import measurement_update
from twin.identification.filter_settings import STUDY_STEP, FilterSettings, plain_settings
from twin.identification.identifiability import Identifiability, judge
from twin.identification.joint_ukf import (
    JOINT_FIELDS,
    PSI,
    STEP_MAX,
    JointUKF,
    advance,
    hold_inside,
    parts,
    rooms,
    see,
    wave_parts,
)
from twin.model.actuators import follow_all
from twin.model.dynamics import N_ACT, all_terms
from twin.model.structure import N_STATES, accelerations
from twin.particulars import STUDY_SPEED, Particulars
from twin.predictors.base import Estimate, Prediction, Predictor
from usv_kernel.arrays import shaped
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import wrap

__all__ = [
    "ModelPredictor",
    "RolloutInputs",
    "UKFPredictor",
]

Array = NDArray[Any]

WIND_LIMIT = 100.0
"""No wind is faster, m/s."""

AID_SD = 0.5 / STUDY_SPEED
"""Standard deviation of the model's velocity as an aid, in usual speeds."""

AID_TURN = 0.04
"""Standard deviation of the model's yaw rate as an aid, in usual speeds over length."""

ECHO = 400.0
"""Without GPS the error of the navigation's velocity lasts: so many rows count as one."""

RESTART_AFTER = 4.0
"""After so long without GPS (in lengths over usual speed) the state starts anew with the next
fix; the parameters stay ..."""

ASTRAY = 10.0
"""... as where it is so many standard deviations from what the navigation says."""

AID_AFTER, AID_EVERY = 1.0, 1.0
"""The model aids the navigation filter each AID_EVERY s once GPS is AID_AFTER s old."""

# flat memory of the navigation filter
_NAV_P = N_NAV

_STATUS = _NAV_P + N_NAV * N_NAV

_SINCE_AID, BEGUN, _HAS_IMU = range(_STATUS + STATUS_SIZE, _STATUS + STATUS_SIZE + 3)

NAV_SIZE = _HAS_IMU + 1


@inlined
def nav_parts(nav):
    """Return state and covariance of the navigation filter as views."""
    return nav[:_NAV_P], shaped(nav, _NAV_P, (N_NAV, N_NAV))


@kernel
def tight_step(dt, z, cmd, nav, nav_settings, nav_work, memory, constants, scratch, work, kit):
    """One row of the plain predictor: navigate, predict, correct; all memory in place."""
    n, P_nav = nav_parts(nav)
    status = nav[_STATUS:_SINCE_AID]
    x, P, act, wind, _, _, r, p0, lags, envelope, _, n_unit = parts(memory, constants, kit)
    _, R, terms, model, mask, _, _ = rooms(scratch, kit)
    felt, waves = wave_parts(memory, constants, kit)

    feel_wind(z, wind)
    for k in range(4):
        model[k] = 0.0
    if nav[BEGUN] > 0.0:
        all_terms(x, act, wind, kit, terms)
        see(dt, terms, memory, kit)
        du, dv, dr = accelerations(terms, kit, x, N_STATES)
        turn, speed = envelope[2], envelope[0]
        model[0] = min(max(du, -speed * turn), speed * turn)
        model[1] = min(max(dv, -speed * turn), speed * turn)
        model[2] = min(max(dr, -turn * turn), turn * turn)
        # a model that has never been held to a measured motion may spin the navigation
        model[3] = nav[_HAS_IMU]
    age = status[GPS_AGE] + dt
    navigate(n, P_nav, dt, z, model, nav_settings, status, nav_work)
    if nav[BEGUN] == 0.0:
        for k in range(2):
            act[k], act[2 + k] = n_unit * cmd[k], cmd[2 + k]
        if status[READY_FIX] * status[READY_HEADING] > 0.0:
            for i in range(N_STATES):
                x[i] = n[i]
                P[i, i] = p0[i]
            nav[BEGUN] = 1.0
        return
    # so long a roll-out is far from linear in the parameters: its error would ruin them
    astray = age > RESTART_AFTER * 4.0 / envelope[2] and status[GPS_AGE] == 0.0
    for i in range(N_STATES):
        off = n[i] - x[i]
        if i == PSI:
            off = wrap(off)
        wavy = felt[i - PSI - 1] if i > PSI else 0.0
        astray = astray or off * off > ASTRAY**2 * (P[i, i] + P_nav[i, i] + r[i] + wavy)
    if astray:
        for i in range(N_STATES):
            for k in range(x.shape[0]):
                P[i, k] = P[k, i] = 0.0
            x[i], P[i, i] = n[i], p0[i] + P_nav[i, i]
        follow_all(act, cmd, lags, n_unit, dt)
        return
    advance(dt, cmd, memory, constants, scratch, work, kit)
    row = max(dt, 1e-3)
    for i in range(N_STATES):
        R[i, i] = STUDY_STEP * r[i] / row + P_nav[i, i]
        mask[i] = 1.0
    if status[IMU_AGE] == 0.0:
        nav[_HAS_IMU] = 1.0
    # a boat without IMU has not lost it: its navigation goes by fixes and compass alone
    no_gps = status[GPS_AGE] > AID_AFTER
    no_imu = nav[_HAS_IMU] > 0.0 and status[IMU_AGE] > AID_AFTER
    if no_gps:
        # what the navigation then says of them is in part the model's own
        mask[0] = mask[1] = 0.0
        R[3, 3] *= ECHO
        R[4, 4] *= ECHO
    if no_imu:
        mask[5] = 0.0
    if waves[0] > 0.0:
        for k in range(3):
            i = PSI + 1 + k
            # held while the sensor that would feel them is gone
            if not (no_imu if k == 2 else no_gps):
                # a prediction gone wild is no wave: none moves her faster than she sails
                off = min(abs(n[i] - x[i]), 0.25 * envelope[k])
                more = off * off - P[i, i] - R[i, i]
                share = min(min(row, STEP_MAX) / waves[0], 1.0)
                felt[k] = max(felt[k] + share * (more - felt[k]), 0.0)
            R[i, i] += waves[1] * felt[k] / row
    measurement_update(x, P, n[:N_STATES], mask, R, PSI, math.inf, work)
    hold_inside(x, envelope)
    nav[_SINCE_AID] += dt
    if (no_gps or no_imu) and nav[_SINCE_AID] >= AID_EVERY:
        nav[_SINCE_AID] = 0.0
        speed, turn = 0.25 * envelope[0], 0.25 * envelope[2]
        aid_velocity(
            *(n, P_nav, x[3], x[4], (AID_SD * speed) ** 2, status),
            *(nav_work[0], nav_work[1]),
        )
        if no_imu:
            aid(n, P_nav, 5, x[5], (AID_TURN * turn) ** 2, status, nav_work[0], nav_work[1])
    if no_gps:
        for i in range(2):
            spread = P[i, i]
            for k in range(x.shape[0]):
                P[i, k] = P[k, i] = 0.0
            x[i], P[i, i] = n[i], spread


@inlined
def feel_wind(z, wind):
    """Take the velocity of the true wind from a row of measurements, if both parts are there.

    Parameters
    ----------
    z : ndarray, shape (10,)
        Measurement row.
    wind : ndarray, shape (2,)
        To north and east, m/s; kept where nothing new is said.
    """
    if 0.0 <= z[8] < WIND_LIMIT and math.isfinite(z[9]):
        wind[0], wind[1] = -z[8] * math.cos(z[9]), -z[8] * math.sin(z[9])


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

    models = True

    def __init__(
        self, particulars: Particulars, settings: FilterSettings, *, seed: int = 0
    ) -> None:
        super().__init__(particulars, seed=seed)
        self.ukf = JointUKF(particulars, settings)
        self.parameter_names = settings.structure.parameters
        self.parameter_units = settings.structure.units
        self.parameter_blocks = settings.structure.blocks
        self.t = 0.0

    def __reduce__(self) -> tuple[Any, ...]:
        """Make copies (``copy.deepcopy``, ``pickle``) by the constructor, which lays out memory."""
        return _copy_of, (type(self), *self.made_with, self.state_dict())

    def views(self) -> dict[str, Array]:
        """Return the arrays that the predictor remembers, by field; they are views."""
        return with_prefix("filter", self.ukf.views())

    def fields(self) -> dict[str, Field]:
        """Return what the fields of a saved state may hold."""
        return with_prefix("filter", JOINT_FIELDS)

    def state_dict(self) -> State:
        """Return all that is remembered; a subclass that remembers more adds its fields."""
        return {"t": self.t, **{name: view.copy() for name, view in self.views().items()}}

    def load_state_dict(self, state: State) -> None:
        """Take over a saved state; see :meth:`Predictor.load_state_dict`."""
        views = self.views()
        check_fields(state, {"t": self.t, **views}, self.fields())
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
        """Return what is believed now."""
        x, P = self.ukf.x.copy(), self.ukf.P
        state = self.with_common_error(P[:N_STATES, :N_STATES])
        sd, params_sd = (
            np.sqrt(np.maximum(np.diag(c), 0.0)) for c in (state, P[N_STATES:, N_STATES:])
        )
        return Estimate(self.t, x[:N_STATES], sd, x[N_STATES:], params_sd, self.ready)

    def identifiability(self) -> Identifiability:
        """Return what the data seen say of the parameters."""
        ukf, settings = self.ukf, self.ukf.settings
        return judge(
            self.parameter_names,
            [(name, np.arange(*ends)) for name, ends in self.parameter_blocks.items()],
            ukf.grams,
            settings.q[3:],
            settings.xi0_cov,
            ukf.P[N_STATES:, N_STATES:],
            float(ukf.seen[0]),
        )

    def mean(self, plan: Array, dt: float) -> Array:
        """Return the predicted states alone; see :meth:`twin.predictors.base.Predictor.mean`."""
        return self.ukf.roll(plan, dt)[0]

    def predict(self, plan: Array, dt: float) -> Prediction:
        """Predict the motion under a plan; see :meth:`twin.predictors.base.Predictor.predict`."""
        mean, acts = self.ukf.roll(plan, dt)
        after = dt * np.arange(1, len(plan) + 1)
        start_cov = self.with_common_error(self.ukf.P[:N_STATES, :N_STATES])
        return Prediction(
            self.t,
            self.state.copy(),
            start_cov,
            self.t + after,
            mean,
            self._within_reach(self.with_common_error(self.ukf.bands(acts, dt)), start_cov, after),
        )

    def _within_reach(self, cov: Array, start_cov: Array, after: Array) -> Array:
        """Return covariances (K, 6, 6) without deviations that no boat could have by then."""
        envelope = self.ukf.envelope
        most = np.zeros((len(after), N_STATES))
        most[:, :2] = 2.0 * envelope[0] * after[:, None]
        most[:, 2] = 2.0 * np.minimum(envelope[2] * after, np.pi)
        most += np.sqrt(np.diag(start_cov))
        most[:, 3:] = 2.0 * envelope
        sd = np.sqrt(np.maximum(np.einsum("kii->ki", cov), 1e-300))
        shrink = np.minimum(1.0, most / sd)
        # the product first: it is symmetric to the last bit
        within: Array = cov * (shrink[:, :, None] * shrink[:, None, :])
        return within


def _copy_of(
    kind: type[ModelPredictor], arguments: tuple[Any, ...], options: dict[str, Any], state: State
) -> ModelPredictor:
    predictor = kind(*arguments, **options)
    predictor.load_state_dict(state)
    return predictor


class RolloutInputs(NamedTuple):
    """What the models of many boats are rolled from.

    Attributes
    ----------
    places, velocities : ndarray, shape (n, 3)
        Position (m) and heading (rad); speed forward and to starboard (m/s), yaw rate (rad/s).
    parameters : ndarray, shape (n, p)
        Of the structure.
    actuators, winds : ndarray, shapes (n, 4), (n, 2)
        See :func:`twin.model.rollout.roll_out`.
    seen : ndarray, shape (n, 3) or (1, 3)
        Largest velocities met so far; infinite where no model is too wild.
    usual : ndarray, shape (3,)
        Velocities that any such boat may be foretold to have.
    prior : ndarray, shape (p,)
        Parameters to fall back to where a model exceeds both by far.
    """

    places: Array
    velocities: Array
    parameters: Array
    actuators: Array
    winds: Array
    seen: Array
    usual: Array
    prior: Array


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

    def __init__(
        self,
        particulars: Particulars,
        *,
        model: str | None = None,
        settings: FilterSettings | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(particulars, settings or plain_settings(particulars, model), seed=seed)
        self.nav = np.zeros(NAV_SIZE)
        self.n = self.nav[:_NAV_P]
        self.P_nav = self.nav[_NAV_P:_STATUS].reshape(N_NAV, N_NAV)
        self.status = self.nav[_STATUS:_SINCE_AID]
        self._nav_settings = navigation_settings(particulars)
        self._arguments = (
            *(self.nav, self._nav_settings, np.zeros((WORK_ROWS, N_NAV))),
            *self.ukf.arguments,
        )
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.ukf.reset()
        self.nav[:] = 0.0
        self.n[:], self.P_nav[:], self.status[:] = initial_navigation(self._nav_settings)
        self.t = 0.0

    def views(self) -> dict[str, Array]:
        """See :meth:`ModelPredictor.views`."""
        return {
            **with_prefix("navigation", navigation_views(self.n, self.P_nav, self.status)),
            "since_aid": self.nav[_SINCE_AID:BEGUN],
            "begun": self.nav[BEGUN:_HAS_IMU],
            "has_imu": self.nav[_HAS_IMU:NAV_SIZE],
            **super().views(),
        }

    def fields(self) -> dict[str, Field]:
        """See :meth:`ModelPredictor.fields`."""
        own = {"since_aid": Field(low=0.0), "begun": FLAG, "has_imu": FLAG}
        return {**super().fields(), **with_prefix("navigation", NAVIGATION_FIELDS), **own}

    @property
    def remembered(self) -> tuple[Array, ...]:
        """All that the filter remembers; arrays whose rows stand for boats in a batch."""
        return self.nav, self.ukf.memory

    @property
    def shared(self) -> tuple[Any, ...]:
        """What twins of like boats can share, in the order of :func:`tight_step`."""
        _, settings, nav_work, _, *rest = self._arguments
        return settings, nav_work, *rest

    def rollout_inputs(self, *remembered: Array) -> RolloutInputs:
        """Return what :func:`twin.model.rollout.roll_out` needs, of many boats, as views.

        Parameters
        ----------
        *remembered : ndarrays
            As :attr:`remembered`, but with a row for each boat.
        """
        memory, n = remembered[1], len(self.ukf.x)
        end = n + n * n
        return RolloutInputs(
            *(memory[:, : PSI + 1], memory[:, PSI + 1 : N_STATES], memory[:, N_STATES:n]),
            *(memory[:, end : end + N_ACT], memory[:, end + N_ACT : end + N_ACT + 2]),
            *(np.full((1, 3), math.inf), np.full(3, math.inf), self.ukf.settings.xi0),
        )

    @property
    def ready(self) -> bool:
        """True once the filter has begun."""
        return bool(self.nav[BEGUN])

    def with_common_error(self, cov: Array) -> Array:
        """Return covariances with the GPS bias and the error of the navigation added.

        The joint filter takes that error for white, and would average it away; without GPS
        it lasts and grows.
        """
        return super().with_common_error(cov) + self.P_nav[:N_STATES, :N_STATES]

    def update(self, t: float, dt: float, z: Array, cmd: Array) -> None:
        """Take one row; see :meth:`twin.predictors.base.Predictor.update`."""
        self.t = t
        tight_step(dt, z, cmd, *self._arguments)
