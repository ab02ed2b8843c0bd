"""Model structures: their formulas, slopes, blocks, priors and symmetries."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from twin import Twin
from twin.model.priors import scaled_prior
from twin.model.structure import (
    MODELS,
    N_TERMS,
    ONE,
    TERMS,
    Structure,
    Term,
    accelerations,
    state_terms,
    structure_of,
    term_slopes,
    thrust_terms,
)
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel

LENGTH, SPEED, SHAFT = 6.336, 5.4, 6.33
CALM = np.zeros(2)

finite = st.floats(-10.0, 10.0)
angle = st.floats(-0.7, 0.7)
CASES = [
    pytest.param((name, kind, biased), id=f"{name}-{kind}-{biased:d}")
    for name in MODELS
    for kind in ("drives", "differential", "tanker")
    for biased in (False, True)
]


def boat(case: tuple[str, str, bool]) -> Structure:
    name, kind, biased = case
    options = {} if kind == "drives" else {kind: True}
    return structure_of(name, LENGTH, SPEED, SHAFT, **options, biased=biased)


def terms_of(
    structure: Structure,
    nu: tuple[float, float, float],
    psi: float,
    wind: np.ndarray,
    act: tuple[float, float, float, float],
) -> np.ndarray:
    terms = np.full(N_TERMS, math.nan)
    n_l, n_r, d_l, d_r = act
    thrust_terms(n_l, n_r, math.cos(d_l), math.sin(d_l), math.cos(d_r), math.sin(d_r), terms)
    state_terms(*nu, math.cos(psi), math.sin(psi), wind, structure.terms.hull, terms)
    return terms


def printed(
    kind: str,
    nu: tuple[float, float, float],
    psi: float,
    wind: np.ndarray,
    act: tuple[float, float, float, float],
) -> dict[str, tuple[float, float, float]]:
    """Return what one unit of each parameter adds to u', v', r'.

    Source: Eq (20), with docs/explanation/ship_and_sea.md, What the paper gets wrong;
    docs/explanation/twin.md, Model structure. Shaft speeds are those of the
    structure: in `mmg` each is a speed of flow.
    """
    u, v, r = nu
    n_l, n_r, d_l, d_r = act
    left, right = n_l * abs(n_l), n_r * abs(n_r)
    cos_l, cos_r, sin_l, sin_r = math.cos(d_l), math.cos(d_r), math.sin(d_l), math.sin(d_r)
    surge = {
        **{"X_u": u, "X_uu": u * abs(u), "X_u|u|": u * abs(u), "X_uuu": u**3},
        **{"X_vv": v**2, "X_vr": v * r, "X_rr": r**2},
        **{"T_uL": left * cos_l, "T_uR": right * cos_r},
        "X_nn": (left * cos_l + right * cos_r) / 2,
        "X_nu": u * (abs(n_l) * cos_l + abs(n_r) * cos_r) / 2,
    }
    sway = {
        **{"Y_u": u, "Y_v": v, "Y_r": r, "Y_ur": u * r, "Y_|u|v": abs(u) * v},
        **{"Y_v|v|": v * abs(v), "Y_v|r|": v * abs(r), "Y_|v|r": abs(v) * r, "Y_r|r|": r * abs(r)},
        **{"T_vL": left * sin_l, "T_vR": right * sin_r},
        "Y_nn": (left * sin_l + right * sin_r) / 2,
        "Y_nu": u * (abs(n_l) * sin_l + abs(n_r) * sin_r) / 2,
    }
    yaw = {
        **{"N_u": u, "N_v": v, "N_r": r, "N_uv": u * v, "N_|u|r": abs(u) * r},
        **{"N_v|v|": v * abs(v), "N_v|r|": v * abs(r), "N_|v|r": abs(v) * r, "N_r|r|": r * abs(r)},
        **{"N_vvr": v**2 * r, "N_vrr": v * r**2, "N_0": 1.0},
        **{"N_cos": math.cos(psi), "N_sin": math.sin(psi)},
        **{"N_cos2": math.cos(2 * psi), "N_sin2": math.sin(2 * psi)},
        "T_rL": left if kind == "differential" else left * sin_l,
        "T_rR": -right if kind == "differential" else right * sin_r,
        **{"N_nn": sway["Y_nn"], "N_nu": sway["Y_nu"]},
        "N_dn": (min(n_l, 0) ** 2 + min(n_r, 0) ** 2) / 2
        if kind == "tanker"
        else (left * cos_l - right * cos_r) / 2,
    }
    # by unequal propellers
    surge["X_dn"] = (left * cos_l - right * cos_r) / 2
    yaw["N_mn"] = surge["X_nn"]
    # a rudder or drive feels hull wake, slipstream (a tenth of it astern), and the turning stern
    across = 0.5 * (0.71 * LENGTH * r - v)
    fin_x, fin_y, side = 0.0, 0.0, 0.0
    for n, d in ((n_l, d_l), (n_r, d_r)):
        square = 0.4 * u * abs(u) + (0.6 if n > 0 else 0.06) * n * abs(n)
        along = square / math.sqrt(abs(square) + (0.05 * SPEED) ** 2)
        force = (along**2 + across**2) * math.sin(d - math.atan2(across, along))
        fin_x += force * math.sin(d) / 2
        fin_y += force * math.cos(d) / 2
        # the part of the force that cross flow alone gives, whatever side it comes from
        side += math.hypot(along, across) * abs(across) * math.cos(d) ** 2 / 2
    surge["X_F"], sway["Y_F"], yaw["N_F"] = fin_x, fin_y, fin_y
    sway["Y_S"] = yaw["N_S"] = side
    if wind.any():
        north = wind[0] - (u * math.cos(psi) - v * math.sin(psi))
        east = wind[1] - (u * math.sin(psi) + v * math.cos(psi))
        fast, toward = math.hypot(north, east), math.atan2(east, north) - psi
        surge["X_w"] = fast**2 * math.cos(toward)
        sway["Y_w"] = fast**2 * math.sin(toward)
        yaw["N_w"] = fast**2 * math.sin(toward) * math.cos(toward)
    else:
        surge["X_w"] = sway["Y_w"] = yaw["N_w"] = 0.0
    return {
        **{name: (value, 0.0, 0.0) for name, value in surge.items()},
        **{name: (0.0, value, 0.0) for name, value in sway.items()},
        **{name: (0.0, 0.0, value) for name, value in yaw.items()},
        "E_north": (math.cos(psi), -math.sin(psi), 0.0),
        "E_east": (math.sin(psi), math.cos(psi), 0.0),
    }


@pytest.mark.parametrize("case", CASES)
@settings(max_examples=40, deadline=None)
@given(
    nu=st.tuples(finite, finite, finite),
    psi=finite,
    wind=st.one_of(st.just((0.0, 0.0)), st.tuples(finite, finite)),
    act=st.tuples(finite, finite, angle, angle),
)
def test_every_parameter_multiplies_its_printed_term(case, nu, psi, wind, act) -> None:
    structure, wind = boat(case), np.array(wind)
    terms = terms_of(structure, nu, psi, wind, act)
    formulas = printed(case[1], nu, psi, wind, act)
    for k, name in enumerate(structure.parameters):
        got = accelerations(terms, structure.terms, np.eye(len(structure))[k], 0)
        # values to some 1e3: rounding of their factors
        np.testing.assert_allclose(got, formulas[name], rtol=1e-10, atol=1e-10, err_msg=name)


def away_from_kinks(*values: float) -> None:
    assume(min(map(abs, values)) > 0.05)


@pytest.mark.parametrize("name", MODELS)
@settings(max_examples=150, deadline=None)
@given(
    nu=st.tuples(finite, finite, finite),
    psi=finite,
    wind=st.one_of(st.just((0.0, 0.0)), st.tuples(finite, finite)),
    act=st.tuples(finite, finite, angle, angle),
)
def test_slopes_are_those_of_the_terms(name, nu, psi, wind, act) -> None:
    u, v, r = nu
    away_from_kinks(u, v, r)
    away_from_kinks(0.71 * LENGTH * r - v)
    wind = np.array(wind)
    structure = structure_of(name, LENGTH, SPEED, SHAFT, tanker=True)  # it has all terms
    hull = structure.terms.hull
    for n in act[:2]:  # where the flow at a drive turns round
        away_from_kinks(0.4 * u * abs(u) + (0.6 if n > 0.0 else 0.06) * n * abs(n))
    # where the apparent wind ends
    c, s = math.cos(psi), math.sin(psi)
    away_from_kinks(math.hypot(wind[0] - (u * c - v * s), wind[1] - (u * s + v * c)))
    slopes = np.zeros((4, N_TERMS))
    # another state was there before: nothing of it may stay
    other = terms_of(structure, (1.0, 2.0, 3.0), 0.4, np.array([5.0, 1.0]), (1.0, 2.0, 0.3, 0.4))
    term_slopes((1.0, 2.0, 3.0), (0.9, 0.4), np.array([5.0, 1.0]), hull, other, slopes)
    terms = terms_of(structure, nu, psi, wind, act)
    term_slopes((u, v, r), (c, s), wind, hull, terms, slopes)
    h, at = 1e-5, np.array([u, v, r, psi])
    used = sorted({int(t) for row in structure.terms.which for t in row})
    for i in range(4):
        up, down = (
            terms_of(structure, tuple(moved[:3]), moved[3], wind, act)
            for moved in (at + h * np.eye(4)[i], at - h * np.eye(4)[i])
        )
        expected = (up - down) / (2.0 * h)
        # rounding of terms to 1e3 over 2 h, and h^2 times third derivatives (to 1e4)
        np.testing.assert_allclose(
            slopes[i, used], expected[used], rtol=1e-6, atol=2e-6, err_msg=str(i)
        )


@pytest.mark.parametrize("name", MODELS)
def test_bias_is_added_once_and_changes_nothing_else(name) -> None:
    plain, biased = (structure_of(name, LENGTH, SPEED, SHAFT, biased=b) for b in (False, True))
    names = [n for n in biased.parameters if not n.startswith("E_")]
    assert biased.parameters.count("E_north") == biased.parameters.count("E_east") == 1
    assert [n for n in plain.parameters if not n.startswith("E_")] == names
    rest = [biased.parameters.index(n) for n in names]
    old = [plain.parameters.index(n) for n in names]
    np.testing.assert_array_equal(biased.mean[rest], plain.mean[old])
    np.testing.assert_array_equal(biased.sd[rest], plain.sd[old])
    # whether the heading plays a part, which spares the prediction sines where it does not
    assert biased.terms.hull[1] == 1.0
    assert plain.terms.hull[1] == (1.0 if name == "mmg" else 0.0)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("differential", [False, True])
def test_prior_keeps_its_speed_and_course(name, differential) -> None:
    structure = structure_of(name, LENGTH, SPEED, SHAFT, differential=differential)
    assert (structure.sd > 0.0).all() and np.isfinite(structure.mean).all()
    # the nominal shaft speed in the structure's unit keeps about the nominal speed
    n = SHAFT * structure.n_unit
    terms = terms_of(structure, (SPEED, 0.0, 0.0), 0.0, CALM, (n, n, 0.0, 0.0))
    du, dv, dr = accelerations(terms, structure.terms, structure.mean, 0)
    # to 8 % of the speed, 15 % of the drag: half of what the thrust is uncertain by (study)
    assert abs(du) < 0.15 * 0.19 * SPEED**2 / LENGTH
    assert dv == dr == 0.0


@settings(max_examples=50, deadline=None)
@given(factor=st.floats(1.0, 8.0), seed=st.integers(0, 99))
def test_a_scaled_prior_finds_the_drag_of_a_catamaran(factor: float, seed: int) -> None:
    model = structure_of("mmg", 2.0, 1.0, 10.0, differential=True, current=True)
    rng = np.random.default_rng(seed)
    grows = np.array([name.startswith(("X_u", "X_n", "N_d", "N_|")) for name in model.parameters])
    own = model.mean + 0.5 * model.sd * rng.standard_normal(len(model))
    found, mean, sd = scaled_prior(
        model.parameters, model.mean, model.sd, np.where(grows, factor * own, own)
    )
    assert 0.3 * factor < found < 3.0 * factor
    assert (np.abs(np.where(grows, factor * own, own) - mean) < 4.0 * sd).all()
    still = [model.parameters.index(name) for name in ("X_vr", "Y_ur", "C_north", "N_0")]
    np.testing.assert_array_equal(mean[still], model.mean[still])
    np.testing.assert_array_equal(sd[still], model.sd[still])
    thrust = model.parameters.index("X_nn")
    assert mean[thrust] == pytest.approx(found * model.mean[thrust])


def test_a_scaled_prior_does_not_explain_thrust_of_the_wrong_sign() -> None:
    model = structure_of("mmg", 2.0, 1.0, 10.0, differential=True)
    wrong = np.where([name == "X_nn" for name in model.parameters], -9.0, 1.0) * model.mean
    mean, sd = scaled_prior(model.parameters, model.mean, model.sd, wrong)[1:]
    assert (np.abs(wrong - mean) > 4.0 * np.where(sd > 0.0, sd, np.inf)).any()


def test_a_line_of_the_table_is_a_new_term_that_a_twin_estimates(monkeypatch) -> None:
    line = Term("X_0", "m/s2", "X", ONE, (-1, 2, 0), 0.3, 0.3)
    plain = structure_of("mmg", LENGTH, SPEED, SHAFT)
    monkeypatch.setitem(TERMS, "mmg", (line, *TERMS["mmg"]))
    model, natural = structure_of("mmg", LENGTH, SPEED, SHAFT), SPEED**2 / LENGTH
    assert model.parameters == ("X_0", *plain.parameters)
    np.testing.assert_allclose((model.mean[0], model.sd[0]), 0.3 * natural)
    terms = terms_of(model, (4.0, -0.5, 0.2), 0.8, CALM, (5.0, 6.0, 0.1, 0.3))
    alone = accelerations(terms, model.terms, np.eye(len(model))[0], 0)
    np.testing.assert_allclose(alone, (1.0, 0.0, 0.0), rtol=1e-12)
    # no boat is pushed when nothing drives it: the estimate leaves the prior, and is surer
    vessel = Vessel.load("otter")
    log = simulate("zigzag", vessel=vessel, sea=SeaState(), duration=60.0, seed=0)
    twin = Twin(particulars_of(vessel), "ukf:model=mmg")
    twin.run(log)
    estimate, at = twin.predictor.estimate(), twin.predictor.parameter_names.index("X_0")
    before = twin.predictor.ukf.settings
    assert estimate.params_sd[at] < 0.9 * math.sqrt(before.xi0_cov[at, at])
    assert abs(estimate.params[at]) < before.xi0[at]
