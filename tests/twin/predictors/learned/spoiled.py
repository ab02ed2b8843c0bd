"""Histories with something wrong, which no learner may stumble over."""

from __future__ import annotations

import numpy as np


def spoiled(rows: np.ndarray, kind: str, command: int) -> np.ndarray:
    """Return a history of 241 rows with something wrong; ``command`` is the column of a command."""
    rng = np.random.default_rng(5)
    if kind == "constant":
        rows[:] = rows[50]
    elif kind == "at rest":
        rows[:] = 0.0
    elif kind == "few rows":
        rows = rows[:20]
    elif kind == "one row":
        rows = rows[:1]
    elif kind == "all NaN":
        rows[:] = np.nan
    elif kind == "some NaN":
        rows[rng.random(rows.shape) < 0.003] = np.nan
    elif kind == "NaN block":
        rows[60:120] = np.nan
    elif kind == "NaN at the end":
        rows[230:, 3:] = np.nan
    elif kind == "wild":
        rows[rng.integers(0, 241, 3), 3:6] = 1e200
        rows[rng.integers(0, 241, 3), command] = 1e200
        rows[100] = np.inf
    elif kind == "constant commands":
        rows[:, 6:] = rows[5, 6:]
    elif kind == "growing":
        rows[:, 3:6] *= np.exp(0.01 * np.arange(241))[:, None]
    elif kind == "noise":
        rows[:, 3:6] += rng.normal(scale=(3.0, 3.0, 0.5), size=(241, 3))
    return rows
