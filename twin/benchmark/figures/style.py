"""The look of all pictures: colours, legends, axes, ticks and limits."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twin.logs.log import Log

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

Windows = Sequence[tuple[float, float]]

Styles = Mapping[str, tuple[str, Any]]
"""Colour and line style of each predictor."""

Entry = tuple[Any, str]
"""Handle and label of a legend."""

DPI = 130

WIDTH = 4.6
"""Width of a picture in the report, inch."""

# Okabe and Ito's colours suit any kind of colour vision; the line styles need no colours.
BLACK, GREY, YELLOW = "#000000", "#808080", "#F0E442"

STYLES: dict[str, tuple[str, Any]] = {
    "persistence": ("#E69F00", (0, (1.2, 1.2))),
    "persistence-8s": ("#56B4E9", (0, (4, 1.5))),
    "ukf": ("#0072B2", (0, (5, 1.2, 1.2, 1.2))),
    "dsw-ukf": ("#009E73", (0, (8, 2))),
    "lstm": ("#CC79A7", (0, (3, 1, 1, 1, 1, 1))),
    "dsw-ukf-plus": ("#D55E00", "-"),
    "oracle": (GREY, (0, (1, 2.5))),
}

# of other predictors: from Tol's muted scheme, for the same readers
MORE_COLOURS = ("#882255", "#999933", "#332288", "#44AA99", "#661100")

MORE_LINES: tuple[Any, ...] = (
    (0, (2.5, 1)),
    (0, (6, 1, 2, 1)),
    (0, (10, 2, 2, 2)),
    (0, (5, 1, 1, 1, 1, 1, 1, 1)),
    (0, (2, 2.5)),
)

DASHED = (0, (4, 1.5))


def predictor_styles(names: Iterable[str]) -> dict[str, tuple[str, Any]]:
    """Return colour and line style of each predictor, the same ones in every picture."""
    styles: dict[str, tuple[str, Any]] = {}
    for name in names:
        k = sum(other not in STYLES for other in styles)
        more = MORE_COLOURS[k % len(MORE_COLOURS)], MORE_LINES[k % len(MORE_LINES)]
        styles[name] = STYLES.get(name, more)
    return styles


# legends
def line(colour: str, style: Any = "-", width: float = 1.8) -> Any:
    """Return a line for a legend."""
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, ls=style, lw=width)


def dots(colour: str, marker: str = ".") -> Any:
    """Return markers for a legend."""
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, ls="", marker=marker, ms=6)


def patch(colour: str, alpha: float = 1.0) -> Any:
    """Return an area for a legend."""
    from matplotlib.patches import Patch

    return Patch(facecolor=colour, alpha=alpha)


def predictor_entries(names: Iterable[str], styles: Styles) -> list[Entry]:
    """Return the legend's entries of predictors."""
    return [(line(*styles[name]), name) for name in names]


# figures and axes
def new_figure(
    title: str,
    about: str,
    entries: Sequence[Entry],
    mosaic: list[list[Any]],
    size: tuple[float, float],
) -> tuple[Figure, dict[Any, Axes]]:
    """Return a picture with title and legend above its panels.

    ``about`` stands below the title. ``entries`` are the (handle, text) of the legend, ``mosaic``
    as for ``Figure.subplot_mosaic``, ``size`` the width and the height without the legend, inch.
    """
    from matplotlib.figure import Figure

    width, height = size
    handles, labels = zip(*entries, strict=True)
    # a letter is 0.08 inch wide on average; line and gaps 0.58
    columns = max(1, min(len(entries), int(width / (0.08 * max(map(len, labels)) + 0.58))))
    height += 0.55 + 0.19 * -(-len(entries) // columns)
    fig = Figure(figsize=(width, height), dpi=DPI, facecolor="white", layout="constrained")
    legend = fig.legend(
        handles,
        labels,
        title=f"{title}\n{fill(about, int(width / 0.08))}",
        title_fontsize=10,
        alignment="left",
        loc="outside upper left",
        ncols=columns,
        frameon=False,
        fontsize=9.5,
        borderaxespad=0.2,
        handlelength=2.8,
    )
    for text in (legend.get_title(), *legend.get_texts()):
        text.set_parse_math(False)
    axes = fig.subplot_mosaic(mosaic)
    for ax in axes.values():
        ax.tick_params(labelsize=9, length=0, pad=3)
        ax.spines[["top", "right"]].set_visible(False)
        ax.spines[["left", "bottom"]].set_color(GREY)
        ax.grid(True, lw=0.4, color="#DDDDDD")
        ax.set_axisbelow(True)
    return fig, axes


def set_title(ax: Axes, text: str) -> None:
    """Write a panel's title; with a given height, matplotlib does not search for one."""
    ax.set_title(text, loc="left", fontsize=10, pad=5, y=1.0, parse_math=False)


def set_ticks(ax: Axes, across: int, up: int, label: str | None) -> None:
    """Set the largest numbers of ticks, and the horizontal axis's label; None hides its numbers."""
    from matplotlib.ticker import MaxNLocator

    ax.xaxis.set_major_locator(MaxNLocator(across, steps=[1, 2, 5, 10]))
    ax.yaxis.set_major_locator(MaxNLocator(up, steps=[1, 2, 5, 10]))
    if label is None:
        ax.tick_params(labelbottom=False)
    else:
        ax.set_xlabel(label, fontsize=10)


def lost_within(lost: Windows, log: Log) -> list[tuple[float, float]]:
    """Return the times without GPS that fall into a log."""
    return [(a, b) for a, b in lost if len(log) and b > log.t[0] and a < log.t[-1]]


def shade_lost(ax: Axes, lost: Windows, origin: float = 0.0) -> None:
    """Shade the times without GPS; ``origin`` is the time at the axis's 0."""
    for a, b in lost:
        ax.axvspan(a - origin, b - origin, color=YELLOW, alpha=0.3, lw=0, zorder=0)


def limits_of(parts: Iterable[Array], least: float, margin: float) -> tuple[float, float]:
    """Return the range of the finite values, at least so wide, with a margin on both sides."""
    values = np.concatenate([np.zeros(0), *(np.ravel(part) for part in parts)])
    values = values[np.isfinite(values) & (np.abs(values) < 1e12)]
    if not len(values):
        return -1.0, 1.0
    low, high = float(values.min()), float(values.max())
    wide = max(high - low, least, 1e-6 + 1e-3 * max(abs(low), abs(high)))
    middle, half = 0.5 * (low + high), (0.5 + margin) * wide
    return middle - half, middle + half


# files
def picture_bytes(fig: Figure, kind: str) -> bytes:
    """Return a picture as a file of a kind, svg or pdf; equal pictures are equal bytes."""
    import matplotlib

    no_date = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    buffer = io.BytesIO()
    with matplotlib.rc_context(
        {
            "svg.fonttype": "none",  # text as text
            "svg.hashsalt": "usv-twin",
            "pdf.fonttype": 42,  # TrueType, as journals ask for
            "font.sans-serif": [
                "DejaVu Sans",
                "Verdana",
                "sans-serif",
            ],  # the first two are as wide
            "path.simplify_threshold": 0.5,
        }
    ):
        if (layout := fig.get_layout_engine()) is not None:
            # matplotlib would draw the whole picture once more to lay it out
            fig.set_layout_engine(None)
            layout.execute(fig)
        fig.savefig(buffer, format=kind, metadata=no_date[kind])
    return buffer.getvalue()
