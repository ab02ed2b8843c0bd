"""The report: complete, self-contained, and robust to absurd or missing numbers."""

import math
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from html.parser import HTMLParser

import numpy as np
import pytest

from twin import PREDICTORS
from twin.benchmark.figures.data import RunFigure, reference_of
from twin.benchmark.figures.results import growth_figure, verdict_figure
from twin.benchmark.figures.runs import panel_limits
from twin.benchmark.figures.style import predictor_styles
from twin.benchmark.report import write_report
from twin.channels import MEASUREMENTS
from twin.logs.log import Log
from twin.predictors.base import Prediction


def sail(name="run", truth=True, rows=400):
    t = 0.05 * np.arange(rows)
    psi = 0.2 * t
    true = np.stack(
        [20 * np.sin(psi), 20 * (1 - np.cos(psi)), psi, 4 + 0 * t, 0 * t, 0.2 + 0 * t], 1
    )
    z = np.full((rows, len(MEASUREMENTS)), math.nan)
    z[::4, :2] = true[::4, :2]
    z[::4, 2], z[::4, 3] = 4 * np.cos(psi[::4]), 4 * np.sin(psi[::4])
    z[:, 4] = (psi + math.pi) % (2 * math.pi) - math.pi
    cmd = np.tile([20.0, 20.0, 0.3, 0.3], (rows, 1))
    return Log(t, z, cmd, true if truth else None, name)


def predicted(t0, factor=1.0):
    after = 0.25 * np.arange(1, 41)
    psi = 0.2 * t0
    start = np.array([20 * math.sin(psi), 20 * (1 - math.cos(psi)), psi, 4, 0, 0.2])
    mean = start + factor * np.outer(after, [1.0, 1.0, 0.1, 0.01, 0.01, 0.01])
    return Prediction(
        t0, start, np.zeros((6, 6)), t0 + after, mean, np.eye(6) * np.ones((40, 1, 1))
    )


def figure(factor=1.0, origins=(5.0, 8.0)):
    return [predicted(origin, factor) for origin in origins]


def results(names=("persistence", "ukf"), **more):
    here = {"scenario": "turn", "case": "gps10", "fault": "gps10", "plan": "known"}
    summary = [
        {**here, "predictor": name, "metric": metric, "value": value, "low": None, "high": None}
        for k, name in enumerate(names)
        for metric, value in (("mae", 2.5 - k), ("skill", -3.25 * k))
    ]
    settings = {"identify_s": 5.0, "logs": ()}
    found = {"version": "1", "command": "usv-twin benchmark", "settings": settings}
    return {**found, "summary": summary, **more}


def run(log, predictors, lost=()):
    return RunFigure("turn", "gps10", 0, log, list(lost), predictors)


def page(files):
    return files[0].read_text(encoding="utf-8")


class Nesting(HTMLParser):
    """Checks that every element is closed where it was opened."""

    def __init__(self):
        super().__init__()
        self.open = []

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "br", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return a report with every kind of picture and table, of many predictors and long names."""
    log = sail()
    names = [*PREDICTORS, "an-own-predictor"]
    every = {name: figure() for name in names}
    named = "a-recorded-run-of-a-boat_with_a_long_name"
    runs = [
        run(log, every, [(7.0, 12.0)]),
        RunFigure("zigzag", "none", 0, log, [], {"ukf": figure(origins=(8.0,))}),
        RunFigure(named, "gps30", 12, sail(truth=False), [], {"ukf": figure()}),
    ]
    here = {"scenario": "turn", "case": "gps10", "predictor": "ukf", "plan": "hold"}
    verdict = [
        {"predictor": name, "loss": loss, "cases": ["gps10"], "position_m": k, "heading_deg": k}
        | {"ratio": k, "ratio_low": k - 0.5, "ratio_high": k + 0.5, "mae": k, "mse": k}
        | {"next": None, "wins": 0, "runs": 4}
        for k, name in enumerate(names, 1)
        for loss in ("none", "any", "all")
    ]
    recorded = [
        {"folder": "lake", "fault": "none", "plan": "known", "channel": channel, "runs": 3}
        | {"predictor": name, "error": 1.0, "ratio": ratio, "low": 0.25, "high": 4.5}
        for name, ratio in (("persistence", 1.0), ("ukf", 0.5))
        for channel in ("displacement", "psi")
    ]
    loss = {"folder": "lake", "scenario": "", "case": "gps10", "fault": "gps10", "losses": 4}
    loss |= {"predictor": "ukf", "error_m": 2.0, "worst_m": 4.0, "said_m": 3.0, "held": 0.75}
    pair = {"against": "persistence", "change_percent": -12.34, "median_percent": -9.0}
    pair |= {"low": -20.0, "high": -3.0, "wins": 5, "seeds": 6}
    channels = [
        {**here, "channel": c, "horizon_s": h, "coverage90": 0.9 - 0.01 * h, "mae": h}
        for c in ("u", "displacement", "psi")
        for h in (1.0, 10.0)
    ]
    motion = [
        {**here, "seed": k, "channel": "roll", "horizon_s": h, "sd": 0.1, "held": 1.5}
        | {"skill": 0.125 * h + 0.01 * k, "coverage90": 0.885, "rmse": 0.0125 * h, "crps": 0.007}
        for k in range(3)
        for h in (1.0, 2.0)
    ]
    quiet = {**here, "span_s": 2.0, "base_rate": 0.375, "auc": None, "auc_now": 0.6875}
    quiet |= {"brier": 0.125, "brier_skill": -0.25}
    found = results(
        names,
        verdict=verdict,
        recorded=recorded,
        losses=[loss],
        paired=[here | pair],
        channels=channels,
        motion=motion,
        quiet=[quiet],
        predictors={"ukf": {"tuning": "60 tries"}},
    )
    found["summary"][0] |= {"low": 1.25, "high": 3.75}
    return write_report(tmp_path_factory.mktemp("report"), found, runs)


def test_report_is_complete_and_self_contained(whole):
    report, *pictures = whole
    base = "turn_gps10_seed0_"
    stems = {path.stem for path in pictures}
    assert {"verdict", "turn_gps10_error", base + "track", base + "prediction1"} <= stems
    assert "zigzag_none_seed0_track" in stems
    assert len(set(pictures)) == 10
    for path in pictures:
        assert path.parent == report.parent / "pictures"
        assert ET.fromstring(path.read_text(encoding="utf-8")).tag.endswith("}svg")
    text = page(whole)
    assert text.count("<img ") == len(pictures)
    # nothing is fetched from anywhere
    assert not re.search(r"https?:|@import|<(script|link|iframe|object)|src=\"(?!data:)", text)
    parser = Nesting()
    parser.feed(text)
    assert parser.open == []


def test_tables_have_the_values(whole):
    text = re.sub(r"\s+", " ", re.sub(r"data:[^\"]*", "", page(whole)))
    cells = re.sub(r"> <", "><", text)
    for part in (
        "[1.25, 3.75]",  # an interval of the summary
        "<td>-12.3<br><small>[-20.0, -3.00]",  # the paired comparison
        "5 of 6",
        "0.890/0.800",  # coverage by horizon
        "0.500<br><small>[0.250, 4.50]",  # a recorded run over persistence
        "<td>75 %</td>",  # losses that were held
        "<td>deg</td>",  # roll in degrees, though the rows are in rad
        "0.135<br><small>1.50<br>88 %",  # median skill, held, coverage
        "<br>0.716<br>0.401",  # its error and CRPS
        "<td>2.0 s</td><td>0.375</td><td>-0.250</td><td>-</td><td>0.688</td>",
        "60 tries",
    ):
        assert part in cells, part


def test_the_best_value_is_bold(tmp_path):
    text = page(write_report(tmp_path, results(), []))
    assert "<b>1.50</b>" in text  # lowest MAE
    assert "<b>0</b>" in text  # highest skill
    assert "<b>2.50</b>" not in text


@pytest.mark.parametrize("value", [0.0, 1e-300, 1.0, 1.7e308, math.inf])
def test_pictures_of_absurd_errors_have_limits(value):
    verdict = [
        {"predictor": name, "loss": "none", "position_m": size, "heading_deg": 1.0}
        for name, size in (("persistence", 1.0), ("ukf", value))
    ]
    growth = [
        {"predictor": "ukf", "plan": "known", "channel": "psi", "horizon_s": h, "mae": size}
        for h, size in ((1.0, 0.1), (10.0, value))
    ]
    styles = predictor_styles(("persistence", "ukf"))
    for picture in (verdict_figure(verdict, styles), growth_figure("turn", growth, styles)):
        picture.draw_without_rendering()
        for ax in picture.axes:
            assert np.isfinite([*ax.get_xlim(), *ax.get_ylim()]).all()


def test_each_bar_has_its_number_beside_it_also_one_that_is_cut():
    sizes = {"persistence": 1.0, "mine": 25.0, "half": 0.5}
    verdict = [
        {"predictor": name, "loss": loss, "position_m": size, "heading_deg": size}
        for name, size in sizes.items()
        for loss in ("none", "any")
        if (name, loss) != ("half", "any")  # has not been scored there
    ]
    picture = verdict_figure(verdict, predictor_styles(sizes))
    picture.draw_without_rendering()
    for ax in picture.axes:
        shown = [text for text in ax.texts if text.get_text()]
        assert sorted(t.get_text() for t in shown) == ["0.500", "1.00", "1.00", "25.0", "25.0"]
        arrows = [line for line in ax.lines if line.get_marker() == ">"]
        assert len(arrows) == sum(float(t.get_text()) > ax.get_xlim()[1] for t in shown) == 2
        for text in shown:
            box = text.get_window_extent()
            assert picture.bbox.x0 <= box.x0 and box.x1 <= picture.bbox.x1
            end = ax.transData.transform((min(float(text.get_text()), ax.get_xlim()[1]), 0.0))[0]
            assert 0.0 < box.x0 - end < 20.0


@pytest.mark.parametrize("oracle", [False, True])
@pytest.mark.parametrize("high", [None, 1.1, 7.0])
def test_pictures_and_their_captions_say_what_is_drawn(tmp_path, oracle, high):
    """An interval that leaves the axis ends in an arrow; what is not drawn is not named."""
    names = ("persistence", "ukf", *(("oracle",) if oracle else ()))
    rows = [
        {"predictor": name, "loss": loss, "cases": ["none"], "plan": "known", "scenarios": ["turn"]}
        | {f"{panel}{end}": v for panel in ("position_m", "heading_deg") for end, v in ends.items()}
        | {"ratio": None, "mae": 1.0, "mse": 1.0, "next": None, "wins": 0, "runs": 4}
        for name in names
        for loss in ("none", "all")
        for ends in [{"": 1.0} | ({"_low": 0.5, "_high": high} if high and name == "ukf" else {})]
    ]
    picture = verdict_figure(rows, predictor_styles(names))
    far = high is not None and high > 1.2
    for ax in picture.axes:
        assert [line.get_xdata()[0] for line in ax.lines if line.get_marker() == ">"] == [1.2] * far
        assert [text.get_text() for text in ax.texts][1] == "1.00" + " (to 7.00)" * far
    text = page(write_report(tmp_path, results(names, verdict=rows), []))
    assert (text.count("95 % bootstrap intervals") > 0) == (high is not None)
    assert ("oracle is the true ship" in text) == oracle


@pytest.mark.parametrize("factor", [1e300, math.inf])
def test_absurd_predictions_do_not_stop_it(tmp_path, factor):
    with np.errstate(all="ignore"):
        predictors = {"ukf": figure(origins=(5.0,)), "dsw-ukf": figure(factor, origins=(5.0,))}
    files = write_report(tmp_path, results(), [run(sail(), predictors)])
    assert len(files) == 1 + 2


def test_absurd_predictions_do_not_squash_the_truth():
    truth = np.linspace(0.0, 10.0, 50)
    low, high = panel_limits(truth, [np.linspace(0.0, 1e9, 50)], 1.0)
    assert -2.0 < low < 0.0
    assert 10.0 < high < 25.0


def test_same_input_gives_same_bytes(tmp_path):
    runs = [run(sail(), {"ukf": figure(origins=(8.0,))})]
    first, second = (
        write_report(tmp_path / name, results(), runs, pdf=True) for name in ("one", "two")
    )
    assert [p.read_bytes() for p in first] == [p.read_bytes() for p in second]
    for one, other in zip(first[1:], second[1:], strict=True):
        pdf = one.with_suffix(".pdf").read_bytes()
        assert pdf.startswith(b"%PDF") and pdf == other.with_suffix(".pdf").read_bytes()


def test_text_is_escaped(tmp_path):
    log = sail("<b>$x^$</b>")
    marked_up = RunFigure("<i>$_$", "no&ne", 0, log, [], {"<u>$^$": figure(origins=())})
    found = results(("<u>$^$",), command="usv-twin <script>", notes=["lstm <left> out"])
    files = write_report(tmp_path, found, [marked_up])
    text = page(files)
    assert "&lt;script&gt;" in text
    assert "lstm &lt;left&gt; out" in text
    assert not re.search(r"<(script|left|i|u)>", text)
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+", path.name) for path in files)


def test_missing_values_are_dashes(tmp_path):
    found = results()
    for row in found["summary"]:
        row["value"] = math.nan if row["metric"] == "mae" else None
    files = write_report(tmp_path, found, [])
    assert page(files).count("<td>-</td>") == 4
    assert len(files) == 1


@pytest.mark.parametrize("found", [{}, {"rows": [], "summary": [], "settings": {}, "command": "x"}])
def test_a_report_of_nothing_says_so(tmp_path, found):
    files = write_report(tmp_path / "new", found, [])
    assert len(files) == 1
    assert "nothing to show" in page(files)


def test_recorded_run_without_truth():
    seen = reference_of(sail(truth=False))
    assert not seen.is_truth
    # surge speed from GPS and compass, yaw rate from the compass since there is no gyro
    np.testing.assert_allclose(seen.v[3], 4.0, atol=1e-9)
    np.testing.assert_allclose(seen.v[5], 0.2, atol=1e-9)


def test_pictures_that_are_left_out_are_named(tmp_path):
    here = {"plan": "known", "predictor": "ukf", "metric": "mae", "value": 1.0}
    cases = [{**here, "scenario": "turn", "case": f"gps{k}", "fault": "none"} for k in range(9)]
    channels = [
        {**row, "channel": "psi", "horizon_s": h, "mae": h} for row in cases for h in (1.0, 10.0)
    ]
    found = results(channels=channels) | {"summary": cases}
    files = write_report(tmp_path, found, [])
    assert len([file for file in files if file.suffix == ".svg"]) == 8
    assert "of the first 8 of 9 runs" in page(files)
    (tmp_path / "pictures" / "own.txt").write_text("mine")
    files = write_report(tmp_path, found, None)
    assert len(files) == 1 and "<img" not in page(files)
    # those of an earlier report would contradict its numbers; what is not its own stays
    assert [path.name for path in (tmp_path / "pictures").iterdir()] == ["own.txt"]
    (tmp_path / "pictures" / "own.txt").unlink()
    write_report(tmp_path, found, None)
    assert not (tmp_path / "pictures").exists()


def test_a_report_on_own_logs_says_nothing_of_simulated_boats(tmp_path):
    settings = {"scenarios": (), "seeds": (0,), "vessel": "usv75", "hs": 0.5, "logs": ("a.csv",)}
    own = RunFigure("a", "none", None, sail(truth=False), [], {"ukf": figure()})
    text = page(write_report(tmp_path, results() | {"settings": settings}, [own]))
    assert "a.csv" in text and not re.search("usv75|seed|boats|oracle", text)
    assert "<b>MAE</b>" in text and "<b>E</b>" not in text  # only what a table has is explained
    assert (tmp_path / "pictures" / "a_none_track.svg").exists()


def test_a_predictor_may_lack_what_others_have(tmp_path):
    predictors = {"lstm": [], "ukf": figure(origins=(8.0,))}
    files = write_report(tmp_path, results(), [run(sail(), predictors)])
    stems = {path.stem.removeprefix("turn_gps10_") for path in files[1:]}
    assert stems == {"seed0_track", "seed0_prediction1"}


def test_equal_names_do_not_overwrite_each_other(tmp_path):
    runs = [run(sail(), {"ukf": figure(origins=())}) for _ in range(2)]
    files = write_report(tmp_path, results(), runs)
    assert len(set(files)) == len(files) == 3


def test_matplotlib_is_imported_late_and_without_pyplot():
    code = (
        "import sys, twin.benchmark.report\n"
        "from twin.benchmark.figures.results import verdict_figure\n"
        "assert 'matplotlib' not in sys.modules\n"
        "row = dict(predictor='ukf', loss='none', position_m=1.0, heading_deg=1.0)\n"
        "verdict_figure([row], {'ukf': ('#000000', '-')})\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
