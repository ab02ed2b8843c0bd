"""A log sent as the live stream of a boat, at real time or faster."""

from __future__ import annotations

import contextlib
import itertools
import math
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.live.protocols.mavlink import MavlinkWriter, Servos
from twin.live.protocols.nmea_writer import NmeaWriter
from twin.live.protocols.sockets import FeedError, open_socket
from twin.logs.datum import Plane
from twin.logs.log import Log

__all__ = [
    "Datagram",
    "MavlinkStream",
    "NmeaStream",
    "Stream",
    "replay",
    "schedule",
]

Array = NDArray[np.float64]

ORIGIN = (59.43, 10.47)
"""Where a log without a place lies unless given: in the Oslofjord, degrees."""

HELLO = 1.0
"""Time between two heartbeats of the autopilot, s of the log."""


@dataclass(frozen=True)
class Datagram:
    """What is sent at once."""

    due: float  # when, s of the log
    data: bytes
    messages: int = 1  # how many messages it holds


class Stream(ABC):
    """Rows of a log as datagrams.

    ``origin`` is latitude and longitude, degrees, of north = east = 0 in the log; ``start`` the
    sender's clock at time 0 of the log, s.
    """

    def __init__(self, origin: tuple[float, float], start: float) -> None:
        if not (abs(origin[0]) < 90.0 and abs(origin[1]) <= 180.0):
            raise FeedError(
                f"origin {origin[0]:g}, {origin[1]:g}: latitude must be within 90 and longitude "
                "within 180 degrees"
            )
        self.plane, self.start = Plane(*origin), start

    def place(self, z: Array) -> tuple[float, float] | None:
        """Return latitude and longitude of a row, degrees."""
        north, east = z[:2].tolist()
        return None if math.isnan(north + east) else self.plane.degrees(north, east)

    @abstractmethod
    def row(self, t: float, z: Array, cmd: Array) -> Iterator[Datagram]:
        """Yield the datagrams of a row."""


class NmeaStream(Stream):
    """Rows as NMEA 0183, a datagram for each; see ``twin/live/protocols/nmea.py``.

    ``start`` is UNIX time, by default now; with ``tag`` each sentence has a TAG block with its
    time.
    """

    def __init__(
        self,
        origin: tuple[float, float] = ORIGIN,
        start: float | None = None,
        *,
        tag: bool = False,
    ) -> None:
        super().__init__(origin, time.time() if start is None else start)
        self._writer = NmeaWriter("GP", tag=tag)

    def row(self, t: float, z: Array, cmd: Array) -> Iterator[Datagram]:
        """Yield the datagram of a row."""
        lines = self._writer.row(self.start + t, z, cmd, self.place(z))
        yield Datagram(t, "".join(lines).encode(), len(lines))


class MavlinkStream(Stream):
    """Rows as MAVLink 2, up to three messages for each; see ``twin/live/protocols/mavlink.py``.

    ``start`` is the time since the autopilot started, by default 10 s.
    """

    def __init__(
        self, servos: Servos, origin: tuple[float, float] = ORIGIN, start: float = 10.0
    ) -> None:
        super().__init__(origin, start)
        self._writer = MavlinkWriter(servos=servos)
        self._greeted = -math.inf

    def row(self, t: float, z: Array, cmd: Array) -> Iterator[Datagram]:
        """Yield the datagrams of a row."""
        if t - self._greeted >= HELLO:
            self._greeted = t
            yield Datagram(t, self._writer.heartbeat("MAV_TYPE_SURFACE_BOAT"))
        for data in self._writer.row(self.start + t, z, cmd, self.place(z)):
            yield Datagram(t, data)


def schedule(
    log: Log, stream: Stream, *, loop: bool = False, counts: Counter[str] | None = None
) -> Iterator[Datagram]:
    """Yield the datagrams of a log in the order in which they are sent.

    Samples that are NaN are not sent. With ``loop`` it begins again at the end, for ever; the time
    goes on. ``counts`` receives the rows, datagrams and messages.
    """
    counts = Counter() if counts is None else counts
    length = float(log.t[-1] - log.t[0]) + log.dt
    for lap in itertools.count() if loop else (0,):
        for t, z, cmd in log:
            counts["rows"] += 1
            for datagram in stream.row(t + lap * length, z, cmd):
                counts["datagrams"] += 1
                counts["messages"] += datagram.messages
                yield datagram


def replay(
    log: Log,
    stream: Stream,
    address: str,
    *,
    speed: float = 1.0,
    loop: bool = False,
    progress: Callable[[float], None] = lambda t: None,
    counts: Counter[str] | None = None,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Counter[str]:
    """Send a log to ``udp://HOST:PORT`` as a boat's stream, ``speed`` times as fast as it happened.

    ``progress`` receives the time of the log that is sent, s. Returned are the counts: those of
    :func:`schedule`, datagrams ``unsent``, and datagrams that came ``back``.
    """
    if len(log) < 2:
        raise FeedError(f"{log.name}: has {len(log)} row(s); a stream needs two")
    if not (math.isfinite(speed) and speed > 0.0):
        raise FeedError(f"speed {speed}: must be finite and above 0; 1 is as it happened")
    counts = Counter() if counts is None else counts
    output, target = open_socket(address, bind=False)
    with output:
        begun = clock()
        for datagram in schedule(log, stream, loop=loop, counts=counts):
            wait = begun + (datagram.due - float(log.t[0])) / speed - clock()
            if wait > 0.0:
                sleep(wait)
            try:
                output.sendto(datagram.data, target)
            except OSError:
                counts["unsent"] += 1
            with contextlib.suppress(OSError):  # no reply is waiting, or no receiver is there
                while output.recv(1 << 16):
                    counts["back"] += 1
            progress(datagram.due)
    return counts
