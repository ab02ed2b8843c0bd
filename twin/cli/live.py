"""The commands view and replay of ``usv-twin``."""

from __future__ import annotations

import dataclasses
import math
import signal
import time
import webbrowser
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from twin.cli.common import INTERRUPTED, console, errors, note
from twin.digital_twin import Twin
from twin.live.protocols.feed import Feed, FeedError, needed
from twin.live.protocols.mavlink import MavlinkFeed, Servos
from twin.live.protocols.nmea import NmeaFeed
from twin.live.protocols.replay import ORIGIN, Disturb, MavlinkStream, NmeaStream, Stream, replay
from twin.logs.columns import LogError
from twin.logs.log import Log
from twin.particulars import Particulars
from twin.predictors.registry import DEFAULT, PREDICTORS, PredictorError, predictor_class
from twin.sim.bridge import particulars_of
from twin.sim.oracle import check_simulator
from twin.sim.recorded import NO_PARTICULARS, particulars_for_log
from usv_gym.manoeuvring.manoeuvres import MANOEUVRES, ManoeuvreError
from usv_gym.vessel.vessel import Vessel, VesselError, vessel_names
from usv_gym.world.faults import FAULTS_HELP, parse_faults
from usv_gym.world.sea import SEA_STATES, SeaState
from usv_gym.world.sensors import GRADES

if TYPE_CHECKING:
    from twin.live.sessions.session import Session

__all__ = [
    "COMMANDS",
]

ShaftMaxOption = Annotated[
    float | None,
    typer.Option(
        help="MAVLink: shaft speed at full throttle, rev/s. Left out: twice the usual one."
    ),
]

SteerMaxOption = Annotated[
    float | None, typer.Option(help="MAVLink: full helm, degrees. Left out: 30.")
]


def view_command(
    log: Annotated[
        Path | None,
        typer.Argument(help="Log to look at; left out: a simulated boat, or a feed."),
    ] = None,
    nmea: Annotated[
        str | None,
        typer.Option(help="Follow a boat that sends NMEA 0183 to this address: udp://:10110."),
    ] = None,
    mavlink: Annotated[
        str | None,
        typer.Option(help="Follow a boat or an autopilot by MAVLink: udp://:14550."),
    ] = None,
    reply: Annotated[
        str | None,
        typer.Option(
            help="Where the twin's estimate and prediction are sent: udp://HOST:PORT. Left out: "
            "back to who sends."
        ),
    ] = None,
    vessel: Annotated[
        str | None,
        typer.Option(
            "--vessel",
            "--ship",
            help=f"The boat: a name ({', '.join(vessel_names())}) or a TOML file; for a log or a "
            "feed, main particulars will do. Left out: what lies beside the log, else usv75.",
        ),
    ] = None,
    predictor: Annotated[
        str, typer.Option("--predictor", "-p", help=f"One of: {', '.join(PREDICTORS)}.")
    ] = DEFAULT,
    mapping: Annotated[
        Path | None, typer.Option(help="TOML file that says which column of the log is which.")
    ] = None,
    plan: Annotated[
        str,
        typer.Option(
            help="Of a log. known: the twin is told the commands that follow; hold: the last stays."
        ),
    ] = "known",
    sea: Annotated[str, typer.Option(help=f"One of: {', '.join(SEA_STATES)}.")] = "2",
    dof: Annotated[
        int, typer.Option(help="Degrees of freedom of the simulated ship: 3, or 6 with its heave.")
    ] = 6,
    sensors: Annotated[str, typer.Option(help=f"One of: {', '.join(GRADES)}.")] = "typical",
    faults: Annotated[str, typer.Option(help=f"Faults of sensors: {FAULTS_HELP}.")] = "none",
    fault_start: Annotated[
        float, typer.Option(help="When a fault given by its seconds begins, s.")
    ] = 85.0,
    shaft_max: ShaftMaxOption = None,
    steer_max: SteerMaxOption = None,
    autopilot: Annotated[
        str, typer.Option(help=f"off, {', '.join(MANOEUVRES)}, or path.")
    ] = "turn",
    seed: Annotated[int, typer.Option(min=0, help="Seed of sea, sensors and path.")] = 0,
    speed: Annotated[
        float, typer.Option(min=0.1, max=10.0, help="Seconds of the run per second.")
    ] = 1.0,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for logs that are recorded.")
    ] = Path(),
    host: Annotated[
        str, typer.Option(help="Address to show it at; 0.0.0.0 lets others look.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port, or the next free one.")] = 8080,
    browser: Annotated[
        bool, typer.Option("--open", help="Open it in this machine's browser.")
    ] = False,
) -> None:
    """Show a boat and its twin in the browser, live and in three dimensions.

    Without a log or a feed, the boat is simulated: steer it, change the weather, lose its GPS.
    Ctrl-C ends it; a log that is being recorded is written then.
    """
    from twin.live.sessions.autopilot import AUTOPILOTS
    from twin.live.sessions.simulated import SimulatedSession, World
    from twin.live.ui.viewer import check_host

    needed("viser")  # before anything is compiled
    check_host(host)
    given = [name for name, one in (("LOG", log), ("--nmea", nmea), ("--mavlink", mavlink)) if one]
    if len(given) > 1:
        raise LogError(f"{' and '.join(given)}: look at one of them at a time")
    session: Session
    if log is not None:
        session = _recorded(log, mapping, vessel, predictor, plan, out)
    elif nmea is not None or mavlink is not None:
        full = shaft_max, None if steer_max is None else math.radians(steer_max)
        session = _fed(nmea, mavlink, reply, vessel, predictor, full, out)
    else:
        boat = Vessel.load(vessel or "usv75")
        if autopilot not in AUTOPILOTS:
            raise ManoeuvreError(
                f"no autopilot is called {autopilot!r}; known: {', '.join(AUTOPILOTS)}"
            )
        world = World(
            vessel=boat,
            sea=SeaState.named(sea),
            predictor=predictor,
            sensors=sensors,
            seed=seed,
            dof=dof,
            faults=parse_faults(faults, fault_start),
        )
        session = SimulatedSession(world, out, autopilot)
    session.set_scale(speed)
    _show(session, host, port, browser)


def _show(session: Session, host: str, port: int, browser: bool) -> None:
    """Serve a session until Ctrl-C, or until it is told to end."""
    from twin.live.ui.viewer import Viewer

    viewer = Viewer(session, host, port)
    for kind in (signal.SIGINT, signal.SIGTERM):  # also where a shell has told it to ignore them
        signal.signal(kind, signal.default_int_handler)
    try:
        session.start()
        if viewer.port != port:
            note(f"port {port} is in use")
        console.print(f"look at {viewer.url} (Ctrl-C ends it)", highlight=False)
        if browser:
            webbrowser.open(viewer.url)
        viewer.serve()
    except KeyboardInterrupt:
        console.print("stopped")
    finally:
        session.stop()
        viewer.close()
        if session.recorded is not None:
            console.print(f"log: {session.recorded}", highlight=False, soft_wrap=True)
    if session.error is not None:
        raise session.error


def _recorded(
    path: Path, mapping: Path | None, ship: str | None, predictor: str, plan: str, out: Path
) -> Session:
    from twin.live.sessions.log import LogSession

    log = Log.read(path, mapping)
    for line in log.notes:
        note(line)
    particulars, found = particulars_for_log(path, ship)
    if not found:
        note(NO_PARTICULARS.format(path))
    check_simulator(predictor, log, particulars)
    return LogSession(log, Twin(particulars, predictor), _vessel(ship, particulars), out, plan)


def _fed(
    nmea: str | None,
    mavlink: str | None,
    reply: str | None,
    ship: str | None,
    predictor: str,
    full: tuple[float | None, float | None],
    out: Path,
) -> Session:
    from twin.live.sessions.feed import FeedSession

    if predictor_class(predictor).needs_simulator:
        raise PredictorError(f"predictor {predictor!r}: nobody can tell it of a real boat's sea")
    particulars, _ = particulars_for_log(Path("feed"), ship or "usv75")
    if ship is None:
        particulars = dataclasses.replace(particulars, design="")
        note("the boat is taken to be the usv75; --vessel names another")
    twin = Twin(particulars, predictor)
    if nmea is not None:
        feed: Feed = NmeaFeed(nmea, particulars, reply)
    else:
        servos = Servos.of(particulars, *full)
        feed = MavlinkFeed(str(mavlink), particulars, reply, servos=servos)
    return FeedSession(feed, twin, _vessel(ship or "usv75", particulars), out)


def _vessel(ship: str | None, particulars: Particulars) -> Vessel | None:
    """Return the vessel whose hull is to be shown; None where only particulars are known."""
    name = ship or particulars.name
    if name in vessel_names():
        vessel = Vessel.load(name)
        return vessel if particulars_of(vessel).length == particulars.length else None
    try:
        return Vessel.load(name) if ship is not None else None
    except VesselError:
        return None


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
    shaft_max: ShaftMaxOption = None,
    steer_max: SteerMaxOption = None,
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
        particulars, _ = particulars_for_log(log, ship)
        angle = None if steer_max is None else math.radians(steer_max)
        stream = MavlinkStream(Servos.of(particulars, shaft_max, angle), place)
    counts: Counter[str] = Counter()
    length = float(run.t[-1] - run.t[0])
    bar = Progress(
        *(TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()),
        console=console,
        transient=True,
    )
    span = "again and again" if loop else f"{length:g} s"
    console.print(f"sending {run.name} to {target}: {span}, {speed:g} times as fast")
    code, begun = 0, time.monotonic()
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
    late = time.monotonic() - begun - length / speed
    if not loop and late > 1.0 + 0.1 * length / speed:
        note(f"this machine was {late:.0f} s too slow for {speed:g} times as fast")
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


COMMANDS: dict[str, Callable[..., None]] = {"view": view_command, "replay": replay_command}
"""Commands by name."""
