"""usv-twin bench: the measuring itself, and that what is compared does the same work."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from twin.cli.main import app
from twin.filters.ukf import measurement_update
from twin.model.augmented import joint_predict
from twin.performance import cases
from twin.performance.cases import chosen, fit
from twin.performance.harness import FLOOR, REFERENCE_FLOOR, Case, Measured, measure

OWN = [case for case in cases.CASES if not case.needs and not case.slow]
KEYS = ["name", "rate_per_s", "median_us", "relative_to", "ratio"]


def busy(times):
    """Return what makes a burst of so many additions."""
    return lambda: (lambda: sum(range(times)), 1)


@pytest.mark.parametrize("case", OWN, ids=lambda case: case.name)
def test_every_case_runs(case):
    run, count = case.make()
    run()
    assert count >= 1


def test_names_are_unique_and_references_known():
    names = [case.name for case in cases.CASES]
    assert len(set(names)) == len(names)
    assert {case.relative_to for case in cases.CASES} - {None} <= set(names)


def test_both_filters_do_the_same():
    problem = cases.Problem()
    predict, correct = problem.arguments()
    theirs = problem.filterpy()
    for _ in range(5):
        joint_predict(*predict)
        measurement_update(*correct)
        theirs.predict()
        theirs.update(problem.z)
    sd = np.sqrt(np.diag(theirs.P))
    np.testing.assert_allclose(problem.ukf.x / sd, theirs.x / sd, rtol=0, atol=1e-10)
    np.testing.assert_allclose(
        problem.ukf.P / np.outer(sd, sd), theirs.P / np.outer(sd, sd), rtol=0, atol=1e-10
    )


def test_cases_bring_what_they_are_compared_with():
    assert [case.name for case in chosen("in-kernel")] == [
        "filterpy UKF 6 + 25",
        "UKF 6 + 25 in-kernel",
    ]
    names = [case.name for case in chosen("batch of 256")]
    assert {FLOOR, "CartPole x 256", "batch of 256", "batch of 256, ukf, 2 threads"} <= set(names)
    assert not any(case.slow for case in chosen(quick=True))
    assert chosen("no such case") == []


def test_rates_and_ratios():
    cases = [Case("slow", busy(20_000)), Case("fast", busy(2_000), "slow")]
    slow, fast = measure(cases, 5).rows(cases)
    assert list(slow) == list(fast) == KEYS
    assert slow["relative_to"] is None and slow["ratio"] is None
    assert fast["relative_to"] == "slow" and 3.0 < fast["ratio"] < 30.0
    assert fast["rate_per_s"] == pytest.approx(1e6 / fast["median_us"])


def test_bursts_take_turns():
    order = []
    cases = [Case(name, busy(10)) for name in "ab"]
    measure(cases, 3, order.append)
    assert order == list("ab") * 4


def test_what_was_reached_hangs_on_the_floor():
    measured = Measured({FLOOR: [2.0 / REFERENCE_FLOOR] * 3, "it": [1e-3] * 3})
    # the floor runs at half its speed here, and so may the case
    assert measured.reached(Case("it", busy(1), must=2000.0)) == pytest.approx(1.0)
    assert measured.reached(Case("it", busy(1), FLOOR, must_ratio=0.1)) == pytest.approx(
        2e3 / REFERENCE_FLOOR / 0.1
    )
    assert measured.reached(Case("it", busy(1))) is None


def test_peers_that_fail_are_told_of():
    def broken():
        raise AttributeError("their API moved")

    cases = [
        Case("absent", broken, needs=("no_such_package.part",)),
        Case("broken", broken, needs=("json",)),
        Case("ours", busy(10), "absent"),
    ]
    measured = measure(cases, 1)
    (row,) = measured.rows(cases)
    assert row["name"] == "ours" and row["relative_to"] is None
    assert measured.absent == {
        "absent": "no_such_package.part not installed",
        "broken": "AttributeError: their API moved",
    }
    with pytest.raises(AttributeError):
        measure([Case("ours", broken)], 1)


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
    result = CliRunner().invoke(app, ["bench", "--json", str(out)])
    assert result.exit_code == 130, result.output
    assert [row["name"] for row in json.loads(out.read_text())] == ["first", "second"]
    assert "second" in result.output and "memory" not in result.output
    assert "interrupted" in result.output


def test_rows_of_the_command(tmp_path):
    out = tmp_path / "rows.json"
    result = CliRunner().invoke(
        app, ["bench", "--quick", "--only", "ship,", "--rounds", "1", "--json", str(out)]
    )
    assert result.exit_code == 0, result.output
    rows = json.loads(out.read_text())
    assert {"ship, 3-DOF, 0 waves", "ship, 6-DOF, 100 waves"} <= {row["name"] for row in rows}
    assert all(list(row) == KEYS for row in rows)


def test_growth_of_the_command(tmp_path):
    out = tmp_path / "rows.json"
    arguments = ["bench", "--growth", "--only", "ship step, 3-DOF", "--rounds", "1"]
    result = CliRunner().invoke(app, [*arguments, "--json", str(out)])
    assert result.exit_code == 0, result.output
    rows = json.loads(out.read_text())
    assert [row["size"] for row in rows] == list(cases.CURVES[0].sizes)
    assert rows[-1]["median_us"] > rows[0]["median_us"]
    assert "us times wave components" in " ".join(result.output.split())


def test_first_use_is_of_a_process_that_finds_nothing(tmp_path, monkeypatch):
    (tmp_path / "kernel").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert 0.1 < cases.first_use(()) < 30.0  # nothing but the imports
    monkeypatch.setattr(
        cases, "_FIRST_USE", 'import os; print(len(os.listdir(os.environ["NUMBA_CACHE_DIR"])))'
    )
    assert cases.first_use(()) == 0.0


def test_a_first_use_that_fails_is_left_out(tmp_path, monkeypatch):
    monkeypatch.setattr(cases, "CASES", (Case("first", busy(10)),))
    monkeypatch.setattr(cases, "MEMORY", {})
    monkeypatch.setattr(cases, "_FIRST_USE", "raise ValueError('no such vessel')")
    out = tmp_path / "rows.json"
    result = CliRunner().invoke(app, ["bench", "--json", str(out), "--rounds", "1"])
    assert result.exit_code == 0, result.output
    assert [row["name"] for row in json.loads(out.read_text())] == ["first"]
    assert "ValueError: no such vessel" in " ".join(result.output.split())


def test_first_use_of_the_command(tmp_path, monkeypatch):
    monkeypatch.setattr(cases, "FIRST_USES", {"first use of nothing": ((), 30.0)})
    out = tmp_path / "rows.json"
    result = CliRunner().invoke(app, ["bench", "--only", "first use", "--json", str(out)])
    assert result.exit_code == 0, result.output
    (row,) = json.loads(out.read_text())
    assert list(row) == KEYS
    assert row["median_us"] == pytest.approx(1e6 / row["rate_per_s"])
    assert "at most 30 s" in result.output
    # a minute of compiling is not for --quick
    assert CliRunner().invoke(app, ["bench", "--quick", "--only", "first use"]).exit_code == 2


def test_ctrl_c_while_compiling_keeps_what_is_there(tmp_path, monkeypatch):
    def interrupted(options):
        raise KeyboardInterrupt

    monkeypatch.setattr(cases, "CASES", (Case("first", busy(10)),))
    monkeypatch.setattr(cases, "first_use", interrupted)
    out = tmp_path / "rows.json"
    result = CliRunner().invoke(app, ["bench", "--json", str(out), "--rounds", "1"])
    assert result.exit_code == 130, result.output
    assert [row["name"] for row in json.loads(out.read_text())] == ["first"]
    assert "interrupted" in result.output and "memory" not in result.output


def test_unknown_case_is_an_error():
    result = CliRunner().invoke(app, ["bench", "--only", "xyz"])
    assert result.exit_code == 2


def test_a_straight_line_is_found():
    sizes = [0, 10, 50, 100, 400]
    line = fit(sizes, [3.0 + 0.5 * n for n in sizes])
    assert line.start == pytest.approx(3.0) and line.slope == pytest.approx(0.5)
    assert line.worst < 1e-9 and line.bend is None
    assert line(20) == pytest.approx(13.0)


def test_a_bend_is_found():
    sizes = [1, 2, 4, 16, 64, 256, 1024]
    line = fit(sizes, [1.0 + 0.1 * n + 0.4 * max(n - 64, 0) for n in sizes])
    assert line.bend == 64
    assert line.slopes == pytest.approx((0.1, 0.5))
    assert "bends at 64" in line.told("boats")


@pytest.mark.parametrize(("twin", "most"), cases.MEMORY.values())
def test_memory_of_a_boat(twin, most):
    boats = cases._boats(twin, cases.BOATS)
    arrays = boats.simulation.boats.nbytes / cases.BOATS
    assert arrays < cases.memory_per_boat(twin) < (most or 64e3)
