"""What a row goes through before a predictor takes it: the same for one boat and for many."""

from __future__ import annotations

from twin.channels import COMMANDS
from twin.filters.navigation_state import RESTART
from twin.integrity.checks import check_sensors, write_restart
from twin.integrity.state import INTEGRITY, INTEGRITY_SETTINGS
from twin.motion.deck_motion import MOTION, MOTION_SETTINGS, MOTION_WORK, take_row
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import as_record

__all__ = ["sense", "sense_row"]


@inlined
def _advance_motion(t, dt, z, state, ready, i, motions, given, work):
    """Take roll, pitch and heave from a row; without memory nothing of it is compiled."""
    if motions is None:
        return
    of_boat, scratch = as_record(given, MOTION_SETTINGS), as_record(work, MOTION_WORK)
    take_row(t, dt, z, state, ready, as_record(motions[i], MOTION), of_boat, scratch)


@inlined
def sense(t, dt, z, cmd, state, ready, health, given, i, motion, used, trusted):
    """Take the motion of the deck and doubtful sensors out of a row.

    Parameters
    ----------
    t, dt : float
        Time, and time since the row before, s.
    z, cmd : ndarray, shapes (19,), (4,)
        Measurements, of which is written how an upright boat would have them; and commands.
    state : ndarray, shape (6,)
        The predictor's estimate after the row before.
    ready : bool
        Whether that means anything.
    health, given : record
        ``INTEGRITY``, advanced in place, and ``INTEGRITY_SETTINGS``.
    i, motion : int, tuple
        Which boat; what all boats remember of ``MOTION`` (n, ...), ``MOTION_SETTINGS`` and
        ``MOTION_WORK``, flat; None three times where nothing measures it.
    used, trusted : ndarray, shapes (19,), (4,)
        Written: the row without impossible numbers and sensors at fault, which are NaN; and its
        command, or the last one that was trusted.
    """
    _advance_motion(t, dt, z, state, ready, i, motion[0], motion[1], motion[2])
    check_sensors(dt, z, cmd, state, ready, health, given, used)
    for k in range(len(COMMANDS)):
        trusted[k] = health.drives.trusted[k] if health.commands_doubted > 0.0 else cmd[k]


@kernel
def sense_row(t, dt, z, cmd, state, ready, memory, settings, motion, used, trusted, restart):
    """Do :func:`sense` for one boat, and write where the navigation begins again, if it does."""
    health, given = as_record(memory, INTEGRITY), as_record(settings, INTEGRITY_SETTINGS)
    sense(t, dt, z, cmd, state, ready, health, given, 0, motion, used, trusted)
    if health.switched > 0.0:
        write_restart(health, given, as_record(restart, RESTART))
