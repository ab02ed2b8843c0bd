"""Scores of predictions against the truth, and what a benchmark makes of many of them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from twin.benchmark.protocol import HORIZONS, TYPICAL, UNIT_KEY
from twin.logs.log import Log
from twin.predictors.base import Z90, Prediction

__all__ = [
    "CHANNELS",
    "METRICS",
    "STUDY_CHANNELS",
    "STUDY_HORIZONS",
    "Reference",
    "Score",
    "channel_table",
    "compare",
    "crps",
    "recorded_table",
    "rows_of",
    "run_rows",
    "score",
    "summarise",
    "table_of",
    "trends",
]

Array = NDArray[np.float64]

CHANNELS = ("u", "v", "r", "along", "across", "psi")

STUDY_CHANNELS = ("u", "v", "r", "psi", "displacement")
"""What ``J`` is the mean of; displacement is the distance between where the boat is and where
it was predicted, both counted from where the prediction started."""

STUDY_HORIZONS = tuple(0.5 * k for k in range(1, 21))

METRICS = (
    *("mae", "mae_median", "mse", "normalised", "skill", "J", "E", "E_runs", "crps"),
    *("start_error", "displacement_10s", "psi_10s", "coverage90"),
)

BASELINE = "persistence"

FLOOR = "oracle"

_OUTSIDE_ELLIPSE = -2.0 * math.log(0.1)

_AT = [STUDY_HORIZONS.index(h) for h in HORIZONS]

_FLAT = math.sqrt(2.0 / math.pi)
"""Mean size of a standard normal number."""

_PAIR = (4.0 - 2.0 * math.sqrt(2.0)) / math.sqrt(math.pi)
"""Mean difference of the sizes of two of them."""


def crps(off: Array, down: Array, up: Array) -> Array:
    """Return the continuous ranked probability score of two-piece normal distributions.

    Below its mode such a distribution has one width, above it another: that of a prediction's
    mean with its 5 % and 95 % points. Where both are equal it is the normal distribution. In
    the unit of the values; of a certain prediction it is the absolute error.

    Source: CRPS = E|X - y| - E|X - X'| / 2, Gneiting and Raftery 2007; the same numbers as
    ``scoringrules.crps_2pnormal``, whose import compiles for seconds in every worker.

    Parameters
    ----------
    off : ndarray
        Truth less mode.
    down, up : ndarray
        Widths (standard deviations) below and above the mode.

    Returns
    -------
    ndarray
    """
    near = np.maximum(np.where(off < 0.0, down, up), 1e-12)
    far = np.maximum(np.where(off < 0.0, up, down), 1e-12)
    total, away = near + far, np.abs(off)
    a = away / near
    bell = 2.0 * _FLAT * np.exp(-0.5 * a * a)  # 4 times the density at a
    to_truth = far * (away + _FLAT * far) + near * near * (
        bell - _FLAT - a + 2.0 * a * erf(a / math.sqrt(2.0))
    )
    apart = (_PAIR * (near**3 + far**3) / total + 2.0 * _FLAT * near * far) / total
    return np.asarray(to_truth / total - 0.5 * apart)


NEARBY = 3.0
"""A recorded sample must lie this many usual steps, and at least as many half seconds, from what
is scored against it: across a gap nobody knows where the boat was."""


class Reference:
    """What is scored against: the truth of a log, or its recorded positions and headings."""

    def __init__(self, log: Log) -> None:
        if log.truth is not None:
            self.t, self.columns = [log.t] * 6, list(log.truth.T.copy())
            self.columns[2] = np.unwrap(self.columns[2])
            return
        self.t, self.columns = [], []
        for entry in (0, 1, 4):
            seen = np.isfinite(log.z[:, entry])
            if not seen.any():
                raise ValueError(
                    f"{log.name}: has no positions or no headings to score predictions against"
                )
            values = log.z[seen, entry]
            self.t.append(log.t[seen])
            self.columns.append(np.unwrap(values) if entry == 4 else values)

    def known(self, times: Array) -> bool:
        """Return whether there are samples near all of some times."""
        for t in self.t[-1 if len(self.t) == 6 else 0 :]:
            reach = NEARBY * max(0.5, float(np.median(np.diff(t))) if len(t) > 1 else 0.0)
            after = np.searchsorted(t, times).clip(max=len(t) - 1)
            apart = np.minimum(
                np.abs(t[after] - times), np.abs(times - t[np.maximum(after - 1, 0)])
            )
            if (apart > reach).any():
                return False
        return True

    def at(self, times: Array) -> Array:
        """Return states (h, 6) or (h, 3) at times, linearly between samples."""
        return np.stack(
            [np.interp(times, t, c) for t, c in zip(self.t, self.columns, strict=True)], axis=1
        )


class Score(NamedTuple):
    """One prediction against the truth, at h horizons.

    ``error`` and ``change`` (h, c) are errors and true changes of the channels (the last c of
    :data:`CHANNELS`), ``away`` (h,) the error of the displacement, ``crps`` (h, c) the score of
    the channels' distributions, and ``inside`` (h, c + 1) says whether channels and displacement
    lie in the 90 % bands.
    """

    error: Array
    change: Array
    away: Array
    crps: Array
    inside: NDArray[np.bool_]


def score(prediction: Prediction, truth: Array, horizons: Sequence[float]) -> Score:
    """Compare one prediction with the truth.

    Positions count from where the prediction started, so that the error of the start, which
    is the receiver's and common to all predictors, is not counted again at each horizon; it
    is reported on its own (``start_error``).

    Parameters
    ----------
    prediction : Prediction
        What was said.
    truth : ndarray, shape (1 + h, 6) or (1 + h, 3)
        True states, or positions and headings alone: at the start, then at the horizons.
    horizons : sequence of float
        Seconds after the start.
    """
    mean, cov = prediction.at(np.array(horizons))
    low, high = prediction.band(np.array(horizons))
    start, later = truth[0], truth[1:]
    psi = later[:, 2]
    c, s = np.cos(psi), np.sin(psi)
    moved = later[:, :2] - start[:2]
    ex, ey = (mean[:, :2] - prediction.start[:2] - moved).T
    spread = cov - prediction.start_cov
    xx, xy, yy = spread[:, 0, 0], spread[:, 0, 1], spread[:, 1, 1]
    error, change, inside, widths = [], [], [], []
    if truth.shape[1] == 6:
        for i in (3, 4, 5):
            error.append(mean[:, i] - later[:, i])
            change.append(later[:, i] - start[i])
            inside.append((low[:, i] <= later[:, i]) & (later[:, i] <= high[:, i]))
            widths.append((mean[:, i] - low[:, i], high[:, i] - mean[:, i]))
    # along the true heading, then across it to starboard
    for a, b in ((c, s), (-s, c)):
        error.append(a * ex + b * ey)
        change.append(a * moved[:, 0] + b * moved[:, 1])
        sd = np.sqrt(np.maximum(a * a * xx + 2.0 * a * b * xy + b * b * yy, 0.0))
        inside.append(np.abs(error[-1]) <= Z90 * sd)
        widths.append((Z90 * sd, Z90 * sd))
    turn = (mean[:, 2] - psi + math.pi) % (2.0 * math.pi) - math.pi
    error.append(turn)
    change.append(psi - start[2])
    inside.append((low[:, 2] - mean[:, 2] <= -turn) & (-turn <= high[:, 2] - mean[:, 2]))
    widths.append((mean[:, 2] - low[:, 2], high[:, 2] - mean[:, 2]))
    size = np.maximum(xx * yy - xy * xy, 0.0)
    inside.append(yy * ex * ex - 2.0 * xy * ex * ey + xx * ey * ey <= _OUTSIDE_ELLIPSE * size)
    errors = np.stack(error, axis=1)
    down, up = np.maximum(np.array(widths), 0.0).transpose(1, 2, 0) / Z90
    return Score(
        *(errors, np.stack(change, axis=1), np.hypot(ex, ey)),
        *(crps(-errors, down, up), np.stack(inside, axis=1)),
    )


def table_of(parts: Sequence[Score]) -> dict[str, Any]:
    """Return what a result keeps of the scores of one predictor on one run.

    Parameters
    ----------
    parts : sequence of Score
        At :data:`STUDY_HORIZONS`.

    Returns
    -------
    dict
        ``n`` predictions; by channel (also ``displacement``) ``mae``, ``mse``, ``crps`` and
        ``coverage90`` at :data:`HORIZONS`; ``scale``, the root mean square of the true change;
        ``curves``, the MAE of the study's channels at every half second.
    """
    error, change, away, sharp, inside = (np.array(item) for item in zip(*parts, strict=True))
    channels = CHANNELS[-error.shape[2] :]
    size = {c: np.abs(error[:, :, i]) for i, c in enumerate(channels)} | {"displacement": away}
    table: dict[str, Any] = {
        channel: {
            "mae": values[:, _AT].mean(axis=0).tolist(),
            "mse": (values[:, _AT] ** 2).mean(axis=0).tolist(),
            "coverage90": inside[:, _AT, i].mean(axis=0).tolist(),
        }
        for i, (channel, values) in enumerate(size.items())
    }
    for i, channel in enumerate(channels):
        table[channel]["crps"] = sharp[:, _AT, i].mean(axis=0).tolist()
    return {
        "n": len(parts),
        "channels": table,
        "scale": np.sqrt(np.mean(change[:, _AT] ** 2, axis=0)).T.tolist(),
        "curves": {c: size[c].mean(axis=0).tolist() for c in STUDY_CHANNELS if c in size},
    }


def rows_of(results: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield the errors of each run, predictor, plan, channel and horizon.

    Parameters
    ----------
    results : sequence of dict
        From :func:`twin.benchmark.runner.run_unit`.
    """
    for result in results:
        for plan, table in result["plans"].items():
            for channel, values in table["channels"].items():
                if channel in CHANNELS:
                    for j, horizon in enumerate(HORIZONS):
                        yield {
                            **{key: result["unit"][key] for key in UNIT_KEY},
                            **{"plan": plan, "channel": channel, "horizon_s": horizon},
                            **{m: values[m][j] for m in ("mae", "mse", "crps")},
                            "n": table["n"],
                        }


def _resampled(values: Array) -> Array:
    """Return 2000 bootstrap means over seeds, from the same draws for every row."""
    n = len(values)
    return values[np.random.default_rng(0).integers(0, n, (2000, n))].mean(axis=1)


def _interval(means: Array, seeds: int) -> tuple[float | None, float | None]:
    """Return the middle 95 % of bootstrap values; none for fewer than three seeds."""
    if seeds < 3:
        return None, None
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


KEY = (*UNIT_KEY, "plan")
"""What tells the rows of ``results["runs"]`` apart."""


def run_rows(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row of metrics for each run, predictor and plan.

    ``mae`` and ``mse`` are pooled over :data:`CHANNELS` and :data:`HORIZONS` (as in the
    paper's Table 4, units mixed); ``normalised`` is the mean over channels and horizons of
    the MAE over the root mean square of the true change; ``skill`` is 1 minus the mean of the
    ratios to raw persistence; ``J`` is the mean over :data:`STUDY_CHANNELS` of the MAE (mean
    over :data:`STUDY_HORIZONS`) over that of the oracle on the same run, and ``E`` is J - 1
    (how they are summed up over runs: :func:`summarise`);
    ``start_error`` is the distance of the believed from the true position at the origins, m;
    ``displacement_10s`` (m) and ``psi_10s`` (rad) the MAE after 10 s; ``crps`` that of the
    channels' distributions (see :func:`crps`), pooled as the MAE; ``coverage90`` the share of
    errors inside the 90 % bands, mean of channels and horizons.

    Parameters
    ----------
    results : sequence of dict
        From :func:`twin.benchmark.runner.run_unit`.
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
        base, floor = (_of(key, name) for name in (BASELINE, FLOOR))
        if base in rows:
            row["skill"] = 1.0 - float(np.mean(tables[key] / np.maximum(tables[base], 1e-12)))
        if floor in rows:
            row["J"] = float(_over_floor(_study_errors(row), _study_errors(rows[floor])))
            row["E"] = row["J"] - 1.0
    return list(rows.values())


def _study_errors(row: dict[str, Any]) -> Array:
    """Return the mean error of each of the study's channels."""
    return np.array([np.mean(row["curves"][channel]) for channel in STUDY_CHANNELS])


def _over_floor(own: Array, floor: Array) -> Array:
    """Return the mean over channels (last axis) of errors over those of the oracle."""
    return np.asarray(np.mean(own / np.maximum(floor, 1e-12), axis=-1))


def _of(key: tuple[Any, ...], predictor: str) -> tuple[Any, ...]:
    """Return the key of another predictor on the same run."""
    return (*key[:-2], predictor, key[-1])


def _groups(
    runs: Sequence[dict[str, Any]], *keys: str
) -> dict[tuple[Any, ...], list[dict[str, Any]]]:
    """Return rows with the same values of some keys together, ordered by seed."""
    groups: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in sorted(runs, key=lambda row: row["seed"]):
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return groups


_CELL = tuple(key for key in KEY if key != "seed")

_SOURCES = {"mae_median": "mae", "E_runs": "E"}


def summarise(runs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the summary over seeds: means with 95 % bootstrap intervals, and medians.

    ``J`` is of means, as in the study: the mean error over all runs over that of the oracle,
    averaged over channels, and ``E`` is that minus 1; their medians are of single runs. The mean
    of the runs' own E is ``E_runs``: few of them, where the oracle is nearly perfect, can make most
    of it. ``mae_median`` is the median MAE as a metric of its own.

    Parameters
    ----------
    runs : sequence of dict
        From :func:`run_rows`.
    """
    order = {tuple(row[key] for key in _CELL): None for row in runs}
    groups = _groups(runs, *_CELL)
    errors = {tuple(row[key] for key in KEY): _study_errors(row) for row in runs if "J" in row}
    summary = []
    for cell in order:
        members = groups[cell]
        keys = [tuple(row[key] for key in KEY) for row in members]
        floors = [_of(key, FLOOR) for key in keys]
        over_floor = all(key in errors for key in (*keys, *floors))
        for metric in METRICS:
            source = _SOURCES.get(metric, metric)
            if any(source not in row for row in members):
                continue
            if source in ("J", "E") and not over_floor:
                continue
            values = np.array([row[source] for row in members])
            value, low, high = float(np.median(values)), None, None
            if metric != "mae_median":
                means = _resampled(values)
                value = float(values.mean())
                if metric in ("J", "E"):
                    own, floor = (np.array([errors[k] for k in each]) for each in (keys, floors))
                    less = 1.0 if metric == "E" else 0.0
                    means = _over_floor(_resampled(own), _resampled(floor)) - less
                    value = float(_over_floor(own.mean(axis=0), floor.mean(axis=0))) - less
                low, high = _interval(means, len(values))
            summary.append(
                {
                    **dict(zip(_CELL, cell, strict=True)),
                    "metric": metric,
                    "value": value,
                    "low": low,
                    "high": high,
                    "median": float(np.median(values)),
                }
            )
    return summary


def compare(runs: Sequence[dict[str, Any]], against: str) -> list[dict[str, Any]]:
    """Return the paired comparison of each predictor with a reference, on the same seeds.

    ``change_percent`` is the change of the mean pooled MAE, with a 95 % bootstrap interval
    over seeds; ``median_percent`` the median of the changes of single seeds; ``wins`` of
    ``seeds`` had the smaller MAE.

    Parameters
    ----------
    runs : sequence of dict
        From :func:`run_rows`.
    against : str
        Predictor to compare with; where it did not run there is nothing to compare.
    """
    table = {tuple(row[key] for key in KEY): row["mae"] for row in runs}
    rows = []
    for cell, members in _groups(runs, *_CELL).items():
        others = [_of(tuple(row[key] for key in KEY), against) for row in members]
        pairs = [
            (row["mae"], table[other])
            for row, other in zip(members, others, strict=True)
            if other in table
        ]
        if cell[-2] == against or not pairs:
            continue
        own, other = np.array(pairs).T
        ratio = _resampled(own) / _resampled(other)
        low, high = _interval(100.0 * (ratio - 1.0), len(own))
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
    """Return errors, CRPS and coverage of the bands by channel and horizon, mean over seeds.

    ``coverage90`` is the share of errors inside the 90 % bands: of the displacement, inside the
    90 % ellipse. It has no CRPS: the scores of ``along`` and ``across`` say that.

    Parameters
    ----------
    results : sequence of dict
        From :func:`twin.benchmark.runner.run_unit`; seeds are pooled.
    """
    cells: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for result in results:
        for plan, table in result["plans"].items():
            key = (*(result["unit"][name] for name in _CELL[:-1]), plan)
            cells.setdefault(key, []).append(table["channels"])
    return [
        {
            **dict(zip(_CELL, key, strict=True)),
            **{"channel": channel, "horizon_s": horizon},
            **{m: float(np.mean([part[channel][m][j] for part in parts])) for m in metrics},
        }
        for key, parts in cells.items()
        for channel, metrics in parts[0].items()
        for j, horizon in enumerate(HORIZONS)
    ]


def _gps_loss(row: dict[str, Any]) -> float | None:
    """Return the length of a loss of GPS alone, s; None in other cases."""
    lost = re.fullmatch(r"gps(\d+\.?\d*)", row["fault"])
    return 0.0 if row["fault"] == "none" else float(lost[1]) if lost else None


def _sea_state(row: dict[str, Any]) -> float | None:
    """Return the number of a sea state without losses; None in other cases."""
    return float(row["sea"]) if row["sea"].isdigit() and row["fault"] == "none" else None


TRENDS: dict[str, Callable[[dict[str, Any]], float | None]] = {
    "gps_loss_s": _gps_loss,
    "sea_state": _sea_state,
}
"""What the error is shown against, of simulated runs that differ in nothing else."""


def trends(runs: Sequence[dict[str, Any]], sea: str) -> list[dict[str, Any]]:
    """Return the error against the length of a GPS loss and against the sea state.

    Each value is the mean over boats of the mean over scenarios, with its 95 % bootstrap
    interval over boats. A trend needs three values or more of what it is shown against.

    Parameters
    ----------
    runs : sequence of dict
        From :func:`run_rows`.
    sea : str
        Name of the sea state that losses of GPS are shown in.
    """
    rows = []
    for axis, value_of in TRENDS.items():
        kept = [
            (value, row)
            for row in runs
            if row["grade"] == TYPICAL and (axis == "sea_state" or row["sea"] == sea)
            if (value := value_of(row)) is not None
        ]
        if len({value for value, _ in kept}) < 3:
            continue
        cells: dict[tuple[Any, ...], dict[int, list[dict[str, Any]]]] = {}
        for value, row in kept:
            cell = cells.setdefault((row["predictor"], row["plan"], value), {})
            cell.setdefault(row["seed"], []).append(row)
        for (predictor, plan, value), seeds in sorted(cells.items(), key=lambda item: item[0][2]):
            for metric in ("displacement_10s", "psi_10s", "start_error"):
                means = np.array(
                    [np.mean([row[metric] for row in seeds[seed]]) for seed in sorted(seeds)]
                )
                low, high = _interval(_resampled(means), len(means))
                rows.append(
                    {
                        **{"axis": axis, "at": value, "predictor": predictor, "plan": plan},
                        **{"metric": metric, "value": float(means.mean())},
                        **{"low": low, "high": high, "seeds": len(means)},
                    }
                )
    return rows


def recorded_table(results: Sequence[dict[str, Any]], against: str) -> list[dict[str, Any]]:
    """Return the RMSE after 10 s over that of raw persistence, of the recorded runs of a folder.

    ``ratio`` is its mean over runs, with a 95 % bootstrap interval, ``geometric`` its
    geometric mean; ``change_percent`` how far the mean ratio is above that of ``against`` on
    the same runs, with its paired interval.

    Parameters
    ----------
    results : sequence of dict
        From :func:`twin.benchmark.runner.run_unit`; those of simulated runs are left out.
    against : str
        Predictor to compare with.
    """
    cells: dict[tuple[str, ...], dict[str, float]] = {}
    for result in results:
        unit = result["unit"]
        if unit["log"]:
            folder = Path(unit["log"]).absolute().parent.name
            for plan, table in result["plans"].items():
                for channel in ("displacement", "psi"):
                    rmse = math.sqrt(table["channels"][channel]["mse"][-1])
                    key = (folder, unit["fault"], plan, channel, unit["predictor"])
                    cells.setdefault(key, {})[unit["scenario"]] = rmse
    rows: list[dict[str, Any]] = []
    for where, own in cells.items():
        base = cells.get((*where[:-1], BASELINE), {})
        names = sorted(name for name in own if base.get(name, 0.0) > 0.0)
        if not names:
            continue
        ratio = np.array([own[name] / base[name] for name in names])
        low, high = _interval(_resampled(ratio), len(ratio))
        row = {
            **dict(zip(("folder", "fault", "plan", "channel", "predictor"), where, strict=True)),
            **{"runs": len(names), "rmse": float(np.mean([own[name] for name in names]))},
            **{"ratio": float(ratio.mean()), "low": low, "high": high},
            "geometric": float(np.exp(np.log(np.maximum(ratio, 1e-12)).mean())),
        }
        other = cells.get((*where[:-1], against), {})
        both = [k for k, name in enumerate(names) if name in other]
        if both and where[-1] != against:
            mine = ratio[both]
            theirs = np.array([other[names[k]] / base[names[k]] for k in both])
            change = 100.0 * (_resampled(mine) / _resampled(theirs) - 1.0)
            low, high = _interval(change, len(both))
            row |= {
                **{"against": against, "wins": int((mine < theirs).sum())},
                "change_percent": 100.0 * float(mine.mean() / theirs.mean() - 1.0),
                **{"change_low": low, "change_high": high},
            }
        rows.append(row)
    return rows
