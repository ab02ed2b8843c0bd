"""The fault matrix: how twins bear faults of sensors, commands and thrusters.

Boats sail a zigzag in waves. From second 90 on a twin gets rows with a fault, and the truth says
how well it knows the boat meanwhile and afterwards. The same run without the fault is the measure.
"""

from __future__ import annotations

import argparse
import copy
import dataclasses
import hashlib
import math
import os
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from twin import Log, Twin, known_plan
from twin.benchmark.loading import with_faults
from twin.benchmark.sources import predictor_digest, versions
from twin.files import keep, kept
from twin.integrity.state import SENSORS
from twin.parallel import results_of
from twin.predictors.registry import base_name
from twin.sim.bridge import CONTROL_STEP_S, particulars_of, prepare, sail
from usv_gym import SeaState, SensorSuite, Vessel
from usv_gym.world.faults import THRUSTERS, Fault, parse_faults
from usv_gym.world.simulation import Simulation
from usv_kernel.cache import running_program

Array = NDArray[np.float64]

START_S, AFTER_S = 90.0, 30.0
"""When the fault begins, and how long a run goes on after its end."""

LOSS = "gps45@80"
"""The loss of GPS within which the faults of other sensors are tried as well."""

EVERY_S, HORIZON_S, PLAN_STEP_S = 1.0, 10.0, 0.25
"""Time between predictions, how far they reach, and the step of their plan."""

NORMAL_SPAN_S, NORMAL_FACTOR, NORMAL_FREE_M = 10.0, 1.5, 0.1
"""Forecasts are normal again when their mean error over so many seconds is within this factor of
that without the fault, and this many metres."""

NORMAL_SOON_S = 10.0
"""How soon after a fault they should be."""

REGION_90 = 4.605
"""Squared Mahalanobis distance that 90 % of a normal distribution in the plane are within."""

VESSELS = ("usv75", "otter", "wamv16")
GRADES = ("typical", "consumer")
COMPASS_RATE_HZ = {20: 20.0, 5: 10.0, 1: 5.0}
"""Rate of the compass beside each rate of the GPS, Hz."""

WAVES_M, WIND_MPS = 0.5, 4.5

CURRENT_MPS = 1.0
"""Speed of the current that sets in."""


class MatrixFault(NamedTuple):
    """A fault of the matrix.

    Its name is its text of faults, without a start.
    """

    text: str
    seconds: float
    """How long it lasts."""
    sensors: tuple[str, ...] = ()
    """Names in ``twin.integrity.state.SENSORS`` of which one must be named; empty where none is at
    fault, or only the boat has changed."""


CLEAN = "none"
CURRENT = "current"
"""No fault; and a current to the east that sets in and stays."""

_ALL = ("gps", "compass", "gyro", "accelerometers")

FAULTS = {
    fault.text: fault
    for fault in (
        MatrixFault(CLEAN, 20.0),
        MatrixFault("gps-jump=500:10", 10.0, ("gps",)),
        MatrixFault("gps-jump=20:20", 20.0, ("gps",)),
        MatrixFault("gps-frozen10", 10.0, ("gps",)),
        MatrixFault("gps-garbage10", 10.0, ("gps",)),
        MatrixFault("gps-late=5:10", 10.0, ("gps",)),
        MatrixFault("gps-late=2:20", 20.0, ("gps",)),
        MatrixFault("gps-late=1.5:20", 20.0, ("gps",)),
        MatrixFault("gps-ramp=1:20", 20.0, ("gps",)),
        MatrixFault("fixes-ramp=0.5:20", 20.0, ("gps",)),
        MatrixFault("fixes-swapped20", 20.0, ("gps",)),
        MatrixFault("velocity-frozen20", 20.0, ("gps",)),
        MatrixFault("velocity-scale=1.944:20", 20.0, ("gps",)),
        MatrixFault("velocity-sign20", 20.0, ("gps",)),
        MatrixFault("compass-bias=3.1416:10", 10.0, ("compass",)),
        MatrixFault("compass-bias=0.5:20", 20.0, ("compass",)),
        MatrixFault("compass-ramp=0.05:20", 20.0, ("compass",)),
        MatrixFault("compass-frozen20", 20.0, ("compass",)),
        MatrixFault("compass-sign20", 20.0, ("compass",)),
        MatrixFault("gyro-frozen20", 20.0, ("gyro",)),
        MatrixFault("gyro-bias=0.1:20", 20.0, ("gyro",)),
        MatrixFault("gyro-sign20", 20.0, ("gyro",)),
        MatrixFault("gyro-scale=57.3:20", 20.0, ("gyro",)),
        MatrixFault("accel_x-bias=1:20", 20.0, ("accelerometers",)),
        MatrixFault("accelerometers-sign20", 20.0, ("accelerometers",)),
        MatrixFault("accelerometers-scale=3.28:20", 20.0, ("accelerometers",)),
        MatrixFault("imu-frozen20", 20.0, ("gyro", "accelerometers")),
        MatrixFault("all20", 20.0, _ALL),
        MatrixFault("all-garbage10", 10.0, _ALL),
        # ten seconds, and as many until the backlog is handed out
        MatrixFault("all-stall10+commands-stall10", 20.0, _ALL),
        MatrixFault("commands-sign20", 20.0, ("commands",)),
        MatrixFault("commands-zero20", 20.0, ("commands",)),
        MatrixFault("commands-swapped20", 20.0, ("commands",)),
        MatrixFault("commands-garbage10", 10.0, ("commands",)),
        MatrixFault("steering-sign20", 20.0, ("commands",)),
        MatrixFault("left-zero20", 20.0, ("commands",)),
        MatrixFault("left-scale=0.7:20", 20.0),
        MatrixFault(CURRENT, 20.0),
    )
}
"""Faults by text."""


class Unit(NamedTuple):
    """Runs of a boat that differ by their faults."""

    predictor: str
    vessel: str
    grade: str
    gps_rate_hz: int
    seed: int


class FaultRun(NamedTuple):
    """What one run with a fault showed."""

    predictor: str
    vessel: str
    grade: str
    gps_rate_hz: int
    seed: int
    in_loss: bool
    fault: str
    named_s: float
    """From the fault's begin until a sensor at fault is named; inf if none is."""
    left_out: tuple[str, ...]
    """Sound sensors that were excluded."""
    largest_m: float
    """Largest error of position during the fault."""
    after_m: float
    """Error of position 10 s after its end."""
    clean_after_m: float
    """The same without the fault."""
    inside_during: float
    """Share of times in which the truth was within the claimed 90 % region, during ..."""
    inside_after: float
    """... and after the fault."""
    recovered_s: float
    """From the fault's end until forecasts are normal again; inf if they are not within 20 s."""


class _Track(NamedTuple):
    """What is noted of a run, second by second from the fault's begin."""

    now_m: Array  # error of position
    ahead_m: Array  # error of the position 10 s ahead
    inside: Array  # 1 where the truth was within the claimed 90 % region
    named: dict[str, float]  # time after which each sensor was no longer ok, s
    excluded: frozenset[str]


def _suite(unit: Unit) -> SensorSuite:
    """Return the sensors of a unit."""
    return dataclasses.replace(
        SensorSuite.grade(unit.grade),
        gps_rate=float(unit.gps_rate_hz),
        compass_rate=COMPASS_RATE_HZ[unit.gps_rate_hz],
    )


def _set_in(t: float, simulation: Simulation) -> None:
    """Let a current set in."""
    if t >= START_S:
        simulation.weather["current_east"] = CURRENT_MPS


def sailed(unit: Unit, fault: str) -> Log:
    """Return the log of a boat with its own part of a fault; the other part comes later."""
    own = [one for one in _parsed(fault) if one.kind in THRUSTERS]
    simulation = Simulation(
        1,
        Vessel.load(unit.vessel),
        SeaState(hs=WAVES_M, wind=WIND_MPS),
        suite=_suite(unit),
        faults=own,
        dt=CONTROL_STEP_S,
    )
    longest = max(one.seconds for one in FAULTS.values())
    duration = START_S + longest + AFTER_S + HORIZON_S + EVERY_S
    run = prepare(simulation, "zigzag", duration, unit.seed)
    return sail(run, _set_in if fault == CURRENT else None)


def _parsed(fault: str) -> list[Fault]:
    """Return what the text of a fault stands for."""
    if fault == CURRENT:
        return []
    return [one for one in parse_faults(fault, START_S) if isinstance(one, Fault)]


def _track(twin: Twin, log: Log, rows: Log, seconds: float, absent: str) -> _Track:
    """Note how a twin gets on with rows, from the begin of a fault until after it."""
    assert log.truth is not None
    first = int(np.searchsorted(log.t, START_S))
    last = int(np.searchsorted(log.t, START_S + seconds + AFTER_S))
    due, named, excluded = START_S, dict[str, float](), set[str]()
    found: list[tuple[float, float, bool]] = []
    for k in range(first, last):
        t = float(log.t[k])
        twin.step(t, rows.z[k], rows.cmd[k])
        for sensor, status in twin.health.items():
            if sensor not in SENSORS or (sensor == absent and status.status == "absent"):
                continue
            if status.status != "ok":
                named.setdefault(sensor, t - START_S)
            if status.status == "excluded":
                excluded.add(sensor)
        if t < due - 1e-6:
            continue
        due += EVERY_S
        # the commands to come are those that the boat got, not those that the twin was told
        plan = known_plan(log, k, HORIZON_S, PLAN_STEP_S)
        prediction = twin.predict(plan, dt=PLAN_STEP_S)
        later = int(np.searchsorted(log.t, t + HORIZON_S))
        error = prediction.start[:2] - log.truth[k, :2]
        ahead = prediction.mean[-1, :2] - log.truth[later, :2]
        distance = float(error @ np.linalg.solve(prediction.start_cov[:2, :2], error))
        found.append((float(np.hypot(*error)), float(np.hypot(*ahead)), distance < REGION_90))
    now, far, inside = np.array(found, dtype=np.float64).T
    return _Track(now, far, inside, named, frozenset(excluded))


def _recovered(track: _Track, clean: _Track, seconds: float) -> float:
    """Return the time from a fault's end until forecasts are normal again, s."""
    end, span = round(seconds / EVERY_S), round(NORMAL_SPAN_S / EVERY_S)
    for begin in range(end, len(track.ahead_m) - span + 1):
        normal = clean.ahead_m[begin : begin + span].mean()
        if track.ahead_m[begin : begin + span].mean() <= NORMAL_FACTOR * normal + NORMAL_FREE_M:
            return (begin - end) * EVERY_S
    return math.inf


def _runs(unit: Unit) -> list[FaultRun]:
    """Return what the runs of a unit show; what comes before the fault is sailed once."""
    particulars = particulars_of(Vessel.load(unit.vessel), _suite(unit))
    sound = sailed(unit, CLEAN)
    first, results = int(np.searchsorted(sound.t, START_S)), []
    for in_loss in (False, True):
        loss = parse_faults(LOSS, 0.0) if in_loss else ()
        rows = with_faults(sound, loss)
        begun = Twin(particulars, unit.predictor, seed=unit.seed)
        for k in range(first):
            begun.step(sound.t[k], rows.z[k], rows.cmd[k])
        before = {name for name, one in begun.health.items() if one.status == "excluded"}
        absent = "gps" if in_loss else ""
        longest = max(fault.seconds for fault in FAULTS.values())
        clean = _track(copy.deepcopy(begun), sound, rows, longest, absent)
        for name, fault in FAULTS.items():
            parts = _parsed(name)
            changed = name == CURRENT or any(one.kind in THRUSTERS for one in parts)
            log = sailed(unit, name) if changed else sound
            told = [one for one in parts if one.kind not in THRUSTERS]
            faulty = with_faults(log, [*loss, *told])
            if name != CLEAN and _same(faulty, rows):
                continue  # a GPS that is lost already, a helm that this boat does not have
            track = _track(copy.deepcopy(begun), log, faulty, fault.seconds, absent)
            end = round(fault.seconds / EVERY_S)
            later = end + round(HORIZON_S / EVERY_S)
            named = [track.named.get(one, math.inf) for one in fault.sensors]
            results.append(
                FaultRun(
                    *unit,
                    in_loss,
                    name,
                    min(named, default=math.inf),
                    tuple(sorted(track.excluded - set(fault.sensors) - before)),
                    float(track.now_m[:end].max()),
                    float(track.now_m[later]),
                    float(clean.now_m[later]),
                    float(track.inside[:end].mean()),
                    float(track.inside[end:].mean()),
                    _recovered(track, clean, fault.seconds),
                )
            )
    return results


def _same(one: Log, other: Log) -> bool:
    """Return whether a twin is told the same of two logs."""
    return np.array_equal(one.z, other.z, equal_nan=True) and np.array_equal(one.cmd, other.cmd)


def matrix_units(predictors: Sequence[str], seeds: Sequence[int]) -> list[Unit]:
    """Return the units of the matrix, seed by seed."""
    return [
        Unit(predictor, vessel, grade, rate, seed)
        for seed in seeds
        for predictor in predictors
        for vessel in VESSELS
        for grade in GRADES
        for rate in COMPASS_RATE_HZ
    ]


def _percent(share: float) -> str:
    """Return a share as per cent; a dash where there is none."""
    return "-" if math.isnan(share) else f"{100.0 * share:.0f} %"


def _mean(values: Sequence[float]) -> float:
    """Return a mean; NaN of nothing."""
    return float(np.mean(values)) if values else math.nan


def _named(runs: Sequence[FaultRun]) -> list[float]:
    """Return after how long each fault was named that must be, s."""
    return [run.named_s for run in runs if FAULTS[run.fault].sensors]


def _median(values: Sequence[float]) -> str:
    """Return the median time of what was named, s."""
    found = [value for value in values if math.isfinite(value)]
    return f"{np.median(found):.1f}" if found else "-"


def _pooled(runs: Sequence[FaultRun]) -> str:
    """Return the cells of a pooled row."""
    faulty, named = [run for run in runs if run.fault != CLEAN], _named(runs)
    clean = [run for run in runs if run.fault == CLEAN]
    after, without = (
        _mean([getattr(run, name) for run in faulty]) for name in ("after_m", "clean_after_m")
    )
    soon = _mean([run.recovered_s <= NORMAL_SOON_S for run in faulty])
    cells = (
        _percent(_mean([math.isfinite(value) for value in named])),
        _median(named),
        _percent(_mean([bool(run.left_out) for run in faulty])),
        f"{sum(bool(run.left_out) for run in clean)} of {len(clean)}",
        f"{after:.1f} / {without:.1f}",
        f"{_percent(_mean([run.inside_during for run in faulty]))} / "
        f"{_percent(_mean([run.inside_after for run in faulty]))}",
        _percent(soon),
        str(len(faulty)),
    )
    return " | ".join(cells)


POOLED_HEAD = (
    "| GPS | faults named | after, s | a sound sensor left out | the same without a fault | error "
    "10 s after / without fault, m | in the claimed 90 %, during / after | forecast normal within "
    "10 s | runs |",
    "|---|---|---|---|---|---|---|---|---|",
)

DETAIL_HEAD = (
    "| fault | named, % | after, s | a sound sensor left out, runs | of runs | largest error, m | "
    "in the claimed 90 % during, % | forecast normal within 10 s, % |",
    "|---|---|---|---|---|---|---|---|",
)


def tables(results: Sequence[FaultRun]) -> list[str]:
    """Return lines of Markdown: for each predictor a pooled table, then rows by fault."""
    lines = []
    for predictor in dict.fromkeys(run.predictor for run in results):
        own = [run for run in results if run.predictor == predictor]
        lines += [f"## `{predictor}`", "", *POOLED_HEAD]
        for in_loss in (False, True):
            for rate in COMPASS_RATE_HZ:
                some = [run for run in own if (run.in_loss, run.gps_rate_hz) == (in_loss, rate)]
                if some:
                    where = f"lost, before at {rate} Hz" if in_loss else f"{rate} Hz"
                    lines.append(f"| {where} | {_pooled(some)} |")
        for in_loss, title in ((False, "With GPS"), (True, "Without GPS")):
            lines += ["", f"### {title}", "", *DETAIL_HEAD]
            lines += _details([run for run in own if run.in_loss == in_loss])
        lines.append("")
    return lines


def _shares(groups: Sequence[Sequence[float]]) -> str:
    """Return the mean of each group, %."""
    return " / ".join(f"{100.0 * _mean(group):.0f}" for group in groups)


def _details(runs: Sequence[FaultRun]) -> list[str]:
    """Return a row for each fault; a cell has a value for each rate, highest first."""
    lines = []
    for name, fault in FAULTS.items():
        some = [run for run in runs if run.fault == name]
        by_rate = [[run for run in some if run.gps_rate_hz == rate] for rate in COMPASS_RATE_HZ]
        groups = [group for group in by_rate if group]
        if not groups:
            continue
        must = groups if fault.sensors else []

        cells = (
            f"`{name}`",
            _shares([[math.isfinite(run.named_s) for run in g] for g in must]),
            " / ".join(_median(_named(g)) for g in must),
            " / ".join(str(sum(bool(run.left_out) for run in g)) for g in groups),
            str(max(map(len, groups))),
            " / ".join(f"{max(run.largest_m for run in g):.1f}" for g in groups),
            _shares([[run.inside_during for run in g] for g in groups]),
            _shares([[run.recovered_s <= NORMAL_SOON_S for run in g] for g in groups]),
        )
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def sail_unit(unit: Unit, file: Path, key: object) -> None:
    """Sail the runs of a unit, and keep what they show."""
    keep(file, key, [list(run) for run in _runs(unit)])


def runs_of(file: Path, key: object) -> list[FaultRun] | None:
    """Return the kept runs of a unit; None where there are none of this program."""
    found = kept(file, key)
    return found and [FaultRun(*run)._replace(left_out=tuple(run[8])) for run in found]


def file_of(folder: Path, unit: Unit) -> Path:
    """Return the file of a unit's runs; no two units share one."""
    return folder / f"{quote('_'.join(map(str, unit)), safe='')}.json"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--predictors", nargs="+", default=["ukf"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[100, 101])
    parser.add_argument("--vessels", nargs="+", choices=VESSELS, default=VESSELS)
    parser.add_argument("--grades", nargs="+", choices=GRADES, default=GRADES)
    parser.add_argument(
        "--rates", nargs="+", type=int, choices=COMPASS_RATE_HZ, default=list(COMPASS_RATE_HZ),
        help="rates of the GPS, Hz",
    )  # fmt: skip
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--out", type=Path, default=Path("fault_matrix.md"))
    asked = parser.parse_args()
    units = [
        unit
        for unit in matrix_units(asked.predictors, asked.seeds)
        if unit.vessel in asked.vessels
        and unit.grade in asked.grades
        and unit.gps_rate_hz in asked.rates
    ]
    folder = asked.out.with_name(f"{asked.out.stem}_runs")
    folder.mkdir(parents=True, exist_ok=True)
    script = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
    keys = {
        name: [running_program(), script, versions(base_name(name)), predictor_digest(name)]
        for name in asked.predictors
    }
    places = [(file_of(folder, unit), keys[unit.predictor]) for unit in units]
    calls = [
        partial(sail_unit, unit, *place)
        for unit, place in zip(units, places, strict=True)
        if runs_of(*place) is None
    ]
    screen = Console(stderr=True)
    screen.print(f"{len(units) - len(calls)} of {len(units)} boats are in {folder}")
    try:
        for _ in track(
            results_of(calls, jobs=asked.jobs), "fault matrix", len(calls), console=screen
        ):
            pass
    except KeyboardInterrupt:
        sys.exit(f"stopped: {folder} has what is finished; the same command goes on")
    text = "\n".join(tables([run for place in places for run in runs_of(*place) or ()]))
    asked.out.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
