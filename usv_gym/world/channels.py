"""The bits of sensors and commands in a row, and the columns of the sensors."""

from __future__ import annotations

__all__ = [
    "AHRS_BIT",
    "AXIS_BITS",
    "BITS",
    "COMMANDS_BIT",
    "COMPASS",
    "COMPASS_BIT",
    "FIXES_BIT",
    "GPS",
    "GPS_BIT",
    "IMU",
    "IMU_BIT",
    "LEFT_BIT",
    "RIGHT_BIT",
    "STEERING_BIT",
    "VELOCITY_BIT",
    "WIND_BIT",
]

GPS = slice(0, 4)
COMPASS = slice(4, 5)
IMU = slice(5, 8)

GPS_BIT = 1
COMPASS_BIT = 2
IMU_BIT = 4
AHRS_BIT = 8
WIND_BIT = 16

AXIS_BITS = {
    "gyro_x": 32,
    "gyro_y": 64,
    "gyro_z": 128,
    "accel_x": 256,
    "accel_y": 512,
    "accel_z": 1024,
}
"""Bit of each axis of the IMU alone."""

FIXES_BIT = 2048
VELOCITY_BIT = 4096
"""Bits of the position and of the velocity of the GPS alone."""

COMMANDS_BIT = 8192
STEERING_BIT = 16384
"""Bits of the commands as they are reported, and of the angles among them alone."""

LEFT_BIT = 32768
RIGHT_BIT = 65536
"""Bits of the thrusters of the boat."""

_AXES = {name: IMU_BIT | bit for name, bit in AXIS_BITS.items()}

_FIX = GPS_BIT | FIXES_BIT
_VELOCITY = GPS_BIT | VELOCITY_BIT
_ANGLE = COMMANDS_BIT | STEERING_BIT

BITS = (
    *(_FIX, _FIX, _VELOCITY, _VELOCITY, COMPASS_BIT),
    *(_AXES["gyro_z"], _AXES["accel_x"], _AXES["accel_y"]),
    *(_AXES["gyro_x"], _AXES["gyro_y"], _AXES["accel_z"], AHRS_BIT, AHRS_BIT, _FIX, _VELOCITY),
    *(WIND_BIT, WIND_BIT),
    *(COMMANDS_BIT, COMMANDS_BIT, _ANGLE, _ANGLE),
)
"""Bits of each of SENSOR_CHANNELS, of MOTION_CHANNELS, of WIND_CHANNELS and of the four commands:
that of the sensor and that of the part of it alone, an axis of the IMU or half of the GPS."""
