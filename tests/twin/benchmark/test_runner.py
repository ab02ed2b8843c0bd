"""The benchmark: what it scores, how it continues, and workers that change nothing."""

from __future__ import annotations

import dataclasses
import json
from typing import ClassVar

import numpy as np
import pytest

from twin.benchmark import runner as bench
from twin.benchmark import scores
from twin.benchmark.loading import load_run, with_faults
from twin.benchmark.metrics import METRICS
from twin.benchmark.motion_scores import attitude_lines
from twin.benchmark.protocol import (
    FULL,
    FULL_CASES,
    HORIZONS,
    SPREAD,
    BenchmarkError,
    Settings,
    Unit,
    available,
    left_out,
    units,
)
from twin.logs.log import Log, recorded_runs
from twin.parallel import BACKENDS
from twin.particulars import ParticularsError
from twin.predictors.baselines import Persistence
from twin.predictors.registry import PREDICTORS, PredictorError
from twin.sim.bridge import particulars_of
from twin.sim.recorded import particulars_for_log
from usv_gym.manoeuvring.manoeuvres import ManoeuvreError
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.faults import Fault, FaultError
from usv_gym.world.recorded_spectrum import SeaError

SMALL = Settings(
    scenarios=("zigzag",),
    faults=("none", "gps5"),
    seeds=(0, 1),
    predictors=("persistence", "ukf", "oracle"),
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
    # scenarios x faults x seeds x predictors x plans x channels x horizons
    assert len(rows) == 1 * 2 * 2 * 3 * 2 * 6 * 4
    for row in rows:
        assert row["plan"] in ("known", "hold")
        assert row["n"] == 11  # every second from 30 to 40 s
        assert 0.0 <= row["mae"] ** 2 <= row["mse"] * (1 + 1e-12)
        assert row["crps"] > 0.0
        assert (row["case"], row["sea"], row["grade"]) == (row["fault"], "2", "typical")
    metrics = {item["metric"] for item in results["summary"]}
    assert metrics == set(METRICS)
    json.dumps(results, allow_nan=False)
    # the boat does not roll
    assert results["motion"] == results["quiet"] == []


def test_summary_is_the_mean_and_median_over_seeds(small):
    _, results = small
    for predictor in SMALL.predictors:
        cell = {"fault": "none", "predictor": predictor, "plan": "known"}

        def select(rows, **more):
            return [row for row in rows if (cell | more).items() <= row.items()]  # noqa: B023

        values = [
            np.mean([row["mae"] for row in select(results["rows"], seed=seed)])
            for seed in SMALL.seeds
        ]
        (item,) = select(results["summary"], metric="mae")
        assert item["value"] == pytest.approx(np.mean(values))
        assert item["median"] == pytest.approx(np.median(values))
        (skill,) = select(results["summary"], metric="skill")
        # the zigzag is where a model pays
        assert skill["value"] == 0.0 if predictor == "persistence" else skill["value"] > 0.3


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


def test_plans_and_other_settings_overwrite_nothing_of_each_other(tmp_path, monkeypatch):
    both = dataclasses.replace(SMALL, faults=("none",), seeds=(0,), predictors=("persistence",))
    known = dataclasses.replace(both, plans=("known",))
    (unit,) = units(both)
    whole = run_all(both, tmp_path)
    assert set(bench.finished(known, unit, tmp_path)["plans"]) == {"known"}
    calm = dataclasses.replace(known, hs=0.0, predictors=("persistence",))
    run_all(calm, tmp_path)
    assert bench.finished(both, unit, tmp_path) is not None
    # one plan after the other makes both
    for folder, plans in (("a", ("hold",)), ("a", ("known",))):
        run_all(dataclasses.replace(both, plans=plans), tmp_path / folder)
    monkeypatch.delattr(bench, "run_unit")
    assert run_all(both, tmp_path / "a") == whole
    assert bench.run_figures(both, {unit: bench.finished(both, unit, tmp_path / "a")})


def test_a_result_of_other_settings_is_not_reused(small):
    folder, _ = small
    unit = units(SMALL)[0]
    assert bench.finished(SMALL, unit, folder) is not None
    other = dataclasses.replace(SMALL, hs=0.6)
    assert bench.finished(other, unit, folder) is None
    bench.result_file(SMALL, unit, folder).write_text("{broken")
    assert bench.finished(SMALL, unit, folder) is None


def test_a_result_of_other_particulars_is_not_reused(tmp_path):
    log = recorded_runs()["boat1_usv_circle"]
    path = tmp_path / "own.csv.gz"
    path.write_bytes(log.read_bytes())
    text = log.with_name("boat1_usv_circle.toml").read_text()
    path.with_name("own.toml").write_text(text)
    settings = Settings(scenarios=(), logs=(str(path),), predictors=("ukf",))
    before = bench.digest(settings, units(settings)[0])
    path.with_name("own.toml").write_text(text + "\n# heavier today\n")
    assert bench.digest(settings, units(settings)[0]) != before


def test_no_two_runs_share_a_file(tmp_path):
    names = ("go od", "go-od", "go%20od", "go_od")
    files = {bench.result_file(SMALL, Unit(n, "none", 0, "ukf", n), tmp_path) for n in names}
    assert len(files) == len(names)


def test_nothing_is_scored_across_a_gap(tmp_path):
    log = Log.read(recorded_runs()["boat1_usv_circle"])
    z = log.z.copy()
    gap = (log.t > log.t[0] + 100.0) & (log.t < log.t[0] + 130.0)
    z[gap, :4] = np.nan
    path = tmp_path / "gap.csv"
    dataclasses.replace(log, z=z).write(path)
    settings = Settings(
        scenarios=(),
        logs=(str(path),),
        faults=("none",),
        predictors=("persistence",),
        ship=str(recorded_runs()["boat1_usv_circle"].with_name("boat1_usv_circle.toml")),
    )
    (unit,) = units(settings)
    result = bench.run_unit(settings, unit, tmp_path, pictures=False)
    # an origin every second; its 10 s and the gap's 30 s overlap for 40 s, less what is near
    assert 33 <= result["skipped"] <= 40
    reference = scores.Reference(Log.read(path))
    start = float(log.t[0])
    assert reference.known(start + np.array([60.0, 70.0]))
    assert not reference.known(start + np.array([95.0, 105.0]))
    assert not reference.known(np.array([float(log.t[-1]) + 5.0]))
    assert (
        bench.collect(settings, {unit: result}, "")["logs"]["gap"]["skipped"] == result["skipped"]
    )


def test_absurd_samples_are_no_truth_to_score_against(tmp_path):
    recorded = recorded_runs()["boat1_usv_circle"]
    log = Log.read(recorded)
    velocities, headings = (np.flatnonzero(np.isfinite(log.z[:, j])) for j in (2, 4))
    z = log.z.copy()
    z[velocities[len(velocities) * 3 // 4], 2:4] = 655.35
    z[headings[len(headings) * 3 // 4], 4] = 65535.0
    dataclasses.replace(log, z=z).write(tmp_path / "wild.csv")
    path = str(tmp_path / "wild.csv")
    settings = dataclasses.replace(
        SMALL, scenarios=(), logs=(path,), ship=str(recorded.with_name("boat1_usv_circle.toml"))
    )
    run = load_run(settings, Unit("wild", "none", 0, "persistence", path))
    assert np.nanmax(np.abs(run.reference.z[:, 2:5])) < 100.0
    assert np.nanmax(run.seen.z[:, 2]) == 655.35
    assert [line.partition(":")[0] for line in run.absurd] == [
        "gps_vx_mps, gps_vy_mps",
        "compass_rad",
    ]


@pytest.mark.parametrize("backend", ["loky", "threading", "dask", "ray"])
def test_workers_change_nothing(small, tmp_path, backend):
    pytest.importorskip(BACKENDS[backend], reason=f"{backend} is not installed")
    assert run_all(SMALL, tmp_path, 2, backend) == small[1]


def test_written_logs_can_be_read_back(small):
    folder, _ = small
    log = Log.read(folder / "logs" / "zigzag_gps5_0.csv")
    lost = np.isnan(log.z[:, 0])
    # 5 s of loss from 35 s on, and the two rows before the first late fix
    assert lost.sum() == 100 + 2
    assert log.t[lost][2] == pytest.approx(35.0)
    run = load_run(SMALL, Unit("zigzag", "gps5", 0, "ukf"))
    assert run.identify == 30.0
    assert run.seen.truth is None
    np.testing.assert_array_equal(run.reference.z, log.z)
    np.testing.assert_array_equal(run.reference.truth, log.truth)


def test_a_log_is_replaced_with_its_result_and_has_its_particulars(tmp_path):
    small = dataclasses.replace(SMALL, faults=("none",), seeds=(0,), predictors=("persistence",))
    run_all(small, tmp_path)
    path = tmp_path / "logs" / "zigzag_none_0.csv"
    before = path.read_bytes()
    run_all(dataclasses.replace(small, hs=1.0), tmp_path)
    assert path.read_bytes() != before
    assert particulars_for_log(path) == particulars_of(small.boat(0))
    other = tmp_path / "alone.csv"
    other.write_bytes(before)
    with pytest.raises(ParticularsError, match="alone"):
        particulars_for_log(other)


def test_a_calm_straight_run_has_no_absurd_normalised_error(tmp_path):
    calm = dataclasses.replace(
        SMALL, scenarios=("straight",), faults=("none",), seeds=(0,), hs=0.0, wind=0.0, spread=0.0
    )
    results = run_all(calm, tmp_path)
    values = [i["value"] for i in results["summary"] if i["metric"] == "normalised"]
    assert max(values) < 1e3


def test_recorded_run_is_scored_against_its_record(tmp_path):
    path = str(recorded_runs()["boat1_usv_circle"])
    settings = dataclasses.replace(SMALL, scenarios=(), logs=(path,), faults=("none", "gps20"))
    results = run_all(settings, tmp_path)
    assert {row["channel"] for row in results["rows"]} == {"along", "across", "psi"}
    assert {row["scenario"] for row in results["rows"]} == {"boat1_usv_circle"}
    assert {row["predictor"] for row in results["rows"]} == {"persistence", "ukf"}
    # without the oracle there is no J
    assert {i["metric"] for i in results["summary"]} == set(METRICS) - {"J", "E", "E_runs"}
    assert left_out(settings) == (
        "oracle is left out of boat1_usv_circle: the true boat is not known",
    )
    value = {
        (i["predictor"], i["fault"], i["metric"]): i["value"]
        for i in results["summary"]
        if i["plan"] == "known"
    }
    assert value["ukf", "none", "mae"] < 0.6 * value["persistence", "none", "mae"]
    assert value["ukf", "gps20", "start_error"] > 1.2 * value["ukf", "none", "start_error"]


def test_j_is_the_mean_of_the_ratios_to_the_oracle(small):
    _, results = small
    value = {
        (i["predictor"], i["fault"], i["plan"], i["metric"]): i["value"] for i in results["summary"]
    }
    for fault in SMALL.faults:
        for plan in SMALL.plans:
            assert value["oracle", fault, plan, "J"] == 1.0
            assert value["oracle", fault, plan, "E"] == 0.0
        for name in ("persistence", "ukf"):
            j = value[name, fault, "known", "J"]
            assert value[name, fault, "known", "E"] == pytest.approx(j - 1.0)
            assert j > 1.0
    table = {
        tuple(row[key] for key in ("fault", "seed", "predictor", "plan")): row
        for row in results["runs"]
    }
    row, oracle = (table["gps5", 1, name, "hold"] for name in ("ukf", "oracle"))
    assert tuple(row["curves"]) == scores.STUDY_CHANNELS
    assert all(len(curve) == 20 for curve in row["curves"].values())
    ratios = [np.mean(row["curves"][c]) / np.mean(oracle["curves"][c]) for c in row["curves"]]
    assert row["J"] == pytest.approx(np.mean(ratios))


def test_coverage_is_counted_by_channel_and_horizon(small):
    _, results = small
    rows = results["channels"]
    # faults x predictors x plans x channels x horizons
    assert len(rows) == 2 * 3 * 2 * 7 * 4
    here = [r for r in rows if (r["fault"], r["predictor"], r["plan"]) == ("none", "ukf", "known")]
    pooled = [
        r["coverage90"]
        for r in results["runs"]
        if (r["fault"], r["predictor"], r["plan"]) == ("none", "ukf", "known")
    ]
    single = [r["coverage90"] for r in here if r["channel"] != "displacement"]
    assert np.mean(single) == pytest.approx(np.mean(pooled))


def test_predictors_of_a_module_are_called_by_their_class():
    names = ["ukf", "dsw-ukf:window=off", "ewar:EWAR", "ewar:EWAR:gain=2", "a:Own", "b:Own"]
    assert list(bench.shown_names(names).values()) == [
        *("ukf", "dsw-ukf:window=off", "EWAR", "EWAR:gain=2", "a:Own", "b:Own")
    ]


def test_every_seed_sails_another_boat():
    lengths = [SMALL.boat(seed).values["length_waterline"] for seed in (0, 1, 0)]
    assert lengths[0] == lengths[2] != lengths[1]
    same = dataclasses.replace(SMALL, spread=0.0)
    assert same.boat(0).values == same.boat(1).values == Vessel.load("usv75").values


def test_faults_remove_signals_of_a_recorded_log():
    log = Log.read(recorded_runs()["boat1_usv_circle"])
    cut = with_faults(log, (Fault("gps", 50.0, 10.0), Fault("compass", 70.0, 5.0)))
    inside = (log.t >= 50.0) & (log.t < 60.0)
    assert np.isnan(cut.z[inside, :4]).all()
    np.testing.assert_array_equal(cut.z[~inside, :4], log.z[~inside, :4])
    assert np.isnan(cut.z[(log.t >= 70.0) & (log.t < 75.0), 4]).all()


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        ({"scenarios": ("loop",)}, ManoeuvreError, "loop"),
        ({"predictors": ("magic",)}, PredictorError, "magic"),
        ({"faults": ("gps",)}, FaultError, "gps10"),
        ({"faults": ("sonar10",)}, FaultError, "sonar"),
        ({"plans": ("guess",)}, PredictorError, "hold, known"),
        ({"spread": 0.8}, BenchmarkError, "spread = 0.8"),
        ({"hs": -1.0}, SeaError, "hs = -1.0"),
        ({"duration_s": 35.0}, BenchmarkError, "duration_s"),
        ({"logs": ("a/run.csv", "b/run.csv.gz")}, BenchmarkError, "'run'"),
    ],
)
def test_bad_settings_die_early(change, kind, message):
    with pytest.raises(kind, match=message):
        dataclasses.replace(SMALL, **change)


def test_missing_torch_is_reported(monkeypatch):
    monkeypatch.setattr("twin.benchmark.protocol.find_spec", lambda name: None)
    names, notes = available(("ukf", "lstm"))
    assert names == ("ukf",)
    assert "pip install torch" in notes[0]


CASES = dataclasses.replace(
    SMALL,
    cases=tuple(FULL_CASES[name] for name in ("base", "gps5", "sea3", "sea0", "best")),
    plans=("known",),
    predictors=("persistence", "ukf"),
    seeds=(0, 1),
)


def test_the_full_protocol_changes_one_factor_at_a_time():
    assert FULL["scenarios"] == ("turn", "zigzag", "turn-zigzag", "random")
    assert len(FULL["seeds"]) == 24 and SPREAD == 0.15
    base = FULL_CASES["base"]
    for case in FULL_CASES.values():
        changed = sum(getattr(case, key) != getattr(base, key) for key in ("fault", "sea", "grade"))
        assert changed == (case is not base)
    full = Settings(cases=tuple(FULL_CASES.values()), **FULL)
    assert {unit.sea for unit in units(full)} == {*"01234", "squall", "building"}
    origins = full.duration_s - full.identify_s - HORIZONS[-1] + 1.0
    assert origins >= 20
    # the longest loss ends within the run
    assert full.identify_s + full.fault_after_s + 30.0 <= full.duration_s


def test_cases_are_named_in_the_results(tmp_path):
    cases = run_all(CASES, tmp_path)
    named = {(i["case"], i["fault"], i["sea"], i["grade"]) for i in cases["summary"]}
    assert named == {
        *(("base", "none", "2", "typical"), ("gps5", "gps5", "2", "typical")),
        *(("sea3", "none", "3", "typical"), ("sea0", "none", "0", "typical")),
        ("best", "none", "2", "best"),
    }
    mae = {
        (i["predictor"], i["case"]): i["value"] for i in cases["summary"] if i["metric"] == "mae"
    }
    assert mae["ukf", "sea0"] < mae["ukf", "base"] < mae["ukf", "sea3"]


def predictions(monkeypatch, folder, unit, run):
    """Return all predictions in a unit of work."""
    found = []

    def score(prediction, truth, horizons):
        found.extend([prediction.mean, prediction.cov, prediction.low])
        return scores.score(prediction, truth, horizons)

    monkeypatch.setattr(bench, "score", score)
    bench.run_unit(SMALL, unit, folder, pictures=True, run=run)
    return found


@pytest.mark.parametrize("predictor", SMALL.predictors)
def test_no_predictor_sees_the_truth_or_later_rows(tmp_path, monkeypatch, predictor):
    """With nonsense as truth and in later rows, the predictions are the same bits."""
    unit = Unit("zigzag", "gps5", 0, predictor, "", "", "2", "typical")
    run = load_run(SMALL, unit)
    wrong = dataclasses.replace(run.reference, truth=run.reference.truth + 1e5)
    z = run.seen.z.copy()
    z[run.seen.t > 40.0 + 1e-9] = 1e6  # the last origin is at 40 s
    seen = dataclasses.replace(run.seen, z=z)
    clean = predictions(monkeypatch, tmp_path, unit, run)
    poisoned = predictions(monkeypatch, tmp_path, unit, run._replace(reference=wrong, seen=seen))
    assert len(clean) == len(poisoned) == 2 * 11 * 3
    for one, other in zip(clean, poisoned, strict=True):
        np.testing.assert_array_equal(one, other)


class Greedy(Persistence):
    """Keeps whatever it can reach, and overwrites its arguments."""

    arrays: ClassVar[list] = []

    def update(self, t, dt, z, cmd):
        self.arrays.extend(item for item in (z.base, cmd.base) if item is not None)
        super().update(t, dt, z, cmd)
        z[:] = 1e6
        cmd[:] = 1e6

    def predict(self, plan, dt):
        prediction = super().predict(plan, dt)
        plan[:] = 1e6
        return prediction


def test_no_predictor_reaches_another_or_the_log(small, tmp_path, monkeypatch):
    """A predictor that overwrites its arguments runs first; the others predict the same."""
    monkeypatch.setitem(PREDICTORS, "greedy", Greedy)
    mixed = dataclasses.replace(SMALL, predictors=("greedy", *SMALL.predictors))
    results = run_all(mixed, tmp_path)
    assert not Greedy.arrays
    kept = [row for row in results["rows"] if row["predictor"] != "greedy"]
    assert kept == small[1]["rows"]


class Stumbles(Persistence):
    def predict(self, plan, dt):
        if self.t > 35.0:
            raise ZeroDivisionError("a user's")
        return super().predict(plan, dt)


def test_an_error_is_reported_and_the_rest_is_scored(tmp_path, monkeypatch):
    monkeypatch.setitem(PREDICTORS, "stumbles", Stumbles)
    broken = tmp_path / "broken.csv"
    broken.write_text("t_s\n1\n")
    settings = dataclasses.replace(
        SMALL,
        predictors=("stumbles", "persistence"),
        faults=("none",),
        seeds=(0,),
        logs=(str(broken), str(recorded_runs()["boat1_usv_circle"])),
    )
    found = dict(bench.runs(settings, tmp_path))
    text = {
        (unit.scenario, unit.predictor): str(result)
        for unit, result in found.items()
        if isinstance(result, Exception)
    }
    assert "stumbles: ZeroDivisionError: a user's (" in text["zigzag", "stumbles"]
    assert "test_runner.py, line" in text["zigzag", "stumbles"]
    assert "broken.csv" in text["broken", "persistence"]
    scored = {unit.scenario for unit, result in found.items() if isinstance(result, dict)}
    assert scored == {"zigzag", "boat1_usv_circle"}


def test_a_rolling_boat_is_scored_in_roll_pitch_and_heave(tmp_path):
    settings = Settings(
        scenarios=("heading135",),
        faults=("none",),
        seeds=(0,),
        predictors=("ukf",),
        plans=("known",),
        duration_s=100.0,
        dof=6,
        spreading=4.0,
    )
    assert settings.sea().components == 1000
    done = dict(bench.runs(settings, tmp_path))
    results = bench.collect(settings, done, "test")
    rows = {(row["channel"], row["horizon_s"]): row for row in results["motion"]}
    assert {channel for channel, _ in rows} == {"roll", "pitch", "heave", "deck_speed"}
    assert [h for channel, h in rows if channel == "roll"] == [0.5, 1.0, 2.0, 3.0, 5.0, 10.0]
    assert rows["roll", 0.5]["skill"] < 0.5 < rows["roll", 0.5]["held"]
    assert all(row["rmse"] == pytest.approx(row["skill"] * row["sd"]) for row in rows.values())
    assert [row["span_s"] for row in results["quiet"]] == [2.0, 3.0, 5.0]
    (figure,) = bench.run_figures(settings, done)
    assert [forecast.t0 for forecast in figure.examples["ukf"]] == pytest.approx([80.0, 90.0])
    # the verdict says it in words
    said = attitude_lines(results)
    assert [line.split()[0] for line in said] == ["roll", "pitch", "quiet", "quiet", "quiet"]
    assert f"errs by {rows['roll', 1.0]['skill']:.2f} and" in said[0] and "ukf" in said[0]
    assert attitude_lines({}) == []


class Gaps(Persistence):
    def forecast_from_last(self, rows, plan):
        path = super().forecast_from_last(rows, plan)
        if self.t > 35.0:
            path[7, 5] = np.nan
        return path


class PastGaps(Persistence):
    def forecast(self, rows, origins, plans):
        out = super().forecast(rows, origins, plans)
        out[-1, 0, 0] = np.inf
        return out


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (Gaps, ["origin t = 36.00 s", "r_radps is nan at step 8 of 40, 2 s ahead"]),
        (PastGaps, ["origin t = 30.00 s", "x_m is inf at step 1 of 40, 0.25 s ahead"]),
    ],
)
def test_a_forecast_with_nan_is_an_error_that_says_where(tmp_path, monkeypatch, kind, words):
    monkeypatch.setitem(PREDICTORS, "gaps", kind)
    settings = dataclasses.replace(
        SMALL, predictors=("gaps",), faults=("none",), seeds=(0,), plans=("known",)
    )
    ((unit, error),) = bench.runs(settings, tmp_path)
    assert isinstance(error, BenchmarkError)
    for word in ("gaps, run zigzag_none_0, plan known", kind.__name__, *words):
        assert word in str(error)
    assert not bench.result_file(settings, unit, tmp_path).exists()


def test_results_name_the_program_and_fresh_ones_reuse_nothing(small, tmp_path, monkeypatch):
    folder, results = small
    assert results["program"]["sources"] == bench.running_program()
    assert results["predictors"]["ukf"]["sources"] == ""
    ran = []
    monkeypatch.setattr(bench, "run_unit", lambda settings, unit, *_, **__: ran.append(unit))
    dict(bench.runs(SMALL, folder, done={}))
    assert set(ran) == set(units(SMALL))
