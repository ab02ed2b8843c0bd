"""What the commands share: consoles, errors, options and files."""

from __future__ import annotations

import contextlib
import functools
import itertools
import json
import math
import os
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn
from rich.table import Table

from twin.logs.kinds import kind_of
from twin.predictors.named_options import split_names
from twin.predictors.registry import PREDICTORS
from usv_gym.design.seaway import warning_of
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.schedule import SCHEDULE_HELP
from usv_gym.world.sea import SEA_STATES, SeaState
from usv_gym.world.sensors import GRADES
from usv_kernel.cache import cached
from usv_kernel.errors import UsvTwinError
from usv_kernel.files import write_whole

INTERRUPTED = 130
"""Exit code after Ctrl-C."""

PIPE_WIDTH = 120
"""Columns of tables that are written to a pipe or file, unless COLUMNS says otherwise."""

_narrow = sys.stdout.isatty() or "COLUMNS" in os.environ
console = Console(markup=False, emoji=False, width=None if _narrow else PIPE_WIDTH)

errors = Console(stderr=True, markup=False, emoji=False)

SHOWN_EVERY_ROWS = 100
"""After so many rows of a log the progress bar moves."""


class OptionError(UsvTwinError):
    """An option with a wrong value; the message names both."""


Command = TypeVar("Command", bound=Callable[..., None])


def report_user_errors(command: Command) -> Command:
    """Turn errors that a user can correct into one line and exit code 2."""

    @functools.wraps(command)
    def run(*args: Any, **kwargs: Any) -> None:
        try:
            command(*args, **kwargs)
        except (UsvTwinError, ImportError, OSError) as error:
            text = str(error)
            if isinstance(error, OSError) and error.filename is not None:
                text = f"{error.filename}: {error.strerror}; choose another file or folder"
            errors.print(f"error: {text}", style="red", highlight=False, soft_wrap=True)
            raise typer.Exit(2) from None

    return run  # type: ignore[return-value]


LogArgument = Annotated[
    Path, typer.Argument(help="Log: CSV, CSV.gz, Parquet, ROS 2 bag, MCAP, .BIN, .tlog.")
]

LogsArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG",
        help="Logs: CSV, CSV.gz, Parquet, ROS 2 bag, MCAP, .BIN, .tlog.",
    ),
]

OPTIONS_EXAMPLE = "dsw-ukf:window=off,w_min=20"
"""How options stand in a predictor's name."""

PredictorOption = Annotated[
    str,
    typer.Option(
        "--predictor",
        "-p",
        help=f"One of: {', '.join(PREDICTORS)}; with options as {OPTIONS_EXAMPLE}.",
    ),
]

ShipOption = Annotated[
    str | None,
    typer.Option(
        "--ship",
        "--vessel",
        help="Main particulars of the boat: a TOML file, or the name of a vessel. "
        "Default: the .toml of the log's name beside the log.",
    ),
]

MappingOption = Annotated[
    Path | None,
    typer.Option(
        help="TOML file that says which column or ROS topic is which column of the log. "
        "Default: <log>.mapping.toml beside the log, if there is one."
    ),
]

DofOption = Annotated[
    int, typer.Option(help="Degrees of freedom of the ship: 3, or 6 with heave, roll, pitch.")
]

HsOption = Annotated[str | None, typer.Option(help=f"Significant wave height, m. {SCHEDULE_HELP}")]

WindOption = Annotated[
    str | None, typer.Option(help=f"Mean wind speed at 10 m, m/s. {SCHEDULE_HELP}")
]

WindFromOption = Annotated[
    str | None,
    typer.Option(help=f"Direction the wind comes from, degrees from north. {SCHEDULE_HELP}"),
]

AnyWindOption = Annotated[
    str | None,
    typer.Option(
        "--wind-from", help="Direction the wind comes from, degrees from north, or any: drawn."
    ),
]

AnyCurrentOption = Annotated[
    str | None,
    typer.Option(
        "--current",
        help="Speed of a current to any direction, m/s, or any: up to 0.5 m/s, drawn.",
    ),
]

SeaOption = Annotated[str, typer.Option(help=f"One of: {', '.join(SEA_STATES)}.")]

CurrentOption = Annotated[float | None, typer.Option(help="Speed of the current, m/s.")]

CurrentToOption = Annotated[
    float | None, typer.Option(help="Direction the current goes to, degrees from north.")
]

SensorsOption = Annotated[str, typer.Option(help=f"One of: {', '.join(GRADES)}.")]

FAULT_START_S = 85.0
"""Start of a fault that says none, as gps10 and not gps10@30."""

ShaftMaxOption = Annotated[
    float | None,
    typer.Option(
        help="MAVLink: shaft speed at full throttle, rev/s. Default: twice the nominal one."
    ),
]

SteerMaxOption = Annotated[
    float | None, typer.Option(help="MAVLink: largest steering angle, degrees. Default: 30.")
]

JobsOption = Annotated[
    int, typer.Option(min=1, help="Workers; the results do not depend on the number.")
]


CPUS = os.cpu_count() or 1


def note(text: str) -> None:
    """Print what a user should know."""
    console.print(f"note: {text}", style="yellow", highlight=False, soft_wrap=True)


def print_notes(notes: Iterable[str], said: set[str]) -> None:
    """Print notes that were not said of another log before."""
    for text in notes:
        if text not in said:
            note(text)
    said.update(notes)


def note_capsizing(vessel: Vessel, sea: SeaState, dof: int) -> None:
    """Print it where a vessel will capsize in a sea."""
    if (found := warning_of(vessel, sea, dof)) is not None:
        note(found)


def explain(text: str) -> None:
    """Print how to read a table."""
    console.print(text, style="dim", soft_wrap=True)


def stopped(text: str) -> typer.Exit:
    """Print what Ctrl-C has left, and return the exit to raise."""
    errors.print(f"stopped: {text}", style="yellow", soft_wrap=True)
    return typer.Exit(INTERRUPTED)


def new_table(title: str, *heads: str, left: Collection[str] = (), **style: Any) -> Table:
    """Return a table; columns are aligned to the right but those in ``left``."""
    table = Table(title=title, **{"box": SIMPLE_HEAD, "padding": (0, 1, 0, 0), **style})
    for head in heads:
        table.add_column(head, justify="left" if head in left else "right", no_wrap=True)
    return table


def status(text: str) -> contextlib.AbstractContextManager[Any]:
    """Return a status line; none where the compiler is going to show its own."""
    return console.status(text) if cached() else contextlib.nullcontext()


def progress_bar(*more: ProgressColumn, **options: Any) -> Progress:
    """Return a progress bar that counts, with more columns at its end."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), *more)
    return Progress(*columns, **{"console": console, **options})


@contextlib.contextmanager
def row_progress(text: str, total: int) -> Iterator[Callable[[], None]]:
    """Show a progress bar for the rows of a log; call what it gives after each row."""
    rows = itertools.count(1)
    # the compiler shows a line of its own where kernels are not cached
    with progress_bar(transient=True, disable=not cached()) as progress:
        task = progress.add_task(text, total=total)

        def advance() -> None:
            if (done := next(rows)) % SHOWN_EVERY_ROWS == 0:
                progress.update(task, completed=done)

        yield advance


def radians(degrees: float | None) -> float | None:
    """Return an angle in rad, or None."""
    return None if degrees is None else math.radians(degrees)


def write_json(path: Path, content: dict[str, Any] | list[dict[str, Any]]) -> None:
    """Write JSON, whole or not at all."""
    write_text(path, json.dumps(content, indent=1) + "\n")


def write_text(path: Path, text: str) -> None:
    """Make a file's folder, and write the file whole or not at all."""
    write_whole(path, text.encode())


def keep_file(path: Path | None, force: bool, option: str = "--out") -> None:
    """Refuse to replace a file, unless with --force."""
    if path is not None and path.exists() and not force:
        raise OptionError(f"{path}: is there already; choose another {option}, or --force")


def keep_format(path: Path | None, option: str) -> None:
    """Refuse a name that ends as a file of another format than the text of an option."""
    if path is not None and path.suffix.lower() in (".xlsx", ".xls", ".parquet", ".json"):
        raise OptionError(f"{path}: {option} writes no {path.suffix}; choose another ending")


def keep_logs(logs: Sequence[Path], options: Mapping[str, object]) -> None:
    """Refuse TOML among logs, before any is read, and options for one log where there are more."""
    for log in logs:
        if log.suffix == ".toml" and (kind := kind_of(log.read_bytes())):
            raise OptionError(f"{log}: this is {kind}")
    given = [name for name, value in options.items() if value is not None]
    if len(logs) > 1 and given:
        raise OptionError(f"{len(logs)} logs, and {', '.join(given)}: that is for one log")


def parse_list(text: str, option: str) -> tuple[str, ...]:
    """Return the items of a comma-separated option, each once."""
    items = tuple(dict.fromkeys(item.strip() for item in text.split(",") if item.strip()))
    if not items:
        raise OptionError(f"{option}: name at least one")
    return items


def parse_world(wind_from: str | None, current: str | None) -> dict[str, Any]:
    """Return options of the environment from ``--wind-from`` and ``--current``."""
    world: dict[str, Any] = {}
    given = {"wind_from_deg": ("--wind-from", wind_from), "current": ("--current", current)}
    for name, (option, text) in given.items():
        if text is None or text == "any":
            world |= {} if text is None else {name: text}
            continue
        try:
            world[name] = float(text)
        except ValueError:
            raise OptionError(f"{option} {text}: write a number, or any") from None
    return world


def parse_predictors(text: str, option: str = "--predictors") -> tuple[str, ...]:
    """Return predictors of a comma-separated list, each once, with options behind a colon."""
    names = tuple(dict.fromkeys(split_names(text)))
    if not names:
        raise OptionError(f"{option}: name at least one")
    return names


def parse_seeds(text: str) -> tuple[int, ...]:
    """Return seeds: ``A-B``, ``A:B`` for A to B - 1, or a list as ``0,4,7``."""
    try:
        found: list[int] = []
        for item in text.split(","):
            first, mark, last = item.partition(":" if ":" in item else "-")
            begin = int(first) if first or mark != ":" else 0
            found += range(begin, int(last) + (mark == "-") if mark else begin + 1)
        seeds = tuple(dict.fromkeys(found))
    except ValueError:
        raise OptionError(
            f"--seeds {text}: write A-B, A:B for A to B - 1, or a list as 0,4,7"
        ) from None
    if not seeds or min(seeds) < 0:
        raise OptionError(f"--seeds {text}: holds no seed of 0 or more")
    return seeds
