"""The curves beside the scene of a view."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.live.sessions.log import LogSession
from twin.live.sessions.session import Session
from twin.live.sessions.tracker import History
from twin.live.ui.panel import HELP, small
from twin.live.ui.scene import GREY, RED
from twin.predictors.base import Z90
from usv_gym.envs.scene import SDS

if TYPE_CHECKING:
    import viser

__all__ = ["Curves"]

Array = NDArray[np.float64]

HEIGHT, LOW = 150, 120
"""Heights of a curve, and of one of many, pixels: all of a tab fit into 720."""

SHOWN_S = 300.0
"""The end of a run that the curves show."""


class DeckCurve(NamedTuple):
    """One curve of the deck's motion."""

    title: str
    column: int  # of the forecast
    unit: float  # of what is drawn


DECK_CURVES = (
    DeckCurve("roll ahead (deg)", 0, math.radians(1.0)),
    DeckCurve("pitch ahead (deg)", 1, math.radians(1.0)),
    DeckCurve("heave ahead, down (m)", 2, 1.0),
    DeckCurve("speed of the deck down (m/s)", 3, 1.0),
)

POINTS_AHEAD = 61
"""Points of these curves."""

WIDTH_PX = 350
"""Width of the panel."""

STYLE = "<style>.uplot { width: 100% !important; }</style>"
"""A curve begins 0 pixels wide, and grows: its title and legend have their place from the begin."""


def by_equation(blocks: Mapping[str, tuple[int, int]]) -> dict[str, tuple[int, int]]:
    """Return blocks of parameters that follow each other, those of two equations by themselves.

    The span of a block may hold all of the one before it: then that one keeps its own.
    """
    spans, found, end = list(blocks.items()), dict[str, tuple[int, int]](), 0
    for k, (name, (first, last)) in enumerate(spans):
        first = max(first, end)
        after, begins = (spans[k + 1][0], spans[k + 1][1][0]) if k + 1 < len(spans) else ("", last)
        common = begins if first < begins < last else last
        found |= {name: (first, common), f"{name} and {after}": (common, last)}
        end = last
    return {name: ends for name, ends in found.items() if ends[0] < ends[1]}


class Curves:
    """The panel on the right: how well the twin does, and what it makes of the boat."""

    def __init__(self, server: viser.ViserServer, session: Session) -> None:
        self.gui, self.session = server.gui, session
        self.style = server.gui.add_html(STYLE)
        self.panel = server.gui.add_panel()
        with self.panel.add_tab("Prediction"):
            self.error = self._curve(
                "error after 10 s (m)",
                ("twin", RED, ()),
                ("velocity and turn rate held", GREY, (6.0, 4.0)),
            )
        self.blocks = by_equation(session.monitor.twin.predictor.parameter_blocks)
        names = session.monitor.twin.predictor.parameter_names
        units = session.monitor.twin.predictor.parameter_units
        self.parameters: list[tuple[Any, Any]] = []
        with self.panel.add_tab("Parameters"):
            if not self.blocks:
                self.gui.add_markdown("This predictor has no model, and identifies no parameters.")
            for block, (first, last) in self.blocks.items():
                choice = self.gui.add_dropdown(block, names[first:last])
                curve = self._curve(
                    f"{names[first]} ({units[first]})",
                    ("estimate", RED, ()),
                    (f"- {SDS:g} sd", RED, (3.0, 3.0)),
                    (f"+ {SDS:g} sd", RED, (3.0, 3.0)),
                    low=True,
                )
                self.parameters.append((choice, curve))
        with self.panel.add_tab("Deck"):
            self.no_deck = self.gui.add_markdown(
                "Nothing measures roll and pitch. A log needs one of the columns `gyro_x_radps` to "
                "`gps_vz_mps`, a simulated boat `--dof 6`."
            )
            self.deck = [
                self._curve(
                    drawn.title,
                    ("forecast", RED, ()),
                    ("5 %", RED, (3.0, 3.0)),
                    ("95 %", RED, (3.0, 3.0)),
                    time="time ahead (s)",
                    low=True,
                )
                for drawn in DECK_CURVES
            ]
        with self.panel.add_tab("Help"):
            self.gui.add_html(small(*HELP))
        self.names, self.units = names, units
        self.panel.dock_right()
        self.panel.set_width(WIDTH_PX)

    def show(self) -> None:
        """Draw the curves up to now."""
        seen = self.session.history()
        if not isinstance(self.session, LogSession):
            seen = seen.since(SHOWN_S)
        if len(seen.t) < 2:  # nothing yet, or back at the begin of a log
            nothing = np.full(2, math.nan)
            none = np.full((2, len(self.names)), math.nan)
            seen = History(np.arange(2.0), nothing, nothing, none, none)
        self._draw(self.error, seen.t, seen.error, seen.error_hold)
        self._show_deck()
        for choice, curve in self.parameters:
            column = self.names.index(choice.value)
            title = f"{choice.value} ({self.units[column]})"
            if curve.title != title:
                curve.title = title
                curve.axes = axes(title)
            self._draw(curve, seen.t, *interval(seen, column))

    def _show_deck(self) -> None:
        """Draw the forecast of roll, pitch, heave and deck speed, if there is one."""
        now = self.session.snapshot
        motion = None if now is None else now.motion
        self.no_deck.visible = motion is None
        for curve, drawn in zip(self.deck, DECK_CURVES, strict=True):
            curve.visible = motion is not None
            if motion is not None:
                ahead = np.linspace(0.0, float(motion.t[-1] - motion.t0), POINTS_AHEAD)
                mean, sd = (part[:, drawn.column] / drawn.unit for part in motion.at(ahead))
                self._draw(curve, ahead, mean, mean - Z90 * sd, mean + Z90 * sd)

    def _curve(
        self,
        title: str,
        *series: tuple[str, Any, tuple[float, ...]],
        low: bool = False,
        time: str = "time (s)",
    ) -> Any:
        lines: list[dict[str, Any]] = [{"label": time}]
        lines += [
            {"label": label, "stroke": f"rgb{colour}", "width": 2, "dash": dash, "spanGaps": False}
            for label, colour, dash in series
        ]
        nothing = np.array([0.0, 1.0])
        return self.gui.add_uplot(
            (nothing, *(np.zeros(2) for _ in series)),
            tuple(lines),
            title=title,
            scales={"x": {"time": False, "auto": True}, "y": {"auto": True}},
            axes=axes(title, time),
            legend={"show": len(series) > 1 and not low, "live": False},
            height=LOW if low else HEIGHT,
            padding=(8, 22, 0, 0),
        )

    @staticmethod
    def _draw(handle: Any, t: Array, *values: Array) -> None:
        """Draw what is known; of less than a line, an empty plot."""
        rows = np.isfinite(np.stack(values)).any(axis=0)
        if rows.sum() < 2:
            # viser scales time by its old range: without one, it would show nothing ever after
            handle.data = (t[[0, -1]], *(np.full(2, math.nan) for _ in values))
            return
        # the browser cannot draw NaN: gaps of a curve are interpolated
        handle.data = (t[rows], *(padded(value[rows]) for value in values))


def padded(values: Array) -> Array:
    """Return a curve with its gaps drawn through; one of nothing is 0."""
    known = np.isfinite(values)
    if not known.any():
        return np.zeros(len(values))
    return np.interp(np.arange(len(values)), np.flatnonzero(known), values[known])


def axes(title: str, time: str = "time (s)") -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the axes of a curve over time."""
    unit = title[title.rindex("(") + 1 : title.rindex(")")]
    return (
        {"label": time, "labelSize": 18, "size": 30},
        {"label": unit, "labelSize": 18, "size": 48},
    )


def interval(seen: History, column: int) -> tuple[Array, Array, Array]:
    """Return a parameter and the ends of its interval, each (n,)."""
    middle, off = seen.params[:, column], SDS * seen.params_sd[:, column]
    return middle, middle - off, middle + off
