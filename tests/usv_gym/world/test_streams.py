"""Generators of a boat: NumPy's own children, whatever is switched on."""

from __future__ import annotations

import numpy as np

from usv_gym.world.streams import NOISE_STREAMS, STREAMS, spawned
from usv_kernel.random import STREAM, fill_normal, start_stream


def test_streams_are_the_children_of_the_generator() -> None:
    ours, theirs = (np.random.default_rng(np.random.SeedSequence(5, spawn_key=(3,))) for _ in "ab")
    stream, number = np.zeros(STREAM, np.uint64), np.zeros(1)
    for _ in range(2):  # a second time others are spawned
        found, expected = spawned(ours, wind=True), dict(zip(STREAMS, theirs.spawn(9), strict=True))
        (expected["weather"],) = expected["gusts"].spawn(1)
        (expected["fault_seeds"],) = expected["faults"].spawn(1)
        for name, words in zip(NOISE_STREAMS, found.states[: len(NOISE_STREAMS)], strict=True):
            start_stream(words, stream)
            fill_normal(stream, number)
            assert number[0] == expected.pop(name).standard_normal(), name
        for name, one in expected.items():
            assert found.generator(name).random() == one.random(), name


def test_a_generator_of_another_kind_has_the_same_children() -> None:
    sequence = np.random.SeedSequence(5)
    twister = np.random.Generator(np.random.MT19937(sequence))
    one = spawned(twister, wind=False)
    other = spawned(np.random.default_rng(5), wind=False)
    np.testing.assert_array_equal(one.states, other.states)
    assert one.generator("sea").random() == other.generator("sea").random()
    assert sequence.n_children_spawned == 8
