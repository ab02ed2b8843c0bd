"""Sums of rows in vector instructions, written out where compilers do not find them.

A loop over a few dozen numbers is left half scalar by LLVM. The remainder of a division by sixteen
is done one by one, after checks that the arrays do not overlap. Here the last group of lanes
overlaps the one before instead, and nothing is stored before all of it has been read.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.errors import TypingError
from numba.extending import intrinsic

__all__ = [
    "LANES",
    "Block",
    "Factors",
    "Rows",
    "Strip",
    "accumulate",
    "accumulate_rows",
    "combine",
    "dots",
    "inner",
    "padded",
]

LANES = 16
"""Number of sums of :func:`dots` that run in parallel."""

_LANES = 4

_WIDE = 8
_GROUP = 6
_BLOCK = 6
"""Columns of the widest vectors, how many of them are summed side by side, so that one need not
wait for the other, and rows that :func:`accumulate_rows` holds in registers."""

_DOUBLE = ir.DoubleType()


def padded(count: int) -> int:
    """Return how many numbers hold so many, and leave no lane of a sum empty."""
    return -(-count // LANES) * LANES


class Strip(NamedTuple):
    """The numbers ``array[at : at + width]``; arrays are indexed as they lie in memory."""

    array: Any
    at: int
    width: int


class Block(NamedTuple):
    """So many strips of ``width`` numbers, ``apart`` from each other."""

    array: Any
    at: int
    apart: int
    size: int
    width: int


class Factors(NamedTuple):
    """``sign * array[start + j step]`` for j = 0, 1, ..."""

    array: Any
    start: int
    step: int
    sign: float


class Rows(NamedTuple):
    """``many`` rows, of which row j begins at ``array[first + j width]``."""

    array: Any
    first: int
    width: int
    many: int


@intrinsic
def accumulate(typing_context, to, factors, rows):
    """Add the sum over j of factor j times row j, in their order and fused, to a strip.

    What is added may lie in the same array, but not in the strip. All arrays are contiguous
    float64. For kernels only.
    """
    return _sums(to, factors, rows, add=True)


@intrinsic
def combine(typing_context, to, factors, rows):
    """Write what :func:`accumulate` adds; what was there before does not matter."""
    return _sums(to, factors, rows, add=False)


def _members(context: Any, builder: Any, kinds: Any, args: Any) -> list[Any]:
    """Return the members of NamedTuples in a row: arrays as they are, numbers cast."""
    found = []
    for kind, arg in zip(kinds, args, strict=True):
        values = cgutils.unpack_tuple(builder, arg)
        for name, member, value in zip(kind.fields, kind.types, values, strict=True):
            if not isinstance(member, types.Array):
                number = types.float64 if name == "sign" else types.intp
                value = context.cast(builder, value, member, number)
            found.append(value)
    return found


def _fused(builder: ir.IRBuilder, lanes: int) -> tuple[Any, Any]:
    """Return the type of so many lanes, and the function a b + c of them with one rounding."""
    kind = ir.VectorType(_DOUBLE, lanes) if lanes > 1 else _DOUBLE
    name = f"llvm.fma.v{lanes}f64" if lanes > 1 else "llvm.fma.f64"
    of_three = ir.FunctionType(kind, [kind] * 3)
    return kind, cgutils.get_or_insert_function(builder.module, of_three, name)


def _check_rows(*arrays: Any) -> None:
    for array in arrays:
        if not (isinstance(array, types.Array) and array.dtype == types.float64):
            raise TypingError(f"sums of rows take arrays of float64, not {array}")
        if array.layout != "C":
            raise TypingError(f"sums of rows take contiguous arrays, not {array}")


def _pointer(context: Any, builder: ir.IRBuilder, kind: Any, array: Any, at: Any) -> Any:
    """Return where an entry of an array lies."""
    return builder.gep(context.make_array(kind)(context, builder, array).data, [at])


def _sums(to: Any, factors: Any, rows: Any, add: bool) -> tuple[Any, Any]:
    """Return signature and code of the sums."""
    arrays = [kind.types[0] for kind in (to, factors, rows)]
    _check_rows(*arrays)
    signature = types.void(to, factors, rows)

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        to, at, count, factors, start, step, sign, rows, first, width, many = _members(
            context, builder, sig.args, args
        )
        target = _pointer(context, builder, arrays[0], to, at)
        each = _pointer(context, builder, arrays[1], factors, start)
        source = _pointer(context, builder, arrays[2], rows, first)
        index = count.type

        def sums(offsets: list[Any], lanes: int) -> list[Any]:
            """Return sums of vectors from each offset on, in variables of their own."""
            kind, fused = _fused(builder, lanes)

            def place(base: Any, offset: Any) -> Any:
                return builder.bitcast(builder.gep(base, [offset]), kind.as_pointer())

            zero = ir.Constant(kind, [0.0] * lanes if lanes > 1 else 0.0)
            totals = [
                cgutils.alloca_once_value(
                    builder, builder.load(place(target, offset), align=8) if add else zero
                )
                for offset in offsets
            ]
            with cgutils.for_range(builder, many) as loop:
                factor = builder.fmul(
                    sign, builder.load(builder.gep(each, [builder.mul(loop.index, step)]))
                )
                factor = _broadcast(builder, factor, lanes)
                row = builder.gep(source, [builder.mul(loop.index, width)])
                for offset, total in zip(offsets, totals, strict=True):
                    term = builder.load(place(row, offset), align=8)
                    builder.store(builder.call(fused, [factor, term, builder.load(total)]), total)
            places = (place(target, offset) for offset in offsets)
            return list(zip(places, totals, strict=True))

        def write(results: list[Any]) -> None:
            for where, total in results:
                builder.store(builder.load(total), where, align=8)

        def vectors(first: Any, lanes: int, size: int) -> list[Any]:
            return [builder.add(first, index(k * lanes)) for k in range(size)]

        def overlapping(lanes: int, size: int) -> None:
            """Sum so many vectors at once, of which the last ends where the row does."""
            last = builder.sub(count, index(lanes))
            write(sums([*vectors(index(0), lanes, size - 1), last], lanes))

        def groups() -> None:
            """Sum groups of vectors; the last one ends where the row does."""
            size = index(_WIDE * _GROUP)
            end = builder.sub(count, size)
            last = sums(vectors(end, _WIDE, _GROUP), _WIDE)
            with cgutils.for_range_slice(builder, index(0), end, size, intp=index) as loop:
                write(sums(vectors(loop[0], _WIDE, _GROUP), _WIDE))
            write(last)

        def at_most(size: int) -> None:
            """Sum a row that is not longer than so many vectors."""
            if size == 0:
                some = builder.icmp_signed(">=", count, index(_LANES))
                with builder.if_else(some) as (few, fewer):
                    with few:
                        overlapping(_LANES, 2)
                    with fewer, cgutils.for_range(builder, count) as loop:
                        write(sums([loop.index], 1))
                return
            least = _WIDE if size == 1 else _WIDE * (size - 1) + 1
            with builder.if_else(builder.icmp_signed(">=", count, index(least))) as (yes, no):
                with yes:
                    overlapping(_WIDE, size)
                with no:
                    at_most(size - 1)

        wide = builder.icmp_signed(">", count, index(_WIDE * _GROUP))
        with builder.if_else(wide) as (then, otherwise):
            with then:
                groups()
            with otherwise:
                at_most(_GROUP)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def accumulate_rows(typing_context, to, factors, rows):
    """Do :func:`accumulate` for each strip of a block.

    To strip i the factors from ``array[start + i]`` on belong; the rows serve all and stay in
    registers. They may not lie in the block; ``sign`` is 1 or -1.
    """
    arrays = [kind.types[0] for kind in (to, factors, rows)]
    _check_rows(*arrays)
    signature = types.void(to, factors, rows)

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        to, at, apart, size, count, factors, start, step, sign, rows, first, width, many = _members(
            context, builder, sig.args, args
        )
        target = _pointer(context, builder, arrays[0], to, at)
        each = _pointer(context, builder, arrays[1], factors, start)
        source = _pointer(context, builder, arrays[2], rows, first)
        index = count.type

        def columns(offset: Any, lanes: int, begin: Any, block: int, seen: Any = None) -> None:
            """Add so many rows from ``begin`` on, in so many columns from ``offset`` on.

            To the first ``seen`` of the columns nothing is added.
            """
            kind, fused = _fused(builder, lanes)

            def place(base: Any, row: Any, across: Any) -> Any:
                at = builder.add(builder.mul(row, across), offset)
                return builder.bitcast(builder.gep(base, [at]), kind.as_pointer())

            numbers = [builder.add(begin, index(k)) for k in range(block)]
            with_sign = _broadcast(builder, sign, lanes)
            held = [
                builder.fmul(with_sign, builder.load(place(source, j, width), align=8))
                for j in numbers
            ]
            if seen is not None:
                new, none = _from(builder, seen, lanes), ir.Constant(kind, [0.0] * lanes)
                held = [builder.select(new, row, none) for row in held]
            with cgutils.for_range(builder, size) as loop:
                where = place(target, loop.index, apart)
                total = builder.load(where, align=8)
                for j, row in zip(numbers, held, strict=True):
                    one = builder.gep(each, [builder.add(builder.mul(j, step), loop.index)])
                    factor = _broadcast(builder, builder.load(one), lanes)
                    total = builder.call(fused, [factor, row, total])
                builder.store(total, where, align=8)

        def groups(lanes: int, begin: Any, block: int) -> None:
            """Add so many rows in groups of columns, of which the last overlaps the one before."""
            over = builder.and_(count, index(lanes - 1))
            done, group = builder.sub(count, over), index(lanes)
            with cgutils.for_range_slice(builder, index(0), done, group, intp=index) as loop:
                at = loop[0]
                columns(at, lanes, begin, block)
            if lanes > 1:
                with builder.if_then(builder.icmp_signed("!=", over, index(0))):
                    seen = builder.sub(group, over)
                    columns(builder.sub(done, seen), lanes, begin, block, seen)

        def across(begin: Any, block: int) -> None:
            """Add so many rows from ``begin`` on, in all columns."""
            wide, some = (
                builder.icmp_signed(">=", count, index(lanes)) for lanes in (_WIDE, _LANES)
            )
            with builder.if_else(wide) as (then, otherwise):
                with then:
                    groups(_WIDE, begin, block)
                with otherwise, builder.if_else(some) as (few, fewer):
                    with few:
                        groups(_LANES, begin, block)
                    with fewer:
                        groups(1, begin, block)

        rest = builder.srem(many, index(_BLOCK))
        end = builder.sub(many, rest)
        with cgutils.for_range_slice(builder, index(0), end, index(_BLOCK), intp=index) as loop:
            at = loop[0]
            across(at, _BLOCK)
        with cgutils.for_range_slice(builder, end, many, index(1), intp=index) as loop:
            at = loop[0]
            across(at, 1)
        return context.get_dummy_value()

    return signature, generate


def _broadcast(builder: ir.IRBuilder, number: Any, lanes: int) -> Any:
    """Return a number in all lanes."""
    if lanes == 1:
        return number
    none = ir.Constant(ir.VectorType(_DOUBLE, lanes), ir.Undefined)
    one = builder.insert_element(none, number, ir.IntType(32)(0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
    return builder.shuffle_vector(one, none, mask)


@intrinsic
def inner(typing_context, a, first, b, start, count):
    """Return the sum of ``a[first + k] b[start + k]`` over k = 0 ... count - 1.

    Four sums run side by side; each term is fused. The arrays are contiguous float64, and indexed
    as they lie in memory. For kernels only.
    """
    _check_rows(a, b)
    whole = types.intp
    signature = types.float64(a, whole, b, whole, whole)

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        count = args[4]
        index = count.type
        rows = [_pointer(context, builder, sig.args[k], args[k], args[k + 1]) for k in (0, 2)]
        result = cgutils.alloca_once_value(builder, _DOUBLE(0.0))

        def term(at: Any, lanes: int) -> tuple[Any, list[Any]]:
            kind, fused = _fused(builder, lanes)
            places = (builder.bitcast(builder.gep(row, [at]), kind.as_pointer()) for row in rows)
            return fused, [builder.load(place, align=8) for place in places]

        with builder.if_else(builder.icmp_signed(">=", count, index(_LANES))) as (wide, narrow):
            with wide:
                kind = _fused(builder, _LANES)[0]
                over = builder.and_(count, index(_LANES - 1))
                fused, (one, other) = term(builder.sub(count, index(_LANES)), _LANES)
                # the last four overlap those before, whose elements do not count twice
                new = _from(builder, builder.sub(index(_LANES), over), _LANES)
                none = ir.Constant(kind, [0.0] * _LANES)
                total = cgutils.alloca_once_value(
                    builder, builder.select(new, builder.fmul(one, other), none)
                )
                done, group = builder.sub(count, over), index(_LANES)
                with cgutils.for_range_slice(builder, index(0), done, group, intp=index) as loop:
                    at = loop[0]
                    fused, pair = term(at, _LANES)
                    builder.store(builder.call(fused, [*pair, builder.load(total)]), total)
                builder.store(_folded(builder, builder.load(total), _LANES), result)
            with narrow, cgutils.for_range(builder, count) as loop:
                fused, pair = term(loop.index, 1)
                builder.store(builder.call(fused, [*pair, builder.load(result)]), result)
        return builder.load(result)

    return signature, generate


def _from(builder: ir.IRBuilder, lane: Any, lanes: int) -> Any:
    """Return which lanes are not before the given one."""
    numbers = ir.Constant(ir.VectorType(_DOUBLE, lanes), [float(k) for k in range(lanes)])
    return builder.fcmp_ordered(
        ">=", numbers, _broadcast(builder, builder.sitofp(lane, _DOUBLE), lanes)
    )


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
        with cgutils.for_range_slice(builder, count.type(0), end, size, intp=count.type) as loop:
            at = loop[0]
            first, second, factor = (
                builder.load(
                    builder.bitcast(builder.gep(row.data, [at]), kind.as_pointer()), align=8
                )
                for row in rows
            )
            for total, row in zip(totals, (first, second), strict=True):
                builder.store(builder.call(fused, [row, factor, builder.load(total)]), total)
        return context.make_tuple(
            builder,
            sig.return_type,
            [_folded(builder, builder.load(total), LANES) for total in totals],
        )

    return pair(a, b, x), generate


def _folded(builder: ir.IRBuilder, lanes: Any, many: int) -> Any:
    """Return the sum of all lanes, pair by pair."""
    half = many // 2
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
