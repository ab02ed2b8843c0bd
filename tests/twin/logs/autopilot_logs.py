"""Small logs as an autopilot would write them, made of a log."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from twin import Log
from twin.channels import MEASUREMENTS
from twin.logs.datum import Plane

HOME = 59.9, 10.7
EPOCH = 1_764_115_200.0
"""Wednesday, 26 November 2025, 0:00 UTC."""

WEEK, MILLISECONDS = 2394, 259_218_000
"""The same as GPS week and time in it, 18 leap seconds later."""

SKID = {"SERVO1_FUNCTION": 73.0, "SERVO3_FUNCTION": 74.0, "CRUISE_SPEED": 1.5}
SKID |= {"CRUISE_THROTTLE": 70.0}
RUDDER = {"SERVO1_FUNCTION": 26.0, "SERVO3_FUNCTION": 70.0}

FORMATS = {
    "FMT": (0x80, "BBnNZ", "Type,Length,Name,Format,Columns"),
    "PARM": (0x40, "QNff", "TimeUS,Name,Value,Default"),
    "GPS": (
        0x41,
        "QBBIHBcLLeffffB",
        "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U",
    ),
    "ATT": (0x42, "QffffffB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF"),
    "IMU": (0x43, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "RCOU": (0x44, "QHHHH", "TimeUS,C1,C2,C3,C4"),
    "POS": (0x45, "QLLf", "TimeUS,Lat,Lng,Alt"),
}
"""Kind, letters and columns of the messages."""

LETTERS = {"b": "b", "B": "B", "h": "h", "H": "H", "i": "i", "I": "I", "q": "q", "Q": "Q"}
LETTERS |= {"f": "f", "d": "d", "c": "h", "C": "H", "e": "i", "E": "I", "L": "i"}
LETTERS |= {"n": "4s", "N": "16s", "Z": "64s"}


def message(name: str, *values: object) -> bytes:
    kind, letters, _ = FORMATS[name]
    packer = struct.Struct("<" + "".join(LETTERS[letter] for letter in letters))
    return b"\xa3\x95" + bytes([kind]) + packer.pack(*values)


def description(name: str, length: int | None = None) -> bytes:
    kind, letters, columns = FORMATS[name]
    own = 3 + struct.calcsize("<" + "".join(LETTERS[letter] for letter in letters))
    texts = (text.encode() for text in (name, letters, columns))
    return message("FMT", kind, own if length is None else length, *texts)


def width(share: float) -> int:
    return round(1500.0 + 400.0 * min(max(share, -1.0), 1.0))


class Row:
    """A row of a log in an autopilot's units."""

    def __init__(self, log: Log, k: int, full: float) -> None:
        self.t = float(log.t[k])
        self.z = dict(zip(MEASUREMENTS, log.z[k].tolist(), strict=True))
        after = log.cmd[min(k + 1, len(log) - 1)]  # in force in the interval up to the next row
        self.shares = after[0] / full, after[1] / full
        self.helm = after[2] / math.radians(30.0)
        north, east = self.z["gps_x_m"], self.z["gps_y_m"]
        self.fix = math.isfinite(north)
        if self.fix:
            self.place = tuple(float(v) for v in Plane(*HOME).degrees(north, east))
        velocity = self.z["gps_vx_mps"], self.z["gps_vy_mps"]
        self.speed = math.hypot(*velocity)
        self.course = math.degrees(math.atan2(velocity[1], velocity[0])) % 360.0

    def widths(self, rudder: bool) -> tuple[int, int, int, int]:
        left, right = self.shares
        first = self.helm if rudder else left
        return width(first), 0, width(right), 0


def dataflash(
    log: Log, parameters: Mapping[str, float], full: float = 20.0, status: int = 3
) -> bytes:
    """Return a DataFlash log of a run; its own position is a kilometre off."""
    rudder = parameters.get("SERVO1_FUNCTION") == 26.0
    parts = [description(name) for name in FORMATS]
    for name, value in parameters.items():
        parts.append(message("PARM", 1, name.encode(), value, value))
    for k in range(len(log)):
        row = Row(log, k, full)
        now = round(1e6 * (100.0 + row.t))
        z = row.z
        parts.append(message("RCOU", now - 3000, *row.widths(rudder)))
        degrees = [math.degrees(z[f"ahrs_{name}_rad"]) for name in ("roll", "pitch")]
        yaw = math.degrees(z["compass_rad"])
        parts.append(message("ATT", now, 0.0, degrees[0], 0.0, degrees[1], 0.0, yaw, 3))
        rates = z["gyro_x_radps"], z["gyro_y_radps"], z["gyro_radps"]
        force = z["accel_x_mps2"], z["accel_y_mps2"], z["accel_z_mps2"]
        parts.append(message("IMU", now + 200, 0, *rates, *force))
        parts.append(message("IMU", now + 300, 1, *(9.0,) * 6))
        if row.fix:
            place = [round(1e7 * v) for v in row.place]
            ms = MILLISECONDS + round(1e3 * row.t)
            height = round(-100.0 * z["gps_z_m"])
            motion = row.speed, row.course, z["gps_vz_mps"], 0.0
            sent = (status, ms, WEEK, 10, 80, *place, height, *motion, 1)
            parts.append(message("GPS", now + 500, 0, *sent))
        parts.append(message("POS", now, *(round(1e7 * (v + 0.01)) for v in HOME), 0.0))
    return b"".join(parts)


def telemetry(
    log: Log,
    parameters: Mapping[str, float],
    full: float = 20.0,
    *,
    boot: float = 100.0,
    late: float = 0.3,
    receiver: bool = True,
    flags: int | None = None,
) -> bytes:
    """Return a telemetry log of a run; packets arrive late, and its own position is off.

    With ``flags``, accelerations are those of HIGHRES_IMU, and of RAW_IMU else.
    """
    from pymavlink.dialects.v20 import common as dialect

    link, parts = dialect.MAVLink(None, 1, 1), []
    rudder = parameters.get("SERVO1_FUNCTION") == 26.0

    def send(arrived: float, made: object) -> None:
        packed = bytes(made.pack(link))  # type: ignore[attr-defined]
        link.seq = (link.seq + 1) % 256
        parts.append(struct.pack(">Q", round(1e6 * arrived)) + packed)

    for name, value in parameters.items():
        send(EPOCH, dialect.MAVLink_param_value_message(name.encode(), value, 9, 1, 0))
    for k in range(len(log)):
        row = Row(log, k, full)
        z, at, stamp = row.z, EPOCH + row.t + late * (k % 3), boot + row.t
        ms, us = round(1e3 * stamp), round(1e6 * stamp)
        yaw = math.remainder(z["compass_rad"], 2.0 * math.pi)
        tilt = z["ahrs_roll_rad"], z["ahrs_pitch_rad"], yaw
        rates = z["gyro_x_radps"], z["gyro_y_radps"], z["gyro_radps"]
        send(at, dialect.MAVLink_attitude_message(ms, *tilt, *rates))
        outputs = (*row.widths(rudder), 0, 0, 0, 0)
        send(at, dialect.MAVLink_servo_output_raw_message((us - 3000) % 2**32, 0, *outputs))
        force = [z[f"accel_{axis}_mps2"] for axis in "xyz"]
        milli = [round(1e3 * value / 9.80665) for value in force]
        if flags is None:
            send(at, dialect.MAVLink_raw_imu_message(us, *milli, 0, 0, 0, 0, 0, 0))
        else:
            send(at, dialect.MAVLink_highres_imu_message(us, *force, *[0.0] * 10, flags))
        off = [round(1e7 * (value + 0.01)) + 10 * k for value in HOME]
        send(at, dialect.MAVLink_global_position_int_message(ms, *off, 0, 0, k, k, 0, 0))
        if row.fix and receiver:
            place = [round(1e7 * v) for v in row.place]
            height = round(-1e3 * z["gps_z_m"])
            motion = round(100.0 * row.speed), round(100.0 * row.course)
            raw = dialect.MAVLink_gps_raw_int_message
            sent = raw(us, 3, *place, height, 80, 80, *motion, 10)
            send(at, sent)
            send(at, sent)  # streamed faster than the receiver measures
        if k % 20 == 0:
            send(at, dialect.MAVLink_system_time_message(round(1e6 * (EPOCH + row.t)), ms))
    return b"".join(parts)


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def close(one: np.ndarray, two: np.ndarray, tolerance: float) -> bool:
    """Return whether samples agree where both have one, and that is nearly everywhere."""
    both = np.isfinite(one) & np.isfinite(two)
    missing = np.isfinite(one) != np.isfinite(two)
    same = bool((np.abs(one - two)[both] <= tolerance).all())
    return bool(both.sum() > 5) and bool(missing.sum() <= 2) and same
