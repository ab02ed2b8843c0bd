"""One row of DSW-UKF+: observer, window, waves and refit."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from twin.channels import PSI, R, U, V
from twin.filters.navigation_ekf import is_learning_suspended, lacks_gps
from twin.filters.navigation_state import NAVIGATION
from twin.identification.conformal import (
    HORIZONS,
    REGION,
    SCORES,
    Z90,
    take_score,
)
from twin.identification.evidence import REFITS, evidence_work, find_change, refit
from twin.identification.experts import (
    BEST,
    CHANGED,
    CHOSEN,
    JOINT,
    NOTED,
    PAST,
    SCORED,
    choose,
    expert_state,
    note,
    score,
    slot_of,
)
from twin.identification.joint_ukf import (
    filter_config,
    filter_state,
    filter_workspace,
    plausible_speed,
)
from twin.identification.prediction_error import (
    ACT,
    COMMAND,
    GOOD,
    LOW,
    MIDDLE,
    NONE,
    STATE,
    WIND,
    linearise_work,
    refit_config,
)
from twin.identification.segments import (
    RefitWork,
    add,
    discard_before,
    relinearise,
    segment_state,
    segment_work,
)
from twin.identification.wave_residual import (
    ORDER,
    fit_sector_ar,
    fit_waves,
    heading_kernel,
    sector_work_size,
)
from twin.model.dynamics import N_ACT, drive, rates_over_ground
from twin.model.rollout import GRID, rotate_body_velocity
from twin.model.structure import N_STATES, current_of
from twin.predictors.baselines import GAP_MAX
from twin.predictors.plus_forecast import (
    draws_of,
    mean_forecast_of,
    mean_products,
    plus_draws,
    plus_mean,
)
from twin.predictors.plus_memory import (
    WINDOW,
    PlusMemory,
    all_good,
    last_row,
    observer_gain,
    plus_config_of,
    plus_work_of,
)
from twin.predictors.ukf import (
    UKFConfig,
    UKFMemory,
    UKFWork,
    correct,
    has_diverged,
    place_by_navigation,
    restart_state,
    start_filter,
    tight_step,
)
from usv_kernel.arrays import flat_size, take
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import as_record

__all__ = [
    "WAVE_WORK",
    "check_work",
    "plus_step",
    "update_plus",
]

SPEED_GOOD, HEADING_GOOD, GAP_GOOD = 0.25, 0.1, 2.5
"""Largest standard deviations of velocity (nominal speeds) and heading (rad) of a row to fit, and
greatest age (s) of the row before it."""

CHECK_ROWS, CHECK_DRAWS = round(HORIZONS[-1] / GRID), 20
"""Grid steps of a forecast that is compared with what came, and its draws."""

_CHECKED = np.array([round(h / GRID) for h in HORIZONS])

TINY = 1e-300
"""Least of a variance, so that an error over it is a number."""

WAVE_SPAN, LATE_SPAN = 80.0, 60.0
"""Waves are predicted from the residuals of this many seconds, and drawn from so many of the last
valid ones. Earlier residuals also hold what was not yet learned."""

LEARNT = 16
"""Segments compared before forecasts are: until then, the spread of now is not that of then."""

SEGMENTS_MIN = 3
"""Least number of segments for a refit."""


@inlined
def refit_work(work, p, capacity):
    """Open the scratch of a refit."""
    return RefitWork(
        linearise_work(work.line, p),
        segment_work(work.solve, p, capacity),
        evidence_work(work.evidence, p, capacity),
    )


@inlined
def _slow_step(dt, nav, window, state, config, terms):
    """Advance the low-frequency observer."""
    n, act, slow, envelope = nav.n, state.act, window.slow, config.envelope
    steps = max(1, math.ceil(min(dt, 10.0) / GRID - 1e-9))
    h, gain = min(dt, 10.0) / steps, observer_gain(config)
    c, s = math.cos(n[PSI]), math.sin(n[PSI])
    drive(act, terms)
    current = current_of(state.x, N_STATES, config.model.hull)
    for _ in range(steps):
        motion = slow[0], slow[1], slow[2], c, s
        rates = rates_over_ground(
            motion, state.wind, current, state.x, N_STATES, config.model, terms
        )
        rotate_body_velocity(n[R] - slow[2], h, slow, 0)
        for i in range(3):
            slow[i] += h * (rates[i] + gain * (n[3 + i] - slow[i]))
            # where nobody knows what the drives do, the model says nothing of the velocities
            reach = 0.125 * envelope[i] if nav.commands_doubted == 0.0 else 0.0
            slow[i] = min(max(slow[i], n[3 + i] - reach), n[3 + i] + reach)


@inlined
def _record(t, dt, good, cmd, nav, window, state, rows):
    """Write the window's rows up to time t, interpolated on its grid."""
    n, act, last, last_act = nav.n, state.act, window.last, window.last_act
    if dt > GAP_MAX:
        for k in range(rows.shape[0]):
            rows[k, GOOD] = 0.0
        window.halves = math.ceil((t - window.origin) / (0.5 * GRID))
    while window.origin + 0.5 * GRID * window.halves <= t:
        half = int(window.halves)
        share = 1.0
        if dt > 0.0:
            share = 1.0 - min(max((t - window.origin - 0.5 * GRID * half) / dt, 0.0), 1.0)
        row = rows[(half // 2) % rows.shape[0]]
        first = MIDDLE if half % 2 == 1 else ACT
        for k in range(N_ACT):
            row[first + k] = last_act[k] + share * (act[k] - last_act[k])
        if half % 2 == 0:
            for k in range(N_STATES):
                row[STATE + k] = last[k] + share * (n[k] - last[k])
            for k in range(3):
                row[LOW + k] = window.slow[k]
            for k in range(2):
                row[WIND + k] = state.wind[k]
            for k in range(N_ACT):
                row[COMMAND + k] = cmd[k]
            row[GOOD] = good
        window.halves += 1.0
    for k in range(N_STATES):
        last[k] = n[k]
    for k in range(N_ACT):
        last_act[k] = act[k]


@kernel
def _take_segments(rows, window, experts, segments, config, model, work):
    """Take the segments that are over into the window; return how many starts were tried."""
    newest, tried = last_row(window), 0
    # older rows have been overwritten, nearly all of them after a long gap
    start = max(int(window.next_start), newest - rows.shape[0] + 1)
    while start + config.steps < newest:
        if all_good(start, start + config.steps, rows):
            add(
                start, rows, experts.params[int(experts.count[BEST])], segments, config, model, work
            )
            if start <= experts.count[NOTED]:  # else it began and ended between two refits
                score(start, rows, experts, config, model, work.line)
        start += config.spacing
        tried += 1
    window.next_start = start
    return tried


_WAVE_ROWS = round(WAVE_SPAN / GRID) + 1


class WavesWork(NamedTuple):
    """Scratch of :func:`_fit_waves` for N rows."""

    w: Any  # (N, 3) residuals of u, v, r
    psi: Any  # (N,) headings
    good: Any  # (N,) which rows count
    fit: Any  # of the fits


@inlined
def _waves_work(work, N):
    """Open the scratch of :func:`_fit_waves`."""
    w, at = take(work, 0, (N, 3))
    psi, at = take(work, at, (N,))
    good, at = take(work, at, (N,))
    return WavesWork(w, psi, good, work[at:])


_MEAN_SIZE = flat_size(mean_forecast_of, 0, CHECK_ROWS, CHECK_ROWS)

_DRAWS_SIZE = flat_size(draws_of, 0, CHECK_ROWS, CHECK_ROWS, CHECK_DRAWS)

WAVE_WORK = 5 * _WAVE_ROWS + sector_work_size(_WAVE_ROWS)
"""Length of the scratch of the waves."""


@kernel
def _fit_waves(rows, window, config, work):
    """Fit autoregressions to the last residuals: by sector for the draws, and of the moment."""
    newest, count = last_row(window), 0
    first = max(newest - min(round(WAVE_SPAN / GRID), config.span), 0)
    N, late = newest + 1 - first, 0
    scratch = _waves_work(work, N)
    w, psi, good = scratch.w, scratch.psi, scratch.good
    for k in range(N - 1, -1, -1):
        row = rows[(first + k) % rows.shape[0]]
        psi[k], good[k] = row[STATE + PSI], row[GOOD]
        for i in range(3):
            w[k, i] = row[STATE + U + i] - row[LOW + i] if good[k] > 0.0 else 0.0
        if good[k] > 0.0:
            count += 1
            if count <= round(LATE_SPAN / GRID):
                late = k
    if count <= 5 * ORDER:
        return
    fit_sector_ar(w[late:], psi[late:], good[late:], window.sectors[:], scratch.fit)
    for i in range(3):
        mean, square = 0.0, 0.0
        for k in range(N):
            mean += w[k, i] / count
        for k in range(N):
            square += (w[k, i] - mean) ** 2 / count if good[k] > 0.0 else 0.0
        window.wave_sd[i] = math.sqrt(square)
    heading = psi[N - 1] + 0.5 * config.period * window.slow[2]
    for k in range(N):
        # both factors of the products that are fitted have it
        weight = heading_kernel(psi[k] - heading)
        for i in range(3):
            w[k, i] *= weight
    fit_waves(w, window.wave_ar[:], scratch.fit)


@inlined
def _give_covariance(cov, P):
    """Write the covariance (p, p) of parameters, which then say nothing of the state."""
    for i in range(cov.shape[0]):
        for k in range(N_STATES):
            P[N_STATES + i, k] = P[k, N_STATES + i] = 0.0
        for k in range(cov.shape[0]):
            P[N_STATES + i, N_STATES + k] = cov[i, k]


class CheckWork(NamedTuple):
    """Scratch of :func:`_check_forecast`."""

    plan: Any  # (40, 4) commands as they were
    kept: Any  # (15 + p,) what is put back
    covs: Any  # (4, 6, 6) claimed covariances at the horizons
    ordered: Any  # (scores,)
    mean: Any  # see MeanForecast
    draws: Any  # see Draws


@inlined
def check_work(work, p):
    """Open the scratch of a comparison."""
    plan, at = take(work, 0, (CHECK_ROWS, N_ACT))
    kept, at = take(work, at, (2 * N_STATES + N_ACT + p,))
    covs, at = take(work, at, (len(HORIZONS), N_STATES, N_STATES))
    ordered, at = take(work, at, (SCORES,))
    mean, at = take(work, at, (_MEAN_SIZE + p,))
    draws, at = take(work, at, (_DRAWS_SIZE + (CHECK_DRAWS + 1 + p + 1) * p,))
    return CheckWork(plan, kept, covs, ordered, mean, draws)


@inlined
def _swap(kept, at, values, other):
    """Keep values, and write others in their place; return the place after those kept."""
    for k in range(other.shape[0]):
        kept[at + k], values[k] = values[k], other[k]
    return at + other.shape[0]


@inlined
def _put_back(kept, at, values, count):
    """Write values that were kept; return the place after them."""
    for k in range(count):
        values[k] = kept[at + k]
    return at + count


@kernel
def _forecast_from(first, memory, config, scratch):
    """Write the forecast from a row on under the commands as they were, and its covariances.

    The parameters are those that the expert in use had then. Covariance, waves to come and shape of
    the waves are those of now.
    """
    model, rows, p = config.model, memory.rows, config.model.which.shape[1]
    nav, window = as_record(memory.nav, NAVIGATION), as_record(memory.window, WINDOW)
    state, experts = filter_state(memory.filter, model), expert_state(memory.experts, p)
    spacing = refit_config(config.refit, p).spacing
    size = rows.shape[0]
    start, halves = rows[first % size], window.halves
    for k in range(CHECK_ROWS):
        for i in range(N_ACT):
            scratch.plan[k, i] = rows[(first + k + 1) % size, COMMAND + i]
    kept, params = scratch.kept, state.x[N_STATES:]
    then = experts.past[slot_of(first, spacing), int(experts.count[CHOSEN])]
    # the clock is put back to the row ...
    at = _swap(kept, 0, nav.n, start[STATE:LOW])
    at = _swap(kept, at, window.slow, start[LOW:WIND])
    at = _swap(kept, at, state.wind, start[WIND:GOOD])
    at = _swap(kept, at, state.act, start[ACT:MIDDLE])
    _swap(kept, at, params, then)
    window.halves = 2.0 * (first + 1)
    mean = mean_forecast_of(scratch.mean, p, CHECK_ROWS, CHECK_ROWS)
    draws = draws_of(scratch.draws, p, CHECK_ROWS, CHECK_ROWS, CHECK_DRAWS)
    plus_mean(scratch.plan, GRID, memory, config, mean)
    # other draws each time, so that their chance averages out
    some = int(window.compared) % (config.by_params.shape[0] // CHECK_DRAWS) * CHECK_DRAWS
    normal = (
        config.by_params[some : some + CHECK_DRAWS],
        config.by_start[some : some + CHECK_DRAWS],
        config.by_waves[some : some + CHECK_DRAWS + 1],
    )
    plus_draws((mean, mean), GRID, False, memory, config, normal, draws)
    mean_products(draws.deviations, _CHECKED, scratch.covs)
    # ... and forward again
    window.halves = halves
    at = _put_back(kept, 0, nav.n, N_STATES)
    at = _put_back(kept, at, window.slow, 3)
    at = _put_back(kept, at, state.wind, 2)
    at = _put_back(kept, at, state.act, N_ACT)
    _put_back(kept, at, params, p)


@kernel
def _check_forecast(first, memory, config, scratch):
    """Compare the forecast from a row on with what came; see ``twin.identification.conformal``."""
    rows, window = memory.rows, as_record(memory.window, WINDOW)
    _forecast_from(first, memory, config, scratch)
    mean = mean_forecast_of(scratch.mean, config.model.which.shape[1], CHECK_ROWS, CHECK_ROWS)
    for h in range(_CHECKED.shape[0]):
        state, P = mean.states[0, _CHECKED[h] - 1], scratch.covs[h]
        came = rows[(first + _CHECKED[h]) % rows.shape[0]]
        x, y = came[STATE] - state[0], came[STATE + 1] - state[1]
        area = max(P[0, 0] * P[1, 1] - P[0, 1] * P[0, 1], TINY)
        square = (P[1, 1] * x * x - 2.0 * P[0, 1] * x * y + P[0, 0] * y * y) / area
        take_score(h, 0, math.sqrt(square / REGION), window, scratch.ordered)
        for k in range(2, N_STATES):
            score_ = abs(came[STATE + k] - state[k]) / (Z90 * math.sqrt(max(P[k, k], TINY)))
            take_score(h, k - 1, score_, window, scratch.ordered)
    window.compared += 1.0


@kernel
def _check_forecasts(memory, config, work):
    """Compare the forecasts that are over with what came, one of each start of a segment."""
    window, p = as_record(memory.window, WINDOW), config.model.which.shape[1]
    spacing, experts = refit_config(config.refit, p).spacing, expert_state(memory.experts, p)
    newest, noted, scratch = last_row(window), experts.count[NOTED], check_work(work.check, p)
    start = max(int(window.next_check), newest - memory.rows.shape[0] + 1)
    while start + CHECK_ROWS <= newest:
        known = noted - PAST * spacing < start <= noted and experts.count[SCORED] >= LEARNT
        if known and all_good(start - ORDER, start + CHECK_ROWS, memory.rows):
            _check_forecast(start, memory, config, scratch)
        start += spacing
    window.next_check = start


@kernel
def _refit(memory, config, work):
    """Bring segments, waves and refits up to date, and write the best parameters to the filter."""
    model, rows, window = config.model, memory.rows, as_record(memory.window, WINDOW)
    p = model.which.shape[1]
    given = refit_config(config.refit, p)
    experts = expert_state(memory.experts, p)
    segments = segment_state(memory.segments, p, given.capacity)
    scratch = refit_work(work, p, given.capacity)
    _take_segments(rows, window, experts, segments, given, model, scratch)
    newest = last_row(window)
    count = discard_before(newest - given.span, segments)
    _fit_waves(rows, window, given, work.waves)
    joint = filter_state(memory.joint, model)
    for k in range(p):
        experts.params[JOINT, k] = joint.x[N_STATES + k]
    for start in range(int(window.next_start), newest + 1, given.spacing):
        note(start, given.spacing, experts)
    if count < SEGMENTS_MIN:
        return
    own = experts.params[int(experts.count[BEST])]
    relinearise(given.relinearised, rows, own, segments, given, model, scratch)
    changed = find_change(
        newest, experts.count[CHANGED], own, segments, given, model, scratch.evidence
    )
    experts.count[CHANGED] = changed
    for r in range(REFITS):
        params, cov = experts.params[r], experts.cov[r]
        refit(r, changed, params, cov, segments, given, model, scratch.evidence)
    row = rows[newest % rows.shape[0]]
    bounds, tight = work.waves[:3], filter_state(memory.filter, model)
    nominal = filter_config(config.filter, model).nominal
    for i in range(3):
        bounds[i] = plausible_speed(i, tight.fastest, nominal, 1.0)
    if not choose(row, bounds, experts, model, scratch.line):
        return
    chosen = int(experts.count[CHOSEN])
    for i in range(p):
        tight.x[N_STATES + i] = experts.params[chosen, i]
    if chosen == JOINT:
        _give_covariance(joint.P[N_STATES:, N_STATES:], tight.P)
    else:
        _give_covariance(experts.cov[chosen if chosen < REFITS else 0], tight.P)


@kernel
def update_plus(t, dt, z, cmd, memory, config, work):
    """Do :func:`plus_step` with plain tuples, which numba takes from Python much faster."""
    nav, tight, rows, window, experts, segments, joint = memory
    own = PlusMemory(nav, tight, rows, window, experts, segments, joint)
    plus_step(t, dt, z, cmd, own, plus_config_of(config), plus_work_of(work))


@inlined
def _identify(outage, dt, cmd, nav, wind, memory, config, scratch):
    """Let the joint filter, whose parameters are a candidate, take the navigation's state."""
    model = config.model
    joint, given = filter_state(memory.joint, model), filter_config(config.joint, model)
    for k in range(2):
        joint.wind[k] = wind[k]
    if has_diverged(outage, nav, joint, given):
        restart_state(dt, cmd, nav, joint, given)
        return
    correct(dt, cmd, nav, joint, given, model, scratch)
    if lacks_gps(nav):
        place_by_navigation(nav, joint)


@inlined
def _take_mean(state, experts, memory, model):
    """Go on with the mean of the joint filter's parameters and those of the first refit.

    Without GPS the errors of a boat that no population describes add up, and those of the two
    differ. It is no surer than the joint filter was.
    """
    p = model.which.shape[1]
    joint = filter_state(memory.joint, model)
    for i in range(p):
        state.x[N_STATES + i] = 0.5 * (joint.x[N_STATES + i] + experts.params[0, i])
    _give_covariance(joint.P[N_STATES:, N_STATES:], state.P)


@kernel
def plus_step(t, dt, z, cmd, memory, config, work):
    """Take one row, as :meth:`twin.predictors.base.Predictor.update`, and refit when it is time."""
    nav, window, model = (
        as_record(memory.nav, NAVIGATION),
        as_record(memory.window, WINDOW),
        config.model,
    )
    begun, outage = nav.begun > 0.0, nav.gps_age + dt
    tight_step(
        dt,
        z,
        cmd,
        UKFMemory(memory.nav, memory.filter),
        UKFConfig(config.nav, config.filter, model),
        UKFWork(work.nav, work.filter),
    )
    if nav.begun == 0.0:
        return
    state, given = filter_state(memory.filter, model), filter_config(config.filter, model)
    P = nav.P
    given_refit = refit_config(config.refit, model.which.shape[1])
    if not begun:
        start_filter(cmd, nav, filter_state(memory.joint, model), given)
        window.origin, window.halves = t, 0.0
        for k in range(N_STATES):
            window.last[k] = nav.n[k]
        for k in range(3):
            window.slow[k] = nav.n[3 + k]
        for k in range(N_ACT):
            window.last_act[k] = state.act[k]
    else:
        scratch = filter_workspace(work.filter, model.which.shape[1])
        if given_refit.joint != NONE:
            _identify(outage, dt, cmd, nav, state.wind, memory, config, scratch)
        terms = scratch.terms
        _slow_step(dt, nav, window, state, given, terms)
    if nav.gps_age > GAP_GOOD and outage - dt <= GAP_GOOD and given.rest_push < 1.0:
        experts = expert_state(memory.experts, model.which.shape[1])
        if experts.count[SCORED] >= SEGMENTS_MIN and int(experts.count[CHOSEN]) == JOINT:
            _take_mean(state, experts, memory, model)
    fast = (SPEED_GOOD * 0.25 * given.envelope[0]) ** 2
    sure = P[U, U] < fast and P[V, V] < fast and P[PSI, PSI] < HEADING_GOOD**2
    trusted = nav.gps_age <= GAP_GOOD and not is_learning_suspended(nav)
    good = 1.0 if sure and dt <= GAP_GOOD and trusted else 0.0
    _record(t, dt, good, cmd, nav, window, state, memory.rows)
    if t >= window.refit_at and nav.gps_age <= GAP_GOOD:
        _check_forecasts(memory, config, work)
        window.refit_at = t + given_refit.period - 1e-9
        _refit(memory, config, work)
