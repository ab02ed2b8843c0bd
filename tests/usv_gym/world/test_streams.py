"""Generators of a boat: NumPy's own children, whatever is switched on."""

from __future__ import annotations

import numpy as np
import pytest

from usv_gym import SeaState
from usv_gym.world.simulation import Simulation
from usv_gym.world.streams import STREAMS, BoatStreams


@pytest.mark.parametrize("kind", [np.random.PCG64, np.random.MT19937])
def test_streams_are_the_children_of_the_generator(kind) -> None:
    def rng() -> np.random.Generator:
        return np.random.Generator(kind(np.random.SeedSequence(5, spawn_key=(3,))))

    ours, theirs = rng(), rng()
    made = BoatStreams(sea=True, motion=True, wind=True, faults=True)
    for _ in range(2):  # a second time others are spawned
        found, expected = made.spawned(ours), theirs.spawn(len(STREAMS))
        for name, one in zip(STREAMS, expected, strict=True):
            assert found[name].random() == one.random(), name
        (slow,) = expected[1].spawn(1)
        assert found["weather"].random() == slow.random()


def test_begin_is_a_reset_with_the_generator_of_the_seed() -> None:
    sea = [SeaState.named("2"), SeaState.named("0")]
    one, other = (Simulation(2, "usv75", sea, dof=6, suite="best") for _ in range(2))
    seeds = np.random.SeedSequence(9).spawn(2)
    for i, seed in enumerate(seeds):
        one.begin(i, one.streams.of(seed))
    other.reset(
        [0, 1], [np.random.default_rng(seed) for seed in np.random.SeedSequence(9).spawn(2)]
    )
    for _ in range(50):
        for simulation in (one, other):
            simulation.step(np.tile([10.0, 8.0, 0.1, 0.0], (2, 1)))
    np.testing.assert_array_equal(one.rows, other.rows)
