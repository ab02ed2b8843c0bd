"""One row of DSW-UKF+: observer, window, waves and refit."""

from __future__ import annotations

import math

from twin.identification.data_weight import judge, note, record_size, settle
from twin.identification.joint_ukf import parts, rooms
from twin.identification.prediction_error import (
    ACT,
    GOOD,
    GRID,
    LOW,
    MIDDLE,
    STATE,
    STEPS,
    WIND,
    add,
    believed,
    drop,
    memory_size,
    renew,
    roll_room,
)
from twin.identification.wave_residual import (
    ORDER,
    SECTOR_SIZE,
    SECTORS,
    describe_sectors,
    fit_waves,
    likeness,
    sector_room,
)
from twin.model.dynamics import N_ACT
from twin.model.rollout import slip
from twin.model.structure import N_STATES, accelerations, state_terms, thrust_terms
from twin.predictors.baselines import GAP_MAX
from twin.predictors.ukf import BEGUN, nav_parts, tight_step
from usv_kernel.arrays import shaped
from usv_kernel.jit import kernel

OBSERVER_GAIN = 0.5
"""Of the low-frequency observer, 1/s. By it, too, the velocities of a draw take on its waves: what
was measured is the observer's motion and what that left, and so will be what comes."""

SPEED_GOOD, HEADING_GOOD, GAP_GOOD = 0.25, 0.1, 2.5
"""A row may be fitted if the navigation is as sure as this of velocity (usual speeds) and
heading (rad), and if the row before it is not older (s)."""

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
        See :meth:`twin.predictors.base.Predictor.update`.
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
