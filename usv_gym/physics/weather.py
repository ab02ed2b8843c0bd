"""Weather of one boat: a flat vector of course, current, drift and slow wind, and its kernels.

The course is one to eight moments between which wave height and wind change linearly; before
the first and after the last they are held. A vector of zeros is calm.
"""

from __future__ import annotations

import math

import numpy as np

from usv_gym.physics.waves import DRIFT_SUMS, elevation
from usv_gym.physics.wind import gust
from usv_kernel.jit import kernel
from usv_kernel.scalar import wrap

# the first moment of the course; each further one is COURSE_COLUMNS on
START, WAVE_GAIN, WIND_SPEED, WIND_FROM = 0, 1, 2, 3

COURSE_COLUMNS = 4

COURSE_ROWS = 8

# how many moments follow the first
CHANGES = COURSE_ROWS * COURSE_COLUMNS

# mean wind speed (m/s) that the gusts are drawn for
GUST_WIND = CHANGES + 1

# slow wind: Gauss-Markov state, its standard deviation and time constant (s)
SPEED_DRIFT, SPEED_SD, SPEED_TAU = GUST_WIND + 1, GUST_WIND + 2, GUST_WIND + 3

FROM_DRIFT, FROM_SD, FROM_TAU = SPEED_TAU + 1, SPEED_TAU + 2, SPEED_TAU + 3

CURRENT_NORTH, CURRENT_EAST = FROM_TAU + 1, FROM_TAU + 2

# sums of the waves' mean drift at gain 1; see waves.mean_drift_loads
DRIFT = CURRENT_EAST + 1

DRIFT_END = DRIFT + DRIFT_SUMS

WEATHER_SIZE = DRIFT_END

NOISE_SIZE = 2
"""Normal numbers that :func:`drift_on` takes."""


def constant(
    wind: float = 0.0, wind_from: float = 0.0, north: float = 0.0, east: float = 0.0
) -> np.ndarray:
    """Return the vector of a weather that stays as it is, with waves as they come.

    Parameters
    ----------
    wind, wind_from : float
        Mean wind speed (m/s) and where it comes from (rad).
    north, east : float
        Current, m/s.

    Returns
    -------
    ndarray, shape (WEATHER_SIZE,)
    """
    weather = np.zeros(WEATHER_SIZE)
    weather[WAVE_GAIN] = 1.0
    weather[WIND_SPEED] = weather[GUST_WIND] = wind
    weather[WIND_FROM] = wind_from
    weather[CURRENT_NORTH], weather[CURRENT_EAST] = north, east
    return weather


@kernel
def _between(t: float, weather: np.ndarray) -> tuple[int, int, float]:
    """Return where the moments of the course around t begin, and the share of the later one."""
    i, last = 0, COURSE_COLUMNS * int(weather[CHANGES])
    while i < last and t >= weather[i + COURSE_COLUMNS + START]:
        i += COURSE_COLUMNS
    begin = weather[i + START]
    if i == last or t <= begin:
        return i, i, 0.0
    j = i + COURSE_COLUMNS
    return i, j, (t - begin) / (weather[j + START] - begin)


@kernel
def wave_gain(t: float, weather: np.ndarray) -> float:
    """Return what the amplitude of every wave is multiplied by at time t.

    Parameters
    ----------
    t : float
        Time, s.
    weather : ndarray, shape (WEATHER_SIZE,)
        Weather; layout at the top of this file.
    """
    i, j, share = _between(t, weather)
    gain = weather[i + WAVE_GAIN]
    return gain + share * (weather[j + WAVE_GAIN] - gain)


@kernel
def air_velocity(t: float, gusts: np.ndarray, weather: np.ndarray) -> tuple[float, float]:
    """Return the velocity of the air in m/s, north and east, at time t.

    The direction turns the short way round. Gusts grow and fall with the mean speed (their
    intensity stays); the slow drift of the speed is kept within the mean speed either way,
    so that no wind stays no wind.

    Parameters
    ----------
    t : float
        Time, s.
    gusts : ndarray, shape (3, G)
        Gusts; see :func:`usv_gym.physics.wind.gust`.
    weather : ndarray, shape (WEATHER_SIZE,)
        Weather; layout at the top of this file.
    """
    i, j, share = _between(t, weather)
    speed, come_from = weather[i + WIND_SPEED], weather[i + WIND_FROM]
    speed += share * (weather[j + WIND_SPEED] - speed)
    come_from += share * wrap(weather[j + WIND_FROM] - come_from) + weather[FROM_DRIFT]
    speed += max(min(weather[SPEED_DRIFT], speed), -speed)
    if speed > 0.0 and gusts.shape[1] > 0:
        speed = max(speed + gust(t, gusts) * (speed / weather[GUST_WIND]), 0.0)
    return -speed * math.cos(come_from), -speed * math.sin(come_from)


@kernel
def _gauss_markov(value: float, sd: float, tau: float, dt: float, normal: float) -> float:
    """Return a first-order Gauss-Markov state after dt, exactly; after infinity, a fresh one."""
    return value * math.exp(-dt / tau) + sd * math.sqrt(-math.expm1(-2.0 * dt / tau)) * normal


@kernel
def drift_on(weather: np.ndarray, dt: float, normal_speed: float, normal_direction: float) -> None:
    """Advance the slow changes of wind speed and direction, in place.

    Parameters
    ----------
    weather : ndarray, shape (WEATHER_SIZE,)
        Weather; layout at the top of this file.
    dt : float
        Step, s; infinity draws the states that an episode starts with.
    normal_speed, normal_direction : float
        Standard normal numbers.
    """
    if weather[SPEED_SD] > 0.0:
        weather[SPEED_DRIFT] = _gauss_markov(
            weather[SPEED_DRIFT], weather[SPEED_SD], weather[SPEED_TAU], dt, normal_speed
        )
    if weather[FROM_SD] > 0.0:
        weather[FROM_DRIFT] = _gauss_markov(
            weather[FROM_DRIFT], weather[FROM_SD], weather[FROM_TAU], dt, normal_direction
        )


@kernel
def surface(
    x: np.ndarray,
    y: np.ndarray,
    t: np.ndarray,
    waves: np.ndarray,
    weather: np.ndarray,
    out: np.ndarray,
) -> None:
    """Write the height of the sea surface above rest in m at many places and times.

    Parameters
    ----------
    x, y, t, out : ndarray, shape (n,)
        Places (m north and east) and times (s), and where to write.
    waves : ndarray, shape (7, M)
        Wave components.
    weather : ndarray, shape (WEATHER_SIZE,)
        Weather; layout at the top of this file.
    """
    for i in range(out.size):
        out[i] = wave_gain(t[i], weather) * elevation(x[i], y[i], t[i], waves)
