"""What DSW-UKF+ remembers of the last minutes: its observer, the rows of its window, the waves."""

from __future__ import annotations

import numpy as np

from twin.identification.interval_scale import RECORD
from twin.identification.prediction_error import GOOD
from twin.identification.wave_residual import ORDER, SECTOR_SIZE, SECTORS
from twin.model.dynamics import N_ACT
from twin.model.structure import N_STATES
from usv_kernel.jit import inlined, kernel

__all__ = ["OBSERVER_GAIN", "WINDOW", "all_good", "last_row", "observer_gain"]

OBSERVER_GAIN = 0.5
"""Largest gain of the low-frequency observer, 1/s; also that by which waves enter the velocities of
a drawn forecast."""

OBSERVER_GAIN_SHIP = 2.0
"""The same in nominal speeds over length: the residual of an observer much faster than its ship
would not hold the model's error."""

WINDOW = np.dtype(
    [
        ("origin", "f8"),  # time of the grid's origin, s
        ("halves", "f8"),  # half grid steps since then
        ("last", "f8", N_STATES),  # navigation state of the row before
        ("last_act", "f8", N_ACT),  # actuators of the row before
        ("slow", "f8", 3),  # low-frequency u, v (m/s), r (rad/s)
        ("next_start", "f8"),  # first row of the next segment
        ("refit_at", "f8"),  # time of the next refit, s
        ("wave_sd", "f8", 3),  # standard deviations of the waves in u, v, r
        ("wave_ar", "f8", (ORDER, 3)),  # autoregression that predicts the present waves
        ("sectors", "f8", (SECTORS, SECTOR_SIZE)),  # autoregressions of waves, by headings
        *RECORD,
    ]
)
"""What a predictor remembers of its observer, window and waves, besides the rows."""


@inlined
def observer_gain(config):
    """Return the gain of the low-frequency observer, 1/s, by the settings of the joint filter."""
    return min(OBSERVER_GAIN, OBSERVER_GAIN_SHIP * 0.25 * config.envelope[2])


@inlined
def last_row(window):
    """Return the number of the newest complete row of the window; -1 if there is none."""
    return int(window.halves) // 2 - 1


@kernel
def all_good(first, last, rows):
    """Return whether the rows from first to last, the last included, may be fitted."""
    good = True
    for k in range(first, last + 1):
        good = good and rows[k % rows.shape[0], GOOD] > 0.0
    return good
