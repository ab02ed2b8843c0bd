"""A recorded run as a session, any moment of which can be seen."""

from __future__ import annotations

import bisect
import math
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.digital_twin import PLANS, Twin, TwinError, known_plan
from twin.live.sessions.session import (
    SNAPSHOT_EVERY_S,
    Session,
    Snapshot,
    measured_boat,
)
from twin.live.sessions.tracker import (
    HORIZON_S,
    LOST_AFTER_S,
    PLAN_STEP_S,
    History,
    TwinMonitor,
    overlay_of,
    sensor_timeout,
)
from twin.logs.log import Log
from twin.sim.bridge import TRUE_STATE
from usv_gym.envs.scene import TwinOverlay
from usv_gym.vessel.vessel import Vessel
from usv_kernel.channels import COMPASS, GPS_X, GYRO

__all__ = [
    "LogSession",
]

Array = NDArray[np.float64]

PREDICTIONS_KEPT = 4000
PREDICTION_SPACING_MAX_S = 2.0
"""Predictions of a run that are kept, about, and the longest time between two."""

ROWS_BEHIND = 4000
TRACK = 400
FIXES = 400
"""The track of so many rows is drawn with about so many points, and so many fixes."""


class LogSession(Session):
    """A recorded run: its twin goes through it as fast as it can, and any moment can be seen.

    ``plan``, one of ``twin.digital_twin.PLANS``, says whether the twin is given the commands that
    follow. ``at`` is the moment that is shown, s, ``done`` the moment up to which the twin has
    come. Nothing is recorded twice.
    """

    def __init__(
        self, log: Log, twin: Twin, vessel: Vessel | None, folder: Path, plan: str = "known"
    ) -> None:
        if plan not in PLANS:
            raise TwinError(f"plan = {plan!r}: use {' or '.join(PLANS)}")
        super().__init__(vessel, twin.particulars, folder)
        self.log, self.plan = log, plan
        self.at = self.done = float(log.t[0])
        span = float(log.t[-1] - log.t[0])
        self._spacing = min(
            max(SNAPSHOT_EVERY_S, span / PREDICTIONS_KEPT), PREDICTION_SPACING_MAX_S
        )
        self._fixes, self._headings, self._turns = (
            np.flatnonzero(np.isfinite(log.z[:, column])) for column in (GPS_X, COMPASS, GYRO)
        )
        intervals = np.diff(log.t[self._fixes])
        self._timeout = sensor_timeout(float(np.median(intervals)) if len(intervals) else 1.0)
        self.monitor = TwinMonitor(twin)
        self._next, self._due = 0, -math.inf
        self._estimated = np.full((len(log), 6), math.nan)
        self._moments: list[TwinOverlay | None] = []
        self._times: list[float] = []
        self._anchor_now()

    def history(self) -> History:
        """Return the curves up to the moment that is shown."""
        whole = self.monitor.history()
        return whole.rows(whole.t <= self.at + 1e-9)

    def seek(self, t: float) -> None:
        """Show another moment, s."""
        self.at = min(max(t, float(self.log.t[0])), self.done)
        self._anchor_now()

    @property
    def t(self) -> float:
        """The moment that is shown, s."""
        return self.at

    def _rest(self) -> float:
        return super()._rest() if self._next == len(self.log) else 0.0

    def _advance(self) -> None:
        begin, first = self._anchor
        begun = time.monotonic()
        while self._next < len(self.log) and time.monotonic() < begun + SNAPSHOT_EVERY_S:
            self._take_row()
        if not self.paused:
            self.at = first + (begun - begin) * self.scale
            if self.at > self.done:  # the twin is not there yet, or the run is over
                self.at = self.done
                self._anchor_now()

    def _take_row(self) -> None:
        """Give the twin its next row, and keep its estimate."""
        log, row = self.log, self._next
        t, truth = float(log.t[row]), None if log.truth is None else log.truth[row]
        self.monitor.step(t, log.z[row], log.cmd[row], truth)
        if t >= self._due - 1e-9 or row == len(log) - 1:
            self._due = t + self._spacing
            plan = known_plan(log, row, HORIZON_S, PLAN_STEP_S) if self.plan == "known" else "hold"
            made = self.monitor.predict(plan)
            self._moments.append(None if made is None else overlay_of(made))
            self._times.append(t)
        if self._moments[-1] is not None:
            self._estimated[row] = self.monitor.twin.predictor.state
        self.done, self._next = t, row + 1

    def _look(self) -> Snapshot | None:
        if not self._times:
            return None
        log, last = self.log, min(self.at, self.done) + 1e-9
        row = max(int(np.searchsorted(log.t, last, side="right")) - 1, 0)
        t = float(log.t[row])
        fixes, headings, turns = (
            known[: np.searchsorted(known, row, side="right")]
            for known in (self._fixes, self._headings, self._turns)
        )
        ages = [t - float(log.t[known[-1]]) if len(known) else math.inf for known in (fixes, turns)]
        measured = np.full(3, math.nan)
        if len(fixes):
            measured[:2] = log.z[fixes[-1], GPS_X : GPS_X + 2]
        if len(headings):
            measured[2] = log.z[headings[-1], COMPASS]
        boat = measured_boat(measured, log.cmd[row])
        if log.truth is not None and np.isfinite(log.truth[row, :3]).all():
            boat[list(TRUE_STATE)] = np.nan_to_num(log.truth[row])
        places = self._estimated if log.truth is None else log.truth
        behind = places[
            max(row - ROWS_BEHIND, 0) : row + 1 : max(min(row, ROWS_BEHIND) // TRACK, 1), :2
        ]
        follow = slice(row + 1, int(np.searchsorted(log.t, t + HORIZON_S, side="right")))
        ahead = (log.z if log.truth is None else log.truth)[follow, :2]
        return Snapshot(
            t=t,
            boat=boat,
            overlay=self._overlay(row, t),
            motion=None,
            fixes=log.z[fixes[-FIXES:], GPS_X : GPS_X + 2],
            track=behind[np.isfinite(behind[:, 0])],
            ahead=ahead[np.isfinite(ahead[:, 0])],
            gps_age=ages[0],
            gps_lost=ages[0] > self._timeout,
            imu_lost=len(turns) > 0 and ages[1] > LOST_AFTER_S,
            has_imu=len(turns) > 0,
            health=self.monitor.twin.health_history.at(t),
            current=self.monitor.current_at(t),
        )

    def _overlay(self, row: int, t: float) -> TwinOverlay | None:
        """Return the estimate at a row, with the last prediction from there on."""
        index = max(bisect.bisect_right(self._times, t + 1e-9) - 1, 0)
        made = self._moments[index]
        if made is None or not np.isfinite(self._estimated[row, 0]):
            return None
        since = max(t - self._times[index], 0.0)
        later = made.horizons > since + 1e-6
        return TwinOverlay(
            state=self._estimated[row],
            cov=made.cov,
            horizons=made.horizons[later] - since,
            ahead=made.ahead[later],
            covs=made.covs[later],
        )
