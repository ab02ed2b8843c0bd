"""The controls and the curves beside the scene of a view."""

from __future__ import annotations

import html
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twin.channels import U
from twin.live.sessions.autopilot import AUTOPILOTS
from twin.live.sessions.feed import FeedSession
from twin.live.sessions.log import LogSession
from twin.live.sessions.policy import PolicySession
from twin.live.sessions.session import Session, Snapshot
from twin.live.sessions.simulated import SimulatedSession
from twin.live.ui.scene import BLUE, GREEN, PALE, PURPLE, RED
from twin.motion import QUIET_SPANS, MotionForecast
from usv_gym.envs.scene import SDS
from usv_gym.physics import frames as fr
from usv_gym.physics import waves as wv
from usv_gym.physics import weather as wx
from usv_gym.world.sea import SEA_STATES

if TYPE_CHECKING:
    import viser

__all__ = [
    "Controls",
    "controls_of",
]

Array = NDArray[np.float64]

SCALES = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)

THROTTLE_STEP, HELM_STEP = 0.1, 2.0
"""What a press of an arrow key changes: part of the nominal shaft speed, degrees."""

LOSS_S = 10.0
"""A short loss of GPS."""

ALARM = re.compile("LOST|DOUBTFUL|EXCLUDED")
"""What stands out among the words of the instruments."""

CONTROLS_PX = 290
"""Width of the controls."""


class Controls(ABC):
    """The panel on the left: what can be changed, and what the instruments say."""

    def __init__(self, server: viser.ViserServer, session: Session) -> None:
        self.gui, self.session = server.gui, session
        server.gui.main_panel.dock_left()
        server.gui.main_panel.set_width(CONTROLS_PX)
        self.status = self.gui.add_html("")
        self.gui.add_html(key(path=isinstance(session, PolicySession)))
        self._add_time()
        self.add()

    @abstractmethod
    def add(self) -> None:
        """Add what only this kind of session has."""

    def show_nothing(self) -> None:
        """Say that nothing has come yet, and what became of the orders meanwhile."""
        self.status.content = table({"status": "nothing has come yet", **outcome(self.session)})
        self._relabel()

    def show(self, now: Snapshot) -> None:
        """Say what the instruments say, and what each button does next."""
        self.status.content = table(said(now, self.session))
        self._relabel()

    def _relabel(self) -> None:
        for button, label in self.labels():
            if button.label != label:
                button.label = label

    def labels(self) -> list[tuple[Any, str]]:
        """Return the buttons whose words change, and what they say now."""
        said = {
            "pause": "go on" if self.session.paused else "pause",
            "record": "stop recording" if self.session.recording else "record a log",
        }
        return [(getattr(self, name), text) for name, text in said.items() if hasattr(self, name)]

    def _button(
        self, label: str, call: Callable[..., None], *arguments: Any, key: str | None = None
    ) -> Any:
        """Add a button, and a key that does the same, that order something of the session."""

        def order(_: Any) -> None:
            self.session.order(call, *arguments)

        button = self.gui.add_button(label, hint=None if key is None else f"key: {key}")
        button.on_click(order)
        if key is not None:
            self.gui.add_command(label, hotkey=key).on_trigger(order)
        return button

    def _add_time(self) -> None:
        with self.gui.add_folder("Run"):
            self.pause = self._button("pause", self.session.toggle_paused, key="space")
            own = self.session.scale
            names = tuple(f"{scale:g}x" for scale in sorted({*SCALES, own}))
            self.scale = self.gui.add_dropdown("time scale", names, initial_value=f"{own:g}x")
            self.scale.on_update(
                lambda _: self.session.order(
                    self.session.set_scale, float(self.scale.value.rstrip("x"))
                )
            )
            self._add_record()

    def _add_record(self) -> None:
        self.record = self._button("record a log", self.session.toggle_record)


class LossControls(Controls):
    """What loses sensors."""

    session: SimulatedSession | PolicySession

    def _add_losses(self) -> None:
        """Add buttons that lose sensors for a while, or until they are pressed again."""
        session = self.session
        with self.gui.add_folder("Sensors"):
            self._button(f"lose GPS {LOSS_S:g} s", session.lose, "gps", LOSS_S, key="G")
            self.gps = self._button("lose GPS until pressed", session.toggle_loss, "gps")
            self.imu = self._button("lose IMU until pressed", session.toggle_loss, "imu")

    def labels(self) -> list[tuple[Any, str]]:
        """Return the buttons whose words change, and what they say now."""
        said = super().labels()
        for button, kind, name in ((self.gps, "gps", "GPS"), (self.imu, "imu", "IMU")):
            lost = self.session.is_lost(kind)
            said.append((button, f"find {name} again" if lost else f"lose {name} until pressed"))
        return said


class PolicyControls(LossControls):
    """Episodes that an agent steers."""

    session: PolicySession

    def add(self) -> None:
        """Add the loss of sensors, and the next episode."""
        self._add_losses()
        self._button("next episode", self.session.next_episode, key="R")


class SimulatedControls(LossControls):
    """Autopilot, sensors and setup of a simulated boat."""

    session: SimulatedSession

    def add(self) -> None:
        """Add helm, sensors, setup and restart."""
        session, order = self.session, self.session.order
        with self.gui.add_folder("Autopilot"):
            self.autopilot = self.gui.add_dropdown(
                "autopilot", AUTOPILOTS, initial_value=session.helm.autopilot
            )
            self.autopilot.on_update(lambda _: order(session.steer, self.autopilot.value))
            self.throttle = self.gui.add_slider(
                "throttle", -1.0, 1.2, 0.05, session.helm.throttle, hint="keys: arrows up and down"
            )
            self.throttle.on_update(self._push)
            self.helm = self.gui.add_slider(
                "rudder (deg)", -35.0, 35.0, 0.5, 0.0, hint="keys: arrows left and right"
            )
            self.helm.on_update(self._turn)
        for key, slider, step in (
            ("arrowup", self.throttle, THROTTLE_STEP),
            ("arrowdown", self.throttle, -THROTTLE_STEP),
            ("arrowright", self.helm, HELM_STEP),
            ("arrowleft", self.helm, -HELM_STEP),
        ):
            self._on_key(key, slider, step)
        self._add_losses()
        self._button("restart", session.restart, key="R")
        with self.gui.add_folder("Weather", expand_by_default=False):
            given = session.setup.sea
            seas = {name: sea for name, sea in SEA_STATES.items() if not sea.schedule}
            known = next((name for name, sea in seas.items() if sea == given), "as given")
            self.seas = {known: given, **seas}
            self.sea = self.gui.add_dropdown("sea state", tuple(self.seas), initial_value=known)
            self.sea.on_update(lambda _: order(session.change_sea, self.seas[self.sea.value]))

    # The helm's callbacks are coroutines, which viser runs in turn. Functions would run side by
    # side, and two quick presses of a key would move the slider only once.

    async def _push(self, _: Any) -> None:
        self.session.helm.throttle = self.throttle.value

    async def _turn(self, _: Any) -> None:
        """Take the helm: a hand on it counts more than an autopilot."""
        if self.autopilot.value != "off":
            self.autopilot.value = "off"
        self.session.helm.angle = math.radians(self.helm.value)

    def _on_key(self, key: Any, slider: Any, step: float) -> None:
        """Let a key move a slider."""
        command = self.gui.add_command(f"{slider.label} {step:+g}", hotkey=key)

        async def move(_: Any) -> None:
            slider.value = min(max(round(slider.value + step, 2), slider.min), slider.max)

        command.on_trigger(move)


class FeedControls(Controls):
    """A boat that others steer takes no orders, and its time cannot be stopped."""

    session: FeedSession

    def add(self) -> None:
        """Add what helps when another boat begins to send."""
        self._button("restart the twin", self.session.forget)

    def _add_time(self) -> None:
        self._add_record()


class LogControls(Controls):
    """The moment of a recorded run."""

    session: LogSession

    def _add_record(self) -> None:
        """Add nothing: the log is recorded already."""

    def add(self) -> None:
        """Add the slider of time."""
        t = self.session.log.t
        begin, end = float(t[0]), float(t[-1])
        with self.gui.add_folder("Moment"):
            self.at = self.gui.add_slider(
                "time (s)", begin, max(end, begin + 0.1), 0.1, begin, hint="of the log"
            )
            self.progress = self.gui.add_progress_bar(0.0)
            self.gui.add_html(small("Bar: how far the twin has come through the log."))

        def seek(event: Any) -> None:
            if event.client is not None:  # only changes by the user, not by show()
                self.session.order(self.session.seek, self.at.value)

        self.at.on_update(seek)

    def show(self, now: Snapshot) -> None:
        """Say what the instruments say, and move the slider along."""
        super().show(now)
        begin, end = self.at.min, self.at.max
        at = round(min(max(now.t, begin), end), 1)
        if at != self.at.value and not self.session.paused:
            self.at.value = at
        done = 100.0 * (self.session.done - begin) / (end - begin)
        self.progress.value = min(max(done, 0.0), 100.0)


def controls_of(server: viser.ViserServer, session: Session) -> Controls:
    """Return the controls that suit a session."""
    if isinstance(session, SimulatedSession):
        return SimulatedControls(server, session)
    if isinstance(session, PolicySession):
        return PolicyControls(server, session)
    if isinstance(session, LogSession):
        return LogControls(server, session)
    return FeedControls(server, session)


def said(now: Snapshot, session: Session) -> dict[str, str]:
    """Return what the instruments say, each under its name."""
    overlay, state = now.overlay, now.boat
    lines = {"time": f"{now.t:.1f} s"}
    if overlay is not None:
        u, v, r = overlay.state[U:]
        lines["speed (twin)"] = f"{math.hypot(u, v):.2f} m/s"
        lines["heading (twin)"] = f"{math.degrees(overlay.state[2]) % 360.0:05.1f} deg"
        lines["turn rate (twin)"] = f"{math.degrees(r):+.1f} deg/s"
        sd = math.sqrt(max(float(np.linalg.eigvalsh(overlay.covs[-1])[-1]), 0.0))
        lines[f"interval at {overlay.horizons[-1]:.0f} s"] = f"+/- {SDS * sd:.1f} m"
    if now.motion is not None:
        lines |= deck_lines(now.motion)
    if now.silence > 0.0:
        lines = {"feed": f"LOST, nothing heard for {now.silence:.0f} s", **lines}
    if isinstance(session, SimulatedSession | PolicySession):
        left, right = state[fr.DELTA_LEFT], state[fr.DELTA_RIGHT]
        shafts = 0.5 * (state[fr.N_LEFT] + state[fr.N_RIGHT])
        lines["shafts, drives"] = (
            f"{shafts:.1f} rev/s, {math.degrees(0.5 * (left + right)):+.1f} deg"
        )
        roll, pitch = np.degrees(state[[fr.PHI, fr.THETA]])
        lines["roll, pitch"] = f"{roll:+.1f}, {pitch:+.1f} deg"
        if overlay is not None:
            off = math.dist(overlay.state[:2], state[:2])
            lines["twin is off by"] = f"{off:.2f} m"
    known = math.isfinite(now.gps_age)
    lines["GPS"] = ("LOST, " if now.gps_lost else "") + (
        f"fix {now.gps_age:.1f} s old" if known else "no fix yet"
    )
    lines["IMU"] = "none" if not now.has_imu else "LOST" if now.imu_lost else "on"
    lines |= checks(now)
    if now.current is not None:
        north, east, *sds = now.current
        sd = math.sqrt(0.5 * (sds[0] ** 2 + sds[1] ** 2))
        course = math.degrees(math.atan2(east, north)) % 360.0
        lines["current (twin)"] = (
            f"{math.hypot(north, east):.2f} +/- {SDS * sd:.2f} m/s to {course:03.0f} deg"
        )
    if now.sea is not None:
        north, east = wx.air_velocity(now.t, now.sea.gusts, now.sea.weather)
        lines["wind"] = f"{math.hypot(north, east):.1f} m/s"
        height = wx.wave_gain(now.t, now.sea.weather) * 4.0
        height *= math.sqrt(0.5 * float((now.sea.waves[wv.AMPLITUDE] ** 2).sum()))
        lines["waves Hs"] = f"{height:.2f} m"
    for k, note in enumerate(now.notes):
        lines["messages" if k == 0 else " " * k] = note
    return lines | outcome(session)


def deck_lines(motion: MotionForecast) -> dict[str, str]:
    """Return how the deck moves by the twin, and how likely it stays quiet."""
    roll, pitch, heave = motion.mean[0, :3]
    spans = ", ".join(f"{span:g}" for span in QUIET_SPANS)
    chances = ", ".join(f"{100.0 * p:.0f}" for p in motion.quiet) + " %"
    return {
        "roll, pitch (twin)": f"{math.degrees(roll):+.1f}, {math.degrees(pitch):+.1f} deg",
        "heave (twin)": f"{heave:+.2f} m down",
        f"quiet for {spans} s": chances if motion.ready else "still learning",
    }


def outcome(session: Session) -> dict[str, str]:
    """Return what became of the log and of the last order."""
    lines = {}
    if session.recording:
        lines["log"] = f"recording, {session.kept} rows"
    elif session.recorded is not None:
        lines["log"] = f"written: {session.recorded.resolve()}"
    if session.message:
        lines["not done"] = session.message
    return lines


def checks(now: Snapshot) -> dict[str, str]:
    """Return which sensors agree with each other, and of the others since when not, and why."""
    lines = {}
    for status in ("ok", "absent"):
        # the navigation filter is no sensor: it is shown where it is in doubt
        names = ", ".join(
            name
            for name, each in now.health.items()
            if each.status == status and name != "navigation"
        )
        if names:
            lines[f"sensors {status}"] = names
    for name, each in now.health.items():
        if each.status in ("doubtful", "excluded"):
            why = each.why.removeprefix(f"{name} ")
            lines[f"{name} (check)"] = f"{each.status.upper()} since {each.since:.1f} s: {why}"
    return lines


def table(lines: dict[str, str]) -> str:
    """Return names and values as a small table."""
    rows = "".join(
        f"<tr><td style='color:#555;padding-right:8px;white-space:nowrap;vertical-align:top'>"
        f"{html.escape(name)}</td>"
        f"<td style='font-variant-numeric:tabular-nums;overflow-wrap:anywhere"
        f"{';font-weight:bold;color:#A03800' if ALARM.search(value) else ''}'>"
        f"{html.escape(value)}</td></tr>"
        for name, value in lines.items()
    )
    return f"<table id='status' style='font-size:12px;line-height:1.35;margin:6px'>{rows}</table>"


def small(*paragraphs: str) -> str:
    """Return paragraphs in small letters."""
    texts = "".join(f"<p style='margin:0 0 7px'>{text}</p>" for text in paragraphs)
    return f"<div style='font-size:12px;line-height:1.4;margin:6px'>{texts}</div>"


HELP = (
    "<b>Scene.</b> The boat is the true one, or as measured last; its copy is at the "
    "twin's estimate. The ribbon is the predicted track of the next 10 s, "
    f"{SDS:g} standard deviations to either side. The ellipse at its end is the same for the "
    "last moment. The ring shows the scale, N the north. Drag to turn the view, scroll to come "
    "nearer.",
    "<b>Interval at 10 s</b>: half the longer axis of that ellipse.",
    "<b>Error after 10 s</b>: distance from the position predicted 10 s ago to the truth. "
    "Where that is unknown, the twin's estimate at a new fix stands for it. Beside "
    "it, that of a boat that keeps its velocity and turn rate. Of manoeuvres and known "
    "commands the twin is given the commands to come; else it takes the last command to stay.",
    "<b>Sensors</b> are held against each other, and the commands against the motion. A DOUBTFUL "
    "one is used; an EXCLUDED one is not, until it agrees with the others again.",
    "<b>Current</b>: velocity of the water as the twin's model has it, and where it flows to.",
    f"<b>Parameters</b> of the twin's model, with {SDS:g} standard deviations (dotted). X, Y, N "
    "are those of surge, sway and yaw; the letters behind say what each multiplies (X_uu: "
    "u|u|). T: thrust. E: a push to north or east that nothing else explains, as of wind. C: the "
    "current. More: twin/model/structure.py.",
    "<b>Keys</b>: arrows steer, space stops the time, G loses GPS for 10 s, R restarts.",
)


def key(path: bool) -> str:
    """Return what each colour of the scene stands for."""
    entries: tuple[tuple[Any, str], ...] = (
        (RED, "twin, its next 10 s"),
        (PALE, f"{SDS:g} sd"),
        (BLUE, "track; thin: what came"),
        (PURPLE, "GPS fix"),
        *([(GREEN, "path")] if path else []),
    )
    items = "".join(
        f"<span style='white-space:nowrap;margin-right:8px'><span style='color:rgb{colour}'>"
        f"&#9632;</span> {html.escape(name)}</span> "
        for colour, name in entries
    )
    return f"<div style='font-size:11px;line-height:1.35;margin:0 6px 4px'>{items}</div>"
