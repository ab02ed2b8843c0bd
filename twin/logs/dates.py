"""Formats of dates and times as loggers write them, from the texts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from twin.logs.readers import dates

if TYPE_CHECKING:
    import polars as pl

__all__ = [
    "ORDERS",
    "DateFormat",
    "date_formats",
]

ORDERS = {"day-first": "%d{0}%m{0}{1}", "month-first": "%m{0}%d{0}{1}"}
"""Orders of day and month that a text of two numbers leaves open."""

_CLOCK = re.compile(
    r"(?P<hour>\d{1,2}):(?P<minute>\d{2})(?P<second>:\d{2})?(?P<part>\.\d+)?"
    r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<zone>Z|[+-]\d{2}:?\d{2})?$"
)

_NUMBERS = re.compile(r"^(\d{1,2})([/.\-])(\d{1,2})\2(\d{4}|\d{2})$")

_NAMED = re.compile(r"^(\d{1,2})([ \-/.])([A-Za-z]{3,9})\2(\d{4}|\d{2})$")


@dataclass(frozen=True)
class DateFormat:
    """A format that all texts of a column have.

    Parameters
    ----------
    format : str
        For ``format`` of a mapping file; empty for ISO 8601.
    order : str
        ``day-first`` or ``month-first``; empty where the format leaves no choice.
    """

    format: str
    order: str = ""


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
    found = [DateFormat(form, order) for form, order in _candidates(cells[0]) if _fits(cells, form)]
    if len(found) == 2:
        # of two, the one in which the log would jump by a month is wrong
        spans = [_span(cells, each.format) for each in found]
        if min(spans) > 0.0 and max(spans) > 5.0 * min(spans):
            found = [found[spans.index(min(spans))]]
        return found
    return [DateFormat(each.format) for each in found]


def _fits(cells: pl.Series, form: str) -> bool:
    return not dates(cells, form).is_null().any()


def _span(cells: pl.Series, form: str) -> float:
    """Return seconds from the first to the last of dates."""
    seconds = dates(cells, form)
    return abs(float(seconds[-1]) - float(seconds[0]))


def _candidates(text: str) -> list[tuple[str, str]]:
    """Return formats of the form of one text, with the order of day and month."""
    clock, day = "", text
    match = _CLOCK.search(text)
    if match is not None:
        day = text[: match.start()].rstrip(" T,")
        gap = text[len(day) : match.start()]
        clock = gap + ("%I" if match["half"] else "%H") + ":%M"
        clock += ":%S%.f" if match["second"] else ""
        tail = text[match.start() :]
        if match["half"]:
            clock += (" " if re.search(r"\s[AaPp]", tail) else "") + "%p"
        if match["zone"]:
            clock += (" " if re.search(r"\s(Z|[+-])", tail) else "") + "%#z"
    if not day:
        return [(clock, "")]
    numbers, named = _NUMBERS.match(day), _NAMED.match(day)
    if numbers is not None:
        year = "%Y" if len(numbers[4]) == 4 else "%y"
        return [
            (pattern.format(numbers[2], year) + clock, order) for order, pattern in ORDERS.items()
        ]
    if named is not None:
        year = "%Y" if len(named[4]) == 4 else "%y"
        month = "%b" if len(named[3]) == 3 else "%B"
        return [(f"%d{named[2]}{month}{named[2]}{year}{clock}", "")]
    if re.match(r"^\d{4}([/.\-])\d{1,2}\1\d{1,2}$", day):
        mark = day[4]
        return [(f"%Y{mark}%m{mark}%d{clock}", "")]
    return []
