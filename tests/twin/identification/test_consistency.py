"""Whether the joint filter's errors are as large as it says, where its assumptions are true.

Normalised estimation error squared (NEES) and innovation squared (NIS) over Monte-Carlo runs
must lie within the 95 % interval of their chi-square distribution. Source: Bar-Shalom, Li and
Kirubarajan 2001, section 5.4. Each test has its counterpart with a filter that is given a wrong
noise: it must fall outside.
"""

import math

import numpy as np
import pytest
from scipy.stats import chi2

from tests.twin.filters.test_ukf import BOAT, SENSOR_SD, STEP_SD
from twin.filters import ukf
from twin.model import augmented, dynamics
from twin.model.structure import N_TERMS

RUNS = 50


def inside(value: float, degrees: int) -> bool:
    """Return whether a chi-square sum, per degree of freedom, is within its 95 % interval."""
    low, high = chi2.ppf([0.025, 0.975], degrees) / degrees
    return bool(low <= value <= high)


def nees(error: np.ndarray, P: np.ndarray) -> float:
    return float(error @ np.linalg.solve(P, error))


# --- the twin's own model ---------------------------------------------------------------------

H, STEPS = 0.05, 300
# The part of the waves in the velocities is here what the filter takes it for: white noise.
START_SD = np.array([0.5, 0.5, 0.05, 0.3, 0.3, 0.05])


def twin_run(rng: np.random.Generator, given: float) -> tuple[float, float, float]:
    """Return NEES at the end, of all and of the states, and the sum of NIS of one boat.

    The boat is drawn from the filter's prior.

    Parameters
    ----------
    rng
        For the boat, its start, the process noise and the sensors.
    given
        Factor on the variance of the sensors as the filter is given it.
    """
    structure = dynamics.model_of(BOAT, "paper")
    xi0, sd0, model = structure.mean, structure.sd, structure.terms
    # A third of the prior's spread: the filter is exact for what is linear, and a boat that
    # doubles its speed within the run is not.
    sd = np.concatenate([START_SD, sd0 / 3.0])
    x = np.concatenate([[0.0, 0.0, 0.5, 5.0, 0.0, 0.0], xi0])
    P = np.diag(sd**2)
    truth = x + sd * rng.normal(size=31)
    s, xi, after, terms = truth[:6].copy(), truth[6:], np.empty(6), np.empty(N_TERMS)
    calm, unit = np.zeros(2), structure.n_unit * BOAT.shaft_speed
    weights, work = ukf.scaled_weights(31), ukf.workspace(6, 25)
    Q, R = np.diag(STEP_SD**2), given * np.diag(SENSOR_SD**2)
    config = augmented.JointConfig(model, weights)
    scratch = augmented.JointWorkspace(Q, np.zeros(25), terms, work)
    total = 0.0
    for k in range(STEPS):
        angle = 0.2 * math.copysign(1.0, math.sin(0.05 * k))
        act = np.array([unit, unit, angle, angle])
        dynamics.step(s, xi, act, calm, model, H, terms, after)
        s = after + STEP_SD * rng.normal(size=6)
        z = s + SENSOR_SD * rng.normal(size=6)
        state = augmented.JointState(x, P, act, calm)
        repairs = augmented.joint_predict(state, H, config, scratch)
        assert repairs == 0
        total += ukf.measurement_update(x, P, z, np.ones(6), R, 2, math.inf, work)
    return nees(np.concatenate([s, xi]) - x, P), nees(s - x[:6], P[:6, :6]), total


def test_joint_filter_is_consistent_on_its_own_model() -> None:
    rng = np.random.default_rng(11)
    ends, states, sums = np.array([twin_run(rng, 1.0) for _ in range(RUNS)]).T
    assert inside(ends.sum() / (31 * RUNS), 31 * RUNS)
    assert inside(states.sum() / (6 * RUNS), 6 * RUNS)
    assert inside(sums.sum() / (6 * STEPS * RUNS), 6 * STEPS * RUNS)


@pytest.mark.parametrize("given", [0.5, 2.0])
def test_a_wrong_noise_is_found_out(given: float) -> None:
    rng = np.random.default_rng(11)
    _, states, sums = np.array([twin_run(rng, given) for _ in range(RUNS)]).T
    assert not inside(sums.sum() / (6 * STEPS * RUNS), 6 * STEPS * RUNS)
    assert not inside(states.sum() / (6 * RUNS), 6 * RUNS)
