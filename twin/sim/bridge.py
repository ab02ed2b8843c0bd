"""Between simulator and twin: particulars of a vessel, and simulated runs as logs."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.channels import MEASUREMENTS, MOTION_AT
from twin.logs.log import Log, sibling_path
from twin.particulars import DESIGNS, Instruments, Particulars
from usv_gym.manoeuvring.manoeuvres import (
    HEADINGS,
    MISSION,
    SCENARIOS,
    HeadingHold,
    ManoeuvreError,
    commands,
)
from usv_gym.manoeuvring.mission import Mission
from usv_gym.physics import frames as fr
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.faults import Disturbance
from usv_gym.world.sea import SeaState
from usv_gym.world.sensors import SensorSuite
from usv_gym.world.simulation import Simulation
from usv_kernel.channels import COMPASS, GYRO, SENSOR_CHANNELS
from usv_kernel.errors import UsvTwinError
from usv_kernel.files import write_whole

__all__ = [
    "CONTROL_STEP_S",
    "TRUE_STATE",
    "VERTICAL",
    "measurement_row",
    "particulars_of",
    "prepare",
    "sail",
    "simulate",
    "with_deck_point",
]

Array = NDArray[np.float64]

ACCEL_MARGIN_MPS2 = 0.07
"""Standard deviation of what the white noise of an accelerometer leaves out, at 20 Hz."""

TILT_SD_RAD = 0.08
TILT_TIME_S = 1.0
"""Standard deviation and correlation time of roll and pitch in waves and turns."""

CONTROL_STEP_S = 0.05
"""Time between the rows of a simulated run."""

SIMULATED = [*range(len(SENSOR_CHANNELS)), *range(MOTION_AT, len(MEASUREMENTS))]
"""Places of the simulated channels in a row of measurements: no sensor shows the true wind."""

TRUE_STATE = (fr.X, fr.Y, fr.PSI, fr.U, fr.V, fr.R)
"""Entries of the ship's state that a log keeps as the truth."""

VERTICAL = (fr.Z, fr.PHI, fr.THETA, fr.W, fr.P, fr.Q)
"""Those that it keeps of the vertical motion."""


def particulars_of(vessel: Vessel, suite: SensorSuite | None = None, dof: int = 3) -> Particulars:
    """Return the particulars of a simulated vessel, for its twin.

    Of the vessel only main particulars, actuators, typical speed and, if a prior of it comes with
    the package, the class are used. ``suite`` describes its sensors, the default one if left out.
    With ``dof`` 6 the accelerometers also measure its tilt.
    """
    suite = suite or SensorSuite()
    v = vessel.values
    n = v["shaft_speed_manoeuvring"]
    return Particulars(
        name=vessel.name,
        length=v["length_waterline"],
        beam=v["beam"],
        draft=v["draft"],
        mass=v["mass"],
        speed=vessel.straight_speed(n),
        shaft_speed=n,
        steering="differential" if vessel.kind == "thruster_pair" else "drives",
        shaft_lag=v["shaft_lag"],
        # a fixed pair has no drives to turn
        steer_lag=v.get("steer_lag", 0.1),
        steer_rate=v.get("steer_rate", 1.0),
        hulls=2 if "hull_beam" in v else 1,
        hull_beam=v.get("hull_beam", 0.0),
        spacing=v.get("spacing", 0.0),
        design=vessel.design if vessel.design in DESIGNS else "",
        instruments=Instruments(
            gps_sd=max(suite.gps_white, 0.02),
            gps_bias_sd=suite.gps_bias,
            # with a margin for latency in waves
            doppler_sd=math.hypot(suite.doppler_white, 0.06),
            compass_sd=max(math.hypot(suite.compass_white, 0.5 * suite.compass_bias), 0.001),
            compass_bias_sd=suite.compass_bias,
            gyro_sd=max(suite.gyro_white, 1e-4),
            gyro_bias_sd=max(suite.gyro_bias, 1e-5),
            accel_sd=math.hypot(suite.accel_white, ACCEL_MARGIN_MPS2),
            accel_bias_sd=max(suite.accel_bias, 1e-3),
            gps_latency=suite.gps_latency,
            compass_latency=suite.compass_latency,
            ahrs_latency=suite.ahrs_latency,
            gps_arm=suite.gps_arm,
            imu_arm=suite.imu_arm,
            imu_mounting=suite.imu_mounting,
            ahrs_sd=max(math.hypot(suite.ahrs_white, suite.ahrs_bias), 1e-4),
            ahrs_time=suite.ahrs_bias_time,
            height_sd=max(suite.height_white, 0.02),
            height_bias_sd=suite.height_bias,
            climb_sd=max(suite.climb_white, 0.01),
            tilt_sd=TILT_SD_RAD if dof == 6 else 0.0,
            tilt_time=TILT_TIME_S,
            **({"wind_height": suite.wind_height} if suite.has_anemometer else {}),
        ),
    )


def with_deck_point(particulars: Particulars, point: tuple[float, ...]) -> Particulars:
    """Return particulars with the deck point of an environment, m.

    Raises
    ------
    UsvTwinError
        If they name another point.
    """
    own = particulars.deck.point_of(particulars.length)
    if own == point:
        return particulars
    if particulars.deck.point is not None:
        raise UsvTwinError(
            f"particulars: their deck point is {own} m, that of the environment {point} m; make "
            f"the environment with deck_point={own}"
        )
    return dataclasses.replace(particulars, deck=dataclasses.replace(particulars.deck, point=point))


def measurement_row(channels: Array) -> Array:
    """Return a row of ``twin.channels.MEASUREMENTS`` from the simulated sensors."""
    row = np.full(len(MEASUREMENTS), math.nan)
    row[SIMULATED] = channels
    return row


Autopilot = Callable[[Array, float, float], Array]
"""Gives the command (4,) for the true state (6,), compass (rad) and gyro (rad/s)."""


class PreparedRun(NamedTuple):
    """A simulation of one boat before its first step, and what it is commanded then."""

    simulation: Simulation
    commands: Array  # (N, 4)
    name: str
    autopilot: Autopilot | None = None  # gives the commands instead


def simulate(
    manoeuvre: str | Array,
    *,
    vessel: Vessel,
    sea: SeaState,
    duration: float,
    seed: int,
    faults: Sequence[Disturbance] = (),
    suite: SensorSuite | None = None,
    dof: int = 3,
) -> Log:
    """Simulate a manoeuvre and return its log, with the truth; 20 rows a second.

    ``manoeuvre`` is one of ``usv_gym.manoeuvring.manoeuvres.MANOEUVRES``, one of its ``HEADINGS``
    (an autopilot holds it by compass and gyro), ``mission`` (an autopilot sails a lawn mower), or
    the commands (N, 4) of the control steps.
    ``duration`` is in s; ``seed`` that of sea, sensors and (random) manoeuvre.
    """
    simulation = Simulation(1, vessel, sea, suite=suite, faults=faults, dof=dof, dt=CONTROL_STEP_S)
    return sail(prepare(simulation, manoeuvre, duration, seed))


def prepare(
    simulation: Simulation, manoeuvre: str | Array, duration: float, seed: int
) -> PreparedRun:
    """Put a simulation of one boat to its start, and a manoeuvre into commands.

    The arguments are those of :func:`simulate`.
    """
    if isinstance(manoeuvre, str) and manoeuvre not in SCENARIOS:
        raise ManoeuvreError(f"no manoeuvre is called {manoeuvre!r}; known: {', '.join(SCENARIOS)}")
    sea_rng, helm_rng = np.random.default_rng(seed).spawn(2)
    simulation.reset([0], [sea_rng])
    if not isinstance(manoeuvre, str):
        return PreparedRun(simulation, manoeuvre, f"own_{seed}")
    times = np.arange(max(round(duration / CONTROL_STEP_S), 1)) * CONTROL_STEP_S
    name, vessel, given = f"{manoeuvre}_{seed}", simulation.vessel, np.zeros((len(times), 4))
    if manoeuvre == MISSION:
        mission = Mission(vessel, simulation.state[0, TRUE_STATE], CONTROL_STEP_S)
        return PreparedRun(simulation, given, name, mission.command)
    if manoeuvre in HEADINGS:
        hold, heading = HeadingHold(vessel), simulation.seas[0].waves_to + HEADINGS[manoeuvre]
        return PreparedRun(
            simulation, given, name, lambda _, compass, gyro: hold.command(heading, compass, gyro)
        )
    return PreparedRun(simulation, commands(manoeuvre, times, vessel, helm_rng), name)


def sail(run: PreparedRun, before_step: Callable[[float, Simulation], None] | None = None) -> Log:
    """Step a simulation by its commands, and return the log, with the truth.

    ``before_step(t, simulation)`` may change boat and sea. The log has the commands as they are
    reported, with faults.
    """
    simulation, N = run.simulation, len(run.commands)
    t, cmd = np.empty(N + 1), np.concatenate([simulation.reported, run.commands])
    z, truth = np.full((N + 1, len(MEASUREMENTS)), math.nan), np.empty((N + 1, 6))
    motion, held = np.empty((N + 1, len(VERTICAL))), np.zeros(2)
    for k in range(N + 1):
        if k:
            if run.autopilot is not None:
                sample = z[k - 1, [COMPASS, GYRO]]
                held = np.where(np.isnan(sample), held, sample)
                cmd[k] = run.autopilot(truth[k - 1], *held)
            if before_step is not None:
                before_step(float(simulation.t[0]), simulation)
            simulation.step(cmd[k : k + 1])
            cmd[k] = simulation.reported[0]
        t[k] = simulation.t[0]
        z[k, SIMULATED] = simulation.z[0]
        truth[k], motion[k] = simulation.state[0, TRUE_STATE], simulation.state[0, VERTICAL]
    known = motion if simulation.dof == 6 else None
    return Log(t=t, z=z, cmd=cmd, truth=truth, name=run.name, true_motion=known)


def write_run(log: Log, particulars: Particulars, path: Path) -> None:
    """Write a log, and the particulars of its boat beside it; each whole or not at all."""
    write_whole(sibling_path(path, ".toml"), particulars.to_toml().encode())
    log.write(path)
