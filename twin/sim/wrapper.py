"""The observation wrapper: what the twin estimates and predicts, for agents and controllers."""

from __future__ import annotations

import dataclasses
import inspect
import operator
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import gymnasium as gym
import numpy as np

from twin.digital_twin import Twin
from twin.logs.log import Log
from twin.particulars import Particulars
from twin.predictors.base import Predictor
from twin.predictors.registry import DEFAULT
from twin.sim.batched_twins import TWIN_SETS, TwinObserver, TwinOptions
from twin.sim.bridge import (
    TRUE_STATE,
    VERTICAL,
    measurement_row,
    particulars_of,
    with_deck_point,
    write_run,
)
from twin.sim.compact import COMPACT_SETS, SCALED, set_of, shows_forecast
from twin.sim.mixed_twins import MixedTwins, observer_of
from usv_gym.envs.config import EnvConfig
from usv_gym.envs.env import USVEnv, spaces_of
from usv_gym.envs.episodes import Episodes, Observer
from usv_gym.envs.observation import OBSERVERS
from usv_gym.envs.selection import Scaled, with_selection
from usv_gym.envs.vector import USVVectorEnv
from usv_kernel.errors import (
    ArgumentError,
    BoatIndexError,
    UsvTwinError,
    check_options,
    did_you_mean,
)

__all__ = [
    "OBSERVATIONS",
    "TwinObservation",
    "USVTwinEnv",
    "USVTwinVectorEnv",
    "log_of",
    "make_env",
    "make_vector_env",
]

_Env = TypeVar("_Env")


class TwinObservation(
    gym.Wrapper[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    gym.utils.RecordConstructorArgs,
):
    """Append to the observation what a digital twin makes of the same sensors.

    The twin sees the measurements and the commands of the wrapped :class:`USVEnv`, as it
    would on board; it never sees the truth. These 69 entries follow those of the
    environment, each in ``[-10, 10]``:

    ====== ============================================== ================
    entry  what                                           unit of 1.0
    ====== ============================================== ================
    0-1    speed forward and to starboard                 nominal speed
    2      yaw rate                                       rad/s
    3-4    cosine and sine of the heading
    5-6    distance to starboard of the leg, and to go    10 m, 100 m
    7-8    cosine, sine: course of leg - heading
    9-10   cosine, sine: turn to the next leg
    11-16  standard deviations: forward, starboard        10 m
           (position), heading, speeds, yaw rate          rad, nominal speed, rad/s
    ====== ============================================== ================

    and then, 1, 2, 5 and 10 s ahead under the present command, thirteen each; these are what
    ``twin.predict("hold", dt=0.5)`` says:

    ====== ============================================== ================
    0-1    place forward and to starboard of here         nominal speed * horizon
    2-3    cosine and sine of the turn until then
    4-6    speeds and yaw rate then                       nominal speed, rad/s
    7-9    standard deviations: forward, starboard        nominal speed * horizon
           (position), heading                            rad
    10-12  standard deviations: speeds, yaw rate          nominal speed, rad/s
    ====== ============================================== ================

    Validity and age of each signal stand in the environment's own part. ``info`` gains
    ``twin_position_error_m``, the distance of the twin's from the true position: for
    grading, never for an agent. For each sensor it gains ``twin_health_gps`` and so on, the
    place of its status in ``twin.integrity.state.STATUSES``; ``twin.health`` says it in words.
    ``twin_forecast`` grades the twin's forecasts on the episode so far, that of the last step on
    all of it: a mapping of names to floats, see :class:`twin.sim.forecast_scores.ForecastScores`.

    Parameters
    ----------
    env : gymnasium.Env
        An environment over :class:`usv_gym.envs.env.USVEnv`.
    twin : str or Predictor
        A name in ``twin.PREDICTORS``, or a predictor.
    particulars : Particulars, optional
        What the twin is given of the boat; that of the vessel if left out.
    band_period : float
        The standard deviations ahead are updated this often, s; 0 for every step. The means, and
        how unsure the twin is now, are new in every step. (With ``ukf`` the means cost 10 us,
        the standard deviations ahead 0.3 ms; with ``dsw-ukf-plus`` 15 us and 2 ms.)
    seed : int
        For predictors that draw random numbers.
    observation : str
        ``"twin"``, or with more entries ``"twin_params"``, ``"twin_health"`` or
        ``"twin_attitude"``; see :func:`make_env`.
    forecast_scores : bool
        Grade the forecasts. An environment with False, whose observation and pictures show none,
        makes none, which saves a sixth of its time.
    """

    def __init__(
        self,
        env: gym.Env[np.ndarray, np.ndarray],
        twin: str | Predictor = DEFAULT,
        *,
        particulars: Particulars | None = None,
        band_period: float = 5.0,
        seed: int = 0,
        observation: str = "twin",
        forecast_scores: bool = True,
    ) -> None:
        gym.utils.RecordConstructorArgs.__init__(
            self,
            twin=twin,
            particulars=particulars,
            band_period=band_period,
            seed=seed,
            observation=observation,
            forecast_scores=forecast_scores,
        )
        gym.Wrapper.__init__(self, env)
        base = env.unwrapped
        if not isinstance(base, USVEnv):
            raise ArgumentError(
                f"TwinObservation wraps environments over USVEnv, not {type(base).__name__}"
            )
        if env.observation_space.shape != (len(base.episodes.observation),):
            raise ArgumentError(
                "TwinObservation comes before other observations are made of it, and only once; "
                "gym.make('USVTwin-v0', twin=None) gives an environment without a twin"
            )
        if base.episodes.frame_skip > 1:
            raise ArgumentError(
                "TwinObservation wraps environments with frame_skip=1; with more, "
                "gym.make('USVTwin-v0', twin=..., frame_skip=...) has the twin built in"
            )
        options = TwinOptions(
            twin=twin,
            particulars=particulars,
            band_period=band_period,
            twin_seed=seed,
            observation=observation,
            forecast_scores=forecast_scores,
        )
        self._observer = observer_of(base.episodes, options)
        names = *base.episodes.observation, *self._observer.names
        self.observation_space = spaces_of(base.episodes, names)[1]
        self._renderer = base.renderer
        if self._renderer:
            self._renderer.overlay, self._renderer.waits = self._observer.overlay, True

    @property
    def twin(self) -> Twin:
        """The twin of this episode."""
        return self._observer.first

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
        whole = np.empty(self.observation_space.shape or (), np.float32)
        whole[: len(obs)] = obs
        self._observer.observe(whole[None])
        info |= self._observer.first_infos()
        if self._renderer:
            self._renderer.look()
        return whole


def _observed(observation: str | Sequence[str], options: dict[str, Any]) -> dict[str, Any]:
    """Return an environment's options with what makes its twins in place of the twins' options."""
    given = {name: options.pop(name) for name in TWIN_OPTIONS if name in options}
    name, wanted = resolved(observation)
    twins = TwinOptions(**given, observation=name if name in TWIN_SETS else "twin")
    pictures = options.get("render_mode") is not None
    read = twins.forecast_scores or pictures or wanted is None or shows_forecast(wanted)

    def made(episodes: Episodes) -> Observer:
        observer = observer_of(episodes, twins, name if name in OBSERVERS else "")
        if not read and name != "twin_attitude":  # roll is forecast from the motion ahead
            observer.leave_out_forecasts()
        return observer

    about = twins.particulars
    if about is not None and about.deck.point is not None and options.get("dof") == 6:
        options.setdefault("deck_point", about.deck.point)
    return options | {"observer": with_selection(made, wanted) if wanted is not None else made}


class USVTwinEnv(USVEnv):
    """``USVTwin-v0``: :class:`USVEnv` and the twin's part of the observation in one.

    Actions, reward, start and end are those of :class:`usv_gym.envs.env.USVEnv`; the observation
    is that of :class:`TwinObservation`, 92 numbers in all.

    Parameters
    ----------
    observation : str or sequence of str
        ``"twin"``, ``"twin_params"``, ``"twin_health"`` or ``"twin_attitude"``; see
        :func:`make_env`.
    **kwargs
        ``twin``, ``particulars``, ``band_period``, ``twin_seed`` and ``forecast_scores`` as for
        :class:`TwinObservation`, with ``twin_seed`` for ``seed``; ``twin_prior``, one of
        :data:`twin.sim.batched_twins.PRIORS`; others as for :class:`usv_gym.envs.env.USVEnv`.
    """

    def __init__(self, *, observation: str | Sequence[str] = "twin", **kwargs: Any) -> None:
        super().__init__(**_observed(observation, kwargs))

    @property
    def twin(self) -> Twin:
        """The twin of this episode."""
        assert isinstance(self.observer, (TwinObserver, MixedTwins))
        return self.observer.first


class USVTwinVectorEnv(USVVectorEnv):
    """``num_envs`` of :class:`USVTwinEnv` in one, each bit for bit what it is alone.

    Parameters
    ----------
    num_envs : int
        Number of boats.
    observation, **kwargs
        As for :class:`USVTwinEnv`; every boat gets a twin of its own. Those of ``"ukf"`` and
        ``"dsw-ukf-plus"`` run in one compiled call. Others as for
        :class:`usv_gym.envs.vector.USVVectorEnv`.
    """

    def __init__(
        self, num_envs: int, *, observation: str | Sequence[str] = "twin", **kwargs: Any
    ) -> None:
        super().__init__(num_envs, **_observed(observation, kwargs))

    def twin(self, i: int) -> Twin:
        """Return the twin of boat i as of now: a copy, which does not live on with the boat."""
        if not 0 <= operator.index(i) < self.num_envs:
            raise BoatIndexError(f"twin({i}): boats count from 0 to {self.num_envs - 1}")
        assert isinstance(self.observer, (TwinObserver, MixedTwins))
        return self.observer.twin(operator.index(i))


TWIN_OPTIONS = tuple(
    item.name for item in dataclasses.fields(TwinOptions) if item.name != "observation"
)
"""Names of the options of twins."""

OBSERVATIONS = (*OBSERVERS, *TWIN_SETS, *COMPACT_SETS)
"""Names of the observation sets."""


def resolved(observation: str | Sequence[str]) -> tuple[str, Sequence[str | Scaled] | None]:
    """Return the set that an observation is made of, and what of it is shown; None: all of it.

    UsvTwinError: there is no such set, or no set has all the entries.
    """
    if isinstance(observation, str):
        if observation in COMPACT_SETS:
            return COMPACT_SETS[observation]
        if observation in (*OBSERVERS, *TWIN_SETS):
            return observation, None
    names = isinstance(observation, Sequence) and not isinstance(observation, str)
    if not names or not all(isinstance(name, str) for name in observation):
        known = ", ".join(OBSERVATIONS)
        hint = did_you_mean(observation, OBSERVATIONS) if isinstance(observation, str) else ""
        raise UsvTwinError(
            f"observation = {observation!r}{hint}; known: {known}, or a list of entries"
        )
    for name in observation:
        if name in OBSERVATIONS:
            raise UsvTwinError(
                f"observation: there is no entry {name!r}; for the set, write observation={name!r}"
            )
    return set_of(list(observation)), [SCALED.get(name, name) for name in observation]


def _keywords(kind: Callable[..., Any]) -> list[str]:
    """Return the names of the arguments that a class itself takes."""
    return [
        one.name
        for one in inspect.signature(kind).parameters.values()
        if one.kind is not one.VAR_KEYWORD and one.name != "observer"
    ]


def _made(
    plain: Callable[..., _Env],
    with_twin: Callable[..., _Env],
    observation: str | Sequence[str] | None,
    twin: str | Predictor | None,
    options: dict[str, Any],
) -> _Env:
    """Return an environment of the one class or the other; the options are checked here."""
    own = _keywords(plain)
    known = ["observation", *TWIN_OPTIONS, "max_episode_steps", *own, *EnvConfig.names()]
    check_options("USVTwin-v0", options, list(dict.fromkeys(known)))
    if observation is None:
        observation = "raw" if twin is None else "twin"
    name, wanted = resolved(observation)
    if not isinstance(options.get("forecast_scores", True), bool):
        raise UsvTwinError(f"forecast_scores = {options['forecast_scores']!r}: True or False")
    if name in OBSERVERS:
        if options.get("forecast_scores") and twin is not None:
            return with_twin(twin=twin, observation=observation, **options)
        options.pop("forecast_scores", None)
        idle = [name for name in options if name in TWIN_OPTIONS]
        if idle:
            raise ArgumentError(f"{', '.join(idle)}: observation = {observation!r} runs no twin")
        make = OBSERVERS[name]
        return plain(
            observer=with_selection(make, wanted) if wanted is not None else make, **options
        )
    if twin is None:
        raise UsvTwinError(f"observation = {observation!r} needs a twin; twin=None gives none")
    return with_twin(twin=twin, observation=observation, **options)


def make_env(
    *,
    observation: str | Sequence[str] | None = None,
    twin: str | Predictor | None = DEFAULT,
    **kwargs: Any,
) -> USVEnv:
    """Make ``USVTwin-v0``: the vessel at sea, with or without a twin.

    Parameters
    ----------
    observation : str or sequence of str, optional
        What the agent sees, by the name of a set or as a list of names of entries:

        - ``"raw"``: the sensors, see :class:`usv_gym.envs.env.USVEnv`;
        - ``"raw_stacked"``: the same, and behind it those of the seven decisions before;
        - ``"twin"``: the same, and behind it estimate and predictions of the twin, see
          :class:`TwinObservation`;
        - ``"twin_params"``: and behind that the identified parameters and their standard
          deviations, both in units of the standard deviations that they had at the start;
        - ``"twin_health"``: ``"twin"``, and behind it how far the twin trusts GPS, compass, gyro,
          accelerometers and commands, one entry each: 1 ok, 0.5 doubtful, 0 excluded or absent;
        - ``"twin_attitude"``: ``"twin"``, and behind it roll, pitch and heave, their forecasts at
          0.5, 1, 2, 3 and 5 s with half the width of their 90 % intervals, the probabilities that
          the deck stays quiet for 2, 3 and 5 s, and height, period and direction of the waves.
          Angles are in units of 10 degrees, rates in rad/s, lengths in m, speeds in m/s, the period
          in 10 s; it needs ``dof=6``;
        - ``"compact"``: fourteen entries of the sensors and the twin, scaled to one size, for
          agents that learn quickly; ``"compact_params"`` adds eight identified coefficients and
          their standard deviations. ``"compact_raw"`` and ``"compact_oracle"`` are the same of the
          sensors alone and, for comparison, of the truth alone;
        - ``"oracle"``: ``"raw"``, and behind it the truth, for comparison only. It is speeds, yaw
          rate, heading, errors of the path, shaft speeds and drive angles, in the units of those
          sets.

        Left out, it is ``"twin"``, or ``"raw"`` with ``twin=None``. ``observation_names`` of the
        environment has a name for each entry.
    twin : str or Predictor or None
        A name in ``twin.PREDICTORS``, a predictor, or None for the plain environment. It is not
        run where the observation has no part of it, but with ``forecast_scores=True``: then it
        runs beside the agent, which does not see it, and its forecasts are graded in ``info``.
    **kwargs
        See :class:`USVTwinEnv` and :class:`usv_gym.envs.env.USVEnv`.
    """
    return _made(USVEnv, USVTwinEnv, observation, twin, kwargs)


class _RenderModes(list[str]):
    """Modes for gym.make, which makes ``rgb_array_list`` itself.

    All else is left to the environment: its error names value and remedy.
    """

    def __contains__(self, mode: object) -> bool:
        return not (isinstance(mode, str) and mode.endswith("_list"))


# where gym.make looks for the modes, to offer "rgb_array_list" as well
make_env.metadata = {  # type: ignore[attr-defined]
    **USVEnv.metadata,
    "render_modes": _RenderModes(USVEnv.metadata["render_modes"]),
}


def make_vector_env(
    num_envs: int = 1,
    *,
    observation: str | Sequence[str] | None = None,
    twin: str | Predictor | None = DEFAULT,
    **kwargs: Any,
) -> USVVectorEnv:
    """Make ``num_envs`` of ``USVTwin-v0`` in one, for ``gym.make_vec``.

    Parameters
    ----------
    num_envs : int
        Number of boats.
    observation, twin
        As for :func:`make_env`.
    **kwargs
        See :class:`USVTwinVectorEnv` and :class:`usv_gym.envs.vector.USVVectorEnv`.
    """
    options = {"num_envs": num_envs, **kwargs}
    return _made(USVVectorEnv, USVTwinVectorEnv, observation, twin, options)


def log_of(
    env: gym.Env[Any, Any] | gym.vector.VectorEnv[Any, Any, Any],
    path: str | Path | None = None,
    *,
    boat: int = 0,
    ended: bool = False,
) -> Log:
    """Return the episode so far as a log, with the truth.

    Parameters
    ----------
    env : gymnasium.Env or gymnasium.vector.VectorEnv
        Made with ``record=True``.
    path : str or Path, optional
        Write it there as well, with the particulars beside it.
    boat : int
        Which boat of a vector environment.
    ended : bool
        Return the episode before, which the present one has followed, as where a vector
        environment resets in the same step.

    Raises
    ------
    UsvTwinError
        Without ``record=True``, or before the first reset; with ``ended``, before the second.
    """
    base = env.unwrapped
    recorder = base.recorder if isinstance(base, (USVEnv, USVVectorEnv)) else None
    if recorder is None or not any(recorder.rows):
        raise UsvTwinError("make the environment with record=True, and reset it, to get its log")
    if not 0 <= operator.index(boat) < len(recorder.rows):
        raise BoatIndexError(f"boat = {boat}: boats count from 0 to {len(recorder.rows) - 1}")
    rows = (recorder.ended if ended else recorder.rows)[boat]
    if not rows:
        raise UsvTwinError(f"no episode of boat {boat} has ended yet; leave out ended=True")
    assert isinstance(base, (USVEnv, USVVectorEnv))
    kinds = recorder.ended_kinds if ended else recorder.kinds
    kind = base.episodes.kinds[kinds[boat]]
    vessel = kind.vessel
    log = Log(
        t=np.array([row.t for row in rows]),
        cmd=np.array([row.cmd for row in rows]),
        z=np.array([measurement_row(row.z) for row in rows]),
        truth=np.array([row.state[list(TRUE_STATE)] for row in rows]),
        true_motion=(
            np.array([row.state[list(VERTICAL)] for row in rows])
            if base.simulation.dof == 6
            else None
        ),
        name=f"{vessel.name}_episode",
    )
    if path is not None:
        particulars = particulars_of(vessel, base.simulation.suite, base.simulation.dof)
        if base.simulation.dof == 6:
            particulars = with_deck_point(particulars, kind.deck_point)
        write_run(log, particulars, Path(path))
    return log
