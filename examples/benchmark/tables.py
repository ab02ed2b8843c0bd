"""Print tables 4 and 5 of docs/explanation/study.md: full protocol and recorded runs.

The numbers lie beside this file. Those of the full protocol were made by::

    usv-twin benchmark --full --jobs 2 --out full \
        --predictors persistence,persistence-8s,var,ukf,dsw-ukf-plus,oracle

and those of the recorded runs, which are not part of the project, by::

    usv-twin benchmark --plans known --out recorded \
        --predictors persistence,persistence-8s,var,ukf,dsw-ukf,dsw-ukf-plus \
        --log ../shared/data/esso_osaka_frt/*.csv.gz ../shared/data/kvlcc2_simman2008/*.csv.gz

Only what the tables need is kept of either ``results.json``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
SCENARIOS = ("turn", "zigzag", "turn-zigzag", "random")
FOLDERS = ("esso_osaka_frt", "kvlcc2_simman2008")
PLUS = "dsw-ukf-plus"


def read(name: str) -> dict[str, Any]:
    """Return the content of a file beside this one."""
    return dict(json.loads((HERE / name).read_text(encoding="utf-8")))


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
    print("\n".join([*full(), "", *recorded()]))
