"""One realisation of a sea state, as the kernels read it."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usv_gym.physics import GRAVITY, ship, waves
from usv_gym.physics import weather as wx
from usv_gym.vessel.vessel import Vessel
from usv_kernel.records import Record

__all__ = ["Sea", "wave_rows"]

Array = NDArray[np.float64]


def wave_rows(
    vessel: Vessel,
    omega: ArrayLike,
    amplitude: ArrayLike,
    north: ArrayLike,
    east: ArrayLike,
    phase: ArrayLike,
) -> tuple[Array, Array]:
    """Return wave components (7, M) as the kernels read them, and the sums (6,) of mean drift.

    The vessel's draft and length decide how deep the pressure reaches and which waves it reflects.
    ``omega`` is in rad/s, ``amplitude`` in m; ``north, east`` are the unit vector that each
    component goes along; ``phase`` is that at the origin at time 0, rad.
    """
    omega, amplitude, north, east, phase = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(a, float)) for a in (omega, amplitude, north, east, phase))
    )
    k = omega**2 / GRAVITY
    rho_g, draft = vessel.values["water_density"] * GRAVITY, vessel.values["draft"]
    rows = np.zeros((waves.WAVE_ROWS, len(k)))
    rows[waves.OMEGA], rows[waves.AMPLITUDE], rows[waves.PHASE] = omega, amplitude, phase
    rows[waves.K_NORTH], rows[waves.K_EAST] = k * north, k * east
    rows[waves.PRESSURE] = rho_g * amplitude * -np.expm1(-k * draft) / k
    rows[waves.BOTTOM] = k * np.exp(-k * draft) / -np.expm1(-k * draft)
    L, drift = vessel.values["length_waterline"], np.zeros(waves.DRIFT_SUMS)
    for i, c in enumerate(waves.drift_coefficients_limited(2.0 * math.pi / (k * L))):
        load = 0.5 * rho_g * L ** (1 if i < 2 else 2) * c * amplitude**2
        drift[2 * i : 2 * i + 2] = np.sum(load * north), np.sum(load * east)
    return rows, drift


@dataclass(frozen=True)
class Sea:
    """One realisation, as the kernels read it."""

    waves: Array  # (7, M): wave components; rows in usv_gym.physics.waves
    gusts: Array  # (3, G): circular frequency, phase and amplitude of the gusts
    weather: Record  # schedule, current, mean drift and slow wind

    @classmethod
    def calm(cls) -> Sea:
        """Return still water without wind."""
        empty = np.zeros((waves.WAVE_ROWS, 0))
        return cls(waves=empty, gusts=np.zeros((3, 0)), weather=wx.constant())

    @classmethod
    def regular(
        cls, vessel: Vessel, omega: float, amplitude: float, to: float = 0.0, phase: float = 0.0
    ) -> Sea:
        """Return a sea of one regular wave for a vessel, without wind or mean drift.

        ``omega`` in rad/s, ``amplitude`` in m; ``to`` is where the wave goes, ``phase`` that at the
        origin at time 0, rad.
        """
        rows = wave_rows(vessel, omega, amplitude, math.cos(to), math.sin(to), phase)[0]
        return dataclasses.replace(cls.calm(), waves=rows)

    def arrays(self) -> ship.Sea:
        """Return the arrays that the ship's kernels take, with scratch of their own."""
        scratch = waves.factor_workspace(self.waves.shape[1])
        return ship.Sea(self.waves, self.gusts, self.weather, scratch)

    def elevation(self, x: ArrayLike, y: ArrayLike, t: ArrayLike) -> Array:
        """Return the height of the sea surface above rest (m) at places (m) and times (s).

        The three are broadcast against each other.
        """
        x, y, t = np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in (x, y, t)))
        out = np.zeros(x.size)
        wx.surface(x.ravel(), y.ravel(), t.ravel(), self.waves, self.weather, out)
        return out.reshape(x.shape)
