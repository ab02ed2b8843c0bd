"""What ``usv-twin benchmark`` writes for a paper, and what it reuses."""

from __future__ import annotations

import json

from typer.testing import CliRunner

from twin.cli.main import app


def run(*arguments):
    done = CliRunner().invoke(app, ["benchmark", *map(str, arguments)])
    assert done.exit_code == 0, done.output
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
