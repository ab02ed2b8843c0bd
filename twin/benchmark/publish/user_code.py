"""Where in a predictor's own code something happened: errors, methods, files and rows read."""

from __future__ import annotations

import contextlib
import inspect
import linecache
import os
import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import twin
from twin.benchmark.publish.sources import PACKAGES, is_foreign, sources_of
from twin.predictors.base import Predictor

__all__ = [
    "FileRead",
    "lines_reading_later_rows",
    "own_files",
    "place_of_error",
    "place_of_import",
    "place_of_method",
    "watched_files",
]

Array = NDArray[Any]

Line = tuple[str, int]
"""Name of a source file, and number of a line in it."""

_CODE = {".py", ".pyc", ".pyo", ".so", ".pyd", ".nbi", ".nbc"}

_SYSTEM = ("/proc/", "/sys/", "/dev/", "/etc/")

_PROGRAM_FOLDERS = tuple(
    f"{folder}{os.sep}"
    for folder in (
        *(sys.prefix, sys.base_prefix),
        *(Path(twin.__file__).parents[1] / name for name in PACKAGES),
    )
)


def own_files(kind: type[Predictor]) -> frozenset[str]:
    """Return the names of a class's source files from outside of this package."""
    return frozenset(map(str, sources_of(kind).files.values()))


def _shown(line: Line, where: str = "") -> str:
    """Return a line as text: its file, number, function and source."""
    path = Path(line[0])
    with contextlib.suppress(ValueError):
        path = path.relative_to(Path.cwd())
    text = linecache.getline(*line).strip()
    return f"{path}:{line[1]}{f', in {where}' if where else ''}{f': {text}' if text else ''}"


def place_of_error(error: BaseException, files: Collection[str]) -> str:
    """Return the innermost line of some files that raised an error; empty if there is none."""
    place, trace = "", error.__traceback__
    while trace is not None:
        code = trace.tb_frame.f_code
        if _resolved(code.co_filename) in files:
            place = _shown((code.co_filename, trace.tb_lineno), code.co_name)
        trace = trace.tb_next
    return place


def place_of_import(error: BaseException) -> str:
    """Return the innermost line of a module that could not be imported; empty if there is none."""
    place, trace = "", error.__cause__.__traceback__ if error.__cause__ else None
    while trace is not None:
        name = trace.tb_frame.f_code.co_filename
        # neither the import system nor the registry, where every trace begins
        if Path(name).is_file() and not name.startswith(_PROGRAM_FOLDERS):
            place = _shown((name, trace.tb_lineno))
        trace = trace.tb_next
    return place


def place_of_method(kind: type[Predictor], *names: str) -> str:
    """Return where a class from outside defines the first of some methods; empty if nowhere."""
    for name in names:
        for base in kind.__mro__:
            found = vars(base).get(name)
            found = found.fget if isinstance(found, property) else found
            if found is not None and is_foreign(base.__module__):
                with contextlib.suppress(OSError, TypeError):
                    code = inspect.unwrap(found).__code__
                    return _shown((code.co_filename, code.co_firstlineno))
    return ""


def _resolved(name: str) -> str:
    """Return the name of a source file without links."""
    return os.path.realpath(name)


def _lines_of(frame: FrameType | None, until: str) -> Iterator[Line]:
    """Yield the lines that are being run, innermost first, up to those of a file."""
    while frame is not None and frame.f_code.co_filename != until:
        yield frame.f_code.co_filename, frame.f_lineno
        frame = frame.f_back


def _innermost(lines: Iterable[Line], files: Collection[str]) -> str:
    """Return the first of some lines that lies in some files, as text; empty if none does."""
    return next((_shown(line) for line in lines if _resolved(line[0]) in files), "")


# files
class FileRead(NamedTuple):
    """A file that was opened to be read, and the lines that were being run."""

    path: Path
    lines: tuple[Line, ...]

    def place(self, files: Collection[str]) -> str:
        """Return the innermost of the lines that lies in some files; empty if none does."""
        return _innermost(self.lines, files)


_watches: list[tuple[str, list[FileRead]]] = []

_hooks: list[Callable[[str, tuple[Any, ...]], None]] = []


def _note_open(event: str, arguments: tuple[Any, ...]) -> None:
    """Note a file that is opened to be read, while someone watches."""
    if event != "open" or not _watches or not isinstance(arguments[0], (str, bytes, Path)):
        return
    name = os.path.realpath(os.fsdecode(arguments[0]))
    flags = arguments[2] if isinstance(arguments[2], int) else 0
    written = flags & (os.O_WRONLY | os.O_RDWR)
    if written or Path(name).suffix in _CODE or name.startswith((*_SYSTEM, *_PROGRAM_FOLDERS)):
        return
    for until, found in _watches:
        found.append(FileRead(Path(name), tuple(_lines_of(sys._getframe(1), until))))


@contextlib.contextmanager
def watched_files(until: str) -> Iterator[list[FileRead]]:
    """Yield a list that grows by each file that Python opens to read; not those of the program.

    Of the lines that are being run, those inside of the source file ``until`` are kept.
    """
    if not _hooks:  # can never be removed; without a watch it does nothing
        _hooks.append(_note_open)
        sys.addaudithook(_note_open)
    found: list[FileRead] = []
    watch = until, found
    _watches.append(watch)
    try:
        yield found
    finally:
        # by identity: two watches may hold the same files
        _watches[:] = [other for other in _watches if other is not watch]


# rows
class _WatchedRows(np.ndarray):
    """Rows of a history that note which lines read those after an origin."""

    origin: int
    files: Collection[str]
    lines: dict[str, None] | None

    def __array_finalize__(self, source: Any) -> None:
        same = getattr(source, "shape", None) == self.shape
        self.lines = getattr(source, "lines", None) if same else None
        self.origin, self.files = getattr(source, "origin", 0), getattr(source, "files", ())

    def _note(self) -> None:
        if self.lines is not None and (
            place := _innermost(_lines_of(sys._getframe(2), __file__), self.files)
        ):
            self.lines[place] = None

    def __getitem__(self, key: Any) -> Any:
        if self.lines is not None:
            numbers = np.broadcast_to(np.arange(self.shape[0])[:, None], self.shape)[key]
            if np.size(numbers) and np.max(numbers) > self.origin:
                self._note()
        return np.asarray(self)[key]

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        self._note()
        return getattr(ufunc, method)(*map(_plain, inputs), **options)

    def __array_function__(self, function: Any, types: Any, args: Any, options: Any) -> Any:
        self._note()
        return function(*_plain(args), **_plain(options))


def _plain(value: Any) -> Any:
    """Return a value with plain arrays in place of watched ones."""
    if isinstance(value, _WatchedRows):
        return np.asarray(value)
    if isinstance(value, (list, tuple)):
        return type(value)(map(_plain, value))
    return {k: _plain(v) for k, v in value.items()} if isinstance(value, dict) else value


def lines_reading_later_rows(
    forecast: Callable[[Array, Array, Array], Array],
    rows: Array,
    origin: int,
    plan: Array,
    files: Collection[str],
) -> list[str]:
    """Return the lines of some files that read rows after an origin in one forecast.

    Parameters
    ----------
    forecast : callable
        As :meth:`twin.predictors.baselines.HistoryPredictor.forecast`.
    rows : ndarray, shape (M, c)
        History.
    origin : int
        Row to forecast from.
    plan : ndarray, shape (K, 4)
        Commands.
    files : collection of str
        Names of the source files.
    """
    watched = rows.view(_WatchedRows)
    watched.origin, watched.files, watched.lines = origin, files, {}
    # compiled code may refuse such an array; what it read until then is known
    with contextlib.suppress(Exception):
        forecast(watched, np.array([origin]), plan[None])
    return list(watched.lines)
