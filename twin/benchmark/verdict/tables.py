"""Tables of the report: their cells, and those that stand first on the page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from twin.benchmark.figures.data import number_of, text_of
from twin.benchmark.verdict.summary import best_first, recorded_blocks

__all__ = [
    "Cell",
    "Grid",
    "interval_text",
    "losses_grid",
    "number",
    "recorded_verdict_grids",
    "verdict_grid",
]

Row = Mapping[str, Any]


class Cell(NamedTuple):
    """A cell of a table, with smaller lines below its text."""

    text: str
    small: tuple[str, ...] = ()
    bold: bool = False


class Grid(NamedTuple):
    """A table: heads of the columns, and cells by row, of which the first is the row's name."""

    heads: list[str]
    rows: list[list[Cell]]


def number(value: float) -> str:
    """Return a number with three digits, and a dash for NaN."""
    if math.isnan(value):
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


def interval_text(row: Row, low: str = "low", high: str = "high") -> tuple[str, ...]:
    """Return an interval for a cell; nothing where there is none."""
    a, b = number_of(row, low), number_of(row, high)
    return () if math.isnan(a) or math.isnan(b) else (f"[{number(a)}, {number(b)}]",)


def verdict_grid(rows: Sequence[Row]) -> Grid | None:
    """Return what is said first of simulated runs, the best predictor first."""
    if not rows:
        return None
    blocks: dict[str, dict[str, Row]] = {}
    for row in rows:
        blocks.setdefault(text_of(row, "predictor"), {})[text_of(row, "loss")] = row
    there = {text_of(row, "loss") for row in rows}
    lost = sorted({case for row in rows if row["loss"] == "any" for case in row["cases"]})
    names = {"none": "no loss", "any": ", ".join(lost), "all": "all"}
    losses = [loss for loss in ("none", "any") if loss in there]
    columns = [
        *((key, loss) for key in ("position_m", "heading_deg", "ratio") for loss in losses),
        *((key, "all") for key in ("mae", "mse")),
    ]
    titles = {
        **{"position_m": "position (m)", "heading_deg": "heading (deg)"},
        **{"ratio": "ratio to persistence", "mae": "MAE", "mse": "MSE"},
    }
    heads = [
        titles[key] + (f", {names[loss]}" if key not in ("mae", "mse") else "")
        for key, loss in columns
    ]
    lines = []
    for name, block in blocks.items():
        cells = [Cell(name)]
        for key, loss in columns:
            row = block.get(loss, {})
            ends = interval_text(row, f"{key}_low", f"{key}_high")
            cells.append(Cell(number(number_of(row, key)), ends))
        lines.append(cells)
    return Grid(["predictor", *heads], lines)


def recorded_verdict_grids(results: Row) -> dict[str, Grid]:
    """Return what is said first of recorded runs, by title."""
    grids = {}
    heads = ["predictor"]
    for channel in ("position (m)", "heading (deg)"):
        heads += [channel, "ratio, twin", "ratio, recorded"]
    for title, block in recorded_blocks(results).items():
        ends = any(line["loss"] for line in block.values())
        lines = []
        for name in best_first(block):
            rows = block[name]
            cells = [Cell(name)]
            for channel in ("displacement", "psi"):
                row = rows[channel]
                cells.append(Cell(number(number_of(row, "error"))))
                cells.append(Cell(number(number_of(row, "ratio")), interval_text(row)))
                cells.append(Cell(number(number_of(row, "ratio_recorded"))))
            if ends:
                cells += [Cell(number(number_of(rows["loss"], k))) for k in ("error_m", "said_m")]
            lines.append(cells)
        grids[title] = Grid([*heads, *(["end of loss (m)", "said (m)"] * ends)], lines)
    return grids


def losses_grid(rows: Sequence[Row]) -> Grid | None:
    """Return how far off the position is at the ends of losses, and how far it says."""
    if not rows:
        return None
    heads = ["run", "loss", "predictor", "losses", "error (m)", "worst (m)", "said (m)", "held"]
    lines = []
    for row in rows:
        where = text_of(row, "scenario") or text_of(row, "folder")
        names = where, text_of(row, "case"), text_of(row, "predictor"), str(row["losses"])
        values = (number(number_of(row, key)) for key in ("error_m", "worst_m", "said_m"))
        held = f"{100.0 * number_of(row, 'held'):.0f} %"
        lines.append([*map(Cell, names), *map(Cell, values), Cell(held)])
    return Grid(heads, lines)
