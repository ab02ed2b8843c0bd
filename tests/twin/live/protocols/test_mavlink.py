import math
from typing import Any

import numpy as np
import pytest

from tests.twin.live.wire import Wire, example
from twin.channels import (
    ACCEL_Z,
    AHRS_PITCH,
    AHRS_ROLL,
    GPS_VZ,
    GPS_Z,
    GYRO_X,
    GYRO_Y,
)
from twin.live.protocols.mavlink import MavlinkFeed, MavlinkWriter, Servos
from twin.motion import MotionEstimate
from twin.particulars import Particulars
from twin.predictors.base import Estimate
from usv_kernel.channels import ACCEL_X, ACCEL_Y, GYRO

common = pytest.importorskip(
    "pymavlink.dialects.v20.common", reason="needs pymavlink: pip install 'usv-twin[view]'"
)

BOAT = Particulars(name="b", length=6.0, beam=2.0, draft=0.5, mass=2e3, speed=5.0, shaft_speed=20.0)


@pytest.fixture
def wire() -> Wire:
    return Wire(MavlinkFeed, BOAT)


def sender(system: int = 1) -> Any:
    """Return what writes the messages of an autopilot."""
    return example.MavlinkRows(Servos.of(BOAT), system)


def other(message: Any, system: int = 1) -> bytes:
    return bytes(message.pack(common.MAVLink(None, srcSystem=system, srcComponent=1)))


def turned(q: Any) -> np.ndarray:
    """Return the rotation of a quaternion w, x, y, z, from the boat to north, east, down."""
    w, v = q[0], np.array(q[1:])
    across = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.eye(3) + 2.0 * w * across + 2.0 * across @ across


def servos(micros: int, *widths: int) -> bytes:
    full = [*widths, *[0] * (16 - len(widths))]
    return other(common.MAVLink_servo_output_raw_message(micros, 0, *full))


def test_messages_of_a_moment_are_a_row(wire: Wire) -> None:
    write = sender()
    wire.tell(write.position(7.0, (59.5, 10.5), (1.0, -2.0)), write.attitude(7.0, -0.5, 0.1))
    wire.tell(servos(7_010_000, 1300, 0, 1700))
    wire.take(after=1.0)
    ((t, z, cmd),) = wire.rows
    assert t == 0.0 and (wire.feed.plane.latitude, wire.feed.plane.longitude) == (59.5, 10.5)
    expected = [0.0, 0.0, 1.0, -2.0, 2 * math.pi - 0.5, 0.1]
    assert z[:6] == pytest.approx(expected, abs=1e-6) and np.isnan(z[6:]).all()
    # half throttle of twice 20 rev/s, half of 30 degrees to port
    assert cmd == pytest.approx([20.0, 20.0, -math.radians(15.0), -math.radians(15.0)])


@pytest.mark.parametrize("steering", ["drives", "differential"])
def test_servos_there_and_back_give_the_same_commands(steering: str) -> None:
    boat = Particulars(
        **{**vars(BOAT), "steering": steering},
    )
    outputs = Servos.of(boat, shaft_speed=40.0, angle=0.5)
    cmd = np.array([10.0, 10.0, -0.25, -0.25])
    if steering == "differential":
        cmd = np.array([10.0, -20.0, 0.0, 0.0])
    widths = outputs.widths(cmd)
    back = outputs.commands(widths)
    assert [back.get(name, 0.0) for name in Names] == pytest.approx(cmd.tolist(), abs=0.05)
    assert widths[2] == (1600 if steering == "drives" else 1300)
    assert widths[0] == (1300 if steering == "drives" else 1600)


Names = ("n_left_rps", "n_right_rps", "delta_left_rad", "delta_right_rad")


def test_servo_times_of_32_bits_and_of_other_clocks_are_understood(wire: Wire) -> None:
    boot = 5000.0  # beyond 2**32 us
    write = sender()
    for i in range(20):
        wire.tell(write.attitude(boot + 0.1 * i, 1.0, 0.0), after=0.1)
        micros = round(1e6 * (boot + 0.1 * i)) % 2**32 if i < 10 else 1234567
        wire.tell(servos(micros, 1500, 0, 1500 + i))
    wire.take(after=1.0)
    t, _, cmd = wire.arrays()
    assert len(t) == 20 and t == pytest.approx(0.1 * np.arange(20), abs=0.02)
    assert cmd[:, 0] == pytest.approx(40.0 * np.arange(20) / 400.0)


def test_no_fix_is_no_position(wire: Wire) -> None:
    write = sender()
    receiver = common.MAVLink_gps_raw_int_message
    rest = (0, 0, 0, 65535, 65535, 65535, 65535, 255)
    wire.tell(write.position(1.0, (59.5, 10.5), (0.0, 0.0)))
    wire.tell(other(receiver(0, 1, *rest)), write.position(2.0, (59.5, 10.5), (0.0, 0.0)))
    wire.tell(other(receiver(0, 3, *rest)), write.position(3.0, (59.5, 10.5), (0.0, 0.0)))
    wire.take(after=1.0)
    assert [t for t, _, _ in wire.rows] == [0.0, 2.0]
    assert wire.balance()["void"] == 2


def test_one_system_is_followed(wire: Wire) -> None:
    wire.tell(sender(7).attitude(1.0, 1.0, 0.0))
    wire.tell(sender(8).attitude(500.0, 2.0, 0.0))
    assert wire.feed.system == 7  # type: ignore[attr-defined]
    assert wire.balance() == {"received": 2, "used": 1, "unknown": 1}


def test_a_gimbal_s_attitude_is_not_the_boat_s(wire: Wire) -> None:
    gimbal, autopilot = sender(), sender()
    gimbal.link.srcComponent = 154
    wire.tell(gimbal.attitude(900.0, 2.0, 0.0))  # comes first, and has a clock of its own
    for k in range(40):
        t = 5.0 + 0.1 * k
        wire.tell(autopilot.position(t, (59.5, 10.5), (1.0, 0.0)), autopilot.attitude(t, 0.1, 0.0))
        wire.tell(gimbal.attitude(900.0 + t, 2.0, 0.0))
        wire.take(after=0.1)
    wire.take(after=1.0)
    headings = [z[4] for _, z, _ in wire.rows if np.isfinite(z[4])]
    assert len(headings) >= 39
    assert headings[2:] == pytest.approx([0.1] * (len(headings) - 2), abs=1e-6)
    assert sum(np.isfinite(z[0]) for _, z, _ in wire.rows) >= 30


def test_broken_messages_do_not_spoil_their_neighbours(wire: Wire) -> None:
    write = sender()
    sound = [write.attitude(1.0 + 0.1 * i, 1.0, 0.0) for i in range(5)]
    wrong = bytearray(sound[1])
    wrong[14] ^= 1
    far = write.position(1.05, (59.5, 10.5), None).replace(
        (595000000).to_bytes(4, "little"), (2000000000).to_bytes(4, "little")
    )
    wire.tell(sound[0] + bytes(wrong), sound[2][:20], sound[3], far, b"\x00noise", sound[4])
    counts = wire.balance()
    assert counts["used"] == 3 and counts["broken"] == 4


def test_roll_pitch_and_climb_are_read(wire: Wire) -> None:
    write = sender()
    wire.tell(
        write.position(7.0, (59.5, 10.5), (1.0, -2.0), down=(-3.5, 0.25)),
        write.attitude(7.0, -0.5, 0.1, (0.2, -0.1), (0.03, -0.04)),
        highres(0b111, 0.5, -0.25, -9.75, 0.0, 0.0, 0.0),
    )
    z = wire.take(after=1.0)[0][1]
    assert z[[ACCEL_X, ACCEL_Y, ACCEL_Z]] == pytest.approx([0.5, -0.25, -9.75])
    assert z[[GYRO_X, GYRO_Y]] == pytest.approx([0.03, -0.04])
    assert z[[AHRS_ROLL, AHRS_PITCH]] == pytest.approx([0.2, -0.1])
    assert z[[GPS_Z, GPS_VZ]] == pytest.approx([-3.5, 0.25])


def highres(flags: int, *parts: float) -> bytes:
    still = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    return other(common.MAVLink_highres_imu_message(7_000_000, *parts, *still, flags))


IMU = [ACCEL_X, ACCEL_Y, ACCEL_Z, GYRO_X, GYRO_Y, GYRO]
PARTS = 0.5, -0.25, -9.75, 0.03, -0.04, 0.1


@pytest.mark.parametrize("kind", ["RAW_IMU", "SCALED_IMU"])
def test_milli_g_and_mrad_of_an_imu_are_read(wire: Wire, kind: str) -> None:
    numbers = (100, -200, -1000, 30, -40, 100, 0, 0, 0)
    if kind == "RAW_IMU":
        made = common.MAVLink_raw_imu_message(7_000_000, *numbers)
    else:
        made = common.MAVLink_scaled_imu_message(7000, *numbers)
    wire.tell(sender().position(7.0, (59.5, 10.5), None), other(made))
    z = wire.take(after=1.0)[0][1]
    assert z[IMU] == pytest.approx([0.981, -1.962, -9.81, 0.03, -0.04, 0.1])


@pytest.mark.parametrize("flags", [0, 0b111111, 0b000011, 0b101101, 0b111000])
def test_parts_of_an_imu_that_are_not_flagged_are_not_taken(wire: Wire, flags: int) -> None:
    wire.tell(sender().position(7.0, (59.5, 10.5), None), highres(flags, *PARTS))
    z = wire.take(after=1.0)[0][1]
    flagged = [value if flags & 1 << bit else np.nan for bit, value in enumerate(PARTS)]
    assert z[IMU] == pytest.approx(flagged, nan_ok=True)


def test_rates_of_the_attitude_go_before_gyros_until_they_stop(wire: Wire) -> None:
    write = sender()
    for k in range(60):
        t = 7.0 + 0.1 * k
        made = common.MAVLink_raw_imu_message(
            round(1e6 * t) + 9000, 0, 0, -1000, 50, 60, 70, 0, 0, 0
        )
        if k < 20:  # without a rate of pitch
            wire.tell(write.attitude(t, 0.0, 0.2, (0.0, 0.0), (0.1, math.nan)))
        else:
            wire.tell(write.position(t, (59.5, 10.5), None))
        wire.tell(other(made), after=0.1)
    wire.take(after=1.0)
    t, z, _ = wire.arrays()
    early, late = t < 3.5, t > 4.5
    assert z[early, GYRO][np.isfinite(z[early, GYRO])] == pytest.approx([0.2] * 20)
    assert np.nanmin(z[late, GYRO]) == np.nanmax(z[late, GYRO]) == pytest.approx(0.07)
    assert np.nanmax(z[:, GYRO_Y]) == np.nanmin(z[:, GYRO_Y]) == pytest.approx(0.06)


def test_odometry_of_a_heeled_boat_is_turned_back_by_its_quaternion() -> None:
    """As AP_VisualOdom_MAV does: what it turns to north, east and down is that of the estimate."""
    now = MotionEstimate(0.0, 0.1, -0.05, 0.01, -0.02, 0.2, 0.25, 0.3, np.full(4, 0.01))
    s, none = np.array([100.0, -50.0, 0.3, 5.0, 0.5, 0.1]), np.zeros(0)
    estimate = Estimate(0.0, s, np.full(6, 0.5), none, none, True, motion=now)
    (odometry,) = common.MAVLink(None).parse_buffer(MavlinkWriter().odometry(7.0, estimate))
    turn = turned(odometry.q)
    assert np.arctan2(turn[2, 1], turn[2, 2]) == pytest.approx(0.1)
    assert -np.arcsin(turn[2, 0]) == pytest.approx(-0.05)
    assert np.arctan2(turn[1, 0], turn[0, 0]) == pytest.approx(0.3)
    psi, (u, v) = estimate.state[2], estimate.state[3:5]
    north, east = u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)
    ahead = turn @ [odometry.vx, odometry.vy, odometry.vz]
    assert ahead == pytest.approx([north, east, 0.25], abs=1e-6)
    assert odometry.z == pytest.approx(0.2)
    # the heading turns by 0.1 rad/s
    assert (odometry.rollspeed, odometry.pitchspeed) == pytest.approx((0.01, -0.02))
    q, r = odometry.pitchspeed, odometry.yawspeed
    assert (q * np.sin(0.1) + r * np.cos(0.1)) / np.cos(-0.05) == pytest.approx(0.1)
    spread = odometry.pose_covariance
    assert [spread[k] for k in (11, 15, 18)] == pytest.approx([1e-4] * 3)
