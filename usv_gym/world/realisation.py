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
from usv_kernel.jit import kernel
from usv_kernel.records import Record
from usv_kernel.scalar import sincos

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
    rows = np.empty((waves.WAVE_ROWS, len(omega)))
    rows[waves.OMEGA], rows[waves.AMPLITUDE], rows[waves.PHASE] = omega, amplitude, phase
    rows[waves.K_NORTH], rows[waves.K_EAST] = north, east
    return complete_rows(vessel, rows)


def complete_rows(vessel: Vessel, rows: Array) -> Array:
    """Complete wave components (7, M) in place, of which the unit vectors stand for wave numbers.

    See :func:`wave_rows`.
    """
    _fill_rows(rows, vessel.values["water_density"] * GRAVITY, vessel.values["draft"])
    return rows


@kernel
def _fill_rows(rows: np.ndarray, rho_g: float, draft: float) -> None:
    """Complete wave components (7, M), of which the directions stand in place of the numbers."""
    for i in range(rows.shape[1]):
        k = rows[waves.OMEGA, i] ** 2 / GRAVITY
        fall = -math.expm1(-k * draft)
        rows[waves.K_NORTH, i] *= k
        rows[waves.K_EAST, i] *= k
        rows[waves.PRESSURE, i] = rho_g * rows[waves.AMPLITUDE, i] * fall / k
        rows[waves.BOTTOM, i] = k * math.exp(-k * draft) / fall


def drift_sums(vessel: Vessel, omega: Array, amplitude: Array, to: Array) -> Array:
    """Return the sums (6,) of mean drift by regression, see :func:`waves.mean_drift_loads`.

    ``omega`` (M,) in rad/s, ``amplitude`` (M,) in m; the waves go ``to`` (M,), rad. Length and
    number of hulls, with their draft, decide which waves are reflected.
    """
    L, sums = vessel.values["length_waterline"], np.zeros(waves.DRIFT_SUMS)
    share = np.ones(len(omega))
    if vessel.two_hulls:  # waves pass below shallow pontoons
        share = waves.reflected_by_draft(omega**2 / GRAVITY, vessel.values["draft"])
    _sum_regression(np.stack([omega, amplitude, to, share]), L, sums)
    return vessel.values["water_density"] * GRAVITY * sums


@kernel
def _sum_regression(given: np.ndarray, L: float, sums: np.ndarray) -> None:
    """Add what each wave adds to the sums (6,), over the weight of water.

    The rows ``given`` (4, M) are frequencies, amplitudes, directions and reflected shares.
    """
    for i in range(given.shape[1]):
        omega, amplitude = given[0, i], given[1, i]
        sine, cosine = sincos(given[2, i])
        coefficients = waves.drift_limited(2.0 * math.pi * GRAVITY / (omega * omega * L))
        for j in range(3):
            share = 1.0 if j == 0 else given[3, i]
            load = 0.5 * L * share * coefficients[j] * amplitude * amplitude
            load *= 1.0 if j < 2 else L
            sums[2 * j] += load * cosine
            sums[2 * j + 1] += load * sine


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
    if table is None or table.drift_around is None:
        return None
    scale = vessel.values["length_waterline"] / table.length
    points = table.omega / math.sqrt(scale)
    values = table.drift_around
    power = scale ** np.array([1.0, 1.0, 2.0])
    if (to == to[0]).all():
        total, out = np.zeros(values.shape[1:]), np.zeros((waves.LOAD_HEADINGS, 3))
        _sum_drift(np.stack([omega, amplitude]), points, values, np.zeros(len(points)), total)
        _turn(total, to.item(0), out)
        return out * power
    drift = between(omega, points, values)
    # longer waves pass by
    drift = drift * np.minimum(omega / points[0], 1.0)[:, None, None] ** 4
    return power * np.sum(amplitude[:, None, None] ** 2 * _turned(drift, to).real, axis=0)


@kernel
def _sum_drift(
    given: np.ndarray, points: np.ndarray, values: np.ndarray, shares: np.ndarray, out: np.ndarray
) -> None:
    """Add the drift of waves that go the same way to ``out`` (K, 3), at headings off theirs.

    ``shares`` (F,) are zeros: they become how much of each point's drift there is.

    The rows ``given`` (2, M) are frequencies and amplitudes. ``values`` (F, K, 3) are interpolated
    between ``points`` (F,) as :func:`usv_gym.hydro.table.between` does.
    """
    last = points.shape[0] - 1
    first = 0
    for m in range(given.shape[1]):
        omega, weight = given[0, m], given[1, m] ** 2
        # longer waves pass by
        weight *= min(omega / points[0], 1.0) ** 4
        x = min(max(omega, points[0]), points[last])
        while first > 0 and points[first + 1] >= x:
            first -= 1
        while first < last - 3 and points[first + 2] < x:
            first += 1
        for i in range(4):
            part = weight
            for j in range(4):
                if i != j:
                    distance = points[first + i] - points[first + j]
                    part *= (x - points[first + j]) / distance
            shares[first + i] += part
    for f in range(points.shape[0]):
        for k in range(out.shape[0]):
            for n in range(3):
                out[k, n] += shares[f] * values[f, k, n]


@kernel
def _turn(values: np.ndarray, to: float, out: np.ndarray) -> None:
    """Add values (K, 3) at even headings of the wave at even headings (H, 3) of the boat.

    See :func:`_turned`, for one wave and real numbers.
    """
    K, H = values.shape[0], out.shape[0]
    for n in range(K // 2 + 1):
        weight = (1.0 if n == 0 or 2 * n == K else 2.0) / K
        s_0, c_0, s_1, c_1, s_2, c_2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(K):
            s, c = sincos(2.0 * math.pi * ((n * k) % K) / K)
            s_0, c_0 = s_0 + s * values[k, 0], c_0 + c * values[k, 0]
            s_1, c_1 = s_1 + s * values[k, 1], c_1 + c * values[k, 1]
            s_2, c_2 = s_2 + s * values[k, 2], c_2 + c * values[k, 2]
        for h in range(H):
            s, c = sincos(n * (to - 2.0 * math.pi * h / H))
            out[h, 0] += weight * (c * c_0 + s * s_0)
            out[h, 1] += weight * (c * c_1 + s * s_1)
            out[h, 2] += weight * (c * c_2 + s * s_2)


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
