"""The ship: sum of forces, kinematics, Runge-Kutta step (Eq 1-8).

Where the model ends: forces are those of a displacement ship. Above about 0.6 of the Froude number
sqrt(g L) only the resistance curve models planing. Trim, lift, the shorter periods of heave and
pitch, porpoising and the heel into a turn are not modelled. Waves are linear and the hull
wall-sided: no slamming, no green water, no capsizing in breaking seas.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from usv_gym.physics import GRAVITY
from usv_gym.physics import frames as fr
from usv_gym.physics.hull import heave_force, hull_forces, restoring
from usv_gym.physics.propulsion import actuator_rates, propulsion_forces
from usv_gym.physics.rigid_body import accelerate_3, accelerate_6
from usv_gym.physics.waves import (
    LOAD_ROWS,
    WAVE_ROWS,
    drift_at,
    factor_workspace,
    first_order_loads,
    mean_drift_loads,
    table_loads,
    wave_factors,
)
from usv_gym.physics.weather import air_velocity, constant, wave_gain
from usv_gym.physics.wind import apparent_loads, wind_loads
from usv_kernel.jit import kernel
from usv_kernel.records import Record
from usv_kernel.scalar import sincos

WORK_ROWS = 3

LEVEL_MIN = 0.05
"""Least cosine of the pitch in the rate of the Euler angles, which have no yaw at 90 degrees."""


class Ship(NamedTuple):
    """What a ship is: parameters, and how it may move."""

    p: Record
    """Parameters; fields in :data:`~usv_gym.physics.parameters.PARAMETERS`."""
    dof: int
    """Degrees of freedom: 3 holds heave, roll and pitch where they are; 6 frees them."""


class Sea(NamedTuple):
    """What a ship sails in, as arrays."""

    waves: np.ndarray
    """Components (7, M); M = 0 is a calm sea. Rows in :mod:`~usv_gym.physics.waves`."""
    gusts: np.ndarray
    """Components (3, G); see :func:`~usv_gym.physics.wind.gust`."""
    weather: Record
    """Fields in :data:`~usv_gym.physics.weather.WEATHER`."""
    factors: np.ndarray
    """Scratch (16, width) of :func:`~usv_gym.physics.waves.wave_factors`."""
    loads: np.ndarray
    """Loads of a hydrodynamic table (H, 14, M), rows in :mod:`~usv_gym.physics.waves`.

    H = 0: box loads. With three degrees of freedom they are not used.
    """


NO_LOADS = np.zeros((0, LOAD_ROWS, 0))
"""Loads of a sea without a hydrodynamic table."""


def calm_sea(weather: Record | None = None) -> Sea:
    """Return a sea without waves and gusts; without weather, also without wind and current."""
    if weather is None:
        weather = constant()
    return Sea(np.zeros((WAVE_ROWS, 0)), np.zeros((3, 0)), weather, factor_workspace(0), NO_LOADS)


class Air(NamedTuple):
    """Wind and waves of the moment, which stay the same within a step."""

    north: float
    """Velocity of the air, m/s."""
    east: float
    wave_gain: float
    """Factor of the wave amplitudes."""


@kernel
def derivative(
    state: np.ndarray, cmd: np.ndarray, ship: Ship, sea: Sea, air: Air, t: float, out: np.ndarray
) -> None:
    """Write the time derivative of the state (16,) at time t; the sea's factors are written before.

    Source: Eq (1)-(8), ship_and_sea.md. The sum of rigid body and added mass is driven by the
    velocity through a current. That is exact where the current is the same everywhere (Fossen 2021,
    section 10.3). In waves, hull and propulsion feel the orbital motion of the water, and the added
    mass its acceleration. So a boat on a long wave moves with the water. Weight and buoyancy act
    along the vertical, the water plane's share at its centre. The wave's push on the boat's mass
    acts at the centre of gravity. Hull, added mass, propulsion and wind act at their heights in the
    vessel file. With a hydrodynamic table the loads of the waves are about the origin and include
    what they push of the added mass.
    """
    p, waves, weather, gain = ship.p, sea.waves, sea.weather, air.wave_gain
    psi, r = state[fr.PSI], state[fr.R]
    phi, theta = state[fr.PHI], state[fr.THETA]
    free = ship.dof == 6
    current_w = 0.0
    if free:
        current_u, current_v, current_w = fr.unrotate(
            phi, theta, psi, weather.current_north, weather.current_east, 0.0
        )
    else:
        current_u, current_v = fr.to_body(weather.current_north, weather.current_east, psi)
    u, v = state[fr.U] - current_u, state[fr.V] - current_v

    X_wave, Y_wave, N_wave, Z_wave, K_wave, M_wave = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    u_water, v_water = u, v
    tabled = free and sea.loads.shape[0] > 0
    if waves.shape[1] > 0 and tabled:
        loads = table_loads(state[fr.X], state[fr.Y], t, waves, sea.factors)
        u_water -= gain * loads[6]
        v_water -= gain * loads[7]
    elif waves.shape[1] > 0:
        X_wave, Y_wave, N_wave, Z_wave, K_wave, M_wave, u_orbit, v_orbit = first_order_loads(
            state[fr.X], state[fr.Y], psi, t, waves, p, ship.dof, sea.factors
        )
        X_wave, Y_wave, N_wave = gain * X_wave, gain * Y_wave, gain * N_wave
        Z_wave, K_wave, M_wave = gain * Z_wave, gain * K_wave, gain * M_wave
        u_water -= gain * u_orbit
        v_water -= gain * v_orbit

    X_H, Y_H, N_H = hull_forces(u_water, v_water, r, p)
    X_P, Y_P, N_P = propulsion_forces(u_water, v_water, r, state, p)
    x_share, y_share = p.m_x / p.mass, p.m_y / p.mass
    # the water's acceleration pushes the added mass as its pressure pushes the boat's own
    X_H, Y_H = X_H + x_share * X_wave, Y_H + y_share * Y_wave
    X, Y = X_H + X_P, Y_H + Y_P
    N = N_H + N_P + (1.0 + y_share) * N_wave
    X_wind, Y_wind = 0.0, 0.0
    if air.north != 0.0 or air.east != 0.0:
        # the resistance curve has the drag of still air in it already
        X_air, Y_air, N_air = wind_loads(state[fr.U], state[fr.V], psi, air.north, air.east, p)
        X_still, Y_still, N_still = apparent_loads(state[fr.U], state[fr.V], p)
        X_wind, Y_wind = X_air - X_still, Y_air - Y_still
        X, Y, N = X + X_wind, Y + Y_wind, N + N_air - N_still
    if waves.shape[1] > 0:
        if weather.drift_tabled > 0.0:
            X_drift, Y_drift, N_drift = drift_at(psi, weather.drift_table)
        else:
            X_drift, Y_drift, N_drift = mean_drift_loads(psi, weather.drift_sums)
        X, Y, N = X + gain * gain * X_drift, Y + gain * gain * Y_drift, N + gain * gain * N_drift

    x_G = p.x_G
    for i in range(fr.N_LEFT):
        out[i] = 0.0
    if not free:
        du, dv, dr = accelerate_3(X + X_wave, Y + Y_wave, N + x_G * Y_wave, u, v, r, p)
        # the current turns in the body frame as the boat turns
        out[fr.U], out[fr.V], out[fr.R] = du + r * current_v, dv - r * current_u, dr
        out[fr.X], out[fr.Y] = fr.to_earth(state[fr.U], state[fr.V], psi)
        out[fr.PSI] = r
        actuator_rates(state, cmd, p, out)
        return

    w, p_rate, q_rate = state[fr.W] - current_w, state[fr.P], state[fr.Q]
    sf, cf = sincos(phi)
    st, ct = sincos(theta)
    k_x, k_y, k_z = -st, ct * sf, ct * cf  # downwards
    north, east, down = fr.rotate(phi, theta, psi, state[fr.U], state[fr.V], state[fr.W])
    x_F, z_G = p.x_F, p.draft - p.KG
    z_H, z_P = p.z_H, p.z_P
    sinkage = state[fr.Z] + x_F * k_x
    vertical = heave_force(sinkage, down + x_F * (k_y * r - k_z * q_rate), p) + Z_wave
    # wave forces lie in the horizontal plane, and are turned into the body
    X_level, Y_level = ct * X_wave, sf * st * X_wave + cf * Y_wave
    Z = cf * st * X_wave - sf * Y_wave + k_z * vertical
    K_0, M_0, N_0 = restoring(k_x, k_y, k_z, p_rate, q_rate, p)
    K = K_0 + K_wave - z_G * Y_level - z_H * Y_H - z_P * Y_P + p.kappa_wind * p.s_H * Y_wind
    M = M_0 + M_wave + z_G * X_level + z_H * X_H + z_P * X_P - p.s_H * X_wind
    M -= x_F * k_z * vertical
    N += N_0 + x_G * Y_level + x_F * k_y * vertical
    if waves.shape[1] > 0 and tabled:
        # level loads turned into the body
        ahead, aside, down_push = gain * loads[0], gain * loads[1], gain * loads[2]
        heel, trim, turning = gain * loads[3], gain * loads[4], gain * loads[5]
        X, Y = X + ct * ahead + k_x * down_push, Y + sf * st * ahead + cf * aside + k_y * down_push
        Z += cf * st * ahead - sf * aside + k_z * down_push
        K, M = K + ct * heel + k_x * turning, M + sf * st * heel + cf * trim + k_y * turning
        N += cf * st * heel - sf * trim + k_z * turning
    du, dv, dw, dp, dq, dr = accelerate_6(
        (X + X_level + k_x * vertical, Y + Y_level + k_y * vertical, Z, K, M, N),
        (u, v, w, p_rate, q_rate, r),
        p,
    )
    out[fr.U] = du + r * current_v - q_rate * current_w
    out[fr.V] = dv + p_rate * current_w - r * current_u
    out[fr.W] = dw + q_rate * current_u - p_rate * current_v
    out[fr.P], out[fr.Q], out[fr.R] = dp, dq, dr
    out[fr.X], out[fr.Y], out[fr.Z] = north, east, down
    turn = q_rate * sf + r * cf
    level = math.copysign(max(abs(ct), LEVEL_MIN), ct)
    out[fr.PHI] = p_rate + turn * st / level
    out[fr.THETA] = q_rate * cf - r * sf
    out[fr.PSI] = turn / level
    actuator_rates(state, cmd, p, out)


@kernel
def _lean(x: float, y: float, psi: float, t: float, p: Record, sea: Sea) -> tuple[float, ...]:
    """Return the z (m), phi and theta (rad) at which the boat would lie in a frozen sea."""
    weight, plane = p.mass * GRAVITY, p.water_density * GRAVITY * p.A_wp
    if sea.loads.shape[0] > 0:
        X, Y, Z, K, M = table_loads(x, y, t, sea.waves, sea.factors)[:5]
        # less what the horizontal acceleration of boat and water takes
        z_G = p.draft - p.KG
        K += (p.mass * z_G + p.m_y * p.z_H) / (p.mass + p.m_y) * Y
        M += p.x_F * Z - (p.mass * z_G + p.m_x * p.z_H) / (p.mass + p.m_x) * X
        theta = M / (weight * p.GM_L)
        return Z / plane + p.x_F * theta, K / (weight * p.GM_T), theta
    loads = first_order_loads(x, y, psi, t, sea.waves, p, 6, sea.factors)
    Z, K, M = loads[3], loads[4], loads[5]
    return Z / plane, K / (weight * p.GM_T), M / (weight * p.GM_L)


@kernel
def float_on(state: np.ndarray, p: Record, sea: Sea) -> None:
    """Put a boat that sails straight on the surface of the sea at time 0, moving with it.

    Place, heading and speed are read; heave, roll, pitch and their rates are written.
    """
    if sea.waves.shape[1] == 0:
        return
    wave_factors(state[fr.PSI], sea.waves, sea.loads, p, 6, sea.factors)
    gain = wave_gain(0.0, sea.weather)
    psi, u, h = state[fr.PSI], state[fr.U], 0.01
    along_x, along_y = h * u * math.cos(psi), h * u * math.sin(psi)
    x, y = state[fr.X], state[fr.Y]
    z_0, phi_0, theta_0 = _lean(x - along_x, y - along_y, psi, -h, p, sea)
    z_1, phi_1, theta_1 = _lean(x + along_x, y + along_y, psi, h, p, sea)
    rate = gain / (2.0 * h)
    state[fr.Z], state[fr.PHI] = 0.5 * gain * (z_0 + z_1), 0.5 * gain * (phi_0 + phi_1)
    state[fr.THETA] = 0.5 * gain * (theta_0 + theta_1)
    state[fr.W] = rate * (z_1 - z_0) + u * state[fr.THETA]
    state[fr.P], state[fr.Q] = rate * (phi_1 - phi_0), rate * (theta_1 - theta_0)


@kernel
def step(
    state: np.ndarray,
    cmd: np.ndarray,
    ship: Ship,
    sea: Sea,
    t: float,
    dt: float,
    work: np.ndarray,
) -> None:
    """Advance one boat from t to t + dt by one classical Runge-Kutta step, in place.

    The command is held; the factors of the sea are written. ``work`` (3, 16) is scratch; its row
    0 holds the mean derivative over the step on return.
    """
    north, east = air_velocity(t, sea.gusts, sea.weather)
    air = Air(north, east, wave_gain(t, sea.weather))
    middle = state[fr.PSI] + 0.5 * dt * state[fr.R]
    wave_factors(middle, sea.waves, sea.loads, ship.p, ship.dof, sea.factors)
    total, k, trial = work[0], work[1], work[2]
    derivative(state, cmd, ship, sea, air, t, k)
    for i in range(fr.STATE_SIZE):
        total[i] = k[i]
        trial[i] = state[i] + 0.5 * dt * k[i]
    derivative(trial, cmd, ship, sea, air, t + 0.5 * dt, k)
    for i in range(fr.STATE_SIZE):
        total[i] += 2.0 * k[i]
        trial[i] = state[i] + 0.5 * dt * k[i]
    derivative(trial, cmd, ship, sea, air, t + 0.5 * dt, k)
    for i in range(fr.STATE_SIZE):
        total[i] += 2.0 * k[i]
        trial[i] = state[i] + dt * k[i]
    derivative(trial, cmd, ship, sea, air, t + dt, k)
    for i in range(fr.STATE_SIZE):
        total[i] = (total[i] + k[i]) / 6.0
        state[i] += dt * total[i]


@kernel
def sail(
    states: np.ndarray, cmds: np.ndarray, ship: Ship, sea: Sea, dt: float, work: np.ndarray
) -> None:
    """Sail one boat through commands (K, 4), each held over one step, from time 0.

    The first of the states (K + 1, 16) is the start; the others are written.
    """
    for k in range(cmds.shape[0]):
        for i in range(fr.STATE_SIZE):
            states[k + 1, i] = states[k, i]
        step(states[k + 1], cmds[k], ship, sea, k * dt, dt, work)
