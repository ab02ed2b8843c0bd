"""Motion of the twin's models: one step, points of the filter, the paper's numbers, prediction."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from twin.filters import ukf
from twin.model import augmented, dynamics, rollout
from twin.model.structure import MODELS, N_TERMS, Structure, accelerations
from twin.particulars import Particulars
from usv_kernel.scalar import actuate

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
PAPER = dynamics.model_of(BOAT, "paper")
XI = PAPER.mean
CALM, WINDY = np.zeros(2), np.array([-6.0, 8.0])

BOATS = pytest.mark.parametrize(
    ("name", "steering"), [(m, s) for m in MODELS for s in ("drives", "differential")]
)


def structure_for(name: str, steering: str = "drives", **size: float) -> Structure:
    """Return a structure with biases, of the study boat or one of another size."""
    times = size.get("length", STUDY["length"]) / STUDY["length"]  # type: ignore[operator]
    like = {"beam": times * 2.714, "draft": times * 0.526, "mass": times**3 * 3420.0}
    boat = Particulars(**{**STUDY, **like, **size}, steering=steering)  # type: ignore[arg-type]
    return dynamics.model_of(boat, name, biased=True)


def lively(structure: Structure) -> np.ndarray:
    """Return the prior, a little off so that no parameter is 0; biases at one sd."""
    part = np.where(np.char.startswith(structure.parameters, "E_"), 1.0, 0.2)
    return structure.mean + part * structure.sd


def derivative(
    s: np.ndarray,
    xi: np.ndarray,
    act: np.ndarray,
    structure: Structure = PAPER,
    wind: np.ndarray = CALM,
) -> np.ndarray:
    out = np.empty(6)
    s = np.ascontiguousarray(s)
    dynamics.derivative(s, xi, act, wind, structure.terms, np.empty(N_TERMS), out)
    return out


class Start(NamedTuple):
    """State and actuators at the start, lags of the actuators, and limits of the velocities."""

    s: tuple[float, ...] = (0.0, 0.0, 0.5, 5.0, 0.0, 0.0)
    act: tuple[float, ...] = (6.0, 6.0, 0.0, 0.0)
    lags: tuple[float, float, float] = (0.6, 0.1, 0.35)
    envelope: tuple[float, float, float] = (50.0, 50.0, 10.0)


UNDER_WAY, AT_REST = Start(), Start(s=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def forecast(
    xi: np.ndarray,
    plan: np.ndarray,
    dt: float = 0.1,
    start: Start = UNDER_WAY,
    structure: Structure = PAPER,
    wind: np.ndarray = CALM,
    waves: np.ndarray | None = None,
    gain: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Roll out; shaft speeds of ``plan`` and ``start.act`` are rev/s, those returned too."""
    unit = np.array([structure.n_unit, structure.n_unit, 1.0, 1.0])
    out, out_act = np.full((len(plan), 6), np.nan), np.full((len(plan), 4), np.nan)
    begin = rollout.RolloutStart(
        np.array([start.s]), xi[None].copy(), np.array(start.act) * unit, wind
    )
    config = rollout.RolloutConfig(np.array(start.lags), np.array(start.envelope), structure.terms)
    velocity = np.empty((1, 0, 3)) if waves is None else waves[None]
    rollout.rollout(
        begin,
        plan * unit,
        dt,
        config,
        rollout.Waves(velocity, gain),
        rollout.Paths(out[None], out_act),
        np.full(rollout.rollout_size(), np.nan),
    )
    return out, out_act / unit


def steering_plan(rows: int, n: float = 6.33, seed: int = 2) -> np.ndarray:
    """Return random commands, a new one every 2 s at 0.1 s a row."""
    rng = np.random.default_rng(seed)
    calls = rows // 20 + 1
    shafts = n * rng.uniform(0.3, 1.1, (calls, 2))
    angles = rng.uniform(-0.35, 0.35, (calls, 2))
    return np.ascontiguousarray(np.repeat(np.hstack([shafts, angles]), 20, axis=0)[:rows])


# One step


@BOATS
def test_derivative_turns_velocities_to_the_earth_and_adds_accelerations(
    name: str, steering: str
) -> None:
    structure, rng = structure_for(name, steering), np.random.default_rng(0)
    terms = np.empty(N_TERMS)
    for _ in range(20):
        psi, u, v, r = rng.normal(size=4)
        act = np.array([*rng.normal(size=2), *rng.uniform(-0.5, 0.5, 2)])
        xi = rng.normal(size=len(structure))
        s, out = np.array([3.0, -4.0, psi, u, v, r]), np.empty(6)
        dynamics.derivative(s, xi, act, WINDY, structure.terms, terms, out)
        c, n = math.cos(psi), math.sin(psi)
        np.testing.assert_allclose(out[:3], [u * c - v * n, u * n + v * c, r], rtol=1e-14)
        # the terms that it leaves are those of the accelerations (test_structure.py)
        assert tuple(out[3:]) == accelerations(terms, structure.terms, xi, 0)


@BOATS
def test_a_starboard_angle_turns_the_prior_boat_to_starboard(name: str, steering: str) -> None:
    structure = structure_for(name, steering)
    act = [6.0, 6.0, 0.2, 0.2] if steering == "drives" else [6.0, 3.0, 0.0, 0.0]
    out, _ = forecast(structure.mean, np.tile(np.array(act), (100, 1)), structure=structure)
    assert out[-1, 5] > 0.05 and out[-1, 2] > 0.5  # r and psi
    assert out[-1, 4] < 0.0  # slides to port, outwards


@BOATS
def test_step_is_one_euler_step(name: str, steering: str) -> None:
    structure = structure_for(name, steering)
    s, act = np.array([1.0, 2.0, 0.3, 4.0, 0.5, -0.1]), np.array([5.0, 6, 0.1, 0.2])
    xi, after = lively(structure), np.empty(6)
    dynamics.step(s, xi, act, WINDY, structure.terms, 0.05, np.empty(N_TERMS), after)
    np.testing.assert_array_equal(after, s + 0.05 * derivative(s, xi, act, structure, WINDY))


@BOATS
def test_points_go_where_single_steps_go_and_the_slope_is_the_derivative(
    name: str, steering: str
) -> None:
    structure, rng = structure_for(name, steering), np.random.default_rng(3)
    p, model, terms = len(structure), structure.terms, np.empty(N_TERMS)
    work = ukf.workspace(6, p)
    points = work.points[:, : 6 + p]
    points[:] = np.concatenate([[0.0, 0.0, 1.0, 5.0, 0.3, 0.1], lively(structure)])
    points += 0.1 * rng.normal(size=(13, 6 + p))
    points[4:, 2] = points[0, 2]
    before, act = points.copy(), np.array([5.0, 6.0, 0.1, -0.3])
    augmented.propagate_points(act, WINDY, model, 0.05, terms, work)
    after = np.empty(6)
    for row, point in zip(points, before, strict=True):
        dynamics.step(point[:6].copy(), point[6:].copy(), act, WINDY, model, 0.05, terms, after)
        np.testing.assert_allclose(row[:6], after, rtol=1e-14, atol=1e-15)
        np.testing.assert_array_equal(row[6:], point[6:])
    s, xi, moved = before[0, :6].copy(), before[0, 6:].copy(), rng.normal(size=p)
    slope = np.zeros((6, 6 + p))
    for row_of, (first, last) in enumerate(model.limits):
        slope[row_of, first:last] = work.slope[row_of, first:last]
    change = derivative(s, xi + moved, act, structure, WINDY)
    change -= derivative(s, xi, act, structure, WINDY)
    np.testing.assert_allclose(slope[:, 6:] @ moved, 0.05 * change, rtol=1e-9, atol=1e-12)


# The paper's identified models; the numbers are from separate code with the same equations. A
# positive angle is the same turn in the tables as here: no sign had to be changed.

RATED = 380.0 / 60.0
"""Shaft speed of the paper's runs, rev/s."""

# fmt: off
TABLE_2 = np.array([
    -0.01933487, -0.13319095, 0.47497131, 0.02046881, 0.00750947, 0.00750947, 0.14275839,
    -0.13801318, -0.10806983, -0.34930751, 0.17874066, 0.05575388, 0.58329755, 0.13710593,
    -0.07592142, -0.01698518, 0.03176391, -0.17702271, -0.04692461, 0.17730327, 0.07858179,
    0.11225423, 0.08986971, 0.00568659, 0.00568859,
])
"""Table 2 of Qu et al. 2025, from a 20 degree turn, it is unstable."""

TABLE_3 = np.array([
    -0.01520207, 0.87067625, 0.85951994, -0.09341181, 0.01141719, 0.01141719, -0.01204963,
    -0.07585661, -0.53618141, -0.32916798, 0.30233231, 0.13383581, 0.32354393, 0.01002316,
    0.00686091, -0.00045943, 0.04981479, -0.29850031, -0.06855151, -0.06284036, -0.09460934,
    0.14198421, 0.10663989, 0.00136872, 0.00107281,
])
"""Table 3, from a 20/-20 degree zigzag; it speeds up in turns."""
# fmt: on


def paper_run(xi: np.ndarray, angle: float, seconds: float) -> tuple[float, np.ndarray]:
    """Simulate an identified model of the paper from 5 m/s at 380 rpm; return end time and state.

    ``xi`` (25,) is as in :data:`TABLE_2`, the drive angle in rad. The run ends early at
    1000 m/s.
    """
    act, out, terms = np.array([RATED, RATED, angle, angle]), np.empty(6), np.empty(N_TERMS)

    def move(_: float, s: np.ndarray) -> np.ndarray:
        dynamics.derivative(np.ascontiguousarray(s), xi, act, CALM, PAPER.terms, terms, out)
        return out.copy()

    def fast(_: float, s: np.ndarray) -> float:
        return 1000.0 - float(np.hypot(s[3], s[4]))

    fast.terminal = True  # type: ignore[attr-defined]
    start = [0.0, 0.0, 0.0, 5.0, 0.0, 0.0]
    run = solve_ivp(move, (0.0, seconds), start, events=fast, rtol=1e-8, atol=1e-8)
    return float(run.t[-1]), run.y[:, -1]


@pytest.mark.parametrize(("table", "speed"), [(TABLE_2, 5.58), (TABLE_3, 7.76)])
def test_straight_speed_of_the_paper_models(table: np.ndarray, speed: float) -> None:
    act = np.array([RATED, RATED, 0.0, 0.0])
    first, last = PAPER.blocks["surge"]
    xi = np.zeros(25)
    xi[first:last] = table[first:last]
    u = 5.0
    for _ in range(2000):
        u += 0.05 * derivative(np.array([0.0, 0.0, 0.0, u, 0.0, 0.0]), xi, act)[3]
    assert u == pytest.approx(speed, rel=1e-3)


@pytest.mark.parametrize(("angle_deg", "escape"), [(20.0, 7.3), (0.0, 12.9)])
def test_table_2_escapes_to_infinity(angle_deg: float, escape: float) -> None:
    end, state = paper_run(TABLE_2, math.radians(angle_deg), 30.0)
    assert end == pytest.approx(escape, abs=0.2)
    assert np.hypot(state[3], state[4]) == pytest.approx(1000.0, rel=1e-3)


@pytest.mark.parametrize(
    ("angle_deg", "u", "r_degps"), [(20.0, 10.35, 4.26), (-20.0, 11.51, -2.23)]
)
def test_table_3_turns(angle_deg: float, u: float, r_degps: float) -> None:
    _, state = paper_run(TABLE_3, math.radians(angle_deg), 300.0)
    assert state[3] == pytest.approx(u, rel=0.01)
    assert math.degrees(state[5]) == pytest.approx(r_degps, rel=0.01)


# The prior


def test_prior_of_the_study_boat_equals_the_table() -> None:
    # Source: docs/explanation/twin.md, Identifiability.
    xi = dict(zip(PAPER.parameters, zip(XI, PAPER.sd, strict=True), strict=True))
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
    assert set(table) == set(PAPER.parameters)
    for name, expected in table.items():
        # the structure keeps four digits of the dimensionless numbers
        assert xi[name] == pytest.approx(expected, rel=5e-4), name


def test_prior_for_fixed_propellers() -> None:
    boat = Particulars(**{**STUDY, "shaft_speed": 80.0}, steering="differential")  # type: ignore[arg-type]
    fixed = dynamics.model_of(boat, "paper")
    unit = 5.4**2 / (6.336 * 80.0) ** 2
    np.testing.assert_allclose(fixed.mean[23:], 0.24 * unit)
    np.testing.assert_allclose(fixed.sd[23:], 0.14 * unit)
    assert (fixed.mean[13:15] == 0.0).all() and (fixed.sd[13:15] > 0.0).all()


@BOATS
@pytest.mark.parametrize(("length", "speed", "shaft"), [(0.9, 2.0, 30.0), (60.0, 5.4, 1.1)])
def test_prior_moves_boats_of_any_size_in_the_same_way(
    name: str, steering: str, length: float, speed: float, shaft: float
) -> None:
    plan = steering_plan(200, 1.0)
    tracks = []
    for size in ({}, {"length": length, "speed": speed, "shaft_speed": shaft}):
        structure = structure_for(name, steering, **size)
        long, fast, n = ({**STUDY, **size}[key] for key in ("length", "speed", "shaft_speed"))
        time = long / fast
        out, _ = forecast(
            lively(structure),
            plan * np.array([n, n, 1.0, 1.0]),
            0.1 * time,
            start=Start(
                s=(0.0, 0.0, 0.5, 0.9 * fast, 0.0, 0.0),
                act=(n, n, 0.0, 0.0),
                lags=(0.4 * time, 0.1 * time, 0.5 / time),
                envelope=(10.0 * fast, 10.0 * fast, 10.0 / time),
            ),
            structure=structure,
            wind=WINDY / 5.4 * fast,
        )
        tracks.append(out / np.array([long, long, 1.0, fast, fast, 1.0 / time]))
    assert np.ptp(tracks[0][:, 2]) > 0.1
    # steps of the integration: at most 0.25 s, whatever the boat's own time
    np.testing.assert_allclose(tracks[1], tracks[0], atol=1e-4)


# The prediction


def reference(
    structure: Structure, xi: np.ndarray, plan: np.ndarray, dt: float, wind: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return what :func:`forecast` should, by scipy's integration of ship and actuators."""
    lags = np.array([0.6, 0.6, 0.1, 0.1])
    rates = np.array([math.inf, math.inf, 0.35, 0.35])
    unit = np.array([structure.n_unit, structure.n_unit, 1.0, 1.0])
    state = np.array([0.0, 0.0, 0.5, 5.0, 0.0, 0.0, 6.0, 6.0, 0.0, 0.0])
    expected = np.empty((len(plan), 10))
    for k, command in enumerate(plan):

        def move(_: float, s: np.ndarray, command: np.ndarray = command) -> np.ndarray:
            speeds = [actuate(s[6 + i], command[i], lags[i], rates[i]) for i in range(4)]
            return np.concatenate([derivative(s[:6], xi, unit * s[6:], structure, wind), speeds])

        state = solve_ivp(move, (0.0, dt), state, rtol=1e-7, atol=1e-8).y[:, -1]
        expected[k] = state
    return expected[:, :6], expected[:, 6:]


@BOATS
@pytest.mark.parametrize(("dt", "atol"), [(0.05, 1e-4), (0.1, 1e-4), (0.25, 5e-4), (0.5, 2e-2)])
def test_rollout_equals_an_accurate_integration(
    name: str, steering: str, dt: float, atol: float
) -> None:
    structure = structure_for(name, steering)
    rows = round(10.0 / dt)
    plan = steering_plan(100)[(np.arange(rows) * dt / 0.1 + 1e-6).astype(int)]
    xi = lively(structure)
    states, acts = reference(structure, xi, plan, dt, WINDY)
    out, out_act = forecast(xi, plan, dt, structure=structure, wind=WINDY)
    # half a second is one step where the model is slow enough: 2 cm after 10 s of hard steering
    np.testing.assert_allclose(out, states, atol=atol)
    np.testing.assert_allclose(out_act, acts, atol=1e-5)


@pytest.mark.parametrize("steering", ["drives", "differential"])
@pytest.mark.parametrize("length", [0.8, 1.2, 2.0, 6.336])
@pytest.mark.parametrize("thrust", [1.0, 2.0])
def test_a_boat_that_gathers_speed_from_rest_is_followed(
    steering: str, length: float, thrust: float
) -> None:
    """A small boat is slow at rest and fast under way: half a second is then far too long."""
    speed, n = 2.0, 20.0 * thrust
    structure = structure_for("mmg", steering, length=length, speed=speed, shaft_speed=20.0)
    start = AT_REST._replace(
        act=(0.0,) * 4, lags=(0.2, 0.1, 0.35), envelope=(8.0, 8.0, 8.0 / length)
    )
    plan = np.tile([1.05 * n, n, 0.05, 0.05], (20, 1))
    coarse, _ = forecast(structure.mean, plan, 0.5, start, structure)
    fine, _ = forecast(structure.mean, plan.repeat(25, axis=0), 0.02, start, structure)
    fine = fine[24::25]
    assert abs(fine[-1, 3]) > 0.7 * speed * thrust
    np.testing.assert_allclose(coarse[:, 3:], fine[:, 3:], atol=0.05 * speed)
    np.testing.assert_allclose(coarse[:, :2], fine[:, :2], atol=0.3)
    np.testing.assert_allclose(coarse[:, 2], fine[:, 2], atol=0.05)


def test_waves_without_gain_carry_the_boat_along_and_do_nothing_else() -> None:
    still = np.zeros(25)
    waves = np.tile([0.3, -0.2, 0.0], (40, 1))
    waves[20:] = 0.0, 0.0, 0.1
    at = (1.0, 2.0, 0.5, 0.0, 0.0, 0.0)
    out, _ = forecast(still, np.zeros((40, 4)), start=Start(s=at), waves=waves)
    assert (out[:, 3:] == 0.0).all()
    c, n = math.cos(0.5), math.sin(0.5)
    moved = [1.0 + 2.0 * (0.3 * c + 0.2 * n), 2.0 + 2.0 * (0.3 * n - 0.2 * c), 0.5]
    np.testing.assert_allclose(out[19, :3], moved, rtol=1e-12)
    np.testing.assert_allclose(out[39, :3], [*moved[:2], 0.7], rtol=1e-12)
    # a boat under way keeps its velocities
    plan = steering_plan(40)
    np.testing.assert_array_equal(
        forecast(XI, plan, waves=waves)[0][:, 3:], forecast(XI, plan)[0][:, 3:]
    )


def test_velocities_take_on_waves_by_the_gain_within_the_envelope() -> None:
    for waves in np.tile([[0.3, -0.2, 0.0]], (40, 1)), np.tile([[0.0, 0.0, 0.02]], (40, 1)):
        out, _ = forecast(np.zeros(25), np.zeros((40, 4)), start=AT_REST, waves=waves, gain=0.5)
        np.testing.assert_allclose(out[-1, 3:], 0.5 * 4.0 * waves[0], rtol=1e-12)
    waves = np.tile([0.3e6, -0.2e6, 0.02e6], (40, 1))
    out, _ = forecast(np.zeros(25), np.zeros((40, 4)), start=AT_REST, waves=waves, gain=0.5)
    np.testing.assert_array_equal(np.abs(out[-1, 3:]), [50.0, 50.0, 10.0])


def test_velocity_over_ground_stays_while_a_wave_turns_the_boat() -> None:
    # no forces; the least of gains: u' = w v, v' = -w u / 2, for sway has twice the inertia
    rate, k = math.pi / 10.0, math.sqrt(rollout.SWAY_INERTIA_RATIO)
    waves = np.tile([0.0, 0.0, rate], (3000, 1))
    start = Start(s=(0.0, 0.0, 0.4, 3.0, -1.0, 0.0))
    out, _ = forecast(np.zeros(25), np.zeros((3000, 4)), start=start, waves=waves, gain=1e-12)
    angle = k * rate * 0.1 * np.arange(1, 3001)
    expected = np.column_stack(
        [
            3.0 * np.cos(angle) - 1.0 / k * np.sin(angle),
            -np.cos(angle) - 3.0 * k * np.sin(angle),
        ]
    )
    np.testing.assert_allclose(out[:100, 3:5], expected[:100], atol=0.05)
    # and never faster, however long it goes on
    assert np.hypot(out[:, 3], out[:, 4] / k).max() < 1.02 * np.hypot(3.0, 1.0 / k)
    # where waves only carry, u and v turn with the boat
    out, _ = forecast(np.zeros(25), np.zeros((3000, 4)), start=start, waves=waves)
    np.testing.assert_array_equal(out[-1, 3:], [3.0, -1.0, 0.0])


@BOATS
@pytest.mark.parametrize(
    ("scale", "seed"),
    [
        pytest.param(1.0, 0, id="paper's Table 2, or wild"),
        pytest.param(1e6, 0, id="absurd"),
        pytest.param(1e307, 1, id="overflowing"),
        pytest.param(math.nan, 0, id="not a number"),
    ],
)
def test_rollout_of_an_explosive_set_stays_in_the_envelope(
    name: str, steering: str, scale: float, seed: int
) -> None:
    boat = Particulars(**STUDY, steering=steering)  # type: ignore[arg-type]
    structure = dynamics.model_of(boat, name)
    xi = scale * np.random.default_rng(seed).normal(size=len(structure))
    if scale == 1.0 and (name, steering) == ("paper", "drives"):
        xi = TABLE_2
    plan = np.tile([RATED, RATED, 0.35, 0.35], (300, 1))
    start = Start(envelope=(12.0, 11.0, 1.5))
    out, out_act = forecast(xi, plan, start=start, structure=structure, wind=WINDY)
    assert np.isfinite(out).all() and np.isfinite(out_act).all()
    largest = np.abs(out[:, 3:]).max(axis=0)
    assert (largest <= [12.0, 11.0, 1.5]).all() and (largest == [12.0, 11.0, 1.5]).any()
    assert np.hypot(*np.diff(out[:, :2], axis=0).T).max() <= math.hypot(12.0, 11.0) * 0.1 + 1e-9
