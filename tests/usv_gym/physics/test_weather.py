"""Weather: course, slow wind, and what they make of gusts and loads."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.usv_gym.world.seas import realise
from usv_gym import SeaState, Vessel
from usv_gym.physics import frames as fr
from usv_gym.physics import ship, waves
from usv_gym.physics import weather as wx

BOAT = Vessel.load("usv75")
P = BOAT.packed.copy()
NO_GUSTS = np.zeros((3, 0))

angles = st.floats(-math.pi, math.pi)


def on_course(*rows: tuple[float, float, float, float]) -> np.ndarray:
    """Return a weather by (time, wave gain, wind speed, wind from)."""
    weather = wx.constant()
    weather["changes"], weather["gust_wind"] = len(rows) - 1, max(row[2] for row in rows)
    for name, values in zip(
        ("keyframe_t", "wave_gain", "wind_speed", "wind_from"), np.transpose(rows), strict=True
    ):
        weather[name][: len(rows)] = values
    return weather


def wind_at(t: float, weather: np.ndarray, gusts: np.ndarray = NO_GUSTS) -> tuple[float, float]:
    """Return speed and where from, in [0, 2 pi)."""
    north, east = wx.air_velocity(t, gusts, weather)
    return math.hypot(north, east), math.atan2(-east, -north) % (2.0 * math.pi)


# ---------------------------------------------------------------- course


def test_a_course_is_held_outside_and_straight_inside() -> None:
    weather = on_course((100.0, 0.2, 4.0, 1.0), (200.0, 1.0, 8.0, 2.0), (400.0, 0.5, 6.0, 2.0))
    for t, gain, speed, come_from in (
        (0.0, 0.2, 4.0, 1.0),
        (100.0, 0.2, 4.0, 1.0),
        (125.0, 0.4, 5.0, 1.25),
        (200.0, 1.0, 8.0, 2.0),
        (300.0, 0.75, 7.0, 2.0),
        (400.0, 0.5, 6.0, 2.0),
        (1e6, 0.5, 6.0, 2.0),
    ):
        assert wx.wave_gain(t, weather) == pytest.approx(gain, rel=1e-12)
        assert wind_at(t, weather) == pytest.approx((speed, come_from), rel=1e-12)


def test_a_full_course_ends_within_itself() -> None:
    rows = [(10.0 * i, 0.1 * i, float(i), 0.1 * i) for i in range(wx.KEYFRAMES)]
    weather = on_course(*rows)
    assert wx.wave_gain(69.0, weather) == pytest.approx(0.69, rel=1e-12)
    assert wx.wave_gain(70.0, weather) == wx.wave_gain(1e9, weather) == rows[-1][1]


@given(start=angles, turn=st.floats(-3.0, 3.0), rounds=st.integers(-2, 2))
@settings(max_examples=100, deadline=None)
def test_the_wind_turns_the_short_way_round(start: float, turn: float, rounds: int) -> None:
    end = start + turn + 2.0 * math.pi * rounds
    weather = on_course((0.0, 1.0, 5.0, start), (10.0, 1.0, 5.0, end))
    for share in (0.0, 0.3, 0.7):
        _, come_from = wind_at(10.0 * share, weather)
        off = (come_from - start - share * turn + math.pi) % (2.0 * math.pi) - math.pi
        assert off == pytest.approx(0.0, abs=1e-12)


# ---------------------------------------------------------------- slow wind


def test_slow_wind_has_its_standard_deviation_and_time_constant() -> None:
    dt, steps, boats = 2.0, 2000, 40
    sd, tau = np.array([0.8, 0.2]), np.array([50.0, 120.0])
    normal = np.random.default_rng(3).standard_normal((boats, steps + 1, 2))
    states = np.zeros((boats, steps + 1, 2))
    for i in range(boats):
        weather = wx.constant(wind=8.0, wind_from=1.0)
        weather["speed_sd"], weather["speed_tau"] = sd[0], tau[0]
        weather["from_sd"], weather["from_tau"] = sd[1], tau[1]
        for k in range(steps + 1):
            wx.advance_slow_wind(weather, dt if k else math.inf, *normal[i, k])
            states[i, k] = weather["speed_drift"], weather["from_drift"]
    # N = boats * T / (2 tau) = 1600 and 667 independent values: the standard error of a
    # standard deviation is 1/sqrt(2 N) = 1.8 and 2.7 %; three of them
    np.testing.assert_allclose(np.std(states, axis=(0, 1)), sd, rtol=0.08)
    # the first value is one of them, not zero: 1/sqrt(2 * 40) = 11 %
    np.testing.assert_allclose(np.std(states[:, 0], axis=0), sd, rtol=0.33)
    # correlation over one time constant: exp(-1), standard error about 1/sqrt(N)
    for j, lag in enumerate((tau / dt).astype(int)):
        x = states[:, :, j]
        rho = np.mean(x[:, lag:] * x[:, :-lag]) / np.mean(x * x)
        assert rho == pytest.approx(math.exp(-1.0), abs=0.1)
    # speed and direction go their own ways
    assert abs(np.corrcoef(states[:, :, 0].ravel(), states[:, :, 1].ravel())[0, 1]) < 0.12


def test_slow_wind_turns_about_the_mean_wind() -> None:
    weather = wx.constant(wind=8.0, wind_from=1.0)
    weather["speed_drift"], weather["from_drift"] = -0.5, 0.25
    assert wind_at(0.0, weather) == pytest.approx((7.5, 1.25), rel=1e-12)
    # without noise it goes back to the mean, by 1/e in a time constant
    weather["speed_sd"], weather["speed_tau"] = 0.5, 60.0
    for _ in range(60):
        wx.advance_slow_wind(weather, 1.0, 0.0, 0.0)
    assert wind_at(0.0, weather)[0] == pytest.approx(8.0 - 0.5 * math.exp(-1.0), rel=1e-9)
    assert weather["from_drift"] == 0.25  # a standard deviation of zero leaves it alone


@given(mean=st.floats(0.0, 20.0), drift=st.floats(-40.0, 40.0))
@settings(max_examples=100, deadline=None)
def test_slow_wind_stays_within_the_mean_either_way(mean: float, drift: float) -> None:
    weather = wx.constant(wind=mean)
    weather["speed_drift"] = drift
    speed = wind_at(0.0, weather)[0]
    assert speed == pytest.approx(mean + min(max(drift, -mean), mean), abs=1e-12)
    if mean == 0.0:
        assert wx.air_velocity(0.0, NO_GUSTS, weather) == (0.0, 0.0)


# ---------------------------------------------------------------- loads


def accelerations(
    gain: float, first_order: bool = True, drift: bool = True, dof: int = 3
) -> np.ndarray:
    """Return the accelerations that waves alone give a boat at rest."""
    sea = realise(SeaState(hs=0.05, wave_to=0.7), 4)
    rows, weather = sea.waves.copy(), sea.weather.copy()
    weather["wave_gain"][0] = gain
    if not first_order:
        rows[[waves.PRESSURE, waves.BOTTOM]] = 0.0
    if not drift:
        weather["drift_table"] = 0.0
    state, out = np.zeros(fr.STATE_SIZE), np.zeros(fr.STATE_SIZE)
    factors = waves.factor_workspace(rows.shape[1])
    waves.box_factors(0.0, rows, P, 6, factors)
    share = wx.wave_gain(0.0, weather)
    around, air = (
        ship.Sea(rows, NO_GUSTS, weather, factors, ship.NO_LOADS),
        ship.Air(0.0, 0.0, share),
    )
    ship.derivative(state, np.zeros(4), ship.Ship(P, dof), around, air, 0.0, out)
    return out[[fr.U, fr.V, fr.W, fr.P, fr.Q, fr.R] if dof == 6 else [fr.U, fr.V, fr.R]]


def test_first_order_loads_go_with_the_gain_and_drift_with_its_square() -> None:
    first = {"drift": False}
    for kwargs, power in ((first, 1), ({**first, "dof": 6}, 1), ({"first_order": False}, 2)):
        full = accelerations(1.0, **kwargs)
        assert np.all(full != 0.0)
        # hull forces on the moving water have squares in them too, 1e-3 of the whole
        rtol = 2e-3 if power == 1 else 1e-12
        np.testing.assert_allclose(accelerations(0.4, **kwargs), 0.4**power * full, rtol=rtol)
    # zero waves give exactly zero load
    np.testing.assert_array_equal(accelerations(0.0, dof=6), 0.0)


def test_a_step_takes_the_gain_of_its_time() -> None:
    """Waves that grow from nothing move a boat as waves of the gain in that moment do."""
    sea = realise(SeaState(schedule=[(0.0, 0.0, 0.0), (100.0, 1.0, 0.0)]), 4)
    factors = waves.factor_workspace(sea.waves.shape[1])
    held = sea.weather.copy()
    held["changes"], held["wave_gain"][0] = 0.0, 0.25
    ends = []
    for weather in (sea.weather, held):
        state, work = np.zeros(fr.STATE_SIZE), np.zeros((ship.WORK_ROWS, fr.STATE_SIZE))
        around = ship.Sea(sea.waves, sea.gusts, weather, factors, ship.NO_LOADS)
        ship.step(state, np.zeros(4), ship.Ship(P, 6), around, 25.0, 0.05, work)
        ends.append(state)
    np.testing.assert_allclose(ends[0], ends[1], rtol=1e-12)
    assert np.all(ends[0][[fr.U, fr.V, fr.R]] != 0.0)
