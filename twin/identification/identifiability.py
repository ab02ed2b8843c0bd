"""What the data seen say of the parameters: how many, which, and which only together.

A sub-model is one acceleration, linear in its parameters: a = phi' xi + noise. What a run says of
xi is in the Gram matrix G of the regressors seen, and in how the standard deviations of xi shrank.
G is the integral of phi phi' over time (:func:`accumulate`). Each regressor is counted in units of
1 / (prior standard deviation of its parameter), and G weighed by the noise of the acceleration:

    A = D G D / q,   D = diag(prior sd),  q = variance that the velocity gains per second.

So A is the information of the data in units of the prior's. An eigenvalue of 1 is a direction of
which the data say as much as the prior.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.model.structure import N_TERMS
from usv_kernel.arrays import alloca_f64
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
"""Posterior over prior standard deviation at which data and prior have equal information."""

NOT_SHOWN = 1e-10
"""Information of a direction, as a share of the largest, below which it is rounding."""

_PART = 0.1
"""Weight (prior standard deviations) below which a parameter is left out of a direction."""

_SAME = 0.005
"""Part of 1 within which a weight of a merged parameter is not written."""


@kernel
def accumulate(gram, terms, which, seconds):
    """Add the products of regressors, times seconds, to the Gram matrix (k, k) of what was seen.

    It is the integral of phi phi' over time; its lower triangle is added to. ``which`` (k,) says
    which of the terms (m,) of the moment are the regressors phi.
    """
    seen = alloca_f64(N_TERMS)  # in a row, for vector instructions
    for k in range(which.shape[0]):
        seen[k] = terms[which[k]]
    for i in range(which.shape[0]):
        weight, row = seconds * seen[i], gram[i, : i + 1]
        for k in range(row.shape[0]):
            row[k] += weight * seen[k]


@dataclass(frozen=True)
class SubModel:
    """Identifiability of one sub-model as a whole."""

    name: str  # surge, sway or yaw
    parameters: tuple[str, ...]  # names of its parameters
    # number of directions that the data determine, not the prior: sum of l / (1 + l) over the
    # eigenvalues l of A. It lies between 0 and the number of parameters
    effective_rank: float
    # largest over smallest eigenvalue of A; NaN without data. It ends at 1/eps = 4.5e15, where the
    # smallest is rounding: not all parameters can be separated
    condition_number: float
    # in words, the directions of which the data say nothing at all: parameters by themselves, then
    # combinations, in prior standard deviations
    not_shown: tuple[str, ...] = ()

    @property
    def condition(self) -> str:
        """The condition number for a reader: in words where it is rounding."""
        if math.isnan(self.condition_number):
            return "no data"
        return "not all shown" if self.not_shown else f"{self.condition_number:.1e}"


@dataclass(frozen=True)
class Finding:
    """Identifiability of a parameter, or of a weighted sum of collinear ones."""

    name: str  # name of the parameter, or the sum, such as "T_uL + T_uR"
    # parameters of the sum, and by how much each counts; the weight of the first is 1
    members: tuple[str, ...]
    weights: tuple[float, ...]
    # standard deviation before and after the data, in the unit of the first
    prior_sd: float
    sd: float
    # whether the data informed it. Its standard deviation fell to INFORMED of the prior's or below,
    # and its entry in the diagonal of A is 1 or more. Never true for one parameter of a sum
    informed: bool
    merged_into: str = ""  # name of the sum that alone is identified; empty for others

    @property
    def ratio(self) -> float:
        """Standard deviation over that of the prior; NaN for what was known beforehand."""
        return self.sd / self.prior_sd if self.prior_sd > 0.0 else math.nan


@dataclass(frozen=True)
class Identifiability:
    """Identifiability of the parameters of a model from the data."""

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
        lines = [f"{'sub-model':<10}{'parameters':>12}{'effective rank':>16}{'condition':>15}"]
        lines += [
            f"{m.name:<10}{len(m.parameters):>12}{m.effective_rank:>16.1f}{m.condition:>15}"
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
    """Return how well the data of a number of seconds determine the parameters.

    Parameters are merged where the cosine between their regressors over all the data exceeds
    :data:`COLLINEAR` in size. The regressors of a parameter are those of all sub-models that it
    stands in, each weighed by 1/q. What one sub-model cannot tell apart, another one may. The
    weight of a merged parameter is the ratio of its regressor to that of the first.

    ``submodels`` have a name and the numbers (k,) of their parameters; a parameter may stand in
    several. ``gram_matrices`` are from :func:`accumulate`, one each; ``q`` is the noise of the
    acceleration of each, the variance that the velocity gains per second. ``prior`` and
    ``posterior`` (p, p) are the covariances before and after the data.
    """
    before, after = np.asarray(prior, dtype=np.float64), np.asarray(posterior, dtype=np.float64)
    prior_sd = np.sqrt(np.diag(before))
    total = np.zeros_like(before)
    found = []
    earlier: set[int] = set()
    for (name, block), lower, noise in zip(
        submodels, gram_matrices, np.asarray(q, dtype=np.float64), strict=True
    ):
        columns = np.asarray(block)
        triangle = np.tril(lower)
        gram = (triangle + np.tril(triangle, -1).T) / noise
        total[np.ix_(columns, columns)] += gram
        # blocks are ranges: a parameter of an earlier equation may lie in one without a part in it
        part = (np.diag(gram) > 0.0) | np.array([i not in earlier for i in columns], dtype=np.bool_)
        earlier |= set(columns.tolist())
        columns, gram = columns[part], gram[np.ix_(part, part)]
        scale = prior_sd[columns]
        A = gram * scale * scale[:, None]
        rank, condition = _spectrum(A)
        parameters = tuple(names[i] for i in columns)
        found.append(SubModel(name, parameters, rank, condition, _not_shown(parameters, A)))

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


def _not_shown(names: Sequence[str], A: Array) -> tuple[str, ...]:
    """Return in words the directions of which the information A says nothing."""
    size = np.diag(A)
    if not size.max() > 0.0:
        return ()
    absent = size <= NOT_SHOWN * size.max()
    found = [", ".join(name for name, gone in zip(names, absent, strict=True) if gone)]
    found = [text for text in found if text]
    places = np.flatnonzero(~absent)
    values, vectors = np.linalg.eigh(A[np.ix_(places, places)])
    flat = values <= NOT_SHOWN * values[-1]
    # a basis with as few parameters in each direction as there can be
    directions = _reduced(vectors[:, flat].T)
    for row in directions:
        kept = np.flatnonzero(np.abs(row) > _PART)
        found.append(_label([names[places[k]] for k in kept], row[kept]))
    return tuple(found)


def _reduced(rows: Array) -> Array:
    """Return rows with the same span, each with an entry of 1 where the others have 0."""
    rows = rows.copy()
    for k in range(len(rows)):
        rest = np.abs(rows[k:])
        i, j = divmod(int(np.argmax(rest)), rest.shape[1])
        rows[[k, k + i]] = rows[[k + i, k]]
        rows[k] /= rows[k, j]
        others = np.arange(len(rows)) != k
        rows[others] -= rows[others, j][:, None] * rows[k]
    return rows


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
