"""Propulsion: the three kinds against closed forms, through every zero, and mirrored."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from usv_gym import Vessel
from usv_gym.physics import frames as fr
from usv_gym.physics import hull, propulsion

TANKER = Vessel.load("kvlcc2_l7")
OTTER = Vessel.load("otter")
V = TANKER.values
EVEN = {
    **{key: 0.5 for key in ("gamma_R_plus", "gamma_R_minus")},
    **{key: 1.3 for key in ("C_2_plus", "C_2_minus")},
}
TWIN_SCREW = dataclasses.replace(TANKER, values={**V, **EVEN, "units": 2.0, "y_P": 0.3})
KINDS = {
    "drives": Vessel.load("usv75"),
    "rudder": TANKER,
    "two rudders": TWIN_SCREW,
    "thrusters": OTTER,
}


def forces(
    boat: Vessel, u: float, v: float, r: float, n: tuple[float, float], d: tuple[float, float]
) -> np.ndarray:
    state = np.zeros(fr.STATE_SIZE)
    state[fr.N_LEFT :] = *n, *d
    return np.array(propulsion.propulsion_forces(u, v, r, state, boat.packed.copy()))


def as_printed(u: float, v: float, r: float, n: float, delta: float) -> np.ndarray:
    """Return X, Y, N as in docs/explanation/ship_and_sea.md, Propulsion."""
    L, D, rho = V["length_waterline"], V["propeller_diameter"], V["water_density"]
    U = math.hypot(u, v)
    beta, r_ = math.atan2(-v, u), r * L / U
    beta_P = beta - V["x_P_prime"] * r_
    C_2 = V["C_2_plus"] if beta_P > 0 else V["C_2_minus"]
    w = 1.0 - (1.0 - V["wake_fraction"]) * (1 + (1 - math.exp(-V["C_1"] * abs(beta_P))) * (C_2 - 1))
    J = u * (1 - w) / (n * D)
    K_T = V["k_0"] + V["k_1"] * J + V["k_2"] * J**2
    beta_R = beta - V["l_R_prime"] * r_
    v_R = U * (V["gamma_R_plus"] if beta_R > 0 else V["gamma_R_minus"]) * beta_R
    eta = D / V["rudder_height"]
    slip = 1 + V["kappa"] * (math.sqrt(1 + 8 * K_T / (math.pi * J**2)) - 1)
    u_R = V["epsilon"] * u * (1 - w) * math.sqrt(eta * slip**2 + 1 - eta)
    alpha_R = delta - math.atan2(v_R, u_R)
    F_N = 0.5 * rho * V["A_R"] * V["f_alpha"] * (u_R**2 + v_R**2) * math.sin(alpha_R)
    T = rho * n**2 * D**4 * K_T
    return np.array(
        [
            (1 - V["thrust_deduction"]) * T - (1 - V["t_R"]) * F_N * math.sin(delta),
            -(1 + V["a_H"]) * F_N * math.cos(delta),
            -(V["x_R_prime"] + V["a_H"] * V["x_H_prime"]) * L * F_N * math.cos(delta),
        ]
    )


@given(
    u=st.floats(0.3, 1.3),
    v=st.floats(-0.4, 0.4),
    r=st.floats(-0.15, 0.15),
    n=st.floats(9.0, 13.0),
    delta=st.floats(-0.6, 0.6),
)
@settings(max_examples=100, deadline=None)
def test_propeller_and_rudder_are_the_mmg_standard_method(
    u: float, v: float, r: float, n: float, delta: float
) -> None:
    got = forces(TANKER, u, v, r, (n, 0.0), (delta, 0.0))
    # rounding only: the same formulas with and without the quotient J
    np.testing.assert_allclose(got, as_printed(u, v, r, n, delta), rtol=1e-9, atol=1e-9)


def test_the_thrusters_of_the_otter_give_their_bollard_pull() -> None:
    """MSS otter.m: k n|n| each with n in rad/s, k .01108 ahead and .006445 astern."""
    for n, k in ((10.0, 0.02216 / 2), (-10.0, 0.01289 / 2)):
        want = 2.0 * k * (2.0 * math.pi * n) * abs(2.0 * math.pi * n)
        assert forces(OTTER, 0.0, 0.0, 0.0, (n, n), (0.0, 0.0))[0] == pytest.approx(want, rel=1e-3)
    y_P = OTTER.values["y_P"]
    X, Y, N = forces(OTTER, 0.0, 0.0, 0.0, (10.0, 0.0), (0.0, 0.0))
    assert Y == 0.0
    assert pytest.approx(y_P * X, rel=1e-12) == N  # the port thruster pushes the bow to starboard


def test_a_single_unit_ignores_the_other_command() -> None:
    one = forces(TANKER, 1.0, 0.1, 0.05, (10.0, 0.0), (0.2, 0.0))
    np.testing.assert_array_equal(one, forces(TANKER, 1.0, 0.1, 0.05, (10.0, 7.0), (0.2, -0.5)))


@pytest.mark.parametrize("kind", KINDS)
def test_thrust_is_continuous_through_zero(kind: str) -> None:
    """U = 0, J = 0, n = 0, beta_R = 0, beta_P = 0 and delta = 0 are no places to jump at."""
    ranges = range(5), (0.0, 5.0, -5.0), (0.0, 8.0, -8.0), (0.0, 0.05, -0.05)
    for column, u_0, n, r in itertools.product(*ranges):
        near = []
        for offset in (-1e-9, 0.0, 1e-9):
            values = np.array([u_0, 0.0, r, n, 0.0])
            values[column] += offset
            u, v, r_, n_, d = values
            near.append(forces(KINDS[kind], u, v, r_, (n_, n_), (d, d)))
        # slopes are below 1e4 N (N m) per m/s, rad/s, rev/s and rad
        assert np.max(np.abs(np.diff(near, axis=0))) < 1e-4, (column, u_0, n, r)


@pytest.mark.parametrize("boat", [TANKER, TWIN_SCREW])
def test_continuous_where_drift_at_rudder_and_propeller_changes_sides(boat: Vessel) -> None:
    for r in (0.05, -0.05):
        for prime in (V["l_R_prime"], V["x_P_prime"]):
            # beta = prime r': u = 1, v = -tan(beta)
            beta = prime * r * V["length_waterline"]
            v = -math.tan(beta)
            near = [forces(boat, 1.0, v + e, r, (10.0, 10.0), (0.1, 0.1)) for e in (-1e-9, 0, 1e-9)]
            assert np.max(np.abs(np.diff(near, axis=0))) < 1e-5


@pytest.mark.parametrize("kind", ["drives", "two rudders", "thrusters"])
@given(
    u=st.floats(-3, 10),
    v=st.floats(-2, 2),
    r=st.floats(-0.5, 0.5),
    n=st.tuples(st.floats(-15, 15), st.floats(-15, 15)),
    d=st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6)),
)
@settings(max_examples=60, deadline=None)
def test_port_mirrors_starboard(
    kind: str,
    u: float,
    v: float,
    r: float,
    n: tuple[float, float],
    d: tuple[float, float],
) -> None:
    boat = KINDS[kind]
    X, Y, N = forces(boat, u, v, r, n, d)
    mirror = forces(boat, u, -v, -r, n[::-1], (-d[1], -d[0]))
    scale = 1e-9 * (1.0 + abs(X) + abs(Y) + abs(N))
    np.testing.assert_allclose(mirror, [X, -Y, -N], rtol=1e-9, atol=scale)


@pytest.mark.parametrize("kind", ["rudder", "two rudders"])
def test_a_rudder_works_astern_and_at_rest(kind: str) -> None:
    boat = KINDS[kind]
    kick = forces(boat, 0.0, 0.0, 0.0, (10.0, 10.0), (0.3, 0.3))
    assert kick[2] > 0.0  # the jet turns a ship at rest to starboard
    back = forces(boat, -1.0, 0.0, 0.0, (0.0, 0.0), (0.3, 0.3))
    assert back[2] < 0.0  # going astern without jet the same helm turns the other way
    astern = forces(boat, 0.0, 0.0, 0.0, (-10.0, -10.0), (0.0, 0.0))
    assert astern[0] < 0.0


def test_resistance_follows_the_mmg_method_and_small_craft() -> None:
    U, p = 1.1, TANKER.packed.copy()
    q = 0.5 * V["water_density"] * V["length_waterline"] * V["draft"] * U**2
    assert hull.hull_forces(U, 0.0, 0.0, p)[0] == pytest.approx(-q * V["R_0"], rel=1e-12)
    assert hull.hull_forces(-U, 0.0, 0.0, p)[0] == pytest.approx(q * V["R_0"], rel=1e-12)
    # across u = 0 in drift
    near = [hull.hull_forces(u, 0.5, 0.0, p)[0] for u in (-1e-9, 0.0, 1e-9)]
    assert np.max(np.abs(np.diff(near))) < 1e-5
    boat = Vessel.load("telemetron")
    D_u, D_uu = boat.values["D_u"], boat.values["D_uu"]
    X, _, _ = hull.hull_forces(5.0, 0.0, 0.0, boat.packed.copy())
    assert pytest.approx(-(D_u * 5.0 + D_uu * 25.0), rel=1e-12) == X
