"""The backend: a boat in its sea, stepped by the packets of an autopilot."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from usv_gym.physics import GRAVITY
from usv_gym.physics import frames as fr
from usv_gym.sitl.packets import Motion, ServoPacket, decode_servos, encode_motion
from usv_gym.world.simulation import Simulation
from usv_kernel.errors import UsvTwinError, check_number, check_whole

__all__ = ["COUNTS", "Backend", "BackendError", "port_of"]

Array = NDArray[np.float64]

COUNTS = {
    "received": "datagrams that came",
    "steps": "steps of the simulation",
    "repeated": "packets that came again, and were answered by the same motion again",
    "lost": "packets that never came, by their count",
    "restarts": "times that an autopilot began again",
    "late": "packets older than the last one, from the same autopilot",
    "garbage": "datagrams that are no packet of an autopilot",
    "foreign": "packets of a second autopilot, while the first one is there",
    "unsent": "answers that the system refused to send",
}
"""What a backend counts."""

PORT = 9002
INSTANCE = 10
"""Port of ArduPilot's first instance, and the distance to that of the next one."""

INSTANCES_MAX = 100

STEP_RANGE = 1e-3, 0.1
"""Steps of time, s, with which ArduPilot's clock goes on."""

OLD = 100
"""A packet that is older than the last by fewer counts was delayed, not sent after a restart."""

GONE = 2.0
"""Time of silence after which another autopilot may replace one, s."""


class BackendError(UsvTwinError):
    """A backend that cannot be made or opened; the message names the value and the remedy."""


def port_of(instance: int) -> int:
    """Return the port that ArduPilot's instance ``-I`` sends to."""
    check_whole("instance", instance, 0, INSTANCES_MAX, BackendError)
    return PORT + INSTANCE * instance


_Triple = tuple[float, float, float]


class _Kinematics(NamedTuple):
    """How a boat lies and moves at one moment, SI units."""

    place: _Triple
    attitude: _Triple
    velocity: _Triple
    rates: _Triple


class Backend:
    """A simulated boat as the physics of an autopilot, in lock-step with it.

    Each new packet steps the simulation once; a packet that comes again is answered again. The
    step is that of the simulation, whatever frame rate the packet asks for.

    Parameters
    ----------
    simulation : Simulation
        Of one boat, with a control step below 0.1 s. Its vessel says which output commands what.
    seed : int
        Seed of sea and sensors; every restart of the autopilot begins with the same ones.
    heading : float
        At the start, rad clockwise from north.
    moored : bool
        Whether the boat stays in its place, and only heaves, rolls and pitches, until a motor is
        first driven. Autopilots calibrate their sensors before they are armed.
    on_step : callable, optional
        Called after each step with this backend.
    on_restart : callable, optional
        Called with this backend before the boat is put back to the start.
    clock : callable
        Returns the time, s, by which a silent autopilot is known.

    Attributes
    ----------
    motion : Motion
        What was answered last.
    counts : dict of str to int
        By the names in :data:`COUNTS`.
    widths : tuple of int
        Pulse widths of the last step, us.
    """

    def __init__(
        self,
        simulation: Simulation,
        seed: int = 0,
        *,
        heading: float = 0.0,
        moored: bool = True,
        on_step: Callable[[Backend], None] | None = None,
        on_restart: Callable[[Backend], None] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if simulation.n != 1:
            raise BackendError(f"a simulation of {simulation.n} boats: an autopilot steers one")
        check_number("step of the simulation", simulation.dt, *STEP_RANGE, BackendError)
        if simulation.dt >= STEP_RANGE[1]:
            raise BackendError(f"a step of {simulation.dt:g} s: must be below {STEP_RANGE[1]:g} s")
        check_whole("seed", seed, 0, 2**63 - 1, BackendError)
        self.simulation, self.seed, self.heading = simulation, seed, heading
        self.moors, self.moored = moored, moored
        self.on_step, self.on_restart, self.clock = on_step, on_restart, clock
        self.counts = dict.fromkeys(COUNTS, 0)
        self.widths: tuple[int, ...] = ()
        self._servos = simulation.vessel.servos
        self._count: int | None = None
        self._peer: Any = None
        self._heard = -math.inf
        self._begin()

    @property
    def t(self) -> float:
        """Time since the start, s."""
        return float(self.simulation.t[0])

    def _begin(self) -> None:
        """Put the boat to its start, at rest."""
        sim = self.simulation
        sim.reset([0], [np.random.default_rng(self.seed)], speed=0.0, heading=self.heading)
        self.moored = self.moors
        self._place = sim.state[0, [fr.X, fr.Y, fr.PSI]].copy()
        self._before = self._kinematics()
        self.motion = self._motion(self._before, self._before)
        self._answer = encode_motion(self.motion)

    def answer(self, data: bytes, source: Any = None) -> bytes | None:
        """Return the answer to a datagram, after a step of the boat if it is a new packet.

        None for garbage, and for packets that are to be ignored; see :data:`COUNTS`. RunawayError:
        the motion grows without bounds.
        """
        self.counts["received"] += 1
        packet = decode_servos(data)
        if packet is None:
            self.counts["garbage"] += 1
            return None
        now = self.clock()
        last, same = self._count, source == self._peer
        begins = last is not None and packet.number < last
        if last is not None and not same and not begins and now - self._heard < GONE:
            self.counts["foreign"] += 1
            return None
        if (
            begins
            and same
            and last is not None
            and packet.number > 0
            and last - packet.number < OLD
        ):
            self.counts["late"] += 1
            return None
        self._peer, self._heard, self._count = source, now, packet.number
        if begins:
            self.counts["restarts"] += 1
            if self.on_restart is not None:
                self.on_restart(self)
            self._begin()
        elif last is not None:
            if packet.number == last:
                self.counts["repeated"] += 1
                return self._answer
            if same:
                self.counts["lost"] += packet.number - last - 1
        self._step(packet)
        return self._answer

    def _step(self, packet: ServoPacket) -> None:
        """Advance the boat by one step with the commands of a packet."""
        sim, servos = self.simulation, self._servos
        self.widths = packet.widths
        within = [
            min(max(width, round(servos.low)), round(servos.high)) if width else 0
            for width in packet.widths
        ]
        if self.moored and servos.drives(within):
            self.moored = False
        sim.step(np.array([servos.command(within)]))
        if self.moored:
            self._hold()
        after = self._kinematics()
        self.motion = self._motion(self._before, after)
        self._before, self._answer = after, encode_motion(self.motion)
        self.counts["steps"] += 1
        if self.on_step is not None:
            self.on_step(self)

    def _hold(self) -> None:
        """Put the boat back to its mooring: it may go up and down, roll and pitch."""
        state = self.simulation.state[0]
        roll, pitch, yaw, u, v, w = state[[fr.PHI, fr.THETA, fr.PSI, fr.U, fr.V, fr.W]].tolist()
        down = fr.rotate(roll, pitch, yaw, u, v, w)[2]
        state[[fr.X, fr.Y, fr.PSI]] = self._place
        state[[fr.U, fr.V, fr.W]] = fr.unrotate(roll, pitch, self._place[2], 0.0, 0.0, down)
        state[fr.R] = 0.0

    def _kinematics(self) -> _Kinematics:
        """Return place, attitude, velocity over ground and rates of the present moment."""
        state = self.simulation.state[0]
        roll, pitch, yaw, u, v, w = state[[fr.PHI, fr.THETA, fr.PSI, fr.U, fr.V, fr.W]].tolist()
        return _Kinematics(
            tuple(state[[fr.X, fr.Y, fr.Z]].tolist()),
            (roll, pitch, yaw),
            fr.rotate(roll, pitch, yaw, u, v, w),
            tuple(state[[fr.P, fr.Q, fr.R]].tolist()),
        )

    def _motion(self, before: _Kinematics, after: _Kinematics) -> Motion:
        """Return the motion after a step; of rates and forces their mean over it, as an IMU does.

        The specific force is the change of the velocity over ground less gravity, in the axes of
        the middle of the step. So it agrees with the velocity, also at the mooring.
        """
        dt = self.simulation.dt
        north, east, down = (
            (b - a) / dt for a, b in zip(before.velocity, after.velocity, strict=True)
        )
        middle = _mean(before.attitude, after.attitude)
        roll, pitch, yaw = after.attitude
        return Motion(
            round(self.t, 6),
            _mean(before.rates, after.rates),
            fr.unrotate(*middle, north, east, down - GRAVITY),
            after.place,
            (roll, pitch, math.remainder(yaw, math.tau)),
            after.velocity,
        )


def _mean(a: _Triple, b: _Triple) -> _Triple:
    """Return the mean of two vectors."""
    return 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])
