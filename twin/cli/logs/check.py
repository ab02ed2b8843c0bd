"""``usv-twin log check``: what is in a log, and what is wrong with it, before anything is run."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from twin.cli.common import (
    LogArgument,
    MappingOption,
    OptionError,
    console,
    new_table,
    note,
    write_json,
    write_text,
)
from twin.cli.logs.check_picture import draw_check
from twin.integrity.findings import ERROR, NOTE, SEVERITIES, WARNING
from twin.integrity.log_check import LogCheck, check_log
from twin.sim.recorded import has_particulars, particulars_for_log
from usv_kernel.files import write_whole

STYLES = {ERROR: "red", WARNING: "yellow", NOTE: "dim"}


def log_check_command(
    log: LogArgument,
    ship: Annotated[
        str | None,
        typer.Option(
            "--ship",
            "--vessel",
            help="Main particulars of the boat: a TOML file, or the name of a vessel. They tell "
            "units of commands. Default: the .toml of the log's name beside the log, if any.",
        ),
    ] = None,
    mapping: MappingOption = None,
    picture: Annotated[
        Path | None, typer.Option("--out", "-o", help="Picture, PNG. [<log>_check.png]")
    ] = None,
    no_picture: Annotated[bool, typer.Option("--no-picture", help="Draw none.")] = False,
    write: Annotated[
        Path | None,
        typer.Option(help="Particulars file to write, with the instruments as the log shows them."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite that file.")] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Fail on warnings too.")] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Everything, in full precision.")
    ] = None,
) -> None:
    """Tell what is in a log and what is wrong with it, before anything is run.

    Checked are rates, gaps, jitter, noise and delays of the sensors, units, signs, axes and sides,
    and where sensors contradict each other. One line a finding, with its number and the remedy.

    Exit code 0: sound; 1: errors (with --strict also warnings); 2: it cannot be read.
    """
    if write is not None and write.exists() and not force:
        raise OptionError(f"--write {write}: is there already; choose another name, or --force")
    known = ship is not None or has_particulars(log)
    boat = particulars_for_log(log, ship, mapping) if known else None
    found = check_log(log, mapping, boat)
    for line in found.notes:
        note(line)
    _print_measured(found)
    if boat is not None:
        console.print(f"held against the particulars of {boat.name}", highlight=False)
    for finding in found.findings:
        style = STYLES[finding.severity]
        text = f"{finding.severity}: {finding.text}"
        console.print(text, style=style, highlight=False, soft_wrap=True)
    counts = [f"{found.count(severity)} {severity}(s)" for severity in SEVERITIES]
    console.print(", ".join(counts), highlight=False)
    if json_file is not None:
        write_json(json_file, found.to_json())
    if not no_picture and len(found.recording.t) > 1:
        path = picture or Path(f"{found.recording.name}_check.png")
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, draw_check(found))
        console.print(f"picture: {path}", soft_wrap=True)
    if write is not None:
        write_text(write, found.particulars_text(boat))
        console.print(f"particulars: {write}", soft_wrap=True)
        if boat is None:
            note("length, beam, draft and mass stand in no log: fill them in before use")
    if found.count(ERROR) or (strict and found.count(WARNING)):
        raise typer.Exit(1)


def _print_measured(found: LogCheck) -> None:
    """Print what was measured: rates and noise, and how sensors agree."""
    t = found.recording.t
    if len(t) < 2:
        return
    title = f"{found.recording.name}: {len(found.recording.stamps)} rows, {t[-1] - t[0]:.1f} s"
    sensors = new_table(title, "sensor", "samples/s", "noise", "unit", left=("sensor", "unit"))
    for each in found.sensors:
        sensors.add_row(
            each.name,
            f"{each.rate_hz:.3g}" if each.rate_hz else "none",
            f"{each.noise:.2g}" if math.isfinite(each.noise) else "",
            each.unit,
        )
    console.print(sensors)
    for line in found.agreement:
        console.print(line, highlight=False, soft_wrap=True)
