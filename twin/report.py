"""The report of a benchmark: one page of HTML with its pictures inside, and the pictures alone.

Nothing here computes a result; it only shows what ``twin.benchmark`` hands over. matplotlib is
imported when the first picture is drawn, and never through pyplot, so that neither an import
nor a picture changes anything for the caller.
"""

from __future__ import annotations

import base64
import html
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twin.log import MEASUREMENTS, Log
from twin.predictor import Z90, Prediction

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["PredictorFigure", "RunFigure", "picture_of_log", "write_report"]

Array = NDArray[np.float64]
Windows = Sequence[tuple[float, float]]

BANDED = ("dsw-ukf-plus", "ukf")
"""The first of these that took part is shown with its band."""

DPI = 130
WIDTH = 7.0
"""Width of a picture, inch: with 10 pt letters it can be read at 390 pixels too."""

# Okabe and Ito's colours, which can be told apart with any kind of colour vision.
BLACK, GREY, YELLOW = "#000000", "#808080", "#F0E442"
COLOURS = {
    "persistence": "#E69F00",
    "persistence-8s": "#56B4E9",
    "ukf": "#0072B2",
    "dsw-ukf": "#009E73",
    "lstm": "#CC79A7",
    "dsw-ukf-plus": "#D55E00",
    "oracle": "#808080",
}
SPARE = ("#D55E00", "#CC79A7", "#009E73", "#E69F00", "#56B4E9", "#0072B2")
STYLES: tuple[Any, ...] = ((0, (4, 1.5)), (0, (1.5, 1)), (0, (5, 1, 1, 1)))

PANELS = (
    (3, "surge speed u (m/s)"),
    (4, "sway speed v (m/s)"),
    (5, "yaw rate r (deg/s)"),
    (2, "heading psi (deg)"),
    (0, "position north x (m)"),
    (1, "position east y (m)"),
)
"""Column of a state and title, in the order of the paper's Figures 12 and 16."""

METRICS = {
    "mae": ("MAE", "mean absolute error over all channels and horizons, units mixed"),
    "mae_median": ("median MAE", "median of the MAE over seeds"),
    "mse": ("MSE", "mean squared error, pooled in the same way"),
    "normalised": ("normalised error", "MAE over the size of the true change, mean of channels"),
    "skill": ("skill", "1 - error / error of persistence; below 0 is worse than persistence"),
    "J": (
        "J",
        "MAE over that of the oracle on the same run, mean of u, v, r, heading and displacement, "
        "each the mean of every half second up to 10 s",
    ),
    "E": ("E", "J - 1, the excess over the oracle"),
    "crps": ("CRPS", "score of the whole distribution, pooled as the MAE; of a sure one, its MAE"),
    "start_error": (
        "start error (m)",
        "distance of the believed from the reference position when the prediction was made",
    ),
    "displacement_10s": ("displacement (m)", "MAE of the displacement after 10 s"),
    "psi_10s": ("heading (rad)", "MAE of the heading after 10 s"),
    "coverage90": ("90 % coverage", "share of errors inside the 90 % bands; 0.9 is ideal"),
}
"""Heading and meaning of each metric, in the order of the table's columns."""


@dataclass(frozen=True)
class PredictorFigure:
    """What the pictures show of one predictor on one run.

    Parameters
    ----------
    examples : list of Prediction
        At most three, made at the same origins by all predictors.
    t : ndarray, shape (M,)
        Times of the parameter history, s.
    xi, xi_sd : ndarray, shape (M, p)
        Model parameters and their standard deviations; no columns where there is no model.
    names, units : tuple of str
        Of the p parameters.
    blocks : dict of str to tuple of int
        First and last + 1 parameter of the equation of each motion.
    """

    examples: list[Prediction]
    t: Array
    xi: Array
    xi_sd: Array
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


def write_report(out: Path, results: dict[str, Any], runs: list[RunFigure]) -> list[Path]:
    """Write ``report.html`` and ``pictures/*.png``.

    Parameters
    ----------
    out : Path
        Folder, made if it is not there.
    results : dict
        Content of ``results.json``: ``version``, ``command``, ``settings``, ``rows`` and
        ``summary``; ``notes``, a list of lines such as on predictors left out, may be there.
    runs : list of RunFigure
        The runs to be drawn; may be empty.

    Returns
    -------
    list of Path
        What was written, the report first.
    """
    out = Path(out)
    folder = out / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    for stale in folder.glob("*.png"):
        stale.unlink()
    pictures = _Pictures(folder)
    names = dict.fromkeys(_text(row, "predictor") for row in results.get("rows") or [])
    names.update(dict.fromkeys(_text(row, "predictor") for row in results.get("summary") or []))
    for run in runs:
        names.update(dict.fromkeys(run.predictors))
    looks = _looks(names)

    body = [*_introduction(results, runs), *_trends(results, pictures, looks)]
    body += [*_recorded_tables(results), *_tables(results, pictures, looks)]
    for index, run in enumerate(runs):
        body += _run_section(run, index, results, pictures, looks)
    page = _PAGE.format(title="Benchmark of the twin's predictions", body="\n".join(body))
    report = out / "report.html"
    report.write_text(page, encoding="utf-8")
    return [report, *pictures.written]


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
    seen = _reference(log)
    labels: list[tuple[Any, str]] = [(_line(BLACK), seen.label)]
    fixes = _fixes(log)
    if seen.known and len(fixes):
        labels.append((_dots(GREY), "measured"))
    if _inside(lost, log):
        labels.append((_patch(YELLOW), "no GPS"))
    labels += [
        (_line(COLOURS["ukf"]), "left"),
        (_line(COLOURS["dsw-ukf-plus"], STYLES[0]), "right"),
    ]

    # left: the track over the commands; right: what the boat did. Lengths in inches.
    columns, wide, low, gap, foot = len(labels), 3.85, 0.8, 0.42, 0.5
    south, top = _span([seen.path[:, 0]], 1.0, 0.08)
    west, right = _span([seen.path[:, 1]], 1.0, 0.08)
    tall = min(max(wide * (top - south) / (right - west), 2.0), 4.4)
    below = foot + 2 * low + gap + 0.8
    header = _header_height(len(labels), columns)
    fig = _figure(9.6, header + tall + below)
    _header(fig, f"Run {log.name}", labels, columns)
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
        for side, look in (
            (0, {"color": COLOURS["ukf"], "lw": 1.4}),
            (1, {"color": COLOURS["dsw-ukf-plus"], "lw": 1.4, "ls": STYLES[0]}),
        ):
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
    path.write_bytes(_png(fig))


# what was really the case, or what was measured instead


@dataclass(frozen=True)
class _Reference:
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


def _reference(log: Log) -> _Reference:
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
    return _Reference(columns is log.truth, times, values)


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


def _speed(seen: _Reference) -> Array:
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


def _png(fig: Figure) -> bytes:
    """Return a picture as PNG, without a date, so that equal pictures are equal bytes."""
    buffer = io.BytesIO()
    fig.savefig(buffer, format="png", metadata={"Software": None}, pil_kwargs={"compress_level": 4})
    return buffer.getvalue()


def _axes(fig: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Return axes at a place given in inches."""
    w, h = fig.get_size_inches()
    ax = fig.add_axes((left / w, bottom / h, width / w, height / h))
    ax.tick_params(labelsize=9, length=3, pad=2, color=GREY)
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color(GREY)
    ax.grid(True, lw=0.4, color="#DDDDDD")
    ax.set_axisbelow(True)
    return ax


def _header_height(items: int, columns: int) -> float:
    """Return the height in inches that title and legend need."""
    return 0.42 + 0.2 * math.ceil(items / max(columns, 1)) + 0.3


def _header(fig: Figure, title: str, items: Sequence[tuple[Any, str]], columns: int) -> None:
    """Write title and legend above everything else, where no data can be hidden."""
    w, h = fig.get_size_inches()
    fig.text(
        0.12 / w,
        1 - 0.1 / h,
        title,
        ha="left",
        va="top",
        fontsize=12,
        weight="bold",
        parse_math=False,
    )
    if items:
        # matplotlib fills column by column; this order reads row by row
        rows = math.ceil(len(items) / columns)
        short = len(items) - columns * (rows - 1)
        order = [
            r * columns + c for c in range(columns) for r in range(rows if c < short else rows - 1)
        ]
        legend = fig.legend(
            [items[i][0] for i in order],
            [items[i][1] for i in order],
            loc="upper left",
            bbox_to_anchor=(0.12 / w, 1 - 0.4 / h),
            ncols=columns,
            frameon=False,
            fontsize=10,
            borderpad=0.0,
            borderaxespad=0.0,
            labelspacing=0.35,
            handlelength=2.2,
            columnspacing=1.4,
        )
        for text in legend.get_texts():
            text.set_parse_math(False)


def _line(colour: str, style: Any = "-", width: float = 1.8) -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, ls=style, lw=width)


def _dots(colour: str, marker: str = ".") -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, ls="", marker=marker, ms=6)


def _patch(colour: str, alpha: float = 1.0) -> Any:
    from matplotlib.patches import Patch

    return Patch(facecolor=colour, alpha=alpha)


def _looks(names: Iterable[str]) -> dict[str, tuple[str, Any]]:
    """Return colour and style of each predictor, the same ones in every picture."""
    looks: dict[str, tuple[str, Any]] = {}
    for name in names:
        if name in COLOURS:
            looks[name] = (COLOURS[name], "-")
        else:
            k = sum(other not in COLOURS for other in looks)
            looks[name] = (SPARE[k % len(SPARE)], STYLES[k // len(SPARE) % len(STYLES)])
    return looks


def _few_ticks(ax: Axes, across: int, up: int) -> None:
    from matplotlib.ticker import MaxNLocator, ScalarFormatter

    for axis, number in ((ax.xaxis, across), (ax.yaxis, up)):
        axis.set_major_locator(MaxNLocator(number, steps=[1, 2, 2.5, 5, 10]))
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


def _draw_track(ax: Axes, seen: _Reference, fixes: Array, log: Log, lost: Windows) -> None:
    """Draw the way of the boat, its fixes, and where it had none."""
    path = seen.path
    for a, b in _inside(lost, log):
        rows = (seen.t[0] >= a) & (seen.t[0] <= b)
        ax.plot(path[rows, 1], path[rows, 0], color=YELLOW, lw=8, solid_capstyle="butt", zorder=1)
    if seen.known:
        ax.plot(fixes[:, 1], fixes[:, 0], ".", color=GREY, ms=2, alpha=0.7, zorder=2)
        ax.plot(path[:, 1], path[:, 0], color=BLACK, lw=1.0, zorder=3)
    else:
        ax.plot(path[:, 1], path[:, 0], ".-", color=BLACK, lw=0.7, ms=2, zorder=3)


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


def _origins(run: RunFigure) -> list[float]:
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


def _second(t: float) -> str:
    return f"{round(t, 1):g}"


def _name(run: RunFigure) -> str:
    return f"{run.scenario}, fault {run.fault}, seed {run.seed}"


# the pictures of a run


def _track_figure(run: RunFigure, looks: Mapping[str, tuple[str, Any]]) -> Figure:
    """Draw the whole track, and below it the 10 s after each example origin."""
    log, seen, fixes = run.log, _reference(run.log), _fixes(run.log)
    origins = _origins(run)
    shown = [name for name, figure in run.predictors.items() if figure.examples]
    labels: list[tuple[Any, str]] = [(_line(BLACK), f"{seen.label} track")]
    if seen.known and len(fixes):
        labels.append((_dots(GREY), "GPS fixes"))
    if _inside(run.lost, log):
        labels.append((_patch(YELLOW), "stretch without GPS"))
    if origins:
        labels.append((_dots(BLACK, "o"), "predictions start"))
    labels += [(_line(looks[name][0], looks[name][1]), name) for name in shown]
    columns = 4 if all(len(text) < 15 for _, text in labels) else 3

    north, east = seen.path[:, 0], seen.path[:, 1]
    wide = WIDTH - 1.0
    south, top = _span([north], 1.0, 0.08)
    west, right = _span([east], 1.0, 0.08)
    tall = min(max(wide * (top - south) / (right - west), 2.2), 4.6)
    side = (WIDTH - 0.15 - 0.75 * len(origins)) / len(origins) if origins else 0.0
    side = min(side, 2.7)
    header = _header_height(len(labels), columns)
    below = side + 0.8 if origins else 0.0
    height = header + tall + 0.5 + below
    fig = _figure(WIDTH, height)
    _header(fig, f"Track: {_name(run)}", labels, columns)

    whole = _axes(fig, 0.75, below + 0.5, wide, tall)
    limits = _box(north, east, tall / wide)
    _draw_track(whole, seen, fixes, log, run.lost)
    _set_box(whole, *limits)
    _few_ticks(whole, 8, 6)
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
        ax = _axes(fig, 0.75 + (number - 1) * (side + 0.75), 0.5, side, side)
        rows = (seen.t[0] >= origin - 2.0) & (seen.t[0] <= origin + 10.0)
        close = _box(*_with_room(north[rows], east[rows], _examples(run, origin)), 1.0, 0.1)
        _draw_track(
            ax,
            _between_times(seen, origin - 5.0, origin + 10.0),
            _fixes(log.slice(origin - 5.0, origin + 10.0)),
            log,
            run.lost,
        )
        _draw_predictions(ax, run, origin, looks, close, 1.8)
        _set_box(ax, *close)
        _few_ticks(ax, 4, 4)
        _title(ax, f"{number}: from t = {_second(origin)} s")
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


def _between_times(seen: _Reference, t0: float, t1: float) -> _Reference:
    parts = [seen.within(j, t0, t1) for j in range(6)]
    return _Reference(seen.known, [t for t, _ in parts], [v for _, v in parts])


def _at(seen: _Reference, t: float) -> Array:
    """Return the position at a time; NaN where there is none."""
    if not len(seen.t[0]):
        return np.full(2, math.nan)
    return np.array([np.interp(t, seen.t[0], seen.v[j]) for j in (0, 1)])


def _draw_predictions(
    ax: Axes,
    run: RunFigure,
    origin: float,
    looks: Mapping[str, tuple[str, Any]],
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
    place = _at(_reference(run.log), origin)
    ax.plot(place[1:], place[:1], "o", color=BLACK, ms=4.5, zorder=6)


def _prediction_figure(
    run: RunFigure, origin: float, looks: Mapping[str, tuple[str, Any]], seen: _Reference
) -> Figure:
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
        labels.append((_patch(looks[banded][0], 0.25), f"90 % band of {banded}"))
    if lost:
        labels.append((_patch(YELLOW), "no GPS"))
    columns = 4
    header = _header_height(len(labels), columns)
    high, gap = 1.35, 0.42
    height = header + 3 * high + 2 * gap + 0.5
    fig = _figure(WIDTH, height)
    _header(fig, f"Predicted at t = {_second(origin)} s: {_name(run)}", labels, columns)

    speed = float(np.median(_speed(seen))) if len(seen.v[3]) else 1.0
    least = {0: 2 * speed, 1: 2 * speed, 2: 10.0, 3: 0.25 * speed, 4: 0.15 * speed, 5: 3.0}
    for panel, (column, title) in enumerate(PANELS):
        unit = 180.0 / math.pi if column in (2, 5) else 1.0
        wide = (WIDTH - 0.6 - 0.75 - 0.15) / 2
        ax = _axes(
            fig,
            0.6 + (panel % 2) * (wide + 0.75),
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
        _few_ticks(ax, 5, 4)
        if panel < 4:
            ax.tick_params(labelbottom=False)
        else:
            _xlabel(ax, "time after the prediction was made (s)")
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


def _parameter_figure(
    run: RunFigure,
    name: str,
    motion: str,
    looks: Mapping[str, tuple[str, Any]],
    identified: float | None,
) -> Figure:
    """Draw the history of the parameters of one equation, one small panel each."""
    figure = run.predictors[name]
    columns = range(*figure.blocks[motion])
    t = np.asarray(figure.t, dtype=np.float64)
    colour = looks[name][0]
    labels: list[tuple[Any, str]] = [
        (_line(colour), "estimate"),
        (_patch(colour, 0.25), "\u00b11 standard deviation"),
    ]
    lost = _inside(run.lost, run.log)
    if identified is not None:
        labels.append((_line(BLACK, STYLES[0], 1.0), "first prediction"))
    if lost:
        labels.append((_patch(YELLOW), "no GPS"))
    across = 3
    rows = math.ceil(len(columns) / across)
    header = _header_height(len(labels), len(labels))
    high, gap, wide = 1.1, 0.42, (WIDTH - 0.15 - 0.62 * across) / across
    height = header + rows * high + (rows - 1) * gap + 0.5
    fig = _figure(WIDTH, height)
    _header(fig, f"{name}, {motion} parameters: {_name(run)}", labels, len(labels))
    begin = float(t[0])
    end = float(t[-1]) if len(t) > 1 else begin + 1.0
    sheet = _Sheet(fig, begin, end)
    for place, column in enumerate(columns):
        row, side = divmod(place, across)
        xi, sd = (
            np.where(np.abs(part[:, column]) < 1e12, part[:, column], math.nan)
            for part in (figure.xi, figure.xi_sd)
        )
        power = _power(xi)
        xi, sd = xi / 10.0**power, sd / 10.0**power
        low_y, high_y = limits = _history_limits(xi, sd)
        far = 5.0 * (high_y - low_y)
        sheet.panel(
            (0.62 + side * (wide + 0.62), 0.5 + (rows - 1 - row) * (high + gap), wide, high),
            limits,
            _parameter_title(figure, column, power),
            labelled=place + across >= len(columns),
        )
        sheet.shade(lost)
        line, low, up = (np.clip(y, low_y - far, high_y + far) for y in (xi, xi - sd, xi + sd))
        sheet.band(t, low, up, colour)
        if identified is not None:
            sheet.mark(identified)
        sheet.line(t, line, colour)
    return fig


class _Sheet:
    """Many small panels over one range of time, drawn on a single pair of axes in inches.

    matplotlib takes some 60 ms for a pair of axes, most of it for ticks; a run has 50 panels
    of parameters.
    """

    def __init__(self, fig: Figure, begin: float, end: float) -> None:
        from matplotlib.ticker import MaxNLocator

        width, height = fig.get_size_inches()
        self.ax = fig.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0.0, width), ylim=(0.0, height))
        self.ax.set_axis_off()
        self.ax.set_autoscale_on(False)
        self.locator = {n: MaxNLocator(n, steps=[1, 2, 2.5, 5, 10]) for n in (3, 4)}
        self.time = (begin, end)

    def panel(
        self,
        place: tuple[float, float, float, float],
        limits: tuple[float, float],
        title: str,
        *,
        labelled: bool,
    ) -> None:
        """Begin a panel; ``place`` is left, bottom, width and height in inches."""
        from matplotlib.collections import LineCollection
        from matplotlib.patches import Rectangle

        left, bottom, width, height = place
        self.place, self.limits = place, limits
        self.frame = Rectangle((left, bottom), width, height, transform=self.ax.transData)
        write: dict[str, Any] = {"fontsize": 9, "parse_math": False}
        grid, ticks = [], []
        for value, text in self._ticks(4, self.time):
            x = float(self._x(np.array(value)))
            grid.append([(x, bottom), (x, bottom + height)])
            ticks.append([(x, bottom - 0.04), (x, bottom)])
            if labelled:
                self.ax.text(x, bottom - 0.07, text, ha="center", va="top", **write)
        for value, text in self._ticks(3, limits):
            y = float(self._y(np.array(value)))
            grid.append([(left, y), (left + width, y)])
            ticks.append([(left - 0.04, y), (left, y)])
            self.ax.text(left - 0.06, y, text, ha="right", va="center_baseline", **write)
        ticks.append([(left, bottom + height), (left, bottom), (left + width, bottom)])
        for lines, colour, lw in ((grid, "#DDDDDD", 0.4), (ticks, GREY, 0.8)):
            collection = LineCollection(lines, colors=colour, linewidths=lw, zorder=0.5)
            self.ax.add_collection(collection, autolim=False)
        if labelled:
            self.ax.text(
                left + 0.5 * width, bottom - 0.24, "time (s)", ha="center", va="top", fontsize=10
            )
        self.ax.text(left, bottom + height + 0.07, title, fontsize=10, parse_math=False)

    def line(self, t: Array, values: Array, colour: str) -> None:
        """Draw a curve."""
        (line,) = self.ax.plot(self._x(t), self._y(values), color=colour, lw=1.5, zorder=3)
        line.set_clip_path(self.frame)

    def band(self, t: Array, low: Array, high: Array, colour: str) -> None:
        """Shade between two curves."""
        band = self.ax.fill_between(
            self._x(t), self._y(low), self._y(high), color=colour, alpha=0.22, lw=0, zorder=1
        )
        band.set_clip_path(self.frame)

    def mark(self, t: float) -> None:
        """Mark a time."""
        x, (_, bottom, _, height) = float(self._x(np.array(t))), self.place
        (line,) = self.ax.plot(
            [x, x], [bottom, bottom + height], color=BLACK, ls=STYLES[0], lw=1.0, zorder=2
        )
        line.set_clip_path(self.frame)

    def shade(self, windows: Windows) -> None:
        """Shade times as :func:`_shade` does."""
        from matplotlib.patches import Rectangle

        _, bottom, _, height = self.place
        for window in windows:
            a, b = np.clip(window, *self.time)
            x = float(self._x(a))
            for share, alpha, order in ((1.0, 0.2, 0.0), (0.05, 1.0, 2.0)):
                patch = Rectangle(
                    (x, bottom),
                    float(self._x(b)) - x,
                    share * height,
                    color=YELLOW,
                    alpha=alpha,
                    lw=0,
                    zorder=order,
                )
                self.ax.add_patch(patch)

    def _x(self, t: Array) -> Array:
        left, _, width, _ = self.place
        return left + width * (t - self.time[0]) / (self.time[1] - self.time[0])

    def _y(self, values: Array) -> Array:
        _, bottom, _, height = self.place
        return bottom + height * (values - self.limits[0]) / (self.limits[1] - self.limits[0])

    def _ticks(self, number: int, limits: tuple[float, float]) -> list[tuple[float, str]]:
        """Return places and texts of the ticks within limits."""
        values = self.locator[number].tick_values(*limits)
        step = float(values[1] - values[0]) if len(values) > 1 else 1.0
        digits = next((d for d in range(12) if abs(step * 10**d - round(step * 10**d)) < 1e-6), 12)
        inside = [float(v) for v in values if limits[0] <= v <= limits[1]]
        return [(v, f"{v + 0.0:.{digits}f}".replace("-", "\u2212")) for v in inside]


def _history_limits(xi: Array, sd: Array) -> tuple[float, float]:
    """Return limits that show the history of a parameter well.

    An early transient or a spike may leave the picture, the settled values may not.
    """
    there = np.isfinite(xi) & np.isfinite(sd)
    if not there.any():
        return -1.0, 1.0
    last = int(np.flatnonzero(there)[-1])
    usual = np.percentile(xi[there], [2, 98])
    close = 1.5 * sd[last] * np.array([-1.0, 1.0]) + xi[last]
    return _span([usual, close], 0.0, 0.12)


def _power(values: Array) -> int:
    """Return the power of ten, a multiple of 3, that makes values easy to read; 0 if they are."""
    values = np.abs(values[np.isfinite(values)])
    size = float(np.percentile(values, 95)) if len(values) else 0.0
    if size == 0.0 or 0.01 <= size < 1e4:
        return 0
    return 3 * math.floor(math.log10(size) / 3.0)


def _parameter_title(figure: PredictorFigure, column: int, power: int) -> str:
    unit = re.sub(r"([a-z])2", "\\1\u00b2", figure.units[column])
    factor = f"1e{power} " if power else ""
    return f"{figure.names[column]} ({factor}{unit})"


def _error_figure(
    title: str, rows: Sequence[Mapping[str, Any]], looks: Mapping[str, tuple[str, Any]]
) -> Figure | None:
    """Draw the mean absolute error against the horizon; None where there is none."""
    curves: dict[tuple[str, str, str], dict[float, list[tuple[float, float]]]] = {}
    for row in rows:
        value, n, horizon = _number(row, "mae"), _number(row, "n"), _number(row, "horizon_s")
        if math.isnan(value) or math.isnan(horizon):
            continue
        key = (_text(row, "channel"), _text(row, "predictor"), _text(row, "plan"))
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
    plan_style = dict(zip(plans, ["-", *STYLES] * len(plans), strict=False))
    if len(plans) > 1:
        labels += [(_line(GREY, plan_style[plan]), f"plan: {plan}") for plan in plans]
    columns = 4
    header, high = _header_height(len(labels), columns), 2.2
    fig = _figure(WIDTH, header + high + 0.5)
    _header(fig, title, labels, columns)
    wide = (WIDTH - 0.15 - 0.62 * len(panels)) / len(panels)
    for place, (channel, name, unit) in enumerate(panels):
        ax = _axes(fig, 0.62 + place * (wide + 0.62), 0.5, wide, high)
        _title(ax, name)
        lines = []
        for (which, predictor, plan), table in curves.items():
            if which != channel:
                continue
            x = np.array(sorted(table))
            y = np.array(
                [sum(v * w for v, w in table[h]) / sum(w for _, w in table[h]) for h in x.tolist()]
            )
            style = plan_style[plan] if len(plans) > 1 else looks[predictor][1]
            lines.append((looks[predictor][0], style, x, unit * y))
        # one absurd predictor must not flatten all the others
        ends = np.array([line[3].max() for line in lines])
        ends = ends[np.isfinite(ends)]
        top = 1.0
        if len(ends):
            top = max(1.08 * float(np.min([ends.max(), 3.0 * np.median(ends)])), 1e-6)
        for colour, style, x, y in lines:
            y = np.minimum(np.nan_to_num(y, nan=math.nan, posinf=10 * top), 10 * top)
            ax.plot(x, y, color=colour, ls=style, lw=1.6, marker="o", ms=3.5)
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
        horizons = sorted({h for line in lines for h in line[2].tolist()})
        _few_ticks(ax, 5, 5)
        ax.set_xticks(horizons, [f"{h:g}" for h in horizons])
        ax.set_xlim(0.0, 1.05 * horizons[-1])
        ax.set_ylim(0.0, top)
        _xlabel(ax, "horizon (s)")
    return fig


# the page


class _Pictures:
    """Writes each picture to its file and returns it for the page."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.written: list[Path] = []

    def add(self, fig: Figure, name: str, caption: str) -> str:
        """Return the HTML of a picture and keep the picture itself beside the report."""
        data = _png(fig)
        stem = re.sub(r"[^A-Za-z0-9.-]+", "_", name).strip("._") or "picture"
        path, number = self.folder / f"{stem}.png", 2
        while path in self.written:
            path, number = self.folder / f"{stem}_{number}.png", number + 1
        path.write_bytes(data)
        self.written.append(path)
        width, height = (round(DPI * inch) for inch in fig.get_size_inches())
        text = html.escape(caption)
        return (
            f'<figure><img src="data:image/png;base64,{base64.b64encode(data).decode("ascii")}" '
            f'width="{width}" height="{height}" alt="{text}"><figcaption>{text}</figcaption>'
            "</figure>"
        )


def _introduction(results: Mapping[str, Any], runs: Sequence[RunFigure]) -> list[str]:
    """Return title, command, what was measured, and the contents."""
    rows = results.get("rows") or []
    horizons = sorted(
        {_number(row, "horizon_s") for row in rows or results.get("channels") or []} - {math.nan}
    )
    horizons = [h for h in horizons if math.isfinite(h)]
    far = f"{horizons[-1]:g}" if horizons else "10"
    steps = ", ".join(f"{h:g}" for h in horizons[:-1])
    steps = f"{steps} and {horizons[-1]:g} s" if len(horizons) > 1 else f"{far} s"
    settings = results.get("settings") or {}
    begin = _number(settings, "identify_s")
    after = f" ({begin:g} s in simulated runs)" if math.isfinite(begin) else ""
    told = [*rows, *(results.get("summary") or [])]
    faults = sorted({_text(row, "fault") for row in told} | {run.fault for run in runs})
    lost = ", ".join(fault for fault in faults if fault not in ("", "none"))
    body = [
        "<h1>Benchmark of the twin's predictions</h1>",
        f"<pre>{_escape(results.get('command', ''))}</pre>",
        f"<p>Once it has watched measurements and commands long enough{after}, each predictor "
        f"says every second how the boat will move over the next {far} s; it sees nothing of the "
        "future but the commands it is told.</p>",
        f"<p>After {steps} the prediction is compared with the truth that the simulation "
        "knows, or in a recorded run with the measured positions and headings: speeds u and v, "
        "yaw rate r, position along and across the boat, and heading psi, positions counted "
        "from where the prediction starts.</p>",
        "<p>"
        + (
            f"Faults take sensors away (here: {_escape(lost)}; gps10 is a loss of GPS of 10 s "
            "while predictions go on), and what a predictor does then without them is scored "
            "in the same way."
            if lost
            else "No sensor was lost in these runs: GPS was there all the time."
        )
        + "</p>",
    ]
    notes = results.get("notes") or []
    body += [f'<p class="note">{_escape(note)}</p>' for note in notes]
    if settings:
        items = "".join(
            f"<tr><th>{_escape(key)}</th><td>{_escape(_setting(value))}</td></tr>"
            for key, value in settings.items()
        )
        body.append(
            "<details><summary>Settings, version "
            f"{_escape(results.get('version', ''))}</summary>"
            f'<div class="scroll"><table class="plain">{items}</table></div></details>'
        )
    tuned = {
        name: told["tuning"]
        for name, told in (results.get("predictors") or {}).items()
        if isinstance(told, Mapping) and "tuning" in told
    }
    if tuned:
        lines = [
            f"<tr><th>{_escape(name)}</th><td>{_escape(text)}</td></tr>"
            for name, text in tuned.items()
        ]
        body.append("<h2>How much each predictor was tuned</h2>")
        body.append(_html_table("<th>predictor</th><th>searched</th>", lines))
    links = [
        f'<li><a href="#result-{k}">Results: {_escape(_case(*case))}</a></li>'
        for k, case in enumerate(_cases(results))
    ]
    links += [
        f'<li><a href="#run-{k}">Pictures: {_escape(_name(run))}</a></li>'
        for k, run in enumerate(runs)
    ]
    if links:
        body.append("<nav><ul>" + "".join(links) + "</ul></nav>")
    else:
        body.append("<p>No run is finished yet: there is nothing to show.</p>")
    return body


def _cases(results: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return scenario and case of all results, in order."""
    rows = [*(results.get("summary") or []), *(results.get("rows") or [])]
    return list(dict.fromkeys((_text(row, "scenario"), _case_of(row)) for row in rows))


def _case_of(row: Mapping[str, Any]) -> str:
    """Return the name of a row's case: its fault, where there is no other name."""
    return _text(row, "case") or _text(row, "fault")


def _case(scenario: str, case: str) -> str:
    return f"{scenario}, {case}" if case != "none" else f"{scenario}, no fault"


FOLDED = 8
"""Of more cases than these, each is folded away."""


def _tables(
    results: Mapping[str, Any], pictures: _Pictures, looks: Mapping[str, tuple[str, Any]]
) -> list[str]:
    """Return a table and a picture of the errors for each scenario and fault."""
    cases = _cases(results)
    body = ["<h2>Results</h2>"] if cases else []
    shown: set[str] = set()
    for index, (scenario, case) in enumerate(cases):

        def here(part: str, scenario: str = scenario, case: str = case) -> list[dict[str, Any]]:
            return [
                row
                for row in results.get(part) or []
                if (_text(row, "scenario"), _case_of(row)) == (scenario, case)
            ]

        summary, rows = here("summary"), here("rows")
        title = _escape(_case(scenario, case))
        fold = len(cases) > FOLDED
        body.append(
            f'<details id="result-{index}" class="case"><summary>{title}</summary>'
            if fold
            else f'<h3 id="result-{index}">{title}</h3>'
        )
        if summary:
            body.append(_table(summary))
            shown.update(_text(row, "metric") for row in summary)
        body += _paired_table(here("paired")) + _channel_tables(here("channels"))
        seeds = len({_number(row, "seed") for row in rows})
        fig = (
            None
            if fold
            else _error_figure(f"Error against horizon: {_case(scenario, case)}", rows, looks)
        )
        if fig is not None:
            text = (
                "Mean absolute error of position and heading against the horizon, mean of "
                f"{seeds} run{'' if seeds == 1 else 's'}. An arrow head marks a curve that "
                "leaves the picture; the table counts it in full."
            )
            body.append(
                '<div class="pictures">'
                + pictures.add(fig, f"{scenario}_{case}_error", text)
                + "</div>"
            )
        if fold:
            body.append("</details>")
    meanings = [
        f"<b>{_escape(name)}</b>: {_escape(text)}"
        for key, (name, text) in METRICS.items()
        if key in shown
    ]
    if meanings:
        body.insert(
            1,
            '<p class="note">Best value of each column in bold; in brackets the 95 % interval '
            "over seeds, where there are enough of them, and the median. "
            + "; ".join(meanings)
            + ".</p>",
        )
    return body


def _table(summary: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of one scenario and fault."""
    cells: dict[tuple[str, str], dict[str, Mapping[str, Any]]] = {}
    for row in summary:
        key = (_text(row, "predictor"), _text(row, "plan"))
        cells.setdefault(key, {})[_text(row, "metric")] = row
    there = list(dict.fromkeys(_text(row, "metric") for row in summary))
    metrics = [m for m in METRICS if m in there] + [m for m in there if m not in METRICS]
    best = {metric: _best(metric, cells) for metric in metrics}
    plans = len({plan for _, plan in cells}) > 1
    head = "<th>predictor</th>" + ("<th>plan</th>" if plans else "")
    head += "".join(f"<th>{_escape(METRICS.get(m, (m,))[0])}</th>" for m in metrics)
    lines = []
    for (predictor, plan), row in cells.items():
        line = f"<th>{_escape(predictor)}</th>" + (f"<td>{_escape(plan)}</td>" if plans else "")
        for metric in metrics:
            entry = row.get(metric, {})
            text = _value(_number(entry, "value"))
            if text == best[metric]:
                text = f"<b>{text}</b>"
            low, high = _number(entry, "low"), _number(entry, "high")
            if not (math.isnan(low) or math.isnan(high)):
                text += f"<br><small>[{_value(low)}, {_value(high)}]</small>"
                if "mae" not in metric:
                    text += f"<br><small>median {_value(_number(entry, 'median'))}</small>"
            line += f"<td>{text}</td>"
        lines.append(f"<tr>{line}</tr>")
    return _html_table(head, lines)


def _html_table(head: str, lines: Sequence[str]) -> str:
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )


def _paired_table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the comparison of each predictor with the reference; nothing without one."""
    if not rows:
        return []
    head = "<th>predictor</th><th>plan</th><th>change of MAE</th><th>median</th><th>better</th>"
    lines = []
    for row in rows:
        low, high = _number(row, "low"), _number(row, "high")
        between = "" if math.isnan(low) else f"<br><small>[{low:+.1f}, {high:+.1f}]</small>"
        lines.append(
            f"<tr><th>{_escape(_text(row, 'predictor'))}</th><td>{_escape(_text(row, 'plan'))}</td>"
            f"<td>{_number(row, 'change_percent'):+.1f} %{between}</td>"
            f"<td>{_number(row, 'median_percent'):+.1f} %</td>"
            f"<td>{row.get('wins')} of {row.get('seeds')}</td></tr>"
        )
    against = _escape(_text(rows[0], "against"))
    note = f'<p class="note">Against {against}, the same seeds; below 0 is better:</p>'
    return [note, _html_table(head, lines)]


def _channel_tables(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return errors, CRPS and coverage by channel and horizon; folded away."""
    if not rows:
        return []
    horizons = "/".join(f"{h:g}" for h in dict.fromkeys(_number(row, "horizon_s") for row in rows))
    body = []
    for metric, title, factor in (
        ("coverage90", "Coverage of the 90 % bands, %", 100.0),
        ("mae", "MAE by channel, SI units and rad,", 1.0),
        ("crps", "CRPS by channel, SI units and rad,", 1.0),
    ):
        told = [row for row in rows if math.isfinite(_number(row, metric))]
        channels = list(dict.fromkeys(_text(row, "channel") for row in told))
        cells: dict[tuple[str, str], dict[str, list[str]]] = {}
        for row in told:
            cell = cells.setdefault((_text(row, "predictor"), _text(row, "plan")), {})
            value = factor * _number(row, metric)
            text = f"{value:.0f}" if factor > 1.0 else _value(value)
            cell.setdefault(_text(row, "channel"), []).append(text)
        lines = []
        for (predictor, plan), cell in cells.items():
            values = "".join(f"<td>{'/'.join(cell.get(c, ['-']))}</td>" for c in channels)
            lines.append(f"<tr><th>{_escape(predictor)}</th><td>{_escape(plan)}</td>{values}</tr>")
        head = "".join(f"<th>{_escape(c)}</th>" for c in ("predictor", "plan", *channels))
        body.append(
            f"<details><summary>{title} at {horizons} s</summary>"
            + _html_table(head, lines)
            + "</details>"
        )
    return body


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
        "sea state",
        (
            ("displacement_10s", "displacement after 10 s (m)", 1.0),
            ("psi_10s", "heading after 10 s (deg)", 180.0 / math.pi),
        ),
    ),
}
"""Title, horizontal axis and panels (metric, title, factor) of each trend."""


def _trends(
    results: Mapping[str, Any], pictures: _Pictures, looks: Mapping[str, tuple[str, Any]]
) -> list[str]:
    """Return the pictures of the error against what changes from case to case."""
    rows = results.get("trends") or []
    plan = _text(rows[0], "plan") if rows else ""
    body = []
    for axis in TRENDS:
        here = [r for r in rows if _text(r, "axis") == axis and _text(r, "plan") == plan]
        if here:
            text = (
                f"{TRENDS[axis][0]}, future commands {plan}: mean over scenarios and boats, with "
                "95 % bootstrap intervals over boats. The vertical axis is logarithmic."
            )
            body.append(pictures.add(_trend_figure(axis, here, looks), f"trend_{axis}", text))
    return ["<h2>At a glance</h2>", '<div class="pictures">', *body, "</div>"] if body else []


def _trend_figure(
    axis: str, rows: Sequence[Mapping[str, Any]], looks: Mapping[str, tuple[str, Any]]
) -> Figure:
    """Draw the panels of one trend, a line with intervals for each predictor."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

    title, label, panels = TRENDS[axis]
    names = list(dict.fromkeys(_text(row, "predictor") for row in rows))
    at = sorted({_number(row, "at") for row in rows})
    columns = 4
    header, high = _header_height(len(names), columns), 2.6
    fig = _figure(WIDTH, header + high + 0.5)
    labels = [(_line(looks[name][0], looks[name][1]), name) for name in names]
    _header(fig, title, labels, columns)
    wide = (WIDTH - 0.15 - 0.62 * len(panels)) / len(panels)
    step = 0.012 * (at[-1] - at[0])
    for place, (metric, name, factor) in enumerate(panels):
        ax = _axes(fig, 0.62 + place * (wide + 0.62), 0.5, wide, high)
        _title(ax, name)
        seen = []
        for k, predictor in enumerate(names):
            line = sorted(
                (_number(row, "at"), *(factor * _number(row, v) for v in ("value", "low", "high")))
                for row in rows
                if (_text(row, "predictor"), _text(row, "metric")) == (predictor, metric)
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
        ax.yaxis.set_minor_formatter(NullFormatter())
        ax.set_xticks(at, [f"{v:g}" for v in at])
        _xlabel(ax, label)
    return fig


def _recorded_tables(results: Mapping[str, Any]) -> list[str]:
    """Return the table of RMSE over that of raw persistence, for each folder of recorded runs."""
    blocks: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for row in results.get("recorded") or []:
        key = tuple(_text(row, name) for name in ("folder", "fault", "plan"))
        blocks.setdefault(key, []).append(row)
    if not blocks:
        return []
    body = [
        "<h2>Recorded runs</h2>",
        '<p class="note">Root mean square error after 10 s over that of raw persistence on the '
        "same run: mean over runs with its 95 % interval, and geometric mean; then the change of "
        "the mean ratio against a reference on the same runs.</p>",
    ]
    told = (row["against"] for rows in blocks.values() for row in rows if "against" in row)
    against = _escape(next(told, "-"))
    head = "<th>predictor</th>" + "".join(
        f"<th>{channel}</th><th>geometric</th><th>against {against}</th>"
        for channel in ("displacement", "heading")
    )
    for (folder, fault, plan), rows in blocks.items():
        lines = []
        for predictor in dict.fromkeys(_text(row, "predictor") for row in rows):
            line = f"<th>{_escape(predictor)}</th>"
            for channel in ("displacement", "psi"):
                row = next(
                    r for r in rows if (r["predictor"], r["channel"]) == (predictor, channel)
                )
                line += (
                    f"<td>{_value(_number(row, 'ratio'))}{_between(row, 'low', 'high')}</td>"
                    f"<td>{_value(_number(row, 'geometric'))}</td>"
                )
                change = _number(row, "change_percent")
                line += (
                    "<td>-</td>"
                    if math.isnan(change)
                    else f"<td>{change:+.0f} %{_between(row, 'change_low', 'change_high')}</td>"
                )
            lines.append(f"<tr>{line}</tr>")
        most = max(int(_number(row, "runs")) for row in rows)
        body.append(f"<h3>{_escape(folder)}, {most} runs, fault {fault}, plan {plan}</h3>")
        body.append(_html_table(head, lines))
    return body


def _between(row: Mapping[str, Any], low: str, high: str) -> str:
    """Return an interval for a cell; nothing where there is none."""
    a, b = _number(row, low), _number(row, high)
    return "" if math.isnan(a) else f"<br><small>[{_value(a)}, {_value(b)}]</small>"


def _best(
    metric: str, cells: Mapping[tuple[str, str], Mapping[str, Mapping[str, Any]]]
) -> str | None:
    """Return the best value of a column as it is printed; None if nothing is compared."""
    values = [_number(row[metric], "value") for row in cells.values() if metric in row]
    values = [value for value in values if math.isfinite(value)]
    if len({_value(value) for value in values}) < 2:
        return None
    if metric == "skill":
        return _value(max(values))
    if metric == "coverage90":
        return _value(min(values, key=lambda value: abs(value - 0.9)))
    return _value(min(values))


def _run_section(
    run: RunFigure,
    index: int,
    results: Mapping[str, Any],
    pictures: _Pictures,
    looks: Mapping[str, tuple[str, Any]],
) -> list[str]:
    """Return the pictures of one run."""
    seen = _reference(run.log)
    stem = f"{run.scenario}_{run.fault}_seed{run.seed}"
    compared = "truth" if seen.known else "measurements (no truth is known)"
    body = [f'<h2 id="run-{index}">{_escape(_name(run))}</h2>', '<div class="pictures">']
    body.append(
        pictures.add(
            _track_figure(run, looks),
            f"{stem}_track",
            "Track, and predicted tracks over 10 s from each example origin (numbered). Axes "
            f"follow the {compared}; a prediction may leave them.",
        )
    )
    origins = _origins(run)
    for number, origin in enumerate(origins, 1):
        body.append(
            pictures.add(
                _prediction_figure(run, origin, looks, seen),
                f"{stem}_prediction{number}",
                f"Predicted motion against the {compared}, from t = {_second(origin)} s (as "
                "Figures 12 and 16 of the paper). An arrow head marks what leaves its panel.",
            )
        )
    body.append("</div>")
    identified = _number(results.get("settings") or {}, "identify_s")
    if not seen.known and origins:
        # recorded runs are shorter or longer than simulated ones: their first origin tells
        identified = origins[0]
    for name, figure in run.predictors.items():
        if not figure.blocks or not len(figure.xi):
            continue
        body.append(f"<h3>Parameters of {_escape(name)}</h3>")
        body.append('<div class="pictures">')
        for motion in figure.blocks:
            fig = _parameter_figure(
                run, name, motion, looks, identified if math.isfinite(identified) else None
            )
            text = (
                f"Identification of the {motion} parameters by {name} (as Figures 9 to 11 and "
                "13 to 15 of the paper). Early transients may leave the picture."
            )
            body.append(pictures.add(fig, f"{stem}_{name}_{motion}", text))
        body.append("</div>")
    return body


def _text(row: Mapping[str, Any], key: str) -> str:
    value = row.get(key)
    return "" if value is None else str(value)


def _number(row: Mapping[str, Any], key: str) -> float:
    """Return a number of a row; NaN where there is none."""
    value = row.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
        return math.nan
    return float(value)


def _value(value: float) -> str:
    """Return a number for people: three digits, and a dash for what is not known."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    size = abs(value)
    if size >= 1e5:
        return f"{value:.1e}"
    if size >= 100:
        return f"{value:.0f}"
    if size >= 10:
        return f"{value:.1f}"
    if size >= 1:
        return f"{value:.2f}"
    return f"{value:.3f}" if size >= 1e-3 else f"{value + 0.0:.2g}"


def _setting(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        names = (item["name"] if isinstance(item, Mapping) else str(item) for item in value)
        return ", ".join(names) or "none"
    return "none" if value is None else str(value)


def _escape(value: Any) -> str:
    return html.escape(str(value))


_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff;
  max-width: 1240px; margin: 0 auto; padding: 0 12px 48px; overflow-wrap: anywhere; }}
h1 {{ font-size: 1.6rem; line-height: 1.25; }}
h2 {{ font-size: 1.3rem; margin: 2.2em 0 .5em; padding-top: .5em; border-top: 2px solid #ccc; }}
h3 {{ font-size: 1.08rem; margin: 1.8em 0 .5em; }}
p, nav, details {{ max-width: 75ch; }}
pre {{ background: #f3f3f3; padding: 8px 12px; white-space: pre-wrap; border-radius: 4px; }}
nav ul {{ padding-left: 1.2em; }}
nav li {{ padding: 2px 0; }}
details.case {{ max-width: none; margin: .4em 0; }}
details.case > summary {{ cursor: pointer; padding: 4px 0; }}
.note, figcaption {{ color: #444; font-size: .88rem; }}
.scroll {{ overflow-x: auto; max-width: 100%; }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; overflow-wrap: normal; }}
th, td {{ padding: 5px 12px; border-bottom: 1px solid #ddd; text-align: right;
  white-space: nowrap; vertical-align: top; }}
thead th {{ border-bottom: 2px solid #888; vertical-align: bottom; }}
th:first-child, .plain td {{ text-align: left; }}
tbody th {{ font-weight: normal; }}
td small {{ color: #555; }}
.pictures {{ display: grid; gap: 20px 24px; align-items: start;
  grid-template-columns: repeat(auto-fill, minmax(min(100%, 520px), 1fr)); }}
figure {{ margin: 0; min-width: 0; }}
img {{ max-width: 100%; height: auto; display: block; }}
</style>
</head>
<body>
{body}
</body>
</html>
"""
