"""The pictures of a benchmark, and of a log.

Nothing here computes a result. matplotlib is imported when the first picture is drawn, and never
through pyplot: neither an import nor a picture changes anything for the caller.
"""

from twin.benchmark.figures.data import DeckHistory, PredictorFigure, RunFigure
from twin.benchmark.figures.results import (
    error_figure,
    verdict_figure,
)
from twin.benchmark.figures.runs import (
    deck_figure,
    picture_of_log,
    prediction_figure,
    track_figure,
)
from twin.benchmark.figures.style import predictor_styles

__all__ = [
    "DeckHistory",
    "PredictorFigure",
    "RunFigure",
    "deck_figure",
    "error_figure",
    "picture_of_log",
    "prediction_figure",
    "predictor_styles",
    "track_figure",
    "verdict_figure",
]
