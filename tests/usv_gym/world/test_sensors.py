"""Sensors: their statistics, what an IMU feels, places, rates, latency, faults."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from twin.sim.bridge import particulars_of
from twin.sim.wrapper import make_env
from usv_gym import Bursts, Fault, RandomFaults, SeaState, SensorSuite, Vessel
from usv_gym.envs.env import USVEnv
from usv_gym.physics import GRAVITY
from usv_gym.physics import frames as fr
from usv_gym.world import sensors
from usv_gym.world.channels import COMPASS_BIT, GPS_BIT, IMU_BIT
from usv_gym.world.faults import (
    EFFECTS,
    FAULT_KINDS,
    FAULT_NUMBERS,
    ON,
    SPIKE_SIZES,
    Disturbance,
    FaultError,
    apply_faults,
    fault_records,
    fault_sources,
    parse_faults,
)
from usv_gym.world.sensors import GRADES
from usv_gym.world.simulation import BLOCK_STEPS, Simulation
from usv_gym.world.state import BOAT as BOAT_RECORD
from usv_kernel.channels import SENSOR_CHANNELS

DT = 0.05
BOAT = Vessel.load("usv75")
N = BOAT.values["shaft_speed_manoeuvring"]
GPS_X, COMPASS, GYRO, ACCEL_X, ACCEL_Y = 0, 4, 5, 6, 7
BIT = np.array([GPS_BIT] * 4 + [COMPASS_BIT] + [IMU_BIT] * 3)


def rows(
    suite: SensorSuite,
    count: int,
    seed: int = 0,
    dt: float = DT,
    faults: Sequence[Disturbance] = (),
    state: np.ndarray | None = None,
) -> np.ndarray:
    """Return what the sensors of a boat that stays as it is say, first row at t = 0."""
    rng = np.random.default_rng(seed)
    normals = rng.standard_normal((count, sensors.NOISE_SIZE))
    draws = [s.random((count, FAULT_NUMBERS)) for s in fault_sources(faults, rng)]
    numbers, records = np.hstack([normals, *draws]), fault_records(faults, dt)
    packed, delay_line = suite.pack(dt), np.zeros((suite.delay_steps(dt) + 1, 4))
    boat, z = np.zeros(1, BOAT_RECORD)[0], np.zeros((count, 8))
    if state is not None:
        boat["state"] = state
    sensors.start_sensors(packed, numbers[0], boat["sensors"])
    for k in range(count):
        boat["t"], boat["step"] = k * dt, k
        sensors.measure(boat, dt if k else 0.0, packed, numbers[k], records, delay_line)
        z[k] = boat["measurement"]
    return z


def sample(suite: SensorSuite, state: np.ndarray, rate: np.ndarray, dt: float = DT) -> np.ndarray:
    """Return one row of sensors without noise."""
    boat = np.zeros(1, BOAT_RECORD)[0]
    boat["state"], boat["mean_rate"], boat["t"], boat["step"] = state, rate, 1.0, 20
    numbers, delay_line = np.zeros(sensors.NOISE_SIZE), np.zeros((1, 4))
    sensors.measure(boat, dt, suite.pack(dt), numbers, fault_records((), dt), delay_line)
    return boat["measurement"].copy()


def only(**values: object) -> SensorSuite:
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
    for j in range(len(SENSOR_CHANNELS)):
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
    for j in range(len(SENSOR_CHANNELS)):
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
    state = np.zeros(fr.STATE_SIZE)
    state[[fr.U, fr.V, fr.R]] = u, v, r
    z = sample(SensorSuite.perfect(), state, np.zeros(fr.STATE_SIZE))
    # centripetal: towards the centre, which is to starboard for r > 0
    # (docs/explanation/ship_and_sea.md, Frames and notation)
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
        force = fr.to_body(*((velocity[1] - velocity[0]) / dt), middle)
        # the mean over the step, to dt^2 / 12 times second derivatives below 10 m/s4
        np.testing.assert_allclose(sim.z[0, ACCEL_X:], force, atol=1e-4, err_msg=f"step {k}")


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


@pytest.mark.parametrize("rate", [1.0, 3.0, 8.0, 20.0, 50.0])
def test_rates(rate: float) -> None:
    """So many samples a second, as even as steps allow, and never two in a step."""
    z = rows(only(gps_rate=rate, compass_rate=rate, imu_rate=rate), 20 * 60)
    each = min(rate, 20.0)
    for j in range(len(SENSOR_CHANNELS)):
        at = np.flatnonzero(np.isfinite(z[:, j]))
        assert at[0] == 0
        assert len(at) == 60 * each
        assert set(np.diff(at)) <= {math.floor(20.0 / each), math.ceil(20.0 / each)}


def test_rates_are_each_sensors_own() -> None:
    """5 Hz late by a step, 10 Hz, and 8 Hz which alternates between 2 and 3 steps."""
    z = rows(only(gps_rate=5.0, compass_rate=10.0, imu_rate=8.0, gps_latency=0.05), 100)
    k = np.arange(100)
    np.testing.assert_array_equal(np.isfinite(z[:, GPS_X]), (k >= 1) & ((k - 1) % 4 == 0))
    np.testing.assert_array_equal(np.isfinite(z[:, COMPASS]), k % 2 == 0)
    np.testing.assert_array_equal(np.isfinite(z[:, ACCEL_X]), np.isin(k % 5, (0, 3)))


def test_the_rate_does_not_depend_on_the_control_step() -> None:
    """0.01 s steps, 20 Hz: every fifth; a million steps later too."""
    suite = only(imu_rate=20.0)
    z = rows(suite, 500, dt=0.01)
    np.testing.assert_array_equal(np.isfinite(z[:, GYRO]), np.arange(500) % 5 == 0)
    share = suite.pack(0.01)["imu_share"]
    late = [sensors._due(1_000_000 + k, share) for k in range(50)]
    np.testing.assert_array_equal(late, np.arange(50) % 5 == 0)


# ------------------------------------------------- grades


@pytest.mark.parametrize("grade", ["typical", "best"])
def test_statistics_of_a_grade(grade: str) -> None:
    """White part and bias of each channel, from its steps and from its spread."""
    suite, step, count = SensorSuite.grade(grade), 5.0, 60_000
    z = rows(suite, count, dt=step)
    parts = [
        *[(suite.gps_white, suite.gps_bias, suite.gps_bias_time)] * 2,
        *[(suite.doppler_white, 0.0, 1.0)] * 2,
        (suite.compass_white, suite.compass_bias, suite.compass_bias_time),
        (suite.gyro_white, suite.gyro_bias, suite.gyro_bias_time),
        *[(suite.accel_white, suite.accel_bias, suite.accel_bias_time)] * 2,
    ]
    for j, (white, bias, tau) in enumerate(parts):
        # 60 000 steps: their mean square to .6 %; three times that and a bit
        moved = white**2 + bias**2 * (1.0 - math.exp(-step / tau))
        assert 0.5 * np.mean(np.diff(z[:, j]) ** 2) == pytest.approx(moved, rel=0.03)
        # 750 or more time constants: variance to sqrt(2 / 750) = 5 % at worst; three times that
        assert z[:, j].var() == pytest.approx(white**2 + bias**2, rel=0.16)
        if bias > 0.0:
            lag = round(tau / step)
            share = bias**2 / (white**2 + bias**2) * math.exp(-lag * step / tau)
            # Bartlett: sd about sqrt(tau / T) = .037 at worst; three times that
            at_lag = np.corrcoef(z[lag:, j], z[:-lag, j])[0, 1]
            assert at_lag == pytest.approx(share, abs=0.11)


def test_grades_are_what_physics_md_says() -> None:
    """Section 8: a total of 1 to 2.5 m typically, .7 and .2 m at best, MTi-300 data sheet."""
    typical, best = SensorSuite.grade("typical"), SensorSuite.grade("best")
    assert typical == SensorSuite()
    assert 1.0 <= math.hypot(typical.gps_white, typical.gps_bias) <= 2.5
    assert (best.gps_bias, best.gps_white) == (0.7, 0.2)
    assert math.degrees(math.hypot(best.compass_bias, best.compass_white)) == pytest.approx(
        1.0, abs=0.01
    )
    assert math.degrees(best.gyro_white) == pytest.approx(0.045, abs=5e-4)
    assert math.degrees(best.gyro_bias) * 3600.0 == pytest.approx(10.0)
    assert best.accel_white == pytest.approx(60e-6 * 9.80665 * math.sqrt(20.0))
    assert SensorSuite.grade("perfect") == SensorSuite.perfect()
    for item in dataclasses.fields(SensorSuite):
        if item.name.endswith(("_white", "_bias")):
            assert getattr(best, item.name) <= getattr(typical, item.name)
            assert getattr(typical, item.name) <= getattr(SensorSuite.grade("consumer"), item.name)


def test_grades_that_do_not_exist() -> None:
    with pytest.raises(FaultError, match="'superb'; use best, consumer, typical, perfect or a"):
        SensorSuite.grade("superb")
    assert set(GRADES) == {"best", "consumer", "typical", "perfect"}


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
def test_rotation_and_back(
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
        (0.0, 30.0, (0.5, 0.0)),
        (30.0, 0.0, (0.0, -0.5)),
        (-90.0, 0.0, (0.0, 1.0)),
        # both: sin 30 and -cos 30 sin 45 = -.6124
        (45.0, 30.0, (0.5, -0.61237244)),
    ],
)
def test_gravity_leaks_through_roll_and_pitch(
    phi: float, theta: float, force: tuple[float, float]
) -> None:
    state = np.zeros(fr.STATE_SIZE)
    state[fr.PHI], state[fr.THETA], state[fr.PSI] = math.radians(phi), math.radians(theta), 1.0
    z = sample(SensorSuite.perfect(), state, np.zeros(fr.STATE_SIZE))
    np.testing.assert_allclose(z[ACCEL_X:] / GRAVITY, force, atol=1e-8)  # eight digits are given
    assert (z[COMPASS], z[GYRO]) == (1.0, 0.0)  # the compass is tilt-compensated


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
        np.testing.assert_allclose(z[ACCEL_X:], force[:2], atol=3e-5, err_msg=f"t = {t}")
        assert z[GYRO] == state[fr.R]


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
    assert far == dataclasses.replace(near, gps_arm=(3.0, 4.0), imu_arm=(2.0, 0.0))


# ------------------------------------------------- faults


def struck(fault: Disturbance, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return measurements without and with a fault, all sensors at each step."""
    suite = dataclasses.replace(SensorSuite(), gps_latency=0.0)
    return rows(suite, count, seed), rows(suite, count, seed, faults=[fault])


@pytest.mark.parametrize("kind", FAULT_KINDS)
@pytest.mark.parametrize("effect", EFFECTS)
def test_a_fault_strikes_its_sensors_in_its_time_and_nothing_else(kind: str, effect: str) -> None:
    """Afterwards each sample is what it had been: noise and biases went on."""
    clean, z = struck(Fault(kind, 2.0, 3.0, effect=effect, chance=1.0), 200)
    k = np.arange(200)
    inside = ((k >= 40) & (k < 100))[:, None] & ((FAULT_KINDS[kind] & BIT) != 0)
    np.testing.assert_array_equal(z[~inside], clean[~inside])
    if effect == "loss":
        assert np.all(np.isnan(z[inside]))
    elif effect == "frozen":
        np.testing.assert_array_equal(z[inside], np.broadcast_to(clean[39], z.shape)[inside])
    else:
        off = np.abs(z - clean)
        np.testing.assert_allclose(off[inside], np.broadcast_to(SPIKE_SIZES, z.shape)[inside])


def test_spikes_come_with_their_chance_and_either_sign() -> None:
    sizes = (30.0, 31.0, 3.0, 4.0, 1.0, 0.2, 6.0, 7.0)
    fault = Fault("all", 0.0, 1e4, effect="spikes", chance=0.2, sizes=sizes)
    clean, z = struck(fault, 20_000)
    off = z - clean
    hit = off[:, 0] != 0.0
    # binomial: sd .0028; three times that
    assert hit.mean() == pytest.approx(0.2, abs=0.009)
    for j, size in enumerate(sizes):
        np.testing.assert_allclose(np.abs(off[hit, j]), size, rtol=1e-9)
        assert np.all(off[~hit, j] == 0.0)
        # 4000 signs: mean to .016; four times that (36 numbers are looked at)
        assert abs(np.sign(off[hit, j]).mean()) < 0.064
        for i in range(j):
            assert abs(np.mean(np.sign(off[hit, i] * off[hit, j]))) < 0.064


def spans(gone: np.ndarray) -> np.ndarray:
    """Return the lengths of the whole runs of True between two False."""
    edges = np.diff(np.concatenate([[0], gone.astype(int), [0]]))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    inside = (first > 0) & (last < len(gone))
    return (last - first)[inside]


@pytest.mark.parametrize(("loss", "mean"), [(0.1, 2.0), (0.3, 0.5), (0.05, 0.1)])
def test_bursts_have_their_share_and_length(loss: float, mean: float) -> None:
    count = 400_000
    t, z = DT * np.arange(count), np.zeros((count, 8))
    out = apply_faults(t, z, [Bursts("gps", loss, mean)], np.random.default_rng(5))
    gone = np.isnan(out[:, 0])
    np.testing.assert_array_equal(np.isnan(out), gone[:, None] & (BIT == GPS_BIT))
    r = DT / mean
    p = r * loss / (1.0 - loss)
    # a two-state chain: memory 1 - p - r gives the share its spread; bursts are geometric
    memory = 1.0 - p - r
    sd = math.sqrt(loss * (1.0 - loss) * (1.0 + memory) / (1.0 - memory) / count)
    assert gone.mean() == pytest.approx(loss, abs=3.0 * sd)
    bursts = spans(gone)
    sd = math.sqrt((1.0 - r) / r**2 / len(bursts))
    assert bursts.mean() == pytest.approx(1.0 / r, abs=3.0 * sd)


def test_random_faults_keep_their_gaps_and_lengths() -> None:
    count = 400_000
    t, z = DT * np.arange(count), np.zeros((count, 8))
    fault = RandomFaults("imu", gap=(2.0, 6.0), duration=(1.0, 3.0), start=10.0)
    out = apply_faults(t, z, [fault], np.random.default_rng(6))
    gone = np.isnan(out[:, GYRO])
    np.testing.assert_array_equal(np.isnan(out), gone[:, None] & (BIT == IMU_BIT))
    assert not gone[: round(12.0 / DT)].any()
    for value, (low, high) in ((spans(gone), fault.duration), (spans(~gone), fault.gap)):
        seconds = DT * value
        # whole steps: a step either way
        assert seconds.min() >= low - 1.01 * DT
        assert seconds.max() <= high + 1.01 * DT
        # uniform, 3300 of them: mean to (high - low) / sqrt(12 n); three times that, and a step
        spread = (high - low) / math.sqrt(12.0 * len(value))
        assert seconds.mean() == pytest.approx(0.5 * (low + high), abs=3.0 * spread + DT)
        assert seconds.std() == pytest.approx((high - low) / math.sqrt(12.0), rel=0.05)
    # what is drawn at one time is drawn apart: .017 is the spread of 3300 pairs
    gaps, lengths = spans(~gone), spans(gone)[1:]
    some = min(len(gaps), len(lengths))
    assert abs(np.corrcoef(gaps[:some], lengths[:some])[0, 1]) < 0.07


def test_a_frozen_sensor_keeps_its_rate_and_a_loss_hides_it() -> None:
    faults = [Fault("imu", 1.0, 2.0, effect="frozen"), Fault("imu", 2.0, 0.5)]
    suite = dataclasses.replace(SensorSuite(), imu_rate=8.0)
    clean, z = rows(suite, 100), rows(suite, 100, faults=faults)
    k = np.arange(100)
    gone = (k >= 40) & (k < 50)
    np.testing.assert_array_equal(np.isfinite(z[:, GYRO]), np.isfinite(clean[:, GYRO]) & ~gone)
    last = clean[:20][np.isfinite(clean[:20, GYRO])][-1]
    held = np.isfinite(z[:, GYRO]) & (k >= 20) & (k < 60)
    assert held.sum() == 12  # 16 in two seconds, 4 of them lost
    np.testing.assert_array_equal(z[held, GYRO:], np.tile(last[GYRO:], (12, 1)))


def test_a_sensor_frozen_from_the_start_says_nothing() -> None:
    """It has no last sample to repeat."""
    z = rows(SensorSuite(), 20, faults=[Fault("all", 0.0, 0.5, effect="frozen")])
    assert np.all(np.isnan(z[:10]))
    assert np.all(np.isfinite(z[10:]))


def test_recorded_measurements_with_faults() -> None:
    """Columns that are not these sensors' are kept, and so is what is given."""
    rng = np.random.default_rng(0)
    z, t = rng.normal(size=(200, 10)), 100.0 + 0.1 * np.arange(200)
    given = z.copy()
    faults = [Fault("gps", 5.0, 2.0), Fault("compass", 10.0, 1.0, effect="frozen")]
    out = apply_faults(t, z, faults, rng)
    np.testing.assert_array_equal(z, given)
    expected = z.copy()
    expected[50:70, :4] = math.nan
    expected[100:110, 4] = z[99, 4]
    np.testing.assert_array_equal(out, expected)
    np.testing.assert_array_equal(apply_faults(t, z, [], rng), z)


# ------------------------------------------------- faults in a simulation

STEPS = 2 * BLOCK_STEPS[0] + 50


def sailed(faults: Sequence[Disturbance], seed: int = 3, steps: int = STEPS) -> np.ndarray:
    """Return the measurements of a boat in sea state 2."""
    sim = Simulation(1, BOAT, SeaState.named("2"), faults=faults)
    z = np.empty((steps + 1, 8))
    sim.reset([0], [np.random.default_rng(seed)])
    for k in range(steps + 1):
        if k:
            sim.step(np.array([[N, N, 0.2, 0.2]]))
        z[k] = sim.z[0]
    return z


QUICK = tuple(
    dataclasses.replace(fault, gap=(1.0, 4.0), duration=(0.5, 2.0))
    if isinstance(fault, RandomFaults)
    else fault
    for fault in ON
)
"""All faults at once, so often that a minute has plenty of each."""


def test_all_faults_at_once_are_the_same_with_the_same_seed() -> None:
    one, two, other = sailed(QUICK), sailed(QUICK), sailed(QUICK, seed=4)
    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(np.isnan(one), np.isnan(other))


def test_each_of_many_faulty_boats_is_a_boat_alone() -> None:
    many = Simulation(2, BOAT, SeaState.named("2"), faults=QUICK)
    for _ in range(2):  # a reset forgets bursts, windows and frozen samples
        many.reset([0, 1], [np.random.default_rng(3), np.random.default_rng(4)])
        z = [many.z.copy()]
        for _ in range(400):
            many.step(np.full((2, 4), [N, N, 0.2, 0.2]))
            z.append(many.z.copy())
        both = np.stack(z, axis=1)
        for i, seed in enumerate((3, 4)):
            np.testing.assert_array_equal(both[i], sailed(QUICK, seed, 400))


@pytest.mark.parametrize("when", [Bursts, RandomFaults, Fault])
@pytest.mark.parametrize("kind", ["gps", "compass", "imu"])
def test_a_fault_leaves_the_other_sensors_as_they_were(kind: str, when: type[Disturbance]) -> None:
    extra = when(kind, 5.0, 20.0) if when is Fault else when(kind)  # type: ignore[call-arg]
    others = tuple(fault for fault in QUICK if FAULT_KINDS[fault.kind] & FAULT_KINDS[kind] == 0)
    struck, z = sailed((extra, *others)), sailed(others)
    mine = (FAULT_KINDS[kind] & BIT) != 0
    # the same noise, and the same bursts, spikes and windows of the other faults
    np.testing.assert_array_equal(struck[:, ~mine], z[:, ~mine])
    kept = np.isfinite(struck)
    np.testing.assert_array_equal(struck[kept], z[kept])
    assert np.isnan(struck[40:, mine]).any()
    assert np.isfinite(z[40:, mine]).all()


def test_two_equal_faults_do_not_strike_together() -> None:
    one = np.isnan(sailed((Bursts("gps"),)))
    two = np.isnan(sailed((Bursts("gps"), Bursts("gps"))))
    assert np.all(two[one])
    assert two.sum() > one.sum()


@pytest.mark.parametrize(("twin", "dof"), [(None, 3), ("ukf", 3), ("ukf", 6)])
def test_observations_stay_finite_through_everything(twin: str | None, dof: int) -> None:
    env = make_env(twin=twin, dof=dof, sea="6", task="free", faults=QUICK)
    for seed in range(2):
        obs, _ = env.reset(seed=seed)
        for k in range(1200):
            assert env.observation_space.contains(obs), f"step {k}"
            action = np.array([0.5, math.sin(0.05 * k)], np.float32)
            obs, reward, terminated, *_ = env.step(action)
            assert math.isfinite(reward)
            if terminated:  # capsized
                break


@pytest.mark.parametrize(
    "faults", ["none", "on", "gps10@3+imu-spikes20", "all-frozen-random", "gps-bursts20x1"]
)
def test_the_environment_takes_a_text(faults: str) -> None:
    env = USVEnv(faults=faults, suite="best", task="free")
    assert env.simulation.suite == SensorSuite.grade("best")
    obs, _ = env.reset(seed=0)
    again, _ = env.reset(seed=0)
    np.testing.assert_array_equal(obs, again)
    valid = []
    for _ in range(200):
        obs, *_ = env.step(np.array([0.5, 0.0], np.float32))
        assert env.observation_space.contains(obs)
        valid.append(obs[7])
    if faults.startswith("gps10@3"):  # from 3 s on, whatever is drawn
        assert valid[3:59] == [1.0] * 56
        assert not any(valid[60:])


# ------------------------------------------------- texts


def test_parse_faults() -> None:
    assert parse_faults("none", 3.0) == ()
    assert parse_faults("on", 3.0) == ON
    assert parse_faults("gps10", 3.0) == (Fault("gps", 3.0, 10.0),)
    assert parse_faults("gps2.5+imu5", 1.0) == (Fault("gps", 1.0, 2.5), Fault("imu", 1.0, 5.0))
    assert parse_faults("gps10@30", 3.0) == (Fault("gps", 30.0, 10.0),)
    assert parse_faults("gps-frozen5@0", 3.0) == (Fault("gps", 0.0, 5.0, effect="frozen"),)
    assert parse_faults("imu-spikes20", 3.0) == (Fault("imu", 3.0, 20.0, effect="spikes"),)
    assert parse_faults("gps-bursts", 3.0) == (Bursts("gps"),)
    assert parse_faults("gps-bursts5x0.5@60", 3.0) == (Bursts("gps", 0.05, 0.5, 60.0),)
    assert parse_faults("all-random+compass-spikes-random@9", 3.0) == (
        RandomFaults("all"),
        RandomFaults("compass", effect="spikes", start=9.0),
    )
    assert parse_faults("imu-frozen-bursts", 3.0) == (Bursts("imu", effect="frozen"),)


def test_on_is_every_effect_on_every_sensor() -> None:
    bits = (GPS_BIT, COMPASS_BIT, IMU_BIT)
    struck = {(b, fault.effect) for fault in ON for b in bits if FAULT_KINDS[fault.kind] & b}
    assert struck == {(b, effect) for b in bits for effect in EFFECTS}
    assert {type(fault) for fault in ON} == {Bursts, RandomFaults}


@pytest.mark.parametrize(
    "text",
    [
        *("", "gps", "10", "GPS10", "gps-3", "gps10+", "none+gps1", "on+gps1", "gps 1", "gps10@"),
        *("gps-stuck5", "gps-frozen", "gps-bursts10", "gps-bursts10%2", "gps-random5", "gps@3"),
        *("gps10@-1", "gps1e3", "gps\u0663"),
    ],
)
def test_faults_that_are_not_understood(text: str) -> None:
    with pytest.raises(
        FaultError, match="write none; on for all of them; or a kind and seconds"
    ) as e:
        parse_faults(text, 0.0)
    for word in (repr(text), *FAULT_KINDS, *EFFECTS):
        assert word in str(e.value)


KINDS = st.sampled_from([*FAULT_KINDS, "radar", ""])
DOES = st.sampled_from(["", *(f"-{effect}" for effect in EFFECTS), "-stuck"])
NUMBERS = st.sampled_from(["0", "5", "2.5", "1e3", "-1", "", "100", "9" * 400])
WHEN = st.one_of(
    NUMBERS,
    st.sampled_from(["-random", "-bursts"]),
    st.builds("-bursts{}x{}".format, NUMBERS, NUMBERS),
)
AT = st.one_of(st.just(""), NUMBERS.map("@{}".format))
PARTS = st.tuples(KINDS, DOES, WHEN, AT).map("".join)
TEXTS = st.one_of(
    st.lists(PARTS, min_size=1, max_size=3).map("+".join),
    st.text(max_size=20),
    st.text("gpsimuall-0123456789.@+x%", max_size=20),
)


@settings(deadline=None)  # the first one compiles
@given(text=TEXTS)
@example("gps-bursts99x0.01")
@example("gps-bursts100x1")
@example("imu-bursts5x0")
@example("gps" + "9" * 400)
def test_any_text_is_faults_or_a_clear_error(text: str) -> None:
    try:
        faults = parse_faults(text, 10.0)
        packed = fault_records(faults, DT)
    except FaultError as error:
        words = ("use ", "must ", "write ", "make them longer")
        clear = any(word in str(error) for word in words)
    else:
        clear = True
        assert packed.shape == (len(faults),)
        assert np.all(np.isfinite(packed.view(float)))
        assert not np.any(np.isinf(rows(SensorSuite(), 300, faults=faults)))
    assert clear


def test_unknown_kinds_and_impossible_faults() -> None:
    with pytest.raises(FaultError, match=r"'radar10': no .* 'radar'; use gps, imu, compass, all"):
        parse_faults("radar10", 0.0)
    for start, duration in ((0.0, 0.0), (0.0, -1.0), (math.nan, 1.0), (0.0, math.inf)):
        with pytest.raises(FaultError, match="gps fault: start and duration"):
            Fault("gps", start, duration)
    with pytest.raises(FaultError, match="no effect 'stuck'; use loss, frozen, spikes"):
        Fault("gps", 0.0, 1.0, effect="stuck")
    with pytest.raises(FaultError, match=r"chance of a spike must lie in \[0, 1\], got 1.5"):
        Fault("gps", 0.0, 1.0, effect="spikes", chance=1.5)
    with pytest.raises(FaultError, match="sizes must be 8 finite numbers"):
        Fault("gps", 0.0, 1.0, effect="spikes", sizes=(1.0, 2.0))
    for loss in (0.0, 1.0, math.nan):
        with pytest.raises(FaultError, match="gps bursts: the loss must be a share"):
            Bursts("gps", loss)
    for mean in (0.0, math.inf):
        with pytest.raises(FaultError, match="gps bursts: the mean length must"):
            Bursts("gps", 0.1, mean)
    for gap in ((0.0, 1.0), (2.0, 1.0), (1.0, math.inf), (1.0, math.nan)):
        with pytest.raises(FaultError, match="imu fault: gap must be the shortest"):
            RandomFaults("imu", gap=gap)
    for kind in (Bursts, RandomFaults):
        with pytest.raises(FaultError, match="imu fault: the start must be finite, got nan"):
            kind("imu", start=math.nan)


def test_bursts_that_do_not_fit_the_control_step_die_early() -> None:
    for loss, mean in ((0.1, 0.01), (0.9, 0.1)):
        with pytest.raises(FaultError, match=r"do not fit steps of 0\.05 s; make them longer"):
            Simulation(1, BOAT, SeaState(), faults=[Bursts("gps", loss, mean)])
    with pytest.raises(FaultError, match=r"do not fit steps of 0\.05 s"):
        USVEnv(faults="gps-bursts10x0.01")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("gps_white", -1.0), ("gps_white", math.nan), ("accel_bias_time", 0.0)),
        *(("imu_rate", 0.0), ("gps_rate", math.inf), ("gps_arm", (1.0, 2.0))),
        *(("imu_arm", (0.0, math.nan, 0.0)),),
    ],
)
def test_impossible_suites(name: str, value: object) -> None:
    with pytest.raises(FaultError, match=f"sensor {name} = "):
        SensorSuite(**{name: value})  # type: ignore[arg-type]
