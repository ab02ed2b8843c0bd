"""What the data seen say of the parameters: how many, which, and which only together.

A sub-model is one acceleration, linear in its parameters: a = phi' xi + noise. What a run says
of them is in the Gram matrix of the regressors seen, G, the integral of phi phi' over time
(:func:`accumulate`), and in how the standard deviations of xi shrank. Each regressor is
counted in units of 1 / (prior standard deviation of its parameter), and G weighed by the noise
of the acceleration:

    A = D G D / q,   D = diag(prior sd),  q = variance that the velocity gains per second.

So A is the information of the data in units of that of the prior: an eigenvalue of 1 is a
direction of which the data say as much as the prior did.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usv_kernel.jit import kernel

__all__ = [
    "COLLINEAR",
    "INFORMED",
    "Finding",
    "Identifiability",
    "SubModel",
    "accumulate",
    "assess",
]

Array = NDArray[np.float64]

COLLINEAR = 0.999
"""Size of the cosine between two regressors above which their parameters are merged."""

INFORMED = math.sqrt(0.5)
"""Standard deviation over that of the prior at which data and prior say equally much."""

_SAME = 0.005
"""Part of 1 within which a weight of a merged parameter is not written."""


@kernel
def accumulate(gram, terms, which, seconds):
    """Add the products of regressors, times seconds, to the Gram matrix (k, k) of what was seen.

    It is the integral of phi phi' over time; its lower triangle is added to. ``which`` (k,) says
    which of the terms (m,) of the moment are the regressors phi.
    """
    for i in range(which.shape[0]):
        weight = seconds * terms[which[i]]
        for k in range(i + 1):
            gram[i, k] += weight * terms[which[k]]


@dataclass(frozen=True)
class SubModel:
    """What the data say of one sub-model as a whole."""

    name: str  # surge, sway or yaw
    parameters: tuple[str, ...]  # names of its parameters
    # number of directions that the data tell and not the prior: sum of l / (1 + l) over the
    # eigenvalues l of A (see the head of this file), from 0 to the number of parameters
    effective_rank: float
    # largest over smallest eigenvalue of A; NaN without data. It ends at 1/eps = 4.5e15, where the
    # smallest is rounding: not all parameters can be separated
    condition_number: float


@dataclass(frozen=True)
class Finding:
    """What the data say of a parameter, or of a weighted sum of collinear ones."""

    name: str  # name of the parameter, or the sum, such as "T_uL + T_uR"
    # parameters of the sum, and by how much each counts; the weight of the first is 1
    members: tuple[str, ...]
    weights: tuple[float, ...]
    # standard deviation before and after the data, in the unit of the first
    prior_sd: float
    sd: float
    # whether the data informed it: its standard deviation fell to INFORMED of that of the prior or
    # below, and its own regressor was seen strongly enough for that (its entry in the diagonal of A
    # is 1 or more). Never true for one parameter of a sum
    informed: bool
    merged_into: str = ""  # name of the sum of which alone the data speak; empty for others

    @property
    def ratio(self) -> float:
        """Standard deviation over that of the prior; NaN for what was known beforehand."""
        return self.sd / self.prior_sd if self.prior_sd > 0.0 else math.nan


@dataclass(frozen=True)
class Identifiability:
    """What the data seen say of the parameters of a model."""

    seconds: float  # time seen, s
    submodels: tuple[SubModel, ...]  # surge, sway, yaw
    parameters: tuple[Finding, ...]  # each parameter by itself
    # what takes the place of parameters whose regressors were collinear on the data seen: nothing
    # but the sum is identified
    sums: tuple[Finding, ...]

    @property
    def informed(self) -> tuple[str, ...]:
        """Names of the parameters and sums that the data informed."""
        return tuple(item.name for item in (*self.parameters, *self.sums) if item.informed)

    def to_json(self) -> dict[str, Any]:
        """Return all of it as plain data; None stands for NaN."""
        return {
            "seconds": self.seconds,
            "submodels": {item.name: _plain(item) for item in self.submodels},
            "parameters": {item.name: _plain(item) for item in self.parameters},
            "sums": {item.name: _plain(item) for item in self.sums},
            "informed": list(self.informed),
        }

    def __str__(self) -> str:
        """Return a table in plain text."""
        lines = [f"{'sub-model':<10}{'parameters':>12}{'effective rank':>16}{'condition':>12}"]
        lines += [
            f"{m.name:<10}{len(m.parameters):>12}{m.effective_rank:>16.1f}"
            f"{m.condition_number:>12.1e}"
            for m in self.submodels
        ]
        width = max((len(item.name) for item in (*self.parameters, *self.sums)), default=0) + 2
        lines += ["", f"{'parameter':<{width}}{'prior sd':>10}{'sd':>10}{'ratio':>7}  data"]
        lines += [
            f"{item.name:<{width}}{item.prior_sd:>10.3g}{item.sd:>10.3g}{item.ratio:>7.2f}  "
            + (f"only in {item.merged_into}" if item.merged_into else _says(item.informed))
            for item in (*self.parameters, *self.sums)
        ]
        return "\n".join(lines)


def assess(
    names: Sequence[str],
    submodels: Sequence[tuple[str, ArrayLike]],
    gram_matrices: Sequence[ArrayLike],
    q: ArrayLike,
    prior: ArrayLike,
    posterior: ArrayLike,
    seconds: float,
) -> Identifiability:
    """Return what the data seen, for so many seconds, say of the parameters.

    Parameters are merged where the cosine between their regressors over all the data exceeds
    :data:`COLLINEAR` in size. The regressors of a parameter are those of all sub-models that it
    stands in, each weighed by 1/q: what one sub-model cannot tell apart another one may. The weight
    of a merged parameter is the ratio of its regressor to that of the first.

    ``submodels`` have a name and the numbers (k,) of their parameters; a parameter may stand in
    several. ``gram_matrices`` are from :func:`accumulate`, one each; ``q`` is the noise of the
    acceleration of each, the variance that the velocity gains per second. ``prior`` and
    ``posterior`` (p, p) are the covariances before and after the data.
    """
    before, after = np.asarray(prior, dtype=np.float64), np.asarray(posterior, dtype=np.float64)
    prior_sd = np.sqrt(np.diag(before))
    total = np.zeros_like(before)
    found = []
    for (name, block), lower, noise in zip(
        submodels, gram_matrices, np.asarray(q, dtype=np.float64), strict=True
    ):
        columns = np.asarray(block)
        triangle = np.tril(lower)
        gram = (triangle + np.tril(triangle, -1).T) / noise
        total[np.ix_(columns, columns)] += gram
        scale = prior_sd[columns]
        rank, condition = _spectrum(gram * scale * scale[:, None])
        found.append(SubModel(name, tuple(names[i] for i in columns), rank, condition))

    def finding(weights: Array, members: Sequence[int], label: str, merged: str = "") -> Finding:
        variance = float(weights @ before @ weights)
        sd = math.sqrt(max(float(weights @ after @ weights), 0.0))
        gained = total[members[0], members[0]] * variance
        return Finding(
            name=label,
            members=tuple(names[i] for i in members),
            weights=tuple(float(weights[i]) for i in members),
            prior_sd=math.sqrt(variance),
            sd=sd,
            informed=bool(not merged and gained >= 1.0 and sd <= INFORMED * math.sqrt(variance)),
            merged_into=merged,
        )

    sums, place = [], [""] * len(names)
    for members in _groups(total):
        weights = np.zeros(len(names))
        first = members[0]
        size = np.sqrt(np.diag(total)[members] / total[first, first])
        weights[members] = np.where(total[first, members] < 0.0, -size, size)
        label = _label([names[i] for i in members], weights[members])
        sums.append(finding(weights, members, label))
        for i in members:
            place[i] = label
    alone = np.eye(len(names))
    single = [finding(alone[i], [i], names[i], place[i]) for i in range(len(names))]
    return Identifiability(seconds, tuple(found), tuple(single), tuple(sums))


def _spectrum(A: Array) -> tuple[float, float]:
    """Return effective rank and condition number of the information A."""
    values = np.maximum(np.linalg.eigvalsh(A), 0.0)
    top = float(values[-1])
    floor = max(float(values[0]), np.finfo(np.float64).eps * top)
    return float((values / (1.0 + values)).sum()), top / floor if top > 0.0 else math.nan


def _groups(total: Array) -> list[list[int]]:
    """Return the sets of two and more parameters whose regressors are collinear."""
    size = np.sqrt(np.diag(total))
    bound = COLLINEAR * size * size[:, None]
    similar = (np.abs(total) > bound) & (bound > 0.0)
    groups, left = [], set(range(len(total)))
    while left:
        group, new = set(), {min(left)}
        while new:
            group |= new
            new = {int(k) for i in new for k in np.flatnonzero(similar[i])} - group
        left -= group
        if len(group) > 1:
            groups.append(sorted(group))
    return groups


def _label(names: Sequence[str], weights: Array) -> str:
    """Return the name of a weighted sum; the weight of the first is 1."""
    text = names[0]
    for name, weight in zip(names[1:], weights[1:], strict=True):
        size = abs(weight)
        number = "" if abs(size - 1.0) < _SAME else f"{size:.3g} "
        text += f" {'-' if weight < 0.0 else '+'} {number}{name}"
    return text


def _says(informed: bool) -> str:
    return "informed" if informed else "prior"


def _plain(item: SubModel | Finding) -> dict[str, Any]:
    """Return a record as plain data, without its name."""
    table = asdict(item)
    if isinstance(item, Finding):
        table["ratio"] = item.ratio
    del table["name"]
    return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in table.items()}
