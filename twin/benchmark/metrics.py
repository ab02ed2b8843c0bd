"""Metrics of a benchmark: many scores summarised, compared and tabulated."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.benchmark.protocol import HORIZONS, UNIT_KEY
from twin.benchmark.scores import CHANNELS, STUDY_CHANNELS

__all__ = [
    "BASELINE",
    "METRICS",
    "ORACLE",
    "channel_table",
    "compare",
    "grouped",
    "interval_of",
    "recorded_table",
    "resampled",
    "rows_of",
    "run_rows",
    "summarise",
]

Array = NDArray[np.float64]

METRICS = {
    "mae": ("MAE", "mean absolute error over all channels and horizons, units mixed"),
    "mae_median": ("median MAE", "median of the MAE over runs"),
    "mse": ("MSE", "mean squared error, pooled in the same way"),
    "normalised": ("normalised error", "MAE over the size of the true change, mean of channels"),
    "skill": ("skill", "1 - error / error of persistence; below 0 is worse than persistence"),
    "J": (
        "J",
        "MAE over all runs over that of the oracle: mean of u, v, r, heading and displacement, "
        "every half second up to 10 s",
    ),
    "E": ("E", "J - 1, the excess over the oracle"),
    "E_runs": ("mean E of runs", "the same for each run by itself, mean over runs"),
    "crps": (
        "CRPS",
        "score of the whole distribution, pooled as the MAE; without a spread it is the MAE",
    ),
    "start_error": (
        "start error (m)",
        "error of the estimated position at the time of the prediction",
    ),
    "displacement_10s": ("displacement (m)", "MAE of the displacement after 10 s"),
    "psi_10s": ("heading (rad)", "MAE of the heading after 10 s"),
    "coverage90": (
        "90 % coverage",
        "share of errors inside the 90 % prediction intervals; 0.9 is ideal",
    ),
}
"""Heading and meaning of each metric, in the order of the table's columns."""

BASELINE, ORACLE = "persistence", "oracle"
"""Predictors that others are compared with."""


def rows_of(results: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield the errors of each run, predictor, plan, channel and horizon."""
    for result in results:
        for plan, table in result["plans"].items():
            for channel, values in table["channels"].items():
                if channel in CHANNELS:
                    for j, horizon in enumerate(HORIZONS):
                        yield {
                            **{key: result["unit"][key] for key in UNIT_KEY},
                            "plan": plan,
                            "channel": channel,
                            "horizon_s": horizon,
                            **{m: values[m][j] for m in ("mae", "mse", "crps")},
                            "n": table["n"],
                        }


def resampled(values: Array) -> Array:
    """Return 2000 bootstrap means over seeds, with the same resampling for every row."""
    n = len(values)
    return values[np.random.default_rng(0).integers(0, n, (2000, n))].mean(axis=1)


def interval_of(means: Array, seeds: int) -> tuple[float | None, float | None]:
    """Return the 95 % interval of bootstrap values; none for fewer than three seeds."""
    if seeds < 3:
        return None, None
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


KEY = (*UNIT_KEY, "plan")
"""Keys that identify a row of ``results["runs"]``."""


def run_rows(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row of metrics for each run, predictor and plan.

    - ``mae``, ``mse``, ``crps``: pooled over :data:`CHANNELS` and :data:`HORIZONS`, units mixed, as
      in the paper's Table 4; ``coverage90``: share of errors inside the 90 % intervals.
    - ``normalised``: MAE over the root mean square of the true change, mean over channels and
      horizons.
    - ``skill``: 1 minus the mean ratio of the MAE to that of raw persistence.
    - ``J``: MAE over that of the oracle on the same run, mean over :data:`STUDY_CHANNELS`, each
      the mean over :data:`STUDY_HORIZONS`; ``E`` is J - 1. Over runs: :func:`summarise`.
    - ``start_error``: mean error of the estimated position at the start of predictions, m.
    - ``displacement_10s`` (m), ``psi_10s`` (rad): MAE after 10 s.
    """
    rows: dict[tuple[Any, ...], dict[str, Any]] = {}
    tables: dict[tuple[Any, ...], Array] = {}
    for result in results:
        for plan, table in result["plans"].items():
            key = (*(result["unit"][name] for name in KEY[:-1]), plan)
            channels = {c: v for c, v in table["channels"].items() if c in CHANNELS}
            pool = {
                name: np.array([values[name] for values in channels.values()])
                for name in ("mae", "mse", "crps", "coverage90")
            }
            tables[key] = mae = pool["mae"]
            scale = np.array(table["scale"])
            moves = scale > 1e-6  # in a calm straight run nothing changes, and nothing is scored
            rows[key] = {
                **dict(zip(KEY, key, strict=True)),
                **{name: float(values.mean()) for name, values in pool.items()},
                "start_error": result["start_error"],
                "displacement_10s": table["curves"]["displacement"][-1],
                "psi_10s": table["curves"]["psi"][-1],
                "curves": table["curves"],
            }
            if moves.any():
                rows[key]["normalised"] = float(np.mean(mae[moves] / scale[moves]))
    for key, row in rows.items():
        base, oracle = (_key_of(key, name) for name in (BASELINE, ORACLE))
        if base in rows:
            row["skill"] = 1.0 - float(np.mean(tables[key] / np.maximum(tables[base], 1e-12)))
        if oracle in rows:
            row["J"] = float(_mae_over_oracle(_study_errors(row), _study_errors(rows[oracle])))
            row["E"] = row["J"] - 1.0
    return list(rows.values())


def _study_errors(row: dict[str, Any]) -> Array:
    """Return the mean error of each of the study's channels."""
    return np.array([np.mean(row["curves"][channel]) for channel in STUDY_CHANNELS])


def _mae_over_oracle(own: Array, oracle: Array) -> Array:
    """Return the mean over channels (last axis) of errors over those of the oracle."""
    return np.asarray(np.mean(own / np.maximum(oracle, 1e-12), axis=-1))


def _key_of(key: tuple[Any, ...], predictor: str) -> tuple[Any, ...]:
    """Return the key of another predictor on the same run."""
    return (*key[:-2], predictor, key[-1])


def grouped(rows: Sequence[Mapping[str, Any]], *keys: str) -> dict[tuple[Any, ...], list[Any]]:
    """Return rows with the same values of some keys together, in their order.

    A key that a row lacks counts as an empty text.
    """
    groups: dict[tuple[Any, ...], list[Any]] = {}
    for row in rows:
        groups.setdefault(tuple(row.get(key, "") for key in keys), []).append(row)
    return groups


_CELL = tuple(key for key in KEY if key != "seed")

_SOURCES = {"mae_median": "mae", "E_runs": "E"}


def summarise(runs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the summary over seeds: means with 95 % bootstrap intervals, and medians.

    ``J`` is a ratio of means, as in the study: mean error over all runs over the oracle's, averaged
    over channels. ``E`` is J - 1. Their medians are of single runs. ``E_runs`` is the mean of the
    runs' own E, which few runs with a nearly perfect oracle can dominate. ``mae_median`` is the
    median MAE as a metric of its own.
    """
    order = {tuple(row[key] for key in _CELL): None for row in runs}
    groups = grouped(sorted(runs, key=itemgetter("seed")), *_CELL)
    errors = {tuple(row[key] for key in KEY): _study_errors(row) for row in runs if "J" in row}
    summary = []
    for cell in order:
        members = groups[cell]
        for metric in METRICS:
            found = _summary_of(metric, members, errors)
            if found is not None:
                summary.append({**dict(zip(_CELL, cell, strict=True)), "metric": metric, **found})
    return summary


def _summary_of(
    metric: str, members: Sequence[dict[str, Any]], errors: Mapping[tuple[Any, ...], Array]
) -> dict[str, Any] | None:
    """Return value, interval and median of one metric over seeds; None where it is missing."""
    source = _SOURCES.get(metric, metric)
    if any(source not in row for row in members):
        return None
    values = np.array([row[source] for row in members])
    median = float(np.median(values))
    if metric == "mae_median":
        return {"value": median, "low": None, "high": None, "median": median}
    means, value = resampled(values), float(values.mean())
    if source in ("J", "E"):
        keys = [tuple(row[key] for key in KEY) for row in members]
        oracles = [_key_of(key, ORACLE) for key in keys]
        if not all(key in errors for key in (*keys, *oracles)):
            return None
        if metric in ("J", "E"):
            own, oracle = (np.array([errors[key] for key in each]) for each in (keys, oracles))
            less = 1.0 if metric == "E" else 0.0
            means = _mae_over_oracle(resampled(own), resampled(oracle)) - less
            value = float(_mae_over_oracle(own.mean(axis=0), oracle.mean(axis=0))) - less
    low, high = interval_of(means, len(values))
    return {"value": value, "low": low, "high": high, "median": median}


def compare(runs: Sequence[dict[str, Any]], against: str) -> list[dict[str, Any]]:
    """Return the paired comparison of each predictor with a reference, on the same seeds.

    ``change_percent`` is the change of the mean pooled MAE, with a 95 % bootstrap interval over
    seeds. ``median_percent`` is the median of the changes of single seeds. ``wins`` of ``seeds``
    had the smaller MAE. Where the reference did not run there is nothing to compare.
    """
    table = {tuple(row[key] for key in KEY): row["mae"] for row in runs}
    rows = []
    for cell, members in grouped(sorted(runs, key=itemgetter("seed")), *_CELL).items():
        others = [_key_of(tuple(row[key] for key in KEY), against) for row in members]
        pairs = [
            (row["mae"], table[other])
            for row, other in zip(members, others, strict=True)
            if other in table
        ]
        if cell[-2] == against or not pairs:
            continue
        own, other = np.array(pairs).T
        ratio = resampled(own) / resampled(other)
        low, high = interval_of(100.0 * (ratio - 1.0), len(own))
        rows.append(
            {
                **dict(zip(_CELL, cell, strict=True)),
                "against": against,
                "change_percent": 100.0 * float(own.mean() / other.mean() - 1.0),
                "low": low,
                "high": high,
                "median_percent": 100.0 * float(np.median(own / other) - 1.0),
                "wins": int((own < other).sum()),
                "seeds": len(own),
            }
        )
    return rows


def channel_table(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return errors, CRPS and coverage by channel and horizon, mean over pooled seeds.

    ``coverage90`` is the share of errors inside the 90 % intervals, of the displacement inside the
    90 % ellipse. The displacement has no CRPS: those of ``along`` and ``across`` stand for it.
    """
    cells: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for result in results:
        for plan, table in result["plans"].items():
            key = (*(result["unit"][name] for name in _CELL[:-1]), plan)
            cells.setdefault(key, []).append(table["channels"])
    return [
        {
            **dict(zip(_CELL, key, strict=True)),
            "channel": channel,
            "horizon_s": horizon,
            **{m: float(np.mean([part[channel][m][j] for part in parts])) for m in metrics},
        }
        for key, parts in cells.items()
        for channel, metrics in parts[0].items()
        for j, horizon in enumerate(HORIZONS)
    ]


def recorded_table(results: Sequence[dict[str, Any]], against: str) -> list[dict[str, Any]]:
    """Return the RMSE after 10 s over that of raw persistence, of the recorded runs of a folder.

    ``ratio`` is its mean over runs, with a 95 % bootstrap interval, ``geometric`` its geometric
    mean. ``change_percent`` compares the mean ratio with that of ``against`` on the same runs,
    with its paired interval. Simulated runs are left out.

    That persistence keeps the velocities of the twin's own navigation. ``ratio_recorded`` is to
    persistence of the recorded u, v and r: the ratio of the mean errors. ``rmse`` is the mean
    error itself, m or rad, ``error`` the same in m or degrees.
    """
    cells: dict[tuple[str, ...], dict[str, float]] = {}
    held: dict[tuple[str, ...], dict[str, float]] = {}
    for result in results:
        unit = result["unit"]
        if unit["log"]:
            folder = Path(unit["log"]).absolute().parent.name
            for plan, table in result["plans"].items():
                for channel in ("displacement", "psi"):
                    rmse = math.sqrt(table["channels"][channel]["mse"][-1])
                    key = (folder, unit["fault"], plan, channel, unit["predictor"])
                    cells.setdefault(key, {})[unit["scenario"]] = rmse
                    if "held_mse" in result:
                        recorded = math.sqrt(result["held_mse"][channel])
                        held.setdefault(key, {})[unit["scenario"]] = recorded
    rows: list[dict[str, Any]] = []
    for where, own in cells.items():
        rmse = float(np.mean(list(own.values())))
        row = {
            **dict(zip(("folder", "fault", "plan", "channel", "predictor"), where, strict=True)),
            "runs": len(own),
            "rmse": rmse,
            "error": math.degrees(rmse) if where[3] == "psi" else rmse,
        }
        held_rmse = float(np.mean(list(held.get(where, {}).values() or [0.0])))
        if held_rmse > 0.0:
            row["ratio_recorded"] = rmse / held_rmse
        base = cells.get((*where[:-1], BASELINE), {})
        other = cells.get((*where[:-1], against), {}) if where[-1] != against else {}
        found = _ratios(own, base, other)
        if "change_percent" in found:
            found = {**found, "against": against}
        rows.append({**row, **found})
    return rows


def _ratios(
    own: Mapping[str, float], base: Mapping[str, float], other: Mapping[str, float]
) -> dict[str, Any]:
    """Return errors by run over those of persistence, and their change against a reference."""
    names = sorted(name for name in own if base.get(name, 0.0) > 0.0)
    if not names:
        return {}
    ratio = np.array([own[name] / base[name] for name in names])
    low, high = interval_of(resampled(ratio), len(ratio))
    found: dict[str, Any] = {
        "ratio": float(ratio.mean()),
        "low": low,
        "high": high,
        "geometric": float(np.exp(np.log(np.maximum(ratio, 1e-12)).mean())),
    }
    both = [k for k, name in enumerate(names) if name in other]
    if both:
        mine = ratio[both]
        theirs = np.array([other[names[k]] / base[names[k]] for k in both])
        change = 100.0 * (resampled(mine) / resampled(theirs) - 1.0)
        low, high = interval_of(change, len(both))
        found |= {
            "wins": int((mine < theirs).sum()),
            "change_percent": 100.0 * float(mine.mean() / theirs.mean() - 1.0),
            "change_low": low,
            "change_high": high,
        }
    return found
