"""Train agents, evaluate them beside classical control on boats they never met, print the tables.

Ctrl-C keeps what is done; the same command goes on from there. See README.md.
"""

import argparse
import functools
import json
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from bootstrap import interval, iqm, replicates
from tables import markdown

from twin.agents.controllers import make_controller
from twin.agents.evaluation import EVALUATION_SEEDS, OUTAGES, SEAS, evaluate
from twin.agents.hyperparameters import hyperparameters
from twin.agents.training import CURVE_SEEDS, Plan, train
from twin.parallel import results_of

HERE = Path(__file__).resolve().parent

DRAWN = "|".join(SEAS)
"""One of the sea states, drawn for each episode."""

ANY = {"wind_from_deg": "any", "current": "any"}
"""Wind from any direction, and a current of up to 0.5 m/s to any."""

BOATS = tuple(range(920_000, 920_020))
"""Episodes of the conditions with boats that differ: no training and no curve has them."""

METRICS = ("off_path_m", "success", "length_s")


class Condition(NamedTuple):
    """Where agents are evaluated, with each loss of GPS."""

    text: str
    seas: tuple[str, ...]  # each has all episodes
    seeds: tuple[int, ...]  # of the episodes
    options: dict  # of the environment


def differing(text, **options):
    """Return a condition with boats that differ; a slow boat needs more than the usual 120 s."""
    return Condition(text, (DRAWN,), BOATS, {**ANY, "max_episode_steps": 480, **options})


CONDITIONS = {
    "protocol": Condition("the nominal boat, one wind, no current", SEAS, EVALUATION_SEEDS, {}),
    "spread 0": differing("the nominal boat, any wind and current"),
    "spread .15": differing("boats that differ by 15 %", vessel_spread=0.15),
    "spread .30": differing("boats that differ by 30 %, as in training", vessel_spread=0.3),
    "spread .45": differing("boats that differ by 45 %: held out", vessel_spread=0.45),
    "otter": differing("another vessel, spread .15: held out", vessel="otter", vessel_spread=0.15),
}

ARMS = (
    *("ppo-compact_raw", "ppo-compact", "ppo-compact_params", "ppo-compact_oracle"),
    *("ppo-residual-compact", "ppo-mpc-compact", "sac-compact", "recurrent_ppo-compact_raw"),
)
"""Agents that are trained: algorithm and observation set, parted by the last hyphen."""

PAIRS = (
    ("ppo-compact", "ppo-compact_raw"),
    ("ppo-compact_params", "ppo-compact"),
    ("ppo-compact", "ppo-compact_oracle"),
)
"""Sets that are compared: does the twin help, does what it identified, what does truth add?"""

SHOWN = ("spread .15", "gps30")
"""Condition and loss whose single episodes are kept for the shipped policies."""


class Study(NamedTuple):
    """A task, who sails it, and what counts in it."""

    metric: str  # of an episode
    statistic: str  # of the metric: iqm or mean
    better: int  # 1: more is better; -1: less is
    title: str
    controllers: tuple[str, ...]
    against: tuple[str, ...]  # controllers that each arm is compared with
    level: str  # controller whose level the learning curves are to reach
    arms: tuple[str, ...]
    conditions: tuple[str, ...]


STUDIES = {
    "path": Study(
        "off_path_m", "iqm", -1, "distance off the path, m (interquartile mean)",
        ("los", "los-twin", "mpc-twin", "mpc-steady", "los-oracle"), ("los-twin", "mpc-twin"),
        "los-twin", ARMS, tuple(CONDITIONS),
    ),
    "docking": Study(
        "success", "mean", 1, "share of episodes that end at rest in the berth",
        ("dock-twin", "dock-oracle"), ("dock-twin",), "dock-twin",
        tuple(arm for arm in ARMS if arm != "ppo-mpc-compact"), tuple(CONDITIONS)[1:],
    ),
}  # fmt: skip


def plan_of(task, arm, seed, steps=None):
    """Return the plan of one training; ``steps`` are those of the hyperparameters if left out."""
    algo, _, observation = arm.rpartition("-")
    steps = steps or hyperparameters(algo)["n_timesteps"]
    return Plan(
        algo, observation, steps, seed, task=task, every=min(65_536, -(-steps // 8)),
        vessel_spread=0.3, world=ANY, sea=DRAWN, faults="|".join(OUTAGES),
    )  # fmt: skip


def sailed(task, folder, name, seed, steps, conditions):
    """Train one agent, or make a controller (``seed`` is None), and return its episodes.

    What an earlier call has trained or evaluated in the folder is used again.
    """
    place = folder / "runs" / (name if seed is None else f"{name}-{seed}")
    made = {}
    if seed is None:
        agent = make_controller(name)
    else:
        run = train(plan_of(task, name, seed, steps), place, curve_seeds=CURVE_SEEDS)
        agent, made["curve"] = run.policy, run.curve
    asked = json.loads(json.dumps([conditions, OUTAGES]))
    file = place / "evaluation.json"
    if file.exists():
        before = json.loads(file.read_text(encoding="utf-8"))
        if before["asked"] == asked:
            return {**before, **made}
    made |= {"asked": asked, "rows": []}
    for condition, (_, seas, seeds, options) in conditions.items():
        for sea in seas:
            for faults in OUTAGES:
                rows = evaluate(
                    agent, seeds=seeds, sea=sea, faults=faults, task=task, forecast_scores=False,
                    **options,
                )  # fmt: skip
                where = {"condition": condition, "sea": sea, "faults": faults}
                made["rows"].append(where | {key: [row[key] for row in rows] for key in METRICS})
    study = STUDIES[task]
    if name == study.level:
        environment = plan_of(task, study.arms[0], 0).environment | {"forecast_scores": False}
        rows = evaluate(agent, seeds=CURVE_SEEDS, **environment)
        made["level"] = float(np.mean([row[study.metric] for row in rows]))
    place.mkdir(parents=True, exist_ok=True)
    part = place / "evaluation.part"
    part.write_text(json.dumps(made), encoding="utf-8")
    part.replace(file)
    return made


def collect(study, conditions, done):
    """Return all that the study found: estimates, paired differences, trainings, some episodes.

    ``done`` has what :func:`sailed` returned by name and seed.
    """
    cells, paired = [], []
    for condition in conditions:
        for faults in (*OUTAGES, "all"):
            where = {"condition": condition, "faults": faults}
            made, drawn = estimates(study, done, where)
            cells += made
            value = {cell["agent"]: cell[study.metric] for cell in made}
            for agent, other in pairs(study, value):
                low, high = interval(drawn[agent] - drawn[other])
                difference = value[agent] - value[other]
                row = {"agent": agent, "against": other, **where}
                paired.append(row | {"difference": difference, "low": low, "high": high})
    level = done[study.level, None]["level"]
    trained = {piece: made["curve"] for piece, made in done.items() if piece[1] is not None}
    return {
        "level": level,
        "cells": cells,
        "paired": paired,
        "trainings": [ended(study, *piece, curve, level) for piece, curve in trained.items()],
        "episodes": [
            {"agent": name, "seed": seed, **row}
            for name, seed in middle_runs(study, done)
            for row in done[name, seed]["rows"]
            if (row["condition"], row["faults"]) == SHOWN
        ],
    }


def pairs(study, agents):
    """Return the pairs that are compared, of agents that there are."""
    found = [(arm, controller) for controller in study.against for arm in study.arms]
    return [pair for pair in (*found, *PAIRS) if {*pair} <= set(agents)]


def estimates(study, done, where):
    """Return a row for each agent, and bootstrap samples of what they are compared by."""
    statistic = {"iqm": iqm, "mean": functools.partial(np.mean, axis=-1)}[study.statistic]
    names = dict.fromkeys(name for name, _seed in done)
    scores = {name: scores_of(study.metric, done, name, where) for name in names}
    drawn = replicates(scores, statistic)
    rows = [
        {
            **{"agent": name, **where, study.metric: float(statistic(values.ravel()))},
            "ends": interval(drawn[name]),
        }
        for name, values in scores.items()
    ]
    return rows, drawn


def scores_of(metric, done, name, where):
    """Return the scores of an agent, shape (strata, runs, episodes).

    Strata are sea states, with all losses those of each.
    """
    runs = []
    for (agent, _seed), made in done.items():
        if agent == name:
            rows = [row for row in made["rows"] if row["condition"] == where["condition"]]
            rows = [row for row in rows if where["faults"] in ("all", row["faults"])]
            rows.sort(key=lambda row: OUTAGES.index(row["faults"]))  # then as they came, by sea
            runs.append([row[metric] for row in rows])
    return np.array(runs, float).swapaxes(0, 1)


def ended(study, name, seed, curve, level):
    """Return how a training went: its end, and when it first was at the level of the controller."""
    there = [row for row in curve if study.better * (row[study.metric] - level) >= 0.0]
    last = {"decisions": int(curve[-1]["decisions"]), "cpu_s": curve[-1]["cpu_s"]}
    row = {"agent": name, "seed": seed, **last, "end": curve[-1][study.metric]}
    row["level_decisions"] = int(there[0]["decisions"]) if there else None
    row["level_cpu_s"] = there[0]["cpu_s"] if there else None
    return row


def middle_runs(study, done):
    """Return name and seed of each controller, and of the middle run of each arm."""
    found = [(name, None) for name in study.controllers]
    for arm in study.arms:
        runs = [piece for piece in done if piece[0] == arm]
        order = sorted(
            runs,
            key=lambda run: np.mean([x for row in done[run]["rows"] for x in row[study.metric]]),
        )
        found += order[len(order) // 2 : len(order) // 2 + 1]
    return found


def rounded(value):
    """Return JSON data with its fractions rounded to 4 figures."""
    if isinstance(value, dict):
        return {key: rounded(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(one) for one in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value


def run(task, out, jobs, quick):
    """Do what is not done yet of a study, and write its results and policies."""
    study, steps = STUDIES[task], None
    conditions = {name: CONDITIONS[name] for name in study.conditions}
    seeds = range(8)
    if quick:  # so small a study shows only that everything runs
        study, seeds, steps = study._replace(arms=study.arms[:2]), range(2), 8192
        conditions = {"spread .15": CONDITIONS["spread .15"]._replace(seeds=BOATS[:2])}
    pieces = [(name, None) for name in study.controllers]
    pieces += [(arm, seed) for seed in seeds for arm in study.arms]
    calls = [functools.partial(sailed, task, out, *piece, steps, conditions) for piece in pieces]
    done, begun = {}, time.monotonic()
    for i, made in results_of(calls, jobs=jobs):
        done[pieces[i]] = made
        name, minutes = " ".join(map(str, pieces[i])), (time.monotonic() - begun) / 60.0
        print(f"{task} {len(done)} of {len(pieces)}: {name}, {minutes:.1f} min", flush=True)
    done = {piece: done[piece] for piece in pieces}
    texts = {name: condition.text for name, condition in conditions.items()}
    about = {"task": task, "metric": study.metric, "title": study.title, "better": study.better,
             "level_of": study.level, "conditions": texts, "losses": OUTAGES}  # fmt: skip
    results = rounded({**about, **collect(study, conditions, done)})
    (out / "policies").mkdir(exist_ok=True)
    for name, seed in middle_runs(study, done):
        if seed is not None:
            policy = (out / "runs" / f"{name}-{seed}" / "policy.npz").read_bytes()
            (out / "policies" / f"{name}.npz").write_bytes(policy)
    (out / "results.json").write_text(lines_of(results), encoding="utf-8")
    return results


def lines_of(results):
    """Return JSON with a line for each row."""
    parts = []
    for key, value in results.items():
        text = json.dumps(value)
        if isinstance(value, list) and isinstance(value[0], dict):
            text = "[\n" + ",\n".join(map(json.dumps, value)) + "\n]"
        parts.append(f"{json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", help=f"of {', '.join(STUDIES)}; all by default")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, default=HERE, help="folder of the results")
    parser.add_argument("--quick", action="store_true", help="only check that everything runs")
    parser.add_argument("--tables", action="store_true", help="print the results that are there")
    given = parser.parse_args()
    for task in given.tasks or STUDIES:
        out = given.out / task
        try:
            if given.tables:
                results = json.loads((out / "results.json").read_text(encoding="utf-8"))
            else:
                results = run(task, out, given.jobs, given.quick)
        except KeyboardInterrupt:
            sys.exit(f"stopped; the same command goes on from {out}")
        print(markdown(results))


if __name__ == "__main__":
    main()
