"""A recorded run: measurements and commands as read from a file, checked and repaired.

A log is all that a twin may see. Missing data is normal in it and stays missing (NaN);
what cannot be used is refused with the place and the remedy; what was repaired on the way
is counted in :attr:`Log.notes`.
"""

from __future__ import annotations

import dataclasses
import difflib
import gzip
import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from twin.channels import COMMANDS, MEASUREMENTS, TIME, TRUTH
from twin.logs.columns import OTHER_UNITS, REQUIRED, SINGLE, Array, Entry, LogError
from twin.logs.mapping import Layout, layout_of
from twin.logs.readers import CsvFile, ParquetFile, Table, gathered, merged, name_of, shorten
from twin.logs.rosbag import is_bag, read_bag

__all__ = [
    "Log",
    "recorded_runs",
]

_KNOWN = (TIME, *COMMANDS, *MEASUREMENTS, *TRUTH, *SINGLE, *OTHER_UNITS)

# Names that other projects use, and that no spelling distance would find.
_ALIASES = {
    "t": TIME,
    "time": TIME,
    "time_s": TIME,
    "timestamp": TIME,
    "x_m": "gps_x_m",
    "y_m": "gps_y_m",
    "heading": "compass_rad",
    "psi_rad": "compass_rad",
    "heading_rad": "compass_rad",
    "psi_deg": "compass_deg",
    "heading_deg": "compass_deg",
    "r_radps": "gyro_radps",
    "wind_speed": "wind_mps",
    "wind_speed_mps": "wind_mps",
    "tws_mps": "wind_mps",
    "wind_direction": "wind_from_rad",
    "wind_direction_rad": "wind_from_rad",
    "wind_dir_rad": "wind_from_rad",
    "twd_rad": "wind_from_rad",
    "wind_direction_deg": "wind_from_deg",
    "wind_dir_deg": "wind_from_deg",
    "twd_deg": "wind_from_deg",
}

_CONSTANT_ROWS = 20

_GAP_STEPS = 5.0

_WHOLE_TURN = 0.35

_JUMP, _FAST = 50.0, 30.0
"""Between two fixes no boat goes farther than this, m, and this fast, m/s (58 knots)."""

_LOST = 0.1
"""More than this share of the fixes is no slip of a receiver."""

_PIECES = 1000


@dataclass(frozen=True, eq=False)
class Log:
    """A recorded or simulated run of N rows.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Time, s, strictly increasing.
    z : ndarray, shape (N, 10)
        Measurements in the order of :data:`MEASUREMENTS`; NaN where a sensor gave no new
        sample. Heading and wind direction may be wrapped or run on beyond a turn: whoever
        compares one with another angle wraps the difference.
    cmd : ndarray, shape (N, 4)
        Commands in the order of :data:`COMMANDS`, each in force during the interval that
        ends at the row's time.
    truth : ndarray, shape (N, 6), or None
        True state in the order of :data:`TRUTH`, where it is known; NaN where it is not.
    name : str
        For tables and pictures.
    notes : tuple of str
        What was missing, converted or repaired when the log was read.
    """

    t: Array
    z: Array
    cmd: Array
    truth: Array | None = None
    name: str = "log"
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse arrays of a wrong shape, of infinite values, or of a time that stands still."""
        shapes = {"t": (), "z": (len(MEASUREMENTS),), "cmd": (len(COMMANDS),)}
        if self.truth is not None:
            shapes["truth"] = (len(TRUTH),)
        rows = np.shape(self.t)[0] if np.ndim(self.t) == 1 else -1
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

    def __iter__(self) -> Iterator[tuple[float, Array, Array]]:
        """Yield ``(t, z, cmd)`` of each row, as a twin would meet them on board."""
        return zip(self.t.tolist(), self.z, self.cmd, strict=True)

    @property
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
        truth = None if self.truth is None else self.truth[rows]
        return dataclasses.replace(
            self, t=self.t[rows], z=self.z[rows], cmd=self.cmd[rows], truth=truth
        )

    def without_truth(self) -> Log:
        """Return the same run as the boat itself would have recorded it."""
        return dataclasses.replace(self, truth=None)

    def write(self, path: str | Path) -> None:
        """Write the log as CSV, compressed if the name ends in ``.gz``, or as ``.parquet``.

        Parameters
        ----------
        path : str or Path
            File to create or replace.

        Notes
        -----
        NaN becomes an empty cell; each number is written with the digits that give the
        same float64 back. :meth:`read` returns the same arrays, save for what it would
        repair or refuse in any file (repeated fixes, a column that never changes).
        """
        import polars as pl

        columns = {TIME: self.t}
        columns.update(zip(COMMANDS, self.cmd.T, strict=True))
        columns.update(zip(MEASUREMENTS, self.z.T, strict=True))
        if self.truth is not None:
            columns.update(zip(TRUTH, self.truth.T, strict=True))
        frame = pl.DataFrame(columns).fill_nan(None)
        path = Path(path)
        if path.suffix == ".parquet":
            frame.write_parquet(path)
        elif path.suffix == ".gz":
            # No time stamp and no name inside: equal logs give equal files.
            with path.open("wb") as raw, gzip.GzipFile("", "wb", fileobj=raw, mtime=0) as file:
                frame.write_csv(file)  # type: ignore[call-overload]
        else:
            frame.write_csv(path)

    @classmethod
    def read(cls, path: str | Path, mapping: str | Path | None = None) -> Log:
        """Read a log from a CSV or Parquet file or a ROS 2 bag.

        Parameters
        ----------
        path : str or Path
            CSV, plain or gzipped, with a header of column names, in any order; or
            ``.parquet`` with the same columns; or a bag: a folder with ``metadata.yaml``, or
            a file ``.mcap`` or ``.db3``. Required: ``t_s``, the :data:`COMMANDS`,
            ``gps_x_m``, ``gps_y_m`` and ``compass_rad``. The other :data:`MEASUREMENTS` may
            be absent (never measured), and so may the :data:`TRUTH`. ``n_rps`` and
            ``delta_rad`` are those of a ship with one propeller, one rudder, and stand for
            both sides. Degrees and rpm are converted where the name says so:
            ``delta_left_deg``, ``compass_deg``, ``gyro_degps``, ``n_left_rpm`` and so on
            instead of the SI column. Any other column is left out, with a note.
        mapping : str or Path, optional
            TOML file that says which column or message is which column of the log: see
            ``twin/logs/mapping.py`` and ``twin/mappings/ros2_example.toml``. Left out:
            ``<log>.mapping.toml`` beside the log, if there is one. A bag needs one.

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
        - A fix bit-equal to the last one is no new sample but a receiver slower than the
          log, and becomes NaN, its velocity too if that repeats as well; so does a
          repeated compass value.
        - Fixes that no boat can reach from the others (a jump of 500 m and back) become NaN.
        - A step of time above 5 times the median is a gap: missing data.
        - Rows of equal time that do not contradict each other become one.
        - An empty command holds the last one.
        - Blank lines are left out.
        """
        path = Path(path)
        mapping = mapping_of(path, mapping)
        layout = None if mapping is None else Layout.load(mapping)
        if is_bag(path):
            table = read_bag(path, layout)
            _require(table.source, table.data, "name them in the mapping")
            return _assemble(table)
        file = ParquetFile(path) if path.suffix == ".parquet" else CsvFile(path)
        entries, left, layout = _chosen(file, layout)
        table = gathered(file, entries, layout)
        table.notes += left
        return _assemble(table)


def beside(path: str | Path, suffix: str) -> Path:
    """Return the file of a log's name with another ending (``.toml``, ``.png``) beside it."""
    path = Path(path)
    return path.parent / (name_of(path) + suffix)


def mapping_of(path: Path, mapping: str | Path | None = None) -> Path | None:
    """Return the mapping file of a log: the one that is given, else the one beside it, if any."""
    if mapping is not None:
        return Path(mapping)
    found = beside(path, ".mapping.toml")
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
        Name and log file; the particulars of the boat lie beside each log, in
        ``<name>.toml``.
    """
    folder = Path(__file__).with_name("recorded")
    return {path.name.removesuffix(".csv.gz"): path for path in sorted(folder.glob("*.csv.gz"))}


def _require(source: str, names: Collection[str], remedy: str) -> None:
    """Refuse a table without the columns that each log needs."""
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        raise LogError(f"{source}: column(s) {', '.join(missing)} missing; {remedy}")


def _chosen(
    file: CsvFile | ParquetFile, layout: Layout | None
) -> tuple[list[Entry], list[str], Layout]:
    """Return how to make a log of a file's columns, what is left out, and the mapping."""
    source, header = file.source, file.header
    first = "the header" if isinstance(file, ParquetFile) else f"line {file.blank + 1}"
    if layout is None and not {"gps_x_m", "gps_y_m"} <= set(header):
        layout = layout_of(name_of(file.path), header)
    layout = layout or Layout()
    there = f"({first} has: {shorten(', '.join(header), 200)})"
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
            raise LogError(f"{source}: column {given} stands twice in {first}; remove one")
    left = [given for given in header if given not in used]
    absent = [name for name in _KNOWN if OTHER_UNITS.get(name, (name, 1.0))[0] not in made]
    hints = {given: hint for given in left if (hint := _meant(given, absent))}
    remedy = [
        f"rename {given} to {hint}"
        for given, hint in hints.items()
        if OTHER_UNITS.get(hint, (hint, 1.0))[0] in REQUIRED
    ]
    remedy = remedy or ["add them to the file"]
    _require(source, made, f"{'; '.join(remedy)}, or name them in a mapping file {there}")
    if layout.entries:
        notes = [f"{len(left)} column(s) not in {layout.source}: {', '.join(left)}"] if left else []
        return entries, notes, layout
    notes = [
        f"{given or '(no name)'}: unknown column, left out"
        + (f"; if it is {hints[given]}, rename it" if given in hints else "")
        for given in left
    ]
    return entries, notes, layout


def _own(given: str, name: str, names: tuple[str, ...], factor: float) -> Entry:
    """Return the entry of a column under a name of ours."""
    note = f"{given}: converted to {name}" if given != name else ""
    if len(names) > 1:
        note = f"{given}: one for both sides, {' and '.join(names)}"
    if factor == 1.0:
        return Entry(names, (given,), note=note)
    return Entry(names, (given,), lambda values: [values[0] * factor] * len(names), note=note)


def _assemble(table: Table) -> Log:
    """Check and repair the columns of a table and make a log of them."""
    notes = table.notes
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

    t = _checked_time(column(TIME), table)
    rows = len(t)
    cmd = np.empty((rows, len(COMMANDS)))
    for j, name in enumerate(COMMANDS):
        cmd[:, j] = _held_command(column(name), table.given[name], table)
        if name.endswith("_rad"):
            _check_drive(cmd[:, j], name, table)

    z = np.full((rows, len(MEASUREMENTS)), np.nan)
    never = [name for name in MEASUREMENTS if name not in names]
    if never:
        notes.append(f"{', '.join(never)}: not in the file, taken as never measured")
    for j, name in enumerate(MEASUREMENTS):
        if name in names:
            z[:, j] = column(name)
            _check_measurement(t, z[:, j], name, table)
    drop_repeats(t, z, notes)
    with np.errstate(over="ignore", invalid="ignore"):  # of any numbers: no jump, no turning
        _drop_jumps(t, z, table)
        _check_turning(t, z, table)

    truth = None
    if any(name in names for name in TRUTH):
        truth = np.full((rows, len(TRUTH)), np.nan)
        for j, name in enumerate(TRUTH):
            if name in names:
                truth[:, j] = column(name)
        absent = [name for name in TRUTH if name not in names]
        if absent:
            notes.append(f"{', '.join(absent)}: not in the file, this part of the truth is unknown")
    return Log(t, z, cmd, truth, table.name, tuple(notes))


def _merge_equal_times(table: Table) -> None:
    """Make one row of those of equal time, unless they say different things."""
    t = table.data[TIME]
    step = np.diff(t, prepend=-np.inf)
    if not (step == 0.0).any() or not (step >= 0.0).all():
        return
    group = np.cumsum(step > 0.0) - 1
    one = merged(group, table.data)
    for name, values in table.data.items():
        if not ((one[name][group] == values) | np.isnan(values)).all():
            return
    rows, line = np.append(np.flatnonzero(step > 0.0), len(t)), table.line
    table.notes.append(
        f"t_s: {len(t) - len(rows) + 1} of {len(t)} rows have the time of the row before and do "
        "not contradict it, merged with it"
    )
    table.data, table.line = one, lambda row: line(int(rows[row]))


def _meant(given: str, absent: Sequence[str]) -> str | None:
    """Return the absent column that an unknown name probably stands for."""
    low = given.lower().replace(" ", "_")
    if low in _ALIASES:
        return _ALIASES[low] if _ALIASES[low] in absent else None
    begun = [name for name in absent if name.startswith(low + "_")]
    near = begun or difflib.get_close_matches(low, absent, n=1, cutoff=0.7)
    return near[0] if near else None


def _checked_time(t: Array, table: Table) -> Array:
    """Return the time if it is complete and increasing; note its gaps."""
    given = table.source + ": column t_s"
    if len(t) < 2:
        raise LogError(
            f"{table.source}: {len(t)} row of data after the header; a log needs two or more"
            if len(t)
            else f"{table.source}: no row of data after the header (line 1); record a run first"
        )
    if np.isnan(t).any():
        row = int(np.argmax(np.isnan(t)))
        raise LogError(
            f"{given}, {table.line(row)}: empty; each row needs a time, else remove the row"
        )
    step = np.diff(t)
    if (step <= 0.0).any():
        row = int(np.argmax(step <= 0.0)) + 1
        raise LogError(
            f"{given}, {table.line(row)}: time does not increase ({t[row]:.10g} s after "
            f"{t[row - 1]:.10g} s); sort the rows by time and merge those with equal times"
        )
    gaps = step > _GAP_STEPS * np.median(step)
    if gaps.any():
        row = int(np.argmax(step))
        table.notes.append(
            f"t_s: {gaps.sum()} time gap(s) above {_GAP_STEPS:.0f} x the median step "
            f"{np.median(step):.4g} s, treated as missing data (longest {step[row]:.1f} s at "
            f"t = {t[row]:.1f} s, {table.line(row + 1)})"
        )
    return t


def _held_command(values: Array, given: str, table: Table) -> Array:
    """Return a command with empty cells filled by the last one."""
    empty = np.isnan(values)
    if not empty.any():
        return values
    if empty[0]:
        raise LogError(
            f"{table.source}: column {given}, {table.line(0)}: empty, and there is no earlier "
            "command to hold; fill in the command in force or remove the first rows"
        )
    table.notes.append(
        f"{given}: {empty.sum()} of {len(values)} cells empty, the last command held"
    )
    rows = np.arange(len(values))
    return values[np.maximum.accumulate(np.where(empty, 0, rows))]


def _check_measurement(t: Array, values: Array, name: str, table: Table) -> None:
    """Refuse a dead sensor and note what is missing."""
    rows, given = len(values), table.given[name]
    valid = ~np.isnan(values)
    count = int(valid.sum())
    if count == 0:
        table.notes.append(f"{given}: all {rows} cells empty, taken as never measured")
        return
    samples = values[valid]
    if count >= _CONSTANT_ROWS and (samples == samples[0]).all():
        last = rows - 1 - int(np.argmax(valid[::-1]))
        raise LogError(
            f"{table.source}: column {given}, {table.line(int(np.argmax(valid)))} to "
            f"{table.line(last)}: all {count} values are equal, as of a dead sensor; leave its "
            "cells empty or remove the column"
        )
    if count < rows:
        table.notes.append(
            f"{given}: {rows - count} of {rows} cells empty ({_longest_gap(t, valid)})"
        )
    if name in ("compass_rad", "wind_from_rad"):
        _check_angle(values, name, table)


def _in_degrees(name: str) -> str:
    """Return the remedy for degrees under a name of radians."""
    other = name.replace("_rad", "_deg")
    return f'name the column {other} (in a mapping: unit = "{other.rpartition("_")[2]}")'


def _check_drive(values: Array, name: str, table: Table) -> None:
    """Refuse drive angles beyond half a turn."""
    if (most := np.abs(values).max()) > math.pi:
        row = int(np.argmax(np.abs(values)))
        raise LogError(
            f"{table.source}: column {table.given[name]}, {table.line(row)}: {name} is "
            f"{most:.4g} rad, more than half a turn; if these are degrees, {_in_degrees(name)}, "
            "else wrap the angle to within +-pi"
        )


def _check_angle(values: Array, name: str, table: Table) -> None:
    """Refuse an angle that steps as degrees do: unwrapped or not, radians step by less."""
    rows = np.flatnonzero(~np.isnan(values))
    with np.errstate(over="ignore"):
        step = np.diff(values[rows])
    # unwrapping that began anew steps by whole turns
    off = np.abs(np.remainder(step + math.pi, 2.0 * math.pi) - math.pi)
    wild = (np.abs(step) > 2.1 * math.pi) & (off > _WHOLE_TURN)
    if not wild.any():
        return
    given = table.given[name]
    worst = int(np.argmax(np.where(wild, np.abs(step), 0.0)))
    if (np.abs(np.abs(step[wild]) - 360.0) < 30.0).any() or wild.sum() > 0.01 * len(step):
        raise LogError(
            f"{table.source}: column {given}, {table.line(int(rows[worst + 1]))}: {name} steps by "
            f"{step[worst]:.4g} rad, as degrees do; {_in_degrees(name)}"
        )
    table.notes.append(
        f"{given}: {wild.sum()} step(s) of more than a turn; if these are degrees, "
        f"{_in_degrees(name)}"
    )


def _check_turning(t: Array, z: Array, table: Table) -> None:
    """Refuse a heading or a yaw rate in degrees, where the motion tells."""
    seen = np.isfinite(z[:, [0, 4, 5]])
    fix, compass, gyro = (np.flatnonzero(column) for column in seen.T)
    if len(compass) < _CONSTANT_ROWS:
        return
    heading = z[compass, 4]
    if np.abs(heading).max() > 2.1 * math.pi and len(fix) >= _CONSTANT_ROWS:
        grid = _grid(t[fix])
        way = np.diff([np.interp(grid, t[fix], z[fix, j]) for j in (0, 1)])
        psi = heading[np.searchsorted(t[compass], grid[1:]).clip(max=len(compass) - 1)]
        length, course = np.hypot(*way), np.arctan2(way[1], way[0])
        ahead = [
            length @ np.cos(scale * psi - course) / max(length.sum(), 1e-9)
            for scale in (1.0, math.pi / 180.0)
        ]
        if ahead[0] < 0.5 and ahead[1] > 0.9:
            raise LogError(
                f"{table.source}: column {table.given['compass_rad']}: taken as degrees the boat "
                f"goes where it points, as radians not; {_in_degrees('compass_rad')}"
            )
    if len(gyro) >= _CONSTANT_ROWS:
        grid = _grid(t[compass])
        rate, step = z[gyro, 5], np.diff(t[gyro])
        angle = np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * step))
        told = np.diff(np.interp(grid, t[gyro], angle))

        def ratio(psi: Array) -> float:
            """Return how many times as fast the gyro turns; 0 where the two are not alike."""
            turned = np.diff(np.interp(grid, t[compass], np.unwrap(psi)))
            both, square = turned @ told, turned @ turned
            alike = both > 0.9 * math.sqrt(square * (told @ told))
            return float(both / max(square, 1e-9)) if alike else 0.0

        times = ratio(heading)
        if 40.0 < times < 80.0:
            raise LogError(
                f"{table.source}: column {table.given['gyro_radps']}: {times:.3g} times "
                f"the rate at which the heading turns; {_in_degrees('gyro_radps')}"
            )
        beyond = np.abs(heading).max() > 2.1 * math.pi
        if beyond and not 0.5 < times < 2.0 and 0.5 < ratio(np.radians(heading)) < 2.0:
            raise LogError(
                f"{table.source}: column {table.given['compass_rad']}: taken as degrees it turns "
                f"as the yaw rate says, as radians not; {_in_degrees('compass_rad')}"
            )


def _grid(t: Array) -> Array:
    """Return times 2 s apart, or ten steps if those are longer."""
    step = max(2.0, 10.0 * float(np.median(np.diff(t))), (t[-1] - t[0]) / 1e5)
    return np.arange(t[0], t[-1], step)


def _drop_jumps(t: Array, z: Array, table: Table) -> None:
    """Set fixes that no boat can reach from the others to NaN, in place; refuse many of them."""
    new = np.flatnonzero(np.isfinite(z[:, :2]).all(axis=1))
    if len(new) < 2:
        return
    place, at = z[new, :2], t[new]

    def reached(first: npt.NDArray[np.intp], then: int) -> npt.NDArray[np.bool_]:
        way = np.hypot(*(place[then] - place[first]).T)
        return np.asarray(way <= _JUMP + _FAST * (at[then] - at[first]), dtype=np.bool_)

    length = np.hypot(*np.diff(place, axis=0).T)
    broken = np.flatnonzero(length > _JUMP + _FAST * np.diff(at))
    if not len(broken):
        return
    row = int(broken[0])
    where = (
        f"{table.line(int(new[row + 1]))}: the position jumps by {length[row]:.4g} m in "
        f"{at[row + 1] - at[row]:.3g} s"
    )
    # The longest chain of pieces, each of which can be reached from the one before.
    start, end = np.append(0, broken + 1), np.append(broken, len(new) - 1)
    kept = (end - start + 1).astype(np.int64)
    before = np.full(len(start), -1)
    if len(start) <= _PIECES:
        for j in range(1, len(start)):
            chain = np.where(reached(end[:j], int(start[j])), kept[:j], 0)
            best = int(np.argmax(chain))
            if chain[best]:
                kept[j], before[j] = kept[j] + chain[best], best
    given = [table.given[name] for name in MEASUREMENTS[:2]]
    lost = len(new) - int(kept.max())
    if lost > _LOST * len(new):
        raise LogError(
            f"{table.source}: column(s) {', '.join(dict.fromkeys(given))}, "
            f"{where} and stays away; read the pieces one by one with start_s and stop_s in [rows] "
            "of a mapping file, or empty the false cells"
        )
    good = np.zeros(len(new), dtype=np.bool_)
    piece = int(np.argmax(kept))
    while piece >= 0:
        good[start[piece] : end[piece] + 1] = True
        piece = int(before[piece])
    z[new[~good], :2] = np.nan
    table.notes.append(
        f"gps_x_m, gps_y_m: {lost} of {len(new)} fixes cannot be reached from the others, left "
        f"out ({where})"
    )


def _repeated(values: Array) -> npt.NDArray[np.bool_]:
    """Return the rows of (N, k) values that equal the last complete row before them."""
    complete = np.flatnonzero(~np.isnan(values).any(axis=1))
    samples = values[complete]
    repeated = np.zeros(len(values), dtype=np.bool_)
    # Against the last valid sample, not the last row: reading twice changes nothing more.
    repeated[complete[1:]] = (samples[1:] == samples[:-1]).all(axis=1)
    return repeated


def drop_repeats(t: Array, z: Array, notes: list[str]) -> None:
    """Set samples that only repeat the last one to NaN, in place."""
    fix, velocity = slice(0, 2), slice(2, 4)
    compass = slice(4, 5)
    stale = _repeated(z[:, fix])
    parts = [
        (fix, stale, "fixes"),
        (velocity, stale & _repeated(z[:, velocity]), "velocities of repeated fixes"),
        (compass, _repeated(z[:, compass]), "values"),
    ]
    for part, repeated, what in parts:
        if repeated.any():
            total = int((~np.isnan(z[:, part]).any(axis=1)).sum())
            z[repeated, part] = np.nan
            gap = _longest_gap(t, ~repeated & np.isfinite(z[:, part.start]))
            notes.append(
                f"{', '.join(MEASUREMENTS[part])}: {repeated.sum()} of {total} {what} repeat the "
                f"last one, taken as no new sample ({gap})"
            )


def _longest_gap(t: Array, valid: npt.NDArray[np.bool_]) -> str:
    """Return the length and the start of the longest run of rows without a sample."""
    edge = np.diff(np.concatenate(([1], valid.astype(np.int8), [1])))
    first, after = np.flatnonzero(edge == -1), np.flatnonzero(edge == 1)
    # A run lasts until the next sample; at the end of the log, for one step beyond it.
    until = np.append(t, t[-1] + np.median(np.diff(t)))[after]
    longest = int(np.argmax(until - t[first]))
    return (
        f"longest gap {until[longest] - t[first[longest]]:.1f} s at t = {t[first[longest]]:.1f} s"
    )
