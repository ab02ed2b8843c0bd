"""One line for each predictor: errors after 10 s, without and with a loss, and over persistence."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.benchmark.metrics import BASELINE, ORACLE, interval_of, resampled
from twin.benchmark.protocol import TYPICAL, Settings

__all__ = ["ORACLE", "best_first", "recorded_blocks", "scope_of", "sentence_of", "verdict_rows"]

Row = Mapping[str, Any]

Array = NDArray[np.float64]

ERRORS = ("displacement_10s", "psi_10s", "mae", "mse")
"""Entries of a run that the verdict averages."""

DEGREES = 180.0 / math.pi


def verdict_rows(runs: Sequence[Row], settings: Settings) -> list[dict[str, Any]]:
    """Return the verdict on simulated runs: rows without, with and of all losses, best first.

    Runs in other seas and with other sensors than the settings' own are left out, where there are
    both. Of several plans the first counts. Each row is the mean over scenarios, cases and boats:

    - ``loss``: "none" or "any" for runs without and with a loss of a sensor, "all" for both;
    - ``position_m``, ``heading_deg``: mean absolute error after 10 s;
    - ``ratio``: mean of the two, each over that of persistence on the same runs;
    - ``mae``, ``mse``: pooled as in the paper's Table 4, units mixed;
    - ``_low`` and ``_high`` behind each name: the 95 % bootstrap interval over boats;
    - ``wins``: in so many runs the position is nearer than that of the ``next`` predictor;
    - ``plan``, ``scenarios``, ``cases``: what it is the mean of.

    The order is that of ``ratio`` over all runs, or of ``position_m`` without persistence. The
    oracle, which knows the true boat, comes last.
    """
    runs = [row for row in runs if row["plan"] == settings.plans[0]]
    nominal = [row for row in runs if (row["sea"], row["grade"]) == (settings.sea_name, TYPICAL)]
    runs = nominal or runs
    groups = {
        "none": [row for row in runs if row["fault"] == "none"],
        "any": [row for row in runs if row["fault"] != "none"],
        "all": runs,
    }
    rows = [
        {"predictor": name, "loss": loss, "plan": settings.plans[0], **_errors(name, group)}
        for name in dict.fromkeys(row["predictor"] for row in runs)
        for loss, group in groups.items()
        if any(row["predictor"] == name for row in group)
    ]
    key = "ratio" if all(row["ratio"] is not None for row in rows) else "position_m"
    order = {row["predictor"]: row[key] for row in rows if row["loss"] == "all"}
    rows.sort(key=lambda row: (row["predictor"] == ORACLE, order[row["predictor"]]))
    names = [name for name in dict.fromkeys(row["predictor"] for row in rows) if name != ORACLE]
    after = dict(itertools.pairwise(names))
    for row in rows:
        row["next"] = after.get(row["predictor"])
        row["wins"] = _wins(groups[row["loss"]], row["predictor"], row["next"])
    return rows


def _wins(runs: Sequence[Row], name: str, other: str | None) -> int:
    """Return on how many runs a predictor's position is nearer than that of another one."""
    own, its = (
        {
            (row["scenario"], row["case"], row["seed"]): row["displacement_10s"]
            for row in runs
            if row["predictor"] == predictor
        }
        for predictor in (name, other)
    )
    return sum(own[run] < its[run] for run in own if run in its)


def _errors(name: str, runs: Sequence[Row]) -> dict[str, Any]:
    """Return the mean errors of one predictor on some runs, with intervals over boats."""
    own, base = (_by_boat(runs, predictor) for predictor in (name, BASELINE))
    scale = np.array([1.0, DEGREES, 1.0, 1.0])
    means, draws = scale * own.mean(axis=0), scale * resampled(own)
    found: dict[str, Any] = {
        "runs": sum(row["predictor"] == name for row in runs),
        "scenarios": list(dict.fromkeys(row["scenario"] for row in runs)),
        "cases": list(dict.fromkeys(row["case"] for row in runs)),
    }
    for k, key in enumerate(("position_m", "heading_deg", "mae", "mse")):
        low, high = interval_of(draws[:, k], len(own))
        found |= {key: float(means[k]), f"{key}_low": low, f"{key}_high": high}
    found |= {"ratio": None, "ratio_low": None, "ratio_high": None}
    if base.shape == own.shape:
        base = np.maximum(base, 1e-12)
        ratio = (own.mean(axis=0) / base.mean(axis=0))[:2].mean()
        low, high = interval_of((resampled(own) / resampled(base))[:, :2].mean(axis=1), len(own))
        found |= {"ratio": float(ratio), "ratio_low": low, "ratio_high": high}
    return found


def _by_boat(runs: Sequence[Row], predictor: str) -> Array:
    """Return the errors (boats, 4) of one predictor, each the mean over scenarios and cases."""
    boats: dict[int, list[list[float]]] = {}
    for row in runs:
        if row["predictor"] == predictor:
            boats.setdefault(row["seed"], []).append([row[name] for name in ERRORS])
    return np.array([np.mean(boats[seed], axis=0) for seed in sorted(boats)])


def scope_of(row: Row) -> str:
    """Return of which scenarios, losses and future commands a row of the verdict is the mean."""
    cases = ["no loss" if case == "none" else case for case in row.get("cases", ())]
    names = [" and ".join(part) for part in (row.get("scenarios", ()), cases) if part]
    plan = {"hold": "held"}.get(row.get("plan", ""), "known")
    return ", ".join([*names, f"future commands {plan}"])


def sentence_of(verdict: Sequence[Row]) -> str:
    """Return the verdict in one sentence; empty where nothing was simulated."""
    names = list(dict.fromkeys(row["predictor"] for row in verdict if row["predictor"] != ORACLE))
    if not names:
        return ""
    of = {row["loss"]: row for row in verdict if row["predictor"] == names[0]}
    first = of.get("none") or of["all"]
    text = (
        f"10 s ahead {names[0]} is {first['position_m']:.2f} m and {first['heading_deg']:.1f} deg "
        f"off in the mean ({scope_of(of['all'])})"
    )
    if "none" in of and "any" in of:
        loss = of["any"]
        text += f", with a loss {loss['position_m']:.2f} m and {loss['heading_deg']:.1f} deg"
    every = of["all"]
    if every["ratio"] is not None and names[0] != BASELINE:
        between = ""
        if every["ratio_low"] is not None:
            between = f" [{every['ratio_low']:.2f}, {every['ratio_high']:.2f}]"
        text += f": {every['ratio']:.2f}{between} of persistence"
    if every["next"]:
        text += (
            f"; nearer than {every['next']}, the next, in {every['wins']} of {every['runs']} runs"
        )
    return f"{text}."


def recorded_blocks(results: Row) -> dict[str, dict[str, dict[str, Row]]]:
    """Return what is said first of recorded runs: by title, predictor and channel.

    ``results`` is the content of ``results.json``. A table is of one folder and case, with the
    first plan. Beside the channels ``displacement`` and ``psi`` stands ``loss``, the row on the
    ends of losses; it is empty without a loss.
    """
    rows = results.get("recorded") or []
    ends = {
        (row["folder"], row["fault"], row["predictor"]): row for row in results.get("losses") or []
    }
    blocks: dict[str, dict[str, dict[str, Row]]] = {}
    runs: dict[tuple[str, str], int] = {}
    for row in rows:
        here = row["folder"], row["fault"]
        runs[here] = max(row["runs"], runs.get(here, 0))
    for row in rows:
        if row["plan"] != rows[0]["plan"]:
            continue
        here = row["folder"], row["fault"]
        own, every = runs[here], sum(n for key, n in runs.items() if key[1] == row["fault"])
        count = f"{own} run{'s' * (own > 1)}" if own == every else f"{own} of {every} runs"
        loss = "no loss" if row["fault"] == "none" else f"loss {row['fault']}"
        title = f"folder {row['folder']}: {count}, {loss}, plan {row['plan']}"
        block = blocks.setdefault(title, {})
        found = block.setdefault(
            row["predictor"], {"loss": ends.get((*here, row["predictor"]), {})}
        )
        found[row["channel"]] = row
    return blocks


def best_first(block: Mapping[str, Mapping[str, Row]]) -> list[str]:
    """Return the predictors of a table of recorded runs, the smallest ratio first."""

    def size(name: str) -> tuple[float, float]:
        rows = [block[name][channel] for channel in ("displacement", "psi")]
        ratios = [row.get("ratio", math.inf) for row in rows]
        return sum(ratios), rows[0]["error"]

    return sorted(block, key=size)
