"""Weight of the data against the prior: several refits, compared by their forecasts.

A boat in waves that are high for it, of which the prior says little, must rely on its data. One
that has only been turning must not. No setting suits both, so several refits run side by side over
the same segments, each with another weight. The one in use is the one with the best forecasts.
Every forecast is one of a segment that had not been seen. It has the parameters of each refit at
the segment's start, the low-frequency velocities there, and the actuators as they were.

Place and heading are compared: they add velocities up, and the waves cancel.

Source: docs/explanation/twin.md, The refit; prequential validation, Dawid 1984.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.filters.linalg import packed_size
from twin.identification.change import (
    change_evidence,
    known_before,
    quadratics_by_changes,
    widen_known,
)
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
from twin.identification.segments import (
    ITERATIONS,
    Known,
    Segments,
    samples_of,
    solve,
    store_factor,
    use,
)
from twin.model.rollout import GRID
from usv_kernel.arrays import flat_size, named_dtype, python_views, take
from usv_kernel.jit import inlined, kernel

__all__ = [
    "DataWeightSelector",
    "SelectorState",
    "forecast_error",
    "keep_parameters",
    "linearised_at",
    "score",
    "select_data_weight",
    "selector_state",
]

Array = NDArray[Any]

DATA_WEIGHTS = (1.0, 10.0, 100.0, 0.1, 1.0, 10.0, 100.0)
"""Factors of the data's information in the refits; the first is used until another is better."""

SPANS_S = (math.inf, math.inf, math.inf, math.inf, 35.0, 35.0, 35.0)
"""Length of the window of each refit."""

REFITS = len(DATA_WEIGHTS)

PRIOR = REFITS
JOINT = REFITS + 1
"""Candidates that are no refits: the prior's parameters, and those of the joint filter, if there is
one."""

CANDIDATES = REFITS + 2

_DATA_WEIGHTS = np.array(DATA_WEIGHTS)
COUNT_MAX = 2.0**52
"""Whole numbers up to it are exact in a double."""

_SPAN_ROWS = np.array([min(span / GRID, COUNT_MAX) for span in SPANS_S])

SCORED_MIN = 8
RECORD_SEGMENTS = 25
LOG_ERROR_MARGIN = 0.25
"""Least number of scored segments for a choice, number over which the logarithms of squared errors
are averaged, and by how much another's mean must be lower."""

SHORT = next(r for r, span in enumerate(SPANS_S) if math.isfinite(span))
"""The first of the refits with a short window, which begins no earlier than the last change."""

CUSUM_CLIP = 4.0
CUSUM_DRIFT = 2.2
CUSUM_ALARM = 4.5
"""Cumulative sum (Page 1954) of the logarithms of squared errors above their mean: the bound of an
increment, the drift that is subtracted from it, and the threshold of the sum."""

EVIDENCE_ALARM = 12.5
LAGS_S = (2.0, 6.0, 14.0)
"""Twice the log-likelihood ratio above which thrust or current have changed, and the times before
the last segment at which a change is tested, rising."""

_NAMES = {
    PRIOR: "the prior, as no refit forecasts better",
    JOINT: "the joint filter",
}

_LAG_ROWS = np.array([round(lag / GRID) for lag in LAGS_S])

ALARM_SCORED_MIN = 14
ALARM_INFORMATION_MIN = 30.0
ALARM_INTERVAL_S = 20.0
"""Conditions of an alarm: least number of scored segments, their least information on the thrust
(see ``change.known_before``), and least time since the last alarm."""

SHORT_REFIT_LEAD = 1.1
"""Lead of the short refits after a change, in margins."""

DATA_WEIGHT_OF_JOINT = 10.0
"""Data weight that corresponds to the parameters of the joint filter."""

SQUARED_ERROR_MIN = 1e-9
SQUARED_ERROR_MAX = 1e9
"""Bounds of a squared error, so that its logarithm is a number."""


class SelectorState(NamedTuple):
    """Memory of the choice of the data weight."""

    count: Any  # (6,) see SCORED to ALARM
    surprise: Any  # (1,) evidence that the boat has changed
    errors: Any  # (c,) mean logarithm of each candidate's squared errors
    params: Any  # (c, p) parameters of each candidate
    factors: Any  # (refits, p, p) Cholesky factors of the inverses of the refits' covariances
    past: Any  # (slots, c, p) parameters when recent segments began
    pull: Any  # (p,) right-hand side of the prior after a change; see ``segments.Known``
    information: Any  # (h,) 0 before the first change


SCORED, CHOSEN, TURN, NOTED, CHANGED, ALARM = range(6)
"""Segments compared, candidate in use, refit whose turn it is, last row that was noted, row at
which the boat changed, and that at which it was found."""


@inlined
def selector_state(memory, p, steps, spacing):
    """Open the memory of the choice between refits of p parameters."""
    count, at = take(memory, 0, (6,))
    surprise, at = take(memory, at, (1,))
    errors, at = take(memory, at, (CANDIDATES,))
    params, at = take(memory, at, (CANDIDATES, p))
    factors, at = take(memory, at, (REFITS, p, p))
    past, at = take(memory, at, (1 + steps // spacing + 3, CANDIDATES, p))
    pull, at = take(memory, at, (p,))
    information, at = take(memory, at, (packed_size(p),))
    return SelectorState(count, surprise, errors, params, factors, past, pull, information)


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


@kernel
def keep_parameters(start, spacing, state):
    """Keep the parameters of all refits for the segment that begins at a row."""
    if start <= state.count[NOTED]:
        return
    now = state.past[start // spacing % state.past.shape[0]]
    for r in range(now.shape[0]):
        for k in range(now.shape[1]):
            now[r, k] = state.params[r, k]
    state.count[NOTED] = start


@inlined
def _lead(r, errors):
    """Return the lead of a candidate's mean error over the first one's, in margins."""
    return (errors[0] - errors[r]) / LOG_ERROR_MARGIN


@inlined
def linearised_at(state):
    """Return the refit at whose parameters segments are linearised: that in use, or the best.

    Other candidates are no minimum of the refit's cost. The first refit is the best until another
    one with a long window leads it by a margin.
    """
    chosen = int(state.count[CHOSEN])
    if chosen < REFITS:
        return chosen
    best, most = 0, 1.0
    if state.count[SCORED] >= SCORED_MIN:
        for r in range(1, SHORT):
            lead = _lead(r, state.errors)
            if lead > most:
                best, most = r, lead
    return best


@inlined
def _data_weight_of(candidate):
    """Return the data weight while a candidate is in use."""
    if candidate < REFITS:
        return max(_DATA_WEIGHTS[candidate], 1.0)
    return 1.0 if candidate == PRIOR else DATA_WEIGHT_OF_JOINT


@inlined
def _candidates(config):
    """Return how many candidates there are."""
    return CANDIDATES if config.joint == FIRST else PRIOR + 1


@kernel
def _begin_after(changed, first, state, segments, config, model, work):
    """Begin with the short refits after a change, from what was known at the row ``first``.

    Of a boat that has hardly sailed nothing is known that could have changed.
    """
    count, errors, samples = state.count, state.errors, samples_of(config)
    quadratics_by_changes(0, segments.params, segments, config, model, work.change)
    if known_before(changed, samples, segments, config, work.change) < ALARM_INFORMATION_MIN:
        return
    base = state.past[max(first, 0) // config.spacing % state.past.shape[0], int(count[CHOSEN])]
    weight = _data_weight_of(int(count[CHOSEN]))
    # of the long refits in turn the first has the widest covariance
    known = state.factors[0], state.pull, state.information
    if not widen_known(base, *known, config, model, work):
        return
    state.surprise[0] = 0.0
    count[CHANGED], count[CHOSEN], count[ALARM] = changed, SHORT, count[NOTED]
    for r in range(SHORT, REFITS):
        if _DATA_WEIGHTS[r] <= weight:
            count[CHOSEN] = r
    for r in range(SHORT, REFITS):
        errors[r] = errors[0] - SHORT_REFIT_LEAD * LOG_ERROR_MARGIN


@inlined
def _may_change(row, count):
    """Return whether enough is known to say that the boat has changed, and not just now."""
    return count[SCORED] >= ALARM_SCORED_MIN and (row - count[ALARM]) * GRID >= ALARM_INTERVAL_S


@kernel
def _test_for_change(newest, state, segments, config, model, work):
    """Begin with the short refits where a change explains the last segments better.

    Much better, or at all where the forecasts have become worse than they used to be.
    """
    if not _may_change(newest, state.count):
        return
    samples, first, surprise = samples_of(config), newest - config.steps, state.surprise
    enough = EVIDENCE_ALARM if surprise[0] < CUSUM_ALARM else 0.0
    earliest = first - _LAG_ROWS[_LAG_ROWS.shape[0] - 1]
    quadratics_by_changes(earliest, segments.params, segments, config, model, work.change)
    for k in range(_LAG_ROWS.shape[0]):
        since = first - _LAG_ROWS[k]
        if change_evidence(since, samples, segments, config, work.change) > enough:
            _begin_after(since, first, state, segments, config, model, work)
            return
    if surprise[0] >= CUSUM_ALARM:
        surprise[0] = 0.0


@kernel
def score(first, rows, state, config, model, work):
    """Compare what the refits predicted at a row with what came."""
    count, errors, worse = state.count, state.errors, 0.0
    if first <= count[ALARM]:
        return  # the short refits were others when it began
    count[SCORED] += 1.0
    for r in range(_candidates(config)):
        xi = state.past[first // config.spacing % state.past.shape[0], r]
        error = forecast_error(first, rows, xi, model, config, work.line)
        error = math.log(min(max(error, SQUARED_ERROR_MIN), SQUARED_ERROR_MAX))
        if r == int(count[CHOSEN]):
            worse = min(error - errors[r], CUSUM_CLIP)
        errors[r] += (error - errors[r]) / min(count[SCORED], RECORD_SEGMENTS)
    surprise = state.surprise
    surprise[0] = min(max(surprise[0] + worse - CUSUM_DRIFT, 0.0), CUSUM_ALARM)
    if not _may_change(first, count):
        surprise[0] = 0.0


@kernel
def _best(state, config):
    """Return the candidate with the best record; the default until another has proved better."""
    best, most = 0, -math.inf
    default = JOINT if config.joint == FIRST else 0
    for r in range(_candidates(config)):
        lead = _lead(r, state.errors) + (1.0 if r == default else 0.0)
        if lead > most:
            best, most = r, lead
    return best


@kernel
def select_data_weight(newest, state, segments, config, model, work):
    """Refit with the weight in use and another in turn, and use the best candidate."""
    count, params, factors = state.count, state.params, state.factors
    _test_for_change(newest, state, segments, config, model, work)
    count[TURN] += 1.0
    chosen = int(count[CHOSEN])
    first = chosen if chosen < REFITS else int(count[TURN] + 1) % REFITS
    other = int(count[TURN]) % (REFITS - 1)
    for r in (first, other if other < first else other + 1):
        since = max(newest - int(_SPAN_ROWS[r]), int(count[CHANGED]) if r >= SHORT else 0, 0)
        known = Known(_DATA_WEIGHTS[r], since, work.solve.none, config.information)
        if r >= SHORT and newest - count[CHANGED] < config.span and state.information[0] > 0.0:
            known = Known(_DATA_WEIGHTS[r], since, state.pull, state.information)
        if solve(params[r], known, ITERATIONS, segments, config, work):
            store_factor(work.solve.U, factors[r])
    if count[SCORED] >= SCORED_MIN:
        count[CHOSEN] = chosen = _best(state, config)
    use(params[chosen], factors[chosen if chosen < REFITS else 0], segments, work)


class DataWeightSelector:
    """Refits of the same segments with unequal data weights, and the mean error of each.

    The segments' ``params`` and ``cov`` are those of the refit in use. ``memory`` is its memory,
    flat, and ``state`` the same by name. Of these, ``params`` (c, p) are the parameters of each
    candidate, ``errors`` (c,) the mean logarithms of each one's squared errors.
    """

    def __init__(self, segments: Segments) -> None:
        self.segments = segments
        self._sizes = len(segments.prior), segments.steps, segments.config.spacing
        self.memory = np.zeros(flat_size(selector_state, *self._sizes))
        self.state: SelectorState = python_views(selector_state)(self.memory, *self._sizes)
        self.params, self.errors = self.state.params, self.state.errors
        self.reset()

    @property
    def dtype(self) -> np.dtype[Any]:
        """Structured dtype of the memory; see :class:`SelectorState`."""
        return named_dtype(selector_state, *self._sizes)

    def reset(self) -> None:
        """Forget everything; all begin with the prior."""
        self.memory[:] = 0.0
        self.state.count[NOTED] = -1.0
        self.state.count[CHANGED] = -COUNT_MAX
        self.state.count[ALARM] = -COUNT_MAX
        self.state.count[CHOSEN] = JOINT if self.segments.config.joint == FIRST else 0
        self.params[:] = self.state.past[:] = self.segments.prior

    @property
    def chosen(self) -> int:
        """The candidate in use: a refit, :data:`PRIOR` or :data:`JOINT`."""
        return int(self.state.count[CHOSEN])

    @property
    def refitted(self) -> bool:
        """Whether there was a refit."""
        return bool(self.state.count[TURN] > 0.0)

    @property
    def uses_prior(self) -> bool:
        """Whether the parameters in use are the prior's."""
        return not self.refitted or self.chosen == PRIOR

    @property
    def name(self) -> str:
        """The candidate in use after the first refit, in plain words."""
        return _NAMES.get(self.chosen) or self._refit_name(self.chosen)

    def _refit_name(self, r: int) -> str:
        """Return the name of a refit: its window, s, and its data weight."""
        span = min(SPANS_S[r], self.segments.config.span * GRID)
        return f"the refit to the last {span:.0f} s, data weight {DATA_WEIGHTS[r]:g}"

    def best_refit(self) -> tuple[Array, Array] | None:
        """Return mean and standard deviations, each (p,), of the best refit; None without one."""
        best = int(linearised_at(self.state))
        factor = self.state.factors[best]
        if not factor[0, 0] > 0.0:
            return None
        inverse = np.linalg.inv(factor)  # the covariance is that times its transpose
        return self.params[best].copy(), np.sqrt(np.sum(inverse**2, axis=1))
