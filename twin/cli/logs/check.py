"""``usv-twin log check``: what is in a log, and what is wrong with it, before anything is run."""

from __future__ import annotations

import dataclasses
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
from twin.logs.diagnosis.diagnose import Diagnosis, diagnose
from twin.logs.diagnosis.findings import ERROR, NOTE, WARNING, Finding, Recording
from twin.logs.diagnosis.instruments import particulars_text
from twin.logs.errors import LogError
from twin.logs.log import assemble, read_table
from twin.logs.readers import Table
from twin.particulars import Particulars
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

    Checked are rates, gaps, jitter, noise and delays of the sensors. Compass is compared with gyro
    and track, speed with fixes, commands with the motion. Units, signs and sides, rest, and forces
    without a command are checked, too. One line a finding, with its number and the remedy.

    Exit code 0: sound; 1: errors (with --strict also warnings); 2: it cannot be read.
    """
    if write is not None and write.exists() and not force:
        raise OptionError(f"--write {write}: is there already; choose another name, or --force")
    table = read_table(log, mapping)
    known = ship is not None or has_particulars(log)
    boat = particulars_for_log(log, ship, mapping) if known else None
    recording = Recording.of(table.data, table.given, table.name, table.plane)
    found = diagnose(recording, boat)
    extra = []
    if table.lacking:
        what = table.lacking.removeprefix(f"{table.source}: ")
        extra.append(Finding(ERROR, "columns-missing", what, ""))
    elif not found.of(ERROR):
        extra += _refused(table)
    findings = (*extra, *found.findings)
    for line in table.notes:
        note(line)
    _print_measured(found, boat)
    for finding in findings:
        style = STYLES[finding.severity]
        text = f"{finding.severity}: {finding.text}"
        console.print(text, style=style, highlight=False, soft_wrap=True)
    counts = {kind: sum(f.severity == kind for f in findings) for kind in STYLES}
    console.print(
        f"{counts[ERROR]} error(s), {counts[WARNING]} warning(s), {counts[NOTE]} note(s)",
        highlight=False,
    )
    if json_file is not None:
        content = found.to_json()
        content["findings"] = [
            {"severity": f.severity, "code": f.code, "what": f.what, "remedy": f.remedy}
            for f in extra
        ] + content["findings"]
        write_json(json_file, content)
    if not no_picture and len(recording.t) > 1:
        path = picture or Path(f"{table.name}_check.png")
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, draw_check(found))
        console.print(f"picture: {path}", soft_wrap=True)
    if write is not None:
        _write_particulars(write, found, boat)
    if counts[ERROR] or (strict and counts[WARNING]):
        raise typer.Exit(1)


def _refused(table: Table) -> list[Finding]:
    """Return what the strict reader refuses the log for, if the detectors did not see it."""
    try:
        assemble(dataclasses.replace(table, notes=[]))  # its notes repeat the findings
    except LogError as error:
        return [Finding(ERROR, "refused", str(error), "")]
    return []


def _write_particulars(path: Path, found: Diagnosis, boat: Particulars | None) -> None:
    write_text(path, particulars_text(found, boat))
    console.print(f"particulars: {path}", soft_wrap=True)
    if boat is None:
        note("length, beam, draft and mass stand in no log: fill them in before use")


def _print_measured(found: Diagnosis, boat: Particulars | None) -> None:
    """Print what was measured: rates and noise, and how sensors agree."""
    recording, measured = found.recording, found.measured
    t = recording.t
    if len(t) < 2:
        return
    title = f"{recording.name}: {len(recording.stamps)} rows, {t[-1] - t[0]:.1f} s"
    heads = ("sensor", "samples/s", "noise", "unit")
    sensors = new_table(title, *heads, left=("sensor", "unit"))
    noise = {
        "fix": ("gps_m", "m", 1.0),
        "velocity": ("velocity_mps", "m/s", 1.0),
        "compass": ("compass_rad", "deg", 180.0 / math.pi),
        "gyro": ("gyro_radps", "deg/s", 180.0 / math.pi),
        "accelerometers": ("accel_mps2", "m/s2", 1.0),
        "roll and pitch gyros": ("tilt_radps", "deg/s", 180.0 / math.pi),
        "vertical accelerometer": ("lift_mps2", "m/s2", 1.0),
        "AHRS": ("ahrs_rad", "deg", 180.0 / math.pi),
        "height": ("height_m", "m", 1.0),
        "vertical speed": ("climb_mps", "m/s", 1.0),
    }
    for sensor, rate in measured.rates.items():
        key, unit, scale = noise.get(sensor, ("", "", 1.0))
        value = measured.noise.get(key, math.nan) * scale
        sensors.add_row(
            sensor,
            f"{rate:.3g}" if rate else "none",
            f"{value:.2g}" if math.isfinite(value) else "",
            unit if rate else "",
        )
    console.print(sensors)
    for line in _agreement(found, boat):
        console.print(line, highlight=False, soft_wrap=True)


def _agreement(found: Diagnosis, boat: Particulars | None) -> list[str]:
    """Return lines on how sensors and commands agree with each other."""
    measured, lines = found.measured, []
    gyro, headed = measured.gyro, measured.rates["compass"] > 0.0
    if gyro is not None and abs(gyro.correlation) > 0.8:
        late = f", {gyro.lag:+.2f} s late" if gyro.lag else ""
        lines.append(
            f"gyro against compass: scale {gyro.scale:.3f}, bias {gyro.bias:+.4f} rad/s{late}"
        )
    elif measured.rates["gyro"] and headed:
        lines.append("gyro against compass: cannot tell, the boat turns too little")
    track = measured.track
    if track is not None and track.is_known:
        off, sd = math.degrees(track.legs), math.degrees(track.legs_sd)
        lines.append(f"track against compass: {off:+.1f} degrees (standard deviation {sd:.1f})")
    elif headed:
        lines.append(
            "track against compass: cannot tell; sail legs in opposite directions, or circles to "
            "both sides"
        )
    velocity = measured.velocity
    if velocity is not None:
        late = f", {velocity.lag:+.2f} s late" if velocity.lag else ""
        lines.append(f"fixes against speed over ground: ratio {velocity.ratio:.3f}{late}")
    imu = measured.imu
    if imu is not None and imu.correlation > 0.7 and imu.latency_sd < 0.2:
        lines.append(
            f"GPS latency: {imu.latency:.2f} s behind the accelerometers (standard deviation "
            f"{imu.latency_sd:.2f} s)"
        )
    else:
        lines.append("GPS latency: cannot tell without accelerometers that see the boat accelerate")
    for name, called in (("difference", "unequal thrust"), ("steering", "steering angle")):
        effect = measured.effects.get(name)
        if effect is not None and effect.clear:
            side = "starboard" if effect.gain > 0.0 else "port"
            lines.append(
                f"{called} above 0 turns to {side}, and explains {effect.share:.0%} of the turning"
            )
        elif effect is not None:
            lines.append(f"{called}: cannot tell its sign")
    if measured.unchecked:
        lines.append(f"axes of the IMU: cannot tell those of {', '.join(measured.unchecked)}")
    elif measured.unchecked is not None:
        lines.append("axes of the IMU: each moves enough to be checked")
    if boat is not None:
        lines.append(f"held against the particulars of {boat.name}")
    return lines
