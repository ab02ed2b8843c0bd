"""External navigation against an EKF with ArduPilot's rules: a minute without GPS, and back."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from tests.usv_gym.sitl.fake_autopilot import FakeAutopilot, Seen
from twin.digital_twin import Twin
from twin.live.external.navigation import STATES, ExternalNavigation
from twin.live.external.peer import AutopilotPeer
from twin.live.external.simulated import AutopilotRun, suite_of
from twin.logs.datum import Datum, Plane
from twin.sim.bridge import particulars_of
from usv_gym.sitl.backend import Backend
from usv_gym.sitl.parameters import autopilot_parameters
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.faults import Fault
from usv_gym.world.sea import SeaState
from usv_gym.world.simulation import Simulation
from usv_kernel.scalar import rotation

HOME = Datum(latitude=59.9, longitude=10.7)
AUTO, HOLD, MANUAL = 10, 4, 0
ORIGIN = np.array([3.5, 1.4])
"""Of the local frame, m north and east of home."""

FAILSAFE, HEALTHY, GATE = 8.0, 0.5, 5.0
"""Time without aiding until the failsafe (s), age of a healthy ODOMETRY (s), and the innovation
in standard deviations that is refused."""

LOCAL_FRD, BODY_FRD = 20, 12


def diagonal(triangle: list[float]) -> list[float]:
    """Return the variances in the upper triangle of a covariance (6, 6)."""
    return [triangle[k] for k in (0, 6, 11, 15, 18, 20)]


class LoopPort:
    """The port of a twin, without sockets: what it sends is heard at once."""

    def __init__(self, peer: AutopilotPeer, autopilot: FakeEkf) -> None:
        self.peer, self.autopilot = peer, autopilot
        self.counts: dict[str, int] = {}
        self._parser = dialect.MAVLink(None)

    def poll(self) -> None:
        for item in self.autopilot.spoken():
            self.peer.hear(item)

    def send(self, datagrams: Iterable[bytes]) -> None:
        for data in datagrams:
            for item in self._parser.parse_buffer(data) or ():
                self.autopilot.hear(item)

    def close(self) -> None:
        """Nothing is open."""


class FakeEkf:
    """Autopilot 1 of a backend, with an EKF that takes external navigation, in lock-step.

    It sails ``points`` (K, 2), m north and east, by its own estimate of the place, not by the
    truth. What it publishes as GLOBAL_POSITION_INT is that estimate, and its local origin is not
    its home.
    """

    def __init__(self, backend: Backend, points: np.ndarray, seed: int, *, external: bool) -> None:
        self.pilot = FakeAutopilot(lambda data: backend.answer(data, "fake"))
        self.points, self.external = points, external
        self.rng = np.random.default_rng(seed)
        self.servos = backend.simulation.vessel.servos
        self.tuned = autopilot_parameters(backend.simulation.vessel)
        plane = HOME.plane
        assert plane is not None
        self.plane: Plane = plane
        self.link = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self._parser = dialect.MAVLink(None)
        self._outbox: list[Any] = []
        self.mode, self.armed, self.leg = MANUAL, False, 0
        self.source, self.gps_on = 1, True
        self.place, self.velocity = np.zeros(2), np.zeros(2)
        self.aided = self.odometry_at = -math.inf
        self.resets: int | None = None
        self.refused = self.jumped = 0
        self.due_gps = self.due_beat = 0.0
        self.modes: list[tuple[float, int]] = []
        self.errors: list[tuple[float, float]] = []
        self.refuse_source = False

    def hear(self, item: Any) -> None:
        """Take a message of the twin."""
        kind = item.get_type()
        if kind == "ODOMETRY":
            self._take_odometry(item)
        elif kind == "COMMAND_LONG":
            self._obey(item)
        elif kind == "PARAM_SET":
            assert item.param_id == "SIM_GPS1_ENABLE"
            self.gps_on = item.param_value == 1.0
            self.say(
                dialect.MAVLink_param_value_message(b"SIM_GPS1_ENABLE", item.param_value, 9, 1, 0)
            )

    def _obey(self, item: Any) -> None:
        result = 0
        if item.command == 42007:
            result = 4 if self.refuse_source else 0
            if result == 0:
                self.source = int(item.param1)
        elif item.command == 512:
            lat, lon = self.plane.degrees(*ORIGIN)
            self.say(
                dialect.MAVLink_gps_global_origin_message(
                    round(1e7 * float(lat)), round(1e7 * float(lon)), 0
                )
            )
        self.say(dialect.MAVLink_command_ack_message(item.command, result))

    def _take_odometry(self, item: Any) -> None:
        """Take an estimate as AP_VisualOdom_MAV and EKF3 do."""
        if (item.frame_id, item.child_frame_id) != (LOCAL_FRD, BODY_FRD):
            return
        pose, speed = diagonal(item.pose_covariance), diagonal(item.velocity_covariance)
        numbers = [item.x, item.y, item.z, *item.q, item.vx, item.vy, *pose, *speed]
        assert all(map(math.isfinite, numbers)), "Internal errors 0x400 l:34 cnstring_nan"
        if item.quality < 0:
            return
        self.odometry_at = self.pilot.last
        error = min(max((pose[0] ** 2 + pose[1] ** 2 + pose[2] ** 2) ** (1.0 / 3.0), 0.2), 100.0)
        jumped = self.resets is not None and item.reset_counter != self.resets
        self.resets = item.reset_counter
        self.jumped += jumped
        if self.source != 2:
            return
        yaw = 2.0 * math.atan2(item.q[3], item.q[0])
        c, s = math.cos(yaw), math.sin(yaw)
        velocity = np.array([c * item.vx - s * item.vy, s * item.vx + c * item.vy])
        self._correct(np.array([item.x, item.y]) + ORIGIN, velocity, error, jumped)

    def _correct(self, place: np.ndarray, velocity: np.ndarray, sd: float, jumped: bool) -> None:
        """Correct the estimate, or refuse a place that is far from it."""
        innovation = place - self.place
        if jumped or self.aided == -math.inf:
            self.place, self.velocity = place.copy(), velocity.copy()
        elif np.hypot(*innovation) > GATE * max(math.hypot(sd, 0.5), 0.5):
            self.refused += 1
            return
        else:
            self.place = self.place + 0.2 * innovation
            self.velocity = self.velocity + 0.3 * (velocity - self.velocity)
        self.aided = self.pilot.last

    def say(self, message: Any) -> None:
        self._outbox.append(message)

    def spoken(self) -> list[Any]:
        """Return what was said since the last time, as it comes over a wire."""
        out, self._outbox = self._outbox, []
        return [item for m in out for item in self._parser.parse_buffer(m.pack(self.link)) or ()]

    def _enter(self, mode: int) -> None:
        if mode != self.mode:
            self.mode = mode
            self.modes.append((self.pilot.last, mode))

    def step(self, t_arm: float = 25.0) -> None:
        """Advance by one packet."""
        widths = self._widths()
        before = self.pilot.last
        seen = self.pilot.step(widths)
        t, dt = seen.t, seen.t - before
        force = rotation(seen.attitude) @ seen.force
        if self.aided > -math.inf:
            self.velocity = self.velocity + dt * force[:2]
            self.place = self.place + dt * self.velocity
        if t >= self.due_gps:
            self.due_gps = t + 0.2
            self._receive(seen)
        if t >= self.due_beat:
            self.due_beat = t + 1.0
            base = 128 if self.armed else 0
            self.say(dialect.MAVLink_heartbeat_message(11, 3, base, self.mode, 4, 3))
        healthy = not self.external or t - self.odometry_at < HEALTHY
        if not self.armed and t > t_arm and healthy and self.aided > -math.inf:
            self.armed = True
            self._enter(AUTO)
        if self.armed and t - self.aided > FAILSAFE and self.mode == AUTO:
            self._enter(HOLD)
            self.say(dialect.MAVLink_statustext_message(2, b"EKF failsafe"))
        self.errors.append((t, math.dist(self.place, seen.place[:2])))

    def _receive(self, seen: Seen) -> None:
        """Take a fix, and publish the estimate as if it were one."""
        if self.gps_on and self.source == 1 and self.pilot.last > 5.0:
            noise = 0.1 * self.rng.standard_normal(4)
            place, velocity = np.array(seen.place[:2]), np.array(seen.velocity[:2])
            self._correct(place + noise[:2], velocity + 0.5 * noise[2:], 100.0, False)
        lat, lon = self.plane.degrees(*self.place)
        self.say(
            dialect.MAVLink_global_position_int_message(
                round(1e3 * seen.t),
                round(1e7 * float(lat)),
                round(1e7 * float(lon)),
                0,
                0,
                0,
                0,
                0,
                0,
            )
        )

    def _widths(self) -> dict[int, int]:
        """Return the pulses of the present mode."""
        if self.mode != AUTO or not self.pilot.seen:
            return {}
        seen, p = self.pilot.seen[-1], self.tuned
        goal, start = self.points[self.leg], self.points[max(self.leg - 1, 0)]
        if math.dist(goal, self.place) < p["WP_RADIUS"] and self.leg + 1 < len(self.points):
            self.leg += 1
        course = math.atan2(*(goal - start)[::-1]) if self.leg else math.atan2(*goal[::-1])
        c, s = math.cos(course), math.sin(course)
        off = c * (self.place - goal)[1] - s * (self.place - goal)[0]
        wanted = course - math.atan(off / (3.0 * p["WP_RADIUS"]))
        error = math.remainder(wanted - seen.attitude[2], math.tau)
        limit = math.radians(p["ATC_STR_RAT_MAX"])
        rate = min(max(p["ATC_STR_ANG_P"] * error, -limit), limit)
        helm = p["ATC_STR_RAT_FF"] * rate + p["ATC_STR_RAT_P"] * (rate - seen.gyro[2])
        helm, throttle = min(max(helm, -1.0), 1.0), p["CRUISE_THROTTLE"] / 100.0
        if self.servos.steering:
            return {1: round(1500 + 400 * helm), 3: round(1500 + 400 * throttle)}
        sides = [min(max(throttle + sign * helm, -1.0), 1.0) for sign in (1.0, -1.0)]
        return {1: round(1500 + 400 * sides[0]), 3: round(1500 + 400 * sides[1])}


SEA = SeaState(hs=0.5, wind=6.0, current=0.2, current_to=math.radians(60.0))
LOST, BACK = 120.0, 180.0
END = 186.0
LANES = [[10.0, 0.0], [120.0, 0.0], [120.0, 50.0], [10.0, 50.0], [10.0, 100.0], [120.0, 100.0]]
POINTS = np.array(LANES)


class Sailed(NamedTuple):
    ekf: FakeEkf
    run: AutopilotRun
    events: list[tuple[float, str]]
    stated: list[tuple[float, ...]]  # time, place and standard deviations of the twin

    def error(self, t: float) -> float:
        """Return how far the autopilot's own estimate is off at a time, m."""
        times = [at for at, _ in self.ekf.errors]
        return self.ekf.errors[int(np.searchsorted(times, t))][1]

    def states(self, after: float = 0.0) -> list[str]:
        names = [text.partition(":")[0] for t, text in self.events if t > after]
        return [name for name in names if name in STATES]


def sail(
    seed: int = 1, *, twin: bool = True, end: float = END, lost: float = LOST, **options: Any
) -> Sailed:
    boat, suite = Vessel.load("usv75"), suite_of("typical")
    faults = (Fault("gps", lost, BACK - LOST),)
    simulation = Simulation(
        1, boat, SEA, suite=suite, faults=faults, dof=6, dt=0.025, dt_physics=0.0125
    )
    backend = Backend(simulation, seed)
    events: list[tuple[float, str]] = []
    refuse = options.pop("refuse", False)
    ekf = FakeEkf(backend, POINTS, seed, external=twin)
    ekf.refuse_source = refuse
    navigation = None
    if twin:
        navigation = ExternalNavigation(lambda t, text: events.append((t, text)), **options)
    port = LoopPort(navigation.peer if navigation else AutopilotPeer(), ekf)
    run = AutopilotRun(
        backend,
        HOME,
        twin=Twin(particulars_of(boat, suite, 6)) if twin else None,
        navigation=navigation,
        port=port,  # type: ignore[arg-type]
    )
    stated: list[tuple[float, ...]] = []
    while ekf.pilot.last < end:
        ekf.step()
        if run.twin is not None and (now := run.twin.estimate()).ready:
            stated.append((now.t, *now.state[:2].tolist(), *now.sd[:2].tolist()))
    return Sailed(ekf, run, events, stated)


@pytest.fixture(scope="module")
def sailed() -> list[Sailed]:
    return [sail(seed) for seed in range(1, 4)]


def test_the_mission_goes_on_for_a_minute_without_gps(sailed: list[Sailed]) -> None:
    for one in sailed:
        assert [mode for _, mode in one.ekf.modes] == [AUTO]
        assert one.states() == ["ready", "lost", "aiding", "returning", "ready"]


def test_the_estimate_of_the_autopilot_stays_near_the_truth(sailed: list[Sailed]) -> None:
    errors = [one.error(BACK - 0.1) for one in sailed]
    assert np.median(errors) < 4.0
    assert max(errors) < 8.0


def test_the_estimate_is_right_three_seconds_after_the_gps_is_back(sailed: list[Sailed]) -> None:
    assert max(one.error(BACK + 3.0) for one in sailed) < 3.0


def test_the_stated_sd_holds_the_error(sailed: list[Sailed]) -> None:
    """The twin must not claim more than it knows: within three of its standard deviations."""
    for one in sailed:
        t, x, y, sd_x, sd_y = next(row for row in reversed(one.stated) if row[0] < BACK)
        truth = one.run.log.slice(t - 0.01).truth
        assert truth is not None
        assert abs(x - truth[0, 0]) < 3.0 * sd_x
        assert abs(y - truth[0, 1]) < 3.0 * sd_y


def test_without_a_twin_the_failsafe_holds_the_boat() -> None:
    one = sail(twin=False, lost=45.0, end=45.0 + 40.0)
    assert [mode for _, mode in one.ekf.modes] == [AUTO, HOLD]
    assert one.ekf.modes[1][0] == pytest.approx(45.0 + 8.0, abs=0.5)
    assert math.hypot(*one.ekf.pilot.seen[-1].velocity[:2]) < 1.5  # it drifts


def test_a_twin_that_has_seen_too_little_does_not_take_over() -> None:
    early = sail(end=60.0, lost=45.0)
    assert early.states() == ["lost"]
    assert "of 30 s under way" in early.events[-2][1]
    assert "fell to Hold" in early.events[-1][1]
    assert early.ekf.source == 1


def test_a_twin_that_no_longer_knows_gives_up() -> None:
    one = sail(lost=70.0, end=70.0 + 45.0, max_sd_m=2.0)
    assert one.states() == ["ready", "lost", "aiding", "gave up"]
    assert one.ekf.source == 1
    assert one.ekf.modes[-1][1] == HOLD


def test_a_source_that_is_refused_is_asked_for_again_and_said() -> None:
    one = sail(lost=70.0, end=70.0 + 4.0, refuse=True)
    refused = [text for _, text in one.events if "refused source set 2" in text]
    assert 4 <= len(refused) <= 7
    assert one.run.navigation is not None and one.run.navigation.state == "lost"
