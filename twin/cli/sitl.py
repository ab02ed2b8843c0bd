"""``usv-twin sitl``: ship and sea as the physics of ArduPilot."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Annotated

import typer

from twin.cli.common import (
    CurrentOption,
    CurrentToOption,
    HsOption,
    OptionError,
    SeaOption,
    SensorsOption,
    WindFromOption,
    WindOption,
    console,
    note,
    note_capsizing,
    radians,
)
from twin.cli.link import MaxSdOption, counted, say
from twin.digital_twin import Twin
from twin.live.external.navigation import ExternalNavigation
from twin.live.external.peer import AutopilotPeer, MavlinkPort
from twin.live.external.simulated import AutopilotRun, suite_of, unmirrored
from twin.logs.datum import Datum
from twin.logs.log import Log
from twin.particulars import Particulars
from twin.predictors.registry import PREDICTORS, PredictorError, predictor_class
from twin.sim.bridge import particulars_of, write_run
from usv_gym.sitl.backend import Backend, port_of
from usv_gym.sitl.parameters import autopilot_parameters, parameter_text
from usv_gym.sitl.server import LOOPBACK, Server
from usv_gym.vessel.vessel import Vessel, vessel_names
from usv_gym.world.faults import FAULTS_HELP, parse_faults
from usv_gym.world.schedule import changing_sea
from usv_gym.world.sea import SeaState
from usv_gym.world.simulation import Simulation

FAULT_START_S = 180.0
"""Start of a fault that says none, as gps10 and not gps10@30: the autopilot sails by then."""


def sitl_command(
    vessel: Annotated[
        str, typer.Argument(help=f"Name ({', '.join(vessel_names())}) or TOML file.")
    ] = "usv75",
    print_params: Annotated[
        bool,
        typer.Option(
            "--print-params", help="Print parameters of the autopilot for the vessel, and end."
        ),
    ] = False,
    cruise: Annotated[
        float | None, typer.Option(help="Cruising speed of these parameters, m/s.")
    ] = None,
    twin: Annotated[
        str | None,
        typer.Option(help=f"Predictor of the twin ({', '.join(PREDICTORS)}). Default: no twin."),
    ] = None,
    max_sd: MaxSdOption = 20.0,
    mavlink: Annotated[
        str,
        typer.Option(
            help="Where the autopilot speaks MAVLink, for the twin and faults of its GPS."
        ),
    ] = "udp://127.0.0.1:14551",
    sea: SeaOption = "2",
    hs: HsOption = None,
    wind: WindOption = None,
    wind_from: WindFromOption = None,
    current: CurrentOption = None,
    current_to: CurrentToOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of sea and sensors.")] = 0,
    faults: Annotated[
        str,
        typer.Option(
            help="Faults of the twin's sensors. A loss of the GPS strikes the autopilot's "
            f"receiver, too: {FAULTS_HELP}."
        ),
    ] = "none",
    sensors: SensorsOption = "typical",
    home: Annotated[str, typer.Option(help="Home of the autopilot, LAT,LON.")] = "59.9,10.7",
    heading: Annotated[float, typer.Option(help="Heading at the start, degrees.")] = 0.0,
    moored: Annotated[
        bool,
        typer.Option(
            "--moored/--adrift", help="Whether the boat stays until a motor is first driven."
        ),
    ] = True,
    rate: Annotated[int, typer.Option(min=20, max=1000, help="Steps per second, Hz.")] = 100,
    instance: Annotated[
        int, typer.Option("--instance", "-I", help="Instance of the autopilot: port 9002 + 10 I.")
    ] = 0,
    address: Annotated[
        str, typer.Option(help="Address to listen at; all but loopback are open to others.")
    ] = LOOPBACK,
    duration: Annotated[
        float, typer.Option(min=0.0, help="End after so many simulated seconds; 0: at Ctrl-C.")
    ] = 0.0,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Log to write, with the truth."),
    ] = None,
) -> None:
    """Be the physics of ArduPilot: our ship and sea answer its JSON interface.

    Start the autopilot with --model JSON:127.0.0.1. With --twin, the twin is its external
    navigation while the GPS is lost. Ctrl-C ends it; the log is written then.
    """
    boat = Vessel.load(vessel)
    if print_params:
        given = autopilot_parameters(boat, cruise, external=twin is not None)
        console.print(parameter_text(boat, given), end="", highlight=False, soft_wrap=True)
        return
    state = changing_sea(SeaState.named(sea), hs, wind, wind_from)
    state = state.replace(current=current, current_to=radians(current_to))
    parsed, suite = parse_faults(faults, FAULT_START_S), suite_of(sensors)
    for kind in unmirrored(parsed):
        note(f"the fault {kind} strikes the twin's sensors alone, not those of the autopilot")
    note_capsizing(boat, state, 6)
    step = 1.0 / rate
    simulation = Simulation(
        1, boat, state, suite=suite, faults=parsed, dof=6, dt=step, dt_physics=step
    )
    backend = Backend(simulation, seed, heading=math.radians(heading), moored=moored)
    particulars = particulars_of(boat, suite, 6)
    model, navigation = None, None
    if twin is not None:
        if predictor_class(twin).needs_simulator:
            raise PredictorError(f"predictor {twin!r}: the sea is not known to an autopilot")
        model = Twin(particulars, twin)
        navigation = ExternalNavigation(say, max_sd_m=max_sd)
    latitude, longitude = _place(home)
    port = None
    if navigation is not None or parsed:
        port = MavlinkPort(mavlink, AutopilotPeer() if navigation is None else navigation.peer)
    with Server(backend, address, port_of(instance)) as server:
        run = AutopilotRun(
            backend,
            Datum(latitude=latitude, longitude=longitude),
            twin=model,
            navigation=navigation,
            port=port,
            on_log=_Logs(out, particulars).write,
        )
        _announce(server, address, home, mavlink if port is not None else None, instance)
        try:
            _serve(server, duration)
        except KeyboardInterrupt:
            console.print("stopped")
        finally:
            run.finish()
            if port is not None:
                port.close()
    console.print(f"packets: {counted(backend.counts)}", highlight=False)
    if port is not None:
        console.print(f"MAVLink: {counted(port.counts)}", highlight=False)


def _place(text: str) -> tuple[float, float]:
    """Return latitude and longitude of ``LAT,LON``, degrees."""
    try:
        latitude, longitude = map(float, text.split(","))
    except ValueError:
        raise OptionError(f"--home {text}: write LAT,LON in degrees, as 59.9,10.7") from None
    return latitude, longitude


def _announce(server: Server, address: str, home: str, mavlink: str | None, instance: int) -> None:
    """Say how the autopilot is started."""
    console.print(f"waiting for ArduPilot at {address} port {server.port}", highlight=False)
    serial = ""
    if mavlink is not None:
        serial = f" --serial0 udpclient:{mavlink.removeprefix('udp://')}"
    console.print(
        f"  ardurover -w -S --model JSON:{address} --rate {round(1 / server.backend.simulation.dt)}"
        f" --home {home},0,0 --defaults rover.parm,our.parm{serial} -I{instance}",
        highlight=False,
        soft_wrap=True,
    )


def _serve(server: Server, duration: float) -> None:
    """Answer the autopilot until Ctrl-C, or for so many simulated seconds."""
    backend, begun, before = server.backend, math.nan, 0.0
    while not (duration and backend.t >= duration):
        server.poll()
        if math.isnan(begun) and backend.counts["steps"]:
            begun, before = time.monotonic(), backend.t
            say(backend.t, "ArduPilot is there")
    spent = time.monotonic() - begun
    if spent > 0.0:
        factor = (backend.t - before) / spent
        console.print(f"{backend.t:.0f} s, {factor:.1f} times as fast as the clock")


class _Logs:
    """Writes the logs of the runs as they end, and the boat's particulars beside them."""

    def __init__(self, out: Path | None, particulars: Particulars) -> None:
        self.out, self.particulars, self.written = out, particulars, 0

    def write(self, log: Log) -> None:
        """Write a log; the first has the name as given, others a number behind it."""
        if self.out is None:
            return
        self.written += 1
        path = self.out
        if self.written > 1:
            path = path.with_name(f"{path.stem}_{self.written}{path.suffix}")
        write_run(log, self.particulars, path)
        console.print(f"{len(log)} rows: {path}", highlight=False, soft_wrap=True)
