"""Data sets hold the evaluated episodes, and the forecasts as the twin made them."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from tests.twin.cli.command import run
from twin.agents.controllers import make_controller
from twin.agents.evaluation import evaluate
from twin.agents.policy import AgentError
from twin.agents.recording.dataset import check_dataset, episodes_of, write_dataset

needs_minari = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("minari", "h5py")),
    reason="data sets need Minari: pip install 'usv-twin[minari]'",
)

EPISODES = {"seeds": (1, 2), "sea": "0", "faults": "gps10@2", "max_episode_steps": 30}


@pytest.mark.parametrize("name", ["los-twin", "los"])
def test_recorded_episodes_are_those_of_the_evaluation(name):
    rows = evaluate(make_controller(name), **EPISODES)
    for row, episode in zip(rows, episodes_of(make_controller(name), **EPISODES), strict=True):
        infos = episode["infos"]
        assert len(episode["rewards"]) == 30 and episode["truncations"].tolist()[-1]
        assert episode["rewards"].sum() == pytest.approx(row["return"], rel=1e-5)
        off = np.abs(infos["cross_track_m"][1:]).mean()
        assert off == pytest.approx(row["off_path_m"], rel=1e-4)
        assert {len(values) for values in infos.values()} == {31}
        assert np.diff(infos["t_s"]) == pytest.approx(0.5)


def test_recorded_forecasts_come_near_the_truth_that_follows():
    (episode,) = episodes_of(make_controller("los-twin"), seeds=(4,), sea="0", faults="none")
    infos = episode["infos"]
    state, ahead = infos["state"], infos["twin_ahead"]
    assert ahead.shape[1:] == (4, 6) and infos["twin_ahead_cov"].shape[1:] == (4, 2, 2)
    error = np.linalg.norm(ahead[20:-2, 0, :2] - state[22:, :2], axis=1)  # 1 s ahead
    moved = np.linalg.norm(state[22:, :2] - state[20:-2, :2], axis=1)
    assert np.median(error) < 0.3 * np.median(moved)
    now = np.linalg.norm(infos["twin_state"][20:, :2] - state[20:, :2], axis=1)
    assert np.median(now) < 2.0


def test_an_episode_ends_where_it_ends():
    episodes = episodes_of(make_controller("los-twin"), seeds=(1, 2), sea="0", faults="none")
    for episode in episodes:
        assert episode["terminations"].tolist().count(True) == 1
        assert episode["terminations"][-1] and episode["infos"]["is_success"][-1]
        assert len(episode["observations"]) == len(episode["actions"]) + 1 < 240


@pytest.fixture
def shelf(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "shelf"))
    return tmp_path / "shelf"


@pytest.mark.slow
@needs_minari
def test_minari_reads_the_data_set_and_recovers_the_environment(shelf):
    import minari

    given = {"seeds": (1, 2), "seas": ("0",), "outages": ("gps10@2",)}
    count = write_dataset(
        "usv/los-twin-v0", make_controller("los-twin"), max_episode_steps=20, **given
    )
    data = minari.load_dataset("usv/los-twin-v0")
    assert count == data.total_episodes == 2 and data.total_steps == 40
    expected = episodes_of(make_controller("los-twin"), **(EPISODES | {"max_episode_steps": 20}))
    for episode, other in zip(data.iterate_episodes(), expected, strict=True):
        np.testing.assert_array_equal(episode.observations, other["observations"])
        np.testing.assert_array_equal(episode.infos["twin_ahead"], other["infos"]["twin_ahead"])
    env = data.recover_environment()
    obs, _info = env.reset(seed=1)
    np.testing.assert_array_equal(obs, next(iter(data.iterate_episodes())).observations[0])
    with pytest.raises(AgentError, match="is there already; choose another version"):
        check_dataset("usv/los-twin-v0", 1)


@pytest.mark.slow
@needs_minari
def test_evaluate_writes_a_data_set(shelf, tmp_path):
    words = ("evaluate", "los", "--seeds", "1-2", "--sea", "0", "--faults", "none")
    said = run(*words, "--minari", "usv/los-v0").output
    assert "Minari data set of 2 episodes: usv/los-v0" in " ".join(said.split())
    assert "write a name and a version" in run(*words, "--minari", "los", check=2).output
    two = run("evaluate", "los-twin", *words[1:], "--minari", "usv/two-v0", check=2).output
    assert "2 agents; evaluate one of them at a time" in " ".join(two.split())


def test_a_missing_minari_is_named(monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "minari" else found(name)
    )
    with pytest.raises(ImportError, match=r"needs minari: pip install 'usv-twin\[minari\]'"):
        check_dataset("usv/los-v0", 1)
