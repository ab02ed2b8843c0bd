"""What differs from episode to episode: boat, load, wind, current, heading and faults."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from usv_gym.envs.config import EnvConfig
from usv_gym.vessel.variation import FACTORS, BoatClass, Factors
from usv_gym.vessel.vessel import Vessel, VesselError
from usv_gym.world.faults import (
    Disturbance,
    FaultError,
    FaultWarning,
    fault_records,
    fault_text,
    ineffective_fault,
    parse_faults,
)
from usv_gym.world.sea import choice
from usv_gym.world.sensors import SensorSuite
from usv_gym.world.simulation import Simulation, World

__all__ = ["Draw", "Worlds", "faults_of"]

FAULT_START = (10.0, 60.0)
"""A fault given by its name begins at random between these times, s."""

DRAWN = (
    *("load", "hs_m", "wind_mps", "wind_from_deg", "current_mps", "current_to_deg"),
    "heading_deg",
)
"""Numbers of ``info["drawn"]``."""

_KIND, _LOAD, _WIND_FROM, _CURRENT, _CURRENT_TO, _HEADING = range(6)
_NUMBERS = 6
"""Uniform numbers of an episode: all are drawn, so that none hangs on which options are set."""


class Draw(NamedTuple):
    """What one episode has."""

    kind: int
    """Place of the vessel among those of which one is drawn."""
    world: World
    factors: np.ndarray
    """Of the boat, see :data:`usv_gym.vessel.variation.FACTORS`."""
    load: float


class Worlds:
    """Draws what differs from episode to episode, and remembers it for ``info["drawn"]``.

    Parameters
    ----------
    n : int
        Number of boats.
    config : EnvConfig
        Options of the environment.
    vessels : sequence of Vessel
        One of which each episode has.

    Attributes
    ----------
    active : bool
        Whether anything is drawn or changed here; if not, :meth:`draw` is not called.
    drawn : dict of str to ndarray
        What stands in ``info["drawn"]``, an array (n, ...) for each key.
    """

    def __init__(self, n: int, config: EnvConfig, vessels: Sequence[Vessel]) -> None:
        spread = config.vessel_spread
        self.classes = [BoatClass(one, spread, sides=spread / 3.0) for one in vessels]
        self._wind_from, self._load = config.wind_span(), config.load_span()
        self._current, self._heading = config.current_spans(), config.heading_span()
        self._mass_varies = self._load != (1.0, 1.0)
        moved = self._heading != (0.0, 0.0) or self._mass_varies or len(vessels) > 1
        varies = spread > 0.0 or self._wind_from is not None or self._current is not None
        self.active = bool(varies or moved)
        self.drawn: dict[str, np.ndarray] = {
            "vessel": np.full(n, vessels[0].name, dtype=object),
            "vessel_factors": np.full(n, None, dtype=object),
            **{name: np.zeros(n) for name in DRAWN},
            "faults": np.full(n, "none", dtype=object),
        }
        self.drawn["load"][:] = 1.0
        same = Factors(*[1.0] * len(FACTORS))
        for i in range(n):
            self.drawn["vessel_factors"][i] = same

    def draw(self, rng: np.random.Generator) -> Draw:
        """Draw one episode."""
        u = rng.random(_NUMBERS).tolist()
        kind = min(int(u[_KIND] * len(self.classes)), len(self.classes) - 1)
        load = _within(self._load, u[_LOAD])
        boat = self.classes[kind].draw(rng, load)
        current = None
        if self._current is not None:
            speed = _within(self._current[0], u[_CURRENT])
            to = math.radians(_within(self._current[1], u[_CURRENT_TO]))
            current = speed * math.cos(to), speed * math.sin(to)
        span = self._wind_from
        wind_from = None if span is None else math.radians(_within(span, u[_WIND_FROM]) % 360.0)
        heading = math.radians(_within(self._heading, u[_HEADING]))
        heading = (heading + math.pi) % (2.0 * math.pi) - math.pi if heading else 0.0
        world = World(boat.vessel, boat.speed, heading, wind_from, current)
        return Draw(kind, world, boat.factors, load)

    def note(self, i: int, draw: Draw | None, simulation: Simulation) -> None:
        """Remember what the episode of boat i has; None: nothing was drawn here."""
        drawn, sea, faults = self.drawn, simulation.drawn_seas[i], simulation.drawn_faults[i]
        drawn["hs_m"][i], drawn["wind_mps"][i] = sea.hs, sea.wind
        weather = simulation.weather[i]
        wind_from = sea.wind_from if draw is None else draw.world.wind_from
        wind_from = sea.wind_from if wind_from is None else wind_from
        drawn["wind_from_deg"][i] = math.degrees(wind_from) % 360.0
        north, east = weather["current_north"].item(), weather["current_east"].item()
        drawn["current_mps"][i] = math.hypot(north, east)
        drawn["current_to_deg"][i] = math.degrees(math.atan2(east, north)) % 360.0
        drawn["faults"][i] = "+".join(map(fault_text, faults)) or "none"
        if draw is not None:
            drawn["vessel"][i], drawn["load"][i] = draw.world.vessel.name, draw.load
            drawn["vessel_factors"][i] = Factors(*draw.factors.tolist())
            drawn["heading_deg"][i] = math.degrees(draw.world.heading) % 360.0


def _within(span: tuple[float, float], share: float) -> float:
    """Return a number of a range, by its share of the way."""
    low, high = span
    return low if low == high else low + share * (high - low)


def vessels_of(config: EnvConfig) -> tuple[Vessel, ...]:
    """Return the vessels of which one is drawn; VesselError where they cannot share a simulation.

    Action and observation need the same entries for all of them.
    """
    given: Any = config.vessel
    if isinstance(given, str):
        given = [name.strip() for name in given.split("|")]
    elif not isinstance(given, Sequence):
        given = [given]
    if not given:
        raise VesselError("vessel = an empty list: give one or more")
    vessels = tuple(Vessel.load(one) for one in given)
    if config.actions == "units":
        widths = {one.name: one.actuators.shape[1] for one in vessels}
        if len(set(widths.values())) > 1:
            listed = ", ".join(f"{name} has {width}" for name, width in widths.items())
            raise VesselError(
                f"vessel: actions='units' is an action for each actuator, and {listed}; use "
                "actions='common', which is one shaft speed and one angle for every vessel"
            )
    return vessels


def check_tables(vessels: Sequence[Vessel], dof: int) -> None:
    """Refuse vessels with and without a hydrodynamic table in six degrees of freedom."""
    if dof == 6 and len({one.hydro is None for one in vessels}) > 1:
        names = ", ".join(one.name for one in vessels if one.hydro is not None)
        raise VesselError(
            f"vessel: with dof=6 only some of these have a hydrodynamic table ({names}); take "
            "Vessel.load(name).without_table() of those, or vessels that all have one"
        )


def faults_of(config: EnvConfig) -> tuple[Any, int]:
    """Return faults, or a function that draws them, and how many there are at most."""
    faults, dt = config.faults, config.dt
    if isinstance(faults, str):
        texts = faults.split("|")
        # a wrong name fails here, not at the first reset
        named = [parse_faults(one, 0.0) for one in texts]
        if not any(named):
            return (), 0
        most = max(len(fault_records(one, dt)) for one in named)
        _warn_of([fault for one in named for fault in one], config)

        later = [parse_faults(one, 1.0) for one in texts]
        drawn = [
            [(fault, fault != moved) for fault, moved in zip(*both, strict=True)]
            for both in zip(named, later, strict=True)
        ]

        def draw(rng: np.random.Generator) -> tuple[Disturbance, ...]:
            start = rng.uniform(*FAULT_START)
            found = choice(drawn, rng)
            return tuple(_begun(one, start) if moves else one for one, moves in found)

        drawer: Callable[[np.random.Generator], tuple[Disturbance, ...]] = draw
        return drawer, most
    items = list(faults) if isinstance(faults, Sequence) else [faults]
    given = [fault for fault in items if isinstance(fault, Disturbance)]
    if len(given) < len(items):
        raise FaultError(
            f"faults = {faults!r}: give a text such as 'gps10', or a list of "
            "usv_gym.Fault(kind, start, duration)"
        )
    _warn_of(given, config)
    return given, len(given)


def _begun(fault: Disturbance, start: float) -> Disturbance:
    """Return a fault that begins at another time (s), and needs no other check."""
    begun = object.__new__(type(fault))
    begun.__dict__.update(fault.__dict__, start=start)
    return begun


def _warn_of(faults: Sequence[Disturbance], config: EnvConfig) -> None:
    """Warn of a fault that changes nothing."""
    anemometer = SensorSuite.of(config.suite).has_anemometer
    if (found := ineffective_fault(faults, config.dof, anemometer)) is not None:
        warnings.warn(found, FaultWarning, stacklevel=4)
