"""The report of the study of agents: tables, verdicts and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin.agents.forecast_table import FORECAST_HEADS, forecast_rows
from twin.agents.study import METRICS, Piece, Settings
from twin.files import results_text
from usv_kernel.files import replacing, write_whole

__all__ = ["COLOURS", "forecast_lines", "markdown", "pictures", "verdicts", "write"]


def write(
    results: Mapping[str, Any],
    settings: Settings,
    done: Mapping[Piece, Mapping[str, Any]],
    folder: Path,
) -> None:
    """Write ``results.json``, ``tables.md``, pictures, and the policies that are shipped."""
    write_whole(folder / "results.json", results_text(dict(results)).encode())
    write_whole(folder / "tables.md", markdown(results).encode())
    pictures(results, folder)
    _copy_middle(settings, done, folder)


def _copy_middle(settings: Settings, done: Mapping[Piece, Mapping[str, Any]], folder: Path) -> None:
    """Copy the policy of the middle run of each arm, by distance off the path, to ``policies/``."""
    for arm in settings.arms:
        means = {
            piece: np.mean([row["off_path_m"] for row in made["rows"]])
            for piece, made in done.items()
            if piece[:2] == arm
        }
        if not means:
            continue
        algo, observation, seed = sorted(means, key=lambda piece: means[piece])[len(means) // 2]
        source = folder / "runs" / f"{algo}-{observation}-{seed}" / "policy.npz"
        copy = folder / "policies" / f"{algo}-{observation}.npz"
        write_whole(copy, source.read_bytes())


def _steps(results: Mapping[str, Any]) -> str:
    """Return how many decisions each algorithm was trained for."""
    made = {row["agent"].partition("-")[0]: int(row["decisions"][-1]) for row in results["curves"]}
    return ", ".join(f"{steps} ({algo})" for algo, steps in made.items())


def markdown(results: Mapping[str, Any]) -> str:
    """Return the study's tables and what they say."""
    settings = results["settings"]
    outages = settings["outages"]
    runs, episodes = len(settings["seeds"]), len(settings["evaluation_seeds"])
    lines = [
        "# GPS loss study",
        "",
        f"`{results['command']}`",
        "",
        f"Interquartile means of {runs} trainings of {_steps(results)} decisions and {episodes} "
        "episodes in each sea state. The 95 % intervals are of a stratified bootstrap over runs "
        "and episodes. Time after a failure counts as the distance that ends the episode.",
    ]
    cells = {
        (cell["metric"], cell["sea"], cell["agent"], cell["faults"]): cell
        for cell in results["cells"]
    }
    for metric, title in METRICS.items():
        seas = list(dict.fromkeys(key[1] for key in cells if key[0] == metric))
        for sea in seas:
            shown = [name for name in outages if any(
                key[0] == metric and key[1] == sea and key[3] == name for key in cells
            )]  # fmt: skip
            where = "all sea states" if sea == "all" else f"sea state {sea}"
            lines += ["", f"## {title[0].upper()}{title[1:]}, {where}", ""]
            lines += _row(["agent", *shown]), _row(["---"] * (len(shown) + 1))
            for agent in dict.fromkeys(key[2] for key in cells):
                found = [cells.get((metric, sea, agent, name)) for name in shown]
                lines.append(_row([agent, *(_text(cell, "iqm", metric) for cell in found)]))
    if results["gaps"]:
        lines += ["", "## Share of the gap from raw to oracle that is closed", ""]
        lines += _row(["agent", "by", *outages]), _row(["---"] * (len(outages) + 2))
    gaps = {(gap["agent"], gap["metric"], gap["faults"]): gap for gap in results["gaps"]}
    for agent, metric in dict.fromkeys(key[:2] for key in gaps):
        found = [gaps.get((agent, metric, name)) for name in outages]
        lines.append(_row([agent, metric, *map(_closed, found)]))
    lines += forecast_lines(results)
    return "\n".join([*lines, "", *verdicts(results)]) + "\n"


def forecast_lines(results: Mapping[str, Any]) -> list[str]:
    """Return how predictable the boat of each agent is, lines of a table; none if not graded."""
    if not results.get("forecasts"):
        return []
    twin = results["settings"]["options"].get("twin", "ukf")
    about = results.get("forecasts_of", "all episodes of the tables above")
    lines = [
        "", "## How predictable is the boat of each agent?", "",
        f"Forecasts of the twin `{twin}`, made each second on {about}: mean absolute errors "
        "and share of truths within the 90 % intervals. `That came`: with the commands that "
        "the agent then gave. `Held`: with the command of the moment.", "",
    ]  # fmt: skip
    lines += (_row(["agent", "made", "commands", *FORECAST_HEADS]),)
    lines += (_row(["---"] * (3 + len(FORECAST_HEADS))),)
    for agent in dict.fromkeys(row["agent"] for row in results["forecasts"]):
        own = [row for row in results["forecasts"] if row["agent"] == agent]
        numbers = [{k: v for k, v in row.items() if k not in _LABELS} for row in own]
        lines += [_row([agent, *cells]) for cells in forecast_rows(numbers)]
    return lines


_LABELS = ("agent", "faults", "episodes")


def _row(items: Sequence[str]) -> str:
    return f"| {' | '.join(items)} |"


def _text(cell: Mapping[str, Any] | None, key: str, metric: str) -> str:
    if cell is None:
        return "-"
    digits = 0 if metric == "return" else 2
    text = f"{cell[key]:.{digits}f}"
    if cell["low"] is not None:
        text += f" [{cell['low']:.{digits}f}, {cell['high']:.{digits}f}]"
    return text


def _closed(gap: Mapping[str, Any] | None) -> str:
    """Return the share of a gap that is closed in %, or that there is none."""
    if gap is None:
        return "-"
    if gap["closed"] is None:
        return "no gap"
    bounds = "" if gap["low"] is None else f" [{gap['low']:.0%}, {gap['high']:.0%}]"
    return f"{gap['closed']:.0%}{bounds}"


def verdicts(results: Mapping[str, Any]) -> list[str]:
    """Return where the twin helps, and where it does not, a line for each."""
    lines = []
    for algo in dict.fromkeys(row["algo"] for row in results["helps"]):
        own = [row for row in results["helps"] if row["algo"] == algo]
        good = [row for row in own if row["verdict"] == "helps"]
        lines.append(f"{algo}: the twin helps in {len(good)} of {len(own)} sea states and outages.")
        lines += [
            f"{algo}: it does not help in sea state {row['sea']} with {row['faults']}: "
            f"{row['verdict']} ({row['less_m']:+.2f} m less off the path"
            + ("" if row["low"] is None else f", 95 % {row['low']:+.2f} to {row['high']:+.2f}")
            + ")."
            for row in own
            if row["verdict"] != "helps"
        ]
    return [part for line in lines for part in (line, "")][:-1]


COLOURS = {
    "raw": "#c0392b", "raw_stacked": "#e08e0b", "twin": "#1f6fb4", "twin_params": "#6a3d9a",
    "twin_health": "#b0568f", "twin_attitude": "#1a9c9c", "oracle": "#2e8b57",
    "compact": "#17395c", "compact_params": "#3d1f5c",
}  # fmt: skip


def pictures(results: Mapping[str, Any], folder: Path) -> list[Path]:
    """Draw distances off the path, shares of the gap if an arm closes some, and learning curves."""
    import matplotlib.pyplot as plt

    drawn = {"off_path.png": _draw_cells(results), "curves.png": _draw_curves(results)}
    if any(gap["metric"] == "off_path_m" for gap in results["gaps"]):
        drawn["gap.png"] = _draw_gaps(results)
    else:
        (folder / "gap.png").unlink(missing_ok=True)  # of other arms in the same folder
    for name, figure in drawn.items():
        with replacing(folder / name) as partial:
            figure.savefig(partial, dpi=130)
        plt.close(figure)
    return [folder / name for name in drawn]


def _panels(results: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the agents of each panel; the recurrent one stands beside what it is compared with."""
    found: dict[str, list[str]] = {}
    for algo, observation in results["settings"]["arms"]:
        panel = "ppo" if algo == "recurrent_ppo" else algo
        found.setdefault(panel, []).append(f"{algo}-{observation}")
    return found


def _figure(count: int) -> Any:
    import matplotlib.pyplot as plt

    return plt.subplots(
        1, count, figsize=(1.5 + 4.5 * count, 4.2), sharey=True, squeeze=False, layout="constrained"
    )


def _in_metres(ax: Any) -> None:
    """Make the vertical axis logarithmic, with ticks at 1, 2, 5, 10, ..."""
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter(lambda y, _: f"{y:g}" if f"{y:g}".strip("0.") in "25" else "")


def _style(agent: str) -> dict[str, Any]:
    algo, observation = agent.partition("-")[::2]
    dashed = "--" if algo == "recurrent_ppo" else "-"
    label = "raw, recurrent" if algo == "recurrent_ppo" else observation.replace("_", " ")
    return {"color": COLOURS[observation], "linestyle": dashed, "label": label}


def _draw_cells(results: Mapping[str, Any]) -> Any:
    settings = results["settings"]
    outages = settings["outages"]
    sea = "all" if len(settings["seas"]) > 1 else settings["seas"][0]
    cells = {
        (cell["agent"], cell["faults"]): cell
        for cell in results["cells"]
        if cell["metric"] == "off_path_m" and cell["sea"] == sea
    }
    panels = _panels(results)
    figure, axes = _figure(len(panels))
    place = np.arange(len(outages))
    for ax, (panel, agents) in zip(axes[0], panels.items(), strict=True):
        for k, agent in enumerate(agents):
            own = [cells[agent, name] for name in outages]
            middle = np.array([cell["iqm"] for cell in own])
            ends = np.array([[cell["low"], cell["high"]] for cell in own], dtype=np.float64).T
            aside = place + 0.05 * (k - 0.5 * (len(agents) - 1))
            spans = np.abs(ends - middle)
            ax.errorbar(aside, middle, spans, marker="o", ms=4, capsize=2, **_style(agent))
        for k, name in enumerate(results["levels"]):
            line = [cells[name, outage]["iqm"] for outage in outages]
            ax.plot(place, line, color="0.45", lw=1.2, marker="xsdv^<>p*"[k % 9], ms=4,
                    linestyle=":", label=name)  # fmt: skip
        ax.set_xticks(place, outages)
        ax.set_title(panel.upper())
        ax.set_xlabel("loss of GPS")
        _in_metres(ax)
        ax.grid(alpha=0.3)
    axes[0, 0].set_ylabel("off the path, m (interquartile mean)")
    axes[0, -1].legend(fontsize=8, loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure


def _draw_gaps(results: Mapping[str, Any]) -> Any:
    outages = results["settings"]["outages"]
    gaps = [gap for gap in results["gaps"] if gap["metric"] == "off_path_m"]
    panels = {
        panel: [agent for agent in agents if any(gap["agent"] == agent for gap in gaps)]
        for panel, agents in _panels(results).items()
    }
    figure, axes = _figure(len(panels))
    for ax, (panel, agents) in zip(axes[0], panels.items(), strict=True):
        width = 0.8 / max(len(agents), 1)
        for k, agent in enumerate(agents):
            style = _style(agent)
            hatch = "//" if style.pop("linestyle") == "--" else None
            for gap in (gap for gap in gaps if gap["agent"] == agent):
                at = outages.index(gap["faults"]) + width * (k + 0.5) - 0.4
                if gap["closed"] is None:
                    ax.text(at, 0.02, "no gap", rotation=90, ha="center", va="bottom", fontsize=8)
                    continue
                ends = np.abs(np.array([[gap["low"]], [gap["high"]]]) - gap["closed"])
                ax.bar(at, gap["closed"], 0.9 * width, yerr=ends, capsize=2, alpha=0.85,
                       color=style["color"], hatch=hatch)  # fmt: skip
            ax.bar(0, 0, color=style["color"], hatch=hatch, label=style["label"])
        ax.axhline(0.0, color="0.3", lw=0.8)
        ax.axhline(1.0, color="0.3", lw=0.8, ls=":")
        ax.set_ylim(-1.0, 1.6)
        ax.set_xticks(range(len(outages)), outages)
        ax.set_title(panel.upper())
        ax.set_xlabel("loss of GPS")
        if agents:
            ax.legend(
                fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.06), ncols=3, frameon=False
            )
    axes[0, 0].yaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
    axes[0, 0].set_ylabel("share of the gap raw to oracle that is closed")
    return figure


def _draw_curves(results: Mapping[str, Any]) -> Any:
    panels = _panels(results)
    figure, axes = _figure(len(panels))
    for ax, (panel, agents) in zip(axes[0], panels.items(), strict=True):
        for agent in agents:
            own = [curve for curve in results["curves"] if curve["agent"] == agent]
            if not own:
                continue
            steps = np.array(own[0]["decisions"]) / 1e3
            off = np.array([curve["off_path_m"] for curve in own])
            style = _style(agent)
            ax.plot(steps, off.mean(axis=0), **style)
            ax.fill_between(steps, off.min(axis=0), off.max(axis=0), color=style["color"],
                            alpha=0.15, lw=0)  # fmt: skip
        levels = results["levels"]
        for k, (name, level) in enumerate(levels.items()):
            ax.axhline(level, color="0.5", lw=0.8, ls=":")
            # side by side, as some curves coincide
            ax.annotate(name, ((k + 0.5) / len(levels), level), fontsize=7, color="0.35",
                        xycoords=("axes fraction", "data"), ha="center", va="bottom")  # fmt: skip
        ax.set_title(panel.upper())
        ax.set_xlabel("decisions, thousands")
        _in_metres(ax)
        ax.grid(alpha=0.3)
        ax.legend(fontsize=8, loc="upper right")
    axes[0, 0].set_ylabel("off the path, m (mean; shaded: all runs)")
    return figure
