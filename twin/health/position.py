"""Kernel that holds the fixes against their own velocity, or against that of the navigation."""

from __future__ import annotations

import math

from twin.health.evidence import (
    ALARM,
    CLEAR,
    GIVE_IN,
    exclude,
    is_fault,
    is_frozen,
    limited,
    over_ground,
    set_status,
    typical_size,
    velocity_step,
)
from twin.health.standing import (
    accept_stand,
    are_fixes_standing,
    begin_standing,
    have_stood,
    note_leap,
)
from twin.health.state import (
    ABSENT,
    ACCELEROMETERS,
    COMPASS_SENSOR,
    DOUBTFUL,
    DRIFTS,
    EXCLUDED,
    FROZEN,
    GPS,
    GYRO_SENSOR,
    IMPOSSIBLE,
    JUMPED,
    NO_REASON,
    OK,
    RELEASED,
    RETURNING,
    STEPPED,
    VELOCITY_FROZEN,
    VELOCITY_WRONG,
)
from usv_kernel.channels import GPS_VX, GPS_VY, GPS_X, GPS_Y
from usv_kernel.jit import inlined, kernel

__all__ = ["check_position"]

SUM_TIME = 20.0
"""Time constant of the leaky sum of position minus velocity, s: slow pulls need a long one."""

FLOOR, VELOCITY_TIME = 0.15, 2.0
"""Least level, m; and the time for which a velocity error lasts, s."""

PULL_TIME, PULL_MEAN = 8.0, 1.0
"""Time constants of a long and a short mean of position minus velocity, s: in both, the noise of
single fixes averages out, and a pull of half a metre a second shows in five seconds."""

PULL_FLOOR, PULL_VELOCITY, BIAS_TIME = 0.05, 1.0, 400.0
"""Least level of their distance, m; the time for which a velocity error counts in it, and the time
in which the drifting error of a fix changes, s."""

TINY = 1e-9
"""Least age of the means, s: two fixes may have one stamp. Also the least distance, m."""

RECKONED_SHARE = 0.03
"""Error of the navigation's velocity where the GPS gives none, in nominal speeds."""

STEP_SHARE = 0.02
"""Error of a straight line between two fixes, in nominal speeds times the time between them."""

GAP_MAX = 30.0
"""After a longer gap (s) the sum begins again: dead reckoning says little by then."""

JUMP_MIN, JUMP_SHARE = 5.0, 0.5
"""A jump is larger than this (m) and than this share of the way at nominal speed."""

GATE, GATE_LOST = 0.05, 0.2
"""Growth of the distance from dead reckoning within which a GPS comes back, in nominal speeds:
with a trusted heading, and without. The second is also that of one without velocity that was frozen
and moves again."""

LOST_TIME = 10.0
"""After a GPS that gave garbage, or was drawn away, is left out for so long (s), its fixes are
right if they follow their own velocity: dead reckoning began at a wrong place."""

STEP_SURE = 3.0
"""Standard deviations of a velocity's step that no acceleration explains."""

LATE_MOST, FAST = 8.0, 5.0
"""A GPS is late by less than this, s. Of a boat that sails faster than so many levels of its
velocity, the accelerometers tell a late one."""

CATCHING_UP = 0.1
"""Error of the velocity of dead reckoning, in nominal speeds: frozen fixes that go on to the right
place within seconds are faster."""

CALM_VELOCITY = 3.0
"""After its velocity stepped, a GPS whose fixes were near dead reckoning for so long (s) is used
without it."""

CALM, CALM_FROZEN, CALM_LONG = 1.0, 3.0, 8.0
"""An excluded GPS comes back after it was near dead reckoning for so long, s. One that was frozen
comes back after its fixes followed its velocity again for so long, wherever it is. Where it gives
none, it must move with the boat for the last time, and not be too far away;
one that was left out for as long as nothing had been said against it, after the third time."""


@inlined
def _begin_sum(health):
    """Set the sum to zero."""
    health.position_sum[0] = health.position_sum[1] = 0.0


@inlined
def _begin_pull(health):
    """Forget the means of position minus velocity."""
    health.pull_age = 0.0


@inlined
def _pull(step_x, step_y, T, health, given):
    """Learn the means of position minus velocity; return how far they are apart, in levels."""
    health.pull_age += max(T, TINY)
    short = min(T / min(health.pull_age, PULL_MEAN), 1.0)
    long = min(T / min(health.pull_age, PULL_TIME), 1.0)
    for k in range(2):
        # both from the last fix
        step = step_x if k == 0 else step_y
        health.pull_short[k] = (1.0 - short) * (health.pull_short[k] - step)
        health.pull_long[k] = (1.0 - long) * (health.pull_long[k] - step)
    size = math.hypot(
        health.pull_short[0] - health.pull_long[0], health.pull_short[1] - health.pull_long[1]
    )
    white = given.gps_sd * math.sqrt(min(T / (2.0 * PULL_MEAN), 1.0))
    drift = given.gps_bias_sd * math.sqrt(PULL_TIME / BIAS_TIME)
    other = math.hypot(given.doppler_sd * PULL_VELOCITY, PULL_FLOOR)
    floor = math.hypot(math.hypot(white, drift), other) + STEP_SHARE * given.speed * T
    learn = health.sensors[GPS].status != EXCLUDED
    health.pull_level = typical_size(health.pull_level, size, floor, T, health.clock, learn)
    factor = limited(size, health.pull_level)
    for k in range(2):
        health.pull_short[k] *= factor
        health.pull_long[k] *= factor
    return size / health.pull_level


@inlined
def _reckon(dt, z, s, health):
    """Move on by the velocity since the last fix, and from where an excluded GPS was right."""
    north, east = over_ground(s)
    health.reckoned[0] += north * dt
    health.reckoned[1] += east * dt
    health.reckoned_time += dt
    if health.row_gap == 0.0:
        health.stand_way[0] += north * dt
        health.stand_way[1] += east * dt
    doppler = math.isfinite(z[GPS_VX]) and math.isfinite(z[GPS_VY])
    if doppler:
        north, east = z[GPS_VX], z[GPS_VY]
    health.travelled[0] += north * dt
    health.travelled[1] += east * dt
    sensors = health.sensors
    blind = sensors[COMPASS_SENSOR].status == ABSENT and sensors[GYRO_SENSOR].status == ABSENT
    if blind or health.row_gap > 0.0:
        health.gap_way[0] += north * dt
        health.gap_way[1] += east * dt
    health.fix_time += dt
    return doppler


@inlined
def _excuse_gap(step_x, step_y, health):
    """Return a step without what of it a gap explains: no rows, or rows without any turn measured.

    In it the boat may have turned; or the clock stepped, and the boat did not move at all. So it
    may be anywhere within the way that it would have made ahead.
    """
    moved_x, moved_y = step_x + health.gap_way[0], step_y + health.gap_way[1]
    way = math.hypot(health.gap_way[0], health.gap_way[1])
    health.gap_way[0] = health.gap_way[1] = 0.0
    if way == 0.0:
        return step_x, step_y
    share = max(1.0 - way / max(math.hypot(moved_x, moved_y), TINY), 0.0)
    return share * moved_x, share * moved_y


@inlined
def _is_released(z, jump, health, given):
    """Return whether the velocity changes with a jump (m), though no accelerometer measured it.

    So does a GPS that was drawn away, once it is right again. Other jumps leave the velocity right,
    but for that of a GPS that begins to be late. It is as far as the boat sailed meanwhile, and
    accelerometers contradict its velocity only where the boat is fast.
    """
    T = health.velocity_time
    sd = math.sqrt(2.0) * given.doppler_sd + (given.accel_bias_sd + given.tilt) * T
    step_x, step_y = velocity_step(z, health)
    measured = health.sensors[ACCELEROMETERS].status == OK and health.accel_gap == 0.0
    speed = math.hypot(health.velocity[0], health.velocity[1])
    not_late = jump > LATE_MOST * speed or speed > FAST * health.velocity_level
    return measured and not_late and math.hypot(step_x, step_y) > STEP_SURE * sd  # false for NaN


@inlined
def _is_catching_up(z, noise, health, given):
    """Return whether fixes come nearer to dead reckoning faster than its velocity may err."""
    x, y = z[GPS_X] - health.reckoned[0], z[GPS_Y] - health.reckoned[1]
    nearer = -(health.position_sum[0] * x + health.position_sum[1] * y)
    most = noise + CATCHING_UP * given.speed * health.sensors[GPS].followed
    return nearer > most * math.hypot(x, y)


@inlined
def _readmit(z, T, follows, frozen, doppler, health, given):
    """Take the GPS back after it was near dead reckoning for a while.

    ``follows`` tells whether its fixes follow its velocity, if it gives one.
    """
    gps = health.sensors[GPS]
    if gps.reason == IMPOSSIBLE:
        return
    level, lasted = health.position_level, health.reckoned_time
    heading_lost = (
        health.sensors[COMPASS_SENSOR].status != OK or health.sensors[GYRO_SENSOR].status != OK
    )
    gate = CLEAR * level + (GATE_LOST if heading_lost else GATE) * given.speed * lasted
    error = math.hypot(z[GPS_X] - health.reckoned[0], z[GPS_Y] - health.reckoned[1])
    near = error < gate and not frozen
    if not follows:
        # the next fix begins a new track
        _begin_sum(health)
        _begin_pull(health)
    gps.followed = gps.followed + T if follows else 0.0
    stepped = gps.reason == STEPPED
    gps.calm = gps.calm + T if near and (follows or stepped) else 0.0
    if stepped and gps.calm > CALM_VELOCITY and gps.followed < CALM:
        set_status(health, GPS, DOUBTFUL, VELOCITY_WRONG)
        return
    likely = error < CLEAR * level + GATE_LOST * given.speed * lasted
    alive = gps.followed > CALM_FROZEN if doppler else likely and gps.followed > CALM_LONG
    alive = alive and gps.reason == FROZEN
    # dead reckoning is worth as much as the fixes from which it began
    most = min(max(gps.in_use, LOST_TIME), GIVE_IN)
    if gps.reason == RETURNING or gps.reason == RELEASED:
        most = LOST_TIME
    lasting = lasted > most and gps.followed > CALM_LONG
    calm = gps.calm > CALM and follows and (not stepped or gps.followed > CALM_VELOCITY)
    if calm or alive or lasting:
        if lasted > GIVE_IN:
            gps.in_use = 0.0  # what spoke against it so long is at fault
            accept_stand(health)
        set_status(health, GPS, OK, NO_REASON)
        _begin_sum(health)
        _begin_pull(health)
        health.velocity_sum[0] = health.velocity_sum[1] = 0.0


@inlined
def _take_velocity_back(T, follows, health):
    """Use the velocity again after the fixes followed it for a while."""
    gps = health.sensors[GPS]
    gps.calm = gps.calm + T if follows else 0.0
    if not follows:
        _begin_sum(health)
        _begin_pull(health)
    if gps.calm > CALM_LONG:
        set_status(health, GPS, OK, NO_REASON)


@kernel
def check_position(dt, z, s, ready, possible, new_gps, health, given):
    """Hold fixes against velocity; see :func:`twin.health.checks.check_sensors`.

    A predictor whose state is not ``possible`` is lost. Only fixes bring it back.
    """
    note_leap(dt, z, health, given)
    doppler = _reckon(dt, z, s, health)
    gps = health.sensors[GPS]
    frozen = is_frozen(gps)
    if not (math.isfinite(z[GPS_X]) and math.isfinite(z[GPS_Y]) and (new_gps or frozen)):
        return
    T = health.fix_time
    known = math.isfinite(health.fix[0])
    step_x = z[GPS_X] - health.fix[0] - health.travelled[0]
    step_y = z[GPS_Y] - health.fix[1] - health.travelled[1]
    step_x, step_y = _excuse_gap(step_x, step_y, health)
    if not (possible or doppler):
        step_x = step_y = 0.0
    health.fix[0], health.fix[1] = z[GPS_X], z[GPS_Y]
    health.travelled[0] = health.travelled[1] = health.fix_time = 0.0
    if not known or not ready:
        return
    # what fixes and a repeated velocity disagree by is no fault of the fixes
    if T > GAP_MAX or (gps.status == DOUBTFUL and gps.reason == VELOCITY_FROZEN):
        _begin_sum(health)
        _begin_pull(health)
        begin_standing(health)
        return
    fade = math.exp(-T / SUM_TIME)
    health.position_sum[0] = health.position_sum[0] * fade + step_x
    health.position_sum[1] = health.position_sum[1] * fade + step_y
    size = math.hypot(health.position_sum[0], health.position_sum[1])
    noise = math.sqrt(2.0) * given.gps_sd + FLOOR + given.doppler_sd * VELOCITY_TIME
    noise += STEP_SHARE * given.speed * T
    floor = noise if doppler else noise + RECKONED_SHARE * given.speed * SUM_TIME
    level = typical_size(
        health.position_level, size, floor, T, health.clock, gps.status != EXCLUDED
    )
    health.position_level = level
    jumped = math.hypot(step_x, step_y) > (
        max(ALARM * level * noise / floor, JUMP_MIN) + JUMP_SHARE * given.speed * T
    )
    stood = have_stood(s, health, given)
    if jumped:
        begin_standing(health)
    standing = are_fixes_standing(z, s, T, health, given)
    # dead reckoning since another fault may be wrong
    asked = gps.status != EXCLUDED or gps.reason == FROZEN or gps.reason == DRIFTS
    standing = standing and asked
    frozen = frozen or standing
    pull = _pull(step_x, step_y, T, health, given)
    follows = not (jumped or frozen)
    if doppler:
        follows = follows and size < CLEAR * level and pull < CLEAR
    elif gps.status == EXCLUDED and gps.reason == FROZEN:
        follows = follows and not _is_catching_up(z, noise, health, given)
    if gps.status == DOUBTFUL and gps.reason == VELOCITY_WRONG and not jumped:
        _take_velocity_back(T, follows, health)
    elif gps.status != EXCLUDED:
        if jumped:
            jump = math.hypot(step_x, step_y)
            released = _is_released(z, jump, health, given)
            exclude(health, GPS, FROZEN if stood else RELEASED if released else JUMPED)
            if stood:
                gps.in_use = 0.0  # dead reckoning begins where the fixes stood
        elif standing:
            exclude(health, GPS, FROZEN)
        # without a measured velocity, only the predictor's is left: it may be the one that errs
        elif (doppler or frozen) and is_fault(max(size / level, pull), 1.0, T, gps):
            exclude(health, GPS, FROZEN if frozen else DRIFTS)
    else:
        if standing and gps.reason == DRIFTS:
            exclude(health, GPS, FROZEN)
        if jumped:
            _begin_sum(health)
            _begin_pull(health)
        _readmit(z, T, follows, frozen, doppler, health, given)
