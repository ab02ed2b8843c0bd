"""The native vector environment: each element is the single environment, to the bit."""

import copy
import pickle
import threading

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import usv_gym  # noqa: F401 - registers the environment
from tests.usv_gym.envs.test_own_tasks import Line
from twin.sim.wrapper import OBSERVATIONS
from usv_gym import SeaState
from usv_gym.world.faults import Fault
from usv_kernel.errors import UsvTwinError

N = 3
FAULTS = "gps3@2+imu-spikes-random"
SHORT = {"faults": FAULTS, "max_episode_steps": 90}
EVERYTHING = (
    "gps-ramp=0.3:2@1+fixes-late=0.5:2@4+all-stall1@7+commands-garbage1@3+velocity-swapped1@2"
    "+imu-garbage-random+commands-stall-random+gyro-bias-bursts+left-zero2@5+right-scale-random"
)
TWINS = (None, "persistence", "ukf", "dsw-ukf-plus")
MODES = ("NextStep", "SameStep")
DRAWN = {"sea": "calm|3", "vessel_spread": 0.3, "wind_from_deg": "any", "current": "any"}
DRAWN |= {"heading_deg": "any", "load": (0.8, 1.2), "faults": "none|gps3@2|imu-random+gps-bursts"}


def actions(steps, n=N, width=2, seed=0):
    return np.random.default_rng(seed).uniform(-1.2, 1.2, (steps, n, width)).astype(np.float32)


def natives(n=N, **options):
    return gym.make_vec("USVTwin-v0", num_envs=n, **(SHORT | options))


def same(a, b):
    """Assert that nested infos hold the same."""
    assert type(a) is type(b) or np.isscalar(a), (a, b)
    if isinstance(a, dict):
        assert set(a) == set(b)
        for key in a:
            same(a[key], b[key])
    elif isinstance(a, np.ndarray) and a.dtype == object:
        for x, y in zip(a, b, strict=True):
            assert (x is None) == (y is None)
            if x is not None:
                np.testing.assert_array_equal(x, y)
    else:
        np.testing.assert_array_equal(a, b)


def decisions(observation, **others):
    """Return options of an observation set, with decisions of ten steps in worlds that differ."""
    dof = 6 if observation == "twin_attitude" else 3
    short = {"frame_skip": 10, "max_episode_steps": 30}
    return {"observation": observation, "twin": "ukf", "dof": dof, **short, **DRAWN, **others}


OTTER = {"twin": None, "vessel": "otter", "actions": "units"}
OTTER["sea"] = SeaState(hs=0.6, wind=6.0, wind_sd=1.0, spreading=2.0, current=0.4)
OTTER["faults"] = [Fault("gps", start=1.0, duration=1.0)]
CASES = [
    *({"twin": twin} for twin in TWINS),
    *({**OTTER, "dof": dof} for dof in (3, 6)),
    *map(decisions, OBSERVATIONS),
    *(decisions("twin", twin=twin) for twin in ("dsw-ukf-plus", "var")),
    decisions("twin", vessel="usv75|otter"),
    decisions(["ahead_5s_forward", "gps_age", "twin_surge"], vessel="usv75|otter"),
    decisions("twin_health", vessel="usv75|otter", twin="persistence"),
    {"twin": "ukf", "sea": "2", "dof": 6, "faults": EVERYTHING, "max_episode_steps": 200},
    {**DRAWN, "twin": None, "task": "docking", "vessel": "kvlcc2_l7|wamv16", "sea": "2|building"},
    {**DRAWN, "twin": None, "task": "station", "dof": 6, "suite": "best", "faults": "on"},
    {**DRAWN, "twin": None, "task": "seakeeping", "dof": 6, "reward_weights": {"effort": 0.5}},
    {**DRAWN, "twin": None, "task": Line, "current": (0.3, (0.0, 90.0)), "heading_deg": 90.0},
]
"""How resets come about has nothing to do with these: they take turns, but for the plain twin."""


@pytest.mark.parametrize(
    ("options", "mode"),
    [*((one, MODES[k % 2]) for k, one in enumerate(CASES)), *(({"twin": "ukf"}, m) for m in MODES)],
)
def test_it_is_gymnasiums_own_over_single_environments(options, mode):
    """Observations, rewards, ends and infos, over whole episodes with faults and resets."""
    native = natives(autoreset_mode=mode, **options)
    options = SHORT | options
    sync = SyncVectorEnv(
        [lambda: gym.make("USVTwin-v0", **options)] * N, autoreset_mode=AutoresetMode(mode)
    )
    for a, b in zip(native.reset(seed=5), sync.reset(seed=5), strict=True):
        same(a, b)
    ends = failures = 0
    for action in actions(3 * options["max_episode_steps"] - 10):
        action[0] = [1.0, 0.3]  # hard to one side: it fails where it has the time
        ours, theirs = native.step(action), sync.step(action)
        for a, b in zip(ours, theirs, strict=True):
            same(a, b)
        ends += int((ours[2] | ours[3]).sum())
        failures += int(ours[2].sum())
    assert ends >= 2 * N and (failures or "frame_skip" not in options)


@pytest.mark.parametrize("twin", [None, "ukf", "dsw-ukf-plus"])
@pytest.mark.parametrize("frame_skip", [1, 4])
def test_threads_change_nothing(twin, frame_skip):
    options = {"twin": twin, "frame_skip": frame_skip}
    one, two = natives(5, **options), natives(5, **options, num_threads=2)
    for a, b in zip(one.reset(seed=1), two.reset(seed=1), strict=True):
        same(a, b)
    for action in actions(200 // frame_skip, 5):
        for a, b in zip(one.step(action), two.step(action), strict=True):
            same(a, b)
    before = threading.active_count()
    two.close()
    assert threading.active_count() < before


def test_a_mask_resets_only_those_that_it_names():
    envs = natives(twin="ukf", autoreset_mode="Disabled")
    envs.reset(seed=3)
    for action in actions(20):
        before = envs.step(action)[0]
    mask = np.array([False, True, False])
    obs, infos = envs.reset(seed=[None, 11, None], options={"reset_mask": mask})
    np.testing.assert_array_equal(obs[[0, 2]], before[[0, 2]])
    fresh, _ = gym.make("USVTwin-v0", twin="ukf", **SHORT).reset(seed=11)
    np.testing.assert_array_equal(obs[1], fresh)
    np.testing.assert_array_equal(infos["_t_s"], mask)
    t = envs.step(actions(1)[0])[4]["t_s"]
    np.testing.assert_allclose(t, [1.05, 0.05, 1.05])


def test_disabled_autoreset_refuses_to_go_on_after_the_end():
    envs = natives(twin=None, autoreset_mode="Disabled", max_episode_steps=2)
    envs.reset(seed=0)
    envs.step(actions(1)[0])
    assert envs.step(actions(1)[0])[3].all()
    with pytest.raises(gym.error.ResetNeeded, match="reset_mask"):
        envs.step(actions(1)[0])
    envs.reset(options={"reset_mask": np.array([True, True, True])})
    envs.step(actions(1)[0])


def test_seeds_go_on_where_none_is_given():
    envs, env = natives(twin=None), gym.make("USVTwin-v0", twin=None, **SHORT)
    envs.reset(seed=4)
    env.reset(seed=5)
    assert envs.unwrapped.np_random_seed == (4, 5, 6)
    obs, _ = envs.reset()
    np.testing.assert_array_equal(obs[1], env.reset()[0])


def test_what_cannot_be_is_said():
    envs = natives(twin=None)
    with pytest.raises(gym.error.ResetNeeded):
        envs.step(actions(1)[0])
    for seed in ([1, 2], [1, 2.7, 3], "abc"):
        with pytest.raises((TypeError, ValueError), match="seed"):
            envs.reset(seed=seed)
    masks = [True, False, True], np.array([True]), np.zeros(3, dtype=bool)
    for options in ("x", {"speed": 1}, *({"reset_mask": mask} for mask in masks)):
        with pytest.raises((TypeError, ValueError), match="options"):
            envs.reset(options=options)
    envs.reset(seed=0)
    with pytest.raises(ValueError, match="shape"):
        envs.step(np.zeros(2))
    with pytest.raises(ValueError, match="numbers"):
        envs.step("full ahead")


def test_an_action_that_is_no_number_does_nothing():
    envs, other = natives(twin="ukf"), natives(twin="ukf")
    bad = actions(1)[0]
    bad[1, 0] = np.nan
    for each in (envs, other):
        each.reset(seed=0)
    for action in actions(30):
        with pytest.raises(ValueError, match=r"action of \[1\] holds NaN"):
            envs.step(bad)
        for a, b in zip(envs.step(action), other.step(action), strict=True):
            same(a, b)


def test_each_boat_has_a_twin_that_can_be_asked():
    envs, env = natives(twin="dsw-ukf-plus"), gym.make("USVTwin-v0", twin="dsw-ukf-plus", **SHORT)
    envs.reset(seed=2)
    env.reset(seed=4)
    for action in actions(60):
        envs.step(action)
        env.step(action[2])
    ours, own = envs.unwrapped.twin(2), env.unwrapped.twin
    assert ours.t == own.t
    np.testing.assert_array_equal(ours.predict("hold").mean, own.predict("hold").mean)
    np.testing.assert_array_equal(ours.estimate().params, own.estimate().params)
    np.testing.assert_array_equal(ours.monitor.memory, own.monitor.memory)
    assert (ours.health, ours.notes) == (own.health, own.notes)
    ours.step(99.0, np.full(10, np.nan), np.zeros(4))  # a copy: the boat's own goes on
    assert envs.unwrapped.twin(2).t == own.t


@pytest.mark.parametrize("twin", ["persistence", "ukf"])
@pytest.mark.parametrize("n", [1, 2])
def test_the_twin_that_is_asked_for_is_a_copy(twin, n):
    one, other = natives(n, twin=twin), natives(n, twin=twin)
    one.reset(seed=0)
    other.reset(seed=0)
    one.unwrapped.twin(0).step(99.0, np.full(10, np.nan), np.zeros(4))
    for action in actions(5, n):
        same(one.step(action)[0], other.step(action)[0])


def sailed(env, steps):
    """Return all that an environment says of some steps."""
    found = []
    for action in steps:
        obs, reward, terminated, truncated, info = env.step(action)
        found += [obs.copy(), np.copy(reward), np.copy(terminated), np.copy(truncated)]
        found += [np.copy(info["t_s"]), np.copy(info["cross_track_m"])]
    return found


@pytest.mark.parametrize("n", [None, 1, 3])
@pytest.mark.parametrize(
    "options",
    [{"twin": None, "faults": "gps-random"}, {"twin": "ukf"}, {"dof": 6}, {"twin": "var"}],
)
def test_an_episode_branches_in_two_that_go_on_with_the_same_bits(n, options):
    env = natives(n, **options) if n else gym.make("USVTwin-v0", max_episode_steps=40, **options)
    env.reset(seed=3)
    steps = actions(70, n) if n else [action[0] for action in actions(70, 1)]
    sailed(env, steps[:30])
    state, copied = env.unwrapped.get_state(), pickle.loads(pickle.dumps(env))
    other = copy.deepcopy(env)
    # beyond the end of an episode: generators are part of it
    last = steps[30:] if n else steps[30:40]
    want = sailed(env, last)
    for again in (copied, other):
        for one, two in zip(want, sailed(again, last), strict=True):
            np.testing.assert_array_equal(one, two)
    env.unwrapped.set_state(state)
    if not n:
        env = env.unwrapped  # the time limit counts by itself
    # a copy of a copy of it goes on alike, and a new episode is as new
    state = env.unwrapped.get_state()
    env.unwrapped.set_state(state)
    for again in (copy.deepcopy(env), env):
        for one, two in zip(want[:6], sailed(again, last[:1]), strict=True):
            np.testing.assert_array_equal(one, two)
    fresh = natives(n, **options) if n else gym.make("USVTwin-v0", **options).unwrapped
    fresh.reset(seed=5)
    env.reset(seed=5)
    for one, two in zip(sailed(fresh, steps[:5]), sailed(env, steps[:5]), strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize(
    "options", [{"sea": "5"}, {"vessel": "otter"}, {"twin": "ukf"}, {"frame_skip": 5}]
)
def test_states_of_other_environments_and_what_is_none_are_refused(options):
    env = gym.make("USVTwin-v0", twin=None).unwrapped
    other = gym.make("USVTwin-v0", **{"twin": None, **options}).unwrapped
    for one in (env, other):
        one.reset(seed=0)
    with pytest.raises(UsvTwinError, match=r"another environment; .* differ"):
        env.set_state(other.get_state())
    for wrong in (b"abc", {"x": 1}, None):
        with pytest.raises(UsvTwinError, match="what get_state returned"):
            env.set_state(wrong)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_closed_environment_says_so(threads):
    envs = natives(twin=None, num_threads=threads)
    envs.reset(seed=0)
    envs.close()
    for call in (envs.reset, lambda: envs.step(actions(1)[0])):
        with pytest.raises(gym.error.ClosedEnvironmentError, match="was closed"):
            call()


@pytest.mark.parametrize("skip", [1, 5])
def test_first_episodes_may_end_one_after_the_other(skip):
    native = natives(faults="none", twin=None, frame_skip=skip, max_episode_steps=20)
    ends = np.array([3, 20, 11])
    native.reset(seed=1, options={"first_episode_steps": ends})
    seen = np.zeros((60, N), dtype=bool)
    for k, action in enumerate(np.zeros((60, N, 2), np.float32)):
        seen[k] = native.step(action)[3]
    for i, first in enumerate(ends):
        # the step after an end begins the next episode, of full length
        np.testing.assert_array_equal(np.flatnonzero(seen[:, i])[:2], [first - 1, first + 20])
    for wrong in ([1, 2], [0, 1, 2], [1.5, 2.0, 3.0]):
        with pytest.raises(ValueError, match="first_episode_steps"):
            native.reset(options={"first_episode_steps": wrong})
