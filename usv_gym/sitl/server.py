"""The socket of a backend: datagrams of an autopilot come in, and answers go back."""

from __future__ import annotations

import socket

from usv_gym.sitl.backend import Backend, BackendError, port_of

__all__ = ["LOOPBACK", "Server"]

LOOPBACK = "127.0.0.1"


class Server:
    """A UDP port at which a backend answers.

    Parameters
    ----------
    backend : Backend
        What answers.
    host : str
        Address to listen at; of loopback unless another is named.
    port : int, optional
        Default: that of ArduPilot's first instance, see :func:`port_of`.

    Raises
    ------
    BackendError
        If nothing can listen there.
    """

    def __init__(self, backend: Backend, host: str = LOOPBACK, port: int | None = None) -> None:
        self.backend = backend
        port = port_of(0) if port is None else port
        try:
            known = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(known[0], socket.SOCK_DGRAM)
        except (OSError, UnicodeError) as error:
            raise BackendError(f"{host}: the address is not known ({error})") from None
        try:
            self._socket.bind(known[4])
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise BackendError(
                f"{host} port {port}: cannot listen there ({error}); stop what uses the port, "
                "or take another instance or an address of this machine"
            ) from None
        self.port = int(self._socket.getsockname()[1])

    def poll(self, timeout: float = 0.2) -> bool:
        """Answer one datagram, if one comes within a time (s); return whether one came."""
        self._socket.settimeout(timeout)
        try:
            data, source = self._socket.recvfrom(1 << 16)
        except TimeoutError:
            return False
        except OSError:  # an earlier answer was refused
            return True
        reply = self.backend.answer(data, source)
        if reply is not None:
            try:
                self._socket.sendto(reply, source)
            except OSError:
                self.backend.counts["unsent"] += 1
        return True

    def close(self) -> None:
        """Let go of the port."""
        self._socket.close()

    def __enter__(self) -> Server:
        """Return the server itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()
