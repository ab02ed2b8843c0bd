"""The check of a folder of results: it passes what is whole, and finds what is not."""

from __future__ import annotations

import dataclasses
import json
import shutil

import pytest
from typer.testing import CliRunner

from twin.benchmark import runner as bench
from twin.benchmark.protocol import BenchmarkError, Settings, units
from twin.benchmark.publish import submission
from twin.benchmark.publish.submission import check_submission
from twin.cli.main import app
from twin.files import keep, kept, results_text
from twin.predictors.baselines import Persistence
from twin.predictors.registry import PREDICTORS
from usv_kernel.files import read_json

SETTINGS = Settings(
    scenarios=("zigzag",),
    faults=("none",),
    seeds=(0, 1),
    predictors=("persistence", "persistence-8s"),
    plans=("known",),
    identify_s=20.0,
    duration_s=35.0,
)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    results = bench.collect(SETTINGS, dict(bench.runs(SETTINGS, folder)), "test")
    (folder / "results.json").write_text(results_text(results))
    return folder


@pytest.fixture
def copy(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "copy")


def findings(folder, **options):
    return {item.name: item for item in check_submission(folder, **options)}


def changed(folder, change):
    """Change the content of results.json."""
    path = folder / "results.json"
    results = json.loads(path.read_text())
    change(results)
    path.write_text(json.dumps(results))


def test_a_whole_folder_holds(whole):
    found = findings(whole)
    assert all(item.passed for item in found.values()), found
    assert "4, each of this program" in found["results"].text
    assert "2 of 2 to the last bit" in found["computed again"].text
    done = CliRunner().invoke(app, ["benchmark", "--submit-check", str(whole), "--sample", "0"])
    assert done.exit_code == 0 and "6 checks, 0 failed" in done.output


def test_the_sample_is_drawn_by_the_file(whole, copy):
    done = {unit: {} for unit in units(SETTINGS)}
    drawn = submission._drawn(whole / "results.json", done, 1)
    assert drawn == submission._drawn(copy / "results.json", done, 1)
    assert [unit.predictor for unit in drawn] == list(SETTINGS.predictors)
    others = set()
    for k in range(8):
        changed(copy, lambda results, k=k: results.update(command=f"{k}"))
        others.add(tuple(unit.seed for unit in submission._drawn(copy / "results.json", done, 1)))
    assert len(others) > 1
    assert len(submission._drawn(whole / "results.json", done, 9)) == 4


def test_an_edited_table_is_found(copy):
    def better(results):
        results["summary"][0]["value"] *= 0.99

    changed(copy, better)
    found = findings(copy, sample=0)
    assert found["tables"].passed is False and "summary" in found["tables"].text
    done = CliRunner().invoke(app, ["benchmark", "--submit-check", str(copy), "--sample", "0"])
    assert done.exit_code == 1 and "6 checks, 1 failed" in done.output


def test_an_edited_result_is_found(copy):
    """Also where its checksum, its key and the tables are made to fit."""
    for unit in units(SETTINGS):
        path = bench.result_file(copy, unit)
        key = read_json(path, BenchmarkError)["key"]
        result = kept(path, key)
        for table in result["plans"]["known"]["channels"].values():
            table["mae"] = [0.9 * value for value in table["mae"]]
        keep(path, key, result)
    results = bench.collect(SETTINGS, bench.reusable(SETTINGS, copy), "test")
    (copy / "results.json").write_text(results_text(results))
    found = findings(copy)
    assert found["tables"].passed and found["results"].passed
    assert found["computed again"].passed is False
    assert "differs by 10 % from here" in found["computed again"].text


def test_a_forged_end_of_a_loss_is_found(tmp_path):
    settings = dataclasses.replace(SETTINGS, faults=("gps5",), seeds=(0,))
    done = bench.runs(settings, tmp_path)
    for unit, _ in done:
        path = bench.result_file(tmp_path, unit)
        key = read_json(path, BenchmarkError)["key"]
        result = kept(path, key)
        result["loss_ends"][0]["error_m"] *= 0.1
        keep(path, key, result)
    results = bench.collect(settings, bench.reusable(settings, tmp_path), "test")
    (tmp_path / "results.json").write_text(results_text(results))
    found = findings(tmp_path)
    assert found["tables"].passed and found["computed again"].passed is False


@pytest.mark.parametrize("part", ["summary", "verdict"])
def test_nan_in_a_table_is_found(copy, part):
    def spoilt(results):
        row = results[part][0]
        row[next(key for key, value in row.items() if isinstance(value, float))] = float("nan")

    changed(copy, spoilt)
    found = findings(copy, sample=0)
    assert found["tables"].passed is False and part in found["tables"].text


def test_a_seed_that_is_missing_or_damaged_is_found(copy):
    unit = units(SETTINGS)[-1]
    bench.result_file(copy, unit).write_text("{}")
    found = findings(copy, sample=0)
    assert found["results"].passed is False
    assert "1 of 4 are missing or damaged" in found["results"].text
    assert f"{unit.predictor} on {unit.run}" in found["results"].text
    assert found["tables"].passed is False


def test_other_settings_than_those_named_are_found(copy):
    changed(copy, lambda results: results["settings"].update(hs=0.1))
    found = findings(copy, sample=0)
    assert found["results"].passed is False and "of other settings" in found["results"].text


def test_another_program_is_named(copy):
    changed(copy, lambda results: results["program"].update(numpy="0.1", sources="f00"))
    found = findings(copy, sample=0)
    assert found["program"].passed is False
    assert "numpy 0.1, here" in found["program"].text and "f00" in found["program"].text
    assert found["results"].passed is None


class Mine(Persistence):
    average = 1.0


def test_other_sources_of_a_predictor_are_found(tmp_path, monkeypatch):
    monkeypatch.setitem(PREDICTORS, "mine", Mine)
    settings = dataclasses.replace(SETTINGS, predictors=("mine",), seeds=(0,))
    results = bench.collect(settings, dict(bench.runs(settings, tmp_path)), "test")
    (tmp_path / "results.json").write_text(results_text(results))
    assert findings(tmp_path)["predictors"].passed
    monkeypatch.setattr(submission, "predictor_digest", lambda name: "other")
    found = findings(tmp_path, sample=0)
    assert found["predictors"].passed is False and "mine" in found["predictors"].text


def test_a_log_that_is_not_at_hand_is_asked_for(copy):
    changed(copy, lambda results: results["settings"].update(logs=["far.csv"]))
    found = findings(copy, sample=0)
    assert found["settings"].passed is None and "--log" in found["settings"].text
    assert found["tables"].passed is None


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"settings": {"cases": 3}}', '{"settings": 1}'])
def test_a_damaged_file_is_an_error_with_a_remedy(tmp_path, text):
    with pytest.raises(BenchmarkError, match="no such file; name a folder"):
        list(check_submission(tmp_path))
    (tmp_path / "results.json").write_text(text)
    with pytest.raises(BenchmarkError, match=r"results\.json"):
        list(check_submission(tmp_path))
