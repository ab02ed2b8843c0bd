"""Rigid body and added mass: from forces to accelerations (Eq 4-8)."""

from __future__ import annotations

from usv_kernel.jit import kernel
from usv_kernel.records import Record


@kernel
def accelerate_3(
    X: float, Y: float, N: float, u: float, v: float, r: float, p: Record
) -> tuple[float, float, float]:
    """Return the accelerations of surge, sway and yaw; heave, roll and pitch are held.

    Forces and moment are about the origin; u, v, r through water.
    Source: Yasukawa and Yoshimura 2015, midship origin. The moment that the added masses make
    in drift (Munk) stands in N_v.
    """
    m, m_x, m_y, x_G = p.mass, p.m_x, p.m_y, p.x_G
    m_xG = m * x_G
    X += (m + m_y) * v * r + m_xG * r * r
    Y -= (m + m_x) * u * r
    N -= m_xG * u * r
    a, c = m + m_y, p.I_zz + m_xG * x_G + p.J_zz
    det = a * c - m_xG * m_xG
    return X / (m + m_x), (c * Y - m_xG * N) / det, (a * N - m_xG * Y) / det


@kernel
def _solve(rows: tuple[float, ...], right: tuple[float, float, float]) -> tuple[float, ...]:
    """Solve the symmetric system with rows (a b c), (b d e), (c e f)."""
    a, b, c, d, e, f = rows
    x, y, z = right
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    D, E, F = a * f - c * c, b * c - a * e, a * d - b * b
    det = a * A + b * B + c * C
    return (
        (A * x + B * y + C * z) / det,
        (B * x + D * y + E * z) / det,
        (C * x + E * y + F * z) / det,
    )


@kernel
def accelerate_6(
    forces: tuple[float, ...], velocity: tuple[float, ...], vessel: Record
) -> tuple[float, ...]:
    """Return the accelerations in all six degrees of freedom.

    Forces X, Y, Z, K, M, N are about the origin in the water line; velocity is through water.
    Source: Eq (6) as restored in ship_and_sea.md (SNAME) with ``y_G = 0`` and the axes of inertia
    along the body. The added masses of surge and sway act ``z_H`` below the water line, and as in
    the MMG standard method in the horizontal plane. That of heave acts at the centre of the water
    plane and moves with the boat, so that the period of heave does not depend on the speed. Strip
    theory's lift at speed would be wrong for planing hulls. With w = p = q = 0 and held, the rows
    of X, Y and N are those of :func:`accelerate_3`.
    """
    X, Y, Z, K, M, N = forces
    u, v, w, p, q, r = velocity
    m, m_x, m_y, m_z = vessel.mass, vessel.m_x, vessel.m_y, vessel.m_z
    x_G, z_G, z_H, x_F = vessel.x_G, vessel.draft - vessel.KG, vessel.z_H, vessel.x_F
    I_x = vessel.I_xx + vessel.J_xx + m * z_G * z_G
    I_y = vessel.I_yy + vessel.J_yy + m * (x_G * x_G + z_G * z_G)
    I_z = vessel.I_zz + vessel.J_zz + m * x_G * x_G
    I_xz = m * x_G * z_G

    # the added masses, at their depth
    u_H, v_H = u + z_H * q, v - z_H * p
    X_A, Y_A = m_y * v_H * r, -m_x * u_H * r
    a_x, a_y, a_z = v * r - w * q, w * p - u * r, u * q - v * p
    # that of heave, a mass that moves with the boat and resists along z only
    sinking, a_F = m_z * (w - x_F * q), m_z * (a_z - x_F * r * p)
    X += X_A + m * (a_x + x_G * (q * q + r * r) - z_G * p * r) - sinking * q
    Y += Y_A + m * (a_y - z_G * q * r - x_G * q * p) + sinking * p
    Z += m * (a_z + z_G * (p * p + q * q) - x_G * r * p) + a_F
    M -= x_F * a_F
    N += x_F * sinking * p
    K += -z_H * Y_A - (I_z - I_y) * q * r + p * q * I_xz - m * z_G * a_y
    M += z_H * X_A - (I_x - I_z) * r * p - (p * p - r * r) * I_xz + m * (z_G * a_x - x_G * a_z)
    N += -(I_y - I_x) * p * q - r * q * I_xz + m * x_G * a_y

    du, dw, dq = _solve(
        (
            m + m_x,
            0.0,
            m * z_G + m_x * z_H,
            m + m_z,
            -m * x_G - m_z * x_F,
            I_y + m_x * z_H * z_H + m_z * x_F * x_F,
        ),
        (X, Z, M),
    )
    dv, dp, dr = _solve(
        (m + m_y, -m * z_G - m_y * z_H, m * x_G, I_x + m_y * z_H * z_H, -I_xz, I_z), (Y, K, N)
    )
    return du, dv, dw, dp, dq, dr
