"""A simulated boat under an autopilot as a session of the page."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.digital_twin import Twin
from twin.live.external.simulated import AutopilotRun
from twin.live.sessions.session import MAX_LAG, Session, Snapshot
from twin.live.sessions.tracker import TwinMonitor
from twin.logs.datum import Datum
from usv_gym.sitl.server import Server
from usv_gym.world.realisation import Sea

__all__ = ["SitlSession"]

Array = NDArray[np.float64]

POLL = 0.02
"""Longest wait for a packet, s; the page is to be answered meanwhile."""


class SitlSession(Session):
    """A simulated boat that an autopilot steers, with its twin.

    The page can look on and record logs; time is that of the autopilot.
    """

    has_truth = True

    offers = "record logs to the folder of --out"

    def __init__(self, server: Server, run: AutopilotRun, twin: Twin, folder: Path) -> None:
        simulation = run.backend.simulation
        super().__init__(simulation.vessel, twin.particulars, folder)
        self.server, self.run = server, run
        self.monitor = TwinMonitor(twin)
        run.on_row, run.step_twin = self._row, self._step

    def forget(self) -> None:
        """Restart the twin; the boat sails on."""
        self.monitor.twin.reset()
        self.monitor = TwinMonitor(self.monitor.twin)
        self.changed += 1

    def _step(self, t: float, z: Array, cmd: Array, truth: Array) -> None:
        if not t > self.monitor.t and np.isfinite(self.monitor.t):  # the autopilot began again
            self.monitor = TwinMonitor(self.monitor.twin)
            self.snapshot = None
            self.changed += 1
        self.monitor.step(t, z, cmd, truth)

    def _row(self, t: float, z: Array, cmd: Array, truth: Array) -> None:
        self._keep(t, z, cmd, truth)

    def _advance(self) -> None:
        until = time.monotonic() + MAX_LAG
        while self.server.poll(POLL) and time.monotonic() < until:
            pass

    def _rest(self) -> float:
        return 0.0

    def _look(self) -> Snapshot | None:
        if not np.isfinite(self.monitor.t):
            return None
        sim = self.run.backend.simulation
        sea = Sea(sim.waves[0].copy(), sim.gusts[0].copy(), sim.weather[0].copy())
        notes = self.notes
        rate = self._rate(self.monitor.t)
        return self._seen(sim.state[0].copy(), sea=sea, rate=rate, notes=notes)

    @property
    def datum(self) -> Datum:
        """The autopilot's home."""
        return self.run.datum

    @property
    def notes(self) -> tuple[str, ...]:
        """State of external navigation, and what came of the autopilot, in words."""
        counts = self.run.backend.counts
        text = ", ".join(f"{name} {count}" for name, count in counts.items() if count)
        if self.run.navigation is None:
            return (text,)
        return f"external navigation: {self.run.navigation.status}", text
