"""Kernels that hold the sensors against each other.

Each pair of sensors that measure one thing gives a leaky sum of what they disagree by, and each sum
has a level: what it typically is, and never less than the data sheets say. A sum far above its level
for a while is a fault. A third sensor, or the shape of the fault, says whose.
"""

from __future__ import annotations

import math

from twin.channels import PSI, R, U, V
from twin.health.commands import DECIDED, check_commands
from twin.health.state import (
    ABSENT,
    ACCELEROMETERS,
    AT_ODDS,
    COMMAND,
    COMPASS_SENSOR,
    DOUBTFUL,
    DRIFTS,
    EXCLUDED,
    FROZEN,
    GPS,
    GYRO_SENSOR,
    IMPOSSIBLE,
    JUMPED,
    LATE,
    NO_REASON,
    OK,
)
from usv_kernel.channels import ACCEL_X, ACCEL_Y, COMPASS, GPS_VX, GPS_VY, GPS_X, GPS_Y, GYRO
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import wrap

__all__ = ["check_sensors"]

YAW_TIME, PLACE_TIME, SPEED_TIME, COURSE_TIME = 3.0, 20.0, 3.0, 10.0
"""Time constants of the leaky sums, s."""

LEVEL_TIME = 120.0
"""Time constant of the levels, s."""

ALARM, CLEAR = 5.0, 3.0
"""A sum is at odds above so many levels, and consistent below so many."""

SURE = 0.5
"""A sum that is at odds for so long is a fault, s; at once above twice the alarm."""

CALM = 2.0
"""An excluded sensor comes back after it was consistent for so long, s."""

VOTE = 8.0
"""So long the course over ground may take to say which of compass and gyro is wrong, s."""

GIVE_IN = 60.0
"""What stays away for so long is taken for true, s."""

ABSENT_AFTER = 3.0
"""A sensor is absent after so long without a sample, and after ten typical intervals."""

REACH, SPEED_LIMIT, ACCEL_LIMIT, ROUNDS = 1e7, 20.0, 50.0, 1e5


@inlined
def _set(health, sensor, status, reason):
    check = health.sensors[sensor]
    if check.status != status or check.reason != reason:
        if not (check.status == status):
            check.since = health.clock
        check.status = status
        check.reason = reason
        check.evidence = 0.0
        check.calm = 0.0


@inlined
def _exclude(health, sensor, reason):
    """Leave a sensor out, and note where it would be by dead reckoning."""
    if health.sensors[sensor].status != EXCLUDED:
        if sensor == GPS:
            for k in range(2):
                health.reckoned[k] = health.fix[k] + health.way[k] - health.place[k]
                health.place[k] = 0.0
            health.reckoned_time = 0.0
        elif sensor == COMPASS_SENSOR:
            health.heading = health.last[COMPASS] + health.turned - health.yaw
            health.yaw = 0.0
    _set(health, sensor, EXCLUDED, reason)


@inlined
def _level(level, size, floor, dt, clock, ready):
    """Return the level after a sum of this size; it follows slowly, and faults hardly."""
    if level <= 0.0:
        level = 2.0 * floor
    if ready:
        share = dt / min(LEVEL_TIME, clock + 10.0)
        if size > CLEAR * level:
            share *= 0.1
        capped = min(size, CLEAR * level)
        level = math.sqrt(level * level + min(share, 0.1) * (capped * capped - level * level))
    return min(max(level, floor), 5.0 * floor)


@inlined
def _take_samples(dt, z, first, last, limit_low, sensor, health, out):
    """Mask impossible numbers; note age and repetition; return whether a sample is new."""
    check = health.sensors[sensor]
    check.age += dt
    given, bad, same = False, False, True
    for j in range(first, last):
        if math.isnan(z[j]):
            continue
        limit = limit_low if j >= 2 or sensor != GPS else REACH
        if not abs(z[j]) < limit:
            bad = True
            continue
        given = True
        same = same and z[j] == health.last[j]
    if bad:
        for j in range(first, last):
            out[j] = math.nan
        check.impossible = min(check.impossible + 1.0, 20.0)
        if check.impossible >= 2.0:
            _exclude(health, sensor, IMPOSSIBLE)
        check.calm = 0.0
        check.age = 0.0
        return False
    if not given:
        return False
    check.impossible = max(check.impossible - 0.1, 0.0)
    if same:
        check.repeated += check.age
        check.age = 0.0
        return False
    if check.status == OK:
        check.longest = max(check.longest * math.exp(-check.repeated / 60.0), check.repeated)
    check.repeated = 0.0
    if check.status == ABSENT:
        _set(health, sensor, OK, NO_REASON)
    check.interval = check.age if check.interval == 0.0 else check.interval + 0.05 * (
        min(check.age, 10.0 * check.interval) - check.interval
    )
    check.age = 0.0
    return True


@inlined
def _judge(size, level, dt, check):
    """Gather evidence; return whether it is a fault."""
    if size > ALARM * level:
        check.evidence += max(dt, 0.05)
    else:
        check.evidence = max(check.evidence - dt, 0.0)
    return check.evidence >= SURE or size > 2.0 * ALARM * level


@inlined
def _frozen(check):
    """Return whether a sensor repeats itself for longer than it ever did."""
    return check.repeated > max(0.2, 3.0 * check.interval, 2.0 * check.longest)


@inlined
def _vote(health):
    """Leave out compass or gyro, by which of them the course over ground follows less."""
    compass, gyro = health.sensors[COMPASS_SENSOR], health.sensors[GYRO_SENSOR]
    by_compass, by_gyro = abs(health.against_compass), abs(health.against_gyro)
    if compass.status == OK:
        _set(health, COMPASS_SENSOR, DOUBTFUL, AT_ODDS)
        _set(health, GYRO_SENSOR, DOUBTFUL, AT_ODDS)
    if max(by_compass, by_gyro) > 0.25 + 2.0 * min(by_compass, by_gyro) or (
        health.clock - compass.since > VOTE
    ):
        if by_compass > by_gyro:
            _exclude(health, COMPASS_SENSOR, AT_ODDS)
            _set(health, GYRO_SENSOR, OK, NO_REASON)
        else:
            _exclude(health, GYRO_SENSOR, AT_ODDS)
            _set(health, COMPASS_SENSOR, OK, NO_REASON)


@kernel
def _check_heading(dt, z, s, ready, new_compass, new_gyro, health, given):
    """Hold compass against gyro, and both against the course over ground."""
    compass, gyro = health.sensors[COMPASS_SENSOR], health.sensors[GYRO_SENSOR]
    rate = z[GYRO] if abs(z[GYRO]) < ACCEL_LIMIT else math.nan
    health.turn_time += dt
    health.course_time += dt
    if math.isfinite(rate):
        health.turned += (rate - health.gyro_bias) * dt
        health.course_gyro += (rate - health.gyro_bias) * dt
    else:
        health.turn_gap += dt
        health.turned += s[R] * dt
    health.heading += s[R] * dt
    given_compass = abs(z[COMPASS]) < ROUNDS
    frozen_compass = given_compass and _frozen(compass)
    fault = 0
    if given_compass and (new_compass or frozen_compass):
        T = health.turn_time
        step = wrap(z[COMPASS] - health.last[COMPASS] - health.turned)
        if ready and compass.status != EXCLUDED and abs(step) > 0.3 + 1.5 * given.max_turn * T:
            _exclude(health, COMPASS_SENSOR, JUMPED)
        if math.isfinite(step) and health.turn_gap < 0.2 * T and T < 5.0:
            floor = math.sqrt(2.0) * given.compass_sd + 0.005
            floor += (given.gyro_sd * math.sqrt(max(dt, 0.01)) + 3.0 * given.gyro_bias_sd) * YAW_TIME
            health.yaw = health.yaw * math.exp(-T / YAW_TIME) + step
            size = abs(health.yaw)
            trusted = compass.status == OK and gyro.status == OK
            health.yaw_level = _level(health.yaw_level, size, floor, T, health.clock, trusted)
            level = health.yaw_level
            if trusted:
                share = min(T / LEVEL_TIME, 0.1)
                bias = share * min(max(step / max(T, 1e-3), -3.0 * level / YAW_TIME), 3.0 * level / YAW_TIME)
                health.gyro_bias += bias
            most = 20.0 * given.gyro_bias_sd + 0.002
            health.gyro_bias = min(max(health.gyro_bias, -most), most)
            if compass.status != EXCLUDED and gyro.status != EXCLUDED:
                if abs(step) > max(ALARM * level, 1.5 * given.max_turn * T):
                    # no boat turns so fast
                    health.yaw -= step
                    _exclude(health, COMPASS_SENSOR, JUMPED)
                elif _judge(size, level, T, compass):
                    if _frozen(gyro):
                        _set(health, GYRO_SENSOR, EXCLUDED, FROZEN)
                    elif frozen_compass:
                        _exclude(health, COMPASS_SENSOR, FROZEN)
                    else:
                        _vote(health)
                elif compass.status == DOUBTFUL and size < CLEAR * level:
                    _set(health, COMPASS_SENSOR, OK, NO_REASON)
                    _set(health, GYRO_SENSOR, OK, NO_REASON)
            elif gyro.status == EXCLUDED:
                gyro.calm = gyro.calm + T if size < CLEAR * level and not _frozen(gyro) else 0.0
                if gyro.calm > CALM + YAW_TIME:
                    _set(health, GYRO_SENSOR, OK, NO_REASON)
            if compass.status == EXCLUDED and compass.reason != IMPOSSIBLE:
                # an excluded compass is held against the gyro's heading
                away = abs(wrap(z[COMPASS] - health.heading))
                lasted = health.clock - compass.since
                gate = CLEAR * level + 0.02 + 3.0 * given.gyro_bias_sd * lasted
                near = away < gate and not frozen_compass
                compass.calm = compass.calm + T if near else 0.0
                follows = size < CLEAR * level and not frozen_compass
                if compass.calm > CALM or (lasted > GIVE_IN and follows):
                    _set(health, COMPASS_SENSOR, OK, NO_REASON)
                    health.yaw = 0.0
        health.turned = health.turn_time = health.turn_gap = 0.0


@inlined
def _lag(health):
    """Return by how many seconds the course seems to lag the heading, and the yaw rate's variance."""
    w = max(health.late[0], 1e-9)
    mean_r, mean_b = health.late[1] / w, health.late[2] / w
    var = health.late[3] / w - mean_r * mean_r
    cov = health.late[4] / w - mean_r * mean_b
    return -cov / max(var, 1e-9), var


@kernel
def _check_course(z, s, new_gps, health, given):
    """Hold the course over ground against gyro and compass: whose heading is wrong?"""
    if not new_gps or not (math.isfinite(z[GPS_VX]) and math.isfinite(z[GPS_VY])):
        return
    fast = math.hypot(z[GPS_VX], z[GPS_VY])
    heading = z[COMPASS] if abs(z[COMPASS]) < ROUNDS else math.nan
    if fast < 0.2 * given.speed:
        health.course = math.nan
        return
    # in a turn the course lags the heading
    lag = min(max(_lag(health)[0], 0.0), 2.5 * given.time_scale)
    course = math.atan2(z[GPS_VY], z[GPS_VX]) + lag * s[R]
    T = health.course_time
    fade = math.exp(-T / COURSE_TIME)
    health.against_gyro *= fade
    health.against_compass *= fade
    if math.isfinite(health.course) and T < 3.0:
        change = wrap(course - health.course)
        health.against_gyro += wrap(change - health.course_gyro)
        if math.isfinite(heading) and math.isfinite(health.course_compass):
            health.against_compass += wrap(change - wrap(heading - health.course_compass))
    health.course, health.course_time, health.course_gyro = course, 0.0, 0.0
    health.course_compass = heading
    # how late the velocity is: by the yaw rate, the course lags the heading
    trusted = health.sensors[COMPASS_SENSOR].status == OK
    if math.isfinite(heading) and trusted and health.sensors[GYRO_SENSOR].status == OK:
        for k in range(5):
            health.late[k] *= math.exp(-T / 15.0)
        r, beta = s[R], wrap(course - lag * s[R] - heading)
        if abs(beta) < 1.2:
            health.late[0] += T
            health.late[1] += T * r
            health.late[2] += T * beta
            health.late[3] += T * r * r
            health.late[4] += T * r * beta


@kernel
def _check_place(dt, z, s, ready, new_gps, health, given):
    """Hold the fixes against their own velocity, or against that of the navigation."""
    gps = health.sensors[GPS]
    c, n = math.cos(s[PSI]), math.sin(s[PSI])
    north, east = s[U] * c - s[V] * n, s[U] * n + s[V] * c
    doppler = math.isfinite(z[GPS_VX]) and math.isfinite(z[GPS_VY])
    if doppler and gps.status != EXCLUDED:
        north, east = z[GPS_VX], z[GPS_VY]
    health.way[0] += north * dt
    health.way[1] += east * dt
    health.fix_time += dt
    s_north, s_east = s[U] * c - s[V] * n, s[U] * n + s[V] * c
    health.reckoned[0] += s_north * dt
    health.reckoned[1] += s_east * dt
    health.reckoned_time += dt
    if not (abs(z[GPS_X]) < REACH and abs(z[GPS_Y]) < REACH):
        return
    frozen = _frozen(gps)
    if not (new_gps or frozen):
        return
    T = health.fix_time
    known = math.isfinite(health.fix[0])
    step_x = z[GPS_X] - health.fix[0] - health.way[0]
    step_y = z[GPS_Y] - health.fix[1] - health.way[1]
    health.fix[0], health.fix[1] = z[GPS_X], z[GPS_Y]
    health.way[0] = health.way[1] = health.fix_time = 0.0
    if not known or not ready:
        return
    if T > 30.0:
        health.place[0] = health.place[1] = 0.0
        return
    fade = math.exp(-T / PLACE_TIME)
    health.place[0] = health.place[0] * fade + step_x
    health.place[1] = health.place[1] * fade + step_y
    size = math.hypot(health.place[0], health.place[1])
    floor = math.sqrt(2.0) * given.gps_sd + 0.15 + given.doppler_sd * 2.0
    if not doppler:
        floor += 0.03 * given.speed * PLACE_TIME
    floor += 0.02 * given.speed * T
    health.place_level = _level(health.place_level, size, floor, T, health.clock, gps.status == OK)
    level = health.place_level
    if gps.status != EXCLUDED:
        step = math.hypot(step_x, step_y)
        jumped = step > max(ALARM * level, 5.0) + 0.5 * given.speed * T
        if jumped:
            _exclude(health, GPS, JUMPED)
        elif _judge(size, level, T, gps):
            _exclude(health, GPS, FROZEN if frozen else DRIFTS)
    else:
        lasted = health.reckoned_time
        if math.hypot(step_x, step_y) > max(ALARM * level, 5.0) + 0.5 * given.speed * T:
            health.place[0] = health.place[1] = size = 0.0
        lost = health.sensors[COMPASS_SENSOR].status != OK or (
            health.sensors[GYRO_SENSOR].status != OK
        )
        gate = CLEAR * level + (0.2 if lost else 0.05) * given.speed * lasted
        away = math.hypot(z[GPS_X] - health.reckoned[0], z[GPS_Y] - health.reckoned[1])
        follows = size < CLEAR * level and not frozen
        if gps.reason == IMPOSSIBLE:
            return
        gps.calm = gps.calm + T if away < gate and follows else 0.0
        if gps.calm > 1.0 or (lasted > GIVE_IN and follows):
            _set(health, GPS, OK, NO_REASON)
            health.place[0] = health.place[1] = 0.0


@kernel
def _check_speeds(dt, z, s, ready, new_gps, new_imu, health, given):
    """Hold the velocity over ground against the accelerometers."""
    accel, gps = health.sensors[ACCELEROMETERS], health.sensors[GPS]
    driven = abs(z[ACCEL_X]) < ACCEL_LIMIT and abs(z[ACCEL_Y]) < ACCEL_LIMIT
    c, n = math.cos(s[PSI]), math.sin(s[PSI])
    health.velocity_time += dt
    if driven:
        ax, ay = z[ACCEL_X] - health.accel_bias[0], z[ACCEL_Y] - health.accel_bias[1]
        health.gained[0] += (ax * c - ay * n) * dt
        health.gained[1] += (ax * n + ay * c) * dt
    else:
        health.gain_gap += dt
    if not new_gps or not (math.isfinite(z[GPS_VX]) and math.isfinite(z[GPS_VY])):
        return
    T = health.velocity_time
    if ready and math.isfinite(health.velocity[0]) and T < 3.0 and health.gain_gap < 0.2 * T:
        step_x = z[GPS_VX] - health.velocity[0] - health.gained[0]
        step_y = z[GPS_VY] - health.velocity[1] - health.gained[1]
        fade = math.exp(-T / SPEED_TIME)
        health.speeds[0] = health.speeds[0] * fade + step_x
        health.speeds[1] = health.speeds[1] * fade + step_y
        size = math.hypot(health.speeds[0], health.speeds[1])
        floor = math.sqrt(2.0) * given.doppler_sd + given.accel_bias_sd * SPEED_TIME + given.tilt
        floor += given.accel_sd * math.sqrt(0.5 * max(dt, 0.01) * SPEED_TIME) + 0.1
        floor += given.arm * 0.5 / given.time_scale
        trusted = accel.status == OK and gps.status == OK
        health.speeds_level = _level(health.speeds_level, size, floor, T, health.clock, trusted)
        level = health.speeds_level
        if trusted:
            share = min(T / LEVEL_TIME, 0.1)
            most = 3.0 * level / SPEED_TIME
            forward = (step_x * c + step_y * n) / max(T, 1e-3)
            side = (step_y * c - step_x * n) / max(T, 1e-3)
            health.accel_bias[0] += share * min(max(forward, -most), most)
            health.accel_bias[1] += share * min(max(side, -most), most)
            most = 5.0 * given.accel_bias_sd + 0.02
            for k in range(2):
                health.accel_bias[k] = min(max(health.accel_bias[k], -most), most)
        if gps.status != EXCLUDED and accel.status != EXCLUDED:
            lag, var = _lag(health)
            natural = 2.5 * given.time_scale + 1.0 + given.latency
            if _judge(size, level, T, accel):
                if lag > natural and var > (0.05 / given.time_scale) ** 2:
                    _exclude(health, GPS, LATE)
                else:
                    _set(health, ACCELEROMETERS, EXCLUDED, AT_ODDS)
        elif accel.status == EXCLUDED:
            near = size < CLEAR * level
            accel.calm = accel.calm + T if near else 0.0
            if accel.calm > CALM + SPEED_TIME:
                _set(health, ACCELEROMETERS, OK, NO_REASON)
    health.velocity[0], health.velocity[1] = z[GPS_VX], z[GPS_VY]
    health.gained[0] = health.gained[1] = health.gain_gap = health.velocity_time = 0.0


@kernel
def check_sensors(dt, z, cmd, s, ready, health, given, out):
    """Hold the sensors of a row against each other, and leave out those at fault.

    Parameters
    ----------
    dt : float
        Time since the row before, s.
    z, cmd : ndarray, shapes (10,), (4,)
        The row.
    s : ndarray, shape (6,)
        State that the predictor had after the row before.
    ready : bool
        Whether that means anything.
    health, given : record
        ``HEALTH``, advanced in place; ``HEALTH_SETTINGS``.
    out : ndarray, shape (10,)
        The row without the samples of excluded sensors.
    """
    health.clock += dt
    for j in range(z.shape[0]):
        out[j] = z[j]
    fastest = SPEED_LIMIT * given.speed
    new_gps = _take_samples(dt, z, GPS_X, COMPASS, fastest, GPS, health, out)
    new_compass = _take_samples(dt, z, COMPASS, GYRO, ROUNDS, COMPASS_SENSOR, health, out)
    new_gyro = _take_samples(dt, z, GYRO, ACCEL_X, 10.0, GYRO_SENSOR, health, out)
    new_imu = _take_samples(dt, z, ACCEL_X, ACCEL_Y + 1, ACCEL_LIMIT, ACCELEROMETERS, health, out)
    _check_heading(dt, out, s, ready, new_compass, new_gyro, health, given)
    _check_place(dt, out, s, ready, new_gps, health, given)
    _check_speeds(dt, out, s, ready, new_gps, new_imu, health, given)
    _check_course(out, s, new_gps, health, given)
    check_commands(dt, cmd, s, ready, health, given)
    command = health.sensors[COMMAND]
    # what is doubtful for long is a boat that has changed: the twin must learn it
    fresh = command.status == DOUBTFUL and health.clock - command.since < DECIDED
    health.commands_doubted = 1.0 if command.status == EXCLUDED or fresh else 0.0
    for sensor in range(4):
        check = health.sensors[sensor]
        if check.status != ABSENT and check.age > max(ABSENT_AFTER, 10.0 * check.interval):
            _set(health, sensor, ABSENT, NO_REASON)
            check.since = health.clock - check.age
            check.impossible = 0.0
        if check.status == EXCLUDED and check.reason == IMPOSSIBLE:
            check.calm += dt
            if check.calm > CALM:
                check.impossible = 0.0
                # a place or heading must also be near where dead reckoning puts it
                if sensor <= COMPASS_SENSOR:
                    _set(health, sensor, EXCLUDED, JUMPED)
                else:
                    _set(health, sensor, OK, NO_REASON)
    for j in range(8):
        if math.isfinite(out[j]):
            health.last[j] = out[j]
    if health.sensors[GPS].status == EXCLUDED:
        for j in range(GPS_X, COMPASS):
            out[j] = math.nan
    if health.sensors[COMPASS_SENSOR].status == EXCLUDED:
        out[COMPASS] = math.nan
    if health.sensors[GYRO_SENSOR].status == EXCLUDED:
        out[GYRO] = math.nan
    if health.sensors[ACCELEROMETERS].status == EXCLUDED:
        out[ACCEL_X] = out[ACCEL_Y] = math.nan
