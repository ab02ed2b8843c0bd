"""The forecast of DSW-UKF+: its mean, and draws of parameters, start and waves around it.

The same kernels serve ``predict``, ``mean``, and the observations of environments, so that all give
the same means and standard deviations.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.channels import PSI
from twin.filters.linalg import cholesky
from twin.filters.navigation_state import NAVIGATION
from twin.identification.interval_scale import factor_ahead
from twin.identification.joint_ukf import (
    PRIOR_SHRINKAGE,
    drive_share,
    filter_config,
    filter_state,
    is_plausible,
    scale_plan,
    shrink_to_prior,
)
from twin.identification.prediction_error import LOW, refit_config
from twin.identification.wave_residual import ORDER, between, forecast_waves, simulate_waves
from twin.model.dynamics import N_ACT
from twin.model.rollout import GRID, Paths, RolloutStart, Waves, rollout, rollout_size
from twin.model.structure import N_STATES
from twin.predictors.plus_update import WINDOW, all_good, last_row, observer_gain
from twin.predictors.ukf import DOUBTED
from usv_kernel.arrays import take
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import as_record

__all__ = [
    "FORECAST_WAVE_GAIN",
    "Draws",
    "MeanForecast",
    "draws_of",
    "interval_edges",
    "mean_forecast_of",
    "mean_products",
    "plan_draws",
    "plus_draws",
    "plus_mean",
]

Array = NDArray[Any]

FORECAST_WAVE_GAIN = 0.25
"""The gain of the predicted waves, 1/s: half of them carry the boat to and fro, and pass."""

START_WAVE = 0.3
"""Error of the observer's velocity, in standard deviations of the waves."""

TAMED = (1.0, 0.5, 0.5)
"""Parts of their deviation from the mean that parameters of a wild draw keep, in turn, until a
boat could sail it. The first is whole: that rollout has steps of its own."""

_ROLLOUT = rollout_size()

_MOTION = rollout_size(2) - _ROLLOUT


class MeanForecast(NamedTuple):
    """The mean forecast of K rows, with waves predicted on a grid of N steps."""

    plan: Any  # (K, 4) commands in the unit of the structure
    params: Any  # (1, p) parameters in use
    start: Any  # (1, 6) place and heading, low-frequency velocities
    after: Any  # (K,) times of the rows' ends after now, s
    past: Any  # (6, 3) last waves, newest first
    path: Any  # (1, N + 1, 3) predicted waves on the grid
    ends: Any  # (1, K, 3) the same at the rows' ends ...
    means: Any  # (1, K, 3) ... and on average over the rows
    states: Any  # (1, K, 6) states at the rows' ends
    act: Any  # (K, 4) actuators then
    work: Any  # scratch of the rollout


class Draws(NamedTuple):
    """D draws around the mean forecast; member 0 is the mean without what is drawn."""

    shocks: Any  # (D, 6) drawn errors of the start
    starts: Any  # (D + 1, 6) where the members begin
    params: Any  # (D + 1, p) their parameters
    heading: Any  # (N,) heading ahead on the grid, rad
    path: Any  # (D + 1, N + 1, 3) drawn waves on the grid
    ends: Any  # (D + 1, K, 3) the same at the rows' ends ...
    means: Any  # (D + 1, K, 3) ... and on average over the rows, with those predicted
    states: Any  # (D + 1, K, 6)
    act: Any  # (K, 4)
    deviations: Any  # (D, K + 1, 6) of the draws from member 0, now and at the rows' ends
    root: Any  # (p, p) factor of the parameters' covariance
    small: Any  # (6, 6) that of the start's
    line: Any  # (1, p) scratch of the factors
    work: Any  # scratch of the rollout


@inlined
def mean_forecast_of(memory, p, K, N):
    """Open the memory of a mean forecast."""
    plan, at = take(memory, 0, (K, N_ACT))
    params, at = take(memory, at, (1, p))
    start, at = take(memory, at, (1, N_STATES))
    after, at = take(memory, at, (K,))
    past, at = take(memory, at, (ORDER, 3))
    path, at = take(memory, at, (1, N + 1, 3))
    ends, at = take(memory, at, (1, K, 3))
    means, at = take(memory, at, (1, K, 3))
    states, at = take(memory, at, (1, K, N_STATES))
    act, at = take(memory, at, (K, N_ACT))
    work, at = take(memory, at, (_ROLLOUT,))
    return MeanForecast(plan, params, start, after, past, path, ends, means, states, act, work)


@inlined
def draws_of(memory, p, K, N, D):
    """Open the memory of D draws."""
    shocks, at = take(memory, 0, (D, N_STATES))
    starts, at = take(memory, at, (D + 1, N_STATES))
    params, at = take(memory, at, (D + 1, p))
    heading, at = take(memory, at, (N,))
    path, at = take(memory, at, (D + 1, N + 1, 3))
    ends, at = take(memory, at, (D + 1, K, 3))
    means, at = take(memory, at, (D + 1, K, 3))
    states, at = take(memory, at, (D + 1, K, N_STATES))
    act, at = take(memory, at, (K, N_ACT))
    deviations, at = take(memory, at, (D, K + 1, N_STATES))
    root, at = take(memory, at, (p, p))
    small, at = take(memory, at, (N_STATES, N_STATES))
    line, at = take(memory, at, (1, p))
    work, at = take(memory, at, (_ROLLOUT + D * _MOTION,))
    return Draws(
        shocks, starts, params, heading, path, ends, means, states, act, deviations, root, small,
        line, work,
    )  # fmt: skip


@kernel
def past_waves(nav, rows, window, w):
    """Write residuals of the last velocities (6, 3), newest first; zeros if a row is invalid."""
    newest = last_row(window)
    w[:] = 0.0
    # rows interpolated over a gap have no waves
    if newest < ORDER or not all_good(newest - ORDER + 2, newest, rows):
        return
    for i in range(3):
        w[0, i] = nav.n[3 + i] - window.slow[i]
        for k in range(1, ORDER):
            row = rows[(newest + 1 - k) % rows.shape[0]]
            w[k, i] = row[3 + i] - row[LOW + i]


@kernel
def _begin(dt, memory, out):
    """Write start, times and predicted waves of a forecast."""
    nav, window = as_record(memory.nav, NAVIGATION), as_record(memory.window, WINDOW)
    for k in range(3):
        out.start[0, k], out.start[0, 3 + k] = nav.n[k], window.slow[k]
    for k in range(out.after.shape[0]):
        out.after[k] = dt * (k + 1)
    past_waves(nav, memory.rows, window, out.past)
    forecast_waves(out.past, window.wave_ar, out.path[0])
    between(out.path, GRID, out.after, out.ends, out.means)


@kernel
def plus_mean(plan, dt, memory, config, out):
    """Write the mean forecast under a plan (K, 4) with rows dt (s) apart.

    The parameters are shrunk to the prior until the motion is plausible. Shaft speeds are in the
    unit of the particulars.
    """
    model = config.model
    state, given = filter_state(memory.filter, model), filter_config(config.filter, model)
    scale_plan(plan, given.n_unit, out.plan)
    _begin(dt, memory, out)
    start = RolloutStart(out.start, out.params, state.act, state.wind)
    waves, paths = Waves(out.means, FORECAST_WAVE_GAIN), Paths(out.states, out.act)
    share = drive_share(out.plan, given.n_nominal, given.driven)
    for part in PRIOR_SHRINKAGE:
        shrink_to_prior(part, state.x, given.prior, out.params[0])
        rollout(start, out.plan, dt, given, waves, paths, out.work)
        if is_plausible(out.states[0], state.fastest, given.nominal, share):
            break
    for row in range(plan.shape[0]):
        for k in range(3):
            out.states[0, row, 3 + k] += out.ends[0, row, k]


@kernel
def _add_drawn(root, shocks, out):
    """Add root' shocks to a vector."""
    for j in range(out.shape[0]):
        row, to = root[j, j:], out[j:]
        for k in range(row.shape[0]):
            to[k] += row[k] * shocks[j]


@kernel
def _headings_ahead(psi, states, dt, heading):
    """Write headings at grid steps on the way: straight lines between ``psi`` and the states."""
    m, K = 0, states.shape[0]
    for k in range(heading.shape[0]):
        t = GRID * (k + 1)
        while m < K - 1 and t > dt * (m + 1):
            m += 1
        before = psi if m == 0 else states[m - 1, 2]
        share = min((t - dt * m) / dt, 1.0)
        heading[k] = before + share * (states[m, 2] - before)


@kernel
def plus_draws(mean, mean_dt, memory, config, normal, out):
    """Write how draws of parameters, start and waves deviate from the mean forecast.

    ``mean`` is the mean forecast with rows ``mean_dt`` (s) apart, and the plan of the draws with
    its predicted waves. It is the same twice where both are at the same rows. ``normal`` has
    standard normal numbers of parameters (D, p), starts (D, 6) and waves (D + 1, 40, 3), used again
    where they do not reach. The first of the waves are zeros.
    """
    central, own = mean
    by_params, by_start, by_waves = normal
    model, D = config.model, by_params.shape[0]
    nav, window = as_record(memory.nav, NAVIGATION), as_record(memory.window, WINDOW)
    state, given = filter_state(memory.filter, model), filter_config(config.filter, model)
    p, small, P_nav = by_params.shape[1], out.small, nav.P
    cholesky(state.P[N_STATES:, N_STATES:], out.root, out.line)
    for i in range(N_STATES):
        for k in range(N_STATES):
            small[i, k] = P_nav[i, k]
        if i >= 3:
            small[i, i] += (START_WAVE * window.wave_sd[i - 3]) ** 2
            if nav.commands_doubted > 0.0:
                small[i, i] += (DOUBTED * given.envelope[i - 3]) ** 2
    cholesky(small, small, out.line)
    out.shocks[:] = 0.0
    for d in range(D + 1):
        for k in range(p):
            out.params[d, k] = central.params[0, k]
        for k in range(N_STATES):
            out.starts[d, k] = central.start[0, k]
        if d > 0:
            shocks = out.shocks[d - 1]
            _add_drawn(out.root, by_params[d - 1], out.params[d])
            _add_drawn(small, by_start[d - 1], shocks)
            for k in range(2, N_STATES):
                out.starts[d, k] += shocks[k]
    _headings_ahead(nav.n[2], central.states[0], mean_dt, out.heading)
    out.path[:] = 0.0
    simulate_waves(window.sectors, out.heading, by_waves, out.path[:, 1:])
    between(out.path, GRID, own.after, out.ends, out.means)
    for d in range(D + 1):
        for row in range(own.plan.shape[0]):
            for k in range(3):
                out.means[d, row, k] += own.means[0, row, k]
    start = RolloutStart(out.starts, out.params, state.act, state.wind)
    paths = Paths(out.states, out.act)
    gain = observer_gain(given)
    waves = Waves(out.means, gain)
    share = drive_share(own.plan, given.n_nominal, given.driven)
    rollout(start, own.plan, own.after[0], given, waves, paths, out.work)
    for d in range(1, D + 1):
        member = slice(d, d + 1)
        start = RolloutStart(out.starts[member], out.params[member], state.act, state.wind)
        waves, paths = Waves(out.means[member], gain), Paths(out.states[member], out.act)
        for part in TAMED:
            if is_plausible(out.states[d], state.fastest, given.nominal, share):
                break
            for k in range(p):
                kept = part * (out.params[d, k] - central.params[0, k])
                out.params[d, k] = central.params[0, k] + kept
            rollout(start, own.plan, own.after[0], given, waves, paths, out.work)
    for d in range(D):
        for k in range(N_STATES):
            out.deviations[d, 0, k] = out.shocks[d, k] if k >= 2 else 0.0
    refit = refit_config(config.refit, p)
    for row in range(own.plan.shape[0]):
        for k in range(N_STATES):
            factor = factor_ahead(own.after[row], max(k - 1, 0), window, refit)
            for d in range(D):
                value = out.states[d + 1, row, k]
                if k >= 3:
                    value += out.ends[d + 1, row, k - 3]
                # the error of the heading now stays
                still = out.shocks[d, PSI] if k == PSI else 0.0
                change = value - out.states[0, row, k] - still
                out.deviations[d, row + 1, k] = still + factor * change


@kernel
def mean_products(deviations, rows, covs):
    """Write the mean over draws of the products of deviations (D, K, n) at rows: (k, n, n)."""
    D, n = deviations.shape[0], deviations.shape[2]
    covs[:] = 0.0
    for d in range(D):
        for k in range(rows.shape[0]):
            row = deviations[d, rows[k]]
            for i in range(n):
                for j in range(i + 1):
                    covs[k, i, j] += row[i] * row[j]
    for k in range(rows.shape[0]):
        for i in range(n):
            for j in range(i + 1):
                covs[k, i, j] /= D
                covs[k, j, i] = covs[k, i, j]


@kernel
def plan_draws(plan, dt, memory, config, out):
    """Write plan, start and predicted waves of the draws, where their rows are others."""
    scale_plan(plan, filter_config(config.filter, config.model).n_unit, out.plan)
    _begin(dt, memory, out)


def interval_edges(deviations: Array) -> Array:
    """Return the 5 and 95 % points (2, K, 6) of deviations (D, K, 6), made to hold the mean."""
    D, K, n = deviations.shape
    place = np.array([0.05, 0.95]) * (D - 1)
    low = place.astype(int)
    # the draws of one number are contiguous, and sorted only as far as needed
    lines = np.ascontiguousarray(deviations.reshape(D, -1).T)
    ordered = np.partition(lines, [*low, *(low + 1)], axis=1).T.reshape(D, K, n)
    share = (place - low)[:, None, None]
    edges: Array = (1.0 - share) * ordered[low] + share * ordered[low + 1]
    edges[0], edges[1] = np.minimum(edges[0], 0.0), np.maximum(edges[1], 0.0)
    return edges
