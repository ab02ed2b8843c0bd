"""``usv-twin study``: agents on boats they never met, against classical control and each other."""

from __future__ import annotations

import dataclasses
import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import TimeElapsedColumn

from twin.agents.study import report, results, runs, settings
from twin.cli.common import (
    CPUS,
    BackendOption,
    JobsOption,
    console,
    parse_list,
    parse_seeds,
    progress_bar,
    stopped,
)
from twin.cli.train import KEPT
from twin.parallel import check_backend


def study_command(
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder of the study. [agent_study/TASK]")
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Decisions of each training. Default: n_timesteps of the hyperparameters.",
        ),
    ] = None,
    seeds: Annotated[str, typer.Option(help="Trainings of each arm.")] = "0-7",
    twin: Annotated[str, typer.Option(help="Twin of the observation.")] = "ukf",
    task: Annotated[str, typer.Option(help=f"One of: {', '.join(settings.STUDIES)}.")] = "path",
    arms: Annotated[
        str | None,
        typer.Option(
            help="Comma-separated, as ppo-compact or ppo-residual-compact. [those of the study]"
        ),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Only check that everything runs, in minutes.")
    ] = False,
    jobs: JobsOption = CPUS,
    backend: BackendOption = "loky",
) -> None:
    """Compare trained agents with classical control, on boats that differ.

    Agents see the sensors, the twin, with it what it identified, or the truth. They are trained on
    boats that differ by 30 %, in any wind and current, and evaluated beside the controllers, with
    losses of GPS of 0, 10, 30 and 60 s; two conditions are held out. Writes results.json,
    tables.md, pictures, and the middle policy of each arm. Ctrl-C keeps what is finished; the same
    command continues from there. Arms may be done in parts, into the same folder: the command with
    all of them then takes what is there.
    """
    asked = settings.Settings(steps=steps, seeds=parse_seeds(seeds), twin=twin, task=task)
    if quick:
        asked = settings.quick(asked)
    if arms is not None:
        named = tuple(settings.arm_named(item) for item in parse_list(arms, "--arms"))
        asked = dataclasses.replace(asked, arms=named)
    settings.check(asked)
    check_backend(backend)
    out = Path("agent_study") / task if out is None else out
    done: dict[settings.Piece, dict[str, Any]] = {}
    try:
        with progress_bar(TimeElapsedColumn()) as progress:
            bar = progress.add_task("study", total=len(settings.pieces(asked)))
            for piece, made in runs.work(asked, out, jobs, backend):
                done[piece] = made
                progress.advance(bar)
    except KeyboardInterrupt:
        raise stopped(KEPT.format(out)) from None
    command = shlex.join(["usv-twin", *sys.argv[1:]])
    found = results.collect(asked, done, command)
    report.write(found, asked, done, out)
    if quick:
        console.print("everything runs; results of so small a study mean nothing")
    for line in () if quick else report.sentences(found):
        console.print(line, highlight=False, soft_wrap=True)
    console.print(f"{out / 'results.json'}, {out / 'tables.md'}, and pictures beside them")
