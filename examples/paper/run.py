"""Redo the paper of Qu et al. 2025: its two manoeuvres, its methods and their neighbours.

Ctrl-C keeps the forecasts that are finished; the same command goes on from there.
"""

import argparse
import functools
import json
from pathlib import Path

import numpy as np
from findings import METHODS, Trace, contests, findings, paper_rows
from page import draw_forecast, draw_parameters, draw_window, table_4, write_page

from twin import Twin
from twin.benchmark import runner
from twin.benchmark.loading import load_run
from twin.benchmark.protocol import Settings, available, units
from twin.identification.dynamic_window import LATERAL_LIMIT
from twin.parallel import results_of
from usv_kernel.channels import ACCEL_Y

PREDICTORS = (*METHODS, "ukf", "dsw-ukf-plus", "persistence")

TRACED = ("dsw-ukf:printed", "dsw-ukf", "dsw-ukf:window=off")
"""Predictors whose parameters and windows are followed."""

DRAWN = (*TRACED, "lstm", "dsw-ukf-plus")
"""Predictors in the pictures of a forecast: all of them would hide each other."""


def trace(settings, unit):
    """Follow a filter of the paper along a run."""
    run = load_run(settings, unit)
    twin = Twin(run.particulars, unit.predictor, seed=unit.seed)
    window, moving = twin.predictor.window, twin.predictor.use == "dynamic"
    rows, due, lateral = [], float(run.seen.t[0]), False
    for t, z, cmd in run.seen:
        twin.step(t, z.copy(), cmd.copy())
        lateral = lateral or abs(z[ACCEL_Y]) > LATERAL_LIMIT
        if t >= due - 1e-9:
            due += 1.0
            length = window.W if moving else 0
            short = window.T < 10.0
            rows.append((t, twin.estimate().params, length, window.V, window.S, short, lateral))
            lateral = False
    return Trace(*map(np.array, zip(*rows, strict=True)), window.base, window.cap)


def traces(settings, jobs):
    """Return the traces of all runs without a fault, by scenario and predictor, in seed order."""
    work = [unit for unit in units(settings) if unit.fault == "none" and unit.predictor in TRACED]
    calls = [functools.partial(trace, settings, unit) for unit in work]
    found, groups = dict(results_of(calls, jobs=jobs)), {}
    for k, unit in enumerate(work):
        groups.setdefault((unit.scenario, unit.predictor), []).append(found[k])
    return groups


def pictures(settings, done, traced):
    """Return the pictures of the page by name, those of runs for the first seed."""
    drawn, start = {}, settings.identify_s
    for scenario in settings.scenarios:
        parts = {name: group[0] for (sailed, name), group in traced.items() if sailed == scenario}
        windows = {name: part for name, part in parts.items() if part.window.any()}
        drawn[f"{scenario}_window"] = draw_window(scenario, windows, start)
        for name, part in parts.items():
            file = f"{scenario}_{name.replace(':', '_').replace('=', '_')}"
            drawn[file] = draw_parameters(scenario, name, part, start)
        first = (scenario, "none", settings.seeds[0])
        here = [unit for unit in done if (unit.scenario, unit.fault, unit.seed) == first]
        plan = settings.plans[0]
        made = {u.predictor: done[u]["examples"][plan] for u in here if u.predictor in DRAWN}
        examples = {name: found[0] for name, found in made.items()}
        truth = load_run(settings, here[0]).reference
        drawn[f"{scenario}_forecast"] = draw_forecast(scenario, examples, truth)
    return drawn


def redo(settings, out, jobs):
    """Sail, score and follow everything; write the page and the rows to a folder."""
    out.mkdir(parents=True, exist_ok=True)
    runner.warm_up(settings, jobs=jobs)
    found, work = {}, units(settings)
    for unit, result in runner.runs(settings, out, jobs=jobs):
        found[unit] = result
        print(f"\r{len(found)} of {len(work)} results", end="", flush=True)
    print()
    done = {u: found[u] for u in work if not isinstance(found[u], Exception)}
    for unit in set(found) - set(done):
        print(f"not scored: {unit.run} {unit.predictor}: {found[unit]}")
    results = list(done.values())
    traced = traces(settings, jobs)
    rows, found = paper_rows(settings, results, traced), contests(results)
    sentences = findings(rows, found)
    print("MAE [95 % interval] / the paper", table_4(rows, "MAE"), *sentences, sep="\n")
    text = json.dumps([row._asdict() for row in rows], indent=1)
    (out / "rows.json").write_text(text + "\n", encoding="utf-8")
    print(write_page(out, rows, sentences, found, pictures(settings, done, traced)))


def main():
    """Read the options, and redo the paper."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--boats", type=int, default=8, help="at least 3, for an interval")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("paper"))
    given = parser.parse_args()
    names, notes = available(PREDICTORS)
    print(*notes, sep="\n", end="\n" if notes else "")
    seeds = tuple(range(given.boats))
    redo(Settings(plans=("known",), seeds=seeds, predictors=names), given.out, given.jobs)


if __name__ == "__main__":
    main()
