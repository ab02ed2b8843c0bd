"""Training: reproducible, resumable, and a policy file that is what was trained."""

import numpy as np
import pytest

import usv_gym  # noqa: F401 - registers the environment

pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed")
pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed")

from twin.agents import training
from twin.agents.evaluation import EVALUATION_SEEDS, FIRST_TRAINING_SEED, make_envs
from twin.agents.hyperparameters import ALGORITHMS, CORRECTING, hyperparameters, schedule
from twin.agents.policy import AgentError, Policy
from twin.agents.training import CURVE_SEEDS, Plan, Run, train

SMALL = {
    "ppo": {"n_envs": 4, "n_steps": 16, "batch_size": 32, "n_epochs": 2},
    "sac": {"n_envs": 4, "learning_starts": 32, "batch_size": 16, "gradient_steps": 1},
    "recurrent_ppo": {"n_envs": 4, "n_steps": 16, "batch_size": 32, "n_epochs": 2},
    "ppo-residual": {"n_envs": 4, "n_steps": 16, "batch_size": 32, "n_epochs": 2},
    "ppo-mpc": {"n_envs": 4, "n_steps": 16, "batch_size": 32, "n_epochs": 2},
}


def plan(algo="ppo", **changes):
    nominal = {"observation": "raw", "steps": 300, "every": 128, "max_episode_steps": 12}
    if algo in CORRECTING:  # the controllers need the twin
        nominal["observation"] = "compact"
    return Plan(algo, **(nominal | changes))


def run(tmp_path, algo="ppo", name="run", hyper=(), **changes):
    small = hyperparameters(algo) | SMALL[algo] | dict(hyper)
    return train(plan(algo, **changes), tmp_path / name, hyper=small, curve_seeds=(1, 2, 3))


def curve(found: Run):
    return [
        {key: value for key, value in row.items() if key not in ("wall_s", "cpu_s")}
        for row in found.curve
    ]


def same(a: Policy, b: Policy) -> bool:
    return all(
        np.array_equal(x, y)
        for one, other in zip(a.layers, b.layers, strict=True)
        for x, y in zip(one, other, strict=True)
    ) and np.array_equal(a.sd, b.sd)


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_a_run_that_crashed_goes_on_as_if_it_had_not(tmp_path, algo, monkeypatch):
    hyper = {"buffer_size": 40 * 4} if algo == "sac" else {}  # the buffer is full before the end
    whole = run(tmp_path, algo, "whole", hyper)
    last = {"sac": 300}.get(algo, 320)  # those on policy end with a whole rollout
    assert [row["decisions"] for row in whole.curve] == [0, 128, 256, last]
    save = training._Learner._save

    def dies(self):
        if self.model.num_timesteps == 256:
            raise KeyboardInterrupt
        save(self)

    with monkeypatch.context() as patched:
        patched.setattr(training._Learner, "_save", dies)
        with pytest.raises(KeyboardInterrupt):
            run(tmp_path, algo, "stopped", hyper)
    assert (tmp_path / "stopped" / "checkpoint.pt").exists()
    with pytest.raises(AgentError, match="has not ended"):
        Run.of(tmp_path / "stopped")
    stopped = run(tmp_path, algo, "stopped", hyper)
    assert curve(stopped) == curve(whole)
    spent = [row["cpu_s"] for row in stopped.curve]
    assert spent == sorted(spent) and spent[0] < spent[-1]  # over both parts
    assert same(stopped.policy, whole.policy)
    left = {path.name for path in (tmp_path / "stopped").iterdir()}
    assert left == {"run.json", "curve.csv", "policy.npz", "log"}
    logs = {path.name for path in (tmp_path / "stopped" / "log").glob("*.csv")}
    assert logs == {"progress_0.csv", "progress_128.csv"}


def test_a_run_that_is_done_stays_as_it_is_and_another_one_is_refused(tmp_path):
    first = run(tmp_path)
    before = (tmp_path / "run" / "policy.npz").stat().st_mtime_ns
    again = run(tmp_path)
    assert again.curve == first.curve
    assert (tmp_path / "run" / "policy.npz").stat().st_mtime_ns == before
    with pytest.raises(AgentError, match="is a run with steps = 300, not 500"):
        run(tmp_path, steps=500)
    with pytest.raises(AgentError, match="is a run with hyper"):
        run(tmp_path, hyper={"n_epochs": 3})


@pytest.mark.parametrize("algo", ["ppo", "sac", "recurrent_ppo"])
def test_a_policy_file_is_what_stable_baselines3_predicts(tmp_path, algo):
    from stable_baselines3.common.vec_env import VecNormalize

    from usv_gym.envs.sb3 import SB3VecEnv

    small = hyperparameters(algo) | SMALL[algo]
    learner = training._Learner(plan(algo), tmp_path, small, (1,))
    learner.learn(False)
    model, envs = learner.model, learner.envs
    path = tmp_path / "policy.npz"
    learner.policy({"algo": algo}).save(path)
    assert path.stat().st_size < 200_000
    policy = Policy.load(path)
    assert policy.settings == {"algo": algo} and policy.observation == "raw"
    mine = make_envs(4, observation="raw", max_episode_steps=12)
    obs, _ = mine.reset(seed=5)
    policy.begin(mine)
    state, starts = None, np.ones(4, dtype=bool)
    for _ in range(11):
        normal = envs.normalize_obs(obs)
        expected, state = model.predict(normal, state, starts, deterministic=True)
        actions = policy.act(obs)
        np.testing.assert_allclose(actions, expected, atol=1e-5)
        starts = np.zeros(4, dtype=bool)
        obs, *_ = mine.step(actions)
    assert np.ptp(actions) > 1e-3
    mine.close()
    assert isinstance(envs, VecNormalize) and isinstance(envs.unwrapped, SB3VecEnv)


def test_a_policy_refuses_other_observations_and_files(tmp_path):
    policy = run(tmp_path).policy
    with pytest.raises(AgentError, match="trained on 23 entries of the observation set 'raw'"):
        policy.begin(make_envs(2, observation="twin"))
    wrong = tmp_path / "wrong.npz"
    np.savez(wrong, notes=np.array([{"a": 1}], dtype=object))
    with pytest.raises(AgentError, match="is cut off or damaged"):
        Policy.load(wrong)


def test_no_training_sees_a_boat_that_evaluates():
    assert not set(EVALUATION_SEEDS) & set(CURVE_SEEDS)
    assert max(EVALUATION_SEEDS + CURVE_SEEDS) < FIRST_TRAINING_SEED


def test_a_linear_learning_rate_falls_to_zero():
    rate = schedule("learning_rate", "lin_1e-3")
    assert [rate(left) for left in (1.0, 0.5, 0.0)] == [1e-3, 5e-4, 0.0]
    assert schedule("learning_rate", 3e-4) == 3e-4


def test_what_never_began_does_not_block_its_folder(tmp_path):
    with pytest.raises(ValueError, match="no sea state"):
        run(tmp_path, sea="2,4")
    run(tmp_path, sea="2", steps=64)


def test_a_damaged_checkpoint_is_named(tmp_path, monkeypatch):
    def dies(self):
        save(self)
        raise KeyboardInterrupt

    save = training._Learner._save
    with monkeypatch.context() as patch:
        patch.setattr(training._Learner, "_save", dies)
        with pytest.raises(KeyboardInterrupt):
            run(tmp_path)
    checkpoint = tmp_path / "run" / "checkpoint.pt"
    for damaged in (b"garbage", checkpoint.read_bytes()[:-100]):
        checkpoint.write_bytes(damaged)
        with pytest.raises(AgentError, match="damaged"):
            run(tmp_path)


def test_there_is_nothing_to_learn_without_a_reward():
    with pytest.raises(AgentError, match="has no reward"):
        plan(task="free")


def test_wrong_plans_are_named():
    for wrong in ({"algo": "dqn"}, {"observation": "eyes"}, {"steps": 0}, {"seed": -1}):
        name, value = next(iter(wrong.items()))
        with pytest.raises(AgentError, match=f"{name} = {value!r}"):
            plan(**wrong)


@pytest.mark.parametrize(
    "text", ["n_steps =", "steps = 3", '[policy_kwargs]\nactivation_fn = "gelu"', None]
)
def test_wrong_files_of_hyperparameters_are_named(tmp_path, text):
    file = tmp_path / "mine.toml"
    if text is not None:
        file.write_text(text)
    with pytest.raises(AgentError, match=r"mine\.toml"):
        hyperparameters("ppo", file)


@pytest.mark.parametrize(
    ("algo", "hyper", "said"),
    [
        ("recurrent_ppo", {"policy_kwargs": {"n_lstm_layers": 2}}, "n_lstm_layers"),
        ("ppo", {"normalize": {"gamma": 0.9}}, "gamma"),
        ("ppo", {"normalize": 1}, "normalize = 1"),
        ("ppo", {"policy_kwargs": {"activation_fn": ["tanh"]}}, "activation_fn"),
        ("ppo", {"learning_rate": "log_3"}, "learning_rate"),
        ("ppo", {"clip_range": "fast"}, "clip_range"),
        ("ppo", {"gamma": "x"}, "gamma"),
        ("ppo", {"batch_size": 0}, "hyperparameters of ppo"),
        ("ppo", {"n_envs": 0}, "n_envs = 0"),
        ("ppo", {"residual": {"share": 0.5}}, "residual"),
        ("ppo", {"reward": {"scale": -1.0}}, "scale"),
        ("ppo", {"reward": {"least": "low"}}, "least"),
        ("ppo", {"reward_weights": 3.0}, "reward_weights"),
        ("ppo-residual", {"residual": {"base": "los-dr"}}, "base"),
        ("ppo-residual", {"residual": {"share": "half"}}, "share"),
        ("ppo-residual", {"residual": {"gain": 1.0}}, "gain"),
    ],
)
def test_wrong_hyperparameters_are_named_and_leave_no_run(tmp_path, algo, hyper, said):
    with pytest.raises(AgentError, match=said):
        run(tmp_path, algo, hyper=hyper)
    assert not (tmp_path / "run" / "run.json").exists()
