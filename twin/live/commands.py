"""The command replay of ``usv-twin``."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from twin.benchmark import particulars_beside
from twin.live.feed import FeedError
from twin.live.mavlink import Servos
from twin.live.replay import ORIGIN, Disturb, MavlinkStream, NmeaStream, Stream, replay
from twin.log import Log
from twin.terminal import INTERRUPTED, console, errors

__all__ = ["COMMANDS"]


def replay_command(
    log: Annotated[Path, typer.Argument(help="Log: CSV, CSV.gz, Parquet, ROS 2 bag, MCAP.")],
    nmea: Annotated[
        str | None,
        typer.Option(help="Send NMEA 0183 to udp://HOST:PORT; udp://:10110 is this machine."),
    ] = None,
    mavlink: Annotated[
        str | None,
        typer.Option(help="Send MAVLink 2 to udp://HOST:PORT; udp://:14550 is this machine."),
    ] = None,
    speed: Annotated[float, typer.Option(help="How many times as fast as it happened.")] = 1.0,
    origin: Annotated[
        str, typer.Option(help="Latitude,longitude of the log's 0, 0, degrees.")
    ] = f"{ORIGIN[0]},{ORIGIN[1]}",
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end, for ever.")] = False,
    disturb: Annotated[
        str,
        typer.Option(
            help="Shares of what is sent late, doubled, broken, swapped: late=.05,broken=.01."
        ),
    ] = "",
    seed: Annotated[int, typer.Option(min=0, help="Of what is disturbed.")] = 0,
    tag: Annotated[
        bool, typer.Option("--tag", help="A TAG block with the time before each NMEA sentence.")
    ] = False,
    ship: Annotated[
        str | None,
        typer.Option(
            "--ship",
            "--vessel",
            help="Boat, TOML file or name, whose full throttle scales MAVLink's servo outputs. "
            "Left out: the .toml beside the log, else usv75.",
        ),
    ] = None,
    shaft_max: Annotated[
        float | None,
        typer.Option(help="Shaft speed at full throttle, rev/s. Left out: twice the usual one."),
    ] = None,
    steer_max: Annotated[
        float | None, typer.Option(help="Full helm, degrees. Left out: 30.")
    ] = None,
    mapping: Annotated[
        Path | None,
        typer.Option(help="TOML file that says which column is which column of the log."),
    ] = None,
) -> None:
    """Send a log as the live stream of a boat, for usv-twin view --nmea or --mavlink.

    NMEA: a datagram for each row, with ZDA, GGA, RMC, HDT, ROT, RPM and RSA as far as the row has
    them. MAVLink: GLOBAL_POSITION_INT, ATTITUDE, SERVO_OUTPUT_RAW, and a heartbeat.
    """
    target = nmea if nmea is not None else mavlink
    if target is None or (nmea is not None and mavlink is not None):
        raise FeedError("name one of --nmea udp://:10110 and --mavlink udp://:14550")
    run = Log.read(log, mapping)
    place = _origin(origin)
    if nmea is not None:
        stream: Stream = NmeaStream(place, tag=tag)
    else:
        particulars, _ = particulars_beside(log, ship)
        angle = None if steer_max is None else math.radians(steer_max)
        stream = MavlinkStream(Servos.of(particulars, shaft_max, angle), place)
    counts: Counter[str] = Counter()
    length = float(run.t[-1] - run.t[0])
    bar = Progress(
        *(TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()),
        console=console,
        transient=True,
    )
    code = 0
    with bar:
        task = bar.add_task(f"sending {run.name}", total=None if loop else length)

        def progress(t: float) -> None:
            bar.update(task, completed=t - float(run.t[0]))

        try:
            replay(
                *(run, stream, target),
                speed=speed,
                disturb=Disturb.parse(disturb),
                seed=seed,
                loop=loop,
                progress=progress,
                counts=counts,
            )
        except KeyboardInterrupt:
            code = INTERRUPTED
    told = [f"{count} {name}" for name, count in counts.items() if count]
    console.print(f"sent to {target}: {', '.join(told)}", highlight=False, soft_wrap=True)
    if code:
        errors.print("stopped", style="yellow")
        raise typer.Exit(code)


def _origin(text: str) -> tuple[float, float]:
    """Return latitude and longitude of ``LAT,LON``."""
    try:
        latitude, longitude = map(float, text.split(","))
    except ValueError:
        raise FeedError(f"--origin {text}: write LAT,LON in degrees, as 59.43,10.47") from None
    return latitude, longitude


COMMANDS: dict[str, Callable[..., None]] = {"replay": replay_command}
"""Commands by name."""
