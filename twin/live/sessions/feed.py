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
from twin.live.sessions.session import LAG_MAX_S, Session, Snapshot, measured_boat
from twin.live.sessions.tracker import TwinMonitor
from twin.logs.datum import Datum
from twin.logs.wire.feed import Feed
from usv_gym.vessel.vessel import Vessel

__all__ = [
    "FeedSession",
]

Array = NDArray[np.float64]

SILENT_AFTER_S = 2.0
"""Time of the clock without a row after which a feed counts as silent."""


class FeedSession(Session):
    """A real boat, or an autopilot's simulator, as it comes over the wire.

    The feed is closed at the end. Logs are recorded to ``folder``.
    """

    def __init__(self, feed: Feed, twin: Twin, vessel: Vessel | None, folder: Path) -> None:
        super().__init__(vessel, twin.particulars, folder)
        self.feed = feed
        self.monitor, self._cmd = TwinMonitor(twin), np.zeros(len(COMMANDS))
        self._heard = math.nan
        self._waiting: deque[tuple[float, Array, Array]] = deque()

    def _close(self) -> None:
        self.feed.close()
        super()._close()

    def _advance(self) -> None:
        begun = time.monotonic()
        if not self._waiting:
            self._waiting.extend(self.feed.take())
        while self._waiting and time.monotonic() < begun + LAG_MAX_S:
            t, z, cmd = self._waiting.popleft()
            self.monitor.step(t, z, cmd)
            self._cmd, self._heard = cmd, time.monotonic()
            self._keep(t, z, cmd)

    def _look(self) -> Snapshot | None:
        monitor = self.monitor
        if not math.isfinite(monitor.t):
            return None
        silence = time.monotonic() - self._heard
        silence = silence if silence > SILENT_AFTER_S else 0.0
        boat = measured_boat(monitor.measured, self._cmd)
        return self._seen(boat, silence, notes=self.notes)

    @property
    def datum(self) -> Datum | None:
        """The first fix."""
        plane = self.feed.plane
        return None if plane is None else Datum(latitude=plane.latitude, longitude=plane.longitude)

    @property
    def notes(self) -> tuple[str, ...]:
        """What came over the wire, in words."""
        counts = ", ".join(f"{name} {n}" for name, n in self.feed.counts.items() if n)
        return (counts, *self.feed.notes)
