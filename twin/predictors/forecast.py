"""The forecast of every predictor with a model, of one boat or many: mean and covariance.

The mean is a rollout of the model from the filter's state; where waves are known, from the
low-frequency velocities, and the waves of the moment carry the boat along. Its covariance is that
of sigma points, or of draws of parameters, start and waves. ``mean``, ``predict``, and observations
and scores of environments are these kernels.

Source: docs/explanation/twin.md, Waves and prediction intervals.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.channels import PSI
from twin.filters.linalg import cholesky
from twin.filters.navigation_state import NAVIGATION
from twin.identification.interval_scale import factor_ahead
from twin.identification.joint_ukf import (
    DOUBTED_VELOCITY_SD,
    clip_velocities,
    filter_config,
    filter_state,
    filter_workspace,
    process_noise,
    scale_plan,
)
from twin.identification.prediction_error import LOW, refit_config
from twin.identification.wave_residual import ORDER, between, forecast_waves, simulate_waves
from twin.identification.window import WINDOW, all_good, last_row, observer_gain
from twin.model.actuators import follow_all
from twin.model.augmented import JointState, joint_predict
from twin.model.dynamics import N_ACT
from twin.model.rollout import GRID, Paths, RolloutStart, Waves, rollout, rollout_size
from twin.model.structure import N_STATES
from usv_kernel.arrays import flat_size, python_views, shaped, take
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import as_record

__all__ = [
    "SHRINKAGE",
    "Beginning",
    "Draws",
    "Forecast",
    "ForecastConfig",
    "Sources",
    "beginning",
    "coarse_plan",
    "covariance_ahead",
    "draw_ahead",
    "draws_of",
    "drive_share",
    "forecast_mean",
    "forecast_of",
    "interval_edges",
    "is_plausible",
    "limit_covariances",
    "mean_ahead",
    "mean_products",
    "opened",
    "past_waves",
    "sigma_covariances",
    "steps_of_waves",
]

Array = NDArray[Any]

SHRINKAGE = (1.0, 0.5, 0.25, 0.0)
"""Parts of the way, tried in turn until a boat could sail so: from the prior's parameters to the
fitted ones, and from those of the mean to those of a draw."""

WAVE_GAIN_PER_S = 0.25
"""Gain with which predicted waves enter the velocities."""

START_WAVE_SD = 0.3
"""Standard deviation of the observer's velocity, in standard deviations of the waves."""

_ROLLOUT = rollout_size()

_MOTION = rollout_size(2) - _ROLLOUT


class Sources(NamedTuple):
    """What a forecast is made from, flat."""

    filter: Any  # see FilterState
    # None where no waves are known
    nav: Any  # see NAVIGATION
    rows: Any  # (M, 20) rows of the window
    window: Any  # see WINDOW


class ForecastConfig(NamedTuple):
    """What a forecast is given of the boat."""

    filter: Any  # see FilterConfig
    model: Any  # ModelTerms
    refit: Any  # see RefitConfig; None where no waves are known


class Beginning(NamedTuple):
    """What the mean of a forecast is made from."""

    start: Any  # (1, 6) x, y, psi; u, v, r, low-frequency where waves are known
    means: Any  # (1, K, 3) predicted waves in u, v, r on average over the rows, or (1, 0, 3) ...
    ends: Any  # ... and at their ends
    params: Any  # (p,) fitted parameters
    act: Any  # (4,) actuators
    wind: Any  # (2,) m/s
    fastest: Any  # (3,) largest velocities seen


class Forecast(NamedTuple):
    """A forecast of K rows; its waves are predicted on a grid of N steps, or N = 0 for none."""

    held: Any  # (K, 4) a command, held, in rev/s and rad
    plan: Any  # (K, 4) commands in the unit of the structure
    params: Any  # (1, p) parameters in use
    start: Any  # (1, 6) see Beginning
    after: Any  # (K,) times of the rows' ends after now, s
    past: Any  # (6, 3) last waves, newest first
    path: Any  # (1, N + 1, 3) predicted waves on the grid
    ends: Any  # (1, K or 0, 3) the same at the rows' ends ...
    means: Any  # (1, K or 0, 3) ... and on average over the rows
    states: Any  # (1, K, 6) states at the rows' ends
    act: Any  # (K, 4) actuators then
    covs: Any  # (K, 6, 6) covariances then, by sigma points
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
def forecast_of(memory, p, K, N):
    """Open the memory of a forecast."""
    held, at = take(memory, 0, (K, N_ACT))
    plan, at = take(memory, at, (K, N_ACT))
    params, at = take(memory, at, (1, p))
    start, at = take(memory, at, (1, N_STATES))
    after, at = take(memory, at, (K,))
    past, at = take(memory, at, (ORDER, 3))
    path, at = take(memory, at, (1, N + 1, 3))
    ends, at = take(memory, at, (1, min(N, 1) * K, 3))
    means, at = take(memory, at, (1, min(N, 1) * K, 3))
    states, at = take(memory, at, (1, K, N_STATES))
    act, at = take(memory, at, (K, N_ACT))
    covs, at = take(memory, at, (K, N_STATES, N_STATES))
    work, at = take(memory, at, (_ROLLOUT,))
    return Forecast(
        held, plan, params, start, after, past, path, ends, means, states, act, covs, work
    )


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


def opened(opener: Callable[..., Any], *sizes: int) -> Any:
    """Return new memory of a forecast or of draws, by name."""
    return python_views(opener)(np.empty(_size(opener, *sizes)), *sizes)


@functools.cache
def _size(opener: Callable[..., Any], *sizes: int) -> int:
    return flat_size(opener, *sizes)


def steps_of_waves(span: float) -> int:
    """Return how many grid steps cover a time (s)."""
    return math.ceil(span / GRID - 1e-9)


def coarse_plan(plan: Array, dt: float) -> tuple[Array, int]:
    """Return a plan at steps near :data:`GRID`, and how many of its rows are one step."""
    every = max(1, min(round(GRID / dt), len(plan)))
    K = math.ceil(len(plan) / every)
    return plan[np.minimum(np.arange(K) * every + every // 2, len(plan) - 1)], every


@inlined
def drive_share(plan, n_nominal, driven):
    """Return the largest shaft speed of a plan in nominal ones, 1 to ``driven``."""
    share = 1.0
    for row in range(plan.shape[0]):
        share = max(share, abs(plan[row, 0]) / n_nominal, abs(plan[row, 1]) / n_nominal)
    return min(share, driven)


@inlined
def plausible_speed(k, fastest, nominal, share):
    """Return the plausible bound of a velocity, by the fastest seen and ``share`` nominal ones."""
    return max(1.5 * fastest[k], share * nominal[k])


@inlined
def is_plausible(states, fastest, nominal, share):
    """Return whether all velocities are within :func:`plausible_speed`."""
    plausible = True
    for row in range(states.shape[0]):
        for k in range(3):
            bound = plausible_speed(k, fastest, nominal, share)
            plausible = plausible and abs(states[row, 3 + k]) <= bound
    return plausible


@inlined
def _limit_deviation(cov, i, most):
    """Limit one standard deviation of a covariance, in place."""
    factor = min(1.0, most / math.sqrt(max(cov[i, i], 1e-300)))
    if factor < 1.0:
        for k in range(cov.shape[0]):
            cov[i, k] *= factor
            cov[k, i] *= factor


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


@inlined
def beginning(state, out):
    """Return what a forecast begins with that has its start and waves."""
    x, p = state.x, state.x.shape[0] - N_STATES
    params = shaped(x, N_STATES, (p,))
    return Beginning(out.start, out.means, out.ends, params, state.act, state.wind, state.fastest)


@inlined
def _begin(dt, state, nav, rows, window, out):
    """Write start and waves of a forecast with rows dt (s) apart, and return what it begins with.

    ``nav``, ``rows`` and ``window`` are flat, or None where no waves are known.
    """
    if window is None:
        for k in range(N_STATES):
            out.start[0, k] = state.x[k]
        return beginning(state, out)
    known, seen = as_record(nav, NAVIGATION), as_record(window, WINDOW)
    for k in range(3):
        out.start[0, k], out.start[0, 3 + k] = known.n[k], seen.slow[k]
    for k in range(out.after.shape[0]):
        out.after[k] = dt * (k + 1)
    past_waves(known, rows, seen, out.past)
    forecast_waves(out.past, seen.wave_ar, out.path[0])
    between(out.path, GRID, out.after, out.ends, out.means)
    return beginning(state, out)


@kernel
def forecast_mean(plan, dt, begin, given, out):
    """Write the states and actuators that a plan (K, 4) with rows dt (s) apart leads to.

    Shaft speeds are in the unit of the particulars. The parameters are shrunk to the prior until
    the motion is plausible; ``out.params`` are those used. Returned is how many steps of the
    integration one row took, at most.
    """
    scale_plan(plan, given.n_unit, out.plan)
    start = RolloutStart(begin.start, out.params, begin.act, begin.wind)
    waves, paths = Waves(begin.means, WAVE_GAIN_PER_S), Paths(out.states, out.act)
    steps, share = 1, drive_share(out.plan, given.n_nominal, given.driven)
    for part in SHRINKAGE:
        for k in range(begin.params.shape[0]):
            out.params[0, k] = given.prior[k] + part * (begin.params[k] - given.prior[k])
        steps = rollout(start, out.plan, dt, given, waves, paths, out.work)
        if is_plausible(out.states[0], begin.fastest, given.nominal, share):
            break
    for row in range(begin.ends.shape[1]):
        for k in range(3):
            out.states[0, row, 3 + k] += begin.ends[0, row, k]
    return steps


@kernel
def mean_ahead(plan, dt, sources, config, out):
    """Do :func:`forecast_mean` from what a predictor remembers."""
    model, nav, rows, window = config.model, sources.nav, sources.rows, sources.window
    state, given = filter_state(sources.filter, model), filter_config(config.filter, model)
    begin = _begin(dt, state, nav, rows, window, out)
    return forecast_mean(plan, dt, begin, given, out)


@inlined
def sigma_covariances(dt, steps, state, config, out, work):
    """Write the covariances ``out.covs`` (K, 6, 6) of the state at the ends of the rows of a plan.

    ``out`` and ``steps`` are what :func:`forecast_mean` wrote and returned for the same rows, dt
    (s) apart.
    """
    plan, params, covs = out.plan, out.params[0], out.covs
    x, P, act = work.ahead
    ahead = JointState(x, P, act, state.wind)
    for i in range(x.shape[0]):
        x[i] = state.x[i] if i < N_STATES else params[i - N_STATES]
        for k in range(x.shape[0]):
            P[i, k] = state.P[i, k]
    for k in range(N_ACT):
        act[k] = state.act[k]
    least = max(1, math.ceil(dt / GRID - 1e-9))
    # Euler's steps, of points that are faster than the mean
    steps = least if steps <= least else 2 * steps
    share = drive_share(plan, config.n_nominal, config.driven)
    h = dt / steps
    process_noise(h, state, config, work)
    for row in range(plan.shape[0]):
        for _ in range(steps):
            follow_all(act, plan[row], config.lags, 1.0, 0.5 * h)
            joint_predict(ahead, h, config, work)
            follow_all(act, plan[row], config.lags, 1.0, 0.5 * h)
            clip_velocities(x, config.envelope)
            for k in range(3):
                bound = plausible_speed(k, state.fastest, config.nominal, share)
                _limit_deviation(P, 3 + k, config.even * bound)
        for i in range(N_STATES):
            for k in range(N_STATES):
                covs[row, i, k] = P[i, k]


@kernel
def covariance_ahead(plan, dt, sources, config, out, work):
    """Do :func:`mean_ahead` and :func:`sigma_covariances`; ``work`` is a filter's scratch."""
    model = config.model
    steps = mean_ahead(plan, dt, sources, config, out)
    state, given = filter_state(sources.filter, model), filter_config(config.filter, model)
    scratch = filter_workspace(work, model.which.shape[1])
    sigma_covariances(dt, steps, state, given, out, scratch)


@kernel
def limit_covariances(covs, start_cov, dt, envelope):
    """Limit, in place, standard deviations to those of a boat within its envelope.

    ``covs`` (K, 6, 6) are at the ends of rows dt (s) apart, after ``start_cov``, whose diagonal
    counts. ``envelope`` (3,) is the largest size of u, v (m/s) and r (rad/s).
    """
    for row in range(covs.shape[0]):
        after, cov = dt * (row + 1), covs[row]
        for i in range(N_STATES):
            most = 2.0 * envelope[max(i - 3, 0)]
            if i < PSI:
                most = 2.0 * envelope[0] * after + math.sqrt(start_cov[i, i])
            elif i == PSI:
                most = 2.0 * min(envelope[2] * after, math.pi) + math.sqrt(start_cov[i, i])
            _limit_deviation(cov, i, most)


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
def draw_ahead(mean, mean_dt, sources, config, normal, out):
    """Write how draws of parameters, start and waves deviate from the mean forecast.

    ``mean`` is the mean forecast with rows ``mean_dt`` (s) apart, and that with the rows of the
    draws. It is the same twice where both are at the same rows. ``normal`` has
    standard normal numbers of parameters (D, p), starts (D, 6) and waves (D + 1, 40, 3), used again
    where they do not reach. The first of the waves are zeros.
    """
    central, own = mean
    by_params, by_start, by_waves = normal
    model, D = config.model, by_params.shape[0]
    nav, window = as_record(sources.nav, NAVIGATION), as_record(sources.window, WINDOW)
    state, given = filter_state(sources.filter, model), filter_config(config.filter, model)
    p, small, P_nav = by_params.shape[1], out.small, nav.P
    cholesky(state.P[N_STATES:, N_STATES:], out.root, out.line)
    for i in range(N_STATES):
        for k in range(N_STATES):
            small[i, k] = P_nav[i, k]
        if i >= 3:
            small[i, i] += (START_WAVE_SD * window.wave_sd[i - 3]) ** 2
            if nav.commands_doubted > 0.0:
                small[i, i] += (DOUBTED_VELOCITY_SD * given.envelope[i - 3]) ** 2
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
        whole = 1.0
        # the first part is whole: that rollout has steps of its own
        for part in SHRINKAGE:
            if is_plausible(out.states[d], state.fastest, given.nominal, share):
                break
            for k in range(p):
                kept = part / whole * (out.params[d, k] - central.params[0, k])
                out.params[d, k] = central.params[0, k] + kept
            whole = part
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
