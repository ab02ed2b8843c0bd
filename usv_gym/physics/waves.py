"""Irregular waves: elevation, first-order loads, mean drift (Eq 14, 18-19)."""

from __future__ import annotations

import math

import numpy as np

from usv_kernel.jit import kernel
from usv_kernel.records import Record
from usv_kernel.scalar import fma, sincos
from usv_kernel.simd import dots, padded

# rows of the array of wave components, shape (7, M). PRESSURE is rho g a integrated over the draft
# (N/m), BOTTOM the share of it that acts on a metre at the bottom (1/m)
OMEGA, K_NORTH, K_EAST, PHASE, AMPLITUDE, PRESSURE, BOTTOM = 0, 1, 2, 3, 4, 5, 6

WAVE_ROWS = 7

# factors of each component from hull and heading. With its sine or cosine they give forces to north
# and east, the yaw moment in two parts, and the velocity of the water. Then lift, trim, heel;
# scratch
FORCE_NORTH, FORCE_EAST, YAW_ALONG, YAW_ACROSS, ORBIT_NORTH, ORBIT_EAST = 0, 1, 2, 3, 4, 5

LIFT, TRIM, HEEL, SCRATCH = 6, 7, 8, 9

# rows of the loads of a hydrodynamic table (H, 14, M), at H headings of the boat: X, Y, Z, K, M, N
# that go with the cosine of a component's phase, then with its sine, and the velocity of the water
# forward and to starboard, with the cosine
COSINE_LOADS = 0
SINE_LOADS = 6
ORBIT_FORWARD = 12
ORBIT_STARBOARD = 13

LOAD_ROWS = 14

FACTOR_ROWS = LOAD_ROWS + 2

LOAD_HEADINGS = 24
"""Headings of the boat at which a sea has loads, and mean drift; between them cubic."""

DRIFT_SUMS = 6

_TINY = 1e-30


@kernel
def drift_coefficients(ratio: float) -> tuple[float, float, float]:
    """Return the mean-drift coefficients C_X, C_Y, C_N as printed.

    ``ratio`` is wave length over ship length; the regression holds from 0.2 to 1.
    Source: Eq (19), after Daidola et al. 1986.
    """
    x = ratio
    return (
        0.05 + x * (-0.2 + x * (0.75 - 0.51 * x)),
        0.46 + x * (6.83 + x * (-15.65 + 8.44 * x)),
        -0.11 + x * (0.68 + x * (-0.79 + 0.21 * x)),
    )


@kernel
def drift_limited(ratio: float) -> tuple[float, float, float]:
    """Return the mean-drift coefficients, kept to where the regression holds.

    Below 0.2 the value at 0.2 is held; from 1.0 to 1.3 it fades to nothing (cos^2). Printed
    polynomials are cubic and would push a 7.5 m boat with four times its weight. C_Y is at most 1,
    the drift of a wall that reflects all.
    """
    fade = math.cos(0.5 * math.pi * min(max((ratio - 1.0) / 0.3, 0.0), 1.0)) ** 2
    c_x, c_y, c_n = drift_coefficients(min(max(ratio, 0.2), 1.0))
    return c_x * fade, min(c_y, 1.0) * fade, c_n * fade


def reflected_by_draft(k: np.ndarray, draft: float) -> np.ndarray:
    """Return the share of a wave's energy that a vertical wall as deep as the draft reflects.

    ``k`` is the wave number, 1/m. Source: Ursell 1947, with 1.5 times the draft as in Fujii and
    Takahashi 1975.
    """
    from scipy.special import i1, k1  # takes a while, and few vessels need it

    depth = 1.5 * draft * np.asarray(k, dtype=float)
    within = (math.pi * i1(np.minimum(depth, 20.0))) ** 2
    return np.asarray(within / (within + k1(depth) ** 2))


@kernel
def elevation(x: float, y: float, t: float, waves: np.ndarray) -> float:
    """Return the height of the sea surface above rest in m, at a place (m) and time (s)."""
    total = 0.0
    for i in range(waves.shape[1]):
        phase = waves[K_NORTH, i] * x + waves[K_EAST, i] * y - waves[OMEGA, i] * t
        total += waves[AMPLITUDE, i] * sincos(phase + waves[PHASE, i])[1]
    return total


def factor_workspace(components: int) -> np.ndarray:
    """Return the workspace of :func:`wave_factors` for a number of components, (16, width).

    Rows are filled up with zeros, see :func:`~usv_kernel.simd.padded`.
    """
    return np.zeros((FACTOR_ROWS, padded(components)))


@kernel
def _shape(
    north: np.ndarray, east: np.ndarray, a: float, b: float, sinc: np.ndarray, bessel: np.ndarray
) -> None:
    """Write sin(s)/s and j1(s) = (sin s - s cos s)/s^2 for s = a north + b east."""
    for i in range(north.shape[0]):
        s = a * north[i] + b * east[i]
        sine, cosine = sincos(s)
        z = s * s
        # the offset makes sin(s)/s 1 at 0 and is lost elsewhere
        inverse = 1.0 / (s + _TINY)
        ratio = (sine + _TINY) * inverse
        series = s * (1.0 / 3.0 - z * (1.0 / 30.0 - z * (1.0 / 840.0 - z / 45360.0)))
        sinc[i] = ratio
        bessel[i] = series if z < 0.01 else (ratio - cosine) * inverse


# LLVM vectorises a loop only if it can check beforehand that its rows do not overlap, which it does
# for few rows. So the loops below are short.
@kernel
def _scale(row: np.ndarray, by: np.ndarray, out: np.ndarray) -> None:
    """Write the product of two rows."""
    for i in range(row.shape[0]):
        out[i] = by[i] * row[i]


@kernel
def box_factors(psi: float, waves: np.ndarray, p: Record, dof: int, factors: np.ndarray) -> None:
    """Write what the length and the beam of the hull make of each component.

    They depend on the heading only, so that one evaluation, at its middle, serves a step. ``dof``
    3 leaves lift, trim and heel out. ``factors`` (16, padded(M)) is from :func:`factor_workspace`.
    """
    M = waves.shape[1]
    half_length, half_beam = 0.5 * p.length_waterline, 0.5 * p.beam
    area = p.block_coefficient * p.length_waterline * p.beam
    mass = p.water_density * p.draft * area
    sp, cp = sincos(psi)
    north, east, pressure = waves[K_NORTH], waves[K_EAST], waves[PRESSURE]
    S, C = factors[SCRATCH, :M], factors[SCRATCH + 1, :M]
    along, across = factors[SCRATCH + 2, :M], factors[SCRATCH + 3, :M]
    _shape(north, east, half_length * cp, half_length * sp, S, along)
    _shape(north, east, -half_beam * sp, half_beam * cp, C, across)
    # Q(s, k_x) = L^2/2 j1(s), Q(c, k_y) = B^2/2 j1(c), over L B as the forces
    for i in range(M):
        along[i] *= half_length * area * pressure[i] * C[i]
    for i in range(M):
        across[i] *= half_beam * area * pressure[i] * S[i]
    for i in range(M):
        S[i] *= area * pressure[i] * C[i]
    _scale(S, north, factors[FORCE_NORTH, :M])
    _scale(S, east, factors[FORCE_EAST, :M])
    # (k_y along - k_x across) turned to north and east
    row = factors[YAW_ALONG, :M]
    for i in range(M):
        row[i] = east[i] * along[i] - north[i] * across[i]
    row = factors[YAW_ACROSS, :M]
    for i in range(M):
        row[i] = north[i] * along[i] + east[i] * across[i]
    for i in range(M):
        C[i] = 1.0 / (mass * (waves[OMEGA, i] + _TINY))
    _scale(C, factors[FORCE_NORTH, :M], factors[ORBIT_NORTH, :M])
    _scale(C, factors[FORCE_EAST, :M], factors[ORBIT_EAST, :M])
    if dof == 6:
        _scale(S, waves[BOTTOM], factors[LIFT, :M])
        _scale(along, waves[BOTTOM], factors[TRIM, :M])
        _scale(across, waves[BOTTOM], factors[HEEL, :M])


@kernel
def _around(psi: float, count: int) -> tuple[int, int, int, int, float]:
    """Return the four of even headings next to psi, and psi's share between the middle two.

    They are those of :func:`_weights`.
    """
    place = psi * (count / (2.0 * math.pi))
    whole = math.floor(place)
    i = int(whole) % count
    return (i + count - 1) % count, i, (i + 1) % count, (i + 2) % count, place - whole


@kernel
def _weights(s: float) -> tuple[float, float, float, float]:
    """Return the weights of the four values at -1, 0, 1, 2 of the cubic through them, at s."""
    below, above, far = 1.0 + s, 1.0 - s, 2.0 - s
    middle = 0.5 * far * below
    outer = -s * above / 6.0
    return outer * far, middle * above, middle * s, outer * below


@kernel
def _blend(rows: tuple[np.ndarray, ...], weights: tuple[float, ...], out: np.ndarray) -> None:
    """Write the weighted sum of four rows."""
    a, b, c, d = rows
    f, g, h, k = weights
    for i in range(out.shape[0]):
        out[i] = f * a[i] + g * b[i] + h * c[i] + k * d[i]


@kernel
def wave_factors(
    psi: float, waves: np.ndarray, loads: np.ndarray, p: Record, dof: int, factors: np.ndarray
) -> None:
    """Write the factors of each component at a heading.

    They are from ``loads`` (H, 14, M), as a hydrodynamic table says, with six degrees of freedom
    and H above 0. Else they are those of :func:`box_factors`.
    """
    if dof != 6 or loads.shape[0] == 0:
        box_factors(psi, waves, p, dof, factors)
        return
    M = waves.shape[1]
    a, b, c, d, s = _around(psi, loads.shape[0])
    weights = _weights(s)
    for j in range(LOAD_ROWS):
        _blend((loads[a, j], loads[b, j], loads[c, j], loads[d, j]), weights, factors[j, :M])


@kernel
def table_loads(
    x: float, y: float, t: float, waves: np.ndarray, factors: np.ndarray
) -> tuple[float, float, float, float, float, float, float, float]:
    """Return the first-order loads of a hydrodynamic table, and the water's motion.

    ``factors`` is what :func:`wave_factors` makes of loads and heading. Returned are X, Y, Z (N,
    down), K, M, N (N m) about the origin, level in the frame of the heading. They push the boat and
    its added mass. Then come u, v of the water as in :func:`first_order_loads`.
    """
    M = waves.shape[1]
    sines, cosines = factors[LOAD_ROWS], factors[LOAD_ROWS + 1]
    for i in range(M):
        phase = fma(waves[K_NORTH, i], x, waves[PHASE, i] - waves[OMEGA, i] * t)
        sines[i], cosines[i] = sincos(fma(waves[K_EAST, i], y, phase))
    X, Y = dots(factors[0], factors[1], cosines)
    Z, K = dots(factors[2], factors[3], cosines)
    M_pitch, N = dots(factors[4], factors[5], cosines)
    X_sine, Y_sine = dots(factors[6], factors[7], sines)
    Z_sine, K_sine = dots(factors[8], factors[9], sines)
    M_sine, N_sine = dots(factors[10], factors[11], sines)
    u, v = dots(factors[ORBIT_FORWARD], factors[ORBIT_STARBOARD], cosines)
    return X + X_sine, Y + Y_sine, Z + Z_sine, K + K_sine, M_pitch + M_sine, N + N_sine, u, v


@kernel
def first_order_loads(
    x: float,
    y: float,
    psi: float,
    t: float,
    waves: np.ndarray,
    p: Record,
    dof: int,
    factors: np.ndarray,
) -> tuple[float, float, float, float, float, float, float, float]:
    """Return the first-order loads and the water's motion in the frame of the heading.

    Froude-Krylov pressure integrated over a box of the hull's length, beam and draft. The
    horizontal loads are scaled by the block coefficient, heave by the water plane, roll and pitch
    by the restoring moments. So a long wave lifts the boat by its height and tilts it by its slope.
    The phase is taken at the moving position, so that encounter frequency and turning need no
    further thought.

    ``factors`` is what :func:`box_factors` makes of the waves (7, M); its last rows are scratch.
    Returned are X, Y (N), N (N m); Z (N, down), K, M (N m), zeros with ``dof`` 3. Then come u, v of
    the water's orbital motion forward and to starboard, mean over the hull (m/s).

    Source: ship_and_sea.md.
    """
    M = waves.shape[1]
    sp, cp = sincos(psi)
    sines, cosines = factors[SCRATCH], factors[SCRATCH + 1]
    for i in range(M):
        phase = fma(waves[K_NORTH, i], x, waves[PHASE, i] - waves[OMEGA, i] * t)
        sines[i], cosines[i] = sincos(fma(waves[K_EAST, i], y, phase))
    north, east = dots(factors[FORCE_NORTH], factors[FORCE_EAST], sines)
    X, Y = north * cp + east * sp, east * cp - north * sp
    along, across = dots(factors[YAW_ALONG], factors[YAW_ACROSS], cosines)
    N = along * cp - across * sp
    north, east = dots(factors[ORBIT_NORTH], factors[ORBIT_EAST], cosines)
    u, v = north * cp + east * sp, east * cp - north * sp
    if dof != 6:
        return X, Y, N, 0.0, 0.0, 0.0, u, v
    lift = dots(factors[LIFT], factors[LIFT], cosines)[0]
    trim, heel = dots(factors[TRIM], factors[HEEL], sines)
    L, B = p.length_waterline, p.beam
    area = p.block_coefficient * L * B
    restoring = 12.0 * p.mass / (p.water_density * area)
    Z = -lift * p.A_wp / area
    K = heel * restoring * p.GM_T / (B * B)
    M_pitch = -trim * restoring * p.GM_L / (L * L)
    return X, Y, N, Z, K, M_pitch, u, v


@kernel
def mean_drift_loads(psi: float, sums: np.ndarray) -> tuple[float, float, float]:
    """Return the mean second-order surge force, sway force (N) and yaw moment (N m).

    ``sums`` (6,) holds sums over the components for X, Y, N in turn. They are of ``1/2 rho g L C
    a^2`` (``L^2`` for N), times the cosine and times the sine of the component's direction.
    Source: Eq (18) with g, and L^2 in N, as the dimensions ask for.
    """
    s, c = sincos(psi)
    # cos(mu - psi) for surge, sin(mu - psi) for sway and yaw
    X = sums[0] * c + sums[1] * s
    Y = sums[3] * c - sums[2] * s
    N = sums[5] * c - sums[4] * s
    return X, Y, N


@kernel
def drift_at(psi: float, table: np.ndarray) -> tuple[float, float, float]:
    """Return the mean second-order X, Y (N) and N (N m) from those at even headings (H, 3)."""
    a, b, c, d, s = _around(psi, table.shape[0])
    f, g, h, k = _weights(s)
    X = f * table[a, 0] + g * table[b, 0] + h * table[c, 0] + k * table[d, 0]
    Y = f * table[a, 1] + g * table[b, 1] + h * table[c, 1] + k * table[d, 1]
    N = f * table[a, 2] + g * table[b, 2] + h * table[c, 2] + k * table[d, 2]
    return X, Y, N
