"""Faults that a twin may meet: changes of the rows of a log, or of the boat and its sea."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.logs.log import Log
from twin.sim.bridge import CONTROL_STEP, prepare, sail
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.sea import SeaState
from usv_gym.world.simulation import Simulation
from usv_kernel.channels import (
    ACCEL_X,
    ACCEL_Y,
    COMPASS,
    GPS_VX,
    GPS_VY,
    GPS_X,
    GPS_Y,
    GYRO,
)

__all__ = ["SENSOR_FAULTS", "SensorFault", "inject", "simulate_with"]

Array = NDArray[np.float64]

GPS_CHANNELS = slice(GPS_X, GPS_VY + 1)

IMU_CHANNELS = slice(GYRO, ACCEL_Y + 1)

SENSORS = slice(GPS_X, ACCEL_Y + 1)

LEFT, RIGHT = 0, 1
"""The shaft speeds among the commands."""


class Rows(NamedTuple):
    """The rows that a fault changes in place."""

    since: Array  # time since the fault began, s, (n,)
    z: Array  # measurements, (n, 10)
    cmd: Array  # commands, (n, 4)
    before: Array  # measurements of all rows up to the last of these, without fault, (m, 10)
    dt: float  # typical time between rows, s
    rng: np.random.Generator


Change = Callable[[Rows], None]


@dataclass(frozen=True)
class SensorFault:
    """A fault.

    Parameters
    ----------
    name, text : str
        For the command line, and for a table.
    seconds : float
        How long it lasts.
    sensors : tuple of str
        Names in ``twin.integrity.state.SENSORS`` of which one must be named; empty where no check of
        the sensors can find it.
    change : callable
        Changes the rows that the twin gets.
    shafts : tuple of float
        Factors of the shaft speeds that the boat makes of its commands meanwhile.
    current : float
        Current to the east that sets in, m/s.
    lasts : bool
        Whether the boat stays so: the twin must learn it.
    """

    name: str
    text: str
    seconds: float
    sensors: tuple[str, ...]
    change: Change
    shafts: tuple[float, float] = (1.0, 1.0)
    current: float = 0.0
    lasts: bool = False


def _nothing(rows: Rows) -> None:
    """Change nothing."""


def _frozen(channels: slice) -> Change:
    """Return a change that repeats the last sample before the fault."""

    def change(rows: Rows) -> None:
        z, past = rows.z[:, channels], rows.before[: len(rows.before) - len(rows.z), channels]
        given = np.isfinite(past).all(axis=1)
        z[:] = np.where(np.isfinite(z), past[given][-1], math.nan)

    return change


def _added(channel: int, amount: float, rate: float = 0.0) -> Change:
    """Return a change that adds an amount, and so much more a second."""

    def change(rows: Rows) -> None:
        rows.z[:, channel] += amount + rate * rows.since

    return change


def _set(channels: slice, value: float) -> Change:
    """Return a change that replaces samples by a value."""

    def change(rows: Rows) -> None:
        rows.z[:, channels] = value

    return change


def _command_factor(factor: float) -> Change:
    """Return a change that multiplies all commands."""

    def change(rows: Rows) -> None:
        rows.cmd[:] *= factor

    return change


def _absurd_commands(rows: Rows) -> None:
    """Set all commands to a billion."""
    rows.cmd[:] = 1e9


def _turned_compass(rows: Rows) -> None:
    """Turn the compass by 180 degrees, within its range of -pi to pi."""
    rows.z[:, COMPASS] = (rows.z[:, COMPASS] + 2.0 * math.pi) % (2.0 * math.pi) - math.pi


def _late(seconds: float) -> Change:
    """Return a change that delays all that the GPS says."""

    def change(rows: Rows) -> None:
        n, late = len(rows.z), round(seconds / rows.dt)
        first = len(rows.before) - n
        rows.z[:, GPS_CHANNELS] = rows.before[
            np.maximum(np.arange(first, first + n) - late, 0), GPS_CHANNELS
        ]

    return change


def _pulled(rate: float) -> Change:
    """Return a change that draws position and velocity away together, as a current would."""

    def change(rows: Rows) -> None:
        rows.z[:, GPS_Y] += rate * rows.since
        rows.z[:, GPS_VY] += rate

    return change


def _garbage(rows: Rows) -> None:
    """Replace all samples by numbers of any size."""
    shape = rows.z[:, SENSORS].shape
    rows.z[:, SENSORS] = rows.rng.normal(size=shape) * 10.0 ** rows.rng.uniform(-3.0, 12.0, shape)


ANY = ("gps", "compass", "gyro", "accelerometers")

SENSOR_FAULTS = {
    fault.name: fault
    for fault in (
        SensorFault("clean", "none", 20.0, (), _nothing),
        SensorFault("gyro-frozen", "gyro frozen", 20.0, ("gyro",), _frozen(slice(GYRO, GYRO + 1))),
        SensorFault("gyro-bias", "gyro bias of .1 rad/s", 20.0, ("gyro",), _added(GYRO, 0.1)),
        SensorFault(
            "compass-turned", "compass turned by 180 deg", 10.0, ("compass",), _turned_compass
        ),
        SensorFault(
            "compass-drift",
            "compass drifts by .05 rad/s",
            20.0,
            ("compass",),
            _added(COMPASS, 0.0, 0.05),
        ),
        SensorFault(
            "compass-frozen",
            "compass frozen",
            20.0,
            ("compass",),
            _frozen(slice(COMPASS, COMPASS + 1)),
        ),
        SensorFault(
            "imu-frozen", "gyro and accelerometers frozen", 20.0, ANY[2:], _frozen(IMU_CHANNELS)
        ),
        SensorFault(
            "accel-bias",
            "accelerometer bias of 1 m/s2",
            20.0,
            ("accelerometers",),
            _added(ACCEL_X, 1.0),
        ),
        SensorFault(
            "commands-reversed",
            "commands with the wrong sign",
            20.0,
            ("commands",),
            _command_factor(-1.0),
        ),
        SensorFault("commands-zero", "commands zero", 20.0, ("commands",), _command_factor(0.0)),
        SensorFault("commands-absurd", "commands of 1e9", 10.0, ("commands",), _absurd_commands),
        SensorFault("gps-jump", "GPS jumps by 500 m", 10.0, ("gps",), _added(GPS_X, 500.0)),
        SensorFault("gps-jump-small", "GPS jumps by 20 m", 10.0, ("gps",), _added(GPS_Y, 20.0)),
        SensorFault("gps-frozen", "GPS frozen", 20.0, ("gps",), _frozen(GPS_CHANNELS)),
        SensorFault(
            "gps-velocity-frozen",
            "GPS velocity frozen, fixes right",
            20.0,
            ("gps",),
            _frozen(slice(GPS_VX, GPS_VY + 1)),
        ),
        SensorFault("gps-absurd", "GPS of 1e9", 10.0, ("gps",), _set(GPS_CHANNELS, 1e9)),
        SensorFault("gps-late", "GPS 5 s late", 30.0, ("gps",), _late(5.0)),
        SensorFault(
            "gps-pull",
            "fixes drawn away at .5 m/s, velocity right",
            60.0,
            ("gps",),
            _added(GPS_Y, 0.0, 0.5),
        ),
        SensorFault(
            "gps-spoofed", "fixes and velocity drawn away at .5 m/s", 60.0, ("gps",), _pulled(0.5)
        ),
        SensorFault("all-lost", "all sensors lost", 60.0, ANY, _set(SENSORS, math.nan)),
        SensorFault("garbage", "garbage from all sensors", 10.0, ANY, _garbage),
        SensorFault("garbage-long", "1e5 rows of garbage", 5000.0, ANY, _garbage),
        SensorFault(
            "thruster-dead",
            "left thruster dead from then on",
            60.0,
            ("commands",),
            _nothing,
            (0.0, 1.0),
            lasts=True,
        ),
        SensorFault(
            "thruster-weak",
            "left thruster at half its thrust from then on",
            60.0,
            (),
            _nothing,
            (math.sqrt(0.5), 1.0),
            lasts=True,
        ),
        SensorFault(
            "current-step",
            "current of 1 m/s from then on",
            60.0,
            (),
            _nothing,
            current=1.0,
            lasts=True,
        ),
    )
}
"""Faults by name: those of ``docs/explanation/fault_matrix.md``."""


def simulate_with(
    fault: SensorFault,
    start: float,
    manoeuvre: str,
    boat: Vessel,
    sea: SeaState,
    *,
    duration: float,
    seed: int,
) -> Log:
    """Return a log of a boat that has its part of a fault from a time (s) on."""
    end = math.inf if fault.lasts else start + fault.seconds

    def before_step(t: float, simulation: Simulation, command: Array) -> None:
        if start <= t < end:
            command[LEFT] *= fault.shafts[0]
            command[RIGHT] *= fault.shafts[1]
            simulation.weather["current_east"] = fault.current

    simulation = Simulation(1, boat, sea, dt=CONTROL_STEP)
    return sail(prepare(simulation, manoeuvre, duration, seed), before_step)


def inject(log: Log, fault: SensorFault, start: float, seed: int) -> Log:
    """Return a log with a fault from a time (s) on; equal arguments give equal logs."""
    first, last = np.searchsorted(log.t, [start, start + fault.seconds])
    z, cmd = log.z.copy(), log.cmd.copy()
    fault.change(
        Rows(
            log.t[first:last] - start,
            z[first:last],
            cmd[first:last],
            log.z[:last],
            log.dt,
            np.random.default_rng(seed),
        )
    )
    return dataclasses.replace(log, z=z, cmd=cmd)
