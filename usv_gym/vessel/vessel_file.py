"""Reader of vessel files (TOML), and the vessels that ship with the package."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

from usv_gym.vessel.schema import OPTIONAL, SCHEMA, UNITS, VesselError, check_kind, keys_of
from usv_kernel.errors import did_you_mean
from usv_kernel.files import read_toml
from usv_kernel.servos import ServoError, Servos

__all__ = [
    "read_vessel",
    "vessel_names",
    "vessel_path",
]


_FILES = ("mesh", "hydro")


def vessel_names() -> tuple[str, ...]:
    """Return the names of the vessels that ship with the package."""
    folder = resources.files("usv_gym.vessel") / "vessels"
    return tuple(sorted(p.name[:-5] for p in folder.iterdir() if p.name.endswith(".toml")))


def vessel_path(source: str | Path) -> Path:
    """Return the file of a known name, or the path that is given."""
    if str(source) in vessel_names():
        return Path(str(resources.files("usv_gym.vessel") / "vessels" / f"{source}.toml"))
    return Path(source)


def read_vessel(source: str | Path) -> dict[str, Any]:
    """Return the keyword arguments of a vessel, in SI units, from a TOML file or a known name.

    ``hydro`` is the path of a hydrodynamic table, or None.

    VesselError names the key and the remedy.
    """
    path = vessel_path(source)
    design = str(source) if str(source) in vessel_names() else ""
    if path.suffix != ".toml":
        raise VesselError(
            f"no vessel is called {str(source)!r}{did_you_mean(source, vessel_names())}; known: "
            f"{', '.join(vessel_names())}, or give the path of a .toml file"
        )
    table = read_toml(path, VesselError)
    try:
        return {**_fields(table, path), "design": design}
    except VesselError as error:
        raise VesselError(f"{path}: {error}") from None


def _fields(tables: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return the fields of a vessel from the tables of its file."""
    known = {"vessel", "autopilot", *SCHEMA}
    for name in tables:
        if name not in known:
            raise VesselError(f"unknown table [{name}]; known: {', '.join(sorted(known))}")
    values: dict[str, float] = {}
    guesses = set()
    curve: dict[str, tuple[float, ...]] = {"speed": (), "force": ()}
    kind = ""
    about = _about(tables.get("vessel", {}), path)
    for name in SCHEMA:
        if not isinstance(tables.get(name), dict):
            raise VesselError(f"the table [{name}] is missing")
        given = dict(tables[name])
        if name == "propulsion":
            kind = check_kind(given.pop("kind", None))
        keys = keys_of(name, kind)
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
        for key in keys:
            unit = keys[key][0]
            if key not in given:
                if key in OPTIONAL:
                    continue
                raise VesselError(f"[{name}] {key}: is missing (a number in {unit})")
            (values[key],), guess = _numbers(given[key], unit, f"[{name}] {key}", scalar=True)
            if guess:
                guesses.add(key)
    if "autopilot" in tables:
        about["outputs"] = _outputs(tables["autopilot"], kind)
    return {
        **about,
        "kind": kind,
        "values": values,
        "resistance_speed": curve["speed"],
        "resistance_force": curve["force"],
        "guesses": frozenset(guesses),
    }


def _outputs(table: Any, kind: str) -> Servos:
    """Return the servo outputs of an autopilot from the table [autopilot]."""
    skid = kind == "thruster_pair"
    places = ("left", "right") if skid else ("throttle", "steering")
    scales = {"shaft_speed": "rev/s"} if skid else {"shaft_speed": "rev/s", "angle": "rad"}
    known = (*places, *scales, "pulse")
    if not isinstance(table, dict):
        raise VesselError("[autopilot] must be a table")
    for key in table:
        if key not in known:
            raise VesselError(f"[autopilot] {key}: unknown key; known: {', '.join(known)}")
    for key in (*places, *scales):
        if key not in table:
            raise VesselError(f"[autopilot] {key}: is missing")
    for key in places:
        if isinstance(table[key], bool) or not isinstance(table[key], int):
            raise VesselError(f"[autopilot] {key}: must be the number of an output, from 1")
    pulse = table.get("pulse", [1100, 1500, 1900])
    numbers = isinstance(pulse, list) and all(type(width) in (int, float) for width in pulse)
    if not numbers or len(pulse) != 3:
        raise VesselError("[autopilot] pulse: must be three widths, us: least, at rest, greatest")
    full = {
        key: _numbers(table[key], unit, f"[autopilot] {key}", scalar=True)[0][0]
        for key, unit in scales.items()
    }
    low, middle, high = map(float, pulse)
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


def _about(table: Any, path: Path) -> dict[str, Any]:
    """Return name, title and files from the table [vessel]."""
    if not isinstance(table, dict):
        raise VesselError("[vessel] must be a table")
    for key, value in table.items():
        if key not in ("name", "title", *_FILES) or not isinstance(value, str):
            known = ", ".join(("name", "title", *_FILES))
            raise VesselError(f"[vessel] {key}: unknown key; known: {known} (texts)")
    files: dict[str, Path | None] = {}
    for key in _FILES:
        file = (path.parent / table[key]).resolve() if key in table else None
        if file is not None and key == "hydro" and not file.is_file():
            # a copy of a vessel of the package keeps its table
            shipped = Path(str(resources.files("usv_gym.vessel") / "vessels" / table[key]))
            file = shipped if shipped.is_file() else file
        if file is not None and not file.is_file():
            raise VesselError(
                f"[vessel] {key}: there is no file {file}; give its path from this file's folder"
            )
        files[key] = file
    return {
        "name": table.get("name", path.stem),
        "title": table.get("title", path.stem),
        **files,
    }


def _numbers(
    entry: Any, unit: str, place: str, *, scalar: bool = False
) -> tuple[tuple[float, ...], bool]:
    """Return the numbers of one entry in SI units, and whether the file marks it as a guess."""
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
