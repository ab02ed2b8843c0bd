"""State, settings and memory of the navigation filter, by name.

The state is n = (x, y, psi, u, v, r, b_gyro, b_ax, b_ay, b_compass, t_x, t_y): see
:mod:`twin.filters.navigation_ekf`. What has one size for every boat is a record of a structured
dtype on flat memory. Kernels and Python read and write the same names, and a record goes into a
call as one pointer.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.channels import MEASUREMENTS, STATE
from twin.particulars import GRAVITY, Particulars

__all__ = [
    "NAVIGATION",
    "NAVIGATION_SETTINGS",
    "NAVIGATION_WORK",
    "N_NAV",
    "RESTART",
    "initial_navigation",
    "largest_leap",
    "navigation_settings",
    "sample_limits",
]

Array = NDArray[np.float64]

N_NAV = 12

GYRO_BIAS, ACCEL_X_BIAS, ACCEL_Y_BIAS, COMPASS_BIAS, TILT_X, TILT_Y = range(len(STATE), N_NAV)
"""Places in the filter's state after x, y, psi, u, v, r: biases of the sensors, and the specific
force that tilt lets in."""

IMU_LEAPS = 6
"""Place of the IMU's leaps among the runs of refused numbers."""

IS_MODELLED = 3
"""Place of the flag, after a model's u', v', r', that they are given."""

MODEL_VARIANCES = 4
"""Place of the variances of u', v', r' after the flag."""

N_MODELLED = 7
"""Accelerations of a model, the flag, and variances."""

RING_ROWS = 64
RING_COLUMNS = 9

SPEED_LIMIT = 20.0
TURN_LIMIT = 10.0
ACCEL_LIMIT = 50.0
POSITION_MAX_M = 1e7
HEADING_MAX_RAD = 1e5
"""Limits of valid samples: speed in nominal speeds, yaw rate in rad/s, specific force in m/s2,
position in m, and unwrapped heading in rad."""

WIND_LIMIT = 100.0
"""Limit of a valid wind speed, m/s."""

AIDED_WANDER = 0.05
AIDED_YAW_WANDER = 0.05
"""Random walk of a model's velocity (U) and yaw rate (U/L) in one L/U, standard deviations."""

VARIANCE_MIN = 1e-12
"""Smallest variance; a smaller one is a rounding error."""

RESTART = np.dtype(
    [
        ("lost", "f8"),  # 1 where the navigation does not know where it is, whatever it claims
        ("position", "f8"),  # 1 where all of the state begins again, ...
        ("heading", "f8"),  # ... heading and yaw rate do, ...
        ("surge", "f8"),  # ... or surge and sway do
        ("state", "f8", len(STATE)),  # with this ...
        ("cov", "f8", (len(STATE), len(STATE))),  # ... and this covariance
    ]
)
"""Where the navigation begins again, as a sensor that it used was at fault."""

NAVIGATION = np.dtype(
    [
        ("n", "f8", N_NAV),  # state: m, rad, m/s, rad/s, m/s2
        ("P", "f8", (N_NAV, N_NAV)),  # its covariance
        ("has_fix", "f8"),  # 1 once a fix has come
        ("has_heading", "f8"),  # 1 once a heading has come
        ("gps_age", "f8"),  # time since the last sample that was used, s
        ("compass_age", "f8"),
        ("imu_age", "f8"),
        ("refused", "f8", 8),  # runs of refused numbers of x, y, vn, ve, psi, r, and IMU leaps
        ("last", "f8", 8),  # newest sample of each channel; NaN before the first
        ("unchanged", "f8", 3),  # how long GPS, compass and IMU have repeated themselves, s
        ("clock", "f8"),  # time since the start, s
        ("path", "f8", 4),  # integrals of speed north and east (m), cos and sin of heading (s)
        # integrals of cos and sin of the heading at the last fix (s), and the square of the time
        # that north and east of the mean course until then are apart from those of the course since
        ("turned", "f8", 4),
        ("corrected", "f8", 3),  # sums of the corrections of heading, u, v
        ("count", "f8"),  # entries of the ring so far
        ("ring", "f8", (RING_ROWS, RING_COLUMNS)),  # recent past: see twin.filters.dead_reckoning
        ("since_lost", "f8"),  # time since that was last so, s
        ("unsettled", "f8"),  # time for which models still learn nothing after it came again, s
        ("lost", "f8"),  # 1 where a refused number was taken after all in this row
        ("since_aid", "f8"),  # time since the model aided the filter, s
        ("begun", "f8"),  # 1 once the twin has begun with fix and heading
        ("has_imu", "f8"),  # 1 once an IMU sample has come
        ("drift_var", "f8"),  # of the model's velocity, as it lasts, (m/s)2
        # open-loop trial of the model, see twin.predictors.without_gps: its time (s), u, v (m/s),
        # place to north and east (m), and how many trials were averaged
        ("trial", "f8", 6),
        ("commands_doubted", "f8"),  # 1 while the commands do not explain the motion
        ("motion_doubted", "f8"),  # 1 while sensors of the motion are at fault and left out
        ("restart", RESTART),  # where it begins again after this row, if it does
        ("restarted", "f8"),  # 1 in the row in which it did
    ]
)
"""What the filter of a boat remembers."""

NAVIGATION_SETTINGS = np.dtype(
    [
        ("gps_var", "f8"),  # variance of a fix, m2
        ("doppler_var", "f8"),  # of a GPS velocity, (m/s)2
        ("compass_var", "f8"),  # of a heading, rad2
        ("gyro_var", "f8"),  # of a yaw rate, (rad/s)2
        ("gyro_bias_var", "f8"),  # of the biases in the long run
        ("accel_var", "f8"),  # of a specific force, (m/s2)2
        ("accel_bias_var", "f8"),
        ("latency", "f8"),  # age of a GPS sample, s
        ("bias_time", "f8"),  # time constant of the biases, s
        ("r_density", "f8"),  # of the yaw rate's random walk, (rad/s)2/s
        ("held_density", "f8"),  # of velocities that are held, (m/s)2/s
        ("aided_density", "f8"),  # of velocities that a model drives
        ("velocity_var_0", "f8"),  # of velocities at the start, (m/s)2
        ("r_var_0", "f8"),  # of the yaw rate at the start
        ("r_aided_density", "f8"),  # of a yaw rate that a model drives
        ("compass_bias_var", "f8"),
        ("tilt_var", "f8"),  # of gravity that tilt lets in, (m/s2)2
        ("tilt_time", "f8"),  # its time constant, s
        ("gps_x", "f8"),  # antenna forward and to starboard of the origin, m
        ("gps_y", "f8"),
        ("imu_x", "f8"),  # IMU likewise, m
        ("imu_y", "f8"),
        ("leap", "f8"),  # largest change of an acceleration from row to row, m/s2
    ]
)
"""What the filter is given of a boat and its instruments."""

NAVIGATION_WORK = np.dtype(
    [
        ("H", "f8", N_NAV),  # measurement row; zeros between corrections
        ("gain", "f8", N_NAV),  # P H'
        ("A", "f8", (N_NAV, N_NAV)),  # A P of a prediction, Cholesky factor of a repair
        ("past", "f8", N_NAV),  # where the boat was when the fix was taken
        ("before", "f8", N_NAV),  # state before the fix
    ]
)
"""Scratch of the filter."""


def navigation_settings(particulars: Particulars) -> Array:
    """Return the settings of the filter for a boat, in the order of :data:`NAVIGATION_SETTINGS`.

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
    turn = U / L
    tilt = GRAVITY * I.tilt_sd
    return np.array(
        [
            I.gps_sd**2 + I.gps_bias_sd**2,
            I.doppler_sd**2,
            I.compass_sd**2,
            I.gyro_sd**2,
            max(I.gyro_bias_sd**2, VARIANCE_MIN),
            I.accel_sd**2,
            I.accel_bias_sd**2,
            I.gps_latency,
            200.0,
            (0.5 * turn) ** 2 * turn,  # yaw rate wanders by half its size in one L/U
            (0.25 * U) ** 2 * turn,  # velocity without accelerometers, likewise
            (AIDED_WANDER * U) ** 2 * turn,
            U**2,
            turn**2,
            (AIDED_YAW_WANDER * turn) ** 2 * turn,
            max(I.compass_bias_sd**2, VARIANCE_MIN),
            max(tilt**2, VARIANCE_MIN),
            I.tilt_time,
            *I.gps_arm[:2],
            *I.imu_arm[:2],
            largest_leap(particulars),
        ]
    )


def largest_leap(particulars: Particulars) -> float:
    """Return the largest change of an acceleration from row to row that is no leap, m/s2."""
    I, U, L = particulars.instruments, particulars.speed, particulars.length
    return 0.5 * U * U / L + 8.0 * math.hypot(I.accel_sd, 0.5 * GRAVITY * I.tilt_sd)


def sample_limits(particulars: Particulars) -> Array:
    """Return the sizes (19,), in the order of a measurement row, that no valid sample reaches."""
    fastest = SPEED_LIMIT * particulars.speed
    inertial = TURN_LIMIT, ACCEL_LIMIT, ACCEL_LIMIT
    fix = POSITION_MAX_M, POSITION_MAX_M, fastest, fastest
    level = [*fix, HEADING_MAX_RAD, *inertial, WIND_LIMIT, HEADING_MAX_RAD]
    # roll, pitch and heave are no business of these filters
    return np.array([*level, *[math.inf] * (len(MEASUREMENTS) - len(level))])


def initial_navigation(settings: Array) -> Array:
    """Return the memory of a filter that has seen nothing, in the order of :data:`NAVIGATION`."""
    given, memory = settings.view(NAVIGATION_SETTINGS)[0], np.zeros(NAVIGATION.itemsize // 8)
    nav = memory.view(NAVIGATION)[0]
    variances = (
        *("gps_var", "gps_var", "compass_var", "velocity_var_0", "velocity_var_0", "r_var_0"),
        *("gyro_bias_var", "accel_bias_var", "accel_bias_var", "compass_bias_var"),
        *("tilt_var", "tilt_var"),
    )
    np.fill_diagonal(nav["P"], [given[name] for name in variances])
    nav["last"] = math.nan
    return memory
