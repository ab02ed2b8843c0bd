"""The report of a benchmark: one page of HTML with its pictures inside, and the pictures alone.

Nothing here computes a result; it only shows what ``twin.benchmark.runner`` hands over. The page needs
no network, no script and no font of its own.
"""

from __future__ import annotations

import html
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.benchmark.figures import (
    TRENDS,
    Looks,
    RunFigure,
    error_figure,
    looks_of,
    name_of,
    number_of,
    origins_of,
    parameter_figure,
    prediction_figure,
    reference_of,
    second,
    text_of,
    track_figure,
    trend_figure,
)
from twin.benchmark.svg import FONTS, sheet_of, standalone, svg_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "write_report",
]

PAPER = {"turn": 9, "zigzag": 13}
"""First of the paper's four figures of a scenario: parameters of surge, sway, yaw; prediction."""

METHOD = "dsw-ukf"
"""The paper's own method: its parameters are unfolded."""

METRICS = {
    "mae": ("MAE", "mean absolute error over all channels and horizons, units mixed"),
    "mae_median": ("median MAE", "median of the MAE over seeds"),
    "mse": ("MSE", "mean squared error, pooled in the same way"),
    "normalised": ("normalised error", "MAE over the size of the true change, mean of channels"),
    "skill": ("skill", "1 - error / error of persistence; below 0 is worse than persistence"),
    "J": (
        "J",
        "MAE over all runs over that of the oracle, mean of u, v, r, heading and displacement, "
        "each the mean of every half second up to 10 s",
    ),
    "E": ("E", "J - 1, the excess over the oracle"),
    "E_runs": (
        "mean E of runs",
        "the same for each run by itself, mean over runs: few of them can make most of it",
    ),
    "crps": ("CRPS", "score of the whole distribution, pooled as the MAE; of a sure one, its MAE"),
    "start_error": (
        "start error (m)",
        "distance of the believed from the reference position when the prediction was made",
    ),
    "displacement_10s": ("displacement (m)", "MAE of the displacement after 10 s"),
    "psi_10s": ("heading (rad)", "MAE of the heading after 10 s"),
    "coverage90": ("90 % coverage", "share of errors inside the 90 % bands; 0.9 is ideal"),
}
"""Heading and meaning of each metric, in the order of the table's columns."""


def write_report(out: Path, results: dict[str, Any], runs: list[RunFigure]) -> list[Path]:
    """Write ``report.html`` and ``pictures/*.svg``.

    Parameters
    ----------
    out : Path
        Folder, made if it is not there.
    results : dict
        Content of ``results.json``: ``version``, ``command``, ``settings``, ``rows`` and
        ``summary``; ``notes``, a list of lines such as on predictors left out, may be there.
    runs : list of RunFigure
        The runs to be drawn; may be empty.

    Returns
    -------
    list of Path
        What was written, the report first.
    """
    out = Path(out)
    folder = out / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    for stale in folder.glob("*.[ps][nv]g"):
        stale.unlink()
    pictures = _Pictures(folder)
    names = dict.fromkeys(text_of(row, "predictor") for row in results.get("rows") or [])
    names.update(dict.fromkeys(text_of(row, "predictor") for row in results.get("summary") or []))
    for run in runs:
        names.update(dict.fromkeys(run.predictors))
    looks = looks_of(names)

    body = [*_introduction(results, runs), *_trends(results, pictures, looks)]
    body += [*_recorded_tables(results), *_tables(results, pictures, looks), *_conditions(results)]
    for index, run in enumerate(runs):
        body += _run_section(run, index, results, pictures, looks)
    page = _PAGE.format(fonts=FONTS, sheet=sheet_of(pictures.styles, "svg "), body="\n".join(body))
    report = out / "report.html"
    report.write_text(page, encoding="utf-8")
    return [report, *pictures.written]


# the page
class _Pictures:
    """Writes each picture to its file and returns it for the page."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.written: list[Path] = []
        self.styles: dict[str, str] = {}

    def add(self, fig: Figure, name: str, caption: str) -> str:
        """Return the HTML of a picture and keep the picture itself beside the report."""
        stem = re.sub(r"[^A-Za-z0-9.-]+", "_", name).strip("._") or "picture"
        path, number = self.folder / f"{stem}.svg", 2
        while path in self.written:
            path, number = self.folder / f"{stem}_{number}.svg", number + 1
        svg = svg_of(fig, f"p{len(self.written)}", caption, self.styles)
        path.write_text(standalone(svg, self.styles), encoding="utf-8")
        self.written.append(path)
        return f"<figure>{svg}<figcaption>{html.escape(caption)}</figcaption></figure>"


def _introduction(results: Mapping[str, Any], runs: Sequence[RunFigure]) -> list[str]:
    """Return title, command, what was measured, and the contents."""
    rows = results.get("rows") or []
    horizons = sorted(
        {number_of(row, "horizon_s") for row in rows or results.get("channels") or []} - {math.nan}
    )
    horizons = [h for h in horizons if math.isfinite(h)]
    far = f"{horizons[-1]:g}" if horizons else "10"
    steps = ", ".join(f"{h:g}" for h in horizons[:-1])
    steps = f"{steps} and {horizons[-1]:g} s" if len(horizons) > 1 else f"{far} s"
    settings = results.get("settings") or {}
    begin = number_of(settings, "identify_s")
    after = f" ({begin:g} s in simulated runs)" if math.isfinite(begin) else ""
    told = [*rows, *(results.get("summary") or [])]
    faults = sorted({text_of(row, "fault") for row in told} | {run.fault for run in runs})
    lost = ", ".join(fault for fault in faults if fault not in ("", "none"))
    body = [
        "<h1>Benchmark of the twin's predictions</h1>",
        f"<pre>{_escape(results.get('command', ''))}</pre>",
        f"<p>Once it has watched measurements and commands long enough{after}, each predictor "
        f"says every second how the boat will move over the next {far} s; it sees nothing of the "
        "future but the commands it is told.</p>",
        f"<p>After {steps} the prediction is compared with the truth that the simulation "
        "knows, or in a recorded run with the measured positions and headings: speeds u and v, "
        "yaw rate r, position along and across the boat, and heading psi, positions counted "
        "from where the prediction starts.</p>",
        "<p>"
        + (
            f"Faults take sensors away (here: {_escape(lost)}; gps10 is a loss of GPS of 10 s "
            "while predictions go on), and what a predictor does then without them is scored "
            "in the same way."
            if lost
            else "No loss of a sensor was added to these runs."
        )
        + "</p>",
    ]
    notes = results.get("notes") or []
    body += [f'<p class="note">{_escape(note)}</p>' for note in notes]
    links = [
        f'<li><a href="#result-{k}">Results: {_escape(_case(*case))}</a></li>'
        for k, case in enumerate(_cases(results))
    ]
    links += [
        f'<li><a href="#run-{k}">Pictures: {_escape(name_of(run))}</a></li>'
        for k, run in enumerate(runs)
    ]
    if links:
        body.append("<nav><ul>" + "".join(links) + "</ul></nav>")
    else:
        body.append("<p>No run is finished yet: there is nothing to show.</p>")
    return body


def _conditions(results: Mapping[str, Any]) -> list[str]:
    """Return the settings, and how much each predictor was tuned."""
    settings = results.get("settings") or {}
    body = []
    if settings:
        items = "".join(
            f"<tr><th>{_escape(key)}</th><td>{_escape(_setting(value))}</td></tr>"
            for key, value in settings.items()
        )
        body.append(
            "<details><summary>Settings, version "
            f"{_escape(results.get('version', ''))}</summary>"
            f'<div class="scroll"><table class="plain">{items}</table></div></details>'
        )
    tuned = {
        name: told["tuning"]
        for name, told in (results.get("predictors") or {}).items()
        if isinstance(told, Mapping) and "tuning" in told
    }
    if tuned:
        lines = [
            f"<tr><th>{_escape(name)}</th><td>{_escape(text)}</td></tr>"
            for name, text in tuned.items()
        ]
        body.append(
            "<details><summary>How much each predictor was tuned</summary>"
            + _html_table("<th>predictor</th><th>searched</th>", lines)
            + "</details>"
        )
    return body


def _cases(results: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return scenario and case of all results, in order."""
    rows = [*(results.get("summary") or []), *(results.get("rows") or [])]
    return list(dict.fromkeys((text_of(row, "scenario"), _case_of(row)) for row in rows))


def _case_of(row: Mapping[str, Any]) -> str:
    """Return the name of a row's case: its fault, where there is no other name."""
    return text_of(row, "case") or text_of(row, "fault")


def _case(scenario: str, case: str) -> str:
    return f"{scenario}, {case}" if case != "none" else f"{scenario}, no fault"


FOLDED = 8
"""Of more cases than these, each is folded away."""


def _tables(results: Mapping[str, Any], pictures: _Pictures, looks: Looks) -> list[str]:
    """Return a table and a picture of the errors for each scenario and fault."""
    cases = _cases(results)
    body = ["<h2>Results</h2>"] if cases else []
    shown: set[str] = set()
    for index, (scenario, case) in enumerate(cases):

        def here(part: str, scenario: str = scenario, case: str = case) -> list[dict[str, Any]]:
            return [
                row
                for row in results.get(part) or []
                if (text_of(row, "scenario"), _case_of(row)) == (scenario, case)
            ]

        summary, rows = here("summary"), here("rows")
        title = _escape(_case(scenario, case))
        fold = len(cases) > FOLDED
        body.append(
            f'<details id="result-{index}" class="case"><summary>{title}</summary>'
            if fold
            else f'<h3 id="result-{index}">{title}</h3>'
        )
        if summary:
            body.append(_table(summary))
            shown.update(text_of(row, "metric") for row in summary)
        body += _paired_table(here("paired")) + _channel_tables(here("channels"))
        seeds = len({number_of(row, "seed") for row in rows})
        fig = None if fold else error_figure(_case(scenario, case), rows, looks)
        if fig is not None:
            text = (
                "Error growth: mean absolute error of position and heading against the horizon, "
                f"mean of {seeds} run{'' if seeds == 1 else 's'}. An arrow head marks a curve that "
                "leaves the picture; the table counts it in full."
            )
            body.append(
                '<div class="pictures">'
                + pictures.add(fig, f"{scenario}_{case}_error", text)
                + "</div>"
            )
        if fold:
            body.append("</details>")
    meanings = [
        f"<b>{_escape(name)}</b>: {_escape(text)}"
        for key, (name, text) in METRICS.items()
        if key in shown
    ]
    if meanings:
        body.insert(
            1,
            '<p class="note">Best value of each column in bold; in brackets the 95 % interval '
            "over seeds, where there are enough of them, and the median. "
            + "; ".join(meanings)
            + ".</p>",
        )
    return body


def _table(summary: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of one scenario and fault."""
    cells: dict[tuple[str, str], dict[str, Mapping[str, Any]]] = {}
    for row in summary:
        key = (text_of(row, "predictor"), text_of(row, "plan"))
        cells.setdefault(key, {})[text_of(row, "metric")] = row
    there = list(dict.fromkeys(text_of(row, "metric") for row in summary))
    metrics = [m for m in METRICS if m in there] + [m for m in there if m not in METRICS]
    best = {metric: _best(metric, cells) for metric in metrics}
    plans = len({plan for _, plan in cells}) > 1
    head = "<th>predictor</th>" + ("<th>plan</th>" if plans else "")
    head += "".join(f"<th>{_escape(METRICS.get(m, (m,))[0])}</th>" for m in metrics)
    lines = []
    for (predictor, plan), row in cells.items():
        line = f"<th>{_escape(predictor)}</th>" + (f"<td>{_escape(plan)}</td>" if plans else "")
        for metric in metrics:
            entry = row.get(metric, {})
            text = _value(number_of(entry, "value"))
            if text == best[metric]:
                text = f"<b>{text}</b>"
            low, high = number_of(entry, "low"), number_of(entry, "high")
            if not (math.isnan(low) or math.isnan(high)):
                text += f"<br><small>[{_value(low)}, {_value(high)}]</small>"
                if "mae" not in metric:
                    text += f"<br><small>median {_value(number_of(entry, 'median'))}</small>"
            line += f"<td>{text}</td>"
        lines.append(f"<tr>{line}</tr>")
    return _html_table(head, lines)


def _html_table(head: str, lines: Sequence[str]) -> str:
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )


def _paired_table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the comparison of each predictor with the reference; nothing without one."""
    if not rows:
        return []
    head = "<th>predictor</th><th>plan</th><th>change of MAE</th><th>median</th><th>better</th>"
    lines = []
    for row in rows:
        low, high = number_of(row, "low"), number_of(row, "high")
        between = "" if math.isnan(low) else f"<br><small>[{low:+.1f}, {high:+.1f}]</small>"
        lines.append(
            f"<tr><th>{_escape(text_of(row, 'predictor'))}</th>"
            f"<td>{_escape(text_of(row, 'plan'))}</td>"
            f"<td>{number_of(row, 'change_percent'):+.1f} %{between}</td>"
            f"<td>{number_of(row, 'median_percent'):+.1f} %</td>"
            f"<td>{row.get('wins')} of {row.get('seeds')}</td></tr>"
        )
    against = _escape(text_of(rows[0], "against"))
    note = f'<p class="note">Against {against}, the same seeds; below 0 is better:</p>'
    return [note, _html_table(head, lines)]


def _channel_tables(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return errors, CRPS and coverage by channel and horizon; folded away."""
    if not rows:
        return []
    horizons = "/".join(
        f"{h:g}" for h in dict.fromkeys(number_of(row, "horizon_s") for row in rows)
    )
    body = []
    for metric, title, factor in (
        ("coverage90", "Coverage of the 90 % bands, %", 100.0),
        ("mae", "MAE by channel, SI units and rad,", 1.0),
        ("crps", "CRPS by channel, SI units and rad,", 1.0),
    ):
        told = [row for row in rows if math.isfinite(number_of(row, metric))]
        channels = list(dict.fromkeys(text_of(row, "channel") for row in told))
        cells: dict[tuple[str, str], dict[str, list[str]]] = {}
        for row in told:
            cell = cells.setdefault((text_of(row, "predictor"), text_of(row, "plan")), {})
            value = factor * number_of(row, metric)
            text = f"{value:.0f}" if factor > 1.0 else _value(value)
            cell.setdefault(text_of(row, "channel"), []).append(text)
        lines = []
        for (predictor, plan), cell in cells.items():
            values = "".join(f"<td>{'/'.join(cell.get(c, ['-']))}</td>" for c in channels)
            lines.append(f"<tr><th>{_escape(predictor)}</th><td>{_escape(plan)}</td>{values}</tr>")
        head = "".join(f"<th>{_escape(c)}</th>" for c in ("predictor", "plan", *channels))
        body.append(
            f"<details><summary>{title} at {horizons} s</summary>"
            + _html_table(head, lines)
            + "</details>"
        )
    return body


def _trends(results: Mapping[str, Any], pictures: _Pictures, looks: Looks) -> list[str]:
    """Return the pictures of the error against what changes from case to case."""
    rows = results.get("trends") or []
    plan = text_of(rows[0], "plan") if rows else ""
    body = []
    for axis in TRENDS:
        here = [r for r in rows if text_of(r, "axis") == axis and text_of(r, "plan") == plan]
        if here:
            text = (
                f"{TRENDS[axis][0]}, future commands {plan}: mean over scenarios and boats, with "
                "95 % bootstrap intervals over boats. The vertical axis is logarithmic."
            )
            body.append(pictures.add(trend_figure(axis, here, looks), f"trend_{axis}", text))
    return ["<h2>At a glance</h2>", '<div class="pictures">', *body, "</div>"] if body else []


def _recorded_tables(results: Mapping[str, Any]) -> list[str]:
    """Return the table of RMSE over that of raw persistence, for each folder of recorded runs."""
    blocks: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for row in results.get("recorded") or []:
        key = tuple(text_of(row, name) for name in ("folder", "fault", "plan"))
        blocks.setdefault(key, []).append(row)
    if not blocks:
        return []
    body = [
        "<h2>Recorded runs</h2>",
        '<p class="note">Root mean square error after 10 s over that of raw persistence on the '
        "same run: mean over runs with its 95 % interval, and geometric mean; then the change of "
        "the mean ratio against a reference on the same runs.</p>",
    ]
    told = (row["against"] for rows in blocks.values() for row in rows if "against" in row)
    against = _escape(next(told, "-"))
    head = "<th>predictor</th>" + "".join(
        f"<th>{channel}</th><th>geometric</th><th>against {against}</th>"
        for channel in ("displacement", "heading")
    )
    for (folder, fault, plan), rows in blocks.items():
        lines = []
        for predictor in dict.fromkeys(text_of(row, "predictor") for row in rows):
            line = f"<th>{_escape(predictor)}</th>"
            for channel in ("displacement", "psi"):
                row = next(
                    r for r in rows if (r["predictor"], r["channel"]) == (predictor, channel)
                )
                line += (
                    f"<td>{_value(number_of(row, 'ratio'))}{_between(row, 'low', 'high')}</td>"
                    f"<td>{_value(number_of(row, 'geometric'))}</td>"
                )
                change = number_of(row, "change_percent")
                line += (
                    "<td>-</td>"
                    if math.isnan(change)
                    else f"<td>{change:+.0f} %{_between(row, 'change_low', 'change_high')}</td>"
                )
            lines.append(f"<tr>{line}</tr>")
        most = max(int(number_of(row, "runs")) for row in rows)
        many = "1 run" if most == 1 else f"{most} runs"
        body.append(f"<h3>{_escape(folder)}, {many}, fault {fault}, plan {plan}</h3>")
        body.append(_html_table(head, lines))
    return body


def _between(row: Mapping[str, Any], low: str, high: str) -> str:
    """Return an interval for a cell; nothing where there is none."""
    a, b = number_of(row, low), number_of(row, high)
    return "" if math.isnan(a) else f"<br><small>[{_value(a)}, {_value(b)}]</small>"


def _best(
    metric: str, cells: Mapping[tuple[str, str], Mapping[str, Mapping[str, Any]]]
) -> str | None:
    """Return the best value of a column as it is printed; None if nothing is compared."""
    values = [number_of(row[metric], "value") for row in cells.values() if metric in row]
    values = [value for value in values if math.isfinite(value)]
    if len({_value(value) for value in values}) < 2:
        return None
    if metric == "skill":
        return _value(max(values))
    if metric == "coverage90":
        return _value(min(values, key=lambda value: abs(value - 0.9)))
    return _value(min(values))


def _run_section(
    run: RunFigure,
    index: int,
    results: Mapping[str, Any],
    pictures: _Pictures,
    looks: Looks,
) -> list[str]:
    """Return the pictures of one run."""
    seen = reference_of(run.log)
    stem = f"{run.scenario}_{run.fault}_seed{run.seed}"
    compared = "truth" if seen.known else "measurements (no truth is known)"
    first = PAPER.get(run.scenario)
    title = name_of(run)
    if first is not None:
        title = f"{title[0].upper()}{title[1:]}: compare the paper's Figures {first}-{first + 3}"
    body = [f'<h2 id="run-{index}">{_escape(title)}</h2>']
    if first is not None and run.fault != "none":
        body.append('<p class="note">The paper has these figures without a fault.</p>')
    body.append('<div class="pictures">')
    body.append(
        pictures.add(
            track_figure(run, looks),
            f"{stem}_track",
            "Track, and predicted tracks over 10 s from each example origin (numbered). Axes "
            f"follow the {compared}; a prediction may leave them.",
        )
    )
    origins = origins_of(run)
    for number, origin in enumerate(origins, 1):
        body.append(
            pictures.add(
                prediction_figure(run, origin, looks, seen),
                f"{stem}_prediction{number}",
                f"{_compare(first, 3)}10 s motion prediction against the {compared}, made at "
                f"t = {second(origin)} s. An arrow head marks what leaves its panel.",
            )
        )
    body.append("</div>")
    identified = number_of(results.get("settings") or {}, "identify_s")
    if not seen.known and origins:
        # recorded runs are shorter or longer than simulated ones: their first origin tells
        identified = origins[0]
    shown = {name: f for name, f in run.predictors.items() if f.blocks and len(f.params)}
    for name in sorted(shown, key=lambda name: name != METHOD):
        unfolded = " open" if name == METHOD or METHOD not in shown else ""
        body.append(
            f"<details{unfolded}><summary>Parameters by {_escape(name)}</summary>"
            '<div class="pictures">'
        )
        for place, motion in enumerate(shown[name].blocks):
            fig = parameter_figure(
                run, name, motion, looks, identified if math.isfinite(identified) else None
            )
            text = (
                f"{_compare(first, place)}identification of the {motion} parameters by {name}. "
                "Early transients may leave the picture."
            )
            body.append(pictures.add(fig, f"{stem}_{name}_{motion}", text))
        body.append("</div></details>")
    return body


def _compare(first: int | None, place: int) -> str:
    """Return which of the paper's figures of a scenario a picture is to be compared with."""
    return "" if first is None else f"Compare Figure {first + place} of the paper: "


def _value(value: float) -> str:
    """Return a number for people: three digits, and a dash for what is not known."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    size = abs(value)
    if size >= 1e5:
        return f"{value:.1e}"
    if size >= 100:
        return f"{value:.0f}"
    if size >= 10:
        return f"{value:.1f}"
    if size >= 1:
        return f"{value:.2f}"
    return f"{value:.3f}" if size >= 1e-3 else f"{value + 0.0:.2g}"


def _setting(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        names = (item["name"] if isinstance(item, Mapping) else str(item) for item in value)
        return ", ".join(names) or "none"
    return "none" if value is None else str(value)


def _escape(value: Any) -> str:
    return html.escape(str(value))


_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Benchmark of the twin's predictions</title>
<style>
:root {{ color-scheme: light dark; --ink: #1a1a1a; --soft: #444; --rule: #ccc; --page: #fff;
  --box: #f3f3f3; }}
@media (prefers-color-scheme: dark) {{ :root {{ --ink: #e8e8e8; --soft: #bbb; --rule: #555;
  --page: #16181a; --box: #26292c; }} }}
body {{ font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--page);
  max-width: 1240px; margin: 0 auto; padding: 0 12px 48px; overflow-wrap: anywhere; }}
h1 {{ font-size: 1.6rem; line-height: 1.25; }}
h2 {{ font-size: 1.3rem; margin: 2.2em 0 .5em; padding-top: .5em;
  border-top: 2px solid var(--rule); }}
h3 {{ font-size: 1.08rem; margin: 1.8em 0 .5em; }}
p, nav {{ max-width: 75ch; }}
a {{ color: light-dark(#0059b3, #7db8ff); }}
pre {{ background: var(--box); padding: 8px 12px; white-space: pre-wrap; border-radius: 4px; }}
nav ul {{ padding-left: 1.2em; }}
nav li {{ padding: 4px 0; }}
details {{ margin: .6em 0; }}
summary {{ cursor: pointer; padding: 6px 0; }}
.note, figcaption {{ color: var(--soft); font-size: .88rem; }}
.scroll {{ overflow-x: auto; max-width: 100%; }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; overflow-wrap: normal; }}
th, td {{ padding: 5px 12px; border-bottom: 1px solid var(--rule); text-align: right;
  white-space: nowrap; vertical-align: top; }}
thead th {{ border-bottom: 2px solid var(--soft); vertical-align: bottom; }}
th:first-child, .plain td {{ text-align: left; }}
th:first-child {{ position: sticky; left: 0; background: var(--page); padding-left: 0; }}
.plain td {{ white-space: normal; }}
tbody th {{ font-weight: normal; }}
small {{ color: var(--soft); }}
.pictures {{ display: grid; gap: 20px 16px; align-items: start;
  grid-template-columns: repeat(auto-fill, minmax(min(100%, 366px), 1fr)); }}
figure {{ margin: 0; min-width: 0; max-width: 520px; }}
svg {{ display: block; width: 100%; height: auto; background: #fff; font-family: {fonts}; }}
{sheet}
</style>
</head>
<body>
{body}
</body>
</html>
"""
