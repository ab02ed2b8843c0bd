"""The channels of a measurement, and the bit of the sensor that each comes from."""

from __future__ import annotations

__all__ = ["CHANNELS", "COMPASS", "COMPASS_BIT", "GPS", "GPS_BIT", "IMU", "IMU_BIT"]

CHANNELS = (
    "gps_x_m",
    "gps_y_m",
    "gps_vx_mps",
    "gps_vy_mps",
    "compass_rad",
    "gyro_radps",
    "accel_x_mps2",
    "accel_y_mps2",
)
"""Entries of a measurement row; NaN where there is no new sample."""

GPS, COMPASS, IMU = slice(0, 4), slice(4, 5), slice(5, 8)

GPS_BIT, COMPASS_BIT, IMU_BIT = 1, 2, 4
