"""The command line ``usv-twin``: simulate, identify, predict, benchmark, validate, train, view."""

from __future__ import annotations

import sys
from collections.abc import Callable

import typer

from twin.cli.benchmark import benchmark_command
from twin.cli.common import report_user_errors
from twin.cli.evaluate import evaluate_command
from twin.cli.interfaces.fmu import fmu_command
from twin.cli.interfaces.link import link_command
from twin.cli.interfaces.sitl import sitl_command
from twin.cli.logs.check import log_check_command
from twin.cli.logs.identify import identify_command
from twin.cli.logs.judge import verdict_command
from twin.cli.logs.mapping import mapping_new_command
from twin.cli.logs.predict import predict_command
from twin.cli.logs.replay import replay_command
from twin.cli.paper import paper_command
from twin.cli.simulate import simulate_command
from twin.cli.soak import soak_command
from twin.cli.study import study_command
from twin.cli.train import train_command
from twin.cli.validate import validate_command
from twin.cli.vessel import (
    vessel_check_command,
    vessel_hydro_command,
    vessel_mesh_command,
    vessel_new_command,
)
from twin.cli.view import view_command

__all__ = [
    "app",
    "main",
]

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="A digital twin of an unmanned surface vessel. Simulate it, identify it from a log, "
    "and predict where it will be. Benchmark predictors under GPS loss, and validate ship and "
    "sea. Train and evaluate agents that steer, and view boat and twin in the browser.",
)

log_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Check a log before it is used."
)

mapping_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Propose a mapping file for a log."
)

vessel_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Check, begin or draw a vessel."
)

COMMANDS: dict[str, Callable[..., None]] = {
    "simulate": simulate_command,
    "identify": identify_command,
    "judge": verdict_command,
    "predict": predict_command,
    "benchmark": benchmark_command,
    "paper": paper_command,
    "validate": validate_command,
    "train": train_command,
    "evaluate": evaluate_command,
    "study": study_command,
    "view": view_command,
    "replay": replay_command,
    "sitl": sitl_command,
    "link": link_command,
    "soak": soak_command,
    "fmu": fmu_command,
}
"""Commands by name, in the order of the help page."""

VESSEL_COMMANDS: dict[str, Callable[..., None]] = {
    "check": vessel_check_command,
    "new": vessel_new_command,
    "mesh": vessel_mesh_command,
    "hydro": vessel_hydro_command,
}

LOG_COMMANDS: dict[str, Callable[..., None]] = {"check": log_check_command}

MAPPING_COMMANDS: dict[str, Callable[..., None]] = {"new": mapping_new_command}

for group, commands in (
    (app, COMMANDS),
    (log_app, LOG_COMMANDS),
    (mapping_app, MAPPING_COMMANDS),
    (vessel_app, VESSEL_COMMANDS),
):
    for name, command in commands.items():
        group.command(name)(report_user_errors(command))
app.add_typer(log_app, name="log")
app.add_typer(mapping_app, name="mapping")
app.add_typer(vessel_app, name="vessel")


def expand_files(arguments: list[str], option: str = "--log") -> list[str]:
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


def main() -> None:
    """Run the command line."""
    app(args=expand_files(sys.argv[1:]), prog_name="usv-twin")
