"""``usv-twin evaluate``: let agents sail the same episodes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import TimeElapsedColumn

from twin.agents.evaluation import (
    EVALUATION_SEEDS,
    FRAME_SKIP,
    OUTAGES,
    SEAS,
    agents_named,
    on_grid,
    trained_with,
)
from twin.agents.weights import SavedPolicy
from twin.cli.common import (
    AnyCurrentOption,
    AnyWindOption,
    JobsOption,
    console,
    note,
    parse_list,
    parse_seeds,
    parse_world,
    progress_bar,
    write_json,
)
from twin.cli.tables import print_episodes
from twin.parallel import results_of
from usv_gym.envs.tasks import TASKS
from usv_gym.world.sensors import GRADES


def evaluate_command(
    models: Annotated[
        list[str],
        typer.Argument(
            help="A run's folder, a folder of runs, a policy (.npz), a model of Stable-Baselines3 "
            "(.zip), the name of a classical controller, or module:Class of an agent of your own.",
            metavar="MODEL",
        ),
    ],
    sea: Annotated[
        str, typer.Option(help="Comma-separated; 0|2 draws one of them for each episode.")
    ] = ",".join(SEAS),
    faults: Annotated[
        str, typer.Option(help="Comma-separated; gps30@40 begins at 40 s.")
    ] = ",".join(OUTAGES),
    seeds: Annotated[
        str, typer.Option(help="One episode each: A-B, A:B, or a list as 0,4,7.")
    ] = f"{EVALUATION_SEEDS[0]}-{EVALUATION_SEEDS[-1]}",
    task: Annotated[
        str | None,
        typer.Option(help=f"One of: {', '.join(TASKS)}; or module:Class. Default: trained."),
    ] = None,
    twin: Annotated[str | None, typer.Option(help="Default: that of the training, or ukf.")] = None,
    vessel: Annotated[
        str | None, typer.Option(help="Default: that of the training, or usv75.")
    ] = None,
    vessel_spread: Annotated[
        float | None,
        typer.Option(help="Spread of the boats. Default: that of the training, or 0."),
    ] = None,
    wind_from: AnyWindOption = None,
    current: AnyCurrentOption = None,
    sensors: Annotated[
        str, typer.Option(help=f"Grade of the sensors, one of: {', '.join(GRADES)}.")
    ] = "typical",
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Every episode, in full precision.")
    ] = None,
    log_dir: Annotated[
        Path | None,
        typer.Option(
            "--log-dir", help="Write each episode there as a log, for the other commands."
        ),
    ] = None,
    jobs: JobsOption = 1,
) -> None:
    """Let agents sail the same episodes, and grade the twin's forecasts on them.

    In each sea state with each loss of GPS; a twin sails with every agent, seen by it or not.

    The distance off the path is the mean over an episode. After a failure (50 m off the path, or
    capsized) the rest of the episode counts as 50 m. The time is that to a success. The forecast
    error is that of the displacement 5 s ahead, with the commands that came.
    """
    seas, outages = parse_list(sea, "--sea"), parse_list(faults, "--faults")
    chosen = {"task": task, "twin": twin, "vessel": vessel, "vessel_spread": vessel_spread}
    given = {key: value for key, value in chosen.items() if value is not None}
    given |= parse_world(wind_from, current)
    suited = given | {"suite": sensors}
    agents = [agent for model in models for agent in agents_named(model, **suited)]
    for agent in (agent for _, agent in agents if isinstance(agent, SavedPolicy)):
        note(f"{agent.note}; each action is held for {FRAME_SKIP} steps of .05 s")
    same = trained_with([pair[1] for pair in agents], given) | {"suite": sensors}
    where: dict[str, Any] = {"seeds": parse_seeds(seeds), "seas": seas, "outages": outages}
    if log_dir is not None:
        log_dir.mkdir(parents=True, exist_ok=True)
        where["log_dir"] = log_dir
    calls = [
        (model, call)
        for model, agent in agents
        for call in on_grid(agent, label=model, **where, **same)
    ]
    made: dict[int, list[dict[str, Any]]] = {}
    with progress_bar(TimeElapsedColumn()) as progress:
        bar = progress.add_task("evaluating", total=len(calls))
        for i, rows in results_of([pair[1] for pair in calls], jobs=jobs):
            made[i] = rows
            progress.advance(bar)
    found = [{"model": calls[i][0], **same, **row} for i in sorted(made) for row in made[i]]
    print_episodes(found)
    if log_dir is not None:
        console.print(f"logs of {len(found)} episodes: {log_dir}")
    if json_file is not None:
        write_json(json_file, found)
        console.print(f"every episode: {json_file}")
