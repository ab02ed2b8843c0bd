"""The command line ``usv-twin``: simulate, identify, predict, benchmark, validate, train, view."""

from __future__ import annotations

import sys

# each of these registers its commands with the app
from twin.cli import (
    agents as commands,
)
from twin.cli import (
    live,
)
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


for _name, _command in {**commands.COMMANDS, **live.COMMANDS}.items():
    app.command(_name)(_speaking(_command))


def main() -> None:
    """Run the command line."""
    app(args=_expand(sys.argv[1:]), prog_name="usv-twin")
