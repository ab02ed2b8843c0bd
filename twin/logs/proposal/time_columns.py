"""Which columns of an unknown log hold the time, and how they are written."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from twin.logs.clock import HOUR_S, hours_of, wild_stamps
from twin.logs.columns import Array
from twin.logs.dates import (
    MEANINGS,
    ZONES,
    DateFormat,
    ahead_of_utc,
    date_formats,
    dates,
    in_utc,
    is_day,
    is_time_of_day,
    joined,
    lack_zeros,
    padded,
    second_hours,
    with_zeros,
)
from twin.logs.errors import LogError
from twin.logs.files import number_of
from twin.logs.proposal.header_words import NAMES, means, unit_of
from twin.logs.proposal.sheet import Proposal

__all__ = ["TimeColumns", "find_time"]

Cells = Mapping[str, Sequence[str]]

_DAY = 86400.0

_DAY_STEP = 5e-4
_DAY_LEAST = 2e4
"""Numbers above the second that rise by less than the first are days, not seconds: no log has 2000
rows a second. Spreadsheets count days from 1900, MATLAB from the year 0."""


_WHOLE_DAY = re.compile(r"(19|20)\d\d(0[1-9]|1[0-2])(0[1-9]|[12]\d|3[01])")
"""Year, month and day in one number."""

_HOURS = re.compile(r":|\d\.\d\d\.\d\d(?!\d)")
"""Marks between hours, minutes and seconds."""

_AHEAD = re.compile(r"(?:\b(?:UTC|GMT)\s*|(?=[+-]\d\d:))([+-]\d{1,2})(?::?(\d\d))?\b")
"""How far a clock is ahead of UTC, in the name of its column."""


@dataclass
class TimeColumns(Proposal):
    """Where the time is, and how to read it, and what is open.

    Parameters
    ----------
    names : tuple of str
        Column of the time, or those of date and time; empty if there is none.
    unit, more, why : str
        Unit, other keys and comment of its line in the mapping.
    seconds : ndarray, shape (N,)
        The time, s.
    """

    names: tuple[str, ...] = ()
    unit: str = ""
    more: str = ""
    why: str = ""
    seconds: Array | None = None


def find_time(
    text: Cells, numbers: dict[str, Array], left: Sequence[str], answers: tuple[str, str]
) -> TimeColumns:
    """Return the time of a log.

    Parameters
    ----------
    text : dict of str to list of str
        Its cells, by column.
    numbers : dict of str to ndarray
        The columns whose cells are numbers.
    left : sequence of str
        Names of the columns that may hold it.
    answers : tuple of str
        Order of day and month, and zone; empty where they are not stated.
    """
    found = TimeColumns()
    counts = [n for n in left if n in numbers and unit_of(n, ("ms", "us", "ns"))]
    counts = [name for name in counts if _is_clock(numbers[name])]
    named = [name for name in left if means(name, NAMES["time"]) or name in counts]
    fine = [numbers[name] for name in named if name in numbers]
    coarse = set[str]()
    for names in _clocks(text, numbers, left, named):
        cells = [cell.strip() for cell in text[names[-1]]]
        if names[-1] in numbers:
            cells = [padded(cell) for cell in cells]
        if len(names) == 2:
            cells = joined(text[names[0]], cells)
        formats = date_formats(cells)
        if formats and not _is_coarse(cells, fine):
            return _dated(found, names, cells, formats, answers)
        coarse |= {*names} if formats else set()
    for name in named:
        if name not in numbers and name not in coarse and (cell := _first(text, name)):
            found.questions.append(
                f"{name}: {cell!r} has no format of date and time that is known, or other rows "
                'have another one; state it: unit = "datetime", format = "%d/%m/%Y %H:%M:%S%.f", '
                "and write months of other languages than those of western Europe as numbers"
            )
    for name in set(named) & set(numbers):
        filled = np.array([number_of(cell) for cell in with_zeros(text[name])], dtype=np.float64)
        numbers = {**numbers, name: _whole(found, name, numbers[name], filled)}
    return _counted(found, numbers, left, named)


def _is_coarse(cells: Sequence[str], others: Sequence[Array]) -> bool:
    """Return whether most rows share their text with the row before, but not their number."""
    repeats = np.mean([one == two for one, two in itertools.pairwise(cells)] or [False])
    return bool(repeats > 0.5) and any((np.diff(_known(each)) > 0.0).all() for each in others)


def _clocks(
    text: Cells, numbers: dict[str, Array], left: Sequence[str], named: Sequence[str]
) -> list[tuple[str, ...]]:
    """Return columns that may hold date and time, the likeliest first."""
    first = {name: _first(text, name) for name in left}
    days = [
        name
        for name in sorted(left, key=lambda name: name not in named)
        if (name in named or name not in numbers or _WHOLE_DAY.fullmatch(first[name]))
        and is_day(first[name])
    ]
    whole = [n for n in left if n not in {*numbers, *days} and _HOURS.search(first[n])]
    whole = [name for name in whole if not is_time_of_day(first[name])]
    whole += [n for n in left if n not in numbers and re.match(r"\d{8}[ T_-]\d{6}", first[n])]
    whole += [n for n in named if n in numbers and re.match(r"(19|20)\d{12}(\.|$)", first[n])]
    times = [n for n in left if n not in numbers and is_time_of_day(first[n])]
    # 08.03.10 may be both, and a day changes at midnight alone
    times = [n for n in times if n not in days or len({*text[n]}) > 2]
    times += [n for n in named if n in numbers and n not in days and _is_hhmmss(numbers[n])]
    whole.sort(key=lambda name: name not in named)
    times.sort(key=lambda name: name not in named)
    pairs = [(day, time) for time in times for day in days if day != time]
    return [*((name,) for name in whole), *pairs, *((name,) for name in times)]


def _first(text: Cells, name: str) -> str:
    """Return the first cell of a column that is not empty."""
    return next((stripped for cell in text[name] if (stripped := cell.strip())), "")


def _is_hhmmss(values: Array) -> bool:
    """Return whether numbers are hours, minutes and seconds in one, as NMEA has them."""
    known = values[np.isfinite(values)]
    if len(known) < 10 or known.min() < 0.0 or known.max() >= 240000.0:
        return False
    minutes, seconds = known // 100.0 % 100.0, known % 100.0
    if (minutes >= 60.0).any() or (seconds >= 60.0).any():
        return False
    # seconds would reach 60 within the minute; within one minute both say the same
    step = np.diff(known)
    return bool((step >= 40.0).any() and np.median(step) < 30.0)


def _dated(
    found: TimeColumns,
    names: tuple[str, ...],
    cells: Sequence[str],
    formats: list[DateFormat],
    answers: tuple[str, str],
) -> TimeColumns:
    """Return the time of cells whose formats are known."""
    order, zone = answers
    example = next(cell for cell in cells if cell.strip())
    title = " and ".join(names)
    if len(formats) > 1:
        chosen = [each for each in formats if each.order == order]
        if not chosen:
            found.choices = formats
            found.questions.append(f"{title}: {example!r}: day first or month first?")
        formats = chosen or formats
    form, name = formats[0].format, formats[0].zone
    found.names, found.unit = names, "datetime"
    found.more = f"format = {json.dumps(form)}" if form else ""
    if "%d" not in form and form:
        found.why = "a time without a date"
        found.questions.append(f"{title}: the log keeps no date; add a column of dates to keep it")
    elif form.startswith("%d%m%y "):
        found.questions.append(f"{names[0]}: taken as day, month, year, as NMEA has it")
    found.seconds = _whole(found, title, dates(cells, form), dates(with_zeros(cells), form))
    first = float(np.append(_known(found.seconds), 0.0)[0])
    stated = re.search(r"%#?z|(UTC|GMT)\)?$", form)
    if not form:  # ISO 8601
        stated = re.search(r":.*(Z|[+-]\d\d(:?\d\d)?)$", example)
    if stated or "%d" not in (form or "%d"):
        zone = ""
    else:
        in_head, name = ("", name) if name else _zone_of(title)
        in_head = in_head or ZONES.get(name, name if "/" in name else "")
        if zone and formats[0].zone in ZONES and zone != in_head:
            found.questions.append(f"{title}: {name} in the cells is taken, and not {zone}")
            zone = ""
        if zone and in_head and ahead_of_utc(zone, first) != ahead_of_utc(in_head, first):
            found.questions.append(f"{title}: {zone} is taken, as asked, though its name says else")
            name = ""
        zone = zone or in_head
        found.why = f"{name} is {zone}" if name != zone and name else ""
        if not zone and name and not formats[0].zone and name not in MEANINGS:
            found.questions.append(f"{title}: {name}: a zone? UTC is taken; else state it: --zone")
            found.why = "dates without a zone count as UTC"
        elif not zone and name:
            found.zone = name
            found.questions.append(
                f"{title}: {example!r}: {name} is the name of several zones: how far ahead of UTC?"
            )
        elif not zone:
            found.why = "dates without a zone count as UTC"
            if re.search(r"local|lokal|ortszeit", title, re.IGNORECASE):
                found.questions.append(f"{title}: local time counts as UTC; state it with --zone")
    found.seconds = in_utc(found.seconds, cells, form, zone)
    found.seconds = found.seconds + second_hours(found.seconds, zone)[0]
    step = np.diff(_known(found.seconds))
    typical = float(np.median(np.abs(step))) if len(step) else 0.0
    for row in np.flatnonzero(np.abs(step - typical) > 0.5 * HOUR_S)[:1].tolist():
        if hours_of(float(step[row]) - typical, typical):
            found.questions.append(
                f"{title}: the clock is set {'back' if step[row] < 0.0 else 'forward'} by an hour "
                f"at row {row + 2}, as local time is; state its place, as --zone Europe/Berlin"
            )
    if zone and zone != "+00:00":
        found.more += f'{", " * bool(found.more)}zone = "{zone}"'
    return found


def _zone_of(title: str) -> tuple[str, str]:
    """Return how far a clock is ahead of UTC by the name of its column, and the zone's name."""
    ahead = _AHEAD.search(title)
    if ahead is not None:
        return f"{ahead[1][0]}{int(ahead[1][1:]):02d}:{ahead[2] or '00'}", ""
    words = re.findall(r"(?<![^\W_])[A-Z]{3,4}(?![^\W_])", title)
    unknown = "".join(re.findall(r"[(\[]([^\W\d][\w/ ]{2,})[)\]]", title)[:1])
    if re.fullmatch(r"[dmyhs/ ]+|.*local.*", unknown, re.IGNORECASE):  # a picture of a date
        unknown = ""
    if "/" in unknown:
        with suppress(LogError):
            ahead_of_utc(unknown)
            return unknown, ""
    return "", next((word for word in words if word in {**ZONES, **MEANINGS}), unknown)


def _whole(found: TimeColumns, title: str, seconds: Array, filled: Array) -> Array:
    """Return times, with zeros in front of their fractions where these lack them."""
    if not lack_zeros(seconds, filled):
        return seconds
    found.questions.append(f"{title}: fractions of a second lack zeros in front, and are read so")
    return filled


def _counted(
    found: TimeColumns, numbers: dict[str, Array], left: Sequence[str], named: Sequence[str]
) -> TimeColumns:
    """Return the time of a column of numbers that rise."""
    there = [name for name in left if name in numbers]
    rising = [name for name in there if (np.diff(_known(numbers[name])) >= 0.0).all()]
    if not set(rising) & set(named):  # a clock may be set, and rows be out of order
        known = {name: _known(numbers[name]) for name in there if name in named}
        unlike = {n: max(len(np.unique(e)), (np.diff(e) > 0.0).sum()) for n, e in known.items()}
        rising += [name for name, count in unlike.items() if 2 * count > len(known[name])]
    if not set(rising) & set(named):
        rising = [name for name in rising[:1] if _is_clock(numbers[name])]
        found.questions += [f"{name}: taken as the time, for it rises steadily" for name in rising]
    if not rising:
        return found
    # of several clocks the finest, and then that of the shortest name
    name = min(
        (name for name in rising if name in named),
        key=lambda name: (-len(np.unique(numbers[name])), len(name)),
        default=rising[0],
    )
    values = numbers[name]
    unit = unit_of(name, ("ms", "us", "ns")) or _time_unit(values)
    scale = {"": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "day": _DAY}[unit]
    start = float(_known(values)[0]) * scale
    found.names, found.unit = (name,), unit
    if start > 1e6:
        found.more, found.why = f"offset = {-start!r}", "counted from the first row"
        if unit == "day":
            found.why = "days, as spreadsheets count them; from the first row on"
    found.seconds = np.asarray(values * scale - (start if found.more else 0.0))
    return found


def _is_clock(values: Array) -> bool:
    """Return whether values of a column rise in each row, most by much the same."""
    step = np.diff(_known(values))
    if len(step) < 10 or (step <= 0.0).any():
        return False
    return bool(np.mean(np.abs(step / np.median(step) - 1.0) < 0.5) > 0.9)


def _time_unit(values: Array) -> str:
    """Return the unit of times without one in the name, from their size and step."""
    known = _known(values)
    step = float(np.median(np.diff(known))) if len(known) > 1 else math.nan
    if known[0] > _DAY_LEAST and 0.0 < step < _DAY_STEP:
        return "day"
    for unit, least, epoch in (("ns", 1e6, 1e17), ("us", 1e3, 1e14), ("ms", 5.0, 1e11)):
        if known[-1] > epoch or (step >= least and unit != "ns"):
            return unit
    return ""


def _known(values: Array) -> Array:
    return values[np.isfinite(values) & ~wild_stamps(values)]
