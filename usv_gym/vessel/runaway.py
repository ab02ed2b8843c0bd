"""Vessels whose motion grows without bound: found by a few seconds of hard manoeuvres.

The ship is integrated in calm water and strong wind, from rest and from fast crabbing, with full
thrust ahead, astern and to the sides. A ship whose speeds leave every plausible range runs away.
The coefficient to blame is the one farthest from those of the vessels that ship, scaled by Froude
to this length, of which a typical value ends that.
"""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import numpy as np

from usv_gym.physics import GRAVITY, ship
from usv_gym.physics import frames as fr
from usv_gym.physics.hull import hull_forces
from usv_gym.physics.parameters import PARAMETERS
from usv_gym.physics.propulsion import propulsion_forces
from usv_gym.physics.weather import constant
from usv_gym.vessel.schema import KIND_SCHEMA, OPTIONAL, SCHEMA
from usv_gym.vessel.vessel import Vessel, VesselError
from usv_gym.vessel.vessel_file import shipped_names
from usv_kernel.records import Record

__all__ = [
    "Runaway",
    "check_motion",
    "find_runaway",
]

DURATION = 20.0
"""How long each manoeuvre is, in lengths over top speed."""

STEPS = 60, 800
"""Fewest and most steps of a manoeuvre."""

SPEED_MAX = 5.0, 5.0
"""Largest plausible speed, as a multiple of the top speed and what is added to it, m/s."""

RATE_MAX = 5.0, 20.0
"""Largest plausible rate, in top speeds over lengths and what is added to it, rad/s."""

WAYS = (
    (0.0, 0.0, 0.5),
    (1.0, 0.4, 1.5),
    (1.0, -0.4, 2.5),
)
"""How manoeuvres start: surge and sway over top speed, and where the wind comes from, rad."""

SPEED_BISECTIONS = 40

STATE_MAX = 1e9
"""Bound of every entry of a state, SI units, also of a ship that has capsized."""

CAPSIZED = math.radians(70.0)
"""Roll or pitch beyond which the motion is not judged, rad."""

HEELED, DIPPING = 0.2, 0.05
"""Roll and pitch at the start of those in six degrees of freedom, rad."""

ROCKING = 0.3
"""Rates of roll and pitch there, as in steep waves, in units of sqrt(g / length)."""

DIMENSIONS = {
    **{"1": 0.0, "1/rad": 0.0, "rad": 0.0, "m": 1.0, "m2": 2.0, "kg": 3.0, "kg m2": 5.0},
    **{"kg/m": 2.0, "kg/s": 2.5, "kg m2/s": 4.5, "kg m2 s": 5.5, "N": 3.0, "m/s": 0.5},
    **{"s": 0.5, "rev/s": -0.5, "rev/s2": -1.0, "rad/s": -0.5, "kg/m3": 0.0},
}
"""Powers of the length with which quantities grow in ships of one Froude number, by unit."""

WIND = 5.5, 15.0
"""Speed of the wind for a ship of 1 m, scaled by Froude, and its maximum, m/s."""

SMALLER_STEPS = (2, 5, 10, 20, 50, 100)
"""By which the integration step is divided in search of one with which the ship can be sailed."""

SETTINGS = frozenset(
    (
        *("units", "water_density", "shaft_speed_service", "shaft_speed_manoeuvring", "steer_max"),
        *("length_waterline", "beam", "draft", "block_coefficient", "hull_beam", "spacing"),
        "zeta_roll_viscous",
    )
)
"""Parameters that are not to blame."""


class Runaway(NamedTuple):
    """A motion that grows without bound."""

    case: str  # which manoeuvre
    time: float  # when it left the plausible range, s
    coefficient: str  # the one to blame; empty if no single one is
    value: float
    typical: tuple[float, float]  # smallest and largest of vessels that ship, at this length
    step: float  # an integration step with which it does not, s; 0 if there is none


def check_motion(vessel: Vessel, dof: int, dt_physics: float) -> None:
    """Refuse a vessel that runs away; VesselError names the coefficient and the remedy.

    Parameters
    ----------
    vessel : Vessel
        Any vessel.
    dof : int
        Degrees of freedom, 3 or 6.
    dt_physics : float
        Integration step, s.
    """
    found = find_runaway(vessel, dof, dt_physics)
    if found is None:
        return
    text = (
        f"{vessel.name}: the motion runs away {found.time:.2g} s after {found.case}, with {dof} "
        f"degrees of freedom and dt_physics = {dt_physics:g} s. "
    )
    if found.coefficient:
        text += (
            f"{found.coefficient} = {found.value:.4g} is the likely cause: the vessels that ship "
            f"have {found.typical[0]:.2g} to {found.typical[1]:.2g} at this length"
        )
    else:
        text += "No single coefficient explains it: check their units and signs"
    if found.step:
        text += f"; it stays bounded with dt_physics = {found.step:.2g} s"
    raise VesselError(text)


def find_runaway(vessel: Vessel, dof: int, dt_physics: float) -> Runaway | None:
    """Return how a vessel runs away, or None if it does not; see :func:`check_motion`."""
    v = vessel.values
    if v["shaft_speed_manoeuvring"] > v["shaft_speed_max"]:
        raise VesselError(
            f"{vessel.name}: shaft_speed_manoeuvring = {v['shaft_speed_manoeuvring']:g} rev/s is "
            f"above shaft_speed_max = {v['shaft_speed_max']:g} rev/s; correct one of them"
        )
    full, hard = v["shaft_speed_max"], vessel.helm_max
    helms = {
        "full speed ahead": vessel.command(full, 0.0),
        "full speed astern": vessel.command(-full, 0.0),
        "full speed and hard to starboard": vessel.command(full, hard),
        "full speed and hard to port": vessel.command(full, -hard),
        "full speed astern and hard to starboard": vessel.command(-full, hard),
    }
    commands = tuple((text, *command.tolist()) for text, command in helms.items())
    return _find(vessel.packed.tobytes(), dof, dt_physics, commands)


@functools.lru_cache(maxsize=1024)
def _find(
    packed: bytes, dof: int, h: float, commands: tuple[tuple[Any, ...], ...]
) -> Runaway | None:
    """Search for a runaway of the vessel with these parameters."""
    p = np.frombuffer(packed, PARAMETERS).copy()[0]
    trials = [(*command, *way) for command in commands for way in WAYS]
    for trial in trials:
        steps = _steps_to_runaway(p, dof, h, trial)
        if steps is not None:
            first = (trial, *trials)
            smaller = (h / n for n in SMALLER_STEPS)
            step = next((s for s in smaller if _is_sound(p, dof, s, first)), 0.0)
            return Runaway(trial[0], steps * h, *_blame(p, dof, h, first), step)
    return None


def _top_speed(p: Record, n: float) -> float:
    """Return the steady speed straight ahead, m/s; the upper bound of the search if there is none.

    Like :meth:`Vessel.straight_speed`, for parameters that are no vessel's.
    """
    state = np.zeros(fr.STATE_SIZE)
    state[fr.N_LEFT] = state[fr.N_RIGHT] = n
    low, high = 0.0, 4.0 * n * p["propeller_diameter"] + 1.0
    for _ in range(SPEED_BISECTIONS):
        u = 0.5 * (low + high)
        surplus = propulsion_forces(u, 0.0, 0.0, state, p)[0] + hull_forces(u, 0.0, 0.0, p)[0]
        low, high = (u, high) if surplus > 0.0 else (low, u)
    return high


def _start(p: Record, top: float, dof: int, way: tuple[float, float, float]) -> np.ndarray:
    """Return the state (16,) in which a manoeuvre starts."""
    share, crab = way[:2]
    start = np.zeros(fr.STATE_SIZE)
    start[fr.U], start[fr.V], start[fr.R] = (
        share * top,
        crab * top,
        crab * top / p["length_waterline"],
    )
    if dof == 6:
        start[fr.PHI], start[fr.THETA] = math.copysign(HEELED, crab), DIPPING
        rocking = math.copysign(ROCKING * math.sqrt(GRAVITY / p["length_waterline"]), crab)
        start[fr.W], start[fr.P], start[fr.Q] = 0.1 * crab * top, rocking, rocking
    return start


def _steps_to_runaway(p: Record, dof: int, h: float, trial: tuple[Any, ...]) -> int | None:
    """Return the step at which a manoeuvre leaves the plausible range; None if it does not."""
    command, way = np.array(trial[1:5]), trial[5:]
    command[:2] = np.clip(command[:2], -p["shaft_speed_max"], p["shaft_speed_max"])
    with np.errstate(all="ignore"):
        top = _top_speed(p, float(np.abs(command[:2]).max()))
        time = top / p["length_waterline"]
        steps = int(min(max(DURATION / max(time, 1e-9) / h, STEPS[0]), STEPS[1]))
        states = np.zeros((steps + 1, fr.STATE_SIZE))
        states[0] = _start(p, top, dof, way)
        work = np.zeros((ship.WORK_ROWS, fr.STATE_SIZE))
        wind = min(WIND[0] * math.sqrt(p["length_waterline"]), WIND[1])
        sea = ship.calm_sea(constant(wind, way[2]))
        ship.sail(states, np.tile(command, (steps, 1)), ship.Ship(p, dof), sea, h, work)
        speeds = np.abs(states[:, [fr.U, fr.V, fr.W]]).max(axis=1)
        rates = np.abs(states[:, [fr.P, fr.Q, fr.R]]).max(axis=1)
        fast = ~(speeds <= SPEED_MAX[0] * top + SPEED_MAX[1])
        fast |= ~(rates <= RATE_MAX[0] * time + RATE_MAX[1])
        over = np.abs(states[:, [fr.PHI, fr.THETA]]).max(axis=1) > CAPSIZED
        if over.any():  # what has capsized tumbles, and an episode ends there
            fast[np.argmax(over) + 1 :] = False
        fast |= ~(np.abs(states).max(axis=1) < STATE_MAX)
    return int(np.argmax(fast)) if fast.any() else None


def _is_sound(p: Record, dof: int, h: float, trials: tuple[tuple[Any, ...], ...]) -> bool:
    """Return whether no manoeuvre runs away."""
    return all(_steps_to_runaway(p, dof, h, trial) is None for trial in trials)


@functools.cache
def _typical() -> dict[str, tuple[float, float, float]]:
    """Return least, median and most of each coefficient of vessels that ship, scaled to 1 m.

    A vessel may lack the optional terms: their ranges include 0.
    """
    found: dict[str, list[float]] = {}
    for name in shipped_names():
        values = Vessel.load(name).values
        for key, value in values.items():
            scale = values["length_waterline"] ** DIMENSIONS[_UNIT[key]]
            found.setdefault(key, []).append(value / scale)
    none = {key: [0.0] if key in OPTIONAL else [] for key in found}
    return {
        key: (min(x + none[key]), float(np.median(x)), max(x + none[key]))
        for key, x in found.items()
    }


_UNIT = {
    key: unit
    for table in (*SCHEMA.values(), *KIND_SCHEMA.values())
    for key, (unit, bound) in table.items()
}


def _blame(
    p: Record, dof: int, h: float, trials: tuple[tuple[Any, ...], ...]
) -> tuple[str, float, tuple[float, float]]:
    """Return the coefficient to blame, its value and its typical range at this length."""
    ranges, medians, excess = {}, {}, {}
    for name in _typical().keys() - SETTINGS:
        scale = float(p["length_waterline"] ** DIMENSIONS[_UNIT[name]])
        low, medians[name], high = (scale * value for value in _typical()[name])
        value, widest = float(p[name]), max(abs(low), abs(high)) or scale
        ranges[name] = low, high
        excess[name] = max(low - value, value - high) / widest
    changed = p.copy()
    for name in sorted(excess, key=lambda name: (-excess[name], name)):
        changed[name] = medians[name]
        sound = excess[name] > 0.0 and _is_sound(changed, dof, h, trials)
        changed[name] = p[name]
        if sound:
            return name, float(p[name]), ranges[name]
    return "", math.nan, (math.nan, math.nan)
