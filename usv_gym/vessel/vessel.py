"""A vessel: its numbers, their layout for the kernels, and other boats of its kind."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from usv_gym.hydro.motions import equivalent_loads, natural_values
from usv_gym.hydro.netcdf import read_table
from usv_gym.hydro.table import HydroError, HydroTable
from usv_gym.physics import frames as fr
from usv_gym.physics import parameters as par
from usv_gym.physics import ship
from usv_gym.physics.hull import hull_forces
from usv_gym.physics.propulsion import propulsion_forces
from usv_gym.vessel.schema import (
    DAMPING,
    HULL_TERMS,
    KIND_SCHEMA,
    ZETA_ROLL_VISCOUS,
    VesselError,
    check_kind,
    check_resistance,
    check_values,
)
from usv_gym.vessel.variation import (
    FACTORS,
    FIXED,
    NO_SPEED,
    SHAFT_SPEEDS,
    SIDES_AT,
    TRIES,
    draw,
    law_of,
)
from usv_gym.vessel.vessel_file import read_vessel, vessel_names
from usv_kernel.records import Record
from usv_kernel.servos import Servos

__all__ = [
    "KIND_SCHEMA",
    "BoatClass",
    "DrawnBoat",
    "Vessel",
    "VesselError",
    "course_eigenvalues",
    "jacobian",
    "state_at",
    "vessel_names",
]

# what the kernels read for a key that the vessel does not have
_DEFAULTS = {
    **{key: 0.0 for keys in KIND_SCHEMA.values() for key in keys},
    **{key: 0.0 for key in (*HULL_TERMS, "C_d_crossflow", *DAMPING)},
    "steer_lag": 1.0,
    "rudder_height": 1.0,
}

FULL_HELM = math.radians(30.0)
"""Helm angle at which a thruster pair gives all thrust with one thruster, rad."""

TWO_HULLS = 0.5
"""Water-plane coefficient below which a vessel counts as a catamaran."""


@dataclass(frozen=True, kw_only=True)
class Vessel:
    """A ship with one or two propulsion units.

    Parameters
    ----------
    name, title : str
        Short name, and a description in one line.
    kind : str
        Kind of propulsion, a key of :data:`KIND_SCHEMA`.
    values : Mapping[str, float]
        Numbers of :data:`~usv_gym.vessel.schema.SCHEMA`, SI units; missing hull terms are 0.
    resistance_speed, resistance_force : tuple of float
        Points of the resistance curve, m/s and N, from (0, 0) on; empty if R_0, D_u and D_uu
        give the resistance.
    guesses : frozenset of str
        Keys that the file marks as estimates.
    hydro : HydroTable, optional
        Hydrodynamic table of the hull, see :meth:`with_table`.
    stated : Mapping[str, float]
        With a table: the numbers that the vessel had without it.
    design : str
        Vessel of the package that this one is, or was drawn from by :meth:`varied`. Empty for
        any other file, whatever its name.
    outputs : Servos, optional
        Servo outputs of an autopilot that steer it, see :attr:`servos`.
    side_thrust : tuple of float
        Thrust of the left and right unit over the nominal one, less 1: no two sides are alike.
    """

    name: str
    title: str
    kind: str
    values: Mapping[str, float]
    resistance_speed: tuple[float, ...] = ()
    resistance_force: tuple[float, ...] = ()
    guesses: frozenset[str] = field(default=frozenset())
    hydro: HydroTable | None = None
    stated: Mapping[str, float] = field(default_factory=dict)
    design: str = ""
    outputs: Servos | None = None
    side_thrust: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("values", "stated"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        check_values(check_kind(self.kind), self.values)
        check_resistance(self.values, self.resistance_speed, self.resistance_force)

    # a mapping proxy cannot be pickled, and parallel workers need the vessel
    def __reduce__(self) -> tuple[Any, ...]:
        fields = {item.name: getattr(self, item.name) for item in dataclasses.fields(self)}
        return _rebuild, (fields | {key: dict(fields[key]) for key in ("values", "stated")},)

    def __getattr__(self, key: str) -> float:
        values = self.__dict__.get("values", {})
        if key in values:
            return values[key]
        raise AttributeError(f"vessel has no {key!r}")

    @classmethod
    def load(cls, source: str | Path | Vessel) -> Vessel:
        """Return a vessel of the package by its name, or from a file.

        Parameters
        ----------
        source : str or Path or Vessel
            Name (see :func:`vessel_names`), path of a TOML file, or a vessel.

        Returns
        -------
        Vessel

        Raises
        ------
        VesselError
            Names the file, the key and the remedy.
        """
        if isinstance(source, Vessel):
            return source
        if not isinstance(source, (str, Path)):
            raise VesselError(f"vessel = {source!r}: give a name, the path of a file, or a Vessel")
        fields = read_vessel(source)
        hydro = fields.pop("hydro")
        try:
            vessel = cls(**fields)
            return vessel if hydro is None else vessel.with_table(read_table(hydro))
        except (VesselError, HydroError) as error:
            raise VesselError(f"{source}: {error}") from None

    def with_table(self, table: HydroTable) -> Vessel:
        """Return the vessel with a hydrodynamic table, which replaces the numbers that it gives.

        They are the keys of :func:`usv_gym.hydro.motions.natural_values`, in place of the file's
        own, which stay in ``stated``. VesselError: the table does not reach a natural frequency, or
        is of water of another density by more than 5 %.
        """
        stated = self.stated or self.values
        density = stated["water_density"] / table.density
        if not 0.95 < density < 1.05:
            raise VesselError(
                f"[vessel] hydro: the table is of water of {table.density:g} kg/m3, but "
                f"water_density is {stated['water_density']:g} kg/m3"
            )
        values = {"zeta_roll_viscous": ZETA_ROLL_VISCOUS, **stated}
        try:
            found = natural_values(table, values)
        except HydroError as error:
            raise VesselError(f"[vessel] hydro: {error}") from None
        return dataclasses.replace(self, values=values | found, hydro=table, stated=stated)

    def without_table(self) -> Vessel:
        """Return the vessel with the numbers of its file alone, in waves a box of its size.

        One of :meth:`varied` keeps its factors of the others.
        """
        if self.hydro is None:
            return self
        nominal = self._nominal
        values = {
            key: v if self.values[key] == nominal[key] else self.values[key] / nominal[key] * v
            for key, v in self.stated.items()
        }
        return dataclasses.replace(self, values=values, hydro=None, stated={})

    @cached_property
    def _nominal(self) -> dict[str, float]:
        """Numbers that a vessel with a table had when it was read."""
        if self.hydro is None:
            return dict(self.values)
        nominal = {"zeta_roll_viscous": ZETA_ROLL_VISCOUS, **self.stated}
        return nominal | natural_values(self.hydro, nominal)

    @cached_property
    def loads(self) -> NDArray[np.complex128] | None:
        """Loads in waves on the ship in time, see :func:`~usv_gym.hydro.motions.equivalent_loads`.

        Shape (F, 2 (H - 1), 6), over the frequencies and all headings of the table; None without.
        """
        if self.hydro is None:
            return None
        return equivalent_loads(self.hydro, self.values, self._nominal)

    @cached_property
    def packed(self) -> Record:
        """Record for the kernels; fields in ``physics.parameters``. Copy it before a change."""
        record = np.zeros(1, par.PARAMETERS)[0]
        values = {**_DEFAULTS, **self.values, "kind": par.KINDS.index(self.kind)}
        for key in par.SCALARS:
            record[key] = values[key]
        for key in ("resistance_speed", "resistance_force"):
            points = getattr(self, key)
            if points:
                record[key] = points[-1]
                record[key][: len(points)] = points
        record["side_thrust"] = self.side_thrust
        return record

    @property
    def two_hulls(self) -> bool:
        """Whether it is a catamaran: its file says so, or its water plane."""
        v = self.values
        plane = self.stated.get("A_wp", v["A_wp"])
        return "hull_beam" in v or plane < TWO_HULLS * v["length_waterline"] * v["beam"]

    @property
    def helm_max(self) -> float:
        """Largest helm angle, rad."""
        return self.values.get("steer_max", FULL_HELM)

    @property
    def servos(self) -> Servos:
        """Servo outputs of an autopilot; by default those of ArduPilot's Rover.

        Full throttle is the greatest shaft speed of a thruster pair, else that in service.
        """
        if self.outputs is not None:
            return self.outputs
        if self.kind == "thruster_pair":
            shaft = self.values["shaft_speed_max"]
            return Servos(shaft_speed=shaft, angle=1.0, left=1, right=3, steering=0)
        return Servos(shaft_speed=self.values["shaft_speed_service"], angle=self.helm_max)

    @cached_property
    def mixing(self) -> np.ndarray:
        """Commands per full throttle and full helm, shape (4, 2)."""
        if self.kind == "thruster_pair":
            return np.array([[1.0, 1.0], [1.0, -1.0], [0.0, 0.0], [0.0, 0.0]])
        return np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0]])

    @cached_property
    def actuators(self) -> np.ndarray:
        """Commands per full command of each actuator, shape (4, actuators)."""
        if self.kind == "thruster_pair":
            return np.eye(4)[:, :2]
        return np.eye(4) if self.values["units"] == 2.0 else self.mixing

    def command(self, n: np.ndarray | float, angle: np.ndarray | float) -> np.ndarray:
        """Return the command (..., 4), rev/s and rad, for a shaft speed and a helm angle.

        The angle is above 0 to starboard. A thruster pair shifts thrust from one thruster to the
        other instead; at 30 degrees one stops. VesselError: numbers that are not finite, or an
        angle beyond 90 degrees.
        """
        n, angle = np.broadcast_arrays(np.asarray(n, float), np.asarray(angle, float))
        if not (np.all(np.isfinite(n)) and np.all(np.abs(angle) <= 0.5 * math.pi)):
            raise VesselError(
                f"command(n={n}, angle={angle}): must be finite, and the angle in rad, within 90 "
                "degrees (math.radians turns degrees into rad)"
            )
        if self.kind == "thruster_pair":
            share = angle / FULL_HELM
            left, right = (np.copysign(np.sqrt(np.abs(x)), x) for x in (1.0 + share, 1.0 - share))
            still = np.zeros_like(n)
            return np.stack([n * left, n * right, still, still], axis=-1)
        return np.stack([n, n, angle, angle], axis=-1)

    def straight_speed(self, n: float) -> float:
        """Return the steady speed (m/s) straight ahead in calm water.

        ``n`` is the speed of all shafts, rev/s, 0 or more. VesselError: thrust and resistance
        balance at no speed.
        """
        if n <= 0.0:
            return 0.0
        state = np.zeros(fr.STATE_SIZE)
        state[fr.N_LEFT] = state[fr.N_RIGHT] = n
        p = self.packed.copy()  # kernels are compiled for writable arrays

        def surplus(u: float) -> float:
            return propulsion_forces(u, 0.0, 0.0, state, p)[0] + hull_forces(u, 0.0, 0.0, p)[0]

        top = 4.0 * n * self.values["propeller_diameter"] + 1.0
        while surplus(top) > 0.0 and top < 200.0:
            top *= 2.0
        if not surplus(0.0) > 0.0 > surplus(top):
            raise VesselError(
                f"{self.name}: [propulsion] k_0, k_1, k_2: at {n:g} rev/s the propellers do not "
                "balance the resistance at any speed. K_T must be above 0 at rest and fall with J, "
                "and resistance (R_0, D_u, D_uu or its curve) must grow with speed"
            )
        return _root(surplus, 0.0, top, xtol=1e-9)

    def shaft_speed_for(self, speed: float) -> float:
        """Return the shaft speed (rev/s) for a speed (m/s) straight ahead in calm water."""
        if speed <= 0.0:
            return 0.0
        top = 1.0
        while self.straight_speed(top) < speed:
            top *= 2.0
        return _root(lambda n: self.straight_speed(n) - speed, 0.0, top, xtol=1e-10)

    def varied(
        self, rng: np.random.Generator, spread: float = 0.15, built: float | None = None
    ) -> Vessel:
        """Return a random boat of the same kind; equal states of ``rng`` give equal boats.

        Coefficients of forces and added masses are multiplied by 1 + ``spread`` times a normal
        number, geometry and inertia by 1 + ``built`` (default ``spread / 3``) times one. Factors
        are limited to 0.1 to 1.9. The resistance curve gets one factor for its forces and one (as
        geometry) for its speeds. The length overall follows the length, the water plane length and
        beam. Actuators, shaft speeds and name stay.

        A boat is drawn again if it breaks the schema, or is course-unstable (or more so than this
        vessel, if that is unstable). It is also drawn again if its speed at the manoeuvring shaft
        speed differs by more than a factor of 4/3. VesselError: a spread is negative or infinite,
        or no boat could be drawn.

        Source: docs/explanation/ship_and_sea.md, Vessels.
        """
        return BoatClass(self, spread, built).draw(rng).vessel


def state_at(vessel: Vessel, n: float, speed: float) -> np.ndarray:
    """Return the state (16,) of a vessel that goes straight ahead at a speed (m/s)."""
    state = np.zeros(fr.STATE_SIZE)
    state[fr.U] = speed
    state[fr.N_LEFT :] = vessel.command(n, 0.0)
    return state


def jacobian(vessel: Vessel, state: np.ndarray, rows: list[int], dof: int = 6) -> np.ndarray:
    """Return the Jacobian of the state derivative in calm water, with constant commands.

    It is that of the ``rows`` of the state by themselves, by central differences.
    """
    still, calm, air = ship.Ship(vessel.packed, dof), ship.calm_sea(), ship.Air(0.0, 0.0, 1.0)
    cmd, out, h = state[fr.N_LEFT :].copy(), np.zeros(fr.STATE_SIZE), 1e-6
    slopes = np.empty((len(rows), len(rows)))
    for j, row in enumerate(rows):
        for sign in (1.0, -1.0):
            trial = state.copy()
            trial[row] += sign * h
            ship.derivative(trial, cmd, still, calm, air, 0.0, out)
            slopes[:, j] = out[rows] if sign > 0.0 else (slopes[:, j] - out[rows]) / (2.0 * h)
    return slopes


def course_eigenvalues(vessel: Vessel, n: float) -> tuple[complex, complex]:
    """Return the two eigenvalues of drift and turning on a straight course, 1/s.

    The less stable one is first; the vessel is course-stable if its real part is below 0.
    """
    state = state_at(vessel, n, vessel.straight_speed(n))
    values = np.linalg.eigvals(jacobian(vessel, state, [fr.V, fr.R], dof=3))
    first, second = sorted((complex(value) for value in values), key=lambda z: -z.real)
    return first, second


def _rebuild(fields: dict[str, Any]) -> Vessel:
    return Vessel(**fields)


def _root(f: Callable[[float], float], a: float, b: float, xtol: float) -> float:
    """Return the root of f between a and b by Brent's method."""
    from scipy.optimize import brentq  # a third of a second

    return float(brentq(f, a, b, xtol=xtol))


class DrawnBoat(NamedTuple):
    """A boat of a kind."""

    vessel: Vessel
    factors: NDArray[np.float64]
    """Of :data:`FACTORS`: each number over that of the nominal vessel; 1 where that has none."""
    speed: float
    """Steady speed at the manoeuvring shaft speed in calm water, m/s."""


class BoatClass:
    """Boats like one vessel; see :meth:`Vessel.varied` for how they differ.

    Parameters
    ----------
    vessel : Vessel
        The nominal boat.
    spread, built : float
        Standard deviations of the factors of coefficients, and of geometry and inertia (a third of
        the former if left out).
    sides : float
        Standard deviation of the factor of each side's thrust, with two propulsion units.

    Attributes
    ----------
    law : ndarray
        Flat memory of :data:`~usv_gym.vessel.variation.LAW`, for kernels.

    Raises
    ------
    VesselError
        A standard deviation is negative or infinite.
    """

    def __init__(
        self, vessel: Vessel, spread: float, built: float | None = None, sides: float = 0.0
    ) -> None:
        built = spread / 3.0 if built is None else built
        if not (math.isfinite(spread + built + sides) and min(spread, built, sides) >= 0.0):
            raise VesselError(
                f"varied(spread={spread}, built={built}): must be finite numbers, 0 or more"
            )
        self.vessel, self.spread, self.built = vessel, spread, built
        self.shaft_speed = vessel.values[SHAFT_SPEEDS[0]]
        self.speed = vessel.straight_speed(self.shaft_speed)
        flat = np.array([vessel.packed]).view(np.float64).copy()
        self.law = law_of(vessel.values, flat, self.speed, spread, built, sides)
        self._nominal = np.array(list(vessel.values.values()))
        same = {"hull_beam": "beam", "spacing": "beam", "zeta_roll_viscous": "zeta_roll"}
        # what kernels do not read stays as it is: the kind stands for a factor of 1
        self._places = np.array(
            [
                par.SCALARS.index("kind" if key in FIXED else same.get(key, key))
                for key in vessel.values
            ]
        )
        self._fields = {
            item.name: getattr(vessel, item.name) for item in dataclasses.fields(vessel)
        }
        self._resistance = np.array([vessel.resistance_speed, vessel.resistance_force])

    def draw(self, rng: np.random.Generator, load: float = 1.0) -> DrawnBoat:
        """Return a boat; equal states of ``rng`` give equal boats.

        ``load`` multiplies mass, moments of inertia, added masses and draft of what was drawn.
        VesselError: no boat could be drawn.
        """
        speed, factors, flat = draw(rng, float(load), self.law)
        if not speed > 0.0:
            raise self.refusal(speed, load)
        return DrawnBoat(self.boat(factors, flat), factors, speed)

    def refusal(self, speed: float, load: float) -> VesselError:
        """Return the error of what :func:`draw` gives in place of a speed."""
        if speed == NO_SPEED:
            return VesselError(f"{self.vessel.name}: a load of {load:g} leaves it no speed")
        return VesselError(
            f"{self.vessel.name}: none of {TRIES} boats drawn with spread = {self.spread:g}, "
            f"built = {self.built:g} holds speed and course; use smaller spreads"
        )

    def boat(self, factors: NDArray[np.float64], flat: NDArray[np.float64]) -> Vessel:
        """Return the vessel of drawn factors and flat parameters, which need no other check."""
        if (factors == 1.0).all():
            return self.vessel
        force, speed = (factors[FACTORS.index(f"resistance_{of}")] for of in ("force", "speed"))
        values = (factors[self._places] * self._nominal).tolist()
        changed: dict[str, Any] = {
            "values": MappingProxyType(dict(zip(self.vessel.values, values, strict=True))),
            "resistance_speed": tuple((speed * self._resistance[0]).tolist()),
            "resistance_force": tuple((force * self._resistance[1]).tolist()),
            "side_thrust": tuple(flat[SIDES_AT].tolist()),
            "packed": flat.copy().view(par.PARAMETERS)[0],
        }
        vessel = object.__new__(type(self.vessel))
        vessel.__dict__.update(self._fields, **changed)
        return vessel
