"""Every command has a help page, and what has left says where it went."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.twin.cli.command import run
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
