"""Runs as MCAP files: read back by two other readers, and by our own."""

from __future__ import annotations

import dataclasses
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.twin.logs.foreign import COLUMN, run
from twin import Twin
from twin.logs.datum import Datum
from twin.logs.log import Log
from twin.logs.tables import ExportError
from twin.sim.bridge import particulars_of
from usv_gym import Vessel

pytest.importorskip("rosbags")

DATUM = Datum(latitude=59.9, longitude=10.7, epoch=1_764_115_200.25)
START = 1_764_115_200_250_000_000
"""The same in ns: a double cannot hold it."""

BOAT = particulars_of(Vessel.load("usv75"))
RUN = dataclasses.replace(run(100, truth=True), datum=DATUM)


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


def test_the_file_is_indexed_in_order_and_holds_its_definitions(tmp_path):
    reader = pytest.importorskip("mcap.reader")
    path = tmp_path / "a.mcap"
    RUN.write(path)
    with path.open("rb") as file:
        summary = reader.make_reader(file).get_summary()
        stamps = [m.log_time for _, _, m in reader.make_reader(file).iter_messages()]
    assert stamps == sorted(stamps) and len(stamps) == summary.statistics.message_count
    assert summary.chunk_indexes
    kinds = {schema.name: schema for schema in summary.schemas.values()}
    for name in ("nav_msgs/msg/Odometry", "sensor_msgs/msg/NavSatFix"):
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
