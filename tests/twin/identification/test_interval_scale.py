"""Intervals shrink where forecasts erred less than they claimed, and never grow."""

import numpy as np
import pytest

from tests.twin.identification.test_data_weight import PARTICULARS, SPACING, segments, window
from twin.identification.interval_scale import (
    CHANNELS,
    FACTOR_MIN,
    POINTS,
    RECORD,
    compare_segment,
    factor_ahead,
)
from twin.model.dynamics import model_of
from usv_kernel.jit import kernel


@pytest.fixture(scope="module")
def structure():
    return model_of(PARTICULARS, "mmg", biased=True)


@kernel
def factor_of(after, channel, record, config):
    return factor_ahead(after, channel, record, config)


def new_record():
    return np.zeros(1, np.dtype(RECORD))[0]


def compared(structure, sd, error, seed=0):
    """Record of 64 forecasts whose parameters err by ``error`` and claim ``sd``, of the prior's."""
    rng = np.random.default_rng(seed)
    own, record = segments(structure, structure.mean), new_record()
    rows = window(structure, structure.mean, rng, rows=64 * SPACING + own.steps + 2)
    cov, P = np.diag((sd * structure.sd) ** 2), np.zeros((6, 6))
    for k in range(64):
        xi = structure.mean + error * structure.sd * rng.standard_normal(len(structure.sd))
        compare_segment(
            k * SPACING, rows, xi, (cov, P), record, own.config, structure.terms, own.work
        )
    return record, own.config


def test_honest_claims_have_a_share_of_one(structure):
    record, _ = compared(structure, 0.05, 0.05)
    assert record["compared"] == 64
    assert np.all((record["share"] > 0.4) & (record["share"] < 2.5))
    assert record["share"].mean() == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize("channel", range(CHANNELS))
def test_claims_four_times_too_large_shrink_the_intervals(structure, channel):
    record, config = compared(structure, 0.08, 0.02)
    short, long = (factor_of(s, channel, record, config) for s in (1.0, 7.0))
    # a quarter, and what chance adds
    assert 0.2 < short < 0.55
    assert 0.2 < long < 0.8
    assert factor_of(60.0, channel, record, config) == long


def test_intervals_never_grow(structure):
    record, config = compared(structure, 0.01, 0.1)
    assert record["share"].min() > 3.0
    for after in np.linspace(0.0, 12.0, 7):
        assert all(factor_of(after, c, record, config) == 1.0 for c in range(CHANNELS))


def test_without_errors_to_compare_nothing_shrinks(structure):
    own = segments(structure, structure.mean)
    assert factor_of(3.0, 0, new_record(), own.config) == 1.0


def test_few_errors_shrink_less_than_many(structure):
    config, record = segments(structure, structure.mean).config, new_record()
    record["share"][:] = 0.2
    factors = []
    for record["compared"] in (2.0, 8.0, 30.0):
        factors.append(factor_of(5.0, 0, record, config))
    assert factors[0] > factors[1] > factors[2] > np.sqrt(0.2)


def test_a_share_of_nothing_leaves_a_least_interval(structure):
    own, record = segments(structure, structure.mean), new_record()
    record["compared"] = 30.0
    assert record["share"].shape == (POINTS, CHANNELS)
    assert factor_of(3.0, 0, record, own.config) == FACTOR_MIN


def test_a_change_of_the_boat_widens_the_intervals_again_within_five_segments(structure):
    record, config = compared(structure, 0.08, 0.02)
    before = factor_of(7.0, 0, record, config)
    own, rng = segments(structure, structure.mean), np.random.default_rng(1)
    weak = structure.mean + 0.5 * structure.sd
    rows = window(structure, weak, rng, rows=5 * SPACING + own.steps + 2)
    cov, P = np.diag((0.08 * structure.sd) ** 2), np.zeros((6, 6))
    for k in range(5):
        compare_segment(
            k * SPACING, rows, structure.mean, (cov, P), record, config, structure.terms, own.work
        )
    assert before < 0.8
    assert factor_of(7.0, 0, record, config) == 1.0
