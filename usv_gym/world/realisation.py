"""One realisation of a sea state, as the kernels read it."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usv_gym.hydro.table import between
from usv_gym.physics import GRAVITY, ship, waves
from usv_gym.physics import weather as wx
from usv_gym.vessel.vessel import Vessel
from usv_kernel.records import Record

__all__ = ["Sea", "drift_sums", "drift_table", "load_rows", "wave_rows"]

Array = NDArray[np.float64]


def wave_rows(
    vessel: Vessel,
    omega: ArrayLike,
    amplitude: ArrayLike,
    north: ArrayLike,
    east: ArrayLike,
    phase: ArrayLike,
) -> Array:
    """Return wave components (7, M) as the kernels read them.

    The vessel's draft decides how deep the pressure reaches. ``omega`` is in rad/s, ``amplitude``
    in m; ``north, east`` are the unit vector of each component's direction. ``phase`` is that at
    the origin at time 0, rad.
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
    return rows


def drift_sums(vessel: Vessel, omega: Array, amplitude: Array, to: Array) -> Array:
    """Return the sums (6,) of mean drift by regression, see :func:`waves.mean_drift_loads`.

    ``omega`` (M,) in rad/s, ``amplitude`` (M,) in m; the waves go ``to`` (M,), rad. Length and
    number of hulls, with their draft, decide which waves are reflected.
    """
    k, L = omega**2 / GRAVITY, vessel.values["length_waterline"]
    coefficients = waves.drift_coefficients_limited(2.0 * math.pi / (k * L))
    if vessel.two_hulls:  # waves pass below shallow pontoons
        c_x, c_y, c_n = coefficients
        share = waves.reflected_by_draft(k, vessel.values["draft"])
        coefficients = c_x, share * c_y, share * c_n
    rho_g, sums = vessel.values["water_density"] * GRAVITY, np.zeros(waves.DRIFT_SUMS)
    for i, c in enumerate(coefficients):
        load = 0.5 * rho_g * L ** (1 if i < 2 else 2) * c * amplitude**2
        sums[2 * i : 2 * i + 2] = np.sum(load * np.cos(to)), np.sum(load * np.sin(to))
    return sums


_HEAVE, _PITCH = 2, 4


def load_rows(vessel: Vessel, rows: Array) -> Array:
    """Return the loads (H, 14, M) of wave components (7, M) on a vessel with a hydrodynamic table.

    They are those of :func:`usv_gym.physics.waves.wave_factors`, for H even headings of the boat;
    H = 0 without a table or without waves.
    """
    M, table = rows.shape[1], vessel.hydro
    if table is None or vessel.loads is None or M == 0:
        return np.zeros((0, waves.LOAD_ROWS, M))
    amplitude = rows[waves.AMPLITUDE]
    scale = vessel.values["length_waterline"] / table.length
    points = table.omega / math.sqrt(scale)
    at = np.where(amplitude > 0.0, rows[waves.OMEGA], points[0])  # rows are filled up with zeros
    loads = np.asarray(between(at, points, vessel.loads), dtype=complex)
    # heave pushes at the centre of the water plane: what is left of pitch goes with the slope
    loads[..., _PITCH] += vessel.values["x_F"] * loads[..., _HEAVE]
    loads *= _beyond(at, points)[:, None]
    loads[..., _PITCH] -= vessel.values["x_F"] * loads[..., _HEAVE]
    to = np.arctan2(rows[waves.K_EAST], rows[waves.K_NORTH])
    around = amplitude[:, None, None] * _turned(loads, to)
    # (M, H, 6) -> (H, 6, M); Re(F exp(i phase)) = Re F cos(phase) - Im F sin(phase)
    around = np.moveaxis(around, 0, 2)
    out = np.zeros((waves.LOAD_HEADINGS, waves.LOAD_ROWS, M))
    out[:, waves.COSINE_LOADS : waves.SINE_LOADS] = around.real
    out[:, waves.SINE_LOADS : waves.ORBIT_FORWARD] = -around.imag
    for i, psi in enumerate(2.0 * math.pi * np.arange(len(out)) / len(out)):
        factors = waves.factor_workspace(M)
        waves.box_factors(psi, rows, vessel.packed.copy(), 3, factors)
        north, east = factors[waves.ORBIT_NORTH, :M], factors[waves.ORBIT_EAST, :M]
        out[i, waves.ORBIT_FORWARD] = north * math.cos(psi) + east * math.sin(psi)
        out[i, waves.ORBIT_STARBOARD] = east * math.cos(psi) - north * math.sin(psi)
    return out


def drift_table(vessel: Vessel, omega: Array, amplitude: Array, to: Array) -> Array | None:
    """Return the mean drift (H, 3) at even headings of the boat, None without a table.

    Forces in N, moment in N m; the waves as in :func:`drift_sums`.
    """
    table = vessel.hydro
    if table is None or table.drift is None:
        return None
    scale = vessel.values["length_waterline"] / table.length
    points = table.omega / math.sqrt(scale)
    drift = between(omega, points, table.around(table.drift) * scale ** np.array([1.0, 1.0, 2.0]))
    # longer waves pass by
    drift = drift * np.minimum(omega / points[0], 1.0)[:, None, None] ** 4
    return np.asarray(np.sum(amplitude[:, None, None] ** 2 * _turned(drift, to).real, axis=0))


def _beyond(omega: Array, points: Array) -> Array:
    """Return factors (M, 6) of loads at frequencies beyond those of a table.

    In longer waves all but heave go with the slope, in shorter ones they vanish.
    """
    long = np.minimum(omega / points[0], 1.0)[:, None] ** np.array([2.0, 2, 0, 2, 2, 4])
    return np.asarray(long * np.minimum(points[-1] / omega, 1.0)[:, None] ** 6)


def _turned(values: NDArray[np.inexact], to: Array) -> NDArray[np.complex128]:
    """Return values (M, K, n) at even headings of the wave, at even headings (M, H, n) of the boat.

    ``to`` (M,) is where each wave goes. Trigonometric interpolation: exact up to K / 2 lobes.
    """
    K, H = values.shape[1], waves.LOAD_HEADINGS
    order = np.arange(-(K // 2), K // 2 + 1)
    lobes = np.fft.fft(values, axis=1)[:, order] / K * np.exp(1j * np.outer(to, order))[:, :, None]
    lobes[:, [0, -1]] *= 0.5  # K / 2 lobes turn either way
    # lobes that are alike at these headings are one. No matrix product: its rounding hangs on
    # where the numbers lie
    folded = np.zeros((len(values), H, values.shape[2]), dtype=complex)
    for k, n in enumerate(order % H):
        folded[:, n] += lobes[:, k]
    return np.asarray(np.fft.fft(folded, axis=1))


@dataclass(frozen=True)
class Sea:
    """One realisation, as the kernels read it."""

    waves: Array  # (7, M): wave components; rows in usv_gym.physics.waves
    gusts: Array  # (3, G): circular frequency, phase and amplitude of the gusts
    weather: Record  # schedule, current, mean drift and slow wind
    vessel: Vessel | None = None  # what it was made for

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
        rows = wave_rows(vessel, omega, amplitude, math.cos(to), math.sin(to), phase)
        return dataclasses.replace(cls.calm(), waves=rows, vessel=vessel)

    def arrays(self) -> ship.Sea:
        """Return the arrays that the ship's kernels take, with scratch of their own."""
        scratch = waves.factor_workspace(self.waves.shape[1])
        loads = ship.NO_LOADS if self.vessel is None else load_rows(self.vessel, self.waves)
        return ship.Sea(self.waves, self.gusts, self.weather, scratch, loads)

    def elevation(self, x: ArrayLike, y: ArrayLike, t: ArrayLike) -> Array:
        """Return the height of the sea surface above rest (m) at places (m) and times (s).

        The three are broadcast against each other.
        """
        x, y, t = np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in (x, y, t)))
        out = np.zeros(x.size)
        wx.surface(x.ravel(), y.ravel(), t.ravel(), self.waves, self.weather, out)
        return out.reshape(x.shape)
