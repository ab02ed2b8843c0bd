"""Irregular waves: elevation, first-order loads, mean drift (Eq 14, 18-19)."""

from __future__ import annotations

import math

import numpy as np

from usv_gym.physics import parameters as par
from usv_gym.physics.frames import sincos
from usv_kernel import kernel

# rows of the array of wave components, shape (7, M)
OMEGA, K_NORTH, K_EAST, PHASE, AMPLITUDE, PRESSURE, BOTTOM = 0, 1, 2, 3, 4, 5, 6
WAVE_ROWS = 7
FACTOR_ROWS = 6
LANES = 4
DRIFT_SUMS = 6

_TINY = 1e-30


def drift_coefficients(ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the mean-drift coefficients C_X, C_Y, C_N as printed.

    Parameters
    ----------
    ratio : ndarray
        Wave length over ship length; the regression holds from 0.2 to 1.

    Notes
    -----
    Source: Eq (19), after Daidola et al. 1986.
    """
    x = np.asarray(ratio, dtype=float)
    return (
        0.05 - 0.2 * x + 0.75 * x**2 - 0.51 * x**3,
        0.46 + 6.83 * x - 15.65 * x**2 + 8.44 * x**3,
        -0.11 + 0.68 * x - 0.79 * x**2 + 0.21 * x**3,
    )


def drift_coefficients_limited(ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the mean-drift coefficients, kept to where the regression holds.

    Below 0.2 the value at 0.2 is held; from 1.0 to 1.3 it fades to nothing (cos^2): printed
    polynomials are cubic and would push a 7.5 m boat with four times its weight.
    """
    x = np.asarray(ratio, dtype=float)
    fade = np.cos(0.5 * math.pi * np.clip((x - 1.0) / 0.3, 0.0, 1.0)) ** 2
    c_x, c_y, c_n = drift_coefficients(np.clip(x, 0.2, 1.0))
    return c_x * fade, c_y * fade, c_n * fade


@kernel
def _sinc(s: float, sine: float) -> float:
    """Return sin(s)/s; the offset makes it 1 at 0 and is lost elsewhere."""
    return (sine + _TINY) / (s + _TINY)


@kernel
def _j1(s: float, sine: float, cosine: float) -> float:
    """Return (sin s - s cos s)/s^2, the first spherical Bessel function."""
    z = s * s
    series = s / 3.0 * (1.0 - z / 10.0 * (1.0 - z / 28.0 * (1.0 - z / 54.0)))
    closed = (sine - s * cosine) / (z + _TINY)
    return series if z < 0.01 else closed


@kernel
def elevation(x: float, y: float, t: float, waves: np.ndarray) -> float:
    """Return the height of the sea surface above rest in m.

    Parameters
    ----------
    x, y : float
        Place, m north and east.
    t : float
        Time, s.
    waves : ndarray, shape (6, M)
        Wave components; rows as named at the top of this file.
    """
    total = 0.0
    for i in range(waves.shape[1]):
        phase = waves[K_NORTH, i] * x + waves[K_EAST, i] * y - waves[OMEGA, i] * t
        _, c = sincos(phase + waves[PHASE, i])
        total += waves[AMPLITUDE, i] * c
    return total


@kernel
def box_factors(psi: float, waves: np.ndarray, p: np.ndarray, factors: np.ndarray) -> None:
    """Write what the length and the beam of the hull make of each component.

    They hang on the heading only, so that one evaluation, at its middle, serves a step.

    Parameters
    ----------
    psi : float
        Heading, rad.
    waves : ndarray, shape (6, M)
        Wave components; PRESSURE holds ``rho g a (1 - exp(-k d)) / k``.
    p : ndarray, shape (PACKED_SIZE,)
        Packed vessel.
    factors : ndarray, shape (6, M)
        Written in its first three rows: force per wave number, and the moment's shares of
        length and beam.
    """
    half_length = 0.5 * p[par.LENGTH]
    half_beam = 0.5 * p[par.BEAM]
    area = p[par.BLOCK] * p[par.LENGTH] * p[par.BEAM]
    cp, sp = math.cos(psi), math.sin(psi)
    for i in range(waves.shape[1]):
        s = (waves[K_NORTH, i] * cp + waves[K_EAST, i] * sp) * half_length
        c = (waves[K_EAST, i] * cp - waves[K_NORTH, i] * sp) * half_beam
        sin_s, cos_s = sincos(s)
        sin_c, cos_c = sincos(c)
        S, C = _sinc(s, sin_s), _sinc(c, sin_c)
        pressure = area * waves[PRESSURE, i]
        factors[0, i] = pressure * S * C
        # Q(s, k_x) = L^2/2 j1(s), Q(c, k_y) = B^2/2 j1(c), over L B as the forces
        factors[1, i] = pressure * half_length * C * _j1(s, sin_s, cos_s)
        factors[2, i] = pressure * half_beam * S * _j1(c, sin_c, cos_c)


@kernel
def first_order_loads(
    x: float, y: float, psi: float, t: float, waves: np.ndarray, factors: np.ndarray
) -> tuple[float, float, float]:
    """Return the first-order surge force, sway force (N) and yaw moment (N m).

    Froude-Krylov pressure integrated over a box of the hull's length, beam and draft, with
    the loads scaled by the block coefficient. The phase is taken at the moving position, so
    that encounter frequency and turning need no further thought.

    Parameters
    ----------
    x, y, psi : float
        Position in m and heading in rad.
    t : float
        Time, s.
    waves, factors : ndarray, shapes (6, M), (6, M)
        Wave components, and what :func:`box_factors` makes of them; the last three rows
        are scratch.
    """
    cp, sp = math.cos(psi), math.sin(psi)
    norths, easts, turns = factors[3], factors[4], factors[5]
    M = waves.shape[1]
    for i in range(M):
        k_north, k_east = waves[K_NORTH, i], waves[K_EAST, i]
        s, c = sincos(k_north * x + k_east * y - waves[OMEGA, i] * t + waves[PHASE, i])
        force = factors[0, i] * s
        norths[i] = k_north * force
        easts[i] = k_east * force
        k_x = k_north * cp + k_east * sp
        k_y = k_east * cp - k_north * sp
        turns[i] = c * (k_y * factors[1, i] - k_x * factors[2, i])
    # four sums at a time, in an order that no compiler changes: same seed, same bits
    a_0, a_1, a_2, a_3 = 0.0, 0.0, 0.0, 0.0
    b_0, b_1, b_2, b_3 = 0.0, 0.0, 0.0, 0.0
    c_0, c_1, c_2, c_3 = 0.0, 0.0, 0.0, 0.0
    whole = M - M % LANES
    for i in range(0, whole, LANES):
        a_0, a_1 = a_0 + norths[i], a_1 + norths[i + 1]
        a_2, a_3 = a_2 + norths[i + 2], a_3 + norths[i + 3]
        b_0, b_1 = b_0 + easts[i], b_1 + easts[i + 1]
        b_2, b_3 = b_2 + easts[i + 2], b_3 + easts[i + 3]
        c_0, c_1 = c_0 + turns[i], c_1 + turns[i + 1]
        c_2, c_3 = c_2 + turns[i + 2], c_3 + turns[i + 3]
    for i in range(whole, M):
        a_0, b_0, c_0 = a_0 + norths[i], b_0 + easts[i], c_0 + turns[i]
    north, east = (a_0 + a_1) + (a_2 + a_3), (b_0 + b_1) + (b_2 + b_3)
    N = (c_0 + c_1) + (c_2 + c_3)
    return north * cp + east * sp, east * cp - north * sp, N


@kernel
def mean_drift_loads(psi: float, sums: np.ndarray) -> tuple[float, float, float]:
    """Return the mean second-order surge force, sway force (N) and yaw moment (N m).

    Parameters
    ----------
    psi : float
        Heading, rad.
    sums : ndarray, shape (6,)
        For X, Y, N in turn: the sums over the components of ``1/2 rho g L C a^2`` (``L^2``
        for N) times the cosine and times the sine of each component's direction.

    Notes
    -----
    Source: Eq (18) with g, and L^2 in N, as the dimensions ask for.
    """
    c, s = math.cos(psi), math.sin(psi)
    # cos(mu - psi) for surge, sin(mu - psi) for sway and yaw
    X = sums[0] * c + sums[1] * s
    Y = sums[3] * c - sums[2] * s
    N = sums[5] * c - sums[4] * s
    return X, Y, N
