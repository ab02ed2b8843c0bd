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

from twin.model import derivative
from twin.pem import ACT, GOOD, GRID, LOW, MIDDLE, WIND, Segments
from twin.structure import N_STATES, N_TERMS
from usv_kernel import kernel

__all__ = ["Rivals", "miss"]

Array = NDArray[Any]

TRUSTS = (1.0, 10.0, 100.0)
"""How far the rivals trust the data; the first is in use until another has proved better."""
MARGIN = 0.15
"""By how much the mean logarithm of another's squared errors must be lower."""
ENOUGH, MEMORY = 8, 30
"""Segments before anything is chosen, and over which errors are averaged."""
LEAST, MOST = 1e-9, 1e9
"""Bounds of a squared error, so that its logarithm is a number."""


@kernel
def miss(first, steps, every, rows, xi, kit, by_place, by_heading, room):
    """Return how far a forecast from one row of a window was off in place and heading.

    Parameters
    ----------
    first, steps, every, rows, xi, kit
        See :func:`twin.pem.linearise`.
    by_place, by_heading : float
        1 / variance of x or y (m), and of the heading (rad).
    room : (72,) array
        Scratch.

    Returns
    -------
    float
        Mean over the samples of the squared weighted errors; infinite where the motion leaves all
        bounds.
    """
    size = rows.shape[0]
    terms, rest = room[:N_TERMS], room[N_TERMS:]
    s, place, k, sums = rest[:6], rest[6:12], rest[12:18], rest[18:24]
    start = rows[first % size]
    wind, act = start[WIND:GOOD], start[ACT:MIDDLE]
    for i in range(3):
        s[i], s[3 + i] = start[i], start[LOW + i]
    total, count = 0.0, 0
    for step in range(steps):
        after = rows[(first + step + 1) % size]
        for i in range(N_STATES):
            place[i], sums[i] = s[i], 0.0
        for stage in range(4):
            if stage == 1:
                act = rows[(first + step) % size, MIDDLE:]
            elif stage == 3:
                act = after[ACT:MIDDLE]
            derivative(place, xi, act, wind, kit, terms, k)
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


class Rivals:
    """Refits of the same segments with unequal trust, and the record of each.

    Parameters
    ----------
    segments : Segments
        Theirs; its ``xi`` and ``cov`` are those of the rival in use.
    spacing : int
        Rows between the starts of segments.

    Attributes
    ----------
    xi, cov : ndarray, shapes (k, p), (k, p, p)
        Parameters of each rival, and their covariance.
    errors : ndarray, shape (k,)
        Mean logarithm of each one's squared errors.
    judged : int
        Segments that were judged.
    chosen : int
        The rival in use.
    """

    def __init__(self, segments: Segments, spacing: int) -> None:
        self.segments, self.spacing = segments, spacing
        self._room = np.zeros(N_TERMS + 4 * N_STATES)
        self.reset()

    def reset(self) -> None:
        """Forget everything; all begin with the prior."""
        many, segments = len(TRUSTS), self.segments
        self.xi = np.tile(segments.prior, (many, 1))
        self.cov = np.tile(segments.prior_cov, (many, 1, 1))
        self._then = np.tile(segments.prior, (segments.steps // self.spacing + 3, many, 1))
        self._noted = -1
        self.errors, self.judged, self.chosen, self._turn = np.zeros(many), 0, 0, 0

    def note(self, starts: Iterable[int]) -> None:
        """Keep what the rivals believe now for the segments that begin at some rows."""
        for start in starts:
            if start > self._noted:
                self._then[start // self.spacing % len(self._then)] = self.xi
                self._noted = start

    def judge(self, first: int, rows: Array) -> None:
        """Compare what the rivals foretold at a row with what came.

        Parameters
        ----------
        first : int
            Row where a segment began.
        rows : ndarray, shape (M, 20)
            The window.
        """
        segments = self.segments
        by_place, by_heading = segments.weights[[0, 2]]
        how = (first, segments.steps, segments.settings.every, rows)
        self.judged += 1
        for r, xi in enumerate(self._then[first // self.spacing % len(self._then)]):
            missed = miss(*how, xi, segments.kit, by_place, by_heading, self._room)
            error = math.log(min(max(missed, LEAST), MOST))
            self.errors[r] += (error - self.errors[r]) / min(self.judged, MEMORY)

    def solve(self) -> None:
        """Refit the rival in use and another in turn, and put the best of all to use."""
        segments = self.segments
        others = [r for r in range(len(TRUSTS)) if r != self.chosen]
        self._turn += 1
        for r in (self.chosen, others[self._turn % len(others)]):
            self._use(r)
            segments.solve()
        if self.judged >= ENOUGH:
            self.chosen = int(np.argmin(self.errors + MARGIN * (np.arange(len(TRUSTS)) > 0)))
        self._use(self.chosen)

    def _use(self, r: int) -> None:
        segments = self.segments
        segments.xi, segments.cov, segments.trust = self.xi[r], self.cov[r], TRUSTS[r]
