"""An autopilot that speaks ArduPilot's JSON interface, and parses as strictly as ArduPilot does."""

import math
import re
import struct
from collections.abc import Callable
from typing import NamedTuple

NUMBER = r"-?\d+(?:\.\d+)?(?:e-?\d+)?"
VECTOR = rf"\[({NUMBER}),({NUMBER}),({NUMBER})\]"
# section, key and form, as libraries/SITL/SIM_JSON.h lists them; no blank may follow a colon
FIELDS = {
    "timestamp": rf'"timestamp":({NUMBER})',
    "gyro": rf'"imu":\{{[^}}]*"gyro":{VECTOR}',
    "force": rf'"imu":\{{[^}}]*"accel_body":{VECTOR}',
    "place": rf'"position":{VECTOR}',
    "attitude": rf'"attitude":{VECTOR}',
    "velocity": rf'"velocity":{VECTOR}',
}


class Seen(NamedTuple):
    """What an autopilot reads in an answer."""

    t: float
    gyro: tuple[float, ...]
    force: tuple[float, ...]
    place: tuple[float, ...]
    attitude: tuple[float, ...]
    velocity: tuple[float, ...]


def parse(data: bytes) -> Seen:
    """Return an answer, or fail where ArduPilot would."""
    text = data.decode("ascii")
    assert text.startswith("\n") and text.endswith("\n") and text.count("\n") == 2
    found = []
    for name, form in FIELDS.items():
        match = re.search(form, text)
        assert match, f"Failed to parse {name}: {text}"
        values = tuple(float(value) for value in match.groups())
        assert all(map(math.isfinite, values))
        found.append(values if len(values) == 3 else values[0])
    return Seen(*found)  # type: ignore[arg-type]


class FakeAutopilot:
    """Sends pulse widths by ``ask``, which carries a datagram there and its answer back."""

    def __init__(self, ask: Callable[[bytes], bytes | None], *, wide: bool = False) -> None:
        self.ask, self.wide = ask, wide
        self.count, self.last = 0, 0.0
        self.seen: list[Seen] = []

    def packet(self, widths: dict[int, int], rate: int = 1200) -> bytes:
        """Return a packet with the widths of some outputs, from 1; the others are unused."""
        outputs = 32 if self.wide else 16
        values = [widths.get(i + 1, 0) for i in range(outputs)]
        magic = 29569 if self.wide else 18458
        return struct.pack(f"<HHI{outputs}H", magic, rate, self.count, *values)

    def step(self, widths: dict[int, int]) -> Seen:
        """Send one packet, and take its answer as ArduPilot does."""
        reply = self.ask(self.packet(widths))
        assert reply is not None
        seen = parse(reply)
        assert 0.0 < seen.t - self.last < 0.1
        self.count, self.last = self.count + 1, seen.t
        self.seen.append(seen)
        return seen

    def wait(self, seconds: float) -> None:
        """Stay disarmed: 1500 us before the parameters are read, then no pulses."""
        until = self.last + seconds
        for output in range(1, 17):
            self.step(dict.fromkeys(range(1, output), 1500))
        while self.last < until:
            self.step({})

    def hold(self, heading: float, seconds: float, throttle: int = 1650) -> None:
        """Hold a heading by a P controller on output 1, with output 3 as the throttle."""
        until = self.last + seconds
        while self.last < until:
            yaw, rate = self.seen[-1].attitude[2], self.seen[-1].gyro[2]
            error = math.remainder(heading - yaw, 2.0 * math.pi)
            helm = min(max(2.0 * error - 3.0 * rate, -1.0), 1.0)
            self.step({1: round(1500 + 400 * helm), 3: throttle})
