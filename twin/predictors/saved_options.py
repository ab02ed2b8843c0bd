"""Options of a predictor as plain data, so that a saved twin can make it again."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.checkpoint import StateError
from twin.model.dynamics import model_of
from twin.model.structure import Structure
from twin.particulars import Particulars

__all__ = [
    "pack_option",
    "unpack_option",
]

Arrays = dict[str, NDArray[Any]]

CLASSES = {
    "FilterSettings": "twin.identification.filter_settings",
    "RefitSettings": "twin.identification.prediction_error",
    "Vessel": "usv_gym.vessel.vessel",
    "Servos": "usv_kernel.servos",
    "HydroTable": "usv_gym.hydro.table",
    "SeaState": "usv_gym.world.sea",
    "SeaKeyframe": "usv_gym.world.sea",
    "Spectrum": "usv_gym.world.recorded_spectrum",
}
"""Classes whose objects a file may hold, and the modules that define them."""


def pack_option(value: Any, where: str, arrays: Arrays) -> Any:
    """Return a value as plain data for JSON; its arrays are added to ``arrays``.

    Values are numbers, texts, arrays, containers of those, and objects of :data:`CLASSES`;
    StateError names what is of another kind. ``where`` is the value's name, for messages.
    """
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufcU":
        arrays[where] = value
        return {"array": where}
    if isinstance(value, Path):
        return {"path": str(value)}
    if isinstance(value, Structure):
        return {"structure": value.name, "parameters": list(value.parameters)}
    kind = type(value)
    if CLASSES.get(kind.__name__) == kind.__module__:
        names = getattr(kind, "_fields", None) or [
            item.name for item in dataclasses.fields(kind) if item.init
        ]
        fields = {n: pack_option(getattr(value, n), f"{where}.{n}", arrays) for n in names}
        return {"class": kind.__name__, "fields": fields}
    if isinstance(value, (list, tuple, frozenset)):
        items = sorted(value) if isinstance(value, frozenset) else value
        packed = [pack_option(item, f"{where}.{i}", arrays) for i, item in enumerate(items)]
        return packed if isinstance(value, list) else {kind.__name__: packed}
    if hasattr(value, "items") and all(isinstance(key, str) for key in value):
        return {"dict": {k: pack_option(v, f"{where}.{k}", arrays) for k, v in value.items()}}
    raise StateError(
        f"option {where!r} is a {kind.__name__}, which cannot be saved; hand the predictor in as "
        "an object, and again to Twin.load(path, predictor=...)"
    )


def unpack_option(packed: Any, arrays: Arrays, particulars: Particulars) -> Any:
    """Return the value that :func:`pack_option` packed.

    Raises StateError, ValueError, TypeError or LookupError where the data are damaged.
    """

    def unpack(item: Any) -> Any:
        return unpack_option(item, arrays, particulars)

    if isinstance(packed, list):
        return [unpack(item) for item in packed]
    if not isinstance(packed, dict):
        return packed
    if "class" in packed:
        name = packed["class"]
        kind = getattr(import_module(CLASSES[name]), name)
        return kind(**{key: unpack(value) for key, value in packed["fields"].items()})
    if "structure" in packed:
        return _structure(packed["structure"], packed["parameters"], particulars)
    readers: dict[str, Callable[[Any], Any]] = {
        "array": lambda name: arrays[name],
        "path": Path,
        "tuple": lambda items: tuple(unpack(item) for item in items),
        "frozenset": lambda items: frozenset(unpack(item) for item in items),
        "dict": lambda items: {key: unpack(value) for key, value in items.items()},
    }
    ((key, value),) = packed.items()
    return readers[key](value)


def _structure(name: str, parameters: list[str], particulars: Particulars) -> Structure:
    """Return the structure of a boat with these parameters."""
    for tanker in (particulars.tanker, not particulars.tanker):
        for biased, current in itertools.product((False, True), repeat=2):
            found = model_of(particulars, name, biased=biased, tanker=tanker, current=current)
            if list(found.parameters) == parameters:
                return found
    raise StateError(
        f"the model structure {name!r} has other parameters here; load it with the usv-twin that "
        "saved it"
    )
