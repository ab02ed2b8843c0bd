"""Rows of an autopilot's receiver, never of its own estimate.

Sailing by the twin, the autopilot's estimate is the twin's own come back: GLOBAL_POSITION_INT would
look like a perfect fix. So place and speed come from GPS_RAW_INT.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.live.external.peer import AutopilotPeer
from twin.live.protocols.mavlink import (
    AUTOPILOT,
    CLOCK_TOLERANCE_S,
    ONBOARD,
    UNKNOWN_HEADING,
    MavlinkFeed,
    MavlinkWriter,
)
from twin.logs.wire.feed import Message
from twin.logs.wire.sockets import Address
from twin.particulars import Particulars

__all__ = ["ReceiverFeed"]

Array = NDArray[np.float64]

REORDER_S = 0.1
"""Time that a row waits for messages that were overtaken: the autopilot sails by its estimate."""

FIX_TYPE_MIN = 2
"""Least ``fix_type`` of a place on the Earth."""

SET_INTERVAL = 511
ASK_EVERY_S = 10.0
"""Command MAV_CMD_SET_MESSAGE_INTERVAL, and the time after which it is given again."""

INTERVALS_S = {30: 0.05, 27: 0.05, 36: 0.05, 24: 0.2}
"""Time between two messages, by number: ATTITUDE, RAW_IMU, SERVO_OUTPUT_RAW, GPS_RAW_INT."""


class ReceiverFeed(MavlinkFeed):
    """Rows of an autopilot's receiver, attitude, IMU and servo outputs.

    ``peer`` hears all that the autopilot says. Other arguments are those of
    :class:`~twin.live.protocols.mavlink.MavlinkFeed`.
    """

    def __init__(
        self, address: str | None, particulars: Particulars, peer: AutopilotPeer, **options: Any
    ) -> None:
        self.peer = peer
        self._writer = MavlinkWriter(component=ONBOARD)
        self._source: Address | None = None
        self._target: Address | None = None
        self._intervals_asked = -math.inf
        super().__init__(address, particulars, **{"wait": REORDER_S, **options})

    def take(self) -> list[tuple[float, Array, Array]]:
        """Return the rows that are complete, and ask for what rows are made of."""
        rows, now = super().take(), self.clock()
        if self._target is not None and now - self._intervals_asked >= ASK_EVERY_S:
            self._intervals_asked = now
            system = int(self.peer.system or AUTOPILOT)
            self.post(
                self._writer.command(system, SET_INTERVAL, message, 1e6 * interval)
                for message, interval in INTERVALS_S.items()
            )
        return rows

    def receive(self, data: bytes, arrival: float, source: Address | None = None) -> None:
        """See :meth:`~twin.logs.wire.feed.Feed.receive`."""
        self._source = source
        super().receive(data, arrival, source)

    def post(self, datagrams: Iterable[bytes]) -> None:
        """Send datagrams to where the autopilot speaks from, once that is known."""
        if self._target is None or self._socket is None:
            return
        for data in datagrams:
            with contextlib.suppress(OSError):  # it is gone, or its line is full
                self._socket.sendto(data, self._target)

    def age(self, t: float) -> float:
        """Return how long ago the time of a row was, s."""
        return max(self._map.at(self.clock()) - (self._zero or 0.0) - t, 0.0)

    def _message(self, item: Any) -> Message | str:
        if item.get_type() != "BAD_DATA":
            self.peer.hear(item)
            if item.get_srcSystem() == self.peer.system:
                self._target = self._source
        return super()._message(item)

    def _readers(self) -> dict[str, Callable[[Any], Message]]:
        readers = super()._readers()
        del readers["GLOBAL_POSITION_INT"]
        return {**readers, "GPS_RAW_INT": self._fix}

    def _fix(self, item: Any) -> Message:
        """Return place and speed of the receiver."""
        if item.fix_type < FIX_TYPE_MIN or not (item.lat or item.lon):
            return Message("position", void=True)
        stamp = item.time_usec / 1e6
        timed = abs(stamp - self._boot) < CLOCK_TOLERANCE_S
        values = {}
        if UNKNOWN_HEADING not in (item.vel, item.cog):
            course, speed = math.radians(item.cog / 100.0), item.vel / 100.0
            values["gps_vx_mps"] = speed * math.cos(course)
            values["gps_vy_mps"] = speed * math.sin(course)
        place = item.lat / 1e7, item.lon / 1e7
        return Message("position", stamp if timed else None, values, place)
