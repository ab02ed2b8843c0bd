"""An anemometer on a mast: the apparent wind at its height, as the boat heads, moves and rolls."""

from __future__ import annotations

import math

import numpy as np

from usv_gym.physics import frames as fr
from usv_gym.world.sampling import drift, is_due
from usv_kernel.jit import kernel
from usv_kernel.records import Record, as_record, record_size
from usv_kernel.scalar import wrap

__all__ = ["WIND_NOISE_SIZE", "WIND_ROWS", "measure_wind", "start_wind"]

WIND_NOISE = np.dtype(
    [
        # white noise, then what drives the biases: speed and direction each; all standard normal
        ("white", float, 2),
        ("bias", float, 2),
    ]
)
"""Random numbers of one control step."""

WIND_NOISE_SIZE = record_size(WIND_NOISE)

WIND_ROWS = 2
"""Numbers of a sample that wait for its latency: air past the mast forward and to starboard."""

REFERENCE_HEIGHT = 10.0
PROFILE = 0.11
"""Height of the mean wind of a sea state, m, and exponent of the wind's profile over open sea.

Source: Hsu, Meindl and Gilhousen 1994."""


@kernel
def start_wind(suite: Record, numbers: np.ndarray, sensors: Record) -> None:
    """Write settled biases; ``numbers`` (4,) are those of :data:`WIND_NOISE`."""
    noise = as_record(numbers, WIND_NOISE)
    sensors.wind_bias = suite.wind_bias * noise.bias[0]
    sensors.wind_from_bias = suite.wind_from_bias * noise.bias[1]


@kernel
def measure_wind(
    boat: Record,
    air: tuple[float, float],
    suite: Record,
    numbers: np.ndarray,
    line: np.ndarray,
) -> None:
    """Write an anemometer's measurement to ``boat.sensors.wind``, NaN without a new sample.

    It stands above the origin and tilts with the boat, so it measures what blows across the deck:
    the wind of its height less the velocity of the masthead.

    Parameters
    ----------
    boat : record of :data:`usv_gym.world.state.BOAT`
        State and step are read; the biases and ``wind`` of ``sensors`` are advanced.
    air : tuple of float
        Velocity of the air 10 m above the sea, north and east, m/s.
    suite : record of :data:`usv_gym.world.sensors.SUITE`
        Errors, rate and height.
    numbers : ndarray, shape (4,)
        Random numbers of this step: :data:`WIND_NOISE`.
    line : ndarray, shape (delay + 1, 2)
        Past apparent winds for the latency, advanced in place.
    """
    noise, count, sensors, state = (
        as_record(numbers, WIND_NOISE),
        int(boat.step),
        boat.sensors,
        (boat.state),
    )
    if count > 0:
        sensors.wind_bias = drift(
            sensors.wind_bias, suite.wind_bias, suite.wind_decay, noise.bias[0]
        )
        sensors.wind_from_bias = drift(
            sensors.wind_from_bias, suite.wind_from_bias, suite.wind_decay, noise.bias[1]
        )
    phi, theta, psi = state[fr.PHI], state[fr.THETA], state[fr.PSI]
    u = state[fr.U] - state[fr.Q] * suite.wind_height
    v = state[fr.V] + state[fr.P] * suite.wind_height
    share = (suite.wind_height / REFERENCE_HEIGHT) ** PROFILE
    north, east = share * air[0], share * air[1]
    ahead = fr.rotate(phi, theta, psi, 1.0, 0.0, 0.0)
    aside = fr.rotate(phi, theta, psi, 0.0, 1.0, 0.0)
    newest = line[count % line.shape[0]]
    newest[0] = ahead[0] * north + ahead[1] * east - u
    newest[1] = aside[0] * north + aside[1] * east - v
    delay = line.shape[0] - 1
    sensors.wind[0] = sensors.wind[1] = math.nan
    if count >= delay and is_due(count - delay, suite.wind_share):
        old = line[(count - delay) % line.shape[0]]
        speed = math.hypot(old[0], old[1]) + sensors.wind_bias + suite.wind_white * noise.white[0]
        angle = math.atan2(-old[1], -old[0]) + sensors.wind_from_bias
        sensors.wind[0] = max(speed, 0.0)
        sensors.wind[1] = wrap(angle + suite.wind_from_white * noise.white[1])
