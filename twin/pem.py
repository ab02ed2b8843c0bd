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

from twin.dense import add_product, add_rows, cholesky, invert, solve_factored
from twin.structure import (
    LEFT_COS,
    N_STATES,
    N_TERMS,
    accelerations,
    state_terms,
    term_slopes,
    thrust_terms,
)
from usv_kernel import kernel

__all__ = ["GRID", "RefitSettings", "Segments", "linearise", "room"]

Array = NDArray[Any]

GRID = 0.25
"""Step of the window's rows and of the integration, s."""
N_OFFSETS = 3
# columns of a window's rows
STATE, LOW, WIND, GOOD, ACT, MIDDLE = 0, 6, 9, 11, 12, 16
COLUMNS = 20
"""Navigation state (6), low-frequency velocities (3), true wind (2), whether the row may be
fitted, actuators then (4) and half a step later (4)."""


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


def room(p: int) -> Array:
    """Return the scratch of :func:`linearise` for p parameters."""
    m = p + 1 + N_OFFSETS
    small = 8 * N_TERMS + 4 * N_STATES + 6 * _SQUARE + _ROWS * N_STATES
    return np.zeros(small + (_ROWS + m + N_STATES) * m)


_SQUARE = N_STATES * N_STATES
_ROWS = N_STATES + 12
"""What sensitivities after a step are sums of: those before it, and the terms of surge, sway and
yaw at each of its four stages."""


@kernel
def _drive(act, terms):
    """Write the terms of the actuators."""
    thrust_terms(
        *(act[0], act[1], math.cos(act[2]), math.sin(act[2]), math.cos(act[3]), math.sin(act[3])),
        terms,
    )


@kernel
def _stage(s, wind, xi, kit, terms, slopes, k, A):
    """Write the derivative k of the state, and A, the derivative of k by the state."""
    which, limits, hull = kit
    c, n = math.cos(s[2]), math.sin(s[2])
    u, v, r = s[3], s[4], s[5]
    state_terms(u, v, r, c, n, wind, hull, terms)
    term_slopes(u, v, r, c, n, wind, hull, terms, slopes)
    k[0], k[1], k[2] = u * c - v * n, u * n + v * c, r
    k[3], k[4], k[5] = accelerations(terms, kit, xi, 0)
    A[0, 2], A[0, 3], A[0, 4] = -k[1], c, -n
    A[1, 2], A[1, 3], A[1, 4] = k[0], n, c
    A[2, 5] = 1.0
    for i in range(3):
        by_u, by_v, by_r, by_psi = 0.0, 0.0, 0.0, 0.0
        for q in range(limits[3 + i, 0] - N_STATES, limits[3 + i, 1] - N_STATES):
            t = which[i, q]
            by_u += xi[q] * slopes[0, t]
            by_v += xi[q] * slopes[1, t]
            by_r += xi[q] * slopes[2, t]
            by_psi += xi[q] * slopes[3, t]
        A[3 + i, 2], A[3 + i, 3], A[3 + i, 4], A[3 + i, 5] = by_psi, by_u, by_v, by_r


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
                D[i, j] = 0.0
                for q in range(N_STATES):
                    D[i, j] += W[i, q] * A[stage, q, j]
                T[i, j] += D[i, j]
            for e in range(3):
                T[i, N_STATES + 4 * e + stage] = W[i, 3 + e]
        for i in range(N_STATES):
            for j in range(2, N_STATES):
                W[i, j] = reach * D[i, j]
            share = 1.0 if stage == 1 else 2.0
            W[i, i] = share * GRID / 6.0 + reach * D[i, i]


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
    terms = room[: 4 * N_TERMS].reshape((4, N_TERMS))
    slopes = room[4 * N_TERMS : 8 * N_TERMS].reshape((4, N_TERMS))
    rest = room[8 * N_TERMS :]
    s, place, k, sums = rest[:6], rest[6:12], rest[12:18], rest[18:24]
    rest = rest[24:]
    A = rest[: 4 * _SQUARE].reshape((4, N_STATES, N_STATES))
    W = rest[4 * _SQUARE : 5 * _SQUARE].reshape((N_STATES, N_STATES))
    D = rest[5 * _SQUARE : 6 * _SQUARE].reshape((N_STATES, N_STATES))
    rest = rest[6 * _SQUARE :]
    T = rest[: _ROWS * N_STATES].reshape((N_STATES, _ROWS))
    rest = rest[_ROWS * N_STATES :]
    S = rest[: _ROWS * m].reshape((_ROWS, m))  # sensitivities, then terms
    full = rest[_ROWS * m : (_ROWS + m) * m].reshape((m, m))
    J = rest[(_ROWS + m) * m :].reshape((N_STATES, m))

    start = rows[first % size]
    wind = start[WIND:GOOD]
    S[:] = 0.0
    full[:] = 0.0
    for i in range(N_STATES):
        s[i] = start[i]
    for i in range(N_OFFSETS):
        S[3 + i, p + 1 + i] = 1.0
        full[p + 1 + i, p + 1 + i] = offset_weights[i]
    _drive(start[ACT:MIDDLE], terms[3])
    for step in range(steps):
        after = rows[(first + step + 1) % size]
        for j in range(LEFT_COS, N_TERMS):
            terms[0, j] = terms[3, j]
        _drive(rows[(first + step) % size, MIDDLE:], terms[1])
        for j in range(LEFT_COS, N_TERMS):
            terms[2, j] = terms[1, j]
        _drive(after[ACT:MIDDLE], terms[3])
        for i in range(N_STATES):
            place[i], sums[i] = s[i], 0.0
        for stage in range(4):
            _stage(place, wind, xi, kit, terms[stage], slopes, k, A[stage])
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
            for j in range(m):
                J[i, j] = S[i, j]
            add_rows(J, i, 0, m, T, i, S, 2, _ROWS)
        for i in range(N_STATES):
            for j in range(m):
                S[i, j] = J[i, j]
        if not (abs(s[3]) < 1e3 and abs(s[4]) < 1e3 and abs(s[5]) < 1e2):
            return math.inf
        if (step + 1) % every == 0:
            for i in range(N_STATES):
                root = math.sqrt(weights[i])
                J[i, p] = after[i] - s[i]
                for j in range(m):
                    J[i, j] *= root
            add_product(full, J, J, m, 0, m, 0, N_STATES, 1.0)
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


@kernel
def _cost(xi, H, b, c, at, pair):
    """Return one segment's quadratic at parameters; ``pair`` becomes xi - at and H (xi - at)."""
    p = xi.shape[0]
    for k in range(p):
        pair[0, k], pair[1, k] = xi[k] - at[k], 0.0
    add_rows(pair, 1, 0, p, pair, 0, H, 0, p)
    total = c
    for k in range(p):
        total += pair[0, k] * (pair[1, k] - 2.0 * b[k])
    return max(total, 0.0)


@kernel
def _costs(xi, first, H, b, c, at, factor, pair, q):
    """Write factor times the quadratic of each segment that there is."""
    for i in range(first.shape[0]):
        if first[i] >= 0:
            q[i] = factor * _cost(xi, H[i], b[i], c[i], at[i], pair)


@kernel
def _solve(
    xi,
    cov,
    first,
    H,
    b,
    c,
    at,
    prior,
    information,
    scale,
    knee,
    trust,
    samples,
    iterations,
    damping,
    work,
):
    """Write the parameters and the covariance that the weighed quadratics and the prior make."""
    p = xi.shape[0]
    A, L = work[:p], work[p : 2 * p]
    pull, start, pair = work[2 * p], work[2 * p + 1], work[2 * p + 2 :]
    for k in range(p):
        start[k] = xi[k]
    for _ in range(iterations):
        for k in range(p):
            pull[k] = 0.0
            for j in range(p):
                away = prior[j] - xi[j] + damping * (start[j] - xi[j])
                A[k, j] = (1.0 + damping) * information[k, j]
                pull[k] += information[k, j] * away
        for i in range(first.shape[0]):
            if first[i] < 0:
                continue
            q = scale / samples * _cost(xi, H[i], b[i], c[i], at[i], pair)
            weight = trust * scale * (1.0 if q <= knee else knee / q)
            for k in range(p):
                pull[k] += weight * (b[i, k] - pair[1, k])
                total, own = A[k], H[i, k]
                for j in range(total.shape[0]):
                    total[j] += weight * own[j]
        if cholesky(A, L) > 0:
            return  # The prior alone is definite: this is rounding, and the next window's matter.
        solve_factored(L, pull, pull)
        for k in range(p):
            xi[k] += pull[k]
    if damping == 0.0:  # else it would be that of the step, not of the least
        invert(L, cov)


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

    Attributes
    ----------
    xi, cov : ndarray, shapes (p,), (p, p)
        Parameters and their covariance (Laplace); the prior's at first.
    trust : float
        How many times more the segments count than ``scale`` and ``knee`` say.
    """

    def __init__(
        self, kit: Any, mean: Array, cov: Array, settings: RefitSettings, capacity: int
    ) -> None:
        p = len(mean)
        self.kit, self.settings = kit, settings
        self.prior, self.prior_cov = np.array(mean), np.array(cov)
        self.information = np.linalg.inv(cov)
        self.weights, self.offset_weights = settings.sd**-2.0, settings.offset_sd**-2.0
        self.steps = round(settings.horizon / GRID)
        self.samples = N_STATES * (self.steps // settings.every)
        self.H = np.zeros((capacity, p, p))
        self.b, self.at = np.zeros((capacity, p)), np.zeros((capacity, p))
        self.c = np.zeros(capacity)
        self.first = np.full(capacity, -1)
        self._room, self._work = room(p), np.zeros((2 * p + 4, p))
        self._pair = np.zeros((2, p))
        self.reset()

    @property
    def _quadratics(self) -> tuple[Array, Array, Array, Array, Array]:
        return self.first, self.H, self.b, self.c, self.at

    def reset(self) -> None:
        """Forget every segment."""
        self.first[:] = -1
        self.xi, self.cov = self.prior.copy(), self.prior_cov.copy()
        self.trust = 1.0
        self._H, self._b = np.zeros_like(self.prior_cov), np.zeros_like(self.prior)

    def add(self, first: int, rows: Array, xi: Array) -> None:
        """Take a new segment from row ``first`` on, in the place of the oldest."""
        slot = int(np.argmin(self.first))
        if self._linearise(slot, first, rows, xi):
            self.first[slot] = first

    def drop(self, before: int) -> None:
        """Forget segments that begin before a row."""
        self.first[self.first < before] = -1

    def _linearise(self, slot: int, first: int, rows: Array, xi: Array) -> bool:
        c = linearise(
            *(first, self.steps, self.settings.every, rows, xi, self.kit),
            *(self.weights, self.offset_weights, self._room, self._H, self._b),
        )
        if not math.isfinite(c):
            return False
        self.H[slot], self.b[slot], self.c[slot], self.at[slot] = self._H, self._b, c, xi
        return True

    def renew(self, rows: Array, budget: int) -> None:
        """Linearise anew at the present parameters, those that moved most first."""
        used = np.flatnonzero(self.first >= 0)
        step = (self.xi - self.at[used]) / np.sqrt(np.diag(self.prior_cov))
        moved = np.einsum("ij,ij->i", step, step)
        for slot in used[np.argsort(-moved, kind="stable")[:budget]]:
            self._linearise(slot, int(self.first[slot]), rows, self.xi)

    def costs(self, xi: Array) -> Array:
        """Return q_i at parameters, by the quadratics; 0 where there is no segment."""
        q = np.zeros(len(self.first))
        _costs(xi, *self._quadratics, self.settings.scale / self.samples, self._pair, q)
        return q

    def objective(self, xi: Array) -> float:
        """Return what :meth:`solve` makes small, by the quadratics."""
        q = self.costs(xi)
        knee, away = self.settings.knee, xi - self.prior
        rho = np.where(q <= knee, q, knee * (1.0 + np.log(np.maximum(q, knee) / knee)))
        return float(self.trust * self.samples * rho.sum() + away @ self.information @ away)

    def solve(self, iterations: int = 4, damping: float = 0.0) -> None:
        """Move the parameters to the least of the sum of the quadratics and the prior.

        Parameters
        ----------
        iterations : int
            Of the robust weights.
        damping : float
            Of Levenberg and Marquardt, in units of the prior's information.
        """
        settings = self.settings
        _solve(
            *(self.xi, self.cov, *self._quadratics, self.prior, self.information),
            *(settings.scale, settings.knee, self.trust, self.samples),
            *(iterations, damping, self._work),
        )

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
        best = self.objective(self.xi)
        for _ in range(iterations):
            kept = self.xi.copy(), self.H.copy(), self.b.copy(), self.c.copy(), self.at.copy()
            self.solve(1, damping)
            self.renew(rows, many)
            reached = bool((self.at[self.first >= 0] == self.xi).all())
            now = self.objective(self.xi) if reached else math.inf
            if now <= best:
                done = best - now <= tolerance * best
                best, damping = now, 0.25 * damping if damping > 1e-6 else 0.0
                if done:
                    self.solve(1)
                    return True
            else:
                self.xi, self.H, self.b, self.c, self.at = kept
                damping = max(4.0 * damping, 1e-2)
                if damping > 1e8:
                    return True
        return False
