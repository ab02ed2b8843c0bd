"""Tables 4 and 5 of docs/explanation/study.md, and what is kept of the results that they need.

``python tables.py`` prints the tables; ``python tables.py NAME FILE`` keeps the part of a whole
``results.json`` that docs and tests quote, as NAME.json beside this file (README.md has the names).
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from twin.files import results_text

HERE = Path(__file__).parent
SCENARIOS = ("turn", "zigzag", "turn-zigzag", "random")
FOLDERS = ("esso_osaka_frt", "kvlcc2_simman2008")
PLUS = "dsw-ukf-plus"


def read(name: str) -> dict[str, Any]:
    """Return the content of a file beside this one."""
    return dict(json.loads((HERE / name).read_text(encoding="utf-8")))


def kept(name: str, results: dict[str, Any]) -> dict[str, Any]:
    """Return what docs and tests quote of whole results; the values stay as they are."""
    heads = {key: results[key] for key in ("version", "command", "settings", "predictors")}
    if name == "recorded":
        return {**heads, "recorded": results["recorded"]}
    metrics = ("mae",) if name == "results" else ("mae", "E", "coverage90")
    predictors = list(results["predictors"]) if name == "results" else ["ukf", PLUS]
    rows = {
        key: [row for row in results[key] if row["predictor"] in predictors]
        for key in ("summary", "paired")
    }
    summary = [row for row in rows["summary"] if row["metric"] in metrics]
    if name == "full":
        return {**heads, "summary": summary, "paired": rows["paired"]}
    # tests compute the runs of the first boat again
    runs = [
        {key: value for key, value in row.items() if key != "curves"}
        for row in results["runs"]
        if row["seed"] == 0
    ]
    more = {key: results[key] for key in ("program", "notes", "verdict")}
    return {**heads, **more, "summary": summary, "runs": runs}


def full() -> list[str]:
    """Return a line for each case: E of the twin, and its MAE against that of ``ukf``."""
    results = read("full.json")
    excess = {
        (i["scenario"], i["case"]): i["value"]
        for i in results["summary"]
        if i["predictor"] == PLUS and i["metric"] == "E"
    }
    change = {
        (i["scenario"], i["case"]): i["change_percent"]
        for i in results["paired"]
        if i["predictor"] == PLUS
    }
    return [
        f"| {case} | "
        + " | ".join(f"{excess[s, case]:+.2f} / {change[s, case]:+.0f} %" for s in SCENARIOS)
        + " |"
        for case in dict.fromkeys(case for _, case in excess)
    ]


def recorded() -> list[str]:
    """Return a line for each predictor: ratios to raw persistence, and displacement to ``var``."""
    results = read("recorded.json")
    rows = {(i["folder"], i["predictor"], i["channel"]): i for i in results["recorded"]}
    lines = []
    for predictor in results["predictors"]:
        cells = []
        for folder in FOLDERS:
            place, heading = (rows[folder, predictor, key] for key in ("displacement", "psi"))
            cells += [
                f"{place['ratio']:.2f} ({place['geometric']:.2f})",
                f"{heading['ratio']:.2f} ({heading['geometric']:.2f})",
                "-"
                if predictor == "var"
                else f"{place['change_percent']:+.0f} "
                f"[{place['change_low']:+.0f}, {place['change_high']:+.0f}]",
            ]
        lines.append(f"| {predictor} | {' | '.join(cells)} |")
    return lines


if __name__ == "__main__":
    if len(sys.argv) == 3:
        name, file = sys.argv[1:]
        whole = json.loads(Path(file).read_text(encoding="utf-8"))
        (HERE / f"{name}.json").write_text(results_text(kept(name, whole)), encoding="utf-8")
    else:
        print("\n".join([*full(), "", *recorded()]))
