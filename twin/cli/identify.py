"""``usv-twin identify``: run a twin over a log and print its model."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from twin.channels import CHANNELS
from twin.cli.common import (
    MappingOption,
    ModelOption,
    ShipOption,
    _bar,
    _begin,
    _speaking,
    _write_csv,
    _write_json,
    app,
    console,
)
from twin.digital_twin import Twin
from twin.identification.identifiability import Finding, Identifiability
from twin.logs.columns import LogError
from twin.logs.log import Log
from twin.predictors.base import Estimate
from twin.predictors.registry import DEFAULT, PREDICTORS


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
                rows.append([t, *now.state, *now.sd, *now.params, *now.params_sd])
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
    if len(last.params):
        _print_parameters(prior, last, twin)
    else:
        console.print(f"{predictor} has no model, and so identifies no parameters.")
    if out is not None:
        console.print(f"every row: {out}")
    if save is not None:
        console.print(f"the twin at t = {twin.t:.2f} s: {save}")


def _estimate_json(estimate: Estimate, twin: Twin, predictor: str) -> dict[str, Any]:
    names = twin.predictor.parameter_names
    seen = twin.predictor.identifiability()
    return {
        "predictor": predictor,
        "t_s": estimate.t,
        "ready": estimate.ready,
        "state": dict(zip(CHANNELS, estimate.state.tolist(), strict=True)),
        "state_sd": dict(zip(CHANNELS, estimate.sd.tolist(), strict=True)),
        "parameters": dict(zip(names, estimate.params.tolist(), strict=True)),
        "parameters_sd": dict(zip(names, estimate.params_sd.tolist(), strict=True)),
        "identifiability": None if seen is None else seen.to_json(),
    }


def _print_state(estimate: Estimate, predictor: str, log: Log) -> None:
    table = Table(
        title=f"{log.name}: state at t = {estimate.t:.2f} s by {predictor}", box=SIMPLE_HEAD
    )
    for name in ("", "north m", "east m", "heading deg", "surge m/s", "sway m/s", "yaw deg/s"):
        table.add_column(name, justify="right")
    scale = np.array([1.0, 1.0, 180.0 / math.pi, 1.0, 1.0, 180.0 / math.pi])
    s = estimate.state.copy()
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
        ratio = last.params_sd[i] / prior.params_sd[i] if prior.params_sd[i] > 0 else math.nan
        numbers = (prior.params[i], prior.params_sd[i], last.params[i], last.params_sd[i])
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
