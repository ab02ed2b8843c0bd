"""Children of a random generator, made quickly: an environment draws a dozen at each reset.

They are those of :meth:`numpy.random.Generator.spawn`, to the bit. NumPy's own take 10 us each, as
the seed sequence is hashed in Python objects.

Source: numpy.random.SeedSequence, after O'Neill 2015 (Developing a seed_seq alternative).
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.random import PCG64, Generator, SeedSequence
from numpy.random.bit_generator import ISpawnableSeedSequence
from numpy.typing import NDArray

from usv_kernel.jit import kernel

__all__ = ["Children", "Parent", "hash_numbers"]

Words = NDArray[np.uint64]

_POOL, _WORDS, _KEY = 4, 8, 3
"""Words of 32 bits of a pool, and of a state; most words of a child's key."""

_MASK = np.uint64(0xFFFFFFFF)
_SHIFT = np.uint64(16)
_INIT_A, _MULT_A = np.uint64(0x43B0D7E5), np.uint64(0x931E8875)
_INIT_B, _MULT_B = np.uint64(0x8B51F9DD), np.uint64(0x58F38DED)
_MIX_L, _MIX_R = np.uint64(0xCA01F9DD), np.uint64(0x4973F715)


@kernel
def _mix(x: np.uint64, y: np.uint64) -> np.uint64:
    """Return two words made one."""
    mixed = (_MIX_L * x - _MIX_R * y) & _MASK
    return mixed ^ (mixed >> _SHIFT)


@kernel
def _hash_child(
    entropy: np.ndarray, first: int, key: np.ndarray, pool: np.ndarray, out: np.ndarray
) -> None:
    """Write the state (4,) of one child; see :func:`_hash`. ``pool`` (4,) is scratch."""
    own = entropy.shape[0]
    count = own + key.shape[0]
    const = _INIT_A
    for i in range(max(count, _POOL)):
        word = np.uint64(0)
        if i < own:
            word = entropy[i]
        elif i < count:
            word = key[i - own]
            word += np.uint64(first if i == own else 0)
        # the first fill the pool, and all others are mixed into each of it
        for j in range(1 if i < _POOL else _POOL):
            value = (word ^ const) & _MASK
            const = (const * _MULT_A) & _MASK
            value = (value * const) & _MASK
            value ^= value >> _SHIFT
            if i < _POOL:
                pool[i] = value
            else:
                pool[j] = _mix(pool[j], value)
        if i == _POOL - 1:
            for source in range(_POOL):
                for target in range(_POOL):
                    if source != target:
                        value = (pool[source] ^ const) & _MASK
                        const = (const * _MULT_A) & _MASK
                        value = (value * const) & _MASK
                        value ^= value >> _SHIFT
                        pool[target] = _mix(pool[target], value)
    const = _INIT_B
    for i in range(_WORDS):
        value = (pool[i % _POOL] ^ const) & _MASK
        const = (const * _MULT_B) & _MASK
        value = (value * const) & _MASK
        value ^= value >> _SHIFT
        if i % 2 == 0:
            out[i // 2] = value
        else:
            out[i // 2] |= value << np.uint64(32)


@kernel
def _hash(
    entropy: np.ndarray, first: int, keys: np.ndarray, sizes: np.ndarray, out: np.ndarray
) -> None:
    """Write the states (n, 4) of the children with keys (n, 3) of which ``sizes`` (n,) count.

    ``entropy`` are the words of the parent, its own key included. To the first number of each key
    ``first`` is added. The last row of ``out`` (n + 1, 4) is scratch. All arrays are uint64, and
    hold 32 bits but for the states.
    """
    pool = out[keys.shape[0]]
    for child in range(keys.shape[0]):
        _hash_child(entropy, first, keys[child, : int(sizes[child])], pool, out[child])


@kernel
def hash_numbers(numbers: np.ndarray, scratch: np.ndarray, state: np.ndarray) -> None:
    """Write what starts ``numpy.random.default_rng(numbers)``.

    Of the numbers only the first may have more than 32 bits. ``scratch`` (3, 8) and ``state`` (4,)
    are uint64, as all.
    """
    words, count = scratch[0], 1
    words[0] = numbers[0] & _MASK
    if numbers[0] > _MASK:
        words[1], count = numbers[0] >> np.uint64(32), 2
    for number in numbers[1:]:
        words[count] = number
        count += 1
    _hash_child(words[:count], 0, scratch[1, :0], scratch[2], state)


class _Seed(ISpawnableSeedSequence):
    """Hands a bit generator the state that was hashed for it, and spawns as NumPy's does."""

    def __init__(self, words: Words, own: Words, key: tuple[int, ...]) -> None:
        self._state, self._own, self._key, self._spawned = words, own, key, 0

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> Words:
        """Return the words; a PCG64 asks for four of 64 bits."""
        return self._state

    def spawn(self, n_children: int) -> list[_Seed]:
        """Return the next children."""
        first, self._spawned = self._spawned, self._spawned + n_children
        own = _keyed(self._own.tolist(), self._key)
        states = _hashed(own, first, tuple((k,) for k in range(n_children)))
        return [_Seed(state, own, (first + k,)) for k, state in enumerate(states)]


def _words(number: int) -> list[int]:
    """Return a whole number as words of 32 bits, the lowest first."""
    found = [number & 0xFFFFFFFF]
    while number := number >> 32:
        found.append(number & 0xFFFFFFFF)
    return found


def _keyed(own: list[int], key: tuple[int, ...]) -> Words:
    """Return a parent's words with its own key, which begins where a pool of zeros would end."""
    filled = own + [0] * (_POOL - len(own))
    return np.array(filled + [word for number in key for word in _words(number)], np.uint64)


class Children:
    """Children of a seed sequence, which does not count them.

    Parameters
    ----------
    seed : SeedSequence
        The parent.
    keys : tuple of tuple of int
        ``(k,)`` is the k-th child, ``(k, j)`` the j-th child of that, and so on, three at most.
    first : int
        The child that is counted as the 0-th one.
    own : ndarray of uint64, optional
        Words of the parent with its key, where they are known.

    Attributes
    ----------
    states : ndarray of uint64, shape (K, 4)
        What starts the generator of each, see :func:`usv_kernel.random.start_stream`.
    """

    def __init__(
        self,
        seed: SeedSequence,
        keys: tuple[tuple[int, ...], ...],
        first: int = 0,
        own: Words | None = None,
    ) -> None:
        self._seed, self._keys, self._first = seed, keys, first
        self._own = _own_words(seed) if own is None else own
        if self._own.size:
            self.states = _hashed(self._own, first, keys)
        else:
            each = (self._by_numpy(k) for k in range(len(keys)))
            self.states = np.array([one.generate_state(4, np.uint64) for one in each])

    def _by_numpy(self, k: int) -> SeedSequence:
        one, *more = self._keys[k]
        key = (*self._seed.spawn_key, self._first + one, *more)
        return SeedSequence(self._seed.entropy, spawn_key=key, pool_size=self._seed.pool_size)

    def generator(self, k: int) -> Generator:
        """Return that of the k-th key, equal to what :meth:`numpy.random.Generator.spawn` gives."""
        if not self._own.size:
            return Generator(PCG64(self._by_numpy(k)))
        one, *more = self._keys[k]
        seed = _Seed(self.states[k], self._own, (self._first + one, *more))
        return Generator(PCG64(seed))  # type: ignore[arg-type]


def _own_words(seed: SeedSequence) -> Words:
    """Return the words of a seed sequence with its key; none if it is of an unusual kind."""
    if isinstance(seed.entropy, int) and seed.pool_size == _POOL:
        return _keyed(_words(seed.entropy), seed.spawn_key)
    return np.empty(0, np.uint64)


class Parent:
    """A generator that has children again and again.

    NumPy makes the children that it counts, which takes as long as much of a reset. So they are
    counted when somebody asks for the generator, and at once from then on.
    """

    def __init__(self, generator: Generator, *, shared: bool = False) -> None:
        self._generator, self._shared = generator, shared
        seed: Any = generator.bit_generator.seed_seq
        self._seed, self._own, self._late = seed, _own_words(seed), 0

    @property
    def generator(self) -> Generator:
        """The generator, for others to use."""
        self._shared = True
        if self._late:
            self._seed.spawn(self._late)
            self._late = 0
        return self._generator

    def children(self, keys: tuple[tuple[int, ...], ...], count: int) -> Children:
        """Return children by their keys, of which ``count`` are new."""
        first = self._seed.n_children_spawned + self._late
        if self._shared:
            self._seed.spawn(count)
        else:
            self._late += count
        return Children(self._seed, keys, first, self._own)


def _hashed(own: Words, first: int, keys: tuple[tuple[int, ...], ...]) -> Words:
    """Return the states (K, 4) of children of a parent of so many words, from ``first`` on."""
    padded, sizes = _arrays(keys)
    states = np.empty((len(keys) + 1, _WORDS // 2), dtype=np.uint64)
    _hash(own, first, padded, sizes, states)
    return states[:-1]


@functools.lru_cache(maxsize=64)
def _arrays(keys: tuple[tuple[int, ...], ...]) -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
    """Return keys (n, 3), filled up with zeros, and their sizes (n,)."""
    padded = [(*key, *[0] * (_KEY - len(key))) for key in keys]
    return np.array(padded, np.uint64), np.array([len(key) for key in keys], np.uint64)
