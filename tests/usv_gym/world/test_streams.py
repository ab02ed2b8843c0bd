"""Generators of a boat: NumPy's own children, whatever is switched on."""

from __future__ import annotations

import numpy as np

from usv_gym import SeaState
from usv_gym.world.simulation import Simulation
from usv_gym.world.streams import KEYS, NOISE_STREAMS, STREAMS, Streams, spawned
from usv_kernel.random import STREAM, fill_normal, start_stream
from usv_kernel.streams import Children


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


def test_begin_is_a_reset_with_the_generator_of_the_seed() -> None:
    sea = [SeaState.named("2"), SeaState.named("0")]
    one, other = (Simulation(2, "usv75", sea, dof=6, suite="best") for _ in range(2))
    seeds = np.random.SeedSequence(9).spawn(2)
    for i, seed in enumerate(seeds):
        one.begin(i, Streams(Children(seed, KEYS)))
    other.reset(
        [0, 1], [np.random.default_rng(seed) for seed in np.random.SeedSequence(9).spawn(2)]
    )
    for _ in range(50):
        for simulation in (one, other):
            simulation.step(np.tile([10.0, 8.0, 0.1, 0.0], (2, 1)))
    np.testing.assert_array_equal(one.rows, other.rows)
