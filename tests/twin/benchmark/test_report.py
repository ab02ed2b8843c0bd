"""The report: complete, self-contained, and robust to absurd or missing numbers."""

import dataclasses
import math
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from html.parser import HTMLParser

import numpy as np
import pytest

from twin import PREDICTORS
from twin.benchmark import figures
from twin.benchmark.figures import PredictorFigure, RunFigure, picture_of_log, predictor_styles
from twin.benchmark.figures.data import reference_of
from twin.benchmark.figures.errors import headline
from twin.benchmark.figures.history import interval_widths, panel_limits
from twin.benchmark.figures.style import STYLES
from twin.benchmark.report import write_report
from twin.channels import MEASUREMENTS
from twin.logs.log import Log
from twin.model.structure import structure_of
from twin.predictors.base import Z90, Prediction

PNG = b"\x89PNG\r\n\x1a\n"
MODEL = structure_of("paper", 6.3, 5.4, 20.0)


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


def predicted(log, t0, factor=1.0):
    row = round(t0 / 0.05)
    psi = log.t[row]
    after = 0.25 * np.arange(1, 41)
    start = np.array(
        [20 * math.sin(0.2 * psi), 20 * (1 - math.cos(0.2 * psi)), 0.2 * psi, 4, 0, 0.2]
    )
    mean = start + factor * np.outer(after, [1.0, 1.0, 0.1, 0.01, 0.01, 0.01])
    cov = np.eye(6) * after[:, None, None]
    return Prediction(t0, start, np.zeros((6, 6)), t0 + after, mean, cov)


def figure(log, factor=1.0, model=1, origins=(5.0, 8.0)):
    """Return what a predictor leaves; ``model``: so many parameters of each motion at most."""
    t, examples = np.arange(20.0), [predicted(log, o, factor) for o in origins]
    kept, blocks = [], {}
    for motion, (first, last) in MODEL.blocks.items():
        blocks[motion] = (len(kept), len(kept) + min(model, last - first))
        kept += range(first, last)[:model]
    xi = np.outer(t, np.linspace(1e-6, 1.0, len(MODEL)))[:, kept] * factor
    names, units = (tuple(part[k] for k in kept) for part in (MODEL.parameters, MODEL.units))
    return PredictorFigure(examples, t, xi, 0.1 * np.abs(xi), names, units, blocks if kept else {})


def results(predictors=("persistence", "ukf"), **more):
    rows, summary = [], []
    for k, name in enumerate(predictors):
        here = {"scenario": "turn", "fault": "gps10", "predictor": name, "plan": "known"}
        rows += [
            {**here, "seed": 0, "channel": c, "horizon_s": h, "mae": h / (k + 1), "mse": h, "n": 3}
            for c in ("u", "along", "across", "psi")
            for h in (1.0, 10.0)
        ]
        for metric, value in (("mae", 2.5 - k), ("skill", -3.25 * k)):
            summary.append(
                {**here, "metric": metric, "value": value, "low": value - 1, "high": None}
            )
    settings = {"identify_s": 5.0, "logs": ()}
    found = {"version": "1", "command": "usv-twin benchmark", "settings": settings}
    return {**found, "rows": rows, "summary": summary, **more}


def run(log, predictors, lost=()):
    return RunFigure("turn", "gps10", 0, log, list(lost), predictors)


def page(files):
    return files[0].read_text(encoding="utf-8")


def test_report_is_complete_and_self_contained(tmp_path):
    log = sail()
    predictors = {"persistence": figure(log, model=0), "ukf": figure(log)}
    files = write_report(tmp_path, results(), [run(log, predictors, [(7.0, 12.0)])])
    assert files[0] == tmp_path / "report.html"
    stems = {path.stem for path in files[1:]}
    base = "turn_gps10_seed0_"
    ends = ("track", "prediction1", "prediction2", "ukf_surge", "ukf_sway", "ukf_yaw")
    assert stems == {"turn_gps10_error"} | {base + end for end in ends}
    assert all(path.parent == tmp_path / "pictures" for path in files[1:])
    for path in files[1:]:
        assert ET.fromstring(path.read_text(encoding="utf-8")).tag.endswith("}svg")
    text = page(files)
    assert text.count("<svg ") == text.count('aria-label="') == len(files) - 1
    assert 'name="viewport" content="width=device-width' in text
    # nothing to be fetched from anywhere, and every reference leads somewhere, to one place
    assert not re.search(r"https?:|@import|<(script|link|img|iframe|object)|\bsrc=", text)
    targets = re.findall(r'href="([^"]*)"', text) + re.findall(r"url\(([^)]*)\)", text)
    names = re.findall(r'\bid="([^"]*)"', text)
    assert {target[1:] for target in targets} == set(names)
    assert len(names) == len(set(names))


class Nesting(HTMLParser):
    """Checks that every element is closed where it was opened."""

    def __init__(self):
        super().__init__()
        self.open = []

    def handle_starttag(self, tag, attrs):
        assert len(dict(attrs)) == len(attrs), (tag, attrs)
        if tag not in ("meta", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return a report with every kind of picture, of many predictors and long names."""
    log = sail()
    names = [*PREDICTORS, "an-own-predictor", "dsw-ukf"]
    every = {n: figure(log, model=len(MODEL) if n in ("ukf", "dsw-ukf") else 0) for n in names}
    one = {"ukf": figure(log, origins=(8.0,))}
    runs = [
        run(log, every, [(7.0, 12.0)]),
        RunFigure("zigzag", "none", 0, log, [], one),
        RunFigure(
            "a-recorded-run-of-a-boat_with_a_long_name", "gps30", 12, log, [], {"ukf": every["var"]}
        ),
    ]
    trends = [
        {"axis": axis, "predictor": name, "metric": metric, "at": at, "value": 1.0 + at}
        | {"low": 0.9 + at, "high": 1.2 + at}
        for name in names
        for axis, (_, _, panels) in figures.TRENDS.items()
        for metric in panels
        for at in (0.0, 10.0, 30.0)
    ]
    return write_report(tmp_path_factory.mktemp("report"), results(names, trends=trends), runs)


def test_page_is_well_formed(whole):
    parser = Nesting()
    parser.feed(page(whole))
    assert parser.open == []


def test_pictures_name_those_of_the_paper(whole):
    text = page(whole)
    assert "Turn, fault gps10, seed 0: compare the paper&#39;s Figures 9-12<" in text
    assert "Zigzag, no fault, seed 0: compare the paper&#39;s Figures 13-16<" in text
    captions = re.findall(r"<figcaption>Compare Figure (\d+) of the paper", text)
    # two predictions, then surge, sway and yaw by two predictors; one of each
    assert captions == ["12"] * 2 + ["9", "10", "11"] * 2 + ["16", "13", "14", "15"]
    # the paper's own method first, and not folded away
    shown = re.findall(r"<details( open)?><summary>Parameters by ([\w-]+)", text)
    assert shown[:2] == [(" open", "dsw-ukf"), ("", "ukf")]


@pytest.mark.slow
def test_long_runs_make_a_small_page(tmp_path):
    rng = np.random.default_rng(0)
    log = sail(rows=2400)
    log = dataclasses.replace(log, z=log.z + rng.normal(0.0, 0.5, log.z.shape))
    made = figure(log, model=len(MODEL))
    t = 0.5 * np.arange(240)
    # parameters that walk through the whole panel all the time are worse than real ones
    xi = rng.normal(size=(240, len(MODEL))).cumsum(axis=0)
    made = dataclasses.replace(made, t=t, params=xi, params_sd=1.0 + 0.0 * xi)
    files = write_report(tmp_path, results(), [run(log, {"ukf": made, "dsw-ukf": made})])
    assert files[0].stat().st_size < 400_000


def test_every_axis_has_its_unit():
    log = sail()
    several = run(log, {"ukf": figure(log, model=3), "dsw-ukf": figure(log)}, [(7.0, 12.0)])
    styles = predictor_styles(several.predictors)
    seen = reference_of(log)
    found = results()
    trend = [
        {"axis": axis, "predictor": "ukf", "metric": metric, "at": at, "value": 1.0 + at}
        for axis, (_, _, panels) in figures.TRENDS.items()
        for metric in panels
        for at in (0.0, 10.0, 30.0)
    ]
    drawn = [
        figures.track_figure(several, styles),
        figures.prediction_figure(several, 5.0, styles, seen),
        figures.error_figure("turn", found["rows"], predictor_styles(("persistence", "ukf"))),
    ]
    spans = [{"span_s": span, "reliability": [[0.25, 0.3, 99]]} for span in (2.0, 3.0)]
    drawn.append(figures.reliability_figure(spans))
    drawn += [
        figures.parameter_figure(several, "ukf", motion, styles, 5.0) for motion in MODEL.blocks
    ]
    drawn += [
        figures.trend_figure(axis, [row for row in trend if row["axis"] == axis], styles)
        for axis in figures.TRENDS
    ]
    unit = re.compile(r"\((?!\))[^()]*(\([^()]*\))?\)$")
    for picture in drawn:
        picture.draw_without_rendering()  # makes the layout
        assert picture.axes
        for ax in picture.axes:
            assert unit.search(ax.get_ylabel() or ax.get_title(loc="left")), ax
            left, bottom = ax.get_position().p0
            # the label of the time stands below the lowest panel of a column
            column = [o for o in picture.axes if abs(o.get_position().x0 - left) < 1e-6]
            lowest = min(column, key=lambda o: o.get_position().y0)
            assert unit.search((ax if ax.get_xlabel() else lowest).get_xlabel()), ax
            assert ax.get_xlabel() or bottom > lowest.get_position().y0


def test_line_styles_differ_without_colours():
    styles = predictor_styles((*PREDICTORS, *STYLES))
    assert len({str(style) for _, style in styles.values()}) == len(styles)
    assert len({colour for colour, _ in (styles[name] for name in STYLES)}) == 7


def test_error_picture_shows_a_few_strong_lines_and_names_the_others():
    names = ("persistence", "ukf", "dsw-ukf", "dsw-ukf-plus", "lstm", "oracle", "mine:Own")
    rows = results(names)["rows"]
    strong = ["ukf", "dsw-ukf", "dsw-ukf-plus", "mine:Own"]
    assert headline(names) == strong
    rows += [{**row, "plan": "hold"} for row in rows]
    rows[0]["mae"] = math.inf
    picture = figures.error_figure("turn", rows, predictor_styles(names))
    picture.draw_without_rendering()
    assert [text.get_text() for text in picture.legends[0].get_texts()][:4] == strong
    for ax in picture.axes:
        texts = {text.get_text(): text.get_window_extent() for text in ax.texts}
        assert set(texts) == set(names) - set(strong)
        heights = sorted(box.y0 for box in texts.values())
        assert np.diff(heights).min() > 0.8 * max(box.height for box in texts.values())
        assert np.isfinite([*ax.get_xlim(), *ax.get_ylim()]).all()


@pytest.mark.parametrize("value", [0.0, 1e-300, 1.0, 1.7e308, math.inf])
def test_error_picture_of_absurd_errors_has_limits(value):
    rows = [{**row, "mae": value} for row in results()["rows"]]
    picture = figures.error_figure("turn", rows, predictor_styles(("persistence", "ukf")))
    picture.draw_without_rendering()
    assert all(np.isfinite(ax.get_ylim()).all() for ax in picture.axes)


OVERLAPS = """
const bad = [];
for (const svg of document.querySelectorAll('svg')) {
  const box = svg.getBoundingClientRect();
  const texts = [...svg.querySelectorAll('text')].map(e => [e, e.getBoundingClientRect()]);
  for (const [i, [a, p]] of texts.entries()) {
    if (p.left < box.left || p.right > box.right || p.top < box.top || p.bottom > box.bottom)
      bad.push(['outside', a.textContent, svg.getAttribute('aria-label')]);
    for (const [b, q] of texts.slice(i + 1)) {
      const wide = Math.min(p.right, q.right) - Math.max(p.left, q.left);
      // a line of text is higher than its letters
      const high = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
      if (wide > 0 && high > 0.25 * Math.min(p.height, q.height))
        bad.push([a.textContent, b.textContent, svg.getAttribute('aria-label')]);
    }
  }
}
return bad;
"""
SMALLEST = """
return Math.min(...[...document.querySelectorAll('text')].map(
  e => parseFloat(getComputedStyle(e).fontSize) * e.ownerSVGElement.getScreenCTM().a));
"""


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1280, 720)])
def test_page_fits_a_browser(browser, whole, width, height):
    driver = browser(width, height)
    driver.get(whole[0].as_uri())
    driver.execute_script("for (const e of document.querySelectorAll('details')) e.open = true")
    assert driver.execute_script("return innerWidth") == width
    assert driver.execute_script("return document.scrollingElement.scrollWidth") <= width
    assert driver.get_log("browser") == []
    assert driver.execute_script(OVERLAPS) == []
    assert driver.execute_script(SMALLEST) > 9.5  # pixels


def test_same_input_gives_same_bytes(tmp_path):
    log = sail()
    runs = [run(log, {"ukf": figure(log, model=0, origins=(8.0,))})]
    first, second = (write_report(tmp_path / k, results(), runs) for k in ("a", "b"))
    assert [p.read_bytes() for p in first] == [p.read_bytes() for p in second]


def test_text_is_escaped(tmp_path):
    log = sail("<b>$x^$</b>")
    marked_up = RunFigure("<i>$_$", "no&ne", 0, log, [], {"<u>$^$": figure(log, origins=())})
    found = results(("<u>$^$",), command="usv-twin <script>", notes=["lstm <left> out"])
    files = write_report(tmp_path, found, [marked_up])
    text = page(files)
    assert "&lt;script&gt;" in text
    assert "lstm &lt;left&gt; out" in text
    assert not re.search(r"<(script|left|i|u)>", text)
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+", path.name) for path in files)


def test_the_best_value_is_bold(tmp_path):
    text = page(write_report(tmp_path, results(), []))
    assert "<b>1.50</b>" in text  # lowest MAE
    assert "<b>0</b>" in text  # highest skill
    assert "<td>-3.25</td>" in text
    assert "<b>2.50</b>" not in text
    assert "[" not in re.sub(r"\[type.*", "", text.split("<tbody>")[1].split("</tbody>")[0])


def test_interval_needs_both_ends(tmp_path):
    found = results()
    found["summary"][0].update(low=1.25, high=3.75)
    assert "[1.25, 3.75]" in page(write_report(tmp_path, found, []))


def test_pairs_and_coverage_are_shown(tmp_path):
    here = {"scenario": "turn", "fault": "gps10", "predictor": "ukf", "plan": "hold"}
    pair = {"against": "persistence", "change_percent": -12.34, "median_percent": -9.0}
    pair |= {"low": -20.0, "high": -3.0, "wins": 5, "seeds": 6}
    cover = [
        {"channel": c, "horizon_s": h, "coverage90": 0.9 - 0.01 * h}
        for c in ("u", "displacement")
        for h in (1.0, 10.0)
    ]
    found = results(paired=[here | pair], channels=[here | row for row in cover])
    found["summary"][0].update(low=1.25, high=3.75, median=2.125)
    text = page(write_report(tmp_path, found, []))
    assert "Against persistence" in text
    assert "-12.3 %<br><small>[-20.0, -3.0]" in text and "5 of 6" in text
    assert "Coverage of the 90 % intervals, %, at 1/10 s" in text
    assert text.count("<td>89/80</td>") == 2


def test_forecasts_of_roll_and_of_a_quiet_deck_are_shown(tmp_path):
    here = {"scenario": "turn", "case": "none", "predictor": "ukf", "plan": "known"}
    motion = [
        {**here, "seed": k, "channel": "roll", "horizon_s": h, "sd": 0.1}
        | {"skill": 0.125 * h + 0.01 * k, "held": 1.5, "coverage90": 0.885}
        | {"rmse": 0.0125 * h, "crps": 0.007}
        for k in range(3)
        for h in (1.0, 2.0)
    ]
    quiet = {**here, "span_s": 2.0, "base_rate": 0.375, "auc": None, "auc_now": 0.6875}
    quiet["brier"] = 0.125
    quiet["reliability"] = [[0.05, 0.1, 40], [0.62, 0.5, 30], [0.85, 1.0, 3]]
    found = results(motion=motion, quiet=[{**quiet, "brier_skill": -0.25}])
    text = page(write_report(tmp_path, found, []))
    assert "<td>0.135<br><small>1.50</small><br><small>88 %</small></td><td>0.260<br>" in text
    assert "<td>2 s</td><td>0.375</td><td>-0.250</td><td>-</td><td>0.688</td>" in text
    assert "<td>0.688</td><td>0.125</td>" in text
    # degrees, though the rows are in rad
    assert "<td>deg</td><td>0.716<br><small>5.73</small><br><small>0.401</small></td>" in text
    assert (tmp_path / "pictures" / "quiet_reliability.svg").is_file()
    picture = figures.reliability_figure([quiet, quiet])
    curve = picture.axes[0].lines[1].get_xydata()
    assert curve == pytest.approx(np.array([[5.0, 10.0], [62.0, 50.0]]))  # three are too few


def test_an_interval_may_be_wider_on_one_side():
    log = sail()
    prediction = predicted(log, 5.0)
    skew = dataclasses.replace(
        prediction, low=prediction.mean - 1.0, high=prediction.mean + 3.0, start_cov=np.eye(6)
    )
    down, up = interval_widths(skew, 3, 2.0)
    np.testing.assert_allclose(down, [2.0 * Z90, *[2.0] * 40])
    np.testing.assert_allclose(up, [2.0 * Z90, *[6.0] * 40])


def test_missing_values_are_dashes(tmp_path):
    found = results()
    for row in found["summary"]:
        row["value"] = math.nan if row["metric"] == "mae" else None
    for row in found["rows"]:
        row["mae"] = None
    files = write_report(tmp_path, found, [])
    assert page(files).count("<td>-</td>") == 4
    assert len(files) == 1


@pytest.mark.parametrize("found", [{}, {"rows": [], "summary": [], "settings": {}, "command": "x"}])
def test_a_report_of_nothing_says_so(tmp_path, found):
    files = write_report(tmp_path / "new", found, [])
    assert len(files) == 1
    assert "nothing to show" in page(files)


@pytest.mark.parametrize("factor", [1e300, math.inf])
def test_absurd_predictions_do_not_stop_it(tmp_path, factor):
    log = sail()
    tame = figure(log, model=0, origins=(5.0,))
    with np.errstate(all="ignore"):
        wild = figure(log, factor, origins=(5.0,))
    files = write_report(tmp_path, results(), [run(log, {"ukf": tame, "dsw-ukf": wild})])
    assert len(files) == 1 + 1 + 1 + 1 + 3


def test_absurd_predictions_do_not_squash_the_truth():
    truth = np.linspace(0.0, 10.0, 50)
    low, high = panel_limits(truth, [np.linspace(0.0, 1e9, 50)], 1.0)
    assert -2.0 < low < 0.0
    assert 10.0 < high < 25.0


def test_recorded_run_without_truth(tmp_path):
    log = sail(truth=False)
    seen = reference_of(log)
    assert not seen.is_truth
    # surge speed from GPS and compass, yaw rate from the compass since there is no gyro
    np.testing.assert_allclose(seen.v[3], 4.0, atol=1e-9)
    np.testing.assert_allclose(seen.v[5], 0.2, atol=1e-9)
    found = results()
    found["rows"] = [row for row in found["rows"] if row["channel"] != "u"]
    files = write_report(tmp_path, found, [run(log, {"ukf": figure(log, model=0)})])
    assert len(files) == 1 + 1 + 1 + 2


def test_a_report_of_recorded_runs_begins_with_table_bars_and_track(tmp_path):
    log = sail(truth=False)
    recorded = [
        {
            **{"folder": "lake", "fault": fault, "plan": "known", "channel": channel, "runs": 3},
            **{"predictor": name, "error": 1.0, "ratio": ratio, "low": 0.9 * ratio},
            "high": 1.1 * ratio,
        }
        for fault in ("none", "gps10")
        for name, ratio in (("persistence", 1.0), ("ukf", 0.5), ("var", 3.0))
        for channel in ("displacement", "psi")
    ]
    styled = results(("persistence", "ukf", "var"), recorded=recorded)
    files = write_report(tmp_path, styled, [run(log, {"ukf": figure(log, model=0)})])
    assert "recorded_verdict" in {path.stem for path in files[1:]}
    text = page(files)
    heads = ("<h3>folder lake: 3 runs, no loss", 'aria-label="Root mean', 'aria-label="Turn')
    order = (*heads, "<details")
    places = [text.index(part) for part in order]
    assert places == sorted(places)
    # persistence took no part: there is nothing to compare with
    bare = [{key: row[key] for key in row if key != "ratio"} for row in recorded]
    for row in bare:
        row.pop("low"), row.pop("high")
    files = write_report(tmp_path, styled | {"recorded": bare}, [])
    assert "recorded_verdict" not in {path.stem for path in files[1:]}


def test_a_predictor_may_lack_what_others_have(tmp_path):
    log = sail()
    empty = PredictorFigure([], np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)))
    one = figure(log, model=0, origins=(8.0,))
    files = write_report(tmp_path, results(), [run(log, {"lstm": empty, "ukf": one})])
    assert {p.stem for p in files[2:]} == {"turn_gps10_seed0_track", "turn_gps10_seed0_prediction1"}


def test_equal_names_do_not_overwrite_each_other(tmp_path):
    log = sail()
    runs = [run(log, {"ukf": figure(log, model=0, origins=())})] * 2
    files = write_report(tmp_path, results(), runs)
    assert len(set(files)) == len(files) == 4


@pytest.mark.parametrize("kind", ["truth", "recorded", "blind", "short"])
def test_picture_of_log_is_drawn(tmp_path, kind):
    log = sail(truth=kind != "recorded", rows=1 if kind == "short" else 400)
    if kind == "blind":
        log = Log(log.t, np.full_like(log.z, math.nan), log.cmd)
    path = tmp_path / "new" / "run.png"
    picture_of_log(log, path, [(7.0, 12.0)])
    assert path.read_bytes().startswith(PNG)


def test_matplotlib_is_imported_late_and_without_pyplot(tmp_path):
    code = (
        "import sys, numpy as np, twin.benchmark.figures as r; from pathlib import Path\n"
        "from twin import Log\n"
        "assert 'matplotlib' not in sys.modules\n"
        f"log = Log(np.arange(3.), np.zeros((3, {len(MEASUREMENTS)})), np.zeros((3, 4)))\n"
        f"r.picture_of_log(log, Path({str(tmp_path / 'p.png')!r}))\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
