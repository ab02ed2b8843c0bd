"""The command line ``usv-twin``: simulate, identify, predict, benchmark, validate, train, view."""

from __future__ import annotations

import contextlib
import csv
import errno
import functools
import gzip
import json
import math
import os
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import numpy as np
import typer
from rich.box import SIMPLE_HEAD
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from twin import benchmark as bench
from twin.agents import commands
from twin.agents.agent import ControllerError
from twin.agents.policy import AgentError
from twin.bag import is_bag
from twin.identifiability import Finding, Identifiability
from twin.live import commands as live
from twin.live.feed import FeedError
from twin.log import Log, LogError, beside
from twin.oracle import check_world
from twin.particulars import ParticularsError
from twin.predictor import CHANNELS, Estimate, Prediction
from twin.registry import DEFAULT, PREDICTORS, PredictorError
from twin.simulated import particulars_of, simulate
from twin.state import StateError, write_whole
from twin.structure import MODELS
from twin.terminal import INTERRUPTED, console, errors, listed, note, results_text, seeds_of
from twin.twin import PLANS, Twin, TwinError, known_plan
from usv_gym.design import DesignError, design
from usv_gym.geometry import boat_of
from usv_gym.inspection import Inspection, inspect
from usv_gym.manoeuvres import MANOEUVRES, ManoeuvreError
from usv_gym.physics import KNOT
from usv_gym.sea import SEA_STATES, SeaError, SeaState
from usv_gym.sensors import FAULTS_HELP, GRADES, FaultError, SensorSuite, parse_faults
from usv_gym.simulation import SimulationError
from usv_gym.tasks import TaskError
from usv_gym.vessel import KIND_SCHEMA, MESH_FORMATS, Vessel, VesselError, vessel_names
from usv_kernel import cached

if TYPE_CHECKING:
    from twin import speed
    from twin.validation_study import Section, Study

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="A digital twin of an unmanned surface vessel: simulate it, identify it from a log, "
    "predict where it will be, benchmark predictors under GPS loss, validate the ship and "
    "the sea, train and evaluate agents that steer, and view boat and twin in the browser.",
)
vessel_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Check, begin or draw a vessel."
)
app.add_typer(vessel_app, name="vessel")

EXPECTED = (
    AgentError,
    bench.BenchmarkError,
    ControllerError,
    DesignError,
    FaultError,
    FeedError,
    ImportError,
    LogError,
    ManoeuvreError,
    OSError,
    ParticularsError,
    PredictorError,
    SeaError,
    SimulationError,
    StateError,
    TaskError,
    TwinError,
    VesselError,
)

Command = TypeVar("Command", bound=Callable[..., None])


def _speaking(command: Command) -> Command:
    """Turn errors that a user can mend into one line and exit code 2."""

    @functools.wraps(command)
    def run(*args: Any, **kwargs: Any) -> None:
        try:
            command(*args, **kwargs)
        except EXPECTED as error:
            if isinstance(error, OSError) and error.filename is not None:
                error = OSError(
                    f"{error.filename}: {error.strerror}; choose another file or folder"
                )
            errors.print(f"error: {error}", style="red", highlight=False, soft_wrap=True)
            raise typer.Exit(2) from None

    return run  # type: ignore[return-value]


PredictorOption = Annotated[
    str, typer.Option("--predictor", "-p", help=f"One of: {', '.join(PREDICTORS)}.")
]
ModelOption = Annotated[
    str | None,
    typer.Option(
        "--model",
        help=f"Model structure, one of {', '.join(MODELS)}; left out: the predictor's own choice.",
    ),
]
ShipOption = Annotated[
    str | None,
    typer.Option(
        "--ship",
        "--vessel",
        help="Main particulars of the boat: a TOML file, or the name of a vessel. "
        "Left out: the .toml of the log's name beside the log, else usv75.",
    ),
]
MappingOption = Annotated[
    Path | None,
    typer.Option(
        help="TOML file that says which column or ROS topic is which column of the log. "
        "Left out: <log>.mapping.toml beside the log, if it is there."
    ),
]
DofOption = Annotated[
    int, typer.Option(help="Degrees of freedom of the ship: 3, or 6 with heave, roll, pitch.")
]
HsOption = Annotated[float | None, typer.Option(help="Significant wave height, m.")]
WindOption = Annotated[float | None, typer.Option(help="Mean wind speed at 10 m, m/s.")]
WindFromOption = Annotated[
    float | None, typer.Option(help="Where the wind comes from, degrees clockwise from north.")
]


@app.command("simulate")
@_speaking
def simulate_command(
    manoeuvre: Annotated[str, typer.Argument(help=f"One of: {', '.join(MANOEUVRES)}.")] = "turn",
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Log to write; <manoeuvre>_<seed>.csv.")
    ] = None,
    vessel: Annotated[
        str, typer.Option(help=f"Name ({', '.join(vessel_names())}) or TOML file.")
    ] = "usv75",
    duration: Annotated[
        float, typer.Option(min=1.0, max=86400.0, help="Length of the run, s.")
    ] = 120.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of sea and sensors.")] = 0,
    sea: Annotated[str, typer.Option(help=f"One of: {', '.join(SEA_STATES)}.")] = "2",
    hs: HsOption = None,
    wind: WindOption = None,
    wind_from: WindFromOption = None,
    faults: Annotated[str, typer.Option(help=f"Faults of sensors: {FAULTS_HELP}.")] = "none",
    fault_start: Annotated[
        float, typer.Option(help="When a fault given by its seconds begins, s.")
    ] = 85.0,
    sensors: Annotated[str, typer.Option(help=f"One of: {', '.join(GRADES)}.")] = "typical",
    dof: DofOption = 3,
) -> None:
    """Sail a manoeuvre in a sea state: a log (CSV), the boat's particulars, and a picture."""
    from twin.figures import picture_of_log

    boat = Vessel.load(vessel)
    degrees = None if wind_from is None else math.radians(wind_from)
    state = SeaState.named(sea).replace(hs=hs, wind=wind, wind_from=degrees)
    suite, broken = SensorSuite.grade(sensors), parse_faults(faults, fault_start)
    for fault in broken:
        if getattr(fault, "start", 0.0) >= duration:
            note(f"the fault of {fault.kind} begins after the end of the run: see --fault-start")
    path = out or Path(f"{manoeuvre}_{seed}.csv")
    log = simulate(
        manoeuvre,
        vessel=boat,
        sea=state,
        duration=duration,
        seed=seed,
        faults=broken,
        suite=suite,
        dof=dof,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    log.write(path)
    particulars, picture = beside(path, ".toml"), beside(path, ".png")
    particulars.write_text(particulars_of(boat, suite, dof).to_toml(), encoding="utf-8")
    windows = bench.gps_windows(broken)
    picture_of_log(log, picture, windows)
    console.print(f"{len(log)} rows, {duration:g} s: {path}, {particulars}, {picture}")


@app.command("identify")
@_speaking
def identify_command(
    log: Annotated[Path, typer.Argument(help="Log: CSV, CSV.gz, Parquet, ROS 2 bag, MCAP.")],
    predictor: Annotated[
        str | None,
        typer.Option(
            "--predictor",
            "-p",
            help=f"One of: {', '.join(PREDICTORS)}. Left out: {DEFAULT}, or the resumed one.",
        ),
    ] = None,
    model: ModelOption = None,
    ship: ShipOption = None,
    mapping: MappingOption = None,
    until: Annotated[float | None, typer.Option(help="Stop at this time of the log, s.")] = None,
    save: Annotated[
        Path | None, typer.Option(help="File for all that the twin knows at the end.")
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            help="File that --save wrote: go on from it, with the rows of the log after its time."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="CSV of state and parameters with sd at every row."),
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="The last estimate, in full precision.")
    ] = None,
) -> None:
    """Run the twin over a log and print what it makes of the boat.

    The log needs the columns t_s, n_left_rps, n_right_rps, delta_left_rad, delta_right_rad,
    gps_x_m, gps_y_m and compass_rad; gps_vx_mps, gps_vy_mps, gyro_radps, accel_x_mps2 and
    accel_y_mps2 help. Empty cells are missing data.

    With --save the twin can go on later, here with --resume or in Python with Twin.load, as if
    it had never stopped: the same bits. It knows its predictor, boat and instruments; those
    options are then left out.
    """
    run, twin = _begin(log, predictor, ship, until, resume, model, mapping)
    predictor = str(twin.name)
    unfed = Twin.load(resume) if resume is not None else twin
    unfed.reset()
    prior = unfed.estimate()
    header = ["t_s", *CHANNELS, *(f"sd_{c}" for c in CHANNELS)]
    names = twin.predictor.parameter_names
    header += [*names, *(f"sd_{n}" for n in names)]
    rows = []
    with _bar("identifying", len(run)) as advance:
        for t, z, cmd in run:
            twin.step(t, z, cmd)
            if out is not None:
                now = twin.estimate()
                rows.append([t, *now.s, *now.sd, *now.xi, *now.xi_sd])
            advance()
    last = twin.estimate()
    if save is not None:
        twin.save(save)
    if out is not None:
        _write_csv(out, header, rows)
    if json_file is not None:
        _write_json(json_file, _estimate_json(last, twin, predictor))
    if not last.ready:
        raise LogError(f"{log}: no fix and heading came together, so there is nothing to say")
    _print_state(last, predictor, run)
    if len(last.xi):
        _print_parameters(prior, last, twin)
    else:
        console.print(f"{predictor} has no model, and so identifies no parameters.")
    if out is not None:
        console.print(f"every row: {out}")
    if save is not None:
        console.print(f"the twin at t = {twin.t:.2f} s: {save}")


@app.command("predict")
@_speaking
def predict_command(
    log: Annotated[Path, typer.Argument(help="Log: CSV, CSV.gz, Parquet, ROS 2 bag, MCAP.")],
    predictor: PredictorOption = DEFAULT,
    model: ModelOption = None,
    ship: ShipOption = None,
    mapping: MappingOption = None,
    at: Annotated[
        float | None,
        typer.Option(
            help="Time of the log at which to predict, s; left out: its end, or where the "
            "horizon still fits when the plan is known."
        ),
    ] = None,
    horizon: Annotated[float, typer.Option(min=0.1, max=600.0, help="How far, s.")] = 10.0,
    plan: Annotated[
        str,
        typer.Option(
            help="Future commands. hold: the last one stays; known: those that the log goes on "
            "with; or a CSV file with t_s from now and the four command columns."
        ),
    ] = "hold",
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="CSV of the prediction, sd and 90 % band."),
    ] = None,
) -> None:
    """Run the twin over a log up to a time, and predict where the boat will be after it."""
    run, twin = _begin(log, predictor, ship, None, model=model, mapping=mapping)
    last = float(run.t[-1])
    if at is None:
        at = last - horizon if plan == "known" else last
    if not run.t[0] <= at <= last:
        raise TwinError(f"--at {at:g}: the log runs from {run.t[0]:g} to {last:g} s")
    if plan == "known" and at + horizon > last + 1e-6:
        raise TwinError(
            f"--plan known: the log ends {last - at:.1f} s after {at:g} s; "
            f"choose --at {last - horizon:g} or earlier, or --plan hold"
        )
    row = int(np.searchsorted(run.t, at + 1e-9) - 1)
    with _bar("identifying", row + 1) as advance:
        for index, (t, z, cmd) in enumerate(run):
            if index > row:
                break
            twin.step(t, z, cmd)
            advance()
    if not twin.estimate().ready:
        raise LogError(f"{log}: no fix and heading before t = {at:g} s; choose a later --at")
    dt = horizon / max(round(horizon / 0.1), 1)
    if plan == "hold":
        prediction = twin.predict("hold", horizon=horizon, dt=dt)
    elif plan == "known":
        prediction = twin.predict(known_plan(run, row, horizon, dt), dt=dt)
    else:
        prediction = twin.predict(_read_plan(Path(plan), horizon, dt), dt=dt)
    _print_prediction(prediction, predictor, plan, run)
    if out is not None:
        parts = (prediction.mean, prediction.sd, prediction.low, prediction.high)
        table = np.column_stack([prediction.t, *parts])
        header = [f"{kind}{c}" for kind in ("", "sd_", "low_", "high_") for c in CHANNELS]
        _write_csv(out, ["t_s", *header], table.tolist())
        console.print(f"every 0.1 s: {out}")


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
            help=f"Comma-separated, of the full protocol's: {', '.join(bench.FULL_CASES)}. [all]"
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
    ] = bench.SPREAD,
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
        str, typer.Option(help=f"Kind of workers, one of: {', '.join(bench.BACKENDS)}.")
    ] = "loky",
) -> None:
    """Compare predictors on the same runs, with and without a loss of GPS.

    A 10 s prediction every second after 80 s of identification, scored against the truth;
    every seed is another boat of the same kind in another sea. J and E measure each predictor
    against the oracle: the true boat in the mean wind. Without arguments: a 20 degree turn and
    a 20/-20 zigzag of 7.5 m boats in sea state 2, six seeds each, future commands known and
    held, and one recorded run of a real boat. With --full the full protocol. With --log recorded
    runs, scored against what was measured later, those of the archives twin.archive knows as
    they were downloaded; a file that cannot be read is named, and the others are scored.
    Writes results.json, report.html, the pictures, and every run as a log that identify and
    predict read. Ctrl-C keeps what is finished; the same command goes on from there.
    """
    if check is not None:
        _check(check)
        return
    bench.check_backend(backend)
    asked = listed(predictors, "--predictors")
    names, notes = bench.available(asked)
    if not names:
        raise PredictorError("; ".join(notes))
    recorded, missing = _present(log or [])
    usual: dict[str, Any] = {"logs": recorded}
    if full:
        usual |= {**bench.FULL, "cases": _cases(cases)} if not recorded else bench.FULL
    elif cases is not None:
        raise bench.BenchmarkError("--cases are those of the full protocol: add --full")
    else:
        usual["logs"] = recorded or bench.default_logs()
    if recorded:
        usual |= {"scenarios": (), "ship": ship}
    elif scenarios is not None:
        usual["scenarios"] = listed(scenarios, "--scenarios")
    if faults is not None:
        if full:
            raise bench.BenchmarkError("--faults: the full protocol has --cases in its place")
        usual["faults"] = listed(faults, "--faults")
    elif recorded:
        usual["faults"] = ("none",)
    if seeds is not None:
        usual["seeds"] = seeds_of(seeds)
    if plans is not None:
        usual["plans"] = listed(plans, "--plans")
    settings = bench.Settings(
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
    notes += bench.left_out(settings)
    notes += tuple(
        bench.NO_PARTICULARS.format(path)
        for path in recorded
        if ship is None and bench.without_particulars(path)
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
    total = len(bench.units(settings))
    if len(done) + sum(failed.counts.values()) < total:
        kept = sum(bench.result_file(out, unit).exists() for unit in bench.units(settings))
        errors.print(
            f"stopped: {kept} of {total} results are kept in {out}; "
            "the same command goes on from there",
            style="yellow",
        )
        raise typer.Exit(INTERRUPTED)
    if not done:
        raise bench.BenchmarkError("nothing could be scored; the lines above say why")
    from twin.report import write_report

    with console.status("drawing the report"):
        written = write_report(out, results, bench.figures(settings, done))
    console.print(f"{out / 'results.json'}, {written[0]}")


def _cases(text: str | None) -> tuple[bench.Case, ...]:
    """Return cases of the full protocol by name."""
    names = tuple(bench.FULL_CASES) if text is None else listed(text, "--cases")
    for name in names:
        if name not in bench.FULL_CASES:
            known = ", ".join(bench.FULL_CASES)
            raise bench.BenchmarkError(f"no case is called {name!r}; known: {known}")
    return tuple(bench.FULL_CASES[name] for name in names)


def _check(name: str) -> None:
    """Print whether a predictor keeps the contract; exit code 1 where it does not."""
    from twin.contract import check

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


@vessel_app.command("check")
@_speaking
def vessel_check_command(
    vessel: Annotated[
        str, typer.Argument(help=f"TOML file, or a name: {', '.join(vessel_names())}.")
    ],
    strict: Annotated[bool, typer.Option("--strict", help="Fail on warnings too.")] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Everything, in full precision.")
    ] = None,
) -> None:
    """Print what a vessel's numbers amount to, and every rule of thumb that they break.

    Exit code 0: sound; 1: errors (with --strict also warnings); 2: it cannot be read.
    """
    boat = Vessel.load(vessel)
    boat_of(boat)  # reads its mesh file
    found = inspect(boat)
    if json_file is not None:
        _write_json(json_file, found.to_json())
    _print_inspection(found)
    if found.errors or (strict and found.findings):
        raise typer.Exit(1)


@vessel_app.command("new")
@_speaking
def vessel_new_command(
    name: Annotated[str, typer.Option(help="Letters, digits, _ and -.")],
    length: Annotated[float, typer.Option(help="At the water line, m.")],
    beam: Annotated[float, typer.Option(help="At the water line, m.")],
    draft: Annotated[float, typer.Option(help="Of the hull, m.")],
    mass: Annotated[float, typer.Option(help="kg.")],
    kind: Annotated[
        str, typer.Option(help=f"Propulsion, one of: {', '.join(KIND_SCHEMA)}.")
    ] = "steerable_drive",
    units: Annotated[
        int | None, typer.Option(help="1 or 2; left out: 1 propeller with rudder, else 2.")
    ] = None,
    speed: Annotated[float | None, typer.Option(help="In service, kn.")] = None,
    power: Annotated[float | None, typer.Option(help="Of all shafts, kW.")] = None,
    length_overall: Annotated[
        float | None, typer.Option(help="m; left out: 5 % above the length.")
    ] = None,
    water_density: Annotated[
        float | None, typer.Option(help="kg/m3; left out: 1025, sea water.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="File; <name>.toml.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a file.")] = False,
) -> None:
    """Write a first vessel file: what is not given is estimated by regressions, and marked."""
    path = out or Path(f"{name}.toml")
    if path.exists() and not force:
        raise DesignError(f"{path}: is there already; choose another --out, or --force")
    first = design(
        name=name,
        length=length,
        beam=beam,
        draft=draft,
        mass=mass,
        kind=kind,
        units=units,
        speed=None if speed is None else speed * KNOT,
        power=None if power is None else power * 1e3,
        length_overall=length_overall,
        water_density=water_density,
    )
    for line in first.notes:
        note(line)
    _write_text(path, first.text)
    guesses, values = len(first.vessel.guesses), len(first.vessel.values) + 2
    console.print(
        f"{path}: {guesses} of {values} entries are estimates; look at it with "
        f"usv-twin vessel check {path}",
        soft_wrap=True,
    )


@vessel_app.command("mesh")
@_speaking
def vessel_mesh_command(
    vessel: Annotated[
        str, typer.Argument(help=f"TOML file, or a name: {', '.join(vessel_names())}.")
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help=f"{', '.join(MESH_FORMATS)}; <name>.glb."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a file.")] = False,
) -> None:
    """Write the boat's geometric model, in m, for a 3-D program or as a vessel's mesh.

    .glb keeps parts and colours, drives and propellers too, with y up, z forward and x to port as
    in every glTF file; the others hold the hull and what stands on it, with z up, x forward and y
    to port.
    """
    ship = Vessel.load(vessel)
    path = out or Path(f"{ship.name}.glb")
    if path.exists() and not force:
        raise VesselError(f"{path}: is there already; choose another --out, or --force")
    boat = boat_of(ship)
    content = boat.encoded(path.suffix.lower())
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, content)
    whole = boat.whole()
    long, wide, high = np.ptp(whole.bounds, axis=0)
    console.print(
        f"{path}: of a boat of {len(boat.parts)} parts, {len(whole.faces)} triangles, "
        f"with her drives {long:.4g} m long, {wide:.4g} m wide, {high:.4g} m high",
        soft_wrap=True,
    )


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
    from twin import speed

    if json_out is not None:
        # said before the minutes of measuring, not after them
        folder = json_out.parent
        if json_out.is_dir() or not folder.is_dir() or not os.access(folder, os.W_OK):
            raise bench.BenchmarkError(
                f"--json {json_out}: must be a file in a folder that is there and can be written to"
            )
    rounds = rounds or (5 if quick or growth else 9)
    if growth:
        rows, interrupted = _grown(speed.CURVES, only, rounds)
    else:
        rows, interrupted = _compared(only, quick, rounds)
    if json_out is not None:
        _write_json(json_out, rows)
        console.print(f"rows: {json_out}")
    if interrupted:
        raise typer.Exit(INTERRUPTED)


@app.command("validate")
@_speaking
def validate_command(
    check: Annotated[
        bool, typer.Option("--check", help="Write nothing; fail where the page is not today's.")
    ] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Every row, in full precision.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder of the page; by default the repository's root."),
    ] = None,
) -> None:
    """Compute what is published or measured, and write it beside that as VALIDATION.md.

    With --check the page is read instead: exit code 1 where a value is out of its tolerance,
    or is not the one on the page.
    """
    from twin import validation_page
    from twin.validation_study import Study, shared_folder

    home = Path(__file__).resolve().parents[1]
    # the page of an installed package is that of the folder where one is
    root = out or (home if (home / "pyproject.toml").is_file() else Path())
    page = root / validation_page.PAGE
    before = page.read_text(encoding="utf-8") if page.is_file() else ""
    if check and not before:
        raise FileNotFoundError(errno.ENOENT, "no page to check", str(page))
    study = Study(shared_folder(home))
    try:
        sections = _sections(study)
    except KeyboardInterrupt:
        errors.print("stopped: nothing is written", style="yellow")
        raise typer.Exit(INTERRUPTED) from None
    _print_validation(sections)
    if json_file is not None:
        _write_json(json_file, validation_page.to_json(sections))
    wrong = validation_page.failures(sections)
    if check:
        wrong += validation_page.compare(before, sections)
    else:
        from twin.validation_pictures import draw

        root.mkdir(parents=True, exist_ok=True)
        page.write_text(validation_page.render(sections, before), encoding="utf-8")
        with console.status("drawing the pictures"):
            drawn = draw(study, root / validation_page.FOLDER)
        console.print(f"{page}, {len(drawn)} pictures in {root / validation_page.FOLDER}")
    for text in wrong:
        errors.print(text, style="red", highlight=False, soft_wrap=True)
    if wrong:
        raise typer.Exit(1)


class _Failed(dict[str, str]):
    """Reasons why there is no result, by run or file; ``counts`` says of how many predictors."""

    def __init__(self) -> None:
        super().__init__()
        self.counts: dict[str, int] = {}

    def add(self, unit: bench.Unit, error: Exception) -> None:
        """Keep a reason; the same of several predictors on a run is told once."""
        where = unit.log or unit.run
        key = where if self.get(where, str(error)) == str(error) else f"{where} {unit.predictor}"
        self[key] = str(error)
        self.counts[key] = self.counts.get(key, 0) + 1


def _work(
    settings: bench.Settings, out: Path, jobs: int, backend: str
) -> tuple[dict[bench.Unit, dict[str, Any]], _Failed]:
    """Do all pieces of work under a progress bar; Ctrl-C ends it early."""
    done: dict[bench.Unit, dict[str, Any]] = {}
    failed = _Failed()
    total = len(bench.units(settings))
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


def _sections(study: Study) -> list[Section]:
    """Compute all sections of the validation page under a progress bar."""
    from twin.validation import SECTIONS

    sections = []
    with Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), console=console
    ) as progress:
        bar = progress.add_task("validating", total=len(SECTIONS))
        for name, section in SECTIONS.items():
            progress.update(bar, description=name)
            sections.append(section(study))
            progress.advance(bar)
    return sections


def _print_validation(sections: list[Section]) -> None:
    table = Table(title="validation", box=SIMPLE_HEAD)
    for name in ("section", "ok", "out", "reported", "skipped"):
        table.add_column(name, justify="left" if name == "section" else "right")
    reasons: list[str] = []
    for section in sections:
        skipped = [row.skipped for row in section.rows if row.skipped]
        judged = [row.ok for row in section.rows if not row.skipped]
        counts = judged.count(True), judged.count(False), judged.count(None), len(skipped)
        table.add_row(section.title, *map(str, counts))
        reasons += skipped
    console.print(table)
    for reason in dict.fromkeys(reasons):
        note(f"skipped: {reason}")


def _timed(cases: list[speed.Case], rounds: int) -> speed.Measured:
    """Measure under a progress bar."""
    from twin.speed import measure

    with Progress(
        *(TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()),
        console=errors,
        transient=True,
    ) as progress:
        bar = progress.add_task("", total=len(cases) * (rounds + 1))

        def advance(name: str) -> None:
            progress.update(bar, advance=1, description=f"{name:36}")

        return measure(cases, rounds, advance)


def _compared(only: str, quick: bool, rounds: int) -> tuple[list[dict[str, Any]], bool]:
    """Measure cases beside each other, print a table; return its rows, and whether Ctrl-C came."""
    from twin import speed

    cases = speed.chosen(only, quick=quick)
    memory = {n: m for n, m in speed.MEMORY.items() if only.lower() in n.lower()}
    first = {n: m for n, m in speed.FIRST_USES.items() if only.lower() in n.lower() and not quick}
    if not cases and not memory and not first:
        raise bench.BenchmarkError(f"--only {only!r}: no such case; leave it out to see them all")
    measured = _timed(cases, rounds)
    rows = measured.rows(cases)
    table = Table(title="speed", box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for name in ("case", "us", "per s", "ratio", "must", "reached"):
        table.add_column(name, justify="left" if name == "case" else "right", no_wrap=True)
    by_name = {case.name: case for case in cases}
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
                seconds = speed.first_use(options)
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
        size = speed.memory_per_boat(twin)
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
    curves: tuple[speed.Curve, ...], only: str, rounds: int
) -> tuple[list[dict[str, Any]], bool]:
    """Measure how cost grows, print a table of each curve, and return as _compared does."""
    from twin import speed

    curves = tuple(c for c in curves if only.lower() in f"{c.name}, {c.size}".lower())
    if not curves:
        raise bench.BenchmarkError(f"--only {only!r}: no such curve; leave it out to see them all")
    rows: list[dict[str, Any]] = []
    for curve in curves:
        measured = _timed(speed.growth_cases(curve), rounds)
        part, line = speed.growth_rows(curve, measured)
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


def _digits(value: float) -> str:
    """Return a positive number with three digits, or all before the point, or three after it."""
    return f"{value:.{min(max(2 - math.floor(math.log10(value)), 0), 3)}f}"


def _begin(
    path: Path,
    predictor: str | None,
    ship: str | None,
    until: float | None,
    resume: Path | None = None,
    model: str | None = None,
    mapping: Path | None = None,
) -> tuple[Log, Twin]:
    """Read a log, say what is missing in it, and make a twin for it, or load one."""
    log = Log.read(path, mapping)
    for line in log.notes:
        note(line)
    if resume is not None:
        found, twin = True, _resumed(resume, predictor, ship, model)
    else:
        particulars, found = bench.particulars_beside(path, ship)
        check_world(predictor or DEFAULT, log, particulars)
        options: dict[str, Any] = {} if model is None else {"model": model}
        twin = Twin(particulars, predictor or DEFAULT, **options)
    log = log.without_truth()
    if until is not None:
        if not math.isfinite(until):
            raise TwinError(f"--until {until}: must be a finite time in s")
        log = log.slice(-math.inf, math.nextafter(until, math.inf))
        if len(log) == 0:
            raise TwinError(f"--until {until:g}: the log has no row before it")
    if not found:
        note(bench.NO_PARTICULARS.format(path))
    console.print(f"boat: {twin.particulars.name}, {twin.particulars.length:g} m", highlight=False)
    if resume is not None:
        later = log.slice(math.nextafter(twin.t, math.inf), math.inf) if twin.t == twin.t else log
        if len(later) == 0:
            raise TwinError(
                f"{path}: has no row after t = {twin.t:g} s, where {resume} was saved; "
                "hand in the log that goes on from there"
            )
        log = later
    return log, twin


def _resumed(path: Path, predictor: str | None, ship: str | None, model: str | None) -> Twin:
    """Load a saved twin; what it knows itself cannot be asked for otherwise."""
    twin = Twin.load(path)
    if predictor is not None and predictor != twin.name:
        raise TwinError(f"--predictor {predictor}: {path} goes on with {twin.name}; leave it out")
    if model is not None:
        raise TwinError(f"--model {model}: {path} keeps its own; leave it out")
    if ship is not None:
        raise TwinError(f"--ship {ship}: {path} knows its boat; leave it out")
    return twin


def _busy(text: str) -> contextlib.AbstractContextManager[Any]:
    """Return a status line; none where the compiler is going to show its own."""
    return console.status(text) if cached() else contextlib.nullcontext()


class _bar:
    """A progress bar for rows of a log."""

    def __init__(self, text: str, total: int) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            console=console,
            transient=True,
        )
        self._task = self._progress.add_task(text, total=total)
        self._count = 0

    def __enter__(self) -> Callable[[], None]:
        if cached():  # the compiler shows a line of its own otherwise
            self._progress.start()
        return self._advance

    def _advance(self) -> None:
        self._count += 1
        if self._count % 100 == 0:
            self._progress.update(self._task, completed=self._count)

    def __exit__(self, *_: object) -> None:
        self._progress.stop()


def _read_plan(path: Path, horizon: float, dt: float) -> np.ndarray:
    """Return a plan of commands on the grid of a prediction, from a CSV file."""
    names = ("t_s", "n_left_rps", "n_right_rps", "delta_left_rad", "delta_right_rad")
    if not path.is_file():
        raise TwinError(f"--plan {path}: use hold, known, or a CSV file with {', '.join(names)}")
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        missing = [name for name in names if name not in (reader.fieldnames or ())]
        if missing:
            raise TwinError(f"{path}: the column(s) {', '.join(missing)} are missing")
        try:
            rows = np.array([[float(line[name]) for name in names] for line in reader])
        except (TypeError, ValueError) as error:
            raise TwinError(f"{path}: line {reader.line_num}: {error}") from None
    if len(rows) == 0 or not np.isfinite(rows).all() or (np.diff(rows[:, 0]) <= 0).any():
        raise TwinError(f"{path}: needs at least one row, finite numbers, and a rising t_s")
    middle = dt * (np.arange(round(horizon / dt)) + 0.5)
    return rows[np.maximum(np.searchsorted(rows[:, 0], middle, side="right") - 1, 0), 1:]


def _estimate_json(estimate: Estimate, twin: Twin, predictor: str) -> dict[str, Any]:
    names = twin.predictor.parameter_names
    seen = twin.predictor.identifiability()
    return {
        "predictor": predictor,
        "t_s": estimate.t,
        "ready": estimate.ready,
        "state": dict(zip(CHANNELS, estimate.s.tolist(), strict=True)),
        "state_sd": dict(zip(CHANNELS, estimate.sd.tolist(), strict=True)),
        "parameters": dict(zip(names, estimate.xi.tolist(), strict=True)),
        "parameters_sd": dict(zip(names, estimate.xi_sd.tolist(), strict=True)),
        "identifiability": None if seen is None else seen.to_json(),
    }


def _print_state(estimate: Estimate, predictor: str, log: Log) -> None:
    table = Table(
        title=f"{log.name}: state at t = {estimate.t:.2f} s by {predictor}", box=SIMPLE_HEAD
    )
    for name in ("", "north m", "east m", "heading deg", "surge m/s", "sway m/s", "yaw deg/s"):
        table.add_column(name, justify="right")
    scale = np.array([1.0, 1.0, 180.0 / math.pi, 1.0, 1.0, 180.0 / math.pi])
    s = estimate.s.copy()
    s[2] %= 2.0 * math.pi
    table.add_row("value", *(f"{v:.3f}" for v in s * scale))
    table.add_row("sd", *(f"{v:.3f}" for v in estimate.sd * scale))
    console.print(table)


def _print_parameters(prior: Estimate, last: Estimate, twin: Twin) -> None:
    unit = getattr(getattr(twin.predictor, "ukf", None), "settings", None)
    table = Table(
        title="parameters (mean and standard deviation)", box=SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
    for name in ("", "unit", "prior", "sd", "now", "sd", "ratio", "told"):
        left = name in ("", "unit", "told")
        table.add_column(name, justify="left" if left else "right", no_wrap=True)
    seen = twin.predictor.identifiability()
    found = {} if seen is None else {item.name: item for item in seen.parameters}
    for i, (name, symbol) in enumerate(
        zip(twin.predictor.parameter_names, twin.predictor.parameter_units, strict=True)
    ):
        ratio = last.xi_sd[i] / prior.xi_sd[i] if prior.xi_sd[i] > 0 else math.nan
        numbers = (prior.xi[i], prior.xi_sd[i], last.xi[i], last.xi_sd[i])
        told = ""
        if name in found:
            told = "sum" if found[name].merged_into else _told(found[name])
        table.add_row(name, symbol, *(f"{v:.3g}" for v in numbers), f"{ratio:.2f}", told)
    console.print(table)
    console.print(
        "ratio: sd over that of the prior; told by the data: it fell to 0.71 or below, and the "
        "parameter's own regressor was seen. Only the sums below are told of their members, "
        "whose regressors were alike (cosine above 0.999).",
        style="dim",
        soft_wrap=True,
    )
    if seen is not None:
        _print_identifiability(seen)
    if unit is not None and unit.n_unit != 1.0:
        console.print(
            f"Shaft speeds enter the thrust terms times {unit.n_unit:.4g} (see FilterSettings).",
            style="dim",
        )


def _told(finding: Finding) -> str:
    return "data" if finding.informed else "prior"


def _print_identifiability(seen: Identifiability) -> None:
    """Print the sums in place of collinear parameters, and what the data say of sub-models."""
    if seen.sums:
        table = Table(title="sums of collinear parameters", box=SIMPLE_HEAD)
        for name in ("", "prior sd", "sd", "ratio", "told by"):
            table.add_column(name, justify="left" if name in ("", "told by") else "right")
        for item in seen.sums:
            numbers = (f"{item.prior_sd:.3g}", f"{item.sd:.3g}", f"{item.ratio:.2f}")
            table.add_row(item.name, *numbers, _told(item))
        console.print(table)
    table = Table(title=f"identifiability on {seen.seconds:.0f} s of data", box=SIMPLE_HEAD)
    for name in ("sub-model", "parameters", "effective rank", "condition number"):
        table.add_column(name, justify="left" if name == "sub-model" else "right")
    for model in seen.submodels:
        rank, condition = f"{model.effective_rank:.1f}", f"{model.condition_number:.1e}"
        table.add_row(model.name, str(len(model.parameters)), rank, condition)
    console.print(table)
    console.print(
        "effective rank: directions told by the data and not the prior; condition number of "
        "the regressors in prior standard deviations (4.5e15: singular).",
        style="dim",
        soft_wrap=True,
    )


def _print_inspection(found: Inspection) -> None:
    """Print the derived particulars of a vessel, and the rules that it breaks."""
    facts = Table(title=f"{found.name}: {found.title}", box=SIMPLE_HEAD, show_header=False)
    for justify in ("left", "right"):
        facts.add_column(justify=justify, no_wrap=True)  # type: ignore[arg-type]
    units = {"mps": "m/s", "degps": "deg/s", "rps": "rev/s"}
    rows = {
        **found.particulars,
        **{f"period of {name} s": value for name, value in found.periods.items()},
        **{
            f"turn: {' '.join(units.get(word, word) for word in name.split('_'))}": value
            for name, value in found.turn.items()
        },
    }
    for name, value in rows.items():
        facts.add_row(name, f"{value:.4g}")
    if found.course:
        pairs = [f"{found.course[f'{i}_real']:.3g}" for i in ("first", "second")]
        stable = "stable" if found.course["first_real"] < 0.0 else "unstable"
        facts.add_row("straight course at service speed", f"{stable} ({', '.join(pairs)} 1/s)")
    console.print(facts)
    speeds = Table(title="straight ahead in calm water", box=SIMPLE_HEAD)
    for head in ("shaft rev/s", "speed m/s", "kn", "Froude", "thrust N"):
        speeds.add_column(head, justify="right")
    for row in found.speeds:
        speeds.add_row(*(f"{value:.4g}" for value in row.values()))
    console.print(speeds)
    for finding in found.findings:
        kind, style = ("error", "red") if finding.error else ("warning", "yellow")
        console.print(f"{kind}: {finding.text}", style=style, highlight=False, soft_wrap=True)
    warnings = len(found.findings) - len(found.errors)
    console.print(f"{len(found.errors)} error(s), {warnings} warning(s)")


def _print_prediction(prediction: Prediction, predictor: str, plan: str, log: Log) -> None:
    span = float(prediction.t[-1] - prediction.t0)
    horizons = [h for h in (1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0) if h < span] + [span]
    mean = prediction.at(np.array(horizons))[0]
    low, high = prediction.band(np.array(horizons))
    table = Table(
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        title=f"{log.name}: prediction at t = {prediction.t0:.2f} s by {predictor}, "
        f"plan {plan} (below each value how far its 90 % band reaches up and down)",
    )
    heads = ("after s", "north m", "east m", "heading deg", "surge m/s", "sway m/s", "yaw deg/s")
    for name in heads:
        table.add_column(name, justify="right")
    scale = np.array([1.0, 1.0, 180.0 / math.pi, 1.0, 1.0, 180.0 / math.pi])
    for h, m, up, down in zip(horizons, mean, high - mean, mean - low, strict=True):
        m = m.copy()
        m[2] %= 2.0 * math.pi
        cells = zip(m * scale, up * scale, down * scale, strict=True)
        table.add_row(f"{h:g}", *(f"{a:.2f}\n+{b:.2f} -{c:.2f}" for a, b, c in cells))
    console.print(table)


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
        if case in bench.FULL_CASES:
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


def _short(value: float, digits: int) -> str:
    """Return a number with so many decimals below 10, and fewer above."""
    for bound, fewer in ((10.0, 0), (100.0, 1)):
        if abs(value) < bound:
            return f"{value:.{digits - fewer}f}"
    return f"{value:.0f}"


def _write_csv(path: Path, header: list[str], rows: list[list[float]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows([[repr(float(v)) for v in row] for row in rows])


def _write_json(path: Path, content: dict[str, Any] | list[dict[str, Any]]) -> None:
    _write_text(path, json.dumps(content, indent=1) + "\n")


def _write_table(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write rows as a packed CSV; equal rows give equal bytes."""
    import polars as pl

    text = pl.DataFrame(rows).write_csv()
    path.write_bytes(gzip.compress(text.encode(), mtime=0))


def _write_text(path: Path, text: str) -> None:
    """Make a file's folder, and write the file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, text.encode())


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


def _expand(arguments: list[str], option: str = "--log") -> list[str]:
    """Let one option take several files: ``--log a b`` becomes ``--log a --log b``."""
    expanded: list[str] = []
    inside = False
    for argument in arguments:
        if argument.startswith("-"):
            inside = argument == option
            if not inside:
                expanded.append(argument)
        elif inside:
            expanded += [option, argument]
        else:
            expanded.append(argument)
    return expanded


for _name, _command in {**commands.COMMANDS, **live.COMMANDS}.items():
    app.command(_name)(_speaking(_command))


def main() -> None:
    """Run the command line."""
    app(args=_expand(sys.argv[1:]), prog_name="usv-twin")


if __name__ == "__main__":
    main()
