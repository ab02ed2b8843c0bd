"""``usv-twin check``: exit codes, files, and answers on logs of every quality."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil

import numpy as np
import polars as pl
import pytest

from tests.twin.cli.command import run
from twin import Log, Particulars
from twin.benchmark.figures.style import new_figure
from twin.cli import pictures


@pytest.fixture
def faulty(folder, tmp_path):
    """Return a log in knots, with a mirrored gyro and angles in degrees, without particulars."""
    log = Log.read(folder / "run.csv").without_truth()
    log.z[:, 2:4] /= 1852.0 / 3600.0
    log.z[:, 5] *= -1.0
    log.cmd[:, 2:] *= 180.0 / np.pi
    log.write(tmp_path / "bad.csv")
    return tmp_path / "bad.csv"


def codes(path, severity):
    """Return codes and sensors of findings in a file of --json."""
    found = json.loads(path.read_text())["findings"]
    return {
        f"{finding['code']} {finding['sensor']}"
        for finding in found
        if finding["severity"] == severity
    }


def test_a_sound_log_has_no_error_and_a_twin_that_may_be_trusted(folder, tmp_path):
    files = ("--out", tmp_path / "a.png", "--json", tmp_path / "a.json")
    out = run("check", folder / "run.csv", "-p", "ukf", *files).stdout
    verdict = json.loads((tmp_path / "a.json").read_text())["verdict"]
    assert verdict["grade"] in ("ok", "doubtful")
    assert [answer["about"] for answer in verdict["answers"]] == [
        "forecast",
        "coverage",
        "without GPS",
        "parameters",
        "sensors",
    ]
    assert all(answer["text"] in out for answer in verdict["answers"])
    assert not codes(tmp_path / "a.json", "error")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_without_a_twin_the_log_alone_is_checked(folder, tmp_path):
    files = ("--no-twin", "--no-picture", "--json", tmp_path / "a.json")
    run("check", folder / "run.csv", *files)
    assert json.loads((tmp_path / "a.json").read_text())["verdict"] is None
    run("check", folder / "run.csv", *files, "--strict", check=1)  # fixes are missing


def test_faults_are_named_and_particulars_are_begun(faulty, tmp_path):
    files = ("--no-picture", "--json", tmp_path / "a.json", "--write", tmp_path / "boat.toml")
    out = run("check", faulty, *files, check=1).stdout
    assert codes(tmp_path / "a.json", "error") == {"unit velocity", "sign gyro", "unit steering"}
    assert "--ship" in out  # what the second part needs
    assert "# length = ?" in (tmp_path / "boat.toml").read_text()
    assert "--force" in run("check", faulty, *files, check=2).stderr
    # a file beside the log that is not filled in yet is needed by a twin alone
    shutil.copy(tmp_path / "boat.toml", faulty.with_suffix(".toml"))
    assert "length" in run("check", faulty, "--no-picture", check=2).stderr
    run("check", faulty, "--no-picture", "--no-twin", "--json", tmp_path / "b.json", check=1)
    assert codes(tmp_path / "b.json", "error") == codes(tmp_path / "a.json", "error")


def test_particulars_of_a_known_boat_are_written_whole(folder, tmp_path):
    written = tmp_path / "boat.toml"
    run("check", folder / "run.csv", "--no-twin", "--no-picture", "--write", written)
    assert Particulars.load(written).length == Particulars.load(folder / "run.toml").length


def test_particulars_written_anew_keep_what_was_written_by_hand(faulty, tmp_path):
    path = faulty.with_suffix(".toml")
    quiet = ("--no-picture", "--no-twin", "--write", path)
    run("check", faulty, *quiet, check=1)
    first = path.read_text()
    run("check", faulty, *quiet, "--force", check=1)
    assert path.read_text() == first  # it can be written anew before it is complete
    text = first.replace('steering = "drives"', 'steering = "differential"')
    for name, value in {"length": 6.3, "beam": 2.7, "draft": 0.5, "mass": 3000}.items():
        text = text.replace(f"# {name} = ?  # fill in", f"{name} = {value}")
    text = re.sub("(?m)^shaft_speed = .*", "shaft_speed = 9.0  # log: at that speed", text)
    text = re.sub("(?m)^gyro_sd = .*", "gyro_sd=0.003 # data sheet", text)
    text = re.sub("(?m)^gps_sd = .*", "gps_sd = 9.0  # log: scatter", text)
    text = text.replace("gps_arm = [0.0, 0.0, 0.0]", "gps_arm = [\n  1.0, 0.0,\n  -2.0,\n]")
    text = text.replace("[instruments]", "# measured in May\n[instruments]")
    path.write_text("# my boat\n" + text + "\n[deck]\n# at the bow\nmax_speed = 0.4\n")
    out = run("check", faulty, *quiet, "--force", check=1).stdout
    assert "length, beam, draft, mass, gyro_sd, gps_arm, max_speed, which are of no log" in out
    boat, lines = Particulars.load(path), path.read_text().splitlines()
    assert lines[lines.index("# measured in May") + 1] == "[instruments]"
    assert lines[lines.index("# at the bow") + 1] == "max_speed = 0.4" and "# my boat" in lines
    assert (boat.length, boat.mass, boat.deck.max_speed) == (6.3, 3000.0, 0.4)
    assert (boat.instruments.gyro_sd, boat.instruments.gps_arm) == (0.003, (1.0, 0.0, -2.0))
    assert boat.steering == "drives" and boat.shaft_speed > 10.0 and boat.instruments.gps_sd < 1.0
    assert "goes with" not in out
    path.write_text(re.sub("(?m)^speed = .*", f"speed = {2.0 * boat.speed}", path.read_text()))
    out = run("check", faulty, *quiet, "--force", check=1).stdout
    renewed = Particulars.load(path)
    assert (renewed.speed, renewed.shaft_speed) == (2.0 * boat.speed, boat.shaft_speed)
    assert (
        f"in the log speed = {boat.speed:g} goes with" in out
        and f"at {boat.speed:g} m/s" in path.read_text()
    )


def test_instruments_of_several_logs_are_written_once(folder, tmp_path):
    log = Log.read(folder / "run.csv").without_truth()
    logs, rng = [tmp_path / f"{name}.csv" for name in "abc"], np.random.default_rng(7)
    for path, sd in zip(logs, (0.0, 0.01, 0.05), strict=True):
        z = log.z.copy()
        z[:, 5] += sd * rng.standard_normal(len(z))
        dataclasses.replace(log, z=z).write(path)
    quiet, written = ("--no-twin", "--no-picture"), tmp_path / "boat.toml"

    def gyro_sd(*given):
        run("check", *given, *quiet, "--write", written, "--force", check=None)
        return float(re.search(r"gyro_sd = ([\d.]+)", written.read_text())[1])

    each = [gyro_sd(path) for path in logs]
    assert each == sorted(each) and each[2] > 2.0 * each[1]
    assert gyro_sd(*logs) == gyro_sd(*logs[::-1]) == each[1]
    assert "from c, b, a" in written.read_text() and "median of 3 logs" in written.read_text()
    boat = folder / "run.toml"
    run("check", *logs, *quiet, "--ship", boat, "--write", written, "--force", check=None)
    assert Particulars.load(written).length == Particulars.load(boat).length
    # a file that is replaced keeps what was written by hand, whether it is in use or not
    written.write_text(re.sub("(?m)^mass = .*", "mass = 2500.0", written.read_text()))
    out = run("check", *logs, *quiet, "--write", written, "--force", check=None).stdout
    assert Particulars.load(written).mass == 2500.0 and "mass" in out
    # logs of two boats have no instruments in common
    shutil.copy(boat, logs[0].with_suffix(".toml"))
    text = re.sub("(?m)^length = .*", "length = 3.0", boat.read_text())
    logs[1].with_suffix(".toml").write_text(text)
    said = run("check", *logs, *quiet, "--write", written, "--force", check=2).stderr
    assert "--write" in said and "--ship" in said


def test_several_logs_are_checked_in_turn(folder, faulty):
    quiet = ("--no-twin", "--no-picture")
    out = run("check", folder / "run.csv", faulty, *quiet, check=1).stdout
    assert "run: " in out and "bad: " in out
    said = run("check", folder / "run.csv", faulty, *quiet, "--json", "a.json", check=2).stderr
    assert "--json: that is for one log" in said
    beside = folder / "run.toml"  # no run to sail through before it is told what it is
    for command in ("check", "identify"):
        out = run(command, folder / "run.csv", beside, check=2)
        assert not out.stdout and f"{beside}: this is TOML of a boat" in out.stderr
        assert "--ship" in out.stderr


@pytest.mark.parametrize(
    ("lacking", "panels"),
    [
        ((), ["track", "commands", "speed", "turn", "heading"]),
        (("gyro", "accel"), ["track", "commands", "speed", "turn", "heading"]),
        (("gyro", "accel", "compass"), ["track", "commands", "speed", "heading"]),
        (("gps", "n_", "delta"), ["turn", "heading"]),
    ],
)
def test_the_picture_has_no_panel_without_a_curve(folder, tmp_path, monkeypatch, lacking, panels):
    table = pl.read_csv(folder / "run.csv")
    table = table.drop([c for c in table.columns if c.startswith((*lacking, "true"))])
    table.write_csv(tmp_path / "part.csv")
    drawn = {}

    def figure(title, about, entries, *more):
        made = new_figure(title, about, entries, *more)
        drawn.update({"axes": made[1], "key": [text for _, text in entries]})
        return made

    monkeypatch.setattr(pictures, "new_figure", figure)
    run("check", tmp_path / "part.csv", "--no-twin", "--out", tmp_path / "a.png", check=None)
    assert sorted(drawn["axes"]) == sorted(panels)
    for ax in drawn["axes"].values():
        assert np.isfinite(ax.dataLim.get_points()).all()
    assert ("fixes; left unit" in drawn["key"]) == ("gps" not in lacking)


def test_a_twin_of_a_faulty_log_is_bad(folder, tmp_path):
    log = Log.read(folder / "run.csv").without_truth()
    log.z[:, 5] *= -1.0
    log.write(tmp_path / "bad.csv")
    (tmp_path / "bad.toml").write_text((folder / "run.toml").read_text())
    kept = tmp_path / "a.json"
    run("check", tmp_path / "bad.csv", "-p", "ukf", "--no-picture", "--json", kept, check=1)
    verdict = json.loads(kept.read_text())["verdict"]
    assert verdict["grade"] == "bad"
    assert verdict["answers"][-1]["numbers"]["findings"] == {"sign gyro": "error"} | {
        code: "warning" for code in codes(kept, "warning")
    }


def test_a_log_that_cannot_be_used_says_why(folder, tmp_path):
    rows = (folder / "run.csv").read_text().splitlines()
    place = rows[0].split(",").index("compass_rad")
    short = [",".join(c for j, c in enumerate(row.split(",")) if j != place) for row in rows]
    twice = [*rows, rows[-1].replace(",", ",9", 1)]
    for name, lines, word in (("short", short, "compass_rad"), ("twice", twice, "one row")):
        path = tmp_path / f"{name}.csv"
        path.write_text("\n".join(lines) + "\n")
        path.with_suffix(".toml").write_text((folder / "run.toml").read_text())
        out = run("check", path, "--no-picture", check=1).stdout
        assert "error: " in out and word in out and "no twin can run" in out


@pytest.mark.parametrize("content", [b"", b"t_s\n", b"\x00\xff" * 99, b"a,b\n1,2\n", b"t_s,x\n1\n"])
def test_a_file_of_another_kind_is_one_clear_line(tmp_path, content):
    path = tmp_path / "odd.csv"
    path.write_bytes(content)
    found = run("check", path, "--no-picture", check=None)
    assert found.exit_code in (1, 2)
    assert "error: " in found.output and "Traceback" not in found.output


def test_only_what_was_written_by_hand_in_the_file_of_the_boat_is_kept(folder, tmp_path):
    log = Log.read(folder / "run.csv").without_truth()
    a, b, new = (tmp_path / name for name in ("a.csv", "b.csv", "new.toml"))
    log.write(a)
    log.write(b)
    quiet = ("--no-twin", "--no-picture", "--force", "--write")
    boat = (folder / "run.toml").read_text()
    hand = re.sub("(?m)^speed = .*", "speed = 0.5", boat)
    tagged = re.sub("(?m)^(speed|shaft_speed) = .*", r"\1 = 0.5  # log: x", boat)
    file = a.with_suffix(".toml")
    file.write_text(hand)
    out = run("check", a, *quiet, new, check=None).stdout
    assert Particulars.load(new).speed == 0.5
    assert re.search(r"kept of \S*a\.toml: [^;]*\bspeed\b[^;]*, which are of no log", out)
    # a vessel wrote nothing by hand: its name stands for what is taken of it
    out = run("check", a, "--ship", "otter", *quiet, tmp_path / "otter.toml", check=None).stdout
    assert "kept of otter: " in out and "hand" not in out
    new.unlink()
    file.write_text(tagged)
    run("check", a, *quiet, new, check=None)
    computed = Particulars.load(new)
    assert computed.speed > 0.5 and re.search("(?m)^speed = .*# log: ", new.read_text())
    # a file of another log gives nothing to the one that is written anew
    b.with_suffix(".toml").write_text(hand)
    run("check", a, b, *quiet, file, check=None)
    assert Particulars.load(file).speed == computed.speed
    assert re.search("(?m)^shaft_speed = .*# log: ", file.read_text())


def test_a_prior_is_kept_in_another_folder_and_beside_one_that_is_written_out(folder, tmp_path):
    kept, new = tmp_path / "boat.toml", tmp_path / "new" / "boat.toml"
    run("identify", folder / "run.csv", "--save-prior", tmp_path / "boat.prior")
    head, boat = "[particulars]\n", (folder / "run.toml").read_text()
    kept.write_text(boat.replace(head, f'{head}prior = "boat.prior"\n'))
    quiet = ("--no-twin", "--no-picture", "--force", "--ship", kept, "--write", new)
    out = run("check", folder / "run.csv", *quiet, check=None).stdout
    # only what the file of the boat says; the instruments that it lacks are of the log, or usual
    said = re.search(r"kept of \S*boat\.toml: (.*), which are of no log", " ".join(out.split()))
    assert said and set(said[1].split(", ")) <= set(re.findall(r"(?m)^(\w+) = ", kept.read_text()))
    assert 'prior = "../boat.prior"' in new.read_text()
    new.write_text(Particulars.load(kept).to_toml())
    for ship in (kept, new):
        shown = (*quiet[:-3], ship, "--write", new)
        run("check", folder / "run.csv", *shown, check=None)
        assert Particulars.load(new).prior == Particulars.load(kept).prior


def test_what_is_missing_is_said_once(folder, tmp_path):
    log = Log.read(folder / "run.csv").without_truth()
    logs = [tmp_path / f"{name}.csv" for name in "ab"]
    for path in logs:
        log.write(path)
    quiet, new = ("--no-twin", "--no-picture"), tmp_path / "a.toml"
    out = run("check", *logs, *quiet, "--write", new, check=None).stdout
    assert out.count("fill in length, beam, draft, mass") == 1 and "--write" not in out
    said = run("check", logs[0], "--no-picture", check=2).stderr
    assert "length, beam, draft, mass; fill them in, and remove the # before them" in said
