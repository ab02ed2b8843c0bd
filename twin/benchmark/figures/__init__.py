"""The pictures of a benchmark, and of a log.

Nothing here computes a result. matplotlib is imported when the first picture is drawn, and never
through pyplot: neither an import nor a picture changes anything for the caller.
"""

from twin.benchmark.figures.bars import recorded_figure, verdict_figure
from twin.benchmark.figures.data import DeckHistory, PredictorFigure, RunFigure
from twin.benchmark.figures.deck import deck_figure, reliability_figure
from twin.benchmark.figures.errors import error_figure
from twin.benchmark.figures.history import parameter_figure, prediction_figure
from twin.benchmark.figures.style import predictor_styles
from twin.benchmark.figures.track import picture_of_log, track_figure
from twin.benchmark.figures.trends import TRENDS, trend_figure

__all__ = [
    "TRENDS",
    "DeckHistory",
    "PredictorFigure",
    "RunFigure",
    "deck_figure",
    "error_figure",
    "parameter_figure",
    "picture_of_log",
    "prediction_figure",
    "predictor_styles",
    "recorded_figure",
    "reliability_figure",
    "track_figure",
    "trend_figure",
    "verdict_figure",
]
