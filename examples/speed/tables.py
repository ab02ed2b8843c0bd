"""Print the tables of README.md from the measurements that lie beside this file."""

from __future__ import annotations

import json
import runpy
from itertools import groupby
from pathlib import Path
from typing import Any

from twin.performance.cases import CASES, COLD_COMPILES

HERE = Path(__file__).parent
GROWTH = runpy.run_path(str(HERE / "growth.py"))


def number(value: float) -> str:
    """Return three digits, or all before the point."""
    return f"{value:,.0f}".replace(",", " ") if value >= 100 else f"{value:.3g}"


def row(cells: list[str]) -> str:
    """Return a line of a Markdown table."""
    return f"| {' | '.join(cells)} |"


def read(name: str) -> list[dict[str, Any]]:
    """Return the rows of a file of measurements."""
    return list(json.loads((HERE / name).read_text(encoding="utf-8")))


def with_peers() -> list[str]:
    """Return the lines of the table of cases."""
    targets = {}
    for case in CASES:
        parts = [f"{case.target / 1000:.0f} k"] if case.target else []
        parts += [f"{case.target_ratio:g} x"] if case.target_ratio else []
        targets[case.name] = ", ".join(parts)
    lines = []
    for item in read("bench.json"):
        name = item["name"]
        if item["median_us"] is None:
            cells = [f"{item['bytes'] / 1000:.0f} kB", "", "", "", ""]
        elif name in COLD_COMPILES:
            limit = COLD_COMPILES[name][1]
            at_most = "" if limit is None else f"at most {limit:g} s"
            cells = [f"{item['median_us'] / 1e6:.1f} s", "", "", "", at_most]
        else:
            ratio = "" if item["ratio"] is None else f"{item['ratio']:.3g}"
            times = [number(item["median_us"]), number(item["rate_per_s"])]
            cells = [*times, ratio, item["relative_to"] or "", targets.get(name, "")]
        lines.append(row([name, *cells]))
    return lines


def growing() -> list[str]:
    """Return the lines about how each cost grows."""
    lines = []
    for name, items in groupby(read("growth.json"), key=lambda item: item["name"]):
        points = list(items)
        of = points[0]["size_of"]
        line = GROWTH["fit"]([p["size"] for p in points], [p["median_us"] for p in points])
        lines += [f"**{name}**, against {of}: {line.describe(of)}.", ""]
        lines += [row([of, *(str(p["size"]) for p in points)]), "|---" * (len(points) + 1) + "|"]
        lines += [row(["us", *(number(p["median_us"]) for p in points)]), ""]
    return lines


if __name__ == "__main__":
    print("\n".join([*with_peers(), "", *growing()]))
