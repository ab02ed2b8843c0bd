"""Pictures of results: errors after 10 s as bars, errors against the horizon."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.benchmark.figures.style import (
    BLACK,
    WIDTH,
    Styles,
    new_figure,
    patch,
    predictor_entries,
    set_title,
)
from twin.benchmark.verdict.tables import number, number_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["growth_figure", "has_intervals", "verdict_figure"]

ERRORS = {"position_m": "position after 10 s (m)", "heading_deg": "heading after 10 s (deg)"}
"""Title of each panel of the bars."""

LOSSES = {"none": ("without a loss", 0.95), "any": ("with a loss", 0.45)}
"""Label and opacity of the bars."""

LONGEST_BAR = 1e6
"""Longer bars cannot be drawn."""

CHANNELS = {"displacement": ("position (m)", 1.0), "psi": ("heading (deg)", 180.0 / math.pi)}
"""Title and factor of each panel of the errors against the horizon."""

Row = Mapping[str, Any]


def verdict_figure(rows: Sequence[Row], styles: Styles) -> Figure:
    """Draw the mean absolute errors with 95 % intervals over boats, the best predictor on top.

    ``rows`` are those of ``results["verdict"]``. The panels show persistence in full, and cut what
    is longer, which ends in an arrow. Beside each bar stands its number, and the end of its
    interval if that is cut.
    """
    names = list(dict.fromkeys(row["predictor"] for row in rows))
    of = {(row["predictor"], row["loss"]): row for row in rows}
    losses = [loss for loss in LOSSES if any(row["loss"] == loss for row in rows)]
    entries = [(patch(BLACK, LOSSES[loss][1]), LOSSES[loss][0]) for loss in losses]
    about = "mean over scenarios and boats" + (", 95 % intervals" if has_intervals(rows) else "")
    mosaic = [[panel] for panel in ERRORS]
    size = (WIDTH, 2.0 * (0.3 * len(names) + 0.7))
    fig, axes = new_figure("Errors after 10 s", about, entries, mosaic, size)
    for panel, title in ERRORS.items():
        ax, limit = axes[panel], _limit(rows, panel)
        set_title(ax, title)
        for j, loss in enumerate(losses):
            value, low, high = (
                np.array([number_of(of.get((name, loss), {}), f"{panel}{end}") for name in names])
                for end in ("", "_low", "_high")
            )
            bars = ax.barh(
                np.arange(len(names)) + (j + 0.5) / len(losses) * 0.8,
                np.minimum(value, LONGEST_BAR),
                xerr=np.maximum([value - low, high - value], 0.0),
                height=0.72 / len(losses),
                color=[styles[name][0] for name in names],
                alpha=LOSSES[loss][1],
                error_kw={"ecolor": BLACK, "lw": 1.0},
            )
            for bar, v, end in zip(bars, value, high, strict=True):
                far = np.fmax(v, end)
                at = np.fmin(far, limit), bar.get_y() + 0.5 * bar.get_height()
                text = "" if np.isnan(v) else number(v)
                if far > limit:
                    text += f" (to {number(end)})" if end > limit else ""
                    ax.plot(*at, ">", color=BLACK, markersize=7, clip_on=False)
                ax.annotate(text, at, (6, 0), textcoords="offset points", va="center", fontsize=9)
        ax.set_ylim(len(names), -0.2)
        ax.set_xlim(0.0, limit)
        ax.set_yticks(np.arange(len(names)) + 0.4, names, parse_math=False)
        ax.grid(False, axis="y")
    return fig


def has_intervals(rows: Sequence[Row]) -> bool:
    """Return whether an error of the verdict has an interval."""
    return any(number_of(row, f"{panel}_low") >= 0.0 for row in rows for panel in ERRORS)


def _limit(rows: Sequence[Row], panel: str) -> float:
    """Return the end of the axis: persistence, or the largest error without it."""
    base = [row for row in rows if row["predictor"] == "persistence"]
    ends = [number_of(row, f"{panel}{end}") for row in base or rows for end in ("", "_high")]
    return 1.2 * max([end for end in ends if 0.0 < end < LONGEST_BAR], default=1.0)


def growth_figure(about: str, rows: Sequence[Row], styles: Styles) -> Figure | None:
    """Draw the mean absolute error against the horizon, of the first plan; None without any.

    ``about`` is scenario and case, ``rows`` are theirs of ``results["channels"]``.
    """
    from matplotlib.ticker import LogLocator

    drawn = [
        row
        for row in rows
        if row["plan"] == rows[0]["plan"] and 0.0 < number_of(row, "mae") < LONGEST_BAR
    ]
    panels = [name for name in CHANNELS if any(row["channel"] == name for row in drawn)]
    if not panels:
        return None
    names = dict.fromkeys(row["predictor"] for row in drawn)
    title, mosaic = f"Error against horizon, plan {drawn[0]['plan']}", [[name] for name in panels]
    size = (WIDTH, 1.75 * len(panels) + 0.2)
    fig, axes = new_figure(title, about, predictor_entries(names, styles), mosaic, size)
    for panel in panels:
        ax, (title, factor) = axes[panel], CHANNELS[panel]
        set_title(ax, title)
        for name in names:
            own = [row for row in drawn if (row["channel"], row["predictor"]) == (panel, name)]
            colour, style = styles[name]
            errors = [factor * row["mae"] for row in own]
            ax.plot([row["horizon_s"] for row in own], errors, "o", color=colour, ls=style, ms=3.5)
        ax.set_yscale("log")
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter("")
    axes[panels[-1]].set_xlabel("horizon (s)", fontsize=10)
    return fig
