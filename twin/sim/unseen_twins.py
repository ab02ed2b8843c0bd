"""Twins that agents do not see: their forecasts are graded on what the agents sail."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.digital_twin import Twin
from twin.sim.batched_twins import TwinObserver
from twin.sim.mixed_twins import MixedTwins
from usv_gym.envs.episodes import Episodes, Observer

__all__ = ["UnseenTwins"]

_ALL = slice(None)


class UnseenTwins(Observer):
    """The entries of another observer, or none, and the infos of twins.

    Parameters
    ----------
    episodes : Episodes
        The boats.
    make : callable, optional
        Makes the observer whose entries the agent sees, see
        :data:`usv_gym.envs.observation.OBSERVERS`.
    twins : TwinObserver or MixedTwins
        The twins of the boats.
    """

    def __init__(
        self,
        episodes: Episodes,
        make: Callable[[Episodes], Observer] | None,
        twins: TwinObserver | MixedTwins,
    ) -> None:
        self.shown = make(episodes) if make else None
        self.twins = twins
        self.names = self.shown.names if self.shown else ()
        # what the twins would show
        size = len(episodes.observation) + len(twins.names)
        self._unseen = np.zeros((episodes.n, size), np.float32)

    @property
    def first(self) -> Twin:
        """The twin of the first boat."""
        return self.twins.first

    def twin(self, i: int) -> Twin:
        """See :meth:`twin.sim.batched_twins.TwinObserver.twin`."""
        return self.twins.twin(i)

    def reset(self, i: int) -> None:
        """See :class:`Observer`."""
        if self.shown:
            self.shown.reset(i)
        self.twins.reset(i)

    def observe(self, obs: NDArray[np.float32], look: bool = True, rows: slice = _ALL) -> None:
        """See :class:`Observer`."""
        if self.shown:
            self.shown.observe(obs, look, rows)
        self.twins.observe(self._unseen, look, rows)

    def infos(self) -> dict[str, np.ndarray]:
        """See :class:`Observer`."""
        return self.twins.infos()

    def first_infos(self) -> dict[str, Any]:
        """See :class:`Observer`."""
        return self.twins.first_infos()
