"""Memory and settings of the sensor checks, by name."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.channels import COMMANDS
from twin.particulars import GRAVITY, Particulars

__all__ = [
    "ABSENT",
    "ACCELEROMETERS",
    "COMMAND",
    "COMPASS_SENSOR",
    "DOUBTFUL",
    "EXCLUDED",
    "GPS",
    "GYRO_SENSOR",
    "HEALTH",
    "HEALTH_SETTINGS",
    "OK",
    "REASONS",
    "SENSORS",
    "STATUSES",
    "health_settings",
    "initial_health",
]

Array = NDArray[np.float64]

SENSORS = ("gps", "compass", "gyro", "accelerometers", "commands")
"""What is checked."""

GPS, COMPASS_SENSOR, GYRO_SENSOR, ACCELEROMETERS, COMMAND = range(len(SENSORS))

STATUSES = ("absent", "ok", "doubtful", "excluded")
"""What is said of a sensor: no samples; used; used, but at odds with others; not used."""

ABSENT, OK, DOUBTFUL, EXCLUDED = range(len(STATUSES))

REASONS = (
    "",
    "gives numbers that no boat gives",
    "repeats itself while the boat moves",
    "jumped",
    "disagrees with the other sensors",
    "moves away from its own velocity",
    "is late",
    "have the wrong sign or swapped sides",
    "do not explain how the boat moves",
)
"""Why, in words that follow the sensor's name."""

(
    NO_REASON,
    IMPOSSIBLE,
    FROZEN,
    JUMPED,
    AT_ODDS,
    DRIFTS,
    LATE,
    WRONG_SIGN,
    NO_ANSWER,
) = range(len(REASONS))

LAGS = 4

CHECK = np.dtype(
    [
        ("status", "f8"),  # one of STATUSES
        ("reason", "f8"),  # one of REASONS
        ("since", "f8"),  # time at which it became so, s
        ("age", "f8"),  # time since the last sample, s
        ("interval", "f8"),  # typical time between samples, s
        ("repeated", "f8"),  # how long it has repeated itself, s
        ("longest", "f8"),  # longest repetition while it was right, s
        ("evidence", "f8"),  # how long it has been at odds, s
        ("calm", "f8"),  # how long it has been consistent while excluded, s
        ("impossible", "f8"),  # recent share of impossible numbers
    ]
)
"""What is remembered of a sensor."""

COMMAND_TERMS = 6

DRIVE = 3

N_COMMANDS = len(COMMANDS)

AXIS = np.dtype(
    [
        ("information", "f8", (COMMAND_TERMS, COMMAND_TERMS)),
        ("right", "f8", COMMAND_TERMS),
        ("params", "f8", COMMAND_TERMS),
        ("level", "f8"),  # typical error of a step
    ]
)
"""A linear model of yaw rate or surge."""

HEALTH = np.dtype(
    [
        ("clock", "f8"),  # time since the start, s
        ("sensors", CHECK, len(SENSORS)),
        ("last", "f8", 8),  # last sample of each channel; NaN before the first
        # heading: compass against gyro and course
        ("turned", "f8"),  # integral of the gyro since the last compass sample, rad
        ("turn_time", "f8"),  # time since then, s
        ("turn_gap", "f8"),  # part of it without gyro, s
        ("gyro_bias", "f8"),  # rad/s
        ("yaw", "f8"),  # leaky sum of compass minus gyro, rad
        ("yaw_level", "f8"),  # its typical size
        ("heading", "f8"),  # heading by the gyro alone since the compass was excluded, rad
        ("course", "f8"),  # last course over ground, rad; NaN if there is none
        ("course_time", "f8"),  # time since then, s
        ("course_gyro", "f8"),  # integral of the gyro since then, rad
        ("course_compass", "f8"),  # heading then, rad
        ("against_gyro", "f8"),  # leaky sum of course minus gyro, rad
        ("against_compass", "f8"),  # leaky sum of course minus compass, rad
        # position against velocity
        ("fix", "f8", 2),  # last fix, m
        ("fix_time", "f8"),  # time since then, s
        ("way", "f8", 2),  # integral of the velocity since then, m
        ("place", "f8", 2),  # leaky sum of position minus velocity, m
        ("place_level", "f8"),
        ("reckoned", "f8", 2),  # where dead reckoning puts an excluded GPS, m
        ("reckoned_sd", "f8"),  # and how sure that is, m
        ("reckoned_time", "f8"),  # s
        # velocity against accelerometers
        ("velocity", "f8", 2),  # last velocity over ground, m/s
        ("velocity_time", "f8"),  # time since then, s
        ("gained", "f8", 2),  # integral of the acceleration since then, m/s
        ("gain_gap", "f8"),  # part of that time without accelerometers, s
        ("accel_bias", "f8", 2),  # of forward and starboard, m/s2
        ("speeds", "f8", 2),  # leaky sum of velocity minus acceleration, m/s
        ("speeds_level", "f8"),
        # commands against the motion: a linear model of the change in a step, for yaw and surge
        ("drive", "f8", DRIVE),  # thrust, steering moment, difference of thrust, after the lags
        ("driven", "f8", DRIVE),  # their mean over the step so far
        ("step_time", "f8"),  # time since the step began, s
        ("motion", "f8", 2),  # yaw rate and surge at its beginning, in nominal units
        ("steps", "f8"),  # steps learned from
        ("fit", AXIS, 2),  # of yaw rate and surge
        ("before", "f8", N_COMMANDS),  # command when the step began
        ("trusted", "f8", N_COMMANDS),  # last command before anything was at odds
        ("commands_doubted", "f8"),  # 1 while the commands do not explain the motion
        ("at_odds", "f8"),  # leaky mean of squared errors, in levels ...
        ("if_reversed", "f8"),  # ... with all commands reversed
        ("if_steered", "f8"),  # ... with steering reversed
        ("if_both", "f8"),  # ... with both
        ("if_swapped", "f8"),  # ... with sides swapped
        ("excited", "f8"),  # how much of the motion the commands make
        # how late the velocity is: leaky sums of yaw rate and drift angle
        ("late", "f8", 5),  # weights, sums of r, beta, r r, r beta
    ]
)
"""What the checks remember of a boat."""

HEALTH_SETTINGS = np.dtype(
    [
        ("time_scale", "f8"),  # length over nominal speed, s
        ("speed", "f8"),  # nominal speed, m/s
        ("gps_sd", "f8"),
        ("gps_bias_sd", "f8"),
        ("doppler_sd", "f8"),
        ("compass_sd", "f8"),
        ("gyro_sd", "f8"),
        ("gyro_bias_sd", "f8"),
        ("accel_sd", "f8"),
        ("accel_bias_sd", "f8"),
        ("tilt", "f8"),  # gravity that tilt lets in, m/s2
        ("arm", "f8"),  # between antenna and IMU, m
        ("latency", "f8"),  # declared age of a fix, s
        ("max_turn", "f8"),  # rad/s
        ("shaft_speed", "f8"),  # nominal, rev/s
        ("lag", "f8"),  # of shafts and drives, s
    ]
)
"""What the checks are given of a boat and its instruments."""


def health_settings(particulars: Particulars) -> Array:
    """Return the settings of the checks, in the order of :data:`HEALTH_SETTINGS`."""
    I, U, L = particulars.instruments, particulars.speed, particulars.length
    arm = math.dist(I.gps_arm, I.imu_arm)
    return np.array(
        [
            L / U,
            U,
            I.gps_sd,
            I.gps_bias_sd,
            I.doppler_sd,
            I.compass_sd,
            I.gyro_sd,
            I.gyro_bias_sd,
            I.accel_sd,
            I.accel_bias_sd,
            GRAVITY * I.tilt_sd,
            arm,
            I.gps_latency,
            1.0 + 2.0 * U / L,
            particulars.shaft_speed,
            max(particulars.shaft_lag, particulars.steer_lag),
        ]
    )


def initial_health(settings: Array) -> Array:
    """Return the memory of checks that have seen nothing, in the order of :data:`HEALTH`."""
    memory = np.zeros(HEALTH.itemsize // 8)
    health = memory.view(HEALTH)[0]
    health["last"] = math.nan
    health["sensors"]["status"] = ABSENT
    health["course"] = math.nan
    health["fix"] = health["velocity"] = math.nan
    return memory
