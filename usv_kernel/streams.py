"""Children of a random generator, those of :meth:`numpy.random.Generator.spawn` to the bit."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.random import PCG64, Generator, SeedSequence
from numpy.typing import NDArray

from usv_kernel.jit import kernel

__all__ = ["Children", "hash_numbers", "spawn_children"]

_POOL = 4
_WORDS = 8
"""Words of 32 bits of a pool, and of a state."""

_MASK = np.uint64(0xFFFFFFFF)
_SHIFT = np.uint64(16)
_INIT_A = np.uint64(0x43B0D7E5)
_MULT_A = np.uint64(0x931E8875)
_INIT_B = np.uint64(0x8B51F9DD)
_MULT_B = np.uint64(0x58F38DED)
_MIX_L = np.uint64(0xCA01F9DD)
_MIX_R = np.uint64(0x4973F715)


class Children:
    """Children of a seed sequence, which does not count them.

    Parameters
    ----------
    seed : SeedSequence
        The parent.
    keys : tuple of tuple of int
        ``(k,)`` is the k-th child, ``(k, j)`` the j-th child of that, and so on.
    first : int
        The child that is counted as the 0-th one.

    Attributes
    ----------
    states : ndarray of uint64, shape (K, 4)
        What starts the generator of each, see :func:`usv_kernel.random.start_stream`.
    """

    def __init__(
        self, seed: SeedSequence, keys: tuple[tuple[int, ...], ...], first: int = 0
    ) -> None:
        self._seed, self._keys, self._first = seed, keys, first
        each = [self._child(k).generate_state(4, np.uint64) for k in range(len(keys))]
        self.states: NDArray[np.uint64] = np.array(each)

    def _child(self, k: int) -> SeedSequence:
        one, *more = self._keys[k]
        key = (*self._seed.spawn_key, self._first + one, *more)
        return SeedSequence(self._seed.entropy, spawn_key=key, pool_size=self._seed.pool_size)

    def generator(self, k: int) -> Generator:
        """Return that of the k-th key, equal to what :meth:`numpy.random.Generator.spawn` gives."""
        return Generator(PCG64(self._child(k)))


def spawn_children(generator: Generator, keys: tuple[tuple[int, ...], ...], count: int) -> Children:
    """Return children of a generator by their keys, of which it counts ``count`` as spawned."""
    seed: Any = generator.bit_generator.seed_seq
    first = seed.n_children_spawned
    seed.spawn(count)
    return Children(seed, keys, first)


@kernel
def _scramble(word: np.uint64, const: np.uint64) -> np.uint64:
    """Return a word hashed with a constant, which is multiplied by the next one before."""
    value = (word * const) & _MASK
    return value ^ (value >> _SHIFT)


@kernel
def _mix(x: np.uint64, y: np.uint64) -> np.uint64:
    """Return two words made one."""
    mixed = (_MIX_L * x - _MIX_R * y) & _MASK
    return mixed ^ (mixed >> _SHIFT)


@kernel
def hash_numbers(numbers: np.ndarray, scratch: np.ndarray, state: np.ndarray) -> None:
    """Write what starts ``numpy.random.default_rng(numbers)``, within compiled code.

    Of the numbers only the first may have more than 32 bits. ``scratch`` (2, 8) and ``state`` (4,)
    are uint64, as all.

    Source: numpy.random.SeedSequence, after O'Neill 2015 (Developing a seed_seq alternative).
    """
    words, pool, count = scratch[0], scratch[1], 1
    words[0] = numbers[0] & _MASK
    if numbers[0] > _MASK:
        words[1], count = numbers[0] >> np.uint64(32), 2
    for number in numbers[1:]:
        words[count] = number
        count += 1
    const = _INIT_A
    for i in range(max(count, _POOL)):
        word = words[i] if i < count else np.uint64(0)
        # the first fill the pool, and all others are mixed into each of it
        for j in range(1 if i < _POOL else _POOL):
            before, const = word ^ const, (const * _MULT_A) & _MASK
            value = _scramble(before & _MASK, const)
            if i < _POOL:
                pool[i] = value
            else:
                pool[j] = _mix(pool[j], value)
        if i == _POOL - 1:
            for source in range(_POOL):
                for target in range(_POOL):
                    if source != target:
                        before, const = pool[source] ^ const, (const * _MULT_A) & _MASK
                        pool[target] = _mix(pool[target], _scramble(before & _MASK, const))
    const = _INIT_B
    for i in range(_WORDS):
        before, const = pool[i % _POOL] ^ const, (const * _MULT_B) & _MASK
        value = _scramble(before & _MASK, const)
        if i % 2 == 0:
            state[i // 2] = value
        else:
            state[i // 2] |= value << np.uint64(32)
