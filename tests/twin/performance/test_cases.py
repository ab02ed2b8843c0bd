"""``usv-twin bench``: the harness, the cases and the command."""

from __future__ import annotations

import itertools
import json
import runpy
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from twin.cli.main import app
from twin.performance import cases
from twin.performance.cases import CASES, select_cases
from twin.performance.harness import BASELINE, BASELINE_RATE, Case, Measured, measure

KEYS = ["name", "rate_per_s", "median_us", "relative_to", "ratio"]
GROWTH = runpy.run_path(str(Path(__file__).parents[3] / "examples" / "speed" / "growth.py"))


def busy(times):
    """Return what makes a burst of so many additions."""
    return lambda: (lambda: sum(range(times)), 1)


def bench(*arguments, check=0):
    result = CliRunner().invoke(app, ["bench", *map(str, arguments)])
    assert result.exit_code == check, result.output
    return " ".join(result.output.split())


@pytest.fixture
def one_case(monkeypatch):
    """A single fast case in place of all, and nothing else to measure."""
    monkeypatch.setattr(cases, "CASES", (Case("first", busy(10)),))
    monkeypatch.setattr(cases, "MEMORY", {})
    monkeypatch.setattr(cases, "COLD_COMPILES", {})


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_every_case_runs(case):
    run, count = case.make()
    run()
    assert count >= 1


def test_names_are_unique_and_references_known():
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names)
    assert {case.relative_to for case in CASES} - {None} <= set(names)


def test_both_filters_do_the_same():
    problem = cases.Problem()
    predict, correct = problem.arguments()
    theirs = problem.filterpy()
    for _ in range(5):
        cases._update_often(1, predict, correct)
        theirs.predict()
        theirs.update(problem.z)
    sd = np.sqrt(np.diag(theirs.P))
    np.testing.assert_allclose(problem.ukf.x / sd, theirs.x / sd, rtol=0, atol=1e-10)
    np.testing.assert_allclose(
        problem.ukf.P / np.outer(sd, sd), theirs.P / np.outer(sd, sd), rtol=0, atol=1e-10
    )


def test_cases_bring_what_they_are_compared_with():
    names = [case.name for case in select_cases("in-kernel")]
    assert names == ["filterpy UKF 6 + 25", "UKF 6 + 25 in-kernel"]
    names = [case.name for case in select_cases("batch of 256")]
    assert names == [BASELINE, "batch of 256", "batch of 256, ukf"]
    assert select_cases("no such case") == []


def test_rates_and_ratios_are_medians_over_the_rounds():
    measured = Measured({"slow": [2e-3, 4e-3, 9e-3], "fast": [1e-3, 1e-3, 2e-3]})
    slow, fast = measured.rows([Case("slow", busy(1)), Case("fast", busy(1), "slow")])
    assert list(slow) == list(fast) == KEYS
    assert slow["relative_to"] is None and slow["ratio"] is None
    assert fast["relative_to"] == "slow" and fast["ratio"] == pytest.approx(4.0)
    assert slow["rate_per_s"] == pytest.approx(250.0)
    assert slow["median_us"] == pytest.approx(4000.0)


def test_bursts_take_turns():
    order = []
    measure([Case(name, busy(10)) for name in "ab"], 3, order.append)
    assert order == list("ab") * 4


def test_targets_scale_with_the_baseline():
    measured = Measured({BASELINE: [2.0 / BASELINE_RATE] * 3, "it": [1e-3] * 3})
    # the baseline runs at half its speed here, and so may the case
    assert measured.target_fraction(Case("it", busy(1), target=2000.0)) == pytest.approx(1.0)
    ratio = measured.target_fraction(Case("it", busy(1), BASELINE, target_ratio=0.1))
    assert ratio == pytest.approx(2e3 / BASELINE_RATE / 0.1)
    assert measured.target_fraction(Case("it", busy(1))) is None


def interrupted():
    """Make a burst that Ctrl-C ends after a few."""
    left = itertools.count()

    def run():
        # two bursts go into setting it up
        if next(left) > 4:
            raise KeyboardInterrupt
        sum(range(2_000_000))

    return run, 1


def test_ctrl_c_keeps_what_is_there(monkeypatch, tmp_path):
    monkeypatch.setattr(cases, "CASES", (Case("first", busy(10)), Case("second", interrupted)))
    out = tmp_path / "rows.json"
    printed = bench("--json", out, check=130)
    assert [row["name"] for row in json.loads(out.read_text())] == ["first", "second"]
    assert "second" in printed and "interrupted" in printed and "memory" not in printed


def test_rows_of_the_command_are_complete(tmp_path):
    out = tmp_path / "rows.json"
    bench("--quick", "--only", "ship,", "--rounds", "1", "--json", out)
    rows = json.loads(out.read_text())
    assert {"ship, 3-DOF, 0 waves", "ship, 6-DOF, 100 waves"} <= {row["name"] for row in rows}
    assert all(list(row) == KEYS for row in rows)


def test_growth_of_the_command_is_printed(tmp_path):
    out = tmp_path / "rows.json"
    only = ("--only", "ship step, 3-DOF", "--rounds", "1")
    printed = bench("--growth", *only, "--json", out)
    rows = json.loads(out.read_text())
    assert list(rows[0]) == ["name", "size_of", "size", "median_us", "line_us"]
    assert [row["size"] for row in rows] == list(GROWTH["COMPONENTS"])
    assert "us times wave components" in printed
    assert "no such curve" in bench("--growth", "--only", "xyz", check=2)


def test_cold_compile_starts_without_kernels(tmp_path, monkeypatch):
    (tmp_path / "kernel").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(
        cases, "_FIRST_USE", 'import os; print(len(os.listdir(os.environ["NUMBA_CACHE_DIR"])))'
    )
    assert cases.cold_compile_seconds(()) == 0.0


def test_cold_compile_of_the_command_is_printed(one_case, tmp_path, monkeypatch):
    monkeypatch.setattr(cases, "COLD_COMPILES", {"first use of nothing": ((), 30.0)})
    out = tmp_path / "rows.json"
    assert "at most 30 s" in bench("--only", "first use", "--json", out)
    (row,) = json.loads(out.read_text())
    assert list(row) == KEYS
    assert row["median_us"] == pytest.approx(1e6 / row["rate_per_s"])
    # a minute of compiling is not for --quick
    bench("--quick", "--only", "first use", check=2)


def test_ctrl_c_while_compiling_keeps_what_is_there(one_case, tmp_path, monkeypatch):
    def stop(options):
        raise KeyboardInterrupt

    monkeypatch.setattr(cases, "COLD_COMPILES", {"first use": ((), None)})
    monkeypatch.setattr(cases, "cold_compile_seconds", stop)
    out = tmp_path / "rows.json"
    assert "interrupted" in bench("--json", out, "--rounds", "1", check=130)
    assert [row["name"] for row in json.loads(out.read_text())] == ["first"]


def test_a_compilation_that_fails_is_left_out(one_case, tmp_path, monkeypatch):
    monkeypatch.setattr(cases, "COLD_COMPILES", {"first use": ((), None)})
    monkeypatch.setattr(cases, "_FIRST_USE", "raise ValueError('no such vessel')")
    out = tmp_path / "rows.json"
    assert "first use: ValueError: no such vessel" in bench("--json", out, "--rounds", "1")
    assert [row["name"] for row in json.loads(out.read_text())] == ["first"]


def test_a_straight_line_is_found():
    sizes = [0, 10, 50, 100, 400]
    line = GROWTH["fit"](sizes, [3.0 + 0.5 * n for n in sizes])
    assert line.start == pytest.approx(3.0) and line.slope == pytest.approx(0.5)
    assert line.worst < 1e-9 and line.bend is None
    assert line(20) == pytest.approx(13.0)


def test_a_bend_is_found():
    sizes = [1, 2, 4, 16, 64, 256, 1024]
    line = GROWTH["fit"](sizes, [1.0 + 0.1 * n + 0.4 * max(n - 64, 0) for n in sizes])
    assert line.bend == 64
    assert line.slopes == pytest.approx((0.1, 0.5))
    assert "bends at 64" in line.describe("boats")


@pytest.mark.parametrize(("twin", "limit"), cases.MEMORY.values())
def test_memory_of_a_boat_is_within_bounds(twin, limit):
    boats = cases.make_boats(twin, cases.BOATS)
    arrays = boats.simulation.boats.nbytes / cases.BOATS
    assert arrays < cases.memory_per_boat(twin) < (limit or 75e3)
