"""What an autopilot recorded, as columns of a log."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from twin.channels import COMMANDS, TIME
from twin.logs.autopilot.outputs import Outputs
from twin.logs.columns import Array
from twin.logs.datum import Plane
from twin.logs.errors import LogError
from twin.logs.mapping import Layout
from twin.logs.readers import MAX_ROWS, Table, date_of, merged, name_of, said, thinned, too_long
from twin.logs.rosbag import commanded

__all__ = [
    "Flight",
    "Samples",
    "steady_times",
    "table_of",
]

ROW = 0.01
"""Samples of one pass of the autopilot's loop come within this time of each other, s."""

APART = 5.0
"""A sample this far in time from its neighbours has a damaged stamp, s."""

_FAR = 1e5
"""Largest distance of a fix from the middle one, m."""


class Samples(NamedTuple):
    """Times (n,), s since the autopilot started, and columns (n,) by name."""

    t: Array
    columns: dict[str, Array]


@dataclass
class Flight:
    """What an autopilot recorded."""

    fixes: Samples  # latitude, longitude (degrees) and the columns of the receiver
    sensors: list[Samples]  # attitude and IMU
    widths: dict[int, tuple[Array, Array]]  # times and pulse widths (us) of each servo output
    parameters: dict[str, float]
    epoch: float | None = None  # time at which the autopilot started, s since 1970
    notes: list[str] = field(default_factory=list)


def steady_times(t: Array) -> np.ndarray:
    """Return which stamps (n,) are no outliers among their neighbours, as in damaged messages."""
    if len(t) < 3:
        return np.isfinite(t)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(t, 2, mode="reflect"), 5)
    return np.abs(t - np.median(around, axis=1)) < APART


def table_of(path: Path, flight: Flight, layout: Layout | None) -> Table:
    """Return the columns of a log from what an autopilot recorded.

    Raises
    ------
    LogError
        Where there is no fix or no command, or the mapping has more than [rows] and [servos].
    """
    layout = layout or Layout()
    if layout.entries:
        raise LogError(
            f"{layout.source}: {layout.entries[0].names[0]}: the messages of {path} are known; a "
            "mapping of such a log has only [rows] and [servos]"
        )
    outputs = Outputs.of(flight.parameters, layout.servos, str(path))
    _check(path, flight, outputs)
    notes = [*flight.notes, *outputs.notes]
    fixes = _near(flight.fixes, notes)
    columns = dict(fixes.columns)
    latitude, longitude = columns.pop("latitude"), columns.pop("longitude")
    plane = Plane(float(latitude[0]), float(longitude[0]))
    north, east = plane.metres(latitude, longitude)
    columns |= {"gps_x_m": north, "gps_y_m": east}
    commands = [Samples(*pair) for pair in outputs.commands(flight.widths)]
    parts = [Samples(fixes.t, columns), *flight.sensors, *commands]
    data = _united(parts)
    if len(data[TIME]) > MAX_ROWS:
        raise too_long(str(path))
    begin = float(data[TIME][0])
    data[TIME] = data[TIME] - begin
    epoch = None if flight.epoch is None else flight.epoch + begin
    if epoch is not None:
        notes.append(f"t_s: counted from {date_of(epoch)}")
    data = commanded(data, notes)
    before = len(data[TIME])
    data = thinned(data[TIME], data, layout)
    notes += said(layout, before, len(data[TIME]))
    t = data[TIME]
    given = {name: name for name in data} | outputs.names

    def place(row: int) -> str:
        return f"t = {t[row]:.6g} s"

    return Table(str(path), name_of(path), data, given, place, notes, plane, epoch)


def _check(path: Path, flight: Flight, outputs: Outputs) -> None:
    """Refuse a recording without fixes, heading or commands."""
    if not len(flight.fixes.t):
        raise LogError(
            f"{path}: its GPS receiver never had a fix, and the autopilot's own position is no "
            "measurement; record outdoors, with GPS among the messages"
        )
    if not any("compass_rad" in part.columns and len(part.t) for part in flight.sensors):
        raise LogError(f"{path}: has no attitude, and so no heading; log or stream ATTITUDE (ATT)")
    for number in outputs.numbers:
        if not len(flight.widths.get(number, ((),))[0]):
            raise LogError(
                f"{path}: has no pulse widths of servo output {number}; log RCOU (LOG_BITMASK), or "
                "stream SERVO_OUTPUT_RAW"
            )


def _near(fixes: Samples, notes: list[str]) -> Samples:
    """Return the fixes that are not a hundred kilometres off the others."""
    latitude, longitude = fixes.columns["latitude"], fixes.columns["longitude"]
    middle = Plane(float(np.median(latitude)), float(np.median(longitude)))
    near = np.hypot(*middle.metres(latitude, longitude)) < _FAR
    if near.all() or not near.any():
        return fixes
    notes.append(
        f"{int((~near).sum())} fix(es) more than {_FAR / 1e3:g} km off the others left out"
    )
    return Samples(fixes.t[near], {name: v[near] for name, v in fixes.columns.items()})


def _united(parts: list[Samples]) -> dict[str, Array]:
    """Return the rows of all samples; those of one pass of the autopilot's loop become one."""
    stamps = np.unique(np.concatenate([part.t for part in parts]))
    group, begin, row = np.empty(len(stamps), dtype=np.intp), -np.inf, -1
    for k, t in enumerate(stamps.tolist()):
        if t - begin >= ROW:
            row, begin = row + 1, t
        group[k] = row
    data: dict[str, Array] = {TIME: merged(group, {TIME: stamps})[TIME]}
    for part in parts:
        rows = group[np.searchsorted(stamps, part.t)]
        data |= merged(rows, part.columns, len(data[TIME]))
    return {name: data[name] for name in (TIME, *COMMANDS, *data) if name in data}
