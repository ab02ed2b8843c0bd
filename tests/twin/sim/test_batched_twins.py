"""Twins in one compiled call say what the same twins say one by one."""

import gymnasium as gym
import numpy as np
import pytest

import usv_gym  # noqa: F401 - registers the environment
from twin.model.rollout import LONG_STEP
from twin.predictors.registry import predictor_class
from twin.sim.batched_twins import HORIZONS, TWIN_OBSERVATION, CompiledTwins, SeparateTwins
from usv_gym.envs.episodes import BOUND, OBSERVATION

OPTIONS = {"task": "free", "faults": "gps5@15", "sea": "2"}


def sail(env, steps=500):
    """Return the twin's parts of the observations of steps with a command that changes."""
    rng, rows = np.random.default_rng(0), []
    env.reset(seed=1)
    for k in range(steps):
        if k % 100 == 0:
            action = np.array([0.8, rng.uniform(-1.0, 1.0)])
        rows.append(env.step(action)[0][len(OBSERVATION) :])
    return np.array(rows)


@pytest.mark.parametrize("twin", ["ukf", "dsw-ukf-plus"])
def test_compiled_twins_equal_those_asked_one_by_one(twin, monkeypatch):
    """In what they observe, how far they trust sensors, and how their forecasts are graded."""
    options = OPTIONS | {"observation": "twin_health", "faults": "gps5@12+gyro-frozen8@20"}
    ours = gym.make("USVTwin-v0", twin=twin, **options)
    monkeypatch.setattr(predictor_class(twin), "is_compiled", False)
    theirs = gym.make("USVTwin-v0", twin=twin, **options)
    assert isinstance(ours.unwrapped.observer, CompiledTwins)
    assert isinstance(theirs.unwrapped.observer, SeparateTwins)
    # single precision
    np.testing.assert_allclose(sail(ours, 540), sail(theirs, 540), rtol=2e-6, atol=2e-6)
    assert ours.unwrapped.twin.health == theirs.unwrapped.twin.health
    assert ours.unwrapped.twin.health["gyro"].status == "excluded"
    one, other = (env.step(np.zeros(2))[-1]["twin_forecast"] for env in (ours, theirs))
    assert dict(one) == pytest.approx(dict(other), rel=1e-6) and one["n_loss"] > 0


def assert_equals_prediction(note, twin):
    """Assert that what is noted of a boat's future is the prediction of its twin."""
    found = twin.predict("hold", dt=LONG_STEP)
    rows = [int(np.flatnonzero(np.isclose(found.t - twin.t, h))[0]) for h in HORIZONS]
    np.testing.assert_allclose(note["ahead"], found.mean[rows], rtol=0, atol=1e-6)
    sd = np.sqrt(np.diagonal(note["covs"], axis1=1, axis2=2))
    np.testing.assert_allclose(sd, found.sd[rows], rtol=0, atol=1e-6)
    # shorter rows are the same forecast, up to the error of integration
    short_rows = twin.predict("hold")
    rows = [int(np.flatnonzero(np.isclose(short_rows.t - twin.t, h))[0]) for h in HORIZONS]
    assert (abs(note["ahead"] - short_rows.mean[rows]) < 0.07 * sd + 1e-6).all()
    np.testing.assert_allclose(sd, short_rows.sd[rows], rtol=0.05, atol=1e-6)


@pytest.mark.parametrize("twin", ["ukf", "dsw-ukf-plus"])
@pytest.mark.parametrize("n", [1, 3])
def test_observation_ahead_equals_the_prediction_of_a_held_command(twin, n):
    envs = gym.make_vec("USVTwin-v0", num_envs=n, twin=twin, band_period=0.0, **OPTIONS)
    envs.reset(seed=1)
    rng, base = np.random.default_rng(0), envs.unwrapped
    for k in range(400):
        if k % 100 == 0:
            actions = rng.uniform(-1.0, 1.0, envs.action_space.shape)
        envs.step(actions)
        for i in range(n) if k in (19, 299, 399) else ():
            assert_equals_prediction(base.observer.notes[i], base.observer.twin(i))
    envs.close()


def test_the_twin_of_an_environment_is_up_to_date():
    env = gym.make("USVTwin-v0", twin="ukf", **OPTIONS)
    twin = env.unwrapped.twin
    sail(env, 30)
    assert twin.t == pytest.approx(1.5)
    assert twin.predictor.ready
    assert twin.cmd[0] > 0.0
    np.testing.assert_array_equal(twin.predict("hold").start, twin.estimate().state)


def test_band_period_sets_how_often_covariances_ahead_are_updated():
    env = gym.make("USVTwin-v0", twin="ukf", band_period=1.0, **OPTIONS)
    rows = sail(env, 100)
    ahead = [i for i, name in enumerate(TWIN_OBSERVATION) if name == "ahead_5s_sd_heading"]
    changed = np.flatnonzero(np.diff(rows[:, ahead[0]]) != 0.0) + 1
    assert len(changed) in (4, 5)
    assert (np.diff(changed) == 20).all()


@pytest.mark.parametrize("twin", ["ukf", "dsw-ukf-plus"])
def test_never_a_nan_in_an_observation_through_everything(twin):
    env = gym.make("USVTwin-v0", twin=twin, task="free", faults="on", sea="6", dof=6)
    rows = sail(env, 1500)
    assert np.isfinite(rows).all()
    assert np.abs(rows).max() <= BOUND
