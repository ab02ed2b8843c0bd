"""The validation page: rows as Markdown and JSON, and whether a page is still true.

A page is compared with today's as text, but for numbers: two numbers in the same place are the
same if they differ by no more than the rounding of the page, so that another processor's last
bits do not matter.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from decimal import Decimal, InvalidOperation
from itertools import zip_longest
from textwrap import fill
from typing import Any

from usv_gym.validation.study import Row, Section

__all__ = [
    "FOLDER",
    "PAGE",
    "compare",
    "failures",
    "render",
    "to_json",
    "verdict",
]

PAGE = "VALIDATION.md"

FOLDER = "examples/validation"
"""Where the pictures lie, beside the page."""

HEADS = ("item", "value", "reference", "tolerance", "result", "source")

ROUNDING = Decimal("0.6")
"""Difference that is rounding, in units of the last figure on the page."""

ABSENT = "-"

WIDTH = 100

INTRODUCTION = """# Validation

What this code computes, beside what is published, measured, or computed apart from it. Written by
`usv-twin validate`, which computes every value anew; `usv-twin validate --check` (part of the CI)
fails if a value is out of its tolerance or is no longer the one on this page. `--json FILE` gives
the rows in full precision.

- **ok**: within the tolerance. **reported**: stands beside the reference, and is not judged.
- Sections and item numbers of `physics.md` are those of the specification that the project was
  built from; the work that each number comes from is named where it is known.
- The recorded runs of KVLCC2 and the buoy's spectra are not part of the project. Rows that need
  them are computed where the data are (`USV_TWIN_SHARED`, or `../shared`); elsewhere they stay
  as they are here.

What is **not** validated:

- planing: above a Froude number of about 0.6 (9 kn for the 7.5 m boat) there is a resistance
  curve and nothing else, no trim, lift, porpoising or heel of a planing hull;
- stopping, going astern and crash stops;
- six degrees of freedom in steep waves: loads are linear, hulls wall-sided, nothing breaks;
- the 7.5 m boat itself: no trials of it are public, and most of its coefficients are guesses,
  each marked in `usv_gym/vessels/usv75.toml`;
- motions near resonance under way, which are half of what Jensen's closed forms say;
- tolerances, where a section says that they were chosen here.
"""


def tolerance_text(row: Row) -> str:
    """Return what a row allows, in words."""
    if row.tolerance is None:
        return ABSENT
    if row.kind == "relative":
        return f"{100.0 * row.tolerance:.3g} %"
    return {"absolute": "+-", "factor": "factor ", "below": "below "}[row.kind] + (
        f"{row.tolerance:g}"
    )


def verdict(row: Row) -> str:
    """Return the result of a row in a word."""
    if row.skipped:
        return "skipped"
    return {None: "reported", True: "ok", False: "**OUT**"}[row.ok]


def number(value: float | None, digits: int) -> str:
    """Return a number with so many significant figures."""
    if value is None or not math.isfinite(value):
        return ABSENT
    return f"{value:#.{digits}g}".rstrip(".")


def value_text(row: Row) -> str:
    """Return the value of a row; one that must be small and is has no figures to keep."""
    if row.kind == "below" and row.ok:
        return f"below {row.tolerance:g}"
    return number(row.value, row.digits)


def cells(row: Row, digits: int | None = None) -> tuple[str, ...]:
    """Return the cells of a row of the table, the value with so many figures."""
    row = row if digits is None else replace(row, digits=digits)
    reference = ABSENT if row.reference is None else f"{row.reference:.6g}"
    return (row.item, value_text(row), reference, tolerance_text(row), verdict(row), row.source)


def render(sections: Sequence[Section], before: str = "", digits: int | None = None) -> str:
    """Return the page.

    Parameters
    ----------
    sections : sequence of Section
        Today's rows.
    before : str
        An earlier page, which rows that are skipped today are taken from.
    digits : int, optional
        Significant figures of every value; by default those of its row.
    """
    kept = _rows_of(before)
    lines = [INTRODUCTION]
    for section in sections:
        lines += [f"## {section.title}", "", fill(section.text, WIDTH), ""]
        lines += [f"| {' | '.join(HEADS)} |", "|---|---:|---:|---|---|---|"]
        for row in section.rows:
            found = cells(row, digits)
            old = kept.get((section.title, row.item))
            if row.skipped and old:
                # what was computed is kept; what it is held against is today's
                reference = old[2] if row.reference is None else found[2]
                found = (found[0], old[1], reference, found[3], old[4], found[5])
            lines.append(f"| {' | '.join(found)} |")
        lines.append("")
        for name, caption in section.pictures.items():
            lines += [f"![{caption}]({FOLDER}/{name})", "", f"*{caption}*", ""]
    return "\n".join(lines).rstrip("\n") + "\n"


def compare(page: str, sections: Sequence[Section]) -> list[str]:
    """Return where a page differs from today's rows by more than rounding.

    Parameters
    ----------
    page : str
        The page as it is.
    sections : sequence of Section
        Today's rows; those that are skipped are taken from the page.
    """
    found, title = [], ""
    exact = render(sections, page, digits=15)
    for old, new in zip_longest(page.splitlines(), exact.splitlines(), fillvalue=""):
        title = new[3:] if new.startswith("## ") else title
        ours, theirs = _cells_of(new), _cells_of(old)
        if ours and theirs and ours[0] == theirs[0]:
            found += [
                f"{title}: {ours[0]}: {head} is {a} on the page, {b} today"
                for head, a, b in zip(HEADS, theirs, ours, strict=True)
                if not _same(a, b)
            ]
        elif old != new:
            found.append(f"{title}: the page has {old!r}, today it is {new!r}")
    return found


def failures(sections: Sequence[Section]) -> list[str]:
    """Return the rows that are out of their tolerance."""
    return [
        f"{section.title}: {row.item}: {value_text(row)}, but {cells(row)[2]} "
        f"({tolerance_text(row)}) after {row.source}"
        for section in sections
        for row in section.rows
        if row.ok is False
    ]


def to_json(sections: Sequence[Section]) -> list[dict[str, Any]]:
    """Return every row with item, value, reference, tolerance, source, ok, and its section.

    ``kind`` says how the tolerance is meant (:data:`usv_gym.validation.study.KINDS`); ``ok`` is
    None for rows that are not judged or, with the reason in ``skipped``, not computed.
    """
    return [
        {
            "section": section.title,
            "item": row.item,
            "value": _finite(row.value),
            "reference": _finite(row.reference),
            "tolerance": row.tolerance,
            "kind": row.kind,
            "source": row.source,
            "ok": row.ok,
            "skipped": row.skipped,
        }
        for section in sections
        for row in section.rows
    ]


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _cells_of(line: str) -> tuple[str, ...]:
    """Return the cells of a line of a table of rows, else none."""
    parts = re.split(r" \| ", line[2:-2]) if line.startswith("| ") and line.endswith(" |") else []
    return tuple(parts) if len(parts) == len(HEADS) else ()


def _rows_of(page: str) -> Mapping[tuple[str, str], tuple[str, ...]]:
    """Return the cells of every row of a page by section and item."""
    rows, title = {}, ""
    for line in page.splitlines():
        if line.startswith("## "):
            title = line[3:]
        elif parts := _cells_of(line):
            rows[title, parts[0]] = parts
    return rows


def _same(old: str, exact: str) -> bool:
    """Return whether a cell still holds, but for its own rounding."""
    try:
        a, b = Decimal(old), Decimal(exact)
    except InvalidOperation:
        return old == exact
    unit = Decimal(1).scaleb(int(a.as_tuple().exponent))
    return old == exact or abs(a - b) <= ROUNDING * unit
