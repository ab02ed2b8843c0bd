"""Forecasts of roll and pitch scored while a twin runs, against what it finds two seconds later."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.motion.deck_motion import Z90, DeckMotion, MotionForecast
from twin.motion.forecast_state import PITCH
from twin.motion.state import ANGLE

__all__ = ["TILT_HORIZON", "TiltMeter", "TiltScore"]

Array = NDArray[np.float64]

TILT_HORIZON = 2.0
"""Of the forecasts that are scored, s: beyond, hardly a phase of a wave can be known."""

_ANGLES = PITCH + 1


class TiltScore(NamedTuple):
    """How forecasts of roll and pitch turned out."""

    n: int
    seconds: float  # from the first to the last
    error: Array  # (2,) root mean square, rad
    held: Array  # (2,) the same of the present angle, held, rad
    known: Array  # (2,) standard deviation of the angle of now, root mean square, rad
    inside: Array  # (2,) share inside the 90 % interval


class TiltMeter:
    """Compares forecasts of roll and pitch with the estimate of later rows.

    Parameters
    ----------
    motion : DeckMotion
        Of the twin that runs; it is only read.
    """

    def __init__(self, motion: DeckMotion) -> None:
        self._motion = motion
        self._due: deque[MotionForecast] = deque()
        self._found: list[tuple[Array, Array, Array, Array]] = []
        self._made: list[float] = []

    def note(self, forecast: MotionForecast | None) -> None:
        """Keep a forecast to be scored; those before the first verified one say little."""
        if forecast is not None and forecast.ready:
            self._due.append(forecast)

    def take(self, t: float) -> None:
        """Score what is due after the row of time t, s."""
        while self._due and t >= self._due[0].t0 + TILT_HORIZON - 1e-9:
            made = self._due.popleft()
            if t > made.t0 + 2.0 * TILT_HORIZON:
                continue  # the log has a gap
            mean, sd = made.at([t - made.t0])
            angle = self._motion.record["attitude"]["tilt"][:, ANGLE]
            error = mean[0, :_ANGLES] - angle
            held = made.mean[0, :_ANGLES] - angle
            inside = np.abs(error) <= Z90 * sd[0, :_ANGLES]
            self._made.append(made.t0)
            self._found.append((error, held, made.sd[0, :_ANGLES], inside.astype(np.float64)))

    def score(self) -> TiltScore | None:
        """Return how the forecasts turned out; None where none could be scored."""
        if not self._found:
            return None
        error, held, sd, inside = map(np.array, zip(*self._found, strict=True))
        error, held, sd = (np.sqrt(np.mean(part**2, axis=0)) for part in (error, held, sd))
        seconds = self._made[-1] - self._made[0]
        return TiltScore(len(self._found), seconds, error, held, sd, inside.mean(axis=0))
