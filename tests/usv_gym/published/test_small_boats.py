"""Speeds, turns and zigzags of the small boats beside separate code with the same equations."""

import math

import numpy as np
import pytest

from examples.validation import trials
from usv_gym import Vessel
from usv_gym.physics import KNOT
from usv_gym.vessel.vessel import course_eigenvalues

BOAT = Vessel.load("usv75")
LENGTH_OVERALL = BOAT.values["length_overall"]


def shaft_speed_at(knots: float) -> float:
    return BOAT.shaft_speed_for(knots * KNOT)


@pytest.mark.parametrize(("n_rps", "knots"), [(20.4, 11.0), (25.6, 20.0), (39.7, 38.0)])
def test_speed_at_a_shaft_speed(n_rps: float, knots: float) -> None:
    assert BOAT.straight_speed(n_rps) / KNOT == pytest.approx(knots, rel=0.015)


@pytest.mark.parametrize(("knots", "expected"), [(8.0, (-0.59, -1.69)), (38.0, (-2.65, -8.0))])
def test_eigenvalues_of_the_course(knots: float, expected: tuple[float, float]) -> None:
    found = course_eigenvalues(BOAT, shaft_speed_at(knots))
    np.testing.assert_allclose(np.real(found), expected, rtol=0.015)


@pytest.mark.parametrize(
    ("knots", "speed_mps", "rate_degps", "radius", "advance", "diameter"),
    [
        (11.0, 4.8, 17.5, 2.1, None, None),
        (20.0, 6.6, 21.0, 2.4, 5.3, 6.2),
        (30.0, 11.8, 24.0, 3.7, None, None),
        (38.0, 15.6, 29.0, 4.1, 7.1, 8.9),
    ],
)
def test_turns_with_20_degrees_of_drive_angle(
    knots: float,
    speed_mps: float,
    rate_degps: float,
    radius: float,
    advance: float | None,
    diameter: float | None,
) -> None:
    """Speed, rate and radius of the steady turn; radius, advance and diameter in lengths."""
    angle = math.radians(20.0)
    track = trials.turning_circle(BOAT, angle, n=shaft_speed_at(knots))
    speed, rate = track.speed[-1], track.r[-1]
    # the references have two figures
    assert speed == pytest.approx(speed_mps, rel=0.03)
    assert math.degrees(rate) == pytest.approx(rate_degps, rel=0.03)
    assert speed / rate / LENGTH_OVERALL == pytest.approx(radius, rel=0.03)
    if advance is not None:
        found = trials.turning_indices(track, LENGTH_OVERALL)
        assert found.advance == pytest.approx(advance, rel=0.03)
        assert found.tactical_diameter == pytest.approx(diameter, rel=0.03)


def test_overshoots_of_a_20_20_zigzag() -> None:
    switch = math.radians(20.0)
    track = trials.zigzag(BOAT, switch, switch, n=shaft_speed_at(11.0))
    found = trials.zigzag_indices(track, switch).overshoots
    # separate code: 12 to 20 degrees, and a degree
    assert math.degrees(min(found)) > 11.0 and math.degrees(max(found)) < 21.0
