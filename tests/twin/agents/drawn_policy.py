"""A policy whose weights are drawn, where any policy will do."""

import itertools

import numpy as np

from twin.agents.policy import Policy
from twin.agents.training import Plan
from twin.sim.wrapper import make_env


def drawn_policy(observation: str = "twin", *, hidden: int = 64, recurrent: bool = False) -> Policy:
    """Return a policy that sees this set, with small random weights, always the same."""
    rng = np.random.default_rng(0)
    algo = "recurrent_ppo" if recurrent else "ppo"
    names = make_env(observation=observation).observation_names
    plan = Plan(algo, observation, 1)
    lstm = None
    if recurrent:
        sizes = (4 * hidden, len(names)), (4 * hidden, hidden), (4 * hidden,)
        drawn = [0.1 * rng.standard_normal(size) for size in sizes]
        lstm = drawn[0], drawn[1], drawn[2]
    sizes = [hidden if recurrent else len(names), hidden, 2]
    layers = [
        (0.1 * rng.standard_normal((after, before)), 0.1 * rng.standard_normal(after))
        for before, after in itertools.pairwise(sizes)
    ]
    mean, sd = np.zeros(len(names)), np.ones(len(names))
    settings = {"algo": algo, "seed": 0, "steps": 1, **plan.environment}
    return Policy(plan.name, observation, names, settings, mean, sd, np.inf, layers, lstm)
