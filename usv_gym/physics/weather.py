"""Weather of one boat: schedule of wind and waves, current, mean drift and slow wind.

The schedule is one to eight keyframes, between which wave height and wind change linearly.
Before the first and after the last they are held.
"""

from __future__ import annotations

import math

import numpy as np

from usv_gym.physics.waves import DRIFT_SUMS, LOAD_HEADINGS, elevation
from usv_gym.physics.wind import gust
from usv_kernel.jit import kernel
from usv_kernel.records import Record
from usv_kernel.scalar import wrap

KEYFRAMES = 8
"""Largest number of keyframes of a schedule."""

WEATHER = np.dtype(
    [
        # the schedule: time (s), factor of wave amplitudes, wind speed (m/s) and the direction
        # it comes from (rad, clockwise from north), at each keyframe
        ("keyframe_t", float, KEYFRAMES),
        ("wave_gain", float, KEYFRAMES),
        ("wind_speed", float, KEYFRAMES),
        ("wind_from", float, KEYFRAMES),
        ("changes", float),  # number of keyframes after the first
        ("gust_wind", float),  # mean wind speed of the drawn gusts, m/s
        # slow wind: Gauss-Markov state, standard deviation and time constant (s)
        ("speed_drift", float),  # m/s
        ("speed_sd", float),
        ("speed_tau", float),
        ("from_drift", float),  # rad
        ("from_sd", float),
        ("from_tau", float),
        ("current_north", float),  # velocity of the water, m/s
        ("current_east", float),
        ("drift_sums", float, DRIFT_SUMS),  # see waves.mean_drift_loads, at gain 1
        # mean drift of a hydrodynamic table at headings of the boat, and 1 if there is one
        ("drift_table", float, (LOAD_HEADINGS, 3)),
        ("drift_tabled", float),
    ]
)
"""Weather of one boat; zeros are calm."""

NOISE_SIZE = 2
"""Standard normal numbers that :func:`advance_slow_wind` takes."""


def constant(
    wind: float = 0.0, wind_from: float = 0.0, north: float = 0.0, east: float = 0.0
) -> Record:
    """Return weather that stays as it is: wind and current in m/s, waves as given."""
    weather = np.zeros(1, WEATHER)[0]
    weather["wave_gain"][0] = 1.0
    weather["wind_speed"][0] = weather["gust_wind"] = wind
    weather["wind_from"][0] = wind_from
    weather["current_north"], weather["current_east"] = north, east
    return weather


@kernel
def _between(t: float, weather: Record) -> tuple[int, int, float]:
    """Return the keyframes before and after t, and the share of the later one."""
    i, last = 0, int(weather.changes)
    while i < last and t >= weather.keyframe_t[i + 1]:
        i += 1
    begin = weather.keyframe_t[i]
    if i == last or t <= begin:
        return i, i, 0.0
    return i, i + 1, (t - begin) / (weather.keyframe_t[i + 1] - begin)


@kernel
def wave_gain(t: float, weather: Record) -> float:
    """Return what the amplitude of every wave is multiplied by at time t (s)."""
    i, j, share = _between(t, weather)
    gain = weather.wave_gain[i]
    return gain + share * (weather.wave_gain[j] - gain)


@kernel
def air_velocity(t: float, gusts: np.ndarray, weather: Record) -> tuple[float, float]:
    """Return the velocity of the air in m/s, north and east, at time t (s).

    The direction turns the short way round. Gusts (3, G) grow and fall with the mean speed (their
    intensity stays). The slow drift of the speed is kept within the mean speed either way, so that
    no wind stays no wind.
    """
    i, j, share = _between(t, weather)
    speed, come_from = weather.wind_speed[i], weather.wind_from[i]
    speed += share * (weather.wind_speed[j] - speed)
    come_from += share * wrap(weather.wind_from[j] - come_from) + weather.from_drift
    speed += max(min(weather.speed_drift, speed), -speed)
    if speed > 0.0 and gusts.shape[1] > 0:
        speed = max(speed + gust(t, gusts) * (speed / weather.gust_wind), 0.0)
    return -speed * math.cos(come_from), -speed * math.sin(come_from)


@kernel
def _gauss_markov(value: float, sd: float, tau: float, dt: float, normal: float) -> float:
    """Return a first-order Gauss-Markov state after dt, exactly; after infinity, a fresh one."""
    return value * math.exp(-dt / tau) + sd * math.sqrt(-math.expm1(-2.0 * dt / tau)) * normal


@kernel
def advance_slow_wind(
    weather: Record, dt: float, normal_speed: float, normal_direction: float
) -> None:
    """Advance the slow changes of wind speed and direction by a step dt (s), in place.

    An infinite step draws the states that an episode starts with, from the two standard normal
    numbers.
    """
    if weather.speed_sd > 0.0:
        weather.speed_drift = _gauss_markov(
            weather.speed_drift, weather.speed_sd, weather.speed_tau, dt, normal_speed
        )
    if weather.from_sd > 0.0:
        weather.from_drift = _gauss_markov(
            weather.from_drift, weather.from_sd, weather.from_tau, dt, normal_direction
        )


@kernel
def surface(
    x: np.ndarray,
    y: np.ndarray,
    t: np.ndarray,
    waves: np.ndarray,
    weather: Record,
    out: np.ndarray,
) -> None:
    """Write the height of the sea surface above rest in m at n places (m) and times (s)."""
    for i in range(out.size):
        out[i] = wave_gain(t[i], weather) * elevation(x[i], y[i], t[i], waves)
