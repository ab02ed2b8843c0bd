"""What lasts of one simulated boat, and what all boats of a simulation share.

A boat is one flat row of float64: a record of :data:`BOAT`, then waves, gusts, loads, faults, what
these remember, and the delay lines of the sensors. Their sizes depend on sea, faults and delay. One
array a call keeps the kernels quick; :func:`sea_arrays`, :func:`fault_arrays` and
:func:`sensor_arrays` give its parts names.
"""

from __future__ import annotations

import numpy as np

from usv_gym.physics import frames as fr
from usv_gym.physics.parameters import PARAMETERS
from usv_gym.physics.ship import WORK_ROWS
from usv_gym.physics.waves import LOAD_ROWS, OMEGA, WAVE_ROWS
from usv_gym.physics.weather import WEATHER
from usv_gym.vessel.variation import FACTORS
from usv_gym.world.anemometer import WIND_ROWS
from usv_gym.world.faults import CHANNELS, FAULT, STRUCK
from usv_gym.world.sensors import DELAYED, SENSORS, SUITE
from usv_gym.world.streams import NOISE_STREAMS
from usv_kernel.arrays import shaped
from usv_kernel.jit import inlined
from usv_kernel.random import STREAM
from usv_kernel.records import Record, as_records, field_at, record_size

__all__ = [
    "BOAT",
    "SIMULATION",
    "VESSEL",
    "WORLD",
    "fault_arrays",
    "sea_arrays",
    "sensor_arrays",
]

BOAT = np.dtype(
    [
        ("state", float, fr.STATE_SIZE),  # true state; order and units in physics.frames
        ("command", float, fr.COMMAND_SIZE),  # n_left, n_right (rev/s), delta_left, right (rad)
        # of the last step, SENSOR_CHANNELS, MOTION_CHANNELS, WIND_CHANNELS; NaN: no new sample
        ("measurement", float, CHANNELS),
        # the command as it is reported, with faults
        ("reported", float, fr.COMMAND_SIZE),
        ("sensors", SENSORS),  # biases and last samples
        ("weather", WEATHER),  # wind, current, schedule
        ("t", float),  # s, since the reset
        ("step", float),  # control steps since the reset
        ("streams", "u8", (len(NOISE_STREAMS), STREAM)),  # generators of the noise
        ("mean_rate", float, fr.STATE_SIZE),  # mean time derivative over the last step
        ("work", float, (WORK_ROWS, fr.STATE_SIZE)),  # scratch of the Runge-Kutta step
        ("vessel", PARAMETERS),  # boats of a kind may differ
    ]
)
"""One boat of a simulation."""

VESSEL = slice(field_at(BOAT, "vessel"), field_at(BOAT, "vessel") + record_size(PARAMETERS))
"""Where the flat parameters of its vessel lie in a row."""

WORLD = np.dtype(
    [
        ("kind", float),  # place of the vessel among the kinds of boats
        ("load", float),  # factor of its mass
        ("factors", float, len(FACTORS)),  # see usv_gym.vessel.variation.FACTORS
        ("x", float),  # m, start north
        ("y", float),  # m, start east
        ("heading", float),  # rad, at the start
        ("speed", float),  # m/s, ahead over ground, at the start
        ("shaft_speed", float),  # rev/s, at the start
        ("wind_from", float),  # rad, where all wind is turned to come from; NaN: as in the sea
        ("current_north", float),  # m/s; NaN: as in the sea
        ("current_east", float),
        ("sea", float),  # place of the sea state
        ("faults", float),  # place of the set of faults
        ("fault_start", float),  # s, of those that begin at random
    ]
)
"""What one boat's episode begins with, besides its random numbers."""

SIMULATION = np.dtype(
    [
        ("dt", float),  # s, control step
        ("substeps", int),  # integration steps in a control step
        ("dof", int),  # degrees of freedom, 3 or 6
        # where the parts that follow the record begin in a row, and their sizes
        ("waves_at", int),
        ("wave_components", int),
        ("loads_at", int),  # of a hydrodynamic table
        ("load_headings", int),
        ("gusts_at", int),
        ("gust_components", int),
        ("faults_at", int),
        ("fault_count", int),
        ("fault_memory_at", int),  # sound rows of the past, for faults of delay
        ("fault_memory_rows", int),
        ("delay_line_at", int),
        ("delay_rows", int),
        ("wind_line_at", int),  # the delay line of the anemometer
        ("wind_rows", int),
        ("suite", SUITE),
    ]
)
"""What all boats of a simulation share, and never changes."""


@inlined
def sea_arrays(row: np.ndarray, config: Record) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return waves (7, M), gusts (3, G) and loads (H, 14, M) of a boat; M = 0 in a calm sea."""
    M = config.wave_components
    if M > 0 and row[config.waves_at + OMEGA * M] == 0.0:  # others have waves, this boat none
        M = 0
    waves = shaped(row, config.waves_at, (WAVE_ROWS, M))
    gusts = shaped(row, config.gusts_at, (3, config.gust_components))
    return waves, gusts, shaped(row, config.loads_at, (config.load_headings, LOAD_ROWS, M))


@inlined
def fault_arrays(row: np.ndarray, config: Record) -> tuple[np.ndarray, np.ndarray]:
    """Return faults (F,), and what they remember of past rows (M, 22)."""
    faults = as_records(row, config.faults_at, config.fault_count, FAULT)
    memory = shaped(row, config.fault_memory_at, (config.fault_memory_rows, 1 + STRUCK))
    return faults, memory


@inlined
def sensor_arrays(row: np.ndarray, config: Record) -> tuple[np.ndarray, np.ndarray]:
    """Return the delay lines of the sensors (D, 15) and of the wind (K, 2)."""
    delay_line = shaped(row, config.delay_line_at, (config.delay_rows, DELAYED))
    wind_line = shaped(row, config.wind_line_at, (config.wind_rows, WIND_ROWS))
    return delay_line, wind_line
