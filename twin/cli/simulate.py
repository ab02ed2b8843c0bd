"""``usv-twin simulate``: sail a manoeuvre and write its log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin.cli.common import (
    FAULT_START_S,
    DofOption,
    HsOption,
    OptionError,
    SeaOption,
    SensorsOption,
    WindFromOption,
    WindOption,
    console,
    note,
    note_capsizing,
)
from twin.logs.log import LOG_SUFFIXES, sibling_path
from twin.sim.bridge import particulars_of, simulate, write_run
from usv_gym.manoeuvring.manoeuvres import SCENARIOS
from usv_gym.vessel.vessel import Vessel, vessel_names
from usv_gym.world.faults import FAULTS_HELP, ineffective_fault, parse_faults
from usv_gym.world.schedule import changing_sea
from usv_gym.world.sea import SeaState
from usv_gym.world.sensors import SensorSuite


def simulate_command(
    manoeuvre: Annotated[
        str,
        typer.Argument(
            help=f"One of: {', '.join(SCENARIOS)}. headingN: N degrees to where the waves go."
        ),
    ] = "turn",
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help="Log: .csv, .csv.gz, .parquet, .mcap. [<manoeuvre>_<seed>.csv]"
        ),
    ] = None,
    vessel: Annotated[
        str, typer.Option(help=f"Name ({', '.join(vessel_names())}) or TOML file.")
    ] = "usv75",
    duration: Annotated[
        float, typer.Option(min=1.0, max=86400.0, help="Length of the run, s.")
    ] = 120.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of sea and sensors.")] = 0,
    sea: SeaOption = "2",
    hs: HsOption = None,
    wind: WindOption = None,
    wind_from: WindFromOption = None,
    faults: Annotated[str, typer.Option(help=f"Faults of sensors: {FAULTS_HELP}.")] = "none",
    sensors: SensorsOption = "typical",
    dof: DofOption = 3,
) -> None:
    """Sail a manoeuvre in a sea state: a log, and the boat's particulars beside it.

    usv-twin check LOG draws it.
    """
    if out is not None and not out.name.endswith(LOG_SUFFIXES):
        raise OptionError(f"--out {out}: a log's name ends in {', '.join(LOG_SUFFIXES)}")
    boat = Vessel.load(vessel)
    state = changing_sea(SeaState.named(sea), hs, wind, wind_from)
    suite, parsed = SensorSuite.grade(sensors), parse_faults(faults, FAULT_START_S)
    for fault in parsed:
        if getattr(fault, "start", 0.0) >= duration:
            note(f"the fault of {fault.kind} begins after the run; gps10@30 begins at 30 s")
    if (found := ineffective_fault(parsed, dof, suite.has_anemometer)) is not None:
        note(found)
    note_capsizing(boat, state, dof)
    path = out or Path(f"{manoeuvre}_{seed}.csv")
    log = simulate(
        manoeuvre,
        vessel=boat,
        sea=state,
        duration=duration,
        seed=seed,
        faults=parsed,
        suite=suite,
        dof=dof,
    )
    write_run(log, particulars_of(boat, suite, dof), path)
    console.print(f"{len(log)} rows, {duration:g} s: {path}, {sibling_path(path, '.toml')}")
