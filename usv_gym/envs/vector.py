"""Many environments in one: Gymnasium's vector interface over the same compiled step."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from usv_gym.envs.config import EnvConfig
from usv_gym.envs.env import BoatsAtSea
from usv_gym.envs.episodes import Episodes, Observer
from usv_gym.envs.render import RENDER_MODES, RENDER_SIZE, Frame, pictures
from usv_gym.envs.worlds import DRAWN
from usv_gym.world.simulation import BOATS_MAX
from usv_kernel.errors import ArgumentError, UsvTwinError, check_whole

__all__ = [
    "USVVectorEnv",
]

Info = dict[str, Any]


STEPS_MAX = 10**12
"""Longest episode, decisions."""


class USVVectorEnv(BoatsAtSea, VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """``num_envs`` of :class:`usv_gym.envs.env.USVEnv` in one, each bit for bit what it is alone.

    Parameters
    ----------
    num_envs : int
        Number of boats.
    max_episode_steps : int, optional
        Number of decisions after which an episode is truncated; None: never.
    autoreset_mode : AutoresetMode or str
        ``"NextStep"``: the step after an episode's end resets it, whatever the action.
        ``"SameStep"``: the step that ends it does; ``info["final_obs"]`` and
        ``info["final_info"]`` hold how it ended. ``"Disabled"``: reset it yourself, with
        ``options={"reset_mask": ...}``.
    render_mode : str, optional
        ``"rgb_array"``: :meth:`render` returns a picture of each boat. ``"human"``: a window
        shows the first boat.
    num_threads : int
        Threads that share the boats; worth it from some hundred boats on, and more so with twins.
        The results do not depend on it.
    observer : callable, optional
        As for :class:`usv_gym.envs.env.USVEnv`.
    record : bool
        Keep every row of each boat's episode, and of its episode before, for
        :func:`twin.sim.wrapper.log_of`.
    **options
        Those of :class:`~usv_gym.envs.config.EnvConfig`.

    Notes
    -----
    ``reset(seed=7)`` gives element i what ``reset(seed=7 + i)`` gives a single environment; a
    sequence of seeds gives each its own, and None goes on with its generator. Infos are arrays
    over the boats, with a mask ``_key`` beside each ``key``, as in Gymnasium's own. That holds for
    ``info["drawn"]`` as well, in resets and in steps that reset some boats.
    """

    metadata = {  # noqa: RUF012 - Gymnasium's attribute
        "render_modes": RENDER_MODES,
        "render_fps": 20,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    closed = True  # close() may be called before __init__ has ended

    def __init__(
        self,
        num_envs: int,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        num_threads: int = 1,
        observer: Callable[[Episodes], Observer] | None = None,
        record: bool = False,
        render_mode: str | None = None,
        render_size: tuple[int, int] = RENDER_SIZE,
        **options: Any,
    ) -> None:
        check_whole("num_envs", num_envs, 1, BOATS_MAX)
        if max_episode_steps is not None:
            check_whole("max_episode_steps", max_episode_steps, 1, STEPS_MAX)
        own = ["observation", "twin", "max_episode_steps", "autoreset_mode", "num_threads"]
        config = EnvConfig.of(options, own)
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError:
            modes = ", ".join(repr(mode.value) for mode in AutoresetMode)
            raise UsvTwinError(f"autoreset_mode = {autoreset_mode!r}; known: {modes}") from None
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.num_envs, self.max_episode_steps = int(num_envs), max_episode_steps
        episodes = Episodes(self.num_envs, config, threads=num_threads)
        self.single_action_space, self.single_observation_space = self._set_up(
            episodes, observer, record, render_mode, render_size
        )
        self.frame_skip = episodes.frame_skip
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._generators: list[np.random.Generator | None] = [None] * self.num_envs
        self._seeds = [-1] * self.num_envs
        self._obs = np.zeros(self._obs_shape, np.float32)
        self._over = np.zeros(self.num_envs, dtype=np.bool_)
        # steps after which each boat's episode is truncated
        self._limit = (max_episode_steps or math.inf) * self.frame_skip
        self._limits = np.full(self.num_envs, self._limit)
        self._not_reset = np.ones(self.num_envs, dtype=np.bool_)
        self.closed = False

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Seed of each boat's generator; -1 before the first reset."""
        return tuple(self._seeds)

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Generator of each boat."""
        return tuple(self._generator(i) for i in range(self.num_envs))

    def _generator(self, i: int, seed: int | None = None) -> np.random.Generator:
        generator = self._generators[i]
        if generator is None or seed is not None:
            generator, self._seeds[i] = seeding.np_random(seed)
            self._generators[i] = generator
        return generator

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, Info]:
        """Start episodes: all of them, or those of a mask.

        Parameters
        ----------
        seed : int, sequence of int, or None
            See the class.
        options : dict, optional
            ``"reset_mask"``: array of bool, shape (n,): only these are reset.
            ``"first_episode_steps"``: array of int, shape (n,): decisions after which the episodes
            that begin now are truncated. It replaces ``max_episode_steps``: boats need not end all
            at once.

        Returns
        -------
        ndarray, dict
            Observations (n, ...) of all boats, and infos of those that were reset.
        """
        self._refuse_closed()
        n = self.num_envs
        seeds: list[int | None]
        if seed is None:
            seeds = [None] * n
        elif isinstance(seed, (int, np.integer)):
            seeds = [int(seed) + i for i in range(n)]
        else:
            try:
                seeds = [None if one is None else operator.index(one) for one in seed]
            except TypeError:
                raise ArgumentError(
                    f"seed = {seed!r}: must be a whole number, one for each environment, or None"
                ) from None
        if len(seeds) != n:
            raise UsvTwinError(f"{len(seeds)} seeds for {n} environments; give one for each")
        if not isinstance(options, dict | None):
            raise ArgumentError(f"options = {options!r}: must be a dict or None")
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        limits = options.pop("first_episode_steps", None)
        if options:
            raise UsvTwinError(f"unknown reset options: {', '.join(map(str, options))}")
        if mask is None:
            mask = np.ones(n, dtype=np.bool_)
        if not (isinstance(mask, np.ndarray) and mask.dtype == np.bool_):
            kind = mask.dtype if isinstance(mask, np.ndarray) else type(mask).__name__
            raise ArgumentError(f"options['reset_mask'] must be an array of bool, not {kind}")
        if mask.shape != (n,) or not mask.any():
            raise UsvTwinError(
                f"options['reset_mask'] of shape {mask.shape} with {mask.sum()} set: must have "
                f"shape ({n},), and one or more set"
            )
        if limits is not None:
            limits = np.asarray(limits)
            if limits.shape != (n,) or limits.dtype.kind not in "iu" or (limits < 1).any():
                raise UsvTwinError(
                    "options['first_episode_steps'] must be an array of whole numbers, 1 or "
                    f"more, of shape ({n},)"
                )
        chosen = Chosen.of(mask)
        for i in chosen.numbers:
            self._generator(i, seeds[i])
        self._restart(chosen)
        if limits is not None:
            self._limits[mask] = limits[mask].astype(np.int64) * self.frame_skip
        self._over[mask] = False
        if self.renderer:
            self.renderer.look()
        return self._shown(), self._infos(chosen) | self._drawn(chosen)

    def _restart(self, chosen: Chosen) -> None:
        """Reset some boats, and write their observations."""
        for i in chosen.numbers:
            self.episodes.reset(i, self._generator(i), self._obs[i])
            if self.observer:
                self.observer.reset(i)
            if self.recorder:
                self.recorder.reset(i)
        if self.observer:
            for rows in chosen.runs:
                self.observer.observe(self._obs, rows=rows)
        for rows in chosen.runs:
            self._not_reset[rows] = False
            self._limits[rows] = self._limit

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Info]:
        """Sail for one decision; see :meth:`gymnasium.vector.VectorEnv.step`.

        Parameters
        ----------
        actions : array_like, shape (n, A)
            See :class:`usv_gym.envs.env.USVEnv`.

        Returns
        -------
        ndarray, ndarray, ndarray, ndarray, dict
            Observations (n, ...), rewards, terminations, truncations (n,), infos.
        """
        self._refuse_closed()
        if self._not_reset.any():
            raise gym.error.ResetNeeded("call reset() before step()")
        try:
            values = np.asarray(actions, dtype=np.float64)
        except (TypeError, ValueError):
            raise UsvTwinError("actions are not an array of numbers") from None
        shape = self.action_space.shape
        if values.shape != shape:
            raise UsvTwinError(
                f"actions have shape {values.shape}; it must be {shape}: see the action table of "
                "usv_gym.envs.env.USVEnv"
            )
        mode, over = self.autoreset_mode, self._over
        if mode == AutoresetMode.DISABLED and over.any():
            raise gym.error.ResetNeeded(
                f"the episodes of {np.flatnonzero(over).tolist()} are over: "
                "reset(options={'reset_mask': ...})"
            )
        late = over.copy()
        bad = ~np.isfinite(values).all(axis=1) & ~late
        if bad.any():
            raise UsvTwinError(
                f"action of {np.flatnonzero(bad).tolist()} holds NaN or infinity; every entry "
                "must lie in [-1, 1]"
            )
        begun = Chosen.of(late)
        if begun.runs:
            self._restart(begun)
            self.episodes.records["idle_steps"][late] = self.frame_skip
        self.episodes.actions[1] = values
        self.episodes.step(self._obs, self._callbacks)
        record = self.task.records
        rewards = record["reward"].copy()
        terminations = record["terminated"] != 0.0
        truncations = self.episodes.steps >= self._limits
        rewards[late] = 0.0
        over = terminations | truncations
        if mode == AutoresetMode.SAME_STEP and over.any():
            final = np.full(self.num_envs, None, dtype=object)
            shown = self._shown()
            for i in np.flatnonzero(over):
                final[i] = shown[i].copy()
            begun = Chosen.of(over)
            ended = self._infos(begun)
            self._restart(begun)
            infos = self._infos(None) | self._drawn(begun)
            infos |= {"final_obs": final, "_final_obs": over.copy()}
            infos |= {"final_info": ended, "_final_info": over.copy()}
            over = np.zeros_like(over)
        else:
            infos = self._infos(None) | self._drawn(begun)
        self._over = over
        if self.renderer:
            self.renderer.look()
        return self._shown(), rewards, terminations, truncations, infos

    def _shown(self) -> np.ndarray:
        """Return what the agents see of the observations, as a copy."""
        return self._selection.pick(self._obs) if self._selection else self._obs.copy()

    def render(self) -> tuple[Frame, ...] | None:  # type: ignore[override]
        """Return a picture of each boat if the mode is ``"rgb_array"``."""
        self._refuse_closed()
        return pictures(self.renderer, not self._not_reset.any())

    def _infos(self, chosen: Chosen | None) -> Info:
        """Return the infos of some boats, or of all of them."""
        record = self.task.records
        terms = {name: record["terms"][:, k] for k, name in enumerate(self.task.terms)}
        values = {
            "t_s": self.simulation.t,
            "cross_track_m": record["errors"][:, 0],
            "leg": record["leg"].astype(np.int64),
            "is_success": record["success"] != 0.0,
            "capsized": record["capsized"] != 0.0,
            **(self.observer.infos() if self.observer else {}),
        }
        infos = masked(values, chosen, self.num_envs)
        infos["reward_terms"] = masked(terms, chosen, self.num_envs)
        infos["_reward_terms"] = infos["_t_s"]
        return infos

    def _drawn(self, begun: Chosen) -> Info:
        """Return what was drawn of the episodes that begin now; nothing where none does."""
        if not begun.runs:
            return {}
        worlds, numbers = self.episodes.worlds, np.zeros((self.num_envs, len(DRAWN)))
        for rows in begun.runs:
            numbers[rows] = worlds.numbers[rows]
        drawn = masked(worlds.names, begun, self.num_envs)
        for k, name in enumerate(DRAWN):
            drawn[name], drawn[f"_{name}"] = numbers[:, k], drawn["_vessel"]
        return {"drawn": drawn, "_drawn": begun.mask.copy()}

    def _refuse_closed(self) -> None:
        if self.closed:
            raise gym.error.ClosedEnvironmentError("the environment was closed; make another one")

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads, and close the window."""
        self.episodes.close()
        if self.renderer:
            self.renderer.close()


class Chosen(NamedTuple):
    """Some of the boats."""

    mask: np.ndarray
    """Whether each is one of them (n,)."""
    numbers: list[int]
    runs: list[slice]
    """The same as slices, one for neighbours: they take less time than a mask."""

    @classmethod
    def of(cls, mask: np.ndarray) -> Chosen:
        """Return the boats of a mask."""
        numbers: list[int] = mask.nonzero()[0].tolist()
        runs: list[slice] = []
        for i in numbers:
            if runs and runs[-1].stop == i:
                runs[-1] = slice(runs[-1].start, i + 1)
            else:
                runs.append(slice(i, i + 1))
        return cls(mask, numbers, runs)


def masked(values: dict[str, np.ndarray], chosen: Chosen | None, n: int) -> Info:
    """Return infos as Gymnasium's vector environments do: each key, and where it holds."""
    if chosen is None:
        where, infos = np.ones(n, dtype=np.bool_), {key: values[key].copy() for key in values}
    else:
        where, infos = chosen.mask.copy(), {}
        for key, value in values.items():
            # elsewhere 0, or None
            shown = np.empty(n, object) if value.dtype.hasobject else np.zeros(n, value.dtype)
            for rows in chosen.runs:
                shown[rows] = value[rows]
            infos[key] = shown
    return infos | {f"_{key}": where for key in values}
