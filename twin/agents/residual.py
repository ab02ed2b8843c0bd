"""What a trained agent corrects: a classical controller, and by how much."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, TypeAlias

from twin.agents.controllers import BASES, LOS, make_controller
from twin.agents.hyperparameters import CORRECTING
from twin.agents.mpc import ModelPredictive

__all__ = ["Base", "Residual", "make_base", "residual_of"]

Base: TypeAlias = LOS | ModelPredictive
"""What may be corrected: it names the entries that it needs, and forgets boat by boat."""


class Residual(NamedTuple):
    """A controller, and what a correction of 1 adds to its action."""

    base: str
    share: float = 0.5


def residual_of(algo: str, given: Mapping[str, Any], task: str) -> Residual | None:
    """Return what an algorithm corrects, by the table [residual] of its hyperparameters."""
    base = "dock-twin" if task == "docking" else "los-twin"
    return Residual(**{"base": base, **given}) if algo in CORRECTING else None


def make_base(residual: Residual) -> Base:
    """Return a new controller of those that may be corrected."""
    assert residual.base in BASES
    made = make_controller(residual.base)
    assert isinstance(made, Base)
    return made
