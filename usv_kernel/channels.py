"""The channels of the sensors, by name: simulator and twin agree on them here."""

from __future__ import annotations

__all__ = [
    "ACCEL_X",
    "ACCEL_Y",
    "COMPASS",
    "GPS_VX",
    "GPS_VY",
    "GPS_X",
    "GPS_Y",
    "GYRO",
    "SENSOR_CHANNELS",
]

SENSOR_CHANNELS = (
    "gps_x_m",
    "gps_y_m",
    "gps_vx_mps",
    "gps_vy_mps",
    "compass_rad",
    "gyro_radps",
    "accel_x_mps2",
    "accel_y_mps2",
)
"""Position and velocity over ground north (x) and east (y), heading clockwise from north, yaw rate,
specific force forward and to starboard."""

GPS_X, GPS_Y, GPS_VX, GPS_VY, COMPASS, GYRO, ACCEL_X, ACCEL_Y = range(len(SENSOR_CHANNELS))
"""Their places in a row of measurements."""
