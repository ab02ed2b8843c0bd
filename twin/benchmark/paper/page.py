"""``paper.html``: the paper's tables and figures beside those of this package, on one page.

Nothing here computes a result. The page is ``paper.html.jinja`` beside this file, in the style of
the benchmark's report.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from twin.benchmark.figures import (
    RunFigure,
    parameter_figure,
    prediction_figure,
    predictor_styles,
)
from twin.benchmark.figures.data import example_times, reference_of
from twin.benchmark.paper.experiment import METHODS, TRACED, Trace
from twin.benchmark.paper.figures import table_figure, window_figure
from twin.benchmark.paper.findings import FORMS, Contest
from twin.benchmark.paper.published import FIGURES, PREDICTION_FIGURES, TABLES
from twin.benchmark.paper.rows import PaperRow
from twin.benchmark.protocol import Unit
from twin.benchmark.report import page_template
from twin.benchmark.svg import FONTS, sheet_of, svg_of
from twin.benchmark.verdict.tables import Cell, Grid, number
from usv_kernel.files import write_whole

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.figure import Figure

__all__ = [
    "PaperResults",
    "write_page",
]

IN_FIGURES = ("dsw-ukf:printed", "dsw-ukf", "dsw-ukf:window=off", "lstm", "dsw-ukf-plus")
"""Predictors in the pictures of a forecast: all of them would hide each other."""


class PaperResults(NamedTuple):
    """What the page shows."""

    rows: Sequence[PaperRow]
    contests: Sequence[Contest]
    findings: Sequence[str]
    runs: Sequence[RunFigure]  # runs that kept their pictures
    traced: Mapping[Unit, Trace]
    settings: Mapping[str, Any]
    notes: Sequence[str]
    command: str


class _Picture(NamedTuple):
    """A picture with its caption."""

    svg: Markup
    caption: str


class _Gallery:
    """Pictures as parts of the page."""

    def __init__(self) -> None:
        self.styles: dict[str, str] = {}
        self._count = 0

    def picture(self, fig: Figure, caption: str) -> _Picture:
        """Return a picture for the page."""
        from markupsafe import Markup

        svg = svg_of(fig, f"p{self._count}", caption, self.styles)
        self._count += 1
        return _Picture(Markup(svg), caption)


def write_page(path: Path, results: PaperResults) -> Path:
    """Write the page, one file without scripts or fonts of its own; return its path.

    Parameters
    ----------
    path : Path
        File, for instance ``paper.html``.
    results : PaperResults
        What was measured.
    """
    names = list(dict.fromkeys(row.predictor for row in results.rows))
    styles, gallery = predictor_styles(names), _Gallery()
    identified = float(results.settings["identify_s"])
    intervals = any(row.low is not None for row in results.rows)
    with_interval = " with its 95 % interval" if intervals else ""
    table_4 = [row for row in results.rows if row.table == "Table 4"]
    pictures = [
        gallery.picture(
            table_figure(table_4, metric, styles),
            f"{metric} of 10 s forecasts, mean over seeds{with_interval}, and the paper's "
            "numbers. Its boat and sea are others, so that only the order can be compared.",
        )
        for metric in ("MAE", "MSE")
        if table_4
    ]
    sections = {
        "findings": results.findings,
        "command": results.command,
        "notes": results.notes,
        "intervals": intervals,
        "settings": results.settings,
        "table_4": _table_4_grid(results.rows),
        "table_4_pictures": pictures,
        "contests": _contest_grid(results.contests),
        "tables": [
            {"title": f"{named[0]}: parameters identified in the {scenario}", "grid": grid}
            for scenario, named in TABLES.items()
            if (grid := _parameter_grid(results.rows, named[0])) is not None
        ],
        "algorithm": _metric_grid(results.rows, ("Algorithm 1",)),
        "windows": _windows(results, gallery, styles, identified),
        "figures": _metric_grid(
            results.rows, tuple(name for motions in FIGURES.values() for name in motions.values())
        ),
        "runs": [
            _run_section(run, gallery, styles, identified)
            for run in results.runs
            if run.fault == "none"
        ],
    }
    template = page_template("paper/paper.html.jinja")
    page = template.render(**sections, fonts=FONTS, sheet=sheet_of(gallery.styles, "svg "))
    write_whole(path, page.encode())
    return path


# tables
def _cell(row: PaperRow | None) -> Cell:
    """Return ours, its interval, and the paper's number."""
    if row is None:
        return Cell("-")
    small = []
    if row.low is not None and row.high is not None:
        small.append(f"[{number(row.low)}, {number(row.high)}]")
    if row.paper is not None:
        small.append(f"paper {number(row.paper)}")
    return Cell(number(row.ours), tuple(small))


def _table_4_grid(rows: Sequence[PaperRow]) -> Grid | None:
    """Return Table 4: a line for each predictor, two columns for each scenario and fault."""
    here = {row[1:5]: row for row in rows if row.table == "Table 4"}
    if not here:
        return None
    cases = list(dict.fromkeys(key[:2] for key in here))
    names = list(dict.fromkeys(key[2] for key in here))
    metrics = ("MAE", "MSE")
    heads = ["predictor", "in the paper"]
    heads += [
        f"{scenario}{'' if fault == 'none' else ', ' + fault}: {metric}"
        for scenario, fault in cases
        for metric in metrics
    ]
    best = {
        (*case, metric): min(
            here[(*case, name, metric)].ours for name in names if (*case, name, metric) in here
        )
        for case in cases
        for metric in metrics
    }
    lines = []
    for name in names:
        cells = [Cell(name), Cell(METHODS.get(name, "-"))]
        for case in cases:
            for metric in metrics:
                row = here.get((*case, name, metric))
                cell = _cell(row)
                bold = row is not None and row.ours == best[(*case, metric)]
                cells.append(cell._replace(bold=bold))
        lines.append(cells)
    return Grid(heads, lines)


def _contest_grid(contests: Sequence[Contest]) -> Grid | None:
    """Return what the window alone changes."""
    if not contests:
        return None
    heads = ["scenario", "fault", "method", "change of MAE by the window", "better"]
    lines = []
    for one in contests:
        between = () if one.low is None else (f"[{one.low:+.0f}, {one.high:+.0f}]",)
        lines.append(
            [
                *map(Cell, (one.scenario, one.fault, FORMS[one.predictor])),
                Cell(f"{one.change:+.0f} %", between),
                Cell(f"{one.wins} of {one.seeds}"),
            ]
        )
    return Grid(heads, lines)


def _parameter_grid(rows: Sequence[PaperRow], table: str) -> Grid | None:
    """Return Table 2 or 3: a line for each parameter, the paper's number first."""
    here = [row for row in rows if row.table == table]
    if not here:
        return None
    names = list(dict.fromkeys(row.predictor for row in here))
    lines = []
    for metric in dict.fromkeys(row.metric for row in here):
        found = {row.predictor: row for row in here if row.metric == metric}
        paper = next(iter(found.values())).paper
        cells = [_cell(found[name]._replace(paper=None)) for name in names]
        lines.append([Cell(metric), Cell("-" if paper is None else number(paper)), *cells])
    return Grid(["parameter", "paper", *names], lines)


def _metric_grid(rows: Sequence[PaperRow], tables: Sequence[str]) -> Grid | None:
    """Return rows of figures or of the algorithm: a line for each number."""
    here = {
        (row.table, row.scenario, row.metric, row.predictor): row
        for row in rows
        if row.table in tables
    }
    names = [name for name in TRACED if any(key[3] == name for key in here)]
    lines = [
        [*map(Cell, key), *(_cell(here.get((*key, name))) for name in names)]
        for key in dict.fromkeys(key[:3] for key in here)
    ]
    return Grid(["in the paper", "scenario", "", *names], lines) if lines else None


# pictures
def _windows(
    results: PaperResults, gallery: _Gallery, styles: Any, identified: float
) -> list[_Picture]:
    """Return the windows over time of the first seed of each scenario."""
    shown: dict[tuple[str, int], dict[str, Trace]] = {}
    for unit in sorted(results.traced, key=lambda unit: unit.seed):
        if any(results.traced[unit].window):
            group = shown.setdefault((unit.scenario, unit.seed), {})
            group[unit.predictor] = results.traced[unit]
    first = {key[0]: key for key in reversed(list(shown))}
    return [
        gallery.picture(
            window_figure(f"{scenario}, seed {key[1]}", shown[key], styles, identified),
            f"Algorithm 1 in the {scenario}: the window, the rows that the index V adds to it "
            "(Eq 37, 40), and the index S (Eq 39).",
        )
        for scenario, key in sorted(first.items())
    ]


def _run_section(
    run: RunFigure, gallery: _Gallery, styles: Any, identified: float
) -> dict[str, Any]:
    """Return the pictures of a scenario: forecasts and parameters."""
    few = {name: run.predictors[name] for name in IN_FIGURES if name in run.predictors}
    run = dataclasses.replace(run, predictors=few)
    styles = {**predictor_styles(run.predictors), **styles}
    reference = reference_of(run.log)
    figure = PREDICTION_FIGURES.get(run.scenario)
    shown = [
        gallery.picture(
            prediction_figure(run, start, styles, reference),
            f"Compare {figure} of the paper: 10 s forecasts made at t = {start:g} s against the "
            "truth. An arrow head marks what leaves its panel.",
        )
        for start in example_times(run)[:1]
    ]
    parameters = {
        name: [
            gallery.picture(
                parameter_figure(run, name, motion, styles, identified),
                f"Compare {title} of the paper: the {motion} parameters by {name}.",
            )
            for motion, title in FIGURES.get(run.scenario, {}).items()
        ]
        for name in TRACED
        if name in run.predictors and run.predictors[name].blocks
    }
    return {"title": f"Figures of the {run.scenario}", "pictures": shown, "parameters": parameters}
