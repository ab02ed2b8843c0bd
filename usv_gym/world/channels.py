"""The bits and columns of the sensors in the rows of ``usv_kernel.channels``."""

from __future__ import annotations

__all__ = [
    "AHRS_BIT",
    "AXIS_BITS",
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

AXIS_BITS = {
    "gyro_x": 32,
    "gyro_y": 64,
    "gyro_z": 128,
    "accel_x": 256,
    "accel_y": 512,
    "accel_z": 1024,
}
"""Bit of each axis of the IMU alone."""

_AXES = {name: IMU_BIT | bit for name, bit in AXIS_BITS.items()}

BITS = (
    *(GPS_BIT, GPS_BIT, GPS_BIT, GPS_BIT, COMPASS_BIT),
    *(_AXES["gyro_z"], _AXES["accel_x"], _AXES["accel_y"]),
    *(_AXES["gyro_x"], _AXES["gyro_y"], _AXES["accel_z"], AHRS_BIT, AHRS_BIT, GPS_BIT, GPS_BIT),
    *(WIND_BIT, WIND_BIT),
)
"""Bits of each of SENSOR_CHANNELS, of MOTION_CHANNELS, and of WIND_CHANNELS: that of the sensor
and, of an IMU, that of the axis."""
