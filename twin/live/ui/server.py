"""The server of a view: viser's, with a check of each request and of each message."""

from __future__ import annotations

import contextlib
import functools
import io
import logging
from collections.abc import Callable, Iterator
from typing import Any

import viser
from websockets.asyncio import server as websockets_server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from twin.live.ui.access import Access, AccessError
from twin.live.ui.messages import RefusedError, checked

__all__ = [
    "start_server",
]

LARGEST = 1 << 16
"""Bytes of the largest message that a browser may send: a pose of its camera has 300."""

PROTOCOL = f"viser-v{viser.__version__}"


def start_server(access: Access, port: int, report: Callable[[str], None]) -> viser.ViserServer:
    """Start viser's server at the host of an access, and at a port or the next free one.

    ``report`` is given the reason when a browser sends what no control offers.

    Raises
    ------
    AccessError
        If this release of viser does not serve in a way that can be checked.
    """
    found: list[viser.ViserServer] = []

    class Connection(ServerConnection):
        """A WebSocket that hands on what passes the check."""

        async def recv(self, decode: bool | None = None) -> Any:
            while True:
                raw = await super().recv(decode)
                try:
                    return checked(found[0].gui, raw)
                except RefusedError as error:
                    report(f"refused what a browser sent: {error}")

    with (
        _served_by(access, Connection) as count,
        # the server prints its address; the command does so in one line
        contextlib.redirect_stdout(io.StringIO()),
    ):
        server = viser.ViserServer(host=access.host, port=port, label="usv-twin", verbose=False)
    found.append(server)
    if not count:
        server.stop()
        raise AccessError(
            f"viser {viser.__version__} serves without our checks; install another: "
            "pip install viser==1.1.1"
        )
    return server


@contextlib.contextmanager
def _served_by(access: Access, connection: type[ServerConnection]) -> Iterator[list[int]]:
    """Let viser, which has no hook for it, start its server with our checks; yield its starts."""
    plain, count = websockets_server.serve, []

    def serve(
        handler: Any, *arguments: Any, process_request: Callable[..., Any], **options: Any
    ) -> Any:
        count.append(1)
        options |= {
            "process_request": functools.partial(_answer, access, process_request),
            "create_connection": connection,
            "max_size": LARGEST,
            "logger": _silent(),
        }
        return plain(handler, *arguments, **options)

    websockets_server.serve = serve  # type: ignore[assignment, misc]
    try:
        yield count
    finally:
        websockets_server.serve = plain  # type: ignore[misc]


def _answer(
    access: Access,
    pages: Callable[[ServerConnection, Request], Response | None],
    connection: ServerConnection,
    request: Request,
) -> Response | None:
    """Refuse a request, or let viser answer it."""
    try:
        refused = access.refusal(connection, request)
        if refused is not None:
            return refused
        if request.headers.get("Upgrade", "").lower() == "websocket":
            # another release's page, or none of viser's
            offered = request.headers.get("Sec-WebSocket-Protocol", "")
            known = PROTOCOL in [one.strip() for one in offered.split(",")]
            return None if known else connection.respond(400, "Load the page again.\n")
        response = pages(connection, request)
        if response is not None:
            response.headers.update(access.headers(connection, request))
        return response
    except Exception:  # two headers of a name, a path that is none
        return connection.respond(400, "This request cannot be read.\n")


def _silent() -> logging.Logger:
    """Return a logger that says nothing: anybody can send a request that is none."""
    logger = logging.getLogger("usv_twin.view")
    logger.addHandler(logging.NullHandler())
    logger.propagate = False
    return logger
