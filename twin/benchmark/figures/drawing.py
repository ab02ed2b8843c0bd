"""Pictures of a page: asked for one by one, drawn by several processes, written to files."""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from twin.benchmark.svg import pdf_of, standalone, svg_of, with_styles
from twin.parallel import results_of
from usv_kernel.files import write_whole

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.figure import Figure

__all__ = [
    "Picture",
    "Pictures",
]

CHUNK = 6
"""Pictures that a process draws at a time; those of a run share it."""


@dataclass
class Picture:
    """A picture with its caption; ``svg`` is an SVG element once it is drawn, if it shows much."""

    draw: Callable[[], Figure | None]
    name: str
    caption: str
    svg: Markup | None = None


class Pictures:
    """Keeps pictures to be drawn, draws them, and writes each to its file."""

    def __init__(
        self, folder: Path, drawn: Callable[[str], None] | None = None, *, pdf: bool = False
    ) -> None:
        self.folder, self.drawn, self.pdf = folder, drawn, pdf
        self.written: list[Path] = []
        self.styles: dict[str, str] = {}
        self._waiting: list[Picture] = []

    def add(self, draw: Callable[[], Figure | None], name: str, caption: str) -> Picture:
        """Return a picture for the page, which :meth:`draw` will make."""
        self._waiting.append(Picture(draw, name, caption))
        return self._waiting[-1]

    def draw(self, jobs: int) -> None:
        """Draw all pictures, and keep their files; one of nothing is left out."""
        tasks = [
            (picture.draw, f"p{k}", picture.caption) for k, picture in enumerate(self._waiting)
        ]
        calls = [
            functools.partial(_drawn, tasks[first : first + CHUNK], self.pdf)
            for first in range(0, len(tasks), CHUNK)
        ]
        made: dict[int, list[_Drawing | None]] = {}
        for number, found in results_of(calls, jobs=jobs):
            made[number] = found
            for picture in self._waiting[CHUNK * number : CHUNK * number + len(found)]:
                if self.drawn:
                    self.drawn(picture.name)
        ordered = itertools.chain.from_iterable(made[k] for k in sorted(made))
        for picture, drawn in zip(self._waiting, ordered, strict=True):
            if drawn is not None:
                self._keep(picture, *drawn)

    def _keep(self, picture: Picture, svg: str, styles: Sequence[str], pdf: bytes | None) -> None:
        """Write a picture to its files, with styles that it shares with the others of the page."""
        from markupsafe import Markup

        stem = re.sub(r"[^A-Za-z0-9.-]+", "_", picture.name).strip("._") or "picture"
        path, number = self.folder / f"{stem}.svg", 2
        while path in self.written:
            path, number = self.folder / f"{stem}_{number}.svg", number + 1
        svg = with_styles(svg, styles, self.styles)
        write_whole(path, standalone(svg, self.styles).encode())
        if pdf is not None:
            write_whole(path.with_suffix(".pdf"), pdf)
        self.written.append(path)
        picture.svg = Markup(svg)


class _Drawing(NamedTuple):
    """A picture as it was drawn."""

    svg: str
    styles: list[str]  # of its classes
    pdf: bytes | None


def _drawn(
    tasks: Sequence[tuple[Callable[[], Figure | None], str, str]], pdf: bool
) -> list[_Drawing | None]:
    """Return pictures, each with the styles of its classes; None for one of nothing."""
    made: list[_Drawing | None] = []
    for draw, prefix, label in tasks:
        styles: dict[str, str] = {}
        fig = draw()
        if fig is None:
            made.append(None)
            continue
        svg = svg_of(fig, prefix, label, styles)
        made.append(_Drawing(svg, list(styles), pdf_of(fig) if pdf else None))
    return made
