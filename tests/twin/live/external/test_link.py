"""A link to an autopilot over a socket: rows of its receiver, and the hand-over at a loss."""

import math
import socket
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from tests.twin.live.wire import free_port
from twin.digital_twin import Twin
from twin.live.external.link import Link
from twin.live.external.navigation import ExternalNavigation
from twin.live.external.peer import AutopilotPeer, MavlinkPort
from twin.live.external.receiver import ReceiverFeed
from twin.live.protocols.mavlink import JumpCounter
from twin.logs.datum import Plane
from twin.logs.wire.sockets import FeedError
from twin.sim.bridge import particulars_of
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.sensors import SensorSuite
from usv_kernel.channels import GPS_VX, GPS_X

HOME = Plane(59.9, 10.7)
BOAT = particulars_of(Vessel.load("usv75"), SensorSuite(gps_latency=0.0))
SPEED = 3.0


class Pilot:
    """An autopilot on a boat that sails north; its own estimate is nonsense."""

    def __init__(self, port: int) -> None:
        self.to = ("127.0.0.1", port)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.link = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self.parser = dialect.MAVLink(None)
        self.fix_type, self.armed = 3, True
        self.heard: dict[str, list[Any]] = {}
        self.sources: list[float] = []

    def send(self, *messages: Any) -> None:
        for message in messages:
            self.socket.sendto(message.pack(self.link), self.to)

    def step(self, k: int) -> None:
        t = 0.05 * k
        ms, d = round(1e3 * t) + 10_000, dialect
        lat, lon = (round(1e7 * float(v)) for v in HOME.degrees(SPEED * t, 0.0))
        widths = [1500, 0, 1640] + [0] * 5
        self.send(
            d.MAVLink_attitude_message(ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            d.MAVLink_raw_imu_message(1000 * ms, 0, 0, -1000, 0, 0, 0, 0, 0, 0),
            d.MAVLink_servo_output_raw_message(1000 * ms, 0, *widths),
            d.MAVLink_global_position_int_message(ms, lat + 90000, lon, 0, 0, 0, 0, 0, 0),
        )
        if k % 4 == 0:
            cm = round(100 * SPEED)
            self.send(
                d.MAVLink_gps_raw_int_message(
                    1000 * ms, self.fix_type, lat, lon, 0, 100, 100, cm, 0, 12
                )
            )
        if k % 20 == 0:
            base = 128 if self.armed else 0
            self.send(d.MAVLink_heartbeat_message(11, 3, base, 10, 4, 3))

    def listen(self) -> None:
        while True:
            try:
                data = self.socket.recv(1 << 16)
            except BlockingIOError:
                return
            for item in self.parser.parse_buffer(data) or ():
                self.heard.setdefault(item.get_type(), []).append(item)
                if item.get_type() == "COMMAND_LONG":
                    self.obey(item)

    def obey(self, item: Any) -> None:
        if item.command == 42007:
            self.sources.append(item.param1)
        if item.command == 512:
            lat, lon = (round(1e7 * float(v)) for v in HOME.degrees(3.5, 1.4))
            self.send(dialect.MAVLink_gps_global_origin_message(lat, lon, 0))
        self.send(dialect.MAVLink_command_ack_message(item.command, 0))


class Both:
    """An autopilot and the twin at the other end of its wire, in steps of 0.05 s."""

    def __init__(self) -> None:
        self.now, self.k = 0.0, 0
        port = free_port()
        self.events: list[str] = []
        self.navigation = ExternalNavigation(
            lambda t, text: self.events.append(text), moving_s=5.0, ready_sd_m=50.0, max_sd_m=1e3
        )
        self.feed = ReceiverFeed(
            f"udp://127.0.0.1:{port}", BOAT, self.navigation.peer, clock=lambda: self.now
        )
        self.link, self.twin = Link(self.feed, self.navigation), Twin(BOAT, "persistence")
        self.pilot = Pilot(port)
        self.rows: list[tuple[float, np.ndarray, np.ndarray]] = []
        take = self.feed.take
        self.feed.take = lambda: self.keep(take())  # type: ignore[method-assign]

    def keep(self, rows: list[Any]) -> list[Any]:
        self.rows += rows
        return rows

    def sail(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.05)):
            self.pilot.step(self.k)
            self.link.step(self.twin)
            self.pilot.listen()
            self.k += 1
            self.now = 0.05 * self.k

    @property
    def states(self) -> list[str]:
        return [text.partition(":")[0] for text in self.events]


@pytest.fixture
def both() -> Iterator[Both]:
    made = Both()
    yield made
    made.feed.close()
    made.pilot.socket.close()


def test_rows_are_those_of_the_receiver_and_not_of_the_estimate(both: Both) -> None:
    both.sail(5.0)
    fixes = np.array([z[[GPS_X, GPS_VX]] for _, z, _ in both.rows if np.isfinite(z[GPS_X])])
    assert len(fixes) == pytest.approx(25, abs=2)
    # 0.009 degrees are a kilometre
    assert np.all(fixes[:, 0] < 20.0)
    assert fixes[:, 1] == pytest.approx(SPEED)


def test_odometry_is_in_the_frame_of_the_autopilot_and_of_the_present(both: Both) -> None:
    both.sail(4.0)
    last = both.pilot.heard["ODOMETRY"][-1]
    assert (last.frame_id, last.child_frame_id, last.quality) == (20, 12, 100)
    assert all(map(math.isfinite, [*last.pose_covariance, *last.velocity_covariance]))
    # where the boat is at the message's own time, less the origin
    t = last.time_usec / 1e6 - 10.0
    assert last.x == pytest.approx(SPEED * t - 3.5, abs=0.3)
    assert last.y == pytest.approx(-1.4, abs=0.1)
    assert t == pytest.approx(both.now, abs=0.15)


def test_a_loss_is_handed_over_and_back(both: Both) -> None:
    both.sail(12.0)
    assert both.navigation.state == "ready"
    both.pilot.fix_type = 1
    both.sail(10.0)
    assert both.navigation.state == "aiding"
    assert both.pilot.sources[-1] == 2.0
    both.pilot.fix_type = 3
    both.sail(6.0)
    assert both.navigation.state == "ready"
    assert both.pilot.sources[-1] == 1.0
    assert both.states == ["ready", "lost", "aiding", "returning", "ready"]


def test_arming_lets_the_twin_begin_again(both: Both) -> None:
    both.pilot.armed = False
    both.sail(8.0)
    begun = both.twin.begun
    both.pilot.armed = True
    both.sail(3.0)
    assert both.twin.begun > begun
    assert both.navigation.state == "waiting"


def test_a_jump_is_counted_and_motion_is_not() -> None:
    counter = JumpCounter()
    state = np.array([0.0, 0.0, 0.5, 4.0, 0.2, 0.0])
    velocity = 4.0 * math.cos(0.5) - 0.2 * math.sin(0.5), 4.0 * math.sin(0.5) + 0.2 * math.cos(0.5)
    for k in range(100):
        state[:2] = 0.05 * k * velocity[0], 0.05 * k * velocity[1]
        assert counter.take(0.05 * k, state) == 0
    state[:2] += 0.6
    assert counter.take(5.0, state) == 1
    for k in range(300):
        state[0] += 10.0
        counter.take(5.1 + k, state)
    assert 0 <= counter.count < 256


def test_a_port_survives_garbage_and_answers_the_autopilot() -> None:
    peer = AutopilotPeer()
    port = MavlinkPort("udp://127.0.0.1:" + str(free_port()), peer)
    pilot = Pilot(port.port)
    try:
        port.send([b"nobody is there"])
        assert port.counts["sent"] == 0
        pilot.socket.sendto(b"\xfd\x09" + bytes(50), pilot.to)
        pilot.send(dialect.MAVLink_heartbeat_message(11, 3, 128, 10, 4, 3))
        pilot.send(dialect.MAVLink_param_value_message(b"SIM_GPS1_ENABLE", 1.0, 9, 1, 0))
        for _ in range(100):
            port.poll()
        assert peer.system == 1 and peer.armed and peer.mode == 10
        assert peer.parameters == {"SIM_GPS1_ENABLE": 1.0}
        assert port.counts["broken"] > 0
        port.send([b"hello"])
        assert port.counts["sent"] == 1
        with pytest.raises(FeedError, match="cannot listen"):
            MavlinkPort(f"udp://127.0.0.1:{port.port}", peer)
    finally:
        port.close()
        pilot.socket.close()
