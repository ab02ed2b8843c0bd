"""Tables that ``usv-twin benchmark`` prints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.table import Table

from twin.benchmark.motion_scores import SHOWN_UNITS, median_scores, shown_motion
from twin.benchmark.protocol import FULL_CASES
from twin.benchmark.verdict.summary import ORACLE, best_first, recorded_blocks, sentence_of
from twin.cli.common import console, explain, new_table, note, short

__all__ = ["print_results", "print_verdict"]

Row = Mapping[str, Any]

Cells = dict[tuple[str, str, str], dict[str, dict[str, Row]]]
"""Rows of a summary by (scenario, case, plan), predictor and metric."""

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


def print_verdict(results: dict[str, Any]) -> None:
    """Print the verdict on simulated runs, that on recorded ones, and the notes.

    ``results`` is the content of ``results.json``.
    """
    if results["verdict"]:
        _print_simulated(results["verdict"])
    _print_recorded_verdict(results)
    for name, log in results.get("logs", {}).items():
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
    every = rows[0] if rows[0]["loss"] == "all" else next(r for r in rows if r["loss"] == "all")
    names = {"none": "no loss", "any": "with a loss", "all": "all"}
    losses = [loss for loss in ("none", "any") if any(loss in block for block in blocks.values())]
    lost = [case for row in rows if row["loss"] == "any" for case in row["cases"]]
    if len(set(lost)) == 1:
        names["any"] = lost[0]
    elif lost:
        names["any"] = "loss"
    if "any" in losses:
        names["none"] = "none"
    heads = [
        (first if k == 0 else "\n") + f"\n{names[loss]}"
        for first in ("position\nm", "heading\ndeg", "ratio to\npersist.")
        for k, loss in enumerate(losses)
    ]
    runs = every["runs"]
    table = _predictor_table(
        f"Mean error after 10 s, {runs} run{'s' * (runs > 1)}, best first",
        *heads,
        "\n\nMAE",
        "\n\nMSE",
        padding=0,
    )
    for name, block in blocks.items():
        if name == ORACLE:
            table.add_section()
        texts = [
            "-" if block.get(loss, {}).get(key) is None else short(block[loss][key], digits)
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


def _print_recorded_verdict(results: Mapping[str, Any]) -> None:
    """Print errors of recorded runs in metres and degrees, and over persistence of two kinds."""
    blocks = recorded_blocks(results)
    for title, block in blocks.items():
        ends = _has_losses(block)
        ratio = ("ratio to\npersist.\ntwin", "\n\nlog")
        heads = ["position\n\nm", *ratio, "heading\n\ndeg", *ratio]
        heads += ["end of\nloss: m\noff", "\n\nclaimed"] * ends
        table = _predictor_table(title, *heads)
        for name in best_first(block):
            texts = []
            for channel in ("displacement", "psi"):
                row = block[name][channel]
                texts.append(short(row["error"], 3 if channel == "displacement" else 2))
                texts += [_optional(row.get(key), 2) for key in ("ratio", "ratio_recorded")]
            if ends:
                loss = block[name]["loss"]
                texts += [_optional(loss.get(key), 2) for key in ("error_m", "said_m")]
            table.add_row(name, *texts)
        console.print(table)
    if blocks:
        explain(
            "Root mean square errors after 10 s, mean over runs, best first. Ratio to persistence, "
            "which holds u, v and r. Column twin: those of the twin's own navigation, mean of the "
            "ratios of runs. Column log: those in the log, ratio of the mean errors."
            + (LOSS_NOTE if any(_has_losses(block) for block in blocks.values()) else "")
        )


LOSS_NOTE = (
    " End of loss: error of the estimated position, m, and the radius that is claimed to hold "
    "90 %; medians."
)
"""Explains the columns of tables with a loss of GPS."""


def _has_losses(block: Mapping[str, Mapping[str, Row]]) -> bool:
    """Return whether a table has the columns on the ends of losses."""
    return any(line["loss"] for line in block.values())


def _optional(value: float | None, digits: int) -> str:
    """Return a number, or a dash where there is none."""
    return "-" if value is None else short(value, digits)


def print_results(results: dict[str, Any], missing: Sequence[str]) -> None:
    """Print a table for each run and case.

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
    _print_motion(**shown_motion(results))
    _print_losses(results.get("losses", []))
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
                texts += [_optional(row.get(key), 3) for key in ("ratio", "geometric")]
                texts.append(_change(row))
            table.add_row(predictor, *texts)
        console.print(table)
    against = next((row["against"] for row in rows if "against" in row), None)
    if against is not None:
        explain(
            f"%: change of the mean ratio against {against} on the same runs, with its 95 % "
            "bootstrap interval over runs"
        )


def _print_losses(rows: Sequence[Row]) -> None:
    """Print how far off the estimated position is at the end of a loss, and how far it says."""
    if not rows:
        return
    names = ("run", "loss", "predictor")
    title = "Estimated position at the end of a loss of GPS"
    heads = (*names, "losses", "off m", "worst", "said m", "held")
    table = new_table(title, *heads, left=names)
    for row in rows:
        table.add_row(
            row["scenario"] or row["folder"],
            row["case"],
            row["predictor"],
            str(row["losses"]),
            *(short(row[key], 2) for key in ("error_m", "worst_m", "said_m")),
            f"{100.0 * row['held']:.0f} %",
        )
    console.print(table)
    explain("Medians; said: the radius that is to hold 90 %; held: the share that it did hold.")


def _print_motion(motion: Sequence[Row], quiet: Sequence[Row]) -> None:
    """Print what the forecasts of roll, pitch and heave are worth, and of a quiet deck."""
    if not motion:
        return
    predictor = motion[0]["predictor"]
    horizons = sorted({row["horizon_s"] for row in motion})
    for plan in dict.fromkeys(row["plan"] for row in motion):
        cells: dict[tuple[str, str], list[Row]] = {}
        for row in motion:
            if row["plan"] == plan:
                cells.setdefault((row["scenario"], row["channel"]), []).append(row)
        after = [f"{h:g} s" for h in horizons]
        title = (
            f"RMSE over sd; below it that of the present value, held; truth inside the 90 % "
            f"interval. Plan {plan}, {predictor}"
        )
        heads: tuple[str, ...] = ("scenario", "channel", "sd", *after)
        skills = new_table(title, *heads, left=heads[:2], padding=0)
        title = f"RMSE; below it the sd of the motion, and the CRPS. Plan {plan}, {predictor}"
        heads = ("scenario", "channel", "unit", *after)
        errors = new_table(title, *heads, left=heads[:3], padding=0)
        for (scenario, channel), found in cells.items():
            unit, factor = SHOWN_UNITS[channel]
            medians = [median_scores(found, horizon) for horizon in horizons]
            sd = float(np.median([row["sd"] for row in found]))
            skills.add_row(
                scenario,
                channel,
                short(factor * sd, 2),
                *(
                    f"{m['skill']:.2f}\n{m['held']:.2f}\n{100.0 * m['coverage90']:.0f} %"
                    for m in medians
                ),
            )
            names = ("rmse", "sd", "crps")
            texts = ["\n".join(short(factor * m[name], 2) for name in names) for m in medians]
            errors.add_row(scenario, channel, unit, *texts)
        console.print(skills)
        console.print(errors)
    scores = ("Brier", "Brier skill", "AUC", "AUC now")
    heads = ("scenario", "case", "plan", "span", "share", *scores)
    table = new_table(f"quiet deck, {predictor}", *heads, left=heads[:3])
    for row in quiet:
        given = (row[name] for name in ("brier", "brier_skill", "auc", "auc_now"))
        values = ("-" if value is None else short(value, 2) for value in given)
        where = (row["scenario"], row["case"], row["plan"], f"{row['span_s']:g} s")
        table.add_row(*where, short(row["base_rate"], 2), *values)
    console.print(table)
    explain(
        f"The twins of all predictors forecast this alike, but for the turn ahead; shown is "
        f"that of {predictor}. Roll and pitch: sd in degrees; heave in m, deck_speed in m/s. "
        "1 is the error of the mean. Medians over seeds. Quiet: roll, pitch and deck speed "
        "within the limits of the particulars for the whole span; share: how often that was so. "
        "Brier skill: 0 is that of the share. AUC now: of how far the deck is within its limits "
        "at present."
    )


def _change(row: Row) -> str:
    """Return a change against the reference with its interval, in %."""
    if "change_percent" not in row:
        return "-"
    text = f"{row['change_percent']:+.0f}"
    if row["change_low"] is not None:
        text += f"\n{row['change_low']:+.0f}..{row['change_high']:+.0f}"
    return text
