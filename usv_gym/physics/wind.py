"""Wind: gusts as a sum of harmonics, apparent wind, Blendermann loads (Eq 12-13)."""

from __future__ import annotations

import math

import numpy as np

from usv_gym.physics import AIR_DENSITY, frames
from usv_kernel.arrays import alloca_f64
from usv_kernel.jit import kernel
from usv_kernel.records import Record
from usv_kernel.scalar import sincos
from usv_kernel.simd import LANES


@kernel
def gust(t: float, gusts: np.ndarray) -> float:
    """Return the gust speed in m/s at time t (s).

    Rows of ``gusts`` (3, G): circular frequency (rad/s), phase (rad), amplitude (m/s).
    """
    G = gusts.shape[1]
    whole = G - G % LANES
    sums = alloca_f64(LANES)  # side by side, for vector instructions
    sums[:] = 0.0
    for begin in range(0, whole, LANES):
        for k in range(LANES):
            i = begin + k
            sums[k] += gusts[2, i] * sincos(gusts[0, i] * t + gusts[1, i])[1]
    for i in range(whole, G):
        sums[i - whole] += gusts[2, i] * sincos(gusts[0, i] * t + gusts[1, i])[1]
    half = LANES // 2
    while half > 0:
        for k in range(half):
            sums[k] += sums[k + half]
        half //= 2
    return sums[0]  # type: ignore[no-any-return]


@kernel
def coefficients(gamma: float, p: Record) -> tuple[float, float, float]:
    """Return the Blendermann wind coefficients C_X, C_Y, C_N.

    ``gamma`` is the direction of the apparent wind off the bow, rad; above 0 over the port bow.
    Source: Blendermann 1994; Eq (13), whose print lacks the minus of C_X.
    The formula for C_N holds for wind over port; the other side is its mirror image.
    """
    return _coefficients(gamma, math.cos(gamma), math.sin(gamma), p)


@kernel
def _coefficients(
    gamma: float, cosine: float, sine: float, p: Record
) -> tuple[float, float, float]:
    """Return :func:`coefficients` with cosine and sine of the direction at hand."""
    AL_AF = p.A_L / p.A_F
    CD_l_AF = p.CD_l_bow if cosine >= 0.0 else p.CD_l_stern
    CD_l = CD_l_AF / AL_AF
    CD_t = p.CD_t
    twice = 2.0 * sine * cosine
    den = 1.0 - 0.5 * p.delta_wind * (1.0 - CD_l / CD_t) * twice * twice
    C_X = -CD_l_AF * cosine / den
    C_Y = CD_t * sine / den
    arm = p.s_L / p.length_overall - 0.18 * (abs(gamma) - 0.5 * math.pi)
    return C_X, C_Y, arm * C_Y


@kernel
def wind_loads(
    u: float, v: float, psi: float, north: float, east: float, p: Record
) -> tuple[float, float, float]:
    """Return surge force, sway force (N) and yaw moment (N m) of the apparent wind.

    ``u, v`` and the air's ``north, east`` are over the ground, m/s. Source: Eq (12).
    """
    air_u, air_v = frames.to_body(north, east, psi)
    return apparent_loads(u - air_u, v - air_v, p)


@kernel
def apparent_loads(u_rw: float, v_rw: float, p: Record) -> tuple[float, float, float]:
    """Return :func:`wind_loads` of a boat that moves through the air, forward and to starboard."""
    speed = math.sqrt(u_rw * u_rw + v_rw * v_rw)
    if speed == 0.0:
        return 0.0, 0.0, 0.0
    pressure = 0.5 * AIR_DENSITY * speed * speed
    C_X, C_Y, C_N = _coefficients(-math.atan2(v_rw, u_rw), u_rw / speed, -v_rw / speed, p)
    side = pressure * p.A_L
    return pressure * p.A_F * C_X, side * C_Y, side * p.length_overall * C_N
