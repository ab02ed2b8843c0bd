"""One row of DSW-UKF+: observer, window, waves and refit."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from twin.channels import PSI, R, U, V
from twin.filters.navigation_ekf import is_learning_suspended, lacks_gps
from twin.filters.navigation_state import NAVIGATION
from twin.identification.change import change_work
from twin.identification.data_weight import (
    CHOSEN,
    JOINT,
    NOTED,
    SCORED,
    keep_parameters,
    linearised_at,
    score,
    select_data_weight,
    selector_state,
)
from twin.identification.interval_scale import compare_segment, record_work
from twin.identification.joint_ukf import (
    filter_config,
    filter_state,
    filter_workspace,
)
from twin.identification.prediction_error import (
    ACT,
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
from twin.identification.window import WINDOW, all_good, last_row, observer_gain
from twin.model.dynamics import N_ACT, drive, rates_over_ground
from twin.model.rollout import GRID, rotate_body_velocity
from twin.model.structure import N_STATES, ModelTerms, current_of
from twin.predictors.baselines import GAP_MAX
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
from usv_kernel.arrays import take
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import as_record

__all__ = [
    "SEGMENTS_MIN",
    "UNFIT",
    "WAVE_WORK",
    "PlusConfig",
    "PlusMemory",
    "PlusWork",
    "plus_config_of",
    "plus_step",
    "refit_work",
    "update_plus",
]

SPEED_SD_MAX = 0.25
HEADING_SD_MAX_RAD = 0.1
ROW_AGE_MAX_S = 2.5
"""Largest standard deviations of velocity (nominal speeds) and heading of a fitted row, and
greatest age of the row before it."""

UNFIT = (
    f"rows more than {ROW_AGE_MAX_S:g} s apart",
    f"no fix for {ROW_AGE_MAX_S:g} s",
    "sensors or commands in doubt",
    f"sd of the speed above {SPEED_SD_MAX:g} nominal speeds",
    f"sd of the heading above {math.degrees(HEADING_SD_MAX_RAD):.1f} degrees",
)
"""Why a row is not fitted: its GOOD is minus the index."""

WAVE_SPAN_S = 60.0
"""Window of the residuals from which waves are predicted and drawn."""

SEGMENTS_MIN = 3
"""Least number of segments for a refit."""


class PlusMemory(NamedTuple):
    """What a predictor remembers, flat; in a batch each row is a boat's."""

    nav: Any  # see NAVIGATION
    filter: Any  # see FilterState
    rows: Any  # (M, 20) rows of the window; see prediction_error.COLUMNS
    window: Any  # see WINDOW
    selector: Any  # see SelectorState
    segments: Any  # see SegmentState
    joint: Any  # see FilterState; of the joint filter, which identifies only


class PlusConfig(NamedTuple):
    """What a predictor is given of its boat."""

    nav: Any  # see NAVIGATION_SETTINGS
    filter: Any  # see FilterConfig
    model: Any  # ModelTerms
    refit: Any  # see RefitConfig
    joint: Any  # see FilterConfig; of the joint filter


class PlusWork(NamedTuple):
    """Scratch, which predictors of like boats can share."""

    nav: Any  # see NAVIGATION_WORK
    filter: Any  # see FilterWorkspace
    line: Any  # see LineariseWork
    solve: Any  # see SegmentWork
    change: Any  # see ChangeWork
    waves: Any  # of _fit_waves
    spread: Any  # see RecordWork


@inlined
def refit_work(work, p, capacity):
    """Open the scratch of a refit."""
    return RefitWork(
        linearise_work(work.line, p),
        segment_work(work.solve, p, capacity),
        change_work(work.change, p, capacity),
        record_work(work.spread, p),
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
def _record(t, dt, good, nav, window, state, rows):
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
            row[GOOD] = good
        window.halves += 1.0
    for k in range(N_STATES):
        last[k] = n[k]
    for k in range(N_ACT):
        last_act[k] = act[k]


@kernel
def _add_segments(rows, window, selector, segments, nav, config, model, work):
    """Add the segments that are complete; return the number of starts that were tried."""
    newest, tried = last_row(window), 0
    # older rows have been overwritten, nearly all of them after a long gap
    start = max(int(window.next_start), newest - rows.shape[0] + 1)
    while start + config.steps < newest:
        if all_good(start, start + config.steps, rows):
            at = selector.params[linearised_at(selector)]
            add(start, rows, at, segments, config, model, work)
            if start <= selector.count[NOTED]:  # else it began and ended between two refits
                score(start, rows, selector, config, model, work)
                slot = start // config.spacing % selector.past.shape[0]
                xi, covs = selector.past[slot, int(selector.count[CHOSEN])], (segments.cov, nav.P)
                compare_segment(start, rows, xi, covs, window, config, model, work)
        start += config.spacing
        tried += 1
    window.next_start = start
    return tried


_WAVE_ROWS = round(WAVE_SPAN_S / GRID) + 1


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


WAVE_WORK = 5 * _WAVE_ROWS + sector_work_size(_WAVE_ROWS)
"""Length of the scratch of the waves."""


@kernel
def _fit_waves(rows, window, config, work):
    """Fit autoregressions to the last residuals: by sector for the draws, and of the moment."""
    newest, count = last_row(window), 0
    first = max(newest - min(round(WAVE_SPAN_S / GRID), config.span), 0)
    N = newest + 1 - first
    scratch = _waves_work(work, N)
    w, psi, good = scratch.w, scratch.psi, scratch.good
    for k in range(N):
        row = rows[(first + k) % rows.shape[0]]
        psi[k], good[k] = row[STATE + PSI], row[GOOD]
        for i in range(3):
            w[k, i] = row[STATE + U + i] - row[LOW + i] if good[k] > 0.0 else 0.0
        count += 1 if good[k] > 0.0 else 0
    if count <= 5 * ORDER:
        return
    fit_sector_ar(w, psi, good, window.sectors[:], scratch.fit)
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


@kernel
def _refit(memory, config, work):
    """Bring segments, waves and refits up to date, and write the best parameters to the filter."""
    model, rows, window = config.model, memory.rows, as_record(memory.window, WINDOW)
    p = model.which.shape[1]
    given = refit_config(config.refit, p)
    selector = selector_state(memory.selector, p, given.steps, given.spacing)
    segments = segment_state(memory.segments, p, given.capacity)
    scratch = refit_work(work, p, given.capacity)
    nav = as_record(memory.nav, NAVIGATION)
    _add_segments(rows, window, selector, segments, nav, given, model, scratch)
    newest = last_row(window)
    count = discard_before(newest - given.span, segments)
    _fit_waves(rows, window, given, work.waves)
    joint = filter_state(memory.joint, model)
    for k in range(p):
        selector.params[JOINT, k] = joint.x[N_STATES + k]
    for start in range(int(window.next_start), newest + 1, given.spacing):
        keep_parameters(start, given.spacing, selector)
    if count < SEGMENTS_MIN:
        return
    at = selector.params[linearised_at(selector)]
    relinearise(given.relinearised, rows, at, segments, given, model, scratch)
    tight = filter_state(memory.filter, model)
    select_data_weight(newest, selector, segments, given, model, scratch)
    if int(selector.count[CHOSEN]) == JOINT:
        for i in range(p):
            for k in range(p):
                segments.cov[i, k] = joint.P[N_STATES + i, N_STATES + k]
    for i in range(p):
        tight.x[N_STATES + i] = segments.params[i]
    _give_covariance(segments.cov, tight.P)


@inlined
def plus_config_of(config):
    """Return a configuration by name from a plain tuple."""
    nav, tight, model, refit, joint = config
    return PlusConfig(nav, tight, ModelTerms(*model), refit, joint)


@kernel
def update_plus(t, dt, z, cmd, memory, config, work):
    """Do :func:`plus_step` with plain tuples, which numba takes from Python much faster."""
    plus_step(t, dt, z, cmd, PlusMemory(*memory), plus_config_of(config), PlusWork(*work))


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
def _average_parameters(state, selector, memory, model):
    """Use the mean of the joint filter's parameters and those of the first refit.

    Without GPS the errors of a boat that no population describes add up, and those of the two
    differ. It is no surer than the joint filter was.
    """
    p = model.which.shape[1]
    joint = filter_state(memory.joint, model)
    for i in range(p):
        state.x[N_STATES + i] = 0.5 * (joint.x[N_STATES + i] + selector.params[0, i])
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
    refit = refit_config(config.refit, model.which.shape[1])
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
        if refit.joint != NONE:
            _identify(outage, dt, cmd, nav, state.wind, memory, config, scratch)
        terms = scratch.terms
        _slow_step(dt, nav, window, state, given, terms)
    if given.rest_push < 1.0 and nav.gps_age > ROW_AGE_MAX_S and outage - dt <= ROW_AGE_MAX_S:
        selector = selector_state(memory.selector, model.which.shape[1], refit.steps, refit.spacing)
        if selector.count[SCORED] >= SEGMENTS_MIN and int(selector.count[CHOSEN]) == JOINT:
            _average_parameters(state, selector, memory, model)
    fast = (SPEED_SD_MAX * 0.25 * given.envelope[0]) ** 2
    good = 1.0
    if P[PSI, PSI] >= HEADING_SD_MAX_RAD**2:
        good = -4.0
    if P[U, U] >= fast or P[V, V] >= fast:
        good = -3.0
    if is_learning_suspended(nav):
        good = -2.0
    if nav.gps_age > ROW_AGE_MAX_S:
        good = -1.0
    if dt > ROW_AGE_MAX_S:
        good = 0.0
    _record(t, dt, good, nav, window, state, memory.rows)
    if t >= window.refit_at and nav.gps_age <= ROW_AGE_MAX_S:
        window.refit_at = t + refit.period - 1e-9
        _refit(memory, config, work)
