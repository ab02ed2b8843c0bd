"""Adaptive conformal intervals: they hold what they claim, whatever the errors are."""

import numpy as np
import pytest

from twin.identification.conformal import (
    HORIZONS,
    MISSED,
    RECORD,
    SCORES,
    factor_ahead,
    first_record,
    take_score,
)
from usv_kernel.jit import kernel
from usv_kernel.records import as_record

DTYPE = np.dtype([*RECORD, ("sorted_", "f8", SCORES)])


@kernel
def take(h, channel, score, memory, scratch):
    record = as_record(memory, DTYPE)
    take_score(h, channel, score, record, scratch)
    record.compared += 1.0


@kernel
def factor(after, channel, memory):
    return factor_ahead(after, channel, as_record(memory, DTYPE))


@pytest.fixture
def memory():
    values = np.zeros(DTYPE.itemsize // 8)
    for name, value in first_record().items():
        values.view(DTYPE)[0][name][:] = value
    return values


def test_before_any_forecast_intervals_are_as_claimed(memory):
    record = memory.view(DTYPE)[0]
    for channel in range(5):
        assert all(factor(after, channel, memory) == 1.0 for after in (0.1, 1.0, 7.0, 60.0))
        # the scores are those of intervals that hold: a tenth of them is above 1
        assert np.mean(record["scores"][0, channel] > 1.0) == pytest.approx(MISSED, abs=0.02)


@pytest.mark.parametrize("true_sd", [0.2, 1.0, 5.0])
def test_intervals_hold_nine_of_ten_whatever_the_claim_was(memory, true_sd):
    rng, inside = np.random.default_rng(0), []
    for k in range(1000):
        score = abs(true_sd * rng.standard_normal()) / 1.645
        inside.append(score <= factor(HORIZONS[1], 2, memory))
        take(1, 2, score, memory, np.empty(SCORES))
        assert 0.0 <= memory.view(DTYPE)[0]["level"][1, 2] <= 1.0, k
    assert np.mean(inside[200:]) == pytest.approx(1.0 - MISSED, abs=0.025)
    assert factor(HORIZONS[1], 2, memory) == pytest.approx(true_sd, rel=0.4)


def test_intervals_follow_errors_that_grow(memory):
    """Online, the share inside recovers: the guarantee needs no distribution that stays."""
    rng, inside = np.random.default_rng(1), []
    for k in range(1200):
        score = abs((1.0 + k / 100.0) * rng.standard_normal()) / 1.645
        inside.append(score <= factor(HORIZONS[0], 0, memory))
        take(0, 0, score, memory, np.empty(SCORES))
    assert np.mean(inside[200:]) > 0.86


def test_one_horizon_and_channel_moves_no_other(memory):
    before = memory.view(DTYPE)[0]["factor"].copy()
    for _ in range(SCORES):
        take(2, 3, 4.0, memory, np.empty(SCORES))
    after = memory.view(DTYPE)[0]["factor"]
    assert after[2, 3] > 3.0
    after[2, 3] = before[2, 3]
    np.testing.assert_array_equal(after, before)


def test_factors_are_linear_between_horizons_and_constant_beyond(memory):
    memory.view(DTYPE)[0]["factor"][:, 1] = 1.0, 3.0, 2.0, 4.0
    found = [factor(after, 1, memory) for after in (0.2, 1.0, 1.5, 2.0, 3.5, 5.0, 10.0, 60.0)]
    np.testing.assert_allclose(found, [1.0, 1.0, 2.0, 3.0, 2.5, 2.0, 4.0, 4.0])
