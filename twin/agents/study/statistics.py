"""Statistics of the study: interquartile means and means, with intervals of a bootstrap.

Source: Agarwal et al. 2021, Deep Reinforcement Learning at the Edge of the Statistical Precipice.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

__all__ = ["REPLICATES", "STATISTICS", "interval", "iqm", "mean", "replicates", "verdict"]

Array = NDArray[np.float64]

REPLICATES = 2000

LEVEL = 95.0


def iqm(values: Array) -> Array:
    """Return the interquartile means of the last axis, of what is no NaN.

    A quarter of the values is cut off at each end, as ``scipy.stats.trim_mean(values, 0.25)`` does.
    """
    ordered = np.sort(values, axis=-1)  # NaN comes last
    count = np.isfinite(ordered).sum(axis=-1, keepdims=True)
    cut = count // 4
    place = np.arange(ordered.shape[-1])
    kept = (place >= cut) & (place < count - cut)
    total = np.where(kept, ordered, 0.0).sum(axis=-1)
    return np.where(count[..., 0] > 0, total / np.maximum(kept.sum(axis=-1), 1), np.nan)


def mean(values: Array) -> Array:
    """Return the means of the last axis, of what is no NaN; NaN where there is nothing else."""
    known = np.isfinite(values)
    count = known.sum(axis=-1)
    total = np.where(known, values, 0.0).sum(axis=-1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


STATISTICS: dict[str, Callable[[Array], Array]] = {"iqm": iqm, "mean": mean}
"""Statistics by name; each is of the last axis."""


def replicates(
    scores: Mapping[str, Array], statistic: Callable[[Array], Array] = iqm, seed: int = 0
) -> dict[str, Array]:
    """Return the statistic (REPLICATES,) of bootstrap samples of each agent, by its name.

    Scores are (S, R, E) each: strata (sea states, losses), runs, episodes; R may differ. Episodes
    are drawn once for all agents, as they met the same ones, and for all strata: those of a seed
    have boat and path in common. Runs are drawn for each agent, from a generator of its own, so
    that no agent's numbers depend on which others there are.
    """
    strata, episodes = next(iter(scores.values())).shape[::2]
    chosen = np.random.default_rng(seed).integers(episodes, size=(REPLICATES, 1, 1, episodes))
    stratum = np.arange(strata)[:, None, None]
    found = {}
    for name, values in scores.items():
        rng = np.random.default_rng([seed, *name.encode()])
        runs = rng.integers(values.shape[1], size=(REPLICATES, 1, values.shape[1], 1))
        found[name] = statistic(values[stratum, runs, chosen].reshape(REPLICATES, -1))
    return found


def interval(sample: Array) -> tuple[float, float]:
    """Return the bounds of the 95 % interval of a bootstrap sample."""
    tail = (100.0 - LEVEL) / 2.0
    low, high = np.percentile(sample, [tail, 100.0 - tail])
    return float(low), float(high)


def verdict(low: float, high: float, better: int) -> str:
    """Return what an interval of a difference shows; ``better`` is 1 if more is better, or -1."""
    if low <= 0.0 <= high:
        return "no difference shown"
    return "better" if better * low > 0.0 else "worse"
