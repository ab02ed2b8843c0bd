"""The runs of the study: agents are trained, and with the controllers evaluated, in any order."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from twin.agents.agent import Agent
from twin.agents.controllers import make_controller
from twin.agents.evaluation import evaluate, on_grid
from twin.agents.study.settings import Piece, Settings, name_of, pieces
from twin.agents.training import Plan, train
from twin.files import keep, kept
from twin.parallel import results_of
from usv_kernel import __version__
from usv_kernel.cache import sources_digest

__all__ = ["folder_of", "work"]

IDLE = ("twin/agents/study/", "twin/agents/hyper/", "twin/cli/", "twin/live/")
"""Sources without a part in what an episode comes to."""

METRICS = ("off_path_m", "success", "failed", "length_s", "return")


def work(
    settings: Settings, folder: Path, jobs: int = 1, backend: str = "loky"
) -> Iterator[tuple[Piece, dict[str, Any]]]:
    """Train and evaluate all that is not done yet, and yield each piece as it comes.

    An interrupted study goes on in the folder's ``runs/``, and one with other arms uses what is
    there. The results do not depend on ``jobs`` and ``backend``, see
    :func:`twin.parallel.results_of`. Yielded with a piece are ``rows``, one for an episode, and
    the learning ``curve``; of the controller whose level counts, its ``level`` on the episodes of
    the learning curves.
    """
    todo = pieces(settings)
    calls = [functools.partial(_work_one, settings, folder, piece) for piece in todo]
    for i, made in results_of(calls, jobs=jobs, backend=backend):
        yield todo[i], made


def folder_of(piece: Piece, folder: Path) -> Path:
    """Return the folder of a piece."""
    name = name_of(piece)
    return folder / "runs" / (name if piece[2] is None else f"{name}-{piece[2]}")


def _work_one(settings: Settings, folder: Path, piece: Piece) -> dict[str, Any]:
    """Return what one piece came to: kept from before, or made now."""
    first, observation, seed = piece
    place = folder_of(piece, folder)
    plan = settings.plan(first if observation else "ppo", observation or "raw", seed or 0)
    made: dict[str, Any] = {}
    agent: Agent
    if observation:
        hyper = settings.hyper.get(first)
        run = train(plan, place, hyper=hyper, curve_seeds=settings.curve_seeds)
        agent, made["curve"] = run.policy, run.curve
    else:
        agent = make_controller(first)
    asked = {
        **{"version": __version__, "sources": sources_digest(without=IDLE)},
        **{"losses": settings.losses, "environment": plan.environment, "metrics": METRICS},
        "conditions": {
            name: [one.seas, one.seeds, one.options] for name, one in settings.evaluated.items()
        },
        "curve_seeds": settings.curve_seeds,
    }
    before: dict[str, Any] | None = kept(place / "evaluation.json", asked)
    if before is not None:
        return before
    made["rows"] = _rows(agent, settings, plan)
    if first == settings.studied.level:
        rows = evaluate(
            agent, seeds=settings.curve_seeds, forecast_scores=False, **plan.environment
        )
        made["level"] = float(np.mean([row[settings.studied.metric] for row in rows]))
    keep(place / "evaluation.json", asked, made)
    return made


def _rows(agent: Agent, settings: Settings, plan: Plan) -> list[dict[str, Any]]:
    """Return a row for each episode of each condition with each loss."""
    common = {
        name: plan.environment[name] for name in ("twin", "task", "frame_skip", "max_episode_steps")
    }
    found = []
    for name, condition in settings.evaluated.items():
        calls = on_grid(
            agent, seeds=condition.seeds, seas=condition.seas, outages=settings.losses,
            forecast_scores=False, **{**common, **condition.options},
        )  # fmt: skip
        found += [
            {
                **{"condition": name, "sea": row["sea"], "faults": row["faults"]},
                **{metric: row[metric] for metric in METRICS},
            }
            for call in calls
            for row in call()
        ]
    return found
