"""What the pictures show: runs, predictions, and the truth or the measurements in its place."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.channels import PSI, R, U, V, X, Y
from twin.logs.log import Log
from twin.predictors.base import Prediction
from usv_kernel.channels import COMPASS, GPS_VX, GPS_VY, GYRO

__all__ = ["Reference", "RunFigure", "example_times", "examples_at", "gps_fixes", "reference_of"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RunFigure:
    """What the pictures show of one run."""

    # as in the rows of the results
    scenario: str
    fault: str
    seed: int | None  # None for a recorded run
    log: Log  # the run; without truth, the measurements stand in for it
    lost: list[tuple[float, float]]  # start and end of the times without GPS, s
    # by predictor, in the order of the legends: at most three, made at the same times by all
    examples: dict[str, list[Prediction]]

    @property
    def name(self) -> str:
        """Scenario, fault and seed for names of files."""
        return f"{self.scenario}_{self.fault}" + ("" if self.seed is None else f"_seed{self.seed}")

    @property
    def label(self) -> str:
        """Scenario, fault and seed for headings."""
        fault = "no fault" if self.fault == "none" else f"fault {self.fault}"
        return f"{self.scenario}, {fault}" + ("" if self.seed is None else f", seed {self.seed}")


@dataclass(frozen=True)
class Reference:
    """What the predictions are compared with: the truth, or measurements.

    ``t`` and ``v`` are the times (s) and values of each of the six states.
    """

    is_truth: bool
    t: list[Array]
    v: list[Array]

    @property
    def label(self) -> str:
        """Name in legends."""
        return "true" if self.is_truth else "measured"

    @property
    def path(self) -> Array:
        """Positions (n, 2) north and east, at the times ``t[0]``."""
        return np.stack([self.v[X], self.v[Y]], axis=1)

    @property
    def speed(self) -> Array:
        """Speed over ground, m/s, at the times of the surge speed."""
        sway = np.interp(self.t[U], self.t[V], self.v[V]) if len(self.t[V]) else 0.0
        return np.hypot(self.v[U], sway)

    def position(self, t: float) -> Array:
        """Return the position north and east at a time; NaN where there is none."""
        if not len(self.t[X]):
            return np.full(2, math.nan)
        return np.array([np.interp(t, self.t[X], self.v[j]) for j in (0, 1)])

    def within(self, column: int, t0: float, t1: float) -> tuple[Array, Array]:
        """Return times and values of one state between two times."""
        t = self.t[column]
        rows = (t >= t0 - 1e-9) & (t <= t1 + 1e-9)
        return t[rows], self.v[column][rows]


def reference_of(log: Log) -> Reference:
    """Return the truth of a log, or what its sensors measured."""
    is_truth = log.truth is not None and bool(np.isfinite(log.truth[:, :2]).all(axis=1).any())
    columns = log.truth if is_truth and log.truth is not None else _measured_states(log)
    times, values = [], []
    both = np.isfinite(columns[:, :2]).all(axis=1)
    for j in range(6):
        there = both if j < 2 else np.isfinite(columns[:, j])
        times.append(log.t[there])
        column = columns[there, j]
        values.append(np.unwrap(column) if j == 2 and len(column) else column)
    return Reference(is_truth, times, values)


def _measured_states(log: Log) -> Array:
    """Return states (N, 6) as far as the sensors give them; NaN elsewhere."""
    out = np.full((len(log), 6), math.nan)
    out[:, :2] = log.z[:, :2]
    out[:, PSI] = log.z[:, COMPASS]
    out[:, R] = log.z[:, GYRO]
    there = np.isfinite(out[:, PSI])
    if there.sum() < 2:
        return out
    t, psi = log.t[there], np.unwrap(out[there, PSI])
    heading = np.interp(log.t, t, psi)
    c, s = np.cos(heading), np.sin(heading)
    out[:, U] = log.z[:, GPS_VX] * c + log.z[:, GPS_VY] * s
    out[:, V] = log.z[:, GPS_VY] * c - log.z[:, GPS_VX] * s
    if not np.isfinite(out[:, R]).any():
        # no gyro: the slope of the heading over one second, short enough for a boat's turn
        late, early = np.minimum(log.t + 0.5, t[-1]), np.maximum(log.t - 0.5, t[0])
        turned = np.interp(late, t, psi) - np.interp(early, t, psi)
        out[:, R] = turned / np.maximum(late - early, 1e-9)
    return out


def gps_fixes(log: Log) -> Array:
    """Return the positions (n, 2) of all GPS fixes."""
    fixes = log.z[:, :2]
    return fixes[np.isfinite(fixes).all(axis=1)]


def example_times(run: RunFigure) -> list[float]:
    """Return the times at which the examples were made, s."""
    times = {round(p.t0, 3) for examples in run.examples.values() for p in examples}
    return sorted(times)[:3]


def examples_at(run: RunFigure, t0: float) -> dict[str, Prediction]:
    """Return the predictions made at a time, by predictor."""
    return {
        name: prediction
        for name, examples in run.examples.items()
        for prediction in examples
        if abs(prediction.t0 - t0) < 2e-3
    }
