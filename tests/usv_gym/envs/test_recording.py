"""Episodes as logs, and twins on them."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.usv_gym.envs.acting import actions_of, episode
from twin import Log, Twin
from twin.sim.bridge import particulars_of
from twin.sim.wrapper import log_of, make_env
from usv_gym import Fault
from usv_gym.physics import frames as fr


@pytest.fixture(scope="module", params=["ukf", "dsw-ukf", "dsw-ukf-plus", "persistence"])
def sailed(request: pytest.FixtureRequest) -> tuple[Any, list[Any], list[np.ndarray]]:
    """Return an environment after 40 s with a loss, and the estimates of its twin on the way."""
    env = make_env(twin=request.param, task="free", record=True, faults=[Fault("gps", 20.0, 10.0)])
    env.reset(seed=8)
    estimates, states = [env.twin.estimate()], [np.array(env.twin.predictor.state)]
    for action in actions_of(env, 800):
        env.step(action)
        estimates.append(env.twin.estimate())
        states.append(np.array(env.twin.predictor.state))
    return env, estimates, states


def test_the_wrapper_estimates_as_a_twin_on_the_log_on_disk(sailed: Any, tmp_path: Path) -> None:
    """Bit for bit, without the truth: the twin cannot have seen it."""
    env, estimates, states = sailed
    log_of(env, tmp_path / "episode.csv")
    log = Log.read(tmp_path / "episode.csv").without_truth()
    twin = Twin(
        particulars_of(env.unwrapped.vessel, env.unwrapped.simulation.suite),
        type(env.twin.predictor)(env.twin.particulars),
    )
    assert len(log) == len(estimates) == 801
    for row, estimate, state in zip(log, estimates, states, strict=True):
        twin.step(*row)
        np.testing.assert_array_equal(twin.predictor.state, state)
        other = twin.estimate()
        assert (other.t, other.ready) == (estimate.t, estimate.ready)
        for name in ("state", "sd", "params", "params_sd"):
            np.testing.assert_array_equal(getattr(other, name), getattr(estimate, name))
    np.testing.assert_array_equal(twin.monitor.memory, env.twin.monitor.memory)
    assert (twin.health, twin.notes) == (env.twin.health, env.twin.notes) and twin.notes


def test_the_log_holds_what_the_sensors_said_and_the_truth(sailed: Any) -> None:
    env, _, _ = sailed
    log = log_of(env)
    assert log.truth is not None
    np.testing.assert_array_equal(log.t, 0.05 * np.arange(801))
    np.testing.assert_array_equal(
        log.truth[-1], env.unwrapped.simulation.state[0, [0, 1, 5, 6, 7, 11]]
    )
    np.testing.assert_array_equal(log.cmd[-1], env.unwrapped.simulation.cmd[0])
    gone = np.isnan(log.z[:, 0])
    assert np.all(gone[(log.t > 20.01) & (log.t < 29.99)])
    assert gone.sum() == 200 + 2  # and before the first fix
    assert np.all(np.isnan(log.z[:, 8]))  # no sensor measures the wind


def test_a_log_needs_a_recording() -> None:
    env = make_env(twin=None)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="record=True"):
        log_of(env)
    with pytest.raises(ValueError, match="record=True, and reset"):
        log_of(make_env(twin=None, record=True))


def test_a_new_episode_starts_a_new_log_and_a_new_twin() -> None:
    env = make_env(task="free", record=True)
    one, _ = episode(env, 4, 100)
    episode(env, 5, 60)
    assert len(log_of(env)) == 61
    again, _ = episode(env, 4, 100)
    np.testing.assert_array_equal(one, again)


def test_the_position_error_in_info_is_for_grading() -> None:
    env = make_env(task="free")
    env.reset(seed=0)
    for action in actions_of(env, 400):
        *_, info = env.step(action)
    s, truth = env.twin.predictor.state, env.unwrapped.simulation.state[0]
    expected = math.hypot(s[0] - truth[fr.X], s[1] - truth[fr.Y])
    assert info["twin_position_error_m"] == pytest.approx(expected)
    # GPS bias of 1 m a side, and more than nothing
    assert 0.0 < expected < 5.0
