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
from usv_gym.physics.spectra import gust_density, to_pm_frequencies
from usv_gym.vessel.vessel import Vessel
from usv_kernel.arrays import take
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import Record
from usv_kernel.scalar import sincos

__all__ = [
    "GUST_COMPONENTS",
    "Sea",
    "drift_scratch",
    "fill_rows",
    "gust_rows",
    "interpolated",
    "load_rows",
    "pm_components",
    "sum_drift",
    "sum_regression",
]

Array = NDArray[np.float64]


@kernel
def fill_rows(rows: np.ndarray, count: int, rho_g: float, draft: float) -> None:
    """Complete the first components (7, M), whose directions are in the rows of random numbers."""
    for i in range(count):
        k = rows[waves.OMEGA, i] ** 2 / GRAVITY
        fall = -math.expm1(-k * draft)
        rows[waves.K_NORTH, i] *= k
        rows[waves.K_EAST, i] *= k
        rows[waves.PRESSURE, i] = rho_g * rows[waves.AMPLITUDE, i] * fall / k
        rows[waves.BOTTOM, i] = k * math.exp(-k * draft) / fall


@kernel
def pm_components(hs: float, omega: np.ndarray) -> None:
    """Replace uniform numbers (M,) by frequencies (rad/s) of a PM sea, of equal energy each.

    One lies at random in each of M bins: the sea never repeats.
    """
    M = omega.shape[0]
    for i in range(M):
        omega[i] = min(max((i + omega[i]) / M, 1e-12), 1.0 - 1e-12)
    to_pm_frequencies(hs, omega)


GUST_COMPONENTS = 32

_GUST_EDGES_HZ = np.geomspace(1.0 / 600.0, 0.5, GUST_COMPONENTS + 1)
_GUST_WIDTHS_HZ = np.diff(_GUST_EDGES_HZ)


@kernel
def gust_rows(kind: int, wind: float, rows: np.ndarray) -> None:
    """Replace uniform numbers in the first two rows (3, G) by gusts of a spectrum.

    See :func:`usv_gym.physics.spectra.gust_density`. The rows become circular frequency, phase and
    amplitude.
    """
    for i in range(GUST_COMPONENTS):
        width = _GUST_WIDTHS_HZ[i]
        f = _GUST_EDGES_HZ[i] + rows[0, i] * width
        rows[0, i], rows[1, i] = 2.0 * math.pi * f, 2.0 * math.pi * rows[1, i]
        rows[2, i] = math.sqrt(2.0 * gust_density(kind, f, wind) * width)


@kernel
def reflected_share(k_draft: float, table: np.ndarray) -> float:
    """Return the share of a wave's energy that hulls reflect, by wave number times draft.

    The ``table`` (2, R) is that of :func:`usv_gym.physics.waves.reflected_by_draft`; R = 0: all.
    """
    return 1.0 if table.shape[1] == 0 else interpolated(k_draft, table[0], table[1])


@kernel
def sum_regression(
    given: np.ndarray, to: float, p: Record, reflected: np.ndarray, sums: np.ndarray
) -> None:
    """Write the sums (6,) of mean drift over waves, see :func:`waves.mean_drift_loads`.

    The rows ``given`` (3, M) are frequencies, amplitudes, and directions off ``to``, rad. ``p``
    are the parameters of the boat, whose length and draft decide which waves are reflected; see
    :func:`reflected_share`.
    """
    sums[:] = 0.0
    L = p.length_waterline
    for i in range(given.shape[1]):
        omega, amplitude = given[0, i], given[1, i]
        sine, cosine = sincos(to + given[2, i])
        coefficients = waves.drift_limited(2.0 * math.pi * GRAVITY / (omega * omega * L))
        aside = reflected_share(omega * omega / GRAVITY * p.draft, reflected)
        for j in range(3):
            load = 0.5 * L * (1.0 if j == 0 else aside) * coefficients[j] * amplitude * amplitude
            load *= 1.0 if j < 2 else L
            sums[2 * j] += load * cosine
            sums[2 * j + 1] += load * sine
    for j in range(sums.shape[0]):
        sums[j] *= p.water_density * GRAVITY


@kernel
def interpolated(x: float, points: np.ndarray, values: np.ndarray) -> float:
    """Return a value at x, between those at rising points; the outermost hold beyond them."""
    low, high = 0, points.shape[0] - 1
    if x >= points[high]:
        return values[high]
    if x <= points[0]:
        return values[0]
    while high - low > 1:
        middle = (low + high) // 2
        if points[middle] <= x:
            low = middle
        else:
            high = middle
    share = (x - points[low]) / (points[high] - points[low])
    return values[low] + share * (values[high] - values[low])


_HEAVE = 2
_PITCH = 4


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
    around = amplitude[:, None, None] * _at_boat_headings(loads, to)
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


def drift_scratch(shape: tuple[int, ...]) -> int:
    """Return how many numbers :func:`sum_drift` takes for a table of a shape (F, K, 3)."""
    F, K = shape[:2]
    return F + 3 * K + 2 * K + 2 * waves.LOAD_HEADINGS


@kernel
def sum_drift(
    given: np.ndarray,
    to: float,
    scale: float,
    table: tuple[np.ndarray, np.ndarray, np.ndarray],
    out: np.ndarray,
) -> None:
    """Write the mean drift (H, 3) at even headings of the boat.

    Forces in N, moment in N m. The rows of ``given`` (3, M) are frequencies, amplitudes, and
    directions off ``to``, rad. ``table`` holds frequencies (F,), the drift (F, K, 3) at even
    headings of the wave, and scratch of :func:`drift_scratch` numbers. ``scale`` is the length of
    the boat over that of the table.
    """
    first = 0
    out[:] = 0.0
    while first < given.shape[1]:
        # waves of one direction together
        last = first + 1
        while last < given.shape[1] and given[2, last] == given[2, first]:
            last += 1
        _add_drift(given[:, first:last], to + given[2, first], scale, table, out)
        first = last
    for h in range(out.shape[0]):
        out[h, 0] *= scale
        out[h, 1] *= scale
        out[h, 2] *= scale * scale


@inlined
def _add_drift(given, to, scale, table, out):
    """Add the drift of waves that all go ``to``, for a boat as long as that of the table."""
    points, values, scratch = table
    F, K, H = values.shape[0], values.shape[1], out.shape[0]
    shares, at = take(scratch, 0, (F,))
    total, at = take(scratch, at, (K, 3))
    around, at = take(scratch, at, (K, 2))
    headings, at = take(scratch, at, (H, 2))
    shares[:] = 0.0
    total[:] = 0.0
    _share_out(given, math.sqrt(scale), points, shares)
    for f in range(F):
        if shares[f] != 0.0:
            for k in range(K):
                for j in range(3):
                    total[k, j] += shares[f] * values[f, k, j]
    for k in range(K):
        around[k, 1], around[k, 0] = sincos(2.0 * math.pi * k / K)
    for h in range(H):
        headings[h, 1], headings[h, 0] = sincos(2.0 * math.pi * h / H)
    # trigonometric interpolation, see _at_boat_headings: lobes of the wave, at headings of the boat
    for n in range(K // 2 + 1):
        weight = (1.0 if n == 0 or 2 * n == K else 2.0) / K
        s, c = sincos(n * to)
        for j in range(3):
            c_j, s_j, at = 0.0, 0.0, 0
            for k in range(K):
                c_j += around[at, 0] * total[k, j]
                s_j += around[at, 1] * total[k, j]
                at = at + n - K if at + n >= K else at + n
            # at the angle of the waves less the heading of the boat
            ahead, aside = weight * (c * c_j + s * s_j), weight * (s * c_j - c * s_j)
            step, at = n % H, 0
            for h in range(H):
                out[h, j] += headings[at, 0] * ahead + headings[at, 1] * aside
                at = at + step - H if at + step >= H else at + step


@inlined
def _share_out(given, root, points, shares):
    """Add how much of each point's drift there is, as :func:`usv_gym.hydro.table.between` does.

    ``root`` takes frequencies of the boat to those of the table.
    """
    last, first = points.shape[0] - 1, 0
    for m in range(given.shape[1]):
        omega, weight = root * given[0, m], given[1, m] ** 2
        # longer waves pass by
        weight *= min(omega / points[0], 1.0) ** 4
        x = min(max(omega, points[0]), points[last])
        while first > 0 and points[first + 1] >= x:
            first -= 1
        while first < last - 3 and points[first + 2] < x:
            first += 1
        for i in range(4):
            part, whole = weight, 1.0
            for j in range(4):
                if i != j:
                    part *= x - points[first + j]
                    whole *= points[first + i] - points[first + j]
            shares[first + i] += part / whole


def _beyond(omega: Array, points: Array) -> Array:
    """Return factors (M, 6) of loads at frequencies beyond those of a table.

    In longer waves all but heave go with the slope, in shorter ones they vanish.
    """
    long = np.minimum(omega / points[0], 1.0)[:, None] ** np.array([2.0, 2, 0, 2, 2, 4])
    return np.asarray(long * np.minimum(points[-1] / omega, 1.0)[:, None] ** 6)


def _at_boat_headings(values: NDArray[np.inexact], to: Array) -> NDArray[np.complex128]:
    """Return values (M, K, n) at even headings of the wave, at even headings (M, H, n) of the boat.

    ``to`` (M,) is where each wave goes. Trigonometric interpolation: exact up to K / 2 lobes.
    """
    K, H = values.shape[1], waves.LOAD_HEADINGS
    order = np.arange(-(K // 2), K // 2 + 1)
    lobes = np.fft.fft(values, axis=1)[:, order] / K * np.exp(1j * np.outer(to, order))[:, :, None]
    lobes[:, [0, -1]] *= 0.5  # K / 2 lobes turn either way
    # lobes that are alike at these headings are one. No matrix product: its rounding depends on
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
        rows = np.zeros((waves.WAVE_ROWS, 1))
        rows[waves.OMEGA], rows[waves.AMPLITUDE], rows[waves.PHASE] = omega, amplitude, phase
        rows[waves.K_NORTH], rows[waves.K_EAST] = math.cos(to), math.sin(to)
        fill_rows(rows, 1, vessel.values["water_density"] * GRAVITY, vessel.values["draft"])
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
