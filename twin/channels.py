"""Names of the channels: time, commands, measurements, truth and forecast."""

from __future__ import annotations

from usv_kernel.channels import MOTION_CHANNELS, SENSOR_CHANNELS, WIND_CHANNELS

__all__ = [
    "ACCEL_Z",
    "AHRS_PITCH",
    "AHRS_ROLL",
    "APPARENT_FROM",
    "APPARENT_SPEED",
    "COMMANDS",
    "GPS_VZ",
    "GPS_Z",
    "GYRO_X",
    "GYRO_Y",
    "MEASUREMENTS",
    "MOTION_AT",
    "MOTION_END",
    "PSI",
    "STATE",
    "TIME",
    "TRUE_MOTION",
    "TRUTH",
    "WIND_FROM",
    "WIND_SPEED",
    "R",
    "U",
    "V",
    "X",
    "Y",
]

TIME = "t_s"
"""Time of the row, s."""

COMMANDS = ("n_left_rps", "n_right_rps", "delta_left_rad", "delta_right_rad")
"""Columns of ``Log.cmd``: shaft speeds, rev/s, and drive angles, rad (above 0: to starboard)."""

MEASUREMENTS = (
    *(*SENSOR_CHANNELS, "wind_mps", "wind_from_rad"),
    *(*MOTION_CHANNELS, *WIND_CHANNELS),
)
"""Columns of ``Log.z``: those of the sensors, speed of the true wind, and the direction that it
comes from, clockwise from north; then those of a boat whose roll, pitch and heave are measured;
then those of an anemometer on board."""

WIND_SPEED, WIND_FROM, MOTION_AT = range(len(SENSOR_CHANNELS), len(SENSOR_CHANNELS) + 3)
"""Places of the wind among them, and of the first motion channel."""

MOTION_END = MOTION_AT + len(MOTION_CHANNELS)
"""The place after the last of them."""

GYRO_X, GYRO_Y, ACCEL_Z, AHRS_ROLL, AHRS_PITCH, GPS_Z, GPS_VZ = range(MOTION_AT, MOTION_END)
"""Places of the motion channels."""

APPARENT_SPEED, APPARENT_FROM = range(MOTION_END, len(MEASUREMENTS))
"""Places of the apparent wind."""

TRUTH = ("true_x_m", "true_y_m", "true_psi_rad", "true_u_mps", "true_v_mps", "true_r_radps")
"""Columns of ``Log.truth``: the simulated state, for scoring only."""

TRUE_MOTION = (
    *("true_z_m", "true_roll_rad", "true_pitch_rad"),
    *("true_w_mps", "true_p_radps", "true_q_radps"),
)
"""Columns of ``Log.true_motion``: place down, roll, pitch, and the body's speed down, roll rate and
pitch rate."""

STATE = ("x_m", "y_m", "psi_rad", "u_mps", "v_mps", "r_radps")
"""Columns of a state: north, east, heading, speed forward, to starboard, yaw rate."""

X, Y, PSI, U, V, R = range(len(STATE))
"""Their places."""
