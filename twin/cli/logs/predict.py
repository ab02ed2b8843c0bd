"""``usv-twin predict``: forecast from any moment of a log."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from twin.channels import COMMANDS, TIME
from twin.cli.common import (
    MOTION_HEADS,
    MOTION_SCALE,
    STATE_HEADS,
    STATE_SCALE,
    LogArgument,
    MappingOption,
    ModelOption,
    PredictorOption,
    ShipOption,
    check_out,
    console,
    new_table,
    note,
    open_log,
    print_health,
    print_sea,
    row_progress,
)
from twin.digital_twin import TwinError, known_plan
from twin.logs.bag_writer import BAG_SUFFIX, Forecast, write_bag
from twin.logs.dates import Clock
from twin.logs.errors import LogError
from twin.logs.files import CsvFile
from twin.logs.log import Log
from twin.motion import CHANNELS, QUIET_SPANS, MotionForecast, SeaEstimate
from twin.predictors.base import Z90, Prediction
from twin.predictors.registry import DEFAULT

LEARNING_MIN = 10.0
"""A twin with a model has learned nothing of the boat from less data than this, s: the first refit
comes after about as much."""


def predict_command(
    log: LogArgument,
    predictor: PredictorOption = DEFAULT,
    model: ModelOption = None,
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
            help="The prediction, its sd and its 90 % interval: .csv, .parquet or .geojson; or "
            "with the log and the estimates: .mcap.",
        ),
    ] = None,
) -> None:
    """Run the twin over a log up to a time, and predict the motion after it."""
    dt = horizon / max(round(horizon / 0.1), 1)
    commands = None if plan in ("hold", "known") else _read_plan(Path(plan), horizon, dt)
    run, twin = open_log(log, predictor, ship=ship, model=model, mapping=mapping)
    if out is not None:
        check_out(out, run, twin)
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
        states = twin.run(before, advance)
    print_health(twin)
    if not twin.estimate().ready:
        raise LogError(f"{log}: no fix and heading before t = {at:g} s; choose a later --at")
    if plan == "known":
        commands = known_plan(run, row, horizon, dt)
    prediction = twin.predict("hold" if commands is None else commands, horizon=horizon, dt=dt)
    seen = float(run.t[row] - run.t[0])
    if twin.predictor.parameter_names and seen < LEARNING_MIN:
        note(
            f"the twin has seen {seen:.1f} s of data: it had no time to learn the boat, and the "
            "forecast rests on the prior"
        )
    _print_prediction(prediction, predictor, plan, run)
    if prediction.motion is not None:
        _print_motion(prediction.motion, twin.sea)
    if out is not None and out.suffix == BAG_SUFFIX:
        write_bag(out, run, states, _forecast(prediction))
        console.print(f"log, estimates and prediction: {out}")
    elif out is not None:
        about = {"boat": twin.particulars.name, "log": run.name, "predictor": predictor}
        prediction.table(twin.datum).write(out, **about, plan=plan, from_t_s=prediction.t0)
        console.print(f"every 0.1 s: {out}")


def _forecast(prediction: Prediction) -> Forecast:
    """Return a prediction as a bag has it."""
    whole = Forecast(prediction.t0, prediction.t, prediction.mean, prediction.cov)
    motion = prediction.motion
    if motion is None:
        return whole
    after = prediction.t - motion.t0
    columns = [CHANNELS.index(name) for name in ("heave_m", "roll_rad", "pitch_rad")]
    mean, sd, rates = (part[:, columns] for part in (*motion.at(after), motion.rates_at(after)))
    return whole._replace(tilt=mean, tilt_sd=sd, tilt_rates=rates)


def _read_plan(path: Path, horizon: float, dt: float) -> np.ndarray:
    """Return a plan of commands on the grid of a prediction, from a CSV file."""
    names = (TIME, *COMMANDS)
    if not path.is_file():
        raise TwinError(f"--plan {path}: use hold, known, or a CSV file with {', '.join(names)}")
    file = CsvFile(path)
    missing = [name for name in names if name not in file.header]
    if missing:
        raise TwinError(f"{path}: the column(s) {', '.join(missing)} are missing")
    blocks = [block[1] for block in file.blocks(names, Clock(""))]
    rows = np.concatenate([np.stack([b[name] for name in names], axis=1) for b in blocks])
    rows = rows[~np.isnan(rows).all(axis=1)]  # blank lines
    if len(rows) == 0 or not np.isfinite(rows).all() or (np.diff(rows[:, 0]) <= 0).any():
        raise TwinError(f"{path}: needs at least one row, finite numbers, and a rising t_s")
    middle = dt * (np.arange(round(horizon / dt)) + 0.5)
    return rows[np.maximum(np.searchsorted(rows[:, 0], middle, side="right") - 1, 0), 1:]


def _print_prediction(prediction: Prediction, predictor: str, plan: str, log: Log) -> None:
    span = float(prediction.t[-1] - prediction.t0)
    ends = (1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0)
    horizons = [h for h in ends if h < span - 1e-6] + [span]
    mean = prediction.at(np.array(horizons))[0]
    low, high = prediction.interval(np.array(horizons))
    up, down = high - mean, mean - low
    mean[:, 2] %= 2.0 * math.pi
    table = new_table(
        f"{log.name}: prediction at t = {prediction.t0:.2f} s by {predictor}, plan {plan} "
        "(below each value how far its 90 % interval reaches up and down)",
        "after s",
        *STATE_HEADS,
    )
    parts = (part * STATE_SCALE for part in (mean, up, down))
    for horizon, *rows in zip(horizons, *parts, strict=True):
        # one below the other: side by side they do not fit into 80 columns
        cells = (f"{m:.2f}\n+{u:.2f}\n-{d:.2f}" for m, u, d in zip(*rows, strict=True))
        table.add_row(f"{horizon:g}", *cells)
    console.print(table)


def _print_motion(motion: MotionForecast, sea: SeaEstimate | None) -> None:
    after = [0.0, 1.0, 2.0, 3.0, 5.0, float(motion.t[-1] - motion.t0)]
    mean, sd = motion.at(after)
    title = (
        "roll, pitch and heave (each with half of its 90 % interval; vertical speed at the deck)"
    )
    table = new_table(title, "after s", *MOTION_HEADS)
    for time, *rows in zip(after, mean * MOTION_SCALE, Z90 * sd * MOTION_SCALE, strict=True):
        table.add_row(f"{time:g}", *(f"{m:.2f} +-{s:.2f}" for m, s in zip(*rows, strict=True)))
    console.print(table)
    chances = zip(QUIET_SPANS, motion.quiet, strict=True)
    shown = ", ".join(f"{span:g} s {chance:.0%}" for span, chance in chances)
    if motion.ready:
        console.print(f"quiet deck for the next: {shown}", highlight=False)
    else:
        note(
            "the forecast of roll, pitch and heave is still learning: it says little yet, and "
            "the odds of a quiet deck are not known"
        )
    print_sea(sea)
