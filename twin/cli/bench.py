"""``usv-twin bench``: speed of the package beside Gymnasium's Pendulum and filterpy."""

from __future__ import annotations

import os
import runpy
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from twin.cli.common import (
    INTERRUPTED,
    OptionError,
    console,
    errors,
    new_table,
    note,
    three_digits,
    write_json,
)

if TYPE_CHECKING:
    from twin.performance.harness import Case, Measured

GROWTH = Path(__file__).resolve().parents[2] / "examples" / "speed" / "growth.py"
"""The script behind ``--growth``."""


def bench_command(
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer rounds, and no compilation: under a minute.")
    ] = False,
    growth: Annotated[
        bool,
        typer.Option(
            "--growth",
            help="Run examples/speed/growth.py instead: cost against wave components, boats, "
            "window and horizon.",
        ),
    ] = False,
    only: Annotated[str, typer.Option(help="Only cases with this text in their names.")] = "",
    rounds: Annotated[
        int | None, typer.Option(min=1, help="Bursts of each case. [9; quick, growth: 5]")
    ] = None,
    json_out: Annotated[
        Path | None, typer.Option("--json", help="Write the rows as JSON too.")
    ] = None,
) -> None:
    """Measure the speed of this package, and of Pendulum and filterpy beside it.

    All cases take turns in short bursts. Shown are medians over the rounds, per operation: a step
    of one boat, an update, a row, a refit, a prediction. "ratio": speed over that of the first case
    of the block. "target": least rate on the reference machine, where Gymnasium's Pendulum makes 94
    k steps/s, or least ratio. "fraction": the part of the target that is reached, with rates scaled
    by Pendulum's rate in the same round. 1 or more is enough on any machine. Ctrl-C shows what is
    there.
    """
    if json_out is not None:
        # before the minutes of measuring, not after them
        folder = json_out.parent
        if json_out.is_dir() or not folder.is_dir() or not os.access(folder, os.W_OK):
            raise OptionError(
                f"--json {json_out}: must be a file in a folder that exists and can be written to"
            )
    rounds = rounds or (5 if quick or growth else 9)
    if growth:
        if not GROWTH.is_file():
            raise FileNotFoundError(2, "--growth needs this file of the repository", str(GROWTH))
        rows, interrupted = runpy.run_path(str(GROWTH))["measure_growth"](only, rounds, _measure)
    else:
        rows, interrupted = _compare(only, quick, rounds)
    if json_out is not None:
        write_json(json_out, rows)
        console.print(f"rows: {json_out}")
    if interrupted:
        raise typer.Exit(INTERRUPTED)


def _measure(cases: list[Case], rounds: int) -> Measured:
    """Measure under a progress bar."""
    from twin.performance.harness import measure

    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=errors, transient=True) as progress:
        bar = progress.add_task("", total=len(cases) * (rounds + 1))

        def advance(name: str) -> None:
            progress.update(bar, advance=1, description=f"{name:36}")

        return measure(cases, rounds, advance)


def _compare(only: str, quick: bool, rounds: int) -> tuple[list[dict[str, Any]], bool]:
    """Measure cases, print a table; return its rows, and whether Ctrl-C came."""
    from twin.performance import cases

    chosen = cases.select_cases(only)
    memory = {n: m for n, m in cases.MEMORY.items() if only.lower() in n.lower()}
    compiles = {n: m for n, m in cases.COLD_COMPILES.items() if only.lower() in n.lower()}
    if quick:
        compiles = {}
    if not chosen and not memory and not compiles:
        raise OptionError(f"--only {only!r}: no such case; leave it out to see them all")
    measured = _measure(chosen, rounds)
    rows = measured.rows(chosen)
    _print_rates(chosen, rows, measured)
    try:
        for name, (options, limit) in () if measured.interrupted else compiles.items():
            try:
                with errors.status(f"{name}: compiling"):
                    seconds = cases.cold_compile_seconds(options)
            except cases.CompileError as error:
                note(f"left out: {name}: {error}")
                continue
            timed = {"rate_per_s": 1.0 / seconds, "median_us": 1e6 * seconds}
            rows.append({"name": name, **timed, "relative_to": None, "ratio": None})
            at_most = "" if limit is None else f"; at most {limit:g} s"
            console.print(f"{name}: {seconds:.1f} s of one core{at_most}", highlight=False)
        for name, (twin, limit) in () if measured.interrupted else memory.items():
            size = cases.memory_per_boat(twin)
            nothing = dict.fromkeys(("rate_per_s", "median_us", "relative_to", "ratio"))
            rows.append({"name": name, **nothing, "bytes": size})
            at_most = "" if limit is None else f"; at most {limit / 1e3:g} kB"
            console.print(f"{name}: {size / 1e3:.1f} kB{at_most}", highlight=False)
    except KeyboardInterrupt:
        measured.interrupted = True
    if measured.interrupted:
        note("interrupted: the medians are those of the rounds so far; sizes were not measured")
    return rows, measured.interrupted


def _print_rates(chosen: list[Case], rows: list[dict[str, Any]], measured: Measured) -> None:
    """Print a table with a block for each case that others are compared with."""
    heads = ("case", "us", "per s", "ratio", "target", "fraction")
    table = new_table("speed", *heads, left=("case",), pad_edge=False)
    by_name = {case.name: case for case in chosen}
    block = None
    for row in rows:
        case = by_name[row["name"]]
        if block not in (None, case.relative_to or case.name):
            table.add_section()
        block = case.relative_to or case.name
        targets = [] if case.target is None else [_thousands(case.target)]
        targets += [] if case.target_ratio is None else [f"{case.target_ratio:g} x"]
        fraction = measured.target_fraction(case)
        table.add_row(
            case.name,
            three_digits(row["median_us"]),
            _thousands(row["rate_per_s"]),
            "" if row["ratio"] is None else three_digits(row["ratio"]),
            ", ".join(targets),
            "" if fraction is None else f"{fraction:.2f}",
        )
    console.print(table)


def _thousands(value: float) -> str:
    """Return a rate with three digits and k or M."""
    for factor, unit in ((1e6, " M"), (1e3, " k")):
        if value >= factor:
            return f"{three_digits(value / factor)}{unit}"
    return three_digits(value)
