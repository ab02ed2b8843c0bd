"""Vessels: the properties of every shipped one, random boats, and bad files.

``tests/usv_gym/physics/golden/<vessel>_6dof.json`` holds trajectories in six degrees of freedom,
``usv75_zigzag.json`` that of the boat of ``USVTwin-v0`` in three. A change that moves them needs a
reason in the change log, that of a registered id a new id or a fix; then write them again with::

    PYTHONPATH=. python tests/usv_gym/vessel/test_vessel.py
"""

import dataclasses
import json
import math
import pickle
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import usv_gym
from usv_gym import SeaState, SensorSuite, Vessel, vessel_names
from usv_gym.manoeuvring.manoeuvres import commands
from usv_gym.physics import frames as fr
from usv_gym.physics import parameters as par
from usv_gym.physics import ship
from usv_gym.vessel import vessel_file
from usv_gym.vessel.schema import KIND_SCHEMA, SCHEMA
from usv_gym.vessel.variation import LAW
from usv_gym.vessel.vessel import BoatClass, VesselError, course_eigenvalues
from usv_gym.world.simulation import Simulation

FOLDER = Path(usv_gym.__file__).parent / "vessel" / "vessels"
USV75 = (FOLDER / "usv75.toml").read_text(encoding="utf-8")

NOT_EVERY_VESSEL = {*SCHEMA["hull"], *(key for keys in KIND_SCHEMA.values() for key in keys)}

# ------------------------------------------------- every shipped vessel


def test_vessel_names_are_those_of_the_folder() -> None:
    assert "usv75" in vessel_names()
    assert set(vessel_names()) == {path.stem for path in FOLDER.glob("*.toml")}


@pytest.fixture(params=vessel_names())
def boat(request: pytest.FixtureRequest) -> Vessel:
    return Vessel.load(request.param)


def test_packed_holds_every_number_of_the_vessel(boat: Vessel) -> None:
    packed = boat.packed
    assert packed.dtype == par.PARAMETERS
    for key in par.SCALARS:
        if key in boat.values:
            assert packed[key] == boat.values[key] == getattr(boat, key)
        else:  # of another kind of propulsion, or a term that the hull does not have
            assert key == "kind" or key in NOT_EVERY_VESSEL
    assert par.KINDS[int(packed["kind"])] == boat.kind
    count = len(boat.resistance_speed)
    for name in ("resistance_speed", "resistance_force"):
        points, values = getattr(boat, name), packed[name]
        np.testing.assert_array_equal(values[:count], points)
        assert np.all(values[count:] == (points or [0.0])[-1])


def test_straight_speed_rises_with_shaft_speed(boat: Vessel) -> None:
    shafts = np.linspace(0.02, 1.0, 25) * boat.values["shaft_speed_max"]
    speeds = np.array([boat.straight_speed(n) for n in shafts])
    assert np.all(np.isfinite(speeds))
    assert np.all(np.diff(speeds) > 0.0)
    assert speeds[0] > 0.0
    assert boat.straight_speed(0.0) == 0.0


def test_shaft_speed_for_inverts_straight_speed(boat: Vessel) -> None:
    top = boat.straight_speed(boat.values["shaft_speed_max"])
    for speed in (0.0, 0.1 * top, 0.5 * top, top):
        # to 1e-10 rev/s
        found = boat.straight_speed(boat.shaft_speed_for(speed))
        assert found == pytest.approx(speed, abs=1e-8)


def run(boat: Vessel, state: np.ndarray, cmd: np.ndarray, seconds: float, dof: int) -> np.ndarray:
    """Return the states of a run in calm water."""
    work, dt = np.zeros((ship.WORK_ROWS, fr.STATE_SIZE)), 0.05
    steps = int(seconds / dt)
    states = np.empty((steps + 1, fr.STATE_SIZE))
    states[0] = state
    cmds = np.tile(cmd, (steps, 1))
    ship.sail(states, cmds, ship.Ship(boat.packed, dof), ship.calm_sea(), dt, work)
    return states


def underway(boat: Vessel) -> tuple[np.ndarray, np.ndarray, float]:
    """Return state, command and speed of a boat at its manoeuvring shaft speed."""
    n = boat.values["shaft_speed_manoeuvring"]
    state, cmd = np.zeros(fr.STATE_SIZE), boat.command(n, 0.0)
    speed = boat.straight_speed(n)
    state[fr.U], state[fr.N_LEFT :] = speed, cmd
    return state, cmd, speed


def course_stable(boat: Vessel, share: float = 0.01) -> bool:
    """Return whether drift decays by more than a share per ship length."""
    n = boat.values["shaft_speed_manoeuvring"]
    rate = boat.straight_speed(n) / boat.values["length_waterline"]
    return course_eigenvalues(boat, n)[0].real < -share * rate


@pytest.mark.parametrize("dof", [3, 6])
def test_a_disturbed_vessel_returns_to_a_straight_course(boat: Vessel, dof: int) -> None:
    state, cmd, speed = underway(boat)
    L = boat.values["length_waterline"]
    state[[fr.V, fr.R]] = 0.02 * speed, 0.02 * speed / L
    slowest = course_eigenvalues(boat, boat.values["shaft_speed_manoeuvring"])[0].real
    if course_stable(boat):
        end = run(boat, state, cmd, max(60.0 * L / speed, -15.0 / slowest), dof)[-1]
        # after fifteen time constants or 60 lengths
        assert abs(end[fr.V]) < 1e-4 * speed
        assert abs(end[fr.R]) < 1e-4 * speed / L
        assert end[fr.U] == pytest.approx(speed, rel=1e-3)
    else:  # its file says so, and it turns slowly
        text = (FOLDER / f"{boat.name}.toml").read_text(encoding="utf-8")
        assert "course-" in text.split("[vessel]")[0]
        end = run(boat, state, cmd, 20.0 * L / speed, dof)[-1]
        assert abs(end[fr.R]) < 0.2 * speed / L
        assert end[fr.U] > 0.8 * speed


def test_a_heeled_vessel_rights_itself(boat: Vessel) -> None:
    state, cmd, _ = underway(boat)
    state[[fr.Z, fr.PHI, fr.THETA]] = 0.1 * boat.values["draft"], 0.1, 0.02
    v = boat.values
    roll = 2 * math.pi * math.sqrt((v["I_xx"] + v["J_xx"]) / (v["mass"] * 9.8 * v["GM_T"]))
    seconds = 2.0 * roll / max(v["zeta_roll"], 0.05)
    track = run(boat, state, cmd, seconds, 6)
    assert np.isfinite(track).all()
    tail = track[-len(track) // 10 :]
    # two periods over the damping: e^-12 of the heel; the thrust keeps a little trim
    assert np.max(np.abs(tail[:, fr.PHI])) < 1e-3
    assert np.max(np.abs(tail[:, fr.THETA])) < 0.02
    assert np.max(np.abs(tail[:, fr.Z])) < 0.02 * v["draft"]


def test_turns_to_both_sides_are_equally_fast(boat: Vessel) -> None:
    state, speed = underway(boat)[::2]
    L, n = boat.values["length_waterline"], boat.values["shaft_speed_manoeuvring"]
    rates = [
        run(boat, state, boat.command(n, sign * boat.helm_max), 10.0 * L / speed, 3)[-1, fr.R]
        for sign in (1.0, -1.0)
    ]
    assert rates[0] > 0.0 > rates[1]
    # C_2 and gamma_R of a single propeller differ by side: 10 %
    assert rates[0] == pytest.approx(-rates[1], rel=0.1)


def test_pickling_keeps_a_vessel(boat: Vessel) -> None:
    _ = boat.packed  # a cached vector must not prevent it
    again = pickle.loads(pickle.dumps(boat))
    assert again.guesses == boat.guesses
    assert dict(again.values) == dict(boat.values)
    np.testing.assert_array_equal(again.packed, boat.packed)


def test_a_vessel_is_immutable(boat: Vessel) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        boat.name = "other"  # type: ignore[misc]
    with pytest.raises(TypeError):
        boat.values["mass"] = 1.0  # type: ignore[index]
    with pytest.raises(AttributeError, match="no 'wings'"):
        _ = boat.wings


def test_outputs_of_an_autopilot_are_those_of_the_kind(tmp_path: Path) -> None:
    usv75, otter = Vessel.load("usv75"), Vessel.load("otter")
    helm = math.radians(15.0)
    command = [-12.8, -12.8, helm, helm]
    assert usv75.servos.command([1700, 0, 1300]) == pytest.approx(command)
    full = otter.values["shaft_speed_max"]
    assert otter.servos.command([1900, 1900, 1100]) == pytest.approx([full, -full, 0.0, 0.0])
    path = tmp_path / "boat.toml"
    for boat in (usv75, otter):  # without the table they have the same outputs by default
        text = (FOLDER / f"{boat.name}.toml").read_text(encoding="utf-8")
        path.write_text(text.partition("[autopilot]")[0], encoding="utf-8")
        assert Vessel.load(path).outputs is None
        assert Vessel.load(path).servos == boat.servos
    path.write_text(USV75 + "pulse = [1000, 1500, 2000]\n", encoding="utf-8")
    servos = Vessel.load(path).servos
    assert (servos.low, servos.middle, servos.high) == (1000.0, 1500.0, 2000.0)


# ------------------------------------------------- random boats of a kind


def growth(boat: Vessel) -> float:
    """Return the largest growth rate of drift over the shaft speeds, per ship length."""
    return max(
        course_eigenvalues(boat, n)[0].real
        * boat.values["length_waterline"]
        / boat.straight_speed(n)
        for n in (boat.values[f"shaft_speed_{at}"] for at in ("manoeuvring", "service", "max"))
    )


def test_varied_boats_keep_kind_stability_and_speed(boat: Vessel) -> None:
    n = boat.values["shaft_speed_manoeuvring"]
    for seed in range(10):
        other = boat.varied(np.random.default_rng(seed))
        again = boat.varied(np.random.default_rng(seed))
        assert dict(other.values) == dict(again.values)
        assert other.resistance_force == again.resistance_force
        assert (other.name, other.kind) == (boat.name, boat.kind)
        assert other.design == boat.design == boat.name
        for key, value in boat.values.items():
            assert math.copysign(1.0, other.values[key]) == math.copysign(1.0, value)
            kept = key.startswith(("shaft_", "steer_")) or key in ("units", "water_density")
            assert (other.values[key] == value) == (kept or value == 0.0), key
        # an unstable vessel varies into boats that are not more unstable
        assert growth(other) <= max(growth(boat), 0.0)
        assert 0.75 <= other.straight_speed(n) / boat.straight_speed(n) <= 4.0 / 3.0
        assert other.length_waterline <= other.length_overall


def test_a_user_file_has_no_design_whatever_its_name(tmp_path: Path) -> None:
    path = tmp_path / "usv75.toml"
    path.write_bytes((FOLDER / "usv75.toml").read_bytes())
    own = Vessel.load(path)
    assert (own.name, own.design) == ("usv75", "")
    assert own.varied(np.random.default_rng(0)).design == ""
    assert pickle.loads(pickle.dumps(Vessel.load("usv75"))).design == "usv75"


@pytest.mark.slow
def test_varied_boats_have_the_given_spread() -> None:
    boat, rng = Vessel.load("usv75"), np.random.default_rng(1)
    assert dict(boat.varied(rng, 0.0).values) == dict(boat.values)
    ratios = np.array(
        [
            [other.values[key] / boat.values[key] for key in ("astern", "CD_t", "I_xx", "GM_T")]
            for other in (boat.varied(rng) for _ in range(400))
        ]
    )
    # rejection does not depend on these keys; 400 draws give a spread to 3.5 %
    np.testing.assert_allclose(np.std(ratios, axis=0), [0.15, 0.15, 0.05, 0.05], rtol=0.12)
    np.testing.assert_allclose(np.mean(ratios, axis=0), 1.0, atol=0.03)


def test_impossible_spreads_are_refused() -> None:
    boat, rng = Vessel.load("usv75"), np.random.default_rng(0)
    for bad in (-0.1, math.nan, math.inf):
        with pytest.raises(VesselError, match=r"spread=.*0 or more"):
            boat.varied(rng, bad)
    kind = BoatClass(boat, 0.15)
    kind.law.view(LAW)["growth"] = -math.inf  # no boat is stable
    with pytest.raises(VesselError, match=r"usv75: none of 1000 boats.*smaller spreads"):
        kind.draw(rng)


# ------------------------------------------------- golden and published numbers

GOLDEN = Path(__file__).parents[1] / "physics" / "golden"


def zigzag(boat: Vessel, dof: int) -> dict[str, list[float]]:
    """Return states of a timed zigzag in sea state 2, seed 0."""
    # Froude scaling above 10 m
    simulation = Simulation(1, boat, SeaState.named("2"), suite=SensorSuite.perfect(), dof=dof)
    simulation.reset([0], [np.random.default_rng(0)])
    scale = max(1.0, round(math.sqrt(boat.values["length_waterline"] / 10.0)))
    steps = int(1200 * scale)
    t = 0.05 * np.arange(steps)
    states = {}
    for k, cmd in enumerate(commands("zigzag", t / scale, boat, np.random.default_rng(0)), start=1):
        simulation.step(cmd[None])
        if k % (steps // 10) == 0:
            states[f"{k * 0.05:g}"] = simulation.state[0].tolist()
    return states


TRAJECTORIES = {"usv75_zigzag": ("usv75", 3)} | {f"{v}_6dof": (v, 6) for v in vessel_names()}


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_zigzag_equals_the_golden_trajectory(name: str) -> None:
    golden = json.loads((GOLDEN / f"{name}.json").read_text(encoding="utf-8"))["states"]
    vessel, dof = TRAJECTORIES[name]
    states = zigzag(Vessel.load(vessel), dof)
    assert list(states) == list(golden)
    for t, state in states.items():
        # 1e-6: the sums' order may differ between processors
        rtol = 0.0 if dof == 3 else 1e-8
        np.testing.assert_allclose(state, golden[t], rtol=rtol, atol=1e-6, err_msg=f"t = {t} s")
    course = np.array(list(golden.values()))
    # it is a zigzag
    assert np.ptp(course[:, fr.PSI]) > math.radians(20.0 if dof == 3 else 5.0)
    assert np.max(np.abs(course[:, [fr.PHI, fr.THETA]])) < math.radians(60.0)


# ------------------------------------------------- bad files


def changed(key: str, entry: str) -> str:
    """Return the text of usv75 with another entry for a key."""
    text, count = re.subn(rf"(?m)^{key} = .*$", f"{key} = {entry}".replace("\\", r"\\"), USV75)
    assert count == 1
    return text


def value(number: str, unit: str) -> str:
    return f'{{ value = {number}, unit = "{unit}", source = "test" }}'


def check_refused(tmp_path: Path, text: str, words: Sequence[str]) -> None:
    """Check that loading the text raises one message with the path and all words."""
    path = tmp_path / "boat.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(VesselError) as caught:
        Vessel.load(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert caught.value.__cause__ is None
    assert all(word in message for word in words), (message, words)


@pytest.mark.parametrize(
    ("key", "entry", "word"),
    [
        ("beam", value("2.7", "m") + '\nmast = { value = 1, unit = "m" }', "mast"),
        ("beam", "2.714", "no unit"),
        ("beam", '{ value = 2.7, source = "x" }', "unit: is missing"),
        ("beam", '{ value = 2.7, unit = "m" }', "source: is missing"),
        ("beam", '{ value = 2.7, unit = "m", source = "x", note = 1 }', "note"),
        ("beam", value("2.7", "ft"), "use m, mm"),
        ("beam", '{ value = 2.7, unit = ["m"], source = "x" }', "use m, mm"),
        ("steer_max", value("30", "kn"), "use rad, deg"),
        ("mass", value("0", "kg"), "above 0"),
        ("A_R", value("-0.1", "m2"), "0 or more"),
        ("mass", value('"heavy"', "kg"), "'heavy'"),
        ("mass", value("true", "kg"), "True"),
        ("mass", value("[1, 2]", "kg"), "[1, 2]"),
        ("N_v", value("nan", "1"), "finite"),
        ("N_v", value("-inf", "1"), "finite"),
        ("N_v", value("1" + "0" * 400, "1"), "digits"),
        ("mass", value("5000", "kg"), "20 %"),
        ("x_P", value("2.6", "m"), "aft"),
    ],
)
def test_bad_entries_are_refused_with_place_and_remedy(
    tmp_path: Path, key: str, entry: str, word: str
) -> None:
    check_refused(tmp_path, changed(key, entry), (key, word))


def curve(speed: str, force: str, unit: str = "kN") -> str:
    text = re.sub(r"(?m)^speed = .*$", f"speed = {value(speed, 'kn')}", USV75)
    return re.sub(r"(?m)^force = .*$", f"force = {value(force, unit)}", text)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (USV75.replace("J_zz = {", "J_zzz = {"), ("[particulars] J_zzz", "did you mean 'J_zz'")),
        (re.sub(r"(?m)^J_zz = .*$", "", USV75), ("[particulars] J_zz", "kg m2")),
        (USV75 + "\n[sails]\narea = 3\n", ("sails", "known:")),
        (USV75[: USV75.index("[wind]")], ("wind", "missing")),
        ("wind = 3\n" + USV75[: USV75.index("[wind]")], ("[wind]", "table")),
        (USV75.replace('title = "', 'colour = "'), ("[vessel] colour", "name, title")),
        (USV75.replace('title = "', 'title = 3 #"'), ("[vessel] title", "text")),
        (USV75.replace("[hull]", "[hull"), ("not valid TOML", "line")),
        (USV75.replace("throttle = 3", "throttle = 0"), ("[autopilot]", "1 to 16")),
        (USV75.replace("throttle = 3", ""), ("[autopilot] throttle", "missing")),
        (USV75.replace("throttle = 3", 'throttle = "a"'), ("[autopilot] throttle", "output")),
        (USV75.replace("throttle = 3", "throttle = 3\nleft = 2"), ("[autopilot] left", "known:")),
        (USV75 + "pulse = [1500, 1100, 1900]\n", ("[autopilot]", "rise")),
        (USV75 + "pulse = [1500]\n", ("[autopilot] pulse", "three")),
        (curve("[0, 5, 10]", "[0, 1, 2, 3]"), ("[hull.resistance]", "equally many")),
        (curve("[0, 5]", "[0, 1]"), ("[hull.resistance]", "3 to 16")),
        (curve(str(list(range(17))), str(list(range(17)))), ("[hull.resistance]", "3 to 16")),
        (curve("[0, 5, 5]", "[0, 1, 2]"), ("[hull.resistance]", "rise")),
        (curve("[1, 5, 10]", "[0, 1, 2]"), ("[hull.resistance]", "start at speed 0")),
        (curve("[0, 5, 10]", "[0, -1, 2]"), ("[hull.resistance]", "negative")),
        (curve("[0, 5, 10]", '[0, "x", 2]'), ("[hull.resistance]", "list of numbers")),
        (curve("[0, 5, 10]", "5"), ("[hull.resistance]", "list of numbers")),
        (curve("[0, nan, 10]", "[0, 1, 2]"), ("[hull.resistance]", "finite")),
        (curve("[0, 5, 10]", "[0, 1, inf]"), ("[hull.resistance]", "finite")),
        (curve("[0, 5, 10]", "[0, 1, 2]", "lbf"), ("[hull.resistance]", "use N, kN")),
    ],
)
def test_bad_tables_are_refused_with_place_and_remedy(
    tmp_path: Path, text: str, words: Sequence[str]
) -> None:
    check_refused(tmp_path, text, words)


def test_unknown_names_and_unreadable_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(VesselError, match=r"'bismarck'.*known: .*usv75"):
        Vessel.load("bismarck")
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    for name in ("none.toml", "folder.toml", "binary.toml"):
        with pytest.raises(VesselError, match=name):
            Vessel.load(tmp_path / name)


def test_other_packages_add_vessels_by_entry_points(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "patrol.toml").write_text(USV75.replace('name = "usv75"', 'name = "patrol"'))
    (tmp_path / "yard_of_boats.py").write_text(
        "from pathlib import Path\nPATROL = Path(__file__).with_name('patrol.toml')\n"
    )
    about = tmp_path / "yard_of_boats-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: yard_of_boats\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        f"[{vessel_file.GROUP}]\npatrol = yard_of_boats:PATROL\nusv75 = yard_of_boats:PATROL\n"
        "wreck = yard_of_boats:WRECK\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    vessel_file._added.cache_clear()
    try:
        assert vessel_names() == (*vessel_file.shipped_names(), "patrol", "wreck")
        patrol = Vessel.load("patrol")
        assert (patrol.name, patrol.design) == ("patrol", "")
        assert patrol.values == Vessel.load("usv75").values
        assert Vessel.load("usv75").name == "usv75"  # those that ship keep their names
        with pytest.raises(VesselError, match="'wreck': the entry point yard_of_boats:WRECK"):
            Vessel.load("wreck")
    finally:
        vessel_file._added.cache_clear()


def test_the_constructor_checks_values() -> None:
    boat = Vessel.load("usv75")
    with pytest.raises(VesselError, match=r"\[particulars\] mass.*above 0"):
        dataclasses.replace(boat, values={**boat.values, "mass": -1.0})
    with pytest.raises(VesselError, match="wings"):
        dataclasses.replace(boat, values={**boat.values, "wings": 2.0})
    without = {key: number for key, number in boat.values.items() if key != "beam"}
    with pytest.raises(VesselError, match="beam"):
        dataclasses.replace(boat, values=without)


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


def test_resistance_curve_is_converted_to_si(tmp_path: Path) -> None:
    path = tmp_path / "boat.toml"
    path.write_text(curve("[0, 10, 36]", "[0, 1.5, 4]"), encoding="utf-8")
    boat = Vessel.load(path)
    np.testing.assert_allclose(boat.resistance_speed, [0, 18520 / 3600, 18.52], rtol=1e-15)
    np.testing.assert_allclose(boat.resistance_force, [0, 1500.0, 4000.0], rtol=1e-15)


if __name__ == "__main__":
    for name, (vessel, dof) in TRAJECTORIES.items():
        about = (
            f"{vessel}, timed zigzag at shaft_speed_manoeuvring, sea state 2, seed 0, {dof} "
            "degrees of freedom: ten times the 16 states of usv_gym.physics.frames; written by "
            "tests/usv_gym/vessel/test_vessel.py"
        )
        (GOLDEN / f"{name}.json").write_text(
            json.dumps({"about": about, "states": zigzag(Vessel.load(vessel), dof)}, indent=1)
            + "\n",
            encoding="utf-8",
        )
