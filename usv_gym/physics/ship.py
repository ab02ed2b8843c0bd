"""The ship: sum of forces, kinematics, Runge-Kutta step (Eq 1-8).

Where the model ends: forces are those of a displacement ship. Above about 0.6 of the Froude
number sqrt(g L) the resistance curve is all that knows of planing: trim, lift, the shorter
periods of heave and pitch, porpoising and the heel into a turn of a planing hull are not
there. Waves are linear and the hull wall-sided: no slamming, no green water, no capsizing in
breaking seas.
"""

from __future__ import annotations

import math

import numpy as np

from usv_gym.physics import GRAVITY
from usv_gym.physics import frames as fr
from usv_gym.physics import parameters as par
from usv_gym.physics.hull import heave_force, hull_forces, restoring
from usv_gym.physics.propulsion import actuator_rates, propulsion_forces
from usv_gym.physics.rigid_body import accelerate_3, accelerate_6
from usv_gym.physics.waves import box_factors, first_order_loads, mean_drift_loads
from usv_gym.physics.weather import (
    CURRENT_EAST,
    CURRENT_NORTH,
    DRIFT,
    DRIFT_END,
    air_velocity,
    wave_gain,
)
from usv_gym.physics.wind import apparent_loads, wind_loads
from usv_kernel.jit import kernel
from usv_kernel.scalar import sincos

WORK_ROWS = 3

LEVEL_MIN = 0.05
"""Least cosine of the pitch in the rate of the Euler angles, which have no yaw at 90 degrees."""


@kernel
def derivative(
    state: np.ndarray,
    cmd: np.ndarray,
    p: np.ndarray,
    waves: np.ndarray,
    factors: np.ndarray,
    weather: np.ndarray,
    air_north: float,
    air_east: float,
    gain: float,
    t: float,
    dof: int,
    out: np.ndarray,
) -> None:
    """Write the time derivative of the state.

    Parameters
    ----------
    state, out : ndarray, shape (16,)
        State and its derivative; layout in :mod:`~usv_gym.physics.frames`.
    cmd : ndarray, shape (4,)
        Command.
    p : ndarray, shape (PACKED_SIZE,)
        Packed vessel.
    waves, factors : ndarray, shapes (7, M), (13, filled(M))
        Wave components and :func:`~usv_gym.physics.waves.box_factors`; M = 0 is a calm sea.
    weather : ndarray, shape (WEATHER_SIZE,)
        Current and drift sums; layout in :mod:`~usv_gym.physics.weather`.
    air_north, air_east : float
        Velocity of the air, m/s.
    gain : float
        What the amplitudes of the waves are multiplied by.
    t : float
        Time, s.
    dof : int
        Degrees of freedom: 3 holds heave, roll and pitch where they are; 6 frees them.

    Notes
    -----
    Source: Eq (1)-(8), physics.md 2.1-2.3 C. The sum of rigid body and added mass is driven by
    the velocity through a current, which is exact where that is the same everywhere (Fossen
    2021, section 10.3). In waves, hull and propulsion feel the orbital motion of the water, and
    the added mass its acceleration: a boat on a long wave moves with the water. Weight and
    buoyancy act along the vertical, the water plane's share at its centre; the wave's push on
    the boat's mass at its centre of gravity; hull, added mass, propulsion and wind at their
    heights in the vessel file.
    """
    psi, r = state[fr.PSI], state[fr.R]
    phi, theta = state[fr.PHI], state[fr.THETA]
    free = dof == 6
    current_w = 0.0
    if free:
        current_u, current_v, current_w = fr.unrotate(
            phi, theta, psi, weather[CURRENT_NORTH], weather[CURRENT_EAST], 0.0
        )
    else:
        current_u, current_v = fr.to_body(weather[CURRENT_NORTH], weather[CURRENT_EAST], psi)
    u, v = state[fr.U] - current_u, state[fr.V] - current_v

    X_wave, Y_wave, N_wave, Z_wave, K_wave, M_wave = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    u_water, v_water = u, v
    if waves.shape[1] > 0:
        X_wave, Y_wave, N_wave, Z_wave, K_wave, M_wave, u_orbit, v_orbit = first_order_loads(
            state[fr.X], state[fr.Y], psi, t, waves, p, dof, factors
        )
        X_wave, Y_wave, N_wave = gain * X_wave, gain * Y_wave, gain * N_wave
        Z_wave, K_wave, M_wave = gain * Z_wave, gain * K_wave, gain * M_wave
        u_water -= gain * u_orbit
        v_water -= gain * v_orbit

    X_H, Y_H, N_H = hull_forces(u_water, v_water, r, p)
    X_P, Y_P, N_P = propulsion_forces(u_water, v_water, r, state, p)
    x_share, y_share = p[par.M_X] / p[par.MASS], p[par.M_Y] / p[par.MASS]
    # the water's acceleration pushes the added mass as its pressure pushes the boat's own
    X_H, Y_H = X_H + x_share * X_wave, Y_H + y_share * Y_wave
    X, Y = X_H + X_P, Y_H + Y_P
    N = N_H + N_P + (1.0 + y_share) * N_wave
    X_wind, Y_wind = 0.0, 0.0
    if air_north != 0.0 or air_east != 0.0:
        # the resistance curve has the drag of still air in it already
        X_air, Y_air, N_air = wind_loads(state[fr.U], state[fr.V], psi, air_north, air_east, p)
        X_still, Y_still, N_still = apparent_loads(state[fr.U], state[fr.V], p)
        X_wind, Y_wind = X_air - X_still, Y_air - Y_still
        X, Y, N = X + X_wind, Y + Y_wind, N + N_air - N_still
    if waves.shape[1] > 0:
        X_drift, Y_drift, N_drift = mean_drift_loads(psi, weather[DRIFT:DRIFT_END])
        X, Y, N = X + gain * gain * X_drift, Y + gain * gain * Y_drift, N + gain * gain * N_drift

    x_G = p[par.X_G]
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
    x_F, z_G = p[par.X_F], p[par.DRAFT] - p[par.KG]
    z_H, z_P = p[par.Z_H], p[par.Z_P]
    sinkage = state[fr.Z] + x_F * k_x
    vertical = heave_force(sinkage, down + x_F * (k_y * r - k_z * q_rate), p) + Z_wave
    # wave forces lie in the horizontal plane, and are turned into the body
    X_level, Y_level = ct * X_wave, sf * st * X_wave + cf * Y_wave
    Z = cf * st * X_wave - sf * Y_wave + k_z * vertical
    K_0, M_0, N_0 = restoring(k_x, k_y, k_z, p_rate, q_rate, p)
    K = (
        K_0
        + K_wave
        - z_G * Y_level
        - z_H * Y_H
        - z_P * Y_P
        + p[par.KAPPA_WIND] * p[par.S_H] * Y_wind
    )
    M = M_0 + M_wave + z_G * X_level + z_H * X_H + z_P * X_P - p[par.S_H] * X_wind
    M -= x_F * k_z * vertical
    N += N_0 + x_G * Y_level + x_F * k_y * vertical
    du, dv, dw, dp, dq, dr = accelerate_6(
        X + X_level + k_x * vertical,
        Y + Y_level + k_y * vertical,
        Z,
        K,
        M,
        N,
        u,
        v,
        w,
        p_rate,
        q_rate,
        r,
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
def _lean(
    x: float, y: float, psi: float, t: float, waves: np.ndarray, p: np.ndarray, factors: np.ndarray
) -> tuple[float, float, float]:
    """Return the z (m), phi and theta (rad) at which the boat would lie in a frozen sea."""
    _, _, _, Z, K, M, _, _ = first_order_loads(x, y, psi, t, waves, p, 6, factors)
    weight = p[par.MASS] * GRAVITY
    z = Z / (p[par.DENSITY] * GRAVITY * p[par.A_WP])
    return z, K / (weight * p[par.GM_T]), M / (weight * p[par.GM_L])


@kernel
def float_on(
    state: np.ndarray, waves: np.ndarray, weather: np.ndarray, p: np.ndarray, factors: np.ndarray
) -> None:
    """Put a boat that sails straight on the surface of the sea at time 0, moving with it.

    Parameters
    ----------
    state : ndarray, shape (16,)
        Place, heading and speed are read; heave, roll, pitch and their rates are written.
    waves, weather, p, factors
        As for :func:`step`.
    """
    if waves.shape[1] == 0:
        return
    box_factors(state[fr.PSI], waves, p, 6, factors)
    gain = wave_gain(0.0, weather)
    psi, u, h = state[fr.PSI], state[fr.U], 0.01
    along_x, along_y = h * u * math.cos(psi), h * u * math.sin(psi)
    x, y = state[fr.X], state[fr.Y]
    z_0, phi_0, theta_0 = _lean(x - along_x, y - along_y, psi, -h, waves, p, factors)
    z_1, phi_1, theta_1 = _lean(x + along_x, y + along_y, psi, h, waves, p, factors)
    rate = gain / (2.0 * h)
    state[fr.Z], state[fr.PHI] = 0.5 * gain * (z_0 + z_1), 0.5 * gain * (phi_0 + phi_1)
    state[fr.THETA] = 0.5 * gain * (theta_0 + theta_1)
    state[fr.W] = rate * (z_1 - z_0) + u * state[fr.THETA]
    state[fr.P], state[fr.Q] = rate * (phi_1 - phi_0), rate * (theta_1 - theta_0)


@kernel
def step(
    state: np.ndarray,
    cmd: np.ndarray,
    p: np.ndarray,
    waves: np.ndarray,
    gusts: np.ndarray,
    weather: np.ndarray,
    t: float,
    dt: float,
    dof: int,
    factors: np.ndarray,
    work: np.ndarray,
) -> None:
    """Advance one boat by one classical Runge-Kutta step, in place.

    Parameters
    ----------
    state : ndarray, shape (16,)
        State at t; on return at t + dt.
    cmd : ndarray, shape (4,)
        Command, held over the step.
    p, waves, gusts, weather
        Packed vessel and sea; see :func:`derivative` and :func:`usv_gym.physics.wind.gust`.
    t, dt : float
        Time and step, s.
    dof : int
        3 or 6; see :func:`derivative`.
    factors : ndarray, shape (13, filled(M))
        Room for :func:`~usv_gym.physics.waves.box_factors`.
    work : ndarray, shape (3, 16)
        Scratch; on return row 0 holds the mean derivative over the step.
    """
    north, east = air_velocity(t, gusts, weather)
    gain = wave_gain(t, weather)
    box_factors(state[fr.PSI] + 0.5 * dt * state[fr.R], waves, p, dof, factors)
    k, trial = work[1], work[2]
    total = work[0]
    derivative(state, cmd, p, waves, factors, weather, north, east, gain, t, dof, k)
    for i in range(fr.STATE_SIZE):
        total[i] = k[i]
        trial[i] = state[i] + 0.5 * dt * k[i]
    derivative(trial, cmd, p, waves, factors, weather, north, east, gain, t + 0.5 * dt, dof, k)
    for i in range(fr.STATE_SIZE):
        total[i] += 2.0 * k[i]
        trial[i] = state[i] + 0.5 * dt * k[i]
    derivative(trial, cmd, p, waves, factors, weather, north, east, gain, t + 0.5 * dt, dof, k)
    for i in range(fr.STATE_SIZE):
        total[i] += 2.0 * k[i]
        trial[i] = state[i] + dt * k[i]
    derivative(trial, cmd, p, waves, factors, weather, north, east, gain, t + dt, dof, k)
    for i in range(fr.STATE_SIZE):
        total[i] = (total[i] + k[i]) / 6.0
        state[i] += dt * total[i]


@kernel
def sail(
    states: np.ndarray,
    cmds: np.ndarray,
    p: np.ndarray,
    waves: np.ndarray,
    gusts: np.ndarray,
    weather: np.ndarray,
    dt: float,
    dof: int,
    factors: np.ndarray,
    work: np.ndarray,
) -> None:
    """Sail one boat through a list of commands, from time 0.

    Parameters
    ----------
    states : ndarray, shape (K + 1, 16)
        The first row is the start; the others are written.
    cmds : ndarray, shape (K, 4)
        Commands, each held over one step.
    p, waves, gusts, weather, dt, dof, factors, work
        As for :func:`step`.
    """
    for k in range(cmds.shape[0]):
        for i in range(fr.STATE_SIZE):
            states[k + 1, i] = states[k, i]
        step(states[k + 1], cmds[k], p, waves, gusts, weather, k * dt, dt, dof, factors, work)
