"""Telemetry logs (.tlog): MAVLink packets, each behind the time at which it arrived.

Read through pymavlink, of the extra ``view``. A sender's own stamp counts where it is of the clock
that ATTITUDE has; radio links are late by tenths of seconds.
Source: https://ardupilot.org/dev/docs/telemetry-logs.html; MAVLink common message set.
"""

from __future__ import annotations

import importlib
import math
import re
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from twin.logs.autopilot.flight import APART, Flight, Samples
from twin.logs.columns import Array
from twin.logs.errors import LogError
from twin.logs.files import cannot_be_read
from twin.logs.readers import MAX_ROWS, too_long

__all__ = ["read_telemetry", "telemetry_parameters"]

_PLAUSIBLE = 6e14, 4e15
"""Times of arrival in this range, 1989 to 2096, are plausible, us since 1970."""

_DAY = 86400e6

_MARK = re.compile(rb"[\xfd\xfe]")

_SEARCH = 1 << 16
"""A file without a packet in so many bytes is no telemetry log."""

_GRAVITY = 9.80665
"""Gravity in which ArduPilot counts milli-g, m/s2."""

_WRAP = 2.0**32

_IDS = {
    **{2: "SYSTEM_TIME", 22: "PARAM_VALUE", 24: "GPS_RAW_INT", 26: "SCALED_IMU", 27: "RAW_IMU"},
    **{30: "ATTITUDE", 33: "GLOBAL_POSITION_INT", 36: "SERVO_OUTPUT_RAW", 105: "HIGHRES_IMU"},
    124: "GPS2_RAW",
}
"""Numbers of the messages that are read."""

_PARAMETER, _PARAMETER_ID = "PARAM_VALUE", 22

_IMUS = ("HIGHRES_IMU", "SCALED_IMU", "RAW_IMU")
"""From the best one."""

_RECEIVERS = ("GPS_RAW_INT", "GPS2_RAW")


class _Sent(NamedTuple):
    """A message: its time of arrival (us since 1970), the system that sent it, what it says."""

    arrived: int
    system: int
    message: Any


@dataclass
class _Start:
    """What one autopilot sent between two of its starts."""

    t: dict[str, list[float]] = field(default_factory=dict)
    rows: dict[str, list[tuple[float, ...]]] = field(default_factory=dict)
    boot: float = -1.0  # newest time of its clock, s
    epochs: list[float] = field(default_factory=list)
    fix: float = math.nan  # newest stamp of the receiver

    def add(self, name: str, t: float, row: tuple[float, ...]) -> None:
        self.t.setdefault(name, []).append(t)
        self.rows.setdefault(name, []).append(row)

    def of(self, name: str) -> tuple[Array, Array]:
        """Return times (n,) and rows (n, k)."""
        return np.array(self.t.get(name, ())), np.array(self.rows.get(name, ()), dtype=float)


def read_telemetry(path: Path) -> Flight:
    """Return what the autopilot of a telemetry log sent.

    Raises
    ------
    LogError
        For a file that cannot be read, or is no such log; and where pymavlink is not installed.
    """
    starts: dict[int, list[_Start]] = {}
    parameters: dict[int, dict[str, float]] = {}
    counts: Counter[str] = Counter()
    for sent in _messages(path, _IDS, counts):
        message, system = sent.message, sent.system
        name = message.get_type()
        if name == _PARAMETER:
            _keep(parameters, system, message)
            continue
        counts["read"] += 1
        if counts["read"] > MAX_ROWS:
            raise too_long(str(path))
        _take(starts.setdefault(system, [_Start()]), name, message, sent.arrived * 1e-6)
    return _flight(path, starts, parameters, counts)


def telemetry_parameters(path: Path) -> dict[str, float]:
    """Return the parameters that the autopilot of a telemetry log sent, by name.

    See :func:`read_telemetry`.
    """
    parameters: dict[int, dict[str, float]] = {}
    for sent in _messages(path, (_PARAMETER_ID,), Counter()):
        _keep(parameters, sent.system, sent.message)
    return max(parameters.values(), key=len, default={})


def _keep(parameters: dict[int, dict[str, float]], system: int, message: Any) -> None:
    """Keep a parameter, unless its value is none."""
    if math.isfinite(message.param_value):
        parameters.setdefault(system, {})[str(message.param_id)] = float(message.param_value)


def _messages(path: Path, wanted: Collection[int], counts: Counter[str]) -> Iterator[_Sent]:
    """Yield the wanted messages of autopilots."""
    try:
        dialect = importlib.import_module("pymavlink.dialects.v20.common")
    except ImportError:
        raise LogError(
            f"{path}: reading telemetry needs the package pymavlink: pip install 'usv-twin[view]'"
        ) from None
    try:
        data = path.read_bytes()
    except OSError as error:
        raise cannot_be_read(path, error) from None
    link = dialect.MAVLink(None)
    for arrived, packet in _packets(path, data, counts):
        newer = packet[0] == 0xFD
        number = int.from_bytes(packet[7:10], "little") if newer else packet[5]
        system, component = packet[5:7] if newer else packet[3:5]
        if component != 1 or number not in wanted:  # a camera sends its attitude, too
            continue
        try:
            message = link.decode(bytearray(packet))
        except Exception:  # a broken packet fails in as many ways as it has bytes
            counts["broken"] += 1
            continue
        yield _Sent(arrived, system, message)


def _packets(path: Path, data: bytes, counts: Counter[str]) -> Iterator[tuple[int, bytes]]:
    """Yield the time of arrival (us since 1970) and the bytes of each packet."""
    at, last, end = 0, 0, len(data)
    while at + 16 <= end:
        arrived = int.from_bytes(data[at : at + 8], "big")
        near = abs(arrived - last) < _DAY if last else _PLAUSIBLE[0] < arrived < _PLAUSIBLE[1]
        mark = data[at + 8]
        if near and mark in (0xFD, 0xFE):
            signed = mark == 0xFD and data[at + 10] & 1
            size = data[at + 9] + (8 if mark == 0xFE else 25 if signed else 12)
            if at + 8 + size > end:
                break
            yield arrived, data[at + 8 : at + 8 + size]
            at, last = at + 8 + size, arrived
            continue
        if not last and at > _SEARCH:
            break
        found = _MARK.search(data, at + 9)
        if found is None:
            break
        counts["lost"] += found.start() - 8 - at
        at = found.start() - 8
    if not last:
        raise LogError(
            f"{path}: is no telemetry log of MAVLink (the time of arrival before each packet); "
            "copy it again, in binary"
        )
    counts["lost"] += end - at


def _take(starts: list[_Start], name: str, message: Any, arrived: float) -> None:
    """Append what a message says to the newest start of its autopilot."""
    now = starts[-1]
    if name == "ATTITUDE":
        boot = message.time_boot_ms * 1e-3
        if boot < now.boot - APART:
            now = _Start()
            starts.append(now)
        now.boot = boot
        tilt = message.roll, message.pitch, message.yaw
        now.add(name, boot, (*tilt, message.rollspeed, message.pitchspeed, message.yawspeed))
        now.epochs.append(arrived - boot)
        return
    if now.boot < 0.0:
        return  # its clock is not known yet
    if name in _RECEIVERS:
        fresh = message.time_usec != now.fix or name != "GPS_RAW_INT"
        if name == "GPS_RAW_INT":
            now.fix = message.time_usec
        if message.fix_type >= 2 and fresh and (message.lat or message.lon):
            known = message.vel != 65535 and message.cog != 65535
            speed = message.vel * 0.01 if known else math.nan
            place = message.lat * 1e-7, message.lon * 1e-7, message.alt * -1e-3
            course = math.radians(message.cog * 0.01)
            velocity = speed * math.cos(course), speed * math.sin(course)
            now.add(name, _stamp(message.time_usec * 1e-6, now), (*place, *velocity))
    elif name == "GLOBAL_POSITION_INT":
        if message.lat or message.lon:
            place = message.lat * 1e-7, message.lon * 1e-7, message.alt * -1e-3
            velocity = message.vx * 0.01, message.vy * 0.01
            now.add(name, _stamp(message.time_boot_ms * 1e-3, now), (*place, *velocity))
    elif name == "SERVO_OUTPUT_RAW":
        if message.port == 0:
            stamp = message.time_usec * 1e-6
            # 32 bits of microseconds wrap every 72 minutes
            stamp += round((now.boot - stamp) * 1e6 / _WRAP) * _WRAP * 1e-6
            widths = tuple(float(getattr(message, f"servo{k}_raw")) for k in range(1, 17))
            now.add(name, _stamp(stamp, now), widths)
    elif name in _IMUS:
        milli = name != "HIGHRES_IMU"
        scale = _GRAVITY * 1e-3 if milli else 1.0
        stamp = message.time_boot_ms * 1e-3 if name == "SCALED_IMU" else message.time_usec * 1e-6
        axes = message.xacc, message.yacc, message.zacc
        flags = 0b111 if milli else message.fields_updated
        force = [v * scale if flags & 1 << k else math.nan for k, v in enumerate(axes)]
        if any(map(math.isfinite, force)):
            now.add(name, _stamp(stamp, now), tuple(force))
    elif name == "SYSTEM_TIME" and message.time_unix_usec:
        now.add(name, now.boot, (message.time_unix_usec * 1e-6 - message.time_boot_ms * 1e-3,))


def _stamp(stamp: float, now: _Start) -> float:
    """Return the sender's stamp, s, or where it is of another clock the newest of ours."""
    return stamp if abs(stamp - now.boot) < APART else now.boot


def _flight(
    path: Path,
    starts: dict[int, list[_Start]],
    parameters: dict[int, dict[str, float]],
    counts: Counter[str],
) -> Flight:
    """Return the longest piece of the autopilot that sent most."""
    lengths = {
        system: max(len(start.t.get("ATTITUDE", ())) for start in pieces)
        for system, pieces in starts.items()
    }
    if not any(lengths.values()):
        raise LogError(
            f"{path}: has no ATTITUDE of an autopilot (component 1), and so no clock and no "
            "heading; stream it while recording"
        )
    system = max(lengths, key=lengths.__getitem__)
    pieces = starts[system]
    start = max(pieces, key=lambda piece: len(piece.t.get("ATTITUDE", ())))
    notes = []
    if len(lengths) > 1:
        notes.append(f"of the systems {', '.join(map(str, sorted(lengths)))}, {system} is read")
    if len(pieces) > 1:
        notes.append(f"the autopilot started {len(pieces)} times; the longest piece is read")
    if counts["broken"] or counts["lost"]:
        notes.append(f"{counts['broken']} broken packet(s) and {counts['lost']} bytes left out")
    fixes = _fixes(start, notes)
    t, attitude = start.of("ATTITUDE")
    names = ("ahrs_roll_rad", "ahrs_pitch_rad", "compass_rad", "gyro_x_radps", "gyro_y_radps")
    columns = dict(zip((*names, "gyro_radps"), attitude.T, strict=True))
    columns = {key: np.where(np.isfinite(v), v, np.nan) for key, v in columns.items()}
    columns["compass_rad"] = np.remainder(columns["compass_rad"], 2.0 * np.pi)
    notes.append("heading, roll, pitch and rates: the autopilot's attitude (ATTITUDE)")
    sensors = [Samples(t, columns)]
    for kind in _IMUS:
        t, force = start.of(kind)
        if len(t):
            axes = ("accel_x_mps2", "accel_y_mps2", "accel_z_mps2")
            force = np.where(np.isfinite(force), force, np.nan)
            sensors.append(Samples(t, dict(zip(axes, force.T, strict=True))))
            notes.append(f"accelerations: {kind}")
            break
    t, servos = start.of("SERVO_OUTPUT_RAW")
    widths = {k + 1: (t, column) for k, column in enumerate(servos.T)} if len(t) else {}
    epochs = start.of("SYSTEM_TIME")[1]
    epoch = float(np.median(epochs if len(epochs) else start.epochs))
    return Flight(fixes, sensors, widths, parameters.get(system, {}), epoch, notes)


def _fixes(start: _Start, notes: list[str]) -> Samples:
    """Return the receiver's fixes; the autopilot's own position where it sent no others."""
    name = max(_RECEIVERS, key=lambda name: len(start.t.get(name, ())))
    t, rows = start.of(name)
    if len(t):
        notes.append(f"position and velocity: the receiver ({name}), not the autopilot's estimate")
    elif not math.isnan(start.fix):
        return Samples(np.zeros(0), {})  # a receiver without a fix: the estimate stands on nothing
    else:
        t, rows = start.of("GLOBAL_POSITION_INT")
        if not len(t):
            return Samples(np.zeros(0), {})
        notes.append(
            "position and velocity: the autopilot's own estimate (GLOBAL_POSITION_INT), as the log "
            "has no GPS_RAW_INT; it goes on when GPS is lost"
        )
    names = ("latitude", "longitude", "gps_z_m", "gps_vx_mps", "gps_vy_mps")
    sound = (np.abs(rows[:, 0]) <= 90.0) & (np.abs(rows[:, 1]) <= 180.0)
    return Samples(t[sound], dict(zip(names, rows[sound].T, strict=True)))
