"""n episodes at once: boats, their tasks, and what their agents see. Behind every environment."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usv_gym.envs.tasks import (
    ERRORS,
    KNOWN_LEG,
    REACH,
    SPEED,
    TERM,
    TERMINATED,
    UNIT,
    follow,
    judge,
    make_task,
)
from usv_gym.physics import GRAVITY
from usv_gym.vessel.vessel import Vessel
from usv_gym.world import sensors
from usv_gym.world.sea import SeaState, choice
from usv_gym.world.sensors import Disturbance, FaultError, SensorSuite
from usv_gym.world.simulation import BIAS, CMD, COUNT, STEP, Simulation, Z, advance, out_of_noise
from usv_kernel.jit import kernel
from usv_kernel.scalar import sincos

__all__ = [
    "BOUND",
    "OBSERVATION",
    "Episodes",
    "Observer",
]

OBSERVATION = (
    *("cos_heading", "sin_heading", "yaw_rate", "accel_forward", "accel_starboard"),
    *("speed_forward", "speed_starboard"),
    *("gps_valid", "compass_valid", "imu_valid", "gps_age", "compass_age", "imu_age"),
    *("shaft_left", "shaft_right", "drive_left", "drive_right"),
    *("cross_track", "to_go", "cos_course_error", "sin_course_error"),
    *("cos_next_turn", "sin_next_turn"),
)
"""Names of the entries of the observation; scales in :class:`usv_gym.envs.env.USVEnv`."""

BOUND = 10.0
"""Largest size of an entry of an observation; what is larger is cut off."""

AGE_SCALE = 10.0

FAULT_START = (10.0, 60.0)
"""A fault given by its name begins at random between these times, s."""

# one row of numbers per boat: the last samples, their ages, task errors as known on board, and how
# many steps the boat lets pass, because it has just been reset or its episode is over
HELD = 0

AGE = HELD + len(sensors.CHANNELS)

KNOWN_ERROR = AGE + 3

RESTS = KNOWN_ERROR + len(ERRORS)

RECORD_SIZE = RESTS + 1

# rules of the task are followed by the steps of a decision and what turns actions into commands
FRAMES = 5

SCALE = FRAMES + 1

MIXING = SCALE + 4

DONE, NOT_FINITE, NO_NOISE = 0, 1, 2
"""What a step may say."""

_ALL = slice(None)


@kernel
def observe(
    boat: np.ndarray,
    task: np.ndarray,
    points: np.ndarray,
    rules: np.ndarray,
    dt: float,
    seen: np.ndarray,
    o: np.ndarray,
) -> None:
    """Hold the last sample of each sensor of one boat, and write the observation from it."""
    z, held = boat[Z:BIAS], seen[HELD:AGE]
    age, errors = seen[AGE:KNOWN_ERROR], seen[KNOWN_ERROR:RESTS]
    for j in range(3):
        age[j] += dt
    if math.isfinite(z[0]):
        age[0] = 0.0
        for j in range(4):
            held[j] = z[j]
    if math.isfinite(z[4]):
        age[1] = 0.0
        held[4] = z[4]
    if math.isfinite(z[5]):
        age[2] = 0.0
        for j in range(5, 8):
            held[j] = z[j]
    leg = int(task[KNOWN_LEG])
    leg = follow(held[0], held[1], held[4], points, leg, rules[REACH], errors)
    task[KNOWN_LEG] = leg
    speed = rules[SPEED]
    # new since the last decision, and there was one at all
    fresh = (min(rules[FRAMES] - 1.0, boat[COUNT]) + 0.5) * dt
    s, c = sincos(held[4])
    o[0], o[1], o[2] = c, s, held[5]
    o[3], o[4] = held[6] / GRAVITY, held[7] / GRAVITY
    o[5] = (held[2] * c + held[3] * s) / speed
    o[6] = (held[3] * c - held[2] * s) / speed
    for j in range(3):
        o[7 + j] = 1.0 if age[j] < fresh else 0.0
        o[10 + j] = age[j] / AGE_SCALE
    for j in range(4):
        o[13 + j] = boat[CMD + j] / rules[SCALE + j]
    o[17] = errors[0] / rules[UNIT]
    o[18] = 0.1 * errors[1] / rules[UNIT]
    o[20], o[19] = sincos(errors[2])
    o[22], o[21] = sincos(errors[3])
    for j in range(len(OBSERVATION)):  # more may follow
        o[j] = min(max(o[j], -BOUND), BOUND)


@kernel
def _step(
    boats: np.ndarray,
    layout: np.ndarray,
    constants: np.ndarray,
    factors: np.ndarray,
    tasks: np.ndarray,
    points: np.ndarray,
    rules: np.ndarray,
    seen: np.ndarray,
    actions: np.ndarray,
    obs: np.ndarray,
    left: int,
) -> int:
    """Take one step of every boat, but those that rest; unless it says DONE, nothing was done.

    ``actions`` (2, n, A) holds the action of the last step, and this one; ``left`` says how many
    steps of this decision follow.
    """
    first = left + 1 == int(rules[FRAMES])
    width = actions.shape[2]
    for i in range(boats.shape[0]):
        for j in range(width):
            if not math.isfinite(actions[1, i, j]) and seen[i, RESTS] == 0.0:
                return NOT_FINITE
    if out_of_noise(boats):
        return NO_NOISE
    for i in range(boats.shape[0]):
        if seen[i, RESTS] > 0.0:
            seen[i, RESTS] -= 1.0
            continue
        before, action = actions[0, i], actions[1, i]
        for j in range(width):
            action[j] = min(max(action[j], -1.0), 1.0)
        for j in range(4):
            share = 0.0
            for k in range(width):
                share += rules[MIXING + j * width + k] * action[k]
            boats[i, CMD + j] = rules[SCALE + j] * min(max(share, -1.0), 1.0)
        advance(boats[i], layout, constants, factors)
        if first:
            for j in range(TERM, TERMINATED):
                tasks[i, j] = 0.0
        judge(boats[i, :CMD], action, before, points[i], rules, tasks[i])
        observe(boats[i], tasks[i], points[i], rules, constants[STEP], seen[i], obs[i])
        for j in range(width):
            before[j] = action[j]
        if tasks[i, TERMINATED] != 0.0:
            seen[i, RESTS] = left
    return DONE


class Observer(ABC):
    """Adds entries to the observations of n boats, behind :data:`OBSERVATION`.

    Attributes
    ----------
    names : tuple of str
        What it adds.
    """

    names: tuple[str, ...]

    @abstractmethod
    def reset(self, i: int) -> None:
        """Let boat i begin an episode."""

    @abstractmethod
    def observe(self, obs: NDArray[np.float32], look: bool = True, rows: slice = _ALL) -> None:
        """See a step of the boats that did not rest, and write their entries.

        Parameters
        ----------
        obs : ndarray, shape (n, D)
            Observations of all boats; the first entries are those of the sensors.
        look : bool
            Write at all: False for the steps of a decision but the last.
        rows : slice
            The boats to look at.
        """

    def infos(self) -> dict[str, np.ndarray]:
        """Return what infos gain, arrays (n,)."""
        return {}


class Episodes:
    """n boats of one kind, each in an episode of its own.

    Parameters
    ----------
    n : int
        Number of boats.
    threads : int
        Threads that share the boats; the results do not hang on it.
    vessel, sea, hs, wind, wind_from_deg, suite, faults, task, actions, frame_skip, dof, dt, \
    dt_physics
        See :class:`usv_gym.envs.env.USVEnv`.

    Attributes
    ----------
    simulation : Simulation
        The world.
    task : Task
        What is asked of the boats.
    speed : float
        Usual speed, m/s.
    width : int
        Numbers in an action.
    watchers : list of callable
        Called after each step with the observations, and whether it is the last of a decision.
    """

    def __init__(
        self,
        n: int,
        *,
        threads: int = 1,
        vessel: str | Path | Vessel = "usv75",
        sea: str | SeaState | Sequence[str | SeaState] = "2",
        hs: float | None = None,
        wind: float | None = None,
        wind_from_deg: float | None = None,
        suite: SensorSuite | str | None = None,
        faults: str | Sequence[Disturbance] = "none",
        task: str = "path",
        actions: str = "common",
        frame_skip: int = 1,
        dof: int = 3,
        dt: float = 0.05,
        dt_physics: float = 0.05,
    ) -> None:
        if actions not in ("common", "units"):
            raise ValueError(f"actions = {actions!r}; use 'common' or 'units'")
        for name, count in (("num_threads", threads), ("frame_skip", frame_skip)):
            if isinstance(count, bool) or not (isinstance(count, (int, np.integer)) and count >= 1):
                raise ValueError(f"{name} = {count!r}: must be a whole number, 1 or more")
        self.vessel = Vessel.load(vessel)
        if wind_from_deg is not None and not isinstance(wind_from_deg, (int, float, np.number)):
            raise ValueError(f"wind_from_deg = {wind_from_deg!r}: must be a number of degrees")
        wind_from = None if wind_from_deg is None else math.radians(wind_from_deg % 360.0)
        self.seas = tuple(
            state.replace(hs=hs, wind=wind, wind_from=wind_from) for state in SeaState.any_of(sea)
        )
        given, most = _faults(faults, dt)
        self.simulation = Simulation(
            n,
            self.vessel,
            self.seas,
            suite=suite,
            faults=given,
            max_faults=most,
            dof=dof,
            dt=dt,
            dt_physics=dt_physics,
        )
        limits = self.vessel.values
        self.n, self.frame_skip = n, int(frame_skip)
        self._countdown = tuple(reversed(range(self.frame_skip)))
        self.watchers: list[Callable[[NDArray[np.float32], bool], None]] = []
        self.speed = self.vessel.straight_speed(limits["shaft_speed_manoeuvring"])
        self.task = make_task(task, n, self.speed, limits["length_waterline"])
        n_max, delta_max = limits["shaft_speed_service"], self.vessel.helm_max
        self._scale = np.array([n_max, n_max, delta_max, delta_max])
        mixing = self.vessel.mixing if actions == "common" else self.vessel.actuators
        self.width = mixing.shape[1]
        n_usual = limits["shaft_speed_manoeuvring"]
        self.usual_action = np.linalg.pinv(mixing) @ (
            np.array([n_usual, n_usual, 0.0, 0.0]) / self._scale
        )
        """The action that holds the usual speed, straight ahead; episodes begin with it."""
        self.actions = np.zeros((2, n, self.width))
        """Those of the last step, and of this one."""
        self.seen = np.zeros((n, RECORD_SIZE))
        boats, layout, constants, factors = self.simulation.arguments
        self.rules = np.concatenate(
            [self.task.rules, [self.frame_skip], self._scale, mixing.ravel()]
        )
        parts = np.array_split(np.arange(n), min(threads, n))
        self.blocks = [slice(int(part[0]), int(part[-1]) + 1) for part in parts]
        """The boats of each thread."""
        self._arguments: list[tuple[Any, ...]] = [
            (
                *(boats[rows], layout, constants, factors.copy()),
                *(self.task.records[rows], self.task.points[rows], self.rules),
                *(self.seen[rows], self.actions[:, rows]),
            )
            for rows in self.blocks
        ]
        self._pool = ThreadPoolExecutor(len(self.blocks)) if len(self.blocks) > 1 else None

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Refuse to be copied: a copy's arrays would no longer be those that kernels write to."""
        raise TypeError(
            "an environment of usv_gym cannot be copied or pickled; make another one, and reset it "
            "with the same seed"
        )

    def close(self) -> None:
        """End the threads."""
        if self._pool:
            self._pool.shutdown()

    def reset(self, i: int, rng: np.random.Generator, obs: np.ndarray) -> None:
        """Put one boat to the start of an episode.

        Parameters
        ----------
        i : int
            Which boat.
        rng : numpy.random.Generator
            Its generator.
        obs : ndarray, shape (23,)
            Its first observation is written there.
        """
        for_world, for_task = rng.spawn(2)
        self.simulation.reset([i], [for_world])
        self.task.reset(i, for_task)
        self.actions[:, i] = self.usual_action
        self.seen[i] = 0.0
        observe(
            *(self.simulation.boats[i], self.task.records[i], self.task.points[i], self.rules),
            *(self.simulation.dt, self.seen[i], obs),
        )

    def step(self, obs: np.ndarray) -> bool:
        """Take the steps of one decision by ``actions[1]``.

        Parameters
        ----------
        obs : ndarray, shape (n, 23 or more)
            The observations are written there, but for boats that rest.

        Returns
        -------
        bool
            False, with nothing done, if an action is no number.
        """
        for left in self._countdown:
            if not self._step(obs, left):
                return False
            for watch in self.watchers:
                watch(obs, left == 0)
        return True

    def _step(self, obs: np.ndarray, left: int) -> bool:
        if self._pool is None:
            arguments = (*self._arguments[0], obs, left)
            said = _step(*arguments)
            if said == NO_NOISE:
                self.simulation.draw_noise()
                said = _step(*arguments)
            return bool(said == DONE)
        awake = self.seen[:, RESTS] == 0.0
        if not np.isfinite(self.actions[1, awake]).all():
            return False
        if out_of_noise(self.simulation.boats):
            self.simulation.draw_noise()
        self.each(lambda j: _step(*(*self._arguments[j], obs[self.blocks[j]], left)))
        return True

    def each(self, call: Callable[[int], Any]) -> None:
        """Call a function for the number of each block of boats, by a thread for each."""
        if self._pool is None:
            call(0)
        else:
            list(self._pool.map(call, range(len(self.blocks))))

    @property
    def steps(self) -> np.ndarray:
        """Steps since the reset, shape (n,), as floats; a view."""
        return self.simulation.records[:, COUNT]


def _faults(faults: str | Sequence[Disturbance], dt: float) -> tuple[Any, int]:
    """Return faults, or a function that draws them, and how many there are at most."""
    if isinstance(faults, str):
        texts = faults.split("|")
        # a wrong name dies here, not at the first reset
        most = max(len(sensors.fault_rows(sensors.parse_faults(one, 0.0), dt)) for one in texts)

        def draw(rng: np.random.Generator) -> tuple[Disturbance, ...]:
            start = rng.uniform(*FAULT_START)
            return sensors.parse_faults(choice(texts, rng), start)

        return draw, most
    items = list(faults) if isinstance(faults, Sequence) else [faults]
    given = [fault for fault in items if isinstance(fault, Disturbance)]
    if len(given) < len(items):
        raise FaultError(
            f"faults = {faults!r}: give a text such as 'gps10', or a list of "
            "usv_gym.Fault(kind, start, duration)"
        )
    return given, len(given)
