"""Scores of the forecasts that twins make while boats sail, kept within the compiled step.

Once a second a forecast is kept, and 10 s later compared with the truth: as it was made, with the
command held, and again from where it began, with the commands that came. The definitions are those
of :mod:`twin.benchmark.scores`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.channels import PSI, U, X, Y
from twin.identification.joint_ukf import scale_plan
from twin.model.dynamics import N_ACT
from twin.model.rollout import HORIZON_ROWS, HORIZONS, LONG_STEP
from twin.model.structure import N_STATES
from twin.motion.deck_motion import Z90
from twin.predictors.forecast import Beginning, forecast_mean
from usv_gym.physics import frames as fr
from usv_gym.world.channels import (
    AHRS_BIT,
    COMPASS_BIT,
    FIXES_BIT,
    GPS_BIT,
    IMU_BIT,
    WIND_BIT,
)
from usv_gym.world.faults import LOSS
from usv_gym.world.state import BOAT, fault_arrays
from usv_kernel.arrays import shaped, take
from usv_kernel.errors import UsvTwinError
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import as_record, as_records, field_at, record_size
from usv_kernel.scalar import wrap

__all__ = [
    "FORECAST_EVERY_S",
    "GRADED_AT",
    "LONGEST_STEP",
    "NAMES",
    "NO_SCORES",
    "PLANS",
    "SCORES",
    "SUMS_AT",
    "WHERE",
    "Buffers",
    "ForecastScores",
    "follow_forecasts",
    "grade_by_model",
    "grade_known",
    "grades_size",
    "is_due",
    "is_in_loss",
    "keep_forecast",
    "keep_with_model",
    "next_plan",
]

PLANS = ("known", "held")
"""With the commands that came, and with the present one held."""

WHERE = ("outside", "loss")
"""Whether a loss of sensors was on when the forecast was made: no, or yes."""

SCORES = (
    *("displacement_m", "heading_rad", "speed_mps"),
    *("displacement_coverage90", "heading_coverage90", "speed_coverage90"),
)
"""Mean absolute errors, and shares of truths within the 90 % intervals."""

ERRORS = 3
"""How many of them are errors; the coverages are those of the same channels, in this order."""

COUNTS = ("n", "n_intervals")
"""How many forecasts were graded, and how many of them with new standard deviations."""

_COUNT = len(SCORES)
_INTERVALS = len(SCORES) + 1

_SUMS = (len(PLANS), len(WHERE), len(HORIZONS), len(SCORES) + len(COUNTS))

FORECAST_EVERY_S = 1.0
"""Time between two forecasts that are kept."""

LONGEST_STEP = LONG_STEP
"""Longest control step with which forecasts are graded, s: that of a row of their plans."""

FORECASTS_KEPT = 12
"""Most forecasts that wait to be scored: one of each of the last 10 s, and two to spare."""

COMMANDS_KEPT = 26
"""Half seconds of commands that are kept: 10 s, a control step and two to spare."""

ELLIPSE_90 = -2.0 * math.log(0.1)
"""Squared Mahalanobis distance of the 90 % ellipse."""

_TRUTH = np.array([fr.X, fr.Y, fr.PSI, fr.U])
_STATE = np.array([X, Y, PSI, U])
"""Entries of the true state, and of a predicted one, that are compared."""

ORIGIN = np.dtype(
    [
        ("t", "f8"),  # s
        ("in_loss", "f8"),  # 1 within a loss of sensors
        ("has_intervals", "f8"),  # 1 if the standard deviations are new
        ("doubted", "f8"),  # 1 if the twin does not know what the drives do
        ("start", "f8", 2),  # position that it begins with, m
        ("place", "f8", 2),  # true position, m
        ("commands", "f8", N_ACT),  # integral of the commands until then
        ("held", "f8", (len(HORIZONS), 4)),  # x, y, psi, u with the command held
        ("spread", "f8", (len(HORIZONS), 3)),  # xx, xy, yy of the displacement's covariance
        ("deviation", "f8", (len(HORIZONS), 2)),  # standard deviations of psi and u
        ("truth", "f8", (len(HORIZONS), 4)),  # x, y, psi, u as they came
    ]
)
"""A forecast that waits for its time; what it begins with follows, see
:class:`twin.predictors.forecast.Beginning`."""

GRADES = np.dtype(
    [
        ("next", "f8"),  # time of the next forecast to keep, s
        ("made", "f8"),  # forecasts kept so far ...
        ("reached", "f8", len(HORIZONS)),  # ... of which so many reached each horizon ...
        ("graded", "f8"),  # ... and so many are graded
        ("before", "f8", 4),  # true x, y, psi, u of the row before
        ("commands", "f8", N_ACT),  # integral of the commands so far
        ("marks", "f8"),  # half seconds that have begun
        ("integrals", "f8", (COMMANDS_KEPT, N_ACT)),  # integral of the commands at each of the last
        ("sums", "f8", _SUMS),  # by PLANS, WHERE, horizon, SCORES and COUNTS
    ]
)
"""What is remembered of the forecasts of one boat."""

GRADED_AT = field_at(GRADES, "graded")
SUMS_AT = slice(field_at(GRADES, "sums"), field_at(GRADES, "sums") + math.prod(_SUMS))
"""Where the number of graded forecasts stands in a flat record, and their sums."""

_ORIGIN_SIZE = record_size(ORIGIN)
_GRADES_SIZE = record_size(GRADES)
_LAST = len(HORIZONS) - 1


class Buffers(NamedTuple):
    """What a forecast of K rows is written to."""

    commands: Any  # (K, 4) commands that came
    plan: Any  # (K, 4) the same in the unit of the structure
    params: Any  # (1, p)
    states: Any  # (1, K, 6)
    act: Any  # (K, 4)
    work: Any  # scratch of the rollout


@inlined
def _model_size(p, rows):
    return N_STATES + N_ACT + 5 + p + 6 * rows


def grades_size(p: int, rows: int) -> int:
    """Return the numbers that a boat's forecasts take, of p parameters and rows of waves."""
    return _GRADES_SIZE + FORECASTS_KEPT * (_ORIGIN_SIZE + N_STATES + N_ACT + 5 + p + 6 * rows)


@inlined
def _place_of(number, at, p, rows):
    """Return where a forecast begins in the note of its boat, by its number."""
    size = _ORIGIN_SIZE + _model_size(p, rows)
    return at + _GRADES_SIZE + (int(number) % FORECASTS_KEPT) * size


@inlined
def _model_of(note, place, p, rows):
    """Return what the forecast at a place begins with."""
    start, at = take(note, place + _ORIGIN_SIZE, (1, N_STATES))
    act, at = take(note, at, (N_ACT,))
    wind, at = take(note, at, (2,))
    params, at = take(note, at, (p,))
    fastest, at = take(note, at, (3,))
    means, at = take(note, at, (1, rows, 3))
    ends, at = take(note, at, (1, rows, 3))
    return Beginning(start, means, ends, params, act, wind, fastest)


@kernel
def follow_forecasts(dt, boat, note, at, p, rows):
    """Take the command and the truth of a row; return whether a forecast can now be graded.

    ``note`` is the flat memory of a boat in which its forecasts begin at ``at``; of p parameters,
    and so many rows of waves.
    """
    grades, t = as_records(note, at, 1, GRADES)[0], boat.t
    while LONG_STEP * grades.marks <= t + 1e-9:
        slot = int(grades.marks) % COMMANDS_KEPT
        passed = min(max(LONG_STEP * grades.marks - (t - dt), 0.0), dt)
        for k in range(N_ACT):
            grades.integrals[slot, k] = grades.commands[k] + boat.command[k] * passed
        grades.marks += 1.0
    for k in range(N_ACT):
        grades.commands[k] += boat.command[k] * dt
    for h in range(HORIZONS.shape[0]):
        while grades.reached[h] < grades.made:
            place = _place_of(grades.reached[h], at, p, rows)
            origin = as_records(note, place, 1, ORIGIN)[0]
            late = t - (origin.t + HORIZONS[h])
            if late < -1e-9:
                break
            share = min(max(late / dt, 0.0), 1.0)
            for k in range(4):
                now = boat.state[_TRUTH[k]]
                back = grades.before[k] - now
                origin.truth[h, k] = now + share * (wrap(back) if k == 2 else back)
            grades.reached[h] += 1.0
    for k in range(4):
        grades.before[k] = boat.state[_TRUTH[k]]
    return grades.graded < grades.reached[_LAST]


@inlined
def _write_plan(origin, grades, plan):
    """Write the commands (K, 4) that came after a forecast, their means over half seconds."""
    for k in range(N_ACT):
        before = origin.commands[k]
        for row in range(plan.shape[0]):
            place = origin.t / LONG_STEP + row + 1.0
            mark = math.floor(place + 1e-6)
            share = place - mark
            after = grades.integrals[int(mark) % COMMANDS_KEPT, k]
            if share > 1e-6:
                # between two half seconds; the last may not be over yet
                over = mark + 1.0 < grades.marks
                more = (
                    grades.integrals[int(mark + 1.0) % COMMANDS_KEPT, k]
                    if over
                    else grades.commands[k]
                )
                after = after + share * (more - after) if over else more
            plan[row, k] = (after - before) / LONG_STEP
            before = after


@kernel
def is_in_loss(t, row, simulation):
    """Return whether a loss of sensors is on at t (s), by a boat's row of the simulator.

    A loss of a sensor that the boat does not have is none.
    """
    there = GPS_BIT | FIXES_BIT | COMPASS_BIT | IMU_BIT
    if simulation.suite.wind_share > 0.0:
        there |= WIND_BIT
    if simulation.dof == 6 and simulation.suite.ahrs_share > 0.0:
        there |= AHRS_BIT
    faults = fault_arrays(row, simulation)[0]
    for i in range(faults.shape[0]):
        fault = faults[i]
        if fault.effect == LOSS and int(fault.bits) & there and t >= fault.start:
            bursts = fault.leave > 0.0
            if (bursts and fault.bursting > 0.0) or (not bursts and t < fault.end):
                return True
    return False


@kernel
def is_due(boat, note, at):
    """Return whether a forecast of this moment is to be kept."""
    return boat.t >= as_records(note, at, 1, GRADES)[0].next - 1e-9


@inlined
def keep_forecast(start, boat, noted, happens, period, note, at, sizes):
    """Keep the forecast that stands in a boat's note; return where it begins.

    ``noted`` is the record of ``note``, ``start`` the state (6,) that the forecast begins with.
    ``happens`` are whether sensors are lost, and whether commands are doubted; ``sizes`` are p and
    rows of :func:`follow_forecasts`.
    """
    grades = as_records(note, at, 1, GRADES)[0]
    place = _place_of(grades.made, at, sizes[0], sizes[1])
    origin = as_records(note, place, 1, ORIGIN)[0]
    origin.t, origin.in_loss = boat.t, 1.0 if happens[0] else 0.0
    origin.doubted = 1.0 if happens[1] else 0.0
    fresh = noted.last - (noted.covs_due - period) < FORECAST_EVERY_S - 1e-6
    origin.has_intervals = 1.0 if fresh else 0.0
    for k in range(2):
        origin.start[k], origin.place[k] = start[k], boat.state[_TRUTH[k]]
    for k in range(N_ACT):
        origin.commands[k] = grades.commands[k]
    for h in range(HORIZONS.shape[0]):
        for k in range(4):
            origin.held[h, k] = noted.ahead[h, _STATE[k]]
        for k in range(3):
            origin.spread[h, k] = noted.spread[h, k]
        origin.deviation[h, 0] = math.sqrt(max(noted.covs[h, PSI, PSI], 0.0))
        origin.deviation[h, 1] = math.sqrt(max(noted.covs[h, U, U], 0.0))
    grades.made += 1.0
    grades.next = FORECAST_EVERY_S * (math.floor(boat.t / FORECAST_EVERY_S + 1e-9) + 1.0)
    return place


@inlined
def keep_with_model(row, simulation, noted, period, begin, doubted, note, at):
    """Keep the forecast of a boat, if it is time, and what it begins with, ``begin``.

    ``row`` is the boat's of the simulator, ``doubted`` whether its commands are.
    """
    boat = as_record(row, BOAT)
    if not is_due(boat, note, at):
        return
    happens = is_in_loss(boat.t, row, simulation), doubted
    sizes = begin.params.shape[0], begin.means.shape[1]
    place = keep_forecast(begin.start[0], boat, noted, happens, period, note, at, sizes)
    kept = _model_of(note, place, *sizes)
    for k in range(N_STATES):
        kept.start[0, k] = begin.start[0, k]
    for k in range(N_ACT):
        kept.act[k] = begin.act[k]
    for k in range(2):
        kept.wind[k] = begin.wind[k]
    for k in range(3):
        kept.fastest[k] = begin.fastest[k]
    for k in range(sizes[0]):
        kept.params[k] = begin.params[k]
    for row in range(sizes[1]):
        for k in range(3):
            kept.means[0, row, k] = begin.means[0, row, k]
            kept.ends[0, row, k] = begin.ends[0, row, k]


@inlined
def _add_scores(h, predicted, origin, sums):
    """Add how far a predicted x, y, psi, u is from the truth at a horizon to a plan's sums."""
    x, y, psi, u = predicted
    truth, spread, where = origin.truth, origin.spread, int(origin.in_loss)
    ex = x - origin.start[0] - (truth[h, 0] - origin.place[0])
    ey = y - origin.start[1] - (truth[h, 1] - origin.place[1])
    turn, faster = abs(wrap(psi - truth[h, 2])), abs(u - truth[h, 3])
    sums[where, h, 0] += math.hypot(ex, ey)
    sums[where, h, 1] += turn
    sums[where, h, 2] += faster
    sums[where, h, _COUNT] += 1.0
    if origin.has_intervals > 0.0:
        xx, xy, yy = spread[h, 0], spread[h, 1], spread[h, 2]
        size = max(xx * yy - xy * xy, 0.0)
        within = yy * ex * ex - 2.0 * xy * ex * ey + xx * ey * ey <= ELLIPSE_90 * size
        sums[where, h, ERRORS] += 1.0 if within else 0.0
        sums[where, h, ERRORS + 1] += 1.0 if turn <= Z90 * origin.deviation[h, 0] else 0.0
        sums[where, h, ERRORS + 2] += 1.0 if faster <= Z90 * origin.deviation[h, 1] else 0.0
        sums[where, h, _INTERVALS] += 1.0


@inlined
def _grade(origin, states, rows, grades):
    """Grade a forecast: the states at some rows under the commands that came, and those held."""
    known, held = grades.sums[0], grades.sums[1]
    for h in range(HORIZONS.shape[0]):
        m = states[rows[h]]
        _add_scores(h, (m[X], m[Y], m[PSI], m[U]), origin, known)
        m = origin.held[h]
        _add_scores(h, (m[0], m[1], m[2], m[3]), origin, held)
    grades.graded += 1.0


@inlined
def grade_by_model(dt, boat, note, at, given, rows, out):
    """Take a row, and grade the forecasts whose time has come, made again by the model.

    ``given`` is the joint filter's configuration; ``rows`` are those of the waves.
    """
    grades, p = as_records(note, at, 1, GRADES)[0], out.params.shape[1]
    if not follow_forecasts(dt, boat, note, at, p, rows):
        return
    while grades.graded < grades.reached[_LAST]:
        place = _place_of(grades.graded, at, p, rows)
        origin, begin = as_records(note, place, 1, ORIGIN)[0], _model_of(note, place, p, rows)
        _write_plan(origin, grades, out.commands)
        if origin.doubted > 0.0:
            # what the drives got is not known, but what they will get is
            scale_plan(out.commands[:1], given.n_unit, shaped(begin.act, 0, (1, N_ACT)))
        forecast_mean(out.commands, LONG_STEP, begin, given, out)
        _grade(origin, out.states[0], HORIZON_ROWS, grades)


@kernel
def next_plan(note, at, plan):
    """Write the commands (20, 4) that came after the forecast to be graded next."""
    grades = as_records(note, at, 1, GRADES)[0]
    place = _place_of(grades.graded, at, 0, 0)
    _write_plan(as_records(note, place, 1, ORIGIN)[0], grades, plan)


@kernel
def grade_known(known, note, at):
    """Grade a forecast, from its states (20, 6) under the commands that came.

    Return whether there is another.
    """
    grades = as_records(note, at, 1, GRADES)[0]
    place = _place_of(grades.graded, at, 0, 0)
    _grade(as_records(note, place, 1, ORIGIN)[0], known, HORIZON_ROWS, grades)
    return grades.graded < grades.reached[_LAST]


def _names() -> dict[str, tuple[tuple[int, ...], tuple[int, ...]]]:
    """Return the names of all scores: where each stands in the sums, and what it is divided by."""
    found: dict[str, tuple[tuple[int, ...], tuple[int, ...]]] = {}
    for i, where in enumerate(_IN):
        for k, name in enumerate(COUNTS):
            found[f"{name}{where}"] = (0, i, 0, len(SCORES) + k), ()
    for j, plan in enumerate(PLANS):
        for i, where in enumerate(_IN):
            for h, horizon in enumerate(HORIZONS.tolist()):
                for k, name in enumerate(SCORES):
                    count = _COUNT if k < ERRORS else _INTERVALS
                    key = f"{plan}{where}_{horizon:g}s_{name}"
                    found[key] = (j, i, h, k), (j, i, h, count)
    return found


_IN = ("", "_loss")

_PLACES = _names()

NAMES = tuple(_PLACES)
"""Names of all scores."""


class ScoreNameError(UsvTwinError, KeyError):
    """A name without a score, or whose score no forecast counts for yet."""


class ForecastScores(Mapping[str, float]):
    """Scores of a twin's forecasts on an episode so far, by name.

    A name is such as ``"held_10s_displacement_m"``, or of forecasts made while sensors were lost
    ``"known_loss_5s_heading_rad"``: one of :data:`PLANS`, ``loss`` or nothing, a horizon of 1, 2, 5
    or 10 s, and one of :data:`SCORES`. ``"n"`` and ``"n_loss"`` say how many forecasts were graded,
    ``"n_intervals"`` and ``"n_intervals_loss"`` how many of them count for the coverages. What no
    forecast counts for is not there. ``dict(scores)`` is ready for JSON.

    Parameters
    ----------
    sums : ndarray, shape (2, 2, 4, 8)
        Sums over forecasts, by :data:`PLANS`, :data:`WHERE`, horizon, and then :data:`SCORES` and
        the two counts.
    """

    def __init__(self, sums: NDArray[np.float64]) -> None:
        self.sums = sums

    def __getitem__(self, name: str) -> float:
        if name not in self:
            what = "counts for no forecast yet" if name in NAMES else "is the name of no score"
            raise ScoreNameError(f"{name!r} {what}; use scores.get({name!r})")
        place, count = _PLACES[name]
        return float(self.sums[place] / (self.sums[count] if count else 1.0))

    def __contains__(self, name: object) -> bool:
        place = _PLACES.get(name) if isinstance(name, str) else None
        return place is not None and bool(not place[1] or self.sums[place[1]])

    def __iter__(self) -> Iterator[str]:
        return (name for name in NAMES if name in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __repr__(self) -> str:
        return f"ForecastScores({dict(self)})"


NO_SCORES = ForecastScores(np.zeros(_SUMS))
"""Those of an episode that has just begun."""
