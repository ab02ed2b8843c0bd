"""What adds to an observation, or looks on, while boats sail their episodes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from usv_gym.envs.selection import Selection

__all__ = ["Observer", "StepCallback"]

_ALL = slice(None)


class StepCallback(Protocol):
    """What takes in every step of the episodes."""

    def observe(self, obs: NDArray[np.float32], look: bool = True) -> None:
        """Take in a step; ``look`` is False for the steps of a decision but the last."""


class Observer(ABC):
    """Adds entries to the observations of n boats, behind those of the sensors.

    Attributes
    ----------
    names : tuple of str
        What it adds.
    selection : Selection or None
        What of all entries is shown; None for all.
    """

    names: tuple[str, ...]
    selection: Selection | None = None
    by_block = False
    """Whether :meth:`observe_block` takes in the boats of one thread, while others sail on."""

    @abstractmethod
    def reset(self, i: int) -> None:
        """Let boat i begin an episode."""

    @abstractmethod
    def observe(self, obs: NDArray[np.float32], look: bool = True, rows: slice = _ALL) -> None:
        """Take in a step of the boats that are not idle, and write their entries.

        Parameters
        ----------
        obs : ndarray, shape (n, D)
            Observations of all boats; the first entries are those of the sensors.
        look : bool
            Write at all: False for the steps of a decision but the last.
        rows : slice
            The boats to look at.
        """

    def observe_block(self, j: int, obs: NDArray[np.float32], look: bool) -> None:  # noqa: B027
        """Do :meth:`observe` for block j of the boats, whose observations these are.

        Called with ``by_block`` only; :meth:`finish` follows when all blocks have sailed.
        """

    def finish(self, obs: NDArray[np.float32], rows: slice = _ALL) -> None:  # noqa: B027
        """Write what is left to write of some boats after the last step of a decision."""

    def infos(self) -> dict[str, np.ndarray]:
        """Return what infos gain, arrays (n,)."""
        return {}

    def first_infos(self) -> dict[str, Any]:
        """Return what the infos of the first boat gain: the numbers of :meth:`infos`."""
        return {name: values.item(0) for name, values in self.infos().items()}
