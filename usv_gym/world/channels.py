"""The bits and columns of the sensors in a measurement row of ``usv_kernel.channels``."""

from __future__ import annotations

__all__ = ["COMPASS", "COMPASS_BIT", "GPS", "GPS_BIT", "IMU", "IMU_BIT"]

GPS, COMPASS, IMU = slice(0, 4), slice(4, 5), slice(5, 8)

GPS_BIT, COMPASS_BIT, IMU_BIT = 1, 2, 4
