"""Timed manoeuvres: commands as functions of time."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from usv_gym.vessel.vessel import Vessel
from usv_kernel.errors import UsvTwinError

__all__ = [
    "HEADINGS",
    "MANOEUVRES",
    "MISSION",
    "SCENARIOS",
    "HeadingHold",
    "ManoeuvreError",
    "commands",
]


class ManoeuvreError(UsvTwinError):
    """An unknown manoeuvre; the message lists the known ones."""


def _straight(t: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return np.ones_like(t), np.zeros_like(t)


def _turn(t: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return np.ones_like(t), np.where(t >= APPROACH, ANGLE, 0.0)


def _zigzag(t: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    leg = np.floor((t - APPROACH) / LEG)
    return np.ones_like(t), np.where(t >= APPROACH, np.where(leg % 2 == 0, ANGLE, -ANGLE), 0.0)


def _turn_zigzag(t: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    leg = np.floor((t - SWITCH) / LEG)
    zigzag = np.where(leg % 2 == 0, -ANGLE, ANGLE)
    return np.ones_like(t), np.where(t >= SWITCH, zigzag, _turn(t, rng)[1])


def _random(t: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    throttle, angle = np.ones_like(t), np.zeros_like(t)
    begin = APPROACH
    while begin < t[-1]:
        later = t >= begin
        throttle[later], angle[later] = rng.uniform(0.7, 1.0), rng.uniform(-1.25, 1.25) * ANGLE
        begin += rng.uniform(3.0, 10.0)
    return throttle, angle


APPROACH = 5.0
"""Duration of the straight approach, s."""

LEG = 12.0
"""Duration of a leg of the zigzag, s; equal to both sides as in Qu et al. 2025."""

SWITCH = 82.0
"""Time at which turn-zigzag changes from turn to zigzag, s."""

ANGLE = math.radians(20.0)
"""Drive angle of turn and zigzag, rad."""

MANOEUVRES: dict[
    str, Callable[[np.ndarray, np.random.Generator], tuple[np.ndarray, np.ndarray]]
] = {
    "straight": _straight,
    "turn": _turn,
    "zigzag": _zigzag,
    "turn-zigzag": _turn_zigzag,
    "random": _random,
}
"""Name -> function of time that gives relative shaft speed and drive angle (rad)."""


HEADINGS = {f"heading{angle}": math.radians(angle) for angle in range(0, 181, 45)}
"""Straight runs by heading hold, and their angle to where the waves go: 0 is a following sea,
90 a beam sea from port, 180 a head sea."""

MISSION = "mission"
"""A lawn mower by line of sight in a current, see :mod:`usv_gym.manoeuvring.mission`."""

SCENARIOS = (*MANOEUVRES, *HEADINGS, MISSION)
"""All that a run can be."""

HOLD_GAIN = 0.8
HOLD_RATE = 0.8
"""Drive angle for a heading error, and for a turning of a length in the time to sail it."""


class HeadingHold:
    """An autopilot that holds a heading at the manoeuvring speed, for one boat or many.

    Parameters
    ----------
    vessel : Vessel
        What it steers.
    """

    def __init__(self, vessel: Vessel) -> None:
        self.vessel = vessel
        self.shaft = vessel.values["shaft_speed_manoeuvring"]
        time = vessel.values["length_waterline"] / vessel.straight_speed(self.shaft)
        self._rate = HOLD_RATE * time

    def command(
        self, heading: np.ndarray | float, compass: np.ndarray | float, gyro: np.ndarray | float
    ) -> np.ndarray:
        """Return the command (..., 4) for heading and compass, rad, and gyro, rad/s."""
        turn = 2.0 * math.pi
        error = np.asarray(heading - compass)
        error = error - turn * np.rint(error / turn)
        angle = np.clip(HOLD_GAIN * error - self._rate * gyro, -ANGLE, ANGLE)
        return self.vessel.command(self.shaft, angle)


def commands(
    name: str, t: np.ndarray, vessel: Vessel, rng: np.random.Generator, n: float | None = None
) -> np.ndarray:
    """Return the commands (N, 4) of one of :data:`MANOEUVRES` at times (N,) that rise from 0.

    Shaft speeds are in rev/s, angles in rad. ``n`` is the shaft speed at relative speed 1, by
    default the manoeuvring speed of the vessel. ``rng`` is used by ``random`` only.
    ManoeuvreError: the name is not known.
    """
    if name not in MANOEUVRES:
        raise ManoeuvreError(f"no manoeuvre is called {name!r}; known: {', '.join(MANOEUVRES)}")
    throttle, angle = MANOEUVRES[name](np.asarray(t, dtype=float), rng)
    full = vessel.values["shaft_speed_manoeuvring"] if n is None else n
    return vessel.command(throttle * full, angle)
