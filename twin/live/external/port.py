"""A UDP port at which an autopilot's MAVLink messages arrive, and answers leave."""

from __future__ import annotations

from collections.abc import Iterable

from twin.live.external.peer import AutopilotPeer
from twin.live.protocols.sockets import Address, needed, open_socket

__all__ = ["MavlinkPort"]

DATAGRAMS_MAX = 200
"""So many datagrams are read at most in one call; the rest waits for the next."""


class MavlinkPort:
    """Hears one autopilot at ``udp://HOST:PORT``, and answers to where it speaks from.

    ``counts`` has the messages that came, those that were broken, and the datagrams sent and
    unsent. Nothing that comes over the wire raises.
    """

    def __init__(self, address: str, peer: AutopilotPeer) -> None:
        self.peer = peer
        self._parser = needed("pymavlink.dialects.v20.ardupilotmega").MAVLink(None)
        self._parser.robust_parsing = True
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
