"""Numbers and names in tables of results."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from twin.benchmark.metrics import ORACLE

__all__ = ["best_text", "interval", "is_best", "number", "number_of"]

Row = Mapping[str, Any]

IDEAL = {"coverage90": 0.9, "motion_coverage90": 0.9}
"""Metrics whose best value is neither the smallest nor the largest."""

LARGEST = ("skill", "brier_skill", "auc", "won")
"""Metrics whose best value is the largest."""

NO_RACE = ("motion_sd", "motion_held", "base_rate", "auc_now")
"""What the sea does, and what the present state says: no predictor's."""


def number_of(row: Row, key: str) -> float:
    """Return a number of a row of results; NaN where there is none."""
    value = row.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
        return math.nan
    return float(value)


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


def best_text(metric: str, rows: Sequence[Row], factor: float = 1.0) -> str | None:
    """Return the best value of a metric times a factor, as printed; None if nothing is compared.

    The oracle knows the true boat and takes no part; the ``reference`` of a paired comparison does.
    """
    if metric in NO_RACE:
        return None
    values = [factor * number_of(row, "value") for row in rows if row["predictor"] != ORACLE]
    values = [value for value in values if math.isfinite(value)]
    if len(values) < 2:
        return None
    values += [factor * row["reference"] for row in rows[:1] if "reference" in row]
    if metric in IDEAL:
        return number(min(values, key=lambda value: abs(value - factor * IDEAL[metric])))
    return number(max(values) if metric in LARGEST else min(values))


def is_best(row: Row, best: str | None, factor: float = 1.0) -> bool:
    """Return whether a row has the best value, as :func:`best_text` prints it."""
    own = number(factor * number_of(row, "value"))
    return best is not None and row["predictor"] != ORACLE and own == best
