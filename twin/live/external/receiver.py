"""Rows of an autopilot's receiver, never of its own estimate.

Sailing by the twin, the autopilot's estimate is the twin's own come back: GLOBAL_POSITION_INT would
look like a perfect fix. So place and speed come from GPS_RAW_INT, or from GPS2_RAW where the twin
itself is the first receiver.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

from twin.live.external.peer import AutopilotPeer
from twin.live.protocols.feed import Message
from twin.live.protocols.mavlink import NEAR, UNKNOWN_HEADING, MavlinkFeed
from twin.logs.datum import Plane
from twin.particulars import Particulars

__all__ = ["ReceiverFeed"]

WAIT = 0.1
"""A row waits so long, s, for messages that were overtaken: the autopilot sails by its estimate."""

NO_FIX = 2
"""Least ``fix_type`` of a place on the Earth."""

SET_INTERVAL, ASK_EVERY = 511, 10.0
"""Command MAV_CMD_SET_MESSAGE_INTERVAL, and the time, s, after which it is given again."""

INTERVALS = {30: 0.05, 27: 0.05, 36: 0.05, 24: 0.2}
"""Message -> time between two, s: ATTITUDE, RAW_IMU, SERVO_OUTPUT_RAW, GPS_RAW_INT."""

SECOND = {124: 0.2}
"""The same of GPS2_RAW."""


class ReceiverFeed(MavlinkFeed):
    """Rows of an autopilot's receiver, attitude, IMU and servo outputs.

    ``peer`` hears all that the autopilot says; ``second`` takes the second receiver. Other
    arguments are those of :class:`~twin.live.protocols.mavlink.MavlinkFeed`.
    """

    def __init__(
        self,
        address: str | None,
        particulars: Particulars,
        peer: AutopilotPeer,
        *,
        second: bool = False,
        **options: Any,
    ) -> None:
        self.peer = peer
        self._fixes = "GPS2_RAW" if second else "GPS_RAW_INT"
        self._intervals = {**INTERVALS, **(SECOND if second else {})}
        self._intervals_asked = -math.inf
        super().__init__(address, particulars, None, **{"wait": WAIT, **options})

    def greet(self, now: float) -> Iterator[bytes]:
        """Yield the heartbeat, and ask for what rows are made of."""
        yield from super().greet(now)
        system = self.peer.system
        if system is not None and now - self._intervals_asked >= ASK_EVERY:
            self._intervals_asked = now
            for message, interval in self._intervals.items():
                yield self._writer.command(system, SET_INTERVAL, message, 1e6 * interval)

    @property
    def plane(self) -> Plane | None:
        """Where x = y = 0 is on the Earth; None before the first fix."""
        return self._plane

    def age(self, t: float) -> float:
        """Return how long ago the time of a row was, s."""
        return max(self._map.at(self.clock()) - (self._zero or 0.0) - t, 0.0)

    def _message(self, item: Any) -> Message | str:
        if item.get_type() != "BAD_DATA":
            self.peer.hear(item)
        return super()._message(item)

    def _readers(self) -> dict[str, Callable[[Any], Message]]:
        readers = super()._readers()
        del readers["GLOBAL_POSITION_INT"], readers["GPS_RAW_INT"]
        return {**readers, self._fixes: self._fix}

    def _fix(self, item: Any) -> Message:
        """Return place and speed of the receiver."""
        if item.fix_type < NO_FIX or not (item.lat or item.lon):
            return Message("position", void=True)
        stamp = item.time_usec / 1e6
        timed = abs(stamp - self._boot) < NEAR
        values = {}
        if UNKNOWN_HEADING not in (item.vel, item.cog):
            course, speed = math.radians(item.cog / 100.0), item.vel / 100.0
            values["gps_vx_mps"] = speed * math.cos(course)
            values["gps_vy_mps"] = speed * math.sin(course)
        place = item.lat / 1e7, item.lon / 1e7
        return Message("position", stamp if timed else None, values, place)
