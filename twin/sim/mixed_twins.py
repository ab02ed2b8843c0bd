"""Twins of boats of several kinds, and twins that agents do not see."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.digital_twin import Twin
from twin.predictors.registry import PredictorError
from twin.sim.batched_twins import TwinObserver, TwinOptions, twins_of
from usv_gym.envs.episodes import Episodes, Observer
from usv_gym.envs.observation import OBSERVERS
from usv_gym.envs.scene import TwinOverlay

__all__ = ["MixedTwins", "observer_of"]

_ALL = slice(None)


class MixedTwins(Observer):
    """Twins of n boats, each of one of several kinds in its episode.

    Parameters
    ----------
    episodes : Episodes
        The boats.
    kinds : sequence of TwinObserver
        Twins of all boats for each kind, as particulars and prior differ; those of the kind that a
        boat has are run.
    seen : bool
        Whether the agent sees their entries; else their forecasts are graded on what it sails.
    shown : Observer, optional
        Of an agent that does not: what it sees besides the sensors.

    Raises
    ------
    PredictorError
        The kinds add different entries to the observation.
    """

    def __init__(
        self,
        episodes: Episodes,
        kinds: Sequence[TwinObserver],
        *,
        seen: bool = True,
        shown: Observer | None = None,
    ) -> None:
        self.kinds, self.seen, self.shown = tuple(kinds), seen, shown
        self.names = kinds[0].names if seen else shown.names if shown else ()
        self._numbers = episodes.records["kind"]
        if any(one.names != kinds[0].names for one in kinds):
            names = ", ".join(kind.vessel.name for kind in episodes.kinds)
            raise PredictorError(
                f"vessel = {names}: the twins of these identify different parameters, so that "
                "observation='twin_params' differs; use 'twin', or vessels of one kind"
            )
        size = len(episodes.observation) + len(kinds[0].names)
        self._unseen = np.zeros((episodes.n, size), np.float32)

    def _of(self, i: int) -> TwinObserver:
        return self.kinds[int(self._numbers[i])]

    @property
    def first(self) -> Twin:
        """The twin of the first boat."""
        return self._of(0).first

    def twin(self, i: int) -> Twin:
        """See :meth:`twin.sim.batched_twins.TwinObserver.twin`."""
        return self._of(i).twin(i)

    def overlay(self, i: int) -> TwinOverlay | None:
        """See :meth:`twin.sim.batched_twins.TwinObserver.overlay`."""
        return self._of(i).overlay(i)

    def leave_out_forecasts(self) -> None:
        """See :meth:`twin.sim.batched_twins.TwinObserver.leave_out_forecasts`."""
        for one in self.kinds:
            one.leave_out_forecasts()

    def reset(self, i: int) -> None:
        """See :class:`Observer`."""
        if self.shown is not None:
            self.shown.reset(i)
        for one in self.kinds:
            one.reset(i)
            if one is not self._of(i):
                one.leave(i)

    def observe(self, obs: NDArray[np.float32], look: bool = True, rows: slice = _ALL) -> None:
        """See :class:`Observer`; each twin writes the entries of its own boats alone."""
        if self.shown is not None:
            self.shown.observe(obs, look, rows)
        obs = obs if self.seen else self._unseen
        for one in self.kinds:
            one.observe(obs, look, rows)

    def infos(self) -> dict[str, np.ndarray]:
        """See :class:`Observer`."""
        each = [one.infos() for one in self.kinds]
        return {
            name: np.choose(self._numbers.astype(np.intp), [infos[name] for infos in each])
            for name in each[0]
        }

    def first_infos(self) -> dict[str, Any]:
        """See :class:`Observer`."""
        return self._of(0).first_infos()


def observer_of(
    episodes: Episodes, options: TwinOptions, beside: str = ""
) -> TwinObserver | MixedTwins:
    """Return the twins of n boats; ``beside`` is the set that agents see who do not see them."""
    found = twins_of(episodes, options)
    if beside:
        make = OBSERVERS[beside]
        return MixedTwins(episodes, found, seen=False, shown=make(episodes) if make else None)
    return found[0] if len(found) == 1 else MixedTwins(episodes, found)
