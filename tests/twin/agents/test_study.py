"""The study: its statistics against known answers, and a tiny one from end to end."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from scipy import stats
from typer.testing import CliRunner

from twin.agents import study, study_report
from twin.agents.policy import AgentError, Policy
from twin.agents.study import Settings, iqm, replicates
from twin.sim.wrapper import OBSERVATIONS

pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed")
pytest.importorskip("tensorboard", reason="tensorboard is not installed")

from twin.agents.training import hyperparameters

TINY = Settings(
    arms=(("ppo", "raw"), ("ppo", "twin"), ("ppo", "oracle")),
    steps=128,
    seeds=(0, 1),
    controllers=("idle",),
    seas=("0", "2"),
    outages=("none", "gps10@1"),
    evaluation_seeds=(1, 2, 3, 4),
    curve_seeds=(5, 6),
    options={"max_episode_steps": 8, "every": 128},
    hyper={
        "ppo": hyperparameters("ppo")
        | {"n_envs": 4, "n_steps": 16, "batch_size": 32, "n_epochs": 1}
    },
)


class Idle:
    name, observation = "idle", "raw"

    def begin(self, envs):
        self.n = envs.num_envs

    def act(self, obs):
        return np.zeros((self.n, 2))


@pytest.fixture(autouse=True)
def one_controller(monkeypatch):
    monkeypatch.setattr(study, "controllers", lambda: {"idle": Idle})


def test_interquartile_means_are_scipys():
    rng = np.random.default_rng(0)
    for size in (3, 4, 5, 20, 61):
        values = rng.normal(size=(7, size))
        np.testing.assert_allclose(iqm(values), stats.trim_mean(values, 0.25, axis=1))
    gone = np.append(values[0], [np.nan] * 9)
    assert iqm(gone) == pytest.approx(stats.trim_mean(values[0], 0.25))
    assert np.isnan(iqm(np.full(3, np.nan)))


def test_intervals_cover_the_true_value_as_often_as_they_say():
    rng = np.random.default_rng(1)
    covered = 0
    for trial in range(200):
        scores = rng.normal(3.0, 1.0, (1, 1, 40))
        low, high = study.interval(replicates([scores], trial)[0])
        covered += low <= 3.0 <= high
    assert 178 <= covered <= 199  # 95 % of 200, with what chance and 40 episodes allow


def test_agents_are_compared_on_the_same_episodes():
    rng = np.random.default_rng(2)
    hard = rng.normal(0.0, 10.0, (3, 1, 20))  # how hard an episode is
    first, second = replicates([hard + 1.0, hard])
    np.testing.assert_allclose(first - second, 1.0)
    runs = np.repeat([[[0.0]], [[1.0]]], 20, axis=2).reshape(1, 2, 20)
    assert set(np.unique(replicates([runs])[0])) <= {0.0, 0.5, 1.0}  # whole runs are drawn


def made(levels, settings=TINY):
    """Results of agents that are so far off the path, whatever the sea, by outage."""
    rng = np.random.default_rng(3)
    done = {}
    for piece in study.pieces(settings):
        rows = []
        for sea in settings.seas:
            for faults in settings.outages:
                level = levels[piece[1] or piece[0]][settings.outages.index(faults)]
                for seed in settings.evaluation_seeds:
                    off = level + rng.normal(0.0, 0.01)
                    rows.append(
                        {
                            **{"sea": sea, "faults": faults, "seed": seed, "off_path_m": off},
                            **{"return": -off, "failed": False, "twin_forecast": {}},
                            "off_path_outage_m": None if faults == "none" else off,
                        }
                    )
        curve = [{"decisions": 0.0, "off_path_m": 9.0}, {"decisions": 128.0, "off_path_m": 3.0}]
        done[piece] = {"rows": rows, "curve": curve, "level": 2.0}
    return done


def test_the_share_of_the_gap_and_where_the_twin_does_not_help():
    levels = {"raw": (2.0, 6.0), "twin": (2.0, 3.0), "oracle": (2.0, 2.0), "idle": (9.0, 9.0)}
    results = study.collect(TINY, made(levels), "a command")
    gaps = {(gap["metric"], gap["faults"]): gap for gap in results["gaps"]}
    for metric in ("off_path_m", "return", "off_path_outage_m"):
        gap = gaps[metric, "gps10@1"]
        assert gap["closed"] == pytest.approx(0.75, abs=0.02)
        assert gap["low"] < 0.75 < gap["high"] and gap["high"] - gap["low"] < 0.1
    assert gaps["off_path_m", "none"]["closed"] is None  # there is no gap to close
    assert ("off_path_outage_m", "none") not in gaps
    verdicts = {(row["sea"], row["faults"]): row["verdict"] for row in results["helps"]}
    assert verdicts["0", "gps10@1"] == "helps"
    assert verdicts["0", "none"] == "no difference shown"
    text = study_report.markdown(results)
    assert "| ppo-twin | off_path_m | no gap | 75% [" in text
    assert "ppo: the twin helps in 2 of 4 sea states and outages." in text
    assert "it does not help in sea state 2 with none: no difference shown" in text
    # where the truth is of no use, no part of its use is closed
    useless = study.collect(TINY, made(levels | {"oracle": (8.0, 8.0)}), "a command")
    assert {gap["closed"] for gap in useless["gaps"]} == {None}
    worse = levels | {"twin": (4.0, 7.0)}
    results = study.collect(TINY, made(worse), "a command")
    assert {row["verdict"] for row in results["helps"]} == {"harms"}


def test_without_a_gap_to_show_there_is_no_picture_of_it(tmp_path):
    alone = dataclasses.replace(TINY, arms=(("ppo", "twin"),))
    levels = {"twin": (2.0, 3.0), "idle": (9.0, 9.0)}
    results = study.collect(alone, made(levels, alone), "a command")
    (tmp_path / "gap.png").touch()  # of an earlier study
    written = study_report.pictures(results, tmp_path)
    assert {path.name for path in written} == {"off_path.png", "curves.png"}
    assert set(tmp_path.iterdir()) == set(written)


def test_every_observation_set_has_a_colour_of_its_own():
    assert set(study_report.COLOURS) == set(OBSERVATIONS)
    assert len(set(study_report.COLOURS.values())) == len(OBSERVATIONS)


def test_a_tiny_study_goes_on_and_comes_to_the_same_numbers(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "REPLICATES", 100)
    first = study.work(TINY, tmp_path / "a")
    done = dict([next(first), next(first)])
    first.close()
    assert set(done) == {("idle", "", None), ("ppo", "raw", 0)}
    policy = tmp_path / "a" / "runs" / "ppo-raw-0" / "policy.npz"
    before = policy.stat().st_mtime_ns
    results = {}
    for name in "ab":
        done = dict(study.work(TINY, tmp_path / name))
        assert len(done) == 7
        results[name] = study.collect(TINY, done, "a command")
        study_report.write(results[name], TINY, done, tmp_path / name)
    assert policy.stat().st_mtime_ns == before
    for part in ("cells", "gaps", "helps", "episodes", "levels"):
        assert results["a"][part] == results["b"][part]
    written = json.loads((tmp_path / "a" / "results.json").read_text())
    assert written["cells"] == results["a"]["cells"]
    assert written["settings"]["steps"] == 128
    assert {cell["sea"] for cell in written["cells"]} == {"all", "0", "2"}
    for picture in ("off_path.png", "gap.png", "curves.png"):
        assert (tmp_path / "a" / picture).read_bytes().startswith(b"\x89PNG")
    shipped = Policy.load(tmp_path / "a" / "policies" / "ppo-twin.npz")
    assert shipped.observation == "twin" and shipped.settings["steps"] == 128
    # other episodes: the policies stay, and are evaluated again
    other = dataclasses.replace(TINY, evaluation_seeds=(8, 9))
    again = dict(study.work(other, tmp_path / "a"))
    assert {row["seed"] for row in again["ppo", "twin", 1]["rows"]} == {8, 9}
    assert policy.stat().st_mtime_ns == before


def test_what_cannot_be_done_is_said_at_once():
    with pytest.raises(AgentError, match="no controller is called 'pilot'; known: idle"):
        study.check(dataclasses.replace(TINY, controllers=("pilot",)))
    with pytest.raises(AgentError, match="known: ppo, sac"):
        study.check(dataclasses.replace(TINY, arms=(("dqn", "raw"),)))
    with pytest.raises(AgentError, match="needs a seed"):
        study.check(dataclasses.replace(TINY, seeds=()))


def test_commands_print_the_study(tmp_path, monkeypatch):
    from twin.cli.main import app

    hyper = tmp_path / "tiny.toml"
    hyper.write_text("n_envs = 4\nn_steps = 16\nbatch_size = 32\nn_epochs = 1\n")
    runs = tmp_path / "runs"

    def said(*arguments, code=0):
        result = CliRunner().invoke(app, [str(argument) for argument in arguments])
        assert result.exit_code == code, result.output
        return result.output

    asked = ("train", "--obs", "raw", "--steps", 64, "--seeds", "0-1", "--hyper", hyper)
    asked = (*asked, "--sea", "0", "--faults", "none", "--out", runs)
    assert "ppo-raw, 64 decisions" in said(*asked)
    assert (runs / "ppo-raw-1" / "policy.npz").exists()
    said(*asked)  # done: at once
    assert "is a run with sea = 0, not 2" in " ".join(
        said(*asked[:-4], "--sea", "2", "--out", runs, "--faults", "none", code=2).split()
    )
    file = tmp_path / "episodes.json"
    output = said(
        "evaluate",
        runs,
        "idle",
        runs / "ppo-raw-0" / "policy.npz",
        "--seeds",
        "1-2",
        "--sea",
        "0",
        "--faults",
        "none",
        "--json",
        file,
    )
    assert "idle" in output
    rows = json.loads(file.read_text())
    assert len(rows) == 8 and rows[0]["agent"] == "ppo-raw"
    assert "no such folder, policy or controller" in said("evaluate", "pilot", code=2)
    assert rows[0]["task"] == "path" and rows[0]["frame_skip"] == 10
    (tmp_path / "mine.py").write_text(
        "import numpy as np\n"
        "class Mine:\n"
        "    name, observation = 'mine', 'raw'\n"
        "    def begin(self, envs): self.n = envs.num_envs\n"
        "    def act(self, obs): return np.zeros((self.n, 2))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    output = said("evaluate", "mine:Mine", "--seeds", "1", "--sea", "0", "--faults", "none")
    assert "mine" in output
    assert "write module:Class" in said("evaluate", "mine:Nobody", code=2)
    other = tmp_path / "station.npz"
    policy = Policy.load(runs / "ppo-raw-0")
    policy.settings["task"] = "station"
    policy.save(other)
    output = " ".join(said("evaluate", runs, other, "--seeds", "1", code=2).split())
    assert "were trained with task = path, station" in output
    with pytest.raises(AgentError, match=r"sees 23 entries .* not 4"):
        policy.act(np.zeros((1, 4)))
    assert policy.act(np.zeros(23)).shape == (2,)
    assert "algo = 'dqn'" in said("train", "--algo", "dqn", code=2)
    assert "no task is called 'swim'" in said("train", "--task", "swim", "--out", runs, code=2)

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(study, "work", interrupt)
    assert "continues from there" in said("study", "--out", tmp_path / "study", code=130)
