"""The observation wrapper: what the twin believes and predicts, for agents and controllers."""

from __future__ import annotations

import operator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from twin.log import Log, beside
from twin.observer import HORIZONS, TWIN_OBSERVATION, TwinObserver, observer_of
from twin.particulars import Particulars
from twin.predictor import Predictor
from twin.registry import DEFAULT
from twin.simulated import TRUE_STATE, measurement_row, particulars_of
from twin.twin import Twin
from usv_gym.env import USVEnv
from usv_gym.episodes import BOUND, OBSERVATION
from usv_gym.vector import USVVectorEnv, masked

__all__ = [
    "HORIZONS",
    "TWIN_OBSERVATION",
    "TwinObservation",
    "USVTwinEnv",
    "USVTwinVectorEnv",
    "log_of",
    "make_env",
    "make_vector_env",
]


SIZE = len(OBSERVATION) + len(TWIN_OBSERVATION)
"""Numbers in an observation with the twin's part."""


def _space() -> spaces.Box:
    return spaces.Box(-BOUND, BOUND, (SIZE,), np.float32)


def _look(observer: TwinObserver, obs: np.ndarray, info: dict[str, Any]) -> None:
    """Let the twin of one boat see this step, and write its part of the observation and info."""
    observer.observe(obs[None])
    info["twin_position_error_m"] = observer.off.item(0)


def _show(env: Any) -> None:
    """Let the pictures know of this step, now that the twin has seen it."""
    if env.renderer:
        env.renderer.look()


class TwinObservation(
    gym.Wrapper[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    gym.utils.RecordConstructorArgs,
):
    """Append to the observation what a digital twin makes of the same sensors.

    The twin sees the measurements and the commands of the wrapped :class:`USVEnv`, as it
    would on board; it never sees the truth. These 67 entries follow those of the
    environment, each in ``[-10, 10]``:

    ====== ============================================== ================
    entry  what                                           unit of 1.0
    ====== ============================================== ================
    0-1    speed forward and to starboard                 usual speed
    2      yaw rate                                       rad/s
    3-4    cosine and sine of the heading
    5-6    distance to starboard of the leg, and to go    10 m, 100 m
    7-8    cosine, sine: course of leg - heading
    9-14   standard deviations: forward, starboard        10 m
           (position), heading, speeds, yaw rate          rad, usual speed, rad/s
    ====== ============================================== ================

    and then, 1, 2, 5 and 10 s ahead under the present command, thirteen each:

    ====== ============================================== ================
    0-1    place forward and to starboard of here         usual speed * horizon
    2-3    cosine and sine of the turn until then
    4-6    speeds and yaw rate then                       usual speed, rad/s
    7-12   standard deviations as above                   as above
    ====== ============================================== ================

    Validity and age of each signal stand in the environment's own part. ``info`` gains
    ``twin_position_error_m``, the distance of the believed from the true position: for
    grading, never for an agent.

    Parameters
    ----------
    env : gymnasium.Env
        An environment over :class:`usv_gym.env.USVEnv`.
    twin : str or Predictor
        A name in ``twin.PREDICTORS``, or a predictor.
    particulars : Particulars, optional
        What the twin is told of the boat; that of the vessel if left out.
    band_period : float
        The standard deviations ahead are renewed this often, s; 0 for every step. The means, and
        how unsure the twin is now, are new in every step. (With ``ukf`` the means cost 10 us,
        the standard deviations ahead 0.3 ms; with ``dsw-ukf-plus`` 15 us and 2 ms.)
    seed : int
        For predictors that draw random numbers.
    """

    def __init__(
        self,
        env: gym.Env[np.ndarray, np.ndarray],
        twin: str | Predictor = DEFAULT,
        *,
        particulars: Particulars | None = None,
        band_period: float = 5.0,
        seed: int = 0,
    ) -> None:
        gym.utils.RecordConstructorArgs.__init__(
            self, twin=twin, particulars=particulars, band_period=band_period, seed=seed
        )
        gym.Wrapper.__init__(self, env)
        base = env.unwrapped
        if not isinstance(base, USVEnv):
            raise TypeError(
                f"TwinObservation wraps environments over USVEnv, not {type(base).__name__}"
            )
        if env.observation_space.shape != (len(OBSERVATION),):
            raise TypeError(
                "TwinObservation comes before other observations are made of it, and only once; "
                "gym.make('USVTwin-v0', twin=None) gives an environment without a twin"
            )
        self._observer = observer_of(base.episodes, twin, particulars, band_period, seed)
        self.twin = self._observer.first
        self.observation_space = _space()
        if base.renderer:
            base.renderer.belief = self._observer.belief

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode with a twin that knows nothing yet."""
        obs, info = self.env.reset(seed=seed, options=options)
        self._observer.reset(0)
        return self._with_twin(obs, info), info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Sail one step, and let the twin see it."""
        obs, reward, terminated, truncated, info = self.env.step(action)
        return self._with_twin(obs, info), float(reward), terminated, truncated, info

    def _with_twin(self, obs: np.ndarray, info: dict[str, Any]) -> np.ndarray:
        whole = np.empty(SIZE, np.float32)
        whole[: len(obs)] = obs
        _look(self._observer, whole, info)
        _show(self.unwrapped)
        return whole


class USVTwinEnv(USVEnv):
    """``USVTwin-v0``: :class:`USVEnv` and the twin's part of the observation in one.

    Actions, reward, start and end are those of :class:`usv_gym.env.USVEnv`; the observation
    is that of :class:`TwinObservation`, 90 numbers in all.

    Parameters
    ----------
    twin, particulars, band_period, twin_seed
        As for :class:`TwinObservation`, with ``twin_seed`` for ``seed``.
    **kwargs
        As for :class:`usv_gym.env.USVEnv`.
    """

    def __init__(
        self,
        *,
        twin: str | Predictor = DEFAULT,
        particulars: Particulars | None = None,
        band_period: float = 5.0,
        twin_seed: int = 0,
        **kwargs: Any,
    ) -> None:
        super().__init__(**kwargs)
        self._observer = observer_of(self.episodes, twin, particulars, band_period, twin_seed)
        self.twin = self._observer.first
        self.observation_space = _space()
        self._size = SIZE
        if self.renderer:
            self.renderer.belief = self._observer.belief

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; see :meth:`USVEnv.reset`."""
        obs, info = super().reset(seed=seed, options=options)
        self._observer.reset(0)
        _look(self._observer, obs, info)
        _show(self)
        return obs, info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Sail one step; see :meth:`USVEnv.step`."""
        obs, reward, terminated, truncated, info = super().step(action)
        _look(self._observer, obs, info)
        _show(self)
        return obs, reward, terminated, truncated, info


class USVTwinVectorEnv(USVVectorEnv):
    """``num_envs`` of :class:`USVTwinEnv` in one, each bit for bit what it is alone.

    Parameters
    ----------
    num_envs : int
        Number of boats.
    twin, particulars, band_period, twin_seed
        As for :class:`USVTwinEnv`; every boat gets a twin of its own. Those of ``"ukf"`` and
        ``"dsw-ukf-plus"`` run in one compiled call.
    **kwargs
        As for :class:`usv_gym.vector.USVVectorEnv`.
    """

    def __init__(
        self,
        num_envs: int,
        *,
        twin: str | Predictor = DEFAULT,
        particulars: Particulars | None = None,
        band_period: float = 5.0,
        twin_seed: int = 0,
        **kwargs: Any,
    ) -> None:
        super().__init__(num_envs, **kwargs)
        self._observer = observer_of(self.episodes, twin, particulars, band_period, twin_seed)
        self._set_spaces(self.single_action_space, _space())
        self._obs = np.zeros(self.observation_space.shape or (), np.float32)
        if self.renderer:
            self.renderer.belief = self._observer.belief

    def twin(self, i: int) -> Twin:
        """Return the twin of boat i as of now: a copy, which does not live on with the boat."""
        if not 0 <= operator.index(i) < self.num_envs:
            raise IndexError(f"twin({i}): boats count from 0 to {self.num_envs - 1}")
        return self._observer.twin(operator.index(i))

    def _begin(self, mask: np.ndarray) -> None:
        super()._begin(mask)
        for i in np.flatnonzero(mask):
            self._observer.reset(int(i))
            self._observer.observe(self._obs, slice(int(i), int(i) + 1))

    def _advance(self) -> None:
        super()._advance()
        self._observer.observe(self._obs)

    def _infos(self, mask: np.ndarray | None) -> dict[str, Any]:
        infos = super()._infos(mask)
        off = {"twin_position_error_m": self._observer.off}
        return infos | masked(off, mask, self.num_envs)


def make_env(*, twin: str | Predictor | None = DEFAULT, **kwargs: Any) -> USVEnv:
    """Make ``USVTwin-v0``: the vessel at sea, with or without a twin.

    Parameters
    ----------
    twin : str or Predictor or None
        A name in ``twin.PREDICTORS``, a predictor, or None for the plain environment.
    **kwargs
        See :class:`USVTwinEnv` and :class:`usv_gym.env.USVEnv`.
    """
    return USVEnv(**kwargs) if twin is None else USVTwinEnv(twin=twin, **kwargs)


# where gym.make looks for the modes, to offer "rgb_array_list" as well
make_env.metadata = USVEnv.metadata  # type: ignore[attr-defined]


def make_vector_env(
    num_envs: int = 1, *, twin: str | Predictor | None = DEFAULT, **kwargs: Any
) -> USVVectorEnv:
    """Make ``num_envs`` of ``USVTwin-v0`` in one, for ``gym.make_vec``.

    Parameters
    ----------
    num_envs : int
        Number of boats.
    twin : str or Predictor or None
        As for :func:`make_env`.
    **kwargs
        See :class:`USVTwinVectorEnv` and :class:`usv_gym.vector.USVVectorEnv`.
    """
    if twin is None:
        return USVVectorEnv(num_envs, **kwargs)
    return USVTwinVectorEnv(num_envs, twin=twin, **kwargs)


def log_of(env: gym.Env[Any, Any], path: str | Path | None = None) -> Log:
    """Return the episode so far as a log, with the truth.

    Parameters
    ----------
    env : gymnasium.Env
        Made with ``record=True``.
    path : str or Path, optional
        Write it there as well, with the particulars beside it.

    Raises
    ------
    ValueError
        Without ``record=True``, or before the first reset.
    """
    base = env.unwrapped
    if not isinstance(base, USVEnv) or not base.history:
        raise ValueError("make the environment with record=True, and reset it, to get its log")
    rows = np.array(base.history)
    log = Log(
        t=rows[:, 0],
        cmd=rows[:, 1:5],
        z=np.array([measurement_row(row[5:13]) for row in rows]),
        truth=rows[:, 13:][:, list(TRUE_STATE)],
        name=f"{base.vessel.name}_episode",
    )
    if path is not None:
        log.write(path)
        particulars = particulars_of(base.vessel, base.simulation.suite, base.simulation.dof)
        beside(path, ".toml").write_text(particulars.to_toml(), encoding="utf-8")
    return log
