"""Estimates of roll, pitch and heave against the true motion, and against exact cases."""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
import pytest

from tests.twin.motion.rows import after, sail, take
from twin import Log, Particulars
from twin.channels import ACCEL_Z, AHRS_PITCH, AHRS_ROLL, GPS_VZ, GPS_Z, GYRO_X, MEASUREMENTS
from twin.motion import DeckMotion
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SensorSuite, Vessel
from usv_gym.world.sea import SeaState
from usv_kernel.channels import ACCEL_X, ACCEL_Y, GYRO
from usv_kernel.scalar import rotation

VESSEL = Vessel.load("usv75")
BOAT = particulars_of(VESSEL, dof=6)
SETTLED = 600
"""Rows after which the filters are settled."""


RUNS = (("heading45", "2"), ("heading135", "3"), ("heading90", "2"), ("zigzag", "2")) * 3
"""Courses and seas; each run has biases of the sensors of its own."""


@functools.cache
def sailed(run: int, suite: SensorSuite | None = None) -> Log:
    """Return a run, by default with typical sensors."""
    scenario, sea = RUNS[run]
    return simulate(
        scenario,
        vessel=VESSEL,
        sea=SeaState.named(sea),
        duration=90,
        seed=run,
        suite=suite,
        dof=6,
    )


def estimates(
    log: Log, boat: Particulars = BOAT, without: tuple[int, ...] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Return roll, pitch, heave, vertical speed of each row and their deviations (4)."""
    z = log.z.copy()
    z[:, list(without)] = np.nan
    motion, found, sd = DeckMotion(boat), [], []
    # the twin's velocity: good to a few cm/s
    for _ in sail(motion, log, z, velocity_error_mps=0.03):
        now = motion.estimate()
        found.append((now.roll, now.pitch, now.heave, now.vertical_speed))
        sd.append(now.sd)
    return np.array(found)[SETTLED:], np.array(sd)[SETTLED:]


@functools.cache
def errors_and_claims(run: int, without: tuple[int, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Return errors of a run with typical sensors (N, 4), and the claimed deviations."""
    found, sd = estimates(sailed(run), without=without)
    return found - truth(sailed(run)), sd


def truth(log: Log) -> np.ndarray:
    """Return the same of the true motion."""
    z, roll, pitch, w = log.true_motion[:, :4].T
    u, v = log.truth[:, 3:5].T
    down = np.cos(pitch) * (np.sin(roll) * v + np.cos(roll) * w) - np.sin(pitch) * u
    return np.stack([roll, pitch, z - z[SETTLED:].mean(), down], axis=1)[SETTLED:]


def rms(errors: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(errors**2, axis=0))


@pytest.mark.parametrize(
    ("without", "limit"), [((), 0.15), ((AHRS_ROLL, AHRS_PITCH), 0.4)], ids=["ahrs", "no ahrs"]
)
def test_roll_and_pitch_are_within_the_target(without: tuple[int, ...], limit: float) -> None:
    errors = [rms(errors_and_claims(run, without)[0][:, :2]) for run in range(len(RUNS))]
    assert np.degrees(np.median(errors)) < limit


def test_claimed_deviations_are_those_of_the_errors() -> None:
    ratios = []
    for run in range(len(RUNS)):
        errors, sd = errors_and_claims(run)
        ratios.append(rms(errors[:, :3]) / rms(sd[:, :3]))
    assert (np.median(ratios, axis=0) > 0.4).all()
    assert (np.median(ratios, axis=0) < 1.5).all()


def level_boat(rate: float, accel_bias: tuple[float, float], rows: int = 4000) -> DeckMotion:
    """Estimates after a level boat at rest has turned at a rate, with biased accelerometers."""
    rng, motion = np.random.default_rng(3), DeckMotion(BOAT)
    z = np.full((rows, len(MEASUREMENTS)), np.nan)
    z[:, [GYRO, GYRO_X, GYRO_X + 1]] = BOAT.instruments.gyro_sd * rng.standard_normal((rows, 3))
    z[:, GYRO] += rate
    force = *accel_bias, -9.81
    z[:, [ACCEL_X, ACCEL_Y, ACCEL_Z]] = force + 1e-3 * rng.standard_normal((rows, 3))
    for k in range(rows):
        state = np.array([0.0, 0.0, 0.05 * rate * k, 0.0, 0.0, rate])
        take(motion, 0.05 * k, 0.05 if k else 0.0, z[k], state, True)
    return motion


@pytest.mark.parametrize("rate", [-0.3, 0.3])
def test_a_turn_averages_the_bias_of_the_accelerometers(rate: float) -> None:
    bias = 0.05, -0.05
    straight, turning = (level_boat(r, bias).estimate() for r in (0.0, rate))
    wrong = math.hypot(straight.roll, straight.pitch)
    assert wrong == pytest.approx(math.hypot(*bias) / 9.81, rel=0.4)
    assert math.hypot(turning.roll, turning.pitch) < 0.5 * wrong
    # and the deviations say so
    assert turning.sd[0] < 0.7 * straight.sd[0]
    assert turning.sd[1] < 0.7 * straight.sd[1]


def test_noise_of_gravity_is_what_the_innovations_show() -> None:
    """Accelerations that last for half a second hide gravity: the filter must find how many."""
    n, rng, sds = 4000, np.random.default_rng(1), []
    for size in (0.05, 0.4):
        z = np.full((n, len(MEASUREMENTS)), np.nan)
        z[:, [GYRO, GYRO_X, GYRO_X + 1]] = 1e-4 * rng.standard_normal((n, 3))
        slow, stay = np.zeros((n, 2)), math.exp(-0.05 / 0.5)
        for k in range(1, n):
            slow[k] = stay * slow[k - 1] + math.sqrt(1.0 - stay**2) * rng.standard_normal(2)
        z[:, [ACCEL_X, ACCEL_Y]] = size * slow + 1e-3 * rng.standard_normal((n, 2))
        z[:, ACCEL_Z] = -9.80665 + 1e-3 * rng.standard_normal(n)
        motion = DeckMotion(BOAT)
        for k in range(n):
            take(motion, 0.05 * k, 0.05 if k else 0.0, z[k], np.zeros(6), True)
        density = motion.record["attitude"]["innovation"][:, 1]
        expected = 2.0 * 0.5 * (size / 9.80665) ** 2
        assert (density > 0.3 * expected).all()
        assert (density < 3.0 * expected).all()
        now = motion.estimate()
        assert now is not None
        sds.append(now.sd[:2])
    assert (sds[1] > 1.2 * sds[0]).all()


def test_gnss_halves_the_error_of_the_heave() -> None:
    heave = [
        [rms(errors_and_claims(run, without)[0])[2] for without in ((), (GPS_Z, GPS_VZ))]
        for run in range(len(RUNS))
    ]
    with_fix, alone = np.median(heave, axis=0)
    assert with_fix < 0.5 * alone
    assert with_fix < 0.07


def test_an_imu_mounted_askew_gives_the_same_attitude() -> None:
    angles, log = (0.1, -0.15, 1.2), sailed(0)
    z = log.z.copy()
    turn = rotation(angles).T
    for columns in ([GYRO_X, GYRO_X + 1, GYRO], [ACCEL_X, ACCEL_Y, ACCEL_Z]):
        z[:, columns] = z[:, columns] @ turn.T
    instruments = dataclasses.replace(BOAT.instruments, imu_mounting=angles)
    askew = dataclasses.replace(BOAT, instruments=instruments)
    upright = errors_and_claims(0)[0] + truth(log)
    np.testing.assert_allclose(
        estimates(dataclasses.replace(log, z=z), askew)[0], upright, atol=2e-3
    )


def test_an_upright_row_has_the_acceleration_without_gravity() -> None:
    """What the horizontal filters get: the tilt no longer leaks into the accelerometers."""
    log, motion = sailed(1), DeckMotion(BOAT)
    raw, level = [], []
    for k, row in sail(motion, log):
        u, v, r = log.truth[k, 3:]
        before = log.truth[max(k - 1, 0), 3:]
        true = np.array([(u - before[0]) / 0.05 - v * r, (v - before[1]) / 0.05 + u * r])
        raw.append(log.z[k, ACCEL_X : ACCEL_Y + 1] - true)
        level.append(row[ACCEL_X : ACCEL_Y + 1] - true)
    assert (rms(np.array(level)[SETTLED:]) < 0.5 * rms(np.array(raw)[SETTLED:])).all()


def test_an_arm_of_the_imu_does_not_change_the_estimate() -> None:
    """On a mast 3 m above and 2 m ahead, the IMU feels the rotation; it is taken out."""
    arm = (2.0, 0.5, -3.0)
    suite = dataclasses.replace(SensorSuite.perfect(), imu_arm=arm, ahrs_rate=0.0)
    log = sailed(1, suite)
    boat = particulars_of(VESSEL, suite, 6)
    errors = rms(estimates(log, boat)[0] - truth(log))
    assert np.degrees(errors[:2]).max() < 0.4
    assert errors[3] < 0.05


@pytest.mark.parametrize("column", [ACCEL_X, ACCEL_Y, GYRO], ids=["ahead", "side", "yaw"])
@pytest.mark.parametrize("silent", [False, True])
def test_a_dead_horizontal_axis_lifts_no_boat(column: int, silent: bool) -> None:
    """Before, the last force of all axes went on, and the heave was 8 m off within a minute."""
    log = sailed(1)
    z = log.z.copy()
    z[700:, column] = math.nan if silent else z[700, column]
    dead = dataclasses.replace(log, z=z)
    error = np.abs(estimates(dead)[0] - truth(log))[200:]
    sound = errors_and_claims(1)[0][200:]
    assert (rms(error[:, 2:]) < 2.0 * rms(sound[:, 2:])).all()
    assert np.degrees(rms(error[:, :2])).max() < 0.5
    names = {ACCEL_X: {"accel_x_mps2"}, ACCEL_Y: {"accel_y_mps2"}, GYRO: set()}[column]
    assert set(after(DeckMotion(BOAT), log, z).troubles()) == names


def test_a_dead_gyro_of_an_imu_on_its_side_counts_for_the_other_rate() -> None:
    log = sailed(1)
    z = log.z.copy()
    for columns in ([GYRO_X, GYRO_X + 1, GYRO], [ACCEL_X, ACCEL_Y, ACCEL_Z]):
        z[:, columns] = z[:, columns] @ rotation((0.0, 0.0, 0.5 * math.pi))
    z[700:, GYRO_X + 1] = z[700, GYRO_X + 1]
    instruments = dataclasses.replace(BOAT.instruments, imu_mounting=(0.0, 0.0, 0.5 * math.pi))
    askew = dataclasses.replace(BOAT, instruments=instruments)
    found, sd = estimates(dataclasses.replace(log, z=z), askew)
    errors = rms((found - truth(log))[200:, :2])
    assert np.degrees(errors).max() < 0.4
    assert (errors < 2.0 * sd[200:, :2].mean(axis=0)).all()


def test_spikes_are_refused() -> None:
    log, rng = sailed(1), np.random.default_rng(0)
    z = log.z.copy()
    for column, size in ((AHRS_ROLL, 0.5), (GPS_VZ, 5.0), (GPS_Z, 50.0)):
        z[rng.random(len(z)) < 0.05, column] += size
    struck = estimates(dataclasses.replace(log, z=z))[0]
    assert (rms(struck - truth(log)) < 1.5 * rms(errors_and_claims(1)[0]) + 1e-3).all()
