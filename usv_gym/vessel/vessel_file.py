"""Reader of vessel files (TOML), and the vessels that are known by name."""

from __future__ import annotations

import functools
from collections.abc import Collection, Mapping
from importlib import resources
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from usv_gym.vessel.schema import OPTIONAL, SCHEMA, UNITS, VesselError, check_kind, keys_of
from usv_kernel.errors import did_you_mean
from usv_kernel.files import read_toml
from usv_kernel.servos import ServoError, Servos

__all__ = ["GROUP", "read_vessel", "shipped_names", "vessel_names", "vessel_path"]

GROUP = "usv_twin.vessels"
"""Group of the entry points by which other packages add vessels: the path of a vessel file each."""

FOLDER = Path(str(resources.files("usv_gym.vessel") / "vessels"))
"""Files of the vessels that ship with the package."""


@functools.cache
def shipped_names() -> tuple[str, ...]:
    """Return the names of the vessels that ship with the package."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


@functools.cache
def _added() -> dict[str, EntryPoint]:
    """Return the vessels of other packages; those that ship keep their names."""
    found = sorted(entry_points(group=GROUP), key=lambda entry: entry.name)
    return {entry.name: entry for entry in found if entry.name not in shipped_names()}


def vessel_names() -> tuple[str, ...]:
    """Return the names of the vessels of this package, and of others that add some.

    Others do it by an entry point in the group :data:`GROUP` that names the path of a file::

        [project.entry-points."usv_twin.vessels"]
        patrol = "my_package:PATROL"
    """
    return (*shipped_names(), *_added())


def vessel_path(source: str | Path) -> Path:
    """Return the file of a known name, or the path that is given.

    VesselError: the entry point of another package names no file.
    """
    name = str(source)
    if name in shipped_names():
        return FOLDER / f"{name}.toml"
    if name not in _added():
        return Path(source)
    entry = _added()[name]
    try:
        return Path(entry.load())
    except Exception as error:  # foreign code may raise anything when it is imported
        raise VesselError(
            f"vessel {name!r}: the entry point {entry.value} of another package gives no path of "
            f"a vessel file ({type(error).__name__}: {error}); mend or remove that package"
        ) from error


def read_vessel(source: str | Path) -> dict[str, Any]:
    """Return the keyword arguments of a vessel, in SI units, from a TOML file or a known name.

    ``hydro`` is the path of a hydrodynamic table, or None.

    VesselError names the key and the remedy.
    """
    path = vessel_path(source)
    if path.suffix != ".toml":
        raise VesselError(
            f"no vessel is called {str(source)!r}{did_you_mean(source, vessel_names())}; known: "
            f"{', '.join(vessel_names())}, or give the path of a .toml file"
        )
    tables = read_toml(path, VesselError)
    try:
        fields = _fields(tables, path)
    except VesselError as error:
        raise VesselError(f"{path}: {error}") from None
    return {**fields, "design": str(source) if str(source) in shipped_names() else ""}


def _fields(tables: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return the fields of a vessel from the tables of its file."""
    _check_keys("table ", tables, ("vessel", *SCHEMA, "autopilot"), ("vessel", "autopilot"))
    about = tables.get("vessel", {})
    names = ("name", "title", "hydro")
    _check_keys("[vessel] ", about, names, names)
    for key, text in about.items():
        if not isinstance(text, str):
            raise VesselError(f"[vessel] {key}: must be a text, got {text!r}")
    kind = ""
    entries: dict[str, tuple[Any, bool]] = {}
    resistance: dict[str, tuple[Any, bool]] = {}
    for name in SCHEMA:
        _check_keys(f"[{name}] ", tables[name], None)
        given = dict(tables[name])
        if name == "propulsion":
            kind = check_kind(given.pop("kind", None))
        if name == "hull" and "resistance" in given:
            resistance = _entries("hull.resistance", given.pop("resistance"), _CURVE, many=True)
        units = {key: unit for key, (unit, _) in keys_of(name, kind).items()}
        entries |= _entries(name, given, units)
    curve = {f"resistance_{key}": entry for key, entry in resistance.items()}
    return {
        "name": about.get("name", path.stem),
        "title": about.get("title", path.stem),
        "hydro": _table_path(path, about),
        "kind": kind,
        "values": {key: value for key, (value, _) in entries.items()},
        **{key: value for key, (value, _) in curve.items()},
        "guesses": frozenset(key for key, (_, guess) in {**entries, **curve}.items() if guess),
        "outputs": _outputs(tables["autopilot"], kind) if "autopilot" in tables else None,
    }


_CURVE = {"speed": "m/s", "force": "N"}


def _check_keys(
    place: str, table: Any, known: Collection[str] | None, optional: Collection[str] = ()
) -> None:
    """Check that something is a table with the known keys."""
    if not isinstance(table, dict):
        raise VesselError(f"{place}must be a table, got {table!r}")
    if known is None:
        return
    for key in table:
        if key not in known:
            near = did_you_mean(key, known)
            raise VesselError(f"{place}{key}: unknown key{near}; known: {', '.join(known)}")
    for key in known:
        if key not in table and key not in optional:
            unit = f" (a number in {known[key]})" if isinstance(known, Mapping) else ""
            raise VesselError(f"{place}{key}: is missing{unit}")


def _entries(
    name: str, table: Any, units: Mapping[str, str], many: bool = False
) -> dict[str, tuple[Any, bool]]:
    """Return numbers in SI units, and whether they are marked as guesses, by key of a table."""
    _check_keys(f"[{name}] ", table, units, OPTIONAL)
    return {
        key: _number(table[key], unit, f"[{name}] {key}", many)
        for key, unit in units.items()
        if key in table
    }


def _number(entry: Any, unit: str, place: str, many: bool = False) -> tuple[Any, bool]:
    """Return the number of one entry (or many) in SI units, and whether it is marked as a guess."""
    remedy = f'write it as {{ value = ..., unit = "{unit}", source = "..." }}'
    if not isinstance(entry, dict):
        raise VesselError(f"{place}: has no unit; {remedy}")
    try:
        _check_keys("", entry, ("value", "unit", "source", "guess"), ("guess",))
    except VesselError as error:
        raise VesselError(f"{place}: {error}; {remedy}") from None
    factor = UNITS[unit].get(str(entry["unit"]))
    if factor is None:
        raise VesselError(
            f"{place}: unit {entry['unit']!r} is not known here; use {', '.join(UNITS[unit])}"
        )
    if not isinstance(entry["source"], str) or not isinstance(entry.get("guess", False), bool):
        raise VesselError(f"{place}: source must be a text and guess true or false")
    value = entry["value"]
    numbers = value if many and isinstance(value, list) else [value]
    if (many and not isinstance(value, list)) or not all(type(v) in (int, float) for v in numbers):
        kind = "a list of numbers" if many else "a number"
        raise VesselError(f"{place}: value must be {kind}, got {value!r}")
    found = tuple(float(v) * factor for v in numbers)
    return found if many else found[0], entry.get("guess", False)


def _outputs(table: Any, kind: str) -> Servos:
    """Return the servo outputs of an autopilot from the table [autopilot]."""
    skid = kind == "thruster_pair"
    places = ("left", "right") if skid else ("throttle", "steering")
    scales = {"shaft_speed": "rev/s"} if skid else {"shaft_speed": "rev/s", "angle": "rad"}
    _check_keys("[autopilot] ", table, (*places, *scales, "pulse"), ("pulse",))
    for key in places:
        if type(table[key]) is not int:
            raise VesselError(f"[autopilot] {key}: must be the number of an output, from 1")
    pulse = table.get("pulse", [1100, 1500, 1900])
    if not (isinstance(pulse, list) and len(pulse) == 3) or any(
        type(width) not in (int, float) for width in pulse
    ):
        raise VesselError("[autopilot] pulse: must be three widths, us: least, at rest, greatest")
    low, middle, high = map(float, pulse)
    full = {key: _number(table[key], unit, f"[autopilot] {key}")[0] for key, unit in scales.items()}
    try:
        return Servos(
            left=table[places[0]],
            right=table[places[1 if skid else 0]],
            steering=0 if skid else table["steering"],
            shaft_speed=full["shaft_speed"],
            angle=full.get("angle", 1.0),
            low=low,
            middle=middle,
            high=high,
        )
    except ServoError as error:
        raise VesselError(f"[autopilot] {error}") from None


def _table_path(path: Path, about: Mapping[str, str]) -> Path | None:
    """Return the hydrodynamic table that [vessel] names, from the folder of its file."""
    if "hydro" not in about:
        return None
    file = (path.parent / about["hydro"]).resolve()
    if not file.is_file():
        file = FOLDER / about["hydro"]  # a copy of a vessel of the package keeps its table
    if not file.is_file():
        raise VesselError(
            f"[vessel] hydro: there is no file {path.parent / about['hydro']}; give its path from "
            "this file's folder"
        )
    return file
