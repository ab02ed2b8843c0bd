"""Tables of a benchmark for papers: LaTeX with intervals and the best in bold, and CSV."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from twin import files
from twin.benchmark.metrics import BASELINE, ORACLE, grouped
from twin.benchmark.motion_scores import MOTION_METRICS, MOTION_UNITS
from twin.benchmark.verdict.summary import scope_of
from twin.benchmark.verdict.tables import IDEAL, best_text, is_best, number

__all__ = ["csv_text", "latex_text"]

Row = Mapping[str, Any]

CELL = ("scenario", "case", "plan")

DEGREES = 180.0 / math.pi

COLUMNS = {
    "displacement_10s": ("position (m)", 1.0),
    "psi_10s": (r"heading ($^\circ$)", DEGREES),
    "mae": ("MAE", 1.0),
    "mse": ("MSE", 1.0),
    "J": ("$J$", 1.0),
    "coverage90": (r"coverage (\%)", 100.0),
}
"""Columns of the LaTeX tables by metric: heading, and factor from the results' unit."""

VERDICT = {
    "position_m": ("displacement_10s", 1.0),
    "heading_deg": ("psi_10s", DEGREES),
    "ratio": (f"displacement_psi_10s_over_{BASELINE}", 1.0),
    "mae": ("mae", 1.0),
    "mse": ("mse", 1.0),
}
"""Metric of each entry of the verdict, and factor from the metric's unit."""

LOSSES = {"none": "", "any": ", loss", "all": ""}
"""What is said of a loss behind such a column."""

UNITS = {"start_error": "m", "displacement_10s": "m", "psi_10s": "rad"}
"""Units of the metrics that have one."""

FITTED = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}"
"""Scales a table down to the width of the text, and none up."""

CSV_COLUMNS = (
    *("scenario", "case", "fault", "sea", "grade", "plan", "predictor", "metric", "unit"),
    *("value", "low", "high", "median", "runs", "best"),
)
"""Columns of the CSV table; ``low`` and ``high`` are the 95 % interval. Means over
several scenarios or cases have their names parted by |."""


def _recorded(results: Row) -> list[dict[str, Any]]:
    """Return the ratios to persistence of the recorded runs, as rows like those of the summary.

    Without persistence they are the errors themselves.
    """
    return [
        {
            **{key: row[key] for key in ("fault", "plan", "predictor", "runs")},
            **{"scenario": row["folder"], "case": row["fault"], "of": f"rmse_{row['channel']}_10s"},
            "metric": f"rmse_{row['channel']}_10s"
            + (f"_over_{BASELINE}" if "ratio" in row else ""),
            "unit": "" if "ratio" in row else UNITS[f"{row['channel']}_10s"],
            **{key: row.get(key) for key in ("low", "high")},
            "value": row.get("ratio", row.get("rmse")),
        }
        for row in results.get("recorded") or []
    ]


def _paired(results: Row) -> list[dict[str, Any]]:
    """Return the paired comparisons as rows like those of the summary: change, and runs won."""
    found = [
        {**row, "metric": "mae", "value": row["change_percent"], "median": row["median_percent"]}
        | {"runs": row["seeds"]}
        for row in results.get("paired") or []
    ]
    found += [
        {**row, "scenario": row["folder"], "case": row["fault"], "value": row["change_percent"]}
        | {"metric": f"rmse_{row['channel']}_10s", "low": row["change_low"]}
        | {"high": row["change_high"], "median": None}
        for row in results.get("recorded") or []
        if "change_percent" in row
    ]
    won = [
        {**row, "value": 100.0 * row["wins"] / row["runs"], "score": "won"}
        | {"low": None, "high": None, "median": None}
        for row in found
    ]
    return [
        {**row, "metric": f"{row['metric']}_{kind}_against_{row['against']}", "unit": "%"}
        | {"of": row["metric"], "kind": kind, "reference": reference}
        for kind, rows, reference in (("change", found, 0.0), ("won", won, 50.0))
        for row in rows
    ]


def _verdict(results: Row) -> list[dict[str, Any]]:
    """Return the verdict as rows like those of the summary, over scenarios and cases: turn|zigzag.

    ``loss`` says which cases: "none", "any" or "all".
    """
    return [
        {name: row[name] for name in ("plan", "predictor", "runs", "loss")}
        | {"scenario": "|".join(row["scenarios"]), "case": "|".join(row["cases"])}
        | {"metric": metric, "value": row[entry] / factor}
        | {end: v / factor if (v := row.get(f"{entry}_{end}")) else v for end in ("low", "high")}
        for entry, (metric, factor) in VERDICT.items()
        for row in results.get("verdict") or []
        if row[entry] is not None
    ]


def _motion(results: Row) -> list[dict[str, Any]]:
    """Return the scores of roll, pitch, heave and a quiet deck, as rows like those of the summary.

    Those of the motion are means over runs; ``score`` is what they are compared by.
    """
    table, own = [], (*CELL, "fault", "sea", "grade", "predictor")
    for block in grouped(results.get("motion") or [], *own, "channel", "horizon_s").values():
        first = block[0]
        channel, ahead = first["channel"], f"{first['horizon_s']:g}s"
        for score in MOTION_METRICS:
            values = [row[score] for row in block]
            found = {"value": float(np.mean(values)), "median": float(np.median(values))}
            unit = MOTION_UNITS[channel] if score in ("rmse", "sd", "crps") else ""
            names = {"metric": f"{channel}_{ahead}_{score}", "score": f"motion_{score}"}
            runs = {"runs": len(block), "unit": unit, "low": None, "high": None}
            table.append({**{key: first.get(key, "") for key in own}, **names, **found, **runs})
    for row in results.get("quiet") or []:
        for score in ("base_rate", "brier", "brier_skill", "auc", "auc_now"):
            if row[score] is not None:
                names = {"metric": f"quiet_{row['span_s']:g}s_{score}", "score": score}
                cell = {key: row.get(key, "") for key in own}
                table.append({**cell, **names, "value": row[score], "low": None, "high": None})
    return table


def _runs(results: Row) -> Counter[tuple[Any, ...]]:
    """Return how many runs each cell of the summary is the mean of."""
    keys = (*CELL, "predictor")
    return Counter(tuple(row[key] for key in keys) for row in results.get("runs") or [])


def csv_text(results: Row) -> str:
    """Return every value of verdict, summary, comparisons, recorded runs and motion as a CSV table.

    Parameters
    ----------
    results : dict
        What :func:`twin.benchmark.runner.collect` returns.

    Returns
    -------
    str
        With the columns :data:`CSV_COLUMNS`; ``best`` marks the best of the rows of a run, case,
        plan and metric to three digits, the oracle left out.
    """
    count, table = _runs(results), []
    rows = [*_verdict(results), *(results.get("summary") or []), *_recorded(results)]
    rows += [*_paired(results), *_motion(results)]
    # the verdict on one scenario and case is their mean in the summary
    once = {key: block[-1] for key, block in grouped(rows, *CELL, "metric", "predictor").items()}
    for block in grouped([*once.values()], *CELL, "metric").values():
        best = best_text(block[0].get("score", block[0]["metric"]), block)
        for row in block:
            own = tuple(row.get(key, "") for key in (*CELL, "predictor"))
            more = {
                "unit": row.get("unit", UNITS.get(row["metric"], "")),
                "runs": row.get("runs", count[own]),
                "best": is_best(row, best),
            }
            table.append([{**row, **more}.get(name) for name in CSV_COLUMNS])
    return files.csv_text(CSV_COLUMNS, table)


def latex_text(results: Row) -> str:
    """Return LaTeX tables: the verdict, each run and case, paired tests, folders of recorded runs.

    They need the packages ``booktabs`` and ``graphicx``; what is wider than the text is scaled to
    it. Below each mean stands its 95 % interval over runs, if there are enough; the best value of a
    column is bold, the oracle left out. The captions say so.

    Parameters
    ----------
    results : dict
        What :func:`twin.benchmark.runner.collect` returns.
    """
    program = (results.get("program") or {}).get("sources", "")
    tables = [
        f"% usv-twin {results.get('version', '')}, sources {program}\n"
        f"% {' '.join(results.get('command', '').split())}\n"
        "% needs \\usepackage{booktabs,graphicx}\n"
    ]
    verdict = [
        {**row, "metric": row["metric"] + LOSSES[row["loss"]], "head": head, "factor": factor}
        for row in _verdict(results)
        for head, factor in [COLUMNS.get(row["metric"], ("ratio", 1.0))]
        if (row["loss"] == "all") == (row["metric"] in ("mae", "mse"))
    ]
    if verdict:
        of = next(row for row in results["verdict"] if row["loss"] == "all")
        caption = (
            f"All scenarios ({_escaped(scope_of(of))}): mean errors of position and heading after "
            "10\\,s, their ratio to those of persistence, pooled MAE and MSE."
        )
        heads = {
            row["metric"]: (row["head"] + LOSSES[row["loss"]], row["factor"]) for row in verdict
        }
        tables.append(_latex_table(verdict, heads, caption, "verdict"))
    count = _runs(results)
    summary = results.get("summary") or []
    for (scenario, case, plan), rows in grouped(summary, *CELL).items():
        runs = max(count[scenario, case, plan, row["predictor"]] for row in rows)
        over = f"mean over {runs} seeds" if runs > 1 else "one run"
        loss = "" if case == "none" else f", case {_escaped(case)}"
        caption = (
            f"{_escaped(scenario)}{loss}, {_planned(plan)}: errors of position "
            f"and heading after 10\\,s, pooled MAE and MSE, {over}."
        )
        names = {row["predictor"] for row in rows}
        if ORACLE in names:
            caption += " The oracle knows the true boat and takes no part."
        metrics = {m: head for m, head in COLUMNS.items() if any(r["metric"] == m for r in rows)}
        tables.append(_latex_table(rows, metrics, caption, f"{scenario}-{case}-{plan}"))
    for (scenario, case, plan), rows in grouped(_paired(results), *CELL).items():
        against = rows[0]["against"]
        caption = (
            f"{_escaped(scenario)}, case {_escaped(case)}, {_planned(plan)}: change of the error "
            f"against {_escaped(against)} on the same runs, below 0 is better, and the share of "
            "runs in which it is smaller."
        )
        heads = {row["metric"]: (rf"{_noun(row)}, {row['kind']} (\%)", 1.0) for row in rows}
        tables.append(_latex_table(rows, heads, caption, f"{scenario}-{case}-{plan}-paired"))
    for (folder, fault, plan), rows in grouped(
        _recorded(results), "scenario", "fault", "plan"
    ).items():
        runs = max(row["runs"] for row in rows)
        loss = "" if fault == "none" else f", loss {_escaped(fault)}"
        ratios = any(row["metric"] != row["of"] for row in rows)
        over = " over that of persistence" if ratios else ""
        caption = (
            f"Recorded runs of {_escaped(folder)}{loss}, {_planned(plan)}: RMSE "
            f"after 10\\,s{over}, mean over {runs} run{'s' if runs > 1 else ''}."
        )
        heads = {
            row["metric"]: (_noun(row), 1.0)
            if row["metric"] != row["of"]
            else COLUMNS[row["of"].removeprefix("rmse_")]
            for row in rows
        }
        tables.append(_latex_table(rows, heads, caption, f"{folder}-{fault}-{plan}"))
    return "\n".join(tables)


def _latex_table(
    rows: Sequence[Row], metrics: Mapping[str, tuple[str, float]], caption: str, label: str
) -> str:
    """Return one LaTeX table with a line for each predictor; the caption gets what marks mean."""
    by_metric = grouped(rows, "metric")
    best = {
        m: best_text(by_metric[m,][0].get("score", m), by_metric[m,], factor)
        for m, (_name, factor) in metrics.items()
    }
    lines = []
    for (predictor,), own in grouped(rows, "predictor").items():
        values, intervals = [], []
        found = {row["metric"]: row for row in own}
        for metric, (_head, factor) in metrics.items():
            row = found.get(metric)
            if row is None:
                values.append("--")
                intervals.append("")
                continue
            text = number(factor * row["value"])
            bold = is_best(row, best[metric], factor)
            values.append(rf"\textbf{{{text}}}" if bold else text)
            low, high = row.get("low"), row.get("high")
            between = ""
            if low is not None and high is not None:
                ends = f"[{number(factor * low)}, {number(factor * high)}]"
                between = rf"{{\scriptsize {ends}}}"
            intervals.append(between)
        lines.append(rf"{_escaped(predictor)} & {' & '.join(values)} \\")
        if any(intervals):
            lines.append(rf" & {' & '.join(intervals)} \\")
    heads = " & ".join(head for head, _factor in metrics.values())
    body = "\n".join(lines)
    if "textbf" in body:
        nearest = f", of coverage what is nearest to {100.0 * IDEAL['coverage90']:g}\\,\\%"
        caption += f" Best in bold{nearest if best.get('coverage90') else ''}."
    if "scriptsize" in body:
        caption += " In brackets: 95\\,\\% intervals over runs."
    return (
        "\\begin{table}\n\\centering\n\\footnotesize\n\\setlength{\\tabcolsep}{3pt}\n"
        # article has no space below a caption
        "\\setlength{\\belowcaptionskip}{6pt}\n"
        f"\\caption{{{caption}}}\n\\label{{tab:{_label(label)}}}\n{FITTED}{{%\n"
        f"\\begin{{tabular}}{{l{'r' * len(metrics)}}}\n\\toprule\n"
        f"predictor & {heads} \\\\\n\\midrule\n{body}\n\\bottomrule\n"
        "\\end{tabular}}\n\\end{table}\n"
    )


_SPECIAL = {
    **{mark: f"\\{mark}" for mark in "&%$#_{}"},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
}


def _noun(row: Row) -> str:
    """Return what the metric that a row compares is called, without its unit."""
    return COLUMNS[row["of"].removeprefix("rmse_")][0].partition(" (")[0]


def _planned(plan: str) -> str:
    """Return what is known of the future commands, for a caption."""
    return f"future commands {_escaped({'hold': 'held'}.get(plan, plan))}"


def _escaped(text: str) -> str:
    """Return text with the marks that mean something to LaTeX written out."""
    return "".join(_SPECIAL.get(mark, mark) for mark in text)


def _label(text: str) -> str:
    """Return text as the name of a table."""
    return "".join(mark if mark.isalnum() or mark in "-." else "-" for mark in text)
