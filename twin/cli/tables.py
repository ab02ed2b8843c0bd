"""Tables that the commands print."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin.agents.evaluation import mean_scores
from twin.agents.training import Plan, Run
from twin.cli.common import console, new_table

__all__ = ["print_episodes", "print_forecasts", "print_trainings"]

EPISODES_MIN = 3
"""Fewer episodes have no interval."""

REPLICATES = 2000
"""Bootstrap samples behind an interval."""

PLACES = {"": "all", "_loss": "lost"}
"""Where forecasts are graded: with all sensors, or while some are lost."""

PLANS = {"known": "that came", "held": "held"}
"""Commands that forecasts go by."""

AHEAD_S = (1, 2, 5, 10)

Rows = Sequence[dict[str, Any]]


def print_trainings(trained: Sequence[tuple[Plan, Run]]) -> None:
    """Print what trainings of several seeds came to."""
    heads = ("seed", "return", "off the path, m", "success", "minutes", "folder")
    first = trained[0][0]
    title = f"{first.name}, {first.steps} decisions"
    table = new_table(title, *heads, left=("folder",), padding=(0, 1))
    for plan, run in sorted(trained, key=lambda pair: pair[0].seed):
        last = run.curve[-1]
        table.add_row(
            str(plan.seed),
            f"{last['return']:.0f}",
            f"{last['off_path_m']:.2f}",
            f"{last['success']:.0%}",
            f"{last['wall_s'] / 60.0:.1f}",
            str(run.folder),
        )
    console.print(table)


def print_episodes(found: Rows) -> None:
    """Print how evaluated agents did, a line for each agent, sea state and loss."""
    means = ("success", "failed", "time,\ns", "return", "forecast\nerror, m")
    heads = ("agent", "sea", "loss", "off path,\nm", *means)
    one = found[0]
    title = (
        f"task {one['task']}, {one['vessel']}, spread {one.get('vessel_spread', 0.0):g}: median "
        "distance off the path [95 % interval], and means. Where an episode neither succeeds nor "
        "fails, its time ran out"
    )
    table = new_table(title, *heads, left=heads[:3], padding=0)
    table.columns[0].no_wrap, table.columns[0].overflow = False, "fold"
    labels = short_names([row["model"] for row in found])
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for row in found:
        groups.setdefault((row["model"], row["sea"], row["faults"]), []).append(row)
    for (model, sea, loss), rows in groups.items():
        times = [row["length_s"] for row in rows if row["success"]]
        table.add_row(
            *(labels[model], sea, loss, median([row["off_path_m"] for row in rows])),
            f"{np.mean([row['success'] for row in rows]):.0%}",
            f"{np.mean([row['failed'] for row in rows]):.0%}",
            f"{np.mean(times):.0f}" if times else "-",
            f"{np.mean([row['return'] for row in rows]):.0f}",
            forecast_error(rows),
        )
    console.print(table)


def print_forecasts(found: Rows) -> None:
    """Print how good the twin's forecasts were on the episodes of each agent."""
    heads = ("agent", "sensors", "commands", "ahead", "m", "deg", "m/s", "in 90 %", "n")
    title = (
        f"forecasts of {found[0]['twin']} on the same episodes: mean errors of displacement, "
        "heading and speed, and shares of them in the 90 % intervals"
    )
    table = new_table(title, *heads, left=heads[:3])
    for model, label in short_names([row["model"] for row in found]).items():
        scores = mean_scores([row["twin_forecast"] for row in found if row["model"] == model])
        for place, sensors in PLACES.items():
            for plan, commands in PLANS.items() if scores[f"n{place}"] else ():
                for ahead in AHEAD_S:
                    stem = f"{plan}{place}_{ahead}s"
                    shares = [
                        scores.get(f"{stem}_{channel}_coverage90")
                        for channel in ("displacement", "heading", "speed")
                    ]
                    table.add_row(
                        *(label, sensors, commands, f"{ahead} s"),
                        f"{scores[f'{stem}_displacement_m']:.2f}",
                        f"{math.degrees(scores[f'{stem}_heading_rad']):.1f}",
                        f"{scores[f'{stem}_speed_mps']:.2f}",
                        " ".join("-" if one is None else f"{100 * one:.0f}" for one in shares),
                        f"{scores[f'n{place}']:.0f}",
                    )
    console.print(table)


def short_names(models: Sequence[str]) -> dict[str, str]:
    """Return short names of models: the last part of a path where that is clear."""
    short = {model: Path(model).name.removesuffix(".npz") for model in models}
    names = list(short.values())
    return {model: name if names.count(name) == 1 else model for model, name in short.items()}


def median(distances: Sequence[float]) -> str:
    """Return the median and its bootstrap interval."""
    text = f"{np.median(distances):.2f}"
    if len(distances) < EPISODES_MIN:
        return text
    samples = np.random.default_rng(0).choice(distances, (REPLICATES, len(distances)))
    low, high = np.percentile(np.median(samples, axis=1), [2.5, 97.5])
    return f"{text} [{low:.2f}, {high:.2f}]"


def forecast_error(rows: Rows) -> str:
    """Return the mean error of the displacement 5 s ahead, with and without a loss, m."""
    scores = mean_scores([row["twin_forecast"] for row in rows])
    parts = [
        (scores[f"n{place}"], scores[f"known{place}_5s_displacement_m"])
        for place in PLACES
        if scores[f"n{place}"]
    ]
    count = sum(n for n, _error in parts)
    return f"{sum(n * error for n, error in parts) / count:.2f}" if count else "-"
