"""A recorded run as a session, any moment of which can be seen."""

from __future__ import annotations

import bisect
import math
import threading
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.live.follower import HORIZON, PLAN_STEP, Follower, History
from twin.live.session import PUBLISHED, Session, Snapshot, measured_boat
from twin.log import Log
from twin.simulated import TRUE_STATE
from twin.twin import PLANS, Twin, TwinError, known_plan
from usv_gym.vessel import Vessel

__all__ = ["LogSession"]

Array = NDArray[np.float64]

SNAPSHOTS = 2000
"""Moments of a recorded run that are kept at most."""


class LogSession(Session):
    """A recorded run: its twin goes through it as fast as it can, and any moment can be seen.

    Parameters
    ----------
    log : Log
        The run; with the truth, if it is known, to judge by.
    twin : Twin
        Fresh.
    vessel : Vessel or None
        Whose hull is shown.
    folder : Path
        As for any session; nothing is recorded twice.
    plan : str
        One of ``twin.twin.PLANS``: whether the twin is told the commands that follow.

    Attributes
    ----------
    at : float
        Moment that is shown, s.
    done : float
        Moment up to which the twin has come, s.
    plan : str
        As above.
    """

    def __init__(
        self, log: Log, twin: Twin, vessel: Vessel | None, folder: Path, plan: str = "known"
    ) -> None:
        super().__init__(vessel, twin.particulars, folder)
        self.log = log
        self.at = float(log.t[0])
        span = float(log.t[-1] - log.t[0])
        self._spacing = max(2.0 * PUBLISHED, span / SNAPSHOTS)
        self._anchor = time.monotonic(), self.at
        known = log.z[:, :2] if log.truth is None else log.truth[:, :2]
        there = np.isfinite(known[:, 0])
        self._places, self._when = known[there], log.t[there]
        self._prepare(twin, plan)

    def _prepare(self, twin: Twin, plan: str) -> None:
        """Let a fresh twin stand before the first row."""
        if plan not in PLANS:
            raise TwinError(f"plan = {plan!r}: use {' or '.join(PLANS)}")
        self.plan, self._row, self.done = plan, 0, float(self.log.t[0])
        self._follower = Follower(twin)
        self._moments: list[Snapshot] = []
        self._times: list[float] = []
        self._over = threading.Event()
        self._worker = threading.Thread(target=self._go_through, name="twin", daemon=True)

    def again(self, plan: str) -> None:
        """Go through the log once more with another plan, up to the moment that is shown."""
        self._over.set()
        self._worker.join()
        twin = self._follower.twin
        twin.reset()
        self._prepare(twin, plan)
        self._worker.start()
        self.changed += 1

    @property
    def follower(self) -> Follower:
        """The twin and what is seen of it."""
        return self._follower

    def history(self) -> History:
        """Return the curves up to the moment that is shown."""
        whole = self._follower.history()
        return whole.rows(whole.t <= self.at + 1e-9)

    def seek(self, t: float) -> None:
        """Show another moment."""
        self.at = min(max(t, float(self.log.t[0])), self.done)
        self._anchor = time.monotonic(), self.at

    def set_scale(self, scale: float) -> None:
        """Change the pace."""
        super().set_scale(scale)
        self._anchor = time.monotonic(), self.at

    def set_paused(self, paused: bool) -> None:
        """Let time stand still, or go on."""
        super().set_paused(paused)
        self._anchor = time.monotonic(), self.at

    def _run(self) -> None:
        self._worker.start()
        super()._run()

    def _close(self) -> None:
        self._over.set()
        self._worker.join()
        super()._close()

    def _go_through(self) -> None:
        """Feed the twin all rows, and keep what it believed in between."""
        log, due = self.log, -math.inf
        try:
            for row, (t, z, cmd) in enumerate(log):
                if self._over.is_set():
                    return
                truth = None if log.truth is None else log.truth[row]
                self._follower.step(t, z, cmd, truth)
                if t >= due or row == len(log) - 1:
                    due = t + self._spacing
                    self._moments.append(self._moment(row))
                    self._times.append(t)
                    self.done = t
        except BaseException as error:
            self.error = error

    def _plan(self) -> str | Array:
        if self.plan == "hold":
            return "hold"
        return known_plan(self.log, self._row, HORIZON, PLAN_STEP)

    def _moment(self, row: int) -> Snapshot:
        log, t = self.log, float(self.log.t[row])
        self._row = row
        boat = measured_boat(self._follower.measured, log.cmd[row])
        if log.truth is not None and np.isfinite(log.truth[row, :3]).all():
            boat[list(TRUE_STATE)] = np.nan_to_num(log.truth[row])
        first, last = np.searchsorted(self._when, (t, t + HORIZON), side="right")
        return self._seen(boat, ahead=self._places[first:last])

    def _advance(self) -> None:
        begin, first = self._anchor
        now = time.monotonic()
        self.at = first + (now - begin) * self.scale
        if self.at > self.done:  # the twin is not there yet, or the run is over
            self.at = self.done
            self._anchor = now, self.at

    def _look(self) -> Snapshot | None:
        if not self._times:
            return None
        index = bisect.bisect_right(self._times, self.at + 1e-9) - 1
        return self._moments[max(index, 0)]
