"""The estimated position at the end of a loss of GPS: how far off it is, and how far it says."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.benchmark.scores import ELLIPSE_90, Reference
from twin.predictors.base import Estimate

__all__ = ["loss_rows", "losses_to_score", "score_loss_end"]

Array = NDArray[np.float64]


def losses_to_score(
    t: Array, lost: Sequence[tuple[float, float]], reference: Reference
) -> dict[int, float]:
    """Return the last row within each loss of GPS, with the length of the loss, s.

    ``t`` (N,) are the times of the rows, ``lost`` start and end of each loss, s. A loss that lasts
    to the end of the run is left out, and one at whose end no position is known.
    """
    ends = {}
    for start, end in lost:
        row = int(np.searchsorted(t, end - 1e-9)) - 1
        if 0 <= row < len(t) - 1 and t[row] > start and reference.known(t[row : row + 1]):
            ends[row] = end - start
    return ends


def score_loss_end(
    estimate: Estimate, length: float, reference: Reference, fix_sd: float = 0.0
) -> dict[str, float]:
    """Return what an estimate at the end of a loss is worth.

    ``error_m`` is the error of the position, ``said_m`` the radius of the circle that is to hold it
    in 90 % of all cases, by the estimate's own standard deviations and, where a fix stands for the
    truth, by that of a fix, ``fix_sd`` (m).
    """
    true = reference.at(np.array([estimate.t]))[0, :2]
    variance = float(np.mean(np.square(estimate.sd[:2]))) + fix_sd**2
    return {
        "t_s": estimate.t,
        "length_s": length,
        "error_m": float(np.hypot(*(estimate.state[:2] - true))),
        "said_m": math.sqrt(ELLIPSE_90 * variance),
    }


def loss_rows(results: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the ends of the losses of each scenario or folder, case and predictor.

    ``error_m`` is the median error, ``worst_m`` the largest; ``said_m`` the median radius that was
    to hold 90 % of them, and ``held`` the share that it did hold; ``losses`` their number.
    """
    cells: dict[tuple[Any, ...], list[dict[str, float]]] = {}
    for result in results:
        unit = result["unit"]
        if ends := result.get("loss_ends"):
            folder = Path(unit["log"]).absolute().parent.name if unit["log"] else ""
            scenario = unit["scenario"] if not folder else ""
            key = (folder, scenario, unit["case"], unit["fault"], unit["predictor"])
            cells.setdefault(key, []).extend(ends)
    rows = []
    for where, ends in cells.items():
        error, said = (np.array([end[name] for end in ends]) for name in ("error_m", "said_m"))
        rows.append(
            {
                **dict(
                    zip(("folder", "scenario", "case", "fault", "predictor"), where, strict=True)
                ),
                "losses": len(ends),
                "error_m": float(np.median(error)),
                "worst_m": float(error.max()),
                "said_m": float(np.median(said)),
                "held": float(np.mean(error <= said)),
            }
        )
    return rows
