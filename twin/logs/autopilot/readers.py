"""The two kinds of logs of an autopilot, as one kind of recording."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from twin.logs.autopilot.dataflash import DataFlash, Messages
from twin.logs.autopilot.flight import APART, Flight, Samples, steady_times, table_of
from twin.logs.autopilot.telemetry import read_telemetry, telemetry_parameters
from twin.logs.columns import Array
from twin.logs.errors import LogError
from twin.logs.mapping import Layout
from twin.logs.readers import Table

__all__ = [
    "is_autopilot_log",
    "parameters_of",
    "read_autopilot_log",
]

SUFFIXES = (".bin", ".tlog")
"""Endings of DataFlash and telemetry logs, in any case."""

_GPS_EPOCH = 315964800.0
"""6 January 1980, s since 1970."""

LEAP_SECONDS = 18.0
"""GPS time runs ahead of UTC by this much since 2017, s.
Source: IERS Bulletin C 53."""

_WEEK = 604800.0

_OUTPUTS = ("RCOU", "RCO2", "RCO3")


def is_autopilot_log(path: Path) -> bool:
    """Return whether a path is that of a log of an autopilot, by its ending."""
    return path.suffix.lower() in SUFFIXES


def read_autopilot_log(path: Path, layout: Layout | None) -> Table:
    """Return the columns of an autopilot's log.

    Position and velocity are those of the GPS receiver, heading, roll and pitch those of the
    autopilot's attitude, and the commands come from its servo outputs.

    Raises
    ------
    LogError
        Names the file and the remedy.
    """
    return table_of(path, _flight(path), layout)


def parameters_of(path: Path) -> Mapping[str, float]:
    """Return the autopilot's parameters in its log, by name."""
    if path.suffix.lower() == ".tlog":
        return telemetry_parameters(path)
    return _parameters(DataFlash(path, ("PARM",)).messages)


def _flight(path: Path) -> Flight:
    if path.suffix.lower() == ".tlog":
        return read_telemetry(path)
    log = DataFlash(path, ("GPS", "GPS2", "ATT", "IMU", "PARM", *_OUTPUTS))
    found = {name: _stamped(path, rows) for name, rows in log.messages.items()}
    notes = []
    if log.lost:
        notes.append(f"{log.lost} bytes of damaged or torn messages left out")
    fixes, epoch = _receiver(found, notes)
    sensors = []
    if "ATT" in found:
        sensors.append(_attitude(found["ATT"]))
        notes.append("heading, roll and pitch: the autopilot's attitude (ATT)")
    if "IMU" in found:
        sensors.append(_imu(found["IMU"]))
    return Flight(fixes, sensors, _widths(found), _parameters(log.messages), epoch, notes)


def _stamped(path: Path, rows: Messages) -> Messages:
    """Return messages without those of a damaged stamp."""
    if "TimeUS" not in rows:
        raise LogError(
            f"{path}: its messages have no TimeUS; logs from before ArduPilot 3.3 (2015) cannot be "
            "read: convert them with mavlogdump.py --format csv, and write a mapping"
        )
    t = _time(rows)
    kept = steady_times(t)
    back = -np.diff(t[kept])
    if len(back) and back.max() > APART:
        raise LogError(
            f"{path}: the time goes back by {back.max():.3g} s: the file holds several logs; split "
            "it where the autopilot started again"
        )
    return rows.where(kept)


def _time(rows: Messages) -> Array:
    return rows["TimeUS"] * 1e-6


def _parameters(messages: Mapping[str, Messages]) -> dict[str, float]:
    """Return the parameters, each as it was last."""
    rows = messages.get("PARM")
    if rows is None or "Value" not in rows or "Name" not in (rows.rows.dtype.names or ()):
        return {}
    named = zip(rows.texts("Name"), rows["Value"].tolist(), strict=True)
    return {name: value for name, value in named if np.isfinite(value)}


def _of_instance(rows: Messages, number: int) -> Messages:
    return rows.where(rows["I"] == number) if "I" in rows else rows


def _columns(rows: Messages, names: Mapping[str, str], scale: float = 1.0) -> dict[str, Array]:
    """Return columns of a log from fields of messages, those that are there; NaN if not finite."""
    made = {}
    for name, source in names.items():
        if source in rows:
            values = scale * rows[source]
            made[name] = np.where(np.isfinite(values), values, np.nan)
    return made


def _receiver(found: Mapping[str, Messages], notes: list[str]) -> tuple[Samples, float | None]:
    """Return the fixes of the receiver that has most of them, and the time of the start."""
    receivers: list[tuple[str, Messages]] = []
    if "GPS" in found:
        rows = found["GPS"]
        numbers = np.unique(rows["I"]) if "I" in rows else np.zeros(1)
        receivers += [(f"GPS {n + 1:.0f}", _of_instance(rows, n)) for n in numbers[:4]]
    if "GPS2" in found:
        receivers.append(("GPS 2", found["GPS2"]))
    fields = {"Status", "Lat", "Lng", "Spd", "GCrs"}
    sound = [(name, _with_fix(rows)) for name, rows in receivers if all(f in rows for f in fields)]
    if not sound:
        return Samples(np.zeros(0), {}), None
    name, rows = max(sound, key=lambda item: len(item[1].rows))
    if len(sound) > 1:
        notes.append(f"position and velocity: {name}, which has most fixes of {len(sound)}")
    else:
        notes.append(f"position and velocity: the receiver ({name}), not the autopilot's estimate")
    speed, course = rows["Spd"], np.radians(rows["GCrs"])
    columns = {"latitude": rows["Lat"], "longitude": rows["Lng"]}
    columns |= {"gps_vx_mps": speed * np.cos(course), "gps_vy_mps": speed * np.sin(course)}
    columns |= _columns(rows, {"gps_z_m": "Alt"}, -1.0)
    if "VZ" in rows and rows["VZ"].any():
        columns |= _columns(rows, {"gps_vz_mps": "VZ"})
    t = _time(rows)
    columns = {key: np.where(np.isfinite(v), v, np.nan) for key, v in columns.items()}
    return Samples(t, columns), _epoch(rows, t)


def _with_fix(rows: Messages) -> Messages:
    """Return the messages with a fix that is a place on Earth."""
    latitude, longitude = rows["Lat"], rows["Lng"]
    place = (np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 180.0)
    return rows.where((rows["Status"] >= 2.0) & place & ((latitude != 0.0) | (longitude != 0.0)))


def _epoch(rows: Messages, t: Array) -> float | None:
    """Return the time at which the autopilot started, s since 1970, by the receiver's clock."""
    if not ("GWk" in rows and "GMS" in rows):
        return None
    known = rows["GWk"] > 0.0
    if not known.any():
        return None
    gps = _GPS_EPOCH + _WEEK * rows["GWk"] + 1e-3 * rows["GMS"] - LEAP_SECONDS
    return float(np.median((gps - t)[known]))


def _attitude(rows: Messages) -> Samples:
    names = {"compass_rad": "Yaw", "ahrs_roll_rad": "Roll", "ahrs_pitch_rad": "Pitch"}
    made = _columns(rows, names, np.pi / 180.0)
    if "compass_rad" in made:
        made["compass_rad"] = np.remainder(made["compass_rad"], 2.0 * np.pi)
    return Samples(_time(rows), made)


def _imu(rows: Messages) -> Samples:
    rows = _of_instance(rows, 0)
    names = {"gyro_radps": "GyrZ", "gyro_x_radps": "GyrX", "gyro_y_radps": "GyrY"}
    names |= {f"accel_{axis}_mps2": f"Acc{axis.upper()}" for axis in "xyz"}
    return Samples(_time(rows), _columns(rows, names))


def _widths(found: Mapping[str, Messages]) -> dict[int, tuple[Array, Array]]:
    """Return times and pulse widths of each output."""
    widths = {}
    for rows in (found[name] for name in _OUTPUTS if name in found):
        for field in rows.rows.dtype.names or ():
            if re.fullmatch(r"C\d{1,2}", field) and field in rows:
                widths[int(field[1:])] = _time(rows), rows[field]
    return widths
