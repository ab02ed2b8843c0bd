"""State and command indices, and the turn between body and earth (Eq 1-3)."""

from __future__ import annotations

import math

from usv_kernel import kernel

X, Y, Z, PHI, THETA, PSI = 0, 1, 2, 3, 4, 5
U, V, W, P, Q, R = 6, 7, 8, 9, 10, 11
N_LEFT, N_RIGHT, DELTA_LEFT, DELTA_RIGHT = 12, 13, 14, 15
STATE_SIZE = 16
COMMAND_SIZE = 4
UNITS = 2
"""Propulsion units; index 0 is port (left), 1 is starboard (right)."""


@kernel
def to_earth(a: float, b: float, psi: float) -> tuple[float, float]:
    """Turn a horizontal body vector into north and east parts.

    Source: Eq (1)-(2) with roll and pitch zero.
    """
    c, s = math.cos(psi), math.sin(psi)
    return a * c - b * s, a * s + b * c


@kernel
def to_body(north: float, east: float, psi: float) -> tuple[float, float]:
    """Turn a horizontal earth vector into forward and starboard parts."""
    c, s = math.cos(psi), math.sin(psi)
    return north * c + east * s, east * c - north * s
