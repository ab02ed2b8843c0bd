"""The pictures of a benchmark, and of a log.

Nothing here computes a result; it only draws what ``twin.benchmark.runner`` hands over. matplotlib is
imported when the first picture is drawn, and never through pyplot, so that neither an import
nor a picture changes anything for the caller.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twin.channels import MEASUREMENTS
from twin.logs.log import Log
from twin.predictors.base import Z90, Prediction

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "PredictorFigure",
    "RunFigure",
    "error_figure",
    "looks_of",
    "parameter_figure",
    "picture_of_log",
    "prediction_figure",
    "track_figure",
    "trend_figure",
]

Array = NDArray[np.float64]

Windows = Sequence[tuple[float, float]]

Looks = Mapping[str, tuple[str, Any]]
"""Colour and style of the line of each predictor."""

BANDED = ("dsw-ukf-plus", "ukf")
"""The first of these that took part is shown with its band."""

DPI = 130

WIDTH = 4.6
"""Width of a picture in the report, inch: letters of 10 pt are 11 pixels high on a phone."""

# Okabe and Ito's colours, which can be told apart with any kind of colour vision; the styles
# tell lines apart where there are none.
BLACK, GREY, YELLOW = "#000000", "#808080", "#F0E442"

LOOKS: dict[str, tuple[str, Any]] = {
    "persistence": ("#E69F00", (0, (1.2, 1.2))),
    "persistence-8s": ("#56B4E9", (0, (4, 1.5))),
    "ukf": ("#0072B2", (0, (5, 1.2, 1.2, 1.2))),
    "dsw-ukf": ("#009E73", (0, (8, 2))),
    "lstm": ("#CC79A7", (0, (3, 1, 1, 1, 1, 1))),
    "dsw-ukf-plus": ("#D55E00", "-"),
    "oracle": (GREY, (0, (1, 2.5))),
}

# of other predictors: from Tol's muted scheme, for the same readers
SPARE = ("#882255", "#999933", "#332288", "#44AA99", "#661100")

STYLES: tuple[Any, ...] = (
    (0, (2.5, 1)),
    (0, (6, 1, 2, 1)),
    (0, (10, 2, 2, 2)),
    (0, (5, 1, 1, 1, 1, 1, 1, 1)),
    (0, (2, 2.5)),
)

DASHED = (0, (4, 1.5))

LEFT, RIGHT = LOOKS["ukf"][0], LOOKS["dsw-ukf-plus"][0]

PANELS = (
    (3, "surge speed u (m/s)"),
    (4, "sway speed v (m/s)"),
    (5, "yaw rate r (deg/s)"),
    (2, "heading psi (deg)"),
    (0, "position north x (m)"),
    (1, "position east y (m)"),
)
"""Column of a state and title, in the order of the paper's Figures 12 and 16."""


@dataclass(frozen=True)
class PredictorFigure:
    """What the pictures show of one predictor on one run.

    Parameters
    ----------
    examples : list of Prediction
        At most three, made at the same origins by all predictors.
    t : ndarray, shape (M,)
        Times of the parameter history, s.
    params, params_sd : ndarray, shape (M, p)
        Model parameters and their standard deviations; no columns where there is no model.
    names, units : tuple of str
        Of the p parameters.
    blocks : dict of str to tuple of int
        First and last + 1 parameter of the equation of each motion.
    """

    examples: list[Prediction]
    t: Array
    params: Array
    params_sd: Array
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    blocks: dict[str, tuple[int, int]] = field(default_factory=dict)


@dataclass(frozen=True)
class RunFigure:
    """What the pictures show of one run.

    Parameters
    ----------
    scenario, fault : str
        As in the rows of the results.
    seed : int
        Seed of the run.
    log : Log
        The run; without truth, the measurements stand in for it.
    lost : list of tuple of float
        Start and end of the times without GPS, s.
    predictors : dict of str to PredictorFigure
        By name, in the order of the legends.
    """

    scenario: str
    fault: str
    seed: int
    log: Log
    lost: list[tuple[float, float]]
    predictors: dict[str, PredictorFigure]


def picture_of_log(log: Log, path: Path, lost: Windows = ()) -> None:
    """Draw track, speed, yaw rate, heading and commands of a log.

    Parameters
    ----------
    log : Log
        The run.
    path : Path
        PNG file to create or replace.
    lost : sequence of tuple of float
        Start and end of the times without GPS, s.
    """
    seen = reference_of(log)
    labels: list[tuple[Any, str]] = [(_line(BLACK), seen.label)]
    fixes = _fixes(log)
    if seen.known and len(fixes):
        labels.append((_dots(GREY), "measured"))
    if _inside(lost, log):
        labels.append((_patch(YELLOW), "no GPS"))
    labels += [
        (_line(LEFT), "left"),
        (_line(RIGHT, DASHED), "right"),
    ]

    # left: the track over the commands; right: what the boat did. Lengths in inches.
    across, wide, low, gap, foot = 9.6, 3.85, 0.8, 0.42, 0.5
    south, top = _span([seen.path[:, 0]], 1.0, 0.08)
    west, right = _span([seen.path[:, 1]], 1.0, 0.08)
    tall = min(max(wide * (top - south) / (right - west), 2.0), 4.4)
    below = foot + 2 * low + gap + 0.8
    header = _header_height(labels, across)
    fig = _figure(across, header + tall + below)
    _header(fig, "Run", log.name, labels)
    track = _axes(fig, 0.75, below, wide, tall)
    _title(track, "track, north up")
    _draw_track(track, seen, fixes, log, lost)
    _set_box(track, *_box(seen.path[:, 0], seen.path[:, 1], tall / wide))
    _few_ticks(track, 6, 5)

    speed = np.hypot(log.z[:, 2], log.z[:, 3])
    panels: list[tuple[str, list[tuple[Array, Array, dict[str, Any]]]]] = [
        ("speed over ground (m/s)", []),
        ("yaw rate (deg/s)", []),
        ("heading (deg)", []),
        ("shaft speed, command (rev/s)", []),
        ("drive angle, command (deg)", []),
    ]
    line: dict[str, Any] = {"color": BLACK, "lw": 1.2, "zorder": 3}
    dot: dict[str, Any] = {"color": GREY, "ls": "", "marker": ".", "ms": 2.5, "zorder": 2}
    gyro = MEASUREMENTS.index("gyro_radps")
    if seen.known:
        panels[0][1].append((seen.t[3], _speed(seen), line))
        panels[0][1].append((log.t, speed, dot))
        panels[1][1].append((log.t, np.degrees(log.z[:, gyro]), dot))
        panels[1][1].append((seen.t[5], np.degrees(seen.v[5]), line))
    else:
        shown = np.isfinite(speed)
        panels[0][1].append((log.t[shown], speed[shown], line))
        panels[1][1].append((seen.t[5], np.degrees(seen.v[5]), line))
    panels[2][1].append((seen.t[2], np.degrees(seen.v[2]), line))
    for index, unit in ((0, 1.0), (2, 180.0 / math.pi)):
        for side, (colour, style) in enumerate(((LEFT, "-"), (RIGHT, DASHED))):
            look: dict[str, Any] = {"color": colour, "ls": style, "lw": 1.4}
            panels[3 + index // 2][1].append((log.t, unit * log.cmd[:, index + side], look))
    high = (tall + below - foot - 2 * gap) / 3
    places = [(5.4, foot + (2 - k) * (high + gap), high) for k in range(3)]
    places += [(0.75, foot + (1 - k) * (low + gap), low) for k in range(2)]
    most = float(np.abs(log.cmd[:, :2]).max()) if len(log) else 0.0
    least = (0.0, 2.0, 10.0, max(0.2 * most, 0.1), 10.0)
    for row, (title, lines) in enumerate(panels):
        left, bottom, height = places[row]
        ax = _axes(fig, left, bottom, 4.0 if row < 3 else wide, height)
        _title(ax, title)
        for t, values, look in lines:
            ax.plot(t, values, **look)
        _shade(ax, lost)
        if len(log):
            ax.set_xlim(float(log.t[0]), float(log.t[-1]) + (len(log) < 2))
        ax.set_ylim(*_span([values for _, values, _ in lines], least[row], 0.1))
        _few_ticks(ax, 6, 3 if row > 2 else 5)
        if row in (2, 4):
            _xlabel(ax, "time (s)")
        else:
            ax.tick_params(labelbottom=False)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    buffer = io.BytesIO()
    # no program: equal pictures are equal bytes
    fig.savefig(buffer, format="png", metadata={"Software": None}, pil_kwargs={"compress_level": 4})
    path.write_bytes(buffer.getvalue())


# what was really the case, or what was measured instead
@dataclass(frozen=True)
class Reference:
    """What the predictions are compared with: each column of a state with its own times."""

    known: bool
    t: list[Array]
    v: list[Array]

    @property
    def label(self) -> str:
        return "true" if self.known else "measured"

    @property
    def path(self) -> Array:
        """Positions (n, 2) north and east, at the times ``t[0]``."""
        return np.stack([self.v[0], self.v[1]], axis=1)

    def within(self, column: int, t0: float, t1: float) -> tuple[Array, Array]:
        """Return times and values of one column between two times."""
        t = self.t[column]
        rows = (t >= t0 - 1e-9) & (t <= t1 + 1e-9)
        return t[rows], self.v[column][rows]


def reference_of(log: Log) -> Reference:
    """Return the truth of a log, or what its sensors say in its place."""
    if log.truth is not None and np.isfinite(log.truth[:, :2]).all(axis=1).any():
        columns = log.truth
    else:
        columns = _measured(log)
    times, values = [], []
    both = np.isfinite(columns[:, :2]).all(axis=1)
    for j in range(6):
        there = both if j < 2 else np.isfinite(columns[:, j])
        times.append(log.t[there])
        column = columns[there, j]
        values.append(np.unwrap(column) if j == 2 and len(column) else column)
    return Reference(columns is log.truth, times, values)


def _measured(log: Log) -> Array:
    """Return states (N, 6) as far as the sensors give them; NaN elsewhere."""
    out = np.full((len(log), 6), math.nan)
    out[:, :2] = log.z[:, :2]
    out[:, 2] = log.z[:, 4]
    out[:, 5] = log.z[:, 5]
    there = np.isfinite(out[:, 2])
    if there.sum() < 2:
        return out
    t, psi = log.t[there], np.unwrap(out[there, 2])
    heading = np.interp(log.t, t, psi)
    c, s = np.cos(heading), np.sin(heading)
    out[:, 3] = log.z[:, 2] * c + log.z[:, 3] * s
    out[:, 4] = log.z[:, 3] * c - log.z[:, 2] * s
    if not np.isfinite(out[:, 5]).any():
        # no gyro: the slope of the heading over one second, short enough for a boat's turn
        late, early = np.minimum(log.t + 0.5, t[-1]), np.maximum(log.t - 0.5, t[0])
        turned = np.interp(late, t, psi) - np.interp(early, t, psi)
        out[:, 5] = turned / np.maximum(late - early, 1e-9)
    return out


def _fixes(log: Log) -> Array:
    """Return the positions (n, 2) of all GPS fixes."""
    fixes = log.z[:, :2]
    return fixes[np.isfinite(fixes).all(axis=1)]


def _speed(seen: Reference) -> Array:
    """Return the speed over ground, m/s, at the times of the surge speed."""
    return np.hypot(
        seen.v[3], np.interp(seen.t[3], seen.t[4], seen.v[4]) if len(seen.t[4]) else 0.0
    )


def _inside(lost: Windows, log: Log) -> list[tuple[float, float]]:
    """Return the times without GPS that fall into a log."""
    return [(a, b) for a, b in lost if len(log) and b > log.t[0] and a < log.t[-1]]


# pieces of pictures
def _title(ax: Axes, text: str) -> None:
    """Write a title at a fixed place: looking for a free one takes a third of all time."""
    ax.set_title(text, loc="left", fontsize=10, pad=5, y=1.0, parse_math=False)


def _xlabel(ax: Axes, text: str) -> None:
    """Write the label of the horizontal axis, at a fixed place too."""
    ax.set_xlabel(text, fontsize=10)
    ax.xaxis.set_label_coords(0.5, -0.24 * DPI / ax.bbox.height)


def _ylabel(ax: Axes, text: str) -> None:
    """Write the label of the vertical axis, at a fixed place too."""
    ax.set_ylabel(text, fontsize=10)
    ax.yaxis.set_label_coords(-0.46 * DPI / ax.bbox.width, 0.5)


def _figure(width: float, height: float) -> Figure:
    """Return an empty picture of a size in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    fig = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    FigureCanvasAgg(fig)
    return fig


def _axes(fig: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Return axes at a place given in inches."""
    w, h = fig.get_size_inches()
    ax = fig.add_axes((left / w, bottom / h, width / w, height / h))
    # the grid shows where the ticks are
    ax.tick_params(labelsize=9, length=0, pad=3)
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color(GREY)
    ax.grid(True, lw=0.4, color="#DDDDDD")
    ax.set_axisbelow(True)
    return ax


def _columns(items: Sequence[tuple[Any, str]], width: float) -> int:
    """Return how many columns of a legend fit into a width in inches."""
    for columns in range(len(items), 1, -1):
        # a letter of 9.5 pt is 0.08 inch wide at most, on average; line and gaps 0.58
        longest = (max(len(text) for _, text in items[c::columns]) for c in range(columns))
        if sum(0.08 * letters + 0.58 for letters in longest) < width:
            return columns
    return 1


def _header_height(items: Sequence[tuple[Any, str]], width: float = WIDTH) -> float:
    """Return the height in inches that title, legend and the title of a panel need."""
    return 0.82 + 0.19 * math.ceil(len(items) / _columns(items, width))


def _header(fig: Figure, title: str, about: str, items: Sequence[tuple[Any, str]]) -> None:
    """Write title and legend above everything else, where no data can be hidden."""
    w, h = fig.get_size_inches()
    most = int(w / 0.08)
    about = (
        about if len(about) <= most else f"{about[: most // 2 - 2]} ... {about[-most // 2 + 3 :]}"
    )
    left: dict[str, Any] = {"ha": "left", "va": "top", "parse_math": False}
    fig.text(0.08 / w, 1 - 0.06 / h, title, fontsize=11, weight="bold", **left)
    fig.text(0.08 / w, 1 - 0.26 / h, about, fontsize=9.5, color="#444444", **left)
    if not items:
        return
    # matplotlib fills column by column; this order reads row by row
    columns = _columns(items, w)
    rows = math.ceil(len(items) / columns)
    short = len(items) - columns * (rows - 1)
    order = [
        r * columns + c for c in range(columns) for r in range(rows if c < short else rows - 1)
    ]
    legend = fig.legend(
        [items[i][0] for i in order],
        [items[i][1] for i in order],
        loc="upper left",
        bbox_to_anchor=(0.08 / w, 1 - 0.48 / h),
        ncols=columns,
        frameon=False,
        fontsize=9.5,
        borderpad=0.0,
        borderaxespad=0.0,
        labelspacing=0.35,
        handlelength=2.8,
        handletextpad=0.5,
        columnspacing=0.9,
    )
    for text in legend.get_texts():
        text.set_parse_math(False)


def _line(colour: str, style: Any = "-", width: float = 1.8) -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, ls=style, lw=width)


def _dots(colour: str, marker: str = ".", fill: Any = "full") -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, ls="", marker=marker, ms=6, fillstyle=fill)


def _patch(colour: str, alpha: float = 1.0) -> Any:
    from matplotlib.patches import Patch

    return Patch(facecolor=colour, alpha=alpha)


def looks_of(names: Iterable[str]) -> dict[str, tuple[str, Any]]:
    """Return colour and style of each predictor, the same ones in every picture."""
    looks: dict[str, tuple[str, Any]] = {}
    for name in names:
        k = sum(other not in LOOKS for other in looks)
        looks[name] = LOOKS.get(name, (SPARE[k % len(SPARE)], STYLES[k % len(STYLES)]))
    return looks


def _few_ticks(ax: Axes, across: int, up: int) -> None:
    from matplotlib.ticker import MaxNLocator, ScalarFormatter

    for axis, number in ((ax.xaxis, across), (ax.yaxis, up)):
        axis.set_major_locator(MaxNLocator(number, steps=[1, 2, 5, 10]))
        form = ScalarFormatter(useOffset=False)
        form.set_scientific(False)
        axis.set_major_formatter(form)


def _shade(ax: Axes, lost: Windows, begin: float = 0.0) -> None:
    """Shade the times without GPS; ``begin`` is the time at which the axis has its 0."""
    for a, b in lost:
        ax.axvspan(a - begin, b - begin, color=YELLOW, alpha=0.2, lw=0, zorder=0)
        ax.axvspan(a - begin, b - begin, ymax=0.05, color=YELLOW, lw=0, zorder=2)


def _span(parts: Iterable[Array], least: float, margin: float) -> tuple[float, float]:
    """Return the range of the finite values, at least so wide, with a margin on both sides."""
    values = np.concatenate([np.zeros(0), *(np.ravel(part) for part in parts)])
    values = values[np.isfinite(values) & (np.abs(values) < 1e12)]
    if not len(values):
        return -1.0, 1.0
    low, high = float(values.min()), float(values.max())
    wide = max(high - low, least, 1e-6 + 1e-3 * max(abs(low), abs(high)))
    middle, half = 0.5 * (low + high), (0.5 + margin) * wide
    return middle - half, middle + half


def _box(north: Array, east: Array, ratio: float, margin: float = 0.08) -> tuple[float, ...]:
    """Return limits (south, north, west, east) around points, of a height to width ratio."""
    s, n = _span([north], 1.0, margin)
    w, e = _span([east], 1.0, margin)
    if (n - s) < ratio * (e - w):
        more = 0.5 * (ratio * (e - w) - (n - s))
        s, n = s - more, n + more
    else:
        more = 0.5 * ((n - s) / ratio - (e - w))
        w, e = w - more, e + more
    return s, n, w, e


def _set_box(ax: Axes, s: float, n: float, w: float, e: float) -> None:
    ax.set_xlim(w, e)
    ax.set_ylim(s, n)
    ax.set_aspect("equal")
    _xlabel(ax, "east (m)")
    _ylabel(ax, "north (m)")


def _draw_track(ax: Axes, seen: Reference, fixes: Array, log: Log, lost: Windows) -> None:
    """Draw the way of the boat, its fixes, and where it had none."""
    path = seen.path
    for a, b in _inside(lost, log):
        rows = (seen.t[0] >= a) & (seen.t[0] <= b)
        ax.plot(path[rows, 1], path[rows, 0], color=YELLOW, lw=8, solid_capstyle="butt", zorder=1)
    if seen.known:
        _dot(ax, fixes[:, ::-1], GREY)
        ax.plot(path[:, 1], path[:, 0], color=BLACK, lw=1.0, zorder=3)
    else:
        _dot(ax, path[:, ::-1], BLACK)
        ax.plot(path[:, 1], path[:, 0], color=BLACK, lw=0.7, zorder=3)


def _dot(ax: Axes, points: Array, colour: str) -> None:
    """Draw points (n, 2) as one path of steps too short to see: a marker each is a large file."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Steps

    if len(points):
        steps = np.repeat(points, 2, axis=0)
        steps[1::2, 0] += 1e-3
        codes = np.tile([Steps.MOVETO, Steps.LINETO], len(points))
        look: dict[str, Any] = {"fill": False, "ec": colour, "lw": 1.6, "capstyle": "round"}
        ax.add_patch(PathPatch(Steps(steps, codes), **look, zorder=2))


def _cut(path: Array, limits: tuple[float, ...]) -> Array:
    """Return a track (n, 2) up to where it is far outside of the limits for the first time."""
    s, n, w, e = limits
    far = 2.0 * max(n - s, e - w)
    with np.errstate(invalid="ignore"):
        good = (
            (path[:, 0] > s - far)
            & (path[:, 0] < n + far)
            & (path[:, 1] > w - far)
            & (path[:, 1] < e + far)
        )
    return path if good.all() else path[: int(np.argmin(good))]


def origins_of(run: RunFigure) -> list[float]:
    """Return the times at which the examples were made, s."""
    times = {round(p.t0, 3) for figure in run.predictors.values() for p in figure.examples}
    return sorted(times)[:3]


def _examples(run: RunFigure, origin: float) -> dict[str, Prediction]:
    """Return the predictions made at an origin, by predictor."""
    return {
        name: prediction
        for name, figure in run.predictors.items()
        for prediction in figure.examples
        if abs(prediction.t0 - origin) < 2e-3
    }


def second(t: float) -> str:
    return f"{round(t, 1):g}"


def name_of(run: RunFigure) -> str:
    fault = "no fault" if run.fault == "none" else f"fault {run.fault}"
    return f"{run.scenario}, {fault}, seed {run.seed}"


# the pictures of a run
def track_figure(run: RunFigure, looks: Looks) -> Figure:
    """Draw the whole track, and below it the 10 s after each example origin."""
    log, seen, fixes = run.log, reference_of(run.log), _fixes(run.log)
    origins = origins_of(run)
    shown = [name for name, figure in run.predictors.items() if figure.examples]
    labels: list[tuple[Any, str]] = [(_line(BLACK), f"{seen.label} track")]
    if seen.known and len(fixes):
        labels.append((_dots(GREY), "GPS fixes"))
    if _inside(run.lost, log):
        labels.append((_patch(YELLOW), "stretch without GPS"))
    if origins:
        labels.append((_dots(BLACK, "o"), "predictions start"))
    labels += [(_line(looks[name][0], looks[name][1]), name) for name in shown]

    north, east = seen.path[:, 0], seen.path[:, 1]
    wide = WIDTH - 0.75
    south, top = _span([north], 1.0, 0.08)
    west, right = _span([east], 1.0, 0.08)
    tall = min(max(wide * (top - south) / (right - west), 1.8), 3.6)
    side, next_to, above = 1.58, 2.24, 2.38
    rows = math.ceil(len(origins) / 2)
    header = _header_height(labels)
    below = above * rows
    fig = _figure(WIDTH, header + tall + 0.5 + below)
    _header(fig, "Track", name_of(run), labels)

    whole = _axes(fig, 0.62, below + 0.5, wide, tall)
    limits = _box(north, east, tall / wide)
    _draw_track(whole, seen, fixes, log, run.lost)
    _set_box(whole, *limits)
    _few_ticks(whole, 6, 6)
    _title(whole, "the whole run, north up")
    for number, origin in enumerate(origins, 1):
        _draw_predictions(whole, run, origin, looks, limits, 1.4)
        place = _at(seen, origin)
        if np.isfinite(place).all():
            away = place - np.array([np.median(north), np.median(east)])
            away *= 15.0 / max(float(np.hypot(*away)), 1e-9)
            whole.annotate(
                str(number),
                (place[1], place[0]),
                (away[1], away[0]),
                textcoords="offset points",
                fontsize=11,
                weight="bold",
                zorder=8,
                ha="center",
                va="center",
                bbox={"boxstyle": "circle,pad=0.12", "fc": "white", "ec": BLACK, "lw": 0.8},
            )
        down, along = divmod(number - 1, 2)
        place_up = 0.5 + above * (rows - 1 - down)
        ax = _axes(fig, 0.62 + next_to * along, place_up, side, side)
        near = (seen.t[0] >= origin - 2.0) & (seen.t[0] <= origin + 10.0)
        close = _box(*_with_room(north[near], east[near], _examples(run, origin)), 1.0, 0.1)
        _draw_track(
            ax,
            _between_times(seen, origin - 5.0, origin + 10.0),
            _fixes(log.slice(origin - 5.0, origin + 10.0)),
            log,
            run.lost,
        )
        _draw_predictions(ax, run, origin, looks, close, 1.8)
        _set_box(ax, *close)
        _few_ticks(ax, 3, 4)
        _title(ax, f"{number}: from t = {second(origin)} s")
    return fig


def _with_room(
    north: Array, east: Array, examples: Mapping[str, Prediction]
) -> tuple[Array, Array]:
    """Return positions to be in sight: the true ones, and predicted ones not far from them."""
    if not len(north):
        return north, east
    room = 0.3 * max(float(np.ptp(north)), float(np.ptp(east)), 1.0)
    out = []
    for column, there in enumerate((north, east)):
        parts = [p.mean[:, column][np.isfinite(p.mean[:, column])] for p in examples.values()]
        all_parts = np.concatenate([there, *parts])
        out.append(np.clip(all_parts, there.min() - room, there.max() + room))
    return out[0], out[1]


def _between_times(seen: Reference, t0: float, t1: float) -> Reference:
    parts = [seen.within(j, t0, t1) for j in range(6)]
    return Reference(seen.known, [t for t, _ in parts], [v for _, v in parts])


def _at(seen: Reference, t: float) -> Array:
    """Return the position at a time; NaN where there is none."""
    if not len(seen.t[0]):
        return np.full(2, math.nan)
    return np.array([np.interp(t, seen.t[0], seen.v[j]) for j in (0, 1)])


def _draw_predictions(
    ax: Axes,
    run: RunFigure,
    origin: float,
    looks: Looks,
    limits: tuple[float, ...],
    width: float,
) -> None:
    """Draw the predicted tracks from one origin, and the place where they start."""
    for order, (name, prediction) in enumerate(_examples(run, origin).items()):
        path = _cut(np.concatenate([prediction.start[None, :2], prediction.mean[:, :2]]), limits)
        colour, style = looks[name]
        ax.plot(path[:, 1], path[:, 0], color=colour, ls=style, lw=width, zorder=4 + 0.1 * order)
        if len(path) == len(prediction.mean) + 1:
            ax.plot(path[-1:, 1], path[-1:, 0], "o", color=colour, ms=3, zorder=4 + 0.1 * order)
    place = _at(reference_of(run.log), origin)
    ax.plot(place[1:], place[:1], "o", color=BLACK, ms=4.5, zorder=6)


def prediction_figure(run: RunFigure, origin: float, looks: Looks, seen: Reference) -> Figure:
    """Draw what was predicted at an origin against what came, in six panels."""
    examples = _examples(run, origin)
    end = max([origin + 10.0, *(float(p.t[-1]) for p in examples.values() if len(p.t))])
    banded = next((name for name in BANDED if name in examples), None)
    lost = [(a, b) for a, b in run.lost if b > origin and a < end]
    labels: list[tuple[Any, str]] = [
        (_line(BLACK, width=2.4) if seen.known else _dots(BLACK), seen.label)
    ]
    labels += [(_line(looks[name][0], looks[name][1]), name) for name in examples]
    if banded:
        labels.append(
            (
                _patch(looks[banded][0], 0.25),
                "its 90 % band" if len(examples) < 2 else f"90 % of {banded}",
            )
        )
    if lost:
        labels.append((_patch(YELLOW), "no GPS"))
    header = _header_height(labels)
    high, gap, wide = 1.15, 0.42, 1.59
    fig = _figure(WIDTH, header + 3 * high + 2 * gap + 0.5)
    _header(fig, f"Predicted at t = {second(origin)} s", name_of(run), labels)

    speed = float(np.median(_speed(seen))) if len(seen.v[3]) else 1.0
    least = {0: 2 * speed, 1: 2 * speed, 2: 10.0, 3: 0.25 * speed, 4: 0.15 * speed, 5: 3.0}
    for panel, (column, title) in enumerate(PANELS):
        unit = 180.0 / math.pi if column in (2, 5) else 1.0
        ax = _axes(
            fig,
            0.58 + (panel % 2) * (wide + 0.66),
            0.5 + (2 - panel // 2) * (high + gap),
            wide,
            high,
        )
        _title(ax, title)
        t, truth = seen.within(column, origin, end)
        truth = unit * truth
        turns = 360.0 * round(float(truth[0]) / 360.0) if column == 2 and len(truth) else 0.0
        truth = truth - turns

        curves = {}
        for name, prediction in examples.items():
            curve = unit * np.concatenate(
                [prediction.start[None, column], prediction.mean[:, column]]
            )
            if column == 2 and np.isfinite(curve[0]):
                aim = truth[0] if len(truth) else 0.0
                curve = curve - 360.0 * np.round((curve[0] - aim) / 360.0)
            curves[name] = curve
        limits = _limits(truth, list(curves.values()), least[column])
        if seen.known:
            ax.plot(t - origin, truth, color=BLACK, lw=2.4, zorder=3)
        else:
            ax.plot(t - origin, truth, ".", color=BLACK, ms=4, zorder=3)
        for name, curve in curves.items():
            _draw_curve(
                ax,
                examples[name],
                curve,
                looks[name],
                limits,
                _band(examples[name], column, unit) if name == banded else None,
            )
        _shade(ax, lost, origin)
        ax.set_xlim(0.0, end - origin)
        ax.set_ylim(*limits)
        _few_ticks(ax, 6, 4)
        if panel < 4:
            ax.tick_params(labelbottom=False)
        else:
            _xlabel(ax, "time ahead (s)")
    return fig


def _limits(truth: Array, curves: Sequence[Array], least: float) -> tuple[float, float]:
    """Return limits that show the truth well, and as much of the curves as fits beside it."""
    if not len(truth):
        # no reference in this channel: the middle of what was predicted
        values = np.concatenate([np.zeros(0), *curves])
        values = values[np.isfinite(values)]
        return _span([np.percentile(values, [10, 90])] if len(values) else [], least, 0.5)
    low, high = _span([truth], least, 0.1)
    room = 0.75 * (high - low)
    inside = [np.clip(curve[np.isfinite(curve)], low - room, high + room) for curve in curves]
    return _span([np.array([low, high]), *inside], 0.0, 0.03)


def _band(prediction: Prediction, column: int, unit: float) -> tuple[Array, Array]:
    """Return how far the 90 % band of one column reaches down and up, each (K + 1,)."""
    start = Z90 * math.sqrt(max(float(prediction.start_cov[column, column]), 0.0))
    mean = prediction.mean[:, column]
    with np.errstate(invalid="ignore"):
        down, up = mean - prediction.low[:, column], prediction.high[:, column] - mean
    return unit * np.concatenate([[start], down]), unit * np.concatenate([[start], up])


def _draw_curve(
    ax: Axes,
    prediction: Prediction,
    curve: Array,
    look: tuple[str, Any],
    limits: tuple[float, float],
    band: tuple[Array, Array] | None,
) -> None:
    """Draw one predicted curve; an arrow head shows where it leaves the picture."""
    low, high = limits
    far = 5.0 * (high - low)
    after = np.concatenate([[0.0], prediction.t - prediction.t0])
    curve = np.clip(np.nan_to_num(curve, nan=high + far), low - far, high + far)
    colour, style = look
    if band is not None:
        down, up = (np.clip(np.nan_to_num(part, nan=far), 0.0, 2.0 * far) for part in band)
        ax.fill_between(after, curve - down, curve + up, color=colour, alpha=0.18, lw=0, zorder=1)
    ax.plot(after, curve, color=colour, ls=style, lw=1.6, zorder=4)
    outside = (curve < low) | (curve > high)
    if outside.any():
        k = int(np.argmax(outside))
        up = curve[k] > high
        edge = high if up else low
        # the place on the edge, between the last point inside and the first outside
        share = (edge - curve[k - 1]) / (curve[k] - curve[k - 1]) if k else 0.0
        x = after[k - 1] + share * (after[k] - after[k - 1]) if k else after[0]
        edge += (-0.045 if up else 0.045) * (high - low)
        ax.plot([x], [edge], marker="^" if up else "v", color=colour, ms=7, clip_on=False, zorder=6)


def parameter_figure(
    run: RunFigure,
    name: str,
    motion: str,
    looks: Looks,
    identified: float | None,
) -> Figure:
    """Draw the history of the parameters of one equation, one small panel each."""
    figure = run.predictors[name]
    columns = range(*figure.blocks[motion])
    t = np.asarray(figure.t, dtype=np.float64)
    colour = looks[name][0]
    labels: list[tuple[Any, str]] = [
        (_line(colour), "estimate"),
        (_patch(colour, 0.25), "\u00b12 sd"),
    ]
    lost = _inside(run.lost, run.log)
    if identified is not None:
        labels.append((_line(BLACK, DASHED, 1.0), "first prediction"))
    if lost:
        labels.append((_patch(YELLOW), "no GPS"))
    across, high, gap, wide = 2, 1.0, 0.42, 1.59
    rows = math.ceil(len(columns) / across)
    fig = _figure(WIDTH, _header_height(labels) + rows * high + (rows - 1) * gap + 0.5)
    _header(fig, f"{motion.capitalize()} parameters by {name}", name_of(run), labels)
    for place, column in enumerate(columns):
        row, side = divmod(place, across)
        xi, sd = (
            np.where(np.abs(part[:, column]) < 1e12, part[:, column], math.nan)
            for part in (figure.params, figure.params_sd)
        )
        power = _power(_history_limits(xi, sd))
        xi, sd = xi / 10.0**power, sd / 10.0**power
        low_y, high_y = limits = _history_limits(xi, sd)
        far = 5.0 * (high_y - low_y)
        left, bottom = 0.58 + side * (wide + 0.66), 0.5 + (rows - 1 - row) * (high + gap)
        ax = _axes(fig, left, bottom, wide, high)
        _title(ax, _parameter_title(figure, column, power))
        _shade(ax, lost)
        line, low, up = (
            np.clip(y, low_y - far, high_y + far) for y in (xi, xi - 2.0 * sd, xi + 2.0 * sd)
        )
        ax.fill_between(t, low, up, color=colour, alpha=0.22, lw=0, zorder=1)
        if identified is not None:
            ax.axvline(identified, color=BLACK, ls=DASHED, lw=1.0, zorder=2)
        ax.plot(t, line, color=colour, lw=1.5, zorder=3)
        ax.set_xlim(float(t[0]), float(t[-1]) if len(t) > 1 else float(t[0]) + 1.0)
        ax.set_ylim(*limits)
        _few_ticks(ax, 4, 3)
        if place + across < len(columns):
            ax.tick_params(labelbottom=False)
        else:
            _xlabel(ax, "time (s)")
    return fig


def _history_limits(xi: Array, sd: Array) -> tuple[float, float]:
    """Return limits that show the history of a parameter well.

    An early transient or a spike may leave the picture, the settled values may not.
    """
    there = np.isfinite(xi) & np.isfinite(sd)
    if not there.any():
        return -1.0, 1.0
    last = int(np.flatnonzero(there)[-1])
    usual = np.percentile(xi[there], [2, 98])
    close = 2.2 * sd[last] * np.array([-1.0, 1.0]) + xi[last]
    return _span([usual, close], 0.0, 0.12)


def _power(limits: tuple[float, float]) -> int:
    """Return the power of ten, a multiple of 3, that makes numbers short; 0 if they are."""
    size = max(map(abs, limits))
    return 0 if 0.1 <= size < 1e4 else 3 * math.floor(math.log10(size) / 3.0)


def _parameter_title(figure: PredictorFigure, column: int, power: int) -> str:
    unit = re.sub(r"([a-z])2", "\\1\u00b2", figure.units[column])
    factor = f"1e{power} " if power else ""
    return f"{figure.names[column]} ({factor}{unit})"


def text_of(row: Mapping[str, Any], key: str) -> str:
    """Return a text of a row of results; empty where there is none."""
    value = row.get(key)
    return "" if value is None else str(value)


def number_of(row: Mapping[str, Any], key: str) -> float:
    """Return a number of a row of results; NaN where there is none."""
    value = row.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
        return math.nan
    return float(value)


def error_figure(about: str, rows: Sequence[Mapping[str, Any]], looks: Looks) -> Figure | None:
    """Draw the mean absolute error against the horizon; None where there is none."""
    curves: dict[tuple[str, str, str], dict[float, list[tuple[float, float]]]] = {}
    for row in rows:
        value, n, horizon = number_of(row, "mae"), number_of(row, "n"), number_of(row, "horizon_s")
        if math.isnan(value) or math.isnan(horizon):
            continue
        key = (text_of(row, "channel"), text_of(row, "predictor"), text_of(row, "plan"))
        weight = n if n > 0 else 1.0
        curves.setdefault(key, {}).setdefault(horizon, []).append((value, weight))
    panels = [
        ("along", "position along (m)", 1.0),
        ("across", "position across (m)", 1.0),
        ("psi", "heading (deg)", 180.0 / math.pi),
    ]
    panels = [panel for panel in panels if any(key[0] == panel[0] for key in curves)]
    if not panels:
        return None
    predictors = list(dict.fromkeys(key[1] for key in curves))
    plans = list(dict.fromkeys(key[2] for key in curves))
    labels: list[tuple[Any, str]] = [
        (_line(looks[name][0], looks[name][1]), name) for name in predictors
    ]
    fill = {plan: "full" if k % 2 == 0 else "none" for k, plan in enumerate(plans)}
    if len(plans) > 1:
        labels += [(_dots(BLACK, "o", fill[plan]), f"plan {plan}") for plan in plans]
    fig = _stacked("Error against horizon", about, labels, [name for _, name, _ in panels], 1.25)
    for ax, (channel, _, unit) in zip(fig.axes, panels, strict=True):
        lines = []
        for (which, predictor, plan), table in curves.items():
            if which != channel:
                continue
            x = np.array(sorted(table))
            y = np.array(
                [sum(v * w for v, w in table[h]) / sum(w for _, w in table[h]) for h in x.tolist()]
            )
            lines.append((*looks[predictor], fill[plan], x, unit * y))
        # one absurd predictor must not flatten all the others
        ends = np.array([line[-1].max() for line in lines])
        ends = ends[np.isfinite(ends)]
        top = 1.0
        if len(ends):
            top = max(1.08 * float(np.min([ends.max(), 3.0 * np.median(ends)])), 1e-6)
        for colour, style, full, x, y in lines:
            y = np.minimum(np.nan_to_num(y, nan=math.nan, posinf=10 * top), 10 * top)
            ax.plot(x, y, color=colour, ls=style, lw=1.6, marker="o", ms=4, fillstyle=full)
            outside = y > top
            if outside.any():
                k = int(np.argmax(outside))
                share = (top - y[k - 1]) / (y[k] - y[k - 1]) if k else 0.0
                ax.plot(
                    [x[k - 1] + share * (x[k] - x[k - 1]) if k else x[0]],
                    [0.97 * top],
                    marker="^",
                    color=colour,
                    ms=7,
                    clip_on=False,
                    zorder=6,
                )
        horizons = sorted({h for line in lines for h in line[3].tolist()})
        _few_ticks(ax, 5, 5)
        ax.set_xticks(horizons, [f"{h:g}" for h in horizons])
        ax.set_xlim(0.0, 1.05 * horizons[-1])
        ax.set_ylim(0.0, top)
    _xlabel(fig.axes[-1], "horizon (s)")
    return fig


def _stacked(
    title: str, about: str, labels: list[tuple[Any, str]], panels: Sequence[str], high: float
) -> Figure:
    """Return a picture with one panel below the other, each with its title."""
    gap = 0.5
    below = 0.5 + (len(panels) - 1) * (high + gap)
    fig = _figure(WIDTH, _header_height(labels) + below + high)
    _header(fig, title, about, labels)
    for row, name in enumerate(panels):
        _title(_axes(fig, 0.58, below - row * (high + gap), WIDTH - 0.76, high), name)
    return fig


TRENDS: dict[str, tuple[str, str, tuple[tuple[str, str, float], ...]]] = {
    "gps_loss_s": (
        "Error against the length of a GPS loss",
        "length of the loss (s)",
        (
            ("displacement_10s", "displacement after 10 s (m)", 1.0),
            ("start_error", "believed position (m)", 1.0),
        ),
    ),
    "sea_state": (
        "Error against the sea state",
        "sea state (WMO code 3700)",
        (
            ("displacement_10s", "displacement after 10 s (m)", 1.0),
            ("psi_10s", "heading after 10 s (deg)", 180.0 / math.pi),
        ),
    ),
}
"""Title, horizontal axis and panels (metric, title, factor) of each trend."""


def trend_figure(axis: str, rows: Sequence[Mapping[str, Any]], looks: Looks) -> Figure:
    """Draw the panels of one trend, a line with intervals for each predictor."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    title, label, panels = TRENDS[axis]
    names = list(dict.fromkeys(text_of(row, "predictor") for row in rows))
    at = sorted({number_of(row, "at") for row in rows})
    labels = [(_line(looks[name][0], looks[name][1]), name) for name in names]
    about = "mean over scenarios and boats, 95 % intervals"
    fig = _stacked(title, about, labels, [name for _, name, _ in panels], 1.9)
    step = 0.012 * (at[-1] - at[0])
    for ax, (metric, _, factor) in zip(fig.axes, panels, strict=True):
        seen = []
        for k, predictor in enumerate(names):
            line = sorted(
                (
                    number_of(row, "at"),
                    *(factor * number_of(row, v) for v in ("value", "low", "high")),
                )
                for row in rows
                if (text_of(row, "predictor"), text_of(row, "metric")) == (predictor, metric)
            )
            x, y, low, up = np.array(line).T
            # side by side, so that intervals can be told apart
            x = x + step * (k - 0.5 * (len(names) - 1))
            colour, style = looks[predictor]
            ax.plot(x, y, color=colour, ls=style, lw=1.6, marker="o", ms=3.5, zorder=3)
            ax.vlines(x, low, up, color=colour, lw=1.2, zorder=2)
            seen += [y, low, up]
        values = np.concatenate(seen)
        values = values[np.isfinite(values) & (values > 0.0)]
        ax.set_yscale("log")
        ax.set_ylim(0.9 * values.min(), 1.1 * values.max())
        near = values.max() < 8.0 * values.min()
        parts = (1, 1.5, 2, 3, 5, 7) if near else (1, 2, 5)
        ticks = [m * 10.0**p for p in range(-4, 5) for m in parts]
        ax.yaxis.set_major_locator(FixedLocator(ticks))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        ax.yaxis.set_minor_locator(NullLocator())
        ax.set_xticks(at, [f"{v:g}" for v in at])
    _xlabel(fig.axes[-1], label)
    return fig
