"""The predictors by name: the one place to add one."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from twin.particulars import Particulars
from twin.predictor import Predictor

__all__ = ["DEFAULT", "EXTRAS", "PREDICTORS", "PredictorError", "make_predictor", "predictor_class"]

PREDICTORS: dict[str, str | type[Predictor]] = {
    "persistence": "twin.predictor:Persistence",
    "persistence-8s": "twin.predictor:SmoothedPersistence",
    "ukf": "twin.identifier:UKFPredictor",
    "dsw-ukf": "twin.dsw:DSWPredictor",
    "dsw-ukf-plus": "twin.plus:PlusPredictor",
    "var": "twin.var:VARPredictor",
    "lstm": "twin.neural:LSTMPredictor",
    "fleet-lstm": "twin.pretrained:FleetLSTM",
    "transformer": "twin.pretrained:FleetTransformer",
    "oracle": "twin.oracle:Oracle",
}
"""Name to class, or to ``module:Class``, which is imported when it is first asked for."""

EXTRAS = {"lstm": ("torch", "lstm")}
"""Predictors that need more than the base: the module, and the extra that installs it."""

DEFAULT = "dsw-ukf-plus"
"""The predictor that is used where none is named."""


class PredictorError(ValueError):
    """A predictor that is not known or cannot be used; the message says what can."""


def predictor_class(name: str) -> type[Predictor]:
    """Return the class of a predictor; errors as for :func:`make_predictor`."""
    try:
        entry = PREDICTORS[name]
    except (KeyError, TypeError):
        raise PredictorError(
            f"no predictor is called {name!r}; known: {', '.join(PREDICTORS)}"
        ) from None
    if isinstance(entry, str):
        module, _, attribute = entry.partition(":")
        entry = getattr(import_module(module), attribute)
    if not (isinstance(entry, type) and issubclass(entry, Predictor)):
        raise PredictorError(f"predictor {name!r}: {entry!r} is not a subclass of Predictor")
    return entry


def make_predictor(
    name: str, particulars: Particulars, *, seed: int = 0, **options: Any
) -> Predictor:
    """Return a new predictor.

    Parameters
    ----------
    name : str
        One of :data:`PREDICTORS`.
    particulars : Particulars
        The boat.
    seed : int
        For those that draw random numbers.
    **options
        Handed to the class; those with a model structure take ``model``.

    Raises
    ------
    PredictorError
        Lists the names that there are, or says that there is no structure to choose.
    """
    kind = predictor_class(name)
    if "model" in options and not kind.models:
        raise PredictorError(f"predictor {name!r} has no model structure; leave out 'model'")
    return kind(particulars, seed=seed, **options)
