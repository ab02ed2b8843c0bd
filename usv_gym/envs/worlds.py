"""What differs from episode to episode: boat, load, wind, current, heading and faults."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from usv_gym.envs.config import EnvConfig
from usv_gym.vessel.variation import FACTORS, LAW, Factors, draw_boat, scratch_of_draws
from usv_gym.vessel.vessel import BoatClass, Vessel, VesselError
from usv_gym.world.faults import (
    Disturbance,
    FaultError,
    FaultWarning,
    fault_of_table,
    ineffective_fault,
    parse_faults,
)
from usv_gym.world.sensors import SensorSuite
from usv_gym.world.simulation import Simulation
from usv_gym.world.start import FaultSets
from usv_gym.world.state import VESSEL, WORLD
from usv_kernel.arrays import alloca_f64
from usv_kernel.jit import inlined, kernel
from usv_kernel.random import fill_uniform, start_stream
from usv_kernel.records import as_record, field_at

__all__ = ["DRAWN", "Worlds", "faults_of", "note_drawn"]

FAULT_START = (10.0, 60.0)
"""A fault given by its name begins at random between these times, s."""

DRAWN = (
    *("load", "hs_m", "wind_mps", "wind_from_deg", "current_mps", "current_to_deg"),
    "heading_deg",
)
"""Numbers of ``info["drawn"]``."""

_KIND, _LOAD, _WIND_FROM, _CURRENT, _CURRENT_TO, _HEADING = range(6)
_NUMBERS = 6
"""Uniform numbers of an episode: all are drawn, so that none depends on the options."""

_KIND_AT = field_at(WORLD, "kind")
_LOAD_AT = field_at(WORLD, "load")
_FACTORS = slice(field_at(WORLD, "factors"), field_at(WORLD, "factors") + len(FACTORS))

_FAULTS = slice(field_at(WORLD, "faults"), field_at(WORLD, "fault_start") + 1)

_UNDRAWN = (math.nan, math.nan)


@inlined
def _within(span, share):
    """Return a number of a range, by its share of the way."""
    return span[0] if span[0] == span[1] else span[0] + share * (span[1] - span[0])


@kernel
def _draw(
    words: np.ndarray,
    spans: np.ndarray,
    laws: np.ndarray,
    row: np.ndarray,
    world: np.ndarray,
    scratch: np.ndarray,
) -> float:
    """Draw one episode, and return the speed of its boat, or why there is none.

    ``words`` (4,) start its generator, and become it. ``spans`` (6, 2) are ranges; NaN: not drawn.
    ``laws`` (K, ...), ``row`` and ``world`` are flat memory of LAW, BOAT and WORLD.
    """
    start_stream(words, words)
    u = alloca_f64(_NUMBERS)
    fill_uniform(words, u)
    begin, count = as_record(world, WORLD), laws.shape[0]
    kind = min(int(u[_KIND] * count), count - 1)
    begin.kind, begin.load = kind, _within(spans[_LOAD], u[_LOAD])
    law, flat = as_record(laws[kind], LAW), row[VESSEL]
    begin.speed = draw_boat(words, begin.load, law, begin.factors[:], flat, scratch)
    begin.shaft_speed = law.shafts[0]
    if not math.isnan(spans[_CURRENT, 0]):
        speed = _within(spans[_CURRENT], u[_CURRENT])
        to = math.radians(_within(spans[_CURRENT_TO], u[_CURRENT_TO]))
        begin.current_north, begin.current_east = speed * math.cos(to), speed * math.sin(to)
    if not math.isnan(spans[_WIND_FROM, 0]):
        begin.wind_from = math.radians(_within(spans[_WIND_FROM], u[_WIND_FROM]) % 360.0)
    heading = math.radians(_within(spans[_HEADING], u[_HEADING]))
    begin.heading = (heading + math.pi) % (2.0 * math.pi) - math.pi if heading != 0.0 else 0.0
    return begin.speed


@inlined
def note_drawn(boat, begin, sea, drawn):
    """Write the numbers (7,) of :data:`DRAWN` of one boat."""
    drawn[0], drawn[1], drawn[2] = begin.load, sea.hs, sea.wind
    wind_from = sea.wind_from if math.isnan(begin.wind_from) else begin.wind_from
    drawn[3] = math.degrees(wind_from) % 360.0
    north, east = boat.weather.current_north, boat.weather.current_east
    drawn[4], drawn[5] = math.hypot(north, east), math.degrees(math.atan2(east, north)) % 360.0
    drawn[6] = math.degrees(begin.heading) % 360.0


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
    kinds : tuple of BoatClass
        Kinds of boats.
    active : bool
        Whether anything is drawn or changed here; if not, :meth:`draw` is not called.
    numbers : ndarray, shape (n, 7)
        Those of :data:`DRAWN`.
    names : dict of str to ndarray
        What else stands in ``info["drawn"]``, an array (n,) of objects for each key.
    """

    def __init__(self, n: int, config: EnvConfig, vessels: Sequence[Vessel]) -> None:
        spread = config.vessel_spread
        self.kinds = tuple(BoatClass(one, spread, sides=spread / 3.0) for one in vessels)
        wind_from, load, heading = config.wind_span(), config.load_span(), config.heading_span()
        current = config.current_spans()
        self._varies = spread > 0.0 or load != (1.0, 1.0)
        self.active = bool(
            self._varies
            or heading != (0.0, 0.0)
            or len(vessels) > 1
            or not (wind_from is None and current is None)
        )
        spans = _UNDRAWN, load, wind_from or _UNDRAWN, *(current or (_UNDRAWN,) * 2), heading
        self._spans, self._scratch = np.array(spans), scratch_of_draws()
        self._laws = np.stack([kind.law for kind in self.kinds])
        self.numbers = np.zeros((n, len(DRAWN)))
        self.names: dict[str, np.ndarray] = {
            "vessel": np.full(n, vessels[0].name, dtype=object),
            "vessel_factors": np.empty(n, dtype=object),
            "faults": np.full(n, "none", dtype=object),
        }
        same = Factors(*[1.0] * len(FACTORS))
        for i in range(n):
            self.names["vessel_factors"][i] = same

    def drawn(self, i: int) -> dict[str, Any]:
        """Return ``info["drawn"]`` of boat i."""
        numbers = zip(DRAWN, self.numbers[i].tolist(), strict=True)
        return {**{key: values[i] for key, values in self.names.items()}, **dict(numbers)}

    def draw(self, words: np.ndarray, i: int, simulation: Simulation) -> int:
        """Draw the next episode of boat i, and return which kind of boat it has.

        ``words`` (4,) start its generator, which is used up. VesselError: no boat could be drawn.
        """
        row, world = simulation.rows[i], simulation.world_rows[i]
        speed = _draw(words, self._spans, self._laws, row, world, self._scratch)
        kind = int(world[_KIND_AT])
        if not speed > 0.0:
            raise self.kinds[kind].refusal(speed, world[_LOAD_AT].item())
        self.names["vessel"][i] = self.kinds[kind].vessel.name
        if self._varies:
            self.names["vessel_factors"][i] = Factors(*world[_FACTORS].tolist())
        return kind

    def note_faults(self, i: int, simulation: Simulation) -> None:
        """Remember which faults the episode of boat i has."""
        number, start = simulation.world_rows[i, _FAULTS].tolist()
        self.names["faults"][i] = simulation.fault_sets.text(int(number), start)


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


def faults_of(config: EnvConfig) -> FaultSets:
    """Return the sets of faults of which each episode has one."""
    faults = config.faults
    if isinstance(faults, str):
        texts = faults.split("|")
        named = [parse_faults(one, 0.0) for one in texts]
        _warn_of([fault for one in named for fault in one], config)
        later = [parse_faults(one, 1.0) for one in texts]
        moving = [
            [fault != moved for fault, moved in zip(*both, strict=True)]
            for both in zip(named, later, strict=True)
        ]
        return FaultSets(named, moving, FAULT_START)
    items = list(faults) if isinstance(faults, Sequence) else [faults]
    items = [fault_of_table(one) if isinstance(one, Mapping) else one for one in items]
    given = [fault for fault in items if isinstance(fault, Disturbance)]
    if len(given) < len(items):
        raise FaultError(
            f"faults = {faults!r}: give a text such as 'gps10', or a list of "
            "usv_gym.Fault(kind, start, duration)"
        )
    _warn_of(given, config)
    return FaultSets([given])


def _warn_of(faults: Sequence[Disturbance], config: EnvConfig) -> None:
    """Warn of a fault that changes nothing."""
    anemometer = SensorSuite.of(config.suite).has_anemometer
    if (found := ineffective_fault(faults, config.dof, anemometer)) is not None:
        warnings.warn(found, FaultWarning, stacklevel=4)
