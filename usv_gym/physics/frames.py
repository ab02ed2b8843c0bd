"""State and command indices, and the turn between body and earth (Eq 1-3)."""

from __future__ import annotations

from usv_kernel.jit import inlined
from usv_kernel.scalar import sincos

X, Y, Z, PHI, THETA, PSI = 0, 1, 2, 3, 4, 5

U, V, W, P, Q, R = 6, 7, 8, 9, 10, 11

N_LEFT, N_RIGHT, DELTA_LEFT, DELTA_RIGHT = 12, 13, 14, 15

STATE_SIZE = 16

COMMAND_SIZE = 4

UNITS = 2
"""Propulsion units; index 0 is port (left), 1 is starboard (right)."""


@inlined
def to_earth(a: float, b: float, psi: float) -> tuple[float, float]:
    """Turn a horizontal body vector into north and east parts.

    Source: Eq (1)-(2) with roll and pitch zero.
    """
    s, c = sincos(psi)
    return a * c - b * s, a * s + b * c


@inlined
def to_body(north: float, east: float, psi: float) -> tuple[float, float]:
    """Turn a horizontal earth vector into forward and starboard parts."""
    s, c = sincos(psi)
    return north * c + east * s, east * c - north * s


@inlined
def rotate(
    phi: float, theta: float, psi: float, a: float, b: float, c: float
) -> tuple[float, float, float]:
    """Turn a body vector (forward, starboard, down) into north, east and down parts.

    Source: Eq (1)-(2): roll, then pitch, then heading. Upright: the bits of :func:`to_earth`.
    """
    s_phi, c_phi = sincos(phi)
    s_theta, c_theta = sincos(theta)
    starboard, low = b * c_phi - c * s_phi, b * s_phi + c * c_phi
    north, east = to_earth(a * c_theta + low * s_theta, starboard, psi)
    return north, east, low * c_theta - a * s_theta


@inlined
def unrotate(
    phi: float, theta: float, psi: float, north: float, east: float, down: float
) -> tuple[float, float, float]:
    """Turn an earth vector into forward, starboard and down parts; undoes :func:`rotate`."""
    s_phi, c_phi = sincos(phi)
    s_theta, c_theta = sincos(theta)
    ahead, starboard = to_body(north, east, psi)
    low = ahead * s_theta + down * c_theta
    return (
        ahead * c_theta - down * s_theta,
        starboard * c_phi + low * s_phi,
        low * c_phi - starboard * s_phi,
    )
