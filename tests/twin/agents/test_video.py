"""Videos show each decision of each agent, and what is missing is said before anything sails."""

from __future__ import annotations

import importlib.util
import subprocess

import numpy as np
import pytest

from tests.twin.cli.command import run
from twin.agents.controllers import make_controller
from twin.agents.policy import AgentError
from twin.agents.video import check_video, record_video

needs_video = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("pygame", "imageio_ffmpeg")),
    reason="videos need pygame-ce and imageio-ffmpeg: pip install 'usv-twin[video]'",
)


@needs_video
def test_video_has_a_frame_for_each_decision_of_two_agents(tmp_path):
    import imageio_ffmpeg

    path = tmp_path / "two.mp4"
    agents = [make_controller("los"), make_controller("los-twin")]
    count = record_video(path, agents, seed=1, sea="0", faults="none", max_episode_steps=12)
    assert count == 13
    raw = ("-loglevel", "error", "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-")
    read = subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), *raw], capture_output=True, check=True)
    pictures = np.frombuffer(read.stdout, np.uint8).reshape(13, 508, 960, 3)
    first, last = pictures[0].astype(int), pictures[-1].astype(int)
    assert np.abs(first - last).max() > 50  # the boats move
    assert np.abs(last[:, :480] - last[:, 480:]).max() > 50  # and only one has a twin
    assert [one.name for one in tmp_path.iterdir()] == ["two.mp4"]


@needs_video
def test_evaluate_prints_its_tables_and_writes_a_video(tmp_path):
    path = tmp_path / "film.gif"
    words = ("evaluate", "los-twin", "--seeds", "1-2", "--sea", "0", "--faults", "none")
    output = run(*words, "--video", path).output
    agent, sea, loss, off, success, failed, time, total, forecast = next(
        line.split() for line in output.splitlines() if "los-twin" in line
    )
    assert (agent, sea, loss, success, failed) == ("los-twin", "0", "none", "100%", "0%")
    assert 0.0 < float(off) < 5.0 and 60.0 < float(time) < 120.0
    assert float(total) > 1000.0 and 0.0 < float(forecast) < 5.0
    assert path.read_bytes().startswith(b"GIF8")


@needs_video
@pytest.mark.parametrize(
    ("name", "agents"), [("film.doc", 1), ("none/film.mp4", 1), ("film.mp4", 5)]
)
def test_impossible_videos_are_refused(tmp_path, name, agents):
    with pytest.raises(AgentError, match=name):
        check_video(tmp_path / name, agents)


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "imageio_ffmpeg" else found(name)
    )
    with pytest.raises(ImportError, match=r"usv-twin\[video\]"):
        check_video(tmp_path / "film.mp4", 1)
