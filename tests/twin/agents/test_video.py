"""Videos show each decision of each agent, and what is missing is said before anything sails."""

from __future__ import annotations

import importlib.util
import subprocess

import numpy as np
import pytest
from twin.agents.recording.video import check_video, record_video
from typer.testing import CliRunner

from twin.agents.controllers import make_controller
from twin.agents.policy import AgentError

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
    pictures = np.frombuffer(read.stdout, np.uint8).reshape(-1, 668, 1280, 3)
    assert len(pictures) == 13
    first, last = pictures[0].astype(int), pictures[-1].astype(int)
    assert np.abs(first - last).max() > 50  # the boats move
    assert np.abs(last[:, :640] - last[:, 640:]).max() > 50  # and only one has a twin


@needs_video
def test_video_has_the_format_of_its_ending(tmp_path):
    path = tmp_path / "one.gif"
    assert record_video(path, [make_controller("los")], seed=1, max_episode_steps=2) == 3
    assert path.read_bytes().startswith(b"GIF8")
    assert [one.name for one in tmp_path.iterdir()] == ["one.gif"]


@needs_video
def test_impossible_videos_are_refused(tmp_path):
    with pytest.raises(AgentError, match=r"must end in \.mp4"):
        check_video(tmp_path / "film.doc", 1)
    with pytest.raises(AgentError, match="there is no folder"):
        check_video(tmp_path / "none" / "film.mp4", 1)
    with pytest.raises(AgentError, match="5 agents; name 1 to 4"):
        check_video(tmp_path / "film.mp4", 5)


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "imageio_ffmpeg" else found(name)
    )
    with pytest.raises(ImportError, match=r"needs imageio-ffmpeg: pip install 'usv-twin\[video\]'"):
        check_video(tmp_path / "film.mp4", 1)


@needs_video
def test_evaluate_prints_success_time_return_and_forecasts_and_writes_a_video(tmp_path):
    from twin.cli.main import app

    path = tmp_path / "film.mp4"
    words = ("evaluate", "los-twin", "--seeds", "1-2", "--sea", "0", "--faults", "none")
    result = CliRunner().invoke(app, [*words, "--video", str(path)])
    assert result.exit_code == 0, result.output
    assert "forecast" in result.output and "success" in result.output
    row = next(line.split() for line in result.output.splitlines() if "los-twin" in line)
    agent, sea, loss, off, success, failed, time, total, forecast = row
    assert (agent, sea, loss, success, failed) == ("los-twin", "0", "none", "100%", "0%")
    assert 0.0 < float(off) < 5.0 and 60.0 < float(time) < 120.0
    assert float(total) > 1000.0 and 0.0 < float(forecast) < 5.0
    assert path.stat().st_size > 10_000
