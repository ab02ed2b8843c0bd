"""The commands train, evaluate and study of ``usv-twin``."""

from __future__ import annotations

import dataclasses
import importlib
import json
import os
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.box import SIMPLE_HEAD
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from twin.agents import study
from twin.agents.agent import Agent
from twin.agents.evaluation import EVALUATION_SEEDS, OUTAGES, SEAS, on_grid
from twin.agents.policy import AgentError, Policy, write_whole
from twin.agents.training import ALGORITHMS, Plan, Run, hyperparameters, train
from twin.cli.common import INTERRUPTED, console, errors, listed, seeds_of
from twin.parallel import BACKENDS, check_backend, results_of
from twin.sim.wrapper import OBSERVATIONS
from usv_gym.envs.tasks import TASKS

__all__ = [
    "COMMANDS",
]

JobsOption = Annotated[int, typer.Option(min=1, help="Workers; results do not depend on it.")]

BackendOption = Annotated[
    str, typer.Option(help=f"Kind of workers, one of: {', '.join(BACKENDS)}.")
]

CPUS = os.cpu_count() or 1

EVALUATED_ON = f"{EVALUATION_SEEDS[0]}-{EVALUATION_SEEDS[-1]}"


def train_command(
    algo: Annotated[str, typer.Option(help=f"One of: {', '.join(ALGORITHMS)}.")] = "ppo",
    obs: Annotated[
        str, typer.Option(help=f"What the agent sees, one of: {', '.join(OBSERVATIONS)}.")
    ] = "twin",
    steps: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Decisions (half a second each) of all boats together. Left out: n_timesteps "
            "of the hyperparameters.",
        ),
    ] = None,
    seeds: Annotated[
        str, typer.Option(help="A-B (or A:B for A to B - 1), or a list as 0,4,7: a run for each.")
    ] = "0",
    task: Annotated[str, typer.Option(help=f"One of: {', '.join(TASKS)}.")] = "path",
    sea: Annotated[
        str, typer.Option(help="Sea states, one of them drawn for each episode.")
    ] = "|".join(SEAS),
    faults: Annotated[
        str, typer.Option(help="Losses of sensors, one of them drawn for each episode.")
    ] = "|".join(OUTAGES),
    twin: Annotated[str, typer.Option(help="Which twin, for what sees one.")] = "ukf",
    vessel: Annotated[str, typer.Option(help="Name or TOML file.")] = "usv75",
    hyper: Annotated[
        Path | None,
        typer.Option(help="TOML file of hyperparameters. Left out: twin/agents/hyper/<algo>.toml."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of runs.")] = Path("runs"),
    jobs: JobsOption = 1,
) -> None:
    """Train agents with Stable-Baselines3.

    Each seed is a folder <out>/<algo>-<obs>-<seed>: policy.npz (what usv-twin evaluate takes),
    curve.csv (the learning curve, on fixed episodes), tensorboard/ (tensorboard --logdir <out>),
    run.json (all settings). After Ctrl-C or a crash the same command goes on from the last
    checkpoint, and comes to the same policy as if it had never stopped.
    """
    options: dict[str, Any] = {
        "task": task,
        "sea": sea,
        "faults": faults,
        "twin": twin,
        "vessel": vessel,
    }
    values = hyperparameters(algo, hyper)
    if steps is None:
        steps = values["n_timesteps"]
    plans = [Plan(algo, obs, steps, seed, **options) for seed in seeds_of(seeds)]
    table = Table(title=f"{plans[0].name}, {steps} decisions", box=SIMPLE_HEAD)
    for head in ("seed", "return", "off the path, m", "success", "minutes", "folder"):
        table.add_column(head, justify="left" if head == "folder" else "right")
    try:
        for plan, run in _trained(plans, values, out, jobs):
            last = run.curve[-1]
            table.add_row(
                *(str(plan.seed), f"{last['return']:.0f}", f"{last['off_path_m']:.2f}"),
                *(f"{last['success']:.0%}", f"{last['wall_s'] / 60.0:.1f}", str(run.folder)),
            )
    except KeyboardInterrupt:
        _stopped(out)
    console.print(table)
    console.print(
        f"look at them with: usv-twin evaluate {out} (and tensorboard --logdir {out})",
        highlight=False,
        soft_wrap=True,
    )


def _trained(
    plans: list[Plan], hyper: dict[str, Any], out: Path, jobs: int
) -> Iterator[tuple[Plan, Run]]:
    """Train all plans: one after the other with a bar each, or several at once."""
    from joblib import Parallel, delayed

    folders = [out / f"{plan.name}-{plan.seed}" for plan in plans]
    if jobs == 1 or len(plans) == 1:
        for plan, folder in zip(plans, folders, strict=True):
            console.print(f"{folder}: {plan.steps} decisions", highlight=False)
            yield plan, train(plan, folder, hyper=hyper, progress=console.is_terminal)
        return
    pool = Parallel(n_jobs=jobs, return_as="generator")
    with _bar() as progress:
        bar = progress.add_task("runs", total=len(plans))
        tasks = (
            delayed(train)(plan, folder, hyper=hyper)
            for plan, folder in zip(plans, folders, strict=True)
        )
        for plan, run in zip(plans, pool(tasks), strict=True):
            progress.advance(bar)
            yield plan, run


def _bar() -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        *(BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()),
        console=console,
    )


def _stopped(out: Path) -> None:
    errors.print(
        f"stopped: all up to the last checkpoints is kept in {out}; the same command goes on "
        "from there",
        style="yellow",
        soft_wrap=True,
    )
    raise typer.Exit(INTERRUPTED) from None


def evaluate_command(
    models: Annotated[
        list[str],
        typer.Argument(
            help="A run's folder, a folder of runs, a policy (.npz), the name of a classical "
            "controller, or module:Class of an agent of your own.",
            metavar="MODEL",
        ),
    ],
    sea: Annotated[
        str, typer.Option(help="Comma-separated; 0|2 draws one for each episode.")
    ] = ",".join(SEAS),
    faults: Annotated[
        str, typer.Option(help="Comma-separated; gps30@40 begins at 40 s.")
    ] = ",".join(OUTAGES),
    seeds: Annotated[
        str, typer.Option(help="An episode for each: A-B, A:B, or a list as 0,4,7.")
    ] = EVALUATED_ON,
    task: Annotated[
        str | None, typer.Option(help=f"One of: {', '.join(TASKS)}. Left out: the trained one.")
    ] = None,
    twin: Annotated[
        str | None, typer.Option(help="Left out: the one that it was trained with, or ukf.")
    ] = None,
    vessel: Annotated[
        str | None, typer.Option(help="Left out: the one that it was trained with, or usv75.")
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Every episode, in full precision.")
    ] = None,
    jobs: JobsOption = 1,
    backend: BackendOption = "loky",
) -> None:
    """Let agents sail the same episodes, in each sea state with each loss of GPS.

    The distance off the path is the mean over an episode, in which the time after a failure (50 m
    off, or capsized) counts as 50 m.
    """
    seas, outages = listed(sea, "--sea"), listed(faults, "--faults")
    chosen = {"task": task, "twin": twin, "vessel": vessel}
    given = {key: value for key, value in chosen.items() if value is not None}
    agents = [agent for model in models for agent in _agents(model)]
    same = _trained_with([agent for _, agent in agents], given)
    table = Table(
        title=f"task {same['task']}: distance off the path, m; median [95 % interval], share of "
        "failures",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    for head in ("agent", "sea", *outages):
        table.add_column(head, no_wrap=head == "sea")
    where: dict[str, Any] = {"seeds": seeds_of(seeds), "seas": seas, "outages": outages}
    calls = [(model, call) for model, agent in agents for call in on_grid(agent, **where, **same)]
    made: dict[int, list[dict[str, Any]]] = {}
    with _bar() as progress:
        bar = progress.add_task("evaluating", total=len(calls))
        for i, rows in results_of([call for _, call in calls], jobs=jobs, backend=backend):
            made[i] = rows
            progress.advance(bar)
    found = [{"model": calls[i][0], **same, **row} for i in sorted(made) for row in made[i]]
    for model, agent in agents:
        for state in seas:
            own = [
                [row for row in found if (row["model"], row["sea"], row["faults"]) == key]
                for key in ((model, state, loss) for loss in outages)
            ]
            table.add_row(agent.name if model == agent.name else model, state, *map(_median, own))
    console.print(table)
    if json_file is not None:
        write_whole(json_file, (json.dumps(found, indent=1) + "\n").encode())
        console.print(f"every episode: {json_file}")


def _agents(model: str) -> list[tuple[str, Agent]]:
    """Return the agents that a name stands for, and what each is called."""
    path = Path(model)
    if path.is_dir():
        if (path / "run.json").exists():
            return [(model, Run.of(path).policy)]
        files = sorted(path.glob("*/policy.npz")) or sorted(path.glob("*.npz"))
        if not files:
            raise AgentError(f"{path}: holds no run that has ended; usv-twin train makes them")
        return [
            (str(file.parent if file.name == "policy.npz" else file), Policy.load(file))
            for file in files
        ]
    if path.suffix == ".npz":
        return [(model, Policy.load(path))]
    module, colon, name = model.partition(":")
    if colon:
        try:
            return [(model, getattr(importlib.import_module(module), name)())]
        except (ImportError, AttributeError) as error:
            raise AgentError(f"{model}: {error}; write module:Class") from None
    known = study.controllers()
    if model in known:
        return [(model, known[model]())]
    raise AgentError(
        f"{model}: no such folder or policy, and no controller is called so; "
        f"controllers: {', '.join(known)}; agents of your own: module:Class"
    )


def _trained_with(agents: list[Agent], given: dict[str, Any]) -> dict[str, Any]:
    """Return the options of the environment that policies were trained in, and those given."""
    options = Plan("ppo", "raw", 1).environment | given
    for name in ("task", "twin", "vessel", "frame_skip", "max_episode_steps"):
        trained = {
            agent.settings[name]
            for agent in agents
            if isinstance(agent, Policy) and name in agent.settings
        }
        if name in given or not trained:
            continue
        if len(trained) > 1:
            what = ", ".join(map(str, sorted(trained)))
            raise AgentError(
                f"these were trained with {name} = {what}: evaluate them one by one"
                + (f", or name --{name}" if name in ("task", "twin", "vessel") else "")
            )
        (options[name],) = trained
    del options["sea"], options["faults"]
    return options


def _median(rows: list[dict[str, Any]]) -> str:
    """Return the median distance off the path with its interval, and how many failed."""
    off = np.array([row["off_path_m"] for row in rows])
    drawn = np.random.default_rng(0).choice(off, (study.REPLICATES, len(off)))
    low, high = study.interval(np.median(drawn, axis=1))
    failed = sum(row["failed"] for row in rows) / len(rows)
    lost = f" {failed:.0%}" if failed else ""
    return f"{np.median(off):.2f}\n[{low:.2f}, {high:.2f}]{lost}"


def study_command(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the study.")] = Path(
        "gps_loss_study"
    ),
    steps: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Decisions of each training. Left out: n_timesteps of the hyperparameters.",
        ),
    ] = None,
    seeds: Annotated[str, typer.Option(help="Trainings of each arm.")] = "0-4",
    twin: Annotated[str, typer.Option(help="Which twin.")] = "ukf",
    task: Annotated[str, typer.Option(help=f"One of: {', '.join(TASKS)}.")] = "path",
    arms: Annotated[
        str | None,
        typer.Option(help="Comma-separated, as ppo-twin or recurrent_ppo-raw. [the study's nine]"),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Only see that everything runs, in minutes.")
    ] = False,
    jobs: JobsOption = CPUS,
    backend: BackendOption = "loky",
) -> None:
    """Ask what an agent gains from the twin when the GPS is gone.

    Trains PPO and SAC on the sensors, on stacked sensors, on the twin and on the truth, and
    recurrent PPO on the sensors; evaluates them and the classical controllers in three sea states
    with losses of GPS of 0, 10, 30 and 60 s. Writes results.json, tables.md, pictures, and the
    middle policy of each arm. Ctrl-C keeps what is finished; the same command goes on from there.
    """
    settings = study.Settings(
        steps=steps,
        seeds=seeds_of(seeds),
        controllers=tuple(study.controllers()),
        options={"twin": twin, "task": task},
    )
    if quick:
        settings = study.quick(settings)
    if arms is not None:
        pairs = [item.partition("-") for item in listed(arms, "--arms")]
        settings = dataclasses.replace(settings, arms=tuple((one[0], one[2]) for one in pairs))
    study.check(settings)
    check_backend(backend)
    done: dict[study.Piece, dict[str, Any]] = {}
    try:
        with _bar() as progress:
            bar = progress.add_task("study", total=len(study.pieces(settings)))
            for piece, made in study.work(settings, out, jobs, backend):
                done[piece] = made
                progress.advance(bar)
    except KeyboardInterrupt:
        _stopped(out)
    command = shlex.join(["usv-twin", *sys.argv[1:]])
    results = study.collect(settings, done, command)
    study.write(results, settings, done, out)
    if quick:
        console.print("everything runs; what so small a study says means nothing")
    for line in () if quick else filter(None, study.verdicts(results)):
        console.print(line, highlight=False, soft_wrap=True)
    console.print(f"{out / 'results.json'}, {out / 'tables.md'}, and pictures beside them")


COMMANDS: dict[str, Callable[..., None]] = {
    "train": train_command,
    "evaluate": evaluate_command,
    "study": study_command,
}
"""Commands by name."""
