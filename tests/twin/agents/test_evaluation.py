"""Evaluation: the episode of a seed is that of a single environment, and failing early costs."""

import json

import gymnasium as gym
import numpy as np
import pytest

from twin import Log, Particulars
from twin.agents import evaluation
from twin.agents.controllers import CONTROLLERS, make_controller
from twin.agents.evaluation import evaluate, make_envs, mean_scores
from twin.agents.policy import AgentError
from twin.live.sessions.policy import PolicySession
from twin.parallel import results_of


class Fixed:
    """Holds the same action for ever."""

    observation = "raw"

    def __init__(self, *action, name="fixed"):
        self.action, self.name = action, name

    def begin(self, envs):
        self.n = envs.num_envs

    def act(self, obs):
        return np.tile(self.action, (self.n, 1))


def test_episode_i_is_that_of_a_single_environment_with_its_seed():
    seeds, steps = (7, 3, 900_000), 30
    rows = evaluate(Fixed(0.7, 0.05), seeds=seeds, faults="gps10", max_episode_steps=steps)
    for seed, row in zip(seeds, rows, strict=True):
        env = gym.make(
            "USVTwin-v0", observation="raw", faults="gps10", sea="2", frame_skip=10,
            max_episode_steps=steps,
        )  # fmt: skip
        env.reset(seed=seed)
        total, off, over = 0.0, [], False
        while not over:
            _, reward, terminated, truncated, info = env.step(np.array([0.7, 0.05]))
            total += reward
            off.append(abs(info["cross_track_m"]))
            over = terminated or truncated
        assert row["seed"] == seed and row["agent"] == "fixed"
        assert row["return"] == pytest.approx(total, abs=1e-9)
        assert row["length_s"] == pytest.approx(info["t_s"]) == pytest.approx(steps * 0.5)
        assert row["cross_track_m"] == pytest.approx(np.mean(off)) == row["off_path_m"]
        assert not row["failed"] and not row["success"]


def test_an_agent_that_lacks_a_part_is_named(tmp_path, monkeypatch):
    (tmp_path / "half.py").write_text("class Half:\n    def act(self, obs): ...\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(AgentError, match=r"half:Half: .* lacks name and observation and begin"):
        evaluation.agents_named("half:Half")


@pytest.mark.parametrize("algo", ["PPO", "SAC"])
@pytest.mark.parametrize("name", ["vecnormalize", "model_vecnormalize"])
def test_a_model_is_scaled_by_the_file_beside_it(tmp_path, algo, name):
    sb3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.vec_env import VecNormalize

    from usv_gym.envs.sb3 import SB3VecEnv

    boats = VecNormalize(SB3VecEnv(1, observation="twin", frame_skip=10), clip_obs=3.0)
    model = getattr(sb3, algo)("MlpPolicy", boats, device="cpu", seed=3, use_sde=True)
    boats.reset()
    boats.step(np.array([[0.5, 0.1]]))
    model.save(tmp_path / "model")
    boats.save(tmp_path / f"{name}.pkl")
    ((_, agent),) = evaluation.agents_named(str(tmp_path / "model.zip"))
    assert f"scaled by {name}.pkl" in agent.note
    envs = make_envs(2, observation="twin")
    obs = envs.reset(seed=[5, 6])[0]
    agent.begin(envs)
    expected = model.predict(boats.normalize_obs(obs), deterministic=True)[0]
    np.testing.assert_allclose(agent.act(obs), expected, rtol=1e-5)
    assert evaluate(agent, seeds=[5], max_episode_steps=3)[0]["agent"] == "model"


NAMED = ["cross_track", "sin_course_error", "yaw_rate", "ahrs_roll"]


@pytest.mark.parametrize(
    "options",
    [
        {"observation": NAMED[:3], "actions": "common"},
        {"observation": NAMED, "actions": "common", "dof": 6},
        {"observation": "raw", "actions": "units"},
        {"observation": NAMED[:2], "actions": "units", "vessel": "otter"},  # as many as common
    ],
)
def test_a_model_sails_with_the_entries_and_actions_that_it_was_made_for(tmp_path, options):
    sb3 = pytest.importorskip("stable_baselines3")
    from usv_gym.envs.sb3 import SB3VecEnv

    model = sb3.PPO("MlpPolicy", SB3VecEnv(1, frame_skip=10, **options), device="cpu", seed=3)
    model.save(tmp_path / "model")
    model = sb3.PPO.load(tmp_path / "model", device="cpu")
    given = {key: value for key, value in options.items() if key == "vessel"}
    ((_, agent),) = evaluation.agents_named(str(tmp_path / "model.zip"), **given)
    assert (agent.observation, agent.actions) == (options["observation"], options["actions"])
    known = evaluation.trained_with([agent], given)
    assert known["dof"] == options.get("dof", 3)
    envs = make_envs(2, frame_skip=10, **options)
    obs = envs.reset(seed=[5, 6])[0]
    agent.begin(envs)
    np.testing.assert_allclose(agent.act(obs), model.predict(obs, deterministic=True)[0])
    (row,) = evaluate(agent, seeds=[5], **{**known, "max_episode_steps": 3})
    assert row["agent"] == "model"
    session = PolicySession(agent, tmp_path, predictor="ukf", **known)
    assert session.envs.single_action_space == model.action_space
    session.stop()


def test_a_model_without_names_is_of_the_set_of_its_size_or_its_shape_is_told(tmp_path):
    sb3 = pytest.importorskip("stable_baselines3")
    flat = gym.wrappers.FlattenObservation
    for name, options in (("raw", {"observation": "raw"}), ("few", {"observation": NAMED[:3]})):
        env = flat(gym.make("USVTwin-v0", actions="units", **options))
        sb3.PPO("MlpPolicy", env, device="cpu").save(tmp_path / name)
    ((_, agent),) = evaluation.agents_named(str(tmp_path / "raw.zip"))
    assert (agent.observation, agent.actions) == ("raw", "units")
    said = r"Box\(-10.0, 10.0, \(3,\).* actions units \(4,\).*raw \(23,\).*module:Class"
    with pytest.raises(AgentError, match=said):
        evaluation.agents_named(str(tmp_path / "few.zip"))


def test_a_model_for_another_observation_says_what_to_do(tmp_path):
    sb3 = pytest.importorskip("stable_baselines3")
    sb3.A2C("MlpPolicy", gym.make("Pendulum-v1"), device="cpu").save(tmp_path / "pendulum")
    with pytest.raises(AgentError, match="module:Class"):
        evaluation.agents_named(str(tmp_path / "pendulum.zip"))
    seen = gym.spaces.Dict({"all": gym.make("Pendulum-v1").observation_space})
    pendulum = gym.wrappers.TransformObservation(
        gym.make("Pendulum-v1"), lambda obs: {"all": obs}, seen
    )
    sb3.A2C("MultiInputPolicy", pendulum, device="cpu").save(tmp_path / "dict")
    with pytest.raises(AgentError, match=r"are Dict\(.*actions Box\(-2.0, 2.0, \(1,\)"):
        evaluation.agents_named(str(tmp_path / "dict.zip"))
    (tmp_path / "torch.pt").write_bytes(b"PK")
    with pytest.raises(AgentError, match="is no policy"):
        evaluation.agents_named(str(tmp_path / "torch.pt"))
    (tmp_path / "no.zip").write_bytes(b"PK")
    with pytest.raises(AgentError, match="is no model of Stable-Baselines3"):
        evaluation.agents_named(str(tmp_path / "no.zip"))


def test_time_after_a_failure_counts_as_far_off():
    # a circle leaves the path behind by 50 m before long
    rows = evaluate(Fixed(1.0, 0.0), seeds=(1, 2, 3, 4), max_episode_steps=240, sea="0")
    failed = [row for row in rows if row["failed"]]
    assert failed
    for row in failed:
        sailed = np.ceil(row["length_s"] * 2.0) / 240.0  # it ends within a decision
        assert 0.0 < sailed < 1.0
        expected = sailed * row["cross_track_m"] + (1.0 - sailed) * 50.0
        assert row["off_path_m"] == pytest.approx(expected)
        assert row["return"] < 0.0


def test_time_after_a_success_does_not_count():
    class Guided(Fixed):
        observation = "oracle"

        def begin(self, envs):
            names = envs.observation_names
            self.at = [names.index(f"true_{name}") for name in (
                "cross_track", "cos_course_error", "sin_course_error"
            )]  # fmt: skip

        def act(self, obs):
            off, c, s = obs[:, self.at].T
            turn = np.arctan2(s, c) - np.arctan(off * 10.0 / 15.0)
            return np.stack([np.ones_like(off), np.clip(1.5 * turn, -1.0, 1.0)], axis=1)

    rows = evaluate(Guided(), seeds=(1, 2, 3), max_episode_steps=400, sea="0")
    assert all(row["success"] and not row["failed"] for row in rows)
    assert all(row["length_s"] < 150.0 for row in rows)
    assert all(row["off_path_m"] == row["cross_track_m"] < 6.0 for row in rows)


def test_the_outage_has_a_score_of_its_own():
    agent = Fixed(0.7, 0.1)
    (row,) = evaluate(agent, seeds=(5,), faults="gps10@4", max_episode_steps=40, sea="0")
    env = gym.make("USVTwin-v0", observation="raw", sea="0", frame_skip=10, max_episode_steps=40)
    env.reset(seed=5)
    off = [abs(env.step(np.array([0.7, 0.1]))[4]["cross_track_m"]) for _ in range(40)]
    # decisions end at 0.5, 1.0, ... s, and those from 4 to 34 s count; the episode has 20 s
    assert row["off_path_outage_m"] == pytest.approx(np.mean(off[7:]))
    (without,) = evaluate(agent, seeds=(5,), max_episode_steps=5)
    assert without["off_path_outage_m"] is None


def test_station_keeping_counts_the_distance_to_the_point():
    (row,) = evaluate(Fixed(0.0, 0.0), seeds=(1,), task="station", max_episode_steps=2, sea="0")
    envs = make_envs(1, observation="raw", task="station", max_episode_steps=2, sea="0")
    envs.reset(seed=[1])
    far = np.hypot(*envs.task.errors[0, :2])
    assert row["cross_track_m"] == pytest.approx(far, abs=6.0) and far > 25.0


GRID = {"seeds": (1, 2), "seas": ("0", "2"), "outages": ("none", "gps10@1")}


def test_two_workers_change_nothing():
    agent = CONTROLLERS["los-dr"]()  # has a memory, which episodes must not share
    calls = evaluation.on_grid(agent, **GRID, max_episode_steps=20)
    serial = [
        evaluate(agent, seeds=GRID["seeds"], sea=sea, faults=faults, max_episode_steps=20)
        for sea in GRID["seas"]
        for faults in GRID["outages"]
    ]
    assert len({json.dumps(rows) for rows in serial}) == 4
    made = dict(results_of(calls, jobs=2))
    assert [made[i] for i in range(4)] == serial


def test_no_seeds_are_refused():
    with pytest.raises(AgentError, match="name at least one"):
        evaluate(Fixed(0.0, 0.0), seeds=())


def test_motion_is_that_of_the_reward():
    agent = Fixed(0.7, 0.1)
    (row,) = evaluate(agent, seeds=(5,), task="seakeeping", max_episode_steps=20, sea="3")
    env = gym.make(
        "USVTwin-v0",
        **{"observation": "raw", "sea": "3", "task": "seakeeping", "dof": 6, "twin": None},
        **{"frame_skip": 10, "max_episode_steps": 20},
    )
    env.reset(seed=5)
    terms = [env.step(np.array([0.7, 0.1]))[4]["reward_terms"]["motion"] for _ in range(20)]
    assert row["motion"] == pytest.approx(-np.mean(terms) / (0.5 * 10))
    assert 0.01 < row["motion"] < 4.0
    (without,) = evaluate(agent, seeds=(5,), max_episode_steps=5)
    assert without["motion"] is None


def test_forecasts_are_graded_on_episodes_of_agents_that_see_no_twin(tmp_path):
    agent = make_controller("los")
    options = {"sea": "2", "faults": "gps10@10", "max_episode_steps": 60}
    rows = evaluate(agent, seeds=[3, 4], log_dir=tmp_path, label="runs/los", **options)
    for row in rows:
        scores = row["twin_forecast"]
        assert scores["n"] > 0
        assert scores["n_loss"] > 0
        log = Log.read(tmp_path / f"runs_los_sea2_gps10@10_{row['seed']}.csv")
        assert log.t[-1] == pytest.approx(row["length_s"])
        assert log.truth is not None
        assert Particulars.load(tmp_path / f"runs_los_sea2_gps10@10_{row['seed']}.toml").length > 0
    whole = mean_scores([row["twin_forecast"] for row in rows])
    parts = [row["twin_forecast"] for row in rows]
    name = "known_loss_10s_displacement_m"
    weighed = sum(one[name] * one["n_loss"] for one in parts)
    assert whole[name] == pytest.approx(weighed / whole["n_loss"])
