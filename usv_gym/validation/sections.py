"""Sections of the validation page on ship and sea."""

from __future__ import annotations

from collections.abc import Callable

from usv_gym.validation.boundary_elements import hull_in_waves
from usv_gym.validation.manoeuvring import plants, tanker_measured, tanker_replay, tanker_trials
from usv_gym.validation.numerics import numerics
from usv_gym.validation.sea import sea, wind_and_drift
from usv_gym.validation.seakeeping import loads_in_waves, motions
from usv_gym.validation.study import Section, Study

__all__ = ["SECTIONS"]

SECTIONS: dict[str, Callable[[Study], Section]] = {
    "published trials": tanker_trials,
    "measured trials": tanker_measured,
    "replay": tanker_replay,
    "sea": sea,
    "wind and drift": wind_and_drift,
    "loads in waves": loads_in_waves,
    "hull in waves": hull_in_waves,
    "motions": motions,
    "small boats": plants,
    "numerics": numerics,
}
"""Functions that compute the sections, in the order of the page."""
