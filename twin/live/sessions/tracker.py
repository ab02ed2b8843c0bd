"""A twin that takes rows one by one, its errors against later fixes, and what is shown of it."""

from __future__ import annotations

import bisect
import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.channels import U
from twin.digital_twin import Twin
from twin.predictors.base import Prediction
from twin.predictors.baselines import hold_velocity
from usv_gym.envs.scene import TwinOverlay
from usv_kernel.channels import COMPASS, GPS_X, GYRO

__all__ = [
    "HORIZON_S",
    "LOST_AFTER_S",
    "PLAN_STEP_S",
    "History",
    "TwinMonitor",
    "overlay_of",
    "sensor_timeout",
]

Array = NDArray[np.float64]

HORIZON_S = 10.0
"""Length of a forecast."""

PLAN_STEP_S = 0.25
"""Time between two rows of a plan."""

CURRENT = "C_north", "C_east"
"""Parameters of a model that are the velocity of the water."""

FIXES = 400
TRACK = 1500
"""Fixes and points of the track that are kept to be drawn."""

HISTORY_STEP_S = 0.5
HISTORY_ROWS = 1200
"""Time between two rows of the curves at first, and the number at which every other one goes."""

INTERVALS_MISSED = 3.0
LOST_AFTER_S = 0.5
"""Silence after which a sensor counts as lost: nominal intervals, and the least time."""

TRACK_SPACING_LENGTHS = 0.05
"""Least distance of two points of the track, in lengths of the boat."""

ERROR_GAP_S = 1.0
RESTART_GAP_S = 30.0
"""Gap between rows after which no errors are computed, and after which the curves begin again."""


def overlay_of(prediction: Prediction) -> TwinOverlay:
    """Return a prediction as what pictures draw."""
    return TwinOverlay(
        state=prediction.start,
        cov=prediction.start_cov[:2, :2],
        horizons=prediction.t - prediction.t0,
        ahead=prediction.mean,
        covs=prediction.cov[:, :2, :2],
    )


def sensor_timeout(interval: float) -> float:
    """Return the time without a sample, s, after which a sensor of that interval counts as lost."""
    return max(INTERVALS_MISSED * interval, LOST_AFTER_S)


@dataclass(frozen=True, eq=False)
class History:
    """Curves over time."""

    t: Array  # (T,): time, s
    # (T,): error (m) of the position predicted 10 s before: by the twin, and by held velocity and
    # turn rate. NaN where there is no reference
    error: Array
    error_hold: Array
    # (T, p): parameters and their standard deviations
    params: Array
    params_sd: Array

    def rows(self, chosen: NDArray[np.bool_]) -> History:
        """Return some rows, chosen by a mask (T,)."""
        return History(**{name: values[chosen] for name, values in vars(self).items()})

    def since(self, span: float) -> History:
        """Return the rows of the last seconds."""
        return self.rows(self.t >= self.t[-1] - span) if len(self.t) else self


class TwinMonitor:
    """A twin that is stepped by this class only, and what a view shows of it.

    ``t`` is the time of the last row, s. ``measured`` (3,) has the last fix (m north and east) and
    compass heading (rad), NaN before the first. ``fixes`` and ``track`` are the last fixes, and
    where the boat was (the truth where it is known, else the estimate), m. ``gps_age`` is the time
    since the last fix, s. ``error, error_hold``: see :class:`History`.
    """

    def __init__(self, twin: Twin) -> None:
        self.twin = twin
        self.t = math.nan
        self.measured = np.full(3, math.nan)
        self.fixes: deque[tuple[float, float]] = deque(maxlen=FIXES)
        self.track: deque[tuple[float, float]] = deque(maxlen=TRACK)
        self.error = self.error_hold = math.nan
        self._fixed_at, self._gyro_at = math.nan, math.nan
        self._intervals: deque[float] = deque(maxlen=21)
        self._open: deque[tuple[float, Array, Array]] = deque()
        self._place = (math.nan, math.nan)
        self._rows: list[tuple[tuple[float, ...], Array, Array]] = []
        self._step = HISTORY_STEP_S

    @property
    def gps_age(self) -> float:
        """Time since the last fix, s; infinite before the first."""
        return self.t - self._fixed_at if math.isfinite(self._fixed_at) else math.inf

    @property
    def sensor_timeout(self) -> float:
        """Time without a fix after which GPS counts as lost, s."""
        return sensor_timeout(float(np.median(self._intervals)) if self._intervals else 1.0)

    @property
    def gps_lost(self) -> bool:
        """Whether fixes that should have come by now did not."""
        return self.gps_age > self.sensor_timeout

    @property
    def has_imu(self) -> bool:
        """Whether a turn rate has ever come."""
        return math.isfinite(self._gyro_at)

    @property
    def imu_age(self) -> float:
        """Time since the last turn rate, s; 0 where none ever came."""
        return self.t - self._gyro_at if self.has_imu else 0.0

    def step(self, t: float, z: Array, cmd: Array, truth: Array | None = None) -> None:
        """Take one row, as :meth:`twin.digital_twin.Twin.step`.

        ``truth`` (6,) is for the errors alone, NaN where it is not known. No twin receives it.
        """
        fix, heading = z[GPS_X : GPS_X + 2], float(z[COMPASS])
        if t - self.t > RESTART_GAP_S:
            self._rows, self._step = [], HISTORY_STEP_S
            self.error = self.error_hold = math.nan
        self.twin.step(t, z, cmd)
        before, self.t = self.t, t
        if math.isfinite(fix[0]):
            self.measured[:2] = fix
            self.fixes.append((float(fix[0]), float(fix[1])))
            if math.isfinite(self._fixed_at):
                self._intervals.append(t - self._fixed_at)
            self._fixed_at = t
        if math.isfinite(heading):
            self.measured[2] = heading
        if math.isfinite(z[GYRO]):
            self._gyro_at = t
        self._note_errors(before, truth)
        if not self._rows or t >= self._rows[-1][0][0] + self._step:
            self._note()

    def predict(self, plan: str | Array = "hold") -> Prediction | None:
        """Return where the boat will be; None before a first fix.

        ``plan`` is "hold", or commands (HORIZON_S / PLAN_STEP_S, 4), every :data:`PLAN_STEP_S`. The
        prediction is scored when its last moment has come.
        """
        if not self.twin.predictor.estimate().ready:
            return None
        prediction = self.twin.predict(plan, horizon=HORIZON_S, dt=PLAN_STEP_S)
        start = prediction.start
        held = hold_velocity(start, start[U:], np.array([HORIZON_S]))[0]
        if not self._open or self.t > self._open[-1][0]:
            self._open.append((self.t, prediction.mean[-1, :2], held[:2]))
        return prediction

    def current_at(self, t: float) -> Array | None:
        """Return the velocity of the water as estimated at a time, s; from any thread.

        That is (4,): north, east, and their standard deviations, m/s; None without an estimate.
        """
        names = self.twin.predictor.parameter_names
        rows = list(self._rows)
        row = bisect.bisect_right(rows, t, key=lambda each: each[0][0])
        if not set(CURRENT) <= set(names) or not row:
            return None
        columns = [names.index(name) for name in CURRENT]
        params, sd = rows[row - 1][1:]
        return np.concatenate([params[columns], sd[columns]])

    def history(self) -> History:
        """Return the curves up to now; may be called from any thread."""
        rows, size = list(self._rows), len(self.twin.predictor.parameter_names)
        widths = 3, size, size
        curves, *parts = (
            np.array([row[k] for row in rows]).reshape(len(rows), width)
            for k, width in enumerate(widths)
        )
        return History(*curves.T, *parts)

    def _note_errors(self, before: float, truth: Array | None) -> None:
        """Note the error of the prediction whose horizon has just passed."""
        last = self._place
        if truth is not None and math.isfinite(truth[0]):
            self._place = float(truth[0]), float(truth[1])
        elif self.gps_lost:
            self._place = math.nan, math.nan
        else:
            s = self.twin.predictor.state
            self._place = float(s[0]), float(s[1])
        far = TRACK_SPACING_LENGTHS * self.twin.particulars.length
        there = math.isfinite(self._place[0])
        if there and (not self.track or math.dist(self.track[-1], self._place) > far):
            self.track.append(self._place)
        while self._open and self._open[0][0] + HORIZON_S <= self.t + 1e-9:
            due, by_twin, held = self._open.popleft()
            share = (due + HORIZON_S - before) / (self.t - before)
            share = share if self.t - before < ERROR_GAP_S else math.nan
            place = [a + share * (b - a) for a, b in zip(last, self._place, strict=True)]
            self.error = math.dist(place, by_twin)
            self.error_hold = math.dist(place, held)

    def _note(self) -> None:
        """Add a row to the curves; when there are too many, keep every second."""
        if len(self._rows) >= HISTORY_ROWS:
            self._rows = self._rows[::2]
            self._step *= 2.0
        row, now = (self.t, self.error, self.error_hold), self.twin.estimate()
        self._rows.append((row, now.params.copy(), now.params_sd.copy()))
