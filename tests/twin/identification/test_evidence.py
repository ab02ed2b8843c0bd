"""The refit, and changes of a boat: found when they come, and not when they do not."""

import math

import numpy as np
import pytest

from tests.twin.identification.test_experts import (
    PARTICULARS,
    SPACING,
    refit_scratch,
    run,
    segments,
    window,
)
from twin.identification.evidence import NEVER, SHARE_SD, find_change, refit
from twin.identification.experts import BEST, CHANGED
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


def taken(structure, rows, first=0, sure=1.0):
    """Return segments of rows, and scratch of their refits."""
    own = segments(structure, structure.mean, sure)
    for start in range(first, len(rows) - own.steps - 1, SPACING):
        own.add(start, rows, own.params)
    return own, refit_scratch(own)


@pytest.mark.parametrize("side", [0, 1])
def test_a_change_is_found_with_its_size(structure, side):
    own, work = taken(structure, changed_rows(structure, side, 0.5, seed=side))
    newest = AT + own.steps + round(14.0 / GRID)
    given = own.state, own.config, own.model, work
    found = find_change(newest, NEVER, own.params, *given)
    assert abs(found - AT) * GRID <= 14.0
    # half of the thrust is one standard deviation
    assert work.size[side] == pytest.approx(-1.0, abs=0.3)
    assert np.all(np.abs(np.delete(work.size, side)) < 0.4)


@pytest.mark.parametrize("seed", range(5))
def test_no_change_is_none(structure, seed):
    rows = window(structure, structure.mean, np.random.default_rng(seed), noise=0.5, rows=200)
    own, work = taken(structure, rows)
    given = own.state, own.config, own.model, work
    assert find_change(len(rows) - 1, NEVER, own.params, *given) == NEVER


def test_without_segments_nothing_has_changed(structure):
    own, work = taken(structure, np.zeros((0, 24)))
    assert find_change(99, NEVER, own.params, own.state, own.config, own.model, work) == NEVER


def test_without_a_change_the_refit_is_that_of_the_robust_objective(structure):
    """One reweighting after the other, it goes where ``Segments.solve`` goes."""
    own, work = taken(structure, window(structure, structure.mean, np.random.default_rng(1), 1.0))
    xi, cov = structure.mean.copy(), np.zeros_like(own.prior_cov)
    for _ in range(30):
        refit(0, NEVER, xi, cov, own.state, own.config, own.model, work)
        own.solve(1)
    np.testing.assert_allclose(xi / structure.sd, own.params / structure.sd, atol=1e-6)
    np.testing.assert_allclose(cov, own.cov, rtol=1e-6, atol=1e-12)


def test_more_weight_of_the_data_leaves_less_variance(structure):
    own, work = taken(structure, window(structure, structure.mean, np.random.default_rng(1), 1.0))
    sd = []
    for r in range(3):
        xi, cov = structure.mean.copy(), np.zeros_like(own.prior_cov)
        refit(r, NEVER, xi, cov, own.state, own.config, own.model, work)
        sd.append(np.sqrt(np.diag(cov)))
    assert (sd[0] >= sd[1]).all() and (sd[1] >= sd[2]).all() and (sd[2] < 0.9 * sd[0]).any()


def test_a_change_forgets_these_four_numbers_and_nothing_else(structure):
    """Kulhavy: the variance grows by that of the change in its directions, exactly."""
    rows = window(structure, structure.mean, np.random.default_rng(2), 0.5, rows=300)
    own, work = taken(structure, rows)
    given = own.state, own.config, own.model, work
    xi, cov = structure.mean.copy(), np.zeros_like(own.prior_cov)
    refit(0, NEVER, xi, cov, *given)
    last = own.first.max()
    same, wide = structure.mean.copy(), np.zeros_like(cov)
    refit(0, float(last), same, wide, *given)
    # the last segment alone knows little: nearly all of what was forgotten is open again
    share = SHARE_SD * share_slopes(structure.terms)[0] @ structure.mean
    open_ = np.linalg.solve(wide, share) @ share
    known = np.linalg.solve(cov, share) @ share
    assert open_ < 0.5 * known
    k = [structure.parameters.index(name) for name in ("Y_|u|v", "N_|u|r", "X_vr")]
    np.testing.assert_allclose(np.diag(wide)[k], np.diag(cov)[k], rtol=0.3)


def test_after_a_change_the_refit_goes_on_from_what_was_known(structure):
    rows = changed_rows(structure, 0, 0.5, seed=3)
    experts = run(structure, segments(structure, structure.mean, sure=1.0), rows)
    count = experts.state.count
    assert abs(count[CHANGED] - AT) * GRID <= 14.0
    k = [structure.parameters.index(name) for name in ("X_nn", "N_nn")]
    weak = structure.mean - 0.5 * share_slopes(structure.terms)[0] @ structure.mean
    now = experts.state.params[int(count[BEST])]
    assert np.all(np.abs(now[k] - weak[k]) < 0.5 * np.abs(structure.mean[k] - weak[k]))


def test_a_boat_that_does_not_change_is_not_said_to_have(structure):
    rows = window(structure, structure.mean, np.random.default_rng(8), noise=0.7, rows=480)
    experts = run(structure, segments(structure, structure.mean), rows)
    assert experts.state.count[CHANGED] == NEVER
    assert math.isfinite(experts.state.weights.sum())
