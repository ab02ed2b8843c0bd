"""The backend of an autopilot: its protocol, and the physics that its sensors are made of."""

import math
import socket
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.usv_gym.sitl.fake_autopilot import FakeAutopilot, parse
from usv_gym.physics import GRAVITY
from usv_gym.physics import frames as fr
from usv_gym.sitl.backend import Backend, BackendError, port_of
from usv_gym.sitl.packets import decode_servos
from usv_gym.sitl.server import Server
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.sea import SeaState
from usv_gym.world.simulation import Simulation
from usv_kernel.scalar import rotation

SEA = SeaState.named("2").replace(current=0.3, current_to=1.0)
CALM = SeaState()


def backend(
    vessel: str = "usv75", sea: SeaState = CALM, *, dof: int = 6, **options: Any
) -> Backend:
    simulation = Simulation(1, Vessel.load(vessel), sea, dof=dof, dt=0.01, dt_physics=0.01)
    return Backend(simulation, **options)


def autopilot(made: Backend, source: Any = "first", **options: Any) -> FakeAutopilot:
    return FakeAutopilot(lambda data: made.answer(data, source), **options)


def run(made: Backend, pilot: FakeAutopilot) -> dict[str, np.ndarray]:
    """Return the motion of half a minute with a turn in it, by name."""
    pilot.wait(1.0)
    pilot.hold(0.0, 10.0)
    pilot.hold(1.5, 20.0)
    return {
        name: np.array([getattr(s, name) for s in pilot.seen]) for name in pilot.seen[0]._fields
    }


@pytest.mark.parametrize("vessel", ["usv75", "otter"])
def test_velocity_is_the_rate_of_the_place(vessel: str) -> None:
    ran = run(made := backend(vessel, SEA), autopilot(made))
    free = slice(np.argmax(np.abs(ran["place"][:, 0]) > 1e-6) + 1, None)
    place, velocity = ran["place"][free], ran["velocity"][free]
    assert len(place) > 1000
    between = 0.5 * (velocity[1:] + velocity[:-1])
    np.testing.assert_allclose(np.diff(place, axis=0) / 0.01, between, atol=2e-3)


@pytest.mark.parametrize("vessel", ["usv75", "otter"])
def test_specific_force_and_gravity_are_the_rate_of_the_velocity(vessel: str) -> None:
    """In the axes of the earth, within a hundredth; also at the mooring and when it is cast off."""
    ran = run(made := backend(vessel, SEA), autopilot(made))
    rate = np.diff(ran["velocity"], axis=0) / 0.01
    down = np.array([0.0, 0.0, GRAVITY])
    for k in range(0, len(rate), 7):
        turned = rotation(ran["attitude"][k + 1]) @ ran["force"][k + 1] + down
        # the axes of the end of the step, and not of its middle
        size = np.linalg.norm(rate[k]) + GRAVITY
        assert np.linalg.norm(turned - rate[k]) < 0.01 * size


def test_gyro_is_the_rate_of_the_attitude() -> None:
    ran = run(made := backend("usv75", SEA), autopilot(made))
    for k in range(1, len(ran["gyro"]), 7):
        roll, pitch = ran["attitude"][k][:2]
        change = ran["attitude"][k] - ran["attitude"][k - 1]
        droll, dpitch, dyaw = (math.remainder(part, math.tau) / 0.01 for part in change)
        expected = (
            droll - dyaw * math.sin(pitch),
            dpitch * math.cos(roll) + dyaw * math.sin(roll) * math.cos(pitch),
            -dpitch * math.sin(roll) + dyaw * math.cos(roll) * math.cos(pitch),
        )
        assert ran["gyro"][k] == pytest.approx(expected, abs=2e-3)


def test_pulses_beyond_the_full_width_command_no_more_than_it() -> None:
    made = backend()
    autopilot(made).step({1: 2500, 3: 2500})
    servos = made.simulation.vessel.servos
    full = [servos.shaft_speed, servos.shaft_speed, servos.angle, servos.angle]
    assert made.simulation.cmd[0] == pytest.approx(full)


def test_the_boat_stays_moored_until_a_motor_is_driven() -> None:
    made = backend("usv75", SeaState.named("3").replace(current=0.5), heading=0.7)
    pilot = autopilot(made)
    pilot.wait(20.0)
    assert {(s.place[0], s.place[1], s.attitude[2]) for s in pilot.seen} == {(0.0, 0.0, 0.7)}
    assert max(abs(s.velocity[0]) + abs(s.velocity[1]) for s in pilot.seen) < 1e-9
    assert max(abs(s.velocity[2]) for s in pilot.seen) > 0.1  # it rides the waves
    assert made.moored
    pilot.hold(0.7, 5.0)
    assert not made.moored
    assert math.hypot(*pilot.seen[-1].place[:2]) > 0.5


def test_a_pulse_before_all_throttles_have_one_does_not_cast_off() -> None:
    """ArduRover begins with 1000 us at output 1, and nothing at the others."""
    made = backend("otter", SEA)
    pilot = autopilot(made)
    pilot.wait(2.0)
    pilot.step({1: 1000, 3: 0})
    pilot.wait(2.0)
    assert made.moored
    pilot.step({1: 1400, 3: 1600})
    assert not made.moored


def test_without_a_mooring_the_boat_drifts_with_the_current() -> None:
    made = backend("otter", CALM.replace(current=0.4), moored=False)
    pilot = autopilot(made)
    pilot.wait(20.0)
    assert pilot.seen[-1].place[0] > 3.0


def test_a_packet_that_comes_again_gets_the_same_answer() -> None:
    made = backend("usv75", SEA)
    pilot = autopilot(made)
    pilot.wait(0.5)
    lost = made.answer(pilot.packet({3: 1700}), "first")  # the answer does not arrive
    again = made.answer(pilot.packet({3: 1700}), "first")
    assert lost == again
    assert made.counts["repeated"] == 1
    pilot.step({3: 1700})
    assert made.counts["repeated"] == 2


def test_a_lost_packet_is_counted_and_time_goes_on_by_one_step() -> None:
    made = backend()
    pilot = autopilot(made)
    pilot.wait(0.2)
    before = made.t
    pilot.count += 3
    pilot.step({})
    assert made.counts["lost"] == 3
    assert made.t == pytest.approx(before + 0.01)


def test_an_autopilot_that_begins_again_gets_the_same_start() -> None:
    made = backend("usv75", SEA)
    ended: list[float] = []
    made.on_restart = lambda one: ended.append(one.t)
    runs = []
    for source in ("first", "second"):
        pilot = autopilot(made, source)
        pilot.wait(0.5)
        pilot.hold(0.3, 5.0)
        runs.append(pilot.seen)
    assert runs[0] == runs[1]
    assert ended == [runs[0][-1].t]
    assert made.counts["restarts"] == 1


def test_a_delayed_packet_is_no_restart() -> None:
    made = backend()
    pilot = autopilot(made)
    pilot.wait(0.5)
    delayed, last = pilot.packet({}), made.t
    pilot.step({})
    pilot.step({})
    assert made.answer(delayed, "first") is None
    assert made.counts["late"] == 1 and made.counts["restarts"] == 0
    pilot.step({})
    assert made.t > last


def test_a_second_autopilot_is_ignored_until_the_first_is_gone() -> None:
    now = [0.0]
    made = backend(clock=lambda: now[0])
    pilot = autopilot(made)
    pilot.wait(0.2)
    second = autopilot(made, "second")
    second.count = 5000
    assert made.answer(second.packet({}), "second") is None
    assert made.counts["foreign"] == 1
    now[0] = 10.0
    assert made.answer(second.packet({}), "second") is not None


def test_the_step_of_time_is_that_of_the_simulation() -> None:
    made = backend()
    for k, rate in enumerate((1200, 50, 0, 65535)):
        pilot = autopilot(made)
        pilot.count = k
        reply = made.answer(pilot.packet({}, rate), "first")
        assert reply is not None and parse(reply).t == pytest.approx(0.01 * (k + 1))


def test_32_outputs_are_read() -> None:
    made = backend()
    pilot = autopilot(made, wide=True)
    pilot.step({1: 1900, 3: 1500, 32: 1234})
    assert made.widths[31] == 1234
    assert made.simulation.cmd[0, 2] == pytest.approx(math.radians(30.0))


@given(data=st.binary(max_size=100))
@settings(max_examples=200)
def test_garbage_is_counted_and_changes_nothing(data: bytes) -> None:
    made = SHARED
    if decode_servos(data) is None:
        counts, t = dict(made.counts), made.t
        assert made.answer(data, "first") is None
        assert made.counts["garbage"] == counts["garbage"] + 1
        assert made.t == t


SHARED = backend()


def test_instances_have_ports_of_their_own() -> None:
    assert [port_of(n) for n in (0, 1, 5)] == [9002, 9012, 9052]
    with pytest.raises(BackendError, match="instance = -1"):
        port_of(-1)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Backend(Simulation(2, "usv75", CALM, dt=0.01, dt_physics=0.01)), "2 boats"),
        (lambda: Backend(Simulation(1, "usv75", CALM, dt=0.1)), "below 0.1"),
        (lambda: Backend(Simulation(1, "usv75", CALM, dt=0.05), seed=-1), "seed = -1"),
        (lambda: Server(backend(), "no host", 1), "not known"),
    ],
)
def test_what_a_backend_cannot_do_is_reported(make: Callable[[], object], words: str) -> None:
    with pytest.raises(BackendError, match=words):
        make()


def test_over_a_socket_garbage_is_survived_and_no_frame_is_lost() -> None:
    made = backend()
    with Server(made, port=0) as server, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.settimeout(30.0)
        done = threading.Event()

        def serve() -> None:
            while not done.is_set():
                server.poll(0.01)

        thread = threading.Thread(target=serve)
        thread.start()

        def ask(data: bytes) -> bytes:
            wire.sendto(b"garbage", ("127.0.0.1", server.port))
            wire.sendto(data, ("127.0.0.1", server.port))
            return wire.recv(1 << 16)

        try:
            pilot = FakeAutopilot(ask)
            pilot.wait(0.5)
            pilot.hold(0.2, 2.0)
        finally:
            done.set()
            thread.join()
        with pytest.raises(BackendError, match=f"port {server.port}"):
            Server(made, port=server.port)
    assert made.counts["steps"] == len(pilot.seen)
    assert made.counts["garbage"] == len(pilot.seen)
    assert made.counts["lost"] == made.counts["repeated"] == 0
    assert made.simulation.state[0, fr.U] > 0.1
