"""DSW-UKF+: the twin that refits its model to the last minutes, and says how sure it is.

Four things work together:

1. the tight navigation filter and the joint UKF of :class:`twin.identifier.UKFPredictor`, which
   carry state and parameters from row to row, through losses of sensors as well;
2. the refit of :mod:`twin.pem`: every second the parameters (and their covariance) become those
   that would have foretold the last minutes best, starting from a prior with full covariance; the
   joint filter goes on from there;
3. a low-frequency observer, the model held to the navigation's velocities by a gain of 0.5 /s:
   predictions start from it, because waves are no part of the model, and what it leaves of the
   measured velocities is taken for waves (:mod:`twin.residual`);
4. bands from draws: of the parameters, of the start, and of the waves to come, which are those of
   the headings ahead, and move the low-frequency motion as the observer would.

Where the predicted motion leaves what the boat was ever seen to do, the parameters are drawn back
to the prior until it does not (:data:`SHRINK`).

Source: twin.md section 10 B.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.dense import cholesky
from twin.identifier import (
    BEGUN,
    Beliefs,
    UKFPredictor,
    nav_parts,
    parts,
    plain_settings,
    rooms,
    scale_plan,
    tight_step,
)
from twin.model import (
    LOOK_AHEAD,
    N_ACT,
    N_STATES,
    ROOM,
    look_ahead,
    model_of,
    roll_out,
    roll_outs,
    slip,
)
from twin.particulars import STUDY_LENGTH, STUDY_SPEED, Particulars
from twin.pem import (
    ACT,
    COLUMNS,
    GOOD,
    GRID,
    LOW,
    MIDDLE,
    RULES,
    STATE,
    STEPS,
    WIND,
    RefitSettings,
    Segments,
    add,
    believed,
    drop,
    memory_size,
    renew,
    roll_room,
)
from twin.predictor import GAP_MAX, Prediction, finer
from twin.prior import population_prior
from twin.residual import (
    FACTOR,
    ORDER,
    SECTOR_SIZE,
    SECTORS,
    between,
    describe_sectors,
    fit_waves,
    foretell_waves,
    likeness,
    sector_room,
    simulate_waves,
)
from twin.rivals import Rivals, judge, note, record_size, settle
from twin.structure import accelerations, state_terms, thrust_terms
from usv_kernel import in_python, kernel
from usv_kernel.views import shaped

__all__ = ["PlusPredictor", "refit_settings"]

Array = NDArray[Any]

OBSERVER_GAIN = 0.5
"""Of the low-frequency observer, 1/s. By it, too, the velocities of a draw take on its waves: what
was measured is the observer's motion and what that left, and so will be what comes."""
TOLD_GAIN = 0.25
"""The same for the waves foretold, 1/s: half of them carry the boat to and fro, and pass."""
SPEED_GOOD, HEADING_GOOD, GAP_GOOD = 0.25, 0.1, 2.5
"""A row may be fitted if the navigation is as sure as this of velocity (usual speeds) and
heading (rad), and if the row before it is not older (s)."""
UNHURRIED = 1.5
"""Time to sail a length, in units of the study boat's, from which on segments are too alike."""
SHRINK = (1.0, 0.5, 0.25, 0.0)
"""Parts of the way from the prior's parameters to the fitted ones that are tried in turn."""
START_WAVE = 0.3
"""Error of the observer's velocity, in standard deviations of the waves."""
DRAWS_MIN = 20
"""Fewer draws give no 5 % point."""
WAVE_SPAN, LATE_SPAN = 80.0, 60.0
"""Waves are foretold from what was left of this many seconds, and drawn from so many of the last of
them that are any good: before, it is also what was not yet learned."""
SEGMENTS_MIN = 3
"""Fewer say nothing of the parameters."""

# the track between rows: time of the grid's origin, half steps since then, last state,
# last actuators, low-frequency velocities; first row of the next segment, time of the next refit;
# largest velocities seen; height of the waves; autoregression of those foretold; sectors of those
# drawn
_ORIGIN, _HALVES, _LAST, _LAST_ACT = 0, 1, 2, 2 + N_STATES
_SLOW = _LAST_ACT + N_ACT
_NEXT_START, _REFIT_AT, _SEEN = _SLOW + 3, _SLOW + 4, _SLOW + 5
_WAVE_SD, _HERE = _SEEN + 3, _SEEN + 6
_SECTORS = _HERE + 3 * ORDER
TRACK_SIZE = _SECTORS + SECTORS * SECTOR_SIZE

_PERIOD, _RENEWED, _SPACING, _SPAN = range(4)
_RULES = 4
"""Numbers before the rules of the segments: period (s), segments renewed; rows between starts and
in the window."""


def refit_settings(particulars: Particulars) -> RefitSettings:
    """Return the settings of the refit, tuned for 6.336 m at 5.4 m/s, scaled by Froude.

    Times are not scaled: nobody waits ten minutes for a tanker's model. A ship that takes much
    longer to sail her length is seen for fewer lengths, by segments that are the more alike, and
    each counts the less.

    Source: twin.md section 10 B3.
    """
    L, U = particulars.length / STUDY_LENGTH, particulars.speed / STUDY_SPEED
    return RefitSettings(
        span=110.0,
        spacing=2.0,
        horizon=7.0,
        every=2,
        sd=np.array([0.175 * L, 0.175 * L, 0.04, 0.2 * U, 0.2 * U, 0.025 * U / L]),
        offset_sd=np.array([0.075 * U, 0.075 * U, 0.01 * U / L]),
        scale=0.15 * min(1.0, UNHURRIED / particulars.slowness),
        knee=0.015,
    )


@kernel
def _slow_step(dt, n, track, memory, constants, scratch, kit):
    """Advance the low-frequency observer."""
    x, _, act, wind, _, _, _, _, _, envelope, _, _ = parts(memory, constants, kit)
    terms = rooms(scratch, kit)[2]
    slow = track[_SLOW:]
    steps = max(1, math.ceil(min(dt, 10.0) / GRID - 1e-9))
    h = min(dt, 10.0) / steps
    c, s = math.cos(n[2]), math.sin(n[2])
    thrust_terms(
        *(act[0], act[1], math.cos(act[2]), math.sin(act[2]), math.cos(act[3]), math.sin(act[3])),
        terms,
    )
    for _ in range(steps):
        state_terms(slow[0], slow[1], slow[2], c, s, wind, kit[2], terms)
        rates = accelerations(terms, kit, x, N_STATES)
        slip(n[5] - slow[2], h, slow, 0)
        for i in range(3):
            slow[i] += h * (rates[i] + OBSERVER_GAIN * (n[3 + i] - slow[i]))
            slow[i] = min(max(slow[i], -envelope[i]), envelope[i])


@kernel
def _record(t, dt, n, good, track, act, wind, rows):
    """Write the window's rows up to time t, interpolated on its grid."""
    if dt > GAP_MAX:
        for k in range(rows.shape[0]):
            rows[k, GOOD] = 0.0
        track[_HALVES] = math.ceil((t - track[_ORIGIN]) / (0.5 * GRID))
    while track[_ORIGIN] + 0.5 * GRID * track[_HALVES] <= t:
        half = int(track[_HALVES])
        share = 1.0
        if dt > 0.0:
            share = 1.0 - min(max((t - track[_ORIGIN] - 0.5 * GRID * half) / dt, 0.0), 1.0)
        row = rows[(half // 2) % rows.shape[0]]
        if half % 2 == 1:
            for k in range(N_ACT):
                before = track[_LAST_ACT + k]
                row[MIDDLE + k] = before + share * (act[k] - before)
        else:
            for k in range(N_STATES):
                row[STATE + k] = track[_LAST + k] + share * (n[k] - track[_LAST + k])
            for k in range(3):
                row[LOW + k] = track[_SLOW + k]
            for k in range(2):
                row[WIND + k] = wind[k]
            row[GOOD] = good
            for k in range(N_ACT):
                before = track[_LAST_ACT + k]
                row[ACT + k] = before + share * (act[k] - before)
        track[_HALVES] += 1.0
    for k in range(N_STATES):
        track[_LAST + k] = n[k]
    for k in range(N_ACT):
        track[_LAST_ACT + k] = act[k]


@kernel
def book_size(p, capacity, steps, spacing):
    """Return the length of all that one predictor remembers of its window but the rows."""
    return TRACK_SIZE + record_size(p, steps, spacing) + memory_size(p, capacity)


@kernel
def book_parts(book, rules, p):
    """Return the track, the record of the rivals and the memory of the segments as views."""
    end = TRACK_SIZE + record_size(p, int(rules[_RULES + STEPS]), int(rules[_SPACING]))
    return book[:TRACK_SIZE], book[TRACK_SIZE:end], book[end:]


@kernel
def _last_row(track):
    """Return the number of the newest complete row of the window; -1 if there is none."""
    return int(track[_HALVES]) // 2 - 1


@kernel
def _all_good(first, last, rows):
    """Return whether the rows from first to last, the last included, may be fitted."""
    good = True
    for k in range(first, last + 1):
        good = good and rows[k % rows.shape[0], GOOD] > 0.0
    return good


@kernel
def take_segments(rows, book, rules, kit, room):
    """Take the segments that are over into the window; return how many starts were looked at."""
    p = kit[0].shape[1]
    track, record, memory = book_parts(book, rules, p)
    own, spacing, looks = rules[_RULES:], int(rules[_SPACING]), 0
    newest, steps = _last_row(track), int(own[STEPS])
    # older rows have been written over: after a long gap, nearly all of it
    start = max(int(track[_NEXT_START]), newest - rows.shape[0] + 1)
    while start + steps < newest:
        if _all_good(start, start + steps, rows):
            add(start, rows, believed(memory, p)[0], memory, own, kit, room)
            judge(start, spacing, rows, record, own, kit, room)
        start += spacing
        looks += 1
    track[_NEXT_START] = start
    return looks


_WAVE_ROWS = round(WAVE_SPAN / GRID) + 1
_WAVE_ROOM = 5 * _WAVE_ROWS + sector_room(_WAVE_ROWS)
"""Length of the room of :func:`_describe_waves`."""


@kernel
def _describe_waves(rows, rules, track, room):
    """Fit autoregressions to what the model left of the last velocities.

    Those of the sectors of headings are for the draws. Another is that of headings as they will be
    until the next refit, and foretells the waves of the moment.
    """
    newest, count = _last_row(track), 0
    first = max(newest - min(round(WAVE_SPAN / GRID), int(rules[_SPAN])), 0)
    N, late = newest + 1 - first, 0
    w, psi, good = shaped(room, 0, (N, 3)), room[3 * N : 4 * N], room[4 * N : 5 * N]
    rest = room[5 * N :]
    for k in range(N - 1, -1, -1):
        row = rows[(first + k) % rows.shape[0]]
        psi[k], good[k] = row[STATE + 2], row[GOOD]
        for i in range(3):
            w[k, i] = row[3 + i] - row[LOW + i] if good[k] > 0.0 else 0.0
        if good[k] > 0.0:
            count += 1
            if count <= round(LATE_SPAN / GRID):
                late = k
            for i in range(3):
                track[_SEEN + i] = max(track[_SEEN + i], abs(row[LOW + i]))
    if count <= 5 * ORDER:
        return
    sectors = shaped(track, _SECTORS, (SECTORS, SECTOR_SIZE))
    describe_sectors(w[late:], psi[late:], good[late:], sectors, rest)
    for i in range(3):
        mean, square = 0.0, 0.0
        for k in range(N):
            mean += w[k, i] / count
        for k in range(N):
            square += (w[k, i] - mean) ** 2 / count if good[k] > 0.0 else 0.0
        track[_WAVE_SD + i] = math.sqrt(square)
    heading = psi[N - 1] + 0.5 * rules[_PERIOD] * track[_SLOW + 2]
    for k in range(N):
        # both factors of the products that are fitted have it
        alike = likeness(psi[k] - heading)
        for i in range(3):
            w[k, i] *= alike
    fit_waves(w, shaped(track, _HERE, (ORDER, 3)), rest)


@kernel
def _refit(rows, book, rules, memory, constants, kit, room):
    """Bring segments, waves and rivals up to date, and write the best parameters to the filter."""
    p = kit[0].shape[1]
    track, record, window = book_parts(book, rules, p)
    own, spacing = rules[_RULES:], int(rules[_SPACING])
    take_segments(rows, book, rules, kit, room)
    newest = _last_row(track)
    count = drop(newest - int(rules[_SPAN]), window, p)
    _describe_waves(rows, rules, track, room[roll_room(p) :])
    for start in range(int(track[_NEXT_START]), newest + 1, spacing):
        note(start, spacing, record, p)
    if count < SEGMENTS_MIN:
        return
    xi, cov = believed(window, p)
    renew(int(rules[_RENEWED]), rows, xi, window, own, kit, room)
    settle(record, window, own, kit, room)
    x, P, _, _, _, _, _, _, _, _, _, _ = parts(memory, constants, kit)
    for i in range(p):
        x[N_STATES + i] = xi[i]
        for k in range(N_STATES):
            P[N_STATES + i, k] = P[k, N_STATES + i] = 0.0
        for k in range(p):
            P[N_STATES + i, N_STATES + k] = cov[i, k]


@kernel
def plus_step(
    t,
    dt,
    z,
    cmd,
    nav,
    settings,
    nav_work,
    memory,
    constants,
    scratch,
    work,
    kit,
    rows,
    book,
    rules,
    room,
):
    """Take one row, and refit when it is time; all memory in place.

    Parameters
    ----------
    t, dt, z, cmd
        See :meth:`twin.predictor.Predictor.update`.
    nav, memory, rows, book : array
        What a :class:`PlusPredictor` remembers.
    settings, constants, kit, rules : array
        What it is told of the boat.
    nav_work, scratch, work, room : array
        What predictors of like boats can share.
    """
    begun = nav[BEGUN] > 0.0
    tight_step(dt, z, cmd, nav, settings, nav_work, memory, constants, scratch, work, kit)
    if nav[BEGUN] == 0.0:
        return
    track = book[:TRACK_SIZE]
    n, P_nav = nav_parts(nav)
    _, _, act, wind, _, _, _, _, _, envelope, _, _ = parts(memory, constants, kit)
    if not begun:
        track[_ORIGIN], track[_HALVES] = t, 0.0
        for k in range(N_STATES):
            track[_LAST + k] = n[k]
        for k in range(3):
            track[_SLOW + k] = n[3 + k]
        for k in range(N_ACT):
            track[_LAST_ACT + k] = act[k]
    else:
        _slow_step(dt, n, track, memory, constants, scratch, kit)
    fast = (SPEED_GOOD * 0.25 * envelope[0]) ** 2
    sure = P_nav[3, 3] < fast and P_nav[4, 4] < fast and P_nav[2, 2] < HEADING_GOOD**2
    good = 1.0 if sure and dt <= GAP_GOOD else 0.0
    _record(t, dt, n, good, track, act, wind, rows)
    if t >= track[_REFIT_AT]:
        track[_REFIT_AT] = t + rules[_PERIOD] - 1e-9
        _refit(rows, book, rules, memory, constants, kit, room)


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
def plus_look(command, n, usual, slowness, rows, book, rules, memory, constants, kit, ahead, room):
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
            *(start, theta, act, command, lags, envelope, wind, kit, slowness),
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
    command, gps_var, slowness, P_nav, ahead, book, memory, constants, kit, shocks, room, covs
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
        *(start, theta, act, command, lags, envelope, wind, kit, slowness),
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
            *(begun, drawn, act, command, lags, envelope, wind, kit, slowness),
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


class PlusPredictor(UKFPredictor):
    """DSW-UKF+; see the head of this file.

    Parameters
    ----------
    particulars : Particulars
        The boat.
    model : str
        One of ``twin.structure.MODELS``.
    prior : tuple of ndarray, optional
        Mean (p,) and covariance (p, p) of the parameters; those of like boats if left out.
    settings : RefitSettings, optional
        :func:`refit_settings` if left out.
    period : float
        Time between refits, s.
    renewed : int
        Segments that a refit linearises anew, besides the new one.
    draws : int
        Paths that the bands are made of.
    seed : int
        Of the draws.
    """

    tuning = "about 290 configurations on 4 to 96 tuning seeds, 20 of the navigation"

    def __init__(
        self,
        particulars: Particulars,
        *,
        model: str = "mmg",
        prior: tuple[Array, Array] | None = None,
        settings: RefitSettings | None = None,
        period: float = 1.0,
        renewed: int = 8,
        draws: int = 100,
        seed: int = 0,
    ) -> None:
        if not (math.isfinite(period) and period > 0.0 and renewed >= 0 and draws >= DRAWS_MIN):
            raise ValueError(
                f"period = {period}, renewed = {renewed}, draws = {draws}: must be above 0 s, 0 or "
                f"more, and at least {DRAWS_MIN}"
            )
        structure = model_of(particulars, model, biased=True)
        mean, cov = prior or population_prior(structure, particulars)
        p = len(structure)
        if np.shape(mean) != (p,) or np.shape(cov) != (p, p):
            raise ValueError(
                f"prior has shapes {np.shape(mean)} and {np.shape(cov)}; the structure {model!r} "
                f"has {p} parameters: ({p},) and ({p}, {p})"
            )
        filters = dataclasses.replace(
            plain_settings(particulars, model),
            structure=structure,
            q_xi=np.zeros(p),
            xi0=mean,
            xi0_cov=cov,
        )
        self.refit = settings or refit_settings(particulars)
        self.period, self.renewed = period, renewed
        self.spacing = round(self.refit.spacing / GRID)
        capacity = math.ceil(self.refit.span / self.refit.spacing)
        steps, span = round(self.refit.horizon / GRID), round(self.refit.span / GRID)
        self.rows = np.zeros((span + steps + 2 * self.spacing, COLUMNS))
        self.book = np.zeros(book_size(p, capacity, steps, self.spacing))
        # as long as the rules will be, so that the book can be opened
        rules = np.array([period, renewed, self.spacing, span, *np.zeros(STEPS), steps])
        self.track, record, window = in_python(book_parts)(self.book, rules, p)
        self._seen, self._wave_sd = self.track[_SEEN:_WAVE_SD], self.track[_WAVE_SD:_HERE]
        self._here = self.track[_HERE:_SECTORS].reshape(ORDER, 3)
        self._sectors = self.track[_SECTORS:].reshape(SECTORS, SECTOR_SIZE)
        self.segments = Segments(structure.kit, mean, cov, self.refit, capacity, window)
        if len(self.segments.room) < roll_room(p) + _WAVE_ROOM:
            self.segments.room = np.zeros(roll_room(p) + _WAVE_ROOM)
        self.rules = np.concatenate([rules[:_RULES], self.segments.rules])
        self.rivals = Rivals(self.segments, self.spacing, record)
        rng = np.random.default_rng(seed)
        self._theta_shocks = rng.standard_normal((draws, p))
        self._start_shocks = rng.standard_normal((draws, N_STATES))
        # the first path is the mean
        self._wave_shocks = rng.standard_normal((draws + 1, round(10.0 / GRID), 3))
        self._wave_shocks[0] = 0.0
        self._room = np.empty(ROOM * (draws + 1))
        U = particulars.speed
        self._usual = np.array([1.5 * U, 0.8 * U, 1.2 * U / particulars.length])
        """Velocities that any boat may be foretold to have; once seen, half as much again."""
        super().__init__(particulars, settings=filters, seed=seed)
        self._plus_arguments = (
            *(*self._arguments, self.rows, self.book, self.rules),
            self.segments.room,
        )
        self._look = (
            *(self._usual, np.zeros(_look_size(p))),
            (self._theta_shocks, self._start_shocks, self._wave_shocks),
        )

    def reset(self) -> None:
        """Forget everything."""
        super().reset()
        self.rows[:] = 0.0
        self.track[:] = 0.0
        self.segments.reset()
        self.rivals.reset()
        self.track[_REFIT_AT] = -math.inf
        # until the waves have been seen: as high as a refit takes them to be, and without memory
        self._wave_sd[:] = self._sectors[:, FACTOR::4] = self.refit.sd[3:]

    @property
    def remembered(self) -> tuple[Array, ...]:
        """All that the predictor remembers; see :attr:`UKFPredictor.remembered`."""
        return *super().remembered, self.rows, self.book

    @property
    def shared(self) -> tuple[Any, ...]:
        """What twins of like boats can share: for the rows, then for looking ahead."""
        return *super().shared, self.rules, self.segments.room, *self._look

    def beliefs(self, *remembered: Array) -> Beliefs:
        """See :meth:`UKFPredictor.beliefs`; without the share of the waves."""
        nav, _, _, book = remembered
        return (
            super()
            .beliefs(*remembered)
            ._replace(
                places=nav[:, :3],
                velocities=book[:, _SLOW:_NEXT_START],
                seen=book[:, _SEEN:_WAVE_SD],
                usual=self._usual,
                prior=self.segments.prior,
            )
        )

    @property
    def _next_start(self) -> int:
        return int(self.track[_NEXT_START])

    @property
    def _refit_at(self) -> float:
        return float(self.track[_REFIT_AT])

    @property
    def last_row(self) -> int:
        """Number of the newest complete row of the window; -1 if there is none."""
        return int(_last_row(self.track))

    @property
    def window_s(self) -> float:
        """See :attr:`twin.predictor.Predictor.window_s`."""
        return min(max(self.last_row, 0) * GRID, self.refit.span)

    def update(self, t: float, dt: float, z: Array, cmd: Array) -> None:
        """Take one row; see :meth:`twin.predictor.Predictor.update`."""
        self.t = t
        plus_step(t, dt, z, cmd, *self._plus_arguments)

    def _window(self, first: int, last: int) -> Array:
        """Return rows first to last, the last included, as an array of their own."""
        return self.rows[np.arange(first, last + 1) % len(self.rows)]

    def _start(self) -> Array:
        start = self.n[:N_STATES].copy()
        start[3:] = self.track[_SLOW:_NEXT_START]
        return start

    def _past(self) -> Array:
        w = np.empty((ORDER, 3))
        _past_waves(self.n, self.rows, self.track, w)
        return w

    def _guarded(self, plan: Array, dt: float, ripple: Array) -> tuple[Array, Array]:
        """Return parameters that keep the motion within bounds, and the motion."""
        ukf, theta = self.ukf, np.empty(len(self.segments.prior))
        scaled, out, acts = (
            np.empty_like(plan),
            np.empty((len(plan), N_STATES)),
            np.empty_like(plan),
        )
        _roll_guarded(
            *(plan, dt, self.n, self._usual, ripple, self.track, self.rules),
            *(ukf.memory, ukf.constants, ukf.kit, scaled, theta, out, acts, self._room),
        )
        return theta, out

    def _told(self, after: Array) -> tuple[Array, Array]:
        """Return the waves foretold (1, K, 3) at times (K,), and on average between them."""
        path = np.empty((1, math.ceil(after[-1] / GRID - 1e-9) + 1, 3))
        foretell_waves(self._past(), self._here, path[0])
        ends, means = np.empty((2, 1, len(after), 3))
        between(path, GRID, after, ends, means)
        return ends, means

    def _drawn(self, after: Array, psi: Array) -> tuple[Array, Array]:
        """Return the waves (D, K, 3) of the draws, without those foretold, as :meth:`_told` does.

        Parameters
        ----------
        after : ndarray, shape (K,)
            Times after now, s, from the first step on.
        psi : ndarray
            Headings on the way, every :data:`GRID` seconds, rad.
        """
        shocks = self._wave_shocks
        times = math.ceil(len(psi) / shocks.shape[1])  # used again where they do not reach
        shocks = np.concatenate([shocks] * times, axis=1)[:, : len(psi)] if times > 1 else shocks
        path = np.zeros((len(shocks), len(psi) + 1, 3))
        simulate_waves(self._sectors, psi, shocks, path[:, 1:])
        ends, means = np.empty((2, len(shocks), len(after), 3))
        between(path, GRID, after, ends, means)
        return ends, means

    def _way(self, mean: Array, dt: float, span: float) -> Array:
        """Return headings every :data:`GRID` seconds on the way (K, 6) foretold."""
        after = GRID * np.arange(1, math.ceil(span / GRID - 1e-9) + 1)
        way: Array = np.interp(after, dt * np.arange(len(mean) + 1), [self.n[2], *mean[:, 2]])
        return way

    def _central(self, plan: Array, dt: float) -> tuple[Array, Array]:
        """Return the parameters in use and the states (K, 6) most to be expected."""
        ends, ripple = self._told(dt * np.arange(1, len(plan) + 1))
        theta, out = self._guarded(plan, dt, ripple[0])
        out[:, 3:] += ends[0]
        return theta, out

    def mean(self, plan: Array, dt: float) -> Array:
        """Return the predicted states alone; see :meth:`twin.predictor.Predictor.mean`."""
        return self._central(plan, dt)[1]

    def predict(self, plan: Array, dt: float) -> Prediction:
        """Predict the motion under a plan; see :meth:`twin.predictor.Predictor.predict`."""
        theta, mean = self._central(plan, dt)
        # the draws are rolled at coarse steps: only how far they part is used
        every = max(1, min(round(GRID / dt), len(plan)))
        K = math.ceil(len(plan) / every)
        h = dt * every
        after = h * np.arange(1, K + 1)
        coarse = plan[np.minimum(np.arange(K) * every + every // 2, len(plan) - 1)]
        unit = self.ukf.settings.n_unit
        coarse = coarse * [unit, unit, 1.0, 1.0]
        D = len(self._theta_shocks)
        thetas, starts = np.empty((D + 1, len(theta))), np.empty((D + 1, N_STATES))
        thetas[0], starts[0] = theta, self._start()
        cov = self.ukf.P[N_STATES:, N_STATES:]
        thetas[1:] = theta + self._theta_shocks @ _root(cov).T
        P = self.P_nav[:N_STATES, :N_STATES].copy()
        P[range(3, 6), range(3, 6)] += (START_WAVE * self._wave_sd) ** 2
        shocks = self._start_shocks @ _root(P).T
        starts[1:] = starts[0] + shocks
        starts[1:, :2] = starts[0, :2]
        ends, ripples = self._drawn(after, self._way(mean, dt, after[-1]))
        ripples += self._told(after)[1]
        out, acts = np.empty((D + 1, K, N_STATES)), np.empty((K, N_ACT))
        ukf = self.ukf
        roll_outs(
            *(starts, thetas, ukf.act, coarse, h, ukf.lags, ukf.envelope, ukf.wind, ukf.kit),
            *(ripples, OBSERVER_GAIN, out, acts, self._room),
        )
        out[..., 3:] += ends
        away = np.concatenate([np.zeros((D, 1, N_STATES)), out[1:] - out[0]], axis=1)
        away[:, 0, 2:] = shocks[:, 2:]
        start_cov = self.with_common_error(np.zeros((N_STATES, N_STATES)))
        covs = np.empty((K + 1, N_STATES, N_STATES))
        _mean_products(away, covs)
        covs[:, :2, :2] += start_cov[:2, :2]
        # where the position is now is as unsure as where it goes, and of another cause
        away[:, :, :2] += (self._start_shocks[:, :2] @ _root(start_cov[:2, :2]).T)[:, None]
        edges = _edges(away)
        low_edge, high_edge = (finer(edge, every, len(plan)) for edge in edges)
        return Prediction(
            self.t,
            starts[0].copy(),
            start_cov,
            self.t + dt * np.arange(1, len(plan) + 1),
            mean,
            finer(covs, every, len(plan)),
            low=mean + low_edge,
            high=mean + high_edge,
        )


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
