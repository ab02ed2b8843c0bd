"""Children of generators are NumPy's own."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from usv_kernel.streams import children, seeded

KEYS = [(0,), (3,), (1, 0), (7, 2)]


@given(
    entropy=st.one_of(st.integers(0, 2**200), st.lists(st.integers(0, 2**40), min_size=1)),
    key=st.lists(st.integers(0, 2**40), max_size=3),
)
def test_children_are_those_that_numpy_spawns(entropy, key) -> None:
    def seed() -> np.random.SeedSequence:
        return np.random.SeedSequence(entropy, spawn_key=tuple(key))

    ours = children(seed(), KEYS)
    spawned = np.random.default_rng(seed()).spawn(8)
    theirs = [spawned[0], spawned[3], spawned[1].spawn(1)[0], spawned[7].spawn(3)[2]]
    for one, other in zip(ours, theirs, strict=True):
        assert one.bit_generator.state == other.bit_generator.state
        np.testing.assert_array_equal(one.standard_normal(3), other.standard_normal(3))


@given(st.lists(st.integers(0, 2**70), min_size=1, max_size=7))
def test_seeded_generators_are_those_of_numpy(numbers) -> None:
    theirs = np.random.default_rng(numbers)
    assert seeded(numbers).bit_generator.state == theirs.bit_generator.state
