"""What is remembered of the motion for forecasts, and the constants of learning them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.motion.state import HEAVE_FORGETTING_S
from twin.particulars import Particulars
from usv_kernel.records import record_size

__all__ = [
    "CHANNELS",
    "DECK_SPEED",
    "FORECAST",
    "FORECAST_SETTINGS",
    "FORECAST_WORK",
    "HEAVE_CHANNEL",
    "HORIZONS",
    "N_CHANNELS",
    "N_HORIZONS",
    "PITCH",
    "QUIET_SPANS",
    "ROLL",
    "forecast_settings",
    "initial_forecast",
]

Array = NDArray[np.float64]

CHANNELS = ("roll_rad", "pitch_rad", "heave_m", "deck_speed_mps")
"""What is forecast. Heave and the vertical speed of the deck point are positive down."""

ROLL, PITCH, HEAVE_CHANNEL, DECK_SPEED = range(len(CHANNELS))

N_CHANNELS = len(CHANNELS)

HORIZONS = np.concatenate([np.arange(1, 13) * 0.25, np.arange(7, 11) * 0.5, np.arange(6.0, 11.0)])
"""Times ahead of the forecasts, s."""

N_HORIZONS = len(HORIZONS)

LONGEST_S = float(HORIZONS[-1])

TARGETS = N_CHANNELS * N_HORIZONS

N_LAGS = 16
"""Samples of each signal that a forecast is made from ..."""

LAG_S = 0.2
LAG_LENGTH_M = 6.336
"""... and the time between them on a boat of this length: it grows with the root of it."""

BASE_STEP_S = 0.05
"""Time between the rows that are kept; more for ships."""

TICK_ROWS = 4
"""Rows between two that are learned from."""

SIGNALS = 7
"""Roll, pitch, their rates, heave, vertical speed, vertical acceleration; the deck's vertical speed
follows."""

PLACES = (0, 1, 4, 7)
"""Where the channels stand among these ..."""

ERROR_PLACES = (0, 1, 4, 5)
"""... and the signal that holds the lasting error of the estimate of each."""

N_FEATURES = N_LAGS * SIGNALS

N_TERMS = N_FEATURES + 1

RING_ROWS = round(LONGEST_S / BASE_STEP_S) + TICK_ROWS * N_LAGS

RIDGE = 0.01
"""Penalty of the ridge regression, over the variance of the features."""

FORGETTING_S = 60.0
"""Time constant with which samples of the regression are forgotten."""

REFIT_S = 10.0
"""Time between fits."""

FIRST_FIT_S = 25.0
"""Time of data before the first fit."""

VERIFIED_FORGETTING_S = 60.0
"""Time constant with which verified errors are forgotten."""

FIT_PRIOR_TICKS = 60.0
"""Prior weight of the error of a fit on its own data beside verified ones, in ticks."""

FREEDOM_SHARE = 0.5
"""Effective degrees of freedom of a fit over the number of features."""

PRIOR_SD = (0.05, 0.05, 0.2, 0.3)
"""Prior standard deviation by channel: rad, rad, m, m/s."""

PRIOR_TIME_S = 3.0
"""Prior weight of that, as time of data."""

HEEL_MEAN_S = 2.0
HEEL_FORGETTING_S = 300.0
"""Time constants of the means of heel and trim, and of the regression on accelerations."""

HEEL_PRIOR = (-0.2, 0.0)
HEEL_PRIOR_SD = (0.3, 0.1)
"""Prior mean and standard deviation of roll and pitch, rad, for an acceleration of 1 g to starboard
and forward."""

HEEL_NOISE_RAD = 0.02
HEEL_NOISE_S = 5.0
"""Standard deviation and correlation time of the mean angle in that regression."""

N_ERRORS = 64
ERROR_PERIOD_S = 1.6
"""Past forecasts whose errors make the probability of a quiet deck, and the time between them."""

UNSURE_SHARE = 0.5
"""Present standard deviation over the limit from which on a channel is hardly measured."""

QUIET_SPANS = (2.0, 3.0, 5.0)
"""Times for which the deck may stay quiet, s."""

N_QUIET = int(np.searchsorted(HORIZONS, QUIET_SPANS[-1])) + 1
"""Horizons within them."""

ERROR_TIMES_S = (10.0, 10.0, HEAVE_FORGETTING_S, 1.0)
"""Correlation time of the error of the estimate, by channel."""

ERROR_LEFT = np.exp(-HORIZONS / np.array(ERROR_TIMES_S)[:, None]).ravel()
"""Share of such an error that is left at each horizon."""

HEAVE_LEAK_GNSS = 0.06
HEAVE_LEAK_ALONE = 0.6
CLIMB_LEAK = 0.15
"""Share of the heave that the filter leaves out or shifts, with GNSS and without, and of the
vertical speed without."""

QUIET_CHANNELS = (ROLL, PITCH, DECK_SPEED)

STEPS = round(LONGEST_S / (TICK_ROWS * BASE_STEP_S))

FORECAST = np.dtype(
    [
        ("ring", "f8", (RING_ROWS, SIGNALS + 1)),  # signals and deck speed
        ("before", "f8", SIGNALS + 1),  # those of the row before
        ("t_before", "f8"),  # its time, s; NaN before the first
        ("begun", "f8"),  # time of the first row of the ring, s
        ("rows", "f8"),  # rows of the ring so far
        ("gram", "f8", (N_TERMS, N_TERMS)),  # weighted sums of products of 1 and features, upper
        ("cross", "f8", (N_TERMS, TARGETS)),  # ... and of targets
        ("squares", "f8", TARGETS),  # ... and of their squares
        ("weight", "f8"),  # of the next tick; grows, so that older ones count less
        ("weights", "f8", 2),  # sums of the weights and of their squares
        ("fitted", "f8"),  # ticks until the next fit
        ("coefficients", "f8", (N_TERMS, TARGETS)),  # of the fit; first those of 1
        ("means", "f8", TARGETS),  # of the targets at the fit
        ("fit_var", "f8", TARGETS),  # variances of its errors
        ("fit_worth", "f8", TARGETS),  # share of the variance that it explains
        ("gain", "f8", TARGETS),  # what a forecast makes of a constant error of its channel
        ("is_fit", "f8"),  # 1 once there is a fit
        ("made", "f8", (STEPS, TARGETS)),  # forecasts of past ticks, deviations from the means
        ("made_at", "f8", (STEPS, 2)),  # number of their tick, 1 where there was a fit
        ("made_means", "f8", (STEPS, TARGETS)),
        ("verified", "f8", (3, TARGETS)),  # mean squares: forecast, forecast times truth, truth
        ("verifications", "f8"),  # how many ticks these stand for
        ("errors", "f8", (N_ERRORS, 3, N_QUIET)),  # of QUIET_CHANNELS
        ("n_errors", "f8"),
        ("noise", "f8", N_CHANNELS),  # variances of the estimates of the channels
        ("moments", "f8", (3, N_CHANNELS)),  # mean, mean square, and seconds of each channel
        ("smooth", "f8", (2, 2)),  # mean angles and mean accelerations / g, of roll and pitch
        ("speed", "f8"),  # forward, of the row before, m/s
        ("heel_sums", "f8", (2, 5)),  # of 1, a, y, a a, a y
        ("heel", "f8", 2),  # roll and pitch for 1 g
    ]
)
"""What is remembered for forecasts. All are float64, so that it fits into flat memory."""

FORECAST_SETTINGS = np.dtype(
    [
        ("base", "f8"),  # s between rows of the ring
        ("lag", "f8"),  # rows between the samples of a forecast
        ("deck", "f8", 3),  # the deck point: m forward, to starboard, down
        ("limits", "f8", 3),  # of QUIET_CHANNELS
        ("at", "f8", N_HORIZONS),  # HORIZONS in rows of the ring
    ]
)

FORECAST_WORK = np.dtype(
    [
        ("features", "f8", N_TERMS),
        ("targets", "f8", TARGETS),
        ("scale", "f8", N_TERMS),
        ("factor", "f8", (N_FEATURES, N_FEATURES)),
        ("right", "f8", (N_FEATURES, TARGETS)),
        ("now", "f8", SIGNALS + 1),
    ]
)
"""Scratch; one serves many boats."""


def initial_forecast() -> Array:
    """Return the memory of a boat before its first row: :data:`FORECAST` as flat float64."""
    memory = np.zeros(record_size(FORECAST))
    record = memory.view(FORECAST)[0]
    record["t_before"] = record["speed"] = np.nan
    record["weight"] = 1.0
    record["heel"] = HEEL_PRIOR
    record["made_at"] = -1.0
    return memory


def forecast_settings(particulars: Particulars) -> Array:
    """Return :data:`FORECAST_SETTINGS` of a boat as flat float64."""
    memory = np.zeros(record_size(FORECAST_SETTINGS))
    record = memory.view(FORECAST_SETTINGS)[0]
    scale = math.sqrt(particulars.length / LAG_LENGTH_M)
    base = BASE_STEP_S * max(round(scale), 1)
    record["base"], record["lag"] = base, min(max(round(LAG_S * scale / base), 2), TICK_ROWS)
    deck = particulars.deck
    record["deck"] = deck.point_of(particulars.length)
    record["limits"] = deck.max_tilt, deck.max_tilt, deck.max_speed
    record["at"] = HORIZONS / base
    return memory
