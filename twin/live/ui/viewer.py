"""The server of a view: one scene and two panels, kept like a session's latest snapshot."""

from __future__ import annotations

import contextlib
import io
import time
from typing import Any

from twin.live.sessions.session import Session, Snapshot
from twin.live.ui.curves import Curves
from twin.live.ui.panel import controls_of
from twin.live.ui.scene import SceneView
from twin.live.ui.server import start_server
from usv_gym.vessel.geometry import Boat, Form, boat_of

__all__ = [
    "Viewer",
]

CURVES_EVERY_S = 0.5
"""Time between two pictures of the curves."""

UNWATCHED_FRAME_S = 1.0
"""Time between two frames without a viewer."""


class Viewer:
    """Shows a session, which its owner starts and stops, to every browser that asks.

    It listens on loopback at ``port``, or the next free one. ``frames`` counts the frames that were
    made.
    """

    def __init__(self, session: Session, port: int = 8080) -> None:
        self.session, self.frames = session, 0
        self.server: Any = start_server(port)
        self.server.gui.configure_theme(show_logo=False, show_share_button=False)
        self.scene = SceneView(self.server, boat(session))
        self.controls = controls_of(self.server, session)
        self.curves = Curves(self.server, session)
        self._shown: Snapshot | None = None
        self._curves_due, self._curves_behind = 0.0, False

    @property
    def url(self) -> str:
        """Where browsers find it."""
        return f"http://{self.server.get_host()}:{self.port}"

    @property
    def port(self) -> int:
        """Port that it listens at."""
        return int(self.server.get_port())

    def serve(self) -> None:
        """Show frames until the user presses Ctrl-C or the session ends; raise what ended it."""
        due = 0.0
        while self.session.error is None:
            fresh = self.session.fresh.wait(UNWATCHED_FRAME_S)
            self.session.fresh.clear()
            now = time.monotonic()
            if (fresh or self._curves_behind) and (now >= due or self.server.get_clients()):
                due = now + UNWATCHED_FRAME_S
                self.step(now)
        raise self.session.error

    def step(self, now: float) -> None:
        """Make one frame, if there is anything new."""
        snapshot = self.session.snapshot
        if snapshot is None:
            self.controls.show_nothing()
        elif snapshot is not self._shown:
            self._shown = snapshot
            self.frames += 1
            with self.server.atomic():
                self.scene.show(snapshot)
                self.controls.show(snapshot)
            self._curves_behind = True
        # also while a session pauses: its last moment may not have been drawn yet
        if self._curves_behind and now >= self._curves_due:
            self._curves_due = now + CURVES_EVERY_S
            self._curves_behind = False
            self.curves.show()

    def close(self) -> None:
        """Send every browser away."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()


def boat(session: Session) -> Boat:
    """Return the hull of a session's boat: of its vessel file, or of its main particulars."""
    if session.vessel is not None:
        return boat_of(session.vessel)
    own = session.particulars
    kind = "thruster_pair" if own.steering == "differential" else "steerable_drive"
    volume = own.mass / 1000.0
    form = Form(length=own.length, beam=own.beam, draft=own.draft, volume=volume, kind=kind)
    return boat_of(form)
