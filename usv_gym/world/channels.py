"""The channels of a measurement, and the bit of the sensor that each comes from."""

from __future__ import annotations

from usv_kernel.channels import SENSOR_CHANNELS

__all__ = ["CHANNELS", "COMPASS", "COMPASS_BIT", "GPS", "GPS_BIT", "IMU", "IMU_BIT"]

CHANNELS = SENSOR_CHANNELS
"""Entries of a measurement row; NaN where there is no new sample."""

GPS, COMPASS, IMU = slice(0, 4), slice(4, 5), slice(5, 8)

GPS_BIT, COMPASS_BIT, IMU_BIT = 1, 2, 4
