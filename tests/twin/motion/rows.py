"""Rows for the motion of the deck alone, for tests."""

from __future__ import annotations

import numpy as np

from tests.twin.rows import NO_MOTION, Sensed
from twin.motion.attitude import is_measured
from twin.motion.deck_motion import DeckMotion
from twin.sim.bridge import particulars_of
from usv_gym import Vessel

BOAT = particulars_of(Vessel.load("usv75"))


def take(
    motion: DeckMotion, t: float, dt: float, z: np.ndarray, state: np.ndarray, ready: bool
) -> np.ndarray:
    """Let the motion take a row, and return it as an upright boat would have it."""
    boat, given = Sensed(BOAT, t - dt if dt > 0.0 else np.nan), NO_MOTION
    if motion.active or is_measured(z):
        given = motion.memory[None], motion.settings, motion.scratch
    boat.take(t, z, np.zeros(4), state, ready, given)
    return boat.row["z"].copy()
