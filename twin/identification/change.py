"""What can change about a boat at once, and whether it has: thrust of a side, and the current.

A thruster fails or picks up weed, or the boat enters a stream. Nothing else of the model changes,
so it is tested whether these few numbers explain the last segments better than the model does: a
generalised likelihood ratio, with a prior on each change. Where they do, the boat has changed, and
the refit goes on from what was known before, widened by them.

Source: Willsky and Jones 1976 (generalised likelihood ratios for jumps in linear systems).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from twin.filters.linalg import cholesky, invert, solve_factored
from twin.model.structure import CURRENT
from twin.model.thrust_share import SIDES
from usv_kernel.arrays import take
from usv_kernel.jit import inlined, kernel

__all__ = [
    "ChangeWork",
    "change_evidence",
    "change_work",
    "known_before",
    "quadratics_by_changes",
    "widen_known",
]

CHANGES = SIDES + 2
"""Share of thrust of the left and right side, current to north and east."""

SHARE_SD = 0.5
CURRENT_CHANGE_SD_MPS = 1.0
"""Prior standard deviations of a change: of a side's share of its thrust, and of the current."""

REWEIGHTINGS = 3
"""Robust reweightings in the search for a change."""


class ChangeWork(NamedTuple):
    """Scratch of a test of n segments for changes of p parameters."""

    effects: Any  # (4, p) parameters by a change of one standard deviation
    offset: Any  # (p,) parameters relative to the prior's
    image: Any  # (p,) product with a curvature
    cost: Any  # (n,) a segment's mean squared error without a change
    slope: Any  # (n, 4) its quadratic in the changes
    curvature: Any  # (n, 4, 4)
    size: Any  # (4,) changes found, in standard deviations
    right: Any  # (4,)
    total: Any  # (4, 4)
    line: Any  # (1, 4)


@inlined
def change_work(work, p, n):
    """Open the scratch of a test for changes."""
    effects, at = take(work, 0, (CHANGES, p))
    offset, at = take(work, at, (p,))
    image, at = take(work, at, (p,))
    cost, at = take(work, at, (n,))
    slope, at = take(work, at, (n, CHANGES))
    curvature, at = take(work, at, (n, CHANGES, CHANGES))
    size, at = take(work, at, (CHANGES,))
    right, at = take(work, at, (CHANGES,))
    total, at = take(work, at, (CHANGES, CHANGES))
    line, at = take(work, at, (1, CHANGES))
    return ChangeWork(effects, offset, image, cost, slope, curvature, size, right, total, line)


@inlined
def _write_effects(xi, config, model, effects):
    """Write the change of parameters (p,) by one standard deviation of each change."""
    p, at = xi.shape[0], int(model.hull[CURRENT])
    effects[:] = 0.0
    for side in range(SIDES):
        for i in range(p):
            for k in range(p):
                effects[side, i] += SHARE_SD * config.shares[side, i, k] * xi[k]
    if at >= 0:
        for i in range(2):
            effects[SIDES + i, at + i] = CURRENT_CHANGE_SD_MPS


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


@kernel
def quadratics_by_changes(since, xi, state, config, model, work):
    """Write the segments that begin from row ``since`` on as quadratics in the changes."""
    effects, offset, image = work.effects, work.offset, work.image
    p = xi.shape[0]
    _write_effects(xi, config, model, effects)
    for k in range(p):
        offset[k] = xi[k] - config.prior[k]
    for n in range(state.first.shape[0]):
        if state.first[n] < max(since, 0):
            continue
        _multiply(state.packed[n], offset, image)
        cost = state.c[n]
        for k in range(p):
            cost += offset[k] * (image[k] - 2.0 * state.b[n, k])
        work.cost[n] = max(cost, 0.0)
        for i in range(CHANGES):
            total = 0.0
            for k in range(p):
                total += effects[i, k] * (state.b[n, k] - image[k])
            work.slope[n, i] = total
        for i in range(CHANGES):
            _multiply(state.packed[n], effects[i], image)
            for j in range(i + 1):
                total = 0.0
                for k in range(p):
                    total += effects[j, k] * image[k]
                work.curvature[n, i, j] = work.curvature[n, j, i] = total


@inlined
def _changed_cost(n, work):
    """Return the squared errors of a segment with the changes found."""
    cost = work.cost[n]
    for i in range(CHANGES):
        image = 0.0
        for j in range(CHANGES):
            image += work.curvature[n, i, j] * work.size[j]
        cost += work.size[i] * (image - 2.0 * work.slope[n, i])
    return max(cost, 0.0)


@inlined
def _robust(q, knee):
    """Return a segment's mean squared error after robust weighting."""
    return q if q <= knee else knee * (1.0 + math.log(q / knee))


@kernel
def change_evidence(since, samples, state, config, work):
    """Return twice the log-likelihood ratio of a change at row ``since`` against none.

    The prior's penalty on the size of the changes is taken off. :func:`quadratics_by_changes`
    comes first.
    ``samples`` is the number of errors in a segment.
    """
    size, total, right = work.size, work.total, work.right
    size[:] = 0.0
    for _ in range(REWEIGHTINGS):
        for i in range(CHANGES):
            right[i] = 0.0
            for j in range(CHANGES):
                total[i, j] = 1.0 if i == j else 0.0
        for n in range(state.first.shape[0]):
            if state.first[n] < max(since, 0):
                continue
            q = _changed_cost(n, work) / samples
            weight = config.scale * (1.0 if q <= config.knee else config.knee / q)
            for i in range(CHANGES):
                right[i] += weight * work.slope[n, i]
                for j in range(CHANGES):
                    total[i, j] += weight * work.curvature[n, i, j]
        if cholesky(total, total, work.line) > 0:
            return 0.0
        solve_factored(total, right, size)
    evidence = 0.0
    for n in range(state.first.shape[0]):
        if state.first[n] >= max(since, 0):
            before = _robust(work.cost[n] / samples, config.knee)
            after = _robust(_changed_cost(n, work) / samples, config.knee)
            evidence += config.scale * samples * (before - after)
    for i in range(CHANGES):
        evidence -= size[i] * size[i]
    return evidence


@kernel
def known_before(since, samples, state, config, work):
    """Return the information on the thrust of both sides from segments before row ``since``.

    In standard deviations of a change to the power of -2; see :func:`quadratics_by_changes`, which
    must have written all segments.
    """
    known = 0.0
    for n in range(state.first.shape[0]):
        if 0 <= state.first[n] < since:
            q = work.cost[n] / samples
            weight = config.scale * (1.0 if q <= config.knee else config.knee / q)
            for i in range(SIDES):
                for j in range(SIDES):
                    known += weight * work.curvature[n, i, j]
    return known


@kernel
def widen_known(base, factor, pull, information, config, model, work):
    """Write the prior of the parameters after a change.

    ``base`` (p,) are the parameters of before, ``factor`` (p, p) the upper Cholesky factor of their
    information. ``pull`` and ``information`` are written, see
    ``twin.identification.segments.Known``. Returned is False, and nothing is written, where there
    is no factor yet, or rounding leaves no definite matrix. ``work`` is a ``RefitWork``.
    """
    p, A, U, line = base.shape[0], work.solve.H, work.solve.U, work.solve.inverse
    effects = work.change.effects
    if factor[0, 0] <= 0.0:
        return False
    invert(factor, A, line)
    _write_effects(base, config, model, effects)
    for i in range(p):
        for k in range(p):
            for j in range(CHANGES):
                A[i, k] += effects[j, i] * effects[j, k]
    if cholesky(A, U, line) > 0:
        return False
    invert(U, A, line)
    at = 0
    for i in range(p):
        pull[i] = 0.0
        for k in range(p):
            pull[i] += A[i, k] * (base[k] - config.prior[k])
        for k in range(i, p):
            information[at] = A[i, k]
            at += 1
    return True
