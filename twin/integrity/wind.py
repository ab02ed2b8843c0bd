"""Kernel that makes the true wind of the apparent wind, and doubts an anemometer that is stuck."""

from __future__ import annotations

import math

from twin.channels import APPARENT_FROM, APPARENT_SPEED, PSI, WIND_FROM, WIND_SPEED, U, V
from twin.filters.navigation_state import WIND_LIMIT
from twin.integrity.bank import LEARN_S, RETURN_S, SILENT_S
from twin.integrity.state import ABSENT, EXCLUDED, FROZEN, NO_REASON, OK
from usv_kernel.jit import inlined

__all__ = ["check_wind"]

SMOOTHING_S = 2.0
"""Time constant of the wind that the model takes: noise and the swaying mast average out."""

GUST_S = 10.0
"""Time constant with which the wind returns to its mean without samples."""

SPIKE_MPS = 10.0
"""Change from the last samples above which a sample is refused, unless the change lasts."""

STUCK_S = 10.0
"""Time of equal samples after which an anemometer counts as stuck."""

ANGLE_MAX_RAD = 1e3
"""Bound of a direction."""


@inlined
def _set(memory, status, reason):
    wind = memory.wind
    if wind.status != status:
        wind.status, wind.reason, wind.since = status, reason, memory.clock


@inlined
def _is_usable(dt, speed, angle, memory):
    """Take a sample of the apparent wind as it is; return whether it says something new."""
    wind = memory.wind
    wind.silent += dt
    if not (0.0 <= speed < WIND_LIMIT and abs(angle) < ANGLE_MAX_RAD):  # NaN: none
        if wind.silent > SILENT_S:
            _set(memory, ABSENT, NO_REASON)
        return False
    since, wind.silent = wind.silent, 0.0
    same_speed, same_angle = speed == wind.last[0], angle == wind.last[1]
    wind.repeated[0] = wind.repeated[0] + since if same_speed else 0.0
    wind.repeated[1] = wind.repeated[1] + since if same_angle else 0.0
    wind.last[0], wind.last[1] = speed, angle
    stuck = max(wind.repeated[0], wind.repeated[1]) > STUCK_S
    if stuck:
        _set(memory, EXCLUDED, FROZEN)
        wind.changing = 0.0
    elif wind.status == EXCLUDED:
        wind.changing = 0.0 if same_speed or same_angle else wind.changing + since
        if wind.changing > RETURN_S:
            _set(memory, OK, NO_REASON)
    elif wind.status == ABSENT:
        _set(memory, OK, NO_REASON)
    return wind.status == OK and not (same_speed and same_angle)


@inlined
def check_wind(dt, out, state, usable, memory, given):
    """Write the true wind to a row that has the apparent wind, or had it before.

    Parameters
    ----------
    dt : float
        Time since the row before, s.
    out : ndarray, shape (19,)
        The row: speed and direction of the true wind, 10 m above the sea, are written to it once
        an anemometer has given samples.
    state : ndarray, shape (6,)
        State of the boat, whose velocity and heading the apparent wind holds.
    usable : bool
        Whether that means anything.
    memory, given : record
        ``INTEGRITY``, whose part ``wind`` is advanced; ``INTEGRITY_SETTINGS``.
    """
    wind = memory.wind
    wind.age += dt
    speed, angle = out[APPARENT_SPEED], out[APPARENT_FROM]
    if _is_usable(dt, speed, angle, memory) and usable:
        c, s = math.cos(state[PSI]), math.sin(state[PSI])
        ahead, aside = state[U] - speed * math.cos(angle), state[V] - speed * math.sin(angle)
        north = given.wind_gain * (ahead * c - aside * s)
        east = given.wind_gain * (ahead * s + aside * c)
        odd = wind.known > 0.0 and (
            math.hypot(north - wind.velocity[0], east - wind.velocity[1]) > SPIKE_MPS
        )
        if not odd or wind.age >= SMOOTHING_S:
            share = 1.0 if odd or wind.known == 0.0 else 1.0 - math.exp(-wind.age / SMOOTHING_S)
            wind.known = min(wind.known + min(wind.age, 1.0) + 1e-3, LEARN_S)
            slow = min((min(wind.age, 1.0) + 1e-3) / wind.known, 1.0)
            wind.velocity[0] += share * (north - wind.velocity[0])
            wind.velocity[1] += share * (east - wind.velocity[1])
            wind.mean[0] += slow * (wind.velocity[0] - wind.mean[0])
            wind.mean[1] += slow * (wind.velocity[1] - wind.mean[1])
            wind.age = 0.0
    if wind.known > 0.0:
        left = math.exp(-wind.age / GUST_S)
        north = wind.mean[0] + left * (wind.velocity[0] - wind.mean[0])
        east = wind.mean[1] + left * (wind.velocity[1] - wind.mean[1])
        out[WIND_SPEED] = math.hypot(north, east)
        out[WIND_FROM] = math.atan2(-east, -north)
