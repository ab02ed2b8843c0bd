"""Random numbers of one boat: a generator of its own for each thing that is drawn."""

from __future__ import annotations

from typing import Any

import numpy as np

from usv_kernel.streams import children

__all__ = ["STREAMS", "BoatStreams", "Streams"]

Streams = dict[str, np.random.Generator]
"""Generators by the name of what they draw."""

STREAMS = ("waves", "gusts", "gps", "compass", "imu", "faults", "sea", "motion", "wind")
"""What has a child of a boat's generator, in their order; the last with an anemometer alone."""


class BoatStreams:
    """Makes the children of a boat's generator.

    What is switched off leaves the others as they were: each has its place.

    Parameters
    ----------
    sea, motion, wind, faults : bool
        Whether a sea is drawn, motion and wind are measured, and there are faults.
    """

    def __init__(self, *, sea: bool, motion: bool, wind: bool, faults: bool) -> None:
        used = {"sea": sea, "motion": motion, "wind": wind, "faults": faults}
        # with or without gusts, the slow wind is the same
        keys: list[tuple[int, ...]] = [(STREAMS.index("gusts"), 0)]
        keys += [(k,) for k, name in enumerate(STREAMS) if used.get(name, True)]
        self.keys = tuple(keys)
        """Which children of the boat's generator these are, see :func:`children`."""
        self.names = ("weather", *(STREAMS[key[0]] for key in keys[1:]))
        self._count = len(STREAMS) - (not wind)

    def of(self, seed: np.random.SeedSequence, first: int = 0) -> Streams:
        """Return the children of a seed sequence that are used, from the ``first`` one on."""
        return dict(zip(self.names, children(seed, self.keys, first), strict=True))

    def spawned(self, rng: np.random.Generator) -> Streams:
        """Return the children of a generator, which counts them as spawned."""
        seed: Any = rng.bit_generator.seed_seq
        if type(rng.bit_generator) is np.random.PCG64:
            first = seed.n_children_spawned
            seed.spawn(self._count)
            return self.of(seed, first)
        found = dict(zip(STREAMS, rng.spawn(self._count), strict=False))
        return found | {"weather": found["gusts"].spawn(1)[0]}
