"""n episodes at once: boats, their tasks, and their observations. Behind every environment."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from usv_gym.design.seaway import warning_of
from usv_gym.envs.config import EnvConfig
from usv_gym.envs.observer import Observer, StepCallback
from usv_gym.envs.scoring import (
    COURSE_ERROR,
    CROSS_TRACK,
    ERRORS,
    NEXT_TURN,
    RULES,
    TASK,
    TO_GO,
    TaskError,
    follow,
    score_step,
)
from usv_gym.envs.tasks import Step, Task, make_task
from usv_gym.envs.worlds import Worlds, check_tables, faults_of, note_drawn, vessels_of
from usv_gym.physics import GRAVITY
from usv_gym.physics.frames import COMMAND_SIZE
from usv_gym.vessel.runaway import check_motion
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.faults import CHANNELS
from usv_gym.world.sensors import WIND_AT
from usv_gym.world.simulation import (
    DONE,
    NOT_FINITE,
    RAN_AWAY,
    Simulation,
    advance,
    parts_of,
)
from usv_gym.world.start import SEA
from usv_gym.world.state import BOAT, SIMULATION, WORLD
from usv_gym.world.streams import KEYS, Streams
from usv_kernel.channels import (
    ACCEL_X,
    ACCEL_Y,
    COMPASS,
    GPS_VX,
    GPS_VY,
    GPS_X,
    GPS_Y,
    GYRO,
    SENSOR_CHANNELS,
)
from usv_kernel.errors import check_whole
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import Record, as_record, field_at, record_size, structured
from usv_kernel.scalar import sincos
from usv_kernel.streams import spawn_children

__all__ = [
    "BOUND",
    "EPISODE",
    "EPISODES",
    "MOTION_OBSERVATION",
    "OBSERVATION",
    "WIND_OBSERVATION",
    "CapsizeWarning",
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

MOTION_OBSERVATION = (
    *("roll_rate", "pitch_rate", "accel_down", "ahrs_roll", "ahrs_pitch"),
    *("gps_down", "speed_down", "ahrs_valid", "ahrs_age"),
)
"""Those that six degrees of freedom add behind them."""

WIND_OBSERVATION = ("wind_ahead", "wind_starboard", "wind_valid", "wind_age")
"""Those that an anemometer adds behind these."""

(
    _COS_HEADING, _SIN_HEADING, _YAW_RATE, _ACCEL_FORWARD, _ACCEL_STARBOARD,
    _SPEED_FORWARD, _SPEED_STARBOARD,
    _GPS_VALID, _COMPASS_VALID, _IMU_VALID, _GPS_AGE, _COMPASS_AGE, _IMU_AGE,
    _SHAFT_LEFT, _SHAFT_RIGHT, _DRIVE_LEFT, _DRIVE_RIGHT,
    _CROSS_TRACK, _TO_GO, _COS_COURSE_ERROR, _SIN_COURSE_ERROR, _COS_NEXT_TURN, _SIN_NEXT_TURN,
) = range(len(OBSERVATION))  # fmt: skip

THREADS_MAX = 1024
"""Most threads."""

BOUND = 10.0
"""Largest size of an entry of an observation; what is larger is cut off."""

AGE_SCALE = 10.0

TILT_SCALE = math.radians(10.0)

WIND_SCALE = 10.0
"""Unit of the apparent wind, m/s."""

_GYRO_X = len(SENSOR_CHANNELS)
_AHRS_ROLL = len(SENSOR_CHANNELS) + 3
_GPS_Z = WIND_AT - 2

_AGE_OF = (GPS_X, COMPASS, GYRO, _AHRS_ROLL, WIND_AT)
"""Channels whose samples the ages of GPS, compass, IMU, AHRS and anemometer count from."""

EPISODE = np.dtype(
    [
        ("task", TASK),
        ("held", float, CHANNELS),  # last sample of each channel, its unit
        ("age", float, 5),  # s, of the last sample of GPS, compass, IMU, AHRS, anemometer
        ("known_errors", float, len(ERRORS)),  # errors of the task as known on board
        ("idle_steps", float),  # steps to let pass, after a reset or the end of an episode
        ("kind", float),  # place of the vessel among those of which one is drawn
    ]
)
"""State of one episode besides that of the boat."""

EPISODES = np.dtype(
    [
        ("simulation", SIMULATION),
        ("rules", RULES),
        ("frames", float),  # control steps of a decision
        ("own_task", float),  # 1 where Python rates the steps
        ("entries", float),  # of the sensors in an observation
        ("wind_at", float),  # the first of them that an anemometer adds; 0: there is none
        ("scale", float, COMMAND_SIZE),  # command of a full action: rev/s, rad
        ("mixing", float, (COMMAND_SIZE, COMMAND_SIZE)),  # share of each action in each command
    ]
)
"""What all episodes of boats of one kind share, and never changes."""


_KEYS = (*((0, *key) for key in KEYS), (1,), (2,))
"""Children of a boat's generator: those of the simulation, then for the task, and for the world."""

_TASK = len(_KEYS) - 2
_WORLD = len(_KEYS) - 1

_HEADING = field_at(WORLD, "heading")


class CapsizeWarning(UserWarning):
    """The vessel will capsize in this sea, as far as a minute of it shows."""


@inlined
def _hold(boat, episode, points, config):
    """Hold the last sample of each sensor of one boat, and follow its path as known on board."""
    z, held, age, errors = boat.measurement, episode.held, episode.age, episode.known_errors
    for j in range(age.shape[0]):
        age[j] += config.simulation.dt
    for j in range(z.shape[0]):
        if math.isfinite(z[j]):
            held[j] = z[j]
    for k in range(age.shape[0]):
        if math.isfinite(z[_AGE_OF[k]]):
            age[k] = 0.0
    leg, reach = int(episode.task.known_leg), config.rules.reach
    leg = follow(held[GPS_X], held[GPS_Y], held[COMPASS], points, leg, reach, errors)
    episode.task.known_leg = leg


@kernel
def _describe(boat: Record, episode: Record, config: Record, o: np.ndarray) -> None:
    """Write the observation of one boat from the samples that are held."""
    held, age, errors, rules = episode.held, episode.age, episode.known_errors, config.rules
    # new since the last decision, and there was one at all
    fresh = (min(config.frames - 1.0, boat.step) + 0.5) * config.simulation.dt
    s, c = sincos(held[COMPASS])
    o[_COS_HEADING], o[_SIN_HEADING], o[_YAW_RATE] = c, s, held[GYRO]
    o[_ACCEL_FORWARD], o[_ACCEL_STARBOARD] = held[ACCEL_X] / GRAVITY, held[ACCEL_Y] / GRAVITY
    o[_SPEED_FORWARD] = (held[GPS_VX] * c + held[GPS_VY] * s) / rules.speed
    o[_SPEED_STARBOARD] = (held[GPS_VY] * c - held[GPS_VX] * s) / rules.speed
    for j in range(3):
        o[_GPS_VALID + j] = 1.0 if age[j] < fresh else 0.0
        o[_GPS_AGE + j] = age[j] / AGE_SCALE
    for j in range(4):
        o[_SHAFT_LEFT + j] = boat.command[j] / config.scale[j]
    o[_CROSS_TRACK] = errors[CROSS_TRACK] / rules.unit
    o[_TO_GO] = 0.1 * errors[TO_GO] / rules.unit
    o[_SIN_COURSE_ERROR], o[_COS_COURSE_ERROR] = sincos(errors[COURSE_ERROR])
    o[_SIN_NEXT_TURN], o[_COS_NEXT_TURN] = sincos(errors[NEXT_TURN])
    if config.simulation.dof == 6:
        _describe_motion(held, age[3], fresh, o[len(OBSERVATION) :])
    if config.wind_at > 0.0:
        _describe_wind(held, age[4], fresh, o[int(config.wind_at) :])
    for j in range(int(config.entries)):  # more may follow
        o[j] = min(max(o[j], -BOUND), BOUND)


@inlined
def _describe_motion(held, age, fresh, o):
    """Write the entries of roll, pitch and heave."""
    o[0], o[1], o[2] = held[_GYRO_X], held[_GYRO_X + 1], held[_GYRO_X + 2] / GRAVITY
    o[3], o[4] = held[_AHRS_ROLL] / TILT_SCALE, held[_AHRS_ROLL + 1] / TILT_SCALE
    o[5], o[6] = held[_GPS_Z] / 10.0, held[_GPS_Z + 1]
    o[7], o[8] = 1.0 if age < fresh else 0.0, age / AGE_SCALE


@inlined
def _describe_wind(held, age, fresh, o):
    """Write the entries of the apparent wind: where it comes from."""
    side, ahead = sincos(held[WIND_AT + 1])
    o[0], o[1] = held[WIND_AT] * ahead / WIND_SCALE, held[WIND_AT] * side / WIND_SCALE
    o[2], o[3] = 1.0 if age < fresh else 0.0, age / AGE_SCALE


@kernel
def _step(
    rows: np.ndarray,
    episodes: np.ndarray,
    shared: np.ndarray,
    factors: np.ndarray,
    points: np.ndarray,
    actions: np.ndarray,
    obs: np.ndarray,
    left: int,
) -> int:
    """Take one step of every boat that is not idle; unless it returns DONE, nothing was done.

    ``rows`` and ``episodes`` are the flat memory of BOAT and EPISODE, ``shared`` of EPISODES, one
    row for each kind of boat. ``actions`` (2, n, A) holds the action of the last step, and this
    one. ``left`` is how many steps of this decision follow; before the last, only boats whose
    episode ends now are observed.
    """
    first = left + 1 == int(as_record(shared[0], EPISODES).frames)
    width = actions.shape[2]
    for i in range(rows.shape[0]):
        idle = as_record(episodes[i], EPISODE).idle_steps
        for j in range(width):
            if not math.isfinite(actions[1, i, j]) and idle == 0.0:
                return NOT_FINITE
    sound = True
    for i in range(rows.shape[0]):
        episode = as_record(episodes[i], EPISODE)
        if episode.idle_steps > 0.0:
            episode.idle_steps -= 1.0
            continue
        config = as_record(shared[int(episode.kind)], EPISODES)
        boat, before, action = as_record(rows[i], BOAT), actions[0, i], actions[1, i]
        for j in range(width):
            action[j] = min(max(action[j], -1.0), 1.0)
        for j in range(4):
            share = 0.0
            for k in range(width):
                share += config.mixing[j, k] * action[k]
            boat.command[j] = config.scale[j] * min(max(share, -1.0), 1.0)
        sound = advance(rows[i], config.simulation, factors) and sound
        if first:
            episode.task.terms[:] = 0.0
            episode.task.reward = 0.0
        path, rules = points[i], config.rules
        score_step(boat.state, boat.mean_rate, action, before, path, rules, episode.task)
        _hold(boat, episode, points[i], config)
        # a task of one's own says later that the episode is over
        if left == 0 or episode.task.terminated != 0.0 or config.own_task > 0.0:
            _describe(boat, episode, config, obs[i])
        for j in range(width):
            before[j] = action[j]
        if episode.task.terminated != 0.0:
            episode.idle_steps = left
    return DONE if sound else RAN_AWAY


@kernel
def _begin(
    row: np.ndarray,
    episode: np.ndarray,
    points: np.ndarray,
    shared: np.ndarray,
    notes: tuple[np.ndarray, np.ndarray, np.ndarray],
    obs: np.ndarray,
) -> None:
    """Write the first observation of one boat, from flat memory, and note what was drawn.

    ``notes`` hold flat memory of WORLD, that of SEA for each sea state, and the numbers of DRAWN.
    """
    boat, memory = as_record(row, BOAT), as_record(episode, EPISODE)
    begin = as_record(notes[0], WORLD)
    memory.kind = begin.kind
    config = as_record(shared[int(memory.kind)], EPISODES)
    note_drawn(boat, begin, as_record(notes[1][int(begin.sea)], SEA), notes[2])
    _hold(boat, memory, points, config)
    _describe(boat, memory, config, obs)


class Kind(NamedTuple):
    """What all episodes of one vessel have in common."""

    vessel: Vessel
    speed: float
    """Nominal speed, m/s."""
    task: Task
    nominal_action: NDArray[np.float64]
    """The action that holds the nominal speed, straight ahead; episodes begin with it."""
    deck_point: tuple[float, ...]
    """Where the motion counts, m forward, to starboard and down of the origin."""


def _mixing(vessel: Vessel, config: EnvConfig) -> NDArray[np.float64]:
    """Return commands (4, A) per full action."""
    return vessel.mixing if config.actions == "common" else vessel.actuators


class Episodes:
    """n boats of one kind, each in an episode of its own.

    Parameters
    ----------
    n : int
        Number of boats.
    config : EnvConfig
        Options of the environment.
    threads : int
        Threads that share the boats; results do not depend on it.

    Attributes
    ----------
    simulation : Simulation
        The simulator.
    width : int
        Numbers in an action.
    observation : tuple of str
        Names of the sensors' entries in an observation.
    options : dict
        Those that say what an action is, and how the boat moves.
    records : ndarray of EPISODE, shape (n,)
        What lasts of each episode.
    vessel, speed, task, nominal_action, config
        Those of the first kind of boat; ``kinds`` and ``configs`` have all.
    shared : ndarray
        What kernels read of the options: flat memory, a row for each kind of boat.
    """

    def __init__(self, n: int, config: EnvConfig, *, threads: int = 1) -> None:
        check_whole("num_threads", threads, 1, THREADS_MAX)
        vessels, self.seas = vessels_of(config), config.seas()
        self.vessel = vessels[0]
        self.worlds = Worlds(n, config, vessels)
        self.simulation = Simulation(
            n,
            self.vessel,
            self.seas,
            suite=config.suite,
            faults=faults_of(config),
            kinds=self.worlds.kinds,
            dof=config.dof,
            dt=config.dt,
            dt_physics=config.dt_physics,
        )
        check_tables(vessels, config.dof)
        for vessel in vessels:
            check_motion(vessel, config.dof, config.dt_physics)
            for sea in self.seas:
                if (found := warning_of(vessel, sea, config.dof)) is not None:
                    warnings.warn(found, CapsizeWarning, stacklevel=2)
        self.n, self.frame_skip = n, int(config.frame_skip)
        self._countdown = tuple(reversed(range(self.frame_skip)))
        self.memory = np.zeros((n, record_size(EPISODE)))
        """State of each episode, as kernels take it."""
        self.records = structured(self.memory, EPISODE)
        self.observation = OBSERVATION + (MOTION_OBSERVATION if config.dof == 6 else ())
        wind_at = len(self.observation) if self.simulation.suite.has_anemometer else 0
        self.observation += WIND_OBSERVATION if wind_at else ()
        self.configs = np.zeros(len(vessels), EPISODES)
        """What kernels read of the options, for each kind of boat."""
        self.shared = self.configs.view(float).reshape(len(vessels), -1)
        self.kinds = [self._kind(vessel, config) for vessel in vessels]
        """What differs between the vessels of which an episode draws one."""
        self.speed, self.task, self.nominal_action = self.kinds[0][1:4]
        self.width, self._own = len(self.nominal_action), self.task.is_own
        self.options = {"actions": config.actions, "dof": config.dof}
        for row, kind in zip(self.configs, self.kinds, strict=True):
            kind.task.records, kind.task.points = self.records["task"], self.task.points
            v, mixing = kind.vessel.values, _mixing(kind.vessel, config)
            row["simulation"], row["rules"] = self.simulation.config, kind.task.rules
            row["frames"], row["wind_at"] = self.frame_skip, wind_at
            row["own_task"] = kind.task.is_own
            row["entries"], row["mixing"][:, : self.width] = len(self.observation), mixing
            n_max = v["shaft_speed_service"]
            row["scale"] = n_max, n_max, *2 * (kind.vessel.helm_max,)
        self.config = self.configs[0]
        self.actions = np.zeros((2, n, self.width))
        """Those of the last step, and of this one."""
        self.blocks = parts_of(n, self.simulation.substeps, threads)
        """The boats of each call of a kernel."""
        sim = self.simulation
        self._arguments: list[tuple[Any, ...]] = [
            (
                sim.rows[block],
                self.memory[block],
                self.shared,
                sim.factors.copy(),
                self.task.points[block],
                self.actions[:, block],
            )
            for block in self.blocks
        ]
        self.threads = threads
        self._pool = self._threads()

    def _kind(self, vessel: Vessel, config: EnvConfig) -> Kind:
        """Return what is particular to a vessel."""
        v, motion = vessel.values, config.motion_penalty
        n_manoeuvring, n_max = v["shaft_speed_manoeuvring"], v["shaft_speed_service"]
        speed = vessel.straight_speed(n_manoeuvring)
        length, weights = v["length_waterline"], config.reward_weights
        task = make_task(config.task, self.n, speed, length, motion, weights)
        if config.dof != 6 and task.rules["motion"] > 0.0:
            what = f"task = {config.task!r}" if motion is None else f"motion_penalty = {motion}"
            raise TaskError(f"{what}: a boat with dof=3 does not roll; use dof=6")
        if config.deck_point is not None:
            task.rules["deck"] = config.deck_point
        share = n_manoeuvring / n_max
        nominal = np.linalg.pinv(_mixing(vessel, config)) @ np.array([share, share, 0.0, 0.0])
        return Kind(vessel, speed, task, nominal, tuple(task.rules["deck"].tolist()))

    def __getstate__(self) -> dict[str, Any]:
        """Return what copies are made of: threads are no part of it."""
        return {**vars(self), "_pool": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Become a copy, with threads of its own."""
        vars(self).update(state)
        self._pool = self._threads()

    def _threads(self) -> ThreadPoolExecutor | None:
        return ThreadPoolExecutor(self.threads) if min(self.threads, self.n) > 1 else None

    def close(self) -> None:
        """End the threads."""
        if self._pool:
            self._pool.shutdown()

    def reset(self, i: int, rng: np.random.Generator, obs: np.ndarray) -> None:
        """Start an episode of one boat.

        Parameters
        ----------
        i : int
            Which boat.
        rng : numpy.random.Generator
            That of the boat.
        obs : ndarray, shape (23 or more,)
            Its first observation is written there.
        """
        # all randomness of an episode comes from children of its generator, one for each purpose:
        # so an option does not change what the others draw
        children, sim = spawn_children(rng, _KEYS, 2), self.simulation
        number = self.worlds.draw(children.states[_WORLD], i, sim) if self.worlds.active else 0
        sim.begin(i, Streams(children))
        if sim.fault_sets.most > 0:
            self.worlds.note_faults(i, sim)
        kind, world, memory = self.kinds[number], sim.world_rows[i], self.memory[i]
        memory[:] = 0.0
        kind.task.draw(i, children, _TASK, world[_HEADING])
        self.actions[:, i] = kind.nominal_action
        notes = world, sim.sea_tables.rows, self.worlds.numbers[i]
        _begin(sim.rows[i], memory, self.task.points[i], self.shared, notes, obs)

    def step(self, obs: np.ndarray, callbacks: Sequence[StepCallback] = ()) -> bool:
        """Take the steps of one decision by ``actions[1]``.

        Parameters
        ----------
        obs : ndarray, shape (n, 23 or more)
            The observations are written there, but for idle boats.
        callbacks : sequence of StepCallback
            Called after each step. The caller keeps them: a reference from here back to their
            owner would keep a dropped environment in memory.

        Returns
        -------
        bool
            False, with nothing done, if an action is no number.
        """
        if len(self.blocks) > 1 and not self._own:
            watching = [one for one in callbacks if isinstance(one, Observer) and one.by_block]
            if len(watching) == len(callbacks):
                return self._step_blocks(obs, self._countdown, watching)
        for left in self._countdown:
            before = self._before_step() if self._own else None
            if not self._step(obs, left):
                return False
            if before:
                self._score(*before, left)
            for callback in callbacks:
                callback.observe(obs, left == 0)
        return True

    def _before_step(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the last actions (n, A), and which boats will sail (n,)."""
        return self.actions[0].copy(), self.records["idle_steps"] == 0.0

    def _score(self, before: np.ndarray, active: np.ndarray, left: int) -> None:
        """Let tasks that rate their steps themselves do so, of the boats that sailed."""
        record, boats = self.records["task"], self.simulation.boats
        step = Step(
            t=self.simulation.t,
            state=boats["state"],
            rate=boats["mean_rate"],
            action=self.actions[1],
            before=before,
            errors=record["errors"],
            leg=record["leg"].astype(np.int64),
            points=self.task.points,
            capsized=record["capsized"] != 0.0,
        )
        for number, kind in enumerate(self.kinds):
            rated = active & (self.records["kind"] == number)
            if rated.any():
                kind.task.take(step, rated)
        over = active & (record["terminated"] != 0.0)
        self.records["idle_steps"][over] = left

    def _step(self, obs: np.ndarray, left: int) -> bool:
        if len(self.blocks) > 1:
            return self._step_blocks(obs, (left,))
        arguments = (*self._arguments[0], obs, left)
        result = _step(*arguments)
        if result == RAN_AWAY:
            raise self.simulation.runaway()
        return bool(result == DONE)

    def _step_blocks(
        self, obs: np.ndarray, countdown: Iterable[int], watching: Sequence[Observer] = ()
    ) -> bool:
        """Take steps block by block: threads wait for each other once, after the last."""
        active = self.records["idle_steps"] == 0.0
        if not np.isfinite(self.actions[1, active]).all():
            return False

        def sail(j: int) -> None:
            block = self.blocks[j]
            for left in countdown:
                arguments = (*self._arguments[j], obs[block], left)
                if _step(*arguments) == RAN_AWAY:
                    raise self.simulation.runaway()
                for one in watching:
                    one.observe_block(j, obs[block], left == 0)

        self.each(sail)
        for one in watching:
            one.finish(obs)
        return True

    def each(self, call: Callable[[int], Any]) -> None:
        """Call a function for the number of each block of boats, by threads if there are any."""
        if self._pool is None:
            for j in range(len(self.blocks)):
                call(j)
        else:
            list(self._pool.map(call, range(len(self.blocks))))

    @property
    def steps(self) -> np.ndarray:
        """Steps since the reset, shape (n,), as floats; a view."""
        return self.simulation.boats["step"]
