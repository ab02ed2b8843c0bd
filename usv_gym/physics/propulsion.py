"""Propulsion of three kinds: thrust, drive leg or rudder, actuators (Eq 10-11)."""

from __future__ import annotations

import math

import numpy as np

from usv_gym.physics import frames as fr
from usv_gym.physics.hull import R_PRIME_MAX
from usv_gym.physics.parameters import PROPELLER_RUDDER
from usv_kernel.jit import kernel
from usv_kernel.records import Record
from usv_kernel.scalar import actuate, sincos


@kernel
def thrust(n: float, u_P: float, p: Record) -> float:
    """Return the open-water thrust (N) of one propeller with an inflow u_P (m/s) along its shaft.

    ``n`` is negative astern. ``rho D^4 n^2 K_T(J)`` with ``J = u_P / (n D)``, written without the
    quotient so that it holds through n = 0. Astern the propeller is taken as turned round, with a
    pull at rest of its own.
    """
    D = p.propeller_diameter
    J_n = u_P / D
    k_0 = p.k_0 if n >= 0.0 else p.k_0 * p.astern
    return (
        p.water_density * D**4 * (k_0 * n * abs(n) + p.k_1 * abs(n) * J_n + p.k_2 * J_n * abs(J_n))
    )


@kernel
def _drive_forces(
    u: float, v: float, r: float, unit: tuple[float, ...], n: float, delta: float, p: Record
) -> tuple[float, float, float]:
    """Return X, Y, N of one steerable drive, or of one fixed thruster (which has no leg).

    ``unit`` is its place to starboard (m), and its thrust over the nominal one.

    Source: Eq (10) with delta > 0 to starboard; the leg as an MMG rudder (Yasukawa and
    Yoshimura 2015) without hull interaction.
    """
    y, share = unit
    area = p.water_density * math.pi * p.propeller_diameter**2 / 8.0
    u_unit = u - y * r
    T = share * thrust(n, (1.0 - p.wake_fraction) * u_unit, p)
    s, c = sincos(delta)
    u_R = u_unit + p.slipstream * math.sqrt(max(T, 0.0) / area)
    v_R = v + p.x_P * r
    # sin(delta + atan2(v_R, u_R)) * (u_R^2 + v_R^2), without the arc tangent
    speed = math.sqrt(u_R * u_R + v_R * v_R)
    F_N = 0.5 * p.water_density * p.A_R * p.f_alpha * speed * (s * u_R + c * v_R)
    T *= 1.0 - p.thrust_deduction
    X = T * c - F_N * s
    Y = -T * s - F_N * c
    return X, Y, p.x_P * Y - y * X


@kernel
def _rudder_forces(
    u: float, v: float, r: float, unit: tuple[float, ...], n: float, delta: float, p: Record
) -> tuple[float, float, float]:
    """Return X, Y, N of one propeller and the rudder behind it.

    ``unit`` is its place to starboard (m), and its thrust over the nominal one.

    Source: MMG standard method, Yasukawa and Yoshimura 2015. The rudder's inflow is written without
    the quotient J, so that it holds with the ship at rest. Signed squares let it go through zero
    when the ship goes astern.
    """
    y, share = unit
    L, D = p.length_waterline, p.propeller_diameter
    U = math.sqrt(u * u + v * v)
    beta = math.atan2(-v, abs(u))
    r_ = L * r / max(U, abs(L * r) / R_PRIME_MAX, 1e-9)
    beta_P = beta - p.x_P_prime * r_
    C_2 = p.C_2_plus if beta_P > 0.0 else p.C_2_minus
    gain = 1.0 + (1.0 - math.exp(-p.C_1 * abs(beta_P))) * (C_2 - 1.0)
    # the share of turning keeps the wake of a straight course: a ship at rest has no drift
    u_P = (1.0 - p.wake_fraction) * (u * gain - y * r)
    T = share * thrust(n, u_P, p)

    jet = math.sqrt(max(u_P * u_P + 8.0 * T / (math.pi * p.water_density * D * D), 0.0))
    inside = u_P + p.kappa * (jet - abs(u_P))
    eta = min(D / p.rudder_height, 1.0)
    square = eta * inside * abs(inside) + (1.0 - eta) * u_P * abs(u_P)
    u_R = p.epsilon * math.copysign(math.sqrt(abs(square)), square)
    drift = U * beta - p.l_R_prime * L * r
    v_R = drift * (p.gamma_R_plus if drift > 0.0 else p.gamma_R_minus)
    speed = math.sqrt(u_R * u_R + v_R * v_R)
    s, c = sincos(delta)
    # sin(delta - atan2(v_R, u_R)) * (u_R^2 + v_R^2), without the arc tangent
    F_N = 0.5 * p.water_density * p.A_R * p.f_alpha * speed * (s * u_R - c * v_R)

    X = (1.0 - p.thrust_deduction) * T - (1.0 - p.t_R) * F_N * s
    Y = -(1.0 + p.a_H) * F_N * c
    N = -(p.x_R_prime + p.a_H * p.x_H_prime) * L * F_N * c
    return X, Y, N - y * X


@kernel
def propulsion_forces(
    u: float, v: float, r: float, state: np.ndarray, p: Record
) -> tuple[float, float, float]:
    """Return surge force, sway force (N) and yaw moment (N m) of all propulsion units.

    ``u, v, r`` is the velocity through water; of the state only the actuators are read. A single
    unit is the left one.
    """
    X_P, Y_P, N_P = 0.0, 0.0, 0.0
    units = int(p.units)
    rudder = p.kind == PROPELLER_RUDDER
    for i in range(units):
        y = 0.0 if units == 1 else (-p.y_P if i == 0 else p.y_P)
        unit = y, 1.0 + p.side_thrust[i]
        n, delta = state[fr.N_LEFT + i], state[fr.DELTA_LEFT + i]
        if rudder:
            X, Y, N = _rudder_forces(u, v, r, unit, n, delta, p)
        else:
            X, Y, N = _drive_forces(u, v, r, unit, n, delta, p)
        X_P += X
        Y_P += Y
        N_P += N
    return X_P, Y_P, N_P


@kernel
def actuator_rates(state: np.ndarray, cmd: np.ndarray, p: Record, out: np.ndarray) -> None:
    """Write the rates (rev/s2, rad/s) of shafts and drives that follow their commands.

    Commands are held inside what the vessel can do. Source: replaces Eq (11), which can only
    move away from zero.
    """
    n_max, delta_max = p.shaft_speed_max, p.steer_max
    for i in range(fr.UNITS):
        n = min(max(cmd[i], -n_max), n_max)
        delta = min(max(cmd[2 + i], -delta_max), delta_max)
        j, k = fr.N_LEFT + i, fr.DELTA_LEFT + i
        out[j] = actuate(state[j], n, p.shaft_lag, p.shaft_rate)
        out[k] = actuate(state[k], delta, p.steer_lag, p.steer_rate)
