"""An autopilot at a UDP port: what it says of itself in MAVLink, and answers to it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from twin.live.protocols.mavlink import AUTOPILOT, new_parser
from twin.logs.wire.sockets import Address, open_socket

__all__ = ["ACCEPTED", "HOLD", "AutopilotPeer", "MavlinkPort"]

ARMED = 128
"""Flag MAV_MODE_FLAG_SAFETY_ARMED."""

HOLD = 4
"""Mode of ArduPilot's Rover."""

ACCEPTED = 0
"""MAV_RESULT_ACCEPTED."""

FAILSAFE = "EKF failsafe"
"""What ArduPilot says when its EKF fails."""

DATAGRAMS_MAX = 200
"""Most datagrams that one call reads; the rest waits for the next."""


class AutopilotPeer:
    """The autopilot that is followed: the first one whose heartbeat comes.

    Attributes
    ----------
    system : int or None
        Its system; None before its first heartbeat.
    armed : bool
    mode : int or None
        Custom mode of ArduPilot's Rover.
    origin : tuple of float or None
        Latitude and longitude of its local frame, degrees.
    results : dict of int to int
        Result of the last answer to each command that it answered.
    parameters : dict of str to float
        Parameters that it has stated.
    failed : bool
        Whether it said that its EKF has failed.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Forget all that it said."""
        self.system: int | None = None
        self.armed = False
        self.mode: int | None = None
        self.origin: tuple[float, float] | None = None
        self.results: dict[int, int] = {}
        self.parameters: dict[str, float] = {}
        self.failed = False

    def hear(self, item: Any) -> None:
        """Take a message of pymavlink; those of others are passed over."""
        if item.get_srcComponent() != AUTOPILOT:
            return
        kind = item.get_type()
        if self.system is None and kind == "HEARTBEAT":
            self.system = item.get_srcSystem()
        if item.get_srcSystem() != self.system:
            return
        if kind == "HEARTBEAT":
            self.armed = bool(item.base_mode & ARMED)
            self.mode = int(item.custom_mode)
        elif kind == "GPS_GLOBAL_ORIGIN":
            place = item.latitude / 1e7, item.longitude / 1e7
            if any(place) and abs(place[0]) <= 90.0 and abs(place[1]) <= 180.0:
                self.origin = place
        elif kind == "COMMAND_ACK":
            self.results[int(item.command)] = int(item.result)
        elif kind == "PARAM_VALUE":
            self.parameters[str(item.param_id)] = float(item.param_value)
        elif kind == "STATUSTEXT":
            self.failed |= FAILSAFE in str(item.text)


class MavlinkPort:
    """Hears one autopilot at ``udp://HOST:PORT``, and answers to where it speaks from.

    ``counts`` has the messages that came, those that were broken, and the datagrams sent and
    unsent. Nothing that comes over the wire raises.
    """

    def __init__(self, address: str, peer: AutopilotPeer) -> None:
        self.peer = peer
        self._parser = new_parser()
        self.counts = dict.fromkeys(("received", "broken", "sent", "unsent"), 0)
        self._socket = open_socket(address, bind=True)[0]
        self._target: Address | None = None

    @property
    def port(self) -> int:
        """Number of the port."""
        return int(self._socket.getsockname()[1])

    def poll(self) -> None:
        """Take what has come."""
        for _ in range(DATAGRAMS_MAX):
            try:
                data, source = self._socket.recvfrom(1 << 16)
            except BlockingIOError:
                return
            except OSError:  # an earlier answer was refused
                continue
            for item in self._parser.parse_buffer(data) or ():
                self.counts["received"] += 1
                if item.get_type() == "BAD_DATA":
                    self.counts["broken"] += 1
                    continue
                self.peer.hear(item)
                if item.get_srcSystem() == self.peer.system:
                    self._target = source

    def send(self, datagrams: Iterable[bytes]) -> None:
        """Send datagrams to the autopilot, once it is known."""
        for data in datagrams:
            if self._target is None:
                continue
            try:
                self._socket.sendto(data, self._target)
                self.counts["sent"] += 1
            except OSError:
                self.counts["unsent"] += 1

    def close(self) -> None:
        """Let go of the port."""
        self._socket.close()
