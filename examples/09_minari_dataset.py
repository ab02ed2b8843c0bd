"""Write episodes of an agent as a Minari data set, with the truth and the forecasts of its twin.

Minari (https://minari.farama.org) keeps data sets of offline reinforcement learning, in
``~/.minari``, or where MINARI_DATASETS_PATH says. Run
``python examples/09_minari_dataset.py usv/los-twin-v0 los-twin``.
"""

import argparse
import copy
import warnings

import gymnasium as gym
import numpy as np

from twin.agents.evaluation import agents_named, make_envs
from twin.model.rollout import HORIZONS
from twin.sim.bridge import TRUE_STATE

try:
    import minari
    from minari.data_collector import EpisodeBuffer
except ImportError as error:
    raise SystemExit(f"{error}: python -m pip install -e '.[minari]'") from None

OPTIONS = {"sea": "2", "faults": "gps30", "twin": "ukf", "frame_skip": 10}
DESCRIPTION = f"""Episodes of an unmanned surface vessel. Infos have a row for each observation.
state: the true position north and east (m), heading (rad), speeds forward and to starboard (m/s),
yaw rate (rad/s). twin_state: the same by the twin. twin_ahead: forecasts of it
{", ".join(f"{h:g}" for h in HORIZONS)} s ahead, with the command held. twin_ahead_cov: covariances
of their positions (m2). They are NaN before the twin has a position."""


def look(envs, infos):
    """Return the truth of the boat, and the estimate and forecasts of its twin."""
    found = {name: np.array(infos[name][0]) for name in ("t_s", "cross_track_m", "is_success")}
    found["state"] = envs.simulation.state[0, list(TRUE_STATE)]
    twin = envs.observer.overlay(0)
    none = np.full((len(HORIZONS), 6), np.nan)
    found["twin_state"] = none[0] if twin is None else twin.state
    found["twin_ahead"] = none if twin is None else twin.ahead
    found["twin_ahead_cov"] = none[:, :4].reshape(-1, 2, 2) if twin is None else twin.covs
    return found


def episode(agent, seed, **env):
    """Return the episode that ``usv-twin evaluate`` has for a seed, as arrays by name."""
    # a twin sails with every agent, seen by it or not
    envs = make_envs(1, observation=agent.observation, forecast_scores=True, **env)
    obs, infos = envs.reset(seed=[seed])
    agent.begin(envs)
    seen, looks, steps, over = [obs[0].copy()], [look(envs, infos)], [], False
    while not over:
        actions = np.clip(agent.act(obs), -1.0, 1.0).astype(np.float32)
        obs, *outcome, infos = envs.step(actions)
        steps.append([part[0] for part in (actions, *outcome)])
        seen.append(obs[0].copy())
        looks.append(look(envs, infos))
        over = steps[-1][2] or steps[-1][3]
    envs.close()
    names = ("actions", "rewards", "terminations", "truncations")
    columns = dict(zip(names, map(np.stack, zip(*steps, strict=True)), strict=True))
    infos = {name: np.stack([one[name] for one in looks]) for name in looks[0]}
    return {"observations": np.stack(seen), **columns, "infos": infos}


def main(name, model, seeds):
    """Sail the episodes of seeds 0, 1, ... and write them."""
    ((_, agent),) = agents_named(model)
    buffers = [
        EpisodeBuffer(id=seed, seed=seed, **episode(agent, seed, **OPTIONS))
        for seed in range(seeds)
    ]
    spec = copy.deepcopy(gym.spec("USVTwin-v0"))
    spec.kwargs, spec.max_episode_steps = {"observation": agent.observation, **OPTIONS}, 240
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # author and link are the user's to give
        minari.create_dataset_from_buffers(
            name, buffers, env=spec, algorithm_name=agent.name, description=DESCRIPTION
        )
    print(f"{name}: {seeds} episodes")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("name", help="of the data set, such as usv/los-twin-v0")
    parser.add_argument("model", help="the agent, as usv-twin evaluate takes it")
    parser.add_argument("seeds", nargs="?", type=int, default=4, help="episodes to sail")
    main(**vars(parser.parse_args()))
