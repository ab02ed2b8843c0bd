"""Numbers and names in tables of results."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from twin.benchmark.figures.data import number_of

__all__ = ["best_text", "grouped", "interval", "number"]

Row = Mapping[str, Any]


def number(value: float | None) -> str:
    """Return a number with three digits, and a dash for NaN or None."""
    if value is None or math.isnan(value):
        return "-"
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    size = abs(value)
    if size >= 1e5:
        return f"{value:.1e}"
    for bound, digits in ((100.0, 0), (10.0, 1), (1.0, 2), (1e-3, 3)):
        if size >= bound:
            return f"{value:.{digits}f}"
    return f"{value + 0.0:.2g}"


def interval(row: Row, name: str = "") -> str:
    """Return the interval of a value, ``NAME_low`` to ``NAME_high``; empty where there is none."""
    before = f"{name}_" if name else ""
    low, high = number_of(row, f"{before}low"), number_of(row, f"{before}high")
    return "" if math.isnan(low) or math.isnan(high) else f"[{number(low)}, {number(high)}]"


def best_text(metric: str, rows: Sequence[Row]) -> str | None:
    """Return the best value of a metric as it is printed; None if nothing is compared."""
    values = [v for v in (number_of(row, "value") for row in rows) if math.isfinite(v)]
    if len({number(value) for value in values}) < 2:
        return None
    if metric == "skill":
        return number(max(values))
    if metric == "coverage90":
        return number(min(values, key=lambda value: abs(value - 0.9)))
    return number(min(values))


def grouped(rows: Sequence[Row], *keys: str) -> dict[tuple[Any, ...], list[Row]]:
    """Return rows with the same values of some keys together, in their order."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return groups
