"""Print tables 1 to 3 of docs/explanation/study.md from the results beside this file."""

from __future__ import annotations

import json
from pathlib import Path

HERE = Path(__file__).parent
SCENARIOS = ("turn", "zigzag", "turn-zigzag", "random")
CHANNELS = ("u", "v", "r", "psi", "along", "across", "displacement")


def row(first: str, cells: list[str]) -> str:
    """Return a line of a Markdown table."""
    return f"| {first} | {' | '.join(cells)} |"


def lines() -> list[str]:
    """Return every line of the tables but their heads."""
    results, other = (
        json.loads((HERE / f"{name}.json").read_text(encoding="utf-8"))
        for name in ("results", "class_unknown")
    )
    for key in ("predictors", "summary", "paired"):
        results[key] += other[key]
    value = {(i["scenario"], i["predictor"], i["metric"]): i for i in results["summary"]}
    out = []
    for predictor in results["predictors"]:
        cells = []
        for scenario in SCENARIOS:
            mae, excess, each = (
                value[scenario, predictor, metric] for metric in ("mae", "E", "E_runs")
            )
            cells.append(
                f"{mae['value']:.3f} / {mae['median']:.3f} / {excess['value']:+.2f} / "
                f"{each['value']:+.2f} / {each['median']:+.2f}"
            )
        out.append(row(predictor, cells))
    paired = {(i["scenario"], i["predictor"], i["against"]): i for i in results["paired"]}
    for predictor, against in dict.fromkeys(key[1:] for key in paired):
        cells = [
            f"{i['change_percent']:+.0f} [{i['low']:+.0f}, {i['high']:+.0f}], {i['wins']}"
            for i in (paired[scenario, predictor, against] for scenario in SCENARIOS)
        ]
        out.append(row(f"{predictor} against {against}", cells))
    inside = {(i["scenario"], i["channel"], i["horizon_s"]): i for i in results["channels"]}
    for channel in CHANNELS:
        cells = [
            " ".join(
                f"{100 * inside[scenario, channel, h]['coverage90']:.0f}" for h in (1, 2, 5, 10)
            )
            for scenario in SCENARIOS
        ]
        out.append(row(channel, cells))
    return out


if __name__ == "__main__":
    print("\n".join(lines()))
