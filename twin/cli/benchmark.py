"""``usv-twin benchmark``: forecasts of all predictors, scored and reported."""

from __future__ import annotations

import contextlib
import gzip
import os
import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from twin.benchmark import runner as bench
from twin.benchmark.protocol import (
    FULL,
    FULL_CASES,
    SPREAD,
    BenchmarkError,
    Case,
    Settings,
    Unit,
    available,
    left_out,
    units,
)
from twin.cli.common import (
    INTERRUPTED,
    DofOption,
    MappingOption,
    ModelOption,
    _busy,
    _short,
    _speaking,
    _write_text,
    app,
    console,
    errors,
    listed,
    note,
    seeds_of,
)
from twin.digital_twin import PLANS
from twin.files import results_text
from twin.logs.columns import LogError
from twin.logs.rosbag import is_bag
from twin.parallel import BACKENDS, check_backend
from twin.predictors.registry import PREDICTORS, PredictorError
from twin.sim.recorded import NO_PARTICULARS, lacks_particulars
from usv_gym.manoeuvring.manoeuvres import MANOEUVRES
from usv_gym.vessel.vessel import Vessel, vessel_names
from usv_gym.world.faults import FAULTS_HELP


@app.command("benchmark")
@_speaking
def benchmark_command(
    full: Annotated[
        bool,
        typer.Option(
            "--full",
            help="The full protocol: four scenarios, 24 boats, losses of GPS and IMU, sea states "
            "and grades of sensors, one at a time; --scenarios, --cases, --seeds, --predictors "
            "and --plans thin it.",
        ),
    ] = False,
    check: Annotated[
        str | None,
        typer.Option(
            help="Only check that a predictor (a name, or module:Class) keeps the contract of "
            "all predictors; exit code 1 where it does not."
        ),
    ] = None,
    scenarios: Annotated[
        str | None,
        typer.Option(help=f"Comma-separated, of: {', '.join(MANOEUVRES)}. [turn,zigzag]"),
    ] = None,
    faults: Annotated[
        str | None, typer.Option(help=f"Comma-separated, each {FAULTS_HELP}. [none,gps10]")
    ] = None,
    cases: Annotated[
        str | None,
        typer.Option(
            help=f"Comma-separated, of the full protocol's: {', '.join(FULL_CASES)}. [all]"
        ),
    ] = None,
    seeds: Annotated[
        str | None,
        typer.Option(help="A-B (or A:B for A to B - 1), or a list as 0,4,7. [0-5; full: 200-223]"),
    ] = None,
    predictors: Annotated[
        str,
        typer.Option(
            help=f"Comma-separated, of: {', '.join(PREDICTORS)}; or module:Class, of your own."
        ),
    ] = ",".join(PREDICTORS),
    plans: Annotated[
        str | None,
        typer.Option(
            help=f"Comma-separated, of: {', '.join(PLANS)} (commands of the future). "
            "[known,hold; full: known]"
        ),
    ] = None,
    against: Annotated[
        str | None,
        typer.Option(
            help=f"Reference of the paired comparison. [{bench.AGAINST}; recorded runs: "
            f"{bench.AGAINST_RECORDED}]"
        ),
    ] = None,
    vessel: Annotated[
        str, typer.Option(help=f"Name ({', '.join(vessel_names())}) or TOML file.")
    ] = "usv75",
    spread: Annotated[
        float,
        typer.Option(help="Every seed sails another boat, by this share; 0: the vessel as it is."),
    ] = SPREAD,
    dof: DofOption = 3,
    model: ModelOption = None,
    hs: Annotated[float, typer.Option(help="Significant wave height, m.")] = 0.5,
    wind: Annotated[float, typer.Option(help="Mean wind speed at 10 m, m/s.")] = 4.5,
    wind_from: Annotated[
        float, typer.Option(help="Where the wind comes from, degrees from north.")
    ] = 135.0,
    log: Annotated[
        list[Path] | None,
        typer.Option(help="Recorded runs to score instead of simulated ones (several files)."),
    ] = None,
    ship: Annotated[
        str | None,
        typer.Option(
            help="Particulars for the recorded runs, as for identify; a file of [[ship]] tables "
            "tells several boats apart by their logs."
        ),
    ] = None,
    mapping: MappingOption = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of results.")] = Path(
        "benchmark"
    ),
    jobs: Annotated[int, typer.Option(min=1, help="Workers; results do not depend on it.")] = (
        os.cpu_count() or 1
    ),
    backend: Annotated[
        str, typer.Option(help=f"Kind of workers, one of: {', '.join(BACKENDS)}.")
    ] = "loky",
) -> None:
    """Compare predictors on the same runs, with and without a loss of GPS.

    A 10 s prediction every second after 80 s of identification, scored against the truth;
    every seed is another boat of the same kind in another sea. J and E measure each predictor
    against the oracle: the true boat in the mean wind. Without arguments: a 20 degree turn and
    a 20/-20 zigzag of 7.5 m boats in sea state 2, six seeds each, future commands known and
    held, and one recorded run of a real boat. With --full the full protocol. With --log recorded
    runs, scored against what was measured later, those of the archives twin.logs.datasets knows as
    they were downloaded; a file that cannot be read is named, and the others are scored.
    Writes results.json, report.html, the pictures, and every run as a log that identify and
    predict read. Ctrl-C keeps what is finished; the same command goes on from there.
    """
    if check is not None:
        _check(check)
        return
    check_backend(backend)
    asked = listed(predictors, "--predictors")
    names, notes = available(asked)
    if not names:
        raise PredictorError("; ".join(notes))
    recorded, missing = _present(log or [])
    usual: dict[str, Any] = {"logs": recorded}
    if full:
        usual |= {**FULL, "cases": _cases(cases)} if not recorded else FULL
    elif cases is not None:
        raise BenchmarkError("--cases are those of the full protocol: add --full")
    else:
        usual["logs"] = recorded or bench.default_logs()
    if recorded:
        usual |= {"scenarios": (), "ship": ship}
    elif scenarios is not None:
        usual["scenarios"] = listed(scenarios, "--scenarios")
    if faults is not None:
        if full:
            raise BenchmarkError("--faults: the full protocol has --cases in its place")
        usual["faults"] = listed(faults, "--faults")
    elif recorded:
        usual["faults"] = ("none",)
    if seeds is not None:
        usual["seeds"] = seeds_of(seeds)
    if plans is not None:
        usual["plans"] = listed(plans, "--plans")
    settings = Settings(
        predictors=names,
        vessel=vessel,
        spread=spread,
        dof=dof,
        model=model,
        hs=hs,
        wind=wind,
        wind_from_deg=wind_from,
        mapping=str(mapping) if recorded and mapping else None,
        **usual,
    )
    if against is not None and against not in names:
        raise PredictorError(
            f"--against {against}: takes no part; it must be one of --predictors: "
            f"{', '.join(names)}"
        )
    Vessel.load(vessel)
    notes += left_out(settings)
    notes += tuple(
        NO_PARTICULARS.format(path) for path in recorded if ship is None and lacks_particulars(path)
    )
    for line in notes:
        note(line)
    out.mkdir(parents=True, exist_ok=True)
    done, failed = _work(settings, out, jobs, backend)
    not_scored = tuple(
        f"not scored: {reason if run in reason else f'{run}: {reason}'}"
        for run, reason in {**missing, **failed}.items()
    )
    command = shlex.join(["usv-twin", *sys.argv[1:]])
    results = bench.collect(settings, done, command, notes + not_scored, against)
    if full:  # hundreds of thousands of rows: a table of their own
        _write_table(out / "rows.csv.gz", results.pop("rows"))
        del results["runs"]
    _write_text(out / "results.json", results_text(results))
    _print_benchmark({**results, "notes": notes}, [name for name in asked if name not in names])
    for line in not_scored:
        errors.print(line, style="red", highlight=False, soft_wrap=True)
    total = len(units(settings))
    if len(done) + sum(failed.counts.values()) < total:
        kept = sum(bench.result_file(out, unit).exists() for unit in units(settings))
        errors.print(
            f"stopped: {kept} of {total} results are kept in {out}; "
            "the same command goes on from there",
            style="yellow",
        )
        raise typer.Exit(INTERRUPTED)
    if not done:
        raise BenchmarkError("nothing could be scored; the lines above say why")
    from twin.benchmark.report import write_report

    with console.status("drawing the report"):
        written = write_report(out, results, bench.figures(settings, done))
    console.print(f"{out / 'results.json'}, {written[0]}")


def _cases(text: str | None) -> tuple[Case, ...]:
    """Return cases of the full protocol by name."""
    names = tuple(FULL_CASES) if text is None else listed(text, "--cases")
    for name in names:
        if name not in FULL_CASES:
            known = ", ".join(FULL_CASES)
            raise BenchmarkError(f"no case is called {name!r}; known: {known}")
    return tuple(FULL_CASES[name] for name in names)


def _check(name: str) -> None:
    """Print whether a predictor keeps the contract; exit code 1 where it does not."""
    from twin.benchmark.conformance import check

    table = Table(title=f"contract of {name}", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for head in ("", "check", "what happened"):
        table.add_column(head, no_wrap=head != "what happened")
    with _busy("checking"):
        found = check(name)
    marks = {True: "pass", False: "FAIL", None: "skip"}
    for item in found:
        table.add_row(marks[item.passed], item.name, item.text)
    console.print(table)
    broken = sum(item.passed is False for item in found)
    console.print(f"{len(found)} checks, {broken} failed")
    if broken:
        raise typer.Exit(1)


class _Failed(dict[str, str]):
    """Reasons why there is no result, by run or file; ``counts`` says of how many predictors."""

    def __init__(self) -> None:
        super().__init__()
        self.counts: dict[str, int] = {}

    def add(self, unit: Unit, error: Exception) -> None:
        """Keep a reason; the same of several predictors on a run is told once."""
        where = unit.log or unit.run
        key = where if self.get(where, str(error)) == str(error) else f"{where} {unit.predictor}"
        self[key] = str(error)
        self.counts[key] = self.counts.get(key, 0) + 1


def _work(
    settings: Settings, out: Path, jobs: int, backend: str
) -> tuple[dict[Unit, dict[str, Any]], _Failed]:
    """Do all pieces of work under a progress bar; Ctrl-C ends it early."""
    done: dict[Unit, dict[str, Any]] = {}
    failed = _Failed()
    total = len(units(settings))
    with contextlib.suppress(KeyboardInterrupt):
        if not bench.all_finished(settings, out):
            bench.warm_up(settings)
        with Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=console,
            # of a run with all its predictors at a time: a longer memory than of seconds
            speed_estimate_period=600.0,
        ) as progress:
            bar = progress.add_task("benchmark", total=total)
            for unit, result in bench.runs(settings, out, jobs=jobs, backend=backend):
                if isinstance(result, Exception):
                    failed.add(unit, result)
                else:
                    done[unit] = result
                progress.advance(bar)
    return done, failed


def _print_benchmark(results: dict[str, Any], left_out: list[str]) -> None:
    """Print the result table, a block for each run and case, and the notes."""
    cells: dict[tuple[str, str, str], dict[str, dict[str, dict[str, Any]]]] = {}
    for item in results["summary"]:
        case = item.get("case", item["fault"])
        block = cells.setdefault((item["scenario"], case, item["plan"]), {})
        block.setdefault(item["predictor"], {})[item["metric"]] = item
    if len(cells) > MOST_BLOCKS:
        _print_overview(cells)
    else:
        _print_blocks(cells, left_out)
        _print_paired(results.get("paired", []))
    _print_recorded(results.get("recorded", []))
    for name, log in results.get("logs", {}).items():
        parts = (
            [f"{len(log['repairs'])} notes and repairs (results.json)"] if log["repairs"] else []
        )
        if log["skipped"]:
            parts.append(f"{log['skipped']} predictions not scored, in gaps")
        if parts:
            note(f"{name}: {', '.join(parts)}")
    for line in results["notes"]:
        note(line)
    console.print(
        "MAE and MSE as in the paper's Table 4: pooled over u, v, r, position and heading at 1, "
        "2, 5 and 10 s, units mixed; CRPS: the same of the whole distribution. norm. (error over "
        "the true change) and skill (1 - error / error of raw persistence) are means over channels "
        "and horizons. start (m): distance of the believed from the true position when a "
        "prediction is made. band: share of errors inside the 90 % bands. J: mean of MAE over "
        "that of the oracle, of u, v, r, heading and displacement over every half second "
        "up to 10 s; E is J - 1. Below the MAE: its 95 % interval over seeds; med.: its median. "
        "results.json and the report have the other intervals and medians, every case, and "
        "errors, CRPS and coverage by channel and horizon.",
        style="dim",
        soft_wrap=True,
    )


MOST_BLOCKS = 8
"""Runs and cases that are shown in full; of more, a table of one number each."""


def _print_overview(
    cells: dict[tuple[str, str, str], dict[str, dict[str, dict[str, Any]]]],
) -> None:
    """Print one number for each run, case and predictor: E where the oracle took part, or MAE."""
    predictors = list(dict.fromkeys(name for block in cells.values() for name in block))
    excess = all("E" in metrics for block in cells.values() for metrics in block.values())
    metric, title = ("E", "E, excess over the oracle") if excess else ("mae", "MAE")
    name_width = max(map(len, predictors))
    for plan in dict.fromkeys(plan for _, _, plan in cells):
        columns = [key for key in cells if key[2] == plan]
        widest = max(len(word) for key in columns for word in key[:2]) + 1
        many = max(1, (console.width - name_width - 2) // max(widest, 7))
        for first in range(0, len(columns), many):
            shown = columns[first : first + many]
            table = Table(title=f"{title}, plan {plan}", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
            table.add_column("predictor", no_wrap=True)
            for scenario, case, _ in shown:
                table.add_column(f"{scenario}\n{case}", justify="right", no_wrap=True)
            for name in predictors:
                values = (cells[key].get(name, {}).get(metric) for key in shown)
                texts = ("-" if item is None else _short(item["value"], 3) for item in values)
                table.add_row(name, *texts)
            console.print(table)


def _print_recorded(rows: list[dict[str, Any]]) -> None:
    """Print the RMSE after 10 s over that of raw persistence, for each folder of runs."""
    blocks: dict[tuple[str, str, str], dict[str, dict[str, dict[str, Any]]]] = {}
    for row in rows:
        block = blocks.setdefault((row["folder"], row["fault"], row["plan"]), {})
        block.setdefault(row["predictor"], {})[row["channel"]] = row
    for (folder, fault, plan), block in blocks.items():
        most = max(row["runs"] for channels in block.values() for row in channels.values())
        loss = "" if fault == "none" else f", loss {fault}"
        table = Table(
            title=f"{folder}, {most} run{'s' * (most > 1)}{loss}, plan {plan}: RMSE after 10 s "
            "over that of raw persistence",
            box=SIMPLE_HEAD,
            padding=(0, 1, 0, 0),
        )
        table.add_column("predictor", no_wrap=True)
        for name in ("displace-\nment", "geom.\nmean", "%", "heading", "geom.\nmean", "%"):
            table.add_column(name, justify="right", no_wrap=True)
        for predictor, channels in block.items():
            texts: list[str] = []
            for channel in ("displacement", "psi"):
                row = channels[channel]
                texts += [_short(row["ratio"], 3), _short(row["geometric"], 3), _change(row)]
            table.add_row(predictor, *texts)
        console.print(table)
    against = next((row["against"] for row in rows if "against" in row), None)
    if against is not None:
        console.print(
            f"%: change of the mean ratio against {against} on the same runs, with its 95 % "
            "bootstrap interval over runs",
            style="dim",
            soft_wrap=True,
        )


def _change(row: dict[str, Any]) -> str:
    """Return a change against the reference with its interval, in %."""
    if "change_percent" not in row:
        return "-"
    text = f"{row['change_percent']:+.0f}"
    if row["change_low"] is not None:
        text += f"\n{row['change_low']:+.0f}..{row['change_high']:+.0f}"
    return text


def _print_blocks(
    cells: dict[tuple[str, str, str], dict[str, dict[str, dict[str, Any]]]], left_out: list[str]
) -> None:
    heads = {
        "mae": "MAE",
        "mae_median": "med.",
        "mse": "MSE",
        "crps": "CRPS",
        "normalised": "norm.",
        "skill": "skill",
        "J": "J",
        "E": "E",
        "start_error": "start",
        "coverage90": "band",
    }
    shown = {metric for block in cells.values() for metrics in block.values() for metric in metrics}
    heads = {metric: head for metric, head in heads.items() if metric in shown}
    for (scenario, case, plan), block in cells.items():
        loss = "no loss" if case == "none" else f"loss {case}"
        if case in FULL_CASES:
            loss = f"case {case}"
        table = Table(title=f"{scenario}, {loss}, plan {plan}", box=SIMPLE_HEAD, padding=0)
        table.add_column("predictor", no_wrap=True)
        for head in heads.values():
            table.add_column(head, justify="right", no_wrap=True)
        for predictor, metrics in block.items():
            table.add_row(
                predictor,
                *(_cell(metrics.get(metric), metric) for metric in heads),
            )
        for predictor in left_out:
            table.add_row(predictor, "left out", *("-" for _ in range(len(heads) - 1)))
        console.print(table)


def _print_paired(rows: list[dict[str, Any]]) -> None:
    """Print how each predictor compares with the reference on the same seeds."""
    if not rows:
        return
    table = Table(
        title=f"MAE against {rows[0]['against']}, %, the same seeds",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    for head in ("run", "case", "plan", "predictor"):
        table.add_column(head, no_wrap=head != "run")
    for head in ("change", "interval", "better"):
        table.add_column(head, justify="right", no_wrap=True)
    for row in rows:
        between = "-" if row["low"] is None else f"{row['low']:+.1f}..{row['high']:+.1f}"
        names = (row[key] for key in ("scenario", "case", "plan", "predictor"))
        wins = f"{row['wins']} of {row['seeds']}"
        table.add_row(*names, f"{row['change_percent']:+.1f}", between, wins)
    console.print(table)


def _cell(item: dict[str, Any] | None, metric: str) -> str:
    """Return one value, and for the MAE its interval: more does not fit into 80 columns."""
    if item is None:
        return "-"
    text = _short(item["value"], 2 if metric in ("mae_median", "start_error", "coverage90") else 3)
    if metric == "mae" and item["low"] is not None:
        text += f"\n{_short(item['low'], 2)}..{_short(item['high'], 2)}"
    return text


def _write_table(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write rows as a packed CSV; equal rows give equal bytes."""
    import polars as pl

    text = pl.DataFrame(rows).write_csv()
    path.write_bytes(gzip.compress(text.encode(), mtime=0))


def _present(logs: list[Path]) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return the files that are there, and why others are not; one must be there if any is given.

    What is not there is told of at the end: the others are still scored.
    """
    there: list[str] = []
    missing: dict[str, str] = {}
    for given in logs:
        try:
            there += _matching(given)
        except LogError as error:  # noqa: PERF203
            missing[str(given)] = str(error)
    if missing and not there:
        raise LogError("; ".join(missing.values()))
    return tuple(dict.fromkeys(there)), missing


def _matching(given: Path) -> list[str]:
    """Return the files that a name, or a pattern that the shell has left as it is, stands for."""
    found = [given]
    if set("*?[") & set(str(given)) and not given.exists():
        found = sorted(Path(given.anchor).glob(str(given.relative_to(given.anchor))))
    files = [str(path) for path in found if path.is_file() or is_bag(path)]
    if not files:
        raise LogError(f"{given}: no such file; name logs, or a pattern such as 'runs/*.csv'")
    return files
