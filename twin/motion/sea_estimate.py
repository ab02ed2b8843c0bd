"""Height, period and direction of the waves, from how the boat moves on them."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from twin.motion.state import ANGLE, CLIMB, HEAVE
from twin.particulars import GRAVITY
from usv_kernel.jit import kernel
from usv_kernel.records import as_record
from usv_kernel.scalar import sincos

__all__ = ["SEA_MOMENTS", "SeaEstimate", "estimate_sea", "sea_of", "take_sea"]

MEMORY = 120.0
"""Time after which a sample weighs a third, s."""

READY = 30.0
"""Time of data before there is an estimate, s."""

SEA_MOMENTS = np.dtype(
    [
        ("seconds", "f8"),  # time of data
        ("heave", "f8", 2),  # mean and mean square, m
        ("climb", "f8"),  # mean square of the vertical speed, m2/s2
        ("slope", "f8", 2),  # means of the slopes to north and east
        ("slopes", "f8"),  # mean square of the slope
        ("cross", "f8", 2),  # mean products of vertical speed and slopes, m/s
        ("speed", "f8", 2),  # mean velocity of the boat to north and east, m/s
    ]
)
"""Moments of the motion in the axes of the earth. All are float64."""


class SeaEstimate(NamedTuple):
    """What the twin makes of the sea; NaN until half a minute of motion is known."""

    hs: float
    """Significant height, m: four standard deviations of the heave. Waves shorter than the boat
    hardly lift it, and are missing; so are, by up to half, those that it sails along with."""
    period: float
    """Mean period of the waves, s, by their slopes; not that of their encounter with the boat."""
    to: float
    """Mean direction that they go to, rad clockwise from north, whatever the heading."""

    @property
    def known(self) -> bool:
        """Whether there is an estimate yet."""
        return math.isfinite(self.hs)


@kernel
def take_sea(dt, heading, velocity, attitude, memory):
    """Take the attitude of a row.

    Parameters
    ----------
    dt, heading : float
        Time since the row before (s), and heading (rad).
    velocity : ndarray, shape (2,)
        Speed forward and to starboard by the twin, m/s; NaN where it has none.
    attitude : record of ``twin.motion.state.ATTITUDE``
        After the row.
    memory : record of :data:`SEA_MOMENTS`
        Advanced in place.
    """
    if not (math.isfinite(velocity[0]) and math.isfinite(velocity[1]) and dt > 0.0):
        return
    memory.seconds += dt
    share = min(dt / min(memory.seconds, MEMORY), 1.0)
    phi, theta = attitude.tilt[0, ANGLE], attitude.tilt[1, ANGLE]
    z, w = attitude.vertical[HEAVE], attitude.vertical[CLIMB]
    s, c = sincos(heading)
    # a boat that lies in the surface: bow up where it rises ahead, starboard down to starboard
    north, east = theta * c + phi * s, theta * s - phi * c
    memory.heave[0] += share * (z - memory.heave[0])
    memory.heave[1] += share * (z * z - memory.heave[1])
    memory.climb += share * (w * w - memory.climb)
    memory.slope[0] += share * (north - memory.slope[0])
    memory.slope[1] += share * (east - memory.slope[1])
    memory.slopes += share * (north * north + east * east - memory.slopes)
    memory.cross[0] += share * (w * north - memory.cross[0])
    memory.cross[1] += share * (w * east - memory.cross[1])
    u, v = velocity[0], velocity[1]
    memory.speed[0] += share * (u * c - v * s - memory.speed[0])
    memory.speed[1] += share * (u * s + v * c - memory.speed[1])


@kernel
def sea_of(memory):
    """Return height (m), period (s) and direction (rad) of the waves; NaN while unknown.

    A surface that travels has slope and vertical speed in phase, along its direction. A boat that
    overtakes the waves sees them the other way round. Of the two directions, the one is taken whose
    frequency of encounter is nearer to that of the heave.

    Source: Longuet-Higgins, Cartwright and Smith 1963 (directions from heave, pitch and roll).
    """
    heave = memory.heave[1] - memory.heave[0] ** 2
    slopes = memory.slopes - memory.slope[0] ** 2 - memory.slope[1] ** 2
    if not (memory.seconds >= READY and heave > 0.0 and slopes > 0.0):
        return math.nan, math.nan, math.nan
    number = math.sqrt(slopes / heave)
    frequency, seen = math.sqrt(GRAVITY * number), math.sqrt(memory.climb / heave)
    along = math.atan2(memory.cross[1], memory.cross[0])
    s, c = sincos(along)
    speed = memory.speed[0] * c + memory.speed[1] * s
    # waves that go along are met, or waves that go the other way are overtaken
    met, overtaken = abs(frequency - number * speed), -number * speed - frequency
    turned = overtaken > 0.0 and abs(overtaken - seen) < abs(met - seen)
    to = along + math.pi if turned else along
    return 4.0 * math.sqrt(heave), 2.0 * math.pi / frequency, to % (2.0 * math.pi)


@kernel
def _sea_of(memory):
    """Do :func:`sea_of` on flat memory."""
    return sea_of(as_record(memory, SEA_MOMENTS))


def estimate_sea(memory: Any) -> SeaEstimate:
    """Return height, period and direction of the waves: see :func:`sea_of`.

    ``memory`` is :data:`SEA_MOMENTS` as flat float64.
    """
    return SeaEstimate(*_sea_of(memory))
