"""Tasks: their paths, rewards and ends, computed a second time from the true track."""

import dataclasses
import math
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from twin.particulars import Deck, Particulars
from twin.sim.bridge import particulars_of
from twin.sim.wrapper import OBSERVATIONS, TwinObservation, log_of, make_env, make_vector_env
from usv_gym.envs.episodes import OBSERVATION
from usv_gym.envs.scoring import FAILURE_COST, TaskError
from usv_gym.envs.tasks import TASKS, make_task
from usv_gym.physics import frames as fr
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.faults import Fault, FaultWarning
from usv_kernel.errors import ArgumentError, UsvTwinError
from usv_kernel.scalar import rotation

RATED = ("path", "curves", "lawnmower", "waypoints")
SPEED, LENGTH = 5.0, 7.5


def drawn(name, seed, n=1):
    task = make_task(name, n, SPEED, LENGTH)
    for i in range(n):
        task.reset(i, np.random.default_rng([seed, i]))
    return task


def bends(points):
    """Return the lengths of legs, and the turns between them in rad."""
    legs = np.diff(points, axis=0)
    courses = np.arctan2(legs[:, 1], legs[:, 0])
    turns = (np.diff(courses) + math.pi) % (2.0 * math.pi) - math.pi
    return np.hypot(*legs.T), turns, courses


@pytest.mark.parametrize("name", TASKS)
def test_paths_begin_at_the_boat_and_depend_on_their_seed_alone(name):
    task = drawn(name, 3, n=2)
    assert (task.points[:, 0] == 0.0).all()
    again = drawn(name, 3, n=2)
    np.testing.assert_array_equal(task.points, again.points)
    if name != "free":
        assert not np.array_equal(task.points[0], task.points[1])


def test_each_kind_of_path_is_what_it_says():
    for seed in range(30):
        lengths, turns, courses = bends(drawn("path", seed).points[0])
        assert (lengths >= 10 * LENGTH - 1e-9).all() and (lengths <= 20 * LENGTH + 1e-9).all()
        assert np.degrees(np.abs(turns)).max() <= 70.0 + 1e-9
        lengths, turns, _ = bends(drawn("waypoints", seed).points[0])
        assert np.degrees(np.abs(turns)).max() <= 140.0 + 1e-9
        lengths, turns, _ = bends(drawn("curves", seed).points[0])
        np.testing.assert_allclose(lengths, LENGTH)
        curvature = np.abs(turns[5:]) / LENGTH
        assert curvature.max() <= 1.0 / (6.0 * LENGTH) + 1e-9  # never sharper than 6 lengths
        lengths, turns, courses = bends(drawn("lawnmower", seed).points[0])
        np.testing.assert_allclose(np.abs(turns), math.pi / 2.0)
        np.testing.assert_allclose(lengths[::2], lengths[0])  # parallel legs of one length
        assert len(set(np.round(np.cos(courses[::2]), 9))) == 2  # there and back
        lengths, _, courses = bends(drawn("station", seed).points[0])
        assert 4 * LENGTH <= lengths[0] <= 8 * LENGTH
        assert abs(courses[0]) <= math.pi / 2.0


@pytest.mark.parametrize("name", RATED)
def test_rewards_of_paths_follow_from_the_true_track(name):
    """Computed a second time from the true states, leg by leg."""
    env = make_env(task=name, twin=None, sea="3", record=True)
    env.reset(seed=5)
    rng, vessel = np.random.default_rng(0), env.vessel.values
    previous = np.array([vessel["shaft_speed_manoeuvring"] / vessel["shaft_speed_service"], 0.0])
    points, reach, rates = env.task.points[0], env.task.rules[1], []
    leg = 0
    for _ in range(300):
        action = np.array([0.7, rng.uniform(-1.0, 1.0)])
        _, reward, terminated, _, info = env.step(action)
        x, y, psi = env.simulation.state[0, [0, 1, 5]]
        u, v = env.simulation.state[0, [6, 7]]

        def off(k, x=x, y=y):
            d = points[k + 1] - points[k]
            course = math.atan2(d[1], d[0])
            e = np.array([x, y]) - points[k]
            across = e[1] * math.cos(course) - e[0] * math.sin(course)
            left = np.hypot(*d) - e @ [math.cos(course), math.sin(course)]
            return across, left, course

        across, left, course = off(leg)
        if left < reach and leg + 2 < len(points):
            leg += 1
            across, left, course = off(leg)
        assert info["leg"] == leg
        assert info["cross_track_m"] == pytest.approx(across, abs=1e-9)
        along = u * math.cos(course - psi) + v * math.sin(course - psi)
        terms = info["reward_terms"]
        assert terms["progress"] == pytest.approx(1.0 - abs(along / env.speed - 1.0))
        assert terms["cross_track"] == pytest.approx(-min(abs(across) / 10.0, 2.0))
        effort = -0.05 * np.abs(action - previous).sum()
        assert terms["effort"] == pytest.approx(effort, abs=1e-12)
        assert reward == pytest.approx(sum(terms.values()))
        previous = action
        rates.append(reward)
        if terminated:
            break
    assert len(rates) > 100


def test_off_the_path_is_a_failure_and_the_end():
    env = make_env(twin=None, sea="calm")
    env.reset(seed=0)
    for _ in range(2000):
        *_, reward, terminated, _, info = env.step(np.array([0.8, 0.25]))
        if terminated:
            break
    assert abs(info["cross_track_m"]) > 50.0 and not info["is_success"]
    assert info["reward_terms"]["failure"] == -FAILURE_COST
    assert reward < -FAILURE_COST + 1.0


def test_a_boat_on_station_succeeds_and_one_that_leaves_fails():
    env = make_env(task="station", twin=None, sea="calm")
    env.reset(seed=1)
    assert set(env.reset(seed=1)[1]["reward_terms"]) == {"distance", "speed", "effort", "failure"}
    point = env.task.points[0, 1]
    env.simulation.state[0, :2] = point + np.array([3.0, 4.0])
    *_, reward, terminated, _, info = env.step(np.zeros(2))
    away = np.hypot(*(env.simulation.state[0, :2] - point))
    assert info["is_success"] and not terminated
    assert info["reward_terms"]["distance"] == pytest.approx(-0.5 * away / 10.0)
    assert info["reward_terms"]["speed"] < 0.0
    env.simulation.state[0, :2] = point + np.array([0.0, 101.0])
    *_, reward, terminated, _, info = env.step(np.zeros(2))
    assert terminated and not info["is_success"]
    assert reward < -FAILURE_COST


def test_a_decision_of_ten_steps_is_ten_steps():
    """The same track, the sum of rewards, the last observation; only the effort counts once."""
    options = {"sea": "3", "twin": "ukf", "faults": "gps3@2"}
    long, short = make_env(frame_skip=10, **options), make_env(**options)
    one, other = long.reset(seed=3)[0], short.reset(seed=3)[0]
    np.testing.assert_array_equal(one, other)
    valid = [k for k, name in enumerate(OBSERVATION) if name.endswith("_valid")]
    sds = [k for k, name in enumerate(long.observation_names) if "ahead" in name and "sd" in name]
    for action in np.random.default_rng(0).uniform(-1.0, 1.0, (20, 2)):
        one, reward, *_, info = long.step(action)
        total, seen = 0.0, np.zeros(len(valid))
        for _ in range(10):
            other, part, *_, last = short.step(action)
            total, seen = total + part, np.maximum(seen, other[valid])
        assert reward == pytest.approx(total)
        np.testing.assert_array_equal(long.simulation.state, short.simulation.state)
        np.testing.assert_array_equal(one[valid], seen)  # a sample since the last decision
        rest = np.delete(np.arange(len(one)), [*valid, *sds])  # they come every 5 s
        np.testing.assert_allclose(one[rest], other[rest], atol=1e-6)
        assert info["t_s"] == last["t_s"]


# ------------------------------------------------- observation sets


@pytest.mark.filterwarnings("ignore:.*render.*")
@pytest.mark.parametrize(
    ("task", "observation"),
    [
        (list(TASKS)[k % len(TASKS)], OBSERVATIONS[k % len(OBSERVATIONS)])
        for k in range(max(len(TASKS), len(OBSERVATIONS)))
    ],
)
def test_both_checkers_accept_every_task_and_observation_set(task, observation):
    env = make_env(
        task=task,
        observation=observation,
        twin="ukf",
        frame_skip=5,
        faults="gps10",
        dof=6 if observation == "twin_attitude" or task == "seakeeping" else 3,
    )
    assert len(env.observation_names) == env.observation_space.shape[0]
    assert len(set(env.observation_names)) == len(env.observation_names)
    check_env(env, skip_render_check=True)
    sb3 = pytest.importorskip("stable_baselines3.common.env_checker")
    sb3.check_env(env)


def test_the_attitude_set_holds_forecasts_of_all_channels():
    env = make_env(observation="twin_attitude", twin="ukf", frame_skip=5, dof=6, sea="2")
    names = list(env.observation_names)
    for channel in ("roll", "pitch", "heave", "deck_speed"):
        for horizon in ("0.5", "1", "2", "3", "5"):
            assert f"ahead_{horizon}s_{channel}" in names
            assert f"ahead_{horizon}s_half_width_{channel}" in names
    obs, _ = env.reset(seed=3)
    for _ in range(40):
        obs, *_ = env.step(np.zeros(env.action_space.shape))
    own = dict(zip(names, obs.tolist(), strict=True))
    # nothing is learned yet: the mean, and heave is counted from it
    assert abs(own["ahead_2s_heave"]) < 0.5
    assert own["ahead_2s_half_width_heave"] > 1.6 * own["sd_heave"] > 0.0


@pytest.mark.parametrize("faults", ["ahrs10", "gps10|ahrs-random", [Fault("ahrs", 1.0, 5.0)]])
def test_a_fault_of_the_ahrs_warns_where_there_is_none(faults):
    with pytest.warns(FaultWarning, match="dof=3 has no AHRS"):
        make_env(twin=None, faults=faults)
    with warnings.catch_warnings():
        warnings.simplefilter("error", FaultWarning)
        make_env(twin=None, faults=faults, dof=6)
        make_env(twin=None, faults="on")


def test_stacked_is_what_was_seen_before():
    env = make_env(observation="raw_stacked", frame_skip=4)
    plain = make_env(observation="raw", frame_skip=4)
    for seed in (1, None):
        seen = [plain.reset(seed=seed)[0]] * 8
        np.testing.assert_array_equal(env.reset(seed=seed)[0], np.concatenate(seen))
        for action in np.random.default_rng(2).uniform(-1.0, 1.0, (12, 2)):
            seen = [plain.step(action)[0], *seen[:7]]
            np.testing.assert_array_equal(env.step(action)[0], np.concatenate(seen))


def test_the_oracle_sees_the_truth():
    env = make_env(observation="oracle", sea="3", faults="gps60@5")
    env.reset(seed=2)
    at = {name: k for k, name in enumerate(env.observation_names)}
    for action in np.random.default_rng(2).uniform(-1.0, 1.0, (300, 2)):
        obs, *_, info = env.step(action)
    state = env.simulation.state[0]
    assert obs[at["true_surge"]] == pytest.approx(state[6] / env.speed, rel=1e-6)
    assert obs[at["true_sin_heading"]] == pytest.approx(math.sin(state[5]), abs=1e-6)
    assert obs[at["true_cross_track"]] == pytest.approx(info["cross_track_m"] / 10.0, rel=1e-5)
    assert obs[at["true_drive_left"]] == pytest.approx(state[14] / env.vessel.helm_max, rel=1e-5)
    assert obs[at["cross_track"]] != obs[at["true_cross_track"]]


def test_raw_and_twin_never_see_the_truth():
    """A false true position changes rewards, and nothing that is seen before the next fix."""
    for observation in ("raw", "raw_stacked", "twin", "twin_params", "twin_health"):
        options = {"observation": observation, "twin": "ukf", "faults": "gps60@1", "sea": "calm"}
        one, other = make_env(**options), make_env(**options)
        one.reset(seed=1), other.reset(seed=1)
        for k in range(60):
            a, b = one.step(np.array([0.7, 0.1])), other.step(np.array([0.7, 0.1]))
            if k == 39:
                other.simulation.state[0, :2] += [5.0, 9.0]
        np.testing.assert_array_equal(a[0], b[0])
        assert a[1] != b[1]


def test_parameters_are_those_of_the_twin():
    for observed in (
        make_env(observation="twin_params", twin="ukf"),
        make_env(observation="twin_params", twin="dsw-ukf"),
    ):
        observed.reset(seed=1)
        prior = type(observed)(twin=observed.twin.name).twin.predictor.estimate()
        for action in np.random.default_rng(2).uniform(-1.0, 1.0, (60, 2)):
            obs = observed.step(action)[0]
        now = observed.twin.predictor.estimate()
        p = len(now.params)
        xi, sd = obs[-2 * p : -p], obs[-p:]
        expected = ((now.params - prior.params) / prior.params_sd).clip(-10.0, 10.0)
        np.testing.assert_allclose(xi, expected, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(sd, (now.params_sd / prior.params_sd).clip(0.0, 10.0), rtol=1e-5)
        assert np.abs(xi).max() > 0.01


@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
def test_misspelled_options_get_the_nearest_and_all_names(make):
    with pytest.raises(ArgumentError) as caught:
        make("USVTwin-v0", fault="gps10", max_epsiode_steps=9)
    said = str(caught.value)
    assert "'faults'" in said and "'max_episode_steps'" in said
    assert ("num_envs" in said) == (make is gym.make_vec)


def test_observation_sets_that_cannot_be_say_so():
    with pytest.raises(ValueError, match=r"known: raw, raw_stacked, oracle, twin, twin_params"):
        make_env(observation="all")
    with pytest.raises(ValueError, match="needs a twin"):
        make_vector_env(2, observation="twin", twin=None)
    with pytest.raises(ValueError, match="identifies no parameters"):
        make_env(observation="twin_params", twin="persistence")
    with pytest.raises(ValueError, match="is given the sea"):
        make_env(twin="oracle", sea="0|2")
    with pytest.raises(ArgumentError, match=r"^particulars: observation = 'raw' runs no twin$"):
        make_env(observation="raw", particulars=None)
    with pytest.raises(TypeError, match="frame_skip=1"):
        TwinObservation(make_env(twin=None, frame_skip=2), "ukf")
    with pytest.raises(ValueError, match="frame_skip = 0"):
        make_env(frame_skip=0)


@pytest.mark.slow
def test_a_million_random_steps_in_a_storm_with_every_fault_are_numbers():
    envs = make_vector_env(
        100, observation="twin_params", twin="ukf", sea="6", faults="on", frame_skip=10, dof=6
    )
    obs, _ = envs.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(1000):
        obs, reward, *_ = envs.step(rng.uniform(-1.0, 1.0, (100, 2)))
        assert np.isfinite(obs).all() and np.isfinite(reward).all()
        assert (np.abs(obs) <= 10.0).all()


# ------------------------------------------------- motion of the boat


@pytest.mark.parametrize("point", [None, (2.5, 1.0, -1.5)])
def test_motion_costs_by_roll_and_by_the_acceleration_of_the_deck(point):
    env = make_env(twin=None, dof=6, sea="3", motion_penalty=0.25, deck_point=point)
    env.reset(seed=1)
    a, b, c = point or (0.4 * env.vessel.values["length_waterline"], 0.0, 0.0)
    before = None
    for _ in range(100):
        *_, info = env.step(np.array([0.6, 0.3]))
        state, rate = env.simulation.state[0], env.simulation.boats["mean_rate"][0]
        p, q, r = state[[fr.P, fr.Q, fr.R]]
        assert list(info["reward_terms"])[-1] == "motion"
        # the deck point's own acceleration along the mast, by its velocity
        u, v, w = state[[fr.U, fr.V, fr.W]] + np.cross([p, q, r], [a, b, c])
        if before is not None:
            lift = (w - before) / 0.05 + p * v - q * u
            rough = (state[fr.PHI] / math.radians(10.0)) ** 2 + (lift / 2.0) ** 2
            assert info["reward_terms"]["motion"] == pytest.approx(
                -0.25 * min(rough, 4.0), rel=1e-6, abs=1e-9
            )
            mean = rate[fr.W] - a * rate[fr.Q] + b * rate[fr.P]
            assert mean == pytest.approx((w - before) / 0.05)
        before = w
    plain = make_env(twin=None, dof=6, sea="3")
    plain.reset(seed=1)
    assert "motion" not in plain.step(np.array([0.6, 0.3]))[-1]["reward_terms"]


SEAKEEPING = {"task": "seakeeping", "observation": "twin_attitude", "twin": "ukf", "dof": 6}
POINT = 2.5, 1.0, -1.5
BOAT = particulars_of(Vessel.load("usv75"), dof=6)
POINTED = dataclasses.replace(BOAT, deck=Deck(point=POINT))


@pytest.mark.parametrize("given", [{"deck_point": POINT}, {"particulars": POINTED}])
def test_reward_and_twin_have_the_same_deck_point(given):
    env = make_env(**SEAKEEPING, **given)
    envs = make_vector_env(2, **SEAKEEPING, **given)
    for one, twin in ((env, env.twin), (envs, envs.twin(1))):
        assert one.episodes.kinds[0].deck_point == POINT
        assert tuple(one.episodes.config["rules"]["deck"]) == POINT
        assert twin.particulars.deck.point == POINT
    alone = [env.reset(seed=3)[0], *(env.step(np.array([0.6, 0.3]))[0] for _ in range(40))]
    both = [envs.reset(seed=[3, 4])[0][0]]
    both += [envs.step(np.full((2, 2), [0.6, 0.3]))[0][0] for _ in range(40)]
    np.testing.assert_array_equal(alone, both)
    # what the twin says of the point in the observation is of this point
    now = env.twin.attitude
    k = env.observation_names.index("twin_deck_speed")
    assert alone[-1][k] == pytest.approx(now.deck_speed, abs=1e-6)
    turned = np.cross([now.roll_rate, now.pitch_rate, env.twin.estimate().state[5]], POINT)
    down = now.vertical_speed + rotation((now.roll, now.pitch, 0.0))[2] @ turned
    assert now.deck_speed == pytest.approx(down, abs=0.1)


def test_a_deck_point_of_its_own_goes_with_the_log(tmp_path):
    env = make_env(twin=None, task="seakeeping", dof=6, deck_point=POINT, record=True)
    env.reset(seed=0)
    env.step(env.episodes.nominal_action)
    log_of(env, tmp_path / "a.csv")
    assert Particulars.load(tmp_path / "a.toml").deck.point == POINT


@pytest.mark.parametrize(
    "options",
    [
        {"deck_point": POINT},
        {**SEAKEEPING, "particulars": POINTED, "deck_point": (0.0, 0.0, 0.0)},
        *({"dof": 6, "deck_point": one} for one in ((1.0, 2.0), "bow", (1.0, math.nan, 0.0))),
    ],
)
def test_a_deck_point_without_roll_or_beside_another_is_refused(options):
    with pytest.raises(UsvTwinError, match="deck_point"):
        make_env(**{"twin": None, **options})


def test_seakeeping_wants_a_boat_that_rolls_and_is_lenient_off_the_course():
    with pytest.raises(TaskError, match=r"task = 'seakeeping': .* use dof=6"):
        make_env(twin=None, task="seakeeping")
    with pytest.raises(TaskError, match=r"motion_penalty = 0\.5: .*use dof=6"):
        make_env(twin=None, motion_penalty=0.5)
    env = make_env(twin=None, task="seakeeping", dof=6, sea="0")
    for seed in range(3):
        env.reset(seed=seed)
        start, end = env.task.points[0]
        assert np.hypot(*(end - start)) == pytest.approx(110.0 * env.speed)
        assert abs(math.atan2(end[1], end[0])) <= math.radians(60.0)
    # in a third of the unit to the side, a boat pays a third of what it does on a path
    env.step(env.episodes.nominal_action)
    env.simulation.state[0, [fr.X, fr.Y]] = 10.0 * np.array([-end[1], end[0]]) / np.hypot(*end)
    terms = env.step(env.episodes.nominal_action)[-1]["reward_terms"]
    assert terms["cross_track"] == pytest.approx(-1.0 / 3.0, abs=0.02)
