"""A real boat, or an autopilot's simulator, as a session."""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np

from twin.live.feed import Feed
from twin.live.follower import Follower
from twin.live.session import Session, Snapshot, measured_boat
from twin.log import COMMANDS
from twin.twin import Twin
from usv_gym.vessel import Vessel

__all__ = ["FeedSession"]

REPLY = 0.2
"""Time between two answers to a feed, s."""


class FeedSession(Session):
    """A real boat, or an autopilot's simulator, as it comes over the wire.

    Parameters
    ----------
    feed : Feed
        Where rows come from, and the twin's belief goes back to; closed at the end.
    twin : Twin
        Fresh.
    vessel : Vessel or None
        Whose hull is shown.
    folder : Path
        Where recorded logs go.
    """

    def __init__(self, feed: Feed, twin: Twin, vessel: Vessel | None, folder: Path) -> None:
        super().__init__(vessel, twin.particulars, folder)
        self.feed = feed
        self._follower, self._cmd = Follower(twin), np.zeros(len(COMMANDS))
        self._answered = -math.inf

    @property
    def follower(self) -> Follower:
        """The twin and what is seen of it."""
        return self._follower

    def _close(self) -> None:
        super()._close()
        self.feed.close()

    def _advance(self) -> None:
        for t, z, cmd in self.feed.take():
            self._follower.step(t, z, cmd)
            self._cmd = cmd
            self._keep(t, z, cmd)

    def _look(self) -> Snapshot | None:
        follower = self._follower
        if not math.isfinite(follower.t):
            return None
        estimate = follower.twin.estimate()
        boat = measured_boat(follower.measured, self._cmd)
        seen = self._seen(boat, rate=self._rate(follower.t), notes=self.notes)
        if estimate.ready and time.monotonic() >= self._answered + REPLY:
            self._answered = time.monotonic()
            self.feed.send(estimate, seen.prediction)
        return seen

    @property
    def notes(self) -> tuple[str, ...]:
        """What came over the wire, in words."""
        counts = ", ".join(f"{name} {n}" for name, n in self.feed.counts.items() if n)
        return (*self.feed.notes, counts)
