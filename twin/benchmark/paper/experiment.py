"""What is run to redo the paper: its two manoeuvres, its methods, and their neighbours.

The forecasts are those of the benchmark's runner. Beside them :func:`trace` follows the filters of
the paper row by row: their parameters (Tables 2 and 3, Figures 9 to 11 and 13 to 15) and the window
of Algorithm 1. Each result is a file, so that work that was stopped goes on.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.benchmark import runner
from twin.benchmark.loading import Run, load_run
from twin.benchmark.protocol import Settings, Unit, units
from twin.digital_twin import Twin
from twin.files import keep, kept
from twin.identification.dynamic_window import LATERAL_LIMIT
from twin.parallel import results_of
from twin.predictors.dsw_ukf import DSWPredictor
from usv_kernel.channels import ACCEL_Y

__all__ = [
    "METHODS",
    "PREDICTORS",
    "TRACED",
    "WITHOUT_WINDOW",
    "Trace",
    "paper_settings_of",
    "trace",
    "traces",
]

Array = NDArray[np.float64]

METHODS = {
    "dsw-ukf:printed": "DSW-UKF",
    "dsw-ukf:printed,window=off": "UKF",
    "dsw-ukf": "DSW-UKF",
    "dsw-ukf:window=off": "UKF",
    "lstm": "LSTM",
}
"""The paper's name of each predictor that stands for a row of its Table 4."""

WITHOUT_WINDOW = {
    "dsw-ukf:printed": "dsw-ukf:printed,window=off",
    "dsw-ukf": "dsw-ukf:window=off",
}
"""The paper's method as printed and as mended, and each without its window, all else equal."""

PREDICTORS = (*METHODS, "ukf", "dsw-ukf-plus", "persistence")
"""Rows of the table, in its order."""

TRACED = ("dsw-ukf:printed", "dsw-ukf", "dsw-ukf:window=off")
"""Predictors whose parameters and windows are followed."""


class Trace(NamedTuple):
    """A filter of the paper along a run, once a second."""

    t: list[float]  # s
    params: list[list[float]]  # the 25 parameters
    window: list[int]  # length of the window, rows
    V: list[float | None]  # index of the environment; None before the first adjustment
    S: list[float | None]  # index of the nonlinearity
    short_period: list[bool]  # whether the period was T0 / 2
    lateral: list[bool]  # whether the lateral acceleration was above its limit since the row before
    base: int  # fixed part of the window, rows
    cap: int  # largest variable part, rows


def paper_settings_of(
    seeds: Sequence[int], predictors: Sequence[str] = PREDICTORS, **options: Any
) -> Settings:
    """Return what the runner is to measure.

    Parameters
    ----------
    seeds : sequence of int
        Boats and seas; the paper repeated each manoeuvre four times.
    predictors : sequence of str
        Names.
    **options
        Further ones of :class:`twin.benchmark.protocol.Settings`.
    """
    given = {"plans": ("known",), "seeds": tuple(seeds), "predictors": tuple(predictors)}
    return Settings(**{**given, **options})


def traced_units(settings: Settings) -> list[Unit]:
    """Return the runs that are followed: those without a fault, with each traced predictor."""
    names = [name for name in TRACED if name in settings.predictors]
    first = settings.predictors[0]
    plain = [unit for unit in units(settings) if unit.fault == "none" and unit.predictor == first]
    return [
        Unit(unit.scenario, unit.fault, unit.seed, name, "", unit.case, unit.sea, unit.grade)
        for unit in plain
        for name in names
    ]


def trace_file(folder: Path, unit: Unit) -> Path:
    """Return the file that keeps the trace of a unit."""
    file = runner.result_file(folder, unit)
    return file.with_name(f"trace_{file.name}")


def trace(settings: Settings, unit: Unit, folder: Path, run: Run | None = None) -> Trace:
    """Follow a filter of the paper along a run, and keep the result in a file of the folder.

    Parameters
    ----------
    settings, unit
        As for :func:`twin.benchmark.runner.run_unit`; the predictor is a ``dsw-ukf``.
    folder : Path
        Of results.
    run : Run, optional
        From :func:`twin.benchmark.loading.load_run`, where at hand.
    """
    run = run or load_run(settings, unit)
    twin = Twin(run.particulars, unit.predictor, seed=unit.seed)
    predictor = twin.predictor
    assert isinstance(predictor, DSWPredictor)
    window, with_window = predictor.window, predictor.use == "dynamic"
    found = Trace([], [], [], [], [], [], [], window.base, window.cap)
    due, lateral = float(run.seen.t[0]), False
    for t, z, cmd in run.seen:
        twin.step(t, z.copy(), cmd.copy())
        lateral = lateral or abs(z[ACCEL_Y]) > LATERAL_LIMIT
        if t < due - 1e-9:
            continue
        due += 1.0
        found.t.append(float(t))
        found.params.append(twin.estimate().params.tolist())
        found.window.append(window.W if with_window else 0)
        found.V.append(None if math.isnan(window.V) else float(window.V))
        found.S.append(None if math.isnan(window.S) else float(window.S))
        found.short_period.append(bool(window.T < 10.0))
        found.lateral.append(bool(lateral))
        lateral = False
    keep(trace_file(folder, unit), _key(settings, unit), found._asdict())
    return found


def _key(settings: Settings, unit: Unit) -> list[str]:
    """Return what a trace depends on."""
    return ["trace", runner.digest(settings, unit)]


def finished_trace(settings: Settings, unit: Unit, folder: Path) -> Trace | None:
    """Return the trace of earlier work with the same settings, if there is one."""
    path = trace_file(folder, unit)
    found = kept(path, _key(settings, unit)) if path.exists() else None
    return None if found is None else Trace(**found)


def traces(
    settings: Settings, folder: Path, *, jobs: int = 1
) -> Iterator[tuple[Unit, Trace | Exception]]:
    """Follow the filters of the paper along all runs that are not done yet; yield each as it comes.

    Parameters
    ----------
    settings : Settings
        From :func:`paper_settings_of`.
    folder : Path
        Of results.
    jobs : int
        Workers; the results do not depend on the number.
    """
    todo: dict[str, list[Unit]] = {}
    for unit in traced_units(settings):
        done = finished_trace(settings, unit, folder)
        if done is None:
            todo.setdefault(unit.run, []).append(unit)
        else:
            yield unit, done
    calls = [functools.partial(_attempt, settings, task, folder) for task in todo.values()]
    for result in results_of(calls, jobs=jobs) if calls else ():
        yield from result[1]


def _attempt(
    settings: Settings, task: Sequence[Unit], folder: Path
) -> list[tuple[Unit, Trace | Exception]]:
    """Follow the filters along one run."""
    try:
        run = load_run(settings, task[0])
        return [(unit, trace(settings, unit, folder, run)) for unit in task]
    except Exception as error:  # as the runner does: the other runs go on
        return [(unit, error) for unit in task]
