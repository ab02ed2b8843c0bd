"""``usv-twin link``: the twin as external navigation of a real boat's autopilot."""

from __future__ import annotations

import time
from typing import Annotated

import typer

from twin.cli.common import (
    PredictorOption,
    ShaftMaxOption,
    SteerMaxOption,
    console,
    radians,
)
from twin.cli.view import feed_twin
from twin.live.external.link import Link
from twin.live.external.navigation import ExternalNavigation
from twin.live.external.receiver import ReceiverFeed
from twin.live.protocols.mavlink import Servos
from twin.predictors.registry import DEFAULT
from usv_gym.vessel.vessel import vessel_names

MaxSdOption = Annotated[
    float,
    typer.Option(min=0.1, help="The twin gives up above this standard deviation of its place, m."),
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
    max_sd: MaxSdOption = 20.0,
    shaft_max: ShaftMaxOption = None,
    steer_max: SteerMaxOption = None,
    duration: Annotated[
        float, typer.Option(min=0.0, help="End after so many seconds; 0: at Ctrl-C.")
    ] = 0.0,
) -> None:
    """Sail on without GPS: the twin is the external navigation of an autopilot.

    The autopilot needs VISO_TYPE 1 and a second source set: usv-twin sitl --print-params --twin
    dsw-ukf-plus prints them. Ctrl-C ends it.
    """
    navigation = ExternalNavigation(say, max_sd_m=max_sd)
    twin, _ = feed_twin(vessel, predictor)
    servos = Servos.of(twin.particulars, shaft_max, radians(steer_max))
    feed = ReceiverFeed(mavlink, twin.particulars, navigation.peer, servos=servos)
    link = Link(feed, navigation)
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


def say(t: float, text: str) -> None:
    """Print an event with its time, s."""
    console.print(f"{t:9.2f} s  {text}", highlight=False, soft_wrap=True)


def counted(counts: dict[str, int]) -> str:
    """Return counts in words."""
    return ", ".join(f"{name} {count}" for name, count in counts.items() if count) or "nothing"
