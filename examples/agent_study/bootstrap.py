"""Interquartile means, and 95 % intervals of a stratified bootstrap.

Source: Agarwal et al. 2021, Deep Reinforcement Learning at the Edge of the Statistical Precipice.
"""

import numpy as np

REPLICATES = 2000


def iqm(values):
    """Return the interquartile means of the last axis: without a quarter at each end."""
    cut = values.shape[-1] // 4
    return np.sort(values, axis=-1)[..., cut : values.shape[-1] - cut].mean(axis=-1)


def replicates(scores, statistic):
    """Return the statistic (REPLICATES,) of bootstrap samples of each agent, by its name.

    ``scores`` are by agent, of shape (strata, runs, episodes). Episodes are drawn once for all
    agents, as they met the same ones, and for all strata: those of a seed have boat and path in
    common. Runs are drawn for each agent, from a generator of its own.
    """
    strata, episodes = next(iter(scores.values())).shape[::2]
    chosen = np.random.default_rng(0).integers(episodes, size=(REPLICATES, 1, 1, episodes))
    stratum = np.arange(strata)[:, None, None]
    found = {}
    for name, values in scores.items():
        rng = np.random.default_rng([0, *name.encode()])
        runs = rng.integers(values.shape[1], size=(REPLICATES, 1, values.shape[1], 1))
        found[name] = statistic(values[stratum, runs, chosen].reshape(REPLICATES, -1))
    return found


def interval(sample):
    """Return the bounds of the 95 % interval of a bootstrap sample."""
    low, high = np.percentile(sample, [2.5, 97.5])
    return float(low), float(high)
