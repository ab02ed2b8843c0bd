"""Wind: Blendermann's coefficients and loads, gusts."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.usv_gym.world.seas import realise
from usv_gym import SeaState, Vessel
from usv_gym.physics import frames as fr
from usv_gym.physics import ship, weather, wind

BOAT = Vessel.load("usv75")
P = BOAT.packed.copy()

angles = st.floats(-math.pi, math.pi)


def apparent(gamma_deg: float, speed: float = 10.0) -> np.ndarray:
    """Return the loads of apparent wind off the bow, above 0 from port, on a boat at rest."""
    to = math.radians(gamma_deg) + math.pi  # blowing away from where it comes
    # from port: the air moves to starboard, which is east of a boat heading north
    return np.array(wind.wind_loads(0.0, 0.0, 0.0, speed * math.cos(to), -speed * math.sin(to), P))


@given(gamma=angles)
@settings(max_examples=200, deadline=None)
def test_port_mirrors_starboard(gamma: float) -> None:
    C_X, C_Y, C_N = wind.coefficients(gamma, P)
    mirrored = wind.coefficients(-gamma, P)
    # the same expressions on either side: equal to the bit
    assert mirrored == (C_X, -C_Y, -C_N)


@given(u=st.floats(-20, 20), v=st.floats(-5, 5), psi=angles, speed=st.floats(0, 30), to=angles)
@settings(max_examples=200, deadline=None)
def test_loads_depend_on_the_air_seen_from_the_boat(
    u: float, v: float, psi: float, speed: float, to: float
) -> None:
    """Turning boat and wind together, or adding one velocity to both, changes nothing."""
    north, east = speed * math.cos(to), speed * math.sin(to)
    loads = wind.wind_loads(u, v, psi, north, east, P)
    turned = wind.wind_loads(u, v, 0.0, *fr.to_body(north, east, psi), P)
    # at the seam astern, rounding may choose the other side of the mirror: compare sizes
    scale = 0.5 * 1.224 * ((abs(u) + abs(v) + speed) ** 2) * 9.0 * 7.5
    for a, b in zip(loads, turned, strict=True):
        assert abs(a) == pytest.approx(abs(b), abs=1e-12 * scale + 1e-12)
    ahead, side = fr.to_body(north, east, psi)
    at_rest = wind.wind_loads(0.0, 0.0, 0.0, ahead - u, side - v, P)
    for a, b in zip(loads, at_rest, strict=True):
        assert abs(a) == pytest.approx(abs(b), abs=1e-12 * scale + 1e-12)


@pytest.mark.parametrize("gamma", [0.0, 90.0, -90.0, 180.0])
def test_loads_are_continuous_at_the_branches(gamma: float) -> None:
    eps = 1e-7
    left, at, right = (apparent(gamma + d) for d in (-eps, 0.0, eps))
    # slopes are below 1e3 N(m) per degree
    np.testing.assert_allclose(left, at, atol=2e3 * eps)
    np.testing.assert_allclose(right, at, atol=2e3 * eps)


def test_load_is_quadratic_in_speed() -> None:
    np.testing.assert_allclose(apparent(50.0, 12.0), 9.0 * apparent(50.0, 4.0), rtol=1e-12)


# ---------------------------------------------------------------- zero wind


def test_wind_load_vanishes_with_the_wind() -> None:
    """The ship feels wind less still air, so that a breath of wind makes no jump."""
    state = np.zeros(fr.STATE_SIZE)
    state[[fr.U, fr.V]] = 10.0, 0.5
    cmd, sea = np.zeros(4), ship.calm_sea()
    calm, breath = np.zeros(fr.STATE_SIZE), np.zeros(fr.STATE_SIZE)
    for speed, out in ((0.0, calm), (1e-8, breath)):
        air = ship.Air(speed, speed, 1.0)
        ship.derivative(state, cmd, ship.Ship(P, 3), sea, air, 0.0, out)
    # 1e-8 m/s on 10 m/s: loads of 5e-7 N on 3.4 t
    np.testing.assert_allclose(breath, calm, atol=1e-8)
    assert np.any(breath != calm)


# ---------------------------------------------------------------- gusts


@given(t=st.floats(0.0, 4000.0))
@settings(max_examples=50, deadline=None)
def test_gust_is_the_plain_sum(t: float) -> None:
    gusts = realise(SeaState(wind=8.0), 1).gusts
    # rounding of phases up to 1e4 rad
    assert wind.gust(t, gusts) == pytest.approx(
        np.sum(gusts[2] * np.cos(gusts[0] * t + gusts[1])), abs=1e-10
    )


def test_a_gust_cannot_turn_the_wind_round() -> None:
    lull = np.array([[0.1], [math.pi], [5.0]])  # minus 5 m/s at t = 0
    assert weather.air_velocity(0.0, lull, weather.constant(wind=1.0)) == (0.0, 0.0)
