"""Prior of a boat's parameters, from a population of similar boats.

The files in ``twin/model/priors`` hold the dimensionless parameters of random boats, for each model
structure and kind of boat (``examples/priors`` makes them), one boat a row. One file serves
boats of every size. For a class of boats (:data:`twin.particulars.DESIGNS`) the boats vary around a
model of the class. Its coefficients have errors of 20 %, as those of any model have.

Source: docs/explanation/twin.md, The refit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.boat_prior import limited
from twin.model.structure import ENVIRONMENT, MODELS, Structure
from twin.particulars import DRIVES_FROUDE_MIN, Particulars
from usv_kernel.errors import UsvTwinError

__all__ = [
    "KINDS",
    "Prior",
    "PriorError",
    "boat_or",
    "kind_of",
    "population_prior",
    "scaled_prior",
    "shipped_prior",
    "takes",
]

Array = NDArray[np.float64]

MEAN_DEVIATION_MAX_SD = 100.0
"""Largest deviation of a boat's own mean, in standard deviations of the population."""

_REMEDY = "make it again with usv-twin identify --save-prior, or leave it out"

KINDS = ("drives", "rudder", "differential")
"""Kinds of boats: fast ones on steerable drives, ships with rudders, fixed pairs of thrusters."""

TANKER = "tanker"
"""Ships with rudders that are of full form: sampled around one that was measured. The drafts
of the others are made to hold their course, and few tankers do."""

UNCORRELATED_PART = 0.3
"""Share of each variance that no other parameter explains, at the least."""

SPREAD_MIN = 1e-3
"""A smaller spread, as a share of the structure's own, means that calm water shows nothing."""


SCALE_SD = math.log(3.0)
SCALE_MAX = 10.0
"""Standard deviation of the logarithm of the drag of boats with two thrusters, and largest factor
of it: their drag over displacement at typical speeds is from .01 to .1 and more."""

_NO_DRAG = ("X_vr", "Y_ur", "N_uv", "X_w", "Y_w", "N_w", *ENVIRONMENT)
"""Parameters that do not grow with drag: those of mass, wind and sea."""


class PriorError(UsvTwinError):
    """A prior that cannot be used; the message names the file or value and the remedy."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Dimensionless parameters of a population of boats."""

    about: str  # one line that says how it was made
    parameters: tuple[str, ...]  # names of the p parameters
    # (b,): number of each boat in its population; those that the model did not fit are missing
    boats: NDArray[np.int64]
    fits: Array  # (b, p): their parameters in the natural units of the structure

    @classmethod
    def load(cls, path: Path) -> Prior:
        """Read a file that :meth:`to_csv` wrote; PriorError names the file and the remedy."""
        try:
            about, names, *rows = path.read_text(encoding="utf-8").splitlines()
            parameters = tuple(names.split(",")[1:])
            table = np.array([row.split(",") for row in rows], dtype=float)
            if table.shape != (len(rows), 1 + len(parameters)) or not np.isfinite(table).all():
                raise PriorError(f"{len(parameters)} parameters, table of shape {table.shape}")
        except (OSError, ValueError) as error:
            raise PriorError(
                f"{path}: is no prior ({error}); make a new one with examples/priors/population.py"
            ) from None
        return cls(about.removeprefix("# "), parameters, table[:, 0].astype(np.int64), table[:, 1:])

    def to_csv(self) -> str:
        """Return the text of a file, with six digits."""
        lines = [f"# {self.about}", ",".join(("boat", *self.parameters))]
        for boat, row in zip(self.boats, self.fits, strict=True):
            lines.append(",".join([str(boat), *(f"{value:.6g}" for value in row)]))
        return "\n".join(lines) + "\n"

    def of(self, structure: Structure) -> tuple[Array, Array]:
        """Return median (p,) and covariance (p, p) of a boat's parameters in SI units.

        Parameters that calm water does not show (wind, biases, the side force of drives that do not
        turn) keep the structure's mean and standard deviation. PriorError: the population is one of
        another structure.
        """
        if not set(self.parameters) <= set(structure.parameters):
            raise PriorError(
                f"the model {structure.name!r} has not all of {', '.join(self.parameters)}; take "
                "a prior of the same model"
            )
        mean, covariance = structure.mean.copy(), np.diag(structure.sd**2)
        at = np.array([structure.parameters.index(name) for name in self.parameters])
        fits = self.fits * structure.scales[at]
        shown = fits.std(axis=0) > SPREAD_MIN * structure.sd[at]
        at, fits = at[shown], fits[:, shown]
        mean[at] = np.median(fits, axis=0)
        spread = np.cov(fits.T)
        alone = UNCORRELATED_PART * np.diag(np.diag(spread))
        covariance[np.ix_(at, at)] = (1.0 - UNCORRELATED_PART) * spread + alone
        return mean, covariance


def kind_of(particulars: Particulars) -> str:
    """Return which of :data:`KINDS` a boat belongs to, or :data:`TANKER`."""
    if particulars.steering == "differential":
        return "differential"
    if particulars.tanker:
        return TANKER
    return "drives" if particulars.froude > DRIVES_FROUDE_MIN else "rudder"


@cache
def shipped_prior(model: str, kind: str) -> Prior:
    """Return a prior that comes with the package, by structure and kind.

    A kind is one of :data:`KINDS`, :data:`TANKER`, or a class of :data:`twin.particulars.DESIGNS`.
    """
    return Prior.load(Path(str(resources.files("twin.model") / "priors" / f"{model}_{kind}.csv")))


def population_prior(structure: Structure, particulars: Particulars) -> tuple[Array, Array]:
    """Return mean (p,) and covariance (p, p) of a boat's parameters before any data, in SI units.

    They are those of its class, if it is given, else those of its kind. Boats with a fixed pair of
    thrusters get the structure's own prior. The population of drafted hulls has no catamarans, and
    was the worse prior for Otter and for a recorded boat.
    """
    kind = particulars.design or kind_of(particulars)
    if kind == "differential":
        return structure.mean.copy(), np.diag(structure.sd**2)
    return shipped_prior(structure.name, kind).of(structure)


def scaled_prior(
    names: Sequence[str], mean: Array, sd: Array, found: Array
) -> tuple[float, Array, Array]:
    """Return the rough prior of a boat with the drag that a run has shown.

    At its typical speed a boat's thrust is its drag. So all terms of thrust, drag and damping grow
    together with drag over displacement, which the rough prior does not know. The factor is the one
    that leaves the least squared deviations, its own logarithm's (:data:`SCALE_SD`) among them.

    Parameters
    ----------
    names : sequence of str
        Of the p parameters.
    mean, sd : ndarray, shape (p,)
        Rough prior, in any units.
    found : ndarray, shape (p,)
        Parameters that a run has shown, in the same units.

    Returns
    -------
    factor : float
        Of drag, from 1 / :data:`SCALE_MAX` to :data:`SCALE_MAX`.
    mean, sd : ndarray, shape (p,)
        The prior of such a boat.
    """
    grows = np.array([name not in _NO_DRAG for name in names])
    factors = np.geomspace(1.0 / SCALE_MAX, SCALE_MAX, 121)
    known = grows & (sd > 0.0)
    far = (found[known] / factors[:, None] - mean[known]) / sd[known]
    factor = float(factors[np.argmin((far**2).sum(axis=1) + (np.log(factors) / SCALE_SD) ** 2)])
    scale = np.where(grows, factor, 1.0)
    return factor, scale * mean, scale * sd


def takes(structure: Structure, particulars: Particulars) -> bool:
    """Return whether a boat has a prior of its own for this structure.

    PriorError: a prior of no known model, or with parameters that its model does not have.
    """
    prior = particulars.prior
    if prior is None:
        return False
    if prior.model not in MODELS:
        raise PriorError(
            f"the prior of {prior.boat!r} is of the model {prior.model!r}, which is not one of "
            f"{', '.join(MODELS)}: {_REMEDY}"
        )
    if prior.model != structure.name:
        return False
    odd = sorted(set(prior.parameters) - {*structure.parameters, *ENVIRONMENT})
    if odd:
        raise PriorError(
            f"the prior of {prior.boat!r} has parameters that the model {structure.name!r} of "
            f"this boat does not have, such as {odd[0]!r}: {_REMEDY}"
        )
    return True


def boat_or(
    population: tuple[Array, Array], structure: Structure, particulars: Particulars
) -> tuple[Array, Array]:
    """Return the boat's own prior, mean (p,) and covariance (p, p) in SI units, if it has one.

    Parameters that it does not have, such as those of wind and sea, keep what the population says,
    and in no direction is the boat's prior wider. Without one, the population's is returned.
    PriorError: a prior that is not of such a boat.
    """
    prior = particulars.prior
    if prior is None or not takes(structure, particulars):
        return population
    names = [n for n in prior.parameters if n in structure.parameters and n not in ENVIRONMENT]
    at = np.array([structure.parameters.index(name) for name in names], dtype=np.int64)
    own = np.array([prior.parameters.index(name) for name in names], dtype=np.int64)
    mean, covariance = population[0].copy(), population[1].copy()
    bound = population[1][np.ix_(at, at)]
    mean[at] = np.array(prior.mean)[own]
    far = np.abs(mean[at] - population[0][at]) > MEAN_DEVIATION_MAX_SD * np.sqrt(np.diag(bound))
    if far.any():
        name = names[int(np.argmax(far))]
        raise PriorError(
            f"the prior of {prior.boat!r} has {name} = {prior.mean[own[int(np.argmax(far))]]:g}, "
            f"over {MEAN_DEVIATION_MAX_SD:g} standard deviations from boats like this: {_REMEDY}"
        )
    covariance[at], covariance[:, at] = 0.0, 0.0
    covariance[np.ix_(at, at)] = limited(np.array(prior.covariance)[np.ix_(own, own)], bound)
    return mean, covariance
