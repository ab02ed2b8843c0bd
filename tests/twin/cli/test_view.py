"""What ``usv-twin view`` says of who can connect."""

from __future__ import annotations

import http.client
import re
import signal
import socket
import subprocess
import sys

import pytest

pytest.importorskip("viser", reason="needs viser: pip install 'usv-twin[view]'")

from tests.twin.live.wire import free_port, viewing


def status(port: int, path: str) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    connection.request("GET", path)
    with connection.getresponse() as answer:
        found = answer.status
    connection.close()
    return found


def test_a_view_that_others_reach_says_what_is_open_and_has_a_token(tmp_path):
    port = free_port(socket.SOCK_STREAM)
    options = ["--host", "0.0.0.0", "--port", str(port), "-p", "persistence"]
    with viewing(tmp_path, *options) as (process, said):
        path = re.search(rf"http://localhost:{port}(/\?token=[A-Za-z0-9_-]+)", said[-1]).group(1)
        answers = [status(port, "/"), status(port, path), status(port, f"{path}x")]
        process.send_signal(signal.SIGINT)
        complained = process.communicate(timeout=60)[1]
    assert "0.0.0.0 is open to other machines, without encryption" in "".join(said)
    assert "use the controls of its page, and record logs" in "".join(said)
    assert answers == [403, 200, 403]
    assert process.returncode == 0
    assert "Traceback" not in complained and "rror" not in complained


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--token", "short"], "--token: use 8 to 128 letters"),
        (["--reply", "udp://:10111"], "--reply goes with --nmea"),
        (["--host", ""], "--host : cannot listen there"),
    ],
)
def test_an_option_that_cannot_be_used_is_one_line(options, words, tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "twin.cli", "view", "-p", "persistence", *options],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=300,
    )
    assert done.returncode == 2 and done.stderr.startswith(f"error: {words}")
    assert done.stderr.count("\n") == 1
