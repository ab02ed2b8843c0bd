"""Pictures of the study of agents: estimates by loss, learning curves, paired differences."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from twin.agents.study.results import ALL
from twin.agents.study.settings import STUDIES
from usv_kernel.files import replacing

__all__ = ["COLOURS", "pictures"]

COLOURS = {
    "raw": "#8c564b", "raw_stacked": "#b5a642", "twin": "#17becf", "twin_params": "#9467bd",
    "twin_health": "#b0568f", "twin_attitude": "#1a9c9c", "oracle": "#7f9c3b",
    "compact_raw": "#c0392b", "compact": "#1f6fb4", "compact_params": "#6a3d9a",
    "compact_oracle": "#2e8b57",
}  # fmt: skip
"""Colour of each observation set."""

LINES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1, 1, 1)))

MARKERS = "osD^vP*"

VERDICTS = {"better": "#2e8b57", "worse": "#c0392b", "no difference shown": "0.5"}


def pictures(results: Mapping[str, Any], folder: Path) -> list[Path]:
    """Draw what agents are compared by, learning curves, and paired differences."""
    import matplotlib.pyplot as plt

    studied = STUDIES[results["settings"]["task"]]
    drawn = {
        f"{studied.metric.removesuffix('_m')}.png": _draw_cells(results),
        "curves.png": _draw_curves(results),
        "paired.png": _draw_pairs(results),
    }
    for name, figure in drawn.items():
        with replacing(folder / name) as partial:
            figure.savefig(partial, dpi=100)
        plt.close(figure)
    return [folder / name for name in drawn]


def _styles(results: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return how each arm is drawn: a colour for the set, line and marker for the algorithm."""
    arms = results["settings"]["arms"]
    algos = list(dict.fromkeys(algo for algo, _observation in arms))
    found = {}
    for algo, observation in arms:
        k = algos.index(algo)
        found[f"{algo}-{observation}"] = {
            **{"color": COLOURS[observation], "linestyle": LINES[k % len(LINES)]},
            **{"marker": MARKERS[k % len(MARKERS)], "label": f"{algo}-{observation}"},
        }
    return found


def _figure(count: int, height: float = 4.0) -> tuple[Any, list[Any]]:
    """Return a figure with so many panels, three in a row."""
    import matplotlib.pyplot as plt

    columns = min(count, 3)
    rows = -(-count // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(1.5 + 4.5 * columns, height * rows), sharey=True, squeeze=False,
        layout="constrained",
    )  # fmt: skip
    for ax in axes.ravel()[count:]:
        ax.remove()
    return figure, list(axes.ravel()[:count])


def _in_metres(ax: Any) -> None:
    """Make the vertical axis logarithmic, with ticks at 1, 2, 5, 10, ..."""
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter(lambda y, _: f"{y:g}" if f"{y:g}".strip("0.") in "25" else "")


def _draw_cells(results: Mapping[str, Any]) -> Any:
    settings = results["settings"]
    studied, losses = STUDIES[settings["task"]], settings["losses"]
    cells = {(cell["condition"], cell["agent"], cell["faults"]): cell for cell in results["cells"]}
    styles = _styles(results)
    figure, axes = _figure(len(settings["conditions"]))
    place = np.arange(len(losses))
    for ax, condition in zip(axes, settings["conditions"], strict=True):
        agents = list(dict.fromkeys(key[1] for key in cells))
        for k, agent in enumerate(agents):
            own = [cells[condition, agent, loss] for loss in losses]
            middle = np.array([cell[studied.metric] for cell in own])
            ends = np.array([cell[f"{studied.metric}_ends"] for cell in own]).T
            # an interval of percentiles need not hold the estimate
            spans = np.maximum(np.array([middle - ends[0], ends[1] - middle]), 0.0)
            aside = place + 0.03 * (k - 0.5 * (len(agents) - 1))
            grey = {"color": f"{0.15 + 0.15 * (k % 4)}", "linestyle": ":", "marker": "x"}
            style = styles.get(agent, grey | {"label": agent})
            ax.errorbar(aside, middle, spans, ms=4, lw=1.1, capsize=1.5, **style)
        ax.set_xticks(place, losses)
        ax.set_title(condition)
        if studied.metric == "off_path_m":
            _in_metres(ax)
        ax.grid(alpha=0.3)
    figure.supxlabel("loss of GPS")
    figure.supylabel(studied.title)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", fontsize=8)
    return figure


def _draw_curves(results: Mapping[str, Any]) -> Any:
    studied = STUDIES[results["settings"]["task"]]
    styles = _styles(results)
    algos = list(dict.fromkeys(algo for algo, _observation in results["settings"]["arms"]))
    figure, axes = _figure(len(algos))
    for ax, algo in zip(axes, algos, strict=True):
        for agent, style in styles.items():
            own = [curve for curve in results["curves"] if curve["agent"] == agent]
            if not own or agent.rpartition("-")[0] != algo:
                continue
            steps = np.array(own[0]["decisions"]) / 1e3
            score = np.array([curve[studied.metric] for curve in own])
            ax.plot(steps, score.mean(axis=0), ms=3, **style)
            ax.fill_between(steps, score.min(axis=0), score.max(axis=0), color=style["color"],
                            alpha=0.15, lw=0)  # fmt: skip
        for name, level in results["levels"].items():
            ax.axhline(level, color="0.4", lw=0.9, ls=":")
            ax.annotate(name, (1.0, level), fontsize=7, color="0.3", ha="right", va="bottom",
                        xycoords=("axes fraction", "data"))  # fmt: skip
        ax.set_title(algo)
        ax.set_xlabel("decisions, thousands")
        if studied.metric == "off_path_m":
            _in_metres(ax)
        ax.grid(alpha=0.3)
        ax.legend(fontsize=8)
    off = "off the path, m" if studied.metric == "off_path_m" else "share of successes"
    axes[0].set_ylabel(f"{off} (mean; shaded: all runs)")
    return figure


def _draw_pairs(results: Mapping[str, Any]) -> Any:
    """Draw the differences over all losses, a panel for each condition."""
    settings = results["settings"]
    studied = STUDIES[settings["task"]]
    rows = [row for row in results["paired"] if row["faults"] == ALL]
    names = list(dict.fromkeys(f"{row['agent']} less {row['against']}" for row in rows))
    figure, axes = _figure(len(settings["conditions"]), 1.2 + 0.22 * len(names))
    for ax, condition in zip(axes, settings["conditions"], strict=True):
        for row in (row for row in rows if row["condition"] == condition):
            at = names.index(f"{row['agent']} less {row['against']}")
            colour = VERDICTS[row["verdict"]]
            ax.plot([row["low"], row["high"]], [at, at], color=colour, lw=2.0)
            ax.plot(row["difference"], at, "o", color=colour, ms=4)
        ax.axvline(0.0, color="0.3", lw=0.8)
        if studied.metric == "off_path_m":  # some are far off, most differ by decimetres
            ax.set_xscale("symlog", linthresh=1.0)
            ax.set_xticks([-10.0, -1.0, -0.5, 0.0, 0.5, 1.0, 10.0])
            ax.xaxis.set_major_formatter("{x:g}")
            ax.minorticks_off()
        ax.set_yticks(range(len(names)), names, fontsize=8)
        ax.set_ylim(len(names) - 0.5, -0.5)
        ax.set_title(condition)
        ax.grid(alpha=0.3)
    better = "left" if studied.better < 0 else "right"
    figure.supxlabel(f"difference over all losses; better to the {better} (green: shown, 95 %)")
    return figure
