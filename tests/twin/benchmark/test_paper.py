"""The paper redone: rows beside its numbers, sentences that follow from them, page and command."""

from __future__ import annotations

import dataclasses
import json
import math
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from twin import Twin
from twin.benchmark import runner
from twin.benchmark.loading import load_run
from twin.benchmark.paper import experiment
from twin.benchmark.paper.experiment import (
    METHODS,
    PREDICTORS,
    WITHOUT_WINDOW,
    Trace,
    finished_trace,
    paper_settings_of,
    trace_file,
    traced_units,
    traces,
)
from twin.benchmark.paper.figures import _number
from twin.benchmark.paper.findings import Contest, findings
from twin.benchmark.paper.published import TABLE_4, TABLES
from twin.benchmark.paper.rows import PaperRow, paper_rows, window_shares
from twin.cli import paper as command
from twin.cli.main import app
from twin.identification.dynamic_window import DynamicWindow, variable_part
from twin.predictors.registry import make_predictor, options_of

NAMES = ("dsw-ukf:printed", "dsw-ukf", "dsw-ukf:window=off", "persistence")
SHORT = {"identify_s": 8.0, "duration_s": 20.0}


@pytest.fixture(scope="module")
def redone(tmp_path_factory):
    """A short experiment: settings, folder, results and traces."""
    folder = tmp_path_factory.mktemp("paper")
    settings = paper_settings_of((0, 1, 2), NAMES, faults=("none",), **SHORT)
    done = dict(runner.runs(settings, folder))
    traced = dict(traces(settings, folder))
    assert not [one for one in (*done.values(), *traced.values()) if isinstance(one, Exception)]
    return SimpleNamespace(settings=settings, folder=folder, done=done, traced=traced)


def a_trace(window, V, S, cap=15):
    n = len(window)
    return Trace(
        t=[float(k) for k in range(n)],
        params=[[1.0] * 25] * n,
        window=window,
        V=V,
        S=S,
        short_period=[True] * n,
        lateral=[False] * n,
        base=15,
        cap=cap,
    )


def test_variants_differ_in_the_window_alone():
    for name, without in WITHOUT_WINDOW.items():
        assert options_of(without) == {**options_of(name), "window": "off"}
        assert METHODS[name] == "DSW-UKF" and METHODS[without] == "UKF"
    assert set(METHODS) < set(PREDICTORS)


def test_printed_method_adapts_both_noises_without_feedback(boat):
    predictor = make_predictor("dsw-ukf:printed", boat)
    assert (predictor.adapt, predictor.adapts, predictor.use) == ("literal", "QR", "dynamic")
    assert not predictor.fusion.feedback
    assert make_predictor("dsw-ukf", boat).adapt == "off"


def test_variable_part_follows_eq_40_and_its_bounds():
    assert variable_part(0.05, 1.1, 15, 15) == 0  # calm
    assert variable_part(0.05, 1.3, 15, 15) == math.floor(15 * (0.03 + 0.52) + 0.5)
    assert variable_part(0.5, 1.0, 15, 15) == math.floor(15 * 0.7 + 0.5)
    assert variable_part(0.0, 1e30, 15, 15) == 15
    assert variable_part(0.0, 1e30, 15, 385) == 385


def test_window_without_a_cap_grows_to_any_bound():
    """Eq 39 grows with the window that Eq 40 makes of it."""
    rng, lengths = np.random.default_rng(1), []
    for cap in (15, 45, 185):
        window = DynamicWindow(base=15, cap=cap, period="binary")
        rng = np.random.default_rng(1)
        for k in range(2400):
            window.update(0.05 * k, trace_P=9.0, hs=1.0, motion=float(rng.normal()))
        lengths.append(window.W)
    assert lengths == [30, 60, 200]


def test_window_shares_count_what_the_index_adds():
    part = a_trace([15, 15, 30, 20], [None, 0.0, 0.2, 1.0], [None, 1.0, 5.0, 1.0])
    shares = window_shares(part)
    assert shares["W, mean, rows"] == 20.0 and shares["cap of W, rows"] == 30.0
    assert shares["W at its cap, share of time"] == 0.25
    assert shares["W at its base, share of time"] == 0.5
    assert shares["rows that V adds, mean"] == pytest.approx(15 * 0.6 * 0.4)
    assert shares["rows that V adds, largest"] == pytest.approx(9.0)
    # at S = 5 the window is at its cap either way
    assert shares["V changes W, share of time"] == pytest.approx(1 / 3)


def test_rows_hold_the_numbers_of_runs_and_paper(redone):
    rows = paper_rows(redone.settings, redone.done, redone.traced)
    by = {row[:5]: row for row in rows}
    table, published = TABLES["turn"]
    found = [row for row in rows if (row.table, row.predictor) == (table, "dsw-ukf")]
    assert [row.paper for row in found[:25]] == published.tolist() and len(found) == 26
    units_of = [u for u in redone.traced if (u.scenario, u.predictor) == ("turn", "dsw-ukf")]
    ends = [np.array(redone.traced[u].params)[8] for u in units_of]
    assert [row.ours for row in found[:25]] == pytest.approx(np.mean(ends, axis=0).tolist())
    for scenario, methods in TABLE_4.items():
        for name in NAMES:
            for k, metric in enumerate(("MAE", "MSE")):
                row = by["Table 4", scenario, "none", name, metric]
                assert row.low <= row.ours <= row.high
                assert row.paper == methods.get(METHODS.get(name), (None, None))[k]
    errors = [
        np.mean(
            [
                c["mae"]
                for n, c in result["plans"]["known"]["channels"].items()
                if n != "displacement"
            ]
        )
        for unit, result in redone.done.items()
        if (unit.scenario, unit.predictor) == ("turn", "dsw-ukf")
    ]
    assert by["Table 4", "turn", "none", "dsw-ukf", "MAE"].ours == pytest.approx(np.mean(errors))
    named = {row.table for row in rows}
    assert {f"Figure {k}" for k in range(9, 17)} | {"Algorithm 1", "Table 3"} <= named
    assert all(math.isfinite(row.ours) for row in rows)
    assert not [r for r in rows if r.table == "Algorithm 1" and "window=off" in r.predictor]


def test_trace_is_that_of_a_twin_row_by_row(redone):
    unit = next(u for u in redone.traced if u.predictor == "dsw-ukf:printed")
    run = load_run(redone.settings, unit)
    twin = Twin(run.particulars, unit.predictor, seed=unit.seed)
    twin.run(run.seen)
    part = redone.traced[unit]
    at = [k for k, (t, _, _) in enumerate(run.seen) if t <= part.t[-1] + 1e-9]
    assert len(at) == len(run.seen)  # the last row is shown
    assert part.params[-1] == twin.estimate().params.tolist()
    assert part.window[-1] == twin.predictor.window.W


def test_traces_are_kept_and_belong_to_their_settings(redone):
    work = traced_units(redone.settings)
    assert len(work) == len(redone.traced) == 2 * 3 * 3
    for unit in work:
        assert finished_trace(redone.settings, unit, redone.folder) == redone.traced[unit]
    other = dataclasses.replace(redone.settings, hs=1.0)
    assert finished_trace(other, work[0], redone.folder) is None
    trace_file(redone.folder, work[0]).write_text("{}")
    again = dict(traces(redone.settings, redone.folder))
    assert again == redone.traced


def table_4(values):
    """Return rows of Table 4 with these MAE, for a turn."""
    return [
        PaperRow("Table 4", "turn", "none", name, "MAE", value, None, None, None)
        for name, value in values.items()
    ]


def algorithm(values, name="dsw-ukf"):
    """Return rows of Algorithm 1."""
    return [
        PaperRow("Algorithm 1", "turn", "none", name, metric, value, None, None, None)
        for metric, value in values.items()
    ]


def test_order_of_table_4_follows_from_the_errors():
    def sentence(dsw, ukf, lstm, low=-9.0, high=-1.0):
        rows = table_4({"dsw-ukf": dsw, "dsw-ukf:window=off": ukf, "lstm": lstm})
        contest = Contest("turn", "none", "dsw-ukf", 100.0 * (dsw / ukf - 1.0), low, high, 1, 1)
        return findings(rows, [contest])[0]

    assert "reproduces: it holds in 1 of 1 cases as mended" in sentence(0.1, 0.2, 0.3)
    worse = sentence(0.2, 0.1, 0.3, low=-9.0, high=9.0)
    assert "does not reproduce: it holds in 0 of 1" in worse
    assert "DSW-UKF is before UKF in 0, UKF before LSTM in 1" in worse
    assert "by +100 to +100 %, in 0 of 1 cases" in worse
    assert "in 1 of 1 cases with a 95 % interval without zero" in sentence(0.1, 0.2, 0.3)
    both = table_4({"dsw-ukf": 0.1, "dsw-ukf:window=off": 0.2})
    both += table_4({"dsw-ukf:printed": 0.3, "dsw-ukf:printed,window=off": 0.2})
    said = findings(both, [Contest("turn", "none", "dsw-ukf", -50.0, None, None, 1, 1)])[0]
    assert "(DSW-UKF before UKF) reproduces in part" in said and "LSTM" not in said
    assert said.endswith("changes the MAE by -50 to -50 %.")  # too few seeds for an interval


def test_sentences_on_index_and_cap_follow_from_the_window():
    inert = {
        "rows that V adds, mean": 0.1,
        "rows that V adds, largest": 0.4,
        "V changes W, share of time": 0.0,
        "W at its cap, share of time": 0.9,
        "cap of W, rows": 30.0,
        "S, median": 700.0,
    }
    environment, cap = findings(algorithm(inert), [])
    assert (
        "is inert" in environment and "0.1 rows" in environment and "0 % of the time" in environment
    )
    assert "sits at its cap of 30 rows" in cap and "90 % of the time as mended" in cap
    assert "the median of its index S is 700, where 2.5 is enough" in cap
    two = algorithm(inert) + algorithm({**inert, "S, median": 90.0}, "dsw-ukf:printed")
    assert "index S is 90.0 to 700, by manoeuvre and form" in findings(two, [])[1]
    acts = {**inert, "rows that V adds, mean": 4.0, "V changes W, share of time": 0.3}
    environment, cap = findings(algorithm({**acts, "W at its cap, share of time": 0.1}), [])
    assert " acts " in environment and "up to 30.0 %" in environment
    assert "moves between base and cap of 30 rows" in cap
    assert findings([], []) == []


@pytest.mark.parametrize("limits", [(0.235, 0.33), (0.01, 60.0), (2.0, 3100.0), (1e-4, 1e5)])
def test_logarithmic_axes_have_few_plain_numbers(limits):
    from matplotlib.figure import Figure

    ax = Figure().add_subplot(xscale="log", xlim=limits)
    _number(ax.xaxis)
    low, high = limits
    shown = [label.get_text() for label in ax.get_xticklabels()]
    assert 3 <= len(shown) <= 5 and "" not in shown
    assert all(low <= float(text) <= high for text in shown)


class Tags(HTMLParser):
    """Counts the elements of a page."""

    def __init__(self):
        super().__init__()
        self.count = {}

    def handle_starttag(self, tag, attributes):
        self.count[tag] = self.count.get(tag, 0) + 1


@pytest.fixture
def short(monkeypatch):
    """The command with few predictors on short runs."""
    monkeypatch.setattr(command, "PREDICTORS", ("dsw-ukf", "dsw-ukf:window=off"))
    monkeypatch.setattr(
        command,
        "paper_settings_of",
        lambda seeds, names: paper_settings_of(
            seeds, names, faults=("none",), scenarios=("turn",), **SHORT
        ),
    )
    monkeypatch.setattr(runner, "warm_up", lambda settings, **given: None)


def invoke(*arguments, code=0):
    result = CliRunner().invoke(app, ["paper", "--jobs", "1", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == code, result.output
    return " ".join(result.output.split())


def test_command_writes_page_and_rows_and_goes_on(short, tmp_path, monkeypatch):
    real, asked = experiment.trace, []

    def interrupted(settings, unit, folder, run=None):
        if len(asked) == 1:
            raise KeyboardInterrupt
        asked.append(unit)
        return real(settings, unit, folder, run)

    monkeypatch.setattr(experiment, "trace", interrupted)
    monkeypatch.setattr(
        experiment, "results_of", lambda calls, jobs: ((k, call()) for k, call in enumerate(calls))
    )
    out = ("--out", tmp_path, "--seeds", "0")
    said = invoke(*out, code=130)
    assert "results are kept" in said and "the same command goes on from there" in said
    assert not (tmp_path / "paper.html").exists()
    first = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "runs").iterdir()}
    assert len(first) == 1

    monkeypatch.setattr(experiment, "trace", real)
    said = invoke(*out, "--json", tmp_path / "rows.json")
    for name, time in first.items():  # nothing was done again
        assert (tmp_path / "runs" / name).stat().st_mtime_ns == time
    assert "The order of Table 4 (DSW-UKF before UKF)" in said
    rows = json.loads((tmp_path / "rows.json").read_text())
    assert {tuple(row) for row in rows} == {PaperRow._fields}
    page = (tmp_path / "paper.html").read_text()
    tags = Tags()
    tags.feed(page)
    # two of Table 4, a window, a forecast, and three equations of two filters
    assert tags.count["svg"] == 2 + 1 + 1 + 2 * 3
    # Table 4, the window alone, Algorithm 1, Table 2, the figures, the settings
    assert tags.count["table"] == 6 and "script" not in tags.count
    for text in ("Table 2", "Figure 9", "Figure 12", "Algorithm 1", "paper 0.159"):
        assert text in page
    for text in (page, said):  # one seed has no interval
        assert "95 % interval" not in text and "95 % bootstrap" not in text


def test_command_names_wrong_seeds():
    assert "--seeds x" in invoke("--seeds", "x", code=2)
