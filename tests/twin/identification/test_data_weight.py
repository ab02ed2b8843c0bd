"""Refits of unequal trust: their forecasts decide which is in use."""

import numpy as np
import pytest

from twin.identification.data_weight import (
    DATA_WEIGHTS,
    SCORED,
    SCORED_MIN,
    DataWeightSelector,
    forecast_error,
    keep_parameters,
    score,
    select_data_weight,
)
from twin.identification.prediction_error import (
    ACT,
    COLUMNS,
    GOOD,
    LOW,
    MIDDLE,
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
    table[:, MIDDLE:] = act
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
    selector = DataWeightSelector(segments(structure, structure.mean))
    selector.params[1] = wild
    own = selector.segments
    keep_parameters(0, SPACING, selector.state)
    score(0, rows, selector.state, own.config, own.model, own.work)
    assert np.isfinite(selector.errors).all()
    assert np.argmax(selector.errors) == 1


def segments(structure, mean, sure=1.0):
    cov, schedule = np.diag((structure.sd / sure) ** 2), (1.0, 8, SPACING, 440, 0.0)
    return Segments(structure.terms, mean, cov, SETTINGS, 60, schedule)


def run(structure, selector, rows):
    """As the predictor does it: a refit every second."""
    own, next_start = selector.segments, 0
    given = own.config, own.model, own.work
    for newest in range(0, len(rows), 4):
        while next_start + own.steps < newest:
            own.add(next_start, rows, own.params)
            score(next_start, rows, selector.state, *given)
            next_start += SPACING
        if (own.first >= 0).sum() < 3:
            continue
        for start in range(next_start, newest + 1, SPACING):
            keep_parameters(start, SPACING, selector.state)
        own.relinearise(rows, 8)
        select_data_weight(newest, selector.state, own.state, *given)


@pytest.mark.slow
def test_a_prior_that_is_sure_and_wrong_loses_to_the_data(structure):
    truth = structure.mean.copy()
    for name in ("N_uv", "N_|u|r", "Y_|u|v", "X_nn"):
        k = structure.parameters.index(name)
        truth[k] += 0.5 * structure.sd[k]
    rows = window(structure, truth, np.random.default_rng(1), noise=1.0)
    selector = DataWeightSelector(segments(structure, structure.mean, sure=20.0))
    run(structure, selector, rows)
    assert selector.chosen > 0
    own = selector.segments
    assert (own.params == selector.params[selector.chosen]).all()
    assert DATA_WEIGHTS[selector.chosen] > DATA_WEIGHTS[0]
    # the choice pays on what comes later
    later = window(structure, truth, np.random.default_rng(2))
    errors = [
        np.mean([error_of(structure, later, xi, k) for k in (40, 120, 200)])
        for xi in selector.params
    ]
    assert errors[selector.chosen] < errors[0]


def test_a_good_prior_is_kept_in_noise(structure):
    rows = window(structure, structure.mean, np.random.default_rng(3), noise=1.0)
    selector = DataWeightSelector(segments(structure, structure.mean))
    run(structure, selector, rows)
    assert selector.state.count[SCORED] >= SCORED_MIN
    assert selector.chosen == 0
    assert selector.errors[0] < selector.errors[2]
