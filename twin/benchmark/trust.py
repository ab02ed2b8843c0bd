"""How far a twin of a log may be trusted: five or six answers with numbers, and a colour.

The twin runs over the log once. Meanwhile its forecasts are scored as in the benchmark, against
the log's own fixes and headings and beside persistence, and copies of it go on without GPS.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.benchmark.protocol import BenchmarkError
from twin.benchmark.scores import Reference, score
from twin.benchmark.trust_answers import (
    AMBER,
    COLOURS,
    DOUBTFUL_AMBER,
    EXCLUDED_AMBER,
    EXCLUDED_RED,
    FAR,
    FAR_AMBER,
    GREEN,
    RED,
    SEE_CHECK,
    SPEED_LEAST,
    SPEED_MOST,
    Answer,
    HealthCount,
    other_boat,
    parameter_answer,
    sensor_answer,
    turned_effects,
    with_parameters_in_use,
)
from twin.boat_prior import ENVIRONMENT
from twin.digital_twin import Twin, known_plan
from twin.filters.navigator import Navigator
from twin.integrity.findings import Finding
from twin.logs.log import Log
from twin.model.priors import kind_of, scaled_prior
from twin.motion.tilt_meter import TILT_HORIZON, TiltMeter
from twin.particulars import Particulars
from twin.predictors.base import Z90, Estimate, ParametersInUse, Prediction
from twin.predictors.baselines import hold_velocity
from usv_kernel.scalar import wrap

__all__ = [
    "AMBER",
    "GREEN",
    "RED",
    "RULES",
    "Answer",
    "GpsLoss",
    "ScoredForecast",
    "TrustMeter",
    "Verdict",
    "position_bound",
    "worst_of",
]

Array = NDArray[np.float64]

HORIZON = 10.0
"""Of the forecasts that are scored, s."""

STEP = 0.25
"""Of the forecasts, s, where the log has no longer one."""

RATIO_GREEN, RATIO_AMBER = 0.9, 1.1
"""Error over that of persistence, up to which a forecast is green or amber."""

RATIO_LIMITS = f"green up to {RATIO_GREEN:g}, red above {RATIO_AMBER:g}"
"""The same in words, beside a ratio that is not green."""

COVERAGE_GREEN, COVERAGE_AMBER = 0.75, 0.5
"""Share inside the claimed 90 %, from which on it is green or amber ..."""

CLAIMED, CHANCE = 0.9, 2.5
"""... and how many standard deviations less than claimed a short log may show by chance."""

STEADY = 2.0
"""Where persistence is off by so many times the noise of the sensors, the boat kept its motion."""

BEARS_GREEN, BEARS_AMBER = 30.0, 10.0
"""Seconds without GPS from which on they are green or amber."""

BOUND_MIN, BOUND_NOISE = 5.0, 5.0
"""The bound of the position error without GPS is at least this (m, standard deviations of a fix),
or the boat's length if that is more."""

LOSSES, LOSS_SPAN = 8, 60.0
"""Losses of GPS that are tried, and the longest, s."""

EVERY = 2.0
"""Time between forecasts, s."""

SCORED_MIN = 60.0
"""Forecasts over less time than this, s, say too little: they are never red."""

LOSS_MIN = BEARS_AMBER
"""A shorter one says nothing, s."""

RULES = (
    "Green needs all of these. "
    f"Forecast: the error at {HORIZON:g} s is up to {RATIO_GREEN:g} of that of persistence, which "
    "holds the velocities. The noise of the sensors is allowed too, or "
    f"{STEADY:g} times it where persistence errs no more. "
    f"Coverage: {COVERAGE_GREEN:.0%} or more lie inside the claimed 90 %; a short log may show "
    f"less by chance. Without GPS: {BEARS_GREEN:g} s or more. "
    f"Parameters: none is beyond {FAR:g} prior standard deviations, and no effect of a command "
    "has the other sign. Steering is as the particulars say. The speed straight ahead is "
    f"{SPEED_LEAST:g} to {SPEED_MOST:g} times the stated one. The parameters in use are not the "
    "prior of a population. Sensors: the log check has no error or warning, and no sensor is "
    f"excluded for {EXCLUDED_AMBER:.0%} or doubtful for {DOUBTFUL_AMBER:.0%} of the run. "
    f"Attitude, where the log has it: error after {TILT_HORIZON:g} s and coverage by the same "
    "limits.\n\n"
    f"Amber allows {RATIO_AMBER:g} of persistence, a coverage of {COVERAGE_AMBER:.0%}, and "
    f"{BEARS_AMBER:g} s without GPS. It allows up to {FAR_AMBER} parameters beyond, or more where "
    "the first three lines are green. It allows a population's prior in use, and warnings. What a "
    f"log is too short to tell is amber: forecasts over less than {SCORED_MIN:g} s.\n\n"
    "Red is anything else, such as commands, GPS or compass that are excluded for "
    f"{EXCLUDED_RED:.0%} of the run. The worst line counts."
)
"""The rules of the colours, for a help page."""


class ScoredForecast(NamedTuple):
    """One forecast, and how far it and persistence were off at :data:`HORIZON`."""

    t: float  # time at which it was made, s
    path: Array  # (k, 2) positions from the start on, m
    error: tuple[float, float]  # m, rad
    persistence: tuple[float, float]  # m, rad
    covered: tuple[bool, bool]  # position and heading inside the claimed 90 %


class GpsLoss(NamedTuple):
    """A stretch of the log in which a copy of the twin got no fixes."""

    t: float  # when it began, s
    after: Array  # (k,) seconds without GPS at each fix of the log
    error: Array  # (k,) error of the displacement then, m


@dataclass(frozen=True, eq=False)
class Verdict:
    """The answers, and what they were made from."""

    boat: str
    log: str
    predictor: str
    bound: float  # of the position error without GPS, m
    answers: tuple[Answer, ...]
    forecasts: tuple[ScoredForecast, ...]
    losses: tuple[GpsLoss, ...]
    # names, and deviation from the prior in its standard deviations, largest first
    deviations: tuple[tuple[str, float], ...]
    in_use: ParametersInUse | None = None  # None where the predictor has no choice

    @property
    def colour(self) -> str:
        """The worst of the answers' colours."""
        return max((answer.colour for answer in self.answers), key=COLOURS.index)

    @property
    def fault(self) -> str:
        """Why sensors or commands are at fault, so that parameters learned the fault; or empty."""
        for answer in self.answers:
            turned = answer.about == "parameters" and answer.numbers.get("sign")
            if answer.colour == RED and (answer.about == "sensors" or turned):
                return answer.text.removesuffix(f": {SEE_CHECK}").removesuffix(f"; {SEE_CHECK}")
        return ""

    def to_json(self) -> dict[str, Any]:
        """Return all numbers as plain data."""
        return {
            "boat": self.boat,
            "log": self.log,
            "predictor": self.predictor,
            "colour": self.colour,
            "answers": [answer.to_json() for answer in self.answers],
            "gps_losses": [
                {"t_s": loss.t, "after_s": loss.after.tolist(), "error_m": loss.error.tolist()}
                for loss in self.losses
            ],
            "deviations_in_prior_sd": dict(self.deviations),
            "parameters_in_use": None if self.in_use is None else self.in_use.name,
        }


def worst_of(verdicts: Sequence[Verdict]) -> Verdict:
    """Return one verdict on several runs of a boat: of each answer, the worst one.

    Of answers of one colour, that with the worst number.

    Parameters
    ----------
    verdicts : sequence of Verdict
        One for each run, of one boat and predictor.
    """
    answers = []
    for about in dict.fromkeys(answer.about for each in verdicts for answer in each.answers):
        found = [(each.log, a) for each in verdicts for a in each.answers if a.about == about]
        log, worst = max(found, key=lambda pair: _badness(pair[1]))
        same = sum(pair[1].colour == worst.colour for pair in found)
        count = f"{same} of {len(found)}" if same < len(found) else f"all {len(found)}"
        runs = f"; {count} runs {worst.colour}" if len(found) > 1 else ""
        more = f" [of {log}{runs}]" if len(verdicts) > 1 else ""
        answers.append(dataclasses.replace(worst, text=worst.text + more))
    deviations: dict[str, float] = {}
    for name, size in (pair for each in verdicts for pair in each.deviations):
        deviations[name] = max(size, deviations.get(name, 0.0))
    return dataclasses.replace(
        verdicts[0],
        log=f"{len(verdicts)} runs of {verdicts[0].boat}",
        answers=tuple(answers),
        forecasts=tuple(f for each in verdicts for f in each.forecasts),
        losses=tuple(loss for each in verdicts for loss in each.losses),
        deviations=tuple(sorted(deviations.items(), key=lambda pair: -pair[1])),
    )


def _badness(answer: Answer) -> tuple[int, tuple[float, ...]]:
    """Return what orders answers: by colour, then by the number."""
    # where there is none, the log cannot tell: it has no worse number than another
    return COLOURS.index(answer.colour), answer.badness


def position_bound(particulars: Particulars) -> float:
    """Return the position error (m) beyond which a twin without GPS is not to be trusted."""
    noise = BOUND_NOISE * particulars.instruments.gps_sd
    return max(particulars.length, BOUND_MIN, noise)


class TrustMeter:
    """Scores a twin while it runs over a log; call it after each row.

    Parameters
    ----------
    twin : Twin
        Before the first row of the log.
    log : Log
        Without truth.
    """

    def __init__(self, twin: Twin, log: Log) -> None:
        self.twin, self.log = twin, log
        self.particulars = twin.particulars
        self.bound = position_bound(self.particulars)
        self.prior = twin.estimate()  # parameters before the first row
        self._navigator = Navigator(self.particulars)
        self._health = HealthCount()
        try:
            self._reference: Reference | None = Reference(log)
        except BenchmarkError:
            self._reference = None
        first, last = float(log.t[0]), float(log.t[-1])
        span = last - first
        self._next = first + min(60.0, 0.4 * span)
        self._next_tilt = self._next
        self._end = last - HORIZON
        length = min(LOSS_SPAN, 0.4 * span)
        starts = np.linspace(max(self._next, first + 0.5 * span), last - length, LOSSES)
        self._loss_length = length
        self._loss_starts = starts.tolist() if length >= LOSS_MIN else []
        self._row = 0
        self._tilt = TiltMeter(twin.motion)
        self.forecasts: list[ScoredForecast] = []
        self.losses: list[GpsLoss] = []

    def __call__(self) -> None:
        """Take note of the row that the twin has just taken."""
        row, log = self._row, self.log
        self._row += 1
        t = float(log.t[row])
        step = t - float(log.t[row - 1]) if row else 0.0
        self._navigator.update(step, log.z[row])
        self._health.take(step, self.twin.health_history.at(t))
        self._tilt.take(t)
        if self._reference is None:
            return
        if self.twin.motion.active and self._next_tilt - 1e-9 <= t <= self._end + 1e-9:
            while self._next_tilt <= t + 1e-9:
                self._next_tilt += EVERY
            self._note_tilt(row)
        if t >= self._next - 1e-9 and t <= self._end + 1e-9:
            while self._next <= t + 1e-9:
                self._next += EVERY
            self._score(row, t)
        if self._loss_starts and t >= self._loss_starts[0] - 1e-9:
            del self._loss_starts[0]
            self._lose_gps(row)

    def _plan(self, row: int, horizon: float) -> tuple[Array, float]:
        """Return the commands after a row, and the time between them, s."""
        dt = min(max(self.log.dt, STEP), 0.5)
        return known_plan(self.log, row, horizon, dt), dt

    def _note_tilt(self, row: int) -> None:
        """Forecast roll and pitch from a row: the boat heels as it will turn until then."""
        predictor = self.twin.predictor
        if not predictor.ready:
            return
        plan, dt = self._plan(row, TILT_HORIZON)
        after, states = dt * np.arange(1.0, len(plan) + 1.0), predictor.mean(plan, dt)
        self._tilt.note(self.twin.motion.forecast(after, states, predictor.state))

    def _score(self, row: int, t: float) -> None:
        """Score forecasts of twin and persistence from a row."""
        assert self._reference is not None
        times = np.array([t, t + HORIZON])
        if not self._reference.known(times):
            return
        truth = self._reference.at(times)
        plan, dt = self._plan(row, HORIZON)
        prediction = self.twin.predictor.predict(plan, dt)
        own = score(_with_noise(prediction, self.particulars), truth, (HORIZON,))
        error = float(own.displacement[0]), abs(float(own.error[0, -1]))
        covered = bool(own.covered[0, -1]), bool(own.covered[0, -2])
        state = self._navigator.state
        held = hold_velocity(state, state[3:], np.array([HORIZON]))[0]
        moved = held[:2] - state[:2] - (truth[1, :2] - truth[0, :2])
        persistence = float(np.hypot(*moved)), abs(wrap(float(held[2] - truth[1, 2])))
        path = np.concatenate([prediction.start[None, :2], prediction.mean[3::4, :2]])
        self.forecasts.append(ScoredForecast(t, path, error, persistence, covered))

    def _lose_gps(self, row: int) -> None:
        """Let a copy of the twin go on without fixes, and note its errors."""
        log, predictor = self.log, copy.deepcopy(self.twin.predictor)
        t_0 = float(log.t[row])
        ends = int(np.searchsorted(log.t, t_0 + self._loss_length, side="right"))
        seen = np.asarray(np.isfinite(log.z[:, :2]).all(axis=1))
        earlier = np.flatnonzero(seen[: row + 1])
        if not len(earlier) or t_0 - log.t[earlier[-1]] > 2.0 or not predictor.estimate().ready:
            return
        # what the last fixes differ by, such as noise and delay, is no error of the loss
        start = predictor.state[:2] - self._fix(t_0)
        after, error = [], []
        for k in range(row + 1, ends):
            z = log.z[k].copy()
            z[:4] = np.nan
            predictor.update(float(log.t[k]), float(log.t[k] - log.t[k - 1]), z, log.cmd[k])
            if seen[k]:
                off = predictor.state[:2] - log.z[k, :2] - start
                after.append(float(log.t[k]) - t_0)
                error.append(float(np.hypot(*off)))
        if after:
            self.losses.append(GpsLoss(t_0, np.array(after), np.array(error)))

    def _fix(self, t: float) -> Array:
        """Return the position of the fixes at a time."""
        assert self._reference is not None
        return self._reference.at(np.array([t]))[0, :2]

    def verdict(self, findings: Sequence[Finding] = ()) -> Verdict:
        """Return the five answers, and a sixth where the log shows roll and pitch.

        Parameters
        ----------
        findings : sequence of Finding
            Of ``twin.integrity.log_check.check_log``.
        """
        in_use, own = self.twin.predictor.parameters_in_use(), self.particulars.prior is not None
        last = self._compared(in_use)
        deviations, drag = self._deviations(last)
        turned = turned_effects(self.twin.predictor.parameter_names, self.prior, last)
        scores = self._forecast_answer(), self._coverage_answer(), self._loss_answer()
        other = other_boat(self.log, self.particulars)
        parameters = parameter_answer(deviations, turned, drag, other, own)
        parameters = with_parameters_in_use(parameters, in_use, own)
        if not self.twin.estimate().ready:
            parameters = Answer("parameters", AMBER, "cannot tell: no fix and heading together")
        elif parameters.colour == RED and all(answer.colour == GREEN for answer in scores):
            # the prior may be too narrow for a boat that its twin predicts well
            parameters = dataclasses.replace(parameters, colour=AMBER)
        answers: tuple[Answer, ...] = (*scores, parameters, sensor_answer(findings, self._health))
        if self.twin.motion.active:
            answers = (*answers, self._tilt_answer())
        return Verdict(
            boat=self.particulars.name,
            log=self.log.name,
            predictor=str(self.twin.name),
            bound=self.bound,
            answers=answers,
            forecasts=tuple(self.forecasts),
            losses=tuple(self.losses),
            deviations=tuple(deviations),
            in_use=in_use,
        )

    def _compared(self, in_use: ParametersInUse | None) -> Estimate:
        """Return the last estimate, with the best refit's parameters where the prior is in use."""
        last = self.twin.estimate()
        if in_use is None or not in_use.is_prior or in_use.refit is None:
            return last
        mean, sd = in_use.refit
        return dataclasses.replace(last, params=mean, params_sd=sd)

    def _forecast_answer(self) -> Answer:
        if not self.forecasts:
            return Answer("forecast", AMBER, "cannot tell: too few fixes and headings")
        own = _root_mean_square([f.error for f in self.forecasts])
        held = _root_mean_square([f.persistence for f in self.forecasts])
        on_board = self.particulars.instruments
        # two fixes, each of two coordinates; two headings
        noise = math.sqrt(2.0) * np.array([math.sqrt(2.0) * on_board.gps_sd, on_board.compass_sd])
        ratio = own / np.maximum(held, 1e-12)
        small = (own <= noise) | ((own <= STEADY * noise) & (held <= STEADY * noise))
        worst = float(np.max(np.where(small, 0.0, ratio)))
        degrees = math.degrees(own[1]), math.degrees(held[1])
        text = (
            f"{own[0]:.2f} m and {degrees[0]:.1f} degrees off after {HORIZON:g} s; persistence "
            f"{held[0]:.2f} m and {degrees[1]:.1f} degrees"
        )
        numbers = {
            "n": len(self.forecasts),
            "displacement_m": float(own[0]),
            "heading_rad": float(own[1]),
            "persistence_displacement_m": float(held[0]),
            "persistence_heading_rad": float(held[1]),
        }
        colour = _colour(worst <= RATIO_GREEN, worst <= RATIO_AMBER, self._seconds)
        above = [
            f"{name} {value:.3f} times persistence ({RATIO_LIMITS})"
            for name, value, fine in zip(("position", "heading"), ratio, small, strict=True)
            if value > RATIO_GREEN and not fine
        ]
        text += _why(above, worst > RATIO_AMBER, self._seconds)
        return Answer("forecast", colour, text, numbers, (worst, float(ratio.max())))

    def _coverage_answer(self) -> Answer:
        if not self.forecasts:
            return Answer("coverage", AMBER, "cannot tell: no forecast could be scored")
        place, heading = np.mean([f.covered for f in self.forecasts], axis=0).tolist()
        count = len(self.forecasts)
        text = (
            f"{place:.0%} of positions and {heading:.0%} of headings inside the claimed 90 % "
            f"({count} {'forecast' if count == 1 else 'forecasts'})"
        )
        worst = min(place, heading)
        seconds = self._seconds
        bound = _coverage_bound(seconds)
        colour = _colour(worst >= bound, worst >= COVERAGE_AMBER, seconds)
        below = [
            f"{name} below {bound:.0%}"
            for name, share in (("positions", place), ("headings", heading))
            if share < bound
        ]
        text += _why(below, worst < COVERAGE_AMBER, seconds)
        numbers = {"position": place, "heading": heading}
        return Answer("coverage", colour, text, numbers, (-worst, -max(place, heading)))

    def _tilt_answer(self) -> Answer:
        if (found := self._tilt.score()) is None:
            return Answer("attitude", AMBER, "cannot tell: no forecast of roll could be scored")
        error, held = np.degrees(found.error), np.degrees(found.held)
        text = (
            f"roll {error[0]:.1f} and pitch {error[1]:.1f} degrees off after {TILT_HORIZON:g} s; "
            f"held {held[0]:.1f} and {held[1]:.1f}; {found.inside[0]:.0%} and "
            f"{found.inside[1]:.0%} inside the claimed 90 %"
        )
        # a boat that hardly moves is as well known as its sensors are
        ratio = np.where(found.error <= STEADY * found.known, 0.0, found.error / found.held)
        worst, inside = float(ratio.max()), float(found.inside.min())
        colour = _colour(
            worst <= RATIO_GREEN and inside >= _coverage_bound(found.seconds),
            worst <= RATIO_AMBER and inside >= COVERAGE_AMBER,
            found.seconds,
        )
        bound, names = _coverage_bound(found.seconds), ("roll", "pitch")
        reasons = [
            f"{name} {value:.3f} times the held angle ({RATIO_LIMITS})"
            for name, value in zip(names, ratio, strict=True)
            if value > RATIO_GREEN
        ]
        reasons += [
            f"{name} below {bound:.0%}"
            for name, share in zip(names, found.inside, strict=True)
            if share < bound
        ]
        text += _why(reasons, worst > RATIO_AMBER or inside < COVERAGE_AMBER, found.seconds)
        numbers = {name: np.asarray(part).tolist() for name, part in found._asdict().items()}
        return Answer("attitude", colour, text, numbers, (worst, -inside))

    @property
    def _seconds(self) -> float:
        """Time over which forecasts were scored, s."""
        return self.forecasts[-1].t - self.forecasts[0].t

    def _loss_answer(self) -> Answer:
        if not self.losses:
            long_enough = self._loss_length >= LOSS_MIN
            lacks = "has too few fixes and headings" if long_enough else "is too short"
            text = f"cannot tell: the log {lacks} to cut GPS losses into it"
            return Answer("without GPS", AMBER, text, {"bound_m": self.bound})
        bears, held = [], []
        for loss in self.losses:
            beyond = np.flatnonzero(np.asarray(loss.error > self.bound))
            held.append(not len(beyond))
            bears.append(float(loss.after[beyond[0] if len(beyond) else -1]))
        # a loss that ended within the bound says nothing against longer ones
        counted = [math.inf if ok else s for s, ok in zip(bears, held, strict=True)]
        median = int(np.argsort(counted, kind="stable")[(len(counted) - 1) // 2])
        at_least = "at least " if held[median] else ""
        end = float(np.median([loss.error[-1] for loss in self.losses]))
        many = len(bears) > 1
        tried = f"median of {len(bears)} losses" if many else "one loss"
        text = (
            f"position within {self.bound:.3g} m for {at_least}{bears[median]:.0f} s "
            f"({tried} of {self._loss_length:.0f} s{f'; shortest {min(bears):.0f} s' * many}); "
            f"{'median ' * many}error at the end {end:.1f} m"
        )
        numbers = {
            "bound_m": self.bound,
            "seconds": bears,
            "within_bound": held,
            "end_error_m": [float(loss.error[-1]) for loss in self.losses],
        }
        typical = counted[median]
        colour = GREEN if typical >= BEARS_GREEN else AMBER if typical >= BEARS_AMBER else RED
        if colour != GREEN:
            text += f"; green from {BEARS_GREEN:g} s on"
        return Answer("without GPS", colour, text, numbers, (-typical, end))

    def _deviations(self, last: Estimate) -> tuple[list[tuple[str, float]], float]:
        """Return how far parameters ended from the prior, in its deviations; and a factor.

        The factor is that of drag where the prior was rough, else 1.
        """
        names = self.twin.predictor.parameter_names
        mean, sd, factor = self.prior.params, self.prior.params_sd, 1.0
        own = self.particulars.prior is not None
        if len(names) and kind_of(self.particulars) == "differential" and not own:
            factor, mean, sd = scaled_prior(names, mean, sd, last.params)
        far = np.abs(last.params - mean) / np.where(sd > 0.0, sd, math.inf)
        pairs = [
            pair for pair in zip(names, far.tolist(), strict=True) if pair[0] not in ENVIRONMENT
        ]
        return sorted(pairs, key=lambda pair: -pair[1]), factor


def _coverage_bound(seconds: float) -> float:
    """Return the share inside the claimed 90 % from which on it is green, of forecasts so long."""
    # forecasts that overlap count as one
    chance = CHANCE * math.sqrt(CLAIMED * (1.0 - CLAIMED) / (1.0 + seconds / HORIZON))
    return max(min(COVERAGE_GREEN, CLAIMED - chance), COVERAGE_AMBER)


def _colour(is_green: bool, is_amber: bool, seconds: float) -> str:
    """Return the colour of scores of forecasts over a time, s; few of them are never red."""
    return GREEN if is_green else AMBER if is_amber or seconds < SCORED_MIN else RED


def _why(reasons: Sequence[str], is_bad: bool, seconds: float) -> str:
    """Return which of the scores are not green, as the end of a sentence; empty if all are.

    ``is_bad``: they would be red, of forecasts over :data:`SCORED_MIN` or more.
    """
    if not reasons:
        return ""
    short = f", over {seconds:.0f} s: too few to judge" if is_bad and seconds < SCORED_MIN else ""
    return f": {'; '.join(reasons)}{short}"


def _root_mean_square(pairs: list[tuple[float, float]]) -> Array:
    return np.asarray(np.sqrt(np.mean(np.square(pairs), axis=0)), dtype=np.float64)


def _with_noise(prediction: Prediction, particulars: Particulars) -> Prediction:
    """Return a prediction of what sensors will measure: their noise is added to the intervals."""
    on_board = particulars.instruments
    cov, low, high = (a.copy() for a in (prediction.cov, prediction.low, prediction.high))
    # position: noise of two fixes, at start and end
    for i in (0, 1):
        cov[:, i, i] += 2.0 * on_board.gps_sd**2
    more = (Z90 * on_board.compass_sd) ** 2
    down, up = prediction.mean[:, 2] - low[:, 2], high[:, 2] - prediction.mean[:, 2]
    low[:, 2] = prediction.mean[:, 2] - np.sqrt(down**2 + more)
    high[:, 2] = prediction.mean[:, 2] + np.sqrt(up**2 + more)
    return dataclasses.replace(prediction, cov=cov, low=low, high=high)
