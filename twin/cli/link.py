"""``usv-twin link``: the twin as external navigation of a real boat's autopilot."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from twin.cli.common import (
    OptionError,
    PredictorOption,
    ShaftMaxOption,
    SteerMaxOption,
    console,
    radians,
)
from twin.cli.view import feed_twin, show_session
from twin.live.external.link import Link, LinkSession
from twin.live.external.navigation import KINDS, ExternalNavigation, ExternalOptions
from twin.live.external.receiver import ReceiverFeed
from twin.live.protocols.mavlink import Servos
from twin.predictors.registry import DEFAULT
from usv_gym.vessel.vessel import vessel_names

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


PAUSE = 0.005
"""Time between two looks at the wire, s."""


def link_command(
    mavlink: Annotated[
        str, typer.Argument(help="Address at which the autopilot's MAVLink arrives.")
    ] = "udp://:14551",
    vessel: Annotated[
        str | None,
        typer.Option(
            "--vessel",
            "--ship",
            help=f"The boat: a name ({', '.join(vessel_names())}) or a TOML file; main particulars "
            "will do. Default: usv75.",
        ),
    ] = None,
    predictor: PredictorOption = DEFAULT,
    external: ExternalOption = "odometry",
    max_sd: MaxSdOption = 20.0,
    resume: ResumeOption = False,
    shaft_max: ShaftMaxOption = None,
    steer_max: SteerMaxOption = None,
    duration: Annotated[
        float, typer.Option(min=0.0, help="End after so many seconds; 0: at Ctrl-C.")
    ] = 0.0,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for logs that are recorded on the page.")
    ] = Path(),
    view: ViewOption = False,
    view_port: ViewPortOption = 8080,
) -> None:
    """Sail on without GPS: the twin is the external navigation of an autopilot.

    The autopilot needs VISO_TYPE 1 and a second source set: usv-twin sitl --print-params --twin
    dsw-ukf-plus prints them. Ctrl-C ends it.
    """
    navigation = navigation_of(external, max_sd, resume)
    if navigation is None:
        raise OptionError("--external off: nothing would be sent; usv-twin view --mavlink looks on")
    twin, shown = feed_twin(vessel, predictor)
    servos = Servos.of(twin.particulars, shaft_max, radians(steer_max))
    second = external == "gps-input"
    feed = ReceiverFeed(mavlink, twin.particulars, navigation.peer, second=second, servos=servos)
    link = Link(feed, navigation)
    if view:
        from twin.live.ui.access import Access

        session = LinkSession(link, twin, shown, out)
        show_session(session, Access.of("127.0.0.1", (), None), view_port, False)
        return
    console.print(f"waiting for an autopilot at {mavlink} (Ctrl-C ends it)", highlight=False)
    end = time.monotonic() + duration if duration else float("inf")
    try:
        with feed:
            while time.monotonic() < end:
                if not link.step(twin):
                    time.sleep(PAUSE)
    except KeyboardInterrupt:
        console.print("stopped")
    console.print(f"external navigation: {navigation.status}", highlight=False)
    console.print(f"messages: {counted(feed.counts)}", highlight=False, soft_wrap=True)


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
