"""The fault matrix: what it measures, and what it keeps."""

import math

import numpy as np
import pytest
from typer.testing import CliRunner

from twin.benchmark import fault_matrix
from twin.benchmark.fault_matrix import FAULTS, FaultRun, Unit, fault_runs, matrix_units, tables
from twin.cli.main import app
from twin.integrity.state import SENSORS
from usv_gym.world.faults import Fault, parse_faults

UNIT = Unit("ukf", "usv75", "typical", 5, 0)


def only(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """Leave the matrix few faults and one boat; workers are forked, so they see it as well."""
    monkeypatch.setattr(fault_matrix, "FAULTS", {name: FAULTS[name] for name in names})
    monkeypatch.setattr(fault_matrix, "VESSELS", ("usv75",))
    monkeypatch.setattr(fault_matrix, "GRADES", ("typical",))
    monkeypatch.setattr(fault_matrix, "COMPASS_RATE_HZ", {5: 10.0})


def run_of(fault: str, rate: int = 5, **found: object) -> FaultRun:
    run = FaultRun("ukf", "otter", "typical", rate, 0, False, fault, 2.0, (), 3.0, 4.0, 5.0, 0.9,
                   0.8, 0.0)  # fmt: skip
    return run._replace(**found)


def test_faults_of_the_matrix_last_as_long_as_they_say() -> None:
    for name, fault in FAULTS.items():
        assert set(fault.sensors) <= set(SENSORS)
        if name == "current":
            continue
        parts = parse_faults(name, 90.0)
        assert all(isinstance(one, Fault) for one in parts)
        seconds = {one.duration * (2.0 if one.effect == "stall" else 1.0) for one in parts}
        assert seconds <= {fault.seconds}


def test_a_frozen_gyro_is_named_and_forgotten(tmp_path, monkeypatch) -> None:
    only(monkeypatch, "none", "gyro-frozen20", "gps-frozen10", "left-zero20")
    file = tmp_path / "runs.json"
    *_, (done, results) = fault_runs([UNIT], file)
    assert done == 1
    seen = {(run.in_loss, run.fault): run for run in results}
    # a GPS that is lost cannot freeze
    assert len(results) == len(seen) == 7 and (True, "gps-frozen10") not in seen
    clean, frozen = seen[False, "none"], seen[False, "gyro-frozen20"]
    assert clean.after_m == clean.clean_after_m and clean.recovered_s == 0.0
    assert frozen.named_s < 5.0 and frozen.recovered_s < 10.0 and not frozen.left_out
    assert frozen.inside_during > 0.8
    assert seen[False, "left-zero20"].after_m != clean.after_m
    # what is finished is not sailed again
    content = file.read_text()
    ((done, again),) = fault_runs([UNIT], file)
    assert (done, again) == (1, results) and file.read_text() == content


def test_units_are_sailed_seed_by_seed() -> None:
    units = matrix_units(["ukf", "var"], [3, 4])
    assert len(units) == len(set(units)) == 2 * 2 * 3 * 2 * 3
    assert [unit.seed for unit in units] == sorted(unit.seed for unit in units)


def test_pooled_rows_come_first_and_count_what_they_say() -> None:
    lines = tables(
        [
            run_of("none", left_out=("gps",)),
            run_of("gyro-frozen20"),
            run_of("gyro-sign20", named_s=math.inf, recovered_s=math.inf, left_out=("compass",)),
            run_of("left-scale=0.7:20", named_s=math.inf, inside_during=0.6),
            run_of("gyro-sign20", rate=1, in_loss=True),
        ]
    )
    (row,) = (line for line in lines if line.startswith("| 5 Hz"))
    # of two faults that must be named one is; of three runs with a fault one leaves out too much
    assert row == "| 5 Hz | 50 % | 2.0 | 33 % | 1 of 1 | 4.0 / 5.0 | 80 % / 80 % | 67 % | 3 |"
    assert lines.index(row) < lines.index("### With GPS")
    assert sum(line.startswith("| lost, before at 1 Hz") for line in lines) == 1


def test_command_goes_on_from_what_is_finished(tmp_path, monkeypatch) -> None:
    only(monkeypatch, "none", "compass-frozen20")
    options = ["benchmark", "--faults-matrix", "--seeds", "1", "--jobs", "1"]
    first, again = (CliRunner().invoke(app, [*options, "--out", str(tmp_path)]) for _ in range(2))
    assert first.exit_code == again.exit_code == 0, first.output
    assert "`compass-frozen20`" in first.output
    assert (tmp_path / "fault_matrix.md").read_text() in again.output


def test_a_current_sets_in_and_is_not_seen_before() -> None:
    clean, tide, dead = (
        fault_matrix.sailed(UNIT, name) for name in ("none", "current", "left-zero20")
    )
    before = clean.t < 90.0
    for other in (tide, dead):
        np.testing.assert_array_equal(other.truth[before], clean.truth[before])
        np.testing.assert_array_equal(other.cmd, clean.cmd)
    # water that runs east at 1 m/s for 60 s
    assert tide.truth[-1, 1] > clean.truth[-1, 1] + 30.0
    at = int(np.searchsorted(clean.t, 110.0))
    assert dead.truth[at, 3] < clean.truth[at, 3] - 0.3
