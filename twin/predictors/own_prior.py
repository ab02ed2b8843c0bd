"""A boat's own prior from the predictors of its earlier runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.boat_prior import SAME_BOAT_TOLERANCE, BoatPrior, BoatPriorError, combine
from twin.model.priors import takes
from twin.model.structure import ENVIRONMENT, N_STATES
from twin.predictors.base import Predictor
from twin.predictors.ukf import ModelPredictor, UKFPredictor

__all__ = [
    "prior_note",
    "prior_of_runs",
]


def prior_of_runs(predictors: Sequence[Predictor]) -> BoatPrior:
    """Return the prior of a boat's next run from the parameters of several runs.

    See :func:`twin.boat_prior.combine`.

    Parameters
    ----------
    predictors : sequence of Predictor
        One for each run, of one class, at its end. Each began with the population's prior.

    Raises
    ------
    BoatPriorError
        The runs are of several boats or models, or a run says nothing.
    """
    if not predictors:
        raise BoatPriorError("no run is given: give at least one")
    first = predictors[0]
    if not isinstance(first, ModelPredictor):
        raise BoatPriorError(
            f"a {type(first).__name__} has no parameters to keep; use dsw-ukf-plus or ukf"
        )
    boat, settings = first.particulars, first.ukf.settings
    names = settings.structure.parameters
    kept = [i for i, name in enumerate(names) if name not in ENVIRONMENT]
    part = np.ix_(kept, kept)
    runs = []
    for number, predictor in enumerate(predictors, 1):
        about = predictor.particulars
        if not isinstance(predictor, ModelPredictor) or predictor.parameter_names != names:
            raise BoatPriorError(f"run {number} has other parameters than the first: use one model")
        for key in ("length", "beam", "mass", "speed", "shaft_speed", "steering"):
            now, first_had = getattr(about, key), getattr(boat, key)
            # the load may change from run to run
            most = SAME_BOAT_TOLERANCE[key] if key in ("beam", "mass") else 0.0
            if now != first_had and (not most or abs(now / first_had - 1.0) > most):
                raise BoatPriorError(
                    f"run {number} has {key} = {now}, and the first {first_had}: a prior is of one "
                    "boat; use the same particulars"
                )
        if about.prior is not None:
            raise BoatPriorError(
                f"run {number} began with the boat's own prior, and would count twice: identify "
                "it without"
            )
        if not predictor.ready:
            raise BoatPriorError(
                f"run {number}: no fix and heading came together, so it says nothing; leave it out"
            )
        mean = predictor.ukf.xi[kept].copy()
        runs.append((mean, predictor.ukf.P[N_STATES:, N_STATES:][part].copy()))
        if not all(np.isfinite(value).all() for value in runs[-1]):
            raise BoatPriorError(f"run {number}: its parameters are not finite; leave it out")
    mean, cov = combine((settings.xi0[kept], settings.xi0_cov[part]), runs)
    return BoatPrior(
        boat=boat.name,
        model=settings.structure.name,
        steering=boat.steering,
        length=boat.length,
        beam=boat.beam,
        mass=boat.mass,
        speed=boat.speed,
        shaft_speed=boat.shaft_speed,
        runs=len(runs),
        parameters=tuple(names[i] for i in kept),
        mean=tuple(mean.tolist()),
        covariance=tuple(tuple(row) for row in cov.tolist()),
    )


def prior_note(predictor: Predictor, name: str) -> str:
    """Return why a predictor leaves its boat's own prior unused; empty if it does not."""
    prior = predictor.particulars.prior
    if prior is None:
        return ""
    unused = f"the prior of {prior.boat!r} is of the model {prior.model!r}; {name} "
    if not isinstance(predictor, UKFPredictor):
        return f"{unused}takes none, and starts without it"
    structure = predictor.ukf.settings.structure
    if takes(structure, predictor.particulars):
        return ""
    return (
        f"{unused}has the model {structure.name!r}, and starts without it; with the option "
        f"model={prior.model} behind a name, as in ukf:model={prior.model}, it is used"
    )
