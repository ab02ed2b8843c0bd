"""The report of the study of agents: tables, and what they say in plain sentences."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin.agents.study.pictures import pictures
from twin.agents.study.results import ALL, QUESTIONS
from twin.agents.study.runs import folder_of
from twin.agents.study.settings import STUDIES, Piece, Settings, Studied, name_of
from twin.files import results_text
from usv_kernel.files import write_whole

__all__ = ["best_arm", "digest", "markdown", "rounded", "sentences", "write"]

FIGURES = 4
"""Significant figures of numbers in ``results.json``."""

Rows = list[Mapping[str, Any]]


def write(
    results: Mapping[str, Any],
    settings: Settings,
    done: Mapping[Piece, Mapping[str, Any]],
    folder: Path,
) -> None:
    """Write ``results.json``, ``tables.md``, pictures, and the policies that are shipped."""
    short = rounded(dict(results))
    write_whole(folder / "results.json", results_text(short).encode())
    write_whole(folder / "tables.md", markdown(short).encode())
    pictures(short, folder)
    _copy_middle(settings, done, folder)


def rounded(value: Any) -> Any:
    """Return JSON data with its fractions rounded to 4 figures, but for hyperparameters."""
    if isinstance(value, dict):
        return {key: one if key == "hyper" else rounded(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(one) for one in value]
    if isinstance(value, float):
        return int(value) if value.is_integer() else float(f"{value:.{FIGURES}g}")
    return value


def _copy_middle(settings: Settings, done: Mapping[Piece, Mapping[str, Any]], folder: Path) -> None:
    """Copy the policy of the middle run of each arm, by what counts, to ``policies/``."""
    metric = settings.studied.metric
    for arm in settings.arms:
        means = {
            piece: np.mean([row[metric] for row in made["rows"]])
            for piece, made in done.items()
            if piece[:2] == arm
        }
        if means:
            middle = sorted(means, key=lambda piece: means[piece])[len(means) // 2]
            source = folder_of(middle, folder) / "policy.npz"
            write_whole(folder / "policies" / f"{name_of(arm)}.npz", source.read_bytes())


def markdown(results: Mapping[str, Any]) -> str:
    """Return the study's tables and what they say."""
    settings = results["settings"]
    studied = STUDIES[settings["task"]]
    lines = [f"# Study of agents: {settings['task']}", "", f"`{results['command']}`", ""]
    lines += [f"- {line}" for line in sentences(results)]
    lines += [
        "",
        f"Numbers are the {studied.title}, with 95 % intervals of a bootstrap over runs and "
        f"episodes. Trainings of each agent: {len(settings['seeds'])}. "
        "Time off the path after a failure counts as the distance that ends the episode.",
        "",
        "## Differences over all losses",
        "",
        *_summary(results),
    ]
    for name, condition in settings["conditions"].items():
        seas = ", ".join(condition["seas"])
        episodes = len(condition["seeds"])
        lines += [
            "", f"## {name}: {condition['text']}", "",
            f"Sea: {seas}. Episodes of each sea with each loss: {episodes}.", "",
            *_estimates(results, studied, name), "",
            f"{_other_heads(studied)}, of each loss:", "",
            *_others(results, studied, name), "",
            "Differences on the same episodes, agent less other:", "",
            *_differences(results, studied, name),
        ]  # fmt: skip
    lines += ["", "## Trainings", "", *_trainings(results, studied)]
    return "\n".join(lines) + "\n"


def digest(results: Mapping[str, Any]) -> str:
    """Return the tables of :func:`markdown` that say most: the documentation has these."""
    settings = results["settings"]
    studied = STUDIES[settings["task"]]
    lines = ["### Differences over all losses", "", *_summary(results)]
    for name, condition in settings["conditions"].items():
        lines += ["", f"### {name}: {condition['text']}", "", *_estimates(results, studied, name)]
    return "\n".join([*lines, "", "### Trainings", "", *_trainings(results, studied)]) + "\n"


def _summary(results: Mapping[str, Any]) -> list[str]:
    """Return the table of differences over all losses, a column for each condition."""
    conditions = results["settings"]["conditions"]
    found: dict[tuple[str, str], dict[str, Mapping[str, Any]]] = {}
    for row in results["paired"]:
        if row["faults"] == ALL:
            found.setdefault((row["agent"], row["against"]), {})[row["condition"]] = row
    rows = (
        [agent, other, *(_difference(of[name]) for name in conditions)]
        for (agent, other), of in found.items()
    )
    return _table(["agent", "other", *conditions], rows)


def _table(heads: Sequence[str], rows: Iterator[list[str]]) -> list[str]:
    """Return the lines of a table."""
    return [_line(heads), _line(["---"] * len(heads)), *map(_line, rows)]


def _line(items: Sequence[str]) -> str:
    return f"| {' | '.join(items)} |"


def _losses(results: Mapping[str, Any]) -> list[str]:
    return [*results["settings"]["losses"], ALL]


def _by_agent(
    results: Mapping[str, Any], condition: str
) -> dict[str, dict[str, Mapping[str, Any]]]:
    """Return the cells of a condition by agent and loss."""
    found: dict[str, dict[str, Mapping[str, Any]]] = {}
    for cell in results["cells"]:
        if cell["condition"] == condition:
            found.setdefault(cell["agent"], {})[cell["faults"]] = cell
    return found


def _estimates(results: Mapping[str, Any], studied: Studied, condition: str) -> list[str]:
    """Return the table of what agents are compared by."""
    name, losses = studied.metric, _losses(results)
    rows = (
        [agent, *(_with_ends(cells[loss][name], cells[loss][f"{name}_ends"]) for loss in losses)]
        for agent, cells in _by_agent(results, condition).items()
    )
    return _table(["agent", *losses], rows)


def _with_ends(value: float, ends: Sequence[float], sign: str = "") -> str:
    return f"{value:{sign}.2f} [{ends[0]:{sign}.2f}, {ends[1]:{sign}.2f}]"


def _other_heads(studied: Studied) -> str:
    """Return what stands in the second table of a condition."""
    first = "Mean off the path, m" if studied.metric == "off_path_m" else "Off the path, m"
    return f"{first} / share of successes / mean time of these, s / mean return"


def _others(results: Mapping[str, Any], studied: Studied, condition: str) -> list[str]:
    """Return the table of the other estimates."""
    off = "off_path_mean_m" if studied.metric == "off_path_m" else "off_path_m"
    rows = (
        [agent, *(_four(cells[loss], off) for loss in _losses(results))]
        for agent, cells in _by_agent(results, condition).items()
    )
    return _table(["agent", *_losses(results)], rows)


def _four(cell: Mapping[str, Any], off: str) -> str:
    time = "-" if cell["length_s"] is None else f"{cell['length_s']:.0f}"
    return f"{cell[off]:.2f} / {cell['success']:.2f} / {time} / {cell['return']:.0f}"


def _differences(results: Mapping[str, Any], studied: Studied, condition: str) -> list[str]:
    """Return the table of paired tests."""
    found: dict[tuple[str, str], dict[str, Mapping[str, Any]]] = {}
    for row in results["paired"]:
        if row["condition"] == condition:
            found.setdefault((row["agent"], row["against"]), {})[row["faults"]] = row
    rows = (
        [agent, other, *(_difference(of[loss]) for loss in _losses(results))]
        for (agent, other), of in found.items()
    )
    return _table(["agent", "other", *_losses(results)], rows)


def _difference(row: Mapping[str, Any]) -> str:
    text = _with_ends(row["difference"], (row["low"], row["high"]), "+")
    return text if row["verdict"] == "no difference shown" else f"{text} {row['verdict']}"


def _trainings(results: Mapping[str, Any], studied: Studied) -> list[str]:
    """Return the table of trainings: how long they took, and when they were at the level."""
    level = results["levels"].get(studied.level)
    reached = "-" if level is None else f"{level:.2f}"
    heads = [
        *("agent", "decisions", "CPU, s", "end of the curve"),
        f"runs at the level of {studied.level} ({reached})",
        *("after decisions", "after CPU, s"),
    ]
    rows = []
    for agent in dict.fromkeys(curve["agent"] for curve in results["curves"]):
        own = [curve for curve in results["curves"] if curve["agent"] == agent]
        there = [curve for curve in own if curve["level_decisions"] is not None]
        rows.append([
            agent,
            str(own[0]["decisions"][-1]),
            _spread([curve["cpu_s"][-1] for curve in own]),
            _spread([curve[studied.metric][-1] for curve in own], 2),
            f"{len(there)} of {len(own)}",
            _spread([curve["level_decisions"] for curve in there]),
            _spread([curve["level_cpu_s"] for curve in there]),
        ])  # fmt: skip
    return [
        "CPU seconds are of the process that trains, without the evaluations of the curve. Given "
        "are median and range of the runs; a curve has a point every so many decisions.", "",
        *_table(heads, iter(rows)),
    ]  # fmt: skip


def _spread(values: Sequence[float], digits: int = 0) -> str:
    """Return median and range."""
    if not values:
        return "-"
    middle = f"{float(np.median(values)):.{digits}f}"
    return f"{middle} ({min(values):.{digits}f} to {max(values):.{digits}f})"


def best_arm(results: Mapping[str, Any]) -> str:
    """Return the arm with the best ends of its learning curves, of those without the truth.

    These episodes are no part of the evaluation, so that the choice favours no arm there.
    """
    studied = STUDIES[results["settings"]["task"]]
    ends: dict[str, list[tuple[float, float]]] = {}
    for curve in results["curves"]:
        if not curve["agent"].endswith("oracle"):
            end = studied.better * curve[studied.metric][-1], curve["return"][-1]
            ends.setdefault(curve["agent"], []).append(end)
    # of equal ones, that with the larger return
    return max(ends, key=lambda arm: tuple(np.mean(ends[arm], axis=0)), default="")


def sentences(results: Mapping[str, Any]) -> list[str]:
    """Return what the study says, by its numbers."""
    studied = STUDIES[results["settings"]["task"]]
    best, lines = best_arm(results), []
    if best:
        lines.append(f"The learned agent with the best ends of learning curves is `{best}`.")
    for other in studied.against:
        rows = [row for row in results["paired"] if row["against"] == other]
        lines += _said(f"`{best}` against `{other}`", [row for row in rows if row["agent"] == best])
    words = {
        "twin": "Does the twin help? `{}` against `{}`",
        "identified": "Does what the twin identified help? `{}` against `{}`",
        "truth": "Against the truth: `{}` against `{}`",
    }
    for question in QUESTIONS:
        rows = [row for row in results["paired"] if row["question"] == question]
        for agent, other in dict.fromkeys((row["agent"], row["against"]) for row in rows):
            own = [row for row in rows if row["agent"] == agent]
            lines += _said(words[question].format(agent, other), own)
    count = len(results["paired"])
    lines.append(
        f"{count} pairs were tested, with no correction for their number: of as many without any "
        f"difference about {0.05 * count:.0f} would be called better or worse by chance."
    )
    return lines


def _said(pair: str, rows: Rows) -> Iterator[str]:
    """Yield where one agent of a pair is better, worse, or neither."""
    single = [row for row in rows if row["faults"] != ALL]
    if not single:
        return
    counts = {
        kind: [row for row in single if row["verdict"] == kind]
        for kind in ("better", "worse", "no difference shown")
    }
    parts = [f"{kind} in {len(found)} of {len(single)}" for kind, found in counts.items()]
    yield f"{pair}, conditions and losses: {'; '.join(parts)}."
    for kind in ("better", "worse"):
        where = itertools.groupby(counts[kind], key=lambda row: row["condition"])
        listed = [f"{name} ({', '.join(row['faults'] for row in own)})" for name, own in where]
        if listed:
            yield f"{pair}, {kind}: {'; '.join(listed)}."
    whole = [row for row in rows if row["faults"] == ALL]
    listed = [f"{row['condition']} {_difference(row)}" for row in whole]
    yield f"{pair}, difference over all losses: {'; '.join(listed)}."
