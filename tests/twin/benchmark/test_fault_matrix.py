"""The fault matrix: what it measures, and what it keeps."""

import math

import numpy as np
import pytest
from typer.testing import CliRunner

from twin.benchmark.fault_matrix import MATRIX_FAULTS, FaultRun, fault_runs, matrix_table
from twin.benchmark.sensor_faults import SENSOR_FAULTS, simulate_with
from twin.cli.main import app
from usv_gym import SeaState, Vessel


def run_of(fault, seed, recovered=1.0):
    return FaultRun("ukf", fault, seed, recovered, 0.9, 0.8, 2.0, 3.0, 0)


def test_frozen_gyro_is_named_and_forgotten(tmp_path):
    file = tmp_path / "runs.json"
    *_, (done, total, results) = fault_runs(["ukf"], ["gyro-frozen"], [0], file)
    (found,) = results
    assert (done, total) == (1, 1)
    # measured: named after 2 s, normal again after 0 s
    assert found.named < 5.0 and found.recovered < 10.0 and found.others == 0
    assert found.inside_now > 0.8
    # what is finished is not sailed again
    kept = file.read_text()
    ((done, total, again),) = fault_runs(["ukf"], ["gyro-frozen"], [0], file)
    assert again == results and file.read_text() == kept


def test_table_has_a_row_for_each_fault_and_says_never():
    lines = matrix_table([run_of("gps-jump", 0), run_of("gps-jump", 1, math.inf)])
    assert len(lines) == 3
    assert "| GPS jumps by 500 m | `ukf` | never / never |" in lines[2]
    assert lines[2].endswith("| 2 |")


def test_command_goes_on_from_what_is_finished(tmp_path, monkeypatch):
    monkeypatch.setattr("twin.benchmark.fault_matrix.MATRIX_FAULTS", ("compass-turned",))
    options = ["benchmark", "--faults-matrix", "--seeds", "1", "--predictors", "ukf"]
    first, again = (
        CliRunner().invoke(app, [*options, "--jobs", "1", "--out", str(tmp_path)]) for _ in range(2)
    )
    assert first.exit_code == again.exit_code == 0, first.output
    assert "compass turned by 180 deg" in first.output
    assert (tmp_path / "fault_matrix.md").read_text() in again.output


def test_faults_of_the_matrix_are_short():
    assert "garbage-long" not in MATRIX_FAULTS and "clean" in MATRIX_FAULTS


def test_weak_thruster_leaves_the_log_with_the_commands_given():
    boat, sea = Vessel.load("usv75"), SeaState(hs=0.3, wind=3.0)
    clean, weak, tide = (
        simulate_with(SENSOR_FAULTS[name], 20.0, "turn", boat, sea, duration=40.0, seed=1)
        for name in ("clean", "thruster-dead", "current-step")
    )
    before = clean.t < 20.0
    assert (weak.cmd == clean.cmd).all()
    for other in (weak, tide):
        assert (other.truth[before] == clean.truth[before]).all()
    # measured: a dead thruster costs 1.3 m/s in 20 s, and water that runs east at 1 m/s takes 18 m
    assert weak.truth[-1, 3] < clean.truth[-1, 3] - 0.5
    assert tide.truth[-1, 1] > clean.truth[-1, 1] + 10.0


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["thruster-dead", "thruster-weak", "current-step"])
def test_a_boat_that_changes_is_learned_in_half_a_minute(fault, tmp_path):
    *_, (_, _, results) = fault_runs(["dsw-ukf-plus"], [fault], [0, 1, 2], tmp_path / "runs.json")
    # measured on seeds 0-7: 17, 16 and 11 s in the median, 46 s at worst
    assert np.median([found.recovered for found in results]) < 30.0
    assert max(found.recovered for found in results) < 60.0
