"""Standard manoeuvring trials, simulated in calm water.

Each returns a :class:`~usv_gym.manoeuvring.indices.Track` that begins with the order, at full speed
along x, with the ordered helm angle. The helm is a generator: it gets the true state and yields
the next angle, so that a trial reads like its instructions.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from usv_gym.manoeuvring import indices
from usv_gym.manoeuvring.indices import Track, Turning, Zigzag
from usv_gym.physics import frames as fr
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.sea import SeaState
from usv_gym.world.sensors import SensorSuite
from usv_gym.world.simulation import Simulation
from usv_kernel.errors import UsvTwinError

__all__ = [
    "StandardTrials",
    "TrialError",
    "standard_trials",
    "turning_circle",
    "zigzag",
]

HelmProgram = Generator[float, np.ndarray, None]

LIMIT = 200.0
"""Duration after which a trial fails, in times to sail a length at the approach speed."""


class TrialError(UsvTwinError):
    """A trial that is impossible for a vessel; the message says why."""


def turning_circle(
    vessel: Vessel,
    *,
    angle: float,
    n: float,
    speed: float | None = None,
    dof: int = 3,
    dt: float | None = None,
) -> Track:
    """Simulate a turning circle up to a change of heading of 720 degrees.

    ``angle`` is that of the helm, rad, positive to starboard, ``n`` the constant shaft speed,
    rev/s. ``speed`` is that of the approach, m/s, by default :meth:`Vessel.straight_speed`; ``dof``
    is 3 or 6. ``dt`` is by default the time to sail 1/200 of a length. It is at most 0.05 s for a
    length of 7 m, scaled with its square root. TrialError: impossible arguments, and a trial that
    does not end.
    """
    trial = _Trial(vessel, n, speed, dof, dt)
    return trial.sail({"turning circle": _turn(trial.checked_angle(angle))})[0]


def zigzag(
    vessel: Vessel,
    *,
    switch: float,
    helm: float,
    n: float,
    speed: float | None = None,
    overshoots: int = 4,
    dof: int = 3,
    dt: float | None = None,
) -> Track:
    """Simulate a zigzag; options as for :func:`turning_circle`.

    The helm (rad, with the sign of the first order) is reversed at each change of heading of
    ``switch`` (rad).
    """
    trial = _Trial(vessel, n, speed, dof, dt)
    if not (switch > 0.0 and overshoots >= 1):
        raise TrialError(
            f"switch = {switch:g} rad must be above 0 and overshoots = {overshoots} at least 1"
        )
    program = _zigzag(switch, trial.checked_angle(helm), overshoots)
    return trial.sail({"zigzag": program})[0]


@dataclass(frozen=True, kw_only=True)
class StandardTrials:
    """Standard trials to both sides, starboard first: their indices and tracks."""

    length: float
    """Ship length, m."""
    speed: float
    """Speed of the approach, m/s."""
    angle: float
    """Helm angle of the turning circles, rad."""
    turning: tuple[Turning, ...]
    """Turning circles."""
    zigzag_10: tuple[Zigzag, ...]
    """10/10 zigzags."""
    zigzag_20: tuple[Zigzag, ...]
    """20/20 zigzags."""
    tracks: dict[str, Track]
    """Tracks by name, such as ``10/10 zigzag to port``."""


def standard_trials(
    vessel: Vessel,
    n: float,
    *,
    speed: float | None = None,
    dof: int = 3,
    dt: float | None = None,
) -> StandardTrials:
    """Simulate turning circles, 10/10 and 20/20 zigzags to both sides at once.

    Options as for :func:`turning_circle`. Circles use 35 degrees of helm or the largest possible.
    """
    trial = _Trial(vessel, n, speed, dof, dt)
    angle = min(math.radians(35.0), trial.largest)
    ten, twenty = (trial.checked_angle(math.radians(degrees)) for degrees in (10.0, 20.0))
    programs: dict[str, HelmProgram] = {}
    for side, sign in (("starboard", 1.0), ("port", -1.0)):
        programs[f"turning circle to {side}"] = _turn(sign * angle)
        programs[f"10/10 zigzag to {side}"] = _zigzag(ten, sign * ten, 2)
        programs[f"20/20 zigzag to {side}"] = _zigzag(twenty, sign * twenty, 2)
    tracks = dict(zip(programs, trial.sail(programs), strict=True))
    runs, length = list(tracks.values()), trial.length

    def zigzags(which: int, switch: float) -> tuple[Zigzag, ...]:
        return tuple(
            indices.zigzag(run, length=length, switch=switch, origin=0.0) for run in runs[which::3]
        )

    return StandardTrials(
        length=length,
        speed=trial.speed,
        angle=angle,
        turning=tuple(indices.turning(run, length=length, origin=0.0) for run in runs[::3]),
        zigzag_10=zigzags(1, ten),
        zigzag_20=zigzags(2, twenty),
        tracks=tracks,
    )


class _Trial:
    """A vessel on its approach in calm water, with the time step of the trial."""

    def __init__(
        self, vessel: Vessel, n: float, speed: float | None, dof: int, dt: float | None
    ) -> None:
        for name, value in (("n", n), ("speed", speed), ("dt", dt)):
            if value is None and name != "n":
                continue
            number = isinstance(value, (int, float, np.number)) and math.isfinite(value)
            if not (number and value > 0.0):  # type: ignore[operator]
                raise TrialError(f"{name} = {value!r}: must be a finite number above 0")
        self.vessel, self.n = vessel, n
        self.speed = vessel.straight_speed(n) if speed is None else speed
        self.length = vessel.values["length_waterline"]
        self.largest = vessel.helm_max
        # orders are late by up to a step
        step = min(0.005 * self.length / self.speed, 0.05 * math.sqrt(self.length / 7.0))
        self.dt = step if dt is None else dt
        self.dof = dof

    def checked_angle(self, angle: float) -> float:
        """Return a helm angle; :class:`TrialError` if the helm does not reach it."""
        number = isinstance(angle, (int, float, np.number))
        if not (number and 0.0 < abs(angle) <= self.largest * (1.0 + 1e-9)):
            shown = f"{math.degrees(angle):.3g} degrees" if number else repr(angle)
            raise TrialError(
                f"a trial with a helm angle of {shown}: {self.vessel.name} needs one above 0 and "
                f"at most {math.degrees(self.largest):.3g} degrees"
            )
        return angle

    def sail(self, programs: dict[str, HelmProgram]) -> list[Track]:
        """Return the tracks of boats simulated at once, each until its helm program ends."""
        boats = len(programs)
        simulation = Simulation(
            boats,
            self.vessel,
            SeaState.named("calm"),
            suite=SensorSuite.perfect(),
            dt=self.dt,
            dt_physics=self.dt,
            dof=self.dof,
        )
        simulation.reset(range(boats), [np.random.default_rng(0) for _ in range(boats)])
        state = simulation.state
        state[:, fr.U] = self.speed
        state[:, [fr.N_LEFT, fr.N_RIGHT]] = self.n
        angles = np.array([next(program) for program in programs.values()])
        states, orders = [state.copy()], [np.zeros(boats)]
        cmd = self.vessel.command(self.n, angles)
        ends, active = [0] * boats, dict(enumerate(programs.values()))
        while active:
            if len(states) * self.dt * self.speed > LIMIT * self.length:
                raise TrialError(
                    f"{self.vessel.name}: {list(programs)[next(iter(active))]}: not done in the "
                    f"time to sail {LIMIT:g} lengths ({len(states) * self.dt:.0f} s)"
                )
            simulation.step(cmd)
            states.append(state.copy())
            orders.append(angles.copy())
            for i, program in list(active.items()):
                angle = _next_angle(program, state[i])
                if angle is None:
                    ends[i] = len(states)
                    del active[i]
                elif angle != angles[i]:
                    angles[i] = angle
                    cmd[i] = self.vessel.command(self.n, angle)
        all_states, all_orders = np.array(states), np.array(orders)
        columns = {"x": fr.X, "y": fr.Y, "psi": fr.PSI, "u": fr.U, "v": fr.V, "r": fr.R}
        return [
            Track(
                t=self.dt * np.arange(end),
                delta=all_orders[:end, i],
                **{name: all_states[:end, i, k] for name, k in columns.items()},
            )
            for i, end in enumerate(ends)
        ]


def _next_angle(program: HelmProgram, state: np.ndarray) -> float | None:
    """Return the next helm angle of a program, None at its end."""
    try:
        return program.send(state)
    except StopIteration:
        return None


def _turn(angle: float) -> HelmProgram:
    state = yield angle
    while abs(state[fr.PSI]) < 4.0 * math.pi:
        state = yield angle


def _zigzag(switch: float, helm: float, overshoots: int) -> HelmProgram:
    side, angle = math.copysign(1.0, helm), helm
    state = yield angle
    for _ in range(overshoots):
        while side * state[fr.PSI] < switch:
            state = yield angle
        side, angle = -side, -angle
    # the last overshoot is over when the heading is 0 again
    while side * state[fr.PSI] < 0.0:
        state = yield angle
