"""Who may see a view and steer its boat: names of the server, further origins, and a token."""

from __future__ import annotations

import hmac
import ipaddress
import re
import secrets
import socket
from collections.abc import Iterable
from dataclasses import dataclass
from urllib.parse import parse_qs, urlsplit

from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from usv_kernel.errors import UsvTwinError

__all__ = [
    "Access",
    "AccessError",
    "check_host",
    "is_loopback",
]

LOOPBACK = ("localhost", "127.0.0.1", "::1")

PORTS = {"http": 80, "https": 443}
"""Ports that browsers leave out."""

TOKEN = re.compile(r"[A-Za-z0-9_-]{8,128}")


class AccessError(UsvTwinError):
    """An option that says who may connect and cannot be used; the message names the remedy."""


@dataclass(frozen=True)
class Access:
    """Decides on each HTTP request and each WebSocket of a server, by what browsers say of it.

    A page of another site can send requests to a server on this machine. Its browser then states
    the ``Origin`` of that page, and as ``Host`` the name by which it found the server.

    Parameters
    ----------
    host : str
        Address that the server listens at. Its name and those of loopback are its own, and so is
        the address at which a request arrives; each with the server's port.
    origins : frozenset of str
        Further origins, as ``https://boat.example``: pages that may connect, and names of this
        server behind a proxy.
    token : str or None
        What each browser must present once, in the address; it is kept in a cookie. None: nothing.
    """

    host: str = "127.0.0.1"
    origins: frozenset[str] = frozenset()
    token: str | None = None

    @classmethod
    def of(cls, host: str, origins: Iterable[str] = (), token: str | None = None) -> Access:
        """Return the access to a server at a host, with a new token where others can reach it.

        Raises
        ------
        AccessError
            For an origin or a token that cannot stand in an address.
        """
        if token is not None and not TOKEN.fullmatch(token):
            raise AccessError(
                "--token: use 8 to 128 letters, digits, - or _, or leave it out to have one made"
            )
        if token is None and not is_loopback(host):
            token = secrets.token_urlsafe(24)
        return cls(host, frozenset(_origin(one) for one in origins), token)

    def refusal(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the answer to a request that is refused; None where it may go on."""
        address, port = connection.local_address[:2]
        names = {*LOOPBACK, self.host.lower(), str(address).partition("%")[0]}
        own = {_netloc(name, port) for name in names}
        known = own | {urlsplit(origin).netloc for origin in self.origins}
        headers = request.headers
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or hosts[0].lower() not in known:
            return connection.respond(
                403,
                "This view does not go by that name. --allow-origin http://NAME:PORT adds it.\n",
            )
        allowed = {f"http://{name}" for name in own} | self.origins
        if not all(origin.lower() in allowed for origin in origins) or (
            not origins and _is_foreign(headers)
        ):
            return connection.respond(
                403, "Pages of another site may not use this view. --allow-origin adds a site.\n"
            )
        query = _query(request)
        if query is None:
            return connection.respond(400, "This view takes no parameter but its token.\n")
        if self.token is not None and not self._presents(headers, query, port):
            return connection.respond(
                403, "This view needs its token: open the address that usv-twin has printed.\n"
            )
        return None

    def headers(self, connection: ServerConnection, request: Request) -> dict[str, str]:
        """Return what an answer says of where its page may connect to, and who may frame it."""
        port = connection.local_address[1]
        host = request.headers["Host"].lower()
        frames = " ".join(["'self'", *sorted(self.origins)])
        sources = f"'self' ws://{host} wss://{host} data: blob:"
        found = {
            # the page of viser holds its scripts, and connects where its address says
            "Content-Security-Policy": "default-src 'self' data: blob:; script-src 'self' "
            "'unsafe-inline' 'unsafe-eval' data: blob:; style-src 'self' 'unsafe-inline'; "
            f"connect-src {sources}; base-uri 'none'; form-action 'none'; object-src 'none'; "
            f"frame-ancestors {frames}",
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cache-Control": "no-store",
        }
        if self.token is not None and _query(request):
            found["Set-Cookie"] = f"{_cookie(port)}={self.token}; Path=/; HttpOnly; SameSite=Strict"
        return found

    def _presents(self, headers: Headers, query: list[str], port: int) -> bool:
        """Return whether a request has the token, in its address or as a cookie."""
        cookies = (part.strip() for line in headers.get_all("Cookie") for part in line.split(";"))
        found = [part.partition("=")[2] for part in cookies if part.startswith(f"{_cookie(port)}=")]
        own = str(self.token).encode()
        return any(hmac.compare_digest(one.encode(), own) for one in (*query, *found))


def is_loopback(host: str) -> bool:
    """Return whether only this machine reaches a server at a host."""
    try:
        found = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        return False
    places = (str(one[4][0]).partition("%")[0] for one in found)
    return all(ipaddress.ip_address(place).is_loopback for place in places)


def check_host(host: str) -> None:
    """Refuse an address that is none of this machine: the server would wait for ever."""
    try:
        found = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(*found[:3]) as one:
            one.bind(found[4])
    except (OSError, UnicodeError) as error:
        raise OSError(
            f"--host {host}: cannot listen there ({error}); use 127.0.0.1, 0.0.0.0 or an address "
            "of this machine"
        ) from None


def _is_foreign(headers: Headers) -> bool:
    """Return whether a page of another site asks for a part, as an image or a script."""
    site, mode = headers.get_all("Sec-Fetch-Site"), headers.get_all("Sec-Fetch-Mode")
    return mode != ["navigate"] and not set(site) <= {"none", "same-origin"}


def _query(request: Request) -> list[str] | None:
    """Return the tokens of an address; None where it has other parameters.

    Viser's page would connect to any server that its parameters name, and run its scripts.
    """
    found = parse_qs(request.path.partition("?")[2], keep_blank_values=True)
    return found.get("token", []) if set(found) <= {"token"} else None


def _cookie(port: int) -> str:
    """Return the name of the cookie; browsers share cookies among the ports of a host."""
    return f"usv-twin-{port}"


def _netloc(name: str, port: int | None, scheme: str = "http") -> str:
    """Return a name and a port as browsers write them."""
    name = f"[{name}]" if ":" in name else name
    return name if port is None or port == PORTS[scheme] else f"{name}:{port}"


def _origin(text: str) -> str:
    """Return an origin as browsers write it."""
    try:
        parts = urlsplit(text.lower())
        port = parts.port
    except ValueError:
        parts, port = urlsplit(""), None
    rest = parts.path.strip("/") or parts.query or parts.fragment or parts.username
    if parts.scheme not in PORTS or not parts.hostname or rest or not parts.hostname.isascii():
        raise AccessError(
            f"--allow-origin {text}: write scheme, name and port, as http://boat.local:8080"
        )
    return f"{parts.scheme}://{_netloc(parts.hostname, port, parts.scheme)}"
