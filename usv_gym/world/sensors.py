"""Sensors of a boat: noisy, biased, late, tilted with the boat, and sometimes lost."""

from __future__ import annotations

import math

import numpy as np

from usv_gym.physics import GRAVITY
from usv_gym.physics import frames as fr
from usv_gym.world.faults import STRUCK
from usv_gym.world.sampling import drift, is_due
from usv_gym.world.sensor_suite import GRADES, SUITE, SensorSuite
from usv_kernel.channels import (
    ACCEL_X,
    ACCEL_Y,
    COMPASS,
    GPS_VX,
    GPS_VY,
    GPS_X,
    GPS_Y,
    GYRO,
    MOTION_CHANNELS,
    SENSOR_CHANNELS,
)
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import Record, as_record, record_size

__all__ = [
    "DELAYED",
    "GRADES",
    "MOTION_NOISE_SIZE",
    "NOISE",
    "NOISE_SIZE",
    "SENSORS",
    "SUITE",
    "WIND_AT",
    "SensorSuite",
    "measure",
    "start_motion_sensors",
    "start_sensors",
]

NOISE = np.dtype(
    [
        # white noise of each channel, then what drives its bias; all standard normal
        ("gps", float, 4),
        ("gps_bias", float, 2),
        ("compass", float),
        ("compass_bias", float),
        ("gyro", float),
        ("accel", float, 2),
        ("gyro_bias", float),
        ("accel_bias", float, 2),
    ]
)
"""Random numbers of one control step."""

NOISE_SIZE = record_size(NOISE)

WIND_AT = len(SENSOR_CHANNELS) + len(MOTION_CHANNELS)
"""Place of the first of WIND_CHANNELS in a row of measurements."""

MOTION_NOISE = np.dtype(
    [
        # the same for what six degrees of freedom add
        ("gyro", float, 2),
        ("gyro_bias", float, 2),
        ("accel", float),
        ("accel_bias", float),
        ("ahrs", float, 2),
        ("ahrs_bias", float, 2),
        ("height", float),
        ("height_bias", float),
        ("climb", float),
    ]
)
"""More random numbers of one control step, with six degrees of freedom."""

MOTION_NOISE_SIZE = record_size(MOTION_NOISE)

DELAY_LINE = np.dtype(
    [
        ("fix", float, 6),  # antenna: m north and east, their speeds (m/s), down, its speed
        ("heading", float),  # rad
        ("tilt", float, 2),  # roll and pitch, rad
        ("rate", float, 3),  # of the body, rad/s
        ("force", float, 3),  # specific force at the IMU, in the boat's axes, m/s2
    ]
)
"""What the sensors measure of one control step, without errors, as it waits for their latency."""

DELAYED = record_size(DELAY_LINE)

HEIGHT, CLIMB = 4, 5
"""Places of position and velocity down in a fix."""

SENSORS = np.dtype(
    [
        ("gps_bias", float, 2),  # m, north and east
        ("compass_bias", float),  # rad
        ("gyro_bias", float),  # rad/s
        ("accel_bias", float, 2),  # m/s2, forward and starboard
        ("gyro_xy_bias", float, 2),  # rad/s, about the axes forward and to starboard
        ("accel_z_bias", float),  # m/s2
        ("ahrs_bias", float, 2),  # rad, roll and pitch
        ("height_bias", float),  # m
        ("climb_bias", float),  # m/s
        ("wind_bias", float),  # m/s
        ("wind_from_bias", float),  # rad
        ("wind", float, 2),  # apparent wind of this step before any fault, m/s and rad
        (
            "last",
            float,
            STRUCK,
        ),  # what was handed out last, NaN before the first; see faults.strike
    ]
)
"""Memory of the sensors of one boat."""


@kernel
def start_sensors(suite: Record, numbers: np.ndarray, sensors: Record) -> None:
    """Initialise the memory of the sensors: settled biases, and no sample.

    Parameters
    ----------
    suite : record of :data:`SUITE`
        Errors of the sensors.
    numbers : ndarray, shape (14 + 3 F,)
        Random numbers of a step; the first are those of :data:`NOISE`.
    sensors : record of :data:`SENSORS`
        Written.
    """
    noise = as_record(numbers, NOISE)
    sensors.gps_bias[0] = suite.gps_bias * noise.gps_bias[0]
    sensors.gps_bias[1] = suite.gps_bias * noise.gps_bias[1]
    sensors.compass_bias = suite.compass_bias * noise.compass_bias
    sensors.gyro_bias = suite.gyro_bias * noise.gyro_bias
    sensors.accel_bias[0] = suite.accel_bias * noise.accel_bias[0]
    sensors.accel_bias[1] = suite.accel_bias * noise.accel_bias[1]
    sensors.wind[:] = math.nan
    sensors.last[:] = math.nan


@kernel
def start_motion_sensors(suite: Record, numbers: np.ndarray, sensors: Record) -> None:
    """Write settled biases of the sensors of roll, pitch and heave.

    ``numbers`` (13,) are those of :data:`MOTION_NOISE`; see :func:`start_sensors`.
    """
    noise = as_record(numbers, MOTION_NOISE)
    for i in range(2):
        sensors.gyro_xy_bias[i] = suite.gyro_bias * noise.gyro_bias[i]
        sensors.ahrs_bias[i] = suite.ahrs_bias * noise.ahrs_bias[i]
    sensors.accel_z_bias = suite.accel_bias * noise.accel_bias
    sensors.height_bias = suite.height_bias * noise.height_bias
    sensors.climb_bias = suite.climb_bias * noise.height_bias


@inlined
def _mounted(mounting: np.ndarray, vector: np.ndarray, i: int) -> float:
    """Return the part of a vector of the boat along axis i of the IMU."""
    return mounting[i, 0] * vector[0] + mounting[i, 1] * vector[1] + mounting[i, 2] * vector[2]


@kernel
def measure(
    boat: Record,
    dt: float,
    suite: Record,
    numbers: np.ndarray,
    motion_numbers: np.ndarray,
    delay_line: np.ndarray,
) -> None:
    """Write the measurements of a boat's sensors, without faults.

    The IMU measures specific force where it sits, along its own axes. Gravity leaks into the
    horizontal ones with roll and pitch: with a = nu' + omega x nu of the origin,
    ``f = a + omega' x r + omega x (omega x r) - R^T (0, 0, g)``.

    Source: Fossen 2021, Eq 14.16-14.20; docs/explanation/ship_and_sea.md, Sensors.

    Parameters
    ----------
    boat : record of :data:`usv_gym.world.state.BOAT`
        State, mean rate over the step and time are read; ``sensors`` is advanced; ``measurement``
        is written, NaN where there is no new sample.
    dt : float
        Time over which the mean rate is the mean, s; 0 at the start.
    suite : record of :data:`SUITE`
        Errors and rates.
    numbers : ndarray, shape (14,)
        Random numbers of this step, :data:`NOISE`.
    motion_numbers : ndarray, shape (13,) or (0,)
        :data:`MOTION_NOISE`; none with three degrees of freedom, whose boats have no such sensors.
    delay_line : ndarray, shape (D, 15)
        :data:`DELAY_LINE` of the past steps, one more than the longest latency; advanced in place.
    """
    sensors, z = boat.sensors, boat.measurement
    noise, count = as_record(numbers, NOISE), int(boat.step)
    if count > 0:
        gps, accel = sensors.gps_bias, sensors.accel_bias
        for i in range(2):
            gps[i] = drift(gps[i], suite.gps_bias, suite.gps_decay, noise.gps_bias[i])
            accel[i] = drift(accel[i], suite.accel_bias, suite.accel_decay, noise.accel_bias[i])
        sensors.compass_bias = drift(
            sensors.compass_bias, suite.compass_bias, suite.compass_decay, noise.compass_bias
        )
        sensors.gyro_bias = drift(
            sensors.gyro_bias, suite.gyro_bias, suite.gyro_decay, noise.gyro_bias
        )
    rows = delay_line.shape[0]
    _sample_exact(boat, dt, suite, as_record(delay_line[count % rows], DELAY_LINE))
    for i in range(z.shape[0]):
        z[i] = math.nan
    # a sensor with latency gives nothing until its first sample is old enough
    due = (
        _arrives(count, suite.gps_delay, suite.gps_share),
        _arrives(count, suite.imu_delay, suite.imu_share),
        suite.ahrs_share > 0.0 and _arrives(count, suite.ahrs_delay, suite.ahrs_share),
    )
    fix = as_record(delay_line[(count - int(suite.gps_delay)) % rows], DELAY_LINE).fix
    imu = as_record(delay_line[(count - int(suite.imu_delay)) % rows], DELAY_LINE)
    if due[0]:
        z[GPS_X] = fix[GPS_X] + sensors.gps_bias[0] + suite.gps_white * noise.gps[0]
        z[GPS_Y] = fix[GPS_Y] + sensors.gps_bias[1] + suite.gps_white * noise.gps[1]
        z[GPS_VX] = fix[GPS_VX] + suite.doppler_white * noise.gps[2]
        z[GPS_VY] = fix[GPS_VY] + suite.doppler_white * noise.gps[3]
    if _arrives(count, suite.compass_delay, suite.compass_share):
        old = as_record(delay_line[(count - int(suite.compass_delay)) % rows], DELAY_LINE)
        z[COMPASS] = old.heading + sensors.compass_bias + suite.compass_white * noise.compass
    if due[1]:
        mounting = suite.imu_mounting
        z[GYRO] = _mounted(mounting, imu.rate, 2) + sensors.gyro_bias
        z[GYRO] += suite.gyro_white * noise.gyro
        z[ACCEL_X] = _mounted(mounting, imu.force, 0) + sensors.accel_bias[0]
        z[ACCEL_Y] = _mounted(mounting, imu.force, 1) + sensors.accel_bias[1]
        z[ACCEL_X] += suite.accel_white * noise.accel[0]
        z[ACCEL_Y] += suite.accel_white * noise.accel[1]
    if motion_numbers.shape[0] > 0:
        tilt = as_record(delay_line[(count - int(suite.ahrs_delay)) % rows], DELAY_LINE).tilt
        _measure_motion(boat, suite, motion_numbers, due, (fix, imu, tilt))
    if suite.wind_share > 0.0:
        for i in range(2):
            z[WIND_AT + i] = sensors.wind[i]


@inlined
def _arrives(count, delay, share):
    """Return whether a sample that is late by some steps comes with this one."""
    return count >= delay and is_due(count - int(delay), share)


@inlined
def _sample_exact(boat, dt, suite, newest):
    """Write what the sensors measure at this moment, without errors, to the delay line."""
    state, mean_rate = boat.state, boat.mean_rate
    phi, theta, psi = state[fr.PHI], state[fr.THETA], state[fr.PSI]
    p, q, r = state[fr.P], state[fr.Q], state[fr.R]
    newest.heading = psi
    newest.tilt[0], newest.tilt[1] = phi, theta
    newest.rate[0], newest.rate[1], newest.rate[2] = p, q, r
    ahead, side, low = suite.gps_arm[0], suite.gps_arm[1], suite.gps_arm[2]
    north, east, down = fr.rotate(phi, theta, psi, ahead, side, low)
    v_north, v_east, v_down = fr.rotate(
        phi,
        theta,
        psi,
        state[fr.U] + (q * low - r * side),
        state[fr.V] + (r * ahead - p * low),
        state[fr.W] + (p * side - q * ahead),
    )
    fix = newest.fix
    fix[GPS_X], fix[GPS_Y] = state[fr.X] + north, state[fr.Y] + east
    fix[GPS_VX], fix[GPS_VY] = v_north, v_east
    fix[HEIGHT], fix[CLIMB] = state[fr.Z] + down, v_down
    if not is_due(int(boat.step), suite.imu_share):
        return
    half = 0.5 * dt
    u = state[fr.U] - half * mean_rate[fr.U]
    v = state[fr.V] - half * mean_rate[fr.V]
    w = state[fr.W] - half * mean_rate[fr.W]
    p -= half * mean_rate[fr.P]
    q -= half * mean_rate[fr.Q]
    r -= half * mean_rate[fr.R]
    phi -= half * mean_rate[fr.PHI]
    theta -= half * mean_rate[fr.THETA]
    ahead, side, low = suite.imu_arm[0], suite.imu_arm[1], suite.imu_arm[2]
    # omega x r, the velocity of the IMU relative to the origin
    u_arm, v_arm, w_arm = q * low - r * side, r * ahead - p * low, p * side - q * ahead
    x_arm = mean_rate[fr.Q] * low - mean_rate[fr.R] * side + q * w_arm - r * v_arm
    y_arm = mean_rate[fr.R] * ahead - mean_rate[fr.P] * low + r * u_arm - p * w_arm
    z_arm = mean_rate[fr.P] * side - mean_rate[fr.Q] * ahead + p * v_arm - q * u_arm
    f_x = mean_rate[fr.U] - v * r + w * q + x_arm + GRAVITY * math.sin(theta)
    f_y = mean_rate[fr.V] + u * r - w * p + y_arm
    f_y -= GRAVITY * math.cos(theta) * math.sin(phi)
    f_z = mean_rate[fr.W] + v * p - u * q + z_arm
    f_z -= GRAVITY * math.cos(theta) * math.cos(phi)
    newest.force[0], newest.force[1], newest.force[2] = f_x, f_y, f_z


@inlined
def _measure_motion(boat, suite, numbers, due, exact):
    """Write roll, pitch and heave as an IMU of three axes, an AHRS and GNSS measure them.

    ``due`` is whether GNSS, IMU and AHRS have a sample, ``exact`` what they measured, without
    errors.
    """
    sensors, z = boat.sensors, boat.measurement[len(SENSOR_CHANNELS) :]
    noise, mounting = as_record(numbers, MOTION_NOISE), suite.imu_mounting
    has_fix, has_imu, has_tilt = due
    fix, imu, tilt = exact
    gyro, ahrs = sensors.gyro_xy_bias, sensors.ahrs_bias
    if boat.step > 0.0:
        for i in range(2):
            gyro[i] = drift(gyro[i], suite.gyro_bias, suite.gyro_decay, noise.gyro_bias[i])
            ahrs[i] = drift(ahrs[i], suite.ahrs_bias, suite.ahrs_decay, noise.ahrs_bias[i])
        sensors.accel_z_bias = drift(
            sensors.accel_z_bias, suite.accel_bias, suite.accel_decay, noise.accel_bias
        )
        sensors.height_bias = drift(
            sensors.height_bias, suite.height_bias, suite.height_decay, noise.height_bias
        )
        sensors.climb_bias = drift(
            sensors.climb_bias, suite.climb_bias, suite.height_decay, noise.height_bias
        )
    if has_imu:
        for i in range(2):
            z[i] = _mounted(mounting, imu.rate, i) + gyro[i] + suite.gyro_white * noise.gyro[i]
        z[2] = _mounted(mounting, imu.force, 2) + sensors.accel_z_bias
        z[2] += suite.accel_white * noise.accel
    if has_tilt:
        z[3] = tilt[0] + ahrs[0] + suite.ahrs_white * noise.ahrs[0]
        z[4] = tilt[1] + ahrs[1] + suite.ahrs_white * noise.ahrs[1]
    if has_fix:
        z[5] = fix[HEIGHT] + sensors.height_bias + suite.height_white * noise.height
        z[6] = fix[CLIMB] + sensors.climb_bias + suite.climb_white * noise.climb
