"""``usv-twin benchmark``: predictions of all predictors, scored and reported."""

from __future__ import annotations

import contextlib
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import TimeRemainingColumn
from rich.table import Table

from twin.benchmark import runner
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
    CPUS,
    BackendOption,
    DofOption,
    JobsOption,
    MappingOption,
    ModelOption,
    console,
    errors,
    explain,
    new_table,
    note,
    parse_list,
    parse_seeds,
    progress_bar,
    short,
    status,
    stopped,
    write_text,
)
from twin.digital_twin import PLANS
from twin.files import compressed_csv, results_text
from twin.logs.columns import LogError
from twin.logs.rosbag import is_bag
from twin.parallel import check_backend
from twin.predictors.registry import PREDICTORS, PredictorError
from usv_gym.manoeuvring.manoeuvres import MANOEUVRES
from usv_gym.vessel.vessel import Vessel, vessel_names
from usv_gym.world.faults import FAULTS_HELP
from usv_kernel.files import write_whole

Row = Mapping[str, Any]

Cells = dict[tuple[str, str, str], dict[str, dict[str, Row]]]
"""Rows of a summary by (scenario, case, plan), predictor and metric."""


def benchmark_command(
    full: Annotated[
        bool,
        typer.Option(
            "--full",
            help="The full protocol: four scenarios, 24 boats, losses of GPS and IMU, sea states "
            "and grades of sensors, one at a time. --scenarios, --cases, --seeds, --predictors "
            "and --plans restrict it.",
        ),
    ] = False,
    check: Annotated[
        str | None,
        typer.Option(
            help="Only check that a predictor (a name, or module:Class) keeps the contract of "
            "all predictors. Exit code 1: it does not."
        ),
    ] = None,
    faults_matrix: Annotated[
        bool,
        typer.Option(
            "--faults-matrix",
            help="Only sail every fault of sensors and commands that the twin knows, and print how "
            "ukf and dsw-ukf-plus bear it. --predictors and --seeds [0-7] restrict it.",
        ),
    ] = False,
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
            help=f"Comma-separated, of: {', '.join(PREDICTORS)}; or module:Class of your own."
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
            help=f"Reference of the paired comparison. [{runner.AGAINST}; recorded runs: "
            f"{runner.AGAINST_RECORDED}]"
        ),
    ] = None,
    vessel: Annotated[
        str, typer.Option(help=f"Name ({', '.join(vessel_names())}) or TOML file.")
    ] = "usv75",
    spread: Annotated[
        float,
        typer.Option(
            help="Relative variation of the boat from seed to seed. 0: the vessel as it is."
        ),
    ] = SPREAD,
    dof: DofOption = 3,
    model: ModelOption = None,
    hs: Annotated[float, typer.Option(help="Significant wave height, m.")] = 0.5,
    wind: Annotated[float, typer.Option(help="Mean wind speed at 10 m, m/s.")] = 4.5,
    wind_from: Annotated[
        float, typer.Option(help="Direction the wind comes from, degrees from north.")
    ] = 135.0,
    log: Annotated[
        list[Path] | None,
        typer.Option(help="Recorded runs to score instead of simulated ones (several files)."),
    ] = None,
    ship: Annotated[
        str | None,
        typer.Option(
            help="Particulars for the recorded runs, as for identify. A file of [[ship]] tables "
            "holds several boats, each with its logs."
        ),
    ] = None,
    mapping: MappingOption = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of results.")] = Path(
        "benchmark"
    ),
    jobs: JobsOption = CPUS,
    backend: BackendOption = "loky",
) -> None:
    """Compare predictors on the same runs, with and without a loss of GPS.

    Each predictor makes a 10 s prediction every second after 80 s of identification; the truth
    scores it. Every seed is another boat of the same kind in another sea. J and E compare each
    predictor with the oracle, which knows the true boat and the mean wind.

    Without arguments: a 20 degree turn and a 20/-20 zigzag of 7.5 m boats in sea state 2. There
    are six seeds each, future commands known and held, and one recorded run of a real boat. With
    --full: the full protocol. With --log: recorded runs, scored against later measurements.
    Archives that twin.logs.datasets knows are read as downloaded. A file that cannot be read is
    reported, and the others are scored.

    Writes results.json, report.html, the pictures, and every run as a log for identify and
    predict. Ctrl-C keeps what is finished; the same command continues from there.
    """
    if check is not None:
        _check(check)
        return
    if faults_matrix:
        given = "ukf,dsw-ukf-plus" if predictors == ",".join(PREDICTORS) else predictors
        _matrix(parse_list(given, "--predictors"), parse_seeds(seeds or "0-7"), out, jobs)
        return
    check_backend(backend)
    asked = parse_list(predictors, "--predictors")
    names, notes = available(asked)
    if not names:
        raise PredictorError("; ".join(notes))
    recorded, missing = _find_logs(log or [])
    options: dict[str, Any] = {"logs": recorded}
    if full:
        options |= {**FULL, "cases": _parse_cases(cases)} if not recorded else FULL
    elif cases is not None:
        raise BenchmarkError("--cases are those of the full protocol: add --full")
    else:
        options["logs"] = recorded or runner.default_logs()
    if recorded:
        options |= {"scenarios": (), "ship": ship}
    elif scenarios is not None:
        options["scenarios"] = parse_list(scenarios, "--scenarios")
    if faults is not None:
        if full:
            raise BenchmarkError("--faults: the full protocol has --cases in its place")
        options["faults"] = parse_list(faults, "--faults")
    elif recorded:
        options["faults"] = ("none",)
    if seeds is not None:
        options["seeds"] = parse_seeds(seeds)
    if plans is not None:
        options["plans"] = parse_list(plans, "--plans")
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
        **options,
    )
    if against is not None and against not in names:
        raise PredictorError(
            f"--against {against}: takes no part; it must be one of --predictors: "
            f"{', '.join(names)}"
        )
    Vessel.load(vessel)
    notes += left_out(settings)
    for line in notes:
        note(line)
    out.mkdir(parents=True, exist_ok=True)
    done, failed = _run_all(settings, out, jobs, backend)
    not_scored = tuple(
        f"not scored: {reason if run in reason else f'{run}: {reason}'}"
        for run, reason in {**missing, **failed}.items()
    )
    command = shlex.join(["usv-twin", *sys.argv[1:]])
    console.print(f"scoring {len(done)} results")
    results = runner.collect(settings, done, command, notes + not_scored, against)
    if full:  # hundreds of thousands of rows: a table of their own
        write_whole(out / "rows.csv.gz", compressed_csv(results.pop("rows")))
        del results["runs"]
    write_text(out / "results.json", results_text(results))
    print_results({**results, "notes": notes}, [name for name in asked if name not in names])
    for line in not_scored:
        errors.print(line, style="red", highlight=False, soft_wrap=True)
    work = units(settings)
    if len(done) + sum(failed.counts.values()) < len(work):
        kept = sum(runner.result_file(out, unit).exists() for unit in work)
        raise stopped(
            f"{kept} of {len(work)} results are kept in {out}; the same command goes on from there"
        )
    if not done:
        raise BenchmarkError("nothing could be scored; the lines above say why")
    from twin.benchmark.report import write_report

    figures = runner.run_figures(settings, done)
    console.print(f"drawing {out / 'pictures'}: errors, and {len(figures)} run(s) in detail")
    with progress_bar(transient=True) as progress:
        bar = progress.add_task("drawing", total=None)

        def drawn(name: str) -> None:
            progress.update(bar, advance=1, description=name)

        written = write_report(out, results, figures, drawn)
    console.print(f"{out / 'results.json'}, {written[0]}")


def _parse_cases(text: str | None) -> tuple[Case, ...]:
    """Return cases of the full protocol by name."""
    names = tuple(FULL_CASES) if text is None else parse_list(text, "--cases")
    for name in names:
        if name not in FULL_CASES:
            known = ", ".join(FULL_CASES)
            raise BenchmarkError(f"no case is called {name!r}; known: {known}")
    return tuple(FULL_CASES[name] for name in names)


def _find_logs(logs: list[Path]) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return the log files, and a reason for each that is missing; refuse if all are missing."""
    found: list[str] = []
    missing: dict[str, str] = {}
    for given in logs:
        try:
            found += match_files(given)
        except LogError as error:  # noqa: PERF203
            missing[str(given)] = str(error)
    if missing and not found:
        raise LogError("; ".join(missing.values()))
    return tuple(dict.fromkeys(found)), missing


def match_files(given: Path) -> list[str]:
    """Return the files of a name, or of a pattern that the shell has not expanded."""
    found = [given]
    if set("*?[") & set(str(given)) and not given.exists():
        found = sorted(Path(given.anchor).glob(str(given.relative_to(given.anchor))))
    files = [str(path) for path in found if path.is_file() or is_bag(path)]
    if not files:
        raise LogError(f"{given}: no such file; name logs, or a pattern such as 'runs/*.csv'")
    return files


def _check(name: str) -> None:
    """Print whether a predictor keeps the contract; exit code 1 if it does not."""
    from twin.benchmark.conformance import check

    heads = ("", "check", "result")
    table = new_table(f"contract of {name}", *heads, left=heads)
    table.columns[-1].no_wrap = False
    with status("checking"):
        found = check(name)
    marks = {True: "pass", False: "FAIL", None: "skip"}
    for item in found:
        table.add_row(marks[item.passed], item.name, item.text)
    console.print(table)
    broken = sum(item.passed is False for item in found)
    console.print(f"{len(found)} checks, {broken} failed")
    if broken:
        raise typer.Exit(1)


def _matrix(predictors: Sequence[str], seeds: Sequence[int], out: Path, jobs: int) -> None:
    """Sail the fault matrix, and print and write its table."""
    from twin.benchmark.fault_matrix import MATRIX_FAULTS, fault_runs, matrix_table

    out.mkdir(parents=True, exist_ok=True)
    file, results = out / "fault_matrix.json", []
    with progress_bar() as bar:
        task = bar.add_task("fault matrix", total=None)
        try:
            for done, total, found in fault_runs(predictors, MATRIX_FAULTS, seeds, file, jobs=jobs):
                results = found
                bar.update(task, completed=done, total=total)
        except KeyboardInterrupt:
            raise stopped(
                f"stopped: {file} has what is finished; the same command goes on"
            ) from None
    table = "\n".join(matrix_table(results)) + "\n"
    write_text(out / "fault_matrix.md", table)
    print(table, end="")
    note(f"{file}, {out / 'fault_matrix.md'}")


class _Failures(dict[str, str]):
    """Reasons for missing results, by run or file; ``counts`` says of how many predictors."""

    def __init__(self) -> None:
        super().__init__()
        self.counts: dict[str, int] = {}

    def add(self, unit: Unit, error: Exception) -> None:
        """Keep a reason; the same one of several predictors on a run counts once."""
        where = unit.log or unit.run
        key = where if self.get(where, str(error)) == str(error) else f"{where} {unit.predictor}"
        self[key] = str(error)
        self.counts[key] = self.counts.get(key, 0) + 1


def _run_all(
    settings: Settings, out: Path, jobs: int, backend: str
) -> tuple[dict[Unit, dict[str, Any]], _Failures]:
    """Do all work under a progress bar; Ctrl-C ends it early."""
    done: dict[Unit, dict[str, Any]] = {}
    failed = _Failures()
    with contextlib.suppress(KeyboardInterrupt):
        if not runner.all_finished(settings, out):
            runner.warm_up(settings)
        # one estimate over many runs, as each comes with all its predictors at a time
        with progress_bar(TimeRemainingColumn(), speed_estimate_period=600.0) as progress:
            bar = progress.add_task("benchmark", total=len(units(settings)))
            for unit, result in runner.runs(settings, out, jobs=jobs, backend=backend):
                if isinstance(result, Exception):
                    failed.add(unit, result)
                else:
                    done[unit] = result
                progress.advance(bar)
    return done, failed


# what is printed
MAX_BLOCKS = 8
"""Up to this many runs and cases are shown in full, more in an overview."""

HEADS = {
    "mae": "MAE",
    "mae_median": "med.",
    "mse": "MSE",
    "crps": "CRPS",
    "normalised": "norm.",
    "skill": "skill",
    "J": "J",
    "E": "E",
    "start_error": "start",
    "coverage90": "cov.",
}
"""Columns of the tables by metric."""


def print_results(results: dict[str, Any], missing: Sequence[str]) -> None:
    """Print a table for each run and case, and the notes.

    Parameters
    ----------
    results : dict
        Content of ``results.json``.
    missing : sequence of str
        Predictors that could not run here.
    """
    cells: Cells = {}
    for item in results["summary"]:
        case = item.get("case", item["fault"])
        block = cells.setdefault((item["scenario"], case, item["plan"]), {})
        block.setdefault(item["predictor"], {})[item["metric"]] = item
    if len(cells) > MAX_BLOCKS:
        _print_overview(cells)
    else:
        _print_blocks(cells, missing)
        _print_paired(results.get("paired", []))
    _print_recorded(results.get("recorded", []))
    for name, log in results.get("logs", {}).items():
        parts = []
        if log["repairs"]:
            parts.append(f"{len(log['repairs'])} notes and repairs (results.json)")
        if log["skipped"]:
            parts.append(f"{log['skipped']} predictions not scored, in gaps")
        if parts:
            note(f"{name}: {', '.join(parts)}")
    for line in results["notes"]:
        note(line)
    explain(
        "MAE and MSE as in the paper's Table 4: pooled over u, v, r, position and heading at 1, "
        "2, 5 and 10 s. Units are mixed. Below the MAE: its 95 % interval over seeds. med.: its "
        "median. CRPS: the same of the whole distribution. norm. (error over the true change) and "
        "skill (1 - error / error of raw persistence): means over channels and horizons. "
        "J: MAE over that of the oracle, mean of u, v, r, heading and displacement over every "
        "half second up to 10 s. E is J - 1. start: error of the estimated position at the time "
        "of the prediction, m. cov.: share of errors inside the 90 % prediction intervals. "
        "results.json and the report have all intervals and medians, and errors, CRPS and "
        "coverage by channel and horizon."
    )


def _print_overview(cells: Cells) -> None:
    """Print one number for each run, case and predictor: E with the oracle, else MAE."""
    predictors = list(dict.fromkeys(name for block in cells.values() for name in block))
    excess = all("E" in metrics for block in cells.values() for metrics in block.values())
    metric, title = ("E", "E, excess over the oracle") if excess else ("mae", "MAE")
    name_width = max(map(len, predictors))
    for plan in dict.fromkeys(key[2] for key in cells):
        columns = [key for key in cells if key[2] == plan]
        widest = max(len(word) for key in columns for word in key[:2]) + 1
        many = max(1, (console.width - name_width - 2) // max(widest, 7))
        for first in range(0, len(columns), many):
            shown = columns[first : first + many]
            heads = ("\n".join(key[:2]) for key in shown)
            table = new_table(f"{title}, plan {plan}", "predictor", *heads, left=("predictor",))
            for name in predictors:
                values = (cells[key].get(name, {}).get(metric) for key in shown)
                texts = ("-" if item is None else short(item["value"], 3) for item in values)
                table.add_row(name, *texts)
            console.print(table)


def _print_blocks(cells: Cells, missing: Sequence[str]) -> None:
    """Print a table of all metrics for each run and case."""
    there = {metric for block in cells.values() for metrics in block.values() for metric in metrics}
    heads = {metric: head for metric, head in HEADS.items() if metric in there}
    for (scenario, case, plan), block in cells.items():
        loss = "no loss" if case == "none" else f"loss {case}"
        if case in FULL_CASES:
            loss = f"case {case}"
        table = _predictor_table(f"{scenario}, {loss}, plan {plan}", *heads.values(), padding=0)
        for predictor, metrics in block.items():
            table.add_row(predictor, *(_cell(metrics.get(metric), metric) for metric in heads))
        for predictor in missing:
            table.add_row(predictor, "left out", *["-"] * (len(heads) - 1))
        console.print(table)


def _predictor_table(title: str, *heads: str, **style: Any) -> Table:
    """Return a table with a line for each predictor."""
    return new_table(title, "predictor", *heads, left=("predictor",), **style)


def _cell(item: Row | None, metric: str) -> str:
    """Return one value, and for the MAE its interval: more does not fit into 80 columns."""
    if item is None:
        return "-"
    text = short(item["value"], 2 if metric in ("mae_median", "start_error", "coverage90") else 3)
    if metric == "mae" and item["low"] is not None:
        text += f"\n{short(item['low'], 2)}..{short(item['high'], 2)}"
    return text


def _print_paired(rows: Sequence[Row]) -> None:
    """Print how each predictor compares with the reference on the same seeds."""
    if not rows:
        return
    names = ("scenario", "case", "plan", "predictor")
    heads = (*names, "change", "interval", "better")
    title = f"MAE against {rows[0]['against']}, %, the same seeds"
    table = new_table(title, *heads, left=names)
    table.columns[0].no_wrap = False
    for row in rows:
        table.add_row(
            *(row[name] for name in names),
            f"{row['change_percent']:+.1f}",
            "-" if row["low"] is None else f"{row['low']:+.1f}..{row['high']:+.1f}",
            f"{row['wins']} of {row['seeds']}",
        )
    console.print(table)


def _print_recorded(rows: Sequence[Row]) -> None:
    """Print the RMSE after 10 s over that of raw persistence, for each folder of runs."""
    blocks: Cells = {}
    for row in rows:
        block = blocks.setdefault((row["folder"], row["fault"], row["plan"]), {})
        block.setdefault(row["predictor"], {})[row["channel"]] = row
    heads = ("displace-\nment", "geom.\nmean", "%", "heading", "geom.\nmean", "%")
    for (folder, fault, plan), block in blocks.items():
        most = max(row["runs"] for channels in block.values() for row in channels.values())
        loss = "" if fault == "none" else f", loss {fault}"
        table = _predictor_table(
            f"{folder}, {most} run{'s' * (most > 1)}{loss}, plan {plan}: RMSE after 10 s "
            "over that of raw persistence",
            *heads,
        )
        for predictor, channels in block.items():
            texts: list[str] = []
            for channel in ("displacement", "psi"):
                row = channels[channel]
                texts += [short(row["ratio"], 3), short(row["geometric"], 3), _change(row)]
            table.add_row(predictor, *texts)
        console.print(table)
    against = next((row["against"] for row in rows if "against" in row), None)
    if against is not None:
        explain(
            f"%: change of the mean ratio against {against} on the same runs, with its 95 % "
            "bootstrap interval over runs"
        )


def _change(row: Row) -> str:
    """Return a change against the reference with its interval, in %."""
    if "change_percent" not in row:
        return "-"
    text = f"{row['change_percent']:+.0f}"
    if row["change_low"] is not None:
        text += f"\n{row['change_low']:+.0f}..{row['change_high']:+.0f}"
    return text
