"""Prior of a boat's parameters, from a population of similar boats.

The files in ``twin/model/priors`` hold, for each model structure and kind of boat, the
dimensionless parameters that random boats were found to have
(:mod:`twin.training.prior_population`), one boat a row. One file serves boats of every size. For a
class of boats (:data:`twin.particulars.DESIGNS`) the boats vary around a model of the class, whose
coefficients have errors of 20 %, as those of any model have.

Source: docs/explanation/twin.md, The refit.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.model.structure import Structure
from twin.particulars import FAST, Particulars
from usv_kernel.errors import UsvTwinError

__all__ = [
    "KINDS",
    "Prior",
    "PriorError",
    "kind_of",
    "population_prior",
    "shipped_prior",
]

Array = NDArray[np.float64]

KINDS = ("drives", "rudder", "differential")
"""Kinds of boats: fast ones on steerable drives, ships with rudders, fixed pairs of thrusters."""

TANKER = "tanker"
"""Ships with rudders that are of full form: sampled around one that was measured. The drafts
of the others are made to hold their course, and few tankers do."""

UNCORRELATED_PART = 0.3
"""Share of each variance that no other parameter explains, at the least."""

SPREAD_MIN = 1e-3
"""A smaller spread, as a share of the structure's own, means that calm water shows nothing."""


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
                f"{path}: is no prior ({error}); make a new one with "
                "twin.training.prior_population.make_prior"
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
    return "drives" if particulars.froude > FAST else "rudder"


@cache
def shipped_prior(model: str, kind: str) -> Prior:
    """Return a prior that comes with the package, by structure and kind.

    A kind is one of :data:`KINDS`, :data:`TANKER`, or a class of :data:`twin.particulars.DESIGNS`.
    """
    return Prior.load(Path(str(resources.files("twin.model") / "priors" / f"{model}_{kind}.csv")))


def population_prior(structure: Structure, particulars: Particulars) -> tuple[Array, Array]:
    """Return mean (p,) and covariance (p, p) of a boat's parameters before any data, in SI units.

    They are those of its class, if it is given, else those of its kind. Boats with a fixed pair of
    thrusters get the structure's own prior: the population of drafted hulls has no catamarans, and
    was the worse prior for Otter and for a recorded boat.
    """
    kind = particulars.design or kind_of(particulars)
    if kind == "differential":
        return structure.mean.copy(), np.diag(structure.sd**2)
    return shipped_prior(structure.name, kind).of(structure)
