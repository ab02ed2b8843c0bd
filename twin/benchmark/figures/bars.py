"""Errors after 10 s as bars with intervals, one for each predictor without and with a loss."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from twin.benchmark.figures.data import number_of, text_of
from twin.benchmark.figures.style import BLACK, WIDTH, Styles, new_figure, patch, set_title
from twin.benchmark.verdict.summary import best_first

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["recorded_figure", "verdict_figure"]

PANELS = {"position_m": "position after 10 s (m)", "heading_deg": "heading after 10 s (deg)"}
"""Title of each panel."""

RATIOS = {
    "displacement": "position after 10 s (ratio to persistence)",
    "psi": "heading after 10 s (ratio to persistence)",
}
"""Title of each panel of recorded runs."""

SHADES = {"none": ("without a loss", 0.95), "any": ("with a loss", 0.45), "all": ("all runs", 0.95)}
"""Label and opacity of the bars."""

LINE = 0.3
"""Height of a predictor's bars, inch."""

Row = Mapping[str, Any]


def verdict_figure(rows: Sequence[Row], styles: Styles) -> Figure:
    """Draw the mean absolute errors with 95 % intervals over boats, the best predictor on top.

    ``rows`` are those of ``results["verdict"]``. A bar that is longer than the panel, which shows
    persistence in full, is cut and has an arrow head; its number counts.
    """
    return _bars(rows, styles, PANELS, "mean over scenarios and boats, 95 % intervals")


def recorded_figure(
    blocks: Mapping[str, Mapping[str, Mapping[str, Row]]], styles: Styles
) -> Figure:
    """Draw the ratios of recorded runs to persistence, with 95 % intervals over runs.

    ``blocks`` are those of one folder, from
    :func:`twin.benchmark.verdict.summary.recorded_blocks`: without a loss and with one.
    """
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for block in blocks.values():
        for name in best_first(block):
            for channel in RATIOS:
                row = block[name][channel]
                loss = "none" if row["fault"] == "none" else "any"
                ends = {f"{channel}_{end}": row.get(end) for end in ("low", "high")}
                found = rows.setdefault((name, loss), {"predictor": name, "loss": loss})
                found |= {channel: row.get("ratio"), **ends}
    bounded = any(number_of(row, "psi_low") > 0.0 for row in rows.values())
    about = f"{row['folder']}, mean over runs{', 95 % intervals' if bounded else ''}"
    return _bars(list(rows.values()), styles, RATIOS, about)


def _bars(rows: Sequence[Row], styles: Styles, panels: Mapping[str, str], about: str) -> Figure:
    """Draw a panel for each error, and a bar in it for each predictor and loss."""
    names = list(dict.fromkeys(text_of(row, "predictor") for row in rows))
    there = {text_of(row, "loss") for row in rows}
    losses: list[str] = [loss for loss in ("none", "any") if loss in there] or ["all"]
    shown = {(text_of(row, "predictor"), text_of(row, "loss")): row for row in rows}
    entries = [(patch(BLACK, SHADES[loss][1]), SHADES[loss][0]) for loss in losses]
    height = 2.0 * (LINE * len(names) + 0.7)
    fig, axes = new_figure(
        "Errors after 10 s",
        about,
        entries,
        [[panel] for panel in panels],
        (WIDTH, height),
    )
    for panel, title in panels.items():
        ax = axes[panel]
        set_title(ax, title)
        limit = _limit(rows, panel)
        for k, name in enumerate(names):
            for j, loss in enumerate(losses):
                if (name, loss) in shown:
                    place = k + (0.4 if len(losses) == 1 else 0.2 + 0.4 * j)
                    look = {"height": 0.72 / len(losses), "alpha": SHADES[loss][1]}
                    _draw_bar(ax, shown[name, loss], panel, (place, limit), styles, look)
        ax.set_ylim(len(names), -0.2)
        ax.set_xlim(0.0, limit)
        ax.set_yticks([k + 0.4 for k in range(len(names))], names, parse_math=False)
        ax.set_xlabel(f"error ({title.rpartition('(')[2]}", fontsize=10)
        ax.grid(False, axis="y")
    return fig


def _limit(rows: Sequence[Row], panel: str) -> float:
    """Return the end of the axis: persistence, or the largest error without it."""
    values = {name: 0.0 for name in ("persistence", "other")}
    for row in rows:
        kind = "persistence" if text_of(row, "predictor") == "persistence" else "other"
        ends = [number_of(row, panel), number_of(row, f"{panel}_high")]
        values[kind] = max([values[kind], *(end for end in ends if math.isfinite(end))])
    return 1.2 * (values["persistence"] or values["other"] or 1.0)


def _draw_bar(
    ax: Axes, row: Row, panel: str, at: tuple[float, float], styles: Styles, look: dict[str, Any]
) -> None:
    """Draw one bar at a height, with its interval and its number; ``at`` also has the limit."""
    place, limit = at
    value, low, high = (number_of(row, f"{panel}{end}") for end in ("", "_low", "_high"))
    colour = styles[text_of(row, "predictor")][0]
    ax.barh([place], [min(value, limit)], color=colour, **look)
    if math.isfinite(low) and high < limit:
        ax.plot([low, high], [place, place], color=BLACK, lw=1.0)
    text = f"{value:#.3g}".rstrip(".")
    if value > limit:
        ax.plot([0.985 * limit], [place], marker=">", color=BLACK, ms=5)
        ax.text(0.95 * limit, place, text, va="center", ha="right", fontsize=9, color=BLACK)
        return
    beyond = max(value, high) if high < limit else value
    ax.text(beyond + 0.012 * limit, place, text, va="center", fontsize=9, color=BLACK)
