"""Print the tables of README.md from the measurements that lie beside this file."""

from __future__ import annotations

import json
from itertools import groupby
from pathlib import Path
from typing import Any

from twin.performance.cases import CASES, FIRST_USES, fit

HERE = Path(__file__).parent


def number(value: float) -> str:
    """Return three digits, or all before the point."""
    return f"{value:,.0f}".replace(",", " ") if value >= 100 else f"{value:.3g}"


def row(cells: list[str]) -> str:
    """Return a line of a Markdown table."""
    return f"| {' | '.join(cells)} |"


def beside_peers() -> list[str]:
    """Return the lines of the table of cases."""
    must = {
        case.name: ", ".join(
            [
                *([f"{case.must / 1000:.0f} k"] if case.must else []),
                *([f"{case.must_ratio:g} x"] if case.must_ratio else []),
            ]
        )
        for case in CASES
    }
    lines = []
    for item in json.loads((HERE / "bench.json").read_text(encoding="utf-8")):
        if item["median_us"] is None:
            kilobytes = f"{item['bytes'] / 1000:.0f} kB"
            lines.append(row([item["name"], kilobytes, "", "", "", ""]))
            continue
        if item["name"] in FIRST_USES:
            limit = FIRST_USES[item["name"]][1]
            most = "" if limit is None else f"at most {limit:g} s"
            lines.append(row([item["name"], f"{item['median_us'] / 1e6:.1f} s", "", "", "", most]))
            continue
        ratio = "" if item["ratio"] is None else f"{item['ratio']:.3g}"
        rate = number(item["rate_per_s"])
        cells = [item["name"], number(item["median_us"]), rate, ratio, item["relative_to"] or ""]
        lines.append(row([*cells, must.get(item["name"], "")]))
    return lines


def growing() -> list[str]:
    """Return the lines about how each cost grows."""
    measured: list[dict[str, Any]] = json.loads((HERE / "growth.json").read_text(encoding="utf-8"))
    lines = []
    for name, items in groupby(measured, key=lambda item: item["name"]):
        points = list(items)
        of = points[0]["size_of"]
        line = fit([p["size"] for p in points], [p["median_us"] for p in points])
        lines += [f"**{name}**, against {of}: {line.told(of)}.", ""]
        lines += [row([of, *(str(p["size"]) for p in points)]), "|---" * (len(points) + 1) + "|"]
        lines += [row(["us", *(number(p["median_us"]) for p in points)]), ""]
    return lines


if __name__ == "__main__":
    print("\n".join([*beside_peers(), "", *growing()]))
