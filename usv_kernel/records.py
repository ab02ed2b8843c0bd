"""Records with named fields inside flat arrays, for kernels.

A boat's memory is one flat row of float64, because each array that a kernel takes costs its call
a tenth of a microsecond. Its first part has a fixed layout: a NumPy structured dtype. Kernels see
it as a record (``boat.command[j]``), Python under the same names (``boats["command"]``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.core import cgutils, types
from numba.core.errors import TypingError
from numba.extending import intrinsic
from numpy.typing import NDArray

__all__ = ["Record", "as_record", "as_records", "field_at", "record_size", "structured"]

Record = Any
"""Type of a record: fields are attributes in kernels, and items in Python."""


def record_size(dtype: np.dtype[Any]) -> int:
    """Return how many float64 a record of a structured dtype takes."""
    return dtype.itemsize // 8


def field_at(dtype: np.dtype[Any], name: str) -> int:
    """Return which float64 of a record a field begins with."""
    assert dtype.fields is not None
    return int(dtype.fields[name][1]) // 8


def structured(rows: NDArray[np.float64], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the first part of each row (n, ...) as a structured array (n,), a view."""
    return rows[:, : record_size(dtype)].view(dtype)[:, 0]


@intrinsic
def as_record(typing_context, array, dtype):
    """Return the first numbers of a contiguous float64 array as a record; for kernels.

    Nothing checks that the array is as long as the record.
    """
    known = isinstance(array, types.Array) and array.layout == "C" and array.ndim == 1
    if not (known and array.dtype == types.float64 and isinstance(dtype, types.DType)):
        raise TypingError(f"as_record takes a flat array of float64 and a dtype, not {array}")

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        whole = context.make_array(sig.args[0])(context, builder, args[0])
        return builder.bitcast(whole.data, context.get_value_type(sig.return_type))

    return dtype.dtype(array, dtype), generate


@intrinsic
def as_records(typing_context, array, at, count, dtype):
    """Return the numbers from the ``at``-th on as an array of ``count`` records; for kernels.

    Nothing checks that the array is as long.
    """
    known = isinstance(array, types.Array) and array.layout == "C" and array.ndim == 1
    if not (known and array.dtype == types.float64 and isinstance(dtype, types.DType)):
        raise TypingError(f"as_records takes a flat array of float64 and a dtype, not {array}")
    record = dtype.dtype
    kind = types.Array(record, 1, "C")

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        whole = context.make_array(sig.args[0])(context, builder, args[0])
        view = context.make_array(kind)(context, builder)
        size = context.get_constant(types.intp, record.size)
        count = context.cast(builder, args[2], sig.args[2], types.intp)
        at = context.cast(builder, args[1], sig.args[1], types.intp)
        data = builder.bitcast(builder.gep(whole.data, [at]), view.data.type)
        context.populate_array(
            view,
            data=data,
            shape=cgutils.pack_array(builder, [count]),
            strides=cgutils.pack_array(builder, [size]),
            itemsize=size,
            meminfo=whole.meminfo,
            parent=whole.parent,
        )
        return view._getvalue()

    return kind(array, types.intp, types.intp, dtype), generate
