"""The 25-parameter model: its formulas, the paper's numbers, the prior, the prediction."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from twin import model, ukf
from twin.particulars import Particulars
from twin.validation import RATED, paper_run
from usv_kernel import actuate

STUDY = {
    "name": "study boat",
    "length": 6.336,
    "beam": 2.714,
    "draft": 0.526,
    "mass": 3420.0,
    "speed": 5.4,
    "shaft_speed": 6.33,
}
BOAT = Particulars(**STUDY)  # type: ignore[arg-type]
XI, SD = model.hand_prior(BOAT)

LEFT_RIGHT = np.arange(25)
LEFT_RIGHT[[4, 5, 13, 14, 23, 24]] = [5, 4, 14, 13, 24, 23]

finite = st.floats(-20.0, 20.0)


def derivative(s: np.ndarray, xi: np.ndarray, act: np.ndarray, differential: float) -> np.ndarray:
    out = np.empty(6)
    model.derivative(np.ascontiguousarray(s), xi, act, differential, np.empty(25), out)
    return out


def roll_out(
    xi: np.ndarray,
    plan: np.ndarray,
    dt: float = 0.1,
    s_0: tuple[float, ...] = (0.0, 0.0, 0.5, 5.0, 0.0, 0.0),
    act_0: tuple[float, ...] = (6.0, 6.0, 0.0, 0.0),
    lags: tuple[float, float, float] = (0.6, 0.1, 0.35),
    envelope: tuple[float, float] = (50.0, 10.0),
    differential: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    out, out_act = np.full((len(plan), 6), np.nan), np.full((len(plan), 4), np.nan)
    model.roll_out(
        np.array(s_0),
        xi,
        np.array(act_0),
        plan,
        dt,
        *lags,
        *envelope,
        differential,
        out,
        out_act,
        np.empty(4),
    )
    return out, out_act


def steering_plan(rows: int, n: float = 6.33, seed: int = 2) -> np.ndarray:
    """Return random commands, a new one every 2 s at 0.1 s a row."""
    rng = np.random.default_rng(seed)
    calls = rows // 20 + 1
    shafts = n * rng.uniform(0.3, 1.1, (calls, 2))
    angles = rng.uniform(-0.35, 0.35, (calls, 2))
    return np.ascontiguousarray(np.repeat(np.hstack([shafts, angles]), 20, axis=0)[:rows])


# The formulas


@settings(max_examples=200, deadline=None)
@given(u=finite, v=finite, r=finite, n_l=finite, n_r=finite, d_l=finite, d_r=finite)
def test_accelerations_are_the_restored_equation(
    u: float, v: float, r: float, n_l: float, n_r: float, d_l: float, d_r: float
) -> None:
    # Source: Eq (20) as restored in physics.md section 10.
    xi = np.random.default_rng(0).normal(size=25)
    p = dict(zip(model.PARAMETER_NAMES, xi, strict=True))
    left, right = n_l * abs(n_l), n_r * abs(n_r)
    du = p["X_uu"] * u * abs(u) + p["X_vv"] * v**2 + p["X_vr"] * v * r + p["X_rr"] * r**2
    du += p["T_uL"] * left * math.cos(d_l) + p["T_uR"] * right * math.cos(d_r)
    dv = p["Y_u"] * u + p["Y_v"] * v + p["Y_r"] * r + p["Y_ur"] * u * r
    dv += p["Y_v|v|"] * v * abs(v) + p["Y_v|r|"] * v * abs(r) + p["Y_r|r|"] * r * abs(r)
    dv += p["T_vL"] * left * math.sin(d_l) + p["T_vR"] * right * math.sin(d_r)
    dr = p["N_u"] * u + p["N_v"] * v + p["N_r"] * r
    dr += p["N_v|v|"] * v * abs(v) + p["N_v|r|"] * v * abs(r) + p["N_r|r|"] * r * abs(r)
    dr += p["N_vvr"] * v**2 * r + p["N_vrr"] * v * r**2
    drives = p["T_rL"] * left * math.sin(d_l) + p["T_rR"] * right * math.sin(d_r)
    fixed = p["T_rL"] * left - p["T_rR"] * right
    psi = 0.7
    s, act = np.array([3.0, -4.0, psi, u, v, r]), np.array([n_l, n_r, d_l, d_r])
    for differential, thrust in ((0.0, drives), (1.0, fixed)):
        expected = [
            u * math.cos(psi) - v * math.sin(psi),
            u * math.sin(psi) + v * math.cos(psi),
            r,
            du,
            dv,
            dr + thrust,
        ]
        np.testing.assert_allclose(
            derivative(s, xi, act, differential), expected, rtol=1e-11, atol=1e-8
        )


@pytest.mark.parametrize("differential", [0.0, 1.0])
def test_regressors_mirror_port_and_starboard(differential: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        u, v, r = rng.normal(size=3)
        act = np.array([*rng.normal(size=2), *rng.uniform(-0.5, 0.5, 2)])
        mirrored = np.array([act[1], act[0], -act[3], -act[2]])
        phi, image = np.empty(25), np.empty(25)
        model.regressors(u, v, r, act, differential, phi)
        model.regressors(u, -v, -r, mirrored, differential, image)
        sign = np.where(np.arange(25) < model.X_END, 1.0, -1.0)
        sign[[6, 15]] = 1.0  # Y_u and N_u say how a boat is lopsided.
        np.testing.assert_array_equal(image, sign * phi[LEFT_RIGHT])


def test_a_starboard_angle_turns_the_prior_boat_to_starboard() -> None:
    for steering, act in (
        ("drives", [6.0, 6.0, 0.2, 0.2]),
        ("differential", [6.0, 3.0, 0.0, 0.0]),
    ):
        boat = Particulars(**STUDY, steering=steering)  # type: ignore[arg-type]
        out, _ = roll_out(
            model.hand_prior(boat)[0],
            np.tile(np.array(act), (100, 1)),
            differential=model.is_differential(boat),
        )
        assert out[-1, 5] > 0.05 and out[-1, 2] > 0.5  # r and psi
        assert out[-1, 4] < 0.0  # slides to port, outwards


def test_step_is_one_euler_step() -> None:
    s, act, after = np.array([1.0, 2.0, 0.3, 4.0, 0.5, -0.1]), np.array([5.0, 6, 0.1, 0.2]), None
    after = np.empty(6)
    model.step(s, XI, act, 0.0, 0.05, np.empty(25), after)
    np.testing.assert_array_equal(after, s + 0.05 * derivative(s, XI, act, 0.0))


@pytest.mark.parametrize("differential", [0.0, 1.0])
def test_points_go_where_single_steps_go_and_the_slope_is_the_derivative(
    differential: float,
) -> None:
    rng = np.random.default_rng(3)
    work = ukf.workspace(6, 25)
    points = work[ukf.POINTS, :, :31]
    points[:] = np.hstack([[0.0, 0.0, 1.0, 5.0, 0.3, 0.1], XI]) + 0.1 * rng.normal(size=(13, 31))
    points[4:, 2] = points[0, 2]
    before, act = points.copy(), np.array([5.0, 6.0, 0.1, -0.3])
    model.propagate_points(act, differential, 0.05, work)
    after = np.empty(6)
    for row, point in zip(points, before, strict=True):
        model.step(point[:6].copy(), point[6:].copy(), act, differential, 0.05, np.empty(25), after)
        np.testing.assert_allclose(row[:6], after, rtol=1e-14, atol=1e-15)
        np.testing.assert_array_equal(row[6:], point[6:])
    s, xi, moved = before[0, :6].copy(), before[0, 6:].copy(), rng.normal(size=25)
    slope = np.zeros((6, 31))
    for row_of, (first, last) in enumerate(model.LIMITS):
        slope[row_of, first:last] = work[ukf.SLOPE, row_of, first:last]
    change = derivative(s, xi + moved, act, differential) - derivative(s, xi, act, differential)
    np.testing.assert_allclose(slope[:, 6:] @ moved, 0.05 * change, rtol=1e-9, atol=1e-12)


# The paper's identified models; source of the numbers: physics.md sections 9 and 11. A
# positive angle is the same turn in the tables as here: no sign had to be changed.


@pytest.mark.parametrize(
    ("table", "speed"), [(model.PAPER_TABLE_2, 5.58), (model.PAPER_TABLE_3, 7.76)]
)
def test_straight_speed_of_the_paper_models(table: np.ndarray, speed: float) -> None:
    act = np.array([RATED, RATED, 0.0, 0.0])
    xi = np.where(np.arange(25) < model.X_END, table, 0.0)
    u = 5.0
    for _ in range(2000):
        u += 0.05 * derivative(np.array([0.0, 0.0, 0.0, u, 0.0, 0.0]), xi, act, 0.0)[3]
    assert u == pytest.approx(speed, rel=1e-3)


@pytest.mark.parametrize(("angle_deg", "escape"), [(20.0, 7.3), (0.0, 12.9)])
def test_table_2_escapes_to_infinity(angle_deg: float, escape: float) -> None:
    end, state = paper_run(model.PAPER_TABLE_2, math.radians(angle_deg), 30.0)
    assert end == pytest.approx(escape, abs=0.2)
    assert np.hypot(state[3], state[4]) == pytest.approx(1000.0, rel=1e-3)


@pytest.mark.parametrize(
    ("angle_deg", "u", "r_degps"), [(20.0, 10.35, 4.26), (-20.0, 11.51, -2.23)]
)
def test_table_3_turns(angle_deg: float, u: float, r_degps: float) -> None:
    _, state = paper_run(model.PAPER_TABLE_3, math.radians(angle_deg), 300.0)
    assert state[3] == pytest.approx(u, rel=0.01)
    assert math.degrees(state[5]) == pytest.approx(r_degps, rel=0.01)


# The prior


def test_prior_of_the_study_boat() -> None:
    # Source: twin.md section 13.
    xi = dict(zip(model.PARAMETER_NAMES, zip(XI, SD, strict=True), strict=True))
    table = {
        **{"X_uu": (-0.030, 0.010), "X_vv": (-0.024, 0.05), "X_vr": (1.29, 0.3)},
        **{"X_rr": (0.0, 0.2), "T_uL": (0.00935, 0.003), "T_uR": (0.00935, 0.003)},
        **{"Y_u": (0.0, 0.01), "Y_v": (-0.89, 0.45), "Y_r": (1.17, 0.8)},
        **{"Y_v|v|": (-0.17, 0.3), "Y_v|r|": (0.0, 1.0), "Y_r|r|": (0.0, 0.5)},
        **{"Y_ur": (-0.78, 0.2), "T_vL": (-0.012, 0.008), "T_vR": (-0.012, 0.008)},
        **{"N_u": (0.0, 0.005), "N_v": (-0.288, 0.3), "N_r": (-2.05, 1.0)},
        **{"N_v|v|": (0.0, 0.1), "N_v|r|": (0.0, 1.0), "N_r|r|": (-0.7, 1.0)},
        **{"N_vvr": (-0.2, 0.3), "N_vrr": (0.0, 0.5)},
        **{"T_rL": (0.011, 0.006), "T_rR": (0.011, 0.006)},
    }
    assert set(table) == set(model.PARAMETER_NAMES)
    for name, expected in table.items():
        assert xi[name] == pytest.approx(expected, rel=1e-12), name


def test_prior_for_fixed_propellers() -> None:
    boat = Particulars(**{**STUDY, "shaft_speed": 80.0}, steering="differential")  # type: ignore[arg-type]
    xi, sd = model.hand_prior(boat)
    unit = 5.4**2 / (6.336 * 80.0) ** 2
    np.testing.assert_allclose(xi[23:], 0.24 * unit)
    np.testing.assert_allclose(sd[23:], 0.14 * unit)
    assert (xi[13:15] == 0.0).all() and (sd[13:15] > 0.0).all()
    assert model.is_differential(boat) == 1.0 and model.is_differential(BOAT) == 0.0


@pytest.mark.parametrize("steering", ["drives", "differential"])
@pytest.mark.parametrize(("length", "speed", "shaft"), [(0.9, 2.0, 30.0), (60.0, 5.4, 1.1)])
def test_prior_moves_boats_of_any_size_alike(
    steering: str, length: float, speed: float, shaft: float
) -> None:
    plan = steering_plan(200, 1.0)
    tracks = []
    for size in ({}, {"length": length, "speed": speed, "shaft_speed": shaft}):
        boat = Particulars(**{**STUDY, **size}, steering=steering)  # type: ignore[arg-type]
        long, fast, n = boat.length, boat.speed, boat.shaft_speed
        time = long / fast
        mean, sd = model.hand_prior(boat)
        xi = mean + 0.2 * sd  # so that no parameter is 0
        out, _ = roll_out(
            xi,
            plan * np.array([n, n, 1.0, 1.0]),
            0.1 * time,
            s_0=(0.0, 0.0, 0.5, 0.9 * fast, 0.0, 0.0),
            act_0=(n, n, 0.0, 0.0),
            lags=(0.4 * time, 0.1 * time, 0.5 / time),
            envelope=(10.0 * fast, 10.0 / time),
            differential=model.is_differential(boat),
        )
        tracks.append(out / np.array([long, long, 1.0, fast, fast, 1.0 / time]))
    assert np.ptp(tracks[0][:, 2]) > 0.1
    np.testing.assert_allclose(tracks[1], tracks[0], atol=1e-4)


# The prediction


@pytest.mark.parametrize("steering", ["drives", "differential"])
@pytest.mark.parametrize("dt", [0.05, 0.1, 0.5])
def test_roll_out_equals_an_accurate_integration(steering: str, dt: float) -> None:
    boat = Particulars(**STUDY, steering=steering)  # type: ignore[arg-type]
    xi, differential = model.hand_prior(boat)[0], model.is_differential(boat)
    rows = round(10.0 / dt)
    plan = steering_plan(100)[(np.arange(rows) * dt / 0.1 + 1e-6).astype(int)]
    lags = np.array([0.6, 0.6, 0.1, 0.1])
    rates = np.array([math.inf, math.inf, 0.35, 0.35])
    state = np.array([0.0, 0.0, 0.5, 5.0, 0.0, 0.0, 6.0, 6.0, 0.0, 0.0])
    expected = np.empty((rows, 10))
    for k, command in enumerate(plan):

        def move(_: float, s: np.ndarray, command: np.ndarray = command) -> np.ndarray:
            speeds = [actuate(s[6 + i], command[i], lags[i], rates[i]) for i in range(4)]
            return np.concatenate([derivative(s[:6], xi, s[6:].copy(), differential), speeds])

        state = solve_ivp(move, (0.0, dt), state, rtol=1e-7, atol=1e-8).y[:, -1]
        expected[k] = state
    out, out_act = roll_out(xi, np.ascontiguousarray(plan), dt, differential=differential)
    # 0.5 s is cut into the longest steps there are, 0.25 s
    np.testing.assert_allclose(out, expected[:, :6], atol=1e-4 if dt < 0.25 else 5e-4)
    np.testing.assert_allclose(out_act, expected[:, 6:], atol=1e-5)


def test_roll_out_continues_where_it_ended() -> None:
    plan = steering_plan(60)
    whole, whole_act = roll_out(XI, plan)
    first, first_act = roll_out(XI, plan[:25].copy())
    second, second_act = roll_out(
        XI, plan[25:].copy(), s_0=tuple(first[-1]), act_0=tuple(first_act[-1])
    )
    np.testing.assert_array_equal(np.vstack([first, second]), whole)
    np.testing.assert_array_equal(np.vstack([first_act, second_act]), whole_act)


@pytest.mark.parametrize(
    "xi",
    [
        pytest.param(model.PAPER_TABLE_2, id="Table 2"),
        pytest.param(np.full(25, 0.1), id="the paper's start"),
        pytest.param(np.random.default_rng(0).normal(size=25) * 1e6, id="absurd"),
        pytest.param(np.random.default_rng(1).normal(size=25) * 1e307, id="overflowing"),
        pytest.param(np.full(25, math.nan), id="not a number"),
    ],
)
def test_roll_out_of_an_explosive_set_stays_in_the_envelope(xi: np.ndarray) -> None:
    plan = np.tile([RATED, RATED, 0.35, 0.35], (300, 1))
    out, out_act = roll_out(xi, plan, envelope=(12.0, 1.5))
    assert np.isfinite(out).all() and np.isfinite(out_act).all()
    assert np.abs(out[:, 3:5]).max() == 12.0 or np.abs(out[:, 5]).max() == 1.5
    assert np.abs(out[:, 3:5]).max() <= 12.0 and np.abs(out[:, 5]).max() <= 1.5
    assert np.abs(np.diff(out[:, :2], axis=0)).max() <= 12.0 * math.sqrt(2.0) * 0.1 + 1e-9


@settings(max_examples=50, deadline=None)
@given(
    value=st.floats(-2.0, 2.0),
    target=st.floats(-2.0, 2.0),
    lag=st.floats(0.01, 2.0),
    rate=st.one_of(st.floats(0.05, 5.0), st.just(math.inf)),
)
def test_follow_solves_the_actuator_law(
    value: float, target: float, lag: float, rate: float
) -> None:
    once, slow = value, value
    h, parts = 0.5, 5000
    for _ in range(parts):
        slow += h / parts * actuate(slow, target, lag, rate)
    for _ in range(7):
        once = model.follow(once, target, lag, rate, h / 7)
    assert once == pytest.approx(slow, abs=1e-3 + 0.01 * h / parts * abs(target - value) / lag)
    # one that is next to its target is taken as there
    close = 1e-12 + 2.0 * model.ARRIVED * abs(target)
    assert model.follow(value, target, lag, rate, h) == pytest.approx(once, abs=close)
    assert min(value, target) <= once <= max(value, target)
