"""Derivatives of a structure's terms by velocities and heading."""

from __future__ import annotations

import math

import numpy as np

from twin.model.structure import (
    ADVANCE_COS,
    ADVANCE_SIN,
    AU_R,
    AU_V,
    AV_R,
    COS,
    COS_LEFT,
    COS_TWICE,
    FIN_DRAG,
    FIN_LIFT,
    FIN_SIDE,
    FULL,
    LENGTH,
    LEVER,
    MINUS_SIN,
    R_R,
    RACE_LEFT,
    RR,
    SHAFT_COS,
    SHAFT_SIN,
    SIN,
    SIN_LEFT,
    SIN_TWICE,
    SOFT,
    STRAIGHTENING,
    U_U,
    UR,
    UUU,
    UV,
    V_R,
    V_V,
    VR,
    VRR,
    VV,
    VVR,
    WIND_N,
    WIND_X,
    WIND_Y,
    R,
    U,
    V,
    inflow,
)
from usv_kernel.jit import kernel

__all__ = ["BY_PSI", "BY_R", "BY_U", "BY_V", "term_slopes"]

_SHIP = (WIND_X, WIND_Y, WIND_N, FIN_DRAG, FIN_LIFT, FIN_SIDE)

BY_U = np.array([U_U, UUU, U, UR, UV, AU_V, AU_R, ADVANCE_COS, ADVANCE_SIN, *_SHIP])

BY_V = np.array([VV, VR, V, V_V, V_R, VVR, VRR, UV, AU_V, AV_R, *_SHIP])

BY_R = np.array([VR, RR, R, V_R, R_R, UR, VVR, VRR, AU_R, AV_R, *_SHIP[3:]])

BY_PSI = np.array([COS, SIN, MINUS_SIN, COS_TWICE, SIN_TWICE, WIND_X, WIND_Y, WIND_N])
"""Terms that change with u, v, r and psi: those whose slopes :func:`term_slopes` writes."""


@kernel
def term_slopes(velocity, heading, wind, hull, terms, slopes):
    """Write the derivatives of the state's terms by u, v, r and psi.

    Parameters
    ----------
    velocity, heading : tuple of float
        u, v (m/s), r (rad/s); cosine and sine of the heading.
    wind, hull
        See :func:`state_terms`.
    terms : (N_TERMS,) array
        As :func:`state_terms` left it.
    slopes : (4, N_TERMS) array
        Written where a derivative is not always 0; hand in zeros.
    """
    u, v, r = velocity
    cos_psi, sin_psi = heading
    slopes[0, U_U], slopes[1, VV] = 2.0 * abs(u), 2.0 * v
    slopes[1, VR], slopes[2, VR], slopes[2, RR] = r, v, 2.0 * r
    slopes[0, U], slopes[1, V], slopes[2, R] = 1.0, 1.0, 1.0
    slopes[1, V_V], slopes[2, R_R] = 2.0 * abs(v), 2.0 * abs(r)
    slopes[1, V_R], slopes[2, V_R] = abs(r), math.copysign(v, v * r)
    slopes[0, UR], slopes[2, UR] = r, u
    slopes[1, VVR], slopes[2, VVR] = 2.0 * v * r, v * v
    slopes[1, VRR], slopes[2, VRR] = r * r, 2.0 * v * r
    slopes[3, COS], slopes[3, SIN], slopes[3, MINUS_SIN] = -sin_psi, cos_psi, -cos_psi
    if hull[FULL] == 0.0:
        return
    slopes[0, UUU] = 3.0 * u * u
    slopes[0, UV], slopes[1, UV] = v, u
    slopes[0, AU_V], slopes[1, AU_V] = math.copysign(v, u * v), abs(u)
    slopes[0, AU_R], slopes[2, AU_R] = math.copysign(r, u * r), abs(u)
    slopes[1, AV_R], slopes[2, AV_R] = math.copysign(r, v * r), abs(v)
    slopes[3, COS_TWICE], slopes[3, SIN_TWICE] = -2.0 * terms[SIN_TWICE], 2.0 * terms[COS_TWICE]
    for i in range(4):
        slopes[i, WIND_X] = slopes[i, WIND_Y] = slopes[i, WIND_N] = 0.0
    if wind[0] != 0.0 or wind[1] != 0.0:
        forth = wind[0] * cos_psi + wind[1] * sin_psi
        across = wind[1] * cos_psi - wind[0] * sin_psi
        ahead, aside = forth - u, across - v
        speed = max(math.sqrt(ahead * ahead + aside * aside), 1e-9)
        xx, xy = speed + ahead * ahead / speed, ahead * aside / speed
        yy = speed + aside * aside / speed
        slopes[0, WIND_X], slopes[1, WIND_X] = -xx, -xy
        slopes[0, WIND_Y], slopes[1, WIND_Y] = -xy, -yy
        slopes[0, WIND_N], slopes[1, WIND_N] = -aside, -ahead
        # turning the boat turns the wind the other way
        slopes[3, WIND_X] = xx * across - xy * forth
        slopes[3, WIND_Y] = xy * across - yy * forth
        slopes[3, WIND_N] = aside * across - ahead * forth
    slopes[0, ADVANCE_COS], slopes[0, ADVANCE_SIN] = terms[SHAFT_COS], terms[SHAFT_SIN]
    turn = STRAIGHTENING * LEVER * hull[LENGTH]
    aside = turn * r - STRAIGHTENING * v
    for i in range(3):
        slopes[i, FIN_DRAG] = slopes[i, FIN_LIFT] = slopes[i, FIN_SIDE] = 0.0
    for k in range(2):
        along, steep = inflow(u, terms[RACE_LEFT + k], hull[SOFT])
        c, s = terms[COS_LEFT + 2 * k], terms[SIN_LEFT + 2 * k]
        speed = max(math.sqrt(along * along + aside * aside), 1e-9)
        attack = s * along - c * aside
        by_along = along / speed * attack + speed * s
        by_aside = aside / speed * attack - speed * c
        side_along = along / speed * c * abs(aside)
        side_aside = math.copysign(aside / speed * aside + speed, aside) * c
        for i in range(3):
            inner = steep if i == 0 else (-STRAIGHTENING if i == 1 else turn)
            slope = (by_along if i == 0 else by_aside) * inner
            slopes[i, FIN_DRAG] += 0.5 * s * slope
            slopes[i, FIN_LIFT] += 0.5 * c * slope
            slopes[i, FIN_SIDE] += 0.5 * c * (side_along if i == 0 else side_aside) * inner
