"""``usv-twin view``: a boat and its twin in the browser."""

from __future__ import annotations

import dataclasses
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from twin.agents.policy import AgentError
from twin.cli.common import (
    FAULT_START_S,
    DofOption,
    HsOption,
    MappingOption,
    PredictorOption,
    SeaOption,
    SensorsOption,
    ShaftMaxOption,
    SteerMaxOption,
    WindFromOption,
    WindOption,
    console,
    note,
    radians,
)
from twin.digital_twin import Twin
from twin.live.protocols.mavlink import MavlinkFeed, Servos
from twin.logs.errors import LogError
from twin.logs.log import Log
from twin.logs.wire.feed import Feed
from twin.logs.wire.nmea import NmeaFeed
from twin.logs.wire.sockets import needed
from twin.particulars import Particulars
from twin.predictors.registry import DEFAULT, PredictorError, predictor_class
from twin.sim.bridge import particulars_of
from twin.sim.oracle import check_simulator
from twin.sim.recorded import particulars_for_log
from usv_gym.manoeuvring.manoeuvres import MANOEUVRES
from usv_gym.vessel.vessel import Vessel, VesselError, vessel_names
from usv_gym.world.faults import FAULTS_HELP, parse_faults
from usv_gym.world.schedule import changing_sea
from usv_gym.world.sea import SeaState

if TYPE_CHECKING:
    from twin.live.sessions.session import Session


def view_command(
    log: Annotated[
        Path | None,
        typer.Argument(help="Log to show. Default: a simulated boat, or a feed."),
    ] = None,
    nmea: Annotated[
        str | None,
        typer.Option(help="Follow a boat that sends NMEA 0183 to this address: udp://:10110."),
    ] = None,
    mavlink: Annotated[
        str | None,
        typer.Option(help="Follow a boat or an autopilot by MAVLink: udp://:14550."),
    ] = None,
    policy: Annotated[
        str | None,
        typer.Option(
            metavar="AGENT",
            help="Let it sail its task, as usv-twin evaluate does: a policy (.npz), a model of "
            "Stable-Baselines3 (.zip), a run's folder, a controller, or module:Class. Degrees of "
            "freedom and time of an episode are those of its training.",
        ),
    ] = None,
    vessel: Annotated[
        str | None,
        typer.Option(
            "--vessel",
            "--ship",
            help=f"The boat: a name ({', '.join(vessel_names())}) or a TOML file; for a log or a "
            "feed, main particulars will do. Default: the .toml beside the log; of a feed usv75.",
        ),
    ] = None,
    predictor: PredictorOption = DEFAULT,
    mapping: MappingOption = None,
    plan: Annotated[
        str,
        typer.Option(
            help="Future commands of a log. known: those that follow; hold: the last one stays."
        ),
    ] = "known",
    sea: SeaOption = "2",
    hs: HsOption = None,
    wind: WindOption = None,
    wind_from: WindFromOption = None,
    dof: DofOption = 6,
    sensors: SensorsOption = "typical",
    faults: Annotated[str, typer.Option(help=f"Faults of sensors: {FAULTS_HELP}.")] = "none",
    shaft_max: ShaftMaxOption = None,
    steer_max: SteerMaxOption = None,
    autopilot: Annotated[
        str, typer.Option(help=f"Who steers a simulated boat: off, {', '.join(MANOEUVRES)}.")
    ] = "turn",
    seed: Annotated[int, typer.Option(min=0, help="Seed of sea and sensors.")] = 0,
    speed: Annotated[
        float, typer.Option(min=0.1, max=10.0, help="Simulated seconds per second.")
    ] = 1.0,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for logs that are recorded.")
    ] = Path(),
    port: Annotated[
        int, typer.Option(min=1, max=65535, help="Port; if it is taken, the next free one.")
    ] = 8080,
) -> None:
    """Show a boat and its twin in the browser, live and in three dimensions.

    Without a log or a feed, the boat is simulated: steer it, change the weather, lose its GPS.
    Ctrl-C ends it; a log that is being recorded is written then.
    """
    needed("viser")  # before anything is compiled
    from twin.live.sessions.feed import FeedSession
    from twin.live.sessions.simulated import SimulatedSession, SimulationSetup

    sources = ("LOG", log), ("--nmea", nmea), ("--mavlink", mavlink), ("--policy", policy)
    given = [name for name, one in sources if one]
    if len(given) > 1:
        raise LogError(f"{' and '.join(given)}: look at one of them at a time")
    session: Session
    if log is not None:
        session = _log_session(log, mapping, vessel, predictor, plan, out)
    elif nmea is not None or mavlink is not None:
        twin, shown = feed_twin(vessel, predictor)
        if nmea is not None:
            feed: Feed = NmeaFeed(nmea, twin.particulars)
        else:
            servos = Servos.of(twin.particulars, shaft_max, radians(steer_max))
            feed = MavlinkFeed(str(mavlink), twin.particulars, servos=servos)
        session = FeedSession(feed, twin, shown, out)
    elif policy is not None:
        options = {"sea": changing_sea(SeaState.named(sea), hs, wind, wind_from)}
        losses = parse_faults(faults, FAULT_START_S)
        own = {"seed": seed, "predictor": predictor, "faults": losses, "suite": sensors}
        session = _policy_session(policy, out, vessel, **options, **own)
    else:
        boat = Vessel.load(vessel or "usv75")
        setup = SimulationSetup(
            vessel=boat,
            sea=changing_sea(SeaState.named(sea), hs, wind, wind_from),
            predictor=predictor,
            sensors=sensors,
            seed=seed,
            dof=dof,
            faults=parse_faults(faults, FAULT_START_S),
        )
        session = SimulatedSession(setup, out, autopilot)
        for line in session.notes:
            note(line)
    session.set_scale(speed)
    show_session(session, port)


def _policy_session(name: str, out: Path, vessel: str | None, **options: Any) -> Session:
    """Return the session of an agent by its name, in the environment of its training."""
    from twin.agents.evaluation import agents_named, trained_with
    from twin.agents.weights import SavedPolicy
    from twin.live.sessions.policy import PolicySession

    given = {} if vessel is None else {"vessel": vessel}
    agents = agents_named(name, suite=options["suite"], **given)
    if len(agents) != 1:
        raise AgentError(f"--policy {name}: holds {len(agents)} agents; name one of them")
    ((_label, agent),) = agents
    if isinstance(agent, SavedPolicy):
        note(agent.note)
    return PolicySession(agent, out, **trained_with([agent], given), **options)


def show_session(session: Session, port: int) -> None:
    """Serve a session until Ctrl-C, or until it ends."""
    from twin.live.ui.viewer import Viewer

    viewer = Viewer(session, port)
    for kind in (signal.SIGINT, signal.SIGTERM):  # also where a shell ignores them
        signal.signal(kind, signal.default_int_handler)
    try:
        session.start()
        if viewer.port != port:
            note(f"port {port} is in use")
        console.print(f"look at {viewer.url} (Ctrl-C ends it)", highlight=False, soft_wrap=True)
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


def _log_session(
    path: Path, mapping: Path | None, ship: str | None, predictor: str, plan: str, out: Path
) -> Session:
    """Return the session of a log with its twin."""
    from twin.live.sessions.log import LogSession

    log = Log.read(path, mapping)
    for line in log.notes:
        note(line)
    particulars = particulars_for_log(path, ship, mapping)
    check_simulator(predictor, log, particulars)
    return LogSession(log, Twin(particulars, predictor), _vessel(ship, particulars), out, plan)


def feed_twin(ship: str | None, predictor: str) -> tuple[Twin, Vessel | None]:
    """Return the twin of a boat that sends its measurements, and the vessel to show."""
    if predictor_class(predictor).needs_simulator:
        raise PredictorError(f"predictor {predictor!r}: the sea of a real boat is not known to it")
    particulars = particulars_for_log(Path("feed"), ship or "usv75")
    if ship is None:
        particulars = dataclasses.replace(particulars, design="")
        note("the boat is taken to be the usv75; --vessel names another")
    return Twin(particulars, predictor), _vessel(ship or "usv75", particulars)


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
