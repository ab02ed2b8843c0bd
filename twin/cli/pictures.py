"""The picture of ``usv-twin check``: what is in a log, and what a twin of it is worth."""

from __future__ import annotations

import dataclasses
import functools
import io
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.benchmark.figures.style import (
    BLACK,
    DASHED,
    Array,
    Entry,
    line,
    new_figure,
    set_ticks,
    set_title,
)
from twin.benchmark.trust import HORIZON_S, Verdict
from twin.integrity.findings import SEVERITIES
from twin.integrity.log_check import LogCheck
from twin.integrity.rows import speed_of
from twin.logs.recording import Recording
from twin.logs.signals import ENOUGH, integrated, sampled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Panel = Callable[[Any, Recording], None]
"""Draws what a recording has into a panel."""

BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"

DRAWN_MAX = 1e7
"""Larger values are not drawn."""

POINTS_MAX = 4000
"""Points of a curve at most."""

PATHS_MAX = 40
"""Forecasts in the track at most."""


def draw_check(check: LogCheck, verdict: Verdict | None = None) -> bytes:
    """Return the picture of a checked log as PNG.

    Parameters
    ----------
    check : LogCheck
        Of a log of two rows or more.
    verdict : Verdict, optional
        On a twin of that log: three panels more.
    """
    recording = _drawable(check.recording)
    counts = {severity: check.count(severity) for severity in SEVERITIES}
    about = ", ".join(f"{n} {severity}(s)" for severity, n in counts.items() if n)
    about = about or "nothing found"
    entries: list[Entry] = [
        (line(BLUE), "fixes; left unit"),
        (line(ORANGE), "compass, velocity; right unit"),
        (line(GREEN), "gyro; steering angle"),
    ]
    track = functools.partial(_track, verdict=verdict)
    left: dict[str, Panel] = {"track": track, "commands": _commands}
    right: dict[str, Panel] = {"speed": _speed, "turn": _turn, "heading": _heading}
    colours = {name: _colours(draw, recording) for name, draw in (left | right).items()}
    seen = set[str]().union(*colours.values())
    entries = [entry for entry in entries if entry[0].get_color() in seen] or entries
    columns = [[name for name in side if colours[name]] for side in (left, right)]
    columns = [names for names in columns if names] or [["commands"]]
    rows = math.prod(map(len, columns))
    mosaic = [[names[k * len(names) // rows] for names in columns] for k in range(rows)]
    size = (11.0, 7.0)
    if verdict is not None:
        about = f"{about}; {verdict.predictor}: {verdict.grade} (" + ", ".join(
            f"{answer.about} {answer.grade}" for answer in verdict.answers
        )
        about += ")"
        entries += [(line(BLACK), "forecasts of the twin"), (line(ORANGE, DASHED), "persistence")]
        for name in ("distance", "turned"):
            mosaic += [[name, "losses"]] * -(-rows // 4)
        size = (11.0, 11.0)
    fig, axes = new_figure(f"{recording.name}: check", about, entries, mosaic, size)
    for name, draw in (left | right).items():
        if name in axes:
            draw(axes[name], recording)
    if verdict is not None:
        _errors(axes["distance"], verdict, 0, 1.0, "distance off, m")
        _errors(axes["turned"], verdict, 1, 180.0 / math.pi, "heading off, degrees")
        _losses(axes["losses"], verdict)
    over_time = {"speed", "turn", "heading", "commands", "distance", "turned"}
    for name in over_time & set(axes):
        axes[name].set_xlim(float(recording.t[0]), float(recording.t[-1]))
        set_ticks(axes[name], 6, 4, None if name in columns[-1][:-1] else "time, s")
    buffer = io.BytesIO()
    fig.savefig(buffer, format="png")
    return buffer.getvalue()


def _colours(draw: Panel, recording: Recording) -> set[str]:
    """Return the colours of the curves that a panel has; none where a log lacks what it shows."""
    from matplotlib.figure import Figure

    draw(ax := Figure().add_subplot(), recording)
    curves = (curve for curve in ax.lines if np.isfinite(curve.get_xydata()).all(axis=1).any())
    return {str(curve.get_color()) for curve in curves}


def _drawable(recording: Recording) -> Recording:
    """Return a recording without the numbers that no picture can hold."""
    z, cmd = (np.where(np.abs(v) < DRAWN_MAX, v, np.nan) for v in (recording.z, recording.cmd))
    return dataclasses.replace(recording, z=z, cmd=cmd)


def _thin(*columns: Array) -> list[Array]:
    """Return every so-many-th value of columns, so that there are few."""
    step = max(len(columns[0]) // POINTS_MAX, 1)
    return [column[::step] for column in columns]


def _track(ax: Axes, recording: Recording, verdict: Verdict | None) -> None:
    set_title(ax, "track, m, coloured by speed, m/s")
    t, fix = recording.samples("gps_x_m", "gps_y_m")
    motion = speed_of(recording)
    if motion is None or len(t) < ENOUGH:
        return
    x, y, at = _thin(fix[:, 0], fix[:, 1], t)
    speed = np.interp(at, motion[0], np.nan_to_num(np.hypot(*motion[1].T)))
    drawn = ax.scatter(y, x, c=speed, s=4, cmap="viridis", lw=0)
    ax.plot(y[:1], x[:1], marker="o", ms=8, mfc="none", mec=BLACK, ls="")
    if verdict is not None:
        every = max(len(verdict.forecasts) // PATHS_MAX, 1)
        for forecast in verdict.forecasts[::every]:
            ax.plot(forecast.path[:, 1], forecast.path[:, 0], color=BLACK, lw=1.0)
    bar = ax.figure.colorbar(drawn, ax=ax, shrink=0.6, pad=0.02)
    bar.ax.tick_params(labelsize=9, length=0)
    ax.set_aspect("equal", adjustable="datalim")
    set_ticks(ax, 5, 6, "east")
    ax.set_ylabel("north", fontsize=10)


def _speed(ax: Axes, recording: Recording) -> None:
    set_title(ax, "speed over ground, m/s")
    t, velocity = recording.samples("gps_vx_mps", "gps_vy_mps")
    if len(t):
        at, speed = _thin(t, np.hypot(*velocity.T))
        ax.plot(at, speed, color=ORANGE, lw=1.0)
    motion = speed_of(recording)
    if motion is not None:
        ax.plot(motion[0], np.hypot(*motion[1].T), color=BLUE, lw=1.6)


def _turn(ax: Axes, recording: Recording) -> None:
    set_title(ax, "yaw rate, deg/s")
    t, compass = recording.samples("compass_rad")
    t_gyro, gyro = recording.samples("gyro_radps")
    grid = np.linspace(recording.t[0], recording.t[-1], min(POINTS_MAX, len(recording.t)))
    turned = integrated(t_gyro, gyro[:, 0]) if len(t_gyro) > 1 else gyro[:, 0]
    for at, angle, colour, style in (
        (t, np.unwrap(compass[:, 0]), ORANGE, "-"),
        (t_gyro, turned, GREEN, DASHED),
    ):
        if len(at) >= ENOUGH:
            rate = sampled(at, angle, grid + 0.5) - sampled(at, angle, grid - 0.5)
            ax.plot(grid, np.degrees(rate), color=colour, ls=style, lw=1.0)


def _heading(ax: Axes, recording: Recording) -> None:
    set_title(ax, "course and heading, deg")
    t, compass = recording.samples("compass_rad")
    at, psi = _thin(t, np.degrees(np.remainder(compass[:, 0], 2.0 * math.pi)))
    ax.plot(at, psi, color=ORANGE, ls="", marker=".", ms=2)
    motion = speed_of(recording)
    if motion is not None:
        course = np.degrees(np.arctan2(motion[1][:, 1], motion[1][:, 0])) % 360.0
        ax.plot(motion[0], course, color=BLUE, ls="", marker=".", ms=3)
    ax.set_ylim(0.0, 360.0)


def _commands(ax: Axes, recording: Recording) -> None:
    set_title(ax, "commands: shaft speeds, rev/s; angle, deg")
    for j, colour, scale in ((0, BLUE, 1.0), (1, ORANGE, 1.0), (2, GREEN, 180.0 / math.pi)):
        if np.nan_to_num(recording.cmd[:, j]).any():
            at, value = _thin(recording.t, scale * recording.cmd[:, j])
            ax.plot(at, value, color=colour, lw=1.0)


def _errors(ax: Axes, verdict: Verdict, k: int, scale: float, title: str) -> None:
    """Draw the errors of twin and persistence over the time at which they were made."""
    set_title(ax, f"{title}, {HORIZON_S:g} s ahead")
    t = [forecast.t for forecast in verdict.forecasts]
    held = [scale * f.persistence[k] for f in verdict.forecasts]
    ax.plot(t, held, color=ORANGE, lw=1.0, ls=DASHED)
    ax.plot(t, [scale * f.error[k] for f in verdict.forecasts], color=BLACK, lw=1.4)
    ax.set_ylim(bottom=0.0)


def _losses(ax: Axes, verdict: Verdict) -> None:
    """Draw the error of each loss of GPS, and the bound."""
    set_title(ax, "position off without GPS, m; a line is one loss")
    for loss in verdict.losses:
        ax.plot(loss.after, loss.error, color=BLACK, lw=1.0)
    ax.axhline(verdict.bound, color=ORANGE, lw=1.0, ls=DASHED)
    ax.set_ylim(0.0, 3.0 * verdict.bound)
    set_ticks(ax, 6, 4, "time without GPS, s")
