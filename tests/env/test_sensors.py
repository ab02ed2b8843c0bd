"""Sensors: their statistics, what an accelerometer feels, latency, rates, losses."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from usv_gym import SeaState, SensorSuite, Vessel, sensors
from usv_gym.physics import frames as fr
from usv_gym.sensors import CHANNELS, FAULT_KINDS, Fault, FaultError, parse_faults
from usv_gym.simulation import Simulation

DT = 0.05
BOAT = Vessel.load("usv75")
N = BOAT.values["shaft_speed_manoeuvring"]
WITHOUT: np.ndarray = np.zeros((0, 3))
GPS_X, GPS_VX, COMPASS, GYRO, ACCEL_X, ACCEL_Y = 0, 2, 4, 5, 6, 7


def rows(suite: SensorSuite, count: int, seed: int = 0, dt: float = DT) -> np.ndarray:
    """Return what the sensors of a boat at rest at the origin say, first row at t = 0."""
    normals = np.random.default_rng(seed).standard_normal((count, sensors.NOISE_SIZE))
    packed, bias = suite.pack(dt), np.zeros(sensors.BIAS_SIZE)
    ring = np.zeros((suite.delay_steps(dt) + 1, 4))
    state, rate, z = np.zeros(fr.STATE_SIZE), np.zeros(fr.STATE_SIZE), np.zeros((count, 8))
    sensors.start_biases(packed, normals[0], bias)
    for k in range(count):
        step = dt if k else 0.0
        sensors.measure(state, rate, k * dt, k, step, packed, normals[k], WITHOUT, bias, ring, z[k])
    return z


def only(**values: float) -> SensorSuite:
    return dataclasses.replace(SensorSuite.perfect(), **values)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "channels"),
    [
        ("gps_white", (0, 1)),
        ("doppler_white", (2, 3)),
        ("compass_white", (4,)),
        ("gyro_white", (5,)),
        ("accel_white", (6, 7)),
    ],
)
def test_white_noise(name: str, channels: tuple[int, ...]) -> None:
    z = rows(only(**{name: 0.3}), 20_000)
    for j in range(len(CHANNELS)):
        if j not in channels:
            assert np.all(z[:, j] == 0.0)
            continue
        # 20 000 samples: sd to 0.5 %, mean to .7 % of sd, correlation to .7 %; four times that
        assert z[:, j].std() == pytest.approx(0.3, rel=0.02)
        assert abs(z[:, j].mean()) < 0.03 * 0.3
        assert abs(np.corrcoef(z[1:, j], z[:-1, j])[0, 1]) < 0.03
    if len(channels) == 2:
        assert abs(np.corrcoef(z[:, channels[0]], z[:, channels[1]])[0, 1]) < 0.03


@pytest.mark.parametrize(
    ("name", "channels"),
    [
        ("gps_bias", (0, 1)),
        ("compass_bias", (4,)),
        ("gyro_bias", (5,)),
        ("accel_bias", (6, 7)),
    ],
)
def test_gauss_markov_bias(name: str, channels: tuple[int, ...]) -> None:
    """The bias has its sd from the start, and forgets itself with its time constant."""
    tau, step = 10.0, 0.5
    suite = only(**{name: 0.3, f"{name}_time": tau})
    z = rows(suite, 60_000, dt=step)  # 3000 time constants
    for j in range(len(CHANNELS)):
        if j not in channels:
            assert np.all(z[:, j] == 0.0)
            continue
        # 3000 independent spans: sd to 1.3 %; three times that
        assert z[:, j].std() == pytest.approx(0.3, rel=0.04)
        lag = round(tau / step)
        # exp(-1) after one time constant; .02 is the spread of 3000 spans
        correlation = np.corrcoef(z[lag:, j], z[:-lag, j])[0, 1]
        assert correlation == pytest.approx(math.exp(-1.0), abs=0.06)
        # one step: exp(-dt/tau)
        one = np.corrcoef(z[1:, j], z[:-1, j])[0, 1]
        assert one == pytest.approx(math.exp(-step / tau), abs=0.01)
    starts = np.array([rows(suite, 1, seed=seed)[0, channels[0]] for seed in range(2000)])
    # 2000 starts: sd to 1.6 %; three times that
    assert starts.std() == pytest.approx(0.3, rel=0.05)


def test_a_perfect_suite_tells_the_truth() -> None:
    sim = Simulation(1, BOAT, SeaState.named("2"), suite=SensorSuite.perfect())
    sim.reset([0], [np.random.default_rng(0)])
    for _ in range(200):
        sim.step(np.array([[N, N, 0.2, 0.1]]))
        s, z = sim.state[0], sim.z[0]
        assert (z[0], z[1]) == (s[fr.X], s[fr.Y])
        np.testing.assert_allclose(z[2:4], fr.to_earth(s[fr.U], s[fr.V], s[fr.PSI]), rtol=1e-15)
        assert (z[COMPASS], z[GYRO]) == (s[fr.PSI], s[fr.R])


def test_accelerometer_in_a_steady_turn_on_a_circle() -> None:
    """Sailing a circle at constant u, v, r, it feels -v r ahead and u r to starboard."""
    u, v, r = 6.0, -1.0, 0.3
    state, z = np.zeros(fr.STATE_SIZE), np.zeros(8)
    state[[fr.U, fr.V, fr.R]] = u, v, r
    suite = SensorSuite.perfect()
    noise, bias = np.zeros(sensors.NOISE_SIZE), np.zeros(sensors.BIAS_SIZE)
    sensors.measure(
        state, np.zeros(16), 1.0, 20, DT, suite.pack(DT), noise, WITHOUT, bias, np.zeros((1, 4)), z
    )
    # centripetal: towards the centre, which is to starboard for r > 0 (physics.md 2.1)
    assert z[ACCEL_X] == pytest.approx(-v * r, rel=1e-15)
    assert z[ACCEL_Y] == pytest.approx(u * r, rel=1e-15)


def test_accelerometer_is_the_turned_derivative_of_the_ground_velocity() -> None:
    """u' - v r and v' + u r are the earth-fixed acceleration, seen from the boat."""
    dt = 0.01
    sim = Simulation(
        1, BOAT, SeaState.named("2"), suite=SensorSuite.perfect(), dt=dt, dt_physics=dt
    )
    sim.reset([0], [np.random.default_rng(0)])
    for k in range(600):
        before = sim.state[0].copy()
        sim.step(np.array([[1.2 * N, 0.9 * N, 0.3, 0.3]]))
        after = sim.state[0]
        velocity = [np.array(fr.to_earth(s[fr.U], s[fr.V], s[fr.PSI])) for s in (before, after)]
        middle = 0.5 * (before[fr.PSI] + after[fr.PSI])
        felt = fr.to_body(*((velocity[1] - velocity[0]) / dt), middle)
        # the mean over the step, to dt^2 / 12 times second derivatives below 10 m/s4
        np.testing.assert_allclose(sim.z[0, ACCEL_X:], felt, atol=1e-4, err_msg=f"step {k}")


def test_gps_is_late() -> None:
    suite = only(gps_latency=0.15)
    assert suite.delay_steps(DT) == 3
    sim = Simulation(1, BOAT, SeaState(), suite=suite)
    sim.reset([0], [np.random.default_rng(0)])
    truth = [sim.state[0].copy()]
    assert np.all(np.isnan(sim.z[0, :4]))  # no fix is old enough yet
    for k in range(1, 40):
        sim.step(np.array([[N, N, 0.3, 0.3]]))
        truth.append(sim.state[0].copy())
        if k < 3:
            assert np.all(np.isnan(sim.z[0, :4]))
            continue
        old = truth[k - 3]
        assert (sim.z[0, 0], sim.z[0, 1]) == (old[fr.X], old[fr.Y])
        np.testing.assert_allclose(
            sim.z[0, 2:4], fr.to_earth(old[fr.U], old[fr.V], old[fr.PSI]), rtol=1e-15
        )
        assert sim.z[0, COMPASS] == sim.state[0, fr.PSI]  # the others are not late


def test_rates() -> None:
    z = rows(only(gps_every=4, compass_every=2, imu_every=3, gps_latency=0.05), 100)
    k = np.arange(100)
    np.testing.assert_array_equal(np.isfinite(z[:, GPS_X]), (k >= 1) & ((k - 1) % 4 == 0))
    np.testing.assert_array_equal(np.isfinite(z[:, COMPASS]), k % 2 == 0)
    np.testing.assert_array_equal(np.isfinite(z[:, ACCEL_X]), k % 3 == 0)


@pytest.mark.parametrize(
    ("kind", "gone"),
    [("gps", range(4)), ("compass", [4]), ("imu", range(5, 8)), ("all", range(8))],
)
def test_a_loss_takes_away_what_it_names_and_no_more(kind: str, gone: range | list[int]) -> None:
    sim = Simulation(
        1, BOAT, SeaState(), suite=SensorSuite.perfect(), faults=[Fault(kind, 1.0, 0.5)]
    )
    sim.reset([0], [np.random.default_rng(0)])
    for _ in range(60):
        sim.step(np.array([[N, N, 0.0, 0.0]]))
        # from its start on, up to but not including its end
        lost = 1.0 - 1e-9 <= sim.t[0] < 1.5 - 1e-9
        expected = [lost and j in gone for j in range(8)]
        np.testing.assert_array_equal(np.isnan(sim.z[0]), expected)


def test_every_kind_of_loss_is_tested() -> None:
    assert set(FAULT_KINDS) == {"gps", "compass", "imu", "all"}


def test_parse_faults() -> None:
    assert parse_faults("none", 3.0) == ()
    assert parse_faults("gps10", 3.0) == (Fault("gps", 3.0, 10.0),)
    assert parse_faults("gps2.5+imu5", 1.0) == (Fault("gps", 1.0, 2.5), Fault("imu", 1.0, 5.0))


@pytest.mark.parametrize(
    "text", ["", "gps", "10", "GPS10", "gps-3", "gps10+", "none+gps1", "gps 1"]
)
def test_faults_that_are_not_understood(text: str) -> None:
    with pytest.raises(FaultError, match="write none, or a kind and seconds such as gps10") as e:
        parse_faults(text, 0.0)
    for kind in FAULT_KINDS:
        assert kind in str(e.value)


def test_unknown_kinds_and_impossible_times() -> None:
    with pytest.raises(FaultError, match="'radar'; use gps, imu, compass, all"):
        parse_faults("radar10", 0.0)
    for start, duration in ((0.0, 0.0), (0.0, -1.0), (math.nan, 1.0), (0.0, math.inf)):
        with pytest.raises(FaultError, match="gps fault: start and duration"):
            Fault("gps", start, duration)


@pytest.mark.parametrize(
    ("name", "value"),
    [("gps_white", -1.0), ("gps_white", math.nan), ("accel_bias_time", 0.0), ("imu_every", 0)],
)
def test_impossible_suites(name: str, value: float) -> None:
    with pytest.raises(FaultError, match=f"sensor {name} = "):
        SensorSuite(**{name: value})  # type: ignore[arg-type]
