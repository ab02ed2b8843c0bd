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
from twin.cli.interfaces.common import (
    ExternalOption,
    MaxSdOption,
    ResumeOption,
    ViewOption,
    ViewPortOption,
    counted,
    navigation_of,
)
from twin.cli.view import feed_twin, show_session
from twin.live.external.link import Link, LinkSession
from twin.live.external.receiver import ReceiverFeed
from twin.live.protocols.mavlink import Servos
from twin.predictors.registry import DEFAULT
from usv_gym.vessel.vessel import vessel_names

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
