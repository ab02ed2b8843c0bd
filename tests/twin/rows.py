"""Rows through what precedes a predictor, without one, for tests."""

from __future__ import annotations

from typing import Any

import numpy as np

from twin import Particulars
from twin.batch import HEALTH
from twin.filters.navigation_state import RESTART
from twin.integrity.monitor import SensorMonitor
from twin.integrity.sensing import ROW, sense_row
from twin.integrity.state import initial_integrity, integrity_settings
from usv_kernel.records import record_size, structured

NO_MOTION = (None, None, None)
AT_REST = np.zeros(6)


class Sensed:
    """A boat whose state nobody knows but who tells it with a row.

    ``row`` is the record of ``ROW``, ``monitor`` reads what the sensor checks remember.
    """

    def __init__(self, about: Particulars, last: float = np.nan) -> None:
        self.rows = np.zeros((1, record_size(ROW)))
        self.row = structured(self.rows, ROW)[0]
        self.row["last"] = last
        self.rows[0, HEALTH] = initial_integrity(about)
        self.monitor = SensorMonitor(self.rows[0, HEALTH])
        self._settings, self._restart = integrity_settings(about), np.zeros(record_size(RESTART))

    def take(
        self,
        t: float,
        z: np.ndarray,
        cmd: np.ndarray,
        state: np.ndarray = AT_REST,
        ready: bool = False,
        motion: Any = NO_MOTION,
    ) -> np.ndarray:
        """Take a row of time t, and return what of its measurements can be used."""
        self.row["t"], self.row["z"], self.row["cmd"] = t, z, cmd
        state = np.ascontiguousarray(state)
        sense_row(0, state, ready, (self.rows, self._settings, *motion), self._restart)
        return self.row["used"].copy()
