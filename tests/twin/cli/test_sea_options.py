"""Options of a sea that changes, on the command line."""

from __future__ import annotations

import numpy as np
import pytest

from tests.twin.cli.command import run
from twin import Log
from twin.channels import MEASUREMENTS


def test_the_sea_of_a_simulated_run_changes_as_asked(empty):
    options = ("--duration", "30", "--sensors", "best", "--wind-from", "0")
    run("simulate", "turn", *options, "--wind", "1@5,12@15", "--hs", "0.1@0,0.4@20", "-o", "a.csv")
    log = Log.read("a.csv")
    speed = log.z[:, MEASUREMENTS.index("apparent_wind_mps")]
    early, late = (np.nanmean(speed[(log.t > a) & (log.t < a + 4.0)]) for a in (1.0, 24.0))
    assert late > early + 3.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--hs", "0.9@60,0.3@0"), "hs = '0.9@60,0.3@0': times must rise"),
        (("--hs=-1@0,1@9",), "schedule[0].hs = -1.0: must lie between 0 and 20"),
        (("--wind", "nan@0"), "wind = 'nan@0': 'nan@0' is not finite"),
        (("--wind", "strong"), "wind = 'strong': write one number"),
        (("--wind-from", "90@0,east@9"), "wind_from = '90@0,east@9': write one number"),
    ],
)
@pytest.mark.parametrize("command", [("simulate", "turn"), ("benchmark",)])
def test_a_sea_that_makes_no_sense_is_one_line(empty, command, options, message):
    output = " ".join(run(*command, *options, check=2).output.split())
    assert message in output and "Traceback" not in output


def test_a_fault_of_the_wind_without_an_anemometer_is_said(empty):
    options = ("--duration", "20", "--faults", "wind5@5", "-o", "b.csv")
    assert "no anemometer" in " ".join(run("simulate", "turn", *options).output.split())
