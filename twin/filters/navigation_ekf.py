"""The tight GPS/IMU/compass filter: where the boat is and how it moves, without a ship model.

An extended Kalman filter with twelve states

    n = (x, y, psi, u, v, r, b_gyro, b_ax, b_ay, b_compass, t_x, t_y)

(north and east in m, heading in rad, velocity over the ground forward and starboard in m/s,
yaw rate in rad/s, the biases of gyro, accelerometers and compass, and the gravity that tilt
lets into each accelerometer, m/s2: first-order Gauss-Markov, as are the biases, but fast).
The accelerometers drive u and v; GPS position, GPS velocity, compass and gyro are measured
one number after the other, so that any of them may be missing in any row. Antenna and IMU may
sit off the origin.

A GPS sample is ``gps_latency`` old, and is compared with where the antenna was then. For that
a ring holds the recent path by dead reckoning alone: what was corrected since is taken as an
error of heading and velocity that was there all the time.

Where the accelerometers are missing, the accelerations of a model may be handed in; without
one, velocities are held.

No sample, besides NaN, is

- a number that no boat gives (:data:`SPEED_LIMIT` and others);
- one further than :data:`GATE` standard deviations off, until so many in a row were refused
  that the filter must be the one that is wrong: then it starts anew from that number. An
  acceleration is refused where it leaps from one row to the next;
- a frozen one: a sensor all of whose given numbers repeat to the last bit has said nothing
  new, be it that it is stuck or that the log has more rows than the sensor has samples. But
  a number may also stay because nothing moves, or because it is rounded. So once it has
  stayed for :data:`FROZEN_TIME`, a fix or heading that is within its standard deviation of
  what the filter expects counts as new. An IMU that repeats is always one that says nothing.

The filter knows nothing of waves: what it says moves with them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.checkpoint import FLAG, Field, State, check_fields, fill
from twin.particulars import GRAVITY, Particulars
from usv_kernel.jit import kernel
from usv_kernel.scalar import wrap
from usv_kernel.simd import accumulate_rows, combine

__all__ = [
    "GPS_AGE",
    "N_NAV",
    "Navigator",
    "aid_velocity",
    "navigate",
    "navigation_settings",
]

Array = NDArray[np.float64]

N_NAV = 12

WORK_ROWS = N_NAV + 4

GATE = 6.0
"""Standard deviations beyond which a number is refused ..."""

REFUSED_MAX = 20.0
"""... unless this many in a row were refused, one that comes after a pause of 1 s counting
for :data:`REFUSED_RATE`."""

REFUSED_RATE = 5.0

SPEED_LIMIT, TURN_LIMIT, ACCEL_LIMIT, REACH, ROUNDS = 20.0, 10.0, 50.0, 1e7, 1e5
"""No boat does more: speed in usual speeds, yaw rate in rad/s, specific force in m/s2,
position in m, and heading in rad (not wrapped). Numbers beyond are no samples."""

FROZEN_TIME = 2.0
"""Seconds after which numbers that do not change may mean a boat that does not move."""

STEP_MAX = 0.1
"""Longest step of the prediction, s; longer gaps are cut up."""

GAP_MAX = 600.0
"""A gap longer than this, s, is predicted through as if it were this long."""

AIDED, AIDED_TURN = 0.05, 0.05
"""How far velocity and yaw rate of a model wander in one L/U, in U and U/L."""

_VARIANCE_MIN = 1e-12
"""Below this a variance is rounding."""

_SHARP = 1e4
"""A correction that shrinks a variance by more than this may leave rounding behind."""

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
    _AIDED_DENSITY,
    _VELOCITY_VAR_0,
    _R_VAR_0,
    _R_AIDED_DENSITY,
    _COMPASS_BIAS_VAR,
    _TILT_VAR,
    _TILT_TIME,
    _GPS_X,
    _GPS_Y,
    _IMU_X,
    _IMU_Y,
    _LEAP,
) = range(23)

# entries of the status: flags, ages (s), runs of refused numbers, samples of the row before,
# how long they have stayed (s), clock (s), path by dead reckoning, sums of corrections, ring,
# whether a number was taken by force
READY_FIX, READY_HEADING, GPS_AGE, COMPASS_AGE, IMU_AGE, REFUSED = 0, 1, 2, 3, 4, 5

_LAST = REFUSED + 8

_STAYED = _LAST + 8

_CLOCK = _STAYED + 3

# integrals of speed north and east, cos and sin of the heading; all without corrections
_PATH = _CLOCK + 1

# of heading, u, v
_CORRECTED = _PATH + 4

_COUNT = _CORRECTED + 3

_RING = _COUNT + 1

_ROWS, _COLUMNS = 64, 9

_LOST = _RING + _ROWS * _COLUMNS

STATUS_SIZE = _LOST + 1


def navigation_settings(particulars: Particulars) -> Array:
    """Return the packed settings of the filter for a boat.

    Parameters
    ----------
    particulars : Particulars
        Length, speed and instruments are used; what no data sheet states scales with speed
        and length (Froude).

    Returns
    -------
    ndarray, shape (23,)
    """
    I, U, L = particulars.instruments, particulars.speed, particulars.length
    accel = U * U / L
    turn = U / L
    tilt = GRAVITY * I.tilt_sd
    return np.array(
        [
            I.gps_sd**2 + I.gps_bias_sd**2,
            I.doppler_sd**2,
            I.compass_sd**2,
            I.gyro_sd**2,
            max(I.gyro_bias_sd**2, _VARIANCE_MIN),
            I.accel_sd**2,
            I.accel_bias_sd**2,
            I.gps_latency,
            200.0,
            (0.5 * turn) ** 2 * turn,  # yaw rate wanders by half its size in one L/U
            (0.25 * U) ** 2 * turn,  # velocity without accelerometers, likewise
            (AIDED * U) ** 2 * turn,
            U**2,
            turn**2,
            (AIDED_TURN * turn) ** 2 * turn,
            max(I.compass_bias_sd**2, _VARIANCE_MIN),
            max(tilt**2, _VARIANCE_MIN),
            I.tilt_time,
            *I.gps_arm,
            *I.imu_arm,
            0.5 * accel + 8.0 * math.hypot(I.accel_sd, 0.5 * tilt),
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
def _mend(P, root):
    """Drop the correlations of a covariance that rounding has left without Cholesky factor."""
    for i in range(N_NAV):
        for j in range(i + 1):
            rest = P[i, j]
            for k in range(j):
                rest -= root[i, k] * root[j, k]
            if j < i:
                root[i, j] = rest / root[j, j]
            elif rest > 1e-11 * P[i, i]:
                root[i, i] = math.sqrt(rest)
            else:
                for a in range(N_NAV):
                    for b in range(a):
                        P[a, b] = 0.0
                        P[b, a] = 0.0
                return


@kernel
def _predict(n, P, h, ax, ay, accel_var, driven, r_mean, r_rate, r_var, settings, path, A):
    """Advance mean and covariance by h; ``driven`` says that ax, ay are specific forces.

    ``r_mean`` is the yaw rate in the middle of the step, ``r_rate`` its growth where nothing
    will be measured.
    """
    u, v, r = n[3], n[4], n[5]
    psi = n[2] + 0.5 * h * r_mean
    c, s = math.cos(psi), math.sin(psi)
    if driven:
        ax -= n[7] + n[10]
        ay -= n[8] + n[11]
        u_mean = u + 0.5 * h * (ax + v * r_mean)
        v_mean = v + 0.5 * h * (ay - u * r_mean)
        ax += v_mean * r_mean
        ay -= u_mean * r_mean
    else:
        u_mean, v_mean = u + 0.5 * h * ax, v + 0.5 * h * ay
    north, east = u_mean * c - v_mean * s, u_mean * s + v_mean * c
    # first five rows of A P; A = I + h F
    for k in range(N_NAV):
        A[0, k] = P[0, k] + h * (P[3, k] * c - P[4, k] * s - P[2, k] * east)
        A[1, k] = P[1, k] + h * (P[3, k] * s + P[4, k] * c + P[2, k] * north)
        A[2, k] = P[2, k] + h * P[5, k]
    if driven:
        for k in range(N_NAV):
            A[3, k] = P[3, k] + h * (r * P[4, k] + v * P[5, k] - P[7, k] - P[10, k])
            A[4, k] = P[4, k] - h * (r * P[3, k] + u * P[5, k] + P[8, k] + P[11, k])
    else:
        for k in range(N_NAV):
            A[3, k] = P[3, k]
            A[4, k] = P[4, k]
    # their part of (A P) A'; the rest of the columns stays
    for i in range(5):
        for k in range(5, N_NAV):
            P[i, k] = A[i, k]
            P[k, i] = A[i, k]
        P[i, 0] = A[i, 0] + h * (A[i, 3] * c - A[i, 4] * s - A[i, 2] * east)
        P[i, 1] = A[i, 1] + h * (A[i, 3] * s + A[i, 4] * c + A[i, 2] * north)
        P[i, 2] = A[i, 2] + h * A[i, 5]
        if driven:
            P[i, 3] = A[i, 3] + h * (r * A[i, 4] + v * A[i, 5] - A[i, 7] - A[i, 10])
            P[i, 4] = A[i, 4] - h * (r * A[i, 3] + u * A[i, 5] + A[i, 8] + A[i, 11])
        else:
            P[i, 3] = A[i, 3]
            P[i, 4] = A[i, 4]
    for i in range(5):
        for k in range(i):
            P[i, k] = P[k, i]
    decay = h / settings[_BIAS_TIME]
    P[3, 3] += accel_var
    P[4, 4] += accel_var
    P[5, 5] += r_var
    P[6, 6] += 2.0 * decay * (settings[_GYRO_BIAS_VAR] - P[6, 6])
    P[7, 7] += 2.0 * decay * (settings[_ACCEL_BIAS_VAR] - P[7, 7])
    P[8, 8] += 2.0 * decay * (settings[_ACCEL_BIAS_VAR] - P[8, 8])
    P[9, 9] += 2.0 * decay * (settings[_COMPASS_BIAS_VAR] - P[9, 9])
    stay = math.exp(-h / settings[_TILT_TIME])
    for i in range(10, N_NAV):
        for k in range(N_NAV):
            P[i, k] *= stay
            P[k, i] *= stay
        P[i, i] += (1.0 - stay * stay) * settings[_TILT_VAR]
        n[i] *= stay
    _cap(P, settings)
    n[0] += h * north
    n[1] += h * east
    n[2] += h * r_mean
    n[3] += h * ax
    n[4] += h * ay
    n[5] += h * r_rate
    for i in range(6, 10):
        n[i] *= 1.0 - decay
    fastest = SPEED_LIMIT * math.sqrt(settings[_VELOCITY_VAR_0])
    n[3] = min(max(n[3], -fastest), fastest)
    n[4] = min(max(n[4], -fastest), fastest)
    n[5] = min(max(n[5], -TURN_LIMIT), TURN_LIMIT)
    # the same step without the corrections that were made so far
    c, s = math.cos(psi - path[4]), math.sin(psi - path[4])
    path[0] += h * ((u_mean - path[5]) * c - (v_mean - path[6]) * s)
    path[1] += h * ((u_mean - path[5]) * s + (v_mean - path[6]) * c)
    path[2] += h * c
    path[3] += h * s


@kernel
def _correct(n, P, H, innovation, variance, age, status, channel, gain, A):
    """Correct by one number with measurement row H; return False where it is refused.

    ``age`` is the time since the sensor's last sample, s; a channel below 0 refuses nothing.
    """
    S = _gain(P, H, variance, gain)
    if channel >= 0:
        if innovation * innovation > GATE * GATE * S:
            status[REFUSED + channel] += max(1.0, REFUSED_RATE * age)
            if status[REFUSED + channel] <= REFUSED_MAX:
                return False
            # the filter is lost: take the number as if nothing had been known
            status[_LOST] = 1.0
            for i in range(6):
                size = H[i] * H[i]
                # a jump of the position says nothing of the heading
                if size > 0.25 and (channel > 1 or i == channel):
                    P[i, i] += innovation * innovation / max(size, 1.0)
            S = _gain(P, H, variance, gain)
        status[REFUSED + channel] = 0.0
    step = innovation / S
    for i in range(N_NAV):
        n[i] += gain[i] * step
    for i in range(3):
        status[_CORRECTED + i] += gain[2 + i] * step
    root = 1.0 / math.sqrt(S)
    for i in range(N_NAV):
        gain[i] *= root
    accumulate_rows(P, 0, N_NAV, N_NAV, N_NAV, gain, 0, 1, -1.0, gain, 0, N_NAV, 1)
    for i in range(N_NAV):
        P[i, i] = max(P[i, i], _VARIANCE_MIN)
    if S / variance > _SHARP:
        _mend(P, A)
    return True


@kernel
def _forget_biases(n, P, settings):
    """Begin anew with what was learned from numbers that have turned out to be false."""
    for i in range(6, N_NAV):
        for k in range(N_NAV):
            P[i, k] = 0.0
            P[k, i] = 0.0
        n[i] = 0.0
    P[6, 6] = settings[_GYRO_BIAS_VAR]
    P[7, 7] = P[8, 8] = settings[_ACCEL_BIAS_VAR]
    P[9, 9] = settings[_COMPASS_BIAS_VAR]
    P[10, 10] = P[11, 11] = settings[_TILT_VAR]


@kernel
def _gain(P, H, variance, gain):
    """Write P H' and return the variance of the innovation."""
    S = variance
    combine(gain, 0, N_NAV, H, 0, 1, 1.0, P, 0, N_NAV, N_NAV)
    for i in range(N_NAV):
        S += H[i] * gain[i]
    return max(S, variance)  # rounding apart it is no less


@kernel
def aid_velocity(n, P, u, v, variance, status, H, gain):
    """Correct the velocity by what a model says of it.

    Parameters
    ----------
    n, P : ndarray, shapes (12,), (12, 12)
        State and covariance, corrected in place.
    u, v : float
        Velocity over the ground that the model gives, m/s.
    variance : float
        Of each, (m/s)^2.
    status, H, gain : ndarray
        Status and scratch as in :func:`navigate`.
    """
    aid(n, P, 3, u, variance, status, H, gain)
    aid(n, P, 4, v, variance, status, H, gain)


@kernel
def aid(n, P, entry, value, variance, status, H, gain):
    """Correct one entry of the state by what a model says of it; see :func:`aid_velocity`."""
    for i in range(N_NAV):
        H[i] = 0.0
    H[entry] = 1.0
    # a model is never so much surer than the filter that the covariance needs mending, for
    # which there is no scratch here
    variance = max(variance, 2.0 * P[entry, entry] / _SHARP)
    _correct(n, P, H, value - n[entry], variance, 0.0, status, -1, gain, P)


@kernel
def _start(n, P, z, settings, status):
    """Take heading and fix as they come, until both are there."""
    speed = settings[_VELOCITY_VAR_0]
    fastest = SPEED_LIMIT * math.sqrt(speed)
    if abs(z[4]) < ROUNDS:
        n[2] = z[4]
        status[READY_HEADING] = 1.0
    if abs(z[0]) < REACH and abs(z[1]) < REACH:
        n[0], n[1] = z[0], z[1]
        n[3] = n[4] = 0.0
        if abs(z[2]) < fastest and abs(z[3]) < fastest:
            n[3], n[4] = z[2], z[3]
        status[READY_FIX] = 1.0
        status[GPS_AGE] = 0.0
    if abs(z[5]) < TURN_LIMIT:
        n[5] = z[5]
    if status[READY_FIX] * status[READY_HEADING] == 0.0:
        return
    old = settings[_LATENCY] + status[GPS_AGE]
    c, s = math.cos(n[2]), math.sin(n[2])
    forward, side = settings[_GPS_X], settings[_GPS_Y]
    north, east = n[3], n[4]
    n[0] += old * north - c * forward + s * side
    n[1] += old * east - s * forward - c * side
    n[3] = north * c + east * s + n[5] * side
    n[4] = east * c - north * s - n[5] * forward
    P[0, 0] = P[1, 1] = settings[_GPS_VAR] + old * old * speed
    P[2, 2] = settings[_COMPASS_VAR] + settings[_COMPASS_BIAS_VAR]
    P[2, 9] = P[9, 2] = -settings[_COMPASS_BIAS_VAR]
    status[GPS_AGE] = status[COMPASS_AGE] = status[IMU_AGE] = 0.0


@kernel
def _same(z, status, sensor, first, last, dt):
    """Return whether all numbers that a sensor gives are those that it gave last."""
    given, same = False, True
    for j in range(first, last):
        if math.isfinite(z[j]):
            given = True
            same = same and z[j] == status[_LAST + j]
    status[_STAYED + sensor] += dt
    if not given:
        return False
    if not same:
        status[_STAYED + sensor] = 0.0
        for j in range(first, last):
            status[_LAST + j] = z[j]
    return same


@kernel
def _remember(n, status, settings):
    """Write the present into the ring, unless the last entry is too near."""
    count = int(status[_COUNT])
    newest = _RING + _COLUMNS * ((count - 1) % _ROWS)
    if count > 0:
        apart = settings[_LATENCY] / (_ROWS - 4)
        if status[_CLOCK] - status[newest] < apart:
            return
    row = _RING + _COLUMNS * (count % _ROWS)
    _present(n, status, status[row : row + _COLUMNS])
    # the remainder alone counts, and that the ring is full
    status[_COUNT] = count + 1 if count + 1 < 2 * _ROWS else _ROWS


@kernel
def _present(n, status, row):
    """Write time, path, and heading, u, v without corrections, then yaw rate."""
    row[0] = status[_CLOCK]
    for i in range(4):
        row[1 + i] = status[_PATH + i]
    for i in range(3):
        row[5 + i] = n[2 + i] - status[_CORRECTED + i]
    row[8] = n[5]


@kernel
def _back_then(n, status, settings, past):
    """Write where the boat was when the fix was taken.

    ``past`` becomes the way made since to north and east (m), the integrals of cos and sin
    of the heading (s), and then heading, u, v and r of that time.
    """
    _present(n, status, past)
    late = settings[_LATENCY]
    if late > 0.0:
        then = status[_CLOCK] - late
        count = int(status[_COUNT])
        depth = min(count, _ROWS)
        newer = past
        share = 0.0
        older = past
        for back in range(1, depth + 1):
            row = _RING + _COLUMNS * ((count - back) % _ROWS)
            newer, older = older, status[row : row + _COLUMNS]
            if older[0] <= then:
                break
        span = newer[0] - older[0]
        # before the oldest entry, the way goes on as it began
        if span > 0.0:
            share = min((newer[0] - then) / span, 1e3)
        for i in range(_COLUMNS):
            # ``newer`` may be ``past`` itself
            past[i] = (
                newer[i] + share * (older[i] - newer[i]) if i < 5 or share <= 1.0 else older[i]
            )
    turned, du, dv = status[_CORRECTED], status[_CORRECTED + 1], status[_CORRECTED + 2]
    c, s = math.cos(turned), math.sin(turned)
    C, S = status[_PATH + 2] - past[3], status[_PATH + 3] - past[4]
    north = status[_PATH] - past[1] + du * C - dv * S
    east = status[_PATH + 1] - past[2] + du * S + dv * C
    past[0], past[1] = c * north - s * east, s * north + c * east
    past[2], past[3] = c * C - s * S, s * C + c * S
    past[4], past[5], past[6] = past[5] + turned, past[6] + du, past[7] + dv
    past[7] = past[8]


@kernel
def _take_fix(n, P, z, dt, repeats, settings, status, H, gain, A, past, before):
    """Correct by position and velocity of the antenna when the fix was taken."""
    _back_then(n, status, settings, past)
    for i in range(N_NAV):
        before[i] = n[i]
    c, s = math.cos(past[4]), math.sin(past[4])
    late, age = settings[_LATENCY], status[GPS_AGE]
    # what velocity gains on its way from then to now, that nobody knows of
    drift = settings[_ACCEL_VAR] * min(dt, STEP_MAX) * late
    drift += settings[_TILT_VAR] * late * min(late, 2.0 * settings[_TILT_TIME])
    drift += max(P[7, 7], P[8, 8]) * late * late
    # ... shared by all fixes of that time
    drift *= max(late / max(age, dt, 1e-3), 1.0)
    gps_var = settings[_GPS_VAR] + drift * late * late / 3.0
    doppler_var = settings[_DOPPLER_VAR] + drift
    fastest = SPEED_LIMIT * math.sqrt(settings[_VELOCITY_VAR_0])
    forward, side = settings[_GPS_X], settings[_GPS_Y]
    for j in range(4):
        if not abs(z[j]) < (REACH if j < 2 else fastest):
            continue
        for i in range(6):
            H[i] = 0.0
        if j == 0:
            expected = before[0] - past[0] + c * forward - s * side
            H[0], H[2], H[3], H[4] = 1.0, past[1] - s * forward - c * side, -past[2], past[3]
        elif j == 1:
            expected = before[1] - past[1] + s * forward + c * side
            H[1], H[2], H[3], H[4] = 1.0, c * forward - s * side - past[0], -past[3], -past[2]
        else:
            u, v = past[5] - past[7] * side, past[6] + past[7] * forward
            north, east = u * c - v * s, u * s + v * c
            if j == 2:
                expected = north
                H[2], H[3], H[4], H[5] = -east, c, -s, -c * side - s * forward
            else:
                expected = east
                H[2], H[3], H[4], H[5] = north, s, c, c * forward - s * side
        innovation = z[j] - expected
        for i in range(6):
            innovation -= H[i] * (n[i] - before[i])
        variance = gps_var if j < 2 else doppler_var
        if repeats and innovation * innovation > variance:
            return
        if _correct(n, P, H, innovation, variance, age, status, j, gain, A):
            status[GPS_AGE] = 0.0


@kernel
def navigate(n, P, dt, z, model, settings, status, work):
    """Take one row of measurements.

    Parameters
    ----------
    n, P : ndarray, shapes (12,), (12, 12)
        State and covariance, advanced in place.
    dt : float
        Time since the row before, s; 0 or more.
    z : ndarray, shape (10,)
        Measurement row in the order of ``twin.logs.log.MEASUREMENTS``; NaN is missing.
    model : ndarray, shape (4,)
        Accelerations u', v' (m/s2), r' (rad/s2) for where the IMU is missing, and their use:
        1 if a model gave them, 0 if there is none and velocities are held.
    settings : ndarray, shape (23,)
        From :func:`navigation_settings`.
    status : ndarray, shape (STATUS_SIZE,)
        Two flags (fix and heading there), ages of the last GPS, compass and IMU sample (s),
        runs of refused numbers, and what the filter remembers; advanced in place.
    work : ndarray, shape (WORK_ROWS, 12)
        Scratch.
    """
    H, gain, A = work[0], work[1], work[2 : 2 + N_NAV]
    dt = min(max(dt, 0.0), GAP_MAX)
    status[_CLOCK] += dt
    status[GPS_AGE] += dt
    status[COMPASS_AGE] += dt
    status[IMU_AGE] += dt
    last_gyro = status[_LAST + 5]
    last_x, last_y = status[_LAST + 6], status[_LAST + 7]
    gps_repeats = _same(z, status, 0, 0, 4, dt)
    compass_repeats = _same(z, status, 1, 4, 5, dt)
    imu = not _same(z, status, 2, 5, 8, dt)
    if status[READY_FIX] * status[READY_HEADING] == 0.0:
        _start(n, P, z, settings, status)
        if status[READY_FIX] * status[READY_HEADING] > 0.0:
            _remember(n, status, settings)
        return
    # a gyro that follows its row before, and an IMU whose arm it can be used for
    follows = dt > 0.0 and dt <= STEP_MAX and status[IMU_AGE] <= 1.5 * dt
    gyro = imu and abs(z[5]) < TURN_LIMIT
    driven = imu and abs(z[6]) < ACCEL_LIMIT and abs(z[7]) < ACCEL_LIMIT
    if driven and follows:
        leap = max(abs(z[6] - last_x), abs(z[7] - last_y))
        if leap > settings[_LEAP] and status[REFUSED + 6] < 0.5 * REFUSED_MAX:
            status[REFUSED + 6] += 1.0
            driven = False
            status[_LAST + 6], status[_LAST + 7] = last_x, last_y
        else:
            status[REFUSED + 6] = 0.0
    # what a model gives for this moment does not last through a gap
    modelled = model[3] > 0.0 and dt * dt * settings[_R_VAR_0] <= 1.0
    r_rate, r_mean, r_var = 0.0, n[5], settings[_R_DENSITY]
    if gyro:
        change = z[5] - n[6] - n[5]
        S = P[5, 5] + 2.0 * P[5, 6] + P[6, 6] + settings[_GYRO_VAR] + r_var * dt
        if change * change < GATE * GATE * S:
            r_mean += 0.5 * change
    elif modelled:
        r_rate, r_var = model[2], settings[_R_AIDED_DENSITY]
    steps = max(1, math.ceil(dt / STEP_MAX - 1e-9))
    h = dt / steps
    ax, ay, held = 0.0, 0.0, settings[_HELD_DENSITY] * h
    if modelled:
        ax, ay, held = model[0], model[1], settings[_AIDED_DENSITY] * h
    path = status[_PATH:_COUNT]
    for j in range(steps):
        # a sample is the mean over its interval; a gap is not filled with it
        if driven and j == steps - 1:
            forward, side = settings[_IMU_X], settings[_IMU_Y]
            turn = r_mean * r_mean
            spin = (z[5] - last_gyro) / dt if gyro and follows else 0.0
            if not abs(spin) * STEP_MAX < 1.0:
                spin = 0.0
            force_x = z[6] + turn * forward + spin * side
            force_y = z[7] + turn * side - spin * forward
            var = settings[_ACCEL_VAR] * h * h
            _predict(
                *(n, P, h, force_x, force_y, var, True, r_mean, r_rate, r_var * h),
                *(settings, path, A),
            )
        else:
            if not gyro:
                r_mean = n[5] + 0.5 * h * r_rate
            _predict(n, P, h, ax, ay, held, False, r_mean, r_rate, r_var * h, settings, path, A)
    if steps > 1:
        _mend(P, A)

    for i in range(N_NAV):
        H[i] = 0.0
    if gyro:
        H[5] = H[6] = 1.0
        innovation = z[5] - n[5] - n[6]
        age = status[IMU_AGE]
        if _correct(n, P, H, innovation, settings[_GYRO_VAR], age, status, 5, gain, A):
            status[IMU_AGE] = 0.0
        H[5] = H[6] = 0.0
    if abs(z[4]) < ROUNDS:
        innovation = wrap(z[4] - n[2] - n[9])
        var, age = settings[_COMPASS_VAR], status[COMPASS_AGE]
        if not compass_repeats or (
            status[_STAYED + 1] >= FROZEN_TIME and innovation * innovation < var
        ):
            H[2] = H[9] = 1.0
            if _correct(n, P, H, innovation, var, age, status, 4, gain, A):
                status[COMPASS_AGE] = 0.0
            H[2] = H[9] = 0.0
    if not gps_repeats or status[_STAYED] >= FROZEN_TIME:
        _take_fix(
            *(n, P, z, dt, gps_repeats, settings, status),
            *(H, gain, A, work[2 + N_NAV], work[3 + N_NAV]),
        )
    if status[_LOST] > 0.0:
        status[_LOST] = 0.0
        _forget_biases(n, P, settings)
    _remember(n, status, settings)


def initial_navigation(settings: Array) -> tuple[Array, Array, Array]:
    """Return state (12,), covariance (12, 12) and status of a filter that knows nothing."""
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
            settings[_COMPASS_BIAS_VAR],
            settings[_TILT_VAR],
            settings[_TILT_VAR],
        ]
    )
    status = np.zeros(STATUS_SIZE)
    status[_LAST:_STAYED] = math.nan
    return np.zeros(N_NAV), P, status


def navigation_views(n: Array, P: Array, status: Array) -> dict[str, Array]:
    """Return what the filter remembers as fields by name, which are views."""
    places = {
        "ready": (READY_FIX, GPS_AGE),
        "ages": (GPS_AGE, REFUSED),
        "refused": (REFUSED, _LAST),
        "last_samples": (_LAST, _STAYED),
        "unchanged_for": (_STAYED, _CLOCK),
        "clock": (_CLOCK, _PATH),
        "dead_reckoning": (_PATH, _CORRECTED),
        "corrected": (_CORRECTED, _COUNT),
        "ring_count": (_COUNT, _RING),
        "ring": (_RING, _LOST),
        "lost": (_LOST, STATUS_SIZE),
    }
    views = {name: status[a:b] for name, (a, b) in places.items()}
    return {"mean": n, "covariance": P, **views}


NAVIGATION_FIELDS = {
    "covariance": Field(covariance=True),
    "ready": FLAG,
    "ages": Field(low=0.0),
    "refused": Field(low=0.0),
    "last_samples": Field(nan=True, infinite=True),
    "unchanged_for": Field(low=0.0),
    "clock": Field(low=0.0),
    "ring_count": Field(low=0.0, high=2.0 * _ROWS, integer=True),
    "lost": FLAG,
}
"""What the fields of :func:`navigation_views` may hold."""


class Navigator:
    """The filter with its arrays, for those who need no model.

    Parameters
    ----------
    particulars : Particulars
        The boat and its instruments.

    Attributes
    ----------
    n, P : ndarray, shapes (12,), (12, 12)
        State and covariance.
    """

    def __init__(self, particulars: Particulars) -> None:
        self._settings = navigation_settings(particulars)
        self._work = np.zeros((WORK_ROWS, N_NAV))
        self._model = np.zeros(4)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.n, self.P, self.status = initial_navigation(self._settings)

    def _views(self) -> dict[str, Array]:
        return navigation_views(self.n, self.P, self.status)

    def state_dict(self) -> State:
        """Return all that is remembered, as fields by name."""
        return {name: view.copy() for name, view in self._views().items()}

    def load_state_dict(self, state: State) -> None:
        """Take over what :meth:`state_dict` returned."""
        check_fields(state, self._views(), NAVIGATION_FIELDS)
        fill(self._views(), state)

    @property
    def ready(self) -> bool:
        """True once a fix and a heading have come."""
        return bool(self.status[READY_FIX] and self.status[READY_HEADING])

    @property
    def state(self) -> Array:
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
