"""Kernel that asks whether the current that a model believes in is one that water makes.

A GPS that is drawn away looks like a current. Where that is too large, or changes too fast, the
fixes are doubted.
"""

from __future__ import annotations

import math

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

LARGEST, LARGEST_SHARE = 1.0, 0.1
"""A current above this is not plausible where no one has said so: m/s, or nominal speeds if that is
more, as the model of a fast boat says less of slow water."""

CHANGE, CHANGE_SHARE = 0.25, 0.05
"""Nor is one that changes by more than this within the looks that are remembered, likewise."""

EVERY = 5.0
"""The current is looked at each so many seconds."""

SURE = 2.0
"""Standard deviations by which it must be so."""

SHOWN = 60.0
"""How long a change is shown, s."""


@kernel
def check_current(current, health, given):
    """Look at the current if it is time, and doubt the GPS where it is not plausible.

    Parameters
    ----------
    current : tuple of 3 floats
        Velocity of the water to north and east, and its standard deviation, m/s; NaN where there
        is no estimate.
    health, given : record
        ``HEALTH``, advanced in place; ``HEALTH_SETTINGS``.
    """
    if health.clock < health.current_due:
        return
    north, east, sd = current
    health.current_due = health.clock + EVERY
    if not math.isfinite(sd):
        return
    past = health.current_past
    change = max(CHANGE, CHANGE_SHARE * given.speed)
    for look in range(CURRENT_LOOKS):
        by = math.hypot(north - past[look, 0], east - past[look, 1])
        # false where there was no look
        if by - SURE * math.hypot(sd, past[look, 2]) > change:
            health.current_doubted = health.clock + SHOWN
    for look in range(CURRENT_LOOKS - 1, 0, -1):
        for k in range(3):
            past[look, k] = past[look - 1, k]
    past[0, 0], past[0, 1], past[0, 2] = north, east, sd
    gps, reason = health.sensors[GPS], NO_REASON
    if math.hypot(north, east) - SURE * sd > max(LARGEST, LARGEST_SHARE * given.speed):
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
