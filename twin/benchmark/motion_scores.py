"""Scores of forecasts of roll, pitch, heave and deck speed, and of quiet spells."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.benchmark.protocol import UNIT_KEY
from twin.benchmark.scores import crps
from twin.logs.log import Log
from twin.motion import QUIET_SPANS, MotionForecast
from twin.particulars import Particulars
from twin.predictors.base import Z90
from twin.predictors.registry import DEFAULT

__all__ = [
    "MOTION_HORIZONS",
    "MOTION_METRICS",
    "MOTION_UNITS",
    "SHOWN_UNITS",
    "MotionScore",
    "MotionTruth",
    "attitude_lines",
    "auc",
    "median_scores",
    "motion_rows",
    "motion_table",
    "quiet_rows",
    "shown_motion",
]

Array = NDArray[np.float64]

MOTION_UNITS = {"roll": "rad", "pitch": "rad", "heave": "m", "deck_speed": "m/s"}
"""Channels and their units; the last two are positive down."""

MOTION_METRICS = ("rmse", "sd", "skill", "held", "crps", "coverage90")

SHOWN_UNITS = {
    channel: ("deg", math.degrees(1.0)) if unit == "rad" else (unit, 1.0)
    for channel, unit in MOTION_UNITS.items()
}
"""Unit in which people read the errors of a channel, and the factor to it."""

MOTION_HORIZONS = (0.5, 1.0, 2.0, 3.0, 5.0, 10.0)
"""Times ahead, s."""


class MotionScore(NamedTuple):
    """One forecast beside the truth."""

    error: Array  # (h, 4)
    from_mean: Array  # (h, 4): true deviation from the mean of the run
    held: Array  # (h, 4): error of the estimate now, held
    crps: Array  # (h, 4)
    covered: NDArray[np.bool_]  # (h, 4): whether the 90 % intervals cover
    quiet: Array  # (3,): probabilities
    was_quiet: NDArray[np.bool_]  # (3,)
    margin: float  # how far the deck is within its limits now: below 0, beyond them


class MotionTruth:
    """True motion of a simulated run."""

    def __init__(self, log: Log, particulars: Particulars, begin: float) -> None:
        """``begin`` (s) is the start of what is scored: heave is counted from its mean there."""
        assert log.true_motion is not None
        assert log.truth is not None
        z, roll, pitch, w, p, q = log.true_motion.T
        u, v, r = log.truth[:, 3:6].T
        a, b, c = particulars.deck.point_of(particulars.length)
        ahead, side, down = u + q * c - r * b, v + r * a - p * c, w + p * b - q * a
        turned = np.sin(roll) * side + np.cos(roll) * down
        speed = np.cos(pitch) * turned - np.sin(pitch) * ahead
        self.t = log.t
        self.values = np.stack([roll, pitch, z - z[log.t >= begin].mean(), speed], axis=1)
        self._mean = self.values[log.t >= begin].mean(axis=0)
        deck = particulars.deck
        limits = np.array([deck.max_tilt, deck.max_tilt, deck.max_speed])
        self._margin = 1.0 - (np.abs(self.values[:, [0, 1, 3]]) / limits).max(axis=1)

    def at(self, times: Array) -> Array:
        """Return the channels (h, 4) at times (h,), s, linearly between samples."""
        columns = [np.interp(times, self.t, column) for column in self.values.T]
        return np.stack(columns, axis=1)

    def score(self, forecast: MotionForecast) -> MotionScore:
        """Compare a forecast with the truth."""
        after = np.array(MOTION_HORIZONS)
        mean, sd = forecast.at(after)
        truth = self.at(forecast.t0 + after)
        rows = [
            slice(*np.searchsorted(self.t, (forecast.t0 - 1e-6, forecast.t0 + span + 1e-6)))
            for span in QUIET_SPANS
        ]
        return MotionScore(
            error=mean - truth,
            from_mean=truth - self._mean,
            held=forecast.mean[0] - truth,
            crps=crps(truth - mean, sd, sd),
            covered=np.abs(mean - truth) <= Z90 * sd,
            quiet=forecast.quiet,
            was_quiet=np.array([bool((self._margin[row] > 0.0).all()) for row in rows]),
            margin=float(np.interp(forecast.t0, self.t, self._margin)),
        )


def auc(score: Array, happened: NDArray[np.bool_]) -> float:
    """Return the area under the ROC curve: the chance that a score ranks yes above no.

    ``score`` and ``happened`` have shape (n,); NaN where all or none happened.
    """
    from scipy.stats import rankdata  # takes half a second

    yes, no = int(happened.sum()), int((~happened).sum())
    if not yes or not no:
        return math.nan
    return (float(rankdata(score)[happened].sum()) - yes * (yes + 1) / 2.0) / (yes * no)


def motion_table(parts: Sequence[MotionScore]) -> dict[str, Any]:
    """Return the scores of one run.

    By channel, at :data:`MOTION_HORIZONS`: ``rmse``, ``sd`` (of the true motion, about its mean in
    the run, at the very times that were forecast), ``skill`` (RMSE over sd: 1 is that of the mean),
    ``held`` (the same of the present value), ``crps`` and ``coverage90``. By span of
    ``twin.motion.QUIET_SPANS``: the forecast probabilities, what happened, and the margin now.
    """
    of = MotionScore(*map(np.array, zip(*parts, strict=True)))  # type: ignore[arg-type]
    rmse, rmse_held, sd = (
        np.sqrt(np.mean(part**2, axis=0)) for part in (of.error, of.held, of.from_mean)
    )
    scale = np.maximum(sd, 1e-9)
    return {
        "n": len(parts),
        "channels": {
            channel: {
                "rmse": rmse[:, c].tolist(),
                "sd": sd[:, c].tolist(),
                "skill": (rmse[:, c] / scale[:, c]).tolist(),
                "held": (rmse_held[:, c] / scale[:, c]).tolist(),
                "crps": of.crps[:, :, c].mean(axis=0).tolist(),
                "coverage90": of.covered[:, :, c].mean(axis=0).tolist(),
            }
            for c, channel in enumerate(MOTION_UNITS)
        },
        "quiet": {
            "probability": of.quiet.T.tolist(),
            "happened": of.was_quiet.T.tolist(),
            "margin": np.asarray(of.margin).tolist(),
        },
    }


def motion_rows(results: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield the scores of each run, predictor, plan, channel and horizon."""
    for result in results:
        for plan, table in result.get("motion", {}).items():
            for channel, values in table["channels"].items():
                for j, horizon in enumerate(MOTION_HORIZONS):
                    yield {
                        **{key: result["unit"][key] for key in UNIT_KEY},
                        "plan": plan,
                        "channel": channel,
                        "horizon_s": horizon,
                        **{metric: values[metric][j] for metric in MOTION_METRICS},
                        "n": table["n"],
                    }


def shown_motion(results: Mapping[str, Any]) -> dict[str, list[Mapping[str, Any]]]:
    """Return the rows ``motion`` and ``quiet`` of the predictor whose twin is shown.

    The predictors differ little here: their part is the turn ahead.
    """
    names = [row["predictor"] for row in results.get("motion") or []]
    name = DEFAULT if DEFAULT in names else names[0] if names else ""
    return {
        part: [row for row in results.get(part) or [] if row["predictor"] == name]
        for part in ("motion", "quiet")
    }


def median_scores(rows: Sequence[Mapping[str, Any]], horizon: float) -> dict[str, float]:
    """Return the medians over rows of one horizon (s), by the names in :data:`MOTION_METRICS`."""
    here = [row for row in rows if row["horizon_s"] == horizon]
    return {name: float(np.median([row[name] for row in here])) for name in MOTION_METRICS}


def attitude_lines(results: Mapping[str, Any]) -> list[str]:
    """Return what the verdict says of roll and pitch, and of a quiet deck; nothing without them.

    The skill is the error over the standard deviation of the motion, the median over runs.
    """
    rows, lines = shown_motion(results), []
    for channel in ("roll", "pitch"):
        block = [row for row in rows["motion"] if row["channel"] == channel]
        if block:
            one, two = (median_scores(block, horizon) for horizon in (1.0, 2.0))
            lines.append(
                f"{channel} of {block[0]['predictor']} 1 and 2 s ahead errs by {one['skill']:.2f} "
                f"and {two['skill']:.2f} of its standard deviation, held by {one['held']:.2f} and "
                f"{two['held']:.2f}; {100.0 * one['coverage90']:.0f} and "
                f"{100.0 * two['coverage90']:.0f} % are inside the 90 % intervals"
            )
    for span in QUIET_SPANS if rows["quiet"] else ():
        skills = [row["brier_skill"] for row in rows["quiet"] if row["span_s"] == span]
        known = [skill for skill in skills if skill is not None]
        said = f"Brier skill {np.median(known):.2f}" if known else "no spells of both kinds"
        lines.append(f"quiet deck for {span:g} s: {said}")
    return lines


def _reliability(p: Array, happened: NDArray[np.bool_]) -> list[list[float]]:
    """Return mean probability, share and number of each tenth of probability that occurs."""
    tenth = np.minimum((10.0 * p).astype(np.int64), 9)
    return [
        [float(p[tenth == k].mean()), float(happened[tenth == k].mean()), int((tenth == k).sum())]
        for k in np.unique(tenth)
    ]


def quiet_rows(results: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield the scores of the probability of a quiet deck, pooled over the runs of a cell.

    ``brier`` and ``brier_skill`` against the share of quiet spells in the cell (climatology),
    ``auc``, and ``auc_now`` of the simple baseline: how far the deck is within its limits now. A
    skill needs spells of both kinds. ``reliability`` has, for each tenth of probability that was
    given, its mean, the share of spells that were quiet, and their number.
    """
    cells: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    keys = tuple(key for key in UNIT_KEY if key != "seed")
    for result in results:
        for plan, table in result.get("motion", {}).items():
            key = (*(result["unit"][name] for name in keys), plan)
            cells.setdefault(key, []).append(table["quiet"])
    for key, parts in cells.items():
        margin = np.concatenate([part["margin"] for part in parts])
        for j, span in enumerate(QUIET_SPANS):
            p = np.concatenate([part["probability"][j] for part in parts])
            happened = np.concatenate([part["happened"][j] for part in parts]).astype(bool)
            base, brier = float(happened.mean()), float(np.mean((p - happened) ** 2))
            both = 0.0 < base < 1.0
            yield {
                **dict(zip((*keys, "plan"), key, strict=True)),
                "span_s": span,
                "base_rate": base,
                "brier": brier,
                "brier_skill": 1.0 - brier / (base * (1.0 - base)) if both else None,
                "auc": auc(p, happened) if both else None,
                "auc_now": auc(margin, happened) if both else None,
                "reliability": _reliability(p, happened),
                "n": len(p),
            }
