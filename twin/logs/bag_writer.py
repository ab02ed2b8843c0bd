"""A run as an MCAP file of ROS 2 messages, for Foxglove, PlotJuggler and ROS itself.

Frames are those of REP 103 and 105: ``map`` has x east, y north, z up, and ``base_link`` x forward,
y to port, z up. Angles turn to port above 0, and a yaw of 0 points east. A heading is a quaternion,
so that whole turns are lost.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.channels import MEASUREMENTS, PSI, TRUE_MOTION, R, U, V, X, Y
from twin.logs.columns import Array
from twin.logs.tables import ExportError
from usv_kernel.files import write_whole

if TYPE_CHECKING:
    from twin.logs.log import Log

__all__ = [
    "BAG_SUFFIX",
    "write_bag",
]

BAG_SUFFIX = ".mcap"

_LATEST = 2**31 - 1
"""Largest second of a ROS stamp."""


def _check(path: str | Path, log: Log) -> None:
    """Refuse to write a bag without rosbags, or of times that ROS has no stamp for.

    Raises
    ------
    ExportError
        Names the file and the remedy.
    """
    try:
        import rosbags.rosbag2  # noqa: F401
    except ImportError:
        raise ExportError(
            f"{path}: writing MCAP needs the package rosbags: pip install 'usv-twin[ros]'"
        ) from None
    epoch = _epoch(log)
    if len(log.t) and not 0.0 <= epoch + log.t[0] <= epoch + log.t[-1] < _LATEST - 1e6:
        raise ExportError(
            f"{path}: a stamp of ROS is from 0 to {_LATEST} s since 1970, and the log runs from "
            f"{epoch + log.t[0]:.6g} to {epoch + log.t[-1]:.6g} s; shift its time"
        )


def write_bag(path: str | Path, log: Log) -> None:
    """Write a run as an MCAP file.

    Parameters
    ----------
    path : str or Path
        File to create or replace.
    log : Log
        The run. NavSatFix is written where it has latitude and longitude.

    Raises
    ------
    ExportError
        Without rosbags, or for times before 1970.
    """
    _check(path, log)
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    make = _Messages(store.types, _epoch(log))
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        links: dict[str, Any] = {}
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            for ns, topic, message in make.rows(log):
                kind = message.__msgtype__
                if topic not in links:
                    links[topic] = writer.add_connection(topic, kind, typestore=store)
                writer.write(links[topic], ns, store.serialize_cdr(message, kind))
        write_whole(path, next(bag.glob("*.mcap")).read_bytes())


def _epoch(log: Log) -> float:
    """Return the time of t = 0, s since 1970; 0 where it is not known."""
    return 0.0 if log.datum is None or log.datum.epoch is None else log.datum.epoch


class _Messages:
    """Makes messages of rows; ``types`` are those of the message definitions by name."""

    def __init__(self, types: Any, epoch: float) -> None:
        self._types = types
        self._second = math.floor(epoch)
        self._rest = epoch - self._second

    def _new(self, kind: str, *values: Any) -> Any:
        return self._types[kind](*values)

    def _ns(self, t: float) -> int:
        return self._second * 10**9 + round((self._rest + t) * 1e9)

    def _header(self, t: float, frame: str) -> Any:
        second, rest = divmod(self._ns(t), 10**9)
        stamp = self._new("builtin_interfaces/msg/Time", second, rest)
        return self._new("std_msgs/msg/Header", stamp, frame)

    def _vector(self, x: float, y: float, z: float, kind: str = "Vector3") -> Any:
        return self._new(f"geometry_msgs/msg/{kind}", float(x), float(y), float(z))

    def _turn(self, psi: float, roll: float = 0.0, pitch: float = 0.0) -> Any:
        """Return the quaternion of a heading, roll and pitch; zeros where there is no heading."""
        kind = "geometry_msgs/msg/Quaternion"
        if math.isnan(psi):
            return self._new(kind, 0.0, 0.0, 0.0, 0.0)
        half = 0.5 * (0.5 * math.pi - psi), 0.5 * -pitch, 0.5 * roll
        (cy, cp, cr), (sy, sp, sr) = (tuple(map(f, half)) for f in (math.cos, math.sin))
        x, y = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy
        z, w = cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy
        return self._new(kind, x, y, z, w)

    def _odometry(self, t: float, state: Array, motion: Array) -> Any:
        """Return a true state (6,) and motion (6,) in the order of ``TRUE_MOTION``."""
        place = self._vector(state[Y], state[X], -motion[0], "Point")
        turn = self._turn(state[PSI], motion[1], motion[2])
        pose = self._new("geometry_msgs/msg/Pose", place, turn)
        linear = self._vector(state[U], -state[V], -motion[3])
        angular = self._vector(motion[4], -motion[5], -state[R])
        twist = self._new("geometry_msgs/msg/Twist", linear, angular)
        exact = np.zeros(36)
        return self._new(
            "nav_msgs/msg/Odometry",
            self._header(t, "map"),
            "truth",
            self._new("geometry_msgs/msg/PoseWithCovariance", pose, exact),
            self._new("geometry_msgs/msg/TwistWithCovariance", twist, exact),
        )

    def _transform(self, t: float, state: Array, motion: Array) -> Any:
        """Return where the true boat is in the map, and how it is turned."""
        place = self._vector(state[Y], state[X], -motion[0])
        turn = self._turn(state[PSI], motion[1], motion[2])
        turn = self._new("geometry_msgs/msg/Transform", place, turn)
        header = self._header(t, "map")
        stamped = self._new("geometry_msgs/msg/TransformStamped", header, "truth", turn)
        return self._new("tf2_msgs/msg/TFMessage", [stamped])

    def rows(self, log: Log) -> Iterator[tuple[int, str, Any]]:
        """Yield the time (ns), topic and message of commands, samples and truth, row by row."""
        plane = None if log.datum is None else log.datum.plane
        places = None if plane is None else np.stack(plane.degrees(*log.z[:, :2].T), axis=1)
        for k, t in enumerate(log.t.tolist()):
            row = dict(zip(MEASUREMENTS, log.z[k].tolist(), strict=True))
            said: dict[str, Any] = {}
            if k + 1 < len(log.t):  # a row has what was in force in the interval that ends at it
                said["/command"] = self._command(t, log.cmd[k + 1])
            said |= {topic: of(self, t, row) for topic, of in _SENSORS.items()}
            if places is not None and np.isfinite(places[k]).all():
                said["/gps/fix"] = self._fix(t, places[k], row["gps_z_m"])
            if log.truth is not None and np.isfinite(log.truth[k]).all():
                still = np.zeros(len(TRUE_MOTION))
                motion = still if log.true_motion is None else log.true_motion[k]
                said["/truth/odometry"] = self._odometry(t, log.truth[k], motion)
                said["/tf"] = self._transform(t, log.truth[k], motion)
            for topic, message in said.items():
                if message is not None:
                    yield self._ns(t), topic, message

    def _command(self, t: float, cmd: Array) -> Any:
        names = ["left_shaft", "right_shaft", "left_drive", "right_drive"]
        position = np.array([math.nan, math.nan, -cmd[2], -cmd[3]])
        velocity = np.array([*(2.0 * math.pi * cmd[:2]), math.nan, math.nan])
        header = self._header(t, "base_link")
        kind = "sensor_msgs/msg/JointState"
        return self._new(kind, header, names, position, velocity, np.zeros(0))

    def _fix(self, t: float, place: Array, down: float) -> Any:
        status = self._new("sensor_msgs/msg/NavSatStatus", 0, 1)
        latitude, longitude = map(float, place)
        header = self._header(t, "gps")
        return self._new(
            "sensor_msgs/msg/NavSatFix", header, status, latitude, longitude, -down, np.zeros(9), 0
        )

    def position(self, t: float, row: dict[str, float]) -> Any:
        """Return the fix in metres, if there is one."""
        x, y, down = row["gps_x_m"], row["gps_y_m"], row["gps_z_m"]
        if all(map(math.isnan, (x, y, down))):
            return None
        point = self._vector(y, x, -down, "Point")
        return self._new("geometry_msgs/msg/PointStamped", self._header(t, "map"), point)

    def velocity(self, t: float, row: dict[str, float]) -> Any:
        """Return the velocity over ground, if there is one."""
        north, east, down = row["gps_vx_mps"], row["gps_vy_mps"], row["gps_vz_mps"]
        if all(map(math.isnan, (north, east, down))):
            return None
        linear, still = self._vector(east, north, -down), self._vector(0.0, 0.0, 0.0)
        twist = self._new("geometry_msgs/msg/Twist", linear, still)
        return self._new("geometry_msgs/msg/TwistStamped", self._header(t, "map"), twist)

    def imu(self, t: float, row: dict[str, float]) -> Any:
        """Return heading, rates and accelerations, if any; a covariance of -1 marks a missing one.

        Source: sensor_msgs/msg/Imu.
        """
        rates = row["gyro_x_radps"], -row["gyro_y_radps"], -row["gyro_radps"]
        force = row["accel_x_mps2"], -row["accel_y_mps2"], -row["accel_z_mps2"]
        psi = row["compass_rad"]
        if all(map(math.isnan, (*rates, *force, psi))):
            return None
        tilt = (0.0 if math.isnan(v) else v for v in (row["ahrs_roll_rad"], row["ahrs_pitch_rad"]))
        known = (not math.isnan(psi), not math.isnan(rates[2]), not math.isnan(force[0]))
        spread = [np.array([0.0 if here else -1.0, *[0.0] * 8]) for here in known]
        turn, header = self._turn(psi, *tilt), self._header(t, "base_link")
        vectors = self._vector(*rates), self._vector(*force)
        parts = (turn, spread[0], vectors[0], spread[1], vectors[1], spread[2])
        return self._new("sensor_msgs/msg/Imu", header, *parts)

    def ahrs(self, t: float, row: dict[str, float]) -> Any:
        """Return roll and pitch as they were measured; NaN for one that was not.

        The orientation of an Imu message has no place for a part of it.
        """
        return self._stamped(t, "base_link", row["ahrs_roll_rad"], -row["ahrs_pitch_rad"], math.nan)

    def wind(self, t: float, row: dict[str, float]) -> Any:
        """Return the velocity of the air, if it is measured."""
        north, east = _air(row["wind_mps"], row["wind_from_rad"])
        return self._stamped(t, "map", east, north)

    def apparent_wind(self, t: float, row: dict[str, float]) -> Any:
        """Return the velocity of the air on board, if it is measured."""
        ahead, starboard = _air(row["apparent_wind_mps"], row["apparent_wind_rad"])
        return self._stamped(t, "base_link", ahead, -starboard)

    def _stamped(self, t: float, frame: str, x: float, y: float, z: float = 0.0) -> Any:
        """Return a vector; None where neither x nor y is known."""
        if math.isnan(x) and math.isnan(y):
            return None
        vector = self._vector(x, y, z)
        return self._new("geometry_msgs/msg/Vector3Stamped", self._header(t, frame), vector)


def _air(speed: float, source: float) -> tuple[float, float]:
    """Return the velocity of air that comes from a direction clockwise from the first axis."""
    return -speed * math.cos(source), -speed * math.sin(source)


_SENSORS: dict[str, Callable[[_Messages, float, dict[str, float]], Any]] = {
    "/gps/position": _Messages.position,
    "/gps/velocity": _Messages.velocity,
    "/imu/data": _Messages.imu,
    "/ahrs": _Messages.ahrs,
    "/wind": _Messages.wind,
    "/wind/apparent": _Messages.apparent_wind,
}
"""Topic and maker of each sensor's message, which is None where nothing is measured."""
