"""Triangle meshes, and the simple bodies that boats are built from."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Mesh"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh: vertices (V, 3) in m, faces (F, 3) counter-clockwise seen from outside."""

    vertices: Array
    faces: NDArray[np.int32]

    @property
    def volume(self) -> float:
        """Enclosed volume of a closed mesh, m3."""
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0

    @property
    def bounds(self) -> Array:
        """Smallest and largest x, y and z, m, shape (2, 3)."""
        return np.array([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    def moved(self, by: Sequence[float] | Array) -> Mesh:
        """Return the mesh moved by a vector (3,), m."""
        return Mesh(self.vertices + np.asarray(by), self.faces)

    @classmethod
    def joined(cls, meshes: Iterable[Mesh]) -> Mesh:
        """Return several meshes as one."""
        meshes = tuple(meshes)
        starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        pairs = zip(meshes, starts, strict=False)
        return cls(
            np.concatenate([mesh.vertices for mesh in meshes]),
            np.concatenate([mesh.faces + start for mesh, start in pairs]).astype(np.int32),
        )


def loft(rings: Array, caps: tuple[bool, bool] = (True, True)) -> Mesh:
    """Return the closed surface through closed polygons, (rings, points, 3).

    An end without a cap must run into a point or an edge; coinciding points become one.
    Diagonals of the second half of the points mirror those of the first.
    """
    m, k = rings.shape[:2]
    index = np.arange(m * k).reshape(m, k)
    a, b = index[:-1], index[1:]
    a_next, b_next = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    half = (np.arange(k) < k // 2)[:, None]
    one = np.where(half, np.stack((a, b, b_next), -1), np.stack((a, b, a_next), -1))
    two = np.where(half, np.stack((a, b_next, a_next), -1), np.stack((b, b_next, a_next), -1))
    faces = [one.reshape(-1, 3), two.reshape(-1, 3)]
    points = [rings.reshape(-1, 3)]
    for i, (capped, ring) in enumerate(zip(caps, (index[0], index[-1]), strict=True)):
        if capped:
            centre = np.full(k, m * k + len(points) - 1)
            fan = np.stack([centre, ring, np.roll(ring, -1)], axis=-1)
            faces.append(fan if i == 0 else fan[:, ::-1])
            points.append(rings[-i].mean(axis=0)[None])
    return _merged(np.concatenate(points), np.concatenate(faces))


def _merged(points: Array, faces: NDArray[np.integer[Any]]) -> Mesh:
    """Join coinciding points, drop faces without area, and orient faces outwards."""
    grain = 1e-9 * float(np.ptp(points, axis=0).max())
    kept, where = np.unique(
        np.round(points / grain), axis=0, return_index=True, return_inverse=True
    )[1:]
    faces = where.reshape(-1)[faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    mesh = Mesh(points[kept], faces.astype(np.int32))
    return mesh if mesh.volume >= 0.0 else Mesh(mesh.vertices, mesh.faces[:, ::-1])


def mirrored(mesh: Mesh) -> Mesh:
    """Return a mesh with port and starboard exchanged."""
    return Mesh(mesh.vertices * (1.0, -1.0, 1.0), mesh.faces[:, ::-1])


def block(
    levels: Sequence[tuple[float, float, float, float]], power: float = 5.0, points: int = 16
) -> Mesh:
    """Return a body with rounded corners from levels: z, aft and fore x, half breadth, m."""
    angle = 2.0 * math.pi * (np.arange(points) + 0.5) / points
    c, s = (np.copysign(np.abs(f(angle)) ** (2.0 / power), f(angle)) for f in (np.cos, np.sin))
    rings = [
        np.stack([0.5 * (x0 + x1) + 0.5 * (x1 - x0) * c, half * s, np.full(points, z)], axis=-1)
        for z, x0, x1, half in levels
    ]
    return loft(np.array(rings))


def prism(low: float, high: float, aft: float, fore: float, half: float, power: float) -> Mesh:
    """Return a body of one horizontal section between two z: aft and fore x, half breadth, m."""
    return block([(low, aft, fore, half), (high, aft, fore, half)], power)


def foil(chord: float, thick: float, low: float, high: float, lead: float) -> Mesh:
    """Return a vertical blade from z = low to high, its nose ``lead`` ahead of the z axis, m."""
    s = np.array([0.0, 0.08, 0.3, 0.6, 1.0])
    half = 0.5 * thick * np.array([0.0, 0.62, 1.0, 0.72, 0.12])
    x = lead - chord * s
    outline = np.concatenate([np.stack([x, half], axis=-1), np.stack([x, -half], axis=-1)[:0:-1]])
    rings = [np.column_stack([outline, np.full(len(outline), z)]) for z in (low, high)]
    return loft(np.array(rings))


def propeller(diameter: float, blades: int = 3) -> Mesh:
    """Return a right-handed propeller about x with its disc at x = 0, m."""
    pieces = []
    share = np.array([0.2, 0.45, 0.7, 0.9, 1.0])
    chord = diameter * np.array([0.2, 0.32, 0.36, 0.27, 0.08])
    pitch = np.arctan(1.0 / (math.pi * share))
    corners = np.array([[-0.5, 0.0], [0.0, 0.06], [0.5, 0.0], [0.0, -0.06]])
    rings = np.empty((len(share), 4, 3))
    for ring, r, c, p in zip(rings, 0.5 * diameter * share, chord, pitch, strict=True):
        along, off = c * corners[:, 0], c * corners[:, 1]
        ring[:, 0] = along * math.sin(p) + off * math.cos(p)
        side = along * math.cos(p) - off * math.sin(p)
        # the tip stays within the disc
        ring[:, 1] = side
        ring[:, 2] = np.sqrt(np.maximum(r * r - side * side, 0.0))
    blade = loft(rings)
    for i in range(blades):
        a = 2.0 * math.pi * i / blades
        turn = np.array(
            [[1.0, 0.0, 0.0], [0.0, math.cos(a), -math.sin(a)], [0.0, math.sin(a), math.cos(a)]]
        )
        pieces.append(Mesh(blade.vertices @ turn.T, blade.faces))
    return Mesh.joined(pieces)
