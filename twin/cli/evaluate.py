"""``usv-twin evaluate``: let agents sail the same episodes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.progress import TimeElapsedColumn
from rich.table import Table

from twin.agents.agent import Agent
from twin.agents.controllers import CONTROLLERS, DOCKING
from twin.agents.evaluation import EVALUATION_SEEDS, OUTAGES, SEAS, on_grid
from twin.agents.forecast_table import forecast_rows, mean_scores
from twin.agents.policy import AgentError, Policy
from twin.agents.recording.dataset import check_dataset, write_dataset
from twin.agents.recording.video import check_video, record_video
from twin.agents.study.statistics import REPLICATES, interval
from twin.agents.training import Plan, Run
from twin.cli.common import (
    AnyCurrentOption,
    AnyWindOption,
    BackendOption,
    JobsOption,
    console,
    new_table,
    parse_list,
    parse_seeds,
    parse_world,
    progress_bar,
    write_json,
)
from twin.parallel import results_of
from usv_gym.envs.tasks import TASKS
from usv_gym.world.sensors import GRADES
from usv_kernel.files import import_named

EVALUATED_ON = f"{EVALUATION_SEEDS[0]}-{EVALUATION_SEEDS[-1]}"


INTERVAL_MIN = 3
"""Fewer episodes have no interval."""


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
        str, typer.Option(help="Comma-separated; 0|2 draws one of them for each episode.")
    ] = ",".join(SEAS),
    faults: Annotated[
        str, typer.Option(help="Comma-separated; gps30@40 begins at 40 s.")
    ] = ",".join(OUTAGES),
    seeds: Annotated[
        str, typer.Option(help="One episode each: A-B, A:B, or a list as 0,4,7.")
    ] = EVALUATED_ON,
    task: Annotated[
        str | None, typer.Option(help=f"One of: {', '.join(TASKS)}. Default: the trained one.")
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
    video: Annotated[
        Path | None,
        typer.Option(
            help="Write a video of the first episode, all agents side by side: .mp4 or .gif."
        ),
    ] = None,
    minari: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Write all episodes of an agent, with the twin's forecasts, as a Minari data set: "
            "usv/los-twin-v0.",
        ),
    ] = None,
    jobs: JobsOption = 1,
    backend: BackendOption = "loky",
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
    agents = [agent for model in models for agent in agents_named(model)]
    given |= parse_world(wind_from, current)
    same = trained_with([pair[1] for pair in agents], given) | {"suite": sensors}
    if video is not None:
        check_video(video, len(agents))
    if minari is not None:
        check_dataset(minari, len(agents))
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
        for i, rows in results_of([pair[1] for pair in calls], jobs=jobs, backend=backend):
            made[i] = rows
            progress.advance(bar)
    found = [{"model": calls[i][0], **same, **row} for i in sorted(made) for row in made[i]]
    labels = _labels([model for model, _agent in agents])
    console.print(_episodes(labels, found, same))
    console.print(_forecasts(labels, found, same["twin"]))
    if log_dir is not None:
        console.print(f"logs of {len(found)} episodes: {log_dir}")
    if video is not None:
        first = {"seed": where["seeds"][0], "sea": seas[0], "faults": outages[0]}
        frames = record_video(video, [agent for _model, agent in agents], **first, **same)
        console.print(f"video of seed {first['seed']}, {frames} frames: {video}")
    if minari is not None:
        grid = {name: where[name] for name in ("seeds", "seas", "outages")}
        count = write_dataset(minari, agents[0][1], **grid, **same)
        console.print(f"Minari data set of {count} episodes: {minari}")
    if json_file is not None:
        write_json(json_file, found)
        console.print(f"every episode: {json_file}")


def agents_named(model: str) -> list[tuple[str, Agent]]:
    """Return the agents that a name stands for, each with its label."""
    path = Path(model)
    if path.is_dir():
        if (path / "run.json").exists():
            return [(model, Run.of(path).policy)]
        files = sorted(path.glob("*/policy.npz")) or sorted(path.glob("*.npz"))
        if not files:
            raise AgentError(f"{path}: holds no finished run; usv-twin train makes them")
        return [
            (str(file.parent if file.name == "policy.npz" else file), Policy.load(file))
            for file in files
        ]
    if path.suffix == ".npz":
        return [(model, Policy.load(path))]
    if ":" in model:
        return [(model, import_named(model, AgentError, model)())]
    known = CONTROLLERS | DOCKING
    if model in known:
        return [(model, known[model]())]
    raise AgentError(
        f"{model}: no such folder, policy or controller; "
        f"controllers: {', '.join(known)}; agents of your own: module:Class"
    )


def trained_with(agents: list[Agent], given: dict[str, Any]) -> dict[str, Any]:
    """Return the environment options of the training, overridden by those given."""
    options = Plan("ppo", "raw", 1).environment | given
    named = ("task", "twin", "vessel", "vessel_spread", "frame_skip", "max_episode_steps")
    for name in named:
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
                + (f", or name --{name.replace('_', '-')}" if name in named[:4] else "")
            )
        (options[name],) = trained
    worlds = [
        {key: one for key, one in agent.settings.get("world", {}).items() if key not in given}
        for agent in agents
        if isinstance(agent, Policy)
    ]
    if any(world != worlds[0] for world in worlds):
        raise AgentError(f"these were trained in other worlds, {worlds}: evaluate them one by one")
    del options["sea"], options["faults"]
    return (worlds[0] if worlds else {}) | options


def _labels(models: list[str]) -> dict[str, str]:
    """Return short names of models: the last part of a path, if it is one."""
    short = {model: Path(model).name.removesuffix(".npz") for model in models}
    names = list(short.values())
    return {model: name if names.count(name) == 1 else model for model, name in short.items()}


def _forecasts(labels: dict[str, str], found: list[dict[str, Any]], twin: str) -> Table:
    """Return the table of the twin's forecasts on the episodes of each agent."""
    heads = ("agent", "sensors", "commands", "ahead", "m", "deg", "m/s", "in 90 %", "n")
    title = (
        f"forecasts of {twin} on the same episodes: mean errors of displacement, heading and "
        "speed, and shares of them in the 90 % intervals"
    )
    table = new_table(title, *heads, left=heads[:3])
    for model, label in labels.items():
        rows = [row["twin_forecast"] for row in found if row["model"] == model]
        for made, plan, ahead, *cells in forecast_rows(rows):
            shares = " ".join(cells[3:6]).replace("%", "")
            lost = "lost" if "lost" in made else "all"
            table.add_row(label, lost, plan, f"{ahead} s", *cells[:3], shares, cells[6])
    for column in table.columns[1:]:
        column.no_wrap = True
    return table


def _episodes(labels: dict[str, str], found: list[dict[str, Any]], same: dict[str, Any]) -> Table:
    """Return the table of how the agents did, a line for each sea state and loss."""
    means = ("success", "failed", "time,\ns", "return", "forecast\nerror, m")
    heads = ("agent", "sea", "loss", "off path,\nm", *means)
    boats = f"{same['vessel']}, spread {same.get('vessel_spread', 0.0):g}"
    title = (
        f"task {same['task']}, {boats}: median distance off the path [95 % interval], and means. "
        "Where an episode neither succeeds nor fails, its time ran out"
    )
    table = new_table(title, *heads, left=heads[:3], padding=0)
    table.columns[0].no_wrap, table.columns[0].overflow = False, "fold"
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for row in found:
        groups.setdefault((row["model"], row["sea"], row["faults"]), []).append(row)
    for (model, sea, loss), rows in groups.items():
        table.add_row(labels[model], sea, loss, *_cells(rows))
    return table


def _cells(rows: list[dict[str, Any]]) -> tuple[str, ...]:
    """Return distance off the path, success, failures, time, return and forecast error."""
    times = [row["length_s"] for row in rows if row["success"]]
    return (
        _median([row["off_path_m"] for row in rows]),
        f"{np.mean([row['success'] for row in rows]):.0%}",
        f"{np.mean([row['failed'] for row in rows]):.0%}",
        f"{np.mean(times):.0f}" if times else "-",
        f"{np.mean([row['return'] for row in rows]):.0f}",
        _forecast_error([row["twin_forecast"] for row in rows]),
    )


def _median(distances: list[float]) -> str:
    """Return the median and its interval."""
    median = f"{np.median(distances):.2f}"
    if len(distances) < INTERVAL_MIN:
        return median
    samples = np.random.default_rng(0).choice(distances, (REPLICATES, len(distances)))
    low, high = interval(np.median(samples, axis=1))
    return f"{median} [{low:.2f}, {high:.2f}]"


def _forecast_error(episodes: list[dict[str, float]]) -> str:
    """Return the mean error of the displacement 5 s ahead, with and without a loss, m."""
    scores = mean_scores(episodes)
    parts = [
        (scores[f"n{place}"], scores[f"known{place}_5s_displacement_m"])
        for place in ("", "_loss")
        if scores[f"n{place}"]
    ]
    count = sum(part[0] for part in parts)
    return f"{sum(n * error for n, error in parts) / count:.2f}" if count else "-"
