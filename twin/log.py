"""A recorded run: measurements and commands as read from a CSV file, checked and repaired.

A log is all that a twin may see. Missing data is normal in it and stays missing (NaN);
what cannot be used is refused with the place and the remedy; what was repaired on the way
is counted in :attr:`Log.notes`.
"""

from __future__ import annotations

import csv
import dataclasses
import difflib
import gzip
import io
import math
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    import polars as pl

__all__ = ["COMMANDS", "MEASUREMENTS", "TRUTH", "Log", "LogError", "recorded_runs"]

Array = npt.NDArray[np.float64]

TIME = "t_s"
"""Time of the row, s."""

COMMANDS = ("n_left_rps", "n_right_rps", "delta_left_rad", "delta_right_rad")
"""Columns of ``Log.cmd``: shaft speeds, rev/s, and drive angles, rad (above 0: to starboard)."""

MEASUREMENTS = (
    "gps_x_m",
    "gps_y_m",
    "gps_vx_mps",
    "gps_vy_mps",
    "compass_rad",
    "gyro_radps",
    "accel_x_mps2",
    "accel_y_mps2",
    "wind_mps",
    "wind_from_rad",
)
"""Columns of ``Log.z``: position and velocity over ground north (x) and east (y), heading
clockwise from north, yaw rate, specific force forward and to starboard, speed of the true wind
and the direction that it comes from, clockwise from north."""

TRUTH = ("true_x_m", "true_y_m", "true_psi_rad", "true_u_mps", "true_v_mps", "true_r_radps")
"""Columns of ``Log.truth``: the simulated state, for scoring only."""

REQUIRED = (TIME, *COMMANDS, "gps_x_m", "gps_y_m", "compass_rad")

_DEGREE = math.pi / 180.0
_OTHER_UNITS: dict[str, tuple[str, float]] = {
    "n_left_rpm": ("n_left_rps", 1.0 / 60.0),
    "n_right_rpm": ("n_right_rps", 1.0 / 60.0),
    "delta_left_deg": ("delta_left_rad", _DEGREE),
    "delta_right_deg": ("delta_right_rad", _DEGREE),
    "compass_deg": ("compass_rad", _DEGREE),
    "gyro_degps": ("gyro_radps", _DEGREE),
    "wind_from_deg": ("wind_from_rad", _DEGREE),
    "true_psi_deg": ("true_psi_rad", _DEGREE),
    "true_r_degps": ("true_r_radps", _DEGREE),
}
_KNOWN = (TIME, *COMMANDS, *MEASUREMENTS, *TRUTH, *_OTHER_UNITS)

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
_SINGLE = {
    "n_rps": "n_left_rps and n_right_rps",
    "delta_rad": "delta_left_rad and delta_right_rad",
}

_EMPTY = ("nan", "NaN", "NAN", "NA", "N/A", "null", "NULL", "None")
_CONSTANT_ROWS = 20
_GAP_STEPS = 5.0


class LogError(ValueError):
    """A log that cannot be used; the message names the file, the place and the remedy."""


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
        """Write the log as CSV, compressed if the name ends in ``.gz``.

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
        if path.suffix == ".gz":
            # No time stamp and no name inside: equal logs give equal files.
            with path.open("wb") as raw, gzip.GzipFile("", "wb", fileobj=raw, mtime=0) as file:
                frame.write_csv(file)  # type: ignore[call-overload]
        else:
            frame.write_csv(path)

    @classmethod
    def read(cls, path: str | Path) -> Log:
        """Read a log from a CSV file, plain or gzipped.

        Parameters
        ----------
        path : str or Path
            File with a header of column names, in any order. Required: ``t_s``, the
            :data:`COMMANDS`, ``gps_x_m``, ``gps_y_m`` and ``compass_rad``. The other
            :data:`MEASUREMENTS` may be absent (never measured), and so may the
            :data:`TRUTH`. Degrees and rpm are converted: ``delta_left_deg``,
            ``delta_right_deg``, ``compass_deg``, ``gyro_degps``, ``wind_from_deg``,
            ``true_psi_deg``, ``true_r_degps``, ``n_left_rpm``, ``n_right_rpm`` instead of
            the SI column. Any other column is left out, with a note.

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
        - A step of time above 5 times the median is a gap: missing data.
        - An empty command holds the last one.
        - Blank lines are left out.
        """
        return _assemble(_open_csv(Path(path)))


def beside(path: str | Path, suffix: str) -> Path:
    """Return the file of a log's name with another ending (``.toml``, ``.png``) beside it."""
    path = Path(path)
    return path.with_name(path.name.removesuffix(".gz").removesuffix(".csv") + suffix)


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


@dataclass
class _Table:
    """Named columns of numbers from some file, before any check of what they mean."""

    source: str
    name: str
    header: tuple[str, ...]
    column: Callable[[str], Array]
    line: Callable[[int], str]
    notes: list[str]


def _assemble(table: _Table) -> Log:
    """Check and repair the columns of a table and make a log of them."""
    source, notes = table.source, table.notes
    names = _choose_columns(table)

    def column(name: str) -> Array:
        given = names[name]
        values = table.column(given)
        if np.isinf(values).any():
            row = int(np.argmax(np.isinf(values)))
            raise LogError(
                f"{source}: column {given}, {table.line(row)}: the value is infinite; "
                "leave the cell empty where there is no value"
            )
        if given == name:
            return values
        notes.append(f"{given}: converted to {name}")
        return values * _OTHER_UNITS[given][1]

    t = _checked_time(column(TIME), table)
    rows = len(t)
    cmd = np.empty((rows, len(COMMANDS)))
    for j, name in enumerate(COMMANDS):
        cmd[:, j] = _held_command(column(name), names[name], table)
        if name.endswith("_rad") and np.abs(cmd[:, j]).max() > math.pi:
            notes.append(
                f"{name}: reaches {np.abs(cmd[:, j]).max():.4g} rad; if these are degrees, name "
                f"the column {name.removesuffix('_rad')}_deg"
            )

    z = np.full((rows, len(MEASUREMENTS)), np.nan)
    never = [name for name in MEASUREMENTS if name not in names]
    if never:
        notes.append(f"{', '.join(never)}: not in the file, taken as never measured")
    for j, name in enumerate(MEASUREMENTS):
        if name in names:
            z[:, j] = column(name)
            _check_measurement(t, z[:, j], names[name], table)
    drop_repeats(t, z, notes)

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


def _choose_columns(table: _Table) -> dict[str, str]:
    """Return the column of the file for each known name it has, or raise."""
    source, header = table.source, table.header
    names: dict[str, str] = {}
    for given in header:
        if given not in _KNOWN:
            continue
        name = _OTHER_UNITS.get(given, (given, 1.0))[0]
        if name in names:
            raise LogError(
                f"{source}: columns {names[name]} and {given} both give {name}; remove one of them"
            )
        names[name] = given

    absent = [name for name in _KNOWN if _OTHER_UNITS.get(name, (name, 1.0))[0] not in names]
    unknown = [given for given in header if given not in _KNOWN]
    hints = {given: hint for given in unknown if (hint := _meant(given, absent))}
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        remedy = [
            f"rename {given} to {hint}"
            for given, hint in hints.items()
            if _OTHER_UNITS.get(hint, (hint, 1.0))[0] in missing
        ]
        remedy += [f"copy {given} to {both}" for given, both in _SINGLE.items() if given in unknown]
        raise LogError(
            f"{source}: column(s) {', '.join(missing)} missing; "
            + ("; ".join(remedy) if remedy else "add them to the file")
            + f" (line 1 has: {_shorten(', '.join(header), 200)})"
        )
    for given in unknown:
        hint = f"; if it is {hints[given]}, rename it" if given in hints else ""
        table.notes.append(f"{given or '(no name)'}: unknown column, left out{hint}")
    return names


def _meant(given: str, absent: Sequence[str]) -> str | None:
    """Return the absent column that an unknown name probably stands for."""
    low = given.lower().replace(" ", "_")
    if low in _ALIASES:
        return _ALIASES[low] if _ALIASES[low] in absent else None
    begun = [name for name in absent if name.startswith(low + "_")]
    near = begun or difflib.get_close_matches(low, absent, n=1, cutoff=0.7)
    return near[0] if near else None


def _checked_time(t: Array, table: _Table) -> Array:
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


def _held_command(values: Array, given: str, table: _Table) -> Array:
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


def _check_measurement(t: Array, values: Array, given: str, table: _Table) -> None:
    """Refuse a dead sensor and note what is missing."""
    rows = len(values)
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
    angle = given in ("compass_rad", "wind_from_rad")
    if angle and count > 1 and np.abs(np.diff(samples)).max() > 2.0 * math.pi:
        table.notes.append(
            f"{given}: jumps by more than a turn; if these are degrees, name the column "
            f"{given.removesuffix('_rad')}_deg"
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


def _shorten(text: str, length: int = 40) -> str:
    return text if len(text) <= length else text[: length - 3] + "..."


def _open_csv(path: Path) -> _Table:
    """Return the table in a CSV file, plain or gzipped; its numbers are parsed at once."""
    try:
        with path.open("rb") as file:
            packed = file.read(2) == b"\x1f\x8b"
        if path.suffix == ".gz" and not packed and path.stat().st_size:
            raise LogError(
                f"{path}: is not a gzip file although its name ends in .gz; compress it with "
                "gzip or drop the .gz"
            )
        data = gzip.decompress(path.read_bytes()) if packed else None
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise LogError(
            f"{path}: the gzip file is damaged or cut off ({error}); copy it again, or rescue its "
            f"start with: zcat {path.name} > rescued.csv"
        ) from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise LogError(f"{path}: cannot be read ({reason}); check the name and the file") from None
    blank, header = _read_header(path, data)
    frame, bad = _read_numbers(path, data, blank, header)

    first_line = blank + 2
    rows: npt.NDArray[np.intp] | None = None
    notes: list[str] = []
    # Blank lines (often the last) arrive as rows without any value.
    void = _rows_without_value(frame)
    if void.any():
        rows = np.flatnonzero(~void)
        notes.append(f"{int(void.sum())} row(s) without a single value left out")

    def line(row: int) -> str:
        return f"line {first_line + (int(rows[row]) if rows is not None else row)}"

    def column(name: str) -> Array:
        values = frame[name].to_numpy().astype(np.float64, copy=False)
        return values if rows is None else values[rows]

    if bad is not None:
        given, row, text = bad
        raise LogError(
            f"{path}: column {given}, line {first_line + row}: {_shorten(text)!r} is not a "
            "number; correct it, or leave the cell empty where there is no value"
        )
    name = path.name.removesuffix(".gz").removesuffix(".csv")
    return _Table(str(path), name, header, column, line, notes)


def _rows_without_value(frame: pl.DataFrame) -> npt.NDArray[np.bool_]:
    import polars as pl

    if not frame.width:
        return np.zeros(0, dtype=np.bool_)
    void = frame.select(pl.all_horizontal(pl.all().is_null()).alias("void"))["void"]
    return np.asarray(void.to_numpy(), dtype=np.bool_)


def _read_header(path: Path, data: bytes | None) -> tuple[int, tuple[str, ...]]:
    """Return the number of blank lines before the header, and its names."""
    blank = 0
    with path.open("rb") if data is None else io.BytesIO(data) as file:
        if b"\0" in file.read(4096):
            raise LogError(
                f"{path}: is a binary file or UTF-16 text, not CSV; save it as CSV in UTF-8"
            )
        file.seek(0)
        while (raw := file.readline(1 << 20)) and not raw.strip(b"\r\n\t \xef\xbb\xbf"):
            blank += 1
    if not raw:
        raise LogError(f"{path}: the file is empty; write a header of column names and the rows")
    try:
        text = raw.decode("utf-8-sig").rstrip("\r\n")
    except UnicodeDecodeError:
        raise LogError(
            f"{path}: line {blank + 1} is not UTF-8 text; save the file as CSV in UTF-8"
        ) from None
    if "\r" in text:
        raise LogError(f"{path}: the lines end in CR only; save the file with LF or CR LF ends")
    header = tuple(name.strip() for name in next(csv.reader([text])))
    if len(header) < len(REQUIRED):
        for mark, called in ((";", "semicolons"), ("\t", "tabs")):
            if mark in text:
                raise LogError(
                    f"{path}: line {blank + 1}: cells are separated by {called}; separate them by "
                    "commas, with a point as the decimal mark"
                )
    if all(_is_number(name) for name in header):
        raise LogError(
            f"{path}: line {blank + 1} holds numbers; put a header of column names above them: "
            f"{', '.join((TIME, *COMMANDS, *MEASUREMENTS))}"
        )
    for name in header:
        if name in _KNOWN and header.count(name) > 1:
            raise LogError(f"{path}: column {name} stands twice in line {blank + 1}; remove one")
    return blank, header


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _read_numbers(
    path: Path, data: bytes | None, blank: int, header: tuple[str, ...]
) -> tuple[pl.DataFrame, tuple[str, int, str] | None]:
    """Return the known columns as float64, and the first cell that is no number."""
    import polars as pl

    wanted = [j for j, name in enumerate(header) if name in _KNOWN]
    names = [header[j] for j in wanted]

    def read(numbers: bool) -> pl.DataFrame:
        frame = pl.read_csv(
            path if data is None else data,
            columns=wanted,
            skip_lines=blank,
            infer_schema=False,
            null_values=list(_EMPTY),
            encoding="utf8" if numbers else "utf8-lossy",
            schema_overrides=[pl.Float64 if j in wanted else pl.String for j in range(len(header))]
            if numbers
            else None,
        )
        return frame.rename(dict(zip(frame.columns, names, strict=True)))

    if not wanted:
        return pl.DataFrame(), None
    try:
        return read(numbers=True), None
    except pl.exceptions.PolarsError:
        pass  # spaces around numbers, or a cell that is no number: look at the text
    try:
        text = read(numbers=False).select(pl.all().str.strip_chars())
    except pl.exceptions.PolarsError as error:
        raise LogError(_ragged(path, data, len(header)) or f"{path}: {error}") from None
    frame = text.select(pl.all().cast(pl.Float64, strict=False))
    first: tuple[str, int, str] | None = None
    for name in names:
        wrong = frame[name].is_null() & text[name].is_not_null() & (text[name] != "")
        row = wrong.arg_max() if wrong.any() else None
        if row is not None and (first is None or row < first[1]):
            first = (name, row, text[name][row])
    return frame, first


def _ragged(path: Path, data: bytes | None, width: int) -> str | None:
    """Return the complaint about the first line with more cells than the header has."""
    with path.open("rb") if data is None else io.BytesIO(data) as file:
        reader = csv.reader(io.TextIOWrapper(file, "utf-8", errors="replace", newline=""))
        for cells in reader:
            if len(cells) > width:
                return (
                    f"{path}: line {reader.line_num} has {len(cells)} cells but the header "
                    f"{width}; remove the surplus cells, or name their columns in the header"
                )
    return None
