"""The contract of predictors as a list of checks, also for predictors of users.

``usv-twin benchmark --check module:Class`` runs them; the tests of this package run them on every
entry of ``twin.PREDICTORS``. They say nothing about the accuracy of predictions.
"""

from __future__ import annotations

import copy
import dataclasses
import inspect
import math
import pickle
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.benchmark.publish.sources import declared_files
from twin.benchmark.publish.user_code import (
    FileRead,
    lines_reading_later_rows,
    own_files,
    place_of_error,
    place_of_import,
    place_of_method,
    watched_files,
)
from twin.checkpoint import StateError
from twin.digital_twin import Twin, known_plan
from twin.logs.log import Log
from twin.predictors.base import ForecastError, Prediction
from twin.predictors.baselines import HistoryPredictor
from twin.predictors.registry import PredictorError, make_predictor, predictor_class
from twin.sim.bridge import particulars_of, simulate
from twin.sim.oracle import simulator_options
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.sea import SeaState
from usv_kernel.errors import UsvTwinError

__all__ = [
    "CHECKS",
    "Finding",
    "check",
]

Array = NDArray[np.float64]

LONGER = 8
"""A history is checked as it is, and so many times as long."""

ROWS = 500
"""Rows before the answers that the checks compare: 25 s at 20 Hz."""

TRAINED_AT = 20.0

SEED = 3

PLAN_DT = 0.1

PSD = 1e-7
"""Tolerance on negative eigenvalues of a correlation matrix: rounding errors."""


FORECASTING = ("forecast", "forecast_from_last", "path", "predict", "mean")
"""Methods that a forecast may come from, those that users write first."""


class BrokenError(UsvTwinError):
    """A violation of the contract; ``methods`` may have caused it, the likeliest first."""

    methods: tuple[str, ...] = ()
    place = ""


class NotSupportedError(UsvTwinError):
    """An optional feature that a predictor does not have."""


@dataclass(frozen=True)
class Finding:
    """The outcome of one check; ``passed`` is None where it is not supported, which is allowed."""

    name: str
    passed: bool | None
    text: str
    place: str = ""  # file and line of the predictor's own code that failed, where they are known


class _Trial:
    """A predictor by name, a run for it, and its answers at row :data:`ROWS`."""

    def __init__(self, name: str, opened: Sequence[FileRead]) -> None:
        self.name, self.opened = name, opened
        self.kind = predictor_class(name)
        self.files = own_files(self.kind)
        vessel, sea = Vessel.load("usv75"), SeaState(hs=0.5, wind=4.5)
        self.log = simulate("zigzag", vessel=vessel, sea=sea, duration=40.0, seed=7)
        self.particulars = particulars_of(vessel)
        self.options: dict[str, Any] = simulator_options(name, vessel, sea, 3)
        if self.kind.trains:
            self.options["train_at"] = TRAINED_AT
        self.plan = known_plan(self.log, ROWS - 1, 10.0, PLAN_DT)
        self._expected: list[Any] | None = None

    def new(self) -> Twin:
        return Twin(self.particulars, self.name, seed=SEED, **self.options)

    def after(self, log: Log | None = None, rows: int = ROWS) -> Twin:
        """Return a new twin after the first rows, which are views of the whole log."""
        twin = self.new()
        self.step(twin, log or self.log, 0, rows)
        return twin

    @staticmethod
    def step(twin: Twin, log: Log, first: int, last: int) -> None:
        z, cmd = log.z.copy(), log.cmd.copy()  # the predictor may write to them
        for k in range(first, last):
            twin.step(float(log.t[k]), z[k], cmd[k])

    def answers(self, twin: Twin) -> list[Any]:
        """Return estimate and predictions of a twin under two plans."""
        estimate = twin.estimate()
        found = [getattr(estimate, item.name) for item in dataclasses.fields(estimate)]
        held = twin.predict("hold", dt=0.25)
        known = twin.predict(self.plan.copy(), dt=PLAN_DT)
        again = twin.predict("hold", dt=0.25)
        if not np.array_equal(held.mean, again.mean):
            raise BrokenError("a prediction under one plan changes the next one under another plan")
        for prediction in (known, held):
            found += [getattr(prediction, item.name) for item in dataclasses.fields(prediction)]
        return [np.array(part, dtype=np.float64) for part in found]

    @property
    def expected(self) -> list[Any]:
        """The answers of an undisturbed twin at row :data:`ROWS`."""
        if self._expected is None:
            self._expected = self.answers(self.after())
        return self._expected

    def compare(self, twin: Twin, after: str, *methods: str) -> None:
        """Refuse other answers than those of an undisturbed twin."""
        for mine, other in zip(self.expected, self.answers(twin), strict=True):
            if not np.array_equal(mine, other, equal_nan=True):
                error = np.abs(mine - other).max() if mine.shape == other.shape else math.nan
                text = f"other answers {after}: they differ by up to {error:.3g}"
                _require(False, text, *methods)


def _require(good: bool, text: str, *methods: str) -> None:
    """Raise where something is false that one of some methods may have caused."""
    if not good:
        error = BrokenError(text)
        error.methods = methods
        raise error


def _require_valid(prediction: Prediction, rows: int, where: str) -> None:
    """Refuse wrong shapes and times, values that are not finite, and wrong covariances."""
    shapes = {"start": (6,), "start_cov": (6, 6), "t": (rows,), "mean": (rows, 6)}
    shapes |= {"cov": (rows, 6, 6), "low": (rows, 6), "high": (rows, 6)}
    for name, shape in shapes.items():
        value = np.asarray(getattr(prediction, name))
        other = f"{where}: {name} has shape {value.shape}, not {shape}"
        _require(value.shape == shape, other, *FORECASTING)
        _require(bool(np.isfinite(value).all()), f"{where}: {name} is not finite", *FORECASTING)
    after = np.diff(np.concatenate([[prediction.t0], prediction.t]))
    _require(bool((after > 0.0).all()), f"{where}: its times do not increase from t0", "predict")
    for cov in (prediction.start_cov[None], prediction.cov):
        # of correlations, so that units and sizes do not matter
        sd = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 1e-300))
        unit = cov / sd[:, :, None] / sd[:, None, :]
        even = bool(np.allclose(unit, unit.transpose(0, 2, 1), rtol=0.0, atol=1e-9))
        _require(even, f"{where}: a covariance is not symmetric", "predict")
        least = float(np.linalg.eigvalsh(unit).min())
        negative = f"{where}: a covariance has the eigenvalue {least:.3g} (of 1)"
        _require(least > -PSD, negative, "predict")
    tolerance = 1e-9 * (1.0 + np.abs(prediction.mean))
    ordered = prediction.low <= prediction.mean + tolerance
    ordered &= prediction.mean <= prediction.high + tolerance
    _require(bool(ordered.all()), f"{where}: low <= mean <= high does not hold", "predict")


def _check_class(trial: _Trial) -> str:
    """A subclass of Predictor, made of particulars and a seed."""
    abstract = sorted(getattr(trial.kind, "__abstractmethods__", ()))
    _require(not abstract, f"does not define {', '.join(abstract)}")
    given = {"seed": SEED, **trial.options}
    try:
        inspect.signature(trial.kind).bind(trial.particulars, **given)
    except TypeError as error:
        raise BrokenError(
            f"cannot be called with particulars, {', '.join(given)}: {error}"
        ) from None
    predictor = make_predictor(trial.name, trial.particulars, **given)
    _require(
        predictor.particulars == trial.particulars,
        "does not keep its particulars; call super().__init__(particulars, seed=seed)",
        "__init__",
    )
    return f"{trial.kind.__module__}:{trial.kind.__qualname__}; tuning: {trial.kind.tuning}"


def _check_without_data(trial: _Trial) -> str:
    """Valid before any row, after one, and without any measurement."""
    _require_valid(trial.new().predict("hold"), 40, "before the first row")
    _require_valid(trial.after(rows=1).predict("hold"), 40, "after one row")
    silent = trial.new()
    for k in range(60):
        silent.step(0.05 * k, np.full(trial.log.z.shape[1], math.nan), np.zeros(4))
    _require_valid(silent.predict("hold"), 40, "without any measurement")
    _require(not silent.estimate().ready, "is ready without any measurement")
    return "no row, one row, 60 rows of nothing"


def _check_shapes(trial: _Trial) -> str:
    """Shapes, times, covariances and intervals of predictions."""
    twin = trial.after()
    estimate = twin.estimate()
    _require(estimate.t == trial.log.t[ROWS - 1], f"the estimate has t = {estimate.t}")
    _require(bool(estimate.ready), f"is not ready after {ROWS} rows")
    shapes = np.shape(estimate.state), np.shape(estimate.sd)
    _require(shapes == ((6,), (6,)), "state and sd must have shape (6,)")
    _require(
        np.shape(estimate.params) == np.shape(estimate.params_sd),
        "params and params_sd differ in shape",
    )
    names = twin.predictor.parameter_names or trial.kind.parameter_names
    units = twin.predictor.parameter_units or trial.kind.parameter_units
    _require(
        len(names) == len(units) == len(estimate.params),
        f"{len(estimate.params)} parameters, but {len(names)} names and {len(units)} units",
    )
    for rows, dt in ((1, 0.05), (100, 0.1), (40, 0.25), (60, 1.0)):
        plan = np.repeat(trial.plan[:1], rows, axis=0)
        prediction = twin.predict(plan, dt=dt)
        _require_valid(prediction, rows, f"plan of {rows} rows of {dt:g} s")
        ends = prediction.t0 + dt * np.arange(1, rows + 1)
        _require(
            np.allclose(prediction.t, ends, atol=1e-6), "its times are not the ends of the rows"
        )
        _require(abs(prediction.t0 - estimate.t) < 1e-6, "t0 is not the time of the last row")
    mean = twin.predictor.mean(trial.plan.copy(), PLAN_DT)
    full = twin.predict(trial.plan.copy(), dt=PLAN_DT).mean
    _require(np.allclose(mean, full, rtol=0.0, atol=1e-9), "mean() is not predict().mean")
    return "plans of .05 to 60 s"


def _check_causality(trial: _Trial) -> str:
    """Neither later rows nor the truth change an answer."""
    rng, rest = np.random.default_rng(1), len(trial.log) - ROWS
    z, cmd = trial.log.z.copy(), trial.log.cmd.copy()
    z[ROWS:] = rng.normal(size=(rest, z.shape[1])) * 1e3
    cmd[ROWS:] = rng.normal(size=(rest, 4)) * 30.0
    poisoned = dataclasses.replace(
        trial.log, z=z, cmd=cmd, truth=np.full((len(trial.log), 6), 1e6), name="poisoned"
    )
    trial.compare(trial.after(poisoned), "where later rows are nonsense")
    whole = trial.after(rows=len(trial.log))
    whole.predict("hold")
    trial.compare(trial.after(), "of one made after another of its class has seen the whole run")
    return f"{rest} later rows and the truth replaced by nonsense: the same bits"


def _check_origins(trial: _Trial) -> str:
    """Forecasts from rows of a history, as for its own past errors, use no later ones."""
    predictor = trial.after().predictor
    if not isinstance(predictor, HistoryPredictor):
        return "keeps no history of forecasts"
    calls: list[tuple[Array, Array, Array]] = []

    def forecast(rows: Array, origins: Array, plans: Array) -> Array:
        # of a copy: what an earlier call has fitted would hide what this one uses
        one = copy.deepcopy(predictor)
        one._rows = list(rows.copy())
        return np.array(one.forecast(rows.copy(), origins.copy(), plans.copy()))

    def noted(rows: Array, origins: Array, plans: Array) -> Array:
        calls.append((rows.copy(), origins.copy(), plans.copy()))
        return forecast(rows, origins, plans)

    other = copy.deepcopy(predictor)
    other.forecast = noted  # type: ignore[method-assign]
    other.predict(trial.plan.copy(), PLAN_DT)
    if calls:  # a long history too: what is used may hang on its length
        rows, origins, plans = max(calls, key=lambda call: len(call[1]))
        more = np.tile(rows, (LONGER, 1))
        calls.append((more, origins + len(more) - len(rows), plans))
    rng, count = np.random.default_rng(1), 0
    for rows, origins, plans in calls:
        clean = forecast(rows, origins, plans)
        for k, origin in enumerate(origins):
            if origin + 1 == len(rows):
                continue
            changed, later = rows.copy(), len(rows) - origin - 1
            # rows of the same run in a wrong order, so that they are plausible
            changed[origin + 1 :] = rows[rng.integers(0, len(rows), later)]
            changed[origin + 1 :] += 0.1 * rng.normal(size=(later, rows.shape[1]))
            commands = plans.copy()
            commands[k + 1 :] = commands[k + 1 :, ::-1]
            found = forecast(changed, origins, commands)[k]
            if not np.allclose(found, clean[k], rtol=1e-9, atol=1e-9):
                lines = lines_reading_later_rows(
                    copy.deepcopy(predictor).forecast, rows, int(origin), plans[k], trial.files
                )
                error = BrokenError(
                    f"forecast() from row {origin} changes by up to "
                    f"{np.abs(found - clean[k]).max():.3g} with the rows after it, of {len(rows)}; "
                    "use rows[: origin + 1] alone for each origin"
                )
                error.place, error.methods = "; ".join(lines), ("forecast",)
                raise error
            count += 1
    return f"{count} origins, with other rows after each: the same forecasts"


def _check_determinism(trial: _Trial) -> str:
    """The same seed gives the same bits, whatever another predictor of the class does."""
    busy = trial.after(rows=ROWS // 2)
    twin = trial.after()
    trial.step(busy, trial.log, ROWS // 2, ROWS // 2 + 50)
    busy.predict("hold")
    trial.compare(twin, "of a second one with the same seed, while a third does other things")
    return "two of the same seed, while a third does other things: the same bits"


def _check_no_side_effects(trial: _Trial) -> str:
    """Predictions and estimates change nothing."""
    twin = trial.new()
    for k in range(0, ROWS, 20):
        trial.step(twin, trial.log, k, k + 20)
        twin.estimate()
        twin.predict(-trial.plan[: 1 + k % 90], dt=PLAN_DT)
        twin.predictor.mean(trial.plan[:5].copy(), 0.3)
        twin.predictor.identifiability()
    trial.compare(twin, "after earlier predictions")
    trial.compare(twin, "of a second prediction")
    return "predictions at every 20th row: the same bits"


def _check_arrays(trial: _Trial) -> str:
    """Arguments are neither written to nor kept."""
    log, twin = trial.log, trial.new()
    z, cmd = np.empty(log.z.shape[1]), np.empty(4)
    for k in range(ROWS):
        z[:], cmd[:] = log.z[k], log.cmd[k]
        twin.predictor.update(float(log.t[k]), float(log.t[k] - log.t[k - 1]) if k else 0.0, z, cmd)
        kept = np.array_equal(z, log.z[k], equal_nan=True) and np.array_equal(cmd, log.cmd[k])
        _require(kept, "update() writes to the row it is given", "update")
        z[:], cmd[:] = 1e6, 1e6
    twin.t, twin.cmd = float(log.t[ROWS - 1]), log.cmd[ROWS - 1].copy()
    plan = trial.plan.copy()
    twin.predictor.predict(plan, PLAN_DT)
    _require(
        np.array_equal(plan, trial.plan), "predict() writes to the plan it is given", *FORECASTING
    )
    trial.compare(twin, "after the arrays of a row are overwritten")
    return "rows and plan as before; rows overwritten afterwards: the same bits"


def _check_reset(trial: _Trial) -> str:
    """reset() gives the same as a new predictor."""
    twin = trial.new()
    trial.step(twin, trial.log, 150, 150 + ROWS)
    twin.predict("hold")
    twin.reset()
    trial.step(twin, trial.log, 0, ROWS)
    trial.compare(twin, "after reset()", "reset")
    return "other rows, then reset: the same bits as a new one"


def _check_losses(trial: _Trial) -> str:
    """Finite through lost sensors, gaps, a jump of time, and wild numbers."""
    log, twin, rng = trial.log, trial.after(), np.random.default_rng(1)
    t, size = twin.t, log.z.shape[1]
    lost = {"gps": slice(0, 4), "compass": slice(4, 5), "imu": slice(5, 8), "all": slice(0, size)}
    for what, columns in lost.items():
        for k in range(100):
            z = log.z[k].copy()
            z[columns] = math.nan
            t += 0.05
            twin.step(t, z, log.cmd[k].copy())
        _require_valid(twin.predict("hold"), 40, f"without {what} for 5 s")
    for what, step in (("a gap of 30 s", 30.0), ("a jump of time of a day", 86400.0)):
        t += step
        twin.step(t, log.z[0].copy(), log.cmd[0].copy())
        _require_valid(twin.predict("hold"), 40, f"after {what}")
    for _ in range(60):
        t += 0.5
        z = np.where(rng.random(size) < 0.5, math.nan, rng.normal(size=size) * 1e4)
        twin.step(t, z, rng.normal(size=4) * [30.0, 30.0, 1.0, 1.0])
    _require_valid(twin.predict("hold"), 40, "after wild numbers")
    _require(bool(np.isfinite(twin.estimate().sd).all()), "the sd of the estimate is not finite")
    return "GPS, compass, IMU, all lost; gaps of 30 s and a day; numbers of 10 000"


def _check_saving(trial: _Trial) -> str:
    """A loaded file gives the same as no stop."""
    twin = trial.after(rows=ROWS - 50)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "check.twin"
        try:
            twin.save(path)
            again = Twin.load(path, predictor=trial.new().predictor)
        except StateError as error:
            raise NotSupportedError(str(error).replace(folder, "")) from None
    trial.step(again, trial.log, ROWS - 50, ROWS)
    trial.compare(again, "after it was saved and loaded")
    return "saved 50 rows earlier: the same bits"


def _check_copies(trial: _Trial) -> str:
    """Copies, deep or pickled, give the same as the original."""
    twin = trial.after(rows=ROWS - 50)
    ways: dict[str, Callable[[Any], Any]] = {
        "copy.deepcopy": copy.deepcopy,
        "pickle": lambda item: pickle.loads(pickle.dumps(item)),
    }
    done = []
    for name, way in ways.items():
        try:
            other = Twin(trial.particulars, way(twin.predictor))
        except Exception as error:  # of a user's predictor
            text = f"{name}: {type(error).__name__}: {error}"
            raise (BrokenError if name == "copy.deepcopy" else NotSupportedError)(text) from None
        other.t, other.cmd = twin.t, twin.cmd.copy()
        trial.step(other, trial.log, ROWS - 50, ROWS)
        trial.compare(other, f"of a copy by {name}")
        done.append(name)
    return f"{' and '.join(done)}: the same bits"


def _check_time(trial: _Trial) -> str:
    """Faster than 20 rows and one prediction a second."""
    twin = trial.after(rows=ROWS)
    begin = time.perf_counter()
    trial.step(twin, trial.log, ROWS, ROWS + 200)
    row = (time.perf_counter() - begin) / 200
    begin = time.perf_counter()
    for _ in range(5):
        twin.predict(trial.plan.copy(), dt=PLAN_DT)
    prediction = (time.perf_counter() - begin) / 5
    text = f"{1e3 * row:.2f} ms a row, {1e3 * prediction:.1f} ms a prediction of 10 s"
    _require(20.0 * row + prediction < 1.0, f"{text}: slower than real time")
    return text


def _check_files(trial: _Trial) -> str:
    """Every file that the predictor's own code reads is declared."""
    declared = declared_files(trial.kind)
    known = {path.resolve() for path in declared.values()}
    for read in trial.opened:
        place = read.place(trial.files) if read.path not in known else ""
        if place:
            error = BrokenError(
                f"reads {read.path.name}; name it in the class attribute files, or results are "
                "reused after it has changed"
            )
            error.place = place
            raise error
    return f"declared: {', '.join(declared) or 'none'}; read: no others"


CHECKS: dict[str, Callable[[_Trial], str]] = {
    "class and constructor": _check_class,
    "before and without data": _check_without_data,
    "shapes, times, covariances, intervals": _check_shapes,
    "no future, no truth": _check_causality,
    "no rows after an origin": _check_origins,
    "same seed, same answer": _check_determinism,
    "no side effects": _check_no_side_effects,
    "arguments untouched": _check_arrays,
    "reset": _check_reset,
    "losses, gaps, wild numbers": _check_losses,
    "save and load": _check_saving,
    "copies": _check_copies,
    "time": _check_time,
    "files": _check_files,
}
"""The checks by name, in this order."""


def check(name: str, checks: Sequence[str] = tuple(CHECKS)) -> list[Finding]:
    """Return the finding of each check of the contract.

    ``name`` is in ``twin.PREDICTORS``, or ``module:Class``. Of the checks, from :data:`CHECKS`, the
    rest is skipped where the predictor cannot be made.

    Examples
    --------
    >>> from twin.benchmark.conformance import check
    >>> all(item.passed for item in check("persistence", ["reset", "arguments untouched"]))
    True
    """
    with watched_files(__file__) as opened:
        try:
            trial = _Trial(name, opened)
        except (PredictorError, ImportError) as error:
            place = place_of_import(error)
            return [Finding("class and constructor", False, str(error), place)]
        found: list[Finding] = []
        causes: dict[str, str] = {}
        for item in checks:
            found.append(_found(item, trial, causes))
            if CHECKS[item] is _check_class and not found[-1].passed:
                break
    return found


def _found(item: str, trial: _Trial, causes: dict[str, str]) -> Finding:
    """Run one check; ``causes`` are those of earlier ones, each of which is explained once."""
    try:
        return Finding(item, True, CHECKS[item](trial))
    except NotSupportedError as error:
        return Finding(item, None, f"not supported: {error}")
    except Exception as error:  # of a user's predictor
        text, place = str(error), place_of_error(error, trial.files)
        methods: tuple[str, ...] = ()
        if isinstance(error, BrokenError):
            methods, place = error.methods, error.place or place
        elif isinstance(error, ForecastError):
            methods = FORECASTING
        else:
            text = f"raises {type(error).__name__}: {error}"
        place = place or place_of_method(trial.kind, *methods)
        # one line of the user's may fail many checks, with other numbers in each message
        cause = f"{type(error).__name__} {place}" if place else text
        if cause in causes:
            return Finding(item, False, f"the same as in {causes[cause]!r}")
        causes[cause] = item
        return Finding(item, False, text, place)
