"""Flat memory seen by name: views, records and scratch on the stack, for kernels and for Python.

What lasts, what is configured and what is scratch lies in a few flat float64 arrays, because each
array that a kernel takes costs a call. An *opener*, an inlined kernel, takes the fields one after
the other and returns them as a NamedTuple; what has a fixed size is a record of a structured dtype.
"""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.errors import TypingError
from numba.extending import intrinsic
from numpy.typing import NDArray

__all__ = [
    "alloca_f64",
    "flat_size",
    "named_dtype",
    "python_views",
    "reshaped",
    "shaped",
    "take",
]

Array = NDArray[Any]


def reshaped(array: Array, at: int, shape: tuple[int, ...]) -> Array:
    """Return what :func:`shaped` returns in a kernel."""
    size = int(np.prod(shape))
    return array.reshape(-1)[at : at + size].reshape(shape)


def _taken(array: Array, at: int, shape: tuple[int, ...]) -> tuple[Array, int]:
    return reshaped(array, at, shape), at + int(np.prod(shape))


def python_views(opener: Callable[..., Any], **names: Any) -> Callable[..., Any]:
    """Return the Python function behind an opener; its views are of the same memory."""
    function = opener.py_func  # type: ignore[attr-defined]
    known = {**function.__globals__, "shaped": reshaped, "take": _taken, **names}
    return FunctionType(function.__code__, known)


def flat_size(opener: Callable[..., Any], *sizes: Any) -> int:
    """Return how many numbers the fields of ``opener(memory, *sizes)`` take."""
    end = 0

    def count(array: Any, at: int, shape: tuple[int, ...]) -> tuple[Array, int]:
        nonlocal end
        end = at + int(np.prod(shape))
        return np.broadcast_to(np.zeros(()), shape), end

    python_views(opener, take=count)(None, *sizes)
    return end


def named_dtype(opener: Callable[..., Any], *sizes: Any) -> np.dtype[Any]:
    """Return the structured dtype of the memory that an opener opens: the same names in Python."""
    memory = np.zeros(flat_size(opener, *sizes))
    names, formats, offsets = [], [], []

    def add(views: Any) -> None:
        for name, view in zip(views._fields, views, strict=True):
            if isinstance(view, tuple):
                parts = zip((f"{name}_{i}" for i in range(len(view))), view, strict=True)
            else:
                parts = zip((name,), (view,), strict=True)
            for part, array in parts:
                names.append(part)
                formats.append((np.float64, array.shape))
                offsets.append(array.ctypes.data - memory.ctypes.data)

    add(python_views(opener)(memory, *sizes))
    kind = {"names": names, "formats": formats, "offsets": offsets, "itemsize": memory.nbytes}
    return np.dtype(kind)  # type: ignore[call-overload]


def _contiguous(array: Any) -> types.Array:
    known = isinstance(array, types.Array) and array.layout == "C"
    if not (known and array.dtype == types.float64):
        raise TypingError(f"views take a contiguous array of float64, not {array}")
    return array


def _view(context: Any, builder: Any, source: Any, args: Any, kinds: Any, result: Any) -> Any:
    """Return a view of an array and the place after it."""
    array, at, shape = args
    whole = context.make_array(source)(context, builder, array)
    view = context.make_array(result)(context, builder)
    sizes = [
        context.cast(builder, size, kind, types.intp)
        for size, kind in zip(cgutils.unpack_tuple(builder, shape), kinds, strict=True)
    ]
    stride = context.get_constant(types.intp, 8)
    strides, number = [], context.get_constant(types.intp, 1)
    for size in reversed(sizes):
        strides.append(stride)
        stride = builder.mul(stride, size)
        number = builder.mul(number, size)
    of_all = types.UniTuple(types.intp, len(sizes))  # type: ignore[attr-defined]
    view.meminfo, view.parent = whole.meminfo, whole.parent
    view.data = builder.gep(whole.data, [at])
    view.itemsize = whole.itemsize
    view.nitems = number
    view.shape = context.make_tuple(builder, of_all, sizes)
    view.strides = context.make_tuple(builder, of_all, strides[::-1])
    return view._getvalue(), builder.add(at, number)


@intrinsic
def shaped(typing_context, array, at, shape):
    """Return the numbers of an array from the ``at``-th on, as a view of another shape.

    The array must be contiguous; that it has as many numbers is not checked. For kernels; from
    Python, :func:`python_views` calls :func:`reshaped` instead. numba's own reshape calls a
    function that looks for strides, each time.
    """
    seen = types.Array(types.float64, len(shape), _contiguous(array).layout)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _view(context, builder, sig.args[0], args, shape, sig.return_type)[0]

    return seen(array, types.intp, shape), generate


@intrinsic
def take(typing_context, array, at, shape):
    """Return the view that :func:`shaped` returns, and the place after it."""
    seen = types.Array(types.float64, len(shape), _contiguous(array).layout)
    pair = types.Tuple((seen, types.intp))  # type: ignore[attr-defined]

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        found = _view(context, builder, sig.args[0], args, shape, seen)
        return context.make_tuple(builder, sig.return_type, found)

    return pair(array, types.intp, shape), generate


@intrinsic(prefer_literal=True)
def alloca_f64(typing_context, size):
    """Return so many float64 on the stack; what is in them is left from others.

    For kernels: the number must be a constant, and the array ends with the kernel.
    """
    if not isinstance(size, types.IntegerLiteral):
        raise TypingError(f"the size of an array on the stack must be a constant, not {size}")
    kind = types.Array(types.float64, 1, "C")

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        whole = context.get_constant
        number = ir.IntType(64)(size.literal_value)
        array = context.make_array(kind)(context, builder)
        context.populate_array(
            array,
            data=cgutils.alloca_once(builder, ir.DoubleType(), number),
            shape=[whole(types.intp, size.literal_value)],
            strides=[whole(types.intp, 8)],
            itemsize=whole(types.intp, 8),
            meminfo=None,
        )
        return array._getvalue()

    return kind(size), generate
