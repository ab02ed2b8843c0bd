"""The cells of an unknown log, and the lines of the mapping that is proposed for it."""

from __future__ import annotations

import gzip
import io
import json
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twin.logs.columns import Array
from twin.logs.dates import DateFormat
from twin.logs.errors import LogError
from twin.logs.files import (
    EMPTY,
    CsvFile,
    ParquetFile,
    ragged_line,
    twice_said,
    units_line,
    with_points,
)
from twin.logs.proposal.header_words import NAMES, is_turn_rate, means, words_of

if TYPE_CHECKING:
    import polars as pl

__all__ = [
    "Columns",
    "Proposal",
    "add_line",
    "clean",
    "entry",
    "known",
    "pick",
    "put",
    "read_columns",
]

_ROWS, _LOOK = 200_000, 1000
"""Rows that are looked at, and those whose cells are counted."""


@dataclass
class Columns:
    """Cells of a file: as text, and as numbers where they are numbers."""

    text: pl.DataFrame
    numbers: dict[str, Array]
    left: list[str]
    twice: dict[str, str] = field(default_factory=dict)  # names that stand twice: the complaint

    def take(self, name: str) -> str:
        """Return a column's name, and take it out of those that are left."""
        if name in self.twice:
            raise LogError(self.twice[name])
        self.left.remove(name)
        return name


def _text_of(file: ParquetFile) -> pl.DataFrame:
    """Return the first rows of a file as text, without columns of lists."""
    import polars as pl

    parts: list[pl.DataFrame] = []
    for frame in file.frames(file.header, _ROWS):
        plain = [name for name, kind in frame.schema.items() if not kind.is_nested()]
        parts.append(frame.select(pl.col(plain).cast(pl.String)))
        if sum(part.height for part in parts) >= _ROWS:
            break
    return pl.concat(parts).head(_ROWS)


def read_columns(path: Path) -> Columns:
    """Return the cells of the first rows of a file."""
    import polars as pl

    twice: dict[str, str] = {}
    if path.suffix == ".parquet":
        frame = _text_of(ParquetFile(path))
    else:
        file = CsvFile(path)
        with gzip.open(path, "rb") if file.packed else path.open("rb") as raw:
            for _ in range(file.blank):
                raw.readline()
            lines = [raw.readline() for _ in range(_ROWS)]
        # a surplus comma would shift the cells: of "Fri, 05 Apr", or of seconds with a comma
        ragged = ragged_line(b"".join(lines[1:_LOOK]), file.blank + 2, len(file.header), file.mark)
        if ragged:
            raise LogError(f"{path}: {ragged}, or put cells that hold a comma in quotes")
        try:
            frame = pl.read_csv(
                io.BytesIO(b"".join(lines)),
                infer_schema=False,
                separator=file.mark,
                encoding="utf8-lossy",
                truncate_ragged_lines=True,
            )
            frame = frame if file.mark == "," else with_points(frame)
        except pl.exceptions.PolarsError as error:
            raise LogError(f"{path}: {str(error).splitlines()[0]}") from None
        first = [j for j, name in enumerate(file.header) if name not in file.header[:j]]
        frame = frame[:, first]
        frame.columns = [file.header[j] for j in first]
        twice = {
            name: twice_said(path, name, f"line {file.blank + 1}")
            for name in set(file.header)
            if file.header.count(name) > 1
        }
    numbers = {}
    for name in frame.columns:
        cells = frame[name].str.strip_chars()
        cells = cells.set(cells.is_in(EMPTY), None)
        values = cells.cast(pl.Float64, strict=False)
        filled = int((cells.is_not_null() & (cells != "")).sum())
        if filled and values.is_not_null().sum() > 9 * filled // 10:
            numbers[name] = values.to_numpy().astype(np.float64, copy=False)
    if len(numbers) > 1 and (units := units_line({name: frame[name] for name in frame.columns})):
        place = "row 1" if path.suffix == ".parquet" else f"line {file.blank + 2}"
        raise LogError(f"{path}: {place} {units}")
    return Columns(frame, numbers, list(frame.columns), twice)


def pick(columns: Columns, meaning: str, *, numeric: bool = True) -> str | None:
    """Return the first column of a meaning, shorter names first."""
    there = [
        name
        for name in columns.left
        if (name in columns.numbers or not numeric)
        and (means(name, NAMES[meaning]) or (meaning == "gyro" and is_turn_rate(name)))
        and "rpm" not in words_of(name)  # the r of rpm_r is a side
        # a yaw rate is neither a heading nor a speed
        and not (meaning in ("heading", "speed") and is_turn_rate(name))
    ]
    exact = [name for name in there if re.fullmatch(NAMES[meaning], "".join(words_of(name)[:1]))]
    return min(exact or there, key=lambda name: len(words_of(name)), default=None)


def entry(name: str, source: str, unit: str = "", more: str = "", why: str = "") -> str:
    """Return a line of a table."""
    parts = [f"from = {json.dumps(source, ensure_ascii=False)}"]
    parts += [f'unit = "{unit}"'] if unit else []
    parts += [more] if more else []
    value = f"{{ {', '.join(parts)} }}" if len(parts) > 1 else parts[0].removeprefix("from = ")
    return f"{name} = {value}" + (f"  # {why}" if why else "")


def add_line(found: Proposal, table: str, line: str) -> None:
    """Add a line to a table of the mapping."""
    found.lines.setdefault(table, []).append(line)


def put(
    columns: Columns,
    found: Proposal,
    target: str,
    name: str,
    unit: str = "",
    more: str = "",
    why: str = "",
    *,
    table: str = "columns",
) -> None:
    """Take a column, and add the line that makes a column of the log of it."""
    add_line(found, table, entry(target, columns.take(name), unit, more, why))


def known(values: Array) -> Array:
    """Return the values that are finite."""
    return values[np.isfinite(values)]


def clean(t: Array, values: Array) -> tuple[Array, Array]:
    """Return the rows whose time advances and whose values are new."""
    table = values if values.ndim == 2 else values[:, None]
    ok = np.isfinite(t) & np.isfinite(table).all(axis=1)
    t, values, table = t[ok], values[ok], table[ok]
    new = np.ones(len(t), dtype=np.bool_)
    new[1:] = t[1:] > np.maximum.accumulate(t)[:-1]
    new[1:] &= (table[1:] != table[:-1]).any(axis=1)
    return t[new], values[new]


@dataclass
class Proposal:
    """A mapping file to begin with.

    Parameters
    ----------
    lines : dict of str to list of str
        Lines of each table of the file.
    missing : list of str
        What each log needs, and no column seems to hold.
    questions : list of str
        What the values leave open.
    choices : list of DateFormat
        Two formats, where day and month are open.
    zone : str
        The name of a zone, where it means several.
    """

    lines: dict[str, list[str]] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)
    questions: list[str] = field(default_factory=list)
    choices: list[DateFormat] = field(default_factory=list)
    zone: str = ""

    def text(self, source: str) -> str:
        """Return the text of the mapping file."""
        out = [f"# Proposed for {source} by usv-twin mapping: check every line."]
        out += [f"# ? {question}" for question in self.questions]
        for table in ("columns", "position", "velocity"):
            rows = list(self.lines.get(table, []))
            if table == "columns":
                rows += [f"# {name} = ?    # no column seems to hold it" for name in self.missing]
            if rows:
                out += ["", f"[{table}]", *rows]
        return "\n".join(out) + "\n"
