"""CSV files: their header, and their columns as numbers, block by block."""

from __future__ import annotations

import csv
import gzip
import io
import math
import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from twin.channels import COMMANDS, MEASUREMENTS, TIME
from twin.logs.columns import EMPTY, Array
from twin.logs.dates import Clock, with_zeros
from twin.logs.errors import LogError
from twin.logs.kinds import kind_of

__all__ = [
    "CsvFile",
    "as_numbers",
    "cannot_be_read",
    "hemispheres",
    "is_number",
    "number_of",
    "opened",
    "shorten",
    "twice_said",
    "units_line",
]

_BLOCK_BYTES = 1 << 20
"""A piece of a CSV file, whose rows take little memory even if they are blank or short."""

_BLANK_MAX = 1000
"""Most blank lines before the header."""

_REMARKS = ("#", "%", "//", "sep=")
_REMARK_LINES = 100
"""What lines of comments begin with, and the most of them that are looked at."""

_LOOK = 1000
"""First rows in which a surplus cell is refused where all columns are looked at."""

_SIDE = r"(N(?:ORTH)?|S(?:OUTH)?|E(?:AST)?|W(?:EST)?)?"

_ANGLE = re.compile(
    rf"{_SIDE}\s*(-?\d+\.?\d*)?(\s*[°:-]\s*|\s+)?(?:(\d+\.?\d*)\s*['\u2032:-]?\s*)?"
    rf"(?:(\d+\.?\d*)\s*[\"\u2033]?\s*)?{_SIDE}",
    re.ASCII,
)
"""Degrees, and maybe minutes and seconds, with the hemisphere before or behind; or that alone."""

Block = tuple[Array, dict[str, Array], set[str]]
"""Number of each row in the file, the columns, and which of them were dates."""


def shorten(text: str, length: int = 40) -> str:
    """Return a text cut to a length."""
    return text if len(text) <= length else text[: length - 3] + "..."


def number_of(cell: str) -> float | None:
    """Return a cell as a number, NaN if it is empty; None if it is no number."""
    if not cell:
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        return math.nan if cell.strip() in EMPTY else None
    return value if cell.isascii() and "_" not in cell else None  # Python reads more than numbers


def _numbers_of(cells: Sequence[str]) -> list[float | None]:
    """Return cells as numbers as :func:`number_of` does, fast where all are plain."""
    text = "".join(cells)
    if text.isascii() and "_" not in text:
        try:
            return [float(cell) if cell else math.nan for cell in cells]
        except ValueError:
            pass
    return [number_of(cell) for cell in cells]


def as_numbers(
    columns: Mapping[str, Array | Sequence[str]], clock: Clock, lines: Array, file: str, unit: str
) -> dict[str, Array]:
    """Return columns as numbers, dates as seconds since 1970; refuse any other text.

    Parameters
    ----------
    columns : mapping of str to ndarray or sequence of str
        By name; texts hold the cells as they stand in the file.
    clock : Clock
        The column of dates, if any.
    lines : ndarray, shape (N,)
        Number of each row in the file.
    file, unit : str
        What messages call the file and its rows.
    """
    numbers: dict[str, Array] = {}
    wrong: tuple[int, str] | None = None
    texts = {name: cells for name, cells in columns.items() if not isinstance(cells, np.ndarray)}
    for name, cells in columns.items():
        if isinstance(cells, np.ndarray):
            numbers[name] = cells
            continue
        if name == clock.date:
            numbers[name] = np.full(len(cells), math.nan)  # read with the time of day
            continue
        values = clock.seconds(texts) if name == clock.column else _numbers_of(cells)
        if None in values and name != clock.column and (sides := hemispheres(cells)):
            values = sides
        if None in values and (wrong is None or values.index(None) < wrong[0]):
            wrong = values.index(None), name
        numbers[name] = np.array(values, dtype=np.float64)
    if wrong is not None:
        row, name = wrong
        cell = texts[name][row]
        if row == 0 and (units := units_line(texts)):
            raise LogError(f"{file}: {unit} {int(lines[0])} {units}")
        what = "date and time" if name == clock.column else "number"
        timed = name in (clock.column, TIME)
        remedy = "remove the row" if timed else "leave the cell empty where there is no value"
        if re.fullmatch(r"\s*-?\d+,\d+\s*", cell):
            remedy = "if the comma is the decimal mark, separate the cells by semicolons or tabs"
        raise LogError(
            f"{file}: column {name}, {unit} {int(lines[row])}: {shorten(cell)!r} is "
            f"not a {what}; correct it, or {remedy}"
        )
    return numbers


def hemispheres(cells: Sequence[str]) -> list[float | None]:
    """Return degrees with a hemisphere, or its sign alone; NaN of empty cells, [] of other text."""
    found: list[float | None] = []
    for cell in cells:
        match = _ANGLE.fullmatch(cell.strip().upper())
        if cell.strip() in EMPTY:
            found.append(math.nan)
        elif match is None or not (match[1] or match[6] or "°" in cell):
            return []
        else:
            side = match[1] or match[6] or "N" if (match[2] or "")[:1] != "-" else "S"
            parts = [abs(float(part or 0.0)) for part in (match[2] or 1.0, match[4], match[5])]
            size = parts[0] + parts[1] / 60.0 + parts[2] / 3600.0
            found.append(-size if side[0] in "SW" else size)
    return found


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """Open a file, plain or gzipped; turn the errors of a damaged one into one with a remedy."""
    try:
        with path.open("rb") as file:
            start = file.read(2)
        packed = start == b"\x1f\x8b"
        if path.suffix == ".gz" and start and not packed:
            raise LogError(
                f"{path}: is not a gzip file although its name ends in .gz; compress it with "
                "gzip or drop the .gz"
            )
        with gzip.open(path, "rb") if packed else path.open("rb") as file:
            yield file  # type: ignore[misc]
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise LogError(
            f"{path}: the gzip file is damaged or cut off ({error}); copy it again, or rescue its "
            f"start with: zcat {path.name} > rescued.csv"
        ) from None
    except OSError as error:
        raise cannot_be_read(path, error) from None


class CsvFile:
    """A CSV file, plain or gzipped; LogError where it is none with a header.

    Cells are separated by commas; or by semicolons, tabs or bars, where a comma may be the decimal
    mark.
    """

    unit = "line"  # what messages call a row
    head: str  # what messages call the header
    first: int  # number of the first row

    def __init__(self, path: Path) -> None:
        self.path, self.source, self.torn = path, str(path), False
        self.zeros = ""  # column of times whose fractions of a second lack zeros in front
        with opened(path) as file:
            blank, self.mark, self.header = _read_header(path, file)
        self.head, self.first = f"line {blank + 1}", blank + 2

    def blocks(self, sources: Sequence[str], clock: Clock) -> Iterator[Block]:
        """Yield the columns named, in pieces of whole lines; ``clock`` holds dates, if any."""
        wanted = [j for j, name in enumerate(self.header) if name in sources]
        first = self.first
        with opened(self.path) as file:
            for _ in range(first - 1):
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
                columns = self._cells(text, first, wanted)
                lines = np.arange(first, first + len(columns[0]), dtype=np.float64)
                named = dict(zip((self.header[j] for j in wanted), columns, strict=True))
                if self.zeros:
                    named[self.zeros] = with_zeros(named[self.zeros])
                numbers = as_numbers(named, clock, lines, self.source, self.unit)
                yield lines, numbers, {clock.column} & set(numbers)
                first += text.count(b"\n")

    def _cells(self, text: bytes, first: int, wanted: Sequence[int]) -> list[list[str]]:
        """Return the cells of the wanted columns of lines, with a point in decimals.

        Missing cells are empty. Surplus ones are left out, unless every column is wanted.
        """
        width = len(self.header)
        if not (cells := _plain_cells(text, self.mark, width)):
            reader = _reader(text, self.mark)
            try:
                rows = list(reader)
            except csv.Error as error:
                raise LogError(
                    f"{self.source}: line {first - 1 + reader.line_num}: {error}; check the "
                    "quotation marks up to there"
                ) from None
            if len(wanted) == width and max(map(len, rows), default=0) > width:
                ragged = ragged_line(text, first, width, self.mark)
                raise LogError(f"{self.source}: {ragged}")
            whole = [row[:width] + [""] * (width - len(row)) for row in rows]
            cells = [cell for row in whole for cell in row]
        columns = [cells[j::width] for j in wanted]
        return columns if self.mark == "," else [with_points(column) for column in columns]

    def texts(self, rows: int) -> dict[str, list[str]]:
        """Return the cells of the first rows, by column; of equal names, the first one's."""
        with opened(self.path) as file:
            for _ in range(self.first - 1):
                file.readline()
            lines = [file.readline() for _ in range(rows)]
        # a surplus comma would shift the cells: of "Fri, 05 Apr", or of seconds with a comma
        look = b"".join(lines[:_LOOK])
        if ragged := ragged_line(look, self.first, len(self.header), self.mark):
            raise LogError(f"{self.source}: {ragged}, or put cells that hold a comma in quotes")
        names = list(dict.fromkeys(self.header))
        wanted = [self.header.index(name) for name in names]
        return dict(zip(names, self._cells(b"".join(lines), self.first, wanted), strict=True))


def _lines(text: bytes) -> str:
    """Return lines as text; a carriage return within one counts as a space."""
    return text.decode("utf-8", "replace").replace("\r\n", "\n").replace("\r", " ")


def _reader(text: bytes, mark: str) -> Any:
    """Return a reader of lines."""
    return csv.reader(io.StringIO(_lines(text), newline="\n"), delimiter=mark, strict=True)


def _plain_cells(text: bytes, mark: str, width: int) -> list[str]:
    """Return the cells of lines, one line after the other.

    Nothing where one has quotes or another number of cells: that takes a reader.
    """
    lines = _lines(text).removesuffix("\n").split("\n")
    plain = text and b'"' not in text and all(line.count(mark) == width - 1 for line in lines)
    return mark.join(lines).split(mark) if plain else []


def twice_said(source: str | Path, name: str, place: str) -> str:
    """Return the complaint about a column whose name stands twice in the header."""
    return f"{source}: column {name} stands twice in {place}; remove or rename one of them"


def units_line(columns: Mapping[str, Sequence[str]]) -> str:
    """Return the complaint about units in the first row of columns, or nothing."""
    first = [values[0].strip() for values in columns.values() if len(values) > 1]
    second = [values[1].strip() for values in columns.values() if len(values) > 1]
    words = [text for text in first if text not in EMPTY]
    short = len(words) > 1 and all(len(text) < 16 for text in words)
    if not short or any(re.search(r"\d{2}", text) or is_number(text) for text in words):
        return ""
    if not any(is_number(text) for text in second):
        return ""
    return f"holds units or other words ({shorten(', '.join(words))}), not values; remove this line"


def with_points(cells: list[str]) -> list[str]:
    """Return cells of a column with a point where a digit follows a comma, as decimals have.

    A column in which numbers have both stays as it is: there a comma may part thousands.
    """
    commas = [cell for cell in cells if "," in cell]
    if not commas:
        return cells
    numbers = [cell for cell in cells if ":" not in cell]
    if any("," in cell for cell in numbers) and any("." in cell for cell in numbers):
        return cells
    return [re.sub(r",(\d+)", r".\1", cell, count=1) for cell in cells]


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


def _read_header(path: Path, file: BinaryIO) -> tuple[int, str, tuple[str, ...]]:
    """Return the blank lines before the header, what separates cells, and its names."""
    blank = 0
    start = file.read(4096)
    if kind := kind_of(start):
        raise LogError(f"{path}: this is {kind}")
    if b"\0" in start:
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
        for other in ";\t|":
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
    if len(header) == 1 and len(text.split()) > 3:
        raise LogError(
            f"{path}: line {blank + 1}: spaces separate the cells; put commas in their place"
        )
    if 2 * sum(is_number(name) for name in header) > len(header):
        raise LogError(
            f"{path}: line {blank + 1} holds numbers; put a header of column names above them: "
            f"{', '.join((TIME, *COMMANDS, *MEASUREMENTS))}"
        )
    return blank, mark, tuple(name.strip() for name in header)


def _lines_above(text: str, header: Sequence[str], file: BinaryIO) -> int:
    """Return how many lines, from the first on, stand above one with the names of columns."""
    if len(header) > 1 and not text.startswith(_REMARKS):
        return 0
    for above in range(1, _REMARK_LINES):
        line = file.readline(1 << 20)
        if not line:
            return 0
        cells = max(line.count(mark) for mark in (b",", b";", b"\t", b"|")) + 1
        start = line.decode("utf-8", "replace")
        remark, first = start.startswith(_REMARKS), re.split(r"[,;\t|]", start, maxsplit=1)[0]
        if cells > max(len(header), 2) and not remark:
            return above if len(header) == 1 or not is_number(first) else 0
    return 0


def is_number(text: str) -> bool:
    """Return whether a text is a number."""
    return text.strip() not in EMPTY and number_of(text) is not None


def ragged_line(text: bytes, first: int, width: int, mark: str) -> str | None:
    """Return the complaint about the first line with more cells than the header has."""
    reader = _reader(text, mark)
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
