"""What the attitude filters remember of one boat, and what they are given."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin.particulars import GRAVITY, Particulars
from usv_kernel.records import record_size
from usv_kernel.scalar import rotation

__all__ = [
    "AHRS_ERROR",
    "ANGLE",
    "ATTITUDE",
    "ATTITUDE_SETTINGS",
    "CLIMB",
    "GRAVITY_ERROR",
    "HEAVE",
    "HEAVE_CORNER_MAX_RADPS",
    "HEAVE_CORNER_SHARE",
    "HEIGHT_ERROR",
    "LATE_FIX_ROWS",
    "LIFT_BIAS",
    "NO_SAMPLE_AGE_S",
    "N_TILT",
    "N_VERTICAL",
    "RATE_BIAS",
    "RATE_RMS_RADPS",
    "SLOW_HEAVE_SD_M",
    "attitude_settings",
    "initial_attitude",
    "wave_density",
]

Array = NDArray[np.float64]

ANGLE, RATE_BIAS, AHRS_ERROR, GRAVITY_ERROR = range(4)
"""State of a tilt filter: roll or pitch (rad), bias of its gyro (rad/s), errors of the AHRS and of
the angle that the accelerometers show (rad)."""

N_TILT = 4

HEAVE, CLIMB, LIFT_BIAS, HEIGHT_ERROR = range(4)
"""State of the vertical filter: heave (m) and vertical speed (m/s), both down; bias of the vertical
acceleration (m/s2), and error of the GNSS height (m)."""

N_VERTICAL = 4

LATE_FIX_ROWS = 64
"""Past rows that are kept for late fixes."""

GYRO_BIAS_TIME_S = 300.0
ACCEL_BIAS_TIME_S = 110.0
HEIGHT_BIAS_TIME_S = 400.0
"""Time constants of the biases of gyros, accelerometers and GNSS height, s."""

AHRS_WHITE_SHARE = 0.1
"""Standard deviation of the white part of an AHRS's error, as a share of the whole."""

NO_SAMPLE_AGE_S = 1e9
"""Age of a sample that has not come yet, s."""

WAVE_ACCEL_MPS2 = 0.15
WAVE_ACCEL_MIN_MPS2 = 0.03
WAVE_ACCEL_MAX_MPS2 = 0.6
"""Horizontal acceleration in waves that velocities do not show: at the start, and its bounds
once innovations show it."""

WAVE_ACCEL_TIME_S = 0.5
"""Correlation time of that acceleration."""

INNOVATION_MEAN_S = 5.0
INNOVATION_FORGETTING_S = 60.0
"""Time constants of the mean innovation, and of its mean square, from which it is found."""

CLIMB_TIMEOUT_S = 2.0
"""Age of the last vertical speed of the GNSS from which on heave comes from the IMU alone."""

HEAVE_CORNER_SHARE = 0.2
HEAVE_CORNER_MIN_RADPS = 0.15
HEAVE_CORNER_MAX_RADPS = 0.6
"""Corner frequency of the high-pass filter of heave without GNSS, as a share of the frequency of
the waves, and its bounds."""

RATE_RMS_RADPS = 0.3
RATE_DERIVATIVE_RMS_RADPS2 = 0.75
"""Root mean squares of the rate of roll or pitch and of its derivative, before a gyro was seen."""

WAVE_FREQUENCY_TIME_S = 60.0
WAVE_SPEED_LEAK_S = 4.0
"""Time constants of the mean squares that give the frequency of the waves, and of the leaky
integral of the vertical acceleration among them."""

HEAVE_FORGETTING_S = 15.0
SLOW_HEAVE_SD_M = 0.025
"""Time constant in which heave returns to its mean, and standard deviation of slower heave."""

ATTITUDE = np.dtype(
    [
        ("tilt", "f8", (2, N_TILT)),  # roll filter and pitch filter, see ANGLE
        ("P", "f8", (2 * N_TILT, 2 * N_TILT)),  # covariance of both
        ("vertical", "f8", N_VERTICAL),  # see HEAVE
        ("P_vertical", "f8", (N_VERTICAL, N_VERTICAL)),
        ("rate", "f8", 3),  # body rates of the last row without biases, rad/s
        ("turning", "f8", 3),  # their time derivatives, rad/s2
        ("force", "f8", 3),  # specific force of the origin in the last row, m/s2
        ("lift", "f8"),  # vertical acceleration of the last row, down, m/s2
        ("wave_speed", "f8"),  # its leaky integral, m/s
        ("wave_power", "f8", 2),  # mean squares of that and of the acceleration
        ("innovation", "f8", (2, 2)),  # mean angle that gravity shows beside the filter's, rad ...
        # ... and the spectral density of what it is made of, rad2 s; of roll and pitch
        ("velocity", "f8", 2),  # horizontal velocity of the row before, m/s; NaN before the first
        ("ages", "f8", 7),  # time since the last new sample of each motion channel, s
        ("last", "f8", 7),  # that sample; NaN before the first
        ("refused", "f8", 7),  # runs of refused samples
        ("nis", "f8", 2),  # mean square of the innovations of the AHRS over their variance
        (
            "doubted",
            "f8",
            (2, 2),
        ),  # how long gyro and AHRS of roll and pitch are in doubt, s
        ("own", "f8", 2),  # roll and pitch by gyros and gravity alone, rad
        ("by_gravity", "f8", (2, 2)),  # mean squares of what gravity shows less these, ...
        # ... and less the AHRS, rad2
        ("planar", "f8", 3),  # last yaw rate, specific force forward and to starboard
        ("planar_new", "f8"),  # 1 where those of this row are new
        ("planar_ages", "f8", 3),  # time since the last new one of each, s
        ("rows", "f8"),  # rows taken
        ("turned", "f8", 2),  # integrals of the rates of roll and pitch, rad
        ("rate_power", "f8", (2, 2)),  # mean squares of the rates of roll and pitch, (rad/s)2 ...
        # ... and of their derivatives, (rad/s2)2
        ("ring", "f8", (LATE_FIX_ROWS, 4)),  # time, roll, pitch, vertical speed of past rows
        ("turned_ring", "f8", (LATE_FIX_ROWS, 2)),  # those integrals in the same rows
    ]
)
"""One boat. All are float64, so that it fits into flat memory."""

ATTITUDE_SETTINGS = np.dtype(
    [
        # standard deviations
        ("gyro", "f8"),  # white, rad/s per sample
        ("gyro_bias", "f8"),  # rad/s
        ("accel", "f8"),  # white, m/s2 per sample
        ("accel_bias", "f8"),  # m/s2
        ("ahrs", "f8"),  # rad
        ("ahrs_time", "f8"),  # s, how long its error lasts
        ("height", "f8"),  # white, m
        ("height_bias", "f8"),  # m
        ("climb", "f8"),  # white, m/s
        ("latency", "f8"),  # s, age of a fix
        ("ahrs_latency", "f8"),  # s, age of roll and pitch of an AHRS
        ("imu_arm", "f8", 3),  # m forward, to starboard, down
        ("gps_arm", "f8", 3),
        ("mounting", "f8", (3, 3)),  # turns a vector of the IMU into the boat's axes
    ]
)


def wave_density(accel: float) -> float:
    """Return the spectral density of the angle that gravity shows, rad2 s.

    ``accel`` is the horizontal acceleration that is taken for gravity, m/s2: it lasts for
    :data:`WAVE_ACCEL_TIME_S`.
    """
    return 2.0 * WAVE_ACCEL_TIME_S * (accel / GRAVITY) ** 2


def initial_attitude() -> Array:
    """Return the memory of a boat before its first row: :data:`ATTITUDE` as flat float64."""
    memory = np.zeros(record_size(ATTITUDE))
    record = memory.view(ATTITUDE)[0]
    for name in ("velocity", "last", "planar"):
        record[name] = np.nan
    record["ages"] = record["planar_ages"] = NO_SAMPLE_AGE_S
    return memory


def attitude_settings(particulars: Particulars) -> Array:
    """Return :data:`ATTITUDE_SETTINGS` of a boat as flat float64."""
    board = particulars.instruments
    memory = np.zeros(record_size(ATTITUDE_SETTINGS))
    record = memory.view(ATTITUDE_SETTINGS)[0]
    record["gyro"], record["gyro_bias"] = board.gyro_sd, board.gyro_bias_sd
    record["accel"], record["accel_bias"] = board.accel_sd, board.accel_bias_sd
    record["ahrs"], record["ahrs_time"] = board.ahrs_sd, board.ahrs_time
    record["height"], record["height_bias"] = board.height_sd, board.height_bias_sd
    record["climb"], record["latency"] = board.climb_sd, board.gps_latency
    record["ahrs_latency"] = board.ahrs_latency
    record["imu_arm"], record["gps_arm"] = board.imu_arm, board.gps_arm
    record["mounting"] = rotation(board.imu_mounting)
    return memory
