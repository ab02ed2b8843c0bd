"""Forecasts of DSW-UKF+: mean and spread from posterior draws."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.filters.linalg import cholesky
from twin.identification.joint_ukf import parts, scale_plan
from twin.identification.prediction_error import GRID, LOW, RULES
from twin.identification.wave_residual import (
    ORDER,
    SECTOR_SIZE,
    SECTORS,
    between,
    foretell_waves,
    simulate_waves,
)
from twin.model.dynamics import N_ACT
from twin.model.rollout import LOOK_AHEAD, ROOM, look_ahead, roll_out
from twin.model.structure import N_STATES
from twin.predictors.plus_update import (
    _HERE,
    _RULES,
    _SECTORS,
    _SEEN,
    _SLOW,
    _WAVE_SD,
    OBSERVER_GAIN,
    TRACK_SIZE,
    _all_good,
    _last_row,
)
from usv_kernel.arrays import shaped
from usv_kernel.jit import kernel

Array = NDArray[Any]

TOLD_GAIN = 0.25
"""The same for the waves foretold, 1/s: half of them carry the boat to and fro, and pass."""

SHRINK = (1.0, 0.5, 0.25, 0.0)
"""Parts of the way from the prior's parameters to the fitted ones that are tried in turn."""

START_WAVE = 0.3
"""Error of the observer's velocity, in standard deviations of the waves."""


@kernel
def _past_waves(n, rows, track, w):
    """Write what is left of the last velocities (6, 3), newest first; zeros if some are no good."""
    newest = _last_row(track)
    w[:] = 0.0
    # what a gap was bridged with is no wave
    if newest < ORDER or not _all_good(newest - ORDER + 2, newest, rows):
        return
    for i in range(3):
        w[0, i] = n[3 + i] - track[_SLOW + i]
        for k in range(1, ORDER):
            row = rows[(newest + 1 - k) % rows.shape[0]]
            w[k, i] = row[3 + i] - row[LOW + i]


@kernel
def _start_at(n, track, start):
    """Write where a prediction begins: place and heading, and low-frequency velocities."""
    for k in range(3):
        start[k], start[3 + k] = n[k], track[_SLOW + k]


@kernel
def _draw_back(part, x, rules, theta):
    """Write parameters that lie a part of the way from the prior's to the fitted ones."""
    prior = rules[_RULES + RULES :]
    for k in range(theta.shape[0]):
        theta[k] = prior[k] + part * (x[N_STATES + k] - prior[k])


@kernel
def _inside(out, track, usual):
    """Return whether velocities stay near what was ever seen, or usual."""
    inside = True
    for row in range(out.shape[0]):
        for k in range(3):
            bound = max(1.5 * track[_SEEN + k], usual[k])
            inside = inside and abs(out[row, 3 + k]) <= bound
    return inside


@kernel
def _roll_guarded(
    plan, dt, n, usual, ripple, track, rules, memory, constants, kit, scaled, theta, out, acts, room
):
    """Roll the model, its parameters drawn back to the prior until it stays within bounds."""
    x, _, act, wind, _, _, _, _, lags, envelope, _, n_unit = parts(memory, constants, kit)
    start = room[ROOM:][:N_STATES]
    _start_at(n, track, start)
    scale_plan(plan, n_unit, scaled)
    for part in SHRINK:
        _draw_back(part, x, rules, theta)
        roll_out(
            *(start, theta, act, scaled, dt, lags, envelope, wind, kit, ripple, TOLD_GAIN),
            *(out, acts, room),
        )
        if _inside(out, track, usual):
            return


_PATH = round(float(LOOK_AHEAD[-1]) / GRID) + 1
"""Rows of a path of the waves, from now on."""


@kernel
def _look_parts(room, p):
    """Return room for parameters, starts, waves, motions and factors as views."""
    many = LOOK_AHEAD.shape[0]
    theta, drawn, rest = room[:p], room[p : 2 * p], room[2 * p :]
    start, begun, rest = rest[:N_STATES], rest[N_STATES:][:N_STATES], rest[2 * N_STATES :]
    past, rest = shaped(rest, 0, (ORDER, 3)), rest[3 * ORDER :]
    path, rest = shaped(rest, 0, (1, _PATH, 3)), rest[3 * _PATH :]
    ends, means = shaped(rest, 0, (1, many, 3)), shaped(rest, 3 * many, (1, many, 3))
    rest = rest[6 * many :]
    more_ends, more_means = shaped(rest, 0, (1, many, 3)), shaped(rest, 3 * many, (1, many, 3))
    rest = rest[6 * many :]
    other, rest = shaped(rest, 0, (many, N_STATES)), rest[N_STATES * many :]
    centre, rest = shaped(rest, 0, (many, N_STATES)), rest[N_STATES * many :]
    acts, rest = shaped(rest, 0, (many, N_ACT)), rest[N_ACT * many :]
    way, rest = rest[: _PATH - 1], rest[_PATH - 1 :]
    root, rest = shaped(rest, 0, (p, p)), rest[p * p :]
    small, rest = shaped(rest, 0, (N_STATES, N_STATES)), rest[N_STATES**2 :]
    return (
        *(theta, drawn, start, begun, past, path, ends, means, more_ends, more_means),
        *(other, centre, acts, way, root, small, shaped(rest, 0, (1, p)), rest[p:]),
    )


def _look_size(p: int) -> int:
    """Return the length of the room of :func:`plus_look`: that of its parts, and of a roll-out."""
    many = len(LOOK_AHEAD)
    waves = 3 * (ORDER + _PATH + 4 * many) + _PATH - 1
    return 3 * p + p * p + 2 * N_STATES + N_STATES**2 + waves + (2 * N_STATES + N_ACT) * many + ROOM


@kernel
def plus_look(
    command, n, usual, time_scale, rows, book, rules, memory, constants, kit, ahead, room
):
    """Write the motion most to be expected at LOOK_AHEAD under a held command.

    What :meth:`PlusPredictor.mean` says of the same times, of `usv75` to within a few 1e-3 of the
    way made. Waves count by their means between the times: small boats in high waves are off by
    some .01 in place and .03 in sway.

    Parameters
    ----------
    command : (4,) array
        In the unit of the structure, rad.
    n : (12,) array
        Navigation state.
    usual, slowness
        Largest usual velocities, and the time to sail a length, s.
    rows, book, rules, memory, constants, kit
        Of a :class:`PlusPredictor`.
    ahead : (4, 6) array
        Written.
    room : array
        As long as :func:`_look_size` says; the parameters in use and the waves foretold are left
        there, for :func:`plus_spread`.
    """
    p = kit[0].shape[1]
    x, _, act, wind, _, _, _, _, lags, envelope, _, _ = parts(memory, constants, kit)
    track = book[:TRACK_SIZE]
    own = _look_parts(room, p)
    theta, _, start, _, past, path, ends, means, _, _ = own[:10]
    _, _, acts, _, _, _, _, roll = own[10:]
    _start_at(n, track, start)
    _past_waves(n, rows, track, past)
    foretell_waves(past, shaped(track, _HERE, (ORDER, 3)), path[0])
    between(path, GRID, LOOK_AHEAD, ends, means)
    for part in SHRINK:
        _draw_back(part, x, rules, theta)
        look_ahead(
            *(start, theta, act, command, lags, envelope, wind, kit, time_scale),
            *(means[0], TOLD_GAIN, ahead, acts, roll),
        )
        if _inside(ahead, track, usual):
            break
    for m in range(ahead.shape[0]):
        for k in range(3):
            ahead[m, 3 + k] += ends[0, m, k]


@kernel
def _add_drawn(root, shocks, out):
    """Add root' shocks to a vector."""
    for j in range(out.shape[0]):
        row = root[j, j:]
        to = out[j:]
        for k in range(row.shape[0]):
            to[k] += row[k] * shocks[j]


@kernel
def _way(psi, ahead, way):
    """Write headings (K,), every GRID seconds, from ``psi`` to those of LOOK_AHEAD."""
    m, before = 0, 0.0
    for k in range(way.shape[0]):
        t = GRID * (k + 1)
        while m + 1 < ahead.shape[0] and t > LOOK_AHEAD[m] + 1e-9:
            psi, before, m = ahead[m, 2], LOOK_AHEAD[m], m + 1
        way[k] = psi + (t - before) / (LOOK_AHEAD[m] - before) * (ahead[m, 2] - psi)


@kernel
def plus_spread(
    command, gps_var, time_scale, P_nav, ahead, book, memory, constants, kit, shocks, room, covs
):
    """Write how unsure the state will be at LOOK_AHEAD; call after :func:`plus_look`.

    The draws are those of :meth:`PlusPredictor.predict`, rolled at coarser steps: waves act on the
    velocities by their means between the times, by which these are up to a sixth surer later on.

    Parameters
    ----------
    command, slowness, book, memory, constants, kit, room
        As for :func:`plus_look`.
    gps_var : float
        Variance of the drifting part of a fix, m2.
    P_nav : (12, 12) array
        Covariance of the navigation.
    ahead : (4, 6) array
        From :func:`plus_look`.
    shocks : tuple
        Standard normal numbers of parameters (D, p), starts (D, 6) and waves (D + 1, 40, 3); the
        first of the waves are zeros.
    covs : (4, 6, 6) array
        Covariances ahead are written there.
    """
    by_theta, by_start, by_waves = shocks
    p, D = kit[0].shape[1], by_theta.shape[0]
    _, P, act, wind, _, _, _, _, lags, envelope, _, _ = parts(memory, constants, kit)
    track = book[:TRACK_SIZE]
    own = _look_parts(room, p)
    theta, drawn, start, begun, _, path, ends, means, more_ends, more_means = own[:10]
    out, centre, acts, way, root, small, work, roll = own[10:]
    sectors = shaped(track, _SECTORS, (SECTORS, SECTOR_SIZE))
    cholesky(P[N_STATES:, N_STATES:], root, work)
    for i in range(N_STATES):
        for k in range(N_STATES):
            small[i, k] = P_nav[i, k]
        if i >= 3:
            small[i, i] += (START_WAVE * track[_WAVE_SD + i - 3]) ** 2
    cholesky(small, small, work)
    covs[:] = 0.0
    # what every draw makes of the waves foretold is not how far they part
    look_ahead(
        *(start, theta, act, command, lags, envelope, wind, kit, time_scale),
        *(means[0], OBSERVER_GAIN, centre, acts, roll),
    )
    for m in range(out.shape[0]):
        for k in range(3):
            centre[m, 3 + k] += ends[0, m, k]
    _way(start[2], ahead, way)
    path[:] = 0.0  # the waves of the draws come on top of those foretold
    for d in range(D):
        for k in range(p):
            drawn[k] = theta[k]
        for k in range(N_STATES):
            begun[k] = start[k]
        _add_drawn(root, by_theta[d], drawn)
        _add_drawn(small, by_start[d], begun)
        begun[0], begun[1] = start[0], start[1]
        simulate_waves(sectors, way, by_waves[d + 1 : d + 2], path[:, 1:])
        between(path, GRID, LOOK_AHEAD, more_ends, more_means)
        for m in range(out.shape[0]):
            for k in range(3):
                more_means[0, m, k] += means[0, m, k]
        look_ahead(
            *(begun, drawn, act, command, lags, envelope, wind, kit, time_scale),
            *(more_means[0], OBSERVER_GAIN, out, acts, roll),
        )
        for m in range(out.shape[0]):
            for k in range(3):
                out[m, 3 + k] += ends[0, m, k] + more_ends[0, m, k]
            for k in range(N_STATES):
                out[m, k] -= centre[m, k]
            for i in range(N_STATES):
                for k in range(N_STATES):
                    covs[m, i, k] += out[m, i] * out[m, k] / D
    for m in range(covs.shape[0]):
        for i in range(2):
            for k in range(2):
                covs[m, i, k] += P_nav[i, k] + (gps_var if i == k else 0.0)


@kernel
def _mean_products(away, covs):
    """Write the mean over draws of the products of deviations (D, K, n) to (K, n, n)."""
    D, _, n = away.shape
    covs[:] = 0.0
    for d in range(D):
        for k in range(covs.shape[0]):
            row = away[d, k]
            for i in range(n):
                for j in range(i + 1):
                    covs[k, i, j] += row[i] * row[j]
    for k in range(covs.shape[0]):
        for i in range(n):
            for j in range(i + 1):
                covs[k, i, j] /= D
                covs[k, j, i] = covs[k, i, j]


def _edges(away: Array) -> Array:
    """Return the 5 and 95 % points (2, K, 6) of deviations (D, K, 6), made to hold the mean."""
    D, K, n = away.shape
    place = np.array([0.05, 0.95]) * (D - 1)
    low = place.astype(int)
    # the draws of one number stand side by side: sorted as far as needed, that is quick
    lines = np.ascontiguousarray(away.reshape(D, -1).T)
    ordered = np.partition(lines, [*low, *(low + 1)], axis=1).T.reshape(D, K, n)
    share = (place - low)[:, None, None]
    edges: Array = (1.0 - share) * ordered[low] + share * ordered[low + 1]
    edges[0], edges[1] = np.minimum(edges[0], 0.0), np.maximum(edges[1], 0.0)
    return edges


def _root(cov: Array) -> Array:
    """Return a square root of a covariance, also of one that is only semi-definite."""
    root = np.zeros_like(cov)
    cholesky(np.ascontiguousarray(cov), root, np.empty((1, len(cov))))
    return root.T
