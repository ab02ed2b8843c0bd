"""Results of costly functions of arrays, kept for equal arguments.

Two runs that differ by a late fault are equal up to it. So a net that was trained on the one need
not be trained on the other, and a forecast from the same past need not be made again.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "MISSING",
    "Memo",
]

MISSING = object()
"""Stands for no result."""


class Memo:
    """The last results by the digest of their arguments; threads may share it."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._kept: OrderedDict[bytes, Any] = OrderedDict()
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies and pickles begin empty."""
        return Memo, (self._size,)

    @staticmethod
    def key(arrays: Sequence[NDArray[Any]], *more: object) -> bytes:
        """Return the digest of arrays, with their shapes and types, and of what else matters."""
        digest = hashlib.blake2b(repr(more).encode(), digest_size=16)
        for array in arrays:
            digest.update(f"{array.dtype}{array.shape}".encode())
            digest.update(np.ascontiguousarray(array).data)
        return digest.digest()

    def find(self, key: bytes) -> Any:
        """Return the result of a key; :data:`MISSING` where there is none."""
        with self._lock:
            if key not in self._kept:
                return MISSING
            self._kept.move_to_end(key)
            return self._kept[key]

    def keep(self, key: bytes, result: Any) -> None:
        """Keep a result; the one that was not asked for the longest makes place."""
        with self._lock:
            self._kept[key] = result
            while len(self._kept) > self._size:
                self._kept.popitem(last=False)
