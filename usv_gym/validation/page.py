"""The validation page: rows as Markdown and JSON, and comparison with a page on disk.

Pages are compared as text. Numbers may differ by the rounding of the page, as another processor
may give other last bits.
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

PAGE = "validation.md"

FOLDER = "validation"
"""Folder of the pictures, next to the page."""

HEADS = ("item", "value", "reference", "tolerance", "result", "source")

ROUNDING = Decimal("0.6")
"""Allowed difference from rounding, in units of the last figure on the page."""

ABSENT = "-"

WIDTH = 100

INTRODUCTION = """# Validation

This page compares what the simulator computes with published results, with measurements, with
separate code, and with exact properties. `usv-twin validate` computes all values and writes this
page. `usv-twin validate --check` runs in CI: it fails if a value leaves its tolerance or differs
from this page. `--json FILE` gives the rows in full precision.

How to read the tables:

- **ok**: the value is within the tolerance. **reported**: the reference is shown, without a test.
- *separate computation*: other code computed the reference from the same equations. Agreement
  checks the code, not the model.
- Recorded runs of KVLCC2 and spectra of a wave buoy are not distributed. Their rows are computed
  where the data exist (`USV_TWIN_SHARED`, or `../shared`); elsewhere they keep their values.

What the results say:

- The equations are coded correctly: all separate computations agree.
- The tanker turns as in towing tanks, within 6 %. Its overshoots in zigzags are too small, and a
  replay of long recorded zigzags diverges.
- Simulated seas have the given height, period and spectrum.
- At rest, motions in waves and mean drift of four boats are those of a boundary-element code
  within 5 %. Under way, an independent theory has amplitudes of the same shape, not of one size.

What is **not** validated:

- Planing: above a Froude number of about 0.6 (9 kn for the 7.5 m boat) only the resistance curve
  is modelled. Trim, lift, porpoising and heel of a planing hull are missing.
- Stopping, going astern and crash stops.
- Six degrees of freedom in steep waves: loads are linear, hulls wall-sided, and no wave breaks.
- The 7.5 m boat itself: no trials of it are public, and most of its coefficients are estimates,
  marked in `usv_gym/vessel/vessels/usv75.toml`.
- Hydrodynamics under way: the loads are those at rest, at the frequency of encounter.
- Tolerances that a section states as chosen after the values were known.
"""


def tolerance_text(row: Row) -> str:
    """Return the tolerance of a row as text."""
    if row.tolerance is None:
        return ABSENT
    if row.kind == "relative":
        return f"{100.0 * row.tolerance:.3g} %"
    return {"absolute": "+-", "factor": "factor ", "below": "below "}[row.kind] + (
        f"{row.tolerance:g}"
    )


def verdict(row: Row) -> str:
    """Return the result of a row in one word."""
    if row.skipped:
        return "skipped"
    return {None: "reported", True: "ok", False: "**OUT**"}[row.ok]


def number(value: float | None, digits: int) -> str:
    """Return a number with some significant figures."""
    if value is None or not math.isfinite(value):
        return ABSENT
    return f"{value:#.{digits}g}".rstrip(".")


def value_text(row: Row) -> str:
    """Return the value of a row as text; small sizes appear as their bound."""
    if row.kind == "below" and row.ok:
        return f"below {row.tolerance:g}"
    return number(row.value, row.digits)


def cells(row: Row, digits: int | None = None) -> tuple[str, ...]:
    """Return the cells of a row; default figures of the value are those of the row."""
    row = row if digits is None else replace(row, digits=digits)
    reference = ABSENT if row.reference is None else f"{row.reference:.6g}"
    return (row.item, value_text(row), reference, tolerance_text(row), verdict(row), row.source)


def render(sections: Sequence[Section], before: str = "", digits: int | None = None) -> str:
    """Return the page; an earlier one, ``before``, gives the values of skipped rows.

    ``digits`` are the significant figures of every value; by default those of its row.
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
                # keep the value; take reference and tolerance from the code
                reference = old[2] if row.reference is None else found[2]
                found = (found[0], old[1], reference, found[3], old[4], found[5])
            lines.append(f"| {' | '.join(found)} |")
        lines.append("")
        for name, caption in section.pictures.items():
            lines += [f"![{caption}]({FOLDER}/{name})", "", f"*{caption}*", ""]
    return "\n".join(lines).rstrip("\n") + "\n"


def compare(page: str, sections: Sequence[Section]) -> list[str]:
    """Return the differences of a page from computed rows beyond rounding.

    Skipped rows are taken from the page.
    """
    found, title = [], ""
    exact = render(sections, page, digits=15)
    for old, new in zip_longest(page.splitlines(), exact.splitlines(), fillvalue=""):
        title = new[3:] if new.startswith("## ") else title
        now, page_cells = _cells_of(new), _cells_of(old)
        if now and page_cells and now[0] == page_cells[0]:
            found += [
                f"{title}: {now[0]}: {head} is {a} on the page, {b} now"
                for head, a, b in zip(HEADS, page_cells, now, strict=True)
                if not _same(a, b)
            ]
        elif old != new:
            found.append(f"{title}: the page has {old!r}, now it is {new!r}")
    return found


def failures(sections: Sequence[Section]) -> list[str]:
    """Return a message for each row out of its tolerance."""
    return [
        f"{section.title}: {row.item}: {value_text(row)}, but {cells(row)[2]} "
        f"({tolerance_text(row)}) from {row.source}"
        for section in sections
        for row in section.rows
        if row.ok is False
    ]


def to_json(sections: Sequence[Section]) -> list[dict[str, Any]]:
    """Return every row with section, item, value, reference, tolerance, kind, source and ok.

    ``ok`` is None for rows that are reported only, or skipped for the reason in ``skipped``.
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
    """Return the cells of a table line, empty for other lines."""
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
    """Return whether a cell equals an exact value within rounding."""
    try:
        a, b = Decimal(old), Decimal(exact)
    except InvalidOperation:
        return old == exact
    unit = Decimal(1).scaleb(int(a.as_tuple().exponent))
    return old == exact or abs(a - b) <= ROUNDING * unit
