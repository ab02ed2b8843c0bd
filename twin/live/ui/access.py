"""Who may see a view and steer its boat: browsers of this machine, or those with a token."""

from __future__ import annotations

import hmac
import ipaddress
import re
import secrets
import socket
from dataclasses import dataclass
from urllib.parse import parse_qs, urlsplit

from websockets.datastructures import Headers
from websockets.http11 import Request

from usv_kernel.errors import UsvTwinError

__all__ = [
    "Access",
    "AccessError",
    "check_host",
    "is_loopback",
]

TOKEN = re.compile(r"[A-Za-z0-9_-]{8,128}")


class AccessError(UsvTwinError):
    """An option that says who may connect and cannot be used; the message names the remedy."""


@dataclass(frozen=True)
class Access:
    """Decides on each HTTP request and each WebSocket of a server.

    A page of another site can send requests to a server on this machine: its browser then states
    the ``Origin`` of that page, which is not the ``Host`` it asks. A site that lets its own name
    point here has that name as ``Host``; it passes with a token alone, which it does not know.

    Parameters
    ----------
    host : str
        Address that the server listens at.
    token : str or None
        What each browser must present once, in the address; it is kept in a cookie. None: only
        names of loopback are answered.
    """

    host: str = "127.0.0.1"
    token: str | None = None

    @classmethod
    def of(cls, host: str, token: str | None = None) -> Access:
        """Return the access to a server at a host, with a new token where others can reach it.

        Raises
        ------
        AccessError
            For a token that cannot stand in an address.
        """
        if token is not None and not TOKEN.fullmatch(token):
            raise AccessError(
                "--token: use 8 to 128 letters, digits, - or _, or leave it out to have one made"
            )
        if token is None and not is_loopback(host):
            token = secrets.token_urlsafe(24)
        return cls(host, token)

    def refusal(self, request: Request) -> str | None:
        """Return why a request is refused; None where it may go on."""
        host = request.headers["Host"].lower()
        if any(urlsplit(one.lower()).netloc != host for one in request.headers.get_all("Origin")):
            return "Pages of another site may not use this view."
        given = parse_qs(request.path.partition("?")[2], keep_blank_values=True)
        if not set(given) <= {"token"}:
            # viser's page would connect to any server that they name, and run its scripts
            return "This view takes no parameter but its token."
        if self.token is None:
            if not is_loopback(urlsplit(f"//{host}").hostname or ""):
                return "This view does not go by that name; start it with --token for others."
        elif not self._is_token(*given.get("token", ()), *self._cookies(request.headers)):
            return "This view needs its token: open the address that usv-twin has printed."
        return None

    def headers(self, request: Request) -> dict[str, str]:
        """Return what an answer says of who may frame or read it, and the cookie with the token."""
        found = {
            "Content-Security-Policy": "frame-ancestors 'none'",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Referrer-Policy": "no-referrer",
            "Cache-Control": "no-store",
        }
        if self.token is not None and "?" in request.path:
            cookie = f"{self._cookie(request.headers)}={self.token}"
            found["Set-Cookie"] = f"{cookie}; Path=/; HttpOnly; SameSite=Strict"
        return found

    def _cookies(self, headers: Headers) -> list[str]:
        """Return the values of our cookie."""
        parts = (part.strip() for line in headers.get_all("Cookie") for part in line.split(";"))
        name = self._cookie(headers)
        return [value for key, _, value in (part.partition("=") for part in parts) if key == name]

    def _cookie(self, headers: Headers) -> str:
        """Return the name of the cookie; browsers share cookies among the ports of a host."""
        return "usv-twin-" + re.sub(r"[^a-z0-9]", "-", headers["Host"].lower())

    def _is_token(self, *given: str) -> bool:
        """Return whether one of these is the token."""
        own = str(self.token).encode()
        return any(hmac.compare_digest(one.encode(), own) for one in given)


def is_loopback(host: str) -> bool:
    """Return whether a name or address is one of loopback, which only this machine reaches."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


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
