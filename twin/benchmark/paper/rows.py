"""The rows of ``usv-twin paper``: what is measured here beside what the paper prints."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.benchmark.metrics import mean_interval, run_rows
from twin.benchmark.paper.experiment import METHODS, Trace
from twin.benchmark.paper.published import (
    FIGURES,
    ITERATIONS,
    PREDICTION_FIGURES,
    SETTLED_ITERATIONS,
    TABLE_4,
    TABLES,
)
from twin.benchmark.protocol import HORIZONS, Settings, Unit
from twin.identification.dynamic_window import GAMMA_ENVIRONMENT, variable_part
from twin.model.structure import structure_of

__all__ = [
    "PaperRow",
    "paper_rows",
    "window_shares",
]

Array = NDArray[np.float64]

STRUCTURE = structure_of("paper", 1.0, 1.0, 1.0)
"""The paper's model, for the names and equations of its parameters."""

SETTLED_SHARE = 0.1
"""A parameter has settled once it stays this share of its largest excursion from its end value."""


class PaperRow(NamedTuple):
    """One number of the paper's, or beside it: mean over seeds, with a 95 % interval."""

    table: str  # table, figure or algorithm of the paper
    scenario: str
    fault: str
    predictor: str
    metric: str
    ours: float
    low: float | None  # None with fewer than three seeds
    high: float | None
    paper: float | None  # None where the paper prints none


def paper_rows(
    settings: Settings,
    done: Mapping[Unit, dict[str, Any]],
    traced: Mapping[Unit, Trace],
) -> list[PaperRow]:
    """Return all rows, in the paper's order; results that are missing are left out.

    Parameters
    ----------
    settings : Settings
        Of the experiment.
    done : mapping of Unit to dict
        Results of the runner.
    traced : mapping of Unit to Trace
        Filters of the paper along the runs.
    """
    groups: dict[tuple[str, str], list[Trace]] = {}
    for unit in sorted(traced, key=lambda unit: unit.seed):
        groups.setdefault((unit.scenario, unit.predictor), []).append(traced[unit])
    rows: list[PaperRow] = []
    for scenario in settings.scenarios:
        here = {
            name: groups[scenario, name]
            for name in settings.predictors
            if (scenario, name) in groups
        }
        for name, parts in here.items():
            rows += _parameters(scenario, name, parts, settings.identify_s)
    results = sorted(done.values(), key=lambda result: result["unit"]["seed"])
    rows += _table_4(results)
    for scenario in settings.scenarios:
        for (sailed, name), parts in groups.items():
            if sailed == scenario:
                rows += _figures(scenario, name, parts, settings.identify_s)
        rows += _predictions(scenario, results)
    for (scenario, name), parts in groups.items():
        if any(parts[0].window):
            rows += _algorithm(scenario, name, parts)
    return rows


def _row(
    where: tuple[str, str, str, str], metric: str, values: Sequence[float], paper: float | None
) -> PaperRow:
    """Return a row of the values of all seeds."""
    return PaperRow(*where, metric, *mean_interval(values), paper)


def _at(part: Trace, seconds: float) -> Array:
    """Return the parameters (25,) at a time."""
    return np.array(part.params[int(np.abs(np.array(part.t) - seconds).argmin())])


def _parameters(
    scenario: str, name: str, parts: Sequence[Trace], identify_s: float
) -> Iterator[PaperRow]:
    """Yield Table 2 or 3: the parameters at the end of the identification."""
    if scenario not in TABLES:
        return
    table, published = TABLES[scenario]
    found = np.array([_at(part, identify_s) for part in parts])
    for parameter, values, paper in zip(STRUCTURE.parameters, found.T, published, strict=True):
        yield _row((table, scenario, "none", name), parameter, values.tolist(), float(paper))
    same = (np.sign(found) == np.sign(published)).mean(axis=1)
    yield _row((table, scenario, "none", name), "share with the paper's sign", same.tolist(), None)


def _table_4(results: Sequence[dict[str, Any]]) -> Iterator[PaperRow]:
    """Yield Table 4: MAE and MSE, pooled over channels and horizons."""
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for row in run_rows(results):
        groups.setdefault((row["scenario"], row["fault"], row["predictor"]), []).append(row)
    for (scenario, fault, name), members in groups.items():
        published = TABLE_4.get(scenario, {}).get(METHODS.get(name, ""), (None, None))
        where = ("Table 4", scenario, fault, name)
        for metric, paper in zip(("mae", "mse"), published, strict=True):
            yield _row(where, metric.upper(), [row[metric] for row in members], paper)


def _figures(
    scenario: str, name: str, parts: Sequence[Trace], identify_s: float
) -> Iterator[PaperRow]:
    """Yield what Figures 9 to 11 and 13 to 15 show: when the parameters settled, and whether."""
    for motion, figure in FIGURES.get(scenario, {}).items():
        block = slice(*STRUCTURE.blocks[motion])
        where = (figure, scenario, "none", name)
        iterations = SETTLED_ITERATIONS.get(figure)
        published = None if iterations is None else iterations / ITERATIONS * identify_s
        settled = [_settled(part, block, identify_s) for part in parts]
        yield _row(where, "settled at, s", settled, published)
        later = [
            float(np.median(np.abs(_at(part, part.t[-1]) / _at(part, identify_s) - 1.0)[block]))
            for part in parts
        ]
        yield _row(where, f"change after {identify_s:g} s, share", later, None)


def _settled(part: Trace, block: slice, identify_s: float) -> float:
    """Return when the last parameter of an equation came to stay near its end value, s."""
    t = np.array(part.t)
    before = t <= identify_s + 1e-9
    history = np.array(part.params)[before, block]
    away = np.abs(history - history[-1])
    outside = (away > SETTLED_SHARE * away.max(axis=0)).any(axis=1)
    last = int(np.flatnonzero(outside)[-1]) + 1 if outside.any() else 0
    return float(t[before][last])


def _predictions(scenario: str, results: Sequence[dict[str, Any]]) -> Iterator[PaperRow]:
    """Yield what Figures 12 and 16 show: errors of each channel after 10 s."""
    groups: dict[tuple[str, str, str], list[float]] = {}
    for result in results:
        unit = result["unit"]
        if unit["scenario"] == scenario:
            for channel, values in result["plans"]["known"]["channels"].items():
                key = (unit["fault"], unit["predictor"], channel)
                groups.setdefault(key, []).append(values["mae"][-1])
    for (fault, name, channel), values in groups.items():
        where = (PREDICTION_FIGURES.get(scenario, "forecast"), scenario, fault, name)
        yield _row(where, f"MAE of {channel} after {HORIZONS[-1]:g} s", values, None)


def window_shares(part: Trace) -> dict[str, float]:
    """Return what the window of Algorithm 1 did along a run, by metric.

    "V changes W": share of the time in which the window without the index of the environment
    would have another length.
    """
    window = np.array(part.window)
    known = [(v, s) for v, s in zip(part.V, part.S, strict=True) if v is not None and s is not None]
    V, S = np.array(known).reshape(-1, 2).T if known else np.full((2, 1), math.nan)
    added = part.base * GAMMA_ENVIRONMENT * V
    changed = [
        variable_part(v, s, part.base, part.cap) != variable_part(0.0, s, part.base, part.cap)
        for v, s in known
    ]
    return {
        "W, mean, rows": float(window.mean()),
        "cap of W, rows": float(part.base + part.cap),
        "W at its cap, share of time": float((window >= part.base + part.cap).mean()),
        "W at its base, share of time": float((window <= part.base).mean()),
        "V, mean": float(V.mean()),
        "rows that V adds, mean": float(added.mean()),
        "rows that V adds, largest": float(added.max()),
        "V changes W, share of time": float(np.mean(changed)) if changed else math.nan,
        "S, median": float(np.median(S)),
        "period T0/2, share of time": float(np.mean(part.short_period)),
        "lateral rule, share of time": float(np.mean(part.lateral)),
    }


def _algorithm(scenario: str, name: str, parts: Sequence[Trace]) -> Iterator[PaperRow]:
    """Yield what Algorithm 1 did over time."""
    shares = [window_shares(part) for part in parts]
    for metric in shares[0]:
        # a run too short for an adjustment has no index
        values = [share[metric] for share in shares if math.isfinite(share[metric])]
        if values:
            yield _row(("Algorithm 1", scenario, "none", name), metric, values, None)
