"""Roll, pitch, heave and deck speed of a run, beside what was forecast for each moment."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from twin.benchmark.figures.data import RunFigure, run_label
from twin.benchmark.figures.style import (
    BLACK,
    WIDTH,
    Entry,
    limits_of,
    line,
    new_figure,
    patch,
    set_ticks,
    set_title,
)
from twin.predictors.base import Z90

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["SHOWN_AHEAD", "deck_figure"]

SHOWN_AHEAD = 2.0
"""The picture shows what was forecast so long before, s."""

SHOWN = 40.0
"""Length of the picture, s."""

COLOUR = "#D55E00"

PANELS = (
    ("roll (deg)", 180.0 / math.pi),
    ("pitch (deg)", 180.0 / math.pi),
    ("heave, down (m)", 1.0),
    ("vertical speed of the deck point, down (m/s)", 1.0),
)


def deck_figure(run: RunFigure, name: str) -> Figure | None:
    """Draw the true motion, and the forecasts of a predictor's twin; None where there are none."""
    deck = run.predictors[name].deck
    if deck is None or not len(deck.t):
        return None
    begin = float(deck.t[0])
    end = min(float(deck.t[-1]), begin + SHOWN)
    entries: list[Entry] = [
        (line(BLACK, width=2.0), "true"),
        (line(COLOUR), f"forecast {SHOWN_AHEAD:g} s before"),
        (patch(COLOUR, 0.25), "its 90 % interval"),
    ]
    mosaic = [[k] for k in range(len(PANELS))]
    title = f"Motion on the waves, forecast {SHOWN_AHEAD:g} s ahead"
    fig, axes = new_figure(title, run_label(run), entries, mosaic, (WIDTH, 6.4))
    for k, (text, unit) in enumerate(PANELS):
        ax, rows = axes[k], (deck.t >= begin) & (deck.t <= end)
        t, mean, half = deck.t[rows], unit * deck.mean[rows, k], unit * Z90 * deck.sd[rows, k]
        truth = unit * deck.truth[rows, k]
        set_title(ax, text)
        ax.fill_between(t, mean - half, mean + half, color=COLOUR, alpha=0.25, lw=0, zorder=1)
        ax.plot(t, truth, color=BLACK, lw=2.0, zorder=3)
        ax.plot(t, mean, color=COLOUR, lw=1.5, zorder=4)
        ax.set_xlim(begin, end)
        ax.set_ylim(*limits_of([truth, mean - half, mean + half], 1e-3, 0.05))
        set_ticks(ax, 8, 4, "time (s)" if k == len(PANELS) - 1 else None)
    return fig
