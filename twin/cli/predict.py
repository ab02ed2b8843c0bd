"""``usv-twin predict``: forecast from any moment of a log."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from twin.cli.common import (
    LogArgument,
    MappingOption,
    PredictorOption,
    ShipOption,
    console,
    note,
    row_progress,
)
from twin.cli.tables import print_health, print_prediction
from twin.digital_twin import TwinError, known_plan
from twin.logs.errors import LogError
from twin.logs.plan import read_plan
from twin.logs.tables import check_export
from twin.predictors.registry import DEFAULT
from twin.sim.recorded import twin_for_log


def predict_command(
    log: LogArgument,
    predictor: PredictorOption = DEFAULT,
    ship: ShipOption = None,
    mapping: MappingOption = None,
    at: Annotated[
        float | None,
        typer.Option(
            help="Time of the log at which to predict, s. Default: its end, or with a known "
            "plan one horizon before it."
        ),
    ] = None,
    horizon: Annotated[
        float, typer.Option(min=0.1, max=600.0, help="Length of the prediction, s.")
    ] = 10.0,
    plan: Annotated[
        str,
        typer.Option(
            help="Future commands. hold: the last one stays; known: those of the log; or a CSV "
            "file with t_s from now on and the four command columns."
        ),
    ] = "hold",
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="The prediction, its sd and its 90 % interval: .csv, .parquet or .geojson.",
        ),
    ] = None,
) -> None:
    """Run the twin over a log up to a time, and predict the motion after it."""
    dt = horizon / max(round(horizon / 0.1), 1)
    commands = None if plan in ("hold", "known") else read_plan(plan, horizon, dt)
    run, twin = twin_for_log(log, predictor, ship=ship, mapping=mapping)
    for line in run.notes:
        note(line)
    console.print(f"boat: {twin.particulars.name}, {twin.particulars.length:g} m")
    if out is not None:
        check_export(out, twin.datum)
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
    before = run.slice(-math.inf, math.nextafter(run.t[row], math.inf))
    with row_progress("identifying", row + 1) as advance:
        twin.run(before, advance)
    print_health(twin.notes)
    if not twin.estimate().ready:
        raise LogError(f"{log}: no fix and heading before t = {at:g} s; choose a later --at")
    if plan == "known":
        commands = known_plan(run, row, horizon, dt)
    prediction = twin.predict("hold" if commands is None else commands, horizon=horizon, dt=dt)
    title = f"{run.name}: prediction at t = {prediction.t0:.2f} s by {predictor}, plan {plan}"
    print_prediction(prediction, title, twin.sea)
    if out is not None:
        about = {"boat": twin.particulars.name, "log": run.name, "predictor": predictor}
        prediction.table(twin.datum).write(out, **about, plan=plan, from_t_s=prediction.t0)
        console.print(f"every 0.1 s: {out}")
