"""What the checks share: a sensor's status, and the leaky sums of what two sensors disagree by.

Each sum has a level: its typical size, and never less than the data sheets say. A sum far above
its level for a while is a fault.
"""

from __future__ import annotations

import math

from twin.channels import PSI, U, V
from twin.health.state import (
    COMPASS_SENSOR,
    EXCLUDED,
    GPS,
    OK,
    STEPPED,
    VELOCITY_WRONG,
)
from usv_kernel.channels import COMPASS, GPS_VX, GPS_VY
from usv_kernel.jit import inlined

__all__ = [
    "ALARM",
    "CALM",
    "CLEAR",
    "FROZEN_INTERVALS",
    "FROZEN_LONGEST",
    "FROZEN_TIME",
    "GIVE_IN",
    "LEVEL_SHARE",
    "exclude",
    "is_fault",
    "is_frozen",
    "is_velocity_doubted",
    "learning_share",
    "limited",
    "over_ground",
    "set_status",
    "typical_size",
    "velocity_step",
]

ALARM, CLEAR = 5.0, 3.0
"""A sum is at odds above so many levels, and consistent below so many. Between them nothing
changes, so that a sum at the border does not make a status flicker."""

CERTAIN = 0.5
"""A sum that is at odds for so long is a fault, s; at once above twice the alarm."""

SAMPLE_EVIDENCE = 0.05
"""A sample at odds counts for at least so long, s: fast logs have tiny steps."""

CALM = 2.0
"""An excluded sensor comes back after it was consistent for so long, s."""

GIVE_IN = 60.0
"""A disagreement that has lasted so long is taken for true, s: the dead reckoning that a sensor
is held against has then drifted itself."""

SUM_MAX = 15.0
"""Most levels that a sum holds on to: above what is a fault at once."""

LEVEL_TIME, LEVEL_START = 120.0, 10.0
"""Time constant of the levels, and its first value, s: it grows with the clock, so that levels are
learned soon."""

LEVEL_SHARE = 0.1
"""Largest weight of one sample in a level or bias; also the factor of that weight for a sum above
:data:`CLEAR` levels, so that a fault is not learned as normal."""

LEVEL_START_FACTOR, LEVEL_RANGE = 2.0, 5.0
"""A level begins at so many times its floor, and reaches at most so many times: beyond, a sensor
would be so far from its data sheet that it must be named."""

FROZEN_TIME, FROZEN_INTERVALS, FROZEN_LONGEST = 0.2, 3.0, 2.0
"""A sensor is frozen if it repeats itself for longer than this (s), than so many of its sampling
intervals, and than so many times its longest repetition (coarse sensors repeat at rest)."""


@inlined
def set_status(health, sensor, status, reason):
    """Set status and reason of a sensor; a new one starts without evidence."""
    check = health.sensors[sensor]
    if check.status != status or check.reason != reason:
        if check.status != status:
            check.since = health.clock
        check.status = status
        check.reason = reason
        check.evidence = 0.0
        check.calm = 0.0
        check.followed = 0.0


@inlined
def exclude(health, sensor, reason):
    """Leave a sensor out, and begin dead reckoning from where it was right."""
    check = health.sensors[sensor]
    if check.status != EXCLUDED:
        check.in_use = health.clock - check.since if check.status == OK else 0.0
        if sensor == GPS:
            for k in range(2):
                # the sum is the part of the fix that its velocity does not explain
                health.reckoned[k] = health.fix[k] + health.travelled[k] - health.position_sum[k]
                health.position_sum[k] = 0.0
            health.reckoned_time = 0.0
        elif sensor == COMPASS_SENSOR:
            health.reckoned_heading = health.last[COMPASS] + health.gyro_turn - health.heading_sum
            health.heading_sum = 0.0
    set_status(health, sensor, EXCLUDED, reason)


@inlined
def learning_share(T):
    """Return the share by which a sample, T (s) after the last, changes what is learned slowly."""
    return min(T / LEVEL_TIME, LEVEL_SHARE)


@inlined
def typical_size(level, size, floor, dt, clock, learn):
    """Return the level after a sum of this size: its slow root mean square, within bounds."""
    if level <= 0.0:
        level = LEVEL_START_FACTOR * floor
    if learn:
        share = dt / min(LEVEL_TIME, clock + LEVEL_START)
        if size > CLEAR * level:
            share *= LEVEL_SHARE
        capped = min(size, CLEAR * level)
        level = math.sqrt(
            level * level + min(share, LEVEL_SHARE) * (capped * capped - level * level)
        )
    return min(max(level, floor), LEVEL_RANGE * floor)


@inlined
def limited(size, level):
    """Return the factor that keeps a sum within bounds, so that it fades soon after a fault."""
    return min(1.0, SUM_MAX * level / max(size, 1e-300))


@inlined
def is_fault(size, level, dt, check):
    """Gather evidence from a sum of this size; return whether it is a fault."""
    if size > ALARM * level:
        check.evidence += max(dt, SAMPLE_EVIDENCE)
    else:
        check.evidence = max(check.evidence - dt, 0.0)
    return check.evidence >= CERTAIN or size > 2.0 * ALARM * level


@inlined
def is_frozen(check):
    """Return whether a sensor repeats itself for longer than it ever did."""
    return check.repeated > max(
        FROZEN_TIME, FROZEN_INTERVALS * check.interval, FROZEN_LONGEST * check.longest
    )


@inlined
def is_velocity_doubted(health):
    """Return whether the velocity of the GPS is not used, or has jumped."""
    gps = health.sensors[GPS]
    return gps.reason == VELOCITY_WRONG or (gps.status == EXCLUDED and gps.reason == STEPPED)


@inlined
def velocity_step(z, health):
    """Return what the velocity gained more than the accelerometers say, north and east, m/s."""
    step_x = z[GPS_VX] - health.velocity[0] - health.accel_gain[0]
    step_y = z[GPS_VY] - health.velocity[1] - health.accel_gain[1]
    return step_x, step_y


@inlined
def over_ground(s):
    """Return the velocity north and east of a state, m/s."""
    c, n = math.cos(s[PSI]), math.sin(s[PSI])
    return s[U] * c - s[V] * n, s[U] * n + s[V] * c
