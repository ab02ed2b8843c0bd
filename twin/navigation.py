"""The tight GPS/IMU/compass filter: where the boat is and how it moves, without a ship model.

An extended Kalman filter with nine states

    n = (x, y, psi, u, v, r, b_gyro, b_ax, b_ay)

(north and east in m, heading in rad, velocity over the ground forward and starboard in m/s,
yaw rate in rad/s, and the biases of gyro and accelerometers). The accelerometers drive u and
v; GPS position, GPS velocity, compass and gyro are measured one number after the other, so
that any of them may be missing in any row. GPS samples are taken as being ``gps_latency``
old: the filter compares them with where it was then.

Where the accelerometers are missing, the accelerations of a model may be handed in; without
one, velocities are held. A number further than :data:`GATE` standard deviations off is
refused, until so many in a row were refused that the filter must be the one that is wrong.

The filter knows nothing of waves: what it says moves with them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.particulars import Particulars
from usv_kernel import kernel, wrap

__all__ = ["GPS_AGE", "N_NAV", "Navigator", "aid_velocity", "navigate", "navigation_settings"]

Array = NDArray[np.float64]

N_NAV = 9
GATE = 6.0
"""Standard deviations beyond which a number is refused ..."""
REFUSED_MAX = 20
"""... unless this many in a row were refused."""
SPEED_LIMIT, TURN_LIMIT, ACCEL_LIMIT, REACH = 20.0, 10.0, 50.0, 1e7
"""No boat does more: speed in usual speeds, yaw rate in rad/s, specific force in m/s2, and
position in m. Numbers beyond are no samples."""
STEP_MAX = 0.1
"""Longest step of the prediction, s; longer gaps are cut up."""

_VARIANCE_MIN = 1e-14
"""Below this a variance is rounding."""

# entries of the settings
(
    _GPS_VAR,
    _DOPPLER_VAR,
    _COMPASS_VAR,
    _GYRO_VAR,
    _GYRO_BIAS_VAR,
    _ACCEL_VAR,
    _ACCEL_BIAS_VAR,
    _LATENCY,
    _BIAS_TIME,
    _R_DENSITY,
    _HELD_DENSITY,
    _AIDED_VAR,
    _VELOCITY_VAR_0,
    _R_VAR_0,
) = range(14)

# entries of the status
READY_FIX, READY_HEADING, GPS_AGE, COMPASS_AGE, IMU_AGE, REFUSED = 0, 1, 2, 3, 4, 5
STATUS_SIZE = REFUSED + 6


def navigation_settings(particulars: Particulars) -> Array:
    """Return the packed settings of the filter for a boat.

    Parameters
    ----------
    particulars : Particulars
        Length, speed and instruments are used; what no data sheet states scales with speed
        and length (Froude).

    Returns
    -------
    ndarray, shape (14,)
    """
    I, U, L = particulars.instruments, particulars.speed, particulars.length
    accel = U * U / L
    turn = U / L
    return np.array(
        [
            I.gps_sd**2 + I.gps_bias_sd**2,
            I.doppler_sd**2,
            I.compass_sd**2,
            I.gyro_sd**2,
            I.gyro_bias_sd**2,
            I.accel_sd**2,
            I.accel_bias_sd**2,
            I.gps_latency,
            200.0,
            (0.5 * turn) ** 2 * turn,  # yaw rate wanders by half its size in one L/U
            (0.25 * U) ** 2 * turn,  # velocity without accelerometers, likewise
            (0.1 * accel) ** 2,
            U**2,
            turn**2,
        ]
    )


@kernel
def _cap(P, settings):
    """Keep variances below what can be; one that is cut also loses its correlations.

    Left with them it would be a gain that is too large, and the filter would run away.
    """
    speed, turn = settings[_VELOCITY_VAR_0], settings[_R_VAR_0]
    for i in range(6):
        top = 1e8 * speed / turn  # ten thousand lengths
        if i == 2:
            top = 40.0
        elif i == 5:
            top = 100.0 * turn
        elif i > 2:
            top = 100.0 * speed
        if not P[i, i] <= top:
            for k in range(N_NAV):
                P[i, k] = 0.0
                P[k, i] = 0.0
            P[i, i] = top


@kernel
def _predict(n, P, h, ax, ay, accel_var, driven, r_rate, settings, A):
    """Advance mean and covariance by h; ``driven`` says that ax, ay are specific forces."""
    psi, u, v, r = n[2], n[3], n[4], n[5]
    c, s = math.cos(psi), math.sin(psi)
    for i in range(N_NAV):
        for k in range(N_NAV):
            A[i, k] = P[i, k]
    # A P, row by row; A = I + h F
    for k in range(N_NAV):
        px = P[2, k] * (-u * s - v * c) + P[3, k] * c - P[4, k] * s
        py = P[2, k] * (u * c - v * s) + P[3, k] * s + P[4, k] * c
        A[0, k] += h * px
        A[1, k] += h * py
        A[2, k] += h * P[5, k]
        if driven:
            A[3, k] += h * (r * P[4, k] + v * P[5, k] - P[7, k])
            A[4, k] += h * (-r * P[3, k] - u * P[5, k] - P[8, k])
    # (A P) A'
    for k in range(N_NAV):
        px = A[k, 2] * (-u * s - v * c) + A[k, 3] * c - A[k, 4] * s
        py = A[k, 2] * (u * c - v * s) + A[k, 3] * s + A[k, 4] * c
        P[k, 0] = A[k, 0] + h * px
        P[k, 1] = A[k, 1] + h * py
        P[k, 2] = A[k, 2] + h * A[k, 5]
        P[k, 3] = A[k, 3]
        P[k, 4] = A[k, 4]
        if driven:
            P[k, 3] += h * (r * A[k, 4] + v * A[k, 5] - A[k, 7])
            P[k, 4] += h * (-r * A[k, 3] - u * A[k, 5] - A[k, 8])
        for j in range(5, N_NAV):
            P[k, j] = A[k, j]
    decay = h / settings[_BIAS_TIME]
    P[3, 3] += accel_var
    P[4, 4] += accel_var
    P[5, 5] += settings[_R_DENSITY] * h
    P[6, 6] += 2.0 * decay * (settings[_GYRO_BIAS_VAR] - P[6, 6])
    P[7, 7] += 2.0 * decay * (settings[_ACCEL_BIAS_VAR] - P[7, 7])
    P[8, 8] += 2.0 * decay * (settings[_ACCEL_BIAS_VAR] - P[8, 8])
    for i in range(N_NAV):
        for k in range(i):
            P[i, k] = 0.5 * (P[i, k] + P[k, i])
            P[k, i] = P[i, k]
    _cap(P, settings)
    n[0] += h * (u * c - v * s)
    n[1] += h * (u * s + v * c)
    n[2] += h * (r + 0.5 * h * r_rate)
    if driven:
        n[3] += h * (ax - n[7] + v * r)
        n[4] += h * (ay - n[8] - u * r)
    else:
        n[3] += h * ax
        n[4] += h * ay
    n[5] += h * r_rate
    for i in range(6, N_NAV):
        n[i] *= 1.0 - decay
    fastest = SPEED_LIMIT * math.sqrt(settings[_VELOCITY_VAR_0])
    n[3] = min(max(n[3], -fastest), fastest)
    n[4] = min(max(n[4], -fastest), fastest)
    n[5] = min(max(n[5], -TURN_LIMIT), TURN_LIMIT)


@kernel
def _correct(n, P, H, innovation, variance, status, channel, gain):
    """Correct by one number with measurement row H; refuse it where it is far off."""
    S = _gain(P, H, variance, gain)
    if channel >= 0:
        if innovation * innovation > GATE * GATE * S:
            status[REFUSED + channel] += 1.0
            if status[REFUSED + channel] <= REFUSED_MAX:
                return
            # the filter is lost: take the number as if nothing had been known
            for i in range(N_NAV):
                if H[i] * H[i] > 0.25:
                    P[i, i] += innovation * innovation
            S = _gain(P, H, variance, gain)
        status[REFUSED + channel] = 0.0
    for i in range(N_NAV):
        n[i] += gain[i] / S * innovation
    for i in range(N_NAV):
        for k in range(i + 1):
            P[i, k] -= gain[i] * gain[k] / S
            P[k, i] = P[i, k]
        P[i, i] = max(P[i, i], _VARIANCE_MIN)


@kernel
def _gain(P, H, variance, gain):
    """Write P H' and return the variance of the innovation."""
    S = variance
    for i in range(N_NAV):
        gain[i] = 0.0
        for k in range(N_NAV):
            gain[i] += P[i, k] * H[k]
    for i in range(N_NAV):
        S += H[i] * gain[i]
    return S


@kernel
def aid_velocity(n, P, u, v, variance, status, H, gain):
    """Correct the velocity by what a model says of it.

    Parameters
    ----------
    n, P : ndarray, shapes (9,), (9, 9)
        State and covariance, corrected in place.
    u, v : float
        Velocity over the ground that the model gives, m/s.
    variance : float
        Of each, (m/s)^2.
    status, H, gain : ndarray
        Status and scratch as in :func:`navigate`.
    """
    for j in range(2):
        for i in range(N_NAV):
            H[i] = 0.0
        H[3 + j] = 1.0
        _correct(n, P, H, (u if j == 0 else v) - n[3 + j], variance, status, -1, gain)


@kernel
def _start(n, P, z, settings, status):
    """Take the first heading and the first fix as they come."""
    if status[READY_HEADING] == 0.0 and math.isfinite(z[4]):
        n[2] = z[4]
        P[2, 2] = settings[_COMPASS_VAR]
        status[READY_HEADING] = 1.0
    if status[READY_FIX] == 0.0 and abs(z[0]) < REACH and abs(z[1]) < REACH:
        n[0], n[1] = z[0], z[1]
        P[0, 0] = P[1, 1] = settings[_GPS_VAR]
        status[READY_FIX] = 1.0
        fastest = SPEED_LIMIT * math.sqrt(settings[_VELOCITY_VAR_0])
        doppler = abs(z[2]) < fastest and abs(z[3]) < fastest
        if doppler and status[READY_HEADING] > 0.0:
            c, s = math.cos(n[2]), math.sin(n[2])
            n[3], n[4] = z[2] * c + z[3] * s, z[3] * c - z[2] * s
    if abs(z[5]) < TURN_LIMIT:
        n[5] = z[5]


@kernel
def navigate(n, P, dt, z, model, settings, status, work):
    """Take one row of measurements.

    Parameters
    ----------
    n, P : ndarray, shapes (9,), (9, 9)
        State and covariance, advanced in place.
    dt : float
        Time since the row before, s; 0 or more.
    z : ndarray, shape (10,)
        Measurement row in the order of ``twin.log.MEASUREMENTS``; NaN is missing.
    model : ndarray, shape (4,)
        Accelerations u', v' (m/s2), r' (rad/s2) for where the IMU is missing, and their use:
        1 if a model gave them, 0 if there is none and velocities are held.
    settings : ndarray, shape (14,)
        From :func:`navigation_settings`.
    status : ndarray, shape (11,)
        Two flags (fix and heading there), ages of the last GPS, compass and IMU sample (s),
        and runs of refused numbers; advanced in place.
    work : ndarray, shape (11, 9)
        Scratch.
    """
    H, gain, A = work[0], work[1], work[2:]
    status[GPS_AGE] += dt
    status[COMPASS_AGE] += dt
    status[IMU_AGE] += dt
    if status[READY_FIX] * status[READY_HEADING] == 0.0:
        _start(n, P, z, settings, status)
        if status[READY_FIX] * status[READY_HEADING] > 0.0:
            status[GPS_AGE] = status[COMPASS_AGE] = status[IMU_AGE] = 0.0
        return
    driven = abs(z[6]) < ACCEL_LIMIT and abs(z[7]) < ACCEL_LIMIT
    gyro = abs(z[5]) < TURN_LIMIT
    steps = max(1, math.ceil(dt / STEP_MAX - 1e-9))
    h = dt / steps
    if driven:
        ax, ay, var = z[6], z[7], settings[_ACCEL_VAR] * dt * dt / steps
    elif model[3] > 0.0:
        ax, ay, var = model[0], model[1], settings[_AIDED_VAR] * h
    else:
        ax, ay, var = 0.0, 0.0, settings[_HELD_DENSITY] * h
    r_rate = model[2] * model[3] if not gyro else 0.0
    for j in range(steps):
        # a sample is the mean over its interval; a gap is not filled with it
        use = driven and (steps == 1 or j == steps - 1)
        if driven and not use:
            _predict(n, P, h, 0.0, 0.0, settings[_HELD_DENSITY] * h, False, 0.0, settings, A)
        else:
            _predict(n, P, h, ax, ay, var, driven, r_rate, settings, A)

    for i in range(N_NAV):
        H[i] = 0.0
    if gyro:
        H[5] = H[6] = 1.0
        _correct(n, P, H, z[5] - n[5] - n[6], settings[_GYRO_VAR], status, 5, gain)
        H[5] = H[6] = 0.0
        status[IMU_AGE] = 0.0
    if math.isfinite(z[4]):
        H[2] = 1.0
        _correct(n, P, H, wrap(z[4] - n[2]), settings[_COMPASS_VAR], status, 4, gain)
        H[2] = 0.0
        status[COMPASS_AGE] = 0.0
    late = settings[_LATENCY]
    for j in range(2):
        if not abs(z[j]) < REACH:
            continue
        c, s = math.cos(n[2]), math.sin(n[2])
        velocity = n[3] * c - n[4] * s if j == 0 else n[3] * s + n[4] * c
        for i in range(N_NAV):
            H[i] = 0.0
        H[j] = 1.0
        H[2] = -late * (-n[3] * s - n[4] * c if j == 0 else n[3] * c - n[4] * s)
        H[3] = -late * (c if j == 0 else s)
        H[4] = -late * (-s if j == 0 else c)
        innovation = z[j] - (n[j] - late * velocity)
        _correct(n, P, H, innovation, settings[_GPS_VAR], status, j, gain)
        status[GPS_AGE] = 0.0
    fastest = SPEED_LIMIT * math.sqrt(settings[_VELOCITY_VAR_0])
    for j in range(2):
        if not abs(z[2 + j]) < fastest:
            continue
        c, s = math.cos(n[2]), math.sin(n[2])
        a, b = 0.0, 0.0
        if driven:
            a, b = ax - n[7], ay - n[8]
        elif model[3] > 0.0:
            a, b = ax - n[4] * n[5], ay + n[3] * n[5]
        else:
            a, b = -n[4] * n[5], n[3] * n[5]
        velocity = n[3] * c - n[4] * s if j == 0 else n[3] * s + n[4] * c
        change = a * c - b * s if j == 0 else a * s + b * c
        for i in range(N_NAV):
            H[i] = 0.0
        H[2] = -n[3] * s - n[4] * c if j == 0 else n[3] * c - n[4] * s
        H[3] = c if j == 0 else s
        H[4] = -s if j == 0 else c
        innovation = z[2 + j] - (velocity - late * change)
        _correct(n, P, H, innovation, settings[_DOPPLER_VAR], status, 2 + j, gain)
        status[GPS_AGE] = 0.0


def initial_navigation(settings: Array) -> tuple[Array, Array, Array]:
    """Return state (9,), covariance (9, 9) and status (11,) of a filter that knows nothing."""
    P = np.diag(
        [
            settings[_GPS_VAR],
            settings[_GPS_VAR],
            settings[_COMPASS_VAR],
            settings[_VELOCITY_VAR_0],
            settings[_VELOCITY_VAR_0],
            settings[_R_VAR_0],
            settings[_GYRO_BIAS_VAR],
            settings[_ACCEL_BIAS_VAR],
            settings[_ACCEL_BIAS_VAR],
        ]
    )
    return np.zeros(N_NAV), P, np.zeros(STATUS_SIZE)


class Navigator:
    """The filter with its arrays, for those who need no model.

    Parameters
    ----------
    particulars : Particulars
        The boat and its instruments.

    Attributes
    ----------
    n, P : ndarray, shapes (9,), (9, 9)
        State and covariance.
    """

    def __init__(self, particulars: Particulars) -> None:
        self._settings = navigation_settings(particulars)
        self._work = np.zeros((2 + N_NAV, N_NAV))
        self._model = np.zeros(4)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.n, self.P, self.status = initial_navigation(self._settings)

    @property
    def ready(self) -> bool:
        """True once a fix and a heading have come."""
        return bool(self.status[READY_FIX] and self.status[READY_HEADING])

    @property
    def s(self) -> Array:
        """State (x, y, psi, u, v, r), a view."""
        return self.n[:6]

    def update(self, dt: float, z: ArrayLike) -> Array:
        """Take one row of measurements; see :func:`navigate`.

        Parameters
        ----------
        dt : float
            Time since the row before, s.
        z : array_like, shape (10,)
            Measurement row.

        Returns
        -------
        ndarray, shape (6,)
            State (x, y, psi, u, v, r), a view.
        """
        z = np.ascontiguousarray(z, dtype=np.float64)
        navigate(self.n, self.P, dt, z, self._model, self._settings, self.status, self._work)
        return self.n[:6]
