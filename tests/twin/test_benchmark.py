"""The benchmark: what it scores, that it can be continued, and that workers change nothing."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

from twin import benchmark as bench
from twin.log import Log, recorded_runs
from twin.predictor import Prediction
from twin.registry import PredictorError
from usv_gym.manoeuvres import ManoeuvreError
from usv_gym.sea import SeaError
from usv_gym.sensors import Fault, FaultError

SMALL = bench.Settings(
    scenarios=("zigzag",),
    faults=("none", "gps5"),
    seeds=(0, 1),
    predictors=("persistence", "ukf"),
    identify_s=30.0,
    duration_s=50.0,
)


def run_all(settings, folder, jobs=1, backend="loky"):
    done = {}
    for unit, result in bench.runs(settings, folder, jobs=jobs, backend=backend):
        assert not isinstance(result, Exception), result
        done[unit] = result
    return bench.collect(settings, done, "test")


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    folder = tmp_path_factory.mktemp("benchmark")
    return folder, run_all(SMALL, folder)


def test_rows_are_complete(small):
    _, results = small
    rows = results["rows"]
    # scenarios x faults x seeds x predictors x channels x horizons
    assert len(rows) == 1 * 2 * 2 * 2 * 6 * 4
    keys = {
        *("scenario", "fault", "seed", "predictor", "plan", "channel", "horizon_s"),
        *("mae", "mse", "n"),
    }
    for row in rows:
        assert set(row) == keys
        assert row["plan"] == "known"
        assert row["n"] == 11  # every second from 30 to 40 s
        assert 0.0 <= row["mae"] ** 2 <= row["mse"] * (1 + 1e-12)
    for item in results["summary"]:
        assert set(item) == {
            "scenario",
            "fault",
            "predictor",
            "plan",
            "metric",
            "value",
            "low",
            "high",
        }
    metrics = {item["metric"] for item in results["summary"]}
    assert metrics == set(bench.METRICS)
    json.dumps(results, allow_nan=False)


def test_summary_is_made_of_the_rows(small):
    _, results = small
    for predictor in SMALL.predictors:
        values = [
            np.mean(
                [
                    row["mae"]
                    for row in results["rows"]
                    if (row["fault"], row["seed"], row["predictor"]) == ("none", seed, predictor)
                ]
            )
            for seed in SMALL.seeds
        ]
        item = next(
            i
            for i in results["summary"]
            if (i["fault"], i["predictor"], i["metric"]) == ("none", predictor, "mae")
        )
        assert item["value"] == pytest.approx(np.mean(values))
    skill = {i["predictor"]: i["value"] for i in results["summary"] if i["metric"] == "skill"}
    assert skill["persistence"] == 0.0
    assert skill["ukf"] > 0.3  # the zigzag is where a model pays


def test_continuing_gives_the_same(small, tmp_path, monkeypatch):
    _, whole = small
    iterator = bench.runs(SMALL, tmp_path, jobs=1)
    first = [next(iterator) for _ in range(3)]
    iterator.close()
    kept = {path.name for path in (tmp_path / "runs").glob("*.json")}
    assert len(kept) >= 3
    ran = []
    real = bench.run_unit

    def counting(settings, unit, folder, **options):
        ran.append(unit)
        return real(settings, unit, folder, **options)

    monkeypatch.setattr(bench, "run_unit", counting)
    again = run_all(SMALL, tmp_path)
    assert again == whole
    assert not {unit for unit, _ in first} & set(ran)


def test_other_settings_are_not_taken_for_the_same(small):
    folder, _ = small
    unit = bench.units(SMALL)[0]
    assert bench.finished(SMALL, unit, folder, pictures=True) is not None
    other = dataclasses.replace(SMALL, hs=0.6)
    assert bench.finished(other, unit, folder, pictures=True) is None
    bench.result_file(folder, unit).write_text("{broken")
    assert bench.finished(SMALL, unit, folder, pictures=True) is None


@pytest.mark.parametrize(("jobs", "backend"), [(2, "loky"), (2, "threading")])
def test_workers_change_nothing(small, tmp_path, jobs, backend):
    assert run_all(SMALL, tmp_path, jobs, backend) == small[1]


def test_logs_can_be_fed_back(small):
    folder, _ = small
    log = Log.read(folder / "logs" / "zigzag_gps5_0.csv")
    lost = np.isnan(log.z[:, 0])
    # 5 s of loss from 35 s on, and the two rows before the first late fix
    assert lost.sum() == 100 + 2
    assert log.t[lost][2] == pytest.approx(35.0)
    seen, reference, _, first = bench.load_run(SMALL, bench.Unit("zigzag", "gps5", 0, "ukf"))
    assert first == 30.0
    assert seen.truth is None
    np.testing.assert_array_equal(reference.z, log.z)
    np.testing.assert_array_equal(reference.truth, log.truth)


def test_a_log_is_renewed_with_its_result_and_has_its_particulars(tmp_path):
    small = dataclasses.replace(SMALL, faults=("none",), seeds=(0,), predictors=("persistence",))
    run_all(small, tmp_path)
    path = tmp_path / "logs" / "zigzag_none_0.csv"
    before = path.read_bytes()
    run_all(dataclasses.replace(small, hs=1.0), tmp_path)
    assert path.read_bytes() != before
    boat, found = bench.particulars_beside(path)
    assert found
    assert boat.length == 6.336
    other = tmp_path / "alone.csv"
    other.write_bytes(before)
    assert not bench.particulars_beside(other)[1]


def test_two_runs_of_one_name_are_refused():
    with pytest.raises(bench.BenchmarkError, match="two runs are called 'run'"):
        dataclasses.replace(SMALL, logs=("a/run.csv", "b/run.csv.gz"))


def test_a_calm_straight_run_has_no_absurd_normalised_error(tmp_path):
    calm = dataclasses.replace(
        SMALL, scenarios=("straight",), faults=("none",), seeds=(0,), hs=0.0, wind=0.0
    )
    results = run_all(calm, tmp_path)
    values = [i["value"] for i in results["summary"] if i["metric"] == "normalised"]
    assert max(values) < 1e3


def test_recorded_run_is_scored_against_its_record(tmp_path):
    path = str(recorded_runs()["boat1_usv_circle"])
    settings = dataclasses.replace(SMALL, scenarios=(), logs=(path,))
    results = run_all(settings, tmp_path)
    assert {row["channel"] for row in results["rows"]} == {"along", "across", "psi"}
    assert {row["scenario"] for row in results["rows"]} == {"boat1_usv_circle"}
    value = {(i["predictor"], i["fault"], i["metric"]): i["value"] for i in results["summary"]}
    assert value["ukf", "none", "mae"] < 0.6 * value["persistence", "none", "mae"]
    assert value["ukf", "gps5", "start_error"] > value["ukf", "none", "start_error"]


def test_errors_of_a_perfect_prediction_are_zero():
    rng = np.random.default_rng(0)
    start = rng.normal(size=6)
    t = np.arange(1, 201) * 0.05
    mean = start + rng.normal(size=(1, 6)) * t[:, None]
    cov = np.tile(np.eye(6), (200, 1, 1))
    prediction = Prediction(0.0, start, np.eye(6), t, mean, cov)
    truth = np.stack([start, *(mean[round(h / 0.05) - 1] for h in bench.HORIZONS)])
    shifted = truth + np.array([5.0, -3.0, 2 * math.pi, 0.0, 0.0, 0.0])  # receiver's bias
    error, change, sd = bench._errors(prediction, shifted)
    np.testing.assert_allclose(error, 0.0, atol=1e-9)
    assert change.shape == sd.shape == (4, 6)


def test_along_and_across_are_seen_from_the_boat():
    start = np.zeros(6)
    t = np.arange(1, 201) * 0.05
    mean = np.zeros((200, 6))
    mean[:, 1] = 2.0 * t  # sails east
    prediction = Prediction(0.0, start, np.zeros((6, 6)), t, mean, np.zeros((200, 6, 6)))
    truth = np.zeros((5, 6))
    truth[:, 2] = math.pi / 2
    truth[1:, 1] = np.array(bench.HORIZONS) * 1.5
    truth[1:, 0] = -1.0
    error, _, _ = bench._errors(prediction, truth)
    np.testing.assert_allclose(error[:, 3], 0.5 * np.array(bench.HORIZONS))  # along: ahead
    np.testing.assert_allclose(error[:, 4], -1.0)  # across: to port of the truth


def test_lost_signals_of_a_recorded_log():
    log = Log.read(recorded_runs()["boat1_usv_circle"])
    cut = bench.with_faults(log, (Fault("gps", 50.0, 10.0), Fault("compass", 70.0, 5.0)))
    inside = (log.t >= 50.0) & (log.t < 60.0)
    assert np.isnan(cut.z[inside, :4]).all()
    np.testing.assert_array_equal(cut.z[~inside, :4], log.z[~inside, :4])
    assert np.isnan(cut.z[(log.t >= 70.0) & (log.t < 75.0), 4]).all()


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        ({"scenarios": ("loop",)}, ManoeuvreError, "no scenario is called 'loop'; known"),
        ({"predictors": ("magic",)}, PredictorError, "no predictor is called 'magic'"),
        ({"faults": ("gps",)}, FaultError, "gps10"),
        ({"faults": ("sonar10",)}, FaultError, "sonar"),
        ({"plans": ("guess",)}, PredictorError, "hold, known"),
        ({"hs": -1.0}, SeaError, "hs = -1.0"),
        ({"duration_s": 35.0}, bench.BenchmarkError, "duration_s"),
    ],
)
def test_bad_settings_die_early(change, kind, message):
    with pytest.raises(kind, match=message):
        dataclasses.replace(SMALL, **change)


def test_missing_torch_is_said(monkeypatch):
    monkeypatch.setattr(bench, "find_spec", lambda name: None)
    names, notes = bench.available(("ukf", "lstm"))
    assert names == ("ukf",)
    assert "pip install torch" in notes[0]
