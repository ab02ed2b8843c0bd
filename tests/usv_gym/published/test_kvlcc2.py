"""Turning circles and zigzags of the tanker KVLCC2 beside separate code and two towing tanks.

Parameters: Yasukawa and Yoshimura 2015. Indices to starboard and to port: advance and tactical
diameter in ship lengths, rate r L / U, overshoots in degrees.
"""

import math

import numpy as np
import pytest

from examples.validation import trials
from examples.validation.trials import StandardTrials
from usv_gym import Vessel
from usv_gym.physics import KNOT

# Results of separate code with the same equations and parameters, a shaft speed (rev/s) each.
# Overshoots within 0.3 degrees were required in advance; 1 and 2 % cover the printed figures.
COMPUTED = {
    ("kvlcc2_l7", 10.4): {
        "advance": (3.25, 3.26),
        "tactical_diameter": (3.23, 3.22),
        "rate": (0.854, 0.877),
        "speed_ratio": 0.34,
        "zigzag_10": ((5.2, 14.4), (7.5, 9.2)),
        "zigzag_20": ((10.8, 15.9), (14.3, 11.6)),
    },
    ("kvlcc2_l7", 11.85): {
        "advance": (3.08, 3.09),
        "tactical_diameter": (3.12, 3.11),
        "rate": (0.858, 0.882),
        "speed_ratio": 0.385,
        "zigzag_10": ((5.0, 13.7), (7.1, 8.9)),
        "zigzag_20": ((10.5, 15.7), (13.7, 11.7)),
    },
    ("kvlcc2", 1.53): {
        "advance": (3.15, 3.19),
        "tactical_diameter": (3.13, 3.14),
        "rate": (0.883, 0.901),
        "speed_ratio": 0.33,
        "zigzag_10": ((5.2, 14.0), (7.5, 8.9)),
        "zigzag_20": ((10.7, 15.5), (14.3, 11.4)),
    },
    ("kvlcc2", 1.778): {
        "advance": (2.98, 3.00),
        "tactical_diameter": (3.00, 3.01),
        "rate": (0.887, 0.906),
        "speed_ratio": 0.38,
        "zigzag_10": ((5.0, 13.2), (7.0, 8.6)),
        "zigzag_20": ((10.5, 15.4), (13.7, 11.5)),
    },
}

APPROACH_SPEED_MPS = {"kvlcc2_l7": 1.179, "kvlcc2": 15.5 * KNOT}


@pytest.fixture(scope="module", params=COMPUTED, ids=lambda case: f"{case[0]}-{case[1]:g}rps")
def case(request: pytest.FixtureRequest) -> tuple[StandardTrials, dict]:
    name, n = request.param
    speed = APPROACH_SPEED_MPS[name]
    return trials.standard_trials(Vessel.load(name), n, speed=speed), COMPUTED[name, n]


def test_turning_circles_are_those_of_separate_code(case: tuple[StandardTrials, dict]) -> None:
    found, computed = case
    for index in ("advance", "tactical_diameter", "rate"):
        for turn, expected in zip(found.turning, computed[index], strict=True):
            assert getattr(turn, index) == pytest.approx(expected, rel=0.01), (index, turn.side)
    assert found.turning[0].speed_ratio == pytest.approx(computed["speed_ratio"], rel=0.02)


def test_zigzags_are_those_of_separate_code(case: tuple[StandardTrials, dict]) -> None:
    found, computed = case
    for trial in ("zigzag_10", "zigzag_20"):
        for run, overshoots in zip(getattr(found, trial), computed[trial], strict=True):
            got = np.degrees(run.overshoots[:2])
            np.testing.assert_allclose(got, overshoots, atol=0.3, err_msg=f"{trial} {run.side}")


def test_the_model_turns_as_in_the_towing_tank() -> None:
    """MARIN free-running tests, SIMMAN 2008: 5 % to starboard, 6 % to port required in advance."""
    model = Vessel.load("kvlcc2_l7")
    circles = [
        trials.turning_circle(model, math.radians(angle), n=10.4, speed=1.179)
        for angle in (35.0, -35.0)
    ]
    starboard, port = (trials.turning_indices(track, 7.0) for track in circles)
    assert starboard.advance == pytest.approx(3.25, rel=0.05)
    assert starboard.tactical_diameter == pytest.approx(3.34, rel=0.05)
    assert port.advance == pytest.approx(3.12, rel=0.06)
    assert port.tactical_diameter == pytest.approx(3.07, rel=0.06)


def test_the_model_is_propelled_at_the_shaft_speed_of_separate_code() -> None:
    assert Vessel.load("kvlcc2_l7").shaft_speed_for(1.179) == pytest.approx(11.85, rel=0.005)
