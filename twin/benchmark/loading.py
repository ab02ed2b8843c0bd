"""The runs of a benchmark: simulated, or read from a log."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from twin.benchmark.protocol import Settings, Unit
from twin.channels import MEASUREMENTS, MOTION_AT, MOTION_END, WIND_FROM, WIND_SPEED
from twin.integrity.rows import without_marks
from twin.logs.log import Log
from twin.logs.recording import Recording
from twin.particulars import Particulars
from twin.sim.bridge import particulars_of, simulate
from twin.sim.recorded import read_run
from usv_gym.manoeuvring.manoeuvres import MISSION
from usv_gym.manoeuvring.mission import CURRENT, CURRENT_TO, time_to_know
from usv_gym.world.faults import REPORTED, Disturbance, apply_faults, parse_faults
from usv_gym.world.sensors import SensorSuite

__all__ = ["Run", "fault_start", "load_run", "measured_truth", "recorded_identify_s", "with_faults"]


MISSION_TIME = 90.0
"""Time that a mission goes on after the first prediction, s: for a loss of GPS of a minute."""


def fault_start(settings: Settings, identify: float) -> float:
    """Return when a loss of sensors begins, s."""
    return identify + settings.fault_after_s


def with_faults(log: Log, faults: Sequence[Disturbance]) -> Log:
    """Return a log with faults of its sensors and commands; equal arguments give equal logs."""
    # the anemometer's columns; where there are none, those of the true wind
    apparent = np.isfinite(log.z[:, MOTION_END:]).any()
    wind = range(MOTION_END, len(MEASUREMENTS)) if apparent else (WIND_SPEED, WIND_FROM)
    columns = [*range(WIND_SPEED), *range(MOTION_AT, MOTION_END), *wind]
    z, cmd = apply_faults(log.t, log.z, log.cmd, faults, np.random.default_rng(0), columns)
    return dataclasses.replace(log, z=z, cmd=cmd)


def recorded_identify_s(log: Log) -> float:
    """Return the time before the first prediction of a recorded run, s."""
    return min(60.0, 0.4 * float(log.t[-1] - log.t[0]))


def measured_truth(log: Log) -> tuple[Log, tuple[str, ...]]:
    """Return a log to score against, without absurd samples, and a line on each sensor's."""
    kept, found = without_marks(Recording(log.t, log.z, np.zeros_like(log.cmd), log.t))
    return dataclasses.replace(log, z=kept.z), tuple(each.what for each in found)


class Run(NamedTuple):
    """A run: what predictors get, and what they are scored against."""

    seen: Log  # the rows that predictors get
    reference: Log  # what their predictions are scored against
    particulars: Particulars  # of the boat
    identify: float  # time of the first prediction, s
    # vessel, sea and degrees of freedom for an oracle; empty for a recorded run
    simulator: tuple[Any, ...]
    absurd: tuple[str, ...] = ()  # lines on samples that the reference lacks


def load_run(settings: Settings, unit: Unit) -> Run:
    """Return the run of a unit; the predictor does not matter."""
    if unit.log:
        log, particulars = read_run(unit.log, settings.ship, settings.mapping)
        identify = recorded_identify_s(log)
        # starts of faults count from the first row
        seen = with_faults(log, parse_faults(unit.fault, fault_start(settings, identify)))
        start = identify + float(log.t[0])
        reference, absurd = measured_truth(log)
        return Run(seen.without_truth(), reference, particulars, start, (), absurd)
    vessel, sea = settings.boat(unit.seed), settings.sea(unit.sea)
    identify, duration = settings.identify_s, settings.duration_s
    if unit.scenario == MISSION:
        identify = max(identify, time_to_know(vessel))
        duration = identify + MISSION_TIME
        if sea.current == 0.0:
            sea = sea.replace(current=CURRENT, current_to=CURRENT_TO)
    suite = SensorSuite.grade(unit.grade) if unit.grade else None
    faults = parse_faults(unit.fault, fault_start(settings, identify))
    # the reference keeps the commands that the boat got
    told = [fault for fault in faults if fault.kind in REPORTED]
    log = simulate(
        unit.scenario,
        vessel=vessel,
        sea=sea,
        duration=duration,
        seed=unit.seed,
        faults=[fault for fault in faults if fault.kind not in REPORTED],
        suite=suite,
        dof=settings.dof,
    )
    particulars = particulars_of(vessel, suite, settings.dof)
    simulator = (vessel, sea, settings.dof)
    log = dataclasses.replace(log, name=unit.run)
    return Run(with_faults(log, told).without_truth(), log, particulars, identify, simulator)
