"""The Gymnasium environment: a thin adapter over :class:`~usv_gym.simulation.Simulation`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from usv_gym import sensors
from usv_gym.sea import SeaState
from usv_gym.sensors import Fault, SensorSuite
from usv_gym.simulation import Simulation
from usv_gym.tasks import ERRORS, TERMS, follow, make_task
from usv_gym.vessel import Vessel
from usv_kernel import kernel

__all__ = ["OBSERVATION", "USVEnv"]

OBSERVATION = (
    *("cos_heading", "sin_heading", "yaw_rate", "accel_forward", "accel_starboard"),
    *("speed_forward", "speed_starboard"),
    *("gps_valid", "compass_valid", "imu_valid", "gps_age", "compass_age", "imu_age"),
    *("shaft_left", "shaft_right", "drive_left", "drive_right"),
    *("cross_track", "to_go", "cos_course_error", "sin_course_error"),
    *("cos_next_turn", "sin_next_turn"),
)
"""Names of the entries of the observation; scales in :class:`USVEnv`."""
BOUND = 10.0
"""Largest size of an entry of an observation; what is larger is cut off."""
AGE_SCALE = 10.0
CROSS_TRACK_SCALE, TO_GO_SCALE = 10.0, 100.0
FAULT_START = (10.0, 60.0)
"""A fault given by its name begins at random between these times, s."""


@kernel
def _command(action: np.ndarray, scale: np.ndarray, cmd: np.ndarray) -> bool:
    """Write commands for actions cut to [-1, 1]; return False if one is not finite."""
    width = action.shape[1]
    for i in range(action.shape[0]):
        for j in range(width):
            if not math.isfinite(action[i, j]):
                return False
            action[i, j] = min(max(action[i, j], -1.0), 1.0)
        for j in range(4):
            cmd[i, j] = scale[j] * action[i, j if width == 4 else j // 2]
    return True


@kernel
def _observe(
    z: np.ndarray,
    cmd: np.ndarray,
    dt: float,
    speed: float,
    scale: np.ndarray,
    points: np.ndarray,
    legs: np.ndarray,
    reach: float,
    held: np.ndarray,
    age: np.ndarray,
    errors: np.ndarray,
    obs: np.ndarray,
) -> None:
    """Hold the last sample of each sensor, and write the observation from it."""
    for i in range(z.shape[0]):
        for j in range(3):
            age[i, j] += dt
        if math.isfinite(z[i, 0]):
            age[i, 0] = 0.0
            for j in range(4):
                held[i, j] = z[i, j]
        if math.isfinite(z[i, 4]):
            age[i, 1] = 0.0
            held[i, 4] = z[i, 4]
        if math.isfinite(z[i, 5]):
            age[i, 2] = 0.0
            for j in range(5, 8):
                held[i, j] = z[i, j]
        c, s = math.cos(held[i, 4]), math.sin(held[i, 4])
        legs[i] = follow(held[i, 0], held[i, 1], held[i, 4], points[i], legs[i], reach, errors)
        o = obs[i]
        o[0], o[1], o[2] = c, s, held[i, 5]
        o[3], o[4] = held[i, 6] / 9.80665, held[i, 7] / 9.80665
        o[5] = (held[i, 2] * c + held[i, 3] * s) / speed
        o[6] = (held[i, 3] * c - held[i, 2] * s) / speed
        for j in range(3):
            o[7 + j] = 1.0 if age[i, j] == 0.0 else 0.0
            o[10 + j] = age[i, j] / AGE_SCALE
        for j in range(4):
            o[13 + j] = cmd[i, j] / scale[j]
        o[17] = errors[0] / CROSS_TRACK_SCALE
        o[18] = errors[1] / TO_GO_SCALE
        o[19], o[20] = math.cos(errors[2]), math.sin(errors[2])
        o[21], o[22] = math.cos(errors[3]), math.sin(errors[3])
        for j in range(o.shape[0]):
            o[j] = min(max(o[j], -BOUND), BOUND)


class USVEnv(gym.Env[np.ndarray, np.ndarray]):
    """A 7.5 m unmanned surface vessel in wind and waves, seen through its sensors.

    Description
    -----------
    A ship after the MMG standard method with two propellers on steerable drives sails in
    Blendermann wind and irregular Pierson-Moskowitz waves. The agent sees a GPS, a compass
    and an IMU that are noisy, biased, late and may drop out; it never sees the truth.
    ``USVTwin-v0`` adds what a digital twin makes of the same sensors; see
    :class:`twin.wrapper.TwinObservation`.

    Action
    ------
    ``Box(-1, 1, (2,), float32)``; more is cut off, NaN is an error.

    = ================================ ========================================
    0 shaft speed of both propellers   1 is ``shaft_speed_service`` of the vessel; < 0 astern
    1 angle of both drives             1 is ``steer_max``; > 0 turns to starboard
    = ================================ ========================================

    ``actions="units"`` gives four: left and right shaft, left and right drive.

    Observation
    -----------
    ``Box(-10, 10, (23,), float32)``. A sensor without a new sample shows its last one.

    ====== ======================================== =============
    entry  what                                     unit of 1.0
    ====== ======================================== =============
    0-1    cosine and sine of the compass heading
    2      yaw rate                                 rad/s
    3-4    specific force, forward and starboard    g
    5-6    GPS velocity, forward and starboard      usual speed
    7-9    new sample of GPS, compass, IMU          yes
    10-12  age of the last sample of each           10 s
    13-14  commanded shaft speeds, left, right      service speed
    15-16  commanded drive angles, left, right      steer_max
    17     last fix to starboard of the leg         10 m
    18     last fix to the next way point           100 m
    19-20  cosine, sine: course of leg - heading
    21-22  cosine, sine: turn to the next leg
    ====== ======================================== =============

    Reward
    ------
    That of the task, see :data:`usv_gym.tasks.TASKS`; ``info["reward_terms"]`` has the parts.

    Start and end
    -------------
    Straight ahead to the north at the speed of ``shaft_speed_manoeuvring``. The task ends
    the episode; ``USVTwin-v0`` truncates it after 2400 steps (120 s).

    Version history
    ---------------
    * v0: first.

    Parameters
    ----------
    vessel : str or Path or Vessel
        Name, TOML file or object.
    sea : str or SeaState
        Name in :data:`usv_gym.sea.SEA_STATES`, or an object.
    hs, wind, wind_from_deg : float, optional
        Change the sea state's wave height (m), wind speed (m/s) and where the wind comes
        from (degrees).
    suite : SensorSuite or "perfect", optional
        Errors and rates of the sensors.
    faults : str or sequence of Fault
        ``"none"``; a name such as ``"gps10"`` (10 s without GPS, beginning at random
        between 10 and 60 s); or faults with their times.
    task : str
        One of :data:`usv_gym.tasks.TASKS`.
    actions : str
        ``"common"`` or ``"units"``.
    dt, dt_physics : float
        Control and integration step, s.
    record : bool
        Keep every row, for :func:`twin.wrapper.log_of`.
    render_mode : None
        There is none yet.
    """

    metadata = {"render_modes": [], "render_fps": 20}  # noqa: RUF012 - Gymnasium's attribute

    def __init__(
        self,
        *,
        vessel: str | Path | Vessel = "usv75",
        sea: str | SeaState = "2",
        hs: float | None = None,
        wind: float | None = None,
        wind_from_deg: float | None = None,
        suite: SensorSuite | str | None = None,
        faults: str | Sequence[Fault] = "none",
        task: str = "path",
        actions: str = "common",
        dt: float = 0.05,
        dt_physics: float = 0.05,
        record: bool = False,
        render_mode: str | None = None,
    ) -> None:
        if render_mode is not None:
            raise ValueError(f"render_mode {render_mode!r} is not offered; leave it out")
        if actions not in ("common", "units"):
            raise ValueError(f"actions = {actions!r}; use 'common' or 'units'")
        if isinstance(suite, str):
            if suite != "perfect":
                raise ValueError(f"suite = {suite!r}; use 'perfect' or a SensorSuite")
            suite = SensorSuite.perfect()
        self.render_mode = None
        self.vessel = Vessel.load(vessel)
        wind_from = None if wind_from_deg is None else math.radians(wind_from_deg)
        self.sea = SeaState.named(sea).replace(hs=hs, wind=wind, wind_from=wind_from)
        if isinstance(faults, str):
            name = faults
            sensors.parse_faults(name, 0.0)  # a wrong name dies here, not at the first reset

            def draw(rng: np.random.Generator) -> tuple[Fault, ...]:
                return sensors.parse_faults(name, rng.uniform(*FAULT_START))

            self.simulation = Simulation(
                1,
                self.vessel,
                self.sea,
                suite=suite,
                faults=draw,
                max_faults=len(sensors.parse_faults(name, 0.0)),
                dt=dt,
                dt_physics=dt_physics,
            )
        else:
            self.simulation = Simulation(
                1, self.vessel, self.sea, suite=suite, faults=faults, dt=dt, dt_physics=dt_physics
            )
        limits = self.vessel.values
        self.speed = self.vessel.straight_speed(limits["shaft_speed_manoeuvring"])
        self.task = make_task(task, 1, self.speed, limits["length_waterline"])
        n_max, delta_max = limits["shaft_speed_service"], limits["steer_max"]
        self._scale = np.array([n_max, n_max, delta_max, delta_max])
        width = 4 if actions == "units" else 2
        self.action_space = spaces.Box(-1.0, 1.0, (width,), np.float32)
        self.observation_space = spaces.Box(-BOUND, BOUND, (len(OBSERVATION),), np.float32)
        self._shape = (width,)
        self._action = np.zeros((1, width))
        self._before = np.zeros((1, width))
        self._cmd = np.zeros((1, 4))
        self._held = np.zeros((1, len(sensors.CHANNELS)))
        self._age = np.zeros((1, 3))
        self._errors = np.zeros(len(ERRORS))
        self._started = False
        self.history: list[np.ndarray] | None = [] if record else None
        """With ``record``: a row of time, command, measurement and true state per step."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; see :meth:`gymnasium.Env.reset`.

        Parameters
        ----------
        seed : int, optional
            Seed of all randomness of this and the following episodes.
        options : dict, optional
            None are known.

        Returns
        -------
        ndarray, dict
            Observation and info.
        """
        super().reset(seed=seed)
        if options:
            raise ValueError(f"unknown reset options: {', '.join(map(str, options))}")
        world, task = self.np_random.spawn(2)
        self.simulation.reset([0], [world])
        self.task.reset(0, task)
        share = self.simulation.cmd[0] / self._scale
        self._action[0] = share if self._action.shape[1] == 4 else share[::2]
        self._held[:] = 0.0
        self._age[:] = 0.0
        self._started = True
        if self.history is not None:
            self.history.clear()
        return self._observation(), self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Sail for one control step; see :meth:`gymnasium.Env.step`.

        Parameters
        ----------
        action : array_like, shape (2,) or (4,)
            See the class.

        Returns
        -------
        ndarray, float, bool, bool, dict
            Observation, reward, terminated, truncated (never here), info.
        """
        if not self._started:
            raise gym.error.ResetNeeded("call reset() before step()")
        try:
            values = np.asarray(action, dtype=np.float64)
        except (TypeError, ValueError):
            raise ValueError(f"action {action!r} is not an array of numbers") from None
        if values.shape != self._shape:
            raise ValueError(
                f"action has shape {values.shape}; it must be {self._shape}: "
                "see the action table of USVEnv"
            )
        self._before, self._action = self._action, self._before
        self._action[0] = values
        if not _command(self._action, self._scale, self._cmd):
            self._before, self._action = self._action, self._before
            raise ValueError(
                f"action {values} holds NaN or infinity; every entry must lie in [-1, 1]"
            )
        self.simulation.step(self._cmd)
        self.task.step(self.simulation.state, self._action, self._before)
        task = self.task
        reward, terminated = task.rewards.item(0), task.terminated.item(0)
        return self._observation(), reward, terminated, False, self._info()

    def _observation(self) -> np.ndarray:
        sim, task = self.simulation, self.task
        obs = np.empty((1, len(OBSERVATION)), np.float32)
        _observe(
            sim.z,
            sim.cmd,
            sim.dt,
            self.speed,
            self._scale,
            task.points,
            task.known_legs,
            task.reach,
            self._held,
            self._age,
            self._errors,
            obs,
        )
        if self.history is not None:
            self.history.append(np.concatenate([sim.t, sim.cmd[0], sim.z[0], sim.state[0]]))
        return obs[0]

    def _info(self) -> dict[str, Any]:
        task = self.task
        return {
            "t_s": self.simulation.t.item(0),
            "cross_track_m": task.errors.item(0),
            "leg": task.legs.item(0),
            "is_success": task.success.item(0),
            "reward_terms": dict(zip(TERMS, task.terms[0].tolist(), strict=True)),
        }
