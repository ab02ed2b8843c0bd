"""Recorded runs: the last recorded command, and persistence of the recorded velocities."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twin.benchmark.figures.data import reference_of
from twin.channels import PSI, R, U, V
from twin.logs.datasets import known_ship
from twin.logs.dates import Clock
from twin.logs.files import CsvFile
from twin.logs.log import Log
from twin.predictors.baselines import hold_velocity
from usv_kernel.channels import GYRO

if TYPE_CHECKING:
    from twin.benchmark.scores import Reference

__all__ = ["RecordedPersistence", "commands_end"]

Array = NDArray[np.float64]

VELOCITIES = ("u_mps", "v_mps", "r_radps")
"""Columns of body velocities in the archives of recorded runs."""

SLOPE_S = 1.0
"""Span over which a velocity is taken from positions or headings, where none was recorded, s."""


def commands_end(log: Log) -> float:
    """Return the time of the last recorded command of a run, s.

    A recorded run often ends with commands of zero: the operator has taken over, by means that
    nobody recorded. Then the last other command counts. ``Log.commands_end`` says where the stream
    of commands stops before the log does. Simulated runs have all commands.
    """
    last = float(log.t[-1])
    if log.truth is not None:
        return last
    given = np.flatnonzero(np.any(log.cmd != 0.0, axis=1))
    if len(given):
        last = float(log.t[given[-1]])
    return min(last, log.commands_end)


class RecordedPersistence:
    """The position and heading of a recorded boat that keeps its recorded body velocities.

    They are those of the file, where it has :data:`VELOCITIES`. Else they are measured velocities,
    and where there are none, slopes of the last :data:`SLOPE_S`.
    """

    def __init__(self, log: Log, reference: Reference, path: str) -> None:
        self._reference = reference
        self._columns = _velocities_of_file(path) or _measured_velocities(log)

    def squared_errors(self, truth: Array, times: Array) -> Array:
        """Return squared errors of displacement, m2, and heading, rad2, at a time.

        Parameters
        ----------
        truth : ndarray, shape (2, 3)
            Measured positions and headings at the two times.
        times : ndarray, shape (2,)
            Start and end of the forecast, s.

        Returns
        -------
        ndarray, shape (2,)
            Displacement and heading; NaN where no velocity is known at the start.
        """
        start = np.concatenate([truth[0], np.zeros(3)])
        velocity = np.array([self._velocity(k, float(times[0])) for k in range(3)])
        end = hold_velocity(start, velocity, times[1:] - times[0])[0]
        turn = math.remainder(end[PSI] - truth[1, 2], 2.0 * math.pi)
        return np.array([float(np.sum((end[:2] - truth[1, :2]) ** 2)), turn * turn])

    def _velocity(self, k: int, t: float) -> float:
        """Return the last value of one body velocity up to a time."""
        times, values = self._columns[k]
        if len(times):
            return float(values[max(int(np.searchsorted(times, t, side="right")) - 1, 0)])
        before, now = self._reference.at(np.array([t - SLOPE_S, t]))
        slope = (now - before) / SLOPE_S
        if k == R - U:
            return float(slope[2])
        # the chord of the last second points along its middle heading
        c, s = math.cos(0.5 * (now[2] + before[2])), math.sin(0.5 * (now[2] + before[2]))
        return float(slope[0] * c + slope[1] * s if k == 0 else slope[1] * c - slope[0] * s)


def _velocities_of_file(path: str) -> list[tuple[Array, Array]]:
    """Return times and values of the body velocities in a file of an archive, if it has them."""
    names = ("t_s", *VELOCITIES)
    # elsewhere a mapping may have given these names another meaning
    if known_ship(path) is None or not set(names) <= set((file := CsvFile(Path(path))).header):
        return []
    blocks = [columns for _, columns, _ in file.blocks(names, Clock(""))]
    columns = [np.concatenate([block[name] for block in blocks]) for name in names]
    kept = [np.isfinite(columns[0]) & np.isfinite(column) for column in columns[1:]]
    return [(columns[0][there], columns[k][there]) for k, there in enumerate(kept, 1)]


def _measured_velocities(log: Log) -> list[tuple[Array, Array]]:
    """Return times and values of the measured body velocities; empty where a sensor is missing."""
    seen = reference_of(log)
    turning = np.isfinite(log.z[:, GYRO]).any()
    return [
        (seen.t[k], seen.v[k]) if k != R or turning else (np.zeros(0), np.zeros(0))
        for k in (U, V, R)
    ]
