"""The belief: a digital twin that sees measurements and commands, and nothing else.

>>> from twin import Log, Particulars, Twin
"""

from twin.log import Log, LogError, recorded_runs
from twin.particulars import Instruments, Particulars
from twin.predictor import Estimate, Prediction, Predictor
from twin.registry import PREDICTORS, make_predictor
from twin.state import StateError
from twin.twin import Twin, TwinError, known_plan

__all__ = [
    "PREDICTORS",
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
    "known_plan",
    "make_predictor",
    "recorded_runs",
]
