"""The command line as a user meets it: results, files, and what it says of bad input."""

from __future__ import annotations

import csv
import gzip
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import usv_gym
from twin import Log, Twin, recorded_runs
from twin.channels import CHANNELS
from twin.cli import benchmark
from twin.cli.benchmark import _matching
from twin.cli.common import seeds_of
from twin.cli.main import _expand, main
from twin.sim.bridge import particulars_of
from twin.sim.wrapper import log_of
from usv_gym import Vessel


def run(*arguments: str, cwd=None, check: int | None = 0) -> subprocess.CompletedProcess[str]:
    result = subprocess.run(
        [sys.executable, "-m", "twin.cli", *arguments],
        capture_output=True,
        text=True,
        cwd=cwd,
        timeout=300,
    )
    assert "Traceback" not in result.stderr + result.stdout
    if check is not None:
        assert result.returncode == check, result.stderr + result.stdout
    return result


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("cli")
    run(
        *("simulate", "zigzag", "--duration", "40", "--seed", "3", "--faults", "gps5"),
        *("--fault-start", "20", "--out", str(path / "run.csv")),
    )
    return path


def test_simulate_writes_log_particulars_and_picture(folder):
    log = Log.read(folder / "run.csv")
    assert len(log) == 801
    assert log.truth is not None
    lost = (log.t >= 20.0) & (log.t < 25.0)
    assert np.isnan(log.z[lost, 0]).all()
    assert np.isfinite(log.z[log.t > 25.0, 0]).all()
    assert (folder / "run.png").read_bytes().startswith(b"\x89PNG")
    assert "[particulars]" in (folder / "run.toml").read_text()


def test_identify_equals_the_twin_in_python(folder):
    out = run(
        *("identify", str(folder / "run.csv"), "--json", str(folder / "last.json")),
        *("--out", str(folder / "all.csv")),
    )
    assert "X_uu" in out.stdout
    log = Log.read(folder / "run.csv").without_truth()
    twin = Twin(particulars_of(Vessel.load("usv75")))
    twin.run(log)
    estimate = twin.estimate()
    assert "..." not in out.stdout  # nothing is cut off at 80 columns
    assert "\u2026" not in out.stdout
    last = json.loads((folder / "last.json").read_text())
    assert list(last["state"].values()) == estimate.state.tolist()
    assert tuple(last["parameters"]) == twin.predictor.parameter_names
    assert list(last["parameters"].values()) == estimate.params.tolist()
    with (folder / "all.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(log)
    assert [float(rows[-1][name]) for name in CHANNELS] == estimate.state.tolist()


def test_wrapper_equals_identify_on_the_log_of_the_same_run(tmp_path):
    env = gym.make(
        "USVTwin-v0", record=True, faults=[usv_gym.Fault("gps", 5.0, 4.0)], disable_env_checker=True
    )
    env.reset(seed=11)
    rng = np.random.default_rng(0)
    for _ in range(300):
        env.step(rng.uniform(-0.2, 1.0, 2).astype(np.float32))
    believed = env.get_wrapper_attr("twin").estimate()
    log_of(env, tmp_path / "episode.csv")
    run("identify", str(tmp_path / "episode.csv"), "--json", str(tmp_path / "e.json"))
    last = json.loads((tmp_path / "e.json").read_text())
    assert list(last["state"].values()) == believed.state.tolist()
    assert list(last["parameters"].values()) == believed.params.tolist()
    assert list(last["parameters_sd"].values()) == believed.params_sd.tolist()


def test_predict_prints_bands_and_writes_them(folder):
    out = run(
        *("predict", str(folder / "run.csv"), "--plan", "known", "--at", "25"),
        *("--out", str(folder / "prediction.csv")),
    )
    assert "90 % band" in out.stdout
    with (folder / "prediction.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["t_s"]) == pytest.approx(35.0)
    for name in CHANNELS:
        assert float(rows[-1][f"low_{name}"]) < float(rows[-1][name])
        assert float(rows[-1][f"high_{name}"]) > float(rows[-1][name])
    log = Log.read(folder / "run.csv")
    k = int(np.searchsorted(log.t, 35.0 - 1e-9))
    miss = np.hypot(
        float(rows[-1]["x_m"]) - log.truth[k, 0], float(rows[-1]["y_m"]) - log.truth[k, 1]
    )
    assert miss < 8.0
    plan = folder / "plan.csv"
    plan.write_text(
        "t_s,n_left_rps,n_right_rps,delta_left_rad,delta_right_rad\n0,20,20,0,0\n5,20,20,.3,.3\n"
    )
    run("predict", str(folder / "run.csv"), "--plan", str(plan))


def test_predict_on_the_recorded_run():
    out = run("predict", str(recorded_runs()["boat1_usv_circle"]), "--at", "100")
    assert "boat1 USV" in out.stdout


def write(path, text):
    path.write_text(text)
    return str(path)


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
def test_broken_logs(tmp_path, text, words):
    path = write(tmp_path / "bad.csv", text)
    result = run("identify", path, check=2)
    assert result.stderr.startswith("error: ")
    assert "bad.csv" in result.stderr
    for word in words:
        assert word in result.stderr, result.stderr


def test_gaps_and_empty_cells_are_reported(tmp_path):
    rows = ROWS.splitlines()
    rows[10] = rows[10].replace(",1.0,2.0,", ",,nan,")
    del rows[20:40]
    path = write(tmp_path / "gappy.csv", HEADER + "\n".join(rows) + "\n")
    result = run("identify", path)
    assert "gps_x_m: 1 of 30 cells empty" in result.stdout
    assert "gap" in result.stdout


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("mass = {", "weight = {"), ["[particulars] weight", "unknown key"]),
        (('unit = "kg", source = "Qu', 'source = "Qu'), ["mass", "unit"]),
        (("value = 3420.0", "value = -3420.0"), ["mass", "above 0"]),
        (("[particulars]", "[particulars"), ["not valid TOML"]),
    ],
)
def test_broken_vessels(tmp_path, change, words):
    from importlib import resources

    text = (resources.files("usv_gym.vessel") / "vessels" / "usv75.toml").read_text()
    assert change[0] in text
    path = write(tmp_path / "boat.toml", text.replace(*change, 1))
    result = run("simulate", "--vessel", path, "--duration", "1", check=2, cwd=tmp_path)
    assert "boat.toml" in result.stderr
    for word in words:
        assert word in result.stderr, result.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["simulate", "loop"], ["loop", "zigzag"]),
        (["simulate", "--sea", "9"], ["9", "calm"]),
        (["simulate", "--hs", "-1"], ["hs = -1"]),
        (["simulate", "--faults", "radar10"], ["radar", "gps"]),
        (["simulate", "--vessel", "boat.toml"], ["boat.toml", "cannot be read"]),
        (["identify", "none.csv"], ["none.csv"]),
        (["benchmark", "--predictors", "magic"], ["magic", "dsw-ukf"]),
        (["benchmark", "--seeds", "5:5"], ["--seeds"]),
        (["benchmark", "--predictors", "ukf", "--against", "lstm"], ["--against lstm", "ukf"]),
        (["benchmark", "--spread", "2"], ["spread = 2"]),
        (["benchmark", "--cases", "base"], ["--full"]),
        (["benchmark", "--full", "--cases", "storm"], ["storm", "gps30", "sea4"]),
        (["benchmark", "--full", "--faults", "none"], ["--cases"]),
        (["benchmark", "--backend", "mpi"], ["mpi", "loky", "dask"]),
        (["benchmark", "--predictors", "no_body:Mine"], ["no_body:Mine", "working directory"]),
        (["benchmark", "--log", "none.csv"], ["none.csv", "no such file"]),
        (["benchmark", "--log", "/nowhere/*.csv"], ["/nowhere/*.csv", "no such file"]),
        (["benchmark", "--log", "."], [".: no such file", "pattern"]),
    ],
)
def test_wrong_words(tmp_path, arguments, words):
    result = run(*arguments, check=2, cwd=tmp_path)
    for word in words:
        assert word in result.stderr, result.stderr
    assert not list(tmp_path.iterdir())


def test_benchmark_end_to_end(tmp_path):
    arguments = [
        *("benchmark", "--scenarios", "zigzag", "--faults", "gps5", "--seeds", "0:2"),
        *("--predictors", "persistence,ukf", "--out", "out", "--jobs", "1"),
    ]
    out = run(*arguments, cwd=tmp_path)
    assert "ukf" in out.stdout
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert {"version", "command", "rows", "summary"} <= set(results)
    assert {row["scenario"] for row in results["rows"]} == {"zigzag", "boat1_usv_circle"}
    assert (tmp_path / "out" / "report.html").stat().st_size > 10_000
    log = tmp_path / "out" / "logs" / "zigzag_gps5_0.csv"
    run("identify", str(log), "--until", "20")
    scored = run(
        *("benchmark", "--log", str(log), str(log.with_name("zigzag_gps5_1.csv"))),
        *("--predictors", "persistence,ukf", "--faults", "none", "--out", "again"),
        cwd=tmp_path,
    )
    assert "zigzag_gps5_1" in scored.stdout
    broken = tmp_path / "broken.csv"
    broken.write_text("t_s\n1\n")
    mixed = run(
        *("benchmark", "--log", str(broken), str(log), "away.csv", "--predictors", "persistence"),
        *("--out", "mixed"),
        cwd=tmp_path,
    )
    for name in ("broken.csv", "away.csv"):
        assert name in mixed.stderr
    results = json.loads((tmp_path / "mixed" / "results.json").read_text())
    assert {row["scenario"] for row in results["rows"]} == {"zigzag_gps5_0"}
    assert {row["fault"] for row in results["rows"]} == {"none"}
    assert any("not scored" in note and "broken.csv" in note for note in results["notes"])
    none = run("benchmark", "--log", str(broken), "--out", "none", check=2, cwd=tmp_path)
    assert none.stderr.count("broken.csv") == 1 and "nothing could be scored" in none.stderr


def test_the_full_protocol_can_be_thinned(tmp_path):
    done = run(
        *("benchmark", "--full", "--seeds", "200", "--scenarios", "turn", "--jobs", "1"),
        *("--cases", "base,gps5,gps10", "--predictors", "persistence", "--out", "out"),
        *("--backend", "threading"),
        cwd=tmp_path,
    )
    assert "case gps5" in done.stdout
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert [case["name"] for case in results["settings"]["cases"]] == ["base", "gps5", "gps10"]
    assert "rows" not in results and "runs" not in results
    assert {row["plan"] for row in results["summary"]} == {"known"}
    assert {row["at"] for row in results["trends"]} == {0, 5, 10}
    table = gzip.decompress((tmp_path / "out" / "rows.csv.gz").read_bytes()).decode().splitlines()
    assert len(table) == 1 + 3 * 6 * 4 and table[0].startswith("scenario,case,fault,sea,grade,seed")
    assert (tmp_path / "out" / "pictures" / "trend_gps_loss_s.svg").exists()


def test_a_predictor_that_cannot_run_has_a_row_that_says_so(capsys):
    from twin.cli.benchmark import _print_benchmark

    item = {"scenario": "turn", "fault": "none", "predictor": "ukf", "plan": "known"}
    item |= {"metric": "mae", "value": 0.2, "low": None, "high": None}
    _print_benchmark({"summary": [item], "notes": ["lstm is left out: no [torch]"]}, ["lstm"])
    out = capsys.readouterr().out
    assert "left out" in out.split("lstm", 1)[1].splitlines()[0]
    assert "no [torch]" in out


def test_the_table_fits_into_80_columns(capsys, monkeypatch):

    monkeypatch.setattr(main.console, "_width", 80)
    cell = {"scenario": "turn-zigzag", "fault": "gps10", "plan": "known"}
    cell |= {"predictor": "persistence-8s", "case": "gps10"}
    worst = {"mae": 13.15, "mse": 88.45, "skill": -1.516, "J": 27.84, "E": 26.84}
    summary = [
        {**cell, "metric": metric, "value": worst.get(metric, 1.212), "low": 10.4, "high": 153.5}
        for metric in main.bench.METRICS
    ]
    pair = {**cell, "against": "dsw-ukf-plus", "change_percent": 1801.2, "median_percent": 1.0}
    pair |= {"low": 1364.3, "high": 2403.3, "wins": 0, "seeds": 24}
    benchmark._print_benchmark({"summary": summary, "paired": [pair], "notes": []}, [])
    out = capsys.readouterr().out
    assert "\u2026" not in out
    assert "+1801.2" in out and "0 of 24" in out and "10.4..154" in out and "persistence-8s" in out


@pytest.mark.skipif(os.name == "nt", reason="signals are POSIX")
def test_ctrl_c_keeps_what_is_finished(tmp_path):
    arguments = [
        *(sys.executable, "-m", "twin.cli", "benchmark", "--scenarios", "turn,zigzag"),
        *("--seeds", "0:20", "--predictors", "persistence,ukf", "--jobs", "1", "--out", "out"),
    ]
    process = subprocess.Popen(
        arguments, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 200
    while len(list((tmp_path / "out").glob("runs/*.json"))) < 5 and time.monotonic() < deadline:
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "goes on from there" in error
    assert "Traceback" not in error
    kept = len(list((tmp_path / "out").glob("runs/*.json")))
    assert kept >= 5
    assert json.loads((tmp_path / "out" / "results.json").read_text())["rows"]


def test_oracle_on_a_simulated_and_on_a_recorded_run(folder):
    run("predict", str(folder / "run.csv"), "--predictor", "oracle", "--at", "30")
    real = str(recorded_runs()["boat1_usv_circle"])
    for more in ((), ("--ship", "usv75")):
        refused = run("predict", real, "--predictor", "oracle", *more, check=2)
        assert refused.stderr.count("\n") == 1
        assert "the true boat of 'boat1_usv_circle' is not known" in refused.stderr


def test_seeds():
    assert seeds_of("2:5") == (2, 3, 4)
    assert seeds_of(":2") == (0, 1)
    assert seeds_of("7,3,7") == (7, 3)
    assert seeds_of("200-202") == (200, 201, 202)
    assert seeds_of("0-1,5,8:10") == (0, 1, 5, 8, 9)


def test_several_files_after_one_option():
    words = ["benchmark", "--log", "a", "b", "--jobs", "2", "--log", "c"]
    assert _expand(words) == [
        *("benchmark", "--log", "a", "--log", "b", "--jobs", "2", "--log", "c")
    ]


def test_patterns_that_the_shell_has_left(tmp_path, monkeypatch):
    (tmp_path / "runs" / "dir.csv").mkdir(parents=True)
    for name in ("b.csv", "a.csv", "a.toml", "[1].csv"):
        (tmp_path / "runs" / name).touch()
    monkeypatch.chdir(tmp_path)
    for start in (Path(), tmp_path):
        folder = start / "runs"
        assert _matching(folder / "[ab].csv") == [str(folder / "a.csv"), str(folder / "b.csv")]
        assert _matching(start / "*" / "b.*") == [str(folder / "b.csv")]
        # a file of that very name comes first
        assert _matching(folder / "[1].csv") == [str(folder / "[1].csv")]


@pytest.mark.parametrize("command", ["simulate", "identify", "predict", "benchmark", "validate"])
def test_help(command):
    assert "Usage" in run(command, "--help").stdout


PARTICULARS = ("--length", "6.3", "--beam", "2.5", "--draft", "0.5", "--mass", "3000")


def test_a_new_vessel_is_checked_and_simulated(tmp_path):
    new = ("vessel", "new", "--name", "mine", *PARTICULARS, "--speed", "15")
    out = run(*new, cwd=tmp_path).stdout
    assert "note: Kijima 1990: L/B is 2.52" in out and "estimates" in out
    text = (tmp_path / "mine.toml").read_text(encoding="utf-8")
    assert "15 kn in service" in text and "guess = true" in text
    found = run("vessel", "check", "mine.toml", "--json", "mine.json", "--strict", cwd=tmp_path)
    assert "0 error(s), 0 warning(s)" in found.stdout
    content = json.loads((tmp_path / "mine.json").read_text(encoding="utf-8"))
    assert content["findings"] == []
    assert any(abs(row["speed_kn"] - 15.0) < 0.05 for row in content["speeds"])
    run("simulate", "turn", "--vessel", "mine.toml", "--duration", "10", cwd=tmp_path)

    again = run(*new, cwd=tmp_path, check=2)
    assert "mine.toml: is there already" in again.stderr and "--force" in again.stderr
    assert (tmp_path / "mine.toml").read_text(encoding="utf-8") == text
    run(*new, "--force", "--power", "100", cwd=tmp_path)
    assert (tmp_path / "mine.toml").read_text(encoding="utf-8") != text
    assert [path.name for path in tmp_path.glob(".*")] == []  # no partial file is left


def test_vessel_check_says_what_is_wrong(tmp_path):
    good = run("vessel", "check", "kvlcc2_l7")
    assert "0 error(s), 1 warning(s)" in good.stdout
    assert run("vessel", "check", "kvlcc2_l7", "--strict", check=1).stdout == good.stdout
    text = (Path(usv_gym.__file__).parent / "vessel" / "vessels" / "usv75.toml").read_text(
        encoding="utf-8"
    )
    bad = tmp_path / "bad.toml"
    bad.write_text(text.replace("A_wp = { value = 13.41", "A_wp = { value = 18"))
    assert "error: A_wp is 18 m2, above length" in run("vessel", "check", str(bad), check=1).stdout
    bad.write_text(text.replace("mass = { value = 3420", "mass = { value = 9000"))
    refused = run("vessel", "check", str(bad), check=2)
    assert refused.stderr.count("\n") == 1
    assert "[particulars] mass" in refused.stderr and "within 20 %" in refused.stderr
    assert "known: kvlcc2" in run("vessel", "check", "bismarck", check=2).stderr


def test_vessel_new_refuses_what_is_no_ship(tmp_path):
    heavy = ("vessel", "new", "--name", "x", *PARTICULARS[:-1], "30000")
    refused = run(*heavy, cwd=tmp_path, check=2)
    assert refused.stderr.startswith("error: mass = 30000 kg")
    assert refused.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_save_and_resume_are_one_run(folder, tmp_path):
    log, kept = str(folder / "run.csv"), tmp_path / "boat.twin"
    whole = run("identify", log, "-p", "ukf", "--json", str(tmp_path / "whole.json"))
    first = run("identify", log, "-p", "ukf", "--until", "22", "--save", str(kept))
    assert f"the twin at t = 22.00 s: {kept}" in first.stdout.replace("\n", "")
    run(
        *("identify", log, "--resume", str(kept), "--json", str(tmp_path / "later.json")),
        *("--save", str(kept)),
    )
    whole, later = (json.loads((tmp_path / f"{n}.json").read_text()) for n in ("whole", "later"))
    assert whole == later
    seen = whole["identifiability"]
    assert seen["submodels"]["surge"]["effective_rank"] > 0.5
    assert seen["parameters"]["T_uL"]["merged_into"] == "T_uL + T_uR"
    assert not {"T_uL", "T_uR"} & set(seen["informed"])
    for arguments, message in (
        (("--resume", str(kept)), "has no row after t = 40 s"),
        (("--resume", str(kept), "-p", "persistence"), "goes on with ukf; leave it out"),
        (("--resume", str(kept), "--ship", "usv75"), "knows its boat; leave it out"),
        (("--resume", log), "is no saved state of a twin"),
        (("--resume", str(tmp_path / "none")), "No such file"),
    ):
        refused = run("identify", log, *arguments, check=2)
        assert message in refused.stderr.replace("\n", " ")


def test_identify_prints_what_the_data_say(folder):
    out = run("identify", str(folder / "run.csv"), "-p", "ukf").stdout
    assert "sums of collinear parameters" in out and "T_uL + T_uR" in out
    assert "condition number" in out and "effective rank" in out
    assert "\u2026" not in out
