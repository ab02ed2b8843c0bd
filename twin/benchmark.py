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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.log import Log, beside, recorded_runs
from twin.particulars import Particulars
from twin.predictor import Prediction
from twin.registry import EXTRAS, PREDICTORS, PredictorError, predictor_class
from twin.report import PredictorFigure, RunFigure
from twin.simulated import particulars_of, simulate
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
    "CHANNELS",
    "HORIZONS",
    "METRICS",
    "BenchmarkError",
    "Settings",
    "Unit",
    "collect",
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
METRICS = ("mae", "mae_median", "mse", "normalised", "skill", "start_error", "coverage90")
BASELINE = "persistence"
_Z90 = 1.6448536269514722


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
        Each is a sea, a set of sensor errors and (random manoeuvre) a helmsman.
    plans : tuple of str
        ``known``: the future commands are given (Eq 27); ``hold``: the last one is held.
    vessel : str
        Name or TOML file.
    dof : int
        Degrees of freedom of the simulated ship, 3 or 6.
    hs, wind, wind_from_deg : float
        Sea state: wave height (m), wind speed (m/s) and direction (degrees).
    logs : tuple of str
        Recorded runs to score.
    ship : str or None
        Particulars of the recorded boat; a TOML file of the log's name beside it if None.
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
    plans: tuple[str, ...] = ("known",)
    vessel: str = "usv75"
    dof: int = 3
    hs: float = 0.5
    wind: float = 4.5
    wind_from_deg: float = 135.0
    logs: tuple[str, ...] = ()
    ship: str | None = None
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
        self.sea()

    def sea(self) -> SeaState:
        """Return the sea state of the simulated runs."""
        return SeaState(hs=self.hs, wind=self.wind, wind_from=math.radians(self.wind_from_deg))


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
        ]
    return work


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
        vessel = Vessel.load(settings.vessel)
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
    log = Log.read(unit.log)
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


def _errors(prediction: Prediction, truth: Array) -> tuple[Array, Array, Array]:
    """Return errors, true changes and standard deviations (h, channels) of one prediction.

    Positions count from where the prediction started, so that the error of the start, which
    is the receiver's and common to all predictors, is not counted again at each horizon; it
    is reported on its own (``start_error``). ``truth`` holds the start in its first row.
    """
    mean, cov = prediction.at(np.array(HORIZONS))
    start, later = truth[0], truth[1:]
    psi = later[:, 2]
    c, s = np.cos(psi), np.sin(psi)
    moved = later[:, :2] - start[:2]
    ex, ey = (mean[:, :2] - prediction.start[:2] - moved).T
    spread = cov - prediction.start_cov
    xx, xy, yy = spread[:, 0, 0], spread[:, 0, 1], spread[:, 1, 1]
    along = [
        ex * c + ey * s,
        moved[:, 0] * c + moved[:, 1] * s,
        np.sqrt(np.maximum(c * c * xx + 2 * c * s * xy + s * s * yy, 0.0)),
    ]
    across = [
        ey * c - ex * s,
        moved[:, 1] * c - moved[:, 0] * s,
        np.sqrt(np.maximum(s * s * xx - 2 * c * s * xy + c * c * yy, 0.0)),
    ]
    turn = (mean[:, 2] - psi + math.pi) % (2.0 * math.pi) - math.pi
    heading = [turn, psi - start[2], np.sqrt(cov[:, 2, 2])]
    parts = [along, across, heading]
    if truth.shape[1] == 6:
        parts = [
            [mean[:, i] - later[:, i], later[:, i] - start[i], np.sqrt(cov[:, i, i])]
            for i in (3, 4, 5)
        ] + parts
    table = np.array(parts).transpose(1, 2, 0)
    return table[0], table[1], table[2]


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
    options = {}
    if predictor_class(unit.predictor).trains:
        # in time for the first prediction: its history begins with the first late fix
        options["train_at"] = identify - float(seen.t[0]) - 0.5
    twin = Twin(particulars, unit.predictor, seed=unit.seed, **options)
    dt = min(max(seen.dt, 0.02), 0.25)
    end = float(seen.t[-1]) - HORIZONS[-1]
    next_origin, next_second = identify, float(seen.t[0])
    scores: dict[str, list[Any]] = {plan: [] for plan in settings.plans}
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
        truth = reference.at(t + np.array([0.0, *HORIZONS]))
        for plan in settings.plans:
            known = known_plan(seen, row, HORIZONS[-1], dt)
            commands = known if plan == "known" else np.repeat(cmd[None], len(known), axis=0)
            prediction = twin.predict(commands, dt=dt)
            scores[plan].append(_errors(prediction, truth))
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
        error, change, sd = (np.array([part[i] for part in parts]) for i in range(3))
        channels = CHANNELS if error.shape[2] == 6 else CHANNELS[3:]
        result["plans"][plan] = {
            "scale": np.sqrt(np.mean(change**2, axis=0)).T.tolist(),
            "coverage90": np.mean(np.abs(error) <= _Z90 * sd, axis=0).T.tolist(),
        }
        for i, channel in enumerate(channels):
            for j, horizon in enumerate(HORIZONS):
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
            "blocks": twin.predictor.parameter_blocks,
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
    for path in (unit.log, settings.ship if unit.log else settings.vessel):
        if path and Path(path).is_file():
            value.update(Path(path).read_bytes())
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


def _interval(values: Array, rng: np.random.Generator) -> tuple[float | None, float | None]:
    """Return the 95 % bootstrap interval of a mean over seeds; none for fewer than three."""
    if len(values) < 3:
        return None, None
    draws = values[rng.integers(0, len(values), (2000, len(values)))].mean(axis=1)
    low, high = np.percentile(draws, [2.5, 97.5])
    return float(low), float(high)


def summarise(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the summary rows over seeds.

    Per run, ``mae`` and ``mse`` are pooled over channels and horizons (as in the paper's
    Table 4, units mixed); ``normalised`` is the mean over channels and horizons of the MAE
    over the root mean square of the true change; ``skill`` is 1 minus the mean of the ratios
    to raw persistence; ``start_error`` is the distance of the believed from the true position
    at the origins, m; ``coverage90`` the share of errors inside the 90 % bands. Values are
    means over seeds with 95 % bootstrap intervals; ``mae_median`` is the median over seeds.

    Parameters
    ----------
    results : sequence of dict
        From :func:`run_unit`.
    """
    pooled: dict[tuple[str, str, int, str, str], dict[str, float]] = {}
    tables: dict[tuple[str, str, int, str, str], Array] = {}
    for result in results:
        unit = result["unit"]
        for plan, extra in result["plans"].items():
            rows = [row for row in result["rows"] if row["plan"] == plan]
            key = (unit["scenario"], unit["fault"], unit["seed"], unit["predictor"], plan)
            mae = np.array([row["mae"] for row in rows])
            scale = np.array(extra["scale"]).ravel()
            moves = scale > 1e-6  # in a calm straight run nothing changes, and nothing is scored
            tables[key] = mae
            pooled[key] = {
                "mae": float(mae.mean()),
                "mse": float(np.mean([row["mse"] for row in rows])),
                "start_error": result["start_error"],
                "coverage90": float(np.mean(extra["coverage90"])),
            }
            if moves.any():
                pooled[key]["normalised"] = float(np.mean(mae[moves] / scale[moves]))
    for key, values in pooled.items():
        base = tables.get((*key[:3], BASELINE, key[4]))
        if base is not None:
            values["skill"] = 1.0 - float(np.mean(tables[key] / np.maximum(base, 1e-12)))
    groups: dict[tuple[str, str, str, str], list[tuple[int, dict[str, float]]]] = {}
    for (scenario, fault, seed, predictor, plan), values in pooled.items():
        groups.setdefault((scenario, fault, predictor, plan), []).append((seed, values))
    summary = []
    for (scenario, fault, predictor, plan), members in groups.items():
        ordered = [values for _, values in sorted(members, key=lambda item: item[0])]
        for metric in METRICS:
            source = "mae" if metric == "mae_median" else metric
            if any(source not in values for values in ordered):
                continue
            numbers = np.array([values[source] for values in ordered])
            low, high = None, None
            if metric == "mae_median":
                value = float(np.median(numbers))
            else:
                value = float(numbers.mean())
                # the same draws for every row: rows of one run stay comparable
                low, high = _interval(numbers, np.random.default_rng(0))
            summary.append(
                {
                    "scenario": scenario,
                    "fault": fault,
                    "predictor": predictor,
                    "plan": plan,
                    "metric": metric,
                    "value": value,
                    "low": low,
                    "high": high,
                }
            )
    return summary


def collect(
    settings: Settings,
    done: dict[Unit, dict[str, Any]],
    command: str,
    notes: Sequence[str] = (),
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
    """
    ordered = [done[unit] for unit in units(settings) if unit in done]
    return {
        "version": __version__,
        "command": command,
        "notes": list(notes),
        "settings": {
            **dataclasses.asdict(settings),
            "logs": [Path(path).name for path in settings.logs],
        },
        "rows": [row for result in ordered for row in result["rows"]],
        "summary": summarise(ordered),
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
    vessel = Vessel.load(settings.vessel)
    log = simulate("turn", vessel=vessel, sea=settings.sea(), duration=1.0, seed=0)
    for name in settings.predictors:
        twin = Twin(particulars_of(vessel), name)
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
                        for name in ("start", "start_cov", "t", "mean", "cov")
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
