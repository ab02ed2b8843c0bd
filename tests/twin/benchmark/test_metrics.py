"""Scores of predictions, and the metrics made of many of them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from twin.benchmark.metrics import KEY, METRICS, compare, recorded_table, summarise
from twin.benchmark.protocol import HORIZONS
from twin.benchmark.scores import STUDY_CHANNELS, as_measured, crps, score
from twin.predictors.base import Prediction


def test_a_perfect_prediction_has_no_error():
    rng = np.random.default_rng(0)
    start = rng.normal(size=6)
    t = np.arange(1, 201) * 0.05
    mean = start + rng.normal(size=(1, 6)) * t[:, None]
    cov = np.tile(np.eye(6), (200, 1, 1)) * (1.0 + t[:, None, None])
    prediction = Prediction(0.0, start, np.eye(6), t, mean, cov)
    truth = np.stack([start, *(mean[round(h / 0.05) - 1] for h in HORIZONS)])
    shifted = truth + np.array([5.0, -3.0, 2 * math.pi, 0.0, 0.0, 0.0])  # receiver's bias
    found = score(prediction, shifted, HORIZONS)
    np.testing.assert_allclose(found.error, 0.0, atol=1e-9)
    np.testing.assert_allclose(found.displacement, 0.0, atol=1e-9)
    assert found.change.shape == (4, 6)
    assert found.covered.shape == (4, 7) and found.covered.all()


def test_along_and_across_follow_the_true_heading():
    start = np.zeros(6)
    t = np.arange(1, 201) * 0.05
    mean = np.zeros((200, 6))
    mean[:, 1] = 2.0 * t  # sails east
    prediction = Prediction(0.0, start, np.zeros((6, 6)), t, mean, np.zeros((200, 6, 6)))
    truth = np.zeros((5, 6))
    truth[:, 2] = math.pi / 2
    truth[1:, 1] = np.array(HORIZONS) * 1.5
    truth[1:, 0] = -1.0
    found = score(prediction, truth, HORIZONS)
    ahead = 0.5 * np.array(HORIZONS)
    np.testing.assert_allclose(found.error[:, 3], ahead)  # along: ahead
    np.testing.assert_allclose(found.error[:, 4], -1.0)  # across: to port of the truth
    np.testing.assert_allclose(found.displacement, np.hypot(ahead, 1.0))


def test_intervals_of_known_errors_cover_nine_in_ten():
    """Normal errors with the stated covariance: 0.9 within 4 sd of 2000 draws (0.027).

    ``low`` and ``high`` decide on u, v, r and heading where they are given.
    """
    rng = np.random.default_rng(1)
    root = rng.normal(size=(6, 6))
    root[2] *= 0.3 / np.linalg.norm(root[2])  # a heading error that does not wrap
    cov = root @ root.T
    t, zero = np.array([5.0, 10.0]), np.zeros((6, 6))
    mean = np.zeros((2, 6))
    covered, given = [], []
    for error in rng.normal(size=(2000, 6)) @ root.T:
        truth = np.stack([np.zeros(6), error])
        prediction = Prediction(0.0, np.zeros(6), zero, t, mean, np.tile(cov, (2, 1, 1)))
        covered.append(score(prediction, truth, (10.0,)).covered[0])
        wide = dataclasses.replace(prediction, low=mean - 100.0, high=mean + 100.0)
        given.append(score(wide, truth, (10.0,)).covered[0])
    share = np.mean(covered, axis=0)
    np.testing.assert_allclose(share, 0.9, atol=0.027)
    assert np.all(np.mean(given, axis=0)[[0, 1, 2, 5]] == 1.0)
    np.testing.assert_array_equal(np.mean(given, axis=0)[[3, 4, 6]], share[[3, 4, 6]])


def test_fixes_and_headings_of_known_noise_are_covered_nine_in_ten(boat):
    """The same share (0.9 within 4 sd of 2000 draws) where sensors stand for the truth."""
    rng = np.random.default_rng(2)
    on_board = boat.instruments
    cov, t = np.diag([0.3, 0.3, 0.01, 0.1, 0.1, 0.01]) ** 2, np.array([10.0])
    prediction = Prediction(0.0, np.zeros(6), np.zeros((6, 6)), t, np.zeros((1, 6)), cov[None])
    noise = [on_board.gps_sd, on_board.gps_sd, on_board.compass_sd]
    covered = []
    for _ in range(2000):
        measured = rng.normal(size=(2, 3)) * noise
        measured[1] += np.sqrt(np.diag(cov))[:3] * rng.normal(size=3)
        covered.append(score(as_measured(prediction, boat), measured, (10.0,)).covered[0])
    np.testing.assert_allclose(np.mean(covered, axis=0), 0.9, atol=0.027)


def test_crps_equals_scoringrules():
    """Widths that differ, that are equal, and none at all; agreement to rounding."""
    rules = pytest.importorskip("scoringrules")
    rng = np.random.default_rng(0)
    error, (down, up) = 3.0 * rng.normal(size=500), rng.uniform(0.1, 3.0, (2, 500))
    np.testing.assert_allclose(
        crps(error, down, up), rules.crps_2pnormal(error, down, up, 0.0), rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(
        crps(error, up, up), rules.crps_normal(error, 0.0, up), rtol=1e-9, atol=1e-12
    )
    none = np.zeros(500)
    np.testing.assert_allclose(crps(error, none, none), np.abs(error))


def test_over_runs_j_is_a_ratio_of_mean_errors():
    """A run on which the oracle is nearly perfect counts by its error, not by its ratio."""
    base = dict.fromkeys(KEY, "x") | {name: 1.0 for name in METRICS}
    errors = {"oracle": (0.01, 1.0, 1.0), "ukf": (0.1, 1.1, 1.2)}
    rows = [
        base
        | {
            "seed": seed,
            "predictor": name,
            "curves": dict.fromkeys(STUDY_CHANNELS, [error] * 20),
        }
        | {"J": error / oracle, "E": error / oracle - 1.0}
        for name, each in errors.items()
        for seed, (error, oracle) in enumerate(zip(each, errors["oracle"], strict=True))
    ]
    found = {item["metric"]: item for item in summarise(rows) if item["predictor"] == "ukf"}
    assert found["E"]["value"] == pytest.approx(2.4 / 2.01 - 1.0)
    assert found["J"]["value"] == pytest.approx(found["E"]["value"] + 1.0)
    assert found["E"]["median"] == found["E_runs"]["median"] == pytest.approx(0.2)
    assert found["E_runs"]["value"] == pytest.approx((9.0 + 0.1 + 0.2) / 3.0)
    assert found["E"]["low"] == pytest.approx(0.1)
    assert found["E"]["high"] == pytest.approx(9.0)


def test_the_paired_comparison_counts_wins_and_the_mean_change():
    """Six seeds on which one is a tenth better, and three fold worse on a seventh."""
    base = {"scenario": "turn", "case": "none", "fault": "none", "plan": "known"}
    base |= {"sea": "2", "grade": "typical"}
    rows = [
        {**base, "seed": seed, "predictor": name, "mae": mae}
        for seed in range(7)
        for name, mae in (("ukf", 1.0 + seed), ("new", (1.0 + seed) * (3.0 if seed == 6 else 0.9)))
    ]
    (found,) = compare(rows, "ukf")
    assert (found["predictor"], found["against"]) == ("new", "ukf")
    assert (found["wins"], found["seeds"]) == (6, 7)
    assert found["median_percent"] == pytest.approx(-10.0)
    assert found["change_percent"] == pytest.approx(100.0 * ((21 * 0.9 + 21.0) / 28.0 - 1.0))
    assert found["low"] == pytest.approx(-10.0) and found["high"] > 60.0
    assert compare(rows, "lstm") == []
    few = compare([row for row in rows if row["seed"] < 2], "ukf")[0]
    assert few["low"] is None and few["change_percent"] == pytest.approx(-10.0)


def test_recorded_ratios_are_to_persistence():
    """Two runs: ratios .5 and .2 of displacement, against a reference at 1 and .4."""
    rows = []
    for run, base, own, ref in (("a", 2.0, 1.0, 2.0), ("b", 5.0, 1.0, 2.0)):
        for name, rmse in (("persistence", base), ("ukf", own), ("var", ref)):
            table = {c: {"mse": [0.0, rmse**2]} for c in ("displacement", "psi")}
            unit = {"scenario": run, "fault": "none", "predictor": name, "log": f"/x/ships/{run}"}
            rows.append({"unit": unit, "plans": {"known": {"channels": table}}})
    found = {r["predictor"]: r for r in recorded_table(rows, "var") if r["channel"] == "psi"}
    assert found["persistence"]["ratio"] == 1.0 and found["ukf"]["folder"] == "ships"
    assert found["ukf"]["ratio"] == pytest.approx(0.35)
    assert found["ukf"]["geometric"] == pytest.approx(math.sqrt(0.1))
    assert found["ukf"]["change_percent"] == pytest.approx(-50.0)
    assert (found["ukf"]["wins"], found["ukf"]["runs"]) == (2, 2)
    assert "against" not in found["var"]


def test_recorded_errors_are_also_over_persistence_of_the_record():
    """Mean errors .3 and .1 m over .6 and .2 m; headings in degrees."""
    rows = [
        {
            "unit": {
                "scenario": run,
                "fault": "none",
                "predictor": "ukf",
                "log": f"/x/ships/{run}",
            },
            "plans": {
                "known": {"channels": {c: {"mse": [rmse**2]} for c in ("displacement", "psi")}}
            },
            "held_mse": {"displacement": (2.0 * rmse) ** 2, "psi": (4.0 * rmse) ** 2},
        }
        for run, rmse in (("a", 0.3), ("b", 0.1))
    ]
    found = {row["channel"]: row for row in recorded_table(rows, "var")}
    assert found["displacement"]["ratio_recorded"] == pytest.approx(0.5)
    assert found["displacement"]["error"] == pytest.approx(0.2)
    assert found["psi"]["ratio_recorded"] == pytest.approx(0.25)
    assert found["psi"]["error"] == pytest.approx(math.degrees(0.2))
    assert "ratio" not in found["psi"]  # the twin's own persistence took no part
