"""Columns of numbers out of CSV and Parquet files, block by block.

Only the columns that are asked for are kept. Of a file that is too long, which may be larger than
the memory, only a piece or thinned rows are read.
"""

from __future__ import annotations

import csv
import gzip
import io
import math
import re
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
import numpy.typing as npt

from twin.channels import COMMANDS, MEASUREMENTS, TIME
from twin.logs.columns import Array, Entry
from twin.logs.dates import Clock, Midnight, past_midnight
from twin.logs.datum import Plane
from twin.logs.errors import LogError
from twin.logs.mapping import Layout

if TYPE_CHECKING:
    import polars as pl

__all__ = [
    "EMPTY",
    "MAX_ROWS",
    "UNIX",
    "CsvFile",
    "ParquetFile",
    "Table",
    "cannot_be_read",
    "date_of",
    "gathered",
    "is_number",
    "merged",
    "name_of",
    "ragged_line",
    "said",
    "shorten",
    "thinned",
    "too_long",
    "twice_said",
    "units_line",
    "with_points",
]

MAX_ROWS = 4_000_000
"""Longest log, rows: 11 hours at 100 Hz, about 2 GB of memory while it is read."""

_BLOCK_BYTES = 1 << 20
"""A piece of a CSV file, whose rows take little memory even if they are blank or short."""

_BLANK_MAX = 1000
"""Most blank lines before the header."""

_REMARKS, _REMARK_LINES = ("#", "%", "//"), 100
"""What lines of comments begin with, and the most of them that are looked at."""

_BLOCK_ROWS = 1 << 19

EMPTY = ("nan", "NaN", "NAN", "NA", "N/A", "null", "NULL", "None", "-", "--", "---")
"""Cells that hold no value."""

_PLACE = "\0place"

UNIX = 1e9, 4e9
"""Times between these are seconds since 1970: September 2001 to 2096."""

_SUFFIXES = (".csv", ".parquet", ".mcap", ".db3", ".bin", ".BIN", ".tlog")


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


def shorten(text: str, length: int = 40) -> str:
    """Return a text cut to a length."""
    return text if len(text) <= length else text[: length - 3] + "..."


def merged(group: npt.NDArray[np.intp], data: Mapping[str, Array]) -> dict[str, Array]:
    """Return one row for each group (N,), 0, 0, 1, ...: the last value in it that is not NaN."""
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


def _time_of_day(seconds: float) -> str:
    """Return seconds since midnight as a time of day."""
    return f"{datetime(1970, 1, 1) + timedelta(seconds=seconds % 86400.0):%H:%M:%S}"


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
    place = raw.pop(_PLACE)
    notes = [f"{void} row(s) without a single value left out"] if void else []
    if isinstance(file, CsvFile) and file.torn:
        notes.append("the last line is cut off, and left out")
    notes += said(layout, read, len(place))
    if epoch == epoch and clock.undated:
        notes.append(f"t_s: counted from {_time_of_day(epoch)}, the log keeps no date")
        epoch = math.nan
    elif len(place) and not dated_file:
        epoch = _epoch_of_offset(timed, raw)
    if epoch == epoch:
        notes.append(f"t_s: counted from {date_of(epoch)}")
    if midnight.days:
        notes.append("t_s: passes midnight without a date, and goes on")
    data = {}
    plane = None
    for entry in entries:
        values = [raw[source] for source in entry.sources]
        plane = entry.plane(values) if entry.plane is not None else plane
        made = entry.columns(values)
        data.update({key: np.broadcast_to(value, place.shape) for key, value in made.items()})
    given = {name: " and ".join(entry.sources) for entry in entries for name in entry.names}
    notes += [entry.note for entry in entries if entry.note]

    def line(row: int) -> str:
        return f"{file.unit} {int(place[row])}"

    known = None if math.isnan(epoch) else epoch
    return Table(file.source, name_of(Path(file.source)), data, given, line, notes, plane, known)


def _only(timed: Entry, data: Mapping[str, Array]) -> Array:
    return timed.columns([data[timed.sources[0]]])[TIME]


_Block = tuple[Array, dict[str, Array], set[str]]
"""Number of each row in the file, the columns, and which of them were dates."""


def _numbers(
    frame: pl.DataFrame, clock: Clock, lines: Array, source: str, unit: str
) -> tuple[dict[str, Array], set[str]]:
    """Return the columns as float64, dates as seconds since 1970; refuse any other text."""
    import polars as pl

    dated: set[str] = set()
    columns: dict[str, Array] = {}
    wrong: tuple[int, str] | None = None
    for name, kind in frame.schema.items():
        values = frame[name]
        if name == clock.date:
            columns[name] = np.full(frame.height, math.nan)  # read with the time of day
            continue
        if name == clock.column and clock.format and kind.is_numeric():
            values = values.cast(pl.String)
        if values.dtype == pl.String:
            text = values.str.strip_chars()
            values = (
                clock.seconds(frame)
                if name == clock.column
                else text.cast(pl.Float64, strict=False)
            )
            bad = values.is_null() & text.is_not_null() & (text != "") & ~text.is_in(EMPTY)
            row = bad.arg_max() if bad.any() else None
            if row is not None and (wrong is None or row < wrong[0]):
                wrong = row, name
            dated |= {name} & {clock.column}
        elif kind in (pl.Datetime, pl.Date):
            values = values.cast(pl.Datetime("us")).dt.epoch("us").cast(pl.Float64) * 1e-6
            dated.add(name)
        elif kind == pl.Duration:
            values = values.dt.total_microseconds().cast(pl.Float64) * 1e-6
        elif not (kind.is_numeric() or kind == pl.Null):
            raise LogError(f"{source}: column {name} holds {kind}, not numbers; convert it")
        numbers = values.cast(pl.Float64)
        columns[name] = numbers.to_numpy().astype(np.float64, copy=False)
    if wrong is not None:
        row, name = wrong
        texts = {key: frame[key] for key in frame.columns if frame[key].dtype == pl.String}
        if row == 0 and (units := units_line(texts)):
            raise LogError(f"{source}: {unit} {int(lines[0])} {units}")
        what = "date and time" if name == clock.column else "number"
        timed = name in (clock.column, TIME)
        remedy = "remove the row" if timed else "leave the cell empty where there is no value"
        raise LogError(
            f"{source}: column {name}, {unit} {int(lines[row])}: {shorten(frame[name][row])!r} is "
            f"not a {what}; correct it, or {remedy}"
        )
    return columns, dated


class CsvFile:
    """A CSV file, plain or gzipped; LogError where it is none with a header.

    Cells are separated by commas; or by semicolons or tabs, where a comma may be the decimal mark.
    """

    unit = "line"

    def __init__(self, path: Path) -> None:
        self.path, self.source, self.torn = path, str(path), False
        try:
            with path.open("rb") as file:
                self.packed = file.read(2) == b"\x1f\x8b"
            empty = not path.stat().st_size
        except OSError as error:
            raise cannot_be_read(path, error) from None
        if path.suffix == ".gz" and not self.packed and not empty:
            raise LogError(
                f"{path}: is not a gzip file although its name ends in .gz; compress it with "
                "gzip or drop the .gz"
            )
        with self._whole(), self._open() as file:
            self.blank, self.raw, self.mark, self.header = _read_header(path, file)

    def _open(self) -> BinaryIO:
        return gzip.open(self.path, "rb") if self.packed else self.path.open("rb")  # type: ignore[return-value]

    @contextmanager
    def _whole(self) -> Iterator[None]:
        """Turn the errors of a damaged file into one that says what to do."""
        try:
            yield
        except (gzip.BadGzipFile, EOFError, zlib.error) as error:
            raise LogError(
                f"{self.path}: the gzip file is damaged or cut off ({error}); copy it again, or "
                f"rescue its start with: zcat {self.path.name} > rescued.csv"
            ) from None
        except OSError as error:
            raise cannot_be_read(self.path, error) from None

    def blocks(self, sources: Sequence[str], clock: Clock) -> Iterator[_Block]:
        """Yield the columns named, in pieces of whole lines; ``clock`` holds dates, if any."""
        wanted = [j for j, name in enumerate(self.header) if name in sources]
        first = self.blank + 2
        with self._whole(), self._open() as file:
            for _ in range(self.blank + 1):
                file.readline()
            for text in _pieces(file, self.source):
                if text and not text.strip():  # blank lines only
                    first += text.count(b"\n")
                    continue
                # the writer was stopped within this line: its last number may have lost digits
                if (
                    text
                    and text[-1:] != b"\n"
                    and text.count(self.mark.encode()) + 1 < len(self.header)
                ):
                    text, self.torn = b"", True
                frame = self._parsed(text, first, wanted, clock)
                lines = np.arange(first, first + frame.height, dtype=np.float64)
                yield lines, *_numbers(frame, clock, lines, self.source, self.unit)
                first += text.count(b"\n")

    def _parsed(self, text: bytes, first: int, wanted: list[int], clock: Clock) -> pl.DataFrame:
        """Return the wanted columns of some lines: as numbers if all are, else as text."""
        import polars as pl

        header = self.raw + b"\n" + text
        names = [self.header[j] for j in wanted]

        def read(numbers: bool) -> pl.DataFrame:
            kinds = [
                pl.Float64
                if numbers and j in wanted and name not in (clock.column, clock.date)
                else pl.String
                for j, name in enumerate(self.header)
            ]
            frame = pl.read_csv(
                header,
                columns=wanted,
                infer_schema=False,
                separator=self.mark,
                null_values=list(EMPTY),
                encoding="utf8" if numbers else "utf8-lossy",
                schema_overrides=kinds,
            )
            return frame.rename(dict(zip(frame.columns, names, strict=True)))

        try:
            frame = read(numbers=True)
            return frame if self.mark == "," else with_points(frame)
        except pl.exceptions.PolarsError:
            pass  # spaces around numbers, or a cell that is no number: look at the text
        try:
            frame = read(numbers=False)
            return frame if self.mark == "," else with_points(frame)
        except pl.exceptions.PolarsError as error:
            ragged = ragged_line(text, first, len(self.header), self.mark)
            raise LogError(
                f"{self.source}: {ragged or shorten(str(error).splitlines()[0], 200)}"
            ) from None


def twice_said(source: str | Path, name: str, place: str) -> str:
    """Return the complaint about a column whose name stands twice in the header."""
    return f"{source}: column {name} stands twice in {place}; remove or rename one of them"


def units_line(columns: Mapping[str, pl.Series]) -> str:
    """Return the complaint about units in the first row of columns, or nothing."""
    first = [str(values[0]).strip() for values in columns.values() if len(values) > 1]
    second = [str(values[1]).strip() for values in columns.values() if len(values) > 1]
    words = [text for text in first if text not in ("", *EMPTY)]
    short = len(words) > 1 and all(len(text) < 16 for text in words)
    if not short or any(re.search(r"\d{2}", text) or is_number(text) for text in words):
        return ""
    if not any(is_number(text) for text in second):
        return ""
    return f"holds units or other words ({shorten(', '.join(words))}), not values; remove this line"


def with_points(frame: pl.DataFrame) -> pl.DataFrame:
    """Return cells of text with a point where a digit follows a comma, as decimals have.

    A column in which numbers have both stays as it is: there a comma may part thousands.
    """
    import polars as pl

    columns = []
    for name in frame.columns:
        text = frame[name]
        if text.dtype == pl.String:
            numbers = text.filter(~text.str.contains(":"))
            if not (numbers.str.contains(",").any() and numbers.str.contains(r"\.").any()):
                text = text.str.replace(r",(\d+)", ".$1")
        columns.append(text)
    return pl.DataFrame(columns)


def _pieces(file: BinaryIO, source: str) -> Iterator[bytes]:
    """Yield the rest of a file in pieces that end where a line ends, of few bytes and few rows."""
    rest = b""
    while data := file.read(_BLOCK_BYTES):
        cut = data.rfind(b"\n") + 1
        if not cut and len(rest) + len(data) > _BLOCK_BYTES:
            raise LogError(f"{source}: a line is longer than 1 MB; this is no CSV file")
        if cut:
            yield rest + data[:cut]
            rest = b""
        rest += data[cut:]
    yield rest


def cannot_be_read(path: Path, error: OSError) -> LogError:
    """Return the error of a file that is not there or not open to us."""
    reason = error.strerror or str(error)
    return LogError(f"{path}: cannot be read ({reason}); check the name and the file")


def _read_header(path: Path, file: BinaryIO) -> tuple[int, bytes, str, tuple[str, ...]]:
    """Return the blank lines before the header, its bytes, what separates cells, and its names."""
    blank = 0
    if b"\0" in file.read(4096):
        raise LogError(f"{path}: is a binary file or UTF-16 text, not CSV; save it as CSV in UTF-8")
    file.seek(0)
    while (raw := file.readline(1 << 20)) and not raw.strip(b"\r\n\t \xef\xbb\xbf"):
        blank += 1
        if blank > _BLANK_MAX:
            raise LogError(
                f"{path}: begins with more than {_BLANK_MAX} blank lines; write a header of column "
                "names and the rows"
            )
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
    mark = ","
    try:
        header = next(csv.reader([text]))
        for other in ";\t":
            if len(header) < 3 and text.count(other) > 2:
                mark, header = other, next(csv.reader([text], delimiter=other))
    except csv.Error as error:
        raise LogError(f"{path}: line {blank + 1} is no header of CSV ({error})") from None
    above = _lines_above(text, header, file)
    if above:
        where = "line 1 looks" if blank + above == 1 else f"lines 1 to {blank + above} look"
        raise LogError(
            f"{path}: {where} like comments above the header; remove them, so that the file "
            "begins with the names of the columns"
        )
    if all(is_number(name) for name in header):
        raise LogError(
            f"{path}: line {blank + 1} holds numbers; put a header of column names above them: "
            f"{', '.join((TIME, *COMMANDS, *MEASUREMENTS))}"
        )
    return blank, raw.rstrip(b"\r\n"), mark, tuple(name.strip() for name in header)


def _lines_above(text: str, header: Sequence[str], file: BinaryIO) -> int:
    """Return how many lines, from the first on, stand above one with the names of columns."""
    if len(header) > 1 and not text.startswith(_REMARKS):
        return 0
    for above in range(1, _REMARK_LINES):
        line = file.readline(1 << 20)
        if not line:
            return 0
        cells = max(line.count(mark) for mark in (b",", b";", b"\t")) + 1
        remark = line.decode("utf-8", "replace").startswith(_REMARKS)
        if cells > max(len(header), 2) and not remark:
            return above if len(header) == 1 or not is_number(_first_cell(line)) else 0
    return 0


def _first_cell(line: bytes) -> str:
    return re.split(r"[,;\t]", line.decode("utf-8", "replace"), maxsplit=1)[0].strip()


def is_number(text: str) -> bool:
    """Return whether a text is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def ragged_line(text: bytes, first: int, width: int, mark: str) -> str | None:
    """Return the complaint about the first line with more cells than the header has."""
    lines = io.TextIOWrapper(io.BytesIO(text), "utf-8", errors="replace", newline="")
    reader = csv.reader(lines, delimiter=mark)
    with suppress(csv.Error):
        for cells in reader:
            if len(cells) > width:
                return (
                    f"line {first - 1 + reader.line_num} has {len(cells)} cells but the header "
                    f"{width}; remove the surplus cells, or name their columns in the header"
                )
    return None


class ParquetFile:
    """A Parquet file; LogError where it is none."""

    unit = "row"

    def __init__(self, path: Path) -> None:
        import polars as pl

        self.path, self.source = path, str(path)
        try:
            with path.open("rb") as file:
                start = file.read(4)
        except OSError as error:
            raise cannot_be_read(path, error) from None
        if start != b"PAR1":
            what = "is not a Parquet file" if start else "the file is empty"
            raise LogError(f"{path}: {what}; write it again, or give a CSV file the ending .csv")
        with self._whole():
            # column by column: two threads that panic at once on a damaged file end the process
            self.frame = pl.scan_parquet(path, glob=False, parallel="none")
            self.header = tuple(self.frame.collect_schema())
            self.rows = int(self.frame.select(pl.len()).collect().item())

    @contextmanager
    def _whole(self) -> Iterator[None]:
        import polars as pl

        try:
            yield
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
            reason = shorten((str(error).splitlines() or ["?"])[0], 100)
            raise LogError(
                f"{self.path}: the Parquet file is damaged or cut off ({reason}); copy it again"
            ) from None

    def blocks(self, sources: Sequence[str], clock: Clock) -> Iterator[_Block]:
        """Yield the columns named, in pieces; see :meth:`CsvFile.blocks`."""
        for first in range(0, max(self.rows, 1), _BLOCK_ROWS):
            with self._whole():
                frame = self.frame.select(sources).slice(first, _BLOCK_ROWS).collect()
            lines = np.arange(first + 1, first + 1 + frame.height, dtype=np.float64)
            yield lines, *_numbers(frame, clock, lines, self.source, self.unit)
