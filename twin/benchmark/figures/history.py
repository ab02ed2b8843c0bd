"""Curves over time: a prediction against the truth, and the parameters of a model."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from twin.benchmark.figures.data import (
    Array,
    PredictorFigure,
    Reference,
    RunFigure,
    examples_at,
    run_label,
)
from twin.benchmark.figures.style import (
    BLACK,
    DASHED,
    WIDTH,
    YELLOW,
    Entry,
    Styles,
    dots,
    limits_of,
    line,
    lost_within,
    mark_exit,
    new_figure,
    patch,
    predictor_entries,
    set_ticks,
    set_title,
    shade_lost,
)
from twin.channels import U
from twin.predictors.base import Z90, Prediction

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "parameter_figure",
    "prediction_figure",
]

WITH_INTERVAL = ("dsw-ukf-plus", "ukf")
"""The first of these that took part is shown with its prediction interval."""

PANELS = {
    3: "surge speed u (m/s)",
    4: "sway speed v (m/s)",
    5: "yaw rate r (deg/s)",
    2: "heading psi (deg)",
    0: "position north x (m)",
    1: "position east y (m)",
}
"""Titles by state, in the order of the paper's Figures 12 and 16."""


def prediction_figure(run: RunFigure, start: float, styles: Styles, reference: Reference) -> Figure:
    """Draw the predictions made at a time (s) against the truth, in six panels."""
    examples = examples_at(run, start)
    end = max([start + 10.0, *(float(p.t[-1]) for p in examples.values() if len(p.t))])
    lost = [(a, b) for a, b in run.lost if b > start and a < end]
    handle = line(BLACK, width=2.4) if reference.is_truth else dots(BLACK)
    entries: list[Entry] = [(handle, reference.label), *predictor_entries(examples, styles)]
    shaded = next((name for name in WITH_INTERVAL if name in examples), None)
    if shaded is not None:
        label = "its 90 % interval" if len(examples) < 2 else f"90 % of {shaded}"
        entries.append((patch(styles[shaded][0], 0.25), label))
    if lost:
        entries.append((patch(YELLOW), "no GPS"))
    order = list(PANELS)
    mosaic = [order[0:2], order[2:4], order[4:6]]
    title = f"Predicted at t = {round(start, 1):g} s"
    fig, axes = new_figure(title, run_label(run), entries, mosaic, (WIDTH, 4.8))

    speed = float(np.median(reference.speed)) if len(reference.v[U]) else 1.0
    least = (2 * speed, 2 * speed, 10.0, 0.25 * speed, 0.15 * speed, 3.0)
    for column, title in PANELS.items():
        ax, unit = axes[column], 180.0 / math.pi if column in (2, 5) else 1.0
        set_title(ax, title)
        t, truth = reference.within(column, start, end)
        truth = unit * truth
        if column == 2 and len(truth):
            truth -= 360.0 * round(float(truth[0]) / 360.0)
        curves = {
            name: _curve(p, column, unit, truth[0] if len(truth) else 0.0)
            for name, p in examples.items()
        }
        limits = panel_limits(truth, curves.values(), least[column])
        if reference.is_truth:
            ax.plot(t - start, truth, color=BLACK, lw=2.4, zorder=3)
        else:
            ax.plot(t - start, truth, ".", color=BLACK, ms=4, zorder=3)
        for name, curve in curves.items():
            after = np.concatenate([[0.0], examples[name].t - start])
            if name == shaded:
                widths = interval_widths(examples[name], column, unit)
                _draw_interval(ax, after, curve, widths, (limits, styles[name][0]))
            _draw_curve(ax, after, curve, limits, styles[name])
        shade_lost(ax, lost, start)
        ax.set_xlim(0.0, end - start)
        ax.set_ylim(*limits)
        set_ticks(ax, 6, 4, "time ahead (s)" if column in order[4:] else None)
    return fig


def _curve(prediction: Prediction, column: int, unit: float, near: float) -> Array:
    """Return one state of a prediction, a heading with the turns that start it near a value."""
    curve = unit * np.concatenate([prediction.start[None, column], prediction.mean[:, column]])
    if column == 2 and np.isfinite(curve[0]):
        curve -= 360.0 * np.round((curve[0] - near) / 360.0)
    return curve


def panel_limits(truth: Array, curves: Iterable[Array], least: float) -> tuple[float, float]:
    """Return limits that show the truth well, and as much of the curves as fits beside it.

    ``truth`` may be empty; ``least`` is the smallest range.
    """
    finite = [curve[np.isfinite(curve)] for curve in curves]
    if not len(truth):
        # no reference in this panel: the middle of the predictions
        values = np.concatenate([np.zeros(0), *finite])
        return limits_of([np.percentile(values, [10, 90])] if len(values) else [], least, 0.5)
    low, high = limits_of([truth], least, 0.1)
    margin = 0.75 * (high - low)
    inside = [np.clip(curve, low - margin, high + margin) for curve in finite]
    return limits_of([np.array([low, high]), *inside], 0.0, 0.03)


def interval_widths(prediction: Prediction, column: int, unit: float) -> tuple[Array, Array]:
    """Return how far the 90 % interval of one state reaches down and up, each (K + 1,)."""
    start = Z90 * math.sqrt(max(float(prediction.start_cov[column, column]), 0.0))
    mean = prediction.mean[:, column]
    with np.errstate(invalid="ignore"):
        down, up = mean - prediction.low[:, column], prediction.high[:, column] - mean
    return unit * np.concatenate([[start], down]), unit * np.concatenate([[start], up])


def _clip_far(values: Array, limits: tuple[float, float]) -> Array:
    """Return values that a drawing program can handle, still far outside of the limits."""
    low, high = limits
    far = 5.0 * (high - low)
    return np.clip(np.nan_to_num(values, nan=high + far), low - far, high + far)


def _draw_curve(
    ax: Axes, t: Array, curve: Array, limits: tuple[float, float], style: tuple[str, object]
) -> None:
    """Draw one predicted curve; an arrow head shows where it leaves the picture."""
    curve = _clip_far(curve, limits)
    ax.plot(t, curve, color=style[0], ls=style[1], lw=1.6, zorder=4)  # type: ignore[arg-type]
    mark_exit(ax, t, curve, limits, style[0])


def _draw_interval(
    ax: Axes,
    t: Array,
    curve: Array,
    widths: tuple[Array, Array],
    look: tuple[tuple[float, float], str],
) -> None:
    """Shade a prediction interval, of given limits of the panel and colour."""
    limits, colour = look
    far = 10.0 * (limits[1] - limits[0])
    curve = _clip_far(curve, limits)
    down, up = (np.clip(np.nan_to_num(width, nan=far), 0.0, far) for width in widths)
    ax.fill_between(t, curve - down, curve + up, color=colour, alpha=0.18, lw=0, zorder=1)


def parameter_figure(
    run: RunFigure, name: str, motion: str, styles: Styles, identified: float | None
) -> Figure:
    """Draw the history of the parameters of one equation, a small panel each.

    ``motion`` names the equation in the predictor's ``blocks``; ``identified`` is the time of the
    first prediction, s.
    """
    figure = run.predictors[name]
    columns = range(*figure.blocks[motion])
    t, colour = np.asarray(figure.t, dtype=np.float64), styles[name][0]
    entries: list[Entry] = [(line(colour), "estimate"), (patch(colour, 0.25), "\u00b12 sd")]
    if identified is not None:
        entries.append((line(BLACK, DASHED, 1.0), "first prediction"))
    lost = lost_within(run.lost, run.log)
    if lost:
        entries.append((patch(YELLOW), "no GPS"))
    rows = math.ceil(len(columns) / 2)
    cells = [*columns, *["."] * (2 * rows - len(columns))]
    mosaic = [cells[k : k + 2] for k in range(0, len(cells), 2)]
    title = f"{motion.capitalize()} parameters by {name}"
    size = (WIDTH, 1.4 * rows + 0.35)
    fig, axes = new_figure(title, run_label(run), entries, mosaic, size)
    for column in columns:
        ax = axes[column]
        mean, sd = (
            np.where(np.abs(part[:, column]) < 1e12, part[:, column], math.nan)
            for part in (figure.params, figure.params_sd)
        )
        power = _power(_history_limits(mean, sd))
        mean, sd = mean / 10.0**power, sd / 10.0**power
        limits = _history_limits(mean, sd)
        far = 5.0 * (limits[1] - limits[0])
        middle, low, up = (
            np.clip(y, limits[0] - far, limits[1] + far)
            for y in (mean, mean - 2.0 * sd, mean + 2.0 * sd)
        )
        set_title(ax, _parameter_title(figure, column, power))
        shade_lost(ax, lost)
        ax.fill_between(t, low, up, color=colour, alpha=0.22, lw=0, zorder=1)
        if identified is not None:
            ax.axvline(identified, color=BLACK, ls=DASHED, lw=1.0, zorder=2)
        ax.plot(t, middle, color=colour, lw=1.5, zorder=3)
        ax.set_xlim(float(t[0]), float(t[-1]) if len(t) > 1 else float(t[0]) + 1.0)
        ax.set_ylim(*limits)
        set_ticks(ax, 4, 3, "time (s)" if column + 2 > columns[-1] else None)
    return fig


def _history_limits(mean: Array, sd: Array) -> tuple[float, float]:
    """Return limits for a parameter's history; a transient or a spike may leave the picture."""
    there = np.isfinite(mean) & np.isfinite(sd)
    if not there.any():
        return -1.0, 1.0
    last = int(np.flatnonzero(there)[-1])
    typical = np.percentile(mean[there], [2, 98])
    end = 2.2 * sd[last] * np.array([-1.0, 1.0]) + mean[last]
    return limits_of([typical, end], 0.0, 0.12)


def _power(limits: tuple[float, float]) -> int:
    """Return the power of ten, a multiple of 3, that makes numbers short; 0 if they are."""
    size = max(map(abs, limits))
    return 0 if 0.1 <= size < 1e4 else 3 * math.floor(math.log10(size) / 3.0)


def _parameter_title(figure: PredictorFigure, column: int, power: int) -> str:
    """Return a parameter's name, factor and unit."""
    unit = re.sub(r"([a-z])2", "\\1\u00b2", figure.units[column])
    factor = f"1e{power} " if power else ""
    return f"{figure.names[column]} ({factor}{unit})"
