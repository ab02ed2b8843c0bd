"""Parameters of an autopilot from a vessel's own trials."""

import math

import numpy as np
import pytest

from usv_gym.physics import frames as fr
from usv_gym.sitl.parameters import autopilot_parameters, handling, parameter_text
from usv_gym.vessel.vessel import Vessel, VesselError, vessel_names
from usv_gym.world.sea import SeaState
from usv_gym.world.simulation import Simulation


@pytest.mark.parametrize("name", ["usv75", "otter"])
def test_cruise_throttle_keeps_the_cruise_speed(name: str) -> None:
    boat = Vessel.load(name)
    p = autopilot_parameters(boat)
    assert p["CRUISE_SPEED"] == {"usv75": 3.0, "otter": 1.5}[name]
    sim = Simulation(1, boat, SeaState())
    sim.reset([0], [np.random.default_rng(0)], speed=p["CRUISE_SPEED"])
    pulse = round(1500 + 4.0 * p["CRUISE_THROTTLE"])
    command = np.array([boat.servos.command([pulse if name == "otter" else 1500, 0, pulse])])
    for _ in range(600):
        sim.step(command)
    assert sim.state[0, fr.U] == pytest.approx(p["CRUISE_SPEED"], rel=0.03)


def test_rates_are_those_of_the_turning_trial() -> None:
    """The prototype of this interface measured 5.5 and 10.4 degrees a second at 15 and 30."""
    boat = handling(Vessel.load("usv75"))
    assert math.degrees(boat.rate) == pytest.approx(5.5, abs=0.3)
    assert math.degrees(boat.rate_max) == pytest.approx(10.4, abs=0.5)
    assert 1.0 < boat.turn_time < 2.5
    assert boat.radius == pytest.approx(13.0, abs=1.0)


@pytest.mark.parametrize("name", vessel_names())
def test_every_vessel_gets_sound_parameters(name: str) -> None:
    boat = Vessel.load(name)
    given = autopilot_parameters(boat, external=True)
    assert all(math.isfinite(value) for value in given.values())
    for key in ("CRUISE_THROTTLE", "ATC_STR_RAT_FF", "ATC_STR_RAT_P", "TURN_RADIUS", "VISO_TYPE"):
        assert given[key] > 0
    functions = {k: v for k, v in given.items() if k.endswith("_FUNCTION")}
    skid = boat.kind == "thruster_pair"
    assert set(functions.values()) == ({73.0, 74.0} if skid else {26.0, 70.0})
    lines = parameter_text(boat, given).splitlines()
    assert lines[0].startswith("#")
    assert dict(line.split() for line in lines[1:]).keys() == given.keys()


def test_a_speed_beyond_the_full_throttle_is_refused() -> None:
    with pytest.raises(VesselError, match="cruising speed = 50"):
        autopilot_parameters(Vessel.load("otter"), 50.0)
