"""Drives, rudders and propellers of a boat."""

from __future__ import annotations

from usv_gym.vessel.form import Form
from usv_gym.vessel.mesh import Mesh, block, foil, prism, propeller, revolve
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
    """Return a drive with its propeller, and an outboard's cowl and bracket."""
    D, fixed = form.propeller_diameter, form.kind == "thruster_pair"
    x = form.arm
    if x is None:
        x = form.stern - (0.3 if fixed else 0.8) * D
    depth = form.draft if form.depth is None else form.depth
    up = -depth - 0.7 * form.freeboard  # top of the leg, from the shaft
    chord = 0.62 * D
    torpedo = ((-0.42, 0.09), (-0.2, 0.13), (0.25, 0.13), (0.5, 0.05), (0.55, 0.0))
    leg = [
        revolve([(along * D, radius * D) for along, radius in torpedo], 0),
        foil(chord, 0.16 * D, up, 0.0, 0.45 * chord),
        foil(0.8 * chord, 0.05 * D, 0.0, 0.55 * D, 0.2 * chord),
        prism(-0.62 * D, -0.58 * D, -0.62 * D, 0.3 * D, 0.22 * D, 3.0),
    ]
    parts = []
    if x < form.stern:  # the motor's cowl, and a bracket to the transom
        size = min((0.9 if fixed else 1.5) * D, 0.25 * form.beam)
        tall = (0.45 if fixed else 0.95) * min(size, form.freeboard)
        cowl = ((0.0, 0.42, 0.26), (0.25, 0.52, 0.33), (0.8, 0.5, 0.31), (1.0, 0.36, 0.22))
        leg.append(
            block(
                [(up - at * tall, -long * size, long * size, w * size) for at, long, w in cowl],
                power=3.5,
            )
        )
        low, high = -0.6 * form.freeboard, -0.15 * form.freeboard
        bracket = prism(low, high, x + 0.1 * D, form.stern + 0.1 * D, 0.2 * D, 8.0)
        parts.append(Part(f"bracket{name}", bracket.moved([0.0, y, 0.0]), COLOURS["drive"]))
    drive = Part(
        name=f"drive{name}",
        mesh=Mesh.joined(leg),
        colour=COLOURS["drive"],
        position=(x, y, depth),
        moves="" if fixed else "steer",
        unit=unit,
    )
    return [*parts, drive, _propeller(D, name, unit, (-0.5 * D, 0.0, 0.0), drive.name)]


def _rudder(form: Form, name: str, unit: int, y: float) -> list[Part]:
    """Return a rudder, and the propeller on its shaft ahead of it."""
    D = form.propeller_diameter
    height, area = form.blade or (0.8 * form.draft, 0.0)
    chord = area / height if area > 0.0 else 0.55 * height
    x = form.stern if form.arm is None else form.arm
    depth = 0.7 * form.draft if form.depth is None else form.depth
    ahead = x + 0.02 * form.length if form.propeller is None else form.propeller
    z = min(depth, form.draft - 0.5 * height)
    stock = 0.06 * chord
    blade = [
        foil(chord, 0.18 * chord, -0.5 * height, 0.5 * height, 0.3 * chord),
        revolve([(-z, stock), (-0.45 * height, stock)], 2),
    ]
    tube = revolve([(0.1 * D, 0.1 * D), (0.35 * D, 0.16 * D), (0.11 * form.length, 0.2 * D)], 0)
    shaft = Part(f"shaft{name}", tube, COLOURS["hull"], (ahead, y, depth))
    rudder = Part(
        f"rudder{name}", Mesh.joined(blade), COLOURS["drive"], (x, y, z), moves="steer", unit=unit
    )
    return [shaft, rudder, _propeller(D, name, unit, (ahead, y, depth))]


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
