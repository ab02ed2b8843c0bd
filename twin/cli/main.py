"""The command line ``usv-twin``: simulate, identify, predict, benchmark, validate, train, view."""

from __future__ import annotations

import sys

from twin.cli import agents, benchmark, identify, live, performance, predict, simulate, validate
from twin.cli.common import _speaking, app
from twin.cli.vessel import vessel_app

app.add_typer(vessel_app, name="vessel")


def _expand(arguments: list[str], option: str = "--log") -> list[str]:
    """Let one option take several files: ``--log a b`` becomes ``--log a --log b``."""
    expanded: list[str] = []
    inside = False
    for argument in arguments:
        if argument.startswith("-"):
            inside = argument == option
            if not inside:
                expanded.append(argument)
        elif inside:
            expanded += [option, argument]
        else:
            expanded.append(argument)
    return expanded


for _name, _command in {**agents.COMMANDS, **live.COMMANDS}.items():
    app.command(_name)(_speaking(_command))


COMMANDS = (benchmark, identify, performance, predict, simulate, validate)
"""Modules that register a command with the app when they are imported."""


def main() -> None:
    """Run the command line."""
    app(args=_expand(sys.argv[1:]), prog_name="usv-twin")
