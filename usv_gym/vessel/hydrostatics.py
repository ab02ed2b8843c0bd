"""Hydrostatics of a hull's mesh: displacement, centres, and water plane."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from usv_gym.vessel.mesh import Array, Mesh
from usv_gym.vessel.schema import VesselError

__all__ = ["Hydrostatics", "wetted_surface"]


@dataclass(frozen=True)
class Hydrostatics:
    """What a hull displaces on even keel; the origin lies on the water line, z is down."""

    volume: float
    """m3."""
    x_B: float
    """Centre of buoyancy forward of the origin, m."""
    z_B: float
    """Its depth below the water line, m."""
    A_wp: float
    """Area of the water plane, m2."""
    x_F: float
    """Its centre forward of the origin, m."""
    I_T: float
    """Second moment of the water plane about the centre line, m4."""
    I_L: float
    """Second moment of the water plane about the athwartships axis through its centre, m4."""

    @classmethod
    def of(cls, mesh: Mesh) -> Hydrostatics:
        """Return those of a closed mesh; VesselError if it displaces no water."""
        a, b, c = np.moveaxis(wetted_surface(mesh), 1, 0)
        # outward normals times area; what lies between their edges and the surface is the hull
        down = 0.5 * np.cross(b - a, c - a)[:, 2]
        sums = a + b + c
        z, x = sums[:, 2] / 3.0, sums[:, 0] / 3.0
        volume, area = float(np.sum(z * down)), float(np.sum(down))
        if not (volume > 0.0 and area > 0.0):
            raise VesselError("the hull's mesh displaces no water: it must reach below z = 0")

        def mean(p: int, q: int) -> Array:
            """Return the mean of the product of two coordinates over each triangle."""
            corners = a[:, p] * a[:, q] + b[:, p] * b[:, q] + c[:, p] * c[:, q]
            return np.asarray((corners + sums[:, p] * sums[:, q]) / 12.0)

        x_F = float(np.sum(x * down)) / area
        return cls(
            volume=volume,
            x_B=float(np.sum(mean(0, 2) * down)) / volume,
            z_B=0.5 * float(np.sum(mean(2, 2) * down)) / volume,
            A_wp=area,
            x_F=x_F,
            I_T=float(np.sum(mean(1, 1) * down)),
            I_L=float(np.sum(mean(0, 0) * down)) - area * x_F**2,
        )

    def GM(self, height: float) -> tuple[float, float]:
        """Return the transverse and the longitudinal GM, m.

        ``height`` is that of the centre of gravity above the water line, m.
        """
        arm = -self.z_B - height
        return self.I_T / self.volume + arm, self.I_L / self.volume + arm

    def trim(self, x_G: float, height: float) -> float:
        """Return the angle to which the boat trims, rad, above 0 by the stern.

        ``x_G`` is the centre of gravity forward of the origin, ``height`` that above the water
        line, m. The water plane is taken to stay as it is.
        """
        return math.atan2(self.x_B - x_G, self.GM(height)[1])


def wetted_surface(mesh: Mesh) -> Array:
    """Return the triangles below the water line z = 0, corners (n, 3, 3) in m."""
    corners = mesh.vertices[mesh.faces]
    below = corners[:, :, 2] > 0.0
    count = below.sum(axis=1)
    pieces = [corners[count == 3]]
    for wet in (1, 2):
        cut = corners[count == wet]
        # turned so that the one corner on its own side comes first
        single = np.argmax(below[count == wet] == (wet == 1), axis=1)
        order = (single[:, None] + np.arange(3)) % 3
        p, q, r = np.moveaxis(np.take_along_axis(cut, order[:, :, None], axis=1), 1, 0)
        pq, pr = _crossing(p, q), _crossing(p, r)
        if wet == 1:
            pieces.append(np.stack([p, pq, pr], axis=1))
        else:
            pieces += [np.stack([pq, q, r], axis=1), np.stack([pq, r, pr], axis=1)]
    return np.concatenate(pieces)


def _crossing(p: Array, q: Array) -> Array:
    """Return where the edges from p to q (n, 3) cross z = 0."""
    share = (p[:, 2] / (p[:, 2] - q[:, 2]))[:, None]
    return np.asarray(p + share * (q - p))
