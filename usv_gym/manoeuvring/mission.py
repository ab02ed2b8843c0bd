"""A survey: parallel legs that an autopilot sails by line of sight."""

from __future__ import annotations

import math
from itertools import count
from typing import TYPE_CHECKING

import numpy as np

from usv_gym.manoeuvring.manoeuvres import HeadingHold

if TYPE_CHECKING:
    from collections.abc import Iterator

    from usv_gym.vessel.vessel import Vessel

__all__ = ["CURRENT", "CURRENT_TO", "Mission", "time_to_know", "way_points"]

LEG = (100.0, 12.0)
APART = (30.0, 7.0)
"""Length of a leg, and distance between legs: m, and the least in lengths of the boat."""

AHEAD = 3.0
REACH = 2.0
"""Distances in lengths of the boat: to the point of the leg that it steers for, and to the end of a
leg at which the next one begins."""

CRAB_TIME = 20.0
"""Time constant of the crab angle, s: that of the current, not that of a turn."""

CURRENT = 0.2
CURRENT_TO = math.radians(60.0)
"""Current of a mission in a sea without one, m/s, and where it goes."""

LEGS_KNOWN = 2.0
"""Legs to both directions, from which a twin tells a current from the boat's own speed."""


def _distances(length: float) -> tuple[float, float]:
    """Return the length of a leg and the distance between legs of a boat of a length, m."""
    leg, apart = (max(metres, lengths * length) for metres, lengths in (LEG, APART))
    return leg, apart


def time_to_know(vessel: Vessel) -> float:
    """Return the time in which a vessel sails legs to both directions, s."""
    speed = vessel.straight_speed(vessel.values["shaft_speed_manoeuvring"])
    return LEGS_KNOWN * sum(_distances(vessel.values["length_waterline"])) / speed


def way_points(length: float, place: np.ndarray, course: float) -> Iterator[np.ndarray]:
    """Yield the ends of legs for a boat of a length (m) at a place (2,), which is the first."""
    leg, apart = _distances(length)
    yield place
    for k in count():
        angle = course + 0.5 * math.pi * (0, 1, 2, 1)[k % 4]
        ahead = np.array([math.cos(angle), math.sin(angle)])
        place = place + (leg if k % 2 == 0 else apart) * ahead
        yield place


class Mission:
    """An autopilot that sails a lawn mower at the manoeuvring speed, and knows its true place.

    Its receiver is not that of the twin: a loss of GPS does not change the track, so that all
    predictors see the same run. Heading and yaw rate come from compass and gyro.

    Source: Fossen 2021, Sec. 12.4 (line-of-sight path following with crab-angle compensation).

    Parameters
    ----------
    vessel : Vessel
        What it steers.
    state : ndarray, shape (6,)
        x, y, psi, u, v, r at the start, from where the first leg goes straight ahead.
    dt : float
        Time between commands, s.
    """

    def __init__(self, vessel: Vessel, state: np.ndarray, dt: float) -> None:
        self._crab, self._share = 0.0, dt / CRAB_TIME
        self._hold = HeadingHold(vessel)
        self._length = vessel.values["length_waterline"]
        self._ends = way_points(self._length, np.array(state[:2]), float(state[2]))
        self._begin, self._end = next(self._ends), next(self._ends)

    def command(self, state: np.ndarray, compass: float, gyro: float) -> np.ndarray:
        """Return the command (4,) for a true state (6,), a compass (rad) and a gyro (rad/s)."""
        leg = self._end - self._begin
        course = math.atan2(leg[1], leg[0])
        c, s = math.cos(course), math.sin(course)
        dx, dy = self._end - state[:2]
        if c * dx + s * dy < REACH * self._length:
            self._begin, self._end = self._end, next(self._ends)
            return self.command(state, compass, gyro)
        across = s * dx - c * dy
        self._crab += self._share * (math.atan2(state[4], max(state[3], 0.1)) - self._crab)
        wanted = course - math.atan2(across, AHEAD * self._length) - self._crab
        return self._hold.command(wanted, compass, gyro)
