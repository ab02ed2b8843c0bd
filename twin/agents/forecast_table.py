"""How predictable the boat of each agent is: scores of a twin's forecasts over many episodes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["FORECAST_HEADS", "forecast_rows", "mean_scores"]

HORIZONS = (1, 2, 5, 10)
"""Seconds ahead, as in the names of scores."""

PLACES = {"": "with all sensors", "_loss": "while sensors are lost"}

PLANS = {"known": "that came", "held": "held"}

COUNTED_BY_INTERVALS = "coverage90"

FORECAST_HEADS = (
    *("ahead, s", "displacement, m", "heading, deg", "speed, m/s"),
    *("coverage: displacement", "heading", "speed", "forecasts"),
)
"""Heads of what :func:`forecast_rows` returns, after the place and the plan."""

Scores = Mapping[str, float]


def mean_scores(episodes: Sequence[Scores]) -> dict[str, float]:
    """Return the scores over all forecasts of some episodes, by name.

    Each episode has what :class:`twin.sim.forecast_scores.ForecastScores` names; it weighs as much
    as it has forecasts.
    """
    found: dict[str, float] = {}
    for place in PLACES:
        for count in ("n", "n_intervals"):
            found[count + place] = math.fsum(one.get(count + place, 0.0) for one in episodes)
    for name in dict.fromkeys(name for one in episodes for name in one if name not in found):
        weight = "n_intervals" if name.endswith(COUNTED_BY_INTERVALS) else "n"
        weight += "_loss" if "_loss_" in name else ""
        parts = [one[name] * one[weight] for one in episodes if name in one]
        found[name] = math.fsum(parts) / found[weight]
    return found


def forecast_rows(episodes: Sequence[Scores]) -> list[list[str]]:
    """Return rows of a table for the episodes of one agent, by place, plan and time ahead."""
    scores = mean_scores(episodes)
    return [
        [PLACES[place], PLANS[plan], *_cells(scores, plan, place, horizon)]
        for place in PLACES
        for plan in PLANS
        for horizon in HORIZONS
        if scores[f"n{place}"]
    ]


def _cells(scores: Scores, plan: str, place: str, horizon: int) -> list[str]:
    """Return the cells of a row, by :data:`FORECAST_HEADS`."""
    stem = f"{plan}{place}_{horizon}s"
    errors = (
        f"{scores[f'{stem}_displacement_m']:.2f}",
        f"{math.degrees(scores[f'{stem}_heading_rad']):.1f}",
        f"{scores[f'{stem}_speed_mps']:.2f}",
    )
    shares: list[Any] = [
        scores.get(f"{stem}_{channel}_coverage90")
        for channel in ("displacement", "heading", "speed")
    ]
    covered = ["-" if share is None else f"{share:.0%}" for share in shares]
    return [str(horizon), *errors, *covered, f"{scores[f'n{place}']:.0f}"]
