"""The structured filter against filterpy's full one, a textbook filter, and abuse."""

import dataclasses
import math

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from twin.filters import ukf
from twin.model import augmented, dynamics
from twin.model.structure import MODELS, N_TERMS, Structure
from twin.particulars import Particulars

H = 0.05
BOAT = Particulars(
    name="study boat",
    length=7.5,
    beam=2.714,
    draft=0.526,
    mass=3420.0,
    speed=5.4,
    shaft_speed=6.33,
)
SENSOR_SD = np.array([1.0, 1.0, 0.03, 0.3, 0.3, 0.048])
STEP_SD = np.array([1e-3, 1e-3, 1e-4, 0.05, 0.05, 0.0125])
START_SD = np.array([2.0, 2.0, 0.05, 0.3, 0.3, 0.05])


PAPER = dynamics.model_of(BOAT, "paper")
SHAFT = 6.33
CALM, WINDY = np.zeros(2), np.array([-6.0, 8.0])


def start(structure: Structure = PAPER) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and covariance at the start; the covariance is full."""
    n = 6 + len(structure)
    x = np.concatenate([[0.0, 0.0, 6.2, 5.0, 0.0, 0.0], structure.mean])
    sd = np.concatenate([START_SD, structure.sd])
    mix = np.eye(n) + 0.1 * np.random.default_rng(1).normal(size=(n, n))
    P = mix @ mix.T * np.outer(sd, sd)
    return x, (P + P.T) / 2.0


def run_of_boat(
    steps: int, seed: int, structure: Structure = PAPER, wind: np.ndarray = CALM
) -> tuple[np.ndarray, np.ndarray]:
    """Return actuators (steps, 4) and noisy states (steps, 6) of a boat in random turns."""
    rng = np.random.default_rng(seed)
    angles = np.repeat(rng.uniform(-0.2, 0.35, steps // 50 + 1), 50)[:steps]
    # fixed propellers turn the boat by their difference, drives by their angles
    n = SHAFT * structure.n_unit
    acts = np.column_stack([n * (1.0 + 1.5 * angles), n * (1.0 - 1.5 * angles), angles, angles])
    s, after, terms = np.array([0.0, 0.0, 6.2, 5.0, 0.0, 0.0]), np.empty(6), np.empty(N_TERMS)
    states = np.empty((steps, 6))
    for k in range(steps):
        dynamics.step(s, structure.mean, acts[k], wind, structure.terms, H, terms, after)
        s = after + 0.3 * STEP_SD * rng.normal(size=6)
        states[k] = s + SENSOR_SD * rng.normal(size=6)
    return acts, states


class FullFilter:
    """filterpy's filter with all points (63 for 25 parameters) on the same model."""

    def __init__(
        self,
        x: np.ndarray,
        P: np.ndarray,
        scaling: tuple[float, float, float],
        structure: Structure,
        wind: np.ndarray,
    ) -> None:
        self.model, self.wind, self.terms = structure.terms, wind, np.empty(N_TERMS)
        points = MerweScaledSigmaPoints(len(x), *scaling)
        self.f = UnscentedKalmanFilter(len(x), 6, H, None, self.move, points)
        self.f.x, self.f.P = x.copy(), P.copy()

    def move(self, x: np.ndarray, dt: float, act: np.ndarray) -> np.ndarray:
        after = x.copy()
        s, xi = x[:6].copy(), x[6:].copy()
        dynamics.step(s, xi, act, self.wind, self.model, dt, self.terms, after[:6])
        return after

    def step(
        self, act: np.ndarray, z: np.ndarray, mask: np.ndarray, Q: np.ndarray, R: np.ndarray
    ) -> None:
        self.f.Q = Q
        self.f.predict(act=act)
        if not mask.any():
            self.f.update(None)
            return
        index = np.flatnonzero(mask)
        z = z.copy()
        z[2] -= 2.0 * math.pi * round((z[2] - self.f.x[2]) / (2.0 * math.pi))
        self.f.update(z[index], R=R[np.ix_(index, index)], hx=lambda x: x[index])


def spread_of(rng: np.random.Generator, sd: np.ndarray) -> np.ndarray:
    """Return a random full covariance about these standard deviations."""
    mix = np.eye(6) + 0.2 * rng.normal(size=(6, 6))
    C = mix @ mix.T * np.outer(sd, sd)
    return (C + C.T) / 2.0


def correct(x, P, z, R, angle=-1, gate=math.inf) -> float:
    """Correct mean and covariance in place by measured states, NaN where there is none."""
    z, R = np.asarray(z, dtype=np.float64), np.asarray(R, dtype=np.float64)
    work = ukf.workspace(len(z), len(x) - len(z))
    return ukf.measurement_update(x, P, z, np.isfinite(z), R, angle, gate, work)


@pytest.mark.parametrize(
    ("structure", "scaling", "losses", "changing"),
    [
        pytest.param(PAPER, (1.0, 2.0, 0.0), False, False, id="plain"),
        pytest.param(PAPER, (0.9, 1.5, 10.0), True, True, id="all, and another scaling"),
        *(
            # the heading moves the regressors by way of biases and wind
            pytest.param(
                dynamics.model_of(dataclasses.replace(BOAT, steering=steering), name, biased=True),
                scaling,
                True,
                True,
                id=f"all, {name}, biased, {steering}",
            )
            for name in MODELS
            for steering, scaling in (
                ("drives", (1.0, 2.0, 0.0)),
                ("differential", (0.9, 1.5, 10.0)),
            )
        ),
    ],
)
def test_equals_the_full_filter(
    structure: Structure, scaling: tuple[float, float, float], losses: bool, changing: bool
) -> None:
    p = len(structure)
    steps, wind = (500, CALM) if structure is PAPER else (200, WINDY)
    rng = np.random.default_rng(7)
    acts, zs = run_of_boat(steps, 3, structure, wind)
    assert np.min(zs[:, 2]) < 2.0 * math.pi < np.max(zs[:, 2])
    zs[:, 2] = np.mod(zs[:, 2], 2.0 * math.pi)  # As a compass has it: must be wrapped.
    x, P = start(structure)
    full = FullFilter(x, P, scaling, structure, wind)
    weights, work = ukf.scaled_weights(6 + p, *scaling), ukf.workspace(6, p)
    terms, config = np.empty(N_TERMS), augmented.JointConfig(structure.terms, weights)
    Q_s, R = np.diag(STEP_SD**2), np.diag(SENSOR_SD**2)
    q_xi = (1e-3 * structure.sd) ** 2
    mask = np.ones(6, dtype=bool)
    worst = 0.0
    for k in range(steps):
        if losses:
            mask = rng.random(6) > 0.4 if k % 7 else np.zeros(6, dtype=bool)
        if changing:
            Q_s, R = spread_of(rng, STEP_SD), spread_of(rng, SENSOR_SD)
            q_xi = (2e-3 * rng.random(p) * structure.sd) ** 2
        Q = np.zeros((6 + p, 6 + p))
        Q[:6, :6], Q[6:, 6:] = Q_s, np.diag(q_xi)
        full.step(acts[k], zs[k], mask, Q, R)
        z = np.where(mask, zs[k], math.nan)
        state = augmented.JointState(x, P, acts[k], wind)
        scratch = augmented.JointWorkspace(Q_s, q_xi, terms, work)
        repairs = augmented.joint_predict(state, H, config, scratch)
        assert repairs == 0
        nis = ukf.measurement_update(x, P, z, mask, R, 2, math.inf, work)
        if mask.any():
            assert nis == pytest.approx(full.f.mahalanobis**2, rel=1e-6)
        sd = np.sqrt(np.diag(full.f.P))
        worst = max(
            worst,
            np.max(np.abs(x - full.f.x) / sd),
            np.max(np.abs(P - full.f.P) / np.outer(sd, sd)),
        )
    assert worst < 1e-9
    assert np.array_equal(P, P.T)


def test_weights_are_those_of_the_scaled_transform() -> None:
    # Source: filterpy 2.0.0, MerweScaledSigmaPoints.
    spread, mean_0, covariance_0, others = ukf.scaled_weights(6, 0.1, 2.0, -3.0)
    assert spread == pytest.approx(0.03)
    assert mean_0 == pytest.approx(-199.0, rel=1e-9)
    assert covariance_0 == pytest.approx(-196.01, rel=1e-9)
    assert others == pytest.approx(100.0 / 6.0, rel=1e-9)
    with pytest.raises(ValueError, match="must be above 0"):
        ukf.scaled_weights(31, 1.0, 2.0, -31.0)


def test_heading_innovation_is_wrapped() -> None:
    x, P = start()
    x[2] = math.pi - 0.01
    z = np.full(6, math.nan)
    z[2] = -math.pi + 0.01
    variance = P[2, 2]
    assert correct(x, P, z, np.eye(6), angle=2) == pytest.approx(0.02**2 / (variance + 1.0))
    assert x[2] > math.pi - 0.01


def test_gate_refuses_and_leaves_everything_as_it_was() -> None:
    x, P = start()
    before = x.copy(), P.copy()
    z = x[:6] + 100.0
    assert correct(x, P, z, np.eye(6), gate=30.0) > 30.0
    assert np.array_equal(x, before[0]) and np.array_equal(P, before[1])
    correct(x, P, z, np.eye(6))
    assert not np.array_equal(x, before[0])


def test_a_measurement_that_repeats_another_is_left_out() -> None:
    both, one = ((np.zeros(3), 1e-20 * np.eye(3)) for _ in range(2))
    nis = correct(*both, [1.0, 1.0], np.ones((2, 2)))  # The same noise in both.
    assert nis == correct(*one, [1.0, math.nan], np.ones((2, 2))) == pytest.approx(1.0)
    assert np.array_equal(both[0], one[0]) and np.array_equal(both[1], one[1])


def test_measurements_without_noise_are_followed() -> None:
    x, P = start()
    z = x[:6] + np.sqrt(np.diag(P)[:6])
    for _ in range(20):
        correct(x, P, z, np.zeros((6, 6)))
        assert np.isfinite(x).all() and (np.diag(P) > 0.0).all()
    np.testing.assert_allclose(x[:6], z, rtol=1e-7)


@pytest.mark.parametrize("spoil", ["indefinite", "nan", "negative", "infinite", "skew"])
def test_a_spoilt_covariance_is_repaired(spoil: str) -> None:
    x, P = start()
    if spoil == "indefinite":
        P[3, 4] = P[4, 3] = 2.0 * math.sqrt(P[3, 3] * P[4, 4])
    elif spoil == "nan":
        P[2, :] = P[:, 2] = math.nan
    elif spoil == "negative":
        P[5, 5] *= -1.0
    elif spoil == "infinite":
        P[1, 1] = math.inf
    else:
        P[3, 20] = 100.0 * P[3, 3]
        P[0, 1] = P[1, 0] = 1.0001 * math.sqrt(P[0, 0] * P[1, 1])
    weights, work = ukf.scaled_weights(31), ukf.workspace(6, 25)
    assert ukf.sigma_points(x, P, weights, work) > 0
    assert all(np.isfinite(array).all() for array in work)
    assert np.array_equal(P, P.T)
    np.linalg.cholesky(P[:6, :6])
    assert ukf.sigma_points(x, P, weights, work) == 0


def test_a_prediction_that_overflows_is_dropped() -> None:
    x, P = start()
    x[3] = 1e25  # Its square is beyond what the filter allows.
    before_x, before_P = x.copy(), P.copy()
    Q_s, q_xi = np.diag(STEP_SD**2), np.full(25, 1e-6)
    weights, work = ukf.scaled_weights(31), ukf.workspace(6, 25)
    act = np.array([6.33, 6.33, 0.0, 0.0])
    state, config = (
        augmented.JointState(x, P, act, CALM),
        augmented.JointConfig(PAPER.terms, weights),
    )
    scratch = augmented.JointWorkspace(Q_s, q_xi, np.empty(N_TERMS), work)
    assert augmented.joint_predict(state, H, config, scratch) == 1
    assert np.array_equal(x, before_x)
    np.testing.assert_array_equal(np.diag(P - before_P)[:6] > 0.0, True)
