"""Tables in files of the classic NetCDF format, read and written without further packages."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from usv_gym.hydro.table import HydroError, HydroTable

__all__ = ["FILE_MAX", "decode_table", "encode_table", "read_table"]

FILE_MAX = 1 << 24
"""Longest file of a table, bytes."""

_DIMENSION, _VARIABLE, _ATTRIBUTE = 10, 11, 12

_TYPES = {1: ">i1", 2: "S1", 3: ">i2", 4: ">i4", 5: ">f4", 6: ">f8"}

_ENTRIES_MAX = 1000  # dimensions, variables or attributes in one list

_HDF5 = b"\x89HDF\r\n\x1a\n"

_AXES = {
    "omega": ("frequency",),
    "heading": ("heading",),
    "added_mass": ("frequency", "force", "motion"),
    "damping": ("frequency", "force", "motion"),
    "excitation_real": ("frequency", "heading", "force"),
    "excitation_imaginary": ("frequency", "heading", "force"),
    "drift": ("frequency", "heading", "drift_force"),
}
"""Variables of a table, and their dimensions."""

_ABOUT = {
    "omega": "rad/s",
    "heading": "rad; where the wave goes less where the boat heads: 0 following, pi head sea",
    "added_mass": "kg, kg m, kg m2",
    "damping": "kg/s, kg m/s, kg m2/s",
    "excitation_real": "N/m, N; load = Re(F a exp(-i omega t)), wave a cos(k.x - omega t)",
    "excitation_imaginary": "N/m, N",
    "drift": "surge N/m2, sway N/m2, yaw N/m; times the square of the amplitude",
}


class _Reader:
    """Takes numbers and names from the head of a file, never beyond its end."""

    def __init__(self, content: bytes, wide: bool) -> None:
        self.content, self.at, self.wide = content, 8, wide

    def take(self, count: int) -> bytes:
        if not 0 <= count <= len(self.content) - self.at:
            raise HydroError("is cut off, or damaged")
        self.at += count
        return self.content[self.at - count : self.at]

    def number(self) -> int:
        return int(struct.unpack(">i", self.take(4))[0])

    def offset(self) -> int:
        return int(struct.unpack(">q", self.take(8))[0]) if self.wide else self.number()

    def name(self) -> str:
        size = self.number()
        return self.take(size + -size % 4)[:size].decode("utf-8")

    def entries(self, tag: int) -> range:
        found, count = self.number(), self.number()
        if (found, count) == (0, 0):
            return range(0)
        if found != tag or not 0 <= count <= _ENTRIES_MAX:
            raise HydroError("is damaged: its head holds no such list")
        return range(count)

    def attributes(self) -> dict[str, Any]:
        found = {}
        for _ in self.entries(_ATTRIBUTE):
            name, kind, count = self.name(), self.number(), self.number()
            if kind not in _TYPES:
                raise HydroError("is damaged: an attribute has no type")
            size = count * np.dtype(_TYPES[kind]).itemsize
            raw = self.take(size + -size % 4)[:size] if size >= 0 else self.take(-1)
            found[name] = raw.decode("utf-8") if kind == 2 else np.frombuffer(raw, _TYPES[kind])
        return found


class _Content(NamedTuple):
    """Variables and attributes of a file."""

    variables: dict[str, NDArray[Any]]
    dimensions: dict[str, tuple[str, ...]]
    attributes: dict[str, Any]


def _decode(content: bytes) -> _Content:
    """Return what a classic NetCDF file holds; HydroError says what is wrong with it."""
    if content[:8] == _HDF5:
        raise HydroError(
            "is a NetCDF-4 file, as capytaine writes; usv-twin vessel hydro --from FILE makes a "
            "table of it"
        )
    if content[:3] != b"CDF" or content[3:4] not in (b"\x01", b"\x02"):
        raise HydroError("is no NetCDF file of the classic format")
    head = _Reader(content, wide=content[3:4] == b"\x02")
    sizes, names = [], []
    for _ in head.entries(_DIMENSION):
        names.append(head.name())
        sizes.append(head.number())
    attributes = head.attributes()
    variables, dimensions = {}, {}
    for _ in head.entries(_VARIABLE):
        name = head.name()
        places = [head.number() for _ in range(min(max(head.number(), 0), 8))]
        head.attributes()
        kind = head.number()
        head.number()  # its size, which shape and type say too
        begin = head.offset()
        if kind not in _TYPES or not all(0 <= place < len(sizes) for place in places):
            raise HydroError(f"is damaged: variable {name} has no type or no dimensions")
        shape = [sizes[place] for place in places]
        if min(shape, default=1) <= 0:
            raise HydroError(f"variable {name} has a dimension without a length")
        dtype = np.dtype(_TYPES[kind])
        end = begin + math.prod(shape) * dtype.itemsize
        if not 0 <= begin <= end <= len(content):
            raise HydroError(f"is cut off: variable {name} ends beyond it")
        values = np.frombuffer(content[begin:end], dtype).reshape(shape)
        variables[name] = values if kind == 2 else values.astype(float)
        dimensions[name] = tuple(names[place] for place in places)
    return _Content(variables, dimensions, attributes)


def decode_table(content: bytes) -> HydroTable:
    """Return the table of a file's content; HydroError says what is wrong."""
    try:
        found = _decode(content)
    except UnicodeDecodeError:
        raise HydroError("is damaged: a name is no text") from None
    for name, axes in _AXES.items():
        if name == "drift" and name not in found.variables:
            continue
        if found.dimensions.get(name) != axes:
            raise HydroError(
                f"has no variable {name}({', '.join(axes)}); usv-twin vessel hydro makes such files"
            )
    values, about = found.variables, found.attributes
    for name in ("length", "density"):
        if not (isinstance(about.get(name), np.ndarray) and about[name].size == 1):
            raise HydroError(f"has no attribute {name} (a number)")
    static = about.get("hydrostatics")
    if static is not None and not (isinstance(static, np.ndarray) and static.size == 4):
        raise HydroError("attribute hydrostatics: must hold A_wp, x_F, GM_T and GM_L")
    source = about.get("source", "")
    return HydroTable(
        omega=values["omega"],
        heading=values["heading"],
        added_mass=values["added_mass"],
        damping=values["damping"],
        excitation=values["excitation_real"] + 1j * values["excitation_imaginary"],
        drift=values.get("drift"),
        length=float(about["length"][0]),
        density=float(about["density"][0]),
        hydrostatics=None if static is None else tuple(float(number) for number in static),  # type: ignore[arg-type]
        source=source if isinstance(source, str) else "",
    )


def read_table(path: Path) -> HydroTable:
    """Read a table of at most :data:`FILE_MAX` bytes; HydroError names the file and what is wrong.

    Files of usv-twin vessel hydro are read; other programs' go through that command.
    """
    try:
        with path.open("rb") as file:
            content = file.read(FILE_MAX + 1)
    except OSError as error:
        raise HydroError(f"{path}: cannot be read ({error.strerror or error})") from None
    if len(content) > FILE_MAX:
        raise HydroError(f"{path}: is longer than {FILE_MAX >> 20} MiB")
    try:
        return decode_table(content)
    except HydroError as error:
        raise HydroError(f"{path}: {error}") from None


def encode_table(table: HydroTable) -> bytes:
    """Return the content of a table's file; numbers have single precision but for the axes."""
    arrays: dict[str, NDArray[Any]] = {
        "omega": table.omega.astype(">f8"),
        "heading": table.heading.astype(">f8"),
        "added_mass": table.added_mass.astype(">f4"),
        "damping": table.damping.astype(">f4"),
        "excitation_real": table.excitation.real.astype(">f4"),
        "excitation_imaginary": table.excitation.imag.astype(">f4"),
        **({} if table.drift is None else {"drift": table.drift.astype(">f4")}),
    }
    sizes = {"frequency": len(table.omega), "heading": len(table.heading), "force": 6, "motion": 6}
    sizes["drift_force"] = 3
    numbers: dict[str, list[float]] = {
        "length": [table.length],
        "density": [table.density],
        **({} if table.hydrostatics is None else {"hydrostatics": list(table.hydrostatics)}),
    }
    texts = {
        "title": "hydrodynamics of a hull, see usv_gym.hydro.table",
        "source": table.source,
        "forces": "surge sway heave roll pitch yaw; x forward, y to starboard, z down, about the "
        "origin on the water line",
        "hydrostatics_names": "A_wp m2, x_F m, GM_T m, GM_L m",
    }
    notes: dict[str, str | list[float]] = {**texts, **numbers}
    places = {name: i for i, name in enumerate(sizes)}

    def head(begins: Mapping[str, int]) -> bytes:
        out = b"CDF\x01" + _ints(0, _DIMENSION, len(sizes))
        out += b"".join(_text(name) + _ints(size) for name, size in sizes.items())
        out += _ints(_ATTRIBUTE, len(notes))
        out += b"".join(_attribute(name, value) for name, value in notes.items())
        out += _ints(_VARIABLE, len(arrays))
        for name, array in arrays.items():
            out += _text(name) + _ints(array.ndim, *(places[axis] for axis in _AXES[name]))
            out += _ints(_ATTRIBUTE, 1) + _attribute("units", _ABOUT[name])
            kind = 6 if array.dtype.itemsize == 8 else 5
            out += _ints(kind, array.nbytes, begins[name])
        return out

    at, begins = len(head(dict.fromkeys(arrays, 0))), {}
    for name, array in arrays.items():
        begins[name], at = at, at + array.nbytes
    return head(begins) + b"".join(array.tobytes() for array in arrays.values())


def _ints(*numbers: int) -> bytes:
    return struct.pack(f">{len(numbers)}i", *numbers)


def _text(text: str) -> bytes:
    raw = text.encode("utf-8")
    return _ints(len(raw)) + raw + b"\0" * (-len(raw) % 4)


def _attribute(name: str, value: str | list[float]) -> bytes:
    if isinstance(value, str):
        return _text(name) + _ints(2) + _text(value)
    return _text(name) + _ints(6, len(value)) + np.asarray(value, ">f8").tobytes()
