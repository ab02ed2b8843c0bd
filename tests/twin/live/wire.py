"""What the tests of live feeds and views share: a wire without waiting, and a view."""

import contextlib
import importlib.util
import os
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.live.sessions.simulated import SimulationSetup
from twin.logs.log import Log, recorded_runs
from twin.logs.wire.feed import Feed
from twin.particulars import Particulars
from usv_gym import SeaState, Vessel


def load_example(path: str) -> Any:
    """Return an example as a module; ``path`` is below the folder of examples."""
    place = Path(__file__).resolve().parents[3] / "examples" / path
    spec = importlib.util.spec_from_file_location(f"example_{place.stem}", place)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[module.__name__] = module
    spec.loader.exec_module(module)
    return module


example = load_example("replay.py")
"""What sends a log as a stream."""

RUN = recorded_runs()["boat1_usv_circle"]


class Wire:
    """Hands datagrams to a feed at times of a clock that stands still between them."""

    def __init__(self, kind: type[Feed], boat: Particulars, **options: Any) -> None:
        self.now = 0.0
        self.feed = kind(None, boat, clock=lambda: self.now, **options)
        self.rows: list[tuple[float, np.ndarray, np.ndarray]] = []

    def carry(self, datagrams: Iterable[Any], speed: float = 1.0) -> None:
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

    def replay(self, log: Log, stream: Any, speed: float) -> Counter[str]:
        counts: Counter[str] = Counter()
        self.carry(example.schedule(log, stream, counts=counts), speed)
        self.take(after=1.0)
        return counts

    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        t, z, cmd = zip(*self.rows, strict=True)
        return np.array(t), np.array(z), np.array(cmd)

    def balance(self) -> dict[str, int]:
        """Return the counts above 0; each message counts in one way."""
        counts = self.feed.counts
        ways = ("used", "late", "doubled", "broken", "void", "unknown")
        assert counts["received"] == sum(counts[way] for way in ways)
        return {name: count for name, count in counts.items() if count}


def is_heartbeat(datagram: Any) -> bool:
    """Return whether a datagram is a HEARTBEAT of MAVLink, which has no time."""
    return datagram.data[:1] == b"\xfd" and datagram.data[7] == 0


def disturbed(
    datagrams: Iterable[Any], rng: np.random.Generator, counts: Counter[str]
) -> list[Any]:
    """Return datagrams of which a twentieth each is late, doubled, broken or overtaken."""
    found = list(datagrams)
    end, made, k = found[-1].due - 2.0, [], 0
    while k < len(found):
        one = found[k]
        way = ("late", "doubled", "broken", "swapped", "")[min(int(20.0 * rng.random()), 4)]
        if is_heartbeat(one) or one.due > end:
            way = ""
        counts[way] += one.messages if way != "broken" else 1
        if way == "swapped":  # the next one of a later time overtakes it
            later = next(
                j
                for j in range(k + 1, len(found))
                if found[j].due > one.due and not is_heartbeat(found[j])
            )
            made += found[k + 1 : later + 1]
            one, k = replace(one, due=found[later].due), later
        elif way == "late":
            one = replace(one, due=one.due + 1.0)
        elif way == "doubled":
            made.append(one)
        elif way == "broken":
            wrong = bytearray(one.data)
            wrong[int(rng.integers(10, 14))] ^= 1  # of the first message
            one = replace(one, data=bytes(wrong))
        made.append(one)
        k += 1
    return sorted(made, key=lambda each: each.due)


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    with socket.socket(socket.AF_INET, kind) as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


def wait(condition: Callable[[], Any], seconds: float = 60.0) -> Any:
    """Return what a condition says once it is true."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)
    return found


def setup(**options: object) -> SimulationSetup:
    """Return a usv75 in sea state 2, with options."""
    given = {"vessel": Vessel.load("usv75"), "sea": SeaState.named("2"), "seed": 5}
    return SimulationSetup(**(given | options))  # type: ignore[arg-type]


@contextlib.contextmanager
def viewing(folder: Path, *arguments: str) -> Iterator[tuple[Any, list[str]]]:
    """Run ``usv-twin view``; yield its process and its lines up to that with its address."""
    with subprocess.Popen(
        [sys.executable, "-m", "twin.cli", "view", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    ) as process:
        said = []
        for line in process.stdout:
            said.append(line)
            if "look at" in line:
                break
        yield process, said
