"""Flights of the real ArduRover on our boats, with a minute without GPS.

``python examples/autopilot/flights.py usv75 dsw-ukf-plus odometry 1 2 3`` prints a line of JSON for
each seed; ``off`` in place of ``odometry`` leaves the twin out. ``USV_TWIN_ARDUROVER`` is the path
of ArduPilot's ``ardurover``, beside which lies its ``rover.parm``.
"""

from __future__ import annotations

import json
import math
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from twin.digital_twin import Twin
from twin.live.external.navigation import ExternalNavigation, ExternalOptions
from twin.live.external.peer import AutopilotPeer, MavlinkPort
from twin.live.external.simulated import AutopilotRun, suite_of
from twin.logs.datum import Datum
from twin.sim.bridge import particulars_of
from usv_gym.sitl.backend import Backend
from usv_gym.sitl.parameters import autopilot_parameters, parameter_text
from usv_gym.sitl.server import Server
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.faults import Fault
from usv_gym.world.sea import SeaState
from usv_gym.world.simulation import Simulation

NEVER = 1e9
HOME = Datum(latitude=59.9, longitude=10.7)
AUTO, HOLD = 10, 4
LANE = {"usv75": (250.0, 50.0), "otter": (100.0, 25.0)}
SEAS = {
    "usv75": SeaState(hs=0.5, wind=6.0, current=0.2, current_to=math.radians(60.0)),
    "otter": SeaState(hs=0.3, wind=5.0, current=0.2, current_to=math.radians(60.0)),
}


def lawnmower(vessel: str, lanes: int = 3) -> np.ndarray:
    """Return way points (K, 2), m north and east: lanes to the north and back."""
    length, apart = LANE[vessel]
    points = [(10.0, 0.0)]
    for lane in range(lanes):
        ends = (length, 10.0) if lane % 2 else (10.0, length)
        points += [(end, lane * apart) for end in (ends if lane else ends[1:])]
    return np.array(points)


def free_port() -> int:
    """Return a UDP port that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


class GroundStation:
    """Uploads a mission, arms, and notes what the autopilot says; no step waits."""

    def __init__(self, points: np.ndarray) -> None:
        plane = HOME.plane
        assert plane is not None
        self.points = [tuple(map(float, plane.degrees(*point))) for point in points]
        self.plane = plane
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.port = self.socket.getsockname()[1]
        self.link = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
        self.parser = dialect.MAVLink(None)
        self.parser.robust_parsing = True
        self.target: Any = None
        self.uploaded = self.armed = False
        self.mode, self.reached = -1, 0
        self.asked = -math.inf
        self.modes: list[tuple[float, int]] = []
        self.texts: list[tuple[float, str]] = []
        self.places: list[tuple[float, float, float]] = []

    def send(self, message: Any) -> None:
        if self.target is not None:
            self.socket.sendto(message.pack(self.link), self.target)
            self.link.seq = (self.link.seq + 1) % 256

    def command(self, number: int, *values: float) -> None:
        padded = [*values, *[0.0] * (7 - len(values))]
        self.send(dialect.MAVLink_command_long_message(1, 1, number, 0, *padded))

    def poll(self, t: float) -> None:
        while True:
            try:
                data, self.target = self.socket.recvfrom(1 << 16)
            except BlockingIOError:
                break
            except OSError:
                continue
            for item in self.parser.parse_buffer(data) or ():
                self.hear(t, item)
        if self.target is not None and t - self.asked >= 1.0:
            self.asked = t
            self.urge(t)

    def urge(self, t: float) -> None:
        """Ask for what is due next."""
        self.send(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        if not self.uploaded:
            self.command(511, dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 1e5)
            self.command(511, dialect.MAVLINK_MSG_ID_MISSION_CURRENT, 1e6)
            self.send(dialect.MAVLink_mission_count_message(1, 1, len(self.points) + 1, 0))
        elif not self.armed and t > 40.0:
            self.command(176, 1, AUTO)
            self.command(400, 1)

    def hear(self, t: float, item: Any) -> None:
        kind = item.get_type()
        if kind == "HEARTBEAT" and item.get_srcComponent() == 1:
            self.armed = bool(item.base_mode & 128)
            if item.custom_mode != self.mode:
                self.mode = item.custom_mode
                self.modes.append((t, self.mode))
        elif kind in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
            place = self.points[max(item.seq - 1, 0)]
            numbers = round(1e7 * place[0]), round(1e7 * place[1])
            self.send(
                dialect.MAVLink_mission_item_int_message(
                    1, 1, item.seq, 3, 16, 0, 1, 0, 0, 0, 0, *numbers, 0.0, 0
                )
            )
        elif kind == "MISSION_ACK":
            self.uploaded = item.type == 0
        elif kind == "MISSION_ITEM_REACHED":
            self.reached = max(self.reached, item.seq)
        elif kind == "STATUSTEXT":
            self.texts.append((t, item.text))
        elif kind == "GLOBAL_POSITION_INT":
            north, east = self.plane.metres(item.lat / 1e7, item.lon / 1e7)
            self.places.append((item.time_boot_ms / 1000.0, float(north), float(east)))

    @property
    def done(self) -> bool:
        return self.reached >= len(self.points)


class Loss(NamedTuple):
    """What a loss of the GPS did."""

    vessel: str
    predictor: str
    kind: str
    seed: int
    seconds: float
    auto: bool  # whether the mode was Auto throughout
    sailed: float  # m in the loss
    error: float  # of the autopilot's estimate at the end, m
    after: float  # the same three seconds after the GPS was back
    off_track: float  # largest distance of the true boat to the plan in the loss, m
    sd: float  # standard deviation that the twin stated at the end, m
    inside: bool  # whether its 90 % region holds the truth then
    track_rms: float  # distance of the true boat to the plan before the loss, rms, m
    pace: float  # simulated seconds per second
    packets: dict[str, int]
    events: list[tuple[float, str]]


LEG, INTO_LEG = 3, 20.0
"""The loss begins so many seconds after this way point is reached."""


def lose(flight: Flight, seconds: float, about: tuple[str, str, str, int]) -> Loss:
    """Sail the mission up to a loss of the GPS, and on until half a minute after it."""
    begun = time.monotonic()
    while flight.station.reached < LEG and flight.backend.t < 900.0:
        flight.until(flight.backend.t + 1.0)
    flight.until(flight.backend.t + INTO_LEG)
    start = flight.lose_gps(seconds)
    end = start + seconds
    flight.until(end + 30.0)
    pace = flight.backend.t / (time.monotonic() - begun)
    log = flight.run.log
    within = log.slice(start, end).truth[:, :2]
    before = log.slice(60.0, start).truth[::20, :2]
    last = log.truth[min(np.searchsorted(log.t, end), len(log) - 1), :2]
    sd, inside = math.nan, False
    known = [row for row in flight.estimates if row[0] < end]
    if known:
        x, y, sd_x, sd_y = known[-1][1:]
        sd = max(sd_x, sd_y)
        inside = bool(((last[0] - x) / sd_x) ** 2 + ((last[1] - y) / sd_y) ** 2 < 4.605)
    return Loss(
        *about,
        seconds=seconds,
        auto=all(mode == AUTO for t, mode in flight.station.modes if t > start),
        sailed=float(np.hypot(*np.diff(within, axis=0).T).sum()),
        error=flight.error(end - 0.1),
        after=flight.error(end + 3.0),
        off_track=max(map(flight.off_track, within[::10])),
        sd=sd,
        inside=inside,
        track_rms=float(np.sqrt(np.mean([flight.off_track(p) ** 2 for p in before]))),
        pace=pace,
        packets=flight.backend.counts,
        events=flight.events,
    )


class Flight:
    """A mission of ArduRover on one of our boats, with or without the twin."""

    def __init__(
        self,
        program: Path,
        folder: Path,
        vessel: str,
        *,
        seed: int = 0,
        options: ExternalOptions | None = None,
        predictor: str = "dsw-ukf-plus",
    ) -> None:
        boat, suite = Vessel.load(vessel), suite_of("typical")
        simulation = Simulation(
            1,
            boat,
            SEAS[vessel],
            suite=suite,
            faults=(Fault("gps", NEVER, 1.0),),  # moved when it is ordered
            dof=6,
            dt=0.01,
            dt_physics=0.01,
        )
        self.points = lawnmower(vessel)
        self.backend = Backend(simulation, seed)
        self.navigation = ExternalNavigation(options, self.note) if options else None
        self.twin = Twin(particulars_of(boat, suite, 6), predictor) if options else None
        self.events: list[tuple[float, str]] = []
        station = self.station = GroundStation(self.points)
        peer = self.navigation.peer if self.navigation else AutopilotPeer()
        self.port = MavlinkPort(f"udp://127.0.0.1:{free_port()}", peer)
        self.run = AutopilotRun(
            self.backend,
            HOME,
            twin=self.twin,
            navigation=self.navigation,
            port=self.port,
            on_row=lambda t, z, cmd, truth: self.row(t),
        )
        self.estimates: list[tuple[float, ...]] = []
        self.server = Server(self.backend, port=free_port())
        given = autopilot_parameters(boat, external=options is not None)
        if options is not None and options.kind == "gps-input":
            given["GPS1_TYPE"] = 14
        (folder / "boat.parm").write_text(parameter_text(boat, given | {"LOG_BACKEND_TYPE": 0}))
        place = f"{HOME.latitude},{HOME.longitude},0,0"
        self.process = subprocess.Popen(
            [
                str(program),
                "-w",
                "-S",
                "--model",
                "JSON:127.0.0.1",
                "--speedup",
                "100",
                "--rate",
                "100",
                "--defaults",
                f"{program.parent / 'rover.parm'},{folder / 'boat.parm'}",
                "--home",
                place,
                "--sim-port-out",
                str(self.server.port),
                "--serial0",
                f"udpclient:127.0.0.1:{self.port.port}",
                "--serial1",
                f"udpclient:127.0.0.1:{station.port}",
                # its other ports differ from those of a flight at the same time
                f"-I{self.server.port % 90 + 5}",
            ],
            cwd=folder,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def note(self, t: float, text: str) -> None:
        self.events.append((t, text))

    def row(self, t: float) -> None:
        self.station.poll(t)
        if self.twin is not None:
            now = self.twin.estimate()
            if now.ready:
                self.estimates.append((t, *now.state[:2].tolist(), *now.sd[:2].tolist()))

    def until(self, t: float) -> None:
        """Go on until a time, s, or until the mission is done."""
        while self.backend.t < t and not self.station.done:
            if not self.server.poll(60.0):
                raise AssertionError(f"ArduRover is silent at t = {self.backend.t:.1f} s")

    def lose_gps(self, seconds: float) -> float:
        """Lose the GPS from the next whole second on; return its time."""
        fault = self.backend.simulation.faults[0, 0]
        fault["start"] = begin = math.ceil(self.backend.t) + 1.0
        fault["end"] = begin + seconds
        return float(begin)

    def off_track(self, place: np.ndarray) -> float:
        """Return the distance of a place to the planned path, m."""
        legs = zip(self.points[:-1], self.points[1:], strict=True)
        found = []
        for a, b in legs:
            along = np.clip((place - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
            found.append(float(np.hypot(*(place - a - along * (b - a)))))
        return min(found)

    def error(self, t: float) -> float:
        """Return how far the autopilot's own estimate is from the truth at a time, m."""
        places, log = np.array(self.station.places), self.run.log
        at = places[min(np.searchsorted(places[:, 0], t), len(places) - 1)]
        row = min(np.searchsorted(log.t, at[0]), len(log) - 1)
        return math.dist(at[1:], log.truth[row, :2])

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self.server.close()
        self.port.close()
        self.station.socket.close()


def main(vessel: str, predictor: str, kind: str, *seeds: str) -> None:
    """Print a line of JSON for each seed."""
    program = Path(os.environ["USV_TWIN_ARDUROVER"])
    for seed in map(int, seeds):
        options = None if kind == "off" else ExternalOptions(kind=kind)
        with tempfile.TemporaryDirectory() as folder:
            flight = Flight(
                program, Path(folder), vessel, seed=seed, options=options, predictor=predictor
            )
            try:
                found = lose(flight, 60.0, (vessel, predictor, kind, seed))
            finally:
                flight.close()
        print(json.dumps(found._asdict()), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
