"""The command line ``usv-twin``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Annotated

import typer

from twin.cli.benchmark import benchmark_command
from twin.cli.check import check_command
from twin.cli.common import console, errors, report_user_errors
from twin.cli.evaluate import evaluate_command
from twin.cli.identify import identify_command
from twin.cli.link import link_command
from twin.cli.mapping import mapping_command
from twin.cli.predict import predict_command
from twin.cli.simulate import simulate_command
from twin.cli.sitl import sitl_command
from twin.cli.train import train_command
from twin.cli.vessel import vessel_check_command, vessel_new_command
from twin.cli.view import view_command
from usv_kernel import __version__

__all__ = [
    "COMMANDS",
    "MOVED",
    "app",
    "main",
]

COMMANDS: dict[str, Callable[..., None]] = {
    "simulate": simulate_command,
    "mapping": mapping_command,
    "check": check_command,
    "identify": identify_command,
    "predict": predict_command,
    "benchmark": benchmark_command,
    "train": train_command,
    "evaluate": evaluate_command,
    "view": view_command,
    "link": link_command,
    "sitl": sitl_command,
}
"""Commands by name, in the order of the help page."""

VESSEL_COMMANDS: dict[str, Callable[..., None]] = {
    "check": vessel_check_command,
    "new": vessel_new_command,
}

MOVED = {
    "log": "usv-twin check LOG",
    "judge": "usv-twin check LOG",
    "mapping new": "usv-twin mapping LOG",
    "replay": "examples/replay.py",
    "study": "examples/agent_study/run.py",
    "paper": "examples/paper/run.py",
    "validate": "examples/validation/",
    "bench": "examples/speed/",
    "soak": "the tests marked slow",
    "fmu": "examples/fmu/",
    "vessel mesh": "examples/hydrodynamics/",
    "vessel hydro": "examples/hydrodynamics/",
}
"""What a former command is called now, or where its work is done."""

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="A digital twin of an unmanned surface vessel. Check a log, identify the boat from it, "
    "and predict where it will be. Simulate boats, benchmark predictors under GPS loss, train and "
    "evaluate agents that steer, and view boat and twin in the browser.",
)


def print_version(asked: bool) -> None:
    """Print the version, and end."""
    if asked:
        console.print(f"usv-twin {__version__}", highlight=False)
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool,
        typer.Option("--version", callback=print_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    """Take the options that stand before a command."""


vessel_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Check or begin a boat.")

for group, commands in ((app, COMMANDS), (vessel_app, VESSEL_COMMANDS)):
    for name, command in commands.items():
        group.command(name)(report_user_errors(command))
app.add_typer(vessel_app, name="vessel")


def moved(arguments: Sequence[str]) -> str:
    """Return what stands for a former command that the arguments name; empty if they name none."""
    for former in (" ".join(arguments[:2]), *arguments[:1]):
        if former in MOVED:
            return f"usv-twin {former} is now {MOVED[former]}"
    return ""


def main() -> None:
    """Run the command line."""
    arguments = sys.argv[1:]
    if text := moved(arguments):
        errors.print(f"error: {text}", style="red", highlight=False, soft_wrap=True)
        sys.exit(2)
    app(args=arguments, prog_name="usv-twin")
