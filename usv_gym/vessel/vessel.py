"""A vessel: read from TOML, checked, and packed for the kernels."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from usv_gym.physics import KNOT, ship
from usv_gym.physics import frames as fr
from usv_gym.physics import parameters as par
from usv_gym.physics.hull import hull_forces
from usv_gym.physics.propulsion import propulsion_forces
from usv_kernel.errors import UsvTwinError
from usv_kernel.records import Record

__all__ = [
    "Vessel",
    "VesselError",
    "course_eigenvalues",
    "jacobian",
    "state_at",
    "vessel_names",
]

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

UNITS: dict[str, dict[str, float]] = {
    "m": {"m": 1.0, "mm": 1e-3},
    "m2": {"m2": 1.0},
    "kg": {"kg": 1.0, "t": 1e3},
    "kg m2": {"kg m2": 1.0},
    "kg/m3": {"kg/m3": 1.0},
    "m/s": {"m/s": 1.0, "kn": KNOT},
    "N": {"N": 1.0, "kN": 1e3},
    "s": {"s": 1.0},
    "rev/s": {"rev/s": 1.0, "rpm": 1.0 / 60.0},
    "rev/s2": {"rev/s2": 1.0, "rpm/s": 1.0 / 60.0},
    "kg/s": {"kg/s": 1.0},
    "kg/m": {"kg/m": 1.0},
    "kg m2/s": {"kg m2/s": 1.0},
    "kg m2 s": {"kg m2 s": 1.0},
    "rad": {"rad": 1.0, "deg": math.pi / 180.0},
    "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180.0},
    "1/rad": {"1/rad": 1.0, "1/deg": 180.0 / math.pi},
    "1": {"1": 1.0},
}
"""For each SI unit, the units that a file may use and their factors."""

_HULL = (
    *("R_0", "X_vv", "X_vr", "X_rr", "X_vvvv"),
    *("Y_v", "Y_r", "Y_vvv", "Y_vvr", "Y_vrr", "Y_rrr"),
    *("N_v", "N_r", "N_vvv", "N_vvr", "N_vrr", "N_rrr"),
)

_DAMPING = {
    "D_u": ("kg/s", "0"),
    "D_uu": ("kg/m", "0"),
    "D_v": ("kg/s", "0"),
    "D_vv": ("kg/m", "0"),
    "D_r": ("kg m2/s", "0"),
    "D_rr": ("kg m2", "0"),
    "D_rrr": ("kg m2 s", "0"),
}

# table -> key -> (SI unit, bound): "+" above 0, "0" 0 or more, "" any
SCHEMA: dict[str, dict[str, tuple[str, str]]] = {
    "particulars": {
        "length_overall": ("m", "+"),
        "length_waterline": ("m", "+"),
        "beam": ("m", "+"),
        "draft": ("m", "+"),
        "block_coefficient": ("1", "+"),
        "water_density": ("kg/m3", "+"),
        "mass": ("kg", "+"),
        "x_G": ("m", ""),
        "KG": ("m", "+"),
        "I_xx": ("kg m2", "+"),
        "I_yy": ("kg m2", "+"),
        "I_zz": ("kg m2", "+"),
        "m_x": ("kg", "0"),
        "m_y": ("kg", "0"),
        "J_zz": ("kg m2", "0"),
    },
    "seakeeping": {
        "A_wp": ("m2", "+"),
        "x_F": ("m", ""),
        "GM_T": ("m", "+"),
        "GM_L": ("m", "+"),
        "m_z": ("kg", "0"),
        "J_xx": ("kg m2", "0"),
        "J_yy": ("kg m2", "0"),
        "zeta_heave": ("1", "0"),
        "zeta_roll": ("1", "0"),
        "zeta_pitch": ("1", "0"),
        "z_H": ("m", ""),
    },
    "hull": {**{key: ("1", "") for key in _HULL}, "C_d_crossflow": ("1", "0"), **_DAMPING},
    "propulsion": {
        "units": ("1", "+"),
        "propeller_diameter": ("m", "+"),
        "k_0": ("1", "+"),
        "k_1": ("1", ""),
        "k_2": ("1", ""),
        "astern": ("1", "0"),
        "wake_fraction": ("1", ""),
        "thrust_deduction": ("1", ""),
        "y_P": ("m", "0"),
        "z_P": ("m", ""),
        "shaft_lag": ("s", "+"),
        "shaft_rate": ("rev/s2", "+"),
        "shaft_speed_max": ("rev/s", "+"),
        "shaft_speed_service": ("rev/s", "+"),
        "shaft_speed_manoeuvring": ("rev/s", "+"),
    },
    "wind": {
        "A_F": ("m2", "+"),
        "A_L": ("m2", "+"),
        "s_L": ("m", ""),
        "s_H": ("m", "0"),
        "kappa_wind": ("1", "0"),
        "CD_t": ("1", "+"),
        "CD_l_bow": ("1", "+"),
        "CD_l_stern": ("1", "+"),
        "delta_wind": ("1", "0"),
    },
}

_STEERED = {
    "steer_lag": ("s", "+"),
    "steer_rate": ("rad/s", "+"),
    "steer_max": ("rad", "+"),
    "A_R": ("m2", "0"),
    "f_alpha": ("1/rad", "0"),
}

# kind of propulsion -> the keys that it adds to [propulsion]
KIND_SCHEMA: dict[str, dict[str, tuple[str, str]]] = {
    "steerable_drive": {**_STEERED, "x_P": ("m", ""), "slipstream": ("1", "0")},
    "propeller_rudder": {
        **_STEERED,
        "rudder_height": ("m", "+"),
        "C_1": ("1", "0"),
        "C_2_plus": ("1", "0"),
        "C_2_minus": ("1", "0"),
        "x_P_prime": ("1", ""),
        "epsilon": ("1", "+"),
        "kappa": ("1", "0"),
        "l_R_prime": ("1", ""),
        "gamma_R_plus": ("1", "0"),
        "gamma_R_minus": ("1", "0"),
        "t_R": ("1", ""),
        "a_H": ("1", "0"),
        "x_H_prime": ("1", ""),
        "x_R_prime": ("1", ""),
    },
    "thruster_pair": {},
}

# what the kernels read of a vessel without the key
_ABSENT = {
    **{key: 0.0 for keys in KIND_SCHEMA.values() for key in keys},
    **{key: 0.0 for key in (*_HULL, "C_d_crossflow", *_DAMPING)},
    "steer_lag": 1.0,
    "rudder_height": 1.0,
}

MESH_FORMATS = (".glb", ".stl", ".obj", ".ply")
"""Kinds of mesh files that a vessel may name."""

FULL_HELM = math.radians(30.0)
"""Helm angle at which a fixed pair of thrusters has moved all thrust to one of them, rad."""

_BUILT = frozenset(
    (
        *("length_waterline", "beam", "draft", "block_coefficient", "mass", "x_G", "KG"),
        *("I_xx", "I_yy", "I_zz", "x_F", "GM_T", "GM_L", "propeller_diameter", "x_P", "y_P"),
        *("z_P", "A_R", "rudder_height", "x_P_prime", "x_R_prime", "A_F", "A_L", "s_L", "s_H"),
    )
)
"""Geometry and inertia: what a yard builds about alike; see :meth:`Vessel.varied`."""

_KEPT = frozenset(
    (
        *("water_density", "units", "shaft_lag", "shaft_rate", "shaft_speed_max"),
        *("shaft_speed_service", "shaft_speed_manoeuvring"),
        *("steer_lag", "steer_rate", "steer_max"),
    )
)
"""The water, and the engines and steering gear that are bought: no boat differs in them."""

TRIES = 1000
"""Boats that :meth:`Vessel.varied` draws at most."""

SAME_WAY = 4.0 / 3.0
"""Boats of a kind differ in speed by this factor at most."""

SHAFT_SPEEDS = ("shaft_speed_manoeuvring", "shaft_speed_service", "shaft_speed_max")


class VesselError(UsvTwinError):
    """A vessel that cannot be used; the message names the file, the key and the remedy."""


def vessel_names() -> tuple[str, ...]:
    """Return the names of the vessels that come with the package."""
    folder = resources.files("usv_gym.vessel") / "vessels"
    return tuple(sorted(p.name[:-5] for p in folder.iterdir() if p.name.endswith(".toml")))


@dataclass(frozen=True, kw_only=True)
class Vessel:
    """A ship with one or two propulsion units.

    Parameters
    ----------
    name, title : str
        Short name, and one line for people.
    kind : str
        Kind of propulsion, a key of :data:`KIND_SCHEMA`.
    values : Mapping[str, float]
        Every number of :data:`SCHEMA` and of the kind, in SI units; terms of the hull may be
        left out and are then 0.
    resistance_speed, resistance_force : tuple of float
        Points of the resistance curve, m/s and N, starting at (0, 0); empty where R_0, D_u
        and D_uu say it all.
    guesses : frozenset of str
        Keys that the file marks as judgement.
    mesh : Path, optional
        Mesh file that replaces the hull and superstructure drawn from the particulars; see
        :mod:`usv_gym.vessel.geometry`. In m, origin amidships on the water line. A .glb file has y up,
        z forward and x to port (glTF); the others have z up, x forward and y to port.
    design : str
        The vessel of the package that this one is, or was drawn from by :meth:`varied`: her
        class. Empty for a file of one's own, whatever its name.
    """

    name: str
    title: str
    kind: str
    values: Mapping[str, float]
    resistance_speed: tuple[float, ...] = ()
    resistance_force: tuple[float, ...] = ()
    guesses: frozenset[str] = field(default=frozenset())
    mesh: Path | None = None
    design: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", MappingProxyType(dict(self.values)))
        object.__setattr__(self, "mesh", None if self.mesh is None else Path(self.mesh))
        self._check()

    # A mapping proxy cannot be pickled, and parallel workers need the vessel.
    def __reduce__(self) -> tuple[Any, ...]:
        fields = {item.name: getattr(self, item.name) for item in dataclasses.fields(self)}
        return _rebuild, ({**fields, "values": dict(self.values)},)

    def __getattr__(self, key: str) -> float:
        values = self.__dict__.get("values", {})
        if key in values:
            return values[key]
        raise AttributeError(f"vessel has no {key!r}")

    @classmethod
    def load(cls, source: str | Path | Vessel) -> Vessel:
        """Return a vessel by the name of one that comes with the package, or from a file.

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
        path, design = Path(source), ""
        if str(source) in vessel_names():
            design = str(source)
            path = Path(str(resources.files("usv_gym.vessel") / "vessels" / f"{source}.toml"))
        elif path.suffix != ".toml":
            raise VesselError(
                f"no vessel is called {str(source)!r}; known: {', '.join(vessel_names())}, "
                "or give the path of a .toml file"
            )
        try:
            table = tomllib.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise VesselError(f"{path}: cannot be read ({error.strerror})") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise VesselError(f"{path}: is not valid TOML: {error}") from None
        try:
            return cls._from_table(table, path, design)
        except VesselError as error:
            raise VesselError(f"{path}: {error}") from None

    @classmethod
    def _from_table(cls, table: dict[str, Any], path: Path, design: str) -> Vessel:
        known = {"vessel", *SCHEMA}
        for name in table:
            if name not in known:
                raise VesselError(f"unknown table [{name}]; known: {', '.join(sorted(known))}")
        about = table.get("vessel", {})
        if not isinstance(about, dict):
            raise VesselError("[vessel] must be a table")
        for key, value in about.items():
            if key not in ("name", "title", "mesh") or not isinstance(value, str):
                raise VesselError(f"[vessel] {key}: unknown key; known: name, title, mesh (texts)")
        mesh = (path.parent / about["mesh"]).resolve() if "mesh" in about else None
        if mesh is not None and not mesh.is_file():
            raise VesselError(
                f"[vessel] mesh: there is no file {mesh}; give its path from this file's folder"
            )
        values: dict[str, float] = {}
        guesses = set()
        curve: dict[str, tuple[float, ...]] = {"speed": (), "force": ()}
        kind = ""
        for name, keys in SCHEMA.items():
            if not isinstance(table.get(name), dict):
                raise VesselError(f"the table [{name}] is missing")
            given = dict(table[name])
            if name == "propulsion":
                kind = _kind(given.pop("kind", None))
                keys = {**keys, **KIND_SCHEMA[kind]}
            if name == "hull" and "resistance" in given:
                points = given.pop("resistance")
                if not isinstance(points, dict) or set(points) != {"speed", "force"}:
                    raise VesselError("[hull.resistance] must hold speed and force, nothing else")
                for key, unit in (("speed", "m/s"), ("force", "N")):
                    curve[key], guess = _numbers(points[key], unit, f"[hull.resistance] {key}")
                    if guess:
                        guesses.add(f"resistance_{key}")
            for key in given:
                if key not in keys:
                    of = f" of a {kind}" if name == "propulsion" else ""
                    raise VesselError(f"[{name}] {key}: unknown key{of}; known: {', '.join(keys)}")
            for key, (unit, _) in keys.items():
                if key not in given:
                    if name == "hull":
                        continue
                    raise VesselError(f"[{name}] {key}: is missing (a number in {unit})")
                numbers, guess = _numbers(given[key], unit, f"[{name}] {key}", scalar=True)
                values[key] = numbers[0]
                if guess:
                    guesses.add(key)
        return cls(
            name=about.get("name", path.stem),
            title=about.get("title", path.stem),
            kind=kind,
            values=values,
            resistance_speed=curve["speed"],
            resistance_force=curve["force"],
            guesses=frozenset(guesses),
            mesh=mesh,
            design=design,
        )

    def _check(self) -> None:
        schema = {name: dict(keys) for name, keys in SCHEMA.items()}
        schema["propulsion"].update(KIND_SCHEMA[_kind(self.kind)])
        for name, keys in schema.items():
            for key, (unit, bound) in keys.items():
                if name == "hull" and key not in self.values:
                    continue
                value = self.values.get(key, math.nan)
                if not math.isfinite(value):
                    raise VesselError(f"[{name}] {key}: must be a finite number, got {value}")
                if (bound == "+" and value <= 0.0) or (bound == "0" and value < 0.0):
                    rule = "above 0" if bound == "+" else "0 or more"
                    raise VesselError(f"[{name}] {key}: must be {rule}, got {value:g} {unit}")
        unknown = set(self.values) - {key for keys in schema.values() for key in keys}
        if unknown:
            raise VesselError(f"unknown value(s): {', '.join(sorted(unknown))}")
        self._check_resistance()
        self._check_mesh()
        v = self.values
        displaced = (v["block_coefficient"] * v["length_waterline"] * v["beam"] * v["draft"]) * v[
            "water_density"
        ]
        if not 0.8 < displaced / v["mass"] < 1.25:
            raise VesselError(
                f"[particulars] mass: {v['mass']:g} kg, but block coefficient, length, beam and "
                f"draft displace {displaced:.4g} kg; they must agree within 20 %"
            )
        for key in ("wake_fraction", "thrust_deduction"):
            if v[key] >= 1.0:
                raise VesselError(f"[propulsion] {key}: must be below 1, got {v[key]:g}")
        if self.kind == "steerable_drive" and v["x_P"] >= 0.0:
            raise VesselError("[propulsion] x_P: the drives must be aft (x_P below 0)")
        if v["units"] not in (1.0, 2.0):
            raise VesselError(f"[propulsion] units: must be 1 or 2, got {v['units']:g}")
        if self.kind == "thruster_pair" and (v["units"] != 2.0 or v["y_P"] == 0.0):
            raise VesselError(
                "[propulsion] a thruster_pair steers by unequal thrust: units must be 2 and y_P "
                "above 0"
            )

    def _check_mesh(self) -> None:
        if self.mesh is None:
            return
        if self.mesh.suffix.lower() not in MESH_FORMATS:
            raise VesselError(
                f"[vessel] mesh: {self.mesh} must be a file of {', '.join(MESH_FORMATS)}"
            )

    def _check_resistance(self) -> None:
        speed, force = self.resistance_speed, self.resistance_force
        if not speed and not force:
            if not any(self.values.get(key, 0.0) > 0.0 for key in ("R_0", "D_u", "D_uu")):
                raise VesselError("[hull] needs a resistance curve, or one of R_0, D_u, D_uu")
            return
        if len(speed) != len(force) or not 3 <= len(speed) <= par.RESISTANCE_POINTS:
            raise VesselError(
                "[hull.resistance] speed and force need equally many points, 3 to "
                f"{par.RESISTANCE_POINTS}; got {len(speed)} and {len(force)}"
            )
        if not np.isfinite([*speed, *force]).all():
            raise VesselError("[hull.resistance] speed and force must be finite numbers")
        if speed[0] != 0.0 or force[0] != 0.0 or min(np.diff(speed)) <= 0.0 or min(force) < 0.0:
            raise VesselError(
                "[hull.resistance] must start at speed 0, force 0; speeds must rise and forces "
                "must not be negative"
            )

    @cached_property
    def packed(self) -> Record:
        """Record for the kernels; fields in ``physics.parameters``. Copy it before a change."""
        record = np.zeros(1, par.PARAMETERS)[0]
        values = {**_ABSENT, **self.values, "kind": par.KINDS.index(self.kind)}
        for key in par.SCALARS:
            record[key] = values[key]
        for key in ("resistance_speed", "resistance_force"):
            points = getattr(self, key)
            if points:
                record[key] = points[-1]
                record[key][: len(points)] = points
        return record

    @property
    def helm_max(self) -> float:
        """Largest helm angle, rad."""
        return self.values.get("steer_max", FULL_HELM)

    @cached_property
    def mixing(self) -> np.ndarray:
        """Shares of full throttle and full helm in each command, shape (4, 2)."""
        if self.kind == "thruster_pair":
            return np.array([[1.0, 1.0], [1.0, -1.0], [0.0, 0.0], [0.0, 0.0]])
        return np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0]])

    @cached_property
    def actuators(self) -> np.ndarray:
        """Share of each actuator's full command in each command, shape (4, actuators)."""
        if self.kind == "thruster_pair":
            return np.eye(4)[:, :2]
        return np.eye(4) if self.values["units"] == 2.0 else self.mixing

    def helm(self, n: np.ndarray | float, angle: np.ndarray | float) -> np.ndarray:
        """Return the command for a shaft speed and a helm angle.

        Parameters
        ----------
        n : float or ndarray, shape (...)
            Shaft speed, rev/s.
        angle : float or ndarray, shape (...)
            Helm angle, rad, above 0 to starboard: that of drives or rudders. A fixed pair of
            thrusters moves thrust from one to the other; at 30 degrees one stops.

        Returns
        -------
        ndarray, shape (..., 4)
            Left and right shaft speed (rev/s), left and right angle (rad).

        Raises
        ------
        VesselError
            For what is no number, or an angle beyond 90 degrees.
        """
        n, angle = np.broadcast_arrays(np.asarray(n, float), np.asarray(angle, float))
        if not (np.all(np.isfinite(n)) and np.all(np.abs(angle) <= 0.5 * math.pi)):
            raise VesselError(
                f"helm(n={n}, angle={angle}): must be finite, and the angle in rad, within 90 "
                "degrees (math.radians turns degrees into rad)"
            )
        if self.kind == "thruster_pair":
            share = angle / FULL_HELM
            left, right = (np.copysign(np.sqrt(np.abs(x)), x) for x in (1.0 + share, 1.0 - share))
            still = np.zeros_like(n)
            return np.stack([n * left, n * right, still, still], axis=-1)
        return np.stack([n, n, angle, angle], axis=-1)

    def straight_speed(self, n: float) -> float:
        """Return the speed in calm water, in m/s, with both shafts at n.

        Parameters
        ----------
        n : float
            Shaft speed, rev/s; 0 or more.
        """
        if n <= 0.0:
            return 0.0
        state = np.zeros(fr.STATE_SIZE)
        state[fr.N_LEFT] = state[fr.N_RIGHT] = n
        p = self.packed.copy()  # kernels are compiled for arrays that can be written to

        def surplus(u: float) -> float:
            return propulsion_forces(u, 0.0, 0.0, state, p)[0] + hull_forces(u, 0.0, 0.0, p)[0]

        top = 4.0 * n * self.values["propeller_diameter"] + 1.0
        while surplus(top) > 0.0 and top < 200.0:
            top *= 2.0
        if not surplus(0.0) > 0.0 > surplus(top):
            raise VesselError(
                f"{self.name}: [propulsion] k_0, k_1, k_2: at {n:g} rev/s the propellers do not "
                "balance the resistance at any speed; K_T must be above 0 at rest and fall with J"
            )
        return _root(surplus, 0.0, top)

    def varied(
        self, rng: np.random.Generator, spread: float = 0.15, built: float | None = None
    ) -> Vessel:
        """Return another boat of the same kind: every coefficient a little different.

        Each coefficient of forces and added masses is multiplied by 1 + ``spread`` times a
        normal number, and geometry and inertia by 1 + ``built`` times one; no factor leaves
        0.1 to 1.9, so that all signs are kept. The resistance curve gets one factor for its
        forces and one (as geometry) for its speeds; the length overall follows the length, the
        water plane length and beam. Actuators, shaft speeds, name and class stay. A boat is drawn
        again if it breaks a rule of the schema, is less stable on a straight course than
        neutral (or than this vessel, where that is unstable), or does not keep its way: if
        at the manoeuvring shaft speed it is faster or slower than this vessel by more than
        a factor of 4/3, as one that planes where this one ploughs.

        Parameters
        ----------
        rng : numpy.random.Generator
            Same state, same boat.
        spread : float
            Standard deviation of the coefficients, as a share; 0 or more.
        built : float, optional
            That of geometry and inertia; a third of ``spread`` by default.

        Returns
        -------
        Vessel

        Raises
        ------
        VesselError
            For spreads that are no such numbers, and where no boat could be drawn.

        Source: twin.md, sections 1, 2 and 13.
        """
        built = spread / 3.0 if built is None else built
        if not (math.isfinite(spread + built) and min(spread, built) >= 0.0):
            raise VesselError(
                f"varied(spread={spread}, built={built}): must be finite numbers, 0 or more"
            )
        sd = np.array([built if key in _BUILT else spread for key in par.SCALARS] + [spread, built])
        limit, n = max(_drift_growth(self), 0.0), self.values["shaft_speed_manoeuvring"]
        usual = self.straight_speed(n)
        for _ in range(TRIES):
            drawn = np.clip(1.0 + sd * rng.standard_normal(sd.size), 0.1, 1.9).tolist()
            *factors, force, speed = drawn
            factor = dict(zip(par.SCALARS, factors, strict=True)) | dict.fromkeys(_KEPT, 1.0)
            factor["length_overall"] = factor["length_waterline"]
            factor["A_wp"] = factor["length_waterline"] * factor["beam"]
            try:
                boat = dataclasses.replace(
                    self,
                    values={key: factor[key] * value for key, value in self.values.items()},
                    resistance_speed=tuple(speed * v for v in self.resistance_speed),
                    resistance_force=tuple(force * f for f in self.resistance_force),
                )
                ratio = boat.straight_speed(n) / usual
                if 1.0 / SAME_WAY <= ratio <= SAME_WAY and _drift_growth(boat) <= limit:
                    return boat
            except VesselError:
                continue
        raise VesselError(
            f"{self.name}: none of {TRIES} boats drawn with spread = {spread:g}, built = {built:g} "
            "keeps way on a straight course; use smaller spreads"
        )


def state_at(vessel: Vessel, n: float, speed: float) -> np.ndarray:
    """Return the state of a vessel going straight ahead, shape (16,).

    Parameters
    ----------
    vessel : Vessel
        The ship.
    n : float
        Shaft speed, rev/s.
    speed : float
        m/s.
    """
    state = np.zeros(fr.STATE_SIZE)
    state[fr.U] = speed
    state[fr.N_LEFT :] = vessel.helm(n, 0.0)
    return state


def jacobian(vessel: Vessel, state: np.ndarray, rows: list[int], dof: int = 6) -> np.ndarray:
    """Return the derivatives of the rates of some states by these states, commands held.

    Parameters
    ----------
    vessel : Vessel
        The ship, in calm water.
    state : ndarray, shape (16,)
        Where; layout in :mod:`usv_gym.physics.frames`.
    rows : list of int
        Which states.
    dof : int
        Degrees of freedom, 3 or 6.
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

    Parameters
    ----------
    vessel : Vessel
        The ship.
    n : float
        Shaft speed, rev/s.

    Returns
    -------
    tuple of complex
        The less stable one first; the ship holds its course where its real part is below 0.
    """
    state = state_at(vessel, n, vessel.straight_speed(n))
    values = np.linalg.eigvals(jacobian(vessel, state, [fr.V, fr.R], dof=3))
    first, second = sorted((complex(value) for value in values), key=lambda z: -z.real)
    return first, second


def _drift_growth(vessel: Vessel) -> float:
    """Return by which share a drift grows for each length sailed, at its worst shaft speed."""
    v = vessel.values
    return max(
        course_eigenvalues(vessel, v[key])[0].real
        * v["length_waterline"]
        / vessel.straight_speed(v[key])
        for key in SHAFT_SPEEDS
    )


def _root(f: Callable[[float], float], a: float, b: float) -> float:
    """Return where f passes zero between a and b, by Brent's method.

    The steps of ``scipy.optimize.brentq(f, a, b, xtol=1e-9)``, and so its very bits, without the
    third of a second that it takes to import.
    """
    x_pre, x, f_pre, fx = a, b, f(a), f(b)
    x_blk = f_blk = step_pre = step = 0.0
    while True:
        if f_pre != 0.0 and fx != 0.0 and (f_pre < 0.0) != (fx < 0.0):
            x_blk, f_blk, step_pre = x_pre, f_pre, x - x_pre
            step = step_pre
        if abs(f_blk) < abs(fx):
            x_pre, x, x_blk = x, x_blk, x
            f_pre, fx, f_blk = fx, f_blk, fx
        delta = (1e-9 + 4.0 * math.ulp(1.0) * abs(x)) / 2.0
        half = (x_blk - x) / 2.0
        if fx == 0.0 or abs(half) < delta:
            return x
        trial = math.inf
        if abs(step_pre) > delta and abs(fx) < abs(f_pre):
            if x_pre == x_blk:
                trial = -fx * (x - x_pre) / (fx - f_pre)
            else:
                d_pre, d_blk = (f_pre - fx) / (x_pre - x), (f_blk - fx) / (x_blk - x)
                trial = -fx * (f_blk * d_blk - f_pre * d_pre) / (d_blk * d_pre * (f_blk - f_pre))
        if 2.0 * abs(trial) < min(abs(step_pre), 3.0 * abs(half) - delta):
            step_pre, step = step, trial
        else:
            step_pre = step = half
        x_pre, f_pre = x, fx
        x += step if abs(step) > delta else math.copysign(delta, half)
        fx = f(x)


def _kind(kind: Any) -> str:
    if not isinstance(kind, str) or kind not in KIND_SCHEMA:
        raise VesselError(
            f"[propulsion] kind: must be one of {', '.join(KIND_SCHEMA)}, got {kind!r}"
        )
    return kind


def _rebuild(fields: dict[str, Any]) -> Vessel:
    return Vessel(**fields)


def _numbers(
    entry: Any, unit: str, place: str, *, scalar: bool = False
) -> tuple[tuple[float, ...], bool]:
    """Return the numbers of one entry in SI units, and whether it is marked as a guess."""
    example = f'{{ value = ..., unit = "{unit}", source = "..." }}'
    if not isinstance(entry, dict):
        raise VesselError(f"{place}: has no unit; write it as {example}")
    for key in entry:
        if key not in ("value", "unit", "source", "guess"):
            raise VesselError(f"{place}: unknown key {key!r}; write it as {example}")
    for key in ("value", "unit", "source"):
        if key not in entry:
            raise VesselError(f"{place}: {key} is missing; write it as {example}")
    factors = UNITS[unit]
    if not isinstance(entry["unit"], str) or entry["unit"] not in factors:
        raise VesselError(
            f"{place}: unit {entry['unit']!r} is not known here; use {', '.join(factors)}"
        )
    if not isinstance(entry["source"], str) or not isinstance(entry.get("guess", False), bool):
        raise VesselError(f"{place}: source must be a text and guess true or false")
    raw = [entry["value"]] if scalar else entry["value"]
    if not isinstance(raw, list) or any(
        isinstance(v, bool) or not isinstance(v, (int, float)) for v in raw
    ):
        kind = "a number" if scalar else "a list of numbers"
        raise VesselError(f"{place}: value must be {kind}, got {entry['value']!r}")
    factor = factors[entry["unit"]]
    try:
        numbers = tuple(float(v) * factor for v in raw)
    except OverflowError:
        raise VesselError(f"{place}: value must be a finite number") from None
    return numbers, bool(entry.get("guess", False))
