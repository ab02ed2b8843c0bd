"""What DSW-UKF+ remembers and is given: its window, its memory, configuration and scratch."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from twin.identification.conformal import RECORD
from twin.identification.prediction_error import GOOD
from twin.identification.wave_residual import ORDER, SECTOR_SIZE, SECTORS
from twin.model.dynamics import N_ACT
from twin.model.structure import N_STATES, ModelTerms
from usv_kernel.jit import inlined, kernel

__all__ = [
    "OBSERVER_GAIN",
    "WINDOW",
    "PlusConfig",
    "PlusMemory",
    "PlusWork",
    "all_good",
    "last_row",
    "observer_gain",
    "plus_config_of",
    "plus_work_of",
]

OBSERVER_GAIN = 0.5
"""Of the low-frequency observer, 1/s, at most. The velocities of a draw take on its waves by it,
too. A measured velocity is the observer's motion and its residual, and so will be those to come."""

GAIN_OF_SHIP = 2.0
"""The same in nominal speeds over length. An observer much faster than its ship follows what the
model leaves out, and its residual says no more of it."""

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
        ("next_check", "f8"),  # first row of the next forecast to compare
        *RECORD,
    ]
)
"""What a predictor remembers of its observer, window and waves, besides the rows."""


class PlusMemory(NamedTuple):
    """What a predictor remembers, flat; in a batch each row is a boat's."""

    nav: Any  # see NAVIGATION
    filter: Any  # see FilterState
    rows: Any  # (M, 24) rows of the window; see prediction_error.COLUMNS
    window: Any  # see WINDOW
    experts: Any  # see ExpertState
    segments: Any  # see SegmentState
    joint: Any  # see FilterState; of the joint filter, which identifies only


class PlusConfig(NamedTuple):
    """What a predictor is given of its boat."""

    nav: Any  # see NAVIGATION_SETTINGS
    filter: Any  # see FilterConfig
    model: Any  # ModelTerms
    refit: Any  # see RefitConfig
    joint: Any  # see FilterConfig; of the joint filter
    by_params: Any  # (D, p) standard normal numbers of the draws: parameters,
    by_start: Any  # (D, 6) starts ...
    by_waves: Any  # (D + 1, 40, 3) ... and waves, used again where they do not reach


class PlusWork(NamedTuple):
    """Scratch, which predictors of like boats can share."""

    nav: Any  # see NAVIGATION_WORK
    filter: Any  # see FilterWorkspace
    line: Any  # see LineariseWork
    solve: Any  # see SegmentWork
    evidence: Any  # see EvidenceWork
    waves: Any  # of _fit_waves
    check: Any  # see CheckWork


@inlined
def observer_gain(config):
    """Return the gain of the low-frequency observer, 1/s, by the settings of the joint filter."""
    return min(OBSERVER_GAIN, GAIN_OF_SHIP * 0.25 * config.envelope[2])


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


@inlined
def plus_config_of(config):
    """Return a configuration by name from a plain tuple."""
    which, limits, hull = config[2]
    model = ModelTerms(which, limits, hull)
    return PlusConfig(
        config[0], config[1], model, config[3], config[4], config[5], config[6], config[7]
    )


@inlined
def plus_work_of(work):
    """Return a workspace by name from a plain tuple."""
    return PlusWork(work[0], work[1], work[2], work[3], work[4], work[5], work[6])
