"""The page beside an autopilot: of a simulated boat, and of a real one."""

from __future__ import annotations

import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.twin.live.wire import free_port
from twin.digital_twin import Twin
from twin.live.external.link import Link, LinkSession
from twin.live.external.navigation import ExternalNavigation
from twin.live.external.receiver import ReceiverFeed
from twin.live.external.simulated import AutopilotRun, SitlSession
from twin.live.sessions.session import Session
from twin.logs.datum import Datum
from twin.sim.bridge import particulars_of
from usv_gym import SeaState, Vessel
from usv_gym.sitl.backend import Backend
from usv_gym.sitl.server import Server
from usv_gym.world.simulation import Simulation

pytest.importorskip("viser")

BOAT = Vessel.load("usv75")


def twin() -> Twin:
    return Twin(particulars_of(BOAT, None, 6), "ukf")


def simulated(folder: Path) -> Session:
    simulation = Simulation(1, BOAT, SeaState.named("2"), dof=6, dt=0.01, dt_physics=0.01)
    backend, own = Backend(simulation, 0), twin()
    run = AutopilotRun(backend, Datum(latitude=59.9, longitude=10.7), twin=own)
    return SitlSession(Server(backend, port=free_port()), run, own, folder)


def linked(folder: Path) -> Session:
    navigation, own = ExternalNavigation(), twin()
    feed = ReceiverFeed(f"udp://127.0.0.1:{free_port()}", own.particulars, navigation.peer)
    return LinkSession(Link(feed, navigation), own, BOAT, folder)


@pytest.mark.parametrize("kind", [simulated, linked])
def test_a_boat_that_an_autopilot_steers_has_a_page(
    kind: Callable[[Path], Session], tmp_path: Path, served: Callable[..., Any]
) -> None:
    session = kind(tmp_path)
    viewer = served(session)
    with urllib.request.urlopen(f"http://127.0.0.1:{viewer.port}/", timeout=20.0) as page:
        assert page.status == 200
    session.stop()
    if isinstance(session, SitlSession):
        session.server.close()
