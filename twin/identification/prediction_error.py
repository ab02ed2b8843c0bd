"""Multi-step prediction-error refit: the parameters with which the model would have foretold best.

A window of navigation states on an even grid is cut into *segments*: every ``spacing`` seconds
one begins, and from there the model is rolled out over ``horizon`` seconds under the actuators
as they were. The parameters are those that make the errors of all segments small,

    sum over segments of  n_i rho(q_i)  +  (xi - xi_0)' P_0^-1 (xi - xi_0),
    q_i = scale / n_i * min over d of [ sum of (errors / sd)^2 + (d / sd_d)^2 ]

with n_i errors in segment i, a free offset d of the initial u, v, r (it carries a wave, and no
parameter should pay for it) and rho(q) = q up to ``knee``, and knee (1 + log(q / knee)) beyond: a
segment that a gust or a wave group has spoilt counts less, as if its weight were
min(1, knee / q). ``scale`` makes up for errors that are alike from sample to sample. A ``trust``
other than 1 multiplies what all the segments say, against the prior.

Each segment is kept as a quadratic in xi about the parameters at which it was linearised, with
the offset removed by its Schur complement, so that a refit costs a sum of small matrices.
Segments are linearised anew a few at a time, those first whose parameters have moved most.

Source: twin.md sections 6 and 10 B3; Levenberg 1944, Marquardt 1963.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.checkpoint import COUNT, Field
from twin.filters.linalg import add_square, cholesky, dot, invert, packed_size, solve_factored
from twin.model.structure import (
    BY_PSI,
    BY_R,
    BY_U,
    BY_V,
    LEFT_COS,
    N_STATES,
    N_TERMS,
    accelerations,
    state_terms,
    term_slopes,
    thrust_terms,
)
from usv_kernel.arrays import shaped
from usv_kernel.errors import UsvTwinError
from usv_kernel.jit import kernel, py_func
from usv_kernel.scalar import fma

__all__ = [
    "GRID",
    "RefitSettings",
    "Segments",
    "linearise",
    "room",
]

Array = NDArray[Any]

GRID = 0.25
"""Step of the window's rows and of the integration, s."""

N_OFFSETS = 3

# columns of a window's rows
STATE, LOW, WIND, GOOD, ACT, MIDDLE = 0, 6, 9, 11, 12, 16

COLUMNS = 20
"""Navigation state (6), low-frequency velocities (3), true wind (2), whether the row may be
fitted, actuators then (4) and half a step later (4)."""


SPAN_MAX = 3600.0
"""Longest window, s."""


class RefitError(UsvTwinError):
    """Settings of the refit that cannot be used; the message names the field."""


@dataclass(frozen=True)
class RefitSettings:
    """How the window is cut up and weighed; defaults for 6.3 m at 5.4 m/s, scaled by Froude.

    Parameters
    ----------
    span, spacing, horizon : float
        Length of the window, time between starts, length of a segment, s.
    every : int
        Grid steps between the samples that are compared.
    sd : ndarray, shape (6,)
        Standard deviations of the errors of x, y (m), psi (rad), u, v (m/s), r (rad/s): what
        waves make of a perfect forecast.
    offset_sd : ndarray, shape (3,)
        Standard deviations of the initial u, v (m/s) and r (rad/s).
    scale, knee : float
        See the head of this file.
    """

    span: float
    spacing: float
    horizon: float
    every: int
    sd: Array
    offset_sd: Array
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
        if not 1 <= self.every <= self.horizon / GRID or self.every != int(self.every):
            raise RefitError(f"every = {self.every} must be 1 to {self.horizon / GRID:g}, whole")


_SQUARE = N_STATES * N_STATES

_ROWS = N_STATES + 12
"""What sensitivities after a step are sums of: those before it, and the terms of surge, sway and
yaw at each of its four stages."""


def room(p: int, capacity: int = 0) -> Array:
    """Return the scratch of :func:`linearise` for p parameters, and of so many segments."""
    solving = 2 * packed_size(p) + packed_size(p) // 6 + 2 * p * p + 3 * p
    return np.zeros(roll_room(p) + solving + capacity)


@kernel
def roll_room(p):
    """Return the length of the scratch of :func:`linearise`."""
    m = p + 1 + N_OFFSETS
    small = 11 * N_TERMS + 4 * N_STATES + 6 * _SQUARE + _ROWS * N_STATES
    return small + (_ROWS + m + N_STATES) * m


@kernel
def drive(act, terms):
    """Write the terms of the actuators."""
    thrust_terms(
        *(act[0], act[1], math.cos(act[2]), math.sin(act[2]), math.cos(act[3]), math.sin(act[3])),
        terms,
    )


@kernel
def _stage(s, wind, xi, kit, by_term, terms, slopes, k, A):
    """Write the derivative k of the state, and A, the derivative of k by the state."""
    hull = kit[2]
    c, n = math.cos(s[2]), math.sin(s[2])
    u, v, r = s[3], s[4], s[5]
    state_terms(u, v, r, c, n, wind, hull, terms)
    term_slopes(u, v, r, c, n, wind, hull, terms, slopes)
    k[0], k[1], k[2] = u * c - v * n, u * n + v * c, r
    k[3], k[4], k[5] = accelerations(terms, kit, xi, 0)
    A[0, 2], A[0, 3], A[0, 4] = -k[1], c, -n
    A[1, 2], A[1, 3], A[1, 4] = k[0], n, c
    A[2, 5] = 1.0
    _add_slopes(BY_PSI, slopes[3], by_term, A, 2)
    _add_slopes(BY_U, slopes[0], by_term, A, 3)
    _add_slopes(BY_V, slopes[1], by_term, A, 4)
    _add_slopes(BY_R, slopes[2], by_term, A, 5)


@kernel
def _add_slopes(some, slopes, by_term, A, j):
    """Write how the accelerations change with one state, of which some terms are functions."""
    surge, sway, yaw = 0.0, 0.0, 0.0
    for k in range(some.shape[0]):
        t = some[k]
        surge += by_term[t, 0] * slopes[t]
        sway += by_term[t, 1] * slopes[t]
        yaw += by_term[t, 2] * slopes[t]
    A[3, j], A[4, j], A[5, j] = surge, sway, yaw


@kernel
def _carry(A, W, D, T):
    """Write what the state after a step owes to the state before it and to the terms.

    Source: the Runge-Kutta scheme differentiated backwards; W is what the state after the step
    gains by a stage's derivative.
    """
    T[:] = 0.0
    W[:] = 0.0
    for i in range(N_STATES):
        W[i, i] = GRID / 6.0
    for stage in range(3, -1, -1):
        reach = GRID if stage == 3 else 0.5 * GRID
        for i in range(N_STATES):
            for j in range(2, N_STATES):  # nothing depends on the place
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
def _grow(T, limits, S, J):
    """Carry the sensitivities through a step, with J for room; they are left in both."""
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
def linearise(first, steps, every, rows, xi, kit, weights, offset_weights, room, H, b):
    """Roll the model out from one row of a window, and write the quadratic that its errors make.

    After it, sum of squared weighted errors, minimised over the initial offset, is about
    ``c - 2 b . (x - xi) + (x - xi)' H (x - xi)`` for parameters x near xi.

    Parameters
    ----------
    first : int
        Row to start from; rows wrap around at the end of the array.
    steps, every : int
        Grid steps of the segment, and between samples.
    rows : (M, 20) array
        The window.
    xi : (p,) array
        Parameters.
    kit : tuple
        Of the structure.
    weights, offset_weights : (6,), (3,) arrays
        1 / variance of errors and of the initial offset.
    room : array
        From :func:`room`.
    H, b : (p, p), (p,) arrays
        Written.

    Returns
    -------
    float
        c; infinite where the motion leaves all bounds, and nothing is written then.

    Source: sensitivities by differentiating the Runge-Kutta scheme itself, so that they are
    those of the motion as computed.
    """
    which, limits, _ = kit
    size, p = rows.shape[0], xi.shape[0]
    # columns: parameters, then the error of a sample, then the offset
    m = p + 1 + N_OFFSETS
    terms = shaped(room, 0, (4, N_TERMS))
    slopes = shaped(room, 4 * N_TERMS, (4, N_TERMS))
    by_term = shaped(room, 8 * N_TERMS, (N_TERMS, 3))
    rest = room[11 * N_TERMS :]
    s, place, k, sums = rest[:6], rest[6:12], rest[12:18], rest[18:24]
    rest = rest[24:]
    A = shaped(rest, 0, (4, N_STATES, N_STATES))
    W = shaped(rest, 4 * _SQUARE, (N_STATES, N_STATES))
    D = shaped(rest, 5 * _SQUARE, (N_STATES, N_STATES))
    rest = rest[6 * _SQUARE :]
    T = shaped(rest, 0, (N_STATES, _ROWS))
    rest = rest[_ROWS * N_STATES :]
    S = shaped(rest, 0, (_ROWS, m))  # sensitivities, then terms
    full = shaped(rest, _ROWS * m, (m, m))
    J = shaped(rest, (_ROWS + m) * m, (N_STATES, m))

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
        full[p + 1 + i, p + 1 + i] = offset_weights[i]
    drive(start[ACT:MIDDLE], terms[3])
    for step in range(steps):
        after = rows[(first + step + 1) % size]
        for j in range(LEFT_COS, N_TERMS):
            terms[0, j] = terms[3, j]
        drive(rows[(first + step) % size, MIDDLE:], terms[1])
        for j in range(LEFT_COS, N_TERMS):
            terms[2, j] = terms[1, j]
        drive(after[ACT:MIDDLE], terms[3])
        for i in range(N_STATES):
            place[i], sums[i] = s[i], 0.0
        for stage in range(4):
            _stage(place, wind, xi, kit, by_term, terms[stage], slopes, k, A[stage])
            share = 2.0 if stage == 1 or stage == 2 else 1.0
            h = GRID if stage == 2 else 0.5 * GRID
            for i in range(N_STATES):
                sums[i] += share * k[i]
                place[i] = s[i] + h * k[i]
            for e in range(3):
                for q in range(limits[3 + e, 0] - N_STATES, limits[3 + e, 1] - N_STATES):
                    S[N_STATES + 4 * e + stage, q] = terms[stage, which[e, q]]
        _carry(A, W, D, T)
        for i in range(N_STATES):
            s[i] += GRID / 6.0 * sums[i]
        _grow(T, limits, S, J)
        if not (abs(s[3]) < 1e3 and abs(s[4]) < 1e3 and abs(s[5]) < 1e2):
            return math.inf
        if (step + 1) % every == 0:
            for i in range(N_STATES):
                root = math.sqrt(weights[i])
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


ITERATIONS = 4
"""Of the robust weights, in a refit."""

RULES = 16
"""Numbers before a prior in the rules of segments: weights of errors (6) and of offsets (3), steps
and every, scale and knee, then room."""

STEPS, EVERY, SCALE, KNEE = 9, 10, 11, 12


@kernel
def rules_of(rules, p):
    """Return prior mean, prior variances and packed information as views of the rules."""
    prior = rules[RULES:]
    return prior[:p], prior[p : 2 * p], prior[2 * p : 2 * p + packed_size(p)]


@kernel
def memory_size(p, capacity):
    """Return the length of the memory of segments."""
    return 1 + p + p * p + capacity * (2 + 2 * p + packed_size(p))


@kernel
def believed(memory, p):
    """Return parameters and covariance in use as views of the memory; before them is the trust."""
    return memory[1 : 1 + p], shaped(memory, 1 + p, (p, p))


@kernel
def quadratics(memory, p):
    """Return first rows, c, b, at and packed H of all segments as views of the memory.

    A segment's quadratic is ``c - 2 b . d + d' H d`` at parameters d off the prior's; ``at`` is
    where it was linearised. Its first row is -1 where there is none.
    """
    h = packed_size(p)
    rest = memory[1 + p + p * p :]
    n = rest.shape[0] // (2 + 2 * p + h)
    first, c, rest = rest[:n], rest[n : 2 * n], rest[2 * n :]
    b, at = shaped(rest, 0, (n, p)), shaped(rest, n * p, (n, p))
    return first, c, b, at, shaped(rest, 2 * n * p, (n, h))


@kernel
def _take(slot, first, rows, xi, memory, rules, kit, room):
    """Linearise a segment at parameters into a slot; return False where the motion is lost."""
    p = xi.shape[0]
    _, c, b, at, packed = quadratics(memory, p)
    prior = rules[RULES : RULES + p]
    rest = room[roll_room(p) :]
    H, pull, away = shaped(rest, 0, (p, p)), rest[p * p :][:p], rest[p * p + p :][:p]
    cost = linearise(
        *(first, int(rules[STEPS]), int(rules[EVERY]), rows, xi, kit),
        *(rules[:N_STATES], rules[N_STATES:STEPS], room, H, pull),
    )
    if not cost < math.inf:
        return False
    k = 0
    for i in range(p):
        away[i], at[slot, i] = xi[i] - prior[i], xi[i]
    # moved to the prior, which is the same for all
    for i in range(p):
        total = 0.0
        for j in range(p):
            total += H[i, j] * away[j]
        cost += away[i] * (2.0 * pull[i] + total)
        b[slot, i] = pull[i] + total
        for j in range(i, p):
            packed[slot, k] = H[i, j]
            k += 1
    c[slot] = cost
    return True


@kernel
def add(first, rows, xi, memory, rules, kit, room):
    """Take a new segment from row ``first`` on, in the place of the oldest."""
    firsts = quadratics(memory, xi.shape[0])[0]
    slot = 0
    for i in range(firsts.shape[0]):
        if firsts[i] < firsts[slot]:
            slot = i
    if _take(slot, first, rows, xi, memory, rules, kit, room):
        firsts[slot] = first


@kernel
def drop(before, memory, p):
    """Forget segments that begin before a row; return how many there are then."""
    first, count = quadratics(memory, p)[0], 0
    for i in range(first.shape[0]):
        if first[i] < before:
            first[i] = -1.0
        if first[i] >= 0.0:
            count += 1
    return count


@kernel
def renew(budget, rows, xi, memory, rules, kit, room):
    """Linearise anew at parameters, those segments first from which they have moved most."""
    p = xi.shape[0]
    first, _, _, at, _ = quadratics(memory, p)
    variance = rules_of(rules, p)[1]
    moved = room[room.shape[0] - first.shape[0] :]
    for i in range(first.shape[0]):
        moved[i] = -1.0
        if first[i] >= 0.0:
            moved[i] = 0.0
            for k in range(p):
                moved[i] += (xi[k] - at[i, k]) ** 2 / variance[k]
    for _ in range(min(budget, first.shape[0])):
        most = 0
        for i in range(first.shape[0]):
            if moved[i] > moved[most]:
                most = i
        if moved[most] < 0.0:
            return
        moved[most] = -1.0
        _take(most, int(first[most]), rows, xi, memory, rules, kit, room)


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
    """Return one segment's quadratic at parameters d off the prior's."""
    total = c + dot(H, square, lanes)
    for k in range(d.shape[0]):
        total -= 2.0 * b[k] * d[k]
    return max(total, 0.0)


@kernel
def _costs(xi, memory, rules, room, q):
    """Write q_i of each segment that there is."""
    p = xi.shape[0]
    first, c, b, _, H = quadratics(memory, p)
    _, square, lanes, _, _, d, _ = _solving(room, p)
    for k in range(p):
        d[k] = xi[k] - rules[RULES + k]
    _square(d, square)
    factor = rules[SCALE] / _samples(rules)
    for i in range(first.shape[0]):
        if first[i] >= 0.0:
            q[i] = factor * _cost(H[i], b[i], c[i], d, square, lanes)


@kernel
def _samples(rules):
    return N_STATES * (int(rules[STEPS]) // int(rules[EVERY]))


@kernel
def _solving(room, p):
    """Return total, products, lanes, factor, work, parameters and right side for a solution."""
    h, square = packed_size(p), p * p
    room = room[roll_room(p) :]
    rest = room[2 * h + h // 6 :]
    return (
        room[:h],
        room[h : 2 * h],
        room[2 * h : 2 * h + h // 6],
        shaped(rest, 0, (p, p)),
        shaped(rest, square, (p + 1, p)),
        rest[2 * square + p : 2 * square + 2 * p],
        rest[2 * square + 2 * p : 2 * square + 3 * p],
    )


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
def solve(xi, trust, iterations, damping, memory, rules, room):
    """Move parameters to the least that the weighed quadratics and the prior make.

    Parameters
    ----------
    xi : (p,) array
        Where to begin; the result.
    trust : float
        Factor of what the segments say.
    iterations : int
        Of the robust weights.
    damping : float
        Of Levenberg and Marquardt, in units of the prior's information.
    memory, rules, room : array
        Of the segments.

    Returns
    -------
    bool
        False where rounding has left no definite matrix; else its factor is the fourth of
        ``_solving(room)``.
    """
    p = xi.shape[0]
    first, c, b, _, H = quadratics(memory, p)
    prior, _, information = rules_of(rules, p)
    total, square, lanes, U, work, d, pull = _solving(room, p)
    scale, knee, samples = rules[SCALE], rules[KNEE], _samples(rules)
    start = work[1]
    for k in range(p):
        d[k] = start[k] = xi[k] - prior[k]
    square[:] = 0.0
    for _ in range(iterations):
        _square(d, square)
        for k in range(total.shape[0]):
            total[k] = information[k]
        pull[:] = 0.0
        if damping > 0.0:
            for k in range(total.shape[0]):
                total[k] *= 1.0 + damping
            _unpack(information, U)
            for i in range(p):
                for j in range(p):
                    pull[i] += damping * U[min(i, j), max(i, j)] * start[j]
        for i in range(first.shape[0]):
            if first[i] < 0.0:
                continue
            q = scale / samples * _cost(H[i], b[i], c[i], d, square, lanes)
            weight = trust * scale * (1.0 if q <= knee else knee / q)
            own, tug = H[i], b[i]
            for k in range(total.shape[0]):
                total[k] = fma(weight, own[k], total[k])
            for k in range(p):
                pull[k] += weight * tug[k]
        _unpack(total, U)
        if cholesky(U, U, work) > 0:
            return False  # The prior alone is definite: this is rounding.
        solve_factored(U, pull, d)
        for k in range(p):
            xi[k] = prior[k] + d[k]
    return True


@kernel
def keep_factor(room, p, out):
    """Write the factor (p, p) of the last solution, which the room holds."""
    U = _solving(room, p)[3]
    for i in range(p):
        for k in range(p):
            out[i, k] = U[i, k] if k >= i else 0.0  # below, the room holds anything


@kernel
def use(xi, factor, trust, memory, room):
    """Put parameters to use, and the covariance that belongs to a factor: 0 where it has none."""
    p = xi.shape[0]
    own, cov = believed(memory, p)
    memory[0] = trust
    for k in range(p):
        own[k] = xi[k]
    if factor[0, 0] > 0.0:
        invert(factor, cov, _solving(room, p)[4])


SEGMENT_FIELDS = {
    "trust": Field(low=0.0),
    "covariance": Field(covariance=True),
    "first_row": Field(low=-1.0, high=COUNT.high, integer=True),
}
"""What the fields of :meth:`Segments.views` may hold."""


class Segments:
    """The segments of a window as quadratics, and the parameters that suit them best.

    Parameters
    ----------
    kit : tuple
        Of the structure.
    mean, cov : ndarray, shapes (p,), (p, p)
        Prior of the parameters.
    settings : RefitSettings
        How errors are weighed.
    capacity : int
        Largest number of segments; the oldest makes room.
    memory : ndarray, optional
        Flat array of :func:`memory_size` to remember in.

    Attributes
    ----------
    xi, cov : ndarray, shapes (p,), (p, p)
        Parameters and their covariance (Laplace), views; the prior's at first.
    b, c, at, packed : ndarray, shapes (n, p), (n,), (n, p), (n, h)
        The quadratics, views: see :func:`quadratics`.
    """

    def __init__(
        self,
        kit: Any,
        mean: Array,
        cov: Array,
        settings: RefitSettings,
        capacity: int,
        memory: Array | None = None,
    ) -> None:
        p = len(mean)
        self.kit, self.settings = kit, settings
        self.prior, self.prior_cov = np.array(mean), np.array(cov)
        self.information = np.linalg.inv(cov)
        self.information = 0.5 * (self.information + self.information.T)
        self.steps = round(settings.horizon / GRID)
        self.samples = N_STATES * (self.steps // settings.every)
        packed = np.zeros(packed_size(p))
        packed[: p * (p + 1) // 2] = self.information[np.triu_indices(p)]
        how = (self.steps, settings.every, settings.scale, settings.knee, 0.0, 0.0, 0.0)
        self.rules = np.concatenate(
            [
                *(settings.sd**-2.0, settings.offset_sd**-2.0, how),
                *(self.prior, np.diag(self.prior_cov), packed),
            ]
        )
        self.memory = np.zeros(memory_size(p, capacity)) if memory is None else memory
        self.params, self.cov = py_func(believed)(self.memory, p)
        self._first, self.c, self.b, self.at, self.packed = py_func(quadratics)(self.memory, p)
        self.room = room(p, capacity)
        self.reset()

    def reset(self) -> None:
        """Forget every segment."""
        self.memory[:] = 0.0
        self._first[:] = -1.0
        self.params[:], self.cov[:] = self.prior, self.prior_cov
        self.trust = 1.0

    def views(self) -> dict[str, Array]:
        """Return what is remembered as fields by name, which are views."""
        return {
            **{"trust": self.memory[:1], "parameters": self.params, "covariance": self.cov},
            **{"first_row": self._first, "cost": self.c, "gradient": self.b},
            **{"linearised_at": self.at, "curvature": self.packed},
        }

    @property
    def trust(self) -> float:
        """How many times more the segments count than ``scale`` and ``knee`` say."""
        return float(self.memory[0])

    @trust.setter
    def trust(self, value: float) -> None:
        self.memory[0] = value

    @property
    def first(self) -> Array:
        """First row of each segment (n,); -1 where there is none."""
        return self._first.astype(int)

    @property
    def H(self) -> Array:
        """Curvatures (n, p, p)."""
        p = len(self.prior)
        i, j = np.triu_indices(p)
        full = np.zeros((len(self.c), p, p))
        full[:, i, j] = full[:, j, i] = self.packed[:, : len(i)]
        return full

    @property
    def _tools(self) -> tuple[Any, ...]:
        return self.memory, self.rules, self.kit, self.room

    def add(self, first: int, rows: Array, xi: Array) -> None:
        """Take a new segment from row ``first`` on, in the place of the oldest."""
        add(first, rows, xi, *self._tools)

    def drop(self, before: int) -> None:
        """Forget segments that begin before a row."""
        drop(before, self.memory, len(self.prior))

    def renew(self, rows: Array, budget: int) -> None:
        """Linearise anew at the present parameters, those that moved most first."""
        renew(budget, rows, self.params, *self._tools)

    def costs(self, xi: Array) -> Array:
        """Return q_i at parameters, by the quadratics; 0 where there is no segment."""
        q = np.zeros(len(self.c))
        _costs(xi, self.memory, self.rules, self.room, q)
        return q

    def objective(self, xi: Array) -> float:
        """Return what :meth:`solve` makes small, by the quadratics."""
        q = self.costs(xi)
        knee, away = self.settings.knee, xi - self.prior
        rho = np.where(q <= knee, q, knee * (1.0 + np.log(np.maximum(q, knee) / knee)))
        return float(self.trust * self.samples * rho.sum() + away @ self.information @ away)

    def solve(self, iterations: int = ITERATIONS, damping: float = 0.0) -> None:
        """Move the parameters to the least of the sum of the quadratics and the prior.

        Parameters
        ----------
        iterations : int
            Of the robust weights.
        damping : float
            Of Levenberg and Marquardt, in units of the prior's information.
        """
        how = (self.trust, iterations, damping, self.memory, self.rules, self.room)
        # a damped step says nothing of how sure the least is
        if solve(self.params, *how) and damping == 0.0:
            factor = py_func(_solving)(self.room, len(self.params))[3]
            use(self.params, factor, self.trust, self.memory, self.room)

    def fit(self, rows: Array, *, iterations: int = 30, tolerance: float = 1e-9) -> bool:
        """Iterate to the least of the true objective: Levenberg-Marquardt over all segments.

        Parameters
        ----------
        rows : ndarray, shape (M, 20)
            The window.
        iterations : int
            At most.
        tolerance : float
            It has converged where the objective falls by less than this part of itself.

        Returns
        -------
        bool
            Whether it converged.
        """
        many, damping = len(self.first), 0.0
        self.renew(rows, many)
        best = self.objective(self.params)
        for _ in range(iterations):
            kept = self.memory.copy()
            self.solve(1, damping)
            self.renew(rows, many)
            reached = bool((self.at[self.first >= 0] == self.params).all())
            now = self.objective(self.params) if reached else math.inf
            if now <= best:
                done = best - now <= tolerance * best
                best, damping = now, 0.25 * damping if damping > 1e-6 else 0.0
                if done:
                    self.solve(1)
                    return True
            else:
                # the covariance was that of the point to which this returns
                py_func(believed)(kept, len(self.prior))[1][:] = self.cov
                self.memory[:] = kept
                damping = max(4.0 * damping, 1e-2)
                if damping > 1e8:
                    return True
        return False
