"""When an autopilot is to sail by the twin, and what it is sent.

The twin's estimate goes out as ODOMETRY all the time, as ArduPilot does not arm without it. When
the GPS is lost, the EKF is switched to its second source set (external navigation) before its
failsafe, which comes after 8 s. When the GPS is back and agrees with the twin, it is switched back.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.channels import PSI, U, V, X, Y
from twin.live.external.peer import ACCEPTED, HOLD, AutopilotPeer
from twin.live.protocols.mavlink import (
    ONBOARD,
    ORIGIN_MESSAGE,
    REQUEST_MESSAGE,
    JumpCounter,
    MavlinkWriter,
)
from twin.logs.datum import Plane
from twin.predictors.base import Estimate
from usv_kernel.channels import GPS_X, GPS_Y
from usv_kernel.errors import UsvTwinError, check_number

__all__ = ["KINDS", "STATES", "ExternalError", "ExternalNavigation", "ExternalOptions"]

Array = NDArray[np.float64]

KINDS = ("odometry", "position", "gps-input")
"""ODOMETRY; the same, but the EKF takes the place alone; GPS_INPUT, in place of a receiver."""

STATES = {
    "waiting": "the twin does not know the boat well enough to take over",
    "ready": "the twin will take over when the GPS is lost",
    "lost": "the GPS is lost, and the autopilot does not sail by the twin",
    "aiding": "the GPS is lost, and the autopilot sails by the twin",
    "returning": "the GPS is back, and has not yet agreed with the twin for long enough",
    "gave up": "the GPS is lost, and the twin no longer knows the place well enough",
}
"""States of external navigation, and what they mean."""

SET_SOURCE, SET_MODE = 42007, 176
"""Commands MAV_CMD_SET_EKF_SOURCE_SET and MAV_CMD_DO_SET_MODE."""

GPS_SOURCE, TWIN_SOURCE = 1, 2
"""Source sets of the EKF."""

HEARTBEAT, ORIGIN_EVERY, RETRY = 1.0, 5.0, 0.5
"""Times between heartbeats, questions for the origin, and orders without an answer, s."""

FIXES_MISSED = 2.5
"""So many times between two fixes without one are a loss, if that is longer than ``loss_s``."""

LONGEST_INTERVAL = 2.0
"""Longest time between two fixes that is taken for that of the receiver, s."""

FIX_EVERY = 0.2
"""Time between two GPS_INPUT, s."""

MOVES = 0.3
"""Speed from which on a boat teaches its twin something, m/s."""

FAILSAFE = "EKF failsafe"
"""What ArduPilot says when its EKF fails."""

RESUME_AFTER = 1.5
"""An autopilot refuses a mode for a second after its failsafe is cleared, s."""

_SLACK = 1e-6


class ExternalError(UsvTwinError):
    """Options that cannot be used; the message names the value and its range."""


@dataclass(frozen=True, kw_only=True)
class ExternalOptions:
    """How the twin is used."""

    kind: str = "odometry"  # one of KINDS
    loss_s: float = 1.0  # time without a fix after which the GPS counts as lost, s
    moving_s: float = 30.0  # time under way before the twin may take over, s
    ready_sd: float = 5.0  # largest standard deviation of the place to take over with, m
    max_sd: float = 20.0  # the twin gives up above it, m
    agree_m: float = 2.0  # twin and GPS agree when they are so near, m ...
    agree_s: float = 3.0  # ... for so long, s
    resume: bool = False  # whether to leave Hold, if the failsafe of the EKF was faster

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ExternalError(f"external = {self.kind!r}: use one of {', '.join(KINDS)}")
        for item in dataclasses.fields(self):
            if item.name not in ("kind", "resume"):
                check_number(item.name, getattr(self, item.name), 0.0, 1e6, ExternalError)


class ExternalNavigation:
    """Decides whether the autopilot sails by the twin, and writes the messages to it.

    Rows and estimates come in with :meth:`take`, messages of the autopilot with ``peer.hear``.

    Parameters
    ----------
    options : ExternalOptions
        How.
    note : callable, optional
        Called with the time (s) and a text for each event.

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
        options: ExternalOptions | None = None,
        note: Callable[[float, str], None] | None = None,
    ) -> None:
        self.options = options or ExternalOptions()
        self.note = note or (lambda t, text: None)
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
        self._asked = self._greeted = self._origin_asked = self._fix_sent = -math.inf
        self._fixed = math.nan
        self._interval = 0.2
        self._moving, self._last = 0.0, math.nan
        self._agreed: float | None = None
        self._mode_before: int | None = None
        self._held = math.nan
        self._refused = False

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
            if math.isfinite(self._fixed) and 0.0 < t - self._fixed < LONGEST_INTERVAL:
                self._interval += 0.1 * (t - self._fixed - self._interval)
            self._fixed = t
        known = estimate.ready and bool(np.isfinite(estimate.state[: V + 1]).all())
        if known and math.hypot(estimate.state[U], estimate.state[V]) > MOVES:
            self._moving += dt
        self._decide(t, fix if fixed else None, estimate, known)
        return list(self._messages(t, estimate, known, plane, stamp))

    def restart(self) -> None:
        """Begin again with a twin that knows nothing."""
        self._moving = 0.0

    @property
    def gps_lost(self) -> bool:
        """Whether the fixes have stopped."""
        limit = max(self.options.loss_s, FIXES_MISSED * self._interval)
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
            if sd > self.options.max_sd:
                self._want(GPS_SOURCE)
                self._go(
                    t,
                    "gave up",
                    f"the place is known to {sd:.1f} m only, more than {self.options.max_sd:g} m",
                )
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
        sd, options = float(max(estimate.sd[X], estimate.sd[Y])), self.options
        if not sd <= options.ready_sd:
            return f"its place is known to {sd:.1f} m only", sd
        if self._moving < options.moving_s:
            return f"it has seen {self._moving:.0f} of {options.moving_s:g} s under way", sd
        return "", sd

    def _agrees(self, t: float, fix: Array | None, estimate: Estimate, lost: bool) -> bool:
        """Return whether the GPS is back and has agreed with the twin for long enough."""
        if lost or not estimate.ready:
            self._agreed = None
            return False
        if fix is not None:
            apart = math.dist(fix, estimate.state[:2])
            if not apart <= self.options.agree_m:
                self._agreed = None
            elif self._agreed is None:
                self._agreed = t
        return self._agreed is not None and t - self._agreed >= self.options.agree_s - _SLACK

    def _want(self, source: int) -> None:
        """Let the EKF change to a source set, until it has."""
        if self._wanted != source:
            self._wanted, self._asked = source, -math.inf
            self.peer.results.pop(SET_SOURCE, None)

    def _note_mode(self) -> None:
        """Keep the mode that the autopilot has when the GPS is lost."""
        self._mode_before = self.peer.mode
        self.peer.texts.clear()

    def _watch_mode(self, t: float) -> None:
        """Say so when the failsafe of the EKF was faster, and go back if that is wanted."""
        away = self.state in ("lost", "aiding", "returning", "gave up")
        if not away:
            self._held = math.nan
        failed = any(FAILSAFE in text for text in self.peer.texts)
        fell = failed and self.peer.mode == HOLD and self._mode_before not in (HOLD, None)
        if away and fell and math.isnan(self._held):
            self._held = t
            then = "will go back" if self.options.resume else "stays there; --resume goes back"
            self.note(t, f"the autopilot fell to Hold, as its EKF failed, and {then}")

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
        if t - self._greeted >= HEARTBEAT - _SLACK:
            self._greeted = t
            yield write.heartbeat()
        if system is None:
            return
        write.system = system
        if self.options.kind == "gps-input":
            self.source = self._wanted  # there is nothing to switch
            if known and plane is not None and t - self._fix_sent >= FIX_EVERY - _SLACK:
                self._fix_sent = t
                yield self._fix(estimate, plane, stamp)
            return
        if t - self._origin_asked >= (HEARTBEAT if self.peer.origin is None else ORIGIN_EVERY):
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
        back = self._held + RESUME_AFTER
        fell = self.peer.mode == HOLD and self.source == TWIN_SOURCE and t >= back
        if self.options.resume and fell and self._mode_before is not None:
            self._held = t
            yield write.command(system, SET_MODE, 1, self._mode_before)

    def _switch(self, t: float, system: int) -> Iterator[bytes]:
        """Yield the order to change the source set, again until it is confirmed."""
        result = self.peer.results.get(SET_SOURCE)
        if result == ACCEPTED and self._asked > -math.inf:
            self.source = self._wanted
            return
        if t - self._asked >= RETRY - _SLACK:
            if result is not None:
                self.note(t, f"the autopilot refused source set {self._wanted} (result {result})")
                del self.peer.results[SET_SOURCE]
            self._asked = t
            yield self.writer.command(system, SET_SOURCE, self._wanted)

    def _fix(self, estimate: Estimate, plane: Plane, stamp: float) -> bytes:
        """Return the estimate as a receiver would give it."""
        x, y, psi, u, v = estimate.state[: V + 1].tolist()
        c, s = math.cos(estimate.state[PSI]), math.sin(psi)
        latitude, longitude = plane.degrees(x, y)
        return self.writer.fix(
            stamp,
            (float(latitude), float(longitude)),
            (u * c - v * s, u * s + v * c),
            (float(max(estimate.sd[:2])), float(max(estimate.sd[[U, V]]))),
            valid=self.state != "gave up",
        )
