"""``usv-twin replay``: send a log as the live stream of a boat."""

from __future__ import annotations

import time
from collections import Counter
from typing import Annotated

import numpy as np
import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from twin.channels import MEASUREMENTS
from twin.cli.common import (
    LogArgument,
    MappingOption,
    ShaftMaxOption,
    SteerMaxOption,
    console,
    note,
    radians,
    stopped,
)
from twin.live.protocols.mavlink import Servos
from twin.live.protocols.nmea_writer import NOT_IN_NMEA
from twin.live.protocols.replay import (
    ORIGIN,
    MavlinkStream,
    NmeaStream,
    Stream,
    replay,
)
from twin.live.protocols.sockets import FeedError
from twin.logs.log import Log
from twin.sim.recorded import particulars_for_log


def replay_command(
    log: LogArgument,
    nmea: Annotated[
        str | None,
        typer.Option(help="Send NMEA 0183 to udp://HOST:PORT; udp://:10110 is this machine."),
    ] = None,
    mavlink: Annotated[
        str | None,
        typer.Option(help="Send MAVLink 2 to udp://HOST:PORT; udp://:14550 is this machine."),
    ] = None,
    speed: Annotated[float, typer.Option(help="Factor on the speed of time.")] = 1.0,
    origin: Annotated[
        str | None,
        typer.Option(
            help="Latitude,longitude of the log's origin, degrees. Default: where the log has it, "
            f"else {ORIGIN[0]},{ORIGIN[1]}."
        ),
    ] = None,
    loop: Annotated[bool, typer.Option("--loop", help="Start over at the end, for ever.")] = False,
    tag: Annotated[
        bool, typer.Option("--tag", help="A TAG block with the time before each NMEA sentence.")
    ] = False,
    ship: Annotated[
        str | None,
        typer.Option(
            "--ship",
            "--vessel",
            help="Boat, TOML file or name, whose full throttle scales MAVLink's servo outputs. "
            "Default: the .toml beside the log.",
        ),
    ] = None,
    shaft_max: ShaftMaxOption = None,
    steer_max: SteerMaxOption = None,
    mapping: MappingOption = None,
) -> None:
    """Send a log as the live stream of a boat, for usv-twin view --nmea or --mavlink.

    NMEA: a datagram for each row, with ZDA, GGA (and height), RMC, HDT, ROT, PASHR and XDR (roll,
    pitch, their rates), MWV, MWD, RPM and RSA where the row has the values. It has no sentence for
    accelerations and vertical speed.

    MAVLink: GLOBAL_POSITION_INT, ATTITUDE, HIGHRES_IMU, WIND_COV, SERVO_OUTPUT_RAW, and a
    heartbeat.
    """
    target = nmea if nmea is not None else mavlink
    if target is None or (nmea is not None and mavlink is not None):
        raise FeedError("name one of --nmea udp://:10110 and --mavlink udp://:14550")
    run = Log.read(log, mapping)
    plane = None if run.datum is None else run.datum.plane
    place = (plane.latitude, plane.longitude) if plane is not None else ORIGIN
    if origin is not None:
        place = _origin(origin)
    if nmea is not None:
        stream: Stream = NmeaStream(place, tag=tag)
        known = np.asarray(np.isfinite(run.z).any(axis=0))
        behind = [name for name in NOT_IN_NMEA if known[MEASUREMENTS.index(name)]]
        if behind:
            note(f"NMEA 0183 has no sentence for {', '.join(behind)}: not sent")
    else:
        particulars = particulars_for_log(log, ship, mapping)
        stream = MavlinkStream(Servos.of(particulars, shaft_max, radians(steer_max)), place)
    counts: Counter[str] = Counter()
    length = float(run.t[-1] - run.t[0])
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )
    span = "again and again" if loop else f"{length:g} s"
    console.print(f"sending {run.name} to {target}: {span}, {speed:g} times as fast")
    interrupted, begun = False, time.monotonic()
    with bar:
        task = bar.add_task(f"sending {run.name}", total=None if loop else length)

        def progress(t: float) -> None:
            bar.update(task, completed=t - float(run.t[0]))

        try:
            replay(run, stream, target, speed=speed, loop=loop, progress=progress, counts=counts)
        except KeyboardInterrupt:
            interrupted = True
    late = time.monotonic() - begun - length / speed
    if not loop and late > 1.0 + 0.1 * length / speed:
        note(f"this machine was {late:.0f} s too slow for {speed:g} times as fast")
    sent = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    console.print(f"sent to {target}: {sent}", highlight=False, soft_wrap=True)
    if interrupted:
        raise stopped("the rest is not sent")


def _origin(text: str) -> tuple[float, float]:
    """Return latitude and longitude of ``LAT,LON``."""
    try:
        latitude, longitude = map(float, text.split(","))
    except ValueError:
        raise FeedError(f"--origin {text}: write LAT,LON in degrees, as 59.43,10.47") from None
    return latitude, longitude
