"""Pictures of a single run: its track, and a forecast."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.benchmark.figures.data import (
    Array,
    Reference,
    RunFigure,
    example_times,
    examples_at,
    gps_fixes,
    reference_of,
)
from twin.benchmark.figures.style import (
    BLACK,
    GREY,
    WIDTH,
    YELLOW,
    Entry,
    Styles,
    Windows,
    dots,
    limits_of,
    line,
    lost_within,
    new_figure,
    patch,
    predictor_entries,
    set_ticks,
    set_title,
    shade_lost,
)
from twin.channels import PSI, R, U, V, X, Y
from twin.logs.log import Log
from twin.predictors.base import Z90, Prediction

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["panel_limits", "prediction_figure", "track_figure"]

POINTS_MAX = 100
"""Of more GPS fixes in a panel, about so many are drawn."""

WITH_INTERVAL = ("dsw-ukf-plus", "ukf")
"""The first of these that took part is shown with its prediction interval."""

STATES = {
    U: "surge speed u (m/s)",
    V: "sway speed v (m/s)",
    R: "yaw rate r (deg/s)",
    PSI: "heading psi (deg)",
    X: "position north x (m)",
    Y: "position east y (m)",
}
"""Titles by state, in the order of Figures 12 and 16 of Qu et al. 2025."""

Limits = tuple[float, float]


# the track
def track_figure(run: RunFigure, styles: Styles) -> Figure:
    """Draw the whole track, and below it the 10 s after each example's start."""
    log, reference, fixes = run.log, reference_of(run.log), gps_fixes(run.log)
    starts = example_times(run)
    entries: list[Entry] = [(line(BLACK), f"{reference.label} track")]
    if reference.is_truth and len(fixes):
        entries.append((dots(GREY), "GPS fixes"))
    if lost_within(run.lost, log):
        entries.append((patch(YELLOW), "stretch without GPS"))
    if starts:
        entries.append((dots(BLACK, "o"), "predictions start"))
    shown = [name for name, examples in run.examples.items() if examples]
    entries += predictor_entries(shown, styles)

    rows: list[list[Any]] = [[0, 0]]
    rows += [[k, k + 1 if k < len(starts) else "."] for k in range(1, len(starts) + 1, 2)]
    size = (WIDTH, 3.6 + 2.3 * (len(rows) - 1))
    fig, axes = new_figure("Track", run.label, entries, rows, size)
    _draw_track(axes[0], reference, fixes, log, run.lost)
    set_ticks(axes[0], 6, 6, "east (m)")
    set_title(axes[0], "the whole run, north up")
    for number, start in enumerate(starts, 1):
        _draw_predictions(axes[0], run, start, styles, reference)
        x, y = reference.position(start)
        if np.isfinite([x, y]).all():
            place: dict[str, Any] = {"xytext": (8, 4), "textcoords": "offset points"}
            mark = axes[0].annotate(str(number), (y, x), weight="bold", **place)
            mark.set_in_layout(False)
        ax = axes[number]
        part = log.slice(start - 2.0, start + 10.0)
        near = reference_of(part)
        _draw_track(ax, near, gps_fixes(part), log, run.lost)
        _draw_predictions(ax, run, start, styles, reference)
        _set_box(ax, *_box_around(near.path, 0.15))
        set_ticks(ax, 3, 4, "east (m)")
        set_title(ax, f"{number}: from t = {round(start, 1):g} s")
    _set_box(axes[0], *_box_around(reference.path, 0.08))
    return fig


def _draw_track(ax: Axes, reference: Reference, fixes: Array, log: Log, lost: Windows) -> None:
    """Draw the way of the boat, its fixes, and the parts without them."""
    path = reference.path
    for a, b in lost_within(lost, log):
        rows = (reference.t[X] >= a) & (reference.t[X] <= b)
        ax.plot(path[rows, 1], path[rows, 0], color=YELLOW, lw=8, solid_capstyle="butt", zorder=1)
    if reference.is_truth:
        few = fixes[:: 1 + len(fixes) // POINTS_MAX]
        ax.plot(few[:, 1], few[:, 0], color=GREY, ls="", marker=".", ms=2.5, zorder=2)
    ax.plot(path[:, 1], path[:, 0], color=BLACK, lw=1.0, zorder=3)


def _draw_predictions(
    ax: Axes, run: RunFigure, start: float, styles: Styles, reference: Reference
) -> None:
    """Draw the predicted tracks from one time, and the place where they start."""
    for name, prediction in examples_at(run, start).items():
        path = np.concatenate([prediction.start[None, :2], prediction.mean[:, :2]])
        path[np.abs(path) > 1e9] = math.nan  # such numbers cannot be drawn
        colour, style = styles[name]
        ax.plot(path[:, 1], path[:, 0], color=colour, ls=style, lw=1.6, zorder=4)
    place = reference.position(start)
    ax.plot(place[1:], place[:1], "o", color=BLACK, ms=4.5, zorder=6)


def _set_box(ax: Axes, north: Limits, east: Limits) -> None:
    """Show at least these limits, with equal scales."""
    # with auto=True the equal scales may widen the limits
    ax.set_ylim(*north, auto=True)
    ax.set_xlim(*east, auto=True)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_ylabel("north (m)", fontsize=10)


def _box_around(path: Array, margin: float) -> tuple[Limits, Limits]:
    """Return limits north and east around a path (n, 2), with a margin as a share of its size."""
    return limits_of([path[:, 0]], 1.0, margin), limits_of([path[:, 1]], 1.0, margin)


# a forecast
def prediction_figure(run: RunFigure, start: float, styles: Styles, reference: Reference) -> Figure:
    """Draw the predictions made at a time (s) against the truth, in six panels."""
    examples = examples_at(run, start)
    end = max([start + 10.0, *(float(p.t[-1]) for p in examples.values() if len(p.t))])
    lost = [(a, b) for a, b in run.lost if b > start and a < end]
    handle = line(BLACK, width=2.4) if reference.is_truth else dots(BLACK)
    entries: list[Entry] = [(handle, reference.label), *predictor_entries(examples, styles)]
    shaded = next((name for name in WITH_INTERVAL if name in examples), None)
    if shaded is not None:
        entries.append((patch(styles[shaded][0], 0.25), f"90 % of {shaded}"))
    if lost:
        entries.append((patch(YELLOW), "no GPS"))
    order = list(STATES)
    mosaic = [order[0:2], order[2:4], order[4:6]]
    title = f"Predicted at t = {round(start, 1):g} s"
    fig, axes = new_figure(title, run.label, entries, mosaic, (WIDTH, 4.8))
    speed = float(np.median(reference.speed)) if len(reference.v[U]) else 1.0
    least = {X: 2 * speed, Y: 2 * speed, PSI: 10.0, U: 0.25 * speed, V: 0.15 * speed, R: 3.0}
    for column, title in STATES.items():
        ax, unit = axes[column], 180.0 / math.pi if column in (PSI, R) else 1.0
        set_title(ax, title)
        t, truth = reference.within(column, start, end)
        truth = unit * truth
        curves = {}
        for name, prediction in examples.items():
            curve = unit * np.concatenate([prediction.start[None], prediction.mean])[:, column]
            turns = 0.0
            if column == PSI and len(truth) and np.isfinite(curve[0]):
                turns = 360.0 * round((curve[0] - truth[0]) / 360.0)
            curves[name] = curve = curve - turns
            after = np.concatenate([[start], prediction.t]) - start
            colour, style = styles[name]
            ax.plot(after, _drawable(curve), color=colour, ls=style, lw=1.6, zorder=4)
            if name == shaded:
                low, high = (unit * part - turns for part in _interval(prediction, column))
                low, high = _drawable(low), _drawable(high)
                ax.fill_between(after, low, high, color=colour, alpha=0.18, lw=0, zorder=1)
        look: dict[str, Any] = {"lw": 2.4} if reference.is_truth else {"ls": "", "marker": "."}
        ax.plot(t - start, truth, color=BLACK, zorder=3, **look)
        shade_lost(ax, lost, start)
        ax.set_xlim(0.0, end - start)
        ax.set_ylim(*panel_limits(truth, curves.values(), least[column]))
        set_ticks(ax, 6, 4, "time ahead (s)" if column in order[4:] else None)
    return fig


def panel_limits(truth: Array, curves: Iterable[Array], least: float) -> Limits:
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


def _interval(prediction: Prediction, column: int) -> tuple[Array, Array]:
    """Return the ends (K + 1,) of the 90 % interval of one state, from the start on."""
    start = prediction.start[column]
    half = Z90 * math.sqrt(max(float(prediction.start_cov[column, column]), 0.0))
    low = np.concatenate([[start - half], prediction.low[:, column]])
    return low, np.concatenate([[start + half], prediction.high[:, column]])


def _drawable(values: Array) -> Array:
    """Return values without numbers that cannot be drawn."""
    return np.where(np.abs(values) < 1e9, values, math.nan)
