"""The twin's model in the structured UKF, and the plain predictor built on it.

:class:`JointUKF` holds state and parameters, follows the actuators from the commands, and
rolls the model into the future. :class:`ModelPredictor` makes a predictor of it.
:class:`UKFPredictor` feeds it from the tight navigation filter, in one compiled call a row.
"""

from __future__ import annotations

import dataclasses
import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.identifiability import Identifiability, accumulate, judge
from twin.model import (
    LOOK_AHEAD,
    N_ACT,
    N_STATES,
    ROOM,
    all_terms,
    follow_all,
    joint_predict,
    model_of,
    roll_out,
)
from twin.navigation import (
    GAP_MAX,
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
from twin.particulars import STUDY_LENGTH, STUDY_SPEED, Particulars
from twin.predictor import Estimate, Prediction, Predictor, finer
from twin.prior import population_prior
from twin.state import copied, pack
from twin.structure import N_TERMS, Structure, accelerations
from twin.ukf import measurement_update, scaled_weights, workspace
from usv_kernel import in_python, inlined, kernel, wrap
from usv_kernel.views import shaped

__all__ = [
    "Beliefs",
    "FilterSettings",
    "JointUKF",
    "ModelPredictor",
    "UKFPredictor",
    "advance",
    "hold_inside",
    "plain_settings",
    "scale_plan",
    "see",
]

Array = NDArray[Any]

PSI = 2
STUDY_STEP = 0.05
"""Step at which the noises below are quoted, s."""
STEP_MAX = 0.1
"""Longest step of the filter's prediction, s; longer gaps are cut up."""
WIND_LIMIT = 100.0
"""No wind is faster, m/s."""
DISTURBED = 0.0088, 0.039
"""What drives the velocities (times length, m2/s) and the yaw rate (times length squared,
rad m2/s) of a tanker within a second: gusts that are no stronger for a longer model, and take
hold of an area to move a mass."""
WAVELESS, WAVELESS_TURN = 0.05, 0.005
"""Part of the measurement noise that is not that of waves; of the yaw rate, which leaves all but
that of the gyro out."""
FELT_TIME, FELT_NOISE, FELT_PUSH = 1.0, 0.3, 10.0
"""Waves that a tanker feels: time over which they are averaged, and what their mean square adds to
the densities of measurement noise (both in lengths over usual speed) and of process noise (in
usual speeds over length)."""
WANDERING, WANDER_TIME = ("E_north", "E_east", "N_0"), 28.0
"""Biases of a tanker that wander, and the time in which they do by their standard deviation, s."""
DOUBT = 1.5
"""How much larger than in the population the variances of a tanker's parameters are taken."""
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
SEE_EVERY, SEE_MAX = 0.25, 1.0
"""Regressors are counted each SEE_EVERY s, and stand for no more than SEE_MAX s of a gap."""


@dataclass(frozen=True)
class FilterSettings:
    """Noises and prior of the joint UKF, in SI units of the boat at hand.

    Parameters
    ----------
    structure : Structure
        What the accelerations are made of; p parameters.
    q : ndarray, shape (6,)
        Variance that each state gains per second.
    r : ndarray, shape (6,)
        Variance of each measured state for rows 0.05 s apart (of the study boat's time);
        rows further apart count for more, as their waves are less alike.
    p0 : ndarray, shape (6,)
        Variance of each state at the start.
    q_xi : ndarray, shape (p,)
        Variance that each parameter gains per second.
    xi0, xi0_cov : ndarray, shapes (p,), (p, p)
        Prior of the parameters.
    n_unit : float
        Shaft speeds are multiplied by this before they enter the model.
    waves : tuple of float
        Time (s) over which is averaged by how much the squared innovations of the velocities
        exceed what the filter expects, and what that mean adds to the densities of measurement
        noise (s) and process noise (1/s). With zeros nothing is.
    alpha, beta, kappa : float
        Spread of the sigma points.
    """

    structure: Structure
    q: Array
    r: Array
    p0: Array
    q_xi: Array
    xi0: Array
    xi0_cov: Array
    n_unit: float
    waves: tuple[float, float, float] = (0.0, 0.0, 0.0)
    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.0


def plain_settings(particulars: Particulars, model: str | None = None) -> FilterSettings:
    """Return the settings of the plain joint UKF.

    The model is that of the paper if none is named, but for tankers: see :func:`_of_a_tanker`.

    Those that worked for a boat of 6.336 m (waterline) at 5.4 m/s and 20 Hz, scaled to any
    boat by length and speed (Froude). The measurement noise is far above that of the
    sensors, because the measured velocities carry the waves and the model does not.

    Source: twin.md section 5.1.
    """
    if model is None and particulars.tanker:
        return _of_a_tanker(particulars)
    L, U = particulars.length / STUDY_LENGTH, particulars.speed / STUDY_SPEED
    time = L / U
    scale = np.array([L, L, 1.0, U, U, 1.0 / time])
    q = np.array([1e-3, 1e-3, 1e-4, 0.05, 0.05, 0.0125]) * scale
    r = np.array([1.0, 1.0, 0.03, 0.3, 0.3, 0.048]) * scale
    p0 = np.array([2.0, 2.0, 0.05, 0.3, 0.3, 0.05]) * scale
    structure = model_of(particulars, model or "paper")
    return FilterSettings(
        structure=structure,
        q=q**2 / (STUDY_STEP * time),
        r=r**2 * time,
        p0=p0**2,
        q_xi=np.zeros(len(structure)),
        xi0=structure.mean,
        xi0_cov=np.diag(structure.sd**2),
        n_unit=structure.n_unit,
    )


def _of_a_tanker(particulars: Particulars) -> FilterSettings:
    """Return the settings of the plain joint UKF for a slow ship of full form.

    She sails a few lengths in the minutes that others are learned in: her filter needs the model
    and the prior of ships. What disturbs her goes by her length alone, see :data:`DISTURBED`, and
    of waves her velocities carry those that are felt, none on a pond: both noises grow with how
    far the innovations exceed what these small ones explain. Wind and current change while she
    sails a length, so that the biases that stand for them wander.

    Source: twin.md sections 14.2 and 14.4.
    """
    L, time = particulars.length, particulars.length / particulars.speed
    along, turning = DISTURBED
    disturbed = np.array([along / L, along / L, turning / L**2])
    calm = plain_settings(particulars, "mmg")
    structure = calm.structure
    mean, covariance = population_prior(structure, particulars)
    wander = np.isin(structure.parameters, WANDERING) * np.diag(covariance) / WANDER_TIME
    return dataclasses.replace(
        calm,
        q=np.concatenate([calm.q[:3], disturbed**2]),
        r=np.array([*5 * (WAVELESS,), WAVELESS_TURN]) ** 2 * calm.r,
        q_xi=wander,
        xi0=mean,
        xi0_cov=DOUBT * covariance,
        waves=(FELT_TIME * time, FELT_NOISE * time, FELT_PUSH / time),
    )


@inlined
def parts(memory, constants, kit):
    """Return x, P, act, wind, q, q_xi, r, p0, lags, envelope, weights and n_unit as views.

    The joint filter has few flat arrays, because each one that a kernel takes costs a call.
    """
    p = kit[0].shape[1]
    n = N_STATES + p
    end = n + n * n
    x, act, wind = memory[:n], memory[end : end + N_ACT], memory[end + N_ACT : end + N_ACT + 2]
    P = shaped(memory, n, (n, n))
    q, q_xi = constants[:N_STATES], constants[N_STATES:n]
    r, p0 = constants[n : n + N_STATES], constants[n + N_STATES : n + 2 * N_STATES]
    rest = constants[n + 2 * N_STATES :]
    return x, P, act, wind, q, q_xi, r, p0, rest[:3], rest[3:6], rest[6:10], rest[10]


@inlined
def wave_parts(memory, constants, kit):
    """Return the mean squares of the waves felt, of u, v, r, and ``FilterSettings.waves``."""
    n = N_STATES + kit[0].shape[1]
    first = n + n * n + N_ACT + 2
    return memory[first : first + 3], constants[constants.shape[0] - 3 :]


@inlined
def rooms(scratch, kit):
    """Return room for Q, q_xi, R, terms, four numbers, six numbers and a roll-out as views."""
    square = N_STATES * N_STATES
    rest = scratch[2 * square :]
    return (
        shaped(scratch, 0, (N_STATES, N_STATES)),
        shaped(scratch, square, (N_STATES, N_STATES)),
        rest[:N_TERMS],
        rest[N_TERMS : N_TERMS + 4],
        rest[N_TERMS + 4 : N_TERMS + 10],
        rest[N_TERMS + 10 : N_TERMS + 10 + ROOM],
        rest[N_TERMS + 10 + ROOM :],
    )


@inlined
def _process_noise(h, memory, constants, kit, Q, qx):
    """Write the process noise of a step of h: Q (6, 6) of the states, qx (p,) of the parameters."""
    _, _, _, _, q, q_xi, _, _, _, _, _, _ = parts(memory, constants, kit)
    felt, waves = wave_parts(memory, constants, kit)
    for i in range(N_STATES):
        Q[i, i] = q[i] * h
    for i in range(3):
        Q[3 + i, 3 + i] += waves[2] * felt[i] * h
    for k in range(q_xi.shape[0]):
        qx[k] = q_xi[k] * h


@kernel
def scale_plan(plan, n_unit, scaled):
    """Write a plan (K, 4) with its shaft speeds in the unit of the structure."""
    for row in range(plan.shape[0]):
        for k in range(2):
            scaled[row, k] = n_unit * plan[row, k]
            scaled[row, 2 + k] = plan[row, 2 + k]


@inlined
def advance(dt, cmd, memory, constants, scratch, work, kit):
    """Predict state, parameters and covariance of the joint filter over dt, actuators included.

    Parameters
    ----------
    dt : float
        Time, s.
    cmd : ndarray, shape (4,)
        Commands of the actuators.
    memory, constants, scratch, work, kit
        Of a :class:`JointUKF`; the memory is advanced in place.
    """
    x, P, act, wind, _, _, _, _, lags, _, weights, n_unit = parts(memory, constants, kit)
    Q, _, terms, _, _, _, qx = rooms(scratch, kit)
    dt = min(dt, GAP_MAX)
    steps = max(1, math.ceil(dt / STEP_MAX - 1e-9))
    h = dt / steps
    _process_noise(h, memory, constants, kit, Q, qx)
    for _ in range(steps):
        follow_all(act, cmd, lags, n_unit, 0.5 * h)
        joint_predict(x, P, act, wind, kit, h, Q, qx, weights, terms, work)
        follow_all(act, cmd, lags, n_unit, 0.5 * h)


@kernel
def see(dt, terms, memory, kit):
    """Add the terms of the moment to what was seen, at SEE_EVERY.

    Parameters
    ----------
    dt : float
        Time since the call before, s.
    terms : ndarray
        All terms of the moment.
    memory, kit
        Of a :class:`JointUKF`. Its memory ends with the time since terms were added, the time
        seen (s), and a Gram matrix for each of surge, sway and yaw.
    """
    n = N_STATES + kit[0].shape[1]
    seen = memory[n + n * n + N_ACT + 5 :]
    seen[0] += dt
    if seen[0] < SEE_EVERY - 1e-9:
        return
    seconds = min(seen[0], SEE_MAX)
    seen[0] = 0.0
    seen[1] += seconds
    first = 2
    for i in range(3):
        low, high = kit[1][3 + i, 0] - N_STATES, kit[1][3 + i, 1] - N_STATES
        size = (high - low) ** 2
        gram = shaped(seen, first, (high - low, high - low))
        accumulate(gram, terms, kit[0][i, low:high], seconds)
        first += size


@inlined
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


@kernel
def _bands(acts, dt, every, memory, constants, scratch, work, kit, copy, out):
    """Write the covariance of the state after each ``every`` rows of a prediction."""
    steps = max(1, math.ceil(dt * every / BAND_STEP - 1e-9))
    h = dt * every / steps
    for k in range(memory.shape[0]):
        copy[k] = memory[k]
    x, P, _, wind, _, _, _, _, _, envelope, weights, _ = parts(copy, constants, kit)
    Q, _, terms, _, _, _, qx = rooms(scratch, kit)
    _process_noise(h, copy, constants, kit, Q, qx)
    for j in range(out.shape[0]):
        last = min((j + 1) * every, acts.shape[0]) - 1
        for _ in range(steps):
            joint_predict(x, P, acts[last], wind, kit, h, Q, qx, weights, terms, work)
            hold_inside(x, envelope)
        for i in range(N_STATES):
            for k in range(N_STATES):
                out[j, i, k] = P[i, k]


@kernel
def _roll(plan, dt, memory, constants, scratch, kit, ripple, scaled, out, acts):
    """Roll the model under a plan whose shaft speeds are in the unit of the particulars."""
    x, _, act, wind, _, _, _, _, lags, envelope, _, n_unit = parts(memory, constants, kit)
    room = rooms(scratch, kit)[5]
    scale_plan(plan, n_unit, scaled)
    s, xi = x[:N_STATES], x[N_STATES:]
    roll_out(s, xi, act, scaled, dt, lags, envelope, wind, kit, ripple, 0.0, out, acts, room)


@kernel
def spread_now(gps_var, P_nav, memory, kit, now):
    """Write how unsure the state is now, as variances on the diagonal of ``now`` (6, 6).

    Other arguments as for :func:`spread_ahead`.
    """
    n = N_STATES + kit[0].shape[1]
    P = shaped(memory, n, (n, n))
    for i in range(N_STATES):
        now[i, i] = P[i, i] + P_nav[i, i] + (gps_var if i < 2 else 0.0)


@kernel
def spread_ahead(command, gps_var, P_nav, memory, constants, scratch, work, kit, copy, now, out):
    """Write how unsure the state will be at LOOK_AHEAD under a held command.

    What :meth:`ModelPredictor.predict` says of the same times, but for how the actuators move.

    Parameters
    ----------
    command : (4,) array
        In the unit of the structure, rad.
    gps_var : float
        Variance of the drifting part of a fix, m2.
    P_nav : (12, 12) array
        Covariance of the navigation.
    memory, constants, scratch, work, kit
        Of a :class:`JointUKF`.
    copy : array
        Room as large as the memory.
    now, out : (6, 6), (4, 6, 6) arrays
        From :func:`spread_now`; covariances ahead, which are written.
    """
    for k in range(memory.shape[0]):
        copy[k] = memory[k]
    x, P, act, wind, _, _, _, _, lags, envelope, weights, _ = parts(copy, constants, kit)
    Q, _, terms, _, _, _, qx = rooms(scratch, kit)
    _process_noise(BAND_STEP, copy, constants, kit, Q, qx)
    before = 0.0
    for j in range(LOOK_AHEAD.shape[0]):
        after = LOOK_AHEAD[j]
        for _ in range(round((after - before) / BAND_STEP)):
            follow_all(act, command, lags, 1.0, 0.5 * BAND_STEP)
            joint_predict(x, P, act, wind, kit, BAND_STEP, Q, qx, weights, terms, work)
            follow_all(act, command, lags, 1.0, 0.5 * BAND_STEP)
            hold_inside(x, envelope)
        before = after
        for i in range(N_STATES):
            # deviations that no boat could have by then
            most = 2.0 * envelope[0] * after + math.sqrt(now[i, i])
            if i == PSI:
                most = 2.0 * min(envelope[2] * after, math.pi) + math.sqrt(now[i, i])
            elif i > PSI:
                most = 2.0 * envelope[i - 3]
            variance = P[i, i] + P_nav[i, i] + (gps_var if i < 2 else 0.0)
            terms[i] = min(1.0, most / math.sqrt(max(variance, 1e-300)))
        for i in range(N_STATES):
            for k in range(N_STATES):
                total = P[i, k] + P_nav[i, k] + (gps_var if i == k and i < 2 else 0.0)
                out[j, i, k] = total * (terms[i] * terms[k])


_NO_RIPPLE = np.empty((0, 3))


class JointUKF:
    """State and parameters of the twin's model in the structured UKF.

    Parameters
    ----------
    particulars : Particulars
        The boat.
    settings : FilterSettings
        Noises and prior.

    Attributes
    ----------
    x, P : ndarray, shapes (6 + p,), (6 + p, 6 + p)
        Mean and covariance: six states, then the parameters.
    act : ndarray, shape (4,)
        Where the actuators are believed to be, in the unit of the structure.
    seen, grams : ndarray, list of three ndarrays
        Time seen (first entry, s), and the Gram matrices of surge, sway and yaw: see
        :func:`twin.identifiability.accumulate`.
    wind : ndarray, shape (2,)
        True wind to north and east, m/s; zeros until it is measured.
    """

    def __init__(self, particulars: Particulars, settings: FilterSettings) -> None:
        self.settings = settings
        self.kit = settings.structure.kit
        n = N_STATES + len(settings.structure)
        self.lags = np.array([particulars.shaft_lag, particulars.steer_lag, particulars.steer_rate])
        U, L = particulars.speed, particulars.length
        self.envelope = np.array([4.0 * U, 4.0 * U, 4.0 * U / L])
        self.weights = scaled_weights(n, settings.alpha, settings.beta, settings.kappa)
        sizes = [b - a for a, b in settings.structure.blocks.values()]
        self.memory = np.zeros(n + n * n + N_ACT + 7 + sum(k * k for k in sizes))
        self.seen = self.memory[n + n * n + N_ACT + 6 :]
        ends = np.cumsum([1, *(k * k for k in sizes)])
        self.grams = [
            self.seen[end - k * k : end].reshape(k, k)
            for k, end in zip(sizes, ends[1:], strict=True)
        ]
        self.constants = np.concatenate(
            [
                *(settings.q, settings.q_xi, settings.r, settings.p0),
                *(self.lags, self.envelope, self.weights),
                *([settings.n_unit], settings.waves),
            ]
        )
        views = in_python(parts)(self.memory, self.constants, self.kit)
        self.x, self.P, self.act, self.wind, self.q, _, self.r, *_ = views
        self.scratch = np.zeros(2 * N_STATES**2 + N_TERMS + 10 + ROOM + n - N_STATES)
        self.work = workspace(N_STATES, n - N_STATES)
        self.arguments = (self.memory, self.constants, self.scratch, self.work, self.kit)
        self._scaled = np.empty((0, 4))
        self._copy = np.empty_like(self.memory)
        self.reset()

    def reset(self) -> None:
        """Go back to the prior."""
        self.memory[:] = 0.0
        self.x[N_STATES:] = self.settings.xi0
        self.P[range(N_STATES), range(N_STATES)] = self.settings.p0
        self.P[N_STATES:, N_STATES:] = self.settings.xi0_cov

    @property
    def xi(self) -> Array:
        """Parameters, a view of shape (p,)."""
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
        _roll(
            *(plan, dt, self.memory, self.constants, self.scratch, self.kit),
            *(_NO_RIPPLE, self._scaled, out, acts),
        )
        return out, acts

    def bands(self, acts: Array, dt: float) -> Array:
        """Return covariances (K, 6, 6) of the states that :meth:`roll` gave with ``acts``."""
        every = max(1, min(round(BAND_STEP / dt), len(acts)))
        coarse = np.zeros((math.ceil(len(acts) / every), N_STATES, N_STATES))
        _bands(acts, dt, every, *self.arguments, self._copy, coarse)
        if every == 1:
            return coarse
        path = np.concatenate([self.P[None, :N_STATES, :N_STATES], coarse])
        return finer(path, every, len(acts))


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
        """Let copies (``copy.deepcopy``, ``pickle``) share memory as the compiled filters need."""
        return copied, (type(self), pack({"it": self}))

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


class Beliefs(NamedTuple):
    """What the models of many boats are rolled from.

    Attributes
    ----------
    places, velocities : ndarray, shape (n, 3)
        Position (m) and heading (rad); speed forward and to starboard (m/s), yaw rate (rad/s).
    parameters : ndarray, shape (n, p)
        Of the structure.
    actuators, winds : ndarray, shapes (n, 4), (n, 2)
        See :func:`twin.model.roll_out`.
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
        One of ``twin.structure.MODELS``; that of :func:`plain_settings` if left out.
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

    @property
    def remembered(self) -> tuple[Array, ...]:
        """All that the filter remembers; arrays whose rows stand for boats in a batch."""
        return self.nav, self.ukf.memory

    @property
    def shared(self) -> tuple[Any, ...]:
        """What twins of like boats can share, in the order of :func:`tight_step`."""
        _, settings, nav_work, _, *rest = self._arguments
        return settings, nav_work, *rest

    def beliefs(self, *remembered: Array) -> Beliefs:
        """Return what :func:`twin.model.roll_out` needs, of many boats, as views.

        Parameters
        ----------
        *remembered : ndarrays
            As :attr:`remembered`, but with a row for each boat.
        """
        memory, n = remembered[1], len(self.ukf.x)
        end = n + n * n
        return Beliefs(
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
        """Take one row; see :meth:`twin.predictor.Predictor.update`."""
        self.t = t
        tight_step(dt, z, cmd, *self._arguments)
