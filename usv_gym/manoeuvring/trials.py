"""Standard manoeuvring trials, sailed in calm water.

Each returns a :class:`usv_gym.manoeuvring.indices.Track` that begins with the order, at full speed, straight
ahead along x; its helm angle is the one that was ordered. The helmsman sees the true state; what
he does is a generator that is sent the state and yields the helm angle, so that each trial reads
as its instructions do.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass

import numpy as np

from usv_gym.manoeuvring import indices
from usv_gym.manoeuvring.indices import Criterion, Track, Turning, Zigzag
from usv_gym.physics import frames as fr
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.sea import SeaState
from usv_gym.world.sensors import SensorSuite
from usv_gym.world.simulation import Simulation
from usv_kernel.errors import UsvTwinError

__all__ = [
    "StandardTrials",
    "TrialError",
    "pull_out",
    "random_steps",
    "spiral",
    "standard_trials",
    "stopping",
    "turning_circle",
    "zigzag",
]

Helmsman = Generator[float, np.ndarray, None]

LIMIT = 200.0
"""Time after which a trial is given up, in the time to sail a length at the approach speed."""

WINDOW, STEADY = 5.0, 2e-4
"""A turn is steady when r L / U changes by less than STEADY in the time to sail WINDOW lengths."""

SPIRAL = tuple(math.radians(angle) for angle in (20, 15, 10, 7, 5, 4, 3, 2, 1))
"""Helm angles of the spiral on either side, rad."""


class TrialError(UsvTwinError):
    """A trial that this vessel cannot sail; the message says which and why."""


def turning_circle(
    vessel: Vessel,
    *,
    angle: float,
    n: float,
    speed: float | None = None,
    dof: int = 3,
    dt: float | None = None,
) -> Track:
    """Sail a turning circle, to a change of heading of 720 degrees.

    Parameters
    ----------
    vessel : Vessel
        The ship.
    angle : float
        Helm angle, rad; positive turns to starboard.
    n : float
        Shaft speed, rev/s; held.
    speed : float, optional
        Speed of the approach, m/s; by default what the shafts give.
    dof : int
        Degrees of freedom of the ship, 3 or 6.
    dt : float, optional
        Time step, s; by default the time to sail 1/200 of a length, but no more than 0.05 s for
        7 m of length and growing with its square root.

    Returns
    -------
    Track
    """
    sea_trial = _Trial(vessel, n, speed, dof, dt)
    return sea_trial.sail({"turning circle": _turn(sea_trial.within_stops(angle))})[0]


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
    """Sail a zigzag.

    Parameters
    ----------
    vessel, n, speed, dof, dt
        See :func:`turning_circle`.
    switch : float
        Change of heading at which the helm is reversed, rad.
    helm : float
        Helm angle, rad; its sign is that of the first order.
    overshoots : int
        After how many the trial ends.

    Returns
    -------
    Track
    """
    sea_trial = _Trial(vessel, n, speed, dof, dt)
    if not (switch > 0.0 and overshoots >= 1):
        raise TrialError(
            f"switch = {switch:g} rad must be above 0 and overshoots = {overshoots} at least 1"
        )
    helmsman = _zigzag(switch, sea_trial.within_stops(helm), overshoots)
    return sea_trial.sail({"zigzag": helmsman})[0]


def pull_out(
    vessel: Vessel,
    *,
    angle: float,
    n: float,
    speed: float | None = None,
    dof: int = 3,
    dt: float | None = None,
) -> tuple[Track, Track]:
    """Sail a turn to either side, put the helm back after 360 degrees, wait for a steady rate.

    Parameters
    ----------
    vessel, angle, n, speed, dof, dt
        See :func:`turning_circle`.

    Returns
    -------
    tuple of Track
        Out of the turn to starboard, and to port.
    """
    sea_trial = _Trial(vessel, n, speed, dof, dt)
    angle = abs(sea_trial.within_stops(angle))
    helmsmen = {
        f"pull-out from {side}": _pull_out(sign * angle, sea_trial)
        for side, sign in (("starboard", 1.0), ("port", -1.0))
    }
    starboard, port = sea_trial.sail(helmsmen)
    return starboard, port


def spiral(
    vessel: Vessel,
    *,
    n: float,
    angles: Sequence[float] = SPIRAL,
    speed: float | None = None,
    dof: int = 3,
    dt: float | None = None,
) -> Track:
    """Sail Dieudonne's direct spiral: helm from starboard to port and back, each until steady.

    Parameters
    ----------
    vessel, n, speed, dof, dt
        See :func:`turning_circle`.
    angles : sequence of float
        Helm angles of one side, rad, falling; mirrored for the other, with 0 between.

    Returns
    -------
    Track
    """
    sea_trial = _Trial(vessel, n, speed, dof, dt)
    down = [*(sea_trial.within_stops(angle) for angle in angles), 0.0, *(-a for a in angles[::-1])]
    helmsman = _hold([*down, *down[-2::-1]], sea_trial)
    return sea_trial.sail({"spiral": helmsman}, limit=LIMIT + 100.0 * len(down))[0]


def stopping(
    vessel: Vessel,
    *,
    n: float,
    astern: float | None = None,
    speed: float | None = None,
    dof: int = 3,
    dt: float | None = None,
) -> Track:
    """Sail a stopping trial: shafts astern, helm amidships, until there is no way on.

    Parameters
    ----------
    vessel, n, speed, dof, dt
        See :func:`turning_circle`; n is the shaft speed of the approach.
    astern : float, optional
        Shaft speed astern, rev/s, above 0; by default that of the approach.

    Returns
    -------
    Track
    """
    sea_trial = _Trial(vessel, n, speed, dof, dt)
    astern = n if astern is None else astern
    if not astern > 0.0:
        raise TrialError(f"astern = {astern:g} rev/s must be above 0")
    return sea_trial.sail({"stopping": _stop()}, order=-astern)[0]


def random_steps(
    vessel: Vessel,
    rng: np.random.Generator,
    *,
    n: float,
    largest: float,
    steps: int = 20,
    speed: float | None = None,
    dof: int = 3,
    dt: float | None = None,
) -> Track:
    """Sail random steps of the helm: a rich record to identify a ship from.

    Parameters
    ----------
    vessel, n, speed, dof, dt
        See :func:`turning_circle`.
    rng : numpy.random.Generator
        Draws angles and how long each is held, the time to sail 2 to 8 lengths.
    largest : float
        Largest helm angle, rad.
    steps : int
        How many.

    Returns
    -------
    Track
    """
    sea_trial = _Trial(vessel, n, speed, dof, dt)
    if steps < 1:
        raise TrialError(f"steps = {steps} must be at least 1")
    largest = sea_trial.within_stops(largest)
    angles = rng.uniform(-largest, largest, steps)
    unit = sea_trial.length / (sea_trial.speed * sea_trial.dt)
    counts = np.ceil(rng.uniform(2.0, 8.0, steps) * unit).astype(int)
    return sea_trial.sail({"random steps": _follow(np.repeat(angles, counts))}, limit=9.0 * steps)[
        0
    ]


@dataclass(frozen=True, kw_only=True)
class StandardTrials:
    """Indices of the standard trials to both sides, starboard first, and their tracks."""

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
    """The runs by name, such as ``10/10 zigzag to port``."""

    @property
    def criteria(self) -> list[Criterion]:
        """What IMO asks of them, see :func:`usv_gym.manoeuvring.indices.imo`."""
        return indices.imo(
            length=self.length,
            speed=self.speed,
            turning=self.turning,
            zigzag_10=self.zigzag_10,
            zigzag_20=self.zigzag_20,
        )


def standard_trials(
    vessel: Vessel,
    n: float,
    *,
    speed: float | None = None,
    dof: int = 3,
    dt: float | None = None,
) -> StandardTrials:
    """Sail turning circles, 10/10 and 20/20 zigzags to both sides, all at once.

    Parameters
    ----------
    vessel, n, speed, dof, dt
        See :func:`turning_circle`. Circles are at 35 degrees of helm, or as far as it goes.

    Returns
    -------
    StandardTrials
    """
    sea_trial = _Trial(vessel, n, speed, dof, dt)
    angle = min(math.radians(35.0), sea_trial.largest)
    ten, twenty = (sea_trial.within_stops(math.radians(degrees)) for degrees in (10.0, 20.0))
    helmsmen: dict[str, Helmsman] = {}
    for side, sign in (("starboard", 1.0), ("port", -1.0)):
        helmsmen[f"turning circle to {side}"] = _turn(sign * angle)
        helmsmen[f"10/10 zigzag to {side}"] = _zigzag(ten, sign * ten, 2)
        helmsmen[f"20/20 zigzag to {side}"] = _zigzag(twenty, sign * twenty, 2)
    tracks = dict(zip(helmsmen, sea_trial.sail(helmsmen), strict=True))
    runs, length = list(tracks.values()), sea_trial.length

    def zigzags(which: int, switch: float) -> tuple[Zigzag, ...]:
        return tuple(
            indices.zigzag(run, length=length, switch=switch, origin=0.0) for run in runs[which::3]
        )

    return StandardTrials(
        length=length,
        speed=sea_trial.speed,
        angle=angle,
        turning=tuple(indices.turning(run, length=length, origin=0.0) for run in runs[::3]),
        zigzag_10=zigzags(1, ten),
        zigzag_20=zigzags(2, twenty),
        tracks=tracks,
    )


class _Trial:
    """Calm water, a ship at speed, and what every trial needs to know of both."""

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
        # orders are late by up to a step, and a step must be short beside every period
        step = min(0.005 * self.length / self.speed, 0.05 * math.sqrt(self.length / 7.0))
        self.dt = step if dt is None else dt
        self.dof = dof

    def within_stops(self, angle: float) -> float:
        """Return a helm angle after a look at whether the helm goes so far."""
        number = isinstance(angle, (int, float, np.number))
        if not (number and 0.0 < abs(angle) <= self.largest * (1.0 + 1e-9)):
            shown = f"{math.degrees(angle):.3g} degrees" if number else repr(angle)
            raise TrialError(
                f"a trial with a helm angle of {shown}: {self.vessel.name} must be given one above "
                f"0 and within the {math.degrees(self.largest):.3g} degrees that its helm goes to"
            )
        return angle

    def sail(
        self, helmsmen: dict[str, Helmsman], order: float | None = None, limit: float = LIMIT
    ) -> list[Track]:
        """Return the tracks of boats that sail at once, each until its helmsman is done.

        Parameters
        ----------
        helmsmen : dict of str to generator
            By the name of the trial.
        order : float, optional
            Shaft speed that is ordered, rev/s; by default that of the approach.
        limit : float
            Time after which it is an error, in the time to sail a length.
        """
        boats, order = len(helmsmen), self.n if order is None else order
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
        angles = np.array([next(man) for man in helmsmen.values()])
        states, orders = [state.copy()], [np.zeros(boats)]
        cmd = self.vessel.command(order, angles)
        ends, sailing = [0] * boats, dict(enumerate(helmsmen.values()))
        while sailing:
            if len(states) * self.dt * self.speed > limit * self.length:
                raise TrialError(
                    f"{self.vessel.name}: {list(helmsmen)[next(iter(sailing))]}: not done in the "
                    f"time to sail {limit:g} lengths ({len(states) * self.dt:.0f} s)"
                )
            simulation.step(cmd)
            states.append(state.copy())
            orders.append(angles.copy())
            for i, man in list(sailing.items()):
                angle = _ask(man, state[i])
                if angle is None:
                    ends[i] = len(states)
                    del sailing[i]
                elif angle != angles[i]:
                    angles[i] = angle
                    cmd[i] = self.vessel.command(order, angle)
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


def _ask(helmsman: Helmsman, state: np.ndarray) -> float | None:
    """Return the next order of a helmsman, None when he is done."""
    try:
        return helmsman.send(state)
    except StopIteration:
        return None


# ------------------------------------------------- what the helmsmen do
def _turn(angle: float) -> Helmsman:
    state = yield angle
    while abs(state[fr.PSI]) < 4.0 * math.pi:
        state = yield angle


def _zigzag(switch: float, helm: float, overshoots: int) -> Helmsman:
    side, angle = math.copysign(1.0, helm), helm
    state = yield angle
    for _ in range(overshoots):
        while side * state[fr.PSI] < switch:
            state = yield angle
        side, angle = -side, -angle
    # the last overshoot has been seen when the heading is amidships again
    while side * state[fr.PSI] < 0.0:
        state = yield angle


def _pull_out(angle: float, sea_trial: _Trial) -> Helmsman:
    state = yield angle
    while abs(state[fr.PSI]) < 2.0 * math.pi:
        state = yield angle
    yield from _hold([0.0], sea_trial)


def _hold(angles: Sequence[float], sea_trial: _Trial) -> Helmsman:
    """Hold each angle until the rate of turn stays: see :data:`STEADY`."""
    seconds = sea_trial.length / sea_trial.speed
    window = math.ceil(WINDOW * seconds / sea_trial.dt)
    for angle in angles:
        before = rate = math.nan
        while not abs(rate - before) * seconds < STEADY:
            before = rate
            for _ in range(window):
                state = yield angle
            rate = float(state[fr.R])


def _stop() -> Helmsman:
    state = yield 0.0
    while state[fr.U] > 0.0:
        state = yield 0.0


def _follow(angles: np.ndarray) -> Helmsman:
    for angle in angles:
        yield float(angle)
