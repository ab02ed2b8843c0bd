"""Kernel that asks whether the current that a model estimates is one that water makes.

A GPS that is drawn away looks like a current. Where that is too large, or changes too fast, the
fixes are doubted.
"""

from __future__ import annotations

import math

from twin.health.drives.filters import SURGE
from twin.health.evidence import set_status
from twin.health.state import (
    CURRENT_CHANGES,
    CURRENT_LOOKS,
    DOUBTFUL,
    GPS,
    LARGE_CURRENT,
    NO_REASON,
    OK,
)
from usv_kernel.jit import kernel

__all__ = ["check_current"]

LARGEST = 4.0
"""A current above so many changes that are not plausible is none either, where no one has said so:
1 m/s for a boat whose class is known."""

EVERY, FIRST = 5.0, 30.0
"""The current is looked at each so many seconds, from so many seconds on: it is first learned."""

SURE = 2.0
"""Standard deviations by which it must be so."""

WAVES = 0.05
"""Surge by waves, in nominal speeds, at which the variance of the current is doubled.

Filters take waves for white noise, so steep ones move the current by more than they claim.
"""

SHOWN = 60.0
"""How long a change is shown, s."""


@kernel
def check_current(health, given):
    """Look at the current if it is time, and doubt the GPS where it is not plausible."""
    if health.clock < health.current_due:
        return
    north, east, sd = health.current[0], health.current[1], health.current[2]
    health.current_due = max(health.clock + EVERY, FIRST)
    if not math.isfinite(sd) or health.clock < FIRST:
        return
    sd *= math.hypot(1.0, health.wave_level[SURGE] / WAVES)
    past = health.current_past
    for look in range(CURRENT_LOOKS):
        by = math.hypot(north - past[look, 0], east - past[look, 1])
        # false where there was no look
        if by - SURE * math.hypot(sd, past[look, 2]) > given.current_change:
            health.current_doubted = health.clock + SHOWN
    for look in range(CURRENT_LOOKS - 1, 0, -1):
        for k in range(3):
            past[look, k] = past[look - 1, k]
    past[0, 0], past[0, 1], past[0, 2] = north, east, sd
    gps, reason = health.sensors[GPS], NO_REASON
    if math.hypot(north, east) - SURE * sd > LARGEST * given.current_change:
        reason = LARGE_CURRENT
    elif health.clock < health.current_doubted:
        reason = CURRENT_CHANGES
    doubted = gps.status == DOUBTFUL and (
        gps.reason == LARGE_CURRENT or gps.reason == CURRENT_CHANGES
    )
    if reason != NO_REASON and (gps.status == OK or doubted):
        set_status(health, GPS, DOUBTFUL, reason)
    elif doubted:
        set_status(health, GPS, OK, NO_REASON)
