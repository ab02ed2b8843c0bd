"""Measurements of a boat that rolls and pitches, as they would be on an upright one."""

from __future__ import annotations

import math

from twin.motion.attitude import HOLD_MAX_S
from twin.motion.state import ANGLE, N_TILT
from usv_kernel.channels import ACCEL_X, ACCEL_Y, GPS_VX, GPS_VY, GPS_X, GPS_Y, GYRO
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import sincos

__all__ = ["turn_upright"]

FRESH_S = 1.0
SURE_SD_RAD = 0.1
"""Age of the last sample, and standard deviation, below which roll and pitch are taken out of the
other sensors."""


@inlined
def _is_sure(memory):
    """Return whether roll and pitch are known well enough, and from samples of now."""
    ages, P = memory.ages, memory.P
    by_rate = ages[0] < FRESH_S and ages[1] < FRESH_S
    by_angle = ages[3] < FRESH_S and ages[4] < FRESH_S
    var = max(P[ANGLE, ANGLE], P[N_TILT + ANGLE, N_TILT + ANGLE])
    return (by_rate or by_angle) and var < SURE_SD_RAD**2


@kernel
def turn_upright(heading, memory, given, z):
    """Write to a row (19,) what its sensors would say on an upright boat.

    Accelerations become horizontal, the yaw rate that of the heading, and the antenna stands
    above its place. ``heading`` is in rad.
    """
    if not _is_sure(memory):
        return
    phi, theta = memory.tilt[0, ANGLE], memory.tilt[1, ANGLE]
    s, c = sincos(phi)
    d, e = sincos(theta)
    p, q, r = memory.rate[0], memory.rate[1], memory.rate[2]
    # samples that repeat themselves stay as they are: whoever checks them must see it
    turn, ages = (q * s + r * c) / e, memory.planar_ages
    if ages[0] == 0.0:
        z[GYRO] = turn
    if max(ages[1], ages[2]) > HOLD_MAX_S and min(ages[1], ages[2]) <= HOLD_MAX_S:
        # but nobody else sees a single axis that is dead
        z[ACCEL_X] = z[ACCEL_Y] = math.nan
    elif memory.planar_new > 0.0:
        f, arm = memory.force, given.imu_arm
        low = s * f[1] + c * f[2]
        ahead, side = e * f[0] + d * low, c * f[1] - s * f[2]
        # what turning adds at the IMU of an upright boat
        z[ACCEL_X] = ahead - memory.turning[2] * arm[1] - turn * turn * arm[0]
        z[ACCEL_Y] = side + memory.turning[2] * arm[0] - turn * turn * arm[1]
    a, b, down = given.gps_arm[0], given.gps_arm[1], given.gps_arm[2]
    if down != 0.0 and math.isfinite(heading):
        # of the antenna against its place on an upright boat, forward and to starboard
        low = s * b + c * down
        ahead, side = e * a + d * low - a, c * b - s * down - b
        rise = q * down * c, -p * down * c
        h, g = sincos(heading)
        if math.isfinite(z[GPS_X]) and math.isfinite(z[GPS_Y]):
            z[GPS_X] -= g * ahead - h * side
            z[GPS_Y] -= h * ahead + g * side
        if math.isfinite(z[GPS_VX]) and math.isfinite(z[GPS_VY]):
            z[GPS_VX] -= g * rise[0] - h * rise[1]
            z[GPS_VY] -= h * rise[0] + g * rise[1]
