"""``usv-twin mapping new``: propose a mapping file for a log of other columns."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from twin.cli.common import OptionError, console, note, write_text
from twin.logs.dates import ORDERS
from twin.logs.log import sibling_path
from twin.logs.mapping import Layout
from twin.logs.proposal import Proposal, propose


def mapping_new_command(
    log: Annotated[Path, typer.Argument(help="Log: CSV, CSV.gz or Parquet.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="File to write. [<log>.mapping.toml beside the log]"),
    ] = None,
    dates: Annotated[
        str, typer.Option(help=f"Order of dates that leave it open: {' or '.join(ORDERS)}.")
    ] = "",
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file.")] = False,
) -> None:
    """Propose a mapping file from the names and values of a log's columns.

    Latitude and longitude, knots, degrees, rpm, pulse widths, dates of any format and zone. The
    values tell units that the names do not. Check every line before use.
    """
    if dates and dates not in ORDERS:
        raise OptionError(f"--dates {dates}: use {' or '.join(ORDERS)}")
    path = out or sibling_path(log, ".mapping.toml")
    if path.exists() and not force:
        raise OptionError(f"{path}: is there already; choose another --out, or --force")
    found = propose(log, dates)
    if found.choices:
        found = _ask(log, found)
    write_text(path, found.text(log.name))
    Layout.load(path)  # what is written can be read
    console.print(path.read_text(encoding="utf-8"), highlight=False, soft_wrap=True, end="")
    for name in found.missing:
        note(f"{name}: no column seems to hold it; complete the mapping")
    console.print(f"mapping: {path}; try it with usv-twin log check {log}", soft_wrap=True)


def _is_interactive() -> bool:
    """Return whether somebody can answer."""
    return sys.stdin.isatty()


def _ask(log: Path, found: Proposal) -> Proposal:
    """Return the proposal with the order of day and month that the user names."""
    question = next(text for text in found.questions if text.endswith("day first or month first?"))
    if not _is_interactive():
        raise OptionError(f"{question} Say so with --dates {' or --dates '.join(ORDERS)}")
    answer = ""
    while answer not in ORDERS:
        answer = typer.prompt(f"{question} ({' or '.join(ORDERS)})").strip()
    return propose(log, answer)
