"""The page of an agent that sails, and what ``usv-twin view --policy`` refuses."""

from __future__ import annotations

import shutil
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.twin.cli.command import run
from twin.agents.policy import Policy
from twin.live.sessions.policy import PolicySession

pytest.importorskip("viser", reason="needs viser: pip install 'usv-twin[view]'")

POLICIES = Path(__file__).resolve().parents[4] / "examples/gps_loss_study/policies"


def test_an_agent_that_sails_has_a_page_with_losses_and_episodes(
    tmp_path: Path, served: Callable[..., Any]
) -> None:
    from twin.live.ui.panel import PolicyControls

    agent = Policy.load(POLICIES / "ppo-raw.npz")
    session = PolicySession(agent, tmp_path, seed=3, predictor="ukf")
    viewer = served(session)
    with urllib.request.urlopen(f"http://127.0.0.1:{viewer.port}/", timeout=20.0) as page:
        assert page.status == 200
    assert isinstance(viewer.controls, PolicyControls)
    labels = [label for _button, label in viewer.controls.labels()]
    assert labels[-2:] == ["lose GPS until pressed", "lose IMU until pressed"]


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (("pilot",), "no such folder, policy or controller"),
        ((str(POLICIES),), "agents; name one of them"),
        (("los", "--nmea", "udp://:10110"), "--nmea and --policy: look at one of them at a time"),
        (("los", "--task", "path"), "No such option"),
    ],
)
def test_view_of_a_policy_refuses_what_it_cannot_show(words, error, tmp_path) -> None:
    output = run("view", "--policy", *words, "--out", tmp_path, check=2).output
    assert error in " ".join(output.split())


def test_view_of_a_policy_without_its_boat_names_the_entries(tmp_path) -> None:
    other = tmp_path / "other.npz"
    policy = Policy.load(shutil.copy(POLICIES / "ppo-raw.npz", other))
    policy.names = (*policy.names[:-1], "speed_of_sound")
    policy.save(other)
    output = run("view", "--policy", other, "--out", tmp_path, check=2).output
    assert "speed_of_sound" in output and "observation='raw'" in " ".join(output.split())
