"""``usv-twin mapping``: propose a mapping file for a log of other columns."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin.cli.common import OptionError, console, keep_file, note, write_text
from twin.logs.dates import MEANINGS, ORDERS, ahead_of_utc
from twin.logs.log import sibling_path
from twin.logs.mapping import Layout
from twin.logs.proposal.propose import Proposal, propose


def mapping_command(
    log: Annotated[Path, typer.Argument(help="Log: CSV, CSV.gz or Parquet.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="File to write. [<log>.mapping.toml beside the log]"),
    ] = None,
    dates: Annotated[
        str, typer.Option(help=f"Order of dates that leave it open: {' or '.join(ORDERS)}.")
    ] = "",
    zone: Annotated[
        str,
        typer.Option(help="Of the clock of dates: ahead of UTC, as -05:00 or 2, or Europe/Berlin."),
    ] = "",
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file.")] = False,
) -> None:
    """Propose a mapping file from the names and values of a log's columns.

    Latitude and longitude, knots, degrees, rpm, pulse widths, dates of any format and zone. The
    values tell units that the names do not. Check every line before use.
    """
    if dates and dates not in ORDERS:
        raise OptionError(f"--dates {dates}: use {' or '.join(ORDERS)}")
    if zone:
        ahead_of_utc(zone)  # refuses what is none
    found_beside = sibling_path(log, ".mapping.toml")
    path = out or found_beside
    if path.resolve() == sibling_path(log, ".toml").resolve():
        raise OptionError(f"{path}: is read as the particulars of the boat; choose another --out")
    keep_file(path, force)
    found = propose(log, dates, zone)
    if found.choices:
        raise _open_question(found, "first?", "--dates", tuple(ORDERS))
    if found.zone:
        meanings = MEANINGS.get(found.zone, ("-05:00", "+09:30"))
        raise _open_question(found, "of UTC?", "--zone", meanings)
    write_text(path, found.text(log.name))
    Layout.load(path)  # what is written can be read
    console.print(path.read_text(encoding="utf-8"), highlight=False, soft_wrap=True, end="")
    for question in found.questions:
        note(f"please check: {question}")
    for name in found.missing:
        note(f"{name}: no column seems to hold it; complete the mapping")
    option = "" if path.resolve() == found_beside.resolve() else f" --mapping {path}"
    console.print(f"mapping: {path}; try it with usv-twin check {log}{option}", soft_wrap=True)


def _open_question(
    found: Proposal, end: str, option: str, examples: tuple[str, ...]
) -> OptionError:
    """Return the question that ends so as an error that names the option with the answer."""
    question = next(text for text in found.questions if text.endswith(end))
    return OptionError(f"{question} Say so with {option} {f' or {option} '.join(examples)}")
