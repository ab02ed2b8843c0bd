"""First vessel files from main particulars."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from usv_gym import SeaState, Vessel
from usv_gym.design.checks import inspect
from usv_gym.design.new_vessel import DesignError, MainParticulars, design
from usv_gym.physics import frames as fr
from usv_gym.vessel.vessel import KIND_SCHEMA, course_eigenvalues
from usv_gym.world.simulation import Simulation

hulls = {
    "length": st.floats(1.0, 300.0),
    "slender": st.floats(2.0, 8.5),
    "flat": st.floats(2.0, 7.0),
    "block": st.floats(0.32, 0.88),
    "froude": st.floats(0.1, 1.0),
    "kind": st.sampled_from(list(KIND_SCHEMA)),
}


@given(**hulls)
@example(length=1.0, slender=8.0, flat=2.0, block=0.5, froude=0.35, kind="propeller_rudder")
@settings(max_examples=40, deadline=None)
def test_a_new_vessel_loads_passes_checks_and_sails(
    tmp_path_factory: pytest.TempPathFactory,
    length: float,
    slender: float,
    flat: float,
    block: float,
    froude: float,
    kind: str,
) -> None:
    if kind == "propeller_rudder":
        froude = min(froude, 0.35)
    if froude > 0.4:  # planing boats are flat and slender
        flat, block = max(flat, 3.5), min(block, 0.55)
    if kind == "thruster_pair":  # they turn by unequal thrust, so they must be wide
        slender, flat = min(slender, 4.5), max(flat, 3.0)
    beam, draft = length / slender, length / slender / flat
    known = MainParticulars(
        name="first",
        length=length,
        beam=beam,
        draft=draft,
        mass=1025.0 * block * length * beam * draft,
        kind=kind,
        speed=froude * math.sqrt(9.80665 * length),
    )
    first = design(known)
    path = tmp_path_factory.mktemp("new") / "first.toml"
    path.write_text(first.text, encoding="utf-8")
    boat = Vessel.load(path)
    assert dict(boat.values) == pytest.approx(dict(first.vessel.values), rel=1e-12)
    assert boat.guesses == first.vessel.guesses
    assert inspect(boat).errors == []
    n = boat.values["shaft_speed_manoeuvring"]
    assert course_eigenvalues(boat, n)[0].real < 0.0
    assert boat.straight_speed(boat.values["shaft_speed_service"]) == pytest.approx(
        froude * math.sqrt(9.80665 * length), rel=1e-2
    )
    # sea state 2 would capsize a boat of 1 m
    simulation = Simulation(1, boat, SeaState(hs=min(0.5, 0.03 * length), wind=3.0), dof=6)
    simulation.reset([0], [np.random.default_rng(0)])
    for k in range(200):
        simulation.step(boat.command(n, 0.1 * (k > 100))[None])
    assert np.isfinite(simulation.state).all()
    assert np.max(np.abs(simulation.state[0, [fr.PHI, fr.THETA]])) < 0.8


def test_estimates_are_marked_with_their_source_and_range() -> None:
    boat = {"name": "a", "length": 6.336, "beam": 2.714, "draft": 0.526, "mass": 3420.0}
    first = design(MainParticulars(**boat, speed=10.0))  # type: ignore[arg-type]
    assert "mass" not in first.vessel.guesses and "Y_v" in first.vessel.guesses
    assert re.search(r"(?m)^Y_v = .*Kijima 1990; out of its range.*guess = true", first.text)
    assert re.search(r"(?m)^mass = (?!.*guess)", first.text)
    assert any("L/B is 2.33" in note for note in first.notes)
    boat = {"name": "b", "length": 100.0, "beam": 16.0, "draft": 6.0, "mass": 6.9e6}
    tanker = design(MainParticulars(**boat, kind="propeller_rudder"))  # type: ignore[arg-type]
    assert re.search(r"(?m)^Y_vvv = .*Yoshimura and Masumoto 2012\"", tanker.text)
    assert not any("Yoshimura" in note or "Kijima 1990: L/B" in note for note in tanker.notes)


def test_speed_and_power_imply_each_other() -> None:
    particulars = {"length": 6.336, "beam": 2.714, "draft": 0.526, "mass": 3420.0}
    by_power = design(MainParticulars(name="a", power=260e3, **particulars))  # type: ignore[arg-type]
    speed = by_power.vessel.straight_speed(by_power.vessel.values["shaft_speed_service"])
    # the paper's boat needs about 260 kW for 38 kn by its own curve: within 20 %
    assert speed * 3600 / 1852 == pytest.approx(38.0, rel=0.2)
    both = design(MainParticulars(name="a", power=10e3, speed=15.0, **particulars))  # type: ignore[arg-type]
    assert any("kW" in note for note in both.notes)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"mass": 90000.0}, ("mass = 90000", "block coefficient")),
        ({"mass": 10.0}, ("block coefficient",)),
        ({"length": -1.0}, ("length = -1",)),
        ({"beam": math.nan}, ("beam = nan",)),
        ({"draft": 0.05, "mass": 300.0}, ("B/d", "1.2 to 20")),
        ({"beam": 6.0, "draft": 1.0, "mass": 1e4}, ("L/B",)),
        ({"speed": 100.0}, ("speed", "Froude")),
        ({"speed": 0.0}, ("speed = 0",)),
        ({"name": "a b"}, ("letters, digits",)),
        ({"kind": "sail"}, ("kind", "thruster_pair")),
        ({"kind": "thruster_pair", "units": 1}, ("units = 1",)),
        ({"units": 3}, ("units = 3",)),
        ({"length_overall": 5.0}, ("length_overall = 5",)),
    ],
)
def test_bad_particulars_are_refused(changes: dict[str, object], words: tuple[str, ...]) -> None:
    good = {"name": "a", "length": 6.3, "beam": 2.7, "draft": 0.53, "mass": 3400.0}
    with pytest.raises(DesignError) as caught:
        design(MainParticulars(**{**good, **changes}))  # type: ignore[arg-type]
    assert all(word in str(caught.value) for word in words)
