"""A recorded run: measurements and commands as read from a file, checked and repaired.

A log is all that a twin may see. Missing data is normal in it and stays missing (NaN). What cannot
be used is refused with the place and the remedy. Repairs are counted in :attr:`Log.notes`.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import gzip
import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin.channels import (
    COMMANDS,
    MEASUREMENTS,
    MOTION_AT,
    MOTION_END,
    TIME,
    TRUE_MOTION,
    TRUTH,
    WIND_SPEED,
)
from twin.files import write_csv
from twin.logs.autopilot.readers import is_autopilot_log, read_autopilot_log
from twin.logs.bag_writer import BAG_SUFFIX, write_bag
from twin.logs.checks import (
    check_drive,
    check_measurement,
    check_turning,
    checked_time,
    drop_jumps,
    drop_repeats,
    held_command,
    stream_end,
)
from twin.logs.clock import spread, wild_stamps
from twin.logs.columns import OTHER_UNITS, REQUIRED, SINGLE, Array, Entry
from twin.logs.datum import DATUM, FIXES, Datum, Plane
from twin.logs.errors import LogError
from twin.logs.files import CsvFile, shorten, twice_said
from twin.logs.mapping import Layout, layout_of, mapping_path
from twin.logs.marks import HEADINGS, marks_of
from twin.logs.parquet import ParquetFile, column_file, need_polars, write_parquet
from twin.logs.readers import UNIX, Table, date_of, gathered, name_of
from twin.logs.recording import equal_times
from twin.logs.rosbag import is_bag, read_bag
from twin.logs.wire.nmea_log import is_nmea_log, read_nmea_log
from usv_kernel.files import replacing

__all__ = [
    "LOG_SUFFIXES",
    "Log",
    "merged_notes",
    "recorded_runs",
]

LOG_SUFFIXES = (".csv", ".csv.gz", ".parquet", BAG_SUFFIX)
"""What the name of a log that is written ends in."""

_KNOWN = (TIME, *COMMANDS, *MEASUREMENTS, *TRUTH, *TRUE_MOTION, *SINGLE, *OTHER_UNITS, *DATUM)

RARE = (
    slice(WIND_SPEED, MOTION_AT),
    slice(MOTION_AT, MOTION_END),
    slice(MOTION_END, len(MEASUREMENTS)),
)
"""Columns that few logs have, of the true wind, of roll, pitch and heave, and of the apparent wind:
where a log has none of a group, nothing is missing."""


@dataclass(frozen=True, eq=False)
class Log:
    """A recorded or simulated run of N rows.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Time, s, strictly increasing.
    z : ndarray, shape (N, 19)
        Measurements in the order of :data:`MEASUREMENTS`; NaN where a sensor gave no new
        sample. Heading and wind direction may be wrapped or run on beyond a turn: whoever
        compares one with another angle wraps the difference. The last two columns, of the apparent
        wind, may be left out, and so may the seven of roll, pitch and heave before them.
    cmd : ndarray, shape (N, 4)
        Commands in the order of :data:`COMMANDS`, each in force during the interval that
        ends at the row's time.
    truth : ndarray, shape (N, 6), or None
        True state in the order of :data:`TRUTH`, where it is known; NaN where it is not.
    name : str
        For tables and pictures.
    notes : tuple of str
        What was missing, converted or repaired when the log was read.
    datum : Datum or None
        Latitude, longitude and date of its origin, where they are known.
    true_motion : ndarray, shape (N, 6), or None
        True heave, roll and pitch in the order of :data:`TRUE_MOTION`, where they are known.
    commands_end : float
        Time at which the stream of commands stops, s; infinite where it lasts as long as the log.
    """

    t: Array
    z: Array
    cmd: Array
    truth: Array | None = None
    name: str = "log"
    notes: tuple[str, ...] = ()
    datum: Datum | None = None
    true_motion: Array | None = None
    commands_end: float = math.inf

    def __post_init__(self) -> None:
        """Refuse arrays of a wrong shape, of infinite values, or of a time that stands still."""
        shapes = {"t": (), "z": (len(MEASUREMENTS),), "cmd": (len(COMMANDS),)}
        if self.truth is not None:
            shapes["truth"] = (len(TRUTH),)
        if self.true_motion is not None:
            shapes["true_motion"] = (len(TRUE_MOTION),)
        rows = np.shape(self.t)[0] if np.ndim(self.t) == 1 else -1
        if np.shape(self.z) in ((rows, MOTION_AT), (rows, MOTION_END)):
            unknown = np.full((rows, len(MEASUREMENTS) - np.shape(self.z)[1]), np.nan)
            object.__setattr__(self, "z", np.hstack([self.z, unknown]))
        for key, tail in shapes.items():
            value = np.ascontiguousarray(getattr(self, key), dtype=np.float64)
            if value.shape != (rows, *tail):
                wanted = ", ".join(["N", *map(str, tail)]) + ("" if tail else ",")
                raise LogError(
                    f"{self.name}: {key} has the shape {value.shape}, expected ({wanted}) with "
                    "the same N for t, z, cmd and truth"
                )
            if np.isinf(value).any() or (key in ("t", "cmd") and np.isnan(value).any()):
                allowed = "finite" if key in ("t", "cmd") else "finite, or NaN for no sample"
                raise LogError(f"{self.name}: every value of {key} must be {allowed}")
            object.__setattr__(self, key, value)
        if (np.diff(self.t) <= 0.0).any():
            row = int(np.argmax(np.diff(self.t) <= 0.0)) + 1
            raise LogError(f"{self.name}: t must increase, but t[{row}] <= t[{row - 1}]")
        object.__setattr__(self, "notes", tuple(self.notes))

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.t)

    def __repr__(self) -> str:
        """Return name, rows and length."""
        span = float(self.t[-1] - self.t[0]) if len(self) else 0.0
        return f"Log({self.name}, {len(self)} rows, {span:.1f} s)"

    def __iter__(self) -> Iterator[tuple[float, Array, Array]]:
        """Yield ``(t, z, cmd)`` of each row, as a twin would meet them on board."""
        return zip(self.t.tolist(), self.z, self.cmd, strict=True)

    @functools.cached_property
    def dt(self) -> float:
        """Median step of the time, s."""
        if len(self) < 2:
            raise LogError(f"{self.name}: a time step needs two rows, the log has {len(self)}")
        return float(np.median(np.diff(self.t)))

    def slice(self, t0: float = -math.inf, t1: float = math.inf) -> Log:
        """Return the rows with ``t0 <= t < t1``.

        Parameters
        ----------
        t0, t1 : float
            Start and end, s. Neighbouring slices share no row.

        Returns
        -------
        Log
            With the arrays shared, not copied; may be empty.
        """
        first, last = np.searchsorted(self.t, (t0, t1))
        rows = slice(int(first), max(int(first), int(last)))
        return dataclasses.replace(
            self,
            t=self.t[rows],
            z=self.z[rows],
            cmd=self.cmd[rows],
            truth=None if self.truth is None else self.truth[rows],
            true_motion=None if self.true_motion is None else self.true_motion[rows],
        )

    def without_truth(self) -> Log:
        """Return the same run as the boat itself would have recorded it."""
        return dataclasses.replace(self, truth=None, true_motion=None)

    def write(self, path: str | Path) -> None:
        """Write the log as CSV, compressed if the name ends in ``.gz``, ``.parquet`` or ``.mcap``.

        Parameters
        ----------
        path : str or Path
            File to create or replace.

        Notes
        -----
        NaN becomes an empty cell; each number is written with the digits that give the
        same float64 back. The datum stands in columns of one value each. :meth:`read` returns the
        same arrays, save for what it would repair or refuse in any file (repeated fixes, a column
        that never changes). MCAP is for programs of ROS and Foxglove: it has no exact times, and
        its truth is not read back.
        """
        if Path(path).suffix == BAG_SUFFIX:
            write_bag(path, self)
            return
        columns = {TIME: self.t}
        columns.update(zip(COMMANDS, self.cmd.T, strict=True))
        columns.update(zip(MEASUREMENTS[:WIND_SPEED], self.z.T, strict=False))
        for part in RARE:
            if np.isfinite(self.z[:, part]).any():
                columns.update(zip(MEASUREMENTS[part], self.z[:, part].T, strict=True))
        if self.truth is not None:
            columns.update(zip(TRUTH, self.truth.T, strict=True))
        if self.true_motion is not None:
            columns.update(zip(TRUE_MOTION, self.true_motion.T, strict=True))
        if self.datum is not None:
            columns.update(self.datum.columns(len(self)))
        if Path(path).suffix == ".parquet":
            write_parquet(path, need_polars(f"{path}: writing Parquet").DataFrame(columns))
            return
        with replacing(path) as partial, partial.open("wb") as raw:
            if partial.suffix == ".gz":
                # No time stamp and no name inside: equal logs give equal files.
                with gzip.GzipFile("", "wb", fileobj=raw, mtime=0) as file:
                    write_csv(file, columns)
            else:
                write_csv(raw, columns)

    @classmethod
    def read(cls, path: str | Path, mapping: str | Path | None = None) -> Log:
        """Read a log: CSV, Parquet, a bag of ROS, NMEA sentences or an autopilot's log.

        Parameters
        ----------
        path : str or Path
            CSV, plain or gzipped, with a header of column names, in any order; or
            ``.parquet`` with the same columns; or a bag: a folder with ``metadata.yaml``, or
            a file ``.mcap`` or ``.db3``; or a log of ArduPilot, ``.BIN`` or ``.tlog``, whose
            messages are known. Required of the others: ``t_s``, the :data:`COMMANDS`,
            ``gps_x_m``, ``gps_y_m`` and ``compass_rad``. The other :data:`MEASUREMENTS` may
            be absent (never measured), and so may the :data:`TRUTH` and :data:`TRUE_MOTION`.
            ``n_rps`` and ``delta_rad`` are those of a ship with one propeller, one rudder, and
            stand for both sides. Degrees and rpm are converted where the name says so:
            ``delta_left_deg``, ``compass_deg``, ``gyro_degps``, ``n_left_rpm`` and so on
            instead of the SI column. Any other column is left out, with a note.
        mapping : str or Path, optional
            TOML file that says which column or message is which column of the log: see
            ``twin/logs/mapping.py`` and ``twin/logs/mappings/ros2_example.toml``. Left out:
            ``<log>.mapping.toml`` next to the log, if there is one. A bag needs one. Or the name of
            one that ships or that another package adds.

        Returns
        -------
        Log
            ``notes`` says what was missing, converted or repaired.

        Raises
        ------
        LogError
            Names the file, the column, the line and the remedy.

        Notes
        -----
        Repairs, each counted in ``notes``:

        - An empty cell (or NaN, NA, null) of a measurement is missing data.
        - A fix bit-equal to the last one is no new sample: the receiver is slower than the log. It
          becomes NaN, and its velocity too if that repeats as well. So does a repeated compass
          value.
        - Fixes that no boat can reach from the others (a jump of 500 m and back) become NaN.
        - Rows whose stamps no clock that was set gives are left out.
        - A step of time above 5 times the median is a gap: missing data.
        - Rows of equal time that do not contradict each other become one.
        - An empty command holds the last one.
        - Blank lines are left out.
        """
        table = read_table(path, mapping)
        if table.lacking:
            raise LogError(table.lacking)
        return assemble(table)


def read_table(path: str | Path, mapping: str | Path | None = None) -> Table:
    """Return the columns of a log as its file has them, before any check or repair.

    Parameters
    ----------
    path, mapping
        As for :meth:`Log.read`.

    Raises
    ------
    LogError
        Where the file cannot be read, or has no time. Other columns may be missing:
        ``lacking`` says which.
    """
    path = Path(path)
    mapping = mapping_of(path, mapping)
    layout = None if mapping is None else Layout.load(mapping)
    if is_autopilot_log(path):
        return read_autopilot_log(path, layout)
    if layout is not None and layout.servos:
        raise LogError(f"{layout.source}: [servos] is for logs of an autopilot; remove the table")
    if is_bag(path):
        table = read_bag(path, layout)
        table.lacking = _lacking(table.source, table.data, "name them in the mapping")
        return table
    if is_nmea_log(path):
        table = read_nmea_log(path, layout)
        constants = (
            "positions come of GGA, RMC, GNS, GLL, headings of HDT, HDG, HDM, THS, VHW, PASHR; of "
            "commands give constants, such as n_rps = 0.0, in "
            f"{sibling_path(path, '.mapping.toml')}"
        )
        table.lacking = _lacking(table.source, table.data, constants)
        return table
    file = column_file(path)
    entries, left, layout, lacking = _chosen(file, layout)
    if not any(TIME in entry.names for entry in entries):
        raise LogError(lacking)
    table = gathered(file, entries, layout)
    table.notes += left
    table.lacking = lacking
    return table


def sibling_path(path: str | Path, suffix: str) -> Path:
    """Return the path next to a log with another ending, such as ``.toml`` or ``.png``."""
    path = Path(path)
    return path.parent / (name_of(path) + suffix)


def mapping_of(path: Path, mapping: str | Path | None = None) -> Path | None:
    """Return the mapping file of a log: the one that is given, else the one next to it, if any."""
    if mapping is not None:
        return mapping_path(mapping)
    found = sibling_path(path, ".mapping.toml")
    return found if found.exists() else None


def files_of(path: str | Path, mapping: str | Path | None = None) -> list[Path]:
    """Return the files that :meth:`Log.read` reads: the log or those of its bag, the mapping."""
    path = Path(path)
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    found = mapping_of(path, mapping)
    return [file for file in (*files, *([found] if found else [])) if file.is_file()]


def recorded_runs() -> dict[str, Path]:
    """Return the recorded runs that ship with the package.

    Returns
    -------
    dict of str to Path
        Name and log file; the particulars of the boat lie next to each log, in
        ``<name>.toml``.
    """
    folder = Path(__file__).with_name("recorded")
    return {path.name.removesuffix(".csv.gz"): path for path in sorted(folder.glob("*.csv.gz"))}


def _lacking(source: str, names: Collection[str], remedy: str) -> str:
    """Return which columns that each log needs a table has not, and the remedy; empty if none."""
    missing = [name for name in REQUIRED if name not in names]
    return f"{source}: column(s) {', '.join(missing)} missing; {remedy}" if missing else ""


def _chosen(
    file: CsvFile | ParquetFile, layout: Layout | None
) -> tuple[list[Entry], list[str], Layout, str]:
    """Return how to make a log of a file's columns, what is left out, the mapping, what lacks."""
    source, header = file.source, file.header
    mapped_here = layout is not None and bool(layout.entries)
    if layout is None and not {"gps_x_m", "gps_y_m"} <= set(header):
        layout = layout_of(name_of(file.path), header)
    layout = layout or Layout()
    there = f"({file.head} has: {shorten(', '.join(header), 200)})"
    for entry in layout.entries:
        if entry.topic:
            raise LogError(
                f"{layout.source}: {entry.names[0]}: a file of columns needs from =, not topic ="
            )
        for name in set(entry.sources) - set(header):
            near = difflib.get_close_matches(name, header, n=1)
            raise LogError(
                f"{source}: has no column {name!r}, which {layout.source} asks for; "
                + (f"did you mean {near[0]}? " if near else "correct the mapping ")
                + there
            )
    mapped = {name for entry in layout.entries for name in entry.names}
    used = {name for entry in layout.entries for name in entry.sources}
    entries, made = list(layout.entries), dict.fromkeys(mapped, layout.source)
    for given in header:
        name, factor = OTHER_UNITS.get(given, (given, 1.0))
        names = SINGLE.get(name, (name,))
        if given not in _KNOWN or given in used or mapped & set(names):
            continue
        for each in names:
            if each in made:
                raise LogError(
                    f"{source}: columns {made[each]} and {given} both give {each}; remove one of "
                    "them"
                )
        entries.append(_own(given, name, names, factor))
        made.update(dict.fromkeys(names, given))
        used.add(given)
    for given in used:
        if header.count(given) > 1:
            raise LogError(twice_said(source, given, file.head))
    left = [given for given in header if given not in used]
    remedy = f"add them, or name them in {layout.source if mapped_here else 'a mapping file'}"
    if not mapped_here:
        remedy += f" (usv-twin mapping {source} proposes one)"
    if not any(name in made for name in SINGLE["delta_rad"]):
        remedy += "; for fixed thrusters write delta_rad = 0.0 in its [columns]"
    lacking = _lacking(source, made, f"{remedy} {there}")
    what = f"not in {layout.source}" if layout.entries else "unknown, left out"
    unused = f"{len(left)} column(s) {what}: {', '.join(given or '(no name)' for given in left)}"
    return entries, [unused] if left else [], layout, lacking


def _own(given: str, name: str, names: tuple[str, ...], factor: float) -> Entry:
    """Return the entry of a column under a name of ours."""
    note = f"{given}: converted to {name}" if given != name else ""
    if len(names) > 1:
        note = f"{given}: one for both sides, {' and '.join(names)}"
    if factor == 1.0:
        return Entry(names, (given,), note=note)
    return Entry(names, (given,), lambda values: [values[0] * factor] * len(names), note=note)


def assemble(table: Table) -> Log:
    """Check and repair the columns of a table and make a log of them.

    Parameters
    ----------
    table : Table
        From :func:`read_table`; its ``notes`` grow.

    Raises
    ------
    LogError
        Where they cannot be used.
    """
    notes = table.notes
    _leave_out_wild(table)
    _merge_equal_times(table)
    names = table.data

    def column(name: str) -> Array:
        values = np.array(table.data[name], dtype=np.float64)
        if np.isinf(values).any():
            row = int(np.argmax(np.isinf(values)))
            raise LogError(
                f"{table.source}: column {table.given[name]}, {table.line(row)}: the value is "
                "infinite; leave the cell empty where there is no value"
            )
        return values

    t = checked_time(column(TIME), table)
    rows = len(t)
    cmd = np.empty((rows, len(COMMANDS)))
    commands_end = stream_end(t, np.stack([column(name) for name in COMMANDS]), notes)
    for j, name in enumerate(COMMANDS):
        cmd[:, j] = held_command(column(name), table.given[name], table)
        if name.endswith("_rad"):
            check_drive(cmd[:, j], name, table)

    z = np.full((rows, len(MEASUREMENTS)), np.nan)
    expected: tuple[str, ...] = MEASUREMENTS[:WIND_SPEED]
    for part in RARE:
        if any(name in names for name in MEASUREMENTS[part]):
            expected = (*expected, *MEASUREMENTS[part])
    never = [name for name in expected if name not in names]
    if never:
        notes.append(f"{', '.join(never)}: not in the file, taken as never measured")
    for j, name in enumerate(MEASUREMENTS):
        if name in names:
            z[:, j] = column(name)
            if name in HEADINGS and (marks := marks_of(z[:, j], 2.0 * math.pi)):
                none = np.isin(z[:, j], marks)
                z[none, j] = np.nan
                numbers = ", ".join(f"{mark:g}" for mark in np.degrees(marks))
                notes.append(
                    f"{table.given[name]}: {none.sum()} of {rows} values are marks for none "
                    f"({numbers} degrees), taken as empty"
                )
            check_measurement(t, z[:, j], name, table)
    drop_repeats(t, z, table)
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # these may be any numbers: no check of jumps and turning
        drop_jumps(t, z, table)
        check_turning(t, z, table)

    truth = None
    if any(name in names for name in TRUTH):
        truth = np.full((rows, len(TRUTH)), np.nan)
        for j, name in enumerate(TRUTH):
            if name in names:
                truth[:, j] = column(name)
        absent = [name for name in TRUTH if name not in names]
        if absent:
            notes.append(f"{', '.join(absent)}: not in the file, this part of the truth is unknown")
    motion_truth = None
    if any(name in names for name in TRUE_MOTION):
        unknown = np.full(rows, np.nan)
        motion_truth = np.stack(
            [column(name) if name in names else unknown for name in TRUE_MOTION], axis=1
        )
    datum = Datum.from_columns(names, table.source)
    if table.epoch is None and UNIX[0] <= t[0] < UNIX[1]:
        table.epoch = 0.0
        notes.append(f"t_s: seconds since 1970, from {date_of(float(t[0]))}")
    given = datum or Datum()
    plane = given.plane or table.plane
    if plane is None and all(name in names for name in FIXES):
        fixes = names[FIXES[0]], names[FIXES[1]]
        plane = Plane.through(fixes, (z[:, 0], z[:, 1]), table.source)
    if plane is not None or table.epoch is not None or datum is not None:
        epoch = table.epoch if given.epoch is None else given.epoch
        datum = Datum(**({} if plane is None else vars(plane)), epoch=epoch)
    said = tuple(merged_notes(notes))
    return Log(t, z, cmd, truth, table.name, said, datum, motion_truth, commands_end)


def merged_notes(notes: Sequence[str]) -> list[str]:
    """Return notes; those that say the same of several columns are one."""
    columns: dict[str, dict[str, None]] = {}
    for note in notes:
        name, _, what = note.rpartition(": ") if note.count(": ") == 1 else ("", "", note)
        columns.setdefault(what, {})[name] = None
    return [", ".join(names) + ": " * any(names) + what for what, names in columns.items()]


def _leave_out_wild(table: Table) -> None:
    """Leave out rows whose stamps are no times of the log."""
    wild = wild_stamps(table.data[TIME])
    if not wild.any():
        return
    rows, line = np.flatnonzero(~wild), table.line
    first = int(np.argmax(wild))
    table.notes.append(
        f"t_s: {wild.sum()} of {len(wild)} rows left out, for their stamps are far from all others "
        f"({line(first)}: {table.data[TIME][first]:.10g} s): the clock was not set there"
    )
    table.data = {name: values[rows] for name, values in table.data.items()}
    table.line = lambda row: line(int(rows[row]))


def _merge_equal_times(table: Table) -> None:
    """Merge rows of equal time; where their values differ, spread them if they are few."""
    found = equal_times(table.data)
    if found is None:
        return
    if found.clashes:
        apart = spread(table.data[TIME])
        if apart is not None:
            table.notes.append(
                f"t_s: {len(apart) - len(found.first)} of {len(apart)} rows have the time of the "
                "row before and other values, spread over the time that the clock counts by"
            )
            table.data = {**table.data, TIME: apart}
        return
    many, line = len(table.data[TIME]), table.line
    rows = np.append(found.first, many)
    table.notes.append(
        f"t_s: {many - len(rows) + 1} of {many} rows have the time of the row before and do "
        "not contradict it, merged with it"
    )
    table.data, table.line = found.data, lambda row: line(int(rows[row]))
