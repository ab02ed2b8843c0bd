"""Sensor checks in environments: what is shown of them, and that each episode begins anew."""

import gymnasium as gym
import numpy as np
import pytest

import usv_gym  # noqa: F401 - registers the environment
from twin.integrity.state import EXCLUDED, OK, SENSORS, STATUSES
from twin.sim.twin_observation import HEALTH_OBSERVATION, TWIN_OBSERVATION
from twin.sim.wrapper import make_env
from usv_gym.envs.episodes import OBSERVATION

STEPS = 1000
OPTIONS = {
    "task": "free",
    "sea": "2",
    "faults": "gyro-frozen8@20+commands-sign100@45",
    "record": True,
}


def sail(env, seed=1, steps=STEPS):
    """Return the last observation and the last info of a run."""
    env.reset(seed=seed)
    rng = np.random.default_rng(0)
    for k in range(steps):
        if k % 60 == 0:
            action = np.array([rng.uniform(0.4, 0.9), rng.uniform(-1.0, 1.0)])
        obs, *_, info = env.step(np.broadcast_to(action, env.action_space.shape))
    return obs, info


@pytest.mark.parametrize("name", ["ukf", "persistence"])
def test_an_episode_begins_with_sensors_that_are_trusted(name):
    for env in (
        make_env(twin=name, **OPTIONS),
        gym.make_vec("USVTwin-v0", num_envs=2, twin=name, **OPTIONS).unwrapped,
    ):
        info = sail(env, steps=540)[1]
        assert np.all(info["twin_health_gyro"] == EXCLUDED)
        info = env.reset(seed=1)[1]
        assert np.all(info["twin_health_gyro"] == OK)
        env.step(np.zeros(env.action_space.shape))
        twin = env.twin(0) if isinstance(env, gym.vector.VectorEnv) else env.twin
        assert (twin.begun, twin.health["gyro"].since) == (0.0, 0.0)


def test_twin_health_says_how_far_each_sensor_is_trusted():
    env = make_env(twin="ukf", observation="twin_health", **OPTIONS)
    plain = make_env(twin="ukf", **OPTIONS)
    whole = len(OBSERVATION) + len(TWIN_OBSERVATION)
    assert env.observation_names == (*plain.observation_names, *HEALTH_OBSERVATION)
    values = {"absent": 0.0, "ok": 1.0, "doubtful": 0.5, "excluded": 0.0}
    assert set(values) == set(STATUSES)
    for steps in (0, 540, STEPS):
        obs = sail(env, steps=steps)[0] if steps else env.reset(seed=1)[0]
        alone = sail(plain, steps=steps)[0] if steps else plain.reset(seed=1)[0]
        np.testing.assert_array_equal(obs[:whole], alone)
        for name in SENSORS:
            shown = obs[env.observation_names.index(f"health_{name}")]
            assert shown == values[env.twin.health[name].status]
