"""Rows for the motion of the deck alone, for tests."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tests.twin.rows import NO_MOTION, Sensed
from twin import Log
from twin.batch import HEALTH
from twin.integrity.state import initial_integrity
from twin.motion.attitude import is_measured
from twin.motion.deck_motion import DeckMotion
from twin.sim.bridge import particulars_of
from usv_gym import Vessel

BOAT = particulars_of(Vessel.load("usv75"))
NOTHING_SEEN = initial_integrity(BOAT)
SENSED = Sensed(BOAT)


def take(
    motion: DeckMotion, t: float, dt: float, z: np.ndarray, state: np.ndarray, ready: bool
) -> np.ndarray:
    """Let the motion take a row, and return it as an upright boat would have it."""
    given = NO_MOTION
    SENSED.rows[0, HEALTH] = NOTHING_SEEN
    SENSED.row["last"] = t - dt if dt > 0.0 else np.nan
    if motion.active or is_measured(z):
        given = motion.memory[None], motion.settings, motion.scratch
    SENSED.take(t, z, np.zeros(4), state, ready, given)
    return SENSED.row["z"].copy()


def sail(
    motion: DeckMotion, log: Log, z: np.ndarray | None = None, velocity_error_mps: float = 0.0
) -> Iterator[tuple[int, np.ndarray]]:
    """Let the motion take each row of a log; yield its number, and what :func:`take` returned.

    The horizontal motion is the true one, but for an error that sways. ``z`` are other
    measurements than the log's.
    """
    z, states, dt = log.z if z is None else z, log.truth.copy(), log.dt
    states[:, 3:5] += velocity_error_mps * np.sin(np.outer(log.t, [0.7, 0.9]))
    for k, t in enumerate(log.t):
        yield k, take(motion, t, dt if k else 0.0, z[k], states[k], True)


def after(motion: DeckMotion, log: Log, z: np.ndarray | None = None) -> DeckMotion:
    """Return the motion after all rows of a log."""
    for _ in sail(motion, log, z):
        pass
    return motion
