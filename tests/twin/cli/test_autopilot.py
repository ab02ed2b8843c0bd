"""The commands sitl and link, as a user runs them."""

from __future__ import annotations

import contextlib
import socket
import threading
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from tests.twin.live.wire import free_port
from tests.usv_gym.sitl.fake_autopilot import FakeAutopilot
from twin.cli.main import app
from twin.logs.log import Log
from usv_gym.sitl.server import Server


def run(*arguments: str) -> Any:
    return CliRunner().invoke(app, list(arguments))


def test_print_params_are_a_parameter_file() -> None:
    found = run("sitl", "otter", "--print-params", "--twin", "ukf")
    assert found.exit_code == 0
    lines = dict(line.split() for line in found.stdout.splitlines() if line[:1] not in ("#", ""))
    assert lines["SERVO1_FUNCTION"] == "73" and lines["VISO_TYPE"] == "1"
    plain = run("sitl", "otter", "--print-params").stdout
    assert "VISO_TYPE" not in plain


def test_sitl_writes_a_log_with_the_truth_for_each_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An autopilot sails, stops, and another one begins again."""
    port, served = free_port(), []
    monkeypatch.setattr("twin.cli.sitl.port_of", lambda instance: port)
    opened = threading.Event()

    class Watched(Server):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            served.append(self)
            opened.set()

    monkeypatch.setattr("twin.cli.sitl.Server", Watched)

    def sail() -> None:
        opened.wait(60.0)
        for seconds in (3.0, 6.5):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
                wire.settimeout(60.0)

                def ask(data: bytes, wire: socket.socket = wire) -> bytes:
                    wire.sendto(data, ("127.0.0.1", port))
                    return wire.recv(1 << 16)

                pilot = FakeAutopilot(ask)
                # the last answer comes when the command has ended
                with contextlib.suppress(TimeoutError, AssertionError, OSError):
                    pilot.wait(1.0)
                    pilot.hold(0.5, seconds - 1.0)

    thread = threading.Thread(target=sail, daemon=True)
    thread.start()
    out = tmp_path / "run.parquet"
    mavlink = f"udp://127.0.0.1:{free_port()}"
    arguments = ("--duration", "6", "--twin", "persistence", "--faults", "gps2@2", "--mavlink")
    found = run("sitl", "usv75", *arguments, mavlink, "--out", str(out))
    assert found.exit_code == 0, found.output
    assert "ardurover -w -S --model JSON:127.0.0.1" in found.output
    first, second = Log.read(out), Log.read(tmp_path / "run_2.parquet")
    assert first.t[-1] == pytest.approx(3.0, abs=0.1)
    assert second.t[-1] == pytest.approx(6.0, abs=0.1)
    assert first.truth is not None and first.true_motion is not None
    assert first.truth[-1, 0] > 0.05
    assert str(first.datum).startswith("latitude 59.9")
    assert (tmp_path / "run.toml").exists()
    assert "restarts 1" in found.output
    thread.join(70.0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("sitl", "usv75", "--home", "Oslo"), "write LAT,LON"),
        (("sitl", "usv75", "--twin", "oracle"), "sea is not known"),
        (("sitl", "bismarck"), "no vessel is called"),
        (("link", "serial:/dev/ttyS0"), "write udp://"),
    ],
)
def test_what_cannot_be_done_is_reported(arguments: tuple[str, ...], words: str) -> None:
    found = run(*arguments)
    assert found.exit_code == 2
    assert words in found.output


def test_link_ends_after_its_time_and_says_what_came() -> None:
    found = run("link", f"udp://127.0.0.1:{free_port()}", "--duration", "0.3")
    assert found.exit_code == 0
    assert "external navigation: waiting" in found.output
    assert "messages: nothing" in found.output
