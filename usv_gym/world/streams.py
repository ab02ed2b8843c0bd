"""Random numbers of one boat: a generator of its own for each thing that is drawn."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from usv_kernel.streams import Children, spawn_children

__all__ = [
    "FAULTS",
    "FAULT_SEEDS",
    "GUSTS",
    "KEYS",
    "NOISE_STREAMS",
    "SEA",
    "STREAMS",
    "WAVES",
    "Streams",
    "spawned",
]

STREAMS = ("waves", "gusts", "gps", "compass", "imu", "faults", "sea", "motion", "wind")
"""What has a child of a boat's generator, in their order; the last with an anemometer alone."""

NOISE_STREAMS = ("gps", "compass", "imu", "motion", "wind", "weather")
"""What is drawn in each step, by kernels; the others are drawn at the start."""

_AT_START = ("waves", "gusts", "sea", "faults", "fault_seeds")

WAVES, GUSTS, SEA, FAULTS, FAULT_SEEDS = range(len(NOISE_STREAMS), len(NOISE_STREAMS) + 5)
"""Places of what is drawn at the start among :data:`KEYS`."""

_PLACES: dict[str, tuple[int, ...]] = {name: (k,) for k, name in enumerate(STREAMS)}
# with or without gusts, the slow wind is the same
_PLACES["weather"] = (STREAMS.index("gusts"), 0)
_PLACES["fault_seeds"] = (STREAMS.index("faults"), 0)

KEYS = tuple(_PLACES[name] for name in (*NOISE_STREAMS, *_AT_START))
"""Children of a boat's generator, see :class:`Children`. What is switched off leaves the others as
they were: each has its place."""


class Streams(NamedTuple):
    """Random numbers of a boat."""

    children: Children
    """Those of which the first are :data:`KEYS`."""

    @property
    def states(self) -> NDArray[np.uint64]:
        """What starts the generator of each of :data:`KEYS`, shape (11 or more, 4)."""
        return self.children.states

    def generator(self, name: str) -> np.random.Generator:
        """Return the generator of what is drawn at the start: waves, gusts, sea or faults."""
        return self.children.generator(len(NOISE_STREAMS) + _AT_START.index(name))


def spawned(rng: np.random.Generator, *, wind: bool) -> Streams:
    """Return children of a generator, which counts them as spawned.

    ``wind`` says whether there is an anemometer.
    """
    return Streams(spawn_children(rng, KEYS, len(STREAMS) - (not wind)))
