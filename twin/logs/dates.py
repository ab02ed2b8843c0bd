"""Formats of dates and times as loggers write them, from the texts."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from twin.logs.columns import Array, Entry

if TYPE_CHECKING:
    import polars as pl

__all__ = [
    "MEANINGS",
    "ORDERS",
    "ZONES",
    "Clock",
    "DateFormat",
    "Midnight",
    "date_formats",
    "dates",
    "is_day",
    "is_time_of_day",
    "joined",
    "padded",
    "past_midnight",
]

ORDERS = {"day-first": "%d{0}%m{0}{1}", "month-first": "%m{0}%d{0}{1}"}
"""Orders of day and month that a text of two numbers leaves open."""

ZONES = {
    **{"UTC": "+00:00", "GMT": "+00:00", "Z": "+00:00", "WET": "+00:00", "WEST": "+01:00"},
    **{"CET": "+01:00", "CEST": "+02:00", "EET": "+02:00", "EEST": "+03:00", "MSK": "+03:00"},
    **{"JST": "+09:00", "KST": "+09:00", "HKT": "+08:00", "SGT": "+08:00", "AWST": "+08:00"},
    **{"AEST": "+10:00", "AEDT": "+11:00", "NZST": "+12:00", "NZDT": "+13:00", "HST": "-10:00"},
}
"""Names of zones that mean one thing; others, such as EST, CST and IST, are those of several."""

MEANINGS = {
    **{"AST": ("-04:00", "+03:00"), "BST": ("+01:00", "+06:00"), "CDT": ("-05:00", "-04:00")},
    **{"CST": ("-06:00", "+08:00"), "EST": ("-05:00", "+10:00"), "IST": ("+05:30", "+01:00")},
    **{"MST": ("-07:00", "+08:00"), "PST": ("-08:00", "+08:00")},
}
"""What names of several zones mean most often."""

_CLOCK = re.compile(
    r"(?P<hour>\d{1,2}):(?P<minute>\d{2})(?P<second>:\d{2})?(?P<part>[.,:]\d+)?"
    r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<zone>Z|[+-]\d{2}(?::?\d{2})?|[A-Z]{2,5})?$"
)

_COMPACT = re.compile(r"^(\d{8}|\d{6})([ T]?)(\d{6})(\.\d+)?(Z|[+-]\d{2}:?\d{2})?$")

_NUMBERS = re.compile(r"^(\d{1,2})([/.\-])(\d{1,2})\2(\d{4}|\d{2})$")

_NAMED = re.compile(r"^([A-Za-z]{3}, )?(\d{1,2})([ \-/.])([A-Za-z]{3,9})\3(\d{4}|\d{2})$")

_DAY = 86400.0


@dataclass(frozen=True)
class DateFormat:
    """A format that all texts of a column have.

    Parameters
    ----------
    format : str
        For ``format`` of a mapping file; empty for ISO 8601.
    order : str
        ``day-first`` or ``month-first``; empty where the format leaves no choice.
    zone : str
        Name of the zone that stands in the format, other than UTC; empty if none does.
    """

    format: str
    order: str = ""
    zone: str = ""


class Clock(NamedTuple):
    """The column that holds dates, if any, and how they are written."""

    column: str
    format: str = ""  # empty for ISO 8601
    date: str = ""  # column of the date, where the other one is a time of day
    zone: float = 0.0  # by which the clock is ahead of UTC, s

    @classmethod
    def of(cls, entry: Entry) -> Clock:
        """Return the clock of the time's entry."""
        if not entry.clock:
            return cls("")
        return cls(entry.sources[0], entry.format, entry.date, entry.zone)

    @property
    def undated(self) -> bool:
        """Whether it says the time of day only."""
        return _undated(self.format) and not self.date

    def seconds(self, frame: pl.DataFrame) -> pl.Series:
        """Return the seconds since 1970 of some rows; null where there is no date."""
        import polars as pl

        text = frame[self.column].cast(pl.String).str.strip_chars()
        if self.date:
            text = joined(frame[self.date].cast(pl.String), text)
        return dates(text, self.format) - self.zone


def joined(day: pl.Series, clock: pl.Series) -> pl.Series:
    """Return texts of dates and of times of day as one; numbers may lack zeros in front."""
    return padded(day.str.strip_chars()) + " " + padded(clock.str.strip_chars())


def padded(text: pl.Series) -> pl.Series:
    """Return texts of whole numbers and decimals with six digits before the point, at least."""
    number = text.str.contains(r"^\d{1,5}(\.\d+)?$").fill_null(False)
    if not number.any():
        return text
    whole = text.str.extract(r"^(\d+)").str.zfill(6) + text.str.extract(r"(\..*)$").fill_null("")
    return text.zip_with(~number, whole)


def _undated(form: str) -> bool:
    return bool(form) and "%d" not in form and "%j" not in form


def dates(text: pl.Series, form: str = "") -> pl.Series:
    """Return dates as seconds since 1970, those without a zone as UTC; null for any other text.

    Parameters
    ----------
    text : Series of str
        Dates and times.
    form : str
        Their format in chrono's letters; empty for ISO 8601. One without a day counts from
        midnight.
    """
    import polars as pl

    if _undated(form):
        text = "1970-01-01 " + (padded(text) if form.startswith("%H%M") else text)
        form = f"%Y-%m-%d {form}"
    try:
        if form and not any(zone in form for zone in ("%z", "%:z", "%#z")):
            date = text.str.to_datetime(form, time_unit="us", strict=False)
        else:
            date = text.str.to_datetime(form or None, time_unit="us", time_zone="UTC", strict=False)
    except pl.exceptions.PolarsError:
        return pl.Series([None] * len(text), dtype=pl.Float64)
    return date.dt.epoch("us").cast(pl.Float64) * 1e-6


@dataclass
class Midnight:
    """How often a clock without a date has passed midnight, and what it said last."""

    days: int = 0
    last: float = math.nan


def past_midnight(seconds: Array, state: Midnight) -> Array:
    """Return times of day that go on where they fall by most of a day."""
    if not len(seconds):
        return seconds
    before = np.concatenate([[state.last], seconds[:-1]])
    days = state.days + np.cumsum(seconds - before < -0.9 * _DAY)
    state.days, state.last = int(days[-1]), float(seconds[-1])
    return np.asarray(seconds + _DAY * days)


def date_formats(texts: Sequence[str]) -> list[DateFormat]:
    """Return the formats that dates may have: none, one, or two where day and month are open.

    Parameters
    ----------
    texts : sequence of str
        Cells of one column; empty ones are left out.
    """
    import polars as pl

    cells = pl.Series([text.strip() for text in texts if text.strip()], dtype=pl.String)
    if not len(cells):
        return []
    if all(re.match(r"\d{4}-\d{2}-\d{2}", text) for text in cells) and _fits(cells, ""):
        return [DateFormat("")]
    found = [each for each in _candidates(cells[0]) if _fits(cells, each.format)]
    if len(found) == 2:
        # of two, the one in which the log would jump by a month is wrong
        spans = [_span(cells, each.format) for each in found]
        if min(spans) > 0.0 and max(spans) > 5.0 * min(spans):
            found = [found[spans.index(min(spans))]]
        return found
    return [DateFormat(each.format, "", each.zone) for each in found]


def _fits(cells: pl.Series, form: str) -> bool:
    return not dates(cells, form).is_null().any()


def _span(cells: pl.Series, form: str) -> float:
    """Return seconds from the first to the last of dates."""
    seconds = dates(cells, form)
    return abs(float(seconds[-1]) - float(seconds[0]))


def _candidates(text: str) -> list[DateFormat]:
    """Return formats of the form of one text, with the order of day and month."""
    compact = _COMPACT.match(text)
    if compact is not None:
        day = "%Y%m%d" if len(compact[1]) == 8 else "%d%m%y"
        clock = f"{compact[2]}%H%M%S%.f" + ("%#z" if compact[5] else "")
        return [DateFormat(day + clock)]
    if re.match(r"^\d{6}(\.\d+)?$", text):
        return [DateFormat("%H%M%S%.f")]
    clock, day, zone = "", text, ""
    match = _CLOCK.search(text)
    if match is not None:
        day = text[: match.start()].rstrip(" T,")
        gap = text[len(day) : match.start()]
        clock = gap + ("%I" if match["half"] else "%H") + ":%M"
        part = match["part"] or "."
        if part[0] != "." and len(part) not in (4, 7, 10):
            return []
        clock += ":%S" + ("%.f" if part[0] == "." else f"{part[0]}%{len(part) - 1}f")
        if not match["second"]:
            if match["part"]:
                return []
            clock = clock.removesuffix(":%S%.f")
        tail = text[match.start() :]
        if match["half"]:
            clock += (" " if re.search(r"\s[AaPp]", tail) else "") + "%p"
        if match["zone"]:
            named = match["zone"].isalpha() and match["zone"] != "Z"
            space = " " if re.search(r"\s(Z|[+-]|[A-Z]+$)", tail[len(match["hour"]) :]) else ""
            clock += space + (match["zone"] if named else "%#z")
            zone = match["zone"] if named and ZONES.get(match["zone"]) != "+00:00" else ""
    return [DateFormat(form + clock, order, zone) for form, order in _days(day)]


def _days(day: str) -> list[tuple[str, str]]:
    """Return formats of the form of a day, with the order of day and month."""
    if not day:
        return [("", "")]
    numbers, named = _NUMBERS.match(day), _NAMED.match(day)
    if numbers is not None:
        year = "%Y" if len(numbers[4]) == 4 else "%y"
        return [(pattern.format(numbers[2], year), order) for order, pattern in ORDERS.items()]
    if named is not None:
        year = "%Y" if len(named[5]) == 4 else "%y"
        month = "%b" if len(named[4]) == 3 else "%B"
        week = "%a, " if named[1] else ""
        return [(f"{week}%d{named[3]}{month}{named[3]}{year}", "")]
    if re.match(r"^\d{4}([/.\-])\d{1,2}\1\d{1,2}$", day):
        mark = day[4]
        return [(f"%Y{mark}%m{mark}%d", "")]
    return []


def is_day(text: str) -> bool:
    """Return whether a text is a date without a time."""
    return bool(re.fullmatch(r"\d{8}|\d{6}", text) or (text and _days(text)))


def is_time_of_day(text: str) -> bool:
    """Return whether a text is a time without a date, as 11:58:00.2."""
    match = _CLOCK.match(text)
    return match is not None and match.end() == len(text)
