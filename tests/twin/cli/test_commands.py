"""Every command has a help page, and what has left says where it went."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import twin
from tests.twin.cli.command import run
from twin.agents.policy import Policy
from twin.cli.main import COMMANDS, MOVED, VESSEL_COMMANDS, moved

KEPT = "benchmark check mapping identify predict simulate train evaluate view link sitl vessel"


def test_these_commands_exist():
    assert {*COMMANDS, "vessel"} == set(KEPT.split())
    assert not {name for name in MOVED if name in KEPT.split()}


@pytest.mark.parametrize(
    "command", [*((name,) for name in COMMANDS), *(("vessel", name) for name in VESSEL_COMMANDS)]
)
def test_a_command_has_help(command):
    assert "Usage" in run(*command, "--help").stdout


@pytest.mark.parametrize("name", MOVED)
def test_a_former_name_answers_with_the_new_one(name):
    assert MOVED[name] in moved([*name.split(), "run.csv", "--strict"])


@pytest.mark.parametrize("name", ["mapping", "vessel check", "check"])
def test_a_command_is_not_taken_for_a_former_one(name):
    assert moved([*name.split(), "new.csv"]) == ""


def test_a_former_name_is_one_line_and_exit_code_2():
    command = [sys.executable, "-m", "twin.cli", "log", "check", "run.csv"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[3])
    assert done.returncode == 2 and not done.stdout
    assert done.stderr.count("\n") == 1 and "usv-twin check" in done.stderr


def test_the_version_is_that_of_the_package():
    assert run("--version").stdout == f"usv-twin {twin.__version__}\n"


def test_what_is_printed_of_objects_is_one_line():
    log = twin.Log.read(twin.recorded_runs()["boat1_usv_circle"]).slice(0.0, 70.0)
    boat = log_particulars()
    one = twin.Twin(boat, "persistence")
    one.run(log)
    policy = Policy(
        "mine", "raw", ("a", "b"), {}, np.zeros(2), np.ones(2), 5.0,
        [(np.zeros((8, 2)), np.zeros(8)), (np.zeros((2, 8)), np.zeros(2))],
    )  # fmt: skip
    for item, words in (
        (log, ["boat1_usv_circle", "rows"]),
        (one, ["persistence of boat1 USV", "t = 69"]),
        (one.predict("hold", horizon=5.0), ["5 s ahead"]),
        (one.estimate(), ["t = 69", f"{one.estimate().state[0]:.3g}"]),
        (policy, ["mine", "raw of 2 entries", "8-2"]),
    ):
        assert len(repr(item)) < 90 and all(word in repr(item) for word in words), repr(item)


def log_particulars():
    path = twin.recorded_runs()["boat1_usv_circle"]
    return twin.Particulars.load(path.with_name("boat1_usv_circle.toml"))
