"""The command line: results, files, and messages on wrong input."""

from __future__ import annotations

import csv
import gzip
import json
import os
import re
import signal
import subprocess
import sys
import time
from importlib import resources
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import usv_gym
from tests.twin.cli.command import run
from twin import Log, Twin, recorded_runs
from twin.channels import STATE
from twin.cli.benchmark import match_files
from twin.cli.common import parse_seeds
from twin.sim.bridge import particulars_of
from twin.sim.wrapper import log_of
from usv_gym import Vessel

USV75 = (resources.files("usv_gym.vessel") / "vessels" / "usv75.toml").read_text(encoding="utf-8")


def test_simulate_writes_log_and_particulars(folder):
    log = Log.read(folder / "run.csv")
    assert len(log) == 801
    assert log.truth is not None
    lost = (log.t >= 20.0) & (log.t < 25.0)
    assert np.isnan(log.z[lost, 0]).all()
    assert np.isfinite(log.z[log.t > 25.0, 0]).all()
    assert "[particulars]" in (folder / "run.toml").read_text()


def test_identify_equals_the_twin_from_python(folder):
    files = ("--json", folder / "last.json", "--out", folder / "all.csv")
    out = run("identify", folder / "run.csv", *files).stdout
    assert "X_uu" in out
    assert "..." not in out and "\u2026" not in out  # nothing is cut off at 80 columns
    log = Log.read(folder / "run.csv").without_truth()
    twin = Twin(particulars_of(Vessel.load("usv75")))
    twin.run(log)
    estimate = twin.estimate()
    last = json.loads((folder / "last.json").read_text())
    assert list(last["state"].values()) == estimate.state.tolist()
    assert tuple(last["parameters"]) == twin.predictor.parameter_names
    assert list(last["parameters"].values()) == estimate.params.tolist()
    with (folder / "all.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(log)
    assert [float(rows[-1][name]) for name in STATE] == estimate.state.tolist()


def test_commands_that_run_a_twin_print_which_sensor_was_not_ok(folder, tmp_path):
    log, path = Log.read(folder / "run.csv"), tmp_path / "frozen.csv"
    log.z[(log.t >= 8.0) & (log.t < 18.0), 5] = 0.05
    log.write(path)
    path.with_suffix(".toml").write_text((folder / "run.toml").read_text())
    kept = tmp_path / "last.json"
    for command in (("predict", path), ("identify", path, "--json", kept)):
        out = run(*command, "-p", "ukf").stdout
        assert "note: gyro excluded from " in out, command
        assert ": repeats itself while the boat moves" in out
        assert re.search(r"note: gps absent from (19\.9|20\.0) to 25\.", out)
    found = json.loads(kept.read_text())
    assert set(found["health"]["gyro"]) == {"status", "since", "why"}
    assert any(line.startswith("gyro excluded") for line in found["health_notes"])


def test_identify_on_an_episode_equals_the_wrapper(tmp_path):
    faults = [usv_gym.Fault("gps", 5.0, 4.0)]
    env = gym.make("USVTwin-v0", record=True, faults=faults, disable_env_checker=True)
    env.reset(seed=11)
    rng = np.random.default_rng(0)
    for _ in range(300):
        env.step(rng.uniform(-0.2, 1.0, 2).astype(np.float32))
    estimate = env.get_wrapper_attr("twin").estimate()
    log_of(env, tmp_path / "episode.csv")
    run("identify", tmp_path / "episode.csv", "--json", tmp_path / "e.json")
    last = json.loads((tmp_path / "e.json").read_text())
    assert list(last["state"].values()) == estimate.state.tolist()
    assert list(last["parameters"].values()) == estimate.params.tolist()
    assert list(last["parameters_sd"].values()) == estimate.params_sd.tolist()


def test_a_saved_twin_goes_on_as_in_one_run(folder, tmp_path):
    log, kept = folder / "run.csv", tmp_path / "boat.twin"
    run("identify", log, "-p", "ukf", "--json", tmp_path / "whole.json")
    first = run("identify", log, "-p", "ukf", "--until", "22", "--save", kept)
    assert f"the twin at t = 22.00 s: {kept}" in first.stdout.replace("\n", "")
    twin = Twin.load(kept)
    twin.run(Log.read(log).slice(22.01, 1e9))
    whole = json.loads((tmp_path / "whole.json").read_text())
    assert list(whole["state"].values()) == twin.estimate().state.tolist()
    seen = whole["identifiability"]
    assert seen["submodels"]["surge"]["effective_rank"] > 0.5
    assert seen["parameters"]["T_uL"]["merged_into"] == "T_uL + T_uR"
    assert not {"T_uL", "T_uR"} & set(seen["informed"])


def test_predict_prints_intervals_and_writes_them(folder):
    file = folder / "prediction.csv"
    out = run("predict", folder / "run.csv", "--plan", "known", "--at", "25", "--out", file)
    assert "\u2026" not in out.stdout
    table = out.stdout.partition("north m")[2].splitlines()
    rows = [line.split()[0] for line in table if re.match(r" +[0-9]+ ", line)]
    assert rows == ["1", "2", "5", "10"]
    assert all(len(line) <= 80 for line in table if "every 0.1 s" not in line)
    assert "90 % interval" in out.stdout.replace("\n", " ")
    with file.open() as lines:
        last = {name: float(value) for name, value in list(csv.DictReader(lines))[-1].items()}
    assert last["t_s"] == pytest.approx(35.0)
    for name in STATE:
        assert last[f"low_{name}"] < last[name] < last[f"high_{name}"]
    log = Log.read(folder / "run.csv")
    true = log.truth[int(np.searchsorted(log.t, 35.0 - 1e-9))]
    assert np.hypot(last["x_m"] - true[0], last["y_m"] - true[1]) < 8.0
    plan = folder / "plan.csv"
    plan.write_text(
        "t_s,n_left_rps,n_right_rps,delta_left_rad,delta_right_rad\n0,20,20,0,0\n5,20,20,.3,.3\n"
    )
    run("predict", folder / "run.csv", "--plan", plan)


def test_predict_prints_roll_pitch_and_a_quiet_deck(tmp_path):
    log = tmp_path / "deck.csv"
    run("simulate", "heading135", "--dof", "6", "--duration", "60", "--sea", "3", "-o", log)
    out = run("predict", log).stdout
    table = out.partition("roll deg")[2]
    rows = {line.split()[0] for line in table.splitlines() if " +-" in line}
    assert rows == {"0", "1", "2", "3", "5", "10"}
    assert re.search(r"quiet deck for the next: 2 s \d+%, 3 s \d+%, 5 s \d+%", out)
    assert re.search(r"sea: significant height \d\.\d\d m, mean period", out)
    kept = tmp_path / "last.json"
    out = run("identify", log, "-p", "ukf", "--json", kept).stdout
    assert "roll deg" in out and "waves going to" in out
    last = json.loads(kept.read_text())
    true = Log.read(log).true_motion[-1]
    most = 4.0 * last["motion_sd"]["roll_rad"]
    assert last["motion"]["roll_rad"] == pytest.approx(true[1], abs=most)
    assert 0.3 < last["sea"]["hs_m"] < 3.0


def test_oracle_needs_a_simulated_run(folder):
    run("predict", folder / "run.csv", "--predictor", "oracle", "--at", "30")
    real = recorded_runs()["boat1_usv_circle"]
    for more in ((), ("--ship", "usv75")):
        refused = run("predict", real, "--predictor", "oracle", *more, check=2)
        assert refused.stderr.count("\n") == 1
        assert "the true boat of 'boat1_usv_circle' is not known" in refused.stderr


HEADER = "t_s,n_left_rps,n_right_rps,delta_left_rad,delta_right_rad,gps_x_m,gps_y_m,compass_rad\n"
ROWS = "".join(f"{k / 10},5,5,0,0,{k * 0.1},{k * 0.2},{0.1 + 0.001 * k}\n" for k in range(50))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HEADER.replace("compass_rad", "magnet") + ROWS, ["compass_rad"]),
        (HEADER + ROWS + "1.0,5,5,0,0,1,1,1\n", ["line 52", "t_s"]),
        (HEADER + ROWS.replace("0.3,5,5", "0.3,5,five"), ["five", "n_right_rps"]),
        (
            HEADER + "".join(f"{k / 10},5,5,0,0,{k},{k},0.5\n" for k in range(50)),
            ["compass_rad", "empty"],
        ),
        ("", ["empty"]),
        (HEADER, ["no row"]),
    ],
)
def test_broken_logs_are_refused_with_the_place(tmp_path, text, words):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    error = run("identify", path, check=2).stderr
    assert error.startswith("error: ")
    assert all(word in error for word in ("bad.csv", *words)), error


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("mass = {", "weight = {"), ["[particulars] weight", "unknown key"]),
        (('unit = "kg", source = "Qu', 'source = "Qu'), ["mass", "unit"]),
        (("value = 3420.0", "value = -3420.0"), ["mass", "above 0"]),
        (("[particulars]", "[particulars"), ["not valid TOML"]),
    ],
)
def test_broken_vessels_are_refused_with_the_key(empty, change, words):
    assert change[0] in USV75
    (empty / "boat.toml").write_text(USV75.replace(*change, 1))
    error = run("simulate", "--vessel", "boat.toml", "--duration", "1", check=2).stderr
    assert all(word in error for word in ("boat.toml", *words)), error


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("simulate loop", ["loop", "zigzag"]),
        ("simulate --sea 9", ["9", "calm"]),
        ("simulate --hs -1", ["hs = -1"]),
        ("simulate --faults radar10", ["radar", "gps"]),
        ("simulate --vessel boat.toml", ["boat.toml", "cannot be read"]),
        ("identify none.csv", ["none.csv"]),
        ("benchmark --predictors magic", ["magic", "dsw-ukf"]),
        ("predict no.csv --predictor uckf", ["'uckf'", "did you mean 'ukf'?", "persistence-8s"]),
        ("predict no.csv --plan hodl", ["plan hodl", "use hold, known"]),
        ("benchmark --seeds 5:5", ["--seeds"]),
        ("benchmark --predictors ukf --against lstm", ["--against lstm", "ukf"]),
        ("benchmark --spread 2", ["spread = 2"]),
        ("benchmark --cases base", ["--full"]),
        ("benchmark --full --cases storm", ["storm", "gps30", "sea4"]),
        ("benchmark --full --faults none", ["--cases"]),
        ("benchmark --backend mpi", ["mpi", "loky", "dask"]),
        ("benchmark --predictors no_body:Mine", ["no_body:Mine", "working directory"]),
        ("benchmark none.csv", ["none.csv", "no such file"]),
        ("benchmark /nowhere/*.csv", ["/nowhere/*.csv", "no such file"]),
        ("benchmark .", [".: no such file", "pattern"]),
    ],
)
def test_wrong_options_are_named_and_nothing_is_written(empty, arguments, words):
    error = run(*arguments.split(), check=2).stderr
    assert all(word in error for word in words), error
    assert not list(empty.iterdir())


def test_benchmark_end_to_end(empty):
    two = ("--predictors", "persistence,ukf")
    cases = ("--scenarios", "zigzag", "--faults", "gps5", "--seeds", "0:2")
    said = run("benchmark", *cases, *two, "--out", "out", "--jobs", "1").stdout
    # the verdict comes first, then where the report is; the other tables stay in the report
    assert said.startswith("10 s ahead ukf is ") and "report: out/report.html" in said
    assert "MSE" in said and "CRPS" not in said
    results = json.loads(Path("out/results.json").read_text())
    assert {"version", "command", "rows", "summary"} <= set(results)
    assert {row["scenario"] for row in results["rows"]} == {"zigzag", "boat1_usv_circle"}
    assert Path("out/report.html").stat().st_size > 10_000
    log = Path("out/logs/zigzag_gps5_0.csv")
    run("identify", log, "--until", "20")
    logs = (log, log.with_name("zigzag_gps5_1.csv"))
    again = run("benchmark", *logs, *two, "--faults", "none", "--out", "again", "--jobs", "1")
    assert "zigzag_gps5_1" in again.stdout
    Path("broken.csv").write_text("t_s\n1\n")
    logs = ("broken.csv", log, "missing.csv")
    one = ("--predictors", "persistence", "--jobs", "1")
    mixed = run("benchmark", *logs, *one, "--out", "mixed", check=1)
    assert "broken.csv" in mixed.stderr and "missing.csv" in mixed.stderr
    results = json.loads(Path("mixed/results.json").read_text())
    assert {row["scenario"] for row in results["rows"]} == {"zigzag_gps5_0"}
    assert {row["fault"] for row in results["rows"]} == {"none"}
    assert any("not scored" in note and "broken.csv" in note for note in results["notes"])
    none = run("benchmark", "broken.csv", "--out", "none", "--jobs", "1", check=2)
    assert none.stderr.count("not scored: broken.csv") == 1
    assert "nothing could be scored" in none.stderr


def test_the_full_protocol_can_be_restricted(empty):
    parts = (
        "--full",
        "--seeds",
        "200",
        "--scenarios",
        "turn",
        "--cases",
        "base,gps5,gps10",
    )
    options = ("--predictors", "persistence", "--out", "out", "--jobs", "1")
    done = run("benchmark", *parts, *options)
    assert "report: out/report.html" in done.stdout
    results = json.loads(Path("out/results.json").read_text())
    assert [case["name"] for case in results["settings"]["cases"]] == ["base", "gps5", "gps10"]
    assert "rows" not in results and "runs" not in results
    assert {row["plan"] for row in results["summary"]} == {"known"}
    table = gzip.decompress(Path("out/rows.csv.gz").read_bytes()).decode().splitlines()
    assert len(table) == 1 + 3 * 6 * 4 and table[0].startswith("scenario,case,fault,sea,grade,seed")


@pytest.mark.skipif(os.name == "nt", reason="signals are POSIX")
def test_ctrl_c_keeps_what_is_finished(empty):
    arguments = "benchmark --scenarios turn,zigzag --seeds 0:20 --predictors persistence"
    process = subprocess.Popen(
        [sys.executable, "-m", "twin.cli", *arguments.split(), "--jobs", "1", "--out", "out"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 200
    while len(list(Path("out").glob("runs/[!.]*.json"))) < 3 and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "goes on from there" in error
    assert "Traceback" not in error
    assert len(list(Path("out").glob("runs/[!.]*.json"))) >= 3
    assert json.loads(Path("out/results.json").read_text())["rows"]


def test_seeds_are_ranges_and_lists():
    assert parse_seeds("2:5") == (2, 3, 4)
    assert parse_seeds(":2") == (0, 1)
    assert parse_seeds("7,3,7") == (7, 3)
    assert parse_seeds("200-202") == (200, 201, 202)
    assert parse_seeds("0-1,5,8:10") == (0, 1, 5, 8, 9)


def test_patterns_that_the_shell_has_not_expanded(empty):
    runs = empty / "runs"
    (runs / "dir.csv").mkdir(parents=True)
    for name in ("b.csv", "a.csv", "a.toml", "[1].csv"):
        (runs / name).touch()
    for start in (Path(), empty):
        folder = start / "runs"
        assert match_files(folder / "[ab].csv") == [str(folder / "a.csv"), str(folder / "b.csv")]
        assert match_files(start / "*" / "b.*") == [str(folder / "b.csv")]
        # a file of that very name comes first
        assert match_files(folder / "[1].csv") == [str(folder / "[1].csv")]


PARTICULARS = ("--length", "6.3", "--beam", "2.5", "--draft", "0.5", "--mass", "3000")


def test_a_new_vessel_is_checked_and_simulated(empty):
    new = ("vessel", "new", "--name", "mine", *PARTICULARS, "--speed", "15")
    out = run(*new).stdout
    assert "note: Kijima 1990: L/B is 2.52" in out and "estimates" in out
    path = empty / "mine.toml"
    text = path.read_text(encoding="utf-8")
    assert "15 kn in service" in text and "guess = true" in text
    found = run("vessel", "check", "mine.toml").stdout
    assert "0 error(s), 0 warning(s)" in found
    (speed,) = re.findall(r"speed, service m/s\s+([\d.]+)", found)
    assert abs(float(speed) - 15.0 * 1852.0 / 3600.0) < 0.03
    run("simulate", "turn", "--vessel", "mine.toml", "--duration", "10")

    again = run(*new, check=2)
    assert "mine.toml: is there already" in again.stderr and "--force" in again.stderr
    assert path.read_text(encoding="utf-8") == text
    run(*new, "--force", "--units", "1")
    assert path.read_text(encoding="utf-8") != text
    assert not list(empty.glob(".*"))  # no partial file is left


def test_vessel_check_reports_errors_and_warnings(tmp_path):
    good = run("vessel", "check", "kvlcc2_l7")
    assert "In sea state 4 it capsizes" in good.stdout.replace("\n", " ")
    assert "0 error(s), 2 warning(s)" in good.stdout
    bad, box = tmp_path / "bad.toml", USV75.replace('hydro = "usv75.nc"\n', "")
    bad.write_text(box.replace("A_wp = { value = 13.41", "A_wp = { value = 18"))
    assert "error: A_wp = 18 m2" in run("vessel", "check", bad, check=1).stdout
    bad.write_text(USV75.replace("mass = { value = 3420", "mass = { value = 9000"))
    refused = run("vessel", "check", bad, check=2).stderr
    assert refused.count("\n") == 1
    assert "[particulars] mass" in refused and "within 20 %" in refused
    assert "known: kvlcc2" in run("vessel", "check", "bismarck", check=2).stderr


def test_vessel_new_refuses_what_does_not_float(empty):
    refused = run("vessel", "new", "--name", "x", *PARTICULARS[:-1], "30000", check=2).stderr
    assert refused.startswith("error: mass = 30000 kg")
    assert refused.count("\n") == 1
    assert not list(empty.iterdir())
