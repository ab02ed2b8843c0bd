"""What a row goes through before a predictor takes it: the same for one boat and for many."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from twin.channels import COMMANDS, MEASUREMENTS
from twin.filters.navigation_state import RESTART
from twin.integrity.checks import check_sensors, write_restart
from twin.integrity.state import INTEGRITY, INTEGRITY_SETTINGS
from twin.motion.deck_motion import MOTION, MOTION_SETTINGS, MOTION_WORK, take_row
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import as_record

__all__ = ["ROW", "Boats", "sense", "sense_row"]

ROW = np.dtype(
    [
        ("t", "f8"),  # time of the row to take, s
        ("last", "f8"),  # time of the last row that was taken, s; NaN before the first
        ("begun", "f8"),  # time of the first, s
        ("lost_at", "f8"),  # when the navigation was last found lost, s; NaN: never
        ("z", "f8", len(MEASUREMENTS)),  # measurements; then as an upright boat would have them
        ("cmd", "f8", len(COMMANDS)),  # command that was in force since the row before
        ("used", "f8", len(MEASUREMENTS)),  # the same without impossible numbers and sensors
        # at fault, which are NaN
        ("trusted", "f8", len(COMMANDS)),  # the command, or the last one that was trusted
        ("health", INTEGRITY),  # what the sensor checks remember
    ]
)
"""The row of a boat, and what is remembered of those before but by motion and predictor."""


class Boats(NamedTuple):
    """Boats that take rows, flat: an array a row, or what all have in common."""

    rows: Any  # (n, ...): each begins with ROW
    settings: Any  # begins with INTEGRITY_SETTINGS
    # None where nothing measures roll, pitch and heave
    motions: Any  # (n, size of MOTION)
    motion_settings: Any  # see MOTION_SETTINGS
    motion_work: Any  # see MOTION_WORK


@inlined
def _advance_motion(t, dt, z, state, ready, i, motions, given, work):
    """Take roll, pitch and heave from a row; without memory nothing of it is compiled."""
    if motions is None:
        return
    of_boat, scratch = as_record(given, MOTION_SETTINGS), as_record(work, MOTION_WORK)
    take_row(t, dt, z, state, ready, as_record(motions[i], MOTION), of_boat, scratch)


@inlined
def sense(i, state, ready, boats, restart):
    """Take the motion of the deck and doubtful sensors out of a boat's row, if it is new.

    Parameters
    ----------
    i : int
        Which of ``boats``.
    state : ndarray, shape (6,)
        The predictor's estimate after the row before.
    ready : bool
        Whether that means anything.
    boats : Boats
        Of :data:`ROW`, ``used``, ``trusted`` and what is remembered are written.
    restart : record of ``RESTART``
        Written where the navigation begins again.

    Returns
    -------
    float
        Time since the row before, s; -1 if there is no new row, or none is ever taken: the time of
        the last is infinite.
    """
    row, given = as_record(boats.rows[i], ROW), as_record(boats.settings, INTEGRITY_SETTINGS)
    t, last, health = row.t, row.last, row.health
    if t == last or last == math.inf:
        return -1.0
    if not math.isfinite(last):
        row.begun = last = t
    dt = t - last
    row.last = t
    z, cmd, used, trusted = row.z[:], row.cmd[:], row.used[:], row.trusted[:]
    motion = boats.motions, boats.motion_settings, boats.motion_work
    _advance_motion(t, dt, z, state, ready, i, motion[0], motion[1], motion[2])
    check_sensors(dt, z, cmd, state, ready, health, given, used)
    for k in range(len(COMMANDS)):
        trusted[k] = health.drives.trusted[k] if health.commands_doubted > 0.0 else cmd[k]
    if health.switched > 0.0:
        write_restart(health, given, restart)
    return dt


@kernel
def sense_row(i, state, ready, boats, restart):
    """Do :func:`sense` with plain tuples, which numba takes from Python much faster."""
    return sense(i, state, ready, Boats(*boats), as_record(restart, RESTART))
