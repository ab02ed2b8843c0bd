"""What runs behind a view, in a thread of its own: a boat and its twin.

A session never waits for who looks: it hands out its latest :class:`Snapshot`, and takes orders
when it comes to them.
"""

from __future__ import annotations

import bisect
import contextlib
import math
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.agents.controllers import LOS
from twin.live.feed import Feed
from twin.live.follower import HORIZON, PLAN_STEP, Follower, History, belief_of
from twin.log import COMMANDS, TRUTH, Log, beside
from twin.oracle import world_options
from twin.particulars import Particulars
from twin.predictor import Prediction
from twin.registry import DEFAULT, predictor_class
from twin.simulated import TRUE_STATE, measurement_row, particulars_of
from twin.state import write_whole
from twin.twin import PLANS, Twin, TwinError, known_plan
from usv_gym.manoeuvres import MANOEUVRES, commands
from usv_gym.physics import frames as fr
from usv_gym.render import Belief
from usv_gym.sea import Sea, SeaState
from usv_gym.sensors import END, START, Disturbance, Fault, SensorSuite
from usv_gym.simulation import Simulation
from usv_gym.tasks import REACH, Curves, follow
from usv_gym.vessel import Vessel

__all__ = ["AUTOPILOTS", "FeedSession", "LogSession", "Session", "SimulatedSession", "Snapshot"]

Array = NDArray[np.float64]

PUBLISHED = 0.05
"""Time between two snapshots, s: 20 Hz."""
SLIP = 0.25
"""A session that is behind by more gives up catching up, s."""
REPLY = 0.2
"""Time between two answers to a feed, s."""
RATE_OVER = 2.0
"""The pace is measured over so many seconds."""
SNAPSHOTS = 4000
"""Moments of a recorded run that are kept at most."""
AUTOPILOTS = ("off", *MANOEUVRES, "path")
"""Who steers: the sliders, a manoeuvre from the moment on at which it is chosen, or line of sight
along a path, from where the twin believes to be."""
DECISION, STEADY = 0.5, 4.0
"""Time between two decisions of the path's autopilot, and over which its commands are averaged to
say what it will go on with, s."""
NEVER = 1e12
UNKNOWN = np.full(len(TRUTH), math.nan)


@dataclass(frozen=True, eq=False, kw_only=True)
class Snapshot:
    """All that a view shows of one moment.

    Parameters
    ----------
    t : float
        Time, s.
    boat : ndarray, shape (16,)
        State of the real boat, layout in :mod:`usv_gym.physics.frames`: the true one, or what
        was measured of it last; NaN in place and heading before.
    belief : Belief or None
        What the twin believes, now and ahead; None before a first fix.
    prediction : Prediction or None
        The same in full.
    fixes, track : ndarray, shape (F, 2), (T, 2)
        Last fixes, and where the boat was, m north and east.
    gps_age : float
        Time since the last fix, s.
    gps_lost, imu_lost : bool
        Whether fixes, or turn rates, that should have come did not.
    error, error_hold : float
        How far off the place predicted 10 s ago is, m, by the twin and by holding velocity and
        turn rate; NaN where nothing tells.
    ahead : ndarray, shape (A, 2)
        Where the boat went in the 10 s that follow, where that is known; m north and east.
    path : ndarray, shape (K, 2)
        Way points, m north and east; none where no path is followed.
    sea : Sea or None
        Waves and wind; None where nobody knows.
    rate : float
        Seconds of the run per second of the clock.
    notes : tuple of str
        What whoever looks should know.
    """

    t: float
    boat: Array
    belief: Belief | None
    prediction: Prediction | None
    fixes: Array
    track: Array
    gps_age: float
    gps_lost: bool
    imu_lost: bool
    error: float
    error_hold: float
    ahead: Array = field(default_factory=lambda: np.empty((0, 2)))
    path: Array = field(default_factory=lambda: np.empty((0, 2)))
    sea: Sea | None = None
    rate: float = math.nan
    notes: tuple[str, ...] = ()


class Session(ABC):
    """A thread that lives a run; subclasses say what comes next.

    Attributes
    ----------
    snapshot : Snapshot or None
        The latest; None before the first.
    scale : float
        Seconds of the run per second of the clock.
    paused : bool
        Whether time stands still.
    fresh : threading.Event
        Set with every new snapshot.
    changed : int
        How often another boat or twin took over.
    message : str
        What the last order could not do; empty where it could.
    recorded : Path or None
        File of the last log that was recorded.
    error : BaseException or None
        What ended the thread.
    """

    def __init__(self, vessel: Vessel | None, particulars: Particulars, folder: Path) -> None:
        self.vessel, self.particulars, self.folder = vessel, particulars, folder
        self.recording = False
        self.recorded: Path | None = None
        self._rows: list[tuple[float, Array, Array, Array]] = []
        self.message = ""
        self.snapshot: Snapshot | None = None
        self.scale, self.paused = 1.0, False
        self.error: BaseException | None = None
        self.changed = 0
        self._orders: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self.fresh, self._stop = threading.Event(), threading.Event()
        self._marks: list[tuple[float, float]] = []
        self._thread = threading.Thread(target=self._run, name="session", daemon=True)

    @property
    @abstractmethod
    def follower(self) -> Follower:
        """The twin and what is seen of it."""

    def history(self) -> History:
        """Return the curves up to the moment that is shown."""
        return self.follower.history()

    def start(self) -> None:
        """Begin to live."""
        self._thread.start()

    def stop(self) -> None:
        """End, and write what was recorded; the session's thread is over then."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join()

    def order(self, call: Callable[..., None], *arguments: Any) -> None:
        """Have something done in the session's thread, between two steps."""
        self._orders.put(lambda: call(*arguments))

    def set_scale(self, scale: float) -> None:
        """Change the pace."""
        self.scale = scale
        self._mark_anew()

    def set_paused(self, paused: bool) -> None:
        """Let time stand still, or go on."""
        self.paused = paused
        self._mark_anew()

    @abstractmethod
    def _advance(self) -> None:
        """Live on up to the present moment of the clock; no longer than about :data:`SLIP`."""

    @abstractmethod
    def _look(self) -> Snapshot | None:
        """Return what is seen now; None while there is nothing."""

    def _mark_anew(self) -> None:
        """Forget the pace of before: from now on time runs otherwise."""
        self._marks.clear()

    def _close(self) -> None:
        """Let go of what is held; in the session's thread, at its end."""
        self.record(False)

    def record(self, on: bool) -> None:
        """Begin to record a log, or end and write it."""
        if self._rows:
            t, z, cmd, truth = (np.array(column) for column in zip(*self._rows, strict=True))
            known = truth if np.isfinite(truth).any() else None
            self._rows = []
            self.recorded = save(Log(t, z, cmd, known, "view"), self.particulars, self.folder)
        self.recording = on

    def _keep(self, t: float, z: Array, cmd: Array, truth: Array = UNKNOWN) -> None:
        """Add a row to the log that is being recorded, if one is."""
        if self.recording:
            self._rows.append((t, z.copy(), cmd.copy(), truth.copy()))

    def _run(self) -> None:
        due = time.monotonic()
        try:
            while not self._stop.is_set():
                self._obey()
                if not self.paused:
                    self._advance()
                now = time.monotonic()
                if now >= due:
                    due = max(due + PUBLISHED, now)
                    self.snapshot = self._look() or self.snapshot
                    self.fresh.set()
                self._stop.wait(min(max(due - time.monotonic(), 0.0), self._rest()))
        except BaseException as error:  # told by who waits in the main thread
            self.error = error
        finally:
            self._close()
            self.fresh.set()

    def _obey(self) -> None:
        """Carry out what was ordered; what cannot be done is told, and changes nothing."""
        with contextlib.suppress(Empty):
            while True:
                call = self._orders.get_nowait()
                try:
                    self.message = ""
                    call()
                except (ValueError, ImportError, OSError) as error:
                    self.message = str(error)

    def _rest(self) -> float:
        """Return how long may be slept before the next step, s."""
        return 0.01

    def _rate(self, t: float) -> float:
        """Return seconds of the run per second of the clock, over the last two."""
        now = time.monotonic()
        self._marks.append((now, t))
        while len(self._marks) > 2 and self._marks[0][0] < now - RATE_OVER:
            self._marks.pop(0)
        (begin, first), (end, last) = self._marks[0], self._marks[-1]
        return (last - first) / (end - begin) if end - begin > 0.3 else math.nan

    def _plan(self) -> str | Array:
        """Return the commands of the next seconds, as far as they are known."""
        return "hold"

    def _seen(self, boat: Array, **others: Any) -> Snapshot:
        """Return the follower's part of a snapshot, and the rest as given."""
        follower = self.follower
        prediction = follower.predict(self._plan())
        return Snapshot(
            t=follower.t,
            boat=boat,
            belief=None if prediction is None else belief_of(prediction),
            prediction=prediction,
            fixes=np.array(follower.fixes).reshape(-1, 2),
            track=np.array(follower.track).reshape(-1, 2),
            gps_age=follower.gps_age,
            gps_lost=follower.gps_lost,
            imu_lost=follower.imu_lost,
            error=follower.error,
            error_hold=follower.error_hold,
            **others,
        )


@dataclass(frozen=True, kw_only=True)
class World:
    """What a simulated session begins with.

    Parameters
    ----------
    vessel, sea, predictor, sensors
        As ``usv-twin simulate`` and ``identify`` take them.
    seed : int
        Of sea, sensors, paths and random manoeuvres.
    dof : int
        Degrees of freedom of the ship.
    faults : sequence of Disturbance
        Faults of sensors beside those that are ordered.
    """

    vessel: Vessel
    sea: SeaState
    predictor: str = DEFAULT
    sensors: str = "typical"
    seed: int = 0
    dof: int = 6
    faults: Sequence[Disturbance] = ()


class SimulatedSession(Session):
    """A boat in a simulated sea that is steered, disturbed and deprived of its sensors by hand.

    Parameters
    ----------
    world : World
        What it begins with.
    folder : Path
        Where recorded logs go.
    autopilot : str
        Who steers at first, one of :data:`AUTOPILOTS`.

    Attributes
    ----------
    world : World
        What the run that is on began with.
    throttle, helm : float
        Part of the usual shaft speed, and helm angle in rad, of who steers by hand.
    """

    def __init__(self, world: World, folder: Path, autopilot: str = "off") -> None:
        super().__init__(world.vessel, particulars_of(world.vessel), folder)
        self.throttle, self.helm, self.autopilot = 1.0, 0.0, autopilot
        self.restart(world)

    @property
    def follower(self) -> Follower:
        """The twin and what is seen of it."""
        return self._follower

    def restart(self, world: World) -> None:
        """Begin anew; a log that is being recorded ends."""
        suite = SensorSuite.grade(world.sensors)
        # two windows of loss that are moved when they are ordered
        gps, imu = (Fault(kind, NEVER, 1.0) for kind in ("gps", "imu"))
        simulation = Simulation(
            1,
            world.vessel,
            world.sea,
            suite=suite,
            faults=(gps, imu, *world.faults),
            dof=world.dof,
            changing=True,
        )
        particulars = particulars_of(world.vessel, suite, world.dof)
        told: dict[str, Any] = {}
        if predictor_class(world.predictor).world:
            told = world_options(world.predictor, world.vessel, world.sea, world.dof)
        twin = Twin(particulars, world.predictor, seed=world.seed, **told)
        self.record(False)
        rng, self._sea_rng, self._helm_rng = np.random.default_rng(world.seed).spawn(3)
        simulation.reset([0], [rng])
        self.world, self.vessel, self.particulars = world, world.vessel, particulars
        self.simulation, self._follower = simulation, Follower(twin)
        self.usual = world.vessel.values["shaft_speed_manoeuvring"]
        self._anchor = time.monotonic(), 0.0
        self.steer(self.autopilot)
        self._mark_anew()
        self._feed()
        self.changed += 1

    @property
    def t(self) -> float:
        """Time since the restart, s."""
        return float(self.simulation.t[0])

    def set_scale(self, scale: float) -> None:
        """Change the pace."""
        super().set_scale(scale)
        self._anchor = time.monotonic(), self.t

    def set_paused(self, paused: bool) -> None:
        """Let time stand still, or go on."""
        super().set_paused(paused)
        self._anchor = time.monotonic(), self.t

    def steer(self, autopilot: str) -> None:
        """Hand the helm over, from this moment on."""
        self.autopilot, self._since = autopilot, self.t
        self._path = np.empty((0, 2))
        if autopilot == "path":
            self._plan_path()

    def lose(self, kind: str, seconds: float) -> None:
        """Lose ``gps`` or ``imu`` from now on for so long; infinity is until it is found again."""
        row = self.simulation.faults[0, ("gps", "imu").index(kind)]
        row[START], row[END] = self.t, self.t + seconds

    def find(self, kind: str) -> None:
        """End a loss."""
        self.lose(kind, 0.0)

    def change_sea(self, sea: SeaState) -> None:
        """Put the boat into another sea."""
        self.simulation.change_sea(0, sea, self._sea_rng)

    def _rest(self) -> float:
        return self.simulation.dt / max(self.scale, 1e-3)

    def _advance(self) -> None:
        begin, first = self._anchor
        now = time.monotonic()
        goal = first + (now - begin) * self.scale
        while self.t + self.simulation.dt <= goal + 1e-9:
            self.simulation.step(self._command()[None])
            self._feed()
            if time.monotonic() > now + SLIP:  # too much is asked of this machine
                self._anchor = time.monotonic(), self.t
                break

    def _feed(self) -> None:
        sim = self.simulation
        z, truth = measurement_row(sim.z[0]), sim.state[0, TRUE_STATE]
        self._follower.step(self.t, z, sim.cmd[0], truth)
        self._keep(self.t, z, sim.cmd[0], truth)

    def _command(self) -> Array:
        """Return what propellers and drives are told now."""
        if self.autopilot in MANOEUVRES:
            return self._manoeuvre(np.zeros(1))[0]
        if self.autopilot == "path":
            return self._along_path()
        vessel = self.world.vessel
        helm = min(max(self.helm, -vessel.helm_max), vessel.helm_max)
        return vessel.helm(self.usual * self.throttle, helm)

    def _manoeuvre(self, ahead: Array) -> Array:
        """Return the commands (K, 4) of the manoeuvre in so many seconds (K,) from now."""
        # a function of time: what is drawn at random is drawn alike each time
        rng, now = np.random.default_rng(self.world.seed), self.t - self._since
        times = np.concatenate([np.arange(0.0, now, 1.0), now + ahead])
        shaft = self.usual * self.throttle
        return commands(self.autopilot, times, self.world.vessel, rng, shaft)[-len(ahead) :]

    def _plan(self) -> str | Array:
        if self.autopilot in MANOEUVRES:
            return self._manoeuvre(np.arange(0.0, HORIZON, PLAN_STEP))
        if self.autopilot == "path":  # what it does against waves and noise does not last
            return np.tile(self._steady, (round(HORIZON / PLAN_STEP), 1))
        return "hold"

    def _plan_path(self) -> None:
        """Draw a curve that begins where the twin believes the boat to be."""
        speed, vessel = self.particulars.speed, self.world.vessel
        task = Curves(1, speed, vessel.values["length_waterline"])
        task.reset(0, self._helm_rng)
        x, y, psi = self._follower.twin.predictor.s[:3]
        c, s = math.cos(psi), math.sin(psi)
        self._path = task.points[0] @ np.array([[c, s], [-s, c]]) + [x, y]
        self._leg, self._reach = 0, float(task.rules[REACH])
        self._decided = -math.inf
        self._steady = self.simulation.cmd[0].copy()
        self._los = LOS()
        self._los.fit(vessel, speed, DECISION, self._reach)

    def _along_path(self) -> Array:
        """Return what line of sight commands, twice a second, by what the twin believes."""
        if self.t >= self._decided + DECISION - 1e-9:
            self._decided = self.t
            if self._leg + 2 >= len(self._path):
                self._plan_path()
            x, y, psi, u, _, r = self._follower.twin.predictor.s
            errors = np.empty(4)
            self._leg = follow(x, y, psi, self._path, self._leg, self._reach, errors)
            e, to_go, off, turn = errors
            motion = [
                *(e, to_go, math.cos(off), math.sin(off), math.cos(turn), math.sin(turn)),
                *(r, u / self.particulars.speed),
            ]
            shaft, helm = self._los.steer(np.array([motion]))[0]
            vessel = self.world.vessel
            full = self.throttle * vessel.values["shaft_speed_service"]
            self._steered = vessel.helm(shaft * full, helm * vessel.helm_max)
            self._steady += DECISION / STEADY * (self._steered - self._steady)
        return self._steered

    def _look(self) -> Snapshot:
        sim = self.simulation
        sea = Sea(sim.waves[0].copy(), sim.gusts[0].copy(), sim.weather[0].copy())
        state = sim.state[0].copy()
        return self._seen(state, path=self._path, sea=sea, rate=self._rate(self.t))


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
    """

    def __init__(
        self, log: Log, twin: Twin, vessel: Vessel | None, folder: Path, plan: str = "hold"
    ) -> None:
        super().__init__(vessel, twin.particulars, folder)
        if plan not in PLANS:
            raise TwinError(f"plan = {plan!r}: use {' or '.join(PLANS)}")
        self.log, self.plan, self._row = log, plan, 0
        self._follower = Follower(twin)
        self.at = self.done = float(log.t[0])
        self._moments: list[Snapshot] = []
        self._times: list[float] = []
        span = float(log.t[-1] - log.t[0])
        self._spacing = max(2.0 * PUBLISHED, span / SNAPSHOTS)
        self._anchor = time.monotonic(), self.at
        known = log.z[:, :2] if log.truth is None else log.truth[:, :2]
        self._known = np.isfinite(known[:, 0])
        self._places, self._when = known[self._known], log.t[self._known]

    @property
    def follower(self) -> Follower:
        """The twin and what is seen of it."""
        return self._follower

    def history(self) -> History:
        """Return the curves up to the moment that is shown."""
        whole = self._follower.history()
        rows = whole.t <= self.at + 1e-9
        return History(**{name: values[rows] for name, values in vars(whole).items()})

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
        worker = threading.Thread(target=self._go_through, name="twin", daemon=True)
        worker.start()
        super()._run()
        self._stop.set()
        worker.join()

    def _go_through(self) -> None:
        """Feed the twin all rows, and keep what it believed in between."""
        log, due = self.log, -math.inf
        try:
            for row, (t, z, cmd) in enumerate(log):
                if self._stop.is_set():
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


def measured_boat(measured: Array, cmd: Array) -> Array:
    """Return a state (16,) of what was measured last (3,) and commanded (4,)."""
    boat = np.zeros(fr.STATE_SIZE)
    boat[[fr.X, fr.Y, fr.PSI]] = measured
    boat[fr.N_LEFT :] = cmd
    return boat


def save(log: Log, particulars: Particulars, folder: Path) -> Path:
    """Write a log and the boat's particulars to new files of a folder; return the log's."""
    folder.mkdir(parents=True, exist_ok=True)
    stamp = time.strftime("%Y%m%d-%H%M%S")
    names = (f"view_{stamp}{suffix}.csv" for suffix in ("", *(f"_{k}" for k in range(2, 1000))))
    path = next(folder / name for name in names if not (folder / name).exists())
    log.write(path)
    write_whole(beside(path, ".toml"), particulars.to_toml().encode())
    return path
