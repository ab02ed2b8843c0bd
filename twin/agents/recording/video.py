"""A video of agents that sail the same episode, side by side."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.agents.agent import Agent
from twin.agents.evaluation import EPISODE, FRAME_SKIP, make_envs
from twin.agents.policy import AgentError

__all__ = ["FORMATS", "MOST_AGENTS", "check_video", "record_video"]

Frame = NDArray[np.uint8]

FORMATS = {".mp4": ("libx264", "yuv420p"), ".gif": ("gif", "rgb8")}
"""Codec and colours of ffmpeg, by how the file name of a video ends."""

MOST_AGENTS = 4
"""So many pictures fit beside each other."""

SIZES = {1: (720, 720), 2: (640, 640)}
"""Width and height of a picture, pixels, for so many agents; more have the smallest."""

SMALL = (480, 480)

FPS = 10
"""Decisions shown per second: with one every half second, the video is five times as fast."""

TITLE = 28
"""Height of the line with an agent's name, pixels."""


def check_video(path: Path, agents: int) -> None:
    """Refuse a video that could not be made.

    Raises
    ------
    AgentError
        It has an unknown ending, its folder is missing, or there are too many agents.
    ImportError
        Names the package that is missing, and how to install it.
    """
    if path.suffix.lower() not in FORMATS:
        raise AgentError(f"--video {path}: must end in {' or '.join(FORMATS)}")
    if not path.parent.is_dir():
        raise AgentError(f"--video {path}: there is no folder {path.parent}; make it first")
    if not 1 <= agents <= MOST_AGENTS:
        raise AgentError(
            f"--video {path}: {agents} agents; name 1 to {MOST_AGENTS}, who sail side by side"
        )
    for module, package in (("pygame", "pygame-ce"), ("imageio_ffmpeg", "imageio-ffmpeg")):
        if importlib.util.find_spec(module) is None:
            raise ImportError(f"--video needs {package}: pip install 'usv-twin[video]'")


def record_video(
    path: Path, agents: Sequence[Agent], *, seed: int, sea: str = "2", faults: str = "none",
    max_episode_steps: int = EPISODE, **env: Any,
) -> int:  # fmt: skip
    """Let agents sail the episode of a seed, and write a video of it.

    Parameters
    ----------
    path : Path
        File to write; its ending names the format.
    agents : sequence of Agent
        1 to 4. Each has a picture with its name; the last one stays where its episode has ended.
    seed : int
        Of the episode.
    sea, faults, max_episode_steps, **env
        See :func:`twin.agents.evaluation.evaluate`.

    Returns
    -------
    int
        Number of frames, one a decision.

    Raises
    ------
    AgentError
        See :func:`check_video`; or the file could not be written.
    """
    check_video(path, len(agents))
    writer_of = importlib.import_module("imageio_ffmpeg").write_frames
    size = SIZES.get(len(agents), SMALL)
    options = {"sea": sea, "faults": faults, "max_episode_steps": max_episode_steps, **env}
    films = [_frames(agent, seed, size, options) for agent in agents]
    width, height = size[0] * len(agents), size[1] + TITLE
    width, height = width - width % 2, height - height % 2  # most decoders want even numbers
    codec, colours = FORMATS[path.suffix.lower()]
    part = path.with_name(f".{path.name}")
    form = {"codec": codec, "pix_fmt_out": colours, "fps": FPS, "macro_block_size": 2}
    writer = writer_of(str(part), (width, height), **form)
    count = 0
    try:
        writer.send(None)
        last: list[Frame | None] = [None for _ in agents]
        while True:
            new = [next(film, None) for film in films]
            if all(one is None for one in new):
                break
            last = [one if one is not None else old for one, old in zip(new, last, strict=True)]
            whole = np.hstack([one for one in last if one is not None])[:height, :width]
            writer.send(np.ascontiguousarray(whole))
            count += 1
        writer.close()
        part.replace(path)
    except OSError as error:
        raise AgentError(f"--video {path}: could not be written ({error})") from None
    finally:
        writer.close()
        part.unlink(missing_ok=True)
        for film in films:
            film.close()
    return count


def _frames(
    agent: Agent, seed: int, size: tuple[int, int], options: dict[str, Any]
) -> Generator[Frame, None, None]:
    """Yield pictures of an episode: one at its start, and one after each decision."""
    named = {"frame_skip": FRAME_SKIP, **options}
    envs = make_envs(
        1, observation=agent.observation, render_mode="rgb_array", render_size=size, **named
    )
    try:
        obs = envs.reset(seed=[seed])[0]
        agent.begin(envs)
        title, over = _title(agent.name, size[0]), False
        while True:
            pictures = envs.render()
            assert pictures is not None
            yield np.vstack([title, pictures[0]])
            if over:
                return
            step = envs.step(agent.act(obs))
            obs, over = step[0], bool(step[2][0] or step[3][0])
    finally:
        envs.close()


def _title(text: str, width: int) -> Frame:
    """Return a line with a name."""
    import matplotlib
    import pygame

    pygame.font.init()
    font = f"{matplotlib.get_data_path()}/fonts/ttf/DejaVuSans.ttf"
    surface = pygame.Surface((width, TITLE), 0, 32)
    surface.fill((255, 255, 255))
    surface.blit(pygame.font.Font(font, 16).render(text, True, (0, 0, 0)), (8, 5))
    pixels = np.frombuffer(pygame.image.tobytes(surface, "RGB"), np.uint8)
    return pixels.reshape(TITLE, width, 3)
