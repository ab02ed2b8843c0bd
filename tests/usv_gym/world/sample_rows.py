"""Rows of simulated sensors, for tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from usv_gym import SensorSuite, Vessel
from usv_gym.world import anemometer, sensors
from usv_gym.world.channels import BITS
from usv_gym.world.faults import (
    CHANNELS,
    STRUCK,
    Disturbance,
    fault_records,
    memory_rows,
    seed_faults,
    strike,
)
from usv_gym.world.state import BOAT as BOAT_RECORD
from usv_kernel.channels import SENSOR_CHANNELS

DT = 0.05
BOAT = Vessel.load("usv75")
N = BOAT.values["shaft_speed_manoeuvring"]
BIT = np.array(BITS)
LEVEL_BIT = BIT[: len(SENSOR_CHANNELS)]


def rows(
    suite: SensorSuite,
    count: int,
    seed: int = 0,
    dt: float = DT,
    faults: Sequence[Disturbance] = (),
    state: np.ndarray | None = None,
    dof: int = 3,
) -> np.ndarray:
    """Return what the sensors of a boat that stays as it is say, first row at t = 0.

    With ``dof`` 6 there are those of roll, pitch and heave behind the others, and those of an
    anemometer, if the suite has one: 5 m/s of wind blow to the north, 4 to the east.
    """
    rng = np.random.default_rng(seed)
    numbers = rng.standard_normal((count, sensors.NOISE_SIZE))
    records = fault_records(faults, dt)
    seed_faults(records, faults, rng)
    motion = rng.standard_normal((count, sensors.MOTION_NOISE_SIZE if dof == 6 else 0))
    channels = sensors.WIND_AT if dof == 6 else len(SENSOR_CHANNELS)
    if suite.has_anemometer:
        channels = CHANNELS
    wind = np.random.default_rng([seed, 1]).standard_normal((count, anemometer.WIND_NOISE_SIZE))
    line = np.zeros((suite.wind_rows(dt), anemometer.WIND_ROWS))
    memory = np.zeros((memory_rows(faults, dt), 1 + STRUCK))
    row = np.zeros(STRUCK)
    packed, delay_line = suite.pack(dt), np.zeros((suite.delay_rows(dt), sensors.DELAYED))
    boat, z = np.zeros(1, BOAT_RECORD)[0], np.zeros((count, channels))
    if state is not None:
        boat["state"] = state
    sensors.start_sensors(packed, numbers[0], boat["sensors"])
    if dof == 6:
        sensors.start_motion_sensors(packed, motion[0], boat["sensors"])
    if suite.has_anemometer:
        anemometer.start_wind(packed, wind[0], boat["sensors"])
    for k in range(count):
        boat["t"], boat["step"] = k * dt, k
        if suite.has_anemometer:
            anemometer.measure_wind(boat, (5.0, 4.0), packed, wind[k], line)
        sensors.measure(boat, dt if k else 0.0, packed, numbers[k], motion[k], delay_line)
        row[:CHANNELS] = boat["measurement"]
        strike(k * dt, k, records, boat["sensors"]["last"], memory, row)
        z[k] = row[:channels]
    return z
