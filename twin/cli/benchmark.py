"""``usv-twin benchmark``: predictions of all predictors, scored and reported."""

from __future__ import annotations

import contextlib
import shlex
import sys
from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import TimeRemainingColumn

from twin.benchmark import runner
from twin.benchmark.export import csv_text, latex_text
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
    sea_settings,
    units,
)
from twin.cli.common import (
    CPUS,
    OPTIONS_EXAMPLE,
    DofOption,
    HsOption,
    JobsOption,
    MappingOption,
    WindFromOption,
    WindOption,
    console,
    errors,
    keep_format,
    parse_list,
    parse_predictors,
    parse_seeds,
    progress_bar,
    status,
    stopped,
    write_text,
)
from twin.cli.tables import print_scores
from twin.digital_twin import PLANS
from twin.files import compressed_csv, results_text
from twin.logs.errors import LogError
from twin.logs.log import recorded_runs
from twin.logs.rosbag import is_bag
from twin.parallel import BACKENDS, check_backend
from twin.predictors.registry import PREDICTORS, PredictorError
from usv_gym.manoeuvring.manoeuvres import SCENARIOS
from usv_gym.vessel.vessel import Vessel, vessel_names
from usv_gym.world.faults import FAULTS_HELP
from usv_kernel.files import write_whole


def benchmark_command(
    logs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="LOG", help="Recorded runs to score. [simulated runs, and one of a boat]"
        ),
    ] = None,
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
            help="Only check that forecasts of a predictor (a name, or module:Class) are finite, "
            "and equal those from logs cut at their origins. Exit code 1: it fails."
        ),
    ] = None,
    scenarios: Annotated[
        str | None, typer.Option(help=f"Comma-separated, of: {', '.join(SCENARIOS)}. [turn,zigzag]")
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
        str | None,
        typer.Option(
            help=f"Comma-separated, of: {', '.join(PREDICTORS)}; or module:Class of your own. "
            f"With options as {OPTIONS_EXAMPLE}. [all that can run]"
        ),
    ] = None,
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
    hs: HsOption = "0.5",
    wind: WindOption = "4.5",
    wind_from: WindFromOption = "135",
    spreading: Annotated[
        float | None,
        typer.Option(help="Exponent s of short-crested waves. [long-crested]", min=0.0),
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
    latex: Annotated[
        Path | None,
        typer.Option(help="Write the tables as LaTeX: means with intervals, the best in bold."),
    ] = None,
    csv: Annotated[
        Path | None, typer.Option(help="Write every mean with its interval as CSV.")
    ] = None,
    pdf: Annotated[
        bool, typer.Option("--pdf", help="Write each picture as PDF, too, beside the SVG.")
    ] = False,
    no_pictures: Annotated[
        bool, typer.Option("--no-pictures", help="Draw none: the report has tables only.")
    ] = False,
    fresh: Annotated[
        bool,
        typer.Option(
            "--fresh", help="Compute every result again, also those that nothing has changed."
        ),
    ] = False,
    jobs: JobsOption = CPUS,
    backend: Annotated[
        str, typer.Option(help=f"Kind of workers, one of: {', '.join(BACKENDS)}.")
    ] = "loky",
) -> None:
    """Compare predictors on the same runs, with and without a loss of GPS.

    Each predictor makes a 10 s prediction every second after 80 s of identification; the truth
    scores it. Every seed is another boat of the same kind in another sea. J and E compare each
    predictor with the oracle, which knows the true boat and the mean wind.

    Without arguments: a 20 degree turn and a 20/-20 zigzag of 7.5 m boats in sea state 2. There
    are six seeds each, future commands known and held, and one recorded run of a real boat. With
    --full: the full protocol. With logs: recorded runs, scored against later measurements.
    Archives that twin.logs.datasets knows are read as downloaded. A file that cannot be read is
    reported, and the others are scored.

    Prints a verdict: errors after 10 s in metres and degrees, with and without the loss, and over
    those of persistence, best first. The report has all tables.

    Writes results.json, report.html, the pictures, and every run as a log for identify and
    predict. Ctrl-C keeps what is finished; the same command continues from there.

    Exit code 1: a log, or a predictor that was named, was not scored on all of its runs.
    """
    if check is not None:
        _check(check)
        return
    keep_format(latex, "--latex")
    keep_format(csv, "--csv")
    check_backend(backend)
    asked = () if predictors is None else parse_predictors(predictors)
    names, notes = available(asked or tuple(PREDICTORS))
    if not names:
        raise PredictorError("; ".join(notes))
    recorded, missing = _find_logs(logs or [])
    options: dict[str, Any] = {"logs": recorded}
    if full:
        options |= {**FULL, "cases": _parse_cases(cases)} if not recorded else FULL
    elif cases is not None:
        raise BenchmarkError("--cases are those of the full protocol: add --full")
    else:
        options["logs"] = recorded or tuple(map(str, recorded_runs().values()))
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
        **sea_settings(hs, wind, wind_from),
        spreading=spreading,
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
    for line in notes:  # the verdict comes first on the standard output
        errors.print(f"note: {line}", style="yellow", highlight=False, soft_wrap=True)
    out.mkdir(parents=True, exist_ok=True)
    done, failed = _run_all(settings, out, jobs, backend, fresh)
    said = [
        why if any(name and name in why for name in (unit.log, unit.run)) else f"{unit.run}: {why}"
        for unit, why in failed.items()
    ]
    not_scored = tuple(dict.fromkeys(f"not scored: {text}" for text in [*missing.values(), *said]))
    command = shlex.join(["usv-twin", *sys.argv[1:]])
    results = runner.collect(settings, done, command, notes + not_scored, against)
    for path, text_of in ((latex, latex_text), (csv, csv_text)):
        if path is not None:
            write_text(path, text_of(results))
    if full:  # hundreds of thousands of rows: a table of their own
        write_whole(out / "rows.csv.gz", compressed_csv(results.pop("rows")))
        del results["runs"], results["motion"]
    write_text(out / "results.json", results_text(results))
    print_scores({**results, "notes": []})  # they were printed before the runs
    for line in not_scored:
        errors.print(line, style="red", highlight=False, soft_wrap=True)
    work = units(settings)
    if len(done) + len(failed) < len(work):
        kept = sum(runner.result_file(settings, unit, out).exists() for unit in work)
        raise stopped(
            f"{kept} of {len(work)} results are kept in {out}; the same command goes on from there"
        )
    if not done:
        raise BenchmarkError("nothing could be scored; the lines above say why")
    from twin.benchmark.report import write_report

    figures = None if no_pictures else runner.run_figures(settings, done)
    with status("writing the report"):
        written = write_report(out, results, figures, pdf=pdf)
    console.print(f"report: {written[0]}; numbers: {out / 'results.json'}", soft_wrap=True)
    lacking = [*missing, *_unscored(work, done, asked)]
    if lacking:
        text = f"not scored: {', '.join(lacking)}; the lines above say why"
        errors.print(f"error: {text}", style="red", highlight=False, soft_wrap=True)
        raise typer.Exit(1)


def _unscored(work: Sequence[Unit], done: Collection[Unit], asked: Sequence[str]) -> list[str]:
    """Return each predictor that lacks results, with how many; of those asked for, also all."""
    every, scored = (Counter(unit.predictor for unit in some) for some in (work, done))
    counts = {name: every[name] - scored[name] for name in every}
    lacking = [f"{name} on {n} of {every[name]} runs" for name, n in counts.items() if n]
    return lacking + [f"{name} on any run" for name in asked if name not in every]


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
        except LogError as error:
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
    """Print whether forecasts equal those from logs cut at their origins; exit code 1 if not."""
    from twin.benchmark.conformance import ContractError, check_predictor

    try:
        with status("checking"):
            count = check_predictor(name)
    except ContractError as error:
        errors.print(f"error: {error}", style="red", highlight=False, soft_wrap=True)
        raise typer.Exit(1) from None
    said = f"{name}: {count} forecasts are finite, and equal those from logs cut at their origins"
    console.print(said, highlight=False, soft_wrap=True)


def _run_all(
    settings: Settings, out: Path, jobs: int, backend: str, fresh: bool
) -> tuple[dict[Unit, dict[str, Any]], dict[Unit, str]]:
    """Do all work under a progress bar, and return results and errors; Ctrl-C ends it early."""
    done: dict[Unit, dict[str, Any]] = {}
    failed: dict[Unit, str] = {}
    with contextlib.suppress(KeyboardInterrupt):
        work = units(settings)
        reused = {} if fresh else runner.reusable(settings, out)
        # not on the standard output, which begins with the results
        errors.print(f"{len(reused)} of {len(work)} results reused", highlight=False)
        if len(reused) < len(work):
            runner.warm_up(settings, jobs=jobs, backend=backend)
        # one estimate over many runs, as each comes with all its predictors at a time
        columns = TimeRemainingColumn()
        with progress_bar(
            columns, transient=True, console=errors, speed_estimate_period=600.0
        ) as progress:
            bar = progress.add_task("benchmark", total=len(work))
            for unit, result in runner.runs(settings, out, jobs=jobs, backend=backend, done=reused):
                if isinstance(result, Exception):
                    failed[unit] = str(result)
                else:
                    done[unit] = result
                progress.advance(bar)
    return done, failed
