"""What an agent gains from the twin when the GPS is gone: trained, evaluated and compared.

Arms are trained with several seeds and evaluated, as are the classical controllers, on the same
episodes of every sea state with every outage. The numbers are interquartile means with intervals of
a stratified bootstrap over runs and episodes.

Source: Agarwal et al. 2021, Deep Reinforcement Learning at the Edge of the Statistical Precipice.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.agents.agent import Agent
from twin.agents.evaluation import EVALUATION_SEEDS, OUTAGES, SEAS, evaluate, on_grid
from twin.agents.forecast_table import mean_scores
from twin.agents.hyperparameters import hyperparameters
from twin.agents.policy import AgentError
from twin.agents.training import CURVE_SEEDS, EVERY, Plan, train
from twin.files import keep, kept
from twin.parallel import results_of
from usv_kernel import __version__
from usv_kernel.cache import sources_digest

__all__ = [
    "ARMS",
    "METRICS",
    "Settings",
    "check",
    "collect",
    "controllers",
    "interval",
    "iqm",
    "pieces",
    "quick",
    "replicates",
    "work",
]

Array = NDArray[np.float64]

ARMS = (
    *((algo, observation) for algo in ("ppo", "sac")
      for observation in ("raw", "raw_stacked", "twin", "oracle")),
    ("recurrent_ppo", "raw"),
)  # fmt: skip
"""Algorithms and observation sets of the study."""

METRICS = {
    "off_path_m": "distance off the path, m",
    "off_path_outage_m": "distance off the path while the GPS is gone and 20 s after, m",
    "return": "return",
    "motion": "motion, squares of roll over 10 degrees and of vertical acceleration over 2 m/s2",
}

REPLICATES = 2000

LEVEL = 95.0


@dataclass(frozen=True)
class Settings:
    """What the study does."""

    arms: tuple[tuple[str, str], ...] = ARMS  # algorithms and observation sets
    # decisions of each training; left out: n_timesteps of the algorithm's hyperparameters
    steps: int | None = None
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)  # trainings of each arm
    controllers: tuple[str, ...] = ()  # classical controllers beside them
    # where agents are evaluated
    seas: tuple[str, ...] = SEAS
    outages: tuple[str, ...] = OUTAGES
    # episodes of each sea state with each outage
    evaluation_seeds: tuple[int, ...] = EVALUATION_SEEDS
    curve_seeds: tuple[int, ...] = CURVE_SEEDS  # episodes of each point of the learning curves
    # options of Plan, such as twin and task
    options: Mapping[str, Any] = field(default_factory=dict)
    # hyperparameters by algorithm; those of this package if left out
    hyper: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def plan(self, algo: str, observation: str, seed: int) -> Plan:
        """Return the plan of one training."""
        steps = self.steps or (self.hyper.get(algo) or hyperparameters(algo))["n_timesteps"]
        every = min(EVERY, -(-steps // 4))
        options: dict[str, Any] = {"every": every, **self.options}
        return Plan(algo, observation, steps, seed, **options)


def quick(settings: Settings) -> Settings:
    """Return the same study so small that it shows only that everything runs."""
    return dataclasses.replace(
        settings,
        arms=tuple(("ppo", observation) for observation in ("raw", "twin", "oracle")),
        steps=8192,
        seeds=settings.seeds[:2],
        seas=("2",),
        outages=("none", "gps30"),
        evaluation_seeds=settings.evaluation_seeds[:4],
        curve_seeds=settings.curve_seeds[:4],
    )


def controllers() -> dict[str, Any]:
    """Return the classical controllers by name: what makes each."""
    from twin.agents.controllers import CONTROLLERS

    return dict(CONTROLLERS)


Piece = tuple[str, str, int | None]
"""Algorithm, observation set and seed; or a controller's name, nothing and None."""


def pieces(settings: Settings) -> list[Piece]:
    """Return all pieces of work, one seed of every arm before the next."""
    steered: list[Piece] = [(name, "", None) for name in settings.controllers]
    return steered + [(*arm, seed) for seed in settings.seeds for arm in settings.arms]


def work(
    settings: Settings, folder: Path, jobs: int = 1, backend: str = "loky"
) -> Iterator[tuple[Piece, dict[str, Any]]]:
    """Train and evaluate all that is not done yet, and yield each piece as it comes.

    An interrupted study goes on in the folder's ``runs/``. The results do not depend on ``jobs``
    and ``backend``, see :func:`twin.parallel.results_of`. Yielded with a piece are ``rows`` (see
    :func:`~twin.agents.evaluation.evaluate`), and the learning ``curve``; of a controller, its
    ``level`` on the episodes of the learning curves.
    """
    todo = pieces(settings)
    calls = [functools.partial(_work_one, settings, folder, piece) for piece in todo]
    for i, made in results_of(calls, jobs=jobs, backend=backend):
        yield todo[i], made


def _work_one(settings: Settings, folder: Path, piece: Piece) -> dict[str, Any]:
    first, observation, seed = piece
    named = first if seed is None else f"{first}-{observation}-{seed}"
    place = folder / "runs" / named
    plan = settings.plan("ppo" if seed is None else first, observation or "raw", seed or 0)
    made: dict[str, Any] = {}
    agent: Agent
    if seed is None:
        agent = controllers()[first]()
    else:
        hyper = settings.hyper.get(first)
        run = train(plan, place, hyper=hyper, curve_seeds=settings.curve_seeds)
        agent, made["curve"] = run.policy, run.curve
    asked = {
        **{"version": __version__, "sources": sources_digest(), "environment": plan.environment},
        **{"seas": settings.seas, "outages": settings.outages},
        "seeds": settings.evaluation_seeds,
    }
    if seed is None:
        asked["curve_seeds"] = settings.curve_seeds
    path = place / "evaluation.json"
    before: dict[str, Any] | None = kept(path, asked)
    if before is not None:
        return before
    grid = {"seas": settings.seas, "outages": settings.outages}
    fixed = {key: value for key, value in plan.environment.items() if key not in ("sea", "faults")}
    seeds = settings.evaluation_seeds
    made["rows"] = [row for call in on_grid(agent, seeds=seeds, **grid, **fixed) for row in call()]
    if seed is None:
        rows = evaluate(agent, seeds=settings.curve_seeds, **plan.environment)
        made["level"] = float(np.mean([row["off_path_m"] for row in rows]))
    keep(path, asked, made)
    return made


def iqm(values: Array) -> Array:
    """Return the interquartile means of the last axis, of what is no NaN.

    A quarter of the values is cut off at each end, as ``scipy.stats.trim_mean(values, 0.25)`` does.
    """
    ordered = np.sort(values, axis=-1)  # NaN comes last
    count = np.isfinite(ordered).sum(axis=-1, keepdims=True)
    cut = count // 4
    place = np.arange(ordered.shape[-1])
    kept = (place >= cut) & (place < count - cut)
    total = np.where(kept, ordered, 0.0).sum(axis=-1)
    return np.where(count[..., 0] > 0, total / np.maximum(kept.sum(axis=-1), 1), np.nan)


def replicates(scores: Sequence[Array], seed: int = 0) -> list[Array]:
    """Return interquartile means (REPLICATES,) of bootstrap samples of each agent.

    Scores are (S, R, E) each: strata (sea states), runs, episodes; R may differ. Runs are drawn for
    each agent, episodes within each stratum for all agents at once, as they met the same ones.
    """
    rng = np.random.default_rng(seed)
    strata, episodes = scores[0].shape[::2]
    chosen = rng.integers(episodes, size=(REPLICATES, strata, 1, episodes))
    stratum = np.arange(strata)[:, None, None]
    found = []
    for values in scores:
        runs = rng.integers(values.shape[1], size=(REPLICATES, 1, values.shape[1], 1))
        found.append(iqm(values[stratum, runs, chosen].reshape(REPLICATES, -1)))
    return found


def interval(sample: Array) -> tuple[float | None, float | None]:
    """Return the bounds of the 95 % interval of a bootstrap sample."""
    tail = (100.0 - LEVEL) / 2.0
    if not np.isfinite(sample).all():
        return None, None
    low, high = np.percentile(sample, [tail, 100.0 - tail])
    return float(low), float(high)


def collect(
    settings: Settings, done: Mapping[Piece, Mapping[str, Any]], command: str
) -> dict[str, Any]:
    """Return all that the study found, from what :func:`work` yielded, ready for JSON."""
    order = [piece for piece in pieces(settings) if piece in done]
    scores = _Scores(settings, {piece: done[piece]["rows"] for piece in order})
    given = {key: value for key, value in dataclasses.asdict(settings).items() if key != "hyper"}
    algos = dict.fromkeys(arm[0] for arm in settings.arms)
    hyper = {algo: settings.hyper.get(algo) or hyperparameters(algo) for algo in algos}
    return {
        "command": command,
        "version": __version__,
        "settings": given,
        "hyper": hyper,
        "cells": scores.cells(),
        "gaps": scores.gaps(),
        "helps": scores.helps(),
        "curves": [
            {"agent": _name(piece), "seed": piece[2], **_columns(done[piece]["curve"])}
            for piece in order
            if piece[2] is not None
        ],
        "levels": {_name(piece): done[piece]["level"] for piece in order if piece[2] is None},
        "episodes": scores.episodes(),
        "forecasts": scores.forecasts(),
    }


def _name(piece: Piece) -> str:
    return piece[0] if piece[2] is None else f"{piece[0]}-{piece[1]}"


def _columns(curve: Sequence[Mapping[str, float]]) -> dict[str, list[float]]:
    return {key: [row[key] for row in curve] for key in curve[0]}


class _Scores:
    """The episodes of all agents as arrays."""

    def __init__(
        self, settings: Settings, rows: Mapping[Piece, Sequence[Mapping[str, Any]]]
    ) -> None:
        self.settings = settings
        self.agents = list(dict.fromkeys(map(_name, rows)))
        self.rows = rows

    def of(self, agent: str, seas: Sequence[str], faults: str, metric: str) -> Array:
        """Return the scores of an agent, shape (seas, runs, episodes)."""
        runs = [rows for piece, rows in self.rows.items() if _name(piece) == agent]
        picked = [
            [
                [row.get(metric) for row in rows if row["sea"] == sea and row["faults"] == faults]
                for rows in runs
            ]
            for sea in seas
        ]
        return np.array(picked, dtype=np.float64)

    def cells(self) -> list[dict[str, Any]]:
        """Return the interquartile means of each agent, sea state (and all) and outage."""
        seas = self.settings.seas
        found = []
        for metric in METRICS:
            for agent in self.agents:
                for some in ([*seas], *([sea] for sea in seas))[: None if len(seas) > 1 else 1]:
                    for faults in self.settings.outages:
                        values = self.of(agent, some, faults, metric)
                        if not np.isfinite(values).any():
                            continue
                        low, high = interval(replicates([values])[0])
                        failed = self.of(agent, some, faults, "failed").mean()
                        found.append(
                            {
                                **{"metric": metric, "agent": agent},
                                **{"sea": "all" if len(some) > 1 else some[0], "faults": faults},
                                **{"iqm": float(iqm(values.ravel())), "low": low, "high": high},
                                **{"runs": values.shape[1], "failed": float(failed)},
                            }
                        )
        return found

    def gaps(self) -> list[dict[str, Any]]:
        """Return which part of the gap from raw to oracle each agent closes, for each outage."""
        found = []
        for agent in self.agents:
            algo, observation = agent.partition("-")[::2]
            against = "ppo" if algo == "recurrent_ppo" else algo
            raw, oracle = f"{against}-raw", f"{against}-oracle"
            if agent in (raw, oracle) or not {raw, oracle} <= set(self.agents) or not observation:
                continue
            for metric in METRICS:
                for faults in self.settings.outages:
                    trio = [
                        self.of(name, self.settings.seas, faults, metric)
                        for name in (raw, agent, oracle)
                    ]
                    if not np.isfinite(trio[0]).any():
                        continue
                    worst, its, best = (float(iqm(values.ravel())) for values in trio)
                    drawn = replicates(trio)
                    gap = interval(drawn[0] - drawn[2])
                    # no share where the gap is not significant, or where the oracle is no better
                    # than raw
                    sign = -1.0 if metric == "return" else 1.0
                    real = all(bound is not None and sign * bound > 0.0 for bound in gap)
                    low, high = (
                        interval((drawn[0] - drawn[1]) / (drawn[0] - drawn[2]))
                        if real
                        else (None, None)
                    )
                    found.append(
                        {
                            **{"agent": agent, "against": against, "metric": metric},
                            **{"faults": faults, "raw": worst, "its": its, "oracle": best},
                            "closed": (worst - its) / (worst - best) if real else None,
                            **{"low": low, "high": high},
                        }
                    )
        return found

    def helps(self) -> list[dict[str, Any]]:
        """Return how much a twin reduces each algorithm's distance from the path."""
        found = []
        for algo in dict.fromkeys(arm[0] for arm in self.settings.arms):
            names = f"{algo}-raw", f"{algo}-twin"
            if not set(names) <= set(self.agents):
                continue
            for sea in self.settings.seas:
                for faults in self.settings.outages:
                    raw, twin = (self.of(name, [sea], faults, "off_path_m") for name in names)
                    drawn = replicates([raw, twin])
                    low, high = interval(drawn[0] - drawn[1])
                    less = float(iqm(raw.ravel()) - iqm(twin.ravel()))
                    verdict = "no difference shown"
                    if low is not None and high is not None and low * high > 0.0:
                        verdict = "helps" if less > 0.0 else "harms"
                    found.append(
                        {
                            **{"algo": algo, "sea": sea, "faults": faults, "less_m": less},
                            **{"low": low, "high": high, "verdict": verdict},
                        }
                    )
        return found

    def forecasts(self) -> list[dict[str, Any]]:
        """Return the scores of the twin's forecasts on each agent's episodes, over all of them."""
        found = []
        for agent in self.agents:
            for faults in self.settings.outages:
                own = [
                    row["twin_forecast"]
                    for piece, rows in self.rows.items()
                    for row in rows
                    if _name(piece) == agent and row["faults"] == faults
                ]
                scores = {name: _short(value) for name, value in mean_scores(own).items()}
                found.append({"agent": agent, "faults": faults, "episodes": len(own), **scores})
        return found

    def episodes(self) -> list[dict[str, Any]]:
        """Return the scores of all episodes, a row for each run, sea state and outage."""
        found = []
        for piece, rows in self.rows.items():
            for sea in self.settings.seas:
                for faults in self.settings.outages:
                    own = [row for row in rows if (row["sea"], row["faults"]) == (sea, faults)]
                    found.append(
                        {
                            **{"agent": _name(piece), "seed": piece[2]},
                            **{"sea": sea, "faults": faults},
                            **{name: [_short(row.get(name)) for row in own] for name in METRICS},
                            "failed": [int(row["failed"]) for row in own],
                        }
                    )
        return found


def _short(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.5g}")


def check(settings: Settings) -> None:
    """Raise AgentError for no seeds or an unknown controller, before hours are spent on it."""
    if not (settings.seeds and settings.evaluation_seeds):
        raise AgentError("a study needs a seed to train and a seed to evaluate on")
    known = controllers() if settings.controllers else {}
    for name in settings.controllers:
        if name not in known:
            raise AgentError(f"no controller is called {name!r}; known: {', '.join(known)}")
    for algo, observation in settings.arms:
        settings.plan(algo, observation, 0)
