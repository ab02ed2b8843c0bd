"""The refit: the posterior of the parameters, and the row at which boat or water has changed.

Each segment is a quadratic form in the parameters, with a robust weight. The prior is normal. Each
refit has another precision of the prior, as a share of the population's: the weight of the data.

Four numbers can change at once, as a thruster fails or the boat enters a stream: the share of its
thrust that each side gives, and the current to north and east. The marginal likelihood that they
have changed at a row is a quadratic form as well. Where it is larger than that of no change, the
information on these four numbers from before is forgotten, and nothing else.

Source: Kass and Raftery 1995, doi:10.1080/01621459.1995.10476572 (evidence by Laplace's method);
Kulhavy 1987, doi:10.1016/0005-1098(87)90093-9 (directional forgetting).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from twin.filters.linalg import cholesky, invert, solve_factored
from twin.identification.segments import samples_of
from twin.model.rollout import GRID
from twin.model.structure import CURRENT
from twin.model.thrust_share import SIDES
from usv_kernel.arrays import take
from usv_kernel.jit import inlined, kernel

__all__ = [
    "NEVER",
    "REFITS",
    "EvidenceWork",
    "evidence_work",
    "find_change",
    "refit",
]

WEIGHTS = (1.0, 10.0, 100.0)
"""Of the data against the prior in each refit: powers of ten, as the best differs by so much."""

REFITS = len(WEIGHTS)

CHANGES = SIDES + 2

SHARE_SD, CURRENT_SD = 0.5, 1.0
"""Standard deviations of a change: of the share of its thrust that a side gives, and of the
current, m/s."""

FAILURES_S = 36000.0
"""Mean time between two changes, s: the prior odds of one in a given second are one to that."""

LAGS = (2.0, 6.0, 14.0)
"""Seconds before the last segment at which a change is sought."""

ERRORS = 4.0
"""Weight of the data in the evidence of a change, against that in the first refit. By the spread of
the segments' slopes (Pauli, Racugno and Ventura 2011, composite likelihoods), it is 3 to 12 on
simulated and recorded boats."""

REWEIGHTINGS = 3
"""Of the robust weights, in the search for a change."""

NEVER = -1e15
"""Row of a change that has not come."""

_WEIGHTS, _LAGS = np.array(WEIGHTS), np.array([round(lag / GRID) for lag in LAGS])


class EvidenceWork(NamedTuple):
    """Scratch of a refit of p parameters to n segments."""

    order: Any  # (n,) slots, the oldest first
    weights: Any  # (n,) of the segments
    cost: Any  # (n,) squared errors of a segment at parameters
    slopes: Any  # (n, 4) and how they change with the changes
    curvature: Any  # (n, 4, 4)
    size: Any  # (4,) changes found, in standard deviations
    effects: Any  # (4, p) parameters by a change of one standard deviation
    image: Any  # (4, p) their products with a curvature or with the information
    seen: Any  # (4, 4) information on the changes
    slope: Any  # (4,)
    few: Any  # (1, 4)
    Y: Any  # (p, p) information
    y: Any  # (p,) information times mean
    d: Any  # (p,) mean of the parameters relative to the prior's
    U: Any  # (p, p) Cholesky factor of the information
    line: Any  # (p + 1, p) see ``linalg.invert``


@inlined
def evidence_work(work, p, n):
    """Open the scratch of a refit."""
    order, at = take(work, 0, (n,))
    weights, at = take(work, at, (n,))
    cost, at = take(work, at, (n,))
    slopes, at = take(work, at, (n, CHANGES))
    curvature, at = take(work, at, (n, CHANGES, CHANGES))
    size, at = take(work, at, (CHANGES,))
    effects, at = take(work, at, (CHANGES, p))
    image, at = take(work, at, (CHANGES, p))
    seen, at = take(work, at, (CHANGES, CHANGES))
    slope, at = take(work, at, (CHANGES,))
    few, at = take(work, at, (1, CHANGES))
    Y, at = take(work, at, (p, p))
    y, at = take(work, at, (p,))
    d, at = take(work, at, (p,))
    U, at = take(work, at, (p, p))
    line, at = take(work, at, (p + 1, p))
    return EvidenceWork(
        order,
        weights,
        cost,
        slopes,
        curvature,
        size,
        effects,
        image,
        seen,
        slope,
        few,
        Y,
        y,
        d,
        U,
        line,
    )


@inlined
def _write_effects(xi, config, model, effects):
    """Write what a standard deviation of each change does to parameters (p,)."""
    p, at = xi.shape[0], int(model.hull[CURRENT])
    effects[:] = 0.0
    for side in range(SIDES):
        for i in range(p):
            for k in range(p):
                effects[side, i] += SHARE_SD * config.shares[side, i, k] * xi[k]
    if at >= 0:
        for i in range(2):
            effects[SIDES + i, at + i] = CURRENT_SD


@inlined
def _write_order(first, order):
    """Write the slots in use, the oldest first; return their number."""
    count = 0
    for n in range(first.shape[0]):
        if first[n] < 0.0:
            continue
        at = count
        while at > 0 and first[int(order[at - 1])] > first[n]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = n
        count += 1
    return count


@inlined
def _multiply(packed, x, out):
    """Write the product of a packed symmetric matrix, the upper triangle by rows, with a vector."""
    p, at = x.shape[0], 0
    out[:] = 0.0
    for i in range(p):
        row, own = packed[at : at + p - i], x[i]
        total = row[0] * own
        for k in range(1, row.shape[0]):
            total += row[k] * x[i + k]
            out[i + k] += row[k] * own
        out[i] += total
        at += p - i


@inlined
def _reduce(variance, work):
    """Factor I + variance times what is seen of the changes: U' U.

    ``seen`` becomes U, ``slope`` U'^-1 times what it was. Returned is the logarithm of the
    determinant, and the least squares that the changes explain.
    """
    seen, slope = work.seen, work.slope
    for i in range(CHANGES):
        for j in range(CHANGES):
            seen[i, j] = variance * seen[i, j] + (1.0 if i == j else 0.0)
    cholesky(seen, seen, work.few)
    logarithm, square = 0.0, 0.0
    for i in range(CHANGES):
        for k in range(i):
            slope[i] -= seen[k, i] * slope[k]
        slope[i] /= seen[i, i]
        square += variance * slope[i] * slope[i]
        logarithm += 2.0 * math.log(seen[i, i])
    return logarithm, square


@kernel
def _write_costs(xi, before, count, state, config, work):
    """Write the squared errors of segments; of those that begin before a row also as quadratics.

    The quadratics are in the changes, of which ``work.effects`` says what they do.
    """
    d, image, effects = work.d, work.image[0], work.effects
    p = xi.shape[0]
    for k in range(p):
        d[k] = xi[k] - config.prior[k]
    for at in range(count):
        n = int(work.order[at])
        packed, b, cost = state.packed[n], state.b[n], state.c[n]
        _multiply(packed, d, image)
        for k in range(p):
            cost += d[k] * (image[k] - 2.0 * b[k])
            work.y[k] = b[k] - image[k]
        work.cost[at] = max(cost, 0.0)
        if state.first[n] >= before:
            continue
        for i in range(CHANGES):
            work.slopes[at, i] = 0.0
            for k in range(p):
                work.slopes[at, i] += effects[i, k] * work.y[k]
            _multiply(packed, effects[i], image)
            for j in range(i + 1):
                total = 0.0
                for k in range(p):
                    total += effects[j, k] * image[k]
                work.curvature[at, i, j] = work.curvature[at, j, i] = total


@inlined
def _changed_cost(at, work):
    """Return the squared errors of a segment with the changes found."""
    cost = work.cost[at]
    for i in range(CHANGES):
        image = 0.0
        for j in range(CHANGES):
            image += work.curvature[at, i, j] * work.size[j]
        cost += work.size[i] * (image - 2.0 * work.slopes[at, i])
    return max(cost, 0.0)


@inlined
def _robust(q, knee):
    """Return what a segment's mean squared error counts."""
    return q if q <= knee else knee * (1.0 + math.log(q / knee))


@inlined
def _weight(q, knee):
    """Return the weight of a segment, by which its mean squared error counts so much more."""
    return 1.0 if q <= knee else knee / q


@kernel
def _evidence(first, last, count, state, config, work):
    """Return twice the logarithm of the posterior odds that some segments have changed.

    They are those that begin from row ``first`` on and before row ``last``.
    """
    samples, scale, knee = samples_of(config), ERRORS * config.scale, config.knee
    work.size[:] = 0.0
    for _ in range(REWEIGHTINGS):
        work.seen[:] = 0.0
        work.slope[:] = 0.0
        for at in range(count):
            if first <= state.first[int(work.order[at])] < last:
                weight = scale * _weight(_changed_cost(at, work) / samples, knee)
                for i in range(CHANGES):
                    work.slope[i] += weight * work.slopes[at, i]
                    for j in range(CHANGES):
                        work.seen[i, j] += weight * work.curvature[at, i, j]
        logarithm, _ = _reduce(1.0, work)
        for i in range(CHANGES - 1, -1, -1):
            total = work.slope[i]
            for k in range(i + 1, CHANGES):
                total -= work.seen[i, k] * work.size[k]
            work.size[i] = total / work.seen[i, i]
    evidence = -2.0 * math.log(FAILURES_S) - logarithm
    for i in range(CHANGES):
        evidence -= work.size[i] * work.size[i]
    for at in range(count):
        if first <= state.first[int(work.order[at])] < last:
            before = _robust(work.cost[at] / samples, knee)
            after = _robust(_changed_cost(at, work) / samples, knee)
            evidence += scale * samples * (before - after)
    return evidence


@kernel
def find_change(newest, changed, xi, state, config, model, work):
    """Return the row at which thrust or current has changed by the evidence, or :data:`NEVER`.

    ``xi`` are the parameters in use since the row ``changed``, ``newest`` is the newest row.
    """
    count = _write_order(state.first, work.order)
    _write_effects(xi, config, model, work.effects)
    _write_costs(xi, math.inf, count, state, config, work)
    for k in range(_LAGS.shape[0]):
        since = newest - config.steps - _LAGS[k]
        if since > changed and _evidence(since, math.inf, count, state, config, work) > 0.0:
            return since
    if changed > NEVER and _evidence(NEVER, changed, count, state, config, work) > 0.0:
        return changed
    return NEVER


@kernel
def _forget(work):
    """Let the four numbers change, by what that leaves of the information on them."""
    Y, y, D, image, seen, slope = work.Y, work.y, work.effects, work.image, work.seen, work.slope
    p = y.shape[0]
    for i in range(CHANGES):
        image[i] = 0.0
        slope[i] = 0.0
        for k in range(p):
            slope[i] += D[i, k] * y[k]
            for j in range(p):
                image[i, j] += D[i, k] * Y[min(k, j), max(k, j)]
    for i in range(CHANGES):
        for j in range(CHANGES):
            seen[i, j] = 0.0
            for k in range(p):
                seen[i, j] += image[i, k] * D[j, k]
    _reduce(1.0, work)
    for i in range(CHANGES):
        own = image[i]
        for j in range(p):
            for k in range(i):
                own[j] -= seen[k, i] * image[k, j]
            own[j] /= seen[i, i]
            y[j] -= own[j] * slope[i]
        for j in range(p):
            for k in range(j, p):
                Y[j, k] -= own[j] * own[k]


@kernel
def _posterior(changed, size, count, state, config, work):
    """Write the mean d and the factor U; return False where rounding leaves no definite matrix.

    ``changed`` is the row at which the four numbers change, ``size`` the weight of the data.
    """
    Y, y, d, information = work.Y, work.y, work.d, config.information
    p, at = y.shape[0], 0
    for i in range(p):
        y[i] = 0.0
        for j in range(i, p):
            Y[i, j] = information[at]
            at += 1
    for n in range(count):
        slot, weight = int(work.order[n]), size * work.weights[n]
        if n > 0 and state.first[int(work.order[n - 1])] < changed <= state.first[slot]:
            _forget(work)
        packed, at = state.packed[slot], 0
        for i in range(p):
            row, own = Y[i, i:], packed[at : at + p - i]
            for j in range(own.shape[0]):
                row[j] += weight * own[j]
            y[i] += weight * state.b[slot, i]
            at += p - i
    if cholesky(Y, work.U, work.line) > 0:
        return False
    solve_factored(work.U, y, d)
    return True


@kernel
def refit(r, changed, xi, cov, state, config, model, work):
    """Move the parameters of a refit to its posterior mean, and write their covariance."""
    count, p, samples = _write_order(state.first, work.order), xi.shape[0], samples_of(config)
    if changed > NEVER:
        _write_effects(xi, config, model, work.effects)
    _write_costs(xi, changed, count, state, config, work)
    for at in range(count):
        square = work.cost[at]
        if state.first[int(work.order[at])] < changed:
            # before the change, errors count as far as no change explains them
            for i in range(CHANGES):
                work.slope[i] = work.slopes[at, i]
                for j in range(CHANGES):
                    work.seen[i, j] = work.curvature[at, i, j]
            square -= _reduce(config.scale, work)[1]
        work.weights[at] = config.scale * _weight(max(square, 0.0) / samples, config.knee)
    if not _posterior(changed, _WEIGHTS[r], count, state, config, work):
        return
    for k in range(p):
        xi[k] = config.prior[k] + work.d[k]
    invert(work.U, cov, work.line)
