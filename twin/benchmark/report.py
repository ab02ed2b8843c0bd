"""The report of a benchmark: one page of HTML with its pictures inside, and the pictures alone.

Nothing here computes a result: it shows what ``twin.benchmark.runner`` collects. The page is
``report.html.jinja`` beside this file, and needs no network, no script and no font of its own.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.benchmark.figures import (
    TRENDS,
    RunFigure,
    deck_figure,
    error_figure,
    parameter_figure,
    prediction_figure,
    predictor_styles,
    recorded_figure,
    reliability_figure,
    track_figure,
    trend_figure,
    verdict_figure,
)
from twin.benchmark.figures.data import (
    example_times,
    number_of,
    reference_of,
    run_label,
    text_of,
)
from twin.benchmark.figures.deck import SHOWN_AHEAD
from twin.benchmark.figures.drawing import Picture, Pictures
from twin.benchmark.figures.style import Styles
from twin.benchmark.motion_scores import SHOWN_UNITS, median_scores, shown_motion
from twin.benchmark.svg import FONTS, sheet_of
from twin.benchmark.verdict.summary import recorded_blocks, sentence_of
from twin.benchmark.verdict.tables import (
    Cell,
    Grid,
    interval_text,
    losses_grid,
    number,
    recorded_verdict_grids,
    verdict_grid,
)
from twin.predictors.registry import DEFAULT
from usv_kernel.files import write_whole

if TYPE_CHECKING:
    from jinja2 import Template

__all__ = [
    "page_template",
    "write_report",
]

Row = Mapping[str, Any]

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
        "MAE over all runs over that of the oracle: mean of u, v, r, heading and displacement, "
        "every half second up to 10 s",
    ),
    "E": ("E", "J - 1, the excess over the oracle"),
    "E_runs": ("mean E of runs", "the same for each run by itself, mean over runs"),
    "crps": (
        "CRPS",
        "score of the whole distribution, pooled as the MAE; without a spread it is the MAE",
    ),
    "start_error": (
        "start error (m)",
        "error of the estimated position at the time of the prediction",
    ),
    "displacement_10s": ("displacement (m)", "MAE of the displacement after 10 s"),
    "psi_10s": ("heading (rad)", "MAE of the heading after 10 s"),
    "coverage90": (
        "90 % coverage",
        "share of errors inside the 90 % prediction intervals; 0.9 is ideal",
    ),
}
"""Heading and meaning of each metric, in the order of the table's columns."""

CHANNEL_TABLES = {
    "coverage90": "Coverage of the 90 % intervals, %,",
    "mae": "MAE by channel, SI units and rad,",
    "crps": "CRPS by channel, SI units and rad,",
}
"""Titles of the tables by channel and horizon."""

MAX_CASES = 8
"""Of more cases than these, each is folded away."""


def write_report(
    out: Path,
    results: dict[str, Any],
    runs: list[RunFigure],
    drawn: Callable[[str], None] | None = None,
    jobs: int = 1,
    *,
    pdf: bool = False,
) -> list[Path]:
    """Write ``report.html`` and ``pictures/*.svg``; return what was written, the report first.

    ``results`` is the content of ``results.json``: ``version``, ``command``, ``settings``, ``rows``
    and ``summary``; ``notes``, a list of lines such as on predictors left out, is optional.
    ``drawn`` is called with the file name of each picture. ``jobs`` processes draw; the files do
    not depend on their number. ``pdf`` writes each picture as PDF, too.
    """
    out = Path(out)
    folder = out / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    for stale in folder.iterdir():
        if stale.suffix in (".png", ".svg", ".pdf"):
            stale.unlink()
    pictures = Pictures(folder, drawn, pdf=pdf)
    rows = [*(results.get("rows") or []), *(results.get("summary") or [])]
    names = dict.fromkeys(text_of(row, "predictor") for row in rows)
    styles = predictor_styles({**names, **{name: None for run in runs for name in run.predictors}})
    cases = _cases(results, pictures, styles)
    shown_first = _track_shown_first(runs)
    head = {
        "sentence": sentence_of(results.get("verdict") or []),
        "verdict": verdict_grid(results.get("verdict") or []),
        "first": _first_pictures(
            results, None if shown_first is None else runs[shown_first], pictures, styles
        ),
        "recorded_verdict": recorded_verdict_grids(results),
    }
    sections = {
        **head,
        **_introduction(results, runs),
        "trends": _trends(results, pictures, styles),
        "recorded": _recorded_grids(results.get("recorded") or []),
        "losses": losses_grid(results.get("losses") or []),
        "motion": _motion_grids(results),
        "reliability": _reliability(results, pictures),
        "cases": cases,
        "metrics": [METRICS[m] for m in METRICS if any(m in case["metrics"] for case in cases)],
        "settings": results.get("settings") or {},
        "version": results.get("version", ""),
        "tuning": {
            name: item["tuning"]
            for name, item in (results.get("predictors") or {}).items()
            if isinstance(item, Mapping) and "tuning" in item
        },
        "runs": [
            _run(run, results, pictures, styles, k == shown_first) for k, run in enumerate(runs)
        ],
    }
    pictures.draw(jobs)
    page = page_template("report.html.jinja").render(
        **sections, fonts=FONTS, sheet=sheet_of(pictures.styles, "svg ")
    )
    report = out / "report.html"
    write_whole(report, page.encode())
    return [report, *pictures.written]


@functools.cache
def page_template(name: str) -> Template:
    """Return the template of a page; ``name`` is a file in or below this folder."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("twin.benchmark", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["setting"] = _setting
    return environment.get_template(name)


def _introduction(results: Row, runs: Sequence[RunFigure]) -> dict[str, Any]:
    """Return what the first lines say of horizons, faults and notes."""
    rows = results.get("rows") or []
    known = {number_of(row, "horizon_s") for row in rows or results.get("channels") or []}
    horizons = [f"{h:g}" for h in sorted(h for h in known if math.isfinite(h))] or ["10"]
    begin = number_of(results.get("settings") or {}, "identify_s")
    stated = [*rows, *(results.get("summary") or [])]
    faults = sorted({text_of(row, "fault") for row in stated} | {run.fault for run in runs})
    return {
        "command": results.get("command", ""),
        "notes": results.get("notes") or [],
        "horizons": horizons,
        "identified_s": f"{begin:g}" if math.isfinite(begin) else None,
        "faults": [fault for fault in faults if fault not in ("", "none")],
    }


# tables
def _case_of(row: Row) -> str:
    """Return the name of a row's case: its fault, where there is no other name."""
    return text_of(row, "case") or text_of(row, "fault")


def _cases(results: Row, pictures: Pictures, styles: Styles) -> list[dict[str, Any]]:
    """Return tables, and a picture of the errors, for each scenario and case."""
    parts = {
        part: _grouped(
            results.get(part) or [], lambda row: (text_of(row, "scenario"), _case_of(row))
        )
        for part in ("summary", "rows", "paired", "channels")
    }
    cases = []
    keys = dict.fromkeys([*parts["summary"], *parts["rows"]])
    for scenario, case in keys:
        here = {part: groups.get((scenario, case), []) for part, groups in parts.items()}
        title = f"{scenario}, {case}" if case != "none" else f"{scenario}, no fault"
        fold = len(keys) > MAX_CASES
        picture = None
        if not fold:
            seeds = len({number_of(row, "seed") for row in here["rows"]})
            caption = (
                "Error growth: mean absolute error of position and heading against the horizon, "
                f"mean of {seeds} run{'' if seeds == 1 else 's'}. Thin grey lines, with names, are "
                "the other predictors, with the first plan. An arrow head marks a curve that "
                "leaves the picture; the table counts it in full."
            )
            draw = functools.partial(error_figure, title, here["rows"], styles)
            picture = pictures.add(draw, f"{scenario}_{case}_error", caption)
        cases.append(
            {
                "title": title,
                "fold": fold,
                "metrics": {text_of(row, "metric") for row in here["summary"]},
                "summary": _summary_grid(here["summary"]),
                "against": text_of(here["paired"][0], "against") if here["paired"] else None,
                "paired": _paired_grid(here["paired"]),
                "channels": _channel_grids(here["channels"]),
                "picture": picture,
            }
        )
    return cases


def _grouped(rows: Sequence[Row], key: Any) -> dict[Any, list[Row]]:
    """Return rows with the same key together, in their order."""
    groups: dict[Any, list[Row]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return groups


def _predictor_and_plan(row: Row) -> tuple[str, str]:
    return text_of(row, "predictor"), text_of(row, "plan")


def _summary_grid(summary: Sequence[Row]) -> Grid | None:
    """Return the table of one scenario and case."""
    if not summary:
        return None
    there = dict.fromkeys(text_of(row, "metric") for row in summary)
    metrics = [m for m in METRICS if m in there] + [m for m in there if m not in METRICS]
    lines = _grouped(summary, _predictor_and_plan)
    entries = {key: {text_of(row, "metric"): row for row in rows} for key, rows in lines.items()}
    best = {
        metric: _best(metric, [row[metric] for row in entries.values() if metric in row])
        for metric in metrics
    }
    plans = len({key[1] for key in entries}) > 1
    rows = []
    for (predictor, plan), row in entries.items():
        cells = [Cell(predictor), *([Cell(plan)] if plans else [])]
        for metric in metrics:
            entry = row.get(metric, {})
            text, small = number(number_of(entry, "value")), interval_text(entry)
            if small and "mae" not in metric:
                small += (f"median {number(number_of(entry, 'median'))}",)
            cells.append(Cell(text, small, text == best[metric]))
        rows.append(cells)
    heads = ["predictor", *(["plan"] if plans else [])]
    return Grid([*heads, *(METRICS.get(m, (m,))[0] for m in metrics)], rows)


def _best(metric: str, entries: Sequence[Row]) -> str | None:
    """Return the best value of a column as it is printed; None if nothing is compared."""
    values = [v for v in (number_of(entry, "value") for entry in entries) if math.isfinite(v)]
    if len({number(value) for value in values}) < 2:
        return None
    if metric == "skill":
        return number(max(values))
    if metric == "coverage90":
        return number(min(values, key=lambda value: abs(value - 0.9)))
    return number(min(values))


def _paired_grid(rows: Sequence[Row]) -> Grid | None:
    """Return the comparison of each predictor with the reference."""
    if not rows:
        return None
    lines = []
    for row in rows:
        low, high = number_of(row, "low"), number_of(row, "high")
        between = () if math.isnan(low) else (f"[{low:+.1f}, {high:+.1f}]",)
        lines.append(
            [
                *map(Cell, _predictor_and_plan(row)),
                Cell(f"{number_of(row, 'change_percent'):+.1f} %", between),
                Cell(f"{number_of(row, 'median_percent'):+.1f} %"),
                Cell(f"{row.get('wins')} of {row.get('seeds')}"),
            ]
        )
    return Grid(["predictor", "plan", "change of MAE", "median", "better"], lines)


def _channel_grids(rows: Sequence[Row]) -> dict[str, Grid]:
    """Return errors, CRPS and coverage by channel and horizon, by title."""
    horizons = "/".join(
        f"{h:g}" for h in dict.fromkeys(number_of(row, "horizon_s") for row in rows)
    )
    grids = {}
    for metric, title in CHANNEL_TABLES.items() if rows else ():
        finite = [row for row in rows if math.isfinite(number_of(row, metric))]
        channels = list(dict.fromkeys(text_of(row, "channel") for row in finite))
        lines = []
        for names, group in _grouped(finite, _predictor_and_plan).items():
            values: dict[str, list[str]] = {}
            for row in group:
                value = number_of(row, metric)
                text = f"{100.0 * value:.0f}" if metric == "coverage90" else number(value)
                values.setdefault(text_of(row, "channel"), []).append(text)
            cells = [Cell("/".join(values.get(channel, ["-"]))) for channel in channels]
            lines.append([*map(Cell, names), *cells])
        grids[f"{title} at {horizons} s"] = Grid(["predictor", "plan", *channels], lines)
    return grids


def _recorded_grids(rows: Sequence[Row]) -> dict[str, Grid]:
    """Return RMSE over that of raw persistence for each folder of recorded runs, by title."""
    against = next((row["against"] for row in rows if "against" in row), "-")
    heads = ["predictor"]
    for channel in ("displacement", "heading"):
        heads += [channel, "geometric", f"against {against}"]
    grids = {}
    keys = ("folder", "fault", "plan")
    for key, block in _grouped(rows, lambda row: tuple(text_of(row, k) for k in keys)).items():
        lines = []
        for predictor, group in _grouped(block, lambda row: text_of(row, "predictor")).items():
            cells = [Cell(predictor)]
            by_channel = {text_of(row, "channel"): row for row in group}
            for channel in ("displacement", "psi"):
                row = by_channel[channel]
                change = number_of(row, "change_percent")
                cells.append(Cell(number(number_of(row, "ratio")), interval_text(row)))
                cells.append(Cell(number(number_of(row, "geometric"))))
                between = interval_text(row, "change_low", "change_high")
                cells.append(Cell("-" if math.isnan(change) else f"{change:+.0f} %", between))
            lines.append(cells)
        most = max(int(number_of(row, "runs")) for row in block)
        many = "1 run" if most == 1 else f"{most} runs"
        grids[f"{key[0]}, {many}, fault {key[1]}, plan {key[2]}"] = Grid(heads, lines)
    return grids


def _motion_grids(results: Row) -> dict[str, Grid]:
    """Return what the forecasts of roll, pitch, heave and a quiet deck were worth, by title."""
    rows = shown_motion(results)
    if not rows["motion"]:
        return {}
    name = text_of(rows["motion"][0], "predictor")
    return {
        f"Roll, pitch, heave and vertical speed, {name}": _motion_grid(rows["motion"], _skill_cell),
        f"Their errors, {name}": _motion_grid(rows["motion"], _error_cell, "unit"),
        f"Quiet deck, {name}": _quiet_grid(rows["quiet"]),
    }


def _motion_grid(rows: Sequence[Row], cell: Callable[[Row, str], Cell], *more: str) -> Grid:
    """Return medians over runs by scenario, plan, channel and horizon."""
    where = ("scenario", "plan", "channel")
    horizons = sorted({number_of(row, "horizon_s") for row in rows})
    lines = []
    for keys, block in _grouped(rows, lambda row: tuple(row[key] for key in where)).items():
        units = [Cell(SHOWN_UNITS[keys[-1]][0])] if more else []
        cells = (cell(median_scores(block, horizon), keys[-1]) for horizon in horizons)
        lines.append([*map(Cell, keys), *units, *cells])
    return Grid([*where, *more, *(f"{horizon:g} s" for horizon in horizons)], lines)


def _skill_cell(found: Row, _: str) -> Cell:
    """Return the skill, that of the present value, and the coverage."""
    inside = f"{100.0 * found['coverage90']:.0f} %"
    return Cell(number(found["skill"]), (number(found["held"]), inside))


def _error_cell(found: Row, channel: str) -> Cell:
    """Return the RMSE, the standard deviation of the motion, and the CRPS."""
    unit = SHOWN_UNITS[channel][1]
    rmse, sd, score = (number(unit * found[name]) for name in ("rmse", "sd", "crps"))
    return Cell(rmse, (sd, score))


def _quiet_grid(rows: Sequence[Row]) -> Grid:
    """Return how well a quiet deck was foreseen, by scenario, case, plan and span."""
    where = ("scenario", "case", "plan")
    values = ("base_rate", "brier_skill", "auc", "auc_now", "brier")
    lines = [
        [
            *(Cell(text_of(row, key)) for key in where),
            Cell(f"{row['span_s']:g} s"),
            *(Cell(number(number_of(row, key))) for key in values),
        ]
        for row in rows
    ]
    return Grid([*where, "span", "share", "Brier skill", "AUC", "AUC now", "Brier"], lines)


# pictures
def _track_shown_first(runs: Sequence[RunFigure]) -> int | None:
    """Return which run's track stands at the top: one with a loss, of a zigzag if there is."""

    def order(k: int) -> tuple[bool, bool]:
        return not runs[k].lost, runs[k].scenario != "zigzag"

    return min(range(len(runs)), key=order, default=None)


def _first_pictures(
    results: Row, run: RunFigure | None, pictures: Pictures, styles: Styles
) -> list[Picture]:
    """Return the bars and the track at the top of the page."""
    shown = []
    if rows := results.get("verdict"):
        caption = (
            "Mean absolute errors after 10 s, with 95 % bootstrap intervals over boats. Where an "
            "arrow head cuts a bar, its number counts. oracle is the true ship in the mean wind."
        )
        draw = functools.partial(verdict_figure, rows, styles)
        shown.append(pictures.add(draw, "verdict", caption))
    elif blocks := _with_ratios(results):
        caption = (
            "Root mean square errors after 10 s over those of persistence: mean over runs, and "
            "where there are enough of them an interval of 95 %. Where an arrow head cuts a bar, "
            "its number counts."
        )
        draw = functools.partial(recorded_figure, blocks, styles)
        shown.append(pictures.add(draw, "recorded_verdict", caption))
    if run is not None:
        shown.append(_track(run, pictures, styles))
    return shown


def _with_ratios(results: Row) -> dict[str, Any]:
    """Return the tables of the first folder of recorded runs, if persistence took part there."""
    blocks = recorded_blocks(results)
    folder = next((row["folder"] for row in results.get("recorded") or []), None)
    return {
        title: block
        for title, block in blocks.items()
        for row in [next(iter(block.values()))["psi"]]
        if row["folder"] == folder and row.get("ratio") is not None
    }


def _reliability(results: Row, pictures: Pictures) -> list[Picture]:
    """Return the picture of the probabilities of a quiet deck."""
    quiet = shown_motion(results)["quiet"]
    if not quiet:
        return []
    caption = (
        "How often the deck stayed quiet, of all times that such a probability was given: pooled "
        "over scenarios, seeds and plans. Dots below the line: it was promised too often."
    )
    draw = functools.partial(reliability_figure, quiet)
    return [pictures.add(draw, "quiet_reliability", caption)]


def _trends(results: Row, pictures: Pictures, styles: Styles) -> list[Picture]:
    """Return the pictures of the error against what changes from case to case."""
    rows = results.get("trends") or []
    plan = text_of(rows[0], "plan") if rows else ""
    shown = []
    for axis, (title, *_) in TRENDS.items():
        here = [r for r in rows if text_of(r, "axis") == axis and text_of(r, "plan") == plan]
        if here:
            caption = (
                f"{title}, future commands {plan}: mean over scenarios and boats, with "
                "95 % bootstrap intervals over boats. The vertical axis is logarithmic."
            )
            draw = functools.partial(trend_figure, axis, here, styles)
            shown.append(pictures.add(draw, f"trend_{axis}", caption))
    return shown


def _track(run: RunFigure, pictures: Pictures, styles: Styles) -> Picture:
    """Return the picture of the track of one run."""
    truth = reference_of(run.log).is_truth
    compared = "truth" if truth else "measurements (the truth is unknown)"
    caption = (
        f"{run_label(run)}: track, and predicted tracks over 10 s from each example (numbered). "
        f"Axes follow the {compared}; a prediction may leave them."
    ) + ("" if run.log.datum is None else f" Origin: {run.log.datum}.")
    draw = functools.partial(track_figure, run, styles)
    return pictures.add(draw, f"{_stem(run)}_track", caption[0].upper() + caption[1:])


def _stem(run: RunFigure) -> str:
    """Return how the names of the pictures of a run begin."""
    return f"{run.scenario}_{run.fault}_seed{run.seed}"


def _run(
    run: RunFigure, results: Row, pictures: Pictures, styles: Styles, track_shown: bool
) -> dict[str, Any]:
    """Return the pictures of one run; its track may stand at the top of the page."""
    reference = reference_of(run.log)
    stem = _stem(run)
    compared = "truth" if reference.is_truth else "measurements (the truth is unknown)"
    first = PAPER.get(run.scenario)
    label = run_label(run)
    title = label
    if first is not None:
        title = f"{label[0].upper()}{label[1:]}: compare the paper's Figures {first}-{first + 3}"
    starts = example_times(run)
    shown = [] if track_shown else [_track(run, pictures, styles)]
    for k, start in enumerate(starts, 1):
        caption = (
            f"{_compare(first, 3)}10 s motion prediction against the {compared}, made at "
            f"t = {round(start, 1):g} s. An arrow head marks what leaves its panel."
        )
        forecast = functools.partial(prediction_figure, run, start, styles, reference)
        shown.append(pictures.add(forecast, f"{stem}_prediction{k}", caption))
    decked = [name for name, figure in run.predictors.items() if figure.deck is not None]
    if decked:
        name = DEFAULT if DEFAULT in decked else decked[0]
        caption = (
            f"Roll, pitch, heave and the vertical speed of the deck point, and what the twin "
            f"with {name} forecast {SHOWN_AHEAD:g} s before."
        )
        deck = functools.partial(deck_figure, run, name)
        shown.append(pictures.add(deck, f"{stem}_deck", caption))
    begin = starts[0] if starts else None
    models = [
        name for name, figure in run.predictors.items() if figure.blocks and len(figure.params)
    ]
    parameters = {}
    for name in sorted(models, key=lambda name: name != METHOD):
        parameters[name] = [
            pictures.add(
                functools.partial(parameter_figure, run, name, motion, styles, begin),
                f"{stem}_{name}_{motion}",
                f"{_compare(first, k)}identification of the {motion} parameters by {name}. "
                "Early transients may leave the picture.",
            )
            for k, motion in enumerate(run.predictors[name].blocks)
        ]
    return {
        "label": label,
        "title": title,
        "without_fault": first is not None and run.fault != "none",
        "pictures": shown,
        "parameters": parameters,
        "unfolded": [METHOD] if METHOD in models else models,
    }


def _compare(first: int | None, place: int) -> str:
    """Return which of the paper's figures of a scenario shows the same."""
    return "" if first is None else f"Compare Figure {first + place} of the paper: "


# texts
def _setting(value: Any) -> str:
    """Return a value of the settings."""
    if isinstance(value, (list, tuple)):
        names = (item["name"] if isinstance(item, Mapping) else str(item) for item in value)
        return ", ".join(names) or "none"
    return "none" if value is None else str(value)
