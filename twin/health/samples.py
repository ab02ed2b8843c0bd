"""Kernels that look at one sensor by itself: impossible numbers, repetition, absence."""

from __future__ import annotations

import math

from twin.channels import U
from twin.health.evidence import (
    CALM,
    FROZEN_INTERVALS,
    FROZEN_LONGEST,
    FROZEN_TIME,
    exclude,
    set_status,
)
from twin.health.state import (
    ABSENT,
    ACCELEROMETERS,
    COMPASS_SENSOR,
    DOUBTFUL,
    EXCLUDED,
    FROZEN,
    GPS,
    GYRO_SENSOR,
    IMPOSSIBLE,
    NO_REASON,
    OK,
    RETURNING,
    SILENT,
    VELOCITY_FROZEN,
    VELOCITY_WRONG,
    WRONG_SCALE,
)
from usv_kernel.channels import ACCEL_X, ACCEL_Y, COMPASS, GPS_VX, GPS_VY, GPS_X, GYRO
from usv_kernel.jit import inlined, kernel

__all__ = [
    "COMPASS_MAX",
    "GYRO_MAX",
    "POSITION_MAX",
    "SPEED_MAX",
    "find_frozen",
    "leave_out",
    "note_absence",
    "take_samples",
]

POSITION_MAX = 1e7
"""No local frame is wider, m."""

SPEED_MAX = 20.0
"""No boat is faster, in nominal speeds; that of a tug is a tenth of a racing boat's."""

COMPASS_MAX = 1e5
"""A heading that was never wrapped stays below, rad: beyond, its last digits are lost."""

GYRO_MAX, ACCEL_MAX = 10.0, 50.0
"""No boat turns or accelerates faster, rad/s and m/s2."""

IMPOSSIBLE_COUNT, IMPOSSIBLE_MAX, IMPOSSIBLE_FADE = 2.0, 20.0, 0.1
"""A single impossible number is masked; so many in few samples are a fault. The count stays
below the second number, and each good sample takes the third off."""

IMPOSSIBLE_MASK = 0.65
"""While the count is above, so for three samples after an impossible one, good numbers of the
sensor are masked too: garbage holds numbers of any size."""

IMPOSSIBLE_SENSORS = 2
"""A row in which so many sensors give impossible numbers is masked as a whole: what else it holds
is garbage of a plausible size."""

LONGEST_TIME = 60.0
"""For so long the longest repetition is remembered, s."""

INTERVAL_SHARE, INTERVAL_MAX = 0.05, 10.0
"""Share of a new interval in the typical one, and how many of those it counts at most: a gap is
no interval."""

REPEATED_TIME, REPEATED_INTERVALS, REPEATED_LONGEST = 2.0, 10.0, 5.0
"""An IMU that repeats itself for longer than this (s), than so many of its intervals and so many
times its longest repetition is frozen, without any other sensor that says so. So is a velocity."""

STILL, KNOWN_TIME = 0.2, 20.0
"""Share of the nominal speed below which a boat may be at rest; and for how long (s) a sensor must
be known."""

ABSENT_TIME, ABSENT_INTERVALS = 3.0, 10.0
"""A sensor is absent after so long without a sample (s), and after so many intervals."""


@inlined
def _is_garbage(z, fastest):
    """Return whether a row holds impossible numbers of several sensors."""
    sensors = 0
    if _is_impossible(z, GPS_X, GPS_VX, POSITION_MAX) or _is_impossible(
        z, GPS_VX, COMPASS, fastest
    ):
        sensors += 1
    if _is_impossible(z, COMPASS, GYRO, COMPASS_MAX):
        sensors += 1
    if _is_impossible(z, GYRO, ACCEL_X, GYRO_MAX):
        sensors += 1
    if _is_impossible(z, ACCEL_X, ACCEL_Y + 1, ACCEL_MAX):
        sensors += 1
    return sensors >= IMPOSSIBLE_SENSORS


@inlined
def _is_impossible(z, first, last, limit):
    """Return whether any of some channels is beyond a limit."""
    most = 0.0
    for j in range(first, last):
        if math.isfinite(z[j]) or math.isinf(z[j]):
            most = max(most, abs(z[j]))
    return most >= limit


@inlined
def _take_channels(dt, z, first, last, sensor, limit, health, out):
    """Take the channels of a sensor; return whether there is a new sample."""
    check = health.sensors[sensor]
    check.age += dt
    given, impossible, same = False, False, True
    for j in range(first, last):
        if math.isnan(z[j]):
            continue
        most = POSITION_MAX if sensor == GPS and j < GPS_VX else limit
        if not abs(z[j]) < most:
            impossible = True
            continue
        given = True
        same = same and z[j] == health.last[j]
    if impossible:
        for j in range(first, last):
            out[j] = math.nan
        check.impossible = min(check.impossible + 1.0, IMPOSSIBLE_MAX)
        # a gyro in degrees is not right again between its large numbers
        if check.impossible >= IMPOSSIBLE_COUNT and check.reason != WRONG_SCALE:
            exclude(health, sensor, IMPOSSIBLE)
        check.calm = 0.0
        check.age = 0.0
        return False
    if not given:
        return False
    check.impossible = max(check.impossible - IMPOSSIBLE_FADE, 0.0)
    if check.impossible > IMPOSSIBLE_MASK and check.status != EXCLUDED:
        for j in range(first, last):
            out[j] = math.nan
        check.age = 0.0
        return False
    if same:
        check.repeated += check.age
        check.age = 0.0
        return False
    if check.status != EXCLUDED:
        faded = check.longest * math.exp(-check.repeated / LONGEST_TIME)
        check.longest = max(faded, check.repeated)
    check.repeated = 0.0
    if check.status == ABSENT:
        set_status(health, sensor, OK, NO_REASON)
    if check.interval == 0.0:
        check.interval = check.age
    else:
        interval = min(check.age, INTERVAL_MAX * check.interval)
        check.interval += INTERVAL_SHARE * (interval - check.interval)
    check.age = 0.0
    return True


@inlined
def _take_velocity(new, T, z, health, out):
    """Leave out the velocity of a GPS that repeats it while its fixes move."""
    gps = health.sensors[GPS]
    if not (math.isfinite(out[GPS_VX]) and math.isfinite(out[GPS_VY])) or not new:
        return
    # a receiver that holds still says that it does
    moves = z[GPS_VX] != 0.0 or z[GPS_VY] != 0.0
    if moves and z[GPS_VX] == health.last[GPS_VX] and z[GPS_VY] == health.last[GPS_VY]:
        health.velocity_repeated += T
    else:
        health.velocity_longest = max(
            health.velocity_longest * math.exp(-T / LONGEST_TIME), health.velocity_repeated
        )
        health.velocity_repeated = 0.0
    longest = FROZEN_LONGEST * health.velocity_longest
    if health.velocity_repeated > max(FROZEN_TIME, FROZEN_INTERVALS * gps.interval, longest):
        out[GPS_VX] = out[GPS_VY] = math.nan
    # said later than done: a coarse receiver repeats itself for a moment
    if health.velocity_repeated > max(REPEATED_TIME, REPEATED_INTERVALS * gps.interval, longest):
        if gps.status == OK:
            set_status(health, GPS, DOUBTFUL, VELOCITY_FROZEN)
    elif gps.status == DOUBTFUL and gps.reason == VELOCITY_FROZEN:
        set_status(health, GPS, OK, NO_REASON)


@kernel
def take_samples(dt, z, health, given, out):
    """Copy a row without its impossible numbers; return whether GPS and compass are new."""
    for j in range(z.shape[0]):
        out[j] = z[j]
    fastest = SPEED_MAX * given.speed
    T = health.sensors[GPS].age + dt
    new_gps = _take_channels(dt, z, GPS_X, COMPASS, GPS, fastest, health, out)
    _take_velocity(new_gps, T, z, health, out)
    new_compass = _take_channels(dt, z, COMPASS, GYRO, COMPASS_SENSOR, COMPASS_MAX, health, out)
    _take_channels(dt, z, GYRO, ACCEL_X, GYRO_SENSOR, GYRO_MAX, health, out)
    _take_channels(dt, z, ACCEL_X, ACCEL_Y + 1, ACCELEROMETERS, ACCEL_MAX, health, out)
    if _is_garbage(z, fastest):
        for j in range(GPS_X, ACCEL_Y + 1):
            out[j] = math.nan
        return False, False
    return new_gps, new_compass


@inlined
def find_frozen(ready, health, given):
    """Leave out IMU sensors that repeat themselves in a way they never did in a moving boat."""
    moves = ready and abs(health.state[U]) > STILL * given.speed and health.clock > KNOWN_TIME
    for sensor in (GYRO_SENSOR, ACCELEROMETERS):
        check = health.sensors[sensor]
        never = max(
            REPEATED_TIME, REPEATED_INTERVALS * check.interval, REPEATED_LONGEST * check.longest
        )
        if moves and check.status != EXCLUDED and check.repeated > never:
            set_status(health, sensor, EXCLUDED, FROZEN)


@inlined
def note_absence(dt, ready, health):
    """Note which sensors are silent, and which give sane numbers again."""
    for sensor in range(ACCELEROMETERS + 1):
        check = health.sensors[sensor]
        silent = check.age > max(ABSENT_TIME, ABSENT_INTERVALS * check.interval)
        if check.status != ABSENT and silent:
            set_status(health, sensor, ABSENT, SILENT)
            check.since = health.clock - check.age
            check.impossible = 0.0
        if check.status == EXCLUDED and check.reason == IMPOSSIBLE:
            check.calm += dt
            if check.calm > CALM:
                check.impossible = 0.0
                # a place or heading must also be near where dead reckoning puts it, if there is any
                if ready and sensor <= COMPASS_SENSOR:
                    set_status(health, sensor, EXCLUDED, RETURNING)
                else:
                    set_status(health, sensor, OK, NO_REASON)


@inlined
def leave_out(health, out):
    """Remember the samples of a row, and mask those of excluded sensors."""
    for j in range(health.last.shape[0]):
        if math.isfinite(out[j]):
            health.last[j] = out[j]
    gps = health.sensors[GPS]
    if gps.status == EXCLUDED:
        for j in range(GPS_X, COMPASS):
            out[j] = math.nan
    elif gps.reason == VELOCITY_WRONG:
        out[GPS_VX] = out[GPS_VY] = math.nan
    if health.sensors[COMPASS_SENSOR].status == EXCLUDED:
        out[COMPASS] = math.nan
    if health.sensors[GYRO_SENSOR].status == EXCLUDED:
        out[GYRO] = math.nan
    if health.sensors[ACCELEROMETERS].status == EXCLUDED:
        out[ACCEL_X] = out[ACCEL_Y] = math.nan
