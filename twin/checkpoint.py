"""Files of saved state: fields by name, checked as they are read.

A file is an archive of NumPy (``.npz``): the array ``header`` holds JSON, the others are the arrays
of the state. Checksums show damage. It holds no code, no pickles and no memory layout. So it is
read after any edit of the program, as long as the fields keep their names and meanings and
:data:`VERSION` stays.
"""

from __future__ import annotations

import io
import json
from collections import deque
from collections.abc import Iterable, Mapping
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from twin.files import read_archive
from usv_kernel import __version__
from usv_kernel.errors import UsvTwinError
from usv_kernel.files import parse_json, write_whole

__all__ = [
    "VERSION",
    "State",
    "StateError",
    "check_fields",
    "plain_options",
    "read",
    "record_views",
    "restore_attributes",
    "saved_attributes",
    "write",
]

State: TypeAlias = dict[str, Any]
"""Fields by name: arrays of numbers or texts, numbers, truth values, texts, None."""

FORMAT = "usv-twin state"

VERSION = 5
"""Version of the format. It rises when a field changes its name or meaning."""

_HEADER = "header"

_SCALARS = (bool, int, float, str, type(None))

_SAME = "load it with the predictor, options and boat that it was saved with"


class StateError(UsvTwinError):
    """A saved state that cannot be used; the message names the file, the field and the remedy."""


def write(path: str | Path, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write a header of plain JSON data and arrays to one file, whole or not at all.

    A file that is there is replaced once the new one is on the disk. The same state gives the same
    bytes.
    """
    content = io.BytesIO()
    about = {"format": FORMAT, "version": VERSION, "software": __version__, **header}
    entries: dict[str, Any] = {_HEADER: np.array(json.dumps(about)), **arrays}
    np.savez_compressed(content, **entries)
    write_whole(Path(path), content.getvalue())


def read(path: str | Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return header and arrays of a file that :func:`write` wrote.

    StateError: it is no such file, is damaged, or has another format version.
    """
    remedy = "choose a file that Twin.save wrote"
    entries = read_archive(path, StateError, "saved twin", remedy)
    if _HEADER not in entries:
        raise StateError(f"{path}: is no saved twin; {remedy}")
    header = parse_json(Path(path), str(entries.pop(_HEADER)).encode(), StateError)
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise StateError(f"{path}: is no saved twin; {remedy}")
    if header.get("version") != VERSION:
        raise StateError(
            f"{path}: has format version {header.get('version')}, written by usv-twin "
            f"{header.get('software')}; usv-twin {__version__} reads version {VERSION}: load it "
            "with that one, or start a new twin"
        )
    return header, entries


def plain_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options of a predictor as plain JSON data; StateError names one that is none."""

    def plain(name: str, value: Any) -> Any:
        if isinstance(value, (np.ndarray, np.generic)):
            value = value.tolist()
        if type(value) in (list, tuple):
            return [plain(name, item) for item in value]
        if not isinstance(value, _SCALARS):
            raise StateError(
                f"option {name!r} is a {type(value).__name__}, which cannot be saved; hand the "
                "predictor in as an object, and again to Twin.load(path, predictor=...)"
            )
        return value

    return {name: plain(name, value) for name, value in options.items()}


def check_fields(
    found: Mapping[str, Any], wanted: Mapping[str, Any], ragged: Iterable[str] = ()
) -> None:
    """Compare saved fields with ``wanted``, the present values: names, types and shapes.

    Those in ``ragged`` may have any number of rows. StateError names the field and the remedy.
    """
    for name in wanted:
        if name not in found:
            raise StateError(f"field {name!r} is missing; {_SAME}")
    for name, value in found.items():
        if name not in wanted:
            raise StateError(f"field {name!r} is unknown here; {_SAME}")
        problem = _other_kind(value, wanted[name])
        first = 1 if name in ragged else 0
        shape, like = np.shape(value)[first:], np.shape(wanted[name])[first:]
        if problem is None and shape != like:
            problem = f"has shape {np.shape(value)} where {np.shape(wanted[name])} is needed"
        if problem is not None:
            raise StateError(f"field {name!r} {problem}; {_SAME}")


def record_views(memory: NDArray[Any], dtype: np.dtype[Any]) -> dict[str, NDArray[Any]]:
    """Return the fields of one record on flat memory as writable views; a number has shape (1,)."""
    record = memory.view(dtype)
    fields = {name: record[name] for name in dtype.names or ()}
    return {name: view[0] if view.ndim > 1 else view for name, view in fields.items()}


def fill(views: Mapping[str, NDArray[Any]], state: Mapping[str, Any]) -> None:
    """Write saved fields into arrays of the same names, in place."""
    for name, view in views.items():
        view[...] = state[name]


def with_prefix(prefix: str, state: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields with a component's name before theirs."""
    return {f"{prefix}.{name}": value for name, value in state.items()}


def without_prefix(prefix: str, state: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of one component, under its own names."""
    start = f"{prefix}."
    return {name[len(start) :]: v for name, v in state.items() if name.startswith(start)}


def load_part(prefix: str, part: Any, state: Mapping[str, Any]) -> None:
    """Load the fields of one component; a message names them as the file does."""
    own = without_prefix(prefix, state)
    try:
        if hasattr(part, "named_parameters"):  # a module of torch
            own = {name: import_module("torch").from_numpy(v) for name, v in own.items()}
        part.load_state_dict(own)
    except StateError as error:
        raise StateError(str(error).replace("field '", f"field '{prefix}.", 1)) from None
    except (RuntimeError, TypeError, ValueError) as error:
        raise StateError(f"field {prefix!r} cannot be loaded ({error}); {_SAME}") from None


# State of objects whose class says nothing of it: their attributes


def saved_attributes(owner: Any, leave_out: Iterable[str] = ()) -> State:
    """Return the attributes of an object as fields, but those to leave out.

    Saved are numbers, truth values, texts, None, and arrays of numbers. So are lists and deques of
    numbers or of arrays of one shape, NumPy's default random generators, and objects with
    ``state_dict`` and ``load_state_dict`` (torch modules too). Functions, classes and modules are
    constants, and left out. A leading underscore is no part of a field's name. StateError names an
    attribute of another kind.
    """
    state: State = {}
    for name, value in _attributes(owner, leave_out):
        key = name.lstrip("_")
        if _is_part(value):
            found = value.state_dict()
            if hasattr(value, "named_parameters"):  # a module of torch
                found = {name: tensor.numpy(force=True) for name, tensor in found.items()}
            state |= with_prefix(key, found)
        elif _is_generator(value):
            state[key] = json.dumps(value.bit_generator.state)
        elif isinstance(value, np.generic):
            state[key] = value.item()
        elif isinstance(value, _SCALARS):
            state[key] = value
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biufU":
            state[key] = value.copy()
        elif isinstance(value, (list, deque)) and _is_stackable(value):
            state[key] = np.array(list(value))
        else:
            raise StateError(
                f"attribute {name!r} of {type(owner).__name__} is a {type(value).__name__}, which "
                "cannot be saved. Write state_dict and load_state_dict, or name it in the class's "
                "`constants` if it never changes"
            )
    return state


def restore_attributes(owner: Any, state: Mapping[str, Any], leave_out: Iterable[str] = ()) -> None:
    """Give a newly made object of the same class what :func:`saved_attributes` returned.

    An array keeps its type and number of axes. StateError names the field and the remedy.
    """
    attributes = dict(_attributes(owner, leave_out))
    rest, restored = dict(state), {}
    for name, value in attributes.items():
        key = name.lstrip("_")
        if _is_part(value):
            for field in without_prefix(key, state):
                del rest[f"{key}.{field}"]
            continue
        if key not in rest:
            raise StateError(f"field {key!r} is missing; {_SAME}")
        found = rest.pop(key)
        problem = _other_kind(found, value)
        if problem is not None:
            raise StateError(f"field {key!r} {problem}; {_SAME}")
        if _is_generator(value):
            bits = np.random.PCG64()
            bits.state = json.loads(found)
            found = np.random.Generator(bits)
        if isinstance(value, (list, deque)) and found is not None:
            found = found.tolist() if found.ndim == 1 else [row.copy() for row in found]
            found = deque(found, value.maxlen) if isinstance(value, deque) else found
        restored[name] = found
    if rest:
        raise StateError(f"field {min(rest)!r} is unknown here; {_SAME}")
    for name, value in attributes.items():
        if name not in restored:
            load_part(name.lstrip("_"), value, state)
    for name, value in restored.items():
        setattr(owner, name, value)


def _other_kind(found: Any, present: Any) -> str | None:
    """Return what is wrong with a value in the place of another; None if nothing is."""
    if found is None or present is None:
        return None
    if isinstance(present, (list, deque)):
        same = isinstance(found, np.ndarray) and found.ndim > 0
    elif isinstance(present, (str, np.random.Generator)):
        same = isinstance(found, str)
    else:
        one, other = np.asarray(found), np.asarray(present)
        same = one.ndim == other.ndim and (
            one.dtype.kind == other.dtype.kind or {one.dtype.kind, other.dtype.kind} <= set("iuf")
        )
    return None if same else f"is no {type(present).__name__} as the present one"


def _attributes(owner: Any, leave_out: Iterable[str]) -> list[tuple[str, Any]]:
    """Return names and values of what may change in an object."""
    leave_out = set(leave_out)
    return [
        (name, value)
        for name, value in vars(owner).items()
        if name not in leave_out and not _is_constant(value)
    ]


def _is_constant(value: Any) -> bool:
    return isinstance(value, (type, ModuleType)) or (callable(value) and not _is_part(value))


def _is_part(value: Any) -> bool:
    return hasattr(value, "state_dict") and hasattr(value, "load_state_dict")


def _is_generator(value: Any) -> bool:
    """Return whether a value is a generator as of ``np.random.default_rng``."""
    return isinstance(value, np.random.Generator) and type(value.bit_generator) is np.random.PCG64


def _is_stackable(values: Any) -> bool:
    """Return whether a list holds only numbers of one type, or arrays of one shape and type."""
    if not all(isinstance(v, (np.ndarray, bool, int, float)) for v in values):
        return False
    return len({(type(v), np.shape(v), np.asarray(v).dtype) for v in values}) <= 1
