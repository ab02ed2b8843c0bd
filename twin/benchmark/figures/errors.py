"""Errors against the horizon: a few predictors in strong lines, the others thin, with their names.

Both axes are logarithmic. They are drawn as linear axes of the logarithms, on which what leaves
the picture is found as in every other one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.benchmark.figures.data import number_of, text_of
from twin.benchmark.figures.style import (
    BLACK,
    WIDTH,
    Array,
    Entry,
    Styles,
    dots,
    mark_exit,
    new_figure,
    predictor_entries,
    set_title,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "error_figure",
    "headline",
]

CHANNELS = {
    "along": ("position along (m)", 1.0),
    "across": ("position across (m)", 1.0),
    "psi": ("heading (deg)", 180.0 / math.pi),
}
"""Title and factor of each panel."""

HEADLINE = ("dsw-ukf-plus", "ukf", "dsw-ukf", "persistence")
"""Drawn in strong lines where there are more predictors than the eye can tell apart."""

PALE, DARK = "#A0A0A0", "#606060"
"""Lines of the other predictors, and their names."""

LONGEST = 18
"""Letters of a name at the end of a line."""

LINE = 0.15
"""Height of such a name, inch."""

Curves = Mapping[tuple[str, str], Mapping[float, float]]
"""Error by horizon, of each predictor and plan."""


def headline(names: Sequence[str]) -> list[str]:
    """Return the four predictors, or fewer, in strong lines: those of other packages first."""
    own = [name for name in names if ":" in name]
    chosen = dict.fromkeys([*own, *(name for name in HEADLINE if name in names), *names])
    return [name for name in names if name in list(chosen)[: len(HEADLINE)]]


def error_figure(about: str, rows: Sequence[Mapping[str, Any]], styles: Styles) -> Figure | None:
    """Draw the mean absolute error against the horizon; None where there is none.

    Parameters
    ----------
    about : str
        Scenario and case.
    rows : sequence of dict
        Rows of the results: ``channel``, ``predictor``, ``plan``, ``horizon_s``, ``mae``, ``n``.
    styles : dict
        From :func:`predictor_styles`.
    """
    errors: dict[tuple[str, str, str], dict[float, list[tuple[float, float]]]] = {}
    for row in rows:
        value, n, horizon = (number_of(row, key) for key in ("mae", "n", "horizon_s"))
        if horizon > 0.0 and not math.isnan(value):
            key = (text_of(row, "channel"), text_of(row, "predictor"), text_of(row, "plan"))
            weight = n if n > 0 else 1.0
            errors.setdefault(key, {}).setdefault(horizon, []).append((value, weight))
    panels = [channel for channel in CHANNELS if any(key[0] == channel for key in errors)]
    if not panels:
        return None
    names = list(dict.fromkeys(key[1] for key in errors))
    plans = list(dict.fromkeys(key[2] for key in errors))
    strong = headline(names)
    entries: list[Entry] = predictor_entries(strong, styles)
    fill = {plan: "full" if k % 2 == 0 else "none" for k, plan in enumerate(plans)}
    if len(plans) > 1:
        entries += [(dots(BLACK, "o", fill[plan]), f"plan {plan}") for plan in plans]
    high = max(1.75, 0.6 + LINE * (len(names) - len(strong)))
    size = (WIDTH, high * len(panels) + 0.2)
    fig, axes = new_figure("Error against horizon", about, entries, [[c] for c in panels], size)
    for channel in panels:
        title, unit = CHANNELS[channel]
        curves = {
            key[1:]: {
                h: unit * sum(v * w for v, w in table[h]) / sum(part[1] for part in table[h])
                for h in sorted(table)
            }
            for key, table in errors.items()
            # the thin lines are those of the first plan: of all plans they would be too many
            if key[0] == channel and (key[1] in strong or key[2] == plans[0])
        }
        set_title(axes[channel], title)
        ends = _draw_errors(axes[channel], curves, {name: styles[name] for name in strong}, fill)
        _label_ends(axes[channel], ends, LINE / (high - 0.5))
        if channel == panels[-1]:
            axes[channel].set_xlabel("horizon (s)", fontsize=10)
    return fig


def _draw_errors(
    ax: Axes, curves: Curves, styles: Styles, fill: Mapping[str, Any]
) -> dict[str, float]:
    """Draw errors by horizon, and cut off absurd ones; return where the thin lines end (0 to 1)."""
    low, high = _limits([_log10(list(curve.values())) for curve in curves.values()])
    ends = {}
    for (predictor, plan), curve in curves.items():
        x = np.log10(list(curve))
        # a point far outside is as good as one at infinity, and can be drawn
        y = np.clip(_log10(list(curve.values())), low - 1.0, high + 1.0)
        strong = predictor in styles
        colour, style = styles.get(predictor, (PALE, "-"))
        width = 0.8 if not strong else 1.8 if fill[plan] == "full" else 1.2
        look: dict[str, Any] = {"marker": "o", "ms": 4.5 if strong else 2.5, "lw": width}
        ax.plot(x, y, color=colour, ls=style, fillstyle=fill[plan], zorder=2 + strong, **look)
        mark_exit(ax, x, y, (low, high), colour)
        if not strong and len(y):
            ends[predictor] = float(np.clip((y[-1] - low) / (high - low), 0.0, 1.0))
    horizons = sorted({h for curve in curves.values() for h in curve})
    first, last = math.log10(horizons[0]), math.log10(horizons[-1])
    margin = 0.04 * max(last - first, 0.1)
    ax.set_xticks(np.log10(horizons), [f"{h:g}" for h in horizons])
    ax.set_xlim(first - margin, last + margin)
    parts = (1, 2, 5) if high - low < 2.2 else (1,)
    marks = [m * 10.0**p for p in range(math.floor(low), math.ceil(high) + 1) for m in parts]
    marks = [mark for mark in marks if low <= math.log10(mark) <= high]
    ax.set_yticks(np.log10(marks), [f"{mark:g}" for mark in marks])
    ax.set_ylim(low, high)
    return ends


def _log10(values: Sequence[float]) -> Array:
    """Return logarithms; minus infinity where there is no error."""
    with np.errstate(divide="ignore"):
        return np.log10(np.asarray(values, dtype=np.float64))


def _limits(curves: Sequence[Array]) -> tuple[float, float]:
    """Return the limits of curves of logarithms: at most three decades, and no absurd error."""
    values, largest = np.concatenate(curves), np.array([curve.max() for curve in curves])
    values, largest = values[np.isfinite(values)], largest[np.isfinite(largest)]
    if not len(largest):
        return -1.0, 0.0
    high = min(float(largest.max()), float(np.median(largest)) + 2.0) + 0.06
    return min(max(float(values.min()) - 0.07, high - 3.0), high - 0.7), high


def _label_ends(ax: Axes, ends: Mapping[str, float], gap: float) -> None:
    """Write names at the right of a panel, as close to the ends of their lines as they fit."""
    low = 0.0
    right = ax.get_xlim()[1]
    wide = right - ax.get_xlim()[0]
    across = ax.get_xaxis_transform()
    for k, name in enumerate(sorted(ends, key=lambda name: ends[name])):
        # a place is left for those above
        height = max(low, min(ends[name], 1.0 - gap * (len(ends) - 1 - k)))
        low = height + gap
        x, y = [ax.get_xticks()[-1], right, right + 0.02 * wide], [ends[name], height, height]
        ax.plot(x, y, color=PALE, lw=0.6, transform=across, clip_on=False, zorder=1)
        label = name if len(name) <= LONGEST else f"{name[: LONGEST - 3]}..."
        look: dict[str, Any] = {"va": "center", "fontsize": 9, "color": DARK}
        ax.text(right + 0.03 * wide, height, label, transform=across, parse_math=False, **look)
