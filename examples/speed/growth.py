"""How the cost grows with wave components, boats, window and horizon.

``usv-twin bench --growth`` runs this script with a progress bar.
"""

from __future__ import annotations

import statistics
import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from twin.cli.common import OptionError, console, new_table, three_digits
from twin.performance.cases import batch, prediction, sail_ship, window
from twin.performance.harness import Case, measure

COMPONENTS = (0, 8, 24, 48, 100, 200, 300, 400)
BOATS = (1, 2, 4, 16, 64, 256, 1024, 4096)
ROWS = (2, 5, 10, 15, 30, 60, 120, 240)
HORIZONS = (1, 2, 5, 10, 20, 40, 60)

CURVES: dict[str, tuple[str, tuple[int, ...], Callable[[int], Any]]] = {
    "ship step, 3-DOF": ("wave components", COMPONENTS, partial(sail_ship, 3)),
    "ship step, 6-DOF": ("wave components", COMPONENTS, partial(sail_ship, 6)),
    "batch step": ("boats", BOATS, partial(batch, None)),
    "batch step with ukf": ("boats", BOATS, partial(batch, "ukf")),
    "dsw-ukf re-run": ("rows", ROWS, window),
    "ukf prediction": ("s ahead", HORIZONS, partial(prediction, "ukf")),
    "dsw-ukf-plus prediction": ("s ahead", HORIZONS, partial(prediction, "dsw-ukf-plus")),
}
"""Name: what grows, the sizes, and a function that sets up a burst for a size."""

STRAIGHT = 0.1
"""Relative deviation from a line within which times count as straight."""


class Line(NamedTuple):
    """A straight line through times, and where they leave it.

    ``start`` and ``slope`` are the time at size 0 and per unit of size, ``worst`` the largest
    relative deviation. ``bend`` is the size where two lines meet that fit far better than one,
    or None; ``slopes`` are those of the two.
    """

    start: float
    slope: float
    worst: float
    bend: float | None
    slopes: tuple[float, float]

    def __call__(self, size: float) -> float:
        """Return the time on the line at a size."""
        return self.start + self.slope * size

    def describe(self, size: str) -> str:
        """Return the line in words, its times in us; ``size`` says what grows."""
        each = f"{self.start:.3g} us + {self.slope:.3g} us times {size}"
        if self.bend is None:
            return f"{each}; straight within {100.0 * self.worst:.0f} %"
        before, after = self.slopes
        return (
            f"{each}, {100.0 * self.worst:.0f} % off at worst; it bends at {self.bend:g}: "
            f"{before:.3g} us times {size} before, {after:.3g} us after"
        )


def fit(sizes: Sequence[float], times: Sequence[float]) -> Line:
    """Return the line with the least squares of relative deviations, and where the times bend.

    A bend is looked for where a time deviates by more than 10 %. It is the size at which two
    lines that meet there fit best, if they halve the deviations.
    """
    n, t = np.asarray(sizes, float), np.asarray(times, float)

    def solve(*columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        basis = np.stack([np.ones_like(n), *columns], axis=1)
        weights = np.linalg.lstsq(basis / t[:, None], np.ones_like(t), rcond=None)[0]
        return weights, basis @ weights / t - 1.0

    (start, slope), residual = solve(n)
    worst, bend, slopes = float(np.abs(residual).max()), None, (slope, slope)
    if worst > STRAIGHT:
        tried = [(knot, *solve(n, np.maximum(n - knot, 0.0))) for knot in n[1:-1]]
        knot, weights, bent = min(tried, key=lambda one: float(one[2] @ one[2]))
        if bent @ bent < 0.25 * (residual @ residual):
            bend, slopes = float(knot), (weights[1], weights[1] + weights[2])
    return Line(float(start), float(slope), worst, bend, (float(slopes[0]), float(slopes[1])))


def measure_growth(
    only: str = "", rounds: int = 5, run: Callable[..., Any] = measure
) -> tuple[list[dict[str, Any]], bool]:
    """Measure and print all curves with a text in their names.

    Returns
    -------
    list of dict and bool
        Rows of ``name``, ``size_of``, ``size``, ``median_us``, ``line_us``; and whether Ctrl-C
        ended it.
    """
    chosen = {n: c for n, c in CURVES.items() if only.lower() in f"{n}, {c[0]}".lower()}
    if not chosen:
        raise OptionError(f"--only {only!r}: no such curve; leave it out to see them all")
    rows: list[dict[str, Any]] = []
    for name, (size_of, sizes, make) in chosen.items():
        measured = run([Case(f"{name}: {n}", partial(make, n)) for n in sizes], rounds)
        times = {
            n: 1e6 * statistics.median(measured.seconds[f"{name}: {n}"])
            for n in sizes
            if f"{name}: {n}" in measured.seconds
        }
        line = fit(list(times), list(times.values())) if len(times) > 2 else None
        table = new_table(f"{name}, us", size_of, "us", "line", "deviation")
        for n, us in times.items():
            at = None if line is None else line(n)
            cells = ("", "") if at is None else (three_digits(at), f"{100 * (us / at - 1):+.0f} %")
            table.add_row(str(n), three_digits(us), *cells)
            row = {"name": name, "size_of": size_of, "size": n, "median_us": us, "line_us": at}
            rows.append(row)
        console.print(table)
        if line is not None:
            console.print(line.describe(size_of), highlight=False)
        if measured.interrupted:
            return rows, True
    return rows, False


if __name__ == "__main__":
    measure_growth(*sys.argv[1:2])
