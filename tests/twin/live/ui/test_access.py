"""Which HTTP requests and WebSockets a view answers."""

from __future__ import annotations

import contextlib
import http.client
import logging
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

viser = pytest.importorskip("viser", reason="needs viser: pip install 'usv-twin[view]'")

from tests.twin.live.ui.test_viewer import setup, wait  # noqa: E402
from twin.live.sessions.simulated import SimulatedSession  # noqa: E402
from twin.live.ui import server  # noqa: E402
from twin.live.ui.access import Access, AccessError, check_host, is_loopback  # noqa: E402
from twin.live.ui.viewer import Viewer  # noqa: E402

UPGRADE = {
    **{"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"},
    **{"Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA=="},
    "Sec-WebSocket-Protocol": f"viser-v{viser.__version__}",
}


@pytest.fixture
def viewer(served: Callable[..., Viewer], tmp_path: Path) -> Callable[..., Viewer]:
    """Return a function that serves a boat to those whom an access allows."""
    return lambda *access: served(
        SimulatedSession(setup(predictor="persistence"), tmp_path),
        access=Access.of("127.0.0.1", *access),
    )


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


def test_only_names_of_the_server_and_its_own_pages_are_answered(viewer):
    view = viewer()
    port = view.port
    for name in ("127.0.0.1", "localhost", "LOCALHOST", "[::1]"):
        assert statuses(view, host=f"{name}:{port}") == (200, 101)
        assert statuses(view, Origin=f"http://{name}:{port}") == (200, 101)
    for host in (
        *("evil.test", f"evil.test:{port}", f"localhost:{port + 1}", "localhost", "127.0.0.1"),
        *("", f"localhost.evil.test:{port}", f"x@localhost:{port}", f"127.0.0.1:{port}.evil"),
    ):
        assert statuses(view, host=host) == (403, 403), host
    for origin in (
        *("http://evil.test", f"http://evil.test:{port}", f"http://localhost:{port + 1}", "null"),
        *(f"https://localhost:{port}", "http://localhost", f"http://localhost:{port}.evil.test"),
        *("", "file://", f"http://localhost:{port}@evil.test"),
    ):
        assert statuses(view, Origin=origin) == (403, 403), origin
    # a page of another site that asks for an image or a script states no origin
    for site in ("cross-site", "same-site"):
        assert ask(view, Sec_Fetch_Site=site, Sec_Fetch_Mode="no-cors").status == 403
        assert ask(view, Sec_Fetch_Site=site, Sec_Fetch_Mode="navigate").status == 200
    assert view.session.error is None


def test_an_allowed_origin_is_a_name_and_may_connect(viewer):
    view = viewer(["https://Boat.example:443/", "http://other.test:9000"])
    for origin in ("https://boat.example", "http://other.test:9000"):
        assert statuses(view, Origin=origin) == (200, 101)
        assert statuses(view, host=origin.partition("//")[2]) == (200, 101)
    assert statuses(view, Origin="http://boat.example") == (403, 403)
    assert "http://other.test:9000" in ask(view).headers["Content-Security-Policy"]


@pytest.mark.parametrize(
    "origin",
    ["*", "boat.example", "ftp://x", "http://", "http://x:99999", "http://x/y", "http://[x"],
)
def test_an_origin_that_is_none_is_refused_with_an_example(origin):
    with pytest.raises(AccessError, match=r"write scheme, name and port, as http://"):
        Access.of("127.0.0.1", [origin])


def test_a_token_is_asked_for_once_and_kept_in_a_cookie(viewer):
    view = viewer((), "secret-token")
    assert view.url.endswith("/?token=secret-token")
    for path in ("/", "/?token=", "/?token=secret-toke", "/?token=secret-token2", "/?token=%ff"):
        assert statuses(view, path) == (403, 403), path
    assert statuses(view, "/?token=secret-token") == (200, 101)
    given = ask(view, "/?token=secret-token").headers["Set-Cookie"]
    assert "HttpOnly" in given and "SameSite=Strict" in given
    cookie = given.partition(";")[0]
    assert cookie == f"usv-twin-{view.port}=secret-token"
    assert statuses(view, Cookie=f"a=b; {cookie}") == (200, 101)
    for wrong in ("usv-twin-1=secret-token", f"{cookie}x", "secret-token", ";=;", "\xff=\xff"):
        assert statuses(view, Cookie=wrong) == (403, 403), wrong
    # it opens no door for other pages
    assert statuses(view, Cookie=cookie, Origin="http://evil.test") == (403, 403)


def test_a_host_that_others_reach_has_a_token():
    made = [Access.of(host).token for host in ("0.0.0.0", "::", "192.0.2.1", "nosuch.invalid")]
    assert len(set(made)) == 4 and all(len(token) >= 32 for token in made)
    assert Access.of("0.0.0.0", (), "my-own-token").token == "my-own-token"
    for host in ("127.0.0.1", "localhost", "127.5.5.5"):
        assert is_loopback(host) and Access.of(host).token is None
    for wrong in ("", "short", "a b c d e f g", "x" * 129, "hi\nthere-you", "ä" * 10):
        with pytest.raises(AccessError, match="8 to 128 letters"):
            Access.of("127.0.0.1", (), wrong)


def test_a_server_for_all_goes_by_the_address_at_which_it_was_found(served, tmp_path):
    session = SimulatedSession(setup(predictor="persistence"), tmp_path)
    view = served(session, host="0.0.0.0")
    path = f"/?token={view.access.token}"
    assert statuses(view, path) == (200, 101)
    assert statuses(view, "/") == (403, 403)
    assert statuses(view, path, host=f"evil.test:{view.port}") == (403, 403)
    assert statuses(view, path, host=f"192.0.2.1:{view.port}") == (403, 403)


def test_a_page_is_not_sent_elsewhere_by_its_address(viewer):
    view = viewer()
    for query in ("websocket=ws://evil.test", "playbackPath=http://evil.test/x", "x", "token=&x=1"):
        assert statuses(view, f"/?{query}") == (400, 400), query
    policy = ask(view).headers["Content-Security-Policy"]
    assert f"connect-src 'self' ws://127.0.0.1:{view.port} " in policy
    assert "frame-ancestors 'self'" in policy and "default-src 'self' data: blob:;" in policy


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
        server.start_server(Access(), 18000, logging.info)


@pytest.mark.parametrize("host", ["", "nosuch.invalid", "203.0.113.9", "\0", "a" * 300])
def test_a_host_that_is_none_of_this_machine_is_refused(host):
    with pytest.raises(OSError, match="cannot listen there"):
        check_host(host)
