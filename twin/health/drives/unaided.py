"""Kernel that holds the accelerometers against the commands while the GPS is silent or left out.

Without it nothing else tells a bias from a motion. The surge that the commands make, by what was
learned of thrust and drag, bounds how long a boat can accelerate.
"""

from __future__ import annotations

import math

from twin.channels import R, U, V
from twin.health.drives.commands import step_seconds
from twin.health.drives.filters import MOTION_MAX, WARM_UP, surge_change
from twin.health.evidence import (
    CALM,
    CLEAR,
    LEVEL_SHARE,
    is_fault,
    is_frozen,
    limited,
    set_status,
    typical_size,
)
from twin.health.state import (
    ABSENT,
    ACCELEROMETERS,
    AT_ODDS,
    COMMAND,
    EXCLUDED,
    GPS,
    NO_ANSWER,
    NO_REASON,
    OK,
)
from usv_kernel.channels import ACCEL_X, ACCEL_Y
from usv_kernel.jit import inlined, kernel

__all__ = ["check_unaided"]

SUM_TIME = 5.0
"""Time constant of the leaky sums of acceleration measured minus expected, s: well above the period
of waves, and below the time in which a bias makes an error of ten metres."""

FLOOR = 0.1
"""Least level, m/s, beside what the data sheet lets a bias add up to."""

BIAS_TIME, KNOWN = 30.0, 0.5
"""Time constant with which the mean difference is learned while fixes come, s; and the share of a
bias of the data sheet that is left of it."""

MARGIN = 1.25
"""Factor of the alarm: the model of thrust and drag is rougher than a sensor."""

SWAY_MOST = 0.3
"""Most sway that is possible without a velocity over ground, in nominal speeds: accelerometers at
fault make more."""

TURN_MAX = 0.5
"""Between rarer rows (s) a boat may begin to turn: its centripetal acceleration is not known."""

STEP_MAX = 2.0
"""After a longer gap (s) the sums begin again."""

UNMOVED = 2.0
"""Commands are at fault where the velocity expected changed so many times as much as that measured:
the boat goes on as before."""

NO_VELOCITY = 3.0
"""A boat is unaided after so long without a velocity over ground, s."""


@inlined
def _is_unaided(health):
    """Return whether no fixes are used, and have not been for a while."""
    absent = health.sensors[GPS].status == ABSENT and health.velocity_time > NO_VELOCITY
    return absent or health.sensors[GPS].status == EXCLUDED


@inlined
def _expected(dt, s, health, given):
    """Return the acceleration forward and to starboard that the commands make, m/s2.

    The surge by the commands alone is advanced; a velocity would hide what the sensors do.
    """
    if health.steps <= WARM_UP or dt > STEP_MAX:
        health.unaided_surge = s[U] / given.speed
    r = s[R] * given.time_scale
    most = SWAY_MOST if _is_unaided(health) else MOTION_MAX
    v = min(max(s[V] / given.speed, -most), most)
    change = surge_change(health.unaided_surge, v, r, health) / step_seconds(given)
    surge = health.unaided_surge + change * dt
    health.unaided_surge = min(max(surge, -MOTION_MAX), MOTION_MAX)
    ahead = (change - v * s[R]) * given.speed
    return ahead, health.unaided_surge * given.speed * s[R]


@inlined
def _decide(size, dt, s, health, given):
    """Leave accelerometers or commands out, or take the former back.

    ``size`` is that of the larger sum, in levels. Where measured and expected velocity part ahead
    alone, commands are at fault if what is measured hardly changed since they agreed.
    """
    accel = health.sensors[ACCELEROMETERS]
    if accel.status == OK and is_fault(size, MARGIN, dt, accel):
        change = health.unaided_gain[0] - health.unaided_agreed[0]
        aside = abs(health.unaided_sum[1]) > CLEAR * health.unaided_level[1]
        if not aside and abs(change - health.unaided_sum[0]) > UNMOVED * abs(change):
            set_status(health, COMMAND, EXCLUDED, NO_ANSWER)
            health.unaided_surge = s[U] / given.speed
            accel.evidence = 0.0
            return
        set_status(health, ACCELEROMETERS, EXCLUDED, AT_ODDS)
        for k in range(2):
            apart = abs(health.unaided_sum[k]) > CLEAR * health.unaided_level[k]
            health.restarts[k] = 1.0 if apart else 0.0
        health.restarted[0], health.restarted[1] = health.unaided_surge * given.speed, 0.0
    elif accel.status == EXCLUDED:
        accel.calm = accel.calm + dt if size < CLEAR and not is_frozen(accel) else 0.0
        if accel.calm > CALM + SUM_TIME:
            set_status(health, ACCELEROMETERS, OK, NO_REASON)


@kernel
def check_unaided(dt, z, s, ready, health, given):
    """Hold accelerometers against commands; see :func:`twin.health.checks.check_sensors`."""
    health.restarts[0] = health.restarts[1] = 0.0
    known = health.sensors[COMMAND].status == OK and health.steps > WARM_UP
    expected = _expected(dt, s, health, given)
    if not (ready and known) or dt > STEP_MAX:
        health.unaided_sum[0] = health.unaided_sum[1] = 0.0
        return
    if not (math.isfinite(z[ACCEL_X]) and math.isfinite(z[ACCEL_Y])):
        return
    learn = health.sensors[ACCELEROMETERS].status == OK and health.sensors[GPS].status == OK
    floor = FLOOR + (KNOWN * given.accel_bias_sd + given.tilt) * SUM_TIME
    fade, most = math.exp(-dt / SUM_TIME), 0.0
    for k in range(2):
        measured = z[ACCEL_X + k] - health.unaided_bias[k]
        more = measured - expected[k]
        health.unaided_gain[k] = health.unaided_gain[k] * fade + measured * dt
        if learn:
            health.unaided_bias[k] += more * min(dt / BIAS_TIME, LEVEL_SHARE)
        total = health.unaided_sum[k] * fade + more * dt
        if k == 1 and dt > TURN_MAX:
            total = 0.0
        level = health.unaided_level[k]
        level = typical_size(level, abs(total), floor, dt, health.clock, learn)
        health.unaided_level[k] = level
        health.unaided_sum[k] = total * limited(abs(total), level)
        size = abs(health.unaided_sum[k]) / level
        if size < CLEAR:
            health.unaided_agreed[k] = health.unaided_gain[k]
        most = max(most, size)
    if _is_unaided(health):
        _decide(most, dt, s, health, given)
