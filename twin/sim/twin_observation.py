"""Compiled twins of many boats, and their part of the observation."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from twin.channels import MEASUREMENTS, MOTION_AT, PSI, STATE, R, U, V, X, Y
from twin.filters.navigation_state import NAVIGATION, NAVIGATION_SETTINGS, NAVIGATION_WORK
from twin.identification.joint_ukf import (
    filter_config,
    filter_state,
    filter_workspace,
)
from twin.integrity.checks import write_restart
from twin.integrity.sensing import sense
from twin.integrity.state import INTEGRITY, INTEGRITY_SETTINGS, SENSORS
from twin.model.dynamics import N_ACT
from twin.model.rollout import GRID, HORIZON_ROWS, HORIZONS, LONG_STEP
from twin.model.structure import N_STATES, ModelTerms
from twin.motion.deck_motion import (
    MOTION,
    MOTION_SETTINGS,
    MOTION_WORK,
    Z90,
    accelerations_ahead,
)
from twin.motion.forecast import forecast_motion, quiet_probabilities
from twin.motion.forecast_state import HORIZONS as HORIZONS_OF_MOTION
from twin.motion.forecast_state import N_CHANNELS, PITCH, QUIET_SPANS
from twin.motion.sea_estimate import DIRECTION_SD_MAX_RAD, sea_of
from twin.motion.state import ANGLE
from twin.predictors.forecast import (
    ForecastConfig,
    Sources,
    beginning,
    draw_ahead,
    draws_of,
    forecast_of,
    limit_covariances,
    mean_ahead,
    mean_products,
    sigma_covariances,
)
from twin.predictors.plus_update import PlusMemory, PlusWork, plus_config_of, plus_step
from twin.predictors.ukf import UKFConfig, UKFMemory, UKFWork, tight_step
from twin.sim.forecast_scores import (
    Buffers,
    grade_by_model,
    is_in_loss,
    keep_forecast,
    keep_with_model,
)
from usv_gym.envs.episodes import BOUND, EPISODES, TILT_SCALE
from usv_gym.envs.observation import (
    COS_COURSE_ERROR,
    COS_HEADING,
    COS_NEXT_TURN,
    OFF_PATH,
    SHAFTS,
    SIN_COURSE_ERROR,
    SIN_HEADING,
    SIN_NEXT_TURN,
    SURGE,
    SWAY,
    TO_END,
    YAW_RATE,
)
from usv_gym.envs.scoring import COURSE_ERROR, CROSS_TRACK, ERRORS, NEXT_TURN, TO_GO, follow
from usv_gym.physics import frames as fr
from usv_gym.world.state import BOAT
from usv_kernel.arrays import shaped
from usv_kernel.channels import SENSOR_CHANNELS
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import as_record, record_size
from usv_kernel.scalar import sincos

__all__ = [
    "ATTITUDE_OBSERVATION",
    "GRADES_AT",
    "HEALTH_OBSERVATION",
    "NOTE",
    "ROWS",
    "SETTINGS",
    "TRUST",
    "TWIN_OBSERVATION",
    "WAVE_STEPS",
    "Boats",
    "describe_flat",
    "describe_motion_flat",
    "keep_forecast_flat",
    "note_attitude_flat",
    "observe_plus",
    "observe_ukf",
    "take_row",
]

_SD = ("sd_forward", "sd_starboard", "sd_heading", "sd_surge", "sd_sway", "sd_yaw_rate")

TWIN_OBSERVATION = (
    *("twin_surge", "twin_sway", "twin_yaw_rate", "twin_cos_heading", "twin_sin_heading"),
    *("twin_cross_track", "twin_to_go", "twin_cos_course_error", "twin_sin_course_error"),
    *("twin_cos_next_turn", "twin_sin_next_turn"),
    *(f"twin_{name}" for name in _SD),
    *(
        f"ahead_{h:g}s_{name}"
        for h in HORIZONS.tolist()
        for name in (
            *("forward", "starboard", "cos_turn", "sin_turn", "surge", "sway", "yaw_rate"),
            *_SD,
        )
    ),
)
"""Names of the entries that the twin adds; scales in :class:`twin.sim.wrapper.TwinObservation`."""

HEALTH_OBSERVATION = tuple(f"health_{sensor}" for sensor in SENSORS)
"""Names of the entries that the set ``twin_health`` adds behind those."""

MOTION_ROWS = tuple(1 + int(np.searchsorted(HORIZONS_OF_MOTION, h)) for h in (0.5, 1, 2, 3, 5))
"""Rows of a forecast of roll, pitch and heave that are shown."""

TRUST = np.array([0.0, 1.0, 0.5, 0.0])
"""Their values for each of ``twin.integrity.state.STATUSES``."""

ROWS = int(HORIZON_ROWS[-1]) + 1
"""Rows of the plan of a forecast."""

WAVE_STEPS = round(ROWS * LONG_STEP / GRID)
"""Grid steps of its waves."""

NOTE = np.dtype(
    [
        ("last", "f8"),  # time of the last row, s; NaN before the first
        ("begun", "f8"),  # time of the first row, s
        ("shown", "f8"),  # time of the last row that was written to the observation, s
        ("covs_due", "f8"),  # time of the next covariances ahead, s
        ("leg", "f8"),  # leg of the path, by the twin's state
        ("path_errors", "f8", len(ERRORS)),  # see usv_gym.envs.tasks.ERRORS
        ("position_error", "f8"),  # distance of the twin's position from the true one, m
        ("z", "f8", len(MEASUREMENTS)),  # measurement row
        ("used", "f8", len(MEASUREMENTS)),  # the same without samples of excluded sensors
        ("trusted", "f8", N_ACT),  # command that the twin takes
        ("now", "f8", (N_STATES, N_STATES)),  # variances of the state, on the diagonal
        ("ahead", "f8", (len(HORIZONS), N_STATES)),  # states at HORIZONS
        ("covs", "f8", (len(HORIZONS), N_STATES, N_STATES)),  # their covariances
        ("spread", "f8", (len(HORIZONS), 3)),  # xx, xy, yy of the displacements' covariances
        ("roll", "f8", 4),  # roll, pitch by the twin, and by the truth, rad
        ("quiet", "f8", len(QUIET_SPANS)),  # probabilities of a quiet deck
        ("hs", "f8"),  # significant height of the waves by the twin, m
        ("health", INTEGRITY),  # what the sensor checks remember
    ]
)
"""What is noted of each boat between observations ..."""

GRADES_AT = record_size(NOTE)
"""... and where that begins which is kept of its forecasts."""

SETTINGS = np.dtype(
    [
        ("period", "f8"),  # the covariances ahead are updated this often, s
        ("gps_var", "f8"),  # variance of the drifting part of a fix, m2
        ("look", "f8"),  # 1 where observations are to be written
        ("show_motion", "f8"),  # 1 where they hold roll, pitch and heave
        ("grading", "f8"),  # 1 where forecasts are graded
        ("forecasting", "f8"),  # 1 where forecasts are made: they are shown, graded or drawn
        ("health", INTEGRITY_SETTINGS),  # what the sensor checks are given
    ]
)
"""What all boats of a batch have in common."""


ATTITUDE_OBSERVATION = (
    *("twin_roll", "twin_pitch", "twin_roll_rate", "twin_pitch_rate"),
    *("twin_heave", "twin_deck_speed"),
    *(f"sd_{name}" for name in ("roll", "pitch", "heave", "deck_speed")),
    *(
        f"ahead_{HORIZONS_OF_MOTION[row - 1]:g}s_{part}{name}"
        for row in MOTION_ROWS
        for name in ("roll", "pitch", "heave", "deck_speed")
        for part in ("", "half_width_")
    ),
    *(f"quiet_{span:g}s" for span in QUIET_SPANS),
    *("sea_height", "sea_period", "cos_sea", "sin_sea"),
)
"""Names of the entries that the set ``twin_attitude`` adds behind those, with six degrees of
freedom."""


class Boats(NamedTuple):
    """The simulated boats, row by row, and what is noted of each."""

    rows: Any  # see usv_gym.world.state.BOAT
    points: Any  # (n, P, 2) way points, m
    notes: Any  # see NOTE
    shared: Any  # see usv_gym.envs.episodes.EPISODES
    settings: Any  # see SETTINGS
    # None with three degrees of freedom
    motions: Any  # (n, size of MOTION)
    motion_settings: Any  # see MOTION_SETTINGS
    motion_work: Any  # see MOTION_WORK


_NOW_SD = SHAFTS
"""Where the standard deviations of the state now begin, after the entries of a true state ..."""
_AHEAD_AT = _NOW_SD + len(STATE)
"""... and those of the horizons, each with these:"""
_FORWARD, _STARBOARD, _COS_TURN, _SIN_TURN, _VELOCITIES = range(5)
_AHEAD_SD = _VELOCITIES + 3
_A_HORIZON = _AHEAD_SD + len(STATE)


@inlined
def _spread(cov, heading, length, speed, out, at):
    """Write the six standard deviations of a state, position turned into the body frame."""
    c, s = heading
    a, b, d = cov[X, X], cov[X, Y], cov[Y, Y]
    out[at] = math.sqrt(max(c * c * a + 2.0 * c * s * b + s * s * d, 0.0)) / length
    out[at + 1] = math.sqrt(max(s * s * a - 2.0 * c * s * b + c * c * d, 0.0)) / length
    out[at + PSI] = math.sqrt(max(cov[PSI, PSI], 0.0))
    out[at + U] = math.sqrt(max(cov[U, U], 0.0)) / speed
    out[at + V] = math.sqrt(max(cov[V, V], 0.0)) / speed
    out[at + R] = math.sqrt(max(cov[R, R], 0.0))


@inlined
def _next_row(boat, note):
    """Write a boat's measurements to its note; return the time since the row before, or -1.

    -1 stands for no new row: the boat is idle, or this twin is of another kind (infinite time).
    """
    t, last = boat.t, note.last
    if t == last or last == math.inf:
        return -1.0
    if not math.isfinite(last):
        note.begun = t
    note.last = t
    for k in range(len(SENSOR_CHANNELS)):
        note.z[k] = boat.measurement[k]
    for k in range(len(SENSOR_CHANNELS), MOTION_AT):
        note.z[k] = math.nan
    for k in range(MOTION_AT, len(MEASUREMENTS)):
        note.z[k] = boat.measurement[k - MOTION_AT + len(SENSOR_CHANNELS)]
    return t - last if math.isfinite(last) else 0.0


@kernel
def take_row(boat, note):
    """Do :func:`_next_row` on flat memory."""
    return _next_row(boat, as_record(note, NOTE))


@inlined
def note_attitude(boat, note, attitude):
    """Note roll and pitch, by the twin and by the truth."""
    note.roll[0], note.roll[1] = attitude.tilt[0, ANGLE], attitude.tilt[1, ANGLE]
    note.roll[2], note.roll[3] = boat.state[fr.PHI], boat.state[fr.THETA]


@kernel
def note_attitude_flat(boat, note, memory):
    """Do :func:`note_attitude` on flat memory."""
    note_attitude(boat, as_record(note, NOTE), as_record(memory, MOTION).attitude)


@kernel
def describe_motion(s, note, memory, given, work, obs):
    """Write roll, pitch and heave, their forecasts, and the sea.

    Parameters
    ----------
    s : ndarray, shape (6,)
        State by the twin.
    note : record of ``NOTE``
        Its ``ahead`` is read, ``quiet`` and ``hs`` are written.
    memory, given, work : record
        Of ``MOTION`` and so on.
    obs : ndarray, shape (57,)
        Written.
    """
    now, forecast, sea = memory.attitude, memory.forecast, memory.sea
    mean, var = work.mean, work.var
    accelerations_ahead(HORIZONS, note.ahead, s, work.ahead)
    forecast_motion(work.ahead, now, forecast, given.forecast, work.forecast, mean, var)
    quiet_probabilities(mean, var, forecast, given.forecast, note.quiet)
    obs[0], obs[1] = mean[0, 0] / TILT_SCALE, mean[0, 1] / TILT_SCALE
    obs[2], obs[3] = now.rate[0], now.rate[1]
    obs[4], obs[5] = mean[0, 2], mean[0, 3]
    for c in range(N_CHANNELS):
        scale = TILT_SCALE if c <= PITCH else 1.0
        obs[6 + c] = math.sqrt(max(var[0, c], 0.0)) / scale
    at = 6 + N_CHANNELS
    for row in MOTION_ROWS:
        for c in range(N_CHANNELS):
            scale = TILT_SCALE if c <= PITCH else 1.0
            obs[at] = mean[row, c] / scale
            obs[at + 1] = Z90 * math.sqrt(max(var[row, c], 0.0)) / scale
            at += 2
    for k in range(len(QUIET_SPANS)):
        obs[at + k] = note.quiet[k]
    at += len(QUIET_SPANS)
    hs, period, to, to_sd = sea_of(sea)
    known, directed = math.isfinite(hs), to_sd < DIRECTION_SD_MAX_RAD
    note.hs = hs if known else 0.0
    side, ahead = sincos(to - s[PSI] if directed else 0.0)
    obs[at] = hs if known else 0.0
    obs[at + 1] = 0.1 * period if known else 0.0
    obs[at + 2], obs[at + 3] = (ahead, side) if directed else (0.0, 0.0)
    for j in range(obs.shape[0]):
        obs[j] = min(max(obs[j], -BOUND), BOUND)


@inlined
def _note_motion(i, motions, boat, note):
    """Do :func:`note_attitude`, if there is any."""
    if motions is None:
        return
    note_attitude(boat, note, as_record(motions[i], MOTION).attitude)


@inlined
def _show_motion(i, s, note, boats, motions, first, obs):
    """Write the entries of roll, pitch and heave of a boat, if they are wanted."""
    if motions is None:
        return
    if as_record(boats.settings, SETTINGS).show_motion > 0.0:
        memory = as_record(motions[i], MOTION)
        work = as_record(boats.motion_work, MOTION_WORK)
        given = as_record(boats.motion_settings, MOTION_SETTINGS)
        describe_motion(s, note, memory, given, work, obs[first + len(TWIN_OBSERVATION) :])


@kernel
def describe_motion_flat(s, note, memory, given, work, obs):
    """Do :func:`describe_motion` on flat memory."""
    describe_motion(
        s,
        as_record(note, NOTE),
        as_record(memory, MOTION),
        as_record(given, MOTION_SETTINGS),
        as_record(work, MOTION_WORK),
        obs,
    )


@inlined
def _is_due(note, look):
    """Return whether a boat's part of the observation is to be written, and is not yet."""
    if look == 0.0 or note.shown == note.last:
        return False
    note.shown = note.last
    return True


@inlined
def _hold(command, plan):
    """Write a plan that holds a command."""
    for row in range(plan.shape[0]):
        for k in range(N_ACT):
            plan[row, k] = command[k]


@inlined
def describe(s, boat, note, points, rules, o):
    """Write the twin's part ``o`` of one boat's observation, from its state and what is noted."""
    errors, ahead, speed, psi = note.path_errors[:], note.ahead, rules.speed, s[PSI]
    d, c = sincos(psi)
    note.leg = follow(s[X], s[Y], psi, points, int(note.leg), rules.reach, errors)
    o[SURGE], o[SWAY], o[YAW_RATE] = s[U] / speed, s[V] / speed, s[R]
    o[COS_HEADING], o[SIN_HEADING] = c, d
    o[OFF_PATH], o[TO_END] = errors[CROSS_TRACK] / rules.unit, 0.1 * errors[TO_GO] / rules.unit
    o[SIN_COURSE_ERROR], o[COS_COURSE_ERROR] = sincos(errors[COURSE_ERROR])
    o[SIN_NEXT_TURN], o[COS_NEXT_TURN] = sincos(errors[NEXT_TURN])
    _spread(note.now, (c, d), rules.unit, speed, o, _NOW_SD)
    at = _AHEAD_AT
    for j in range(ahead.shape[0]):
        m = ahead[j]
        length = speed * HORIZONS[j]
        dx, dy, turn = m[X] - s[X], m[Y] - s[Y], m[PSI] - psi
        o[at + _FORWARD] = (dx * c + dy * d) / length
        o[at + _STARBOARD] = (dy * c - dx * d) / length
        o[at + _SIN_TURN], o[at + _COS_TURN] = sincos(turn)
        o[at + _VELOCITIES], o[at + _VELOCITIES + 1] = m[U] / speed, m[V] / speed
        o[at + _VELOCITIES + 2] = m[R]
        _spread(note.covs[j], (c, d), length, speed, o, at + _AHEAD_SD)
        at += _A_HORIZON
    for j in range(len(TWIN_OBSERVATION)):  # more may follow
        o[j] = min(max(o[j], -BOUND), BOUND)
    note.position_error = math.hypot(s[X] - boat.state[fr.X], s[Y] - boat.state[fr.Y])


@kernel
def describe_flat(s, boat, note, points, rules, o):
    """Do :func:`describe` on flat memory."""
    describe(s, boat, as_record(note, NOTE), points, rules, o)


@inlined
def _write_variances(P, P_nav, gps_var, now):
    """Write how uncertain the state is now."""
    for i in range(N_STATES):
        now[i, i] = P[i, i] + P_nav[i, i] + (gps_var if i < 2 else 0.0)


@inlined
def _write_spread(cov, start_cov, spread):
    """Write xx, xy, yy of the covariance of a displacement: of a place, less that of the start."""
    spread[0] = cov[X, X] - start_cov[0]
    spread[1] = cov[X, Y] - start_cov[1]
    spread[2] = cov[Y, Y] - start_cov[2]


@kernel
def keep_forecast_flat(row, shared, notes, start, doubted, period):
    """Keep the forecast that stands in a boat's note, without a model."""
    boat, note = as_record(row, BOAT), as_record(notes, NOTE)
    happens = is_in_loss(boat.t, row, as_record(shared, EPISODES).simulation), doubted
    keep_forecast(start, boat, note, happens, period, notes, GRADES_AT, (0, 0))


_NAV_WORK = record_size(NAVIGATION_WORK)
_NAV_SETTINGS = record_size(NAVIGATION_SETTINGS)


@inlined
def _split(memory, size):
    """Return the first numbers of an array, and the others."""
    return shaped(memory, 0, (size,)), shaped(memory, size, (memory.shape[0] - size,))


_DRAWN_ROWS = HORIZON_ROWS + 1


@inlined
def _sigma_ahead(steps, note, gps_var, nav, sources, config, out, scratch):
    """Note the covariances of a forecast by sigma points; nothing without ``scratch``."""
    if scratch is None:
        return
    model = config.model
    state, given = filter_state(sources.filter, model), filter_config(config.filter, model)
    sigma_covariances(LONG_STEP, steps, state, given, out, scratch)
    for row in range(ROWS):
        for j in range(N_STATES):
            for k in range(N_STATES):
                out.covs[row, j, k] += nav.P[j, k]
        for j in range(2):
            out.covs[row, j, j] += gps_var
    limit_covariances(out.covs, note.now[:], LONG_STEP, given.envelope)
    place = note.now[X, X], state.P[X, Y] + nav.P[X, Y], note.now[Y, Y]
    for h in range(HORIZON_ROWS.shape[0]):
        cov = out.covs[HORIZON_ROWS[h]]
        _write_spread(cov, place, note.spread[h])
        for j in range(N_STATES):
            for k in range(N_STATES):
                note.covs[h, j, k] = cov[j, k]


@inlined
def _draws_ahead(note, gps_var, nav, sources, config, out, draws, normal):
    """Note the covariances of a forecast by draws; nothing without any."""
    if draws is None:
        return
    draw_ahead((out, out), LONG_STEP, sources, config, normal, draws)
    covs = note.covs[:]
    mean_products(draws.deviations, _DRAWN_ROWS, covs)
    for h in range(HORIZON_ROWS.shape[0]):
        _write_spread(covs[h], (0.0, 0.0, 0.0), note.spread[h])
        for j in range(2):
            for k in range(2):
                covs[h, j, k] += nav.P[j, k]
            covs[h, j, j] += gps_var


@inlined
def _check(dt, i, boat, note, nav, boats, settings):
    """Do what comes before a twin takes a row."""
    health, given, state, ready = note.health, settings.health, nav.n[:N_STATES], nav.begun > 0.0
    z, cmd, used, trusted = note.z[:], boat.reported[:], note.used[:], note.trusted[:]
    motion = boats.motions, boats.motion_settings, boats.motion_work
    sense(note.last, dt, z, cmd, state, ready, health, given, i, motion, used, trusted)
    _note_motion(i, boats.motions, boat, note)
    nav.commands_doubted, nav.motion_doubted = health.commands_doubted, health.motion_doubted
    if health.switched > 0.0:
        write_restart(health, given, nav.restart)


@inlined
def _look(i, boat, note, boats, sources, config, nav, forecast, obs):
    """Forecast, and write the twin's part of a boat's observation, where that is due.

    ``forecast`` is its memory; scratch of sigma points, or draws and their normal numbers.
    """
    settings, shared = as_record(boats.settings, SETTINGS), as_record(boats.shared, EPISODES)
    if not _is_due(note, settings.look):
        return
    out, scratch, draws, normal = forecast
    state, first = filter_state(sources.filter, config.model), int(shared.entries)
    _write_variances(state.P, nav.P, settings.gps_var, note.now)
    if settings.forecasting > 0.0:
        _hold(note.trusted[:], out.held)
        steps = mean_ahead(out.held, LONG_STEP, sources, config, out)
        for h in range(HORIZON_ROWS.shape[0]):
            for j in range(N_STATES):
                note.ahead[h, j] = out.states[0, HORIZON_ROWS[h], j]
        if note.last >= note.covs_due:
            note.covs_due = note.last + settings.period - 1e-9
            gps_var = settings.gps_var
            _sigma_ahead(steps, note, gps_var, nav, sources, config, out, scratch)
            _draws_ahead(note, gps_var, nav, sources, config, out, draws, normal)
    describe(state.x, boat, note, boats.points[i], shared.rules, obs[i, first:])
    if settings.grading > 0.0 and nav.begun > 0.0:
        begin = beginning(state, out)
        keep_with_model(i, boats, note, settings.period, begin, nav, GRADES_AT)
    _show_motion(i, state.x, note, boats, boats.motions, first, obs[i])


@inlined
def _buffers_of(out):
    """Return what a forecast is graded with."""
    return Buffers(out.held, out.plan, out.params, out.states, out.act, out.work)


@kernel
def observe_ukf(boats, memories, config, work, forecast, obs):
    """Let the twins of boats with a new row take it, and write their parts of the observations.

    The arguments are plain tuples, which numba takes from Python much faster than named ones, and
    few arrays, as it checks each in every call.
    """
    boats, work = Boats(*boats), UKFWork(*_split(work, _NAV_WORK))
    values, which, limits, hull = config
    of_nav, of_filter = _split(values, _NAV_SETTINGS)
    config = UKFConfig(of_nav, of_filter, ModelTerms(which, limits, hull))
    model, settings = config.model, as_record(boats.settings, SETTINGS)
    given, of_boat = filter_config(of_filter, model), ForecastConfig(of_filter, model, None)
    out = forecast_of(forecast, which.shape[1], ROWS, 0)
    scratch, again = filter_workspace(work.filter, which.shape[1]), _buffers_of(out)
    for i in range(boats.rows.shape[0]):
        boat, note = as_record(boats.rows[i], BOAT), as_record(boats.notes[i], NOTE)
        memory = UKFMemory(memories[0][i], memories[1][i])
        nav, dt = as_record(memory.nav, NAVIGATION), _next_row(boat, note)
        if dt >= 0.0:
            _check(dt, i, boat, note, nav, boats, settings)
            tight_step(dt, note.used[:], note.trusted[:], memory, config, work)
            if settings.grading > 0.0:
                grade_by_model(dt, boat, boats.notes[i], GRADES_AT, given, 0, again)
        sources = Sources(memory.filter, None, None, None)
        _look(i, boat, note, boats, sources, of_boat, nav, (out, scratch, None, None), obs)


@kernel
def observe_plus(boats, memories, config, work, forecast, obs):
    """Do for ``dsw-ukf-plus`` what :func:`observe_ukf` does for ``ukf``."""
    boats, config, work = Boats(*boats), plus_config_of(config), PlusWork(*work)
    model, settings = config.model, as_record(boats.settings, SETTINGS)
    given = filter_config(config.filter, model)
    of_boat = ForecastConfig(config.filter, model, config.refit)
    of_mean, of_draws, normal = forecast
    D, p = normal[0].shape
    out = forecast_of(of_mean, p, ROWS, WAVE_STEPS)
    ahead = out, None, draws_of(of_draws, p, ROWS, WAVE_STEPS, D), normal
    again = _buffers_of(out)
    for i in range(boats.rows.shape[0]):
        boat, note = as_record(boats.rows[i], BOAT), as_record(boats.notes[i], NOTE)
        navs, tight, rows, window, selector, segments, joint = memories
        memory = PlusMemory(
            navs[i], tight[i], rows[i], window[i], selector[i], segments[i], joint[i]
        )
        nav, dt = as_record(memory.nav, NAVIGATION), _next_row(boat, note)
        if dt >= 0.0:
            _check(dt, i, boat, note, nav, boats, settings)
            plus_step(note.last, dt, note.used[:], note.trusted[:], memory, config, work)
            if settings.grading > 0.0:
                grade_by_model(dt, boat, boats.notes[i], GRADES_AT, given, ROWS, again)
        sources = Sources(memory.filter, memory.nav, memory.rows, memory.window)
        _look(i, boat, note, boats, sources, of_boat, nav, ahead, obs)
