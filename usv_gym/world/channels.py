"""The bits and columns of the sensors in the rows of ``usv_kernel.channels``."""

from __future__ import annotations

__all__ = [
    "AHRS_BIT",
    "BITS",
    "COMPASS",
    "COMPASS_BIT",
    "GPS",
    "GPS_BIT",
    "IMU",
    "IMU_BIT",
    "WIND_BIT",
]

GPS, COMPASS, IMU = slice(0, 4), slice(4, 5), slice(5, 8)

GPS_BIT, COMPASS_BIT, IMU_BIT, AHRS_BIT, WIND_BIT = 1, 2, 4, 8, 16

BITS = (
    *(GPS_BIT, GPS_BIT, GPS_BIT, GPS_BIT, COMPASS_BIT, IMU_BIT, IMU_BIT, IMU_BIT),
    *(IMU_BIT, IMU_BIT, IMU_BIT, AHRS_BIT, AHRS_BIT, GPS_BIT, GPS_BIT),
    *(WIND_BIT, WIND_BIT),
)
"""Bit of the sensor of each of SENSOR_CHANNELS, of MOTION_CHANNELS, and of WIND_CHANNELS."""
