"""``usv-twin train``: train agents with Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import TimeElapsedColumn

from twin.agents.evaluation import OUTAGES, SEAS
from twin.agents.hyperparameters import ALGORITHMS, hyperparameters
from twin.agents.training import EVERY, Plan, Run, train
from twin.cli.common import (
    AnyCurrentOption,
    AnyWindOption,
    JobsOption,
    OptionError,
    console,
    new_table,
    parse_list,
    parse_seeds,
    parse_world,
    progress_bar,
    stopped,
)
from twin.sim.oracle import check_options_of
from twin.sim.wrapper import OBSERVATIONS
from usv_gym.envs.tasks import TASKS

KEPT = "everything up to the last checkpoints is kept in {}; the same command continues from there"
"""Printed after Ctrl-C."""


UPDATES_MIN = 8
"""Trainings with fewer updates are warned of."""

BREAKS = 6
"""A short training is evaluated so often, at least."""


def train_command(
    algo: Annotated[
        str,
        typer.Option(
            help=f"One of: {', '.join(ALGORITHMS)}. ppo-residual corrects los-twin and ppo-mpc "
            "mpc-steady; they begin at its level."
        ),
    ] = "ppo",
    obs: Annotated[
        str | None,
        typer.Option(
            help=f"What the agent sees, one of: {', '.join(OBSERVATIONS)}. Default: that of the "
            "hyperparameters."
        ),
    ] = None,
    entries: Annotated[
        str | None,
        typer.Option(help="Entries of the observation that it sees instead, comma-separated."),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Decisions (half a second each) of all boats together. Default: n_timesteps "
            "of the hyperparameters.",
        ),
    ] = None,
    seeds: Annotated[
        str, typer.Option(help="A-B (or A:B for A to B - 1), or a list as 0,4,7: a run for each.")
    ] = "0",
    task: Annotated[
        str, typer.Option(help=f"One of: {', '.join(TASKS)}; or module:Class of your own.")
    ] = "path",
    sea: Annotated[
        str, typer.Option(help="Sea states parted by |, one of them drawn for each episode.")
    ] = "|".join(SEAS),
    faults: Annotated[
        str, typer.Option(help="Losses of sensors parted by |, one drawn for each episode.")
    ] = "|".join(OUTAGES),
    twin: Annotated[str, typer.Option(help="Twin of the observation, if it has one.")] = "ukf",
    vessel: Annotated[str, typer.Option(help="Name or TOML file.")] = "usv75",
    vessel_spread: Annotated[
        float, typer.Option(help="Spread of the boats, one of them drawn for each episode.")
    ] = 0.0,
    wind_from: AnyWindOption = None,
    current: AnyCurrentOption = None,
    reward_weight: Annotated[
        list[str] | None,
        typer.Option(help="Weight of a term of the reward: cross_track=3; may be repeated."),
    ] = None,
    init: Annotated[
        Path | None,
        typer.Option(help="Start from the weights of this policy (.npz, or a run's folder)."),
    ] = None,
    callback: Annotated[
        str,
        typer.Option(
            help="module:function that Stable-Baselines3 calls in each step with its local and "
            "global variables; False ends the training. Or module:Class of a BaseCallback."
        ),
    ] = "",
    num_threads: Annotated[
        int, typer.Option(min=1, help="Threads that share the boats; they change no result.")
    ] = 1,
    hyper: Annotated[
        Path | None,
        typer.Option(help="TOML file of hyperparameters. Default: twin/agents/hyper/<algo>.toml."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of runs.")] = Path("runs"),
    jobs: JobsOption = 1,
) -> None:
    """Train agents with Stable-Baselines3.

    Each seed is a folder <out>/<algo>-<obs>-<seed>: policy.npz (for usv-twin evaluate),
    curve.csv (the learning curve, on fixed episodes), tensorboard/ (tensorboard --logdir <out>),
    run.json (all settings). After Ctrl-C or a crash the same command continues from the last
    checkpoint, and reaches the same policy as without the stop.
    """
    options: dict[str, Any] = {
        "task": task,
        "sea": sea,
        "faults": faults,
        "twin": twin,
        "vessel": vessel,
        "vessel_spread": vessel_spread,
        "world": parse_world(wind_from, current),
        "reward_weights": parse_weights(reward_weight or []),
        "init": "" if init is None else str(init),
    }
    values = hyperparameters(algo, hyper)
    if steps is None:
        steps = values["n_timesteps"]
    check_options_of(twin, vessel)
    if obs is not None and entries is not None:
        raise OptionError("--obs and --entries: give one of them")
    seen = parse_list(entries, "--entries") if entries is not None else obs
    options["every"] = min(EVERY, -(-steps // BREAKS))
    plans = [
        Plan(algo, seen or values.get("observation", "twin"), steps, seed, **options)
        for seed in parse_seeds(seeds)
    ]
    rollout = values["n_envs"] * values.get("n_steps", 0)
    if steps < UPDATES_MIN * rollout:
        console.print(
            f"note: an update comes after {rollout} decisions, and the learning rate falls to 0 at "
            f"the last: {steps} teach little, --steps {UPDATES_MIN * rollout} more",
            highlight=False,
        )
    how = {"hyper": values, "num_threads": num_threads, "callback": callback}
    heads = ("seed", "return", "off the path, m", "success", "minutes", "folder")
    title = f"{plans[0].name}, {steps} decisions"
    table = new_table(title, *heads, left=("folder",), padding=(0, 1))
    try:
        for plan, run in _trained(plans, how, out, jobs):
            last = run.curve[-1]
            table.add_row(
                str(plan.seed),
                f"{last['return']:.0f}",
                f"{last['off_path_m']:.2f}",
                f"{last['success']:.0%}",
                f"{last['wall_s'] / 60.0:.1f}",
                str(run.folder),
            )
    except KeyboardInterrupt:
        raise stopped(KEPT.format(out)) from None
    console.print(table)
    console.print(
        f"next: usv-twin evaluate {out} (and tensorboard --logdir {out})",
        highlight=False,
        soft_wrap=True,
    )


def parse_weights(texts: list[str]) -> dict[str, float]:
    """Return weights of terms of the reward from texts such as ``cross_track=3``."""
    weights = {}
    for text in texts:
        name, _equals, number = text.partition("=")
        try:
            weights[name.strip()] = float(number)
        except ValueError:
            raise OptionError(
                f"--reward-weight {text}: write the term and a number, as in cross_track=3"
            ) from None
    return weights


def _trained(
    plans: list[Plan], how: dict[str, Any], out: Path, jobs: int
) -> Iterator[tuple[Plan, Run]]:
    """Train all plans: one after the other with a bar each, or several at once."""
    from joblib import Parallel, delayed

    folders = [out / f"{plan.name}-{plan.seed}" for plan in plans]
    if jobs == 1 or len(plans) == 1:
        for plan, folder in zip(plans, folders, strict=True):
            console.print(f"{folder}: {plan.steps} decisions", highlight=False)
            yield plan, train(plan, folder, progress=console.is_terminal, **how)
        return
    pool = Parallel(n_jobs=jobs, return_as="generator")
    with progress_bar(TimeElapsedColumn()) as progress:
        bar = progress.add_task("runs", total=len(plans))
        tasks = (
            delayed(train)(plan, folder, **how) for plan, folder in zip(plans, folders, strict=True)
        )
        for plan, run in zip(plans, pool(tasks), strict=True):
            progress.advance(bar)
            yield plan, run
