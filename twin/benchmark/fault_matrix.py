"""The fault matrix: how twins bear faults of sensors and commands, fault by fault.

A boat sails a manoeuvre in waves. From second 90 on its twin gets rows with a fault, and the truth
says how well it predicts meanwhile and afterwards. The same run without fault is the measure.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.benchmark.sensor_faults import SENSOR_FAULTS, inject, simulate_with
from twin.benchmark.sources import predictor_digest
from twin.digital_twin import Twin, known_plan
from twin.files import keep, kept
from twin.health.state import SENSORS
from twin.sim.bridge import particulars_of
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.sea import SeaState
from usv_kernel.cache import running_program

__all__ = ["MATRIX_FAULTS", "FaultRun", "Trial", "fault_runs", "matrix_table"]

Array = NDArray[np.float64]

START, AFTER = 90.0, 130.0
"""When the fault begins, and how long a run goes on after its end, s."""

FIRST, EVERY, HORIZON = 40.0, 1.0, 10.0
"""First prediction, time between predictions, and how far they reach, s."""

SPAN, FACTOR, FREE = 10.0, 1.5, 0.1
"""Errors are normal again when their mean over so many seconds is within this factor of that
without the fault, and this many metres."""

REGION_90 = 4.605
"""Squared Mahalanobis distance that 90 % of a normal distribution in the plane are within."""

MATRIX_FAULTS = tuple(name for name, fault in SENSOR_FAULTS.items() if fault.seconds < AFTER)
"""Faults of the matrix: those that are short beside a run."""


class FaultRun(NamedTuple):
    """What one run with a fault showed."""

    predictor: str
    fault: str
    seed: int
    recovered: float  # s from the fault's end, or the begin of one that lasts, until predictions
    # are normal again; inf if never
    inside_now: float  # share of times in which the truth was within the claimed 90 % region
    inside_ahead: float  # the same 10 s ahead
    farthest: float  # largest error of the position meanwhile, m
    named: float  # s from the fault's begin until a sensor at fault is named; inf if none is
    others: int  # sensors that were named without being at fault


class Trial(NamedTuple):
    """What a boat sails meanwhile."""

    manoeuvre: str = "zigzag"
    vessel: str = "usv75"
    hs: float = 0.5  # significant wave height, m
    wind: float = 4.5  # mean wind at 10 m, m/s


DEFAULT_TRIAL = Trial()


class _Track(NamedTuple):
    """Predictions of a run: time, error now and 10 s ahead (m), and whether within 90 %."""

    t: Array
    now: Array
    ahead: Array
    inside_now: Array
    inside_ahead: Array
    named: dict[str, float]


def _inside(error: Array, cov: Array) -> bool:
    """Return whether an error in the plane is within the 90 % region of a covariance."""
    return bool(error @ np.linalg.solve(cov[:2, :2], error) < REGION_90)


def _track(predictor: str, fault: str, seed: int, trial: Trial) -> _Track:
    """Predict along a run with a fault."""
    boat, given = Vessel.load(trial.vessel), SENSOR_FAULTS[fault]
    log = simulate_with(
        given,
        START,
        trial.manoeuvre,
        boat,
        SeaState(hs=trial.hs, wind=trial.wind),
        duration=START + given.seconds + AFTER + HORIZON,
        seed=seed,
    )
    rows, twin = inject(log, given, START, seed), Twin(particulars_of(boat), predictor, seed=seed)
    assert log.truth is not None
    found: list[tuple[float, ...]] = []
    named: dict[str, float] = {}
    due = FIRST
    for k, (t, z, cmd) in enumerate(rows):
        twin.step(t, z, cmd)
        if t >= START:
            for sensor, status in twin.health.items():
                if status.status != "ok":
                    named.setdefault(sensor, t - START)
        if t < due or t > log.t[-1] - HORIZON:
            continue
        due += EVERY
        # the commands to come are those that the boat got, not those that the twin was given
        prediction = twin.predict(known_plan(log, k, HORIZON, 0.25), dt=0.25)
        later = int(np.searchsorted(log.t, t + HORIZON))
        error = prediction.start[:2] - log.truth[k, :2]
        later_error = prediction.mean[-1, :2] - log.truth[later, :2]
        inside = _inside(error, prediction.start_cov), _inside(later_error, prediction.cov[-1])
        found.append((t, float(np.hypot(*error)), float(np.hypot(*later_error)), *inside))
    times, now, ahead, inside_now, inside_ahead = np.array(found, dtype=np.float64).T
    return _Track(times, now, ahead, inside_now, inside_ahead, named)


def _run(predictor: str, fault: str, seed: int, trial: Trial) -> FaultRun:
    """Return what a run with a fault shows beside the one without."""
    given = SENSOR_FAULTS[fault]
    track = _track(predictor, fault, seed, trial)
    clean = _track(predictor, "clean", seed, trial)
    end, recovered = START + given.seconds, math.inf
    over = START if given.lasts else end
    for begin in np.arange(over, min(track.t[-1], clean.t[-1]) - SPAN, EVERY):
        span = (track.t >= begin) & (track.t < begin + SPAN)
        normal = (clean.t >= begin) & (clean.t < begin + SPAN)
        if track.ahead[span].mean() <= FACTOR * clean.ahead[normal].mean() + FREE:
            recovered = float(begin - over)
            break
    meanwhile = (track.t >= START) & (track.t < end)
    return FaultRun(
        predictor,
        fault,
        seed,
        recovered,
        float(track.inside_now[meanwhile].mean()),
        float(track.inside_ahead[meanwhile].mean()),
        float(track.now[meanwhile].max()),
        min((track.named.get(name, math.inf) for name in given.sensors), default=math.inf),
        len(set(track.named) & set(SENSORS) - set(given.sensors)),
    )


def fault_runs(
    predictors: Sequence[str],
    faults: Sequence[str],
    seeds: Sequence[int],
    file: Path,
    *,
    trial: Trial = DEFAULT_TRIAL,
    jobs: int = 1,
) -> Iterator[tuple[int, int, list[FaultRun]]]:
    """Sail every fault with every predictor and seed; yield (done, all, results) after each.

    Finished runs are kept in ``file`` (JSON). The same program does not sail them again.
    """
    foreign = {name: text for name in sorted(predictors) if (text := predictor_digest(name))}
    key = [running_program(), *trial, *([foreign] if foreign else [])]
    results = [FaultRun(*item) for item in kept(file, key) or ()]
    done = {(item.predictor, item.fault, item.seed) for item in results}
    units = [(p, f, s) for p in predictors for f in faults for s in seeds]
    left = [unit for unit in units if unit not in done]
    yield len(units) - len(left), len(units), results
    with ProcessPoolExecutor(jobs) as pool:
        tasks = [pool.submit(_run, *unit, trial) for unit in left]
        try:
            for task in as_completed(tasks):
                results.append(task.result())
                keep(file, key, [list(item) for item in results])
                yield len(units) - len(left) + sum(t.done() for t in tasks), len(units), results
        finally:
            pool.shutdown(cancel_futures=True)


def _seconds(values: Array) -> str:
    """Return median and largest of some times, s."""
    shown = [f"{v:.0f}" if math.isfinite(v) else "never" for v in (np.median(values), values.max())]
    return " / ".join(shown)


def matrix_table(results: Sequence[FaultRun]) -> list[str]:
    """Return the lines of a Markdown table: a row for each fault, predictor by predictor."""
    lines = [
        "| fault | predictor | forecast normal again after, s (median / worst) | truth in the "
        "claimed 90 % now / 10 s ahead | largest error of position, m | fault named after, s "
        "(median / worst) | sound sensors doubted, times | runs |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for fault in SENSOR_FAULTS:
        for predictor in dict.fromkeys(item.predictor for item in results):
            some = [r for r in results if r.fault == fault and r.predictor == predictor]
            if not some:
                continue
            now = np.mean([r.inside_now for r in some])
            ahead = np.mean([r.inside_ahead for r in some])
            named = ""
            if SENSOR_FAULTS[fault].sensors:
                named = _seconds(np.array([r.named for r in some]))
            lines.append(
                f"| {SENSOR_FAULTS[fault].text} | `{predictor}` | "
                f"{_seconds(np.array([r.recovered for r in some]))} | "
                f"{100 * now:.0f} / {100 * ahead:.0f} % | {max(r.farthest for r in some):.1f} | "
                f"{named} | {sum(r.others for r in some) or ''} | {len(some)} |"
            )
    return lines
