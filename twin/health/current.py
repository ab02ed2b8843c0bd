"""Whether the current that a twin assumes is one that water makes, or a GPS that is drawn away."""

from __future__ import annotations

import math
from collections import deque

__all__ = ["CurrentWatch"]

LARGEST = 1.0
"""A current above this is not plausible where no one has said so, m/s."""

CHANGE, SPAN, EVERY = 0.25, 40.0, 5.0
"""Nor is one that changes by more than the first number (m/s) within the second (s); looked at each
so many seconds."""

SURE = 2.0
"""Standard deviations by which it must be so."""

SHOWN = 60.0
"""How long a change is shown, s."""


Current = tuple[float, float, float]
"""Velocity of the water to north and east, and its standard deviation, m/s."""


class CurrentWatch:
    """Remembers the current of the last 40 s; a saved twin does not keep it."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._past: deque[Current] = deque(maxlen=1 + round(SPAN / EVERY))
        self._due = -math.inf
        self._changed, self._by = -math.inf, 0.0

    def is_due(self, t: float) -> bool:
        """Return whether the current is to be looked at again at a time, s."""
        return t >= self._due

    def take(self, t: float, current: Current | None) -> None:
        """Take the current at a time, s; None where there is no estimate."""
        self._due = t + EVERY
        if current is None:
            return
        for past in self._past:
            by = math.hypot(current[0] - past[0], current[1] - past[1])
            if by - SURE * math.hypot(current[2], past[2]) > CHANGE:
                self._changed, self._by = t, by
        self._past.append(current)

    def why_doubtful(self, t: float, current: Current | None) -> str:
        """Return in words why a current makes the GPS doubtful; empty where it does not."""
        if current is None:
            return ""
        size = math.hypot(current[0], current[1]) - SURE * current[2]
        if size > LARGEST:
            return f"gps makes a current of at least {size:.1f} m/s: its fixes may be drawn away"
        if t < self._changed + SHOWN:
            return (
                f"gps makes the current change by {self._by:.1f} m/s within {SPAN:.0f} s: its "
                "fixes may be drawn away"
            )
        return ""
