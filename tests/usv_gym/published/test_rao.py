"""Response amplitudes: limits, linearity, encounter frequency."""

import math

import numpy as np
import pytest

from examples.validation.rao import respond
from usv_gym import Vessel
from usv_gym.physics import GRAVITY
from usv_gym.world.realisation import Sea

BOAT = Vessel.load("usv75")
HEAD, BEAM, FOLLOWING = math.pi, 0.5 * math.pi, 0.0
LONGEST = 0.25
"""Frequency of a wave of 986 m, rad/s."""


def slope(omega: float) -> float:
    return omega**2 / GRAVITY


@pytest.mark.parametrize("name", ["usv75", "kvlcc2_l7", "wamv16", "telemetron"])
def test_a_boat_at_rest_follows_a_very_long_wave(name: str) -> None:
    vessel = Vessel.load(name)
    head, beam = (respond(vessel, LONGEST, heading) for heading in (HEAD, BEAM))
    # dynamic terms: (omega / omega_n)^2, up to 2 %; a long ship's (k L)^2 / 24 is less. Rolling
    # of KVLCC2 is slower (3.4 s): 2 % too
    assert float(head.heave) == pytest.approx(1.0, abs=0.02)
    assert float(head.pitch) / slope(LONGEST) == pytest.approx(1.0, abs=0.02)
    assert float(beam.roll) / slope(LONGEST) == pytest.approx(1.0, abs=0.03)
    assert float(head.roll) < 1e-6
    # the water plane's load acts at its centre, the ship's inertia x_G away: x_G / GM_L
    assert float(beam.pitch) < 0.04 * slope(LONGEST)


@pytest.mark.parametrize("speed", [0.0, 3.0, 5.58])
def test_a_boat_moves_with_the_water_of_a_very_long_wave(speed: float) -> None:
    head, beam = (respond(BOAT, LONGEST, heading, speed=speed) for heading in (HEAD, BEAM))
    # particles of deep water go round in circles of the wave's amplitude; their speed is met
    # at the frequency of encounter
    assert float(head.north * head.encounter) / LONGEST == pytest.approx(1.0, abs=0.06)
    assert float(beam.east) == pytest.approx(1.0, abs=0.05)
    assert float(head.heave) == pytest.approx(1.0, abs=0.05)
    assert float(head.pitch) / slope(LONGEST) == pytest.approx(1.0, abs=0.05)
    assert float(beam.roll) / slope(LONGEST) == pytest.approx(1.0, abs=0.05)


def test_an_oblique_wave_tilts_by_its_slope_components() -> None:
    got = respond(BOAT, LONGEST, math.radians(150.0))
    assert float(got.pitch) / slope(LONGEST) == pytest.approx(math.cos(math.pi / 6), rel=0.02)
    assert float(got.roll) / slope(LONGEST) == pytest.approx(0.5, rel=0.02)


@pytest.mark.parametrize(("heading", "speed"), [(HEAD, 0.0), (HEAD, 5.58), (2.0, 3.0)])
def test_motion_is_linear_in_the_wave(heading: float, speed: float) -> None:
    one, two = (respond(BOAT, 1.777, heading, speed=speed, amplitude=a) for a in (1e-3, 2e-3))
    # what is left is of the order of the wave over the draft
    for a, b in zip(one[1:], two[1:], strict=True):
        assert float(b) == pytest.approx(float(a), rel=5e-3, abs=1e-6)


def test_responses_are_symmetric() -> None:
    port, starboard, astern = (respond(BOAT, 2.0, angle) for angle in (2.3, -2.3, math.pi - 2.3))
    for a, b, c in zip(port, starboard, astern, strict=True):
        assert float(b) == pytest.approx(float(a), rel=1e-6)
        # the water plane is centred, but sway and yaw differ at the bow and the stern
        assert float(c) == pytest.approx(float(a), rel=0.05)


def test_encounter_frequency_follows_speed_and_heading() -> None:
    omega, speed = 1.2, 5.58
    for heading in (HEAD, 2.0, BEAM):
        want = omega - slope(omega) * speed * math.cos(heading)
        # in six degrees of freedom the boat trims, and makes a little less speed
        assert float(respond(BOAT, omega, heading, speed=speed).encounter) == pytest.approx(
            want, rel=5e-3
        )


def test_slow_encounters_have_no_amplitude() -> None:
    # g / U: the boat runs along with the wave
    got = respond(BOAT, GRAVITY / 5.58, FOLLOWING, speed=5.58)
    assert abs(float(got.encounter)) < 1e-9
    assert np.isnan([float(x) for x in got[1:]]).all()


def test_a_regular_sea_has_its_amplitude() -> None:
    sea = Sea.regular(BOAT, 1.5, 0.3, to=0.7, phase=0.2)
    height = sea.elevation(0.0, 0.0, np.linspace(0.0, 2.0 * math.pi / 1.5, 2001))
    assert height.max() == pytest.approx(0.3, rel=1e-5)
