"""Rival refits: what they foretold decides which is in use."""

import dataclasses

import numpy as np
import pytest

from twin.identification.data_weight import ENOUGH, TRUSTS, Rivals, miss
from twin.identification.prediction_error import (
    ACT,
    COLUMNS,
    GOOD,
    GRID,
    LOW,
    MIDDLE,
    STATE,
    Segments,
)
from twin.model.dynamics import model_of
from twin.model.rollout import roll_out
from twin.model.structure import N_STATES, N_TERMS
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
    out_act, room = np.empty((rows, 4)), np.zeros(400)
    envelope = np.full(3, 1e3)
    roll_out(
        *(start, xi, act[0], act, GRID, lags, envelope, np.zeros(2), structure.kit),
        *(np.zeros((0, 3)), 0.0, out, out_act, room),
    )
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


def missed(structure, rows, xi, first=0):
    weights = SETTINGS.sd**-2.0
    how = (first, round(SETTINGS.horizon / GRID), SETTINGS.every, rows)
    return miss(*how, xi, structure.kit, weights[0], weights[2], np.zeros(3 * N_TERMS + 24))


def test_the_right_parameters_miss_nothing_and_others_do(structure):
    rows = window(structure, structure.mean, np.random.default_rng(0))
    # actuators switch between rows: what is left is of the integration, far below a sd
    right = missed(structure, rows, structure.mean, 40)
    assert right < 1e-3
    assert missed(structure, rows, structure.mean + 0.5 * structure.sd, 40) > 100.0 * right


def test_a_forecast_that_leaves_all_bounds_is_the_worst(structure):
    rows = window(structure, structure.mean, np.random.default_rng(0))
    wild = structure.mean.copy()
    wild[structure.parameters.index("X_u|u|")] = 10.0
    assert missed(structure, rows, wild) == np.inf
    rivals = Rivals(segments(structure, structure.mean), SPACING)
    rivals.params[1] = wild
    rivals.note([0])
    rivals.judge(0, rows)
    assert np.isfinite(rivals.errors).all()
    assert np.argmax(rivals.errors) == 1


def segments(structure, mean, sure=1.0):
    return Segments(structure.kit, mean, np.diag((structure.sd / sure) ** 2), SETTINGS, 60)


def run(structure, rivals, rows):
    """As the predictor does it: a refit every second."""
    own, next_start = rivals.segments, 0
    for newest in range(0, len(rows), 4):
        while next_start + own.steps < newest:
            own.add(next_start, rows, own.params)
            rivals.judge(next_start, rows)
            next_start += SPACING
        if (own.first >= 0).sum() < 3:
            continue
        rivals.note(range(next_start, newest + 1, SPACING))
        own.renew(rows, 8)
        rivals.solve()


def test_a_prior_that_is_sure_and_wrong_loses_to_the_data(structure):
    truth = structure.mean.copy()
    for name in ("N_uv", "N_|u|r", "Y_|u|v", "X_nn"):
        k = structure.parameters.index(name)
        truth[k] += 0.5 * structure.sd[k]
    rows = window(structure, truth, np.random.default_rng(1), noise=1.0)
    rivals = Rivals(segments(structure, structure.mean, sure=20.0), SPACING)
    run(structure, rivals, rows)
    assert rivals.chosen > 0
    own = rivals.segments
    assert (own.params == rivals.params[rivals.chosen]).all()
    assert own.trust == TRUSTS[rivals.chosen]
    # the choice pays on what comes later
    later = window(structure, truth, np.random.default_rng(2))
    errors = [
        np.mean([missed(structure, later, xi, k) for k in (40, 120, 200)]) for xi in rivals.params
    ]
    assert errors[rivals.chosen] < errors[0]


def test_a_good_prior_is_kept_in_noise(structure):
    rows = window(structure, structure.mean, np.random.default_rng(3), noise=1.0)
    rivals = Rivals(segments(structure, structure.mean), SPACING)
    run(structure, rivals, rows)
    assert rivals.judged >= ENOUGH
    assert rivals.chosen == 0
    assert rivals.errors[0] < rivals.errors[2]


def test_forecasts_are_judged_with_what_was_believed_when_they_began(structure):
    rows = window(structure, structure.mean, np.random.default_rng(4))
    rivals = Rivals(segments(structure, structure.mean), SPACING)
    rivals.note([SPACING])
    before = rivals.params.copy()
    rivals.params += structure.sd  # learned later
    rivals.note([SPACING])
    rivals.judge(SPACING, rows)
    late = rivals.errors.copy()
    rivals.reset()
    rivals.params[:] = before
    rivals.note([SPACING])
    rivals.judge(SPACING, rows)
    np.testing.assert_array_equal(late, rivals.errors)


def test_reset_forgets(structure):
    rows = window(structure, structure.mean, np.random.default_rng(5), noise=0.5)
    rivals = Rivals(segments(structure, structure.mean), SPACING)
    run(structure, rivals, rows)
    rivals.reset()
    fresh = Rivals(segments(structure, structure.mean), SPACING)
    np.testing.assert_array_equal(rivals.record, fresh.record)
    assert (rivals.judged, rivals.chosen) == (0, 0)


def test_settings_are_those_of_the_boat():
    half = refit_settings(dataclasses.replace(PARTICULARS, length=0.5 * PARTICULARS.length))
    assert half.sd[0] == pytest.approx(0.5 * SETTINGS.sd[0])
