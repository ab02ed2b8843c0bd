"""UDP sockets of the live protocols, and their addresses."""

from __future__ import annotations

import contextlib
import importlib
import socket
from typing import Any
from urllib.parse import urlsplit

from usv_kernel.errors import UsvTwinError

__all__ = ["Address", "FeedError", "needed", "open_socket", "parse_address"]

Address = tuple[Any, ...]


class FeedError(UsvTwinError):
    """A feed that cannot be opened; the message names the address and the remedy."""


def needed(module: str) -> Any:
    """Return a module of the extra ``view``, or say how to install it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise ImportError(
            f"the live view and its feeds need {module.partition('.')[0]}, which is not installed; "
            "install it with: pip install 'usv-twin[view]'"
        ) from None


def parse_address(address: str) -> tuple[str, int]:
    """Return host and port of ``udp://HOST:PORT``; without a host, that of loopback.

    IPv6 hosts are written ``udp://[::1]:10110``.
    """
    try:
        parts = urlsplit(address)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(""), None
    more = parts.path or parts.query or parts.fragment or parts.username is not None
    if parts.scheme != "udp" or not port or more:
        raise FeedError(f"{address}: write udp://HOST:PORT, as udp://:10110 for this machine alone")
    return parts.hostname or "127.0.0.1", port


def open_socket(address: str, *, bind: bool) -> tuple[socket.socket, Address]:
    """Return a UDP socket that never blocks, to listen (``bind``) or to send, and its address."""
    host, port = parse_address(address)
    try:
        known = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        family, found = known[0], known[4]
    except (OSError, UnicodeError) as error:
        raise FeedError(f"{address}: the host is not known ({error}); check its name") from None
    made = socket.socket(family, socket.SOCK_DGRAM)
    made.setblocking(False)
    # instruments are often on a broadcast address
    made.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    if bind:
        with contextlib.suppress(OSError):  # as much as the system grants
            made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        try:
            made.bind(found)
        except OSError as error:
            made.close()
            raise FeedError(
                f"{address}: cannot listen there ({error.strerror}); stop what uses the port, or "
                "name another port, or an address of this machine"
            ) from None
    return made, found
