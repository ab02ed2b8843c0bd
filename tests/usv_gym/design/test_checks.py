"""Inspection of vessels: derived particulars and broken rules."""

import dataclasses
import math

import pytest

from usv_gym import Vessel, vessel_names
from usv_gym.design.checks import inspect


@pytest.mark.parametrize("name", vessel_names())
def test_shipped_vessels_have_no_error(name: str) -> None:
    assert inspect(Vessel.load(name)).errors == []


def facts(name: str) -> dict[str, float]:
    return inspect(Vessel.load(name)).facts


def test_speeds_and_thrusts_are_the_published_ones() -> None:
    # by its published damping 13.1 kN make 9.667 m/s
    telemetron = facts("telemetron")
    assert telemetron["thrust, max N"] == pytest.approx(13100.0, rel=1e-5)
    assert telemetron["speed, max m/s"] == pytest.approx(9.667, abs=1e-3)
    # the published largest side force, 4 m aft
    helm = Vessel.load("telemetron").helm_max
    assert 13100.0 * math.sin(helm) == pytest.approx(645.0, rel=1e-4)
    # MSS: 24.4 kgf at most drive it at 6 kn of 0.5144 m/s
    otter = facts("otter")
    assert otter["speed, max m/s"] == pytest.approx(6 * 0.5144, rel=1e-3)
    assert otter["thrust, max N"] == pytest.approx(24.4 * 9.81, rel=1e-3)
    # VRX: 250 N ahead and 100 N astern each; 500 = 51.3 u + 72.4 u^2
    wamv = facts("wamv16")
    assert wamv["bollard pull N"] == pytest.approx(500.0, rel=1e-4)
    assert wamv["bollard pull astern N"] == pytest.approx(200.0, rel=1e-4)
    assert wamv["speed, max m/s"] == pytest.approx(2.2974, rel=1e-3)


def findings(**changes: float) -> str:
    """Return the findings for usv75 with changed values."""
    boat = Vessel.load("usv75")
    found = inspect(dataclasses.replace(boat, values={**boat.values, **changes}))
    return "\n".join(f"{finding.error} {finding.text}" for finding in found.findings)


def test_usv75_has_no_findings() -> None:
    assert findings() == ""


@pytest.mark.parametrize(
    ("changes", "error", "word"),
    [
        ({"mass": 4000.0}, False, "displacement"),
        ({"I_zz": 60000.0}, False, "gyradius in yaw"),
        ({"I_xx": 20000.0}, False, "gyradius in roll"),
        ({"GM_T": 0.02}, False, "GM_T over beam"),
        ({"GM_T": 0.4}, False, "GM_T over KB"),
        ({"m_z": 100.0}, False, "heave"),
        ({"A_wp": 18.0}, True, "A_wp"),
        ({"A_wp": 5.0}, True, "widen downwards"),
        ({"x_G": 1.5}, False, "x_G over the length"),
        ({"KG": 3.0}, False, "KG over draft"),
        ({"length_overall": 6.0}, True, "length_overall"),
        ({"shaft_speed_service": 41.0}, True, "must not fall"),
        ({"k_0": 6.0, "k_1": -0.1}, True, "Froude number"),
        ({"k_0": 0.6, "k_1": 5.0, "k_2": 2.0}, True, "balance the resistance"),
        ({"N_v": -0.4}, False, "drift doubles"),
        ({"A_R": 0.0, "steer_max": 1e-5}, True, "full helm"),
        ({"zeta_roll": 1.5}, False, "overdamped"),
        ({"shaft_lag": 0.01}, True, "dt_physics = 0.025"),
        ({"GM_T": 0.15, "KG": 2.0, "z_P": 2.0}, True, "capsizes"),
    ],
)
def test_a_broken_rule_is_reported(changes: dict[str, float], error: bool, word: str) -> None:
    lines = [line for line in findings(**changes).splitlines() if line.startswith(str(error))]
    assert any(word in line for line in lines), lines


def test_a_turn_to_the_wrong_side_is_an_error() -> None:
    boat = Vessel.load("kvlcc2_l7")
    values = {**boat.values, "x_R_prime": 0.5, "x_H_prime": 0.464}
    texts = [finding.text for finding in inspect(dataclasses.replace(boat, values=values)).errors]
    assert any("to port" in text for text in texts), texts


def test_natural_periods_of_usv75_are_those_of_its_table() -> None:
    # capytaine's, of a study outside this project; its hull lay deeper by the stern
    found = facts("usv75")
    assert found["period of heave s"] == pytest.approx(1.91, abs=0.04)
    assert found["period of pitch s"] == pytest.approx(1.91, abs=0.15)
    assert found["period of roll s"] == pytest.approx(2.11, abs=0.1)
