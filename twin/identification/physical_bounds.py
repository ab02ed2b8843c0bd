"""What holds for the parameters of any boat: drag brakes, turning is damped, thrust pushes ahead.

Each bound is linear in the parameters. An estimate that breaks one, as noise and a rough model may
make it, is replaced by the moments of its normal distribution cut off at the bound.

Source: Simon and Simon 2010, doi:10.1080/00207720903042970, truncation of the density.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.model.structure import N_STATES, N_TERMS, Structure, state_terms, thrust_terms
from usv_kernel.arrays import alloca_f64
from usv_kernel.jit import inlined, kernel

__all__ = ["BOUNDS", "keep_physical", "physical_bounds"]

Array = NDArray[np.float64]

SPEEDS = (0.5, 1.0, 1.5)
"""Speeds at which drag brakes, in nominal ones."""

BOUNDS = len(SPEEDS) + 3
"""Surge at each of the speeds, sway, yaw, and thrust."""

SMALL = 1e-4
"""Difference of velocity for a slope, in nominal ones."""

DEVIATION_MIN_SD = -6.0
"""Largest deviation beyond a bound, in standard deviations: a larger one is clipped to it."""


@kernel
def _terms_at(u, v, r, n, hull, terms):
    """Write all terms of a boat that heads north, with its shafts at n and drives amidships."""
    thrust_terms(n, n, 1.0, 0.0, 1.0, 0.0, terms)
    # a wind that is not known
    state_terms(u, v, r, 1.0, 0.0, (0.0, 0.0), hull, terms)


def physical_bounds(
    structure: Structure, mean: Array, speed: float, shaft_speed: float, share: float
) -> Array:
    """Return rows (:data:`BOUNDS`, p + 1): p factors, and the most that their sum may be.

    The sum is that of factors times parameters.

    Parameters
    ----------
    structure : Structure
        With p parameters.
    mean : ndarray, shape (p,)
        Prior of the parameters, in SI units.
    speed, shaft_speed : float
        Nominal, m/s and rev/s.
    share : float
        Least damping and thrust, as a share of the prior's.
    """
    which, hull = structure.terms.which, structure.terms.hull
    nominal = structure.n_unit * shaft_speed

    def factors(u: float, v: float, r: float, n: float, equation: int) -> Any:
        terms = np.zeros(N_TERMS)
        _terms_at(u * speed, v * speed, r * speed / hull[2], n * nominal, hull, terms)
        return terms[which[equation]]

    rows = [factors(u + SMALL, 0, 0, u, 0) - factors(u - SMALL, 0, 0, u, 0) for u in SPEEDS]
    rows.append(factors(1.0, SMALL, 0.0, 1.0, 1) - factors(1.0, -SMALL, 0.0, 1.0, 1))
    rows.append(factors(1.0, 0.0, SMALL, 1.0, 2) - factors(1.0, 0.0, -SMALL, 1.0, 2))
    rows.append(factors(0, 0, 0, 0, 0) - factors(0, 0, 0, 1.0, 0))
    bounds = np.array([[*row, share * (row @ mean)] for row in rows])
    # of a prior that itself breaks a bound nothing is asked
    bounds[bounds[:, -1] >= 0.0] = 0.0
    return bounds


@inlined
def _is_physical(x, bounds):
    """Return whether a joint vector lies within all bounds."""
    p, sums, within = x.shape[0] - N_STATES, alloca_f64(BOUNDS), True
    for j in range(BOUNDS):
        sums[j] = 0.0
    for k in range(p):
        for j in range(BOUNDS):  # side by side, as each sum waits for its last term
            sums[j] += bounds[j, k] * x[N_STATES + k]
    for j in range(BOUNDS):
        within = within and sums[j] <= bounds[j, p]
    return within


@inlined
def keep_physical(x, P, bounds, gain):
    """Truncate a joint estimate at the bounds of its parameters.

    ``gain`` (6 + p,) is scratch.
    """
    if _is_physical(x, bounds):
        return
    p = x.shape[0] - N_STATES
    for j in range(bounds.shape[0]):
        factors, value = bounds[j], 0.0
        for k in range(p):
            value += factors[k] * x[N_STATES + k]
        if value <= factors[p]:
            continue
        variance = 0.0
        for i in range(x.shape[0]):
            row = P[i]
            gain[i] = 0.0
            for k in range(p):
                gain[i] += row[N_STATES + k] * factors[k]
            if i >= N_STATES:
                variance += factors[i - N_STATES] * gain[i]
        if not variance > 0.0:
            continue
        sd = math.sqrt(variance)
        a = max((factors[p] - value) / sd, DEVIATION_MIN_SD)
        hazard = math.exp(-0.5 * a * a) / (
            math.sqrt(0.5 * math.pi) * math.erfc(-a / math.sqrt(2.0))
        )
        # a part of the distribution lies within the bound; at most its edge is gone to
        mean = min(value - sd * hazard, factors[p])
        left = min(max(1.0 - a * hazard - hazard * hazard, 0.0), 1.0)
        for i in range(x.shape[0]):
            x[i] += gain[i] * (mean - value) / variance
            row, share = P[i], gain[i] * (left - 1.0) / variance
            for k in range(x.shape[0]):
                row[k] += share * gain[k]
