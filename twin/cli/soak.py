"""``usv-twin soak``: long runs that look for what breaks."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import Progress

from twin.cli.common import (
    console,
    new_table,
    note,
    parse_predictors,
    progress_bar,
    stopped,
    three_digits,
    write_json,
)


def soak_command(
    steps: Annotated[int, typer.Option(min=1, help="Steps of boats in all.")] = 1_000_000,
    rows: Annotated[int, typer.Option(min=1, help="Rows of garbage for each predictor.")] = 10_000,
    hours: Annotated[float, typer.Option(min=0.0, help="Hours of a simulated feed.")] = 1.0,
    predictors: Annotated[
        str, typer.Option(help="Predictors that get garbage, separated by commas.")
    ] = "persistence,persistence-8s,ukf,dsw-ukf,dsw-ukf-plus,var,fleet-lstm,transformer",
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything.")] = 0,
    json: Annotated[Path | None, typer.Option(help="Write the results to this file.")] = None,
) -> None:
    """Step boats in every sea, feed garbage to every predictor, and run a live feed for hours.

    Exit code 1 if anything crashed, was not finite, or had no positive definite covariance.
    """
    from twin.benchmark.soak import soak_environments, soak_predictor
    from twin.live.soak import soak_feed

    found: dict[str, list[dict[str, Any]]] = {"environments": [], "garbage": [], "feed": []}
    names = parse_predictors(predictors)
    try:
        with progress_bar() as bar:
            counting = functools.partial(_counting, bar)
            for part in soak_environments(steps, seed, counting("steps of boats", steps)):
                found["environments"].append(part._asdict())
            for name in names:
                result = soak_predictor(name, rows, seed, counting(f"garbage for {name}", rows))
                found["garbage"].append(result._asdict())
            if hours:
                feed = soak_feed(hours, seed, counting("hours of a feed", hours))
                found["feed"].append(feed._asdict())
    except KeyboardInterrupt:
        _show(found, json)
        raise stopped("the tables hold what was finished") from None
    if not _show(found, json):
        raise typer.Exit(1)


def _counting(bar: Progress, text: str, total: float) -> Callable[[float], None]:
    """Return what is called with the amount that is done."""
    task = bar.add_task(text, total=total)

    def count(done: float) -> None:
        bar.update(task, completed=done)

    return count


def _show(found: dict[str, list[dict[str, Any]]], json: Path | None) -> bool:
    """Print tables and write the file; return whether nothing broke."""
    kinds = found["environments"]
    if kinds:
        total = {
            key: sum(kind[key] for kind in kinds) for key in ("steps", "crashes", "not_finite")
        }
        growth = max(kind["growth"] for kind in kinds)
        console.print(
            f"{len(kinds)} kinds of environments: {total['steps']:,} steps, {total['crashes']} "
            f"crashes, {total['not_finite']} not finite, memory at most +{growth:.0f} MB",
            highlight=False,
        )
    heads = [
        *("predictor", "refused", "crashes", "not finite", "not definite"),
        *("slowest", "mean", "normal after s", "MB"),
    ]
    if found["garbage"]:
        rows = found["garbage"][0]["rows"]
        table = new_table(
            f"{rows:,} rows of garbage; times over those of clean rows", *heads, left=("predictor",)
        )
        for one in found["garbage"]:
            after = "never" if math.isinf(one["normal_after"]) else f"{one['normal_after']:.0f}"
            counts = [str(one[key]) for key in tuple(one)[2:6]]
            times = [three_digits(one[key]) for key in ("slowest", "mean")]
            table.add_row(one["predictor"], *counts, *times, after, f"{one['growth']:.0f}")
        console.print(table)
    for one in found["feed"]:
        console.print(
            f"feed of {one['hours']:g} h: {one['rows']:,} rows of {one['datagrams']:,} datagrams, "
            f"{one['crashes']} crashes, {one['not_finite']} not finite, {one['not_definite']} not "
            f"definite, error {one['error']:.2g} m, {one['pace']:.0f} times the pace, memory "
            f"+{one['growth']:.0f} MB",
            highlight=False,
        )
    if json is not None:
        write_json(json, _finite(found))
        note(f"{json}")
    broken = ("crashes", "not_finite", "not_definite")
    return not any(one.get(key) for part in found.values() for one in part for key in broken)


def _finite(found: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
    """Return results with None for what is infinite."""
    return {
        name: [
            {
                k: None if isinstance(v, float) and not math.isfinite(v) else v
                for k, v in one.items()
            }
            for one in part
        ]
        for name, part in found.items()
    }
