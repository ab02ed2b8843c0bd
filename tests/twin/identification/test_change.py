"""Changes of a boat: found when they come, and not when they do not."""

import numpy as np
import pytest

from tests.twin.identification.test_data_weight import PARTICULARS, SPACING, run, segments, window
from twin.identification.change import change_evidence, quadratics_by_changes
from twin.identification.data_weight import (
    ALARM,
    CHANGED,
    EVIDENCE_ALARM,
    SHORT,
    DataWeightSelector,
)
from twin.identification.segments import samples_of
from twin.model.dynamics import model_of
from twin.model.rollout import GRID
from twin.model.thrust_share import share_slopes

AT = 320


@pytest.fixture(scope="module")
def structure():
    return model_of(PARTICULARS, "mmg", biased=True, current=True)


def changed_rows(structure, side, share, seed, noise=0.5):
    """Rows of a boat of which one side gives a share of its thrust from row :data:`AT` on."""
    rng = np.random.default_rng(seed)
    xi = structure.mean.copy()
    weak = xi + (share - 1.0) * share_slopes(structure.terms)[side] @ xi
    rows = window(structure, xi, rng, noise, rows=AT)
    more = window(structure, weak, rng, noise, rows=160)
    return np.concatenate([rows, more])


def evidence_of(own, rows, first):
    for start in range(first, len(rows) - own.steps - 1, SPACING):
        own.add(start, rows, own.params)
    quadratics_by_changes(first, own.params, own.state, own.config, own.model, own.work.change)
    return change_evidence(first, samples_of(own.config), own.state, own.config, own.work.change)


@pytest.mark.parametrize("side", [0, 1])
def test_a_change_is_found_with_its_size(structure, side):
    rows = changed_rows(structure, side, 0.5, seed=side)
    own = segments(structure, structure.mean)
    assert evidence_of(own, rows, AT) > EVIDENCE_ALARM
    size = own.work.change.size.copy()
    # half of the thrust is one standard deviation
    assert size[side] == pytest.approx(-1.0, abs=0.3)
    assert np.all(np.abs(np.delete(size, side)) < 0.4)


@pytest.mark.parametrize("seed", range(5))
def test_no_change_is_no_evidence(structure, seed):
    rows = window(structure, structure.mean, np.random.default_rng(seed), noise=0.5, rows=200)
    own = segments(structure, structure.mean)
    assert evidence_of(own, rows, 0) < 0.5 * EVIDENCE_ALARM


def test_without_segments_there_is_no_evidence(structure):
    rows = window(structure, structure.mean, np.random.default_rng(0), rows=100)
    own = segments(structure, structure.mean)
    assert evidence_of(own, rows, len(rows)) == 0.0


def test_after_a_change_the_refit_goes_on_from_what_was_known(structure):
    rows = changed_rows(structure, 0, 0.5, seed=3)
    selector = DataWeightSelector(segments(structure, structure.mean, sure=1.0))
    run(structure, selector, rows)
    count = selector.state.count
    # it is found within 16 s, and at the right time within 14 s
    assert 0.0 < (count[ALARM] - AT) * GRID < 16.0
    assert abs(count[CHANGED] - AT) * GRID <= 14.0
    assert selector.chosen >= SHORT
    k = [structure.parameters.index(name) for name in ("X_nn", "N_nn")]
    weak = structure.mean - 0.5 * share_slopes(structure.terms)[0] @ structure.mean
    now = selector.params[SHORT]
    assert np.all(np.abs(now[k] - weak[k]) < 0.5 * np.abs(structure.mean[k] - weak[k]))
