"""Pictures of ``usv-twin paper`` that the benchmark does not have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from twin.benchmark.figures.style import (
    BLACK,
    DASHED,
    GREY,
    WIDTH,
    Styles,
    dots,
    line,
    new_figure,
    predictor_entries,
    set_ticks,
    set_title,
)
from twin.benchmark.paper.experiment import Trace
from twin.benchmark.paper.findings import CAP_INDEX
from twin.benchmark.paper.rows import PaperRow
from twin.identification.dynamic_window import GAMMA_ENVIRONMENT

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

__all__ = [
    "table_figure",
    "window_figure",
]


MOST = 5
"""Of more numbers at a logarithmic axis, some would touch."""


def table_figure(rows: Sequence[PaperRow], metric: str, styles: Styles) -> Figure:
    """Draw Table 4: a metric of each method with its interval, and the paper's number beside it.

    Parameters
    ----------
    rows : sequence of PaperRow
        Those of Table 4.
    metric : str
        ``"MAE"`` or ``"MSE"``.
    styles : dict
        From :func:`twin.benchmark.figures.predictor_styles`.
    """
    shown = [row for row in rows if row.metric == metric]
    cases = list(dict.fromkeys((row.scenario, row.fault) for row in shown))
    names = list(dict.fromkeys(row.predictor for row in shown))
    here = "here, 95 % interval" if any(row.low is not None for row in shown) else "here"
    entries = [(dots(BLACK, "o"), here), (dots(BLACK, "D", "none"), "the paper")]
    mosaic = [[f"{scenario} {fault}"] for scenario, fault in cases]
    size = (WIDTH, (0.2 * len(names) + 0.45) * len(cases) + 0.2)
    fig, axes = new_figure(f"Table 4: {metric}", "units mixed", entries, mosaic, size)
    for (scenario, fault), ax in zip(cases, axes.values(), strict=True):
        set_title(ax, f"{scenario}, {'no fault' if fault == 'none' else fault}")
        found = {
            row.predictor: row for row in shown if (row.scenario, row.fault) == (scenario, fault)
        }
        for k, name in enumerate(names):
            if (row := found.get(name)) is None:
                continue
            if row.low is not None and row.high is not None:
                ax.plot([row.low, row.high], [k, k], color=styles[name][0], lw=2.0, zorder=2)
            ax.plot([row.ours], [k], "o", color=styles[name][0], ms=5, zorder=3)
            if row.paper is not None:
                ax.plot([row.paper], [k], "D", color=BLACK, fillstyle="none", ms=5, zorder=4)
        ax.set_yticks(range(len(names)), names, fontsize=8.5)
        ax.set_ylim(len(names) - 0.5, -0.5)
        ax.set_xscale("log")
        _number(ax.xaxis)
    return fig


def _number(axis: Axis) -> None:
    """Label a logarithmic axis with three to five plain numbers, whatever its range."""
    from matplotlib.ticker import (
        FixedLocator,
        FuncFormatter,
        LogLocator,
        MaxNLocator,
        NullFormatter,
    )

    low, high = axis.get_view_interval()
    ticks: list[float] = []
    for locator in (
        *(LogLocator(subs=subs, numticks=99) for subs in ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0))),
        MaxNLocator(4, steps=[1, 2, 5, 10]),
    ):
        ticks = [tick for tick in locator.tick_values(low, high) if low <= tick <= high]
        if len(ticks) > 2:
            break
    axis.set_major_locator(FixedLocator(ticks[:: -(-len(ticks) // MOST)]))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def window_figure(
    scenario: str, traced: Mapping[str, Trace], styles: Styles, identified: float
) -> Figure:
    """Draw the window of Algorithm 1 over time, and its two indices.

    Parameters
    ----------
    scenario : str
        Of the run.
    traced : mapping of str to Trace
        By predictor; those with a window.
    styles : dict
        From :func:`twin.benchmark.figures.predictor_styles`.
    identified : float
        Time of the first prediction, s.
    """
    entries = [
        *predictor_entries(traced, styles),
        (line(BLACK, DASHED, 1.0), "first prediction"),
        (line(GREY, "-", 1.0), f"S = {CAP_INDEX:g}: W at its cap"),
    ]
    panels = {
        "W": "length of the window W (rows)",
        "V": "rows that the environment index V adds",
        "S": "nonlinearity index S",
    }
    mosaic = [[panel] for panel in panels]
    fig, axes = new_figure("Algorithm 1 over time", scenario, entries, mosaic, (WIDTH, 4.6))
    for panel, title in panels.items():
        ax = axes[panel]
        set_title(ax, title)
        for name, part in traced.items():
            ax.step(
                part.t,
                _curve(part, panel),
                where="post",
                color=styles[name][0],
                ls=styles[name][1],
                lw=1.5,
            )
        ax.axvline(identified, color=BLACK, ls=DASHED, lw=1.0)
        ax.set_xlim(traced[next(iter(traced))].t[0], max(part.t[-1] for part in traced.values()))
        if panel == "S":
            ax.axhline(CAP_INDEX, color=GREY, lw=1.0)
            ax.set_yscale("log")
            _number(ax.yaxis)
            ax.set_xlabel("time (s)", fontsize=10)
        else:
            set_ticks(ax, 6, 4, None)
    return fig


def _curve(part: Trace, panel: str) -> np.ndarray:
    """Return what a panel shows of a trace, NaN where nothing is known."""
    if panel == "W":
        return np.array(part.window, dtype=np.float64)
    values = np.array(part.V if panel == "V" else part.S, dtype=np.float64)
    return part.base * GAMMA_ENVIRONMENT * values if panel == "V" else values
