"""Digital twin of a surface vessel: it uses measurements and commands, and nothing else.

>>> from twin import Log, Particulars, Twin
"""

from twin.checkpoint import StateError
from twin.digital_twin import Twin, TwinError, known_plan
from twin.logs.errors import LogError
from twin.logs.log import Log, recorded_runs
from twin.particulars import Deck, Instruments, Particulars
from twin.predictors.base import Estimate, Prediction, Predictor
from twin.predictors.registry import PREDICTORS, make_predictor
from usv_kernel import __version__

__all__ = [
    "PREDICTORS",
    "Deck",
    "Estimate",
    "Instruments",
    "Log",
    "LogError",
    "Particulars",
    "Prediction",
    "Predictor",
    "StateError",
    "Twin",
    "TwinError",
    "__version__",
    "known_plan",
    "make_predictor",
    "recorded_runs",
]
