"""Whether the twin of a log may be trusted: a few answers with numbers, each ok, doubtful or bad.

The twin runs over the log once. Meanwhile its forecasts are scored as in the benchmark, against
the log's own fixes and headings and beside persistence, and copies of it go on without GPS.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.benchmark.loading import measured_truth
from twin.benchmark.protocol import BenchmarkError
from twin.benchmark.scores import Reference, as_measured, score
from twin.channels import MEASUREMENTS
from twin.digital_twin import Twin, known_plan
from twin.filters.navigator import Navigator
from twin.integrity.findings import ERROR, WARNING, Finding
from twin.integrity.monitor import SensorStatus
from twin.logs.log import Log
from twin.model.priors import kind_of, scaled_prior
from twin.model.structure import ENVIRONMENT
from twin.motion.tilt_meter import TILT_HORIZON, TiltMeter
from twin.particulars import Particulars
from twin.predictors.base import Estimate, ParametersInUse
from twin.predictors.baselines import hold_velocity
from twin.predictors.registry import DEFAULT
from twin.sim.oracle import check_simulator
from usv_kernel.scalar import wrap

__all__ = [
    "BAD",
    "DOUBTFUL",
    "OK",
    "Answer",
    "GpsLoss",
    "ScoredForecast",
    "TrustMeter",
    "Verdict",
    "judge",
]

Array = NDArray[np.float64]

OK, DOUBTFUL, BAD = "ok", "doubtful", "bad"

GRADES = (OK, DOUBTFUL, BAD)
"""From best to worst."""

HORIZON_S = 10.0
"""Length of the forecasts that are scored."""

FORECAST_EVERY_S = 2.0
FORECASTS_MAX = 600
"""Least time between two of them, and about how many at most: in a longer log they stand further
apart, evenly."""

FORECAST_STEP_MIN_S = 0.25
FORECAST_STEP_MAX_S = 0.5
"""Their step is that of the log within these bounds."""

RATIO_OK = 0.9
RATIO_DOUBTFUL = 1.1
"""Error over that of persistence, up to which a forecast is ok or doubtful."""

STEADY_NOISE = 2.0
"""Where twin and persistence err by less than so many times the noise of the sensors, the boat
kept its motion, and no twin can be better."""

COVERAGE_OK = 0.75
COVERAGE_DOUBTFUL = 0.5
"""Share inside the claimed 90 % from which on it is ok or doubtful."""

CLAIMED = 0.9
"""Share that the intervals claim to hold."""

CHANCE_SD = 2.5
"""A short log may show so many standard deviations less than claimed by chance."""

SCORED_MIN_S = 60.0
"""Forecasts over less time than this are never bad."""

WITHOUT_GPS_OK_S = 30.0
WITHOUT_GPS_DOUBTFUL_S = 10.0
"""Time without GPS within the bound from which on it is ok or doubtful."""

LOSSES = 8
"""Losses of GPS that are tried in the later half of the log."""

LOSS_MAX_S = 60.0
LOSS_MIN_S = 10.0
"""They last so long at most; shorter ones say nothing."""

BOUND_MIN_M = 5.0
BOUND_NOISE_SD = 5.0
"""The bound of the position error without GPS is the boat's length, this, or so many standard
deviations of a fix, whichever is largest."""

FAR_SD = 4.0
"""Prior standard deviations beyond which a parameter is far."""

FAR_DOUBTFUL = 4
"""Up to so many far parameters are doubtful, more are bad."""

SIGN_SD = 1.645
"""Standard deviations by which a sign is known to 95 %, in the prior and after the run."""

EFFECTS = {
    **dict.fromkeys(("X_nn", "T_uL", "T_uR"), "surge"),
    **dict.fromkeys(("Y_nn", "Y_F", "T_vL", "T_vR"), "sway"),
    **dict.fromkeys(("N_nn", "N_F", "N_dn", "T_rL", "T_rR"), "yaw"),
}
"""Parameters that say what commands do, and their equations."""

DAMPING = {
    **dict.fromkeys(("X_u", "X_u|u|", "X_uu"), "surge"),
    **dict.fromkeys(("Y_|u|v", "Y_v"), "sway"),
    **dict.fromkeys(("N_|u|r", "N_r"), "yaw"),
}
"""Parameters that damp the motion, and their equations."""

SPEED_RATIO_MIN = 0.4
SPEED_RATIO_MAX = 1.7
"""Bounds of the speed straight ahead over what the particulars say at that shaft speed: the
parameters move far enough to hide another boat. On 33 recorded runs of five boats with their own
particulars the ratio lies between .50 and 1.42."""

STRAIGHT_LENGTHS = 3.0
"""Over the time for so many lengths shaft speeds and course are to be steady."""

STRAIGHT_RATE = 0.2
"""Largest yaw rate times length over speed of a boat that goes straight ahead."""

STRAIGHT_MIN_S = 20.0
"""Less time straight ahead says nothing of the speed."""

STEADY_SHAFT = 0.2
FAST_SHAFT = 0.3
"""Largest standard deviation of steady shaft speeds over their mean, and the least mean over the
largest shaft speed of the run."""

EXCLUDED_DOUBTFUL = 0.05
DOUBTED_DOUBTFUL = 0.2
"""Shares of a run from which on a sensor that the twin excluded, or doubted, is doubtful."""

EXCLUDED_BAD = 0.8
"""Share from which on the exclusion of one of :data:`NEEDED` is bad."""

NEEDED = ("commands", "compass", "gps")
"""A twin learns nothing without these."""

_COMPASS = MEASUREMENTS.index("compass_rad")


class ScoredForecast(NamedTuple):
    """One forecast, and how far it and persistence were off after :data:`HORIZON_S`."""

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


@dataclass(frozen=True)
class Answer:
    """One line of a verdict.

    Parameters
    ----------
    about : str
        forecast, coverage, without GPS, parameters, sensors or attitude.
    grade : str
        ok, doubtful or bad.
    text : str
        The answer in words, with its numbers.
    numbers : dict
        The same for a program; SI units.
    """

    about: str
    grade: str
    text: str
    numbers: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Verdict:
    """Whether a twin may be trusted, and what that rests on.

    Parameters
    ----------
    boat, log, predictor : str
        Names.
    bound : float
        Of the position error without GPS, m.
    answers : tuple of Answer
        Five, and a sixth where the log shows roll and pitch.
    forecasts : tuple of ScoredForecast
        One every :data:`FORECAST_EVERY_S`, but about :data:`FORECASTS_MAX` at most.
    losses : tuple of GpsLoss
        Those that were tried.
    notes : tuple of str
        When the twin doubted or excluded which sensor.
    """

    boat: str
    log: str
    predictor: str
    bound: float
    answers: tuple[Answer, ...]
    forecasts: tuple[ScoredForecast, ...] = field(repr=False)
    losses: tuple[GpsLoss, ...] = field(repr=False)
    notes: tuple[str, ...] = ()

    @property
    def grade(self) -> str:
        """The worst grade of the answers."""
        return _worst(answer.grade for answer in self.answers)

    def to_json(self) -> dict[str, Any]:
        """Return all numbers as plain data."""
        return {
            "boat": self.boat,
            "log": self.log,
            "predictor": self.predictor,
            "grade": self.grade,
            "answers": [dataclasses.asdict(answer) for answer in self.answers],
            "gps_losses": [
                {"t_s": loss.t, "after_s": loss.after.tolist(), "error_m": loss.error.tolist()}
                for loss in self.losses
            ],
            "health_notes": list(self.notes),
        }


def judge(
    log: Log,
    particulars: Particulars,
    predictor: str = DEFAULT,
    *,
    findings: Sequence[Finding] = (),
    on_row: Callable[[], object] | None = None,
) -> Verdict:
    """Run a twin over a log, and say whether it may be trusted.

    Parameters
    ----------
    log : Log
        The run; its truth is not used.
    particulars : Particulars
        Of the boat.
    predictor : str, optional
        Its name, with options behind a colon.
    findings : sequence of Finding
        What :func:`twin.integrity.log_check.check_log` found in the log.
    on_row : callable, optional
        Called without arguments after each row.

    Returns
    -------
    Verdict
        With its numbers.
    """
    check_simulator(predictor, log, particulars)
    run = log.without_truth()
    twin = Twin(particulars, predictor)
    twin.locate(run.datum)
    meter = TrustMeter(twin, run)
    for row in run:
        twin.step(*row)
        meter()
        if on_row is not None:
            on_row()
    return meter.verdict(findings)


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
        # s, by sensor and status
        self._seconds_in: defaultdict[tuple[str, str], float] = defaultdict(float)
        try:
            self._reference: Reference | None = Reference(measured_truth(log)[0])
        except BenchmarkError:
            self._reference = None
        first, last = float(log.t[0]), float(log.t[-1])
        self._span = span = last - first
        self._next = self._next_tilt = first + min(60.0, 0.4 * span)
        self._end = last - HORIZON_S
        self._every = max(FORECAST_EVERY_S, (self._end - self._next) / FORECASTS_MAX)
        self._loss_length = min(LOSS_MAX_S, 0.4 * span)
        starts = np.linspace(max(self._next, first + 0.5 * span), last - self._loss_length, LOSSES)
        self._loss_starts = starts.tolist() if self._loss_length >= LOSS_MIN_S else []
        self._row = 0
        self._statuses: Mapping[str, SensorStatus] | None = None
        self._doubted: dict[str, str] = {}  # status of each sensor that is not ok, of these
        # stretches whose fixes the twin left out, s, and when it last did not doubt them
        self._excluded: list[list[float]] = []
        self._undoubted = first
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
        statuses = self.twin.health_history.at(t)
        if statuses is not self._statuses:
            self._statuses = statuses
            self._doubted = {
                sensor: now.status
                for sensor, now in statuses.items()
                if now.status in ("doubtful", "excluded")
            }
        for key in self._doubted.items():
            self._seconds_in[key] += step
        if "gps" not in self._doubted:
            self._undoubted = t
        elif self._doubted["gps"] == "excluded":
            if not self._excluded or self._excluded[-1][1] <= self._undoubted:
                # to doubt fixes took samples, too: about as many as to exclude them
                self._excluded.append([2.0 * self._undoubted - t, t])
            self._excluded[-1][1] = t
        self._tilt.take(t)
        if self._reference is None:
            return
        if self.twin.motion.active and self._next_tilt - 1e-9 <= t <= self._end + 1e-9:
            while self._next_tilt <= t + 1e-9:
                self._next_tilt += self._every
            self._note_tilt(row)
        if self._next - 1e-9 <= t <= self._end + 1e-9:
            while self._next <= t + 1e-9:
                self._next += self._every
            self._score(row, t)
        if self._loss_starts and t >= self._loss_starts[0] - 1e-9:
            del self._loss_starts[0]
            self._lose_gps(row)

    def _plan(self, row: int, horizon: float) -> tuple[Array, float]:
        """Return the commands after a row, and the time between them, s."""
        dt = min(max(self.log.dt, FORECAST_STEP_MIN_S), FORECAST_STEP_MAX_S)
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
        times = np.array([t, t + HORIZON_S])
        if not self._reference.known(times):
            return
        truth = self._reference.at(times)
        plan, dt = self._plan(row, HORIZON_S)
        prediction = self.twin.predictor.predict(plan, dt)
        own = score(as_measured(prediction, self.particulars), truth, (HORIZON_S,))
        error = float(own.displacement[0]), abs(float(own.error[0, -1]))
        covered = bool(own.covered[0, -1]), bool(own.covered[0, -2])
        state = self._navigator.state
        held = hold_velocity(state, state[3:], np.array([HORIZON_S]))[0]
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
        assert self._reference is not None
        # what the last fixes differ by, such as noise and delay, is no error of the loss
        start = predictor.state[:2] - self._reference.at(np.array([t_0]))[0, :2]
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

    def _is_excluded(self, times: ArrayLike) -> NDArray[np.bool_]:
        """Return at which times the twin left the fixes out: they are no truth to score against."""
        at = np.asarray(times, dtype=np.float64)[..., None]
        first, last = np.array(self._excluded).reshape(-1, 2).T
        return np.asarray(((at > first) & (at <= last)).any(axis=-1))

    def _leave_out_excluded(self) -> None:
        """Keep the scores whose fixes the twin believed."""
        self.forecasts = [
            each
            for each in self.forecasts
            if not self._is_excluded([each.t, each.t + HORIZON_S]).any()
        ]
        losses = []
        for loss in self.losses:
            kept = ~self._is_excluded(loss.t + loss.after)
            if kept.any() and not self._is_excluded(loss.t):
                losses.append(GpsLoss(loss.t, loss.after[kept], loss.error[kept]))
        self.losses = losses

    def verdict(self, findings: Sequence[Finding] = ()) -> Verdict:
        """Return the verdict on the rows so far; fixes that the twin left out score nothing.

        Parameters
        ----------
        findings : sequence of Finding
            What :func:`twin.integrity.log_check.check_log` found in the log.
        """
        self._leave_out_excluded()
        scores = self._forecast_answer(), self._coverage_answer(), self._loss_answer()
        answers: tuple[Answer, ...] = (
            *scores,
            self._parameter_answer(scores),
            sensor_answer(findings, self._seconds_in, self._span),
        )
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
            notes=tuple(self.twin.notes),
        )

    @property
    def _seconds(self) -> float:
        """Time over which forecasts were scored, s."""
        return self.forecasts[-1].t - self.forecasts[0].t

    def _forecast_answer(self) -> Answer:
        if not self.forecasts:
            return Answer("forecast", DOUBTFUL, "cannot tell: too few fixes and headings")
        own = _root_mean_square([f.error for f in self.forecasts])
        held = _root_mean_square([f.persistence for f in self.forecasts])
        on_board = self.particulars.instruments
        # two fixes, each of two coordinates; two headings
        noise = math.sqrt(2.0) * np.array([math.sqrt(2.0) * on_board.gps_sd, on_board.compass_sd])
        small = (own <= noise) | ((own <= STEADY_NOISE * noise) & (held <= STEADY_NOISE * noise))
        worst = float(np.max(np.where(small, 0.0, own / np.maximum(held, 1e-12))))
        text = (
            f"{own[0]:.2f} m and {math.degrees(own[1]):.1f} degrees off after {HORIZON_S:g} s; "
            f"persistence {held[0]:.2f} m and {math.degrees(held[1]):.1f} degrees"
        )
        numbers = {
            "n": len(self.forecasts),
            "displacement_m": float(own[0]),
            "heading_rad": float(own[1]),
            "persistence_displacement_m": float(held[0]),
            "persistence_heading_rad": float(held[1]),
        }
        grade = _grade(worst <= RATIO_OK, worst <= RATIO_DOUBTFUL, self._seconds)
        return Answer("forecast", grade, text + _limit(grade, RATIO_LIMIT, self._seconds), numbers)

    def _coverage_answer(self) -> Answer:
        if not self.forecasts:
            return Answer("coverage", DOUBTFUL, "cannot tell: no forecast could be scored")
        place, heading = np.mean([f.covered for f in self.forecasts], axis=0).tolist()
        text = (
            f"{place:.0%} of positions and {heading:.0%} of headings inside the claimed 90 % "
            f"(forecasts: {len(self.forecasts)})"
        )
        worst, bound = min(place, heading), _coverage_bound(self._seconds)
        grade = _grade(worst >= bound, worst >= COVERAGE_DOUBTFUL, self._seconds)
        text += _limit(grade, f"ok from {bound:.0%} on", self._seconds)
        return Answer("coverage", grade, text, {"position": place, "heading": heading})

    def _loss_answer(self) -> Answer:
        if not self.losses:
            long_enough = self._loss_length >= LOSS_MIN_S
            lacks = "has too few fixes and headings" if long_enough else "is too short"
            text = f"cannot tell: the log {lacks} to cut GPS losses into it"
            return Answer("without GPS", DOUBTFUL, text, {"bound_m": self.bound})
        seconds, held = [], []
        for loss in self.losses:
            beyond = np.flatnonzero(np.asarray(loss.error > self.bound))
            held.append(not len(beyond))
            seconds.append(float(loss.after[beyond[0] if len(beyond) else -1]))
        # a loss that ended within the bound says nothing against longer ones
        counted = [math.inf if ok else s for s, ok in zip(seconds, held, strict=True)]
        median = int(np.argsort(counted, kind="stable")[(len(counted) - 1) // 2])
        end = float(np.median([loss.error[-1] for loss in self.losses]))
        text = (
            f"position within {self.bound:.3g} m for {'at least ' if held[median] else ''}"
            f"{seconds[median]:.0f} s (median of losses: {len(seconds)} of {self._loss_length:.0f} "
            f"s; shortest {min(seconds):.0f} s); median error at the end {end:.1f} m"
        )
        numbers = {
            "bound_m": self.bound,
            "seconds": seconds,
            "within_bound": held,
            "end_error_m": [float(loss.error[-1]) for loss in self.losses],
        }
        typical = counted[median]
        grade = _grade(typical >= WITHOUT_GPS_OK_S, typical >= WITHOUT_GPS_DOUBTFUL_S)
        text += _limit(grade, f"ok from {WITHOUT_GPS_OK_S:g} s on")
        return Answer("without GPS", grade, text, numbers)

    def _tilt_answer(self) -> Answer:
        if (found := self._tilt.score()) is None:
            text = "cannot tell: no forecast of roll could be scored"
            return Answer("attitude", DOUBTFUL, text)
        error, held = np.degrees(found.error), np.degrees(found.held)
        text = (
            f"roll {error[0]:.1f} and pitch {error[1]:.1f} degrees off after {TILT_HORIZON:g} s; "
            f"held {held[0]:.1f} and {held[1]:.1f}; {found.inside[0]:.0%} and "
            f"{found.inside[1]:.0%} inside the claimed 90 %"
        )
        # a boat that hardly moves is as well known as its sensors are
        ratio = np.where(found.error <= STEADY_NOISE * found.known, 0.0, found.error / found.held)
        worst, inside = float(ratio.max()), float(found.inside.min())
        bound = _coverage_bound(found.seconds)
        grade = _grade(
            worst <= RATIO_OK and inside >= bound,
            worst <= RATIO_DOUBTFUL and inside >= COVERAGE_DOUBTFUL,
            found.seconds,
        )
        text += _limit(grade, f"{RATIO_LIMIT}; ok from {bound:.0%} inside on", found.seconds)
        numbers = {name: np.asarray(part).tolist() for name, part in found._asdict().items()}
        return Answer("attitude", grade, text, numbers)

    def _parameter_answer(self, scores: Sequence[Answer]) -> Answer:
        predictor, own = self.twin.predictor, self.particulars.prior is not None
        in_use, last = predictor.parameters_in_use(), self.twin.estimate()
        if in_use is not None and in_use.is_prior and in_use.refit is not None:
            mean, sd = in_use.refit
            last = dataclasses.replace(last, params=mean, params_sd=sd)
        if not self.twin.estimate().ready:
            return Answer("parameters", DOUBTFUL, "cannot tell: no fix and heading together")
        deviations, drag = self._deviations(last)
        turned = turned_effects(predictor.parameter_names, self.prior, last)
        answer = parameter_answer(
            deviations, turned, speed_ratio(self.log, self.particulars), drag, in_use, own
        )
        if answer.grade == BAD and all(score.grade == OK for score in scores):
            # the prior may be too narrow for a boat that its twin predicts well
            answer = dataclasses.replace(answer, grade=DOUBTFUL)
        return answer

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


RATIO_LIMIT = f"ok up to {RATIO_OK:g} times persistence, bad above {RATIO_DOUBTFUL:g}"
"""Ends a line on errors that are not ok."""


def position_bound(particulars: Particulars) -> float:
    """Return the position error (m) beyond which a twin without GPS is not to be trusted."""
    noise = BOUND_NOISE_SD * particulars.instruments.gps_sd
    return max(particulars.length, BOUND_MIN_M, noise)


def parameter_answer(
    deviations: Sequence[tuple[str, float]],
    turned: Sequence[str] = (),
    speed: float | None = None,
    drag: float = 1.0,
    in_use: ParametersInUse | None = None,
    own_prior: bool = False,
) -> Answer:
    """Return what the parameters say of the boat.

    Parameters
    ----------
    deviations : sequence of (str, float)
        Names, and distances from the prior in its standard deviations, largest first. Where the
        prior is in use they are those of the best refit.
    turned : sequence of str
        Effects of commands that ended with the other sign.
    speed : float or None
        What :func:`speed_ratio` says.
    drag : float
        Factor by which a rough prior was scaled.
    in_use : ParametersInUse or None
        Candidate in use. Forecasts with a population's prior confirm no parameters, so that the
        answer is doubtful at least.
    own_prior : bool
        Whether the prior is of earlier runs of this boat.
    """
    far = [(name, size) for name, size in deviations if size > FAR_SD]
    grades, parts = [], []
    if not deviations:
        parts.append("the predictor has none")
    elif far or turned:
        grades.append(DOUBTFUL if len(far) <= FAR_DOUBTFUL else BAD)
        shown = ", ".join(f"{name} ({size:.1f})" for name, size in far[:4])
        asked = "has the boat changed since its own prior" if own_prior else "wrong boat or units"
        if far:
            parts.append(
                f"{len(far)} of {len(deviations)} beyond {FAR_SD:g} prior standard deviations: "
                f"{shown}; {asked}?"
            )
        if turned:
            parts.append(f"other sign: {', '.join(turned[:4])}; wrong sides or signs of commands?")
    else:
        name, size = deviations[0]
        parts.append(f"all within {FAR_SD:g} prior standard deviations; largest {name}, {size:.1f}")
    if speed is not None and not SPEED_RATIO_MIN <= speed <= SPEED_RATIO_MAX:
        grades.append(DOUBTFUL)
        parts.append(
            f"straight ahead it goes {speed:.2g} times as fast as speed and shaft_speed say: "
            "wrong boat, or unit of the commands?"
        )
    if not 0.5 < drag < 2.0:
        parts.append(f"{drag:.2g} times the drag of the rough prior")
    if in_use is not None:
        parts.append(f"in use: {in_use.name}")
        if in_use.is_prior:
            grades += [] if own_prior else [DOUBTFUL]
            parts.append("no refit yet" if in_use.refit is None else "the rest is of a refit")
    numbers = {
        "far": dict(far),
        "deviations_in_prior_sd": dict(deviations),
        "sign": list(turned),
        "speed_ratio": speed,
        "count": len(deviations),
        "drag": drag,
        "in_use": None if in_use is None else in_use.name,
        "prior_in_use": in_use is not None and in_use.is_prior,
    }
    return Answer("parameters", _worst(grades), "; ".join(parts), numbers)


def turned_effects(names: Sequence[str], prior: Estimate, last: Estimate) -> list[str]:
    """Return the effects of commands that ended with the other sign, where both are sure.

    An effect and the damping of its motion that are both reversed are the two sides of one
    equation: a steady run has shown their ratio only.

    Parameters
    ----------
    names : sequence of str
        Names of the parameters (p,).
    prior, last : Estimate
        Before the first row, and at the end.
    """
    before, after = prior.params, last.params
    known = (before * after < 0.0) & (np.abs(before) > SIGN_SD * prior.params_sd)
    sure = known & (np.abs(after) > SIGN_SD * last.params_sd)
    damping = {
        DAMPING[name]
        for name, turned in zip(names, known, strict=True)
        if turned and name in DAMPING
    }
    return [
        name
        for name, turned in zip(names, sure, strict=True)
        if turned and name in EFFECTS and EFFECTS[name] not in damping
    ]


def speed_ratio(log: Log, particulars: Particulars) -> float | None:
    """Return the speed straight ahead over what the particulars say at that shaft speed.

    At steady shaft speed, and straight ahead, thrust and drag grow with the square of both. So
    speed over shaft speed is a number of the boat. None: the run shows too little of that.
    """
    fix = np.isfinite(log.z[:, :2]).all(axis=1)
    heading = np.isfinite(log.z[:, _COMPASS])
    if fix.sum() < 2 or heading.sum() < 2:
        return None
    step = 1.0
    t = np.arange(log.t[0], log.t[-1], step)
    x, y = (np.interp(t, log.t[fix], log.z[fix, k]) for k in (0, 1))
    # of the run itself, as the stated speed may be that of another boat
    far = np.hypot(x[4:] - x[:-4], y[4:] - y[:-4]) / (4.0 * step)
    typical = float(np.quantile(far, 0.75)) if len(far) else 0.0
    window = STRAIGHT_LENGTHS * particulars.length / max(typical * step, 1e-6)
    window = round(min(max(window, 4), max(len(t) // 4, 4)))
    if len(t) <= window:
        return None
    psi = np.interp(t, log.t[heading], np.unwrap(log.z[heading, _COMPASS]))
    shaft = np.interp(t, log.t, log.cmd[:, :2].mean(axis=1))
    way = np.hypot(x[window:] - x[:-window], y[window:] - y[:-window])
    turned = np.abs(psi[window:] - psi[:-window])
    mean = _averages(shaft, window)[: len(way)]
    scatter = np.sqrt(np.maximum(_averages(shaft**2, window)[: len(way)] - mean**2, 0.0))
    ahead = (mean > FAST_SHAFT * float(np.abs(shaft).max())) & (scatter < STEADY_SHAFT * mean)
    ahead &= (mean > 0.0) & (turned * particulars.length < STRAIGHT_RATE * way)
    if ahead.sum() * step < STRAIGHT_MIN_S:
        return None
    stated = mean[ahead] * particulars.speed / particulars.shaft_speed * window * step
    return float(np.median(way[ahead] / stated))


def _averages(values: Array, window: int) -> Array:
    """Return the means of so many values that follow each other."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray((total[window:] - total[:-window]) / window)


def sensor_answer(
    findings: Sequence[Finding], seconds_in: Mapping[tuple[str, str], float], span: float
) -> Answer:
    """Return which sensors and commands the check of the log doubts, and which the twin left out.

    Parameters
    ----------
    findings : sequence of Finding
        Of :func:`twin.integrity.log_check.check_log`.
    seconds_in : mapping of (str, str) to float
        How long the twin gave a sensor the status ``doubtful`` or ``excluded``, s.
    span : float
        Length of the run, s.
    """
    grades, parts = [], []
    if said := [finding.what for finding in findings if finding.severity == ERROR]:
        grades.append(BAD)
        parts += [*said[:2], f"errors in the log: {len(said)}"]
    if count := sum(finding.severity == WARNING for finding in findings):
        grades.append(DOUBTFUL)
        parts.append(f"warnings on the log: {count}")
    for (sensor, status), seconds in seconds_in.items():
        share = seconds / max(span, 1e-9)
        if status == "excluded" and share >= EXCLUDED_BAD and sensor in NEEDED:
            grades.append(BAD)
        elif share >= (EXCLUDED_DOUBTFUL if status == "excluded" else DOUBTED_DOUBTFUL):
            grades.append(DOUBTFUL)
        parts.append(f"{sensor} {status} for {seconds:.0f} s, {share:.0%} of the run")
    numbers = {
        "findings": {
            f"{f.code} {f.sensor}": f.severity for f in findings if f.severity in (ERROR, WARNING)
        },
        "health_s": {" ".join(key): seconds for key, seconds in seconds_in.items()},
    }
    return Answer("sensors", _worst(grades), "; ".join(parts) or "none in doubt", numbers)


def _worst(grades: Iterable[str]) -> str:
    return max(grades, key=GRADES.index, default=OK)


def _grade(is_ok: bool, is_doubtful: bool, seconds: float = math.inf) -> str:
    """Return the grade of scores of forecasts over a time, s; few of them are never bad."""
    return OK if is_ok else DOUBTFUL if is_doubtful or seconds < SCORED_MIN_S else BAD


def _limit(grade: str, limit: str, seconds: float = math.inf) -> str:
    """Return the end of a line that is not ok: what would be, and whether the log is too short."""
    short = f"; over {seconds:.0f} s: too few to judge" if seconds < SCORED_MIN_S else ""
    return "" if grade == OK else f"; {limit}{short}"


def _coverage_bound(seconds: float) -> float:
    """Return the share inside the claimed 90 % that is ok for forecasts over a time, s."""
    # forecasts that overlap count as one
    chance = CHANCE_SD * math.sqrt(CLAIMED * (1.0 - CLAIMED) / (1.0 + seconds / HORIZON_S))
    return max(min(COVERAGE_OK, CLAIMED - chance), COVERAGE_DOUBTFUL)


def _root_mean_square(pairs: list[tuple[float, float]]) -> Array:
    return np.asarray(np.sqrt(np.mean(np.square(pairs), axis=0)), dtype=np.float64)
