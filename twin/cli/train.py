"""``usv-twin train``: train agents with Stable-Baselines3."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

from twin.agents.evaluation import OUTAGES, SEAS
from twin.agents.hyperparameters import ALGORITHMS, hyperparameters
from twin.agents.training import EVERY, Plan, train_all
from twin.cli.common import (
    AnyCurrentOption,
    AnyWindOption,
    JobsOption,
    OptionError,
    console,
    parse_list,
    parse_seeds,
    parse_world,
    stopped,
)
from twin.cli.tables import print_trainings
from twin.predictors.registry import predictor_class
from twin.sim.wrapper import OBSERVATIONS
from usv_gym.envs.tasks import TASKS

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
            help=f"What the agent sees, one of: {', '.join(OBSERVATIONS)}; or entries of it, "
            "comma-separated. Default: that of the hyperparameters."
        ),
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
    curve.csv (the learning curve, on fixed episodes), log/ (what Stable-Baselines3 logs: CSV, and
    for tensorboard --logdir <out> if that is installed), run.json (all settings). After Ctrl-C or a
    crash the same command continues from the last checkpoint, and reaches the same policy as
    without the stop.
    """
    values = hyperparameters(algo, hyper)
    steps = steps or values["n_timesteps"]
    predictor_class(twin)
    seen = parse_list(obs, "--obs") if obs is not None and "," in obs else obs
    first = Plan(
        algo,
        seen or values.get("observation", "twin"),
        steps,
        task=task,
        sea=sea,
        faults=faults,
        twin=twin,
        vessel=vessel,
        vessel_spread=vessel_spread,
        world=parse_world(wind_from, current),
        reward_weights=parse_weights(reward_weight or []),
        every=min(EVERY, -(-steps // BREAKS)),
    )
    plans = [dataclasses.replace(first, seed=seed) for seed in parse_seeds(seeds)]
    how = {"hyper": values, "num_threads": num_threads}
    trained = []
    try:
        for plan, run in train_all(
            plans, out, jobs=jobs, progress=jobs == 1 and console.is_terminal, **how
        ):
            trained.append((plan, run))
            console.print(f"{run.folder}: trained", highlight=False)
    except KeyboardInterrupt:
        raise stopped(
            f"everything up to the last checkpoints is kept in {out}; the same command continues "
            "from there"
        ) from None
    print_trainings(trained)
    console.print(f"next: usv-twin evaluate {out}", highlight=False, soft_wrap=True)


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
