"""Scores of roll, pitch, heave and quiet spells against cases worked by hand."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from twin import Log
from twin.benchmark.motion_scores import (
    MOTION_HORIZONS,
    MOTION_UNITS,
    MotionTruth,
    auc,
    motion_rows,
    motion_table,
    quiet_rows,
)
from twin.channels import MEASUREMENTS
from twin.motion import HORIZONS, MotionForecast
from twin.sim.bridge import particulars_of
from usv_gym import Vessel

BOAT = particulars_of(Vessel.load("usv75"), dof=6)
UNIT = {
    "scenario": "heading90",
    "case": "none",
    "fault": "none",
    "sea": "2",
    "grade": "typical",
    "seed": 0,
    "predictor": "ukf",
}


def rolling(amplitude: float = 0.1, period: float = 4.0) -> Log:
    """Return a minute of a boat that rolls as a sine, and does nothing else."""
    t = np.arange(0.0, 60.0, 0.05)
    motion = np.zeros((len(t), 6))
    motion[:, 1] = amplitude * np.sin(2.0 * math.pi * t / period)
    z = np.full((len(t), len(MEASUREMENTS)), np.nan)
    return Log(t, z, np.zeros((len(t), 4)), np.zeros((len(t), 6)), true_motion=motion)


def constant(t0: float, roll: float, sd: float, quiet: float) -> MotionForecast:
    rows = 1 + len(HORIZONS)
    mean = np.zeros((rows, 4))
    mean[:, 0] = roll
    times = t0 + np.concatenate([[0.0], HORIZONS])
    return MotionForecast(t0, times, mean, np.full((rows, 4), sd), np.full(3, quiet))


def test_the_mean_has_a_skill_of_one_and_the_truth_of_zero() -> None:
    truth = MotionTruth(rolling(), BOAT, 0.0)
    starts = np.arange(5.0, 45.0, 0.5)
    mean = motion_table([truth.score(constant(t, 0.0, 0.07, 0.5)) for t in starts])
    roll = mean["channels"]["roll"]
    assert roll["sd"] == pytest.approx([0.1 / math.sqrt(2.0)] * len(MOTION_HORIZONS), rel=0.02)
    np.testing.assert_allclose(roll["skill"], 1.0, atol=0.02)
    # a sine is within 1.645 sd at all times but near its crests
    assert roll["coverage90"] == [1.0] * len(MOTION_HORIZONS)
    exact = []
    for t in starts:
        forecast = constant(t, 0.0, 1e-3, 0.5)
        forecast.mean[:, 0] = 0.1 * np.sin(0.5 * math.pi * forecast.t)
        exact.append(truth.score(forecast))
    assert max(motion_table(exact)["channels"]["roll"]["skill"]) < 0.02


def test_the_mean_has_a_skill_of_one_where_the_waves_grow() -> None:
    """It is that of the times that were forecast, not of the whole run."""
    log = rolling()
    motion = log.true_motion * np.linspace(0.2, 2.0, len(log.t))[:, None]
    truth = MotionTruth(dataclasses.replace(log, true_motion=motion), BOAT, 0.0)
    mean = float(truth.values[:, 0].mean())
    parts = [truth.score(constant(t, mean, 0.07, 0.5)) for t in np.arange(5.0, 45.0, 0.5)]
    roll = motion_table(parts)["channels"]["roll"]
    np.testing.assert_allclose(roll["skill"], 1.0, rtol=1e-9)
    assert roll["sd"][-1] > 1.05 * roll["sd"][0]


def test_a_quiet_spell_is_one_within_the_limits_throughout() -> None:
    """Roll of .1 rad passes the limit of 3 degrees on the way to each crest."""
    truth = MotionTruth(rolling(), BOAT, 0.0)
    # sin(w t) = .5236 at .351 s: a spell that begins at 8 s ends then
    assert not truth.score(constant(8.0, 0.0, 0.1, 0.5)).was_quiet.any()
    quiet = MotionTruth(rolling(amplitude=0.05), BOAT, 0.0)
    score = quiet.score(constant(8.0, 0.0, 0.1, 0.5))
    assert score.was_quiet.all()
    assert score.margin == pytest.approx(1.0)


def test_deck_speed_is_that_of_the_deck_point() -> None:
    log = rolling()
    motion = log.true_motion.copy()
    motion[:, 5] = 0.2  # pitch rate: the bow rises
    moved = MotionTruth(Log(log.t, log.z, log.cmd, log.truth, true_motion=motion), BOAT, 0.0)
    np.testing.assert_allclose(
        moved.values[:, 3], -0.2 * 0.4 * BOAT.length * np.cos(motion[:, 1]), rtol=1e-12
    )


def test_auc_is_the_chance_to_rank_rightly() -> None:
    happened = np.array([True, False, True, False])
    assert auc(np.array([3.0, 1.0, 4.0, 2.0]), happened) == 1.0
    assert auc(np.array([1.0, 3.0, 2.0, 4.0]), happened) == 0.0
    assert auc(np.array([1.0, 1.0, 1.0, 1.0]), happened) == 0.5
    assert math.isnan(auc(np.ones(4), np.ones(4, dtype=bool)))


def test_rows_name_channel_horizon_and_pool_the_quiet_spells() -> None:
    truth = MotionTruth(rolling(amplitude=0.06), BOAT, 0.0)
    starts = np.arange(5.0, 45.0, 0.37)
    parts = [truth.score(constant(t, 0.0, 0.07, 0.3)) for t in starts]
    result = {"unit": UNIT, "motion": {"known": motion_table(parts)}}
    rows = list(motion_rows([result, {"unit": UNIT}]))
    assert len(rows) == len(MOTION_UNITS) * len(MOTION_HORIZONS)
    assert {(row["channel"], row["horizon_s"]) for row in rows} == {
        (channel, horizon) for channel in MOTION_UNITS for horizon in MOTION_HORIZONS
    }
    assert all(row["rmse"] >= 0.0 and row["n"] == len(starts) for row in rows)
    spans = list(quiet_rows([result, result]))
    assert [row["span_s"] for row in spans] == [2.0, 3.0, 5.0]
    base = spans[0]["base_rate"]
    assert spans[0]["n"] == 2 * len(starts)
    assert spans[0]["brier"] == pytest.approx(base * 0.49 + (1.0 - base) * 0.09)
    ((given, share, number),) = spans[0]["reliability"]
    assert (given, share, number) == (pytest.approx(0.3), base, 2 * len(starts))
