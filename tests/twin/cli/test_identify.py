"""``usv-twin identify`` of several runs, and a boat's own prior."""

from __future__ import annotations

import json
import math
import re

import pytest

from tests.twin.cli.command import run
from twin import Log


@pytest.fixture(scope="module")
def second(folder, tmp_path_factory):
    """Return another run of the same boat: the later part of the log."""
    place = tmp_path_factory.mktemp("second")
    (place / "later.toml").write_text((folder / "run.toml").read_text())
    log = Log.read(folder / "run.csv").without_truth()
    log.slice(0.3 * log.t[-1], math.inf).write(place / "later.csv")
    return place / "later.csv"


def test_several_runs_are_combined(folder, second):
    out = run("identify", folder / "run.csv", second).stdout
    assert "from 2 run(s), model mmg" in out and "e+15" not in out
    # each run is forecast with the prior of the other, beside none
    worth = re.search(r"err by (\S+) \(displacement\).* worst of 2 runs by (\S+) and", out)
    assert worth is not None and 0.1 < float(worth[1]) <= float(worth[2]) < 3.0
    assert "no model" in run("identify", folder / "run.csv", second, "-p", "persistence").stdout


def test_a_run_given_twice_counts_once(folder, tmp_path):
    log = folder / "run.csv"
    assert "from 1 run(s)" in run("identify", log, log, "--save-prior", tmp_path / "p").stdout


def test_identify_saves_and_uses_a_prior(folder, second, tmp_path):
    log, kept = folder / "run.csv", tmp_path / "boat.prior"
    out = run("identify", log, second, "--save-prior", kept).stdout
    assert "from 2 run(s), model mmg" in out and 'prior = "boat.prior"' in out
    assert "C_north" not in kept.read_text()  # the current is that of a day
    text = (folder / "run.toml").read_text()
    own = tmp_path / "own.toml"
    own.write_text(text.replace("[particulars]", '[particulars]\nprior = "boat.prior"'))
    again = run("identify", log, "--ship", own, "--json", tmp_path / "a.json").stdout
    assert "starts without it" not in again
    run("identify", log, "--json", tmp_path / "b.json")
    a, b = (json.loads((tmp_path / f"{n}.json").read_text())["parameters_sd"] for n in "ab")
    assert a["X_nn"] < b["X_nn"]
    assert "ukf has the model 'paper'" in run("identify", log, "--ship", own, "-p", "ukf").stdout
    # a prior of runs that began with it would count them twice: they begin without
    run("identify", log, "--ship", own, "--save-prior", tmp_path / "2.prior")
    run("identify", log, "--save-prior", tmp_path / "4.prior")
    assert (tmp_path / "2.prior").read_text() == (tmp_path / "4.prior").read_text()
    for arguments, words in (
        ((log, "--save-prior", kept), "--force"),
        ((log, second, "--json", tmp_path / "x.json"), "--json: that is for one log"),
        ((log, second, "--save-prior", tmp_path / "3.prior", "--save", "x"), "--save: that is for"),
        ((log, "-p", "persistence", "--save-prior", tmp_path / "3.prior"), "no parameters"),
    ):
        assert words in run("identify", *arguments, check=2).stderr
    assert not (tmp_path / "3.prior").exists()
