"""What each mechanism of ``dsw-ukf-plus`` is worth: its forecasts with one mechanism switched off.

The package has no such switches. Its source is copied, lines of the copy are replaced, and the copy
forecasts simulated runs of fresh seeds and, if given, recorded ones. A mechanism that is done is
not computed again: Ctrl-C, and the same command goes on. See README.md.
"""

from __future__ import annotations

import argparse
import ast
import copy
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
AT = [2.0, 5.0, 10.0]  # horizons of coverage, s; errors are those of the last
FIRST_S = 60.0  # first forecast of a run
EVERY_S = 2.0  # time between two
CHANGED_S = 90.0  # when something changes
AFTER_S = 30.0  # time until the boat is scored again
LOSS_S = 39.0  # of GPS, in simulated runs from 80 s on

UPDATE = "twin/predictors/plus_update.py"
WEIGHT = "twin/identification/data_weight.py"
FORECAST = "twin/predictors/forecast.py"
PLUS = "twin/predictors/dsw_ukf_plus.py"
SETTINGS = "twin/identification/filter_settings.py"
CHANGE = "twin/identification/change.py"
WINDOW = "twin/identification/window.py"
SCALE = "twin/identification/interval_scale.py"
WAVES = "twin/identification/wave_residual.py"

Patch = tuple[str, str, str]
"""A file, text in it, and what replaces that."""

MECHANISMS: dict[str, tuple[list[Patch], list[str]]] = {
    "all learning": ([(UPDATE, "if count < SEGMENTS_MIN:", "if count >= 0:")], []),
    "joint filter as candidate": (
        [(PLUS, "return FIRST if", "return NONE if")],
        [f"{UPDATE}:_identify", f"{UPDATE}:_average_parameters"],
    ),
    "several data weights": (
        [(WEIGHT, "(1.0, 10.0, 100.0, 0.1, 1.0, 10.0, 100.0)", "(1.0,) * 7")],
        [],
    ),
    "short spans": ([(WEIGHT, "math.inf, 35.0, 35.0, 35.0", "math.inf, 1e9, 1e9, 1e9")], []),
    "test for change": (
        [(WEIGHT, "if not _may_change(newest, state.count):", "if True:")],
        [CHANGE, f"{WEIGHT}:_test_for_change", f"{WEIGHT}:_begin_after", f"{WEIGHT}:_may_change"],
    ),
    "thrust known before a change": (
        [(WEIGHT, "ALARM_INFORMATION_MIN = 30.0", "ALARM_INFORMATION_MIN = 0.0")],
        [],
    ),
    "three lags of a change": (
        [(WEIGHT, "LAGS_S = (2.0, 6.0, 14.0)", "LAGS_S = (6.0, 6.0, 6.0)")],
        [],
    ),
    "cumulative sum of surprise": (
        [(WEIGHT, "worse - CUSUM_DRIFT, 0.0", "worse - 1e9, 0.0")],
        [],
    ),
    "mean with the refit, in a loss": (
        [(UPDATE, "            _average_parameters(state,", "            _ = (state,")],
        [f"{UPDATE}:_average_parameters"],
    ),
    "robust weights": ([(PLUS, "knee=0.1", "knee=1e9")], []),
    "interval scale": ([(SCALE, "if record.compared == 0.0:", "if True:")], [SCALE]),
    "wild draws tamed": ([(FORECAST, "kept = part / whole *", "kept = 1.0 *")], []),
    "parameters moved to the prior": (
        [(FORECAST, "+ part * (begin", "+ 1.0 * (begin")],
        [],
    ),
    "error of the observer's start": (
        [(FORECAST, "START_WAVE_SD = 0.3", "START_WAVE_SD = 0.0")],
        [],
    ),
    "waves predicted": (
        [(FORECAST, "past_waves(known, rows, seen, out.past)", "out.past[:] = 0.0")],
        [f"{FORECAST}:past_waves", f"{WAVES}:forecast_waves", f"{WAVES}:fit_waves"],
    ),
    "waves by heading": (
        [
            (
                WAVES,
                "math.exp(0.5 * (math.cos(away) - 1.0) / HEADING_BANDWIDTH**2)",
                "1.0 + 0.0*away",
            )
        ],
        [],
    ),
    "waves drawn": (
        [(FORECAST, "    simulate_waves(", "    _ = (")],
        [f"{WAVES}:fit_sector_ar", f"{WAVES}:simulate_waves"],
    ),
    "low-frequency observer": (
        [
            (
                WINDOW,
                "min(OBSERVER_GAIN, OBSERVER_GAIN_SHIP",
                "min(1e3 * OBSERVER_GAIN, OBSERVER_GAIN_SHIP",
            )
        ],
        [f"{UPDATE}:_slow_step"],
    ),
    "current": (
        [(PLUS, "biased=True, current=True", "biased=True, current=False")],
        [],
    ),
    "wandering N_0 and N_mn": (
        [(SETTINGS, "if rough:\n        walking =", "if False:\n        walking =")],
        [],
    ),
    "noises of fixed pairs": (
        [
            (
                SETTINGS,
                "ROUGH_PROCESS_NOISE = 4.0\nROUGH_MEASUREMENT_NOISE = 0.5",
                "ROUGH_PROCESS_NOISE = ROUGH_MEASUREMENT_NOISE = 1.0",
            )
        ],
        [],
    ),
    "less push at rest": (
        [(SETTINGS, "REST_PROCESS_NOISE = 0.001", "REST_PROCESS_NOISE = 0.999")],
        [],
    ),
    "damping left to fixed pairs": ([(SETTINGS, "ROUGH_SHARE = 0.3", "ROUGH_SHARE = 0.1")], []),
    "wandering biases of tankers": (
        [(SETTINGS, 'WANDERING = ("E_north", "E_east", "N_0")', 'WANDERING = ("",)')],
        [],
    ),
    "wider prior of tankers": ([(SETTINGS, "PRIOR_INFLATION = 1.5", "PRIOR_INFLATION = 1.0")], []),
    "waves that move tankers": (
        [(SETTINGS, "NOISE = 0.3\nWAVE_PROCESS_NOISE = 10.0", "NOISE = WAVE_PROCESS_NOISE = 0.0")],
        [],
    ),
}
"""What replaces which lines, and the functions and files that would leave with them."""


def lines_of(places: list[str]) -> int:
    """Return how many lines files and functions (``file:function``) have."""
    total = 0
    for place in places:
        file, _, name = place.partition(":")
        text = (ROOT / file).read_text(encoding="utf-8")
        if not name:
            total += len(text.splitlines())
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef) and node.name == name:
                first = min([node.lineno, *(each.lineno for each in node.decorator_list)])
                total += node.end_lineno - first + 1
    return total


def forecasts(log, reference, boat, first: float, loss: float | None) -> dict[str, object]:
    """Return a twin's errors on a run: by forecast at the longest horizon, and in a loss."""
    from twin import Twin
    from twin.benchmark.scores import ELLIPSE_90, Reference, score
    from twin.digital_twin import known_plan

    truth, twin, due = Reference(reference), Twin(boat), first
    out: dict[str, object] = {"t": [], "error": [], "covered": [], "loss": None}
    dt = min(max(log.dt, 0.02), 0.25)
    for row, (t, z, cmd) in enumerate(log):
        twin.step(t, z.copy(), cmd.copy())
        if loss is not None and t >= loss:
            lost, loss, end = copy.deepcopy(twin), None, t + LOSS_S
            for k in range(row + 1, int(np.searchsorted(log.t, end))):
                lost.step(
                    log.t[k], np.where(np.arange(log.z.shape[1]) < 4, np.nan, log.z[k]), log.cmd[k]
                )
            now = lost.estimate()
            off = now.state[:2] - truth.at(np.array([now.t]))[0, :2]
            bound = ELLIPSE_90 * float(np.mean(np.square(now.sd[:2])))
            out["loss"] = [float(np.hypot(*off)), bool(off @ off <= bound)]
        times = t + np.array([0.0, *AT])
        if t < due - 1e-9 or not truth.known(times):
            continue
        while due <= t + 1e-9:
            due += EVERY_S
        one = score(
            twin.predict(known_plan(reference, row, AT[-1], dt), dt=dt), truth.at(times), AT
        )
        out["t"].append(t)
        out["error"].append(float(one.displacement[-1]))
        out["covered"].append(one.covered[:, -1].tolist())
    return out


def runs(seeds: list[int], logs: list[Path]) -> Iterator[tuple[str, Callable[[], dict]]]:
    """Return names of runs, and what scores each."""
    from twin.benchmark.loading import load_run, recorded_identify_s
    from twin.benchmark.protocol import Settings, Unit
    from twin.sim.bridge import particulars_of, prepare, sail
    from twin.sim.recorded import read_run
    from usv_gym import SensorSuite
    from usv_gym.world.faults import parse_faults
    from usv_gym.world.simulation import Simulation

    def simulated(vessel: str, manoeuvre: str, seed: int) -> dict:
        settings = Settings(vessel=vessel, hs=0.5, wind=4.5)
        run = load_run(settings, Unit(manoeuvre, "none", seed, "ukf", "", "none", "", "typical"))
        return forecasts(run.seen, run.reference, run.particulars, run.identify, 80.0)

    def changed(vessel: str, what: str, seed: int) -> dict:
        settings = Settings(vessel=vessel, hs=0.5, wind=4.5)
        boat, suite = settings.boat(seed), SensorSuite.grade("typical")
        # half of the thrust is .7 of the speed
        faults = parse_faults(f"left-scale=0.7:60@{CHANGED_S:g}", 0.0) if what == "thrust" else ()
        world = Simulation(1, boat, settings.sea(), suite=suite, faults=faults, dt=0.05)

        def stream(t: float, world: Simulation) -> None:
            if what == "current" and t >= CHANGED_S:
                world.weather["current_east"] = 1.0 if vessel == "usv75" else 0.5

        log = sail(prepare(world, "zigzag", 150.0, seed), stream)
        return forecasts(log.without_truth(), log, particulars_of(boat, suite), FIRST_S, None)

    def recorded(path: Path) -> dict:
        beside = sorted(path.parent.glob("*.toml"))
        log, boat = read_run(str(path), str(beside[0]) if beside else None)
        log = log.without_truth()
        return forecasts(log, log, boat, recorded_identify_s(log) + float(log.t[0]), None)

    for seed in seeds:
        for manoeuvre in ("turn", "zigzag", "turn-zigzag", "random"):
            yield f"usv75/{manoeuvre}/{seed}", lambda m=manoeuvre, s=seed: simulated("usv75", m, s)
        for manoeuvre in ("zigzag", "random"):
            yield f"otter/{manoeuvre}/{seed}", lambda m=manoeuvre, s=seed: simulated("otter", m, s)
        for vessel in ("usv75", "otter"):
            for what in ("thrust", "current"):
                yield (
                    f"{what} {vessel}/change/{seed}",
                    lambda v=vessel, w=what, s=seed: changed(v, w, s),
                )
    for path in logs:
        yield f"recorded/{path.parent.name}/{path.name}", lambda p=path: recorded(p)


def work(seeds: list[int], logs: list[Path]) -> None:
    """Print the score of each run, as a line of JSON."""
    for name, make in runs(seeds, logs):
        print(json.dumps([name, make()]), flush=True)


def compute(patches: list[Patch], out: Path, arguments: list[str]) -> dict[str, dict]:
    """Return the scores of all runs by a patched copy of the package."""
    tree = out / "tree"
    for package in ("twin", "usv_gym", "usv_kernel"):
        shutil.copytree(ROOT / package, tree / package, dirs_exist_ok=True)
    for file, old, new in patches:
        text = (tree / file).read_text(encoding="utf-8")
        if old not in text:
            raise SystemExit(f"{file} has no {old!r} any more: correct MECHANISMS")
        (tree / file).write_text(text.replace(old, new), encoding="utf-8")
    more = {"PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(out / "kernels"), "USV_TWIN_QUIET": "1"}
    done = subprocess.run(
        [sys.executable, __file__, "--work", *arguments],
        env={**os.environ, **more, "OPENBLAS_NUM_THREADS": "1"},
        cwd=tree,
        stdout=subprocess.PIPE,
        check=True,
        text=True,
    )
    return dict(map(json.loads, done.stdout.splitlines()))


def size(run: dict, after: bool) -> float:
    """Return a run's mean error, m: of all forecasts, or of those late after a change."""
    t, error = np.array(run["t"]), np.array(run["error"])
    late = (t >= CHANGED_S + AFTER_S) & (t < CHANGED_S + AFTER_S + 20.0)
    return float(error[late].mean() if after else error.mean())


def table(results: dict[str, dict[str, dict]]) -> str:
    """Return the table: change of the error in %, of coverage in points, of that in losses."""
    whole = results["nothing"]
    groups = [g for g in dict.fromkeys(name.split("/")[0] for name in whole)]
    lines = [
        f"| off | lines | {' | '.join(groups)} | in losses |",
        "|---|---|" + "---|" * (len(groups) + 1),
    ]
    for name, found in results.items():
        cells = []
        for group in groups:
            runs_of = [r for r in whole if r.startswith(group + "/") and found[r]["error"]]
            after = group.startswith(("thrust", "current"))
            ratio = [size(found[r], after) / size(whole[r], after) for r in runs_of]
            share = [np.mean(found[r]["covered"], axis=0) for r in runs_of]
            covered = " ".join(f"{100 * each:.0f}" for each in np.mean(share, axis=0))
            cells.append(f"{100 * (np.exp(np.mean(np.log(ratio))) - 1):+.1f} % ({covered})")
        lost = [r for r in whole if found[r]["loss"]]
        ratio = [found[r]["loss"][0] / whole[r]["loss"][0] for r in lost]
        inside = 100 * np.mean([found[r]["loss"][1] for r in lost])
        cells.append(f"{100 * (np.exp(np.mean(np.log(ratio))) - 1):+.1f} % ({inside:.0f})")
        count = lines_of(MECHANISMS[name][1]) if name in MECHANISMS else 0
        lines.append(f"| {name} | {count or '-'} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("logs", nargs="*", type=Path, help="recorded runs, particulars beside them")
    parser.add_argument("--seeds", default="3200-3211", help="of the simulated runs [3200-3211]")
    parser.add_argument("--out", type=Path, default=Path("ablation"), help="folder [ablation]")
    parser.add_argument("--only", nargs="*", default=[], help="mechanisms, by name")
    parser.add_argument("--work", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    first, _, last = given.seeds.partition("-")
    logs = [path.resolve() for path in given.logs]
    if given.work:
        work(list(range(int(first), int(last or first) + 1)), logs)
        return
    out = given.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    file = out / "results.json"
    results = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    for name in ("nothing", *(given.only or MECHANISMS)):
        if name not in results:
            patches = MECHANISMS[name][0] if name in MECHANISMS else []
            arguments = ["--seeds", given.seeds, *map(str, logs)]
            results[name] = compute(patches, out, arguments)
            file.write_text(json.dumps(results), encoding="utf-8")
        print(table({k: results[k] for k in ("nothing", name)}).splitlines()[-1], flush=True)
    print(table(results))


if __name__ == "__main__":
    main()
