"""What runs behind a view, in a thread of its own: a boat and its twin.

A session never waits for who looks: it hands out its latest :class:`Snapshot`, and takes orders
when it comes to them.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, Queue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.channels import TRUTH
from twin.integrity.monitor import SensorStatus
from twin.live.sessions.recorder import Recorder
from twin.live.sessions.tracker import LOST_AFTER_S, History, TwinMonitor, overlay_of
from twin.logs.datum import Datum
from twin.motion import MotionForecast
from twin.particulars import Particulars
from usv_gym.envs.scene import TwinOverlay
from usv_gym.physics import frames as fr
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.realisation import Sea
from usv_gym.world.simulation import Simulation
from usv_kernel.errors import UsvTwinError

__all__ = [
    "LAG_MAX_S",
    "SNAPSHOT_EVERY_S",
    "Session",
    "SessionError",
    "Snapshot",
    "measured_boat",
    "sea_of",
]

Array = NDArray[np.float64]

SNAPSHOT_EVERY_S = 0.05
"""Time between two snapshots: 20 Hz."""

LAG_MAX_S = 0.25
"""Lag from which on a session gives up catching up."""

UNKNOWN = np.full(len(TRUTH), math.nan)


class SessionError(UsvTwinError):
    """An order that cannot be carried out; the message says what can."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Snapshot:
    """All that a view shows of one moment."""

    t: float  # time, s
    # (16,): state of the real boat, layout in usv_gym.physics.frames: the true one, or what was
    # measured of it last; NaN in place and heading before
    boat: Array
    overlay: TwinOverlay | None  # estimate and prediction of the twin; None before a first fix
    motion: MotionForecast | None  # its forecast of roll, pitch and heave, where it has one
    # (F, 2), (T, 2): last fixes, and where the boat was, m north and east
    fixes: Array
    track: Array
    gps_age: float  # time since the last fix, s
    # whether fixes, or turn rates, that should have come did not
    gps_lost: bool
    imu_lost: bool
    has_imu: bool  # whether a turn rate has ever come
    # status of each sensor by its name; empty before the first row
    health: dict[str, SensorStatus] = field(default_factory=dict)
    # (4,): velocity of the water north and east, and its standard deviations, m/s; None where
    # the model has none
    current: Array | None = None
    # (A, 2): where the boat went in the 10 s that follow, where that is known; m north and east
    ahead: Array = field(default_factory=lambda: np.empty((0, 2)))
    # (K, 2): way points, m north and east; none where no path is followed
    path: Array = field(default_factory=lambda: np.empty((0, 2)))
    sea: Sea | None = None  # waves and wind; None where unknown
    # time of the clock for which nothing has come at all, s; 0 where that cannot be
    silence: float = 0.0
    notes: tuple[str, ...] = ()  # messages for the user


class Session(ABC):
    """A thread that runs a boat and its twin; subclasses define its steps.

    ``snapshot`` is the latest, ``fresh`` is set with every new one. ``scale`` is seconds of the run
    per second of the clock; ``paused``: time stands still. ``message`` says what the last order
    could not do. ``recorder`` writes
    the log that is being recorded, ``recorded`` is the file of the last one that was.
    ``error`` is what ended the thread.
    """

    monitor: TwinMonitor

    has_truth = False
    """Whether rows have the true state."""

    def __init__(self, vessel: Vessel | None, particulars: Particulars, folder: Path) -> None:
        self.vessel, self.particulars, self.folder = vessel, particulars, folder
        self.recorder: Recorder | None = None
        self.recorded: Path | None = None
        self.message = ""
        self.snapshot: Snapshot | None = None
        self.scale, self.paused = 1.0, False
        self.error: BaseException | None = None
        self._orders: Queue[Callable[[], None]] = Queue()
        self.fresh, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="session", daemon=True)

    def history(self) -> History:
        """Return the curves up to the moment that is shown."""
        return self.monitor.history()

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """End, and write what was recorded; the session's thread is over then."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join()

    def order(self, call: Callable[..., None], *arguments: Any) -> None:
        """Have something done in the session's thread, between two steps."""
        self._orders.put(lambda: call(*arguments))

    def report(self, text: str) -> None:
        """Show why an order was not carried out; may be called from any thread."""
        self.message = text

    def set_scale(self, scale: float) -> None:
        """Change the pace, seconds of the run per second of the clock."""
        self.scale = scale
        self._anchor_now()

    def set_paused(self, paused: bool) -> None:
        """Let time stand still, or go on."""
        self.paused = paused
        self._anchor_now()

    @abstractmethod
    def _advance(self) -> None:
        """Advance to the present time of the clock, in no more than about :data:`LAG_MAX_S`.

        Where it is paused, time stands still.
        """

    @abstractmethod
    def _look(self) -> Snapshot | None:
        """Return what is seen now; None while there is nothing."""

    @property
    def t(self) -> float:
        """Time of what is shown, s."""
        return self.monitor.t

    def _anchor_now(self) -> None:
        """Count the time of the run from now on."""
        self._anchor = time.monotonic(), self.t

    def _close(self) -> None:
        """Release resources; in the session's thread, at its end."""
        self.record(False)

    def forget(self) -> None:
        """Restart the twin, as for another boat; a log that is being recorded goes on."""
        self.monitor.twin.reset()
        self.monitor = TwinMonitor(self.monitor.twin)
        self.snapshot = None

    @property
    def recording(self) -> bool:
        """Whether a log is being recorded."""
        return self.recorder is not None

    def record(self, on: bool) -> None:
        """Begin to record a log, or end it."""
        if on and self.recorder is None:
            self.recorder = Recorder(self.folder, self.particulars, with_truth=self.has_truth)
        elif not on and self.recorder is not None:
            recorder, self.recorder = self.recorder, None
            self.recorded = recorder.close() or self.recorded

    @property
    def datum(self) -> Datum | None:
        """Where and when the origin is; None where that is not known."""
        return None

    def toggle_record(self) -> None:
        """Begin to record a log, or end and write it, whichever comes next."""
        self.record(not self.recording)

    def toggle_paused(self) -> None:
        """Let time stand still, or go on, whichever comes next."""
        self.set_paused(not self.paused)

    @property
    def kept(self) -> int:
        """Rows of the log that is being recorded."""
        recorder = self.recorder  # of another thread
        return 0 if recorder is None else recorder.rows

    def _keep(self, t: float, z: Array, cmd: Array, truth: Array = UNKNOWN) -> None:
        """Add a row to the log that is being recorded; one that the disk does not take ends."""
        if self.recorder is not None:
            try:
                self.recorder.add(t, z, cmd, truth, self.datum)
            except OSError as error:
                path = self.recorder.path
                with contextlib.suppress(OSError):
                    self.record(False)
                self.report(f"{path}: {error.strerror}; the log has ended there")

    def _run(self) -> None:
        due = time.monotonic()
        try:
            while not self._stop.is_set():
                self._obey()
                self._advance()
                now = time.monotonic()
                if now >= due:
                    due = max(due + SNAPSHOT_EVERY_S, now)
                    self.snapshot = self._look() or self.snapshot
                    self.fresh.set()
                self._stop.wait(min(max(due - time.monotonic(), 0.0), self._rest()))
        except BaseException as error:  # raised again by the main thread
            self.error = error
        try:
            self._close()
        except Exception as error:
            self.error = self.error or error
        self.fresh.set()

    def _obey(self) -> None:
        """Carry out the commands of the page; report those that fail, which change nothing."""
        with contextlib.suppress(Empty):
            while True:
                call = self._orders.get_nowait()
                try:
                    self.report("")
                    call()
                except OSError as error:
                    self.report(f"{_words(error)}; choose another folder")
                except (UsvTwinError, ImportError) as error:
                    self.report(str(error))
                except Exception as error:  # the boat sails on
                    self.report(f"{type(error).__name__}: {error}")

    def _rest(self) -> float:
        """Return how long may be slept before the next step, s."""
        return 0.01

    def _plan(self) -> str | Array:
        """Return the commands of the next seconds, as far as they are known."""
        return "hold"

    def _seen(self, boat: Array, silence: float = 0.0, **others: Any) -> Snapshot:
        """Return the monitor's part of a snapshot, and the rest as given."""
        monitor = self.monitor
        prediction = monitor.predict(self._plan())
        return Snapshot(
            t=monitor.t,
            boat=boat,
            overlay=None if prediction is None else overlay_of(prediction),
            motion=None if prediction is None else prediction.motion,
            fixes=np.array(monitor.fixes).reshape(-1, 2),
            track=np.array(monitor.track).reshape(-1, 2),
            gps_age=monitor.gps_age + silence,
            gps_lost=monitor.gps_age + silence > monitor.sensor_timeout,
            imu_lost=monitor.imu_age + silence > LOST_AFTER_S,
            has_imu=monitor.has_imu,
            health=monitor.twin.health,
            current=monitor.current_at(monitor.t),
            silence=silence,
            **others,
        )


def measured_boat(measured: Array, cmd: Array) -> Array:
    """Return a state (16,) of what was measured last (3,) and commanded (4,)."""
    boat = np.zeros(fr.STATE_SIZE)
    boat[[fr.X, fr.Y, fr.PSI]] = measured
    boat[fr.N_LEFT :] = cmd
    return boat


def sea_of(simulation: Simulation) -> Sea:
    """Return the waves and the wind of a simulated boat at this moment."""
    return Sea(
        *(part[0].copy() for part in (simulation.waves, simulation.gusts, simulation.weather))
    )


def _words(error: OSError) -> str:
    """Return the file and the reason of an error of the system."""
    return str(error) if error.filename is None else f"{error.filename}: {error.strerror}"
