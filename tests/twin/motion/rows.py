"""Rows for the motion of the deck alone, for tests."""

from __future__ import annotations

import numpy as np

from twin.integrity.sensing import sense_row
from twin.integrity.state import initial_integrity, integrity_settings
from twin.motion.deck_motion import DeckMotion
from twin.sim.bridge import particulars_of
from usv_gym import Vessel

BOAT = particulars_of(Vessel.load("usv75"))
SETTINGS = integrity_settings(BOAT)


def take(
    motion: DeckMotion, t: float, dt: float, z: np.ndarray, state: np.ndarray, ready: bool
) -> np.ndarray:
    """Let the motion take a row, and return it as an upright boat would have it."""
    z, health, restart = np.array(z, float), initial_integrity(BOAT), np.zeros(100)
    given = np.zeros(4), np.ascontiguousarray(state), ready, health, SETTINGS, motion.arrays(z)
    sense_row(t, dt, z, *given, np.empty(len(z)), np.empty(4), restart)
    return z
