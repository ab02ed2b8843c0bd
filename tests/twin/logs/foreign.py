"""Recordings of other programs, for tests."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from typer.testing import CliRunner

from twin.channels import APPARENT_SPEED, MEASUREMENTS, TRUTH, WIND_SPEED
from twin.cli.main import app
from twin.logs import readers as table
from twin.logs.datum import Plane
from twin.logs.errors import LogError
from twin.logs.log import Log

MAPPINGS = Path(table.__file__).with_name("mappings")
COLUMN = {name: j for j, name in enumerate(MEASUREMENTS)}


def run(rows: int = 200, truth: bool = False) -> Log:
    """Return the log of a boat that goes where it points, at 10 Hz."""
    rng = np.random.default_rng(2)
    t = 0.1 * np.arange(rows)
    psi = 1.2 + 0.04 * t + 0.3 * np.sin(0.2 * t)
    z = 0.1 * rng.standard_normal((rows, len(MEASUREMENTS)))
    z[:, 0] += np.cumsum(0.2 * np.cos(psi))
    z[:, 1] += np.cumsum(0.2 * np.sin(psi))
    z[:, 2] += 2.0 * np.cos(psi)
    z[:, 3] += 2.0 * np.sin(psi)
    z[:, 4] = psi
    z[:, 5] = 0.04 + 0.06 * np.cos(0.2 * t)
    z[:, [WIND_SPEED, APPARENT_SPEED]] = np.abs(z[:, [WIND_SPEED, APPARENT_SPEED]])
    cmd = np.column_stack([5.0 + 0.1 * np.floor(t), 6.0 - 0.1 * np.floor(t)])
    cmd = np.column_stack([cmd, np.repeat(0.2 * np.sin(np.floor(t))[:, None], 2, axis=1)])
    return Log(t, z, cmd, rng.standard_normal((rows, len(TRUTH))) if truth else None)


def refused(path: Path, mapping: Path | None = None, at: Path | None = None) -> str:
    with pytest.raises(LogError) as caught:
        Log.read(path, mapping)
    message = str(caught.value)
    assert message.startswith(f"{at or path}: ")
    return message


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


FOREIGN = """
[columns]
t_s = { from = "ms", unit = "ms" }
n_rps = { from = "shaft", unit = "rpm" }
delta_rad = { from = "rudder", unit = "deg", scale = -1.0 }
compass_rad = { from = "yaw", unit = "deg", frame = "enu" }
gyro_radps = { from = "rate", unit = "degps", frame = "enu" }
wind_mps = { from = "TWS", unit = "kn", offset = 1.0 }

[position]
latitude = "lat"
longitude = "lon"
datum = [60.0, 179.9999]

[velocity]
speed = { from = "SOG", unit = "kn" }
course = { from = "COG", unit = "deg" }
"""


def foreign(log: Log) -> pl.DataFrame:
    """Return a log in foreign columns."""
    z = dict(zip(MEASUREMENTS, log.z.T, strict=True))
    latitude, longitude = Plane(60.0, 179.9999).degrees(z["gps_x_m"], z["gps_y_m"])
    return pl.DataFrame(
        {
            "ms": 1e3 * log.t,
            "shaft": 60.0 * log.cmd[:, 0],
            "rudder": -np.degrees(log.cmd[:, 2]),
            "yaw": 90.0 - np.degrees(z["compass_rad"]),
            "rate": -np.degrees(z["gyro_radps"]),
            "TWS": z["wind_mps"] * 3600.0 / 1852.0,
            "lat": latitude,
            "lon": longitude,
            "SOG": np.hypot(z["gps_vx_mps"], z["gps_vy_mps"]) * 3600.0 / 1852.0,
            "COG": np.degrees(np.arctan2(z["gps_vy_mps"], z["gps_vx_mps"])),
            "remark": ["ok, so"] * len(log),
        }
    )


START = 1_753_371_900_000_000_000
EXAMPLE = (MAPPINGS / "ros2_example.toml").read_text(encoding="utf-8")
ALL_ROWS = EXAMPLE.split("[rows]")[0]


def record(
    path: Path, log: Log, storage: str, stamped: bool = True, late: int = 0, order: Any = None
) -> Path:
    """Write a log as the bag that the example mapping reads: each sensor at its own rate."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    make = store.types
    z = dict(zip(MEASUREMENTS, log.z.T, strict=True))
    stamps = START + np.round(1e9 * log.t).astype(np.int64)
    no9 = np.zeros(9)

    def header(k: int) -> Any:
        ns = int(stamps[k]) if stamped else 0
        time = make["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
        return make["std_msgs/msg/Header"](time, "boat")

    def vector(x: float, y: float, z: float) -> Any:
        return make["geometry_msgs/msg/Vector3"](float(x), float(y), float(z))

    def imu(k: int) -> Any:
        half = 0.5 * (0.5 * math.pi - z["compass_rad"][k])
        turn = make["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(half), math.cos(half))
        return make["sensor_msgs/msg/Imu"](
            header(k),
            turn,
            no9,
            vector(0, 0, -z["gyro_radps"][k]),
            no9,
            vector(z["accel_x_mps2"][k], -z["accel_y_mps2"][k], 9.81),
            no9,
        )

    lat, lon = Plane(38.8658, 121.5344).degrees(z["gps_x_m"], z["gps_y_m"])

    def fix(k: int) -> Any:
        status = make["sensor_msgs/msg/NavSatStatus"](0 if k else -1, 1)
        return make["sensor_msgs/msg/NavSatFix"](header(k), status, lat[k], lon[k], 0.0, no9, 0)

    def velocity(k: int) -> Any:
        twist = make["geometry_msgs/msg/Twist"](
            vector(z["gps_vy_mps"][k], z["gps_vx_mps"][k], 0.0), vector(0, 0, 0)
        )
        return make["geometry_msgs/msg/TwistStamped"](header(k), twist)

    def command(j: int, scale: float) -> Any:
        # in force in the interval that ends at a row: sent at the row before
        return lambda k: make["std_msgs/msg/Float64"](scale * log.cmd[min(k + 1, len(log) - 1), j])

    everything = {
        "/imu/data": ("sensor_msgs/msg/Imu", imu, 1),
        "/gps/fix": ("sensor_msgs/msg/NavSatFix", fix, 5),
        "/gps/vel": ("geometry_msgs/msg/TwistStamped", velocity, 5),
        "/thruster/left/rpm": ("std_msgs/msg/Float64", command(0, 60.0), 2),
        "/thruster/right/rpm": ("std_msgs/msg/Float64", command(1, 60.0), 2),
        "/steering": ("std_msgs/msg/Float64", command(2, -1.0), 2),
    }
    plugin = getattr(rosbag2.StoragePlugin, storage)
    with rosbag2.Writer(path, version=9, storage_plugin=plugin) as writer:
        for topic, (kind, message, every) in everything.items():
            link = writer.add_connection(topic, kind, typestore=store)
            for k in range(0, len(log), every) if order is None else order:
                raw = store.serialize_cdr(message(int(k)), kind)
                writer.write(link, int(stamps[k]) + late, raw)
    return path


def command(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, [*arguments])
    return result.exit_code, " ".join(result.output.split())
