"""Random numbers in kernels: NumPy's PCG64 and its normal numbers, to the bit.

The state of a generator is four words of 64 bits. So it can lie in a boat's memory, and a kernel
draws what it needs in every step.

Source: O'Neill 2014 (PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms);
Marsaglia and Tsang 2000 (The Ziggurat Method). The tables of the ziggurat are NumPy's.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from usv_kernel.jit import inlined, kernel

__all__ = [
    "STREAM",
    "below",
    "borrowed_stream",
    "fill_normal",
    "fill_uniform",
    "next_word",
    "start_stream",
]

STREAM = 4
"""Words of the state of a generator."""

_MULT_HIGH = np.uint64(0x2360ED051FC65DA4)
_MULT_LOW = np.uint64(0x4385DF649FCCF645)
_ZERO = np.uint64(0)
_ONE = np.uint64(1)
_EIGHT = np.uint64(8)
_ELEVEN = np.uint64(11)
_TURN, _ALL, _63 = np.uint64(58), np.uint64(64), np.uint64(63)
_HALF = np.uint64(32)
_LOW = np.uint64(0xFFFFFFFF)
_LAYER = np.uint64(0xFF)
_FRACTION = np.uint64(0x000FFFFFFFFFFFFF)

_TABLES = np.load(Path(__file__).parent / "ziggurat.npy")
_INSIDE = _TABLES[0].copy()
"""Of each layer: what is below needs no further look."""
_WIDTH = _TABLES[1].view(np.float64).copy()
_HEIGHT = _TABLES[2].view(np.float64).copy()
_TAIL = 3.6541528853610087963519472518
"""Where the tail begins, standard deviations."""


@intrinsic
def _upper(typing_context, a, b):
    """Return the upper 64 bits of the product of two words."""

    def generate(context, builder, signature, arguments):
        wide = ir.IntType(128)
        one, other = (builder.zext(each, wide) for each in arguments)
        product = builder.lshr(builder.mul(one, other), wide(64))
        return builder.trunc(product, ir.IntType(64))

    return types.uint64(types.uint64, types.uint64), generate


@inlined
def _step(high, low, more, less):
    """Return the state after another, whose increment is ``more`` and ``less``."""
    product = low * _MULT_LOW
    following = product + less
    carry = _ONE if following < product else _ZERO
    high = _upper(low, _MULT_LOW) + high * _MULT_LOW + low * _MULT_HIGH
    return high + more + carry, following


@inlined
def _word(high, low):
    """Return the random word of a state."""
    turn, mixed = high >> _TURN, high ^ low
    return (mixed >> turn) | (mixed << ((_ALL - turn) & _63))


@inlined
def _share(word):
    """Return a random number of [0, 1)."""
    return float(word >> _ELEVEN) * (1.0 / 9007199254740992.0)


@kernel
def start_stream(words: np.ndarray, stream: np.ndarray) -> None:
    """Write the state (4,) of a generator whose seed sequence gives four words."""
    more = (words[2] << _ONE) | (words[3] >> _63)
    less = (words[3] << _ONE) | _ONE
    # a step from zero leads to the increment
    low = less + words[1]
    high = more + words[0] + (_ONE if low < less else _ZERO)
    stream[0], stream[1] = _step(high, low, more, less)
    stream[2], stream[3] = more, less


@kernel
def next_word(stream: np.ndarray) -> np.uint64:
    """Return the next 64 random bits of a generator."""
    stream[0], stream[1] = _step(stream[0], stream[1], stream[2], stream[3])
    return _word(stream[0], stream[1])


@kernel
def below(stream: np.ndarray, count: int) -> int:
    """Return a whole number below ``count``, as :meth:`numpy.random.Generator.integers` draws it.

    NumPy takes a word in two halves. So one number is drawn from a generator, after uniform and
    normal ones.

    Source: Lemire 2019 (Fast Random Integer Generation in an Interval).
    """
    size = np.uint64(count)
    least = (_LOW + _ONE - size) % size
    while True:
        word = next_word(stream)
        for half in (word & _LOW, word >> _HALF):
            product = half * size
            if product & _LOW >= least:
                return np.int64(product >> _HALF)  # type: ignore[return-value]


@kernel
def fill_uniform(stream: np.ndarray, out: np.ndarray) -> None:
    """Write random numbers of [0, 1), as :meth:`numpy.random.Generator.random` draws them."""
    for k in range(out.shape[0]):
        out[k] = _share(next_word(stream))


@kernel
def fill_normal(stream: np.ndarray, out: np.ndarray) -> None:
    """Write numbers as :meth:`numpy.random.Generator.standard_normal` draws them."""
    for k in range(out.shape[0]):
        drawing = True
        while drawing:
            word = next_word(stream)
            layer = int(word & _LAYER)
            rest = word >> _EIGHT
            size = (rest >> _ONE) & _FRACTION
            x = float(size) * _WIDTH[layer]
            if rest & _ONE:
                x = -x
            drawing = False
            if size >= _INSIDE[layer]:
                if layer == 0:
                    x = _tail(stream)
                    if (size >> _EIGHT) & _ONE:
                        x = -x
                else:
                    below = _HEIGHT[layer - 1] - _HEIGHT[layer]
                    height = below * _share(next_word(stream)) + _HEIGHT[layer]
                    drawing = not height < math.exp(-0.5 * x * x)
            out[k] = x


@kernel
def _tail(stream: np.ndarray) -> float:
    """Return a normal number beyond where the tail begins."""
    while True:
        x = -(1.0 / _TAIL) * math.log1p(-_share(next_word(stream)))
        y = -math.log1p(-_share(next_word(stream)))
        if y + y > x * x:
            return _TAIL + x


@contextmanager
def borrowed_stream(rng: np.random.Generator) -> Iterator[NDArray[np.uint64]]:
    """Lend the state (4,) of a generator to kernels, and let it go on where they end.

    Of another kind than PCG64, which :func:`numpy.random.default_rng` makes, it starts one.
    """
    generator, stream = rng.bit_generator, np.empty(STREAM, np.uint64)
    kept: Any = generator.state
    if kept["bit_generator"] != "PCG64":
        start_stream(rng.integers(2**64, size=STREAM, dtype=np.uint64), stream)
        yield stream
        return
    state, increment = kept["state"]["state"], kept["state"]["inc"]
    stream[:] = *divmod(state, 2**64), *divmod(increment, 2**64)
    yield stream
    high, low = stream[:2].tolist()
    kept["state"]["state"] = (high << 64) | low
    generator.state = kept
