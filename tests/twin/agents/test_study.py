"""The study: its statistics against known answers, and a tiny one from end to end."""

from __future__ import annotations

import dataclasses
import itertools
import json

import numpy as np
import pytest
from scipy import stats
from typer.testing import CliRunner

from twin.agents.policy import AgentError, Policy
from twin.agents.study import pictures, report, results, runs, settings, statistics
from twin.agents.study.settings import CONDITIONS, Condition, Settings
from twin.agents.study.statistics import iqm, replicates
from twin.sim.wrapper import OBSERVATIONS

pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed")
pytest.importorskip("tensorboard", reason="tensorboard is not installed")

from twin.agents.training import hyperparameters

SMALL = {"n_envs": 4, "n_steps": 16, "batch_size": 32, "n_epochs": 1}

TINY = Settings(
    arms=(("ppo", "compact_raw"), ("ppo", "compact"), ("ppo", "compact_oracle")),
    steps=128,
    seeds=(0, 1),
    losses=("none", "gps10@1"),
    conditions={
        "protocol": Condition("plain", ("0", "2"), (1, 2, 3, 4)),
        "spread .30": Condition("any boat", ("2",), (1, 2, 3, 4), {"vessel_spread": 0.3}),
    },
    curve_seeds=(5, 6),
    options={"max_episode_steps": 8, "every": 128},
    hyper={"ppo": hyperparameters("ppo") | SMALL},
)


@pytest.fixture(autouse=True)
def two_controllers(monkeypatch):
    """Line of sight alone: predictive control is slow, and tested where it lives."""
    path = dataclasses.replace(
        settings.STUDIES["path"], controllers=("los", "los-twin"), against=("los-twin",)
    )
    monkeypatch.setitem(settings.STUDIES, "path", path)
    monkeypatch.setattr(statistics, "REPLICATES", 200)


def test_interquartile_means_are_scipys():
    rng = np.random.default_rng(0)
    for size in (3, 4, 5, 20, 61):
        values = rng.normal(size=(7, size))
        np.testing.assert_allclose(iqm(values), stats.trim_mean(values, 0.25, axis=1))
    gone = np.append(values[0], [np.nan] * 9)
    assert iqm(gone) == pytest.approx(stats.trim_mean(values[0], 0.25))
    assert statistics.mean(gone) == pytest.approx(values[0].mean())
    for statistic in statistics.STATISTICS.values():
        assert np.isnan(statistic(np.full(3, np.nan)))


def test_intervals_cover_the_true_value_as_often_as_they_say(monkeypatch):
    monkeypatch.setattr(statistics, "REPLICATES", 2000)
    rng = np.random.default_rng(1)
    covered = 0
    for trial in range(200):
        scores = rng.normal(3.0, 1.0, (1, 1, 40))
        low, high = statistics.interval(replicates({"one": scores}, seed=trial)["one"])
        covered += low <= 3.0 <= high
    assert 178 <= covered <= 199  # 95 % of 200, with what chance and 40 episodes allow


def test_agents_are_compared_on_the_same_episodes():
    rng = np.random.default_rng(2)
    hard = rng.normal(0.0, 10.0, (3, 1, 20))  # how hard an episode is
    drawn = replicates({"first": hard + 1.0, "second": hard})
    np.testing.assert_allclose(drawn["first"] - drawn["second"], 1.0)
    runs_only = np.repeat([[[0.0]], [[1.0]]], 20, axis=2).reshape(1, 2, 20)
    # whole runs are drawn
    assert set(np.unique(replicates({"one": runs_only})["one"])) <= {0.0, 0.5, 1.0}


def test_boats_of_a_seed_are_drawn_together_for_all_losses():
    boats = np.random.default_rng(3).normal(0.0, 1.0, (1, 1, 20))
    alone = replicates({"one": boats}, statistics.mean)["one"]
    thrice = replicates({"one": np.repeat(boats, 3, axis=0)}, statistics.mean)["one"]
    # three looks at the same boats say no more than one
    assert np.ptp(statistics.interval(thrice)) == pytest.approx(
        np.ptp(statistics.interval(alone)), rel=0.3
    )


def test_numbers_of_an_agent_stay_the_same_with_others():
    rng = np.random.default_rng(4)
    one, other = rng.normal(size=(2, 2, 5, 20))
    both = replicates({"other": other, "one": one})
    np.testing.assert_array_equal(replicates({"one": one})["one"], both["one"])
    # each has draws of its own of the runs
    assert not np.array_equal(*replicates({"one": one, "copy": one}).values())


@pytest.mark.parametrize(
    ("ends", "better", "said"),
    [
        ((0.1, 0.3), 1, "better"),
        ((0.1, 0.3), -1, "worse"),
        ((-0.3, -0.1), -1, "better"),
        ((-0.3, -0.1), 1, "worse"),
        ((-0.1, 0.1), 1, "no difference shown"),
        ((0.0, 0.1), 1, "no difference shown"),
    ],
)
def test_verdict_says_which_side_of_zero_is_better(ends, better, said):
    assert statistics.verdict(*ends, better) == said


def made(levels, given=TINY, metric="off_path_m"):
    """Results of agents with such scores by loss, whatever the condition."""
    rng = np.random.default_rng(3)
    done = {}
    for piece in settings.pieces(given):
        rows = []
        for name, condition in given.evaluated.items():
            for sea, k in itertools.product(condition.seas, range(len(given.losses))):
                for _seed in condition.seeds:
                    score = levels[settings.name_of(piece)][k]
                    row = {"off_path_m": 2.0, "success": True, "failed": False}
                    row |= {"condition": name, "sea": sea, "faults": given.losses[k]}
                    row |= {"length_s": 90.0, "return": 100.0}
                    row[metric] = (
                        bool(rng.random() < score)
                        if metric == "success"
                        else score + rng.normal(0.0, 0.01)
                    )
                    rows.append(row)
        done[piece] = {"rows": rows}
        if piece[1]:
            points = ((0, 0.0, 9.0, 0.0), (64, 1.5, 2.0, 0.5), (128, 3.0, 1.0, 1.0))
            names = "decisions", "cpu_s", "off_path_m", "success"
            done[piece]["curve"] = [{**dict(zip(names, at, strict=True)), "return": 1.0}
                                    for at in points]  # fmt: skip
        elif piece[0] == given.studied.level:
            done[piece]["level"] = 2.0 if metric == "off_path_m" else 0.75
    return done


LEVELS = {
    "los": (9.0, 9.0), "los-twin": (2.0, 3.0),
    "ppo-compact_raw": (1.0, 6.0), "ppo-compact": (1.0, 2.0), "ppo-compact_oracle": (1.0, 1.0),
}  # fmt: skip


def test_paired_tests_say_who_is_better_where():
    found = results.collect(TINY, made(LEVELS), "a command")
    said = {
        (row["agent"], row["against"], row["condition"], row["faults"]): row
        for row in found["paired"]
    }
    # three arms against line of sight, the twin, the truth: two conditions, two losses and all
    assert len(said) == len(found["paired"]) == 5 * 2 * 3
    for condition in TINY.conditions:
        lost = "gps10@1"
        row = said["ppo-compact", "ppo-compact_raw", condition, lost]
        assert row["verdict"] == "better" and row["question"] == "twin"
        assert row["low"] < row["difference"] < row["high"]
        assert row["difference"] == pytest.approx(-4.0, abs=0.02)
        assert said["ppo-compact_raw", "los-twin", condition, lost]["verdict"] == "worse"
        assert said["ppo-compact_raw", "los-twin", condition, "none"]["verdict"] == "better"
        assert said["ppo-compact", "ppo-compact_oracle", condition, lost]["verdict"] == "worse"
        none = said["ppo-compact", "ppo-compact_raw", condition, "none"]
        assert abs(none["difference"]) < 0.02
    text = report.markdown(report.rounded(found))
    best = report.best_arm(found)
    assert best == "ppo-compact_raw"  # all ends are equal, and the truth is none of the choices
    assert "`ppo-compact_raw` against `los-twin`, worse: protocol (gps10@1); spread .30" in text
    assert "30 pairs were tested" in text
    assert "| ppo-compact | 128 | 3 (3 to 3) | 1.00 (1.00 to 1.00) | 2 of 2 | 64 (64 to" in text


def test_cells_have_estimates_of_each_loss_and_of_all():
    found = results.collect(TINY, made(LEVELS), "a command")
    cells = {(row["agent"], row["condition"], row["faults"]): row for row in found["cells"]}
    assert len(cells) == len(found["cells"]) == 5 * 2 * 3
    cell = cells["ppo-compact_raw", "protocol", "gps10@1"]
    assert cell["off_path_m"] == pytest.approx(6.0, abs=0.02) and cell["runs"] == 2
    low, high = cell["off_path_m_ends"]
    assert low < cell["off_path_m"] < high and high - low < 0.05
    whole = cells["ppo-compact_raw", "protocol", "all"]
    assert whole["off_path_mean_m"] == pytest.approx(3.5, abs=0.02)
    assert whole["success"] == 1.0 and whole["length_s"] == 90.0


def test_docking_is_compared_by_its_successes():
    given = dataclasses.replace(TINY, task="docking")
    levels = {
        "dock-twin": (0.9, 0.9), "dock-oracle": (1.0, 1.0),
        "ppo-compact_raw": (0.9, 0.0), "ppo-compact": (1.0, 1.0), "ppo-compact_oracle": (1.0, 1.0),
    }  # fmt: skip
    many = Condition("any boat", ("2",), tuple(range(40)))
    given = dataclasses.replace(given, conditions={"protocol": many, "spread .30": many})
    found = results.collect(given, made(levels, given, "success"), "a command")
    assert {row["condition"] for row in found["cells"]} == {"spread .30"}  # no old protocol
    said = {(row["agent"], row["against"], row["faults"]): row for row in found["paired"]}
    assert said["ppo-compact_raw", "dock-twin", "gps10@1"]["verdict"] == "worse"
    assert said["ppo-compact", "ppo-compact_raw", "gps10@1"]["verdict"] == "better"
    curve = found["curves"][0]
    assert curve["level_decisions"] == 128 and curve["level_cpu_s"] == 3.0
    lost = next(row for row in found["episodes"] if row["agent"] == "dock-oracle")
    assert lost["success"] == "1" * 40


def test_time_of_a_success_counts_no_failure():
    done = made(LEVELS)
    for row in done["ppo", "compact", 0]["rows"]:
        row |= {"success": False, "length_s": 3.0}
    cells = results.collect(TINY, done, "a command")["cells"]
    cell = next(row for row in cells if row["agent"] == "ppo-compact")
    assert cell["length_s"] == 90.0 and cell["success"] == 0.5


def test_numbers_are_kept_to_four_figures_but_for_hyperparameters():
    given = {"a": [1.23456, 7.0, 8], "hyper": {"lr": 0.000123456}, "b": {"c": (0.000123456,)}}
    expected = {"a": [1.235, 7, 8], "hyper": {"lr": 0.000123456}, "b": {"c": [0.0001235]}}
    assert report.rounded(given) == expected


def test_results_of_a_whole_study_stay_below_a_megabyte(monkeypatch):
    rng = np.random.default_rng(5)
    monkeypatch.setattr(statistics, "REPLICATES", 20)
    whole = Settings()
    names = [settings.name_of(piece) for piece in settings.pieces(whole)]
    done = made({name: rng.uniform(1.0, 30.0, 4) for name in names}, whole)
    for piece in done:
        if piece[1]:
            done[piece]["curve"] *= 5
    text = json.dumps(report.rounded(results.collect(whole, done, "a command")))
    assert 300_000 < len(text) < 1_000_000


def test_every_observation_set_has_a_colour_of_its_own():
    assert set(pictures.COLOURS) == set(OBSERVATIONS)
    assert len(set(pictures.COLOURS.values())) == len(OBSERVATIONS)


def test_conditions_are_those_of_the_protocol():
    assert [one.options.get("vessel_spread", 0.0) for one in CONDITIONS.values()] == [
        0.0, 0.0, 0.15, 0.3, 0.45, 0.15
    ]  # fmt: skip
    plan = Settings().plan("ppo-residual", "compact_params", 3)
    environment = plan.environment
    assert environment["vessel_spread"] == 0.3 and environment["current"] == "any"
    assert environment["wind_from_deg"] == "any" and environment["sea"] == "0|2|4"
    trained = {*Settings().curve_seeds, *CONDITIONS["protocol"].seeds}
    assert not trained & set(CONDITIONS["otter"].seeds)


def test_arms_are_split_at_the_last_hyphen():
    assert settings.arm_named("ppo-residual-compact_raw") == ("ppo-residual", "compact_raw")
    for arm in settings.ARMS:
        assert settings.arm_named(settings.name_of(arm)) == arm
    with pytest.raises(AgentError, match="no arm is called 'ppo'"):
        settings.arm_named("ppo")


def test_a_tiny_study_goes_on_and_comes_to_the_same_numbers(tmp_path):
    first = runs.work(TINY, tmp_path / "a")
    done = dict([next(first), next(first), next(first)])
    first.close()
    assert set(done) == {("los", "", None), ("los-twin", "", None), ("ppo", "compact_raw", 0)}
    policy = tmp_path / "a" / "runs" / "ppo-compact_raw-0" / "policy.npz"
    before = policy.stat().st_mtime_ns
    # in parts: the last arms first
    part = dataclasses.replace(TINY, arms=TINY.arms[1:])
    dict(runs.work(part, tmp_path / "a"))
    found = {}
    for name in "ab":
        done = dict(runs.work(TINY, tmp_path / name))
        assert len(done) == 8
        found[name] = results.collect(TINY, done, "a command")
        report.write(found[name], TINY, done, tmp_path / name)
    assert policy.stat().st_mtime_ns == before
    for key in ("cells", "paired", "episodes", "levels"):
        assert found["a"][key] == found["b"][key]
    written = json.loads((tmp_path / "a" / "results.json").read_text())
    assert written["settings"]["steps"] == 128
    assert {cell["condition"] for cell in written["cells"]} == {"protocol", "spread .30"}
    assert all(curve["cpu_s"][-1] > 0.0 for curve in written["curves"])
    assert (tmp_path / "a" / "tables.md").read_text() == report.markdown(written)
    for picture in ("off_path.png", "curves.png", "paired.png"):
        assert (tmp_path / "a" / picture).read_bytes().startswith(b"\x89PNG")
    shipped = Policy.load(tmp_path / "a" / "policies" / "ppo-compact.npz")
    assert shipped.observation == "compact" and shipped.settings["steps"] == 128
    # other episodes: the policies stay, and are evaluated again
    few = {"protocol": dataclasses.replace(TINY.conditions["protocol"], seeds=(8, 9))}
    again = dict(runs.work(dataclasses.replace(TINY, conditions=few), tmp_path / "a"))
    assert len(again["ppo", "compact", 1]["rows"]) == 2 * 2 * 2
    assert policy.stat().st_mtime_ns == before


def test_what_cannot_be_done_is_said_at_once():
    with pytest.raises(AgentError, match="no study has the task 'curves'; known: path, docking"):
        settings.check(dataclasses.replace(TINY, task="curves"))
    with pytest.raises(AgentError, match="known: ppo, sac"):
        settings.check(dataclasses.replace(TINY, arms=(("dqn", "raw"),)))
    with pytest.raises(AgentError, match="a seed to train it with"):
        settings.check(dataclasses.replace(TINY, seeds=()))
    with pytest.raises(AgentError, match="name each only once"):
        settings.check(dataclasses.replace(TINY, arms=(("ppo", "compact"),) * 2))


def test_a_quick_study_is_small_and_takes_other_arms():
    small = settings.quick(Settings(steps=64))
    assert small.steps == 64 and len(small.seeds) == 2 and len(small.conditions) == 2
    assert settings.quick(Settings()).steps < 20_000
    settings.check(small)


def test_commands_print_the_study(tmp_path, monkeypatch):
    from twin.cli.main import app

    hyper = tmp_path / "tiny.toml"
    hyper.write_text("n_envs = 4\nn_steps = 16\nbatch_size = 32\nn_epochs = 1\n")
    folder = tmp_path / "runs"

    def said(*arguments, code=0):
        result = CliRunner().invoke(app, [str(argument) for argument in arguments])
        assert result.exit_code == code, result.output
        return result.output

    asked = ("train", "--obs", "raw", "--steps", 64, "--seeds", "0-1", "--hyper", hyper)
    asked = (*asked, "--sea", "0", "--faults", "none", "--out", folder)
    assert "ppo-raw, 64 decisions" in said(*asked)
    assert (folder / "ppo-raw-1" / "policy.npz").exists()
    said(*asked)  # done: at once
    assert "is a run with sea = 0, not 2" in " ".join(
        said(*asked[:-4], "--sea", "2", "--out", folder, "--faults", "none", code=2).split()
    )
    file = tmp_path / "episodes.json"
    calm = ("--sea", "0", "--faults", "none")
    policy_file = folder / "ppo-raw-0" / "policy.npz"
    output = said(
        "evaluate", folder, "los", policy_file, "--seeds", "1-2", *calm, "--json", file
    )  # fmt: skip
    assert "los" in output
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
    assert "mine" in said("evaluate", "mine:Mine", "--seeds", "1", *calm)
    assert "write module:Class" in said("evaluate", "mine:Nobody", code=2)
    other = tmp_path / "station.npz"
    policy = Policy.load(folder / "ppo-raw-0")
    policy.settings["task"] = "station"
    policy.save(other)
    output = " ".join(said("evaluate", folder, other, "--seeds", "1", code=2).split())
    assert "were trained with task = path, station" in output
    with pytest.raises(AgentError, match=r"sees 23 entries .* not 4"):
        policy.act(np.zeros((1, 4)))
    assert policy.act(np.zeros(23)).shape == (2,)
    assert "algo = 'dqn'" in said("train", "--algo", "dqn", code=2)
    assert "no task is called 'swim'" in said("train", "--task", "swim", "--out", folder, code=2)

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(runs, "work", interrupt)
    assert "continues from there" in said("study", "--out", tmp_path / "study", code=130)
    assert "no arm is called 'ppo'" in said("study", "--arms", "ppo", code=2)
