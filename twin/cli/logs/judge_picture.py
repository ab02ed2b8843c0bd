"""The picture of ``usv-twin judge``: track, forecasts, losses of GPS, parameters."""

from __future__ import annotations

import io
import math
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from twin.benchmark.figures.style import (
    BLACK,
    DASHED,
    Entry,
    dots,
    line,
    new_figure,
    set_ticks,
    set_title,
)
from twin.benchmark.trust import HORIZON, Verdict
from twin.benchmark.trust_answers import FAR
from twin.logs.log import Log

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BLUE, ORANGE = "#0072B2", "#D55E00"

_PATHS, _BARS = 40, 12
"""Most forecasts in the track, and most parameters."""


def draw_verdict(verdict: Verdict, log: Log) -> bytes:
    """Return the picture of a verdict as PNG."""
    entries: list[Entry] = [
        (line(BLUE), f"twin, {HORIZON:g} s ahead"),
        (line(ORANGE), "persistence: velocities held"),
        (dots(BLACK), "fixes"),
        (line(BLACK, DASHED), "limit"),
    ]
    mosaic = [["track", "distance"], ["track", "heading"], ["parameters", "losses"]]
    fig, axes = new_figure(
        f"{verdict.log}: {verdict.colour}",
        f"{verdict.predictor}; "
        + ", ".join(f"{answer.about} {answer.colour}" for answer in verdict.answers),
        entries,
        mosaic,
        (11.0, 9.0),
    )
    _track(axes["track"], verdict, log)
    for k, (name, unit, scale) in enumerate(
        (("distance", "m", 1.0), ("heading", "degrees", 180.0 / math.pi))
    ):
        _errors(axes[name], verdict, k, scale)
        set_title(axes[name], f"{name} off after {HORIZON:g} s, {unit}")
    _losses(axes["losses"], verdict)
    _parameters(axes["parameters"], verdict)
    buffer = io.BytesIO()
    fig.savefig(buffer, format="png")
    return buffer.getvalue()


def _track(ax: Axes, verdict: Verdict, log: Log) -> None:
    """Draw the fixes, and forecasts from where they were made."""
    set_title(ax, "track and forecasts from points of it, m")
    seen = np.isfinite(log.z[:, :2]).all(axis=1)
    ax.plot(log.z[seen, 1], log.z[seen, 0], color=BLACK, ls="", marker=".", ms=2)
    every = max(len(verdict.forecasts) // _PATHS, 1)
    for forecast in verdict.forecasts[::every]:
        ax.plot(forecast.path[:, 1], forecast.path[:, 0], color=BLUE, lw=1.2)
    ax.set_aspect("equal", adjustable="datalim")
    set_ticks(ax, 5, 6, "east")
    ax.set_ylabel("north", fontsize=10)


def _errors(ax: Axes, verdict: Verdict, k: int, scale: float) -> None:
    """Draw the errors of twin and persistence over the time at which they were made."""
    t = [forecast.t for forecast in verdict.forecasts]
    ax.plot(t, [scale * f.persistence[k] for f in verdict.forecasts], color=ORANGE, lw=1.0)
    ax.plot(t, [scale * f.error[k] for f in verdict.forecasts], color=BLUE, lw=1.6)
    set_ticks(ax, 6, 4, "time, s")
    ax.set_ylim(bottom=0.0)


def _losses(ax: Axes, verdict: Verdict) -> None:
    """Draw the error of each loss of GPS, and the bound."""
    set_title(ax, "position off without GPS, m; a line is one loss")
    for loss in verdict.losses:
        ax.plot(loss.after, loss.error, color=BLUE, lw=1.0)
    ax.axhline(verdict.bound, color=BLACK, lw=1.0, ls=DASHED)
    ax.set_ylim(0.0, 3.0 * verdict.bound)
    set_ticks(ax, 6, 4, "time without GPS, s")


def _parameters(ax: Axes, verdict: Verdict) -> None:
    """Draw the parameters that went furthest from the prior."""
    prior = verdict.in_use if verdict.in_use and verdict.in_use.is_prior else None
    title = "best refit, not in use: the prior is" if prior else "parameters farthest from prior"
    set_title(ax, title)
    empty = "" if verdict.deviations else "the predictor has no parameters"
    if prior and prior.refit is None:
        empty = f"in use: {prior.name}"
    if empty:
        ax.text(0.5, 0.5, fill(empty, 28), ha="center", va="center", transform=ax.transAxes)
        ax.set_axis_off()
        return
    shown = dict(verdict.deviations[:_BARS])
    sizes = [min(size, 4.0 * FAR) for size in shown.values()]
    colours = [ORANGE if size > FAR else BLUE for size in sizes]
    ax.barh(range(len(shown)), sizes, color=colours)
    ax.axvline(FAR, color=BLACK, lw=1.0, ls=DASHED)
    set_ticks(ax, 5, len(shown) or 1, "prior standard deviations")
    ax.set_yticks(range(len(shown)), list(shown))
    ax.set_ylim(max(len(shown), 1) - 0.4, -0.6)
