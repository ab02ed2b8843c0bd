"""Compiled twins of many boats, and their part of the observation."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from twin.channels import MEASUREMENTS, MOTION_AT, PSI, STATE, R, U, V, X, Y
from twin.filters.navigation_state import NAVIGATION
from twin.identification.joint_ukf import (
    filter_config,
    filter_state,
    filter_workspace,
)
from twin.integrity.sensing import ROW, Boats
from twin.integrity.state import INTEGRITY_SETTINGS, SENSORS
from twin.model.dynamics import N_ACT
from twin.model.rollout import GRID, HORIZON_ROWS, HORIZONS, LONG_STEP
from twin.model.structure import N_STATES
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
from twin.predictors.plus_update import PlusWork, plus_config_of
from twin.predictors.ukf import UKFWork
from twin.row_steps import plus_memory, take_plus, take_ukf, ukf_config_of, ukf_memory
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
    "Scene",
    "describe_row",
    "give_row",
    "keep_forecast_flat",
    "observe_plus",
    "observe_ukf",
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
        *((name, ROW[name]) for name in ROW.names or ()),
        ("shown", "f8"),  # time of the last row that was written to the observation, s
        ("covs_due", "f8"),  # time of the next covariances ahead, s
        ("leg", "f8"),  # leg of the path, by the twin's state
        ("path_errors", "f8", len(ERRORS)),  # see usv_gym.envs.tasks.ERRORS
        ("position_error", "f8"),  # distance of the twin's position from the true one, m
        ("now", "f8", (N_STATES, N_STATES)),  # variances of the state, on the diagonal
        ("ahead", "f8", (len(HORIZONS), N_STATES)),  # states at HORIZONS
        ("covs", "f8", (len(HORIZONS), N_STATES, N_STATES)),  # their covariances
        ("spread", "f8", (len(HORIZONS), 3)),  # xx, xy, yy of the displacements' covariances
        ("roll", "f8", 4),  # roll, pitch by the twin, and by the truth, rad
        ("quiet", "f8", len(QUIET_SPANS)),  # probabilities of a quiet deck
        ("hs", "f8"),  # significant height of the waves by the twin, m
    ]
)
"""The row of a boat, and what is noted behind it between observations ..."""

GRADES_AT = record_size(NOTE)
"""... and where that begins which is kept of its forecasts."""

SETTINGS = np.dtype(
    [
        ("health", INTEGRITY_SETTINGS),  # what the sensor checks are given
        ("period", "f8"),  # the covariances ahead are updated this often, s
        ("gps_var", "f8"),  # variance of the drifting part of a fix, m2
        ("show_motion", "f8"),  # 1 where they hold roll, pitch and heave
        ("grading", "f8"),  # 1 where forecasts are graded
        ("forecasting", "f8"),  # 1 where forecasts are made: they are shown, graded or drawn
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


class Scene(NamedTuple):
    """The simulated boats, row by row, and their tasks."""

    rows: Any  # see usv_gym.world.state.BOAT
    points: Any  # (n, P, 2) way points, m
    shared: Any  # see usv_gym.envs.episodes.EPISODES


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
def _give_row(boat, note):
    """Write time, measurements and command of a boat to the row that its twin takes next."""
    note.t = boat.t
    for k in range(len(SENSOR_CHANNELS)):
        note.z[k] = boat.measurement[k]
    for k in range(len(SENSOR_CHANNELS), MOTION_AT):
        note.z[k] = math.nan
    for k in range(MOTION_AT, len(MEASUREMENTS)):
        note.z[k] = boat.measurement[k - MOTION_AT + len(SENSOR_CHANNELS)]
    for k in range(N_ACT):
        note.cmd[k] = boat.reported[k]


@kernel
def give_row(boat, note):
    """Do :func:`_give_row` on flat memory."""
    _give_row(boat, as_record(note, NOTE))


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
def _show_motion(motions, i, s, boat, note, boats, shown, obs):
    """Note roll and pitch, by the twin and by the truth; write their entries, if they are shown."""
    if motions is None:
        return
    memory = as_record(motions[i], MOTION)
    for k in range(2):
        note.roll[k] = memory.attitude.tilt[k, ANGLE]
    note.roll[2], note.roll[3] = boat.state[fr.PHI], boat.state[fr.THETA]
    if shown > 0.0:
        work = as_record(boats.motion_work, MOTION_WORK)
        given = as_record(boats.motion_settings, MOTION_SETTINGS)
        describe_motion(s, note, memory, given, work, obs[len(TWIN_OBSERVATION) :])


@inlined
def _is_due(note, look):
    """Return whether a boat's part of the observation is to be written, and is not yet."""
    if not look or note.shown == note.last:
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
def describe_row(i, s, boats, scene, obs):
    """Write the twin's part of the observation of boat i, whose twin says ``s``."""
    boats, scene = Boats(*boats), Scene(*scene)
    boat, note = as_record(scene.rows[i], BOAT), as_record(boats.rows[i], NOTE)
    settings, shared = as_record(boats.settings, SETTINGS), as_record(scene.shared, EPISODES)
    own = obs[i, int(shared.entries) :]
    describe(s, boat, note, scene.points[i], shared.rules, own)
    _show_motion(boats.motions, i, s, boat, note, boats, settings.show_motion, own)


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
def _look(i, look, boat, note, boats, scene, sources, config, nav, forecast, obs):
    """Forecast, and write the twin's part of a boat's observation, where that is due.

    ``forecast`` is its memory; scratch of sigma points, or draws and their normal numbers.
    """
    settings, shared = as_record(boats.settings, SETTINGS), as_record(scene.shared, EPISODES)
    if not _is_due(note, look):
        return
    out, scratch, draws, normal = forecast
    state, own = filter_state(sources.filter, config.model), obs[i, int(shared.entries) :]
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
    describe(state.x, boat, note, scene.points[i], shared.rules, own)
    if settings.grading > 0.0 and nav.begun > 0.0:
        begin, doubted = beginning(state, out), nav.commands_doubted > 0.0
        row, flat = scene.rows[i], boats.rows[i]
        keep_with_model(
            row, shared.simulation, note, settings.period, begin, doubted, flat, GRADES_AT
        )
    _show_motion(boats.motions, i, state.x, boat, note, boats, settings.show_motion, own)


@inlined
def _buffers_of(out):
    """Return what a forecast is graded with."""
    return Buffers(out.held, out.plan, out.params, out.states, out.act, out.work)


@kernel
def observe_ukf(look, boats, scene, memories, config, work, forecast, obs):
    """Let the twins of boats with a new row take it, and write their parts of the observations.

    The arguments are plain tuples, which numba takes from Python much faster than named ones, and
    few arrays, as it checks each in every call. Without ``look``, the rows are taken and no more.
    """
    boats, scene, config, work = Boats(*boats), Scene(*scene), ukf_config_of(config), UKFWork(*work)
    model, settings = config.model, as_record(boats.settings, SETTINGS)
    given, of_boat = filter_config(config.filter, model), ForecastConfig(config.filter, model, None)
    p = model.which.shape[1]
    out, scratch = forecast_of(forecast[0], p, ROWS, 0), filter_workspace(work.filter, p)
    again = _buffers_of(out)
    for i in range(boats.rows.shape[0]):
        boat, note = as_record(scene.rows[i], BOAT), as_record(boats.rows[i], NOTE)
        _give_row(boat, note)
        memory = ukf_memory(memories, i)
        nav, dt = as_record(memory.nav, NAVIGATION), take_ukf(i, boats, memory, config, work)
        if dt >= 0.0 and settings.grading > 0.0:
            grade_by_model(dt, boat, boats.rows[i], GRADES_AT, given, 0, again)
        sources, ahead = Sources(memory.filter, None, None, None), (out, scratch, None, None)
        _look(i, look, boat, note, boats, scene, sources, of_boat, nav, ahead, obs)


@kernel
def observe_plus(look, boats, scene, memories, config, work, forecast, obs):
    """Do for ``dsw-ukf-plus`` what :func:`observe_ukf` does for ``ukf``."""
    boats, scene, config, work = (
        Boats(*boats),
        Scene(*scene),
        plus_config_of(config),
        PlusWork(*work),
    )
    model, settings = config.model, as_record(boats.settings, SETTINGS)
    given = filter_config(config.filter, model)
    of_boat = ForecastConfig(config.filter, model, config.refit)
    of_mean, of_draws, normal = forecast
    D, p = normal[0].shape
    out = forecast_of(of_mean, p, ROWS, WAVE_STEPS)
    ahead = out, None, draws_of(of_draws, p, ROWS, WAVE_STEPS, D), normal
    again = _buffers_of(out)
    for i in range(boats.rows.shape[0]):
        boat, note = as_record(scene.rows[i], BOAT), as_record(boats.rows[i], NOTE)
        _give_row(boat, note)
        memory = plus_memory(memories, i)
        nav, dt = as_record(memory.nav, NAVIGATION), take_plus(i, boats, memory, config, work)
        if dt >= 0.0 and settings.grading > 0.0:
            grade_by_model(dt, boat, boats.rows[i], GRADES_AT, given, ROWS, again)
        sources = Sources(memory.filter, memory.nav, memory.rows, memory.window)
        _look(i, look, boat, note, boats, scene, sources, of_boat, nav, ahead, obs)
