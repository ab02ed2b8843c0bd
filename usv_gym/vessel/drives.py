"""Drives, rudders and propellers of a boat."""

from __future__ import annotations

from usv_gym.vessel.form import Form
from usv_gym.vessel.mesh import foil, propeller
from usv_gym.vessel.parts import COLOURS, Part

__all__ = ["propulsion_parts"]


def propulsion_parts(form: Form) -> list[Part]:
    """Return drives or rudders, and the propellers."""
    parts: list[Part] = []
    for unit in range(form.units):
        name = ("_left", "_right")[unit] if form.units == 2 else ""
        y = (2 * unit - 1) * form.propeller_offset
        parts += (_rudder if form.kind == "propeller_rudder" else _drive)(form, name, unit, y)
    return parts


def _drive(form: Form, name: str, unit: int, y: float) -> list[Part]:
    """Return a drive with its propeller."""
    D, fixed = form.propeller_diameter, form.kind == "thruster_pair"
    x = form.arm
    if x is None:
        x = form.stern - (0.3 if fixed else 0.8) * D
    depth = form.draft if form.depth is None else form.depth
    up = -depth - 0.7 * form.freeboard  # top of the leg, from the shaft
    chord = 0.62 * D
    drive = Part(
        name=f"drive{name}",
        mesh=foil(chord, 0.16 * D, up, 0.55 * D, 0.45 * chord),
        colour=COLOURS["drive"],
        position=(x, y, depth),
        moves="" if fixed else "steer",
        unit=unit,
    )
    return [drive, _propeller(D, name, unit, (-0.5 * D, 0.0, 0.0), drive.name)]


def _rudder(form: Form, name: str, unit: int, y: float) -> list[Part]:
    """Return a rudder, and the propeller on its shaft ahead of it."""
    D = form.propeller_diameter
    height, area = form.blade or (0.8 * form.draft, 0.0)
    chord = area / height if area > 0.0 else 0.55 * height
    x = form.stern if form.arm is None else form.arm
    depth = 0.7 * form.draft if form.depth is None else form.depth
    ahead = x + 0.02 * form.length if form.propeller is None else form.propeller
    z = min(depth, form.draft - 0.5 * height)
    blade = foil(chord, 0.18 * chord, -0.5 * height, 0.5 * height, 0.3 * chord)
    rudder = Part(f"rudder{name}", blade, COLOURS["drive"], (x, y, z), moves="steer", unit=unit)
    return [rudder, _propeller(D, name, unit, (ahead, y, depth))]


def _propeller(
    diameter: float,
    name: str,
    unit: int,
    position: tuple[float, float, float],
    parent: str = "",
) -> Part:
    """Return a propeller that spins."""
    mesh, colour = propeller(diameter), COLOURS["propeller"]
    return Part(f"propeller{name}", mesh, colour, position, parent, "spin", unit)
