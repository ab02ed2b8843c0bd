"""Jumps of an estimate, which its receiver must know of."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.channels import PSI, U, V, X, Y

__all__ = ["JumpCounter"]

JUMP = 0.5
"""An estimate that moves by more than its velocity explains and this, m, has jumped."""

COUNTS = 256
"""The counter of ODOMETRY begins again after so many."""


class JumpCounter:
    """Counts the jumps of an estimate, as the field ``reset_counter`` of ODOMETRY does.

    An EKF refuses a place far from its own, unless the counter says that the estimate was reset.
    """

    def __init__(self) -> None:
        self.count = 0
        self._last: tuple[float, float, float, float, float] | None = None

    def take(self, t: float, state: NDArray[np.float64]) -> int:
        """Take a time (s) and state (6,), in order; return the count, from 0 to 255."""
        c, s = math.cos(state[PSI]), math.sin(state[PSI])
        north, east = state[U] * c - state[V] * s, state[U] * s + state[V] * c
        if self._last is not None:
            before, x, y, vx, vy = self._last
            dt = t - before
            ahead = x + 0.5 * dt * (vx + north), y + 0.5 * dt * (vy + east)
            if math.dist(ahead, (state[X], state[Y])) > JUMP:
                self.count = (self.count + 1) % COUNTS
        self._last = t, float(state[X]), float(state[Y]), float(north), float(east)
        return self.count
