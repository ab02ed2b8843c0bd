"""Motion of the deck beside what was forecast for each moment, and the odds of a quiet deck."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.benchmark.figures.data import RunFigure, run_label
from twin.benchmark.figures.style import (
    BLACK,
    WIDTH,
    Entry,
    dots,
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

__all__ = ["SHOWN_AHEAD", "deck_figure", "reliability_figure"]

SHOWN_AHEAD = 2.0
"""The picture shows what was forecast so long before, s."""

SHOWN = 40.0
"""Length of the picture, s."""

COLOUR = "#D55E00"

SPANS = ("#0072B2", "o", "-"), ("#D55E00", "s", "--"), ("#009E73", "^", ":")
"""Colour, marker and line of each span of a quiet deck."""

FEW = 20
"""A share of fewer spells is not drawn."""

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


def reliability_figure(rows: Sequence[Mapping[str, Any]]) -> Figure | None:
    """Draw how often the deck was quiet against the probability that was given for it.

    Parameters
    ----------
    rows : sequence of dict
        Rows of the results: ``span_s`` and ``reliability``, pooled here over all cells.
    """
    pooled: dict[float, dict[int, list[Any]]] = {}
    for row in rows:
        for part in row["reliability"]:
            tenth = min(int(10.0 * part[0]), 9)
            pooled.setdefault(row["span_s"], {}).setdefault(tenth, []).append(part)
    entries: list[Entry] = [(line(BLACK, width=1.0), "calibrated")]
    curves = []
    for (span, tenths), (colour, marker, style) in zip(pooled.items(), SPANS, strict=False):
        parts = [np.array(tenths[k], dtype=np.float64) for k in sorted(tenths)]
        kept = [
            np.average(part[:, :2], axis=0, weights=part[:, 2])
            for part in parts
            if part[:, 2].sum() >= FEW
        ]
        if kept:
            entries.append((dots(colour, marker), f"next {span:g} s"))
            curves.append((100.0 * np.array(kept), colour, marker, style))
    if not curves:
        return None
    about = f"each dot: {FEW} forecasts or more, a tenth of probability"
    fig, axes = new_figure("Quiet deck", about, entries, [[0]], (WIDTH, 3.6))
    ax = axes[0]
    ax.plot([0.0, 100.0], [0.0, 100.0], color=BLACK, lw=1.0, zorder=1)
    for points, colour, marker, style in curves:
        ax.plot(*points.T, color=colour, marker=marker, ls=style, lw=1.5, ms=5, zorder=3)
    set_title(ax, "spells that were quiet (%)")
    ax.set_xlim(-3.0, 103.0)
    ax.set_ylim(-3.0, 103.0)
    set_ticks(ax, 6, 6, "probability that was given (%)")
    return fig
