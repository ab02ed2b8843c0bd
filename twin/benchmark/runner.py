"""The benchmark: scenarios times cases times predictors times seeds, scored against the truth.

The result of each predictor on each run is a file of its own. So an interrupted benchmark
continues where it stopped, and neither number nor kind of workers changes a result. A predictor
gets copies of the rows of a log without truth, and never sees another predictor.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
import urllib.parse
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.benchmark.conformance import raised
from twin.benchmark.figures.data import RunFigure
from twin.benchmark.loading import Run, fault_start, load_run
from twin.benchmark.metrics import (
    channel_table,
    compare,
    recorded_table,
    rows_of,
    run_rows,
    summarise,
)
from twin.benchmark.motion_scores import (
    MotionScore,
    MotionTruth,
    motion_rows,
    motion_table,
    quiet_rows,
)
from twin.benchmark.protocol import HORIZONS, BenchmarkError, Settings, Unit, units
from twin.benchmark.scores import STUDY_HORIZONS, Reference, Score, as_measured, score, table_of
from twin.benchmark.sources import predictor_digest, versions
from twin.benchmark.verdict.losses import loss_rows, losses_to_score, score_loss_end
from twin.benchmark.verdict.recorded import RecordedPersistence, commands_end
from twin.benchmark.verdict.summary import verdict_rows
from twin.digital_twin import Twin, known_plan
from twin.files import keep, kept
from twin.logs.log import files_of, sibling_path
from twin.parallel import results_of
from twin.predictors.base import ForecastError, Prediction, Predictor
from twin.predictors.registry import base_name, options_of, predictor_class
from twin.sim.bridge import write_run
from twin.sim.compilation import compile_kernels
from twin.sim.oracle import simulator_options
from twin.sim.recorded import particulars_for_log
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.channels import FIXES_BIT, GPS_BIT
from usv_gym.world.faults import FAULT_KINDS, Fault, parse_faults
from usv_kernel import __version__
from usv_kernel.cache import running_program
from usv_kernel.errors import UsvTwinError

__all__ = ["AGAINST", "collect", "run_figures", "run_unit", "runs"]

Array = NDArray[np.float64]

AGAINST = "ukf"
"""Default reference of the paired comparison."""

AGAINST_RECORDED = "var"
"""The reference on recorded runs, where it takes part."""


BY_PLAN = ("plans", "motion", "examples")
"""Parts of a result that have an entry for each plan."""

NAME_MAX = 160
"""Most characters of a run and predictor in the name of a result file; file systems take 255."""


def run_unit(
    settings: Settings, unit: Unit, folder: Path, *, pictures: bool, run: Run | None = None
) -> dict[str, Any]:
    """Run one predictor on one run, score it, and keep the result in a file of the folder.

    The file is replaced as a whole or not at all, and keeps the plans that it has. ``pictures``
    keeps a few predictions for the pictures. ``run`` is from :func:`load_run`, where at hand.
    The result has ``unit``, ``plans`` with a table of scores each (see
    :func:`twin.benchmark.scores.table_of`), and what the pictures need.
    """
    run = run or load_run(settings, unit)
    seen, identify = run.seen, run.identify
    reference = Reference(run.reference)
    moves = run.reference.true_motion is not None
    motion_truth = MotionTruth(run.reference, run.particulars, identify) if moves else None
    twin = _new_twin(settings, unit, run)
    dt = min(max(seen.dt, 0.02), 0.25)
    last_command = commands_end(run.reference)
    end = last_command - HORIZONS[-1]
    lost = lost_gps(settings, unit, run)
    fix_sd = run.particulars.instruments.gps_sd if reference.measured else 0.0
    loss_ends = losses_to_score(seen.t, lost, reference)
    ended: list[dict[str, float]] = []
    held = RecordedPersistence(run.reference, reference, unit.log) if unit.log else None
    held_errors: list[Array] = []
    next_origin = identify
    scores: dict[str, list[Score]] = {plan: [] for plan in settings.plans}
    motions: dict[str, list[MotionScore]] = {plan: [] for plan in settings.plans}
    starts: list[float] = []
    skipped = 0
    examples: dict[str, list[Any]] = {plan: [] for plan in settings.plans if pictures}
    example_at = (identify, identify + settings.fault_after_s + 5.0)
    for row, (t, z, cmd) in enumerate(seen):
        # copies: through the base of a view, a predictor could see the future
        twin.step(t, z.copy(), cmd.copy())
        if row in loss_ends:
            ended.append(score_loss_end(twin.estimate(), loss_ends[row], reference, fix_sd))
        if t < next_origin - 1e-9 or t > end + 1e-9:
            continue
        while next_origin <= t + 1e-9:
            next_origin += 1.0
        times = t + np.array([0.0, *STUDY_HORIZONS])
        if not reference.known(times):
            skipped += 1
            continue
        truth = reference.at(times)
        if not np.isfinite(truth).all():
            raise BenchmarkError(f"{run.reference.name}: its truth has gaps")
        if held is not None:
            held_errors.append(held.squared_errors(truth[[0, -1]][:, :3], times[[0, -1]]))
        known = known_plan(run.reference, row, HORIZONS[-1], dt)
        for plan in settings.plans:
            commands = known if plan == "known" else np.repeat(cmd[None], len(known), axis=0)
            try:
                prediction = twin.predict(commands, dt=dt)
            except ForecastError as error:
                raise BenchmarkError(
                    f"{unit.predictor}, run {unit.run}, plan {plan}, origin t = {t:.2f} s: {error}"
                ) from error
            compared = (
                as_measured(prediction, run.particulars) if reference.measured else prediction
            )
            scores[plan].append(score(compared, truth, STUDY_HORIZONS))
            if motion_truth is not None and prediction.motion is not None:
                motions[plan].append(motion_truth.score(prediction.motion))
            if not all(math.isfinite(part.sum()) for part in scores[plan][-1]):
                raise BenchmarkError(
                    f"{unit.predictor}, run {unit.run}, plan {plan}: its start or intervals at "
                    f"t = {t:.2f} s are not finite"
                )
            if plan == settings.plans[0]:
                starts.append(float(np.hypot(*(prediction.start[:2] - truth[0, :2]))))
            shown = len(examples.get(plan, example_at))
            if shown < len(example_at) and t >= example_at[shown] - 1e-9:
                examples[plan].append(_thin(prediction))
    if not starts:
        gaps = f"; {skipped} lie in gaps of positions or headings" if skipped else ""
        raise BenchmarkError(
            f"{unit.log or unit.run}: too short to be scored: predictions begin at "
            f"{identify:.0f} s and need {HORIZONS[-1]:g} s of commands after them, and the last "
            f"command is at {last_command:.0f} s{gaps}"
        )
    result: dict[str, Any] = {
        "unit": dataclasses.asdict(unit),
        "plans": {plan: table_of(parts) for plan, parts in scores.items()},
        "start_error": float(np.mean(starts)),
        "skipped": skipped,
        "loss_ends": ended,
        "repairs": list(run.reference.notes),
        "absurd": list(run.absurd),
        "datum": None if run.reference.datum is None else run.reference.datum.to_json(),
    }
    if held_errors:
        displacement, psi = np.mean(held_errors, axis=0).tolist()
        result["held_mse"] = {"displacement": displacement, "psi": psi}
        # forecasts that would reach past the last recorded command
        past = np.floor(float(seen.t[-1]) - HORIZONS[-1] - max(end, identify))
        result["past_commands"] = {"end_s": last_command, "left_out": max(int(past), 0)}
    if motion_truth is not None:
        result["motion"] = {plan: motion_table(parts) for plan, parts in motions.items() if parts}
    if pictures:
        result["examples"] = examples
    path, key = result_file(settings, unit, folder), digest(settings, unit)
    before = kept(path, key) or {}
    of_plans = {name: {**before.get(name, {}), **result.get(name, {})} for name in BY_PLAN}
    keep(path, key, {**result, **{name: part for name, part in of_plans.items() if part}})
    return result


def _new_twin(settings: Settings, unit: Unit, run: Run) -> Twin:
    """Return the twin of a run with a unit's predictor."""
    options: dict[str, Any] = {}
    if run.simulator:
        options |= simulator_options(unit.predictor, *run.simulator)
    if predictor_class(unit.predictor).trains:
        # in time for the first prediction, whose history begins with the first late fix
        options["train_at"] = run.identify - float(run.seen.t[0]) - 0.5
    # what stands in the name is closer to the predictor than what holds for all
    for named in options_of(unit.predictor):
        options.pop(named, None)
    return Twin(run.particulars, unit.predictor, seed=unit.seed, **options)


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


def _prediction_of(example: dict[str, Any]) -> Prediction:
    """Return what :func:`_thin` has kept of a prediction."""
    arrays: dict[str, Any] = {key: np.array(part) for key, part in example.items() if key != "t0"}
    return Prediction(example["t0"], **arrays)


def digest(settings: Settings, unit: Unit) -> str:
    """Return a hash of all that a result depends on.

    That is programs and their versions, settings, unit, the sources and files of the predictor, and
    the recorded file. Files count by name and content, not by folder.
    """
    program = [__version__, running_program(), versions(unit.predictor)]
    value = hashlib.sha256(json.dumps([*program, _asked(settings, unit)], sort_keys=True).encode())
    value.update(predictor_digest(unit.predictor).encode())
    ship = settings.ship if unit.log else settings.vessel
    read = list(files_of(unit.log, settings.mapping)) if unit.log else []
    if unit.log and settings.ship is None:
        read.append(sibling_path(unit.log, ".toml"))
    if unit.log:
        prior = particulars_for_log(unit.log, settings.ship, settings.mapping).prior
        value.update(b"" if prior is None else prior.file_text().encode())
    for path in (*read, Path(ship or "")):
        if path.is_file():
            with path.open("rb") as file:
                while piece := file.read(1 << 20):
                    value.update(piece)
    return value.hexdigest()


def _asked(settings: Settings, unit: Unit) -> list[dict[str, Any]]:
    """Return a unit, and the settings that its result depends on, as far as they have names."""
    asked = dataclasses.asdict(settings)
    for key in ("scenarios", "faults", "cases", "seeds", "predictors", "plans", "logs"):
        del asked[key]
    for key in ("vessel", "ship", "mapping"):
        if asked[key] is not None:
            asked[key] = Path(asked[key]).name
    return [asked, {**dataclasses.asdict(unit), "log": Path(unit.log).name}]


def result_file(settings: Settings, unit: Unit, folder: Path) -> Path:
    """Return the file that holds the result of one piece of work; other settings have another."""
    asked = json.dumps(_asked(settings, unit), sort_keys=True).encode()
    name = urllib.parse.quote(f"{unit.run}_{unit.predictor}", safe="+")[:NAME_MAX]
    return folder / "runs" / f"{name}_{hashlib.sha256(asked).hexdigest()[:16]}.json"


def finished(settings: Settings, unit: Unit, folder: Path) -> dict[str, Any] | None:
    """Return the result of earlier work with the same settings, if there is one."""
    path = result_file(settings, unit, folder)
    result: dict[str, Any] = (path.exists() and kept(path, digest(settings, unit))) or {}
    needed = ("plans", "examples") if wants_pictures(settings, unit) else ("plans",)
    if any(plan not in result.get(name, ()) for name in needed for plan in settings.plans):
        return None
    # an equal log may lie in another folder now
    of_plans = {
        name: {plan: result[name][plan] for plan in settings.plans if plan in result[name]}
        for name in BY_PLAN
        if name in result
    }
    return {**result, **of_plans, "unit": dataclasses.asdict(unit)}


def reusable(settings: Settings, folder: Path) -> dict[Unit, dict[str, Any]]:
    """Return the results of earlier work that nothing has changed since."""
    found = {unit: finished(settings, unit, folder) for unit in units(settings)}
    return {unit: result for unit, result in found.items() if result is not None}


def wants_pictures(settings: Settings, unit: Unit) -> bool:
    """Return whether a run is drawn: first seeds of drawn cases, first runs of each folder."""
    if unit.log:
        folder = Path(unit.log).absolute().parent
        peers = [path for path in settings.logs if Path(path).absolute().parent == folder]
        return unit.log in peers[: MAX_DRAWN_LOGS if len(peers) > MAX_DRAWN_LOGS else None]
    drawn = {case.name for case in settings.conditions if case.drawn}
    return unit.seed == settings.seeds[0] and unit.case in drawn


MAX_DRAWN_LOGS = 3
"""Of more recorded runs in one folder, this many are shown."""


def runs(
    settings: Settings,
    folder: Path,
    *,
    jobs: int = 1,
    backend: str = "loky",
    done: Mapping[Unit, dict[str, Any]] | None = None,
) -> Iterator[tuple[Unit, dict[str, Any] | Exception]]:
    """Do all work that is not done yet, and yield each result, or why there is none, as it comes.

    A worker takes a run, which is simulated or read once, or where there are fewer runs than
    workers single predictors. The results do not depend on ``jobs`` and ``backend`` (one of
    ``twin.parallel.BACKENDS``). After an error (a log that cannot be read, say) the rest goes on.
    ``done`` are the results to reuse, if not those of :func:`reusable`; none computes all again.
    """
    todo: dict[tuple[str, ...], list[Unit]] = {}
    done = reusable(settings, folder) if done is None else done
    for unit in units(settings):
        if unit in done:
            yield unit, done[unit]
        else:
            todo.setdefault((unit.log, unit.sea, unit.grade, unit.run), []).append(unit)
    if not todo:
        return
    # recorded runs first: they are the longest, and no worker is to wait for them at the end
    tasks = [todo[run] for run in sorted(todo, key=lambda run: not run[0])]
    if len(tasks) < jobs:
        tasks = [[unit] for task in tasks for unit in task]
    calls = [functools.partial(_attempt, settings, task, folder) for task in tasks]
    for result in results_of(calls, jobs=jobs, backend=backend):
        yield from result[1]


def _attempt(
    settings: Settings, task: Sequence[Unit], folder: Path
) -> list[tuple[Unit, dict[str, Any] | Exception]]:
    """Score the predictors of one run."""
    try:
        run = load_run(settings, task[0])
        if not task[0].log:
            write_run(run.reference, run.particulars, folder / "logs" / f"{task[0].run}.csv")
    except Exception as error:
        return [(unit, _portable(error, unit.run)) for unit in task]
    return [(unit, _scored(settings, unit, folder, run)) for unit in task]


def _scored(settings: Settings, unit: Unit, folder: Path, run: Run) -> dict[str, Any] | Exception:
    """Return the result of a unit, or the error that stopped it."""
    pictures = wants_pictures(settings, unit)
    try:
        return run_unit(settings, unit, folder, pictures=pictures, run=run)
    except Exception as error:  # of a user's predictor
        return _portable(error, f"{unit.run}, {unit.predictor}")


def _portable(error: Exception, what: str) -> BenchmarkError:
    """Return an error that a worker can send; of an unexpected one with what, kind and place."""
    plain = isinstance(error, (UsvTwinError, OSError)) and str(error)
    return BenchmarkError(str(error) if plain else f"{what}: {raised(error)}")


def collect(
    settings: Settings,
    done: dict[Unit, dict[str, Any]],
    command: str,
    notes: Sequence[str] = (),
    against: str | None = None,
) -> dict[str, Any]:
    """Return the content of ``results.json``; results that are missing are left out.

    ``notes`` are remarks for a reader. ``against`` is the reference of the paired comparisons:
    :data:`AGAINST` if left out, on recorded runs :data:`AGAINST_RECORDED` where it takes part.
    """
    names = shown_names(settings.predictors)
    ordered = [
        {**done[unit], "unit": {**done[unit]["unit"], "predictor": names[unit.predictor]}}
        for unit in units(settings)
        if unit in done
    ]
    against = None if against is None else names[against]
    runs = run_rows(ordered)
    on_recorded = AGAINST_RECORDED if AGAINST_RECORDED in settings.predictors else AGAINST
    return {
        "version": __version__,
        "program": {"sources": running_program(), **versions()},
        "command": command,
        "against": against,
        "notes": list(notes),
        "settings": {
            **dataclasses.asdict(settings),
            "logs": [Path(path).name for path in settings.logs],
        },
        "predictors": {
            # a subclass does not inherit the search for its parent's settings
            names[name]: {
                "tuning": vars(predictor_class(name)).get("tuning", Predictor.tuning),
                "sources": predictor_digest(name),
            }
            for name in settings.predictors
        },
        "logs": {
            result["unit"]["scenario"]: {
                "repairs": result["repairs"],
                "absurd": result["absurd"],
                "skipped": result["skipped"],
                **result.get("past_commands", {}),
                "datum": result.get("datum"),
            }
            for result in ordered
            if result["unit"]["log"]
        },
        "rows": list(rows_of(ordered)),
        "motion": list(motion_rows(ordered)),
        "quiet": list(quiet_rows(ordered)),
        "summary": summarise(runs),
        "paired": compare(runs, against or AGAINST),
        "recorded": recorded_table(ordered, against or on_recorded),
        "verdict": verdict_rows([row for row in runs if row["sea"]], settings),
        "losses": loss_rows(ordered),
        "channels": channel_table(ordered),
        "horizons_s": list(STUDY_HORIZONS),
        "runs": runs,
    }


def shown_names(predictors: Sequence[str]) -> dict[str, str]:
    """Return what predictors are called in results: one of a module by its class, where clear."""
    shown = {name: name.split(":", 1)[1] if ":" in base_name(name) else name for name in predictors}
    names = list(shown.values())
    return {name: own if names.count(own) == 1 else name for name, own in shown.items()}


def lost_gps(settings: Settings, unit: Unit, run: Run) -> list[tuple[float, float]]:
    """Return the spans of time without GPS in a run, s."""
    begin = float(run.reference.t[0])
    faults = parse_faults(unit.fault, fault_start(settings, run.identify - begin))
    return [
        (begin + fault.start, begin + (fault.start + fault.duration))
        for fault in faults
        if isinstance(fault, Fault)
        and fault.effect == "loss"
        and FAULT_KINDS[fault.kind] & (GPS_BIT | FIXES_BIT)
    ]


def warm_up(settings: Settings, *, jobs: int = 1, backend: str = "loky") -> None:
    """Compile once what all workers will need."""
    boat = Vessel.load(settings.vessel), settings.sea(), settings.dof
    compile_kernels(boat, settings.predictors, jobs=jobs, backend=backend)


def run_figures(settings: Settings, done: dict[Unit, dict[str, Any]]) -> list[RunFigure]:
    """Return what the report draws: one entry for each run that kept its pictures."""
    names, shown = shown_names(settings.predictors), dict[tuple[str, str, int], RunFigure]()
    for unit in units(settings):
        result = done.get(unit)
        if result is None or not wants_pictures(settings, unit):
            continue
        key = (unit.scenario, unit.fault, unit.seed)
        if key not in shown:
            run = load_run(settings, unit)
            shown[key] = RunFigure(
                scenario=unit.scenario,
                fault=unit.fault,
                seed=None if unit.log else unit.seed,
                log=run.reference,
                lost=lost_gps(settings, unit, run),
                examples={},
            )
        shown[key].examples[names[unit.predictor]] = [
            _prediction_of(example) for example in result["examples"][settings.plans[0]]
        ]
    return list(shown.values())
