"""The page of an agent that sails, and what ``usv-twin view --policy`` refuses."""

import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.twin.agents.drawn_policy import drawn_policy
from tests.twin.cli.command import run
from twin.live.sessions.policy import PolicySession

pytest.importorskip("viser", reason="needs viser: pip install 'usv-twin[view]'")


def test_an_agent_that_sails_has_a_page_with_losses_and_episodes(
    tmp_path: Path, served: Callable[..., Any]
) -> None:
    from twin.live.ui.panel import PolicyControls

    agent = drawn_policy("raw")
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
        (("los", "--nmea", "udp://:10110"), "--nmea and --policy: look at one of them at a time"),
        (("los", "--task", "path"), "No such option"),
    ],
)
def test_view_of_a_policy_refuses_what_it_cannot_show(words, error, tmp_path) -> None:
    output = run("view", "--policy", *words, "--out", tmp_path, check=2).output
    assert error in " ".join(output.split())
