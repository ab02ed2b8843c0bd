"""Cases that take turns in short bursts, and medians over the rounds."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

__all__ = [
    "BASELINE",
    "BASELINE_RATE",
    "Case",
    "Measured",
    "measure",
]

Burst = tuple[Callable[[], object], int]
"""What is timed, and how many operations it does."""

BASELINE = "Pendulum"
"""The case whose rate stands for the speed of the machine."""

BASELINE_RATE = 94e3
"""Its steps/s on the machine for which the target rates were set."""

BURST_MIN = 0.02
"""Least length of a burst, s."""


@dataclass(frozen=True)
class Case:
    """Something to be timed."""

    name: str
    make: Callable[[], Burst]  # sets it up and returns a Burst
    relative_to: str | None = None  # name of the case that its rate is divided by
    # least operations per second on the machine where the baseline makes BASELINE_RATE, and least
    # ratio to relative_to
    target: float | None = None
    target_ratio: float | None = None


@dataclass
class Measured:
    """What :func:`measure` found: times per operation (s) of each case in each round."""

    seconds: dict[str, list[float]] = field(default_factory=dict)
    interrupted: bool = False

    def ratio(self, name: str, to: str) -> float:
        """Return how many times faster a case is than another, as the median over the rounds."""
        pairs = zip(self.seconds[to], self.seconds[name], strict=False)
        return statistics.median(slow / fast for slow, fast in pairs)

    def rows(self, cases: Sequence[Case]) -> list[dict[str, Any]]:
        """Return a row for each case: ``name, rate_per_s, median_us, relative_to, ratio``.

        The last two are None where there is nothing to compare with; what was not measured is
        left out.
        """
        rows = []
        for case in cases:
            if case.name not in self.seconds:
                continue
            to = case.relative_to if case.relative_to in self.seconds else None
            median = statistics.median(self.seconds[case.name])
            rows.append(
                {
                    "name": case.name,
                    "rate_per_s": 1.0 / median,
                    "median_us": 1e6 * median,
                    "relative_to": to,
                    "ratio": None if to is None else self.ratio(case.name, to),
                }
            )
        return rows

    def target_fraction(self, case: Case) -> float | None:
        """Return what fraction of its targets a case reaches; 1 or more is enough.

        A target rate scales with the speed of this machine, which the baseline gives.
        """
        parts = []
        if case.target is not None and BASELINE in self.seconds:
            parts.append(self.ratio(case.name, BASELINE) * BASELINE_RATE / case.target)
        if case.target_ratio is not None and case.relative_to in self.seconds:
            parts.append(self.ratio(case.name, case.relative_to) / case.target_ratio)
        return min(parts, default=None)


def measure(
    cases: Sequence[Case], rounds: int, advance: Callable[[str], None] = lambda name: None
) -> Measured:
    """Time all cases, one burst of each in each round; Ctrl-C ends it early.

    ``advance`` gets the name of each case when it is set up, and after each of its bursts.
    """
    measured, bursts = Measured(), {}
    try:
        for case in cases:
            advance(case.name)
            bursts[case.name] = _calibrated(*case.make())
        for _ in range(rounds):
            for name, (run, count) in bursts.items():
                measured.seconds.setdefault(name, []).append(_time(run) / count)
                advance(name)
    except KeyboardInterrupt:
        measured.interrupted = True
    return measured


def _time(run: Callable[[], object]) -> float:
    begun = time.perf_counter()
    run()
    return time.perf_counter() - begun


def _calibrated(run: Callable[[], object], count: int) -> Burst:
    """Return a burst that is repeated until it is long enough; it has been compiled by then."""
    run()
    times = math.ceil(BURST_MIN / max(_time(run), 1e-9))
    if times <= 1:
        return run, count

    def repeated() -> None:
        for _ in range(times):
            run()

    return repeated, times * count
