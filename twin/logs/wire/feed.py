"""A live feed: messages of a boat become rows for its twin.

Messages come as UDP datagrams, late, doubled, out of order and broken as they may be. They are
placed on one time axis, wait a little for those that were overtaken, and leave as rows in the
order of time. What was not used is counted in :attr:`Feed.counts`; nothing that comes over the
wire raises.
"""

from __future__ import annotations

import bisect
import itertools
import math
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin.channels import COMMANDS, MEASUREMENTS
from twin.logs.datum import Plane
from twin.logs.wire.sockets import Address, open_socket
from twin.particulars import Particulars

__all__ = [
    "COUNTS",
    "Feed",
    "Message",
]

Array = NDArray[np.float64]


COUNTS = {
    "received": "messages that came, of any kind",
    "used": "those that went into rows, gave the time or showed that the sender is there",
    "late": "came when the row of their time was gone; dropped",
    "doubled": "came twice; the second was dropped",
    "out of order": "were overtaken by a later one and sorted in; they count as used, too",
    "broken": "with a wrong or no checksum, cut off, or with impossible values",
    "void": "whose sender says itself that they hold nothing valid, as without a fix",
    "unknown": "sound, but of a kind or a sender that is not followed",
}
"""What is counted. ``received`` is the sum of used, late, doubled, broken, void, unknown, own."""

PERIOD = 0.05
"""Samples of different sensors that are nearer than this in time, s, share a row."""

WAIT = 0.3
"""A row waits this long, s of the stream, for messages that were overtaken ..."""

RESTART = 3.0
"""... and after so much time of the stream, s, with only late ones, its clock was restarted."""

MEMORY = 10.0
"""A message that comes a second time within this, s, is known again; a clock that is farther ahead
of its messages was set."""

SAME = 1e-3
"""Times that differ by less, s, are one."""

REPEAT = 0.01
"""A message without a time that repeats the last one within this, s, is that one again."""

HOLD = 2.0
"""Time without messages, s, over which the sender's clock is extrapolated at its own rate."""

BYTES_MAX = 1 << 16
"""About so many bytes are read in one call; the rest waits for the next."""

LIMITS = {
    "gps_x_m": math.inf,
    "gps_y_m": math.inf,
    "gps_vx_mps": 500.0,
    "gps_vy_mps": 500.0,
    "compass_rad": 8.0,
    "gyro_radps": 50.0,
    **dict.fromkeys(("gyro_x_radps", "gyro_y_radps"), 50.0),
    **dict.fromkeys(("accel_x_mps2", "accel_y_mps2", "accel_z_mps2"), 1000.0),
    **dict.fromkeys(("ahrs_roll_rad", "ahrs_pitch_rad"), 8.0),
    **dict.fromkeys(("wind_mps", "apparent_wind_mps"), 200.0),
    **dict.fromkeys(("wind_from_rad", "apparent_wind_rad"), 8.0),
    "gps_z_m": 1e5,
    "gps_vz_mps": 500.0,
    **dict.fromkeys(COMMANDS[:2], 2000.0),
    **dict.fromkeys(COMMANDS[2:], 0.5 * math.pi + 1e-6),
}
"""Limits of valid values, whatever the checksum says."""


@dataclass(frozen=True)
class Message:
    """One sound message."""

    kind: str  # what it is; a second one of the same kind and time is a repeat
    stamp: float | None = None  # time by its sender's clock, s; None where it has none
    # measurements and commands, by the names of a log's columns
    values: dict[str, float] = field(default_factory=dict)
    fix: tuple[float, float] | None = None  # latitude and longitude, degrees
    void: bool = False  # it holds nothing valid but its time

    def sound(self) -> bool:
        """Return whether all that it says can be true."""
        if self.fix is not None and not (abs(self.fix[0]) <= 90.0 and abs(self.fix[1]) <= 180.0):
            return False
        if self.stamp is not None and not math.isfinite(self.stamp):
            return False
        return all(
            math.isfinite(value) and abs(value) <= LIMITS[name]
            for name, value in self.values.items()
        )


MOMENT = 1e-6
"""Messages that came within so short a time say nothing of the sender's rate, s."""


class _Clock:
    """The sender's time as a function of ours, by a median slope (Theil 1950): robust to delays."""

    def __init__(self) -> None:
        self.pairs: deque[tuple[float, float]] = deque(maxlen=100)
        self.fit: tuple[float, float, float] | None = None

    def tell(self, arrival: float, t: float) -> None:
        """Take the time of a message and when it came."""
        self.pairs.append((arrival, t))
        self.fit = None

    def shift(self, by: float) -> None:
        """Move the sender's time, s, as it runs on under another name."""
        self.pairs = deque(((ours, theirs + by) for ours, theirs in self.pairs), maxlen=100)
        self.fit = None

    def at(self, arrival: float) -> float:
        """Return the time of what comes now."""
        if self.fit is None:
            ours, theirs = np.array(self.pairs).T
            half = (len(ours) + 1) // 2
            passed = ours[half:] - ours[: len(ours) - half]
            rate = 1.0
            # fewer do not give the rate: between two, jitter is as large as the time
            apart = passed > MOMENT
            if len(ours) >= 5 and np.ptp(theirs) >= 1.0 and apart.any():
                steps = theirs[half:] - theirs[: len(ours) - half]
                rate = max(float(np.median(steps[apart] / passed[apart])), 0.0)
            offset = float(np.median((theirs - rate * ours)[-10:]))
            self.fit = float(ours[-1]), rate, offset
        last, rate, offset = self.fit
        known = min(arrival, last + HOLD)
        return offset + rate * known + (arrival - known)


class Feed(ABC):
    """Messages of a boat as rows for its twin; the contract of every kind of feed.

    Parameters
    ----------
    address : str or None
        ``udp://HOST:PORT`` to listen at; None for one that is only handed datagrams by
        :meth:`receive`.
    particulars : Particulars
        The boat: until a command comes it is taken to keep the nominal shaft speed, straight on.
    clock : callable
        Returns the time now, s.
    period, wait : float
        Samples nearer than ``period`` share a row; a row waits ``wait`` for what was overtaken,
        both in s of the stream.

    Attributes
    ----------
    counts : dict of str to int
        By the names in :data:`COUNTS`.
    plane : Plane or None
        Where north = east = 0 is on the Earth: at the first fix; None before it.

    Notes
    -----
    A row's time is that of its fix, or else of its last sample. It is counted by the sender's clock
    from the first row. Messages without a time are placed by a line through the times of the last
    ones with one, over their arrivals. So a stream that runs faster than the clock keeps its times.
    A row's command is the last one up to its time.

    If only late messages come for :data:`RESTART` seconds of their own time, their sender has
    restarted. Its time goes on after what was there, by our own clock. A jump ahead is a gap.
    """

    modulus: float
    """The sender's clock begins again after this, s."""

    def __init__(
        self,
        address: str | None,
        particulars: Particulars,
        *,
        clock: Callable[[], float] = time.monotonic,
        period: float = PERIOD,
        wait: float = WAIT,
    ) -> None:
        self.particulars = particulars
        self.clock, self.period, self.wait = clock, period, wait
        self.counts = dict.fromkeys(COUNTS, 0)
        self.commanded: set[str] = set()
        self.plane: Plane | None = None
        self._cmd = np.array([particulars.shaft_speed] * 2 + [0.0] * 2)
        self._map = _Clock()
        self._base: float | None = None
        self._zero: float | None = None
        self._head = self._timed = self._released = -math.inf
        self._stale, self._leap = math.inf, 0.0
        self._seen: dict[tuple[str, int], float] = {}
        self._last: dict[str, tuple[Message, float]] = {}
        self._buffer: list[tuple[float, int, dict[str, float]]] = []
        self._ready: list[tuple[float, Array, Array]] = []
        self._order = itertools.count()
        self._arrival = -math.inf
        self._socket = None if address is None else open_socket(address, bind=True)[0]

    @abstractmethod
    def decode(self, data: bytes) -> Iterator[Message | str]:
        """Yield what a datagram holds: messages, or the names under which to count what is none."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know of the feed, in words."""
        taken = {
            "shaft speed": (
                COMMANDS[:2],
                f"{self.particulars.shaft_speed:g} rev/s, the nominal one",
            )
        }
        if self.particulars.steering == "drives":
            taken["drive angle"] = COMMANDS[2:], "straight ahead"
        return tuple(
            f"no {what} has come: taken as {text}"
            for what, (names, text) in taken.items()
            if self.commanded.isdisjoint(names)
        ) + ((f"the sender's clock leapt ahead by {self._leap:.0f} s",) if self._leap else ())

    def take(self) -> list[tuple[float, Array, Array]]:
        """Return the rows that are complete, oldest first: time, measurements (19,), commands (4,).

        Times in s strictly increase over the life of the feed; measurements are in the order of
        ``twin.logs.log.MEASUREMENTS``, NaN where there is none.
        """
        drained = self._drain()
        if drained and self.clock() - self._arrival >= self.wait:
            self._release(math.inf)
        rows, self._ready = self._ready, []
        return rows

    def receive(self, data: bytes, arrival: float, source: Address | None = None) -> None:
        """Take one datagram that arrived at a time of the feed's clock (s) from ``source``."""
        if not self._map.pairs:  # until a message has a time, use our own
            self._map.tell(arrival, 0.0)
        for item in self.decode(data):
            counted = item if isinstance(item, str) else self._place(item, arrival)
            self.counts["received"] += 1
            self.counts[counted] += 1
            if counted in ("used", "void"):
                self._arrival = arrival
        self._release(self._head - self.wait)

    def close(self) -> None:
        """Let go of the port."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def __enter__(self) -> Feed:
        """Return the feed itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def stamp_of(self, t: float) -> float:
        """Return a row's time by the sender's clock, s, within its modulus."""
        return (t + (self._zero or 0.0) + (self._base or 0.0)) % self.modulus

    def _drain(self) -> bool:
        """Read what has come; return whether that was all."""
        budget = BYTES_MAX
        while self._socket is not None and budget > 0:
            try:
                data, source = self._socket.recvfrom(1 << 16)
            except BlockingIOError:
                return True
            except OSError:  # an earlier answer was refused
                budget -= 64
                continue
            budget -= len(data) + 64
            self.receive(data, self.clock(), source)
        return budget > 0

    def _place(self, message: Message, arrival: float) -> str:
        """Sort a message in; return under which name it counts."""
        if not message.sound():
            return "broken"
        if message.stamp is None:
            t = max(self._map.at(arrival), self._released + SAME)
            last, before = self._last.get(message.kind, (None, 0.0))
            if message == last and abs(t - before) < REPEAT:
                return "doubled"
            self._last[message.kind] = message, t
        else:
            placed = self._on_axis(message.kind, message.stamp, arrival)
            if isinstance(placed, str):
                return placed
            t = placed
        self._head = max(self._head, t)
        values = message.values
        if message.fix is not None:
            if self.plane is None:
                self.plane = Plane(*message.fix)
            north, east = self.plane.metres(*message.fix)
            values = {"gps_x_m": north, "gps_y_m": east, **values}
        if values:
            bisect.insort(self._buffer, (t, next(self._order), values))
        return "void" if message.void else "used"

    def _on_axis(self, kind: str, stamp: float, arrival: float) -> float | str:
        """Return the time of a message on the feed's axis, or why it has none."""
        if self._base is None:
            self._base = stamp - self._map.at(arrival)
            t = stamp - self._base
        else:
            nearest = max(self._timed, self._released)
            turns = round((nearest + self._base - stamp) / self.modulus)
            t = stamp + turns * self.modulus - self._base
            leap = t - max(self._map.at(arrival), self._head)
            self._leap = max(self._leap, leap if leap > MEMORY else 0.0)
        key = kind, round(t / SAME)
        behind = t < self._released + SAME / 2  # stamps in other units may round to slightly later
        if behind:
            self._stale = min(self._stale, t)
            if t - self._stale >= RESTART:
                now = self._map.at(arrival)
                begun = max(now, self._head + self.period)
                self._base += t - begun
                self._map.shift(begun - now)
                self._seen.clear()
                self._timed = -math.inf
                t, key, behind = begun, (kind, round(begun / SAME)), False
        if key in self._seen:
            return "doubled"
        if behind:
            if t > self._released - RESTART:  # its time still counts
                self._map.tell(arrival, t)
            return "late"
        self._stale = math.inf
        self._seen[key] = t
        while self._seen[oldest := next(iter(self._seen))] < t - MEMORY:
            del self._seen[oldest]
        if t < self._timed - SAME:
            self.counts["out of order"] += 1
        else:
            self._timed = t
            self._map.tell(arrival, t)
        return t

    def _release(self, until: float) -> None:
        """Make rows of all samples up to a time."""
        while self._buffer and self._buffer[0][0] + self.period <= until:
            first, fix, last = self._buffer[0][0], None, self._buffer[0][0]
            row: dict[str, float] = {}
            count = 0
            for t, values in (item[::2] for item in self._buffer):
                apart = t - first >= self.period - SAME / 2
                again = t - last >= SAME and not row.keys().isdisjoint(values)
                if apart or again:
                    break
                row = {**values, **row}
                fix = t if "gps_x_m" in values and fix is None else fix
                last = t
                count += 1
            del self._buffer[:count]
            self._released = last
            self._ready.append(self._row(last if fix is None else fix, row))

    def _row(self, t: float, row: dict[str, float]) -> tuple[float, Array, Array]:
        if self._zero is None:
            self._zero = t
        z = np.array([row.get(name, math.nan) for name in MEASUREMENTS])
        for i, name in enumerate(COMMANDS):
            if name in row:
                self._cmd[i] = row[name]
                self.commanded.add(name)
        return round(t - self._zero, 6), z, self._cmd.copy()
