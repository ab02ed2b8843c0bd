"""The example that gives ArduPilot a mission, against one that asks for it item by item."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.twin.live.wire import free_port
from twin.logs.datum import Plane

mavutil = pytest.importorskip("pymavlink.mavutil")

EXAMPLE = Path(__file__).resolve().parents[4] / "examples/07_ardurover_mission.py"
SAFETY_ARMED, ROVER = 128, (10, 3)


def test_the_example_uploads_arms_and_follows(tmp_path):
    port = free_port()
    link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=1)
    command = [sys.executable, str(EXAMPLE), f"udpin:127.0.0.1:{port}"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as running:
        items, count, armed, end = {}, 0, False, time.monotonic() + 60.0
        while running.poll() is None and time.monotonic() < end:
            link.mav.heartbeat_send(*ROVER, SAFETY_ARMED if armed else 0, 0, 4)
            if armed:
                link.mav.mission_item_reached_send(count - 1)
            message = link.recv_match(blocking=True, timeout=0.2)
            kind = message.get_type() if message else ""
            if kind == "MISSION_COUNT":
                count = message.count
            elif kind == "MISSION_ITEM_INT":
                items[message.seq] = message
            elif kind == "COMMAND_LONG" and message.command == 400:
                armed = message.param1 == 1.0
            missing = [seq for seq in range(count) if seq not in items]
            if missing:
                link.mav.mission_request_int_send(255, 0, missing[0])
            elif count and not armed:
                link.mav.mission_ack_send(255, 0, 0)
        running.kill()
        said = running.stdout.read()
    link.close()
    assert f"way point {count - 1} of {count - 1}" in said
    home = Plane(59.9, 10.7)
    places = [home.metres(items[seq].x / 1e7, items[seq].y / 1e7) for seq in range(1, count)]
    north, east = zip(*places, strict=True)
    assert max(north) == pytest.approx(250.0, abs=0.1)
    assert max(east) == pytest.approx(100.0, abs=0.1)
