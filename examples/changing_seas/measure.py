"""What an anemometer and the paper's window are worth, in steady seas and in seas that change.

Prints the tables of docs/explanation/study.md: ratios of mean errors, with over without. Each is
sailed in a turn and a zigzag by every boat; brackets are 95 % bootstrap intervals over boats.
"""

import argparse
import dataclasses
import functools
import json
from pathlib import Path

import numpy as np

from twin import Log, Twin, known_plan
from twin.benchmark.protocol import Settings
from twin.benchmark.scores import Reference, score
from twin.parallel import results_of
from twin.particulars import Particulars
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SensorSuite

FIRST_SEED = 300
CASES = {
    "anemometer": ("0", "2", "3", "4", "squall", "building"),
    "window": ("2", "squall", "building"),
}
PREDICTORS = {
    "anemometer": ("ukf", "ukf:model=mmg", "dsw-ukf", "dsw-ukf-plus"),
    "window": ("dsw-ukf",),
}
HORIZONS = (2.0, 10.0)
CHANNELS = ("displacement", "heading", "velocity")


def mean_errors(log: Log, boat: Particulars, predictor: str) -> np.ndarray:
    """Return the mean errors (2, 3) of forecasts by horizon and channel, one every second."""
    twin, reference, errors = Twin(boat, predictor), Reference(log), []
    for row, (t, z, cmd) in enumerate(log.without_truth()):
        twin.step(t, z, cmd)
        if 80.0 <= t <= log.t[-1] - 10.0 and row % round(1.0 / log.dt) == 0:
            forecast = twin.predict(known_plan(log, row, 10.0, 0.25), dt=0.25)
            truth = reference.at(t + np.array([0.0, *HORIZONS]))
            found = score(forecast, truth, HORIZONS)
            heading, velocity = np.abs(found.error[:, 5]), np.hypot(*found.error[:, :2].T)
            errors.append(np.stack([found.displacement, heading, velocity], axis=1))
    return np.mean(errors, axis=0)


def sail(question: str, case: str, scenario: str, seed: int) -> list[dict[str, object]]:
    """Return the errors of each predictor with and without what is in question."""
    settings = Settings()
    vessel, found = settings.boat(seed), []
    suite = SensorSuite.grade("best" if question == "anemometer" else "typical")
    log = simulate(
        scenario, vessel=vessel, sea=settings.sea(case), duration=120.0, seed=seed, suite=suite
    )
    for predictor in PREDICTORS[question]:
        if question == "anemometer":
            without = dataclasses.replace(suite, wind_rate=0.0)
            z = log.z.copy()
            z[:, 17:] = np.nan
            off = mean_errors(
                dataclasses.replace(log, z=z), particulars_of(vessel, without), predictor
            )
        else:
            off = mean_errors(log, particulars_of(vessel, suite), f"{predictor}:window=off")
        on = mean_errors(log, particulars_of(vessel, suite), predictor)
        found.append(
            {
                **{"question": question, "case": case, "scenario": scenario, "seed": seed},
                **{"predictor": predictor, "with": on.tolist(), "without": off.tolist()},
            }
        )
    return found


def table(rows: list[dict[str, object]]) -> None:
    """Print the ratios of each question, predictor and case."""
    rng = np.random.default_rng(0)
    heads = [f"{channel}, {h:g} s" for h in HORIZONS[::-1] for channel in CHANNELS]
    for question, cases in CASES.items():
        for predictor in PREDICTORS[question]:
            print(f"\n{question}, {predictor}\n\n| case | {' | '.join(heads)} |")
            print("|---" * (1 + len(heads)) + "|")
            for case in cases:
                here = [
                    row
                    for row in rows
                    if (row["question"], row["predictor"], row["case"])
                    == (question, predictor, case)
                ]
                seeds = sorted({row["seed"] for row in here})
                on, off = (
                    np.array(
                        [
                            np.mean([row[key] for row in here if row["seed"] == seed], axis=0)
                            for seed in seeds
                        ]
                    )[:, ::-1].reshape(len(seeds), -1)
                    for key in ("with", "without")
                )
                drawn = rng.integers(0, len(seeds), (2000, len(seeds)))
                ratios = on[drawn].mean(axis=1) / off[drawn].mean(axis=1)
                low, high = np.percentile(ratios, [2.5, 97.5], axis=0)
                middle = on.mean(axis=0) / off.mean(axis=0)
                cells = [
                    f"{m:.3f} [{a:.2f}, {b:.2f}]" for m, a, b in zip(middle, low, high, strict=True)
                ]
                print(f"| {case} | {' | '.join(cells)} |")


def main() -> None:
    """Sail what is not sailed yet, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--boats", type=int, default=8)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("results.jsonl"))
    given = parser.parse_args()
    rows = (
        [json.loads(line) for line in given.out.read_text().splitlines()]
        if given.out.exists()
        else []
    )
    there = {(row["question"], row["case"], row["scenario"], row["seed"]) for row in rows}
    todo = [
        (question, case, scenario, seed)
        for seed in range(FIRST_SEED, FIRST_SEED + given.boats)
        for question, cases in CASES.items()
        for case in cases
        for scenario in ("turn", "zigzag")
        if (question, case, scenario, seed) not in there
    ]
    with given.out.open("a") as file:
        calls = [functools.partial(sail, *one) for one in todo]
        for done, (_, found) in enumerate(results_of(calls, jobs=given.jobs), 1):
            rows += found
            file.writelines(json.dumps(row) + "\n" for row in found)
            file.flush()
            print(f"\r{done} of {len(todo)} runs", end="", flush=True)
    table([row for row in rows if row["seed"] < FIRST_SEED + given.boats])


if __name__ == "__main__":
    main()
