"""Episodes as logs: of every boat of a vector environment, wherever they end."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from twin import Log, Particulars
from twin.sim.wrapper import log_of, make_env, make_vector_env

DT = 0.05


@settings(max_examples=40, deadline=None)
@given(
    frame_skip=st.integers(1, 13),
    decisions=st.integers(1, 12),
    fails_after=st.none() | st.integers(1, 120),
    boats=st.integers(1, 2),
    mode=st.sampled_from(["NextStep", "SameStep"]),
)
def test_logs_of_episodes_that_end_anywhere_have_rising_times(
    frame_skip, decisions, fails_after, boats, mode
):
    envs = make_vector_env(
        boats, twin=None, record=True, frame_skip=frame_skip, task="path",
        max_episode_steps=decisions, autoreset_mode=mode,
    )  # fmt: skip
    envs.reset(seed=1)
    sim, steps = envs.simulation, 0
    for _ in range(decisions):
        if fails_after is not None and steps + frame_skip >= fails_after:
            sim.state[0, :2] += 500.0  # far off the path: the task ends within this decision
        *_, terminated, truncated, _ = envs.step(np.full((boats, 2), 0.3))
        steps += frame_skip
        if (terminated | truncated)[0]:
            break
    assert (terminated | truncated)[0]
    log = log_of(envs, ended=mode == "SameStep")
    expected = steps - frame_skip + 1 if terminated[0] else steps
    np.testing.assert_array_equal(log.t, DT * np.arange(expected + 1))
    assert np.isfinite(log.truth).all()
    envs.close()


def test_logs_of_a_vector_environment_are_those_of_single_ones(tmp_path):
    options = {"twin": None, "record": True, "frame_skip": 10, "faults": "gps3@2"}
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (12, 3, 2))
    envs = make_vector_env(3, max_episode_steps=8, autoreset_mode="SameStep", **options)
    envs.reset(seed=4)
    for action in actions:
        envs.step(action)
    for i in range(3):
        env = make_env(**options)
        env.reset(seed=4 + i)
        for action in actions[:8]:
            env.step(action[i])
        path = tmp_path / f"{i}.csv"
        ours, theirs = log_of(envs, path, boat=i, ended=True), log_of(env)
        for name in ("t", "cmd", "z", "truth"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
        np.testing.assert_array_equal(Log.read(path).t, ours.t)
        assert Particulars.load(path.with_suffix(".toml")).name == "usv75"
        env.reset()
        for action in actions[8:]:
            env.step(action[i])
        np.testing.assert_array_equal(log_of(envs, boat=i).truth, log_of(env).truth)
