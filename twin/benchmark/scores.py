"""Scores of predictions against the truth."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.benchmark.protocol import HORIZONS, BenchmarkError
from twin.logs.log import Log
from twin.particulars import Particulars
from twin.predictors.base import Z90, Prediction

__all__ = [
    "CHANNELS",
    "STUDY_CHANNELS",
    "STUDY_HORIZONS",
    "Reference",
    "Score",
    "as_measured",
    "crps",
    "score",
    "table_of",
]

Array = NDArray[np.float64]

CHANNELS = ("u", "v", "r", "along", "across", "psi")

STUDY_CHANNELS = ("u", "v", "r", "psi", "displacement")
"""Channels of the error over that of the oracle. ``displacement`` is the distance between true and
predicted position, both counted from the start of the prediction."""

STUDY_HORIZONS = tuple(0.5 * k for k in range(1, 21))

SCORED_AT = [STUDY_HORIZONS.index(h) for h in HORIZONS]

ELLIPSE_90 = -2.0 * math.log(0.1)
"""Squared Mahalanobis distance of the 90 % ellipse."""

MEAN_ABS_NORMAL = math.sqrt(2.0 / math.pi)
"""Mean size of a standard normal number."""

MEAN_ABS_DIFFERENCE = (4.0 - 2.0 * math.sqrt(2.0)) / math.sqrt(math.pi)
"""Mean difference of the sizes of two of them."""


def crps(error: Array, down: Array, up: Array) -> Array:
    """Return the continuous ranked probability score of two-piece normal distributions.

    Such a distribution has one width below its mode and another above it, here those of a
    prediction's 5 % and 95 % points. ``error`` is truth less mode, ``down`` and ``up`` the widths
    (standard deviations). With equal widths it is the normal distribution. The score has the unit
    of the values; without any width it is the absolute error.

    Source: CRPS = E|X - y| - E|X - X'| / 2, Gneiting and Raftery 2007. Equal to
    ``scoringrules.crps_2pnormal``, whose import compiles for seconds in every worker.
    """
    from scipy.special import erf  # takes a quarter of a second

    near = np.maximum(np.where(error < 0.0, down, up), 1e-12)
    far = np.maximum(np.where(error < 0.0, up, down), 1e-12)
    total, size = near + far, np.abs(error)
    a = size / near
    density = 2.0 * MEAN_ABS_NORMAL * np.exp(-0.5 * a * a)  # 4 times that at a
    to_truth = far * (size + MEAN_ABS_NORMAL * far) + near * near * (
        density - MEAN_ABS_NORMAL - a + 2.0 * a * erf(a / math.sqrt(2.0))
    )
    between = MEAN_ABS_DIFFERENCE * (near**3 + far**3) / total + 2.0 * MEAN_ABS_NORMAL * near * far
    return np.asarray(to_truth / total - 0.5 * (between / total))


MAX_GAP = 3.0
"""No scoring further from a sample than this many typical steps, or as many half seconds."""


def _reach(t: Array) -> float:
    """Return how far from samples at times t to score, s."""
    return MAX_GAP * max(0.5, float(np.median(np.diff(t))) if len(t) > 1 else 0.0)


class Reference:
    """What predictions are scored against: the truth, or measured positions and headings."""

    def __init__(self, log: Log) -> None:
        self.measured = log.truth is None
        if log.truth is not None:
            self.t, self.columns = [log.t] * 6, list(log.truth.T.copy())
            self.columns[2] = np.unwrap(self.columns[2])
            self.reaches = [_reach(log.t)]
            return
        self.t, self.columns = [], []
        for entry in (0, 1, 4):
            seen = np.isfinite(log.z[:, entry])
            if not seen.any():
                raise BenchmarkError(
                    f"{log.name}: has no positions or no headings to score predictions against"
                )
            values = log.z[seen, entry]
            self.t.append(log.t[seen])
            self.columns.append(np.unwrap(values) if entry == 4 else values)
        self.reaches = [_reach(t) for t in self.t]

    def known(self, times: Array) -> bool:
        """Return whether there are samples near all of some times."""
        for t, reach in zip(self.t, self.reaches, strict=False):
            after = np.searchsorted(t, times).clip(max=len(t) - 1)
            distance = np.minimum(
                np.abs(t[after] - times), np.abs(times - t[np.maximum(after - 1, 0)])
            )
            if (distance > reach).any():
                return False
        return True

    def at(self, times: Array) -> Array:
        """Return states (h, 6) or (h, 3) at times, linearly between samples."""
        return np.stack(
            [np.interp(times, t, c) for t, c in zip(self.t, self.columns, strict=True)], axis=1
        )


def as_measured(prediction: Prediction, particulars: Particulars) -> Prediction:
    """Return the prediction of what the sensors will measure: its covariance and R, their noise.

    Where fixes and headings stand for the truth, it is this that they are scored against.
    """
    on_board = particulars.instruments
    cov, low, high = (a.copy() for a in (prediction.cov, prediction.low, prediction.high))
    # displacement: noise of two fixes, at start and end
    for i in (0, 1):
        cov[:, i, i] += 2.0 * on_board.gps_sd**2
    more = (Z90 * on_board.compass_sd) ** 2
    down, up = prediction.mean[:, 2] - low[:, 2], high[:, 2] - prediction.mean[:, 2]
    low[:, 2] = prediction.mean[:, 2] - np.sqrt(down**2 + more)
    high[:, 2] = prediction.mean[:, 2] + np.sqrt(up**2 + more)
    return dataclasses.replace(prediction, cov=cov, low=low, high=high)


class Score(NamedTuple):
    """One prediction against the truth, at h horizons."""

    # (h, c): errors and true changes of the channels, the last c of CHANNELS
    error: Array
    change: Array
    displacement: Array  # (h,): error of the displacement, m
    crps: Array  # (h, c): see crps
    # (h, c + 1): whether the 90 % intervals cover channels and displacement
    covered: NDArray[np.bool_]


def score(prediction: Prediction, truth: Array, horizons: Sequence[float]) -> Score:
    """Compare one prediction with the truth, at horizons (s after the start).

    Positions count from the start of the prediction. So the error of the start, which comes from
    the receiver and is common to all predictors, does not count again at each horizon. It is
    reported on its own (``start_error``). ``truth`` (1 + h, 6), or (1 + h, 3) for positions and
    headings alone, is at the start, then at the horizons.
    """
    mean, cov = prediction.at(np.array(horizons))
    low, high = prediction.interval(np.array(horizons))
    start, later = truth[0], truth[1:]
    psi = later[:, 2]
    c, s = np.cos(psi), np.sin(psi)
    moved = later[:, :2] - start[:2]
    ex, ey = (mean[:, :2] - prediction.start[:2] - moved).T
    spread = cov - prediction.start_cov
    xx, xy, yy = spread[:, 0, 0], spread[:, 0, 1], spread[:, 1, 1]
    error, change, covered, widths = [], [], [], []
    if truth.shape[1] == 6:
        for i in (3, 4, 5):
            error.append(mean[:, i] - later[:, i])
            change.append(later[:, i] - start[i])
            covered.append((low[:, i] <= later[:, i]) & (later[:, i] <= high[:, i]))
            widths.append((mean[:, i] - low[:, i], high[:, i] - mean[:, i]))
    # along the true heading, then across it to starboard
    for a, b in ((c, s), (-s, c)):
        error.append(a * ex + b * ey)
        change.append(a * moved[:, 0] + b * moved[:, 1])
        sd = np.sqrt(np.maximum(a * a * xx + 2.0 * a * b * xy + b * b * yy, 0.0))
        covered.append(np.abs(error[-1]) <= Z90 * sd)
        widths.append((Z90 * sd, Z90 * sd))
    turn = (mean[:, 2] - psi + math.pi) % (2.0 * math.pi) - math.pi
    error.append(turn)
    change.append(psi - start[2])
    covered.append((low[:, 2] - mean[:, 2] <= -turn) & (-turn <= high[:, 2] - mean[:, 2]))
    widths.append((mean[:, 2] - low[:, 2], high[:, 2] - mean[:, 2]))
    size = np.maximum(xx * yy - xy * xy, 0.0)
    covered.append(yy * ex * ex - 2.0 * xy * ex * ey + xx * ey * ey <= ELLIPSE_90 * size)
    errors = np.stack(error, axis=1)
    down, up = np.maximum(np.array(widths), 0.0).transpose(1, 2, 0) / Z90
    changes, covers = np.stack(change, axis=1), np.stack(covered, axis=1)
    return Score(errors, changes, np.hypot(ex, ey), crps(-errors, down, up), covers)


def table_of(parts: Sequence[Score]) -> dict[str, Any]:
    """Return the table of scores, at :data:`STUDY_HORIZONS`, of one predictor on one run.

    It has ``n`` predictions; by channel (also ``displacement``) ``mae``, ``mse``, ``crps`` and
    ``coverage90`` at :data:`HORIZONS`; ``scale``, the root mean square of the true change;
    ``curves``, the MAE of the study's channels at every half second.
    """
    error, change, distance, crps_of, covered = map(np.array, zip(*parts, strict=True))
    channels = CHANNELS[-error.shape[2] :]
    size = {c: np.abs(error[:, :, i]) for i, c in enumerate(channels)}
    size["displacement"] = distance
    table: dict[str, Any] = {
        channel: {
            "mae": values[:, SCORED_AT].mean(axis=0).tolist(),
            "mse": (values[:, SCORED_AT] ** 2).mean(axis=0).tolist(),
            "coverage90": covered[:, SCORED_AT, i].mean(axis=0).tolist(),
        }
        for i, (channel, values) in enumerate(size.items())
    }
    for i, channel in enumerate(channels):
        table[channel]["crps"] = crps_of[:, SCORED_AT, i].mean(axis=0).tolist()
    return {
        "n": len(parts),
        "channels": table,
        "scale": np.sqrt(np.mean(change[:, SCORED_AT] ** 2, axis=0)).T.tolist(),
        "curves": {c: size[c].mean(axis=0).tolist() for c in STUDY_CHANNELS if c in size},
    }
