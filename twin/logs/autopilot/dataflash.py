"""Messages of ArduPilot's DataFlash logs (.BIN), which describe their own formats.

pymavlink has a reader, too. It stops for good at the first damaged byte, and runs for ever on a
format of length 0; a log that ends in a lost battery must do neither.
Source: https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from twin.logs.columns import Array
from twin.logs.errors import LogError
from twin.logs.files import cannot_be_read
from twin.logs.readers import MAX_ROWS, too_long

__all__ = [
    "DataFlash",
    "Messages",
]

_HEAD = b"\xa3\x95"

_FORMAT = 0x80
"""Kind of the messages that describe the others."""

_FORMAT_FIELDS = struct.Struct("<BB4s16s64s")

_TYPES: dict[str, tuple[str, float]] = {
    **{"b": ("i1", 1.0), "B": ("u1", 1.0), "h": ("<i2", 1.0), "H": ("<u2", 1.0)},
    **{"i": ("<i4", 1.0), "I": ("<u4", 1.0), "q": ("<i8", 1.0), "Q": ("<u8", 1.0)},
    **{"f": ("<f4", 1.0), "d": ("<f8", 1.0), "g": ("<f2", 1.0), "M": ("u1", 1.0)},
    **{"c": ("<i2", 100.0), "C": ("<u2", 100.0), "e": ("<i4", 100.0), "E": ("<u4", 100.0)},
    **{"L": ("<i4", 1e7), "n": ("S4", 1.0), "N": ("S16", 1.0), "Z": ("S64", 1.0)},
    "a": ("V64", 1.0),
}
"""Letters of a format: what stands in the file, and what it is divided by."""


@dataclass(frozen=True)
class Messages:
    """All messages of one kind."""

    rows: npt.NDArray[np.void]  # (n,): the fields as the file has them
    scales: dict[str, float]  # what each field is divided by

    def __contains__(self, name: str) -> bool:
        """Return whether the messages have a field of numbers."""
        return name in self.scales and self.rows.dtype[name].kind in "iuf"

    def __getitem__(self, name: str) -> Array:
        """Return a field of numbers, shape (n,)."""
        with np.errstate(over="ignore", invalid="ignore"):  # damaged bytes may be any number
            values = self.rows[name].astype(np.float64)
        return values if self.scales[name] == 1.0 else values / self.scales[name]

    def texts(self, name: str) -> list[str]:
        """Return a field of text."""
        return [bytes(text).decode("latin-1") for text in self.rows[name]]

    def where(self, kept: npt.NDArray[np.bool_]) -> Messages:
        """Return some of the messages."""
        return Messages(self.rows[kept], self.scales)


class DataFlash:
    """The messages of a DataFlash log that are wanted.

    Parameters
    ----------
    path : Path
        The file.
    wanted : collection of str
        Names of messages.

    Attributes
    ----------
    messages : dict of str to Messages
        By name; those that the log has.
    lost : int
        Bytes that belong to no sound message.

    Raises
    ------
    LogError
        For a file that cannot be read, or is no such log.
    """

    def __init__(self, path: Path, wanted: Collection[str]) -> None:
        self.messages: dict[str, Messages] = {}
        self.lost = 0
        try:
            with path.open("rb") as file:
                if file.read(3) != _HEAD + bytes([_FORMAT]):
                    raise LogError(
                        f"{path}: is no DataFlash log of ArduPilot; copy it again from the card, "
                        "in binary"
                    )
                with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                    self._read(path, data, frozenset(wanted))
        except OSError as error:
            raise cannot_be_read(path, error) from None

    def _read(self, path: Path, data: mmap.mmap, wanted: frozenset[str]) -> None:
        formats: dict[int, tuple[str, np.dtype, dict[str, float]]] = {}
        lengths = [0] * 256
        lengths[_FORMAT] = 3 + _FORMAT_FIELDS.size
        places: dict[int, list[int]] = {}
        at, end, sound = 0, len(data), 0
        while at + 3 <= end:
            length = lengths[data[at + 2]] if data[at : at + 2] == _HEAD else 0
            # behind damaged bytes, a header counts if another one follows its message
            follows = at + length
            if not length or (at != sound and data[follows : follows + 2] not in (_HEAD, b"")):
                at = data.find(_HEAD, at + 1)
                if at < 0:
                    break
                continue
            if follows > end:
                break
            kind = data[at + 2]
            if kind == _FORMAT:
                _describe(data[at + 3 : follows], formats, lengths)
            elif kind in formats and formats[kind][0] in wanted:
                places.setdefault(kind, []).append(at)
                if len(places[kind]) > MAX_ROWS:
                    raise too_long(str(path))
            self.lost += at - sound
            at = sound = follows
        self.lost += end - sound
        whole = np.frombuffer(data, dtype=np.uint8)
        try:
            for kind, found in places.items():
                name, dtype, scales = formats[kind]
                index = np.array(found)[:, None] + np.arange(3, 3 + dtype.itemsize)
                rows = whole[index].view(dtype)[:, 0]
                self.messages[name] = Messages(rows, scales)
        finally:
            del whole  # or the file could not be closed


def _describe(
    text: bytes, formats: dict[int, tuple[str, np.dtype, dict[str, float]]], lengths: list[int]
) -> None:
    """Take over the format of a kind of message, if it is sound and new."""
    kind, length, name, letters, columns = _FORMAT_FIELDS.unpack(text)
    kinds = letters.rstrip(b"\0").decode("latin-1")
    names = columns.rstrip(b"\0").decode("latin-1").split(",") if columns.strip(b"\0") else []
    known = set(kinds) <= set(_TYPES) and len(names) == len(kinds) == len(set(names))
    if kind in formats or kind == _FORMAT or not known or not all(names):
        return
    dtype = np.dtype([(n, _TYPES[k][0]) for n, k in zip(names, kinds, strict=True)])
    if dtype.itemsize + 3 != length:
        return
    scales = {n: _TYPES[k][1] for n, k in zip(names, kinds, strict=True)}
    formats[kind] = name.rstrip(b"\0").decode("latin-1"), dtype, scales
    lengths[kind] = length
