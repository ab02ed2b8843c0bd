"""A video of agents that sail the same episode, side by side."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.agents.agent import Agent
from twin.agents.evaluation import FRAME_SKIP, make_envs
from twin.agents.policy import AgentError

__all__ = ["check_video", "record_video"]

VIDEO_FORMATS = {".mp4": ("libx264", "yuv420p"), ".gif": ("gif", "rgb8")}
"""Codec and colours of ffmpeg, by how the file name of a video ends."""

AGENTS_MAX = 4
"""So many pictures fit beside each other in a video."""

PICTURE_PX, TITLE_PX = 480, 28
"""Side of a picture in a video, and height of the line with an agent's name."""

FRAMES_PER_S = 10
"""Decisions shown per second: with one every half second, the video is five times as fast."""


def check_video(path: Path, agents: int) -> None:
    """Refuse a video that could not be made.

    AgentError: it has an unknown ending, its folder is missing, or there are too many agents.
    ImportError: it names the package that is missing, and how to install it.
    """
    if path.suffix.lower() not in VIDEO_FORMATS:
        raise AgentError(f"--video {path}: must end in {' or '.join(VIDEO_FORMATS)}")
    if not path.parent.is_dir():
        raise AgentError(f"--video {path}: there is no folder {path.parent}; make it first")
    if not 1 <= agents <= AGENTS_MAX:
        raise AgentError(f"--video {path}: {agents} agents; name 1 to {AGENTS_MAX}")
    for module in ("pygame", "imageio_ffmpeg"):
        if importlib.util.find_spec(module) is None:
            raise ImportError(f"--video needs {module}: pip install 'usv-twin[video]'")


def record_video(path: Path, agents: Sequence[Agent], *, seed: int, **env: Any) -> int:
    """Let agents sail the episode of a seed, write a video of it, and return its frames.

    Agents stand side by side, with a frame for each decision; who is there stays in the picture.
    ``env`` are options of :func:`twin.agents.evaluation.make_envs`. Errors: see
    :func:`check_video`, or the file could not be written.
    """
    check_video(path, len(agents))
    films = [_film(agent, seed, {"frame_skip": FRAME_SKIP, **env}) for agent in agents]
    codec, colours = VIDEO_FORMATS[path.suffix.lower()]
    part = path.with_name(f".{path.name}")
    writer = importlib.import_module("imageio_ffmpeg").write_frames(
        str(part), (PICTURE_PX * len(agents), PICTURE_PX + TITLE_PX), fps=FRAMES_PER_S,
        codec=codec, pix_fmt_out=colours, macro_block_size=2,
    )  # fmt: skip
    shown, count = [next(film) for film in films], 0
    try:
        writer.send(None)
        new: list[Any] = [*shown]
        while any(picture is not None for picture in new):
            shown = [old if one is None else one for one, old in zip(new, shown, strict=True)]
            writer.send(np.ascontiguousarray(np.hstack(shown)))
            count += 1
            new = [next(film, None) for film in films]
        writer.close()
        part.replace(path)
    except OSError as error:
        raise AgentError(f"--video {path}: could not be written ({error})") from None
    finally:
        writer.close()
        part.unlink(missing_ok=True)
    return count


def _film(agent: Agent, seed: int, env: dict[str, Any]) -> Iterator[NDArray[np.uint8]]:
    """Yield pictures of an episode: one at its start, and one after each decision."""
    import pygame

    size = PICTURE_PX, PICTURE_PX
    envs = make_envs(
        1, observation=agent.observation, render_mode="rgb_array", render_size=size, **env
    )
    pygame.font.init()
    line = pygame.Surface((PICTURE_PX, TITLE_PX), 0, 32)
    line.fill((255, 255, 255))
    line.blit(pygame.font.Font(None, 24).render(agent.name, True, (0, 0, 0)), (8, 5))
    title = np.frombuffer(pygame.image.tobytes(line, "RGB"), np.uint8)
    title = title.reshape(TITLE_PX, PICTURE_PX, 3)
    try:
        obs, over = envs.reset(seed=[seed])[0], False
        agent.begin(envs)
        while True:
            pictures = envs.render()
            assert pictures is not None
            yield np.vstack([title, pictures[0]])
            if over:
                return
            obs, _, terminated, truncated, _ = envs.step(agent.act(obs))
            over = bool(terminated[0] or truncated[0])
    finally:
        envs.close()
