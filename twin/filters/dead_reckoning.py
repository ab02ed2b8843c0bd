"""The recent path by dead reckoning: where the boat was when a late fix was taken."""

from __future__ import annotations

import math

from twin.filters.navigation_state import RING_COLUMNS, RING_ROWS
from usv_kernel.jit import kernel

__all__ = [
    "past_motion",
    "remember",
]


@kernel
def remember(nav, settings):
    """Write the present into the ring, unless the last entry is too near."""
    count = int(nav.count)
    if count > 0:
        apart = settings.latency / (RING_ROWS - 4)
        if nav.clock - nav.ring[(count - 1) % RING_ROWS, 0] < apart:
            return
    _present(nav, nav.ring[count % RING_ROWS])
    # the remainder alone counts, and that the ring is full
    nav.count = count + 1 if count + 1 < 2 * RING_ROWS else RING_ROWS


@kernel
def _present(nav, row):
    """Write time, path, and heading, u, v without corrections, then yaw rate."""
    row[0] = nav.clock
    for i in range(4):
        row[1 + i] = nav.path[i]
    for i in range(3):
        row[5 + i] = nav.n[2 + i] - nav.corrected[i]
    row[8] = nav.n[5]


@kernel
def past_motion(nav, settings, past):
    """Write where the boat was when the fix was taken.

    ``past`` becomes the way made since to north and east (m), the integrals of cos and sin
    of the heading (s), and then heading, u, v and r of that time.
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
            if older[0] <= then:
                break
        span = newer[0] - older[0]
        # before the oldest entry, the way goes on as it began
        if span > 0.0:
            share = min((newer[0] - then) / span, 1e3)
        for i in range(RING_COLUMNS):
            # ``newer`` may be ``past`` itself
            past[i] = (
                newer[i] + share * (older[i] - newer[i]) if i < 5 or share <= 1.0 else older[i]
            )
    turned, du, dv = nav.corrected[0], nav.corrected[1], nav.corrected[2]
    c, s = math.cos(turned), math.sin(turned)
    C, S = nav.path[2] - past[3], nav.path[3] - past[4]
    north = nav.path[0] - past[1] + du * C - dv * S
    east = nav.path[1] - past[2] + du * S + dv * C
    past[0], past[1] = c * north - s * east, s * north + c * east
    past[2], past[3] = c * C - s * S, s * C + c * S
    past[4], past[5], past[6] = past[5] + turned, past[6] + du, past[7] + dv
    past[7] = past[8]
