"""Children of generators are NumPy's own."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from usv_kernel.random import STREAM, next_word, start_stream
from usv_kernel.streams import Children, state_of

KEYS = ((0,), (3,), (1, 0), (7, 2))


def made(children: Children) -> list[np.random.Generator]:
    return [children.generator(k) for k in range(len(children.states))]


@given(
    entropy=st.one_of(st.integers(0, 2**200), st.lists(st.integers(0, 2**40), min_size=1)),
    key=st.lists(st.integers(0, 2**40), max_size=3),
)
def test_children_are_those_that_numpy_spawns(entropy, key) -> None:
    def seed() -> np.random.SeedSequence:
        return np.random.SeedSequence(entropy, spawn_key=tuple(key))

    ours = made(Children(seed(), KEYS))
    spawned = np.random.default_rng(seed()).spawn(8)
    theirs = [spawned[0], spawned[3], spawned[1].spawn(1)[0], spawned[7].spawn(3)[2]]
    for one, other in zip(ours, theirs, strict=True):
        assert one.bit_generator.state == other.bit_generator.state
        np.testing.assert_array_equal(one.standard_normal(3), other.standard_normal(3))
        for _ in range(2):  # and so are their own children
            born = [each.spawn(2)[1].bit_generator.state for each in (one, other)]
            assert born[0] == born[1]


@given(first=st.integers(0, 2**31), key=st.lists(st.integers(0, 2**40), max_size=2))
def test_children_from_a_first_one_on_are_those_that_numpy_spawns(first, key) -> None:
    seed = np.random.SeedSequence(7, spawn_key=tuple(key))
    keys = (*KEYS, (2, 1, 4))
    for one, (k, *rest) in zip(made(Children(seed, keys, first)), keys, strict=True):
        whole = np.random.SeedSequence(7, spawn_key=(*key, first + k, *rest))
        assert one.bit_generator.state == np.random.default_rng(whole).bit_generator.state


@given(st.lists(st.integers(0, 2**70), min_size=1, max_size=7))
def test_states_of_numbers_are_those_of_numpy(numbers) -> None:
    stream = np.zeros(STREAM, dtype=np.uint64)
    start_stream(state_of(numbers), stream)
    assert int(next_word(stream)) == np.random.PCG64(numbers).random_raw()
