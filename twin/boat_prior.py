"""A boat's own prior: what earlier runs of the same boat say of its parameters.

The runs are combined as random effects. Let z_k and C_k be mean and covariance of run k, in units
of the population's prior. The boat differs from run to run by a covariance T, of load and fouling:

    T = B + (10 % of each value)^2,
    B = covariance of the z_k, and as if of two runs more, a tenth of the population's,
    mean = (sum (C_k + T)^-1)^-1 sum (C_k + T)^-1 z_k,
    covariance = mean of the C_k + (1 + 1/K) B + (10 % of each value)^2.

No direction is left wider than in the population. Parameters of wind and sea are left out: they
are not the boat's.

Source: DerSimonian and Laird 1986, Meta-analysis in clinical trials, for several parameters.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usv_kernel.errors import UsvTwinError
from usv_kernel.files import read_toml

__all__ = [
    "LOAD_SD_SHARE",
    "BoatPrior",
    "BoatPriorError",
    "combine",
    "limited",
]

Array = NDArray[np.float64]

FORMAT = "usv-twin prior 1"

LOAD_SD_SHARE = 0.1
"""Part of each value by which load and fouling may change it, as a standard deviation."""

UNCORRELATED_PART = 0.3
"""Share of each variance between runs that no other parameter explains: runs are few."""

PRIOR_RUNS = 2.0
PRIOR_VARIANCE_SHARE = 0.1
"""Weight of the prior covariance between runs, in runs, and its share of the population's."""

SAME_BOAT_TOLERANCE = {"length": 0.05, "beam": 0.1, "mass": 0.3}
"""Relative differences within which sizes are those of one boat; the mass changes with the load."""

SAME_THRUST_TOLERANCE = 0.01
"""Relative difference within which speeds per shaft speed are the same."""

SIZE_MIN = 1e-6
SIZE_MAX = 1e6
"""Bounds of lengths (m), speeds (m/s), shaft speeds (rev/s) and other sizes of boats."""

_SIZES = ("length", "beam", "mass", "speed", "shaft_speed")

VARIANCE_MIN = 1e-8
"""Smallest variance in units of the population's: below it is rounding."""


class BoatPriorError(UsvTwinError):
    """A boat's prior that cannot be used; the message names the file or value and the remedy."""


@dataclass(frozen=True, kw_only=True)
class BoatPrior:
    """Mean and covariance of a boat's parameters, and the boat that they were made for.

    Parameters
    ----------
    boat : str
        Its name, for messages.
    model : str
        Model structure, one of ``twin.model.structure.MODELS``.
    steering : str
        As in the particulars.
    length, beam, mass, speed, shaft_speed : float
        As in the particulars: m, m, kg, m/s, rev/s.
    runs : int
        Number of runs that it was made from.
    parameters : tuple of str
        Names of the p parameters.
    mean, covariance : tuple
        Of the parameters, in SI units: p numbers, and p rows of p numbers.
    """

    boat: str
    model: str
    steering: str
    length: float
    beam: float
    mass: float
    speed: float
    shaft_speed: float
    runs: int
    parameters: tuple[str, ...]
    mean: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        for name in ("boat", "model", "steering"):
            if not isinstance(getattr(self, name), str):
                raise BoatPriorError(f"{name} = {getattr(self, name)!r} must be a text")
        for name in _SIZES:
            value = getattr(self, name)
            if type(value) not in (int, float) or not SIZE_MIN <= value <= SIZE_MAX:
                raise BoatPriorError(
                    f"{name} = {value!r:.20} must be a number from {SIZE_MIN:g} to {SIZE_MAX:g}"
                )
        if type(self.runs) is not int or not 0 < self.runs <= SIZE_MAX:
            raise BoatPriorError(f"runs = {self.runs!r:.20} must be a whole number above 0")
        names = self.parameters
        texts = isinstance(names, (list, tuple)) and all(isinstance(n, str) for n in names)
        if not texts or not names or len(set(names)) < len(names):
            raise BoatPriorError("parameters must be names, each once")
        try:
            mean = np.asarray(self.mean, dtype=np.float64)
            cov = np.asarray(self.covariance, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            raise BoatPriorError("mean and covariance must be numbers") from None
        p = len(names)
        if mean.shape != (p,) or cov.shape != (p, p):
            raise BoatPriorError(
                f"mean and covariance have shapes {mean.shape} and {cov.shape}; {p} parameters "
                f"need ({p},) and ({p}, {p})"
            )
        if not (np.isfinite(mean).all() and np.isfinite(cov).all()):
            raise BoatPriorError("mean and covariance must be finite numbers")
        size = np.sqrt(np.maximum(np.diag(cov), 0.0))
        if not (size > 0.0).all() or (np.abs(cov - cov.T) > 1e-6 * np.outer(size, size)).any():
            raise BoatPriorError("covariance must be symmetric, with variances above 0")
        if np.linalg.eigvalsh(cov / np.outer(size, size))[0] < -1e-9 * p:
            raise BoatPriorError("covariance must have no negative eigenvalue")
        object.__setattr__(self, "parameters", tuple(names))
        object.__setattr__(self, "mean", tuple(mean.tolist()))
        object.__setattr__(self, "covariance", tuple(tuple(row) for row in cov.tolist()))
        for name in _SIZES:
            object.__setattr__(self, name, float(getattr(self, name)))

    @classmethod
    def from_table(cls, table: Any) -> BoatPrior:
        """Return the prior in a plain table of values by field name."""
        if not isinstance(table, dict):
            raise BoatPriorError("a prior is a file or a table of keys and values")
        wanted = {item.name for item in dataclasses.fields(cls)}
        if set(table) != wanted:
            odd = sorted(set(table) ^ wanted)
            raise BoatPriorError(f"key(s) missing or unknown: {', '.join(odd)}")
        return cls(**table)

    @classmethod
    def load(cls, path: str | Path) -> BoatPrior:
        """Read a file that :meth:`save` wrote.

        Parameters
        ----------
        path : str or Path
            For instance ``boat.prior``.

        Raises
        ------
        BoatPriorError
            Names the file, the key and the remedy.
        """
        remedy = "make it with: usv-twin identify RUN... --save-prior boat.prior"
        table = read_toml(path, BoatPriorError)
        if table.pop("format", None) != FORMAT:
            raise BoatPriorError(f"prior {path}: has no format = {FORMAT!r}; {remedy}")
        try:
            return cls.from_table(table)
        except BoatPriorError as error:
            raise BoatPriorError(f"prior {path}: {error}; {remedy}") from None

    def to_toml(self) -> str:
        """Return the lines of a table with these fields."""
        lines = []
        for item in dataclasses.fields(self):
            value = getattr(self, item.name)
            if item.name == "covariance":
                rows = ",\n".join(f"  {json.dumps(row)}" for row in value)
                lines.append(f"covariance = [\n{rows},\n]")
            else:
                lines.append(f"{item.name} = {json.dumps(value, ensure_ascii=False)}")
        return "\n".join(lines) + "\n"

    def file_text(self) -> str:
        """Return the text of a file that :meth:`load` reads."""
        head = "# What earlier runs say of a boat's parameters: mean and covariance, SI units."
        return f"{head}\nformat = {json.dumps(FORMAT)}\n{self.to_toml()}"

    def check_boat(self, boat: Any) -> None:
        """Refuse particulars that the prior was not made for; BoatPriorError says what differs."""
        for name in ("steering", *SAME_BOAT_TOLERANCE):
            made_for, found = getattr(self, name), getattr(boat, name)
            if made_for != found and (
                name == "steering" or abs(found / made_for - 1.0) > SAME_BOAT_TOLERANCE[name]
            ):
                raise BoatPriorError(
                    f"the prior of {self.boat!r} is of a boat with {name} = {made_for}, not "
                    f"{found}: correct {name}, or leave the prior out"
                )
        unit = boat.speed / boat.shaft_speed * self.shaft_speed / self.speed
        if abs(unit - 1.0) > SAME_THRUST_TOLERANCE:
            raise BoatPriorError(
                f"the prior of {self.boat!r} was made with speed = {self.speed:g} and shaft_speed "
                f"= {self.shaft_speed:g}, whose ratio is the unit of its thrust: keep the ratio, "
                "or make the prior again"
            )


def limited(cov: Array, bound: Array) -> Array:
    """Return a covariance (p, p) that is in no direction wider than another one."""
    root: Array = np.linalg.cholesky(np.asarray(bound, dtype=np.float64))
    values, vectors = np.linalg.eigh(_whitened(root, cov))
    turned = root @ vectors
    out: Array = (turned * np.clip(values, VARIANCE_MIN, 1.0)) @ turned.T
    return 0.5 * (out + out.T)


def _whitened(root: Array, cov: Array) -> Array:
    """Return a covariance in units of the one whose Cholesky factor is given."""
    half: Array = np.linalg.solve(root, np.linalg.solve(root, cov).T)
    return np.asarray(0.5 * (half + half.T), dtype=np.float64)


def combine(
    population: tuple[Array, Array], runs: Sequence[tuple[Array, Array]]
) -> tuple[Array, Array]:
    """Return mean (p,) and covariance (p, p) of a boat's parameters in its next run.

    See the head of this module.

    Parameters
    ----------
    population : tuple of ndarray
        Mean (p,) and covariance (p, p) that each run began with.
    runs : sequence of tuple of ndarray
        The same at the end of each run; one or more.
    """
    start, bound = population
    root: Array = np.linalg.cholesky(np.asarray(bound, dtype=np.float64))
    z = np.array([np.linalg.solve(root, run[0] - start) for run in runs])
    C = np.array([_whitened(root, limited(run[1], bound)) for run in runs])
    B = PRIOR_RUNS * PRIOR_VARIANCE_SHARE * np.eye(len(bound))
    if len(runs) > 1:
        between = np.cov(z.T).reshape(B.shape)
        alone = UNCORRELATED_PART * np.diag(np.diag(between))
        B += (len(runs) - 1) * ((1.0 - UNCORRELATED_PART) * between + alone)
    B /= PRIOR_RUNS + len(runs) - 1
    typical = start + root @ z.mean(axis=0)
    D = _whitened(root, np.diag((LOAD_SD_SHARE * typical) ** 2))
    weights = np.linalg.inv(C + B + D)
    mean = np.linalg.solve(weights.sum(axis=0), np.einsum("kij,kj->i", weights, z))
    cov = C.mean(axis=0) + (1.0 + 1.0 / len(runs)) * B + D
    return start + root @ mean, limited(root @ cov @ root.T, bound)
