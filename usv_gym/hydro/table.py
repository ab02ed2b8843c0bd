"""Hydrodynamic tables of a hull: added mass, damping, excitation and mean drift."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from usv_kernel.errors import UsvTwinError

__all__ = ["HydroError", "HydroTable", "between"]

Array = NDArray[np.float64]

Complex = NDArray[np.complex128]

FREQUENCIES_MAX = 500
HEADINGS_MAX = 181
"""Most frequencies and headings of a table; each sea is made from all of them."""

ODD = np.array([False, True, False, True, False, True])
"""Modes whose loads change sign as the wave comes from the other side: sway, roll, yaw."""


class HydroError(UsvTwinError):
    """A hydrodynamic table that cannot be used; the message names the file and the remedy."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HydroTable:
    """Hydrodynamics of a hull at rest in deep water, from a potential-flow code.

    Loads are about the vessel's origin on the water line; x forward, y to starboard, z down. A wave
    of amplitude a has the elevation ``a cos(k . x - omega t)``, and its load is the real part of
    ``a F exp(-i omega t)``. Headings are where the wave goes, less where the boat heads: 0 is a
    following sea, pi a head sea, and at pi/2 it goes to starboard. Both sides of the hull are the
    same.
    """

    omega: Array
    """Frequencies (F,), rad/s, rising."""
    heading: Array
    """Headings (H,), rad, at equal steps from 0 to pi."""
    added_mass: Array
    """(F, 6, 6): kg, kg m, kg m2."""
    damping: Array
    """Radiation damping (F, 6, 6): kg/s, kg m/s, kg m2/s."""
    excitation: Complex
    """Froude-Krylov and diffraction loads (F, H, 6) per wave amplitude: N/m and N."""
    drift: Array | None = None
    """Mean surge and sway force and yaw moment (F, H, 3) per square of the amplitude, or None."""
    length: float
    """Length of the water line, m; a boat of another size takes the table by Froude's law."""
    density: float
    """Of the water, kg/m3."""
    hydrostatics: tuple[float, float, float, float] | None = None
    """A_wp (m2), x_F (m), GM_T and GM_L (m) of the same hull, or None."""
    source: str = ""
    """Command and version that made it."""

    def __post_init__(self) -> None:
        F, H = len(self.omega), len(self.heading)
        shapes = {
            "omega": (F,),
            "heading": (H,),
            "added_mass": (F, 6, 6),
            "damping": (F, 6, 6),
            "excitation": (F, H, 6),
            **({} if self.drift is None else {"drift": (F, H, 3)}),
        }
        for name, shape in shapes.items():
            value = np.asarray(getattr(self, name))
            if value.shape != shape:
                raise HydroError(f"{name} of shape {value.shape}: must be {shape}")
            if not np.isfinite(value).all():
                raise HydroError(f"{name}: must be finite numbers")
        if not (4 <= F <= FREQUENCIES_MAX and 5 <= H <= HEADINGS_MAX):
            raise HydroError(
                f"{F} frequencies and {H} headings: must be 4 to {FREQUENCIES_MAX} and 5 to "
                f"{HEADINGS_MAX}"
            )
        if not (self.omega[0] > 0.0 and (np.diff(self.omega) > 0.0).all()):
            raise HydroError("omega: frequencies must be above 0 and rise; sort them")
        if np.abs(self.heading - np.linspace(0.0, math.pi, H)).max() > 1e-3:
            raise HydroError("heading: must go from 0 to 180 degrees at equal steps")
        numbers = (self.length, self.density, *(self.hydrostatics or ()))
        if not (np.isfinite(numbers).all() and self.length > 0.0 and self.density > 0.0):
            raise HydroError("length, density and hydrostatics: must be finite, and above 0")
        # both sides are alike: what lies between heave and sway is noise of a code
        for name in ("added_mass", "damping"):
            object.__setattr__(self, name, np.where(ODD[:, None] == ODD, getattr(self, name), 0.0))
        if np.diagonal(self.damping, 0, 1, 2).max() <= 0.0:
            raise HydroError("damping: no motion radiates waves; is its sign right?")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, HydroTable):
            return NotImplemented
        names = [item.name for item in dataclasses.fields(self)]
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in names)

    def __hash__(self) -> int:
        return hash((self.length, self.density, self.source))

    @cached_property
    def drift_around(self) -> Array | None:
        """Drift (F, K, 3) on a full circle of headings."""
        if self.drift is None:
            return None
        return np.ascontiguousarray(self.around(self.drift), dtype=float)

    def at(self, omega: float | Array) -> tuple[Array, Array]:
        """Return added mass and damping (n, 6, 6) at frequencies (n,) or one, rad/s."""
        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        pair = (between(omega, self.omega, matrix) for matrix in (self.added_mass, self.damping))
        added_mass, damping = (np.asarray(matrix.real, dtype=float) for matrix in pair)
        return added_mass, damping

    def scaled(self, ratio: float) -> HydroTable:
        """Return the table of the same hull with a length of ``ratio`` times this (Froude)."""
        if ratio == 1.0:
            return self
        lever = np.array([0, 0, 0, 1, 1, 1])
        power = 3.0 + lever[:, None] + lever
        static = self.hydrostatics
        return dataclasses.replace(
            self,
            omega=self.omega / math.sqrt(ratio),
            added_mass=self.added_mass * ratio**power,
            damping=self.damping * ratio ** (power - 0.5),
            excitation=self.excitation * ratio ** (2.0 + lever),
            drift=None if self.drift is None else self.drift * ratio ** np.array([1.0, 1.0, 2.0]),
            length=self.length * ratio,
            hydrostatics=None
            if static is None
            else (static[0] * ratio**2, *(number * ratio for number in static[1:])),  # type: ignore[arg-type]
        )

    def around(self, values: NDArray[np.inexact]) -> NDArray[np.inexact]:
        """Return values (F, H, n) of all modes or of surge, sway and yaw on a full circle.

        Headings are then 2 (H - 1) equal steps from 0.
        """
        odd = ODD if values.shape[-1] == 6 else ODD[[0, 1, 5]]
        sign = np.where(odd, -1.0, 1.0)
        values = values.copy()
        values[:, [0, -1]] *= ~odd  # ahead and astern nothing pushes to a side
        return np.concatenate([values, sign * values[:, -2:0:-1]], axis=1)


def between(x: Array, points: Array, values: NDArray[np.inexact]) -> NDArray[np.inexact]:
    """Return values (n, ...) at x (n,) by cubic polynomials through the four nearest points.

    ``values`` (F, ...) belong to rising ``points`` (F,); beyond the ends those there are held.
    """
    x = np.clip(x, points[0], points[-1])
    first = np.clip(np.searchsorted(points, x) - 2, 0, len(points) - 4)
    nodes = points[first[:, None] + np.arange(4)]
    weights = np.ones_like(nodes)
    for i in range(4):
        for j in range(4):
            if i != j:
                weights[:, i] *= (x - nodes[:, j]) / (nodes[:, i] - nodes[:, j])
    total = sum(
        weights[:, i].reshape(-1, *[1] * (values.ndim - 1)) * values[first + i] for i in range(4)
    )
    return np.asarray(total)
