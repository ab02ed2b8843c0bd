"""Kernel that holds the velocity over ground against the accelerometers."""

from __future__ import annotations

import math

from twin.channels import PSI
from twin.health.evidence import (
    ALARM,
    CALM,
    CLEAR,
    GIVE_IN,
    exclude,
    is_fault,
    is_frozen,
    is_velocity_doubted,
    learning_share,
    limited,
    set_status,
    typical_size,
    velocity_step,
)
from twin.health.heading import is_late
from twin.health.state import (
    ACCELEROMETERS,
    AT_ODDS,
    COMPASS_SENSOR,
    DOUBTFUL,
    EXCLUDED,
    GPS,
    GYRO_SENSOR,
    JUMPED,
    LATE,
    NO_REASON,
    OK,
    RELEASED,
    STEPPED,
)
from usv_kernel.channels import ACCEL_X, ACCEL_Y, GPS_VX, GPS_VY
from usv_kernel.jit import inlined, kernel

__all__ = ["check_velocity"]

SUM_TIME = 3.0
"""Time constant of the leaky sum of velocity minus acceleration, s."""

FLOOR, ARM_TURN = 0.1, 0.5
"""Least level, m/s; and the yaw rate (in nominal speeds over a length) at which the arm between
antenna and IMU counts."""

SHORTEST_STEP = 0.01
"""Step for which the noise of the accelerometers counts at least, s."""

STEP_MAX, GAP_SHARE = 3.0, 0.2
"""Steps that are longer (s), or in which accelerometers miss a larger share, are not used."""

EXPLAINED = 0.5
"""A velocity did not step by itself where the reading of the accelerometers jumped by this share of
it, or where the step before was as large: then they are at fault."""

BIAS_SIZE, BIAS_REACH, BIAS_FLOOR = 3.0, 5.0, 0.02
"""A bias is learned from steps of up to so many levels, and up to so many standard deviations of
the data sheet and this, m/s2."""


@inlined
def _integrate_acceleration(dt, z, s, health):
    """Sum up the acceleration over ground since the last velocity; in gaps it is not known."""
    health.velocity_time += dt
    if health.row_gap == 0.0 and math.isfinite(z[ACCEL_X]) and math.isfinite(z[ACCEL_Y]):
        c, n = math.cos(s[PSI]), math.sin(s[PSI])
        ax, ay = z[ACCEL_X] - health.accel_bias[0], z[ACCEL_Y] - health.accel_bias[1]
        health.accel_gain[0] += (ax * c - ay * n) * dt
        health.accel_gain[1] += (ax * n + ay * c) * dt
    else:
        health.accel_gap += dt


@inlined
def _learn_accel_bias(step_x, step_y, T, s, health, given):
    """Learn the biases of the accelerometers from what the velocity gained more than they say."""
    c, n = math.cos(s[PSI]), math.sin(s[PSI])
    share = learning_share(T)
    most = BIAS_SIZE * health.velocity_level / SUM_TIME
    forward = (step_x * c + step_y * n) / max(T, 1e-3)
    side = (step_y * c - step_x * n) / max(T, 1e-3)
    health.accel_bias[0] += share * min(max(forward, -most), most)
    health.accel_bias[1] += share * min(max(side, -most), most)
    most = BIAS_REACH * given.accel_bias_sd + BIAS_FLOOR
    for k in range(2):
        health.accel_bias[k] = min(max(health.accel_bias[k], -most), most)


@inlined
def _find_fault(size, T, health, given):
    """Name the GPS if its velocity is late, or if it came back lately; else the accelerometers."""
    accel = health.sensors[ACCELEROMETERS]
    if is_fault(size, health.velocity_level, T, accel):
        gps = health.sensors[GPS]
        # the sensor that was at fault last is the more likely one; named so, it was in use briefly
        returned = gps.in_use >= GIVE_IN and health.clock - gps.since < GIVE_IN
        if is_late(health, given):
            exclude(health, GPS, LATE)
        elif returned and gps.since > accel.since:
            exclude(health, GPS, AT_ODDS)
        else:
            set_status(health, ACCELEROMETERS, EXCLUDED, AT_ODDS)


@inlined
def _has_stepped(step_x, step_y, T, health, given):
    """Return whether the velocity changed at once; remember its step and the acceleration.

    A fault of the accelerometers makes all further steps alike, and their readings jump with it.
    """
    mean_x, mean_y = health.accel_gain[0] / max(T, 1e-3), health.accel_gain[1] / max(T, 1e-3)
    size = math.hypot(step_x, step_y)
    before = math.hypot(health.velocity_step[0], health.velocity_step[1])
    measured = T * math.hypot(mean_x - health.accel_mean[0], mean_y - health.accel_mean[1])
    health.velocity_step[0], health.velocity_step[1] = step_x, step_y
    health.accel_mean[0], health.accel_mean[1] = mean_x, mean_y
    typical = health.velocity_level * math.sqrt(min(2.0 * T / SUM_TIME, 1.0))
    typical = max(typical, math.sqrt(2.0) * given.doppler_sd)
    sudden = size > ALARM * typical and before < EXPLAINED * size
    return health.velocity_level > 0.0 and sudden and measured < EXPLAINED * size


@inlined
def _hold_against_accelerometers(dt, z, s, health, given):
    """Add what the velocity gained more than the accelerometers say to the sum, and act on it."""
    accel, gps = health.sensors[ACCELEROMETERS], health.sensors[GPS]
    if gps.status == OK and health.clock - gps.since > GIVE_IN:
        gps.in_use = 0.0  # its last fault is long past
    T = health.velocity_time
    step_x, step_y = velocity_step(z, health)
    trusted = accel.status == OK and gps.status != EXCLUDED
    if _has_stepped(step_x, step_y, T, health, given) and trusted:
        exclude(health, GPS, STEPPED)
        health.velocity_sum[0] = health.velocity_sum[1] = 0.0
        return
    fade = math.exp(-T / SUM_TIME)
    health.velocity_sum[0] = health.velocity_sum[0] * fade + step_x
    health.velocity_sum[1] = health.velocity_sum[1] * fade + step_y
    size = math.hypot(health.velocity_sum[0], health.velocity_sum[1])
    floor = math.sqrt(2.0) * given.doppler_sd + given.accel_bias_sd * SUM_TIME + given.tilt
    floor += given.accel_sd * math.sqrt(0.5 * max(dt, SHORTEST_STEP) * SUM_TIME) + FLOOR
    floor += given.arm * ARM_TURN / given.time_scale
    level = typical_size(health.velocity_level, size, floor, T, health.clock, trusted)
    health.velocity_level = level
    if trusted:
        _learn_accel_bias(step_x, step_y, T, s, health, given)
    factor = limited(size, level)
    health.velocity_sum[0] *= factor
    health.velocity_sum[1] *= factor
    if gps.status != EXCLUDED and accel.status != EXCLUDED:
        _find_fault(size, T, health, given)
    elif accel.status == OK and size > CLEAR * level and health.reckoned_time < GIVE_IN:
        # the velocity of a GPS that is late follows its fixes too
        gps.followed = gps.calm = 0.0
    elif accel.status == EXCLUDED:
        consistent = size < CLEAR * level and not is_frozen(accel)
        accel.calm = accel.calm + T if consistent else 0.0
        if accel.calm > CALM + SUM_TIME:
            set_status(health, ACCELEROMETERS, OK, NO_REASON)


@inlined
def _is_reference_lost(health):
    """Return whether heading or velocity are in doubt: the accelerometers cannot be checked."""
    gps = health.sensors[GPS]
    of_fixes = gps.reason == RELEASED or gps.reason == JUMPED
    of_fixes = of_fixes or gps.reason == LATE or gps.reason == AT_ODDS
    lost = gps.status == EXCLUDED and not of_fixes
    lost = lost or is_velocity_doubted(health)
    for sensor in (COMPASS_SENSOR, GYRO_SENSOR):
        lost = lost or health.sensors[sensor].status >= DOUBTFUL
    return lost


@kernel
def check_velocity(dt, z, s, ready, new_gps, health, given):
    """Hold velocity against accelerometers; see :func:`twin.health.checks.check_sensors`."""
    _integrate_acceleration(dt, z, s, health)
    if not new_gps or not (math.isfinite(z[GPS_VX]) and math.isfinite(z[GPS_VY])):
        return
    T = health.velocity_time
    known = math.isfinite(health.velocity[0]) and T < STEP_MAX
    if _is_reference_lost(health):
        health.velocity_sum[0] = health.velocity_sum[1] = 0.0
    elif ready and known and health.accel_gap < GAP_SHARE * T:
        _hold_against_accelerometers(dt, z, s, health, given)
    health.velocity[0], health.velocity[1] = z[GPS_VX], z[GPS_VY]
    health.accel_gain[0] = health.accel_gain[1] = 0.0
    health.accel_gap = health.velocity_time = 0.0
