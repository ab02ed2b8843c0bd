"""``usv-twin paper``: the paper's tables and figures, redone beside its numbers."""

from __future__ import annotations

import contextlib
import dataclasses
import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import TimeRemainingColumn

from twin.benchmark import runner
from twin.benchmark.metrics import run_rows
from twin.benchmark.paper.experiment import (
    PREDICTORS,
    Trace,
    paper_settings_of,
    traced_units,
    traces,
)
from twin.benchmark.paper.findings import contests, findings
from twin.benchmark.paper.page import PaperResults, write_page
from twin.benchmark.paper.rows import PaperRow, paper_rows
from twin.benchmark.protocol import BenchmarkError, Settings, Unit, available, units
from twin.benchmark.verdict.tables import number
from twin.cli.common import (
    CPUS,
    JobsOption,
    console,
    errors,
    explain,
    new_table,
    note,
    parse_seeds,
    progress_bar,
    stopped,
    write_json,
)

HEADS = ("predictor", "MAE", "95 %", "paper", "MSE", "95 %", "paper")
"""Columns of a table."""


def paper_command(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of page and results.")] = Path(
        "paper"
    ),
    json: Annotated[
        Path | None,
        typer.Option(
            help="Write the rows to this file: table, scenario, fault, predictor, metric, ours, "
            "low, high, paper."
        ),
    ] = None,
    seeds: Annotated[
        str, typer.Option(help="A-B (or A:B for A to B - 1), or a list as 0,4,7.")
    ] = "0-7",
    jobs: JobsOption = CPUS,
) -> None:
    """Redo the paper of Qu et al. 2025, and print it side by side with its numbers.

    The 20 degree turn and the 20/-20 zigzag, with and without 10 s without GPS. Each seed is
    another boat and sea; the paper repeated each run four times. Compared are the paper's method
    as printed and as mended, both without their window (the paper's UKF), its LSTM, and predictors
    of this package.

    Writes paper.html with Tables 2 to 4, Figures 9 to 16 and the window of Algorithm 1 over time.
    Ctrl-C keeps what is finished; the same command goes on from there.
    """
    names, notes = available(PREDICTORS)
    settings = paper_settings_of(parse_seeds(seeds), names)
    for line in notes:
        note(line)
    out.mkdir(parents=True, exist_ok=True)
    done, traced, failed = _run_all(settings, out, jobs)
    rows = paper_rows(settings, done, traced)
    found = contests(run_rows(list(done.values())))
    sentences = findings(rows, found)
    print_paper(rows, sentences)
    for line in failed:
        errors.print(line, style="red", highlight=False, soft_wrap=True)
    if json is not None:
        write_json(json, [row._asdict() for row in rows])
        console.print(f"{json}: {len(rows)} rows", highlight=False)
    total = len(units(settings)) + len(traced_units(settings))
    if len(done) + len(traced) + len(failed) < total:
        raise stopped(
            f"{len(done) + len(traced)} of {total} results are kept in {out}; the same command "
            "goes on from there"
        )
    if not done:
        raise BenchmarkError("nothing could be scored; the lines above say why")
    results = PaperResults(
        rows=rows,
        contests=found,
        findings=sentences,
        runs=runner.run_figures(settings, done),
        traced=traced,
        settings=dataclasses.asdict(settings),
        notes=[*notes, *(f"not scored: {line}" for line in failed)],
        command=shlex.join(["usv-twin", *sys.argv[1:]]),
    )
    console.print(f"{write_page(out / 'paper.html', results)}", highlight=False)


def _run_all(
    settings: Settings, out: Path, jobs: int
) -> tuple[dict[Unit, dict[str, Any]], dict[Unit, Trace], list[str]]:
    """Do all work under a progress bar; Ctrl-C ends it early."""
    done: dict[Unit, dict[str, Any]] = {}
    traced: dict[Unit, Trace] = {}
    failed: list[str] = []
    with contextlib.suppress(KeyboardInterrupt):
        reused = runner.reusable(settings, out)
        if len(reused) < len(units(settings)):
            runner.warm_up(settings, jobs=jobs)
        with progress_bar(TimeRemainingColumn(), speed_estimate_period=600.0) as progress:
            total = len(units(settings)) + len(traced_units(settings))
            bar = progress.add_task("redoing the paper", total=total)
            for unit, trace in traces(settings, out, jobs=jobs):
                if isinstance(trace, Exception):
                    failed.append(f"{unit.run} {unit.predictor}: {trace}")
                else:
                    traced[unit] = trace
                progress.advance(bar)
            for unit, result in runner.runs(settings, out, jobs=jobs, done=reused):
                if isinstance(result, Exception):
                    failed.append(f"{unit.run} {unit.predictor}: {result}")
                else:
                    done[unit] = result
                progress.advance(bar)
    return done, traced, failed


def print_paper(rows: list[PaperRow], sentences: list[str]) -> None:
    """Print Table 4 beside the paper's, and what reproduces."""
    cases: dict[tuple[str, str], dict[str, dict[str, PaperRow]]] = {}
    for row in rows:
        if row.table == "Table 4":
            case = cases.setdefault((row.scenario, row.fault), {})
            case.setdefault(row.predictor, {})[row.metric] = row
    for (scenario, fault), case in cases.items():
        table = new_table(
            f"Table 4: {scenario}, {'no fault' if fault == 'none' else fault}",
            *HEADS,
            left=("predictor",),
            show_edge=False,
        )
        for name, found in case.items():
            cells = [text for row in found.values() for text in _cells(row)]
            table.add_row(name, *cells)
        console.print(table)
    if cases:
        bounded = any(row.low is not None for row in rows)
        explain(
            f"Mean over seeds{' [95 % interval]' if bounded else ''}, units mixed as in the paper, "
            "whose boat and sea are others: compare the order. dsw-ukf stands beside the paper's "
            "DSW-UKF, window=off beside its UKF, all else equal. Tables 2 and 3, the figures and "
            "the window over time are on the page."
        )
    for sentence in sentences:
        console.print(sentence, highlight=False, soft_wrap=True)


def _cells(row: PaperRow) -> tuple[str, str, str]:
    """Return ours, its interval and the paper's number."""
    between = "-"
    if row.low is not None and row.high is not None:
        between = f"{row.low:.2g}-{row.high:.2g}"
    return number(row.ours), between, "-" if row.paper is None else number(row.paper)
