"""What the study found, from its episodes: estimates with intervals, paired tests, trainings."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import platform
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.agents.hyperparameters import hyperparameters
from twin.agents.study.settings import Piece, Settings, name_of, pieces
from twin.agents.study.statistics import STATISTICS, interval, mean, replicates, verdict
from usv_kernel import __version__

__all__ = ["ALL", "QUESTIONS", "collect", "pairs"]

Array = NDArray[np.float64]

ALL = "all"
"""All losses together."""

PACKAGES = ("gymnasium", "numba", "numpy", "sb3-contrib", "stable-baselines3", "torch")

ESTIMATES = {
    "off_path_m": ("off_path_m", "iqm"),
    "off_path_mean_m": ("off_path_m", "mean"),
    "success": ("success", "mean"),
}
"""Estimates with an interval by name: of which metric, and which statistic."""

QUESTIONS = {
    "twin": ("compact", "compact_raw"),
    "identified": ("compact_params", "compact"),
    "truth": ("compact", "compact_oracle"),
}
"""Sets that are compared: does the twin help, does what it identified, and what does truth add?"""

EPISODES = {"path": ("off_path_m", "success"), "docking": ("success", "length_s")}
"""Scores of single episodes that are kept, by task."""


def collect(
    settings: Settings, done: Mapping[Piece, Mapping[str, Any]], command: str
) -> dict[str, Any]:
    """Return all that the study found, from what :func:`twin.agents.study.runs.work` yielded.

    It is ready for JSON, but for its numbers, which :func:`twin.agents.study.report.write` rounds.
    """
    order = [piece for piece in pieces(settings) if piece in done]
    scores = _Scores(settings, {piece: done[piece]["rows"] for piece in order})
    given = {key: value for key, value in dataclasses.asdict(settings).items() if key != "hyper"}
    given["conditions"] = {name: given["conditions"][name] for name in settings.evaluated}
    algos = dict.fromkeys(arm[0] for arm in settings.arms)
    levels = {name_of(piece): done[piece]["level"] for piece in order if "level" in done[piece]}
    cells, paired = scores.compared()
    return {
        "command": command,
        "versions": _versions(),
        "settings": given,
        "hyper": {algo: settings.hyper.get(algo) or hyperparameters(algo) for algo in algos},
        "levels": levels,
        "cells": cells,
        "paired": paired,
        "curves": [
            _curve(settings, piece, done[piece]["curve"], levels) for piece in order if piece[1]
        ],
        "episodes": list(scores.episodes()),
    }


def _versions() -> dict[str, str]:
    """Return the versions of what the numbers depend on."""
    found = {"usv-twin": __version__, "python": platform.python_version()}
    return found | {name: importlib.metadata.version(name) for name in PACKAGES}


def pairs(settings: Settings) -> list[tuple[str, str, str]]:
    """Return question, agent and other of each pair: an arm against controllers, or sets."""
    studied, arms = settings.studied, settings.arms
    found = [(base, name_of(arm), base) for base in studied.against for arm in arms]
    for question, (one, other) in QUESTIONS.items():
        found += [
            (question, f"{algo}-{one}", f"{algo}-{other}")
            for algo in dict.fromkeys(arm[0] for arm in arms)
            if {(algo, one), (algo, other)} <= set(arms)
        ]
    return found


def _curve(
    settings: Settings,
    piece: Piece,
    curve: Sequence[Mapping[str, float]],
    levels: Mapping[str, float],
) -> dict[str, Any]:
    """Return a learning curve, and when it first was at the level of the controller."""
    metric, better = settings.studied.metric, settings.studied.better
    columns = ("decisions", "cpu_s", "off_path_m", "success", "return")
    found: dict[str, Any] = {"agent": name_of(piece), "seed": piece[2]}
    found |= {key: [row[key] for row in curve] for key in columns}
    level = levels.get(settings.studied.level)
    there = [] if level is None else [row for row in curve if better * (row[metric] - level) >= 0.0]
    for name in ("decisions", "cpu_s"):
        found[f"level_{name}"] = there[0][name] if there else None
    return found


class _Scores:
    """The episodes of all agents as arrays."""

    def __init__(
        self, settings: Settings, rows: Mapping[Piece, Sequence[Mapping[str, Any]]]
    ) -> None:
        self.settings = settings
        self.agents = list(dict.fromkeys(map(name_of, rows)))
        self.runs: dict[str, list[dict[tuple[str, str, str], list[Mapping[str, Any]]]]] = {}
        self.pieces = list(rows)
        for piece, found in rows.items():
            parts: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
            for row in found:
                parts.setdefault((row["condition"], row["sea"], row["faults"]), []).append(row)
            self.runs.setdefault(name_of(piece), []).append(parts)

    def of(self, agent: str, condition: str, faults: str, metric: str) -> Array:
        """Return the scores of an agent, shape (strata, runs, episodes).

        Strata are sea states, with all losses those of each. Times are of episodes that succeeded.
        """
        losses = self.settings.losses if faults == ALL else (faults,)
        strata = [
            (condition, sea, loss)
            for loss in losses
            for sea in self.settings.conditions[condition].seas
        ]
        return np.array(
            [[[_score(row, metric) for row in run[stratum]] for run in self.runs[agent]]
             for stratum in strata]
        )  # fmt: skip

    def compared(self) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        """Return the estimates of each agent, condition and loss, and the paired tests."""
        cells: list[dict[str, Any]] = []
        paired: list[dict[str, Any]] = []
        for condition in self.settings.evaluated:
            for faults in (*self.settings.losses, ALL):
                made, samples = self._cells(condition, faults)
                cells += made
                paired += self._pairs({cell["agent"]: cell for cell in made}, samples)
        return cells, paired

    def _cells(self, condition: str, faults: str) -> tuple[list[dict[str, Any]], dict[str, Array]]:
        """Return a row for each agent, and the bootstrap samples of what they are compared by."""
        studied = self.settings.studied
        rows = {
            agent: {"agent": agent, "condition": condition, "faults": faults,
                    "runs": len(self.runs[agent])}
            for agent in self.agents
        }  # fmt: skip
        samples: dict[str, Array] = {}
        for name, (metric, statistic) in ESTIMATES.items():
            of = STATISTICS[statistic]
            scores = {agent: self.of(agent, condition, faults, metric) for agent in self.agents}
            drawn = replicates(scores, of)
            if (metric, statistic) == (studied.metric, studied.statistic):
                samples = drawn
            for agent, row in rows.items():
                low, high = interval(drawn[agent])
                row |= {name: float(of(scores[agent].ravel())), f"{name}_ends": [low, high]}
        for agent, row in rows.items():
            for metric in ("failed", "length_s", "return"):
                value = float(mean(self.of(agent, condition, faults, metric).ravel()))
                row[metric] = value if np.isfinite(value) else None
        return list(rows.values()), samples

    def _pairs(
        self, cells: Mapping[str, Mapping[str, Any]], samples: Mapping[str, Array]
    ) -> Iterator[dict[str, Any]]:
        """Yield a paired test of each pair, all of one condition and loss."""
        studied = self.settings.studied
        name = next(
            key for key, of in ESTIMATES.items() if of == (studied.metric, studied.statistic)
        )
        for question, agent, other in pairs(self.settings):
            if not {agent, other} <= set(self.agents):
                continue
            low, high = interval(samples[agent] - samples[other])
            yield {
                **{"question": question, "agent": agent, "against": other},
                **{key: cells[agent][key] for key in ("condition", "faults")},
                "difference": cells[agent][name] - cells[other][name],
                **{"low": low, "high": high, "verdict": verdict(low, high, studied.better)},
            }

    def episodes(self) -> Iterator[dict[str, Any]]:
        """Yield the scores of all episodes, a row for each run, condition, sea state and loss."""
        for agent, runs in self.runs.items():
            seeds = [piece[2] for piece in self.pieces if name_of(piece) == agent]
            for seed, run in zip(seeds, runs, strict=True):
                for (condition, sea, faults), rows in run.items():
                    found: dict[str, Any] = {"agent": agent, "seed": seed, "condition": condition}
                    found |= {"sea": sea, "faults": faults}
                    for metric in EPISODES[self.settings.task]:
                        found[metric] = [row[metric] for row in rows]
                    # a digit for each, 1 for a success
                    found["success"] = "".join("01"[row["success"]] for row in rows)
                    yield found


def _score(row: Mapping[str, Any], metric: str) -> float:
    """Return the score of an episode; that of a failed one has no time."""
    return np.nan if metric == "length_s" and not row["success"] else float(row[metric])
