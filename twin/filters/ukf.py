"""The unscented Kalman filter for a state plus many constant parameters; it has no ship in it.

The filter's vector is x = (s, xi): ``n_s`` states that move and are measured, then ``n_xi``
parameters that are constant but for a random walk. The caller's model must be affine in xi,

    f(s, xi) = f(s, 0) + slope(s) xi,

and the measurement is z = s + noise, each entry present or not. Then, of the 1 + 2 (n_s + n_xi)
sigma points, those that move xi alone can be summed in closed form. Only 1 + 2 n_s are sent through
the model. The result is that of the full filter for any alpha, beta and kappa.

A step is three calls, with the model in the middle:

1. :func:`sigma_points` writes the points;
2. the caller replaces the s part of each point by the model's answer, and writes the slope
   at the centre point;
3. :func:`time_update` forms the predicted mean and covariance;

and :func:`measurement_update` when something was measured. All share one :class:`UKFWorkspace`.

P is kept exactly symmetric, and neither x nor P ever becomes NaN or infinite:

- Where rounding has left P without a Cholesky factor, its correlations are dropped;
- where a prediction overflows, x stays, and P loses its correlations and grows by Q;
- an entry of z that is not finite counts as missing, and none reduces a variance to less than
  1e-10 of itself.

The first two are counted in what the functions return. They tell of a filter that followed an
absurd measurement for want of a gate, or that predicted for too long without any.

Source: Qu et al. 2025, Eq (28)-(34) with the corrections of Wan and van der Merwe (2000);
docs/explanation/twin.md, Joint filter; docs/explanation/performance.md, The structured UKF.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.filters.linalg import add_product
from usv_kernel.errors import UsvTwinError
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import wrap
from usv_kernel.simd import Factors, Rows, Strip, accumulate, combine, inner, padded

__all__ = [
    "UKFWorkspace",
    "measurement_update",
    "scaled_weights",
    "sigma_points",
    "time_update",
    "workspace",
]

Array = NDArray[np.float64]

SPREAD, MEAN_0, COVARIANCE_0, OTHERS = 0, 1, 2, 3
"""Entries of the weights."""

_PIVOT_MIN = 1e-14
"""Part of a variance below which a difference is a rounding error."""

_NOISE_MIN = 1e-10
"""The least measurement noise, as a part of the variance that it meets."""

_OVERFLOW = 1e12
"""No state in SI units is as large as this, nor its variance as its square."""


def scaled_weights(n: int, alpha: float = 1.0, beta: float = 2.0, kappa: float = 0.0) -> Array:
    """Return the weights (4,) of the scaled unscented transform for n states and parameters.

    The first is the square of the points' distance in standard deviations, alpha^2 (n + kappa).
    Then come the centre's weights in mean and covariance, and the weight of each other point. A
    small alpha loses digits: 1e-3 with n = 31 gives the centre a weight of -1e6.

    Source: docs/explanation/twin.md, Joint filter; Wan and van der Merwe 2000.
    """
    spread = alpha**2 * (n + kappa)
    if not spread > 0.0:
        raise UsvTwinError(f"alpha^2 (n + kappa) = {spread} must be above 0")
    mean_0 = 1.0 - n / spread
    return np.array([spread, mean_0, mean_0 + 1.0 - alpha**2 + beta, 0.5 / spread])


class UKFWorkspace(NamedTuple):
    """Scratch of the filter; the first n = n_s + n_xi columns of each count.

    Rows are padded with zeros to whole groups of lanes, so that one sum reads in the vectors that
    the last one wrote.
    """

    points: Any  # (1 + 2 n_s, width) sigma points: the centre, those up, those down
    root: Any  # (1 + 2 n_s, width) first rows of the upper Cholesky factor of P
    slope: Any  # (1 + 2 n_s, width) derivative of the model's answer by x: within ``limits``
    scratch: Any  # (1 + 2 n_s, width) for what is in between


def workspace(n_s: int, n_xi: int) -> UKFWorkspace:
    """Return a workspace of zeros for n_s states and n_xi parameters."""
    return UKFWorkspace(*np.zeros((4, 1 + 2 * n_s, padded(2 * n_s + n_xi + 1))))


@inlined
def _eliminate(rows, factors, j):
    """Write factors[0, j] of row j and factors[0, i] of the rows i before it to row j."""
    width = rows.shape[1]
    combine(
        Strip(rows, j * width, width),
        Factors(factors, j, -1, 1.0),
        Rows(rows, j * width, -width, j + 1),
    )


@kernel
def _factorise(P, root, factors, n_s):
    """Write the first n_s rows of P's upper Cholesky factor; return whether it exists."""
    n = P.shape[0]
    for j in range(n_s):
        row, origin = root[j, :n], P[j]
        for k in range(n):
            row[k] = origin[k]
    for j in range(n_s):
        pivot = P[j, j]
        for i in range(j):
            pivot -= root[i, j] * root[i, j]
        if not (pivot > _PIVOT_MIN * P[j, j] and pivot < _OVERFLOW**2):
            return False
        scale = 1.0 / math.sqrt(pivot)
        for i in range(j):
            factors[0, i] = -scale * root[i, j]
        factors[0, j] = scale
        _eliminate(root, factors, j)
        for i in range(j):
            root[j, i] = 0.0
    own, rest = P[n_s:, n_s:], factors[0, n_s:n]
    for k in range(n - n_s):
        rest[k] = own[k, k]
    for j in range(n_s):
        row = root[j, n_s:n]
        for k in range(n - n_s):
            rest[k] -= row[k] * row[k]
    left = True
    for k in range(n - n_s):
        left = left and rest[k] > _PIVOT_MIN * own[k, k]
    return left


@kernel
def _decorrelate(P):
    """Set P to its variances alone, where these are above 0."""
    n = P.shape[0]
    for i in range(n):
        for k in range(n):
            if k != i:
                P[i, k] = 0.0
        if not P[i, i] > _PIVOT_MIN:  # NaN as well
            P[i, i] = _PIVOT_MIN
        P[i, i] = min(P[i, i], _OVERFLOW)


@kernel
def sigma_points(x, P, weights, work):
    """Write the sigma points that move a state into the points and root of the workspace.

    P is changed only where it has no Cholesky factor, see the head of this file. Returned is the
    number of such repairs, 0 as a rule.

    Source: Eq (29) with n + lambda in place of n + k; docs/explanation/twin.md, Joint filter.
    """
    n = x.shape[0]
    points, root = work.points, work.root
    n_s = (points.shape[0] - 1) // 2
    repairs = 0
    if not _factorise(P, root, work.scratch, n_s):
        _decorrelate(P)
        _factorise(P, root, work.scratch, n_s)
        repairs = 1
    distance = math.sqrt(weights[SPREAD])
    for k in range(n):
        points[0, k] = x[k]
        root[n_s, k] = x[k]
    # each is a row of the root times the points' distance, plus the mean, which follows the root
    sides, width = work.scratch, points.shape[1]
    sides[0, 0], sides[0, 1], sides[0, 2] = distance, 1.0, -distance
    for j in range(n_s):
        row, apart = j * width, (n_s - j) * width
        rows = Rows(root, row, apart, 2)
        combine(Strip(points, width + row, n), Factors(sides, 0, 1, 1.0), rows)
        down = width * (1 + n_s) + row
        combine(Strip(points, down, n), Factors(sides, 2, -1, 1.0), rows)
    return repairs


@kernel
def _hold(P, Q_s, q_xi):
    """Hold the states, uncorrelated, under process noise; return 1, to be counted."""
    n_s = Q_s.shape[0]
    _decorrelate(P)
    for i in range(n_s):
        for k in range(n_s):
            P[i, k] += Q_s[i, k]
    for k in range(q_xi.shape[0]):
        P[n_s + k, n_s + k] += q_xi[k]
    return 1


@kernel
def time_update(x, P, Q_s, q_xi, limits, weights, work):
    """Turn the propagated sigma points into the predicted mean and covariance, in place.

    ``P`` and ``work`` are as :func:`sigma_points` left them, but with the model's answer in the
    first n_s columns of the points, and with its slope. Both are overwritten. ``Q_s`` (n_s, n_s) is
    the process noise of this step, ``q_xi`` (n_xi,) what each parameter's random walk adds.
    ``limits`` (n_s, 2) are first and last + 1 of the columns in which a row of the slope may differ
    from 0, counted in x. They are (n_s, n) for a full row, (n_s, n_s) for an empty one. Returned is
    1 if the prediction was dropped because it overflowed, else 0.

    Source: Eq (30) with the noise added once; docs/explanation/performance.md, The structured UKF.
    """
    n = x.shape[0]
    points, root, slope = work.points, work.root, work.slope
    n_s = (points.shape[0] - 1) // 2
    rows = work.scratch  # The first n_s become rows of P'_sx.
    width = rows.shape[1]
    common = n_s  # rows[common + j, i] is slope_l . G_j, what slope and root have in common.
    error = 2 * n_s  # rows[error] is the answer at the centre less the mean.

    # The mean. Each pair of answers becomes half its difference and its middle less the mean. A
    # pair counts twice the weight of a point; its root goes into the numbers.
    scale = math.sqrt(2.0 * weights[OTHERS])
    for i in range(n_s):
        rows[error, i] = 0.0
    for j in range(1, 1 + n_s):
        for i in range(n_s):
            up = points[j, i] - points[0, i]
            down = points[j + n_s, i] - points[0, i]
            points[j, i] = scale * 0.5 * (up - down)
            points[j + n_s, i] = 0.5 * (up + down)
            rows[error, i] -= weights[OTHERS] * (up + down)
    for j in range(1 + n_s, 1 + 2 * n_s):
        for i in range(n_s):
            points[j, i] = scale * (points[j, i] + rows[error, i])
    tame = True
    for i in range(n_s):
        points[0, i] -= rows[error, i]
        tame = tame and abs(points[0, i]) < _OVERFLOW

    # P'_sx = slope P_xx + (difference - slope G') G, which is the points' part and slope C
    # with C = P_xx - G'G. The factor of G takes the place of the root's own s columns.
    for j in range(n_s):
        for i in range(n_s):
            first = limits[i, 0]
            product = inner(slope, i * width + first, root, j * width + first, limits[i, 1] - first)
            rows[common + j, i] = product
            root[j, i] = points[1 + j, i] - product
    centre = weights[COVARIANCE_0] + 2.0 * (n - n_s) * weights[OTHERS]
    for i in range(n_s):
        first = limits[i, 0]
        combine(
            Strip(rows, i * width + n_s, n - n_s),
            Factors(slope, i * width + first, 1, 1.0),
            Rows(P, first * n + n_s, n, limits[i, 1] - first),
        )
        # P'_ss takes the slope's s columns until all of it is known to be finite.
        for q in range(i + 1):
            first = limits[q, 0]
            product = inner(rows, i * width + first, slope, q * width + first, limits[q, 1] - first)
            product += Q_s[i, q] + centre * rows[error, i] * rows[error, q]
            slope[i, q] = product
            slope[q, i] = product
    add_product(rows, root, root, (n_s, n_s, n), (0, n_s), 1.0)
    add_product(slope, points, points, (n_s, 0, n_s), (1, 1 + 2 * n_s), 1.0)
    add_product(slope, rows, rows, (n_s, 0, n_s), (common, common + n_s), -1.0)

    for i in range(n_s):
        tame = tame and slope[i, i] < _OVERFLOW**2
    if not tame:
        return _hold(P, Q_s, q_xi)
    for i in range(n_s):
        x[i] = points[0, i]
        for k in range(n_s):
            P[i, k] = slope[i, k]
        # Loops over views begin at 0, where no index can be taken for one from the end.
        across, row = P[i, n_s:], rows[i, n_s:n]
        for k in range(n - n_s):
            across[k] = row[k]
    across, below, own = P[:n_s, n_s:], P[n_s:, :n_s], P[n_s:, n_s:]
    for k in range(n - n_s):
        for i in range(n_s):
            below[k, i] = across[i, k]
        own[k, k] += q_xi[k]
    return 0


@kernel
def measurement_update(x, P, z, mask, R, angle, gate, work):
    """Correct mean and covariance, in place, by the measured states z (n_s,) that mask names.

    What is not finite counts as missing. ``angle`` is the index of a state in radians, whose
    innovation is wrapped; -1 if there is none. ``gate`` is the normalised innovation squared above
    which the measurement is refused as a whole. Returned is that number, chi-square of as many
    degrees as there were entries; above ``gate``, or infinite, x and P were left as they were.

    Source: Eq (31)-(33) for z = s + noise; docs/explanation/twin.md, Joint filter.
    """
    # Elimination turns the rows (P_s | S | y) of what was measured, with S = P_ss + R = L L', into
    # L^-1 P_s, L' and L^-1 y. Rows of what was not measured stay 0.
    n = x.shape[0]
    n_s = z.shape[0]
    rows, factors = work.scratch, work.points
    width = rows.shape[1]
    S = n
    y = n + n_s
    for i in range(n_s):
        row, origin = rows[i], P[i]
        for k in range(n):
            row[k] = origin[k]
        for k in range(n_s):
            row[S + k] = origin[k] + R[i, k]
        row[y] = z[i] - x[i]
        if i == angle:
            row[y] = wrap(row[y])
    nis = 0.0
    for i in range(n_s):
        row = rows[i]
        pivot = P[i, i] + max(R[i, i], _NOISE_MIN * P[i, i])
        floor = _PIVOT_MIN * pivot
        for j in range(i):
            pivot -= rows[j, S + i] * rows[j, S + i]
        # an entry may also repeat the others to the last digit
        if not (mask[i] and abs(z[i]) < _OVERFLOW and pivot > floor and pivot < _OVERFLOW**2):
            row[:] = 0.0
            continue
        scale = 1.0 / math.sqrt(pivot)
        for j in range(i):
            factors[0, j] = -scale * rows[j, S + i]
        factors[0, i] = scale
        _eliminate(rows, factors, i)
        nis += row[y] * row[y]
    if not (nis <= gate and nis < math.inf):
        return nis

    accumulate(Strip(x, 0, n), Factors(rows, y, width, 1.0), Rows(rows, 0, width, n_s))
    least = work.root[0]
    for i in range(n):
        least[i] = _PIVOT_MIN * P[i, i]
    add_product(P, rows, rows, (n, 0, n), (0, n_s), -1.0)
    for i in range(n):
        P[i, i] = max(P[i, i], least[i])
    return nis
