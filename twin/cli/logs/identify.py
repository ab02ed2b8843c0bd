"""``usv-twin identify``: run a twin over a log and print its model."""

from __future__ import annotations

import dataclasses
import hashlib
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from twin.benchmark.trust import RED, TrustMeter, Verdict, worst_of
from twin.channels import STATE
from twin.cli.common import (
    MOTION_HEADS,
    MOTION_SCALE,
    STATE_HEADS,
    STATE_SCALE,
    MappingOption,
    ModelOption,
    OptionError,
    ShipOption,
    check_out,
    console,
    explain,
    new_table,
    note,
    open_log,
    print_health,
    print_sea,
    row_progress,
    write_json,
    write_text,
)
from twin.cli.logs.judge import findings_of, print_verdict
from twin.digital_twin import Twin
from twin.identification.identifiability import Finding, Identifiability
from twin.logs.bag_writer import BAG_SUFFIX, write_bag
from twin.logs.errors import LogError
from twin.logs.log import Log
from twin.motion import CHANNELS
from twin.predictors.base import Estimate
from twin.predictors.own_prior import prior_of_runs
from twin.predictors.registry import DEFAULT, PREDICTORS
from twin.predictors.ukf import ModelPredictor


def identify_command(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...",
            help="Log: CSV, CSV.gz, Parquet, ROS 2 bag, MCAP, .BIN, .tlog. "
            "Several runs of one boat together.",
        ),
    ],
    predictor: Annotated[
        str | None,
        typer.Option(
            "--predictor",
            "-p",
            help=f"One of: {', '.join(PREDICTORS)}. Default: {DEFAULT}, or the resumed one.",
        ),
    ] = None,
    model: ModelOption = None,
    ship: ShipOption = None,
    mapping: MappingOption = None,
    until: Annotated[float | None, typer.Option(help="Stop at this time of the log, s.")] = None,
    save: Annotated[
        Path | None, typer.Option(help="File for the whole state of the twin at the end.")
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            help="File that --save wrote: continue from it, with the rows after its time."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="State and parameters with sd at every row: .csv, .parquet or .geojson; "
            "or the log with the states: .mcap.",
        ),
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="The last estimate, in full precision.")
    ] = None,
    save_prior: Annotated[
        Path | None,
        typer.Option(
            help="File for what the runs say of the boat's next run, such as boat.prior. "
            'Particulars use it with the line: prior = "boat.prior".'
        ),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Overwrite the file of --save-prior.")
    ] = False,
    with_faulty: Annotated[
        bool,
        typer.Option(
            "--with-faulty",
            help="Keep with --save-prior also runs in which sensors or commands are at fault, or "
            "whose forecasts are red.",
        ),
    ] = False,
) -> None:
    """Run the twin over a log, and print the state and the parameters that it estimates.

    The log needs the columns t_s, n_left_rps, n_right_rps, delta_left_rad, delta_right_rad,
    gps_x_m, gps_y_m and compass_rad; gps_vx_mps, gps_vy_mps, gyro_radps, accel_x_mps2 and
    accel_y_mps2 help. Empty cells are missing data.

    With --save the twin can continue later, here with --resume or in Python with Twin.load. The
    results are the same bits as without the stop. The file holds predictor, boat and instruments;
    those options are then left out.

    Several logs are runs of one boat: each is identified by itself, and the parameters are
    combined, with their covariance widened for load and fouling. --save-prior keeps that as the
    boat's own prior, also of one run. Each run begins without an earlier prior. Runs in which
    sensors or commands are at fault, or whose forecasts are red, are left out of it. A run that is
    given twice counts once.

    It ends with the colour and the lines of usv-twin judge. Of several runs, each line is of the
    worst run.
    """
    if save_prior is not None:
        if resume is not None:
            raise OptionError("--save-prior and --resume: a prior is made from whole runs")
        if save_prior.exists() and not force:
            raise OptionError(
                f"--save-prior {save_prior}: is there already; choose another name, or --force"
            )
    if len(logs) > 1:
        one = {"--save": save, "--resume": resume, "--out": out, "--json": json_file}
        given = [name for name, value in one.items() if value is not None]
        if given:
            raise OptionError(f"{len(logs)} logs, and {', '.join(given)}: that is for one run")
        seen: dict[str, Path] = {}
        found = [_run_of(one, seen, predictor, ship, until, model, mapping) for one in logs]
        runs = [run for run in found if run is not None]
        _combine(_to_keep(runs, with_faulty, save_prior), save_prior)
        print_verdict(worst_of([run[1] for run in runs]))
        explain("Each line is of the worst run in it. usv-twin judge LOG judges one run.")
        return
    log = logs[0]
    if save_prior is not None:
        run, twin = _opened(log, predictor, ship, until, model, mapping)
    else:
        run, twin = open_log(
            log, predictor, ship=ship, until=until, resume=resume, model=model, mapping=mapping
        )
    if out is not None:
        check_out(out, run, twin)
    predictor = str(twin.name)
    fresh = Twin.load(resume) if resume is not None else twin
    fresh.reset()
    prior = fresh.estimate()
    meter = TrustMeter(twin, run)
    meter.prior = prior
    with row_progress("identifying", len(run)) as advance:

        def on_row() -> None:
            meter()
            advance()

        table = twin.run(run, on_row)
    print_health(twin)
    last = twin.estimate()
    if save is not None:
        twin.save(save)
    if out is not None and out.suffix == BAG_SUFFIX:
        write_bag(out, run, table)
    elif out is not None:
        table.write(out, boat=twin.particulars.name, log=run.name, predictor=predictor)
    if json_file is not None:
        write_json(json_file, _estimate_json(last, twin, predictor))
    if not last.ready:
        raise LogError(f"{log}: no fix and heading came together, so there is nothing to say")
    _print_state(last, predictor, run)
    print_sea(twin.sea)
    if len(last.params):
        _print_parameters(prior, last, twin)
    else:
        console.print(f"{predictor} has no model, and so identifies no parameters.")
    if out is not None:
        console.print(f"every row: {out}")
    if save is not None:
        console.print(f"the twin at t = {twin.t:.2f} s: {save}")
    verdict = meter.verdict(findings_of(log, mapping, twin.particulars, until))
    if save_prior is not None:
        _combine(_to_keep([(twin, verdict)], with_faulty, save_prior), save_prior)
    print_verdict(verdict)
    explain("usv-twin judge LOG draws this; its --help has the rules.")


def _opened(
    log: Path,
    predictor: str | None,
    ship: str | None,
    until: float | None,
    model: str | None,
    mapping: Path | None,
) -> tuple[Log, Twin]:
    """Return a log and a twin that begins without a prior of the boat's own."""
    run, twin = open_log(log, predictor, ship=ship, until=until, model=model, mapping=mapping)
    if twin.particulars.prior is not None:
        note("begins without the prior of the particulars: the new one is to hold each run once")
        bare = dataclasses.replace(twin.particulars, prior=None)
        datum = twin.datum
        twin = Twin(bare, str(twin.name), **twin.options)
        twin.locate(datum)
    return run, twin


def _run_of(
    log: Path,
    seen: dict[str, Path],
    predictor: str | None,
    ship: str | None,
    until: float | None,
    model: str | None,
    mapping: Path | None,
) -> tuple[Twin, Verdict] | None:
    """Return a twin that ran over a log, and how far it may be trusted; None of a log seen before.

    ``seen`` holds the logs so far, by what is in them.
    """
    run, twin = _opened(log, predictor, ship, until, model, mapping)
    content = hashlib.sha256(b"".join(part.tobytes() for part in (run.t, run.z, run.cmd)))
    first = seen.setdefault(content.hexdigest(), log)
    if first is not log:
        note(f"{log}: has the same rows as {first}, and counts once")
        return None
    meter = TrustMeter(twin, run)
    with row_progress(f"identifying {run.name}", len(run)) as advance:

        def on_row() -> None:
            meter()
            advance()

        twin.run(run, on_row)
    print_health(twin)
    if not twin.estimate().ready:
        raise LogError(f"{log}: no fix and heading came together, so there is nothing to say")
    verdict = meter.verdict(findings_of(log, mapping, twin.particulars, until))
    about = f"{run.name}: {run.t[-1] - run.t[0]:.0f} s, {verdict.colour}"
    if verdict.in_use is not None:
        about += f"; in use: {verdict.in_use.name}"
    console.print(about, highlight=False, soft_wrap=True)
    return twin, verdict


def _to_keep(
    runs: Sequence[tuple[Twin, Verdict]], with_faulty: bool, path: Path | None
) -> list[Twin]:
    """Return the twins whose runs a prior may be made of; LogError if there is none."""
    kept = []
    for twin, verdict in runs:
        why = _why_not(verdict)
        if why and path is not None and not with_faulty:
            note(f"{verdict.log}: left out of the prior, {why}, or keep it with --with-faulty")
        else:
            kept.append(twin)
    if not kept:
        for run in runs:
            print_verdict(run[1])
        raise LogError(
            f"{path}: not written, as every run has a fault of sensors or commands, or red "
            "forecasts; mend the logs, give other runs, or keep them with --with-faulty"
        )
    return kept


def _why_not(verdict: Verdict) -> str:
    """Return why no prior is made of a run, and the remedy; empty if it may be."""
    if verdict.fault:
        return f"for {verdict.fault}; mend the log"
    for answer in verdict.answers:
        if answer.about == "forecast" and answer.colour == RED:
            return (
                f"for its forecasts are red ({answer.text}); check that it is of this boat and "
                "that the particulars are right"
            )
    return ""


def _combine(twins: Sequence[Twin], path: Path | None) -> None:
    """Print what runs say together of the boat, beside the population; and write it as a prior."""
    if path is None and not isinstance(twins[0].predictor, ModelPredictor):
        console.print(f"{twins[0].name} has no model, and so identifies no parameters.")
        return
    prior = prior_of_runs([twin.predictor for twin in twins])
    if path is not None:
        write_text(path, prior.file_text())
    first = twins[0].predictor
    first.reset()
    before = first.estimate()
    places = {name: k for k, name in enumerate(first.parameter_names)}
    heads = ("", "unit", "population", "sd", "this boat", "sd", "ratio")
    title = f"{prior.boat}, from {prior.runs} run(s), model {prior.model}"
    table = new_table(title, *heads, left=("", "unit"))
    for k, name in enumerate(prior.parameters):
        at, sd = places[name], math.sqrt(prior.covariance[k][k])
        old = before.params_sd[at]
        numbers = (before.params[at], old, prior.mean[k], sd)
        row = (f"{value:.3g}" for value in numbers)
        table.add_row(name, first.parameter_units[at], *row, f"{sd / old:.2f}")
    console.print(table)
    if path is None:
        explain("--save-prior boat.prior keeps this for the next run of the boat.")
        return
    console.print(f'prior: {path}; use it with prior = "{path.name}" in the particulars')


def _estimate_json(estimate: Estimate, twin: Twin, predictor: str) -> dict[str, Any]:
    names = twin.predictor.parameter_names
    seen, in_use = twin.predictor.identifiability(), twin.predictor.parameters_in_use()
    return {
        "predictor": predictor,
        "t_s": estimate.t,
        "ready": estimate.ready,
        "datum": None if twin.datum is None else twin.datum.to_json(),
        "state": dict(zip(STATE, estimate.state.tolist(), strict=True)),
        "state_sd": dict(zip(STATE, estimate.sd.tolist(), strict=True)),
        "parameters_in_use": None if in_use is None else in_use.name,
        "parameters": dict(zip(names, estimate.params.tolist(), strict=True)),
        "parameters_sd": dict(zip(names, estimate.params_sd.tolist(), strict=True)),
        **_motion_json(estimate, twin),
        "health": {name: status._asdict() for name, status in twin.health.items()},
        "health_notes": list(twin.notes),
        "identifiability": None if seen is None else seen.to_json(),
    }


def _motion_json(estimate: Estimate, twin: Twin) -> dict[str, Any]:
    """Return roll, pitch, heave and the sea, where the log shows them."""
    if estimate.motion is None:
        return {}
    motion, sea = estimate.motion, twin.sea
    waves = None
    if sea is not None and sea.known:
        waves = dict(zip(("hs_m", "period_s", "to_rad", "to_sd_rad"), sea, strict=True))
    return {
        "motion": dict(zip(CHANNELS, motion.mean.tolist(), strict=True)),
        "motion_sd": dict(zip(CHANNELS, motion.sd.tolist(), strict=True)),
        "sea": waves,
    }


def _print_state(estimate: Estimate, predictor: str, log: Log) -> None:
    title = f"{log.name}: state at t = {estimate.t:.2f} s by {predictor}"
    table = new_table(title, "", *STATE_HEADS, padding=(0, 1))
    state = estimate.state.copy()
    state[2] %= 2.0 * math.pi
    table.add_row("value", *(f"{v:.3f}" for v in state * STATE_SCALE))
    table.add_row("sd", *(f"{v:.3f}" for v in estimate.sd * STATE_SCALE))
    console.print(table)
    motion = estimate.motion
    if motion is not None:
        table = new_table("roll, pitch, heave, vertical speed of the deck", "", *MOTION_HEADS)
        table.add_row("value", *(f"{v:.3f}" for v in motion.mean * MOTION_SCALE))
        table.add_row("sd", *(f"{v:.3f}" for v in motion.sd * MOTION_SCALE))
        console.print(table)


def _print_parameters(prior: Estimate, last: Estimate, twin: Twin) -> None:
    heads = ("", "unit", "prior", "sd", "now", "sd", "ratio", "source")
    in_use = twin.predictor.parameters_in_use()
    title = "parameters (mean and standard deviation)"
    if in_use is not None:
        title += f"; in use: {in_use.name}"
    table = new_table(title, *heads, left=SOURCE_COLUMNS)
    seen = twin.predictor.identifiability()
    found = {} if seen is None else {item.name: item for item in seen.parameters}
    units = twin.predictor.parameter_units
    ratios = []
    for i, name in enumerate(twin.predictor.parameter_names):
        ratio = last.params_sd[i] / prior.params_sd[i] if prior.params_sd[i] > 0 else math.nan
        numbers = (prior.params[i], prior.params_sd[i], last.params[i], last.params_sd[i])
        ratios.append(ratio)
        source = _source(found[name]) if name in found else ""
        table.add_row(name, units[i], *(f"{v:.3g}" for v in numbers), f"{ratio:.2f}", source)
    console.print(table)
    _print_legend(twin)
    explain(
        "ratio: sd over that of the prior. source data: it fell to 0.71 or below, and the "
        "parameter's own regressor was excited. source sum: its regressor was collinear with "
        "another (cosine above 0.999), so that the data determine only their sum, given below."
    )
    if in_use is not None and in_use.is_prior:
        explain("The prior is in use: the values are not from the data, only the sd of a refit.")
    if any(ratio > RATIO_SHOWN_ABOVE_ONE for ratio in ratios):
        explain(
            "ratio above 1: the parameter is less certain than at the start. The filter lets it "
            "drift, or a change of the boat was found, and the data do not confine it since."
        )
    if seen is not None:
        _print_identifiability(seen)
    settings = getattr(getattr(twin.predictor, "ukf", None), "settings", None)
    if settings is not None and settings.n_unit != 1.0:
        explain(
            f"Shaft speeds enter the thrust terms times {settings.n_unit:.4g} (see FilterSettings)."
        )


LEGEND = {
    r"[XYN]_": ("X, Y, N", "terms of the acceleration forward, to starboard, in yaw"),
    r"[XYN]_[uvr|]+$": ("u, v, r", "surge speed, sway speed, yaw rate, and products of them"),
    r"E_": ("E", "slow acceleration to north and to east, of wind and current"),
    r"[XYN]_nn$": ("nn", "thrust at rest: mean n|n| of the shafts, n the shaft speed"),
    r"[XYN]_nu$": ("nu", "change of thrust with speed: mean |n| u of the shafts"),
    r"T_": ("T_uL, T_uR ...", "thrust n|n| of the left, right shaft in surge, sway, yaw"),
    r"[XN]_dn$": ("dn", "left less right thrust; of a tanker, thrust astern"),
    r"N_mn$": ("mn", "turning by the mean thrust: the thrusters are unequal"),
    r"[XYN]_F$": ("F", "drag and lift of rudders or drives in the flow at the stern"),
    r"[XYN]_S$": ("S", "force of flow from the side on rudders or drives"),
    r"[XYN]_w$": ("w", "apparent wind, its speed squared"),
    r"N_0$": ("0", "constant yaw acceleration"),
    r"N_(cos|sin)$": ("cos, sin", "yaw acceleration that turns with the heading"),
    r"N_(cos|sin)2$": ("cos2, sin2", "the same, with twice the heading"),
}
"""What names of parameters mean: pattern, what is printed for it, and its meaning."""


def _print_legend(twin: Twin) -> None:
    """Print what the names of a model's parameters mean, as far as they occur."""
    if getattr(twin.predictor, "ukf", None) is None:
        return  # of another package, with names of its own
    table = new_table("what the names mean", "", "", left=("",), show_header=False)
    table.columns[-1].no_wrap = False
    for pattern, (name, meaning) in LEGEND.items():
        if any(re.match(pattern, one) for one in twin.predictor.parameter_names):
            table.add_row(name, meaning)
    console.print(table)
    explain(
        "N_v|v| times v|v| is a yaw acceleration. See docs/explanation/twin.md, Model structure."
    )


RATIO_SHOWN_ABOVE_ONE = 1.005
"""Ratios of standard deviations from which on the table shows more than 1.00."""

SOURCE_COLUMNS = ("", "unit", "source")


def _source(finding: Finding) -> str:
    """Return what determines a parameter."""
    if finding.merged_into:
        return "sum"
    return "data" if finding.informed else "prior"


def _print_identifiability(seen: Identifiability) -> None:
    """Print the sums of collinear parameters, and the rank of the sub-models."""
    if seen.sums:
        heads = ("", "prior sd", "sd", "ratio", "source")
        table = new_table("sums of collinear parameters", *heads, left=SOURCE_COLUMNS)
        for item in seen.sums:
            numbers = (f"{item.prior_sd:.3g}", f"{item.sd:.3g}", f"{item.ratio:.2f}")
            table.add_row(item.name, *numbers, _source(item))
        console.print(table)
    table = new_table(
        f"identifiability on {seen.seconds:.0f} s of data",
        "sub-model",
        "parameters",
        "effective rank",
        "condition number",
        left=("sub-model",),
    )
    for model in seen.submodels:
        rank = f"{model.effective_rank:.1f}"
        table.add_row(model.name, str(len(model.parameters)), rank, model.condition)
    console.print(table)
    explain(
        "effective rank: directions determined by the data and not by the prior. condition "
        "number: of the regressors in prior standard deviations."
    )
    for model in seen.submodels:
        if model.not_shown:
            shown = "; ".join(model.not_shown)
            explain(f"{model.name}: the run did not show {shown}; there the prior stays.")
