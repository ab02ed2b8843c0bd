"""Particulars survive their own file, and every mistake in one is named with its remedy."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twin.particulars import STEERING, Deck, Instruments, Particulars, ParticularsError

BOAT = Particulars(
    name="boat", length=7.5, beam=2.5, draft=0.4, mass=2300.0, speed=5.0, shaft_speed=17.0
)
TEXT = """
[particulars]
name = "boat"
steering = "drives"
length = 7.5
beam = 2.5
draft = 0.4
mass = 2300
speed = 5.0
shaft_speed = 17.0
"""
POSITIVE = ("length", "beam", "draft", "mass", "speed", "shaft_speed", "shaft_lag", "steer_lag",
            "steer_rate")  # fmt: skip


def refused(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ParticularsError) as caught:
        Particulars.load(path)
    assert str(caught.value).startswith(f"{path}: ")
    return str(caught.value)


def test_load_fills_in_what_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "boat.toml"
    path.write_text(TEXT)
    assert Particulars.load(path) == BOAT
    assert Particulars.load(str(path)).instruments == Instruments()
    path.write_text(TEXT + "[instruments]\ngps_sd = 2\n")
    assert Particulars.load(path) == dataclasses.replace(BOAT, instruments=Instruments(gps_sd=2.0))


MAY_BE_ZERO = (
    *("gps_bias_sd", "compass_bias_sd", "gyro_bias_sd", "gps_latency", "tilt_sd"),
    *("height_bias_sd", "compass_latency", "ahrs_latency"),
)
ARMS = ("gps_arm", "imu_arm")
TRIPLES = (*ARMS, "imu_mounting")
ANGLES = ("compass_sd", "compass_bias_sd", "ahrs_sd", "tilt_sd")


def changed(record: Any, rng: np.random.Generator) -> Any:
    """Return a record whose numbers, but zeros, are up to a fifth smaller, to the last bit."""
    values = {}
    for item in dataclasses.fields(record):
        value = getattr(record, item.name)
        if isinstance(value, float):
            values[item.name] = value * float(rng.uniform(0.8, 1.0))
        elif isinstance(value, tuple):
            values[item.name] = tuple(rng.uniform(-3.0, 3.0, 3).tolist())
    return dataclasses.replace(record, **values)


ODD_NAMES = ("", "a 'boat'", 'a "boat"', "back\\slash", "#1 = [x]", "b\u00e5t \u8239", " ")


@pytest.mark.parametrize("name", ODD_NAMES)
@pytest.mark.parametrize("steering", STEERING)
def test_round_trip_gives_equal_particulars(tmp_path: Path, name: str, steering: str) -> None:
    rng, path = np.random.default_rng(len(name)), tmp_path / "boat.toml"
    late = Instruments(compass_latency=0.3, ahrs_latency=1e-300, tilt_sd=0.02)
    for deck in (Deck(), Deck(point=(0.0, 0.0, 0.0))):
        boat = dataclasses.replace(BOAT, name=name, steering=steering)
        given = {"instruments": changed(late, rng), "deck": changed(deck, rng)}
        boat = dataclasses.replace(changed(boat, rng), **given)
        path.write_text(boat.to_toml(), encoding="utf-8")
        assert Particulars.load(path) == boat
    if steering == "drives":
        boat = dataclasses.replace(boat, design="usv75")
        path.write_text(boat.to_toml(), encoding="utf-8")
        assert Particulars.load(path) == boat


@pytest.mark.parametrize("name", POSITIVE)
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_impossible_values_of_a_boat_are_refused(name: str, value: float) -> None:
    words = "must be above 0" if math.isfinite(value) else "is not a finite number"
    change: dict[str, Any] = {name: value}
    with pytest.raises(ParticularsError, match=f"^{name} = {value} {words}"):
        dataclasses.replace(BOAT, **change)


def test_a_class_that_the_other_particulars_contradict_is_refused():
    for change in ({"steering": "differential"}, {"speed": 1.0, "mass": 1025.0 * 8.0}):
        odd = {"length": 10.0, "beam": 1.0, "draft": 1.0, **change}
        other = dataclasses.replace(BOAT, **odd)
        with pytest.raises(ParticularsError, match="design = 'usv75' is a class of boats with"):
            dataclasses.replace(other, design="usv75")
    with pytest.raises(ParticularsError, match="design = None"):
        dataclasses.replace(BOAT, design=None)


@pytest.mark.parametrize(
    ("name", "most"), [("gps_latency", 10), ("ahrs_latency", 10), ("wind_height", 1000)]
)
def test_too_large_values_of_an_instrument_are_refused(name: str, most: float) -> None:
    with pytest.raises(ParticularsError, match=rf"^{name} = 1500\.0 must be {most} "):
        Instruments(**{name: 1500.0})


def test_an_arm_may_leave_out_how_far_down_it_is() -> None:
    assert Instruments(gps_arm=(1.0, 2.0)).gps_arm == (1.0, 2.0, 0.0)


def test_a_deck_point_lies_forward_if_nothing_is_said() -> None:
    assert Deck().point_of(5.0) == (2.0, 0.0, 0.0)
    assert Deck(point=(1.0, 0.5)).point_of(5.0) == (1.0, 0.5, 0.0)
    with pytest.raises(ParticularsError, match="max_tilt = 0"):
        Deck(max_tilt=0.0)
    with pytest.raises(ParticularsError, match=r"point = .* must be three finite numbers"):
        Deck(point=(1.0, math.nan, 0.0))


@pytest.mark.parametrize("name", TRIPLES)
@pytest.mark.parametrize(
    "value", [(1.0,), (1.0, 2.0, 3.0, 4.0), 1.0, (1.0, math.nan), (True, 0.0), "ab"]
)
def test_impossible_arms_are_refused(name: str, value: Any) -> None:
    with pytest.raises(ParticularsError, match=f"^{name} = .* must be three finite numbers"):
        Instruments(**{name: value})


def test_angles_in_degrees_are_refused_with_the_same_in_rad() -> None:
    with pytest.raises(
        ParticularsError, match=r"imu_mounting = \[30, 0, 0\] must be rad.*\[0.5236"
    ):
        Instruments(imu_mounting=[30, 0, 0])
    assert Instruments(imu_mounting=(math.pi, 0.0, -math.pi)).imu_mounting[0] == math.pi
    with pytest.raises(ParticularsError, match=r"max_tilt = 3 must be 1\.571 rad.*write 0\.05236"):
        Deck(max_tilt=3)


@pytest.mark.parametrize("name", ANGLES)
def test_a_file_with_an_error_in_degrees_is_refused(tmp_path: Path, name: str) -> None:
    text = TEXT + f"[instruments]\n{name} = 2\n"
    words = f"{name} = 2 must be 1 rad or less; if it is in degrees, write 0.03491"
    assert words in refused(tmp_path / "boat.toml", text)


@pytest.mark.parametrize("name", ARMS)
def test_sensors_off_the_boat_are_refused(name: str) -> None:
    on_board = Instruments(**{name: (0.0, 0.0, -16.0)})
    with pytest.raises(ParticularsError, match=rf"{name} = .* is not on a boat of 7\.5 m; state"):
        dataclasses.replace(BOAT, instruments=on_board)
    with pytest.raises(ParticularsError, match=r"point = .* is not on a boat of 7\.5 m"):
        dataclasses.replace(BOAT, deck=Deck(point=(-150.0, 0.0)))
    long = dataclasses.replace(BOAT, length=300.0, mass=1e5)
    assert dataclasses.replace(long, instruments=on_board).instruments == on_board


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"mass": 2.3}, "mass = 2.3 kg contradict each other"),
        ({"mass": 2.3e6}, "weighs 1.5e"),
        ({"draft": 40.0}, "draft = 40 m"),
        ({"beam": 25.0}, "beam = 25 m"),
        ({"length": 750.0}, "length = 750 m"),
    ],
)
def test_sizes_that_contradict_each_other_are_refused(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(ParticularsError, match=words):
        dataclasses.replace(BOAT, **wrong)


@pytest.mark.parametrize(
    "name", [item.name for item in dataclasses.fields(Instruments) if item.name not in TRIPLES]
)
def test_impossible_values_of_an_instrument_are_refused(name: str) -> None:
    with pytest.raises(ParticularsError, match=f"^{name} = -1.0 must be"):
        Instruments(**{name: -1.0})
    with pytest.raises(ParticularsError, match=f"^{name} = nan is not a finite number"):
        Instruments(**{name: math.nan})
    if name in MAY_BE_ZERO:
        assert getattr(Instruments(**{name: 0.0}), name) == 0.0
    else:
        with pytest.raises(ParticularsError, match=f"^{name} = 0.0 must be above 0"):
            Instruments(**{name: 0.0})


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("mass = 2300", "mass = -1", "mass = -1 must be above 0"),
        ("mass = 2300", "mass = '2300 kg'", "mass = '2300 kg' must be a number"),
        ("mass = 2300", "mass = [1]", "mass = [1] must be a number"),
        ("mass = 2300", "mass = true", "mass = True must be a number"),
        ('name = "boat"', "name = 5", "name = 5 must be a text"),
        ("mass = 2300", "mas = 2300", "unknown key 'mas'; known keys: name, length, beam"),
        ("mass = 2300\n", "", "missing key(s): mass"),
        ('"drives"', '"oars"', "steering = 'oars' is unknown; use one"),
        ('steering = "drives"\n', "", "steering is missing: how does the boat steer?"),
        ("speed = 5.0", "speed = 5.0\ndesign = 75", "design = 75 must be a text"),
        ("speed = 5.0", "speed = 5.0\ndesign = 'otter'", "'otter': no prior of this class comes"),
        ("[particulars]", "[boat]", "expected the tables [particulars]"),
        ("[particulars]", "[extra]\n[particulars]", "found extra, particulars"),
        ("mass = 2300", "mass = 2300\nmass = 1", "is not valid TOML"),
        ("mass = 2300", "mass = 2300\n[instruments]\nradar = 1", "unknown key 'radar'; known keys"),
        ("shaft_speed = 17.0", "shaft_speed = 17.0\n[instruments]\ngps_sd = 0", "gps_sd = 0 must"),
    ],
)
def test_mistakes_in_a_file_are_named(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert TEXT.count(old) >= 1
    assert words in refused(tmp_path / "boat.toml", TEXT.replace(old, new, 1))


def test_files_without_particulars_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "boat.toml"
    assert "found none" in refused(path, "")
    assert "expected a table of keys and values" in refused(path, "particulars = 3")
    with pytest.raises(ParticularsError, match="cannot be read"):
        Particulars.load(tmp_path / "absent.toml")


def test_file_of_several_ships_is_matched_by_log(tmp_path):
    boats = [
        dataclasses.replace(BOAT, name=name, length=length)
        for name, length in (("a", 3.0), ("b", 7.0))
    ]
    text = ""
    for boat, patterns in zip(boats, ('["first/*"]', '["second/x*", "third.csv"]'), strict=True):
        body = boat.to_toml().replace("[particulars]", "[ship.particulars]")
        text += (
            f"[[ship]]\nlogs = {patterns}\n{body.replace('[instruments]', '[ship.instruments]')}\n"
        )
    path = tmp_path / "ships.toml"
    path.write_text(text)
    for log, boat in (("first/run.csv", 0), ("/data/second/xy.csv.gz", 1), ("third.csv", 1)):
        assert Particulars.load(path, log=log) == boats[boat]
    with pytest.raises(ParticularsError, match=r"ships.toml: no ship has the log second/run.csv"):
        Particulars.load(path, log="second/run.csv")
    with pytest.raises(ParticularsError, match="several ships, and no log says which"):
        Particulars.load(path)
    for wrong in (text.replace("logs", "log", 1), "a = 1\n" + text, "ship = 3\n"):
        path.write_text(wrong)
        with pytest.raises(ParticularsError, match=r"expected only \[\[ship\]\]"):
            Particulars.load(path, log="first/run.csv")


def test_catamarans_are_checked_and_survive_their_file(tmp_path):
    cat = dataclasses.replace(
        BOAT, steering="differential", hulls=2, hull_beam=0.5, spacing=1.9, mass=1500.0
    )
    path = tmp_path / "cat.toml"
    path.write_text(cat.to_toml(), encoding="utf-8")
    assert Particulars.load(path) == cat
    assert "hulls" not in BOAT.to_toml()
    for change, words in (
        ({"hulls": 3}, "hulls = 3 must be 1, or 2"),
        ({"hulls": 1}, "add hulls = 2"),
        ({"spacing": 2.3}, "within the beam of 2.5"),
        ({"spacing": 0.4}, "must not overlap"),
        ({"spacing": 0.6}, "hulls are 1.1 m wide together, and the beam over both is 2.5"),
        ({"hull_beam": -0.5}, "hull_beam = -0.5 must be 0 or more"),
        ({"mass": 4000.0}, "mass = 4000 kg is more than two hulls"),
    ):
        with pytest.raises(ParticularsError, match=words):
            dataclasses.replace(cat, **change)
