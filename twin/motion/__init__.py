"""Roll, pitch and heave: estimate, forecast, sea, and the probability of a quiet deck.

May be imported from: ``twin.predictors`` and what lies above it. It runs on board.
"""

from twin.motion.deck_motion import DeckMotion, MotionEstimate, MotionForecast
from twin.motion.forecast_state import CHANNELS, HORIZONS, QUIET_SPANS
from twin.motion.sea_estimate import SeaEstimate

__all__ = [
    "CHANNELS",
    "HORIZONS",
    "QUIET_SPANS",
    "DeckMotion",
    "MotionEstimate",
    "MotionForecast",
    "SeaEstimate",
]
