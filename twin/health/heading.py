"""Kernels that hold the compass against the gyro, and both against the course over ground."""

from __future__ import annotations

import math

from twin.channels import R
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
)
from twin.health.state import (
    AT_ODDS,
    COMPASS_SENSOR,
    DOUBTFUL,
    EXCLUDED,
    FROZEN,
    GYRO_SENSOR,
    IMPOSSIBLE,
    JUMPED,
    NO_REASON,
    OK,
    TURN_RING,
    WRONG_SCALE,
)
from usv_kernel.channels import COMPASS, GPS_VX, GPS_VY, GYRO
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import wrap

__all__ = ["check_course", "check_heading", "is_late", "turn_to_now"]

SUM_TIME = 3.0
"""Time constant of the leaky sum of compass minus gyro, s: well below that of a gyro's drift,
well above that of noise."""

TURN_TIME, SCALE_TIME = 1.0, 3.0
"""What compass and gyro turned within the first (s) is compared in sign and size over the second
(s): shorter, noise of the compass hides it; longer, few turns are left to compare."""

TURNED = 9.0
"""The compass must turn by more than its noise: so many times its variance."""

CORRELATED = 0.8
"""Two turns are proportional if they share so much of their variance."""

REVERSED, UNIT = (-1.4, -0.6), 15.0
"""Turn of the compass over that of the gyro where one of them has the wrong sign; and the factor
from which on, up or down, one of them has the wrong unit (degrees make 57). Other faults do not
make the two turn in proportion so."""

RIGHT_SCALE = (0.6, 1.5)
"""The same of a gyro that is right; a compass near iron turns by so much less or more."""

COMPASS_RESOLUTION = 0.005
"""Rounding of a compass that gives tenths or thirds of a degree, rad."""

SHORTEST_STEP = 0.01
"""Step for which the noise of a gyro or accelerometer counts at least, s."""

BIAS_SDS = 3.0
"""Standard deviations of a bias that a floor or gate allows."""

BIAS_REACH, BIAS_FLOOR = 20.0, 0.002
"""A gyro bias is learned up to so many standard deviations of the data sheet and this, rad/s."""

JUMP_FREE, JUMP_TURN = 0.3, 1.5
"""A compass jumps if it turns against the gyro by more than this (rad) and by so many times
what the boat can turn meanwhile."""

GAP_SHARE, STEP_MAX = 0.2, 5.0
"""Steps in which the gyro is missing for a larger share, or that are longer (s), are not used."""

AHEAD, DRIFT_TIME, CALM_COURSE = 0.35, 4.0, 8.0
"""A compass also comes back if the mean angle between heading and course over such a time (s) was
smaller than this (rad; leeway and current make less), and it followed the gyro, so long (s)."""

RATE_TIME = 0.3
"""Time constant of the compass's yaw rate, s."""

GATE = 0.02
"""Least distance from dead reckoning within which a compass comes back, rad."""

COURSE_TIME = 10.0
"""Time constant of the leaky sums of course minus gyro and compass, s."""

VOTE_TIME = 8.0
"""So long the course over ground may take to say which of compass and gyro is wrong, s."""

WITNESS_TIME, WITNESS = 60.0, 0.2
"""Where one of the two has the wrong sign or unit, the course says which. It lags, and may support
the wrong one for seconds: what it said within the first (s) decides, above the second (rad2 s)."""

VOTE_FREE, VOTE_FACTOR = 0.25, 2.0
"""One of the two is named when the course is further from it by this (rad) and this factor."""

TURNS_AGREE = 0.6
"""Without a gyro, a compass turns as the course does if they differ by less, rad: the lag of the
course is known roughly."""

SLOW = 0.2
"""Below this share of the nominal speed a course over ground is noise."""

COURSE_GAP = 3.0
"""Two courses further apart in time (s) are not compared."""

LAG_MAX = 2.5
"""In a turn the course of a boat lags its heading by no more, in lengths over nominal speed."""

LAG_TIME, DRIFT_ANGLE_MAX = 15.0, 1.2
"""Time over which that lag is learned, s; larger drift angles (rad) say nothing of it."""

LATE_TIME, LATE_FREE, LATE_TURN = 2.5, 1.0, 0.05
"""By so many lengths over nominal speed, and so many seconds, a velocity may lag the heading. The
third is the standard deviation of the yaw rate from which on a lag shows, in U / L."""

TINY = 1e-9


@inlined
def _integrate_gyro(dt, z, s, health):
    """Sum up what the gyro turned since the last compass sample and the last course.

    What it turned in a gap between rows is not known: the step then counts as too long.
    """
    gap = health.row_gap > 0.0
    health.gyro_time += max(dt, STEP_MAX) if gap else dt
    health.course_time += max(dt, COURSE_GAP) if gap else dt
    if math.isfinite(z[GYRO]):
        health.gyro_rate = z[GYRO] - health.gyro_bias
        health.gyro_turn += (z[GYRO] - health.gyro_bias) * dt
        health.course_gyro += (z[GYRO] - health.gyro_bias) * dt
    else:
        health.gyro_gap += dt
        health.gyro_turn += s[R] * dt
    health.reckoned_heading += s[R] * dt


@inlined
def _learn_gyro_bias(step, level, T, health, given):
    """Learn the gyro's bias from what the compass turned more than it."""
    most = BIAS_SDS * level / SUM_TIME
    health.gyro_bias += learning_share(T) * min(max(step / max(T, 1e-3), -most), most)
    most = BIAS_REACH * given.gyro_bias_sd + BIAS_FLOOR
    health.gyro_bias = min(max(health.gyro_bias, -most), most)


@inlined
def _compare_scale(turned, T, health):
    """Add what the compass turned since its last sample to the regression on the gyro's turn."""
    sums, fade, forget = health.gyro_scale, math.exp(-T / TURN_TIME), math.exp(-T / SCALE_TIME)
    sums.compass = sums.compass * fade + turned
    sums.gyro = sums.gyro * fade + health.gyro_turn
    sums.weight = sums.weight * forget + T
    sums.c = sums.c * forget + T * sums.compass
    sums.g = sums.g * forget + T * sums.gyro
    sums.c_c = sums.c_c * forget + T * sums.compass * sums.compass
    sums.c_g = sums.c_g * forget + T * sums.compass * sums.gyro
    sums.g_g = sums.g_g * forget + T * sums.gyro * sums.gyro


@inlined
def _forget_scale(health):
    """Begin the regression again."""
    sums = health.gyro_scale
    sums.weight = sums.c = sums.g = sums.c_c = sums.c_g = sums.g_g = 0.0


@inlined
def _gyro_scale(health, given):
    """Return the turn of the compass over that of the gyro; NaN where they are not proportional."""
    sums = health.gyro_scale
    weight = max(sums.weight, TINY)
    c, g = sums.c / weight, sums.g / weight
    c_c, g_g = sums.c_c / weight - c * c, sums.g_g / weight - g * g
    c_g = sums.c_g / weight - c * g
    turned = c_c > TURNED * (given.compass_sd**2 + COMPASS_RESOLUTION**2)
    proportional = turned and g_g > 0.0 and c_g * c_g > CORRELATED * c_c * g_g
    return c_g / g_g if proportional and sums.weight > 0.5 * SCALE_TIME else math.nan


@inlined
def _is_scale_wrong(health, given):
    """Return whether compass and gyro turn as if one of them had the wrong sign or unit."""
    scale = _gyro_scale(health, given)
    unit = abs(scale) > UNIT or abs(scale) < 1.0 / UNIT
    return REVERSED[0] < scale < REVERSED[1] or unit


@inlined
def _is_course_known(health):
    """Return whether there is a course over ground of now, to hold a heading against."""
    return health.drift_time > DRIFT_TIME and health.course_time < COURSE_GAP


@inlined
def _course_errors(health, given):
    """Return by how much the course turned otherwise than compass and gyro, rad.

    Where one of the two has the wrong sign or unit, either nothing or all is said against it.
    """
    if _is_scale_wrong(health, given):
        said = health.course_for_compass
        return (math.inf if said < -WITNESS else 0.0), (math.inf if said > WITNESS else 0.0)
    return abs(health.course_minus_compass), abs(health.course_minus_gyro)


@inlined
def _vote_again(health, given):
    """Exchange compass and gyro where the course has come to contradict the one in use."""
    compass, gyro = health.sensors[COMPASS_SENSOR], health.sensors[GYRO_SENSOR]
    by_compass, by_gyro = _course_errors(health, given)
    if compass.status == EXCLUDED and by_gyro > VOTE_FREE + VOTE_FACTOR * by_compass:
        exclude(health, GYRO_SENSOR, AT_ODDS)
        set_status(health, COMPASS_SENSOR, OK, NO_REASON)
    elif gyro.status == EXCLUDED and by_compass > VOTE_FREE + VOTE_FACTOR * by_gyro:
        exclude(health, COMPASS_SENSOR, AT_ODDS)
        set_status(health, GYRO_SENSOR, OK, NO_REASON)


@inlined
def _vote(health, given):
    """Leave out compass or gyro, by which of them the course over ground follows less."""
    compass = health.sensors[COMPASS_SENSOR]
    by_compass, by_gyro = _course_errors(health, given)
    if compass.status == OK:
        set_status(health, COMPASS_SENSOR, DOUBTFUL, AT_ODDS)
        set_status(health, GYRO_SENSOR, DOUBTFUL, AT_ODDS)
        _forget_scale(health)  # that of before says nothing
    clear = max(by_compass, by_gyro) > VOTE_FREE + VOTE_FACTOR * min(by_compass, by_gyro)
    if clear or health.clock - compass.since > VOTE_TIME:
        if by_compass > by_gyro:
            exclude(health, COMPASS_SENSOR, AT_ODDS)
            set_status(health, GYRO_SENSOR, OK, NO_REASON)
        else:
            exclude(health, GYRO_SENSOR, AT_ODDS)
            set_status(health, COMPASS_SENSOR, OK, NO_REASON)


@inlined
def _find_fault(step, turned, T, frozen_compass, health, given):
    """Name compass or gyro if the sum of what they disagree by says so."""
    compass, gyro = health.sensors[COMPASS_SENSOR], health.sensors[GYRO_SENSOR]
    size, level = abs(health.heading_sum), health.heading_level
    most = max(ALARM * level, JUMP_TURN * given.max_turn * T)
    if min(abs(step), abs(turned)) > most:
        # no boat turns so fast
        health.heading_sum -= step
        exclude(health, COMPASS_SENSOR, JUMPED)
    elif min(abs(step), abs(health.gyro_turn)) > most:
        set_status(health, GYRO_SENSOR, EXCLUDED, AT_ODDS)
        set_status(health, COMPASS_SENSOR, OK, NO_REASON)
    elif is_fault(size, level, T, compass):
        if is_frozen(gyro):
            set_status(health, GYRO_SENSOR, EXCLUDED, FROZEN)
        elif frozen_compass:
            exclude(health, COMPASS_SENSOR, FROZEN)
        else:
            _vote(health, given)
    elif compass.status == DOUBTFUL and size < CLEAR * level:
        set_status(health, COMPASS_SENSOR, OK, NO_REASON)
        set_status(health, GYRO_SENSOR, OK, NO_REASON)


@inlined
def _readmit_gyro(size, level, T, health, given):
    """Take the gyro back after it agreed with the compass for a while."""
    gyro = health.sensors[GYRO_SENSOR]
    consistent = size < CLEAR * level and not is_frozen(gyro)
    if _is_scale_wrong(health, given) and health.sensors[COMPASS_SENSOR].status == OK:
        set_status(health, GYRO_SENSOR, EXCLUDED, WRONG_SCALE)
    # while the boat does not turn, wrong sign and unit do not show
    unseen = gyro.reason == WRONG_SCALE
    unseen = unseen and not RIGHT_SCALE[0] < _gyro_scale(health, given) < RIGHT_SCALE[1]
    if not consistent:
        gyro.calm = 0.0
    elif not unseen:
        gyro.calm += T
    if gyro.calm > CALM + SUM_TIME:
        set_status(health, GYRO_SENSOR, OK, NO_REASON)


@inlined
def _readmit_compass(heading, size, level, T, frozen, health, given):
    """Take the compass back after it was near the heading of dead reckoning for a while.

    ``size`` is by how much it contradicts gyro or course, ``level`` what is typical of that, rad.
    """
    compass = health.sensors[COMPASS_SENSOR]
    lasted = health.clock - compass.since
    gate = CLEAR * level + GATE + BIAS_SDS * given.gyro_bias_sd * lasted
    near = abs(wrap(heading - health.reckoned_heading)) < gate and not frozen
    compass.calm = compass.calm + T if near else 0.0
    known = _is_course_known(health)
    aside = known and abs(health.drift_angle) > AHEAD
    follows = size < CLEAR * level and not (frozen or aside)
    compass.followed = compass.followed + T if follows else 0.0
    # the gyro says that it turns rightly, and the course that it points ahead
    agreed = (known or lasted > GIVE_IN) and compass.followed > CALM_COURSE
    if compass.calm > CALM or agreed:
        set_status(health, COMPASS_SENSOR, OK, NO_REASON)
        health.heading_sum = 0.0


@inlined
def _least_level(dt, given):
    """Return the least typical size of the sum of compass minus gyro, by the data sheets, rad."""
    drift = given.gyro_sd * math.sqrt(max(dt, SHORTEST_STEP)) + BIAS_SDS * given.gyro_bias_sd
    return math.sqrt(2.0) * given.compass_sd + COMPASS_RESOLUTION + drift * SUM_TIME


@inlined
def _hold_against_gyro(dt, heading, step, turned, frozen_compass, health, given):
    """Add what the compass turned more than the gyro to the sum, and act on it."""
    compass, gyro = health.sensors[COMPASS_SENSOR], health.sensors[GYRO_SENSOR]
    T, floor = health.gyro_time, _least_level(dt, given)
    health.heading_sum = health.heading_sum * math.exp(-T / SUM_TIME) + step
    size = abs(health.heading_sum)
    trusted = compass.status == OK and gyro.status == OK
    level = typical_size(health.heading_level, size, floor, T, health.clock, trusted)
    health.heading_level = level
    health.heading_sum *= limited(size, level)
    if trusted:
        _learn_gyro_bias(step, level, T, health, given)
    if compass.status != EXCLUDED and gyro.status != EXCLUDED:
        _find_fault(step, turned, T, frozen_compass, health, given)
    else:
        voted = compass.reason == AT_ODDS or gyro.reason == AT_ODDS or gyro.reason == WRONG_SCALE
        if size > ALARM * level and voted:
            _vote_again(health, given)
        if gyro.status == EXCLUDED:
            _readmit_gyro(size, level, T, health, given)
    if compass.status == EXCLUDED and compass.reason != IMPOSSIBLE:
        _readmit_compass(heading, size, level, T, frozen_compass, health, given)


@kernel
def check_heading(dt, z, s, ready, new_compass, health, given):
    """Hold compass against gyro; see :func:`twin.health.checks.check_sensors`."""
    _integrate_gyro(dt, z, s, health)
    compass = health.sensors[COMPASS_SENSOR]
    frozen = is_frozen(compass)
    if not (math.isfinite(z[COMPASS]) and (new_compass or frozen)):
        return
    T = health.gyro_time
    turned = wrap(z[COMPASS] - health.last[COMPASS])
    if new_compass and math.isfinite(turned):
        rate = turned / max(T, 1e-3)
        health.compass_rate += (1.0 - math.exp(-T / RATE_TIME)) * (rate - health.compass_rate)
    step = wrap(z[COMPASS] - health.last[COMPASS] - health.gyro_turn)
    # a gyro with the wrong unit does not make a compass jump
    jumped = min(abs(step), abs(turned)) > JUMP_FREE + JUMP_TURN * given.max_turn * T
    if ready and compass.status != EXCLUDED and jumped:
        exclude(health, COMPASS_SENSOR, JUMPED)
    if math.isfinite(step) and T < STEP_MAX:
        if health.gyro_gap < GAP_SHARE * T:
            _compare_scale(turned, T, health)
            _hold_against_gyro(dt, z[COMPASS], step, turned, frozen, health, given)
        elif compass.status == EXCLUDED and compass.reason != IMPOSSIBLE:
            # without gyro and compass the yaw rate is a guess: only the course tells
            apart = abs(health.course_minus_compass) if _is_course_known(health) else 0.0
            _readmit_compass(z[COMPASS], apart, TURNS_AGREE / CLEAR, T, frozen, health, given)
    health.gyro_turn = health.gyro_time = health.gyro_gap = 0.0


@inlined
def _turned_until(t, health):
    """Return the integral of the yaw rate at a past time, from the samples that are kept."""
    newest, kept = int(health.turn_rows) - 1, min(int(health.turn_rows), TURN_RING)
    back = 0
    while back < kept - 1 and health.turn_ring[(newest - back) % TURN_RING, 0] > t:
        back += 1
    old = health.turn_ring[(newest - back) % TURN_RING]
    new = health.turn_ring[(newest - max(back - 1, 0)) % TURN_RING]
    share = (t - old[0]) / (new[0] - old[0]) if new[0] > old[0] else 0.0
    return old[1] + min(max(share, 0.0), 1.0) * (new[1] - old[1])


@kernel
def turn_to_now(dt, out, new_compass, health, given):
    """Add to a heading that is late what the boat turned since it was measured.

    Filters then take it for one of now. The turn is that of the gyro or, where it is silent, of
    the compass itself. The predictor's yaw rate would feed its own error back to it.
    """
    late = given.compass_latency
    if not late > 0.0:
        return
    rate = out[GYRO] - health.gyro_bias if math.isfinite(out[GYRO]) else health.compass_rate
    health.turned += 0.5 * (rate + health.turn_rate) * dt
    health.turn_rate = rate
    rows = int(health.turn_rows)
    before = health.turn_ring[(rows - 1) % TURN_RING, 0] if rows > 0 else -math.inf
    if health.clock - before >= late / (TURN_RING - 4):
        row = health.turn_ring[rows % TURN_RING]
        row[0], row[1] = health.clock, health.turned
        health.turn_rows += 1.0
    # a value that repeats itself must stay one that does
    if new_compass:
        health.turn_late = health.turned - _turned_until(health.clock - late, health)
    out[COMPASS] += health.turn_late


@inlined
def is_late(health, given):
    """Return whether the velocity over ground is older than it may be."""
    lag, variance = _velocity_lag(health)
    natural = LATE_TIME * given.time_scale + LATE_FREE + given.latency
    return lag > natural and variance > (LATE_TURN / given.time_scale) ** 2


@inlined
def _velocity_lag(health):
    """Return by how much the course seems to lag the heading (s), and the yaw rate's variance."""
    sums = health.lag_sums
    weight = max(sums.weight, TINY)
    mean_r, mean_beta = sums.r / weight, sums.beta / weight
    variance = sums.r_r / weight - mean_r * mean_r
    covariance = sums.r_beta / weight - mean_r * mean_beta
    return -covariance / max(variance, TINY), variance


@inlined
def _learn_lag(T, r, drift_angle, health):
    """Learn how late the velocity is: the drift angle grows with the yaw rate by the lag."""
    sums = health.lag_sums
    fade = math.exp(-T / LAG_TIME)
    sums.weight *= fade
    sums.r *= fade
    sums.beta *= fade
    sums.r_r *= fade
    sums.r_beta *= fade
    if abs(drift_angle) < DRIFT_ANGLE_MAX:
        sums.weight += T
        sums.r += T * r
        sums.beta += T * drift_angle
        sums.r_r += T * r * r
        sums.r_beta += T * r * drift_angle


@inlined
def _compare_turns(course, heading, T, lag, health):
    """Add what the course turned more than gyro and compass, each with the lag of its own rate."""
    fade = math.exp(-T / COURSE_TIME)
    health.course_minus_gyro *= fade
    health.course_minus_compass *= fade
    if not (math.isfinite(health.course) and T < COURSE_GAP):
        return
    change = wrap(course - health.course)
    lagged = lag * (health.gyro_rate - health.course_gyro_rate)
    health.course_minus_gyro += wrap(change - health.course_gyro + lagged)
    if math.isfinite(heading) and math.isfinite(health.course_compass):
        turned = wrap(heading - health.course_compass)
        lagged = lag * (health.compass_rate - health.course_compass_rate)
        health.course_minus_compass += wrap(change - turned + lagged)
    apart = health.course_minus_gyro**2 - health.course_minus_compass**2
    health.course_for_compass = health.course_for_compass * math.exp(-T / WITNESS_TIME) + T * apart


@kernel
def check_course(z, new_gps, health, given):
    """Hold the course over ground against gyro and compass, to tell whose heading is wrong."""
    if not new_gps or not (math.isfinite(z[GPS_VX]) and math.isfinite(z[GPS_VY])):
        return
    if is_velocity_doubted(health):
        health.drift_time = 0.0
        return
    if math.hypot(z[GPS_VX], z[GPS_VY]) < SLOW * given.speed:
        health.course = math.nan
        health.drift_time = 0.0
        return
    heading, T = z[COMPASS], health.course_time
    lag = min(max(_velocity_lag(health)[0], 0.0), LAG_MAX * given.time_scale)
    course = math.atan2(z[GPS_VY], z[GPS_VX])
    _compare_turns(course, heading, T, lag, health)
    health.course, health.course_time, health.course_gyro = course, 0.0, 0.0
    health.course_compass = heading
    health.course_gyro_rate, health.course_compass_rate = health.gyro_rate, health.compass_rate
    if not math.isfinite(heading):
        return
    drift = wrap(course + lag * health.compass_rate - heading)
    share = min(T / DRIFT_TIME, 1.0)
    health.drift_angle = wrap(health.drift_angle + share * wrap(drift - health.drift_angle))
    health.drift_time += T
    compass, gyro = health.sensors[COMPASS_SENSOR], health.sensors[GYRO_SENSOR]
    alone = gyro.status != OK and compass.status == OK  # nothing else tells that it is stuck
    if alone and is_frozen(compass) and abs(health.course_minus_compass) > AHEAD:
        exclude(health, COMPASS_SENSOR, FROZEN)
    if compass.status == OK and gyro.status == OK:
        _learn_lag(T, health.gyro_rate, wrap(course - heading), health)
