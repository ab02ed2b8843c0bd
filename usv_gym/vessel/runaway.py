"""Vessels whose motion grows without bound: found by a few seconds of hard manoeuvres.

The ship is integrated in calm water and strong wind, from rest and from fast crabbing, with full
thrust ahead, astern and to the sides. A ship whose speeds leave every plausible range runs away.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np

from usv_gym.physics import GRAVITY, ship
from usv_gym.physics import frames as fr
from usv_gym.physics.hull import hull_forces
from usv_gym.physics.parameters import PARAMETERS
from usv_gym.physics.propulsion import propulsion_forces
from usv_gym.physics.weather import constant
from usv_gym.vessel.vessel import Vessel, VesselError
from usv_kernel.records import Record

__all__ = ["check_motion"]

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

HEELED = 0.2
DIPPING = 0.05
"""Roll and pitch at the start of those in six degrees of freedom, rad."""

ROCKING = 0.3
"""Rates of roll and pitch there, as in steep waves, in units of sqrt(g / length)."""

WIND = 5.5, 15.0
"""Speed of the wind for a ship of 1 m, scaled by Froude, and its maximum, m/s."""

SMALLER_STEPS = (2, 5, 10, 20, 50, 100)
"""By which the integration step is divided in search of one with which the ship can be sailed."""


def check_motion(vessel: Vessel, dof: int, dt_physics: float) -> None:
    """Refuse a vessel that runs away; VesselError names the manoeuvre and the remedy.

    Parameters
    ----------
    vessel : Vessel
        Any vessel.
    dof : int
        Degrees of freedom, 3 or 6.
    dt_physics : float
        Integration step, s.
    """
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
    found = _find_runaway(vessel.packed.tobytes(), dof, dt_physics, commands)
    if found is not None:
        raise VesselError(f"{vessel.name}: {found}")


@functools.lru_cache(maxsize=1024)
def _find_runaway(
    packed: bytes, dof: int, h: float, commands: tuple[tuple[Any, ...], ...]
) -> str | None:
    """Return in words how the vessel with these parameters runs away; None if it does not."""
    p = np.frombuffer(packed, PARAMETERS).copy()[0]
    trials = [(*command, *way) for command in commands for way in WAYS]
    for trial in trials:
        steps = _steps_to_runaway(p, dof, h, trial)
        if steps is not None:
            first = (trial, *trials)
            smaller = (h / n for n in SMALLER_STEPS)
            step = next((s for s in smaller if _is_sound(p, dof, s, first)), 0.0)
            bounded = f"; it stays bounded with dt_physics = {step:.2g} s" if step else ""
            return (
                f"the motion runs away {steps * h:.2g} s after {trial[0]}, with {dof} degrees of "
                f"freedom and dt_physics = {h:g} s. Check units and signs of its coefficients"
                f"{bounded}"
            )
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
