"""Memory and settings of the sensor checks, by name."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.channels import COMMANDS, STATE
from twin.filters.navigation_state import largest_leap
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
    "WIND_CHECK",
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
    "gave numbers that no boat gives",
    "repeats itself while the boat moves",
    "jumped",
    "contradicted the other sensors",
    "moves away from its own velocity",
    "is late",
    "have the wrong sign or swapped sides",
    "do not explain how the boat moves",
    "gave impossible numbers, and is not yet trusted again",
    "do not reach the left thruster",
    "do not reach the right thruster",
    "makes a current larger than is plausible: its fixes may be drawn away",
    "makes the current change faster than is plausible: its fixes may be drawn away",
    "repeats its velocity, which is not used",
    "has gone silent",
    "jumped in place and velocity: it may have been drawn away until then",
    "changed its velocity at once, though no accelerometer measured it",
    "gives a velocity that contradicts its fixes, and which is not used",
    "has the wrong sign or unit",
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
    RETURNING,
    NO_LEFT,
    NO_RIGHT,
    LARGE_CURRENT,
    CURRENT_CHANGES,
    VELOCITY_FROZEN,
    SILENT,
    RELEASED,
    STEPPED,
    VELOCITY_WRONG,
    WRONG_SCALE,
) = range(len(REASONS))

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
        ("followed", "f8"),  # how long it has been consistent in itself while excluded, s
        ("impossible", "f8"),  # recent share of impossible numbers
        ("in_use", "f8"),  # how long nothing had been said against it when it was excluded, s
    ]
)
"""What is remembered of a sensor."""

WIND_CHECK = np.dtype(
    [
        ("status", "f8"),  # one of STATUSES
        ("reason", "f8"),  # one of REASONS
        ("since", "f8"),  # time at which it became so, s
        ("silent", "f8"),  # time since the last sample, s
        ("age", "f8"),  # time since the last sample that was used, s
        ("last", "f8", 2),  # last apparent wind, m/s and rad
        ("repeated", "f8", 2),  # how long speed and direction have been the same, s
        ("changing", "f8"),  # how long they have changed while excluded, s
        ("known", "f8"),  # time that the mean wind is the mean of, s; 0: nothing is known
        ("velocity", "f8", 2),  # true wind, smoothed: velocity of the air north and east, m/s
        ("mean", "f8", 2),  # its mean, m/s
    ]
)
"""What is remembered of an anemometer, and of the wind."""

COMMAND_TERMS = 6
"""Parameters of the model of yaw rate or surge."""

FILTER_STATES = 1 + COMMAND_TERMS
"""Entries of the filter of an axis: its motion and the parameters."""

DRIVE = 4
"""What the commands make: thrust of left and right, and the part of it that steers."""

HYPOTHESES = 8
"""What may be wrong with the commands, the first of them nothing."""

N_COMMANDS, N_STATES = len(COMMANDS), len(STATE)

CURRENT_LOOKS = 9
"""Looks at the current of the model that are remembered."""

LAG_SUMS = np.dtype(
    [("weight", "f8"), ("r", "f8"), ("beta", "f8"), ("r_r", "f8"), ("r_beta", "f8")]
)
"""Leaky sums of yaw rate r and drift angle beta: they tell how late the velocity is."""

TURN_SUMS = np.dtype(
    [
        ("compass", "f8"),  # what the compass turned lately: a leaky sum, rad
        ("gyro", "f8"),  # the same of the gyro, rad
        ("weight", "f8"),  # leaky sums over time of 1, s ...
        ("c", "f8"),  # ... of the turn of the compass, rad s ...
        ("g", "f8"),  # ... of that of the gyro, rad s ...
        ("c_c", "f8"),  # ... and of their products, rad2 s
        ("c_g", "f8"),
        ("g_g", "f8"),
    ]
)
"""What the regression of the compass's turn on the gyro's remembers."""

FILTER = np.dtype(
    [
        ("x", "f8", (2, FILTER_STATES)),  # yaw rate or surge, then parameters; nominal units
        ("P", "f8", (2, FILTER_STATES, FILTER_STATES)),  # their covariance
    ]
)
"""The filters of yaw and surge by one hypothesis; see ``twin.health.drives.filters``."""

TURN_RING = 16
"""Samples of the turn that are kept for a compass that comes late; they reach back further than it
is late by."""

HEALTH = np.dtype(
    [
        ("clock", "f8"),  # time since the start, s
        ("row_interval", "f8"),  # typical time between rows, s
        ("row_gap", "f8"),  # 1 where the row follows a gap, else 0
        ("state", "f8", N_STATES),  # last state of the predictor that a boat can have
        ("sensors", CHECK, len(SENSORS)),
        ("last", "f8", 8),  # last sample of each channel; NaN before the first
        # heading: compass against gyro and course
        ("turned", "f8"),  # integral of the yaw rate, for a compass that is late, rad
        ("turn_rate", "f8"),  # yaw rate of the row before, rad/s
        ("turn_rows", "f8"),  # samples in the ring so far
        ("turn_ring", "f8", (TURN_RING, 2)),  # time and that integral, now and then
        ("turn_late", "f8"),  # what the boat turned since the last heading was measured, rad
        ("gyro_turn", "f8"),  # integral of the gyro since the last compass sample, rad
        ("gyro_time", "f8"),  # time since then, s
        ("gyro_gap", "f8"),  # part of it without gyro, s
        ("gyro_bias", "f8"),  # rad/s
        ("heading_sum", "f8"),  # leaky sum of compass minus gyro, rad
        ("heading_level", "f8"),  # its typical size, rad
        ("gyro_scale", TURN_SUMS),  # for the sign and unit of the gyro
        ("reckoned_heading", "f8"),  # heading by the yaw rate since the compass was right, rad
        ("course", "f8"),  # last course over ground, rad; NaN if there is none
        ("course_time", "f8"),  # time since then, s
        ("course_gyro", "f8"),  # integral of the gyro since then, rad
        ("course_compass", "f8"),  # heading then, rad
        ("course_gyro_rate", "f8"),  # yaw rate of the gyro then, rad/s
        ("course_compass_rate", "f8"),  # and of the compass, rad/s
        ("gyro_rate", "f8"),  # last yaw rate of the gyro, rad/s
        ("compass_rate", "f8"),  # yaw rate of the compass, rad/s
        ("drift_angle", "f8"),  # leaky mean of course minus heading, rad
        ("drift_time", "f8"),  # how long there has been one, s
        ("course_minus_gyro", "f8"),  # leaky sum of their changes, rad
        ("course_minus_compass", "f8"),  # rad
        ("course_for_compass", "f8"),  # leaky sum of how much nearer the compass is to it, rad2 s
        ("lag_sums", LAG_SUMS),
        # position against velocity
        ("fix", "f8", 2),  # last fix, m
        ("fix_time", "f8"),  # time since then, s
        ("travelled", "f8", 2),  # integral of the velocity since then, m
        ("gap_way", "f8", 2),  # part of it without rows, or without compass and gyro, m
        ("position_sum", "f8", 2),  # leaky sum of position minus velocity, m
        ("position_level", "f8"),  # its typical size, m
        ("pull_short", "f8", 2),  # short mean of position minus velocity, from the last fix, m
        ("pull_long", "f8", 2),  # long mean of the same, m
        ("pull_age", "f8"),  # time since they began, s
        ("pull_level", "f8"),  # typical distance between them, m
        ("reckoned", "f8", 2),  # where dead reckoning puts an excluded GPS, m
        ("reckoned_time", "f8"),  # time since it began, s
        ("stand_mean", "f8", 2),  # short mean of the fixes, m; NaN before the first
        ("stand_at", "f8", 2),  # where it has stood since, m
        ("stand_way", "f8", 2),  # way by the predictor's velocity since, m
        ("stand_mean_way", "f8", 2),  # its mean as that of the fixes, m
        ("stand_most", "f8"),  # the furthest that this led to, in radii of standing fixes
        ("stand_time", "f8"),  # time since, s
        ("since_leap", "f8"),  # time since the acceleration last leapt, s
        ("stand_scatter", "f8"),  # recent mean square of the steps between fixes, m2
        # velocity against accelerometers
        ("velocity", "f8", 2),  # last velocity over ground, m/s
        ("velocity_time", "f8"),  # time since then, s
        ("accel_gain", "f8", 2),  # integral of the acceleration since then, m/s
        ("accel_gap", "f8"),  # part of that time without accelerometers, s
        ("accel_bias", "f8", 2),  # of forward and starboard, m/s2
        ("velocity_sum", "f8", 2),  # leaky sum of velocity minus acceleration, m/s
        ("velocity_level", "f8"),  # its typical size, m/s
        ("velocity_step", "f8", 2),  # velocity minus acceleration of the last fix alone, m/s
        ("accel_mean", "f8", 2),  # mean acceleration over ground before it, m/s2
        ("velocity_repeated", "f8"),  # how long the velocity has repeated itself, s
        ("velocity_longest", "f8"),  # longest repetition while it was right, s
        # accelerometers against the commands
        ("unaided_surge", "f8"),  # surge by the commands alone, in nominal speeds
        ("restarts", "f8", 2),  # 1 in the row in which surge or sway begin again ...
        ("restarted", "f8", 2),  # ... with this, m/s
        ("unaided_bias", "f8", 2),  # mean of acceleration measured minus expected, m/s2
        ("unaided_gain", "f8", 2),  # leaky sums of the acceleration measured, m/s ...
        ("unaided_agreed", "f8", 2),  # ... when it last agreed with that expected, m/s
        ("unaided_sum", "f8", 2),  # leaky sums of what it differs from that, m/s
        ("unaided_level", "f8", 2),  # their typical sizes, m/s
        # velocity of the water by the model, and whether it is plausible
        ("current", "f8", 3),  # north, east, standard deviation, m/s; NaN where there is none
        ("current_due", "f8"),  # time at which it is looked at again, s
        ("current_past", "f8", (CURRENT_LOOKS, 3)),  # north, east and sd then, m/s; NaN for none
        ("current_doubted", "f8"),  # time until which a change makes the GPS doubtful, s
        # commands against the motion: a filter of yaw rate and surge for each hypothesis
        ("drive", "f8", DRIVE),  # thrust and its steering part, side by side, after the lags
        ("targets", "f8", DRIVE),  # thrust and its parts of the row before, without the lags
        ("drive_sum", "f8", DRIVE),  # their integral over the step so far, s
        ("mean_drive", "f8", DRIVE),  # their mean over the last step
        ("drive_before", "f8", DRIVE),  # the same of the step before
        ("held_drive", "f8", DRIVE),  # the same of the last step before anything was at odds
        ("at_rest", "f8"),  # 1 where the shafts were commanded to rest when it ended
        ("known_time", "f8"),  # how long the sensors of the motion have been in use, s
        ("step_time", "f8"),  # time since the step began, s; negative before the first
        ("motion", "f8", 2),  # yaw rate and surge at its beginning or end, in nominal units
        ("sway", "f8"),  # sway at its beginning, in nominal speeds ...
        ("mean_sway", "f8"),  # ... and its mean over the last step
        ("steps", "f8"),  # steps learned from
        ("filters", FILTER, HYPOTHESES),
        ("effects", "f8", (HYPOTHESES, 3)),  # thrust, steering, difference of sides in a step
        ("wave_level", "f8", 2),  # typical part of the waves in yaw rate and surge
        ("quiet_level", "f8", 2),  # the same before anything was at odds
        ("regressors", "f8", COMMAND_TERMS),  # scratch
        ("gain", "f8", FILTER_STATES),  # scratch
        ("against_time", "f8"),  # how long the boat has gone against its thrust, s
        ("row_command", "f8", N_COMMANDS),  # command of the row before
        ("before", "f8", N_COMMANDS),  # command when the step began
        ("trusted", "f8", N_COMMANDS),  # last command before anything was at odds
        ("commands_doubted", "f8"),  # 1 while the commands do not explain the motion
        ("motion_doubted", "f8"),  # 1 while GPS, compass or accelerometers leave it in doubt
        ("at_odds_steps", "f8"),  # steps since the mismatch grew too large
        ("mismatch", "f8"),  # leaky mean of the squared innovations, in their variances
        ("likelihood", "f8", HYPOTHESES),  # logarithms, of the last step
        ("distinct", "f8", HYPOTHESES),  # how far a hypothesis differs from the one in force
        ("evidence", "f8", HYPOTHESES),  # sums of log-likelihood ratios to the one in force
        ("hypothesis", "f8"),  # the one in force
        ("wind", WIND_CHECK),
        ("statuses", "f8"),  # all statuses in one number: it differs where one of them does
    ]
)
"""What the checks remember of a boat."""

HEALTH_SETTINGS = np.dtype(
    [
        ("time_scale", "f8"),  # length over nominal speed, s
        ("speed", "f8"),  # nominal speed, m/s
        # standard deviations of the data sheets: see twin.particulars.Instruments
        ("gps_sd", "f8"),  # m
        ("gps_bias_sd", "f8"),  # m
        ("doppler_sd", "f8"),  # m/s
        ("compass_sd", "f8"),  # rad
        ("gyro_sd", "f8"),  # rad/s
        ("gyro_bias_sd", "f8"),  # rad/s
        ("accel_sd", "f8"),  # m/s2
        ("accel_bias_sd", "f8"),  # m/s2
        ("tilt", "f8"),  # gravity that tilt lets in, m/s2
        ("arm", "f8"),  # between antenna and IMU, m
        ("latency", "f8"),  # declared age of a fix, s
        ("max_turn", "f8"),  # yaw rate that no boat of its size exceeds, rad/s
        ("shaft_speed", "f8"),  # nominal, rev/s
        ("lag", "f8"),  # of shafts and drives, s
        ("sides", "f8"),  # 1 for a boat with a thruster on each side, else 0
        ("wind_gain", "f8"),  # wind 10 m above the sea over that at the anemometer
        ("compass_latency", "f8"),  # declared age of a heading, s
        # change of the current within the looks remembered that is not plausible, m/s
        ("current_change", "f8"),
        ("leap", "f8"),  # largest change of an acceleration from row to row, m/s2
    ]
)
"""What the checks are given of a boat and its instruments."""


TURN_FREE, TURN_FACTOR = 1.0, 2.0
"""No boat turns faster than this (rad/s) and so many nominal speeds over its length."""


CURRENT_CHANGE, CURRENT_CHANGE_ROUGH = 0.25, 0.5
"""Largest change of the current within 40 s that is plausible, m/s: of a boat whose class is known,
and of one whose model errs by as much itself."""

REFERENCE_HEIGHT, PROFILE = 10.0, 0.11
"""The wind of the model is that of this height, m; exponent of the wind's profile over open sea.

Source: Hsu, Meindl and Gilhousen 1994."""


def health_settings(particulars: Particulars) -> Array:
    """Return the settings of the checks, in the order of :data:`HEALTH_SETTINGS`."""
    I, U, L = particulars.instruments, particulars.speed, particulars.length
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
            math.dist(I.gps_arm[:2], I.imu_arm[:2]),
            I.gps_latency,
            TURN_FREE + TURN_FACTOR * U / L,
            particulars.shaft_speed,
            max(particulars.shaft_lag, particulars.steer_lag),
            particulars.steering != "rudder" and not particulars.tanker,
            (REFERENCE_HEIGHT / I.wind_height) ** PROFILE,
            I.compass_latency,
            CURRENT_CHANGE if particulars.design else CURRENT_CHANGE_ROUGH,
            largest_leap(particulars),
        ]
    )


def initial_health() -> Array:
    """Return the memory of checks that have seen nothing, in the layout of :data:`HEALTH`."""
    memory = np.zeros(HEALTH.itemsize // 8)
    health = memory.view(HEALTH)[0]
    health["sensors"]["status"] = ABSENT
    for name in ("last", "course", "fix", "velocity", "stand_mean", "stand_at"):
        health[name] = math.nan
    for name in ("current", "current_past"):
        health[name] = math.nan
    return memory
