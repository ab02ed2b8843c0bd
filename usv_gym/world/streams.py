"""Random numbers of one boat: a generator of its own for each thing that is drawn."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from usv_kernel.streams import Children

__all__ = ["NOISE_STREAMS", "STREAMS", "BoatStreams", "Streams"]

STREAMS = ("waves", "gusts", "gps", "compass", "imu", "faults", "sea", "motion", "wind")
"""What has a child of a boat's generator, in their order; the last with an anemometer alone."""

NOISE_STREAMS = ("gps", "compass", "imu", "motion", "wind", "weather")
"""What is drawn in each step, by kernels; the others are drawn at the start."""

_KEYS: dict[str, tuple[int, ...]] = {name: (k,) for k, name in enumerate(STREAMS)}
# with or without gusts, the slow wind is the same
_KEYS["weather"] = (STREAMS.index("gusts"), 0)

_AT_START = ("waves", "gusts", "sea", "faults")


class Streams(NamedTuple):
    """Random numbers of a boat."""

    noise: NDArray[np.uint64]
    """(6, 4) what starts the generators of :data:`NOISE_STREAMS`."""
    children: Children
    first: int
    """Place of the first of the others among the children."""

    def generator(self, name: str) -> np.random.Generator:
        """Return the generator of what is drawn at the start: waves, gusts, sea or faults."""
        return self.children.generator(self.first + _AT_START.index(name))


class BoatStreams:
    """Makes the children of a boat's generator.

    What is switched off leaves the others as they were: each has its place.
    """

    keys = tuple(_KEYS[name] for name in (*NOISE_STREAMS, *_AT_START))
    """Which children of the boat's generator these are, see :class:`Children`."""

    def __init__(self, *, wind: bool) -> None:
        self._count = len(STREAMS) - (not wind)

    def of(self, children: Children) -> Streams:
        """Return those of children of which the first are :attr:`keys`."""
        count = len(NOISE_STREAMS)
        return Streams(children.states[:count], children, count)

    def spawned(self, rng: np.random.Generator) -> Streams:
        """Return the children of a generator, which counts them as spawned."""
        seed: Any = rng.bit_generator.seed_seq
        first = seed.n_children_spawned
        seed.spawn(self._count)
        return self.of(Children(seed, self.keys, first))
