"""The benchmark: scenarios times predictors times seeds, scored against the truth.

Each piece of work is one run of one predictor. Its result is a file of its own, so that an
interrupted benchmark goes on where it stopped, and the number of workers changes nothing.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
import os
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.log import Log, beside, files_of, recorded_runs
from twin.oracle import check_world, world_options
from twin.particulars import Particulars
from twin.predictor import Z90, Prediction
from twin.registry import EXTRAS, PREDICTORS, PredictorError, predictor_class
from twin.report import PredictorFigure, RunFigure
from twin.simulated import particulars_of, simulate
from twin.structure import MODELS, StructureError
from twin.twin import PLANS, Twin, known_plan
from usv_gym.manoeuvres import MANOEUVRES, ManoeuvreError
from usv_gym.sea import SeaState
from usv_gym.sensors import (
    FAULT_KINDS,
    GPS_BIT,
    Disturbance,
    Fault,
    parse_faults,
    spoiled,
)
from usv_gym.vessel import Vessel
from usv_kernel import __version__, sources_digest

__all__ = [
    "AGAINST",
    "CHANNELS",
    "HORIZONS",
    "METRICS",
    "STUDY_CHANNELS",
    "STUDY_HORIZONS",
    "BenchmarkError",
    "Settings",
    "Unit",
    "collect",
    "compare",
    "left_out",
    "particulars_beside",
    "run_unit",
    "runs",
    "summarise",
    "units",
    "with_faults",
]

Array = NDArray[np.float64]

CHANNELS = ("u", "v", "r", "along", "across", "psi")
HORIZONS = (1.0, 2.0, 5.0, 10.0)
STUDY_CHANNELS = ("u", "v", "r", "psi", "displacement")
"""What ``J`` is the mean of; displacement is the distance between where the boat is and where
it was predicted, both counted from where the prediction started."""
STUDY_HORIZONS = tuple(0.5 * k for k in range(1, 21))
COVERED = (*CHANNELS, "displacement")
"""Channels of coverage: of the displacement, the share inside the 90 % ellipse."""
METRICS = (
    *("mae", "mae_median", "mse", "normalised", "skill", "J", "E"),
    *("start_error", "coverage90"),
)
BASELINE = "persistence"
FLOOR = "oracle"
AGAINST = "ukf"
"""The reference of the paired comparison, where none is named."""
SPREAD = 0.15
"""How different the boats are, as a share (twin.md section 1)."""
_BOATS = 1029
"""Keeps the draws of a seed's boat apart from those of its sea."""
_OUTSIDE_ELLIPSE = -2.0 * math.log(0.1)
_AT = [STUDY_HORIZONS.index(h) for h in HORIZONS]


class BenchmarkError(ValueError):
    """A benchmark that cannot be run; the message says why."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What is to be measured.

    Parameters
    ----------
    scenarios, faults, predictors : tuple of str
        Manoeuvres, losses of sensors such as ``gps10``, and names in ``twin.PREDICTORS``.
    seeds : tuple of int
        Each is a boat, a sea, a set of sensor errors and (random manoeuvre) a helmsman.
    plans : tuple of str
        ``known``: the future commands are given (Eq 27); ``hold``: the last one is held.
    vessel : str
        Name or TOML file.
    spread : float
        Every seed sails another boat: ``Vessel.varied`` by this share; 0: the vessel as it is.
    dof : int
        Degrees of freedom of the simulated ship, 3 or 6.
    model : str or None
        Structure of all predictors that have one; None for each one's own choice.
    hs, wind, wind_from_deg : float
        Sea state: wave height (m), wind speed (m/s) and direction (degrees).
    logs : tuple of str
        Recorded runs to score.
    ship : str or None
        Particulars of the recorded boat; a TOML file of the log's name beside it if None.
    mapping : str or None
        Mapping file of the recorded runs, as for ``Log.read``.
    identify_s : float
        Time before the first prediction, s; recorded runs: 60 s or 40 % of a short one.
    duration_s : float
        Length of a simulated run, s.
    fault_after_s : float
        A loss begins this long after the first prediction, s.
    """

    scenarios: tuple[str, ...] = ("turn", "zigzag")
    faults: tuple[str, ...] = ("none", "gps10")
    seeds: tuple[int, ...] = tuple(range(6))
    predictors: tuple[str, ...] = tuple(PREDICTORS)
    plans: tuple[str, ...] = ("known", "hold")
    vessel: str = "usv75"
    spread: float = SPREAD
    dof: int = 3
    model: str | None = None
    hs: float = 0.5
    wind: float = 4.5
    wind_from_deg: float = 135.0
    logs: tuple[str, ...] = ()
    ship: str | None = None
    mapping: str | None = None
    identify_s: float = 80.0
    duration_s: float = 120.0
    fault_after_s: float = 5.0

    def __post_init__(self) -> None:
        for name in self.scenarios:
            if name not in MANOEUVRES:
                raise ManoeuvreError(
                    f"no scenario is called {name!r}; known: {', '.join(MANOEUVRES)}"
                )
        for name in self.predictors:
            if name not in PREDICTORS:
                raise PredictorError(
                    f"no predictor is called {name!r}; known: {', '.join(PREDICTORS)}"
                )
        if self.model is not None and self.model not in MODELS:
            raise StructureError(
                f"no model structure is called {self.model!r}; known: {', '.join(MODELS)}"
            )
        for name in self.plans:
            if name not in PLANS:
                raise PredictorError(f"no plan is called {name!r}; known: {', '.join(PLANS)}")
        names = [beside(path, "").name for path in self.logs]
        for name in names:
            if names.count(name) > 1 or name in self.scenarios:
                raise BenchmarkError(f"two runs are called {name!r}; rename a log file")
        for text in self.faults:
            parse_faults(text, 0.0)
        if not (self.identify_s > 0 and self.duration_s > self.identify_s + HORIZONS[-1]):
            raise BenchmarkError(
                f"duration_s = {self.duration_s} must exceed identify_s = {self.identify_s} "
                f"by more than the horizon of {HORIZONS[-1]:g} s"
            )
        if self.dof not in (3, 6):
            raise BenchmarkError(f"dof = {self.dof}: must be 3 or 6")
        if not 0.0 <= self.spread <= 0.5:
            raise BenchmarkError(f"spread = {self.spread}: must lie between 0 and 0.5")
        self.sea()

    def sea(self) -> SeaState:
        """Return the sea state of the simulated runs."""
        return SeaState(hs=self.hs, wind=self.wind, wind_from=math.radians(self.wind_from_deg))

    def boat(self, seed: int) -> Vessel:
        """Return the boat that a seed sails."""
        vessel = Vessel.load(self.vessel)
        if self.spread == 0.0:
            return vessel
        return vessel.varied(np.random.default_rng([seed, _BOATS]), self.spread)


@dataclass(frozen=True, order=True)
class Unit:
    """One predictor on one run; ``log`` is the file of a recorded run, else empty."""

    scenario: str
    fault: str
    seed: int
    predictor: str
    log: str = ""

    @property
    def run(self) -> str:
        """Name of the run, for files."""
        return f"{self.scenario}_{self.fault}_{self.seed}"


def available(names: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the predictors that can run here, and a line on each that cannot.

    Parameters
    ----------
    names : sequence of str
        Names in ``twin.PREDICTORS``.
    """
    usable, notes = [], []
    for name in names:
        module, extra = EXTRAS.get(name, (None, ""))
        if module is None or find_spec(module) is not None:
            usable.append(name)
        else:
            notes.append(
                f"{name} is left out: {module} is not installed; "
                f"python -m pip install {module} (the extra [{extra}] of usv-twin)"
            )
    return tuple(usable), tuple(notes)


def units(settings: Settings) -> list[Unit]:
    """Return all work that the settings ask for, in a fixed order."""
    work = [
        Unit(scenario, fault, seed, predictor)
        for scenario in settings.scenarios
        for fault in settings.faults
        for seed in settings.seeds
        for predictor in settings.predictors
    ]
    for path in settings.logs:
        name = beside(path, "").name
        work += [
            Unit(name, fault, 0, predictor, path)
            for fault in settings.faults
            for predictor in settings.predictors
            if _knows(predictor, path, settings.ship, settings.mapping)
        ]
    return work


@functools.cache
def _knows(predictor: str, path: str, ship: str | None, mapping: str | None) -> bool:
    """Return whether a predictor knows all that it needs to run on a log."""
    if not predictor_class(predictor).world:
        return True
    try:
        check_world(predictor, Log.read(path, mapping), particulars_beside(path, ship)[0])
    except (ValueError, OSError):
        return False
    return True


def left_out(settings: Settings) -> tuple[str, ...]:
    """Return a line on each predictor and recorded run that do not go together."""
    return tuple(
        f"{predictor} is left out of {beside(path, '').name}: the true boat is not known"
        for path in settings.logs
        for predictor in settings.predictors
        if not _knows(predictor, path, settings.ship, settings.mapping)
    )


NO_PARTICULARS = "{}: no particulars beside it, taken to be the usv75; --ship FILE names a boat"
"""Said where :func:`particulars_beside` found none."""


def particulars_beside(path: str | Path, ship: str | None = None) -> tuple[Particulars, bool]:
    """Return the particulars for a log, and whether any were given for it.

    They are those of ``ship``, else those in ``<log>.toml`` beside the log, else the usv75's.

    Parameters
    ----------
    path : str or Path
        The log.
    ship : str, optional
        A TOML file of particulars, or the name or file of a vessel of ``usv_gym``.

    Raises
    ------
    ParticularsError, VesselError
        Names the file and the remedy.
    """
    if ship is None:
        file = beside(path, ".toml")
        if file.exists():
            return Particulars.load(file), True
        return particulars_of(Vessel.load("usv75")), False
    text = _text(ship) if Path(ship).suffix == ".toml" else ""
    if "[particulars]" in text and "[hull]" not in text:
        return Particulars.load(ship), True
    return particulars_of(Vessel.load(ship)), True


def _text(path: str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def fault_start(settings: Settings, identify: float) -> float:
    """Return when a loss begins, s: while the boat manoeuvres and predictions are made."""
    return identify + settings.fault_after_s


def with_faults(log: Log, faults: Sequence[Disturbance]) -> Log:
    """Return a log with what the faults do to its sensors; the same whenever it is asked."""
    return dataclasses.replace(log, z=spoiled(log.t, log.z, faults, np.random.default_rng(0)))


def _recorded_identify(log: Log) -> float:
    """Return the time before the first prediction of a recorded run, s."""
    return min(60.0, 0.4 * float(log.t[-1] - log.t[0]))


def load_run(settings: Settings, unit: Unit) -> tuple[Log, Log, Particulars, float]:
    """Return the log to be seen, the log to be scored against, the boat and the first origin."""
    if not unit.log:
        vessel = settings.boat(unit.seed)
        start = fault_start(settings, settings.identify_s)
        log = simulate(
            unit.scenario,
            vessel=vessel,
            sea=settings.sea(),
            duration=settings.duration_s,
            seed=unit.seed,
            faults=parse_faults(unit.fault, start),
            dof=settings.dof,
            name=unit.run,
        )
        particulars = particulars_of(vessel, dof=settings.dof)
        return log.without_truth(), log, particulars, settings.identify_s
    log = Log.read(unit.log, settings.mapping)
    identify = _recorded_identify(log)
    seen = with_faults(log, parse_faults(unit.fault, fault_start(settings, identify)))
    return (
        seen.without_truth(),
        log,
        particulars_beside(unit.log, settings.ship)[0],
        float(log.t[0]) + identify,
    )


class _Reference:
    """What is scored against: the truth of a log, or its recorded positions and headings."""

    def __init__(self, log: Log) -> None:
        if log.truth is not None:
            self.t, self.columns = [log.t] * 6, list(log.truth.T.copy())
            self.columns[2] = np.unwrap(self.columns[2])
            return
        self.t, self.columns = [], []
        for entry in (0, 1, 4):
            seen = np.isfinite(log.z[:, entry])
            values = log.z[seen, entry]
            self.t.append(log.t[seen])
            self.columns.append(np.unwrap(values) if entry == 4 else values)

    def at(self, times: Array) -> Array:
        """Return states (h, 6) or (h, 3) at times, linearly between samples."""
        return np.stack(
            [np.interp(times, t, c) for t, c in zip(self.t, self.columns, strict=True)], axis=1
        )


class Score(NamedTuple):
    """One prediction against the truth, at h horizons.

    ``error`` and ``change`` (h, c) are errors and true changes of the channels (the last c of
    :data:`CHANNELS`), ``away`` (h,) the error of the displacement, and ``inside`` (h, c + 1)
    says whether channels and displacement lie in the 90 % bands.
    """

    error: Array
    change: Array
    away: Array
    inside: NDArray[np.bool_]


def score(prediction: Prediction, truth: Array, horizons: Sequence[float]) -> Score:
    """Compare one prediction with the truth.

    Positions count from where the prediction started, so that the error of the start, which
    is the receiver's and common to all predictors, is not counted again at each horizon; it
    is reported on its own (``start_error``).

    Parameters
    ----------
    prediction : Prediction
        What was said.
    truth : ndarray, shape (1 + h, 6) or (1 + h, 3)
        True states, or positions and headings alone: at the start, then at the horizons.
    horizons : sequence of float
        Seconds after the start.
    """
    mean, cov = prediction.at(np.array(horizons))
    low, high = prediction.band(np.array(horizons))
    start, later = truth[0], truth[1:]
    psi = later[:, 2]
    c, s = np.cos(psi), np.sin(psi)
    moved = later[:, :2] - start[:2]
    ex, ey = (mean[:, :2] - prediction.start[:2] - moved).T
    spread = cov - prediction.start_cov
    xx, xy, yy = spread[:, 0, 0], spread[:, 0, 1], spread[:, 1, 1]
    error, change, inside = [], [], []
    if truth.shape[1] == 6:
        for i in (3, 4, 5):
            error.append(mean[:, i] - later[:, i])
            change.append(later[:, i] - start[i])
            inside.append((low[:, i] <= later[:, i]) & (later[:, i] <= high[:, i]))
    # along the true heading, then across it to starboard
    for a, b in ((c, s), (-s, c)):
        error.append(a * ex + b * ey)
        change.append(a * moved[:, 0] + b * moved[:, 1])
        sd = np.sqrt(np.maximum(a * a * xx + 2.0 * a * b * xy + b * b * yy, 0.0))
        inside.append(np.abs(error[-1]) <= Z90 * sd)
    turn = (mean[:, 2] - psi + math.pi) % (2.0 * math.pi) - math.pi
    error.append(turn)
    change.append(psi - start[2])
    inside.append((low[:, 2] - mean[:, 2] <= -turn) & (-turn <= high[:, 2] - mean[:, 2]))
    size = np.maximum(xx * yy - xy * xy, 0.0)
    inside.append(yy * ex * ex - 2.0 * xy * ex * ey + xx * ey * ey <= _OUTSIDE_ELLIPSE * size)
    return Score(
        np.stack(error, axis=1), np.stack(change, axis=1), np.hypot(ex, ey), np.stack(inside, 1)
    )


def run_unit(settings: Settings, unit: Unit, folder: Path, *, pictures: bool) -> dict[str, Any]:
    """Run one predictor on one run, score it, and keep the result in a file.

    Parameters
    ----------
    settings, unit
        What to do.
    folder : Path
        Folder of results; the file is replaced as a whole or not at all.
    pictures : bool
        Keep what the pictures need: parameter histories and a few predictions.

    Returns
    -------
    dict
        ``unit``, ``rows`` as in ``results.json``, and what :func:`summarise` needs.
    """
    seen, reference_log, particulars, identify = load_run(settings, unit)
    if not unit.log:
        _write_log(reference_log, particulars, folder / "logs" / f"{unit.run}.csv")
    reference = _Reference(reference_log)
    options: dict[str, Any] = {}
    if not unit.log:
        boat, sea = settings.boat(unit.seed), settings.sea()
        options = world_options(unit.predictor, boat, sea, settings.dof)
    if settings.model is not None and predictor_class(unit.predictor).models:
        options["model"] = settings.model
    if predictor_class(unit.predictor).trains:
        # in time for the first prediction: its history begins with the first late fix
        options["train_at"] = identify - float(seen.t[0]) - 0.5
    twin = Twin(particulars, unit.predictor, seed=unit.seed, **options)
    dt = min(max(seen.dt, 0.02), 0.25)
    end = float(seen.t[-1]) - HORIZONS[-1]
    next_origin, next_second = identify, float(seen.t[0])
    scores: dict[str, list[Score]] = {plan: [] for plan in settings.plans}
    starts: list[float] = []
    examples: list[Prediction] = []
    history: list[tuple[float, Array, Array]] = []
    example_at = (identify, identify + settings.fault_after_s + 5.0)
    for row, (t, z, cmd) in enumerate(seen):
        twin.step(t, z, cmd)
        if pictures and t >= next_second - 1e-9:
            next_second += 1.0
            estimate = twin.estimate()
            history.append((t, estimate.xi, estimate.xi_sd))
        if t < next_origin - 1e-9 or t > end + 1e-9:
            continue
        while next_origin <= t + 1e-9:
            next_origin += 1.0
        truth = reference.at(t + np.array([0.0, *STUDY_HORIZONS]))
        for plan in settings.plans:
            known = known_plan(seen, row, HORIZONS[-1], dt)
            commands = known if plan == "known" else np.repeat(cmd[None], len(known), axis=0)
            prediction = twin.predict(commands, dt=dt)
            scores[plan].append(score(prediction, truth, STUDY_HORIZONS))
            if plan == settings.plans[0]:
                starts.append(float(np.hypot(*(prediction.start[:2] - truth[0, :2]))))
                due = len(examples) < len(example_at) and t >= example_at[len(examples)] - 1e-9
                if pictures and due:
                    examples.append(prediction)
    if not starts:
        raise BenchmarkError(
            f"{unit.log or unit.run}: too short to be scored: predictions begin at "
            f"{identify:.0f} s and need {HORIZONS[-1]:g} s after them"
        )
    result: dict[str, Any] = {
        "digest": digest(settings, unit),
        "pictures": pictures,
        "unit": dataclasses.asdict(unit),
        "rows": [],
        "plans": {},
        "start_error": float(np.mean(starts)),
    }
    for plan, parts in scores.items():
        error, change, away, inside = (np.array(item) for item in zip(*parts, strict=True))
        channels = CHANNELS[-error.shape[2] :]
        size = {c: np.abs(error[:, :, i]) for i, c in enumerate(channels)} | {"displacement": away}
        result["plans"][plan] = {
            "scale": np.sqrt(np.mean(change[:, _AT] ** 2, axis=0)).T.tolist(),
            "coverage90": np.mean(inside[:, _AT], axis=0).T.tolist(),
            "mae": {c: size[c].mean(axis=0).tolist() for c in STUDY_CHANNELS if c in size},
        }
        for i, channel in enumerate(channels):
            for j, horizon in zip(_AT, HORIZONS, strict=True):
                e = error[:, j, i]
                result["rows"].append(
                    {
                        "scenario": unit.scenario,
                        "fault": unit.fault,
                        "seed": unit.seed,
                        "predictor": unit.predictor,
                        "plan": plan,
                        "channel": channel,
                        "horizon_s": horizon,
                        "mae": float(np.mean(np.abs(e))),
                        "mse": float(np.mean(e**2)),
                        "n": len(e),
                    }
                )
    if pictures:
        result["examples"] = [_thin(p) for p in examples]
        result["history"] = {
            "t": [t for t, _, _ in history],
            "xi": [xi.tolist() for _, xi, _ in history],
            "xi_sd": [sd.tolist() for _, _, sd in history],
            "names": twin.predictor.parameter_names,
            "units": twin.predictor.parameter_units,
            "blocks": dict(twin.predictor.parameter_blocks),
        }
    path = result_file(folder, unit)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = _partial(path)
    partial.write_text(json.dumps(result), encoding="utf-8")
    partial.replace(path)
    return result


def _partial(path: Path) -> Path:
    """Return a name beside a file that no other worker uses."""
    return path.with_name(f".{os.getpid()}_{threading.get_ident()}_{path.name}")


def _thin(prediction: Prediction) -> dict[str, Any]:
    """Return every fifth row of a prediction, and its last, for a picture."""
    rows = sorted({*range(4, len(prediction.t), 5), len(prediction.t) - 1})
    return {
        "t0": prediction.t0,
        "start": prediction.start.tolist(),
        "start_cov": prediction.start_cov.tolist(),
        "t": prediction.t[rows].tolist(),
        "mean": prediction.mean[rows].tolist(),
        "cov": prediction.cov[rows].tolist(),
        "low": prediction.low[rows].tolist(),
        "high": prediction.high[rows].tolist(),
    }


def _write_log(log: Log, particulars: Particulars, path: Path) -> None:
    """Write a log and its particulars, as a whole: another worker may do so at the same time."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = _partial(path)
    log.write(partial)
    partial.replace(path)
    partial.write_text(particulars.to_toml(), encoding="utf-8")
    partial.replace(beside(path, ".toml"))


@functools.cache
def _program() -> str:
    """Return the digest of the running program; every piece of work asks for it."""
    return sources_digest()


def digest(settings: Settings, unit: Unit) -> str:
    """Return what a result hangs on besides its unit: program, settings and recorded file."""
    kept = dataclasses.asdict(settings)
    for key in ("scenarios", "faults", "seeds", "predictors", "logs"):
        del kept[key]
    text = json.dumps([__version__, _program(), kept, dataclasses.asdict(unit)], sort_keys=True)
    value = hashlib.sha256(text.encode())
    ship = settings.ship if unit.log else settings.vessel
    read = files_of(unit.log, settings.mapping) if unit.log else []
    for path in (*read, Path(ship or "")):
        if path.is_file():
            with path.open("rb") as file:
                while piece := file.read(1 << 20):
                    value.update(piece)
    return value.hexdigest()


def result_file(folder: Path, unit: Unit) -> Path:
    """Return the file that holds the result of one piece of work."""
    return folder / "runs" / f"{unit.run}_{unit.predictor}.json"


def finished(
    settings: Settings, unit: Unit, folder: Path, *, pictures: bool
) -> dict[str, Any] | None:
    """Return the result of earlier work, if it is there and was got with the same settings."""
    try:
        result = json.loads(result_file(folder, unit).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if result.get("digest") != digest(settings, unit) or result.get("pictures") != pictures:
        return None
    return dict(result)


def all_finished(settings: Settings, folder: Path) -> bool:
    """Return whether nothing is left to do."""
    return all(
        finished(settings, unit, folder, pictures=wants_pictures(settings, unit)) is not None
        for unit in units(settings)
    )


def wants_pictures(settings: Settings, unit: Unit) -> bool:
    """Return whether a run is shown in the report: the first seed, and every recorded run."""
    return bool(unit.log) or unit.seed == settings.seeds[0]


def runs(
    settings: Settings, folder: Path, *, jobs: int = 1, backend: str = "loky"
) -> Iterator[tuple[Unit, dict[str, Any] | Exception]]:
    """Do all work that is not done yet, and yield each result as it comes.

    Parameters
    ----------
    settings : Settings
        What to do.
    folder : Path
        Folder of results.
    jobs : int
        Worker processes; the results do not depend on it.
    backend : str
        Of joblib.

    Yields
    ------
    Unit, dict or Exception
        A result, or why there is none (a log that cannot be read, say); the rest goes on.
    """
    from joblib import Parallel, delayed

    todo = []
    for unit in units(settings):
        done = finished(settings, unit, folder, pictures=wants_pictures(settings, unit))
        if done is None:
            todo.append(unit)
        else:
            yield unit, done
    if not todo:
        return
    pool = Parallel(n_jobs=jobs, backend=backend, return_as="generator_unordered")
    yield from pool(
        delayed(_attempt)(settings, unit, folder, wants_pictures(settings, unit)) for unit in todo
    )


def _attempt(
    settings: Settings, unit: Unit, folder: Path, pictures: bool
) -> tuple[Unit, dict[str, Any] | Exception]:
    try:
        return unit, run_unit(settings, unit, folder, pictures=pictures)
    except (ValueError, OSError) as error:
        return unit, error


def _resampled(values: Array) -> Array:
    """Return 2000 bootstrap means over seeds, from the same draws for every row."""
    n = len(values)
    return values[np.random.default_rng(0).integers(0, n, (2000, n))].mean(axis=1)


def _interval(means: Array, seeds: int) -> tuple[float | None, float | None]:
    """Return the middle 95 % of bootstrap values; none for fewer than three seeds."""
    if seeds < 3:
        return None, None
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


KEY = ("scenario", "fault", "seed", "predictor", "plan")
"""What tells the rows of ``results["runs"]`` apart."""


def run_rows(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row of metrics for each run, predictor and plan.

    ``mae`` and ``mse`` are pooled over :data:`CHANNELS` and :data:`HORIZONS` (as in the
    paper's Table 4, units mixed); ``normalised`` is the mean over channels and horizons of
    the MAE over the root mean square of the true change; ``skill`` is 1 minus the mean of the
    ratios to raw persistence; ``J`` is the mean over :data:`STUDY_CHANNELS` of the MAE (mean
    over :data:`STUDY_HORIZONS`) over that of the oracle on the same run, and ``E`` is J - 1;
    ``start_error`` is the distance of the believed from the true position at the origins, m;
    ``coverage90`` the share of errors inside the 90 % bands, mean of channels and horizons.

    Parameters
    ----------
    results : sequence of dict
        From :func:`run_unit`.
    """
    rows: dict[tuple[Any, ...], dict[str, Any]] = {}
    tables: dict[tuple[Any, ...], Array] = {}
    for result in results:
        unit = result["unit"]
        for plan, extra in result["plans"].items():
            here = [row for row in result["rows"] if row["plan"] == plan]
            key = (*(unit[name] for name in KEY[:-1]), plan)
            tables[key] = mae = np.array([row["mae"] for row in here])
            scale = np.array(extra["scale"]).ravel()
            moves = scale > 1e-6  # in a calm straight run nothing changes, and nothing is scored
            rows[key] = {
                **dict(zip(KEY, key, strict=True)),
                "mae": float(mae.mean()),
                "mse": float(np.mean([row["mse"] for row in here])),
                "start_error": result["start_error"],
                "coverage90": float(np.mean(extra["coverage90"][:-1])),
                "curves": extra["mae"],
            }
            if moves.any():
                rows[key]["normalised"] = float(np.mean(mae[moves] / scale[moves]))
    for key, row in rows.items():
        base, floor = ((*key[:3], name, key[4]) for name in (BASELINE, FLOOR))
        if base in rows:
            row["skill"] = 1.0 - float(np.mean(tables[key] / np.maximum(tables[base], 1e-12)))
        if floor in rows:
            lowest = rows[floor]["curves"]
            shares = [np.mean(v) / max(np.mean(lowest[c]), 1e-12) for c, v in row["curves"].items()]
            row["J"] = float(np.mean(shares))
            row["E"] = row["J"] - 1.0
    return list(rows.values())


def _groups(
    runs: Sequence[dict[str, Any]], *keys: str
) -> dict[tuple[Any, ...], list[dict[str, Any]]]:
    """Return rows with the same values of some keys together, ordered by seed."""
    groups: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in sorted(runs, key=lambda row: row["seed"]):
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return groups


_CELL = ("scenario", "fault", "predictor", "plan")


def summarise(runs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the summary over seeds: means with 95 % bootstrap intervals, and medians.

    Parameters
    ----------
    runs : sequence of dict
        From :func:`run_rows`; ``mae_median`` is the median MAE as a metric of its own.
    """
    order = {tuple(row[key] for key in _CELL): None for row in runs}
    groups = _groups(runs, *_CELL)
    summary = []
    for cell in order:
        members = groups[cell]
        for metric in METRICS:
            source = "mae" if metric == "mae_median" else metric
            if any(source not in row for row in members):
                continue
            values = np.array([row[source] for row in members])
            value, low, high = float(np.median(values)), None, None
            if metric == source:
                value = float(values.mean())
                low, high = _interval(_resampled(values), len(values))
            summary.append(
                {
                    **dict(zip(_CELL, cell, strict=True)),
                    "metric": metric,
                    "value": value,
                    "low": low,
                    "high": high,
                    "median": float(np.median(values)),
                }
            )
    return summary


def compare(runs: Sequence[dict[str, Any]], against: str) -> list[dict[str, Any]]:
    """Return the paired comparison of each predictor with a reference, on the same seeds.

    ``change_percent`` is the change of the mean pooled MAE, with a 95 % bootstrap interval
    over seeds; ``median_percent`` the median of the changes of single seeds; ``wins`` of
    ``seeds`` had the smaller MAE.

    Parameters
    ----------
    runs : sequence of dict
        From :func:`run_rows`.
    against : str
        Predictor to compare with; where it did not run there is nothing to compare.
    """
    table = {tuple(row[key] for key in KEY): row["mae"] for row in runs}
    rows = []
    for cell, members in _groups(runs, *_CELL).items():
        pairs = [
            (row["mae"], table[(*(row[key] for key in KEY[:3]), against, row["plan"])])
            for row in members
            if (*(row[key] for key in KEY[:3]), against, row["plan"]) in table
        ]
        if cell[2] == against or not pairs:
            continue
        own, other = np.array(pairs).T
        ratio = _resampled(own) / _resampled(other)
        low, high = _interval(100.0 * (ratio - 1.0), len(own))
        rows.append(
            {
                **dict(zip(_CELL, cell, strict=True)),
                "against": against,
                "change_percent": 100.0 * float(own.mean() / other.mean() - 1.0),
                "low": low,
                "high": high,
                "median_percent": 100.0 * float(np.median(own / other) - 1.0),
                "wins": int((own < other).sum()),
                "seeds": len(own),
            }
        )
    return rows


def coverage(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the share of errors inside the 90 % bands, by channel and horizon.

    Parameters
    ----------
    results : sequence of dict
        From :func:`run_unit`; seeds are pooled.
    """
    tables: dict[tuple[str, ...], list[Array]] = {}
    for result in results:
        for plan, extra in result["plans"].items():
            key = (*(result["unit"][name] for name in _CELL[:3]), plan)
            tables.setdefault(key, []).append(np.array(extra["coverage90"]))
    rows = []
    for key, parts in tables.items():
        share = np.mean(parts, axis=0)
        for i, channel in enumerate(COVERED[-len(share) :]):
            for j, horizon in enumerate(HORIZONS):
                rows.append(
                    {
                        **dict(zip(_CELL, key, strict=True)),
                        "channel": channel,
                        "horizon_s": horizon,
                        "coverage90": float(share[i, j]),
                    }
                )
    return rows


def collect(
    settings: Settings,
    done: dict[Unit, dict[str, Any]],
    command: str,
    notes: Sequence[str] = (),
    against: str = AGAINST,
) -> dict[str, Any]:
    """Return the content of ``results.json``.

    Parameters
    ----------
    settings : Settings
        What was measured.
    done : dict
        Results by unit; those that are missing are left out.
    command : str
        The command that made them.
    notes : sequence of str
        What a reader must know of them.
    against : str
        Reference of the paired comparison.
    """
    ordered = [done[unit] for unit in units(settings) if unit in done]
    runs = run_rows(ordered)
    return {
        "version": __version__,
        "command": command,
        "notes": list(notes),
        "settings": {
            **dataclasses.asdict(settings),
            "logs": [Path(path).name for path in settings.logs],
        },
        "rows": [row for result in ordered for row in result["rows"]],
        "summary": summarise(runs),
        "paired": compare(runs, against),
        "coverage": coverage(ordered),
        "horizons_s": list(STUDY_HORIZONS),
        "runs": runs,
    }


def lost_gps(settings: Settings, unit: Unit, log: Log) -> list[tuple[float, float]]:
    """Return the spans of time without GPS in a run, s."""
    identify = _recorded_identify(log) if unit.log else settings.identify_s
    start = float(log.t[0]) + fault_start(settings, identify)
    return gps_windows(parse_faults(unit.fault, start))


def gps_windows(faults: Sequence[Disturbance]) -> list[tuple[float, float]]:
    """Return the spans of time without GPS that are known beforehand, s."""
    return [
        (fault.start, fault.start + fault.duration)
        for fault in faults
        if isinstance(fault, Fault) and fault.effect == "loss" and FAULT_KINDS[fault.kind] & GPS_BIT
    ]


def default_logs() -> tuple[str, ...]:
    """Return the recorded runs that a benchmark without arguments scores."""
    return tuple(str(path) for path in recorded_runs().values())


def warm_up(settings: Settings) -> None:
    """Compile what the workers will need, before there are several to compile it at once."""
    vessel, sea = settings.boat(0), settings.sea()
    log = simulate("turn", vessel=vessel, sea=sea, duration=1.0, seed=0)
    for name in settings.predictors:
        twin = Twin(particulars_of(vessel), name, **world_options(name, vessel, sea, settings.dof))
        twin.run(log)
        twin.predict("hold")


def figures(settings: Settings, done: dict[Unit, dict[str, Any]]) -> list[RunFigure]:
    """Return what the report draws: one entry for each run that kept its pictures.

    Parameters
    ----------
    settings : Settings
        What was measured.
    done : dict
        Results by unit.
    """
    shown: dict[tuple[str, str, int], RunFigure] = {}
    for unit in units(settings):
        result = done.get(unit)
        if result is None or "history" not in result:
            continue
        key = (unit.scenario, unit.fault, unit.seed)
        if key not in shown:
            log = load_run(settings, unit)[1]
            shown[key] = RunFigure(
                scenario=unit.scenario,
                fault=unit.fault,
                seed=unit.seed,
                log=log,
                lost=lost_gps(settings, unit, log),
                predictors={},
            )
        history = result["history"]
        shown[key].predictors[unit.predictor] = PredictorFigure(
            examples=[
                Prediction(
                    t0=example["t0"],
                    **{
                        name: np.array(example[name])
                        for name in ("start", "start_cov", "t", "mean", "cov", "low", "high")
                    },
                )
                for example in result["examples"]
            ],
            t=np.array(history["t"]),
            xi=np.array(history["xi"]),
            xi_sd=np.array(history["xi_sd"]),
            names=tuple(history["names"]),
            units=tuple(history["units"]),
            blocks={motion: (first, last) for motion, (first, last) in history["blocks"].items()},
        )
    return list(shown.values())
