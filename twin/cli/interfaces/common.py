"""Options and messages that ``sitl`` and ``link`` share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin.cli.common import OptionError, console
from twin.live.external.navigation import KINDS, ExternalNavigation, ExternalOptions

ExternalOption = Annotated[
    str,
    typer.Option(
        help=f"How the twin reaches the autopilot: {', '.join(KINDS)}; off: not at all. position "
        "is odometry for an EKF that takes the place alone."
    ),
]

MaxSdOption = Annotated[
    float,
    typer.Option(min=0.1, help="The twin gives up above this standard deviation of its place, m."),
]

ResumeOption = Annotated[
    bool,
    typer.Option(
        "--resume", help="Leave Hold again, if the failsafe of the autopilot's EKF was faster."
    ),
]

ViewOption = Annotated[bool, typer.Option("--view", help="Show boat and twin in the browser.")]

ViewPortOption = Annotated[
    int, typer.Option(min=1, max=65535, help="Port of the page; if taken, the next one.")
]


def navigation_of(kind: str, max_sd: float, resume: bool) -> ExternalNavigation | None:
    """Return external navigation that prints its events; None if it is off."""
    if kind == "off":
        return None
    options = ExternalOptions(kind=kind, max_sd=max_sd, resume=resume)
    return ExternalNavigation(options, say)


def say(t: float, text: str) -> None:
    """Print an event with its time, s."""
    console.print(f"{t:9.2f} s  {text}", highlight=False, soft_wrap=True)


def counted(counts: dict[str, int]) -> str:
    """Return counts in words."""
    return ", ".join(f"{name} {count}" for name, count in counts.items() if count) or "nothing"


def numbered(path: Path, number: int) -> Path:
    """Return the name of one of several logs; the first has the name as given."""
    return path if number == 0 else path.with_name(f"{path.stem}_{number + 1}{path.suffix}")


def parse_place(text: str, option: str) -> tuple[float, float]:
    """Return latitude and longitude of ``LAT,LON``, degrees."""
    try:
        latitude, longitude = map(float, text.split(","))
    except ValueError:
        raise OptionError(f"{option} {text}: write LAT,LON in degrees, as 59.9,10.7") from None
    return latitude, longitude
