"""``usv-twin predict``: forecast from any moment of a log."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from twin.channels import CHANNELS
from twin.cli.common import (
    MappingOption,
    ModelOption,
    PredictorOption,
    ShipOption,
    _bar,
    _begin,
    _speaking,
    _write_csv,
    app,
    console,
)
from twin.digital_twin import TwinError, known_plan
from twin.logs.columns import LogError
from twin.logs.log import Log
from twin.predictors.base import Prediction
from twin.predictors.registry import DEFAULT


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
