"""``usv-twin vessel``: check a vessel file, or make a new one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin.cli.common import console, keep_file, new_table, note, write_text
from usv_gym.design.checks import inspect
from usv_gym.design.new_vessel import MainParticulars, design
from usv_gym.physics import KNOT
from usv_gym.vessel.vessel import KIND_SCHEMA, Vessel, vessel_names


def vessel_check_command(
    vessel: Annotated[
        str, typer.Argument(help=f"TOML file, or a name: {', '.join(vessel_names())}.")
    ],
) -> None:
    """Print what follows from a vessel's numbers, and every rule of thumb that they break.

    Exit code 0: no errors; 1: errors; 2: it cannot be read.
    """
    boat = Vessel.load(vessel)
    found = inspect(boat)
    table = new_table(f"{found.name}: {found.title}", "", " ", left=("",), show_header=False)
    for name, value in found.facts.items():
        table.add_row(name, f"{value:.4g}")
    console.print(table)
    for finding in found.findings:
        kind, style = ("error", "red") if finding.error else ("warning", "yellow")
        console.print(f"{kind}: {finding.text}", style=style, highlight=False, soft_wrap=True)
    warnings = len(found.findings) - len(found.errors)
    console.print(f"{len(found.errors)} error(s), {warnings} warning(s)")
    if found.errors:
        raise typer.Exit(1)


def vessel_new_command(
    name: Annotated[str, typer.Option(help="Letters, digits, _ and -.")],
    length: Annotated[float, typer.Option(help="At the waterline, m.")],
    beam: Annotated[float, typer.Option(help="At the waterline, over all hulls, m.")],
    draft: Annotated[float, typer.Option(help="Of the hull, m.")],
    mass: Annotated[float, typer.Option(help="kg.")],
    kind: Annotated[
        str, typer.Option(help=f"Propulsion, one of: {', '.join(KIND_SCHEMA)}.")
    ] = "steerable_drive",
    units: Annotated[
        int | None, typer.Option(help="1 or 2. Default: 1 propeller with rudder, else 2.")
    ] = None,
    speed: Annotated[float | None, typer.Option(help="In service, kn.")] = None,
    hulls: Annotated[int, typer.Option(help="1, or 2 of a catamaran.")] = 1,
    hull_beam: Annotated[
        float | None, typer.Option(help="Of each hull of a catamaran at the waterline, m.")
    ] = None,
    spacing: Annotated[
        float | None,
        typer.Option(help="Between the centre lines of two hulls, m. Default: beam - hull beam."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="File to write. [<name>.toml]")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file.")] = False,
) -> None:
    """Write a first vessel file: regressions estimate what is not given, and mark it."""
    path = out or Path(f"{name}.toml")
    keep_file(path, force)
    first = design(
        MainParticulars(
            name=name,
            length=length,
            beam=beam,
            draft=draft,
            mass=mass,
            kind=kind,
            units=units,
            speed=None if speed is None else speed * KNOT,
            hulls=hulls,
            hull_beam=hull_beam,
            spacing=spacing,
        )
    )
    for line in (*first.notes, *(finding.text for finding in inspect(first.vessel).errors)):
        note(line)
    write_text(path, first.text)
    console.print(
        f"{path}: {len(first.vessel.guesses)} of {len(first.vessel.values) + 2} entries are "
        f"estimates; check it with usv-twin vessel check {path}",
        soft_wrap=True,
    )
