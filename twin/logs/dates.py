"""Formats of dates and times as loggers write them, from the texts."""

from __future__ import annotations

import functools
import math
import re
import unicodedata
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import NamedTuple
from zoneinfo import ZoneInfo

import numpy as np

from twin.logs.columns import EMPTY, Array, Entry
from twin.logs.errors import LogError
from twin.logs.signals import runs_of

__all__ = [
    "MEANINGS",
    "ORDERS",
    "ZONES",
    "Clock",
    "DateFormat",
    "Midnight",
    "ahead_of_utc",
    "date_formats",
    "dates",
    "in_utc",
    "is_day",
    "is_time_of_day",
    "joined",
    "lack_zeros",
    "padded",
    "past_midnight",
    "second_hours",
    "with_zeros",
]

ORDERS = {"day-first": "%d{0}%m{0}{1}", "month-first": "%m{0}%d{0}{1}"}
"""Orders of day and month that a text of two numbers leaves open."""

ZONES = {
    **{"UTC": "+00:00", "GMT": "+00:00", "Z": "+00:00", "WET": "+00:00", "WEST": "+01:00"},
    **{"CET": "+01:00", "MEZ": "+01:00", "CEST": "+02:00", "MESZ": "+02:00", "SAST": "+02:00"},
    **{"MDT": "-06:00", "PDT": "-07:00", "AKST": "-09:00", "AKDT": "-08:00", "BRT": "-03:00"},
    **{"EET": "+02:00", "EEST": "+03:00", "MSK": "+03:00"},
    **{"JST": "+09:00", "KST": "+09:00", "HKT": "+08:00", "SGT": "+08:00", "AWST": "+08:00"},
    **{"AEST": "+10:00", "AEDT": "+11:00", "NZST": "+12:00", "NZDT": "+13:00", "HST": "-10:00"},
}
"""Names of zones that mean one thing; others, such as EST, CST and IST, are those of several."""

MEANINGS = {
    **{"AST": ("-04:00", "+03:00"), "BST": ("+01:00", "+06:00"), "CDT": ("-05:00", "-04:00")},
    **{"CST": ("-06:00", "+08:00"), "EDT": ("-04:00", "+11:00"), "EST": ("-05:00", "+10:00")},
    **{"IST": ("+05:30", "+01:00"), "MST": ("-07:00", "+08:00"), "PST": ("-08:00", "+08:00")},
}
"""What names of several zones mean most often."""

_QUARTER_S = 900.0
"""Zones change on whole quarters of an hour, s."""


def ahead_of_utc(zone: str, shown: float = 0.0, name: str = "") -> float:
    """Return by how much a clock is ahead of UTC when it shows so many seconds since 1970, s.

    Parameters
    ----------
    zone : str
        Hours and minutes, as ``+02:00``, ``2`` and ``UTC-5``; a name that means one thing, as
        ``CEST``; or one of the IANA data base, as ``Europe/Berlin``. Empty: UTC.
    shown : float
        What it shows, s; for zones of a place.
    name : str
        What it calls its zone, which of a place is that of standard or of daylight time. Hours and
        minutes are those of standard time, and daylight time is an hour ahead of them.

    Raises
    ------
    LogError
        Where it is no zone, or the name of several.
    """
    zone = ZONES.get(name, zone)
    return _ahead(zone, shown // _QUARTER_S, name) if zone and shown == shown else 0.0


@functools.lru_cache(maxsize=1024)
def _ahead(zone: str, quarter: float, shown_name: str) -> float:
    text, name = ZONES.get(zone.upper(), zone), zone.upper()
    found = re.fullmatch(r"(?:UTC|GMT)?\s*([+-]?)(\d{1,2})(?::?([0-5]\d))?", text, re.IGNORECASE)
    if found is not None and int(found[2]) <= 14:
        size = int(found[2]) + int(found[3] or 0) / 60.0
        daylight = shown_name.endswith("DT") and shown_name not in ZONES
        return 3600.0 * (float(f"{found[1]}1") * size + daylight)
    ahead, place = None, _place(zone)
    if place is not None:
        first = datetime(1970, 1, 1, tzinfo=place) + timedelta(seconds=quarter * _QUARTER_S)
        both = [first, first.replace(fold=1)]
        ahead = next((at for at in both if at.tzname() == shown_name), first).utcoffset()
    if ahead is None:
        hours = " or ".join(MEANINGS.get(name, ("-05:00", "+09:30")))
        raise LogError(
            f"zone {zone!r}: write how far the clock is ahead of UTC, such as {hours}, or its "
            "place, such as Europe/Berlin"
        )
    return ahead.total_seconds()


def _place(zone: str) -> ZoneInfo | None:
    """Return a zone of the IANA data base."""
    if zone and zone.upper() not in {**MEANINGS, **ZONES}:
        with suppress(ValueError, LookupError, OSError):  # a path, no such name, a folder
            return ZoneInfo(zone)
    return None


def in_utc(shown: Array, texts: Sequence[str], form: str, zone: str) -> Array:
    """Return times since 1970, s, of a zone's clock that shows texts (N,) of a format."""
    if not zone:
        return shown
    names = [""] * len(texts)
    if "%Z" in form or _place(zone):
        names = [re.sub(r".*?([A-Z]*)\W*$", r"\1", text) for text in texts]
    ahead = [ahead_of_utc(zone, *each) for each in zip(shown.tolist(), names, strict=True)]
    return np.asarray(shown - np.array(ahead))


def second_hours(stamps: Array, zone: str) -> tuple[Array, bool]:
    """Return what to add to times (N,), s, of a place's clock that was set back.

    In autumn an hour comes twice, and is taken for the first one in the times since 1970. It is the
    second one behind a step back, and where the clock goes on behind it as if no hour lay between.
    Times that all lie within it do not tell which one it is: then the flag is True.
    """
    more, place = np.zeros(len(stamps)), _place(zone)
    if place is None:
        return more, False
    known = np.nan_to_num(stamps).clip(0.0, 2e11)  # dates end with the year 9999
    quarters, of = np.unique(known // _QUARTER_S, return_inverse=True)
    begin = datetime(1970, 1, 1, tzinfo=UTC)
    hours = []
    for quarter in quarters.tolist():
        at = (begin + timedelta(seconds=quarter * _QUARTER_S)).astimezone(place)
        later = (at.utcoffset() or timedelta()) - (at.replace(fold=1).utcoffset() or timedelta())
        hours.append(0.0 if at.fold else max(later.total_seconds(), 0.0))
    twice, step = np.array(hours)[of], np.diff(stamps)
    for first, end in runs_of(twice > 0.0):
        hour = float(twice[first])
        back = np.flatnonzero(step[first : end - 1] < -0.5 * hour)
        goes_on = end < len(stamps) and 0.0 < step[end - 1] - hour < 0.5 * hour
        if len(back) or goes_on:
            more[first + int(np.append(back + 1, 0)[0]) : end] = hour
    return more, bool((twice[np.isfinite(stamps)] > 0.0).all()) and not more.any()


_CLOCK = re.compile(
    # points stand for colons where there are seconds
    r"(?<!\d)(?P<hour>\d{1,2})(?P<mark>:|\.(?=\d\d\.\d\d(?!\d)))(?P<minute>\d{2})"
    r"(?P<second>(?P=mark)\d{2})?(?P<part>[.,:]\d+)?"
    r"(?:\s*(?P<half>[AaPp]\.?[Mm]\.?))?(?P<gap>\s*)"
    r"(?P<zone>Z|\(?(?:UTC|GMT)?[+-]\d{1,2}(?::?\d{2})?\)?|\(?[A-Z]{2,5}\)?|"
    r"[A-Z][a-z]+/[A-Za-z_/]+)?$"
)

_COMPACT = re.compile(r"^(\d{8}|\d{6})([ T_-]?)(\d{6})(\.\d+)?(Z|[+-]\d{2}:?\d{2})?$")

_NUMBERS = re.compile(r"^(\d{1,2})([/.\-])(\d{1,2})\2(\d{4}|\d{2})$")

_WORD = r"[A-Za-z\u00c0-\u024f]"

_SHORT_NUMBER = re.compile(r"\d{1,5}(\.\d+)?$", re.ASCII)

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
    zone: str = ""  # of the clock, for ahead_of_utc

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

    def seconds(self, texts: Mapping[str, Sequence[str]]) -> list[float | None]:
        """Return the seconds since 1970 of some rows; NaN of empty cells, None of other text."""
        cells = [cell.strip() for cell in texts[self.column]]
        whole = joined(texts[self.date], cells) if self.date else cells
        form = self.format
        if not form:  # ISO 8601, or day, month and year, as the first text has it
            first = next((text for text in whole if text.strip() not in EMPTY), "")
            forms = [each.format for each in _candidates(first) if each.order and not each.zone]
            form = forms[0] if forms and "%Y" in forms[0] and "%I" not in forms[0] else ""
        seconds = in_utc(dates(whole, form), whole, form, self.zone).tolist()
        return [
            math.nan if cell in EMPTY else None if math.isnan(second) else second
            for cell, second in zip(cells, seconds, strict=True)
        ]


def joined(days: Sequence[str], clocks: Sequence[str]) -> list[str]:
    """Return texts of dates and of times of day as one; numbers may lack zeros in front."""
    return [
        f"{padded(day.strip())} {padded(clock.strip())}"
        for day, clock in zip(days, clocks, strict=True)
    ]


def padded(text: str) -> str:
    """Return a whole number or a decimal with six digits before the point, at least."""
    if not _SHORT_NUMBER.match(text):
        return text
    whole, point, part = text.partition(".")
    return whole.zfill(6) + point + part


_FRACTION = re.compile(r"((?::|\.\d\d\.|[ T]\d{4})\d{1,2}|^\s*\d+(?=\.\d+\s*$))\.(\d+)", re.ASCII)
"""The fraction of a second, behind seconds or a whole number."""


def with_zeros(cells: Sequence[str]) -> list[str]:
    """Return times whose fractions of a second have as many digits as the longest, zeros in front.

    Loggers that print seconds, a point, and a count of milliseconds or nanoseconds leave them out.
    """
    found = (_FRACTION.search(cell) for cell in cells)
    digits = max((len(each[2]) for each in found if each), default=0)
    return [_FRACTION.sub(lambda m: f"{m[1]}.{m[2].zfill(digits)}", cell, 1) for cell in cells]


def lack_zeros(stamps: Array, padded: Array) -> bool:
    """Return whether times go back, but with zeros in front of their fractions always advance."""
    one, other = (np.diff(each[np.isfinite(each)]) for each in (stamps, padded))
    return bool(len(one) == len(other) and (one < 0.0).any() and (other > 0.0).all())


def _undated(form: str) -> bool:
    return bool(form) and "%d" not in form and "%j" not in form


def dates(texts: Sequence[str], form: str = "") -> Array:
    """Return dates as seconds since 1970 (N,), those without a zone as UTC; NaN for other text.

    Parameters
    ----------
    texts : sequence of str
        Dates and times.
    form : str
        Their format in the letters of ``strftime`` and, for parts of a second and zones, those of
        chrono: ``%.f``, ``%3f``, ``%#z``. Empty for ISO 8601. One without a day counts from
        midnight.
    """
    if _undated(form):
        padding = form.startswith("%H%M")
        texts = [f"1970-01-01 {padded(text) if padding else text}" for text in texts]
        form = f"%Y-%m-%d {form}"
    pattern = _pattern(form) if form else _ISO
    return np.array([_seconds(pattern.fullmatch(text)) for text in texts], dtype=np.float64)


_PARTS = {
    "%Y": r"(?P<year>\d{4})",
    "%y": r"(?P<short_year>\d{2})",
    "%m": r"(?P<month>\d{1,2})",
    "%b": rf"(?P<month_name>{_WORD}{{3,10}})\.?",
    "%d": r"\s*(?P<day>\d{1,2})",
    "%j": r"(?P<day_of_year>\d{1,3})",
    "%a": rf"{_WORD}{{2,10}}\.?",
    "%H": r"\s*(?P<hour>\d{1,2})",
    "%M": r"(?P<minute>\d{1,2})",
    "%S": r"(?P<second>\d{1,2})",
    "%p": r"(?P<half>[AaPp])\.?[Mm]\.?",
    "%f": r"(?P<part>\d{1,9})",
    "%.f": r"(?:\.(?P<part>\d+))?",
    "%z": rf"(?P<zone>{'|'.join(ZONES)}|[+-]\d{{1,2}}(?::?[0-5]\d)?)",
    "%Z": r"[A-Za-z]+",
    "%s": r"(?P<unix>-?\d+)",
    "%%": "%",
}
"""Letters of a format, and what they stand for in a text."""

_ISO = re.compile(
    # with dashes or slashes, or without a mark where T follows
    rf"{_PARTS['%Y']}([-/]|(?=\d{{4}}T)){_PARTS['%m']}\2{_PARTS['%d']}"
    rf"(?:[T ]{_PARTS['%H']}(:|(?<=T\d\d)){_PARTS['%M']}(?:\6{_PARTS['%S']}{_PARTS['%.f']})?"
    r"(?:\s+(?=Z))?(?P<zone>Z|[+-]\d{2}(?::?\d{2})?)?)?",
    re.ASCII,
)

_SAME = {"%B": "%b", "%e": "%d", "%A": "%a", "%k": "%H", "%I": "%H", "%l": "%H", "%P": "%p"}
_SAME |= {"%:z": "%z", "%#z": "%z", "%F": "%Y-%m-%d", "%T": "%H:%M:%S", "%R": "%H:%M"}
_SAME |= {"%D": "%m/%d/%y", "%h": "%b"}
"""Letters that stand for others."""


@functools.cache
def _pattern(form: str) -> re.Pattern[str]:
    """Return the pattern of texts of a format; of one that is not known, that of none."""
    parts = []
    letters = re.compile(r"%(?:[:#]z|\.?\d?f|.)|\s+|.")
    for part in letters.findall("".join(_SAME.get(each, each) for each in letters.findall(form))):
        digits = re.fullmatch(r"%(\.?)(\d)f", part)
        if digits:
            parts.append(re.escape(digits[1]) + rf"(?P<part>\d{{{digits[2]}}})")
        elif part.startswith("%"):
            parts.append(_PARTS.get(part, "(?!)"))
        else:
            parts.append(r"\s*" if part.isspace() else re.escape(part))
    try:
        return re.compile("".join(parts), re.ASCII)
    except re.error:  # a letter that stands twice
        return re.compile("(?!)")


_MONTHS = (
    *("jan|ene|gen", "feb|fev", "mar|mrz|maa|mrt", "apr|avr|abr", "may|mai|mei|mag|maj"),
    *("jun|juin|giu", "jul|juil|lug", "aug|aou|ago", "sep|set", "oct|okt|ott|out", "nov"),
    "dec|dez|dic|des",
)
"""How names of months begin in English, German, French, Spanish, Italian, Portuguese, Dutch and
Scandinavian languages, without accents."""


def _seconds(match: re.Match[str] | None) -> float:
    """Return the seconds since 1970 of the parts of a date and time; NaN if there is no such."""
    if match is None:
        return math.nan
    part = match.groupdict()
    if part.get("unix"):
        return float(part["unix"])
    hour, minute, second = (int(part.get(key) or 0) for key in ("hour", "minute", "second"))
    if half := part.get("half"):
        if not 1 <= hour <= 12:
            return math.nan
        hour = hour % 12 + 12 * (half in "Pp")
    if hour > 23 or minute > 59 or second > 60:
        return math.nan
    try:
        days = _day(*(part.get(key) for key in _DAY_PARTS))
    except ValueError:
        return math.nan
    micros = int((part.get("part") or "0")[:6].ljust(6, "0"))
    try:
        ahead = int(ahead_of_utc(part.get("zone") or ""))
    except LogError:
        return math.nan
    whole = 86400 * days + 3600 * hour + 60 * minute + second - ahead
    return (10**6 * whole + micros) * 1e-6


_DAY_PARTS = ("year", "short_year", "month", "month_name", "day", "day_of_year")


@functools.lru_cache(maxsize=64)
def _day(
    year: str | None,
    short: str | None,
    month: str | None,
    name: str | None,
    day: str | None,
    of_year: str | None,
) -> int:
    """Return the days since 1970 of the parts of a date; ValueError if there is no such day."""
    if short is not None:
        century = 1900 if int(short) >= 70 else 2000  # as POSIX has it
        year = str(century + int(short))
    if name is not None:
        month = str(_month(name))
    if of_year is not None:
        date = datetime(int(year or ""), 1, 1) + timedelta(days=int(of_year) - 1)
    elif month and day and not int(month) and not int(day):
        return 0  # a clock that was not set
    else:
        date = datetime(int(year or ""), int(month or ""), int(day or ""))
    return (date - datetime(1970, 1, 1)).days


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
    cells = [text.strip() for text in texts if text.strip()]
    if not cells:
        return []
    if all(re.match(r"\d{4}-\d{2}-\d{2}", text) for text in cells) and _fits(cells, ""):
        return [DateFormat("")]
    forms = _candidates(cells[0])
    found = [each for each in forms if _fits(cells, each.format)]
    name = re.compile(r"(?<=[\s(])[A-Z]{2,5}(?=\)?$)")
    for sign in ("%#z", "%Z"):  # at the change of clocks the name of the zone changes
        if not found:
            names = {each[0] for cell in cells if (each := name.search(cell))} - {*ZONES}
            zone = max(names, default="")  # of EDT and EST the standard one
            given = [DateFormat(name.sub(sign, f.format), f.order, zone) for f in forms]
            found = [each for each in given if _fits(cells, each.format)]
    if len(found) == 2:
        # of two, the one in which the log would jump by a month is wrong
        spans = [_span(cells, each.format) for each in found]
        if min(spans) > 0.0 and max(spans) > 5.0 * min(spans):
            found = [found[spans.index(min(spans))]]
        return found
    return [DateFormat(each.format, "", each.zone) for each in found]


def _fits(cells: Sequence[str], form: str) -> bool:
    return not np.isnan(dates(cells, form)).any()


def _span(cells: Sequence[str], form: str) -> float:
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
    if year := re.search(r":\d\d(?:\.\d+)?(\D*)( \d{4})$", text):  # of C: the year comes last
        start, zone = text[: year.start(1)], year[1]
        start = f"{start[: start.index(':') - 2].rstrip()}{year[2]}{start[start.index(':') - 3 :]}"
        found = _candidates(start + zone)
        moved = (each.format.replace(" %Y", "", 1) + " %Y" for each in found)
        return [replace(each, format=form) for each, form in zip(found, moved, strict=True)]
    clock, day, zone = "", text, ""
    match = _CLOCK.search(text)
    if match is not None:
        day = text[: match.start()].rstrip(" T,")
        gap = text[len(day) : match.start()]
        mark = match["mark"]
        clock = gap + ("%I" if match["half"] else "%H") + f"{mark}%M"
        part = match["part"] or "."
        if part[0] != "." and len(part) not in (4, 7, 10):
            return []
        clock += f"{mark}%S" + ("%.f" if part[0] == "." else f"{part[0]}%{len(part) - 1}f")
        if not match["second"]:
            if match["part"]:
                return []
            clock = clock.removesuffix(":%S%.f")
        tail = text[match.start() :]
        if match["half"]:
            clock += (" " if re.search(r"\s[AaPp]", tail) else "") + "%p"
        if name := match["zone"]:
            ahead, plain = re.search(r"^Z$|[+-][\d:]*", name), name.strip("()")
            clock += match["gap"][:1]
            clock += f"{name[: ahead.start()]}%#z{name[ahead.end() :]}" if ahead else name
            zone = "" if ahead or ZONES.get(plain) == "+00:00" else plain
    return [DateFormat(form + clock, order, zone) for form, order in _days(day)]


def _days(day: str) -> list[tuple[str, str]]:
    """Return formats of the form of a day, with the order of day and month."""
    if not day:
        return [("", "")]
    numbers = _NUMBERS.match(day)
    if numbers is not None:
        year = "%Y" if len(numbers[4]) == 4 else "%y"
        return [(pattern.format(numbers[2], year), order) for order, pattern in ORDERS.items()]
    if form := _named(day):
        return [(form, "")]
    if (match := re.match(r"^\d{4}([/.\-]?)\d{1,2}\1\d{1,2}$", day)) and (
        match[1] or len(day) == 8
    ):
        return [(f"%Y{match[1]}%m{match[1]}%d", "")]
    return []


def _named(day: str) -> str:
    """Return the format of a day whose month is a name; empty where it is none."""
    form, found = "", list[str]()
    parts = re.findall(rf"{_WORD}{{2,}}(?:\.(?=\s))?|\d+|.", day)
    months = sum(_month(part) > 0 for part in parts)  # a Tuesday may be "mar", too
    for part in parts:
        letter = ""
        if part.isdigit():
            letter = "%Y" if len(part) == 4 else "%y" if "%d" in found else "%d"
        elif _month(part) and (form or months == 1):
            letter = "%b"
        elif not form and len(part) > 1:
            letter = "%a"
        found += [letter] * bool(letter)
        form += letter or part
    whole = sorted(found, key=str.lower)[-3:]
    return form if len(found) < 5 and whole in (["%b", "%d", "%Y"], ["%b", "%d", "%y"]) else ""


def _month(name: str) -> int:
    """Return the number of the month of a name; 0 where it is none."""
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    found = (k for k, begin in enumerate(_MONTHS, 1) if re.match(begin, plain))
    return next(found, 0)


def is_day(text: str) -> bool:
    """Return whether a text is a date without a time."""
    return bool(re.fullmatch(r"\d{8}|\d{6}", text) or (text and _days(text)))


def is_time_of_day(text: str) -> bool:
    """Return whether a text is a time without a date, as 11:58:00.2."""
    match = _CLOCK.match(text)
    return match is not None and match.end() == len(text)
