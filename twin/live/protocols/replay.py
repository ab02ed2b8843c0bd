"""A log sent as the live stream of a boat, at real time or faster, disturbed if wished."""

from __future__ import annotations

import contextlib
import dataclasses
import heapq
import itertools
import math
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.live.protocols.feed import WAIT
from twin.live.protocols.mavlink import MavlinkWriter, Servos
from twin.live.protocols.nmea_writer import NmeaWriter
from twin.live.protocols.sockets import FeedError, open_socket
from twin.logs.datum import Plane
from twin.logs.log import Log

__all__ = [
    "Datagram",
    "LinkImpairment",
    "MavlinkStream",
    "NmeaStream",
    "Pace",
    "Stream",
    "replay",
    "schedule",
]

Array = NDArray[np.float64]

ORIGIN = (59.43, 10.47)
"""Where a log without a place lies unless given: in the Oslofjord, degrees."""

LATE = 1.0
"""A late datagram comes so much later, s of the log: too late for its row."""

HELLO = 1.0
"""Time between two heartbeats of the autopilot, s of the log."""


@dataclass(frozen=True)
class Datagram:
    """What is sent at once."""

    due: float  # when, s of the log
    data: bytes
    messages: int = 1  # how many messages it holds
    steady: bool = False  # whether it is never disturbed


class _Late(NamedTuple):
    """A datagram that waits; the number keeps the order of those of one time."""

    due: float
    number: int
    datagram: Datagram


@dataclass(frozen=True, kw_only=True)
class LinkImpairment:
    """Shares of the datagrams that are disturbed, each in one way at most."""

    late: float = 0.0  # come LATE seconds late
    doubled: float = 0.0  # come twice
    broken: float = 0.0  # have a message with a wrong byte
    swapped: float = 0.0  # come after the next one of a later time

    def __post_init__(self) -> None:
        """Refuse what are no shares."""
        shares = dataclasses.asdict(self)
        if not all(0.0 <= share <= 1.0 for share in shares.values()) or sum(shares.values()) > 1.0:
            raise FeedError(f"disturb: the shares {shares} must be from 0 to 1, and so their sum")

    @classmethod
    def parse(cls, text: str) -> LinkImpairment:
        """Return what ``late=.05,doubled=.05`` says."""
        names = [item.name for item in dataclasses.fields(cls)]
        given: dict[str, float] = {}
        for item in filter(None, (part.strip() for part in text.split(","))):
            name, share = item.partition("=")[::2]
            if name not in names or name in given:
                raise FeedError(
                    f"disturb: {item}: write each of {', '.join(names)} once, as late=.05"
                )
            try:
                given[name] = float(share)
            except ValueError:
                raise FeedError(f"disturb: {item}: write a share, as {name}=.05") from None
        return cls(**given)


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

    @abstractmethod
    def broken(self, data: bytes, rng: np.random.Generator) -> bytes:
        """Return a datagram with one message broken."""

    @abstractmethod
    def count_replies(self, data: bytes) -> int:
        """Return how many messages a datagram holds that came back."""


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

    def broken(self, data: bytes, rng: np.random.Generator) -> bytes:
        """Return the sentences, of which one has a wrong byte in its fields."""
        lines = data.splitlines(keepends=True)
        which = int(rng.integers(len(lines)))
        line = bytearray(lines[which])
        at = int(rng.integers(line.index(b",") + 1, line.rindex(b"*")))
        line[at] = ord("x") if line[at] != ord("x") else ord("y")
        lines[which] = bytes(line)
        return b"".join(lines)

    def count_replies(self, data: bytes) -> int:
        """Return how many sentences a datagram holds."""
        return data.count(b"$")


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
            yield Datagram(t, self._writer.heartbeat("MAV_TYPE_SURFACE_BOAT"), steady=True)
        for data in self._writer.row(self.start + t, z, cmd, self.place(z)):
            yield Datagram(t, data)

    def broken(self, data: bytes, rng: np.random.Generator) -> bytes:
        """Return the message with a wrong byte behind its header."""
        wrong = bytearray(data)
        wrong[int(rng.integers(10, len(wrong)))] ^= 1 << int(rng.integers(8))
        return bytes(wrong)

    def count_replies(self, data: bytes) -> int:
        """Return 1: a datagram is a message."""
        return 1


def schedule(
    log: Log,
    stream: Stream,
    *,
    disturb: LinkImpairment | None = None,
    seed: int = 0,
    loop: bool = False,
    counts: Counter[str] | None = None,
) -> Iterator[Datagram]:
    """Yield the datagrams of a log in the order in which they are sent.

    Samples that are NaN are not sent. ``seed`` decides what goes wrong where. With ``loop`` it
    begins again at the end, for ever; the time goes on. ``counts`` receives the rows, datagrams and
    messages, and the messages of each kind of disturbance.
    """
    counts = Counter() if counts is None else counts
    rng = np.random.default_rng(seed)
    chances = dataclasses.asdict(disturb or LinkImpairment())
    kinds, edges = [*chances, ""], np.cumsum([*chances.values()])
    late: list[_Late] = []
    held: Datagram | None = None
    order = itertools.count()
    end = math.inf if loop else float(log.t[-1]) - LATE - WAIT

    def sent(datagram: Datagram) -> Datagram:
        counts["datagrams"] += 1
        counts["messages"] += datagram.messages
        return datagram

    for datagram in _datagrams(log, stream, loop, counts):
        while late and late[0].due <= datagram.due:
            one = heapq.heappop(late)
            yield sent(dataclasses.replace(one.datagram, due=one.due))
        kind = kinds[int(np.searchsorted(edges, rng.random(), side="right"))]
        swaps = kind == "swapped"
        last = datagram.due > end and (swaps or kind == "late")
        if datagram.steady or last or (swaps and held is not None):
            kind = ""  # nothing comes after the last one, and overlapping pairs are not swapped
        if kind == "broken":
            datagram = dataclasses.replace(datagram, data=stream.broken(datagram.data, rng))
        if kind:
            counts[kind] += 1 if kind == "broken" else datagram.messages
        if kind == "late":
            heapq.heappush(late, _Late(datagram.due + LATE, next(order), datagram))
        elif kind == "swapped":
            held = datagram
        else:
            for _ in range(2 if kind == "doubled" else 1):
                yield sent(datagram)
            overtakes = kind != "broken" and not datagram.steady
            if held is not None and overtakes and held.due < datagram.due:
                yield sent(dataclasses.replace(held, due=datagram.due))
                held = None
    for datagram in (*([held] if held else []), *(one.datagram for one in sorted(late))):
        yield sent(datagram)


def _datagrams(log: Log, stream: Stream, loop: bool, counts: Counter[str]) -> Iterator[Datagram]:
    """Yield the datagrams of the rows of a log, once or for ever."""
    length = float(log.t[-1] - log.t[0]) + log.dt
    for lap in itertools.count() if loop else (0,):
        for t, z, cmd in log:
            counts["rows"] += 1
            yield from stream.row(t + lap * length, z, cmd)


@dataclass(frozen=True)
class Pace:
    """How fast a log is sent."""

    speed: float = 1.0  # how many times as fast as it happened
    # the time now, s, and how to wait
    clock: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep

    def __post_init__(self) -> None:
        if not (math.isfinite(self.speed) and self.speed > 0.0):
            raise FeedError(f"speed {self.speed}: must be finite and above 0; 1 is as it happened")


def replay(
    log: Log,
    datagrams: Iterable[Datagram],
    stream: Stream,
    address: str,
    *,
    pace: Pace | None = None,
    progress: Callable[[float], None] = lambda t: None,
    counts: Counter[str] | None = None,
) -> Counter[str]:
    """Send a log's datagrams, from :func:`schedule`, to ``udp://HOST:PORT`` as a boat's stream.

    ``stream`` counts the replies. ``progress`` receives the time of the log that is sent, s.
    Returned are the counts: those handed in, datagrams ``unsent``, and messages that came ``back``.
    """
    if len(log) < 2:
        raise FeedError(f"{log.name}: has {len(log)} row(s); a stream needs two")
    pace, counts = pace or Pace(), Counter() if counts is None else counts
    output, target = open_socket(address, bind=False)
    with output:
        begun = pace.clock()
        for datagram in datagrams:
            wait = begun + (datagram.due - float(log.t[0])) / pace.speed - pace.clock()
            if wait > 0.0:
                pace.sleep(wait)
            try:
                output.sendto(datagram.data, target)
            except OSError:
                counts["unsent"] += 1
            with contextlib.suppress(OSError):  # no reply is waiting, or no receiver is there
                while True:
                    counts["back"] += stream.count_replies(output.recv(1 << 16))
            progress(datagram.due)
    return counts
