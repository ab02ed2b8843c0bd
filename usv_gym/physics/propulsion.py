"""Two propellers on steerable drives: thrust, leg as a foil, actuators (Eq 10-11)."""

from __future__ import annotations

import math

import numpy as np

from usv_gym.physics import frames as fr
from usv_gym.physics import parameters as par
from usv_kernel import actuate, kernel


@kernel
def thrust(n: float, u_P: float, p: np.ndarray) -> float:
    """Return the open-water thrust of one propeller in N.

    Parameters
    ----------
    n : float
        Shaft speed, rev/s; negative is astern.
    u_P : float
        Inflow along the shaft, m/s.
    p : ndarray, shape (PACKED_SIZE,)
        Packed vessel.

    Notes
    -----
    ``rho D^4 n^2 K_T(J)`` with ``J = u_P / (n D)``, written without the quotient so that it
    holds through n = 0; astern the propeller is taken as turned round.
    """
    D = p[par.DIAMETER]
    J_n = u_P / D
    return (
        p[par.DENSITY]
        * D**4
        * (p[par.K_0] * n * abs(n) + p[par.K_1] * abs(n) * J_n + p[par.K_2] * J_n * abs(J_n))
    )


@kernel
def drive_forces(
    u: float, v: float, r: float, state: np.ndarray, p: np.ndarray
) -> tuple[float, float, float]:
    """Return surge force, sway force (N) and yaw moment (N m) of both drives.

    Parameters
    ----------
    u, v, r : float
        Velocity through water at the origin, m/s and rad/s.
    state : ndarray, shape (16,)
        Only the actuators are read.
    p : ndarray, shape (PACKED_SIZE,)
        Packed vessel.

    Notes
    -----
    Source: Eq (10) with delta > 0 to starboard; the leg as an MMG rudder
    (Yasukawa and Yoshimura 2015) without hull interaction.
    """
    X_P, Y_P, N_P = 0.0, 0.0, 0.0
    area = p[par.DENSITY] * math.pi * p[par.DIAMETER] ** 2 / 8.0
    for i in range(fr.UNITS):
        y = -p[par.Y_P] if i == 0 else p[par.Y_P]
        u_unit = u - y * r
        T = thrust(state[fr.N_LEFT + i], (1.0 - p[par.WAKE]) * u_unit, p)
        delta = state[fr.DELTA_LEFT + i]
        c, s = math.cos(delta), math.sin(delta)
        u_R = u_unit + p[par.SLIPSTREAM] * math.sqrt(max(T, 0.0) / area)
        v_R = v + p[par.X_P] * r
        # sin(delta + atan2(v_R, u_R)) * (u_R^2 + v_R^2), without the arc tangent
        speed = math.sqrt(u_R * u_R + v_R * v_R)
        F_N = 0.5 * p[par.DENSITY] * p[par.A_R] * p[par.F_ALPHA] * speed * (s * u_R + c * v_R)
        T *= 1.0 - p[par.DEDUCTION]
        X = T * c - F_N * s
        Y = -T * s - F_N * c
        X_P += X
        Y_P += Y
        N_P += p[par.X_P] * Y - y * X
    return X_P, Y_P, N_P


@kernel
def actuator_rates(state: np.ndarray, cmd: np.ndarray, p: np.ndarray, out: np.ndarray) -> None:
    """Write the speeds of shafts and drives that follow their commands.

    Parameters
    ----------
    state, out : ndarray, shape (16,)
        Only the actuators are read and written, rev/s2 and rad/s.
    cmd : ndarray, shape (4,)
        Commands, held inside what the vessel can do.
    p : ndarray, shape (PACKED_SIZE,)
        Packed vessel.

    Notes
    -----
    Source: replaces Eq (11), which can only move away from zero.
    """
    n_max, delta_max = p[par.SHAFT_MAX], p[par.STEER_MAX]
    for i in range(fr.UNITS):
        n = min(max(cmd[i], -n_max), n_max)
        delta = min(max(cmd[2 + i], -delta_max), delta_max)
        j, k = fr.N_LEFT + i, fr.DELTA_LEFT + i
        out[j] = actuate(state[j], n, p[par.SHAFT_LAG], math.inf)
        out[k] = actuate(state[k], delta, p[par.STEER_LAG], p[par.STEER_RATE])
