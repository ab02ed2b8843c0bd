"""A simulated boat under an autopilot, its log, and its twin as external navigation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from twin.channels import MEASUREMENTS
from twin.digital_twin import Twin
from twin.live.external.navigation import ExternalNavigation
from twin.live.external.peer import MavlinkPort
from twin.live.protocols.mavlink import ONBOARD, MavlinkWriter
from twin.logs.datum import Datum
from twin.logs.log import Log
from twin.sim.bridge import CONTROL_STEP_S, TRUE_STATE, VERTICAL, measurement_row
from usv_gym.sitl.backend import Backend
from usv_gym.world.channels import GPS_BIT
from usv_gym.world.faults import EFFECTS, FAULT_KINDS, Disturbance
from usv_gym.world.sensors import SensorSuite

__all__ = ["GPS_RATE_HZ", "AutopilotRun", "suite_of", "unmirrored"]

Array = NDArray[np.float64]

GPS_RATE_HZ = 5.0
"""Rate of the receivers that autopilots have."""

RECEIVER, RETRY = "SIM_GPS1_ENABLE", 0.2
"""Parameter that switches the receiver of ArduPilot's simulator, and the time, s, after which the
order is given again if it was not confirmed."""


def suite_of(grade: str) -> SensorSuite:
    """Return the sensors of a grade, with the rate of an autopilot's receiver."""
    values = {**vars(SensorSuite.grade(grade)), "gps_rate": GPS_RATE_HZ}
    return SensorSuite(**values)


def unmirrored(faults: Iterable[Disturbance]) -> list[str]:
    """Return the faults that strike the twin's sensors alone, and not those of the autopilot."""
    return [
        f"{fault.kind}-{fault.effect}"
        for fault in faults
        if fault.effect != "loss" or FAULT_KINDS[fault.kind] != GPS_BIT
    ]


class AutopilotRun:
    """What happens beside a backend: a log with the truth, and the twin as navigation.

    Rows have the length :data:`twin.sim.bridge.CONTROL_STEP_S`, with the last sample of each sensor
    within it. When the boat is cast off the twin begins again: what it saw of a moored boat would
    teach it that wind and current do not move it.

    Parameters
    ----------
    backend : Backend
        The boat. Its hooks are taken over.
    datum : Datum
        Where the boat starts, as the autopilot's home.
    twin : Twin, optional
        With it, ``navigation`` and ``port`` are needed.
    navigation : ExternalNavigation, optional
        Decides what the autopilot is sent.
    port : MavlinkPort, optional
        Where the autopilot speaks MAVLink; faults of the GPS reach its receiver by it.
    on_log : callable, optional
        Called with the log of each run of the autopilot, when it begins again or at the end.
    on_row : callable, optional
        Called with time, measurements, command and truth of each row.
    """

    def __init__(
        self,
        backend: Backend,
        datum: Datum,
        *,
        twin: Twin | None = None,
        navigation: ExternalNavigation | None = None,
        port: MavlinkPort | None = None,
        on_log: Callable[[Log], None] | None = None,
        on_row: Callable[[float, Array, Array, Array], None] | None = None,
    ) -> None:
        self.backend, self.datum = backend, datum
        self.twin, self.navigation, self.port = twin, navigation, port
        self.on_log, self.on_row = on_log, on_row
        backend.on_step, backend.on_restart = self._after_step, self._restart
        self._plane = datum.plane
        self._writer = MavlinkWriter(component=ONBOARD)
        self._every = max(round(CONTROL_STEP_S / backend.simulation.dt), 1)
        self._begin()

    def _begin(self) -> None:
        """Begin an empty log."""
        self._rows: list[tuple[float, Array, Array, Array, Array]] = []
        self._z = np.full_like(self.backend.simulation.z[0], math.nan)
        self._steps, self._moored = 0, self.backend.moors
        self._receiver_on, self._confirmed, self._receiver_asked = True, True, -math.inf

    @property
    def log(self) -> Log:
        """The rows so far, with the truth."""
        sim = self.backend.simulation
        t, z, cmd, truth, motion = zip(*self._rows, strict=True) if self._rows else ((),) * 5
        rows = len(t)
        return Log(
            t=np.array(t, dtype=float),
            z=np.array(z, dtype=float).reshape(rows, len(MEASUREMENTS)),
            cmd=np.array(cmd, dtype=float).reshape(rows, 4),
            truth=np.array(truth, dtype=float).reshape(rows, 6),
            name=sim.vessel.name,
            datum=self.datum,
            true_motion=np.array(motion, dtype=float).reshape(rows, 6) if sim.dof == 6 else None,
        )

    def finish(self) -> None:
        """Hand over the log of the last run."""
        if self.on_log is not None and self._rows:
            self.on_log(self.log)

    def _restart(self, backend: Backend) -> None:
        """End the log of an autopilot that begins again, and forget what the twin has learned."""
        self.finish()
        self._begin()
        if self.twin is not None:
            self.twin.reset()
        if self.navigation is not None:
            self.navigation.begin()

    def _after_step(self, backend: Backend) -> None:
        sim = backend.simulation
        new = sim.z[0]
        self._z = np.where(np.isnan(new), self._z, new)
        self._steps += 1
        if self._steps % self._every == 0:
            self._take_row(backend.t)
            self._z = np.full_like(self._z, math.nan)

    def _take_row(self, t: float) -> None:
        """Hand a row to log, twin and navigation."""
        sim, state = self.backend.simulation, self.backend.simulation.state[0]
        z, cmd = measurement_row(self._z), sim.reported[0].copy()
        truth, motion = state[list(TRUE_STATE)], state[list(VERTICAL)]
        self._rows.append((t, z, cmd, truth, motion))
        if self.port is not None:
            self.port.poll()
            self._mirror_faults(t)
        if self.twin is not None:
            self._navigate(self.twin, t, z, cmd)
        if self.on_row is not None:
            self.on_row(t, z, cmd, truth)

    def _navigate(self, twin: Twin, t: float, z: Array, cmd: Array) -> None:
        """Step the twin, and send what external navigation makes of it."""
        if self._moored and not self.backend.moored:
            twin.reset()
            if self.navigation is not None:
                self.navigation.restart()
        self._moored = self.backend.moored
        twin.step(t, z, cmd)
        if self.navigation is not None and self.port is not None:
            self.port.send(self.navigation.take(t, z, twin.estimate(), self._plane, t))

    def _mirror_faults(self, t: float) -> None:
        """Switch the autopilot's receiver off while the twin's GPS is lost, and on again."""
        port, faults = self.port, self.backend.simulation.faults[0]
        if port is None or port.peer.system is None:
            return
        on = not any(_strikes(fault, t) for fault in faults)
        if on != self._receiver_on:
            self._receiver_on, self._receiver_asked = on, -math.inf
            self._confirmed = False
            port.peer.parameters.pop(RECEIVER, None)
        if not self._confirmed:
            self._confirmed = port.peer.parameters.get(RECEIVER) == float(on)
        if not self._confirmed and t - self._receiver_asked >= RETRY - 1e-6:
            self._receiver_asked = t
            port.send([self._writer.parameter(port.peer.system, RECEIVER, float(on))])


def _strikes(fault: np.void, t: float) -> bool:
    """Return whether a fault takes the fixes away at a time (s)."""
    if not (int(fault["bits"]) & GPS_BIT and fault["effect"] == EFFECTS["loss"]):
        return False
    return bool(fault["start"] <= t < fault["end"] or fault["bursting"])
