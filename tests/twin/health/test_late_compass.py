"""A compass that is late by a latency that the particulars tell."""

from __future__ import annotations

import functools
import math

import gymnasium as gym
import numpy as np
import pytest

from twin import Log, Twin
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SensorSuite, Vessel
from usv_gym.world.sea import SeaState
from usv_kernel.channels import GYRO

VESSEL = Vessel.load("usv75")
RUNS = (("zigzag", "0"), ("zigzag", "2"), ("turn", "2"), ("heading135", "3"))


@functools.cache
def sailed(run: int, latency: float, dof: int) -> Log:
    scenario, sea = RUNS[run]
    return simulate(
        scenario,
        vessel=VESSEL,
        sea=SeaState.named(sea),
        suite=SensorSuite(compass_latency=latency),
        duration=90,
        seed=3,
        dof=dof,
    )


def heading_error(log: Log, stated: float, dof: int, z: np.ndarray | None = None) -> float:
    """Return the root mean square of the error of the heading, deg."""
    boat = particulars_of(VESSEL, SensorSuite(compass_latency=stated), dof)
    twin, found = Twin(boat, "ukf"), []
    for k, (t, row, cmd) in enumerate(log):
        twin.step(t, row if z is None else z[k], cmd)
        found.append(twin.estimate().state[2])
    off = np.angle(np.exp(1j * (np.array(found) - log.truth[:, 2])))[400:]
    return math.degrees(math.sqrt(np.mean(off**2)))


@pytest.mark.parametrize("dof", [3, 6])
def test_a_compass_whose_latency_is_stated_is_as_good_as_one_without(dof: int) -> None:
    prompt = [heading_error(sailed(run, 0.0, dof), 0.0, dof) for run in range(len(RUNS))]
    late = [heading_error(sailed(run, 0.2, dof), 0.2, dof) for run in range(len(RUNS))]
    unknown = [heading_error(sailed(run, 0.2, dof), 0.0, dof) for run in range(len(RUNS))]
    assert np.median(late) < 1.2 * np.median(prompt)
    assert np.median(unknown) > 1.5 * np.median(late)


def test_a_late_compass_is_bridged_without_a_gyro() -> None:
    """The compass itself then says what the boat turned, with its own delay."""
    for run in (0, 1, 3):
        log = sailed(run, 0.2, 3)
        z = log.z.copy()
        z[:, GYRO] = math.nan
        assert heading_error(log, 0.2, 3, z) < 0.8 * heading_error(log, 0.0, 3, z)


def test_a_held_heading_stays_a_repetition() -> None:
    """A heading at 2 Hz that the log repeats in each row must not look new."""
    log = sailed(0, 0.2, 3)
    z = log.z.copy()
    z[:, 4] = z[np.arange(len(z)) // 10 * 10, 4]
    sparse = log.z.copy()
    sparse[np.arange(len(z)) % 10 != 0, 4] = math.nan
    held, empty = (heading_error(log, 0.2, 3, rows) for rows in (z, sparse))
    assert held == pytest.approx(empty, rel=0.02)


def test_latencies_in_a_vector_environment_are_those_of_single_ones() -> None:
    suite = SensorSuite(compass_latency=0.15, imu_latency=0.05, ahrs_latency=0.2)
    options = {
        "twin": "ukf",
        "dof": 6,
        "sea": "2",
        "task": "free",
        "suite": suite,
        "faults": "gyro_x-zero5@4+accel_y-sign3@8+gyro_z2@2",
        "observation": "twin_attitude",
    }
    envs = gym.make_vec("USVTwin-v0", num_envs=2, **options)
    alone = [gym.make("USVTwin-v0", **options) for _ in range(2)]
    obs, _ = envs.reset(seed=[5, 6])
    for i, env in enumerate(alone):
        np.testing.assert_array_equal(obs[i], env.reset(seed=5 + i)[0])
    for k in range(250):
        action = np.array([[0.6, math.sin(0.05 * k)], [0.8, -0.2]], np.float32)
        obs = envs.step(action)[0]
        for i, env in enumerate(alone):
            np.testing.assert_array_equal(obs[i], env.step(action[i])[0])
    for i, env in enumerate(alone):
        memory = envs.unwrapped.twin(i).monitor.memory
        np.testing.assert_array_equal(memory, env.unwrapped.twin.monitor.memory)
    envs.close()
