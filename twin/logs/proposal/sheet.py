"""The cells of an unknown log, and the lines of the mapping that is proposed for it."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from twin.logs.columns import EMPTY, Array
from twin.logs.dates import DateFormat
from twin.logs.errors import LogError
from twin.logs.files import hemispheres, number_of, twice_said, units_line
from twin.logs.marks import NO_PULSES, NO_RPM, RARE, marks_of
from twin.logs.parquet import column_file
from twin.logs.proposal.header_words import (
    AT_THE_COMPASS,
    NAMES,
    OVER_GROUND,
    is_rpm,
    is_setpoint,
    is_steering,
    is_turn_rate,
    means,
    words_of,
)

__all__ = [
    "Columns",
    "Proposal",
    "add_line",
    "clean",
    "entry",
    "is_pulses",
    "known",
    "marked",
    "pick",
    "put",
    "read_columns",
]

_ROWS = 200_000
"""Rows that are looked at."""


@dataclass
class Columns:
    """Cells of a file: as text, and as numbers where they are numbers."""

    text: dict[str, list[str]]
    numbers: dict[str, Array]
    left: list[str]
    twice: dict[str, str] = field(default_factory=dict)  # names that stand twice: the complaint
    # numbers that stand for "no value", by column; they are NaN in numbers
    marks: dict[str, list[float]] = field(default_factory=dict)

    def take(self, name: str) -> str:
        """Return a column's name, and take it out of those that are left."""
        if name in self.twice:
            raise LogError(self.twice[name])
        self.left.remove(name)
        return name


def read_columns(path: Path) -> Columns:
    """Return the cells of the first rows of a file."""
    file = column_file(path)
    text = file.texts(_ROWS)
    twice = {
        name: twice_said(path, name, file.head)
        for name in set(file.header)
        if file.header.count(name) > 1
    }
    numbers = {}
    for name, cells in text.items():
        filled = sum(cell.strip() not in EMPTY for cell in cells)
        values = np.array([number_of(cell) for cell in cells], dtype=np.float64)
        degrees = filled > np.isfinite(values).sum() and re.search(r"\d", "".join(cells))
        if degrees and (angles := hemispheres(cells)):
            values = np.array(angles, dtype=np.float64)
        if filled and np.isfinite(values).sum() > 9 * filled // 10:
            numbers[name] = values
    if len(numbers) > 1 and (units := units_line(text)):
        raise LogError(f"{path}: {file.unit} {file.first} {units}")
    marks = {name: found for name, values in numbers.items() if (found := _marks(name, values))}
    for name, found in marks.items():
        numbers[name] = np.where(np.isin(numbers[name], found), np.nan, numbers[name])
    return Columns(text, numbers, list(text), twice, marks)


_PULSES_US = 800.0, 2200.0
"""Pulse widths that servos and motor controllers take."""

_ANGLES = "heading", "course", "wind_from", "apparent_from"

_SPEEDS = "speed", "wind_speed", "apparent_speed"


def _marks(name: str, values: Array) -> list[float]:
    """Return the numbers of an angle, a speed or a command that are no values."""
    seen = values[np.isfinite(values)]
    pulses = seen[(seen >= _PULSES_US[0]) & (seen <= _PULSES_US[1])]
    none = (seen < _PULSES_US[0]) | (seen > _PULSES_US[1])
    if (
        none.any()
        and not is_rpm(name)
        and (np.isin(seen[none], NO_PULSES).all() or none.mean() < RARE)
    ):
        return np.unique(seen[none]).tolist() if len(pulses) else []
    if is_rpm(name):
        return [mark for mark in marks_of(values, math.inf) if mark in NO_RPM]
    if is_steering(name):  # pulse widths alone are far from each other
        return [mark for mark in marks_of(values, math.inf) if abs(mark) > 90.0 and none.any()]
    if any(means(name, NAMES[word]) for word in _ANGLES):
        # a course of 0 may be that of a boat at rest
        course = not means(name, NAMES["heading"])
        return [mark for mark in marks_of(values, 360.0) if mark != 0.0 or not course]
    return marks_of(values) if any(means(name, NAMES[word]) for word in _SPEEDS) else []


def pick(columns: Columns, meaning: str, *, numeric: bool = True) -> str | None:
    """Return the first column of a meaning, shorter names first."""
    there = [
        name
        for name in columns.left
        if (name in columns.numbers or not numeric)
        and (means(name, NAMES[meaning]) or (meaning == "gyro" and is_turn_rate(name)))
        and "rpm" not in words_of(name)  # the r of rpm_r is a side
        and not is_setpoint(name)
        # a yaw rate is neither a heading nor a speed
        and not (meaning in ("heading", "speed") and is_turn_rate(name))
        and not (meaning == "heading" and means(name, OVER_GROUND))
        and not (meaning == "course" and means(name, AT_THE_COMPASS))
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
    if name in columns.marks:
        numbers = ", ".join(f"{mark:.10g}" for mark in columns.marks[name])
        verb = "is" if len(columns.marks[name]) == 1 else "are"
        what = f"{verb} far from all others, and taken as no value"
        found.questions.append(f"{name}: {numbers} {what}")
    add_line(
        found, table, entry(target, columns.take(name), unit, marked(columns, name, more), why)
    )


def marked(columns: Columns, name: str, more: str) -> str:
    """Return further keys of a line, with the numbers of its column that are no values."""
    numbers = ", ".join(f"{mark:.10g}" for mark in columns.marks.get(name, ()))
    return ", ".join(part for part in (more, f"empty = [{numbers}]" * bool(numbers)) if part)


def known(values: Array) -> Array:
    """Return the values that are finite."""
    return values[np.isfinite(values)]


def is_pulses(values: Array) -> bool:
    """Return whether values are pulse widths of a servo or speed controller, us."""
    there = known(values)
    return bool(len(there) and there.min() >= 800.0 and there.max() <= 2200.0)


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
