"""The contract of predictors as a list of checks, also for those of somebody else.

``usv-twin benchmark --check module:Class`` prints it; the tests of this package ask it of every
entry of ``twin.PREDICTORS``. Nothing is said of how good the predictions are: that is what the
benchmark is for.
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

from twin.checkpoint import StateError
from twin.digital_twin import Twin, known_plan
from twin.logs.log import Log
from twin.predictors.base import Prediction
from twin.predictors.registry import PredictorError, make_predictor, predictor_class
from twin.sim.bridge import particulars_of, simulate
from twin.sim.oracle import simulator_options
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.sea import SeaState

__all__ = [
    "CHECKS",
    "Finding",
    "check",
]

Array = NDArray[np.float64]

ROWS = 500
"""Rows before the question that the checks compare: 25 s at 20 Hz."""

TRAINED_AT = 20.0

SEED = 3

PLAN_DT = 0.1

PSD = 1e-7
"""Least eigenvalue of a correlation matrix, below 0: rounding times the condition number."""


class BrokenError(Exception):
    """What a predictor did that the contract forbids."""


class NotSupportedError(Exception):
    """What a predictor need not do, and does not."""


@dataclass(frozen=True)
class Finding:
    """The outcome of one check.

    Parameters
    ----------
    name, text : str
        What was checked, and what happened.
    passed : bool or None
        None: not supported, which the contract allows.
    """

    name: str
    passed: bool | None
    text: str


class _Trial:
    """A predictor by name, a run to feed it, and what it says at row :data:`ROWS`."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.kind = predictor_class(name)
        vessel, sea = Vessel.load("usv75"), SeaState(hs=0.5, wind=4.5)
        self.log = simulate("zigzag", vessel=vessel, sea=sea, duration=40.0, seed=7)
        self.particulars = particulars_of(vessel)
        self.options: dict[str, Any] = simulator_options(name, vessel, sea, 3)
        if self.kind.trains:
            self.options["train_at"] = TRAINED_AT
        self.plan = known_plan(self.log, ROWS - 1, 10.0, PLAN_DT)
        self._said: list[Any] | None = None

    def new(self) -> Twin:
        return Twin(self.particulars, self.name, seed=SEED, **self.options)

    def fed(self, log: Log | None = None, rows: int = ROWS) -> Twin:
        """Return a new twin after the first rows, which are views of the whole log."""
        twin = self.new()
        self.feed(twin, log or self.log, 0, rows)
        return twin

    @staticmethod
    def feed(twin: Twin, log: Log, first: int, last: int) -> None:
        z, cmd = log.z.copy(), log.cmd.copy()  # what is written to them is lost
        for k in range(first, last):
            twin.step(float(log.t[k]), z[k], cmd[k])

    def answers(self, twin: Twin) -> list[Any]:
        """Return all that a twin says now: estimate, and predictions under two plans."""
        estimate = twin.estimate()
        said = [getattr(estimate, item.name) for item in dataclasses.fields(estimate)]
        held, known, again = (
            twin.predict("hold", dt=0.25),
            twin.predict(self.plan.copy(), dt=PLAN_DT),
            twin.predict("hold", dt=0.25),
        )
        if not np.array_equal(held.mean, again.mean):
            raise BrokenError("a plan that was asked about changes the next answer to another plan")
        for prediction in (known, held):
            said += [getattr(prediction, item.name) for item in dataclasses.fields(prediction)]
        return [np.array(part, dtype=np.float64) for part in said]

    @property
    def said(self) -> list[Any]:
        """The answers at row :data:`ROWS` of a twin that nothing was done to."""
        if self._said is None:
            self._said = self.answers(self.fed())
        return self._said

    def same(self, twin: Twin, after: str) -> None:
        """Refuse other answers than those of a twin that nothing was done to."""
        for mine, other in zip(self.said, self.answers(twin), strict=True):
            if not np.array_equal(mine, other, equal_nan=True):
                away = np.abs(mine - other).max() if mine.shape == other.shape else math.nan
                raise BrokenError(f"other answers {after}: apart by up to {away:.3g}")


def _need(good: bool, text: str) -> None:
    if not good:
        raise BrokenError(text)


def _sound(prediction: Prediction, rows: int, where: str) -> None:
    """Refuse wrong shapes, times that do not increase, what is not finite, and no covariance."""
    shapes = {"start": (6,), "start_cov": (6, 6), "t": (rows,), "mean": (rows, 6)}
    shapes |= {"cov": (rows, 6, 6), "low": (rows, 6), "high": (rows, 6)}
    for name, shape in shapes.items():
        value = np.asarray(getattr(prediction, name))
        _need(value.shape == shape, f"{where}: {name} has shape {value.shape}, not {shape}")
        _need(bool(np.isfinite(value).all()), f"{where}: {name} is not finite")
    after = np.diff(np.concatenate([[prediction.t0], prediction.t]))
    _need(bool((after > 0.0).all()), f"{where}: its times do not increase from t0")
    for cov in (prediction.start_cov[None], prediction.cov):
        # of correlations, so that units and the size of a long prediction do not matter
        sd = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 1e-300))
        unit = cov / sd[:, :, None] / sd[:, None, :]
        even = bool(np.allclose(unit, unit.transpose(0, 2, 1), rtol=0.0, atol=1e-9))
        _need(even, f"{where}: a covariance is not symmetric")
        least = float(np.linalg.eigvalsh(unit).min())
        _need(least > -PSD, f"{where}: a covariance has the eigenvalue {least:.3g} (of 1)")
    room = 1e-9 * (1.0 + np.abs(prediction.mean))
    low, high = prediction.low <= prediction.mean + room, prediction.mean <= prediction.high + room
    _need(bool((low & high).all()), f"{where}: low <= mean <= high does not hold")


def _made(trial: _Trial) -> str:
    """Subclass of Predictor, made of particulars and a seed."""
    abstract = sorted(getattr(trial.kind, "__abstractmethods__", ()))
    _need(not abstract, f"does not define {', '.join(abstract)}")
    given = {"seed": SEED, **trial.options}
    try:
        inspect.signature(trial.kind).bind(trial.particulars, **given)
    except TypeError as error:
        raise BrokenError(
            f"cannot be called with particulars, {', '.join(given)}: {error}"
        ) from None
    predictor = make_predictor(trial.name, trial.particulars, **given)
    _need(
        predictor.particulars == trial.particulars,
        "does not keep its particulars; call super().__init__(particulars, seed=seed)",
    )
    return f"{trial.kind.__module__}:{trial.kind.__qualname__}; tuning: {trial.kind.tuning}"


def _early(trial: _Trial) -> str:
    """Sound before any row, after one, and where no sensor ever speaks."""
    _sound(trial.new().predict("hold"), 40, "before the first row")
    _sound(trial.fed(rows=1).predict("hold"), 40, "after one row")
    silent = trial.new()
    for k in range(60):
        silent.step(0.05 * k, np.full(trial.log.z.shape[1], math.nan), np.zeros(4))
    _sound(silent.predict("hold"), 40, "without any measurement")
    _need(not silent.estimate().ready, "says ready without any measurement")
    return "no row, one row, 60 rows of nothing"


def _shaped(trial: _Trial) -> str:
    """Shapes, times, covariances and bands of an answer."""
    twin = trial.fed()
    estimate = twin.estimate()
    _need(estimate.t == trial.log.t[ROWS - 1], f"estimate says t = {estimate.t}")
    _need(bool(estimate.ready), f"is not ready after {ROWS} rows")
    _need(
        np.shape(estimate.state) == np.shape(estimate.sd) == (6,), "s and sd must have shape (6,)"
    )
    _need(
        np.shape(estimate.params) == np.shape(estimate.params_sd),
        "params and params_sd differ in shape",
    )
    names, units = trial.kind.parameter_names, trial.kind.parameter_units
    names, units = (
        twin.predictor.parameter_names or names,
        twin.predictor.parameter_units or units,
    )
    _need(
        len(names) == len(units) == len(estimate.params),
        f"{len(estimate.params)} parameters, but {len(names)} names and {len(units)} units",
    )
    for rows, dt in ((1, 0.05), (100, 0.1), (40, 0.25), (60, 1.0)):
        plan = np.repeat(trial.plan[:1], rows, axis=0)
        prediction = twin.predict(plan, dt=dt)
        _sound(prediction, rows, f"plan of {rows} rows of {dt:g} s")
        ends = prediction.t0 + dt * np.arange(1, rows + 1)
        _need(np.allclose(prediction.t, ends, atol=1e-6), "its times are not the ends of the rows")
        _need(abs(prediction.t0 - estimate.t) < 1e-6, "t0 is not the time of the last row")
    mean = twin.predictor.mean(trial.plan.copy(), PLAN_DT)
    full = twin.predict(trial.plan.copy(), dt=PLAN_DT).mean
    _need(np.allclose(mean, full, rtol=0.0, atol=1e-9), "mean() is not predict().mean")
    return "plans of .05 to 60 s"


def _causal(trial: _Trial) -> str:
    """Nothing after a row, and no truth, changes an answer at it."""
    rng, rest = np.random.default_rng(1), len(trial.log) - ROWS
    z, cmd = trial.log.z.copy(), trial.log.cmd.copy()
    z[ROWS:] = rng.normal(size=(rest, z.shape[1])) * 1e3
    cmd[ROWS:] = rng.normal(size=(rest, 4)) * 30.0
    poisoned = dataclasses.replace(
        trial.log, z=z, cmd=cmd, truth=np.full((len(trial.log), 6), 1e6), name="poisoned"
    )
    trial.same(trial.fed(poisoned), "where later rows are nonsense")
    return f"{rest} later rows and the truth replaced by nonsense: the same bits"


def _determined(trial: _Trial) -> str:
    """The same seed gives the same bits, whatever another predictor of the class did."""
    busy = trial.fed(rows=ROWS // 2)
    twin = trial.fed()
    trial.feed(busy, trial.log, ROWS // 2, ROWS // 2 + 50)
    busy.predict("hold")
    trial.same(twin, "of a second one with the same seed, beside a third that did other things")
    return "two of the same seed, a third beside them: the same bits"


def _quiet(trial: _Trial) -> str:
    """Asking changes nothing."""
    twin = trial.new()
    for k in range(0, ROWS, 20):
        trial.feed(twin, trial.log, k, k + 20)
        twin.estimate()
        twin.predict(-trial.plan[: 1 + k % 90], dt=PLAN_DT)
        twin.predictor.mean(trial.plan[:5].copy(), 0.3)
        twin.predictor.identifiability()
    trial.same(twin, "where it was asked before")
    trial.same(twin, "when it is asked again")
    return "asked at every 20th row: the same bits"


def _own(trial: _Trial) -> str:
    """Arrays handed in are neither written to nor kept."""
    log, twin = trial.log, trial.new()
    z, cmd = np.empty(log.z.shape[1]), np.empty(4)
    for k in range(ROWS):
        z[:], cmd[:] = log.z[k], log.cmd[k]
        twin.predictor.update(float(log.t[k]), float(log.t[k] - log.t[k - 1]) if k else 0.0, z, cmd)
        kept = np.array_equal(z, log.z[k], equal_nan=True) and np.array_equal(cmd, log.cmd[k])
        _need(kept, "update() writes to the row it is given")
        z[:], cmd[:] = 1e6, 1e6
    twin.t, twin.cmd = float(log.t[ROWS - 1]), log.cmd[ROWS - 1].copy()
    plan = trial.plan.copy()
    twin.predictor.predict(plan, PLAN_DT)
    _need(np.array_equal(plan, trial.plan), "predict() writes to the plan it is given")
    trial.same(twin, "where the arrays of a row are used again after it")
    return "rows and plan as before; rows overwritten afterwards: the same bits"


def _forgets(trial: _Trial) -> str:
    """reset() gives the same as a new one."""
    twin = trial.new()
    trial.feed(twin, trial.log, 150, 150 + ROWS)
    twin.predict("hold")
    twin.reset()
    trial.feed(twin, trial.log, 0, ROWS)
    trial.same(twin, "after reset()")
    return "fed another stretch, reset: the same bits as a new one"


def _survives(trial: _Trial) -> str:
    """Finite through lost sensors, gaps, a jump of time, and wild numbers."""
    log, twin, rng = trial.log, trial.fed(), np.random.default_rng(1)
    t, size = twin.t, log.z.shape[1]
    lost = {"gps": slice(0, 4), "compass": slice(4, 5), "imu": slice(5, 8), "all": slice(0, size)}
    for what, columns in lost.items():
        for k in range(100):
            z = log.z[k].copy()
            z[columns] = math.nan
            t += 0.05
            twin.step(t, z, log.cmd[k].copy())
        _sound(twin.predict("hold"), 40, f"without {what} for 5 s")
    for what, step in (("a gap of 30 s", 30.0), ("a jump of time of a day", 86400.0)):
        t += step
        twin.step(t, log.z[0].copy(), log.cmd[0].copy())
        _sound(twin.predict("hold"), 40, f"after {what}")
    for _ in range(60):
        t += 0.5
        z = np.where(rng.random(size) < 0.5, math.nan, rng.normal(size=size) * 1e4)
        twin.step(t, z, rng.normal(size=4) * [30.0, 30.0, 1.0, 1.0])
    _sound(twin.predict("hold"), 40, "after wild numbers")
    _need(bool(np.isfinite(twin.estimate().sd).all()), "the sd of the estimate is not finite")
    return "GPS, compass, IMU, all lost; gaps of 30 s and a day; numbers of 10 000"


def _saved(trial: _Trial) -> str:
    """Goes on from its file as if it had never stopped."""
    twin = trial.fed(rows=ROWS - 50)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "check.twin"
        try:
            twin.save(path)
            again = Twin.load(path, predictor=trial.new().predictor)
        except StateError as error:
            raise NotSupportedError(str(error).replace(folder, "")) from None
    trial.feed(again, trial.log, ROWS - 50, ROWS)
    trial.same(again, "after it was saved and loaded")
    return "50 rows before the question: the same bits"


def _copied(trial: _Trial) -> str:
    """Copies, deep or pickled, answer as the original does."""
    twin = trial.fed(rows=ROWS - 50)
    ways: dict[str, Callable[[Any], Any]] = {
        "copy.deepcopy": copy.deepcopy,
        "pickle": lambda item: pickle.loads(pickle.dumps(item)),
    }
    done = []
    for name, way in ways.items():
        try:
            other = Twin(trial.particulars, way(twin.predictor))
        except Exception as error:  # whatever the object of somebody else does
            text = f"{name}: {type(error).__name__}: {error}"
            raise (BrokenError if name == "copy.deepcopy" else NotSupportedError)(text) from None
        other.t, other.cmd = twin.t, twin.cmd.copy()
        trial.feed(other, trial.log, ROWS - 50, ROWS)
        trial.same(other, f"of a copy by {name}")
        done.append(name)
    return f"{' and '.join(done)}: the same bits"


def _quick(trial: _Trial) -> str:
    """Keeps up with 20 rows and one prediction a second."""
    twin = trial.fed(rows=ROWS)
    begin = time.perf_counter()
    trial.feed(twin, trial.log, ROWS, ROWS + 200)
    row = (time.perf_counter() - begin) / 200
    begin = time.perf_counter()
    for _ in range(5):
        twin.predict(trial.plan.copy(), dt=PLAN_DT)
    asked = (time.perf_counter() - begin) / 5
    text = f"{1e3 * row:.2f} ms a row, {1e3 * asked:.1f} ms a prediction of 10 s"
    _need(20.0 * row + asked < 1.0, f"{text}: slower than real time")
    return text


CHECKS: dict[str, Callable[[_Trial], str]] = {
    "class and constructor": _made,
    "before and without data": _early,
    "shapes, times, covariances, bands": _shaped,
    "no future, no truth": _causal,
    "same seed, same answer": _determined,
    "asking changes nothing": _quiet,
    "arrays handed in": _own,
    "reset": _forgets,
    "losses, gaps, wild numbers": _survives,
    "save and load": _saved,
    "copies": _copied,
    "time": _quick,
}
"""What is checked, by name, in this order."""


def check(name: str, checks: Sequence[str] = tuple(CHECKS)) -> list[Finding]:
    """Return what a predictor does with each check of the contract.

    Parameters
    ----------
    name : str
        In ``twin.PREDICTORS``, or ``module:Class``.
    checks : sequence of str
        Of :data:`CHECKS`; a predictor that cannot be made is asked nothing else.

    Returns
    -------
    list of Finding

    Examples
    --------
    >>> from twin.benchmark.conformance import check
    >>> all(item.passed for item in check("persistence", ["reset", "arrays handed in"]))
    True
    """
    try:
        trial = _Trial(name)
    except (PredictorError, ImportError) as error:
        return [Finding("class and constructor", False, str(error))]
    found: list[Finding] = []
    for item in checks:
        found.append(_found(item, trial))
        if CHECKS[item] is _made and not found[-1].passed:
            break
    return found


def _found(item: str, trial: _Trial) -> Finding:
    try:
        return Finding(item, True, CHECKS[item](trial))
    except BrokenError as error:
        return Finding(item, False, str(error))
    except NotSupportedError as error:
        return Finding(item, None, f"not supported: {error}")
    except Exception as error:  # whatever the code of somebody else does
        return Finding(item, False, f"raises {type(error).__name__}: {error}")
