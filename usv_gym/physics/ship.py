"""The ship: sum of forces, mass matrix, Runge-Kutta step."""

from __future__ import annotations

import numpy as np

from usv_gym.physics import frames as fr
from usv_gym.physics import parameters as par
from usv_gym.physics.hull import hull_forces
from usv_gym.physics.propulsion import actuator_rates, drive_forces
from usv_gym.physics.waves import box_factors, first_order_loads, mean_drift_loads
from usv_gym.physics.weather import (
    CURRENT_EAST,
    CURRENT_NORTH,
    DRIFT,
    DRIFT_END,
    air_velocity,
    wave_gain,
)
from usv_gym.physics.wind import wind_loads
from usv_kernel import kernel

WORK_ROWS = 3


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
    out: np.ndarray,
) -> None:
    """Write the time derivative of the state; heave, roll and pitch are held.

    Parameters
    ----------
    state, out : ndarray, shape (16,)
        State and its derivative; layout in :mod:`~usv_gym.physics.frames`.
    cmd : ndarray, shape (4,)
        Command.
    p : ndarray, shape (PACKED_SIZE,)
        Packed vessel.
    waves, factors : ndarray, shapes (6, M), (6, M)
        Wave components and :func:`~usv_gym.physics.waves.box_factors`; M = 0 is a calm sea.
    weather : ndarray, shape (WEATHER_SIZE,)
        Current and drift sums; layout in :mod:`~usv_gym.physics.weather`.
    air_north, air_east : float
        Velocity of the air, m/s.
    gain : float
        What the amplitudes of the waves are multiplied by.
    t : float
        Time, s.

    Notes
    -----
    Source: Eq (4)-(8) about a midship origin (Yasukawa and Yoshimura 2015). The sum of
    rigid body and added mass is driven by the velocity through water, which is exact for a
    current that is the same everywhere (Fossen 2021, section 10.3).
    """
    psi, r = state[fr.PSI], state[fr.R]
    current_u, current_v = fr.to_body(weather[CURRENT_NORTH], weather[CURRENT_EAST], psi)
    u, v = state[fr.U] - current_u, state[fr.V] - current_v

    X_H, Y_H, N_H = hull_forces(u, v, r, p)
    X_P, Y_P, N_P = drive_forces(u, v, r, state, p)
    X, Y, N = X_H + X_P, Y_H + Y_P, N_H + N_P
    if air_north != 0.0 or air_east != 0.0:
        # the resistance curve has the drag of still air in it already
        X_air, Y_air, N_air = wind_loads(state[fr.U], state[fr.V], psi, air_north, air_east, p)
        X_still, Y_still, N_still = wind_loads(state[fr.U], state[fr.V], psi, 0.0, 0.0, p)
        X, Y, N = X + X_air - X_still, Y + Y_air - Y_still, N + N_air - N_still
    if waves.shape[1] > 0:
        X_wave, Y_wave, N_wave = first_order_loads(state[fr.X], state[fr.Y], psi, t, waves, factors)
        X_drift, Y_drift, N_drift = mean_drift_loads(psi, weather[DRIFT:DRIFT_END])
        X += gain * (X_wave + gain * X_drift)
        Y += gain * (Y_wave + gain * Y_drift)
        N += gain * (N_wave + gain * N_drift)

    m, m_x, m_y, x_G = p[par.MASS], p[par.M_X], p[par.M_Y], p[par.X_G]
    m_xG = m * x_G
    X += (m + m_y) * v * r + m_xG * r * r
    Y -= (m + m_x) * u * r
    N -= m_xG * u * r
    a, c = m + m_y, p[par.I_ZZ] + m_xG * x_G + p[par.J_ZZ]
    det = a * c - m_xG * m_xG
    # the current turns in the body frame as the boat turns
    out[fr.U] = X / (m + m_x) + r * current_v
    out[fr.V] = (c * Y - m_xG * N) / det - r * current_u
    out[fr.R] = (a * N - m_xG * Y) / det
    out[fr.X], out[fr.Y] = fr.to_earth(state[fr.U], state[fr.V], psi)
    out[fr.PSI] = r
    out[fr.Z] = out[fr.PHI] = out[fr.THETA] = 0.0
    out[fr.W] = out[fr.P] = out[fr.Q] = 0.0
    actuator_rates(state, cmd, p, out)


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
    factors : ndarray, shape (6, M)
        Scratch for :func:`~usv_gym.physics.waves.box_factors`.
    work : ndarray, shape (3, 16)
        Scratch; on return row 0 holds the mean derivative over the step.
    """
    north, east = air_velocity(t, gusts, weather)
    gain = wave_gain(t, weather)
    box_factors(state[fr.PSI] + 0.5 * dt * state[fr.R], waves, p, factors)
    k, trial = work[1], work[2]
    total = work[0]
    derivative(state, cmd, p, waves, factors, weather, north, east, gain, t, k)
    for i in range(fr.STATE_SIZE):
        total[i] = k[i]
        trial[i] = state[i] + 0.5 * dt * k[i]
    derivative(trial, cmd, p, waves, factors, weather, north, east, gain, t + 0.5 * dt, k)
    for i in range(fr.STATE_SIZE):
        total[i] += 2.0 * k[i]
        trial[i] = state[i] + 0.5 * dt * k[i]
    derivative(trial, cmd, p, waves, factors, weather, north, east, gain, t + 0.5 * dt, k)
    for i in range(fr.STATE_SIZE):
        total[i] += 2.0 * k[i]
        trial[i] = state[i] + dt * k[i]
    derivative(trial, cmd, p, waves, factors, weather, north, east, gain, t + dt, k)
    for i in range(fr.STATE_SIZE):
        total[i] = (total[i] + k[i]) / 6.0
        state[i] += dt * total[i]
