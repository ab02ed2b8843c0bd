"""The pictures of a benchmark.

Nothing here computes a result. matplotlib is imported when the first picture is drawn, and never
through pyplot: neither an import nor a picture changes anything for the caller.
"""

from twin.benchmark.figures.data import RunFigure
from twin.benchmark.figures.results import verdict_figure
from twin.benchmark.figures.runs import prediction_figure, track_figure
from twin.benchmark.figures.style import predictor_styles

__all__ = [
    "RunFigure",
    "prediction_figure",
    "predictor_styles",
    "track_figure",
    "verdict_figure",
]
