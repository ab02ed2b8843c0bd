"""Multi-step prediction-error refit: the parameters with which the model would have predicted best.

A window of navigation states on an even grid is cut into *segments*. Every ``spacing`` seconds one
begins, and from there the model is rolled out over ``horizon`` seconds under the actuators as they
were. The parameters are those that make the errors of all segments small,

    sum over segments of  scale n_i rho(q_i)  +  (xi - xi_0)' P_0^-1 (xi - xi_0),
    q_i = 1 / n_i * min over d of [ sum of (errors / sd)^2 + (d / sd_d)^2 ]

with n_i errors in segment i and a free offset d of the initial u, v, r. rho(q) is q up to ``knee``,
and knee (1 + log(q / knee)) beyond. The offset carries a wave, which no parameter should absorb. A
segment that a gust or a wave group has disturbed counts less, as if its weight were min(1, knee /
q). ``scale`` makes up for errors that are correlated from sample to sample. ``data_weight``
multiplies the information of all segments, but not that of the prior.

Each segment is kept as a quadratic in xi about the parameters at which it was linearised. The
offset is removed by its Schur complement. So a refit costs a sum of small matrices. Segments are
relinearised a few at a time, those first whose parameters have moved most.

Source: docs/explanation/twin.md, The refit; Levenberg 1944, Marquardt 1963.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.channels import PSI, R, U, V, X, Y
from twin.filters.linalg import add_square, packed_size
from twin.model.dynamics import rates_over_ground
from twin.model.rollout import GRID
from twin.model.structure import (
    BY_CURRENT,
    BY_PSI,
    BY_R,
    BY_U,
    BY_V,
    CURRENT,
    LEFT_COS,
    N_STATES,
    N_TERMS,
    WIND_N,
    WIND_X,
    current_of,
    term_slopes,
    through_water,
    thrust_terms,
)
from twin.model.thrust_share import SIDES
from usv_kernel.arrays import take
from usv_kernel.errors import UsvTwinError
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import fma

__all__ = [
    "COLUMNS",
    "LineariseWork",
    "RefitConfig",
    "RefitSettings",
    "drive",
    "linearise",
    "linearise_work",
    "refit_config",
    "rk4_step",
]

Array = NDArray[Any]

N_OFFSETS = 3

# columns of a window's rows
STATE = 0
LOW = 6
WIND = 9
GOOD = 11
ACT = 12
MIDDLE = 16

COLUMNS = 20
"""Navigation state (6), low-frequency velocities (3), true wind (2), whether the row may be
fitted, actuators then (4) and half a step later (4)."""


NONE, FIRST = range(2)
"""The joint filter's parameters are no candidate, or in use until another has proved better."""

SPAN_MAX = 3600.0
"""Longest window, s."""


class RefitError(UsvTwinError):
    """Settings of the refit that cannot be used; the message names the field."""


@dataclass(frozen=True)
class RefitSettings:
    """How the window is cut up and weighted.

    The defaults are those of :func:`twin.predictors.dsw_ukf_plus.refit_settings`. They were tuned
    on a boat of 6.336 m at 5.4 m/s.
    """

    # length of the window, time between starts, length of a segment, s
    span: float
    spacing: float
    horizon: float
    every: int  # grid steps between the samples that are compared
    # (6,): standard deviations of the errors of x, y (m), psi (rad), u, v (m/s), r (rad/s): errors
    # of a perfect forecast in waves
    sd: Array
    offset_sd: Array  # (3,): standard deviations of the initial u, v (m/s) and r (rad/s)
    # see the head of this file
    scale: float
    knee: float

    def __post_init__(self) -> None:
        for name, size in (("sd", N_STATES), ("offset_sd", N_OFFSETS)):
            value = np.asarray(getattr(self, name))
            if value.shape != (size,) or not (np.isfinite(value) & (value > 0.0)).all():
                raise RefitError(f"{name} = {value} must be {size} finite numbers above 0")
        for name in ("span", "spacing", "horizon"):
            value = getattr(self, name)
            if not GRID <= value <= SPAN_MAX:
                raise RefitError(f"{name} = {value} must be {GRID} to {SPAN_MAX:g} s")
        if self.span < self.horizon:
            raise RefitError(f"span = {self.span} must be at least horizon = {self.horizon} s")
        for name in ("scale", "knee"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise RefitError(f"{name} = {getattr(self, name)} must be finite and above 0")
        if not 1 <= self.every <= self.horizon / GRID or self.every != int(self.every):
            raise RefitError(f"every = {self.every} must be 1 to {self.horizon / GRID:g}, whole")


_ROWS = N_STATES + 12
"""What sensitivities after a step are sums of: those before it, and the terms of surge, sway and
yaw at each of its four stages."""


class RefitConfig(NamedTuple):
    """What the refit is given."""

    weights: Any  # (6,) 1 / variance of the errors of x, y (m), psi (rad), u, v (m/s), r (rad/s)
    offset_weights: Any  # (3,) 1 / variance of the initial offset of u, v, r
    steps: int  # grid steps of a segment
    every: int  # grid steps between samples
    scale: float  # see the head of prediction_error
    knee: float
    capacity: int  # segments in the window
    period: float  # time between refits, s
    relinearised: int  # segments that a refit relinearises
    spacing: int  # rows between starts of segments
    span: int  # rows of the window
    joint: int  # what the parameters of the joint filter are: NONE or FIRST
    prior: Any  # (p,) prior mean of the parameters
    variance: Any  # (p,) their prior variances
    information: Any  # (h,) inverse of the prior covariance, packed
    shares: Any  # (2, p, p) see ``twin.model.thrust_share``


@inlined
def refit_config(values, p):
    """Open the configuration of a refit of p parameters."""
    weights, at = take(values, 0, (N_STATES,))
    offsets, at = take(values, at, (N_OFFSETS,))
    one, at = take(values, at, (4,))
    two, at = take(values, at, (6,))
    prior, at = take(values, at, (p,))
    variance, at = take(values, at, (p,))
    information, at = take(values, at, (packed_size(p),))
    shares, at = take(values, at, (SIDES, p, p))
    return RefitConfig(
        weights, offsets, int(one[0]), int(one[1]), one[2], one[3],
        int(two[0]), two[1], int(two[2]), int(two[3]), int(two[4]), int(two[5]),
        prior, variance, information, shares,
    )  # fmt: skip


class LineariseWork(NamedTuple):
    """Scratch of :func:`linearise`; m = p + 4 columns: parameters, error of a sample, offset."""

    terms: Any  # (4, N_TERMS) terms at the four stages of a step
    slopes: Any  # (4, N_TERMS) their derivatives by u, v, r, psi
    by_term: Any  # (N_TERMS, 3) parameters, gathered by terms
    s: Any  # (6,) state
    stage: Any  # (6,) state at a stage
    rate: Any  # (6,) its derivative
    sums: Any  # (6,) weighted sum of the four
    A: Any  # (4, 6, 6) derivatives of the rates by the state
    W: Any  # (6, 6) derivative of the step by a stage's rates
    D: Any  # (6, 6) derivative of the step by a stage's state
    T: Any  # (6, 18) derivatives of the step
    S: Any  # (18, m) sensitivities, then terms
    full: Any  # (m, m) the quadratic with offset
    J: Any  # (6, m) sensitivities of a sample


@inlined
def linearise_work(work, p):
    """Open the scratch of :func:`linearise`."""
    m = p + 1 + N_OFFSETS
    terms, at = take(work, 0, (4, N_TERMS))
    slopes, at = take(work, at, (4, N_TERMS))
    by_term, at = take(work, at, (N_TERMS, 3))
    s, at = take(work, at, (N_STATES,))
    stage, at = take(work, at, (N_STATES,))
    rate, at = take(work, at, (N_STATES,))
    sums, at = take(work, at, (N_STATES,))
    A, at = take(work, at, (4, N_STATES, N_STATES))
    W, at = take(work, at, (N_STATES, N_STATES))
    D, at = take(work, at, (N_STATES, N_STATES))
    T, at = take(work, at, (N_STATES, _ROWS))
    S, at = take(work, at, (_ROWS, m))
    full, at = take(work, at, (m, m))
    J, at = take(work, at, (N_STATES, m))
    return LineariseWork(terms, slopes, by_term, s, stage, rate, sums, A, W, D, T, S, full, J)


@kernel
def drive(act, terms):
    """Write the terms of the actuators."""
    c_left, s_left = math.cos(act[2]), math.sin(act[2])
    thrust_terms(act[0], act[1], c_left, s_left, math.cos(act[3]), math.sin(act[3]), terms)


@inlined
def _stage(number, wind, xi, model, work, linear):
    """Write the rates of the state at a stage and, where asked, their derivatives by it."""
    s, k, terms = work.stage, work.rate, work.terms[number]
    c, n = math.cos(s[PSI]), math.sin(s[PSI])
    u, v, r = s[U], s[V], s[R]
    current = current_of(xi, 0, model.hull)
    k[X], k[Y], k[PSI] = u * c - v * n, u * n + v * c, r
    k[U], k[V], k[R] = rates_over_ground((u, v, r, c, n), wind, current, xi, 0, model, terms)
    if not linear:
        return
    A, slopes, by_term = work.A[number], work.slopes, work.by_term
    (u, v), over, (ahead, aside) = through_water((u, v), (c, n), wind, current)
    term_slopes((u, v, r), (c, n), over, model.hull, terms, slopes)
    A[X, PSI], A[X, U], A[X, V] = -k[Y], c, -n
    A[Y, PSI], A[Y, U], A[Y, V] = k[X], n, c
    A[PSI, R] = 1.0
    _add_slopes(BY_PSI, slopes[3], by_term, A, 2)
    _add_slopes(BY_U, slopes[0], by_term, A, 3)
    _add_slopes(BY_V, slopes[1], by_term, A, 4)
    _add_slopes(BY_R, slopes[2], by_term, A, 5)
    if model.hull[CURRENT] >= 0.0:
        _add_current_slopes((c, n), r, (ahead, aside), slopes, by_term, A, terms)


@inlined
def _add_current_slopes(heading, r, current, slopes, by_term, A, terms):
    """Add what the current changes in the slopes, and write those by the current itself."""
    c, s = heading
    ahead, aside = current
    for i in range(3):
        by_u, by_v = A[3 + i, U], A[3 + i, V]
        A[3 + i, PSI] += by_v * ahead - by_u * aside
        for k in range(WIND_X, WIND_N + 1):  # wind acts on the velocity over the ground
            by_u -= by_term[k, i] * slopes[0, k]
            by_v -= by_term[k, i] * slopes[1, k]
        terms[BY_CURRENT + 2 * i] = by_v * s - by_u * c
        terms[BY_CURRENT + 2 * i + 1] = -by_u * s - by_v * c
    # an even current turns with the boat
    A[U, PSI] -= r * ahead
    A[V, PSI] -= r * aside
    A[U, R] += aside
    A[V, R] -= ahead
    terms[BY_CURRENT] -= r * s
    terms[BY_CURRENT + 1] += r * c
    terms[BY_CURRENT + 2] -= r * c
    terms[BY_CURRENT + 3] -= r * s


@kernel
def _add_slopes(some, slopes, by_term, A, j):
    """Write how the accelerations change with one state, of which some terms are functions."""
    surge, sway, yaw = 0.0, 0.0, 0.0
    for k in range(some.shape[0]):
        t = some[k]
        surge += by_term[t, 0] * slopes[t]
        sway += by_term[t, 1] * slopes[t]
        yaw += by_term[t, 2] * slopes[t]
    A[U, j], A[V, j], A[R, j] = surge, sway, yaw


@inlined
def rk4_step(row, after, wind, xi, model, work, linear):
    """Advance the state over a row of the window; return whether it stays within bounds.

    ``work.terms[3]`` holds the actuators of the row; with ``linear``, the derivatives of the four
    stages are written as well.
    """
    s, stage, sums, terms = work.s, work.stage, work.sums, work.terms
    for j in range(LEFT_COS, N_TERMS):
        terms[0, j] = terms[3, j] if j < BY_CURRENT else 0.0
    drive(row[MIDDLE:], terms[1])
    for j in range(LEFT_COS, N_TERMS):
        terms[2, j] = terms[1, j]
    drive(after[ACT:MIDDLE], terms[3])
    for i in range(N_STATES):
        stage[i], sums[i] = s[i], 0.0
    for number in range(4):
        _stage(number, wind, xi, model, work, linear)
        share = 2.0 if number == 1 or number == 2 else 1.0
        h = GRID if number == 2 else 0.5 * GRID
        for i in range(N_STATES):
            sums[i] += share * work.rate[i]
            stage[i] = s[i] + h * work.rate[i]
    for i in range(N_STATES):
        s[i] += GRID / 6.0 * sums[i]
    return abs(s[U]) < 1e3 and abs(s[V]) < 1e3 and abs(s[R]) < 1e2


@kernel
def step_jacobian(A, W, D, T):
    """Write the derivatives of the state after a step, by the step differentiated backwards."""
    T[:] = 0.0
    W[:] = 0.0
    for i in range(N_STATES):
        W[i, i] = GRID / 6.0
    for stage in range(3, -1, -1):
        reach = GRID if stage == 3 else 0.5 * GRID
        for i in range(N_STATES):
            for j in range(2, N_STATES):  # nothing depends on the position
                total = W[i, i] * A[stage, i, j] if i < 2 else 0.0
                for q in range(2, N_STATES):
                    total += W[i, q] * A[stage, q, j]
                D[i, j] = total
                T[i, j] += total
            for e in range(3):
                T[i, N_STATES + 4 * e + stage] = W[i, 3 + e]
        for i in range(N_STATES):
            for j in range(2, N_STATES):
                W[i, j] = reach * D[i, j]
            share = 1.0 if stage == 1 else 2.0
            W[i, i] = share * GRID / 6.0 + reach * D[i, i]


@kernel
def propagate_sensitivities(T, limits, S, J):
    """Carry the sensitivities through a step; they are left in S and J."""
    psi, u, v, r = S[2], S[3], S[4], S[5]
    for i in range(N_STATES):
        a, b, c, d, before, to = T[i, 2], T[i, 3], T[i, 4], T[i, 5], S[i], J[i]
        for k in range(to.shape[0]):
            to[k] = fma(d, r[k], fma(c, v[k], fma(b, u[k], fma(a, psi[k], before[k]))))
        for e in range(3):
            j, low, high = (
                N_STATES + 4 * e,
                limits[3 + e, 0] - N_STATES,
                limits[3 + e, 1] - N_STATES,
            )
            a, b, c, d, some = T[i, j], T[i, j + 1], T[i, j + 2], T[i, j + 3], J[i, low:high]
            A, B = S[j, low:high], S[j + 1, low:high]
            C, D = S[j + 2, low:high], S[j + 3, low:high]
            for k in range(some.shape[0]):
                some[k] = fma(d, D[k], fma(c, C[k], fma(b, B[k], fma(a, A[k], some[k]))))
    for i in range(N_STATES):
        for k in range(J.shape[1]):
            S[i, k] = J[i, k]


@kernel
def linearise(first, rows, xi, model, config, work, H, b):
    """Roll the model out from row ``first`` of a window; write the quadratic that its errors make.

    After it, sum of squared weighted errors, minimised over the initial offset, is about
    ``c - 2 b . (x - xi) + (x - xi)' H (x - xi)`` for parameters x near xi (p,). Returned is c;
    infinite where the motion leaves all bounds, and nothing is written then. Rows (M, 20) wrap
    around at the end of the array.

    Source: sensitivities by differentiating the Runge-Kutta scheme itself, so that they are
    those of the motion as computed.
    """
    which, limits = model.which, model.limits
    size, p = rows.shape[0], xi.shape[0]
    m = p + 1 + N_OFFSETS
    terms, by_term, s, S, full, J = work.terms, work.by_term, work.s, work.S, work.full, work.J
    start = rows[first % size]
    wind = start[WIND:GOOD]
    by_term[:] = 0.0
    for e in range(3):
        for q in range(limits[3 + e, 0] - N_STATES, limits[3 + e, 1] - N_STATES):
            by_term[which[e, q], e] += xi[q]
    S[:] = 0.0
    full[:] = 0.0
    for i in range(N_STATES):
        s[i] = start[i]
    for i in range(N_OFFSETS):
        S[3 + i, p + 1 + i] = 1.0
        full[p + 1 + i, p + 1 + i] = config.offset_weights[i]
    drive(start[ACT:MIDDLE], terms[3])
    for step in range(config.steps):
        row, after = rows[(first + step) % size], rows[(first + step + 1) % size]
        bounded = rk4_step(row, after, wind, xi, model, work, True)
        for number in range(4):
            for e in range(3):
                for q in range(limits[3 + e, 0] - N_STATES, limits[3 + e, 1] - N_STATES):
                    S[N_STATES + 4 * e + number, q] = terms[number, which[e, q]]
        step_jacobian(work.A, work.W, work.D, work.T)
        propagate_sensitivities(work.T, limits, S, J)
        if not bounded:
            return math.inf
        if (step + 1) % config.every == 0:
            for i in range(N_STATES):
                root = math.sqrt(config.weights[i])
                J[i, p] = after[i] - s[i]
                for j in range(m):
                    J[i, j] *= root
            add_square(full, J)
    # remove the offset: its block is small and positive definite
    for q in range(m - 1, p, -1):
        for a in range(q):
            factor = full[a, q] / full[q, q]
            for j in range(a, q):
                full[a, j] -= factor * full[j, q]
    for a in range(p):
        b[a] = full[a, p]
        for j in range(a, p):
            H[a, j] = full[a, j]
            H[j, a] = full[a, j]
    return max(full[p, p], 0.0)
