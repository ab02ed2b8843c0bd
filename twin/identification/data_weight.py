"""How far to trust the data against the prior: rival refits, judged by what they foretold.

A boat of which the prior knows little, in waves that are high for her, must lean on her data; one
that has only been turning must not. No setting suits both, so several refits run side by side
over the same segments, each with another ``trust``, and the one in use is the one whose forecasts
were best. Every forecast is one of a segment that had not been seen: with the parameters that
each rival had when it began, from the low-frequency velocities, under the actuators as they were.

Place and heading are what is judged: they add velocities up, and the waves cancel.

Source: twin.md section 14.1 asks for the choice; prequential validation, Dawid 1984.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.checkpoint import COUNT, Field
from twin.identification.prediction_error import (
    ACT,
    EVERY,
    GOOD,
    GRID,
    ITERATIONS,
    LOW,
    MIDDLE,
    STEPS,
    WIND,
    Segments,
    drive,
    keep_factor,
    roll_room,
    solve,
    use,
)
from twin.model.structure import LEFT_COS, N_STATES, N_TERMS, accelerations, state_terms
from usv_kernel.arrays import shaped
from usv_kernel.jit import kernel, py_func

__all__ = [
    "Rivals",
    "miss",
]

Array = NDArray[Any]

TRUSTS = (1.0, 10.0, 100.0)
"""How far the rivals trust the data; the first is in use until another has proved better."""

_TRUSTS = np.array(TRUSTS)

MARGIN = 0.15
"""By how much the mean logarithm of another's squared errors must be lower."""

ENOUGH, MEMORY = 8, 30
"""Segments before anything is chosen, and over which errors are averaged."""

LEAST, MOST = 1e-9, 1e9
"""Bounds of a squared error, so that its logarithm is a number."""


@kernel
def _rates(s, xi, wind, kit, terms, k):
    """Write the derivative of a state; the actuators' terms are there."""
    c, n = math.cos(s[2]), math.sin(s[2])
    state_terms(s[3], s[4], s[5], c, n, wind, kit[2], terms)
    k[0], k[1], k[2] = s[3] * c - s[4] * n, s[3] * n + s[4] * c, s[5]
    k[3], k[4], k[5] = accelerations(terms, kit, xi, 0)


@kernel
def miss(first, steps, every, rows, xi, kit, by_place, by_heading, room):
    """Return how far a forecast from one row of a window was off in place and heading.

    Parameters
    ----------
    first, steps, every, rows, xi, kit
        See :func:`twin.identification.prediction_error.linearise`.
    by_place, by_heading : float
        1 / variance of x or y (m), and of the heading (rad).
    room : (168,) array
        Scratch.

    Returns
    -------
    float
        Mean over the samples of the squared weighted errors; infinite where the motion leaves all
        bounds.
    """
    size = rows.shape[0]
    terms = shaped(room, 0, (3, N_TERMS))
    rest = room[3 * N_TERMS :]
    s, place, k, sums = rest[:6], rest[6:12], rest[12:18], rest[18:24]
    start = rows[first % size]
    wind = start[WIND:GOOD]
    for i in range(3):
        s[i], s[3 + i] = start[i], start[LOW + i]
    drive(start[ACT:MIDDLE], terms[2])
    total, count = 0.0, 0
    for step in range(steps):
        after = rows[(first + step + 1) % size]
        for j in range(LEFT_COS, N_TERMS):
            terms[0, j] = terms[2, j]
        drive(rows[(first + step) % size, MIDDLE:], terms[1])
        drive(after[ACT:MIDDLE], terms[2])
        for i in range(N_STATES):
            place[i], sums[i] = s[i], 0.0
        for stage in range(4):
            _rates(place, xi, wind, kit, terms[(stage + 1) // 2], k)
            share = 2.0 if stage == 1 or stage == 2 else 1.0
            h = GRID if stage == 2 else 0.5 * GRID
            for i in range(N_STATES):
                sums[i] += share * k[i]
                place[i] = s[i] + h * k[i]
        for i in range(N_STATES):
            s[i] += GRID / 6.0 * sums[i]
        if not (abs(s[3]) < 1e3 and abs(s[4]) < 1e3 and abs(s[5]) < 1e2):
            return math.inf
        if (step + 1) % every == 0:
            count += 1
            x, y = after[0] - s[0], after[1] - s[1]
            total += by_place * (x * x + y * y) + by_heading * (after[2] - s[2]) ** 2
    return total / count


JUDGED, CHOSEN, _TURN, _NOTED = 0, 1, 2, 3


@kernel
def record_size(p, steps, spacing):
    """Return the length of the record of rivals."""
    many = len(TRUSTS)
    return 4 + many * (1 + p * (1 + p + steps // spacing + 3))


@kernel
def record_parts(record, p):
    """Return errors, parameters, their factors, and what was noted as views of the record.

    Before them stand the number of segments that were judged, the rival in use, whose turn it is,
    and the last row that was noted. A factor is Cholesky's of the inverse of the covariance.
    """
    many = len(TRUSTS)
    rest = record[4 + many :]
    xi = shaped(rest, 0, (many, p))
    factors = shaped(rest, many * p, (many, p, p))
    rest = rest[many * p * (1 + p) :]
    slots = rest.shape[0] // (many * p)
    return record[4 : 4 + many], xi, factors, rest.reshape((slots, many, p))


@kernel
def forget(record, prior):
    """Let all rivals begin with the prior."""
    _, xi, _, then = record_parts(record, prior.shape[0])
    record[:] = 0.0
    record[_NOTED] = -1.0
    for r in range(xi.shape[0]):
        for k in range(prior.shape[0]):
            xi[r, k] = prior[k]
            for slot in range(then.shape[0]):
                then[slot, r, k] = prior[k]


@kernel
def note(start, spacing, record, p):
    """Keep what the rivals believe now for the segment that begins at a row."""
    if start <= record[_NOTED]:
        return
    _, xi, _, then = record_parts(record, p)
    now = then[start // spacing % then.shape[0]]
    for r in range(xi.shape[0]):
        for k in range(p):
            now[r, k] = xi[r, k]
    record[_NOTED] = start


@kernel
def judge(first, spacing, rows, record, rules, kit, room):
    """Compare what the rivals foretold at a row with what came."""
    errors, xi, _, then = record_parts(record, kit[0].shape[1])
    steps, every = int(rules[STEPS]), int(rules[EVERY])
    scratch = room[roll_room(kit[0].shape[1]) :]
    record[JUDGED] += 1.0
    for r in range(xi.shape[0]):
        believed = then[first // spacing % then.shape[0], r]
        missed = miss(first, steps, every, rows, believed, kit, rules[0], rules[2], scratch)
        error = math.log(min(max(missed, LEAST), MOST))
        errors[r] += (error - errors[r]) / min(record[JUDGED], MEMORY)


@kernel
def settle(record, memory, rules, kit, room):
    """Refit the rival in use and another in turn, and put the best of all to use."""
    p = kit[0].shape[1]
    errors, xi, factors, _ = record_parts(record, p)
    record[_TURN] += 1.0
    chosen = int(record[CHOSEN])
    other = int(record[_TURN]) % (xi.shape[0] - 1)
    for r in (chosen, other if other < chosen else other + 1):
        if solve(xi[r], _TRUSTS[r], ITERATIONS, 0.0, memory, rules, room):
            keep_factor(room, p, factors[r])
    if record[JUDGED] >= ENOUGH:
        chosen = 0
        for r in range(1, xi.shape[0]):
            if errors[r] + MARGIN < errors[chosen] + (MARGIN if chosen > 0 else 0.0):
                chosen = r
        record[CHOSEN] = chosen
    use(xi[chosen], factors[chosen], _TRUSTS[chosen], memory, room)


RIVAL_FIELDS = {
    "judged": COUNT,
    "chosen": Field(low=0.0, high=len(TRUSTS) - 1.0, integer=True),
    "turn": COUNT,
    "noted": Field(low=-1.0, high=COUNT.high, integer=True),
}
"""What the fields of :meth:`Rivals.views` may hold."""


class Rivals:
    """Refits of the same segments with unequal trust, and the record of each.

    Parameters
    ----------
    segments : Segments
        Theirs; its ``xi`` and ``cov`` are those of the rival in use.
    spacing : int
        Rows between the starts of segments.
    record : ndarray, optional
        Flat array of :func:`record_size` to remember in.

    Attributes
    ----------
    xi : ndarray, shape (k, p)
        Parameters of each rival, a view.
    errors : ndarray, shape (k,)
        Mean logarithm of each one's squared errors, a view.
    """

    def __init__(self, segments: Segments, spacing: int, record: Array | None = None) -> None:
        self.segments, self.spacing = segments, spacing
        p = len(segments.prior)
        self.record = (
            np.zeros(record_size(p, segments.steps, spacing)) if record is None else record
        )
        self.errors, self.params, _, _ = py_func(record_parts)(self.record, p)
        self.reset()

    def views(self) -> dict[str, Array]:
        """Return what is remembered as fields by name, which are views."""
        _, _, factors, then = py_func(record_parts)(self.record, len(self.segments.prior))
        return {
            **{"judged": self.record[JUDGED:CHOSEN], "chosen": self.record[CHOSEN:_TURN]},
            **{"turn": self.record[_TURN:_NOTED], "noted": self.record[_NOTED : _NOTED + 1]},
            **{"errors": self.errors, "parameters": self.params},
            **{"factors": factors, "parameters_noted": then},
        }

    def reset(self) -> None:
        """Forget everything; all begin with the prior."""
        forget(self.record, self.segments.prior)

    @property
    def judged(self) -> int:
        """Segments that were judged."""
        return int(self.record[JUDGED])

    @property
    def chosen(self) -> int:
        """The rival in use."""
        return int(self.record[CHOSEN])

    def note(self, starts: Iterable[int]) -> None:
        """Keep what the rivals believe now for the segments that begin at some rows."""
        for start in starts:
            note(start, self.spacing, self.record, len(self.segments.prior))

    def judge(self, first: int, rows: Array) -> None:
        """Compare what the rivals foretold at a row with what came.

        Parameters
        ----------
        first : int
            Row where a segment began.
        rows : ndarray, shape (M, 20)
            The window.
        """
        own = self.segments
        judge(first, self.spacing, rows, self.record, own.rules, own.kit, own.room)

    def solve(self) -> None:
        """Refit the rival in use and another in turn, and put the best of all to use."""
        own = self.segments
        settle(self.record, own.memory, own.rules, own.kit, own.room)
