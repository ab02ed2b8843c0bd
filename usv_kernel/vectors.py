"""Sums of rows in vector instructions, written out where compilers do not find them.

A loop over a few dozen numbers is left half scalar by LLVM: what is over of a multiple of sixteen
is done one by one, after checks that the arrays do not overlap. Here the last group of lanes
overlaps the one before instead, and nothing is stored before all of it has been read.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.errors import TypingError
from numba.extending import intrinsic

__all__ = ["LANES", "accumulate", "combine", "dots"]

LANES = 16
"""So many sums of :func:`dots` run side by side."""
_LANES = 4
_GROUP = 4
"""Vectors that are summed side by side, so that one need not wait for the other."""
_DOUBLE = ir.DoubleType()


@intrinsic
def accumulate(typing_context, to, at, count, factors, start, step, sign, rows, first, width, many):
    """Add ``sign * factors[start + j step] * rows[first + j width + k]`` to ``to[at + k]``.

    The sum is over j = 0 ... many - 1, in this order and each term fused; k = 0 ... count - 1.
    All arrays are contiguous float64, and indexed as they lie in memory. What is added may lie in
    the same array, but not in those ``count`` numbers. For kernels only.
    """
    return _sums(to, factors, rows, add=True)


@intrinsic
def combine(typing_context, to, at, count, factors, start, step, sign, rows, first, width, many):
    """Write what :func:`accumulate` adds; what was there before does not matter."""
    return _sums(to, factors, rows, add=False)


def _fused(builder: ir.IRBuilder, lanes: int) -> tuple[Any, Any]:
    """Return the type of so many lanes, and the function a b + c of them with one rounding."""
    kind = ir.VectorType(_DOUBLE, lanes) if lanes > 1 else _DOUBLE
    name = f"llvm.fma.v{lanes}f64" if lanes > 1 else "llvm.fma.f64"
    of_three = ir.FunctionType(kind, [kind] * 3)
    return kind, cgutils.get_or_insert_function(builder.module, of_three, name)


def _sums(to: Any, factors: Any, rows: Any, add: bool) -> tuple[Any, Any]:
    """Return signature and code of the sums."""
    for array in (to, factors, rows):
        if not (isinstance(array, types.Array) and array.dtype == types.float64):
            raise TypingError(f"sums of rows take arrays of float64, not {array}")
        if array.layout != "C":
            raise TypingError(f"sums of rows take contiguous arrays, not {array}")
    whole, real = types.intp, types.float64
    signature = types.void(
        *(to, whole, whole, factors, whole, whole, real, rows, whole, whole, whole)
    )

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        to, at, count, factors, start, step, sign, rows, first, width, many = args

        def pointer(number: int, array: Any, index: Any) -> Any:
            data = context.make_array(sig.args[number])(context, builder, array).data
            return builder.gep(data, [index])

        target, each = pointer(0, to, at), pointer(3, factors, start)
        source = pointer(7, rows, first)
        index = count.type

        def sums(offset: Any, lanes: int, vectors: int) -> list[Any]:
            """Return sums of some vectors from ``offset`` on, in variables of their own."""
            kind, fused = _fused(builder, lanes)

            def place(base: Any, vector: int) -> Any:
                lane = builder.add(offset, index(vector * lanes))
                return builder.bitcast(builder.gep(base, [lane]), kind.as_pointer())

            zero = ir.Constant(kind, [0.0] * lanes if lanes > 1 else 0.0)
            totals = [
                cgutils.alloca_once_value(
                    builder, builder.load(place(target, v), align=8) if add else zero
                )
                for v in range(vectors)
            ]
            with cgutils.for_range(builder, many) as loop:
                factor = builder.fmul(
                    sign, builder.load(builder.gep(each, [builder.mul(loop.index, step)]))
                )
                if lanes > 1:
                    one = builder.insert_element(
                        ir.Constant(kind, ir.Undefined), factor, ir.IntType(32)(0)
                    )
                    mask = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
                    factor = builder.shuffle_vector(one, ir.Constant(kind, ir.Undefined), mask)
                row = builder.gep(source, [builder.mul(loop.index, width)])
                for v, total in enumerate(totals):
                    term = builder.load(place(row, v), align=8)
                    builder.store(builder.call(fused, [factor, term, builder.load(total)]), total)
            return [(place(target, v), total) for v, total in enumerate(totals)]

        def write(results: list[Any]) -> None:
            for where, total in results:
                builder.store(builder.load(total), where, align=8)

        def groups(lanes: int, vectors: int) -> None:
            """Sum groups of so many vectors; the last one ends where the row does."""
            size = index(lanes * vectors)
            end = builder.sub(count, size)
            last = sums(end, lanes, vectors)
            with cgutils.for_range_slice(builder, index(0), end, size, intp=index) as (offset, _):
                write(sums(offset, lanes, vectors))
            write(last)

        wide = builder.icmp_signed(">=", count, index(_LANES * _GROUP))
        with builder.if_else(wide) as (then, otherwise):
            with then:
                groups(_LANES, _GROUP)
            with otherwise:
                some = builder.icmp_signed(">=", count, index(_LANES))
                with builder.if_else(some) as (few, fewer):
                    with few:
                        groups(_LANES, 1)
                    with fewer, cgutils.for_range(builder, count) as loop:
                        write(sums(loop.index, 1, 1))
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def dots(typing_context, a, b, x):
    """Return a . x and b . x of contiguous rows, in an order that no compiler changes.

    Sixteen sums run side by side, number i in sum i modulo 16, and are added pair by pair. What
    is over of a multiple of sixteen is left out: fill the rows up with zeros. For kernels only.
    """
    for array in (a, b, x):
        if array != types.Array(types.float64, 1, "C"):
            raise TypingError(f"dots take contiguous rows of float64, not {array}")
    pair = types.UniTuple(types.float64, 2)  # type: ignore[attr-defined]

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        rows = [context.make_array(a)(context, builder, value) for value in args]
        kind, fused = _fused(builder, LANES)
        zero = ir.Constant(kind, [0.0] * LANES)
        totals = [cgutils.alloca_once_value(builder, zero) for _ in "ab"]
        count = builder.extract_value(rows[2].shape, 0)
        size = count.type(LANES)
        end = builder.sub(count, builder.srem(count, size))
        with cgutils.for_range_slice(builder, count.type(0), end, size, intp=count.type) as (at, _):
            first, second, factor = (
                builder.load(
                    builder.bitcast(builder.gep(row.data, [at]), kind.as_pointer()), align=8
                )
                for row in rows
            )
            for total, row in zip(totals, (first, second), strict=True):
                builder.store(builder.call(fused, [row, factor, builder.load(total)]), total)
        return context.make_tuple(
            builder, sig.return_type, [_folded(builder, builder.load(total)) for total in totals]
        )

    return pair(a, b, x), generate


def _folded(builder: ir.IRBuilder, lanes: Any) -> Any:
    """Return the sum of all lanes, pair by pair."""
    half = LANES // 2
    while half > 0:
        parts = [
            builder.shuffle_vector(
                lanes,
                lanes,
                ir.Constant(ir.VectorType(ir.IntType(32), half), list(range(at, at + half))),
            )
            for at in (0, half)
        ]
        lanes = builder.fadd(*parts)
        half //= 2
    return builder.extract_element(lanes, ir.IntType(32)(0))
