"""``usv-twin bench``: speed of the package and of its peers."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from twin.benchmark.protocol import BenchmarkError
from twin.cli.common import INTERRUPTED, _digits, _speaking, _write_json, app, console, errors, note

if TYPE_CHECKING:
    from twin.performance import cases, harness


@app.command("bench")
@_speaking
def bench_command(
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer rounds, and no learning: under a minute.")
    ] = False,
    growth: Annotated[
        bool,
        typer.Option(
            "--growth",
            help="Instead: how the cost grows with wave components, boats, window and horizon.",
        ),
    ] = False,
    only: Annotated[str, typer.Option(help="Only what has this text in its name.")] = "",
    rounds: Annotated[
        int | None, typer.Option(min=1, help="Bursts of each case. [9; quick, growth: 5]")
    ] = None,
    json_out: Annotated[
        Path | None, typer.Option("--json", help="Write the rows as JSON too.")
    ] = None,
) -> None:
    """Measure the speed of this package, and of its peers where they are installed.

    All cases take turns in short bursts; shown are medians over the rounds, per operation: a step
    of one boat, an update, a row, a refit, a prediction, a frame. "ratio": how many times faster
    than the first case of the block. "must": the rate to reach on the reference machine, where
    Gymnasium's Pendulum makes 94 k steps/s, or the ratio to reach. "reached": what part of it is
    reached, rates scaled by how fast Pendulum runs here in the same round; 1 or more is enough on
    any machine. Peers to install: stonesoup, gym-sailing, shipmmg, PythonVehicleSimulator. Ctrl-C
    shows what is there.
    """
    from twin.performance import cases

    if json_out is not None:
        # said before the minutes of measuring, not after them
        folder = json_out.parent
        if json_out.is_dir() or not folder.is_dir() or not os.access(folder, os.W_OK):
            raise BenchmarkError(
                f"--json {json_out}: must be a file in a folder that is there and can be written to"
            )
    rounds = rounds or (5 if quick or growth else 9)
    if growth:
        rows, interrupted = _grown(cases.CURVES, only, rounds)
    else:
        rows, interrupted = _compared(only, quick, rounds)
    if json_out is not None:
        _write_json(json_out, rows)
        console.print(f"rows: {json_out}")
    if interrupted:
        raise typer.Exit(INTERRUPTED)


def _timed(chosen: list[harness.Case], rounds: int) -> harness.Measured:
    """Measure under a progress bar."""
    with Progress(
        *(TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()),
        console=errors,
        transient=True,
    ) as progress:
        bar = progress.add_task("", total=len(chosen) * (rounds + 1))

        def advance(name: str) -> None:
            progress.update(bar, advance=1, description=f"{name:36}")

        return harness.measure(chosen, rounds, advance)


def _compared(only: str, quick: bool, rounds: int) -> tuple[list[dict[str, Any]], bool]:
    """Measure cases beside each other, print a table; return its rows, and whether Ctrl-C came."""
    from twin.performance import cases

    chosen = cases.chosen(only, quick=quick)
    memory = {n: m for n, m in cases.MEMORY.items() if only.lower() in n.lower()}
    first = {n: m for n, m in cases.FIRST_USES.items() if only.lower() in n.lower() and not quick}
    if not chosen and not memory and not first:
        raise BenchmarkError(f"--only {only!r}: no such case; leave it out to see them all")
    measured = _timed(chosen, rounds)
    rows = measured.rows(chosen)
    table = Table(title="speed", box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for name in ("case", "us", "per s", "ratio", "must", "reached"):
        table.add_column(name, justify="left" if name == "case" else "right", no_wrap=True)
    by_name = {case.name: case for case in chosen}
    block = None
    for row in rows:
        case = by_name[row["name"]]
        must = [] if case.must is None else [_thousands(case.must)]
        must += [] if case.must_ratio is None else [f"{case.must_ratio:g} x"]
        if block not in (None, case.relative_to or case.name):
            table.add_section()
        block = case.relative_to or case.name
        ratio, reached = row["ratio"], measured.reached(case)
        table.add_row(
            case.name,
            _digits(row["median_us"]),
            _thousands(row["rate_per_s"]),
            "" if ratio is None else _digits(ratio),
            ", ".join(must),
            "" if reached is None else f"{reached:.2f}",
        )
    console.print(table)
    console.print(
        "us: median per step of one boat, update, row, prediction or frame; ratio: speed over that "
        "of the first case of the block, median of the ratios round by round; must: rate on a "
        "machine where Pendulum makes 94 k steps/s, or ratio; reached: part of it, 1 is enough.",
        highlight=False,
    )
    for name, (options, longest) in first.items():
        if measured.interrupted:
            break
        try:
            with errors.status(f"{name}: compiling"):
                seconds = cases.first_use(options)
        except KeyboardInterrupt:
            measured.interrupted = True
            break
        except RuntimeError as error:
            measured.absent[name] = str(error)
            continue
        timed = {"rate_per_s": 1.0 / seconds, "median_us": 1e6 * seconds}
        rows.append({"name": name, **timed, "relative_to": None, "ratio": None})
        at_most = "" if longest is None else f"; at most {longest:g} s"
        console.print(f"{name}, compiling: {seconds:.1f} s of one core{at_most}", highlight=False)
    for name, (twin, most) in memory.items():
        if measured.interrupted:
            break
        size = cases.memory_per_boat(twin)
        nothing = dict.fromkeys(("rate_per_s", "median_us", "relative_to", "ratio"))
        rows.append({"name": name, **nothing, "bytes": size})
        limit = "" if most is None else f"; at most {most / 1e3:g} kB"
        console.print(f"{name}: {size / 1e3:.1f} kB{limit}", highlight=False)
    if measured.interrupted:
        note("interrupted: the medians are those of the rounds so far; sizes were not measured")
    for why in dict.fromkeys(measured.absent.values()):
        names = [name for name, reason in measured.absent.items() if reason == why]
        note(f"left out: {', '.join(names)}: {why}")
    return rows, measured.interrupted


def _grown(
    curves: tuple[cases.Curve, ...], only: str, rounds: int
) -> tuple[list[dict[str, Any]], bool]:
    """Measure how cost grows, print a table of each curve, and return as _compared does."""
    from twin.performance import cases

    curves = tuple(c for c in curves if only.lower() in f"{c.name}, {c.size}".lower())
    if not curves:
        raise BenchmarkError(f"--only {only!r}: no such curve; leave it out to see them all")
    rows: list[dict[str, Any]] = []
    for curve in curves:
        measured = _timed(cases.growth_cases(curve), rounds)
        part, line = cases.growth_rows(curve, measured)
        rows += part
        table = Table(title=f"{curve.name}, us", box=SIMPLE_HEAD)
        for name in (curve.size, "us", "line", "off"):
            table.add_column(name, justify="right")
        for row in part:
            at, us = row["line_us"], row["median_us"]
            off = "" if at is None else f"{100.0 * (us / at - 1.0):+.0f} %"
            table.add_row(str(row["size"]), _digits(us), "" if at is None else _digits(at), off)
        console.print(table)
        if line is not None:
            console.print(line.told(curve.size), highlight=False)
        if measured.interrupted:
            return rows, True
    return rows, False


def _thousands(value: float) -> str:
    """Return a rate with three digits and k or M."""
    for factor, unit in ((1e6, " M"), (1e3, " k")):
        if value >= factor:
            return f"{_digits(value / factor)}{unit}"
    return _digits(value)
