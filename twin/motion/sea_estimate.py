"""Height, period and direction of the waves, from how the boat moves on them."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from twin.motion.state import ANGLE, CLIMB, HEAVE
from twin.particulars import GRAVITY
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import as_record
from usv_kernel.scalar import sincos

__all__ = [
    "DIRECTION_SD_MAX_RAD",
    "SEA_MOMENTS",
    "SeaEstimate",
    "estimate_sea",
    "sea_of",
    "take_sea",
]

FORGETTING_S = 120.0
"""Time constant of the moments."""

FIRST_ESTIMATE_S = 30.0
"""Time of data before there is an estimate."""

MEAN_SQUARE_MIN = 1e-12
"""Mean squares below this show no waves, SI units."""

COHERENCE_MIN = 0.35
"""Correlation of vertical speed and slope from which on it shows the direction."""

DIRECTION_SD_RAD = math.radians(8.0)
LINE_SD_RAD = math.radians(13.0)
"""What the boat's own motion adds to the error of the direction: by vertical speed and slope, and
by the slopes alone."""

BANDWIDTH = 0.25
"""Width of a spectrum, as a share of its frequency."""

RATIO_SD = 0.35
PHASE_SD = 0.5
"""Standard deviations of the logarithm of the frequency of encounter, and of that correlation."""

DIRECTION_SD_MAX_RAD = 1.0
"""Standard deviation from which on a direction is not to be used."""

SEA_MOMENTS = np.dtype(
    [
        ("seconds", "f8"),  # time of data
        ("heave", "f8", 2),  # mean and mean square, m
        ("climb", "f8"),  # mean square of the vertical speed, m2/s2
        ("slope", "f8", 2),  # means of the slopes to north and east
        ("slopes", "f8", 3),  # their mean squares and mean product
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
    to_sd: float
    """Standard deviation of that, rad. It is large where the opposite direction is as likely."""

    @property
    def known(self) -> bool:
        """Whether there is an estimate yet."""
        return math.isfinite(self.hs)

    @property
    def direction_known(self) -> bool:
        """Whether the direction is known to within :data:`DIRECTION_SD_MAX_RAD`."""
        return self.to_sd < DIRECTION_SD_MAX_RAD


@kernel
def take_sea(dt, heading, velocity, attitude, memory):
    """Take the attitude of a row.

    Parameters
    ----------
    dt, heading : float
        Time since the row before (s), and heading (rad).
    velocity : ndarray, shape (3,)
        Speed forward and to starboard (m/s) and rate of turn by the twin; NaN where it has none.
    attitude : record of ``twin.motion.state.ATTITUDE``
        After the row.
    memory : record of :data:`SEA_MOMENTS`
        Advanced in place.
    """
    if not (math.isfinite(velocity[0]) and math.isfinite(velocity[1]) and dt > 0.0):
        return
    memory.seconds += dt
    share = min(dt / min(memory.seconds, FORGETTING_S), 1.0)
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
    memory.slopes[0] += share * (north * north - memory.slopes[0])
    memory.slopes[1] += share * (east * east - memory.slopes[1])
    memory.slopes[2] += share * (north * east - memory.slopes[2])
    memory.cross[0] += share * (w * north - memory.cross[0])
    memory.cross[1] += share * (w * east - memory.cross[1])
    u, v = velocity[0], velocity[1]
    memory.speed[0] += share * (u * c - v * s - memory.speed[0])
    memory.speed[1] += share * (u * s + v * c - memory.speed[1])


@kernel
def sea_of(memory):
    """Return height (m), period (s), direction of the waves and its deviation (rad); else NaN.

    A surface that travels has slope and vertical speed in phase, along its direction. Waves that
    the boat hardly meets, or overtakes, have them out of phase; then the slopes alone show the
    line along which the waves travel. Of its two directions the one is taken whose frequency of
    encounter, and whose sign of the phase, fit better to what is seen.

    Source: Longuet-Higgins, Cartwright and Smith 1963 (directions from heave, pitch and roll).
    """
    a, b = memory.slope[0], memory.slope[1]
    heave = memory.heave[1] - memory.heave[0] ** 2
    north, east = memory.slopes[0] - a * a, memory.slopes[1] - b * b
    slopes = north + east
    if not (
        memory.seconds >= FIRST_ESTIMATE_S and min(heave, slopes, memory.climb) > MEAN_SQUARE_MIN
    ):
        return math.nan, math.nan, math.nan, math.nan
    number = math.sqrt(slopes / heave)
    frequency, seen = math.sqrt(GRAVITY * number), math.sqrt(memory.climb / heave)
    size = math.sqrt(memory.climb * slopes)
    coherence = min(math.hypot(memory.cross[0], memory.cross[1]) / size, 1.0)
    in_phase = coherence >= COHERENCE_MIN
    along = (
        math.atan2(memory.cross[1], memory.cross[0])
        if in_phase
        else 0.5 * math.atan2(2.0 * (memory.slopes[2] - a * b), north - east)
    )
    s, c = sincos(along)
    speed = memory.speed[0] * c + memory.speed[1] * s
    phase = (memory.cross[0] * c + memory.cross[1] * s) / size
    forth = _misfit(frequency, number * speed, seen, phase)
    back = _misfit(frequency, -number * speed, seen, -phase)
    to = along if forth <= back else along + math.pi
    waves = min(memory.seconds, FORGETTING_S) * seen / math.pi
    var = (1.0 - coherence**2) / (2.0 * waves * max(coherence, COHERENCE_MIN) ** 2)
    var += DIRECTION_SD_RAD**2 if in_phase else LINE_SD_RAD**2
    sure = 1.0 / (1.0 + math.exp(-0.5 * min(abs(forth - back), 60.0)))
    sd = math.sqrt(sure * var + (1.0 - sure) * math.pi**2)
    return 4.0 * math.sqrt(heave), 2.0 * math.pi / frequency, to % (2.0 * math.pi), sd


@inlined
def _misfit(frequency, shift, seen, phase):
    """Return how badly a direction fits, in squared standard deviations.

    ``shift`` (rad/s) is what the boat's own speed takes off the frequency of the waves, ``seen``
    (rad/s) that of the heave, ``phase`` the correlation of vertical speed and slope.
    """
    met, width = frequency - shift, BANDWIDTH * frequency
    ratio = math.log(seen / math.hypot(met, width)) / RATIO_SD
    side = (phase - math.tanh(met / width)) / PHASE_SD
    return ratio * ratio + side * side


@kernel
def _sea_of(memory):
    """Do :func:`sea_of` on flat memory."""
    return sea_of(as_record(memory, SEA_MOMENTS))


def estimate_sea(memory: Any) -> SeaEstimate:
    """Return height, period, direction of the waves and how sure it is: see :func:`sea_of`.

    ``memory`` is :data:`SEA_MOMENTS` as flat float64.
    """
    return SeaEstimate(*_sea_of(memory))
