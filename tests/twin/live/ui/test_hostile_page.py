"""A page of another site, in a real browser, against a view on the same machine."""

from __future__ import annotations

import contextlib
import http.server
import json
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

viser = pytest.importorskip("viser", reason="needs viser: pip install 'usv-twin[view]'")

from tests.twin.live.ui.test_viewer import setup, wait  # noqa: E402
from twin.live.sessions.simulated import SimulatedSession  # noqa: E402

PAGE = """<!doctype html><title>working</title><body><script>
const [view, protocol, own] = %s, found = {};
const attempt = (name, promise) => promise.then(
  () => { found[name] = "open" }, () => { found[name] = "refused" });
const loaded = (tag, url) => new Promise((yes, no) => {
  const one = document.createElement(tag);
  one.onload = yes; one.onerror = no; one.src = url; document.body.append(one);
});
const socket = (url) => new Promise((yes, no) => {
  const one = new WebSocket(url, [protocol]);
  one.onopen = yes; one.onerror = no;
});
Promise.all([
  attempt("socket", socket(view.replace("http", "ws"))),
  attempt("socket by name", socket(view.replace("http://127.0.0.1", "ws://localhost"))),
  attempt("fetch", fetch(view)),
  attempt("blind fetch", fetch(view, {mode: "no-cors"})),
  attempt("script", loaded("script", view)),
  loaded("iframe", view),
]).finally(() => { document.title = JSON.stringify(found) });
</script>"""


class Hostile(http.server.BaseHTTPRequestHandler):
    """Serves the hostile page, and notes each request."""

    def do_GET(self) -> None:
        self.server.asked.append(self.headers.get("Upgrade", self.path))
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(self.server.page.encode())

    def log_message(self, *_arguments: object) -> None:
        pass


@contextlib.contextmanager
def hostile(view: str) -> Iterator[tuple[str, list[str]]]:
    """Serve the page at another port; yield its address and what was asked of it."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Hostile)
    url, server.asked = f"http://127.0.0.1:{server.server_port}", []
    server.page = PAGE % json.dumps([view, f"viser-v{viser.__version__}", url])
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield url, server.asked
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def test_a_page_of_another_site_neither_reads_nor_steers(browser, served, tmp_path: Path):
    session = SimulatedSession(setup(predictor="persistence"), tmp_path)
    viewer = served(session)
    driver = browser(flags=("--host-resolver-rules=MAP evil.test 127.0.0.1",))
    with hostile(viewer.url) as (url, asked):
        # from another port of this machine, and from a site that lets its name point here
        for place in (url, url.replace("127.0.0.1", "evil.test")):
            driver.get(place)
            wait(lambda: driver.title.startswith("{"))
            found = json.loads(driver.title)
            # an answer that the page cannot read tells it nothing: it is a refusal
            assert {found.pop(name) for name in ("blind fetch", "script")} <= {"open", "refused"}
            assert found == dict.fromkeys(("socket", "socket by name", "fetch"), "refused")
            frame = driver.find_element("tag name", "iframe")
            driver.switch_to.frame(frame)
            assert driver.find_elements("css selector", "#root, #status") == []
            driver.switch_to.default_content()
        assert not viewer.server.get_clients()
        # the view under the hostile name: its page would have that site's rights
        driver.get(viewer.url.replace("127.0.0.1", "evil.test"))
        assert "does not go by that name" in driver.page_source
        # viser's own page, sent to the hostile server by its address
        asked.clear()
        driver.get(f"{viewer.url}/?websocket={url.replace('http', 'ws')}")
        assert "takes no parameters" in driver.page_source
        assert asked == []
    assert session.error is None
