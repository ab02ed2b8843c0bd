"""Files: TOML and JSON read within limits, and files written whole or not at all."""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import sys
import threading
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from usv_kernel.errors import UsvTwinError

__all__ = [
    "WriteError",
    "import_named",
    "parse_json",
    "read_json",
    "read_limited",
    "read_toml",
    "replacing",
    "write_whole",
]

TOML_MAX = 1 << 20
"""Longest TOML file, bytes: some ten times what a boat's own prior needs."""

JSON_MAX = 1 << 28
"""Longest JSON file, bytes."""

DEPTH_MAX = 32
"""Deepest nesting of tables and lists."""

INTEGER_MAX = 2**63
"""Whole numbers lie within it, as TOML wants; a double holds them without overflow."""


class WriteError(UsvTwinError, OSError):
    """A file that cannot be written, for instance to a full disk; the message names it."""


@contextlib.contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yield the name of a new file to write; at the end it takes the place of another, whole.

    Its folder is made if needed. If anything fails, the old file stays and the new one is removed.
    A device or a pipe is written to directly.

    Raises
    ------
    WriteError
        Names the file and the reason.
    """
    path = Path(path)
    try:
        path = path.resolve() if path.is_symlink() else path
        if path.exists() and not path.is_file() and not path.is_dir():
            yield path
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        # no other worker or thread has this name, and the end tells the format
        mark = f".{os.getpid()}_{threading.get_ident()}_"
        partial = path.with_name(mark + path.name[-100:])
        try:
            yield partial
            with partial.open("rb+") as file:
                os.fsync(file.fileno())
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as error:
        if isinstance(error, UsvTwinError):
            raise
        raise WriteError(
            f"{path}: cannot be written ({error.strerror or error}); free space, or choose another "
            "file or folder"
        ) from None


def write_whole(path: str | Path, content: bytes) -> None:
    """Write a file whole or not at all, even if the machine stops; see :func:`replacing`."""
    with replacing(path) as partial, partial.open("wb") as file:
        file.write(content)


def read_limited(path: Path, error: type[UsvTwinError], limit: int) -> bytes:
    """Return the content of a file; ``error`` if it cannot be read or is longer than ``limit``."""
    try:
        with path.open("rb") as file:
            content = file.read(limit + 1)
    except (OSError, ValueError) as reason:  # ValueError: a name with a zero byte
        why = getattr(reason, "strerror", None) or reason
        raise error(f"{path}: cannot be read ({why}); check the name and the file") from None
    if len(content) > limit:
        raise error(f"{path}: is longer than {limit / 1e6:.3g} MB; name the file that was meant")
    return content


def read_toml(path: str | Path, error: type[UsvTwinError]) -> dict[str, Any]:
    """Return the tables of a TOML file; ``error`` names the file, the place and the remedy."""
    path = Path(path)
    content = read_limited(path, error, TOML_MAX)
    try:
        table = tomllib.loads(content.decode("utf-8-sig"))
    except RecursionError:
        raise error(f"{path}: is not valid TOML: it is nested too deep") from None
    except ValueError as reason:
        raise error(f"{path}: is not valid TOML: {reason}; correct this place") from None
    _check_values(path, table, error)
    return table


def read_json(path: str | Path, error: type[UsvTwinError]) -> Any:
    """Return the content of a JSON file; ``error`` names the file and the remedy."""
    path = Path(path)
    return parse_json(path, read_limited(path, error, JSON_MAX), error)


def parse_json(path: Path, content: bytes, error: type[UsvTwinError]) -> Any:
    """Return the value of JSON text that was found in a file; see :func:`read_json`."""
    try:
        value = json.loads(content)
    except (ValueError, RecursionError) as reason:
        why = "it is nested too deep" if isinstance(reason, RecursionError) else reason
        raise error(f"{path}: is not valid JSON: {why}; delete it or use an earlier copy") from None
    _check_values(path, value, error)
    return value


def _check_values(path: Path, value: Any, error: type[UsvTwinError]) -> None:
    """Refuse whole numbers that no double holds, and values nested too deep."""
    left: list[tuple[str, int, Any]] = [("", 0, value)]
    while left:
        name, depth, item = left.pop()
        if depth > DEPTH_MAX:
            raise error(f"{path}: {name[:60]} is nested more than {DEPTH_MAX} deep; make it flat")
        if isinstance(item, dict):
            left += [(f"{name}.{key}".strip("."), depth + 1, part) for key, part in item.items()]
        elif isinstance(item, list):
            left += [(name, depth + 1, part) for part in item]
        elif isinstance(item, int) and abs(item) > INTEGER_MAX:
            raise error(f"{path}: {name[:60]} has more digits than a number may have; correct it")


def import_named(name: str, error: type[UsvTwinError], what: str) -> Any:
    """Return what ``module:Class`` stands for; the module may lie in the working directory.

    ``error`` is raised where it does not exist; ``what`` says where the name was given.
    """
    module, _colon, attribute = name.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)  # as for python -m
    try:
        return getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, TypeError, ValueError) as problem:
        raise error(f"{what}: {problem}; write module:Class") from None
