"""Sensors: their statistics, what an IMU feels, places, rates, latency, faults."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.usv_gym.world.sample_rows import BOAT, DT, N, rows
from twin.sim.bridge import particulars_of
from usv_gym import SeaState, SensorSuite
from usv_gym.physics import GRAVITY
from usv_gym.physics import frames as fr
from usv_gym.world import sensors
from usv_gym.world.faults import (
    FaultError,
)
from usv_gym.world.sampling import is_due
from usv_gym.world.simulation import Simulation
from usv_gym.world.state import BOAT as BOAT_RECORD
from usv_kernel.channels import ACCEL_X, ACCEL_Y, COMPASS, GPS_X, GYRO, SENSOR_CHANNELS

MOTION = np.zeros(sensors.MOTION_NOISE_SIZE)

FORCE = [ACCEL_X, ACCEL_Y, len(SENSOR_CHANNELS) + 2]
"""Places of the three accelerometers ..."""

RATE = [len(SENSOR_CHANNELS), len(SENSOR_CHANNELS) + 1, GYRO]
"""... and of the three gyros."""


def sample(suite: SensorSuite, state: np.ndarray, rate: np.ndarray, dt: float = DT) -> np.ndarray:
    """Return one row of sensors without noise, with those of roll, pitch and heave."""
    boat = np.zeros(1, BOAT_RECORD)[0]
    boat["state"], boat["mean_rate"], boat["t"], boat["step"] = state, rate, 1.0, 20
    numbers, delay_line = np.zeros(sensors.NOISE_SIZE), np.zeros((1, sensors.DELAYED))
    sensors.measure(boat, dt, suite.pack(dt), numbers, MOTION, delay_line)
    return boat["measurement"][: sensors.WIND_AT].copy()


def only(**values: object) -> SensorSuite:
    return dataclasses.replace(SensorSuite.perfect(), **values)  # type: ignore[arg-type]


WHITE = {
    **{"gps_white": (0, 1), "doppler_white": (2, 3), "compass_white": (4,)},
    **{"gyro_white": (5, 8, 9), "accel_white": (6, 7, 10)},
    **{"ahrs_white": (11, 12), "height_white": (13,), "climb_white": (14,)},
}
GAUSS_MARKOV = {
    **{"gps_bias": (0, 1), "compass_bias": (4,), "gyro_bias": (5, 8, 9), "accel_bias": (6, 7, 10)},
    **{"ahrs_bias": (11, 12), "height_bias": (13,)},
}
BIASES = {**GAUSS_MARKOV, "climb_bias": (14,)}
"""Places of the channels that an error strikes; the bias of the climb stays as it is."""


def noise(count: int, dt: float = DT, seed: int = 0, **errors: float) -> np.ndarray:
    """Return what sensors (count, 15) of a level boat at rest show but gravity."""
    z = rows(only(**errors), count, seed, dt, dof=6)
    z[:, 10] += GRAVITY
    return z


@pytest.mark.parametrize(("name", "channels"), [*WHITE.items(), *BIASES.items()])
def test_each_error_strikes_its_channels_alone(name: str, channels: tuple[int, ...]) -> None:
    z = noise(50, **{name: 0.3})
    struck = np.isin(np.arange(z.shape[1]), channels)
    assert np.all(z[:, ~struck] == 0.0) and np.all(z[:, struck] != 0.0)


def test_white_noise_has_its_standard_deviation() -> None:
    """Each channel by numbers of its own, and each sample."""
    z = noise(20_000, **dict.fromkeys(WHITE, 0.3))
    # 20 000 samples: sd to 0.5 %, mean to .7 % of sd, correlation to .7 %; four times that
    assert z.std(axis=0) == pytest.approx(0.3, rel=0.02)
    assert np.abs(z.mean(axis=0)).max() < 0.03 * 0.3
    assert np.abs(np.corrcoef(z.T) - np.eye(z.shape[1])).max() < 0.03
    for column in z.T:
        assert abs(np.corrcoef(column[1:], column[:-1])[0, 1]) < 0.03


def test_gauss_markov_bias_has_its_size_and_time() -> None:
    """The bias has its sd from the start, and forgets itself with its time constant."""
    tau, step = 10.0, 0.5
    errors = dict.fromkeys(BIASES, 0.3) | {f"{name}_time": tau for name in GAUSS_MARKOV}
    z = noise(60_000, step, **errors)  # 3000 time constants
    lag = round(tau / step)
    for j in sum(GAUSS_MARKOV.values(), ()):
        # 3000 independent spans: sd to 1.3 %; three times that
        assert z[:, j].std() == pytest.approx(0.3, rel=0.04)
        # exp(-1) after one time constant; .02 is the spread of 3000 spans
        correlation = np.corrcoef(z[lag:, j], z[:-lag, j])[0, 1]
        assert correlation == pytest.approx(math.exp(-1.0), abs=0.06)
        # one step: exp(-dt/tau)
        one = np.corrcoef(z[1:, j], z[:-1, j])[0, 1]
        assert one == pytest.approx(math.exp(-step / tau), abs=0.01)
    starts = np.array([noise(1, seed=seed, **errors)[0] for seed in range(2000)])
    # 2000 starts: sd to 1.6 %; three times that
    assert starts[:, sum(BIASES.values(), ())].std(axis=0) == pytest.approx(0.3, rel=0.05)


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
        force = fr.to_body(*((velocity[1] - velocity[0]) / dt), middle)
        # the mean over the step, to dt^2 / 12 times second derivatives below 10 m/s4
        np.testing.assert_allclose(
            sim.z[0, ACCEL_X : ACCEL_Y + 1], force, atol=1e-4, err_msg=f"step {k}"
        )


@pytest.mark.parametrize("dof", [3, 6])
def test_each_sensor_has_a_latency_of_its_own(dof: int) -> None:
    """Late samples are those of a suite without latency, some steps later, to the bit."""
    late = {"gps": 4, "compass": 2, "imu": 1, "ahrs": 5}
    suite = only(**{f"{name}_latency": DT * steps for name, steps in late.items()})
    prompt = Simulation(1, BOAT, SeaState.named("3"), suite=only(gps_latency=0.0), dof=dof)
    delayed = Simulation(1, BOAT, SeaState.named("3"), suite=suite, dof=dof)
    rows = []
    for sim in (prompt, delayed):
        sim.reset([0], [np.random.default_rng(0)])
        z = [sim.z[0].copy()]
        for k in range(80):
            sim.step(np.array([[N, N, 0.3 * math.sin(0.1 * k), 0.1]]))
            z.append(sim.z[0].copy())
        rows.append(np.array(z))
    columns = {
        "gps": [*range(4), 13, 14],
        "compass": [4],
        "imu": [5, 6, 7, 8, 9, 10],
        "ahrs": [11, 12],
    }
    for name, steps in late.items():
        for j in columns[name]:
            np.testing.assert_array_equal(rows[1][steps:, j], rows[0][:-steps, j])
            assert np.isnan(rows[1][:steps, j]).all()
    assert np.isfinite(rows[1][10:, 11]).all() == (dof == 6)


@pytest.mark.parametrize("rate", [1.0, 3.0, 8.0, 20.0, 50.0])
def test_rates_are_kept(rate: float) -> None:
    """So many samples a second, as even as steps allow, and never two in a step."""
    z = rows(only(gps_rate=rate, compass_rate=rate, imu_rate=rate), 20 * 60)
    each = min(rate, 20.0)
    for j in range(len(SENSOR_CHANNELS)):
        at = np.flatnonzero(np.isfinite(z[:, j]))
        assert at[0] == 0
        assert len(at) == 60 * each
        assert set(np.diff(at)) <= {math.floor(20.0 / each), math.ceil(20.0 / each)}


def test_the_rate_does_not_depend_on_the_control_step() -> None:
    """0.01 s steps, 20 Hz: every fifth; a million steps later too."""
    suite = only(imu_rate=20.0)
    z = rows(suite, 500, dt=0.01)
    np.testing.assert_array_equal(np.isfinite(z[:, GYRO]), np.arange(500) % 5 == 0)
    share = suite.pack(0.01)["imu_share"]
    late = [is_due(1_000_000 + k, share) for k in range(50)]
    np.testing.assert_array_equal(late, np.arange(50) % 5 == 0)


# ------------------------------------------------- six degrees of freedom


def turn(phi: float, theta: float, psi: float) -> np.ndarray:
    """Return the matrix from body to earth, of the three elementary ones."""
    c, s = np.cos([phi, theta, psi]), np.sin([phi, theta, psi])
    about_x = np.array([[1, 0, 0], [0, c[0], -s[0]], [0, s[0], c[0]]])
    about_y = np.array([[c[1], 0, s[1]], [0, 1, 0], [-s[1], 0, c[1]]])
    about_z = np.array([[c[2], -s[2], 0], [s[2], c[2], 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


ANGLE = st.floats(-4.0, 4.0)
LENGTH = st.floats(-10.0, 10.0)


@settings(deadline=None)  # the first one compiles
@given(phi=ANGLE, theta=ANGLE, psi=ANGLE, a=LENGTH, b=LENGTH, c=LENGTH)
def test_rotation_and_back_is_the_identity(
    phi: float, theta: float, psi: float, a: float, b: float, c: float
) -> None:
    earth = fr.rotate(phi, theta, psi, a, b, c)
    # a dozen roundings of numbers up to 10
    np.testing.assert_allclose(earth, turn(phi, theta, psi) @ (a, b, c), atol=1e-13)
    np.testing.assert_allclose(fr.unrotate(phi, theta, psi, *earth), (a, b, c), atol=1e-13)
    assert fr.rotate(0.0, 0.0, psi, a, b, c) == (*fr.to_earth(a, b, psi), c)
    assert fr.unrotate(0.0, 0.0, psi, a, b, c) == (*fr.to_body(a, b, psi), c)


@pytest.mark.parametrize(
    ("phi", "theta", "force"),
    [
        # bow up by 30 degrees: half of g forward; starboard down by 30 degrees: half to port
        (0.0, 30.0, (0.5, 0.0, -0.86602540)),
        (30.0, 0.0, (0.0, -0.5, -0.86602540)),
        (-90.0, 0.0, (0.0, 1.0, 0.0)),
        # both: sin 30 and -cos 30 sin 45 = -.6124
        (45.0, 30.0, (0.5, -0.61237244, -0.61237244)),
    ],
)
def test_gravity_leaks_through_roll_and_pitch(
    phi: float, theta: float, force: tuple[float, float, float]
) -> None:
    state = np.zeros(fr.STATE_SIZE)
    state[fr.PHI], state[fr.THETA], state[fr.PSI] = math.radians(phi), math.radians(theta), 1.0
    z = sample(SensorSuite.perfect(), state, np.zeros(fr.STATE_SIZE))
    np.testing.assert_allclose(z[FORCE] / GRAVITY, force, atol=1e-8)  # eight digits are given
    assert (z[COMPASS], z[GYRO]) == (1.0, 0.0)  # the compass is tilt-compensated
    np.testing.assert_array_equal(z[-4:-2], state[[fr.PHI, fr.THETA]])  # and so is the AHRS


def test_an_imu_mounted_askew_measures_along_its_own_axes() -> None:
    """One turned by a quarter to starboard has its first axis there, and its second aft."""
    state, rate = ride(3.0), np.zeros(fr.STATE_SIZE)
    quarter = only(imu_mounting=(0.0, 0.0, 0.5 * math.pi))
    straight, askew = sample(only(), state, rate), sample(quarter, state, rate)
    for axes in (FORCE, RATE):
        x, y, z = straight[axes]
        np.testing.assert_allclose(askew[axes], (y, -x, z), atol=1e-12)
    other = sample(only(imu_mounting=(0.3, -0.2, 2.0)), state, rate)
    np.testing.assert_allclose(turn(0.3, -0.2, 2.0) @ other[FORCE], straight[FORCE], atol=1e-12)


def test_an_ahrs_has_its_rate_and_may_be_missing() -> None:
    z = rows(SensorSuite(ahrs_rate=5.0), 100, dof=6)
    assert np.isfinite(z[:, 11]).sum() == 25
    assert np.isnan(rows(SensorSuite(ahrs_rate=0.0), 100, dof=6)[:, 11:13]).all()


def test_height_and_climb_come_with_the_fix_and_as_late() -> None:
    sim = Simulation(1, BOAT, SeaState.named("3"), suite=only(gps_latency=0.2), dof=6)
    sim.reset([0], [np.random.default_rng(0)])
    down = [sim.state[0, fr.Z]]
    for _ in range(100):
        sim.step(np.array([[N, N, 0.2, 0.1]]))
        down.append(sim.state[0, fr.Z])
        assert np.isfinite(sim.z[0, 13]) == np.isfinite(sim.z[0, GPS_X])
    assert sim.z[0, 13] == down[-5]
    # and its speed is its derivative
    assert sim.z[0, 14] == pytest.approx((down[-4] - down[-6]) / (2.0 * DT), abs=0.05)


SIZE = np.array([3.0, 2.0, 0.4, 0.3, 0.2, 0.6])
"""A wild ride: m and rad, each about its own mean and at its own frequency."""
OMEGA = np.array([0.5, 0.7, 2.9, 3.1, 2.3, 0.9])
PHASE = np.array([0.1, 0.7, 1.3, 1.9, 2.5, 3.1])


def ride(t: float) -> np.ndarray:
    """Return the state at t of a boat on prescribed paths of all six degrees of freedom."""
    state = np.zeros(fr.STATE_SIZE)
    state[:6] = SIZE * np.sin(OMEGA * t + PHASE)
    state[fr.X] += 5.0 * t
    state[fr.PSI] += 0.2 * t
    rate = SIZE * OMEGA * np.cos(OMEGA * t + PHASE)
    rate[fr.X] += 5.0
    rate[fr.PSI] += 0.2
    phi, theta, psi = state[fr.PHI : fr.PSI + 1]
    state[fr.U : fr.W + 1] = turn(phi, theta, psi).T @ rate[:3]
    phi_dot, theta_dot, psi_dot = rate[3:]
    # the angular velocity from Euler's angles (Fossen 2021, Eq 2.39 inverted)
    state[fr.P] = phi_dot - psi_dot * math.sin(theta)
    state[fr.Q] = theta_dot * math.cos(phi) + psi_dot * math.cos(theta) * math.sin(phi)
    state[fr.R] = -theta_dot * math.sin(phi) + psi_dot * math.cos(theta) * math.cos(phi)
    return state


def place(t: float, arm: tuple[float, float, float]) -> np.ndarray:
    """Return where a point of the boat is, north, east and down."""
    state = ride(t)
    return np.asarray(state[:3] + turn(*state[fr.PHI : fr.PSI + 1]) @ arm)


@pytest.mark.parametrize("arm", [(0.0, 0.0, 0.0), (1.5, -0.4, -2.0), (-3.0, 0.8, 0.5)])
def test_the_imu_feels_the_second_derivative_of_its_place_less_gravity(
    arm: tuple[float, float, float],
) -> None:
    dt, h = 1e-3, 1e-3
    for t in np.linspace(0.0, 20.0, 41):
        state, before = ride(t), ride(t - dt)
        z = sample(only(imu_arm=arm), state, (state - before) / dt, dt)
        middle = t - 0.5 * dt
        moved = (place(middle + h, arm) - 2.0 * place(middle, arm) + place(middle - h, arm)) / h**2
        attitude = turn(*ride(middle)[fr.PHI : fr.PSI + 1])
        force = attitude.T @ (moved - (0.0, 0.0, GRAVITY))
        # h^2 / 12 of fourth and dt^2 / 24 of third derivatives, both below 200 here
        np.testing.assert_allclose(z[FORCE], force, atol=3e-5, err_msg=f"t = {t}")
        np.testing.assert_array_equal(z[RATE], state[fr.P : fr.R + 1])


@pytest.mark.parametrize("arm", [(0.0, 0.0, 0.0), (1.5, -0.4, -2.0)])
def test_the_antenna_is_where_it_sits_and_moves_as_it_does(
    arm: tuple[float, float, float],
) -> None:
    h = 1e-4
    for t in np.linspace(0.0, 20.0, 41):
        z = sample(only(gps_arm=arm), ride(t), np.zeros(fr.STATE_SIZE))
        np.testing.assert_allclose(z[:2], place(t, arm)[:2], atol=1e-12)
        velocity = (place(t + h, arm) - place(t - h, arm)) / (2.0 * h)
        # h^2 / 6 of third derivatives below 200
        np.testing.assert_allclose(z[2:4], velocity[:2], atol=4e-7)


def test_a_twin_hears_of_lever_arms() -> None:
    near = particulars_of(BOAT, SensorSuite()).instruments
    assert near == particulars_of(BOAT).instruments
    far = particulars_of(
        BOAT, SensorSuite(gps_arm=(3.0, 4.0, -12.0), imu_arm=(2.0, 0.0, 0.0))
    ).instruments
    assert far == dataclasses.replace(near, gps_arm=(3.0, 4.0, -12.0), imu_arm=(2.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("gps_white", -1.0), ("gps_white", math.nan), ("accel_bias_time", 0.0)),
        *(("imu_rate", 0.0), ("gps_rate", math.inf), ("gps_arm", (1.0, 2.0))),
        *(("imu_arm", (0.0, math.nan, 0.0)), ("ahrs_latency", 11.0), ("wind_height", 0.0)),
    ],
)
def test_impossible_suites_are_refused(name: str, value: object) -> None:
    with pytest.raises(FaultError, match=f"sensor {name} = "):
        SensorSuite(**{name: value})  # type: ignore[arg-type]
