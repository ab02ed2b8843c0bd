"""What all commands share: where they print, and how options are read and results written."""

from __future__ import annotations

import contextlib
import csv
import functools
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from twin.agents.agent import ControllerError
from twin.agents.policy import AgentError
from twin.benchmark.protocol import BenchmarkError
from twin.checkpoint import StateError
from twin.digital_twin import Twin, TwinError
from twin.files import write_whole
from twin.live.protocols.feed import FeedError
from twin.logs.columns import LogError
from twin.logs.log import Log
from twin.model.structure import MODELS
from twin.particulars import ParticularsError
from twin.predictors.registry import DEFAULT, PREDICTORS, PredictorError
from twin.sim.oracle import check_simulator
from twin.sim.recorded import NO_PARTICULARS, particulars_for_log
from usv_gym.design.new_vessel import DesignError
from usv_gym.envs.tasks import TaskError
from usv_gym.manoeuvring.manoeuvres import ManoeuvreError
from usv_gym.vessel.vessel import VesselError
from usv_gym.world.faults import FaultError
from usv_gym.world.sea import SeaError
from usv_gym.world.simulation import SimulationError
from usv_kernel.cache import cached

__all__ = [
    "INTERRUPTED",
    "console",
    "errors",
    "listed",
    "note",
    "seeds_of",
]

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="A digital twin of an unmanned surface vessel: simulate it, identify it from a log, "
    "predict where it will be, benchmark predictors under GPS loss, validate the ship and "
    "the sea, train and evaluate agents that steer, and view boat and twin in the browser.",
)

EXPECTED = (
    AgentError,
    BenchmarkError,
    ControllerError,
    DesignError,
    FaultError,
    FeedError,
    ImportError,
    LogError,
    ManoeuvreError,
    OSError,
    ParticularsError,
    PredictorError,
    SeaError,
    SimulationError,
    StateError,
    TaskError,
    TwinError,
    VesselError,
)

Command = TypeVar("Command", bound=Callable[..., None])


def _speaking(command: Command) -> Command:
    """Turn errors that a user can mend into one line and exit code 2."""

    @functools.wraps(command)
    def run(*args: Any, **kwargs: Any) -> None:
        try:
            command(*args, **kwargs)
        except EXPECTED as error:
            if isinstance(error, OSError) and error.filename is not None:
                error = OSError(
                    f"{error.filename}: {error.strerror}; choose another file or folder"
                )
            errors.print(f"error: {error}", style="red", highlight=False, soft_wrap=True)
            raise typer.Exit(2) from None

    return run  # type: ignore[return-value]


PredictorOption = Annotated[
    str, typer.Option("--predictor", "-p", help=f"One of: {', '.join(PREDICTORS)}.")
]

ModelOption = Annotated[
    str | None,
    typer.Option(
        "--model",
        help=f"Model structure, one of {', '.join(MODELS)}; left out: the predictor's own choice.",
    ),
]

ShipOption = Annotated[
    str | None,
    typer.Option(
        "--ship",
        "--vessel",
        help="Main particulars of the boat: a TOML file, or the name of a vessel. "
        "Left out: the .toml of the log's name beside the log, else usv75.",
    ),
]

MappingOption = Annotated[
    Path | None,
    typer.Option(
        help="TOML file that says which column or ROS topic is which column of the log. "
        "Left out: <log>.mapping.toml beside the log, if it is there."
    ),
]

DofOption = Annotated[
    int, typer.Option(help="Degrees of freedom of the ship: 3, or 6 with heave, roll, pitch.")
]

HsOption = Annotated[float | None, typer.Option(help="Significant wave height, m.")]

WindOption = Annotated[float | None, typer.Option(help="Mean wind speed at 10 m, m/s.")]

WindFromOption = Annotated[
    float | None, typer.Option(help="Where the wind comes from, degrees clockwise from north.")
]


def _digits(value: float) -> str:
    """Return a positive number with three digits, or all before the point, or three after it."""
    return f"{value:.{min(max(2 - math.floor(math.log10(value)), 0), 3)}f}"


def _begin(
    path: Path,
    predictor: str | None,
    ship: str | None,
    until: float | None,
    resume: Path | None = None,
    model: str | None = None,
    mapping: Path | None = None,
) -> tuple[Log, Twin]:
    """Read a log, say what is missing in it, and make a twin for it, or load one."""
    log = Log.read(path, mapping)
    for line in log.notes:
        note(line)
    if resume is not None:
        found, twin = True, _resumed(resume, predictor, ship, model)
    else:
        particulars, found = particulars_for_log(path, ship)
        check_simulator(predictor or DEFAULT, log, particulars)
        options: dict[str, Any] = {} if model is None else {"model": model}
        twin = Twin(particulars, predictor or DEFAULT, **options)
    log = log.without_truth()
    if until is not None:
        if not math.isfinite(until):
            raise TwinError(f"--until {until}: must be a finite time in s")
        log = log.slice(-math.inf, math.nextafter(until, math.inf))
        if len(log) == 0:
            raise TwinError(f"--until {until:g}: the log has no row before it")
    if not found:
        note(NO_PARTICULARS.format(path))
    console.print(f"boat: {twin.particulars.name}, {twin.particulars.length:g} m", highlight=False)
    if resume is not None:
        later = log.slice(math.nextafter(twin.t, math.inf), math.inf) if twin.t == twin.t else log
        if len(later) == 0:
            raise TwinError(
                f"{path}: has no row after t = {twin.t:g} s, where {resume} was saved; "
                "hand in the log that goes on from there"
            )
        log = later
    return log, twin


def _resumed(path: Path, predictor: str | None, ship: str | None, model: str | None) -> Twin:
    """Load a saved twin; what it knows itself cannot be asked for otherwise."""
    twin = Twin.load(path)
    if predictor is not None and predictor != twin.name:
        raise TwinError(f"--predictor {predictor}: {path} goes on with {twin.name}; leave it out")
    if model is not None:
        raise TwinError(f"--model {model}: {path} keeps its own; leave it out")
    if ship is not None:
        raise TwinError(f"--ship {ship}: {path} knows its boat; leave it out")
    return twin


def _busy(text: str) -> contextlib.AbstractContextManager[Any]:
    """Return a status line; none where the compiler is going to show its own."""
    return console.status(text) if cached() else contextlib.nullcontext()


class _bar:
    """A progress bar for rows of a log."""

    def __init__(self, text: str, total: int) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            console=console,
            transient=True,
        )
        self._task = self._progress.add_task(text, total=total)
        self._count = 0

    def __enter__(self) -> Callable[[], None]:
        if cached():  # the compiler shows a line of its own otherwise
            self._progress.start()
        return self._advance

    def _advance(self) -> None:
        self._count += 1
        if self._count % 100 == 0:
            self._progress.update(self._task, completed=self._count)

    def __exit__(self, *_: object) -> None:
        self._progress.stop()


def _short(value: float, digits: int) -> str:
    """Return a number with so many decimals below 10, and fewer above."""
    for bound, fewer in ((10.0, 0), (100.0, 1)):
        if abs(value) < bound:
            return f"{value:.{digits - fewer}f}"
    return f"{value:.0f}"


def _write_csv(path: Path, header: list[str], rows: list[list[float]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows([[repr(float(v)) for v in row] for row in rows])


def _write_json(path: Path, content: dict[str, Any] | list[dict[str, Any]]) -> None:
    _write_text(path, json.dumps(content, indent=1) + "\n")


def _write_text(path: Path, text: str) -> None:
    """Make a file's folder, and write the file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, text.encode())


console = Console(markup=False)

errors = Console(stderr=True, markup=False)

INTERRUPTED = 130
"""Exit code after Ctrl-C."""


def note(text: str) -> None:
    """Print what a user should know."""
    console.print(f"note: {text}", style="yellow", highlight=False, soft_wrap=True)


def listed(text: str, option: str) -> tuple[str, ...]:
    """Return the items of a comma-separated option, each once."""
    items = tuple(dict.fromkeys(item.strip() for item in text.split(",") if item.strip()))
    if not items:
        raise BenchmarkError(f"{option}: name at least one")
    return items


def seeds_of(text: str) -> tuple[int, ...]:
    """Return seeds: ``A-B``, ``A:B`` for A to B - 1, or a list as ``0,4,7``."""
    try:
        found: list[int] = []
        for item in text.split(","):
            first, mark, last = item.partition(":" if ":" in item else "-")
            begin = int(first) if first or mark != ":" else 0
            found += range(begin, int(last) + (mark == "-") if mark else begin + 1)
        seeds = tuple(dict.fromkeys(found))
    except ValueError:
        raise BenchmarkError(
            f"--seeds {text}: write A-B, A:B for A to B - 1, or a list as 0,4,7"
        ) from None
    if not seeds or min(seeds) < 0:
        raise BenchmarkError(f"--seeds {text}: holds no seed of 0 or more")
    return seeds
