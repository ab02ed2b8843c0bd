"""Kernel that asks whether fixes stand still while the boat moves."""

from __future__ import annotations

import math

from twin.channels import U
from twin.health.drives.filters import thrust_of
from twin.health.state import ACCELEROMETERS, EXCLUDED, FROZEN, GPS, OK
from usv_kernel.channels import ACCEL_X, ACCEL_Y, GPS_VX, GPS_VY, GPS_X
from usv_kernel.jit import inlined

__all__ = ["accept_stand", "are_fixes_standing", "begin_standing", "have_stood", "note_leap"]

MEAN_TIME = 0.5
"""Time constant of the mean of the fixes, s: in it the noise of single fixes averages out."""

NEAR_SDS, NEAR_LEAST = 4.0, 0.1
"""Fixes stand while their mean stays within so many of its standard deviations and this (m), by the
data sheet. Where only the thrust tells that the boat moves, by their own scatter, if that is less:
a boat that is stopped drifts on, and the predictor's velocity takes a while to follow it."""

NAMED_FACTOR = 2.0
"""Once fixes are named, they stand within so many times that: none is taken back by its noise."""

SCATTER_SHARE = 0.2
"""Largest weight of one step between fixes in their scatter."""

WAY_BOTH, WAY_ALONE = 3.0, 4.0
"""They are frozen if the boat went so many times as far as that by the data sheet: where its
velocity is measured and its thrust keeps it going, and where only one of these is so."""

SOON, SOON_INTERVALS, LATE = 0.5, 2.5, 8.0
"""That must show later than this (s) and so many intervals of the fixes after they stood still, and
within the last time (s). Boats at rest have stood for longer, and a velocity that errs has given in
to the fixes by then."""

DRIVEN = 0.3
"""A boat with this share of the thrust that keeps its speed goes on; another may have stopped."""

MOVING, STAND_GIVE_IN = 0.2, 180.0
"""A boat whose receiver measures this velocity, in nominal speeds, does move. Else fixes that stand
for so long (s) are right: the boat may be moored, and thrust does not move it."""

HIT_TIME = 16.0
"""So long (s) after the acceleration leapt the boat may have hit something, so that its fixes
rightly stand."""

THRUST_LEAST = 0.1
"""Thrust, in nominal ones, under which no free boat lies still for long."""


@inlined
def note_leap(dt, z, health, given):
    """Note when the acceleration last leapt, as in an impact: the navigation does not follow it."""
    health.since_leap += dt
    for k in (ACCEL_X, ACCEL_Y):
        if abs(z[k] - health.last[k]) > given.leap:  # false for NaN
            health.since_leap = 0.0


@inlined
def begin_standing(health):
    """Begin again with the next fix."""
    health.stand_mean[0] = math.nan


@inlined
def _is_driven(s, health, given):
    """Return whether the commands drive the boat on, so that it cannot just have stopped."""
    u = s[U] / given.speed
    return thrust_of(health.drive) * u > DRIVEN * abs(u * u * u)


@inlined
def accept_stand(health):
    """Take the fixes for right where they stand: that they do is not asked again."""
    health.stand_time = max(health.stand_time, LATE)


@inlined
def have_stood(s, health, given):
    """Return whether fixes stood for long under thrust: then a jump sets them right.

    The predictor's velocity gave in to them before they were named.
    """
    thrust = abs(thrust_of(health.drive)) > THRUST_LEAST
    return health.stand_time > LATE and thrust and _is_driven(s, health, given)


@inlined
def are_fixes_standing(z, s, T, health, given):
    """Return whether the fixes stay at a place while the boat went away from it.

    T is the time since the last fix, s.
    """
    mean, at, way, gone = (
        health.stand_mean,
        health.stand_at,
        health.stand_way,
        health.stand_mean_way,
    )
    gps = health.sensors[GPS]
    soon = max(SOON, SOON_INTERVALS * gps.interval)
    # the first fix, or the first after a gap, has no lag
    begins = math.isnan(mean[0]) or soon < T
    share = 1.0 if begins else min(T / MEAN_TIME, 1.0)
    square = 0.0
    for k in range(2):
        square += (z[GPS_X + k] - health.last[GPS_X + k]) ** 2
        before = 0.0 if begins else mean[k]
        mean[k] = before + share * (z[GPS_X + k] - before)
        # with the lag of the other: boats that reverse stand for a moment
        gone[k] += share * (way[k] - gone[k])
    health.stand_scatter += min(share, SCATTER_SHARE) * (square - health.stand_scatter)
    doppler = math.isfinite(z[GPS_VX])
    measured = health.sensors[ACCELEROMETERS].status == OK or doppler
    # a step has the variance of two fixes, in each of two directions
    named = gps.status == EXCLUDED and gps.reason == FROZEN
    scatter = given.gps_sd if measured or named else 0.5 * math.sqrt(health.stand_scatter)
    smoothed = NEAR_SDS * math.sqrt(min(0.5 * gps.interval / MEAN_TIME, 1.0))
    near = smoothed * min(scatter, given.gps_sd) + NEAR_LEAST
    near *= NAMED_FACTOR if named else 1.0
    if begins or math.hypot(mean[0] - at[0], mean[1] - at[1]) > near:
        for k in range(2):
            at[k] = mean[k]
            way[k] -= gone[k]
            gone[k] = 0.0
        health.stand_time = health.stand_most = 0.0
    health.stand_time += T
    went = math.hypot(gone[0], gone[1]) / (smoothed * given.gps_sd + NEAR_LEAST)
    health.stand_most = max(health.stand_most, went)
    if named:
        moving = math.hypot(z[GPS_VX], z[GPS_VY]) > MOVING * given.speed  # false for NaN
        early = health.reckoned_time < STAND_GIVE_IN
        return health.stand_most > WAY_BOTH and (moving or early)
    if health.since_leap < HIT_TIME and not doppler:
        # a boat that hit something may have stopped
        return False
    driven = _is_driven(s, health, given)
    most = WAY_BOTH if measured and driven else WAY_ALONE
    went_away = (measured or driven) and health.stand_most > most
    return went_away and soon < health.stand_time < LATE
