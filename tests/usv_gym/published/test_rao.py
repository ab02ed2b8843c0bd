"""Response amplitudes: limits, linearity, encounter frequency."""

import math

import numpy as np
import pytest

from examples.validation.rao import respond
from usv_gym import Vessel
from usv_gym.physics import GRAVITY

BOAT = Vessel.load("usv75")
HEAD, BEAM, FOLLOWING = math.pi, 0.5 * math.pi, 0.0
LONGEST = 0.25
"""Frequency of a wave of 986 m, rad/s."""


def slope(omega: float) -> float:
    return omega**2 / GRAVITY


@pytest.mark.parametrize("name", ["usv75", "kvlcc2_l7", "wamv16", "telemetron"])
def test_a_boat_at_rest_follows_a_very_long_wave(name: str) -> None:
    vessel = Vessel.load(name)
    head, beam = (respond(vessel, LONGEST, angle, amplitude=2e-3) for angle in (HEAD, BEAM))
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
