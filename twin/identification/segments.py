"""The segments of a window as quadratics, and the parameters that suit them best.

See :mod:`twin.identification.prediction_error` for what is minimised.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.filters.linalg import cholesky, dot, invert, packed_size, solve_factored
from twin.identification.change import ChangeWork, change_work
from twin.identification.interval_scale import RecordWork, record_work
from twin.identification.prediction_error import (
    LineariseWork,
    RefitConfig,
    RefitSettings,
    linearise,
    linearise_work,
    refit_config,
)
from twin.model.rollout import GRID
from twin.model.structure import N_STATES, ModelTerms
from twin.model.thrust_share import share_slopes
from usv_kernel.arrays import flat_size, named_dtype, python_views, take
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import fma

__all__ = [
    "ITERATIONS",
    "Known",
    "RefitWork",
    "SegmentState",
    "Segments",
    "add",
    "discard_before",
    "relinearise",
    "samples_of",
    "segment_state",
    "segment_work",
    "solve",
    "store_factor",
    "use",
]

Array = NDArray[Any]

ITERATIONS = 4
"""Of the robust weights, in a refit."""


class SegmentState(NamedTuple):
    """What the refit of a boat remembers: n segments as quadratics, and the parameters in use.

    A segment's quadratic is ``c - 2 b . d + d' H d`` at parameters d relative to the prior's.
    """

    params: Any  # (p,) parameters in use
    cov: Any  # (p, p) their covariance (Laplace)
    first: Any  # (n,) first row of each segment; -1 where there is none
    c: Any  # (n,) constants
    b: Any  # (n, p) slopes
    at: Any  # (n, p) parameters at which each was linearised
    packed: Any  # (n, h) curvatures H, packed


class Known(NamedTuple):
    """Weight and window of the segments in a refit, and its prior information."""

    data_weight: Any  # factor of the segments' information
    since: Any  # segments that begin before this row do not count
    rhs: Any  # (p,) information times the difference of its mean to the prior's; 0 for the prior
    information: Any  # (h,) inverse of its covariance, packed


class SegmentWork(NamedTuple):
    """Scratch of the refit."""

    H: Any  # (p, p) curvature of one segment
    pull: Any  # (p,) its slope
    offset: Any  # (p,) parameters relative to the prior's
    total: Any  # (h,) sum of the curvatures, packed
    square: Any  # (h,) products d d', packed
    lanes: Any  # (h / 6,) see ``linalg.dot``
    U: Any  # (p, p) Cholesky factor of the last solution
    inverse: Any  # (p + 1, p) see ``linalg.invert``
    d: Any  # (p,) parameters relative to the prior's
    right: Any  # (p,) right side
    none: Any  # (p,) zeros
    moved: Any  # (n,) how far parameters have moved since a segment was linearised


@inlined
def segment_state(memory, p, n):
    """Open the memory of n segments."""
    params, at = take(memory, 0, (p,))
    cov, at = take(memory, at, (p, p))
    first, at = take(memory, at, (n,))
    c, at = take(memory, at, (n,))
    b, at = take(memory, at, (n, p))
    linearised, at = take(memory, at, (n, p))
    packed, at = take(memory, at, (n, packed_size(p)))
    return SegmentState(params, cov, first, c, b, linearised, packed)


@inlined
def segment_work(work, p, n):
    """Open the scratch of a refit of n segments."""
    h = packed_size(p)
    H, at = take(work, 0, (p, p))
    pull, at = take(work, at, (p,))
    offset, at = take(work, at, (p,))
    total, at = take(work, at, (h,))
    square, at = take(work, at, (h,))
    lanes, at = take(work, at, (h // 6,))
    U, at = take(work, at, (p, p))
    inverse, at = take(work, at, (p + 1, p))
    d, at = take(work, at, (p,))
    right, at = take(work, at, (p,))
    none, at = take(work, at, (p,))
    moved, at = take(work, at, (n,))
    return SegmentWork(H, pull, offset, total, square, lanes, U, inverse, d, right, none, moved)


class RefitWork(NamedTuple):
    """Scratch of linearisation and solution."""

    line: Any  # LineariseWork
    solve: Any  # SegmentWork
    change: Any  # see ``twin.identification.change``
    spread: Any  # see ``twin.identification.interval_scale``


@kernel
def _linearise(slot, first, rows, xi, state, config, model, work):
    """Linearise a segment at parameters into a slot; return False where the motion is lost."""
    p = xi.shape[0]
    H, pull, offset = work.solve.H, work.solve.pull, work.solve.offset
    cost = linearise(first, rows, xi, model, config, work.line, H, pull)
    if not cost < math.inf:
        return False
    k = 0
    for i in range(p):
        offset[i], state.at[slot, i] = xi[i] - config.prior[i], xi[i]
    # moved to the prior, which is the same for all
    for i in range(p):
        total = 0.0
        for j in range(p):
            total += H[i, j] * offset[j]
        cost += offset[i] * (2.0 * pull[i] + total)
        state.b[slot, i] = pull[i] + total
        for j in range(i, p):
            state.packed[slot, k] = H[i, j]
            k += 1
    state.c[slot] = cost
    return True


@kernel
def add(first, rows, xi, state, config, model, work):
    """Take a new segment from row ``first`` on, in the place of the oldest."""
    slot = 0
    for i in range(state.first.shape[0]):
        if state.first[i] < state.first[slot]:
            slot = i
    if _linearise(slot, first, rows, xi, state, config, model, work):
        state.first[slot] = first


@inlined
def discard_before(before, state):
    """Forget segments that begin before a row; return how many there are then."""
    first, count = state.first, 0
    for i in range(first.shape[0]):
        if first[i] < before:
            first[i] = -1.0
        if first[i] >= 0.0:
            count += 1
    return count


@kernel
def relinearise(budget, rows, xi, state, config, model, work):
    """Relinearise at parameters, first those segments whose linearisation point is farthest."""
    first, moved = state.first, work.solve.moved
    for i in range(first.shape[0]):
        moved[i] = -1.0
        if first[i] >= 0.0:
            moved[i] = 0.0
            for k in range(xi.shape[0]):
                moved[i] += (xi[k] - state.at[i, k]) ** 2 / config.variance[k]
    for _ in range(min(budget, first.shape[0])):
        most = 0
        for i in range(first.shape[0]):
            if moved[i] > moved[most]:
                most = i
        if moved[most] < 0.0:
            return
        moved[most] = -1.0
        _linearise(most, int(first[most]), rows, xi, state, config, model, work)


@kernel
def _square(d, square):
    """Write the packed products d d', those off the diagonal twice: it times H is d' H d."""
    k, p = 0, d.shape[0]
    for i in range(p):
        row, rest, twice = square[k : k + p - i], d[i:], 2.0 * d[i]
        for j in range(row.shape[0]):
            row[j] = twice * rest[j]
        row[0] *= 0.5
        k += p - i


@kernel
def _cost(H, b, c, d, square, lanes):
    """Return one segment's quadratic at parameters d relative to the prior's."""
    total = c + dot(H, square, lanes)
    for k in range(d.shape[0]):
        total -= 2.0 * b[k] * d[k]
    return max(total, 0.0)


@inlined
def samples_of(config):
    """Return the number of errors in a segment."""
    return N_STATES * (config.steps // config.every)


@kernel
def _costs(xi, state, config, work, q):
    """Write q_i of each segment that there is."""
    d, square = work.solve.d, work.solve.square
    for k in range(xi.shape[0]):
        d[k] = xi[k] - config.prior[k]
    square[:] = 0.0
    _square(d, square)
    samples = samples_of(config)
    for i in range(state.first.shape[0]):
        if state.first[i] >= 0.0:
            cost = _cost(state.packed[i], state.b[i], state.c[i], d, square, work.solve.lanes)
            q[i] = cost / samples


@kernel
def _unpack(packed, A):
    """Write the upper triangle of a packed matrix."""
    k = 0
    for i in range(A.shape[0]):
        row = A[i, i:]
        for j in range(row.shape[0]):
            row[j] = packed[k + j]
        k += row.shape[0]


@kernel
def solve(xi, known, iterations, state, config, work):
    """Move parameters to the minimum of the weighted quadratics and the prior.

    ``known`` has the weight of the segments, the first of them, and the prior information.
    ``iterations`` is the number of robust reweightings. Returned is False where rounding has left
    no definite matrix; else its factor is ``work.solve.U``.
    """
    p, scratch = xi.shape[0], work.solve
    total, square, U, d, rhs = scratch.total, scratch.square, scratch.U, scratch.d, scratch.right
    prior, information = config.prior, known.information
    first, packed, slope = state.first, state.packed, state.b
    scale, knee, samples = config.scale, config.knee, samples_of(config)
    for k in range(p):
        d[k] = xi[k] - prior[k]
    square[:] = 0.0
    for _ in range(iterations):
        _square(d, square)
        for k in range(total.shape[0]):
            total[k] = information[k]
        for k in range(p):
            rhs[k] = known.rhs[k]
        for i in range(first.shape[0]):
            if first[i] < 0.0 or first[i] < known.since:
                continue
            q = _cost(packed[i], slope[i], state.c[i], d, square, scratch.lanes) / samples
            weight = known.data_weight * scale * (1.0 if q <= knee else knee / q)
            curvature, gradient = packed[i], slope[i]
            for k in range(total.shape[0]):
                total[k] = fma(weight, curvature[k], total[k])
            for k in range(p):
                rhs[k] += weight * gradient[k]
        _unpack(total, U)
        if cholesky(U, U, scratch.inverse) > 0:
            return False  # The prior alone is positive definite: this is rounding.
        solve_factored(U, rhs, d)
        for k in range(p):
            xi[k] = prior[k] + d[k]
    return True


@kernel
def store_factor(U, out):
    """Write the factor (p, p) of the last solution, which is the upper triangle of U."""
    for i in range(U.shape[0]):
        for k in range(U.shape[0]):
            out[i, k] = U[i, k] if k >= i else 0.0  # entries below the diagonal are undefined


@kernel
def use(xi, factor, state, work):
    """Put parameters to use, and the covariance that belongs to a factor: 0 where it has none."""
    for k in range(xi.shape[0]):
        state.params[k] = xi[k]
    if factor[0, 0] > 0.0:
        invert(factor, state.cov, work.solve.inverse)


class Segments:
    """The segments of a window as quadratics, and the parameters that suit them best.

    ``mean`` (p,) and ``cov`` (p, p) are the prior. Of more than ``capacity`` segments a new one
    takes the place of the oldest. ``schedule`` is for the compiled predictor: time between refits
    (s), segments that one relinearises, rows between starts, rows of the window, and whether the
    joint filter's parameters are a candidate. ``memory, values, line, scratch`` are flat; ``state,
    config, work`` are the same by name. ``params`` (p,) and ``cov`` (p, p, Laplace) are views, the
    prior's at first.
    """

    def __init__(
        self,
        model: ModelTerms,
        mean: Array,
        cov: Array,
        settings: RefitSettings,
        capacity: int,
        schedule: tuple[float, ...] = (0.0,) * 5,
    ) -> None:
        p = len(mean)
        self.model, self.settings = model, settings
        self.prior, self.prior_cov = np.array(mean), np.array(cov)
        self.information = np.linalg.inv(cov)
        self.information = 0.5 * (self.information + self.information.T)
        self.steps = round(settings.horizon / GRID)
        self.samples = N_STATES * (self.steps // settings.every)
        packed = np.zeros(int(packed_size(p)))
        packed[: p * (p + 1) // 2] = self.information[np.triu_indices(p)]
        self.values = np.concatenate(
            [
                settings.sd**-2.0,
                settings.offset_sd**-2.0,
                [self.steps, settings.every, settings.scale, settings.knee, capacity],
                schedule,
                self.prior,
                np.diag(self.prior_cov),
                packed,
                share_slopes(model).ravel(),
            ]
        )
        self.config: RefitConfig = python_views(refit_config)(self.values, p)
        self.memory = np.zeros(flat_size(segment_state, p, capacity))
        self.state: SegmentState = python_views(segment_state)(self.memory, p, capacity)
        self.params, self.cov = self.state.params, self.state.cov
        self.line = np.zeros(flat_size(linearise_work, p))
        self.scratch = np.zeros(flat_size(segment_work, p, capacity))
        self.changes = np.zeros(flat_size(change_work, p, capacity))
        line: LineariseWork = python_views(linearise_work)(self.line, p)
        changes: ChangeWork = python_views(change_work)(self.changes, p, capacity)
        scratch = python_views(segment_work)(self.scratch, p, capacity)
        self.spread = np.zeros(flat_size(record_work, p))
        spread: RecordWork = python_views(record_work)(self.spread, p)
        self.work = RefitWork(line, scratch, changes, spread)
        self.reset()

    @property
    def dtype(self) -> np.dtype[Any]:
        """Structured dtype of the memory; see :class:`SegmentState`."""
        return named_dtype(segment_state, len(self.prior), self.config.capacity)

    def reset(self) -> None:
        """Forget every segment."""
        self.memory[:] = 0.0
        self.state.first[:] = -1.0
        self.params[:], self.cov[:] = self.prior, self.prior_cov

    @property
    def first(self) -> Array:
        """First row of each segment (n,); -1 where there is none."""
        return self.state.first.astype(int)

    @property
    def H(self) -> Array:
        """Curvatures (n, p, p)."""
        p = len(self.prior)
        i, j = np.triu_indices(p)
        full = np.zeros((len(self.state.c), p, p))
        full[:, i, j] = full[:, j, i] = self.state.packed[:, : len(i)]
        return full

    def add(self, first: int, rows: Array, xi: Array) -> None:
        """Take a new segment from row ``first`` on, in the place of the oldest."""
        add(first, rows, xi, self.state, self.config, self.model, self.work)

    def relinearise(self, rows: Array, budget: int) -> None:
        """Relinearise at the present parameters, those that moved most first."""
        relinearise(budget, rows, self.params, self.state, self.config, self.model, self.work)

    def costs(self, xi: Array) -> Array:
        """Return q_i at parameters, by the quadratics; 0 where there is no segment."""
        q = np.zeros(self.config.capacity)
        _costs(xi, self.state, self.config, self.work, q)
        return q

    def objective(self, xi: Array) -> float:
        """Return the objective of :meth:`solve`, by the quadratics."""
        q = self.costs(xi)
        knee, offset = self.settings.knee, xi - self.prior
        rho = np.where(q <= knee, q, knee * (1.0 + np.log(np.maximum(q, knee) / knee)))
        weight = self.settings.scale * self.samples
        return float(weight * rho.sum() + offset @ self.information @ offset)

    def solve(self, iterations: int = ITERATIONS, damping: float = 0.0) -> None:
        """Move the parameters to the minimum of the quadratics and the prior; see :func:`solve`.

        ``damping`` is that of Levenberg and Marquardt in units of the prior's information.
        """
        rhs = damping * self.information @ (self.params - self.prior)
        known = Known(1.0, 0, rhs, (1.0 + damping) * self.config.information)
        given = self.state, self.config, self.work
        # the factor of a damped step is not that of the posterior
        if solve(self.params, known, iterations, *given) and damping == 0.0:
            use(self.params, self.work.solve.U, self.state, self.work)

    def fit(self, rows: Array, *, iterations: int = 30, tolerance: float = 1e-9) -> bool:
        """Minimise the true objective; return whether the iteration converged.

        Levenberg-Marquardt over ``rows`` (M, 20), at most ``iterations`` times, until the objective
        falls by less than the share ``tolerance`` of itself.
        """
        many, damping = len(self.first), 0.0
        self.relinearise(rows, many)
        best = self.objective(self.params)
        for _ in range(iterations):
            kept = self.memory.copy()
            self.solve(1, damping)
            self.relinearise(rows, many)
            reached = bool((self.state.at[self.first >= 0] == self.params).all())
            now = self.objective(self.params) if reached else math.inf
            if now <= best:
                done = best - now <= tolerance * best
                best, damping = now, 0.25 * damping if damping > 1e-6 else 0.0
                if done:
                    self.solve(1)
                    return True
            else:
                # the covariance belongs to the parameters that are restored here
                cov = self.cov.copy()
                self.memory[:] = kept
                self.cov[:] = cov
                damping = max(4.0 * damping, 1e-2)
                if damping > 1e8:
                    return True
        return False
