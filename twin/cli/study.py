"""``usv-twin study``: what an agent gains from the twin when the GPS is lost."""

from __future__ import annotations

import dataclasses
import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import TimeElapsedColumn

from twin.agents import study, study_report
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
from usv_gym.envs.tasks import TASKS


def study_command(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the study.")] = Path(
        "gps_loss_study"
    ),
    steps: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Decisions of each training. Default: n_timesteps of the hyperparameters.",
        ),
    ] = None,
    seeds: Annotated[str, typer.Option(help="Trainings of each arm.")] = "0-4",
    twin: Annotated[str, typer.Option(help="Twin of the observation.")] = "ukf",
    task: Annotated[str, typer.Option(help=f"One of: {', '.join(TASKS)}.")] = "path",
    arms: Annotated[
        str | None,
        typer.Option(help="Comma-separated, as ppo-twin or recurrent_ppo-raw. [the study's nine]"),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Only check that everything runs, in minutes.")
    ] = False,
    jobs: JobsOption = CPUS,
    backend: BackendOption = "loky",
) -> None:
    """Measure what an agent gains from the twin when the GPS is lost.

    Trains PPO and SAC on the sensors, on stacked sensors, on the twin and on the truth, and
    recurrent PPO on the sensors. Evaluates them and the classical controllers in three sea states
    with losses of GPS of 0, 10, 30 and 60 s. Writes results.json, tables.md, pictures, and the
    median policy of each arm. Ctrl-C keeps what is finished; the same command continues from there.
    """
    settings = study.Settings(
        steps=steps,
        seeds=parse_seeds(seeds),
        controllers=tuple(study.controllers()),
        options={"twin": twin, "task": task},
    )
    if quick:
        settings = study.quick(settings)
    if arms is not None:
        pairs = [item.partition("-") for item in parse_list(arms, "--arms")]
        settings = dataclasses.replace(settings, arms=tuple((one[0], one[2]) for one in pairs))
    study.check(settings)
    check_backend(backend)
    done: dict[study.Piece, dict[str, Any]] = {}
    try:
        with progress_bar(TimeElapsedColumn()) as progress:
            bar = progress.add_task("study", total=len(study.pieces(settings)))
            for piece, made in study.work(settings, out, jobs, backend):
                done[piece] = made
                progress.advance(bar)
    except KeyboardInterrupt:
        raise stopped(KEPT.format(out)) from None
    command = shlex.join(["usv-twin", *sys.argv[1:]])
    results = study.collect(settings, done, command)
    study_report.write(results, settings, done, out)
    if quick:
        console.print("everything runs; results of so small a study mean nothing")
    for line in () if quick else filter(None, study_report.verdicts(results)):
        console.print(line, highlight=False, soft_wrap=True)
    console.print(f"{out / 'results.json'}, {out / 'tables.md'}, and pictures beside them")
