"""Parts of a boat's geometric model: coloured meshes that may steer or spin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from usv_gym.vessel.mesh import Array, Mesh

__all__ = ["COLOURS", "Boat", "Colour", "Part"]

Colour = tuple[int, int, int]

COLOURS: dict[str, Colour] = {
    "hull": (32, 74, 112),
    "deck": (196, 202, 206),
    "drive": (62, 68, 74),
    "propeller": (181, 134, 52),
}
"""Red, green and blue (0 to 255) by kind of part; rudders have the colour of drives."""


@dataclass(frozen=True, eq=False)
class Part:
    """A piece of a boat with one colour."""

    name: str  # such as hull, deck, drive_left, propeller_left
    mesh: Mesh  # surface in m, relative to position; axes of the ship
    colour: Colour  # red, green and blue, 0 to 255
    # point about which it turns, m, in the frame of the parent or the ship
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    parent: str = ""  # name of the part that it moves with; empty: the ship
    # steer: turns about z by minus the drive or rudder angle (above 0 to starboard); spin: turns
    # about x with the shaft; empty: fixed
    moves: str = ""
    unit: int = 0  # propulsion unit that moves it: 0 left or single, 1 right

    @classmethod
    def fixed(cls, name: str, mesh: Mesh) -> Part:
        """Return a fixed part in the ship's frame with the colour of its name."""
        return cls(name, mesh, COLOURS[name])


@dataclass(frozen=True, eq=False)
class Boat:
    """The geometric model of a boat: its parts in the ship's frame.

    Axes x forward, y to starboard, z down; origin on the still water line, as in the state.
    """

    parts: tuple[Part, ...]  # parents before their children

    def __getitem__(self, name: str) -> Part:
        return {part.name: part for part in self.parts}[name]

    def position_of(self, part: Part) -> Array:
        """Return the position of a part in the ship's frame with straight drives, m, shape (3,)."""
        here = np.array(part.position)
        return here + self.position_of(self[part.parent]) if part.parent else here

    def whole(self) -> Mesh:
        """Return all parts as one mesh in the ship's frame, with straight drives."""
        return Mesh.joined(part.mesh.moved(self.position_of(part)) for part in self.parts)
