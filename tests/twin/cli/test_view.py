"""What ``usv-twin view`` says in the terminal."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys

import pytest

pytest.importorskip("viser", reason="needs viser: pip install 'usv-twin[view]'")

from tests.twin.live.wire import free_port, viewing


def test_a_view_says_where_it_is_and_ends_with_ctrl_c(tmp_path):
    port = free_port(socket.SOCK_STREAM)
    with viewing(tmp_path, "--port", str(port), "-p", "persistence") as (process, said):
        assert f"http://127.0.0.1:{port} " in said[-1]
        process.send_signal(signal.SIGINT)
        complained = process.communicate(timeout=60)[1]
    assert process.returncode == 0
    assert "Traceback" not in complained and "rror" not in complained


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--nmea", "udp://:10111", "--policy", "los-twin"], "--nmea and --policy: look at one"),
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
