"""A session that is served until the end of a test."""

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.twin.live.wire import free_port
from twin.live.sessions.session import Session


@pytest.fixture
def served() -> Iterator[Callable[..., Any]]:
    """Return a function that serves a session, with options of the viewer."""
    running = []

    def serve(session: Session, **options: Any) -> Any:
        from twin.live.ui.viewer import Viewer

        viewer = Viewer(session, port=free_port(socket.SOCK_STREAM), **options)

        def show() -> None:
            with contextlib.suppress(Stopped):
                viewer.serve()

        thread = threading.Thread(target=show)
        session.start()
        thread.start()
        running.append((session, viewer, thread))
        return viewer

    yield serve
    for session, viewer, thread in running:
        session.stop()
        assert session.error is None, session.error
        session.error = Stopped()
        session.fresh.set()
        thread.join()
        viewer.close()


class Stopped(Exception):
    """The test is over."""
