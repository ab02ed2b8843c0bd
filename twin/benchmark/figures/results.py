"""Pictures of results: errors after 10 s as bars, errors against the horizon."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.benchmark.figures.data import number_of
from twin.benchmark.figures.style import (
    BLACK,
    WIDTH,
    Entry,
    Styles,
    new_figure,
    patch,
    predictor_entries,
    set_title,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["error_figure", "verdict_figure"]

ERRORS = {"position_m": "position after 10 s (m)", "heading_deg": "heading after 10 s (deg)"}
"""Title of each panel of the bars."""

LOSSES = {"none": ("without a loss", 0.95), "any": ("with a loss", 0.45)}
"""Label and opacity of the bars."""

LONGEST_BAR = 1e6
"""Longer bars cannot be drawn."""

CHANNELS = {
    "along": ("position along (m)", 1.0),
    "across": ("position across (m)", 1.0),
    "psi": ("heading (deg)", 180.0 / math.pi),
}
"""Title and factor of each panel of the error against the horizon."""

Row = Mapping[str, Any]


# bars
def verdict_figure(rows: Sequence[Row], styles: Styles) -> Figure:
    """Draw the mean absolute errors with 95 % intervals over boats, the best predictor on top.

    ``rows`` are those of ``results["verdict"]``. The panels show persistence in full, and cut what
    is longer.
    """
    names = list(dict.fromkeys(row["predictor"] for row in rows))
    of = {(row["predictor"], row["loss"]): row for row in rows}
    losses = [loss for loss in LOSSES if any(row["loss"] == loss for row in rows)]
    entries = [(patch(BLACK, LOSSES[loss][1]), LOSSES[loss][0]) for loss in losses]
    about, mosaic = "mean over scenarios and boats, 95 % intervals", [[panel] for panel in ERRORS]
    size = (WIDTH, 2.0 * (0.3 * len(names) + 0.7))
    fig, axes = new_figure("Errors after 10 s", about, entries, mosaic, size)
    for panel, title in ERRORS.items():
        ax = axes[panel]
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
            ax.bar_label(bars, [f"{v:#.3g}".rstrip(".") for v in value], padding=3, fontsize=9)
        ax.set_ylim(len(names), -0.2)
        ax.set_xlim(0.0, _limit(rows, panel))
        ax.set_yticks(np.arange(len(names)) + 0.4, names, parse_math=False)
        ax.grid(False, axis="y")
    return fig


def _limit(rows: Sequence[Row], panel: str) -> float:
    """Return the end of the axis: persistence, or the largest error without it."""
    base = [row for row in rows if row["predictor"] == "persistence"]
    ends = [number_of(row, f"{panel}{end}") for row in base or rows for end in ("", "_high")]
    return 1.2 * max([end for end in ends if 0.0 < end < LONGEST_BAR], default=1.0)


# errors against the horizon
def error_figure(about: str, rows: Sequence[Row], styles: Styles) -> Figure | None:
    """Draw the mean absolute error against the horizon; None where there is none.

    Parameters
    ----------
    about : str
        Scenario and case.
    rows : sequence of dict
        Rows of the results, of which the first plan is drawn: ``channel``, ``predictor``, ``plan``,
        ``horizon_s``, ``mae``.
    styles : dict
        From :func:`twin.benchmark.figures.predictor_styles`.
    """
    plan = rows[0]["plan"] if rows else ""
    errors: dict[str, dict[str, dict[float, list[float]]]] = {}
    for row in rows:
        if row["plan"] == plan and 0.0 < number_of(row, "mae") < 1e9:
            curves = errors.setdefault(row["channel"], {}).setdefault(row["predictor"], {})
            curves.setdefault(row["horizon_s"], []).append(row["mae"])
    panels = [channel for channel in CHANNELS if channel in errors]
    if not panels:
        return None
    names = dict.fromkeys(name for channel in panels for name in errors[channel])
    entries: list[Entry] = predictor_entries(names, styles)
    size = (WIDTH, 1.75 * len(panels) + 0.2)
    title, mosaic = f"Error against horizon, plan {plan}", [[channel] for channel in panels]
    fig, axes = new_figure(title, about, entries, mosaic, size)
    for channel in panels:
        (title, unit), ax = CHANNELS[channel], axes[channel]
        set_title(ax, title)
        ends = []
        for name, curve in errors[channel].items():
            horizons = sorted(curve)
            values = [unit * float(np.mean(curve[horizon])) for horizon in horizons]
            colour, style = styles[name]
            ax.plot(horizons, values, color=colour, ls=style, marker="o", ms=3.5, lw=1.6)
            ends.append(max(values))
        _set_logarithmic(ax, sorted({h for curve in errors[channel].values() for h in curve}), ends)
        if channel == panels[-1]:
            ax.set_xlabel("horizon (s)", fontsize=10)
    return fig


def _set_logarithmic(ax: Axes, horizons: Sequence[float], ends: Sequence[float]) -> None:
    """Make both axes logarithmic; what is a hundred times the median of the ends is cut."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    ax.set_xscale("log")
    ax.set_xticks(horizons, [f"{h:g}" for h in horizons])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_yscale("log")
    top = 1.2 * min(max(ends), 100.0 * float(np.median(ends)))
    ax.set_ylim(max(ax.get_ylim()[0], 1e-4 * top), top)
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())
