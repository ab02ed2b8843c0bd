"""Errors against the length of a GPS loss, and against the sea state."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.benchmark.figures.data import number_of, text_of
from twin.benchmark.figures.style import (
    WIDTH,
    Styles,
    new_figure,
    predictor_entries,
    set_title,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "TRENDS",
    "trend_figure",
]

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
