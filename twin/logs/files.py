"""CSV and Parquet files: their header, and their columns as numbers, block by block."""

from __future__ import annotations

import csv
import gzip
import io
import math
import re
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from twin.channels import COMMANDS, MEASUREMENTS, TIME
from twin.logs.columns import Array
from twin.logs.dates import Clock
from twin.logs.errors import LogError

if TYPE_CHECKING:
    import polars as pl

__all__ = [
    "EMPTY",
    "CsvFile",
    "ParquetFile",
    "cannot_be_read",
    "is_number",
    "ragged_line",
    "shorten",
    "twice_said",
    "units_line",
    "with_points",
]

_BLOCK_BYTES = 1 << 20
"""A piece of a CSV file, whose rows take little memory even if they are blank or short."""

_BLANK_MAX = 1000
"""Most blank lines before the header."""

_REMARKS, _REMARK_LINES = ("#", "%", "//", "sep="), 100
"""What lines of comments begin with, and the most of them that are looked at."""

_BLOCK_ROWS = 1 << 19

EMPTY = ("nan", "NaN", "NAN", "NA", "N/A", "null", "NULL", "None", "-", "--", "---")
"""Cells that hold no value."""

Block = tuple[Array, dict[str, Array], set[str]]
"""Number of each row in the file, the columns, and which of them were dates."""


def shorten(text: str, length: int = 40) -> str:
    """Return a text cut to a length."""
    return text if len(text) <= length else text[: length - 3] + "..."


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
        if re.fullmatch(r"\s*-?\d+,\d+\s*", str(frame[name][row])):
            remedy = "if the comma is the decimal mark, separate the cells by semicolons or tabs"
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

    def blocks(self, sources: Sequence[str], clock: Clock) -> Iterator[Block]:
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
    if 2 * sum(is_number(name) for name in header) > len(header):
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
                remedy = "remove the surplus cells, or name their columns in the header"
                if mark == "," and len(cells) > 1.5 * width:  # each number is cut in two
                    remedy = (
                        "where the comma is the decimal mark, separate the cells by semicolons or "
                        f"tabs; else {remedy}"
                    )
                return (
                    f"line {first - 1 + reader.line_num} has {len(cells)} cells but the header "
                    f"{width}; {remedy}"
                )
    return None


_READER = """
import sys, polars as pl
source, columns, *numbers = sys.argv[1:]
pl.scan_parquet(source, glob=False).select(pl.nth(*map(int, numbers))).sink_ipc(columns)
"""
"""Run by a process of its own: of a damaged page, polars 2.1 asks for more memory than there is and
ends its process."""


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
        try:
            self.header = tuple(pl.read_parquet_schema(path))
        except pl.exceptions.DuplicateError as error:
            raise LogError(f"{path}: {error}; rename one of them") from None
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
            raise self._damaged(str(error)) from None

    def _damaged(self, reason: str) -> LogError:
        said = shorten(" ".join(reason.split()) or "its pages", 100)
        return LogError(
            f"{self.path}: the Parquet file is damaged or cut off ({said}); copy it again"
        )

    def frames(self, sources: Sequence[str], rows: int) -> Iterator[pl.DataFrame]:
        """Yield the columns named, in pieces of so many rows; one empty piece if there are none."""
        import polars as pl

        numbers = [str(self.header.index(name)) for name in sources]
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            columns = Path(folder) / "columns.arrow"
            command = [sys.executable, "-P", "-c", _READER, str(self.path), str(columns)]
            done = subprocess.run([*command, *numbers], capture_output=True, check=False)
            if done.returncode:
                lines = done.stderr.decode("utf-8", "replace").strip().splitlines() or [""]
                raise self._damaged(lines[-1 if done.returncode == 1 else 0])
            whole = pl.scan_ipc(columns)
            height = whole.select(pl.len()).collect().item()
            for first in range(0, max(height, 1), rows):
                yield whole.slice(first, rows).collect()

    def blocks(self, sources: Sequence[str], clock: Clock) -> Iterator[Block]:
        """Yield the columns named, in pieces; see :meth:`CsvFile.blocks`."""
        first = 0
        for frame in self.frames(sources, _BLOCK_ROWS):
            lines = np.arange(first + 1, first + 1 + frame.height, dtype=np.float64)
            first += frame.height
            yield lines, *_numbers(frame, clock, lines, self.source, self.unit)
