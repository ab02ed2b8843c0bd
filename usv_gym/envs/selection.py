"""Observations made to order: which entries an agent sees, and in what units."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from usv_gym.envs.episodes import Episodes, Observer
from usv_kernel.errors import UsvTwinError, did_you_mean
from usv_kernel.jit import kernel

__all__ = ["NEAR", "Scaled", "Selection", "with_selection"]

_ALL = slice(None)

NEAR = "near"
"""Name of the entry that says how near the end of the leg is: 1 within two lengths, then falling
by a factor of e for each 4/3 lengths; from the entry ``to_go`` of the same source."""

SCALED_BOUND = 5.0
"""Bound of a scaled entry."""

_PLACE, _OFFSET, _SCALE, _BOUND, _CURVE = range(5)


class Scaled(NamedTuple):
    """An entry in other units: ``(entry - offset) / scale``, within 5 either way."""

    name: str
    """Of the new entry."""
    source: str | tuple[str, ...]
    """Name of the entry that it is made of; of several, the first that there is."""
    offset: float = 0.0
    scale: float = 1.0
    per_turn: bool = False
    """Whether the scale is in nominal speeds per length: of rates in rad/s."""
    near: float = 0.0
    """If above 0, it is this times :data:`NEAR`."""
    of_pair: Scaled | None = None
    """Its replacement for a vessel that steers by a pair of thrusters."""


@kernel
def _select(full, kinds, table, out):
    """Write the entries (n, d) that are shown of the full observations (n, D).

    ``table`` (kinds, 5, d) has place, offset, scale, bound and, if the entry is NEAR, its size.
    """
    for i in range(full.shape[0]):
        row = table[int(kinds[i])]
        for j in range(out.shape[1]):
            x = (full[i, int(row[_PLACE, j])] - row[_OFFSET, j]) / row[_SCALE, j]
            if row[_CURVE, j] > 0.0:
                x = row[_CURVE, j] * math.exp(-max(x, 0.0))
            out[i, j] = min(max(x, -row[_BOUND, j]), row[_BOUND, j])


class Selection:
    """What is shown of an observation.

    Parameters
    ----------
    episodes : Episodes
        The boats.
    known : sequence of str
        Names of all entries.
    wanted : sequence of str or Scaled
        Names of entries as they are, or entries in other units.

    Attributes
    ----------
    names : tuple of str
        Of the entries that are shown.

    Raises
    ------
    UsvTwinError
        An entry does not exist, or is named twice.
    """

    def __init__(
        self, episodes: Episodes, known: Sequence[str], wanted: Sequence[str | Scaled]
    ) -> None:
        entries = [one if isinstance(one, Scaled) else Scaled(one, one) for one in wanted]
        self.names = tuple(one.name for one in entries)
        if not entries or len(set(self.names)) < len(entries):
            raise UsvTwinError(
                f"observation = {list(self.names)}: name one entry or more, and none twice"
            )
        self._kinds = episodes.records["kind"]
        self._table = np.zeros((len(episodes.kinds), 5, len(entries)))
        places = {name: place for place, name in enumerate(known)}
        for table, kind in zip(self._table, episodes.kinds, strict=True):
            length = kind.vessel.values["length_waterline"]
            for j, given in enumerate(entries):
                pair = given.of_pair if kind.vessel.kind == "thruster_pair" else None
                one = pair or given
                place, bound = _place(one, places), SCALED_BOUND
                if not isinstance(wanted[j], Scaled):
                    bound = math.inf
                scale = one.scale * kind.speed / length if one.per_turn else one.scale
                offset = one.offset
                if one.near:
                    lengths = length / (10.0 * kind.task.unit)
                    offset, scale = 2.0 * lengths, 4.0 / 3.0 * lengths
                table[:, j] = place, offset, scale, bound, one.near

    def pick(self, full: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return what is shown (n, d) of the observations (n, D) of all boats."""
        out = np.empty((len(full), len(self.names)), np.float32)
        _select(full, self._kinds, self._table, out)
        return out


def _place(entry: Scaled, places: dict[str, int]) -> int:
    """Return the place of the source of an entry; UsvTwinError where there is none."""
    sources = (entry.source,) if isinstance(entry.source, str) else entry.source
    for source in sources:
        if source in places:
            return places[source]
    raise UsvTwinError(
        f"observation: there is no entry {sources[0]!r}{did_you_mean(sources[0], places)}; "
        "env.unwrapped.observation_names of observation='twin' and the other sets has the names"
    )


class _Sensors(Observer):
    """Adds nothing to the entries of the sensors."""

    names = ()

    def reset(self, i: int) -> None:
        """See :class:`Observer`; there is no state."""

    def observe(self, obs: NDArray[np.float32], look: bool = True, rows: slice = _ALL) -> None:
        """See :class:`Observer`; there is nothing to write."""


def with_selection(
    make: Callable[[Episodes], Observer] | None, wanted: Sequence[str | Scaled]
) -> Callable[[Episodes], Observer]:
    """Return what makes an observer that shows a selection of its entries and the sensors'.

    The arguments are those of :class:`Selection`, with the observer's ``make``.
    """

    def made(episodes: Episodes) -> Observer:
        observer = make(episodes) if make else _Sensors()
        known = (*episodes.observation, *observer.names)
        observer.selection = Selection(episodes, known, wanted)
        return observer

    return made
