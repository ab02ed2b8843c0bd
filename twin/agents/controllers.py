"""Classical controllers, for many boats at once: the baselines that a trained agent must beat.

Line-of-sight guidance steers to a point of the path some way ahead of the boat. A PD law turns the
boat to the course that leads there. The controllers differ in whom they ask where the boat is.

Source: Fossen 2021, Handbook of Marine Craft Hydrodynamics and Motion Control, section 12.3-12.4
(LOS and ILOS guidance), 15.3 (PD heading control).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.agents.agent import Agent, ControllerError, check_actions, shaft_speeds
from twin.agents.mpc import ModelPredictive
from usv_gym.envs.episodes import AGE_SCALE
from usv_gym.envs.scoring import ALONGSIDE, ERRORS, follow
from usv_gym.envs.vector import USVVectorEnv
from usv_gym.vessel.vessel import Vessel
from usv_kernel.jit import kernel

__all__ = [
    "BASES",
    "CONTROLLERS",
    "DOCKING",
    "LOS",
    "DeadReckoningLOS",
    "Docking",
    "make_controller",
]

Array = NDArray[np.float64]

NAMES = {
    "": ("yaw_rate", "speed_forward"),
    "twin_": ("twin_yaw_rate", "twin_surge"),
    "true_": ("true_yaw_rate", "true_surge"),
}
"""Yaw rate and surge of an observation, by the prefix of its entries."""

CROSS, TO_GO = 0, 1
COSINES = [2, 4]
SINES = [3, 5]
SPEED = 7
"""Columns of what a controller is given: path errors, angles (course error, next turn), speed."""

PATH = (
    *("cross_track", "to_go", "cos_course_error", "sin_course_error"),
    *("cos_next_turn", "sin_next_turn"),
)


class LOS:
    """Line-of-sight guidance with a PD heading loop.

    Lengths are in lengths of the boat and times in the time to sail a length, so that the same
    numbers serve every boat.

    Parameters
    ----------
    name : str
        For tables.
    observation : str
        The set that it needs.
    source : str
        How the entries that it goes by begin: ``""``, ``"twin_"`` or ``"true_"``.
    lookahead : float
        Distance to the point that it steers to, lengths.
    gain : float
        Part of full helm per rad of heading error.
    damping : float
        Part of full helm per rad that the boat turns while it sails a length.
    integral : float
        Part of the cross-track error that is taken up while a length is sailed (against current
        and leeway); 0 for none.
    early : float
        Part of a turn that is steered before its way point, as the point ahead goes round it.
    """

    def __init__(
        self,
        name: str = "los",
        observation: str = "raw",
        source: str = "",
        *,
        lookahead: float = 3.0,
        gain: float = 5.0,
        damping: float = 1.5,
        integral: float = 0.02,
        early: float = 1.0,
    ) -> None:
        check_numbers(name, above_zero=True, lookahead=lookahead)
        check_numbers(name, gain=gain, damping=damping, integral=integral, early=early)
        self.name, self.observation, self.source = name, observation, source
        self.lookahead, self.gain, self.damping = lookahead, gain, damping
        self.integral, self.early = integral, early
        self.entries = (*(source + name for name in PATH), *NAMES[source])

    def begin(self, envs: USVVectorEnv) -> None:
        """See :meth:`twin.agents.agent.Agent.begin`."""
        base = envs.unwrapped
        check_actions(self.name, base)
        self._places = places(base, self.entries)
        self.unit = float(base.task.rules["unit"])
        dt = base.simulation.dt * base.frame_skip
        self.fit(base.vessel, base.speed, dt, float(base.task.rules["reach"]), base.num_envs)

    def fit(self, vessel: Vessel, speed: float, dt: float, reach: float, n: int = 1) -> None:
        """Prepare for n boats without an environment; with one, :meth:`begin` does it.

        ``speed`` is nominal, m/s, ``dt`` the time between decisions, s. ``reach`` is the distance
        at which a way point counts as reached, m, 0 on a curve.
        """
        self.dt, self.speed, self.reach = dt, speed, reach
        self.length = vessel.values["length_waterline"]
        full, nominal = shaft_speeds(vessel)
        self.shaft = nominal / full
        self._drift = np.zeros(n)

    def forget(self, boats: NDArray[np.bool_]) -> None:
        """Forget what was remembered of some boats (n,), which begin an episode."""
        self._drift = np.where(boats, 0.0, self._drift)

    def act(self, obs: NDArray[np.float32]) -> Array:
        """See :meth:`twin.agents.agent.Agent.act`."""
        motion = obs[:, self._places].astype(float)
        motion[:, CROSS] *= self.unit
        motion[:, TO_GO] *= 10.0 * self.unit
        return self.steer(self._navigate(obs, motion))

    def _navigate(self, obs: NDArray[np.float32], motion: Array) -> Array:
        """Return cross-track and to-go (m), cosines and sines of both angles, and the motion."""
        return motion

    def steer(self, motion: Array) -> Array:
        """Return actions (n, 2) in [-1, 1] from how the boats stand to their legs.

        ``motion`` (n, 8): cross-track distance and distance to go (m), cosines and sines of course
        error and next turn. Yaw rate (rad/s) and forward speed (nominal speeds) follow.
        """
        e, to_go, _cos, _sin, _cos_turn, _sin_turn, r, u = motion.T
        # only at the end of the path: elsewhere the next leg has begun by then, and a curve has no
        # end
        near = (self.reach > 0.0) & (to_go < self.reach)
        left = np.divide(to_go, self.reach, where=near, out=np.ones_like(e))
        course = self._course(motion, near)
        ahead = self.lookahead * self.length * left
        aside = e + self._drift
        error = wrapped(course - np.arctan2(aside, ahead))
        step = self.integral * self.dt * self.speed * ahead / (ahead**2 + aside**2 + 1e-9)
        self._drift = np.where(near, 0.0, self._drift + step * e)
        # at its point the boat goes slowly ahead or astern, whichever is nearer, and not aside.
        # Astern the same angle of the drives turns it the other way
        back = np.where(near & (np.cos(error) < 0.0), -1.0, 1.0)
        error = np.where(back < 0.0, wrapped(error + math.pi), error)
        part = np.minimum(np.hypot(left, e / max(self.reach, 1e-9)), 1.0) * np.cos(error)
        part = np.where(near, part, 1.0)
        helm = back * self.gain * part * error - self.damping * self.length / self.speed * r
        wanted = 0.5 * back * part
        slow = wanted + 2.0 * (wanted - u)
        shaft = self.shaft * np.where(near, slow, 1.0)
        return np.clip(np.stack([shaft, helm], axis=1), -1.0, 1.0)

    def _course(self, motion: Array, ending: NDArray[np.bool_]) -> Array:
        """Return courses less headings (n,), rad; but for the last leg they go round early."""
        _e, to_go, cos, sin, cos_turn, sin_turn, _r, _u = motion.T
        # how far the point ahead lies on the next leg
        ahead = self.lookahead * self.length
        beyond = np.where(ending, 0.0, np.clip(1.0 - to_go / ahead, 0.0, 1.0))
        return np.arctan2(sin, cos) + self.early * beyond * np.arctan2(sin_turn, cos_turn)


class Docking(LOS):
    """Line of sight to a berth, slower and slower, with the shafts astern to stop.

    The speed over ground that it keeps is the nominal one, but within ``slow`` lengths of the berth
    in proportion to what is left. A boat that comes too far to the side, or beyond the berth, backs
    off along its leg and comes again.

    Parameters
    ----------
    name, observation, source
        As for :class:`LOS`, as are other options.
    slow : float
        Distance at which it begins to slow down, lengths.
    push : float
        Change of the shaft speed, in nominal ones, per nominal speed too slow.
    aside : float
        Distance to the side of the leg that is too far at the berth, lengths.
    back_off : float
        How far it backs off, lengths.
    fastest : float
        Speed that it keeps until then, nominal speeds.
    turning : float
        Least shaft speed, in nominal ones, with which a large heading error is steered: without
        thrust nothing turns the boat.
    """

    def __init__(
        self,
        name: str = "dock-twin",
        observation: str = "twin",
        source: str = "twin_",
        *,
        slow: float = 8.0,
        push: float = 3.0,
        aside: float = 0.45,
        back_off: float = 3.0,
        fastest: float = 0.4,
        turning: float = 0.3,
        **options: Any,
    ) -> None:
        own = {"lookahead": 3.0, "gain": 2.0, "damping": 1.0}
        super().__init__(name, observation, source, **{**own, **options})
        check_numbers(name, above_zero=True, slow=slow, push=push, aside=aside)
        check_numbers(name, above_zero=True, back_off=back_off, fastest=fastest, turning=turning)
        self.slow, self.push, self.aside = slow, push, aside
        self.back_off, self.fastest, self.turning = back_off, fastest, turning

    def fit(self, vessel: Vessel, speed: float, dt: float, reach: float, n: int = 1) -> None:
        """See :meth:`LOS.fit`."""
        super().fit(vessel, speed, dt, reach, n)
        self._backing = np.zeros(n, dtype=np.bool_)

    def forget(self, boats: NDArray[np.bool_]) -> None:
        """See :meth:`LOS.forget`."""
        super().forget(boats)
        self._backing = self._backing & ~boats

    def steer(self, motion: Array) -> Array:
        """See :meth:`LOS.steer`; a leg without a next turn is that of the berth."""
        e, to_go, _cos, _sin, cos_turn, sin_turn, r, u = motion.T
        L, last = self.length, (np.abs(sin_turn) < 1e-6) & (cos_turn > 0.0)
        left = np.where(last, to_go, to_go + self.slow * L)
        wide = np.abs(e) > self.aside * L + 0.5 * np.maximum(to_go, 0.0)
        self._backing = self._backing | last & ((wide & (to_go < L)) | (to_go < -0.3 * L))
        self._backing = self._backing & last & (to_go < self.back_off * L)
        back = self._backing
        wanted = np.where(back, -0.3, np.clip(left / (self.slow * L), -0.3, self.fastest))
        ahead, course = self.lookahead * L, self._course(motion, last)
        # astern the boat is turned the other way to come back to its leg
        offset = e + self._drift
        error = wrapped(course - np.where(back, -1.0, 1.0) * np.arctan2(offset, ahead))
        step = self.integral * self.dt * self.speed * ahead / (ahead**2 + offset**2)
        self._drift = self._drift + np.where(back, 0.0, step * e)
        part = np.minimum(np.abs(error) / ALONGSIDE, 1.0)
        least = np.where(back | (to_go < 0.3 * L), -np.inf, self.turning * part)
        shaft = self.shaft * np.maximum(wanted + self.push * (wanted - u), least)
        helm = self.gain * error - self.damping * L / self.speed * r
        # drives push the stern to the other side while they turn astern
        helm = np.where(shaft < 0.0, -helm, helm)
        return np.clip(np.stack([shaft, helm], axis=1), -1.0, 1.0)


class DeadReckoningLOS(LOS):
    """The same between and without fixes: compass, last known speed and time carry the boat on.

    Where a leg ends it knows from the way points, which are the boat's own. Known speeds are
    averaged over ``smoothing``, against waves, in times to sail a length; other options are those
    of :class:`LOS`.
    """

    def __init__(self, *, smoothing: float = 12.0, **options: Any) -> None:
        super().__init__("los-dr", **options)
        check_numbers("los-dr", above_zero=True, smoothing=smoothing)
        self.smoothing = smoothing

    def begin(self, envs: USVVectorEnv) -> None:
        """See :meth:`twin.agents.agent.Agent.begin`."""
        super().begin(envs)
        base = envs.unwrapped
        self._more = places(base, ("cos_heading", "sin_heading", "gps_age", "speed_starboard"))
        self._points, self._legs_at_fix = base.task.points, base.task.records["known_leg"]
        n = base.num_envs
        self._track = ReckonedTrack(np.zeros((n, 2)), np.zeros(n), np.zeros((n, len(ERRORS))))
        self._velocity = np.tile([self.speed, 0.0], (n, 1))

    def _navigate(self, obs: NDArray[np.float32], motion: Array) -> Array:
        cos, sin, age, sway = obs[:, self._more].astype(float).T
        age *= AGE_SCALE
        fresh = age < self.dt - 1e-6
        self._track.legs[fresh] = self._legs_at_fix[fresh]
        part = 1.0 - math.exp(-self.dt * self.speed / (self.smoothing * self.length))
        known = self.speed * np.stack([motion[:, SPEED], sway], axis=1)
        self._velocity[fresh] += part * (known - self._velocity)[fresh]
        forward, side = self._velocity.T
        step = np.stack([forward * cos - side * sin, forward * sin + side * cos], axis=1)
        step *= np.where(fresh, age, self.dt)[:, None]
        psi = np.arctan2(sin, cos)
        reckon(fresh, step, psi, motion, self._points, self.reach, self._track)
        motion[:, : TO_GO + 1] = self._track.errors[:, : TO_GO + 1]
        angles = self._track.errors[:, TO_GO + 1 :]
        motion[:, COSINES], motion[:, SINES] = np.cos(angles), np.sin(angles)
        return motion


class ReckonedTrack(NamedTuple):
    """Where n boats are by dead reckoning."""

    place: Array
    """Position (n, 2), m north and east."""
    legs: Array
    """Leg of the path (n,)."""
    errors: Array
    """Errors (n, 4); see :func:`usv_gym.envs.tasks.path_errors`."""


@kernel
def reckon(fresh, step, psi, motion, points, reach, track):
    """Advance the track by dead reckoning, in place, from the last fix where there is a new one.

    ``step`` (n, 2) is the way since that fix or the last call, m north and east. ``motion`` begins
    with cross-track and to-go of the fix, m; ``points`` (n, K, 2) are way points, m, counted as
    reached within ``reach``.
    """
    place, legs, errors = track.place, track.legs, track.errors
    for i in range(fresh.shape[0]):
        if fresh[i]:
            start, end = points[i, int(legs[i])], points[i, int(legs[i]) + 1]
            dx, dy = end[0] - start[0], end[1] - start[1]
            length = math.hypot(dx, dy)
            c, s = dx / length, dy / length
            place[i, 0] = end[0] - motion[i, TO_GO] * c - motion[i, CROSS] * s
            place[i, 1] = end[1] - motion[i, TO_GO] * s + motion[i, CROSS] * c
        place[i, 0] += step[i, 0]
        place[i, 1] += step[i, 1]
        leg = int(legs[i])
        legs[i] = follow(place[i, 0], place[i, 1], psi[i], points[i], leg, reach, errors[i])


def places(envs: USVVectorEnv, names: tuple[str, ...]) -> list[int]:
    """Return where entries stand in an observation; ControllerError names one that is missing."""
    there = list(envs.observation_names)
    missing = [name for name in names if name not in there]
    if missing:
        raise ControllerError(
            f"the observation has no entry {missing[0]!r}; make the environment with the set that "
            "the agent's attribute 'observation' names"
        )
    return [there.index(name) for name in names]


def check_numbers(controller: str, *, above_zero: bool = False, **numbers: float) -> None:
    """Refuse options that are not finite, below 0, or where it says so 0."""
    for name, value in numbers.items():
        if not (math.isfinite(value) and (value > 0.0 or (value == 0.0 and not above_zero))):
            bound = "above 0" if above_zero else "0 or more"
            raise ControllerError(f"{controller}: {name} = {value}: must be finite and {bound}")


def wrapped(angle: Array) -> Array:
    """Return angles within -pi ... pi, rad."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


BASES = ("los", "los-twin", "mpc-twin", "mpc-steady", "los-oracle", "dock-twin", "dock-oracle")
"""Names of those that a trained agent may correct: they forget boat by boat."""

_STEADY = {"effort": 3.0, "progress": 0.5}
"""Weights of model-predictive control that hardly changes its shafts: the twin knows a boat best at
the shaft speeds that it has seen, so that it drifts less without GPS."""

CONTROLLERS: dict[str, Callable[..., Agent]] = {
    "los": LOS,
    "los-dr": DeadReckoningLOS,
    "los-twin": lambda **options: LOS("los-twin", "twin", "twin_", **options),
    "mpc-twin": ModelPredictive,
    "mpc-steady": lambda **options: ModelPredictive("mpc-steady", **_STEADY | options),
    "los-oracle": lambda **options: LOS("los-oracle", "oracle", "true_", **options),
}
"""Controllers of paths by name; each call gives a new one."""

DOCKING: dict[str, Callable[..., Agent]] = {
    "dock-twin": Docking,
    "dock-oracle": lambda **options: Docking("dock-oracle", "oracle", "true_", **options),
}
"""Those of the task ``docking``."""


def make_controller(name: str, **options: Any) -> Agent:
    """Return a controller by its name.

    Parameters
    ----------
    name : str
        One of :data:`CONTROLLERS` or :data:`DOCKING`.
    **options
        Those of its class, such as ``lookahead`` of :class:`LOS`.

    Raises
    ------
    ControllerError
        Lists the names, or the options, that there are.
    """
    known = CONTROLLERS | DOCKING
    if name not in known:
        raise ControllerError(f"no controller is called {name!r}; known: {', '.join(known)}")
    try:
        return known[name](**options)
    except TypeError as error:
        raise ControllerError(f"{name}: {error}") from None
