"""``usv-twin check``: what is wrong with a log, and whether a twin of it may be trusted."""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from twin.benchmark.trust import BAD, OK, Verdict, judge
from twin.cli.common import (
    LogsArgument,
    MappingOption,
    OptionError,
    PredictorOption,
    ShipOption,
    console,
    keep_file,
    keep_logs,
    note,
    print_notes,
    row_progress,
    write_json,
    write_text,
)
from twin.cli.pictures import draw_check
from twin.cli.tables import print_check, print_verdict
from twin.integrity.findings import ERROR, WARNING
from twin.integrity.instruments import renewed
from twin.integrity.log_check import LogCheck, check_log
from twin.logs.log import merged_notes, sibling_path
from twin.particulars import Particulars, ParticularsError
from twin.predictors.registry import DEFAULT
from twin.sim.recorded import has_particulars, particulars_for_log
from usv_kernel.files import read_toml, write_whole


def check_command(
    logs: LogsArgument,
    ship: ShipOption = None,
    mapping: MappingOption = None,
    predictor: PredictorOption = DEFAULT,
    no_twin: Annotated[
        bool, typer.Option("--no-twin", help="Only check the log: no twin runs over it.")
    ] = False,
    picture: Annotated[
        Path | None, typer.Option("--out", "-o", help="Picture, PNG. [<log>_check.png]")
    ] = None,
    no_picture: Annotated[bool, typer.Option("--no-picture", help="Draw none.")] = False,
    write: Annotated[
        Path | None,
        typer.Option(help="Particulars file to write, with the instruments as the logs show them."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite that file.")] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Fail on warnings and a doubtful twin, too.")
    ] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Everything, in full precision.")
    ] = None,
) -> None:
    """Tell what is wrong with a log, or several, and whether a twin of it may be trusted.

    First the log: rates, gaps, noise and delays of the sensors, units, signs and sides, and how
    sensors and commands agree. One line a finding, with its number and the remedy.

    Then the twin, where the particulars of the boat are known. It runs over the log once. Forecasts
    are scored against the log's own fixes and headings, beside persistence; copies of the twin go
    on without GPS in the later half. Each line is ok, doubtful or bad.

    Exit code 0: nothing is wrong; 1: errors in the log or a bad twin (with --strict also warnings
    and a doubtful one); 2: it cannot be read.
    """
    keep_file(write, force, "--write")
    keep_logs(logs, {"--out": picture, "--json": json_file})
    failed, said, missing = False, set[str](), list[str]()
    in_use = {log: Path(ship or sibling_path(log, ".toml")) for log in logs}
    waiting = [log for log in logs if write is not None and _is_renewed(write, in_use[log])]
    boats: dict[Path, Particulars] = {}
    for log in logs:
        if log in waiting or (ship is None and not has_particulars(log)):
            continue
        try:
            boats[log] = particulars_for_log(log, ship, mapping)
        except ParticularsError as error:
            if ship is not None or not no_twin:
                raise
            note(f"{error}; the log is checked without them")
    checks: dict[Path, LogCheck] = {}
    if write is not None:
        checks = {log: check_log(log, mapping, boats.get(log)) for log in logs}
        # a file that is written anew is that of the boat
        known = {} if waiting else {in_use[log]: boat for log, boat in boats.items()}
        missing = _write(write, list(checks.values()), known)
        if not missing:
            boats |= {log: particulars_for_log(log, ship, mapping) for log in waiting}
            checks = {log: found for log, found in checks.items() if log not in waiting}
    for log in logs:
        boat = boats.get(log)
        found = checks.pop(log, None) or check_log(log, mapping, boat)
        print_notes(merged_notes(found.notes), said)
        print_check(found)
        verdict: Verdict | None = None
        if boat is None:
            remedy = (
                "--write FILE writes what the log shows of them; or name the boat with --ship"
                if write is None
                else f"fill in {', '.join(missing)} in {write}, remove the # before them, and name "
                f"it with --ship {write}"
                if missing
                else f"--ship {write}"
            )
            text = f"whether a twin may be trusted needs the particulars of the boat: {remedy}"
            print_notes([text], said)
        elif found.log is None:
            note("no twin can run over this log until its errors are mended")
        elif not no_twin:
            with row_progress("the twin runs", len(found.log)) as advance:
                verdict = judge(found.log, boat, predictor, findings=found.findings, on_row=advance)
            print_verdict(verdict)
        if json_file is not None:
            trust = None if verdict is None else verdict.to_json()
            write_json(json_file, {**found.to_json(), "verdict": trust})
        if not no_picture and len(found.recording.t) > 1:
            path = picture or Path(f"{found.recording.name}_check.png")
            write_whole(path, draw_check(found, verdict))
            console.print(f"picture: {path}", soft_wrap=True)
        grade = OK if verdict is None else verdict.grade
        failed |= found.count(ERROR) > 0 or grade == BAD
        failed |= strict and (found.count(WARNING) > 0 or grade != OK)
    if failed:
        raise typer.Exit(1)


def _are_particulars(path: Path) -> bool:
    """Return whether a file is there and holds particulars."""
    return path.exists() and "particulars" in read_toml(path, ParticularsError)


def _is_renewed(path: Path, in_use: Path) -> bool:
    """Return whether a file is there and holds the particulars that are in use."""
    return path.resolve() == in_use.resolve() and _are_particulars(path)


def _seen_from(path: Path, file: Path) -> str:
    """Return the text of a file of particulars, its prior as the path counts from another file."""

    def moved(line: re.Match[str]) -> str:
        prior = Path(os.path.relpath(file.parent / line[3], path.parent))
        return line[1] + json.dumps(prior.as_posix())

    text = file.read_text(encoding="utf-8")
    return re.sub(r"""(?m)^(\s*prior\s*=\s*)(["'])(.*?)\2""", moved, text)


def _alike(one: object, other: float) -> bool:
    """Return whether something is a number that is another one to two digits."""
    return isinstance(one, (int, float)) and f"{one:.2g}" == f"{other:.2g}"


def _write(path: Path, checks: Sequence[LogCheck], boats: Mapping[Path, Particulars]) -> list[str]:
    """Write the particulars of a boat as its logs show them, and return the keys still to fill in.

    What is of no log stays: of the files of ``boats``, and of the one that is replaced.
    """
    text, kept = checks[0].particulars_text(checks[1:]), ""
    of_log = tomllib.loads(text)["particulars"]
    sources = {
        str(file) if file.exists() else boat.name: _seen_from(path, file)
        if _are_particulars(file)
        else boat.to_toml()
        for file, boat in boats.items()
    }
    several = [tomllib.loads(renewed(text, source)[0]) for source in sources.values()]
    for tables in several:
        tables["particulars"].pop("name")
    if any(tables != several[0] for tables in several):
        raise OptionError(
            f"--write {path}: beside the logs are particulars of several boats; name the "
            "logs of one boat, or their boat with --ship"
        )
    first = dict(list(sources.items())[:1])
    if _are_particulars(path):
        first[str(path)] = _seen_from(path, path)
    for file, source in first.items():
        text, by_hand = renewed(text, source)
        found = f"{', '.join(by_hand)}, which are of no log" if by_hand else "nothing"
        kept += f"; kept of {file}: {found}"
    write_text(path, text)
    console.print(f"particulars: {path}{kept}", soft_wrap=True)
    written, pair = tomllib.loads(text)["particulars"], ("speed", "shaft_speed")
    own = [key for key in pair if not _alike(written[key], of_log[key])]
    if len(own) == 1:
        together = " goes with ".join(f"{key} = {of_log[key]:g}" for key in pair)
        note(
            f"{own[0]} = {written[own[0]]} was kept, but in the log {together}: write both as they "
            "are at the same time"
        )
    return re.findall(r"(?m)^# (\w+) = \?", text)
