"""Parts of arrays seen in another shape, by kernels.

numba's own reshape calls a function that looks for strides, each time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.errors import TypingError
from numba.extending import intrinsic
from numpy.typing import NDArray

__all__ = [
    "reshaped",
    "shaped",
    "stack",
]


def reshaped(array: NDArray[np.float64], at: int, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return what :func:`shaped` returns in a kernel.

    Parameters
    ----------
    array : ndarray
        Contiguous.
    at : int
        The first of them, counted as they lie in memory.
    shape : tuple of int
        Of the view.
    """
    size = int(np.prod(shape))
    return array.reshape(-1)[at : at + size].reshape(shape)


@intrinsic
def shaped(typing_context, array, at, shape):
    """Return the numbers of an array from the ``at``-th on, as a view of another shape.

    The array must be contiguous, and nobody checks that it has as many numbers. For kernels; from
    Python, :func:`usv_kernel.jit.py_func` calls :func:`reshaped` instead.
    """
    known = isinstance(array, types.Array) and array.layout == "C"
    if not (known and array.dtype == types.float64):
        raise TypingError(f"shaped takes a contiguous array of float64, not {array}")
    seen = array.copy(ndim=len(shape))
    signature = seen(array, types.intp, shape)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        whole = context.make_array(sig.args[0])(context, builder, args[0])
        view = context.make_array(sig.return_type)(context, builder)
        sizes = [
            context.cast(builder, size, kind, types.intp)
            for size, kind in zip(cgutils.unpack_tuple(builder, args[2]), shape, strict=True)
        ]
        stride = context.get_constant(types.intp, 8)
        strides = []
        for size in reversed(sizes):
            strides.append(stride)
            stride = builder.mul(stride, size)
        of_all = types.UniTuple(types.intp, len(sizes))  # type: ignore[attr-defined]
        view.meminfo, view.parent = whole.meminfo, whole.parent
        view.data = builder.gep(whole.data, [args[1]])
        view.itemsize = whole.itemsize
        view.nitems = builder.sdiv(stride, context.get_constant(types.intp, 8))
        view.shape = context.make_tuple(builder, of_all, sizes)
        view.strides = context.make_tuple(builder, of_all, strides[::-1])
        return view._getvalue()

    return signature, generate


@intrinsic(prefer_literal=True)
def stack(typing_context, size):
    """Return room for so many float64 on the stack; what is in it is left from others.

    For kernels: the number must be a constant, and the room ends with the kernel.
    """
    if not isinstance(size, types.IntegerLiteral):
        raise TypingError(f"the size of a room on the stack must be a constant, not {size}")
    kind = types.Array(types.float64, 1, "C")

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        whole = context.get_constant
        number = ir.IntType(64)(size.literal_value)
        room = context.make_array(kind)(context, builder)
        context.populate_array(
            room,
            data=cgutils.alloca_once(builder, ir.DoubleType(), number),
            shape=[whole(types.intp, size.literal_value)],
            strides=[whole(types.intp, 8)],
            itemsize=whole(types.intp, 8),
            meminfo=None,
        )
        return room._getvalue()

    return kind(size), generate
