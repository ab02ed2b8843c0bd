"""The report of a benchmark: one page of HTML with its pictures inside, and the pictures alone.

Nothing here computes a result: it shows what ``twin.benchmark.runner`` collects. The page is
``report.html.jinja`` beside this file, and needs no network, no script and no font of its own.
"""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.benchmark.figures import (
    RunFigure,
    deck_figure,
    error_figure,
    prediction_figure,
    predictor_styles,
    track_figure,
    verdict_figure,
)
from twin.benchmark.figures.data import example_times, number_of, reference_of, run_label
from twin.benchmark.figures.runs import SHOWN_AHEAD
from twin.benchmark.figures.style import Styles, picture_bytes
from twin.benchmark.metrics import METRICS
from twin.benchmark.motion_scores import SHOWN_UNITS, median_scores, shown_motion
from twin.benchmark.verdict.summary import best_first, recorded_blocks, sentence_of
from twin.benchmark.verdict.tables import best_text, grouped, interval, number
from twin.parallel import results_of
from twin.predictors.registry import DEFAULT
from usv_kernel.files import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "write_report",
]

Row = Mapping[str, Any]

DRAWN_CASES_MAX = 8
"""Of more cases than these, the errors against the horizon are not drawn."""

CHANNEL_METRICS = ("coverage90", "mae", "crps")
"""Metrics with a table by channel and horizon."""


@dataclass
class Picture:
    """A picture with its file name and caption; ``svg`` is there once it is drawn."""

    draw: Callable[[], Figure | None]
    name: str
    caption: str
    svg: bytes = b""

    @property
    def source(self) -> str:
        """The picture as the source of an HTML image."""
        return f"data:image/svg+xml;base64,{base64.b64encode(self.svg).decode()}"


@dataclass
class Pictures:
    """The pictures of a report: asked for one by one, then drawn together."""

    styles: Styles
    all: list[Picture] = field(default_factory=list)

    def add(self, draw: Callable[[], Figure | None], name: str, caption: str) -> Picture:
        """Return a picture that :meth:`write` will draw."""
        self.all.append(Picture(draw, name, caption))
        return self.all[-1]

    def write(
        self, folder: Path, drawn: Callable[[str], None] | None, jobs: int, pdf: bool
    ) -> list[Path]:
        """Draw all pictures and write each to its file; return the SVG files."""
        files: dict[int, dict[str, bytes]] = {}
        kinds = ("svg", "pdf") if pdf else ("svg",)
        calls = [partial(_drawn, picture.draw, kinds) for picture in self.all]
        for k, found in results_of(calls, jobs=jobs):
            files[k] = found
            if drawn:
                drawn(self.all[k].name)
        written: list[Path] = []
        for k, picture in enumerate(self.all):
            stem = re.sub(r"[^A-Za-z0-9.-]+", "_", picture.name).strip("._") or "picture"
            if folder / f"{stem}.svg" in written:
                stem = f"{stem}_{k}"
            for kind, data in files[k].items():
                write_whole(folder / f"{stem}.{kind}", data)
            if files[k]:
                picture.svg = files[k]["svg"]
                written.append(folder / f"{stem}.svg")
        return written


def _drawn(draw: Callable[[], Figure | None], kinds: Sequence[str]) -> dict[str, bytes]:
    """Return the files of a picture by their kind; none where there is nothing to draw."""
    figure = draw()
    return {} if figure is None else {kind: picture_bytes(figure, kind) for kind in kinds}


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

    ``results`` is the content of ``results.json``; parts of it may be missing. ``drawn`` is called
    with the file name of each picture. ``jobs`` processes draw; the files do not depend on their
    number. ``pdf`` writes each picture as PDF, too.
    """
    folder = Path(out) / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    for stale in folder.iterdir():
        if stale.suffix in (".png", ".svg", ".pdf"):
            stale.unlink()
    rows = [*results.get("rows", ()), *results.get("summary", ())]
    predictors = [row["predictor"] for row in rows]
    predictors += [name for run in runs for name in run.predictors]
    pictures = Pictures(predictor_styles(dict.fromkeys(predictors)))
    # a run with a loss stands at the top, of a zigzag if there is one
    first = min(runs, key=lambda run: (not run.lost, run.scenario != "zigzag"), default=None)
    sections = {
        **_verdict(results.get("verdict", ())),
        "recorded": {
            title: {name: block[name] for name in best_first(block)}
            for title, block in recorded_blocks(results).items()
        },
        "first": _first_pictures(results.get("verdict"), first, pictures),
        "command": results.get("command", ""),
        "notes": results.get("notes", ()),
        "faults": sorted({row["fault"] for row in rows} - {"none"}),
        "loss_ends": results.get("losses", ()),
        **_motion(results),
        "cases": _cases(results, pictures),
        "metrics": METRICS,
        "settings": {key: _text(value) for key, value in results.get("settings", {}).items()},
        "version": results.get("version", ""),
        "tuning": {name: item["tuning"] for name, item in results.get("predictors", {}).items()},
        "runs": [_run(run, pictures, run is first) for run in runs],
    }
    written = pictures.write(folder, drawn, jobs, pdf)
    report = Path(out) / "report.html"
    write_whole(report, _page(sections).encode())
    return [report, *written]


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
        "title_of": lambda metric: METRICS[metric][0],
    }
    return environment.get_template("report.html.jinja").render(**sections)


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


def _cases(results: Row, pictures: Pictures) -> list[dict[str, Any]]:
    """Return tables, and a picture of the errors, for each scenario and case."""
    parts = {
        part: grouped(results.get(part, ()), "scenario", "case")
        for part in ("summary", "rows", "paired", "channels")
    }
    cases = []
    for key in parts["summary"]:
        summary, rows, paired, channels = (groups.get(key, []) for groups in parts.values())
        scenario, case = key
        title = f"{scenario}, {case}" if case != "none" else f"{scenario}, no fault"
        there = {row["metric"] for row in summary}
        metrics = [metric for metric in METRICS if metric in there]
        picture = None
        if len(parts["summary"]) <= DRAWN_CASES_MAX:
            caption = (
                "Error growth: mean absolute error of position and heading against the horizon, "
                "mean over seeds, with the first plan. A curve that leaves the picture is counted "
                "in full by the table."
            )
            draw = partial(error_figure, title, rows, pictures.styles)
            picture = pictures.add(draw, f"{scenario}_{case}_error", caption)
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
                "picture": picture,
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
        caption = (
            "Mean absolute errors after 10 s, with 95 % bootstrap intervals over boats. The table "
            "has the numbers of bars that are cut. oracle is the true ship in the mean wind."
        )
        draw = partial(verdict_figure, verdict, pictures.styles)
        shown.append(pictures.add(draw, "verdict", caption))
    return shown if run is None else [*shown, _track(run, pictures)]


def _stem(run: RunFigure) -> str:
    """Return how the names of the pictures of a run begin."""
    return f"{run.scenario}_{run.fault}_seed{run.seed}"


def _compared(run: RunFigure) -> str:
    """Return what the predictions of a run are compared with."""
    known = reference_of(run.log).is_truth
    return "truth" if known else "measurements (the truth is unknown)"


def _track(run: RunFigure, pictures: Pictures) -> Picture:
    """Return the picture of the track of one run."""
    caption = (
        f"{run_label(run)}: track, and predicted tracks over 10 s from each example (numbered). "
        f"Axes follow the {_compared(run)}; a prediction may leave them."
    ) + ("" if run.log.datum is None else f" Origin: {run.log.datum}.")
    draw = partial(track_figure, run, pictures.styles)
    return pictures.add(draw, f"{_stem(run)}_track", caption[0].upper() + caption[1:])


def _run(run: RunFigure, pictures: Pictures, track_shown: bool) -> dict[str, Any]:
    """Return the pictures of one run; its track may stand at the top of the page."""
    reference, styles = reference_of(run.log), pictures.styles
    shown = [] if track_shown else [_track(run, pictures)]
    for k, start in enumerate(example_times(run), 1):
        caption = (
            f"10 s motion prediction against the {_compared(run)}, made at "
            f"t = {round(start, 1):g} s. Curves may leave their panel."
        )
        draw = partial(prediction_figure, run, start, styles, reference)
        shown.append(pictures.add(draw, f"{_stem(run)}_prediction{k}", caption))
    decked = [name for name, figure in run.predictors.items() if figure.deck is not None]
    if decked:
        name = DEFAULT if DEFAULT in decked else decked[0]
        caption = (
            f"Roll, pitch, heave and the vertical speed of the deck point, and what the twin "
            f"with {name} forecast {SHOWN_AHEAD:g} s before."
        )
        shown.append(pictures.add(partial(deck_figure, run, name), f"{_stem(run)}_deck", caption))
    return {"title": run_label(run), "pictures": shown}
