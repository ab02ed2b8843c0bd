"""How well something steers: episodes with fixed seeds, all at once, one row for each."""

from __future__ import annotations

import copy
import functools
import itertools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

import usv_gym  # noqa: F401 - registers the environment
from twin.agents.agent import Agent, interface_of
from twin.agents.controllers import CONTROLLERS, DOCKING
from twin.agents.hyperparameters import algorithm_class
from twin.agents.policy import AgentError, Policy
from twin.agents.weights import SIX_LINES, SavedPolicy
from twin.sim.wrapper import OBSERVATIONS, log_of
from usv_gym.envs.scoring import STATION
from usv_gym.envs.vector import USVVectorEnv
from usv_gym.world.channels import GPS_BIT
from usv_kernel.errors import UsvTwinError
from usv_kernel.files import import_named

__all__ = [
    "EVALUATION_SEEDS",
    "FIRST_TRAINING_SEED",
    "FRAME_SKIP",
    "OUTAGES",
    "SEAS",
    "agents_named",
    "evaluate",
    "log_name",
    "make_envs",
    "mean_scores",
    "on_grid",
    "trained_with",
]

SEAS = ("0", "2", "4")

OUTAGES = ("none", "gps10", "gps30", "gps60")

EVALUATION_SEEDS = tuple(range(900_000, 900_020))

FIRST_TRAINING_SEED = 2**30
"""No training sees a boat with a smaller seed, so that those may serve to evaluate."""

FRAME_SKIP = 10

EPISODE = 240

AFTER_OUTAGE = 20.0
"""Time after an outage that still counts for its score, s."""


def make_envs(
    n: int, *, observation: str | Sequence[str], twin: str = "ukf", frame_skip: int = FRAME_SKIP,
    max_episode_steps: int = EPISODE, **env: Any,
) -> USVVectorEnv:  # fmt: skip
    """Make n boats for an agent, as ``gym.make_vec("USVTwin-v0", ...)`` with its options ``env``.

    An action is held for ``frame_skip`` steps of 0.05 s; an episode has ``max_episode_steps`` such
    decisions. ``twin`` counts where the observation has one. The task ``seakeeping`` has ``dof=6``.
    """
    if env.get("task") == "seakeeping":
        env = {"dof": 6, **env}
    envs: Any = gym.make_vec(
        "USVTwin-v0",
        num_envs=n,
        observation=observation,
        twin=twin,
        frame_skip=frame_skip,
        max_episode_steps=max_episode_steps,
        **env,
    )
    return envs


def evaluate(
    agent: Agent, *, seeds: Sequence[int] = EVALUATION_SEEDS, sea: str = "2", faults: str = "none",
    frame_skip: int = FRAME_SKIP, max_episode_steps: int = EPISODE,
    log_dir: Path | None = None, label: str = "", **env: Any,
) -> list[dict[str, Any]]:  # fmt: skip
    """Let an agent sail episodes, and return a row for each.

    A twin sails with every agent, also with those that do not see it, and its forecasts are graded;
    with ``forecast_scores=False`` it sails only with those that see it.

    Parameters
    ----------
    agent : Agent
        What steers.
    seeds : sequence of int
        One episode for each: the one that a single environment has with that seed.
    sea, faults : str
        Sea state and loss of sensors; ``"a|b"`` for one of them at random.
    frame_skip, max_episode_steps, **env
        See :func:`make_envs`.
    log_dir : Path, optional
        Write the log of each episode there, with the particulars beside it.
    label : str
        What the logs' names begin with; the agent's name if left out.

    Returns
    -------
    list of dict
        ``agent, sea, faults, seed, return, length_s, success, failed`` (off the path or
        capsized), ``cross_track_m``, ``off_path_m``, ``off_path_outage_m`` and ``motion``.

        ``cross_track_m`` is the mean distance from the path until the episode's end; of station
        keeping, from the point. ``off_path_m`` is the same over all decisions of an episode. Those
        after a failure count as the distance that ends it, 50 m, so that failing early is no
        advantage. Those after a success do not count. ``off_path_outage_m`` is the same from the
        start of the loss of GPS to 20 s after it. It is None without a loss, or where the goal was
        reached before.

        ``motion`` is the mean square of the roll over 10 degrees plus that of the deck's vertical
        acceleration over 2 m/s2. It is None where the reward has no such term.

        ``twin_forecast`` has the scores of the twin's forecasts by name, or nothing; see
        :class:`twin.sim.forecast_scores.ForecastScores`.
    """
    seeds = [int(seed) for seed in seeds]
    if not seeds:
        raise AgentError("no seeds to evaluate on: name at least one")
    envs = make_envs(
        len(seeds),
        autoreset_mode=AutoresetMode.NEXT_STEP,
        sea=sea,
        faults=faults,
        frame_skip=frame_skip,
        max_episode_steps=max_episode_steps,
        record=log_dir is not None,
        **{**interface_of(agent), "forecast_scores": True, **env},
    )
    graded: list[dict[str, float]] = [{} for _ in seeds]
    try:
        obs, infos = envs.reset(seed=seeds)
        agent.begin(envs)
        first, last = _outages(envs)
        errors, along = envs.task.errors, float(envs.task.kind == STATION)
        alive = np.ones(len(seeds), dtype=np.bool_)
        success, failed = ~alive, ~alive
        returns, lengths = np.zeros(len(seeds)), np.zeros(len(seeds))
        off, rough = np.full((2, max_episode_steps, len(seeds)), np.nan)
        weight = float(envs.task.rules["motion"]) * frame_skip
        for row, rolled in zip(off, rough, strict=True):
            obs, rewards, terminated, truncated, infos = envs.step(agent.act(obs))
            returns[alive] += rewards[alive]
            lengths[alive] = infos["t_s"][alive]
            row[alive] = np.hypot(errors[alive, 0], along * errors[alive, 1])
            if weight > 0.0:
                rolled[alive] = -infos["reward_terms"]["motion"][alive] / weight
            ends = alive & (terminated | truncated)
            for i in np.flatnonzero(ends):
                if "twin_forecast" in infos:
                    graded[i] = dict(infos["twin_forecast"][i])
                if log_dir is not None:
                    name = log_name(label or agent.name, sea, faults, seeds[i])
                    log_of(envs, log_dir / name, boat=int(i))
            success |= ends & infos["is_success"]
            failed |= ends & terminated & ~infos["is_success"]
            alive &= ~ends
            if not alive.any():
                break
        times = envs.simulation.dt * frame_skip * np.arange(1, max_episode_steps + 1)[:, None]
    finally:
        envs.close()
    sailed = _mean(off)
    off[np.isnan(off) & failed] = envs.task.rules["area"]
    during = (first <= times) & (times <= last + AFTER_OUTAGE)
    motion = _mean(rough)
    whole, lost = _mean(off), _mean(np.where(during, off, np.nan))
    return [
        {
            **{"agent": agent.name, "sea": sea, "faults": faults, "seed": seed},
            **{"return": float(returns[i]), "length_s": float(lengths[i])},
            **{"success": bool(success[i]), "failed": bool(failed[i])},
            **{"cross_track_m": float(sailed[i]), "off_path_m": float(whole[i])},
            "off_path_outage_m": None if np.isnan(lost[i]) else float(lost[i]),
            "motion": None if np.isnan(motion[i]) else float(motion[i]),
            "twin_forecast": graded[i],
        }
        for i, seed in enumerate(seeds)
    ]


def log_name(label: str, sea: str, faults: str, seed: int) -> str:
    """Return the file name of an episode's log; characters that file systems refuse are ``_``."""
    return re.sub(r"[^\w.+@=-]+", "_", f"{label}_sea{sea}_{faults}_{seed}") + ".csv"


def on_grid(
    agent: Agent, *, seeds: Sequence[int] = EVALUATION_SEEDS, seas: Sequence[str] = SEAS,
    outages: Sequence[str] = OUTAGES, **env: Any,
) -> list[Callable[[], list[dict[str, Any]]]]:  # fmt: skip
    """Return calls of :func:`evaluate` for each sea state with each outage.

    Each has a copy of the agent, so that they may be made in any order and at the same time.
    """
    return [
        functools.partial(
            evaluate, copy.deepcopy(agent), seeds=seeds, sea=sea, faults=faults, **env
        )
        for sea, faults in itertools.product(seas, outages)
    ]


def agents_named(model: str, **env: Any) -> list[tuple[str, Agent]]:
    """Return the agents that a name stands for, each with its label.

    It is the folder of a run or of several, a policy (.npz), a model of Stable-Baselines3 (.zip), a
    controller, or ``module:Class``. ``env`` are options of :func:`make_envs` that are given, for
    models that do not say what they were made for.
    """
    path = Path(model)
    if (path / "run.json").exists():
        if not (path / "policy.npz").exists():
            raise AgentError(f"{path}: has not ended: the command that began it goes on with it")
        return [(model, Policy.load(path))]
    if path.is_dir():
        files = sorted(path.glob("*/policy.npz")) or sorted(path.glob("*.npz"))
        if not files:
            raise AgentError(f"{path}: holds no finished run; usv-twin train makes them")
        names = [file.parent if file.name == "policy.npz" else file for file in files]
        return [(str(name), Policy.load(file)) for name, file in zip(names, files, strict=True)]
    if path.suffix == ".npz":
        return [(model, Policy.load(path))]
    known = CONTROLLERS | DOCKING
    saved = path.with_name(f"{path.name}.zip")  # Stable-Baselines3 adds it to a name without
    if model not in known and not path.exists() and saved.exists():
        path = saved
    if path.suffix == ".zip" and path.exists():
        algorithm_class("ppo")  # says what to install
        return [(model, _fitted(SavedPolicy(path), env))]
    if ":" in model:
        agent = import_named(model, AgentError, model)()
        lacks = [
            name for name in ("name", "observation", "begin", "act") if not hasattr(agent, name)
        ]
        if lacks:
            raise AgentError(
                f"{model}: an agent has name, observation, begin and act; it lacks "
                f"{' and '.join(lacks)}; {SIX_LINES}"
            )
        return [(model, agent)]
    if path.exists():
        raise AgentError(
            f"{model}: is no policy (.npz) and no model of Stable-Baselines3 (.zip); {SIX_LINES}"
        )
    if model not in known:
        raise AgentError(
            f"{model}: no such folder, policy or controller; "
            f"controllers: {', '.join(known)}; agents of your own: module:Class"
        )
    return [(model, known[model]())]


def _fitted(agent: SavedPolicy, env: Mapping[str, Any]) -> SavedPolicy:
    """Give a model the observation, actions and degrees of freedom that its spaces are of.

    Spaces that do not say it are those of a set that has as many entries, and as many actions.
    """
    names = getattr(agent.seen, "names", None)
    kinds: list[Any] = [{"actions": a, "dof": n} for n in (3, 6) for a in ("common", "units")]
    kinds = [vars(agent.acting)["options"]] if hasattr(agent.acting, "options") else kinds
    entries: list[Any] = [] if names is None else [[*names]]
    known, why = dict[str, str](), ""
    for options, observation in itertools.product(kinds, [*OBSERVATIONS, *entries]):
        try:
            envs = make_envs(1, observation=observation, **{**env, **options})
        except UsvTwinError as error:
            why = f"; {error}"
            continue
        envs.close()
        acting, seen = envs.single_action_space, envs.single_observation_space
        if (acting, seen) == (agent.acting, agent.seen) and names in (None, vars(seen)["names"]):
            agent.observation, agent.actions = observation, options["actions"]
            agent.settings = {"dof": options["dof"]}
            return agent
        name = observation if isinstance(observation, str) else "these"
        known[f"observation {name} {seen.shape}"] = why = ""
        known[f"actions {options['actions']} {acting.shape}"] = why
    raise AgentError(
        f"{agent.path}: its observations are {agent.seen}, its actions {agent.acting}; this vessel "
        f"has Box(-1, 1) and Box(-10, 10) of: {', '.join(sorted(known))}{why}; give vessel and "
        f"sensors of the training, or {SIX_LINES}"
    )


def trained_with(agents: Sequence[Agent], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the environment options of the agents' training, overridden by those given.

    AgentError: the agents were trained with different ones.
    """
    options: dict[str, Any] = {"task": "path", "twin": "ukf", "vessel": "usv75"}
    options |= {"frame_skip": FRAME_SKIP, "max_episode_steps": EPISODE}
    settings = [agent.settings for agent in agents if isinstance(agent, (Policy, SavedPolicy))]
    for name in (*options, "vessel_spread", "dof"):
        trained = sorted({one[name] for one in settings if name in one and name not in given})
        if len(trained) > 1:
            raise AgentError(
                f"these were trained with {name} = {', '.join(map(str, trained))}: evaluate them "
                "one by one, or give it"
            )
        options |= {name: trained[0]} if trained else {}
    worlds = [
        {k: v for k, v in agent.settings.get("world", {}).items() if k not in given}
        for agent in agents
        if isinstance(agent, Policy)
    ]
    if any(world != worlds[0] for world in worlds):
        raise AgentError(f"these were trained in other worlds, {worlds}: evaluate them one by one")
    return {**options, **(worlds[0] if worlds else {}), **given}


def mean_scores(episodes: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the scores over all forecasts of some episodes, by name.

    Each episode has what :class:`twin.sim.forecast_scores.ForecastScores` names; it weighs as much
    as it has forecasts.
    """
    counts = [count + place for place in ("", "_loss") for count in ("n", "n_intervals")]
    found = {name: math.fsum(one.get(name, 0.0) for one in episodes) for name in counts}
    for name in dict.fromkeys(name for one in episodes for name in one if name not in found):
        weight = "n_intervals" if name.endswith("coverage90") else "n"
        weight += "_loss" if "_loss_" in name else ""
        parts = [one[name] * one[weight] for one in episodes if name in one]
        found[name] = math.fsum(parts) / found[weight]
    return found


def _outages(envs: USVVectorEnv) -> tuple[np.ndarray, np.ndarray]:
    """Return when each boat's GPS is first lost and back, s; NaN where it is not."""
    first, last = np.full((2, envs.num_envs), np.nan)
    for faults in envs.simulation.faults.T:
        gps = (faults["bits"] == GPS_BIT) & ~(faults["start"] >= first)
        first[gps], last[gps] = faults["start"][gps], faults["end"][gps]
    return first, last


def _mean(values: np.ndarray) -> np.ndarray:
    """Return the means of columns over what is no NaN; NaN where there is nothing else."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    # sums of a column that do not hang on the number of columns
    total = np.ascontiguousarray(np.where(known, values, 0.0).T).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
