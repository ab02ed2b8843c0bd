"""A simulated boat as a session: steered, disturbed and deprived of its sensors by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.live.sessions.autopilot import Autopilot
from twin.live.sessions.sailing import SailingSession, losses, twin_of
from twin.live.sessions.session import SessionError, Snapshot, sea_of
from twin.live.sessions.tracker import TwinMonitor
from twin.predictors.registry import (
    DEFAULT,
    EXTRAS,
    PREDICTORS,
    PredictorError,
    predictor_class,
)
from twin.sim.bridge import TRUE_STATE, measurement_row, particulars_of
from usv_gym.design.seaway import warning_of
from usv_gym.vessel.vessel import Vessel, vessel_names
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
        Of sea, sensors, paths and random manoeuvres.
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

    ``setup`` is what the run that is on began with, ``autopilot`` who steers at first, one of
    :data:`twin.live.sessions.autopilot.AUTOPILOTS`. Logs are recorded to ``folder``. ``vessels``
    by name and ``predictors`` are on offer for a restart: nothing else is opened or imported.
    """

    offers = "steer it, restart it, and record logs to the folder of --out"

    def __init__(self, setup: SimulationSetup, folder: Path, autopilot: str = "off") -> None:
        super().__init__(setup.vessel, particulars_of(setup.vessel), folder)
        names = [name for name in vessel_names() if name != setup.vessel.name]
        self.vessels = {setup.vessel.name: setup.vessel}
        self.vessels |= {name: Vessel.load(name) for name in names}
        self.predictors = _on_offer(setup.predictor)
        self.helm: Autopilot
        self.restart(setup, autopilot)

    def restart(self, setup: SimulationSetup, autopilot: str | None = None) -> None:
        """Restart; a log that is being recorded ends. Who steers goes on unless named.

        SessionError for a predictor that was not on offer at the start. An error changes nothing.
        """
        if setup.predictor not in self.predictors:
            raise SessionError(
                f"predictor {setup.predictor!r} was not on offer at the start; use one of "
                f"{', '.join(self.predictors)}"
            )
        suite = SensorSuite.grade(setup.sensors)
        simulation = Simulation(
            1,
            setup.vessel,
            setup.sea,
            suite=suite,
            faults=(*losses(), *setup.faults),
            dof=setup.dof,
            changing=True,
        )
        particulars = particulars_of(setup.vessel, suite, setup.dof)
        twin = twin_of(setup.vessel, particulars, setup.predictor, setup.sea, setup.dof, setup.seed)
        notes = _notes(setup.vessel, setup.sea, setup.dof)
        rng, sea_rng, helm_rng = np.random.default_rng(setup.seed).spawn(3)
        simulation.reset([0], [rng])
        helm = Autopilot(setup.vessel, particulars.speed, helm_rng)
        if autopilot is None:
            autopilot = self.helm.autopilot
            helm.throttle, helm.angle = self.helm.throttle, self.helm.angle
        gust_seed = int(sea_rng.integers(2**32))
        monitor = TwinMonitor(twin)
        helm.hand_over(autopilot, 0.0, twin.predictor.state)
        z, truth = measurement_row(simulation.z[0]), simulation.state[0, TRUE_STATE]
        monitor.step(float(simulation.t[0]), z, simulation.reported[0], truth)
        self.record(False)
        self.setup, self.vessel, self.particulars = setup, setup.vessel, particulars
        self.simulation, self.monitor, self.helm, self.notes = simulation, monitor, helm, notes
        self._sea_rng, self._gust_seed = sea_rng, gust_seed
        self._mark_restart()
        self.changed += 1

    @property
    def t(self) -> float:
        """Time since the restart, s."""
        return float(self.simulation.t[0])

    def steer(self, autopilot: str) -> None:
        """Hand the helm over, from this moment on."""
        self.helm.hand_over(autopilot, self.t, self.monitor.twin.predictor.state)

    def change_sea(self, sea: SeaState, waves: bool = True) -> None:
        """Put the boat into another sea, or under another wind alone."""
        rng = np.random.default_rng(self._gust_seed) if not waves else self._sea_rng
        self.simulation.change_sea(0, sea, rng, waves=waves)
        if waves:
            self.notes = _notes(self.setup.vessel, sea, self.setup.dof)

    def _sail(self) -> bool:
        sim = self.simulation
        cmd = self.helm.command(self.t, self.monitor.twin.predictor.state)
        try:
            sim.step(cmd[None])
        except RunawayError:
            self.set_paused(True)
            self.report(
                "this vessel's motion grows without bounds; restart with another, and go on"
            )
            return False
        z, truth = measurement_row(sim.z[0]), sim.state[0, TRUE_STATE]
        self.monitor.step(self.t, z, sim.reported[0], truth)
        self._keep(self.t, z, sim.reported[0], truth)
        return True

    def _plan(self) -> str | Array:
        return self.helm.plan(self.t)

    def _look(self) -> Snapshot:
        state, sea = self.simulation.state[0].copy(), sea_of(self.simulation)
        rate = self._rate(self.t)
        return self._seen(state, path=self.helm.path, sea=sea, rate=rate, notes=self.notes)


def _notes(vessel: Vessel, sea: SeaState, dof: int) -> tuple[str, ...]:
    """Return what a user should know of a vessel in a sea."""
    found = warning_of(vessel, sea, dof)
    return () if found is None else (found,)


def _on_offer(given: str) -> tuple[str, ...]:
    """Import the predictors that a page may name, and return their names, the given one first."""
    found = []
    for name in dict.fromkeys((given, *PREDICTORS)):
        # those whose library takes seconds to load only where they are asked for at the start
        if name == given or name not in EXTRAS:
            try:
                predictor_class(name)
            except (PredictorError, ImportError):
                continue  # of another package that is broken; the given one says why by itself
            found.append(name)
    return tuple(found)
