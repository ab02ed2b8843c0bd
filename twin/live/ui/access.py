"""Who may see a view and steer its boat: pages that it served to browsers of this machine."""

from __future__ import annotations

import ipaddress
from urllib.parse import urlsplit

from websockets.http11 import Request

from usv_kernel.errors import UsvTwinError

__all__ = [
    "HEADERS",
    "AccessError",
    "refusal",
]

HEADERS = {
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
"""What an answer says of who may frame or read it."""


class AccessError(UsvTwinError):
    """A server whose requests cannot be checked; the message names the remedy."""


def refusal(request: Request) -> str | None:
    """Return why a request, of HTTP or for a WebSocket, is refused; None where it may go on.

    A page of another site can send requests to a server on this machine: its browser then states
    the ``Origin`` of that page, which is not the ``Host`` it asks. A site that lets its own name
    point here has that name as ``Host``.
    """
    host = request.headers["Host"].lower()
    if any(urlsplit(one.lower()).netloc != host for one in request.headers.get_all("Origin")):
        return "Pages of another site may not use this view."
    if "?" in request.path:
        # viser's page would connect to any server that is named there, and run its scripts
        return "This view takes no parameters."
    if not _is_loopback(urlsplit(f"//{host}").hostname or ""):
        return "This view does not go by that name: open it as localhost, through a tunnel or not."
    return None


def _is_loopback(host: str) -> bool:
    """Return whether a name or address is one of loopback, which only this machine reaches."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"
