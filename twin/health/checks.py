"""Kernel that holds the sensors of a row against each other, and leaves out those at fault.

Each pair of sensors that measure one thing gives a leaky sum of what they disagree by. A third
sensor, or the shape of the fault, says whose fault it is.
"""

from __future__ import annotations

from twin.channels import PSI, R, U, V, X, Y
from twin.health.current import check_current
from twin.health.drives.commands import CHANGED, check_commands
from twin.health.drives.unaided import check_unaided
from twin.health.heading import check_course, check_heading, turn_to_now
from twin.health.position import check_position
from twin.health.samples import (
    COMPASS_MAX,
    GYRO_MAX,
    POSITION_MAX,
    SPEED_MAX,
    find_frozen,
    leave_out,
    note_absence,
    take_samples,
)
from twin.health.state import (
    ABSENT,
    ACCELEROMETERS,
    COMMAND,
    COMPASS_SENSOR,
    DOUBTFUL,
    EXCLUDED,
    GPS,
    N_STATES,
    NO_ANSWER,
    SENSORS,
    STATUSES,
)
from twin.health.velocity import check_velocity
from twin.health.wind import check_wind
from usv_kernel.jit import inlined, kernel

__all__ = ["check_sensors"]

ROW_SHARE, ROWS_MISSING, GAP_LEAST = 0.05, 2.5, 0.5
"""Share of a new interval between rows in the typical one. A row after so many of these, and after
so long (s), follows a gap: rows are missing, or the clock stepped."""


@inlined
def _is_motion_doubted(health):
    """Return whether GPS or compass are left out, or the accelerometers while there is no GPS."""
    sensors = health.sensors
    unaided = sensors[GPS].status == ABSENT and sensors[ACCELEROMETERS].status == EXCLUDED
    return sensors[GPS].status == EXCLUDED or sensors[COMPASS_SENSOR].status == EXCLUDED or unaided


@inlined
def _take_state(s, health, given):
    """Remember the predictor's state; return whether it is one that a boat can have."""
    possible = (
        abs(s[X]) < POSITION_MAX
        and abs(s[Y]) < POSITION_MAX
        and abs(s[PSI]) < COMPASS_MAX
        and abs(s[U]) < SPEED_MAX * given.speed
        and abs(s[V]) < SPEED_MAX * given.speed
        and abs(s[R]) < GYRO_MAX
    )
    for k in range(N_STATES):
        health.state[k] = s[k] if possible else 0.0
    return possible


@inlined
def _follows_gap(dt, health):
    """Return whether a row comes after a gap; learn the typical time between rows."""
    if health.row_interval == 0.0:
        health.row_interval = dt
        return False
    most = ROWS_MISSING * health.row_interval
    health.row_interval += ROW_SHARE * (min(dt, most) - health.row_interval)
    return dt > max(most, GAP_LEAST)


@inlined
def _all_statuses(health):
    """Return one number for the statuses of all sensors: the digits of a number to base 4.

    The digits of the wind are its status and whether it is known or has a reason.
    """
    wind = health.wind
    number = 1.0 if wind.reason > 0.0 or wind.known > 0.0 else 0.0
    number = len(STATUSES) * number + wind.status
    for k in range(len(SENSORS)):
        number = len(STATUSES) * number + health.sensors[k].status
    return number


@kernel
def check_sensors(dt, z, cmd, s, ready, health, given, out):
    """Hold the sensors of a row against each other, and leave out those at fault.

    Parameters
    ----------
    dt : float
        Time since the row before, s.
    z, cmd : ndarray, shapes (19,), (4,)
        The row.
    s : ndarray, shape (6,)
        State that the predictor had after the row before.
    ready : bool
        Whether that means anything.
    health, given : record
        ``HEALTH``, advanced in place, whose ``current`` the caller writes; ``HEALTH_SETTINGS``.
    out : ndarray, shape (19,)
        The row without the samples of excluded sensors, with the heading of now and the true wind
        of an anemometer.
    """
    health.clock += dt
    health.row_gap = 1.0 if _follows_gap(dt, health) else 0.0
    possible = _take_state(s, health, given)
    usable = ready and possible
    state = health.state
    new_gps, new_compass = take_samples(dt, z, health, given, out)
    check_heading(dt, out, state, usable, new_compass, health, given)
    check_position(dt, out, state, ready, possible, new_gps, health, given)
    find_frozen(usable, health, given)
    check_velocity(dt, out, state, usable, new_gps, health, given)
    check_unaided(dt, out, state, usable, health, given)
    check_course(out, new_gps, health, given)
    check_commands(dt, cmd, state, usable, health, given)
    command = health.sensors[COMMAND]
    # what is doubtful for long is a boat that has changed: the twin must learn it
    unexplained = command.status == DOUBTFUL and command.reason == NO_ANSWER
    fresh = unexplained and health.clock - command.since < CHANGED
    health.commands_doubted = 1.0 if command.status == EXCLUDED or fresh else 0.0
    note_absence(dt, ready, health)
    check_current(health, given)
    health.motion_doubted = 1.0 if _is_motion_doubted(health) else 0.0
    leave_out(health, out)
    turn_to_now(dt, out, new_compass, health, given)
    check_wind(dt, out, state, usable, health, given)
    health.statuses = _all_statuses(health)
