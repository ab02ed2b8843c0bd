"""When an autopilot is to sail by the twin, and what it is sent.

The twin's estimate goes out as ODOMETRY all the time, as ArduPilot does not arm without it. When
the GPS is lost, the EKF is switched to its second source set (external navigation) before its
failsafe, which comes after 8 s. When the GPS is back and agrees with the twin, it is switched back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from twin.channels import U, V, X, Y
from twin.live.external.peer import ACCEPTED, HOLD, AutopilotPeer
from twin.live.protocols.mavlink import ONBOARD, JumpCounter, MavlinkWriter
from twin.logs.datum import Plane
from twin.predictors.base import Estimate
from usv_kernel.channels import GPS_X, GPS_Y

__all__ = ["STATES", "ExternalNavigation"]

Array = NDArray[np.float64]

STATES = {
    "waiting": "the twin does not know the boat well enough to take over",
    "ready": "the twin will take over when the GPS is lost",
    "lost": "the GPS is lost, and the autopilot does not sail by the twin",
    "aiding": "the GPS is lost, and the autopilot sails by the twin",
    "returning": "the GPS is back, and has not yet agreed with the twin for long enough",
    "gave up": "the GPS is lost, and the twin no longer knows the place well enough",
}
"""States of external navigation, and what they mean."""

SET_SOURCE = 42007
REQUEST_MESSAGE = 512
"""Commands MAV_CMD_SET_EKF_SOURCE_SET and MAV_CMD_REQUEST_MESSAGE."""

ORIGIN_MESSAGE = 49
"""GPS_GLOBAL_ORIGIN."""

GPS_SOURCE, TWIN_SOURCE = 1, 2
"""Source sets of the EKF."""

HEARTBEAT_EVERY_S = 1.0
ORIGIN_EVERY_S = 5.0
RETRY_AFTER_S = 0.5
"""Times between heartbeats, questions for the origin, and orders without an answer."""

LOSS_S = 1.0
"""Time without a fix after which the GPS counts as lost."""

INTERVALS_MISSED = 2.5
"""Fix intervals without a fix that are a loss, if that is longer than :data:`LOSS_S`."""

FIX_INTERVAL_MAX_S = 2.0
"""Longest time between two fixes that is taken for that of the receiver."""

LEARNING_SPEED_MIN_MPS = 0.3
"""Speed from which on a twin learns from the boat."""

AGREE_M = 2.0
AGREE_S = 3.0
"""Twin and GPS agree after this time within this distance."""

_SLACK = 1e-6


class ExternalNavigation:
    """Decides whether the autopilot sails by the twin, and writes the messages to it.

    Rows and estimates come in with :meth:`take`, messages of the autopilot with ``peer.hear``.

    Parameters
    ----------
    note : callable, optional
        Called with the time (s) and a text for each event.
    moving_s : float
        Time under way before the twin may take over, s.
    ready_sd_m, max_sd_m : float
        Largest standard deviation of the place to take over with, and to keep on with, m.

    Attributes
    ----------
    state : str
        One of :data:`STATES`.
    why : str
        What it waits for, or why it gave up.
    peer : AutopilotPeer
        What the autopilot says.
    source : int
        Source set that the autopilot has confirmed.
    """

    def __init__(
        self,
        note: Callable[[float, str], None] | None = None,
        *,
        moving_s: float = 30.0,
        ready_sd_m: float = 5.0,
        max_sd_m: float = 20.0,
    ) -> None:
        self.note = note or (lambda t, text: None)
        self.moving_s, self.ready_sd_m, self.max_sd_m = moving_s, ready_sd_m, max_sd_m
        self.peer = AutopilotPeer()
        self.writer = MavlinkWriter(component=ONBOARD)
        self._jumps = JumpCounter()
        self.begin()

    def begin(self) -> None:
        """Begin again, with an autopilot that does so."""
        self.peer.forget()
        self.state, self.why = "waiting", "no estimate yet"
        self.source = GPS_SOURCE
        self._wanted = GPS_SOURCE
        self._asked = self._greeted = self._origin_asked = -math.inf
        self._fixed = math.nan
        self._interval = 0.2
        self._moving, self._last = 0.0, math.nan
        self._agreed: float | None = None
        self._mode_before: int | None = None
        self._fell = self._refused = False

    @property
    def status(self) -> str:
        """State and reason in words."""
        return f"{self.state}: {self.why}" if self.why else self.state

    def take(
        self, t: float, z: Array, estimate: Estimate, plane: Plane | None, stamp: float
    ) -> list[bytes]:
        """Take a row and the estimate after it; return the datagrams for the autopilot.

        Parameters
        ----------
        t : float
            Time of the row, s.
        z : ndarray, shape (17,)
            Its measurements; a fix of the receiver, never of the autopilot's own estimate.
        estimate : Estimate
            The twin's, at t or later.
        plane : Plane or None
            Where x = y = 0 is on the Earth; None before it is known.
        stamp : float
            Time of the estimate by the clock of the autopilot, s.
        """
        dt = 0.0 if math.isnan(self._last) else t - self._last
        self._last = t
        fix = z[GPS_X : GPS_Y + 1]
        fixed = bool(np.isfinite(fix).all())
        if fixed:
            if math.isfinite(self._fixed) and 0.0 < t - self._fixed < FIX_INTERVAL_MAX_S:
                self._interval += 0.1 * (t - self._fixed - self._interval)
            self._fixed = t
        known = estimate.ready and bool(np.isfinite(estimate.state[: V + 1]).all())
        if known and math.hypot(estimate.state[U], estimate.state[V]) > LEARNING_SPEED_MIN_MPS:
            self._moving += dt
        self._decide(t, fix if fixed else None, estimate, known)
        return list(self._messages(t, estimate, known, plane, stamp))

    def restart(self) -> None:
        """Begin again with a twin that knows nothing."""
        self._moving = 0.0

    @property
    def gps_lost(self) -> bool:
        """Whether the fixes have stopped."""
        limit = max(LOSS_S, INTERVALS_MISSED * self._interval)
        return not self._last - self._fixed <= limit + _SLACK

    def _decide(self, t: float, fix: Array | None, estimate: Estimate, known: bool) -> None:
        """Go on to the next state."""
        lacking, sd = self._lacking(estimate, known)
        lost = self.gps_lost
        if self.state in ("waiting", "ready"):
            if math.isnan(self._fixed):
                self._go(t, "waiting", "no fix yet")
            elif not lost:
                self._go(t, "waiting" if lacking else "ready", lacking)
            elif lacking:
                self._note_mode()
                self._refused = True
                self._go(t, "lost", f"the twin does not take over, as {lacking}")
            else:
                self._note_mode()
                self._go(t, "lost", "the autopilot has not yet changed its source")
        if self.state == "lost" and not lost:
            self._refused = False
            self._go(t, "returning" if self._wanted == TWIN_SOURCE else "waiting", "")
        if self.state == "lost" and not self._refused:
            self._want(TWIN_SOURCE)
            if self.source == TWIN_SOURCE:
                self._go(t, "aiding", "")
        if self.state in ("aiding", "returning"):
            self._aid(t, fix, estimate, lost, math.inf if not known else sd)
        if self.state == "gave up" and self._agrees(t, fix, estimate, lost):
            self._go(t, "waiting", "")
        self._watch_mode(t)

    def _aid(self, t: float, fix: Array | None, estimate: Estimate, lost: bool, sd: float) -> None:
        """Stay the source of the EKF, hand back, or give up."""
        if lost:
            self._agreed = None
            if sd > self.max_sd_m:
                self._want(GPS_SOURCE)
                why = f"the place is known to {sd:.1f} m only, more than {self.max_sd_m:g} m"
                self._go(t, "gave up", why)
            else:
                self._go(t, "aiding", "")
            return
        self._go(t, "returning", "")
        if self._agrees(t, fix, estimate, lost):
            self._want(GPS_SOURCE)
        if self._wanted == GPS_SOURCE and self.source == GPS_SOURCE:
            self._agreed = None
            self._go(t, "ready", "")

    def _lacking(self, estimate: Estimate, known: bool) -> tuple[str, float]:
        """Return what the twin lacks to take over, and the standard deviation of its place, m."""
        if not known:
            return "the twin has no estimate yet", math.inf
        sd = float(max(estimate.sd[X], estimate.sd[Y]))
        if not sd <= self.ready_sd_m:
            return f"its place is known to {sd:.1f} m only", sd
        if self._moving < self.moving_s:
            return f"it has seen {self._moving:.0f} of {self.moving_s:g} s under way", sd
        return "", sd

    def _agrees(self, t: float, fix: Array | None, estimate: Estimate, lost: bool) -> bool:
        """Return whether the GPS is back and has agreed with the twin for long enough."""
        if lost or not estimate.ready:
            self._agreed = None
            return False
        if fix is not None:
            apart = math.dist(fix, estimate.state[:2])
            if not apart <= AGREE_M:
                self._agreed = None
            elif self._agreed is None:
                self._agreed = t
        return self._agreed is not None and t - self._agreed >= AGREE_S - _SLACK

    def _want(self, source: int) -> None:
        """Let the EKF change to a source set, until it has."""
        if self._wanted != source:
            self._wanted, self._asked = source, -math.inf
            self.peer.results.pop(SET_SOURCE, None)

    def _note_mode(self) -> None:
        """Keep the mode that the autopilot has when the GPS is lost."""
        self._mode_before = self.peer.mode
        self.peer.failed = False

    def _watch_mode(self, t: float) -> None:
        """Say so when the failsafe of the EKF was faster."""
        away = self.state in ("lost", "aiding", "returning", "gave up")
        held = self.peer.mode == HOLD and self._mode_before not in (HOLD, None)
        fell = away and self.peer.failed and held
        if fell and not self._fell:
            self.note(t, "the autopilot fell to Hold, as its EKF failed, and stays there")
        self._fell = fell or (away and self._fell)

    def _go(self, t: float, state: str, why: str) -> None:
        """Enter a state, and say so."""
        changed = state != self.state
        self.state, self.why = state, why
        if changed:
            self._agreed = None
            self.note(t, self.status)

    def _messages(
        self, t: float, estimate: Estimate, known: bool, plane: Plane | None, stamp: float
    ) -> Iterator[bytes]:
        """Yield what is due."""
        write, system = self.writer, self.peer.system
        if t - self._greeted >= HEARTBEAT_EVERY_S - _SLACK:
            self._greeted = t
            yield write.heartbeat()
        if system is None:
            return
        write.link.srcSystem = system
        if t - self._origin_asked >= (
            HEARTBEAT_EVERY_S if self.peer.origin is None else ORIGIN_EVERY_S
        ):
            self._origin_asked = t
            yield write.command(system, REQUEST_MESSAGE, ORIGIN_MESSAGE)
        if self._wanted != self.source or self._asked == -math.inf:
            yield from self._switch(t, system)
        if known and plane is not None and self.peer.origin is not None:
            north, east = plane.metres(*self.peer.origin)
            yield write.odometry(
                stamp,
                estimate,
                origin=(float(north), float(east)),
                resets=self._jumps.take(estimate.t, estimate.state),
                quality=-1 if self.state == "gave up" else 100,
            )

    def _switch(self, t: float, system: int) -> Iterator[bytes]:
        """Yield the order to change the source set, again until it is confirmed."""
        result = self.peer.results.get(SET_SOURCE)
        if result == ACCEPTED and self._asked > -math.inf:
            self.source = self._wanted
            return
        if t - self._asked >= RETRY_AFTER_S - _SLACK:
            if result is not None:
                self.note(t, f"the autopilot refused source set {self._wanted} (result {result})")
                del self.peer.results[SET_SOURCE]
            self._asked = t
            yield self.writer.command(system, SET_SOURCE, self._wanted)
