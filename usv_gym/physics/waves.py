"""Irregular waves: elevation, first-order loads, mean drift (Eq 14, 18-19)."""

from __future__ import annotations

import math

import numpy as np

from usv_gym.physics import parameters as par
from usv_gym.physics.frames import sincos
from usv_kernel import kernel

# rows of the array of wave components, shape (7, M); PRESSURE is rho g a integrated over the
# draft (N/m), BOTTOM the share of it that acts on a metre at the bottom (1/m)
OMEGA, K_NORTH, K_EAST, PHASE, AMPLITUDE, PRESSURE, BOTTOM = 0, 1, 2, 3, 4, 5, 6
WAVE_ROWS = 7
# what hull and heading make of each component, then scratch
FORCE, YAW_LENGTH, YAW_BEAM, ORBITAL, SCRATCH = 0, 1, 2, 3, 4
FACTOR_ROWS = SCRATCH + 7
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
    waves : ndarray, shape (7, M)
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
    waves : ndarray, shape (7, M)
        Wave components.
    p : ndarray, shape (PACKED_SIZE,)
        Packed vessel.
    factors : ndarray, shape (11, M)
        Written in its first four rows: force per wave number, the moment's shares of length
        and beam, and the orbital velocity per wave number.
    """
    half_length = 0.5 * p[par.LENGTH]
    half_beam = 0.5 * p[par.BEAM]
    area = p[par.BLOCK] * p[par.LENGTH] * p[par.BEAM]
    mass_per_area = p[par.DENSITY] * p[par.DRAFT]
    cp, sp = math.cos(psi), math.sin(psi)
    for i in range(waves.shape[1]):
        s = (waves[K_NORTH, i] * cp + waves[K_EAST, i] * sp) * half_length
        c = (waves[K_EAST, i] * cp - waves[K_NORTH, i] * sp) * half_beam
        sin_s, cos_s = sincos(s)
        sin_c, cos_c = sincos(c)
        S, C = _sinc(s, sin_s), _sinc(c, sin_c)
        pressure = area * waves[PRESSURE, i]
        factors[FORCE, i] = pressure * S * C
        # Q(s, k_x) = L^2/2 j1(s), Q(c, k_y) = B^2/2 j1(c), over L B as the forces
        factors[YAW_LENGTH, i] = pressure * half_length * C * _j1(s, sin_s, cos_s)
        factors[YAW_BEAM, i] = pressure * half_beam * S * _j1(c, sin_c, cos_c)
        factors[ORBITAL, i] = (
            waves[PRESSURE, i] * S * C / (mass_per_area * (waves[OMEGA, i] + _TINY))
        )


@kernel
def _sum_rows(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[float, float, float]:
    """Return three sums, four terms at a time, in an order that no compiler changes."""
    a_0, a_1, a_2, a_3 = 0.0, 0.0, 0.0, 0.0
    b_0, b_1, b_2, b_3 = 0.0, 0.0, 0.0, 0.0
    c_0, c_1, c_2, c_3 = 0.0, 0.0, 0.0, 0.0
    M = a.shape[0]
    whole = M - M % LANES
    for i in range(0, whole, LANES):
        a_0, a_1, a_2, a_3 = a_0 + a[i], a_1 + a[i + 1], a_2 + a[i + 2], a_3 + a[i + 3]
        b_0, b_1, b_2, b_3 = b_0 + b[i], b_1 + b[i + 1], b_2 + b[i + 2], b_3 + b[i + 3]
        c_0, c_1, c_2, c_3 = c_0 + c[i], c_1 + c[i + 1], c_2 + c[i + 2], c_3 + c[i + 3]
    for i in range(whole, M):
        a_0, b_0, c_0 = a_0 + a[i], b_0 + b[i], c_0 + c[i]
    return (a_0 + a_1) + (a_2 + a_3), (b_0 + b_1) + (b_2 + b_3), (c_0 + c_1) + (c_2 + c_3)


@kernel
def first_order_loads(
    x: float,
    y: float,
    psi: float,
    t: float,
    waves: np.ndarray,
    p: np.ndarray,
    dof: int,
    factors: np.ndarray,
) -> tuple[float, float, float, float, float, float, float, float]:
    """Return the first-order loads and the water's motion in the frame of the heading.

    Froude-Krylov pressure integrated over a box of the hull's length, beam and draft. The
    horizontal loads are scaled by the block coefficient, heave by the water plane, roll and
    pitch by the restoring moments, so that a long wave lifts the boat by its height and
    tilts it by its slope. The phase is taken at the moving position, so that encounter
    frequency and turning need no further thought.

    Parameters
    ----------
    x, y, psi : float
        Position in m and heading in rad.
    t : float
        Time, s.
    waves : ndarray, shape (7, M)
        Wave components.
    p : ndarray, shape (PACKED_SIZE,)
        Packed vessel.
    dof : int
        3 or 6.
    factors : ndarray, shape (11, M)
        What :func:`box_factors` makes of the components; the last rows are scratch.

    Returns
    -------
    X, Y, N, Z, K, M, u, v : float
        Forces forward and to starboard (N), yaw moment (N m); with ``dof`` 6 also the
        downward force and the roll and pitch moments, else zeros; and the orbital velocity
        of the water forward and to starboard, mean over the hull (m/s).

    Notes
    -----
    Source: physics.md 2.3 C.
    """
    cp, sp = math.cos(psi), math.sin(psi)
    a, b, c = factors[SCRATCH], factors[SCRATCH + 1], factors[SCRATCH + 2]
    d, e = factors[SCRATCH + 3], factors[SCRATCH + 4]
    sines, cosines = factors[SCRATCH + 5], factors[SCRATCH + 6]
    for i in range(waves.shape[1]):
        k_north, k_east = waves[K_NORTH, i], waves[K_EAST, i]
        sine, cosine = sincos(k_north * x + k_east * y - waves[OMEGA, i] * t + waves[PHASE, i])
        force = factors[FORCE, i] * sine
        a[i] = k_north * force
        b[i] = k_east * force
        k_x = k_north * cp + k_east * sp
        k_y = k_east * cp - k_north * sp
        c[i] = cosine * (k_y * factors[YAW_LENGTH, i] - k_x * factors[YAW_BEAM, i])
        orbital = factors[ORBITAL, i] * cosine
        d[i] = k_north * orbital
        e[i] = k_east * orbital
        sines[i], cosines[i] = sine, cosine
    north, east, N = _sum_rows(a, b, c)
    X, Y = north * cp + east * sp, east * cp - north * sp
    if dof == 6:
        for i in range(waves.shape[1]):
            a[i] = waves[BOTTOM, i] * factors[FORCE, i] * cosines[i]
            b[i] = waves[BOTTOM, i] * factors[YAW_LENGTH, i] * sines[i]
            c[i] = waves[BOTTOM, i] * factors[YAW_BEAM, i] * sines[i]
    north, east, lift = _sum_rows(d, e, a)
    u, v = north * cp + east * sp, east * cp - north * sp
    if dof != 6:
        return X, Y, N, 0.0, 0.0, 0.0, u, v
    trim, heel, _ = _sum_rows(b, c, c)
    L, B = p[par.LENGTH], p[par.BEAM]
    area = p[par.BLOCK] * L * B
    restoring = 12.0 * p[par.MASS] / (p[par.DENSITY] * area)
    Z = -lift * p[par.A_WP] / area
    K = heel * restoring * p[par.GM_T] / (B * B)
    M = -trim * restoring * p[par.GM_L] / (L * L)
    return X, Y, N, Z, K, M, u, v


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
