"""The track of a run with its predictions, and the picture of a log."""

from __future__ import annotations

import io
import math
from collections.abc import Collection
from pathlib import Path
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
    run_label,
)
from twin.benchmark.figures.style import (
    BLACK,
    DASHED,
    GREY,
    STYLES,
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
from twin.channels import PSI, R, U, X
from twin.logs.log import Log
from twin.predictors.base import Prediction
from usv_kernel.channels import GPS_VX, GPS_VY, GYRO
from usv_kernel.files import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "picture_of_log",
    "track_figure",
]

LEFT, RIGHT = STYLES["ukf"][0], STYLES["dsw-ukf-plus"][0]

Box = tuple[tuple[float, float], tuple[float, float]]
"""Limits of north and of east, m."""


def picture_of_log(log: Log, path: Path, lost: Windows = ()) -> None:
    """Draw track, speed, yaw rate, heading and commands of a log to a PNG file.

    ``lost`` has the start and end of the times without GPS, s.
    """
    reference, fixes = reference_of(log), gps_fixes(log)
    entries: list[Entry] = [(line(BLACK), reference.label)]
    if reference.is_truth and len(fixes):
        entries.append((dots(GREY), "measured"))
    if lost_within(lost, log):
        entries.append((patch(YELLOW), "no GPS"))
    entries += [(line(LEFT), "left"), (line(RIGHT, DASHED), "right")]
    commands = [["track"]] * 4 + [["shaft"], ["angle"]]
    motion = [["speed"], ["yaw"], ["heading"]]
    fig, axes = new_figure("Run", log.name, entries, [[commands, motion]], (9.6, 6.2))
    set_title(axes["track"], "track, north up")
    _draw_track(axes["track"], reference, fixes, log, lost)
    _set_box(axes["track"], _box_of(*reference.path.T))
    set_ticks(axes["track"], 6, 5, "east (m)")

    solid: dict[str, Any] = {"color": BLACK, "lw": 1.2, "zorder": 3}
    dot: dict[str, Any] = {"color": GREY, "ls": "", "marker": ".", "ms": 2.5, "zorder": 2}
    left, right = {"color": LEFT, "lw": 1.4}, {"color": RIGHT, "lw": 1.4, "ls": DASHED}
    speed = np.hypot(log.z[:, GPS_VX], log.z[:, GPS_VY])
    curves = {
        "speed": [(reference.t[U], reference.speed, solid), (log.t, speed, dot)],
        "yaw": [(reference.t[R], np.degrees(reference.v[R]), solid)],
        "heading": [(reference.t[PSI], np.degrees(reference.v[PSI]), solid)],
        "shaft": [(log.t, log.cmd[:, 0], left), (log.t, log.cmd[:, 1], right)],
        "angle": [
            (log.t, np.degrees(log.cmd[:, 2]), left),
            (log.t, np.degrees(log.cmd[:, 3]), right),
        ],
    }
    if reference.is_truth:
        curves["yaw"].append((log.t, np.degrees(log.z[:, GYRO]), dot))
    else:
        there = np.isfinite(speed)
        curves["speed"] = [(log.t[there], speed[there], solid)]
    most = float(np.abs(log.cmd[:, :2]).max()) if len(log) else 0.0
    panels = {  # title, least range
        "speed": ("speed over ground (m/s)", 0.0),
        "yaw": ("yaw rate (deg/s)", 2.0),
        "heading": ("heading (deg)", 10.0),
        "shaft": ("shaft speed, command (rev/s)", max(0.2 * most, 0.1)),
        "angle": ("drive angle, command (deg)", 10.0),
    }
    for name, (title, least) in panels.items():
        ax = axes[name]
        set_title(ax, title)
        for t, values, look in curves[name]:
            ax.plot(t, values, **look)
        shade_lost(ax, lost)
        if len(log):
            ax.set_xlim(float(log.t[0]), float(log.t[-1]) + (len(log) < 2))
        ax.set_ylim(*limits_of([curve[1] for curve in curves[name]], least, 0.1))
        label = "time (s)" if name in ("heading", "angle") else None
        set_ticks(ax, 6, 3 if name in ("shaft", "angle") else 5, label)
    buffer = io.BytesIO()
    # no program: equal pictures are equal bytes
    fig.savefig(buffer, format="png", metadata={"Software": None}, pil_kwargs={"compress_level": 4})
    write_whole(Path(path), buffer.getvalue())


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
    shown = [name for name, figure in run.predictors.items() if figure.examples]
    entries += predictor_entries(shown, styles)

    box = _box_of(*reference.path.T)
    tall = min(max((WIDTH - 0.75) * np.ptp(box[0]) / np.ptp(box[1]), 1.8), 3.6) + 0.6
    rows = math.ceil(len(starts) / 2)
    mosaic: list[list[Any]] = [[0, 0]] * round(4.0 * tall)
    below = [[start + 1, start + 2] for start in range(0, 2 * rows, 2)]
    mosaic += [row for pair in below for row in [pair] * 9]
    if len(starts) % 2:
        mosaic = [["." if name == len(starts) + 1 else name for name in row] for row in mosaic]
    size = (WIDTH, 0.25 * len(mosaic))
    fig, axes = new_figure("Track", run_label(run), entries, mosaic, size)
    whole = axes[0]
    _draw_track(whole, reference, fixes, log, run.lost)
    set_ticks(whole, 6, 6, "east (m)")
    set_title(whole, "the whole run, north up")
    north, east = reference.path.T
    for number, start in enumerate(starts, 1):
        _draw_predictions(whole, run, start, styles, box, 1.4)
        _number_start(whole, number, reference.position(start), reference)
        ax = axes[number]
        near = (reference.t[X] >= start - 2.0) & (reference.t[X] <= start + 10.0)
        close = _box_around(north[near], east[near], examples_at(run, start).values())
        part = reference.slice(start - 5.0, start + 10.0)
        _draw_track(ax, part, gps_fixes(log.slice(start - 5.0, start + 10.0)), log, run.lost)
        _draw_predictions(ax, run, start, styles, close, 1.8)
        _set_box(ax, close)
        set_ticks(ax, 3, 4, "east (m)")
        set_title(ax, f"{number}: from t = {round(start, 1):g} s")
    _set_box(whole, box)
    return fig


def _draw_track(ax: Axes, reference: Reference, fixes: Array, log: Log, lost: Windows) -> None:
    """Draw the way of the boat, its fixes, and the parts without them."""
    path = reference.path
    for a, b in lost_within(lost, log):
        rows = (reference.t[X] >= a) & (reference.t[X] <= b)
        ax.plot(path[rows, 1], path[rows, 0], color=YELLOW, lw=8, solid_capstyle="butt", zorder=1)
    points, colour = (fixes, GREY) if reference.is_truth else (path, BLACK)
    _draw_dots(ax, points[:, ::-1], colour)
    width = 1.0 if reference.is_truth else 0.7
    ax.plot(path[:, 1], path[:, 0], color=BLACK, lw=width, zorder=3)


def _draw_dots(ax: Axes, points: Array, colour: str) -> None:
    """Draw points (n, 2) as one path of invisible steps: a marker each makes a large file."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Steps

    if len(points):
        steps = np.repeat(points, 2, axis=0)
        steps[1::2, 0] += 1e-3
        codes = np.tile([Steps.MOVETO, Steps.LINETO], len(points))
        look: dict[str, Any] = {"fill": False, "ec": colour, "lw": 1.6, "capstyle": "round"}
        ax.add_patch(PathPatch(Steps(steps, codes), **look, zorder=2))


def _draw_predictions(
    ax: Axes, run: RunFigure, start: float, styles: Styles, box: Box, width: float
) -> None:
    """Draw the predicted tracks from one time, and the place where they start."""
    for order, (name, prediction) in enumerate(examples_at(run, start).items()):
        whole = np.concatenate([prediction.start[None, :2], prediction.mean[:, :2]])
        path = _cut(whole, box)
        look: dict[str, Any] = {"color": styles[name][0], "zorder": 4 + 0.1 * order}
        ax.plot(path[:, 1], path[:, 0], ls=styles[name][1], lw=width, **look)
        if len(path) == len(whole):
            ax.plot(path[-1:, 1], path[-1:, 0], "o", ms=3, **look)
    place = reference_of(run.log).position(start)
    ax.plot(place[1:], place[:1], "o", color=BLACK, ms=4.5, zorder=6)


def _number_start(ax: Axes, number: int, place: Array, reference: Reference) -> None:
    """Write the number of an example outside of the track."""
    if not np.isfinite(place).all():
        return
    outwards = place - np.median(reference.path, axis=0)
    outwards *= 15.0 / max(float(np.hypot(*outwards)), 1e-9)
    ax.annotate(
        str(number),
        (place[1], place[0]),
        (outwards[1], outwards[0]),
        textcoords="offset points",
        fontsize=11,
        weight="bold",
        zorder=8,
        ha="center",
        va="center",
        bbox={"boxstyle": "circle,pad=0.12", "fc": "white", "ec": BLACK, "lw": 0.8},
    ).set_in_layout(False)


def _box_of(north: Array, east: Array) -> Box:
    """Return limits around positions."""
    return limits_of([north], 1.0, 0.08), limits_of([east], 1.0, 0.08)


def _set_box(ax: Axes, box: Box) -> None:
    """Show at least a box, with equal scales."""
    # with auto=True the equal scales may widen the limits
    ax.set_ylim(*box[0], auto=True)
    ax.set_xlim(*box[1], auto=True)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_ylabel("north (m)", fontsize=10)


def _box_around(north: Array, east: Array, examples: Collection[Prediction]) -> Box:
    """Return limits around true positions, and around predicted ones that are close to them."""
    if not len(north):
        return _box_of(north, east)
    margin = 0.3 * max(float(np.ptp(north)), float(np.ptp(east)), 1.0)
    shown = []
    for column, true in enumerate((north, east)):
        parts = [p.mean[:, column][np.isfinite(p.mean[:, column])] for p in examples]
        values = np.concatenate([true, *parts])
        shown.append(np.clip(values, true.min() - margin, true.max() + margin))
    return _box_of(*shown)


def _cut(path: Array, box: Box) -> Array:
    """Return a track (n, 2) up to where it is far outside of the box for the first time."""
    low, high = np.array(box).T
    far = 2.0 * (high - low).max()
    with np.errstate(invalid="ignore"):
        good = ((path > low - far) & (path < high + far)).all(axis=1)
    return path if good.all() else path[: int(np.argmin(good))]
