"""What a training may be given: a controller to correct, weights of rewards, entries, threads."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed")
pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed")

from tests.twin.agents.test_training import SMALL
from tests.twin.cli.command import run as command
from twin.agents import training
from twin.agents.controllers import LOS, make_controller
from twin.agents.evaluation import evaluate, make_envs, trained_with
from twin.agents.hyperparameters import hyperparameters
from twin.agents.policy import AgentError, Policy
from twin.agents.residual import ResidualVecEnv, ScaledReward
from twin.agents.training import Plan, train
from usv_gym.envs.sb3 import SB3VecEnv

LAST = {"max_episode_steps": 12, "sea": "2", "faults": "none"}


def tiny(algo="ppo", **changes):
    return hyperparameters(algo) | SMALL["ppo"] | changes


def learner(tmp_path, algo="ppo", hyper=None, **options):
    plan = Plan(algo, **{"observation": "compact", "steps": 64, **LAST, **options})
    return training._Learner(plan, tmp_path, tiny(algo) if hyper is None else hyper, (1,))


def run(folder, algo="ppo", hyper=None, **options):
    num_threads = options.pop("num_threads", 1)
    plan = Plan(algo, **{"observation": "compact", "steps": 128, "every": 64, **LAST, **options})
    given = tiny(algo) if hyper is None else hyper
    return train(plan, folder, hyper=given, curve_seeds=(1, 2), num_threads=num_threads)


# ------------------------------------------------- corrections of a controller


def corrected(n=3, share=0.5, **options):
    from twin.sim.compact import COMPACT

    base = LOS("los-twin", "twin", "twin_")
    names = [*(one.name for one in COMPACT), *base.entries]
    made = make_envs(n, observation=names, autoreset_mode="SameStep", **options)
    return ResidualVecEnv(SB3VecEnv(made), base, share, len(COMPACT))


@pytest.mark.parametrize(
    ("algo", "base"), [("ppo-residual", "los-twin"), ("ppo-mpc", "mpc-steady")]
)
def test_an_untrained_residual_sails_as_its_controller_does(tmp_path, algo, base):
    found = learner(tmp_path, algo)
    net = found.model.policy.action_net
    net.weight.data.zero_()
    assert not net.bias.data.any()
    policy = found.policy({})
    found.envs.close()
    rows, expected = (
        evaluate(agent, seeds=(1, 2), faults="gps10@1", max_episode_steps=40)
        for agent in (policy, make_controller(base))
    )
    for row, other in zip(rows, expected, strict=True):
        assert row["off_path_m"] == other["off_path_m"] and row["return"] == other["return"]


def test_a_saved_residual_acts_as_in_its_training(tmp_path):
    found = learner(tmp_path, "ppo-residual")
    found.learn()
    path = tmp_path / "policy.npz"
    found.policy({}).save(path)
    policy = Policy.load(path)
    assert (policy.base, policy.share, len(policy.mean)) == ("los-twin", 0.5, 16)
    assert policy.name == "ppo-residual-compact" and list(policy.names) == policy.observation
    boats = corrected(3, max_episode_steps=100)
    boats.seed(5)
    seen = boats.reset()
    envs = make_envs(3, observation=policy.observation, max_episode_steps=100)
    obs, _ = envs.reset(seed=5)
    policy.begin(envs)
    for _ in range(30):
        correction, _ = found.model.predict(seen, deterministic=True)
        seen = boats.step(correction)[0]
        action = policy.act(obs)
        np.testing.assert_allclose(action, boats.envs.episodes.actions[1], atol=1e-5)
        obs, *_ = envs.step(action)
        np.testing.assert_allclose(seen[:, :14], obs[:, :14], atol=2e-2)
    assert np.ptp(correction) > 0.0
    found.envs.close()


@pytest.mark.parametrize(
    ("algo", "base", "memory"),
    [("ppo-residual", "los-twin", "_drift"), ("ppo-mpc", "mpc-steady", "_plans")],
)
def test_a_controller_forgets_a_boat_where_its_episode_ends(tmp_path, algo, base, memory):
    found = learner(tmp_path, algo, sea="4")
    boats = found.envs.venv.venv
    boats.set_options({"first_episode_steps": np.array([8, 12, 9, 12])})
    boats.seed(1)
    boats.reset()
    for k in range(9):
        seen, _, dones, infos = boats.step(np.full((4, 2), 0.1))
        assert dones.tolist() == [k == 7, False, k == 8, False]
        for i in np.flatnonzero(dones):
            last = infos[i]["terminal_observation"]
            assert last.shape == seen[i].shape and not np.array_equal(last, seen[i])
            fresh = make_controller(base)
            fresh.begin(boats.envs)
            fresh.act(boats.envs._shown())
            held, new = getattr(boats.base, memory), getattr(fresh, memory)
            np.testing.assert_array_equal(held[i], new[i])
            assert not np.array_equal(held[1], new[1])
    found.envs.close()


def test_a_correction_is_a_share_of_the_action():
    boats, plain = corrected(2, share=0.25, sea="0"), corrected(2, sea="0")
    for one in (boats, plain):
        one.seed(3)
        one.reset()
    boats.step(np.array([[0.4, -0.2], [-8.0, 8.0]]))
    plain.step(np.zeros((2, 2)))
    based = plain.envs.episodes.actions[1]
    expected = np.clip(based + 0.25 * np.array([[0.4, -0.2], [-8.0, 8.0]]), -1.0, 1.0)
    np.testing.assert_allclose(boats.envs.episodes.actions[1], expected)


def test_rewards_are_scaled_and_bounded_below():
    boats = ScaledReward(corrected(2, sea="0"), 0.1, -0.5)
    plain = corrected(2, sea="0")
    for one in (boats, plain):
        one.seed(3)
        one.reset()
    for _ in range(4):
        rewards = [one.step(np.array([[0.0, 0.0], [-2.0, 2.0]]))[1] for one in (boats, plain)]
        np.testing.assert_array_equal(
            rewards[0], np.maximum(np.float32(0.1) * rewards[1], np.float32(-0.5))
        )


# ------------------------------------------------- what a training is given


def test_entries_spread_and_weights_reach_the_boats(tmp_path):
    seen = ("compact_cross_track", "compact_sin_course_error", "gps_age")
    given = {"observation": seen, "vessel_spread": 0.2, "reward_weights": {"effort": 7.0}}
    found = learner(tmp_path, **given)
    envs = found.envs.unwrapped.envs
    assert envs.observation_names == seen
    # progress, cross track, effort, failure
    assert envs.task.rules["weights"][:4].tolist() == [1.0, 3.0, 7.0, 1.0]
    factors = envs.reset(seed=3)[1]["drawn"]["vessel_factors"]
    assert len({one.mass for one in factors}) == 4
    found.envs.close()
    policy = run(tmp_path / "run", **given).policy
    assert policy.name == "ppo-3-entries" and policy.settings["vessel_spread"] == 0.2
    (row,) = evaluate(policy, seeds=(1,), max_episode_steps=5, vessel_spread=0.2)
    assert row["agent"] == "ppo-3-entries"


def test_an_agent_is_evaluated_in_the_world_of_its_training(tmp_path):
    run(tmp_path / "run", world={"current": (0.4, 90.0)})
    policy = Policy.load(tmp_path / "run")
    options = trained_with([policy], {})
    assert options["current"] == [0.4, 90.0] and "sea" not in options
    envs = make_envs(1, observation="compact", **options)
    assert envs.reset(seed=1)[1]["drawn"]["current_mps"] == pytest.approx(0.4)
    other = run(tmp_path / "other").policy
    with pytest.raises(AgentError, match="were trained in other worlds"):
        trained_with([policy, other], {})
    assert trained_with([policy, other], {"current": "any"})["current"] == "any"


def test_docking_is_corrected_by_default_with_the_controller_that_docks(tmp_path):
    found = learner(tmp_path, "ppo-residual", task="docking")
    assert found.base == "dock-twin"
    found.learn()
    policy = found.policy({})
    found.envs.close()
    assert evaluate(policy, seeds=(1,), task="docking", max_episode_steps=10)[0]["length_s"] > 0.0


def test_the_commands_train_and_evaluate(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("tiny.toml").write_text("n_envs = 4\nn_steps = 16\nbatch_size = 32\nn_epochs = 1\n")
    calm = ("--sea", "0", "--faults", "none")
    words = ("train", "--steps", 64, "--hyper", "tiny.toml", *calm)
    more = ("--reward-weight", "effort=2", "--vessel-spread", "0.1", "--num-threads", 2)
    more += ("--wind-from", "any", "--current", "0.3", "--seeds", "0-1")
    seen = ("--obs", "twin_cross_track,twin_sin_course_error,twin_yaw_rate")
    said = " ".join(command(*words, *more, *seen).output.split())
    assert "ppo-3-entries, 64 decisions" in said
    policy = Policy.load("runs/ppo-3-entries-1")
    assert policy.settings["reward_weights"] == {"effort": 2.0}
    assert policy.settings["vessel_spread"] == 0.1
    assert policy.settings["world"] == {"wind_from_deg": "any", "current": 0.3}
    rows = ("evaluate", "runs", "los", "runs/ppo-3-entries-0/policy.npz", "--seeds", "1-2", *calm)
    command(*rows, "--json", "episodes.json", "--current", "any")
    found = json.loads(Path("episodes.json").read_text())
    assert len(found) == 8 and found[0]["agent"] == "ppo-3-entries"
    assert (found[0]["vessel_spread"], found[0]["current"]) == (0.1, "any")
    for wrong, error in (
        (("--reward-weight", "effort"), "cross_track=3"),
        (("--reward-weight", "joy=2"), "'joy'"),
        (("--current", "strong"), "--current strong"),
        (("--obs", "twin_crosstrack,"), "(did you mean 'twin_cross_track'?)"),
        (("--algo", "dqn"), "'dqn'"),
        (("--task", "swim"), "'swim'"),
        ((*seen, "--sea", "2", "--out", "runs"), "sea = 0"),
    ):
        output = command(*words, "--out", "wrong", *wrong, check=2).output
        assert error in " ".join(output.split())


def test_agents_of_ones_own_are_evaluated(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(
        "import numpy as np\n"
        "class Mine:\n"
        "    name, observation = 'mine', 'raw'\n"
        "    def begin(self, envs): self.n = envs.num_envs\n"
        "    def act(self, obs): return np.zeros((self.n, 2))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    words = ("--seeds", "1", "--sea", "0", "--faults", "none")
    assert "mine" in command("evaluate", "mine:Mine", *words).output
    for wrong in ("mine:Nobody", "pilot"):
        assert wrong in command("evaluate", wrong, *words, check=2).output
