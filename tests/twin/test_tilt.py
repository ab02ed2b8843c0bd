"""Velocities and rates of a heeled boat, against rotation matrices of SciPy."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin.tilt import body_velocity, body_yaw_rate

RNG = np.random.default_rng(5)
TILT = RNG.uniform(-1.2, 1.2, (20, 2))


def test_velocities_turn_by_pitch_and_then_roll() -> None:
    upright = RNG.normal(size=(20, 3))
    turns = Rotation.from_euler("ZYX", np.column_stack([np.zeros(20), TILT[:, 1], TILT[:, 0]]))
    assert np.allclose(body_velocity(upright, TILT), turns.inv().apply(upright), atol=1e-12)


def test_the_yaw_rate_is_that_which_turns_the_heading() -> None:
    turn, pitch_rate, step = 0.3, -0.2, 1e-6
    found = body_yaw_rate(np.full(20, turn), TILT, np.full(20, pitch_rate))
    for (roll, pitch), rate in zip(TILT, found, strict=True):
        before = Rotation.from_euler("ZYX", [0.5, pitch, roll])
        after = before * Rotation.from_rotvec(step * np.array([0.1, pitch_rate, rate]))
        assert (after.as_euler("ZYX")[0] - 0.5) / step == pytest.approx(turn, abs=1e-5)


def test_a_boat_on_its_side_has_a_finite_yaw_rate() -> None:
    assert body_yaw_rate(0.3, (0.5 * math.pi, 0.1), 2.0) == 0.3
