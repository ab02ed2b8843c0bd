"""Errors against the horizon, the length of a GPS loss, and the sea state."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.benchmark.figures.data import number_of, text_of
from twin.benchmark.figures.style import (
    BLACK,
    WIDTH,
    Entry,
    Styles,
    dots,
    mark_exit,
    new_figure,
    predictor_entries,
    set_ticks,
    set_title,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "TRENDS",
    "error_figure",
    "trend_figure",
]

CHANNELS = {
    "along": ("position along (m)", 1.0),
    "across": ("position across (m)", 1.0),
    "psi": ("heading (deg)", 180.0 / math.pi),
}
"""Title and factor of each panel of :func:`error_figure`."""

TRENDS: dict[str, tuple[str, str, dict[str, tuple[str, float]]]] = {
    "gps_loss_s": (
        "Error against the length of a GPS loss",
        "length of the loss (s)",
        {
            "displacement_10s": ("displacement after 10 s (m)", 1.0),
            "start_error": ("estimated position (m)", 1.0),
        },
    ),
    "sea_state": (
        "Error against the sea state",
        "sea state (WMO code 3700)",
        {
            "displacement_10s": ("displacement after 10 s (m)", 1.0),
            "psi_10s": ("heading after 10 s (deg)", 180.0 / math.pi),
        },
    ),
}
"""Title, horizontal axis, and panels (title and factor by metric) of each trend."""


def error_figure(about: str, rows: Sequence[Mapping[str, Any]], styles: Styles) -> Figure | None:
    """Draw the mean absolute error against the horizon; None where there is none.

    ``rows`` are those of the results: ``channel``, ``predictor``, ``plan``, ``horizon_s``, ``mae``,
    ``n``.
    """
    errors: dict[tuple[str, str, str], dict[float, list[tuple[float, float]]]] = {}
    for row in rows:
        value, n, horizon = (number_of(row, key) for key in ("mae", "n", "horizon_s"))
        if not (math.isnan(value) or math.isnan(horizon)):
            key = (text_of(row, "channel"), text_of(row, "predictor"), text_of(row, "plan"))
            weight = n if n > 0 else 1.0
            errors.setdefault(key, {}).setdefault(horizon, []).append((value, weight))
    panels = [channel for channel in CHANNELS if any(key[0] == channel for key in errors)]
    if not panels:
        return None
    entries: list[Entry] = predictor_entries(dict.fromkeys(key[1] for key in errors), styles)
    plans = list(dict.fromkeys(key[2] for key in errors))
    fill = {plan: "full" if k % 2 == 0 else "none" for k, plan in enumerate(plans)}
    if len(plans) > 1:
        entries += [(dots(BLACK, "o", fill[plan]), f"plan {plan}") for plan in plans]
    mosaic = [[channel] for channel in panels]
    size = (WIDTH, 1.75 * len(panels) + 0.2)
    fig, axes = new_figure("Error against horizon", about, entries, mosaic, size)
    for channel in panels:
        title, unit = CHANNELS[channel]
        curves = {
            key[1:]: {
                h: unit * sum(v * w for v, w in table[h]) / sum(w for _, w in table[h])
                for h in sorted(table)
            }
            for key, table in errors.items()
            if key[0] == channel
        }
        set_title(axes[channel], title)
        _draw_errors(axes[channel], curves, styles, fill)
        if channel != panels[-1]:
            axes[channel].set_xlabel("")
    return fig


def _draw_errors(
    ax: Axes,
    curves: Mapping[tuple[str, str], Mapping[float, float]],
    styles: Styles,
    fill: Mapping[str, Any],
) -> None:
    """Draw errors by horizon for each predictor and plan, and cut off absurd ones."""
    ends = np.array([max(curve.values()) for curve in curves.values()])
    ends = ends[np.isfinite(ends)]
    top = max(1.08 * min(ends.max(), 3.0 * np.median(ends)), 1e-6) if len(ends) else 1.0
    for (predictor, plan), curve in curves.items():
        x = np.array(list(curve))
        y = np.minimum(np.nan_to_num(list(curve.values()), nan=math.nan, posinf=10 * top), 10 * top)
        colour, style = styles[predictor]
        look: dict[str, Any] = {"marker": "o", "ms": 4, "fillstyle": fill[plan]}
        ax.plot(x, y, color=colour, ls=style, lw=1.6, **look)
        mark_exit(ax, x, y, (0.0, top), colour)
    horizons = sorted({h for curve in curves.values() for h in curve})
    set_ticks(ax, 5, 5, "horizon (s)")
    ax.set_xticks(horizons, [f"{h:g}" for h in horizons])
    ax.set_xlim(0.0, 1.05 * horizons[-1])
    ax.set_ylim(0.0, top)


def trend_figure(axis: str, rows: Sequence[Mapping[str, Any]], styles: Styles) -> Figure:
    """Draw the panels of one of :data:`TRENDS`, a line with intervals for each predictor.

    ``rows`` are those of ``results["trends"]`` of this axis.
    """
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    title, label, panels = TRENDS[axis]
    names = list(dict.fromkeys(text_of(row, "predictor") for row in rows))
    at = sorted({number_of(row, "at") for row in rows})
    about = "mean over scenarios and boats, 95 % intervals"
    mosaic = [[metric] for metric in panels]
    entries = predictor_entries(names, styles)
    fig, axes = new_figure(title, about, entries, mosaic, (WIDTH, 5.0))
    step = 0.012 * (at[-1] - at[0])
    for metric, (panel, factor) in panels.items():
        ax, ends = axes[metric], []
        set_title(ax, panel)
        for k, predictor in enumerate(names):
            points = sorted(
                [number_of(row, "at"), *(factor * number_of(row, v) for v in VALUES)]
                for row in rows
                if (text_of(row, "predictor"), text_of(row, "metric")) == (predictor, metric)
            )
            x, y, low, up = np.array(points).T
            # side by side, so that the intervals do not overlap
            x = x + step * (k - 0.5 * (len(names) - 1))
            colour, style = styles[predictor]
            ax.plot(x, y, color=colour, ls=style, lw=1.6, marker="o", ms=3.5, zorder=3)
            ax.vlines(x, low, up, color=colour, lw=1.2, zorder=2)
            ends += [y, low, up]
        values = np.concatenate(ends)
        values = values[np.isfinite(values) & (values > 0.0)]
        ax.set_yscale("log")
        ax.set_ylim(0.9 * values.min(), 1.1 * values.max())
        narrow = values.max() < 8.0 * values.min()
        parts = (1, 1.5, 2, 3, 5, 7) if narrow else (1, 2, 5)
        ax.yaxis.set_major_locator(FixedLocator([m * 10.0**p for p in range(-4, 5) for m in parts]))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        ax.yaxis.set_minor_locator(NullLocator())
        ax.set_xticks(at, [f"{v:g}" for v in at])
    ax.set_xlabel(label, fontsize=10)
    return fig


VALUES = ("value", "low", "high")
"""Keys of a trend's row, with the ends of its interval."""
