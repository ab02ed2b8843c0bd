"""The report of a benchmark: one page of HTML with its pictures inside, and the pictures alone.

Nothing here computes a result: it shows what ``twin.benchmark.runner`` collects. The page is
``report.html.jinja`` beside this file, and needs no network, no script and no font of its own.
"""

from __future__ import annotations

import base64
import contextlib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.benchmark.figures.data import RunFigure, example_times, reference_of
from twin.benchmark.figures.results import growth_figure, has_intervals, verdict_figure
from twin.benchmark.figures.runs import prediction_figure, track_figure
from twin.benchmark.figures.style import Styles, picture_bytes, predictor_styles
from twin.benchmark.metrics import METRICS, ORACLE, grouped
from twin.benchmark.motion_scores import SHOWN_UNITS, median_scores, shown_motion
from twin.benchmark.verdict.summary import best_first, recorded_blocks, sentence_of
from twin.benchmark.verdict.tables import best_text, interval, is_best, number, number_of
from usv_kernel.files import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["write_report"]

Row = Mapping[str, Any]

DRAWN_CASES_MAX = 8
"""Of more cases, the errors against the horizon are drawn of the first, and a note says so."""

OF_SIMULATION = (
    *("scenarios", "cases", "seeds", "vessel", "spread", "dof", "hs", "wind", "wind_from_deg"),
    *("schedule", "spreading", "identify_s", "duration_s"),
)
"""Settings that say nothing of recorded runs."""

CHANNEL_METRICS = ("coverage90", "mae", "crps")
"""Metrics with a table by channel and horizon."""


@dataclass(frozen=True)
class Picture:
    """A picture of the page: SVG in the source of an HTML image, and its caption."""

    source: str
    caption: str


class Pictures:
    """Writes the pictures of a report to files of a folder, as PDF, too, if asked for."""

    def __init__(self, folder: Path, styles: Styles, pdf: bool) -> None:
        self.folder, self.styles, self.pdf = folder, styles, pdf
        self.files: list[Path] = []

    def add(self, figure: Figure, name: str, caption: str) -> Picture:
        """Write a picture; other characters than letters, digits, . and - of its name are _."""
        stem = re.sub(r"[^A-Za-z0-9.-]+", "_", name).strip("._") or "picture"
        if self.folder / f"{stem}.svg" in self.files:
            stem = f"{stem}_{len(self.files)}"
        if self.pdf:
            write_whole(self.folder / f"{stem}.pdf", picture_bytes(figure, "pdf"))
        svg = picture_bytes(figure, "svg")
        self.files.append(self.folder / f"{stem}.svg")
        write_whole(self.files[-1], svg)
        return Picture(f"data:image/svg+xml;base64,{base64.b64encode(svg).decode()}", caption)


def write_report(
    out: Path, results: dict[str, Any], runs: list[RunFigure] | None, *, pdf: bool = False
) -> list[Path]:
    """Write ``report.html`` and ``pictures/*.svg``; return what was written, the report first.

    ``results`` is the content of ``results.json``; parts of it may be missing. ``pdf`` writes each
    picture as PDF, too. Without ``runs`` there are no pictures at all, not even earlier ones.
    """
    folder = Path(out) / "pictures"
    for stale in folder.glob("*"):
        if stale.suffix in (".png", ".svg", ".pdf"):
            stale.unlink()
    with contextlib.suppress(OSError):  # of a user's files
        folder.rmdir()
    rows = [*results.get("rows", ()), *results.get("summary", ())]
    predictors = [row["predictor"] for row in rows]
    scored = {row["metric"] for row in results.get("summary", ())}
    drawn, runs = runs is not None, runs or []
    predictors += [name for run in runs for name in run.examples]
    pictures = Pictures(folder, predictor_styles(dict.fromkeys(predictors)), pdf)
    # a run with a loss stands at the top, of a zigzag if there is one
    first = min(runs, key=lambda run: (not run.lost, run.scenario != "zigzag"), default=None)
    sections = {
        **_verdict(results.get("verdict", ())),
        "recorded": {
            title: {name: block[name] for name in best_first(block)}
            for title, block in recorded_blocks(results).items()
        },
        "first": _first_pictures(results.get("verdict"), first, pictures) if drawn else [],
        "command": results.get("command", ""),
        "notes": [*results.get("notes", ()), *_not_drawn(results)],
        "faults": sorted({row["fault"] for row in rows} - {"none"}),
        "loss_ends": results.get("losses", ()),
        **_motion(results),
        "cases": _cases(results, pictures, DRAWN_CASES_MAX if drawn else 0),
        "metrics": {name: METRICS[name] for name in METRICS if name in scored},
        "settings": _settings(results.get("settings", {})),
        "version": results.get("version", ""),
        "tuning": {name: item["tuning"] for name, item in results.get("predictors", {}).items()},
        "runs": [_run(run, pictures, run is first) for run in runs],
    }
    report = Path(out) / "report.html"
    write_whole(report, _page(sections).encode())
    return [report, *pictures.files]


def _page(sections: Mapping[str, Any]) -> str:
    """Return the page."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("twin.benchmark", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "number": number,
        "interval": interval,
        "is_best": is_best,
        "title_of": lambda metric: METRICS[metric][0],
    }
    return environment.get_template("report.html.jinja").render(**sections)


def _not_drawn(results: Row) -> list[str]:
    """Return a note where pictures of the errors against the horizon are left out."""
    count = len(grouped(results.get("summary", ()), "scenario", "case"))
    note = (
        f"The errors against the horizon are drawn of the first {DRAWN_CASES_MAX} of {count} runs "
        "and losses; name fewer scenarios, faults or logs to see others."
    )
    return [note] if count > DRAWN_CASES_MAX else []


def _settings(settings: Row) -> dict[str, str]:
    """Return the settings that say something of the runs."""
    left_out = () if settings.get("scenarios", True) else OF_SIMULATION
    return {key: _text(value) for key, value in settings.items() if key not in left_out}


def _text(value: Any) -> str:
    """Return a value of the settings."""
    if isinstance(value, (list, tuple)):
        names = (item["name"] if isinstance(item, Mapping) else str(item) for item in value)
        return ", ".join(names) or "none"
    return "none" if value is None else str(value)


# tables
def _verdict(rows: Sequence[Row]) -> dict[str, Any]:
    """Return what is said first of simulated runs."""
    lost = sorted({case for row in rows if row["loss"] == "any" for case in row["cases"]})
    names = {"none": "no loss", "any": ", ".join(lost)}
    losses = [loss for loss in names if any(row["loss"] == loss for row in rows)]
    titles = ("position (m)", "heading (deg)", "ratio to persistence")
    return {
        "sentence": sentence_of(rows),
        "verdict": {
            name: {row["loss"]: row for row in block}
            for (name,), block in grouped(rows, "predictor").items()
        },
        "losses": losses,
        "intervals": has_intervals(rows),
        "verdict_heads": [
            *(f"{title}, {names[loss]}" for title in titles for loss in losses),
            "MAE",
            "MSE",
        ],
    }


def _motion(results: Row) -> dict[str, Any]:
    """Return what the forecasts of roll, pitch, heave and a quiet deck were worth."""
    rows = shown_motion(results)
    horizons = sorted({row["horizon_s"] for row in rows["motion"]})
    lines = []
    for where, block in grouped(rows["motion"], "scenario", "plan", "channel").items():
        unit, factor = SHOWN_UNITS[where[-1]]
        medians = [median_scores(block, horizon) for horizon in horizons]
        lines.append({"where": (*where, unit), "factor": factor, "medians": medians})
    return {
        "motion": lines,
        "motion_by": rows["motion"][0]["predictor"] if lines else "",
        "motion_heads": [f"{horizon:g} s" for horizon in horizons],
        "quiet": rows["quiet"],
    }


def _cases(results: Row, pictures: Pictures, drawn: int) -> list[dict[str, Any]]:
    """Return tables for each scenario and case, and a picture of the errors for so many."""
    parts = {
        part: grouped(results.get(part, ()), "scenario", "case")
        for part in ("summary", "paired", "channels")
    }
    cases: list[dict[str, Any]] = []
    for key in parts["summary"]:
        summary, paired, channels = (groups.get(key, []) for groups in parts.values())
        scenario, case = key
        title = f"{scenario}, {case}" if case != "none" else f"{scenario}, no fault"
        there = {row["metric"] for row in summary}
        metrics = [metric for metric in METRICS if metric in there]
        few = len(cases) < drawn
        figure = growth_figure(title, channels, pictures.styles) if few else None
        caption = "Mean absolute error against the horizon, mean over runs, with the first plan."
        cases.append(
            {
                "title": title,
                "metrics": metrics,
                "summary": {
                    names: {row["metric"]: row for row in block}
                    for names, block in grouped(summary, "predictor", "plan").items()
                },
                "best": {
                    metric: best_text(metric, [row for row in summary if row["metric"] == metric])
                    for metric in metrics
                },
                "paired": paired,
                "channel_names": list(dict.fromkeys(row["channel"] for row in channels)),
                "channels": {metric: _by_channel(metric, channels) for metric in CHANNEL_METRICS}
                if channels
                else {},
                "pictures": [pictures.add(figure, f"{scenario}_{case}_error", caption)]
                if figure
                else [],
            }
        )
    return cases


def _by_channel(metric: str, rows: Sequence[Row]) -> dict[tuple[str, str], dict[str, list[float]]]:
    """Return a metric at each horizon, by (predictor, plan) and channel."""
    lines: dict[tuple[str, str], dict[str, list[float]]] = {}
    for row in rows:
        if not math.isnan(value := number_of(row, metric)):
            line = lines.setdefault((row["predictor"], row["plan"]), {})
            line.setdefault(row["channel"], []).append(value)
    return lines


# pictures
def _first_pictures(
    verdict: Sequence[Row] | None, run: RunFigure | None, pictures: Pictures
) -> list[Picture]:
    """Return the bars and the track at the top of the page."""
    shown = []
    if verdict:
        drawn = ", with 95 % bootstrap intervals over boats" if has_intervals(verdict) else ""
        caption = f"Mean absolute errors after 10 s{drawn}; what ends in an arrow is longer."
        if any(row["predictor"] == ORACLE for row in verdict):
            caption += " oracle is the true ship in the mean wind."
        figure = verdict_figure(verdict, pictures.styles)
        shown.append(pictures.add(figure, "verdict", caption))
    return shown if run is None else [*shown, _track(run, pictures)]


def _track(run: RunFigure, pictures: Pictures) -> Picture:
    """Return the picture of the track of one run."""
    caption = (
        f"Track of {run.label}, and predicted tracks over 10 s from each example (numbered). "
        "Axes follow the run; a prediction may leave them."
    ) + ("" if run.log.datum is None else f" Origin: {run.log.datum}.")
    figure = track_figure(run, pictures.styles)
    return pictures.add(figure, f"{run.name}_track", caption)


def _run(run: RunFigure, pictures: Pictures, track_shown: bool) -> dict[str, Any]:
    """Return the pictures of one run; its track may stand at the top of the page."""
    reference = reference_of(run.log)
    shown = [] if track_shown else [_track(run, pictures)]
    for k, start in enumerate(example_times(run), 1):
        caption = (
            f"10 s motion prediction, made at t = {round(start, 1):g} s. Curves may leave their "
            "panel. Measurements stand for a truth that is not known."
        )
        figure = prediction_figure(run, start, pictures.styles, reference)
        shown.append(pictures.add(figure, f"{run.name}_prediction{k}", caption))
    return {"title": run.label, "pictures": shown}
