"""A real boat, or an autopilot's simulator, as a session."""

from __future__ import annotations

import math
import time
from collections import deque
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.channels import COMMANDS
from twin.digital_twin import Twin
from twin.live.protocols.feed import Feed
from twin.live.sessions.session import MAX_LAG, Session, Snapshot, measured_boat
from twin.live.sessions.tracker import TwinMonitor
from twin.logs.datum import Datum
from twin.predictors.base import Prediction
from usv_gym.vessel.vessel import Vessel

__all__ = [
    "FeedSession",
]

Array = NDArray[np.float64]

REPLY = 0.2
"""Time between two answers to a feed, s."""

SILENT = 2.0
"""After so much time of the clock without a row, s, a feed counts as silent."""


class FeedSession(Session):
    """A real boat, or an autopilot's simulator, as it comes over the wire.

    The feed, which the twin's estimates go back to, is closed at the end. Logs are recorded to
    ``folder``.
    """

    offers = "restart its twin, and record logs to the folder of --out"

    def __init__(self, feed: Feed, twin: Twin, vessel: Vessel | None, folder: Path) -> None:
        super().__init__(vessel, twin.particulars, folder)
        self.feed = feed
        self.monitor, self._cmd = TwinMonitor(twin), np.zeros(len(COMMANDS))
        self._answered, self._heard = -math.inf, math.nan
        self._waiting: deque[tuple[float, Array, Array]] = deque()

    def _close(self) -> None:
        self.feed.close()
        super()._close()

    def _advance(self) -> None:
        begun = time.monotonic()
        if not self._waiting:
            self._waiting.extend(self.feed.take())
        while self._waiting and time.monotonic() < begun + MAX_LAG:
            t, z, cmd = self._waiting.popleft()
            self.monitor.step(t, z, cmd)
            self._took(t, z)
            self._cmd, self._heard = cmd, time.monotonic()
            self._keep(t, z, cmd)

    def _look(self) -> Snapshot | None:
        monitor = self.monitor
        if not math.isfinite(monitor.t):
            return None
        now = time.monotonic()
        silence = now - self._heard
        silence = silence if silence > SILENT else 0.0
        boat = measured_boat(monitor.measured, self._cmd)
        rate = self._rate(monitor.t) if silence == 0.0 else 0.0
        seen = self._seen(boat, silence, rate=rate, notes=self.notes)
        # no estimates go out for a boat that is no longer heard of
        if seen.prediction is not None and silence == 0.0 and now >= self._answered + REPLY:
            self._answered = now
            self._reply(seen.prediction)
        return seen

    def _took(self, t: float, z: Array) -> None:
        """Do what is due after each row."""

    def _reply(self, prediction: Prediction) -> None:
        """Send estimate and prediction back."""
        twin = self.monitor.twin
        self.feed.send(twin.estimate(), prediction, twin.health)

    @property
    def datum(self) -> Datum | None:
        """The first fix."""
        if self.feed.origin is None:
            return None
        return Datum(latitude=self.feed.origin[0], longitude=self.feed.origin[1])

    @property
    def notes(self) -> tuple[str, ...]:
        """What came over the wire, in words."""
        counts = ", ".join(f"{name} {n}" for name, n in self.feed.counts.items() if n)
        return (counts, *self.feed.notes)
