"""Runs as MCAP files: read back by two other readers, and by our own."""

from __future__ import annotations

import dataclasses
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from tests.twin.logs.foreign import COLUMN, run
from twin import Twin
from twin.cli.main import app
from twin.logs.bag_writer import Forecast, write_bag
from twin.logs.datum import Datum
from twin.logs.log import Log
from twin.logs.tables import ExportError, StateTable
from twin.sim.bridge import particulars_of
from twin.tilt import body_rates
from usv_gym import Vessel

pytest.importorskip("rosbags")

DATUM = Datum(latitude=59.9, longitude=10.7, epoch=1_764_115_200.25)
START = 1_764_115_200_250_000_000
"""The same in ns: a double cannot hold it."""

BOAT = particulars_of(Vessel.load("usv75"))
RUN = dataclasses.replace(run(100, truth=True), datum=DATUM)
STATE = np.array([10.0, 20.0, 0.5, 3.0, 0.4, 0.1])
"""North, east, heading, forward, to starboard, yaw rate."""


def states(rows: int = 5) -> StateTable:
    names = ("x_m", "y_m", "psi_rad", "u_mps", "v_mps", "r_radps")
    columns = {name: np.full(rows, value) for name, value in zip(names, STATE, strict=True)}
    columns |= {f"sd_{name}": np.full(rows, 0.1 * (k + 1)) for k, name in enumerate(names)}
    columns["x_m"][0] = math.nan  # not ready yet
    return StateTable.of({"t_s": RUN.t[:rows], **columns}, DATUM)


def forecast() -> Forecast:
    t = RUN.t[-1] + np.array([1.0, 2.0, 3.0])
    cov = np.diag([4.0, 9.0, 0.01, 0.2, 0.3, 0.02])
    cov[0, 1] = cov[1, 0] = 1.5
    cov[1, 2] = cov[2, 1] = 0.1
    return Forecast(float(RUN.t[-1]), t, np.tile(STATE, (3, 1)), np.tile(cov, (3, 1, 1)))


MOTION = {"heave_m": 0.3, "roll_rad": 0.2, "pitch_rad": -0.1, "vertical_speed_mps": 0.7}
MOTION |= {"p_radps": 0.05, "q_radps": -0.04, "sd_heave_m": 0.1, "sd_roll_rad": 0.2}
MOTION |= {"sd_pitch_rad": 0.3}


def heeled(rows: int = 5) -> StateTable:
    """Return estimates of a boat that rolls, pitches and heaves; the third row without that."""
    table = states(rows)
    columns = {name: table[name] for name in table.dtype.names}
    columns = {name: v for name, v in columns.items() if v.dtype == np.float64}
    columns |= {name: np.full(rows, value) for name, value in MOTION.items()}
    columns["roll_rad"][2] = math.nan
    return StateTable.of(columns, DATUM)


def check_heeled(odometry) -> None:
    """Check a message against the boat of ``heeled``, by rotations of SciPy."""
    pose, twist = odometry.pose.pose, odometry.twist.twist
    q = pose.orientation
    turn = Rotation.from_quat([q.x, q.y, q.z, q.w])
    yaw, pitch, roll = turn.as_euler("ZYX")
    assert (roll, -pitch) == pytest.approx((0.2, -0.1), abs=1e-6)
    assert math.remainder(0.5 * math.pi - yaw - STATE[2], 2.0 * math.pi) == pytest.approx(
        0.0, abs=1e-6
    )
    assert pose.position.z == pytest.approx(-0.3, abs=1e-6)
    c, s = math.cos(STATE[2]), math.sin(STATE[2])
    over_ground = [3.0 * s + 0.4 * c, 3.0 * c - 0.4 * s, -0.7]  # east, north, up
    linear, angular = twist.linear, twist.angular
    assert turn.apply([linear.x, linear.y, linear.z]) == pytest.approx(over_ground, abs=1e-6)
    # after a short time the heading has turned by its rate, to the right
    after = turn * Rotation.from_rotvec(1e-6 * np.array([angular.x, angular.y, angular.z]))
    assert (yaw - after.as_euler("ZYX")[0]) / 1e-6 == pytest.approx(0.1, abs=1e-4)
    spread = np.reshape(odometry.pose.covariance, (6, 6))
    assert np.diag(spread)[2:5] == pytest.approx([0.01, 0.04, 0.09])


def messages(path: Path) -> dict[str, list]:
    """Return the messages of each topic, read by rosbags with the definitions in the file."""
    from rosbags.highlevel import AnyReader

    found: dict[str, list] = {}
    with AnyReader([path]) as reader:
        for link, stamp, raw in reader.messages():
            found.setdefault(link.topic, []).append((stamp, reader.deserialize(raw, link.msgtype)))
    return found


def test_a_log_reads_back(tmp_path):
    path = tmp_path / "a.mcap"
    RUN.write(path)
    log = Log.read(path)
    assert np.allclose(log.t, RUN.t, atol=1e-9) and log.datum.epoch == DATUM.epoch
    assert np.allclose(log.cmd[1:], RUN.cmd[1:], atol=1e-12)
    for name, j in COLUMN.items():
        assert np.allclose(log.z[:, j], RUN.z[:, j], atol=1e-12), name


def test_whole_turns_of_the_heading_are_lost_and_twins_do_not_mind(tmp_path):
    path = tmp_path / "a.mcap"
    turns, j = np.repeat([-1.0, 0.0, 2.0], -(-len(RUN) // 3))[: len(RUN)], COLUMN["compass_rad"]
    z = RUN.z.copy()
    z[:, j] += 2.0 * np.pi * turns
    log = dataclasses.replace(RUN, z=z)
    log.write(path)
    back = Log.read(path)
    apart = (log.z[:, j] - back.z[:, j]) / (2.0 * np.pi)
    assert np.allclose(apart, np.round(apart), atol=1e-9) and np.abs(apart).max() >= 1.0
    assert (back.z[:, j] >= 0.0).all() and (back.z[:, j] <= 2.0 * np.pi).all()
    for name in ("persistence", "ukf"):
        found = [Twin(BOAT, name).run(one) for one in (log, back)]
        for column in ("x_m", "y_m", "u_mps", "r_radps"):
            assert np.allclose(found[0][column], found[1][column], atol=1e-9, equal_nan=True)


def test_a_log_without_a_date_reads_back(tmp_path):
    path = tmp_path / "a.mcap"
    dataclasses.replace(RUN, datum=None).write(path)
    assert np.allclose(Log.read(path).t, RUN.t, atol=1e-9)


def test_missing_samples_stay_missing(tmp_path):
    z = RUN.z.copy()
    z[10:30, :4] = np.nan
    z[40:60, 4:8] = np.nan
    z[20:50, COLUMN["compass_rad"]] = np.nan
    z[70:80, COLUMN["ahrs_roll_rad"]] = np.nan
    path = tmp_path / "a.mcap"
    dataclasses.replace(RUN, z=z).write(path)
    log = Log.read(path)
    assert (np.isnan(log.z) == np.isnan(z)).all()


def test_fixes_are_on_earth_and_the_truth_is_in_ros_axes(tmp_path):
    path = tmp_path / "a.mcap"
    RUN.write(path)
    found = messages(path)
    place = DATUM.plane.degrees(RUN.z[0, 0], RUN.z[0, 1])
    fix = found["/gps/fix"][0][1]
    assert (fix.latitude, fix.longitude) == pytest.approx(place, abs=1e-12)
    stamp, truth = found["/truth/odometry"][3]
    x, y, psi, u, v, r = RUN.truth[3]
    at, turn = truth.pose.pose.position, truth.pose.pose.orientation
    assert (at.x, at.y) == (y, x)
    yaw = 2.0 * math.atan2(turn.z, turn.w)
    assert math.remainder(yaw - (0.5 * math.pi - psi), 2.0 * math.pi) == pytest.approx(0.0)
    twist = truth.twist.twist
    assert (twist.linear.x, twist.linear.y, twist.angular.z) == (u, -v, -r)
    assert stamp == START + round(RUN.t[3] * 1e9)
    force = found["/imu/data"][7][1].linear_acceleration
    assert (force.x, force.y, force.z) == pytest.approx(RUN.z[7, [6, 7, 12]] * [1.0, -1.0, -1.0])


def test_forecast_is_a_path_with_covariances(tmp_path):
    path, ahead = tmp_path / "a.mcap", forecast()
    write_bag(path, RUN, states(), ahead)
    found = messages(path)
    ((stamp, line),) = found["/forecast/path"]
    assert stamp == START + round(ahead.t0 * 1e9)
    places = [(pose.pose.position.x, pose.pose.position.y) for pose in line.poses]
    assert places == [(20.0, 10.0)] * 3
    seconds = [p.header.stamp.sec + 1e-9 * p.header.stamp.nanosec for p in line.poses]
    assert np.allclose(seconds, DATUM.epoch + ahead.t, atol=1e-6)
    assert len(found["/forecast/odometry"]) == 3
    spread = np.reshape(found["/forecast/odometry"][0][1].pose.covariance, (6, 6))
    assert spread[0, 0] == 9.0 and spread[1, 1] == 4.0 and spread[0, 1] == spread[1, 0] == 1.5
    assert spread[5, 5] == 0.01
    # yaw turns the other way than the heading, and x is east
    assert spread[0, 5] == spread[5, 0] == -0.1
    twist = np.reshape(found["/forecast/odometry"][0][1].twist.covariance, (6, 6))
    assert np.diag(twist)[[0, 1, 5]] == pytest.approx([0.2, 0.3, 0.02])
    assert len(found["/twin/odometry"]) == 4  # not the row without an estimate
    own = np.reshape(found["/twin/odometry"][0][1].pose.covariance, (6, 6))
    assert np.diag(own)[[0, 1, 5]] == pytest.approx([0.04, 0.01, 0.09])


def test_estimates_have_roll_pitch_and_heave_where_they_are_known(tmp_path):
    path = tmp_path / "a.mcap"
    write_bag(path, RUN, heeled())
    found = messages(path)
    first, without, *last = (message for _, message in found["/twin/odometry"])
    for odometry in (first, *last):
        check_heeled(odometry)
        angular = odometry.twist.twist.angular
        assert (angular.x, angular.y) == (0.05, 0.04)
    assert without.pose.pose.position.z == 0.0 and without.twist.twist.linear.x == 3.0
    moves = [move for _, message in found["/tf"] for move in message.transforms]
    boat = [move for move in moves if move.child_frame_id == "base_link"][-1]
    assert boat.transform.rotation == last[-1].pose.pose.orientation
    assert boat.transform.translation.z == -0.3


def test_forecasts_have_roll_pitch_and_heave(tmp_path):
    path, ahead = tmp_path / "a.mcap", forecast()
    # time derivatives of roll and pitch by the rates of MOTION
    rates = body_rates((0.05, -0.04, 0.1), (0.2, -0.1))
    tilt, sd = np.tile([0.3, 0.2, -0.1], (3, 1)), np.tile([0.1, 0.2, 0.3], (3, 1))
    turning = np.tile([0.7, 0.05, -0.04], (3, 1))
    write_bag(path, RUN, None, ahead._replace(tilt=tilt, tilt_sd=sd, tilt_rates=turning))
    found = messages(path)
    assert len(found["/forecast/odometry"]) == 3
    for _, odometry in found["/forecast/odometry"]:
        check_heeled(odometry)
        angular = odometry.twist.twist.angular
        assert (angular.x, -angular.y, -angular.z) == pytest.approx(tuple(rates))
    ((_, line),) = found["/forecast/path"]
    assert all(pose.pose.position.z == -0.3 for pose in line.poses)
    turn = found["/forecast/odometry"][0][1].pose.pose.orientation
    assert all(pose.pose.orientation == turn for pose in line.poses)


def test_the_file_is_indexed_in_order_and_holds_its_definitions(tmp_path):
    reader = pytest.importorskip("mcap.reader")
    path = tmp_path / "a.mcap"
    write_bag(path, RUN, states(), forecast())
    with path.open("rb") as file:
        summary = reader.make_reader(file).get_summary()
        stamps = [m.log_time for _, _, m in reader.make_reader(file).iter_messages()]
    assert stamps == sorted(stamps) and len(stamps) == summary.statistics.message_count
    assert summary.chunk_indexes
    kinds = {schema.name: schema for schema in summary.schemas.values()}
    for name in ("nav_msgs/msg/Odometry", "nav_msgs/msg/Path", "sensor_msgs/msg/NavSatFix"):
        assert kinds[name].encoding == "ros2msg" and b"Header" in kinds[name].data
    assert all(channel.message_encoding == "cdr" for channel in summary.channels.values())


@pytest.mark.parametrize("shift", [-1.0, 3e9])
def test_times_without_a_ros_stamp_are_refused(shift, tmp_path):
    log = dataclasses.replace(RUN, t=RUN.t + shift, datum=None)
    with pytest.raises(ExportError, match="shift its time"):
        log.write(tmp_path / "a.mcap")
    assert not list(tmp_path.iterdir())


def test_without_rosbags_says_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(ExportError, match=r"pip install 'usv-twin\[ros\]'"):
        RUN.write(tmp_path / "a.mcap")


@pytest.mark.parametrize("command", ["predict", "identify"])
def test_commands_write_log_and_estimates(command, tmp_path):
    log, out = tmp_path / "a.csv", tmp_path / "b.mcap"
    RUN.write(log)
    asked = [command, str(log), "--ship", "otter", "-p", "ukf", "--out", str(out)]
    done = CliRunner().invoke(app, asked)
    assert done.exit_code == 0, done.output
    found = messages(out)
    assert {"/gps/fix", "/imu/data", "/twin/odometry", "/tf"} <= set(found)
    assert ("/forecast/path" in found) == (command == "predict")
    assert "/truth/odometry" not in found  # as the boat itself would know it
    topics = ["/twin/odometry", "/forecast/odometry"][: 2 if command == "predict" else 1]
    for topic in topics:  # the log shows roll and pitch
        turn = found[topic][-1][1].pose.pose.orientation
        assert turn.x != 0.0 and turn.y != 0.0
