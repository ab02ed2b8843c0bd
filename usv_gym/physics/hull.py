"""Hull forces: resistance, MMG polynomial, cross-flow drag, damping, restoring (Eq 9)."""

from __future__ import annotations

import math

import numpy as np

from usv_gym.physics import GRAVITY
from usv_gym.physics import parameters as par
from usv_kernel.jit import kernel

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)

R_PRIME_MAX = 4.0
"""Largest |r'| that the polynomial sees: turning on the spot has no r' at all."""

R_0_BAND = 0.2
"""R_0 of the MMG method changes its sign with u, over this band of u / U."""


@kernel
def resistance(u: float, p: np.ndarray) -> float:
    """Return the resistance of the upright hull sailing straight, in N, odd in u.

    Monotone cubic interpolation (Fritsch-Butland slopes) through the points of the vessel
    file: smooth, without overshoot at the hump. Beyond the last point it grows with u^2.

    Parameters
    ----------
    u : float
        Speed through water in m/s.
    p : ndarray, shape (PACKED_SIZE,)
        Packed vessel.
    """
    speed = abs(u)
    a, f, last = par.RESISTANCE_SPEEDS, par.RESISTANCE_FORCES, par.RESISTANCE_POINTS - 1
    while last > 1 and p[a + last] <= p[a + last - 1]:
        last -= 1
    if p[a + last] <= 0.0:  # the vessel has no curve
        return 0.0
    if speed >= p[a + last]:
        return math.copysign(p[f + last] * (speed / p[a + last]) ** 2, u)
    i = 0
    while speed >= p[a + i + 1]:
        i += 1
    h = p[a + i + 1] - p[a + i]
    secant = (p[f + i + 1] - p[f + i]) / h
    left = secant
    if i > 0:
        before = (p[f + i] - p[f + i - 1]) / (p[a + i] - p[a + i - 1])
        left = 2.0 * before * secant / (before + secant) if before * secant > 0.0 else 0.0
    right = secant
    if i + 1 < last:
        after = (p[f + i + 2] - p[f + i + 1]) / (p[a + i + 2] - p[a + i + 1])
        right = 2.0 * after * secant / (after + secant) if after * secant > 0.0 else 0.0
    s = (speed - p[a + i]) / h
    value = p[f + i] + h * s * (
        left + s * (3.0 * secant - 2.0 * left - right + s * (left + right - 2.0 * secant))
    )
    return math.copysign(value, u)


@kernel
def hull_forces(u: float, v: float, r: float, p: np.ndarray) -> tuple[float, float, float]:
    """Return the hull's surge force, sway force (N) and yaw moment (N m).

    Parameters
    ----------
    u, v, r : float
        Velocity through water at midship, m/s and rad/s.
    p : ndarray, shape (PACKED_SIZE,)
        Packed vessel.

    Notes
    -----
    Source: Yasukawa and Yoshimura 2015, cross-flow drag after Fossen 2021, and linear and
    square damping in SI units as small craft are often published with. A term that the vessel
    does not have is 0. The added mass part stands in the ship's left-hand side.
    """
    L, d, rho = p[par.LENGTH], p[par.DRAFT], p[par.DENSITY]
    U = math.sqrt(u * u + v * v)
    q = 0.5 * rho * L * d * U * U
    v_ = v / max(U, 1e-9)
    r_ = L * r / max(U, abs(L * r) / R_PRIME_MAX, 1e-9)
    vv, rr, vr = v_ * v_, r_ * r_, v_ * r_
    ahead = u / max(U, 1e-9)
    X_H = -resistance(u, p) + q * (
        p[par.X_VV] * vv
        + p[par.X_VR] * vr
        + p[par.X_RR] * rr
        + p[par.X_VVVV] * vv * vv
        - p[par.R_0] * max(-1.0, min(1.0, ahead / R_0_BAND))
    )
    Y_H = q * (
        p[par.Y_V] * v_
        + p[par.Y_R] * r_
        + p[par.Y_VVV] * vv * v_
        + p[par.Y_VVR] * vv * r_
        + p[par.Y_VRR] * v_ * rr
        + p[par.Y_RRR] * rr * r_
    )
    N_H = (q * L) * (
        p[par.N_V] * v_
        + p[par.N_R] * r_
        + p[par.N_VVV] * vv * v_
        + p[par.N_VVR] * vv * r_
        + p[par.N_VRR] * v_ * rr
        + p[par.N_RRR] * rr * r_
    )
    side, moment = 0.0, 0.0
    for i in range(_NODES.shape[0]):
        x = 0.5 * L * _NODES[i]
        flow = v + x * r
        strip = _WEIGHTS[i] * abs(flow) * flow
        side += strip
        moment += x * strip
    drag = -0.25 * rho * d * p[par.CROSSFLOW] * L
    X_H -= (p[par.D_U] + p[par.D_UU] * abs(u)) * u
    Y_H -= (p[par.D_V] + p[par.D_VV] * abs(v)) * v
    N_H -= (p[par.D_R] + (p[par.D_RR] + p[par.D_RRR] * abs(r)) * abs(r)) * r
    return X_H, Y_H + drag * side, N_H + drag * moment


@kernel
def restoring(
    k_x: float, k_y: float, k_z: float, p_rate: float, q_rate: float, p: np.ndarray
) -> tuple[float, float, float]:
    """Return the moments K, M, N (N m) of weight and buoyancy, and of roll and pitch damping.

    Parameters
    ----------
    k_x, k_y, k_z : float
        The downward unit vector in the body frame.
    p_rate, q_rate : float
        Roll and pitch rate, rad/s.
    p : ndarray, shape (PACKED_SIZE,)
        Packed vessel.

    Notes
    -----
    Derived from the potential ``m g (GM_T k_y^2 + GM_L k_x^2) / 2``, so that no attitude
    gains energy on the way round; equal to Fossen 2021, Eq 4.16, for small angles. Damping
    is linear: shares of the critical one.
    """
    weight = p[par.MASS] * GRAVITY
    G_44, G_55 = weight * p[par.GM_T], weight * p[par.GM_L]
    B_44 = 2.0 * p[par.ZETA_ROLL] * math.sqrt(G_44 * (p[par.I_XX] + p[par.J_XX]))
    B_55 = 2.0 * p[par.ZETA_PITCH] * math.sqrt(G_55 * (p[par.I_YY] + p[par.J_YY]))
    K = -G_44 * k_y * k_z - B_44 * p_rate
    M = G_55 * k_x * k_z - B_55 * q_rate
    return K, M, (G_44 - G_55) * k_x * k_y


@kernel
def heave_force(sinkage: float, rate: float, p: np.ndarray) -> float:
    """Return the downward force (N) of the water plane, and of heave damping.

    Parameters
    ----------
    sinkage, rate : float
        How deep the centre of the water plane lies below rest (m), and how fast it goes
        down (m/s).
    p : ndarray, shape (PACKED_SIZE,)
        Packed vessel.
    """
    G_33 = p[par.DENSITY] * GRAVITY * p[par.A_WP]
    B_33 = 2.0 * p[par.ZETA_HEAVE] * math.sqrt(G_33 * (p[par.MASS] + p[par.M_Z]))
    return -G_33 * sinkage - B_33 * rate
