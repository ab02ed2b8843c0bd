"""The table [autopilot] of vessel files: which servo output commands what."""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path

import pytest

from usv_gym.vessel.vessel import Vessel, VesselError

FOLDER = resources.files("usv_gym.vessel") / "vessels"
USV75, OTTER = ((FOLDER / f"{name}.toml").read_text() for name in ("usv75", "otter"))


def test_a_steered_boat_has_steering_and_throttle() -> None:
    servos = Vessel.load("usv75").servos
    widths = [1700, 0, 1300]
    command = [-12.8, -12.8, math.radians(15.0), math.radians(15.0)]
    assert servos.command(widths) == pytest.approx(command)


@pytest.mark.parametrize("name", ["otter", "wamv16"])
def test_a_pair_of_thrusters_has_two_throttles(name: str) -> None:
    boat = Vessel.load(name)
    full = boat.values["shaft_speed_max"]
    assert boat.servos.command([1900, 1900, 1100]) == pytest.approx([full, -full, 0.0, 0.0])


@pytest.mark.parametrize("name", ["usv75", "otter"])
def test_a_file_without_the_table_has_the_default_outputs(name: str, tmp_path: Path) -> None:
    text = USV75 if name == "usv75" else OTTER
    path = tmp_path / "boat.toml"
    path.write_text(text.partition("[autopilot]")[0])
    assert Vessel.load(path).servos == Vessel.load(name).servos
    assert Vessel.load(path).outputs is None


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("throttle = 3", "throttle = 0", "must be an output from 1 to 16"),
        ("throttle = 3", "", "throttle: is missing"),
        ("throttle = 3", 'throttle = "three"', "number of an output"),
        ("throttle = 3", "throttle = 3\nsails = 2", "sails: unknown key; known: throttle"),
        ("throttle = 3", "throttle = 3\npulse = [1500, 1100, 1900]", "must rise"),
        ("throttle = 3", "throttle = 3\npulse = [1500]", "three widths"),
    ],
)
def test_bad_outputs_are_refused_with_place_and_remedy(
    before: str, after: str, words: str, tmp_path: Path
) -> None:
    path = tmp_path / "boat.toml"
    path.write_text(USV75.replace(before, after))
    with pytest.raises(VesselError, match=rf"\[autopilot\].*{words}"):
        Vessel.load(path)


def test_other_pulse_widths_are_read(tmp_path: Path) -> None:
    path = tmp_path / "boat.toml"
    path.write_text(USV75 + "pulse = [1000, 1500, 2000]\n")
    servos = Vessel.load(path).servos
    assert (servos.low, servos.middle, servos.high) == (1000.0, 1500.0, 2000.0)
