"""``usv-twin identify``: run a twin over a log and print its model."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from twin.benchmark.trust import judge
from twin.channels import STATE
from twin.cli.common import (
    LogsArgument,
    MappingOption,
    PredictorOption,
    ShipOption,
    console,
    explain,
    keep_file,
    keep_logs,
    print_notes,
    row_progress,
    write_json,
    write_text,
)
from twin.cli.tables import print_estimate, print_health, print_prior
from twin.digital_twin import Twin
from twin.logs.errors import LogError
from twin.logs.log import Log
from twin.logs.tables import check_export
from twin.motion import CHANNELS
from twin.predictors.base import Estimate
from twin.predictors.own_prior import prior_of_runs
from twin.predictors.registry import DEFAULT
from twin.predictors.ukf import ModelPredictor
from twin.sim.recorded import twin_for_log


def identify_command(
    logs: LogsArgument,
    predictor: PredictorOption = DEFAULT,
    ship: ShipOption = None,
    mapping: MappingOption = None,
    until: Annotated[float | None, typer.Option(help="Stop at this time of the log, s.")] = None,
    save: Annotated[
        Path | None, typer.Option(help="File for the whole state of the twin at the end.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="State and parameters with sd at every row: .csv, .parquet or .geojson.",
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
) -> None:
    """Run the twin over a log, and print the state and the parameters that it estimates.

    The log needs the columns t_s, n_left_rps, n_right_rps, delta_left_rad, delta_right_rad,
    gps_x_m, gps_y_m and compass_rad; gps_vx_mps, gps_vy_mps, gyro_radps, accel_x_mps2 and
    accel_y_mps2 help. Empty cells are missing data.

    With --save the twin can continue later, in Python with Twin.load. The results are the same bits
    as without the stop. The file holds predictor, boat and instruments.

    Several logs are runs of one boat: each is identified by itself, and the parameters are
    combined, with their covariance widened for load and fouling. What that is worth is said as
    well: each run is forecast with the prior of the others, beside none. --save-prior keeps it as
    the boat's own prior, also of one run. Each run begins without an earlier prior.

    Whether a twin may be trusted says usv-twin check: give no run that it calls bad.
    """
    keep_file(save_prior, force, "--save-prior")
    logs = list(dict.fromkeys(logs))
    keep_logs(logs, {"--save": save, "--out": out, "--json": json_file})
    together = save_prior is not None or len(logs) > 1
    runs, said = [], set[str]()
    for path in logs:
        log, twin = twin_for_log(
            path, predictor, ship=ship, mapping=mapping, until=until, own_prior=not together
        )
        print_notes(log.notes, said)
        console.print(f"boat: {twin.particulars.name}, {twin.particulars.length:g} m")
        if out is not None:
            check_export(out, twin.datum)
        prior = twin.estimate()
        with row_progress(f"identifying {log.name}", len(log)) as advance:
            if out is not None:
                table = twin.run(log, advance)
            else:  # the last estimate is enough
                for row in log:
                    twin.step(*row)
                    advance()
        print_health(twin.notes)
        last = twin.estimate()
        if not last.ready:
            raise LogError(f"{path}: no fix and heading came together, so there is nothing to say")
        if len(logs) == 1:
            print_estimate(prior, last, twin, log.name)
        if save is not None:
            twin.save(save)
            console.print(f"the twin at t = {twin.t:.2f} s: {save}")
        if out is not None:
            table.write(out, boat=twin.particulars.name, log=log.name, predictor=twin.name)
            console.print(f"every row: {out}")
        if json_file is not None:
            write_json(json_file, _estimate_json(last, twin))
        runs.append((log, twin))
    if together:
        _combine(runs, predictor, save_prior)


def _combine(runs: Sequence[tuple[Log, Twin]], predictor: str, path: Path | None) -> None:
    """Print what runs say together of the boat, and write it as a prior."""
    first = runs[0][1]
    if path is None and not isinstance(first.predictor, ModelPredictor):
        console.print(f"{first.name} has no model, and so identifies no parameters.")
        return
    prior = prior_of_runs([twin.predictor for _, twin in runs])
    if len(runs) > 1:
        _print_worth(runs, predictor)
    first.reset()
    print_prior(prior, first)
    if path is None:
        explain("--save-prior boat.prior keeps this for the next run of the boat.")
        return
    write_text(path, prior.file_text())
    console.print(f'prior: {path}; use it with prior = "{path.name}" in the particulars')


def _print_worth(runs: Sequence[tuple[Log, Twin]], predictor: str) -> None:
    """Print by how much forecasts of each run err with the prior of the others, beside none."""
    ratios = []
    for k, (log, twin) in enumerate(runs):
        prior = prior_of_runs([other.predictor for _, other in (*runs[:k], *runs[k + 1 :])])
        own = dataclasses.replace(twin.particulars, prior=prior)
        with row_progress(f"forecasting {log.name}", 2 * len(log)) as advance:
            told, untold = (
                judge(log, boat, predictor, on_row=advance).answers[0].numbers
                for boat in (own, twin.particulars)
            )
        if told:
            names = ("displacement_m", "heading_rad")
            ratios.append([told[name] / untold[name] for name in names])
    if not ratios:
        console.print("what the prior is worth cannot be told: too few fixes and headings")
        return
    typical, worst = np.exp(np.log(ratios).mean(axis=0)), np.max(ratios, axis=0)
    console.print(
        "With the prior of the other runs, forecasts of 10 s err by "
        f"{typical[0]:.2f} (displacement) and {typical[1]:.2f} (heading) of what they do without; "
        f"in the worst of {len(ratios)} runs by {worst[0]:.2f} and {worst[1]:.2f}.",
        soft_wrap=True,
    )


def _estimate_json(estimate: Estimate, twin: Twin) -> dict[str, Any]:
    """Return the last estimate as plain data; SI units, as the names end."""
    names = twin.predictor.parameter_names
    seen, in_use = twin.predictor.identifiability(), twin.predictor.parameters_in_use()
    content: dict[str, Any] = {
        "predictor": twin.name,
        "t_s": estimate.t,
        "ready": estimate.ready,
        "datum": None if twin.datum is None else twin.datum.to_json(),
        "state": dict(zip(STATE, estimate.state.tolist(), strict=True)),
        "state_sd": dict(zip(STATE, estimate.sd.tolist(), strict=True)),
        "parameters_in_use": None if in_use is None else in_use.name,
        "parameters": dict(zip(names, estimate.params.tolist(), strict=True)),
        "parameters_sd": dict(zip(names, estimate.params_sd.tolist(), strict=True)),
        "health": {name: status._asdict() for name, status in twin.health.items()},
        "health_notes": list(twin.notes),
        "identifiability": None if seen is None else seen.to_json(),
    }
    motion, sea = estimate.motion, twin.sea
    if motion is not None:
        content["motion"] = dict(zip(CHANNELS, motion.mean.tolist(), strict=True))
        content["motion_sd"] = dict(zip(CHANNELS, motion.sd.tolist(), strict=True))
        known = sea is not None and sea.known
        names = ("hs_m", "period_s", "to_rad", "to_sd_rad")
        content["sea"] = dict(zip(names, sea, strict=True)) if sea is not None and known else None
    return content
