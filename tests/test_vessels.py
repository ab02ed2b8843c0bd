"""Vessels: the contract of every one that ships, and what a bad file is told."""

from __future__ import annotations

import dataclasses
import math
import pickle
import re
from pathlib import Path

import numpy as np
import pytest

import usv_gym
from usv_gym import Vessel, vessel_names
from usv_gym.physics import frames as fr
from usv_gym.physics import parameters as par
from usv_gym.physics import ship, weather
from usv_gym.vessel import KIND_SCHEMA, SCHEMA, UNITS, VesselError

FOLDER = Path(usv_gym.__file__).parent / "vessels"
USV75 = (FOLDER / "usv75.toml").read_text(encoding="utf-8")

NOT_EVERY_VESSEL = {*SCHEMA["hull"], *(key for keys in KIND_SCHEMA.values() for key in keys)}

# ------------------------------------------------- contract of every vessel


def test_there_are_vessels() -> None:
    assert "usv75" in vessel_names()
    assert set(vessel_names()) == {path.stem for path in FOLDER.glob("*.toml")}


@pytest.fixture(params=vessel_names())
def boat(request: pytest.FixtureRequest) -> Vessel:
    return Vessel.load(request.param)


def test_loads_by_name_and_by_path(boat: Vessel) -> None:
    again = Vessel.load(FOLDER / f"{boat.name}.toml")
    assert dict(again.values) == dict(boat.values)
    assert again.title
    assert Vessel.load(boat) is boat


def test_packs_every_number_and_nothing_else(boat: Vessel) -> None:
    packed = boat.packed
    assert packed.shape == (par.PACKED_SIZE,)
    assert packed.dtype == np.float64
    assert np.all(np.isfinite(packed))
    for key in par.SCALARS:
        if key in boat.values:
            assert packed[par.INDEX[key]] == boat.values[key] == getattr(boat, key)
        else:  # of another kind of propulsion, or a term that the hull does not have
            assert key == "kind" or key in NOT_EVERY_VESSEL
    assert par.KINDS[int(packed[par.KIND])] == boat.kind
    count = len(boat.resistance_speed)
    for at, points in (
        (par.RESISTANCE_SPEEDS, boat.resistance_speed),
        (par.RESISTANCE_FORCES, boat.resistance_force),
    ):
        np.testing.assert_array_equal(packed[at : at + count], points)
        assert np.all(packed[at + count : at + par.RESISTANCE_POINTS] == points[-1])
    with pytest.raises(ValueError, match="read-only"):
        packed[0] = 1.0


def test_straight_speed_is_finite_and_rises(boat: Vessel) -> None:
    shafts = np.linspace(0.02, 1.0, 25) * boat.values["shaft_speed_max"]
    speeds = np.array([boat.straight_speed(n) for n in shafts])
    assert np.all(np.isfinite(speeds))
    assert np.all(np.diff(speeds) > 0.0)
    assert speeds[0] > 0.0
    assert boat.straight_speed(0.0) == 0.0


def test_shaft_speeds_are_in_order(boat: Vessel) -> None:
    v = boat.values
    assert 0.0 < v["shaft_speed_manoeuvring"] <= v["shaft_speed_service"] <= v["shaft_speed_max"]


def test_sails_straight_after_a_push(boat: Vessel) -> None:
    n = boat.values["shaft_speed_manoeuvring"]
    state, cmd = np.zeros(fr.STATE_SIZE), np.array([n, n, 0.0, 0.0])
    speed = boat.straight_speed(n)
    state[[fr.U, fr.V, fr.R]] = speed, 0.02 * speed, 0.01
    state[fr.N_LEFT : fr.N_RIGHT + 1] = n
    work, dt = np.zeros((ship.WORK_ROWS, fr.STATE_SIZE)), 0.05
    calm, gusts, still = np.zeros((7, 0)), np.zeros((3, 0)), weather.constant()
    seconds = 60.0 * boat.values["length_waterline"] / speed
    for k in range(int(seconds / dt)):
        ship.step(
            *(state, cmd, boat.packed.copy(), calm, gusts, still),
            *(k * dt, dt, 3, np.zeros((8, 0)), work),
        )
    # 60 lengths on, the push is forgotten
    assert abs(state[fr.V]) < 1e-4 * speed
    assert abs(state[fr.R]) < 1e-5
    assert state[fr.U] == pytest.approx(speed, rel=1e-3)


def test_pickles(boat: Vessel) -> None:
    _ = boat.packed  # the cached vector must not be in the way
    again = pickle.loads(pickle.dumps(boat))
    assert again.guesses == boat.guesses
    assert dict(again.values) == dict(boat.values)
    np.testing.assert_array_equal(again.packed, boat.packed)


def test_cannot_be_changed(boat: Vessel) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        boat.name = "other"  # type: ignore[misc]
    with pytest.raises(TypeError):
        boat.values["mass"] = 1.0  # type: ignore[index]
    with pytest.raises(AttributeError, match="no 'wings'"):
        _ = boat.wings


def test_every_number_has_its_source(boat: Vessel) -> None:
    """Unit and source are checked at loading; an empty source is none."""
    text = (FOLDER / f"{boat.name}.toml").read_text(encoding="utf-8")
    sources = re.findall(r'source = "([^"]*)"', text)
    assert len(sources) == len(boat.values) + (2 if boat.resistance_speed else 0)
    assert all(len(source.strip()) > 3 for source in sources)


# ------------------------------------------------- bad files


def changed(key: str, entry: str) -> str:
    """Return the text of usv75 with the entry of one key replaced."""
    text, count = re.subn(rf"(?m)^{key} = .*$", f"{key} = {entry}".replace("\\", r"\\"), USV75)
    assert count == 1
    return text


def value(number: str, unit: str) -> str:
    return f'{{ value = {number}, unit = "{unit}", source = "test" }}'


def refused(tmp_path: Path, text: str) -> str:
    """Return what loading the text says; it must name the file and be one line."""
    path = tmp_path / "boat.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(VesselError) as caught:
        Vessel.load(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert caught.value.__cause__ is None
    return message


def test_the_text_itself_is_good(tmp_path: Path) -> None:
    path = tmp_path / "boat.toml"
    path.write_text(USV75, encoding="utf-8")
    assert Vessel.load(str(path)).packed.tolist() == Vessel.load("usv75").packed.tolist()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        # each: the place, and the remedy
        (
            changed("beam", value("2.7", "m") + '\nmast = { value = 1, unit = "m" }'),
            ("[particulars] mast", "unknown key", "known:", "draft"),
        ),
        (changed("beam", "2.714"), ("[particulars] beam", "no unit", 'unit = "m"')),
        (
            changed("beam", '{ value = 2.7, source = "x" }'),
            ("[particulars] beam", "unit is missing", 'unit = "m"'),
        ),
        (
            changed("beam", '{ value = 2.7, unit = "m" }'),
            ("[particulars] beam", "source is missing"),
        ),
        (
            changed("beam", '{ unit = "m", source = "x" }'),
            ("[particulars] beam", "value is missing"),
        ),
        (
            changed("beam", '{ value = 2.7, unit = "m", source = "x", note = 1 }'),
            ("[particulars] beam", "note"),
        ),
        (changed("beam", value("2.7", "ft")), ("[particulars] beam", "'ft'", "use m, mm")),
        (
            changed("steer_max", value("30", "kn")),
            ("[propulsion] steer_max", "'kn'", "use rad, deg"),
        ),
        (
            changed("beam", '{ value = 2.7, unit = ["m"], source = "x" }'),
            ("[particulars] beam", "unit", "use m, mm"),
        ),
        (changed("mass", value("-3420", "kg")), ("[particulars] mass", "above 0", "-3420")),
        (changed("mass", value("0", "kg")), ("[particulars] mass", "above 0")),
        (changed("A_R", value("-0.1", "m2")), ("[propulsion] A_R", "0 or more")),
        (changed("mass", value('"heavy"', "kg")), ("[particulars] mass", "number", "heavy")),
        (changed("mass", value("true", "kg")), ("[particulars] mass", "number")),
        (changed("mass", value("[1, 2]", "kg")), ("[particulars] mass", "number")),
        (changed("N_v", value("nan", "1")), ("[hull] N_v", "finite")),
        (changed("N_v", value("inf", "1")), ("[hull] N_v", "finite")),
        (changed("N_v", value("-inf", "1")), ("[hull] N_v", "finite")),
        (changed("N_v", value("1" + "0" * 400, "1")), ("[hull] N_v", "finite")),
        (USV75.replace("J_zz = {", "J_zzz = {"), ("[particulars] J_zzz", "unknown key", "J_zz")),
        (re.sub(r"(?m)^J_zz = .*$", "", USV75), ("[particulars] J_zz", "missing", "kg m2")),
        (USV75 + "\n[sails]\narea = 3\n", ("[sails]", "unknown table", "known:", "hull")),
        (USV75[: USV75.index("[wind]")], ("[wind]", "missing")),
        ("wind = 3\n" + USV75[: USV75.index("[wind]")], ("[wind]",)),
        (USV75.replace('title = "', 'colour = "'), ("[vessel] colour", "name, title")),
        (USV75.replace("[hull]", "[hull"), ("not valid TOML", "line")),
        (changed("mass", value("5000", "kg")), ("[particulars] mass", "5000", "displace", "20 %")),
        (changed("x_P", value("2.6", "m")), ("[propulsion] x_P", "aft")),
    ],
)
def test_a_bad_file_is_told_where_and_what(
    tmp_path: Path, text: str, words: tuple[str, ...]
) -> None:
    message = refused(tmp_path, text)
    for word in words:
        assert word in message


def curve(speed: str, force: str, unit: str = "kN") -> str:
    text = re.sub(r"(?m)^speed = .*$", f"speed = {value(speed, 'kn')}", USV75)
    return re.sub(r"(?m)^force = .*$", f"force = {value(force, unit)}", text)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (curve("[0, 5, 10]", "[0, 1, 2, 3]"), "equally many"),
        (curve("[0, 5]", "[0, 1]"), "3 to 16"),
        (curve(str(list(range(17))), str(list(range(17)))), "3 to 16"),
        (curve("[0, 5, 5]", "[0, 1, 2]"), "rise"),
        (curve("[0, 10, 5]", "[0, 1, 2]"), "rise"),
        (curve("[1, 5, 10]", "[0, 1, 2]"), "start at speed 0"),
        (curve("[0, 5, 10]", "[1, 1, 2]"), "start at speed 0"),
        (curve("[0, 5, 10]", "[0, -1, 2]"), "negative"),
        (curve("[0, 5, 10]", '[0, "x", 2]'), "list of numbers"),
        (curve("[0, 5, 10]", "5"), "list of numbers"),
        (curve("[0, 5, 10]", "[0, 1, 2]", unit="lbf"), "use N, kN"),
        (curve("[0, nan, 10]", "[0, 1, 2]"), "finite"),
        (curve("[0, 5, inf]", "[0, 1, 2]"), "finite"),
        (curve("[0, 5, 10]", "[0, nan, 2]"), "finite"),
        (curve("[0, 5, 10]", "[0, 1, inf]"), "finite"),
        (re.sub(r"(?m)^force = .*$", "", USV75), "speed and force"),
    ],
)
def test_a_bad_resistance_curve_is_told(tmp_path: Path, text: str, word: str) -> None:
    message = refused(tmp_path, text)
    assert "[hull.resistance]" in message
    assert word in message


def test_unknown_names_and_missing_files(tmp_path: Path) -> None:
    with pytest.raises(VesselError, match=r"'bismarck'.*known: .*usv75.*\.toml"):
        Vessel.load("bismarck")
    missing = tmp_path / "none.toml"
    with pytest.raises(VesselError, match=r"none\.toml: cannot be read"):
        Vessel.load(missing)
    folder = tmp_path / "folder.toml"
    folder.mkdir()
    with pytest.raises(VesselError, match=r"folder\.toml: cannot be read"):
        Vessel.load(folder)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(VesselError, match=r"binary\.toml: is not valid TOML"):
        Vessel.load(binary)


def test_an_object_made_by_hand_is_checked_too() -> None:
    boat = Vessel.load("usv75")
    with pytest.raises(VesselError, match=r"\[particulars\] mass.*above 0"):
        dataclasses.replace(boat, values={**boat.values, "mass": -1.0})
    with pytest.raises(VesselError, match="wings"):
        dataclasses.replace(boat, values={**boat.values, "wings": 2.0})
    without = {key: number for key, number in boat.values.items() if key != "beam"}
    with pytest.raises(VesselError, match="beam"):
        dataclasses.replace(boat, values=without)


# ------------------------------------------------- units


@pytest.mark.parametrize(
    ("key", "number", "unit", "si"),
    [
        # by the units' definitions: nautical mile 1852 m, degree pi/180
        ("mass", "3.42", "t", 3420.0),
        ("beam", "2714", "mm", 2.714),
        ("steer_max", "30", "deg", math.pi / 6.0),
        ("steer_max", "0.5", "rad", 0.5),
        ("steer_rate", "20", "deg/s", math.pi / 9.0),
        ("shaft_speed_max", "2400", "rpm", 40.0),
        ("f_alpha", "0.04", "1/deg", 0.04 * 180.0 / math.pi),
    ],
)
def test_units_are_converted(tmp_path: Path, key: str, number: str, unit: str, si: float) -> None:
    path = tmp_path / "boat.toml"
    path.write_text(changed(key, value(number, unit)), encoding="utf-8")
    assert Vessel.load(path).values[key] == pytest.approx(si, rel=1e-15)


def test_knots_and_kilonewtons(tmp_path: Path) -> None:
    path = tmp_path / "boat.toml"
    path.write_text(curve("[0, 10, 36]", "[0, 1.5, 4]"), encoding="utf-8")
    boat = Vessel.load(path)
    np.testing.assert_allclose(boat.resistance_speed, [0, 18520 / 3600, 18.52], rtol=1e-15)
    np.testing.assert_allclose(boat.resistance_force, [0, 1500.0, 4000.0], rtol=1e-15)


def test_every_unit_of_the_schema_is_known_and_si_first() -> None:
    tables = [*SCHEMA.values(), *KIND_SCHEMA.values()]
    used = {unit for keys in tables for unit, _ in keys.values()}
    assert used | {"m/s", "N"} == set(UNITS)
    for unit, factors in UNITS.items():
        assert factors[unit] == 1.0
        assert next(iter(factors)) == unit


def test_guesses_are_known() -> None:
    guesses = Vessel.load("usv75").guesses
    assert "A_R" in guesses
    assert "mass" not in guesses  # Table 1 of the paper
    assert "resistance_force" in guesses
