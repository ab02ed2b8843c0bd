"""``usv-twin vessel``: check a vessel file, or make a new one, its mesh or its hydrodynamics."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.progress import TimeRemainingColumn

from twin.cli.common import console, new_table, note, progress_bar, write_json, write_text
from usv_gym.design.checks import HIGHEST, SEAS, Inspection, inspect
from usv_gym.design.new_vessel import DesignError, MainParticulars, design
from usv_gym.design.panels import FREQUENCIES, capytaine, make_table
from usv_gym.hydro.codes import Water, read_results
from usv_gym.hydro.netcdf import encode_table
from usv_gym.physics import KNOT
from usv_gym.vessel.geometry import boat_of, encode_mesh
from usv_gym.vessel.vessel import KIND_SCHEMA, MESH_FORMATS, Vessel, VesselError, vessel_names
from usv_kernel.files import write_whole


def vessel_check_command(
    vessel: Annotated[
        str, typer.Argument(help=f"TOML file, or a name: {', '.join(vessel_names())}.")
    ],
    strict: Annotated[bool, typer.Option("--strict", help="Fail on warnings too.")] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Everything, in full precision.")
    ] = None,
) -> None:
    """Print what follows from a vessel's numbers, and every rule of thumb that they break.

    Exit code 0: sound; 1: errors (with --strict also warnings); 2: it cannot be read.
    """
    boat = Vessel.load(vessel)
    boat_of(boat)  # reads its mesh file
    found = inspect(boat)
    if json_file is not None:
        write_json(json_file, found.to_json())
    _print_inspection(found)
    if found.errors or (strict and found.findings):
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
    power: Annotated[float | None, typer.Option(help="Of all shafts, kW.")] = None,
    length_overall: Annotated[
        float | None, typer.Option(help="m. Default: 5 % above the length.")
    ] = None,
    water_density: Annotated[
        float | None, typer.Option(help="kg/m3. Default: 1025, sea water.")
    ] = None,
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
    if path.exists() and not force:
        raise DesignError(f"{path}: is there already; choose another --out, or --force")
    known = MainParticulars(
        name=name,
        length=length,
        beam=beam,
        draft=draft,
        mass=mass,
        kind=kind,
        units=units,
        speed=None if speed is None else speed * KNOT,
        power=None if power is None else power * 1e3,
        length_overall=length_overall,
        water_density=water_density,
        hulls=hulls,
        hull_beam=hull_beam,
        spacing=spacing,
    )
    first = design(known)
    for line in first.notes:
        note(line)
    write_text(path, first.text)
    for finding in inspect(first.vessel).errors:
        note(finding.text)
    guesses, values = len(first.vessel.guesses), len(first.vessel.values) + 2
    console.print(
        f"{path}: {guesses} of {values} entries are estimates; check it with "
        f"usv-twin vessel check {path}",
        soft_wrap=True,
    )


def vessel_mesh_command(
    vessel: Annotated[
        str, typer.Argument(help=f"TOML file, or a name: {', '.join(vessel_names())}.")
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help=f"{', '.join(MESH_FORMATS)}. [<name>.glb]"),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file.")] = False,
) -> None:
    """Write the boat's geometric model, in m, for a 3-D program or as a vessel's mesh.

    .glb keeps parts and colours, also drives and propellers; y is up, z forward and x to port as
    in every glTF file. The other formats hold the hull and what stands on it; z is up, x forward
    and y to port.
    """
    ship = Vessel.load(vessel)
    path = out or Path(f"{ship.name}.glb")
    if path.exists() and not force:
        raise VesselError(f"{path}: is there already; choose another --out, or --force")
    boat = boat_of(ship)
    content = encode_mesh(boat, path.suffix.lower())
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, content)
    whole = boat.whole()
    long, wide, high = np.ptp(whole.bounds, axis=0)
    console.print(
        f"{path}: of a boat of {len(boat.parts)} parts, {len(whole.faces)} triangles, "
        f"with its drives {long:.4g} m long, {wide:.4g} m wide, {high:.4g} m high",
        soft_wrap=True,
    )


def vessel_hydro_command(
    vessel: Annotated[
        str, typer.Argument(help=f"TOML file, or a name: {', '.join(vessel_names())}.")
    ],
    results: Annotated[
        Path | None,
        typer.Option(
            "--from",
            help="Results of another code instead: capytaine's .nc, a folder of NEMOH, WAMIT's .1.",
        ),
    ] = None,
    origin: Annotated[
        float,
        typer.Option(help="With --from: how far their origin lies forward of the vessel's, m."),
    ] = 0.0,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="[<name>.nc]")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file.")] = False,
) -> None:
    """Make a hydrodynamic table of a vessel's hull, a minute or two with capytaine.

    The table holds added mass, radiation damping, excitation and mean drift by frequency and
    heading. A vessel file names it with hydro = "FILE" in [vessel].
    """
    boat = Vessel.load(vessel)
    path = out or Path(f"{boat.name}.nc")
    if path.exists() and not force:
        raise VesselError(f"{path}: is there already; choose another --out, or --force")
    if results is not None:
        v = boat.values
        water = Water(v["length_waterline"], v["water_density"], v["mass"])
        table = read_results(results, water, origin)
    else:
        command = f"usv-twin vessel hydro {boat.name}, capytaine {capytaine().__version__}"
        with progress_bar(TimeRemainingColumn(), transient=True) as progress:
            bar = progress.add_task(boat.name, total=len(FREQUENCIES))
            table = make_table(boat, lambda done: progress.update(bar, completed=done), command)
    with_table = boat.with_table(table)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, encode_table(table))
    shown = new_table(f"{boat.name}: {table.source}", "", "file", "table", left=("",))
    for key, value in with_table.values.items():
        stated = with_table.stated.get(key)
        if value != stated:
            shown.add_row(key, "-" if stated is None else f"{stated:.4g}", f"{value:.4g}")
    console.print(shown)
    console.print(
        f'{path}: write hydro = "{path.name}" in [vessel] of the vessel file beside it',
        soft_wrap=True,
    )


def _print_inspection(found: Inspection) -> None:
    """Print the derived particulars of a vessel, and the rules that it breaks."""
    units = {"mps": "m/s", "degps": "deg/s", "rps": "rev/s"}
    facts = new_table(f"{found.name}: {found.title}", "", " ", left=("",), show_header=False)
    rows = {
        **found.particulars,
        **{f"period of {name} s": value for name, value in found.periods.items()},
        **{
            f"turn: {' '.join(units.get(word, word) for word in name.split('_'))}": value
            for name, value in found.turn.items()
        },
    }
    for name, value in rows.items():
        facts.add_row(name, f"{value:.4g}")
    if found.course:
        roots = f"{found.course['first_real']:.3g}, {found.course['second_real']:.3g} 1/s"
        stable = "stable" if found.course["first_real"] < 0.0 else "unstable"
        facts.add_row("straight course at service speed", f"{stable} ({roots})")
    for sea, trial in found.seaway.items():
        facts.add_row(f"sea {sea}: largest tilt deg", f"{trial['largest_tilt_deg']:.4g}")
    console.print(facts)
    heads = ("shaft rev/s", "speed m/s", "kn", "Froude", "thrust N")
    speeds = new_table("straight ahead in calm water", *heads, padding=(0, 1))
    for row in found.speeds:
        speeds.add_row(*(f"{value:.4g}" for value in row.values()))
    console.print(speeds)
    console.print(_capsizing(found), highlight=False, soft_wrap=True)
    for finding in found.findings:
        kind, style = ("error", "red") if finding.error else ("warning", "yellow")
        console.print(f"{kind}: {finding.text}", style=style, highlight=False, soft_wrap=True)
    warnings = len(found.findings) - len(found.errors)
    console.print(f"{len(found.errors)} error(s), {warnings} warning(s)")


def _capsizing(found: Inspection) -> str:
    """Return in which seas a vessel capsizes with six degrees of freedom, and which were tried."""
    over = [sea for sea, trial in found.seaway.items() if trial["capsized"]]
    upright = [sea for sea in found.seaway if sea not in over]
    rest = [sea for sea in SEAS if sea not in found.seaway]
    said = {"capsizes in": over, "upright in": upright, "not tried:": rest}
    parts = [f"{what} sea {', '.join(seas)}" for what, seas in said.items() if seas]
    why = " (errors)" if found.errors else f" (rougher, or waves above {HIGHEST:g} lengths)"
    return f"a minute with dof=6: {'; '.join(parts)}{why if rest else ''}"
