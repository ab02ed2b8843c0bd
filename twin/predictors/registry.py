"""The predictors by name: the one place to add one.

A predictor of another package joins by an entry point in the group
:data:`GROUP`, for example in ``pyproject.toml``::

    [project.entry-points."usv_twin.predictors"]
    mine = "my_package.predict:Mine"

or is named as ``module:Class``, without being registered at all.
"""

from __future__ import annotations

import inspect
import sys
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from twin.particulars import Particulars
from twin.predictors.base import Predictor
from usv_kernel.errors import UsvTwinError, check_options, did_you_mean

__all__ = [
    "DEFAULT",
    "EXTRAS",
    "GROUP",
    "PREDICTORS",
    "PredictorError",
    "make_predictor",
    "predictor_class",
]

GROUP = "usv_twin.predictors"
"""Group of the entry points by which other packages add predictors."""

PREDICTORS: dict[str, str | type[Predictor]] = {
    "persistence": "twin.predictors.baselines:Persistence",
    "persistence-8s": "twin.predictors.baselines:SmoothedPersistence",
    "ukf": "twin.predictors.ukf:UKFPredictor",
    "dsw-ukf": "twin.predictors.dsw_ukf:DSWPredictor",
    "dsw-ukf-plus": "twin.predictors.dsw_ukf_plus:PlusPredictor",
    "var": "twin.predictors.learned.varx:VARPredictor",
    "lstm": "twin.predictors.learned.lstm:LSTMPredictor",
    "fleet-lstm": "twin.predictors.learned.pretrained:FleetLSTM",
    "transformer": "twin.predictors.learned.pretrained:FleetTransformer",
    "oracle": "twin.sim.oracle:Oracle",
}
"""Name to class, or to ``module:Class``, which is imported when it is first asked for."""

for _entry in entry_points(group=GROUP):  # those of this package keep their names
    PREDICTORS.setdefault(_entry.name, _entry.value)

EXTRAS = {"lstm": ("torch", "lstm")}
"""Predictors that need more than the base: the module, and the extra that installs it."""

DEFAULT = "dsw-ukf-plus"
"""The predictor that is used where none is named."""


class PredictorError(UsvTwinError):
    """A predictor that is not known or cannot be used; the message says what can."""


def predictor_class(name: str) -> type[Predictor]:
    """Return the class of a predictor; errors as for :func:`make_predictor`.

    The module of ``module:Class`` may lie in the working directory.
    """
    entry: Any = name
    if not (isinstance(name, str) and ":" in name):
        try:
            entry = PREDICTORS[name]
        except (KeyError, TypeError):
            raise PredictorError(
                f"no predictor is called {name!r}{did_you_mean(name, PREDICTORS)}; known: "
                f"{', '.join(PREDICTORS)}; others are named module:Class"
            ) from None
    if isinstance(entry, str):
        entry = _imported(name, entry)
    if not (isinstance(entry, type) and issubclass(entry, Predictor)):
        raise PredictorError(f"predictor {name!r}: {entry!r} is not a subclass of Predictor")
    if entry.needs_simulator and not entry.__module__.startswith("twin."):
        raise PredictorError(
            f"predictor {name!r}: only the oracle may use the simulator's vessel and sea"
        )
    return entry


def _imported(name: str, entry: str) -> Any:
    """Return what ``module:Class`` stands for."""
    module, attribute = entry.partition(":")[::2]
    here = str(Path.cwd())
    if name == entry and here not in sys.path:
        sys.path.append(here)  # as for python -m, and in the workers of any backend too
    try:
        return getattr(import_module(module), attribute)
    except Exception as error:  # whatever foreign code does when it is imported
        if name in EXTRAS and isinstance(error, ImportError):
            raise  # names the command that installs it
        raise PredictorError(
            f"predictor {name!r}: {module!r} cannot be imported with a class {attribute!r} "
            f"({type(error).__name__}: {error}); name it as module:Class, installed or in the "
            "working directory"
        ) from error


def make_predictor(
    name: str, particulars: Particulars, *, seed: int = 0, **options: Any
) -> Predictor:
    """Return a new predictor.

    Parameters
    ----------
    name : str
        One of :data:`PREDICTORS`, or ``module:Class``.
    particulars : Particulars
        The boat.
    seed : int
        For those that draw random numbers.
    **options
        Options of the class; those with a model structure take ``model``.

    Raises
    ------
    PredictorError
        Lists the names that there are, or says that there is no structure to choose.
    ArgumentError
        An option that the predictor does not have; lists those that it has.
    """
    kind = predictor_class(name)
    if "model" in options and not kind.models:
        raise PredictorError(f"predictor {name!r} has no model structure; leave out 'model'")
    # not of the class, whose __new__ takes anything; and without self and the particulars
    arguments = list(inspect.signature(kind.__init__).parameters.values())[2:]
    if not any(one.kind is one.VAR_KEYWORD for one in arguments):
        known = [one.name for one in arguments if one.kind is not one.VAR_POSITIONAL]
        check_options(f"predictor {name!r}", options, known)
    return kind(particulars, seed=seed, **options)
