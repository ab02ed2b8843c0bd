"""The causality test of a predictor, also of a user's: no forecast may use a row after its origin.

``usv-twin benchmark --check module:Class`` runs it. The accuracy of forecasts is not its matter.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.digital_twin import Twin, known_plan
from twin.logs.log import Log
from twin.predictors.base import ForecastError, Predictor
from twin.predictors.baselines import COMMANDED, GRID, HistoryPredictor
from twin.predictors.registry import predictor_class
from twin.sim.bridge import particulars_of, simulate
from twin.sim.oracle import simulator_options
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.sea import SeaState
from usv_kernel.errors import UsvTwinError

__all__ = [
    "ContractError",
    "check_predictor",
]

Array = NDArray[np.float64]

ORIGINS = (300, 500)
"""Numbers of rows after which the twin forecasts: 15 and 25 s at 20 Hz."""

TRAIN_AT_S = 20.0

HORIZON_S = 10.0

SAME = 1e-6
"""Largest absolute and relative difference of two forecasts from the same row of a history: a net
rounds in another way where it forecasts from one row instead of many."""


class ContractError(UsvTwinError):
    """A predictor whose forecasts use later rows, or are not finite; the message names it."""


def check_predictor(name: str) -> int:
    """Return how many forecasts were compared; each is that of a log cut at its origin.

    A twin gets a simulated zigzag of 40 s, and forecasts on the way. Each forecast must be finite,
    and equal to the last bit that of a new twin which gets the log up to the origin alone. A
    :class:`~twin.predictors.baselines.HistoryPredictor` forecasts from earlier rows of its history
    too, for its intervals: each of these must be that from the history up to its row alone.

    Parameters
    ----------
    name : str
        A name in ``twin.PREDICTORS``, or ``module:Class``.

    Raises
    ------
    ContractError
        The predictor breaks one of these rules, or raises an error of its own.
    PredictorError
        There is no such predictor, or it cannot be imported.
    """
    kind = predictor_class(name)
    vessel, sea = Vessel.load("usv75"), SeaState(hs=0.5, wind=4.5)
    log = simulate("zigzag", vessel=vessel, sea=sea, duration=40.0, seed=7)
    options: dict[str, Any] = simulator_options(name, vessel, sea, 3)
    if kind.trains:
        options["train_at"] = TRAIN_AT_S

    def new_twin() -> Twin:
        return Twin(particulars_of(vessel), name, seed=3, **options)

    try:
        for origin, found in zip(
            ORIGINS, _forecasts(new_twin(), log, len(log), ORIGINS), strict=True
        ):
            (alone,) = _forecasts(new_twin(), log, origin, (origin,))
            _compare(f"{name}: after {origin} rows", found, alone)
        history = new_twin()  # without a forecast, which might fit a model
        history.run(log.without_truth())
        return 2 * len(ORIGINS) + _check_history(name, history.predictor)
    except ContractError:
        raise
    except ForecastError as error:  # names the predictor
        raise ContractError(str(error)) from error
    except Exception as error:  # of a user's predictor
        raise ContractError(f"{name}: {type(error).__name__}: {error}") from error


def _forecasts(twin: Twin, log: Log, rows: int, origins: Sequence[int]) -> list[dict[str, Array]]:
    """Feed the first rows of a log; return the arrays of the forecasts at each origin."""
    found = []
    for k in range(rows):
        # copies: through the base of a view, a predictor could see the future
        twin.step(float(log.t[k]), log.z[k].copy(), log.cmd[k].copy())
        if k + 1 in origins:
            plan = known_plan(log, k, HORIZON_S, GRID)
            known, held = twin.predict(plan, dt=GRID), twin.predict("hold", dt=GRID)
            found.append(
                {
                    f"{part} of the forecast with {what} commands": np.array(getattr(one, part))
                    for what, one in (("known", known), ("held", held))
                    for part in ("start", "start_cov", "mean", "cov", "low", "high")
                }
            )
    return found


def _compare(where: str, found: Mapping[str, Array], alone: Mapping[str, Array]) -> None:
    """Refuse forecasts that are not finite, or not those from a log cut at their origin."""
    for part, value in alone.items():
        if not np.isfinite(value).all():
            raise ContractError(f"{where}, {part} is not finite; give every entry a number")
        if not np.array_equal(value, found[part]):
            raise ContractError(
                f"{where} of the whole log, {part} is not that from a log cut there; use only rows "
                "that update() has got, and let predict() change nothing"
            )


def _check_history(name: str, predictor: Predictor) -> int:
    """Return how many forecasts from rows of a history are those from the history cut there."""
    if not isinstance(predictor, HistoryPredictor):
        return 0
    rows, steps = np.array(predictor._rows), round(HORIZON_S / GRID)
    origins = np.arange(round(5.0 / GRID), len(rows) - steps, round(1.0 / GRID))
    plans = rows[origins[:, None] + np.arange(1, steps + 1), COMMANDED]
    # of copies: what one call fits to its rows would hide what another one uses
    whole = np.asarray(copy.deepcopy(predictor).forecast(rows.copy(), origins, plans))
    for k, origin in enumerate(origins):
        cut = copy.deepcopy(predictor)
        cut._rows = list(rows[: origin + 1])
        alone = cut.forecast(rows[: origin + 1].copy(), np.array([origin]), plans[k : k + 1])[0]
        if not np.allclose(whole[k], alone, rtol=SAME, atol=SAME):
            raise ContractError(
                f"{name}: forecast() from row {origin} changes by up to "
                f"{np.abs(whole[k] - alone).max():.3g} with the rows after it, of {len(rows)}; use "
                "rows[: origin + 1] alone for each origin"
            )
    return len(origins)
