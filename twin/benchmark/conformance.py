"""The causality test of a predictor, also of a user's: no forecast may use a row after its origin.

``usv-twin benchmark --check module:Class`` runs it. The accuracy of forecasts is not its matter.
"""

from __future__ import annotations

import copy
import traceback
from typing import Any

import numpy as np

from twin.digital_twin import Twin, known_plan
from twin.predictors.base import ForecastError, Prediction
from twin.predictors.registry import predictor_class
from twin.sim.bridge import particulars_of, simulate
from twin.sim.oracle import simulator_options
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.sea import SeaState
from usv_kernel.errors import UsvTwinError

__all__ = ["ContractError", "check_predictor", "raised"]

ORIGINS = (300, 500)
"""Numbers of rows after which the twin forecasts: 15 and 25 s at 20 Hz."""

TRAIN_AT_S = 20.0

HORIZON_S = 10.0
PLAN_STEP_S = 0.25


class ContractError(UsvTwinError):
    """A predictor whose forecasts use later rows, or are not finite; the message names it."""


def check_predictor(name: str) -> int:
    """Return how many forecasts were compared; each is that of a log cut at its origin.

    A twin gets a simulated zigzag of 40 s, and forecasts on the way. Each forecast must be finite,
    and equal to the last bit that of a new twin which gets the log up to the origin alone.

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
    vessel, sea = Vessel.load("usv75"), SeaState(hs=0.5, wind=4.5)
    log = simulate("zigzag", vessel=vessel, sea=sea, duration=40.0, seed=7)
    options: dict[str, Any] = simulator_options(name, vessel, sea, 3)
    if predictor_class(name).trains:
        options["train_at"] = TRAIN_AT_S

    def forecasts(rows: int, *origins: int) -> list[Prediction]:
        """Return what a new twin forecasts at its origins while it gets the first rows."""
        twin, found = Twin(particulars_of(vessel), name, seed=3, **options), []
        for k in range(rows):
            # copies: through the base of a view, a predictor could see the future
            twin.step(float(log.t[k]), log.z[k].copy(), log.cmd[k].copy())
            if k + 1 in origins:
                plan = known_plan(log, k, HORIZON_S, PLAN_STEP_S)
                found.append(copy.deepcopy(twin.predict(plan, dt=PLAN_STEP_S)))
        return found

    try:
        for origin, found in zip(ORIGINS, forecasts(len(log), *ORIGINS), strict=True):
            (alone,) = forecasts(origin, origin)
            _compare(f"{name}: after {origin} rows", found, alone)
    except ContractError:
        raise
    except ForecastError as error:  # names the predictor
        raise ContractError(str(error)) from error
    except Exception as error:  # of a user's predictor
        raise ContractError(f"{name}: {raised(error)}") from error
    return len(ORIGINS)


def raised(error: Exception) -> str:
    """Return what code of a user raised, and where."""
    at = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({at.filename}, line {at.lineno})"


def _compare(where: str, found: Prediction, alone: Prediction) -> None:
    """Refuse a forecast that is not finite, or not that from a log cut at its origin."""
    for part in ("start", "start_cov", "mean", "cov", "low", "high"):
        value = getattr(alone, part)
        if not np.isfinite(value).all():
            raise ContractError(f"{where}, {part} is not finite; give every entry a number")
        if not np.array_equal(value, getattr(found, part)):
            raise ContractError(
                f"{where} of the whole log, {part} is not that from a log cut there; use only rows "
                "that update() has got, and let predict() change nothing"
            )
