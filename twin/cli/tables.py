"""Tables that the commands print."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from twin.agents.evaluation import mean_scores
from twin.agents.training import Plan, Run
from twin.benchmark.metrics import interval_of
from twin.benchmark.motion_scores import attitude_lines
from twin.benchmark.trust import BAD, DOUBTFUL, OK, Verdict
from twin.benchmark.verdict.summary import ORACLE, best_first, recorded_blocks, sentence_of
from twin.boat_prior import BoatPrior
from twin.cli.common import console, explain, new_table, note
from twin.digital_twin import Twin
from twin.identification.identifiability import Finding, Identifiability
from twin.integrity.findings import ERROR, NOTE, SEVERITIES, WARNING
from twin.integrity.log_check import LogCheck
from twin.motion import QUIET_SPANS, MotionForecast, SeaEstimate
from twin.predictors.base import Z90, Estimate, Prediction

__all__ = [
    "print_check",
    "print_episodes",
    "print_estimate",
    "print_health",
    "print_prediction",
    "print_prior",
    "print_scores",
    "print_trainings",
    "print_verdict",
]

STATE_HEADS = ("north m", "east m", "heading deg", "surge m/s", "sway m/s", "yaw deg/s")

STATE_SCALE = np.array([1.0, 1.0, 180.0 / math.pi, 1.0, 1.0, 180.0 / math.pi])
"""From SI units to those of :data:`STATE_HEADS`."""

MOTION_HEADS = ("roll deg", "pitch deg", "heave m", "down m/s")

MOTION_SCALE = np.array([180.0 / math.pi, 180.0 / math.pi, 1.0, 1.0])
"""From SI units to those of :data:`MOTION_HEADS`; the last is the vertical speed of the deck."""

SHOWN_AFTER_S = (1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0)
"""Times of a prediction that a table shows, and its end."""

HEALTH_LINES = 12
"""So many lines on sensors are printed at most."""

STYLES = {ERROR: "red", WARNING: "yellow", NOTE: "dim", BAD: "red", DOUBTFUL: "yellow", OK: "green"}

Row = Mapping[str, Any]


def short(value: float | None, digits: int) -> str:
    """Return a number with so many decimals below 10, and fewer above; a dash for none."""
    if value is None:
        return "-"
    for bound, fewer in ((10.0, 0), (100.0, 1)):
        if abs(value) < bound:
            return f"{value:.{digits - fewer}f}"
    return f"{value:.0f}"


def _print_rows(
    title: str,
    rows: Sequence[Row],
    columns: Mapping[str, Callable[[Any], str]],
    left: Sequence[str] = (),
) -> None:
    """Print a table with a line for each row; ``columns`` has the text of a row by heading."""
    table = new_table(title, *columns, left=left)
    for row in rows:
        table.add_row(*(text(row) for text in columns.values()))
    console.print(table)


def _plain(text: str, style: str | None = None) -> None:
    """Print a line as it is."""
    console.print(text, style=style, highlight=False, soft_wrap=True)


# what twin and log say
def print_health(lines: Sequence[str]) -> None:
    """Print the notes of a twin: when which sensor was not ok, and why."""
    for line in lines[:HEALTH_LINES]:
        note(line)
    if len(lines) > HEALTH_LINES:
        note(f"and {len(lines) - HEALTH_LINES} more times that a sensor was not ok")


def print_check(check: LogCheck) -> None:
    """Print what was measured in a log, and the findings."""
    recording = check.recording
    if len(recording.t) > 1:
        span = recording.t[-1] - recording.t[0]
        _print_rows(
            f"{recording.name}: {len(recording.stamps)} rows, {span:.1f} s",
            check.sensors,  # type: ignore[arg-type]
            {
                "sensor": lambda s: s.name,
                "samples/s": lambda s: f"{s.rate_hz:.3g}" if s.rate_hz else "none",
                "noise": lambda s: f"{s.noise:.2g}" if math.isfinite(s.noise) else "",
                "unit": lambda s: s.unit,
            },
            left=("sensor", "unit"),
        )
    for line in check.agreement:
        _plain(line)
    for finding in check.findings:
        _plain(f"{finding.severity}: {finding.text}", STYLES[finding.severity])
    _plain(", ".join(f"{check.count(severity)} {severity}(s)" for severity in SEVERITIES))


def print_verdict(verdict: Verdict) -> None:
    """Print whether a twin may be trusted."""
    print_health(verdict.notes)
    console.print()
    title = f"twin of {verdict.boat} by {verdict.predictor}: {verdict.grade}"
    _plain(title, STYLES[verdict.grade])
    for answer in verdict.answers:
        _plain(f"{answer.grade:<9}{answer.about:<12} {answer.text}", STYLES[answer.grade])


# identify
def print_estimate(prior: Estimate, last: Estimate, twin: Twin, log: str) -> None:
    """Print the state and the parameters at the end of a log.

    Parameters
    ----------
    prior, last : Estimate
        Before the first row, and at the end.
    twin : Twin
        After the last row.
    log : str
        Its name.
    """
    title = f"{log}: state at t = {last.t:.2f} s by {twin.name}"
    state = last.state.copy()
    state[2] %= 2.0 * math.pi
    _print_mean_and_sd(title, STATE_HEADS, state * STATE_SCALE, last.sd * STATE_SCALE)
    if (motion := last.motion) is not None:
        title = "roll, pitch, heave, vertical speed of the deck"
        mean, sd = motion.mean * MOTION_SCALE, motion.sd * MOTION_SCALE
        _print_mean_and_sd(title, MOTION_HEADS, mean, sd)
    _print_sea(twin.sea)
    if not len(last.params):
        console.print(f"{twin.name} has no model, and so identifies no parameters.")
        return
    _print_parameters(prior, last, twin)


def _print_mean_and_sd(title: str, heads: Sequence[str], mean: Any, sd: Any) -> None:
    table = new_table(title, "", *heads, padding=(0, 1))
    for name, values in (("value", mean), ("sd", sd)):
        table.add_row(name, *(f"{v:.3f}" for v in values))
    console.print(table)


def _print_sea(sea: SeaEstimate | None) -> None:
    """Print what a twin makes of the waves, once it knows."""
    if sea is not None and sea.known:
        to, sd = math.degrees(sea.to) % 360.0, math.degrees(sea.to_sd)
        going = f"to {to:.0f} deg (sd {sd:.0f})" if sea.direction_known else "in no clear direction"
        _plain(
            f"sea: significant height {sea.hs:.2f} m, mean period {sea.period:.1f} s, "
            f"waves going {going}"
        )


def _print_parameters(prior: Estimate, last: Estimate, twin: Twin) -> None:
    in_use, seen = twin.predictor.parameters_in_use(), twin.predictor.identifiability()
    title = "parameters (mean and standard deviation)"
    title += "" if in_use is None else f"; in use: {in_use.name}"
    heads = ("", "unit", "prior", "sd", "now", "sd", "ratio", "source")
    table = new_table(title, *heads, left=("", "unit", "source"))
    found = {} if seen is None else {item.name: item for item in seen.parameters}
    for i, name in enumerate(twin.predictor.parameter_names):
        ratio = last.params_sd[i] / prior.params_sd[i] if prior.params_sd[i] > 0 else math.nan
        numbers = (prior.params[i], prior.params_sd[i], last.params[i], last.params_sd[i])
        source = _source(found[name]) if name in found else ""
        unit = twin.predictor.parameter_units[i]
        table.add_row(name, unit, *(f"{v:.3g}" for v in numbers), f"{ratio:.2f}", source)
    console.print(table)
    if getattr(twin.predictor, "ukf", None) is not None:  # else they have names of their own
        explain(
            "X, Y, N: terms of the acceleration forward, to starboard, in yaw; N_v|v| times v|v| "
            "is a yaw acceleration. All names: docs/explanation/twin.md, Model structure."
        )
    explain(
        "ratio: sd over that of the prior. source data: it fell to 0.71 or below, and the "
        "parameter's own regressor was excited. source sum: its regressor was collinear with "
        "another (cosine above 0.999), so that the data determine only their sum, given below."
    )
    if in_use is not None and in_use.is_prior:
        explain("The prior is in use: the values are not from the data, only the sd of a refit.")
    if seen is not None:
        _print_identifiability(seen)


def _source(finding: Finding) -> str:
    """Return what determines a parameter."""
    if finding.merged_into:
        return "sum"
    return "data" if finding.informed else "prior"


def _print_identifiability(seen: Identifiability) -> None:
    """Print the sums of collinear parameters, and what the run did not show."""
    if seen.sums:
        _print_rows(
            "sums of collinear parameters",
            seen.sums,  # type: ignore[arg-type]
            {
                "": lambda item: item.name,
                "prior sd": lambda item: f"{item.prior_sd:.3g}",
                "sd": lambda item: f"{item.sd:.3g}",
                "ratio": lambda item: f"{item.ratio:.2f}",
                "source": _source,
            },
            left=("", "source"),
        )
    for model in seen.submodels:
        if model.not_shown:
            shown = "; ".join(model.not_shown)
            explain(f"{model.name}: the run did not show {shown}; there the prior stays.")


def print_prior(prior: BoatPrior, twin: Twin) -> None:
    """Print what runs say together of a boat, beside the population.

    Parameters
    ----------
    prior : BoatPrior
        Of the runs.
    twin : Twin
        Before the first row, without a prior of its own.
    """
    before, names = twin.estimate(), list(twin.predictor.parameter_names)
    heads = ("", "unit", "population", "sd", "this boat", "sd", "ratio")
    title = f"{prior.boat}, from {prior.runs} run(s), model {prior.model}"
    table = new_table(title, *heads, left=("", "unit"))
    for k, name in enumerate(prior.parameters):
        at, sd = names.index(name), math.sqrt(prior.covariance[k][k])
        old = before.params_sd[at]
        numbers = (before.params[at], old, prior.mean[k], sd)
        unit = twin.predictor.parameter_units[at]
        table.add_row(name, unit, *(f"{value:.3g}" for value in numbers), f"{sd / old:.2f}")
    console.print(table)


# predict
def print_prediction(prediction: Prediction, title: str, sea: SeaEstimate | None) -> None:
    """Print a prediction, and where the log shows them roll, pitch and heave."""
    span = float(prediction.t[-1] - prediction.t0)
    horizons = [h for h in SHOWN_AFTER_S if h < span - 1e-6] + [span]
    mean = prediction.at(np.array(horizons))[0]
    low, high = prediction.interval(np.array(horizons))
    up, down = high - mean, mean - low
    mean[:, 2] %= 2.0 * math.pi
    title += " (below each value how far its 90 % interval reaches up and down)"
    table = new_table(title, "after s", *STATE_HEADS)
    parts = (part * STATE_SCALE for part in (mean, up, down))
    for horizon, *rows in zip(horizons, *parts, strict=True):
        # one below the other: side by side they do not fit into 80 columns
        cells = (f"{m:.2f}\n+{u:.2f}\n-{d:.2f}" for m, u, d in zip(*rows, strict=True))
        table.add_row(f"{horizon:g}", *cells)
    console.print(table)
    if prediction.motion is not None:
        _print_motion(prediction.motion)
        _print_sea(sea)


def _print_motion(motion: MotionForecast) -> None:
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
    if motion.ready:
        shown = ", ".join(f"{span:g} s {chance:.0%}" for span, chance in chances)
        _plain(f"quiet deck for the next: {shown}")
    else:
        note(
            "the forecast of roll, pitch and heave is still learning: it says little yet, and "
            "the odds of a quiet deck are not known"
        )


# benchmark
def print_scores(results: dict[str, Any]) -> None:
    """Print the verdict on simulated runs, that on recorded ones, and the notes.

    ``results`` is the content of ``results.json``.
    """
    if results["verdict"]:
        _print_simulated(results["verdict"])
    for line in attitude_lines(results):
        console.print(line, highlight=False, soft_wrap=True)
    _print_recorded_verdict(results)
    for name, log in results.get("logs", {}).items():
        for line in log["absurd"]:
            note(f"{name}: {line}: no truth to score against")
        parts = []
        if log["repairs"]:
            parts.append(f"{len(log['repairs'])} notes and repairs (results.json)")
        if log["skipped"]:
            parts.append(f"{log['skipped']} prediction(s) not scored, in gaps")
        if log.get("left_out"):
            parts.append(
                f"{log['left_out']} prediction(s) not scored, past the last recorded command at "
                f"t = {log['end_s']:.1f} s"
            )
        if parts:
            note(f"{name}: {', '.join(parts)}")
    for line in results["notes"]:
        note(line)


def _print_simulated(rows: Sequence[Row]) -> None:
    """Print one sentence, and a line for each predictor."""
    console.print(sentence_of(rows), highlight=False, soft_wrap=True)
    blocks: dict[str, dict[str, Row]] = {}
    for row in rows:
        blocks.setdefault(row["predictor"], {})[row["loss"]] = row
    losses = [loss for loss in ("none", "any") if any(loss in block for block in blocks.values())]
    lost = {case for row in rows if row["loss"] == "any" for case in row["cases"]}
    named = {"none": "no loss", "any": lost.pop() if len(lost) == 1 else "loss"}
    heads = [
        f"{head}\n{named[loss]}"
        for head in ("position\nm", "heading\ndeg", "ratio to\npersist.")
        for loss in losses
    ]
    runs = next(row["runs"] for row in rows if row["loss"] == "all")
    title = f"Mean error after 10 s, {runs} run{'s' * (runs > 1)}, best first"
    table = _predictor_table(title, *heads, "\n\nMAE", "\n\nMSE", padding=0)
    for name, block in blocks.items():
        if name == ORACLE:
            table.add_section()
        texts = [
            short(block.get(loss, {}).get(key), digits)
            for key, digits in (("position_m", 2), ("heading_deg", 2), ("ratio", 3))
            for loss in losses
        ]
        table.add_row(name, *texts, short(block["all"]["mae"], 3), short(block["all"]["mse"], 3))
    console.print(table)
    explain(
        "Mean absolute errors, mean over scenarios and boats. Ratio: that of position and that of "
        "heading, mean of both. MAE and MSE as in the paper's Table 4: pooled over "
        "u, v, r, position and heading at 1, 2, 5 and 10 s, units mixed."
        + (" oracle is the true ship in the mean wind, no predictor." if ORACLE in blocks else "")
    )


def _predictor_table(title: str, *heads: str, **style: Any) -> Table:
    """Return a table with a line for each predictor."""
    return new_table(title, "predictor", *heads, left=("predictor",), **style)


def _print_recorded_verdict(results: Mapping[str, Any]) -> None:
    """Print errors of recorded runs in metres and degrees, and over persistence of two kinds."""
    blocks = recorded_blocks(results)
    for title, block in blocks.items():
        ends = any(line["loss"] for line in block.values())
        ratio = ("ratio to\npersist.\ntwin", "\n\nlog")
        heads = ["position\n\nm", *ratio, "heading\n\ndeg", *ratio]
        heads += ["end of\nloss: m\noff", "\n\nclaimed"] * ends
        table = _predictor_table(title, *heads)
        for name in best_first(block):
            texts = []
            for channel in ("displacement", "psi"):
                row = block[name][channel]
                texts.append(short(row["error"], 3 if channel == "displacement" else 2))
                texts += [short(row.get(key), 2) for key in ("ratio", "ratio_recorded")]
            if ends:
                loss = block[name]["loss"]
                texts += [short(loss.get(key), 2) for key in ("error_m", "said_m")]
            table.add_row(name, *texts)
        console.print(table)
    if blocks:
        explain(
            "Root mean square errors after 10 s, mean over runs, best first. Ratio to persistence, "
            "which holds u, v and r. Column twin: those of the twin's own navigation, mean of the "
            "ratios of runs. Column log: those in the log, ratio of the mean errors."
            " End of loss: error of the estimated position, m, and the radius that is claimed to "
            "hold 90 %; medians."
        )


REPLICATES = 2000
"""Bootstrap samples behind an interval."""

Rows = Sequence[dict[str, Any]]


def print_trainings(trained: Sequence[tuple[Plan, Run]]) -> None:
    """Print what trainings of several seeds came to."""
    heads = ("seed", "return", "off the path, m", "success", "minutes", "folder")
    first = trained[0][0]
    title = f"{first.name}, {first.steps} decisions"
    table = new_table(title, *heads, left=("folder",), padding=(0, 1))
    for plan, run in sorted(trained, key=lambda pair: pair[0].seed):
        last = run.curve[-1]
        table.add_row(
            str(plan.seed),
            f"{last['return']:.0f}",
            f"{last['off_path_m']:.2f}",
            f"{last['success']:.0%}",
            f"{last['wall_s'] / 60.0:.1f}",
            str(run.folder),
        )
    console.print(table)


def print_episodes(found: Rows) -> None:
    """Print how evaluated agents did, a line for each agent, sea state and loss."""
    means = (
        "reached\nits goal",
        "failed",
        "time to\ngoal, s",
        "return",
        "5 s forecast,\nerror in m",
    )
    heads = ("agent", "sea", "loss", "off the\npath, m", *means)
    one = found[0]
    title = (
        f"task {one['task']}, {one['vessel']}, spread {one.get('vessel_spread', 0.0):g}: median "
        "distance off the path [95 % interval], else means. Where an episode neither reached its "
        "goal nor failed (50 m off, or capsized), its time ran out"
    )
    table = new_table(title, *heads, left=heads[:3], padding=0)
    table.columns[0].no_wrap, table.columns[0].overflow = False, "fold"
    labels = short_names([row["model"] for row in found])
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for row in found:
        groups.setdefault((row["model"], row["sea"], row["faults"]), []).append(row)
    for (model, sea, loss), rows in groups.items():
        times = [row["length_s"] for row in rows if row["success"]]
        table.add_row(
            *(labels[model], sea, loss, median([row["off_path_m"] for row in rows])),
            f"{np.mean([row['success'] for row in rows]):.0%}",
            f"{np.mean([row['failed'] for row in rows]):.0%}",
            f"{np.mean(times):.0f}" if times else "-",
            f"{np.mean([row['return'] for row in rows]):.0f}",
            forecast_error(rows),
        )
    console.print(table)


def short_names(models: Sequence[str]) -> dict[str, str]:
    """Return short names of models: the last part of a path where that is clear."""
    short = {model: Path(model).name.removesuffix(".npz") for model in models}
    names = list(short.values())
    return {model: name if names.count(name) == 1 else model for model, name in short.items()}


def median(distances: Sequence[float]) -> str:
    """Return the median and its bootstrap interval."""
    samples = np.random.default_rng(0).choice(distances, (REPLICATES, len(distances)))
    low, high = interval_of(np.median(samples, axis=1), len(distances))
    between = "" if low is None else f" [{low:.2f}, {high:.2f}]"
    return f"{np.median(distances):.2f}{between}"


def forecast_error(rows: Rows) -> str:
    """Return the mean error of the displacement 5 s ahead, with and without a loss, m."""
    scores = mean_scores([row["twin_forecast"] for row in rows])
    parts = [
        (scores[f"n{place}"], scores[f"known{place}_5s_displacement_m"])
        for place in ("", "_loss")  # with all sensors, or while some are lost
        if scores[f"n{place}"]
    ]
    count = sum(n for n, _error in parts)
    return f"{sum(n * error for n, error in parts) / count:.2f}" if count else "-"
