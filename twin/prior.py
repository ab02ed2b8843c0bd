"""What is believed of a boat's parameters before any data, from a population of like boats.

The files in ``twin/priors`` hold, for each model structure and kind of boat, median, standard
deviation and correlation of the dimensionless parameters that random boats were found to have
(:mod:`twin.population`). One file serves boats of every size.

Source: twin.md, sections 10 B2 and 13.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.particulars import Particulars
from twin.structure import Structure

__all__ = ["KINDS", "Prior", "PriorError", "kind_of", "population_prior", "shipped_prior"]

Array = NDArray[np.float64]

KINDS = ("drives", "rudder", "differential")
"""Kinds of boats: fast ones on steerable drives, ships with rudders, fixed pairs of thrusters."""
FAST = 0.35
"""Froude number of the usual speed above which a boat is taken to have drives, not rudders."""
FLOOR = 1e-3
"""Share of each variance that no other parameter explains, at the least."""


class PriorError(ValueError):
    """A prior that cannot be used; the message names the file and the remedy."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Dimensionless parameters of a population.

    Parameters
    ----------
    model, kind : str
        Model structure, and kind of boats.
    parameters : tuple of str
        Names of the p parameters.
    median, sd : ndarray, shape (p,)
        In the natural units of the structure.
    correlation : ndarray, shape (p, p)
        Of the parameters.
    seed, boats, drawn : int
        Seed of the population, boats that it is made of, and boats that were drawn.
    """

    model: str
    kind: str
    parameters: tuple[str, ...]
    median: Array
    sd: Array
    correlation: Array
    seed: int
    boats: int
    drawn: int

    @classmethod
    def load(cls, path: Path) -> Prior:
        """Read a file that :meth:`to_json` wrote.

        Parameters
        ----------
        path : Path
            The file.

        Raises
        ------
        PriorError
            Names the file and the remedy.
        """
        try:
            table = json.loads(path.read_text(encoding="utf-8"))
            prior = cls(
                **{
                    **{key: table[key] for key in ("model", "kind", "seed", "boats", "drawn")},
                    "parameters": tuple(table["parameters"]),
                    "median": np.array([row[0] for row in table["parameters"].values()], float),
                    "sd": np.array([row[1] for row in table["parameters"].values()], float),
                    "correlation": np.array(table["correlation"], float),
                }
            )
            p = len(prior.parameters)
            if prior.correlation.shape != (p, p) or not np.all(prior.sd > 0.0):
                raise ValueError(f"{p} parameters need {p} sd above 0, and as many correlations")
            np.linalg.cholesky(prior.correlation)
        except (OSError, KeyError, TypeError, ValueError, IndexError) as error:
            raise PriorError(
                f"{path}: is no prior ({error}); make it anew with twin.population"
            ) from None
        return prior

    def to_json(self) -> str:
        """Return the text of a file, with six digits."""
        rows = [[round(float(value), 6) for value in row] for row in self.correlation]
        table: dict[str, Any] = {
            "about": "dimensionless parameters of a population: median and sd; see twin.population",
            **{key: getattr(self, key) for key in ("model", "kind", "seed", "boats", "drawn")},
            "parameters": {
                name: [float(f"{value:.6g}") for value in pair]
                for name, *pair in zip(self.parameters, self.median, self.sd, strict=True)
            },
        }
        head = json.dumps(table, indent=1).removesuffix("\n}")
        return f'{head},\n "correlation": [\n  ' + ",\n  ".join(map(json.dumps, rows)) + "\n ]\n}\n"

    def of(self, structure: Structure) -> tuple[Array, Array]:
        """Return mean and covariance of a boat's parameters in SI units.

        Parameters
        ----------
        structure : Structure
            The model of the boat. Its parameters that calm water does not show (wind, biases)
            keep the mean and the standard deviation that stand there.

        Returns
        -------
        mean : ndarray, shape (p,)
        covariance : ndarray, shape (p, p)
            Positive definite.
        """
        mean, covariance = structure.mean.copy(), np.diag(structure.sd**2)
        at = np.array([structure.parameters.index(name) for name in self.parameters])
        scales = structure.scales[at]
        mean[at] = self.median * scales
        sd = self.sd * scales
        covariance[np.ix_(at, at)] = self.correlation * np.outer(sd, sd)
        return mean, covariance


def kind_of(particulars: Particulars) -> str:
    """Return which of :data:`KINDS` a boat belongs to.

    Parameters
    ----------
    particulars : Particulars
        Length, speed and steering are used.
    """
    if particulars.steering == "differential":
        return "differential"
    froude = particulars.speed / math.sqrt(9.81 * particulars.length)
    return "drives" if froude > FAST else "rudder"


def shipped_prior(model: str, kind: str) -> Prior:
    """Return a prior that comes with the package.

    Parameters
    ----------
    model, kind : str
        Model structure, and one of :data:`KINDS`.
    """
    return Prior.load(Path(str(resources.files("twin") / "priors" / f"{model}_{kind}.json")))


def population_prior(structure: Structure, particulars: Particulars) -> tuple[Array, Array]:
    """Return mean and covariance of a boat's parameters before any data, in SI units.

    Parameters
    ----------
    structure : Structure
        The model of the boat.
    particulars : Particulars
        The boat.

    Returns
    -------
    mean : ndarray, shape (p,)
    covariance : ndarray, shape (p, p)
    """
    return shipped_prior(structure.name, kind_of(particulars)).of(structure)
