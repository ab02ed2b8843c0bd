"""Which parameters are in use: those of a refit, of the joint filter, or of the prior, as experts.

Each expert forecasts the segments that follow, with the parameters that it has at their start, the
low-frequency velocities there, and the actuators as they were. The weight of an expert is its
posterior probability by these forecasts, where from one segment to the next another one may become
the best with a small probability,

    w_i <- (1 - share) w_i error_i^(-n / 2) / total + share / (number of experts).

So an expert that was worse for long takes over within a few forecasts. In use is the one of the
largest weight. Place and heading are scored: they add velocities up, and waves cancel.

Source: Herbster and Warmuth 1998, doi:10.1023/A:1007424614876 (fixed share); Dawid 1984,
doi:10.2307/2981683 (prequential scores).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.identification.evidence import NEVER, REFITS, WEIGHTS
from twin.identification.prediction_error import (
    ACT,
    FIRST,
    GOOD,
    LOW,
    MIDDLE,
    WIND,
    drive,
    rk4_step,
)
from twin.model.rollout import GRID
from usv_kernel.arrays import flat_size, named_dtype, python_views, take
from usv_kernel.jit import inlined, kernel

__all__ = [
    "BEST",
    "CHANGED",
    "CHOSEN",
    "EXPERTS",
    "JOINT",
    "NOTED",
    "PAST",
    "PRIOR",
    "SCORED",
    "ExpertState",
    "Experts",
    "choose",
    "expert_state",
    "forecast_error",
    "is_stable",
    "note",
    "score",
    "slot_of",
]

Array = NDArray[Any]

JOINT, PRIOR = REFITS, REFITS + 1
"""Experts that are no refits."""

EXPERTS = REFITS + 2

SHARE = 0.02
"""Probability that another expert becomes the best from one segment to the next: once in 100 s."""

ERRORS = 0.5
"""Independent errors n in a forecast. Segments overlap, and their errors are of a few waves."""

LEAST, MOST = 1e-9, 1e9
"""Bounds of a squared error, so that its logarithm is a number."""

STABLE_FOR = 20.0
"""Parameters are of use if the motion stays within bounds under held commands for so long, s."""

PAST = 12
"""Starts of segments for which parameters are remembered: those of forecasts that are not over."""


class ExpertState(NamedTuple):
    """What the choice of the parameters remembers."""

    count: Any  # (5,) see SCORED to CHANGED
    weights: Any  # (e,) of the experts
    params: Any  # (e, p) their parameters
    cov: Any  # (refits, p, p) covariances of the refits'
    past: Any  # (slots, e, p) parameters when recent segments began


SCORED, CHOSEN, NOTED, BEST, CHANGED = range(5)
"""Segments compared, expert in use, last row that was noted, best refit, row of a change."""


@inlined
def expert_state(memory, p):
    """Open the memory of the choice between parameters."""
    count, at = take(memory, 0, (5,))
    weights, at = take(memory, at, (EXPERTS,))
    params, at = take(memory, at, (EXPERTS, p))
    cov, at = take(memory, at, (REFITS, p, p))
    past, at = take(memory, at, (PAST, EXPERTS, p))
    return ExpertState(count, weights, params, cov, past)


@kernel
def forecast_error(first, rows, xi, model, config, work):
    """Return the error of a forecast from one row of a window in place and heading.

    It is the mean over the samples of the squared weighted errors; infinite where the motion
    leaves all bounds. Arguments: see :func:`twin.identification.prediction_error.linearise`.
    """
    size, s = rows.shape[0], work.s
    start = rows[first % size]
    wind = start[WIND:GOOD]
    for i in range(3):
        s[i], s[3 + i] = start[i], start[LOW + i]
    drive(start[ACT:MIDDLE], work.terms[3])
    total, count = 0.0, 0
    for step in range(config.steps):
        row, after = rows[(first + step) % size], rows[(first + step + 1) % size]
        if not rk4_step(row, after, wind, xi, model, work, False):
            return math.inf
        if (step + 1) % config.every == 0:
            count += 1
            x, y = after[0] - s[0], after[1] - s[1]
            place = config.weights[0] * (x * x + y * y)
            total += place + config.weights[2] * (after[2] - s[2]) ** 2
    return total / count


@inlined
def slot_of(start, spacing):
    """Return where the parameters are kept of the segment that begins at a row."""
    return start // spacing % PAST


@kernel
def note(start, spacing, state):
    """Keep the parameters of all experts for the segment that begins at a row."""
    if start <= state.count[NOTED]:
        return
    now = state.past[slot_of(start, spacing)]
    for r in range(EXPERTS):
        for k in range(now.shape[1]):
            now[r, k] = state.params[r, k]
    state.count[NOTED] = start


@kernel
def score(first, rows, state, config, model, work):
    """Move the weights by what the experts forecast at a row, and what came."""
    past, weights = state.past[slot_of(first, config.spacing)], state.weights
    state.count[SCORED] += 1.0
    total = 0.0
    for r in range(EXPERTS):
        if weights[r] > 0.0:
            error = forecast_error(first, rows, past[r], model, config, work)
            weights[r] *= min(max(error, LEAST), MOST) ** (-0.5 * ERRORS)
            total += weights[r]
    many = 0.0
    for r in range(EXPERTS):
        weights[r] /= total
        many += 1.0 if weights[r] > 0.0 else 0.0
    for r in range(EXPERTS):
        if weights[r] > 0.0:
            weights[r] = (1.0 - SHARE) * weights[r] + SHARE / many


@kernel
def is_stable(row, xi, bounds, model, work):
    """Return whether velocities are within bounds after :data:`STABLE_FOR` s of held commands.

    The motion starts on both sides of the row's velocities: a mode that grows needs a perturbation.
    """
    s = work.s
    stable = True
    for side in (-1.0, 1.0):
        for i in range(3):
            s[i] = row[i]
            s[3 + i] = row[LOW + i]
        s[4] += side * 0.1 * bounds[1]
        s[5] += side * 0.1 * bounds[2]
        drive(row[ACT:MIDDLE], work.terms[3])
        for _ in range(round(STABLE_FOR / GRID)):
            if not rk4_step(row, row, row[WIND:GOOD], xi, model, work, False):
                return False
        for i in range(3):
            stable = stable and abs(s[3 + i]) <= bounds[i]
    return stable


@kernel
def choose(row, bounds, state, model, work):
    """Put the expert of the largest weight that is stable to use; return whether there is one."""
    for r in range(REFITS):
        if state.weights[r] > state.weights[int(state.count[BEST])]:
            state.count[BEST] = r
    tried = np.uint64(0)
    for _ in range(EXPERTS):
        best, most = -1, 0.0
        for r in range(EXPERTS):
            if state.weights[r] > most and not (tried >> np.uint64(r)) & np.uint64(1):
                best, most = r, state.weights[r]
        if best < 0:
            return False
        if is_stable(row, state.params[best], bounds, model, work):
            state.count[CHOSEN] = best
            return True
        tried |= np.uint64(1) << np.uint64(best)
    return False


class Experts:
    """The experts of a predictor: their memory, flat, and by name as ``state``.

    ``prior`` (p,) and ``cov`` (p, p) are what the refits begin with, ``joint`` whether the joint
    filter is an expert: it is in use until another one has a larger weight, as is the first refit
    where it is none.
    """

    def __init__(self, prior: Array, cov: Array, joint: int) -> None:
        self._prior, self._cov, self._joint = prior, cov, joint
        self.memory = np.zeros(flat_size(expert_state, len(prior)))
        self.state: ExpertState = python_views(expert_state)(self.memory, len(prior))
        self.reset()

    @property
    def dtype(self) -> np.dtype[Any]:
        """Structured dtype of the memory; see :class:`ExpertState`."""
        return named_dtype(expert_state, len(self._prior))

    def reset(self) -> None:
        """Forget everything; all begin with the prior."""
        state, first = self.state, JOINT if self._joint == FIRST else 0
        self.memory[:] = 0.0
        state.count[NOTED], state.count[CHANGED], state.count[CHOSEN] = -1.0, NEVER, first
        state.weights[:] = SHARE
        state.weights[JOINT] = 0.0
        state.weights[first] = 1.0 - SHARE * (EXPERTS - 2 + (first == JOINT))
        state.params[:] = state.past[:] = self._prior
        state.cov[:] = self._cov

    @property
    def chosen(self) -> int:
        """The expert in use: a refit, :data:`JOINT` or :data:`PRIOR`."""
        return int(self.state.count[CHOSEN])

    @property
    def refitted(self) -> bool:
        """Whether there was a refit."""
        return bool((self.state.cov[0] != self._cov).any())

    @property
    def uses_prior(self) -> bool:
        """Whether the parameters in use are the prior's."""
        return not self.refitted or self.chosen == PRIOR

    @property
    def name(self) -> str:
        """The expert in use, in plain words."""
        if not self.refitted:
            return "the prior, as there is too little usable data for a refit"
        if self.chosen < REFITS:
            return f"the refit with data weight {WEIGHTS[self.chosen]:g}"
        return "the joint filter" if self.chosen == JOINT else "the prior"

    def best_refit(self) -> tuple[Array, Array] | None:
        """Return mean and standard deviations, each (p,), of the best refit; None without one."""
        best = int(self.state.count[BEST])
        if not self.refitted:
            return None
        return self.state.params[best].copy(), np.sqrt(np.diag(self.state.cov[best]))
