"""What the tests of the live feed share: a recorded run, and a wire without waiting."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from twin.live.feed import Feed
from twin.live.replay import Datagram, Stream, schedule
from twin.log import Log, recorded_runs
from twin.particulars import Particulars

pytest.importorskip("pynmea2", reason="needs pynmea2: pip install 'usv-twin[view]'")
pytest.importorskip("pymavlink", reason="needs pymavlink: pip install 'usv-twin[view]'")

RUN = recorded_runs()["boat1_usv_circle"]


class Wire:
    """Hands datagrams to a feed at times of a clock that stands still between them."""

    def __init__(self, kind: type[Feed], boat: Particulars, **options: Any) -> None:
        self.now = 0.0
        self.feed = kind(None, boat, clock=lambda: self.now, **options)
        self.rows: list[tuple[float, np.ndarray, np.ndarray]] = []

    def carry(self, datagrams: Iterable[Datagram], speed: float = 1.0) -> None:
        began, first = self.now, None
        for datagram in datagrams:
            first = datagram.due if first is None else first
            self.now = began + (datagram.due - first) / speed
            self.feed.receive(datagram.data, self.now, ("127.0.0.1", 9))
            self.rows += self.feed.take()

    def tell(self, *lines: bytes, after: float = 0.0) -> list[Any]:
        self.now += after
        for line in lines:
            self.feed.receive(line, self.now, ("127.0.0.1", 9))
        return self.take()

    def take(self, after: float = 0.0) -> list[Any]:
        self.now += after
        new = self.feed.take()
        self.rows += new
        return new

    def replay(self, log: Log, stream: Stream, speed: float, **options: Any) -> Counter[str]:
        counts: Counter[str] = Counter()
        self.carry(schedule(log, stream, counts=counts, **options), speed)
        self.take(after=1.0)
        return counts

    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        t, z, cmd = zip(*self.rows, strict=True)
        return np.array(t), np.array(z), np.array(cmd)

    def balance(self) -> dict[str, int]:
        """Return the counts above 0; each message counts in one way."""
        counts = self.feed.counts
        ways = ("used", "late", "doubled", "broken", "void", "unknown", "own")
        assert counts["received"] == sum(counts[way] for way in ways)
        return {name: count for name, count in counts.items() if count}


@pytest.fixture(scope="session")
def circle() -> Log:
    """Return the first two minutes of the recorded run."""
    return Log.read(RUN).slice(0.0, 120.0)


@pytest.fixture(scope="session")
def usv() -> Particulars:
    return Particulars.load(RUN.with_name("boat1_usv_circle.toml"))
