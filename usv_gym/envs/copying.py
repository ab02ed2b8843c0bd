"""Copies of environments, in which arrays that share memory do so again.

The state of an environment lies in a few arrays. Kernels take these, and much of Python reads views
of them. NumPy pickles a view as an array of its own. Here it is pickled as a place in the array
whose memory it shows, and so is a record.
"""

from __future__ import annotations

import io
import pickle
from types import MappingProxyType
from typing import Any

import numpy as np

__all__ = ["packed", "unpacked"]


def _address(shown: Any) -> int:
    """Return where the memory of an array or record begins."""
    return int(shown.__array_interface__["data"][0])


def _owner(shown: Any) -> Any:
    """Return the array whose memory an array or record shows; None if that is its own.

    The memory of an array that was unpickled is that of ``bytes``, or its own.
    """
    base = shown.base
    while isinstance(base, (np.ndarray, np.void)) and isinstance(base.base, (np.ndarray, np.void)):
        base = base.base
    shares = isinstance(base, np.ndarray) and base.flags.c_contiguous and shown.nbytes > 0
    return base if shares else None


def _view(
    owner: np.ndarray, at: int, shape: tuple[int, ...], strides: tuple[int, ...], dtype: np.dtype
) -> np.ndarray:
    """Return a view of the memory of an array from byte ``at`` on."""
    return np.ndarray(shape, dtype, owner, at, strides)


def _record(owner: np.ndarray, at: int, dtype: np.dtype) -> Any:
    """Return a record in the memory of an array, from byte ``at`` on."""
    return _view(owner, at, (), (), dtype)[()]


def _frozen(values: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    """Return a dict that nobody changes."""
    return MappingProxyType(values)


class _Pickler(pickle.Pickler):
    """Keeps what arrays share."""

    def reducer_override(self, one: Any) -> Any:
        if isinstance(one, (np.ndarray, np.void)) and (owner := _owner(one)) is not None:
            at = _address(one) - _address(owner)
            if isinstance(one, np.void):
                return _record, (owner, at, one.dtype)
            return _view, (owner, at, one.shape, one.strides, one.dtype)
        if isinstance(one, MappingProxyType):
            return _frozen, (dict(one),)
        return NotImplemented


def packed(what: Any) -> bytes:
    """Return an object as bytes, of which :func:`unpacked` makes a copy."""
    buffer = io.BytesIO()
    _Pickler(buffer, pickle.HIGHEST_PROTOCOL).dump(what)
    return buffer.getvalue()


def unpacked(state: bytes) -> Any:
    """Return the copy of an object that :func:`packed` took."""
    return pickle.loads(state)
