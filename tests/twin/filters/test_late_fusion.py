"""Late fusion: the formula, accuracy in a turn, losses of sensors, bad input."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.channels import MEASUREMENTS
from twin.filters.late_fusion import LateFusion, fuse
from twin.particulars import Instruments

DT = 0.05
LENGTH = 7.5
INSTRUMENTS = Instruments(gps_sd=1.0, gps_bias_sd=0.0)
GPS, DOPPLER, COMPASS, GYRO = slice(0, 4), slice(2, 4), slice(4, 5), slice(5, 6)


def turn(n: int, dt: float = DT) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return state, earth velocity and body acceleration of a turn in waves after 20 s."""
    t = dt * np.arange(n)
    ramp = np.clip((t - 20.0) / 5.0, 0.0, 1.0)
    ramp = ramp * ramp * (3.0 - 2.0 * ramp)
    u = 5.4 - 1.6 * ramp + 0.17 * np.sin(1.8 * t)
    v = -1.3 * ramp + 0.21 * np.sin(1.8 * t + 1.0)
    r = 0.31 * ramp + 0.02 * np.sin(1.8 * t + 0.3)

    def integral(rate: np.ndarray, start: float) -> np.ndarray:
        return start + np.concatenate([[0.0], np.cumsum(0.5 * dt * (rate[1:] + rate[:-1]))])

    psi = integral(r, 0.3)
    velocity = np.column_stack(
        [u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)]
    )
    x, y = integral(velocity[:, 0], 30.0), integral(velocity[:, 1], -20.0)
    accel = np.column_stack([np.gradient(u, dt) - v * r, np.gradient(v, dt) + u * r])
    return np.column_stack([x, y, psi, u, v, r]), velocity, accel


def measured(
    rng: np.random.Generator, n: int, instruments: Instruments, dt: float = DT
) -> tuple[np.ndarray, np.ndarray]:
    """Return the true states and the measurement rows of a turn."""
    s, velocity, accel = turn(n, dt)
    lag = round(instruments.gps_latency / dt)
    old = np.maximum(np.arange(n) - lag, 0)
    z = np.full((n, len(MEASUREMENTS)), np.nan)
    z[:, :2] = s[old, :2] + rng.normal(0.0, instruments.gps_sd, (n, 2))
    z[:, 2:4] = velocity[old] + rng.normal(0.0, instruments.doppler_sd, (n, 2))
    heading = s[:, 2] + rng.normal(0.0, instruments.compass_sd, n)
    z[:, 4] = np.mod(heading + math.pi, 2.0 * math.pi) - math.pi
    z[:, 5] = s[:, 5] + rng.normal(0.0, instruments.gyro_bias_sd)
    z[:, 5] += rng.normal(0.0, instruments.gyro_sd, n)
    bias = rng.choice([-1.0, 1.0], 2) * instruments.accel_bias_sd
    z[:, 6:8] = accel + bias + rng.normal(0.0, instruments.accel_sd, (n, 2))
    return s, z


def run(fusion: LateFusion, z: np.ndarray, dt: float = DT) -> np.ndarray:
    """Return all results, after a check that covariances stay positive definite."""
    out = np.empty((len(z), 6))
    for i, row in enumerate(z):
        out[i] = fusion.update(dt, row)
        if i % 50 == 0:
            check_sound(fusion)
    return out


def check_sound(fusion: LateFusion) -> None:
    assert np.isfinite(fusion.state).all()
    for P in (fusion.gps.P, fusion.imu.P, fusion.fused_covariance, fusion.covariance):
        assert np.isfinite(P).all()
        np.linalg.cholesky(P)


def rms(out: np.ndarray, s: np.ndarray, start: int = 0) -> np.ndarray:
    return np.sqrt(np.mean((out - s)[start:] ** 2, axis=0))


def test_fuse_is_the_inverse_covariance_formula() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        a, b = rng.normal(size=(2, 4, 6))
        K_gps, K_imu = a @ a.T, b @ b.T
        p, q = rng.normal(size=(2, 4))
        phi, K, W = fuse(p, K_gps, q, K_imu)
        expected = np.linalg.inv(np.linalg.inv(K_gps) + np.linalg.inv(K_imu))
        np.testing.assert_allclose(K, expected, atol=1e-9)
        np.testing.assert_allclose(
            phi, expected @ (np.linalg.inv(K_gps) @ p + np.linalg.inv(K_imu) @ q), atol=1e-8
        )
        np.testing.assert_allclose(W, K_imu @ np.linalg.inv(K_gps + K_imu), atol=1e-9)  # Eq 42


def test_first_update_of_the_gps_filter_equals_one_by_hand() -> None:
    # One axis, constant acceleration, no process noise to speak of: the position variance
    # after a second fix one second later is that of two equal measurements of the position,
    # one of them carried on with a known velocity.
    sensors = Instruments(gps_sd=2.0, gps_bias_sd=0.0, doppler_sd=1e-6)
    fusion = LateFusion(sensors, LENGTH, jerk=1e-6)
    z = np.full(len(MEASUREMENTS), math.nan)
    z[:5] = 0.0, 0.0, 3.0, 0.0, 0.0
    fusion.update(0.0, z)
    z[:2] = 4.0, 0.0
    fusion.update(1.0, z)
    assert fusion.gps.x[0] == pytest.approx(0.5 * (3.0 + 4.0), abs=1e-3)
    assert fusion.gps.P[0, 0] == pytest.approx(2.0**2 / 2.0, rel=1e-3)


@pytest.mark.parametrize("seed", [0, 1])
def test_feedback_decides_how_good_velocities_are(seed: int) -> None:
    # docs/explanation/twin.md: u, v rms .16-.25 m/s with feedback, .5-1 m/s without; no Doppler.
    s, z = measured(np.random.default_rng(seed), 1000, INSTRUMENTS)
    z[:, DOPPLER] = math.nan
    with_it = rms(run(LateFusion(INSTRUMENTS, LENGTH), z), s, 500)
    without = rms(run(LateFusion(INSTRUMENTS, LENGTH, feedback=False), z), s, 500)
    assert (with_it[3:5] > 0.05).all()
    assert (with_it[3:5] < 0.3).all()
    assert (without[3:5] > 0.4).all()
    assert np.hypot(*without[3:5]) > 2.0 * np.hypot(*with_it[3:5])


ROW = np.arange(1000)


@pytest.mark.parametrize(
    ("seed", "missing", "bounds"),
    [
        pytest.param(4, ([], GPS), [0.7, 0.7, 0.012, 0.2, 0.2, 0.01], id="none"),
        pytest.param(7, (ROW, slice(5, 8)), [math.inf, math.inf, 0.03, 0.4, 0.4, 0.06], id="IMU"),
        pytest.param(9, (ROW % 4 > 0, GPS), [0.8, 0.8, math.inf, 0.3, 0.3, math.inf], id="5 Hz"),
        pytest.param(9, (ROW % 20 > 0, GPS), [0.8, 0.8, math.inf, 0.3, 0.3, math.inf], id="1 Hz"),
    ],
)
def test_accuracy_is_within_bounds(
    seed: int, missing: tuple[np.ndarray, slice], bounds: list[float]
) -> None:
    s, z = measured(np.random.default_rng(seed), 1000, INSTRUMENTS)
    z[missing] = math.nan
    assert (rms(run(LateFusion(INSTRUMENTS, LENGTH), z), s, 500) < bounds).all()


def test_latency_is_not_compensated() -> None:
    # as in the paper: the position lags by about speed times latency
    instruments = Instruments(gps_sd=0.01, gps_bias_sd=0.0, gps_latency=0.5)
    s, z = measured(np.random.default_rng(2), 400, instruments)
    out = run(LateFusion(instruments, LENGTH), z)
    lag = np.hypot(*(out - s)[200:, :2].T).mean()
    assert lag == pytest.approx(0.5 * 5.4, rel=0.1)


def test_before_the_first_fix_it_follows_compass_and_gyro() -> None:
    s, z = measured(np.random.default_rng(0), 200, INSTRUMENTS)
    z[:100, GPS] = math.nan
    z[:50, COMPASS] = math.nan
    z[:20, GYRO] = math.nan
    fusion = LateFusion(INSTRUMENTS, LENGTH)
    for i in range(20):
        np.testing.assert_array_equal(fusion.update(DT, z[i]), np.zeros(6))
    out = run(fusion, z[20:100])
    np.testing.assert_array_equal(out[:, [0, 1, 3, 4]], np.zeros((80, 4)))
    np.testing.assert_allclose(out[30:, 2], s[50:100, 2], atol=0.05)
    assert not fusion.ready
    fusion.update(DT, z[100])
    assert fusion.ready
    assert np.hypot(*(fusion.state - s[100])[:2]) < 5.0
    check_sound(fusion)


def test_a_fix_without_compass_is_not_ready() -> None:
    fusion = LateFusion(INSTRUMENTS, LENGTH)
    z = np.full(len(MEASUREMENTS), math.nan)
    z[:4] = 5.0, 6.0, 1.0, 2.0
    np.testing.assert_allclose(fusion.update(DT, z), [5.0, 6.0, 0.0, 1.0, 2.0, 0.0])
    assert not fusion.ready
    z[4] = math.pi / 2.0
    s = fusion.update(DT, z)
    assert fusion.ready
    np.testing.assert_allclose(s[2:5], [math.pi / 2.0, 2.0, -1.0], atol=0.1)


def test_gps_loss_of_a_minute_stays_within_bounds() -> None:
    s, z = measured(np.random.default_rng(3), 2400, INSTRUMENTS)
    lost, back = 600, 1800
    z[lost:back, GPS] = math.nan
    fusion = LateFusion(INSTRUMENTS, LENGTH)
    out = np.empty_like(s)
    weight, sd = np.empty(len(z)), np.empty(len(z))
    for i, row in enumerate(z):
        out[i] = fusion.update(DT, row)
        weight[i] = fusion.weight_gps[0, 0]
        sd[i] = math.sqrt(fusion.fused_covariance[0, 0])
        if i % 50 == 0:
            check_sound(fusion)
    # the uncertainty grows and the IMU takes over
    assert sd[back - 1] > 20.0 * sd[lost - 1]
    assert abs(weight[back - 1]) < 0.01
    # dead reckoning with a bias of .05 m/s2 in a turn: tens of metres, not kilometres
    error = np.hypot(*(out - s)[:, :2].T)
    assert error[lost : lost + 200].max() < 6.0
    assert error[back - 1] < 150.0
    # ten seconds after the return all is as before
    assert (rms(out, s, back + 200) < [0.8, 0.8, 0.012, 0.25, 0.25, 0.01]).all()


def test_loss_of_all_sensors_for_five_minutes_is_survived() -> None:
    n = 600 + 6000 + 600
    s, z = measured(np.random.default_rng(6), n, INSTRUMENTS)
    lost, back = 600, 6600
    fusion = LateFusion(INSTRUMENTS, LENGTH)
    run(fusion, z[:lost])
    start = fusion.state
    end = run(fusion, np.full((600, len(MEASUREMENTS)), math.nan), 10 * DT)[-1]
    # neither acceleration nor yaw rate of the last second is carried on for minutes
    assert np.hypot(*(end - start)[:2]) < 3000.0
    assert abs(end[5]) < 1e-3
    error = run(fusion, z[back:]) - s[back:]
    # the count of whole turns is lost with the compass
    error[:, 2] = np.mod(error[:, 2] + math.pi, 2.0 * math.pi) - math.pi
    after = np.sqrt(np.mean(error[200:] ** 2, axis=0))
    assert (after < [0.8, 0.8, 0.012, 0.25, 0.25, 0.01]).all()


@pytest.mark.parametrize("length", [1.0, 7.5, 300.0])
def test_two_hours_of_loss_leave_sound_covariances(length: float) -> None:
    _, z = measured(np.random.default_rng(0), 40, INSTRUMENTS)
    fusion = LateFusion(INSTRUMENTS, length)
    run(fusion, z)
    rest = np.full(len(MEASUREMENTS), math.nan)
    rest[:8] = 3.0, 4.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0
    for lost in (GPS, slice(0, len(MEASUREMENTS))):
        row = rest.copy()
        row[lost] = math.nan
        for _ in range(360):
            fusion.update(10.0, row)
        check_sound(fusion)
    out = run(fusion, np.tile(rest, (200, 1)))
    np.testing.assert_allclose(out[-1, [0, 1, 3, 4, 5]], [3.0, 4.0, 0.0, 0.0, 0.0], atol=0.1)


def test_covariance_is_that_of_the_body_velocities() -> None:
    # against the spread of draws from the earth-fixed estimate
    _, z = measured(np.random.default_rng(0), 900, INSTRUMENTS)
    fusion = LateFusion(INSTRUMENTS, LENGTH)
    run(fusion, z)
    rng = np.random.default_rng(1)
    velocity = rng.multivariate_normal(fusion.fused[2:], fusion.fused_covariance[2:, 2:], 200_000)
    psi = rng.normal(fusion.state[2], math.sqrt(fusion.imu.P[4, 4]), 200_000)
    u = velocity[:, 0] * np.cos(psi) + velocity[:, 1] * np.sin(psi)
    v = velocity[:, 1] * np.cos(psi) - velocity[:, 0] * np.sin(psi)
    np.testing.assert_allclose(
        fusion.covariance[3:5, 3:5], np.cov(u, v), rtol=0.03, atol=0.02 * u.var()
    )


@settings(max_examples=40, deadline=None)
@given(
    patterns=st.lists(
        st.tuples(
            st.integers(0, 2 ** len(MEASUREMENTS) - 1),
            st.integers(1, 12),
            st.sampled_from([0.0, 1e-6, DT, 0.2, 1.0, 60.0]),
        ),
        min_size=1,
        max_size=12,
    ),
    seed=st.integers(0, 5),
    feedback=st.booleans(),
)
def test_any_pattern_of_missing_samples_stays_finite(
    patterns: list[tuple[int, int, float]], seed: int, feedback: bool
) -> None:
    _, z = measured(np.random.default_rng(seed), 150, INSTRUMENTS)
    fusion = LateFusion(INSTRUMENTS, LENGTH, feedback=feedback)
    i = 0
    for mask, repeat, dt in patterns:
        for _ in range(repeat):
            row = z[i].copy()
            row[(mask >> np.arange(len(MEASUREMENTS))) & 1 == 1] = (math.nan, math.inf)[i % 2]
            i += 1
            s = fusion.update(dt, row)
            assert s.shape == (6,)
            check_sound(fusion)
