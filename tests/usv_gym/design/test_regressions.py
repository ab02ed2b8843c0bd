"""Regressions against separate computations for the 7.5 m boat, and against KVLCC2."""

import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from usv_gym import Vessel
from usv_gym.design import regressions as reg
from usv_gym.design.regressions import Estimate, Form

BOAT = Form(length=6.336, beam=2.714, draft=0.526, block_coefficient=0.3689)
TANKER = Form(length=320.0, beam=58.0, draft=20.8, block_coefficient=0.81, x_G=11.2)


def test_kijima_equals_references_for_the_boat() -> None:
    values = reg.kijima(BOAT, 0.0)
    # three figures: half a unit of the last
    assert values["Y_v"] == pytest.approx(-0.482, abs=5e-4)
    assert values["Y_r"] == pytest.approx(0.130, abs=5e-4)
    assert values["N_v"] == pytest.approx(-0.166, abs=5e-4)
    assert values["N_r"] == pytest.approx(-0.0621, abs=5e-5)
    assert reg.kijima(BOAT, 0.05)["Y_r"] == pytest.approx(values["Y_r"] + 0.05)
    assert any("L/B is 2.33" in note for note in values.notes)


def test_kijima_is_near_published_coefficients_of_kvlcc2() -> None:
    values = reg.kijima(TANKER, 0.022)
    assert values.notes == ()
    boat = Vessel.load("kvlcc2")
    # a regression over many ships: within 30 %
    for key in ("Y_v", "N_v", "N_r"):
        assert values[key] == pytest.approx(boat.values[key], rel=0.31)


def test_added_masses_equal_references_for_the_boat() -> None:
    assert reg.soding(BOAT)["m_x"] == pytest.approx(514.0, rel=2e-3)
    values = reg.zhou(BOAT)
    assert values["m_y"] / BOAT.mass == pytest.approx(0.70, abs=5e-3)
    assert values["J_zz"] == pytest.approx(4955.0, rel=2e-3)


def test_added_masses_are_near_those_of_kvlcc2() -> None:
    # from the same charts: 5 % for sway and yaw
    values, boat = reg.zhou(TANKER), Vessel.load("kvlcc2")
    assert values["m_y"] == pytest.approx(boat.values["m_y"], rel=0.05)
    assert values["J_zz"] == pytest.approx(boat.values["J_zz"], rel=0.05)


def test_yoshimura_notes_wrong_signs_out_of_range() -> None:
    values = reg.yoshimura(BOAT, 0.08 * 0.3689 * 2 * 0.43, 0.3)
    assert values["Y_vvv"] == pytest.approx(0.048, abs=1e-3)
    assert any("Y_vvv" in note for note in values.notes)
    tanker = reg.yoshimura(TANKER, 0.022, 0.223)
    assert tanker.notes == ()
    assert tanker["Y_vvv"] < 0.0 and tanker["N_rrr"] < 0.0
    assert tanker["X_rr"] == pytest.approx(-0.085 * 0.1468 + 0.008 - 0.035 * 0.223, abs=1e-4)


def test_hydrostatics_match_the_boat_and_a_box() -> None:
    values = reg.hydrostatics(BOAT, 0.78)
    assert values["KB"] == pytest.approx(0.36, abs=0.006)
    # the references use another rule for the inertia of the water plane: 12 %
    assert values["BM_T"] == pytest.approx(1.85, rel=0.12)
    assert values["BM_L"] == pytest.approx(9.4, rel=0.12)
    # a box: KB half the draft, BM_T of B^2 / (12 d) to the 3 % of the rule
    box = Form(length=10.0, beam=3.0, draft=1.0, block_coefficient=1.0)
    values = reg.hydrostatics(box, 1.0)
    assert values["KB"] == pytest.approx(0.5)
    assert values["BM_T"] == pytest.approx(9.0 / 12.0, rel=0.035)
    assert values["BM_L"] == pytest.approx(100.0 / 12.0, rel=0.1)
    assert any("typical 0.6" in note for note in values.notes)


def test_rudder_and_cross_flow_match_references() -> None:
    values = reg.kijima_rudder(TANKER)
    published = Vessel.load("kvlcc2").values
    # a regression over many ships: within 15 %
    assert values["a_H"] == pytest.approx(published["a_H"], rel=0.15)
    assert values["epsilon"] == pytest.approx(published["epsilon"], rel=0.15)
    assert reg.cross_flow(BOAT)["C_d_crossflow"] == pytest.approx(0.60, abs=0.005)
    wide = Form(length=10.0, beam=8.0, draft=0.5, block_coefficient=0.5)
    assert reg.cross_flow(wide)["C_d_crossflow"] == pytest.approx(0.559, abs=1e-3)
    deep = Form(length=10.0, beam=0.001, draft=5.0, block_coefficient=0.5)
    assert reg.cross_flow(deep)["C_d_crossflow"] == pytest.approx(1.966)


EVERY: tuple[Callable[[Form], Estimate], ...] = (
    lambda form: reg.kijima(form, 0.02),
    lambda form: reg.yoshimura(form, 0.02, 0.2),
    reg.soding,
    reg.zhou,
    lambda form: reg.hydrostatics(form, 0.8),
    reg.kijima_rudder,
    reg.cross_flow,
)


@given(
    scale=st.floats(0.01, 50.0),
    slender=st.floats(2.0, 9.0),
    flat=st.floats(1.5, 8.0),
    block=st.floats(0.2, 0.95),
)
def test_dimensionless_numbers_do_not_depend_on_the_scale(
    scale: float, slender: float, flat: float, block: float
) -> None:
    def form(L: float) -> Form:
        return Form(length=L, beam=L / slender, draft=L / slender / flat, block_coefficient=block)

    one, other = form(10.0), form(10.0 * scale)
    for estimate in EVERY:
        assert all(math.isfinite(value) for value in estimate(one).values.values())
        if estimate not in (reg.soding, reg.zhou):
            lengths = {key: scale for key in ("KB", "BM_T", "BM_L")}
            for key, value in estimate(one).values.items():
                wanted = value * lengths.get(key, 1.0)
                assert estimate(other)[key] == pytest.approx(wanted, rel=1e-9, abs=1e-12)
    for key, power in (("m_y", 3), ("J_zz", 5)):
        # rounding only
        assert reg.zhou(other)[key] == pytest.approx(reg.zhou(one)[key] * scale**power, rel=1e-9)
