"""Children of generators are NumPy's own."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from usv_kernel.streams import Children, spawn_children

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


@given(st.lists(st.sampled_from([0, 1, 3]), max_size=6))
def test_a_generator_counts_its_children(counts) -> None:
    keys = ((0,), (1, 0), (2,))
    ours, theirs = np.random.default_rng(8), np.random.default_rng(8)
    for count in counts:
        children = spawn_children(ours, keys, count)
        spawned = [child.random() for child in theirs.spawn(count)]
        if count == 3:
            assert [children.generator(k).random() for k in (0, 2)] == [spawned[0], spawned[2]]
        assert sum_of(ours) == sum_of(theirs)


def sum_of(rng: np.random.Generator) -> int:
    return rng.bit_generator.seed_seq.n_children_spawned
