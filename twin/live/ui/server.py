"""The server of a view: viser's, with a check of each request."""

from __future__ import annotations

import contextlib
import io
import logging
from collections.abc import Callable, Iterator
from typing import Any

import viser
from websockets.asyncio import server as websockets_server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from twin.live.ui.access import HEADERS, AccessError, refusal

__all__ = [
    "start_server",
]

HOST = "127.0.0.1"


def start_server(port: int) -> viser.ViserServer:
    """Start viser's server on loopback, at a port or the next free one.

    Raises
    ------
    AccessError
        If this release of viser does not serve in a way that can be checked.
    """
    with (
        _checked() as starts,
        # the server prints its address; the command does so in one line
        contextlib.redirect_stdout(io.StringIO()),
    ):
        server = viser.ViserServer(host=HOST, port=port, label="usv-twin", verbose=False)
    if not starts:
        server.stop()
        raise AccessError(
            f"viser {viser.__version__} serves without our checks; install another: "
            "pip install viser==1.1.1"
        )
    return server


@contextlib.contextmanager
def _checked() -> Iterator[list[int]]:
    """Let viser, which has no hook for it, start its server with our check; yield its starts."""
    plain, starts = websockets_server.serve, []
    # anybody can send a request that is none
    silent = logging.getLogger("usv_twin.view")
    silent.addHandler(logging.NullHandler())
    silent.propagate = False

    def serve(handler: Any, *arguments: Any, process_request: Any, **options: Any) -> Any:
        starts.append(1)

        def answer(connection: ServerConnection, request: Request) -> Response | None:
            return _answer(process_request, connection, request)

        return plain(handler, *arguments, **options, process_request=answer, logger=silent)

    websockets_server.serve = serve  # type: ignore[assignment, misc]
    try:
        yield starts
    finally:
        websockets_server.serve = plain  # type: ignore[misc]


def _answer(
    pages: Callable[[ServerConnection, Request], Response | None],
    connection: ServerConnection,
    request: Request,
) -> Response | None:
    """Refuse a request, or let viser answer it."""
    try:
        refused = refusal(request)
        if refused is not None:
            return connection.respond(403, f"{refused}\n")
        response = pages(connection, request)
        if response is not None:
            response.headers.update(HEADERS)
        return response
    except Exception:  # no host or two of them, a path that is none
        return connection.respond(400, "This request cannot be read.\n")
