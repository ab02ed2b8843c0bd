"""The structured filter against filterpy's full one, a textbook filter, and abuse."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from twin import model, ukf
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


def start() -> tuple[np.ndarray, np.ndarray]:
    """Return mean and covariance at the start; the covariance is full."""
    xi, sd = model.hand_prior(BOAT)
    x = np.concatenate([[0.0, 0.0, 3.0, 5.0, 0.0, 0.0], xi])
    sd = np.concatenate([START_SD, sd])
    mix = np.eye(31) + 0.1 * np.random.default_rng(1).normal(size=(31, 31))
    P = mix @ mix.T * np.outer(sd, sd)
    return x, (P + P.T) / 2.0


def run_of_boat(steps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return actuators (steps, 4) and noisy states (steps, 6) of a boat in random turns."""
    rng = np.random.default_rng(seed)
    xi = model.hand_prior(BOAT)[0]
    angles = np.repeat(rng.uniform(-0.35, 0.35, steps // 50 + 1), 50)[:steps]
    acts = np.column_stack([np.full((steps, 2), 6.33), angles, angles])
    s, after, phi = np.array([0.0, 0.0, 3.0, 5.0, 0.0, 0.0]), np.empty(6), np.empty(25)
    states = np.empty((steps, 6))
    for k in range(steps):
        model.step(s, xi, acts[k], 0.0, H, phi, after)
        s = after + 0.3 * STEP_SD * rng.normal(size=6)
        states[k] = s + SENSOR_SD * rng.normal(size=6)
    return acts, states


class FullFilter:
    """filterpy's filter with all 63 points on the same model."""

    def __init__(self, x: np.ndarray, P: np.ndarray, alpha: float, beta: float, kappa: float):
        points = MerweScaledSigmaPoints(31, alpha, beta, kappa)
        self.f = UnscentedKalmanFilter(31, 6, H, None, self.move, points)
        self.f.x, self.f.P = x.copy(), P.copy()

    @staticmethod
    def move(x: np.ndarray, dt: float, act: np.ndarray) -> np.ndarray:
        after = x.copy()
        model.step(x[:6].copy(), x[6:].copy(), act, 0.0, dt, np.empty(25), after[:6])
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


@pytest.mark.parametrize(
    ("scaling", "losses", "changing"),
    [
        pytest.param((1.0, 2.0, 0.0), False, False, id="plain"),
        pytest.param((1.0, 2.0, 0.0), True, False, id="missing measurements"),
        pytest.param((1.0, 2.0, 0.0), False, True, id="Q and R change"),
        pytest.param((0.9, 1.5, 10.0), True, True, id="all, and another scaling"),
    ],
)
def test_equals_the_full_filter(
    scaling: tuple[float, float, float], losses: bool, changing: bool
) -> None:
    steps = 1000
    rng = np.random.default_rng(7)
    acts, zs = run_of_boat(steps, 3)
    zs[:, 2] = np.mod(zs[:, 2], 2.0 * math.pi)  # As a compass has it: must be wrapped.
    x, P = start()
    full = FullFilter(x, P, *scaling)
    weights, work = ukf.scaled_weights(31, *scaling), ukf.workspace(6, 25)
    Q_s, R = np.diag(STEP_SD**2), np.diag(SENSOR_SD**2)
    sd_0 = model.hand_prior(BOAT)[1]
    q_xi = (1e-3 * sd_0) ** 2
    mask = np.ones(6, dtype=bool)
    worst = 0.0
    for k in range(steps):
        if losses:
            mask = rng.random(6) > 0.4 if k % 7 else np.zeros(6, dtype=bool)
        if changing:
            Q_s, R = spread_of(rng, STEP_SD), spread_of(rng, SENSOR_SD)
            q_xi = (2e-3 * rng.random(25) * sd_0) ** 2
        Q = np.zeros((31, 31))
        Q[:6, :6], Q[6:, 6:] = Q_s, np.diag(q_xi)
        full.step(acts[k], zs[k], mask, Q, R)
        z = np.where(mask, zs[k], math.nan)
        assert model.joint_predict(x, P, acts[k], 0.0, H, Q_s, q_xi, weights, work) == 0
        ukf.measurement_update(x, P, z, mask, R, 2, math.inf, work)
        sd = np.sqrt(np.diag(full.f.P))
        worst = max(
            worst,
            np.max(np.abs(x - full.f.x) / sd),
            np.max(np.abs(P - full.f.P) / np.outer(sd, sd)),
        )
    assert worst < 1e-9
    assert np.array_equal(P, P.T)
