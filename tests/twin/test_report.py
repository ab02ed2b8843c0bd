"""The report: complete, self-contained, and unmoved by absurd or missing numbers."""

import dataclasses
import math
import re
import subprocess
import sys

import numpy as np
import pytest

from twin import report
from twin.log import MEASUREMENTS, Log
from twin.predictor import Prediction
from twin.report import PredictorFigure, RunFigure, picture_of_log, write_report
from twin.structure import structure_of

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


def figure(log, factor=1.0, model=True, origins=(5.0, 8.0)):
    t, examples = np.arange(20.0), [predicted(log, o, factor) for o in origins]
    if not model:
        return PredictorFigure(examples, t, np.zeros((20, 0)), np.zeros((20, 0)))
    xi = np.outer(t, np.linspace(1e-6, 1.0, len(MODEL))) * factor
    named = MODEL.parameters, MODEL.units, MODEL.blocks
    return PredictorFigure(examples, t, xi, 0.1 * np.abs(xi), *named)


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
    predictors = {"persistence": figure(log, model=False), "ukf": figure(log)}
    files = write_report(tmp_path, results(), [run(log, predictors, [(7.0, 12.0)])])
    assert files[0] == tmp_path / "report.html"
    stems = {path.stem for path in files[1:]}
    base = "turn_gps10_seed0_"
    ends = ("track", "prediction1", "prediction2", "ukf_surge", "ukf_sway", "ukf_yaw")
    assert stems == {"turn_gps10_error"} | {base + end for end in ends}
    assert all(path.parent == tmp_path / "pictures" for path in files[1:])
    assert all(path.read_bytes().startswith(PNG) for path in files[1:])
    text = page(files)
    assert text.count("<img ") == len(files) - 1
    sources = re.findall(r'(?:src|href)="([^"]{0,12})', text)
    assert all(source.startswith(("data:image", "#")) for source in sources)
    assert "<script" not in text
    # every link of the contents leads somewhere
    for target in re.findall(r'href="#([^"]+)"', text):
        assert f'id="{target}"' in text


def test_same_input_gives_same_bytes(tmp_path):
    log = sail()
    runs = [run(log, {"ukf": figure(log, model=False, origins=(8.0,))})]
    first, second = (write_report(tmp_path / k, results(), runs) for k in ("a", "b"))
    assert [p.read_bytes() for p in first] == [p.read_bytes() for p in second]


def test_text_is_escaped(tmp_path):
    log = sail("<b>$x^$</b>")
    strange = RunFigure("<i>$_$", "no&ne", 0, log, [], {"<u>$^$": figure(log, origins=())})
    found = results(("<u>$^$",), command="usv-twin <script>", notes=["lstm <left> out"])
    files = write_report(tmp_path, found, [strange])
    text = page(files)
    assert "&lt;script&gt;" in text
    assert "lstm &lt;left&gt; out" in text
    assert not re.search(r"<(script|left|i|u)>", text)
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+", path.name) for path in files)


def test_best_is_bold_and_bad_is_shown(tmp_path):
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
    assert "Coverage of the 90 % bands, % at 1/10 s" in text
    assert text.count("<td>89/80</td>") == 2


def test_a_band_may_be_wider_on_one_side():
    log = sail()
    prediction = predicted(log, 5.0)
    skew = dataclasses.replace(
        prediction, low=prediction.mean - 1.0, high=prediction.mean + 3.0, start_cov=np.eye(6)
    )
    down, up = report._band(skew, 3, 2.0)
    np.testing.assert_allclose(down, [2.0 * report.Z90, *[2.0] * 40])
    np.testing.assert_allclose(up, [2.0 * report.Z90, *[6.0] * 40])


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
def test_nothing_finished(tmp_path, found):
    files = write_report(tmp_path / "new", found, [])
    assert len(files) == 1
    assert "nothing to show" in page(files)


@pytest.mark.parametrize("factor", [1e300, math.inf])
def test_absurd_predictions_do_not_stop_it(tmp_path, factor):
    log = sail()
    tame = figure(log, model=False, origins=(5.0,))
    with np.errstate(all="ignore"):
        wild = figure(log, factor, origins=(5.0,))
    files = write_report(tmp_path, results(), [run(log, {"ukf": tame, "dsw-ukf": wild})])
    assert len(files) == 1 + 1 + 1 + 1 + 3


def test_absurd_predictions_do_not_squash_the_truth():
    truth = np.linspace(0.0, 10.0, 50)
    low, high = report._limits(truth, [np.linspace(0.0, 1e9, 50)], 1.0)
    assert -2.0 < low < 0.0
    assert 10.0 < high < 25.0


def test_recorded_run_without_truth(tmp_path):
    log = sail(truth=False)
    seen = report._reference(log)
    assert not seen.known
    # surge speed from GPS and compass, yaw rate from the compass since there is no gyro
    np.testing.assert_allclose(seen.v[3], 4.0, atol=1e-9)
    np.testing.assert_allclose(seen.v[5], 0.2, atol=1e-9)
    found = results()
    found["rows"] = [row for row in found["rows"] if row["channel"] != "u"]
    files = write_report(tmp_path, found, [run(log, {"ukf": figure(log, model=False)})])
    assert len(files) == 1 + 1 + 1 + 2


def test_a_predictor_may_lack_what_others_have(tmp_path):
    log = sail()
    empty = PredictorFigure([], np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)))
    one = figure(log, model=False, origins=(8.0,))
    files = write_report(tmp_path, results(), [run(log, {"lstm": empty, "ukf": one})])
    assert {p.stem for p in files[2:]} == {"turn_gps10_seed0_track", "turn_gps10_seed0_prediction1"}


def test_equal_names_do_not_overwrite_each_other(tmp_path):
    log = sail()
    runs = [run(log, {"ukf": figure(log, model=False, origins=())})] * 2
    files = write_report(tmp_path, results(), runs)
    assert len(set(files)) == len(files) == 4


@pytest.mark.parametrize("kind", ["truth", "recorded", "blind", "short"])
def test_picture_of_log(tmp_path, kind):
    log = sail(truth=kind != "recorded", rows=1 if kind == "short" else 400)
    if kind == "blind":
        log = Log(log.t, np.full_like(log.z, math.nan), log.cmd)
    path = tmp_path / "new" / "run.png"
    picture_of_log(log, path, [(7.0, 12.0)])
    assert path.read_bytes().startswith(PNG)


def test_matplotlib_comes_late_and_without_pyplot(tmp_path):
    code = (
        "import sys, numpy as np, twin.report as r; from pathlib import Path\n"
        "assert 'matplotlib' not in sys.modules\n"
        "log = r.Log(np.arange(3.), np.zeros((3, len(r.MEASUREMENTS))), np.zeros((3, 4)))\n"
        f"r.picture_of_log(log, Path({str(tmp_path / 'p.png')!r}))\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
