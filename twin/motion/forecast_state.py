"""What is remembered of the motion for forecasts, and the constants of learning them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.motion.state import MEMORY as MEMORY_OF_HEAVE
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

LAST = float(HORIZONS[-1])

TARGETS = N_CHANNELS * N_HORIZONS

LAGS = 16
"""Samples of each signal that a forecast is made from ..."""

LAG = 0.2
LAG_LENGTH = 6.336
"""... and the time between them, s, on a boat of this length (m). It grows with the root of it."""

BASE = 0.05
"""Time between the rows that are kept, s; more for ships."""

TICK = 4
"""Of these rows one in so many is learned from."""

SIGNALS = 7
"""Roll, pitch, their rates, heave, vertical speed, vertical acceleration; the deck's vertical speed
follows."""

PLACES = (0, 1, 4, 7)
"""Where the channels stand among these ..."""

ERROR_PLACES = (0, 1, 4, 5)
"""... and the signal that holds the lasting error of the estimate of each."""

N_FEATURES = LAGS * SIGNALS

N_TERMS = N_FEATURES + 1

RING_ROWS = round(LAST / BASE) + TICK * LAGS

PENALTY = 0.01
"""Of the ridge, in units of the features' own energy."""

MEMORY = 60.0
"""Time after which what was learned weighs a third, s."""

REFIT = 10.0
"""Time between fits, s."""

LEARNED = 25.0
"""Time of data before the first fit, s."""

VERIFIED = 60.0
"""Time after which a verified error weighs a third, s."""

TRUST_TICKS = 60.0
"""So many ticks does the error of a fit on its own data count, beside the verified ones."""

FIT_SHARE = 0.5
"""Share of the features that a fit is taken to use up."""

PRIOR_SD = (0.05, 0.05, 0.2, 0.3)
"""Standard deviation of each channel before it is known: rad, rad, m, m/s ..."""

PRIOR_TIME = 3.0
"""... which counts as so many seconds of data."""

HEEL_TIME = 2.0
HEEL_MEMORY = 300.0
"""Heel and trim are compared with means of this time, over this time, s."""

HEEL = (-0.2, 0.0)
HEEL_SD = (0.3, 0.1)
"""Roll and pitch for an acceleration of 1 g to starboard and forward, before any data, rad."""

HEEL_NOISE = 0.02
"""What else lets a mean angle wander, rad ..."""

HEEL_SAMPLE = 5.0
"""... for so long, s."""

ERRORS = 64
"""Forecasts whose errors are kept for the probability of a quiet deck, the newest ..."""

ERROR_PERIOD = 1.6
"""... and the time between them, s."""

UNSURE = 0.5
"""A channel whose present standard deviation is this share of its limit is hardly measured."""

QUIET_SPANS = (2.0, 3.0, 5.0)
"""Times for which the deck may stay quiet, s."""

N_QUIET = int(np.searchsorted(HORIZONS, QUIET_SPANS[-1])) + 1
"""Horizons within them."""

ERROR_TIMES = (10.0, 10.0, MEMORY_OF_HEAVE, 1.0)
"""How long an error of the estimate of each channel lasts, s."""

STAYS = np.exp(-HORIZONS / np.array(ERROR_TIMES)[:, None]).ravel()
"""Share of such an error that is left at each horizon."""

HEAVE_LEAK = (0.06, 0.6)
CLIMB_LEAK = 0.15
"""Share of the heave that the filter leaves out or shifts, with GNSS and without; the same of the
vertical speed without."""

QUIET_CHANNELS = (ROLL, PITCH, DECK_SPEED)

STEPS = round(LAST / (TICK * BASE))

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
        ("errors", "f8", (ERRORS, 3, N_QUIET)),  # of QUIET_CHANNELS
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
    record["heel"] = HEEL
    record["made_at"] = -1.0
    return memory


def forecast_settings(particulars: Particulars) -> Array:
    """Return :data:`FORECAST_SETTINGS` of a boat as flat float64."""
    memory = np.zeros(record_size(FORECAST_SETTINGS))
    record = memory.view(FORECAST_SETTINGS)[0]
    scale = math.sqrt(particulars.length / LAG_LENGTH)
    base = BASE * max(round(scale), 1)
    record["base"], record["lag"] = base, min(max(round(LAG * scale / base), 2), TICK)
    deck = particulars.deck
    record["deck"] = deck.point_of(particulars.length)
    record["limits"] = deck.max_tilt, deck.max_tilt, deck.max_speed
    record["at"] = HORIZONS / base
    return memory
