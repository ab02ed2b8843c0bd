"""Hull forces: resistance, MMG polynomial, cross-flow drag, damping, restoring (Eq 9)."""

from __future__ import annotations

import math

import numpy as np

from usv_gym.physics import GRAVITY
from usv_gym.physics.parameters import RESISTANCE_POINTS
from usv_kernel.jit import kernel
from usv_kernel.records import Record

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)

R_PRIME_MAX = 4.0
"""Largest |r'| that the polynomial sees: turning on the spot has no r' at all."""

R_0_BAND = 0.2
"""R_0 of the MMG method changes its sign with u, over this band of u / U."""


@kernel
def resistance(u: float, p: Record) -> float:
    """Return the resistance (N, odd in u) of the upright hull at a speed u (m/s) through water.

    Monotone cubic interpolation (Fritsch-Butland slopes) through the points of the vessel
    file: smooth, without overshoot at the hump. Beyond the last point it grows with u^2.
    """
    speed = abs(u)
    a, f, last = p.resistance_speed, p.resistance_force, RESISTANCE_POINTS - 1
    while last > 1 and a[last] <= a[last - 1]:
        last -= 1
    if a[last] <= 0.0:  # the vessel has no curve
        return 0.0
    if speed >= a[last]:
        return math.copysign(f[last] * (speed / a[last]) ** 2, u)
    i = 0
    while speed >= a[i + 1]:
        i += 1
    h = a[i + 1] - a[i]
    secant = (f[i + 1] - f[i]) / h
    left = secant
    if i > 0:
        before = (f[i] - f[i - 1]) / (a[i] - a[i - 1])
        left = 2.0 * before * secant / (before + secant) if before * secant > 0.0 else 0.0
    right = secant
    if i + 1 < last:
        after = (f[i + 2] - f[i + 1]) / (a[i + 2] - a[i + 1])
        right = 2.0 * after * secant / (after + secant) if after * secant > 0.0 else 0.0
    s = (speed - a[i]) / h
    value = f[i] + h * s * (
        left + s * (3.0 * secant - 2.0 * left - right + s * (left + right - 2.0 * secant))
    )
    return math.copysign(value, u)


@kernel
def hull_forces(u: float, v: float, r: float, p: Record) -> tuple[float, float, float]:
    """Return surge and sway force (N) and yaw moment (N m) at a velocity through water.

    Source: Yasukawa and Yoshimura 2015, cross-flow drag after Fossen 2021, and linear and
    square damping in SI units as small craft are often published with. A term that the vessel
    does not have is 0. The added mass part stands in the ship's left-hand side.
    """
    L, d, rho = p.length_waterline, p.draft, p.water_density
    U = math.sqrt(u * u + v * v)
    q = 0.5 * rho * L * d * U * U
    v_ = v / max(U, 1e-9)
    r_ = L * r / max(U, abs(L * r) / R_PRIME_MAX, 1e-9)
    vv, rr, vr = v_ * v_, r_ * r_, v_ * r_
    ahead = u / max(U, 1e-9)
    X_H = -resistance(u, p) + q * (
        p.X_vv * vv
        + p.X_vr * vr
        + p.X_rr * rr
        + p.X_vvvv * vv * vv
        - p.R_0 * max(-1.0, min(1.0, ahead / R_0_BAND))
    )
    Y_H = q * (
        p.Y_v * v_
        + p.Y_r * r_
        + p.Y_vvv * vv * v_
        + p.Y_vvr * vv * r_
        + p.Y_vrr * v_ * rr
        + p.Y_rrr * rr * r_
    )
    N_H = (q * L) * (
        p.N_v * v_
        + p.N_r * r_
        + p.N_vvv * vv * v_
        + p.N_vvr * vv * r_
        + p.N_vrr * v_ * rr
        + p.N_rrr * rr * r_
    )
    side, moment = 0.0, 0.0
    for i in range(_NODES.shape[0]):
        x = 0.5 * L * _NODES[i]
        flow = v + x * r
        strip = _WEIGHTS[i] * abs(flow) * flow
        side += strip
        moment += x * strip
    drag = -0.25 * rho * d * p.C_d_crossflow * L
    X_H -= (p.D_u + p.D_uu * abs(u)) * u
    Y_H -= (p.D_v + p.D_vv * abs(v)) * v
    N_H -= (p.D_r + (p.D_rr + p.D_rrr * abs(r)) * abs(r)) * r
    return X_H, Y_H + drag * side, N_H + drag * moment


@kernel
def restoring(
    k_x: float, k_y: float, k_z: float, p_rate: float, q_rate: float, p: Record
) -> tuple[float, float, float]:
    """Return the moments K, M, N (N m) of weight and buoyancy, and of roll and pitch damping.

    ``k_x, k_y, k_z`` is the downward unit vector in the body frame; rates are in rad/s.
    Derived from the potential ``m g (GM_T k_y^2 + GM_L k_x^2) / 2``, so that no attitude
    gains energy on the way round; equal to Fossen 2021, Eq 4.16, for small angles. Damping
    is linear: shares of the critical one.
    """
    weight = p.mass * GRAVITY
    G_44, G_55 = weight * p.GM_T, weight * p.GM_L
    B_44 = 2.0 * p.zeta_roll * math.sqrt(G_44 * (p.I_xx + p.J_xx))
    B_55 = 2.0 * p.zeta_pitch * math.sqrt(G_55 * (p.I_yy + p.J_yy))
    K = -G_44 * k_y * k_z - B_44 * p_rate
    M = G_55 * k_x * k_z - B_55 * q_rate
    return K, M, (G_44 - G_55) * k_x * k_y


@kernel
def heave_force(sinkage: float, rate: float, p: Record) -> float:
    """Return the downward force (N) of the water plane, and of heave damping.

    ``sinkage`` is how deep the centre of the water plane lies below rest, m; ``rate`` its rate.
    """
    G_33 = p.water_density * GRAVITY * p.A_wp
    B_33 = 2.0 * p.zeta_heave * math.sqrt(G_33 * (p.mass + p.m_z))
    return -G_33 * sinkage - B_33 * rate
