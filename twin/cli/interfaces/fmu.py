"""``usv-twin fmu``: a vessel in its sea as a co-simulation unit."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin.cli.common import (
    CurrentOption,
    CurrentToOption,
    DofOption,
    HsOption,
    SeaOption,
    WindFromOption,
    WindOption,
    console,
    note_capsizing,
    radians,
)
from usv_gym.cosimulation.unit import CosimulationError, write_unit
from usv_gym.vessel.vessel import Vessel, vessel_names
from usv_gym.world.schedule import changing_sea
from usv_gym.world.sea import SeaState


def fmu_command(
    vessel: Annotated[
        str, typer.Argument(help=f"Name ({', '.join(vessel_names())}) or TOML file.")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="File to write. [<name>.fmu]")
    ] = None,
    sea: SeaOption = "0",
    hs: HsOption = None,
    wind: WindOption = None,
    wind_from: WindFromOption = None,
    current: CurrentOption = None,
    current_to: CurrentToOption = None,
    seed: Annotated[int, typer.Option(min=0, max=2**31 - 1, help="Seed of sea and wind.")] = 0,
    dof: DofOption = 3,
    step: Annotated[float, typer.Option(help="Its step, s; a whole multiple of 0.05.")] = 0.05,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file.")] = False,
) -> None:
    """Write a vessel in its sea as a co-simulation unit (FMI 2.0).

    Inputs are shaft speeds and drive angles, outputs the state of the ship. Wave height, wind,
    current and seed are parameters. It runs where usv-twin is installed.
    """
    path = out or Path(f"{Vessel.load(vessel).name}.fmu")
    if path.exists() and not force:
        raise CosimulationError(f"{path}: is there already; choose another --out, or --force")
    state = changing_sea(SeaState.named(sea), hs, wind, wind_from)
    if state.schedule:
        raise CosimulationError("a unit's sea does not change; give single numbers, without @")
    state = state.replace(current=current, current_to=radians(current_to))
    note_capsizing(Vessel.load(vessel), state, dof)
    write_unit(vessel, path, state, seed=seed, dof=dof, dt=step)
    console.print(f"{path}: {Vessel.load(vessel).name}, FMI 2.0 for co-simulation", soft_wrap=True)
