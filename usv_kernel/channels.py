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
    "MOTION_CHANNELS",
    "SENSOR_CHANNELS",
    "WIND_CHANNELS",
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

MOTION_CHANNELS = (
    "gyro_x_radps",
    "gyro_y_radps",
    "accel_z_mps2",
    "ahrs_roll_rad",
    "ahrs_pitch_rad",
    "gps_z_m",
    "gps_vz_mps",
)
"""What shows roll, pitch and heave: the other axes of the IMU (roll rate, pitch rate, specific
force down), roll and pitch of an AHRS, and position and velocity of the GNSS down. An upright boat
at rest has a specific force of -9.81 m/s2 down."""

WIND_CHANNELS = ("apparent_wind_mps", "apparent_wind_rad")
"""What an anemometer on the boat says: speed of the apparent wind, and the direction that it comes
from, clockwise from the bow."""
