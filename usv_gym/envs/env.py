"""The Gymnasium environment: a thin adapter over :class:`~usv_gym.envs.episodes.Episodes`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from usv_gym.envs.config import EnvConfig
from usv_gym.envs.copying import packed, unpacked
from usv_gym.envs.episodes import BOUND, Episodes, Observer
from usv_gym.envs.render import RENDER_MODES, RENDER_SIZE, Frame, Renderer, fps_of, pictures
from usv_gym.envs.scoring import TASK
from usv_kernel.errors import UsvTwinError
from usv_kernel.records import field_at, record_size

__all__ = [
    "USVEnv",
]


_LEG, _ERRORS, _TERMS, _REWARD, _TERMINATED, _SUCCESS, _CAPSIZED = (
    field_at(TASK, name)
    for name in ("leg", "errors", "terms", "reward", "terminated", "success", "capsized")
)
"""Where these stand in a task's flat record: one list a step is quicker than seven views."""


_FLOAT32 = np.dtype(np.float32)


class Recorded(NamedTuple):
    """What a step leaves in a log."""

    t: float  # s
    cmd: np.ndarray  # (4,) command in force: rev/s, rad
    z: np.ndarray  # (17,) measurement, see usv_kernel.channels
    state: np.ndarray  # true state of the ship, see usv_gym.physics.frames


class Recorder:
    """Rows of the episodes of n boats, for their logs.

    Attributes
    ----------
    rows : list of list of Recorded
        Those of the episode that each boat is in.
    ended : list of list of Recorded
        Those of the one before, until the next ends.
    kinds, ended_kinds : list of int
        Place of the vessel in these, among the kinds of the episodes.
    """

    def __init__(self, episodes: Episodes) -> None:
        self.simulation = simulation = episodes.simulation
        self._numbers = episodes.records["kind"]
        self.kinds = [0] * episodes.n
        self.ended_kinds = [0] * episodes.n
        self.rows: list[list[Recorded]] = [[] for _ in simulation.t]
        self.ended: list[list[Recorded]] = [[] for _ in simulation.t]

    def reset(self, i: int) -> None:
        """Begin the log of boat i with the row of this moment."""
        if self.rows[i]:
            self.ended[i], self.ended_kinds[i] = self.rows[i], self.kinds[i]
        self.kinds[i] = int(self._numbers[i])
        self.rows[i] = []
        self._add([i])

    def observe(self, obs: np.ndarray, look: bool = True) -> None:
        """Add the rows of this step, of boats that sailed it: an ended episode stands still."""
        times = enumerate(self.simulation.t.tolist())
        self._add([i for i, t in times if self.rows[i] and t > self.rows[i][-1].t])

    def _add(self, boats: list[int]) -> None:
        sim = self.simulation
        for i in boats:
            now = sim.t.item(i), sim.reported[i].copy(), sim.z[i].copy(), sim.state[i].copy()
            self.rows[i].append(Recorded(*now))


class Spec(EnvSpec):
    """What Gymnasium knows of an environment, with errors that name the remedy."""

    def to_json(self) -> str:
        """Return it as JSON, where no option is an object that has none."""
        plain = {
            name: value.tolist() if isinstance(value, (np.generic, np.ndarray)) else value
            for name, value in self.kwargs.items()
        }
        without = []
        for name, value in plain.items():
            try:
                EnvSpec.to_json(dataclasses.replace(self, kwargs={name: value}))
            except TypeError:
                without.append(name)
        if without:
            raise UsvTwinError(
                f"spec.to_json(): {' and '.join(without)} of gym.make: an object that has no JSON; "
                "give a vessel by its name or file, a task as 'module:Class'"
            )
        return EnvSpec.to_json(dataclasses.replace(self, kwargs=plain))


class BoatsAtSea:
    """What single and vector environments have in common.

    Attributes
    ----------
    episodes : Episodes
        The boats; ``simulation``, ``task``, ``vessel``, ``seas`` and ``speed`` are theirs.
    observation_names : tuple of str
        What each entry of an observation is.
    """

    metadata: dict[str, Any]

    _spec: Spec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """What made it, where that was Gymnasium."""
        return self._spec

    @spec.setter
    def spec(self, given: EnvSpec | None) -> None:
        parts = [] if given is None else [one.name for one in dataclasses.fields(given) if one.init]
        self._spec = Spec(**{name: getattr(given, name) for name in parts}) if parts else None

    def _set_up(
        self,
        episodes: Episodes,
        observer: Callable[[Episodes], Observer] | None,
        record: bool,
        render_mode: str | None,
        render_size: tuple[int, int],
    ) -> tuple[spaces.Box, spaces.Box]:
        """Add renderer, recorder and observer; return the spaces of actions and observations."""
        if not isinstance(record, bool):
            raise UsvTwinError(f"record = {record!r}: must be True or False")
        self.episodes = episodes
        self.simulation, self.task = episodes.simulation, episodes.task
        self.vessel, self.seas, self.speed = episodes.vessel, episodes.seas, episodes.speed
        self.observer = observer(episodes) if observer else None
        self.metadata = {**self.metadata, "render_fps": fps_of(episodes)}
        self.render_mode = render_mode
        self.renderer = Renderer.of(episodes, self.observer, render_mode, render_size)
        self.recorder = Recorder(episodes) if record else None
        callbacks = self.observer, self.renderer, self.recorder
        self._callbacks = tuple(one for one in callbacks if one is not None)
        names = episodes.observation + (self.observer.names if self.observer else ())
        self._selection = self.observer.selection if self.observer else None
        self.observation_names = self._selection.names if self._selection else names
        # entries of the observations, shown or not
        self._obs_shape = episodes.n, len(names)
        return spaces_of(episodes, self.observation_names)

    def get_state(self) -> bytes:
        """Return all that the next steps depend on, generators and twins included.

        Wrappers keep what is theirs, such as the steps that a time limit has counted; copies
        (``copy.deepcopy``, ``pickle``) hold that as well.
        """
        return packed((self._kind(), vars(self)))

    def set_state(self, state: bytes) -> None:
        """Go on from what :meth:`get_state` of this environment, or of one like it, returned.

        UsvTwinError: it is no such state, or that of an environment with other options.
        """
        try:
            kind, found = unpacked(state)
        except Exception as error:  # bytes of anything may raise anything
            raise UsvTwinError(
                f"set_state takes what get_state returned, not {state!r:.40}: {error}"
            ) from None
        own = self._kind() if "episodes" in vars(self) else kind
        if other := [name for name in own if kind[name] != own[name]]:
            raise UsvTwinError(
                f"set_state: the state is that of another environment; {' and '.join(other)} differ"
            )
        vars(self).update(found)

    def _kind(self) -> dict[str, Any]:
        """Return what environments must have in common to take each other's states."""
        return {
            "vessel": self.vessel.name,
            "sea": repr(self.seas),
            "task": type(self.task).__name__,
            "num_envs": self.episodes.n,
            "observation": self.observation_names,
            "observer": type(self.observer).__name__,
            "options": [one.tobytes() for one in self.episodes.shared],
        }

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Return how a copy is made, for :mod:`copy` and :mod:`pickle`."""
        return _copied, (type(self), self.get_state())


def _copied(kind: type[BoatsAtSea], state: bytes) -> BoatsAtSea:
    """Return an environment that goes on from a state."""
    env = kind.__new__(kind)
    env.set_state(state)
    return env


class USVEnv(BoatsAtSea, gym.Env[np.ndarray, np.ndarray]):
    """An unmanned surface vessel in wind and waves, observed through its sensors.

    Description
    -----------
    A ship after the MMG standard method (by default the paper's: 7.5 m, two propellers on
    steerable drives) sails in Blendermann wind and irregular waves. The agent sees a GPS, a compass
    and an IMU that are noisy, biased, late and may drop out; it never sees the truth.
    ``USVTwin-v0`` adds what a digital twin makes of the same sensors; see
    :class:`twin.sim.wrapper.TwinObservation`.

    Action
    ------
    ``Box(-1, 1, (2,), float32)``; more is cut off, NaN is an error.

    = ================================ ========================================
    0 shaft speed of both propellers   1 is ``shaft_speed_service`` of the vessel; < 0 astern
    1 angle of both drives             1 is ``steer_max``; > 0 turns to starboard
    = ================================ ========================================

    ``actions="units"`` gives one for each actuator: left and right shaft, then left and right drive
    or rudder. A single unit has one of each. A fixed pair of thrusters has shafts only; the common
    angle then speeds one up and slows the other.

    Observation
    -----------
    ``Box(-10, 10, (23,), float32)``, and more behind it with other observation sets, see
    :func:`twin.sim.wrapper.make_env`. A sensor without a new sample shows its last one.
    ``observation_names`` has a name for each entry.

    ====== ======================================== =============
    entry  what                                     unit of 1.0
    ====== ======================================== =============
    0-1    cosine and sine of the compass heading
    2      yaw rate                                 rad/s
    3-4    specific force, forward and starboard    g
    5-6    GPS velocity, forward and starboard      nominal speed
    7-9    new sample of GPS, compass, IMU since
           the last decision                        yes
    10-12  age of the last sample of each           10 s
    13-14  commanded shaft speeds, left, right      service speed
    15-16  commanded drive angles, left, right      steer_max
    17     last fix to starboard of the leg         10 m
    18     last fix to the next way point           100 m
    19-20  cosine, sine: course of leg - heading
    21-22  cosine, sine: turn to the next leg
    ====== ======================================== =============

    10 and 100 m are 4/3 and 13 lengths of a boat for which that is more.

    With ``dof=6`` the sensors of roll, pitch and heave follow, and shift what comes behind:

    ====== ======================================== =============
    23-24  roll rate, pitch rate                    rad/s
    25     specific force, down                     g
    26-27  roll, pitch of the AHRS                  10 deg
    28-29  GNSS position and speed, down            10 m, m/s
    30     new sample of the AHRS                   yes
    31     its age                                  10 s
    ====== ======================================== =============

    Sensors with an anemometer (``suite="best"``, or ``wind_rate`` of a ``SensorSuite`` above 0) add
    four more behind those, ``wind_ahead`` to ``wind_age``:

    = ================================================ =============
    0 apparent wind from ahead                         10 m/s
    1 and from starboard                               10 m/s
    2 new sample of the anemometer                     yes
    3 its age                                          10 s
    = ================================================ =============

    Reward
    ------
    That of the task, see :data:`usv_gym.envs.tasks.TASKS`; ``info["reward_terms"]`` has the parts.
    It comes from the truth, as ``info["cross_track_m"]`` does; the observation's path errors
    come from what is known on board.

    What was drawn
    --------------
    ``info["drawn"]`` of a reset has what the episode was given: ``vessel`` (its name),
    ``vessel_factors`` (see :class:`usv_gym.vessel.variation.Factors`), ``load``,
    ``hs_m``, ``wind_mps``, ``wind_from_deg``, ``current_mps``, ``current_to_deg``, ``heading_deg``
    and ``faults`` (a text). No observation shows it.

    Start and end
    -------------
    Straight ahead, to the north but for ``heading_deg``, at the speed of
    ``shaft_speed_manoeuvring``. The task ends
    the episode, and so does capsizing (``dof=6``; ``info["capsized"]``); ``USVTwin-v0``
    truncates it after 2400 decisions (120 s with ``frame_skip=1``), see ``max_episode_steps`` of
    ``gym.make``.

    Version history
    ---------------
    * v0: first.

    Parameters
    ----------
    record : bool
        Keep every row, for :func:`twin.sim.wrapper.log_of`.
    observer : callable, optional
        Returns, for the :class:`~usv_gym.envs.episodes.Episodes`, what adds to the observation.
    render_mode : str, optional
        ``"rgb_array"``: :meth:`render` returns a picture from above. ``"human"``: a window
        shows each decision. Both need the extra ``render``.
    render_size : tuple of int
        Width and height of a picture, pixels; at least 400 x 360.
    **options
        Those of :class:`~usv_gym.envs.config.EnvConfig`: vessel, sea, sensors, faults, task,
        actions and time steps.
    """

    metadata = {  # noqa: RUF012 - Gymnasium's attribute
        "render_modes": RENDER_MODES,
        "render_fps": 20,
    }

    def __init__(
        self,
        *,
        record: bool = False,
        observer: Callable[[Episodes], Observer] | None = None,
        render_mode: str | None = None,
        render_size: tuple[int, int] = RENDER_SIZE,
        **options: Any,
    ) -> None:
        own = "record", "render_mode", "render_size"
        episodes = Episodes(1, EnvConfig.of(options, own))
        self.action_space, self.observation_space = self._set_up(
            episodes, observer, record, render_mode, render_size
        )
        self._shape = (episodes.width,)
        self._action = episodes.actions[1, 0]
        self._progress = episodes.memory[0, : record_size(TASK)]
        self._terms = [(name, _TERMS + k) for k, name in enumerate(self.task.terms)]
        self._time = self.simulation.t
        self._started = False

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
            raise UsvTwinError(f"unknown reset options: {', '.join(map(str, options))}")
        obs = np.empty(self._obs_shape, np.float32)
        self.episodes.reset(0, self.np_random, obs[0])
        self._started = True
        if self.observer:
            self.observer.reset(0)
            self.observer.observe(obs)
        if self.recorder:
            self.recorder.reset(0)
        self._show()
        info = self._info(self._progress.tolist())
        info["drawn"] = self.episodes.worlds.drawn(0)
        return self._shown(obs), info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Sail for one decision; see :meth:`gymnasium.Env.step`.

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
            values = np.asarray(action)
            if values.dtype is not _FLOAT32:
                values = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError):
            raise UsvTwinError(f"action {action!r} is not an array of numbers") from None
        if values.shape != self._shape:
            raise UsvTwinError(
                f"action has shape {values.shape}; it must be {self._shape}: "
                "see the action table of usv_gym.envs.env.USVEnv"
            )
        self._action[...] = values
        obs = np.empty(self._obs_shape, np.float32)
        if not self.episodes.step(obs, self._callbacks):
            raise UsvTwinError(
                f"action {values} holds NaN or infinity; every entry must lie in [-1, 1]"
            )
        if self.renderer:
            self._show()
        progress = self._progress.tolist()
        terminated = progress[_TERMINATED] != 0.0
        return self._shown(obs), progress[_REWARD], terminated, False, self._info(progress)

    def render(self) -> Frame | None:  # type: ignore[override]
        """Return a picture, shape (height, width, 3), if the mode is ``"rgb_array"``."""
        frames = pictures(self.renderer, self._started)
        return frames[0] if frames else None

    def close(self) -> None:
        """Close the window."""
        if self.renderer:
            self.renderer.close()

    def _shown(self, obs: np.ndarray) -> np.ndarray:
        """Return what the agent sees of the full observation (1, D)."""
        return (self._selection.pick(obs) if self._selection else obs).ravel()

    def _show(self) -> None:
        if self.renderer and not self.renderer.waits:
            self.renderer.look()

    def _info(self, progress: list[float]) -> dict[str, Any]:
        info = {
            "t_s": self._time.item(0),
            "cross_track_m": progress[_ERRORS],
            "leg": int(progress[_LEG]),
            "is_success": progress[_SUCCESS] != 0.0,
            "capsized": progress[_CAPSIZED] != 0.0,
            "reward_terms": {name: progress[at] for name, at in self._terms},
        }
        if self.observer:
            info |= self.observer.first_infos()
        return info


def spaces_of(episodes: Episodes, names: Sequence[str]) -> tuple[spaces.Box, spaces.Box]:
    """Return the spaces of actions and observations of one boat.

    The first knows the ``options`` of the environment that make it what it is, the second the
    ``names`` of its entries: an agent that is saved with its spaces says what it is for.
    """
    acting = spaces.Box(-1.0, 1.0, (episodes.width,), np.float32)
    seen = spaces.Box(-BOUND, BOUND, (len(names),), np.float32)
    vars(acting)["options"], vars(seen)["names"] = dict(episodes.options), (*names,)
    return acting, seen
