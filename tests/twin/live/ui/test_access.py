"""Which HTTP requests and WebSockets a view answers."""

import contextlib
import http.client
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

viser = pytest.importorskip("viser", reason="needs viser: pip install 'usv-twin[view]'")

from tests.twin.live.wire import setup, wait  # noqa: E402
from twin.live.sessions.simulated import SimulatedSession  # noqa: E402
from twin.live.ui import server  # noqa: E402
from twin.live.ui.access import AccessError  # noqa: E402
from twin.live.ui.viewer import Viewer  # noqa: E402

UPGRADE = {
    **{"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"},
    **{"Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA=="},
    "Sec-WebSocket-Protocol": f"viser-v{viser.__version__}",
}


@pytest.fixture
def viewer(served: Callable[..., Viewer], tmp_path: Path) -> Callable[..., Viewer]:
    """Return a function that serves a boat."""
    return lambda: served(SimulatedSession(setup(predictor="persistence"), tmp_path))


def ask(
    viewer: Viewer, path: str = "/", host: str | None = None, **headers: str
) -> http.client.HTTPResponse:
    """Return the answer to a request with these headers; _ stands for -."""
    connection = http.client.HTTPConnection("127.0.0.1", viewer.port, timeout=30)
    with contextlib.closing(connection):
        connection.putrequest("GET", path, skip_host=True)
        connection.putheader("Host", f"127.0.0.1:{viewer.port}" if host is None else host)
        for name, value in headers.items():
            connection.putheader(name.replace("_", "-"), value)
        connection.endheaders()
        with connection.getresponse() as answer:
            return answer


def statuses(viewer: Viewer, path: str = "/", **headers: str) -> tuple[int, int]:
    """Return the answers to a page and to a WebSocket."""
    return ask(viewer, path, **headers).status, ask(viewer, path, **headers, **UPGRADE).status


def test_only_names_of_loopback_and_its_own_pages_are_answered(viewer):
    view = viewer()
    port = view.port
    for name in ("127.0.0.1", "localhost", "LOCALHOST", "[::1]"):
        for at in (port, 9000):  # that of a tunnel
            assert statuses(view, host=f"{name}:{at}") == (200, 101)
            assert statuses(view, host=f"{name}:{at}", Origin=f"http://{name}:{at}") == (200, 101)
    for host in (
        *("evil.test", f"evil.test:{port}", "192.0.2.1"),
        *("", f"localhost.evil.test:{port}", f"localhost:{port}@evil.test"),
    ):
        assert all(status in (400, 403) for status in statuses(view, host=host)), host
    assert statuses(view, host="evil.test", Origin="http://evil.test") == (403, 403)
    for origin in (
        *("http://evil.test", f"http://evil.test:{port}", f"http://localhost:{port + 1}", "null"),
        *("http://localhost", f"http://localhost:{port}.evil.test"),
        *("", "file://", f"http://127.0.0.1:{port}@evil.test"),
    ):
        assert statuses(view, Origin=origin) == (403, 403), origin
    assert view.session.error is None


def test_a_page_is_not_sent_elsewhere_by_its_address_nor_framed(viewer):
    view = viewer()
    for query in ("websocket=ws://evil.test", "playbackPath=http://evil.test/x", "x", "token=&x=1"):
        assert statuses(view, f"/?{query}") == (403, 403), query
    assert ask(view).headers["Content-Security-Policy"] == "frame-ancestors 'none'"


def test_requests_that_are_none_are_answered_without_a_word(viewer, capfd, caplog):
    view = viewer()
    wait(lambda: view.frames > 0)  # all that is compiled has been
    capfd.readouterr()
    host = f"Host: 127.0.0.1:{view.port}\r\n".encode()
    head = b" HTTP/1.1\r\n" + host
    protocol = b"Sec-WebSocket-Protocol: viser-v\x1b[31m[red]0\r\n"
    upgrade = b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    for raw in (
        b"\x16\x03\x01\x02\x00\x01",  # TLS
        b"\x00" * 100,
        b"GET\r\n\r\n",
        b"POST /" + head + b"\r\n",
        b"GET /%00" + head + b"\r\n",
        b"GET /" + b"a" * 5000 + head + b"\r\n",
        b"GET /%2e%2e/%2e%2e/etc/passwd" + head + b"\r\n",
        b"GET /\xff?\xfe" + head + b"\r\n",
        b"GET /" + head + host + b"\r\n",
        b"GET / HTTP/1.1\r\n\r\n",
        b"GET /" + head + b"Origin: a\r\nOrigin: b\r\n\r\n",
        b"GET /" + head + b"Upgrade: websocket\r\nUpgrade: websocket\r\n\r\n",
        b"GET /" + head + upgrade + b"\r\n",
        b"GET /" + head + upgrade + b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n" + protocol,
        b"GET /" + head + upgrade + b"Sec-WebSocket-Key: x\r\n" + protocol + b"\r\n",
    ):
        with socket.create_connection(("127.0.0.1", view.port), timeout=30) as one:
            one.sendall(raw)
            one.shutdown(socket.SHUT_WR)
            answer = one.recv(4096)
        assert not answer.startswith((b"HTTP/1.1 2", b"HTTP/1.1 1", b"HTTP/1.1 5")), raw[:60]
        assert b"root:" not in answer
    assert statuses(view) == (200, 101)
    wait(lambda: not view.server.get_clients())
    said = capfd.readouterr()
    assert said.out + said.err == "" and not caplog.get_records("call")


def test_a_viser_that_cannot_be_guarded_is_not_served(monkeypatch, tmp_path):
    from websockets.asyncio.server import serve

    class Other(viser.ViserServer):
        """Starts a server in another way."""

        def __init__(self, **options: object) -> None:
            server.websockets_server.serve = serve
            super().__init__(**options)

    monkeypatch.setattr(server.viser, "ViserServer", Other)
    with pytest.raises(AccessError, match="without our checks"):
        server.start_server(18000)
