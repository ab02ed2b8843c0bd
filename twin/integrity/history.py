"""When the status of a sensor changed, and that in words."""

from __future__ import annotations

from typing import NamedTuple

from twin.integrity.monitor import SensorMonitor, SensorStatus
from twin.integrity.state import SENSORS

__all__ = ["HealthHistory"]

CHANGES_KEPT = 1000
"""Number of changes that are kept, the last ones."""


class _Change(NamedTuple):
    """The status of all sensors from a time on."""

    t: float  # s
    statuses: dict[str, SensorStatus]


class HealthHistory:
    """Notes when the status of a sensor changes.

    Parameters
    ----------
    monitor : SensorMonitor
        The checks, which others advance.
    """

    def __init__(self, monitor: SensorMonitor) -> None:
        self._monitor = monitor
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._changes: list[_Change] = []
        self._last: dict[str, str] = {}

    def take(self, t: float, begin: float, others: dict[str, SensorStatus]) -> None:
        """Note what changed in the row of time t; the first row was at ``begin``, s.

        ``others`` have the status of what is no sensor of the checks: the navigation, and those
        channels of roll, pitch, heave and wind that are silent or in doubt now.
        """
        statuses = self._monitor.statuses(begin) | others
        status = {name: one.status for name, one in statuses.items()}
        if status != self._last:
            self._last = status
            self._changes.append(_Change(t, statuses))
            del self._changes[:-CHANGES_KEPT]

    def at(self, t: float) -> dict[str, SensorStatus]:
        """Return the status of each sensor at a time, s; empty before the first row."""
        # a copy: others may look on while rows come
        return next((one.statuses for one in self._changes[::-1] if one.t <= t), {})

    def lines(self) -> tuple[str, ...]:
        """Return a line for each stretch in which a sensor was not ok, the earliest first.

        A sensor that has never given a sample is not there, and leaves none.
        """
        lines: list[tuple[float, str]] = []
        channels = {name for change in self._changes for name in change.statuses} - set(SENSORS)
        for sensor in (*SENSORS, *sorted(channels)):
            spans: list[SensorStatus] = []
            for change in self._changes:
                # a channel of roll, pitch or heave is named only while it is in doubt
                status = change.statuses.get(sensor, SensorStatus("ok", change.t, ""))
                if not spans or spans[-1].status != status.status:
                    spans.append(status)
            ends = [f"to {span.since:.1f} s" for span in spans[1:]] + ["s on"]
            for k, (span, end) in enumerate(zip(spans, ends, strict=False)):
                if span.status != "ok" and (k > 0 or span.status != "absent"):
                    why = span.why.replace(f"{sensor} ", ": ", 1)
                    text = f"{sensor} {span.status} from {span.since:.1f} {end}{why}"
                    lines.append((span.since, text))
        return tuple(item[1] for item in sorted(lines, key=lambda item: item[0]))
