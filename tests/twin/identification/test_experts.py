"""Experts: their forecasts decide which is in use."""

import numpy as np
import pytest

from twin.identification.evidence import REFITS, evidence_work, find_change, refit
from twin.identification.experts import (
    BEST,
    CHANGED,
    EXPERTS,
    JOINT,
    PRIOR,
    SCORED,
    SHARE,
    Experts,
    choose,
    forecast_error,
    note,
    score,
)
from twin.identification.prediction_error import (
    ACT,
    COLUMNS,
    COMMAND,
    FIRST,
    GOOD,
    LOW,
    MIDDLE,
    NONE,
    STATE,
)
from twin.identification.segments import Segments
from twin.model.dynamics import model_of
from twin.model.rollout import (
    GRID,
    Paths,
    RolloutConfig,
    RolloutStart,
    Waves,
    rollout,
    rollout_size,
)
from twin.model.structure import N_STATES
from twin.particulars import Particulars
from twin.predictors.dsw_ukf_plus import refit_settings
from twin.sim.bridge import particulars_of
from usv_gym.vessel.vessel import Vessel
from usv_kernel.arrays import flat_size, python_views

PARTICULARS: Particulars = particulars_of(Vessel.load("usv75"))
SETTINGS = refit_settings(PARTICULARS)
SPACING = round(SETTINGS.spacing / GRID)


def window(structure, xi, rng, noise=0.0, rows=500):
    """Rows of a boat whose model is exactly right, steered by steps."""
    n = PARTICULARS.shaft_speed * structure.n_unit
    act = np.empty((rows, 4))
    act[:, :2] = n
    act[:, 2:] = np.repeat(rng.uniform(-0.3, 0.3, (rows // 20 + 1, 1)), 20, axis=0)[:rows]
    start = np.zeros(N_STATES)
    start[3] = PARTICULARS.speed
    lags = np.zeros(3)
    lags[2] = 1e9
    out = np.empty((rows, N_STATES))
    begin = RolloutStart(start[None], np.asarray(xi)[None], act[0], np.zeros(2))
    config = RolloutConfig(lags, np.full(3, 1e3), structure.terms)
    paths, none = Paths(out[None], np.empty((rows, 4))), Waves(np.zeros((1, 0, 3)), 0.0)
    rollout(begin, act, GRID, config, none, paths, np.zeros(rollout_size()))
    table = np.zeros((rows, COLUMNS))
    table[0, STATE : STATE + N_STATES] = start
    table[1:, STATE : STATE + N_STATES] = out[:-1]
    table[:, LOW : LOW + 3] = table[:, 3:6]
    table[0, ACT:MIDDLE] = act[0]
    table[1:, ACT:MIDDLE] = act[:-1]
    table[:, MIDDLE:COMMAND] = act
    table[:, GOOD] = 1.0
    table[:, :6] += noise * rng.standard_normal((rows, 6)) * SETTINGS.sd
    return table


@pytest.fixture(scope="module")
def structure():
    return model_of(PARTICULARS, "mmg", biased=True)


def error_of(structure, rows, xi, first=0):
    own = segments(structure, structure.mean)
    return forecast_error(first, rows, xi, structure.terms, own.config, own.work.line)


def test_the_right_parameters_have_no_error_and_others_do(structure):
    rows = window(structure, structure.mean, np.random.default_rng(0))
    # actuators switch between rows: what is left is of the integration, far below a sd
    right = error_of(structure, rows, structure.mean, 40)
    assert right < 1e-3
    assert error_of(structure, rows, structure.mean + 0.5 * structure.sd, 40) > 100.0 * right


def test_a_forecast_that_leaves_all_bounds_is_the_worst(structure):
    rows = window(structure, structure.mean, np.random.default_rng(0))
    wild = structure.mean.copy()
    wild[structure.parameters.index("X_u|u|")] = 10.0
    assert error_of(structure, rows, wild) == np.inf
    experts = run(structure, segments(structure, structure.mean), rows[:80])
    experts.state.params[1] = wild
    note(80, SPACING, experts.state)
    take(experts, 80, rows, segments(structure, structure.mean))
    weights = experts.state.weights
    assert np.isfinite(weights).all() and weights.sum() == pytest.approx(1.0)
    assert np.argmin(np.delete(weights, JOINT)) == 1


def segments(structure, mean, sure=1.0):
    cov, schedule = np.diag((structure.sd / sure) ** 2), (1.0, 8, SPACING, 440, 0.0)
    return Segments(structure.terms, mean, cov, SETTINGS, 60, schedule)


def refit_scratch(own):
    """Scratch of the refits of some segments, by name."""
    sizes = len(own.prior), own.config.capacity
    work = np.zeros(flat_size(evidence_work, *sizes))
    return python_views(evidence_work)(work, *sizes)


def take(experts, first, rows, own):
    score(first, rows, experts.state, own.config, own.model, own.work.line)


def run(structure, own, rows):
    """As the predictor does it: a refit every second."""
    experts, work, next_start = Experts(own.prior, own.prior_cov, NONE), refit_scratch(own), 0
    state, bounds = experts.state, np.array([20.0, 20.0, 3.0])
    given = own.state, own.config, own.model, work
    for newest in range(0, len(rows), 4):
        best = state.params[int(state.count[BEST])]
        while next_start + own.steps < newest:
            own.add(next_start, rows, best)
            take(experts, next_start, rows, own)
            next_start += SPACING
        for start in range(next_start, newest + 1, SPACING):
            note(start, SPACING, state)
        if (own.first >= 0).sum() < 3:
            continue
        own.params[:] = best
        own.relinearise(rows, 8)
        changed = find_change(newest, state.count[CHANGED], best, *given)
        state.count[CHANGED] = changed
        for r in range(REFITS):
            refit(r, changed, state.params[r], state.cov[r], *given)
        choose(rows[newest], bounds, state, own.model, own.work.line)
    return experts


@pytest.mark.slow
def test_a_prior_that_is_sure_and_wrong_loses_to_the_data(structure):
    truth = structure.mean.copy()
    for name in ("N_uv", "N_|u|r", "Y_|u|v", "X_nn"):
        k = structure.parameters.index(name)
        truth[k] += 0.5 * structure.sd[k]
    rows = window(structure, truth, np.random.default_rng(1), noise=1.0)
    experts = run(structure, segments(structure, structure.mean, sure=20.0), rows)
    assert 0 < experts.chosen < REFITS
    # the choice pays on what comes later
    later = window(structure, truth, np.random.default_rng(2))
    errors = [
        np.mean([error_of(structure, later, xi, k) for k in (40, 120, 200)])
        for xi in experts.state.params
    ]
    assert errors[experts.chosen] < errors[0]


def test_a_good_prior_is_kept_in_noise(structure):
    rows = window(structure, structure.mean, np.random.default_rng(3), noise=1.0)
    experts = run(structure, segments(structure, structure.mean), rows)
    assert experts.state.count[SCORED] >= 20
    assert experts.chosen in (0, PRIOR)
    assert experts.state.weights[0] > experts.state.weights[2]


def test_an_expert_that_was_worse_for_long_takes_over_in_a_few_segments(structure):
    """Fixed share: no weight falls so far that it does not come back."""
    own = segments(structure, structure.mean)
    rows = window(structure, structure.mean, np.random.default_rng(0), noise=0.1)
    wrong = structure.mean + structure.sd
    experts = Experts(own.prior, own.prior_cov, FIRST)
    state = experts.state
    state.past[:] = wrong
    state.past[:, JOINT] = structure.mean
    for first in range(0, 320, SPACING):
        take(experts, first, rows, own)
    assert state.weights[JOINT] > 0.9
    assert state.weights.min() >= SHARE / EXPERTS
    state.past[:] = wrong
    state.past[:, 1] = structure.mean
    needed = 0
    while state.weights.argmax() != 1:
        take(experts, needed * SPACING, rows, own)
        needed += 1
        assert needed < 8


def test_an_expert_that_is_none_has_no_weight(structure):
    own = segments(structure, structure.mean)
    rows = window(structure, structure.mean, np.random.default_rng(0))
    for joint in (NONE, FIRST):
        experts = Experts(own.prior, own.prior_cov, joint)
        assert experts.state.weights.sum() == pytest.approx(1.0)
        assert experts.chosen == (JOINT if joint == FIRST else 0)
        assert experts.uses_prior and experts.best_refit() is None
        take(experts, 0, rows, own)
        assert (experts.state.weights[JOINT] > 0.0) == (joint == FIRST)
