"""Names of the channels: time, commands, measurements, truth and forecast."""

from __future__ import annotations

__all__ = [
    "CHANNELS",
    "COMMANDS",
    "MEASUREMENTS",
    "TIME",
    "TRUTH",
]

TIME = "t_s"
"""Time of the row, s."""

COMMANDS = ("n_left_rps", "n_right_rps", "delta_left_rad", "delta_right_rad")
"""Columns of ``Log.cmd``: shaft speeds, rev/s, and drive angles, rad (above 0: to starboard)."""

MEASUREMENTS = (
    "gps_x_m",
    "gps_y_m",
    "gps_vx_mps",
    "gps_vy_mps",
    "compass_rad",
    "gyro_radps",
    "accel_x_mps2",
    "accel_y_mps2",
    "wind_mps",
    "wind_from_rad",
)
"""Columns of ``Log.z``: position and velocity over ground north (x) and east (y), heading
clockwise from north, yaw rate, specific force forward and to starboard, speed of the true wind
and the direction that it comes from, clockwise from north."""

TRUTH = ("true_x_m", "true_y_m", "true_psi_rad", "true_u_mps", "true_v_mps", "true_r_radps")
"""Columns of ``Log.truth``: the simulated state, for scoring only."""

CHANNELS = ("x_m", "y_m", "psi_rad", "u_mps", "v_mps", "r_radps")
"""Columns of a state: north, east, heading, speed forward, to starboard, yaw rate."""
