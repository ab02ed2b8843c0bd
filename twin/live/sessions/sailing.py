"""A simulated boat that sails at the pace of the clock, and whose sensors can be lost by hand."""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from typing import Any

from twin.digital_twin import Twin
from twin.live.sessions.session import LAG_MAX_S, Session, SessionError
from twin.particulars import Particulars
from twin.predictors.registry import predictor_class
from twin.sim.oracle import simulator_options
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.faults import Fault
from usv_gym.world.sea import SeaState
from usv_gym.world.simulation import Simulation

__all__ = ["LOSSES", "SailingSession", "losses", "twin_of"]

LOSSES = ("gps", "imu")
"""Sensors that may be lost by order, in the places of their faults."""

NEVER_S = 1e12
"""Start of a loss that has not been ordered, s."""


def losses() -> tuple[Fault, ...]:
    """Return a fault of each of :data:`LOSSES`, which is moved when it is ordered."""
    return tuple(Fault(kind, NEVER_S, 1.0) for kind in LOSSES)


def twin_of(
    vessel: Vessel, particulars: Particulars, predictor: str, sea: SeaState, dof: int, seed: int
) -> Twin:
    """Return a twin of a simulated boat; one that needs the simulator is given its sea."""
    given: dict[str, Any] = {}
    if predictor_class(predictor).needs_simulator:
        given = simulator_options(predictor, vessel, sea, dof)
    return Twin(particulars, predictor, seed=seed, **given)


class SailingSession(Session):
    """A simulated boat at the pace of the clock; subclasses sail the rows.

    The first faults of ``simulation`` are :func:`losses`.
    """

    has_truth = True

    simulation: Simulation

    @abstractmethod
    def _sail(self) -> bool:
        """Sail and show one row; return whether the run goes on."""

    def lose(self, kind: str, seconds: float) -> None:
        """Lose ``gps`` or ``imu`` from now on for so long; infinity is until it is found again."""
        row = self._loss(kind)
        start = float(self.simulation.t[0])
        row["start"], row["end"] = start, start + seconds

    def is_lost(self, kind: str) -> bool:
        """Whether ``gps`` or ``imu`` was lost until it is found again."""
        return bool(self._loss(kind)["end"] == math.inf)

    def toggle_loss(self, kind: str) -> None:
        """Lose ``gps`` or ``imu`` for good, or find it again."""
        self.lose(kind, 0.0 if self.is_lost(kind) else math.inf)

    def _loss(self, kind: str) -> Any:
        """Return the fault of a sensor that is lost by order."""
        if kind not in LOSSES:
            raise SessionError(f"no sensor is called {kind!r}; use one of {', '.join(LOSSES)}")
        return self.simulation.faults[0, LOSSES.index(kind)]

    def _rest(self) -> float:
        return self.simulation.dt / max(self.scale, 1e-3)

    def _advance(self) -> None:
        if self.paused:
            return
        begin, first = self._anchor
        now = time.monotonic()
        goal = first + (now - begin) * self.scale
        while self.t + self.simulation.dt <= goal + 1e-9 and self._sail():
            if time.monotonic() > now + LAG_MAX_S:  # too much is asked of this machine
                self._anchor_now()
                break
