"""The recent path by dead reckoning: where the boat was when a late fix was taken."""

from __future__ import annotations

import math
from typing import NamedTuple

from twin.channels import PSI, R
from twin.filters.navigation_state import RING_COLUMNS, RING_ROWS
from usv_kernel.jit import kernel

__all__ = [
    "past_motion",
    "remember",
]


_CLOCK, _NORTH, _EAST, _COS, _SIN, _HEADING, _SURGE, _SWAY, _YAW_RATE = range(RING_COLUMNS)
"""A row of the ring: time, path, and heading, u, v, r."""


class PastMotion(NamedTuple):
    """Where the boat was when a fix was taken."""

    north: float  # distance travelled since then, m
    east: float
    cos: float  # integrals of cosine and sine of the heading since then, s
    sin: float
    psi: float  # heading (rad), velocities (m/s) and yaw rate (rad/s) of that time
    u: float
    v: float
    r: float


@kernel
def remember(nav, settings):
    """Write the present motion to the ring, unless the last entry is too recent."""
    count = int(nav.count)
    if count > 0:
        apart = settings.latency / (RING_ROWS - 4)
        if nav.clock - nav.ring[(count - 1) % RING_ROWS, _CLOCK] < apart:
            return
    _present(nav, nav.ring[count % RING_ROWS])
    # only the remainder counts, and whether the ring is full
    nav.count = count + 1 if count + 1 < 2 * RING_ROWS else RING_ROWS


@kernel
def _present(nav, row):
    """Write a row of the ring; heading, u, v without corrections."""
    row[_CLOCK] = nav.clock
    for i in range(4):
        row[_NORTH + i] = nav.path[i]
    for i in range(3):
        row[_HEADING + i] = nav.n[PSI + i] - nav.corrected[i]
    row[_YAW_RATE] = nav.n[R]


@kernel
def past_motion(nav, settings, past):
    """Write where the boat was when the fix was taken.

    ``past`` is scratch, a row of the ring.
    """
    _present(nav, past)
    late = settings.latency
    if late > 0.0:
        then = nav.clock - late
        count = int(nav.count)
        depth = min(count, RING_ROWS)
        newer = past
        share = 0.0
        older = past
        for back in range(1, depth + 1):
            newer, older = older, nav.ring[(count - back) % RING_ROWS]
            if older[_CLOCK] <= then:
                break
        span = newer[_CLOCK] - older[_CLOCK]
        # before the oldest entry, the path is extrapolated
        if span > 0.0:
            share = min((newer[_CLOCK] - then) / span, 1e3)
        for i in range(RING_COLUMNS):
            # ``newer`` may be ``past`` itself
            linear = i < _HEADING or share <= 1.0
            past[i] = newer[i] + share * (older[i] - newer[i]) if linear else older[i]
    turned, du, dv = nav.corrected[0], nav.corrected[1], nav.corrected[2]
    c, s = math.cos(turned), math.sin(turned)
    C, S = nav.path[2] - past[_COS], nav.path[3] - past[_SIN]
    north = nav.path[0] - past[_NORTH] + du * C - dv * S
    east = nav.path[1] - past[_EAST] + du * S + dv * C
    return PastMotion(
        north=c * north - s * east,
        east=s * north + c * east,
        cos=c * C - s * S,
        sin=s * C + c * S,
        psi=past[_HEADING] + turned,
        u=past[_SURGE] + du,
        v=past[_SWAY] + dv,
        r=past[_YAW_RATE],
    )
