"""What ``usv-twin benchmark`` writes for a paper, and what it reuses."""

from __future__ import annotations

import json

from typer.testing import CliRunner

from twin.cli.main import app
from twin.logs.log import recorded_runs
from twin.predictors.baselines import Persistence


def run(*arguments, code=0):
    done = CliRunner().invoke(app, ["benchmark", *map(str, arguments)])
    assert done.exit_code == code, done.output
    return done


def test_tables_and_pictures_are_written_and_results_reused(tmp_path):
    out, table, tidy = tmp_path / "out", tmp_path / "tables" / "t.tex", tmp_path / "t.csv"
    options = ("--scenarios", "zigzag", "--faults", "none", "--seeds", "0", "--plans", "hold")
    options += ("--predictors", "persistence,persistence-8s", "--jobs", "1", "--out", out)
    first = run(*options, "--latex", table, "--csv", tidy, "--pdf")
    # with the recorded run
    assert "0 of 4 results reused" in first.stderr
    assert r"\begin{tabular}" in table.read_text() and "zigzag" in tidy.read_text()
    pictures = {path.stem for path in (out / "pictures").glob("*.svg")}
    papers = list((out / "pictures").glob("*.pdf"))
    assert {path.stem for path in papers} == pictures and pictures
    # letters as TrueType, not as Type 3, which journals refuse
    assert all(b"/Type3" not in path.read_bytes() for path in papers)
    before = {path.stem: path.read_bytes() for path in papers}
    results = json.loads((out / "results.json").read_text())
    again = run(*options, "--pdf")
    assert "4 of 4 results reused" in again.stderr
    assert before == {p.stem: p.read_bytes() for p in (out / "pictures").glob("*.pdf")}
    fresh = run(*options, "--fresh")
    assert "0 of 4 results reused" in fresh.stderr
    assert not list((out / "pictures").glob("*.pdf"))
    now = json.loads((out / "results.json").read_text())
    assert {**results, "command": ""} == {**now, "command": ""}


def test_text_is_not_written_under_an_ending_of_another_format(tmp_path):
    for option, name in (("--csv", "r.xlsx"), ("--latex", "r.json")):
        said = run(option, tmp_path / name, code=2).stderr
        assert option in said and name in said
    assert not list(tmp_path.iterdir())


class Raises(Persistence):
    """A predictor with a fault."""

    def predict(self, *_args, **_options):
        raise ValueError("no")


def test_a_predictor_that_is_not_scored_shows_in_the_exit_code_and_the_rest_is_kept(tmp_path):
    options = ("--scenarios", "turn", "--faults", "none", "--seeds", "0", "--plans", "hold")
    options += ("--no-pictures", "--jobs", "1", "--out", tmp_path)
    raises = f"{__name__}:Raises"
    done = run(*options, "--predictors", f"persistence,{raises}", code=1)
    last = done.stderr.splitlines()[-1]
    assert last.startswith(f"error: not scored: {raises} on 2 of 2 runs")  # with the recorded one
    assert (tmp_path / "report.html").exists()
    results = json.loads((tmp_path / "results.json").read_text())
    assert {row["predictor"] for row in results["summary"]} == {"persistence"}
    # nothing to score: the true ship of a recorded run is not known
    log = recorded_runs()["boat1_usv_circle"]
    done = run(log, *options[-5:], "--predictors", "persistence,oracle", code=1)
    assert "not scored: oracle on any run" in done.stderr
    run(log, *options[-5:], "--predictors", "persistence")
