"""Prototype."""

from __future__ import annotations

import math

import numpy as np

from twin.health.checks import check_sensors
from twin.health.state import *
from twin.health import state as st
from usv_kernel.jit import kernel
from usv_kernel.records import as_record


@kernel
def _check(dt, z, cmd, s, ready, memory, settings, out):
    check_sensors(dt, z, cmd, s, ready, as_record(memory, HEALTH), as_record(settings, HEALTH_SETTINGS), out)


class SensorMonitor:
    def __init__(self, particulars):
        self.settings = health_settings(particulars)
        self.memory = initial_health(self.settings)
        self.out = np.full(10, math.nan)

    @property
    def health(self):
        return self.memory.view(HEALTH)[0]

    def check(self, dt, z, cmd, s, ready):
        _check(dt, z, cmd, s, ready, self.memory, self.settings, self.out)
        return self.out

    @property
    def commands_trusted(self):
        c = self.health["sensors"][4]
        return not (c["status"] == EXCLUDED or (c["status"] == DOUBTFUL and self.health["clock"] - c["since"] < 6.0))

    def words(self):
        h = self.health
        return {name: (STATUSES[int(c["status"])], REASONS[int(c["reason"])], float(c["since"])) for name, c in zip(SENSORS, h["sensors"])}
