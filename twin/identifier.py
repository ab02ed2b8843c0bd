"""The twin's model in the structured UKF, and the plain predictor built on it.

:class:`JointUKF` holds state and parameters, follows the actuators from the commands, and
rolls the model into the future. :class:`ModelPredictor` makes a predictor of it.
:class:`UKFPredictor` feeds it from the tight navigation filter, in one compiled call a row.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.model import (
    N_STATES,
    N_XI,
    STUDY_LENGTH,
    STUDY_SPEED,
    accelerations,
    follow,
    hand_prior,
    is_differential,
    joint_predict,
    regressors,
    roll_out,
)
from twin.navigation import (
    GPS_AGE,
    IMU_AGE,
    N_NAV,
    READY_FIX,
    READY_HEADING,
    STATUS_SIZE,
    WORK_ROWS,
    aid,
    aid_velocity,
    initial_navigation,
    navigate,
    navigation_settings,
)
from twin.particulars import Particulars
from twin.predictor import Estimate, Prediction, Predictor
from twin.ukf import measurement_update, scaled_weights, workspace
from usv_kernel import kernel, wrap

__all__ = [
    "FilterSettings",
    "JointUKF",
    "ModelPredictor",
    "UKFPredictor",
    "advance",
    "hold_inside",
    "plain_settings",
]

Array = NDArray[Any]

N = N_STATES + N_XI
PSI = 2
STUDY_STEP = 0.05
"""Step at which the noises below are quoted, s."""
STEP_MAX = 0.1
"""Longest step of the filter's prediction, s; longer gaps are cut up."""
GAP_MAX = 600.0
"""A gap longer than this, s, is predicted through as if it were this long."""
BAND_STEP = 0.25
"""Step at which covariances are carried along a prediction, s."""
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


@dataclass(frozen=True)
class FilterSettings:
    """Noises and prior of the joint UKF, in SI units of the boat at hand.

    Parameters
    ----------
    q : ndarray, shape (6,)
        Variance that each state gains per second.
    r : ndarray, shape (6,)
        Variance of each measured state for rows 0.05 s apart (of the study boat's time);
        rows further apart count for more, as their waves are less alike.
    p0 : ndarray, shape (6,)
        Variance of each state at the start.
    q_xi : ndarray, shape (25,)
        Variance that each parameter gains per second.
    xi0, xi0_var : ndarray, shape (25,)
        Prior of the parameters.
    n_unit : float
        Shaft speeds are multiplied by this before they enter the model.
    alpha, beta, kappa : float
        Spread of the sigma points.
    """

    q: Array
    r: Array
    p0: Array
    q_xi: Array
    xi0: Array
    xi0_var: Array
    n_unit: float = 1.0
    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.0


def plain_settings(particulars: Particulars) -> FilterSettings:
    """Return the settings of the plain joint UKF.

    Those that worked for a boat of 6.336 m (waterline) at 5.4 m/s and 20 Hz, scaled to any
    boat by length and speed (Froude). The measurement noise is far above that of the
    sensors, because the measured velocities carry the waves and the model does not.

    Source: twin.md section 5.1.
    """
    L, U = particulars.length / STUDY_LENGTH, particulars.speed / STUDY_SPEED
    time = L / U
    scale = np.array([L, L, 1.0, U, U, 1.0 / time])
    q = np.array([1e-3, 1e-3, 1e-4, 0.05, 0.05, 0.0125]) * scale
    r = np.array([1.0, 1.0, 0.03, 0.3, 0.3, 0.048]) * scale
    p0 = np.array([2.0, 2.0, 0.05, 0.3, 0.3, 0.05]) * scale
    xi0, sd0 = hand_prior(particulars)
    return FilterSettings(
        q=q**2 / (STUDY_STEP * time),
        r=r**2 * time,
        p0=p0**2,
        q_xi=np.zeros(N_XI),
        xi0=xi0,
        xi0_var=sd0**2,
    )


@kernel
def _follow_commands(act, cmd, lags, n_unit, h):
    """Move the four actuators towards their commands for a time h."""
    for k in range(2):
        act[k] = follow(act[k], n_unit * cmd[k], lags[0], math.inf, h)
        act[2 + k] = follow(act[2 + k], cmd[2 + k], lags[1], lags[2], h)


@kernel
def advance(x, P, act, cmd, dt, lags, n_unit, differential, q, q_xi, weights, Q, qx, work):
    """Predict state, parameters and covariance over dt, actuators included.

    Parameters
    ----------
    x, P : ndarray, shapes (31,), (31, 31)
        Mean and covariance, advanced in place.
    act, cmd : ndarray, shape (4,)
        Actuators, advanced in place, and their commands.
    dt : float
        Time, s.
    lags : ndarray, shape (3,)
        Shaft lag (s), steering lag (s), steering rate (rad/s).
    n_unit, differential : float
        See :class:`FilterSettings` and :func:`twin.model.is_differential`.
    q, q_xi : ndarray, shapes (6,), (25,)
        Variances gained per second.
    weights, Q, qx, work : ndarray
        Weights and scratch of :mod:`twin.ukf`.
    """
    dt = min(dt, GAP_MAX)
    steps = max(1, math.ceil(dt / STEP_MAX - 1e-9))
    h = dt / steps
    for i in range(N_STATES):
        Q[i, i] = q[i] * h
    for k in range(N_XI):
        qx[k] = q_xi[k] * h
    for _ in range(steps):
        _follow_commands(act, cmd, lags, n_unit, 0.5 * h)
        joint_predict(x, P, act, differential, h, Q, qx, weights, work)
        _follow_commands(act, cmd, lags, n_unit, 0.5 * h)


@kernel
def hold_inside(x, envelope):
    """Keep the velocities inside what the boat can do: bad parameters must not run away.

    Parameters
    ----------
    x : ndarray, shape (31,)
        Joint vector, changed in place.
    envelope : ndarray, shape (3,)
        Largest size of u, v (m/s) and r (rad/s).
    """
    for i in range(3):
        x[3 + i] = min(max(x[3 + i], -envelope[i]), envelope[i])


# flat memory of the joint filter: where each part begins
_X = 0
_P = _X + N
_ACT = _P + N * N
MEMORY_SIZE = _ACT + 4
# its constants
_Q, _Q_XI = 0, N_STATES
_R = _Q_XI + N_XI
_P0 = _R + N_STATES
_LAGS = _P0 + N_STATES
_ENVELOPE = _LAGS + 3
_WEIGHTS = _ENVELOPE + 3
_UNIT = _WEIGHTS + 4
_DIFFERENTIAL = _UNIT + 1
# its scratch
_QS, _QX = 0, N_STATES * N_STATES
_RS = _QX + N_XI
_PHI = _RS + N_STATES * N_STATES
_MODEL = _PHI + N_XI
_MASK = _MODEL + 4
_TURNED = _MASK + N_STATES
SCRATCH_SIZE = _TURNED + 4
# flat memory of the navigation filter
_NAV_P = N_NAV
_STATUS = _NAV_P + N_NAV * N_NAV
_SINCE_AID, _BEGUN = _STATUS + STATUS_SIZE, _STATUS + STATUS_SIZE + 1
NAV_SIZE = _BEGUN + 1


@kernel
def _tight_step(dt, z, cmd, nav, nav_settings, nav_work, memory, constants, scratch, work):
    """One row of the plain predictor: navigate, predict, correct; all memory in place."""
    n, P_nav = nav[:_NAV_P], nav[_NAV_P:_STATUS].reshape((N_NAV, N_NAV))
    status = nav[_STATUS:_SINCE_AID]
    x, P, act = memory[_X:_P], memory[_P:_ACT].reshape((N, N)), memory[_ACT:]
    q, q_xi, r = constants[_Q:_Q_XI], constants[_Q_XI:_R], constants[_R:_P0]
    lags, envelope = constants[_LAGS:_ENVELOPE], constants[_ENVELOPE:_WEIGHTS]
    weights = constants[_WEIGHTS:_UNIT]
    n_unit, differential = constants[_UNIT], constants[_DIFFERENTIAL]
    Q = scratch[_QS:_QX].reshape((N_STATES, N_STATES))
    qx, R = scratch[_QX:_RS], scratch[_RS:_PHI].reshape((N_STATES, N_STATES))
    phi, model, mask = scratch[_PHI:_MODEL], scratch[_MODEL:_MASK], scratch[_MASK:_TURNED]

    for k in range(4):
        model[k] = 0.0
    if nav[_BEGUN] > 0.0:
        regressors(x[3], x[4], x[5], act, differential, phi)
        du, dv, dr = accelerations(phi, x, N_STATES)
        turn, speed = envelope[2], envelope[0]
        model[0] = min(max(du, -speed * turn), speed * turn)
        model[1] = min(max(dv, -speed * turn), speed * turn)
        model[2] = min(max(dr, -turn * turn), turn * turn)
        model[3] = 1.0
    age = status[GPS_AGE] + dt
    navigate(n, P_nav, dt, z, model, nav_settings, status, nav_work)
    if nav[_BEGUN] == 0.0:
        for k in range(2):
            act[k], act[2 + k] = n_unit * cmd[k], cmd[2 + k]
        if status[READY_FIX] * status[READY_HEADING] > 0.0:
            for i in range(N_STATES):
                x[i] = n[i]
                P[i, i] = constants[_P0 + i]
            nav[_BEGUN] = 1.0
        return
    # so long a roll-out is far from linear in the parameters: its error would ruin them
    astray = age > RESTART_AFTER * 4.0 / envelope[2] and status[GPS_AGE] == 0.0
    for i in range(N_STATES):
        off = n[i] - x[i]
        if i == PSI:
            off = wrap(off)
        astray = astray or off * off > ASTRAY**2 * (P[i, i] + P_nav[i, i] + r[i])
    if astray:
        for i in range(N_STATES):
            for k in range(N):
                P[i, k] = P[k, i] = 0.0
            x[i], P[i, i] = n[i], constants[_P0 + i] + P_nav[i, i]
        _follow_commands(act, cmd, lags, n_unit, dt)
        return
    advance(x, P, act, cmd, dt, lags, n_unit, differential, q, q_xi, weights, Q, qx, work)
    row = max(dt, 1e-3)
    for i in range(N_STATES):
        R[i, i] = STUDY_STEP * r[i] / row + P_nav[i, i]
        mask[i] = 1.0
    no_gps, no_imu = status[GPS_AGE] > AID_AFTER, status[IMU_AGE] > AID_AFTER
    if no_gps:
        # what the navigation then says of them is in part the model's own
        mask[0] = mask[1] = 0.0
        R[3, 3] *= ECHO
        R[4, 4] *= ECHO
    if no_imu:
        mask[5] = 0.0
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
            for k in range(N):
                P[i, k] = P[k, i] = 0.0
            x[i], P[i, i] = n[i], spread


@kernel
def _bands(acts, dt, every, memory, constants, scratch, work, x, P, out):
    """Write the covariance of the state after each ``every`` rows of a prediction."""
    h = dt * every
    Q = scratch[_QS:_QX].reshape((N_STATES, N_STATES))
    qx, weights = scratch[_QX:_RS], constants[_WEIGHTS:_UNIT]
    envelope = constants[_ENVELOPE:_WEIGHTS]
    for i in range(N):
        x[i] = memory[_X + i]
        for k in range(N):
            P[i, k] = memory[_P + N * i + k]
    for i in range(N_STATES):
        Q[i, i] = constants[_Q + i] * h
    for k in range(N_XI):
        qx[k] = constants[_Q_XI + k] * h
    for j in range(out.shape[0]):
        last = min((j + 1) * every, acts.shape[0]) - 1
        joint_predict(x, P, acts[last], constants[_DIFFERENTIAL], h, Q, qx, weights, work)
        hold_inside(x, envelope)
        for i in range(N_STATES):
            for k in range(N_STATES):
                out[j, i, k] = P[i, k]


@kernel
def _roll(plan, dt, memory, constants, scratch, scaled, out, acts):
    """Roll the model under a plan whose shaft speeds are in the unit of the particulars."""
    for row in range(plan.shape[0]):
        for k in range(2):
            scaled[row, k] = constants[_UNIT] * plan[row, k]
            scaled[row, 2 + k] = plan[row, 2 + k]
    roll_out(
        memory[_X : _X + N_STATES],
        memory[_X + N_STATES : _P],
        memory[_ACT:],
        scaled,
        dt,
        constants[_LAGS],
        constants[_LAGS + 1],
        constants[_LAGS + 2],
        constants[_ENVELOPE],
        constants[_ENVELOPE + 2],
        constants[_DIFFERENTIAL],
        out,
        acts,
        scratch[_TURNED:],
    )


class JointUKF:
    """State and 25 parameters of the twin's model in the structured UKF.

    Parameters
    ----------
    particulars : Particulars
        The boat.
    settings : FilterSettings
        Noises and prior.

    Attributes
    ----------
    x, P : ndarray, shapes (31,), (31, 31)
        Mean and covariance: six states, then the parameters.
    act : ndarray, shape (4,)
        Where the actuators are believed to be.
    """

    def __init__(self, particulars: Particulars, settings: FilterSettings) -> None:
        self.settings = settings
        self.differential = is_differential(particulars)
        self.lags = np.array([particulars.shaft_lag, particulars.steer_lag, particulars.steer_rate])
        U, L = particulars.speed, particulars.length
        self.envelope = np.array([4.0 * U, 4.0 * U, 4.0 * U / L])
        self.weights = scaled_weights(N, settings.alpha, settings.beta, settings.kappa)
        # few flat arrays: each one that a kernel takes costs a call
        self.memory = np.zeros(MEMORY_SIZE)
        self.x, self.act = self.memory[_X:_P], self.memory[_ACT:]
        self.P = self.memory[_P:_ACT].reshape(N, N)
        self.constants = np.concatenate(
            [
                *(settings.q, settings.q_xi, settings.r, settings.p0),
                *(self.lags, self.envelope, self.weights),
                [settings.n_unit, self.differential],
            ]
        )
        self.scratch = np.zeros(SCRATCH_SIZE)
        self.Q = self.scratch[_QS:_QX].reshape(N_STATES, N_STATES)
        self.qx = self.scratch[_QX:_RS]
        self.R = self.scratch[_RS:_PHI].reshape(N_STATES, N_STATES)
        self.work = workspace(N_STATES, N_XI)
        self._scaled = np.empty((0, 4))
        self._x, self._P = np.empty(N), np.empty((N, N))
        self.reset()

    def reset(self) -> None:
        """Go back to the prior."""
        self.memory[:] = 0.0
        self.x[N_STATES:] = self.settings.xi0
        np.fill_diagonal(self.P, np.concatenate([self.settings.p0, self.settings.xi0_var]))

    @property
    def xi(self) -> Array:
        """Parameters, a view of shape (25,)."""
        return self.x[N_STATES:]

    def roll(self, plan: Array, dt: float) -> tuple[Array, Array]:
        """Return states (K, 6) and actuators (K, 4) under a plan; nothing is changed.

        Parameters
        ----------
        plan : ndarray, shape (K, 4)
            Commands; shaft speeds in the unit of the particulars.
        dt : float
            Time between rows, s.
        """
        K = len(plan)
        out, acts = np.empty((K, N_STATES)), np.empty((K, 4))
        if len(self._scaled) != K:
            self._scaled = np.empty((K, 4))
        _roll(plan, dt, self.memory, self.constants, self.scratch, self._scaled, out, acts)
        return out, acts

    def bands(self, acts: Array, dt: float) -> Array:
        """Return covariances (K, 6, 6) of the states that :meth:`roll` gave with ``acts``."""
        every = max(1, min(round(BAND_STEP / dt), len(acts)))
        coarse = np.zeros((math.ceil(len(acts) / every), N_STATES, N_STATES))
        _bands(
            *(acts, dt, every, self.memory, self.constants, self.scratch, self.work),
            *(self._x, self._P, coarse),
        )
        if every == 1:
            return coarse
        place = np.arange(1, len(acts) + 1) / every
        low = np.minimum(place.astype(int), len(coarse) - 1)
        share = np.minimum(place - low, 1.0)[:, None, None]
        path = np.concatenate([self.P[None, :N_STATES, :N_STATES], coarse])
        return (1.0 - share) * path[low] + share * path[low + 1]


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
        self.t = 0.0

    @property
    @abstractmethod
    def ready(self) -> bool:
        """True once the filter has begun."""

    @property
    def s(self) -> Array:
        """State, a view of shape (6,)."""
        return self.ukf.x[:N_STATES]

    def estimate(self) -> Estimate:
        """Return what is believed now."""
        x, P = self.ukf.x.copy(), self.ukf.P
        state = self.with_common_error(P[:N_STATES, :N_STATES])
        sd, xi_sd = (np.sqrt(np.maximum(np.diag(c), 0.0)) for c in (state, P[N_STATES:, N_STATES:]))
        return Estimate(self.t, x[:N_STATES], sd, x[N_STATES:], xi_sd, self.ready)

    def mean(self, plan: Array, dt: float) -> Array:
        """Return the predicted states alone; see :meth:`twin.predictor.Predictor.mean`."""
        return self.ukf.roll(plan, dt)[0]

    def predict(self, plan: Array, dt: float) -> Prediction:
        """Predict the motion under a plan; see :meth:`twin.predictor.Predictor.predict`."""
        mean, acts = self.ukf.roll(plan, dt)
        after = dt * np.arange(1, len(plan) + 1)
        start_cov = self.with_common_error(self.ukf.P[:N_STATES, :N_STATES])
        return Prediction(
            self.t,
            self.s.copy(),
            start_cov,
            self.t + after,
            mean,
            self.with_common_error(self.ukf.bands(acts, dt)),
        )


class UKFPredictor(ModelPredictor):
    """Plain joint UKF behind the tight navigation filter.

    Without GPS the filter goes on: it weighs what the navigation says by how sure that still
    is, and aids it with the model's velocity. Without IMU the model's accelerations drive the
    navigation. With neither, the model is rolled on.

    Parameters
    ----------
    particulars : Particulars
        The boat.
    settings : FilterSettings, optional
        :func:`plain_settings` if left out.
    seed : int
        Nothing is drawn at random here.
    """

    def __init__(
        self,
        particulars: Particulars,
        *,
        settings: FilterSettings | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(particulars, settings or plain_settings(particulars), seed=seed)
        self.nav = np.zeros(NAV_SIZE)
        self.n = self.nav[:_NAV_P]
        self.P_nav = self.nav[_NAV_P:_STATUS].reshape(N_NAV, N_NAV)
        self.status = self.nav[_STATUS:_SINCE_AID]
        self._nav_settings = navigation_settings(particulars)
        ukf = self.ukf
        self._arguments = (
            *(self.nav, self._nav_settings, np.zeros((WORK_ROWS, N_NAV))),
            *(ukf.memory, ukf.constants, ukf.scratch, ukf.work),
        )
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.ukf.reset()
        self.nav[:] = 0.0
        self.n[:], self.P_nav[:], self.status[:] = initial_navigation(self._nav_settings)
        self.t = 0.0

    @property
    def ready(self) -> bool:
        """True once the filter has begun."""
        return bool(self.nav[_BEGUN])

    def with_common_error(self, cov: Array) -> Array:
        """Return covariances with the GPS bias and the error of the navigation added.

        The joint filter takes that error for white, and would average it away; without GPS
        it lasts and grows.
        """
        return super().with_common_error(cov) + self.P_nav[:N_STATES, :N_STATES]

    def update(self, t: float, dt: float, z: Array, cmd: Array) -> None:
        """Take one row; see :meth:`twin.predictor.Predictor.update`."""
        self.t = t
        _tight_step(dt, z, cmd, *self._arguments)
