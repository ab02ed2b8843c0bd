"""Columns of a log out of the blocks of a file.

Only the columns that are asked for are kept. Of a file that is too long, which may be larger than
the memory, only a piece or thinned rows are read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import numpy.typing as npt

from twin.channels import TIME
from twin.logs.clock import wild_stamps
from twin.logs.columns import Array, Entry, notes_of
from twin.logs.dates import Clock, Midnight, lack_zeros, past_midnight, second_hours
from twin.logs.datum import Plane
from twin.logs.errors import LogError
from twin.logs.files import CsvFile
from twin.logs.mapping import Layout
from twin.logs.parquet import ParquetFile

__all__ = [
    "MAX_ROWS",
    "UNIX",
    "Table",
    "date_of",
    "gathered",
    "merged",
    "name_of",
    "said",
    "thinned",
    "too_long",
]

MAX_ROWS = 4_000_000
"""Longest log, rows: 11 hours at 100 Hz, about 2 GB of memory while it is read."""

_PLACE = "\0place"

UNIX = 1e9, 4e9
"""Times between these are seconds since 1970: September 2001 to 2096."""

_SUFFIXES = (".csv", ".parquet", ".mcap", ".db3", ".bag", ".bin", ".BIN", ".tlog", ".nmea")


@dataclass
class Table:
    """Columns of a log as a file gave them, before any check of what they mean."""

    source: str  # file, for messages
    name: str  # of the log
    data: dict[str, Array]  # (N,): columns of the log
    given: dict[str, str]  # what the file calls them
    line: Callable[[int], str]  # returns the place of a row in the file, for messages
    notes: list[str] = field(default_factory=list)  # what was done so far
    # on which positions are measured, where the file has latitude and longitude
    plane: Plane | None = None
    epoch: float | None = None  # time of t = 0, s since 1970, where the file has dates or stamps
    lacking: str = ""  # which columns that each log needs are not there, and the remedy


def name_of(path: Path) -> str:
    """Return the name of a log without the ending of its kind."""
    name = path.name.removesuffix(".gz")
    for suffix in _SUFFIXES:
        if name.endswith(suffix):
            return name.removesuffix(suffix)
    return name


def merged(
    group: npt.NDArray[np.intp], data: Mapping[str, Array], rows: int | None = None
) -> dict[str, Array]:
    """Return one row for each group (N,), 0, 0, 1, ...: the last value in it that is not NaN.

    There are as many rows as groups, or more if ``rows`` says so.
    """
    if rows is None:
        rows = int(group[-1]) + 1 if len(group) else 0
    result = {}
    for key, values in data.items():
        result[key] = np.full(rows, np.nan)
        valid = ~np.isnan(values)
        result[key][group[valid]] = values[valid]  # of equal indices, the last one is kept
    return result


def thinned(t: Array, data: dict[str, Array], layout: Layout) -> dict[str, Array]:
    """Return the rows that a layout asks for, of columns at the times t."""
    if layout.start > -math.inf or layout.stop < math.inf:
        # a row without a time is kept, to be reported
        keep = ~((t < layout.start) | (t >= layout.stop))
        t, data = t[keep], {key: values[keep] for key, values in data.items()}
    # a time that stands still, goes back or is missing is kept, to be reported
    if layout.step > 0.0 and len(t) > 1 and (np.diff(t) > 0.0).all():
        cell = np.floor(t / layout.step + 1e-9)
        data = merged(np.cumsum(np.diff(cell, prepend=cell[0]) > 0.0), data)
    return data


def said(layout: Layout, before: int, after: int) -> list[str]:
    """Return the note on rows that a layout left out or merged."""
    if before == after:
        return []
    return [f"{before - after} of {before} rows left out or merged: [rows] of {layout.source}"]


def too_long(source: str) -> LogError:
    """Return the error of a log of too many rows."""
    return LogError(
        f"{source}: has more than {MAX_ROWS:,} rows, the most that a log may have. Read a piece "
        "with start_s and stop_s, or fewer rows with step_s = 0.1, in [rows] of a mapping file "
        "(--mapping FILE)"
    )


def date_of(epoch: float) -> str:
    """Return a time since 1970, s, as a date and time."""
    # datetime knows the years 1 to 9999
    date = datetime(1970, 1, 1) + timedelta(seconds=min(max(epoch, -6e10), 2.5e11))
    return f"{date:%Y-%m-%d %H:%M:%S} UTC"


def _epoch_of_offset(timed: Entry, raw: Mapping[str, Array]) -> float:
    """Return the date, s since 1970, that an offset takes from Unix times; NaN if it does not."""
    if len(timed.sources) != 1:
        return math.nan
    name = timed.sources[0]
    offset, late, first = (
        float(_only(timed, {name: np.array([x])})[0]) for x in (0.0, 1e3, float(raw[name][0]))
    )
    # days of a spreadsheet are of the same size in seconds, but count from another year
    unix = offset < 0.0 and UNIX[0] <= first - offset < UNIX[1] and late - offset < 2e3
    return -offset if unix and abs(first) < 366.0 * 86400.0 else math.nan


def gathered(file: CsvFile | ParquetFile, entries: Sequence[Entry], layout: Layout) -> Table:
    """Return the log's columns that entries, one of which gives the time, make of a file.

    LogError: a cell is no number or the log is too long.
    """
    sources = list(dict.fromkeys(source for entry in entries for source in entry.sources))
    timed = next(entry for entry in entries if TIME in entry.names)
    clock = Clock.of(timed)
    parts: list[dict[str, Array]] = []
    rows = read = void = 0
    epoch, dated_file = math.nan, False
    midnight = Midnight()
    for lines, raw, dated in file.blocks(sources, clock):
        # Blank lines (often the last) arrive as rows without any value.
        blank = np.all([np.isnan(values) for values in raw.values()], axis=0)
        void += int(blank.sum())
        data = {key: values[~blank] for key, values in {**raw, _PLACE: lines}.items()}
        read += len(data[_PLACE])
        for name in dated - set(timed.sources):
            raise LogError(f"{file.source}: column {name} holds dates, not numbers; convert it")
        if dated and clock.undated:
            data[timed.sources[0]] = past_midnight(data[timed.sources[0]], midnight)
        dated_file |= bool(dated)
        if dated and len(data[_PLACE]):
            epoch = float(data[timed.sources[0]][0]) if epoch != epoch else epoch
            data[timed.sources[0]] = data[timed.sources[0]] - epoch
        parts.append(thinned(_only(timed, data), data, layout))
        rows += len(parts[-1][_PLACE])
        if rows > MAX_ROWS:
            raise too_long(file.source)
    raw = {key: np.concatenate([part[key] for part in parts]) for key in (*sources, _PLACE)}
    parts.clear()
    if layout.step > 0.0:
        raw = thinned(_only(timed, raw), raw, layout)
    either = False
    if epoch == epoch:  # the first row may come before the clock was set
        clocked = raw[timed.sources[0]]
        known = np.flatnonzero(np.isfinite(clocked) & ~wild_stamps(clocked))
        begin = float(clocked[known[0]]) if len(known) else 0.0
        later, either = second_hours(epoch + clocked, clock.zone)
        begin += float(later[known[0]]) if len(known) else 0.0
        epoch, raw[timed.sources[0]] = epoch + begin, clocked + later - begin
    clocked = _only(timed, raw)
    back = np.diff(clocked[~wild_stamps(clocked)]) < 0.0
    if isinstance(file, CsvFile) and not file.zeros and back.any():
        file.zeros = timed.sources[0]
        again = gathered(file, entries, layout)
        if lack_zeros(clocked, again.data[TIME]):
            again.notes.append(
                f"t_s: time goes back {back.sum()} times unless the fractions "
                f"of {file.zeros} lack zeros in front (.5 for .005); read so"
            )
            return again
        file.zeros = ""
    place = raw.pop(_PLACE)
    notes = [f"{void} row(s) without a single value left out"] if void else []
    if isinstance(file, CsvFile) and file.torn:
        notes.append("the last line is cut off, and left out")
    notes += said(layout, read, len(place))
    if epoch == epoch and clock.undated:
        notes.append(f"t_s: counted from {date_of(epoch % 86400.0)[11:19]}, the log keeps no date")
        epoch = math.nan
    elif len(place) and not dated_file:
        epoch = _epoch_of_offset(timed, raw)
    if epoch == epoch:
        notes.append(f"t_s: counted from {date_of(epoch)}")
    if either and "%Z" not in clock.format:
        notes.append(
            f"t_s: clocks in {clock.zone} show this hour twice, as they are set back: taken for "
            "the first one; for the second, give the zone as hours from UTC"
        )
    if midnight.days:
        notes.append("t_s: passes midnight without a date, and goes on")
    data = {}
    plane = None
    for entry in entries:
        values = [raw[source] for source in entry.sources]
        for source, marks in entry.pulses:
            none = np.isin(raw[source], marks)
            if none.any():
                numbers = ", ".join(f"{mark:g}" for mark in np.unique(raw[source][none]))
                notes.append(
                    f"{source}: {none.sum()} of {len(place)} pulses are {numbers} us wide, as "
                    f"where there is no signal; taken as empty: empty = [{numbers}] in the mapping"
                )
        made = entry.columns(values)
        if entry.plane is not None:
            plane = entry.plane(values)
            none = np.isnan(made["gps_x_m"]) & np.isfinite(values[0] + values[1])
            if none.any():
                one, other = values[0][none][0], values[1][none][0]
                notes.append(
                    f"{' and '.join(entry.sources)}: {none.sum()} of {len(place)} positions are "
                    f"({one:g}, {other:g}), as of a receiver without a fix, taken as empty"
                )
        data.update({key: np.broadcast_to(value, place.shape) for key, value in made.items()})
    given = {name: " and ".join(entry.sources) for entry in entries for name in entry.names}
    notes += notes_of(entries)

    def line(row: int) -> str:
        return f"{file.unit} {int(place[row])}"

    date = None if math.isnan(epoch) else epoch
    return Table(file.source, name_of(Path(file.source)), data, given, line, notes, plane, date)


def _only(timed: Entry, data: Mapping[str, Array]) -> Array:
    return timed.columns([data[timed.sources[0]]])[TIME]
