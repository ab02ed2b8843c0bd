"""Whether a vessel capsizes in a sea: a minute on five headings, before it is sailed."""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import NamedTuple

import numpy as np

from usv_gym.manoeuvring.manoeuvres import HeadingHold
from usv_gym.physics import frames as fr
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.sea import SeaState
from usv_gym.world.simulation import RunawayError, Simulation

__all__ = ["SeaTrial", "sail_in_sea", "warning_of"]

HEADINGS = (0.0, 45.0, 90.0, 135.0, 180.0)
"""Angles to where the waves go, degrees: 0 is a following sea."""

DURATION = 60.0
DT = 0.05
"""Length of the trial and its step, s."""

REALISATIONS = 2
"""Of the sea, for each heading."""

COMPONENTS = 100

CAPSIZED = math.radians(60.0)
"""The mast is further from upright than this, rad: few boats come back."""

SENSE = 1e6
"""Entries of a state beyond it make no sense, SI units."""


class SeaTrial(NamedTuple):
    """What became of a vessel in a sea."""

    tilt: float
    """Largest angle of the mast from upright, rad."""
    capsized: tuple[float, ...]
    """Headings on which it capsized, degrees to where the waves go."""

    @property
    def where(self) -> str:
        """On which headings it capsized, in words."""
        headings = ", ".join(f"{angle:g}" for angle in self.capsized)
        return f"with the waves at {headings} degrees to its heading (0: from astern)"


def sail_in_sea(vessel: Vessel, sea: SeaState) -> SeaTrial:
    """Sail a vessel with six degrees of freedom for a minute on each of five headings.

    A heading hold steers by the truth at the manoeuvring speed. The seas are always the same.
    """
    return _sail(_Key(vessel), sea.replace(components=min(sea.components, COMPONENTS)))


class _Key:
    """A vessel that equals another one of the same numbers."""

    def __init__(self, vessel: Vessel) -> None:
        self.vessel = vessel
        self._numbers = vessel.name, vessel.packed.tobytes()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self._numbers == other._numbers

    def __hash__(self) -> int:
        return hash(self._numbers)


@functools.lru_cache(maxsize=64)
def _sail(key: _Key, sea: SeaState) -> SeaTrial:
    """Do :func:`sail_in_sea` once for each vessel and sea."""
    vessel, angles = key.vessel, np.repeat(np.radians(HEADINGS), REALISATIONS)
    n = len(angles)
    simulation = Simulation(n, vessel, sea, dof=6, dt=DT)
    simulation.reset(range(n), [np.random.default_rng([k]) for k in range(n)])
    simulation.state[:, fr.PSI] = heading = sea.waves_to + angles
    autopilot = HeadingHold(vessel)
    largest, over = np.zeros(n), np.zeros(n, dtype=np.bool_)
    for _ in range(round(DURATION / DT)):
        state = simulation.state
        try:
            simulation.step(autopilot.command(heading, state[:, fr.PSI], state[:, fr.R]))
        except RunawayError:
            over |= ~(np.abs(simulation.state) < SENSE).all(axis=1)
            break
        state = simulation.state
        tilt = np.arccos(np.clip(np.cos(state[:, fr.PHI]) * np.cos(state[:, fr.THETA]), -1.0, 1.0))
        # what has capsized tumbles on
        largest = np.where(over, largest, np.maximum(largest, tilt))
        over |= tilt > CAPSIZED
    capsized = sorted({round(math.degrees(angle)) for angle in angles[over]})
    return SeaTrial(float(largest.max()), tuple(map(float, capsized)))


def warning_of(vessel: Vessel, sea: SeaState, dof: int) -> str | None:
    """Return what to expect of a vessel that capsizes in a sea; None of one that does not.

    With ``dof=3`` no vessel does.
    """
    if dof != 6 or sea.hs <= 0.0:
        return None
    if sea.schedule:  # the worst of a sea that changes, for as long as the trial takes
        worst = max(sea.schedule, key=lambda moment: moment.hs)
        sea = dataclasses.replace(sea, hs=worst.hs, wind=worst.wind, schedule=())
    trial = sail_in_sea(vessel, sea)
    if not trial.capsized:
        return None
    return (
        f"{vessel.name} capsizes in waves of {sea.hs:g} m within a minute, {trial.where}; "
        "take a calmer sea or another vessel"
    )
