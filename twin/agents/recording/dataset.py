"""Episodes of an agent as a Minari data set, with the forecasts of its twin.

Source: https://minari.farama.org, the data sets of offline reinforcement learning of the makers of
Gymnasium.
"""

from __future__ import annotations

import copy
import importlib.util
import itertools
import re
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from twin.agents.agent import Agent
from twin.agents.evaluation import EPISODE, FRAME_SKIP, make_envs
from twin.agents.policy import AgentError
from twin.model.rollout import HORIZONS
from twin.model.structure import N_STATES
from twin.sim.bridge import TRUE_STATE
from twin.sim.unseen_twins import UnseenTwins
from usv_gym.envs.vector import USVVectorEnv
from usv_kernel import __version__

__all__ = ["check_dataset", "episodes_of", "write_dataset"]

Array = NDArray[np.float64]

DRAWN = ("load", "hs_m", "wind_mps", "wind_from_deg", "current_mps", "current_to_deg")
"""Numbers of what an episode drew."""

_NAME = re.compile(r"[\w.-]+(/[\w.-]+)*-v\d+")

DESCRIPTION = """Episodes of an unmanned surface vessel that {agent} steers.
Infos have a row for each observation. state: the true position north and east (m), heading (rad),
speeds forward and to starboard (m/s), yaw rate (rad/s). twin_state: the same by the twin.
twin_ahead: forecasts of it {horizons} s ahead, with the command held. twin_ahead_cov: covariances
of their positions (m2). They are NaN before the twin has a position."""


def check_dataset(name: str, agents: int) -> None:
    """Refuse a data set that could not be made.

    Raises
    ------
    AgentError
        The name is none of Minari's, is taken, or there are several agents.
    ImportError
        Minari is missing; it says how to install it.
    """
    for module in ("minari", "h5py"):
        if importlib.util.find_spec(module) is None:
            raise ImportError(f"--minari needs {module}: pip install 'usv-twin[minari]'")
    if not _NAME.fullmatch(name):
        raise AgentError(f"--minari {name}: write a name and a version, as in usv/los-twin-v0")
    if agents != 1:
        raise AgentError(f"--minari {name}: {agents} agents; evaluate one of them at a time")
    import minari

    if name in minari.list_local_datasets():
        raise AgentError(
            f"--minari {name}: is there already; choose another version, or delete it: minari "
            f"delete {name}"
        )


def write_dataset(
    name: str, agent: Agent, *, seeds: Sequence[int], seas: Sequence[str], outages: Sequence[str],
    max_episode_steps: int = EPISODE, **env: Any,
) -> int:  # fmt: skip
    """Let an agent sail the episodes of an evaluation, and write them as a Minari data set.

    Parameters
    ----------
    name : str
        Of the data set, such as ``"usv/los-twin-v0"``. Minari keeps it in ``~/.minari``, or where
        MINARI_DATASETS_PATH says.
    agent : Agent
        Steers.
    seeds, seas, outages, max_episode_steps, **env
        See :func:`twin.agents.evaluation.on_grid`. ``recover_environment()`` of the data set gives
        the environment, which draws one of these seas and outages for each episode.

    Returns
    -------
    int
        Number of episodes.

    Raises
    ------
    AgentError, ImportError
        See :func:`check_dataset`.
    """
    check_dataset(name, 1)
    import minari

    env = {"frame_skip": FRAME_SKIP, "twin": "ukf", **env}
    buffers: list[Any] = []
    for sea, faults in itertools.product(seas, outages):
        given = {"sea": sea, "faults": faults, "max_episode_steps": max_episode_steps, **env}
        for seed, episode in zip(seeds, episodes_of(agent, seeds=seeds, **given), strict=True):
            buffers.append(
                minari.data_collector.EpisodeBuffer(id=len(buffers), seed=seed, **episode)
            )
    spec = copy.deepcopy(gym.spec("USVTwin-v0"))
    given = {"observation": agent.observation, "sea": "|".join(seas), "faults": "|".join(outages)}
    spec.kwargs = {**given, **env}
    spec.max_episode_steps = max_episode_steps
    horizons = ", ".join(f"{h:g}" for h in HORIZONS)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # author and link are the user's to give
        minari.create_dataset_from_buffers(
            name,
            buffers,
            env=spec,
            algorithm_name=agent.name,
            description=DESCRIPTION.format(agent=agent.name, horizons=horizons),
            requirements=[f"usv-twin=={__version__}"],
        )
    return len(buffers)


def episodes_of(
    agent: Agent, *, seeds: Sequence[int], max_episode_steps: int = EPISODE, **env: Any
) -> list[dict[str, Any]]:
    """Return episodes of an agent as arrays by name.

    Parameters
    ----------
    agent : Agent
        Steers.
    seeds : sequence of int
        One episode for each: that of :func:`twin.agents.evaluation.evaluate`.
    max_episode_steps, **env
        See there.

    Returns
    -------
    list of dict
        ``observations`` (T + 1, D), ``actions`` (T, 2), ``rewards``, ``terminations``,
        ``truncations`` (T,), and ``infos``: a dict of arrays (T + 1, ...).
    """
    # twins sail with every agent, seen or not
    envs = make_envs(
        len(seeds),
        observation=agent.observation,
        max_episode_steps=max_episode_steps,
        forecast_scores=True,
        **env,
    )
    try:
        obs, infos = envs.reset(seed=list(seeds))
        agent.begin(envs)
        drawn = {name: infos["drawn"][name].astype(float) for name in DRAWN}
        seen = [(obs, _look(envs, infos))]
        steps = []
        alive, lengths = np.ones(len(seeds), dtype=np.bool_), np.zeros(len(seeds), dtype=int)
        for _decision in range(max_episode_steps):
            actions = np.clip(agent.act(obs), -1.0, 1.0).astype(np.float32)
            obs, rewards, terminated, truncated, infos = envs.step(actions)
            steps.append((actions, rewards, terminated, truncated))
            seen.append((obs, _look(envs, infos)))
            lengths += alive
            alive &= ~(terminated | truncated)
            if not alive.any():
                break
    finally:
        envs.close()
    names = ("actions", "rewards", "terminations", "truncations")
    whole = {
        name: np.stack(part) for name, part in zip(names, zip(*steps, strict=True), strict=True)
    }
    observations = np.stack([obs for obs, _info in seen])
    looks = {name: np.stack([info[name] for _obs, info in seen]) for name in seen[0][1]}
    found = []
    for i, n in enumerate(lengths.tolist()):
        constant = {name: np.full(n + 1, values[i]) for name, values in drawn.items()}
        found.append({
            "observations": observations[: n + 1, i],
            **{name: part[:n, i] for name, part in whole.items()},
            "infos": {**{name: part[: n + 1, i] for name, part in looks.items()}, **constant},
        })  # fmt: skip
    return found


def _look(envs: USVVectorEnv, infos: dict[str, Any]) -> dict[str, Any]:
    """Return truth, and estimate and forecasts of the twins, of all boats."""
    n = envs.num_envs
    found = {name: np.array(infos[name]) for name in ("t_s", "cross_track_m", "is_success")}
    found["state"] = envs.simulation.state[:, list(TRUE_STATE)].copy()
    found["twin_state"] = np.full((n, N_STATES), np.nan)
    found["twin_ahead"] = np.full((n, len(HORIZONS), N_STATES), np.nan)
    found["twin_ahead_cov"] = np.full((n, len(HORIZONS), 2, 2), np.nan)
    for i, overlay in enumerate(_overlays(envs)):
        if overlay is not None:
            found["twin_state"][i], found["twin_ahead"][i] = overlay.state, overlay.ahead
            found["twin_ahead_cov"][i] = overlay.covs
    return found


def _overlays(envs: USVVectorEnv) -> Iterator[Any]:
    """Yield estimate and forecasts of the twin of each boat; None before its first row."""
    observer: Any = envs.observer
    twins = observer.twins if isinstance(observer, UnseenTwins) else observer
    for i in range(envs.num_envs):
        yield twins.overlay(i)
