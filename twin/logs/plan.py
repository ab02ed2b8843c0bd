"""Future commands in a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twin.channels import COMMANDS, TIME
from twin.logs.columns import Array
from twin.logs.dates import Clock
from twin.logs.errors import LogError
from twin.logs.files import CsvFile

__all__ = ["read_plan"]


def read_plan(path: str | Path, horizon: float, dt: float) -> Array:
    """Return a plan of commands on the grid of a prediction, from a CSV file.

    Parameters
    ----------
    path : str or Path
        File with the columns ``t_s`` (s from the start of the prediction, rising) and the four
        commands; each row is in force until the next.
    horizon, dt : float
        Length and step of the prediction, s.

    Returns
    -------
    ndarray, shape (round(horizon / dt), 4)
        Commands of each step.

    Raises
    ------
    LogError
        Where the file is missing, or has no such rows.
    """
    path, names = Path(path), (TIME, *COMMANDS)
    if not path.is_file():
        raise LogError(f"plan {path}: use hold, known, or a CSV file with {', '.join(names)}")
    file = CsvFile(path)
    missing = [name for name in names if name not in file.header]
    if missing:
        raise LogError(f"{path}: the column(s) {', '.join(missing)} are missing; add them")
    blocks = [block[1] for block in file.blocks(names, Clock(""))]
    rows = np.concatenate([np.stack([b[name] for name in names], axis=1) for b in blocks])
    rows = rows[~np.isnan(rows).all(axis=1)]  # blank lines
    if len(rows) == 0 or not np.isfinite(rows).all() or (np.diff(rows[:, 0]) <= 0).any():
        raise LogError(f"{path}: needs at least one row, finite numbers, and a rising t_s")
    middle = dt * (np.arange(round(horizon / dt)) + 0.5)
    return np.asarray(
        rows[np.maximum(np.searchsorted(rows[:, 0], middle, side="right") - 1, 0), 1:]
    )
