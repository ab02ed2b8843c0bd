"""The predictors by name: the one place to add one.

A predictor of another package joins by an entry point in the group
:data:`GROUP`, for example in ``pyproject.toml``::

    [project.entry-points."usv_twin.predictors"]
    mine = "my_package.predict:Mine"

or is named as ``module:Class``, without being registered at all.

Options are part of a name: ``dsw-ukf:window=off,adapt=literal``, ``ukf:model=mmg``,
``module:Class:gain=2``. A preset of the class stands first: ``dsw-ukf:printed,window=off``. See
:mod:`twin.predictors.named_options`.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from twin.particulars import Particulars
from twin.predictors.base import Predictor
from twin.predictors.named_options import parse_options, split_name
from usv_kernel.errors import UsvTwinError, check_options, did_you_mean

__all__ = [
    "DEFAULT",
    "EXTRAS",
    "GROUP",
    "PREDICTORS",
    "PredictorError",
    "base_name",
    "make_predictor",
    "options_of",
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


def base_name(name: str) -> str:
    """Return a name without its options: ``"dsw-ukf"`` of ``"dsw-ukf:window=off"``."""
    return split_name(name, PREDICTORS)[0]


def predictor_class(name: str) -> type[Predictor]:
    """Return the class of a predictor; errors as for :func:`make_predictor`.

    The module of ``module:Class`` may lie in the working directory. Options in the name are
    checked for their names and types.
    """
    return _resolve(name)[0]


def options_of(name: str) -> dict[str, Any]:
    """Return the options that a name holds, each with the type that the class wants.

    Parameters
    ----------
    name : str
        As for :func:`make_predictor`.

    Raises
    ------
    PredictorError, ArgumentError
        As for :func:`make_predictor`.
    """
    return _resolve(name)[1]


def _resolve(name: str) -> tuple[type[Predictor], dict[str, Any]]:
    """Return the class of a name, and the options that it holds."""
    base, text = split_name(name, PREDICTORS) if isinstance(name, str) else (name, None)
    entry: Any = base
    if not (isinstance(base, str) and ":" in base):
        try:
            entry = PREDICTORS[base]
        except (KeyError, TypeError):
            raise PredictorError(
                f"no predictor is called {base!r}{did_you_mean(base, PREDICTORS)}; known: "
                f"{', '.join(PREDICTORS)}; others are named module:Class"
            ) from None
    if isinstance(entry, str):
        entry = _imported(base, entry)
    if not (isinstance(entry, type) and issubclass(entry, Predictor)):
        raise PredictorError(f"predictor {base!r}: {entry!r} is not a subclass of Predictor")
    if entry.needs_simulator and not entry.__module__.startswith("twin."):
        raise PredictorError(
            f"predictor {base!r}: only the oracle may use the simulator's vessel and sea"
        )
    if text is None:
        return entry, {}
    return entry, parse_options(base, text, entry.presets, _arguments(entry))


def _arguments(kind: type[Predictor]) -> Sequence[inspect.Parameter]:
    """Return the options of a class, without the particulars."""
    # not of the class, whose __new__ takes anything; and without self and the particulars
    return list(inspect.signature(kind.__init__).parameters.values())[2:]


def _imported(name: str, entry: str) -> Any:
    """Return what ``module:Class`` stands for."""
    module, attribute = entry.partition(":")[::2]
    here = str(Path.cwd())
    if name == entry and here not in sys.path:
        sys.path.append(here)  # as for python -m, and in workers too
    try:
        return getattr(import_module(module), attribute)
    except Exception as error:  # foreign code may raise anything when it is imported
        if name in EXTRAS and isinstance(error, ImportError):
            raise  # names the command that installs it
        raise PredictorError(
            f"predictor {name!r}: {module!r} cannot be imported with a class {attribute!r} "
            f"({type(error).__name__}: {error}){did_you_mean(module, PREDICTORS)}; name it as "
            f"{module.removesuffix('.py') or 'module'}:{attribute or 'Class'}, installed or in the "
            "working directory"
        ) from error


def make_predictor(
    name: str, particulars: Particulars, *, seed: int = 0, **options: Any
) -> Predictor:
    """Return a new predictor.

    Parameters
    ----------
    name : str
        One of :data:`PREDICTORS`, or ``module:Class``; options may follow a colon, as in
        ``"dsw-ukf:window=off"``.
    particulars : Particulars
        The boat.
    seed : int
        For those that draw random numbers.
    **options
        Options of the class; those with a model structure take ``model``.

    Raises
    ------
    PredictorError
        Lists the names that there are, or says that an option in the name has no such value or is
        given twice.
    ArgumentError
        An option that the predictor does not have; lists those that it has.
    """
    kind, named = _resolve(name)
    if twice := [option for option in named if option in options]:
        raise PredictorError(
            f"predictor {name!r}: {', '.join(twice)} stands in its name, and is given beside it; "
            "leave one out"
        )
    given = {**named, **options}
    arguments = _arguments(kind)
    if not any(one.kind is one.VAR_KEYWORD for one in arguments):
        known = [one.name for one in arguments if one.kind is not one.VAR_POSITIONAL]
        check_options(f"predictor {name!r}", given, known)
    try:
        return kind(particulars, seed=seed, **given)
    except UsvTwinError as error:
        if not named:
            raise
        # the message names the option, and here the text that it came from too
        raise PredictorError(f"predictor {name!r}: {error}") from None
