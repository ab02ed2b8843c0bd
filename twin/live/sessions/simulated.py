"""A simulated boat as a session: steered, disturbed and deprived of its sensors by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.live.sessions.autopilot import Autopilot
from twin.live.sessions.sailing import SailingSession, losses, twin_of
from twin.live.sessions.session import Snapshot, sea_of
from twin.live.sessions.tracker import TwinMonitor
from twin.predictors.registry import (
    DEFAULT,
)
from twin.sim.bridge import TRUE_STATE, measurement_row, particulars_of
from usv_gym.design.seaway import warning_of
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.faults import Disturbance
from usv_gym.world.sea import SeaState
from usv_gym.world.sensors import SensorSuite
from usv_gym.world.simulation import RunawayError, Simulation

__all__ = [
    "SimulatedSession",
    "SimulationSetup",
]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class SimulationSetup:
    """What a simulated session begins with.

    vessel, sea, predictor, sensors
        As ``usv-twin simulate`` and ``identify`` take them.
    seed : int
        Of sea, sensors and random manoeuvres.
    dof : int
        Degrees of freedom of the ship.
    faults : sequence of Disturbance
        Faults of sensors beside those that are ordered.
    """

    vessel: Vessel
    sea: SeaState
    predictor: str = DEFAULT
    sensors: str = "typical"
    seed: int = 0
    dof: int = 6
    faults: Sequence[Disturbance] = ()


class SimulatedSession(SailingSession):
    """A boat in a simulated sea that is steered, disturbed and deprived of its sensors by hand.

    ``setup`` is what it begins with, ``autopilot`` who steers at first, one of
    :data:`twin.live.sessions.autopilot.AUTOPILOTS`. Logs are recorded to ``folder``.
    """

    def __init__(self, setup: SimulationSetup, folder: Path, autopilot: str = "off") -> None:
        self.suite = SensorSuite.grade(setup.sensors)
        particulars = particulars_of(setup.vessel, self.suite, setup.dof)
        super().__init__(setup.vessel, particulars, folder)
        self.setup, self.sea = setup, setup.sea
        twin = twin_of(setup.vessel, particulars, setup.predictor, setup.sea, setup.dof, setup.seed)
        self.monitor = TwinMonitor(twin)
        self.notes = self._notes()
        self.helm: Autopilot
        self._begin(autopilot)

    def restart(self) -> None:
        """Begin again in the sea that is on; a log that is recorded ends, who steers goes on."""
        self.record(False)
        self.forget()
        before = self.helm
        self._begin(before.autopilot)
        self.helm.throttle, self.helm.angle = before.throttle, before.angle

    def _begin(self, autopilot: str) -> None:
        """Put the boat to sea, with this autopilot at its helm."""
        setup = self.setup
        self.simulation = Simulation(
            1,
            setup.vessel,
            self.sea,
            suite=self.suite,
            faults=(*losses(), *setup.faults),
            dof=setup.dof,
            changing=True,
        )
        rng, self._sea_rng, helm_rng = np.random.default_rng(setup.seed).spawn(3)
        self.simulation.reset([0], [rng])
        self.helm = Autopilot(setup.vessel, helm_rng)
        self.helm.hand_over(autopilot, 0.0)
        self._take_row()
        self._anchor_now()

    def _take_row(self) -> None:
        """Hand the row of this moment to the twin and to the log."""
        sim = self.simulation
        t, z, truth = float(sim.t[0]), measurement_row(sim.z[0]), sim.state[0, TRUE_STATE]
        self.monitor.step(t, z, sim.reported[0], truth)
        self._keep(t, z, sim.reported[0], truth)

    def steer(self, autopilot: str) -> None:
        """Hand the helm over, from this moment on."""
        self.helm.hand_over(autopilot, self.t)

    def change_sea(self, sea: SeaState) -> None:
        """Put the boat into another sea."""
        self.simulation.change_sea(0, sea, self._sea_rng)
        self.sea = sea
        self.notes = self._notes()

    def _sail(self) -> bool:
        sim = self.simulation
        cmd = self.helm.command(self.t)
        try:
            sim.step(cmd[None])
        except RunawayError:
            self.set_paused(True)
            self.report("this vessel's motion grows without bounds; restart, and go on")
            return False
        self._take_row()
        return True

    def _plan(self) -> str | Array:
        return self.helm.plan(self.t)

    def _look(self) -> Snapshot:
        state, sea = self.simulation.state[0].copy(), sea_of(self.simulation)
        return self._seen(state, sea=sea, notes=self.notes)

    def _notes(self) -> tuple[str, ...]:
        """What a user should know of the vessel in this sea."""
        found = warning_of(self.setup.vessel, self.sea, self.setup.dof)
        return () if found is None else (found,)
