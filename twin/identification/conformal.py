"""How wide intervals must be to hold what they claim: adaptive conformal inference, online.

A forecast that is over is compared with what came. Its score is the error over half of the claimed
interval. Intervals are made as many times wider as a quantile of the last scores says,

    factor = quantile of the last scores at the level 1 - alpha_t,
    alpha_(t+1) = alpha_t + gamma (alpha - missed_t),

for each horizon and channel by itself. So alpha of all intervals miss in the long run, whatever the
boat and the sea. Until scores have come, there are as many of a normal distribution in their
places, and the factor is 1. Without fixes nothing comes, and all stays as it is.

Source: Gibbs and Candes 2021, arXiv:2106.00170.
"""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from usv_kernel.jit import inlined, kernel

__all__ = [
    "CHANNELS",
    "HORIZONS",
    "RECORD",
    "REGION",
    "Z90",
    "factor_ahead",
    "first_record",
    "take_score",
]

HORIZONS = (1.0, 2.0, 5.0, 10.0)
"""Times ahead that are compared, s. Between them factors are linear in time."""

CHANNELS = 5
"""Displacement, heading, u, v, r."""

SCORES = 64
"""Scores that are remembered: about a minute of forecasts."""

MISSED = 0.1
"""Share of truths that an interval may miss."""

STEP = 0.02
"""Step gamma of the level: it moves by it, at most, in about as many forecasts as are remembered.

Source: Zaffran et al. 2022, arXiv:2202.07282, between their .01 and .05."""

REGION = -2.0 * math.log(MISSED)
"""Squared Mahalanobis distance of the region of displacements."""

Z90 = NormalDist().inv_cdf(1.0 - 0.5 * MISSED)

_SHAPE = (len(HORIZONS), CHANNELS)

RECORD = [
    ("compared", "f8"),  # number of forecasts
    ("level", "f8", _SHAPE),  # alpha_t
    ("factor", "f8", _SHAPE),  # of the intervals
    ("scores", "f8", (*_SHAPE, SCORES)),  # the last scores, the oldest replaced first
]
"""Fields of the predictor's memory that this module reads and writes."""

_HORIZONS = np.array(HORIZONS)


def first_record() -> dict[str, NDArray[np.float64]]:
    """Return level, factor and scores before anything has come, by their fields."""
    shares = (np.arange(SCORES) + 0.5) / SCORES
    normal = np.array([NormalDist().inv_cdf(0.5 + 0.5 * share) for share in shares]) / Z90
    scores = np.tile(normal, (*_SHAPE, 1))
    scores[:, 0] = np.sqrt(np.log1p(-shares) / math.log(MISSED))
    # the oldest are replaced first: not all small ones before the large ones
    order = np.random.default_rng(0).permutation(SCORES)
    return {
        "level": np.full(_SHAPE, MISSED),
        "factor": np.ones(_SHAPE),
        "scores": scores[..., order],
    }


@kernel
def _quantile(scores, share, sorted_):
    """Return a quantile of scores; ``sorted_`` is scratch."""
    for k in range(SCORES):
        at = k
        while at > 0 and sorted_[at - 1] > scores[k]:
            sorted_[at] = sorted_[at - 1]
            at -= 1
        sorted_[at] = scores[k]
    place = min(max(share * (SCORES + 1.0) - 1.0, 0.0), SCORES - 1.0)
    k = min(int(place), SCORES - 2)
    return sorted_[k] + (place - k) * (sorted_[k + 1] - sorted_[k])


@kernel
def take_score(h, channel, score, record, scratch):
    """Take the score of a forecast at a horizon: its error over half of the raw interval."""
    at = int(record.compared) % SCORES
    missed = 1.0 if score > record.factor[h, channel] else 0.0
    level = record.level[h, channel] + STEP * (MISSED - missed)
    record.level[h, channel] = min(max(level, 0.0), 1.0)
    record.scores[h, channel, at] = score
    level = record.level[h, channel]
    record.factor[h, channel] = _quantile(record.scores[h, channel], 1.0 - level, scratch)


@inlined
def factor_ahead(after, channel, record):
    """Return the factor of a channel's interval at a time ``after`` (s) ahead.

    It is that of the first horizon before it, and that of the last one beyond.
    """
    k = 0
    while k < _HORIZONS.shape[0] - 2 and after > _HORIZONS[k + 1]:
        k += 1
    share = (after - _HORIZONS[k]) / (_HORIZONS[k + 1] - _HORIZONS[k])
    before, then = record.factor[k, channel], record.factor[k + 1, channel]
    return before + min(max(share, 0.0), 1.0) * (then - before)
